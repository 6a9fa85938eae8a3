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
sensitivities are, with as many degrees of freedom as directions of :math:`\delta` are seen; as F,
since the variance comes from finitely many samples. A model that is not all of its device leaves
innovations that go with the drive, whose sums vary more: where those of the fit do so significantly
at a length, their mean T over its degrees of freedom scales the limits there (Wedderburn,
*Biometrika*, 1974).

Sums are taken over blocks of samples and over 2, 4, 8, ... of them, side by side. A test over
:math:`n` samples comes once in :math:`n` samples, so that with :math:`J` lengths and the level
:math:`\alpha n / J` of each there are :math:`\alpha` hits a sample, at the most: expectations add
up, however much the sums depend on each other, and hits at the end of one block are one alarm.

.. [1] Zhang, Basseville and Benveniste, *Automatica*, 1994.
"""

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.stats import chi2
from scipy.stats import f as f_distribution

_SEEN = 1e-9  # of the largest information: what is less is lost in the rounding of differences
_LEVEL = 0.05  # at which sums of the fit vary more than noise does


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
    """

    def __init__(self, scores, information, dof, false_alarms, block):
        self.known = information.sum(axis=0)
        ranks = np.arange(1, len(self.known) + 1)
        spread, lengths = [], []
        sums = scores, information
        while len(sums[0]):
            spread.append(_dispersion(*sums, len(ranks), dof))
            lengths.append(block * 2 ** len(lengths))
            even = len(sums[0]) // 2 * 2
            sums = [part[:even:2] + part[1:even:2] for part in sums]
        levels = np.minimum(false_alarms * np.array(lengths) / len(lengths), 1.0)
        size, own = np.transpose(spread)[:, :, None]
        limits = size * ranks * f_distribution.isf(levels[:, None], ranks, own)
        self.limits = np.column_stack([np.full(len(levels), np.inf), limits])
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
        taken = information @ np.linalg.pinv(information + self.known, _SEEN, hermitian=True)
        left = information - taken @ information
        return scores - (taken @ scores[:, :, None])[:, :, 0], (left + left.swapaxes(1, 2)) / 2.0

    def _paired(self, level, sums, ends):
        """Return sums of twice the length, and the last blocks of them."""
        if self._waiting[level] is not None:
            both = zip(self._waiting[level], sums, strict=True)
            sums = [np.concatenate([a[None], b]) for a, b in both]
            ends = np.append(-1, ends)
        odd = len(ends) % 2
        self._waiting[level] = [part[-1].copy() for part in sums] if odd else None
        even = len(ends) - odd
        return [part[:even:2] + part[1:even:2] for part in sums], ends[1:even:2]


def statistics(scores, information):
    """Return T and its degrees of freedom for stacked sums and their covariances."""
    size = np.sqrt(np.maximum(np.einsum("kii->ki", information), 0.0))
    size[size == 0.0] = 1.0
    values, vectors = np.linalg.eigh(information / (size[:, :, None] * size[:, None, :]))
    parts = np.einsum("kpi,kp->ki", vectors, scores / size)
    seen = values > _SEEN * values[:, -1:]
    values[~seen] = 1.0
    return np.sum(np.where(seen, parts**2 / values, 0.0), axis=1), seen.sum(axis=1)


def _dispersion(scores, information, p, dof):
    """Return how much more than noise sums of the fit vary, and the degrees of freedom of that."""
    statistic, rank = statistics(scores, information)
    own = rank.sum() - p  # the fit has made p of the sums over all blocks zero
    if own > 0 and chi2.sf(statistic.sum(), own) < _LEVEL:
        return statistic.sum() / own, own
    return 1.0, dof
