"""Overview of the columns of a file, and their faults."""

from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from ..exceptions import RecordError
from ._column_names import is_time
from ._file_columns import as_columns, load_column, long_columns, numbers, record_groups
from ._formats import opened
from ._recognise import ROLES, roles_and_questions

_MOST = 100  # largest number of columns that are inspected
_STANDS = 0.01  # fraction of rows at an extreme value, above which the signal may be clipped
_OFTEN = 5  # smallest ratio of the number of rows there to that at the next value
_PARTS = 200  # largest number of parts of an outline
_FINE = 50  # number of different values, below which a signal is a staircase


@dataclass(frozen=True)
class ColumnOverview:
    """Overview of a column.

    Parameters
    ----------
    name : str
        Name with its unit.
    role : {"drive", "response", "time", "record", ""}
    reason : str
        Why the column has the role.
    kind : str
        Type of the values in the file.
    low, high : float
        Range of the readings, NaN if there are none.
    outline : ndarray of shape (n_parts, 2)
        Smallest and largest reading of each of up to 200 consecutive parts, for a thumbnail.
    interval : float or None
        Sampling interval in s, if the file gives it apart from a column of times.

    See Also
    --------
    recognise_columns : The roles of columns alone.
    skhyst.records.inspect_recording : The overview of a file that contains these.
    """

    name: str
    role: str
    reason: str
    kind: str
    low: float
    high: float
    outline: np.ndarray = field(repr=False, compare=False)
    interval: float | None = None

    @property
    def span(self) -> str:
        """Range of the readings in words."""
        if self.low <= self.high:
            return f"{self.low:g} to {self.high:g}"
        return "dates or clock times" if self.role == "time" else "no numbers"

    def __str__(self):
        kind = "text" if self.kind == "object" else self.kind
        return f"{self.role or '-':10s}{self.name!r}: {self.span} ({kind}; {self.reason})"


def inspect_columns(path, **reading):
    """Return the name of a file, its columns, a dict of columns by role, and a list of faults.

    ``reading`` are options of :func:`skhyst.records.read_records`. The columns by role are names or
    positions, as that function takes them.
    """
    layout = {name: reading.get(name) for name in ("delimiter", "decimal")}
    source, variables = opened(path, **layout)
    faults = []
    roles = _roles(source, variables, reading, faults)
    group = next(iter(record_groups(variables, [column for column, _ in roles.values()]).values()))
    recognised = {
        load_column(source, group, column).name: (role, reason)
        for role, (column, reason) in roles.items()
    }
    columns, signals = [], {}
    for place in long_columns(group)[:_MOST]:
        column = load_column(source, group, place.position)
        values = column.values
        known = recognised.get(place.name) or recognised.get(place.full_name)
        role, reason = known or ("", "not used")
        columns.append(_overview(source, place.name, role, reason, values, column.interval))
        signals[place.name] = role, values
    faults += _faults_of_columns(source, signals)
    addresses = {role: column for role, (column, _) in roles.items()}
    return source.name, tuple(columns), addresses, faults


def _roles(source, variables, reading, faults):
    """Return (column, reason) by role; roles without a column are added to the faults."""
    given = {name: reading.get(name) for name in ROLES}
    timed, others = reading.get("sampling_rate") is not None, reading.get("auxiliary", ())
    known = {role: (column, "as given") for role, column in given.items() if column is not None}
    recognised, questions = roles_and_questions(
        source, variables, given, as_columns(others), timed=timed
    )
    faults += [*questions, *(column.doubt for column in recognised.values() if column.doubt)]
    return known | {role: (column.column, column.reason) for role, column in recognised.items()}


def _overview(source, name, role, reason, values, interval):
    try:
        readings = numbers(source, name, values)
        readings = readings[np.isfinite(readings)]
    except RecordError:
        readings = np.empty(0)
    span = (readings.min(), readings.max()) if readings.size else (np.nan, np.nan)
    parts = [p for p in np.array_split(readings, _PARTS) if p.size]
    outline = np.array([(p.min(), p.max()) for p in parts]).reshape(-1, 2)
    kind = str(values.dtype)
    return ColumnOverview(name, role, reason, kind, *map(float, span), outline, interval)


def _faults_of_columns(source, signals):
    readings = {}
    for name, (role, values) in signals.items():
        try:
            readings[name] = numbers(source, name, values)
        except RecordError as error:
            if role in ("drive", "response"):
                yield str(error)
    for name, values in readings.items():
        role, known = signals[name][0], values[np.isfinite(values)]
        if 0 < known.size < values.size and role not in ("drive", "response"):
            yield f"{name!r} lacks {values.size - known.size} of {values.size} readings."
        if known.size and not np.ptp(known):
            yield f"{name!r} does not move: it is {known[0]:g} throughout."
        elif role == "response":
            yield from _clipped(name, known)
    for (name, values), (other, others) in combinations(readings.items(), 2):
        if is_time(name) and is_time(other):  # each signal may have its own
            continue
        if np.array_equal(values, others, equal_nan=True) and np.ptp(values) > 0.0:
            yield f"{name!r} and {other!r} are the same signal."


def _clipped(name, values):
    """Yield a message for each end of the range at which a signal may be clipped."""
    levels, counts = np.unique(values, return_counts=True)
    if levels.size < _FINE:
        return
    for word, end, next_level in (("largest", -1, -2), ("smallest", 0, 1)):
        if counts[end] > max(_STANDS * values.size, _OFTEN * counts[next_level]):
            percent = 100.0 * counts[end] / values.size
            yield (
                f"{name!r} is at its {word} value, {levels[end]:g}, in {percent:.2g} % of the "
                "rows: is it clipped?"
            )
