"""Limit of the drive's rate.

Loops over a limit of the rate, exact for an input that is a straight line between samples.

With ``e`` the lead of the input over the output, ``s`` its slope and ``R`` the limit, the output
moves towards the input at ``R`` until they meet, after ``e / (R - s)`` for ``e > 0``; from there it
follows the input, or falls behind again where ``|s| > R``.

Limit of the drive's rate.
"""

from dataclasses import dataclass

import numpy as np

from .._jit import jit
from ..base import ParametricModel
from ..operators import Operator, as_signal, parameter

__all__ = [
    "SlewLimit",
    "SlewLimitOperator",
    "slew_limit_run",
    "slew_limit_tangents",
]


@jit
def slew_limit_run(u, before, y, rate, dt, out):
    """Write the output to ``out`` (n,), from ``y`` at the input ``before``."""
    reach = rate * dt
    for i in range(u.size):
        side = 1.0 if before > y or (before == y and u[i] > before) else -1.0
        lead, step = side * (before - y), side * (u[i] - before)
        if lead + step >= reach:
            y += side * reach
        elif step >= -reach:
            y = u[i]
        else:  # they meet, and the input runs away on the other side
            met = lead / (reach - step)
            y = before + side * (step * met - reach * (1.0 - met))
        before = u[i]
        out[i] = y


@jit
def slew_limit_tangents(u, du, before, dbefore, y, tangent, rate, dt, out, dout):
    """Write the output to ``out`` (n,) and its tangents to ``dout`` (n, m + 1).

    ``dbefore`` (m,) and ``tangent`` (m + 1,) are the tangents of ``before`` and ``y``, the latter
    overwritten; the last column is the derivative with respect to the rate.
    """
    m = du.shape[1]
    reach = rate * dt
    last = dbefore.copy()
    for i in range(u.size):
        side = 1.0 if before > y or (before == y and u[i] > before) else -1.0
        lead, step = side * (before - y), side * (u[i] - before)
        if lead + step >= reach:
            y += side * reach
            tangent[m] += side * dt
        elif step >= -reach:
            y = u[i]
            for q in range(m):
                tangent[q] = du[i, q]
            tangent[m] = 0.0
        else:
            closing = reach - step
            met = lead / closing
            y = before + side * (step * met - reach * (1.0 - met))
            by_met = side * (step + reach)
            for q in range(m):
                dlead, dstep = side * (last[q] - tangent[q]), side * (du[i, q] - last[q])
                dmet = (dlead + met * dstep) / closing
                tangent[q] = last[q] + side * dstep * met + by_met * dmet
            dmet = (-side * tangent[m] - met * dt) / closing
            tangent[m] = by_met * dmet - side * dt * (1.0 - met)
        before = u[i]
        for q in range(m):
            last[q] = du[i, q]
        out[i] = y
        for q in range(m + 1):
            dout[i, q] = tangent[q]


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
    >>> from skhyst.hysteresis import SlewLimitOperator
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
    >>> from skhyst.hysteresis import SlewLimitOperator
    >>> drive = np.repeat([0.0, 1.0, -1.0, 0.5], 100)
    >>> y, _ = SlewLimitOperator(3.0).run(drive, 0.01)
    >>> round(SlewLimit(dt=0.01).fit(drive.reshape(-1, 1), y).operator_.rate, 6)
    3.0
    """

    series_rank = SlewLimitOperator.rank

    def __init__(self, *, initial_state="rest", dt=1.0, method="variable_projection"):
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    def starting_values(self, records):
        fastest = max(np.abs(np.diff(r.u)).max(initial=0.0) / r.dt for r in records)
        return [(SlewLimitOperator(float(part * fastest or 1.0)), ()) for part in _PARTS]
