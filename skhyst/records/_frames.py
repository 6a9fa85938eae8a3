"""Put records together, take them apart, and bring them to an even sampling."""

from collections.abc import Mapping
from itertools import pairwise
from numbers import Real

import numpy as np
import pandas as pd
from scipy.signal import butter, sosfiltfilt

from ..exceptions import RecordError
from ._index import GAP, describe_rows, record_slices, sampling_interval, time_stamps

__all__ = ["iter_records", "resample_records", "sampling_interval", "stack_records"]

FILTER_ORDER = 8
PASSED = 0.8  # part of the new Nyquist frequency that the anti-alias filter passes
BRIDGED = 5.0  # uneven records are interpolated over at most this many median intervals


def iter_records(X, y=None, *, dt=1.0):
    """Iterate over the records.

    Parameters
    ----------
    X : array-like or DataFrame of shape (n_samples, n_inputs)
        Input whose index carries the time, as in :func:`record_slices`.
    y : array-like or Series of shape (n_samples,), optional
        Response.
    dt : float, default=1.0
        Interval in s where the index counts samples or is absent.

    Yields
    ------
    label : hashable
        Label of the record; the pieces on both sides of a hole share it.
    X_part : of the type of ``X``, shape (n_record, n_inputs)
        Rows of the record.
    y_part : of the type of ``y``, shape (n_record,), or None
        Response in the record, None where no ``y`` was given.

    Raises
    ------
    RecordError
        If the rows do not form evenly sampled records, or ``y`` has another number of rows.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.records import iter_records, stack_records
    >>> X = stack_records([np.zeros(2), np.zeros(3)], labels=["slow", "fast"], dt=0.1)
    >>> [(label, len(part)) for label, part, _ in iter_records(X)]
    [('slow', 2), ('fast', 3)]
    """
    X, y = _rowed(X), _rowed(y)
    _refuse_lengths(X, y, "iter_records")
    for record in record_slices(X, y, dt=dt):
        part = None if y is None else _take(y, record.rows)
        yield record.label, _take(X, record.rows), part


def _rowed(values):
    return values if values is None or hasattr(values, "shape") else np.asarray(values)


def _take(values, rows):
    return values.iloc[rows] if hasattr(values, "iloc") else values[rows]


def _refuse_lengths(X, y, caller):
    if y is not None and X.shape[0] != y.shape[0]:
        raise RecordError(
            f"X and y of {caller} must have equally many rows. Got {X.shape[0]} and {y.shape[0]} "
            f"instead."
        )


def stack_records(records, labels=None, *, dt=None):
    """Put records together into one frame and one series that know where each record ends.

    Parameters
    ----------
    records : sequence or dict of (X, y) or of X
        The records, in a dict by their labels. ``X`` is a frame, or an array of shape
        (n_samples,) or (n_samples, n_inputs); ``y`` is a series or an array of shape
        (n_samples,). Time indexes are kept. Frames that have a record level already may be
        stacked again and keep their labels.
    labels : sequence of hashable, optional
        One label a record; by default the labels that the records have, or 0, 1, ...
    dt : float, optional
        Sampling interval in s of the records without times. By default their time level counts
        samples, and the ``dt`` of a model says how long these are.

    Returns
    -------
    X : DataFrame of shape (n_samples, n_inputs)
        Rows of all records; the index has the levels ``record`` and ``time``. The columns of
        arrays are named ``drive``, ``auxiliary1``, ...
    y : Series of shape (n_samples,)
        Responses, only if the records are pairs.

    Raises
    ------
    RecordError
        If there are no records, labels repeat, or the records differ in their columns, in the type
        of their times, or in the lengths of ``X`` and ``y``.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.records import stack_records
    >>> u = np.linspace(0.0, 1.0, 3)
    >>> X, y = stack_records([(u, 2.0 * u), (u, 3.0 * u)], labels=["a", "b"], dt=0.1)
    >>> X.loc["b"]
          drive
    time
    0.0     0.0
    0.1     0.5
    0.2     1.0
    """
    if isinstance(records, Mapping):
        labels = list(records) if labels is None else labels
        records = list(records.values())
    records = list(records)
    if not records:
        raise RecordError("The 'records' parameter of stack_records must hold at least one record.")
    if labels is not None:
        labels = list(labels)
        if len(labels) != len(records):
            raise RecordError(
                f"The 'labels' parameter of stack_records must hold one label a record, "
                f"{len(records)} in all. Got {len(labels)} instead."
            )
    if dt is not None:
        _refuse_interval(dt, "stack_records")
    paired = [isinstance(record, tuple) for record in records]
    if any(paired) != all(paired) or any(len(r) != 2 for r in records if isinstance(r, tuple)):
        raise RecordError(
            "The 'records' parameter of stack_records must hold pairs (X, y) throughout, or X "
            "throughout. Got a mixture instead."
        )
    parts, seen = [], set()
    for number, record in enumerate(records):
        x, y = record if paired[0] else (record, None)
        frame, label = _frame(x), number if labels is None else labels[number]
        y = None if y is None else _series(y)
        _refuse_lengths(frame, y, f"record {label!r}")
        index = _stacked_index(frame, label, labels is not None, dt)
        own = set(index.get_level_values("record").unique())
        if seen & own:
            raise RecordError(
                f"The labels of the records must differ. Got {sorted(map(str, seen & own))} twice "
                f"instead; give the 'labels' parameter of stack_records."
            )
        seen |= own
        parts.append((frame.set_axis(index), None if y is None else y.set_axis(index)))
    frames = [frame for frame, _ in parts]
    _refuse_differences(frames)
    X = pd.concat(frames)
    return (X, pd.concat([y for _, y in parts])) if paired[0] else X


def _frame(x):
    if isinstance(x, pd.DataFrame):
        return x
    if isinstance(x, pd.Series):
        return x.to_frame("drive" if x.name is None else x.name)
    x = np.asarray(x)
    if x.ndim == 1:
        x = x[:, None]
    if x.ndim != 2:
        raise RecordError(
            f"The records of stack_records must be of one or two dimensions. Got an array of shape "
            f"{x.shape} instead."
        )
    return pd.DataFrame(x, columns=_default_names(x.shape[1]))


def _default_names(n_inputs):
    return ["drive", *(f"auxiliary{i}" for i in range(1, n_inputs))][:n_inputs]


def _series(y):
    if not isinstance(y, pd.Series):
        y = np.asarray(y)
        if y.ndim == 2 and y.shape[1] == 1:
            y = y[:, 0]
        if y.ndim != 1:
            raise RecordError(f"A response must have one dimension. Got shape {y.shape} instead.")
        y = pd.Series(y)
    return y.rename("response") if y.name is None else y


def _stacked_index(frame, label, relabel, dt):
    """Return the index of record and time that a single record gets."""
    times, labels = frame.index, [label] * len(frame)
    if isinstance(times, pd.MultiIndex):
        stamps = time_stamps(frame)
        level = 1 if "time" not in times.names else list(times.names).index("time")
        own = times.get_level_values(1 - level)
        if relabel and stamps.labels[np.unique(stamps.codes)].size > 1:
            raise RecordError(
                f"The 'labels' parameter of stack_records must be left out for frames that hold "
                f"several records. Got {label!r} for records {list(own.unique())} instead."
            )
        times, labels = times.get_level_values(level), labels if relabel else own
    if dt is not None and pd.api.types.is_integer_dtype(times.dtype):
        times = times.to_numpy() * float(dt)
    return pd.MultiIndex.from_arrays([labels, times], names=["record", "time"])


def _refuse_differences(frames):
    for frame in frames[1:]:
        if list(frame.columns) != list(frames[0].columns):
            raise RecordError(
                f"All records must have the same columns. Got {list(frames[0].columns)} and "
                f"{list(frame.columns)} instead; rename or select them."
            )
    kinds = {frame.index.levels[1].dtype.kind for frame in frames}
    if len(kinds) > 1:
        raise RecordError(
            "All records must have the same type of times. Got a mixture of sample counts, "
            "seconds, datetimes or timedeltas instead; give 'dt' to stack_records, or convert."
        )


def _refuse_interval(dt, caller):
    if not (isinstance(dt, Real) and 0 < dt < np.inf):
        raise RecordError(
            f"The 'dt' parameter of {caller} must be a positive number. Got {dt!r} instead."
        )


def resample_records(X, y=None, *, dt, max_gap=None, anti_alias=True):
    """Bring records to an even grid by linear interpolation.

    Every record starts its grid at its own first sample. Before a coarser grid, a Butterworth
    low-pass at 0.8 of the new Nyquist frequency runs forwards and backwards over every column, so
    that nothing folds back and no phase is lost.

    Parameters
    ----------
    X : array-like or DataFrame of shape (n_samples, n_inputs)
        Input. Its index may be sampled unevenly, and differently in every record; without one,
        rows are 1 s apart.
    y : array-like or Series of shape (n_samples,), optional
        Response.
    dt : float
        New sampling interval in s.
    max_gap : float, optional
        Longer gaps, in s, start a new record and are not filled. By default five median intervals
        of the record, and never less than 1.5 ``dt``.
    anti_alias : bool, default=True
        Whether to filter before a coarser grid.

    Returns
    -------
    X : DataFrame of shape (n_new, n_inputs)
        The index has the levels ``record`` and ``time``; datetimes and timedeltas stay such.
    y : Series of shape (n_new,)
        Only where ``y`` was given.

    Raises
    ------
    RecordError
        If a value is NaN or infinite, rows are shuffled or repeated, or a record is shorter than
        two samples of either sampling.

    Examples
    --------
    >>> import pandas as pd
    >>> from skhyst.records import resample_records
    >>> X = pd.DataFrame({"drive": [0.0, 1.0, 3.0]}, index=[0.0, 0.1, 0.3])
    >>> resample_records(X, dt=0.1)["drive"].round(6).tolist()
    [0.0, 1.0, 2.0, 3.0]
    """
    _refuse_interval(dt, "resample_records")
    if max_gap is not None and not (isinstance(max_gap, Real) and max_gap > 0):
        raise RecordError(
            f"The 'max_gap' parameter of resample_records must be positive. Got {max_gap!r} "
            f"instead."
        )
    frame, series = _frame(X), None if y is None else _series(y)
    _refuse_lengths(frame, series, "resample_records")
    names = [*frame.columns, *([] if series is None else [series.name])]
    columns = [frame] if series is None else [frame, series.to_numpy()[:, None]]
    table = np.hstack([np.asarray(part, dtype=float) for part in columns])
    bad = np.flatnonzero(~np.isfinite(table).all(axis=1))
    if bad.size:
        raise RecordError(
            f"The values of resample_records must be finite. Got {describe_rows(bad)} with NaN or "
            f"infinite values instead; drop them, or read with on_missing='interpolate'."
        )
    stamps = time_stamps(frame)
    labels, times, values = [], [], []
    for label, start, stop in _resampled_pieces(stamps, dt, max_gap):
        seconds = (stamps.values[start:stop] - stamps.values[start]) * stamps.unit
        part = _regrid(seconds, table[start:stop], dt, anti_alias)
        if len(part) < 2:
            raise RecordError(
                f"The 'dt' parameter of resample_records must be at most the length of every "
                f"record. Got {dt!r}, and {seconds[-1]:.6g} s in record {label!r}, rows {start} to "
                f"{stop - 1}, instead; drop this record or take a smaller 'dt'."
            )
        labels.extend([label] * len(part))
        times.append(_labels_of_time(stamps, start, dt * np.arange(len(part))))
        values.append(part)
    index = pd.MultiIndex.from_arrays([labels, np.concatenate(times)], names=["record", "time"])
    values = np.concatenate(values)
    n_inputs = frame.shape[1]
    new = pd.DataFrame(values[:, :n_inputs], index=index, columns=names[:n_inputs])
    if series is None:
        return new
    return new, pd.Series(values[:, n_inputs], index=index, name=names[n_inputs])


def _resampled_pieces(stamps, dt, max_gap):
    for run, (start, stop) in enumerate(pairwise(stamps.runs())):
        if stop - start < 2:
            raise RecordError(
                f"A record must have at least two samples. Got record "
                f"{stamps.label(start, run)!r} with one, row {start}, instead; drop it."
            )
        longest = max_gap
        if longest is None:
            longest = BRIDGED * float(np.median(np.diff(stamps.values[start:stop]))) * stamps.unit
        cuts = stamps.cuts(start, stop, max(longest, GAP * dt))
        for a, b in pairwise(cuts):
            if b - a > 1:  # a single row between two gaps holds no interval to interpolate in
                yield stamps.label(a, run), a, b


def _regrid(seconds, table, dt, anti_alias):
    """Interpolate onto multiples of ``dt``, and filter before that if they are the coarser ones."""
    interval = float(np.median(np.diff(seconds)))
    if anti_alias and dt > (1 + 1e-6) * interval:
        even = np.linspace(0.0, seconds[-1], max(round(seconds[-1] / interval), 1) + 1)
        table = _interpolated(even, seconds, table)
        low_pass = butter(FILTER_ORDER, PASSED * even[1] / dt, output="sos")
        padding = min(round(10 * dt / even[1]), len(even) - 1)
        table = sosfiltfilt(low_pass, table, axis=0, padlen=padding)
        seconds = even
    n_new = int(np.floor(seconds[-1] / dt + 1e-6)) + 1
    return _interpolated(dt * np.arange(n_new), seconds, table)


def _interpolated(grid, seconds, table):
    return np.column_stack([np.interp(grid, seconds, column) for column in table.T])


def _labels_of_time(stamps, start, seconds):
    if stamps.dtype.kind not in "mM":
        return stamps.values[start] * stamps.unit + seconds
    first = pd.Index(stamps.values[start : start + 1]).astype(stamps.dtype)[0]
    return first + pd.to_timedelta(np.round(seconds * 1e9).astype(np.int64), unit="ns")
