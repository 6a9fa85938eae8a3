"""Any regressor with physical effects in series and in parallel."""

import warnings
from copy import copy
from dataclasses import replace
from functools import partial
from itertools import pairwise
from numbers import Integral, Real
from typing import Self

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, MetaEstimatorMixin, clone
from sklearn.utils.validation import check_is_fitted

from .._documentation import documented_like
from .._signals import input_signals
from .._sklearn import HasMethods, Interval, fit_context
from .._validation import (
    ScoredMixin,
    in_native_order,
    known_response,
    read_weights,
    refuse_std,
    rest_input,
    used_interval,
    warn_beyond,
    with_unread,
)
from ..autoregressive import compiled_regressor
from ..base import (
    ParametricModel,
    behind_gaps,
    identified,
    informed,
    one_thread,
    read_data,
    refine,
    scored_where,
    warn_gaps,
    with_params,
)
from ..exceptions import ConvergenceWarning
from ..linear import Gain
from ..operators import (
    CompiledColumn,
    CompiledColumnSeries,
    CompiledSeries,
    Signal,
    Stepper,
    run_records,
)
from ..optimize import OperatorProblem, is_coloured
from ..records import fill_lost_rows, with_lost_rows
from ._backfitting import Backfitting, Turn, fold_of_rows


class Corrected(MetaEstimatorMixin, ScoredMixin, BaseEstimator):
    r"""Any regressor, whose prediction drives a model of physical effects.

    .. math:: y = E[f(X)]

    with the regressor f, such as a network or a pipeline, and the effects E: a lag or a saturation
    in series, a drift or an offset in parallel. The two are fitted in turn (backfitting): the
    effects from out-of-fold predictions of f, then f to the response with the effects inverted, as
    far as the noise allows, until the out-of-fold error no longer falls. So f need not learn what
    the effects describe better.

    Parameters
    ----------
    estimator : estimator
        Any regressor or pipeline. Data without a time index are passed on as they are.
    effects : estimator, default=None
        A parametric model of skhyst, such as a :class:`Cascade` or a :class:`Sum`, driven by the
        prediction; by default a gain and an offset. Its column 0 is the prediction, the others are
        those of ``X``.
    cv : int, default=5
        Number of folds. Folds are whole records; a single record is cut into contiguous blocks.
    max_iter : int, default=10
        Largest number of turns; with 0 the regressor is fitted to the measured response.
    dt : float or None, default=None
        Sampling interval in s of data without a time index; None: that of the regressor and the
        effects, which must agree.

    Attributes
    ----------
    estimator_ : estimator
        The regressor, fitted to all rows.
    effects_ : estimator
        The effects, fitted.
    fit_error_ : float
        Root mean square of the residual with out-of-fold predictions, units of the response.
    n_iter_ : int
        Number of times that the two were fitted: one more than the turns that lowered the error.
    n_features_in_ : int
        Number of columns of ``X``.
    drive_range_ : tuple of (float, float)
        Smallest and largest drive (column 0 of X) in the fit, units of the drive.
    drive_rate_ : float
        Largest rate of the drive between two samples of the fit, units of the drive per s.

    See Also
    --------
    skhyst.diagnosis.EffectSearchCV : Finds the effects that a regressor lacks.

    Notes
    -----
    The effects are identified with predictions that are somewhat worse than those of the final
    regressor, which is fitted to all rows. Each fold of a single record is the response to the
    predictions of one regressor for the whole record, unless a disturbance is among the effects.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn.linear_model import LinearRegression
    >>> from skhyst.compose import Corrected
    >>> from skhyst.linear import FirstOrderLag, FirstOrderLagOperator
    >>> u = np.random.default_rng(0).normal(size=1000).cumsum()
    >>> y, _ = FirstOrderLagOperator(0.05).run(2.0 * u + 1.0, 0.01)
    >>> model = Corrected(LinearRegression(), FirstOrderLag(), dt=0.01).fit(u.reshape(-1, 1), y)
    >>> round(model.effects_.operator_.time_constant, 3)
    0.05
    """

    one_interval = False  # unless its estimator asks for one interval

    _parameter_constraints = {
        "estimator": [HasMethods(["fit", "predict"])],
        "effects": [HasMethods(["fit", "predict"]), None],
        "cv": [Interval(Integral, 2, None, closed="left")],
        "max_iter": [Interval(Integral, 0, None, closed="left")],
        "dt": [Interval(Real, 0, None, closed="neither"), None],
    }

    def __init__(self, estimator, effects=None, *, cv=5, max_iter=10, dt=None):
        self.estimator = estimator
        self.effects = effects
        self.cv = cv
        self.max_iter = max_iter
        self.dt = dt

    def __sklearn_tags__(self):
        tags = super().__sklearn_tags__()
        tags.regressor_tags.poor_score = True  # on data that no device has produced
        return tags

    @fit_context(prefer_skip_nested_validation=False)
    @documented_like(ParametricModel.fit)
    def fit(self, X, y, sample_weight=None) -> Self:
        """Fit the regressor and the effects in turn.

        Raises
        ------
        TypeError
            If the effects are not a parametric model of skhyst.
        ValueError
            If there are weights, and the regressor accepts none.
        """
        effects = Gain() if self.effects is None else clone(self.effects)
        if not isinstance(effects, ParametricModel):
            raise TypeError(
                "The 'effects' parameter of Corrected must be a parametric model of skhyst. "
                f"Got {effects!r} instead."
            )
        y = with_unread(y, sample_weight)
        weights = None
        if sample_weight is not None:
            weights = read_weights(sample_weight, X)
        X, y, read = fill_lost_rows(X, y)
        if weights is not None and read is not None:
            given_weights, weights = weights, np.zeros(len(read))
            weights[read] = given_weights
        slices, columns, y = read_data(self, X, y, reset=True)
        X = in_native_order(X) if hasattr(X, "iloc") else columns
        if len(slices) == 1 and len(y) < self.cv:
            raise ValueError(
                f"Corrected needs at least {self.cv} samples for {self.cv} folds. "
                f"Got {len(y)} instead."
            )
        if hasattr(self, "feature_names_in_"):
            names = ["prediction", *self.feature_names_in_[1:]]
            effects.feature_names_in_ = np.array(names, dtype=object)
        # a segment is a run of rows of one fold: the effects are fitted to segments outside a fold,
        # simulated over whole records, so that a fold does not cut their memory
        fold = fold_of_rows(slices, self.cv)
        backfitting = Backfitting(self.estimator, X, slices, fold, weights)
        segments = [_stretches(fold[s.rows]) for s in slices]
        fold_of_segment = [
            fold[s.rows][a] for s, runs in zip(slices, segments, strict=True) for a, _ in runs
        ]
        train = [np.array(fold_of_segment) != k for k in range(backfitting.n_folds)]
        # the predictions of two clones differ by a jump, which effects with a memory would follow:
        # within a record each clone drives them by itself; but its disturbances are of one record
        is_single = len(slices) == 1
        is_disturbed = effects.disturbance_names or effects.operator_class.is_disturbance
        is_cut = is_single and not is_disturbed
        effects.records_, effects.n_features_in_ = slices, columns.shape[1]

        def records_of(p, begun):
            """Return the records driven by predictions ``p``; ``begun``: see ``refit``."""
            data = effects.record_data(slices, _as_first_column(p, columns), y)
            data = data if read is None else scored_where(data, slices, read)
            if weights is not None:
                data = [
                    replace(r, weights=r.counts() * weights[s.rows])
                    for r, s in zip(data, slices, strict=True)
                ]
            return [
                replace(r, segments=runs, **begun.get(i, {}))
                for i, (r, runs) in enumerate(zip(data, segments, strict=True))
            ]

        def problem_of(fitted, p):
            result, begun = fitted
            return OperatorProblem(
                result.operator,
                records_of(p, begun),
                disturbances=result.disturbances,
                initial_state=effects.free_run_state,
            )

        def out_of_fold(predictions, begun):
            """Return the records, each row driven by the clone that was not trained on it."""
            if not is_cut:
                return records_of(backfitting.out_of_fold(predictions), begun)
            return [
                replace(record, segments=tuple(rows for rows in segments[0] if fold[rows[0]] == k))
                for k, p in enumerate(predictions)
                for record in records_of(p, begun)
            ]

        def refit(last, predictions):
            """Return the result of the effects and how records behind missing rows begin."""
            with one_thread():
                if last is None:
                    records = out_of_fold(predictions, {})
                    _, result = identified(effects, records)
                else:  # from the last result
                    result, begun = last
                    records = out_of_fold(predictions, begun)
                    start = result.operator, result.disturbances
                    result = refine(effects, [start], records, "variable_projection")
                result, records = effects.with_history_behind_gaps(result, records)
            begun = {
                i: {"before": records[i].before, "start": records[i].start}
                for i in behind_gaps(slices)
            }
            return (result, begun), result.error

        # first turn: the regressors learn the response itself, as if there were no effects
        response = np.concatenate([record.y for record in records_of(columns[:, 0], {})])
        targets = np.tile(response, (backfitting.n_folds, 1))
        predictions = backfitting.predict(targets)
        start = refit(None, predictions)
        last = backfitting.alternate(
            Turn(targets, predictions, *start), problem_of, refit, train, self.max_iter
        )
        result, begun = last.effects
        records = out_of_fold(last.predictions, begun)
        for message, kind in effects.fit_warnings(result, records):
            warnings.warn(message, kind, stacklevel=3)
        if is_single and is_disturbed:

            def output(p):
                problem = problem_of(last.effects, p)
                return problem.simulate(result.operator, problem.records[0])

            each = np.array([output(p) for p in last.predictions])[fold, np.arange(len(fold))]
            jumps = output(backfitting.out_of_fold(last.predictions)) - each
            if np.mean(np.square(jumps)) > 0.5 * result.error**2:  # most of the residual
                warnings.warn(
                    "The effects of Corrected follow jumps between the predictions of two folds "
                    "of one record: give several records, or effects without a disturbance.",
                    ConvergenceWarning,
                    stacklevel=3,
                )
        stays = last.number == 0 and self.max_iter > 0 and not result.operator.memoryless
        if stays and is_coloured(result, records, effects.free_run_state):
            warnings.warn(
                "Corrected has not separated the regressor from the effects: the regressor was "
                "fitted to the response with the effects in it, no turn without them has lowered "
                "the out-of-fold error, and the residual is not white.",
                ConvergenceWarning,
                stacklevel=3,
            )
        effects.adopt(result)
        estimator = backfitting.fitted(last.targets)
        return self.adopt(estimator, effects, slices, 1 + last.number)

    def adopt(self, estimator, effects, slices, n_iter) -> Self:
        """Take fitted parts as the result of a fit, without one.

        Parameters
        ----------
        estimator : estimator
            The fitted regressor.
        effects : ParametricModel
            The fitted effects.
        slices : sequence of RecordSlice
            The records of the fit.
        n_iter : int
            Number of turns of the fit.

        Returns
        -------
        self
        """
        self.estimator_, self.effects_, self.records_ = estimator, effects, slices
        self.fit_error_, self.n_iter_ = effects.fit_error_, n_iter
        return self

    @property
    def params_(self) -> dict[str, float]:
        """Parameters of the effects."""
        return self.effects_.params_

    @property
    def params_std_(self) -> dict[str, float]:
        """Standard errors of the parameters of the effects."""
        return self.effects_.params_std_

    @documented_like(ParametricModel.predict)
    def predict(self, X, y_start=None, return_std=False) -> np.ndarray:
        """Return the response, each record from its own initial state.

        The standard deviation of a new sample is not known for an arbitrary regressor.
        """
        check_is_fitted(self)
        refuse_std(self, return_std, "around a regressor")
        slices, columns, _ = read_data(self, X, reset=False, bridge=True)
        if not hasattr(self.estimator_, "drive_range_"):  # which tells it by itself
            linear = hasattr(self.estimator_, "coef_") and self.effects_.operator_.signal_linear
            warn_beyond(self, columns, set(range(columns.shape[1])), linear=linear)
        X = X if hasattr(X, "iloc") else columns
        p = np.ravel(self.estimator_.predict(X)).astype(float)
        slices, columns, p, read = with_lost_rows(slices, columns, p)
        effects, inputs = self.effects_, _as_first_column(p, columns)
        if y_start is not None:
            known = known_response(self, X, y_start)
            interval = {"dt_": self.dt_, "time_unit_": self.time_unit_}
            names = getattr(effects, "feature_names_in_", None)
            rows = inputs if read is None else inputs[read]
            rows = pd.DataFrame(rows, getattr(X, "index", None), names)
            return with_params(effects, **interval).predict(rows, known)
        warn_gaps(self, effects.operator_, slices)
        signal, schedules = effects.operator_input(inputs, slices)
        state = effects.free_run_state
        y = run_records(effects.operator_, signal, slices, state, schedules)
        return y if read is None else y[read]

    def _timed_effects(self):
        return with_params(self.effects_, dt_=self.dt_, time_unit_=self.time_unit_)

    @documented_like(ParametricModel.depends_on_interval)
    def depends_on_interval(self, dt) -> bool:
        """Whether the effects respond differently at another interval than that of the fit."""
        return self._timed_effects().depends_on_interval(dt)

    def stepper(self, dt=None, u0=0.0, initial_state=None, *, schedule=None) -> Stepper:
        """Return the fitted model as a device that is run sample by sample.

        A regressor with a ``stepper``, such as a model of skhyst, is stepped by it; any other must
        predict each row independently; it may be preceded by transformers of skhyst.

        Parameters
        ----------
        dt : float, default=None
            Sampling interval in s; by default that of the records of the fit.
        u0 : float or array-like of shape (n_inputs,), default=0.0
            Inputs at which the device has rested.
        initial_state : {"rest", "zero"}, default=None
            State before the first sample; by default that of :meth:`predict`.
        schedule : float, default=None
            Value that scheduled parameters of the effects depend on.

        Returns
        -------
        Stepper
            ``step(u) -> y``, ``run(u)``, ``state``, ``copy()``.

        Raises
        ------
        NotImplementedError
            If the regressor has a memory and no ``stepper``, or an effect is not causal.
        ValueError
            If a parameter is invalid, or ``dt`` is not given and the records of the fit have
            different intervals.

        Examples
        --------
        >>> import numpy as np
        >>> from sklearn.linear_model import LinearRegression
        >>> from skhyst.compose import Corrected
        >>> from skhyst.linear import FirstOrderLag, FirstOrderLagOperator
        >>> u = np.random.default_rng(0).normal(size=1000).cumsum()
        >>> y, _ = FirstOrderLagOperator(0.05).run(2.0 * u + 1.0, 0.01)
        >>> model = Corrected(LinearRegression(), FirstOrderLag(), dt=0.01).fit(u[:, None], y)
        >>> stepper = model.stepper(u0=u[0])
        >>> bool(np.allclose(stepper.run(u), model.predict(u[:, None])))
        True
        """
        check_is_fitted(self)
        dt = used_interval(self, dt, "Corrected.stepper")
        row = rest_input(u0, initial_state, self.n_features_in_, "Corrected.stepper")
        if hasattr(self.estimator_, "stepper"):
            first = self.estimator_.stepper(dt, row, initial_state).compiled_step
        else:
            at = 0.0 if initial_state == "zero" else row
            first = compiled_regressor(self.estimator_, self.n_features_in_, dt, at)
        row[0] = Stepper(first).step(row if first.n_inputs else row[0])
        effects = with_params(informed(self.effects_, self), records_=self.records_)
        second = effects.stepper(dt, row, initial_state, schedule=schedule).compiled_step
        if second.n_inputs is None:
            step = CompiledSeries((first, second))
        elif first.n_inputs is None:
            step = CompiledColumnSeries((CompiledColumn((first,), 0, 0.0), second))
        else:
            step = CompiledColumnSeries((first, second))
        again = partial(copy(self).stepper, dt, u0, initial_state, schedule=schedule)
        inputs = input_signals(self, step.n_inputs)
        return Stepper(step, dt, inputs=inputs, result=Signal("response"), remake=again)


def _stretches(fold):
    """Return (start, stop) of each run of consecutive rows of one fold."""
    cuts = np.flatnonzero(np.diff(fold)) + 1
    return tuple(pairwise([0, *cuts.tolist(), len(fold)]))


def _as_first_column(p, columns):
    """Return the columns with a prediction in place of the first."""
    return np.column_stack([p, columns[:, 1:]])
