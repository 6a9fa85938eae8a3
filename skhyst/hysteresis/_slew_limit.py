"""Limit of the drive's rate, exact for a drive that is a straight line between samples.

With ``e`` the drive minus the output, ``s`` the drive's slope and ``R`` the limit, the output
moves towards the drive at the rate ``R`` until they meet, after the time ``e / (R - s)`` for
``e > 0``. From there it follows the drive, or falls behind again if ``|s| > R``.
"""

from dataclasses import dataclass

from ..base import ParametricModel
from ..operators import OneStateOperator, parameter
from ._common import fastest_change


def slew_limit_step(y, u0, u1, dt, values):
    """Return the next output, which is also the state, and its derivatives."""
    limit = values[0] * dt
    side = 1.0 if u0 > y or (u0 == y and u1 > u0) else -1.0
    lead, change = side * (u0 - y), side * (u1 - u0)
    if lead + change >= limit:
        y += side * limit
        by = (1.0, 0.0, 0.0, side * dt)
    elif change >= -limit:
        y = u1
        by = (0.0, 0.0, 1.0, 0.0)
    else:  # they meet within the interval, then the drive outruns the output on the other side
        met = lead / (limit - change)
        y += side * limit * (2.0 * met - 1.0)
        slowed = (limit + change) / (limit - change)
        remaining = 1.0 - met
        by = (
            -slowed,
            remaining * (1.0 + slowed),
            met * (1.0 + slowed),
            -side * dt * (remaining + slowed * met),
        )
    return y, y, by, by


@dataclass(frozen=True)
class SlewLimitOperator(OneStateOperator, step=slew_limit_step):
    """Rate limiter: the output follows the input at a limited rate; see :class:`SlewLimit`.

    Parameters
    ----------
    rate : float
        ``R``, units of the drive over s, positive.

    Notes
    -----
    Exact for a drive that is a straight line between samples. The state is ``(output, last
    drive)``; ``"rest"`` sets both to the first sample.

    Examples
    --------
    >>> from skhyst.hysteresis import SlewLimitOperator
    >>> SlewLimitOperator(100.0).run([0.0, 0.25, 0.25, 0.25], dt=1e-3)[0]
    array([0.  , 0.1 , 0.2 , 0.25])
    """

    rate: float = parameter(log=True, lower=0.0, unit="drive/s")
    stage_order = 0
    moves_at_rest = True

    def characteristics(self, seen):
        return {"fastest drive": (seen.rates.max(), "drive/s")}

    def rest(self, u0):
        return u0, (1.0, 0.0)


_PARTS = (0.9, 0.6, 0.3, 0.1)  # starting limits, fractions of the drive's highest rate


class SlewLimit(ParametricModel):
    r"""Slew limit: the response follows the drive at a limited rate.

    .. math:: \dot y = R \operatorname{sgn}(u - y), \quad \text{and } \dot y = \dot u
       \text{ while } y = u, |\dot u| \le R

    as for an amplifier that charges a capacitance with a limited current. It has no gain: put a
    model that has one after it in a :class:`~skhyst.compose.Cascade`.

    Attributes
    ----------
    operator_ : SlewLimitOperator
        ``rate`` R, units of the drive over s.

    See Also
    --------
    skhyst.static.Saturation : Limits of the level.
    skhyst.linear.FirstOrderLag : Slow at every amplitude.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import SlewLimit, SlewLimitOperator
    >>> drive = np.repeat([0.0, 1.0, -1.0, 0.5], 100)
    >>> y, _ = SlewLimitOperator(3.0).run(drive, 0.01)
    >>> round(SlewLimit(dt=0.01).fit(drive.reshape(-1, 1), y).operator_.rate, 6)
    3.0
    """

    operator_class = SlewLimitOperator

    def starting_values(self, records):
        fastest = fastest_change(records)
        return [SlewLimitOperator(float(part * fastest or 1.0)) for part in _PARTS]
