"""The series inside a composition, its replacement, and what can be put around it or beside it.

A composition is a model and an operator of the same structure. However deep it is nested, one part
of it follows the drive: a series of named stages. What follows reads that series, or puts another
one in its place, and leaves everything around it as it is.
"""

import re
from dataclasses import replace
from functools import singledispatch
from typing import Any, NamedTuple

import numpy as np

from ..base import with_params
from ..operators import Operator, SeriesOperator, SumOperator
from ._cascade import Cascade
from ._columns import ColumnOperator, Modulated, ModulatedOperator, OnColumn
from ._scheduled_parameters import ScheduledOperator, ScheduledParameters
from ._sum import Sum

_DRIVEN = "model"  # name of what follows the drive, where that is several models
_AROUND = (Sum, Modulated, OnColumn, ScheduledParameters)  # a series, from outside to inside


class Stage(NamedTuple):
    """A part of a composition: its name, its unfitted model and its operator."""

    name: str
    model: Any
    operator: Operator


def snake_case(name) -> str:
    """Return ``PrandtlIshlinskii`` as ``prandtl_ishlinskii``."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()


def series_stages(whole):
    """Return the stages of the series that follows the drive.

    Parameters
    ----------
    whole : Stage
        A composition: its unfitted model, and its operator without what stands beside it. Without a
        name (None), a single model goes by that of its class.

    Returns
    -------
    list of Stage
        The steps of a Cascade; a single model is one stage of its own.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.compose import Modulated, Stage, series_stages
    >>> from skhyst.linear import FirstOrderLag
    >>> X = np.random.default_rng(0).normal(size=(100, 2))
    >>> model = Modulated(FirstOrderLag()).fit(X, 0.5 * np.cumsum(X[:, 0]))
    >>> [stage.name for stage in series_stages(Stage(None, model, model.operator_))]
    ['first_order_lag']
    """
    while (part := _inside(whole.model, whole)) is not None:
        whole = part
    return _steps(whole.model, whole)


def with_series_stages(whole, stages):
    """Return a composition with other stages in the series that follows the drive.

    A single model becomes a Cascade where there are several. Parameters that follow a number of the
    record do so by their names.
    """
    return _changed(whole, lambda part: _in_series(part.model, part, tuple(stages)), _AROUND)


def put_beside_series(whole, name, model, branch=None, column=None):
    """Return a composition with another model beside what follows the drive.

    That is a disturbance, which is no part of the operator, or what a further ``column`` of X
    drives, with ``branch`` as its operator.
    """
    options = {"initial_state": whole.model.initial_state, "dt": whole.model.dt}
    if not hasattr(whole.model, "steps") or _inside(whole.model, whole) is None:
        stages = series_stages(whole)
        own = stages[0].name if len(stages) == 1 else _DRIVEN
        total, parts = Sum([(own, whole.model)], **options), [whole._replace(name=own)]
    else:
        total, parts = whole.model, _parts(whole.model, whole.operator)
    if branch is None:
        return Stage(None, with_params(total, steps=[*total.steps, (name, model)]), _sum(parts))
    model = OnColumn(model, column, **options)
    return Stage(
        None, *_of_parts(total, [*parts, Stage(name, model, ColumnOperator(branch, column))])
    )


def modulated(whole, column, reference, sensitivity=0.0):
    """Return a composition with the response to the drive scaled by a column.

    ``column`` is its number, or ``"amplitude"``; see :class:`Modulated`.
    """
    number = -1 if column == "amplitude" else column

    def change(part):
        operator = ModulatedOperator(_of_columns(part), number, reference, sensitivity)
        return Stage(part.name, _wrapped(Modulated, part, column=column), operator)

    return _changed(whole, change, _AROUND[:1])


def scheduled(whole, by, low, high, lines):
    """Return a composition with entries that are straight lines in a number of the record.

    ``lines`` are the values at ``low`` and at ``high``, by name of the stage and of the entry.
    """

    def change(part):
        names, operator = _scheduled(part, low, high, lines)
        model = _wrapped(ScheduledParameters, part, by=by, parameters=names)
        return Stage(part.name, model, operator)

    return _changed(whole, change, _AROUND[:3])


def stage_values(whole, *, held=True):
    """Return the values of the operator by (name of the stage, name of the entry).

    Each is an array of one value, or of several where it follows a number of the record. Without
    ``held``, those of entries that are held because another stage has their freedom are left out.
    """
    found, operator = {}, whole.operator
    rows = zip(_keys(whole.model, whole), operator.pack(), operator.gauge_mask(), strict=True)
    for key, value, is_held in rows:
        if held or not is_held:
            found[key] = np.append(found.get(key, []), value)
    return found


def with_stage_values(whole, values):
    """Return a composition with values by (name of the stage, name of the entry), where it has any.

    What follows a number of the record in one of both only has its mean in the other.
    """
    keys, operator = _keys(whole.model, whole), whole.operator
    vector, held = operator.pack(), operator.gauge_mask()
    for key in set(keys) & set(values):
        rows = [i for i, own in enumerate(keys) if own == key and not held[i]]
        same = len(rows) == len(values[key])
        vector[rows] = values[key] if same else np.mean(values[key])
    return whole._replace(operator=operator.unpack(vector))


# ---------------------------------------------------------------------- what is inside of what


def _changed(whole, change, around):
    """Return a composition with a change of what is inside of classes of compositions."""
    part = _inside(whole.model, whole)
    if part is None or not isinstance(whole.model, around):
        return change(whole)
    new = _changed(part, change, around)
    return Stage(new.name, *_around(whole.model, whole, new))


@singledispatch
def _inside(model, whole):
    """Return the part of a composition that follows the drive, None where it is no composition."""


@_inside.register
def _(model: ScheduledParameters, whole):
    operator = whole.operator
    if operator.schedule is not None:
        return Stage(whole.name, model.estimator, operator.operator)
    counts = np.asarray(operator.degrees) + 1
    sums = np.add.reduceat(operator.coefficients, np.cumsum(counts) - counts)
    return Stage(whole.name, model.estimator, operator.base.unpack(sums / counts))


@_inside.register
def _(model: OnColumn, whole):
    if not model.column:
        return Stage(whole.name, model.estimator, whole.operator.operator)


@_inside.register
def _(model: Modulated, whole):
    operator = whole.operator.operator
    reads = model.estimator._reads_columns
    return Stage(whole.name, model.estimator, operator if reads else operator.operator)


@_inside.register
def _(model: Sum, whole):
    driven = [part for part in _parts(model, whole.operator) if not _column(part.model)]
    if len(driven) == 1:
        return driven[0]
    if driven and len(driven) < len(model.steps):
        return Stage(_DRIVEN, *_of_parts(with_params(model, steps=[]), driven))


@singledispatch
def _around(model, whole, part):
    """Return the model and the operator of a composition with another part inside."""


@_around.register
def _(model: ScheduledParameters, whole, part):
    lines = {key: own for key, own in stage_values(whole).items() if len(own) > 1}
    keys, held = _keys(part.model, part), part.operator.gauge_mask()
    free = [key for key, is_held in zip(keys, held, strict=True) if not is_held]
    values = dict(zip(keys, part.operator.pack(), strict=True))
    for key in set(lines) - set(free):  # the line of a gain goes to the stage that has it now
        line = lines.pop(key)
        owners = [other for other in free if other[1] == key[1] and other not in lines]
        if key in keys and len(owners) == 1 and line.mean():
            lines[owners[0]] = line * (values[owners[0]] / line.mean())
    names, operator = _scheduled(part, whole.operator.low, whole.operator.high, lines)
    return with_params(model, estimator=part.model, parameters=names), operator


@_around.register
def _(model: OnColumn, whole, part):
    return with_params(model, estimator=part.model), replace(whole.operator, operator=part.operator)


@_around.register
def _(model: Modulated, whole, part):
    return with_params(model, estimator=part.model), replace(
        whole.operator, operator=_of_columns(part)
    )


@_around.register
def _(model: Sum, whole, part):
    others = [own for own in _parts(model, whole.operator) if _column(own.model)]
    return _of_parts(model, [part, *others])


@singledispatch
def _steps(model, whole):
    """Return the stages of a series."""
    return [Stage(whole.name or snake_case(type(model).__name__), model, whole.operator)]


@_steps.register
def _(model: Cascade, whole):
    return [Stage(*step, own) for step, own in zip(model.steps, whole.operator.stages, strict=True)]


@singledispatch
def _in_series(model, whole, stages):
    """Return a series of other stages."""
    if len(stages) == 1:
        return stages[0]
    options = {"initial_state": model.initial_state, "dt": model.dt}
    return _in_series(Cascade([], **options), Stage(_DRIVEN, None, None), stages)


@_in_series.register
def _(model: Cascade, whole, stages):
    names, operators = (tuple(stage[i] for stage in stages) for i in (0, 2))
    series = SeriesOperator(names, operators).normalized()
    return Stage(whole.name, with_params(model, steps=[stage[:2] for stage in stages]), series)


@singledispatch
def _column(model):
    """Return the number of the column of X that drives a model, 0 for the drive itself."""
    return 0


_column.register(OnColumn, lambda model: model.column)


@singledispatch
def _keys(model, whole):
    """Return (name of the stage, name of the entry) for each value of an operator."""
    part = _inside(model, whole)
    if part is not None:
        return _keys(part.model, part)
    return [(s.name, entry) for s in _steps(model, whole) for entry, _ in s.operator.entries()]


@_keys.register
def _(model: ScheduledParameters, whole):
    part = _inside(model, whole)
    counts = np.asarray(whole.operator.degrees) + 1
    return [key for key, n in zip(_keys(part.model, part), counts, strict=True) for _ in range(n)]


@_keys.register
def _(model: Modulated, whole):
    part = _inside(model, whole)
    return [*_keys(part.model, part), ("scaled by", str(model.column))]


@_keys.register
def _(model: Sum, whole):
    part, found = _inside(model, whole), []
    if part is None:
        return [(whole.name or "sum", entry) for entry, _ in whole.operator.entries()]
    for own in _parts(model, whole.operator):
        if _column(own.model):
            found += [(own.name, entry) for entry, _ in own.operator.entries()]
        elif own.name == part.name:
            found += _keys(own.model, own)
        else:
            found += [(part.name, f"{own.name}__{entry}") for entry, _ in own.operator.entries()]
    return found


# ---------------------------------------------------------------------- pieces


def _wrapped(kind, part, **params):
    """Return a composition of the model of a part."""
    model = part.model
    return kind(model, initial_state=model.initial_state, dt=model.dt, **params)


def _parts(model, operator):
    """Return the parts of a sum but the disturbances, each with the operator of its own model."""
    beside = model._disturbance_names(0)
    steps = [step for step in model.steps if step[0] not in beside]
    wrapped = any(step._reads_columns for _, step in steps)
    return [
        Stage(name, step, own.operator if wrapped and not step._reads_columns else own)
        for (name, step), own in zip(steps, operator.stages, strict=True)
    ]


def _of_parts(model, parts):
    """Return the model and the operator of a sum of other parts and of its disturbances."""
    beside = model._disturbance_names(0)
    kept = [step for step in model.steps if step[0] in beside]
    return with_params(model, steps=[*(part[:2] for part in parts), *kept]), _sum(parts)


def _sum(parts):
    """Return the operator of a sum; beside one that reads columns the others read the first."""
    wrapped = any(part.model._reads_columns for part in parts)
    stages = tuple(_of_columns(part) if wrapped else part.operator for part in parts)
    return SumOperator(tuple(part.name for part in parts), stages).normalized()


def _of_columns(part):
    """Return the operator of a part, of the whole input."""
    return part.operator if part.model._reads_columns else ColumnOperator(part.operator, 0)


def _scheduled(part, low, high, lines):
    """Return the names of the entries that follow lines, and the operator."""
    entries, values = part.operator.entries(), part.operator.pack()
    own = [
        np.asarray(lines.get(key, [value]))
        for key, value in zip(_keys(part.model, part), values, strict=True)
    ]
    names = [name for (name, _), line in zip(entries, own, strict=True) if len(line) > 1]
    degrees = tuple(len(line) - 1 for line in own)
    return names, ScheduledOperator(part.operator, degrees, np.concatenate(own), low, high)
