"""Clipping, a dead band, one-sided dead zones and smooth curves."""

from numbers import Integral

import numpy as np

from .._sklearn import Interval, StrOptions
from ..base import ParametricModel
from ._static import DeadBandOperator, DeadZoneOperator, PolynomialCurveOperator, SaturationOperator

__all__ = ["DeadBand", "DeadZones", "Saturation", "SmoothCurve", "limits_of_drive"]

_MARGIN = 1.2  # half width of a smooth curve over that of the data


def limits_of_drive(records):
    """Return the smallest and the largest value of the drive in all records."""
    return (
        float(min(record.u.min() for record in records)),
        float(max(record.u.max() for record in records)),
    )


class Saturation(ParametricModel):
    r"""Clipping at one or two levels.

    .. math:: y = \min(\max(u, a), b)

    Parameters
    ----------
    sides : {"both", "lower", "upper"}, default="both"
        Which limits there are.
    rank : {"drive", "sensor"}, default="sensor"
        Where it stands when an effect search has to find its place in a series: before everything
        else, or behind it.
    initial_state, dt, method
        As for every model; a memoryless model depends on neither.

    Attributes
    ----------
    operator_ : SaturationOperator
        ``lower`` and ``upper``, units of the signal.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.static import Saturation
    >>> u = np.linspace(-1, 1, 201)
    >>> model = Saturation(sides="upper").fit(u.reshape(-1, 1), np.minimum(u, 0.6))
    >>> round(model.operator_.upper, 6)
    0.6
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "sides": [StrOptions({"both", "lower", "upper"})],
        "rank": [StrOptions({"drive", "sensor"})],
    }

    def __init__(
        self,
        *,
        sides="both",
        rank="sensor",
        initial_state="rest",
        dt=1.0,
        method="variable_projection",
    ):
        self.sides = sides
        self.rank = rank
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    @property
    def series_rank(self):
        return 0 if self.rank == "drive" else 50

    def starting_values(self, records):
        low, high = limits_of_drive(records)
        starts = []
        for part in (0.03, 0.08, 0.15, 0.25, 0.35):
            levels = {
                "lower": {"lower": low + part * (high - low)},
                "upper": {"upper": high - part * (high - low)},
            }
            levels["both"] = levels["lower"] | levels["upper"]
            starts.append((SaturationOperator(**levels[self.sides], rank=self.series_rank), ()))
        return starts


class DeadBand(ParametricModel):
    r"""No response within a band around a level: the dead zone of a valve or of a stage.

    .. math:: y = \max(u - b, 0) + \min(u - a, 0)

    It has no gain: put a model that has one behind it in a :class:`~skhyst.compose.Cascade`.

    Parameters
    ----------
    initial_state, dt, method
        As for every model; a memoryless model depends on neither.

    Attributes
    ----------
    operator_ : DeadBandOperator
        ``center`` (a + b) / 2 and ``half_width`` (b - a) / 2, units of the signal.

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

    series_rank = DeadBandOperator.rank
    _any_interval = True

    def __init__(self, *, initial_state="rest", dt=1.0, method="variable_projection"):
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    def starting_values(self, records):
        low, high = limits_of_drive(records)
        centers = {0.0, 0.5 * (low + high)} if low < 0.0 < high else {0.5 * (low + high)}
        return [
            (DeadBandOperator(part * (high - low) or 1.0, center), ())
            for center in sorted(centers)
            for part in (0.01, 0.03, 0.08, 0.2)
        ]


class DeadZones(ParametricModel):
    r"""Superposition of one-sided dead zones.

    .. math:: y = u + \sum_j w_j D_j(u)

    :math:`D_j(u) = \max(u - r_j, 0)` on the upper side, :math:`\min(u - r_j, 0)` on the lower one:
    the part that makes a Prandtl-Ishlinskii model asymmetric (thesis section 3.2; Kuhnen 2003).

    Parameters
    ----------
    n_zones : int, default=3
        Number of dead zones a side.
    sides : {"both", "lower", "upper"}, default="both"
        Which sides have dead zones.
    initial_state, dt, method
        As for every model; a memoryless model depends on neither.

    Attributes
    ----------
    operator_ : DeadZoneOperator
        ``weights``, ``thresholds`` (units of the signal), ``side``.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.static import DeadZones
    >>> u = np.linspace(-1, 1, 201)
    >>> y = u + 0.5 * np.maximum(u - 0.3, 0.0)
    >>> model = DeadZones(n_zones=1, sides="upper").fit(u.reshape(-1, 1), y)
    >>> round(float(model.operator_.thresholds[0]), 6)
    0.3
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "n_zones": [Interval(Integral, 1, None, closed="left")],
        "sides": [StrOptions({"both", "lower", "upper"})],
    }

    series_rank = DeadZoneOperator.rank
    _any_interval = True

    def __init__(
        self, n_zones=3, *, sides="both", initial_state="rest", dt=1.0, method="variable_projection"
    ):
        self.n_zones = n_zones
        self.sides = sides
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    def starting_values(self, records):
        low, high = limits_of_drive(records)
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        parts = half * np.arange(self.n_zones) / self.n_zones
        sides = {"lower": (-1,), "upper": (1,), "both": (-1, 1)}[self.sides]
        thresholds = np.concatenate([middle + side * parts for side in sides])
        signs = np.repeat(sides, self.n_zones)
        return [(DeadZoneOperator(np.zeros(len(signs)), thresholds, signs), ())]


class SmoothCurve(ParametricModel):
    r"""Smooth memoryless curve: Legendre polynomials from degree 2 on, added to the identity.

    Beyond the range of the fit by more than a fifth of its half, the curve goes on along its
    tangent.

    Parameters
    ----------
    degree : int, default=5
        Highest degree, at least 2.
    initial_state, dt, method
        As for every model; a memoryless model depends on neither.

    Attributes
    ----------
    operator_ : PolynomialCurveOperator
        ``coefficients``, from degree 2 on, relative to ``scale``.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.static import SmoothCurve
    >>> u = np.linspace(-1, 1, 201)
    >>> y = u + 0.1 * (u**3 - 0.864 * u)
    >>> model = SmoothCurve(degree=3).fit(u.reshape(-1, 1), y)
    >>> bool(np.allclose(model.predict(u.reshape(-1, 1)), y))
    True
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "degree": [Interval(Integral, 2, None, closed="left")],
    }

    series_rank = PolynomialCurveOperator.rank
    _any_interval = True

    def __init__(self, degree=5, *, initial_state="rest", dt=1.0, method="variable_projection"):
        self.degree = degree
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    def starting_values(self, records):
        low, high = limits_of_drive(records)
        scale = _MARGIN * 0.5 * (high - low) or 1.0
        operator = PolynomialCurveOperator(
            np.zeros(self.degree - 1), center=0.5 * (low + high), scale=scale
        )
        return [(operator, ())]
