"""What the linear models share."""

import numpy as np

from .._sklearn import StrOptions
from ..base import ParametricModel

__all__ = ["LinearModel", "log_grid", "slope", "time_span"]


class LinearModel(ParametricModel):
    """Base of the linear models: static gain, intercept, hold."""

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "fit_gain": ["boolean"],
        "fit_intercept": ["boolean"],
        "hold": [StrOptions({"foh", "zoh"})],
    }

    def __init__(
        self,
        *,
        fit_gain=True,
        fit_intercept=True,
        hold="foh",
        initial_state="rest",
        dt=1.0,
        method="variable_projection",
    ):
        self.fit_gain = fit_gain
        self.fit_intercept = fit_intercept
        self.hold = hold
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    @property
    def _any_interval(self):
        return getattr(self, "hold", "foh") == "foh"  # a delay has none

    def held_parameters(self):
        free = {"gain": self.fit_gain, "intercept": self.fit_intercept}
        return frozenset(name for name, is_free in free.items() if not is_free)


def time_span(records):
    """Return the shortest interval and the longest record's duration, in s."""
    return min(record.dt for record in records), max(
        len(record.u) * record.dt for record in records
    )


def log_grid(low, high, per_decade):
    """Return logarithmically spaced values from ``low`` to ``high``, both included."""
    decades = max(np.log10(high / low), 0.0)
    return np.geomspace(low, high, max(int(np.ceil(per_decade * decades)) + 1, 2))


def slope(records):
    """Return the least-squares slope of the response over the drive, 1 for a constant drive."""
    u = np.concatenate([record.u for record in records])
    y = np.concatenate([record.y for record in records])
    u, y = u - u.mean(), y - y.mean()
    power = u @ u
    return float(u @ y / power) if power > 0.0 else 1.0
