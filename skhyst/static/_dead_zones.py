r"""One-sided dead zones: ``y = v + sum_j w_j D_j(v)``.

``D_j(v) = max(v - t_j, 0)`` on the upper side, ``min(v - t_j, 0)`` on the lower one (Kuhnen 2003,
section 4; Steinbusch 2020, section 3.2). The operator of the estimator has weights and thresholds
as parameters. The monotone one has the slopes instead: from one threshold to the next the curve is
straight, and its slope is one plus the weights of the active dead zones. With positive slopes,
which are simple bounds, it is strictly monotone and has an exact inverse.
"""

from dataclasses import dataclass, replace
from numbers import Integral

import numpy as np

from .._jit import jit
from .._sklearn import Interval, StrOptions
from ..operators import as_signal, parameter
from ._base import SIDES, StaticModel, StaticOperator, range_of_drive

_FLATTEST = 1e-3  # smallest slope, response over response; the slope of the inverse is at most 1000


@jit
def dead_zones(u, c, s):
    """Return ``u`` plus the dead zones; ``c`` is (weights, thresholds, sides), (n_zones,) each."""
    weights, thresholds, sides = c
    y = u
    for k in range(weights.size):
        distance = u - thresholds[k]
        if distance * sides[k] > 0.0:
            y += weights[k] * distance
    return y


@jit
def _dead_zone_tangents(v, weights, thresholds, sides, slope, by_parameters):
    """Fill the slope, and the derivatives by weights, then thresholds, (n_samples, 2 n_zones)."""
    n = weights.size
    for i in range(v.size):
        slope[i] = 1.0
        for k in range(n):
            distance = v[i] - thresholds[k]
            acts = distance * sides[k] > 0.0
            by_parameters[i, k] = distance if acts else 0.0
            by_parameters[i, n + k] = -weights[k] if acts else 0.0
            slope[i] -= by_parameters[i, n + k]


@dataclass(frozen=True)
class DeadZoneOperator(StaticOperator):
    """Superposition of one-sided dead zones.

    ``y = v + sum_j weights_j D_j(v)`` with ``D_j(v) = max(v - thresholds_j, 0)`` where ``side`` is
    +1 and ``min(v - thresholds_j, 0)`` where it is -1.

    Parameters
    ----------
    weights : ndarray of shape (n_zones,)
        Change of the slope at each threshold.
    thresholds : ndarray of shape (n_zones,)
        Units of the drive. Fixed structure.
    side : ndarray of shape (n_zones,)
        Side of its threshold on which a dead zone acts: 1 above, -1 below. Fixed structure.
    stage_order : int, default=20
        Place in a series. Fixed structure.

    Raises
    ------
    ValueError
        If there is not one threshold and one side per weight, or a side is neither 1 nor -1.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.static import DeadZoneOperator
    >>> zones = DeadZoneOperator(np.array([0.5]), np.array([1.0]), np.array([1]))
    >>> zones.run([-2.0, 0.5, 2.0], dt=1.0)[0]
    array([-2. ,  0.5,  2.5])
    """

    weights: np.ndarray = parameter(linear=True)
    thresholds: np.ndarray = parameter(unit="response")
    side: np.ndarray
    stage_order: int = 20

    characteristics = StaticOperator.bend

    curve = staticmethod(dead_zones)

    def __post_init__(self):
        super().__post_init__()
        self._require_size("thresholds", np.size(self.weights), "weight")
        self._require_size("side", np.size(self.weights), "weight")
        self._require("side", np.isin(self.side, (-1, 1)).all(), "be -1 or 1 each")

    def curve_constants(self):
        return self.weights, self.thresholds, self.side

    def evaluate(self, v):
        v, *constants = map(as_signal, (v, self.weights, self.thresholds, self.side))
        n = constants[0].size
        slope, by_parameters = np.empty(v.size), np.empty((v.size, 2 * n))
        _dead_zone_tangents(v, *constants, slope, by_parameters)
        return v + by_parameters[:, :n] @ self.weights, slope, by_parameters


@dataclass(frozen=True)
class MonotoneDeadZoneOperator(StaticOperator):
    """Superposition of one-sided dead zones of positive slopes (Kuhnen 2003, section 4).

    The curve is straight from one threshold to the next, of slope one between the two thresholds of
    the centre. The slopes, not the weights, are the parameters.

    Parameters
    ----------
    slopes : ndarray of shape (n_zones,)
        Slope on the far side of each threshold, seen from the centre. Bounded below by 0.001 when
        they are identified.
    thresholds : ndarray of shape (n_zones,)
        Ascending, units of the response. Fixed structure.
    n_lower : int
        Number of thresholds below the centre. Fixed structure.

    Raises
    ------
    ValueError
        If there is not one threshold per slope, or ``n_lower`` is not from 0 to their number.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.static import MonotoneDeadZoneOperator
    >>> curve = MonotoneDeadZoneOperator(np.array([2.0, 0.5]), np.array([-1.0, 1.0]), n_lower=1)
    >>> y, _ = curve.run([-3.0, 0.0, 3.0], dt=1.0)
    >>> y
    array([-5.,  0.,  2.])
    >>> curve.inverse().run(y, dt=1.0)[0]
    array([-3.,  0.,  3.])
    """

    slopes: np.ndarray = parameter(linear=True, lower=_FLATTEST)
    thresholds: np.ndarray
    n_lower: int

    stage_order = 20

    def __post_init__(self):
        super().__post_init__()
        n = np.size(self.slopes)
        self._require_size("thresholds", n, "slope")
        self._require("n_lower", 0 <= self.n_lower <= n, f"be from 0 to {n}, the number of slopes")

    @property
    def side(self):
        """Side to which each dead zone opens, -1 or +1, shape (n_zones,)."""
        return np.where(np.arange(np.size(self.thresholds)) < self.n_lower, -1, 1)

    @property
    def weights(self):
        """Weights of the dead zones, as those of a ``DeadZoneOperator``, shape (n_zones,)."""
        below, above = np.split(np.asarray(self.slopes, dtype=float), [self.n_lower])
        return np.concatenate([-np.diff(below, append=1.0), np.diff(above, prepend=1.0)])

    def parts(self, v):
        """Split values by the segments of the curve.

        Parameters
        ----------
        v : ndarray of shape (n,)
            Values of the input.

        Returns
        -------
        central : ndarray of shape (n,)
            Their part in the central segment.
        others : ndarray of shape (n, n_zones)
            Their parts in the others. All parts add up to ``v``; weighted by the slopes of the
            segments, to the output.
        """
        t, k = np.asarray(self.thresholds, dtype=float), self.n_lower
        gaps = np.diff(t, prepend=-np.inf, append=np.inf)
        low = np.concatenate([-gaps[:k], np.zeros(t.size - k)])
        high = np.concatenate([np.zeros(k), gaps[k + 1 :]])
        ends = np.concatenate([[-np.inf], t, [np.inf]])[k : k + 2]
        return np.clip(v, *ends), np.clip(v[:, None] - t, low, high)

    curve = staticmethod(dead_zones)

    def curve_constants(self):
        return self.weights, self.thresholds, self.side

    def _segments(self):
        """Return the slope of each segment (n_zones + 1,) and the output at each threshold."""
        slopes = np.insert(np.asarray(self.slopes, dtype=float), self.n_lower, 1.0)
        levels = np.append(0.0, np.cumsum(np.diff(self.thresholds) * slopes[1:-1]))
        centre = max(self.n_lower - 1, 0)
        return slopes, levels + (self.thresholds[centre] - levels[centre])

    def run(self, u, dt, state=None):
        """Map a signal of shape (n_samples,); see :meth:`Operator.run`."""
        v, t = np.asarray(u, dtype=float), self.thresholds
        slopes, levels = self._segments()
        y = np.interp(v, t, levels)
        y += slopes[0] * np.minimum(v - t[0], 0.0) + slopes[-1] * np.maximum(v - t[-1], 0.0)
        return y, ()

    def evaluate(self, v):
        slopes, _ = self._segments()
        _, parts = self.parts(v)
        return self.run(v, 1.0)[0], slopes[np.searchsorted(self.thresholds, v)], parts

    def inverse(self):
        """Return the exact inverse, an operator of the same kind.

        Raises
        ------
        ValueError
            If a slope is not positive.
        """
        if not np.all(np.asarray(self.slopes) > 0.0):
            raise ValueError(
                "MonotoneDeadZoneOperator has no inverse: its curve must be strictly monotone, "
                f"with slopes above zero. Got the smallest slope {np.min(self.slopes):g} instead."
            )
        _, thresholds = self._segments()
        return replace(self, slopes=1.0 / np.asarray(self.slopes), thresholds=thresholds)


class DeadZones(StaticModel):
    r"""Superposition of one-sided dead zones.

    .. math:: y = u + \sum_j w_j D_j(u)

    :math:`D_j(u) = \max(u - r_j, 0)` on the upper side, :math:`\min(u - r_j, 0)` on the lower one:
    the part that makes a Prandtl-Ishlinskii model asymmetric (Steinbusch, *Hysteresis and Dynamics
    Compensation for Accurate Positioning in High Speed Piezo Scanning Stages*, 2020, section 3.2;
    Kuhnen, *European Journal of Control*, 2003).

    Parameters
    ----------
    n_zones : int, default=3
        Number of dead zones per side.
    sides : {"both", "lower", "upper"}, default="both"
        Which sides have dead zones.

    Attributes
    ----------
    operator_ : DeadZoneOperator
        ``weights``, ``thresholds`` (units of the signal), ``side``.

    See Also
    --------
    skhyst.hysteresis.ModifiedPrandtlIshlinskii : Plays with this curve behind them.
    SmoothCurve : A curve without kinks.

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
        **StaticModel._parameter_constraints,
        "n_zones": [Interval(Integral, 1, None, closed="left")],
        "sides": [StrOptions(set(SIDES))],
    }

    operator_class = DeadZoneOperator

    def __init__(
        self,
        n_zones=3,
        *,
        sides="both",
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        super().__init__(initial_state=initial_state, dt=dt, drive=drive, method=method)
        self.n_zones = n_zones
        self.sides = sides

    def starting_values(self, records):
        low, high = range_of_drive(records)
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        parts = half * np.arange(self.n_zones) / self.n_zones
        sides = SIDES[self.sides]
        thresholds = np.concatenate([middle + side * parts for side in sides])
        signs = np.repeat(sides, self.n_zones)
        return [DeadZoneOperator(np.zeros(len(signs)), thresholds, signs)]
