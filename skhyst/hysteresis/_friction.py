"""What the friction models share."""

import numpy as np

from ..base import ParametricModel

__all__ = ["FrictionModel", "half_range", "swing", "top_speed"]


class FrictionModel(ParametricModel):
    """Base of the friction models: a spring, a dashpot and a constant beside the friction."""

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "fit_damping": ["boolean"],
        "fit_stiffness": ["boolean"],
        "fit_intercept": ["boolean"],
    }

    _rank = 10

    def _fixed(self):
        free = {
            "damping": self.fit_damping,
            "stiffness": self.fit_stiffness,
            "intercept": self.fit_intercept,
        }
        return frozenset(name for name, is_free in free.items() if not is_free)


def swing(records):
    """Return the largest peak-to-peak drive of the records, 1 where the drive never moves."""
    return max(float(np.ptp(record.u)) for record in records) or 1.0


def half_range(records):
    """Return half the largest peak-to-peak response, 1 where it is constant."""
    return 0.5 * max(float(np.ptp(record.y)) for record in records) or 1.0


def top_speed(records):
    """Return a speed that one in twenty samples exceeds, 1 where the drive never moves."""
    speeds = [np.abs(np.diff(record.u)) / record.dt for record in records]
    speeds = np.concatenate(speeds)
    moving = speeds[speeds > 0.0]
    return float(np.quantile(moving, 0.95)) if moving.size else 1.0
