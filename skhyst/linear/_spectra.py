r"""Cross spectra by Welch's method, and the frequency responses that follow from them.

With the discrete Fourier transforms :math:`U_s` (n_inputs) and :math:`Y_s` of the windowed
segments :math:`s = 1 \dots n`,

.. math:: \hat S_{uu} = \sum_s U_s^* U_s^T, \quad \hat S_{uy} = \sum_s U_s^* Y_s, \quad
    \hat G = \hat S_{uu}^{-1} \hat S_{uy}

is the least-squares solution of :math:`Y_s = U_s^T G`. Segments that overlap are correlated: they
count as :math:`n' = n^2 / \sum_{s,t} \rho_{st}` independent ones, where :math:`\rho_{st}` is the
squared correlation of the two windows where they lie. The residual's power, divided by
:math:`n' - n_{inputs}`, is the noise in one of them.
"""

from dataclasses import dataclass

import numpy as np
from scipy.fft import rfft, rfftfreq
from scipy.signal import detrend as remove_trend

__all__ = ["CrossSpectra", "cross_spectra", "effective_averages"]

_WEAKEST = 1e-10  # power of the weakest combination of inputs, of the largest power of all lines


@dataclass(frozen=True)
class CrossSpectra:
    """Sums over all segments: uu (k, m, m), uy (k, m), yy (k,), and how many they are worth."""

    frequency: np.ndarray
    uu: np.ndarray
    uy: np.ndarray
    yy: np.ndarray
    n_averages: float

    def excited(self):
        """Return which lines every combination of the inputs excites."""
        power = np.linalg.eigvalsh(self.uu)
        return power[:, 0] > _WEAKEST * power[:, -1].max()

    def keep(self, lines):
        """Return the spectra at some of the lines."""
        parts = (part[lines] for part in (self.frequency, self.uu, self.uy, self.yy))
        return CrossSpectra(*parts, self.n_averages)

    def estimate(self, method):
        """Return the frequency response (k, m), its standard deviation, and the coherence (k,)."""
        dof = self.n_averages - self.uy.shape[1]
        g = np.linalg.solve(self.uu, self.uy[..., None])[..., 0]
        explained = np.einsum("ki,ki->k", self.uy.conj(), g).real
        coherence = np.clip(explained / self.yy, 0.0, 1.0)
        left = self.yy * (1.0 - coherence) / dof
        inverse = np.linalg.inv(self.uu)
        variance = left[:, None] * np.einsum("kii->ki", inverse).real
        if method == "h2":
            g = g / coherence[:, None]
            variance = variance / coherence[:, None] ** 2
        elif method == "hv":
            g = g / np.sqrt(coherence)[:, None]
            variance = variance * (0.5 * (1.0 + 1.0 / coherence))[:, None]
        return g, np.sqrt(variance), coherence


def cross_spectra(records, dt, window, step, detrend):
    """Sum the spectra of all whole segments of all records.

    Parameters
    ----------
    records : list of (ndarray of shape (n, n_inputs), ndarray of shape (n,))
        Inputs and response.
    dt : float
        Interval in s.
    window : ndarray of shape (segment_length,)
        Window.
    step : int
        Samples from one segment to the next.
    detrend : {"constant", "linear", None}
        What is taken from every segment before the window.

    Returns
    -------
    CrossSpectra
        Without the lines at zero and at half the sampling rate, where the transforms are real.
    """
    length, m = window.size, records[0][0].shape[1]
    lines = slice(1, (length + 1) // 2)
    frequency = rfftfreq(length, dt)[lines]
    uu = np.zeros((frequency.size, m, m), dtype=complex)
    uy = np.zeros((frequency.size, m), dtype=complex)
    yy = np.zeros(frequency.size)
    counts = []
    for inputs, response in records:
        starts = range(0, len(response) - length + 1, step)
        counts.append(len(starts))
        for start in starts:
            rows = slice(start, start + length)
            signals = np.vstack([inputs[rows].T, response[rows]])
            if detrend is not None:
                signals = remove_trend(signals, type=detrend)
            z = rfft(signals * window)[:, lines].T
            u, y = z[:, :m], z[:, m]
            uu += u.conj()[:, :, None] * u[:, None, :]
            uy += u.conj() * y[:, None]
            yy += np.abs(y) ** 2
    return CrossSpectra(frequency, uu, uy, yy, effective_averages(window, step, counts))


def effective_averages(window, step, counts):
    """Return how many independent segments the overlapping ones of records are worth [1]_.

    Parameters
    ----------
    window : ndarray of shape (segment_length,)
    step : int
        Samples from one segment to the next.
    counts : sequence of int
        Segments of each record.

    Returns
    -------
    float

    References
    ----------
    .. [1] P. D. Welch, "The use of fast Fourier transform for the estimation of power spectra",
       IEEE Transactions on Audio and Electroacoustics 15 (1967) 70-73.
    """
    counts = np.asarray(counts, dtype=float)
    total = counts.sum()
    pairs = total
    for k in range(1, int(np.ceil(window.size / step))):
        overlap = window[k * step :] @ window[: window.size - k * step] / (window @ window)
        pairs += 2.0 * np.maximum(counts - k, 0.0).sum() * overlap**2
    return float(total**2 / pairs)
