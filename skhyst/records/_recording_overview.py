"""Overview of a recording and its faults, before any model is fitted."""

from dataclasses import dataclass

import pandas as pd

from ..exceptions import RecordError
from ..io import inspect_columns
from ._index import record_names, record_slices
from ._read_records import read_records

_MOST = 100  # largest number of records that are printed


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
        constant, stay at their largest or smallest value, or are identical; text where numbers are
        expected; gaps, uneven or coarse times; and roles or units that cannot be determined from
        the file.

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
    for record, name in zip(records, record_names(records), strict=True):
        if record.lost:
            faults.append(
                f"record {name} has lost {len(record.lost)} of "
                f"{record.n_samples + len(record.lost)} rows: a model runs on through them, and "
                "they are not scored"
            )
    return records


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
