r"""How many terms a sum has, and their positions: exchange of terms for a sparse measure.

A part such as a sum of plays is a measure over positions: a weight at each threshold. The
best-fitting measure is found by the sliding conditional gradient (Denoyelle et al., *Inverse
Problems*, 2020), written for normal equations:

1. *Scan.* One pass over the records gives the Gram matrices of the columns of terms on a fine grid
   of positions and of all other parameters. From these, terms are added one by one, each time the
   one that reduces the sum of squares most in addition to the present ones (orthogonal least
   squares: Chen, Billings and Luo, *International Journal of Control*, 1989). The weights are
   solved within their bounds each time, and a term whose weight is zero is removed.
2. *How many.* The same is done in each fold, with terms of its own choice, and scored on the
   held-out samples: so the choice of a further term is penalised, too. The number that predicts
   best is taken.
3. *Slide.* All positions move to the minimum of the sum of squares, jointly with all other
   parameters, and coinciding terms are merged.

The steps are repeated with the present terms, whose positions are then free, and a new scan, until
no further term predicts better. Finally, the term that costs least is removed, repeatedly, while
the others, at their new optimum, predict worse by no more than a needless term would gain by
chance. Such a term fits the noise at the best of all positions of the scan: its gain is the largest
square of as many normal variables, about ``2 log(places)`` mean squares of the residual.
"""

from dataclasses import dataclass, replace
from itertools import islice, pairwise

import numpy as np

from ..operators import MovableOperator, Operator, has_weight, select_terms, with_terms
from ._bounded_step import bounded_step
from ._problem import OperatorProblem
from ._variable_projection import damped_step, variable_projection

_FOLDS = 5  # as scikit-learn's own default
_SHORTEST = 16  # samples of a block
# tolerance of a slide, relative to the mean square that one more parameter removes by chance
_SETTLED = 0.1
_EVALUATIONS = 12  # of a slide
_SLIDES = 3  # after each of which coinciding terms are merged
_COINCIDENT = 1e-6  # distance of coinciding terms, relative to the largest position
_DEPENDENT = 1e-9  # residual power of a column that depends linearly on the others, relative
_ROUNDING = 1e-14  # fraction of the sum of squares; a smaller gain is rounding
_LEAST = np.sqrt(np.finfo(float).tiny)  # smallest norm of a column that is not rounding


@dataclass(frozen=True)
class Alone:
    """The place of a part that is the whole model: the interface that :func:`exchanged` needs.

    Attributes
    ----------
    part : Operator
        With a ``resolution``.
    records : sequence of RecordData
    fixed : frozenset of str
        Names of entries that are held.
    initial_state : {"rest", "zero"}
    """

    part: Operator
    records: tuple
    fixed: frozenset = frozenset()
    initial_state: str = "rest"

    def problem(self, part):
        """Return the least-squares problem of the model with another part in this place."""
        return OperatorProblem(
            part, self.records, fixed=self.fixed, initial_state=self.initial_state
        )

    def at(self, problem, x):
        """Return the place with the operators of a problem at ``x``."""
        return replace(self, part=problem.unpack(x)[0])

    def name(self, entry):
        """Return the name of an entry of the part in the problem."""
        return entry

    def inputs(self):
        """Return the records with the input of the part as their drive."""
        return self.records


def exchanged(place, folds):
    """Return a place whose part has the number of terms that predicts best out of fold.

    See the head of this module for the steps.

    Parameters
    ----------
    place : Alone
        Or an object with its attribute and methods; the part is at its solution.
    folds : list of (train, test)
        Boolean masks over the segments of all records: those fitted, those scored.

    Returns
    -------
    place
        The given one if no other resolution predicts better.
    """
    best_cost = _held_out(place, folds) if folds else np.inf
    if best_cost == np.inf:
        return place
    best = current = place
    for candidate in filter(None, (_pursued(place, folds, anew=True), place)):
        candidate = _settled(candidate)
        cost = _held_out(candidate, folds)
        if cost < best_cost:
            best, best_cost = candidate, cost
            break
    current = best if best is not place else _settled(place)
    while (further := _pursued(current, folds)) is not None:
        current = _settled(further)
        cost = _held_out(current, folds)
        if not cost < best_cost:
            break
        best, best_cost = current, cost
    return best if best is place else _thinned(best, folds, best_cost)


def block_folds(records):
    """Return the records cut into blocks, and folds that each hold out one block of every record.

    All folds train on the first block: the first response of a device's memory is not repeated
    later. Records that are divided into segments already are not cut, and always in the training
    set.

    Parameters
    ----------
    records : sequence of RecordData

    Returns
    -------
    records : list of RecordData
    folds : list of (train, test)
        Boolean masks over the segments of all records; none if the records are too short.
    """
    cut, numbers = [], []
    for record in records:
        n = min(_FOLDS + 1, len(record.u) // _SHORTEST)
        if len(record.segments) > 1 or n < 2:
            cut.append(record)
            numbers += [0] * len(record.segments)
            continue
        edges = np.linspace(0, len(record.u), n + 1).astype(int).tolist()
        cut.append(replace(record, segments=tuple(pairwise(edges))))
        numbers += range(n)
    masks = [np.array(numbers) == i for i in range(1, _FOLDS + 1)]
    return cut, [(~test, test) for test in masks if test.any()]


def record_folds(records, count=_FOLDS):
    """Return folds that hold out whole records within the range of the others.

    A record whose drive or column exceeds the range of all others could only be extrapolated.

    Parameters
    ----------
    records : sequence of RecordData
    count : int, default=5
        Largest number of groups in which records are held out.

    Returns
    -------
    folds : list of (train, test)
        Boolean masks over the segments of all records. Empty if no record is held out.
    """
    if len(records) < 2:
        return []
    owner = np.repeat(np.arange(len(records)), [len(record.segments) for record in records])
    inputs = [np.column_stack([x for x in (r.u, r.auxiliary) if x is not None]) for r in records]
    low, high = (np.array([end(values, axis=0) for values in inputs]) for end in (np.min, np.max))
    # in an order that does not depend on their order in the data
    order = np.lexsort([[r.drive.mean() for r in records], [r.y.mean() for r in records]])
    folds = []
    for group in np.array_split(order, min(len(records), max(count, 2))):
        lows, highs = (np.delete(ends, group, axis=0) for ends in (low, high))
        within = (low[group] >= lows.min(axis=0)) & (high[group] <= highs.max(axis=0))
        held_out = np.isin(owner, group[within.all(axis=1)])
        folds.append((~held_out, held_out))
    return [(train, test) for train, test in folds if test.any()]


def whole_record_folds(records, folds):
    """Return folds that hold out whole records, if there are several.

    The segments of a record outside the range of the others are held out as in the given folds.

    Parameters
    ----------
    records : sequence of RecordData
    folds : list of (train, test)
        Boolean masks over the segments of all records. Records are held out in as many groups.

    Returns
    -------
    list of (train, test)
    """
    scored, whole = np.any([test for _, test in folds], axis=0), record_folds(records, len(folds))
    split = ~np.any([test for _, test in whole], axis=0) if whole else np.ones(len(scored), bool)
    merged = [(train, test & scored) for train, test in whole]
    merged += [(train, test & split) for train, test in folds]
    return [(train, test) for train, test in merged if test.any()]


def merged_segments(records, folds):
    """Return records with neighbouring segments merged where no fold divides them, and the folds.

    If no coefficients are fitted per record, the result is the same with fewer sums.

    Parameters
    ----------
    records : sequence of RecordData
    folds : list of (train, test)

    Returns
    -------
    records : list of RecordData
    folds : list of (train, test)
    """
    marks = np.array([mask for fold in folds for mask in fold])
    merged, first, firsts = [], 0, []
    for record in records:
        fold_marks = marks[:, first : first + len(record.segments)]
        gaps = np.array([a[1] != b[0] for a, b in pairwise(record.segments)], dtype=bool)
        is_first = np.append(True, gaps | np.any(fold_marks[:, 1:] != fold_marks[:, :-1], axis=0))
        starts = np.flatnonzero(is_first)
        ends = np.append(starts[1:], len(record.segments)) - 1
        pairs = zip(starts, ends, strict=True)
        segments = tuple((record.segments[a][0], record.segments[b][1]) for a, b in pairs)
        merged.append(replace(record, segments=segments))
        firsts.append(first + starts)
        first += len(record.segments)
    kept = np.concatenate(firsts)
    return merged, [(train[kept], test[kept]) for train, test in folds]


def _movable(place):
    """Return the part with its positions as parameters."""
    part = place.part
    if not part.resolution.holds_positions(part):
        return part
    return MovableOperator.around(part, float(np.max(part.finer(place.inputs()))))


class _Columns:
    """The columns of a part's terms among the unknowns of a problem.

    ``groups`` (n_terms, n_columns) are the columns of the weights and other linear fields, empty if
    these are held; ``positions`` (n_terms,) is -1 for a term that does not move.
    """

    def __init__(self, place, problem, part):
        resolution = part.resolution
        numbers = {name: i for i, name in enumerate(problem.names)}
        rows = range(resolution.of(part))
        fields = [
            name
            for name in (resolution.weights, *resolution.others)
            if np.size(getattr(part, name))
        ]
        columns = [[numbers.get(place.name(f"{f}[{i}]"), -1) for f in fields] for i in rows]
        self.groups = np.array(columns, dtype=int)
        if np.any(self.groups < 0):
            self.groups = np.empty((0, 0), dtype=int)
        names = (place.name(f"{resolution.positions}[{i}]") for i in rows)
        self.positions = np.array([numbers.get(name, -1) for name in names], dtype=int)

    def moving(self, terms):
        """Return the columns of the positions of those terms that move."""
        positions = self.positions[terms]
        return positions[positions >= 0]


def _held_out(place, folds):
    """Return the out-of-fold sum of squares, by one step from the solution for all samples.

    Infinity if the weights are held or no term remains.
    """
    problem = place.problem(_movable(place))
    if not _Columns(place, problem, place.part).groups.size:
        return np.inf
    blocks = problem.evaluate(problem.x0)
    steps = [
        damped_step(problem, problem.x0, problem.total(blocks, train))[0] for train, _ in folds
    ]
    return _scored(problem, blocks, steps, folds)


def _scored(problem, blocks, steps, folds):
    return sum(
        problem.predicted_power(blocks, step, *fold)
        for step, fold in zip(steps, folds, strict=True)
    )


def _settled(place):
    """Return the place with all terms at their best positions, coinciding ones merged."""
    for _ in range(_SLIDES):
        part = _movable(place)
        problem = place.problem(part)
        tolerance = _SETTLED / problem.segment_weight.sum()
        solution = variable_projection(
            problem, problem.x0, tolerance=tolerance, max_evaluations=_EVALUATIONS
        )
        place = place.at(problem, solution.x)
        if part is not place.part and isinstance(place.part, MovableOperator):
            place = replace(place, part=place.part.operator)
        merged = _merged(place.part)
        if merged is None:
            return place
        place = replace(place, part=merged)
    return place


def _merged(part):
    """Return a part without zero weights and with coinciding terms merged; None if unchanged."""
    resolution = part.resolution
    kept = resolution.stays(part) | has_weight(part)
    weights = np.array(getattr(part, resolution.weights), dtype=float)
    if resolution.positions is None:  # ordered terms: only the last ones can be removed
        kept[: np.flatnonzero(kept).max(initial=-1) + 1] = True
    else:
        positions, stays = np.asarray(getattr(part, resolution.positions)), resolution.stays(part)
        for pair in pairwise(np.flatnonzero(kept)):
            if np.ptp(positions[list(pair)]) <= _COINCIDENT * positions[-1]:
                removed, survivor = pair if not stays[pair[0]] else pair[::-1]
                weights[survivor], weights[removed] = weights[survivor] + weights[removed], 0.0
                kept[removed] = False
    if kept.all() or not kept.any():
        return None
    return select_terms(replace(part, **{resolution.weights: weights}), kept)


def _pursued(place, folds, *, anew=False):
    """Return the place with the further terms that predict best; None if none helps.

    With ``anew``, present terms are removed first, except fixed ones.
    """
    resolution = place.part.resolution
    grid = np.asarray(place.part.finer(place.inputs()), dtype=float)
    if resolution.positions is not None:
        grid = grid[~np.isin(grid, getattr(place.part, resolution.positions))]
    part, further = with_terms(place.part, grid)
    is_candidate = ~resolution.stays(part) if anew else further
    movable = part if anew else _movable(replace(place, part=part))
    problem = place.problem(movable)
    x, columns = problem.x0, _Columns(place, problem, part)
    groups = columns.groups[is_candidate]
    blocks = _without(problem.evaluate(x), x, groups.ravel())
    candidate_columns = np.append(groups.ravel(), columns.moving(is_candidate))
    others = np.setdiff1d(np.arange(len(x)), candidate_columns)
    pursuit = _Pursuit(problem, groups, others, ordered=resolution.positions is None)
    paths = [pursuit.steps(problem.total(blocks, train)) for train, _ in folds]
    powers, steps = [], [next(path) for path in paths]
    # up to twice the best number is tried: two terms may help where one does not
    while len(powers) <= 2 * np.argmin([np.inf, *powers]):
        powers.append(_scored(problem, blocks, steps, folds))
        following = [next(path, None) for path in paths]
        if all(new is None for new in following):
            break
        steps = [old if new is None else new for old, new in zip(steps, following, strict=True)]
    fewest = int(is_candidate.all())  # a part has one term at least
    if len(powers) <= fewest:
        return None
    best_count = fewest + int(np.argmin(powers[fewest:]))
    if best_count == 0 and not anew:
        return None
    *_, step = islice(pursuit.steps(problem.total(blocks)), best_count + 1)
    is_weight = np.isin(np.arange(len(x)), groups)
    # nonlinear parameters are moved later, by damped steps
    x = np.where(is_weight, step, x + step * problem.linear)
    place = place.at(problem, np.clip(x, problem.lower, problem.upper))
    part = place.part if movable is part else place.part.operator
    kept = ~is_candidate | has_weight(part)
    if resolution.positions is None:
        kept[: np.flatnonzero(kept).max(initial=-1) + 1] = True
        return replace(place, part=select_terms(part, kept))
    return replace(place, part=_gathered(select_terms(part, kept), grid))


def _gathered(part, grid):
    """Return a part with neighbouring pairs on a grid merged at their weighted mean position.

    Two neighbours on a grid represent one term between them.
    """
    resolution = part.resolution
    positions = np.array(getattr(part, resolution.positions), dtype=float)
    weights = np.array(getattr(part, resolution.weights), dtype=float)
    cells, stays = np.searchsorted(grid, positions), resolution.stays(part)
    kept = np.ones(len(positions), dtype=bool)
    for i in range(1, len(positions)):
        is_pair = cells[i] - cells[i - 1] <= 1 and not (stays[i] or stays[i - 1])
        if is_pair and kept[i - 2 : i - 1].all() and weights[i] * weights[i - 1] > 0.0:
            positions[i] = np.average(positions[i - 1 : i + 1], weights=weights[i - 1 : i + 1])
            weights[i], kept[i - 1] = weights[i] + weights[i - 1], False
    return select_terms(
        replace(part, **{resolution.positions: positions, resolution.weights: weights}), kept
    )


def _without(blocks, x, weights):
    """Return the Gram matrices of the same columns with the residual at zero weights."""
    first = blocks.shape[1] - 1 - len(x)
    shift = np.zeros(blocks.shape[1])
    shift[first + weights], shift[-1] = -x[weights], 1.0
    moved = blocks.copy()
    last = blocks @ shift
    moved[:, :, -1], moved[:, -1, :], moved[:, -1, -1] = last, last, last @ shift
    return moved


class _Pursuit:
    """Greedy selection of terms: each one added reduces the sum of squares most.

    The Gram matrix is swept (Goodnight, *The American Statistician*, 1979): the last column holds
    the solution for the swept columns, and for the others the covariance with the residual.

    ``groups`` (n_terms, n_columns) are the columns of the candidate terms, whose weights are zero
    at the start; ``others`` the columns that are always free.
    """

    def __init__(self, problem, groups, others, *, ordered):
        self.groups, self.others, self.ordered = groups, others, ordered
        self.low, self.high = problem.lower[groups[:, 0]], problem.upper[groups[:, 0]]

    def steps(self, gram):
        """Yield the steps (n,) with 0, 1, 2, ... terms from a Gram matrix."""
        scale = np.sqrt(np.diag(gram))  # unit diagonal: thresholds then depend on no unit
        if scale[-1] <= _LEAST:  # the residual is zero
            yield np.zeros(len(gram) - 1)
            return
        scale[scale <= _LEAST] = np.inf
        swept = gram / np.outer(scale, scale)
        for i in self.others:
            if swept[i, i] > _DEPENDENT:
                _sweep(swept, i)
        columns, others = self.groups[:, 0], [i for i in self.others if swept[i, i] < 0.0]
        chosen, n_yielded = [], 0
        while True:
            if len(chosen) >= n_yielded:
                step = np.zeros(len(gram) - 1)
                index = np.array([*others, *self.groups[chosen].ravel()], dtype=int)
                step[index] = -swept[index, -1] * scale[-1] / scale[index]
                yield step
                n_yielded = len(chosen) + 1
            # a swept diagonal entry is the power of a column orthogonal to the chosen ones, so that
            # slope^2 / power is the decrease of the sum of squares by that column alone
            power, slope = swept[columns, columns], swept[columns, -1]
            limit = np.where(slope < 0.0, self.high, -self.low)
            gain = np.where((power > _DEPENDENT) & (limit > 0.0), slope**2, 0.0)
            gain /= np.where(power > 0.0, power, 1.0)
            gain[chosen] = 0.0
            best = int(np.argmax(gain > 0.0) if self.ordered else np.argmax(gain))
            if not gain[best] > _ROUNDING * swept[-1, -1]:
                return
            chosen.append(best)
            for i in self.groups[best]:
                if swept[i, i] > _DEPENDENT:
                    _sweep(swept, i)
            while True:  # a weight out of its bound is removed, the one that is farthest out first
                weights = -swept[columns[chosen], -1]
                beyond = np.maximum(self._beyond(weights, self.low[chosen], self.high[chosen]), 0.0)
                worst = int(np.argmax(beyond))
                if not beyond[worst] > 0.0:
                    break
                removed = chosen.pop(worst)
                for i in self.groups[removed]:
                    if swept[i, i] < 0.0:
                        _sweep(swept, i)
                if removed == best:
                    return

    @staticmethod
    def _beyond(weights, low, high):
        return np.where(low == 0.0, -weights, np.where(high == 0.0, weights, 0.0))


def _sweep(gram, i):
    """Sweep a row and column of a symmetric matrix; a negative pivot undoes a sweep."""
    sign, pivot = np.sign(gram[i, i]), gram[i, i]
    row = gram[i].copy()
    gram -= np.outer(row, row) / pivot
    gram[i] = gram[:, i] = sign * row / pivot
    gram[i, i] = -1.0 / pivot


def _thinned(place, folds, lowest):
    """Return the place without those terms whose removal does not worsen the prediction."""
    n_positions = max(len(place.part.finer(place.inputs())), 2)
    while True:
        chance = 1.0 + 2.0 * np.log(n_positions) / _n_scored(place, folds)
        reduced = _reduced(place, folds, chance * lowest)
        if reduced is None:
            return place
        reduced = _settled(reduced)
        cost = _held_out(reduced, folds)
        if not cost <= chance * lowest:
            return place
        place, lowest = reduced, cost


def _n_scored(place, folds):
    weight = place.problem(place.part).segment_weight
    return sum(weight[test].sum() for _, test in folds)


def _reduced(place, folds, largest):
    """Return the place without the term that costs least; None if folds predict worse then."""
    part, resolution = place.part, place.part.resolution
    problem = place.problem(_movable(place))
    columns, x = _Columns(place, problem, part), problem.x0
    removable = np.flatnonzero(~resolution.stays(part))
    removable = removable[-1:] if resolution.positions is None else removable
    if resolution.of(part) < 2 or not removable.size:
        return None
    blocks = problem.evaluate(x)

    def solved(gram, index):
        step = np.zeros(len(x))
        limits = (problem.lower - x)[index], (problem.upper - x)[index]
        step[index] = bounded_step(gram[np.ix_(index, index)], gram[index, -1], *limits)
        full = np.append(step, 1.0)
        return step, full @ gram @ full

    trials = []
    for i in removable:
        removed = np.append(columns.groups[i], columns.moving([i]))
        index = np.setdiff1d(np.arange(len(x)), removed)
        cost = solved(problem.total(_without(blocks, x, columns.groups[i])), index)[1]
        trials.append((cost, int(i), index))
    _, i, index = min(trials, key=lambda trial: trial[0])
    remaining = _without(blocks, x, columns.groups[i])
    steps = [solved(problem.total(remaining, train), index)[0] for train, _ in folds]
    if not _scored(problem, remaining, steps, folds) <= largest:
        return None
    return replace(place, part=select_terms(part, np.arange(resolution.of(part)) != i))
