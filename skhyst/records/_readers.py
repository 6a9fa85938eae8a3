"""The front door to recordings in files."""

import warnings
from numbers import Real

import numpy as np
import pandas as pd

from ..exceptions import RecordError, TimeUnitWarning
from ._columns import load_column, numbers
from ._formats import opened, reading
from ._index import time_stamps
from ._missing import fill, missing_rows
from ._units import SECONDS, time_unit_of, without_unit

_POLICIES = ("raise", "drop", "interpolate")


def read_records(
    path,
    *,
    drive,
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
    path : str, Path, or pandas or polars DataFrame
        A table, or a file whose suffix tells the format: ``.csv``, ``.txt``, ``.tsv``, ``.dat``
        (delimited text; the delimiter, a decimal comma and the header are found), ``.mat`` (all
        versions), ``.npy``, ``.npz``, ``.json`` (list of rows, list of records, dict of columns),
        ``.h5``, ``.hdf5``, ``.parquet``, ``.tdms`` and ``.wav``. Version 7.3 of ``.mat``, HDF5,
        Parquet and TDMS need ``skhyst[io]``.
    drive : str or int
        Column of the drive. A column is named as in the file; by its position, counted from 0; as
        ``name[2]`` for a column of a matrix (``name[0, 2]`` or ``name[:, 0, 2]`` with more axes,
        samples along the first); as ``struct.field`` or ``group/channel``, of which the last part
        is enough where it is unique.
    response : str or int, optional
        Column of the response.
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
        Reading that stands for a lost one, in all columns or by column.
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
        ``unit_string`` or an HDF5 attribute says stands in brackets behind the name. Its index has
        the levels ``record`` and ``time`` (s, datetimes or timedeltas).
    y : Series of shape (n_samples,), or None

    Raises
    ------
    RecordError
        If the file is empty or broken, can be read in more than one way, has no such column, or
        values are missing. Rows are counted from 0, without the header.
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
    single = isinstance(auxiliary, str) or not np.iterable(auxiliary)
    inputs = [drive, *([auxiliary] if single else auxiliary)]
    _check_options(time, sampling_rate, on_missing, time_unit)
    _check_layout(delimiter, decimal)
    path, variables = opened(path, delimiter=delimiter, decimal=decimal)
    wanted = inputs if response is None else [*inputs, response]
    columns = [load_column(path, variables, item) for item in wanted]
    names = _with_units(wanted, [column.name for column in columns], units or {})
    stamps, labels = (c if c is None else load_column(path, variables, c) for c in (time, record))
    _refuse_mismatch(path, names[: len(inputs)], [*columns, stamps, labels])
    values = np.column_stack([numbers(path, c.name, c.values) for c in columns])
    stamps = None if stamps is None else _times(path, stamps, time_unit)
    labels = None if labels is None else _labels(labels.values)
    codes = _codes(missing_code, wanted, names)
    keep = missing_rows(path, values, names, codes, stamps, labels, on_missing)
    positions = _positions(labels, len(values))[keep]
    values, stamps, labels = (v if v is None else v[keep] for v in (values, stamps, labels))
    labels = _record_numbers(path, stamps, len(values)) if labels is None else np.asarray(labels)
    if stamps is None:
        stamps = _evenly(path, columns, positions, sampling_rate)
    index = pd.MultiIndex.from_arrays([labels, stamps], names=["record", "time"])
    if on_missing == "interpolate":
        values, filled = fill(values, time_stamps(index))
        if not filled.any():
            raise RecordError(f"{path.name} has no record with readings in every column.")
        values, index = values[filled], index[filled]
    X = pd.DataFrame(values[:, : len(inputs)], index, columns=names[: len(inputs)])
    y = None if response is None else pd.Series(values[:, -1].copy(), index, name=names[-1])
    return X, y


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
        return np.full(len(names), np.nan if missing_code is None else float(missing_code))
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


def _evenly(path, columns, positions, sampling_rate):
    """Return times in s by the rate that is given or the interval that the file says, or counts."""
    if sampling_rate is not None:
        return positions / float(sampling_rate)
    said = {column.name: column.interval for column in columns if column.interval is not None}
    if len(set(said.values())) > 1:
        shown = ", ".join(f"{name!r} {value:g} s" for name, value in said.items())
        raise RecordError(
            f"The columns of {path.name} differ in their sampling intervals: {shown}. Bring them "
            "to one, or pass 'sampling_rate' if the file is wrong."
        )
    return positions * next(iter(said.values())) if said else positions


def _seconds(path, name, times, unit):
    """Return times in s, and ask where nobody has said their unit and it is hardly that."""
    if unit is None:
        try:
            unit = time_unit_of(name)
        except ValueError as error:
            raise RecordError(
                f"The time {name!r} of {path.name} is in {str(error)!r}, which is no unit of time "
                f"that is known: pass 'time_unit', one of {', '.join(SECONDS)}, or 'sampling_rate' "
                "instead of 'time'."
            ) from None
    steps = np.abs(np.diff(times))
    step = np.median(steps[np.isfinite(steps)]) if np.isfinite(steps).any() else 0.0
    if not unit and step >= 1.0:
        warnings.warn(
            f"The time {name!r} of {path.name} has no unit and is taken for seconds, {step:g} s "
            "from sample to sample. Pass 'time_unit' if it counts s, ms or others, or "
            "'sampling_rate' instead of 'time' if it counts samples.",
            TimeUnitWarning,
            stacklevel=4,
        )
    return times * SECONDS[unit or "s"]


def _times(path, column, unit):
    """Return s as floats, or datetimes or timedeltas as a pandas index."""
    name, values = column.name, column.values
    if values.dtype.kind in "biuf":
        return _seconds(path, name, values.astype(float), unit)
    if values.dtype.kind in "Mm":
        return pd.Index(values)
    column = pd.Series(values, dtype=object)
    column = column.where(column.astype(str).str.strip() != "", None)
    if pd.to_numeric(column, errors="coerce").notna().any():
        return _seconds(path, name, numbers(path, name, values), unit)
    clock = pd.to_timedelta(column, errors="coerce")
    if clock.notna().any() and (clock.notna() | column.isna()).all():
        return pd.TimedeltaIndex(clock)
    with reading(path):
        try:
            dates = pd.to_datetime(column, format="ISO8601", utc=True)
        except (ValueError, TypeError) as error:
            first = str(column.dropna().iloc[0])[:40] if column.notna().any() else ""
            raise RecordError(
                f"the time {name!r} must be numbers, ISO 8601 dates (2024-05-31T12:00:00.5) or "
                f"clock times (hh:mm:ss.fff). It starts with {first!r} instead"
            ) from error
    return pd.DatetimeIndex(dates).tz_localize(None)


def _labels(values):
    if values.dtype.kind == "f" and (values[np.isfinite(values)] % 1.0 == 0.0).all():
        return pd.Index(values).astype("Int64") if np.isnan(values).any() else values.astype(int)
    return values


def _positions(labels, n):
    """Return the number of each row within its record, from 0."""
    rows = np.arange(n)
    if labels is None:
        return rows
    starts = np.flatnonzero(np.diff(pd.factorize(labels)[0], prepend=-2))
    return rows - np.repeat(starts, np.diff([*starts, n]))


def _record_numbers(path, stamps, n):
    """Return a label for each row: how often time has started again before it."""
    if stamps is None:
        return np.zeros(n, dtype=int)
    still = np.flatnonzero(stamps[1:] == stamps[:-1]) + 1
    if still.size:
        raise RecordError(
            f"The time of {path.name} stands still at row {still[0]} ({still.size} rows in all), "
            "so its stamps are too coarse: pass 'sampling_rate' instead of 'time'."
        )
    restarts = np.append(False, stamps[1:] < stamps[:-1])
    if restarts.sum() > max(n // 4, 1):
        raise RecordError(
            f"The time of {path.name} runs backwards at {restarts.sum()} of {n} rows: the rows are "
            "shuffled, or 'time' names another column. Sort the rows by time."
        )
    return np.cumsum(restarts)
