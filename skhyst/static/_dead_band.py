"""No response within a band: ``y = u - min(max(u, a), b)``."""

from dataclasses import dataclass

import numpy as np

from .._jit import jit
from ..operators import parameter
from ._base import StaticModel, StaticOperator, range_of_drive

_PARTS = (0.02, 0.06, 0.2)  # starting half widths, fractions of the drive's range


@jit
def dead_band(u, c, s):
    """Return the distance beyond the band, 0 within it; ``c`` is (half width, centre)."""
    half_width, center = c
    distance = u - center
    return distance - min(max(distance, -half_width), half_width)


@dataclass(frozen=True)
class DeadBandOperator(StaticOperator):
    """No response within a band: ``y = v - clip(v, center - half_width, center + half_width)``.

    Parameters
    ----------
    half_width : float
        Units of the drive.
    center : float, default=0.0
        Units of the drive.
    stage_order : int, default=0
        Place in a series. Fixed structure.

    Examples
    --------
    >>> from skhyst.static import DeadBandOperator
    >>> DeadBandOperator(1.0).run([-2.0, 0.5, 2.0], dt=1.0)[0]
    array([-1.,  0.,  1.])
    """

    half_width: float = parameter(log=True, lower=0.0, unit="drive")
    center: float = parameter(unit="drive", default=0.0)
    stage_order: int = 0

    curve = staticmethod(dead_band)

    def curve_constants(self):
        return self.half_width, self.center

    def evaluate(self, v):
        distance = v - self.center
        side = np.sign(distance) * (np.abs(distance) > self.half_width)
        slope = np.abs(side)
        return slope * distance - side * self.half_width, slope, np.stack([-side, -slope], axis=1)


class DeadBand(StaticModel):
    r"""No response within a band around a level: the dead zone of a valve or of a stage.

    .. math:: y = \max(u - b, 0) + \min(u - a, 0)

    It has no gain: put a model that has one after it in a :class:`~skhyst.compose.Cascade`.

    Attributes
    ----------
    operator_ : DeadBandOperator
        ``center`` (a + b) / 2 and ``half_width`` (b - a) / 2, units of the signal.

    See Also
    --------
    skhyst.hysteresis.Backlash : A gap with memory.
    DeadZones : One-sided dead zones, added.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.static import DeadBand
    >>> u = np.linspace(-1, 1, 201)
    >>> y = np.maximum(u - 0.3, 0.0) + np.minimum(u + 0.1, 0.0)
    >>> model = DeadBand().fit(u.reshape(-1, 1), y)
    >>> round(model.operator_.center, 6), round(model.operator_.half_width, 6)
    (0.1, 0.2)
    """

    operator_class = DeadBandOperator

    def starting_values(self, records):
        low, high = range_of_drive(records)
        starts = []
        for part in _PARTS:  # adjacent bands cover the range: one of them overlaps the true one
            count = int(np.ceil(0.5 / part))
            half_width = 0.5 * (high - low) / count or 1.0
            centers = low + half_width * np.arange(1, 2 * count, 2)
            centers = [*centers, 0.0] if low < 0.0 < high else centers
            starts += [DeadBandOperator(half_width, center) for center in centers]
        return starts
