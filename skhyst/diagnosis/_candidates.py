"""Candidates: the model so far with effects added, refitted in rounds of halving, and held out.

Successive halving (Jamieson and Talwalkar, AISTATS 2016) spends the same number of simulations on
each rung: every candidate is simulated once, at its starting values, and the step from there is
predicted; the best third is refitted with three simulations each, the best third of these with
nine, the last third with 27. An effect keeps its best candidate up to the last cut, so that a
variant with many parameters does not crowd out another effect; of the effects the best third, and
three at least, is refitted last and held out.
"""

from dataclasses import dataclass, replace

import numpy as np
from joblib import delayed

from ..optimize import predicted_cost, single_step, variable_projection
from ._shortened import are_long
from ._starts import starting_trees

__all__ = [
    "FACTOR",
    "Candidate",
    "best_of_effects",
    "halve",
    "held_out",
    "predicted",
    "refitted",
]

FACTOR = 3  # of a rung: so many times fewer candidates, so many times the evaluations; e is best
_RUNGS = 3  # after the prediction
_FOLD_EVALUATIONS = FACTOR + 1  # from the solution for all data, a part of which it has seen
_TOLERANCE = 1e-5  # relative change of the sum of squares; a claim is worth a few per cent


@dataclass(frozen=True)
class Candidate:
    """A model with operators at its solution, and what it achieves.

    Attributes
    ----------
    effects : tuple of str
        What was added to the model so far.
    structure : Tree
    cost : float
        Sum of squares of the fit.
    n_parameters : int
    x : ndarray
        Solution in the coordinates of the least-squares problem.
    residuals, predictions, weights : tuple of ndarray of shape (n_samples,)
        Held out, of each record, NaN where nothing is scored; no weights (None) are ones.
    error : float
        Held-out root mean square error.
    box : object
        What the declared black box predicts, where one was declared, see ``_black_box``.
    """

    effects: tuple
    structure: object
    cost: float
    n_parameters: int
    x: np.ndarray
    residuals: tuple | None = None
    predictions: tuple | None = None
    weights: tuple | None = None
    error: float = np.nan
    box: object = None


def predicted(effect, structure, records):
    """Return candidates at an effect's starting values, with what one step from there promises."""
    found = []
    for variant in starting_trees(effect, structure, records):
        for start in variant:
            problem = start.problem(records)
            promise = predicted_cost(problem, problem.x0)
            n_parameters = len(problem.x0) + start.n_coefficients()
            found.append(Candidate((effect.name,), start, promise, n_parameters, problem.x0))
    return found


def refitted(candidate, structure, records, max_evaluations=FACTOR ** (_RUNGS + 1)):
    """Return the candidate with a structure in place of its own, refitted."""
    problem = structure.problem(records)
    n_parameters = len(problem.x0) + structure.n_coefficients()
    solution = variable_projection(
        problem, problem.x0, tolerance=_TOLERANCE, max_evaluations=max_evaluations
    )
    return replace(
        candidate,
        structure=structure.at(problem, solution.x),
        cost=solution.cost,
        x=solution.x,
        n_parameters=n_parameters,
    )


def halve(groups, parallel):
    """Halve the candidates of each group until each has about one that is well refitted.

    Parameters
    ----------
    groups : list of (list of Candidate, list of RecordData)
        At starting values, and the records they are refitted to.
    parallel : joblib.Parallel

    Returns
    -------
    list of list of (float, Candidate)
        Of each group, with Schwarz's criterion, best first.
    """
    found = [candidates for candidates, _ in groups]
    for rung in range(1, _RUNGS):
        found = [_best(candidates) for candidates in found]
        flat = [(c, groups[i][1]) for i, own in enumerate(found) for c in own]
        fitted = iter(parallel(delayed(refitted)(c, c.structure, r, FACTOR**rung) for c, r in flat))
        found = [[next(fitted) for _ in own] for own in found]
    judged = iter(
        parallel(delayed(_criterion)(c, groups[i][1]) for i, own in enumerate(found) for c in own)
    )
    found = [[(next(judged), c) for c in own] for own in found]
    return [sorted(own, key=lambda entry: entry[0]) for own in found]


def _best(candidates):
    """Return the best third of the candidates, one at least."""
    ordered = sorted(candidates, key=lambda c: c.cost)
    return ordered[: -(-len(ordered) // FACTOR)]


def best_of_effects(candidates):
    """Return the best third of candidates with their criterion, ``FACTOR`` at least."""
    ordered = sorted(candidates, key=lambda entry: entry[0])
    return [c for _, c in ordered[: max(-(-len(ordered) // FACTOR), FACTOR)]]


def _criterion(candidate, records):
    """Return Schwarz's criterion with the number of parameters that a dependent residual has.

    With independent errors of one variance the trace below is that variance times the number of
    parameters. Where the residual of a stretch hangs together it is larger (Takeuchi 1976), and
    counting every sample as evidence would prefer curves that only follow the residual.
    """
    problem = candidate.structure.problem(records)
    n = float(problem.segment_weight.sum())
    cost = max(candidate.cost, np.finfo(float).tiny)
    n_parameters = candidate.structure.n_coefficients() * len(records)
    x = candidate.x
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
    return n * np.log(cost / n) + (effective + n_parameters) * np.log(n)


def held_out(candidate, records, folds):
    """Predict every segment from a fit that did not see it; return the completed candidate.

    ``folds`` are pairs of boolean masks over segments: those fitted, those scored.
    """
    problem = candidate.structure.problem(records)
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
    weights = tuple(record.weights for record in records)
    return replace(
        candidate,
        residuals=tuple(residuals),
        predictions=tuple(predictions),
        weights=weights,
        error=_root_mean_square(residuals, weights),
    )


def _root_mean_square(residuals, weights):
    total = count = 0.0
    for e, w in zip(residuals, weights, strict=True):
        known = np.isfinite(e)
        w = np.ones(len(e)) if w is None else w
        total += w[known] @ np.square(e[known])
        count += w[known].sum()
    return float(np.sqrt(total / count))


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
        tolerance=_TOLERANCE,
        max_evaluations=_FOLD_EVALUATIONS,
    ).x
