"""Memoryless operators: clipping, a dead band, one-sided dead zones, a smooth curve."""

from dataclasses import dataclass

import numpy as np

from ..operators import Operator, parameter

__all__ = [
    "DeadBandOperator",
    "DeadZoneOperator",
    "PolynomialCurveOperator",
    "SaturationOperator",
    "StaticOperator",
]


class StaticOperator(Operator):
    """Base of the memoryless operators; a subclass gives ``_evaluate``."""

    rank = 40

    def _evaluate(self, v):
        """Return the curve (n,), its slope (n,) and its parameter derivatives (n, n_parameters)."""
        raise NotImplementedError

    def init(self, u0, initial_state="rest"):
        return ()

    def run(self, u, dt, state=None):
        return self._evaluate(np.asarray(u, dtype=float))[0], ()

    def linearize(self, u, du, dt, initial_state="rest"):
        y, slope, own = self._evaluate(u)
        return y, np.concatenate([du * slope[:, None], own], axis=1)


@dataclass(frozen=True)
class SaturationOperator(StaticOperator):
    """Clipping to ``lower <= y <= upper``; an infinite level is no limit and is not identified."""

    lower: float = parameter(unit="drive", default=-np.inf)
    upper: float = parameter(unit="drive", default=np.inf)
    rank: int = 0

    def parameter_specs(self):
        return {
            name: spec
            for name, spec in super().parameter_specs().items()
            if np.isfinite(getattr(self, name))
        }

    def _evaluate(self, v):
        below, above = v < self.lower, v > self.upper
        own = [
            mask for mask, level in ((below, self.lower), (above, self.upper)) if np.isfinite(level)
        ]
        return (
            np.clip(v, self.lower, self.upper),
            (~(below | above)).astype(float),
            np.stack(own, axis=1).astype(float) if own else np.empty((len(v), 0)),
        )


@dataclass(frozen=True)
class DeadBandOperator(StaticOperator):
    """No response within a band: ``y = v - clip(v, center - half_width, center + half_width)``."""

    half_width: float = parameter(log=True, lower=0.0, unit="drive")
    center: float = parameter(unit="drive", default=0.0)
    rank: int = 0

    def _evaluate(self, v):
        distance = v - self.center
        side = np.sign(distance) * (np.abs(distance) > self.half_width)
        slope = np.abs(side)
        return slope * distance - side * self.half_width, slope, np.stack([-side, -slope], axis=1)


@dataclass(frozen=True)
class DeadZoneOperator(StaticOperator):
    """Superposition of one-sided dead zones (Kuhnen 2003; thesis section 3.2).

    ``y = v + sum_j weights_j D_j(v)`` with ``D_j(v) = max(v - thresholds_j, 0)`` where ``side`` is
    +1 and ``min(v - thresholds_j, 0)`` where it is -1.
    """

    weights: np.ndarray = parameter(linear=True)
    thresholds: np.ndarray = parameter(unit="response")
    side: np.ndarray
    rank: int = 20

    def _evaluate(self, v):
        distance = v[:, None] - self.thresholds
        active = (distance * self.side > 0.0).astype(float)
        zones = distance * active
        return (
            v + zones @ self.weights,
            1.0 + active @ self.weights,
            np.concatenate([zones, -active * self.weights], axis=1),
        )


@dataclass(frozen=True)
class PolynomialCurveOperator(StaticOperator):
    """Smooth memoryless curve ``y = v + scale sum_d coefficients_d P_d((v - center) / scale)``.

    P_d are the Legendre polynomials of degree 2, 3, ...; beyond ``center +- scale`` the curve
    goes on along its tangent.
    """

    coefficients: np.ndarray = parameter(linear=True)
    center: float
    scale: float
    rank: int = 40

    def _evaluate(self, v):
        z = (v - self.center) / self.scale
        inside = np.clip(z, -1.0, 1.0)
        beyond = z - inside
        n = np.size(self.coefficients)
        values = np.polynomial.legendre.legvander(inside, n + 1)
        # P'_d = (2 d - 1) P_{d-1} + P'_{d-2}
        slopes = np.zeros_like(values)
        slopes[:, 1] = 1.0
        for d in range(2, n + 2):
            slopes[:, d] = (2 * d - 1) * values[:, d - 1] + slopes[:, d - 2]
        values, slopes = values[:, 2:], slopes[:, 2:]
        own = self.scale * (values + slopes * beyond[:, None])
        return v + own @ self.coefficients, 1.0 + slopes @ self.coefficients, own
