r"""Standard errors under coloured noise.

With the Jacobian :math:`J` of a model's prediction, :math:`H = J^T J` and noise of the covariance
matrix :math:`\Gamma`, the error of least squares has the covariance

.. math:: H^{-1} \Omega H^{-1}, \qquad \Omega = J^T \Gamma J = \frac{1}{2 \pi}
   \int S(\omega) \, \tilde J(\omega)^* \tilde J(\omega)^T \, d\omega ,

where :math:`S` is the spectrum of the noise and tildes are Fourier transforms [1]_; records add up,
since their noise is independent. For white noise it is :math:`\sigma^2 H^{-1}`. The Jacobian of a
free run depends on the drive, not on the noise, so only :math:`S` has to be estimated. Estimates of
:math:`\Omega` from products of the scores :math:`J_t r_t` with a kernel over their lags (Newey and
West [2]_), which do not use that, need far longer records where the drive is slow.

**The spectrum** is that of an autoregression of the residual, whose order and kind Akaike's
criterion selects (:func:`skhyst.noise.autoregression`).

**Effective sample size.** For a parameter, n samples of coloured noise are worth n times the ratio
of its variance under white noise to its variance. The spectrum at the relevant frequencies is a
mean over about as many values, so that intervals are somewhat too narrow if the effective sample
size is small, just as intervals of the normal distribution are compared with Student's.

**Degrees of freedom of the fit.** The residual is :math:`r = (I - P) e`, and the projection
:math:`P` on the Jacobian removes most noise where the drive has its power, which is where the
spectrum matters. It removes on average about :math:`h S` of the periodogram, with :math:`h = \tilde
J^* H^{-1} \tilde J`. With the last estimate of the spectrum, this is added again, like the
expectation step of Dempster, Laird and Rubin [3]_ for missing data; for white noise it amounts to
the division by n - p.

References
----------
.. [1] Grenander and Rosenblatt, *Statistical Analysis of Stationary Time Series*, 1957, chapter 7.
.. [2] Newey and West, *Review of Economic Studies*, 1994.
.. [3] Dempster, Laird and Rubin, *Journal of the Royal Statistical Society B*, 1977.
"""

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from ..noise import autoregression

_STEPS = 3  # expectation steps for the noise absorbed by the fit
FEWEST = 2  # independent samples, below which no standard error can be estimated


def coloured_covariance(rows, root, n_samples):
    """Return the covariance of least squares, or None if the noise is white.

    Parameters
    ----------
    rows : callable
        Returns an iterator over the records: Jacobian (n, p), residual (n,), an orthonormal basis
        (n, d) of coefficients per record that were projected out of both, a mask of valid samples
        (n,), and the interval in s. Rows without a valid sample are zero.
    root : ndarray of shape (p, k)
        ``J @ root`` has orthonormal columns, for the k directions that are determined.
    n_samples : float
        Number of samples of all records, a sample of weight 2 counted twice.

    Returns
    -------
    ndarray of shape (p, p) or None
    """
    groups = {}
    for jacobian, residual, basis, counts, dt in rows():
        size = next_fast_len(2 * len(residual), real=True)
        sums = groups.setdefault(dt, _Residual()).powers(size, len(residual))
        sums[0] += _power(residual[:, None], size)
        sums[1] += _power(jacobian @ root, size) + _power(basis, size)
        sums[2] += _power(counts[:, None].astype(float), size)
    weight = n_samples / max(sum(group.n_counted for group in groups.values()), 1.0)
    noises = {dt: group.spectrum(weight) for dt, group in groups.items()}
    if all(noise.is_white for noise in noises.values()):
        return None
    total = np.zeros((root.shape[1],) * 2)
    for jacobian, residual, _, _, dt in rows():
        size = next_fast_len(2 * len(residual), real=True)
        spectrum = noises[dt].at(size)
        largest = spectrum.max() or 1.0
        # single precision: the columns are about orthonormal
        parts = rfft((jacobian @ root).astype(np.float32), size, axis=0)
        parts *= np.sqrt(_both_sides(size) / size * (spectrum / largest))[:, None]
        total += largest * np.real(parts.conj().T @ parts)
    return root @ total @ root.T


def penalised_covariance(problem, white, coloured, noise, weighed):
    """Return the covariance of penalised least squares, and the independent fraction of samples.

    The prior that a penalty represents has the covariance ``noise (n P)^-1``; under it the bias of
    the penalty counts as an error, too (Nychka, *Journal of the American Statistical Association*,
    1988). White noise has it in the inverse of the normal equations. With coloured noise, its
    variance is known only from the equivalent number of independent samples.

    Parameters
    ----------
    problem : OperatorProblem
        With the penalties P of each squared unknown, per sample.
    white : ndarray of shape (p, p)
        Covariance under white noise: ``noise`` times the inverse of the normal equations.
    coloured : ndarray of shape (p, p) or None
        That of :func:`coloured_covariance`.
    noise : float
        Variance.
    weighed : ndarray of int
        Numbers of the unknowns whose errors tell how many samples are independent.

    Returns
    -------
    covariance : ndarray of shape (p, p)
    independent : float
        At most 1; 1 for white noise.
    """
    if coloured is None:
        return white, 1.0
    if not (len(weighed) and noise > 0.0):
        return coloured, 1.0
    bias = (white * (problem.segment_weight.sum() * problem.penalty)) @ white / noise
    shrunk = 1.0 / (1.0 + problem.penalty[weighed])
    alone = np.diag(white - bias)[weighed]
    ratio = np.average(np.diag(coloured)[weighed] / alone, weights=shrunk)
    independent = min(1.0 / ratio, 1.0)
    return coloured + bias / independent, independent


@dataclass(frozen=True)
class _Spectrum:
    """Spectrum of an autoregression with ``weights`` (order + 1,).

    With missing samples, only a fraction ``share`` of the products of neighbours exists, so that
    the autoregression describes the noise plus ``extra`` white noise, which is subtracted.
    """

    weights: np.ndarray
    power: float
    extra: float = 0.0
    share: float = 1.0

    @property
    def is_white(self):
        """Whether there are no lags."""
        return len(self.weights) == 1

    def at(self, size):
        """Return the spectrum at the frequencies of a transform of this size."""
        folded = np.zeros(-(-len(self.weights) // size) * size)
        folded[: len(self.weights)] = self.weights
        spectrum = self.power / np.abs(rfft(folded.reshape(-1, size).sum(axis=0))) ** 2
        return np.maximum(spectrum - self.extra, 0.0) / self.share


class _Residual:
    """Sums of periodograms of records of one interval, by the lengths of their transforms."""

    def __init__(self):
        self._powers, self._lengths = {}, []

    def powers(self, size, length):
        """Return sums of powers, to be added to: of the residual, of the fit, and of the mask."""
        self._lengths.append(length)
        return self._powers.setdefault(size, np.zeros((3, size // 2 + 1)))

    @property
    def n_counted(self):
        """Number of valid samples."""
        return sum(irfft(sums[2], size)[0] for size, sums in self._powers.items())

    def spectrum(self, weight):
        """Return the spectrum of the noise; ``weight`` is the mean weight of a sample."""
        lags = np.arange(max(*self._lengths, 2))
        n_products = np.maximum(np.array(self._lengths)[:, None] - lags, 0).sum(axis=0)
        pairs = self._lags(2, 2) / np.maximum(n_products[:2], 1)
        products, absorbed = self._lags(0, len(lags)), self._lags(1, 1)[0]
        n = weight * self.n_counted
        noise = _Spectrum(np.ones(1), products[0] / max(n - absorbed, 1.0))
        for _ in range(_STEPS if pairs[1] > 0.0 else 0):  # 0: no two neighbours are both valid
            covariance = (products + self._lags(1, len(lags), noise)) / (weight * n_products[0])
            if not covariance[0] > 0.0:
                break
            filtered = autoregression(covariance, n)
            noise = _Spectrum(*filtered, (1.0 - pairs[1] / pairs[0]) * covariance[0], pairs[1])
        return noise

    def _lags(self, row, count, noise=None):
        """Return the autocovariances (count,) of a row of powers, times a spectrum if given."""
        total = np.zeros(count)
        for size, sums in self._powers.items():
            power = sums[row] if noise is None else sums[row] * noise.at(size)
            products = irfft(power, size)[:count]
            total[: len(products)] += products
        return total


def _power(columns, size):
    """Return the sum of the columns' powers at the frequencies of a transform."""
    total = np.zeros(size // 2 + 1)
    for column in columns.T:
        total += np.abs(rfft(column, size)) ** 2
    return total


def _both_sides(size):
    """Return the multiplicity of each frequency of a real transform in the two-sided one."""
    often = np.full(size // 2 + 1, 2.0)
    often[0] = 1.0
    if size % 2 == 0:
        often[-1] = 1.0
    return often
