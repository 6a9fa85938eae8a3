r"""Which parameter of a device has changed, or whether its reading has an offset.

Each parameter in turn is changed alone, by as much as makes the sum :math:`R` of the squared
innovations (white, of unit variance) of the samples since an alarm the least. A large change, as of
the frequency of a mode by more than its width, is not what sensitivities say of a small one, so
that models with changed parameters are run: changes of either sign that are doubled from the
uncertainty of the fit on, then the best one between its neighbours.

The parameter :math:`i` that leaves the least :math:`R_i` is the first suspect. Where it is
:math:`j`, both changed together leave less than :math:`j` alone by a chi-square variable of one
degree of freedom (Wilks, *Annals of Mathematical Statistics*, 1938), and :math:`i` alone leaves no
less than both. So :math:`j` is ruled out where :math:`R_j - R_i` is more than that, and else told
together with it. Of a model that is not exact the variable is noncentral: to the noise there comes
the energy of the misfit, see :mod:`skhyst.control._local_tests`.

An offset is a step of the reading. What it does to the innovations is the same at any sample but
for the shift, so that its size follows by least squares and its sample, one of the first block,
from trying all of them (Willsky and Jones, *IEEE Transactions on Automatic Control*, 1976).
"""

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import ncx2

_LEVEL = 0.05  # at which suspects are ruled out, all together
_LARGEST = 0.5  # relative change


def least_left(left, units, values):
    """Return the least sum of squares that each parameter leaves, changed alone.

    Parameters
    ----------
    left : callable
        ``left(i, change)``: sum of the squares with parameter ``i`` changed.
    units : sequence of float
        Uncertainties of the parameters.
    values : sequence of float
        Parameters, or zero where they are unknown.
    """
    return [
        _least(lambda change, i=i: left(i, change), unit, value)
        for i, (unit, value) in enumerate(zip(units, values, strict=True))
    ]


def left_by_step(innovations, response, counts, latest):
    """Return the least sum of squares that a step leaves, of any size and at one of some samples.

    Parameters
    ----------
    innovations, response : ndarray of shape (n_samples,)
        What has been seen, and what a step at the first sample does to it.
    counts : ndarray of shape (n_samples,)
        Of bool: the samples of the sum.
    latest : int
        Samples among the first of which the step may be.
    """
    e, n = innovations * counts, len(innovations)
    taken = 0.0
    for k in range(min(latest, n)):
        own = response[: n - k] * counts[k:]
        power = own @ own
        if power > 0.0:
            taken = max(taken, (own @ e[k:]) ** 2 / power)
    return e @ e - taken


def likely(least, misfit=0.0):
    """Return the numbers of the likely explanations, the most likely first.

    Parameters
    ----------
    least : sequence of float
        Sum of squares that each leaves.
    misfit : float, default=0.0
        Largest sum of squares that the misfit of the model may have along one direction.
    """
    order = np.argsort(least, kind="stable")
    apart = ncx2.isf(_LEVEL / max(len(order) - 1, 1), 1, misfit)
    return [int(i) for i in order if least[i] - least[order[0]] <= apart]


def _least(left, unit, value):
    """Return the least of a function of a change."""
    doublings = np.ceil(np.log2(max(_LARGEST * abs(value) / unit, 2.0)))
    sizes = unit * 2.0 ** np.arange(doublings + 1.0)
    changes = np.concatenate([-sizes[::-1], [0.0], sizes])
    found = [left(change) for change in changes]
    best = int(np.argmin(found))
    if not np.isfinite(found[best]):
        return np.inf
    ends = changes[max(best - 1, 0)], changes[min(best + 1, len(changes) - 1)]
    between = minimize_scalar(left, bounds=ends, method="bounded", options={"xatol": 0.1 * unit})
    return min(found[best], between.fun)
