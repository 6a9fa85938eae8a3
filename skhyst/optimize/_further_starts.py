"""Further starts for a fit whose residual is coloured.

A white residual contains nothing that the model could explain, so the fit has converged. A coloured
one shows either a shortcoming of the model or a local optimum. Further starts distinguish the two:
if they lead back to the best solution, this is the optimum, and the model lacks something.
"""

from dataclasses import replace

import numpy as np
from scipy.special import fdtrc

from ..noise import whiteness_p_value, whitening_filter
from ._identify import NOISELESS, identify, problems_of
from ._problem import OperatorProblem, record_with_history
from ._variable_projection import (
    random_starts,
    search_box,
    start_descent,
    starts_near,
    variable_projection,
)

_TINY = np.finfo(float).tiny
LEVEL = 1e-3  # significance level: the fraction of converged fits that are started again in vain
_ROUNDS = 5
# runs that return to the best solution, while none finds a better one: it is then the optimum
_RETURNS = 3
_STARTS = 12  # per round
_BUDGET = 4.0  # evaluations relative to those of the fit, after which no further strategy is tried
_TRIAL_EVALUATIONS = 4
_FULL_RUNS = 3  # starts of a round that are followed to convergence
_NOTICEABLE = 0.01  # fraction of the sum of squares by which another optimum counts as better
_TOLERANCE = 0.01 * _NOTICEABLE  # of a run, fine enough to distinguish two optima


def _neighbours(problems, seed):
    """Return a better solution of one round or None, how many runs return to it, and evaluations.

    Starts are drawn around the solution, which is that of the first problem, and the other starts.
    """
    problem = problems[0]
    best = start_descent(problem, problem.x0)
    other_starts = [p.x0 for p in problems[1:] if p.names == problem.names]
    box = search_box(problems)
    drawn = random_starts(box, problem.linear, [best.x, *other_starts], _STARTS, seed)
    # where a threshold passes a sample, the next optimum is close; only returns of the random
    # starts are counted, since near ones would return to any local optimum
    near = starts_near(box, best.x, _STARTS // 2, seed)
    evaluations, runs_of_kind = 1, []  # one evaluation for the search box
    for starts, n_followed in ((drawn, _FULL_RUNS), (near, 1)):
        trials = [
            variable_projection(problem, x, max_evaluations=_TRIAL_EVALUATIONS) for x in starts
        ]
        trials.sort(key=lambda trial: trial.cost)
        runs = [
            variable_projection(problem, trial.x, tolerance=_TOLERANCE)
            for trial in trials[:n_followed]
        ]
        evaluations += sum(run.n_evaluations for run in [*trials, *runs])
        runs_of_kind.append(runs)
    random_ends, near_ends = runs_of_kind
    evaluations += best.n_evaluations
    least = min([best, *random_ends, *near_ends], key=lambda run: run.cost)
    best_end = least if least.cost < (1.0 - _NOTICEABLE) * best.cost else best
    returns = (
        sum(run.cost <= best_end.cost / (1.0 - _NOTICEABLE) for run in [best, *random_ends]) - 1
    )
    return best_end if best_end is not best else None, returns, evaluations


def is_coloured(result, records, initial_state="rest"):
    """Whether the residual of a fit exceeds rounding and is not white at the level ``LEVEL``.

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
    series = _residuals(result, records, initial_state)
    return _is_noise(series, records) and whiteness_p_value(series) < LEVEL


def _residuals(result, records, initial_state):
    """Return the residual of each segment of the records."""
    outputs, segments = result.outputs(records, initial_state), []
    for record, output in zip(records, outputs, strict=True):
        residual = np.sqrt(record.counts()) * (record.y - output)
        segments += [residual[start:stop] for start, stop in record.segments]
    return segments


def _is_noise(series, records):
    """Whether residuals exceed rounding."""
    power = sum(float(residual @ residual) for residual in series)
    return power > NOISELESS * sum(record.power() for record in records)


def has_start_misfit(result, records):
    """Whether a fit from rest leaves more where records begin, at the level ``LEVEL``.

    Residuals are whitened by a filter. The variance in the first quarter, eighth, ... of each
    record is compared with that of the rest, in the part with most of it (F test, Bonferroni).

    Parameters
    ----------
    result : IdentificationResult
    records : sequence of RecordData
        Those of the fit.

    Returns
    -------
    bool
    """
    series = _residuals(result, records, "rest")
    if not _is_noise(series, records):
        return False
    squares = [np.square(residual) for residual in _whitened(series, whitening_filter(series))]
    total, n = sum(residual.sum() for residual in squares), sum(map(len, squares))
    parts = [2.0**-k for k in range(2, max(map(len, squares)).bit_length())]
    p_values = []
    for part in parts:
        stops = [int(np.ceil(part * len(residual))) for residual in squares]
        m = sum(stops)
        early = sum(residual[:stop].sum() for residual, stop in zip(squares, stops, strict=True))
        start_power = sum(
            residual[:stop] @ residual[:stop] for residual, stop in zip(series, stops, strict=True)
        )
        if m < n and 2.0 * start_power > sum(residual @ residual for residual in series):
            p_values.append(fdtrc(m, n - m, (early / m) / max((total - early) / (n - m), _TINY)))
    return bool(p_values) and len(parts) * min(p_values) < LEVEL


def _whitened(series, weights):
    return [np.convolve(values, weights)[: len(values)] for values in series]


def start_p_value(result, other, records, n_values, states=("rest", "rest")):
    """Return the p-value of the improvement by another initial state of the records.

    If the residual is only noise, and that of the other fit too, ``n_values`` additional unknowns
    reduce it by chance (F test). The test is made with the residuals and with whitened residuals,
    so that neither their colour nor a small part of a model's own misfit is mistaken for an effect
    of the state.

    Parameters
    ----------
    result, other : IdentificationResult
    records : sequence of RecordData
        Those of the fit.
    n_values : int
        Additional unknowns of the other result.
    states : tuple of (str, str), default=("rest", "rest")
        State before each record, for each of the results.

    Returns
    -------
    float
    """
    history = other.input_history
    with_history = (
        records
        if history is None
        else [
            record_with_history(other.operator, *pair)
            for pair in zip(records, history, strict=True)
        ]
    )
    residuals = [
        _residuals(fit, data, state)
        for fit, data, state in zip((result, other), (records, with_history), states, strict=True)
    ]
    return _improvement_p_value(*residuals, n_values, len(other.params))


def apart_p_value(result, groups, apart, initial_state="rest"):
    """Return the p-value of the improvement by fitting groups of records each by itself.

    One set of parameters for all records is a restriction of one set for each group (Chow,
    *Econometrica*, 1960). As by :func:`start_p_value`, residuals and whitened ones are tested.

    Parameters
    ----------
    result : IdentificationResult
        Of all records.
    groups : sequence of sequence of RecordData
        All records, in their order.
    apart : sequence of IdentificationResult
        Of each group.
    initial_state : {"rest", "zero"}, default="rest"
        State before each record.

    Returns
    -------
    float
    """
    records = [record for group in groups for record in group]
    together, pairs = _residuals(result, records, initial_state), zip(apart, groups, strict=True)
    separate = [residual for pair in pairs for residual in _residuals(*pair, initial_state)]
    n_values = (len(groups) - 1) * len(result.params)
    return _improvement_p_value(together, separate, n_values, len(result.params))


def _improvement_p_value(residuals, other, n_values, n_params):
    """Return the p-value of other residuals of ``n_params`` and ``n_values`` more unknowns."""
    n, p_values = sum(map(len, other)) - n_params - n_values, []
    for weights in (np.ones(1), whitening_filter(other)):
        cost, other_cost = (
            sum(float(e @ e) for e in _whitened(series, weights)) for series in (residuals, other)
        )
        if n <= 0 or cost <= other_cost:
            return 1.0
        p_values.append(
            fdtrc(n_values, n, (cost - other_cost) / n_values * n / max(other_cost, _TINY))
        )
    return float(max(p_values))


def with_further_starts(result, records, starts, others=(), *, fixed=(), initial_state="rest"):
    """Return a result, or a better one from further starts if its residual is coloured.

    Parameters
    ----------
    result : IdentificationResult
    records : sequence of RecordData
        Those of the fit.
    starts : callable
        Returns operators as for :func:`identify`: starting values from the data, among which and
        around which further ones are drawn.
    others : iterable of IdentificationResult, default=()
        Results of other starting strategies of the model, tried before starts are drawn.
    fixed : collection of str, default=()
        Names of entries that are held.
    initial_state : {"rest", "zero"}, default="rest"
        State before each record.

    Returns
    -------
    IdentificationResult
        With ``is_local`` if the residual is coloured and no further start has led to the same
        solution.
    """
    start = result.operator, result.disturbances
    problem = OperatorProblem(start[0], records, disturbances=start[1], fixed=fixed)
    if problem.linear.all():
        return result
    if not is_coloured(result, records, initial_state):
        return result
    most, open_before = (1.0 + _BUDGET) * result.n_evaluations, len(result.silent)

    def is_enough(result):
        """Whether the residual is white, and no more parameters than before are undetermined."""
        few = len(result.silent) <= open_before
        return few and not is_coloured(result, records, initial_state)

    for other in others:
        result = _better(result, other, records, initial_state)
        if result.operator is other.operator and is_enough(result):
            return result
        if result.n_evaluations > most:
            break
    given, options, returns = starts(), {"fixed": fixed, "initial_state": initial_state}, 0
    for seed in range(_ROUNDS):
        problems = problems_of([(result.operator, result.disturbances), *given], records, **options)
        better_start, n_returns, evaluations = _neighbours(problems, seed)
        before = result
        result = replace(result, n_evaluations=result.n_evaluations + evaluations)
        if better_start is not None:
            other = identify([problems[0].unpack(better_start.x)], records, **options)
            result = _better(result, other, records, initial_state)
        better = result.error < before.error
        returns = 0 if better else returns + n_returns
        if (
            returns >= _RETURNS
            or (n_returns and result.n_evaluations > most)
            or (better and is_enough(result))
        ):
            return result
    return replace(result, is_local=True)


def _better(result, other, records, state):
    """Return the better of two results, with the evaluations of both.

    That is the one of noticeably lower error. If it has more undetermined parameters, it may be
    better by chance, and has to improve by more than its parameters can on noise; of two with about
    the same error, the one with fewer undetermined parameters is better. Two parts may share a
    freedom, which can be undetermined in either, so that only the number counts.
    """
    evaluations = result.n_evaluations + other.n_evaluations
    ratio = (other.error / result.error) ** 2 if result.error > 0.0 else np.inf
    more_open = len(other.silent) - len(result.silent)
    better = ratio < 1.0 - _NOTICEABLE or (more_open < 0 and ratio * (1.0 - _NOTICEABLE) < 1.0)
    if better and more_open > 0:
        better = start_p_value(result, other, records, len(other.params), (state, state)) < LEVEL
    return replace(other if better else result, n_evaluations=evaluations)
