"""Base of the autoregressive models: lags, records, initial outputs, simulation, prediction."""

import warnings
from abc import abstractmethod
from copy import copy
from functools import partial
from numbers import Integral, Real
from typing import Self

import numpy as np
from sklearn.base import BaseEstimator
from sklearn.metrics import r2_score
from sklearn.utils.validation import check_is_fitted
from threadpoolctl import threadpool_limits

from .._documentation import inherit_documentation
from .._signals import input_signals
from .._sklearn import (
    Interval,
    StrOptions,
    check_feature_names_in,
    fit_context,
)
from .._validation import (
    ScoredMixin,
    fitted_interval,
    known_response,
    read_weights,
    refuse_large,
    refuse_other_unit,
    refuse_several,
    refuse_std,
    rest_input,
    warn_beyond,
    with_unread,
)
from ..base import read_data
from ..exceptions import ConvergenceWarning, DivergenceWarning, RecordError
from ..operators import Signal, Stepper
from ..preprocessing import SampleRules, lagged_columns, read_lag_table, read_lags
from ..records import MISMATCH, valid_interval, with_lost_rows
from ._initial_outputs import estimate_history, fit_line, rest_outputs
from ._runs import Lags, Start, free_runs, runs_ahead
from ._streaming import compiled_lags, n_stored_rows

_BOUND = 100.0  # an output this many ranges of the response beyond its largest has diverged


class AutoregressiveRegressor(ScoredMixin, BaseEstimator):
    """Base of the models that predict an output from past inputs and past outputs.

    A subclass gives :meth:`_fit_records`, :meth:`_one_step` and ``_step``: the model in a compiled
    form, with ``run(start, bound)``, or None.

    Parameters
    ----------
    input_lags : int, array-like of int, or dict, default=(0, 1)
        Lags of the inputs in samples, for all columns of ``X``. A number ``n`` stands for
        ``0, 1, ..., n``. A dict maps columns, by position or name, to lags of their own.
    output_lags : int or array-like of int, default=(1,)
        Lags of the output in samples. A number ``n`` stands for ``1, ..., n``; without lags the
        model is a static function of the lagged inputs.
    initial_output : {"rest", "measured", "estimate"}, float or array-like, default="rest"
        Outputs before a record. Inputs before it are at rest at their first values.

        - ``"rest"``: the equilibrium output of the model for the record's first inputs.
        - ``"measured"``: if `predict` or `score` gets ``y``, the first samples, as many as the
          longest lag, are the measured ones, and the run starts after them.
        - ``"estimate"``: if `predict` or `score` gets ``y``, those with which the free run fits the
          first samples of the record best.
        - numbers in units of the response: the output before each record, or one number per lag:
          ``y(-1), y(-2), ...``.

        Where there is no ``y``, ``"measured"`` and ``"estimate"`` start from rest.
    dt : float or None, default=None
        Sampling interval in s of data without a time index; None: unknown in ``fit``, later that of
        the fit. Lags are in samples: another interval than that of the fit is refused.
    drive : str, int or None, default=None
        Name or number of the column of X that is the drive; None: column 0.

    Attributes
    ----------
    input_lags_ : tuple of (int, int)
        Column and lag of each lagged input.
    output_lags_ : tuple of int
        Lags of the output.
    lag_names_ : list of str
        Names of the lagged signals, the regressors of the model, such as ``drive(k-1)``.
    initial_outputs_ : ndarray of shape (n_records, longest output lag)
        Outputs before the records of the fit, the latest last; with ``"estimate"`` only.
    bound_ : float
        Magnitude at which outputs are cut off: the largest in the fit plus 100 times their range.
    output_range_ : tuple of (float, float)
        Range of the response in the fit.
    n_features_in_ : int
        Number of columns of ``X``.
    records_ : tuple of RecordSlice
        The records of the fit.
    dt_ : float
        Sampling interval of the fit, in ``time_unit_``.
    time_unit_ : {"s", "sample"}
        "sample" if the data of the fit had no interval.
    drive_range_ : tuple of (float, float)
        Smallest and largest drive in the fit, units of the drive.
    drive_rate_ : float
        Fastest change of the drive between two samples in the fit, units of the drive per s.
    """

    one_interval = True  # lags are in samples
    _bridges = True  # a fit bridges lost rows

    _parameter_constraints = {
        "input_lags": [Interval(Integral, 0, None, closed="left"), "array-like", dict],
        "output_lags": [Interval(Integral, 0, None, closed="left"), "array-like"],
        "initial_output": [
            StrOptions({"rest", "measured", "estimate"}),
            Interval(Real, None, None, closed="neither"),
            "array-like",
        ],
        "dt": [Interval(Real, 0, None, closed="neither"), None],
        "drive": [str, Integral, None],
    }

    def __init_subclass__(cls, **options):
        super().__init_subclass__(**options)
        inherit_documentation(cls)

    @abstractmethod
    def _fit_records(self, X, y, records, weights, read):
        """Fit validated data; lags and ``bound_`` are known.

        Samples of weight zero have no valid response; rows that are not ``read`` have neither
        response nor inputs.
        """

    @abstractmethod
    def _one_step(self, Z):
        """Return the next outputs (n,) for rows of lagged inputs and lagged outputs."""

    def _widen(self, X, records, *, reset=False):
        """Return the inputs, with the columns that a model adds, and the names of all columns.

        With ``reset``, a subclass also adds the lags of its own columns to ``input_lags_``.
        """
        return X, check_feature_names_in(self, None)

    @property
    def _lags(self):
        return Lags(self.input_lags_, self.output_lags_, self._n_columns)

    @fit_context(prefer_skip_nested_validation=False)
    def fit(self, X, y, sample_weight=None) -> Self:
        """Fit the model.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            Inputs; the index carries records and time.
        y : array-like of shape (n_samples,)
            Response.
        sample_weight : array-like of shape (n_samples,), default=None
            Nonnegative weights: the squared error of each sample is multiplied by its weight, as if
            the sample occurred that many times. Unless all are zero or whole numbers, the smallest
            of them 1, they are relative, such as inverse variances: their scale does not matter,
            and the standard deviation of the noise is that of a sample of mean weight. A response
            of weight zero is not read: one step ahead, samples with it among their past outputs are
            left out.

        Returns
        -------
        self
        """
        given = X
        y = with_unread(y, sample_weight)
        self.records_, X, y = read_data(self, X, y, reset=True, bridge=self._bridges)
        if not np.ptp(X, axis=0).any():
            warnings.warn(
                f"The drive does not move: it is {X[0, 0]:g} in every sample, which does not "
                f"determine how {type(self).__name__} responds to it.",
                ConvergenceWarning,
                stacklevel=3,
            )
        weights = read_weights(sample_weight, given)
        records, X, y, weights, read = with_lost_rows(self.records_, X, y, weights)
        read = np.ones(len(y), dtype=bool) if read is None else read
        weights = np.where(read, weights, 0.0)
        if not weights.all():
            y = y.copy()
            for record in records:
                y[record.rows] = _read_values(y[record.rows], weights[record.rows] > 0.0)
        self.input_lags_ = read_lag_table(self, "input_lags", range(X.shape[1]))
        self.output_lags_ = tuple(read_lags(self, "output_lags", self.output_lags, 1))
        X, names = self._widen(X, records, reset=True)
        self._n_columns = X.shape[1]
        self.lag_names_ = [shifted(names[column], lag) for column, lag in self.input_lags_]
        self.lag_names_ += [shifted("y", lag) for lag in self.output_lags_]
        self.output_range_ = (float(y.min()), float(y.max()))
        largest = max(abs(value) for value in self.output_range_)
        self.bound_ = largest + _BOUND * (self._span() or largest or 1.0)
        self._line = fit_line(X, y)
        self._given_history()
        self._fit_records(X, y, records, weights, read)
        if self.initial_output == "estimate":
            starts = self.starting_values(X, records, y)
            self.initial_outputs_ = np.array([start.history for start in starts])
        return self

    def predict(self, X, y=None, horizon=None, *, y_start=None, return_std=False) -> np.ndarray:
        """Return the free run (simulation), or the prediction ``horizon`` steps ahead.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            Inputs.
        y : array-like of shape (n_samples,), optional
            Measured response: for the initial outputs, if `initial_output` requires it, and for a
            `horizon`.
        horizon : int, optional
            Steps ahead: sample ``k`` is predicted from the response measured up to
            ``k - horizon``. By default the free run, which uses the inputs alone.
        y_start : array-like of shape (n_samples,), default=None
            Measured response up to a sample of each record, NaN after it: the free run continues
            from there, and known samples are returned as they are. Replaces ``y``.
        return_std : bool, default=False
            Must be False: the covariance of the free run of such a model is not known.

        Returns
        -------
        ndarray of shape (n_samples,)
            Units of the response, always finite. Outputs that are more than 100 times the range of
            the response in ``fit`` beyond its largest magnitude are cut off there, with a
            :class:`~skhyst.exceptions.DivergenceWarning`.
        """
        check_is_fitted(self)
        refuse_std(self, return_std, "whose past outputs are inputs")
        if y_start is not None and not (y is None and horizon is None):
            raise ValueError(
                f"The 'y_start' parameter of {type(self).__name__}.predict must be None where 'y' "
                "or 'horizon' is given."
            )
        if horizon is not None:
            if not isinstance(horizon, Integral) or horizon < 1:
                raise ValueError(
                    f"The 'horizon' parameter of {type(self).__name__}.predict must be an integer "
                    f"number of samples, at least 1. Got {horizon!r} instead."
                )
            if y is None:
                raise ValueError(
                    f"The 'y' parameter of {type(self).__name__}.predict must be the measured "
                    "response where 'horizon' is given. Got None instead."
                )
        known = [] if y_start is None else [known_response(self, X, y_start)]
        given = () if y is None else (y,)
        bridge = horizon is None or self._bridges
        records, X, y = read_data(self, X, *given, reset=False, bridge=bridge)
        given = known + [signal for signal in (y,) if signal is not None]
        records, X, *given, read = with_lost_rows(records, X, *given)
        y = given[0] if given else None
        refuse_large("X", X)
        warn_beyond(self, X, set(range(X.shape[1])), linear=True)
        X, _ = self._widen(X, records)
        if y_start is None:
            starts = self.starting_values(X, records, y)
        else:
            starts = [self._after_known(X[record.rows], y[record.rows]) for record in records]
        if horizon is None:
            parts, good = self._free_runs(starts)
        else:
            if read is not None:  # predictions stand in for lost measurements
                lost = [~read[record.rows] for record in records]
                starts = list(map(self._with_lost_outputs, starts, lost))
            parts, good = self._runs_ahead(starts, int(horizon))
        if not good:
            warnings.warn(
                "The simulation diverged; outputs far beyond the range of the response in fit were "
                "cut off.",
                DivergenceWarning,
                stacklevel=2,
            )
        result = np.empty(len(X))
        for record, start, part in zip(records, starts, parts, strict=True):
            values = result[record.rows]
            if start.n_past:
                values[: start.n_past] = y[record.rows][: start.n_past]
            values[start.n_past :] = part
        return result if read is None else result[read]

    def predict_one_step(self, X, y) -> np.ndarray:
        """Return the prediction one step ahead, from past measured responses.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            Inputs.
        y : array-like of shape (n_samples,)
            Measured response.

        Returns
        -------
        ndarray of shape (n_samples,)
            Units of the response.
        """
        return self.predict(X, y, horizon=1)

    def score(self, X, y, sample_weight=None) -> float:
        """Return R2 of the free run.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            Inputs.
        y : array-like of shape (n_samples,)
            Measured response; the initial outputs are taken from it if `initial_output` requires
            it. A scorer given by name, such as ``scoring="r2"``, calls ``predict(X)`` without it.
        sample_weight : array-like of shape (n_samples,), optional
            Weights.

        Returns
        -------
        float
        """
        refuse_other_unit(self, y)
        return r2_score(y, self.predict(X, y), sample_weight=sample_weight)

    def stepper(self, dt=None, u0=0.0, initial_state=None) -> Stepper:
        """Return the fitted model as a simulated device that is stepped sample by sample.

        Parameters
        ----------
        dt : float, default=None
            Sampling interval in s; it must be that of the fit, which is the default.
        u0 : float or array-like of shape (n_inputs,), default=0.0
            Inputs at which the device is at rest before the first sample.
        initial_state : {"rest", "zero"}, default=None
            Inputs and outputs before the first sample; by default those of :meth:`predict` without
            ``y``.

        Returns
        -------
        Stepper
            ``step(u) -> y``, ``run(u)``, ``state``, ``copy()``. Outputs are cut off as in
            :meth:`predict`.

        Raises
        ------
        ValueError
            If a parameter is not as above, or ``dt`` is not that of the fit.

        Examples
        --------
        >>> import numpy as np
        >>> from skhyst.autoregressive import NARXRegressor
        >>> u = np.sin(np.arange(200) / 5.0) + np.sin(np.arange(200) / 17.0)
        >>> y = np.convolve(u, 0.2 * 0.8 ** np.arange(50))[:200]
        >>> model = NARXRegressor().fit(u[:, None], y)
        >>> stepper = model.stepper(u0=u[0])
        >>> bool(np.allclose([stepper.step(value) for value in u], model.predict(u[:, None])))
        True
        """
        check_is_fitted(self)
        (interval, _), caller = fitted_interval(self), f"{type(self).__name__}.stepper"
        if dt is not None and not np.isclose(valid_interval(dt, caller), interval, rtol=MISMATCH):
            raise ValueError(
                f"The 'dt' parameter of {caller} must be {interval:g} s, that of the records of "
                f"the fit: the lags are in samples. Got {dt!r} instead."
            )
        levels = rest_input(u0, initial_state, self.n_features_in_, caller)
        rules, positions, inputs = self._row(0.0 * levels if initial_state == "zero" else levels)
        history = np.zeros(self._n_outputs())
        if initial_state is None and self._start_kind() == "given":
            history = self._given_history()
        elif initial_state != "zero":
            (history,) = self._rest(np.array([[rules.row[place] for place, _ in positions]]))
        parts = inputs, self.output_lags_, self.bound_, rules, history
        call, name = self._one_step, type(self).__name__
        step = compiled_lags(self._plain_step(), *parts, call, name)
        return Stepper(
            step,
            interval,
            inputs=input_signals(self, step.n_inputs),
            result=Signal("response"),
            remake=partial(copy(self).stepper, dt, u0, initial_state),
        )

    def stepper_from(self, X, y) -> Stepper:
        """Return the fitted model as a device that continues from a known record.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            One record, as for :meth:`fit`.
        y : array-like of shape (n_samples,)
            Its response, up to a sample, NaN after it.

        Returns
        -------
        Stepper
            Its next ``step(u)`` is the sample after the last one of X.

        Raises
        ------
        ValueError
            If X has several records.
        """
        check_is_fitted(self)
        y = known_response(self, X, y)
        records, X, _ = read_data(self, X, reset=False, bridge=True)
        records, X, y, _ = with_lost_rows(records, X, y)
        refuse_several(self, records)
        start = self._after_known(self._widen(X, records)[0], y)
        drive = X[:, 0] if X.shape[1] == 1 else X
        stepper = self.stepper(u0=X[0])
        stepper.run(drive[: start.n_past])
        if start.n_past and len(start.history):
            rules, _, inputs = self._row(X[0])
            first, state = n_stored_rows(inputs, rules) * len(rules.row), stepper.state
            state[first : first + len(start.history)] = start.history[::-1]
            stepper.state = state
        stepper.run(drive[start.n_past :])
        return stepper

    def __sklearn_tags__(self):
        tags = super().__sklearn_tags__()
        tags.regressor_tags.poor_score = True  # the free run on data without dynamics
        return tags

    # ------------------------------------------------------------------ for the models themselves

    def _places(self, rules):
        """Return position and lag of each column; added columns get rules in ``rules``."""
        return [(j, 0) for j in range(self.n_features_in_)]

    def _row(self, levels):
        """Return the rules of a row at rest, the places of columns, and those of input signals."""
        rules = SampleRules(levels)
        positions = self._places(rules)
        inputs = [(positions[j][0], positions[j][1] + lag) for j, lag in self.input_lags_]
        return rules, positions, inputs

    def _plain_step(self):
        """Return the one-step model in the user's units, or None if it has no compiled form."""
        return self._step

    def _span(self):
        return self.output_range_[1] - self.output_range_[0]

    def _start_kind(self):
        return self.initial_output if isinstance(self.initial_output, str) else "given"

    def _n_outputs(self):
        """Return the number of outputs before a record that a run needs."""
        return max(self.output_lags_, default=0)

    def _n_skipped(self):
        """Return the number of first samples whose lagged signals precede their record."""
        return max(self._n_outputs(), *(lag for _, lag in self.input_lags_))

    def _regression(self, X, y, records, weights, read):
        """Return lagged signals, outputs and weights of the samples whose past is known.

        Signals are (n, n_signals), outputs and weights (n,). Left out are the first samples of a
        record, whose past lies before it, and those with lost rows in their past.
        """
        skip, parts = self._n_skipped(), []
        for record in records:
            if record.n_samples <= skip:
                continue
            inputs, response, counts = X[record.rows], y[record.rows], weights[record.rows]
            n = len(response)
            past = [response[skip - lag : n - lag] for lag in self.output_lags_]
            signals = np.column_stack([lagged_columns(inputs, self.input_lags_, skip), *past])
            known = counts[skip:] > 0.0
            for lag in self.output_lags_:
                known = known & (counts[skip - lag : n - lag] > 0.0)
            for _, lag in self.input_lags_:
                known = known & read[record.rows][skip - lag : n - lag]
            parts.append((signals[known], response[skip:][known], counts[skip:][known]))
        if not parts:
            raise RecordError(
                f"A record must be longer than the longest lag, which is {skip} samples. Got at "
                f"most {max(record.n_samples for record in records)} samples per record instead."
            )
        if not any(len(target) for _, target, _ in parts):
            raise RecordError(
                "At least one sample and all samples at its lags must have a weight above zero. "
                f"Got none instead, with lags up to {skip} samples: too many rows are lost or of "
                "weight zero."
            )
        return parts

    def _with_lost_outputs(self, start, lost):
        """Return a start whose lost outputs are those of the free run from the ones before."""
        n, outputs = len(start.history), np.concatenate([start.history, start.measured])
        edges = np.flatnonzero(np.diff(lost[start.n_past :], prepend=False, append=False))
        for a, b in edges.reshape(-1, 2):
            first, last = start.n_past + a, start.n_past + b
            (run,), _ = self._free_runs([Start(start.inputs[:last], first, outputs[a : a + n])])
            outputs[n + a : n + b] = run
        return start._replace(measured=outputs[n:])

    def starting_values(self, X, records, y=None, weights=None):
        """Return where the run over each record starts.

        Parameters
        ----------
        X : ndarray of shape (n_samples, n_inputs)
            Inputs.
        records : sequence of RecordSlice
            Rows of each record.
        y : ndarray of shape (n_samples,), default=None
            Measured outputs, if they are known.
        weights : ndarray of shape (n_samples,), default=None
            Of their squared errors.

        Returns
        -------
        list of Start
            One per record.
        """
        inputs = [X[record.rows] for record in records]
        measured = [None if y is None else y[record.rows] for record in records]
        counts = [None if weights is None else weights[record.rows] for record in records]
        kind = self._start_kind()
        if kind == "measured" and y is not None:
            return list(map(self._after_past, inputs, measured, counts))
        if kind == "given":
            histories = [self._given_history()] * len(records)
        elif kind == "estimate" and y is not None:
            histories = [
                estimate_history(self._free_runs, u, out, self._n_outputs(), self._span() or 1.0)
                for u, out in zip(inputs, measured, strict=True)
            ]
        else:
            histories = self._rest(np.array([u[0] for u in inputs]))
        return [
            Start(u, 0, history, *data)
            for u, history, *data in zip(inputs, histories, measured, counts, strict=True)
        ]

    def _after_past(self, inputs, measured, weights=None):
        """Return a start after the first samples, as many as the longest lag."""
        n_past, n_outputs = min(self._n_skipped(), len(inputs)), self._n_outputs()
        history = measured[n_past - n_outputs : n_past] if n_past >= n_outputs else [0] * n_outputs
        weights = None if weights is None else weights[n_past:]
        return Start(inputs, n_past, np.asarray(history, dtype=float), measured[n_past:], weights)

    def _after_known(self, inputs, measured):
        """Return a start after the first samples, those whose output is known."""
        unknown = np.flatnonzero(~np.isfinite(measured))
        n_past = int(unknown[0]) if len(unknown) else len(measured)
        (history,) = self._rest(inputs[:1])
        if n_past == 0 and self._start_kind() == "given":
            history = self._given_history()
        history = np.concatenate([history, measured[:n_past]])
        return Start(inputs, n_past, history[len(history) - self._n_outputs() :])

    def _rest(self, firsts):
        """Return the outputs at rest for each row of inputs, (n_rows, longest output lag)."""
        levels = np.zeros(len(firsts))
        if self.output_lags_:
            levels = rest_outputs(
                self._one_step,
                firsts[:, [column for column, _ in self.input_lags_]],
                len(self.output_lags_),
                self._line[0] + firsts @ self._line[1:],
                *self.output_range_,
            )
        return np.repeat(levels[:, None], self._n_outputs(), axis=1)

    def _given_history(self):
        """Return the initial outputs that the user gave, the latest last, or None."""
        if self._start_kind() != "given":
            return None
        given = np.asarray(self.initial_output, dtype=float)
        n_outputs = self._n_outputs()
        if given.ndim == 0:
            return np.full(n_outputs, float(given))
        if given.shape != (n_outputs,) or not np.isfinite(given).all():
            raise ValueError(
                f"The 'initial_output' parameter of {type(self).__name__} must be one finite value "
                f"or {n_outputs} of them, y(-1), y(-2), ... Got {self.initial_output!r} instead."
            )
        return given[::-1].copy()

    def _free_runs(self, starts):
        """Return the free run from each start, and whether all stayed within ``bound_``."""
        if self._step is None:
            # a batch has one row per record: threads would cost more than they save
            with threadpool_limits(1):
                return free_runs(self._one_step, starts, self._lags, self.bound_)
        runs = [self._run(start) for start in starts]
        return [y for y, _ in runs], all(good for _, good in runs)

    def _run(self, start):
        """Return the compiled free run, and whether all of it stayed within ``bound_``."""
        return self._step.run(start, self.bound_)

    def _runs_ahead(self, starts, horizon):
        """Return the predictions ``horizon`` steps ahead, and whether all stayed within bounds."""
        return runs_ahead(self._one_step, starts, horizon, self._lags, self.bound_)


def _read_values(y, known):
    """Return responses with unknown values on a straight line."""
    rows = np.arange(len(y))
    return y if known.all() or not known.any() else np.interp(rows, rows[known], y[known])


def shifted(name, lag):
    return f"{name}(k-{lag})" if lag else f"{name}(k)"
