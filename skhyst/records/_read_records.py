"""Read recordings from files and tables."""

from itertools import pairwise
from typing import overload

import numpy as np
import pandas as pd

from ..exceptions import RecordError
from ..io import read_columns
from ._index import time_stamps
from ._several import labelled, together


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
    r"""Read recordings from files or tables into a frame and a series indexed by record and time.

    Parameters
    ----------
    path : str, Path, pandas or polars DataFrame, table of Arrow, or list of these
        A table, or a file whose suffix gives the format: ``.csv``, ``.txt``, ``.tsv``, ``.dat``,
        ``.asc``, ``.lvm`` (delimited text; the delimiter, a decimal comma and the header are
        found), ``.xlsx``, ``.mat`` (all versions), ``.npy``, ``.npz``, ``.json`` (list of rows,
        list of records, dict of columns), ``.h5``, ``.hdf5``, ``.parquet``, ``.feather``,
        ``.tdms`` and ``.wav``.
        Version 7.3 of ``.mat``, and ``.xlsx``, ``.h5``, ``.parquet``, ``.feather`` and ``.tdms``
        need ``skhyst[io]``. Each entry of a list is a record, labelled by the name of its file.
    drive : str or int, optional
        Column of the drive. A column is named as in the file; by its position, counted from 0; as
        ``name[2]`` for a column of a matrix (``name[0, 2]`` or ``name[:, 0, 2]`` with more axes,
        samples along the first); as ``struct.field``, ``group/channel`` or ``sheet/column``, of
        which the last part is enough. Where several groups or sheets have all requested
        columns, each is a record, and where the line of names of a text or sheet is repeated, a new
        record begins.
        None: drive, response, time and record are those that
        :func:`~skhyst.io.recognise_columns` finds, if they are not given.
    response : str or int, optional
        Column of the response; None: none is read, unless ``drive`` is None.
    time : str or int, optional
        Column of the time: numbers, ISO 8601 dates (in UTC where they carry an offset) or clock
        times ``hh:mm:ss``.
    record : str or int, optional
        Column that labels the records. Without it, a new record starts where time steps back.
    auxiliary : sequence of str or int, default=()
        Columns of auxiliary inputs.
    sampling_rate : float, optional
        In Hz, instead of ``time``. Without either, the interval is taken from the file: the
        ``wf_increment`` of TDMS, the rate of WAV, an attribute of HDF5 or a single value next to
        the arrays such as ``dt``, ``Ts`` or ``fs``, the head of a text.
        If the file has none, the time level numbers the samples, and the interval is that of the
        model (``dt``).
    on_missing : {"raise", "drop", "interpolate"}, default="raise"
        Treatment of rows in which a value is missing, not finite or equal to ``missing_code``.
        Dropped rows leave a gap in time, which starts a new record unless it is short enough for
        lost rows, see :func:`record_slices`; a single row between two gaps is dropped too.
        Interpolation is linear in time and within a record; rows before the first and after the
        last reading of a record are dropped.
    missing_code : float or dict of column to float, optional
        Value that stands for a missing reading, in all columns or by column. None: a value such as
        -9999 or 1e30 that lies far from all others counts as missing, and ``on_missing`` decides
        its treatment. NaN: there is no such value.
    time_unit : {"s", "ms", "us", "ns", "min", "h", "d"} or None, default=None
        Unit of a time column of numbers. None: the unit given in the file, in the column's name
        (``t [ms]``, ``time_ms``), a line of units or an attribute, and s if there is none.
    units : dict of column to str, optional
        Units of drive, response and auxiliary inputs, instead of those in the file.
    delimiter : str, optional
        Of delimited text: the character between columns, ``" "`` for any white space. By default it
        is detected, and a text that can be read in more than one way is refused.
    decimal : {".", ","}, optional
        Of delimited text: the decimal sign; detected by default.

    Returns
    -------
    X : DataFrame of shape (n_samples, n_inputs)
        Drive, then auxiliary inputs, named as in the file, with the unit in brackets after the name
        if a line of units, a TDMS ``unit_string``, an HDF5 attribute, ``frame.attrs["units"]`` or a
        column of pint gives it. Its index has the levels ``record`` and ``time`` (s, datetimes or
        timedeltas).
    y : Series of shape (n_samples,), or None
        Response; None if no response is read.

    Raises
    ------
    RecordError
        If the file is empty or broken, can be read in more than one way, or has no such column; if
        the drive is not given and cannot be recognised; if values are missing or look like codes of
        missing ones; or if files of a list differ in their columns. Rows are counted from 0,
        without the header.
    ImportError
        If the format needs a package that is not installed.

    Warns
    -----
    TimeUnitWarning
        If the time column has no unit, and its values are integers or have steps of seconds.

    See Also
    --------
    inspect_recording : Columns, records and faults of a file before it is read.
    stack_records : The same index for arrays in memory.
    skhyst.io.join_files : Columns of one recording in several files.

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
    options = {"drive": drive, "response": response, "time": time, "record": record}
    options |= {"auxiliary": auxiliary, "sampling_rate": sampling_rate, "units": units}
    options |= {"on_missing": on_missing, "missing_code": missing_code, "time_unit": time_unit}
    options |= {"delimiter": delimiter, "decimal": decimal}
    if isinstance(path, list | tuple):
        return together({k: read_records(one, **options) for k, one in labelled(path).items()})
    groups = read_columns(path, **options)
    return together({label: _indexed(columns, on_missing) for label, columns in groups.items()})


def _indexed(columns, on_missing):
    """Return the frame of inputs and the series of a response, with record and time as index."""
    index = pd.MultiIndex.from_arrays([columns.records, columns.times], names=["record", "time"])
    values, names, n = columns.values, columns.names, columns.n_inputs
    if on_missing == "interpolate":
        values, is_complete = _fill(values, time_stamps(index))
        if not is_complete.any():
            raise RecordError(f"{columns.source} has no record with readings in every column.")
        values, index = values[is_complete], index[is_complete]
    X = pd.DataFrame(values[:, :n], index, columns=names[:n])
    if len(names) == n:
        return X, None
    return X, pd.Series(values[:, -1].copy(), index, name=names[-1])


def _fill(values, stamps):
    """Interpolate missing values linearly in time, between the gaps in the stamps of the rows.

    Return the values and a mask of complete rows, False before the first and after the last reading
    of a stretch without a gap.
    """
    values, clock = values.copy(), stamps.values.astype(float)
    stretches = (cut for run in pairwise(stamps.runs()) for cut in pairwise(stamps.cuts(*run)))
    for start, stop in stretches:
        times = clock[start:stop]
        for column in values[start:stop].T:
            known = np.isfinite(column)
            if known.any() and not known.all():
                column[~known] = np.interp(
                    times[~known], times[known], column[known], left=np.nan, right=np.nan
                )
    return values, np.isfinite(values).all(axis=1)
