r"""The criterion: when the data show that one model predicts better than another.

Every decision of a search is this one comparison: whether an effect is claimed, whether an effect
claimed before is still needed, which candidates the data do not distinguish, and whether the
residual is structure (the rival then is a black box).

**The loss.** Each sample is predicted by a fit that has not seen it. With the residuals :math:`a_t`
of one model, :math:`b_t` of its rival, the weight :math:`w_t` of the sample (one, except for a
robust loss) and the difference of the predictions :math:`\Delta_t = a_t - b_t`, the rival gains

.. math:: d_t = w_t (a_t^2 - b_t^2) = w_t \Delta_t^2 + 2 w_t \Delta_t b_t .

Where both predict the same, for example at rest, nothing is gained or lost: such samples do not
affect the decision.

**Chance.** If the rival is right, :math:`b` is noise, and :math:`Q = \sum w_t \Delta_t b_t` is the
chance part of the sum of the gains, :math:`\sum d_t = \sum w_t \Delta_t^2 + 2 Q`. Neighbours in a
series depend on each other, so :math:`Q` is summed over blocks, :math:`Q_i`, of the length that
Politis and White [1]_ derive from the autocovariances :math:`R_k` of the series: where the noise or
the misfit is slow, blocks are long and few. Blocks of the length :math:`\ell` miss the fraction
:math:`\eta = G / (g \ell)` of the variance, with :math:`g = \sum R_k`, :math:`G = \sum |k| R_k`
(Kuensch [2]_), which is added again:

.. math:: T = \sum d_t \Bigm/ 2 \sqrt{\textstyle\sum Q_i^2 / (1 - \eta)} .

**The test.** The p-value is that of Student's law with as many degrees of freedom as there are
blocks. It does not require equal variances: for independent normal block sums it is conservative at
any level below 8 % (Bakirov and Szekely [3]_), and for a rival with needless parameters, whose
expected gain is negative, even more so. It does not matter where in the record the gain occurs, and
few blocks suffice where the gain is far beyond chance.

**Coloured noise.** Slow noise hides a gain at high frequencies only in plain sums: with the
one-step prediction of the noise subtracted, both residuals are white and the gain is compared with
the noise in its own band. So the same test is made a second time, with the innovations of :math:`a`
and :math:`b` under the rival's noise model (``skhyst.noise``), each record scaled by the root mean
square of both. The smaller of the two p-values is doubled (Bonferroni). A linear filter and a scale
that are common to both models leave equal models equal, so the second test keeps its level whether
or not the noise model is right.

**Additive disturbances.** An offset, a drift or a line is fitted to the record in which it is
scored, and with it the course of the noise. It stays only where the noise alone, with the spectrum
extrapolated from the frequencies around it, does not explain it at the same level, see ``_course``.

**A drive that follows the response.** In a closed loop :math:`\Delta` depends on the noise through
the drive, so that :math:`\sum \Delta_t a_t` is not zero on average where the model is right and
:math:`a` is noise. The difference :math:`Z` of the responses of both models to the part of the
drive that the controller's reference explains (``_reference``) does not depend on the noise. It
replaces :math:`\Delta` in the gain, :math:`\sum w_t Z_t (a_t + b_t)`, and in :math:`Q = \sum w_t
Z_t b_t`. Half the gain is :math:`\sum w_t Z_t a_t - \frac{1}{2} \sum w_t Z_t \Delta_t`: the first
sum is zero on average, and p is 1 where the second is not positive, since Z is then uncorrelated
with :math:`\Delta`. This is the test with the least-squares projection of :math:`\Delta` on Z: its
factor cancels in T, so that no cross-fit is needed.

**The family.** The p-value is multiplied by the number of all contestants that were screened in the
search, not only of those that were grown (Bonferroni), and of all possible pairs where pairs were
tried. So a claim is false with probability `alpha` at most, however the candidates depend on each
other. The light tail makes that cheap: with a hundred blocks, two hundred candidates require T =
4.1 instead of 2.4.

**The size.** A significant difference need not matter. The rival is *better* where the p-value is
below `alpha` and the held-out error falls by at least `min_improvement`.

References
----------
.. [1] Politis and White, *Econometric Reviews*, 2004; corrected by Patton, Politis and White,
   *Econometric Reviews*, 2009.
.. [2] Künsch, *Annals of Statistics*, 1989.
.. [3] Bakirov and Székely, *Journal of Mathematical Sciences*, 2006.
"""

from dataclasses import dataclass

import numpy as np

from ..noise import block_p_value


@dataclass(frozen=True)
class Criterion:
    """The comparison of two models at the user's level and least improvement.

    Parameters
    ----------
    alpha : float
        Probability of a false claim.
    min_improvement : float
        Fraction of the held-out error that a better model removes.
    """

    alpha: float
    min_improvement: float

    def improves_enough(self, worse, better):
        """Whether the held-out error falls by `min_improvement` at least."""
        return bool(better.error < (1.0 - self.min_improvement) * worse.error)

    def is_better(self, worse, better, n_tried=1):
        """Whether one contestant is better than another; see :meth:`p_value`."""
        matters = self.improves_enough(worse, better)
        return matters and self.p_value(worse, better, n_tried) < self.alpha

    def p_value(self, worse, better, n_tried=1):
        """Return the p-value of the hypothesis that ``better`` predicts no better than ``worse``.

        It is corrected for `n_tried` comparisons (Bonferroni).
        """
        series = [weighted(c.residuals, better.weights) for c in (worse, better)]
        if better.explained:
            # in a closed loop: the responses to the noise-free part of the drive
            by_instrument = [b - a for a, b in zip(worse.explained, better.explained, strict=True)]
            series.append(weighted(by_instrument, better.weights))
        p = paired_p_value(*series)
        if better.noise.law != "white":
            p = 2.0 * min(p, paired_p_value(*_rescaled(*map(better.noise.innovations, series))))
        return min(1.0, n_tried * p)


def weighted(series, weights):
    """Return series times the roots of their weights; NaN where the weight is zero."""
    roots = [1.0 if w is None else np.sqrt(np.where(w > 0.0, w, np.nan)) for w in weights]
    return [root * part for root, part in zip(roots, series, strict=True)]


def _rescaled(worse, better, *instruments):
    """Return series, each record divided by the root mean square of both residuals in it."""
    sizes = [
        np.sqrt(np.nansum(np.square(pair)) / max(np.isfinite(pair).sum(), 1)) or 1.0
        for pair in zip(worse, better, strict=True)
    ]
    return [
        [e / size for e, size in zip(group, sizes, strict=True)]
        for group in (worse, better, *instruments)
    ]


def paired_p_value(worse, better, instruments=None):
    """Return the p-value of the hypothesis that the second residuals are no smaller.

    Parameters
    ----------
    worse, better : sequence of ndarray of shape (n_samples,)
        Held-out residuals of each record; NaN where nothing is scored.
    instruments : sequence of ndarray or None, optional
        Series without noise that follow the difference of the predictions, better minus worse; by
        default that difference itself.

    Returns
    -------
    float
    """
    gain, agreement, chances = 0.0, 0.0, []
    instruments = [None] * len(worse) if instruments is None else instruments
    scale = max(np.nanmax(np.abs(a), initial=0.0) for a in worse) or 1.0
    for a, b, z in zip(worse, better, instruments, strict=True):
        scored = np.isfinite(a) & np.isfinite(b)
        a, b = a[scored] / scale, b[scored] / scale
        z = a - b if z is None else z[scored] / scale
        gain += np.sum(z * (a + b))
        agreement += np.sum(z * (a - b))
        chances.append(z * b)
    return block_p_value(0.5 * gain, chances) if agreement > 0.0 else 1.0
