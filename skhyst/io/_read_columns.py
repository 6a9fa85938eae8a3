"""A file as columns of numbers, with names and units, and the time of each row."""

from dataclasses import dataclass
from numbers import Real

import numpy as np
import pandas as pd

from ..exceptions import RecordError
from ._clock import by_record, evenly, positions, record_labels, record_numbers, times, warn_of_rate
from ._column_names import SECONDS, without_unit
from ._file_columns import as_columns, load_column, numbers, record_groups
from ._formats import opened
from ._missing import likely_codes, missing_rows
from ._recognise import days, find_roles, interleaved, separate_times

_POLICIES = ("raise", "drop", "interpolate")


@dataclass(frozen=True)
class Columns:
    """Inputs and response that are read from a file, with the time and the record of each row.

    Parameters
    ----------
    source : str
        Name of the file.
    values : ndarray of shape (n_samples, n_columns)
        Inputs, then the response if there is one; NaN where a reading is missing.
    names : list of str
        Names of the columns, with their units.
    n_inputs : int
    times : ndarray or index of shape (n_samples,)
        In s, or datetimes or timedeltas; numbers of the samples where their interval is not known.
    records : ndarray of shape (n_samples,)
        Label of the record of each row.
    """

    source: str
    values: np.ndarray
    names: list
    n_inputs: int
    times: np.ndarray | pd.Index
    records: np.ndarray


def read_columns(
    path,
    *,
    drive,
    response,
    time,
    record,
    auxiliary,
    sampling_rate,
    on_missing,
    missing_code,
    time_unit,
    units,
    delimiter,
    decimal,
):
    """Return the requested columns of a file; parameters as :func:`skhyst.records.read_records`.

    Returns
    -------
    dict of str to Columns
        By the groups or sheets that have all columns. Missing readings are refused, dropped, or
        left as NaN; they are not interpolated here.
    """
    _check_options(time, sampling_rate, on_missing, time_unit)
    _check_layout(delimiter, decimal)
    path, variables = opened(path, delimiter=delimiter, decimal=decimal)
    others = as_columns(auxiliary)
    roles = {"drive": drive, "response": response, "time": time, "record": record}
    if drive is None:
        recognised = find_roles(path, variables, roles, others, timed=sampling_rate is not None)
        roles |= {role: column.column for role, column in recognised.items()}
    inputs = [roles.pop("drive"), *others]
    request = _Request(
        inputs,
        **roles,
        sampling_rate=sampling_rate,
        on_missing=on_missing,
        missing_code=missing_code,
        time_unit=time_unit,
        units=units,
    )
    groups = record_groups(variables, request.columns)
    return {label: _read(path, members, request) for label, members in groups.items()}


@dataclass(frozen=True)
class _Request:
    """Parameters of `read_columns`, with all inputs in one list."""

    inputs: list
    response: str | int | None
    time: str | int | None
    record: str | int | None
    sampling_rate: float | None
    on_missing: str
    missing_code: float | dict | None
    time_unit: str | None
    units: dict | None

    @property
    def signals(self):
        """Inputs and response."""
        return self.inputs if self.response is None else [*self.inputs, self.response]

    @property
    def columns(self):
        """All columns that are requested."""
        return [c for c in (*self.signals, self.time, self.record) if c is not None]


def _read(path, variables, request):
    """Return the requested columns of one group."""
    n_inputs, wanted = len(request.inputs), request.signals
    columns = [load_column(path, variables, item) for item in wanted]
    names = _with_units(wanted, [column.name for column in columns], request.units or {})
    stamps, labels = (
        c if c is None else load_column(path, variables, c) for c in (request.time, request.record)
    )
    _refuse_mismatch(path, names[:n_inputs], [*columns, stamps, labels])
    if separate := separate_times(path, variables, wanted):
        raise RecordError(separate)
    values = np.column_stack([numbers(path, c.name, c.values) for c in columns])
    stamps = None if stamps is None else times(path, stamps, request.time_unit)
    labels = None if labels is None else record_labels(labels.values)
    if labels is None and stamps is not None and (runs := interleaved(path, variables, stamps)):
        raise RecordError(runs)
    later = days(path, variables, stamps) if isinstance(stamps, pd.TimedeltaIndex) else 0
    if request.missing_code is None:
        codes = likely_codes(path, values, names, request.on_missing)
    else:
        codes = _codes(request.missing_code, wanted, names)
    keep = missing_rows(path, values, names, codes, stamps, labels, request.on_missing)
    rows = positions(labels, len(values))[keep]
    values, stamps, labels = (v if v is None else v[keep] for v in (values, stamps, labels))
    later = later[keep] if np.ndim(later) else later
    if labels is None:
        labels = record_numbers(path, stamps, len(values)) + later
    labels = np.asarray(labels)
    if stamps is not None and (order := by_record(labels, stamps)) is not None:
        values, stamps, labels = values[order], stamps[order], labels[order]
    if stamps is None:
        stamps = evenly(path, columns, rows, request.sampling_rate)
    else:
        warn_of_rate(path, columns, stamps)
    return Columns(path.name, values, names, n_inputs, stamps, labels)


def _check_options(time, sampling_rate, on_missing, time_unit):
    if time is not None and sampling_rate is not None:
        raise ValueError(
            "The 'sampling_rate' parameter of read_records must be None where 'time' names a "
            f"column. Got {sampling_rate!r} instead."
        )
    if sampling_rate is not None and not (
        isinstance(sampling_rate, Real) and 0.0 < sampling_rate < np.inf
    ):
        raise ValueError(
            "The 'sampling_rate' parameter of read_records must be a positive number of Hz. Got "
            f"{sampling_rate!r} instead."
        )
    for name, value, known in (
        ("on_missing", on_missing, _POLICIES),
        ("time_unit", time_unit, (*SECONDS, None)),
    ):
        if value not in known:
            raise ValueError(
                f"The {name!r} parameter of read_records must be one of {known}. Got {value!r} "
                "instead."
            )


def _check_layout(delimiter, decimal):
    if delimiter is not None and not (isinstance(delimiter, str) and len(delimiter) == 1):
        raise ValueError(
            "The 'delimiter' parameter of read_records must be one character, or None. Got "
            f"{delimiter!r} instead."
        )
    if decimal not in (None, ".", ","):
        raise ValueError(
            "The 'decimal' parameter of read_records must be '.', ',' or None. Got "
            f"{decimal!r} instead."
        )


def _refuse_mismatch(path, names, columns):
    """Refuse an input that is given twice, columns of different lengths, and empty columns."""
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise RecordError(
            f"The inputs must be different columns. Got {', '.join(map(repr, repeated))} more "
            "than once; where columns of a file share a name, rename them in the file."
        )
    lengths = {column.name: len(column.values) for column in filter(None, columns)}
    if len(set(lengths.values())) > 1:
        shown = ", ".join(f"{name!r} {length}" for name, length in lengths.items())
        raise RecordError(f"The columns of {path.name} differ in length: {shown}.")
    if not next(iter(lengths.values())):
        raise RecordError(f"{path.name} has no rows.")


def _with_units(wanted, names, units):
    """Return the names of the columns with the units that are given for them."""
    given = _by_column("units", units, wanted, names, "")
    pairs = zip(names, given, strict=True)
    return [f"{without_unit(name)} [{unit}]" if unit else name for name, unit in pairs]


def _codes(missing_code, wanted, names):
    """Return the code of each column, NaN without one."""
    if not isinstance(missing_code, dict):
        return np.full(len(names), float(missing_code))
    return np.array(_by_column("missing_code", missing_code, wanted, names, np.nan), dtype=float)


def _by_column(parameter, given, wanted, names, default):
    """Return the value of a dict for each column, by its name as requested or in the file."""
    unknown = [key for key in given if key not in wanted and key not in names]
    if unknown:
        raise ValueError(
            f"The keys of the {parameter!r} parameter of read_records must be columns that are "
            f"read, {', '.join(map(repr, names))}. Got {unknown[0]!r} instead."
        )
    return [given.get(a, given.get(b, default)) for a, b in zip(wanted, names, strict=True)]
