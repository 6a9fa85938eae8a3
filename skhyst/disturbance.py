"""Disturbances: functions of the time since the start of a record, whatever the drive.

The coefficients of a disturbance belong to the record, not to the device. Identification solves
them exactly record by record; the operator holds their mean over the records, which is what a
free run of a new record can know.
"""

# ruff: noqa: D102 (what an operator and an estimator do is said by their bases)

import math
from abc import abstractmethod
from dataclasses import dataclass
from numbers import Integral

import numpy as np
from scipy.fft import next_fast_len

from ._jit import jit
from ._sklearn import Interval
from .base import ParametricModel
from .operators import LoweredStep, Operator, parameter

__all__ = [
    "DisturbanceOperator",
    "Drift",
    "DriftOperator",
    "Offset",
    "OffsetOperator",
    "PeriodicDisturbance",
    "SinusoidOperator",
]

_OVERSAMPLING = 4  # zero padding of the spectrum in which lines are sought


class DisturbanceOperator(Operator):
    """Base: ``y(t) = basis(t) coefficients``, t from the record's start; no input is used."""

    signal_linear = True
    rank = 60
    stands_beside = True
    has_constant = False  # as the first column of its basis

    @abstractmethod
    def basis(self, time):
        """Return the basis, shape (n_samples, n_coefficients), at ``time`` (s)."""

    def basis_tangents(self, time, coefficients):
        """Return derivatives of ``basis @ coefficients`` by the other parameters, (n, p)."""
        return np.empty((len(time), 0))

    def init(self, u0, initial_state="rest"):
        return 0.0  # s since the record's start

    def run(self, u, dt, state=None):
        start = 0.0 if state is None else state
        time = start + dt * np.arange(len(u))
        return self.basis(time) @ self.coefficients, start + dt * len(u)

    def _step(self):
        """Return the compiled step, or None, and its constants behind ``dt``."""
        return None, ()

    def lowered(self, dt, state):
        step, constants = self._step()
        if step is None:
            return super().lowered(dt, state)
        return LoweredStep(step, (dt, *constants), [state / dt])

    def linearize(self, u, du, dt, initial_state="rest"):
        time = dt * np.arange(len(u))
        basis = self.basis(time)
        own = np.concatenate([basis, self.basis_tangents(time, self.coefficients)], axis=1)
        return basis @ self.coefficients, np.concatenate([np.zeros_like(du), own], axis=1)


@jit
def offset_step(u, c, s):
    """Return the constant; ``c`` is (dt, coefficients)."""
    return c[1][0]


@jit
def drift_step(u, c, s):
    """Return the drift at one sample, ``s``; ``c`` is (dt, coefficients, duration)."""
    dt, coefficients, duration = c
    z = min(2.0 * dt * s[0] / duration - 1.0, 1.0)
    s[0] += 1.0
    before, value, y = 0.0, 1.0, 0.0
    for d in range(coefficients.size):
        y += coefficients[d] * value
        # (d + 1) P_{d+1} = (2 d + 1) z P_d - d P_{d-1}
        before, value = value, ((2 * d + 1) * z * value - d * before) / (d + 1)
    return y


@jit
def sinusoid_step(u, c, s):
    """Return the lines at one sample, ``s``; ``c`` is (dt, coefficients, frequencies)."""
    dt, coefficients, frequencies = c
    time = dt * s[0]
    s[0] += 1.0
    y = 0.0
    n = frequencies.size
    for k in range(n):
        phase = 2.0 * math.pi * frequencies[k] * time
        y += coefficients[k] * math.cos(phase) + coefficients[n + k] * math.sin(phase)
    return y


@dataclass(frozen=True)
class OffsetOperator(DisturbanceOperator):
    """A constant."""

    has_constant = True

    coefficients: np.ndarray = parameter(linear=True, unit="response")

    def basis(self, time):
        return np.ones((len(time), 1))

    def _step(self):
        return offset_step, (self.coefficients,)

    def characteristics(self, seen):
        return {"spread between records": (np.ptp(seen.coefficients), "response")}


@dataclass(frozen=True)
class DriftOperator(DisturbanceOperator):
    """Legendre polynomials of time over ``duration`` (s), from degree 0; constant afterwards."""

    has_constant = True

    coefficients: np.ndarray = parameter(linear=True, unit="response")
    duration: float

    def basis(self, time):
        z = np.clip(2.0 * time / self.duration - 1.0, -1.0, 1.0)
        return np.polynomial.legendre.legvander(z, np.size(self.coefficients) - 1)

    def _step(self):
        return drift_step, (self.coefficients, self.duration)

    def characteristics(self, seen):
        curves = zip(seen.inputs, seen.dts, seen.coefficients, strict=True)
        spans = [np.ptp(self.basis(dt * np.arange(len(u))) @ own) for u, dt, own in curves]
        return {"largest span in a record": (max(spans), "response")}


@dataclass(frozen=True)
class SinusoidOperator(DisturbanceOperator):
    """Sines and cosines at ``frequencies`` (Hz)."""

    coefficients: np.ndarray = parameter(linear=True, unit="response")
    frequencies: np.ndarray = parameter(lower=0.0, unit="Hz")

    def basis(self, time):
        phase = 2.0 * np.pi * np.outer(time, self.frequencies)
        return np.concatenate([np.cos(phase), np.sin(phase)], axis=1)

    def _step(self):
        return sinusoid_step, (self.coefficients, self.frequencies)

    def basis_tangents(self, time, coefficients):
        phase = 2.0 * np.pi * np.outer(time, self.frequencies)
        cosine, sine = np.split(np.asarray(coefficients), 2)
        return 2.0 * np.pi * time[:, None] * (sine * np.cos(phase) - cosine * np.sin(phase))

    def characteristics(self, seen):
        amplitudes = np.hypot(*np.split(seen.coefficients, 2, axis=1)).mean(axis=0)
        return {"frequency": (self.frequencies, "Hz"), "amplitude": (amplitudes, "response")}


class _Disturbance(ParametricModel):
    """Base of the disturbances: nothing is driven, all is beside."""

    operator_class = DisturbanceOperator


class Offset(_Disturbance):
    """A constant for each record.

    Each record's own constant is in ``record_coefficients_``; :meth:`predict` gives the mean over
    the records of the fit, since the drive of a new record tells nothing of its constant.

    Attributes
    ----------
    record_coefficients_ : ndarray of shape (n_records, 1)
        Units of the response.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.disturbance import Offset
    >>> Offset().fit(np.zeros((4, 1)), [1.0, 2.0, 3.0, 4.0]).record_coefficients_
    array([[2.5]])
    """

    def starting_values(self, records):
        return [OffsetOperator(np.zeros(1))]


class Drift(_Disturbance):
    """A slow function of the time since each record's start: Legendre polynomials.

    Parameters
    ----------
    degree : int, default=3
        Highest degree.

    Attributes
    ----------
    record_coefficients_ : ndarray of shape (n_records, degree + 1)
        Units of the response; :meth:`predict` gives the mean over the records.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.disturbance import Drift
    >>> model = Drift(degree=1).fit(np.zeros((5, 1)), [0.0, 1.0, 2.0, 3.0, 4.0])
    >>> np.round(model.predict(np.zeros((3, 1))), 9) + 0.0
    array([0., 1., 2.])
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "degree": [Interval(Integral, 0, None, closed="left")],
    }

    def __init__(self, degree=3, *, initial_state="rest", dt=1.0, method="variable_projection"):
        super().__init__(initial_state=initial_state, dt=dt, method=method)
        self.degree = degree

    def starting_values(self, records):
        duration = max((len(record.u) - 1) * record.dt for record in records)
        return [DriftOperator(np.zeros(self.degree + 1), duration or records[0].dt)]


class PeriodicDisturbance(_Disturbance):
    """Sinusoids at frequencies of their own; amplitude and phase belong to each record.

    Parameters
    ----------
    n_frequencies : int, default=1
        Number of sinusoids.

    Attributes
    ----------
    record_coefficients_ : ndarray of shape (n_records, 2 * n_frequencies)
        Cosine, then sine amplitudes, units of the response.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.disturbance import PeriodicDisturbance
    >>> time = np.arange(500) * 0.01
    >>> y = np.sin(2 * np.pi * 7.3 * time)
    >>> model = PeriodicDisturbance(dt=0.01).fit(np.zeros((500, 1)), y)
    >>> print(f"{model.operator_.stages[1].frequencies[0]:.3f} Hz")
    7.300 Hz
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "n_frequencies": [Interval(Integral, 1, None, closed="left")],
    }

    def __init__(
        self, n_frequencies=1, *, initial_state="rest", dt=1.0, method="variable_projection"
    ):
        super().__init__(initial_state=initial_state, dt=dt, method=method)
        self.n_frequencies = n_frequencies

    def starting_values(self, records):
        frequencies = _spectral_lines(records, self.n_frequencies)
        return [SinusoidOperator(np.zeros(2 * self.n_frequencies), frequencies)]


def _spectral_lines(records, count):
    """Return the frequencies (Hz) of the strongest lines in the power of all records together.

    One after the other: each line found is fitted and taken away before the next is sought.
    """
    dt, longest = min(r.dt for r in records), max(len(r.y) * r.dt for r in records)
    n = next_fast_len(round(_OVERSAMPLING * longest / dt), real=True)
    grid = np.fft.rfftfreq(n, dt)
    # of one duration, so that the lines of all transforms are about the same
    sizes = [round(n * dt / r.dt) for r in records]
    rest = [r.y - r.y.mean() for r in records]
    found = []
    for _ in range(count):
        power = np.zeros(len(grid))
        for y, size in zip(rest, sizes, strict=True):
            own = np.abs(np.fft.rfft(y * np.hanning(len(y)), size)) ** 2
            power[: len(own)] += own[: len(power)]
        # the first bins are what a mean and a trend leave
        power[grid < 2.0 / longest] = 0.0
        found.append(grid[np.argmax(power)])
        line = SinusoidOperator(np.zeros(2), np.array(found[-1:]))
        for i, y in enumerate(rest):
            basis = line.basis(records[i].dt * np.arange(len(y)))
            rest[i] = y - basis @ np.linalg.lstsq(basis, y, rcond=None)[0]
    return np.array(found)
