"""What the linear models share."""

from numbers import Integral

import numpy as np

from .._sklearn import StrOptions
from ..base import ParametricModel

__all__ = ["LinearModel", "chosen_columns", "log_grid", "slope", "time_span"]


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
        return frozenset(n for n in ("gain", "intercept") if not getattr(self, f"fit_{n}", True))


def chosen_columns(inputs, names, count, caller):
    """Return the positions of the columns of X that are chosen by position or name."""
    names, found = list(names), []
    for wanted in inputs:
        if isinstance(wanted, str):
            found.append(names.index(wanted) if wanted in names else None)
        else:
            inside = isinstance(wanted, Integral) and -count <= wanted < count
            found.append(int(wanted) % count if inside else None)
    if not found or None in found or len(set(found)) < len(found):
        named = f" or name ({names})" if names else ""
        raise ValueError(
            f"The 'inputs' parameter of {caller} must be 'all', or at least one column of X and "
            f"none twice, by position (below {count}){named}. Got {inputs!r} instead."
        )
    return found


def time_span(records):
    """Return the shortest interval and the longest record's duration, in s."""
    return min(r.dt for r in records), max(len(r.u) * r.dt for r in records)


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
