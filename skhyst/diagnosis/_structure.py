"""A model as a list of stages, into which an effect can be put."""

import re
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
from sklearn.base import clone
from sklearn.frozen import FrozenEstimator

from ..base import informed
from ..compose import (
    Cascade,
    ColumnOperator,
    Modulated,
    ModulatedOperator,
    OnColumn,
    ScheduledOperator,
    ScheduledParameters,
    Sum,
    amplitude,
)
from ..operators import SeriesOperator, SumOperator
from ..optimize import OperatorProblem, VariableProjection, identify
from ._shortened import are_long

__all__ = ["Branch", "Schedule", "Structure", "snake_case"]

_BRIEFLY = VariableProjection(tolerance=1e-5, max_evaluations=4)
_DRIVEN = "model"  # name of the driven part, where something stands beside it


@dataclass(frozen=True)
class Branch:
    """A stage of its own that a further column of X drives; its output is added."""

    name: str
    model: object
    operator: object
    column: int


@dataclass(frozen=True)
class Modulation:
    """What scales the driven part, for an effect: a column of X, or the record's amplitude."""

    effect: str
    column: int | str
    reference: float
    sensitivity: float = 0.0


@dataclass(frozen=True)
class Schedule:
    """Which entries of the series are straight lines in a number of the record.

    ``by`` is "amplitude" or the number of a column of X; ``lines`` maps the name of an entry to
    its values at ``low`` and at ``high``.
    """

    by: object
    low: float
    high: float
    lines: dict

    def number(self, record):
        """Return the number of a record."""
        if self.by == "amplitude":
            return amplitude(record.u)
        return float(record.auxiliary[:, self.by - 1].mean())

    def applied(self, series):
        """Return the operator whose entries follow the schedule."""
        degrees, values = [], []
        for (name, _), value in zip(series.entries(), series.pack(), strict=True):
            line = self.lines.get(name)
            degrees.append(0 if line is None else 1)
            values += [value] if line is None else list(line)
        return ScheduledOperator(series, tuple(degrees), np.array(values), self.low, self.high)

    def taken(self, operator):
        """Return the schedule and the series at what identification made of :meth:`applied`."""
        lines, start, plain = {}, 0, operator.base.pack()
        for i, ((name, _), degree) in enumerate(
            zip(operator.base.entries(), operator.degrees, strict=True)
        ):
            own = operator.coefficients[start : start + degree + 1]
            plain[i] = own.mean()
            if degree:
                lines[name] = tuple(own)
            start += degree + 1
        return replace(self, lines=lines), operator.base.unpack(plain)


@dataclass(frozen=True)
class Structure:
    """Stages in series and what stands beside them, unfitted models and operators alike.

    Attributes
    ----------
    names, models, operators : tuple
        Of the stages, in the order of the signal.
    beside_names, beside_models, disturbances : tuple
        Of what is added to the response.
    state : {"rest", "zero"}
        State before each record.
    branches : tuple of Branch
    modulations : tuple of Modulation
        At most one for each column.
    schedule : Schedule or None
    added : tuple of (str, tuple)
        Effects in the order in which they were added, and what :meth:`without` needs to know: the
        kind of change, and for an exchange the model and the operator before it.
    places : tuple of (str, str)
        Effects that have changed a stage, and the name of that stage.
    labels : tuple of (str, str)
        Effects whose own name was taken, and the name of what was added for them.
    """

    names: tuple
    models: tuple
    operators: tuple
    beside_names: tuple = ()
    beside_models: tuple = ()
    disturbances: tuple = ()
    state: str = "rest"
    branches: tuple = ()
    modulations: tuple = ()
    schedule: Schedule | None = None
    added: tuple = ()
    places: tuple = ()
    labels: tuple = ()

    @classmethod
    def from_result(cls, estimator, result):
        """Take apart a declared model and what identification found for it."""
        if isinstance(estimator, ScheduledParameters):
            return cls._from_scheduled(estimator, result)
        if isinstance(estimator, Sum) and result.disturbances:
            return cls._from_sum(estimator, result)
        state = estimator._free_run_state()
        if isinstance(estimator, Cascade):
            names, models = zip(*estimator.steps, strict=True)
            return cls(names, models, result.operator.stages, state=state)
        name = snake_case(type(estimator).__name__)
        return cls((name,), (estimator,), (result.operator,), state=state)

    @classmethod
    def _from_sum(cls, estimator, result):
        """Take apart a model with disturbances beside what is driven."""
        steps, names = dict(estimator.steps), estimator._disturbance_names(len(result.disturbances))
        driven = [(name, model) for name, model in steps.items() if name not in names]
        operator = result.operator
        if len(driven) == 1:
            ((name, model),), (operator,) = driven, operator.stages
        else:
            name, model = _DRIVEN, clone(estimator).set_params(steps=driven)
        plain = cls.from_result(
            informed(model, estimator), replace(result, operator=operator, disturbances=())
        )
        if plain._stands_alone():
            plain = replace(plain, names=(name,))
        return replace(
            plain,
            beside_names=names,
            beside_models=tuple(steps[name] for name in names),
            disturbances=result.disturbances,
            state=estimator._free_run_state(),
        )

    @classmethod
    def _from_scheduled(cls, estimator, result):
        """Take apart a model whose parameters are straight lines in a number of the record."""
        operator, inner = result.operator, estimator.estimator
        plain = cls.from_result(inner, replace(result, operator=operator.base))
        by = estimator.by
        if by != "amplitude":
            by = estimator._column(estimator.n_features_in_)
        schedule = Schedule(by, operator.low, operator.high, {})
        base = replace(operator, base=SeriesOperator(plain.names, plain.operators))
        schedule, series = schedule.taken(base)
        return replace(
            plain,
            operators=series.stages,
            state=estimator._free_run_state(),
            schedule=schedule,
        )

    # ------------------------------------------------------------------ as an operator

    def series(self):
        """Return the stages as one operator."""
        return SeriesOperator(self.names, self.operators).normalized()

    def _driven(self, operator):
        """Return the driven part, from its stages as one operator."""
        if not (self.branches or self.modulations):
            return operator
        operator = ColumnOperator(operator, 0)
        for m in self.modulations:
            column = -1 if m.column == "amplitude" else m.column
            operator = ModulatedOperator(operator, column, m.reference, m.sensitivity)
        if not self.branches:
            return operator
        others = tuple(ColumnOperator(b.operator, b.column) for b in self.branches)
        names = (_DRIVEN, *(b.name for b in self.branches))
        return SumOperator(names, (operator, *others)).normalized()

    def driven(self):
        """Return the driven part as one operator, of the input that :meth:`inputs` gives."""
        series = self.series()
        return self._driven(self.schedule.applied(series) if self.schedule else series)

    def inputs(self, records):
        """Return the records as the driven part reads them."""
        if self.schedule is not None:
            records = [replace(r, schedule=self.schedule.number(r)) for r in records]
        if not (self.branches or self.modulations):
            return records
        found = []
        for record in records:
            columns = [record.u]
            if record.auxiliary is not None:
                columns.append(record.auxiliary)
            if "amplitude" in self.modulated_by():
                columns.append(np.full(len(record.u), amplitude(record.u)))
            found.append(replace(record, u=np.column_stack(columns)))
        return found

    def problem(self, records):
        """Return the least-squares problem of all free parameters."""
        before = f"{_DRIVEN}__" if self.branches else ""
        fixed = {
            f"{before}{name}__{entry}"
            for name, model in zip(self.names, self.models, strict=True)
            for entry in model.held_parameters()
        }
        fixed |= {
            f"{b.name}__{entry}" for b in self.branches for entry in b.model.held_parameters()
        }
        return OperatorProblem(
            self.driven(),
            self.inputs(records),
            disturbances=self.disturbances,
            fixed=fixed,
            initial_state=self.state,
        )

    def at(self, problem, x):
        """Return the structure with the operators at ``x``."""
        operator, disturbances = problem.unpack(x)
        branches, modulations, schedule = self.branches, [], self.schedule
        if branches:
            operator, *others = operator.stages
            branches = tuple(
                replace(b, operator=other.operator)
                for b, other in zip(branches, others, strict=True)
            )
        for modulation in reversed(self.modulations):
            modulations.insert(0, replace(modulation, sensitivity=operator.sensitivity))
            operator = operator.operator
        if branches or modulations:
            operator = operator.operator
        if schedule is not None:
            schedule, operator = schedule.taken(operator)
        return replace(
            self,
            operators=operator.stages,
            disturbances=disturbances,
            branches=branches,
            modulations=tuple(modulations),
            schedule=schedule,
        )

    def _stages(self, record):
        """Return the stages as they are in a record."""
        if self.schedule is None:
            return self.operators
        series = SeriesOperator(self.names, self.operators)  # an effect may have no gauge yet
        return self.schedule.applied(series).at(self.schedule.number(record)).operator.stages

    def run(self, records, first=0, last=None, signals=None):
        """Return the output of a stretch of the series for each record."""
        outputs = []
        for number, record in enumerate(records):
            own = replace(record, before=self.rest(record, first))
            if signals is not None:
                own = replace(own, u=signals[number])
            u, skip = own.with_history()
            for stage in self._stages(record)[first:last]:
                u = stage.run(u, record.dt, stage.init(u[0], self.state))[0]
            outputs.append(u[skip:])
        return outputs

    def rest(self, record, at):
        """Return what goes into a place of the series at rest before a record, None if unknown."""
        u = record.before
        if u is not None:
            for stage in self._stages(record)[:at]:
                u = float(stage.run(np.array([u]), record.dt, stage.init(u, self.state))[0][0])
        return u

    def respond(self, records):
        """Return the output of the driven part for each record."""
        if not (self.branches or self.modulations):
            return self.run(records)
        operator, outputs = self.driven(), []
        for record in self.inputs(records):
            own = operator if record.schedule is None else operator.at(record.schedule)
            u, skip = record.with_history()
            outputs.append(own.run(u, record.dt, own.init(u[0], self.state))[0][skip:])
        return outputs

    def n_coefficients(self):
        """Number of coefficients that each record has of its own."""
        return sum(np.size(disturbance.coefficients) for disturbance in self.disturbances)

    # ------------------------------------------------------------------ changes

    def position(self, rank):
        """Return where in the series a stage of this rank goes."""
        behind = [i + 1 for i, stage in enumerate(self.operators) if stage.rank <= rank]
        return max(behind, default=0)

    def place(self, effect):
        """Return the number of the stage that an effect is, or has changed."""
        return self.names.index(dict(self.places).get(effect, self.label(effect)))

    def label(self, effect):
        """Return the name of what was added for an effect."""
        return dict(self.labels).get(effect, effect)

    def is_part(self, effect):
        """Whether an effect is one part of a sum of forces."""
        stage = self.operators[self.place(effect)]
        return isinstance(stage, SumOperator) and self.label(effect) in stage.names

    def operator(self, effect):
        """Return the operator that an effect is, or has become a part of."""
        label = self.label(effect)
        if label in self.beside_names:
            return self.disturbances[self.beside_names.index(label)]
        stage = self.operators[self.place(effect)]
        return stage.stages[stage.names.index(label)] if self.is_part(effect) else stage

    def labelled(self, effect):
        """Return the structure that has a free name for what is added for an effect."""
        parts = [stage.names for stage in self.operators if isinstance(stage, SumOperator)]
        others = [b.name for b in self.branches]
        taken = {*self.names, *self.beside_names, *others, *(name for own in parts for name in own)}
        if effect not in taken:
            return self
        number = next(i for i in count(2) if f"{effect}_{i}" not in taken)
        return replace(self, labels=(*self.labels, (effect, f"{effect}_{number}")))

    def _with(self, effect, *change, **fields):
        return replace(self, added=(*self.added, (effect, change)), **fields)

    def insert(self, name, model, operator):
        """Return the structure with one more stage, where its rank says."""
        at, named = self.position(model.series_rank), self.labelled(name)
        return named._with(
            name,
            "stage",
            names=(*self.names[:at], named.label(name), *self.names[at:]),
            models=(*self.models[:at], model, *self.models[at:]),
            operators=_scaled_by_last((*self.operators[:at], operator, *self.operators[at:])),
        )

    def _cut(self, name):
        at = self.names.index(name)
        return replace(
            self,
            names=self.names[:at] + self.names[at + 1 :],
            models=self.models[:at] + self.models[at + 1 :],
            operators=_scaled_by_last(self.operators, without=at),
        )

    def exchange(self, effect, at, model, operator):
        """Return the structure with another model in the place of a stage."""
        old = self.models[at], self.operators[at]
        changed = self._put(at, model, operator)
        places = (*self.places, (effect, self.names[at]))
        return changed._with(effect, "exchange", *old, places=places)

    def _put(self, at, model, operator):
        return replace(
            self,
            models=(*self.models[:at], model, *self.models[at + 1 :]),
            operators=(*self.operators[:at], operator, *self.operators[at + 1 :]),
        )

    def beside(self, name, model, disturbance):
        """Return the structure with one more disturbance."""
        named = self.labelled(name)
        return named._with(
            name,
            "beside",
            beside_names=(*self.beside_names, named.label(name)),
            beside_models=(*self.beside_models, model),
            disturbances=(*self.disturbances, disturbance),
        )

    def branch(self, name, model, operator, column):
        """Return the structure with one more branch."""
        named = self.labelled(name)
        new = Branch(named.label(name), model, operator, column)
        return named._with(name, "branch", branches=(*self.branches, new))

    def modulated(self, effect, column, reference):
        """Return the structure whose driven part is scaled by one more column."""
        new = Modulation(effect, column, reference)
        return self._with(effect, "modulation", modulations=(*self.modulations, new))

    def modulated_by(self):
        """Return the columns that scale the driven part."""
        return [modulation.column for modulation in self.modulations]

    def scheduled(self, effect, schedule):
        """Return the structure whose parameters depend on the record."""
        return self._with(effect, "schedule", schedule=schedule)

    def inserted_by_record(self, name, model, operator, schedule):
        """Return the structure with one more stage, whose parameters depend on the record."""
        changed = replace(self.insert(name, model, operator), schedule=schedule)
        return replace(changed, added=(*self.added, (name, ("scheduled stage",))))

    def removable(self):
        """Return the effects that can be taken out again."""
        stages = [place for _, place in self.places]
        last = {place: effect for effect, place in self.places}  # of several on one stage
        return [
            name
            for name, _ in self.added
            if name not in dict(self.places)
            or stages.count(dict(self.places)[name]) == 1
            or last[dict(self.places)[name]] == name
        ]

    def without(self, effect):
        """Return the structure without an effect that was added."""
        kind, *old = dict(self.added)[effect]
        label = self.label(effect)
        rest = replace(
            self,
            added=tuple(entry for entry in self.added if entry[0] != effect),
            labels=tuple(entry for entry in self.labels if entry[0] != effect),
        )
        if kind == "stage":
            return rest._cut(label)
        if kind == "scheduled stage":
            return replace(rest._cut(label), schedule=None)
        if kind == "exchange":
            places = tuple(place for place in self.places if place[0] != effect)
            return replace(rest._put(self.place(effect), *old), places=places)
        if kind == "branch":
            return replace(rest, branches=tuple(b for b in self.branches if b.name != label))
        if kind == "beside":
            kept = [i for i, name in enumerate(self.beside_names) if name != label]
            return replace(
                rest,
                beside_names=tuple(self.beside_names[i] for i in kept),
                beside_models=tuple(self.beside_models[i] for i in kept),
                disturbances=tuple(self.disturbances[i] for i in kept),
            )
        if kind == "modulation":
            kept = tuple(m for m in self.modulations if m.effect != effect)
            return replace(rest, modulations=kept)
        return replace(rest, schedule=None)

    # ------------------------------------------------------------------ as an estimator

    def _stands_alone(self):
        """Whether the series is one model without a Cascade, which one that is held needs."""
        return len(self.models) == 1 and not isinstance(self.models[0], FrozenEstimator)

    def estimator(self, declared):
        """Return the unfitted model: the declared one with what was added."""
        models = [clone(model) for model in self.models]
        options = {"initial_state": declared.initial_state, "dt": declared.dt}
        if self._stands_alone():
            name, driven = self.names[0], models[0]
        else:
            name = _DRIVEN
            driven = Cascade(list(zip(self.names, models, strict=True)), **options)
        if self.schedule is not None:
            strip = len(f"{name}__") if self._stands_alone() else 0
            driven = ScheduledParameters(
                driven,
                by=self.schedule.by,
                parameters=[entry[strip:] for entry in self.schedule.lines],
                **options,
            )
        for column in self.modulated_by():
            driven = Modulated(driven, column, **options)
        if not (self.beside_models or self.branches):
            return driven
        others = [(b.name, OnColumn(clone(b.model), b.column, **options)) for b in self.branches]
        beside = zip(self.beside_names, self.beside_models, strict=True)
        others += [(own, clone(model)) for own, model in beside]
        return Sum([(_DRIVEN if self.branches else name, driven), *others], **options)

    def fitted(self, declared, records, slices):
        """Return the model, fitted on all records from the operators here."""
        estimator = self.estimator(declared)
        schedule, operator = self.schedule, self.series()
        if self._stands_alone():
            operator = self.operators[0]
            if schedule is not None:
                strip = len(f"{self.names[0]}__")
                lines = {entry[strip:]: line for entry, line in schedule.lines.items()}
                schedule = replace(schedule, lines=lines)
        operator = self._driven(schedule.applied(operator) if schedule else operator)
        if self.beside_models and not self.branches:
            operator = SumOperator((estimator.steps[0][0],), (operator,))
        result = identify(
            [(operator, self.disturbances)],
            self.inputs(records),
            fixed=estimator.held_parameters(),
            initial_state=self.state,
            # the search has refitted these operators to the same records already
            method=_BRIEFLY if are_long(records) else "variable_projection",
        )
        estimator.records_ = slices
        if records[0].before is not None:
            estimator.initial_drive_ = np.array([record.before for record in records])
        estimator._adopt(result)
        return estimator, result


def _scaled_by_last(operators, without=None):
    """Return a series with its static gain and intercept on the last linear stage.

    That one keeps them where no stage carries a scale of its own; all others are held at one and
    zero. Behind a saturation the gain is no linear parameter, which would be solved for anyway.

    Parameters
    ----------
    operators : tuple of Operator
    without : int, optional
        Stage to leave out; the others take over its gain.
    """
    kept = [i for i in range(len(operators)) if i != without]
    scaled = [i for i, operator in enumerate(operators) if operator.gauge_entries().any()]
    between = operators[scaled[0] : scaled[-1] + 1] if scaled else ()
    owner = max(set(scaled) & set(kept), default=None)
    if (
        owner is None
        or any(operator.carries_scale for operator in operators)
        or not all(operator.signal_linear for operator in between)
        or not all({"gain", "intercept"} <= set(operators[i].sizes()) for i in scaled)
    ):
        return tuple(operators[i] for i in kept)
    gain, intercept = 1.0, 0.0
    for i in scaled:
        gain *= operators[i].gain
        intercept = operators[i].gain * intercept + operators[i].intercept
    own = dict.fromkeys(scaled, (1.0, 0.0)) | {owner: (gain, intercept)}
    return tuple(
        replace(operators[i], gain=own[i][0], intercept=own[i][1]) if i in own else operators[i]
        for i in kept
    )


def snake_case(name):
    """Return ``PrandtlIshlinskii`` as ``prandtl_ishlinskii``."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()
