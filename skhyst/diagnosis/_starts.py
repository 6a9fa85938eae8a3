"""Starting values of an effect in a tree, from the data."""

from dataclasses import replace
from functools import cached_property

import numpy as np

from ..operators import split_disturbances
from ..optimize import distribute_poles, pole_starts, variable_projection
from ._constants import NOTICEABLE, RUNG, SEVERAL, TOLERANCE
from ._edits import AddDisturbance, Insert


def starting_trees(effect, tree, records):
    """Return the trees at the starting values of each variant of an effect that applies.

    A variant is a model, which is added in parallel or at its stage order, or a change (see
    ``_changes``), which makes the trees itself.
    """
    scene = Scene(tree, records)
    variants = []
    for variant in effect.variants():
        if hasattr(variant, "trees"):
            variants.append(variant.trees(effect.name, scene))
        elif effect.additive:
            variants.append(additive(effect.name, variant, scene))
        else:
            variants.append(inserted(effect.name, variant, scene))
    return [candidates for candidates in variants if candidates]


class Scene:
    """A tree and its records, with the signals between the stages, which are cached."""

    def __init__(self, tree, records):
        self.tree = tree
        self.records = records
        self._signals = {}
        self._found = {}

    def kept(self, key, find):
        """Return ``find(scene, *key)``, computed once for all variants of an effect."""
        if key not in self._found:
            self._found[key] = find(self, *key)
        return self._found[key]

    def signals(self, at):
        """Return the input of a place of the series, for each record."""
        if at not in self._signals:
            self._signals[at] = self.tree.run(self.records, last=at)
        return self._signals[at]

    def records_at(self, at):
        """Return the records with the input of a place of the series as their drive."""
        return [
            replace(r, u=u, before=before)
            for r, u, before in zip(
                self.records, self.signals(at), self.tree.history_at(self.records, at), strict=True
            )
        ]

    @cached_property
    def residuals(self):
        """The records with the residual of the driven part as their response."""
        outputs = self.tree.respond(self.records)
        return [replace(r, y=r.y - y) for r, y in zip(self.records, outputs, strict=True)]

    @cached_property
    def has_lost_poles(self):
        """Whether a mode rings through all records, or decays within a sampling interval.

        There, the derivative of the response by the damping vanishes: no gradient leads back.
        """
        modes = [o for o in self.tree.operators if _has_poles(o) and o.n_poles[1]]
        poles = np.concatenate([np.empty(0), *(operator.poles() for operator in modes)])
        return bool(np.any(self.seen(poles) != poles))

    def seen(self, poles):
        """Return poles with decay rates clipped to those that records and sampling resolve."""
        slowest = 1.0 / max(len(record.u) * record.dt for record in self.records)
        fastest = np.pi / min(record.dt for record in self.records)
        return -np.clip(-poles.real, slowest, fastest) + 1j * poles.imag

    def promising(self, candidates, first):
        """Return the few candidates whose output improves the fit most, and the best one alone.

        Before the place ``first`` they are equal. The improvement is that of a linear fit of the
        output together with that of the present tree, with free gains and offset; alone, without
        the present tree.
        """
        if len(candidates) <= SEVERAL:
            return candidates
        records, signals = self.records, self.signals(first)
        rows = _some(records)
        y = np.concatenate([record.y for record in records])[rows]
        before = np.concatenate(self.tree.run(records, first=first, signals=signals))[rows]
        together, alone = [], []
        for candidate in candidates:
            output = np.concatenate(candidate.run(records, first=first, signals=signals))[rows]
            # the constant and the output come first, so that the fit alone is a leading block
            columns = np.stack([np.ones_like(y), output, before])
            columns /= np.linalg.norm(columns, axis=1, keepdims=True) + np.finfo(float).tiny
            gram, right = columns @ columns.T, columns @ y
            # an output equal to the present one makes columns collinear
            gram[np.diag_indices(3)] *= 1.0 + 1e-12
            if not np.isfinite(gram).all():
                gram, right = np.eye(3), np.zeros(3)
            together.append(-right @ np.linalg.lstsq(gram, right, rcond=None)[0])
            gram_alone, right_alone = gram[:2, :2], right[:2]
            alone.append(-right_alone @ np.linalg.lstsq(gram_alone, right_alone, rcond=None)[0])
        chosen = np.argsort(together, kind="stable")[:SEVERAL].tolist()
        best = int(np.argmin(alone))
        return [candidates[i] for i in (chosen if best in chosen else [*chosen, best])]


def driven_starts(model, records, **known):
    """Return the operators at the starting values of a model."""
    return [split_disturbances(start)[0] for start in model.starting_values(records, **known)]


def additive(name, model, scene):
    """Return the trees with an additive disturbance, at its starting values."""
    return [
        scene.tree.edited(name, AddDisturbance(model, disturbance))
        for start in model.starting_values(scene.residuals)
        for disturbance in split_disturbances(start)[1]
    ]


def inserted(name, model, scene):
    """Return the trees with a model at its stage order, from its promising starting values."""
    tree = scene.tree
    at = tree.position(model.stage_order)
    if at == 0 and tree.multi_input:
        return []
    candidates = [
        with_same_input(tree.edited(name, Insert(model, operator)), at, scene)
        for operator in driven_starts(model, scene.records_at(at))
    ]
    dynamics = [i for i, operator in enumerate(tree.operators) if _has_poles(operator)]
    first = min([at, *dynamics])
    redistributed = _redistributed(candidates, at, scene, first) if candidates else []
    return scene.promising(
        redistributed if scene.has_lost_poles else candidates + redistributed, first
    )


def with_same_input(tree, at, scene):
    """Return a tree whose new stage is fitted so that the curve behind it keeps its input.

    A stage that owns the gain starts without one. Elsewhere its linear parameters are solved
    exactly; through a curve that is no linear problem, and the curve was fitted to its present
    input.
    """
    operators = tree.operators
    bent = [i for i in range(at + 1, len(operators)) if not operators[i].signal_linear]
    if not (bent and operators[at].owns_gain):
        return tree
    signals = scene.signals(bent[0] - 1)
    records = [replace(r, y=u) for r, u in zip(scene.records, signals, strict=True)]
    before = tree.with_stages(tree.stages[: bent[0]])
    problem = before.problem(records)
    solution = variable_projection(problem, problem.x0, tolerance=TOLERANCE, max_evaluations=RUNG)
    fitted = before.at(problem, solution.x).stages
    return tree.with_stages([*fitted, *tree.stages[bent[0] :]])


def _redistributed(candidates, at, scene, first):
    """Return candidates whose linear dynamics start again, from as many poles as they have in all.

    A declared model that lacks a pole shifts its own poles to compensate for it, and a local search
    would leave them there; the same holds for poles that were lost because an effect was missing.
    """
    operators, lost = candidates[0].operators, scene.has_lost_poles
    delayed = not _has_poles(operators[first])
    bent = operators[at].signal_linear and sum(map(_has_poles, operators)) + delayed >= 2
    if not (bent or lost):
        return []
    return [
        tree
        for candidate in (candidates if delayed or lost else candidates[:1])
        for tree in _redistributed_poles(candidate, scene, first)
    ]


def _has_poles(operator):
    """Whether an operator is linear and can be given other poles."""
    return hasattr(operator, "with_poles") and sum(operator.n_poles) > 0


def _redistributed_poles(tree, scene, first):
    """Return trees with poles estimated from the signals, distributed over the stages in all ways.

    The tree equals that of the scene before the place ``first``.
    """
    operators = tree.operators
    block = [i for i, operator in enumerate(operators) if _has_poles(operator)]
    n_poles = sum(real + 2 * pairs for real, pairs in (operators[i].n_poles for i in block))
    inputs = tree.run(scene.records, first=first, last=block[0], signals=scene.signals(first))
    data = [(u, r.y, r.dt) for u, r in zip(inputs, scene.records, strict=True)]
    trees, pole_sets = [], _distinct(pole_starts(data, n_poles))
    if scene.has_lost_poles:  # moved to where a gradient exists, with almost the same response
        pole_sets.append(scene.seen(np.concatenate([operators[i].poles() for i in block])))
    for poles in pole_sets:
        for shared in distribute_poles([operators[i] for i in block], poles):
            stages = list(tree.stages)
            for i, moved in zip(block, shared, strict=True):
                stages[i] = stages[i]._replace(operator=replace(moved, model=operators[i].model))
            trees.append(tree.with_stages(stages))
    return trees


def _distinct(pole_sets):
    """Return the pole sets that are not close to an earlier one."""
    distinct = []
    for poles in pole_sets:
        ordered = np.sort_complex(poles)
        if all(np.max(np.abs(ordered / other - 1.0)) > NOTICEABLE for other in distinct):
            distinct.append(ordered)
    return distinct


def _some(records):
    """Return every third of the scored rows in each record."""
    rows, start = [], 0
    for record in records:
        scored = np.concatenate([np.arange(a, b) for a, b in record.segments])
        rows.append(start + scored[::3])
        start += len(record.u)
    return np.concatenate(rows)
