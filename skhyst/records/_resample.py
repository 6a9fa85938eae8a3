"""Bring records to an even sampling."""

from itertools import pairwise
from numbers import Real

import numpy as np
import pandas as pd
from scipy.signal import butter, sosfiltfilt

from ..exceptions import RecordError
from ._frames import as_frame, as_series, refuse_lengths
from ._index import GAP, describe_rows, refuse_interval, time_stamps

FILTER_ORDER = 8
PASSED = 0.8  # part of the new Nyquist frequency that the anti-alias filter passes
BRIDGED = 5.0  # uneven records are interpolated over at most this many median intervals


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
    refuse_interval(dt, "resample_records")
    if max_gap is not None and not (isinstance(max_gap, Real) and max_gap > 0):
        raise RecordError(
            f"The 'max_gap' parameter of resample_records must be positive. Got {max_gap!r} "
            f"instead."
        )
    frame, series = as_frame(X), None if y is None else as_series(y)
    refuse_lengths(frame, series, "resample_records")
    names = [*frame.columns, *([] if series is None else [series.name])]
    columns = [frame] if series is None else [frame, series.to_numpy()[:, None]]
    table = np.hstack([np.asarray(part, dtype=float) for part in columns])
    bad = np.flatnonzero(~np.isfinite(table).all(axis=1))
    if bad.size:
        raise RecordError(
            f"The values of resample_records must be finite. Got {describe_rows(bad)} with NaN or "
            f"infinite values instead; drop them, or read with on_missing='interpolate'."
        )
    stamps = time_stamps(frame.index)
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
