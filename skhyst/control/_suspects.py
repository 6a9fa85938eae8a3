r"""Isolation of a change: which parameter has changed, or whether the reading has an offset.

Each parameter is changed alone, so that the sum :math:`R` of the squared innovations (white, of
unit variance) of the samples since an alarm becomes smallest. Sensitivities do not describe a large
change, such as that of a mode's frequency by more than its width, so models with changed parameters
are run: changes of either sign, doubled from the uncertainty of the fit on, then a bounded search
between the neighbours of the best one.

The parameter :math:`i` with the smallest :math:`R_i` is the first suspect. If in truth :math:`j`
has changed, :math:`R` with both changed is below :math:`R_j` by a chi-square variable of one degree
of freedom (Wilks, *Annals of Mathematical Statistics*, 1938), and :math:`R_i` is not below
:math:`R` with both. So :math:`j` is ruled out if :math:`R_j - R_i` exceeds a quantile of it, and
reported together with :math:`i` otherwise. If the model is not exact, the variable is noncentral:
the energy of the misfit adds to the noise, see :mod:`skhyst.control._local_tests`.

An offset is a step of the reading. Its effect on the innovations is the same at any sample but for
a shift in time, so its size follows by least squares, and its sample, one of the first block, by
trying all of them (Willsky and Jones, *IEEE Transactions on Automatic Control*, 1976).
"""

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import ncx2

_LEVEL = 0.05  # family-wise significance level at which suspects are ruled out
_LARGEST = 0.5  # largest relative change that is tried


def smallest_squares(squares, units, values):
    """Return the smallest sum of squared innovations for each parameter, changed alone.

    Parameters
    ----------
    squares : callable
        ``squares(i, change)``: sum of the squared innovations with parameter ``i`` changed.
    units : sequence of float
        Uncertainties of the parameters.
    values : sequence of float
        Parameters, or zero where they are unknown.

    Returns
    -------
    list of float
    """
    return [
        _smallest(lambda change, i=i: squares(i, change), unit, value)
        for i, (unit, value) in enumerate(zip(units, values, strict=True))
    ]


def squares_after_step(innovations, response, counts, latest):
    """Return the sum of squared innovations minus the best-fitting step of the reading.

    Parameters
    ----------
    innovations : ndarray of shape (n_samples,)
        Observed innovations.
    response : ndarray of shape (n_samples,)
        Response of the innovations to a unit step of the reading at the first sample.
    counts : ndarray of shape (n_samples,)
        Mask of the samples of the sum.
    latest : int
        Number of first samples at which the step may occur.

    Returns
    -------
    float
    """
    e, n = innovations * counts, len(innovations)
    explained = 0.0
    for k in range(min(latest, n)):
        effect = response[: n - k] * counts[k:]
        power = effect @ effect
        if power > 0.0:
            explained = max(explained, (effect @ e[k:]) ** 2 / power)
    return e @ e - explained


def likely(squares, misfit=0.0):
    """Return the indices of the explanations that are not ruled out, the most likely first.

    Parameters
    ----------
    squares : sequence of float
        Sum of squared innovations under each explanation.
    misfit : float, default=0.0
        Largest sum of squares that the misfit of the model may have along one direction.

    Returns
    -------
    list of int
    """
    order = np.argsort(squares, kind="stable")
    limit = ncx2.isf(_LEVEL / max(len(order) - 1, 1), 1, misfit)  # Bonferroni
    return [int(i) for i in order if squares[i] - squares[order[0]] <= limit]


def _smallest(squares, unit, value):
    """Return the minimum of a function of a change."""
    doublings = np.ceil(np.log2(max(_LARGEST * abs(value) / unit, 2.0)))
    sizes = unit * 2.0 ** np.arange(doublings + 1.0)
    changes = np.concatenate([-sizes[::-1], [0.0], sizes])
    sums = [squares(change) for change in changes]
    best = int(np.argmin(sums))
    if not np.isfinite(sums[best]):
        return np.inf
    ends = changes[max(best - 1, 0)], changes[min(best + 1, len(changes) - 1)]
    between = minimize_scalar(squares, bounds=ends, method="bounded", options={"xatol": 0.1 * unit})
    return min(sums[best], between.fun)
