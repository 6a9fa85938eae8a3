"""Backlash: one play operator of unknown width."""

from dataclasses import dataclass

from .._sklearn import StrOptions
from ..base import ParametricModel
from ..operators import OneStateOperator, parameter
from ._common import largest_peak_to_peak


def backlash_step(play, u0, u1, dt, values):
    """Return the next value of the play, which is state and output, and its derivatives."""
    half_gap = values[0]
    side = 0.0
    if play > u1 + half_gap:
        side = 1.0
    elif play < u1 - half_gap:
        side = -1.0
    if side == 0.0:
        by = (1.0, 0.0, 0.0, 0.0)
    else:
        play = u1 + side * half_gap
        by = (0.0, 0.0, 1.0, side)
    return play, play, by, by


@dataclass(frozen=True)
class BacklashOperator(OneStateOperator, step=backlash_step):
    """The output follows the input once half the gap is used up; see :class:`Backlash`.

    Parameters
    ----------
    half_gap : float
        ``r``, units of the drive, positive.
    stage_order : int, default=0
        Position in a series: 0 before all other stages, 50 after them.

    Notes
    -----
    Exact for a drive that is a straight line between samples. The state is ``(output, last
    drive)``. ``"rest"`` is the state after a first loading from zero to the first sample.

    Examples
    --------
    >>> from skhyst.hysteresis import BacklashOperator
    >>> BacklashOperator(0.5).run([0.0, 2.0, 1.5, -1.0], dt=1e-3)[0]
    array([ 0. ,  1.5,  1.5, -0.5])
    """

    half_gap: float = parameter(log=True, lower=0.0, unit="drive")
    stage_order: int = 0


_PARTS = (0.01, 0.03, 0.1, 0.25)  # starting half gaps, fractions of the drive's range


class Backlash(ParametricModel):
    r"""Backlash: the response follows the drive once half the gap is used up, at any rate.

    .. math:: y(t) = \max(u(t) - r, \min(u(t) + r, y(t^-)))

    It has no gain: combine it with a model that has one in a :class:`~skhyst.compose.Cascade`. It
    cannot be distinguished from a free set of plays in the same model
    (:class:`~skhyst.hysteresis.PrandtlIshlinskii`).

    Parameters
    ----------
    place : {"drive", "sensor"}, default="drive"
        Position in a series that an effect search builds: before all other stages, or after them.

    Attributes
    ----------
    operator_ : BacklashOperator
        ``half_gap`` r, units of the drive.

    See Also
    --------
    PrandtlIshlinskii : Many plays of different widths, added.
    skhyst.static.DeadBand : No response within a band, without memory.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import Backlash, BacklashOperator
    >>> drive = np.sin(np.linspace(0, 20, 500))
    >>> y, _ = BacklashOperator(0.13).run(drive, 1.0)
    >>> round(Backlash().fit(drive.reshape(-1, 1), y).operator_.half_gap, 6)
    0.13
    """

    operator_class = BacklashOperator
    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "place": [StrOptions({"drive", "sensor"})],
    }

    def __init__(
        self,
        *,
        place="drive",
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        super().__init__(initial_state=initial_state, dt=dt, drive=drive, method=method)
        self.place = place

    @property
    def stage_order(self) -> int:
        return 0 if self.place == "drive" else 50

    def starting_values(self, records):
        length = largest_peak_to_peak(records)
        return [BacklashOperator(part * length, self.stage_order) for part in _PARTS]
