"""Polynomial NARMAX models whose terms are found in the data."""

import warnings
from itertools import pairwise
from numbers import Integral
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from sklearn.base import clone

from .._sklearn import Interval, StrOptions
from ..base import _threads
from ..exceptions import ConvergenceWarning, RecordError
from ..preprocessing import GeneralizedInputGradient, PlayOperators
from ..preprocessing._lagged_features import read_lags
from ._base import AutoregressiveRegressor
from ._polynomial_loops import plan_polynomial, polynomial_run
from ._problems import PULLS, FreeRunProblem, InnovationProblem, RecordPart, innovations, solve
from ._selection import Criterion, Search, condense, error_reduction, subset_solution
from ._terms import candidate_terms, count_terms, term_name, term_products, unit_scale

__all__ = ["NARMAXRegressor"]

_FEATURES = {
    "rate_sign": lambda dt: GeneralizedInputGradient(include_drive=False, dt=dt),
    "generalized_gradient": lambda dt: GeneralizedInputGradient(include_drive=False, dt=dt),
    "play": lambda dt: PlayOperators(5),
}
_MOST_TERMS = 5000
_FOLDS = 5
_CHUNK = 4096  # rows of candidates held at once
_MOVES = ("removal", "addition", "exchange")
_SIZES = (3, 6, 12)  # of subsets to begin from where the chosen one is unstable
_ROUNDS = 10  # of search and fit where the error is no linear function of the coefficients


class _State(NamedTuple):
    """A subset of the terms, fitted, and the search among its neighbours."""

    subset: list
    theta: np.ndarray
    search: Search
    value: Any
    converged: bool


class NARMAXRegressor(AutoregressiveRegressor):
    r"""Polynomial NARMAX model: which products of past signals give the next output.

    .. math:: y(k) = \sum_i \theta_i \, p_i\big(u(k - \cdot), y(k - \cdot), e(k - \cdot)\big) + e(k)

    with products :math:`p_i` of at most ``degree`` lagged signals. The terms are chosen by forward
    orthogonal regression followed by single removals, additions and exchanges, for as long as a
    criterion falls; the coefficients are those of least squares.

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
        Lags of the errors one step ahead, for noise that is not white.
    noise_degree : int, default=1
        Highest degree of a product with an error in it; 1 makes the noise model linear.
    n_terms : "auto", int or None, default="auto"
        Number of terms: where the criterion is least, or as given, or all that are not collinear.
    criterion : {"ebic", "bic", "aic", "aicc", "cv"}, default="ebic"
        What decides on a term. ``"ebic"`` is the Bayesian criterion with a further price of
        ``2 log(n_candidates)`` a term, without which one in a hundred useless candidates gets in by
        chance; ``"cv"`` is the error in records left out, or in fifths of a single record.
    objective : {"one_step", "simulation"}, default="one_step"
        The error that is made small: one step ahead, or of the free run.
    features : sequence of str or transformer, default=None
        Further inputs made from the drive, which give the model a memory of its direction:
        ``"rate_sign"`` (of the last move), ``"generalized_gradient"``, ``"play"`` (five play
        operators), or transformers of your own with ``fit`` and ``transform``. They enter with the
        shortest lag of column 0.
    include_bias : bool, default=True
        Whether a constant is among the candidates.
    initial_output : {"rest", "measured", "estimate"}, float or array-like, default="rest"
        Outputs before each record of a free run: those of the model at rest under the first inputs,
        the first measured ones where ``y`` is given, those that fit the record best (``"rest"``
        where ``y`` is not given), or values ``y(-1), y(-2), ...``.
    dt : float, default=1.0
        Sampling interval in s of data without a time index.

    Attributes
    ----------
    terms_ : DataFrame
        One row a term, in the order of forward regression: ``term``, ``coefficient``,
        ``standard_error`` and ``error_reduction_ratio``, the part of the sum of squares of the
        response that the term explains beyond those before it.
    coef_, coef_std_ : ndarray of shape (n_terms,)
        Coefficients in the units of the data and their standard errors.
    term_factors_ : ndarray of int, shape (n_terms, degree)
        Factors of each term, positions in ``lag_names_``; -1 for none.
    lag_names_ : list of str
        Lagged signals: inputs, outputs, errors.
    noise_std_ : float
        Standard deviation of the error that was made small, units of the response.
    n_candidates_ : int
        Number of terms there were to choose from.
    n_evaluations_ : int
        Runs over all records that the fit took, 0 where it is a linear problem.
    records_ : tuple of RecordSlice
        The records of the fit.

    See Also
    --------
    NARXRegressor : The same around any regressor.

    Notes
    -----
    Standard errors hold for the terms that were chosen and assume

    - one step ahead without noise terms: that the equation error :math:`e` is white;
    - with noise terms: that it is white once these are taken out. The coefficients are those of the
      prediction-error method, to which extended least squares is the first step;
    - simulation: that the measured response is the free run plus white noise. Noise on the sensor
      biases the coefficients of the one-step objective, and not these.

    References
    ----------
    S. Chen, S. A. Billings, W. Luo, "Orthogonal least squares methods and their application to
    non-linear system identification", Int. J. Control 50 (1989).
    J. Chen, Z. Chen, "Extended Bayesian information criteria for model selection with large model
    spaces", Biometrika 95 (2008).
    "NARMAX approach for micro positioning stage piezoelectric actuator hysteresis identification",
    equation (5).

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
        dt=1.0,
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

    # ------------------------------------------------------------------------------- the features

    def _widen(self, X, records, *, reset=False):
        names = list(getattr(self, "feature_names_in_", ()))
        if not names:
            names = ["u"] if X.shape[1] == 1 else [f"u{i + 1}" for i in range(X.shape[1])]
        if reset:
            self.transformers_ = self._fit_features(X, records[0].dt)
        columns, made_by, lag = (
            [X],
            [],
            min((k for column, k in self.input_lags_ if column == 0), default=0),
        )
        for label, transformer in self.transformers_:
            made = np.concatenate([_transformed(transformer, X[r.rows, :1]) for r in records])
            columns.append(_last_sign(made, records) if label == "rate_sign" else made)
            made_by += [label] * made.shape[1]
            one = made.shape[1] == 1
            names += [label if one else f"{label}{i}" for i in range(made.shape[1])]
        wide = np.concatenate(columns, axis=1) if len(columns) > 1 else X
        if reset:
            self._made = made_by
            self.input_lags_ += tuple((column, lag) for column in range(X.shape[1], wide.shape[1]))
        return wide, names

    def _fit_features(self, X, dt):
        fitted = []
        for kind in [] if self.features is None else self.features:
            if isinstance(kind, str) and kind in _FEATURES:
                label, transformer = kind, _FEATURES[kind](dt)
            elif not isinstance(kind, str) and hasattr(kind, "transform"):
                label, transformer = type(kind).__name__, clone(kind)
            else:
                raise ValueError(
                    "The 'features' parameter of NARMAXRegressor must list transformers or names "
                    f"out of {sorted(_FEATURES)}. Got {kind!r} instead."
                )
            fitted.append((label, transformer.fit(X[:, :1])))
        return fitted

    # ------------------------------------------------------------------------------------ the fit

    def _fit_records(self, X, y, records):
        # condensed data are tiny: threads that wait for each other cost more than they do
        with _threads().limit(limits=1, user_api="blas"):
            self._fit_terms(X, y, records)

    def _fit_terms(self, X, y, records):
        self.noise_lags_ = tuple(read_lags(self, "noise_lags", self.noise_lags, 1))
        if self.noise_lags_ and self.objective == "simulation":
            raise ValueError(
                "The 'noise_lags' parameter of NARMAXRegressor must be empty where 'objective' is "
                f"'simulation': a free run knows no errors. Got {self.noise_lags!r} instead."
            )
        self.lag_names_ = self.lag_names_ + [f"e(k-{lag})" for lag in self.noise_lags_]
        terms = self._candidates()
        self.n_candidates_ = len(terms)
        self._input_scale, self._output_scale = unit_scale(X), float(unit_scale(y))
        parts = self._parts(X, y, records)
        folds, n_samples = self._linear_folds(X, y, records, terms[: self._n_process])
        total = sum(float(np.sum(fold[:, -1] ** 2)) for fold in folds)
        criterion = Criterion(self.criterion, n_samples, len(terms), total)
        search = Search(folds, criterion)
        subset = search.best(self._wanted())
        theta = subset_solution(search.factor, subset)[0]
        self.n_evaluations_, n_free = 0, n_samples
        problem = self._problem(terms, parts, X)
        if problem is not None:
            subset, theta, search = self._improve(problem, search, subset, theta)
            n_free = sum(len(part.measured) for part in parts) - problem.n_extra
        self._adopt(terms, subset, theta, search, n_free)

    def _candidates(self):
        n_process = len(self.input_lags_) + len(self.output_lags_)
        n_noise, degrees = len(self.noise_lags_), (self.degree, self.noise_degree)
        count = count_terms(n_process, self.degree)
        if n_noise:
            count += count_terms(n_process + n_noise, self.noise_degree)
        if count > _MOST_TERMS:
            raise ValueError(
                "The 'degree' parameter of NARMAXRegressor must leave at most "
                f"{_MOST_TERMS} candidate terms of the lags. Got {self.degree!r} with "
                f"{n_process + n_noise} lagged signals instead: {count} terms."
            )
        groups = [(range(n_process), self.degree)]
        process = candidate_terms(groups, self.degree, self.include_bias)
        self._n_process = len(self._without_square_signs(process))
        groups.append((range(n_process, n_process + n_noise), self.noise_degree))
        return self._without_square_signs(candidate_terms(groups, max(degrees), self.include_bias))

    def _without_square_signs(self, terms):
        """Return the terms but for those that repeat a sign, whose square is one."""
        signs = [i for i in range(len(self.input_lags_)) if self._is_sign(i)]
        repeated = [np.sum(terms == sign, axis=1) > 1 for sign in signs]
        return terms[~np.any(repeated, axis=0)] if signs else terms

    def _is_sign(self, position):
        made = self.input_lags_[position][0] - self.n_features_in_
        return made >= 0 and self._made[made] == "rate_sign"

    def _parts(self, X, y, records):
        """Return the records in scaled units; the first samples are the past of the others."""
        skip, n_outputs = self._n_skipped(), self._n_outputs()
        given = self._given_history()
        parts = []
        for record in records:
            inputs, response = X[record.rows] / self._input_scale, y[record.rows]
            n_past = 0
            history = np.full(n_outputs, response[0]) if given is None else given
            if self.objective == "one_step" or self.initial_output == "measured":
                n_past = skip
                history = response[skip - n_outputs : skip]
            if record.n_samples > n_past:
                scaled = response[n_past:] / self._output_scale
                parts.append(RecordPart(inputs, n_past, history / self._output_scale, scaled))
        return parts

    def _linear_folds(self, X, y, records, terms):
        """Return the condensed candidates and responses of each fold, and the number of rows."""
        skip = self._n_skipped()
        Z, target = self._regression(X, y, records)
        Z, target = Z / self._lag_scale(), target / self._output_scale
        sizes = [record.n_samples - skip for record in records if record.n_samples > skip]

        def chunks(rows):
            for start in range(rows.start, rows.stop, _CHUNK):
                part = slice(start, min(start + _CHUNK, rows.stop))
                yield np.column_stack([term_products(Z[part], terms), target[part]])

        folds = [
            condense(chunk for rows in fold for chunk in chunks(rows))
            for fold in self._split(sizes)
        ]
        return folds, len(target)

    def _split(self, sizes):
        """Return the rows of each fold, as slices that stay within a record."""
        ends = np.cumsum(sizes)
        rows = [slice(end - size, end) for end, size in zip(ends, sizes, strict=True)]
        if self.criterion != "cv":
            return [rows]
        if len(rows) == 1:
            edges = np.linspace(0, sizes[0], _FOLDS + 1).astype(int)
            rows = [slice(a, b) for a, b in pairwise(edges) if b > a]
        n_folds = min(_FOLDS, len(rows))
        if n_folds < 2:
            raise RecordError(
                "The records must have at least two samples beyond the longest lag where "
                "'criterion' is 'cv'. Got one instead."
            )
        return [rows[i::n_folds] for i in range(n_folds)]

    def _lag_scale(self):
        inputs = [self._input_scale[column] for column, _ in self.input_lags_]
        return np.array(inputs + [self._output_scale] * len(self.output_lags_))

    def _wanted(self):
        """Return the number of terms for ``Search.best``."""
        return None if self.n_terms == "auto" else self.n_terms or self.n_candidates_

    def _problem(self, terms, parts, X):
        bound = self.bound_ / self._output_scale
        if self.noise_lags_:
            lags = (self.input_lags_, self.output_lags_, self.noise_lags_)
            return InnovationProblem(terms, lags, parts, bound)
        if self.objective == "one_step":
            return None
        line = None
        if self.initial_output == "rest":
            line = (
                self._line[0] / self._output_scale,
                self._line[1:] * self._input_scale / self._output_scale,
            )
        limits = tuple(value / self._output_scale for value in self.output_range_)
        lags = (self.input_lags_, self.output_lags_)
        free = self.initial_output == "estimate"
        return FreeRunProblem(terms, lags, parts, bound, line=line, limits=limits, free=free)

    def _begin(self, problem, search, subset, theta):
        """Yield states to begin from: one, unless its run has left the data."""
        criterion, lost = search.criterion, problem.lost(subset, theta)
        if lost and self.n_terms == "auto":
            for size in _SIZES:  # few terms, mostly linear ones, are often stable
                if size < len(subset):
                    few = search.best(size)
                    coefficients = subset_solution(search.factor, few)[0]
                    yield self._settle(problem, few, coefficients, criterion)
        for pull in PULLS if lost else ():
            # a run that has left the data says nothing of the way back: lead it there
            state = self._settle(problem, subset, theta, criterion, pull)
            subset = state.search.best(self._wanted())
            theta = subset_solution(state.search.factor, subset)[0]
        yield self._settle(problem, subset, theta, criterion)

    def _improve(self, problem, search, subset, theta):
        """Alternate between the fit of the terms and a search around it."""
        state = min(self._begin(problem, search, subset, theta), key=lambda state: state.value)
        for _ in range(_ROUNDS):
            for subset in self._neighbours(state):
                theta = subset_solution(state.search.factor, subset)[0]
                other = self._settle(problem, subset, theta, search.criterion)
                if other.value < state.value:
                    state = other
                    break
            else:
                break
        state = self._settle(problem, state.subset, state.theta, search.criterion, rough=False)
        if not state.converged:
            warnings.warn(
                "The fit of NARMAXRegressor has not converged; it stopped at the best so far.",
                ConvergenceWarning,
                stacklevel=7,
            )
        return state.subset, state.theta, state.search

    def _neighbours(self, state):
        """Yield other subsets that promise more: the best one first, then the best single move."""
        moves = ("exchange",) if self.n_terms != "auto" else _MOVES
        known = [set(state.subset)]
        for find in (
            lambda: state.search.best(self._wanted()),
            lambda: state.search.refine(state.subset, moves, 1),
        ):
            subset = find()
            if set(subset) not in known:
                known.append(set(subset))
                yield subset

    def _settle(self, problem, subset, theta, criterion, pull=0.0, *, rough=True):
        """Fit a subset and look around it."""
        theta, converged, n_evaluations = solve(problem, subset, theta, pull, rough=rough)
        self.n_evaluations_ += n_evaluations
        n_terms = len(problem.terms)
        full = np.concatenate([np.zeros(n_terms), theta[len(subset) :]])
        full[subset] = theta[: len(subset)]
        blocks, cost = [], 0.0
        for tangents, error in problem.blocks(range(n_terms), full, pull)[0]:
            cost += float(error @ error)
            target = error + tangents[:, subset] @ full[subset]
            block = np.column_stack([tangents[:, :n_terms], target])
            if problem.n_extra:  # whatever a change of the initial outputs can explain
                own = tangents[:, n_terms:]
                q = np.linalg.qr(own[:, np.any(own != 0.0, axis=0)])[0]
                block -= q @ (q.T @ block)
            blocks.append(block)
        rows = np.concatenate(blocks)
        folds = [
            condense(rows[part] for part in fold)
            for fold in self._split([len(block) for block in blocks])
        ]
        search = Search(folds, criterion)
        if self.n_terms != "auto":
            value = (-len(subset), cost)
        elif self.criterion == "cv":
            value = search.value(subset)
        else:
            value = criterion(cost, len(subset))
        return _State(list(subset), theta[: len(subset)], search, value, converged)

    def _adopt(self, terms, subset, theta, search, n_free):
        order, ratios = error_reduction(search.factor, subset)
        theta = dict(zip(subset, theta, strict=True))
        theta = np.array([theta[column] for column in order])
        _, inverse, rest = subset_solution(search.factor, order)
        sigma = np.sqrt(rest / max(n_free - len(order), 1))
        factors = terms[order]
        scales = np.append(self._lag_scale(), [self._output_scale] * len(self.noise_lags_))
        scales = np.append(scales, 1.0)[factors]  # -1 is the last one
        with np.errstate(over="ignore", under="ignore"):
            units = self._output_scale / np.prod(scales, axis=1)
            self.coef_ = theta * units
            self.coef_std_ = sigma * np.sqrt(np.einsum("ij,ij->i", inverse, inverse)) * units
        self.term_factors_, self._theta = factors, theta
        self.error_reduction_ratio_ = np.array(ratios)
        self.noise_std_ = float(sigma * self._output_scale)
        signals = len(self.input_lags_) + len(self.output_lags_)
        self._deterministic = ~np.any(factors >= signals, axis=1)
        self._plan = plan_polynomial(
            factors[self._deterministic],
            self.input_lags_,
            self.output_lags_,
            len(self._input_scale),
        )

    # ----------------------------------------------------------------------------------- the runs

    def _one_step(self, Z):
        known = self._deterministic
        values = term_products(Z / self._lag_scale(), self.term_factors_[known])
        return (values @ self._theta[known]) * self._output_scale

    def _run(self, start):
        y, n_good = polynomial_run(
            self._plan,
            self._theta[self._deterministic],
            start.inputs / self._input_scale,
            start.history / self._output_scale,
            self.bound_ / self._output_scale,
            start.n_past,
        )
        y *= self._output_scale
        return y, n_good

    def _runs_ahead(self, starts, measured, horizon):
        if self._deterministic.all():
            return super()._runs_ahead(starts, measured, horizon)
        lags = (self.input_lags_, self.output_lags_, self.noise_lags_)
        bound, runs, good = self.bound_ / self._output_scale, [], True
        for start, y in zip(starts, measured, strict=True):
            part = RecordPart(
                start.inputs / self._input_scale,
                start.n_past,
                start.history / self._output_scale,
                y / self._output_scale,
            )
            run, whole = innovations(self.term_factors_, self._theta, lags, part, bound, horizon)
            runs.append(run * self._output_scale)
            good &= whole
        return runs, good


def _transformed(transformer, drive):
    return np.asarray(transformer.transform(drive), dtype=float)


def _last_sign(rate, records):
    """Return the direction of the last move of each record, 0 before the first one."""
    sign = np.sign(rate)
    for record in records:
        values = sign[record.rows, 0]
        moved = np.maximum.accumulate(np.where(values != 0.0, np.arange(len(values)), 0))
        sign[record.rows, 0] = values[moved]
    return sign
