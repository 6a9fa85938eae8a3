"""Limit of the drive's rate."""

from dataclasses import dataclass

import numpy as np

from .._kernels._arrays import as_signal
from .._kernels._slew_limit import slew_limit_run, slew_limit_tangents
from ._base import Operator, parameter

__all__ = ["SlewLimitOperator"]


@dataclass(frozen=True)
class SlewLimitOperator(Operator):
    r"""Limit of the rate: the output follows the input, at most so fast.

    .. math:: \dot y = R \operatorname{sgn}(u - y), \quad \text{and } \dot y = \dot u
       \text{ while } y = u, |\dot u| \le R

    Parameters
    ----------
    rate : float
        ``R``, units of the drive over s, positive.

    Notes
    -----
    Exact for a drive that is a straight line between samples. The state is ``(output, last
    drive)``.

    Examples
    --------
    >>> from skhyst.operators import SlewLimitOperator
    >>> SlewLimitOperator(100.0).run([0.0, 0.25, 0.25, 0.25], dt=1e-3)[0]
    array([0.  , 0.1 , 0.2 , 0.25])
    """

    rate: float = parameter(log=True, lower=0.0, unit="drive/s")
    rank = 0

    def init(self, u0, initial_state="rest"):
        u0 = float(u0) if initial_state == "rest" else 0.0
        return u0, u0

    def run(self, u, dt, state=None):
        u = as_signal(u)
        if not u.size:
            return np.empty(0), state
        y, before = self.init(u[0]) if state is None else state
        out = np.empty(u.size)
        slew_limit_run(u, before, y, float(self.rate), dt, out)
        return out, (float(out[-1]), float(u[-1]))

    def linearize(self, u, du, dt, initial_state="rest"):
        u, du = as_signal(u), as_signal(du)
        m = du.shape[1]
        y, before = self.init(u[0], initial_state)
        first = du[0] if initial_state == "rest" else np.zeros(m)
        out, dout = np.empty(u.size), np.empty((u.size, m + 1))
        slew_limit_tangents(
            u, du, before, first, y, np.append(first, 0.0), float(self.rate), dt, out, dout
        )
        return out, dout
