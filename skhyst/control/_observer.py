"""Estimation of the response of a device, from its model and from the reading of a sensor.

The input of the hysteresis is the drive, which is known, so that its state is known too. The
uncertain part is linear: motion of the linear stages after the hysteresis that the drive does not
explain, and a drifting output. A Kalman filter estimates both, see :mod:`skhyst.control._kalman`.
"""

from copy import copy, deepcopy
from functools import partial
from numbers import Real
from typing import Self

import numpy as np
from sklearn.base import BaseEstimator, MetaEstimatorMixin
from sklearn.utils.validation import check_is_fitted

from .._signals import input_signals
from .._sklearn import HasMethods, Interval, StrOptions, fit_context
from .._validation import fitted_interval, interval_of, used_interval
from ..base import (
    ParametricModel,
    input_at_rest,
    one_thread,
    read_data,
    warn_of_unmatched_response,
)
from ..exceptions import RecordError
from ..operators import (
    CompiledSeries,
    CompiledStep,
    Series,
    Signal,
    Stepper,
    SumOperator,
    run_records,
    split_disturbances,
)
from ..records import with_lost_rows
from ._compensator import _fitted
from ._kalman import (
    CompiledObserver,
    driven_by_noise,
    last_linear_stages,
    maximum_likelihood,
    stages_of,
    stationary,
    with_predicted_readings,
)
from ._unscented import Unscented


class Running:
    """Part of an estimator that is run sample by sample, by what it has compiled.

    A subclass has ``_start(*arguments)``, which returns that, and its method ``begun()`` the
    arguments with which the same goes on. These are copied and stored: no compiled code.
    """

    _running = _begun = None
    _changing = ()  # names of what changes from sample to sample besides

    def __getstate__(self):
        state = dict(super().__getstate__())
        state |= deepcopy({name: state[name] for name in self._changing if name in state})
        running = state.pop("_running", None)
        return state if running is None else state | {"_begun": running.begun()}

    def _going_on(self):
        """Return what runs, also if it began before this was copied or stored, or None."""
        if self._running is None and self._begun is not None:
            self._running = self._start(*self._begun)
        return self._running


class _Device(Stepper):
    """What an observer runs: from the drive at its first sample, or from a later state."""

    def __init__(self, compiled_step, u0, state=None):
        super().__init__(compiled_step)
        self.u0 = u0
        if state is not None:
            self.state = state

    def begun(self):
        return self.u0, self.state


class Observer(Running, MetaEstimatorMixin, BaseEstimator):
    r"""Estimate the response of a device from its model and a noisy reading, sample by sample.

    Parameters
    ----------
    model : estimator
        A parametric model of skhyst or a cascade of them.
    disturbance : {"random_walk", None}, default="random_walk"
        Additive disturbance of the response: a random walk, which follows slow drift.
    noise_std : float, default=None
        Standard deviation of the sensor's noise, units of the response. By default estimated.
    drift_std : float, default=None
        Standard deviation of the displacement of the random walk in 1 s, units of the response. By
        default estimated.
    process_std : float, default=None
        Standard deviation of the motion of the linear stages after the hysteresis that the drive
        does not explain, units of the response. By default estimated.
    method : {"auto", "linear", "unscented"}, default="auto"
        The stationary Kalman filter, in which a stage with hysteresis in its equation of motion is
        replaced by its linear mode without hysteresis; or the unscented one, which propagates the
        uncertainty through the step of that stage: some 100 us per sample, and no export to C. By
        default the latter if there is such a stage.

    Attributes
    ----------
    model_ : estimator
        The fitted model.
    noise_std_, drift_std_, process_std_ : float
        As given, or else the maximum-likelihood estimates from the residual of the records of the
        fit.
    estimate, disturbance_estimate : float
        Estimate of the response at the last sample, without noise, and of the random walk in it.
    innovation, innovation_std : float
        Last reading minus its prediction, and the standard deviation of this difference.
    state : ndarray
        Complete state of observer and model: a copy, which may be stored and assigned later.
    n_features_in_ : int

    See Also
    --------
    Monitor : Detects changes of the device.

    Notes
    -----
    The hysteresis, and all stages before the last linear ones, follow the drive alone. Variances
    too small to be estimated from ``n`` samples have a lower bound: that of the motion the variance
    of the noise over ``n``, that of the random walk's step per sample the variance of the noise
    over ``n**2``.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.control import Observer
    >>> from skhyst.linear import FirstOrderLag, FirstOrderLagOperator
    >>> rng = np.random.default_rng(0)
    >>> u = np.cumsum(rng.normal(size=2000)) / 10.0
    >>> y, _ = FirstOrderLagOperator(0.05).run(u, 0.01)
    >>> reading = y + 0.1 * rng.normal(size=2000)
    >>> observer = Observer(FirstOrderLag(dt=0.01), drift_std=0.1).fit(u[:, None], reading)
    >>> print(f"{observer.noise_std_:.2f}")
    0.10
    >>> for k in range(2000):  # a device that has shifted
    ...     estimate = observer.update(u[k], reading[k] + 0.5)
    >>> print(f"{estimate - y[-1]:.1f}")
    0.5
    """

    one_interval = False  # unless its model asks for one interval
    _changing = ("_recent",)

    _parameter_constraints = {
        "model": [HasMethods(["fit", "predict"])],
        "disturbance": [StrOptions({"random_walk"}), None],
        "noise_std": [Interval(Real, 0, None, closed="neither"), None],
        "drift_std": [Interval(Real, 0, None, closed="left"), None],
        "process_std": [Interval(Real, 0, None, closed="left"), None],
        "method": [StrOptions({"auto", "linear", "unscented"})],
    }

    def __init__(
        self,
        model,
        *,
        disturbance="random_walk",
        noise_std=None,
        drift_std=None,
        process_std=None,
        method="auto",
    ):
        self.model = model
        self.disturbance = disturbance
        self.noise_std = noise_std
        self.drift_std = drift_std
        self.process_std = process_std
        self.method = method

    @fit_context(prefer_skip_nested_validation=False)
    def fit(self, X, y) -> Self:
        """Fit the model if it is not fitted, and estimate the variances that are not given.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            Column 0 is the drive; the index carries records and time.
        y : array-like of shape (n_samples,)
            Reading of the sensor.

        Returns
        -------
        self

        Raises
        ------
        TypeError
            If the model is not a parametric model of skhyst.
        """
        options = {"reset": True, "dt": interval_of(self.model), "bridge": True}
        slices, _, response = read_data(self, X, y, **options)
        self.model_ = _fitted(self.model, X, y)
        if not isinstance(self.model_, ParametricModel):
            raise TypeError(
                "The 'model' parameter of Observer must be a parametric model of skhyst. "
                f"Got {self.model!r} instead."
            )
        residual = response - self.model_.predict(X)
        slices, residual, read = with_lost_rows(slices, residual)
        lost = np.zeros(len(residual), dtype=bool) if read is None else ~read
        records = [(residual[s.rows], s.dt, lost[s.rows]) for s in slices]
        rounding = (np.finfo(float).eps * np.abs(response).max()) ** 2 or np.finfo(float).tiny
        tail = last_linear_stages(self.model_.operator_)
        with one_thread():
            variances = maximum_likelihood(tail, records, self._given(), rounding)
        self.noise_std_, self.drift_std_, self.process_std_ = map(float, np.sqrt(variances))
        self.reset()
        return self

    def filter(self, X, y) -> np.ndarray:
        """Return the estimates of the response in records, each from rest.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            As for :meth:`fit`.
        y : array-like of shape (n_samples,)
            Reading of the sensor. The estimate at a sample uses the readings up to and including
            this sample.

        Returns
        -------
        ndarray of shape (n_samples,)
            Units of the response.
        """
        return np.concatenate(
            [self.stepper(dt, u[0]).run(rows)[read] for rows, u, dt, read in self._rows(X, y)]
        )

    def innovations(self, X, y) -> np.ndarray:
        """Return each reading minus its prediction.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            As for :meth:`fit`.
        y : array-like of shape (n_samples,)
            Reading of the sensor.

        Returns
        -------
        ndarray of shape (n_samples,)
            Units of the response.
        """
        parts = []
        for rows, u, dt, read in self._rows(X, y):
            compiled_step = self.compiled_step(dt, u[0])
            parts.append(compiled_step.innovating(compiled_step.state.copy())(rows)[read])
        return np.concatenate(parts)

    def compiled_step(self, dt=None, u0=0.0, operator=None) -> CompiledStep:
        """Return one step in plain arithmetic, as :func:`skhyst.export.to_c` writes it.

        Parameters
        ----------
        dt : float, default=None
            Sampling interval in s; by default that of the records of the fit.
        u0 : float or array-like of shape (n_inputs,), default=0.0
            Drive at which the device has rested.
        operator : Operator, default=None
            Used instead of the model's operator, with the same structure and other parameters; the
            filter stays that of the model.

        Returns
        -------
        CompiledStep
            Its input is a row of the drive (with the further columns that the model reads) and the
            reading, its output is the estimate.

        Raises
        ------
        ValueError
            If a parameter is invalid, or ``dt`` is not given and the records of the fit have
            several sampling intervals.
        """
        check_is_fitted(self)
        operator = self.model_.operator_ if operator is None else operator
        u0 = input_at_rest(self.model_, u0, None, "Observer.compiled_step")
        return self._compiled_step(self._interval(dt), u0, operator)

    def stepper(self, dt=None, u0=0.0) -> Stepper:
        """Return the observer as a device that is run by rows of drive and reading.

        Unlike :meth:`update` and :meth:`filter`, it compares no reading with the model: a reading
        beyond those of the fit, as in a smaller unit, is in its ``status`` as ``"extrapolated"``.

        Parameters
        ----------
        dt : float, default=None
            Sampling interval in s; by default that of the records of the fit.
        u0 : float or array-like of shape (n_inputs,), default=0.0
            Drive at which the device has rested.

        Returns
        -------
        Stepper
            ``step([u, y]) -> estimate``, ``run(rows)``, ``state``, ``copy()``.
        """
        step = self.compiled_step(dt, u0)
        inputs = input_signals(self.model_, None if step.n_inputs == 2 else step.n_inputs - 1)
        return Stepper(
            step,
            self._interval(dt),
            inputs=(*inputs, Signal("reading", *getattr(self, "_response_range", ()))),
            result=Signal("estimate of the response"),
            remake=partial(copy(self).stepper, dt, u0),
        )

    def reset(self) -> Self:
        """Discard all readings: the next sample is the first one of a device at rest.

        Returns
        -------
        self
        """
        self._running = self._begun = None
        return self

    def update(self, u, y) -> float:
        """Process the drive and the reading at the next sample, and return the estimate.

        The first sample after the fit or a :meth:`reset` is that of a device at rest. Whenever as
        many samples have passed as the shortest record of the fit has, readings that do not follow
        the model, such as those in another unit, are warned of.

        Parameters
        ----------
        u : float, or array-like of shape (n_inputs,)
            Drive, with the further columns that the model reads.
        y : float
            Reading of the sensor.

        Returns
        -------
        float
            Units of the response.

        Raises
        ------
        ValueError
            If a number is not finite, or the records of the fit have several sampling intervals;
            the state is unchanged then.
        """
        check_is_fitted(self)
        device = self._going_on()
        if device is None:
            device, self._recent = self._start(u), []
        self.estimate = device.step(np.append(u, y))
        self._running = device
        predicted = device.compiled_step.predicted(self.estimate, device.state)
        self._recent.append((predicted, float(y)))
        if len(self._recent) >= min(record.n_samples for record in self.model_.records_):
            self._compare(*np.transpose(self._recent))
            self._recent = []
        return self.estimate

    @property
    def state(self):
        return self._device().state

    @state.setter
    def state(self, values):
        self._device().state = values

    @property
    def disturbance_estimate(self) -> float:
        return self._last()[0]

    @property
    def innovation(self) -> float:
        return self._last()[1]

    @property
    def innovation_std(self) -> float:
        return self._last()[2]

    def _last(self):
        device = self._device()
        return [float(value) for value in device.compiled_step.read(device.state)]

    def _rows(self, X, y):
        """Yield (rows of drive and reading, drive, sampling interval in s, mask of valid rows).

        ``X`` and ``y`` are as for :meth:`filter`. A lost row is included, with the prediction in
        place of its reading.
        """
        check_is_fitted(self)
        slices, columns, y = read_data(self, X, y, reset=False, bridge=True)
        slices, columns, y, read = with_lost_rows(slices, columns, y)
        read = np.ones(len(y), dtype=bool) if read is None else read
        signal, schedules = self.model_.operator_input(columns, slices)
        state = self.model_.free_run_state
        run = run_records(self.model_.operator_, signal, slices, state, schedules)
        for s in slices:
            self._compare(run[s.rows], np.where(read[s.rows], y[s.rows], np.nan))
            rows, u = np.column_stack([signal[s.rows], y[s.rows]]), signal[s.rows]
            if not read[s.rows].all():
                step = self.compiled_step(s.dt, u[0])
                rows = with_predicted_readings(
                    step.innovating, step.state.copy(), rows, ~read[s.rows]
                )
            yield rows, u, self._interval(s.dt), read[s.rows]

    def _compare(self, run, known):
        """Warn if readings, NaN where there is none, have little to do with the model's run."""
        # the random walk takes constants
        walk = 0.0 if self.disturbance is None else np.nanmean(known - run)
        warn_of_unmatched_response(self.model_, run + walk, known, stacklevel=4)

    def _start(self, u0, state=None):
        return _Device(self.compiled_step(None, u0), u0, state)

    def _device(self):
        device = self._going_on()
        if device is None:
            raise AttributeError("The Observer has seen no sample: call 'update' before.")
        return device

    def _interval(self, dt):
        used = used_interval(self, dt, "Observer.compiled_step")
        fitted_dt, unit = fitted_interval(self)
        if unit == "sample" and used != fitted_dt and self.drift_std is None and self.drift_std_:
            raise RecordError(
                "The Observer was fitted without a time, so that the random walk that it has "
                f"estimated is per sample. Got the interval {used:g} s instead: fit it with a time "
                "index or 'dt', or give a 'drift_std'."
            )
        return used

    def _compiled_step(self, dt, u0, operator):
        driven, disturbances = split_disturbances(operator)
        # the filter's gains belong to the model, even if another operator predicts the response
        tail, state = last_linear_stages(self.model_.operator_), self.model_.free_run_state
        variances = self.noise_std_**2, self.drift_std_**2, self.process_std_**2
        in_motion = not all(stage.signal_linear for stage in stages_of(driven)[-len(tail) :])
        if not tail or self.method == "linear" or (self.method == "auto" and not in_motion):
            law = stationary(tail, dt, *variances)
            model = operator.compiled_step(dt, operator.init(u0, state))
            return CompiledObserver((model, law.compiled_step()), law.variance)
        # hysteresis within the motion: uncertainty is propagated through the last stages' steps
        whole = Series(tuple("" for _ in stages_of(driven)), stages_of(driven))
        steps = [
            s.compiled_step(dt, initial)
            for s, initial in zip(whole.stages, whole.init(u0, state), strict=True)
        ]
        front, core = steps[: -len(tail)], steps[-len(tail) :]
        others = SumOperator(tuple("" for _ in disturbances), disturbances)
        spread = self.process_std_ * driven_by_noise(tail, dt)[3]
        return Unscented(
            CompiledSeries(tuple(front)),
            CompiledSeries(tuple(core)),
            others.compiled_step(dt, others.init(u0)),
            spread,
            variances[1] * dt,
            variances[0],
        )

    def _given(self):
        drift = 0.0 if self.disturbance is None else self.drift_std
        given = (self.noise_std, drift, self.process_std)
        return [None if value is None else value**2 for value in given]
