"""Edits of a tree: the changes of a model by which an effect enters it.

Each is a function from a tree to a tree, ``edit(tree, name)``; the added part is called ``name``.
It holds the operators at their starting values and no data, so that it can be applied to another
tree.
"""

from dataclasses import dataclass, fields, replace
from itertools import count

import numpy as np
from sklearn.base import clone

from .._validation import common_parameter
from ..compose import Cascade, Modulated, OnColumn, Sum
from ..linear import Gain, GainOperator
from ..operators import (
    OnColumnOperator,
    Scaled,
    Series,
    Stage,
    SumOperator,
    add_parallel,
    modulated,
    of_columns,
    on_column,
    scheduled,
)
from ._traits import elastic_and_memory

# parameters that an enriched stage keeps
_KEPT = {"drive", "dt", "fit_intercept", "hold", "initial_state", "mass", "method"}


class _Edit:
    place = None  # name of the stage that is edited


@dataclass(frozen=True)
class Insert(_Edit):
    """One more stage in the series, at the place of its stage order."""

    model: object
    operator: object
    kind = "stage"

    def __call__(self, tree, name):
        stages = list(tree.stages)
        at = tree.position(self.model.stage_order)
        stages.insert(at, Stage(name, self.model.tree(self.operator)))
        return tree.with_stages(stages)


@dataclass(frozen=True)
class InsertAt:
    """One more stage at a joint of the series: behind a stage, or before all of them (None)."""

    place: str | None
    model: object
    operator: object
    kind = "stage"

    def __call__(self, tree, name):
        stages = list(tree.stages)
        at = 0 if self.place is None else tree.names.index(self.place) + 1
        stages.insert(at, Stage(name, self.model.tree(self.operator)))
        return tree.with_stages(stages)


def _with_sum(tree, at, parts):
    """Return the tree with a stage as a sum of parts, which begins records as the stage did."""
    options = {key: common_parameter(tree.models[at], key) for key in ("initial_state", "dt")}
    total = Sum([], **options)
    return tree.with_stage(at, SumOperator.of_parts(parts, total).normalized())


@dataclass(frozen=True)
class BehindMemory:
    """One more stage behind the internal memory of a hysteresis, not behind its elastic part."""

    place: str
    model: object
    operator: object
    kind = "memory"

    def __call__(self, tree, name):
        at = tree.names.index(self.place)
        gain, memory = elastic_and_memory(tree.operators[at])
        inner = clone(tree.models[at]).set_params(fit_gain=False)
        parts = inner.tree(memory), self.model.tree(self.operator)
        behind = Series((self.place, name), parts, model=Cascade([]))
        elastic = Stage("elastic", Gain(fit_intercept=False).tree(GainOperator(gain)))
        return _with_sum(tree, at, [elastic, Stage("memory", behind)])


@dataclass(frozen=True)
class Divide:
    """A linear stage becomes two, with one more stage in between."""

    place: str
    model: object
    operators: tuple  # of the first part, of the stage in between, and of the second part
    kind = "stage"

    def __call__(self, tree, name):
        stages, at = list(tree.stages), tree.names.index(self.place)
        whole, (first, between, second) = tree.models[at], self.operators
        behind = next(new for i in count(2) if (new := f"{self.place}_{i}") not in tree.names)
        stages[at : at + 1] = [
            Stage(self.place, whole.resolved(first).tree(first)),
            Stage(name, self.model.tree(between)),
            Stage(behind, whole.resolved(second).tree(second)),
        ]
        return tree.with_stages(stages)


@dataclass(frozen=True)
class Enrich:
    """A stage is replaced by a richer model; options that it was enriched with before are kept."""

    place: str
    model: object
    operator: object
    kind = "exchange"

    def __call__(self, tree, name):
        at = tree.names.index(self.place)
        model, operator = tree.models[at], tree.operators[at]
        if type(model) is type(self.model):
            both = both_models(model, self.model)
            return tree.with_stage(at, both.tree(_both_operators(operator, self.operator)))
        kept = {key: value for key, value in model.get_params().items() if key in _KEPT}
        if kept.get("hold") not in getattr(self.operator, "holds", ()):
            kept.pop("hold", None)
        richer, field_names = clone(self.model), {f.name for f in fields(self.operator)}
        richer.set_params(**{key: kept[key] for key in kept.keys() & richer.get_params()})
        hold = {key: kept[key] for key in {"hold"} & kept.keys() & field_names}
        return tree.with_stage(at, richer.tree(replace(self.operator, **hold)))


@dataclass(frozen=True)
class ScaleEntries:
    """Parameters of the first stage are scaled by a column of X, see ``Modulated``."""

    place: str
    column: int
    reference: float
    scales: tuple
    magnitude: bool = False
    kind = "exchange"

    def __call__(self, tree, name):
        at = tree.names.index(self.place)
        stage, options = tree.stages[at], {"magnitude": self.magnitude}
        scales = "thresholds" if self.scales == ("thresholds",) else list(self.scales)
        model = Modulated(stage.model, self.column, scales=scales, **options)
        scaled = of_columns(stage.operator)
        operator = Scaled(scaled, self.column, self.reference, scales=self.scales, **options)
        return tree.with_stage(at, model.tree(operator))


@dataclass(frozen=True)
class Hold:
    """Another hold: the assumed course of the drive between its samples, see ``LinearModel``."""

    place: str
    hold: str
    kind = "exchange"

    def __call__(self, tree, name):
        at = tree.names.index(self.place)
        model = clone(tree.models[at]).set_params(hold=self.hold)
        return tree.with_stage(at, model.tree(replace(tree.operators[at], hold=self.hold)))


def both_models(model, other):
    """Return a model with the options of two of one class: flags of either, higher degrees."""
    old, new = model.get_params(), other.get_params()
    more = {
        name: max(value, new[name])
        for name, value in old.items()
        if name not in _KEPT and (type(value) is bool or name.endswith("_degree"))
    }
    return clone(model).set_params(**more)


def _both_operators(operator, other):
    """Return an operator with the fields of two of one class.

    Those of ``other``, unless they are shorter arrays, or zero.
    """
    changes = {}
    for field in fields(other):
        if field.kw_only:  # fields of the tree, not of the law
            continue
        old, new = getattr(operator, field.name), getattr(other, field.name)
        if np.size(old) > np.size(new) or (np.size(old) == np.size(new) and not np.any(new)):
            changes[field.name] = old
    return replace(other, **changes)


@dataclass(frozen=True)
class AddForce:
    """One more force in parallel with those of a stage, with the same input."""

    place: str
    model: object
    operator: object
    kind = "force"

    def __call__(self, tree, name):
        at = tree.names.index(self.place)
        forces = [tree.stages[at]]
        if isinstance(forces[0].operator, SumOperator):
            forces = forces[0].operator.members()
        forces.append(Stage(name, self.model.tree(self.operator)))
        return _with_sum(tree, at, forces)


@dataclass(frozen=True)
class AddDisturbance(_Edit):
    """An additive disturbance, in parallel with the driven part."""

    model: object
    operator: object
    kind = "additive"

    def __call__(self, tree, name):
        disturbance = self.model.tree(self.operator)
        return tree.composed(add_parallel(tree.whole, name, disturbance))


@dataclass(frozen=True)
class Drive(_Edit):
    """A model driven by a further column of X, whose output is added to the response."""

    model: object
    operator: object
    column: int
    kind = "branch"

    def __call__(self, tree, name):
        branch = on_column(tree.whole, self.model.tree(self.operator), self.column)
        return tree.composed(add_parallel(tree.whole, name, branch))


@dataclass(frozen=True)
class Bias(_Edit):
    """A model driven by a further column of X, whose output is added to the drive."""

    model: object
    operator: object
    column: int
    reference: float
    kind = "branch"

    def __call__(self, tree, name):
        column = OnColumn(self.model, self.column, centered=self.reference != 0.0)
        model = Sum([("drive", Gain(fit_intercept=False)), ("column", column)])
        branch = OnColumnOperator(self.operator, self.column, self.reference)
        parts = OnColumnOperator(GainOperator(1.0), 0), branch
        operator = SumOperator(("drive", "column"), parts)
        return tree.with_stages([Stage(name, model.tree(operator)), *tree.stages])


@dataclass(frozen=True)
class Begin(_Edit):
    """A drive before each record, for records that do not begin at rest."""

    input_history: tuple
    kind = "start"

    def __call__(self, tree, name):
        model = clone(tree.root.model).set_params(initial_state="estimate")
        return replace(tree, root=replace(tree.root, model=model), input_history=self.input_history)


@dataclass(frozen=True)
class Modulate(_Edit):
    """The response to the drive is scaled by a column of X, or by the "amplitude"."""

    column: int | str
    reference: float
    lag: object = None
    kind = "modulation"

    def __call__(self, tree, name):
        return tree.composed(modulated(tree.whole, self.column, self.reference, lag=self.lag))


@dataclass(frozen=True)
class Schedule(_Edit):
    """Parameters are straight lines in a value per record: a column of X, or the amplitude.

    ``which`` is "dynamics", "all", or the values at ``low`` and at ``high`` of entries of the stage
    that is named after the effect.
    """

    by: int | str
    low: float
    high: float
    which: object
    kind = "schedule"

    def __call__(self, tree, name):
        if self.which in ("dynamics", "all"):
            values = tree.values
            lines = {key: np.repeat(values[key], 2) for key in self.entries(tree, self.which)}
        else:
            lines = {(name, entry): line for entry, line in self.which.items()}
        return tree.composed(scheduled(tree.whole, self.by, self.low, self.high, lines))

    @staticmethod
    def entries(tree, which):
        """Return the entries of the series that may vary with the record.

        For "all" none if only intercepts are free, or only what "dynamics" already names.
        """
        free, dynamics = [], []
        is_free = iter(tree.series().free_mask())
        for name, operator in tree.stages:
            dynamic = operator.signal_linear and sum(operator.n_poles)
            for entry, spec in operator.entries():
                if next(is_free):
                    free.append((name, entry))
                    if dynamic and not spec.linear:
                        dynamics.append((name, entry))
        if which == "dynamics":
            return dynamics
        others = {entry for _, entry in free} - {"intercept"}
        return free if len(free) > len(dynamics) and others else []
