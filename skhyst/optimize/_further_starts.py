"""Further starts for a fit whose residual is coloured.

A residual that is white holds nothing that the model could explain, wherever the fit has ended. One
that is coloured is either a shortcoming of the model or a local optimum. Further starts tell: where
they lead back to the best solution, this is the optimum, and the model lacks something.
"""

from dataclasses import replace

import numpy as np

from ..noise import whiteness_p_value
from ._identify import NOISELESS, identify, problems_of
from ._problem import OperatorProblem
from ._variable_projection import random_starts, variable_projection

LEVEL = 1e-3  # of the test of whiteness: the part of right fits that pay for further starts
_ROUNDS = 5
_RETURNS = (
    3  # runs that lead back to the best, and none to a better one, after which it is the optimum
)
_STARTS = 12  # of a round
_BUDGET = 4.0  # evaluations over those of the fit, after which no further way is begun
_TRIAL_EVALUATIONS = 4
_FULL_RUNS = 3  # starts of a round that are followed to the end
_NOTICEABLE = 0.01  # part of the sum of squares by which another optimum is a better one
_TOLERANCE = 0.01 * _NOTICEABLE  # of a run, which tells two optima apart


def _neighbours(problems, seed):
    """Return the best solution of one round, how often others lead to it, and the evaluations.

    Starts are drawn from around the solution, which is that of the first problem, and the others.
    """
    problem = problems[0]
    best = variable_projection(problem, problem.x0, max_evaluations=1)
    own = [p.x0 for p in problems[1:] if p.names == problem.names]
    drawn = random_starts(problems, [best.x, *own], _STARTS, seed)
    trials = [variable_projection(problem, x, max_evaluations=_TRIAL_EVALUATIONS) for x in drawn]
    trials.sort(key=lambda trial: trial.cost)
    ends = [
        variable_projection(problem, trial.x, tolerance=_TOLERANCE) for trial in trials[:_FULL_RUNS]
    ]
    evaluations = 1 + sum(run.n_evaluations for run in [best, *trials, *ends])  # 1: the search box
    least = min([best, *ends], key=lambda run: run.cost)
    found = least if least.cost < (1.0 - _NOTICEABLE) * best.cost else best
    returns = sum(run.cost <= found.cost / (1.0 - _NOTICEABLE) for run in [best, *ends]) - 1
    return found if found is not best else None, returns, evaluations


def is_coloured(result, records, initial_state="rest"):
    """Whether the residual of a fit is more than rounding, and not white at the level ``LEVEL``.

    Parameters
    ----------
    result : IdentificationResult
    records : sequence of RecordData
        Those of the fit.
    initial_state : {"rest", "zero"}, default="rest"
        State before each record.

    Returns
    -------
    bool
    """
    series, power = [], 0.0
    outputs = result.outputs(records, initial_state)
    for record, output in zip(records, outputs, strict=True):
        residual = np.sqrt(record.counts()) * (record.y - output)
        power += float(residual @ residual)
        series += [residual[start:stop] for start, stop in record.segments]
    if power <= NOISELESS * sum(record.power() for record in records):
        return False
    return whiteness_p_value(series) < LEVEL


def with_further_starts(result, records, starts, others=(), *, fixed=(), initial_state="rest"):
    """Return a result, or a better one from further starts where its residual is coloured.

    Parameters
    ----------
    result : IdentificationResult
    records : sequence of RecordData
        Those of the fit.
    starts : callable
        Returns operators as :func:`identify` takes them: starting values from the data, among and
        around which further ones are drawn.
    others : iterable of IdentificationResult, default=()
        What other ways of starting the model lead to, before starts are drawn.
    fixed : collection of str, default=()
        Names of entries that are held.
    initial_state : {"rest", "zero"}, default="rest"
        State before each record.

    Returns
    -------
    IdentificationResult
        With ``is_local`` where the residual is coloured and no further start has led to the
        solution again.
    """
    start = result.operator, result.disturbances
    problem = OperatorProblem(start[0], records, disturbances=start[1], fixed=fixed)
    if problem.linear.all():
        return result
    if not is_coloured(result, records, initial_state):
        return result
    most = (1.0 + _BUDGET) * result.n_evaluations
    for other in others:
        result = _better(result, other)
        if result.operator is other.operator and not is_coloured(result, records, initial_state):
            return result
        if result.n_evaluations > most:
            break
    given, how, returns = starts(), {"fixed": fixed, "initial_state": initial_state}, 0
    for seed in range(_ROUNDS):
        problems = problems_of([(result.operator, result.disturbances), *given], records, **how)
        found, back, evaluations = _neighbours(problems, seed)
        before = result
        result = replace(result, n_evaluations=result.n_evaluations + evaluations)
        if found is not None:
            result = _better(result, identify([problems[0].unpack(found.x)], records, **how))
        better = result.error < before.error
        returns = 0 if better else returns + back
        if (
            returns >= _RETURNS
            or (back and result.n_evaluations > most)
            or (better and not is_coloured(result, records, initial_state))
        ):
            return result
    return replace(result, is_local=True)


def _better(result, other):
    """Return the other result where it is noticeably better, with the evaluations of both.

    Where it leaves more undetermined, it explains by chance: then it is no better. What two parts
    share may be undetermined in either, so that their number counts.
    """
    evaluations = result.n_evaluations + other.n_evaluations
    better = other.error**2 < (1.0 - _NOTICEABLE) * result.error**2
    better &= len(other.undetermined) <= len(result.undetermined)
    return replace(other if better else result, n_evaluations=evaluations)
