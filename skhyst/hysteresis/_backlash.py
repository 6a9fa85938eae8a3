"""Backlash: one play of unknown width.

Loops over one play whose gap is identified, with its tangents.

One play of identified width.
"""

from dataclasses import dataclass

import numpy as np

from .._jit import jit
from .._sklearn import StrOptions
from ..base import ParametricModel
from ..operators import Operator, as_signal, parameter

__all__ = [
    "Backlash",
    "BacklashOperator",
    "backlash_run",
    "backlash_tangents",
]


@jit
def backlash_run(u, half_gap, play, out):
    """Write the play of ``u`` to ``out`` (n,), from ``play`` before the first sample."""
    for i in range(u.size):
        if play > u[i] + half_gap:
            play = u[i] + half_gap
        elif play < u[i] - half_gap:
            play = u[i] - half_gap
        out[i] = play


@jit
def backlash_tangents(u, du, half_gap, play, tangent, out, dout):
    """Write the play to ``out`` (n,) and its tangents to ``dout`` (n, m + 1).

    ``tangent`` (m + 1,) are those of ``play`` before the first sample, overwritten; the last column
    is the derivative with respect to the half gap.
    """
    m = du.shape[1]
    for i in range(u.size):
        side = 0.0
        if play > u[i] + half_gap:
            side = 1.0
        elif play < u[i] - half_gap:
            side = -1.0
        if side != 0.0:
            play = u[i] + side * half_gap
            for q in range(m):
                tangent[q] = du[i, q]
            tangent[m] = side
        out[i] = play
        for q in range(m + 1):
            dout[i, q] = tangent[q]


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
    >>> from skhyst.hysteresis import BacklashOperator
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


_PARTS = (0.01, 0.03, 0.1, 0.25)  # half gaps to start from, parts of the signal's range


class Backlash(ParametricModel):
    r"""Backlash: the response follows the drive once half the gap is used up.

    .. math:: y(t) = \max(u(t) - r, \min(u(t) + r, y(t^-)))

    It has no gain: put a model that has one before or behind it in a
    :class:`~skhyst.compose.Cascade`. Beside a free set of plays
    (:class:`~skhyst.hysteresis.PrandtlIshlinskii`) it cannot be told.

    Parameters
    ----------
    rank : {"drive", "sensor"}, default="drive"
        Where it stands when an effect search has to find its place in a series: before everything
        else, or behind it.
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample.
    dt : float, default=1.0
        Sampling interval in s of data without a time index. The model does not depend on it.
    method : str or Method, default="variable_projection"
        How the parameters are identified, see :mod:`skhyst.optimize`.

    Attributes
    ----------
    operator_ : BacklashOperator
        ``half_gap`` r, units of the drive.
    params_, params_std_ : dict
        The half gap and its standard error.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import Backlash
    >>> from skhyst.hysteresis import BacklashOperator
    >>> drive = np.sin(np.linspace(0, 20, 500))
    >>> y, _ = BacklashOperator(0.13).run(drive, 1.0)
    >>> round(Backlash().fit(drive.reshape(-1, 1), y).operator_.half_gap, 6)
    0.13
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "rank": [StrOptions({"drive", "sensor"})],
    }

    def __init__(self, *, rank="drive", initial_state="rest", dt=1.0, method="variable_projection"):
        self.rank = rank
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    @property
    def series_rank(self):
        return 0 if self.rank == "drive" else 50

    def starting_values(self, records):
        swing = max(np.ptp(record.u) for record in records) or 1.0
        return [(BacklashOperator(float(part * swing), self.series_rank), ()) for part in _PARTS]
