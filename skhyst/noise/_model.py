r"""Model of a sensor's noise: spectrum, quantisation, outliers.

The discrete cosine transform of stationary noise has nearly independent coefficients :math:`c_k` of
the variance :math:`S(f_k)`. Three spectra are compared: white noise, and white noise plus a
first-order autoregressive process or a power law, as of flicker noise,

.. math:: S = \sigma^2 \qquad
   S = \sigma^2 \left(1 - s + s \frac{1 - a^2}{1 - 2 a \cos 2 \pi f + a^2}\right) \qquad
   S = \sigma^2 (1 - s + s\, b f^{-\beta})

by Whittle's likelihood [1]_, :math:`\sum_k \log S(f_k) + c_k^2 / S(f_k)`; the second and the third
have two more parameters, which Schwarz's criterion [2]_ penalises. A spectrum with a peak fits none
of them: an oscillation is structure, not noise.

References
----------
.. [1] Whittle, *Arkiv för Matematik*, 1953.
.. [2] Schwarz, *Annals of Statistics*, 1978.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.fft import dct
from scipy.linalg import solve_toeplitz
from scipy.optimize import minimize
from scipy.signal import lfilter
from scipy.stats import norm

STEEPEST = 4.0  # largest exponent of the spectrum: that of white noise integrated twice
_MEMORY = 256  # past samples that predict the next
_WIDTH = 0.05  # of a bin of the spectrum, relative to its frequency


@dataclass(frozen=True)
class NoiseModel:
    """Noise of a sensor.

    Parameters
    ----------
    law : {"white", "autoregressive", "power_law"}
        Spectrum: constant, of a first-order autoregressive process, or a power of the frequency.
    standard_deviation : float
        Units of the response.
    coefficient : float
        Correlation of neighbouring samples of the first-order process, or the exponent beta of the
        spectrum f^-beta (1 for flicker noise); 0 for white noise.
    share : float
        Part of the variance that has this law; the rest is white.
    outliers : float
        Fraction of the samples beyond the value that one of n normal variables is expected to
        exceed.
    quantisation : float
        Step of the converter, units of the response; 0 where readings show none. Its square over 12
        is part of the variance, where readings spread over many steps.

    See Also
    --------
    fit_noise : Estimate such a model from series of noise.
    """

    law: str
    standard_deviation: float
    coefficient: float = 0.0
    share: float = 0.0
    outliers: float = 0.0
    quantisation: float = 0.0

    def spectrum(self, frequency):
        """Return the spectrum of the noise, whose mean is one.

        Parameters
        ----------
        frequency : ndarray of shape (n,)
            In cycles per sample, 0 to 0.5.

        Returns
        -------
        ndarray of shape (n,)
            Power, relative to its mean over the frequencies.
        """
        return _spectrum(self.law, frequency, self.coefficient, self.share)

    @cached_property
    def _forecast(self):
        """Weights of the past samples, the last one first, that predict the next."""
        n = 8 * _MEMORY  # fine enough for these lags
        power = self.spectrum(np.arange(0.5, n) / (2 * n))
        correlations = dct(power)[: _MEMORY + 1]  # up to a factor
        return solve_toeplitz(correlations[:-1], correlations[1:])

    def correlation_length(self, n_samples):
        """Return the number of samples in which the correlation falls to 1/e; 0 for white noise.

        It is that of the coloured part, in a record of this length with its mean subtracted.

        Parameters
        ----------
        n_samples : int
            Of the record.

        Returns
        -------
        int
            Samples.
        """
        if self.law == "white":
            return 0
        frequency = np.arange(1, n_samples) / (2.0 * (n_samples - 1))
        power = _spectrum(self.law, frequency, self.coefficient)
        correlations = np.fft.irfft(np.append(0.0, power))[:n_samples]
        low = correlations[1:] <= correlations[0] / np.e
        return int(np.argmax(low)) + 1 if low.any() else n_samples

    def innovations(self, series):
        """Return the one-step prediction errors of each series, in each contiguous part.

        Parameters
        ----------
        series : sequence of ndarray of shape (n_samples,)
            One per record; NaN for missing values.

        Returns
        -------
        list of ndarray of shape (n_samples,)
            One per record; NaN for missing values.
        """
        if self.law == "white":
            return list(series)
        innovations = [np.full(len(values), np.nan) for values in series]
        for errors, values in zip(innovations, series, strict=True):
            for rows in stretches(values):
                errors[rows] = lfilter(np.append(1.0, -self._forecast), 1.0, values[rows])
        return innovations

    def __str__(self):
        size = f"standard deviation {self.standard_deviation:.3g}"
        if self.law == "autoregressive":
            text = (
                f"first-order autoregressive noise, correlation {self.coefficient:.2f} per sample"
            )
        elif self.law == "power_law":
            text = f"noise with the spectrum 1/f^{self.coefficient:.2f}"
        else:
            text = "white noise"
        parts = [f"{text}, {size}"]
        if 0.0 < self.share < 0.95:
            parts.append(f"{100.0 * (1.0 - self.share):.0f} % of its power white")
        if self.outliers:
            parts.append(f"{100.0 * self.outliers:.2f} % outliers")
        if self.quantisation:
            parts.append(f"quantised in steps of {self.quantisation:.3g}")
        return "; ".join(parts)


def stretches(values):
    """Return the rows of each stretch of finite values."""
    known = np.flatnonzero(np.isfinite(values))
    ends = np.flatnonzero(np.diff(known) > 1) + 1
    return [slice(rows[0], rows[-1] + 1) for rows in np.split(known, ends) if len(rows)]


def fit_noise(series, readings=()):
    """Estimate the model of noise from series of it.

    Parameters
    ----------
    series : sequence of ndarray
        Noise, sample by sample, NaN where unknown.
    readings : sequence of ndarray, optional
        Readings of the sensor, units of the response, from which the step of its converter is
        determined.

    Returns
    -------
    NoiseModel
        Of the law that Schwarz's criterion selects.

    See Also
    --------
    difference_noise : Standard deviation of noise on a smooth signal.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.noise import fit_noise
    >>> fit_noise([np.random.default_rng(0).normal(size=1000)]).law
    'white'
    """
    series = [values[rows] for values in series for rows in stretches(values)]
    series = [values - values.mean() for values in series if len(values) > 1]
    power = sum(values @ values for values in series) / max(sum(map(len, series)), 1)
    size = float(np.sqrt(power))
    step = quantisation_step(readings)
    if not power > 0.0:
        return NoiseModel("white", 0.0, quantisation=step)
    bins = _binned(series, power)
    count = bins[-1].sum()
    best = "white", 0.0, 0.0
    least = _deviance(*bins, *best)
    for law, largest in (("autoregressive", 1.0), ("power_law", STEEPEST)):
        starts = [(0.5 * largest, 0.5), (0.9 * largest, 0.5), (0.25 * largest, 0.9)]
        start = min(starts, key=lambda x, law=law: _deviance(*bins, law, *x))
        bounds = [(0.0, largest * (1.0 - 1.0 / count)), (0.0, 1.0)]
        fit = minimize(lambda x, law=law: _deviance(*bins, law, *x) / count, start, bounds=bounds)
        deviance = count * fit.fun + 2.0 * np.log(count)
        if deviance < least:
            best, least = (law, *map(float, fit.x)), deviance
    model = NoiseModel(best[0], size, *best[1:], quantisation=step)
    innovations = np.concatenate(model.innovations(series))
    limit = norm.isf(0.5 / count) * np.median(np.abs(innovations)) / norm.ppf(0.75)
    count = np.count_nonzero(np.abs(innovations) > limit) if limit > 0.0 else 0
    # of normal noise, the expected number is one; more than four occur in one series of 300
    return replace(model, outliers=count / len(innovations) if count > 4 else 0.0)


def quantisation_step(readings):
    """Return the step of a converter, 0 where readings are not multiples of a common step."""
    levels = np.unique(np.concatenate([*readings, np.zeros(0)]))
    n = sum(map(len, readings))
    if len(levels) < 3 or 2 * len(levels) > n:
        return 0.0
    steps = np.diff(levels)
    step = steps.min()
    # readings in a file are rounded decimals of the multiples
    near = np.abs(steps / step - np.round(steps / step)) < 0.05
    return float(steps.sum() / np.round(steps / step).sum()) if near.all() else 0.0


def _spectrum(law, frequency, coefficient, share=1.0, counts=None):
    if law == "white":
        return np.ones_like(frequency)
    if law == "autoregressive":
        a = coefficient
        shape = (1.0 - a * a) / (1.0 - 2.0 * a * np.cos(2.0 * np.pi * frequency) + a * a)
    else:
        shape = frequency**-coefficient
        shape = shape / np.average(shape, weights=counts)
    return 1.0 - share + share * shape


def _binned(series, power):
    """Return frequency, mean square and number of coefficients in bins of a few per cent width."""
    frequency = np.concatenate(
        [np.arange(1, len(values)) / (2.0 * len(values)) for values in series]
    )
    powers = np.concatenate([np.square(dct(values, norm="ortho")[1:]) for values in series]) / power
    _, bins = np.unique(np.log(frequency) // _WIDTH, return_inverse=True)
    counts = np.bincount(bins)
    return np.bincount(bins, frequency) / counts, np.bincount(bins, powers) / counts, counts


def _deviance(frequency, powers, counts, law, coefficient, share):
    """Return minus twice Whittle's log likelihood up to a constant, maximised over the variance."""
    spectrum = _spectrum(law, frequency, coefficient, share, counts)
    mean = np.average(powers / spectrum, weights=counts)
    return counts.sum() * np.log(mean) + counts @ np.log(spectrum)
