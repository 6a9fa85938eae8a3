"""Duhem model of Coleman and Hodgdon."""

from numbers import Integral

import numpy as np

from .._sklearn import Interval
from ..base import ParametricModel
from ..operators import DuhemOperator
from ._friction import half_range, swing

__all__ = ["Duhem"]

_STARTS = np.geomspace(0.003, 1.0, 6)  # 1/alpha, parts of the drive's swing


class Duhem(ParametricModel):
    r"""Duhem model in the form of Coleman and Hodgdon, with polynomials for its two functions.

    .. math::

        \dot h = \alpha |\dot u| (f(u) - h) + \dot u\, g(u), \qquad y = h + c

        f(u) = s \sum_{i=1}^{d} a_i t^i, \quad g(u) = \sum_{j=0}^{d-1} b_j t^j, \quad
        t = (u - m)/s

    At degree 1, ``f(u) = a u`` and ``g(u) = b``. All but ``alpha`` is linear and solved exactly.

    Parameters
    ----------
    degree : int, default=1
        Degree ``d`` of ``f``, one more than that of ``g``. 1 is a loop of two exponential branches
        about a straight line, the same as :class:`Dahl` with a spring; higher degrees bend the
        line, and make the branches differ.
    fit_intercept : bool, default=True
        Whether the response has a constant.
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample: at rest after a first loading from zero; all
        zero; or after a rest at a drive value that is fitted for each record.
    dt : float, default=1.0
        Sampling interval in s of data without a time index. The model does not depend on it.
    method : str or Method, default="variable_projection"
        How the parameters are identified, see :mod:`skhyst.optimize`.

    Attributes
    ----------
    operator_ : DuhemOperator
        ``alpha`` in 1/drive, ``curve`` a_i and ``slope`` b_j in response/drive, ``intercept`` in
        units of the response. At degree 1 ``t = u``; else ``t`` runs from -1 to 1 over the range of
        the drive in the records of the fit (``center``, ``scale``).
    params_, params_std_ : dict
        Parameters and their standard errors.

    References
    ----------
    B. D. Coleman, M. L. Hodgdon, "A constitutive relation for rate-independent hysteresis in
    ferromagnetically soft materials", Int. J. Engineering Science 24(6), 1986.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import Duhem
    >>> from skhyst.operators import DuhemOperator
    >>> drive = np.sin(np.linspace(0, 20, 2000))
    >>> y, _ = DuhemOperator(3.0, curve=[1.0], slope=[0.4]).run(drive, 1.0)
    >>> model = Duhem().fit(drive.reshape(-1, 1), y)
    >>> {name: round(value, 3) + 0.0 for name, value in model.params_.items()}
    {'alpha': 3.0, 'curve[0]': 1.0, 'slope[0]': 0.4, 'intercept': 0.0}
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "degree": [Interval(Integral, 1, 9, closed="both")],
        "fit_intercept": ["boolean"],
    }

    _rank = DuhemOperator.rank

    def __init__(
        self,
        degree=1,
        *,
        fit_intercept=True,
        initial_state="rest",
        dt=1.0,
        method="variable_projection",
    ):
        self.degree = degree
        self.fit_intercept = fit_intercept
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    def _starts(self, records):
        length = swing(records)
        slope = half_range(records) / length
        low = min(float(record.u.min()) for record in records)
        high = max(float(record.u.max()) for record in records)
        center, scale = 0.0, 1.0
        if self.degree > 1:
            center, scale = 0.5 * (low + high), 0.5 * (high - low) or 1.0
        curve, slopes = np.zeros((2, self.degree))
        curve[0], slopes[0] = 2.0 * slope, slope
        return [
            (DuhemOperator(1.0 / (part * length), curve, slopes, center=center, scale=scale), ())
            for part in _STARTS
        ]

    def _fixed(self):
        return frozenset() if self.fit_intercept else frozenset({"intercept"})
