"""Backlash: one play of unknown width."""

import numpy as np

from .._sklearn import StrOptions
from ..base import ParametricModel
from ..operators import BacklashOperator

__all__ = ["Backlash"]

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
    >>> from skhyst.operators import BacklashOperator
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
    def _rank(self):
        return 0 if self.rank == "drive" else 50

    def _starts(self, records):
        swing = max(np.ptp(record.u) for record in records) or 1.0
        return [(BacklashOperator(float(part * swing), self._rank), ()) for part in _PARTS]
