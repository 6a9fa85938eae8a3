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
    """Inputs and outputs of a part of the model, by record; see ``_traits.characteristics``.

    ``coefficients`` are those of an additive disturbance, (n_records, n_coefficients).
    """

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
        """Return the claim with the positions that the search has moved as fitted parameters.

        Then they have standard errors.
        """
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
        """The number of the stage that was added for the effect, or that the effect has changed."""
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
        """The operator that was added or changed; None if the effect is no operator."""
        if self.kind in ("modulation", "schedule", "scheduled stage", "start"):
            return None
        if self.kind == "branch":
            whole, name = self._branches
            return whole.stages[whole.names.index(name)].operator
        return self.structure.part(self.effect.name)

    @property
    def _branches(self):
        """The sum that a branch was added to, and the name of the branch in it."""
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
        """Parameters of the operator that were in the model before the effect."""
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
        # names in the result end in "stage__entry", after the names of what the stage is part of
        structure, place = self.structure, self.edits[0].place
        mark = f"{self.label}__"
        if self._biases:
            mark += f"{self._branches[1]}__"
        if place and not self.is_part:
            mark = f"{place}__"
        elif self.label in structure.disturbance_names:
            mark = f"disturbance{structure.disturbance_names.index(self.label)}__"
        marked = {key: re.split(f"(?:^|__){mark}", key, maxsplit=1) for key in self.result.params}
        keys = {parts[1]: key for key, parts in marked.items() if len(parts) == 2}
        if not keys and self.kind == "exchange":  # a single model has no names of stages
            short_names = {key.removeprefix("model__"): key for key in self.result.params}
            keys = {short: key for short, key in short_names.items() if "__" not in short}
        own_entries = {name for name, _ in self.operator.entries()}  # others vary with the record
        return {short: key for short, key in keys.items() if short in own_entries}

    @cached_property
    def values(self):
        """The identified parameters of the operator: name -> (value, standard error)."""
        params, std = self.result.params, self.result.params_std
        return {short: (params[key], std[key]) for short, key in self.keys.items()}

    def covariance(self, names):
        """Return the covariance of some of the identified parameters of the operator."""
        if self.result.covariance is None:
            return np.diag([self.values[name][1] ** 2 for name in names])
        indices = [list(self.result.params).index(self.keys[name]) for name in names]
        return self.result.covariance[np.ix_(indices, indices)]

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
        # without an owner, the last stage with a shared gain stands for it, or the last of all
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
        """Return the stage's operator with the parameters at a schedule value."""
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
        disturbances = self.structure.disturbances
        # the coefficients of all disturbances stand side by side
        sizes = [np.size(other.coefficients) for other in disturbances]
        index = next(i for i, other in enumerate(disturbances) if other is disturbance)
        return self.result.record_coefficients[:, sum(sizes[:index]) :][:, : sizes[index]]

    def course(self, disturbance):
        """Return a disturbance at all samples, one array per record."""
        pairs = zip(self.records, self._coefficients(disturbance), strict=True)
        return [
            disturbance.basis(r.dt * np.arange(len(r.u))) @ coefficients
            for r, coefficients in pairs
        ]

    @cached_property
    def measured(self):
        """The response of each record without the additive disturbances."""
        responses = [np.array(record.y) for record in self.records]
        for disturbance in self.structure.disturbances:
            for y, course in zip(responses, self.course(disturbance), strict=True):
                y -= course
        return responses

    @cached_property
    def modelled(self):
        """The response of the driven part to each record."""
        return self.structure.respond(self.records)

    def inputs(self):
        """Return the input of the stage in each record; with several columns, the drive."""
        signals = self.structure.run(self.records, last=self.at)
        return [u if u.ndim == 1 else u[:, 0] for u in signals]

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
            parts = [Stage(n, bare(operator)) for n, operator in stage.members() if n != self.label]
            forces = SumOperator.of_parts(parts)
            return structure.with_stage(self.at, operator=forces)
        return structure.cut(structure.names[self.at])

    @cached_property
    def without(self):
        """The response of the model without the effect."""
        return self.rest.respond(self.records)

    def model_residuals(self, without):
        """Return the measured response and the full model's, each minus a response ``without``."""
        return (
            [y - x for y, x in zip(self.measured, without, strict=True)],
            [y - x for y, x in zip(self.modelled, without, strict=True)],
        )

    def without_effect(self):
        """Return the response without the effect, and the two :meth:`model_residuals` of it.

        Where the effect owns the gain of the series, the response is scaled by a fitted straight
        line.
        """
        without = self.without
        if self.structure.operators[self.at].owns_gain and not self.is_part:
            x, y = np.concatenate(without), np.concatenate(self.measured)
            slope, constant = np.polyfit(x, y, 1)
            without = [slope * part + constant for part in without]
        return without, *self.model_residuals(without)
