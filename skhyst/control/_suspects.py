r"""Which parameter of a device has changed.

Each parameter in turn is changed alone, by as much as makes the sum :math:`R` of the squared
innovations (white, of unit variance) of the samples since an alarm the least. A large change, as of
the frequency of a mode by more than its width, is not what sensitivities say of a small one, so
that models with changed parameters are run: changes of either sign that are doubled from the
uncertainty of the fit on, then the best one between its neighbours.

The parameter :math:`i` that leaves the least :math:`R_i` is the first suspect. Where it is
:math:`j`, both changed together leave less than :math:`j` alone by a chi-square variable of one
degree of freedom (Wilks, *Annals of Mathematical Statistics*, 1938), and :math:`i` alone leaves no
less than both. So :math:`j` is ruled out where :math:`R_j - R_i` is more than that, and else told
together with it.
"""

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

_LEVEL = 0.05  # at which suspects are ruled out, all together
_LARGEST = 0.5  # relative change


def suspects(left, units, values):
    """Return the numbers of the likely parameters, the most likely first.

    Parameters
    ----------
    left : callable
        ``left(i, change)``: sum of the squares with parameter ``i`` changed.
    units : sequence of float
        Uncertainties of the parameters.
    values : sequence of float
        Parameters, or zero where they are unknown.
    """
    least = np.array(
        [
            _least(lambda change, i=i: left(i, change), unit, value)
            for i, (unit, value) in enumerate(zip(units, values, strict=True))
        ]
    )
    order = np.argsort(least, kind="stable")
    apart = chi2.isf(_LEVEL / max(len(order) - 1, 1), 1)
    return [int(i) for i in order if least[i] - least[order[0]] <= apart]


def _least(left, unit, value):
    """Return the least of a function of a change."""
    sizes = unit * 2.0 ** np.arange(max(np.ceil(np.log2(_LARGEST * abs(value) / unit)), 1.0) + 1.0)
    changes = np.concatenate([-sizes[::-1], [0.0], sizes])
    found = [left(change) for change in changes]
    best = int(np.argmin(found))
    if not np.isfinite(found[best]):
        return np.inf
    ends = changes[max(best - 1, 0)], changes[min(best + 1, len(changes) - 1)]
    between = minimize_scalar(left, bounds=ends, method="bounded", options={"xatol": 0.1 * unit})
    return min(found[best], between.fun)
