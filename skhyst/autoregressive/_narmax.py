"""Polynomial NARMAX models whose terms are selected from data."""

from math import comb
from numbers import Integral

import numpy as np
import pandas as pd
from sklearn.base import clone
from sklearn.utils.validation import check_is_fitted

from .._sklearn import Interval, StrOptions, check_feature_names_in
from .._validation import drive_column, fitted_interval
from ..base import one_thread
from ..optimize import coloured_covariance
from ..preprocessing import GeneralizedInputGradient, PlayOperators, read_lags
from ..records import valid_interval
from ._base import AutoregressiveRegressor, shifted
from ._difference_equation import at_ratio
from ._nonlinear_selection import improve
from ._polynomial import PolynomialStep, candidate_terms, term_name, term_products
from ._problems import FreeRunProblem, InnovationProblem, innovations
from ._runs import Start
from ._selection import Search, SelectionCriterion, condense_folds, error_reduction, subset_solution

_FEATURES = {
    "rate_sign": GeneralizedInputGradient(include_drive=False, include_rate=False, direction=True),
    "generalized_gradient": GeneralizedInputGradient(include_drive=False),
    "play": PlayOperators(5),
}
_MOST_TERMS = 5000
_LONGEST = 1_000_000  # lag in samples that a file may have
_ONE = -1  # index of a constant input of one


class NARMAXRegressor(AutoregressiveRegressor):
    r"""Polynomial NARMAX model whose terms, products of past signals, are selected from data.

    .. math:: y(k) = \sum_i \theta_i \, p_i\big(u(k - \cdot), y(k - \cdot), e(k - \cdot)\big) + e(k)

    with products :math:`p_i` of at most ``degree`` lagged signals. The terms are selected by
    forward orthogonal regression followed by single removals, additions and exchanges, as long as
    a criterion decreases; the coefficients are those of least squares.

    Parameters
    ----------
    degree : int, default=2
        Highest degree of a product of inputs and outputs.
    input_lags : int, array-like of int, or dict, default=(0, 1, 2)
        Lags of the inputs in samples; a number ``n`` stands for ``0, ..., n``. A dict maps columns,
        by position or name, to their lags.
    output_lags : int or array-like of int, default=(1, 2)
        Lags of the output in samples; a number ``n`` stands for ``1, ..., n``.
    noise_lags : int or array-like of int, default=()
        Lags of the one-step prediction errors, for noise that is not white.
    noise_degree : int, default=1
        Highest degree of a product that contains an error; 1 makes the noise model linear.
    n_terms : "auto", int or None, default="auto"
        Number of terms: "auto" minimises the criterion, None takes all that are not collinear.
    criterion : {"ebic", "bic", "aic", "aicc", "cv"}, default="ebic"
        Criterion of the term selection. ``"ebic"`` is the extended Bayesian information criterion,
        with an additional penalty of ``2 log(n_candidates)`` per term, without which one in a
        hundred useless candidates is selected by chance; ``"cv"`` is the cross-validation error
        over records left out, or over fifths of a single record.
    objective : {"one_step", "simulation"}, default="one_step"
        The error that is minimised: that of the one-step prediction, or of the free run.
    features : sequence of str or transformer, default=None
        Additional inputs computed from the drive, which give the model a memory of its direction:
        ``"rate_sign"`` (sign of the last change), ``"generalized_gradient"``, ``"play"`` (five play
        operators), or transformers of your own with ``fit`` and ``transform``. They enter with the
        shortest lag of column 0.
    include_bias : bool, default=True
        Whether a constant is among the candidates.

    Attributes
    ----------
    terms_ : DataFrame
        One row per term, in the order of forward regression: ``term``, ``coefficient``,
        ``standard_error`` and ``error_reduction_ratio``, the fraction of the sum of squares of the
        response that the term explains in addition to those before it.
    coef_, coef_std_ : ndarray of shape (n_terms,)
        Coefficients in the units of the data and their standard errors.
    coef_std_white_ : ndarray of shape (n_terms,)
        Standard errors if the noise is white.
    term_factors_ : ndarray of int, shape (n_terms, degree)
        Factors of each term, positions in ``lag_names_``; -1 for none.
    lag_names_ : list of str
        Lagged signals: inputs, outputs, errors.
    noise_std_ : float
        Standard deviation of the error that was minimised, units of the response.
    n_candidates_ : int
        Number of candidate terms.
    n_evaluations_ : int
        Number of runs over all records in the fit, 0 for a linear problem.

    See Also
    --------
    NARXRegressor : NARX model around any regressor.

    Notes
    -----
    Standard errors are conditional on the selected terms and assume

    - one step ahead without noise terms: that the equation error :math:`e` is white;
    - with noise terms: that it is white once these are subtracted. The coefficients are those of
      the prediction-error method, whose first iteration is extended least squares;
    - simulation: that the measured response is the free run plus noise of any colour. Standard
      errors account for the colour of the residual, as for every model whose prediction is the free
      run. Sensor noise biases the coefficients of the one-step objective, but not these.

    The selection of terms treats samples as independent. Of 100 runs of 2,000 samples with sensor
    noise of 2 % of the range, exactly the five true terms are found in 98 where the noise is white,
    in 76 where it is autoregressive with the coefficient 0.9, and in 39 where it is flicker noise,
    which mostly shows as a constant; ``python benchmarks/intervals.py`` counts them.

    References
    ----------
    Chen, Billings and Luo, *International Journal of Control*, 1989. Chen and Chen, *Biometrika*,
    2008. Amor, Kaddouri and Abdessemed, *International Journal of Power Electronics and Drive
    Systems*, 2023, equation (5).

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.autoregressive import NARMAXRegressor
    >>> rng = np.random.default_rng(0)
    >>> u, y = rng.uniform(-1.0, 1.0, 500), np.zeros(500)
    >>> for k in range(1, 500):
    ...     y[k] = 0.5 * y[k - 1] + u[k - 1] + 0.3 * y[k - 1] * u[k - 1] ** 2
    >>> model = NARMAXRegressor(3, output_lags=(1,)).fit(u.reshape(-1, 1), y)
    >>> print(model.terms_[["term", "coefficient"]].round(6).to_string(index=False))
                term  coefficient
              u(k-1)          1.0
              y(k-1)          0.5
     y(k-1) u(k-1)^2          0.3
    """

    _parameter_constraints = {
        **AutoregressiveRegressor._parameter_constraints,
        "degree": [Interval(Integral, 1, 9, closed="both")],
        "noise_lags": [Interval(Integral, 0, None, closed="left"), "array-like"],
        "noise_degree": [Interval(Integral, 1, 9, closed="both")],
        "n_terms": [StrOptions({"auto"}), Interval(Integral, 1, None, closed="left"), None],
        "criterion": [StrOptions({"ebic", "bic", "aic", "aicc", "cv"})],
        "objective": [StrOptions({"one_step", "simulation"})],
        "features": ["array-like", None],
        "include_bias": ["boolean"],
    }

    def __init__(
        self,
        degree=2,
        *,
        input_lags=(0, 1, 2),
        output_lags=(1, 2),
        noise_lags=(),
        noise_degree=1,
        n_terms="auto",
        criterion="ebic",
        objective="one_step",
        features=None,
        include_bias=True,
        initial_output="rest",
        dt=None,
        drive=None,
    ):
        self.degree = degree
        self.input_lags = input_lags
        self.output_lags = output_lags
        self.noise_lags = noise_lags
        self.noise_degree = noise_degree
        self.n_terms = n_terms
        self.criterion = criterion
        self.objective = objective
        self.features = features
        self.include_bias = include_bias
        self.initial_output = initial_output
        self.dt = dt
        self.drive = drive

    @property
    def terms_(self):
        """Terms, coefficients, standard errors and error reduction ratios."""
        n_inputs, n_outputs = len(self.input_lags_), len(self.output_lags_)
        names = [term_name(f, self.lag_names_, n_inputs, n_outputs) for f in self.term_factors_]
        return pd.DataFrame(
            {
                "term": names,
                "coefficient": self.coef_,
                "standard_error": self.coef_std_,
                "error_reduction_ratio": self.error_reduction_ratio_,
            }
        )

    def resampled(self, dt) -> "NARMAXRegressor":
        """Return a model of linear terms at another sampling interval.

        It is exact for inputs that are held between the samples of both models, and refused where
        it cannot be.

        Parameters
        ----------
        dt : float
            Sampling interval of the new model, in ``time_unit_``.

        Returns
        -------
        NARMAXRegressor
            Fitted, of degree 1; its standard errors are NaN.

        Raises
        ------
        ValueError
            If a term is a product, or there are features or noise terms; if ``initial_output`` is a
            number per lag; or if ``dt`` is not a multiple of the interval of the fit and a pole is
            zero, such as that of a delay, or negative.

        Examples
        --------
        >>> import numpy as np
        >>> from skhyst.autoregressive import NARXRegressor
        >>> u = np.random.default_rng(0).normal(size=(500, 1))
        >>> y = np.zeros(500)
        >>> for k in range(1, 500):
        ...     y[k] = 0.81 * y[k - 1] + 0.19 * u[k - 1, 0]
        >>> model = NARXRegressor(input_lags=[1], dt=0.02).fit(u, y)
        >>> print(model.resampled(0.01).terms_[["term", "coefficient"]].round(6).to_string())
              term  coefficient
        0  x0(k-1)          0.1
        1   y(k-1)          0.9
        2        1          0.0
        """
        check_is_fitted(self)
        caller = f"{type(self).__name__}.resampled"
        ratio = valid_interval(dt, caller) / fitted_interval(self)[0]
        linear = self._linear_terms()
        if linear is None or np.ndim(self.initial_output):
            raise ValueError(
                f"{caller} is exact for linear terms of inputs and outputs and one initial output. "
                "Got products, features, noise terms or a number per lag instead: fit the model to "
                "data at the other interval."
            )
        weights, intercept = linear
        n_inputs = len(self.input_lags_)
        with_constant = [*self.input_lags_, (_ONE, 0)]
        weights = np.insert(weights, n_inputs, intercept)
        terms, outputs, weights = at_ratio(with_constant, self.output_lags_, weights, ratio)
        is_one = np.array([*(column == _ONE for column, _ in terms), *np.zeros(len(outputs), bool)])
        constant = weights[is_one].sum()
        inputs = tuple(term for term in terms if term[0] != _ONE)
        return _of_terms(self, inputs, tuple(outputs), [*weights[~is_one], constant], float(dt))

    def _linear_terms(self):
        """Return the weights of all lagged signals and the constant; None with other terms."""
        factors, n_signals = self.term_factors_, len(self.input_lags_) + len(self.output_lags_)
        plain = (factors >= 0).sum(axis=1) <= 1
        if not plain.all() or self.noise_lags_ or self.transformers_:
            return None
        weights = np.zeros(n_signals + 1)  # the last one is of a term without factors, -1
        np.add.at(weights, factors.max(axis=1), self.coef_)
        return weights[:-1], weights[-1]

    # ------------------------------------------------------------------------------- the features

    def _widen(self, X, records, *, reset=False):
        names = list(getattr(self, "feature_names_in_", ()))
        if not names:
            names = ["u"] if X.shape[1] == 1 else [f"u{i + 1}" for i in range(X.shape[1])]
        if reset:
            self.transformers_ = self._fit_features(X, records[0].dt)
        drive, wide, signs = [drive_column(self)], [X], []
        for label, transformer in self.transformers_:
            parts = [transformer.transform(X[record.rows][:, drive]) for record in records]
            if label == "rate_sign":
                signs.append(len(names))
            wide.append(np.concatenate(parts).astype(float, copy=False))
            n_made = wide[-1].shape[1]
            names += [label] if n_made == 1 else [f"{label}{i}" for i in range(n_made)]
        if reset:
            lag = min((k for column, k in self.input_lags_ if column in drive), default=0)
            self.input_lags_ += tuple((column, lag) for column in range(X.shape[1], len(names)))
            self._signs = signs
        return (np.concatenate(wide, axis=1) if len(wide) > 1 else X), names

    def _fit_features(self, X, dt):
        fitted = []
        for kind in [] if self.features is None else self.features:
            if isinstance(kind, str) and kind in _FEATURES:
                label, transformer = kind, clone(_FEATURES[kind])
            elif not isinstance(kind, str) and hasattr(kind, "transform"):
                label, transformer = type(kind).__name__, clone(kind)
            else:
                raise ValueError(
                    "The 'features' parameter of NARMAXRegressor must list transformers or names "
                    f"out of {sorted(_FEATURES)}. Got {kind!r} instead."
                )
            if getattr(transformer, "dt", dt) is None:  # it is given the rows, without their times
                transformer.set_params(dt=dt)
            fitted.append((label, transformer.fit(X[:, [drive_column(self)]])))
        return fitted

    # ------------------------------------------------------------------------------------ the fit

    @property
    def _bridges(self):
        # prediction errors at lost rows are unknown, and cannot be interpolated
        return not read_lags(self, "noise_lags", self.noise_lags, 1)

    def _fit_records(self, X, y, records, weights, read):
        self.noise_lags_ = tuple(read_lags(self, "noise_lags", self.noise_lags, 1))
        if self.noise_lags_ and self.objective == "simulation":
            raise ValueError(
                "The 'noise_lags' parameter of NARMAXRegressor must be empty where 'objective' is "
                f"'simulation': a free run has no prediction errors. Got {self.noise_lags!r} "
                "instead."
            )
        if self.noise_lags_ and not weights.all():
            raise ValueError(
                "The 'sample_weight' of NARMAXRegressor must be above zero where there are "
                "'noise_lags': each prediction error needs the response. Got "
                f"{np.count_nonzero(weights == 0.0)} zero(s) instead."
            )
        self.lag_names_ = self.lag_names_ + [f"e(k-{lag})" for lag in self.noise_lags_]
        terms = self._candidates()
        self.n_candidates_, self.n_evaluations_ = len(terms), 0
        self._input_scale, self._output_scale = _unit_scale(X), float(_unit_scale(y))
        with one_thread():  # condensed data are small: threads would cost more than they save
            parts = self._regression(X, y, records, weights, read)
            search, n_free = self._linear_search(parts, terms)
            # None where the criterion decides on the number of terms
            wanted = None if self.n_terms == "auto" else self.n_terms or len(terms)
            problem = self._problem(terms, self._fit_starts(X, y, records, weights))
            if problem is None:
                subset = search.best(wanted)
                theta = subset_solution(search.factor, subset)[0]
            else:
                subset, theta, search, self.n_evaluations_ = improve(problem, search, wanted)
                n_free = sum(start.counts().sum() for start in problem.starts) - problem.n_extra
            self._adopt(terms, subset, theta, search, n_free, problem)

    def _candidates(self):
        n_process = len(self.input_lags_) + len(self.output_lags_)
        n_signals = n_process + len(self.noise_lags_)
        count = comb(n_process + self.degree, self.degree)
        if self.noise_lags_:
            count += comb(n_signals + self.noise_degree, self.noise_degree)
        if count > _MOST_TERMS:
            raise ValueError(
                "The 'degree' parameter of NARMAXRegressor must leave at most "
                f"{_MOST_TERMS} candidate terms for these lags. Got {self.degree!r} with "
                f"{n_signals} lagged signals instead: {count} terms."
            )
        groups = [
            (range(n_process), self.degree),
            (range(n_process, n_signals), self.noise_degree),
        ]
        terms = candidate_terms(groups, max(self.degree, self.noise_degree), self.include_bias)
        # the square of a sign is one: a term with it duplicates another
        signs = [i for i, (column, _) in enumerate(self.input_lags_) if column in self._signs]
        repeated = [np.sum(terms == sign, axis=1) > 1 for sign in signs]
        return terms[~np.any(repeated, axis=0)] if signs else terms

    def _without_noise(self, terms):
        """Return a mask of the terms that have no error as a factor."""
        return np.all(terms < len(self.input_lags_) + len(self.output_lags_), axis=1)

    def _linear_search(self, parts, terms):
        """Return the search over the terms without errors, one step ahead, and the weight of all.

        ``parts`` are the samples of each record.
        """
        known, left_out = terms[self._without_noise(terms)], self.criterion == "cv"
        Z, target, weights = map(np.concatenate, zip(*parts, strict=True))
        Z, target, root = Z / self._lag_scale(), target / self._output_scale, np.sqrt(weights)

        def block(rows):
            products = np.column_stack([term_products(Z[rows], known), target[rows]])
            return root[rows, None] * products

        folds = condense_folds(
            [len(signals) for signals, *_ in parts if len(signals)], left_out, block
        )
        total = sum(float(np.sum(fold[:, -1] ** 2)) for fold in folds)
        criterion = SelectionCriterion(self.criterion, weights.sum(), len(terms), total)
        return Search(folds, criterion), weights.sum()

    def _lag_scale(self):
        inputs = [self._input_scale[column] for column, _ in self.input_lags_]
        return np.array(inputs + [self._output_scale] * len(self.output_lags_))

    def _fit_starts(self, X, y, records, weights):
        """Return the starts of the fit; one step ahead they come after the longest lag."""
        given, starts = self._given_history(), []
        for record in records:
            inputs, response = X[record.rows], y[record.rows]
            history = np.full(self._n_outputs(), response[0]) if given is None else given
            start = Start(inputs, 0, history, response, weights[record.rows])
            if self.objective == "one_step" or self._start_kind() == "measured":
                start = self._after_past(inputs, response, weights[record.rows])
            starts.append(self._scaled(start))
        return [start for start in starts if len(start.measured)]

    def _scaled(self, start):
        measured = None if start.measured is None else start.measured / self._output_scale
        inputs, history = start.inputs / self._input_scale, start.history / self._output_scale
        return start._replace(inputs=inputs, history=history, measured=measured)

    def _problem(self, terms, starts):
        """Return the nonlinear problem to fit, None where the error is linear in coefficients."""
        scale = self._output_scale
        if self.noise_lags_:
            return InnovationProblem(
                terms, self._lags, self.noise_lags_, starts, self.bound_ / scale
            )
        if self.objective == "one_step":
            return None
        line = self._line[0] / scale, self._line[1:] * self._input_scale / scale
        return FreeRunProblem(
            terms,
            self._lags,
            starts,
            self.bound_ / scale,
            line=line if self._start_kind() == "rest" else None,
            limits=tuple(value / scale for value in self.output_range_),
            free=self._start_kind() == "estimate",
        )

    def _adopt(self, terms, subset, unknowns, search, n_free, problem):
        order, ratios = error_reduction(search.factor, subset)
        positions = [subset.index(column) for column in order]
        theta = np.asarray(unknowns)[positions]
        _, inverse, rest = subset_solution(search.factor, order)
        sigma = np.sqrt(rest / max(n_free - len(order), 1))
        white = coloured = sigma * np.sqrt(np.einsum("ij,ij->i", inverse, inverse))
        if self.objective == "simulation" and np.isfinite(inverse).all():
            root = np.zeros_like(inverse)
            root[positions] = inverse
            covariance = coloured_covariance(lambda: problem.rows(subset, unknowns), root, n_free)
            if covariance is not None:
                coloured = np.sqrt(np.diag(covariance)[positions])
        factors, noise = terms[order], [self._output_scale] * len(self.noise_lags_)
        scales = np.concatenate([self._lag_scale(), noise, [1.0]])[factors]  # -1 is the last one
        with np.errstate(over="ignore", under="ignore"):
            units = self._output_scale / np.prod(scales, axis=1)
            self.coef_ = theta * units
            self.coef_std_, self.coef_std_white_ = coloured * units, white * units
        self.term_factors_, self._theta = factors, theta
        self.error_reduction_ratio_ = np.array(ratios)
        self.noise_std_ = float(sigma * self._output_scale)
        self._step = self._polynomial()

    def _polynomial(self):
        known = self._without_noise(self.term_factors_)
        return PolynomialStep(self._lags, self.term_factors_[known], self._theta[known])

    def __getstate__(self):
        return {k: v for k, v in super().__getstate__().items() if k != "_step"}

    def __setstate__(self, state):
        super().__setstate__(state)
        if "coef_" in state:
            self._refuse_broken()
            self._step = self._polynomial()

    def _refuse_broken(self):
        """Refuse indices and sizes with which compiled code would leave its arrays."""
        n_columns, terms = self._n_columns, np.asarray(self.term_factors_)
        n_signals = len(self.input_lags_) + len(self.output_lags_) + len(self.noise_lags_)
        integers = [
            (n_columns, 1, np.size(self._input_scale)),
            *((column, 0, np.size(self._input_scale) - 1) for column, _ in self.input_lags_),
            *((lag, 0, _LONGEST) for _, lag in self.input_lags_),
            *((lag, 1, _LONGEST) for lag in (*self.output_lags_, *self.noise_lags_)),
        ]
        if not (
            all(isinstance(v, Integral) and low <= v <= high for v, low, high in integers)
            and np.shape(self._input_scale) == (n_columns,)
            and (terms.dtype.kind, terms.ndim) == ("i", 2)
            and np.all((terms >= -1) & (terms < n_signals))
            and np.shape(self._theta) == np.shape(self.coef_) == (len(terms),)
            and np.all(np.isfinite([*self._theta, *self.coef_]))
            and np.all(np.greater([self._output_scale, *self._input_scale], 0.0))
            and np.all(np.isfinite([self._output_scale, *self._input_scale]))
        ):
            raise ValueError(
                f"The lags, terms and scales of this {type(self).__name__} do not fit each other: "
                "it is broken."
            )

    # ----------------------------------------------------------------------------------- the runs

    def _places(self, rules):
        drive, positions = [(drive_column(self), 0)], super()._places(rules)
        for _, transformer in self.transformers_:
            positions += transformer.sample_rules(rules, drive, getattr(transformer, "dt", None))
        return positions

    def _plain_step(self):
        known = self._without_noise(self.term_factors_)
        return PolynomialStep(self._lags, self.term_factors_[known], self.coef_[known])

    def _one_step(self, Z):
        return self._step.rows(Z / self._lag_scale()) * self._output_scale

    def _run(self, start):
        y, good = self._step.run(self._scaled(start), self.bound_ / self._output_scale)
        return y * self._output_scale, good

    def _runs_ahead(self, starts, horizon):
        if self._without_noise(self.term_factors_).all():
            return super()._runs_ahead(starts, horizon)
        model = self.term_factors_, self._theta, self._lags, self.noise_lags_
        bound, scale = self.bound_ / self._output_scale, self._output_scale
        runs = [innovations(*model, self._scaled(start), bound, horizon) for start in starts]
        return [y * scale for y, _ in runs], all(good for _, good in runs)


def _unit_scale(values):
    """Return a power of two near the largest magnitude, so that dividing by it is exact."""
    largest = np.abs(values).max(axis=0)
    return 2.0 ** np.round(np.log2(np.where(largest > 0.0, largest, 1.0)))


def _of_terms(model, input_lags, output_lags, weights, dt):
    """Return a fitted linear model with the fit attributes of another, at another interval."""
    attributes, unit = vars(model), fitted_interval(model)[1]
    new = NARMAXRegressor(
        1,
        input_lags={column: [k for c, k in input_lags if c == column] for column, _ in input_lags},
        output_lags=output_lags,
        initial_output=model.initial_output,
        dt=dt if unit == "s" else None,
        drive=model.drive,
    )
    for name in (
        *("n_features_in_", "feature_names_in_", "records_", "drive_range_", "drive_rate_"),
        *("output_range_", "bound_", "_line", "_n_columns"),
    ):
        if name in attributes:
            setattr(new, name, attributes[name])
    new.dt_, new.time_unit_ = dt, unit
    new._records_dt = getattr(model, "_records_dt", fitted_interval(model)[0])
    new.input_lags_, new.output_lags_, new.noise_lags_ = input_lags, output_lags, ()
    names = [check_feature_names_in(model, None)[column] for column, _ in input_lags]
    new.lag_names_ = [shifted(n, lag) for n, (_, lag) in zip(names, input_lags, strict=True)]
    new.lag_names_ += [shifted("y", lag) for lag in output_lags]
    n_signals = len(input_lags) + len(output_lags)
    new.transformers_, new._signs = [], []
    new.n_candidates_, new.n_evaluations_, new.noise_std_ = n_signals + 1, 0, np.nan
    new._input_scale, new._output_scale = np.ones(model._n_columns), 1.0
    new.coef_ = new._theta = np.array(weights)
    new.coef_std_ = new.coef_std_white_ = np.full(n_signals + 1, np.nan)
    new.error_reduction_ratio_ = np.full(n_signals + 1, np.nan)
    new.term_factors_ = np.append(np.arange(n_signals), -1)[:, None]
    new._step = new._polynomial()
    return new
