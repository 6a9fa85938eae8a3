"""Find a column among the variables of a file by name, position or index."""

import re
from bisect import bisect_right
from collections import Counter
from dataclasses import dataclass, replace
from itertools import accumulate

import numpy as np
import pandas as pd

from ..exceptions import RecordError
from ._column_names import is_time, without_unit
from ._formats import reading
from ._missing import marks_missing

_INDEXED = re.compile(r"(?P<name>.*)\[(?P<index>[^\[\]]+)\]", re.DOTALL)
_POSITION = re.compile(r"\s*([+-]?\d+|:|\.\.\.)\s*")
_SHOWN = 20  # variables that an error message lists, signals that a matrix may have


@dataclass(frozen=True)
class Column:
    """One column of a file: name with unit, values, and sampling interval in s (None: unknown)."""

    name: str
    values: np.ndarray
    interval: float | None


def load_column(path, variables, wanted):
    """Return one column of a file.

    ``wanted`` is a name, with its unit or without, the last part of a path if that is unique,
    ``name[2]`` for a column of a matrix, or the 0-based position among all columns of the file.
    """
    if isinstance(wanted, int | np.integer) and not isinstance(wanted, bool):
        return _at_position(path, variables, int(wanted))
    if not isinstance(wanted, str):
        raise RecordError(
            f"A column must be named by a str or by its position as an int. Got {wanted!r} instead."
        )
    variable = _named(path, variables, wanted)
    if variable is not None:
        name = variable.label or wanted
        return Column(name, _vector(path, variable, wanted), variable.interval)
    if re.fullmatch(r"\d+", wanted):
        return _at_position(path, variables, int(wanted))
    match = _INDEXED.fullmatch(wanted)
    variable = match and _named(path, variables, match["name"])
    if variable is None:
        raise RecordError(f"{path.name} has no column {wanted!r}. {listed_variables(variables)}")
    name = replace(variable, name=wanted).label
    return Column(name, _indexed(path, variable, wanted, match["index"]), variable.interval)


def record_groups(variables, wanted):
    """Return the variables by group, if several groups have all columns that are wanted.

    Their names are then those within the group. If one group has them all, it is returned alone;
    if none has, all variables are returned as one group, "".
    """
    groups = {}
    for variable in variables:
        groups.setdefault(variable.group, []).append(variable)
    complete = {group: members for group, members in groups.items() if _has_all(members, wanted)}
    if len(complete) < 2:
        return complete or {"": variables}
    return {
        group: [replace(variable, name=variable.bare, group="") for variable in members]
        for group, members in complete.items()
    }


def _has_all(variables, wanted):
    """Whether a group has all columns; one in another unit is refused later, not passed over."""
    names = {name for v in variables for name in (v.bare, v.bare_label, without_unit(v.bare))}
    bare = [one if one in names else without_unit(str(one)) for one in wanted]
    return bool(wanted and variables[0].group) and names.issuperset(bare)


def as_columns(columns):
    """Return one column or a sequence of them as a list."""
    single = isinstance(columns, str) or not np.iterable(columns)
    return [columns] if single else list(columns)


def _named(path, variables, name):
    parts = [re.split(r"[/.]", v.name) for v in variables]
    bare = [re.split(r"[/.]", without_unit(v.name)) for v in variables]
    matches = [i for i, v in enumerate(variables) if v.name == name]
    if not matches and name:
        matches = [i for i, v in enumerate(variables) if v.label == name]
        matches = matches or [i for i, v in enumerate(variables) if v.bare_label == name]
        matches = matches or [i for i, path_parts in enumerate(parts) if path_parts[-1] == name]
        matches = matches or [
            i for i, path_parts in enumerate(parts) if path_parts == re.split(r"[/.]", name)
        ]
        matches = matches or [i for i, path_parts in enumerate(bare) if path_parts[-1] == name]
    if len(matches) > 1:
        raise RecordError(
            f"{path.name} has {len(matches)} columns that {name!r} may mean, at the positions "
            f"{', '.join(map(str, matches))}: give the full name or the position. "
            f"{listed_variables(variables)}"
        )
    return variables[matches[0]] if matches else None


def listed_variables(variables):
    """Return a sentence that lists variables with their shapes."""
    shown = [
        f"{v.name or 'an array without a name'} {v.refused or _size(v.shape)}"
        for v in variables[:_SHOWN]
    ]
    more = len(variables) - len(shown)
    listed = f"It has: {', '.join(shown)}{f' and {more} more' if more > 0 else ''}."
    deep = next((v for v in variables if len(v.shape) > 2 and not v.refused), None)
    if deep is None:
        return listed
    index = ["0"] * len(deep.shape)
    index[int(np.argmax(deep.shape))] = ":"
    return (
        f"{listed} Of an array of more than two axes each column is named, as "
        f"'{deep.name}[{', '.join(index)}]' with the samples along ':', drive and response alike."
    )


def _size(shape):
    return f"({', '.join(map(str, shape))})" if shape else "(a single value)"


def _is_vector(shape):
    return len(shape) > 0 and sum(n != 1 for n in shape) <= 1


def _length(shape):
    return 0 if not shape else max(shape) if _is_vector(shape) else shape[_has_rows(shape)]


def _has_rows(shape):
    """Whether the signals of a matrix are its rows, few and long, and not its columns."""
    return len(shape) == 2 and 1 < shape[0] <= _SHOWN < shape[1]


def _part(variable, number):
    """Return the name of a signal of a matrix by its number."""
    index = (
        f"[{number}, :]"
        if _has_rows(variable.shape)
        else f"[{number}]"
        if variable.name
        else number
    )
    return replace(variable, name=f"{variable.name}{index}").label


def _at_position(path, variables, position):
    """Count the columns of all variables that are as long as the longest one."""
    usable = [v for v in variables if v.shape and len(v.shape) <= 2 and not v.refused]
    longest = max((_length(v.shape) for v in usable), default=0)
    usable = [v for v in usable if _length(v.shape) == longest]
    widths = [1 if _is_vector(v.shape) else v.shape[not _has_rows(v.shape)] for v in usable]
    if not 0 <= position < sum(widths):
        raise RecordError(
            f"{path.name} has no column at position {position}: it has {sum(widths)} columns, "
            f"counted from 0. {listed_variables(variables)}"
        )
    ends = list(accumulate(widths))
    index = bisect_right(ends, position)
    variable, column = usable[index], position - ends[index] + widths[index]
    if _is_vector(variable.shape):
        name = variable.label or str(position)
        return Column(name, _load(path, variable).reshape(-1), variable.interval)
    values = _load(path, variable)
    signal = values[column] if _has_rows(variable.shape) else values[:, column]
    return Column(_part(variable, column), signal, variable.interval)


@dataclass(frozen=True)
class Place:
    """Location of a column: its position, and its address, a name if it is in several groups."""

    position: int
    address: str | int
    name: str  # with its unit, within its group
    full_name: str


def long_columns(variables):
    """Return the places of all columns that have the length of the longest column.

    If several groups have a column of the same name, the first is returned, addressed by the name,
    unless each group consists of one column, or of one and its time: then the groups are channels,
    not records.
    """
    usable = [v for v in variables if v.shape and len(v.shape) <= 2 and not v.refused]
    longest = max((_length(v.shape) for v in usable), default=0)
    sizes = Counter(v.group for v in usable if not is_time(v.bare))
    repeats = Counter(v.bare for v in usable if sizes[v.group] > 1)
    places, position = {}, 0
    for variable in (v for v in usable if _length(v.shape) == longest):
        if _is_vector(variable.shape):
            key = variable.bare if variable.group else position
            address = key if repeats[variable.bare] > 1 else variable.name or position
            label = variable.bare_label if sizes[variable.group] > 1 else variable.label
            names = (name or str(position) for name in (label, variable.label))
            places.setdefault(address, Place(position, address, *names))
            position += 1
            continue
        width = variable.shape[not _has_rows(variable.shape)]
        for k in range(position, position + width if width <= _SHOWN else 0):
            places[k] = Place(k, k, *[_part(variable, k - position)] * 2)
        position += width
    return list(places.values())


def place_of(path, variables, places, wanted):
    """Return which of the places a column has, named as for `load_column`; None if it has none."""
    is_named = isinstance(wanted, str) and (
        not wanted.isdigit() or _named(path, variables, wanted) is not None
    )
    name = load_column(path, variables, wanted).name
    at = [place for place in places if not is_named and place.position == int(wanted)]
    at += [place for place in places if name in (place.name, place.full_name)]
    return at[0] if at else None


def _load(path, variable):
    if variable.refused:
        raise RecordError(
            f"{variable.name!r} in {path.name} is not read: it is {variable.refused}."
        )
    with reading(path):
        return np.asarray(variable.load())


def _vector(path, variable, wanted):
    if variable.refused or _is_vector(variable.shape):
        return _load(path, variable).reshape(-1)
    if not variable.shape:
        raise RecordError(f"{wanted!r} in {path.name} is a single value, not a column.")
    zeros = ", ".join(["0"] * (len(variable.shape) - 1))
    raise RecordError(
        f"{wanted!r} in {path.name} has the shape {_size(variable.shape)}: give one column of it, "
        f"such as '{variable.name}[{zeros}]'."
    )


def _indexed(path, variable, wanted, text):
    matches = [_POSITION.fullmatch(part) for part in text.split(",")]
    values = _load(path, variable)
    if all(matches):
        symbols = {":": slice(None), "...": Ellipsis}
        index = [symbols.get(m[1]) or int(m[1]) for m in matches]
        if all(isinstance(part, int) for part in index):
            index = [slice(None), *index]  # plain numbers index the axes after that of the samples
        try:
            column = values[tuple(index)]
        except IndexError:
            column = None
        if column is not None and _is_vector(column.shape):
            return column.reshape(-1)
    raise RecordError(
        f"{wanted!r} is not a column of {variable.name or 'the array'!r} in {path.name}, whose "
        f"shape is {_size(values.shape)}: count from 0, one number for each axis but the first."
    )


def numbers(path, name, values):
    """Return a column as floats, NaN where a cell is empty."""
    if values.dtype.kind in "biuf":
        return values.astype(float)
    if values.dtype.kind in "OUSTV":
        column = pd.Series(values, dtype=object)
        converted = coerced(path, name, column)
        text = column.notna() & ~is_blank(column)
        wrong = np.flatnonzero(converted.isna() & text)
        if not len(wrong) and converted.dtype.kind in "biuf":
            return converted.to_numpy(dtype=float)
        row = int(wrong[0]) if len(wrong) else 0
        cell = str(column.iloc[row])
        if cell.strip().lstrip("+-").isdigit():  # an integer too large, which pandas 2 coerces
            raise _beyond(path, name)
        raise RecordError(
            f"Column {name!r} of {path.name} must hold numbers. Got {cell[:40]!r} in row {row} "
            f"instead ({len(wrong)} of {len(column)} rows are not numbers): correct the file, or "
            "leave these cells blank."
        )
    raise RecordError(
        f"Column {name!r} of {path.name} must hold real numbers. Got {values.dtype} instead."
    )


def is_blank(column):
    """Mark the cells of a series without a reading; no copy of a long text is kept."""
    return np.array([marks_missing(str(cell)) for cell in column], dtype=bool)


def coerced(path, name, column):
    """Return a series as numbers, NaN where a cell is not a number."""
    try:
        return pd.to_numeric(column, errors="coerce")
    except OverflowError as error:
        raise _beyond(path, name) from error


def _beyond(path, name):
    return RecordError(
        f"Column {name!r} of {path.name} has an integer beyond all floating-point numbers."
    )
