"""Overview of the columns of a file, and their faults."""

from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from .._envelope import envelope
from ..exceptions import RecordError
from ._column_names import is_time
from ._file_columns import as_columns, load_column, long_columns, numbers, place_of, record_groups
from ._formats import opened
from ._recognise import ROLES, roles_and_questions

_MOST = 100  # largest number of columns that are inspected
_PARTS = 200  # largest number of parts of an outline


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
        Range of the readings of all records, NaN if there are none.
    outline : ndarray of shape (n_points, 2)
        Number and value of the smallest and largest reading of each of up to 200 parts, for a
        thumbnail.
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
    groups = record_groups(variables, [column for column, _ in roles.values()])
    first, group = next(iter(groups.items()))
    places = long_columns(group)
    recognised = {
        place_of(source, group, places, column): (role, reason, column)
        for role, (column, reason) in roles.items()
    }
    columns, signals = [], []
    for place in places[:_MOST]:
        role, reason, address = recognised.get(place, ("", "not used", place.address))
        parts = [
            load_column(source, members, address if role or label != first else place.position)
            for label, members in groups.items()
            if role or label == first or any(address == variable.name for variable in members)
        ]
        readings = np.empty(0)
        try:
            readings = np.concatenate([numbers(source, place.name, part.values) for part in parts])
            signals.append((place.name, role, readings))
        except RecordError as error:
            faults += [str(error)] if role in ("drive", "response") else []
        columns.append(_overview(place.name, role, reason, readings, parts[0]))
    faults += _faults_of_columns(signals)
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


def _overview(name, role, reason, readings, stored):
    readings = readings[np.isfinite(readings)]
    span = (readings.min(), readings.max()) if readings.size else (np.nan, np.nan)
    rows = envelope(readings, _PARTS) if readings.size else []
    outline = np.array([(row, readings[row]) for row in rows]).reshape(-1, 2)
    kind = str(stored.values.dtype)
    return ColumnOverview(name, role, reason, kind, *map(float, span), outline, stored.interval)


def _faults_of_columns(signals):
    for name, role, values in signals:
        known = values[np.isfinite(values)]
        if 0 < known.size < values.size and role not in ("drive", "response"):
            yield f"{name!r} lacks {values.size - known.size} of {values.size} readings."
        if known.size and not np.ptp(known):
            yield f"{name!r} does not move: it is {known[0]:g} throughout."
    for (name, _, values), (other, _, others) in combinations(signals, 2):
        if is_time(name) and is_time(other):  # each signal may have its own
            continue
        if np.array_equal(values, others, equal_nan=True) and np.ptp(values) > 0.0:
            yield f"{name!r} and {other!r} are the same signal."
