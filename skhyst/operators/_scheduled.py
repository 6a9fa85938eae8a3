"""An operator whose parameters depend on a number that belongs to the record."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from math import comb

import numpy as np
from numpy.polynomial import Polynomial

from ._base import Operator

__all__ = ["ScheduledOperator"]


@dataclass(frozen=True)
class ScheduledOperator(Operator):
    """Parameters are polynomials of a schedule, such as the amplitude of the record.

    A polynomial of degree d is given by its Bernstein coefficients over the range of the schedule:
    the parameter stays between the least and the largest of them, so that a bound of the parameter
    is a bound of each coefficient, and those at the ends are the parameter's values there.

    Attributes
    ----------
    base : Operator
        Gives everything but the scheduled values.
    degrees : tuple of int
        Of each value of ``base.pack()``.
    coefficients : ndarray of shape (sum(degrees) + len(degrees),)
    low, high : float
        Range of the schedule.
    schedule : float or None
        The record's number; :meth:`at` sets it.
    """

    base: Operator
    degrees: tuple
    coefficients: np.ndarray
    low: float
    high: float
    schedule: float | None = field(default=None)

    @property
    def signal_linear(self):
        return self.base.signal_linear

    @property
    def carries_scale(self):
        return self.base.carries_scale

    @property
    def rank(self):
        return self.base.rank

    @classmethod
    def constant(cls, base, degrees, low, high):
        """Return the operator whose parameters do not depend on the schedule yet."""
        coefficients = np.repeat(base.pack(), np.asarray(degrees, dtype=int) + 1)
        return cls(base, tuple(degrees), coefficients, low, high)

    def parameter_specs(self):
        return dict(self.entries())

    def entries(self):
        return [
            (f"{name}[{k}]" if degree else name, spec)
            for (name, spec), degree in zip(self.base.entries(), self.degrees, strict=True)
            for k in range(degree + 1)
        ]

    def sizes(self):
        return dict.fromkeys((name for name, _ in self.entries()), 1)

    def pack(self):
        return np.array(self.coefficients, dtype=float)

    def unpack(self, vector):
        return replace(self, coefficients=np.array(vector, dtype=float))

    def linear_mask(self):
        return np.repeat(self.base.linear_mask(), self._counts)

    def gauge_entries(self):
        return np.repeat(self.base.gauge_entries(), self._counts)

    def gauge_mask(self):
        return np.repeat(self.base.gauge_mask(), self._counts)

    @property
    def _counts(self):
        return np.asarray(self.degrees, dtype=int) + 1

    def at(self, schedule):
        """Return the operator of a record with this schedule."""
        return replace(self, schedule=float(schedule))

    @cached_property
    def _basis(self):
        """The Bernstein polynomials at the schedule, shape of ``coefficients``."""
        if self.schedule is None:
            raise ValueError(
                "The parameters depend on the record: use the operator that 'at' returns."
            )
        span = self.high - self.low
        t = (self.schedule - self.low) / span if span > 0.0 else 0.0
        return np.concatenate(
            [[comb(d, k) * t**k * (1.0 - t) ** (d - k) for k in range(d + 1)] for d in self.degrees]
        )

    @cached_property
    def operator(self):
        """The operator with plain parameters at the schedule.

        Beyond the range of the schedule the polynomials go on, up to the parameters' bounds.
        """
        starts = np.cumsum(np.r_[0, self._counts[:-1]])
        values = np.add.reduceat(self.coefficients * self._basis, starts)
        specs = [spec for _, spec in self.base.entries()]
        return self.base.unpack(
            np.clip(values, [spec.lower for spec in specs], [spec.upper for spec in specs])
        )

    def polynomials(self):
        """Return the coefficients by powers of the schedule, lowest first, by name."""
        span = self.high - self.low
        t = Polynomial([-self.low / span, 1.0 / span]) if span > 0.0 else Polynomial([0.0])
        found, start = {}, 0
        for (name, _), d in zip(self.base.entries(), self.degrees, strict=True):
            own = self.coefficients[start : start + d + 1]
            terms = (comb(d, k) * own[k] * t**k * (1 - t) ** (d - k) for k in range(d + 1))
            power = sum(terms, Polynomial([0.0])).coef
            found[name] = np.pad(power, (0, max(d + 1 - len(power), 0)))[: d + 1]
            start += d + 1
        return found

    def __getstate__(self):
        return {k: v for k, v in self.__dict__.items() if k not in ("_basis", "operator")}

    def init(self, u0, initial_state="rest"):
        return self.operator.init(u0, initial_state)

    def run(self, u, dt, state=None):
        return self.operator.run(u, dt, state)

    def linearize(self, u, du, dt, initial_state="rest"):
        y, dy = self.operator.linearize(u, du, dt, initial_state)
        m = du.shape[1]
        own = np.repeat(dy[:, m:], self._counts, axis=1) * self._basis
        return y, np.concatenate([dy[:, :m], own], axis=1)
