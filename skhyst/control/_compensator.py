r"""The drive under which a device follows a reference: inversion of its model.

Stage by stage, from the last to the first, the desired output is converted to the input that gives
it: by the stage's own inverse, by a root per sample, or, for dynamics, by stable inversion, over a
whole record or with a preview of the reference (see :func:`skhyst.operators.inverse_of`).

The remaining error is reduced by iteration. With an approximate inverse :math:`I`, in which a stage
with hysteresis in its equation of motion is replaced by its linear mode without hysteresis, and the
response :math:`y` to the drive :math:`u`,

.. math:: u \leftarrow u + s \, (I[r] - I[y]), \qquad 0 < s \le 1

whose fixed point is a drive under which the response is the reference :math:`r`, whatever the
inverse (iterative learning: Arimoto, Kawamura and Miyazaki, *Journal of Robotic Systems*, 1984).
The trials so far are combined to speed it up (Anderson, *Journal of the ACM*, 1965).
Each step starts from the best trial; where it has made the error larger, half of it is tried. On
the model the compensation becomes as exact as the model is, and on the device as exact as its
sensor.

The response alone does not determine the drive. A mass hardly responds to a drive that changes its
sign from sample to sample. With its sampling zero near -3.73, a component of the drive that grows
by that factor each sample towards the end of a record is not visible in the response at all. Three
measures keep such components out of the drive, whatever its limits are. On the model, a record is
extended by a rest at the last value of its reference, until later values have no effect. A
combination of trials is penalised by the change of its drive, so that no component of which the
response shows little is used (regularisation: Tikhonov, *Soviet Mathematics Doklady*, 1963). And a
trial with a larger drive is kept only if the error falls by more than one standard error of its
root mean square.
"""

import warnings
from dataclasses import replace
from functools import partial
from numbers import Integral, Real
from typing import Literal, Self, overload

import numpy as np
import pandas as pd
from scipy.signal import butter, sosfiltfilt
from sklearn.base import BaseEstimator, MetaEstimatorMixin, clone
from sklearn.exceptions import NotFittedError
from sklearn.utils.validation import check_is_fitted

from .._signals import drive_signal
from .._sklearn import (
    HasMethods,
    Interval,
    StrOptions,
    fit_context,
    validate_parameter_constraints,
)
from .._validation import (
    finite_number,
    finite_numbers,
    fitted_interval,
    interval_of,
    read_slices,
    refuse_large,
    refuse_other_unit,
    used_interval,
)
from ..base import ParametricModel, read_data
from ..exceptions import ReachWarning, RecordError
from ..linear import DelayOperator, GainOperator
from ..operators import (
    ROUNDING,
    CompiledSeries,
    Series,
    Signal,
    Stepper,
    add_disturbances,
    inverse_of,
    split_disturbances,
)
from ..records import fill_lost_rows, record_names, valid_interval
from ._drive_limits import DriveLimits

_ORDER = 4  # of the low-pass, run forwards and backwards
_SMALLEST = 2.0**-6  # fraction of a step below which the iteration has converged
# Fraction of a change of the drive that must be visible in the response; what is less visible is
# damped in a combination of trials. With an exact inverse the fraction is one, with a stiffness
# wrong by a factor of ten a tenth. A step is at most (1 + 1 / (2 * this)) of the requested change.
_VISIBLE = 0.1


class InverseCompensator(MetaEstimatorMixin, BaseEstimator):
    r"""The drive that makes a device follow a reference, from a model of the device.

    Parameters
    ----------
    model : estimator
        A parametric model of skhyst or a cascade of them, of one input. With ``method="learned"``
        any regressor: it is fitted from the response to the drive, as the inverse compensator of
        the inchworm motor is for which :class:`~skhyst.neural.SCNRegressor` was made.
    method : {"auto", "learned"}, default="auto"
        Invert the model, or learn its inverse.
    bandwidth : float, default=None
        Cut-off frequency in Hz of the low-pass filter of the reference and of the errors used for
        learning (Butterworth of order 4, forwards and backwards). By default there is no low-pass.
    drive_limits : {"fit"}, tuple of (float, float) or None, default="fit"
        Smallest and largest drive, its units. By default those in the records of the model's fit
        (``drive_range_``). None: no limits.
    rate_limit : {"fit"}, float or None, default="fit"
        Fastest change of the drive, its units per s. By default the fastest in the records of the
        model's fit (``drive_rate_``). None: no limit.
    limit_margin : float, default=0.0
        Fraction of the range of the fit by which its limits are widened at each end, and of its
        rate by which the rate limit is raised.
    max_residual : float, default=0.05
        Largest error of the model's response at a sample without a warning, as a fraction of the
        range of the reference. The command line writes no drive with a larger error.
    tol : float, default=1e-9
        Error of the model's response, relative to the range of the reference, at which the
        iteration stops.
    max_iter : int, default=50
        Largest number of iterations on the model.

    Attributes
    ----------
    model_ : estimator
        The fitted model.
    errors_ : list of float
        Root mean square error of each trial of the last :meth:`refine`, units of the response.
    n_features_in_ : int
    drive_range_, drive_rate_ : tuple of (float, float), float
        Range and largest rate of the drive in the records of the model's fit, as for
        :class:`~skhyst.base.ParametricModel`; missing if the model has none.
    drive_limits_, rate_limit_ : tuple of (float, float), float
        Limits in force, units of the drive and these per s; infinite if there are none.

    Warns
    -----
    ReachWarning
        If limits clip the drive (with the percentage of the samples); if there is no limit and the
        drive leaves the range or the rate of the fit, or these are not known; if a stage cannot
        give the output that is required of it (with its name and the value); if the response to the
        drive misses the reference by more than ``max_residual`` allows.

    See Also
    --------
    FeedforwardPI : A controller around it.
    skhyst.operators.inverse_of : The inverse of an operator.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.compose import Cascade
    >>> from skhyst.control import InverseCompensator
    >>> from skhyst.hysteresis import PrandtlIshlinskii, PrandtlIshlinskiiOperator
    >>> from skhyst.linear import SecondOrderMode, SecondOrderModeOperator
    >>> time = np.arange(2000) * 1e-3
    >>> u = 5.0 * np.sin(7.0 * time) * np.sin(31.0 * time)
    >>> plays = PrandtlIshlinskiiOperator(np.arange(4.0), np.array([1.0, 0.3, 0.2, 0.1]))
    >>> y, _ = SecondOrderModeOperator(300.0, 0.05).run(plays.run(u, 1e-3)[0], 1e-3)
    >>> model = Cascade([("plays", PrandtlIshlinskii(5)), ("mode", SecondOrderMode())], dt=1e-3)
    >>> compensator = InverseCompensator(model).fit(u[:, None], y)
    >>> reference = 4.0 * np.sin(20.0 * np.clip(time - 0.02, 0.0, 0.6 * np.pi)) ** 2
    >>> drive = compensator.predict(reference[:, None])
    >>> drive, residual = compensator.predict(reference[:, None], return_residual=True)
    >>> bool(np.abs(residual).max() < 1e-6)
    True

    The same, sample by sample, with a preview of the reference:

    >>> preview = compensator.preview()
    >>> stepper = compensator.stepper()
    >>> delayed = stepper.run(reference)
    >>> bool(np.abs(delayed[preview:] - drive[:-preview])[:-preview].max() < 1e-6)
    True
    """

    one_interval = False  # unless its model asks for one interval

    _parameter_constraints = {
        "model": [HasMethods(["fit", "predict"])],
        "method": [StrOptions({"auto", "learned"})],
        "bandwidth": [Interval(Real, 0, None, closed="neither"), None],
        "drive_limits": [StrOptions({"fit"}), tuple, list, None],
        "rate_limit": [StrOptions({"fit"}), Interval(Real, 0, None, closed="neither"), None],
        "limit_margin": [Interval(Real, 0, None, closed="left")],
        "max_residual": [Interval(Real, 0, None, closed="left")],
        "tol": [Interval(Real, 0, None, closed="left")],
        "max_iter": [Interval(Integral, 0, None, closed="left")],
    }

    def __init__(
        self,
        model,
        *,
        method="auto",
        bandwidth=None,
        drive_limits="fit",
        rate_limit="fit",
        limit_margin=0.0,
        max_residual=0.05,
        tol=1e-9,
        max_iter=50,
    ):
        self.model = model
        self.method = method
        self.bandwidth = bandwidth
        self.drive_limits = drive_limits
        self.rate_limit = rate_limit
        self.limit_margin = limit_margin
        self.max_residual = max_residual
        self.tol = tol
        self.max_iter = max_iter

    @fit_context(prefer_skip_nested_validation=False)
    def fit(self, X, y) -> Self:
        """Fit the model if it is not fitted, or learn its inverse.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            Column 0 is the drive, others are not used; the index carries records and time.
        y : array-like of shape (n_samples,)
            Response.

        Returns
        -------
        self

        Raises
        ------
        TypeError
            If the model is not a parametric model of one input, and is to be inverted.
        ValueError
            If the limits are not in ascending order.
        """
        self._check_limits()
        known = interval_of(self.model, fitted=self.method != "learned")
        _, columns, response = read_data(self, X, y, reset=True, dt=known)
        if self.method == "learned":
            self.model_ = clone(self.model).fit(_indexed(response, X), columns[:, 0])
        else:
            self.model_ = _fitted(self.model, X, y)
            if not isinstance(self.model_, ParametricModel) or self.model_.reads_columns:
                raise TypeError(
                    "The 'model' parameter of InverseCompensator must be a parametric model of "
                    f"skhyst of one input. Got {self.model!r} instead: method='learned' takes any "
                    "regressor."
                )
            read_slices(self.model_, X, reset=False)  # refuses an interval that it cannot have
            # the limits are those of the data the model was fitted to, which need not be X
            for name in ("drive_range_", "drive_rate_"):
                delattr(self, name)
                if hasattr(self.model_, name):
                    setattr(self, name, getattr(self.model_, name))
            self._require_inverse()
        return self

    def _require_inverse(self):
        """Refuse a model of which a part has no inverse."""
        plant = _InvertiblePlant(self.model_.operator_, None, self._limits())
        try:
            for _ in plant._inverses():
                pass
        except ValueError as error:
            raise ValueError(
                "The 'model' parameter of InverseCompensator must have an inverse at each of its "
                f"stages. {error}"
            ) from error

    @overload
    def predict(self, X, return_residual: Literal[False] = False) -> np.ndarray: ...
    @overload
    def predict(self, X, return_residual: Literal[True]) -> tuple[np.ndarray, np.ndarray]: ...
    def predict(self, X, return_residual=False) -> np.ndarray | tuple[np.ndarray, np.ndarray]:
        """Return the drive under which the response follows a reference.

        A record begins at rest at its first value. Inverse dynamics are non-causal: they move the
        drive before the response moves, so a reference that moves from its first sample on is
        missed at the beginning, by as little as a drive of moderate size allows. After a record the
        reference is assumed to rest at its last value.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            Column 0, in ``fit`` the drive, is the reference in units of the response; the index
            carries records and time.
        return_residual : bool, default=False
            Whether to return the remaining error of the model's response, too.

        Returns
        -------
        drive : ndarray of shape (n_samples,)
        residual : ndarray of shape (n_samples,)
            The model's response to the drive minus the reference, units of the response. Only with
            ``return_residual``.

        Raises
        ------
        ValueError
            If the reference is not finite, a stage has no stable inverse, or the residual of a
            learned inverse is requested.
        """
        X, _, read = fill_lost_rows(X)
        read = slice(None) if read is None else read
        slices, references = self._model_references(X) if return_residual else self._references(X)
        if self.method == "learned":  # the limits are applied, but there is no model to iterate on
            for s in slices:
                self._require_rate(s.dt)
            learned = self.model_.predict(_indexed(references, X))
            learned = np.ravel(learned).astype(float)
            limits = self._limits()
            parts = [(limits.applied(learned[s.rows], s.dt), learned[s.rows]) for s in slices]
            drive, requested = (np.concatenate(part) for part in zip(*parts, strict=True))
            cut = np.abs(requested - drive) > limits.rounding
            _warn(self._limit_messages(slices, drive, cut))
            return drive[read]
        parts = [self._compensated(references[s.rows], s.dt) for s in slices]
        *parts, messages = zip(*parts, strict=True)
        drive, cut, residual = map(np.concatenate, parts)
        limited = self._limit_messages(slices, drive, cut)
        _warn([*messages, *limited, self._missed(X, residual)])
        return (drive[read], residual[read]) if return_residual else drive[read]

    def largest_miss(self, X, residual) -> tuple[float, float, object]:
        """Return the largest relative residual of all records, its size, and its record.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            As for :meth:`predict`.
        residual : array-like of shape (n_samples,)
            Response minus reference.

        Returns
        -------
        fraction : float
            Largest absolute residual of a record relative to the range of its reference, or to the
            size of a constant reference.
        size : float
            Absolute residual, units of the response.
        record : object
            Label of the record, None for a single record.
        """
        slices, references = self._references(X)
        misses = []
        for s, name in zip(slices, record_names(slices), strict=True):
            reference, size = references[s.rows], float(np.abs(residual[s.rows]).max())
            scale = np.ptp(reference) or np.abs(reference).max() or np.abs(references).max()
            if not scale:  # a rest at zero: an error as small as that of the fit is no miss
                scale = np.inf if size <= getattr(self.model_, "fit_error_", 0.0) else size
            misses.append((size / scale, size, name if len(slices) > 1 else None))
        return max(misses, key=lambda miss: miss[0])

    def refine(self, X, measure, n_trials=6) -> np.ndarray:
        """Return a drive that is learned on the device, trial by trial.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            As for :meth:`predict`, of one record.
        measure : callable
            Applies a drive (n_samples,) to the device, which begins at rest, and returns its
            response (n_samples,).
        n_trials : int, default=6
            Largest number of times that the device is driven.

        Returns
        -------
        ndarray of shape (n_samples,)
            The drive with the smallest error; ``errors_`` has the errors of the trials that were
            kept.

        Raises
        ------
        ValueError
            If there are several records, ``n_trials`` is not a whole number from 1 on, or the
            device returns numbers that are not finite or too few.
        """
        slices, reference = self._model_references(X)
        if len(slices) != 1:
            raise ValueError(f"refine takes one record at a time. Got {len(slices)} instead.")

        def measured(drive):
            y = np.asarray(measure(drive), dtype=float)
            if y.shape != drive.shape or not np.isfinite(y).all():
                raise ValueError(
                    f"The device must return {len(drive)} finite numbers. Got {y!r} instead."
                )
            return y

        if not (isinstance(n_trials, Integral) and n_trials >= 1):
            raise ValueError(
                "The 'n_trials' parameter of InverseCompensator.refine must be a whole number from "
                f"1 on. Got {n_trials!r} instead."
            )
        plant = _InvertiblePlant(self.model_.operator_, slices[0].dt, self._limits())
        requested, *_, message = self._compensated(reference, plant.dt)
        target = self._filtered(reference, plant.dt)
        drive, cut, self.errors_ = self._improved(requested, target, plant, measured, n_trials, 0.0)
        rms = np.full(len(reference), self.errors_[-1])
        missed = self._missed(X, rms, "Root mean square over the record, the device misses")
        _warn([message, *self._limit_messages(slices, drive, cut), missed])
        return drive

    def preview(self, dt=None) -> int:
        r"""Return the preview of the reference in samples that the :meth:`stepper` has by default.

        Later values of the reference change the drive by at most the fraction ``tol``. Dynamics
        with a zero z outside the unit circle need :math:`\log(1/tol) / \log|z|` samples: 16 for a
        ``tol`` of 1e-9 and the zero near -3.73 of a mass that is sampled fast. A delay needs its
        own length.

        Parameters
        ----------
        dt : float, default=None
            As for :meth:`stepper`.

        Returns
        -------
        int
        """
        return self._plant(dt, "preview").inverse_steps(0.0, self._preview_tol())[1]

    def stepper(self, dt=None, reference=0.0, preview=None) -> Stepper:
        """Return the compensator as a device that is run sample by sample.

        It needs a preview of the reference: the drive that it returns belongs to the sample that
        lies ``preview`` samples back. The ``bandwidth`` is not applied, and there is no iteration.

        Parameters
        ----------
        dt : float, default=None
            Sampling interval in s; by default that of the records of the fit.
        reference : float, default=0.0
            Response at which the device has rested.
        preview : int, default=None
            Samples; by default those of :meth:`preview`. Each sample less multiplies the error by
            the magnitude of the zeros outside the unit circle.

        Returns
        -------
        Stepper
            ``step(reference) -> drive``.

        Raises
        ------
        NotImplementedError
            If a stage can only be inverted over a whole record.
        ValueError
            If the preview is not an integer or is shorter than a delay in the model, the reference
            is not finite, or a stage has no stable inverse.
        """
        reference = finite_number(reference, "InverseCompensator.stepper", "reference")
        if preview is not None and not (isinstance(preview, Integral) and preview >= 0):
            raise ValueError(
                "The 'preview' parameter of InverseCompensator.stepper must be a number of "
                f"samples. Got {preview!r} instead."
            )
        plant = self._plant(dt, "stepper")
        _warn([self._unknown()])
        return plant.stepper(reference, self._preview_tol(), preview, drive_signal(self))

    def drive_for(self, reference, dt) -> np.ndarray:
        """Return the drive for one record of a reference.

        Parameters
        ----------
        reference : array-like of shape (n_samples,)
            Units of the response.
        dt : float
            Sampling interval in s.

        Returns
        -------
        ndarray of shape (n_samples,)
            As returned by :meth:`predict`.

        Raises
        ------
        ValueError
            If a parameter is invalid, or as for :meth:`predict`.
        """
        check_is_fitted(self)
        caller, wanted = "InverseCompensator.drive_for", "finite numbers, one per sample"
        reference = finite_numbers(reference, caller, "reference", wanted, ndim=1)
        dt = valid_interval(dt, caller)
        if len(reference) == 1:  # at rest
            return self.drive_for(np.repeat(reference, 2), dt)[:1]
        index = pd.Index(dt * np.arange(len(reference)), name="time")
        names = getattr(self, "feature_names_in_", range(self.n_features_in_))
        X = np.zeros((len(index), self.n_features_in_))
        X[:, 0] = reference
        return self.predict(pd.DataFrame(X, index, names))

    def _plant(self, dt, caller):
        check_is_fitted(self)
        if self.method == "learned":
            raise NotImplementedError("A learned inverse cannot be run sample by sample.")
        dt = self._used_interval(dt, caller)
        return _InvertiblePlant(self.model_.operator_, dt, self._limits())

    def _used_interval(self, dt, caller):
        """Return the interval of a drive; refuse one in s where the rate of the fit has no time."""
        used = used_interval(self, dt, f"InverseCompensator.{caller}")
        self._require_rate(used)
        return used

    def _require_rate(self, used):
        """Refuse an interval in s where the rate of the fit is per sample, and limits the drive."""
        check_is_fitted(self)
        fitted_dt, unit = fitted_interval(self if self.method == "learned" else self.model_)
        if unit == "sample" and used != fitted_dt and self.rate_limit == "fit":
            raise RecordError(
                "The model was fitted without a time, so that the largest rate of its drive is per "
                f"sample. Got the interval {used:g} s instead: fit it with a time index or 'dt', "
                "or give a 'rate_limit' in units per s."
            )

    def _preview_tol(self):
        """Return the relative error that a finite preview may leave, at least that of rounding."""
        return min(max(self.tol, np.finfo(float).eps), 1.0)

    def _references(self, X):
        check_is_fitted(self)
        slices, columns, _ = read_data(self, X, reset=False)
        refuse_large("X", columns)
        return slices, columns[:, 0]

    def _model_references(self, X):
        """Return records and references, for a model that predicts the response."""
        if self.method == "learned":
            raise ValueError("A learned inverse does not predict the response of the device.")
        return self._references(X)

    @property
    def drive_limits_(self) -> tuple[float, float]:
        """Smallest and largest drive, units of the drive; infinite where there is no limit."""
        check_is_fitted(self)
        limits = self._limits()
        return float(limits.low), float(limits.high)

    @property
    def rate_limit_(self) -> float:
        """Largest rate of the drive, its units per s; infinite where there is no limit."""
        check_is_fitted(self)
        return float(self._limits().rate)

    def _limits(self):
        """Return the limits of the drive."""
        self._check_limits()
        low, high, rate = self._seen()
        span = high - low if np.isfinite(high - low) else 0.0
        rounding, margin = min(self.tol, ROUNDING) * span, self.limit_margin * span
        if not isinstance(self.drive_limits, str):
            low, high = (-np.inf, np.inf) if self.drive_limits is None else self.drive_limits
            margin = 0.0
        fitted = isinstance(self.rate_limit, str)
        rate = rate * (1.0 + self.limit_margin) if fitted else self.rate_limit
        rate = np.inf if rate is None else rate
        return DriveLimits(low - margin, high + margin, rate, rounding)

    def _check_limits(self):
        """Refuse invalid limits; they may have been set after the fit."""
        options = {"rate_limit": self._parameter_constraints["rate_limit"]}
        validate_parameter_constraints(options, vars(self), "InverseCompensator")
        if not (isinstance(self.drive_limits, str) and self.drive_limits == "fit"):
            check_limits(self.drive_limits, "InverseCompensator")

    def _seen(self):
        """Return the range and the rate of the drives of the fit, infinite where unknown."""
        low, high = getattr(self, "drive_range_", (-np.inf, np.inf))
        return low, high, getattr(self, "drive_rate_", np.inf)

    def _limit_messages(self, slices, drive, cut):
        """Return warnings about the samples of a drive (n_samples,) limited or beyond the fit."""
        limits, (low, high, rate), messages = self._limits(), self._seen(), [self._unknown()]
        if cut.any():
            messages.append(
                f"The limits of the drive cut {_percent(cut)} of the samples: {limits}. They are "
                "'drive_limits' and 'rate_limit', by default the range of the fit."
            )
        seen = DriveLimits(low, high, rate, limits.rounding)
        beyond = np.concatenate([seen.exceeded(drive[s.rows], s.dt) for s in slices])
        if beyond.any():
            messages.append(
                f"{_percent(beyond)} of the samples of the drive are beyond the range of the fit "
                f"({seen}): from {drive.min():.6g} to {drive.max():.6g}, up to "
                f"{max(_fastest(drive[s.rows], s.dt) for s in slices):.6g} per s."
            )
        return messages

    def _unknown(self):
        """Return a warning if the limits of the fit are required and not known, else ``""``."""
        if hasattr(self, "drive_range_") or "fit" not in (self.drive_limits, self.rate_limit):
            return ""
        return (
            "The drive is not limited to the range of the fit: the model was saved by an earlier "
            "version, without it. Give 'drive_limits' and 'rate_limit'."
        )

    def _missed(self, X, residual, whose="By the model, the device will miss"):
        """Return a warning if the response misses the reference by too much, else ``""``."""
        fraction, size, record = self.largest_miss(X, residual)
        if fraction <= self.max_residual:
            return ""
        where = "" if record is None else f" in record {record!r}"
        part = f"{100.0 * fraction:.3g} % of its range"
        return f"{whose} the reference{where} by up to {size:.4g} ({part})."

    def _filtered(self, signal, dt):
        """Return a signal after the low-pass filter of the bandwidth."""
        if self.bandwidth is None or self.bandwidth * dt >= 0.5:
            return signal
        low_pass = butter(_ORDER, self.bandwidth, fs=1.0 / dt, output="sos")
        if np.sum(low_pass[:, 3:], axis=1).min() <= 0.0:  # its poles are one, but for rounding
            raise ValueError(
                "The 'bandwidth' parameter of InverseCompensator must be a frequency that a filter "
                f"at a sampling interval of {dt:g} s can have. Got {self.bandwidth!r} Hz instead."
            )
        return sosfiltfilt(low_pass, signal, padtype="constant", padlen=len(signal) - 1)

    def _compensated(self, reference, dt):
        """Return the drive of a record, where limits clip it, the residual, and a warning.

        The warning names a stage that cannot give its required output; it may be empty.
        """
        dt = self._used_interval(dt, "predict")
        plant = _InvertiblePlant(self.model_.operator_, dt, self._limits())
        n = len(reference)
        rest = np.full(min(plant.preview(self._preview_tol()), n), reference[-1])
        target = self._filtered(np.append(reference, rest), dt)
        tolerance = self.tol * np.ptp(target)
        requested = plant.invert(target)
        requested[0] = plant.rest(reference[0])
        at_limit, message = plant.held, plant.short(target, max(tolerance, 1e-6 * np.ptp(target)))
        with np.errstate(over="ignore", invalid="ignore"):
            applied = plant.limits.applied(requested, dt)
            residual = plant.run(applied) - target
            if not np.mean(residual**2) <= np.mean((target - target[0]) ** 2):
                # at rest it misses the reference by less
                is_cut = np.abs(requested - applied) > plant.limits.rounding
                if is_cut.any():
                    at_limit = at_limit | is_cut
                    message = (
                        "Within its limits, the drive would miss the reference by more than at "
                        f"rest, where it stays. {message}".rstrip()
                    )
                requested = np.full(len(requested), requested[0])
        drive, cut, _ = self._improved(
            requested, target, plant, plant.run, self.max_iter, tolerance
        )
        drive, cut = drive[:n], (cut | at_limit)[:n]
        return drive, cut, plant.run(drive) - reference, message

    def _improved(self, requested, target, plant, measure, n_trials, tolerance):
        """Return the drive of the best trial, where it is clipped, and errors of kept trials."""
        drives, cuts, changes, errors, best, fraction, desired = [], [], [], [], 0, 1.0, None
        # a larger drive must lower the error by its standard error, that of a root mean square
        factor_if_larger = 1.0 - 1.0 / np.sqrt(2.0 * len(target))
        for trial in range(max(n_trials, 1)):
            drive = plant.limits.applied(requested, plant.dt)
            if drives and np.array_equal(drive, drives[best]):
                break
            drives.append(drive)
            cuts.append(np.abs(requested - drive) > plant.limits.rounding)
            if not n_trials:
                break
            y = measure(drive)
            error = np.sqrt(np.mean((y - target) ** 2))
            larger = np.ptp(drive) > np.ptp(drives[best])
            if not errors or error < (factor_if_larger if larger else 1.0) * errors[-1]:
                errors.append(error)
                best, fraction = trial, 1.0
            else:
                fraction *= 0.5  # the next trial starts again from the best one
            if errors[-1] <= tolerance or fraction < _SMALLEST:
                break
            # I[r] - I[y]: by linear modes, since the inverse of a motion with hysteresis may be
            # unbounded for a measured response
            if desired is None:
                desired = plant.invert(target, by_modes=True)
            changes.append(desired - plant.invert(self._filtered(y, plant.dt), by_modes=True))
            step = changes[best] + _combined(drives, changes, best)
            requested = drives[best] + fraction * step
            if not np.isfinite(requested).all():
                break
        return drives[best], cuts[best], errors


def _combined(drives, changes, best):
    """Return the correction of the best trial's change that follows from all trials (Anderson).

    Of their combinations it is the one with the smallest remaining change, supposing that changes
    are linear in drives, penalised by the change of the drive.
    """
    other_trials = [i for i in range(len(drives)) if i != best]
    if not other_trials:
        return 0.0
    d_drive = np.stack([drives[i] - drives[best] for i in other_trials], axis=1)
    d_change = np.stack([changes[i] - changes[best] for i in other_trials], axis=1)
    penalised = np.concatenate([d_change, _VISIBLE * d_drive])
    target = np.append(changes[best], np.zeros(len(changes[best])))
    weights = np.linalg.lstsq(penalised, target, rcond=None)[0]
    return -(d_drive + d_change) @ weights


def _fastest(drive, dt):
    """Return the largest rate of a drive (n_samples,)."""
    return np.abs(np.diff(drive)).max(initial=0.0) / dt


def _percent(samples):
    return f"{100.0 * np.mean(samples):.3g} %"


def _warn(messages):
    """Warn the caller of the method that calls this, unless all messages are empty."""
    messages = [message for message in dict.fromkeys(messages) if message]
    if messages:
        warnings.warn(" ".join(messages), ReachWarning, stacklevel=3)


def check_limits(limits, name):
    """Raise a ValueError unless limits of the drive are None or two numbers in ascending order."""
    if limits is None:
        return
    are_numbers = np.shape(limits) == (2,) and all(isinstance(limit, Real) for limit in limits)
    if not (are_numbers and limits[0] < limits[1]):
        raise ValueError(
            f"The 'drive_limits' parameter of {name} must be two numbers, the lower one first. "
            f"Got {limits!r} instead."
        )


class _InvertiblePlant:
    """A fitted operator at a sampling interval, run and inverted."""

    def __init__(self, operator, dt, limits):
        self.driven, self.disturbances = split_disturbances(operator)
        self.dt, self.limits = dt, limits
        series = isinstance(self.driven, Series)
        self.names = self.driven.names if series else (type(self.driven).__name__,)
        self.stages = self.driven.stages if series else (self.driven,)
        self.missed = self.held = None

    def run(self, drive):
        """Return the response from rest."""
        y, _ = self.driven.run(drive, self.dt, self.driven.init(drive[0]))
        return y + self._disturbance(len(y))

    def _disturbance(self, n):
        return sum((d.run(np.zeros(n), self.dt)[0] for d in self.disturbances), np.zeros(n))

    def _inverses(self, by_modes=False):
        """Yield name, stage and inverse of each stage, the last one first.

        With ``by_modes`` a stage with hysteresis in its equation of motion is inverted as its
        linear mode without hysteresis, which is bounded for any input, noise included.
        """
        for i in reversed(range(len(self.stages))):
            stage = self.stages[i]
            mode = stage.linear_mode() if by_modes and not stage.at_once else None
            limits = (self.limits.low, self.limits.high) if i == 0 else (-np.inf, np.inf)
            yield self.names[i], stage, mode.inverse() if mode else inverse_of(stage, *limits)

    def invert(self, wanted, by_modes=False):
        """Return the drive for a response.

        Sets ``missed``, the largest relative error of a stage's inverse with the stage's name and
        the required output, and ``held`` (n_samples,), where the first stage misses its output
        because its drive is at a limit.
        """
        v, self.missed = wanted - self._disturbance(len(wanted)), (0.0, "", 0.0)
        self.held = np.zeros(len(v), dtype=bool)
        for name, stage, inverse in self._inverses(by_modes):
            signal, _ = inverse.run(v, self.dt)
            if inverse.causal:  # a non-causal inverse necessarily misses the beginning of a record
                misses = np.abs(stage.run(signal, self.dt, stage.init(signal[0]))[0] - v)
                if stage is self.stages[0]:
                    low, high = self.limits.low, self.limits.high
                    self.held = ((signal <= low) | (signal >= high)) & (misses > 1e-9 * np.ptp(v))
                    misses = np.where(self.held, 0.0, misses)
                worst = np.argmax(misses)
                size = misses[worst] / (np.ptp(v) or 1.0)
                self.missed = max(self.missed, (size, name, float(v[worst])))
            v = signal
        return v

    def rest(self, value):
        """Return the drive under which the response rests at a value."""
        v = np.array([value]) - self._disturbance(1)
        for _, _, inverse in self._inverses():
            v = inverse.run(v, self.dt)[0]
        return v[0]

    def preview(self, tol):
        """Return the preview in samples that the inverses need for a relative error ``tol``."""
        samples = 0
        for _, _, inverse in self._inverses():
            try:
                samples += inverse.ahead(self.dt, 0.0, tol)[1]
            except NotImplementedError:  # needs the whole record, whatever follows it
                continue
        return samples

    def short(self, wanted, enough):
        """Return a warning naming the stage that misses its required output, else ``""``."""
        size, name, value = self.missed
        if size * np.ptp(wanted) <= enough:
            return ""
        return (
            f"The stage '{name}' cannot reach the required {value:g}: the reference is "
            "out of its range, its law is not monotone, or its inverse is not stable."
        )

    def inverse_steps(self, reference, tol):
        """Return the compiled steps of the inverses from rest, their delay, and the drive at rest.

        The delay in samples is the preview that they need for a relative error ``tol``.
        """
        compiled_steps, delay, v = [], 0, np.array([reference]) - self._disturbance(1)
        for _, _, inverse in self._inverses():
            step, samples = inverse.ahead(self.dt, v[0], tol)
            compiled_steps.append(step)
            delay += samples
            v = inverse.run(v, self.dt)[0]
        return compiled_steps, delay, v[0]

    def stepper(self, reference, tol, preview, drive):
        """Return the inverse as a stepper from rest, whose drive is delayed by the preview."""
        remake = partial(self.stepper, reference, tol, preview, drive)
        compiled_steps, delay, rest = self.inverse_steps(reference, tol)
        if preview is not None:
            for exponent in range(-15, 1):  # the smallest error that this preview allows
                compiled_steps, delay, rest = self.inverse_steps(reference, 10.0**exponent)
                if delay <= preview:
                    break
            else:
                raise ValueError(
                    "The 'preview' parameter of InverseCompensator.stepper must be at least "
                    f"{delay} samples: the model's dynamics need them. Got {preview!r} instead."
                )
            if delay < preview:
                spare = DelayOperator(float(preview - delay))
                begin = float(reference - self._disturbance(1)[0])
                compiled_steps.insert(0, spare.compiled_step(1.0, spare.init(begin)))
        if self.disturbances:
            negative = [replace(d, coefficients=-d.coefficients) for d in self.disturbances]
            correction = add_disturbances(GainOperator(1.0), negative)
            compiled_steps.insert(0, correction.compiled_step(self.dt, correction.init(reference)))
        if self.limits:
            compiled_steps.append(self.limits.compiled_step(self.dt, rest))
        return Stepper(
            CompiledSeries(tuple(compiled_steps)),
            self.dt,
            inputs=(Signal("reference"),),
            result=drive,
            preview=delay if preview is None else preview,
            remake=remake,
        )


def _fitted(model, X, y):
    """Return a model, fitted if it is not."""
    try:
        check_is_fitted(model)
    except NotFittedError:
        return clone(model).fit(X, y)
    refuse_other_unit(model, y)
    return model


def _indexed(values, X):
    """Return values as a column with the index of ``X``, where it has one."""
    if not hasattr(X, "iloc"):
        return values[:, None]
    return pd.DataFrame({"response": values}, X.index)
