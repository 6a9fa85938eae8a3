"""What the models share: scales of the data to start from, base of friction models, checks."""

import numpy as np

from ..base import ParametricModel
from ..operators import slopes

_BLOCK = 20  # samples in which the noise is looked for
_QUIET = 0.25  # part of the blocks in which the motion is too slow to be taken for noise


class FrictionModel(ParametricModel):
    """Base of the friction models: a spring, a dashpot and a constant beside the friction.

    The drive is a displacement, the response a force (or anything that follows it).

    Parameters
    ----------
    fit_damping : bool, default=True
        Whether a viscous force ``d`` times the velocity is fitted (0 otherwise).
    fit_stiffness : bool, default=False
        Whether a spring ``k`` is fitted (0 otherwise).
    fit_intercept : bool, default=True
        Whether the response has a constant (a force offset).
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "fit_damping": ["boolean"],
        "fit_stiffness": ["boolean"],
        "fit_intercept": ["boolean"],
    }

    stage_order = 10


def force_characteristics(level, stiffness):
    """Return the characteristics of a hysteretic force whose input is the displacement."""
    return {
        "largest hysteretic force": (level, "response"),
        "stiffness after a turn": (stiffness, "response/drive"),
        "way before it yields": (level / stiffness, "drive"),
    }


def swing(records):
    """Return the largest peak-to-peak drive of the records, 1 where the drive never moves."""
    return max(float(np.ptp(record.u)) for record in records) or 1.0


def half_range(records):
    """Return half the largest peak-to-peak response, 1 where it is constant."""
    return 0.5 * max(float(np.ptp(record.y)) for record in records) or 1.0


def largest_drive(records):
    """Return the largest magnitude of the drive, 1 where it is zero throughout."""
    return max(float(np.abs(record.u).max()) for record in records) or 1.0


def fastest_change(records):
    """Return the largest rate of the drive between two samples, 0 where it never moves."""
    return max(np.abs(np.diff(r.u)).max(initial=0.0) / r.dt for r in records)


def top_speed(records, smoothing=1):
    """Return a speed that one in twenty samples exceeds, 1 where the drive never moves.

    Slopes are taken over ``smoothing`` intervals.
    """
    speeds = np.concatenate([np.abs(slopes(r.u, r.dt, smoothing)) for r in records])
    moving = speeds[speeds > 0.0]
    return float(np.quantile(moving, 0.95)) if moving.size else 1.0


def speed_noise(records, smoothing=1):
    """Return the standard error of slopes over ``smoothing`` intervals that noise leaves.

    It follows from fifth differences of the drive in the quiet parts of the records, to which a
    smooth motion adds next to nothing. 0 where the records are too short to tell.
    """
    slope = np.sqrt(12.0 / (smoothing * (smoothing + 1) * (smoothing + 2)))
    found = [0.0]
    for record in records:
        fifth = np.diff(record.u, n=5)
        n_blocks = len(fifth) // _BLOCK
        power = np.square(fifth[: n_blocks * _BLOCK]).reshape(n_blocks, _BLOCK).mean(axis=1)
        if n_blocks:
            # the squares of the weights 1, 5, 10, 10, 5, 1 add up to 252
            found.append(slope * np.sqrt(np.quantile(power, _QUIET) / 252.0) / record.dt)
    return float(max(found))


def show(model, operator, *names):
    """Store fields of an operator as attributes of a model, ``weights`` as ``weights_``."""
    for name in names:
        value = np.array(getattr(operator, name))
        setattr(model, f"{name}_", value if value.ndim else float(value))
