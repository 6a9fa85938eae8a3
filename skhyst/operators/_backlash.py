"""One play of identified width."""

from dataclasses import dataclass

import numpy as np

from .._kernels._arrays import as_signal
from .._kernels._backlash import backlash_run, backlash_tangents
from ._base import Operator, parameter

__all__ = ["BacklashOperator"]


@dataclass(frozen=True)
class BacklashOperator(Operator):
    r"""Backlash: the output follows the input once half the gap is used up.

    .. math:: y(t) = \max(u(t) - r, \min(u(t) + r, y(t^-)))

    Parameters
    ----------
    half_gap : float
        ``r``, units of the drive, positive.
    rank : int, default=0
        Where it stands in a series: 0 before everything else, 50 behind it.

    Notes
    -----
    The drive is a straight line between samples, and the samples are exact. The state is the last
    output. From rest, the output is where a first loading from zero has taken it.

    Examples
    --------
    >>> from skhyst.operators import BacklashOperator
    >>> BacklashOperator(0.5).run([0.0, 2.0, 1.5, -1.0], dt=1e-3)[0]
    array([ 0. ,  1.5,  1.5, -0.5])
    """

    half_gap: float = parameter(log=True, lower=0.0, unit="drive")
    rank: int = 0

    def init(self, u0, initial_state="rest"):
        if initial_state == "zero":
            return 0.0
        return float(np.sign(u0) * max(abs(u0) - self.half_gap, 0.0))

    def run(self, u, dt, state=None):
        u = as_signal(u)
        if not u.size:
            return np.empty(0), state
        out = np.empty(u.size)
        backlash_run(u, float(self.half_gap), self.init(u[0]) if state is None else state, out)
        return out, float(out[-1])

    def linearize(self, u, du, dt, initial_state="rest"):
        # a first loading from zero passes through the first sample: either state starts at zero
        u, du = as_signal(u), as_signal(du)
        out, dout = np.empty(u.size), np.empty((u.size, du.shape[1] + 1))
        tangent = np.zeros(du.shape[1] + 1)
        backlash_tangents(u, du, float(self.half_gap), 0.0, tangent, out, dout)
        return out, dout
