r"""What the colour of the noise does to standard errors.

With the Jacobian :math:`J` of what a model predicts, :math:`H = J^T J` and noise whose covariance
matrix is :math:`\Gamma`, the error of least squares has the covariance

.. math:: H^{-1} \Omega H^{-1}, \qquad \Omega = J^T \Gamma J = \frac{1}{2 \pi}
   \int S(\omega) \, \tilde J(\omega)^* \tilde J(\omega)^T \, d\omega ,

where :math:`S` is the noise's spectrum and tildes are Fourier transforms [1]_; records add up,
their noise is independent. It is :math:`\sigma^2 H^{-1}` for white noise. The Jacobian of a free
run depends on the drive, not on the noise, so nothing but :math:`S` has to be estimated. Estimates
of :math:`\Omega` from products of the scores :math:`J_t r_t` with a kernel over their lags
(Newey and West [2]_), which do not make use of that, need far longer records where the drive is
slow.

**The spectrum** is that of an autoregression of the residual, a kernel whose shape and width
the residual chooses (:func:`skhyst.noise.autoregression`).

**How much the records are worth.** For a parameter, n samples of such noise tell as much as
:math:`n` times its variance for white noise over its variance, independent ones. The spectrum
at the frequencies that matter is then the mean of about as few numbers, and intervals are somewhat
too narrow, as those of the normal law in the place of Student's are.

**What the fit has taken.** The residual is :math:`r = (I - P) e`, and the projection :math:`P` on
the Jacobian takes most where the drive has its power, which is where the spectrum matters. Its part
of the periodogram is on average about :math:`h S` with :math:`h = \tilde J^* H^{-1} \tilde J`. With
the last estimate of the spectrum it is put back, as the expectation step of Dempster, Laird and
Rubin [3]_ does with what is missing; for white noise this is the division by n - p.

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

_STEPS = 3  # of what the fit has taken
FEWEST = 2  # independent samples, from which a standard error can be found at all


def coloured_covariance(rows, root, n_samples):
    """Return the covariance of least squares, or None where the noise is white.

    Parameters
    ----------
    rows : callable
        Returns an iterator over the records: Jacobian (n, p), residual (n,), an orthonormal basis
        (n, d) of what else was fitted to the record and is in neither, which samples count (n,),
        and the interval in s. Rows that do not count are zero.
    root : ndarray of shape (p, k)
        Makes the columns of the Jacobian orthonormal, those that are determined.
    n_samples : float
        Samples of all records, a sample of weight 2 counted twice.

    Returns
    -------
    ndarray of shape (p, p) or None
    """
    groups = {}
    for jacobian, residual, basis, counts, dt in rows():
        size = next_fast_len(2 * len(residual), real=True)
        own = groups.setdefault(dt, _Residual()).powers(size, len(residual))
        own[0] += _power(residual[:, None], size)
        own[1] += _power(jacobian @ root, size) + _power(basis, size)
        own[2] += _power(counts[:, None].astype(float), size)
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


@dataclass(frozen=True)
class _Spectrum:
    """That of an autoregression, (order + 1,), seen through a part of the pairs of neighbours.

    Where samples are missing, products of neighbours are fewer than squares, a ``share`` of all, so
    that the noise is seen with ``extra`` white noise, which is taken off again.
    """

    weights: np.ndarray
    power: float
    extra: float = 0.0
    share: float = 1.0

    @property
    def is_white(self):
        """Whether nothing is predicted."""
        return len(self.weights) == 1

    def at(self, size):
        """Return it at the frequencies of a transform."""
        folded = np.zeros(-(-len(self.weights) // size) * size)
        folded[: len(self.weights)] = self.weights
        seen = self.power / np.abs(rfft(folded.reshape(-1, size).sum(axis=0))) ** 2
        return np.maximum(seen - self.extra, 0.0) / self.share


class _Residual:
    """Sums of the power of records of one interval, by the lengths of their transforms."""

    def __init__(self):
        self._powers, self._lengths = {}, []

    def powers(self, size, length):
        """Return the sums of the residual's, of what was taken and of what counts, to add to."""
        self._lengths.append(length)
        return self._powers.setdefault(size, np.zeros((3, size // 2 + 1)))

    @property
    def n_counted(self):
        """Number of the samples that count."""
        return sum(irfft(own[2], size)[0] for size, own in self._powers.items())

    def spectrum(self, weight):
        """Return the noise's spectrum; ``weight`` is that of a sample on average."""
        lags = np.arange(max(*self._lengths, 2))
        whole = np.maximum(np.array(self._lengths)[:, None] - lags, 0).sum(axis=0)
        pairs = self._lags(2, 2) / np.maximum(whole[:2], 1)
        found, taken = self._lags(0, len(lags)), self._lags(1, 1)[0]
        n = weight * self.n_counted
        noise = _Spectrum(np.ones(1), found[0] / max(n - taken, 1.0))
        for _ in range(_STEPS if pairs[1] > 0.0 else 0):  # or there are no neighbours
            read = (found + self._lags(1, len(lags), noise)) / (weight * whole[0])
            if not read[0] > 0.0:
                break
            filtered = autoregression(read, n)
            noise = _Spectrum(*filtered, (1.0 - pairs[1] / pairs[0]) * read[0], pairs[1])
        return noise

    def _lags(self, row, count, noise=None):
        """Return sums of products over the lags, (count,), of powers times a spectrum."""
        total = np.zeros(count)
        for size, own in self._powers.items():
            power = own[row] if noise is None else own[row] * noise.at(size)
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
    """Return how often the frequencies of a transform are in the whole one."""
    often = np.full(size // 2 + 1, 2.0)
    often[0] = 1.0
    if size % 2 == 0:
        often[-1] = 1.0
    return often
