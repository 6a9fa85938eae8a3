r"""Tests for changes of parameters, by sums of innovations times their sensitivities.

If parameters have changed by :math:`\delta`, innovations that were white with unit variance become

.. math:: e_k = \psi_k^T \delta + \varepsilon_k, \qquad
   s = \sum_k \psi_k e_k \sim N(M \delta, M + M M_0^{-1} M), \qquad M = \sum_k \psi_k \psi_k^T

with their sensitivities :math:`\psi` (the local approach [1]_). The second term of the covariance
is the uncertainty of the fit, whose records have the information :math:`M_0` on the parameters. So
with :math:`s' = (I + M M_0^{-1})^{-1} s`, whose covariance without a change is
:math:`M' = (M^{-1} + M_0^{-1})^{-1}`,

.. math:: T = s'^T M'^{-1} s'

is distributed as chi-square where nothing has changed, for any drive and however collinear the
sensitivities are, with as many degrees of freedom :math:`r` as directions of :math:`\delta` are
seen; more exactly as F (times r), since the variance is estimated from finitely many samples.

**Misfit.** A model that is close to its device and not exact has a misfit :math:`m_k` in addition
to the noise. It is determined by the history of the drive, so its scores
:math:`\sum_k \psi_k m_k` add up where the drive repeats itself, even if they average to zero over
the records of the fit. It raises the mean of T from :math:`r` by its energy in the directions of
the sensitivities, :math:`c = \max_\delta (\delta^T \sum_k \psi_k m_k)^2 / \delta^T M \delta`. Over
a sum of stretches with the scores :math:`s_b` and the information :math:`M_b`, by Cauchy and
Schwarz,

.. math:: \Big(\sum_b \delta^T s_b\Big)^2 \leq \sum_b \frac{(\delta^T s_b)^2}{\delta^T M_b
   \delta} \, \sum_b \delta^T M_b \delta, \qquad \text{so that} \quad c \leq \sum_b c_b :

however coherent a misfit is, its energy grows no faster than the length. With :math:`\lambda`, the
largest energy per block in sums over the records of the fit, T of a sum over :math:`n` blocks has
at most the mean :math:`r + n \lambda`, and this mean scales the limit (Wedderburn, *Biometrika*,
1974). So the rate of false alarms is kept for a device whose misfit is nowhere larger than in the
worst sums of the fit; changes that move the response less than the misfit does are not found.

The fit has made the sum of all its scores zero; their information is :math:`M_0`. The score of a
part of its records has the covariance :math:`M_b - M_b M_0^{-1} M_b`, and T with this covariance is
that of the part held out: of its score at the parameters estimated from the rest of the records. A
misfit has the same sign under similar drives, so sums are taken over blocks that are neighbours in
time, in amplitude and in rate. If the model is exact, the mean of T over the sums of one length is
that of F. It is larger where scores are coherent, and smaller where the misfit is a larger part of
the estimated noise than of the scores. The variance then is not the same everywhere either; its
own score is :math:`\sum_k (e_k^2 - 1)`. If no mean differs significantly, after Bonferroni,
:math:`\lambda` is zero; else it is the largest :math:`(T - q) / n` of all these sums, where
:math:`q` is the quantile of F that the largest of as many T of noise exceeds about once.

**Lengths.** Sums are taken over single blocks of samples and, in parallel, over 2, 4, 8, ... of
them. A test over :math:`n` samples is made once in :math:`n` samples, so with :math:`J` lengths and
the level :math:`\alpha n / J` for each there are at most :math:`\alpha` false alarms per sample:
expectations add up, however dependent the sums are, and several hits at the end of one block are
one alarm.

.. [1] Zhang, Basseville and Benveniste, *Automatica*, 1994.
"""

import numpy as np
from scipy.stats import f as f_distribution

_SEEN = 1e-9  # fraction of the largest information; below it, rounding of differences prevails
_LEVEL = 0.05  # family-wise level of the tests whether the sums of the fit are those of noise


class LocalTests:
    """Sequential tests over single blocks of samples and over 2, 4, 8, ... of them.

    Parameters
    ----------
    scores : ndarray of shape (n_blocks, p)
        Scores of the blocks of the fit; their sum is zero.
    information : ndarray of shape (n_blocks, p, p)
        Information of each of these blocks.
    dof : int
        Degrees of freedom of the estimate of the variance.
    false_alarms : float
        Largest mean number of false alarms per sample.
    block : int
        Number of samples of a block.
    orders : sequence of ndarray of shape (n_blocks,)
        Indices of the blocks, each sorted by a property other than time, of which blocks with
        similar values may have a similar misfit.
    energies : ndarray of shape (n_blocks,)
        Sums of squared innovations, of unit variance, over the blocks of the fit.
    fourth : float, default=3
        Mean fourth power of the innovations; three for normal noise.

    Attributes
    ----------
    known : ndarray of shape (p, p)
        Information of the fit.
    misfit : float
        Largest energy of the misfit per block, as a multiple of the variance of the noise; zero
        for an exact model.
    limits : ndarray of shape (n_lengths, 1 + p)
        Limits of T, for each length and each number of degrees of freedom.
    """

    def __init__(
        self, scores, information, dof, false_alarms, block, orders=(), energies=None, fourth=3.0
    ):
        self.known = information.sum(axis=0)
        orders = (slice(None), *orders)
        p_values, sizes = _misfit_tests(scores, information, orders, dof)
        if energies is not None:
            spread = np.full((len(energies), 1, 1), block * (fourth - 1.0))
            deviations = (energies - energies.mean())[:, None]
            p_values += _misfit_tests(deviations, spread, orders, dof)[0]
        is_exact = min(p_values, default=1.0) * len(p_values) >= _LEVEL
        self.misfit = 0.0 if is_exact else max([*sizes, 0.0])
        ranks, blocks = np.arange(1, len(self.known) + 1), 2 ** np.arange(len(scores).bit_length())
        levels = np.minimum(false_alarms * block * blocks / len(blocks), 1.0)[:, None]
        means = ranks + self.misfit * blocks[:, None]
        limits = means * f_distribution.isf(levels, ranks, dof)
        self.limits = np.column_stack([np.full(len(blocks), np.inf), limits])
        self.reset()

    def reset(self):
        """Discard all blocks."""
        self._waiting = [None] * len(self.limits)  # sums of odd number, to be paired with the next

    def decide(self, scores, information):
        """Return whether there is an alarm at the end of each block, (n_blocks,) of bool.

        Parameters
        ----------
        scores : ndarray of shape (n_blocks, p)
            Scores of the next blocks.
        information : ndarray of shape (n_blocks, p, p)
            Information of each of them.
        """
        alarms = np.zeros(len(scores), dtype=bool)
        sums, ends = (scores, information), np.arange(len(scores))
        for level, limits in enumerate(self.limits):
            statistic, rank = statistics(*self._with_uncertainty_of_fit(*sums))
            alarms[ends[statistic > limits[rank]]] = True
            sums, ends = self._paired(level, sums, ends)
            if not len(ends):
                break
        return alarms

    def _with_uncertainty_of_fit(self, scores, information):
        """Return s' and M' of stacked sums."""
        weights, reduced = _reduced(information, information + self.known)
        return scores - (weights @ scores[:, :, None])[:, :, 0], reduced

    def _paired(self, level, sums, ends):
        """Return sums of twice the length, and the indices of their last blocks."""
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


def _reduced(information, total):
    """Return M W^-1 and M - M W^-1 M of stacked M (n, p, p), with W the total information."""
    weights = information @ np.linalg.pinv(total, _SEEN, hermitian=True)
    reduced = information - weights @ information
    return weights, (reduced + reduced.swapaxes(1, 2)) / 2.0


def statistics(scores, information):
    """Return T and its degrees of freedom for stacked sums and their covariances."""
    size = np.sqrt(np.maximum(np.einsum("kii->ki", information), 0.0))
    size[size == 0.0] = 1.0
    # in units of each parameter's own information, so that the rank does not depend on units
    values, vectors = np.linalg.eigh(information / (size[:, :, None] * size[:, None, :]))
    components = np.einsum("kpi,kp->ki", vectors, scores / size)
    is_determined = values > _SEEN * values[:, -1:]
    values[~is_determined] = 1.0
    squares = np.where(is_determined, components**2 / values, 0.0)
    return np.sum(squares, axis=1), is_determined.sum(axis=1)


def _misfit_tests(scores, information, orders, dof):
    """Return p-values of the mean T of each length and order, and largest energies per block.

    The p-values suppose that there is no misfit; an energy is that of the misfit in the worst sum.
    """
    known, p_values, sizes = information.sum(axis=0), [], []
    for blocks, sums in _all_sums((scores, information), orders):
        statistic, rank = statistics(sums[0], _reduced(sums[1], known)[1])
        # the sum of all scores is zero, so one of them follows from the others
        n_free = rank.sum() * (1.0 - 1.0 / len(rank))
        if n_free > 0.0:
            mean, noise = statistic.sum() / rank.sum(), f_distribution(n_free, dof)
            p_values.append(2.0 * min(noise.sf(mean), noise.cdf(mean)))
            largest = rank * f_distribution.isf(1.0 / len(rank), np.maximum(rank, 1), dof)
            sizes.append(np.max(statistic - largest) / blocks)
    return p_values, sizes


def _all_sums(parts, orders):
    """Yield a number of blocks and the sums over so many neighbours, for each length and order."""
    yield 1, parts  # single blocks, for which the order does not matter
    for order in orders:
        sums, blocks = _in_pairs([part[order] for part in parts]), 2
        while len(sums[0]) > 1:
            yield blocks, sums
            sums, blocks = _in_pairs(sums), 2 * blocks
