"""Edits: functions from the tree of a model to a tree.

However deeply it is nested, one part of a tree is driven by the drive: a series of named stages.
These functions read that series, or replace it, and leave the nodes around it unchanged. A tree is
given as a :class:`Stage`: its operator, and its name if it is a single stage.
"""

import numpy as np

from ._composition import (
    OnColumnOperator,
    Scaled,
    Scheduled,
    Series,
    SumOperator,
    bare,
    of_columns,
    split_disturbances,
)
from ._part import Stage

_DRIVEN = "model"  # name of the driven part, if it has several stages


def series_stages(whole):
    """Return the stages of the driven series.

    Parameters
    ----------
    whole : Stage
        Without a name (None), a single stage has the name of its estimator.

    Returns
    -------
    list of Stage
        A single model is one stage of its own.

    Examples
    --------
    >>> from skhyst.linear import FirstOrderLag, FirstOrderLagOperator
    >>> from skhyst.operators import Factor, Stage, series_stages
    >>> tree = FirstOrderLag().tree(FirstOrderLagOperator(0.1)) * Factor(1)
    >>> [stage.name for stage in series_stages(Stage(None, tree))]
    ['first_order_lag']
    """
    while (part := whole.operator.inner(whole.name)) is not None:
        whole = part
    return whole.operator.series(whole.name)


def with_series_stages(whole, stages):
    """Return a tree with other stages in the driven series.

    A single model becomes a series if there are several. Scheduled parameters stay scheduled, by
    their names.
    """
    return _changed(whole, lambda part: _in_series(part, stages))


def _in_series(part, stages):
    names, operators = (tuple(stage[i] for stage in stages) for i in (0, 1))
    name, model = part.name, part.operator.model
    if not (isinstance(part.operator, Series) and part.operator.is_composed):
        if len(stages) == 1:
            return stages[0]
        name, model = _DRIVEN, _node(Series, [], part)
    return Stage(name, Series(names, operators, model=model).normalized())


def add_parallel(whole, name, operator):
    """Return a tree with another operator in parallel with the driven part.

    The operator is an additive disturbance, or driven by a further column, see :func:`on_column`.
    """
    total = whole.operator
    if not (isinstance(total, SumOperator) and total.inner() is not None):
        stages = series_stages(whole)
        own_name = stages[0].name if len(stages) == 1 else _DRIVEN
        total, model = SumOperator((own_name,), (total,)), _node(SumOperator, [], whole)
    else:
        model = total.model
    parts = [Stage(own_name, bare(stage)) for own_name, stage in total.members()]
    total = SumOperator.of_parts([*parts, Stage(name, operator)], model)
    return Stage(None, total.normalized())


def on_column(whole, operator, column):
    """Return an operator as a branch of a tree, driven by a column of the input."""
    return OnColumnOperator(
        operator, column, model=_node(OnColumnOperator, None, whole, column=column)
    )


def modulated(whole, column, reference, sensitivity=0.0, lag=None):
    """Return a tree with the response to the drive scaled by a column.

    ``column`` is its number, or ``"amplitude"``, and ``lag`` an operator through which it acts, if
    any; see :class:`skhyst.compose.Modulated`.
    """
    number = -1 if column == "amplitude" else column

    def change(part):
        model = _node(Scaled, None, part, column=column, lag=lag is not None)
        inside = of_columns(part.operator)
        scaled = Scaled(inside, number, reference, sensitivity, lag, model=model)
        return part._replace(operator=scaled)

    return _changed(whole, change, SumOperator)


def scheduled(whole, by, low, high, lines):
    """Return a tree with entries that are linear in a value per record.

    ``lines`` are the values at ``low`` and at ``high``, by name of the stage and of the entry;
    ``by`` is that of :class:`skhyst.compose.ScheduledParameters`.
    """

    def change(part):
        model = _node(Scheduled, None, part, by=by)
        return part._replace(operator=Scheduled.along(part, low, high, lines, model))

    return _changed(whole, change, SumOperator | Scaled | OnColumnOperator)


def stage_values(whole, *, held=True):
    """Return the values of the operator by (name of the stage, name of the entry).

    Each is an array of one value, or of several if it is scheduled. With ``held=False``, entries
    that are held because another stage owns the gain or the intercept are left out.
    """
    driven, _ = split_disturbances(whole.operator)
    values, keys = {}, whole.operator.keys(whole.name)
    for key, value, (_, spec) in zip(keys, driven.pack(), driven.entries(), strict=True):
        if held or not spec.held:
            values[key] = np.append(values.get(key, []), value)
    return values


def with_stage_values(whole, values):
    """Return the driven part with given values by (stage, entry), for entries that it has.

    An entry that is scheduled in only one of the two gets its mean in the other.
    """
    driven, _ = split_disturbances(whole.operator)
    keys, vector, entries = whole.operator.keys(whole.name), driven.pack(), driven.entries()
    for key in set(keys) & set(values):
        rows = [i for i, other in enumerate(keys) if other == key and not entries[i][1].held]
        same = len(rows) == len(values[key])
        vector[rows] = values[key] if same else np.mean(values[key])
    return driven.unpack(vector)


def _changed(whole, change, around=object):
    """Return a tree in which ``change`` is applied within wrapping nodes of some classes."""
    part = whole.operator.inner(whole.name)
    if part is None or not isinstance(whole.operator, around):
        return change(whole)
    new = _changed(part, change, around)
    return Stage(new.name, whole.operator.with_inner(new, part.name))


def _node(kind, parts, whole, **params):
    """Return the estimator of a new node, with the options of a tree."""
    model = whole.model
    options = {"initial_state": model.initial_state, "dt": model.dt}
    return kind.estimator_class()(parts, **options, **params)
