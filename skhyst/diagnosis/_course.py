r"""Whether an additive disturbance is more than what the coloured noise does by itself.

An offset, a drift or a line is fitted to the record that it is in, and so predicts the samples
between those that it was fitted to: where noise hangs together, as flicker noise does at any
distance, it predicts the noise too. What is real stands out of the noise's spectrum. Of a drift
that is what moves: its constant could be an offset's.

With orthonormal columns :math:`q_j` of a basis and the course :math:`r` that a model leaves, noise
of the spectrum :math:`S(f)` gives :math:`q_j' r` the variance :math:`\sum_k S(f_k) Q_{jk}^2`, with
the discrete cosine transform :math:`Q_j` of the column, whose coefficients of stationary noise are
about independent. What the fit of all columns leaves at a frequency has the part
:math:`1 - \sum_j Q_{jk}^2` of :math:`S(f_k)`, and counts for as much.

Noise that enters behind the plant keeps its spectrum. Noise that the drive or its recording has
goes through the plant, whose modes make bands of it, its lags slow noise, and its memory noise
slower still: of white noise there comes the power :math:`P(f)`, which is that of simulated draws.
Over the decade around the basis the spectrum is taken for noise of one colour at both places,

.. math:: S = f^{-\beta} (c + g P)

since those of white noise and flicker noise are powers of the frequency. A colour is at most that
of white noise summed up: what is steeper is the plant's, or a drift. Frequencies count per sample:
in these units both terms are one and the same law at every sampling interval. Whittle's
likelihood [1]_ of the basis and the frequencies around it is compared with the one where the power
in the basis may be larger by a factor; twice the logarithm of the ratio follows the chi-squared law
of one degree of freedom.

A frequency that was sought is where noise happens to have the most power. A record of n samples
tells n / 2 frequencies apart; each one sought multiplies the p-value by that number (Bonferroni).

References
----------
.. [1] Whittle, *Arkiv för Matematik*, 1953.
"""

from dataclasses import replace
from itertools import product

import numpy as np
from scipy.fft import dct
from scipy.optimize import minimize
from scipy.stats import norm

from ..noise import STEEPEST, largest_noise
from ._constants import DRAWS


def course_p_values(tree, records):
    """Return the p-value of each additive disturbance, given all others: name -> p."""
    outputs, found = tree.respond(records), {}
    rests = [record.y - output for record, output in zip(records, outputs, strict=True)]
    times = [record.dt * np.arange(len(record.y)) for record in records]
    labels = {tree.label(effect): effect for effect in tree.effects}
    for label, disturbance in zip(tree.disturbance_names, tree.disturbances, strict=True):
        if label not in labels:  # declared
            continue
        every = [disturbance, *(d for d in tree.disturbances if d is not disturbance)]
        bases = [np.concatenate([d.basis(time) for d in every], axis=1) for time in times]
        own = np.arange(disturbance.basis(times[0]).shape[1])
        if disturbance.has_constant and len(own) > 1:  # which is an offset's
            own = own[1:]
        sought = disturbance.basis_tangents(times[0], disturbance.coefficients).shape[1]
        # the best of so many that a record tells apart
        choices = (0.5 * max(map(len, rests))) ** sought
        p_value = course_p_value(rests, bases, own, _echoes(tree, records, rests, outputs))
        found[labels[label]] = min(1.0, choices * p_value)
    return found


def _echoes(tree, records, rests, outputs):
    """Yield what white noise on the drives becomes, as large as what a model leaves is.

    Sizes are those over the ranges of drive and response, and no larger than the noise that a drive
    can have as it was recorded.
    """
    rng = np.random.default_rng(0)
    drive, response = (np.ptp(np.concatenate([getattr(r, name) for r in records])) for name in "uy")
    size = np.concatenate(rests).std() * drive / response
    sized = [(min(size, largest_noise(r.drive)), r) for r in records]
    for _ in range(DRAWS):
        moved = [replace(r, u=r.u + own * rng.standard_normal(len(r.u))) for own, r in sized]
        yield [a - b for a, b in zip(tree.respond(moved), outputs, strict=True)]


def course_p_value(courses, bases, own, echoes=()):
    """Return the p-value against the noise alone having made what a basis finds.

    Parameters
    ----------
    courses : sequence of ndarray of shape (n_samples,)
        What the driven part of a model leaves, of each record.
    bases : sequence of ndarray of shape (n_samples, n_columns)
        All that is fitted to the courses.
    own : ndarray of int
        The columns that are asked after.
    echoes : iterable of sequence of ndarray of shape (n_samples,)
        What draws of white noise on the drive become.

    Returns
    -------
    float
    """
    parts, own = [_Part(basis, own) for basis in bases], len(own) * len(bases)
    squares = _squares(parts, courses)
    if not (np.any(squares[own:] > 0.0) and np.any(squares[:own] > 0.0)):
        return 0.0 if np.any(squares[:own] > 0.0) else 1.0
    counts = np.concatenate([np.ones(own), *(part.free for part in parts)])
    passed = sum((_squares(parts, echo) for echo in echoes), np.zeros(len(counts))) / counts
    # the drive's noise makes no more than this part of the power
    level = squares[own:].sum() / counts[own:].sum()
    most = min(passed.mean() / (DRAWS * level), 1.0 - 1.0 / len(counts))
    passed = passed / passed.mean() if passed.any() else np.ones(len(counts))

    def deviance(x, scaled):
        """Return that of the fit, and the factor by which the power in the basis is larger."""
        exponent, share = x
        inside = [part.frequency**-exponent @ part.shares for part in parts]
        around = [part.frequency[part.outside] ** -exponent for part in parts]
        variances = np.concatenate([*inside, *around]) * (1.0 - share + share * passed)
        groups = np.split(np.stack([squares / variances, counts]), [own] if scaled else [], axis=1)
        sums, sizes = np.transpose([group.sum(axis=1) for group in groups])
        levels = sums / sizes
        return sizes @ np.log(levels) + counts @ np.log(variances), levels[0] / levels[-1]

    bounds, best = [(0.0, 0.5 * STEEPEST), (0.0, most)], []
    for scaled in (False, True):
        # white, flicker, summed up
        starts = product((0.0, 1.0, 2.0), (0.1 * most, 0.5 * most, 0.9 * most))
        start = min(starts, key=lambda x, s=scaled: deviance(x, s)[0])
        best.append(minimize(lambda x, s=scaled: deviance(x, s)[0], start, bounds=bounds))
    if deviance(best[1].x, True)[1] <= 1.0:
        return 1.0
    return float(norm.sf(np.sqrt(max(best[0].fun - best[1].fun, 0.0))))


class _Part:
    """A basis of a record, and the frequencies around the columns that are asked after."""

    def __init__(self, basis, own):
        order = np.append(np.delete(np.arange(basis.shape[1]), own), own)
        self.q, self.n_own = np.linalg.qr(basis[:, order])[0], len(own)
        taken = np.square(dct(self.q, axis=0, norm="ortho"))
        self.shares = taken[:, -len(own) :]
        self.frequency = np.maximum(np.arange(len(basis)), 0.5) / len(basis)  # half of the least
        inside = self.frequency[self.shares.sum(axis=1) > 0.5]
        near = (self.frequency >= inside.min() / 10.0) & (self.frequency <= 10.0 * inside.max())
        left = 1.0 - taken.sum(axis=1)
        self.outside = near & (left > 0.5)
        self.free = left[self.outside]


def _squares(parts, courses):
    """Return the powers in the columns that are asked after, and at the frequencies around."""
    inner, outer = [], []
    for part, course in zip(parts, courses, strict=True):
        found = part.q.T @ course
        inner.append(np.square(found[-part.n_own :]))
        outer.append(np.square(dct(course - part.q @ found, norm="ortho")[part.outside]))
    return np.concatenate([*inner, *outer])
