"""Start values of records, for an operator without a state of rest.

Displacement and velocity of a free mass at the first sample of a record belong to the record, like
the coefficients of an additive disturbance. With the parameters held, they are found by
Gauss-Newton steps from an estimate by the first samples of the response. With the parameters free,
the response to a small change of them is eliminated like an additive disturbance, so that the step
of the parameters is that of the joint problem, and standard errors account for the unknown start;
the resulting change then updates the start values.
"""

from dataclasses import replace

import numpy as np

from ._identify import identify
from ._problem import OperatorProblem, record_with_history, scheduled

_STEPS = 20  # Gauss-Newton steps for the start of a record, or passes over the parameters
_HALVES = 10
_FOLLOWED = 3  # starts of the parameters that are followed to convergence
SETTLED = 1e-8  # relative decrease of the error by a pass that is worth another one


def start_values_of(operator, disturbances, records, which=None, stiffness=0.0):
    """Return the start values of each record with the parameters held, and the number of runs.

    Parameters
    ----------
    operator, disturbances : Operator, sequence of DisturbanceOperator
    records : sequence of RecordData
    which : sequence of bool, default=None
        Records that have start values of their own; by default all.
    stiffness : float, default=0.0
        Ratio of the noise to the change of the response by a start value that is as likely as the
        noise: what few samples do not determine is as of a rest at the first of them.

    Returns
    -------
    start : ndarray of shape (n_records, n_start)
        NaN for the other records.
    n_evaluations : int
        Largest number of simulations of one record.
    """
    problem = OperatorProblem(operator, records, disturbances=disturbances)
    which = [True] * len(records) if which is None else which
    starts = [
        _start(problem, record, stiffness) if has_own else (np.full(operator.n_start, np.nan), 0)
        for record, has_own in zip(problem.records, which, strict=True)
    ]
    return np.array([start for start, _ in starts]), max(runs for _, runs in starts)


def _start(problem, record, stiffness):
    """Return the start values of a record, and the number of simulations."""
    operator, root = scheduled(problem.operator, record), np.sqrt(record.counts())
    record = replace(record, schedule=None)
    basis = None
    if problem.disturbances:
        columns = root[:, None] * problem.basis(problem.disturbances, record)
        basis = np.linalg.qr(columns)[0]

    def weighted(part):
        part = (part.T * root).T
        return part if basis is None else part - basis @ (basis.T @ part)

    def by_start(start):
        return problem.history_sensitivities(operator, replace(record, start=start))

    def misfit(start):
        residual = weighted(problem.simulate(operator, replace(record, start=start)) - record.y)
        residual = np.append(residual, stiffness * scale * (start - starts[0]))
        return residual, float(residual @ residual) if np.isfinite(residual).all() else np.inf

    known = np.flatnonzero(root)
    read = slice(known[0], known[-1] + 1) if len(known) else slice(None)
    starts = operator.starts(record.u[read], record.y[read], record.dt)
    if record.start is not None:
        starts.append(np.asarray(record.start, dtype=float))
    # a start value counts by its effect on the whole record
    scale = np.sqrt(np.mean(np.square(by_start(starts[0])), axis=0))
    scale[~((scale > 0.0) & np.isfinite(scale))] = 1.0
    trials = [(*misfit(start), start) for start in starts]
    residual, least, start = min(trials, key=lambda trial: trial[1])
    runs = len(starts)
    for _ in range(_STEPS):
        columns = np.concatenate([weighted(by_start(start)), stiffness * np.diag(scale)])
        if not np.isfinite(columns).all():
            break
        step = -np.linalg.lstsq(columns / scale, residual, rcond=1e-10)[0] / scale
        for _half in range(_HALVES):  # far from the solution, a Gauss-Newton step overshoots
            new, cost = misfit(start + step)
            runs += 1
            if cost < least:
                break
            step = 0.5 * step
        if not cost < least:
            break
        settled = cost > (1.0 - SETTLED) * least
        start, residual, least = start + step, new, cost
        if settled:
            break
    return start, runs


def estimate_start_values(
    operator,
    disturbances,
    records,
    *,
    fixed=(),
    method="variable_projection",
    with_errors=True,
    which=None,
    initial_state="rest",
):
    """Identify parameters and the start values of each record.

    Parameters
    ----------
    operator, disturbances : Operator, sequence of DisturbanceOperator
        Starting point of the identification.
    records : sequence of RecordData
        Those of the fit; known start values are the starting point.
    fixed : collection of str, default=()
        Names of entries that are held.
    method : str or Method, default="variable_projection"
    with_errors : bool, default=True
        Whether to compute standard errors.
    which : sequence of bool, default=None
        Records that have start values of their own; by default all.
    initial_state : {"rest", "zero"}, default="rest"
        State before each of the other records.

    Returns
    -------
    result : IdentificationResult
    start : ndarray of shape (n_records, n_start)
        NaN for the other records.
    """
    start, runs = start_values_of(operator, disturbances, records, which)
    how = {"fixed": fixed, "method": method, "with_errors": with_errors}
    how["initial_state"] = initial_state
    best, evaluations, count = None, runs, start.shape[1]
    for _ in range(_STEPS):
        begun = [replace(r, eliminated=None) for r in _begun(operator, records, start)]
        problem = OperatorProblem(operator, begun, disturbances=disturbances)
        loose = [
            replace(
                r,
                eliminated=np.zeros((len(r.u), count))
                if np.isnan(s).any()
                else problem.history_sensitivities(operator, r),
            )
            for r, s in zip(begun, start, strict=True)
        ]
        result = identify([(operator, disturbances)], loose, **how)
        evaluations += result.n_evaluations
        moved, runs = start_values_of(result.operator, result.disturbances, begun, which)
        evaluations += runs
        error = _error(result.operator, result.disturbances, begun, moved, initial_state)
        if best is not None and not error < (1.0 - SETTLED) * best[0].error:
            break
        own_part = result.record_coefficients[:, : result.record_coefficients.shape[1] - count]
        best = replace(result, error=error, record_coefficients=own_part), moved
        operator, disturbances, start = result.operator, result.disturbances, moved
    result, start = best
    return replace(result, n_evaluations=evaluations), start


def identify_from_own_starts(
    starts, records, *, fixed=(), method="variable_projection", with_errors=True
):
    """Identify an operator and the start values of each record, from several candidates.

    Parameters
    ----------
    starts : sequence of Operator
        Starting values of one structure.
    records, fixed, method, with_errors
        As for :func:`estimate_start_values`.

    Returns
    -------
    IdentificationResult
        The best result of the few candidates that fit best before their parameters are changed.
    """
    chosen, evaluations = best_from_own_starts(starts, records)
    options = {"fixed": fixed, "method": method, "with_errors": with_errors}
    results = [estimate_start_values(start, (), records, **options) for start in chosen]
    evaluations += sum(result.n_evaluations for result, _ in results)
    result, start = min(results, key=lambda pair: pair[0].error)
    return replace(result, n_evaluations=evaluations, input_history=start)


def best_from_own_starts(starts, records):
    """Return the few operators that fit best with their own start values, and the evaluations."""
    errors, evaluations = [], 0
    for candidate in starts:
        start, runs = start_values_of(candidate, (), records)
        error = _error(candidate, (), records, start)
        errors.append(error if np.isfinite(error) else np.inf)
        evaluations += runs
    return [starts[i] for i in np.argsort(errors, kind="stable")[:_FOLLOWED]], evaluations


def _begun(operator, records, start):
    """Return records with their start values, where these are not NaN."""
    return [record_with_history(operator, *pair) for pair in zip(records, start, strict=True)]


def _error(operator, disturbances, records, start, initial_state="rest"):
    """Return the root mean square of the residual for given start values."""
    options = {"disturbances": disturbances, "initial_state": initial_state}
    problem = OperatorProblem(operator, _begun(operator, records, start), **options)
    blocks = problem.evaluate(problem.x0, jacobian=False)
    power = problem.total(blocks)[-1, -1]
    return float(np.sqrt(power / problem.segment_weight.sum()))
