"""Overview of a recording and its faults, before any model is fitted."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from ..exceptions import RecordError
from ..io import inspect_columns
from ._data_quality import data_quality
from ._index import record_names, record_slices
from ._read_records import read_records

_MOST = 100  # largest number of records that are printed
_STANDS = 0.01  # fraction of rows at an extreme value, above which the signal may be clipped
_OFTEN = 5  # smallest ratio of the number of rows there to that at the next value
_FINE = 50  # number of different values, below which a signal is a staircase
_SAID = ("clipped_range", "lost_rows", "constant_drive", "same_signal")  # in sentences of their own


@dataclass(frozen=True, repr=False)
class RecordingOverview:
    """Columns, records and faults of a recording; printing it lists them.

    Parameters
    ----------
    name : str
        Name of the file.
    columns : tuple of ColumnOverview
        In the order of the file.
    records : tuple of RecordSlice
        Empty where the sampling of the rows is not known.
    faults : tuple of str
        Questions to resolve before reading, and suspicious findings, one sentence each.
    X, y : DataFrame and Series, or None
        As :func:`read_records` returns them, with lost readings interpolated; None where drive or
        response are not known.

    See Also
    --------
    inspect_recording : Returns it.
    """

    name: str
    columns: tuple
    records: tuple
    faults: tuple
    X: pd.DataFrame | None
    y: pd.Series | None

    def __repr__(self):
        lines = [self.name, *(f"  {column}" for column in self.columns)]
        intervals = {} if self.records else dict.fromkeys(c.interval for c in self.columns)
        intervals = " or ".join(f"{dt:g} s" for dt in intervals if dt)
        lines += [f"  one row every {intervals}, as the file says"] if intervals else []
        names = record_names(self.records)
        for record, name in list(zip(self.records, names, strict=True))[:_MOST]:
            every = (
                "at an unknown interval (samples are counted; sampling_rate, --sampling-rate on "
                "the command line, gives it)"
            )
            if record.time_unit == "s":
                every = f"every {record.dt:g} s, {record.duration:.4g} s in all"
            lost = f", {len(record.lost)} lost" if record.lost else ""
            lines.append(f"  record {name}: {record.n_samples} samples {every}{lost}")
        faults = [f"  {fault}" for fault in self.faults] or ["  none found"]
        return "\n".join([*lines, "faults:", *faults])


def inspect_recording(path, **reading):
    """Return an overview of a recording: its columns, records, sampling intervals and faults.

    Parameters
    ----------
    path : str, Path, or pandas or polars DataFrame
        Recording.
    **reading
        Options of :func:`read_records`. Columns that are not given are those that
        :func:`~skhyst.io.recognise_columns` finds.

    Returns
    -------
    RecordingOverview
        Faults are readings that are missing, or look like codes for missing ones; signals that are
        constant, stay at their largest or smallest value, or are identical; other faults of a
        record that :func:`data_quality` finds; text where numbers are expected; gaps, uneven or
        coarse times; and roles or units that cannot be determined from the file.

    Raises
    ------
    RecordError
        If the file cannot be read at all.

    See Also
    --------
    read_records : Read the recording.
    data_quality : Faults of the measurement as a table.

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
      'y [um]' is at its largest value, 0.9, in 14 % of the rows: is it clipped?
    """
    name, columns, roles, faults = inspect_columns(path, **reading)
    X = y = None
    if {"drive", "response"} <= roles.keys():
        X, y = _read(path, reading | roles, faults)
    records = _records(X, y, faults)
    return RecordingOverview(name, columns, records, tuple(dict.fromkeys(faults)), X, y)


def _records(X, y, faults):
    try:
        records = () if X is None else record_slices(X, y, one_interval=False, bridge=True)
    except RecordError as error:
        faults.append(str(error))
        return ()
    faults += faults_of_records(X, y, records) if records else []
    return records


def faults_of_records(X, y, records):
    """Return sentences on the faults of the response and the clock of each record."""
    found = []
    for record, name in zip(records, record_names(records), strict=True):
        if record.lost:
            found.append(
                f"record {name} has lost {len(record.lost)} of "
                f"{record.n_samples + len(record.lost)} rows: a model runs on through them, and "
                "they are not scored"
            )
        where = f"record {name}: " if len(records) > 1 else ""
        drive, response = X.iloc[record.rows, 0], y.iloc[record.rows]
        faults = list(_clipped(y.name, response.to_numpy()))
        # what holds for all records is a fault of the column
        for one, whole in ((drive, X.iloc[:, 0]), (response, y)):
            if not np.ptp(one) and np.ptp(whole):
                faults.append(f"{one.name!r} does not move: it is {one.iloc[0]:g} throughout.")
        if (
            np.array_equal(drive, response)
            and np.ptp(drive)
            and not np.array_equal(X.iloc[:, 0], y)
        ):
            faults.append(f"{drive.name!r} and {response.name!r} are the same signal.")
        found += [f"{where}{fault}" for fault in faults]
    table = data_quality(X, y, records)
    for row in table[~table["fault"].isin(_SAID)].itertuples():
        where = f"record {row.record}: " if len(records) > 1 else ""
        value = "" if np.isnan(row.value) else f" ({row.value:.6g})"
        found.append(
            f"{where}{row.fault.replace('_', ' ')}{value} in {row.n_samples} of the rows, from row "
            f"{row.rows[0]}: {row.advice}"
        )
    return found


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


def _read(path, options, faults):
    """Return X and y, interpolated where readings are lost; errors are added to the faults."""
    try:
        return read_records(path, **options)
    except RecordError as error:
        faults.append(str(error))
    try:
        return read_records(path, **options | {"on_missing": "interpolate"})
    except RecordError:
        return None, None
