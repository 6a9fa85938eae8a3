r"""Tests for changes of parameters, by sums of innovations times their sensitivities.

Where parameters have changed by :math:`\delta`, innovations that are white and of unit variance
become

.. math:: e_k = \psi_k^T \delta + \varepsilon_k, \qquad
   s = \sum_k \psi_k e_k \sim N(M \delta, M + M M_0^{-1} M), \qquad M = \sum_k \psi_k \psi_k^T

with their sensitivities :math:`\psi` (the local approach [1]_). The second term of the covariance
is there since parameters are known no better than the records of the fit have told, with their
information :math:`M_0`. So with :math:`s' = (I + M M_0^{-1})^{-1} s`, whose covariance without a
change is the information that is left, :math:`M' = (M^{-1} + M_0^{-1})^{-1}`,

.. math:: T = s'^T M'^{-1} s'

is distributed as chi-square where nothing has changed, whatever the drive and however alike the
sensitivities are, with as many degrees of freedom :math:`r` as directions of :math:`\delta` are
seen; as F, since the variance comes from finitely many samples.

**Misfit.** A model that is close to its device and not exact leaves a misfit :math:`m_k` beside
the noise. It follows from the history of the drive, so that its scores :math:`\sum_k \psi_k m_k`
add up where the drive repeats itself, whatever they are on average over the records of the fit.
It raises the mean of T from :math:`r` by its energy in the directions of the sensitivities,
:math:`c = \max_\delta (\delta^T \sum_k \psi_k m_k)^2 / \delta^T M \delta`. Over a sum of
stretches with the scores :math:`s_b` and the information :math:`M_b`, by Cauchy and Schwarz,

.. math:: \Big(\sum_b \delta^T s_b\Big)^2 \leq \sum_b \frac{(\delta^T s_b)^2}{\delta^T M_b
   \delta} \, \sum_b \delta^T M_b \delta, \qquad \text{so that} \quad c \leq \sum_b c_b :

however coherent a misfit is, its energy grows no faster than the length. With :math:`\lambda`, the
largest energy of a block in sums over the records of the fit, a sum over :math:`n` blocks has a T
of the mean :math:`r + n \lambda` at the most, and this mean scales the limit (Wedderburn,
*Biometrika*, 1974). So the level holds, from above, for a device whose misfit is nowhere larger
than in the worst sums of the fit; changes that move the response less than the misfit does are not
found.

The fit has made the sum of all its scores zero, :math:`M_0` their information. The score of a part
of it has the covariance :math:`M_b - M_b M_0^{-1} M_b`, and T with this one is that of the part
held out: of the score at the parameters that the rest of the records gives, and its own covariance.
A misfit has the same sign where drives are alike, so that sums are taken over blocks that are
neighbours in time, and over neighbours in amplitude and in rate. The mean of T over the sums of a
length is that of F where the model is exact. It is larger where scores are coherent, and smaller
where the misfit is a large part of what counts as noise and less so of the scores. Nor is the
variance the same everywhere then, whose own score is :math:`\sum_k (e_k^2 - 1)`. Where no mean
differs significantly, after Bonferroni, :math:`\lambda` is zero; else it is the largest
:math:`(T - q) / n` of all these sums, :math:`q` being what the largest of as many T of noise
exceeds about once: a quantile of F.

**Lengths.** Sums are taken over blocks of samples and over 2, 4, 8, ... of them, side by side. A
test over :math:`n` samples comes once in :math:`n` samples, so that with :math:`J` lengths and the
level :math:`\alpha n / J` of each there are :math:`\alpha` hits a sample, at the most:
expectations add up, however much the sums depend on each other, and hits at the end of one block
are one alarm.

.. [1] Zhang, Basseville and Benveniste, *Automatica*, 1994.
"""

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.stats import f as f_distribution

_SEEN = 1e-9  # of the largest information: what is less is lost in the rounding of differences
_LEVEL = 0.05  # at which sums of the fit are not those of noise, all together


def whitening(series):
    """Return the autoregressive filter (order + 1,) that makes stretches of noise white.

    Its coefficients follow from the autocovariance (Yule, *Philosophical Transactions of the Royal
    Society A*, 1927). Of the orders up to 10 log10 n it has the one with the least criterion of
    Schwarz, *Annals of Statistics*, 1978.
    """
    n = sum(map(len, series))
    orders = range(min(int(10.0 * np.log10(n)), min(map(len, series)) - 1) + 1)
    covariance = np.array([sum(e[lag:] @ e[: len(e) - lag] for e in series) / n for lag in orders])
    if covariance[0] == 0.0:
        return np.ones(1)
    best, least = np.ones(1), n * np.log(covariance[0])
    for order in orders[1:]:
        weights = solve_toeplitz(covariance[:order], covariance[1 : order + 1])
        left = covariance[0] - weights @ covariance[1 : order + 1]
        if left <= 0.0:
            break
        criterion = n * np.log(left) + order * np.log(n)
        if criterion < least:
            best, least = np.append(1.0, -weights), criterion
    return best


class LocalTests:
    """Tests over blocks of samples and over 2, 4, 8, ... of them, as the blocks come.

    Parameters
    ----------
    scores : ndarray of shape (n_blocks, p)
        Sums over the blocks of the fit, in all zero.
    information : ndarray of shape (n_blocks, p, p)
        Of each of these blocks.
    dof : int
        Degrees of freedom of the variance.
    false_alarms : float
        Alarms a sample.
    block : int
        Samples of a block.
    orders : sequence of ndarray of shape (n_blocks,)
        Numbers of the blocks, sorted by what else than time may make the misfit of two alike.
    energies : ndarray of shape (n_blocks,)
        Sums of the squares of the innovations, of unit variance, over the blocks of the fit.
    fourth : float, default=3
        Mean fourth power of the innovations; of normal noise it is three.

    Attributes
    ----------
    known : ndarray of shape (p, p)
        Information of the fit.
    misfit : float
        Largest energy of a block's misfit, of the variance of the noise; zero of an exact model.
    limits : ndarray of shape (n_lengths, 1 + p)
        Of T, for each length and each number of degrees of freedom.
    """

    def __init__(
        self, scores, information, dof, false_alarms, block, orders=(), energies=None, fourth=3.0
    ):
        self.known = information.sum(axis=0)
        orders = (slice(None), *orders)
        chances, sizes = _told_by(scores, information, orders, dof)
        if energies is not None:
            spread = np.full((len(energies), 1, 1), block * (fourth - 1.0))
            chances += _told_by((energies - energies.mean())[:, None], spread, orders, dof)[0]
        is_exact = min(chances, default=1.0) * len(chances) >= _LEVEL
        self.misfit = 0.0 if is_exact else max([*sizes, 0.0])
        ranks, blocks = np.arange(1, len(self.known) + 1), 2 ** np.arange(len(scores).bit_length())
        levels = np.minimum(false_alarms * block * blocks / len(blocks), 1.0)[:, None]
        means = ranks + self.misfit * blocks[:, None]
        limits = means * f_distribution.isf(levels, ranks, dof)
        self.limits = np.column_stack([np.full(len(blocks), np.inf), limits])
        self.reset()

    def reset(self):
        """Forget all blocks."""
        self._waiting = [None] * len(self.limits)  # sums that wait for their neighbours

    def decide(self, scores, information):
        """Return whether there is an alarm at the end of each block.

        Parameters
        ----------
        scores : ndarray of shape (n_blocks, p)
        information : ndarray of shape (n_blocks, p, p)
        """
        alarms = np.zeros(len(scores), dtype=bool)
        sums, ends = (scores, information), np.arange(len(scores))
        for level, limits in enumerate(self.limits):
            statistic, rank = statistics(*self._left(*sums))
            alarms[ends[statistic > limits[rank]]] = True
            sums, ends = self._paired(level, sums, ends)
            if not len(ends):
                break
        return alarms

    def _left(self, scores, information):
        """Return s' and M' of stacked sums."""
        taken, left = _beside(information, information + self.known)
        return scores - (taken @ scores[:, :, None])[:, :, 0], left

    def _paired(self, level, sums, ends):
        """Return sums of twice the length, and the last blocks of them."""
        if self._waiting[level] is not None:
            both = zip(self._waiting[level], sums, strict=True)
            sums = [np.concatenate([a[None], b]) for a, b in both]
            ends = np.append(-1, ends)
        self._waiting[level] = [part[-1].copy() for part in sums] if len(ends) % 2 else None
        return _in_pairs(sums), ends[1::2]


def _in_pairs(sums):
    """Return sums of twice the length; the last of an odd number is left out."""
    even = len(sums[0]) // 2 * 2
    return [part[:even:2] + part[1:even:2] for part in sums]


def _beside(information, whole):
    """Return M W^-1 and M - M W^-1 M of stacked M."""
    taken = information @ np.linalg.pinv(whole, _SEEN, hermitian=True)
    left = information - taken @ information
    return taken, (left + left.swapaxes(1, 2)) / 2.0


def statistics(scores, information):
    """Return T and its degrees of freedom for stacked sums and their covariances."""
    size = np.sqrt(np.maximum(np.einsum("kii->ki", information), 0.0))
    size[size == 0.0] = 1.0
    values, vectors = np.linalg.eigh(information / (size[:, :, None] * size[:, None, :]))
    parts = np.einsum("kpi,kp->ki", vectors, scores / size)
    seen = values > _SEEN * values[:, -1:]
    values[~seen] = 1.0
    return np.sum(np.where(seen, parts**2 / values, 0.0), axis=1), seen.sum(axis=1)


def _told_by(scores, information, orders, dof):
    """Return how likely noise has the mean T of sums of each length, and the largest energies.

    The energies are those of a misfit, for each block.
    """
    known, chances, sizes = information.sum(axis=0), [], []
    for blocks, sums in _all_sums((scores, information), orders):
        statistic, rank = statistics(sums[0], _beside(sums[1], known)[1])
        # in all, scores are zero: one follows from the others
        own = rank.sum() * (1.0 - 1.0 / len(rank))
        if own > 0.0:
            mean, noise = statistic.sum() / rank.sum(), f_distribution(own, dof)
            chances.append(2.0 * min(noise.sf(mean), noise.cdf(mean)))
            largest = rank * f_distribution.isf(1.0 / len(rank), np.maximum(rank, 1), dof)
            sizes.append(np.max(statistic - largest) / blocks)
    return chances, sizes


def _all_sums(parts, orders):
    """Yield blocks, and sums of so many neighbours in each order; single ones have none."""
    yield 1, parts
    for order in orders:
        sums, blocks = _in_pairs([part[order] for part in parts]), 2
        while len(sums[0]) > 1:
            yield blocks, sums
            sums, blocks = _in_pairs(sums), 2 * blocks
