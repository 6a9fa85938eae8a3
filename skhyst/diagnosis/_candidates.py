"""Candidates: the current model with effects added, refitted by successive halving, and held out.

Successive halving (Jamieson and Talwalkar, *International Conference on Artificial Intelligence and
Statistics*, 2016) spends about the same number of simulations on each rung. Every starting value is
simulated once, and the cost after one Gauss-Newton step from there is predicted. The best start of
each variant is refitted with three simulations, the variants of the best third of the effects with
nine, and so on with three times as many, until nine effects or fewer (at least three) remain,
enough to see which other effects explain the data. Candidates are compared by this predicted cost,
so that one is not rejected only because it starts far from its solution. Those whose parameters
still agree with the effect's name are held out. Of each effect, the simplest variant that predicts
as well as the best one is refitted with 27 simulations, and held out again.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from joblib import delayed

from ..noise import fit_noise
from ..optimize import single_step, start_descent_and_predict, variable_projection
from ._constants import FEW, NOTICEABLE, RUNG, SEVERAL, THOROUGH, TOLERANCE
from ._criterion import weighted
from ._shortened import are_long
from ._starts import starting_trees


@dataclass(frozen=True)
class Candidate:
    """A model with its operators at the solution of the fit, and its errors.

    Attributes
    ----------
    effects : tuple of str
        Effects that were added to the current model.
    structure : Tree
    cost : float
        Sum of squares of the fit.
    predicted_cost : float
        Sum of squares that the next step is predicted to reach; equal to ``cost`` at a solution.
    n_parameters : int
    x : ndarray
        Solution in the coordinates of the least-squares problem.
    residuals, predictions, weights : tuple of ndarray of shape (n_samples,)
        Held out, of each record; NaN where nothing is scored. Weights of None mean ones.
    explained : tuple of ndarray of shape (n_samples,) or None
        Held-out response to the part of the drive that a reference explains, if there is one.
    error : float
        Held-out root mean square error.
    box : object
        Predictions of the declared black box, if one was declared, see ``_black_box``.
    solution : Solution or None
        What a descent on the same records begins with, at starting values.
    """

    effects: tuple
    structure: object
    cost: float
    predicted_cost: float
    n_parameters: int
    x: np.ndarray
    residuals: tuple | None = None
    predictions: tuple | None = None
    weights: tuple | None = None
    explained: tuple | None = None
    error: float = np.nan
    box: object = None
    solution: object = None

    @cached_property
    def noise(self):
        """NoiseModel of the held-out residual, weighted."""
        return fit_noise(weighted(self.residuals, self.weights))


def screened(effect, structure, records):
    """Return the most promising start of each variant of an effect."""
    found = []
    for variant in starting_trees(effect, structure, records):
        starts = []
        for start in variant:
            problem = start.problem(records)
            starts.append((start, problem, start_descent_and_predict(problem, problem.x0)))
        start, problem, begun = min(starts, key=lambda begun: begun[2].predicted_cost)
        tree, n_parameters = start.at(problem, begun.x), len(begun.x) + start.n_further_estimates()
        known = tree, np.inf, begun.predicted_cost, n_parameters, begun.x
        found.append(Candidate((effect.name,), *known, solution=begun))
    return found


def refitted(candidate, structure, records, max_evaluations=THOROUGH, begun=None):
    """Return a candidate with another structure, refitted.

    ``begun`` is what the descent begins with where that is known.
    """
    problem = structure.problem(records)
    n_parameters = len(problem.x0) + structure.n_further_estimates()
    solution = variable_projection(
        problem, problem.x0, begun=begun, tolerance=TOLERANCE, max_evaluations=max_evaluations
    )
    return replace(
        candidate,
        structure=structure.at(problem, solution.x),
        cost=solution.cost,
        predicted_cost=solution.predicted_cost,
        x=solution.x,
        n_parameters=n_parameters,
        solution=None,
    )


def completed(candidate, records, max_evaluations):
    """Return a refitted candidate, with the input history of the records where it is estimated."""
    candidate = refitted(candidate, candidate.structure, records, max_evaluations)
    if not candidate.structure.input_history:
        return candidate
    structure = candidate.structure.with_input_history(records)
    return refitted(candidate, structure, records, max_evaluations)


def halve(groups, parallel):
    """Refit the variants of effects in rungs; return those of the best third of the effects.

    Parameters
    ----------
    groups : list of (list of Candidate, list of RecordData, float)
        Of each effect: its variants at starting values, the records they are refitted to, and the
        sum of squares of the current model on these records.
    parallel : callable
        Runs delayed calls and returns their results, None for a call that failed.

    Returns
    -------
    variants : list of list of Candidate
        Of each effect, best first.
    kept : list of int
        The numbers of the effects that stay.
    """
    found = [variants for variants, *_ in groups]
    kept, budget = range(len(groups)), RUNG
    while True:
        refined = _rung([found[i] for i in kept], [groups[i] for i in kept], budget, parallel)
        for i, variants in zip(kept, refined, strict=True):
            found[i] = variants
        if budget > RUNG and len(kept) <= SEVERAL:
            break
        best = sorted(
            (min(c.predicted_cost for c in found[i]) / groups[i][2], i) for i in kept if found[i]
        )
        kept, budget = [i for _, i in best[: _last(len(best))]], RUNG * budget
    for variants in found:
        variants.sort(key=lambda c: c.predicted_cost)
    return found, kept


def _rung(found, groups, budget, parallel):
    jobs = [(c, group[1]) for variants, group in zip(found, groups, strict=True) for c in variants]
    fitted = iter(
        parallel(
            delayed(refitted)(c, c.structure, records, budget, c.solution) for c, records in jobs
        )
    )
    refined = [[next(fitted) for _ in variants] for variants in found]
    return [[c for c in variants if c is not None] for variants in refined]


def _last(count):
    """Return how many effects stay of a number of effects."""
    return max(-(-count // RUNG), FEW)


def held_out(candidate, records, folds):
    """Predict every segment from a fit that did not see it; return the completed candidate.

    Folds are pairs of boolean masks over segments: fitted segments, scored segments.
    """
    problem = candidate.structure.problem(records)
    alike = not all(problem.depends_on(train) for train, _ in folds)
    blocks = problem.evaluate(problem.x0) if alike else None
    # predictions from the measured drive, and from the part of it that a reference explains
    drives = [None, driven_by_reference(candidate.structure, records)]
    drives = drives[: 1 + (drives[1] is not None)]
    predictions = [[np.full(len(r.y), np.nan) for r in records] for _ in drives]
    long = are_long(records)
    for train, test in folds:
        x = _fold_solution(problem, train, blocks, long)
        wanted = np.unique(problem.segment_record[test])
        for predicted, driven in zip(predictions, drives, strict=True):
            parts = problem.predictions(x, train, wanted, driven)
            segment = 0
            for number, record in enumerate(records):
                for start, stop in record.segments:
                    if test[segment]:
                        predicted[number][start:stop] = parts[number][start:stop]
                    segment += 1
    residuals = held_out_residuals(problem, predictions[0])
    weights = tuple(record.weights for record in records)
    return replace(
        candidate,
        residuals=tuple(residuals),
        predictions=tuple(predictions[0]),
        weights=weights,
        explained=tuple(predictions[1]) if predictions[1:] else None,
        error=root_mean_square(residuals, weights),
    )


def driven_by_reference(structure, records):
    """Return the records with the reference-explained drive; None without a reference."""
    if records[0].explained is None:
        return None
    return structure.problem([replace(r, u=r.explained) for r in records]).records


def fitted(candidate, records, starts, *, by_reference=False):
    """Return the in-sample predictions and residuals of a candidate, NaN where nothing is scored.

    Nothing is scored before the starts of the records. With ``by_reference``, predictions are the
    response to the part of the drive that the reference explains.
    """
    problem = candidate.structure.problem(records)
    every = np.ones(len(problem.segment_record), dtype=bool)
    driven = driven_by_reference(candidate.structure, records) if by_reference else None
    predictions = problem.predictions(problem.x0, every, driven=driven)
    for record, start, prediction in zip(records, starts, predictions, strict=True):
        prediction[:start] = np.nan
        if record.weights is not None:
            prediction[record.weights == 0.0] = np.nan
    return predictions, [r.y - part for r, part in zip(records, predictions, strict=True)]


def level_folds(records):
    """Return folds that hold out each level of scheduled records but the two extremes.

    A parameter that is a straight line in the level can be interpolated between other levels.
    """
    levels = np.array([record.schedule for record in records])
    owner = np.repeat(np.arange(len(records)), [len(record.segments) for record in records])
    near = NOTICEABLE * np.abs(levels).max()
    inner = levels[(levels > levels.min() + near) & (levels < levels.max() - near)]
    return [(~test, test) for test in (np.abs(levels[owner] - level) <= near for level in inner)]


def halves(records):
    """Return the two folds that hold out one half of the segments of each record."""
    test = np.concatenate([2 * np.arange(len(r.segments)) < len(r.segments) for r in records])
    return [(~test, test), (test, ~test)]


def longest_block(records, folds):
    """Return the longest time that a fold holds out of a record that it fits to, s; else inf."""
    owner = np.repeat(np.arange(len(records)), [len(record.segments) for record in records])
    times = np.array([r.dt * (stop - start) for r in records for start, stop in r.segments])
    blocks = [
        times[test & (owner == number)].sum()
        for train, test in folds
        for number in np.intersect1d(owner[train], owner[test])
    ]
    return max(blocks, default=np.inf)


def extrapolated(records, folds):
    """Return the fraction of held-out samples whose drive is outside the fitted range."""
    drives = [r.drive[start:stop] for r in records for start, stop in r.segments]
    ends = np.array([(u.min(), u.max()) for u in drives])
    outside = total = 0
    for train, test in folds:
        low, high = ends[train, 0].min(), ends[train, 1].max()
        held = np.concatenate([drives[i] for i in np.flatnonzero(test)])
        outside += np.count_nonzero((held < low) | (held > high))
        total += len(held)
    return outside / total


def held_out_residuals(problem, predictions, starts=None):
    """Return the residuals of records, NaN before their starts.

    The input history of a record is estimated from the record itself. With n samples and k
    estimated values, the squared error of a prediction is expected to be (n + k) / (n - k) times
    that of the fit
    (Akaike, *Annals of the Institute of Statistical Mathematics*, 1969).
    """
    residuals = []
    for number, (record, prediction) in enumerate(zip(problem.records, predictions, strict=True)):
        residual = record.y - prediction
        if starts is not None:
            residual[: starts[number]] = np.nan
        if record.before is not None:
            n, k = int(np.isfinite(residual).sum()), np.size(record.before)
            residual *= np.sqrt((n + k) / max(n - k, 1))
        residuals.append(residual)
    return residuals


def root_mean_square(residuals, weights):
    """Return the root mean square of all known residuals; weights of None mean ones."""
    total = count = 0.0
    for e, w in zip(residuals, weights, strict=True):
        known = np.isfinite(e)
        w = np.ones(len(e)) if w is None else w
        total += w[known] @ np.square(e[known])
        count += w[known].sum()
    return float(np.sqrt(total / count))


def fold_errors(candidate, records, folds):
    """Return the held-out error of each fold, over the samples that the fold scores last."""
    spans = [(i, slice(*span)) for i, record in enumerate(records) for span in record.segments]
    errors = []
    for _, test in folds:
        scored = [spans[j] for j in np.flatnonzero(test)]
        weights = [w if (w := candidate.weights[i]) is None else w[rows] for i, rows in scored]
        residuals = [candidate.residuals[i][rows] for i, rows in scored]
        errors.append(root_mean_square(residuals, weights))
    return errors


def _fold_solution(problem, train, blocks, long):
    """Return the solution for a fold; ``blocks`` are those at the solution for all segments."""
    known = None if problem.depends_on(train) else blocks
    if long:  # with so many samples, the solution of a fold is close to that of all segments
        if known is None:
            known = problem.evaluate(problem.x0, select=train)
        return single_step(problem, problem.x0, known, train)
    return variable_projection(
        problem,
        problem.x0,
        select=train,
        blocks=known,
        tolerance=TOLERANCE,
        max_evaluations=RUNG + 1,  # the start is close to the solution
    ).x
