"""The front door to recordings in files."""

from dataclasses import dataclass
from numbers import Real
from typing import overload

import numpy as np
import pandas as pd

from ..exceptions import RecordError
from ._clock import evenly, positions, record_labels, record_numbers, times
from ._columns import as_columns, load_column, numbers
from ._formats import opened
from ._index import time_stamps
from ._missing import fill, likely_codes, missing_rows
from ._recognise import find_roles
from ._several import labelled, record_groups, together
from ._units import SECONDS, without_unit

_POLICIES = ("raise", "drop", "interpolate")


@overload
def read_records(
    path, *, drive: None = None, response: str | int | None = None, **options
) -> tuple[pd.DataFrame, pd.Series]: ...
@overload
def read_records(
    path, *, drive: str | int, response: str | int, **options
) -> tuple[pd.DataFrame, pd.Series]: ...
@overload
def read_records(
    path, *, drive: str | int, response: None = None, **options
) -> tuple[pd.DataFrame, None]: ...
def read_records(
    path,
    *,
    drive=None,
    response=None,
    time=None,
    record=None,
    auxiliary=(),
    sampling_rate=None,
    on_missing="raise",
    missing_code=None,
    time_unit=None,
    units=None,
    delimiter=None,
    decimal=None,
):
    r"""Read recordings from a file or a table into a frame and a series that carry record and time.

    Parameters
    ----------
    path : str, Path, pandas or polars DataFrame, table of Arrow, or list of these
        A table, or a file whose suffix tells the format: ``.csv``, ``.txt``, ``.tsv``, ``.dat``
        (delimited text; the delimiter, a decimal comma and the header are found), ``.xlsx``,
        ``.mat`` (all versions), ``.npy``, ``.npz``, ``.json`` (list of rows, list of records, dict
        of columns), ``.h5``, ``.hdf5``, ``.parquet``, ``.feather``, ``.tdms`` and ``.wav``.
        Version 7.3 of ``.mat``, and ``.xlsx``, ``.h5``, ``.parquet``, ``.feather`` and ``.tdms``
        need ``skhyst[io]``. Of a list each is a record, labelled by the name of its file.
    drive : str or int, optional
        Column of the drive. A column is named as in the file; by its position, counted from 0; as
        ``name[2]`` for a column of a matrix (``name[0, 2]`` or ``name[:, 0, 2]`` with more axes,
        samples along the first); as ``struct.field``, ``group/channel`` or ``sheet/column``, of
        which the last part is enough. Where several groups or sheets have all columns that are
        asked for, each is a record. None: drive, response, time and record are those that
        :func:`recognise_columns` finds, if they are not given.
    response : str or int, optional
        Column of the response; None: none is read, unless ``drive`` is None.
    time : str or int, optional
        Column of the time: numbers, ISO 8601 dates (in UTC where they carry an offset) or clock
        times ``hh:mm:ss``.
    record : str or int, optional
        Column that labels the records. Without it, time that starts again starts a new one.
    auxiliary : sequence of str or int, default=()
        Columns of auxiliary inputs.
    sampling_rate : float, optional
        In Hz, instead of ``time``. Without either the interval is what the file says: the
        ``wf_increment`` of TDMS, the rate of WAV, an attribute of HDF5 such as ``dt`` or ``fs``.
        Without that too the time level numbers the samples, and the interval is that of the model
        (``dt``).
    on_missing : {"raise", "drop", "interpolate"}, default="raise"
        What happens to rows in which a value is missing, not finite or equal to
        ``missing_code``. Dropped rows leave a gap in time, which starts a new record where it is
        longer than 1.5 intervals; a row that is left without a neighbour is dropped too.
        Interpolation is linear in time and within a record; rows before the first and after the
        last reading of a record are dropped.
    missing_code : float or dict of column to float, optional
        Reading that stands for a lost one, in all columns or by column. None: one such as -9999
        or 1e30 that lies far from all others is lost, so that ``on_missing`` has to say what
        happens to it. NaN: it is a reading like any other.
    time_unit : {"s", "ms", "us", "ns", "min", "h"} or None, default=None
        Unit of a time column of numbers. None: what the file says, in the column's name
        (``t [ms]``, ``time_ms``), a line of units or an attribute, and s where it says nothing.
    units : dict of column to str, optional
        Units of drive, response and auxiliary inputs, in place of what the file says.
    delimiter : str, optional
        Of a text: the character between columns, ``" "`` for any white space. By default it is
        found, and a text that can be read in more than one way is refused.
    decimal : {".", ","}, optional
        Of a text: the decimal sign; found by default.

    Returns
    -------
    X : DataFrame of shape (n_samples, n_inputs)
        Drive, then auxiliary inputs, named as in the file; the unit that a line of units, a TDMS
        ``unit_string``, an HDF5 attribute, ``frame.attrs["units"]`` or a column of pint says stands
        in brackets behind the name. Its index has the levels ``record`` and ``time`` (s, datetimes
        or timedeltas).
    y : Series of shape (n_samples,), or None

    Raises
    ------
    RecordError
        If the file is empty or broken, can be read in more than one way, has no such column, its
        columns do not tell which is the drive, values are missing or look like codes of missing
        ones, or files of a list differ in their columns. Rows are counted from 0, without the
        header.
    ImportError
        If the format needs a package that is not installed.

    Warns
    -----
    TimeUnitWarning
        If the time has no unit, and counts by whole numbers or steps of seconds.

    Notes
    -----
    Nothing in a file is executed: pickled objects, MATLAB objects and function handles are
    refused. Sampling may be uneven here; models refuse it, see `resample_records`.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from skhyst.records import read_records
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder, "stage.csv")
    ...     _ = path.write_text("t;V;nm\n0,0;1,5;10\n0,1;2,5;20\n")
    ...     X, y = read_records(path, drive="V", response="nm", time="t")
    >>> X["V"].tolist(), y.loc[0].index.tolist()
    ([1.5, 2.5], [0.0, 0.1])
    """
    if isinstance(path, list | tuple):
        options = {"drive": drive, "response": response, "time": time, "record": record}
        options |= {"auxiliary": auxiliary, "sampling_rate": sampling_rate, "units": units}
        options |= {"on_missing": on_missing, "missing_code": missing_code, "time_unit": time_unit}
        options |= {"delimiter": delimiter, "decimal": decimal}
        return together({k: read_records(one, **options) for k, one in labelled(path).items()})
    _check_options(time, sampling_rate, on_missing, time_unit)
    _check_layout(delimiter, decimal)
    path, variables = opened(path, delimiter=delimiter, decimal=decimal)
    others = as_columns(auxiliary)
    roles = {"drive": drive, "response": response, "time": time, "record": record}
    if drive is None:
        found = find_roles(path, variables, roles, others, timed=sampling_rate is not None)
        roles |= {role: one.column for role, one in found.items()}
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
    return together({label: _read(path, own, request) for label, own in groups.items()})


@dataclass(frozen=True)
class _Request:
    """What is asked of a file: parameters of `read_records`, with all inputs in one list."""

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
        """All columns that are named."""
        return [c for c in (*self.signals, self.time, self.record) if c is not None]


def _read(path, variables, request):
    """Return what is asked of one group of columns."""
    n_inputs, wanted = len(request.inputs), request.signals
    columns = [load_column(path, variables, item) for item in wanted]
    names = _with_units(wanted, [column.name for column in columns], request.units or {})
    stamps, labels = (
        c if c is None else load_column(path, variables, c) for c in (request.time, request.record)
    )
    _refuse_mismatch(path, names[:n_inputs], [*columns, stamps, labels])
    values = np.column_stack([numbers(path, c.name, c.values) for c in columns])
    stamps = None if stamps is None else times(path, stamps, request.time_unit)
    labels = None if labels is None else record_labels(labels.values)
    if request.missing_code is None:
        codes = likely_codes(path, values, names, request.on_missing)
    else:
        codes = _codes(request.missing_code, wanted, names)
    keep = missing_rows(path, values, names, codes, stamps, labels, request.on_missing)
    rows = positions(labels, len(values))[keep]
    values, stamps, labels = (v if v is None else v[keep] for v in (values, stamps, labels))
    labels = record_numbers(path, stamps, len(values)) if labels is None else np.asarray(labels)
    if stamps is None:
        stamps = evenly(path, columns, rows, request.sampling_rate)
    index = pd.MultiIndex.from_arrays([labels, stamps], names=["record", "time"])
    if request.on_missing == "interpolate":
        values, filled = fill(values, time_stamps(index))
        if not filled.any():
            raise RecordError(f"{path.name} has no record with readings in every column.")
        values, index = values[filled], index[filled]
    X = pd.DataFrame(values[:, :n_inputs], index, columns=names[:n_inputs])
    if request.response is None:
        return X, None
    return X, pd.Series(values[:, -1].copy(), index, name=names[-1])


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
    """Refuse inputs that are one column, and columns of different lengths or none."""
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
    """Return the code of each column, NaN where it has none."""
    if not isinstance(missing_code, dict):
        return np.full(len(names), float(missing_code))
    return np.array(_by_column("missing_code", missing_code, wanted, names, np.nan), dtype=float)


def _by_column(parameter, given, wanted, names, default):
    """Return what a dict says of each column, by its name here or in the file."""
    unknown = [key for key in given if key not in wanted and key not in names]
    if unknown:
        raise ValueError(
            f"The keys of the {parameter!r} parameter of read_records must be columns that are "
            f"read, {', '.join(map(repr, names))}. Got {unknown[0]!r} instead."
        )
    return [given.get(a, given.get(b, default)) for a, b in zip(wanted, names, strict=True)]
