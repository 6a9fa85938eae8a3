"""What is understood of a recording, and what is wrong with it, before any model is fitted."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd

from ..exceptions import RecordError
from ._columns import as_columns, load_column, long_columns, numbers
from ._formats import opened
from ._index import record_slices
from ._readers import read_records
from ._recognise import ROLES, find_roles
from ._several import record_groups

_MOST = 100  # columns that are looked at
_STANDS = 0.01  # of the rows at the largest or smallest value: clipped
_OFTEN = 5  # times as often as the value beside it
_FINE = 50  # different values, below which a signal is a series of steps


@dataclass(frozen=True)
class ColumnOverview:
    """What is known of a column.

    Parameters
    ----------
    name : str
        With its unit.
    role : {"drive", "response", "time", "record", ""}
    reason : str
        What tells the role.
    kind : str
        Type of the values in the file.
    low, high : float
        Range of the readings, NaN where there are none.
    """

    name: str
    role: str
    reason: str
    kind: str
    low: float
    high: float

    def __str__(self):
        span = f"{self.low:g} to {self.high:g}" if self.low <= self.high else "no numbers"
        return f"{self.role or '-':10s}{self.name!r}: {span} ({self.kind}; {self.reason})"


@dataclass(frozen=True, repr=False)
class RecordingOverview:
    """What is understood of a recording. Printing it tells all.

    Parameters
    ----------
    name : str
        Of the file.
    columns : tuple of ColumnOverview
    records : tuple of RecordSlice
        Empty where it is not known how the rows were sampled.
    faults : tuple of str
        What has to be settled, and what is suspicious, a sentence each.
    X, y : DataFrame and Series, or None
        As :func:`read_records` returns them, lost readings interpolated; None where drive or
        response are not known.
    """

    name: str
    columns: tuple
    records: tuple
    faults: tuple
    X: pd.DataFrame | None
    y: pd.Series | None

    def __repr__(self):
        lines = [self.name, *(f"  {column}" for column in self.columns)]
        for record in self.records[:_MOST]:
            every = "at an unknown interval (samples are counted)"
            if record.time_unit == "s":
                every = f"every {record.dt:g} s, {record.n_samples * record.dt:.4g} s in all"
            lines.append(f"  record {record.label}: {record.n_samples} samples {every}")
        faults = [f"  {fault}" for fault in self.faults] or ["  none found"]
        return "\n".join([*lines, "faults:", *faults])


def inspect_recording(path, **reading):
    """Tell what is understood of a recording: its columns, records, intervals and faults.

    Parameters
    ----------
    path : str, Path, or pandas or polars DataFrame
        Recording.
    **reading
        Options of :func:`read_records`. Columns that are not given are those that
        :func:`recognise_columns` finds.

    Returns
    -------
    RecordingOverview
        Faults are readings that are missing, or look like codes of missing ones; signals that do
        not move, stand at their largest or smallest value, or are the same; text where numbers
        are expected; gaps, uneven or coarse times; and what nothing tells.

    Raises
    ------
    RecordError
        If the file cannot be read at all.

    Examples
    --------
    >>> import numpy as np
    >>> import pandas as pd
    >>> from skhyst.records import inspect_recording
    >>> u = np.sin(0.1 * np.arange(200))
    >>> table = pd.DataFrame({"t [ms]": np.arange(200), "u [V]": u, "y [um]": np.minimum(u, 0.9)})
    >>> print(inspect_recording(table))
    the frame
      time      't [ms]': 0 to 199 (int64; by its name)
      drive     'u [V]': -0.99999 to 0.999574 (float64; by its name)
      response  'y [um]': -0.99999 to 0.9 (float64; by its name)
      record 0: 200 samples every 0.001 s, 0.2 s in all
    faults:
      'y [um]' stands at its largest value, 0.9, in 14 % of the rows: is it clipped?
    """
    layout = {name: reading.get(name) for name in ("delimiter", "decimal")}
    source, variables = opened(path, **layout)
    faults = []
    roles = _roles(source, variables, reading, faults)
    own = next(iter(record_groups(variables, [column for column, _ in roles.values()]).values()))
    told = {
        load_column(source, own, column).name: (role, reason)
        for role, (column, reason) in roles.items()
    }
    columns, signals = [], {}
    for place in long_columns(own)[:_MOST]:
        values = load_column(source, own, place.position).values
        role, reason = told.get(place.name) or told.get(place.full_name) or ("", "not used")
        columns.append(_overview(source, place.name, role, reason, values))
        signals[place.name] = role, values
    faults += _faults_of_columns(source, signals)
    X = y = None
    if {"drive", "response"} <= roles.keys():
        options = reading | {role: column for role, (column, _) in roles.items()}
        X, y = _read(path, options, faults)
    records = _records(X, y, faults)
    return RecordingOverview(source.name, tuple(columns), records, tuple(faults), X, y)


def _roles(source, variables, reading, faults):
    """Return (column, reason) by role; what nothing tells is added to the faults."""
    given = {name: reading.get(name) for name in ROLES}
    timed, others = reading.get("sampling_rate") is not None, reading.get("auxiliary", ())
    known = {role: (column, "as given") for role, column in given.items() if column is not None}
    try:
        found = find_roles(source, variables, given, as_columns(others), timed=timed)
    except RecordError as error:
        faults.append(str(error))
        return known
    return known | {role: (one.column, one.reason) for role, one in found.items()}


def _records(X, y, faults):
    try:
        return () if X is None else record_slices(X, y, one_interval=False)
    except RecordError as error:
        faults.append(str(error))
        return ()


def _overview(source, name, role, reason, values):
    try:
        readings = numbers(source, name, values)
        readings = readings[np.isfinite(readings)]
    except RecordError:
        readings = np.empty(0)
    span = (readings.min(), readings.max()) if readings.size else (np.nan, np.nan)
    return ColumnOverview(name, role, reason, str(values.dtype), *map(float, span))


def _read(path, options, faults):
    """Return X and y; what has to be settled before is added to the faults, and passed over."""
    try:
        return read_records(path, **options)
    except RecordError as error:
        faults.append(str(error))
    try:
        return read_records(path, **options | {"on_missing": "interpolate"})
    except RecordError:
        return None, None


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
        if known.size < values.size and role not in ("drive", "response"):
            yield f"{name!r} misses {values.size - known.size} of {values.size} readings."
        if known.size and not np.ptp(known):
            yield f"{name!r} does not move: it is {known[0]:g} throughout."
        elif role == "response":
            yield from _clipped(name, known)
    for (name, values), (other, others) in combinations(readings.items(), 2):
        if np.array_equal(values, others, equal_nan=True) and np.ptp(values) > 0.0:
            yield f"{name!r} and {other!r} are the same signal."


def _clipped(name, values):
    """Tell where a signal stands at an end of its range, far more often than beside it."""
    levels, counts = np.unique(values, return_counts=True)
    if levels.size < _FINE:
        return
    for word, end, beside in (("largest", -1, -2), ("smallest", 0, 1)):
        if counts[end] > max(_STANDS * values.size, _OFTEN * counts[beside]):
            share = 100.0 * counts[end] / values.size
            yield (
                f"{name!r} stands at its {word} value, {levels[end]:g}, in {share:.2g} % of the "
                "rows: is it clipped?"
            )
