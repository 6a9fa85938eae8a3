"""Stack records into one frame, and iterate over the records of a frame."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, overload

import numpy as np
import pandas as pd

from ..exceptions import RecordError
from ._index import (
    MISMATCH,
    record_slices,
    refuse_lost_index,
    refuse_masked,
    time_level,
    time_stamps,
    valid_interval,
)


def iter_records(X, y=None, *, dt=None) -> Iterator[tuple]:
    """Iterate over the records.

    Parameters
    ----------
    X : array-like or DataFrame of shape (n_samples, n_inputs)
        Input with the time in its index, as in :func:`record_slices`.
    y : array-like or Series of shape (n_samples,), optional
        Response.
    dt : float or None, default=None
        Interval in s where the index counts samples or is absent.

    Yields
    ------
    label : hashable
        Label of the record; the pieces on both sides of a gap share it.
    X_part : of the type of ``X``, shape (n_record, n_inputs)
        Rows of the record.
    y_part : of the type of ``y``, shape (n_record,), or None
        Response in the record, None where no ``y`` was given.

    Raises
    ------
    RecordError
        If the rows do not form evenly sampled records, or ``y`` has another number of rows.

    See Also
    --------
    stack_records : The inverse.
    record_slices : Rows and sampling intervals of the records.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.records import iter_records, stack_records
    >>> X = stack_records([np.zeros(2), np.zeros(3)], labels=["slow", "fast"], dt=0.1)
    >>> [(label, len(part)) for label, part, _ in iter_records(X)]
    [('slow', 2), ('fast', 3)]
    """
    X, y = _rowed(X), _rowed(y)
    refuse_lengths(X, y, "iter_records")
    for record in record_slices(X, y, dt=dt, one_interval=False):
        part = None if y is None else _take(y, record.rows)
        yield record.label, _take(X, record.rows), part


def _rowed(values):
    return values if values is None or hasattr(values, "shape") else np.asarray(values)


def _take(values, rows):
    return values.iloc[rows] if hasattr(values, "iloc") else values[rows]


def refuse_lengths(X, y, caller):
    """Raise a RecordError if X and y have different lengths."""
    if y is not None and X.shape[0] != y.shape[0]:
        raise RecordError(
            f"X and y of {caller} must have equally many rows. Got {X.shape[0]} and {y.shape[0]} "
            f"instead."
        )


@overload
def stack_records(
    records: Iterable[tuple] | Mapping[Any, tuple], labels=None, *, dt=None
) -> tuple[pd.DataFrame, pd.Series]: ...
@overload
def stack_records(records, labels=None, *, dt=None) -> pd.DataFrame: ...
def stack_records(records, labels=None, *, dt=None):
    """Stack records into one frame and one series, whose index has the levels record and time.

    Parameters
    ----------
    records : sequence or dict of (X, y) or of X
        The records, in a dict by their labels. ``X`` is a frame, or an array of shape
        (n_samples,) or (n_samples, n_inputs); ``y`` is a series or an array of shape
        (n_samples,). Time indexes are kept. Frames that have a record level already may be
        stacked again and keep their labels.
    labels : sequence of hashable, optional
        One label per record; by default the labels that the records have, or 0, 1, ...
    dt : float, optional
        Sampling interval in s of the records without times. By default their time level counts
        samples, whose interval is then the ``dt`` of the model. If all records have times, it must
        not contradict them.

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
        If there are no records, labels repeat, the records differ in their columns or in the type
        of their times, ``X`` and ``y`` differ in their lengths or indexes, or times are not in s.

    See Also
    --------
    iter_records : The inverse.
    read_records : Records from files.

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
                f"The 'labels' parameter of stack_records must hold one label per record, "
                f"{len(records)} in all. Got {len(labels)} instead."
            )
    if dt is not None:
        valid_interval(dt, "stack_records")
    paired = [_is_pair(record) for record in records]
    if any(paired) != all(paired) or any(len(r) != 2 for r in records if isinstance(r, tuple)):
        raise RecordError(
            "The 'records' parameter of stack_records must hold pairs (X, y) throughout, or X "
            "throughout. Got a mixture instead."
        )
    parts, seen, intervals = [], set(), []
    for number, record in enumerate(records):
        x, y = record if paired[0] else (record, None)
        frame, label = as_frame(x), number if labels is None else labels[number]
        if y is not None:
            given, y = y, as_series(y)
            refuse_lengths(frame, y, f"record {label!r}")
            refuse_lost_index(x, given)
        intervals.append(_median_interval(frame))
        index = _stacked_index(frame, label, labels is not None, dt)
        new = set(index.get_level_values("record").unique())
        if seen & new:
            raise RecordError(
                f"The labels of the records must differ. Got {sorted(map(str, seen & new))} twice "
                f"instead; give the 'labels' parameter of stack_records."
            )
        seen |= new
        parts.append((frame.set_axis(index), None if y is None else y.set_axis(index)))
    contradicted = dt is not None and None not in intervals
    if contradicted and np.any(np.abs(np.subtract(intervals, dt)) > MISMATCH * dt):
        raise RecordError(
            f"The 'dt' parameter of stack_records must not contradict the times of the records. "
            f"Got {dt!r}, and intervals of {min(intervals):.6g} to {max(intervals):.6g} s in their "
            "indexes, instead; leave it out, or give arrays."
        )
    frames = [frame for frame, _ in parts]
    _refuse_differences(frames)
    X = pd.concat(frames)
    return (X, pd.concat([y for _, y in parts])) if paired[0] else X


def _is_pair(record):
    if isinstance(record, list) and any(map(np.iterable, record)):
        raise RecordError(
            "The 'records' parameter of stack_records must hold pairs as tuples (X, y), and arrays "
            "or frames as they are. Got a list of arrays or lists instead."
        )
    return isinstance(record, tuple)


def as_frame(x):
    """Return a frame unchanged, and a series, a table or an array (1-D or 2-D) as a frame."""
    if isinstance(x, pd.DataFrame):
        return x
    if isinstance(x, pd.Series):
        return x.to_frame("drive" if x.name is None else x.name)
    # names of an Arrow table or of a polars frame
    columns = getattr(x, "column_names", getattr(x, "columns", None))
    refuse_masked("X", x)
    x = np.asarray(x)
    if x.ndim == 1:
        x = x[:, None]
    if x.ndim != 2:
        raise RecordError(
            f"The records of stack_records must be of one or two dimensions. Got an array of shape "
            f"{x.shape} instead."
        )
    names = columns or ["drive", *(f"auxiliary{i}" for i in range(1, x.shape[1]))]
    return pd.DataFrame(x, columns=names[: x.shape[1]])


def as_series(y):
    """Return a response as a series, named "response" if it has no name."""
    if not isinstance(y, pd.Series):
        refuse_masked("y", y)
        y = np.asarray(y)
        if y.ndim == 2 and y.shape[1] == 1:
            y = y[:, 0]
        if y.ndim != 1:
            raise RecordError(f"A response must have one dimension. Got shape {y.shape} instead.")
        y = pd.Series(y)
    return y.rename("response") if y.name is None else y


def _median_interval(frame):
    """Return the median interval of the times of a frame in s, None without times."""
    stamps = time_stamps(frame.index)  # refuses other units, and rows without a label or a time
    if stamps.counts or len(frame) < 2:
        return None
    return float(np.median(np.diff(stamps.values))) * stamps.unit


def _stacked_index(frame, label, relabel, dt):
    """Return the index (record, time) of one frame in the stack."""
    times, labels = frame.index, [label] * len(frame)
    if isinstance(times, pd.MultiIndex):
        level = time_level(times)
        given = times.get_level_values(1 - level)
        if relabel and given.nunique() > 1:
            raise RecordError(
                f"The 'labels' parameter of stack_records must be left out for frames that hold "
                f"several records. Got {label!r} for records {list(given.unique())} instead."
            )
        times, labels = times.get_level_values(level), labels if relabel else given
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
