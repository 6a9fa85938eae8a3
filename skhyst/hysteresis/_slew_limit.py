"""Limit of the drive's rate."""

import numpy as np

from ..base import ParametricModel
from ..operators import SlewLimitOperator

__all__ = ["SlewLimit"]

_PARTS = (0.9, 0.6, 0.3, 0.1)  # limits to start from, parts of the fastest change


class SlewLimit(ParametricModel):
    r"""Limit of the rate: the response follows the drive, at most so fast.

    .. math:: \dot y = R \operatorname{sgn}(u - y), \quad \text{and } \dot y = \dot u
       \text{ while } y = u, |\dot u| \le R

    as of an amplifier that charges a capacitance with a limited current. It has no gain: put a
    model that has one behind it in a :class:`~skhyst.compose.Cascade`.

    Parameters
    ----------
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample.
    dt : float, default=1.0
        Sampling interval in s of data without a time index.
    method : str or Method, default="variable_projection"
        How the parameters are identified, see :mod:`skhyst.optimize`.

    Attributes
    ----------
    operator_ : SlewLimitOperator
        ``rate`` R, units of the drive over s.
    params_, params_std_ : dict
        The rate and its standard error.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import SlewLimit
    >>> from skhyst.operators import SlewLimitOperator
    >>> drive = np.repeat([0.0, 1.0, -1.0, 0.5], 100)
    >>> y, _ = SlewLimitOperator(3.0).run(drive, 0.01)
    >>> round(SlewLimit(dt=0.01).fit(drive.reshape(-1, 1), y).operator_.rate, 6)
    3.0
    """

    _rank = SlewLimitOperator.rank

    def __init__(self, *, initial_state="rest", dt=1.0, method="variable_projection"):
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    def _starts(self, records):
        fastest = max(np.abs(np.diff(r.u)).max(initial=0.0) / r.dt for r in records)
        return [(SlewLimitOperator(float(part * fastest or 1.0)), ()) for part in _PARTS]
