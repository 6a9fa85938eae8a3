"""Starting values of an effect in a structure, from the data."""

from dataclasses import replace
from functools import cached_property

import numpy as np
from sklearn.base import clone

from ..hysteresis import OscillatorOperator
from ..linear import DelayOperator, LinearOperator
from ..operators import take_apart
from ..optimize import distribute_poles, pole_starts, predicted_cost

__all__ = [
    "Scene",
    "beside",
    "dynamics_anew",
    "hysteresis_anew",
    "inserted",
    "stage_anew",
    "starting_structures",
]

_STARTS = 3  # of many starting values, so many are linearised
_THINNED = 3  # every so many samples decide which
_LARGEST_CONDITION = 1e6  # of the scaled normal equations; a shape that can be told has some 1e3
_SAME_POLES = 0.03  # relative distance of poles that need no start of their own


def starting_structures(effect, structure, records):
    """Return, for each variant of an effect that applies, the structures at its starting values.

    A variant is a model, which is put beside the series or where its rank says, or a change of
    its own (see ``_changes``), which makes the structures itself.
    """
    scene = Scene(structure, records)
    found = []
    for variant in effect.variants():
        if hasattr(variant, "structures"):
            found.append(variant.structures(effect.name, scene))
        elif effect.beside:
            found.append(beside(effect.name, variant, scene))
        else:
            found.append(inserted(effect.name, variant, scene))
    return [candidates for candidates in found if candidates]


class Scene:
    """A structure and its records, with the signals between the stages, each computed once."""

    def __init__(self, structure, records):
        self.structure = structure
        self.records = records
        self._signals = {}

    def signals(self, at):
        """Return what goes into a place of the series, for each record."""
        if at not in self._signals:
            self._signals[at] = self.structure.run(self.records, last=at)
        return self._signals[at]

    def records_at(self, at):
        """Return the records with what goes into a place of the series as their drive."""
        return [
            replace(r, u=u, before=self.structure.rest(r, at))
            for r, u in zip(self.records, self.signals(at), strict=True)
        ]

    @cached_property
    def residuals(self):
        """The records with what the driven part leaves as their response."""
        outputs = self.structure.respond(self.records)
        return [replace(r, y=r.y - y) for r, y in zip(self.records, outputs, strict=True)]

    @cached_property
    def multi_input(self):
        """Whether the first stage takes several inputs, so that nothing can come before it."""
        return self.records[0].u.ndim > 1

    def promising(self, candidates, first):
        """Return the few candidates whose output helps most, and the one that fits best itself.

        They are alike before the place ``first``. An output helps where it fits together with that
        of the structure as it is, up to gains and offset.
        """
        if len(candidates) <= _STARTS:
            return candidates
        records, signals = self.records, self.signals(first)
        rows = _some(records)
        y = np.concatenate([record.y for record in records])[rows]
        before = np.concatenate(self.structure.run(records, first=first, signals=signals))[rows]
        together, alone = [], []
        for candidate in candidates:
            output = np.concatenate(candidate.run(records, first=first, signals=signals))[rows]
            columns = np.stack([np.ones_like(y), output, before])
            columns /= np.linalg.norm(columns, axis=1, keepdims=True) + np.finfo(float).tiny
            gram, right = columns @ columns.T, columns @ y
            gram[np.diag_indices(3)] *= 1.0 + 1e-12
            if not np.isfinite(gram).all():
                gram, right = np.eye(3), np.zeros(3)
            together.append(-right @ np.linalg.lstsq(gram, right, rcond=None)[0])
            own, part = gram[:2, :2], right[:2]
            alone.append(-part @ np.linalg.lstsq(own, part, rcond=None)[0])
        chosen = np.argsort(together, kind="stable")[:_STARTS].tolist()
        best = int(np.argmin(alone))
        return [candidates[i] for i in (chosen if best in chosen else [*chosen, best])]


def beside(name, model, scene):
    """Return the structures with a disturbance beside the series, at its starting values."""
    return [
        scene.structure.beside(name, model, disturbance)
        for _, disturbances in map(take_apart, model.starting_values(scene.residuals))
        for disturbance in disturbances
    ]


def _undisturbed(structure, records):
    """Return the records without what disturbances add to the response."""
    if not structure.disturbances:
        return records
    problem = structure.problem(records)
    coefficients = problem.coefficients(problem.evaluate(problem.x0, jacobian=False))
    known = problem.outputs(problem.operator, problem.disturbances, coefficients)
    return [
        replace(r, y=r.y - (y - driven))
        for r, y, driven in zip(records, known, structure.respond(records), strict=True)
    ]


def inserted(name, model, scene):
    """Return the structures with a model where its rank says, at its promising starting values."""
    structure = scene.structure
    at = structure.position(model.series_rank)
    if at == 0 and scene.multi_input:
        return []
    candidates = [
        structure.insert(name, model, _unit_gain(operator, structure))
        for operator, _ in map(take_apart, model.starting_values(scene.records_at(at)))
    ]
    first = min(at, _first_dynamics(structure))
    candidates += _redistributed(candidates, at, scene, first)
    return scene.promising(candidates, first)


def _first_dynamics(structure):
    """Return the position of the first linear dynamics."""
    ranks = [isinstance(stage, LinearOperator) for stage in structure.operators]
    return ranks.index(True) if any(ranks) else len(ranks)


def _redistributed(candidates, at, scene, first):
    """Return candidates whose linear dynamics all start anew, from poles of their total number.

    A declared model that lacks a pole bends its own poles to make up for it, and a local search
    would leave them there.
    """
    stages = candidates[0].operators
    if not isinstance(stages[at], LinearOperator | DelayOperator):
        return []
    delayed = isinstance(stages[first], DelayOperator)
    if len(_dynamics(stages)) + delayed < 2:
        return []
    return [
        anew
        for candidate in (candidates if delayed else candidates[:1])
        for anew in _started_anew(candidate, scene, first)
    ]


def hysteresis_anew(structure, records):
    """Return the structure with its hysteresis at the model's own starting values, or None.

    What is missing may have driven the shape of a hysteresis that stands alone so far off that a
    local search does not bring it back: to where the data no longer determine it.
    """
    if len(structure.operators) > 1 or not _can_start_anew(structure, records):
        return None
    if isinstance(structure.operators[0], LinearOperator | OscillatorOperator):
        return None
    problem = structure.problem(records)
    if problem.linear.all() or _is_determined(problem):
        return None
    starts = structure.models[0].starting_values(_undisturbed(structure, records))
    starts = [take_apart(start)[0] for start in starts]
    found = [replace(structure, operators=(operator,)) for operator in starts]
    problems = [candidate.problem(records) for candidate in found]
    return found[int(np.argmin([predicted_cost(p, p.x0) for p in problems]))]


def _is_determined(problem):
    """Whether all unknowns are, well enough, at the starting values of a problem."""
    hessian = problem.total(problem.evaluate(problem.x0))[:-1, :-1]
    scale = np.sqrt(np.maximum(np.diag(hessian), np.finfo(float).tiny))
    values = np.linalg.eigvalsh(hessian / np.outer(scale, scale))
    return values[0] > values[-1] / _LARGEST_CONDITION


def dynamics_anew(structure, records):
    """Return the structure with its linear dynamics at starting values of their own, a few.

    What has been added since may have taken over what they had made up for.
    """
    if not _can_start_anew(structure, records) or not _dynamics(structure.operators):
        return []
    scene = Scene(structure, _undisturbed(structure, records))
    first = _first_dynamics(structure)
    return scene.promising(_started_anew(structure, scene, first), first)


def stage_anew(structure, records):
    """Return the structure with its last stage, which oscillates, identified from nothing.

    Friction and hysteresis inside an equation of motion have many minima. The model itself, with
    all of its law, looks for them thoroughly, which takes its time.
    """
    if not _can_start_anew(structure, records):
        return []
    scene = Scene(structure, _undisturbed(structure, records))
    at = len(structure.operators) - 1
    model = clone(structure.models[at])
    model.set_params(**model._complete)
    anew = model._identify(scene.records_at(at)).operator
    return [
        replace(
            structure,
            models=(*structure.models[:at], model),
            operators=(*structure.operators[:at], anew),
        )
    ]


def _can_start_anew(structure, records):
    return records[0].u.ndim == 1 and structure.schedule is None


def _dynamics(stages):
    """Return the places of the linear stages that have poles."""
    return [i for i, s in enumerate(stages) if isinstance(s, LinearOperator) and sum(s.n_poles)]


def _started_anew(structure, scene, first):
    """Return a structure with the poles that the signals suggest, in all ways to share them out.

    It is that of the scene before the place ``first``.
    """
    stages = structure.operators
    block = _dynamics(stages)
    n_poles = sum(sum((1, 2)[j] * n for j, n in enumerate(stages[i].n_poles)) for i in block)
    inputs = structure.run(scene.records, first=first, last=block[0], signals=scene.signals(first))
    data = [(u, r.y, r.dt) for u, r in zip(inputs, scene.records, strict=True)]
    found = []
    for poles in _distinct(pole_starts(data, n_poles)):
        for own in distribute_poles([stages[i] for i in block], poles):
            operators = list(stages)
            for i, operator in zip(block, own, strict=True):
                operators[i] = operator
            found.append(replace(structure, operators=tuple(operators)))
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


def _some(records):
    """Return every third of the rows that count, in each record."""
    rows, start = [], 0
    for record in records:
        own = np.concatenate([np.arange(a, b) for a, b in record.segments])
        rows.append(start + own[::_THINNED])
        start += len(record.u)
    return np.concatenate(rows)
