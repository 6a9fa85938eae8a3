r"""What a sensor's noise is like: its colour, its converter, its outliers and lines.

Of noise that is stationary the discrete cosine transform has about independent coefficients
:math:`c_k`, of the variance :math:`S(f_k)`. Three spectra are compared, white noise, and white
noise under a first-order process or under a power law, as flicker noise has,

.. math:: S = \sigma^2 \qquad
   S = \sigma^2 \left(1 - s + s \frac{1 - a^2}{1 - 2 a \cos 2 \pi f + a^2}\right) \qquad
   S = \sigma^2 (1 - s + s\, b f^{-\beta})

by Whittle's likelihood [1]_, :math:`\sum_k \log S(f_k) + c_k^2 / S(f_k)`; the second and the third
have to gain enough for two more parameters (Schwarz [2]_). A spectrum with a peak fits none of
these: it shows a line, or an oscillation, and so structure.

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

STEEPEST = 4.0  # exponent of the spectrum: of white noise that is summed up twice
_MEMORY = 256  # past samples that predict the next
_WIDTH = 0.05  # of a bin of the spectrum, relative to its frequency


@dataclass(frozen=True)
class NoiseModel:
    """Noise of a sensor.

    Parameters
    ----------
    law : {"white", "autoregressive", "power_law"}
        Of its spectrum: constant, of a first-order process, or a power of the frequency.
    standard_deviation : float
        Units of the response.
    coefficient : float
        Correlation of neighbouring samples of the first-order process, or the exponent of one over
        the frequency (1 for flicker noise); 0 for white noise.
    share : float
        Part of the variance that has this law; the rest is white.
    outliers : float
        Fraction of the samples beyond the value that normal noise exceeds once in as many.
    quantisation : float
        Step of the converter, units of the response; 0 where readings show none. Of evenly spread
        readings its square over 12 is in the variance.
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

        It is that of the coloured part in a record of so many samples without its mean.

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
        found = [np.full(len(own), np.nan) for own in series]
        for new, own in zip(found, series, strict=True):
            for rows in stretches(own):
                new[rows] = lfilter(np.append(1.0, -self._forecast), 1.0, own[rows])
        return found

    def __str__(self):
        size = f"standard deviation {self.standard_deviation:.3g}"
        if self.law == "autoregressive":
            text = f"first-order noise, correlation {self.coefficient:.2f} a sample"
        elif self.law == "power_law":
            text = f"noise as one over the frequency to the power of {self.coefficient:.2f}"
        else:
            text = "white noise"
        parts = [f"{text}, {size}"]
        if 0.0 < self.share < 0.95:
            parts.append(f"{1.0 - self.share:.0%} of its power white")
        if self.outliers:
            parts.append(f"{self.outliers:.2%} outliers")
        if self.quantisation:
            parts.append(f"read in steps of {self.quantisation:.3g}")
        return "; ".join(parts)


def stretches(values):
    """Return the rows of each stretch of finite values."""
    known = np.flatnonzero(np.isfinite(values))
    ends = np.flatnonzero(np.diff(known) > 1) + 1
    return [slice(rows[0], rows[-1] + 1) for rows in np.split(known, ends) if len(rows)]


def fit_noise(series, readings=()):
    """Return the noise model that series of noise have.

    Parameters
    ----------
    series : sequence of ndarray
        Noise, sample by sample, NaN where unknown.
    readings : sequence of ndarray, optional
        What the sensor reads, for the step of its converter.

    Returns
    -------
    NoiseModel
        Of the law that Schwarz's criterion selects.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.noise import fit_noise
    >>> fit_noise([np.random.default_rng(0).normal(size=1000)]).law
    'white'
    """
    series = [own[rows] for own in series for rows in stretches(own)]
    series = [own - own.mean() for own in series if len(own) > 1]
    power = sum(own @ own for own in series) / max(sum(map(len, series)), 1)
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
        found = minimize(lambda x, law=law: _deviance(*bins, law, *x) / count, start, bounds=bounds)
        deviance = count * found.fun + 2.0 * np.log(count)
        if deviance < least:
            best, least = (law, *map(float, found.x)), deviance
    model = NoiseModel(best[0], size, *best[1:], quantisation=step)
    innovations = np.concatenate(model.innovations(series))
    usual = norm.isf(0.5 / count) * np.median(np.abs(innovations)) / norm.ppf(0.75)
    count = np.count_nonzero(np.abs(innovations) > usual) if usual > 0.0 else 0
    # chance gives one; more than four in one case of 300
    return replace(model, outliers=count / len(innovations) if count > 4 else 0.0)


def quantisation_step(readings):
    """Return the step of a converter, 0 where readings are no multiples of one."""
    levels = np.unique(np.concatenate([*readings, np.zeros(0)]))
    n = sum(map(len, readings))
    if len(levels) < 3 or 2 * len(levels) > n:
        return 0.0
    steps = np.diff(levels)
    step = steps.min()
    # the numbers are rounded, too
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
    """Return frequencies, mean squares and numbers of coefficients within a few per cent."""
    frequency = np.concatenate([np.arange(1, len(own)) / (2.0 * len(own)) for own in series])
    powers = np.concatenate([np.square(dct(own, norm="ortho")[1:]) for own in series]) / power
    _, bins = np.unique(np.log(frequency) // _WIDTH, return_inverse=True)
    counts = np.bincount(bins)
    return np.bincount(bins, frequency) / counts, np.bincount(bins, powers) / counts, counts


def _deviance(frequency, powers, counts, law, coefficient, share):
    """Return minus twice Whittle's log likelihood up to a constant, the variance at its best."""
    spectrum = _spectrum(law, frequency, coefficient, share, counts)
    mean = np.average(powers / spectrum, weights=counts)
    return counts.sum() * np.log(mean) + counts @ np.log(spectrum)
