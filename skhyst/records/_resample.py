"""Resample records onto an even grid, and estimate the resulting error."""

from itertools import pairwise
from numbers import Real
from typing import Any, overload

import numpy as np
import pandas as pd
from scipy.signal import butter, sosfiltfilt

from ..exceptions import RecordError
from ..io import describe_rows
from ._frames import as_frame, as_series, refuse_lengths
from ._index import (
    BRIDGED,
    GAP,
    record_slices,
    refuse_lost_index,
    time_stamps,
    valid_interval,
)

FILTER_ORDER = 8
PASSED = 0.8  # cut-off of the anti-alias filter as a fraction of the new Nyquist frequency


@overload
def resample_records(X, y: None = None, *, dt, max_gap=None, anti_alias=True) -> pd.DataFrame: ...
@overload
def resample_records(
    X, y: Any, *, dt, max_gap=None, anti_alias=True
) -> tuple[pd.DataFrame, pd.Series]: ...
def resample_records(X, y=None, *, dt, max_gap=None, anti_alias=True):
    """Resample records onto an even grid by linear interpolation.

    The grid of each record starts at its first sample. Before resampling to a coarser grid, a
    Butterworth low-pass at 0.8 of the new Nyquist frequency is run forwards and backwards over
    every column, which prevents aliasing and has zero phase. :func:`resampling_error` estimates the
    error that linear interpolation makes in a response.

    Parameters
    ----------
    X : array-like or DataFrame of shape (n_samples, n_inputs)
        Input. Its index may be sampled unevenly, and differently in every record. Data that count
        samples are returned unchanged by "auto" if none are missing, and refused otherwise.
    y : array-like or Series of shape (n_samples,), optional
        Response.
    dt : float or "auto"
        New sampling interval in s. "auto" takes the smallest median interval of all records, times
        the largest power of 2 (1, 2, 4, ...) that stays within the record's own median interval:
        records with similar sampling share an interval, and no filter is needed. If all records are
        even already, nothing is changed.
    max_gap : float, optional
        Longer gaps, in s, start a new record and are not filled. By default five median intervals
        of the record, and never less than 1.5 ``dt``.
    anti_alias : bool, default=True
        Whether to filter before resampling to a coarser grid.

    Returns
    -------
    X : DataFrame of shape (n_new, n_inputs)
        The index has the levels ``record`` and ``time``; datetimes and timedeltas stay such.
    y : Series of shape (n_new,)
        Only where ``y`` was given.

    Raises
    ------
    RecordError
        If a value is NaN or infinite, rows are shuffled or repeated, a record is shorter than two
        samples of the old or the new interval, ``y`` has an index with records that ``X`` lacks, or
        ``X`` is to be changed and has no times.

    See Also
    --------
    resampling_error : The error of the interpolation.
    resample_like : Back onto the original times.

    Examples
    --------
    >>> import pandas as pd
    >>> from skhyst.records import resample_records
    >>> X = pd.DataFrame({"drive": [0.0, 1.0, 3.0]}, index=[0.0, 0.1, 0.3])
    >>> resample_records(X, dt=0.1)["drive"].round(6).tolist()
    [0.0, 1.0, 2.0, 3.0]
    """
    if dt != "auto":
        valid_interval(dt, "resample_records")
    if max_gap is not None and not (isinstance(max_gap, Real) and max_gap > 0):
        raise RecordError(
            f"The 'max_gap' parameter of resample_records must be positive. Got {max_gap!r} "
            f"instead."
        )
    frame, series = as_frame(X), None if y is None else as_series(y)
    refuse_lengths(frame, series, "resample_records")
    if series is not None:
        refuse_lost_index(X, y)
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
    if dt == "auto" and _is_even(frame):
        return frame if series is None else (frame, series.set_axis(frame.index))
    labels, times, values = [], [], []
    for label, start, stop, interval in _resampled_pieces(stamps, dt, max_gap):
        # relative to the first sample: as floats, times since 1970 are only exact to 2e-7 s
        seconds = (stamps.values[start:stop] - stamps.values[start]) * stamps.unit
        part = _regrid(seconds, table[start:stop], interval, anti_alias and dt != "auto")
        if len(part) < 2:
            raise RecordError(
                f"The 'dt' parameter of resample_records must be at most the length of every "
                f"record. Got {dt!r}, and {seconds[-1]:.6g} s in record {label!r}, rows {start} to "
                f"{stop - 1}, instead; drop this record or take a smaller 'dt'."
            )
        labels.extend([label] * len(part))
        times.append(_labels_of_time(stamps, start, interval * np.arange(len(part))))
        values.append(part)
    index = pd.MultiIndex.from_arrays([labels, np.concatenate(times)], names=["record", "time"])
    values = np.concatenate(values)
    n_inputs = frame.shape[1]
    new = pd.DataFrame(values[:, :n_inputs], index=index, columns=names[:n_inputs])
    if series is None:
        return new
    return new, pd.Series(values[:, n_inputs], index=index, name=names[n_inputs])


def resampling_error(X, y, *, dt="auto", max_gap=None) -> float:
    r"""Return an estimate of the error that :func:`resample_records` makes in a response.

    Linear interpolation between two readings, at the distances a and b from a point between them,
    has the error :math:`\tfrac12 y'' a b`. So has interpolation across a reading that is left out,
    where the error is known. With lines between the two neighbours of a reading (m = 1), and
    between the neighbour on one side and the second neighbour on the other (m = 2), the mean
    squares

    .. math:: \overline{d_m^2} = \tfrac14 \overline{{y''}^2}\;\overline{a_m^2 b_m^2}
       + \sigma^2\, \overline{1 + (a_m^2 + b_m^2) / (a_m + b_m)^2}

    give the mean squares of the second derivative :math:`y''` and of white noise :math:`\sigma`;
    the former gives the error at the points of the grid, without the noise.

    Parameters
    ----------
    X : array-like or DataFrame of shape (n_samples, n_inputs)
        Input before resampling; its index has the times of the readings.
    y : array-like or Series of shape (n_samples,)
        Response.
    dt : float or "auto", default="auto"
        As for :func:`resample_records`. The effect of its anti-alias filter is not included.
    max_gap : float, optional
        As for :func:`resample_records`.

    Returns
    -------
    float
        Root mean square error over the grid, units of the response; 0 if all its points are
        readings.

    See Also
    --------
    resample_records : The interpolation.

    Notes
    -----
    The estimate tends to be too small if there are few readings per period, and more so if the
    response has kinks or jumps between readings; a transient that ends before the next reading is
    not seen at all. The second derivative is assumed independent of the spacing: if the response
    was read more often where it is more curved, the true error is smaller. Slow noise counts as
    response.

    Examples
    --------
    >>> import numpy as np
    >>> import pandas as pd
    >>> from skhyst.records import resampling_error
    >>> times = np.cumsum(np.random.default_rng(0).uniform(0.5, 1.5, 2000)) * 0.01
    >>> y = np.sin(20.0 * times)
    >>> print(f"{resampling_error(pd.DataFrame({'drive': y}, times), y):.4f}")
    0.0035
    """
    frame, series = as_frame(X), as_series(y)
    refuse_lengths(frame, series, "resampling_error")
    stamps, values = time_stamps(frame.index), series.to_numpy(dtype=float)
    if dt == "auto" and _is_even(frame):
        return 0.0
    total, count = 0.0, 0
    for _, start, stop, interval in _resampled_pieces(stamps, dt, max_gap):
        seconds = (stamps.values[start:stop] - stamps.values[start]) * stamps.unit
        grid = _grid(seconds, interval)
        before = np.clip(np.searchsorted(seconds, grid) - 1, 0, len(seconds) - 2)
        products = np.maximum((grid - seconds[before]) * (seconds[before + 1] - grid), 0.0)  # a b
        # distances of 1e-6 of an interval are rounding of the times
        products[products < 1e-6 * interval * interval] = 0.0
        total += 0.25 * _curvature(seconds, values[start:stop]) * np.sum(products**2)
        count += len(grid)
    return float(np.sqrt(total / count))


def _is_even(frame):
    """Whether all records are even."""
    try:
        record_slices(frame, one_interval=False, bridge=True)
    except RecordError:
        return False
    return True


def _curvature(seconds, values):
    """Return the mean square of the second derivative of a signal with white noise."""
    if len(seconds) < 4:
        return 0.0
    rows = []
    for neighbours in (((1, 1),), ((1, 2), (2, 1))):
        parts = [_left_out(seconds, values, *steps) for steps in neighbours]
        rows.append([np.mean(np.concatenate(column)) for column in zip(*parts, strict=True)])
    (m1, k1, d1), (m2, k2, d2) = rows
    curvature = (d2 * k1 - d1 * k2) / (m2 * k1 - m1 * k2)
    return float(np.clip(curvature, 0.0, d1 / m1))


def _left_out(seconds, values, back, ahead):
    """Return the coefficients of the mean squares of y'' and noise, and the squared error itself.

    The error is that of a line between the readings ``back`` before and ``ahead`` after a reading,
    at that reading.
    """
    places = np.arange(back, len(seconds) - ahead)
    a, b = seconds[places] - seconds[places - back], seconds[places + ahead] - seconds[places]
    line = (b * values[places - back] + a * values[places + ahead]) / (a + b)
    noise = 1.0 + (a**2 + b**2) / (a + b) ** 2
    return 0.25 * (a * b) ** 2, noise, np.square(values[places] - line)


def resample_like(y, X) -> np.ndarray:
    """Interpolate a resampled series back onto the times of the original rows.

    Parameters
    ----------
    y : Series of shape (n_new,)
        With the index that :func:`resample_records` returned.
    X : DataFrame of shape (n_samples, n_inputs)
        The original rows, before resampling.

    Returns
    -------
    ndarray of shape (n_samples,)
        Beyond the ends of a record's grid, the value at its end.

    See Also
    --------
    resample_records : Resample onto an even grid.

    Examples
    --------
    >>> import pandas as pd
    >>> from skhyst.records import resample_like, resample_records
    >>> X = pd.DataFrame({"drive": [0.0, 1.0, 3.0]}, index=[0.0, 0.1, 0.3])
    >>> resample_like(resample_records(X, dt=0.1)["drive"], X).round(6)
    array([0., 1., 3.])
    """
    stamps, grid = time_stamps(X.index), time_stamps(y.index)
    wanted, known = pairwise(stamps.runs()), pairwise(grid.runs())
    values, interpolated = y.to_numpy(dtype=float), []
    for (a, b), (c, d) in zip(wanted, known, strict=True):
        times = grid.values[c:d] * grid.unit
        interpolated.append(np.interp(stamps.values[a:b] * stamps.unit, times, values[c:d]))
    return np.concatenate(interpolated)


def _resampled_pieces(stamps, dt, max_gap):
    """Yield (label, start, stop, new interval in s) of each piece that is interpolated as one."""
    if stamps.counts:
        raise RecordError(
            f"The index of X must have times to resample at {dt!r}. Got an array or an index of "
            "integers, which count samples, instead; give times in seconds as floats, or call "
            "skhyst.records.stack_records with 'dt', the interval of the data."
        )
    runs = list(pairwise(stamps.runs()))
    for run, (start, stop) in enumerate(runs):
        if stop - start < 2:
            raise RecordError(
                f"A record must have at least two samples. Got record "
                f"{stamps.label(start, run)!r} with one, row {start}, instead; drop it."
            )
    medians = [float(np.median(np.diff(stamps.values[a:b]))) * stamps.unit for a, b in runs]
    for run, (start, stop) in enumerate(runs):
        interval, limit = dt, max_gap
        if dt == "auto":  # medians that differ by rounding are equal
            interval = min(medians) * 2.0 ** np.floor(np.log2(medians[run] / min(medians) + 1e-6))
        if limit is None:
            limit = BRIDGED * medians[run]
        for a, b in pairwise(stamps.cuts(start, stop, max(limit, GAP * interval))):
            span = (stamps.values[b - 1] - stamps.values[a]) * stamps.unit
            # a single row leaves nothing to interpolate
            if b - a > 1 and not (dt == "auto" and span < interval):
                yield stamps.label(a, run), a, b, interval


def _regrid(seconds, table, dt, anti_alias):
    """Interpolate onto multiples of ``dt``, after the anti-alias filter if these are coarser."""
    interval = float(np.median(np.diff(seconds)))
    if anti_alias and dt > (1 + 1e-6) * interval:
        even = np.linspace(0.0, seconds[-1], max(round(seconds[-1] / interval), 1) + 1)
        table = _interpolated(even, seconds, table)
        low_pass = butter(FILTER_ORDER, PASSED * even[1] / dt, output="sos")
        padding = min(round(10 * dt / even[1]), len(even) - 1)
        table = sosfiltfilt(low_pass, table, axis=0, padlen=padding)
        seconds = even
    return _interpolated(_grid(seconds, dt), seconds, table)


def _grid(seconds, dt):
    return dt * np.arange(int(np.floor(seconds[-1] / dt + 1e-6)) + 1)


def _interpolated(grid, seconds, table):
    return np.column_stack([np.interp(grid, seconds, column) for column in table.T])


def _labels_of_time(stamps, start, seconds):
    if stamps.dtype.kind not in "mM":
        return stamps.values[start] * stamps.unit + seconds
    first = pd.Index(stamps.values[start : start + 1]).astype(stamps.dtype)[0]
    return first + pd.to_timedelta(np.round(seconds * 1e9).astype(np.int64), unit="ns")
