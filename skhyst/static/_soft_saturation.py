"""Saturation with a rounded knee: ``y = c + v / (1 + |v / L|^n)^(1 / n)``, ``v = u - c``."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import expit

from .._jit import jit
from ..operators import parameter
from ._base import SIDES, SaturationModel, StaticOperator, range_of_drive

_BROADEST, _SHARPEST = 0.3, 50.0  # bounds of the knee
_LEVELS = (0.5, 0.8, 1.3)  # starting levels relative to the largest distance from the centre
_KNEES = (1.0, 2.0, 4.0)
_LEAST = float(np.finfo(float).tiny)


@jit
def soft_saturation(u, c, s):
    """Return ``c + v / (1 + |v / L|^n)^(1 / n)``; ``c`` is (L, n, c, side)."""
    level, knee, center, side = c
    distance = u - center
    if side * distance < 0.0:
        return u
    size = abs(distance)
    # powers of at most 1, so that none overflows
    if size > level:
        limit = math.copysign(level, distance)
        return center + limit / (1.0 + (level / size) ** knee) ** (1.0 / knee)
    return center + distance / (1.0 + (size / level) ** knee) ** (1.0 / knee)


@dataclass(frozen=True)
class SoftSaturationOperator(StaticOperator):
    """Saturation with a rounded knee, :class:`SoftSaturation`.

    Parameters
    ----------
    level : float
        L, units of the drive.
    knee : float, default=2.0
        Exponent n, from 0.3 to 50.
    center : float, default=0.0
        Centre c, units of the drive.
    side : {0, 1, -1}, default=0
        Saturates on both sides of the centre, above it or below it; the other side is straight.
        Fixed structure.
    stage_order : int, default=50
        Place in a series: 50 for a sensor, 0 for a limit of the drive. Fixed structure.

    Raises
    ------
    ValueError
        If ``side`` is none of these.

    Examples
    --------
    >>> from skhyst.static import SoftSaturationOperator
    >>> SoftSaturationOperator(1.0).run([0.0, 1.0, 1e6], dt=1.0)[0].round(3).tolist()
    [0.0, 0.707, 1.0]
    """

    level: float = parameter(log=True, lower=0.0, unit="drive")
    knee: float = parameter(log=True, lower=_BROADEST, upper=_SHARPEST, default=2.0)
    center: float = parameter(unit="drive", default=0.0)
    side: int = 0
    stage_order: int = 50

    curve = staticmethod(soft_saturation)

    def __post_init__(self):
        super().__post_init__()
        self._require("side", self.side in (-1, 0, 1), "be -1, 0 or 1")

    def curve_constants(self):
        return self.level, self.knee, self.center, self.side

    def evaluate(self, v):
        n, distance = self.knee, v - self.center
        # logarithms: a power of the distance would overflow
        size = np.log(np.maximum(np.abs(distance), _LEAST)) - np.log(self.level)
        full = expit(n * size)  # |v/L|^n / (1 + |v/L|^n)
        beyond = size > 0.0
        rest = np.log1p(np.exp(-n * np.abs(size))) / n
        value = np.where(beyond, np.sign(distance) * self.level, distance) * np.exp(-rest)
        slope = np.exp(-(n + 1.0) * (rest + np.maximum(size, 0.0)))
        knee = value * (rest + np.maximum(size, 0.0) - full * size) / n
        by_parameters = np.stack([value / self.level * full, knee, 1.0 - slope], axis=1)
        if self.side:
            straight = distance * self.side < 0.0
            value, slope = np.where(straight, distance, value), np.where(straight, 1.0, slope)
            by_parameters[straight] = 0.0
        return self.center + value, slope, by_parameters

    def characteristics(self, seen):
        reduction = np.abs(self.run(seen.ends, 1.0)[0] - seen.ends).max()
        return {"reduction at the ends of the range": (reduction, "response")}

    def unsaturated(self, y):
        """Return the drive of a response.

        Parameters
        ----------
        y : ndarray of shape (n_samples,)
            Response.

        Returns
        -------
        ndarray of shape (n_samples,)
            Drive, infinite beyond saturation.
        """
        distance = np.asarray(y, dtype=float) - self.center
        with np.errstate(divide="ignore"):
            log_ratio = np.log(np.abs(distance)) - np.log(self.level)
            margin = -np.expm1(self.knee * np.minimum(log_ratio, 0.0))
            drive = np.where(
                margin > 0.0,
                distance * np.exp(-np.log(margin) / self.knee),
                np.copysign(np.inf, distance),
            )
        if self.side:
            drive = np.where(distance * self.side < 0.0, distance, drive)
        return self.center + drive


class SoftSaturation(SaturationModel):
    r"""Saturation with a rounded knee, as in a magnetic core or an amplifier.

    .. math:: y = c + \frac{v}{(1 + |v / L|^n)^{1/n}}, \qquad v = u - c

    The slope is 1 at the centre c, and far from it y approaches :math:`c \pm L`. With n = 1 this is
    the anhysteretic curve of Frohlich [1]_; the larger n, the sharper the knee, and
    :class:`Saturation` is the limit. It has no gain: combine it with a model that has
    one in a :class:`~skhyst.compose.Cascade`.

    Parameters
    ----------
    sides : {"both", "lower", "upper"}, default="both"
        Which sides of the centre saturate; the other one is straight.
    fit_center : bool, default=True
        Whether the centre is fitted; otherwise it is held at 0, for a symmetric device.

    Attributes
    ----------
    operator_ : SoftSaturationOperator
        ``level`` L and ``center`` c, units of the signal; ``knee`` n, from 0.3 to 50;
        ``unsaturated(y)``.

    See Also
    --------
    Saturation : With sharp limits.
    skhyst.hysteresis.JilesAtherton : Magnetic saturation with hysteresis.

    References
    ----------
    .. [1] Jiles and Atherton, *Journal of Magnetism and Magnetic Materials*, 1986, on anhysteretic
       curves.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.static import SoftSaturation
    >>> u = np.linspace(-3, 3, 201)
    >>> model = SoftSaturation(fit_center=False).fit(u.reshape(-1, 1), u / (1 + abs(u / 2)))
    >>> round(model.operator_.level, 6), round(model.operator_.knee, 6)
    (2.0, 1.0)
    """

    _parameter_constraints = {
        **SaturationModel._parameter_constraints,
        "fit_center": ["boolean"],
    }

    def __init__(
        self,
        *,
        sides="both",
        place="sensor",
        fit_center=True,
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        super().__init__(initial_state=initial_state, dt=dt, drive=drive, method=method)
        self.sides = sides
        self.place = place
        self.fit_center = fit_center

    def starting_values(self, records):
        low, high = range_of_drive(records)
        center = 0.5 * (low + high) if self.fit_center else 0.0
        half_range = max(high - center, center - low) or 1.0
        fixed = center, sum(SIDES[self.sides]), self.stage_order
        return [
            SoftSaturationOperator(part * half_range, knee, *fixed)
            for part in _LEVELS
            for knee in _KNEES
        ]
