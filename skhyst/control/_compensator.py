r"""The drive under which a device follows a reference: its model backwards.

Stage by stage, from the last to the first, each output that is wanted becomes the input that gives
it: by the stage's own inverse, by the root of each sample, or, for dynamics, by stable inversion,
over a whole record or with a preview of the reference (see :func:`skhyst.operators.inverse_of`).

What is left is worked off by iteration. With an approximate inverse :math:`I`, in which a stage
whose motion has hysteresis within it is the linear mode that it is without, and a response
:math:`y` to the drive :math:`u`,

.. math:: u \leftarrow u + s \, (I[r] - I[y]), \qquad 0 < s \le 1

which leaves a drive alone where the response is the reference :math:`r`, whatever the inverse
(iterative learning: Arimoto, Kawamura and Miyazaki, *Journal of Robotic Systems*, 1984). What the
trials so far tell of how changes follow from drives is used too (Anderson, *Journal of the ACM*,
1965). Each step starts from the best trial; where it has made the error larger, half of it is
tried. On the model itself that makes the compensation as exact as the model is, and on the device
as exact as its sensor.

A drive is not determined by the response alone. A mass hardly answers a drive that changes its sign
from sample to sample, and, with the zero of sampling near -3.73, what such a drive does at the end
of a record, growing by that factor each sample, is not seen in it at all. Three things keep such
parts out of the drive, whatever its limits are. On the model, a record is continued by a rest at
the last value of its reference, so long that what comes later does not matter. A combination of
trials is penalised by its drive, so that none is used of which the response shows little
(regularisation: Tikhonov, *Soviet Mathematics Doklady*, 1963). And a trial whose drive is larger is
kept only if the error falls by more than what chance makes of the mean square of so many samples.
"""

import warnings
from dataclasses import replace
from numbers import Integral, Real
from typing import Literal, Self, overload

import numpy as np
import pandas as pd
from scipy.signal import butter, sosfiltfilt
from sklearn.base import BaseEstimator, MetaEstimatorMixin, clone
from sklearn.exceptions import NotFittedError
from sklearn.utils.validation import check_is_fitted

from .._sklearn import (
    HasMethods,
    Interval,
    StrOptions,
    fit_context,
    validate_parameter_constraints,
)
from .._validation import finite_number, finite_numbers, refuse_large
from ..base import ParametricModel, read_data
from ..exceptions import ReachWarning
from ..linear import DelayOperator, GainOperator
from ..operators import (
    CompiledSeries,
    SeriesOperator,
    Stepper,
    add_disturbances,
    inverse_of,
    split_disturbances,
)
from ..records import chosen_interval
from ._drive_limits import DriveLimits

_ORDER = 4  # of the low-pass, run forwards and backwards
_SMALLEST = 2.0**-6  # part of a step below which nothing is gained
_ROUNDING = 1e-9  # of the range of the drive: what exceeds a limit by less is not reported
# Part of a change of the drive that must be seen in the response. An inverse sees all of it, one
# that has a stiffness wrong by ten still a tenth. A step is at most (1 + 1 / (2 * this)) of the
# change that is asked for.
_SEEN = 0.1


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
        Hz. What is faster in the reference, and in errors that are learned from, is left out
        (Butterworth of order 4, forwards and backwards). By default nothing is.
    drive_limits : {"fit"}, tuple of (float, float) or None, default="fit"
        Smallest and largest drive, its units. By default those that the fit of the model has seen
        (``drive_range_``). None: there are none.
    rate_limit : {"fit"}, float or None, default="fit"
        Fastest change of the drive, its units per s. By default the fastest that the fit of the
        model has seen (``drive_rate_``). None: there is none.
    limit_margin : float, default=0.0
        Part of the range of the fit by which its limits are widened at each end, and of its rate by
        which that is raised.
    max_residual : float, default=0.05
        Part of the range of the reference by which the model's response may miss it at a sample
        without a warning. The command line writes no drive beyond.
    tol : float, default=1e-9
        Error of the model's response, relative to the range of the reference, that is good enough.
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
        Range and fastest change of the drive that the fit of the model has seen, as those of
        :class:`~skhyst.base.ParametricModel`; missing where the model does not know them.
    drive_limits_, rate_limit_ : tuple of (float, float), float
        Limits that hold, units of the drive and those per s; infinite where there are none.

    Warns
    -----
    ReachWarning
        If limits cut the drive (with the share of the samples), the drive leaves what the fit has
        seen where limits are None, or that is not known; if a stage does not reach what is asked of
        it (with its name and the value); if the response to the drive misses the reference by more
        than ``max_residual`` allows.

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

    The same, sample by sample, from a reference that is known some samples ahead:

    >>> ahead = compensator.preview()
    >>> stepper = compensator.stepper()
    >>> late = stepper.run(reference)
    >>> bool(np.abs(late[ahead:] - drive[:-ahead])[:-ahead].max() < 1e-6)
    True
    """

    _one_interval = False  # unless its model asks for one

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
        """Fit the model where it is not fitted, or its inverse.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            Column 0 is the drive, others are not used; the index carries records and time.
        y : array-like of shape (n_samples,)
            Response.

        Returns
        -------
        self
        """
        self._check_limits()
        _, columns, response = read_data(self, X, y, reset=True, dt=getattr(self.model, "dt", 1.0))
        if self.method == "learned":
            self.model_ = clone(self.model).fit(_indexed(response, X), columns[:, 0])
        else:
            self.model_ = _fitted(self.model, X, y)
            if not isinstance(self.model_, ParametricModel) or self.model_._reads_columns:
                raise TypeError(
                    "The 'model' parameter of InverseCompensator must be a parametric model of "
                    f"skhyst of one input. Got {self.model!r} instead: method='learned' takes any "
                    "regressor."
                )
            for name in ("drive_range_", "drive_rate_"):  # of the model, whatever X is
                delattr(self, name)
                if hasattr(self.model_, name):
                    setattr(self, name, getattr(self.model_, name))
        return self

    @overload
    def predict(self, X, return_residual: Literal[False] = False) -> np.ndarray: ...
    @overload
    def predict(self, X, return_residual: Literal[True]) -> tuple[np.ndarray, np.ndarray]: ...
    def predict(self, X, return_residual=False) -> np.ndarray | tuple[np.ndarray, np.ndarray]:
        """Return the drive under which the response follows a reference.

        A record begins at rest at its first value. Where dynamics are inverted the drive moves
        before the response has to, so a reference that moves at once is missed at its beginning, by
        as little as a drive of moderate size allows. Behind a record it rests at its last value.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            Column 0 is the reference, in units of the response, in the place of the drive; the
            index carries records and time.
        return_residual : bool, default=False
            Whether to return what is left of the error, too.

        Returns
        -------
        drive : ndarray of shape (n_samples,)
        residual : ndarray of shape (n_samples,)
            The model's response to the drive, less the reference. Only where it is asked for.

        Raises
        ------
        ValueError
            If the reference is not finite, a stage has no stable inverse, or the residual of a
            learned inverse is asked for.
        """
        slices, references = self._known(X) if return_residual else self._references(X)
        if self.method == "learned":
            learned = self.model_.predict(_indexed(references, X))
            learned = np.ravel(learned).astype(float)
            limits = self._limits()
            parts = [(limits.applied(learned[s.rows], s.dt), learned[s.rows]) for s in slices]
            drive, asked = (np.concatenate(part) for part in zip(*parts, strict=True))
            cut = np.abs(asked - drive) > limits.rounding
            _warn(self._told(slices, drive, cut))
            return drive
        parts = [self._compensated(references[s.rows], s.dt) for s in slices]
        *parts, short = zip(*parts, strict=True)
        drive, cut, residual = map(np.concatenate, parts)
        _warn([*short, *self._told(slices, drive, cut), self._missed(X, residual)])
        return (drive, residual) if return_residual else drive

    def largest_miss(self, X, residual) -> tuple[float, float, object]:
        """Return by how much a residual misses the reference, in the record where that is most.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            As for :meth:`predict`.
        residual : array-like of shape (n_samples,)
            Response less reference.

        Returns
        -------
        fraction : float
            Largest absolute residual of a record over the range of its reference, or over the size
            of a reference that is constant.
        size : float
            That residual, units of the response.
        record : object
            Label of the record, None where there is one alone.
        """
        slices, references = self._references(X)
        found = []
        for s in slices:
            own, size = references[s.rows], float(np.abs(residual[s.rows]).max())
            scale = np.ptp(own) or np.abs(own).max() or np.abs(references).max()
            if not scale:  # a rest at zero: what the fit has left of the response is no miss
                scale = np.inf if size <= getattr(self.model_, "fit_error_", 0.0) else size
            found.append((size / scale, size, s.label if len(slices) > 1 else None))
        return max(found, key=lambda miss: miss[0])

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
            Times that the device is driven.

        Returns
        -------
        ndarray of shape (n_samples,)
            The drive with the smallest error; ``errors_`` has those of the trials that were kept.
        """
        slices, reference = self._known(X)
        if len(slices) != 1:
            raise ValueError(f"refine takes one record at a time. Got {len(slices)} instead.")

        def measured(drive):
            y = np.asarray(measure(drive), dtype=float)
            if y.shape != drive.shape or not np.isfinite(y).all():
                raise ValueError(
                    f"The device must answer with {len(drive)} finite numbers. Got {y!r} instead."
                )
            return y

        if not (isinstance(n_trials, Integral) and n_trials >= 1):
            raise ValueError(
                "The 'n_trials' parameter of InverseCompensator.refine must be a whole number from "
                f"1 on. Got {n_trials!r} instead."
            )
        plant = _Backwards(self.model_.operator_, slices[0].dt, self._limits())
        asked, *_, short = self._compensated(reference, plant.dt)
        wanted = self._filtered(reference, plant.dt)
        drive, cut, self.errors_ = self._improved(asked, wanted, plant, measured, n_trials, 0.0)
        rms = np.full(len(reference), self.errors_[-1])
        missed = self._missed(X, rms, "Root mean square over the record, the device misses")
        _warn([short, *self._told(slices, drive, cut), missed])
        return drive

    def preview(self, dt=None) -> int:
        r"""Return how many samples ahead the :meth:`stepper` is fed the reference by default.

        What comes later changes the drive by a part ``tol`` at the most. Dynamics with a zero z
        outside the unit circle need :math:`\log(1/tol) / \log|z|` samples: 16 for a ``tol`` of 1e-9
        and the zero near -3.73 of a mass that is sampled fast. A delay needs its own length.

        Parameters
        ----------
        dt : float, default=None
            As for :meth:`stepper`.

        Returns
        -------
        int
        """
        return self._backwards(dt, "preview").streamed(0.0, self._part_left_out())[1]

    def stepper(self, dt=None, reference=0.0, preview=None) -> Stepper:
        """Return the compensator as a device that is fed the reference sample by sample.

        It is fed the reference some samples ahead: the drive that it returns is for that many
        samples before. The bandwidth plays no part, and nothing is left to iteration.

        Parameters
        ----------
        dt : float, default=None
            Sampling interval in s; by default that of the records of the fit.
        reference : float, default=0.0
            At which the device rests before.
        preview : int, default=None
            Samples ahead; by default those of :meth:`preview`. With fewer the error grows, by the
            size of the zeros outside the unit circle for each.

        Raises
        ------
        NotImplementedError
            If a stage can only be undone over a whole record.
        ValueError
            If the preview is no whole number or shorter than a delay in the model, the reference is
            not finite, or a stage has no stable inverse.
        """
        reference = finite_number(reference, "InverseCompensator.stepper", "reference")
        if preview is not None and not (isinstance(preview, Integral) and preview >= 0):
            raise ValueError(
                "The 'preview' parameter of InverseCompensator.stepper must be a number of "
                f"samples. Got {preview!r} instead."
            )
        plant = self._backwards(dt, "stepper")
        _warn([self._unknown()])
        return plant.stepper(reference, self._part_left_out(), preview)

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
            As :meth:`predict` returns it.

        Raises
        ------
        ValueError
            If a parameter is not as above, or as for :meth:`predict`.
        """
        check_is_fitted(self)
        caller, wanted = "InverseCompensator.drive_for", "finite numbers, one a sample"
        reference = finite_numbers(reference, caller, "reference", wanted, ndim=1)
        dt = chosen_interval((), dt, caller)
        index = pd.Index(dt * np.arange(len(reference)), name="time")
        names = getattr(self, "feature_names_in_", range(self.n_features_in_))
        X = np.zeros((len(index), self.n_features_in_))
        X[:, 0] = reference
        return self.predict(pd.DataFrame(X, index, names))

    def _backwards(self, dt, caller):
        check_is_fitted(self)
        if self.method == "learned":
            raise NotImplementedError("An inverse that was learned is not stepped.")
        dt = chosen_interval(self.model_.records_, dt, f"InverseCompensator.{caller}")
        return _Backwards(self.model_.operator_, dt, self._limits())

    def _part_left_out(self):
        """Return what of a reference that comes late may be left out, rounding at the least."""
        return min(max(self.tol, np.finfo(float).eps), 1.0)

    def _references(self, X):
        check_is_fitted(self)
        slices, columns, _ = read_data(self, X, reset=False, dt=getattr(self.model_, "dt", 1.0))
        refuse_large("X", columns)
        return slices, columns[:, 0]

    def _known(self, X):
        """Return records and references for a model that tells the response."""
        if self.method == "learned":
            raise ValueError("Nothing is known of the response where an inverse was learned.")
        return self._references(X)

    @property
    def drive_limits_(self) -> tuple[float, float]:
        check_is_fitted(self)
        limits = self._limits()
        return float(limits.low), float(limits.high)

    @property
    def rate_limit_(self) -> float:
        check_is_fitted(self)
        return float(self._limits().rate)

    def _limits(self):
        """Return the limits of the drive."""
        self._check_limits()
        low, high, rate = self._seen()
        span = high - low if np.isfinite(high - low) else 0.0
        rounding, wider = min(self.tol, _ROUNDING) * span, self.limit_margin * span
        if not isinstance(self.drive_limits, str):
            low, high = (-np.inf, np.inf) if self.drive_limits is None else self.drive_limits
            wider = 0.0
        fitted = isinstance(self.rate_limit, str)
        rate = rate * (1.0 + self.limit_margin) if fitted else self.rate_limit
        rate = np.inf if rate is None else rate
        return DriveLimits(low - wider, high + wider, rate, rounding)

    def _check_limits(self):
        """Refuse limits that are none; they may have been set after the fit."""
        options = {"rate_limit": self._parameter_constraints["rate_limit"]}
        validate_parameter_constraints(options, vars(self), "InverseCompensator")
        if not (isinstance(self.drive_limits, str) and self.drive_limits == "fit"):
            check_limits(self.drive_limits, "InverseCompensator")

    def _seen(self):
        """Return the range and the rate that the fit has seen, infinite where nobody knows."""
        low, high = getattr(self, "drive_range_", (-np.inf, np.inf))
        return low, high, getattr(self, "drive_rate_", np.inf)

    def _told(self, slices, drive, cut):
        """Return in words which part of a drive (n_samples,) is limited or beyond the fit."""
        limits, seen, told = self._limits(), DriveLimits(*self._seen()), [self._unknown()]
        if cut.any():
            told.append(
                f"The limits of the drive cut {_percent(cut)} of the samples: {limits}. They are "
                "'drive_limits' and 'rate_limit', by default what the fit has seen."
            )
        if self.drive_limits is not None:
            seen = replace(seen, low=-np.inf, high=np.inf)
        if self.rate_limit is not None:
            seen = replace(seen, rate=np.inf)
        seen = replace(seen, rounding=limits.rounding)
        beyond = np.concatenate([seen.exceeded(drive[s.rows], s.dt) for s in slices])
        if beyond.any():
            told.append(
                f"{_percent(beyond)} of the samples of the drive, which is not limited, are beyond "
                f"what the fit has seen ({seen}): up to {drive[np.abs(drive).argmax()]:.6g}."
            )
        return told

    def _unknown(self):
        """Return in words that the limits of the fit are not known, where they are asked for."""
        if hasattr(self, "drive_range_") or "fit" not in (self.drive_limits, self.rate_limit):
            return ""
        return (
            "The drive is not limited to what the fit has seen, as the model, of an earlier "
            "version, does not know it: give 'drive_limits' and 'rate_limit'."
        )

    def _missed(self, X, residual, whose="By the model, the device will miss"):
        """Return in words by how much the response to the drive misses a reference."""
        fraction, size, record = self.largest_miss(X, residual)
        if fraction <= self.max_residual:
            return ""
        where = "" if record is None else f" in record {record!r}"
        part = f"{100.0 * fraction:.3g} % of its range"
        return f"{whose} the reference{where} by up to {size:.4g} ({part})."

    def _filtered(self, signal, dt):
        """Return what of a signal is slower than the bandwidth."""
        if self.bandwidth is None or self.bandwidth * dt >= 0.5:
            return signal
        low_pass = butter(_ORDER, self.bandwidth, fs=1.0 / dt, output="sos")
        return sosfiltfilt(low_pass, signal, padtype="constant", padlen=len(signal) - 1)

    def _compensated(self, reference, dt):
        """Return the drive of a record, where limits cut it, what is left, and who falls short."""
        plant = _Backwards(self.model_.operator_, dt, self._limits())
        n = len(reference)
        rest = np.full(min(plant.ahead(self._part_left_out()), n), reference[-1])
        wanted = self._filtered(np.append(reference, rest), dt)
        enough = self.tol * np.ptp(wanted)
        asked = plant.invert(wanted)
        asked[0] = plant.rest(reference[0])
        held, short = plant.held, plant.short(wanted, max(enough, 1e-6 * np.ptp(wanted)))
        with np.errstate(over="ignore", invalid="ignore"):
            left = plant.run(plant.limits.applied(asked, dt)) - wanted
            if not np.mean(left**2) <= np.mean((wanted - wanted[0]) ** 2):
                asked = np.full(len(asked), asked[0])  # at rest it misses the reference by less
        drive, cut, _ = self._improved(asked, wanted, plant, plant.run, self.max_iter, enough)
        drive, cut = drive[:n], (cut | held)[:n]
        return drive, cut, plant.run(drive) - reference, short

    def _improved(self, asked, wanted, plant, measure, n_trials, enough):
        """Return a drive with a smaller error, where limits cut it, and the errors on the way."""
        drives, cuts, changes, errors, best, part, aim = [], [], [], [], 0, 1.0, None
        least = 1.0 - 1.0 / np.sqrt(2.0 * len(wanted))  # standard error of a root mean square
        for trial in range(max(n_trials, 1)):
            drive = plant.limits.applied(asked, plant.dt)
            if drives and np.array_equal(drive, drives[best]):
                break
            drives.append(drive)
            cuts.append(np.abs(asked - drive) > plant.limits.rounding)
            if not n_trials:
                break
            y = measure(drive)
            error = np.sqrt(np.mean((y - wanted) ** 2))
            larger = np.ptp(drive) > np.ptp(drives[best])
            if not errors or error < (least if larger else 1.0) * errors[-1]:
                errors.append(error)
                best, part = trial, 1.0
            else:
                part *= 0.5
            if errors[-1] <= enough or part < _SMALLEST:
                break
            if aim is None:
                aim = plant.invert(wanted, by_modes=True)
            changes.append(aim - plant.invert(self._filtered(y, plant.dt), by_modes=True))
            step = changes[best] + _combined(drives, changes, best)
            asked = drives[best] + part * step
            if not np.isfinite(asked).all():
                break
        return drives[best], cuts[best], errors


def _combined(drives, changes, best):
    """Return what all trials add to the change that one of them asks for.

    That is of their combinations the one that leaves the smallest change to be asked for, as far as
    changes are linear in drives, and costs the smallest change of the drive.
    """
    others = [i for i in range(len(drives)) if i != best]
    if not others:
        return 0.0
    d_drive = np.stack([drives[i] - drives[best] for i in others], axis=1)
    d_change = np.stack([changes[i] - changes[best] for i in others], axis=1)
    penalised = np.concatenate([d_change, _SEEN * d_drive])
    wanted = np.append(changes[best], np.zeros(len(changes[best])))
    weights = np.linalg.lstsq(penalised, wanted, rcond=None)[0]
    return -(d_drive + d_change) @ weights


def _percent(samples):
    return f"{100.0 * np.mean(samples):.3g} %"


def _warn(told):
    """Warn whoever has called the method that calls this, if anything is told."""
    told = [sentence for sentence in dict.fromkeys(told) if sentence]
    if told:
        warnings.warn(" ".join(told), ReachWarning, stacklevel=3)


def check_limits(limits, name):
    """Refuse limits of the drive that are not two numbers in their order."""
    if limits is None:
        return
    are_numbers = np.shape(limits) == (2,) and all(isinstance(limit, Real) for limit in limits)
    if not (are_numbers and limits[0] < limits[1]):
        raise ValueError(
            f"The 'drive_limits' parameter of {name} must be two numbers, the lower one first. "
            f"Got {limits!r} instead."
        )


class _Backwards:
    """A fitted operator at an interval, run and inverted."""

    def __init__(self, operator, dt, limits):
        self.driven, self.beside = split_disturbances(operator)
        self.dt, self.limits = dt, limits
        series = isinstance(self.driven, SeriesOperator)
        self.names = self.driven.names if series else (type(self.driven).__name__,)
        self.stages = self.driven.stages if series else (self.driven,)
        self.missed = self.held = None

    def run(self, drive):
        """Return the response from rest."""
        y, _ = self.driven.run(drive, self.dt, self.driven.init(drive[0]))
        return y + self._disturbed(len(y))

    def _disturbed(self, n):
        return sum((d.run(np.zeros(n), self.dt)[0] for d in self.beside), np.zeros(n))

    def _inverses(self, by_modes=False):
        """Yield the stages with their names and inverses, the last one first.

        With ``by_modes`` motion is undone as the linear mode that it is without hysteresis, which
        is bounded whatever comes, noise too.
        """
        for i in reversed(range(len(self.stages))):
            stage = self.stages[i]
            mode = stage.linear_mode() if by_modes and not stage.at_once else None
            limits = (self.limits.low, self.limits.high) if i == 0 else (-np.inf, np.inf)
            yield self.names[i], stage, mode.inverse() if mode else inverse_of(stage, *limits)

    def invert(self, wanted, by_modes=False):
        """Return a drive for a response.

        Kept are where a stage falls short the most (``missed``), and at which samples the first
        one does because limits hold its drive (``held``).
        """
        v, self.missed = wanted - self._disturbed(len(wanted)), (0.0, "", 0.0)
        self.held = np.zeros(len(v), dtype=bool)
        for name, stage, inverse in self._inverses(by_modes):
            found, _ = inverse.run(v, self.dt)
            if inverse.causal:  # what looks ahead is short where a record begins
                short = np.abs(stage.run(found, self.dt, stage.init(found[0]))[0] - v)
                if stage is self.stages[0]:
                    low, high = self.limits.low, self.limits.high
                    self.held = ((found <= low) | (found >= high)) & (short > 1e-9 * np.ptp(v))
                    short = np.where(self.held, 0.0, short)
                worst = np.argmax(short)
                size = short[worst] / (np.ptp(v) or 1.0)
                self.missed = max(self.missed, (size, name, float(v[worst])))
            v = found
        return v

    def rest(self, value):
        """Return the drive under which the response rests at a value."""
        v = np.array([value]) - self._disturbed(1)
        for _, _, inverse in self._inverses():
            v = inverse.run(v, self.dt)[0]
        return v[0]

    def ahead(self, tol):
        """Return how many samples what comes later matters before, but for the part ``tol``."""
        samples = 0
        for _, _, inverse in self._inverses():
            try:
                samples += inverse.ahead(self.dt, 0.0, tol)[1]
            except NotImplementedError:  # all of the record does
                continue
        return samples

    def short(self, wanted, enough):
        """Return in words which stage does not reach what the last inversion has asked of it."""
        size, name, value = self.missed
        if size * np.ptp(wanted) <= enough:
            return ""
        return (
            f"The stage '{name}' does not give {value:g}, which is asked of it: the reference is "
            "out of its reach, its law is not monotone, or its inverse is not stable."
        )

    def streamed(self, reference, tol):
        """Return the inverses' steps, from rest, by how many samples they are late, and the drive.

        That is the drive at rest.
        """
        compiled_step, late, v = [], 0, np.array([reference]) - self._disturbed(1)
        for _, _, inverse in self._inverses():
            own, samples = inverse.ahead(self.dt, v[0], tol)
            compiled_step.append(own)
            late += samples
            v = inverse.run(v, self.dt)[0]
        return compiled_step, late, v[0]

    def stepper(self, reference, tol, preview):
        """Return the inverse as a stepper, from rest, that is late by a preview."""
        compiled_step, late, drive = self.streamed(reference, tol)
        if preview is not None:
            for exponent in range(-15, 1):  # of the part that is left out: the least that it can be
                compiled_step, late, drive = self.streamed(reference, 10.0**exponent)
                if late <= preview:
                    break
            else:
                raise ValueError(
                    f"The 'preview' parameter of InverseCompensator.stepper must be {late} samples "
                    f"at the least: the model's dynamics need them. Got {preview!r} instead."
                )
            if late < preview:
                spare = DelayOperator(float(preview - late))
                begin = float(reference - self._disturbed(1)[0])
                compiled_step.insert(0, spare.compiled_step(1.0, spare.init(begin)))
        if self.beside:
            without = [replace(d, coefficients=-d.coefficients) for d in self.beside]
            own = add_disturbances(GainOperator(1.0), without)
            compiled_step.insert(0, own.compiled_step(self.dt, own.init(reference)))
        if self.limits:
            compiled_step.append(self.limits.compiled_step(self.dt, drive))
        return Stepper(CompiledSeries(tuple(compiled_step)), self.dt)


def _fitted(model, X, y):
    """Return a model, fitted if it is not."""
    try:
        check_is_fitted(model)
    except NotFittedError:
        return clone(model).fit(X, y)
    return model


def _indexed(values, X):
    """Return values as a column with the index of ``X``, where it has one."""
    if not hasattr(X, "iloc"):
        return values[:, None]
    return pd.DataFrame({"response": values}, X.index)
