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
since the variance comes from finitely many samples.

Sums are taken over blocks of samples and over 2, 4, 8, ... of them, side by side. A test over
:math:`n` samples comes once in :math:`n` samples, so that with :math:`J` lengths and the level
:math:`\alpha n / J` of each there are :math:`\alpha` hits a sample, at the most: expectations add
up, however much the sums depend on each other, and hits at the end of one block are one alarm.

Which parameter it is: for one in the direction :math:`d`, :math:`T_d = (d^T s')^2 / d^T M' d` is
the largest, but for chance. Another direction explains no more than the two together, and these
more than :math:`d` alone by a chi-square variable of one degree of freedom. So it is ruled out
that :math:`d` alone has changed where the best direction is ahead by more.

.. [1] Q. Zhang, M. Basseville, A. Benveniste, "Early warning of slight changes in systems",
   Automatica 30(1), 1994.
"""

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.stats import chi2
from scipy.stats import f as f_distribution

_SEEN = 1e-9  # of the largest information: what is less is lost in the rounding of differences
_LEVEL = 0.05  # at which suspects are ruled out, all together


def whitening(series):
    """Return the autoregressive filter (order + 1,) that makes stretches of noise white.

    Its coefficients follow from the autocovariance (G. U. Yule, "On a method of investigating
    periodicities in disturbed series", Phil. Trans. Royal Society A 226, 1927). Of the orders up to
    10 log10 n it has the one with the least criterion of G. Schwarz, "Estimating the dimension of a
    model", Annals of Statistics 6(2), 1978.
    """
    n = sum(map(len, series))
    orders = range(min(int(10.0 * np.log10(n)), min(map(len, series)) - 1) + 1)
    covariance = np.array([sum(e[lag:] @ e[: len(e) - lag] for e in series) / n for lag in orders])
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
    known : ndarray of shape (p, p)
        Information of the fit, with a diagonal of ones.
    dof : int
        Degrees of freedom of the variance.
    false_alarms : float
        Alarms a sample.
    lengths : sequence of int
        Samples of the sums, each of twice as many as before.
    """

    def __init__(self, known, dof, false_alarms, lengths):
        self.known = known
        levels = np.minimum(false_alarms * np.array(lengths) / len(lengths), 1.0)
        ranks = np.arange(1, len(known) + 1)
        limits = ranks * f_distribution.isf(levels[:, None], ranks, dof)
        self.limits = np.column_stack([np.full(len(lengths), np.inf), limits])
        self.reset()

    def reset(self):
        """Forget all blocks."""
        self._waiting = [None] * len(self.limits)  # sums that wait for their neighbours
        self._changed = None  # sums since the first alarm

    def decide(self, scores, information):
        """Return whether there is an alarm at the end of each block.

        Parameters
        ----------
        scores : ndarray of shape (n_blocks, p)
        information : ndarray of shape (n_blocks, p, p)
        """
        alarms = np.zeros(len(scores), dtype=bool)
        first = len(scores), None
        sums, ends = (scores, information), np.arange(len(scores))
        for level, limits in enumerate(self.limits):
            statistic, rank = self._statistics(*sums)
            hits = np.flatnonzero(statistic > limits[rank])
            alarms[ends[hits]] = True
            if len(hits) and ends[hits[0]] < first[0]:
                first = ends[hits[0]], [part[hits[0]] for part in sums]
            sums, ends = self._paired(level, sums, ends)
            if not len(ends):
                break
        if self._changed is None and first[1] is not None:
            self._changed = [np.zeros_like(part) + part for part in first[1]]
            later = slice(first[0] + 1, None)
        else:
            later = slice(None)
        if self._changed is not None:
            self._changed[0] += scores[later].sum(axis=0)
            self._changed[1] += information[later].sum(axis=0)
        return alarms

    def suspects(self, directions):
        """Return the likely directions (m, p), by number, the best first; none before an alarm."""
        if self._changed is None:
            return []
        scores, information = (part[0] for part in self._left(*(p[None] for p in self._changed)))
        own = np.einsum("mp,pq,mq->m", directions, information, directions)
        with np.errstate(divide="ignore", invalid="ignore"):
            explained = np.where(own > 0.0, (directions @ scores) ** 2 / own, -np.inf)
        order = np.argsort(-explained)
        apart = chi2.isf(_LEVEL / max(len(order) - 1, 1), 1)
        return [i for i in order if explained[order[0]] - explained[i] <= apart]

    def _left(self, scores, information):
        """Return s' and M' of stacked sums."""
        taken = information @ np.linalg.pinv(information + self.known, _SEEN, hermitian=True)
        left = information - taken @ information
        return scores - (taken @ scores[:, :, None])[:, :, 0], (left + left.swapaxes(1, 2)) / 2.0

    def _statistics(self, scores, information):
        """Return T and its degrees of freedom for stacked sums."""
        scores, information = self._left(scores, information)
        size = np.sqrt(np.maximum(np.einsum("kii->ki", information), 0.0))
        size[size == 0.0] = 1.0
        values, vectors = np.linalg.eigh(information / (size[:, :, None] * size[:, None, :]))
        parts = np.einsum("kpi,kp->ki", vectors, scores / size)
        seen = values > _SEEN * values[:, -1:]
        values[~seen] = 1.0
        return np.sum(np.where(seen, parts**2 / values, 0.0), axis=1), seen.sum(axis=1)

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
