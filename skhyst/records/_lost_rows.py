"""Rows that a recording has lost, restored on the even grid of their record by interpolation."""

from dataclasses import replace

import numpy as np
import pandas as pd

from ._index import record_slices, time_level, time_stamps


def with_lost_rows(slices, *signals):
    """Return records and signals with lost rows restored.

    The values are interpolated linearly: unlike a smooth curve, a straight line adds no turning
    point beyond the readings, which would stay in the memory of a hysteresis.

    Parameters
    ----------
    slices : sequence of RecordSlice
        As :func:`record_slices` gives them with ``bridge=True``.
    *signals : ndarray of shape (n_samples,) or (n_samples, n)
        In the order of the rows.

    Returns
    -------
    slices : tuple of RecordSlice
        None has lost rows.
    *signals : ndarray
        On the rows of these.
    read : ndarray of bool, or None
        Which of the rows were read; None if all of them were.

    Examples
    --------
    >>> import numpy as np
    >>> import pandas as pd
    >>> from skhyst.records import record_slices, with_lost_rows
    >>> drive = pd.Series(np.arange(40.0), 0.1 * np.arange(40)).drop(0.1 * 7)
    >>> slices, u, read = with_lost_rows(record_slices(drive, bridge=True), drive.to_numpy())
    >>> len(slices), u[7], np.flatnonzero(~read)
    (1, np.float64(7.0), array([7]))
    """
    if not any(record.lost for record in slices):
        return slices, *signals, None
    even, samples, start = [], [], 0
    for record in slices:
        n_samples = record.n_samples + len(record.lost)
        rows = slice(start, start + n_samples)
        even.append(replace(record, rows=rows, n_samples=n_samples, lost=()))
        samples.append(start + record.samples)
        start += n_samples
    positions = np.concatenate(samples)
    read = np.zeros(start, dtype=bool)
    read[positions] = True
    filled = []
    for signal in signals:
        columns = signal if signal.ndim > 1 else signal[:, None]
        grid_values = np.empty((start, columns.shape[1]))
        for column, values in zip(grid_values.T, columns.T, strict=True):
            column[:] = np.interp(np.arange(start), positions, values)
        grid_values[read] = columns
        filled.append(grid_values if signal.ndim > 1 else grid_values[:, 0])
    return tuple(even), *filled, read


def fill_lost_rows(X, y=None):
    """Return frames with lost rows restored, and a mask of the rows that were read.

    Parameters
    ----------
    X : DataFrame or array-like of shape (n_samples, n_inputs)
        The index of a frame contains the time, as in :func:`record_slices`; an array has lost no
        rows.
    y : array-like or Series of shape (n_samples,), optional
        Response.

    Returns
    -------
    X : DataFrame
        With interpolated rows; ``X`` itself if none is lost.
    y : Series or None
        On the rows of this.
    read : ndarray of bool, or None
        Which of the rows were read; None if all of them were.

    Examples
    --------
    >>> import numpy as np
    >>> import pandas as pd
    >>> from skhyst.records import fill_lost_rows
    >>> X = pd.DataFrame({"drive": np.arange(40.0)}, index=0.1 * np.arange(40)).drop(0.1 * 7)
    >>> whole, _, read = fill_lost_rows(X)
    >>> len(X), len(whole), np.flatnonzero(~read)
    (39, 40, array([7]))
    """
    if not hasattr(X, "iloc"):
        return X, y, None
    slices = record_slices(X, y, one_interval=False, bridge=True)
    if not any(record.lost for record in slices):
        return X, y, None
    stamps = time_stamps(X.index)
    first, dtype = stamps.values[0], stamps.values.dtype
    response = [] if y is None else [np.asarray(y, dtype=float)]
    signals = (stamps.values - first).astype(float), X.to_numpy(dtype=float)
    _, times, values, *response, read = with_lost_rows(slices, *signals, *response)
    exact = first + (np.rint(times).astype(dtype) if dtype.kind == "i" else times)
    exact[read] = stamps.values
    labels = pd.Index(exact).astype(stamps.dtype) if stamps.dtype.kind in "mM" else exact
    index = pd.Index(labels, name=X.index.name)
    if stamps.codes is not None:
        codes = stamps.codes[np.maximum(np.cumsum(read) - 1, 0)]
        level = time_level(X.index)
        levels = [stamps.labels[codes], labels]
        levels = levels if level == 1 else levels[::-1]
        index = pd.MultiIndex.from_arrays(levels, names=X.index.names)
    frame = pd.DataFrame(values, index, X.columns)
    if y is None:
        return frame, None, read
    return frame, pd.Series(response[0], index, name=getattr(y, "name", None)), read
