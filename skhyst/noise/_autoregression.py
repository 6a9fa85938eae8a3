r"""Autoregressions: filters that make noise white, from its autocovariance.

For a filter that is applied sample by sample, the Bayesian criterion [1]_ chooses the order. For
the spectrum, Akaike's criterion, corrected for short samples [2]_, is efficient [3]_, and three
families are compared: the coefficients of the first lags are free; those of the lags 1, 2, 3-4,
5-8, 9-16, ... are equal within each octave (as the averages of Corsi [4]_), so that long memory
needs few parameters; or they are those of a fractional difference (Hosking [5]_), truncated at the
length of the record, whose only parameter is the exponent of a power-law spectrum.

References
----------
.. [1] Schwarz, *Annals of Statistics*, 1978.
.. [2] Hurvich and Tsai, *Biometrika*, 1989.
.. [3] Shibata, *Annals of Statistics*, 1981.
.. [4] Corsi, *Journal of Financial Econometrics*, 2009.
.. [5] Hosking, *Biometrika*, 1981.
"""

import numpy as np
from scipy.fft import rfft
from scipy.optimize import minimize_scalar

_ROUNDING = 1e-12  # relative error power below which a series counts as predicted exactly


def levinson(covariance, longest):
    """Return the best linear predictors from 1, 2, ... past samples (Levinson's recursion).

    Parameters
    ----------
    covariance : ndarray of shape (n_lags,)
    longest : int

    Returns
    -------
    list of (ndarray of shape (order,), float)
        Weights of the past samples, the last one first, and variance of the prediction errors.
    """
    predictors, weights, variance = [], np.empty(0), covariance[0]
    for order in range(1, min(longest, len(covariance) - 1) + 1):
        reflection = (covariance[order] - weights @ covariance[order - 1 : 0 : -1]) / variance
        weights = np.append(weights - reflection * weights[::-1], reflection)
        variance *= 1.0 - reflection**2
        if not variance > _ROUNDING * covariance[0]:
            break
        predictors.append((weights, variance))
    return predictors


def whitening_filter(series):
    """Return the autoregressive filter (order + 1,) that whitens a list of noise series.

    Its coefficients follow from the autocovariance (Yule, *Philosophical Transactions of the Royal
    Society A*, 1927). Its order, up to 10 log10 n, minimises the Bayesian information criterion.
    """
    n = sum(map(len, series))
    longest = min(int(10.0 * np.log10(n)), min(map(len, series)) - 1)
    covariance = np.array(
        [sum(e[lag:] @ e[: len(e) - lag] for e in series) / n for lag in range(longest + 1)]
    )
    best = np.ones(1)
    if covariance[0] == 0.0:
        return best
    least = n * np.log(covariance[0])
    for weights, variance in levinson(covariance, longest):
        criterion = n * np.log(variance) + len(weights) * np.log(n)
        if criterion < least:
            best, least = np.append(1.0, -weights), criterion
    return best


def autoregression(covariance, n):
    """Return the whitening filter (order + 1,) of noise, and the power of its output.

    ``covariance`` (n_lags,) is the noise's, estimated from ``n`` samples.
    """
    best = np.ones(1), covariance[0]
    least = n * np.log(covariance[0])
    for weights, variance, count in _candidates(covariance, int(10.0 * np.log10(n))):
        if not variance > _ROUNDING * covariance[0] or count > n - 3:
            continue
        criterion = n * np.log(variance) + 2.0 * count * n / (n - count - 2.0)
        if criterion < least:
            best, least = (np.append(1.0, -weights), variance), criterion
    return best


def _candidates(covariance, longest):
    """Return a list of weights of the past, latest first, error power, and degrees of freedom."""
    candidates = [(*predictor, len(predictor[0])) for predictor in levinson(covariance, longest)]
    # sums of the covariance over rectangles of lags from its second integral
    integral = np.cumsum(np.append(0.5 * covariance[0], covariance[1:]))
    integral = np.append(0.0, np.cumsum(integral))
    sums = np.cumsum(covariance)
    edges = [0, 1, 2]
    while 2 * edges[-1] < len(covariance):
        edges.append(2 * edges[-1])
        values = integral[np.abs(np.subtract.outer(edges, edges))]
        gram = values[1:, :-1] + values[:-1, 1:] - values[1:, 1:] - values[:-1, :-1]
        right = np.diff(sums[edges])
        weights = np.linalg.lstsq(gram, right, rcond=None)[0]
        power = covariance[0] - weights @ right
        candidates.append((np.repeat(weights, np.diff(edges)), power, len(weights)))
    return [*candidates, _fractional(covariance)]


def _fractional(covariance):
    """Return the weights of a fractional difference, their error power, and one: its order."""
    size = 2 * len(covariance) - 1  # odd: all but the first frequency occur twice
    power = rfft(np.append(covariance, covariance[:0:-1])).real * 2.0 / size
    power[0] *= 0.5
    factor = 2.0 * np.sin(np.pi * np.arange(len(power)) / size)

    def error_power(order):
        return float(power @ factor ** (2.0 * order))

    order = minimize_scalar(error_power, bounds=(0.0, 1.0), method="bounded").x
    lags = np.arange(1.0, len(covariance))
    return -np.cumprod((lags - 1.0 - order) / lags), error_power(order), 1
