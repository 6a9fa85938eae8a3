"""An index taken apart: times as numbers, labels as codes, and the runs that they form."""

import dataclasses
from collections.abc import Hashable
from typing import Any

import numpy as np
import pandas as pd

from ..exceptions import RecordError

GAP = 1.5  # an interval longer than this many sampling intervals separates two records
UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}

SPLITTERS = (
    "Use a splitter that keeps rows together and in order, skhyst.model_selection.RecordKFold or "
    "BlockedTimeSeriesSplit, in place of train_test_split or KFold(shuffle=True)"
)


@dataclasses.dataclass(frozen=True)
class TimeStamps:
    """An index taken apart: numbers for time, and the record that each row belongs to.

    ``values * unit`` are seconds. ``codes`` is None for an index without a record level, else
    ``labels[codes]`` are the labels of the rows. ``dtype`` is that of the time labels, and
    ``counts`` marks integers that count samples.
    """

    values: np.ndarray
    unit: float
    dtype: Any
    counts: bool = False
    codes: np.ndarray | None = None
    labels: pd.Index | None = None

    def runs(self) -> list[int]:
        """Return the bounds of the runs, ``[0, ..., n_samples]``; refuse repeats and shuffles."""
        values, n = self.values, self.values.size
        steps = np.diff(values)
        codes = np.zeros(n) if self.codes is None else self.codes
        same = codes[1:] == codes[:-1]
        repeats = np.flatnonzero(same & (steps == 0))
        if repeats.size:
            raise RecordError(
                f"Rows {repeats[0]} and {repeats[0] + 1} have the same time, and so have "
                f"{repeats.size} pair(s) of rows in all. Remove repeated rows; if the time stamps "
                f"are too coarse, replace them by row number times interval."
            )
        bounds = np.concatenate(([0], np.flatnonzero(~same | (steps < 0)) + 1, [n]))
        if bounds.size > 2:
            self._refuse_shuffled(bounds)
        return bounds.tolist()

    def _refuse_shuffled(self, bounds):
        single = np.flatnonzero(np.diff(bounds) == 1)
        if self.codes is not None and single.size:
            codes = self.codes[bounds[:-1]]
            single = single[np.bincount(codes)[codes[single]] > 1]
        if single.size:
            raise RecordError(
                f"The rows are not in the order of time: row {bounds[single[0]]} is out of place, "
                f"and {single.size} row(s) in all. {SPLITTERS}; X.sort_index() restores the order "
                f"of an index with a record level."
            )

    def label(self, row, run) -> Hashable:
        """Return the label of a row that lies in the given run."""
        if self.codes is None:
            return run
        label = self.labels[self.codes[row]]
        return label.item() if isinstance(label, np.generic) else label

    def cuts(self, start, stop, longest=None) -> list[int]:
        """Return the bounds of the pieces of a run; ``longest`` is the longest interval, in s."""
        steps = np.diff(self.values[start:stop])
        if steps.size == 0:
            return [start, stop]
        if longest is not None:
            longest = longest / self.unit
        elif self.counts:
            longest = GAP
        elif steps.max() * steps.size <= GAP * steps.sum():
            return [start, stop]  # the longest is near the mean, and so it is near the median
        else:
            longest = GAP * float(np.median(steps))
        gaps = np.flatnonzero(steps > longest) + start + 1
        return [start, *gaps.tolist(), stop]


def time_stamps(X, dt=1.0) -> TimeStamps:
    """Take the index of ``X`` apart; integers, and arrays, count samples of interval ``dt``."""
    index = getattr(X, "index", None)
    if not isinstance(index, pd.Index):
        return TimeStamps(np.arange(n_rows(X)), dt, np.dtype(np.int64), counts=True)
    if not isinstance(index, pd.MultiIndex):
        return _numbers(index, dt)
    level = time_level(index)
    codes = np.asarray(index.codes[1 - level])
    if (codes < 0).any():
        rows = describe_rows(np.flatnonzero(codes < 0))
        raise RecordError(f"Every row must have a record label. Got {rows} without one instead.")
    stamps = _numbers(index.levels[level], dt, index.codes[level])
    return dataclasses.replace(stamps, codes=codes, labels=index.levels[1 - level])


def time_level(index) -> int:
    """Return which level of a MultiIndex is the time; the other one is the record."""
    if index.nlevels != 2:
        raise RecordError(
            f"The index of X must have the levels 'record' and 'time'. Got {index.nlevels} levels "
            f"{list(index.names)} instead; merge or drop the others (X.droplevel)."
        )
    return list(index.names).index("time") if "time" in index.names else 1


def n_rows(X) -> int:
    """Return the number of rows of a frame, an array or a list."""
    return X.shape[0] if hasattr(X, "shape") else len(X)


def _numbers(times, dt, codes=None):
    """Turn time labels into numbers; ``codes`` are the positions in a level of a MultiIndex."""
    dtype = times.dtype
    counts = pd.api.types.is_integer_dtype(dtype)
    if dtype.kind in "mM":
        values, unit = times.asi8, UNITS[times.unit]
    elif pd.api.types.is_float_dtype(dtype):
        values, unit = times.to_numpy(dtype=float, na_value=np.nan), 1.0
    elif counts:
        values, unit = times.to_numpy(dtype=np.int64), dt
    else:
        raise RecordError(
            f"The time in the index of X must be seconds, datetimes, timedeltas or integers that "
            f"count samples. Got values of type {dtype} instead; X.reset_index(drop=True) makes "
            f"one record of the rows, skhyst.records.stack_records builds an index."
        )
    missing = times.isna() if values.dtype.kind == "i" else ~np.isfinite(values)
    if codes is not None:
        codes = np.asarray(codes)
        if values.size:
            values, missing = values[codes], missing[codes] | (codes < 0)
        else:
            values, missing = np.zeros(codes.size), np.ones(codes.size, dtype=bool)
    if missing.any():
        rows = describe_rows(np.flatnonzero(missing))
        raise RecordError(
            f"The time in the index of X must be finite. Got {rows} without a finite time instead; "
            f"drop these rows."
        )
    return TimeStamps(values, unit, dtype, counts)


def describe_rows(rows, most=5) -> str:
    """Return ``"3 row(s) (4, 7, 9)"``, with the first few numbers."""
    shown = ", ".join(str(row) for row in rows[:most])
    return f"{len(rows)} row(s) ({shown}{', ...' if len(rows) > most else ''})"
