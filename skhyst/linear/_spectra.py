r"""Frequency responses from averaged spectra, by Welch's method.

With the discrete Fourier transforms :math:`U_s` (n_inputs) and :math:`Y_s` of the windowed
segments :math:`s = 1 \dots n`,

.. math:: \hat S_{uu} = \sum_s U_s^* U_s^T, \quad \hat S_{uy} = \sum_s U_s^* Y_s, \quad
    \hat G = \hat S_{uu}^{-1} \hat S_{uy}

is the least-squares solution of :math:`Y_s = U_s^T G`. Segments that overlap are correlated: they
count as :math:`n' = n^2 / \sum_{s,t} \rho_{st}` independent ones, where :math:`\rho_{st}` is the
squared correlation of the two windows where they lie (P. D. Welch, IEEE Transactions on Audio and
Electroacoustics 15, 1967, 70-73). The residual's power, divided by :math:`n' - n_{inputs}`, is the
noise in one of them.
"""

import numpy as np
from scipy.fft import rfft
from scipy.signal import detrend as remove_trend

__all__ = ["effective_averages", "welch_estimate"]

_WEAKEST = 1e-10  # power of the weakest combination of inputs, of the largest power of all lines


def effective_averages(window, step, counts):
    """Return how many independent segments those of records are worth, ``counts`` in each."""
    counts = np.asarray(counts, dtype=float)
    total = pairs = counts.sum()
    for k in range(1, int(np.ceil(window.size / step))):
        overlap = window[k * step :] @ window[: window.size - k * step] / (window @ window)
        pairs += 2.0 * np.maximum(counts - k, 0.0).sum() * overlap**2
    return float(total**2 / pairs)


def welch_estimate(records, window, step, detrend, method, n_averages):
    """Estimate the frequency response from all whole segments of records, ``step`` apart.

    Returns the excited lines (multiples of the reciprocal segment length, without those at zero
    and at half the sampling rate, where the transforms are real) and what
    :class:`FrequencyResponse` holds of the estimate at them.
    """
    length, m = window.size, records[0][0].shape[1]
    inner = slice(1, (length + 1) // 2)
    spectra = 0.0
    for inputs, response in records:
        signals = np.vstack([inputs.T, response])
        for start in range(0, len(response) - length + 1, step):
            segment = signals[:, start : start + length]
            if detrend is not None:
                segment = remove_trend(segment, type=detrend)
            z = rfft(segment * window)[:, inner].T
            spectra = spectra + z.conj()[:, :, None] * z[:, None, :]
    power = np.linalg.eigvalsh(spectra[:, :m, :m])
    lines = np.flatnonzero(power[:, 0] > _WEAKEST * power[:, -1].max())
    spectra = spectra[lines]
    uu, uy, yy = spectra[:, :m, :m], spectra[:, :m, m], spectra[:, m, m].real

    g = np.linalg.solve(uu, uy[..., None])[..., 0]
    coherence = np.clip(np.einsum("ki,ki->k", uy.conj(), g).real / yy, 0.0, 1.0)
    dof = n_averages - m
    noise = yy * (1.0 - coherence) / dof
    variance = noise[:, None] * np.einsum("kii->ki", np.linalg.inv(uu)).real
    if method == "h2":
        g = g / coherence[:, None]
        variance = variance / coherence[:, None] ** 2
    elif method == "hv":
        g = g / np.sqrt(coherence)[:, None]
        variance = variance * (0.5 * (1.0 + 1.0 / coherence))[:, None]
    estimate = {"response": g, "std": np.sqrt(variance), "coherence": coherence}
    return lines + 1, {**estimate, "degrees_of_freedom": dof}
