"""Several recordings in one call: a list of files, and groups or sheets of one file."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import pandas as pd

from ..exceptions import RecordError
from ._frames import stack_records
from ._units import without_unit


def labelled(sources):
    """Return files by their names without suffix, or by their paths where those repeat."""
    if not sources:
        raise RecordError("The 'path' parameter of read_records must name a file. Got [] instead.")
    is_frame = [hasattr(source, "columns") for source in sources]
    paths = [None if own else Path(one) for one, own in zip(sources, is_frame, strict=True)]
    stems = Counter(path.stem for path in paths if path)
    labels = [
        number if path is None else path.stem if stems[path.stem] == 1 else str(path)
        for number, path in enumerate(paths)
    ]
    if len(set(labels)) < len(labels):
        raise RecordError("The 'path' parameter of read_records must name each file once.")
    return dict(zip(labels, sources, strict=True))


def record_groups(variables, wanted):
    """Return the variables by group, where several groups have all columns that are wanted.

    There they are called as in their group. Else all variables are one group, or the only one that
    has them all.
    """
    groups = {}
    for variable in variables:
        groups.setdefault(variable.group, []).append(variable)
    holding = {group: own for group, own in groups.items() if _has_all(own, wanted)}
    if len(holding) < 2:
        return holding or {"": variables}
    return {
        group: [replace(variable, name=variable.bare, group="") for variable in own]
        for group, own in holding.items()
    }


def _has_all(variables, wanted):
    names = {name for v in variables for name in (v.bare, v.bare_label, without_unit(v.bare))}
    return bool(wanted and variables[0].group) and all(one in names for one in wanted)


def together(parts):
    """Return the records of all parts, a dict by label of (X, y), labelled by their parts."""
    if len(parts) == 1:
        return next(iter(parts.values()))
    first, columns = None, None
    for label, (X, y) in parts.items():
        own = [*map(str, X.columns), *([] if y is None else [y.name])]
        first, columns = (first, columns) if columns else (label, own)
        if own != columns:
            raise RecordError(
                "Recordings that are read together must have the same columns in the same units. "
                f"Got {', '.join(columns)} in {first!r} and {', '.join(own)} in {label!r} instead."
            )
    found = [_relabelled(label, X, y) for label, (X, y) in parts.items()]
    if found[0][1] is None:
        return stack_records([X for X, _ in found]), None
    return stack_records(found)


def _relabelled(label, X, y):
    """Put the label of a part in front of those of its records, or in the place of the only one."""
    own, times = (X.index.get_level_values(level) for level in ("record", "time"))
    labels = [label] * len(X) if own.nunique() == 1 else [f"{label}/{one}" for one in own]
    index = pd.MultiIndex.from_arrays([labels, times], names=X.index.names)
    return X.set_axis(index), None if y is None else y.set_axis(index)
