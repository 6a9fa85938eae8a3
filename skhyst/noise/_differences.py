r"""Standard deviation of noise on a smooth signal, from differences of neighbouring samples.

The difference of order p multiplies the variance of white noise by :math:`\binom{2p}{p}` and the
amplitude of a sine of the period T by :math:`(2 \sin(\pi / T))^p`. Divided by the root of the
former, differences show the noise, and a smooth signal less with each order (Gasser, Sroka and
Jennen-Steinmetz [1]_ use the second). Noise with correlated neighbours shows less than its size:
for stationary noise of the spectrum S, the mean of S with a weight that rises with the frequency.

References
----------
.. [1] Gasser, Sroka and Jennen-Steinmetz, *Biometrika*, 1986.
"""

import numpy as np
from scipy.special import comb
from scipy.stats import norm

from ._model import stretches

_ORDERS = (2, 3, 4)  # a straight line has no second difference; higher orders amplify rounding


def difference_noise(series):
    """Return the standard deviation of noise on smooth series, a lower bound for coloured noise.

    The smallest of the estimates from second, third and fourth differences. An edge of the signal
    affects few differences: outliers, beyond the value that one of n normal variables is expected
    to exceed, are excluded.

    Parameters
    ----------
    series : sequence of ndarray of shape (n_samples,)
        NaN where a sample is not known.

    Returns
    -------
    float
        Units of the series; NaN where no three neighbouring samples are known.

    See Also
    --------
    fit_noise : Spectrum, quantisation and outliers of a series that is noise alone.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.noise import difference_noise
    >>> noise = 0.1 * np.random.default_rng(0).standard_normal(4000)
    >>> round(difference_noise([np.sin(np.arange(4000) / 50.0) + noise]), 2)
    0.1
    """
    parts = [values[rows] for values in series for rows in stretches(values)]
    sizes = []
    for order in _ORDERS:
        differences = np.concatenate([np.zeros(0), *(np.diff(part, order) for part in parts)])
        if len(differences):
            sizes.append(_without_edges(differences) / np.sqrt(comb(2 * order, order)))
    return float(min(sizes, default=np.nan))


def _without_edges(values):
    """Return the root mean square of values without outliers."""
    most = norm.isf(0.5 / len(values))
    while True:
        size = np.sqrt(np.mean(np.square(values)))
        inside = np.abs(values) <= most * size
        if inside.all() or not inside.any():
            return size
        values = values[inside]


def white_noise_floor(signal):
    """Return the standard deviation of white noise on a smooth signal, 0 if none is detected.

    Differences of a smooth signal shrink with the order, those of white noise keep their scaled
    size.

    Parameters
    ----------
    signal : ndarray of shape (n_samples,)

    Returns
    -------
    float
        Units of the signal.
    """
    order, n = 10, len(signal)  # reduces a sine of 30 samples per period to 1e-6
    if n < 8 * order:
        return 0.0
    before, last = _scatter(signal, order), _scatter(signal, order + 1)
    # for simulated noise, last / before is 1 with a standard deviation of 0.57 / sqrt(n)
    grid = np.min(np.diff(np.unique(signal)), initial=np.inf)
    rounding = n * np.finfo(float).eps * np.abs(signal).max()
    least = max((1.0 - 2.0 / np.sqrt(n)) * before, grid, rounding)
    return float(before) if last > least else 0.0


def largest_noise(signal):
    """Return an upper bound of the standard deviation of white noise on a signal (n_samples,)."""
    return float(min(_scatter(signal, p) for p in range(1, min(len(signal), 12))))


def _scatter(signal, order):
    """Return the robust standard deviation of differences, relative to that of white noise."""
    size = np.median(np.abs(np.diff(signal, order))) / norm.ppf(0.75)
    return size / np.sqrt(comb(2 * order, order))
