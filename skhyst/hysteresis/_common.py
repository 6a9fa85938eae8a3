"""Shared by the models: scales of the data for starting values, and the base of friction models."""

from dataclasses import replace

import numpy as np

from ..base import ParametricModel
from ..operators import slopes
from ..optimize import (
    Alone,
    OperatorProblem,
    block_folds,
    exchanged,
    solve_linear,
    variable_projection,
    whole_record_folds,
)

_BLOCK = 20  # samples per block over which the noise power is averaged
_QUIET = 0.25  # quantile of the blocks: at least this fraction is taken to move slowly


class FrictionModel(ParametricModel):
    """Base of the friction models: friction, a spring, a dashpot and a constant in parallel.

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


def in_direction(starts, records, fixed, initial_state):
    """Return the starts of the direction and form in which the linear parameters fit best.

    Weights of one sign follow the drive in one direction. ``starts`` are of several forms, the
    expected one first. Another form, or a mirror image, is put in front if it explains more than as
    many linear parameters do by chance, which is one mean square of the residual for each.
    """
    if not getattr(starts[0], "non_negative", True):
        return starts
    candidates = []
    for start in starts:
        both = start, replace(start, falling=True)  # which differ in their bounds
        options = {"fixed": fixed, "initial_state": initial_state}
        problems = [OperatorProblem(candidate, records, **options) for candidate in both]
        problem = problems[0]
        gram = problem.total(problem.evaluate(problem.x0))
        costs = [solve_linear(p, p.x0, gram)[1][-1, -1] for p in problems]
        candidates += zip(costs, both, strict=True)
    least, best = min(candidates, key=lambda candidate: candidate[0])
    chance = 1.0 + problem.linear.sum() / problem.segment_weight.sum()
    return [best, starts[0]] if least * chance < candidates[0][0] else starts[:1]


def as_fine_as_needed(starts, records, fixed, initial_state):
    """Return a start with the number and positions of terms that predict best out of fold.

    It has the structure of the first start; see :func:`skhyst.optimize.exchanged`.
    """
    records, folds = block_folds(records)
    place = Alone(starts[0], records, fixed, initial_state)
    problem = place.problem(starts[0])
    place = place.at(problem, variable_projection(problem, problem.x0).x)
    return [exchanged(place, whole_record_folds(records, folds)).part]


def force_characteristics(level, stiffness):
    """Return the characteristics of a hysteretic force driven by a displacement.

    ``level`` is the largest force (units of the response), ``stiffness`` its initial slope
    (response/drive).
    """
    return {
        "largest hysteretic force": (level, "response"),
        "stiffness after a turn": (stiffness, "response/drive"),
        "presliding displacement": (level / stiffness, "drive"),
    }


def largest_peak_to_peak(records):
    """Return the largest peak-to-peak value of the drive in a record, 1 if it never moves."""
    return max(float(np.ptp(record.u)) for record in records) or 1.0


def half_range(records):
    """Return half the largest peak-to-peak value of the response in a record, 1 if constant."""
    return 0.5 * max(float(np.ptp(record.y)) for record in records) or 1.0


def largest_drive(records):
    """Return the largest magnitude of the drive, 1 for a drive of zero."""
    return max(float(np.abs(record.u).max()) for record in records) or 1.0


def fastest_change(records):
    """Return the largest rate of the drive between two samples (drive/s), 0 if it never moves."""
    return max(np.abs(np.diff(r.u)).max(initial=0.0) / r.dt for r in records)


def top_speed(records, smoothing=1):
    """Return the 95 % quantile of the speed (drive/s) while the drive moves, 1 if it never does.

    Speeds are slopes over ``smoothing`` intervals.
    """
    speeds = np.concatenate([np.abs(slopes(r.u, r.dt, smoothing)) for r in records])
    moving = speeds[speeds > 0.0]
    return float(np.quantile(moving, 0.95)) if moving.size else 1.0


def speed_noise(records, smoothing=1):
    """Return the standard error (drive/s) of slopes over ``smoothing`` intervals due to noise.

    It follows from fifth differences of the drive in the quiet parts of the records, where a
    smooth motion contributes almost nothing. 0 if the records are too short.
    """
    # standard error of a least-squares slope, relative to noise over sampling interval
    slope = np.sqrt(12.0 / (smoothing * (smoothing + 1) * (smoothing + 2)))
    errors = [0.0]
    for record in records:
        fifth = np.diff(record.u, n=5)
        n_blocks = len(fifth) // _BLOCK
        power = np.square(fifth[: n_blocks * _BLOCK]).reshape(n_blocks, _BLOCK).mean(axis=1)
        if n_blocks:
            # the squares of the weights 1, 5, 10, 10, 5, 1 add up to 252
            errors.append(slope * np.sqrt(np.quantile(power, _QUIET) / 252.0) / record.dt)
    return float(max(errors))


def show(model, operator, *names):
    """Store fields of an operator as attributes of a model, ``weights`` as ``weights_``."""
    for name in names:
        value = np.array(getattr(operator, name))
        setattr(model, f"{name}_", value if value.ndim else float(value))
