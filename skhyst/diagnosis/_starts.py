"""Starting values of an effect in a structure, from the data."""

from dataclasses import replace

import numpy as np

from ..operators import DelayOperator, LinearOperator
from ..optimize import distribute_poles, pole_starts

__all__ = ["starting_structures"]

_STARTS = 3  # of many starting values, so many are linearised
_THINNED = 3  # every so many samples decide which
_SAME_POLES = 0.03  # relative distance of poles that need no start of their own


def starting_structures(effect, structure, records):
    """Yield, for each variant of an effect, the structures at its starting values."""
    if effect.beside:
        y = structure.run(records)
        rest = [replace(r, y=r.y - part) for r, part in zip(records, y, strict=True)]
        for model in effect.variants():
            yield [
                structure.beside(effect.name, model, disturbance)
                for _, disturbances in model._starts(rest)
                for disturbance in disturbances
            ]
        return
    signals = {}
    for model in effect.variants():
        at = structure.position(model._rank)
        if at not in signals:
            signals[at] = structure.run(records, last=at)
        here = [replace(r, u=u) for r, u in zip(records, signals[at], strict=True)]
        candidates = [
            structure.insert(effect.name, model, _unit_gain(operator, structure))
            for operator, _ in model._starts(here)
        ]
        first = min(at, _first_dynamics(structure))
        if first not in signals:
            signals[first] = structure.run(records, last=first)
        candidates += _redistributed(candidates, at, records, signals[first], first)
        yield _promising(candidates, structure, records, signals[first], first)


def _first_dynamics(structure):
    """Return the position of the first linear dynamics."""
    ranks = [isinstance(stage, LinearOperator) for stage in structure.operators]
    return ranks.index(True) if any(ranks) else len(ranks)


def _redistributed(candidates, at, records, signals, first):
    """Return candidates whose linear dynamics all start anew, from poles of their total number.

    A declared model that lacks a pole bends its own poles to make up for it, and a local search
    would leave them there.
    """
    stages = candidates[0].operators
    if not isinstance(stages[at], LinearOperator | DelayOperator):
        return []
    block = [i for i, stage in enumerate(stages) if isinstance(stage, LinearOperator)]
    delayed = isinstance(stages[first], DelayOperator)
    if len(block) + delayed < 2:
        return []
    n_poles = sum(sum((1, 2)[j] * n for j, n in enumerate(stages[i].n_poles)) for i in block)
    found = []
    for candidate in candidates if delayed else candidates[:1]:
        inputs = candidate.run(records, first=first, last=block[0], signals=signals)
        data = [(u, r.y, r.dt) for u, r in zip(inputs, records, strict=True)]
        for poles in _distinct(pole_starts(data, n_poles)):
            for own in distribute_poles([stages[i] for i in block], poles):
                operators = list(candidate.operators)
                for i, operator in zip(block, own, strict=True):
                    operators[i] = operator
                found.append(replace(candidate, operators=tuple(operators)))
    return found


def _distinct(pole_sets):
    """Return the pole sets that are not near one before."""
    kept = []
    for poles in pole_sets:
        ordered = np.sort_complex(poles)
        if all(np.max(np.abs(ordered / other - 1.0)) > _SAME_POLES for other in kept):
            kept.append(ordered)
    return kept


def _unit_gain(operator, structure):
    """Return the operator without the gain and the intercept that another stage carries."""
    if not any(stage.carries_scale for stage in structure.operators):
        return operator
    values = operator.pack()
    for i, (_, spec) in enumerate(operator.entries()):
        if spec.gauge is not None:
            values[i] = spec.gauge
    return operator.unpack(values)


def _promising(candidates, structure, records, signals, first):
    """Return the few candidates whose output, up to gain and offset, fits best."""
    if len(candidates) <= _STARTS:
        return candidates
    rows = _counted(records)[::_THINNED]
    y = np.concatenate([record.y for record in records])[rows]
    before = np.concatenate(structure.run(records, first=first, signals=signals))[rows]
    costs = []
    for candidate in candidates:
        output = np.concatenate(candidate.run(records, first=first, signals=signals))[rows]
        columns = np.stack([np.ones_like(y), before, output])
        columns /= np.linalg.norm(columns, axis=1, keepdims=True) + np.finfo(float).tiny
        gram, right = columns @ columns.T, columns @ y
        gram[np.diag_indices(3)] *= 1.0 + 1e-12
        costs.append(-right @ np.linalg.lstsq(gram, right, rcond=None)[0])
    order = np.argsort(np.nan_to_num(costs, nan=np.inf), kind="stable")
    return [candidates[i] for i in order[:_STARTS]]


def _counted(records):
    rows, start = [], 0
    for record in records:
        rows += [np.arange(start + a, start + b) for a, b in record.segments]
        start += len(record.u)
    return np.concatenate(rows)
