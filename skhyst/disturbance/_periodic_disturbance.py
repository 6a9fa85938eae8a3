"""Sinusoidal disturbances, at frequencies that do not depend on the drive."""

import math
from dataclasses import dataclass
from numbers import Integral

import numpy as np
from scipy.fft import next_fast_len

from .._jit import jit
from .._sklearn import Interval
from ..base import ParametricModel
from ..operators import parameter
from ._base import Disturbance, DisturbanceOperator

_OVERSAMPLING = 4  # zero padding, so that the highest bin is within 1/(8 duration) of a line


@jit
def sinusoid_step(u, c, s):
    """Return the sum of sinusoids at sample number ``s[0]``.

    ``c`` is (dt, coefficients, frequencies).
    """
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
class SinusoidOperator(DisturbanceOperator):
    """Sum of cosines and sines of the time since the start of the record.

    Parameters
    ----------
    coefficients : ndarray of shape (2 * n_frequencies,)
        Amplitudes of the cosines, then of the sines, units of the response.
    frequencies : ndarray of shape (n_frequencies,)
        Hz.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.disturbance import SinusoidOperator
    >>> hum = SinusoidOperator(np.array([1.0, 0.0]), np.array([0.25]))
    >>> hum.run(np.zeros(4), dt=1.0)[0].round(6) + 0.0
    array([ 1.,  0., -1.,  0.])
    """

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


class PeriodicDisturbance(Disturbance):
    """Sinusoids at fitted frequencies; each record has its own amplitudes and phases.

    Parameters
    ----------
    n_frequencies : int, default=1
        Number of sinusoids.

    Attributes
    ----------
    record_coefficients_ : ndarray of shape (n_records, 2 * n_frequencies)
        Cosine, then sine amplitudes, units of the response.

    See Also
    --------
    Drift : A slow function of time.

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
        self,
        n_frequencies=1,
        *,
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        super().__init__(initial_state=initial_state, dt=dt, drive=drive, method=method)
        self.n_frequencies = n_frequencies

    def starting_values(self, records):
        frequencies = _spectral_lines(records, self.n_frequencies)
        return [SinusoidOperator(np.zeros(2 * self.n_frequencies), frequencies)]


def _spectral_lines(records, count):
    """Return the frequencies (Hz), in order, of the strongest lines in the power of all records.

    They are found one after the other: each line is fitted and subtracted before the next search.
    """
    dt, longest = min(r.dt for r in records), max(len(r.y) * r.dt for r in records)
    n = next_fast_len(round(_OVERSAMPLING * longest / dt), real=True)
    grid = np.fft.rfftfreq(n, dt)
    # one duration for all transforms, so that their bins have about the same frequencies
    sizes = [round(n * dt / r.dt) for r in records]
    residuals = [r.y - r.y.mean() for r in records]
    frequencies = []
    for _ in range(count):
        power = np.zeros(len(grid))
        for y, size in zip(residuals, sizes, strict=True):
            spectrum = np.abs(np.fft.rfft(y * np.hanning(len(y)), size)) ** 2
            power[: len(spectrum)] += spectrum[: len(power)]
        # a mean and a trend leave power in the lowest bins
        power[grid < 2.0 / longest] = 0.0
        frequencies.append(grid[np.argmax(power)])
        line = SinusoidOperator(np.zeros(2), np.array(frequencies[-1:]))
        for i, y in enumerate(residuals):
            basis = line.basis(records[i].dt * np.arange(len(y)))
            residuals[i] = y - basis @ np.linalg.lstsq(basis, y, rcond=None)[0]
    return np.sort(frequencies)
