r"""Whether an additive disturbance is more than the slow course of coloured noise.

An offset, a drift or a line is fitted to the record in which it is scored, and so predicts the
samples between those that it was fitted to: where noise is correlated, like flicker noise at any
distance, it predicts the noise too. A real disturbance stands out of the noise's spectrum. Of a
drift only the varying part is tested, since its constant could be an offset.

With orthonormal columns :math:`q_j` of a basis and the residual :math:`r` of the driven part, noise
of the spectrum :math:`S(f)` gives :math:`q_j' r` the variance :math:`\sum_k S(f_k) Q_{jk}^2`, with
the discrete cosine transform :math:`Q_j` of the column, whose coefficients are nearly independent
for stationary noise. After the fit of all columns, the fraction :math:`1 - \sum_j Q_{jk}^2` of
:math:`S(f_k)` remains at a frequency, which is also its weight.

Noise that enters behind the plant keeps its spectrum. Noise of the drive, or of its recording,
passes the plant: modes make bands of it, lags slow noise, and hysteresis slower noise still. White
noise on the drive becomes the power :math:`P(f)`, which is estimated from simulated draws. Over the
decade around the basis, the noise at both places is assumed to have the same colour,

.. math:: S = f^{-\beta} (c + g P)

since the spectra of white and flicker noise are powers of the frequency. The steepest colour is
that of integrated white noise: what is steeper comes from the plant, or is a drift. Frequencies are
in cycles per sample, so that both terms have the same form at every sampling interval. Whittle's
likelihood [1]_ of the basis and the frequencies around it is compared with the one in which the
power in the basis may be larger by a factor; twice the logarithm of the ratio follows the
chi-squared law of one degree of freedom.

A frequency that was searched for is where the noise happens to have most power. A record of n
samples resolves n / 2 frequencies; each frequency that was searched for multiplies the p-value by
that number (Bonferroni).

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
    """Return the p-value of each additive disturbance, given all the others: name -> p."""
    outputs, p_values = tree.respond(records), {}
    residuals = [record.y - output for record, output in zip(records, outputs, strict=True)]
    times = [record.dt * np.arange(len(record.y)) for record in records]
    labels = {tree.label(effect): effect for effect in tree.effects}
    for label, disturbance in zip(tree.disturbance_names, tree.disturbances, strict=True):
        if label not in labels:  # declared
            continue
        ordered = [disturbance, *(d for d in tree.disturbances if d is not disturbance)]
        bases = [np.concatenate([d.basis(time) for d in ordered], axis=1) for time in times]
        tested = np.arange(disturbance.basis(times[0]).shape[1])
        if disturbance.has_constant and len(tested) > 1:  # the constant belongs to an offset
            tested = tested[1:]
        n_searched = disturbance.basis_tangents(times[0], disturbance.coefficients).shape[1]
        # the best of all frequencies that the record resolves
        choices = (0.5 * max(map(len, residuals))) ** n_searched
        p_value = course_p_value(
            residuals, bases, tested, _echoes(tree, records, residuals, outputs)
        )
        p_values[labels[label]] = min(1.0, choices * p_value)
    return p_values


def _echoes(tree, records, residuals, outputs):
    """Yield responses, by record, to draws of white noise on the drive that explains the residual.

    Its size is that of the residual scaled by the ranges of drive and response, and no larger than
    the noise that the recorded drive can contain.
    """
    rng = np.random.default_rng(0)
    drive, response = (np.ptp(np.concatenate([getattr(r, name) for r in records])) for name in "uy")
    size = np.concatenate(residuals).std() * drive / response
    noise_sizes = [(min(size, largest_noise(r.drive)), r) for r in records]
    for _ in range(DRAWS):
        noisy = [replace(r, u=r.u + std * rng.standard_normal(len(r.u))) for std, r in noise_sizes]
        yield [a - b for a, b in zip(tree.respond(noisy), outputs, strict=True)]


def course_p_value(courses, bases, tested, echoes=()):
    """Return the p-value of the hypothesis that noise alone makes the power in a basis.

    Parameters
    ----------
    courses : sequence of ndarray of shape (n_samples,)
        The residual of the driven part of a model, of each record.
    bases : sequence of ndarray of shape (n_samples, n_columns)
        All columns that are fitted to the courses.
    tested : ndarray of int
        The columns that are tested.
    echoes : iterable of sequence of ndarray of shape (n_samples,)
        Responses to draws of white noise on the drive.

    Returns
    -------
    float
    """
    record_bases, n_tested = [_Part(basis, tested) for basis in bases], len(tested) * len(bases)
    squares = _squares(record_bases, courses)
    if not (np.any(squares[n_tested:] > 0.0) and np.any(squares[:n_tested] > 0.0)):
        return 0.0 if np.any(squares[:n_tested] > 0.0) else 1.0
    counts = np.concatenate([np.ones(n_tested), *(part.free for part in record_bases)])
    drive_noise = (
        sum((_squares(record_bases, echo) for echo in echoes), np.zeros(len(counts))) / counts
    )
    # at most this fraction of the power is made by the noise of the drive
    level = squares[n_tested:].sum() / counts[n_tested:].sum()
    largest_share = min(drive_noise.mean() / (DRAWS * level), 1.0 - 1.0 / len(counts))
    drive_noise = drive_noise / drive_noise.mean() if drive_noise.any() else np.ones(len(counts))

    def deviance(x, scaled):
        """Return the deviance, and the factor by which the power in the basis is larger."""
        exponent, share = x
        inside = [part.frequency**-exponent @ part.shares for part in record_bases]
        around = [part.frequency[part.outside] ** -exponent for part in record_bases]
        variances = np.concatenate([*inside, *around]) * (1.0 - share + share * drive_noise)
        groups = np.split(
            np.stack([squares / variances, counts]), [n_tested] if scaled else [], axis=1
        )
        sums, sizes = np.transpose([group.sum(axis=1) for group in groups])
        levels = sums / sizes
        return sizes @ np.log(levels) + counts @ np.log(variances), levels[0] / levels[-1]

    bounds, best = [(0.0, 0.5 * STEEPEST), (0.0, largest_share)], []
    for scaled in (False, True):
        # white noise, flicker noise, integrated white noise
        starts = product(
            (0.0, 1.0, 2.0), (0.1 * largest_share, 0.5 * largest_share, 0.9 * largest_share)
        )
        start = min(starts, key=lambda x, s=scaled: deviance(x, s)[0])
        best.append(minimize(lambda x, s=scaled: deviance(x, s)[0], start, bounds=bounds))
    if deviance(best[1].x, True)[1] <= 1.0:
        return 1.0
    return float(norm.sf(np.sqrt(max(best[0].fun - best[1].fun, 0.0))))


class _Part:
    """The basis of a record, and the frequencies around its tested columns.

    Attributes
    ----------
    q : ndarray of shape (n_samples, n_columns)
        Orthonormal basis; its last ``n_tested`` columns are the tested ones, given the others.
    shares : ndarray of shape (n_samples, n_tested)
        Fraction of the power of each tested column by frequency.
    frequency : ndarray of shape (n_samples,)
        Relative to the Nyquist frequency.
    outside : ndarray of bool, shape (n_samples,)
        Frequencies within a decade of those of the tested columns that are mostly outside the
        basis.
    free : ndarray of shape (n_outside,)
        Fraction of the noise that remains there after the fit.
    """

    def __init__(self, basis, tested):
        order = np.append(np.delete(np.arange(basis.shape[1]), tested), tested)
        self.q, self.n_tested = np.linalg.qr(basis[:, order])[0], len(tested)
        powers = np.square(dct(self.q, axis=0, norm="ortho"))
        self.shares = powers[:, -len(tested) :]
        # half the least frequency stands for zero, where the power of coloured noise diverges
        self.frequency = np.maximum(np.arange(len(basis)), 0.5) / len(basis)
        inside = self.frequency[self.shares.sum(axis=1) > 0.5]
        near = (self.frequency >= inside.min() / 10.0) & (self.frequency <= 10.0 * inside.max())
        remaining = 1.0 - powers.sum(axis=1)
        self.outside = near & (remaining > 0.5)
        self.free = remaining[self.outside]


def _squares(parts, courses):
    """Return the powers in the tested columns of all records, and at the frequencies around."""
    inner, outer = [], []
    for part, course in zip(parts, courses, strict=True):
        projection = part.q.T @ course
        inner.append(np.square(projection[-part.n_tested :]))
        outer.append(np.square(dct(course - part.q @ projection, norm="ortho")[part.outside]))
    return np.concatenate([*inner, *outer])
