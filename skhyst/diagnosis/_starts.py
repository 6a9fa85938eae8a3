"""Starting values of an effect in a structure, from the data."""

from dataclasses import replace

import numpy as np

from ..operators import DelayOperator, LinearOperator
from ..optimize import distribute_poles, pole_starts

__all__ = ["starting_structures"]

_STARTS = 3  # of many starting values, so many are linearised


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
        rank = model._starts(records)[0][0].rank
        at = structure.position(rank)
        if at not in signals:
            signals[at] = structure.run(records, last=at)
        here = [replace(r, u=u) for r, u in zip(records, signals[at], strict=True)]
        candidates = [
            structure.insert(effect.name, model, operator) for operator, _ in model._starts(here)
        ]
        first = min(at, _first_dynamics(structure))
        if first not in signals:
            signals[first] = structure.run(records, last=first)
        candidates += _redistributed(candidates, records, signals[first], first)
        yield _promising(candidates, structure, records, signals[first], first)


def _first_dynamics(structure):
    """Return the position of the first linear dynamics."""
    ranks = [isinstance(stage, LinearOperator) for stage in structure.operators]
    return ranks.index(True) if any(ranks) else len(ranks)


def _redistributed(candidates, records, signals, first):
    """Return candidates whose linear dynamics all start anew, from poles of their total number.

    A declared model that lacks a pole bends its own poles to make up for it, and a local search
    would leave them there.
    """
    stages = candidates[0].operators
    block = [i for i, stage in enumerate(stages) if isinstance(stage, LinearOperator)]
    delayed = isinstance(stages[first], DelayOperator)
    if len(block) + delayed < 2:
        return []
    n_poles = sum(sum((1, 2)[j] * n for j, n in enumerate(stages[i].n_poles)) for i in block)
    found = []
    for candidate in candidates if delayed else candidates[:1]:
        inputs = candidate.run(records, first=first, last=block[0], signals=signals)
        data = [(u, r.y, r.dt) for u, r in zip(inputs, records, strict=True)]
        for poles in pole_starts(data, n_poles, 0):
            for own in distribute_poles([stages[i] for i in block], poles):
                operators = list(candidate.operators)
                for i, operator in zip(block, own, strict=True):
                    operators[i] = operator
                found.append(replace(candidate, operators=tuple(operators)))
    return found


def _promising(candidates, structure, records, signals, first):
    """Return the few candidates whose output, up to gain and offset, fits best."""
    if len(candidates) <= _STARTS:
        return candidates
    y = np.concatenate([record.y for record in records])
    rows = _counted(records)
    before = np.concatenate(structure.run(records, first=first, signals=signals))
    costs = []
    for candidate in candidates:
        # gains are free until the joint fit: the series is run without holding them
        output = np.concatenate(
            replace(candidate, operators=candidate.series().stages).run(
                records, first=first, signals=signals
            )
        )
        columns = np.stack([np.ones_like(y), before, output], axis=1)[rows]
        gram = columns.T @ columns
        gram[np.diag_indices(3)] *= 1.0 + 1e-12
        right = columns.T @ y[rows]
        costs.append(-right @ np.linalg.lstsq(gram, right, rcond=None)[0])
    order = np.argsort(np.nan_to_num(costs, nan=np.inf), kind="stable")
    return [candidates[i] for i in order[:_STARTS]]


def _counted(records):
    rows, start = [], 0
    for record in records:
        rows += [np.arange(start + a, start + b) for a, b in record.segments]
        start += len(record.u)
    return np.concatenate(rows)
