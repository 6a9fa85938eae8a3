"""Shift in time of either sign, ``y(t) = u(t - shift)``, between the clocks of two instruments."""

from dataclasses import dataclass

from ..base import ParametricModel
from ..operators import parameter
from ._delay import ShiftingOperator
from ._linear import log_grid, time_span


@dataclass(frozen=True)
class TimeShiftOperator(ShiftingOperator):
    """``y(t) = u(t - shift)``; the output looks ahead by as much, and by two samples.

    Where a signal ends, its last value stands: a part of it does not know what comes.
    """

    shift: float = parameter(unit="s")
    rank: int = 60
    causal = False


class TimeShift(ParametricModel):
    r"""Shift in time of either sign, by any part of a sample.

    .. math:: y(t) = u(t - \theta)

    It belongs to a recording and to no device: the channels of a data logger are read one after
    another, the filters of two amplifiers differ, two instruments start apart. Where the response
    is ahead of the drive the model looks ahead, which none in service can.

    Attributes
    ----------
    operator_ : TimeShiftOperator
        ``shift`` in s, by which the response is late; negative where it is ahead.

    See Also
    --------
    Delay : Of a device, which is never ahead.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import TimeShift
    >>> time = np.arange(300) * 0.01
    >>> drive, y = np.sin(time), np.sin(time + 0.003)
    >>> print(f"{TimeShift(dt=0.01).fit(drive.reshape(-1, 1), y).operator_.shift:.4f} s")
    -0.0030 s
    """

    operator_class = TimeShiftOperator
    _any_interval = True

    def starting_values(self, records):
        dt, span = time_span(records)
        sizes = [0.5 * dt, *log_grid(2.0 * dt, max(0.02 * span, 4.0 * dt), 3)]
        return [TimeShiftOperator(float(sign * size)) for size in sizes for sign in (-1.0, 1.0)]
