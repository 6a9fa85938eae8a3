"""Starting values, screening and the held-out contest of one candidate."""

from dataclasses import dataclass, replace

import numpy as np
from joblib import delayed
from scipy.stats import t as student

from ..optimize import predicted_cost, single_step, variable_projection
from ._shortened import are_long
from ._starts import starting_structures

__all__ = [
    "Contestant",
    "Screened",
    "contest",
    "held_out",
    "independent_share",
    "paired_p_value",
    "refitted",
    "refitted_from",
    "relative_gain",
    "screen",
]

_SCREENED = 2  # variants of an effect, at least, whose best start is refitted in screening
_BROKEN_PROMISE = 2.0  # sum of squares reached, relative to what the next variant promises
_TRIALS = 3  # starts of a variant that are refitted briefly in the contest
_TRIAL_EVALUATIONS = 4
_EVALUATIONS = 60
_VARIANTS = 4  # variants of one effect that are refitted
_FINALISTS = 2  # of these, refitted on whole records where the others see first parts
_NEAR = 1.1  # sum of squares in first parts, relative to the best variant's, of another finalist
_FAR = 5.0  # the same, relative to the best effect's, above which none is refitted
_LONG_EVALUATIONS = 5  # on whole records, from the solution in their first parts
_HOPEFUL = 4.0  # sum of squares, relative to the best variant's, up to which one is refitted
_FOLD_EVALUATIONS = 4
_TOLERANCE = 1e-5
_FOLD_TOLERANCE = 1e-5
_LARGEST_CORRELATION = 0.95  # of neighbouring segments
_FEWEST_INDEPENDENT = 2.0  # segments a record, below which the record is the unit
_LARGEST_LOSS = 0.75  # part of the variance that the records' means may take


@dataclass(frozen=True)
class Contestant:
    """A candidate: its structure with operators at the solution, and what it achieves.

    ``box`` is what the declared black box predicts, where one was declared, see ``_black_box``.
    ``simpler`` are the variants of the effect with fewer parameters.
    """

    effect: str
    structure: object
    cost: float
    n_parameters: int
    x: np.ndarray
    squared_errors: np.ndarray | None = None
    residuals: tuple | None = None
    predictions: tuple | None = None
    error: float = np.nan
    p_value: float = np.nan
    box: object = None
    simpler: tuple = ()


@dataclass(frozen=True)
class Screened:
    """What screening found: the variants that apply, and what the best reaches.

    A variant is a list of contestants, best start first. ``beginnings`` are the lists of variants
    from each structure that was screened. ``parts`` are the first parts of the records, where these
    were screened.
    """

    beginnings: list
    cost: float = np.inf
    n_parameters: int = 0
    parts: list | None = None


def screen(effect, structures, records):
    """Refit an effect briefly, in each of structures.

    Each starting value is simulated once: the linear parameters are solved exactly and one
    Gauss-Newton step of all others is predicted. The best starts of the two best variants are then
    refitted for a few steps, since a prediction far from the solution says little, and of further
    ones as long as these keep far less than they have promised. Where whole long records have to be
    screened the prediction is all: such an effect starts from the model so far.
    """
    beginnings, reached = [], []
    for structure in structures:
        variants = [
            _predicted(effect.name, candidates, records)
            for candidates in starting_structures(effect, structure, records)
        ]
        if variants:
            beginnings.append(variants)
            reached.append(_best_of(variants, records))
    if not beginnings:
        return Screened([])
    fewest = min(starts[0].n_parameters for variants in beginnings for starts in variants)
    return Screened(beginnings, min(reached), fewest)


def _best_of(variants, records):
    """Refit the best starts of the hopeful variants briefly; return the least sum of squares."""
    hopeful = sorted(variants, key=lambda starts: starts[0].cost)
    if are_long(records):
        return hopeful[0][0].cost
    reached = np.inf
    for number, starts in enumerate(hopeful):
        if number >= _SCREENED and reached <= _BROKEN_PROMISE * starts[0].cost:
            break
        starts[0] = _refit(starts[0], records, _TRIAL_EVALUATIONS)[0]
        reached = min(reached, starts[0].cost)
    return reached


def _predicted(effect, structures, records):
    """Return contestants at starting values, the most promising first."""
    starts = []
    for structure in structures:
        problem = structure.problem(records)
        predicted = predicted_cost(problem, problem.x0)
        n_parameters = len(problem.x0) + structure.n_coefficients()
        starts.append(Contestant(effect, structure, predicted, n_parameters, problem.x0))
    return sorted(starts, key=lambda c: c.cost)


def refitted_from(contestant, structures, records):
    """Return the contestant refitted from the most promising of structures."""
    starts = _predicted(contestant.effect, structures, records)
    return _refit_variant(starts, records)[1]


def refitted(contestant, structure, records):
    """Return the contestant with another structure, refitted."""
    problem = structure.problem(records)
    n_parameters = len(problem.x0) + structure.n_coefficients()
    changed = replace(contestant, structure=structure, x=problem.x0, n_parameters=n_parameters)
    return _refit(changed, records, _EVALUATIONS)[0]


def _refit(contestant, records, max_evaluations):
    problem = contestant.structure.problem(records)
    solution = variable_projection(
        problem, contestant.x, tolerance=_TOLERANCE, max_evaluations=max_evaluations
    )
    structure = contestant.structure.at(problem, solution.x)
    return replace(contestant, structure=structure, cost=solution.cost, x=solution.x), problem


def contest(candidates, records, parallel, is_plausible):
    """Refit the promising variants of effects; return those that Schwarz's criterion prefers.

    ``candidates`` are, for each effect, what :func:`screen` has found; ``parallel`` is a joblib
    ``Parallel``; ``is_plausible`` tells of a contestant whether its name still says what it is. Of
    variants that were screened on the first parts of the records, the two that are best there are
    refitted on the whole. One contestant is returned of each effect with a plausible variant, which
    knows the simpler ones; the sum of squares is infinite where the first parts tell that another
    effect is far better.
    """
    jobs = [
        (number, starts)
        for number, screened in enumerate(candidates)
        for variants in screened.beginnings
        for starts in _hopeful(variants, are_long(screened.parts or records))
    ]
    refitted = parallel(
        delayed(_refit_variant)(starts, candidates[number].parts or records)
        for number, starts in jobs
    )
    found = [[] for _ in candidates]
    for (number, _), variant in zip(jobs, refitted, strict=True):
        found[number].append(variant)
    found = [sorted(variants, key=lambda v: v[0]) for variants in found]
    in_parts = [number for number, screened in enumerate(candidates) if screened.parts]
    least = min((found[number][0][1].cost for number in in_parts), default=0.0)
    jobs = []
    for number in in_parts:
        (criterion, best), *_ = found[number]
        near = [variant for _, variant in found[number] if variant.cost <= _NEAR * best.cost]
        if best.cost > _FAR * least:
            found[number] = [(criterion, replace(best, cost=np.inf))]
        else:
            found[number] = []
            alone = len(near) == 1
            jobs += [(number, variant, alone) for variant in near[:_FINALISTS]]
    refitted = parallel(
        delayed(_refit_judged)(variant, records, _LONG_EVALUATIONS, alone)
        for _, variant, alone in jobs
    )
    for (number, *_), variant in zip(jobs, refitted, strict=True):
        found[number].append(variant)
    preferred = [_preferred(variants, is_plausible) for variants in found]
    return [contestant for contestant in preferred if contestant is not None]


def _preferred(variants, is_plausible):
    """Return the plausible variant that the criterion prefers, which knows the simpler ones."""
    ordered = [c for _, c in sorted(variants, key=lambda v: v[0])]
    best = next((c for c in ordered if is_plausible(c)), None)
    if best is None:
        return None
    return replace(best, simpler=tuple(c for c in ordered if c.n_parameters < best.n_parameters))


def _hopeful(variants, long):
    """Return the variants of an effect that are worth a refit, best first.

    Of those on whole long records, where a refit is slow: the best and the simplest of what is near
    the best.
    """
    least = min(starts[0].cost for starts in variants)
    bar = (_NEAR if long else _HOPEFUL) * least
    near = [starts for starts in variants if starts[0].cost <= bar]
    near.sort(key=lambda starts: starts[0].cost)
    if not long:
        return near[:_VARIANTS]
    best, simplest = near[0], min(near, key=lambda starts: starts[0].n_parameters)
    return [best] if simplest is best else [best, simplest]


def _refit_variant(starts, records):
    """Return Schwarz's criterion and the contestant that the best of a variant's starts becomes."""
    if are_long(records):
        return _refit_judged(starts[0], records, _LONG_EVALUATIONS)
    trials = [_refit(start, records, _TRIAL_EVALUATIONS)[0] for start in starts[:_TRIALS]]
    return _refit_judged(min(trials, key=lambda c: c.cost), records)


def _refit_judged(contestant, records, max_evaluations=_EVALUATIONS, alone=False):
    """Return the criterion, which nobody needs of one ``alone``, and the contestant refitted."""
    refitted, problem = _refit(contestant, records, max_evaluations)
    return 0.0 if alone else _criterion(refitted, problem, len(records)), refitted


def _criterion(contestant, problem, n_records):
    """Return Schwarz's criterion with the number of parameters that a dependent residual has.

    With independent errors of one variance the trace below is that variance times the number of
    parameters. Where the residual of a stretch hangs together it is larger (Takeuchi 1976), and
    counting every sample as evidence would prefer curves that only follow the residual.
    """
    n = float(problem.segment_weight.sum())
    cost = max(contestant.cost, np.finfo(float).tiny)
    n_parameters = contestant.structure.n_coefficients() * n_records
    x = contestant.x
    inside = np.flatnonzero((x > problem.lower) & (x < problem.upper))
    effective = float(len(inside))
    if not n_parameters:  # else a stretch's gradient depends on its record's coefficients
        blocks = problem.evaluate(x)
        slopes = blocks[:, inside, -1]
        hessian = blocks[:, inside][:, :, inside].sum(axis=0)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(hessian), np.finfo(float).tiny))
        slopes = slopes * scale
        spread = slopes.T @ slopes
        trace = np.trace(np.linalg.pinv(hessian * np.outer(scale, scale), 1e-10) @ spread)
        effective = max(effective, trace * n / cost)
    return n * np.log(cost) + (effective + n_parameters) * np.log(n)


def held_out(contestant, records, folds):
    """Predict every segment from a fit that did not see it; return the completed contestant.

    ``folds`` are pairs of boolean masks over segments: those fitted, those scored.
    """
    problem = contestant.structure.problem(records)
    alike = not all(problem.depends_on(train) for train, _ in folds)
    blocks = problem.evaluate(problem.x0) if alike else None
    predictions = [np.full(len(record.y), np.nan) for record in records]
    long = are_long(records)
    for train, test in folds:
        x = _fold_solution(problem, train, blocks, long)
        wanted = np.unique(problem.segment_record[test])
        parts = problem.predictions(x, train, wanted)
        segment = 0
        for number, record in enumerate(records):
            for start, stop in record.segments:
                if test[segment]:
                    predictions[number][start:stop] = parts[number][start:stop]
                segment += 1
    residuals = [r.y - p for r, p in zip(records, predictions, strict=True)]
    weighed = [
        np.square(own) if record.weights is None else record.weights * np.square(own)
        for own, record in zip(residuals, records, strict=True)
    ]
    squared = np.array(
        [
            np.sum(own[start:stop])
            for own, record in zip(weighed, records, strict=True)
            for start, stop in record.segments
        ]
    )
    scored = np.isfinite(squared)
    error = np.sqrt(squared[scored].sum() / problem.segment_weight[scored].sum())
    return replace(
        contestant,
        squared_errors=squared,
        residuals=tuple(residuals),
        predictions=tuple(predictions),
        error=float(error),
    )


def _fold_solution(problem, train, blocks, long):
    """Return the solution for a fold; ``blocks`` are those of the solution for all segments."""
    known = None if problem.depends_on(train) else blocks
    if long:  # of so many samples a fold's solution is near that of all
        if known is None:
            known = problem.evaluate(problem.x0, select=train)
        return single_step(problem, problem.x0, known, train)
    return variable_projection(
        problem,
        problem.x0,
        select=train,
        blocks=known,
        tolerance=_FOLD_TOLERANCE,
        max_evaluations=_FOLD_EVALUATIONS,
    ).x


def paired_p_value(worse, better, groups):
    """Return the one-sided p-value against ``better`` predicting better than ``worse``.

    A t-test on the relative differences of segments, (worse - better) / (worse + better), which
    no single segment can dominate. Fluctuations count about each record's own mean: that an effect
    shows more in one record than in another is no doubt about it. Neighbouring segments of a record
    share their residual's dependence: the variance of the mean is that of Newey and West
    (Econometrica 55, 1987), or that of a first-order autoregression where it is larger, since the
    former reaches over a few segments only; the correlation's bias is removed (Kendall, Biometrika
    41, 1954) and the degrees of freedom are those of as many independent segments as the mean has
    the variance of. Of more than two records the means are compared too, as independent of each
    other, and of the two p-values the smaller counts twice; where a record hangs together so much
    that it holds fewer than two independent segments, that of the means alone.

    Parameters
    ----------
    worse, better : ndarray of shape (n_segments,)
        Sums of squares; NaN where a segment was not scored.
    groups : ndarray of shape (n_segments,)
        Record of each segment.
    """
    gain = relative_gain(worse, better)
    scored = np.isfinite(gain)
    gain, groups = gain[scored], groups[scored]
    n = len(gain)
    if n < 3 or not np.any(gain != gain[0]):
        return 1.0
    _, record = np.unique(groups, return_inverse=True)
    count = np.bincount(record)
    means = np.bincount(record, gain) / count
    own = gain - means[record]
    power = own @ own
    lags = int(np.floor(4.0 * (n / 100.0) ** (2.0 / 9.0)))
    variance = power
    for lag in range(1, min(lags, n - 1) + 1):
        variance += 2.0 * (1.0 - lag / (lags + 1.0)) * _covariance(own, groups, lag)[0]
    covariance, pairs = _covariance(own, groups, 1)
    rho = covariance / max(power, np.finfo(float).tiny) * n / max(pairs, 1)
    rho = np.clip(rho + (1.0 + 3.0 * rho) / count.mean(), 0.0, _LARGEST_CORRELATION)
    independent = n * (1.0 - rho) / (1.0 + rho)
    of_means = None
    if len(count) > 2:
        of_means = _t_test(means.mean(), means.var(ddof=1) / len(count), len(count) - 1)
        if independent < _FEWEST_INDEPENDENT * len(count):
            return of_means
    variance = max(variance, power * n / independent) / n**2
    variance /= 1.0 - min(len(count) / independent, _LARGEST_LOSS)  # taken by the records' means
    freedom = max(min(n / (lags + 1.0), independent) - len(count), 1.0)
    of_segments = _t_test(gain.mean(), variance, freedom)
    return of_segments if of_means is None else min(1.0, 2.0 * min(of_segments, of_means))


def _t_test(mean, variance, freedom):
    """Return the one-sided p-value against a mean above zero."""
    if variance == 0.0:
        return 0.0 if mean > 0.0 else 1.0
    return float(student.sf(mean / np.sqrt(variance), freedom))


def relative_gain(worse, better):
    """Return (worse - better) / (worse + better) of each segment's sums of squares."""
    return (worse - better) / np.maximum(worse + better, np.finfo(float).tiny)


def independent_share(gains):
    """Return how many independent tests correlated ones are worth, relative to their number.

    Candidates that remove the same part of a residual are no further chances of a false claim. The
    number is that of Li and Ji (Heredity 95, 2005), from the eigenvalues of the correlation.

    Parameters
    ----------
    gains : list of ndarray of shape (n_segments,)
        Of each candidate; NaN where a segment was not scored.
    """
    if len(gains) < 2:
        return 1.0
    gains = np.array(gains)
    gains = gains[:, np.isfinite(gains).all(axis=0)]
    gains = gains[np.ptp(gains, axis=1) > 0.0] if gains.size else gains
    if len(gains) < 2:
        return 1.0
    # rounded, since a whole eigenvalue counts as one test
    values = np.round(np.abs(np.linalg.eigvalsh(np.corrcoef(gains))), 9)
    return float(np.sum((values >= 1.0) + values % 1.0) / len(gains))


def _covariance(values, groups, lag):
    """Return the sum of products of values of a group ``lag`` apart, and their number."""
    same = groups[lag:] == groups[:-lag]
    return np.sum((values[lag:] * values[:-lag])[same]), np.count_nonzero(same)
