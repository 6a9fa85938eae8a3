r"""Whether what stands beside a model is more than the course that its noise takes by itself.

An offset, a drift or a line is fitted to the record that it is in, and so foretells the samples
between those that it was fitted to: where noise hangs together, as flicker noise does at any
distance, it foretells the noise too. What is real stands out of the noise's spectrum. Of a drift
that is what moves: its constant could be an offset's.

With orthonormal columns :math:`q_j` of a basis and the course :math:`r` that is left to it, noise
of the spectrum :math:`S(f)` gives :math:`q_j' r` the variance :math:`\sum_k S(f_k) Q_{jk}^2`, with
the discrete cosine transform :math:`Q_j` of the column, whose coefficients of stationary noise are
about independent. Over the decade around the basis the spectrum is taken for a power of the
frequency, :math:`S = c f^{-\beta}`, as those of white noise and flicker noise are. Frequencies
count per sample: in these units both are one and the same law at every sampling interval.
Whittle's likelihood [1]_ of the basis and the frequencies around it is compared with the one where
the power in the basis may be larger by a factor; twice the logarithm of the ratio follows the
chi-squared law of one degree of freedom.

References
----------
.. [1] P. Whittle, "Estimation and information in stationary time series", Arkiv foer Matematik 2
   (1953).
"""

import numpy as np
from scipy.fft import dct
from scipy.optimize import minimize_scalar
from scipy.stats import norm

from ._constants import STEEPEST


def course_p_values(tree, records):
    """Return the p-value of each effect that stands beside, each beside all others: name -> p."""
    outputs, found = tree.respond(records), {}
    labels = {tree.label(effect): effect for effect in tree.effects}
    for label, disturbance in zip(tree.beside_names, tree.disturbances, strict=True):
        if label not in labels:  # declared
            continue
        courses, bases = [], []
        for record, output in zip(records, outputs, strict=True):
            time = record.dt * np.arange(len(record.y))
            others = [d.basis(time) for d in tree.disturbances if d is not disturbance]
            own = disturbance.basis(time)
            if disturbance.has_constant and own.shape[1] > 1:  # which is an offset's
                own, others = own[:, 1:] - own[:, 1:].mean(axis=0), [*others, own[:, :1]]
            bases.append(own)
            every = np.concatenate([bases[-1], *others], axis=1)
            rest = record.y - output
            solution = np.linalg.lstsq(every, rest, rcond=None)[0]
            solution[: bases[-1].shape[1]] = 0.0
            courses.append(rest - every @ solution)
        found[labels[label]] = course_p_value(courses, bases)
    return found


def course_p_value(courses, bases):
    """Return the p-value against the noise alone having made what a basis finds.

    Parameters
    ----------
    courses : sequence of ndarray of shape (n_samples,)
        What a model leaves to its disturbance, of each record.
    bases : sequence of ndarray of shape (n_samples, n_columns)

    Returns
    -------
    float
    """
    inner, shares, frequencies, outer, around = [], [], [], [], []
    for course, basis in zip(courses, bases, strict=True):
        q = np.linalg.qr(basis)[0]
        own = q.T @ course
        share = np.square(dct(q, axis=0, norm="ortho"))
        frequency = np.maximum(np.arange(len(q)), 0.5) / len(q)  # the mean: half of the least
        inside = share.sum(axis=1) > 0.5
        low, high = frequency[inside].min() / 10.0, 10.0 * frequency[inside].max()
        outside = ~inside & (frequency >= low) & (frequency <= high)
        outer.append(np.square(dct(course - q @ own, norm="ortho"))[outside])
        around.append(frequency[outside])
        inner.append(np.square(own))
        shares.append(share)
        frequencies.append(frequency)
    inner, outer, around = map(np.concatenate, (inner, outer, around))
    if not (np.any(outer > 0.0) and np.any(inner > 0.0)):
        return 0.0 if np.any(inner > 0.0) else 1.0

    def deviance(exponent, scaled):
        """Return that of the fit, and the factor by which the power in the basis is larger."""
        variances = np.concatenate(
            [f**-exponent @ share for f, share in zip(frequencies, shares, strict=True)]
        )
        own, others = inner / variances, outer * around**exponent
        logarithm = exponent * np.log(around).sum() - np.log(variances).sum()
        if not scaled:
            values = np.concatenate([own, others])
            return len(values) * np.log(values.mean()) - logarithm, 1.0
        both = len(own) * np.log(own.mean()) + len(others) * np.log(others.mean())
        return both - logarithm, own.mean() / others.mean()

    best = [
        minimize_scalar(lambda b, s=scaled: deviance(b, s)[0], bounds=(0.0, STEEPEST))
        for scaled in (False, True)
    ]
    if deviance(best[1].x, True)[1] <= 1.0:
        return 1.0
    return float(norm.sf(np.sqrt(max(best[0].fun - best[1].fun, 0.0))))
