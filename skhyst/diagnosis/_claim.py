"""A claimed effect in the augmented model, and the signals for its evidence."""

import re
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..io import unit_of
from ..operators import Stage, SumOperator, bare
from ..records import Units


@dataclass(frozen=True)
class Seen:
    """Inputs and outputs of a part of the model, see ``_traits.characteristics``."""

    inputs: list
    outputs: list
    dts: list
    coefficients: np.ndarray | None = None

    @property
    def ends(self):
        """Smallest and largest value of the input."""
        return np.array([min(u.min() for u in self.inputs), max(u.max() for u in self.inputs)])

    @property
    def rates(self):
        """Absolute rates of the input, of all samples."""
        pairs = zip(self.inputs, self.dts, strict=True)
        return np.concatenate([np.abs(np.diff(u)) / dt for u, dt in pairs])


@dataclass(frozen=True)
class Claim:
    """A claimed effect in the augmented model, and the records.

    Attributes
    ----------
    effect : Effect
    structure : Tree
        The augmented model at its solution.
    result : IdentificationResult
        Of the augmented model, fitted on all records.
    records : sequence of RecordData
    columns : sequence of str
        Names of the columns of X; empty where they have none.
    words : Units
        Names and units of the signals of the recording.
    """

    effect: object
    structure: object
    result: object
    records: tuple
    columns: tuple
    words: Units

    def counted(self):
        """Return the claim with positions that the search has moved as parameters, with errors."""
        if not self.structure.moved:
            return self
        structure, result = self.structure.counted(self.result, self.records)
        return replace(self, structure=structure, result=result)

    @cached_property
    def edits(self):
        """The edits that put the effect into the model."""
        return self.structure.edits_of(self.effect.name)

    @property
    def kind(self):
        """The kind of the edits by which the effect entered."""
        kinds = {edit.kind for edit in self.edits}
        return kinds.pop() if len(kinds) == 1 else "scheduled stage"

    @cached_property
    def at(self):
        """The number of the stage that the effect is, or that it has changed."""
        return self.structure.place(self.effect.name)

    @cached_property
    def label(self):
        """The name of the stage or part that was added for the effect."""
        return self.structure.label(self.effect.name)

    @cached_property
    def is_part(self):
        """Whether the effect is one part of a sum of forces."""
        return self.structure.is_part(self.effect.name)

    @cached_property
    def operator(self):
        """The operator that the effect is, or is a part of; None if it is not an operator."""
        if self.kind in ("modulation", "schedule", "scheduled stage", "start"):
            return None
        if self.kind == "branch":
            whole, name = self._branches
            return whole.stages[whole.names.index(name)].operator
        return self.structure.part(self.effect.name)

    @property
    def _branches(self):
        """The sum that a branch is added in, and the name of the branch there."""
        if self._biases:
            whole = self.structure.part(self.effect.name)
            return whole, whole.names[-1]
        return self.structure.operator, self.label

    @property
    def _biases(self):
        """Whether the branch is added to the drive, not to the response."""
        return self.kind == "branch" and self.label in self.structure.names

    @property
    def in_motion(self):
        """Whether the operator is an equation of motion with forces as its parts."""
        return {"natural_frequency", "damping_ratio"} < set(self.operator.parameter_specs())

    @cached_property
    def not_new(self):
        """Parameters of the operator that do not belong to the effect."""
        if self.kind == "branch":
            return {"intercept"}
        old = set()
        if self.kind == "exchange":
            before = self.structure.without(self.effect.name)
            stage = before.operators[before.names.index(self.edits[0].place)]
            old = set(stage.parameter_specs()) - stage.held_entries()
        return {"gain", "intercept"} | old

    @cached_property
    def keys(self):
        """Identified parameters of the operator: short name -> name in the result."""
        structure, place = self.structure, self.edits[0].place
        mark = f"{self.label}__"
        if self._biases:
            mark += f"{self._branches[1]}__"
        if place and not self.is_part:
            mark = f"{place}__"
        elif self.label in structure.disturbance_names:
            mark = f"disturbance{structure.disturbance_names.index(self.label)}__"
        marked = {key: re.split(f"(?:^|__){mark}", key, maxsplit=1) for key in self.result.params}
        found = {parts[1]: key for key, parts in marked.items() if len(parts) == 2}
        if not found and self.kind == "exchange":  # a single model has no names of stages
            own = {key.removeprefix("model__"): key for key in self.result.params}
            found = {short: key for short, key in own.items() if "__" not in short}
        known = {name for name, _ in self.operator.entries()}  # others vary with the record
        return {short: key for short, key in found.items() if short in known}

    @cached_property
    def values(self):
        """The identified parameters of the operator: name -> (value, standard error)."""
        params, std = self.result.params, self.result.params_std
        return {short: (params[key], std[key]) for short, key in self.keys.items()}

    def covariance(self, names):
        """Return the covariance of some of the identified parameters of the operator."""
        if self.result.covariance is None:
            return np.diag([self.values[name][1] ** 2 for name in names])
        at = [list(self.result.params).index(self.keys[name]) for name in names]
        return self.result.covariance[np.ix_(at, at)]

    @cached_property
    def units(self):
        """Units of the operator's input and output: "drive", "response" or a column's unit.

        Stages before the one that owns the gain are in units of the drive, those behind it in units
        of the response.
        """
        if self.kind == "branch":
            return self.column_unit, "drive" if self._biases else "response"
        if self.kind == "additive":
            return "drive", "response"
        operators = self.structure.operators
        owners = [i for i, o in enumerate(operators) if o.owns_gain]
        shared = [any(spec.is_shared for _, spec in o.entries()) for o in operators]
        owners = owners or np.flatnonzero(shared).tolist()
        owner = max(owners, default=len(operators) - 1)
        return tuple(
            "drive" if before else "response" for before in (self.at <= owner, self.at < owner)
        )

    # ------------------------------------------------------------------ values per record

    @cached_property
    def column(self):
        """The number of the column of X that drives, scales or schedules; or "amplitude"."""
        return getattr(self.edits[-1], "by" if self.kind.startswith("schedule") else "column")

    @property
    def column_name(self):
        """The name of that column, or the description of the amplitude."""
        if self.column == "amplitude":
            return "half range of the drive in a record"
        return str(self.columns[self.column]) if len(self.columns) else f"column {self.column}"

    @property
    def column_unit(self):
        """The unit of that column: from its name, or else the name itself."""
        amplitude = self.column == "amplitude"
        return "drive" if amplitude else unit_of(self.column_name) or self.column_name

    def in_column(self):
        """Return that column of each record."""
        if self.column == "amplitude":
            return [np.full(len(r.u), 0.5 * np.ptp(r.u)) for r in self.records]
        return [record.auxiliary[:, self.column - 1] for record in self.records]

    def stage_at(self, number):
        """Return the stage with its parameters for a record of this schedule value."""
        return self.structure.stages_at(number)[self.at].operator

    # ------------------------------------------------------------------ signals, one array per
    # record

    @cached_property
    def seen(self):
        """The inputs and outputs of the operator."""
        dts = [record.dt for record in self.records]
        if self.kind == "additive":
            inputs = [record.u for record in self.records]
            return Seen(inputs, self.measured, dts, self._coefficients(self.operator))
        if self.kind == "branch":
            return Seen(self.in_column(), self.measured, dts)
        outputs = self.structure.run(self.records, last=self.at + 1)
        return Seen(self.inputs(), self.measured if self.is_part else outputs, dts)

    def _coefficients(self, disturbance):
        """Return the coefficients of a disturbance for each record, (n_records, n_coefficients)."""
        others = self.structure.disturbances
        sizes = [np.size(other.coefficients) for other in others]
        at = next(i for i, other in enumerate(others) if other is disturbance)
        return self.result.record_coefficients[:, sum(sizes[:at]) :][:, : sizes[at]]

    def course(self, disturbance):
        """Return a disturbance over the time of each record."""
        pairs = zip(self.records, self._coefficients(disturbance), strict=True)
        return [disturbance.basis(r.dt * np.arange(len(r.u))) @ own for r, own in pairs]

    @cached_property
    def measured(self):
        """The response of each record without the additive disturbances."""
        found = [np.array(record.y) for record in self.records]
        for disturbance in self.structure.disturbances:
            for y, own in zip(found, self.course(disturbance), strict=True):
                y -= own
        return found

    @cached_property
    def modelled(self):
        """The response of the driven part to each record."""
        return self.structure.respond(self.records)

    def inputs(self):
        """Return the input of the stage in each record; with several columns, the drive."""
        found = self.structure.run(self.records, last=self.at)
        return [u if u.ndim == 1 else u[:, 0] for u in found]

    @cached_property
    def rest(self):
        """The model without the effect: without its stage, its part of a sum, or its dependence.

        For a start in motion, the same model at rest before each record.
        """
        structure = self.structure
        if self.kind == "start":
            return replace(structure, input_history=())
        if self.kind in ("branch", "modulation", "schedule"):
            return structure.without(self.effect.name)
        if self.is_part:
            stage = structure.operators[self.at]
            parts = [Stage(n, bare(own)) for n, own in stage.members() if n != self.label]
            forces = SumOperator.of_parts(parts)
            return structure.with_stage(self.at, operator=forces)
        return structure.cut(structure.names[self.at])

    @cached_property
    def without(self):
        """The response of the model without the effect."""
        return self.rest.respond(self.records)

    def model_residuals(self, without):
        """Return the residual of a model, of the measurement and of the full model's response."""
        return (
            [y - x for y, x in zip(self.measured, without, strict=True)],
            [y - x for y, x in zip(self.modelled, without, strict=True)],
        )

    def without_effect(self):
        """Return the response without the effect, and its residuals; see :meth:`lacking`.

        Where the effect owns the gain of the series, the response is scaled by a fitted straight
        line.
        """
        without = self.without
        if self.structure.operators[self.at].owns_gain and not self.is_part:
            x, y = np.concatenate(without), np.concatenate(self.measured)
            slope, constant = np.polyfit(x, y, 1)
            without = [slope * part + constant for part in without]
        return without, *self.model_residuals(without)
