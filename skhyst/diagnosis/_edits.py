"""Edits of a tree: what putting an effect into a model does to it.

Each has ``apply(tree, name)``, which returns another tree; what is added is called ``name``. An
edit knows the operators to start from and no data, so that it can be done again on another tree.
"""

from dataclasses import dataclass, fields, replace

import numpy as np
from sklearn.base import clone

from ..base import informed
from ..compose import (
    ColumnOperator,
    OnColumn,
    Stage,
    Sum,
    modulated,
    put_beside_series,
    scheduled,
)
from ..linear import Gain, GainOperator
from ..operators import SumOperator

_KEPT = {"dt", "fit_intercept", "hold", "initial_state", "mass", "method"}  # of an enriched stage


class _Edit:
    place = None  # name of the stage that it changes


@dataclass(frozen=True)
class Insert(_Edit):
    """One more stage in the series, where its stage order says."""

    model: object
    operator: object
    kind = "stage"

    def apply(self, tree, name):
        stages = list(tree.stages)
        at = tree.position(self.model.stage_order)
        return tree.with_stages(
            [*stages[:at], Stage(name, self.model, self.operator), *stages[at:]]
        )


@dataclass(frozen=True)
class Enrich:
    """A stage becomes a richer one, or one that is as rich in what it was enriched by before."""

    place: str
    model: object
    operator: object
    kind = "exchange"

    def apply(self, tree, name):
        at = tree.names.index(self.place)
        _, model, operator = tree.stages[at]
        if type(model) is type(self.model):
            operator = _both_operators(operator, self.operator)
            return tree.with_stage(at, model=both_models(model, self.model), operator=operator)
        same = {key: value for key, value in model.get_params().items() if key in _KEPT}
        richer = clone(self.model)
        richer.set_params(**{key: same[key] for key in same.keys() & richer.get_params()})
        return tree.with_stage(at, model=richer, operator=self.operator)


@dataclass(frozen=True)
class Hold:
    """What a stage takes the drive to do between its samples, see ``LinearModel``."""

    place: str
    hold: str
    kind = "exchange"

    def apply(self, tree, name):
        at = tree.names.index(self.place)
        _, model, operator = tree.stages[at]
        model, operator = clone(model).set_params(hold=self.hold), replace(operator, hold=self.hold)
        return tree.with_stage(at, model=model, operator=operator)


def both_models(model, other):
    """Return a model that has what either of one class has: its flags, or the higher degree."""
    old, new = model.get_params(), other.get_params()
    more = {
        name: max(value, new[name])
        for name, value in old.items()
        if name not in _KEPT and (type(value) is bool or name.endswith("_degree"))
    }
    return clone(model).set_params(**more)


def _both_operators(operator, other):
    """Return an operator of one class that has what either has: the longer arrays, no zeros."""
    changes = {}
    for field in fields(other):
        old, new = getattr(operator, field.name), getattr(other, field.name)
        if np.size(old) > np.size(new) or (np.size(old) == np.size(new) and not np.any(new)):
            changes[field.name] = old
    return replace(other, **changes)


@dataclass(frozen=True)
class AddForce:
    """One more force beside those of a stage, of the same input."""

    place: str
    model: object
    operator: object
    kind = "force"

    def apply(self, tree, name):
        at = tree.names.index(self.place)
        stage = tree.stages[at]
        steps, names, parts = [(stage.name, stage.model)], (stage.name,), (stage.operator,)
        if isinstance(stage.operator, SumOperator):
            steps, names, parts = stage.model.steps, stage.operator.names, stage.operator.stages
        operator = SumOperator((*names, name), (*parts, self.operator)).normalized()
        return tree.with_stage(at, model=Sum([*steps, (name, self.model)]), operator=operator)


@dataclass(frozen=True)
class Beside(_Edit):
    """A disturbance beside what is driven."""

    model: object
    operator: object
    kind = "beside"

    def apply(self, tree, name):
        whole = put_beside_series(tree.whole, name, self.model)
        return tree.composed(whole, (*tree.disturbances, self.operator))


@dataclass(frozen=True)
class Drive(_Edit):
    """A model that a further column of X drives, whose output is added."""

    model: object
    operator: object
    column: int
    kind = "branch"

    def apply(self, tree, name):
        branch = self.operator, self.column
        return tree.composed(put_beside_series(tree.whole, name, self.model, *branch))


@dataclass(frozen=True)
class Bias(_Edit):
    """A model that a further column of X drives, whose output is added to the drive."""

    model: object
    operator: object
    column: int
    reference: float
    kind = "branch"

    def apply(self, tree, name):
        column = OnColumn(self.model, self.column, centered=True)
        model = Sum([("drive", Gain(fit_intercept=False)), ("column", column)])
        branch = ColumnOperator(self.operator, self.column, self.reference)
        parts = ColumnOperator(GainOperator(1.0), 0), branch
        operator = SumOperator(("drive", "column"), parts)
        return tree.with_stages([Stage(name, model, operator), *tree.stages])


@dataclass(frozen=True)
class Begin(_Edit):
    """The drive before each record, which does not begin at rest."""

    input_history: tuple
    kind = "start"

    def apply(self, tree, name):
        model = clone(tree.model).set_params(initial_state="estimate")
        return replace(tree, model=informed(model, tree.model), input_history=self.input_history)


@dataclass(frozen=True)
class Modulate(_Edit):
    """The response to the drive is scaled by a column of X, or by the "amplitude"."""

    column: int | str
    reference: float
    kind = "modulation"

    def apply(self, tree, name):
        return tree.composed(modulated(tree.whole, self.column, self.reference))


@dataclass(frozen=True)
class Schedule(_Edit):
    """Parameters are straight lines in a number of the record: a column of X, or the amplitude.

    ``which`` is "dynamics", "all", or the values of entries of the stage that goes by the name of
    the effect, at ``low`` and at ``high``.
    """

    by: int | str
    low: float
    high: float
    which: object
    kind = "schedule"

    def apply(self, tree, name):
        if self.which in ("dynamics", "all"):
            values = tree.values
            lines = {key: np.repeat(values[key], 2) for key in self.entries(tree, self.which)}
        else:
            lines = {(name, entry): line for entry, line in self.which.items()}
        return tree.composed(scheduled(tree.whole, self.by, self.low, self.high, lines))

    @staticmethod
    def entries(tree, which):
        """Return which entries of the series follow the record, none where it makes no sense."""
        free, dynamics = [], []
        masks = tree.series().gauge_mask().tolist()
        for stage in tree.stages:
            held = stage.model.held_parameters()
            moving = stage.operator.signal_linear and sum(stage.operator.n_poles)
            for entry, spec in stage.operator.entries():
                if not masks.pop(0) and entry not in held:
                    free.append((stage.name, entry))
                    if moving and not spec.linear:
                        dynamics.append((stage.name, entry))
        if which == "dynamics":
            return dynamics
        more = {entry for _, entry in free} - {"intercept"}
        return free if len(free) > len(dynamics) and more else []
