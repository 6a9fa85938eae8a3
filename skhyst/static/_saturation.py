"""Clipping: ``y = min(max(u, a), b)``."""

from dataclasses import dataclass

import numpy as np

from .._jit import jit
from ..operators import parameter
from ._base import SIDES, SaturationModel, StaticOperator, range_of_drive

_PARTS = (0.03, 0.08, 0.15, 0.25, 0.35)  # starting fractions of the drive's range that are clipped


@jit
def clip(u, c, s):
    """Return ``min(max(u, lower), upper)``; ``c`` is (lower, upper)."""
    lower, upper = c
    return min(max(u, lower), upper)


@dataclass(frozen=True)
class SaturationOperator(StaticOperator):
    """Clipping to ``lower <= y <= upper``; an infinite level is no limit and is not identified.

    Parameters
    ----------
    lower, upper : float, default=-inf, inf
        Levels, units of the drive.
    stage_order : int, default=0
        Place in a series: 0 for a limit of the drive, 50 for one of a sensor. Fixed structure.

    Examples
    --------
    >>> from skhyst.static import SaturationOperator
    >>> SaturationOperator(upper=1.0).run([-2.0, 0.5, 2.0], dt=1.0)[0]
    array([-2. ,  0.5,  1. ])
    """

    lower: float = parameter(unit="drive", default=-np.inf)
    upper: float = parameter(unit="drive", default=np.inf)
    stage_order: int = 0

    def parameter_specs(self):
        specs = super().parameter_specs()
        return {name: spec for name, spec in specs.items() if np.isfinite(getattr(self, name))}

    curve = staticmethod(clip)

    def curve_constants(self):
        return self.lower, self.upper

    def evaluate(self, v):
        beyond = {"lower": v < self.lower, "upper": v > self.upper}
        by_levels = np.empty((len(v), self.n_parameters))
        for column, name in enumerate(self._sizes):
            by_levels[:, column] = beyond[name]
        slope = (~(beyond["lower"] | beyond["upper"])).astype(float)
        return np.clip(v, self.lower, self.upper), slope, by_levels


class Saturation(SaturationModel):
    r"""Clipping at one or two levels.

    .. math:: y = \min(\max(u, a), b)

    Attributes
    ----------
    operator_ : SaturationOperator
        ``lower`` and ``upper``, units of the signal.

    See Also
    --------
    SoftSaturation : With a rounded knee.
    skhyst.hysteresis.SlewLimit : Limits of the rate.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.static import Saturation
    >>> u = np.linspace(-1, 1, 201)
    >>> model = Saturation(sides="upper").fit(u.reshape(-1, 1), np.minimum(u, 0.6))
    >>> round(model.operator_.upper, 6)
    0.6
    """

    def __init__(
        self,
        *,
        sides="both",
        place="sensor",
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        super().__init__(initial_state=initial_state, dt=dt, drive=drive, method=method)
        self.sides = sides
        self.place = place

    def starting_values(self, records):
        low, high = range_of_drive(records)
        starts = []
        for part in _PARTS:
            clipped = part * (high - low)
            levels = {-1: {"lower": low + clipped}, 1: {"upper": high - clipped}}
            limits = {k: v for side in SIDES[self.sides] for k, v in levels[side].items()}
            starts.append(SaturationOperator(**limits, stage_order=self.stage_order))
        return starts
