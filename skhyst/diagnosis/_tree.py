"""A model as a tree of operators, with the added effects as edits of that tree."""

from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import count

import numpy as np
from sklearn.base import clone

from .._validation import common_parameter
from ..base import informed, refine
from ..operators import (
    MovableOperator,
    Series,
    Stage,
    parts_with_resolution,
    same_places,
    series_stages,
    split_disturbances,
    stage_values,
    with_series_stages,
    with_stage_values,
)
from ..optimize import (
    OperatorProblem,
    VariableProjection,
    ages,
    as_of,
    constant_entries,
    estimate_input_history,
    input_history_of,
    record_with_history,
)
from ..records import RecordSlice
from ._constants import BRIEF, TOLERANCE
from ._edits import Divide, InsertAt
from ._shortened import are_long

BRIEFLY = VariableProjection(tolerance=TOLERANCE, max_evaluations=BRIEF)


def as_read(model, records):
    """Return the records as a model reads them: with its columns of X, and its schedule value.

    The given records have the drive as input, and further columns as auxiliary inputs.
    """
    ends = np.cumsum([len(r.u) for r in records]).tolist()
    starts = [0, *ends[:-1]]
    slices = [
        RecordSlice(number, slice(start, end), r.dt, 0.0, end - start)
        for number, (start, end, r) in enumerate(zip(starts, ends, records, strict=True))
    ]
    X = np.concatenate(
        [r.u[:, None] if r.auxiliary is None else np.c_[r.u, r.auxiliary] for r in records]
    )
    signal, schedule_values = model.operator_input(X, slices)
    if model.reads_columns:
        records = [replace(r, u=signal[s.rows]) for r, s in zip(records, slices, strict=True)]
    if any(value is not None for value in schedule_values):
        records = [replace(r, schedule=s) for r, s in zip(records, schedule_values, strict=True)]
    return records


@dataclass(frozen=True)
class Tree:
    """A model with the present values of its operators, and the edits that were applied to it.

    Attributes
    ----------
    root : Operator
        The tree of operators, with additive disturbances.
    columns : estimator
        A model with the names and the number of the columns of X.
    declared : Tree or None
        The tree before any edit; None where there is none.
    edits : tuple of (str, edit)
        Name of the effect, and the edit made for it, see ``_edits``.
    name : str or None
        Name of a single stage, if it is not the name of its class.
    input_history : tuple of ndarray of shape (n_values,) or (n_values, n_inputs)
        Drive before each record, see ``RecordData``, or starting values of the state for a model
        without a state of rest; empty if all records begin at rest.
    moved : tuple of str
        Names of the stages whose terms were moved to the positions that the data ask for. A fit
        holds these positions, but they are estimates and count as such.
    """

    root: object
    columns: object
    declared: object = None
    edits: tuple = ()
    name: str | None = None
    input_history: tuple = ()
    moved: tuple = ()

    @classmethod
    def of(cls, model, operator, disturbances=(), input_history=()):
        """Return the tree of a declared model, and its operator without additive disturbances."""
        root = model.tree((operator, disturbances))
        state = common_parameter(model, "initial_state")
        if root.model.get_params().get("initial_state", state) != state and state != "rest":
            # only the parts state it, and the parts of effects begin at rest
            root = replace(root, model=clone(root.model).set_params(initial_state=state))
        return cls(root, model, input_history=input_history)

    @classmethod
    def from_result(cls, model, result, input_history=()):
        """Return the tree of a declared model with its identification result."""
        return cls.of(model, result.operator, result.disturbances, input_history)

    def __setstate__(self, state):
        if "root" not in state:  # a file written before operators stored their models
            operator = state.pop("operator"), state.pop("disturbances")
            state["columns"] = state.pop("model")
            state["root"] = state["columns"].tree(operator)
        vars(self).update({f.name: state.get(f.name, f.default) for f in fields(self)})

    def __getstate__(self):
        return {field.name: vars(self).get(field.name) for field in fields(self)}

    @cached_property
    def model(self):
        """The unfitted model."""
        return informed(self.root.unfitted(), self.columns)

    @property
    def operator(self):
        """The operator, without additive disturbances."""
        return self._parts[0]

    @property
    def disturbances(self):
        """The additive disturbances."""
        return self._parts[1]

    @cached_property
    def _parts(self):
        return split_disturbances(self.root)

    # ------------------------------------------------------------------ parts

    @property
    def whole(self):
        """The root, and its name as a single stage."""
        return Stage(self.name, self.root)

    @cached_property
    def stages(self):
        """The stages of the series behind the drive."""
        return series_stages(self.whole)

    @property
    def names(self):
        """Names of the stages."""
        return tuple(stage.name for stage in self.stages)

    @property
    def models(self):
        """Unfitted models of the stages."""
        return tuple(stage.model for stage in self.stages)

    @property
    def operators(self):
        """Operators of the stages; scheduled parameters at their mean."""
        return tuple(stage.operator for stage in self.stages)

    @property
    def disturbance_names(self):
        """Names of the additive disturbances."""
        return self.root.disturbance_names

    @property
    def state(self):
        """State before each record, "rest" or "zero"."""
        return self.model.free_run_state

    @property
    def multi_input(self):
        """Whether the first stage has several inputs, so that no stage can precede it."""
        return bool(self.stages) and self.stages[0].operator.reads_columns

    @property
    def values(self):
        """Values of the operator by (name of the stage, name of the entry)."""
        return stage_values(self.whole)

    @property
    def lines(self):
        """Values of scheduled entries, at the least and at the largest schedule value."""
        return {key: tuple(values) for key, values in self.values.items() if len(values) > 1}

    @property
    def scaled_by(self):
        """Columns that scale the response, or "amplitude", as str."""
        return [column for place, column in self.values if place == "scaled by"]

    @property
    def follows_amplitude(self):
        """Whether a parameter depends on the amplitude of the record."""
        params = self.model.get_params().items()
        return any(k.split("__")[-1] in ("by", "column") and v == "amplitude" for k, v in params)

    def series(self):
        """Return the stages as one operator."""
        return Series(self.names, self.operators).normalized()

    def position(self, order):
        """Return the place in the series of a stage of this order; behind a bias of the drive.

        Stages that an edit has put at a joint of its own are not considered.
        """
        placed = {self.label(n) for n, edit in self.edits if isinstance(edit, InsertAt | Divide)}
        behind = [
            i + 1
            for i, (name, stage) in enumerate(self.stages)
            if name not in placed and stage.stage_order <= order
        ]
        biased = self.multi_input and not (self.declared or self).multi_input
        return max(behind, default=int(biased))

    # ------------------------------------------------------------------ effects

    @property
    def effects(self):
        """Names of the effects in the order in which they were added."""
        return tuple(dict.fromkeys(name for name, _ in self.edits))

    def edits_of(self, effect):
        """Return the edits of an effect."""
        return [edit for name, edit in self.edits if name == effect]

    @cached_property
    def _taken(self):
        """Names that parts of the model already have."""
        params = self.model.get_params().items()
        steps = {key.split("__")[-1] for key, value in params if hasattr(value, "fit")}
        return {*self.names, *self.disturbance_names, *steps}

    def label(self, effect):
        """Return the name of the part that is added for an effect: its own, if it is free."""
        taken = (self.declared or self)._taken
        if effect not in taken:
            return effect
        return next(f"{effect}_{i}" for i in count(2) if f"{effect}_{i}" not in taken)

    def place(self, effect):
        """Return the number of the stage that an effect is, or that it has changed."""
        edits = [edit for edit in self.edits_of(effect) if edit.kind != "stage"]
        places = [edit.place for edit in edits if edit.place]
        return self.names.index(places[0] if places else self.label(effect))

    def is_part(self, effect):
        """Whether an effect is one part of a sum of forces."""
        return any(edit.kind == "force" for edit in self.edits_of(effect))

    def part(self, effect):
        """Return the operator that an effect is, or is a part of."""
        label = self.label(effect)
        if label in self.disturbance_names:
            return self.disturbances[self.disturbance_names.index(label)]
        stage = self.operators[self.place(effect)]
        return stage.stages[stage.names.index(label)] if self.is_part(effect) else stage

    def edited(self, effect, *edits):
        """Return the tree with the edits of one more effect."""
        tree = self
        for edit in edits:
            tree = edit(tree, self.label(effect))
        added = tuple((effect, edit) for edit in edits)
        return replace(tree, declared=self.declared or self, edits=(*self.edits, *added))

    def composed(self, whole):
        """Return the tree with another root and its name."""
        return replace(self, name=whole.name, root=whole.operator)

    def with_operators(self, operator, disturbances):
        """Return the tree with other values of the operator and of its disturbances."""
        parts = operator, tuple(disturbances)
        return replace(self, root=self.model.tree(parts) if self.disturbances else operator)

    def with_stages(self, stages):
        """Return the tree with other stages in its series."""
        return self.composed(with_series_stages(self.whole, stages))

    def with_stage(self, at, operator):
        """Return the tree with another operator of a stage, which keeps its model."""
        stages = list(self.stages)
        if operator.model is None:
            operator = replace(operator, model=stages[at].operator.model)
        stages[at] = stages[at]._replace(operator=operator)
        return self.with_stages(stages)

    def cut(self, *names):
        """Return the tree without some stages; if all are linear, others take over their gain."""
        series = Series(self.names, self.operators)
        for name in names:
            series = series.without(name)
        return self.with_stages(series.series())

    def without(self, effect):
        """Return the declared tree with the edits of all other effects, at the present values.

        Edits of a stage that the effect had added are removed with it. A stage that an edit put
        behind that stage moves up.
        """
        tree = self.declared
        for name in self.effects:
            edits = [tree._moved_up(edit, self.names) for edit in self.edits_of(name)]
            if name != effect and all(edit.place in (None, *tree.names) for edit in edits):
                tree = tree.edited(name, *edits)
        moved = tuple(name for name in self.moved if name in tree.names)
        return replace(tree._at_values_of(self), moved=moved)

    def _moved_up(self, edit, names):
        """Return an edit at a joint, moved behind the nearest earlier stage of this tree."""
        if not isinstance(edit, InsertAt) or edit.place in (None, *self.names):
            return edit
        earlier = [name for name in names[: names.index(edit.place)] if name in self.names]
        return replace(edit, place=earlier[-1] if earlier else None)

    def _at_values_of(self, other):
        """Return the tree with the values of another, for entries of the same names."""
        other = other.cut(*(name for name in other.names if name not in self.names))
        # an entry may be held in the series only, where its neighbours share its freedom
        marks, known_stages = [spec.held for _, spec in other.series().entries()], {}
        for name, operator in other.stages:
            held, marks = np.split(marks, [operator.n_parameters])
            known_stages[name] = operator, held.astype(bool)
        values, stages = stage_values(other.whole, held=False), []
        # entries of the parts of a divided stage have the same names, but mean other poles
        divided = {edit.place for _, edit in other.edits if isinstance(edit, Divide)}
        divided -= {edit.place for _, edit in self.edits if isinstance(edit, Divide)}
        values = {key: value for key, value in values.items() if key[0] not in divided}
        for name, operator in self.stages:
            known, held = known_stages.get(name, (None, None))
            fixed = operator.held_entries()
            if _has_other_terms(operator, known):  # the resolution was raised since
                operator = _with_terms_of(operator, known)
            elif _are_equal(operator, known):
                held = held | [entry in fixed for entry, _ in known.entries()]
                operator = _with_values_of(operator, known, held)
            stages.append(Stage(name, operator))
            for entry in fixed:
                values.pop((name, entry), None)
        tree = self.with_stages(stages)
        if tree.input_history:
            tree = replace(tree, input_history=other.input_history)
        found = dict(zip(other.disturbance_names, other.disturbances, strict=True))
        starts = zip(tree.disturbance_names, tree.disturbances, strict=True)
        driven = with_stage_values(tree.whole, values)
        return tree.with_operators(driven, [found.get(name, start) for name, start in starts])

    # ------------------------------------------------------------------ as an operator

    @cached_property
    def held(self):
        """Names of the entries that are not free."""
        return self.model.held_parameters() | constant_entries(self.operator, self.disturbances)

    def records_with_history(self, records):
        """Return the records with their input history."""
        if not self.input_history:
            return records
        pairs = zip(records, self.input_history, strict=True)
        return [record_with_history(self.operator, record, history) for record, history in pairs]

    def read(self, records):
        """Return the records as the model reads them, with their input history."""
        return self._as_read(self.records_with_history(records))

    def _as_read(self, records):
        """Return the records unchanged if the model reads the drive alone; see :func:`as_read`."""
        reads_more = self.root.reads_columns or self.root.is_scheduled
        return as_read(self.model, records) if reads_more else records

    def problem(self, records):
        """Return the least-squares problem of all free parameters."""
        return OperatorProblem(
            self.operator,
            self.read(records),
            disturbances=self.disturbances,
            fixed=self.held,
            initial_state=self.state,
        )

    def at(self, problem, x):
        """Return the tree with the operators at ``x``."""
        tree = self.with_operators(*problem.unpack(x))
        # neither depends on the values
        cached = {name: vars(self)[name] for name in ("model", "held") if name in vars(self)}
        vars(tree).update(cached)
        return tree

    def n_further_estimates(self):
        """Return the number of estimates other than the unknowns of the problem.

        These are the coefficients of disturbances in each record, the positions that were moved,
        and the input history of one record.
        """
        additive = sum(np.size(disturbance.coefficients) for disturbance in self.disturbances)
        positions = sum(
            np.count_nonzero(~part.resolution.stays(part))  # also of terms of zero weight
            for name, operator in zip(self.names, self.operators, strict=True)
            if name in self.moved
            for _, part, _ in parts_with_resolution(operator)
            if part.resolution.holds_positions(part)
        )
        return int(additive + positions + sum(map(np.size, self.input_history[:1])))

    def _with_positions(self):
        """Return the tree with the moved positions of its terms as parameters."""
        tree = self
        for at in (at for at, name in enumerate(self.names) if name in self.moved):
            for number in range(len(parts_with_resolution(self.operators[at]))):
                # each replacement makes a new stage, in which the next part is looked up
                _, part, with_part = parts_with_resolution(tree.operators[at])[number]
                if part.resolution.holds_positions(part):
                    tree = tree.with_stage(at, with_part(MovableOperator.around(part, np.inf)))
        return tree

    def counted(self, result, records):
        """Return the tree with its moved positions as parameters, and its result with theirs."""
        tree = self.with_operators(result.operator, result.disturbances)._with_positions()
        options = {"fixed": tree.held, "initial_state": self.state}
        return tree, as_of(result, tree.operator, self.read(records), **options)

    def stages_at(self, schedule_value):
        """Return the stages with the parameters of a record of this schedule value."""
        if schedule_value is None:
            return self.stages
        return series_stages(self.whole._replace(operator=self.root.at(schedule_value)))

    def run(self, records, first=0, last=None, signals=None):
        """Return the output of stages ``first`` to before ``last`` of the series for each record.

        ``signals`` are the inputs of the first of them, by default those that the records give it.
        """
        outputs, records = [], self.records_with_history(records)
        for i, (record, read) in enumerate(zip(records, self._as_read(records), strict=True)):
            stages = [stage.operator for stage in self.stages_at(read.schedule)]
            if signals is not None:
                before = self._history_after(stages[:first], read)
                record = replace(record, u=signals[i], before=before)
            elif self.multi_input:
                record = read
            u, skip = record.with_history
            for stage in stages[first:last]:
                start = record.start if stage.n_start and record.start is not None else self.state
                u = stage.run(u, record.dt, stage.init(u[0], start))[0]
            outputs.append(u[skip:])
        return outputs

    def history_at(self, records, at):
        """Return the input history at a place of the series for each record, None where unknown."""
        histories = []
        for record in self.read(records):
            stages = [stage.operator for stage in self.stages_at(record.schedule)[:at]]
            histories.append(self._history_after(stages, record))
        return histories

    def _history_after(self, stages, record):
        """Return the input history behind some stages, None where unknown."""
        if record.before is None:
            return None
        u, skip = record.with_history
        u = u[:skip]
        for stage in stages:
            u = stage.run(u, record.dt, stage.init(u[0], self.state))[0]
        return u[-ages(record.before)]

    def respond(self, records):
        """Return the output of the driven part for each record."""
        problem = OperatorProblem(self.operator, self.read(records), initial_state=self.state)
        return [problem.simulate(self.operator, record) for record in problem.records]

    def with_estimated_history(self, records):
        """Return the tree with the input history of records estimated, the parameters held."""
        read = self._as_read(records)
        histories, _ = input_history_of(self.operator, self.disturbances, read)
        return replace(self, input_history=tuple(histories))

    # ------------------------------------------------------------------ as an estimator

    def identified(self, records):
        """Return the tree with its model identified from scratch, roughly, to be refitted."""
        result = self.estimator.set_params(method=BRIEFLY).identify(self.read(records))
        return replace(self, root=self.model.tree((result.operator, result.disturbances)))

    def with_input_history(self, records):
        """Return the tree refitted together with the input history of the records."""
        result, histories = estimate_input_history(
            self.operator,
            self.disturbances,
            self.read(records),
            fixed=self.held,
            method=BRIEFLY,
            with_errors=False,
        )
        tree = self.with_operators(result.operator, result.disturbances)
        return replace(tree, input_history=tuple(histories))

    @property
    def estimator(self):
        """The unfitted model."""
        return clone_of(self.model)

    def fitted(self, records, slices):
        """Return the model fitted on all records from the present values, and the result."""
        estimator = self.estimator
        # the search has already refitted these operators to the same records
        method = BRIEFLY if are_long(records) else None
        starts = [(self.operator, self.disturbances)]
        result = refine(estimator, starts, self.read(records), method)
        if self.moved:
            result = result.narrowed(self.counted(result, records)[1])
        estimator.records_ = slices
        if self.input_history:
            result = replace(result, input_history=np.array(self.input_history))
        estimator.adopt(result)
        return estimator, result


def clone_of(model):
    """Return a clone with the column names of a model."""
    return informed(clone(model), model)


def _has_other_terms(a, b):
    """Whether parts of two operators of one model differ in the number or positions of terms."""
    if type(a) is not type(b) or type(a.model) is not type(b.model):
        return False
    return any(
        old.resolution.of(old) != new.resolution.of(new) or not same_places(old, new)
        for _, old, new, _ in _shared_parts(a, b)
    )


def _shared_parts(a, b):
    """Return the parts with a resolution that both have: (prefix, of a, of b, replacement in a).

    The last is a function that returns ``a`` with another part in this place.
    """
    others = {prefix: part for prefix, part, _ in parts_with_resolution(b)}
    return [
        (prefix, part, others[prefix], with_part)
        for prefix, part, with_part in parts_with_resolution(a)
        if type(part) is type(others.get(prefix))
    ]


def _with_terms_of(a, b):
    """Return operator ``a`` with the terms of ``b``; members that ``b`` lacks are unchanged."""
    if getattr(a, "names", ()) == getattr(b, "names", ()):
        return replace(b, model=a.model.resolved(b))
    for i in range(len(_shared_parts(a, b))):
        _, part, other, with_part = _shared_parts(a, b)[i]  # of the present `a`
        a = with_part(replace(other, model=part.model.resolved(other)))
    return a


def _with_values_of(operator, other, held):
    """Return an operator with the values of another, except those held, which are its own."""
    values = np.where(held, operator.pack(), other.pack())
    # the fixed structure of the other one, too, but the present hold, which an edit may have set
    found, hold = (
        replace(other.unpack(values), model=operator.model),
        getattr(operator, "hold", None),
    )
    return found if getattr(found, "hold", None) == hold else replace(found, hold=hold)


def _are_equal(a, b):
    """Whether two operators are of one kind and have the same parameters."""
    return type(a) is type(b) and [n for n, _ in a.entries()] == [n for n, _ in b.entries()]
