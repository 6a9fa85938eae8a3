r"""Test of whether the mean of an autocorrelated series is zero.

The series is summed over blocks, :math:`Q_i`, of the length that Politis and White [1]_ derive from
its autocovariances: where it is slow, blocks are long and few. Blocks of that length miss a
fraction :math:`\eta` of the variance of the sum (Künsch [2]_), which is corrected for: if the mean
is zero, the total over :math:`\sqrt{\sum Q_i^2 / (1 - \eta)}` follows Student's t distribution with
as many degrees of freedom as there are blocks.

References
----------
.. [1] Politis and White, *Econometric Reviews*, 2004; corrected by Patton, Politis and White,
   *Econometric Reviews*, 2009.
.. [2] Künsch, *Annals of Statistics*, 1989.
"""

import numpy as np
from scipy.stats import t as student

_WINDOW = 5  # lags: the larger of 5 and sqrt(log10(n)) [1]_, which 10^25 samples would exceed


def block_p_value(total, chances):
    """Return the p-value of a total under the hypothesis that its series has a mean of zero.

    Parameters
    ----------
    total : float
        Sum of the series. The test is one-sided: the alternative is a mean above zero.
    chances : sequence of ndarray
        Contiguous parts of a series of zero mean, whose sum has the same distribution as the total
        under the hypothesis.

    Returns
    -------
    float
    """
    if not total > 0.0:
        return 1.0
    length, missing = block_length(chances)
    sums = np.concatenate([_block_sums(q, length) for q in chances])
    spread = np.sqrt(sums @ sums / (1.0 - missing))
    return float(student.sf(total / spread, len(sums))) if spread > 0.0 else 0.0


def block_length(series):
    """Return the length of blocks whose sums are nearly independent, and the variance they miss.

    Parameters
    ----------
    series : sequence of ndarray
        Stretches of one stationary series with a mean of zero.

    Returns
    -------
    length : int
    missing : float
        Fraction of the variance of the sum that blocks of this length miss, at most one half.
    """
    n = sum(map(len, series))
    longest = max(map(len, series))
    size = longest // 2
    covariance = sum(_autocovariance(s, size) for s in series) / n
    if not covariance[0] > 0.0:
        return 1, 0.0
    rho = covariance / covariance[0]
    # the smallest lag after which a window of autocorrelations is insignificant
    is_small = np.abs(rho[1:]) < 2.0 * np.sqrt(np.log10(n) / n)
    is_small = np.append(is_small, np.ones(_WINDOW, dtype=bool))  # lags beyond count as zero
    m = int(np.argmax(np.convolve(is_small, np.ones(_WINDOW), mode="valid") >= _WINDOW))
    lags = np.arange(min(2 * m, size) + 1)
    taper = np.clip(2.0 * (1.0 - lags / max(2 * m, 1)), 0.0, 1.0)  # flat, then falling to zero
    tapered = taper * rho[: len(lags)]
    g, moment = tapered[0] + 2.0 * tapered[1:].sum(), 2.0 * (lags * tapered).sum()
    if g <= 0.0:  # an oscillation cancels: one block spans the range of correlation
        return min(2 * m + 1, longest), 0.0
    length = int(np.ceil((1.5 * (moment / g) ** 2 * n) ** (1.0 / 3.0)))
    length = min(max(length, 1), longest)
    return length, float(np.clip(moment / (g * length), 0.0, 0.5))


def independent_sample(series):
    """Return how many neighbouring samples are worth an independent one for the mean, at least one.

    One plus twice the sum of the autocorrelations up to the first that is not positive, as in the
    initial sequence of Geyer, *Statistical Science*, 1992. In an oscillation, whose mean is known
    better than that, more are taken to depend on each other.

    Parameters
    ----------
    series : sequence of ndarray
        Stretches of one stationary series with a mean of zero.

    Returns
    -------
    float
    """
    covariance = sum(_autocovariance(s, max(map(len, series)) - 1) for s in series)
    if not covariance[0] > 0.0:
        return 1.0
    first = np.argmax(np.append(covariance, 0.0) <= 0.0)
    return float(2.0 * covariance[:first].sum() / covariance[0] - 1.0)


def _autocovariance(values, size):
    """Return the sums of products of values 0 to ``size`` samples apart, (size + 1,)."""
    spectrum = np.abs(np.fft.rfft(values, 2 * max(len(values), 1))) ** 2
    products = np.fft.irfft(spectrum)[: min(size + 1, len(values))]
    return np.pad(products, (0, size + 1 - len(products)))


def _block_sums(values, length):
    """Return the sums over blocks of nearly equal length, none shorter than ``length``."""
    count = max(len(values) // length, 1)
    edges = np.linspace(0, len(values), count + 1).astype(int)[:-1]
    return np.add.reduceat(values, edges) if len(values) else np.empty(0)
