"""Saturation with a rounded knee."""

from dataclasses import dataclass

import numpy as np
from scipy.special import expit

from ._base import parameter
from ._static import StaticOperator

__all__ = ["SoftSaturationOperator"]

_BROADEST, _SHARPEST = 0.3, 50.0  # knee
_LEAST = np.finfo(float).tiny


@dataclass(frozen=True)
class SoftSaturationOperator(StaticOperator):
    r"""Saturation with a rounded knee: ``y = c + v / (1 + |v / L|^n)^(1 / n)``, ``v = u - c``.

    Its slope is 1 at the centre c; far from it the output approaches ``c - L`` and ``c + L``. The
    larger the knee n, the sharper: it is the clip to these levels in the limit.

    Parameters
    ----------
    level : float
        L, units of the drive.
    knee : float, default=2.0
        n, from 0.3 to 50.
    center : float, default=0.0
        c, units of the drive.
    side : {0, 1, -1}, default=0
        Saturates on both sides of the centre, above it or below it; the other side is straight.
    rank : int, default=50
        50 for a sensor, 0 for what limits the drive.
    """

    level: float = parameter(log=True, lower=0.0, unit="drive")
    knee: float = parameter(log=True, lower=_BROADEST, upper=_SHARPEST, default=2.0)
    center: float = parameter(unit="drive", default=0.0)
    side: int = 0
    rank: int = 50

    def _evaluate(self, v):
        n, distance = self.knee, v - self.center
        # logarithms: a power of the distance would overflow
        size = np.log(np.maximum(np.abs(distance), _LEAST)) - np.log(self.level)
        full = expit(n * size)  # |v/L|^n / (1 + |v/L|^n)
        beyond = size > 0.0
        rest = np.log1p(np.exp(-n * np.abs(size))) / n
        value = np.where(beyond, np.sign(distance) * self.level, distance) * np.exp(-rest)
        slope = np.exp(-(n + 1.0) * (rest + np.maximum(size, 0.0)))
        knee = value * (rest + np.maximum(size, 0.0) - full * size) / n
        own = np.stack([value / self.level * full, knee, 1.0 - slope], axis=1)
        if self.side:
            straight = distance * self.side < 0.0
            value, slope = np.where(straight, distance, value), np.where(straight, 1.0, slope)
            own[straight] = 0.0
        return self.center + value, slope, own

    def inverse(self, y):
        """Return the drive of a response (n_samples,).

        Beyond what the response reaches, the drive is infinite.
        """
        distance = np.asarray(y, dtype=float) - self.center
        with np.errstate(divide="ignore"):
            part = np.log(np.abs(distance)) - np.log(self.level)
            room = -np.expm1(self.knee * np.minimum(part, 0.0))
            drive = np.where(
                room > 0.0,
                distance * np.exp(-np.log(room) / self.knee),
                np.copysign(np.inf, distance),
            )
        if self.side:
            drive = np.where(distance * self.side < 0.0, distance, drive)
        return self.center + drive
