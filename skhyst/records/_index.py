"""Where records begin and end, and how they are sampled: the one place that reads an index.

The rows of ``X`` are cut in two passes. First into *runs*: a run ends where the record level
changes or time steps back (a single time index that restarts is a concatenation of recordings).
Then each run is cut at its *gaps*, the intervals longer than 1.5 times the run's median interval.
Each piece must be sampled evenly, and all of ``X`` at one interval.

A shuffled index steps back at about every second row, which leaves runs of a single row; this
distinguishes shuffling from concatenation. A random subset in the right order (``KFold`` with
``shuffle=True``) leaves single rows between gaps, or no common interval at all.

A short gap may be *lost rows* instead, for example of a dropped packet on a bus: a whole number of
sampling intervals, at most ``BRIDGED``, of a run that has lost at most ``MOST_LOST`` of its rows.
With ``bridge=True``, callers get one record with its missing samples instead of two records.
"""

import dataclasses
from collections.abc import Hashable
from itertools import pairwise
from numbers import Integral, Real
from typing import Any

import numpy as np
import pandas as pd

from ..exceptions import RecordError
from ..io import JITTER, SECONDS, describe_rows, time_unit_of

GAP = 1.5  # an interval longer than this many sampling intervals separates two records
# A straight line over k sampling intervals of a sine with n samples a period is wrong by up to
# (pi k / n)^2 / 2 of its amplitude: five intervals are one hundredth with n = 100.
BRIDGED = 5
MOST_LOST = 0.05  # of the rows of a run; more is left out by a shuffled fold, and is a subset
UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
# Longest interval in s; beyond it, or below its inverse, squares of second derivatives overflow.
LONGEST = 1e25
DRIFT = 1e-3  # deviation of the clock from a straight line, as a fraction of the record's duration
MISMATCH = 0.01  # relative difference between the intervals of two records

SPLITTERS = (
    "Use a splitter that keeps rows together and in order, skhyst.model_selection.RecordKFold or "
    "BlockedTimeSeriesSplit, in place of train_test_split or KFold(shuffle=True); a search that "
    "halves needs a parameter as its resource"
)


@dataclasses.dataclass(frozen=True)
class RecordSlice:
    """Rows of one record in ``X``, and how it is sampled.

    Parameters
    ----------
    label : hashable
        Value of the record level. Without a record level: how often time has restarted before this
        record, so that the parts on both sides of a hole have the same label.
    rows : slice
        Rows of the record.
    dt : float
        Sampling interval in s.
    start_time : float
        Time of the first sample in s; seconds since 1970 for a datetime index.
    n_samples : int
        Number of rows.
    time_unit : {"s", "sample"}, default="s"
        "sample" where neither the index nor ``dt`` gives the interval; it is then 1.
    lost : tuple of int, default=()
        Samples, counted from the start of the record, that have no row.

    See Also
    --------
    record_slices : Find the records of a recording.
    """

    label: Hashable
    rows: slice
    dt: float
    start_time: float
    n_samples: int
    time_unit: str = "s"
    lost: tuple[int, ...] = ()

    def __post_init__(self):
        if not (isinstance(self.dt, Real) and 0.0 < self.dt < np.inf):
            raise ValueError(
                "The 'dt' parameter of RecordSlice must be a finite number above zero. Got "
                f"{self.dt!r} instead."
            )
        ends = self.rows.start, self.rows.stop
        if not (
            all(isinstance(v, Integral) for v in (*ends, self.n_samples))
            and 0 <= self.n_samples == ends[1] - ends[0]
        ):
            raise ValueError(
                "The 'n_samples' parameter of RecordSlice must be the number of its 'rows'. "
                f"Got {self.n_samples!r} instead."
            )

    @property
    def samples(self) -> np.ndarray:
        """Sampling intervals since the start of the record, shape (n_samples,)."""
        return np.delete(np.arange(self.n_samples + len(self.lost)), self.lost)

    @property
    def duration(self) -> float:
        """Sampling intervals in s, one per sample, lost ones included."""
        return (self.n_samples + len(self.lost)) * self.dt

    @property
    def time(self) -> np.ndarray:
        """Time stamps in s, shape (n_samples,), uniform but for lost rows."""
        return self.start_time + self.dt * self.samples


def valid_interval(dt, caller) -> float:
    """Return ``dt`` as a float.

    Parameters
    ----------
    dt : object
        Should be a number of s, within ``LONGEST`` and its inverse.
    caller : str
        Name of the function with the parameter ``dt``, for the error message.

    Returns
    -------
    float

    Raises
    ------
    RecordError
        If it is none.
    """
    if not (isinstance(dt, Real) and 1.0 / LONGEST <= dt <= LONGEST):
        raise RecordError(
            f"The 'dt' parameter of {caller} must be a positive number of seconds, between "
            f"{1.0 / LONGEST:g} and {LONGEST:g}. Got {dt!r} instead."
        )
    return float(dt)


def record_slices(
    X, y=None, *, dt=None, one_interval=True, bridge=False
) -> tuple[RecordSlice, ...]:
    """Find the records in ``X``.

    A new record starts where the record level changes, where time steps back, or after a gap of
    more than 1.5 sampling intervals. Time stamps that are rounded by up to a tenth of an interval,
    and clocks that deviate from a straight line by less than 0.1 % of the duration, count as even.

    Parameters
    ----------
    X : array-like or DataFrame of shape (n_samples, n_inputs)
        The time is read from the index: a ``MultiIndex`` with the levels ``record`` and ``time``,
        or a single index of seconds (float), datetimes or timedeltas. Integers count samples, and
        a hole in them starts a new record; an array is one record without holes.
    y : array-like or Series of shape (n_samples,), optional
        Response. Its index must not have records or times that the index of ``X`` lacks.
    dt : float or None, default=None
        Sampling interval in s where the index counts samples or is absent; None: not known, time
        is in samples.
    one_interval : bool, default=True
        Whether all records must share one sampling interval.
    bridge : bool, default=False
        Whether a gap of at most five whole intervals is counted as lost rows of one record
        (``RecordSlice.lost``) instead of separating two, provided that at most 5 % of the rows are
        lost. For callers that handle missing samples.

    Returns
    -------
    tuple of RecordSlice
        In the order of the rows.

    Raises
    ------
    RecordError
        If rows are shuffled or repeated, a record is sampled unevenly or has a single sample, the
        records differ in their interval where they must not, or ``y`` has an index with records
        that ``X`` lacks.

    See Also
    --------
    iter_records : The parts of X and y themselves.
    sampling_interval : The interval alone.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.records import record_slices
    >>> [(r.rows, r.dt) for r in record_slices(np.zeros((5, 1)), dt=0.1)]
    [(slice(0, 5, None), 0.1)]
    """
    counted = "sample" if dt is None else "s"
    dt = 1.0 if dt is None else dt
    valid_interval(dt, "record_slices")
    dt = float(dt)
    refuse_masked("X", X)
    if y is not None:
        refuse_lost_index(X, y)
    index = getattr(X, "index", None)
    if not isinstance(index, pd.Index):
        index = pd.RangeIndex(len(X if hasattr(X, "__len__") else np.asarray(X)))
    if isinstance(index, pd.RangeIndex) and index.step == 1 and len(index):
        rows = slice(0, len(index))
        return (RecordSlice(0, rows, dt, index.start * dt, len(index), counted),)
    stamps = time_stamps(index, dt)
    if stamps.values.size == 0:
        return ()
    pieces = _pieces(stamps, bridge)
    intervals = _sampling_intervals(stamps, pieces, one_interval)
    unit, slices = counted if stamps.counts else "s", []
    for (run, start, stop, lost), interval in zip(pieces, intervals, strict=True):
        label, start_time = stamps.label(start, run), float(stamps.values[start] * stamps.unit)
        rows = slice(start, stop)
        n_samples = stop - start
        slices.append(RecordSlice(label, rows, interval, start_time, n_samples, unit, lost))
    return tuple(slices)


def sampling_interval(X, *, dt=None) -> float:
    """Return the sampling interval of ``X``.

    Parameters
    ----------
    X : array-like or DataFrame of shape (n_samples, n_inputs)
        Input whose index carries the time, as in :func:`record_slices`.
    dt : float or None, default=None
        Interval in s where the index counts samples or is absent; None: in samples.

    Returns
    -------
    float
        Interval in s, one for all records; 1 in samples.

    Raises
    ------
    RecordError
        If ``X`` has no rows, or its rows do not form evenly sampled records.

    See Also
    --------
    record_slices : Intervals and rows of all records.

    Examples
    --------
    >>> import pandas as pd
    >>> from skhyst.records import sampling_interval
    >>> sampling_interval(pd.DataFrame({"drive": [0.0, 1.0, 2.0]}, index=[0.0, 0.002, 0.004]))
    0.002
    """
    records = record_slices(X, dt=dt)
    if not records:
        raise RecordError("The 'X' parameter of sampling_interval must have rows. Got 0 instead.")
    return records[0].dt


def by_interval(records) -> dict[float, list[int]]:
    """Return which records have the same sampling interval.

    Parameters
    ----------
    records : sequence of RecordSlice
        Or any other objects with ``dt``, the sampling interval in s.

    Returns
    -------
    dict of float to list of int
        Indices of the records by interval, the shortest interval first.

    Examples
    --------
    >>> import pandas as pd
    >>> from skhyst.records import by_interval, record_slices
    >>> times = pd.MultiIndex.from_tuples([("a", 0.0), ("a", 0.5), ("b", 0.0), ("b", 0.1)])
    >>> by_interval(record_slices(pd.DataFrame({"drive": 0.0}, times), one_interval=False))
    {0.1: [1], 0.5: [0]}
    """
    intervals = sorted({record.dt for record in records})
    return {dt: [i for i, r in enumerate(records) if r.dt == dt] for dt in intervals}


def refuse_lost_index(X, y, name="y"):
    """Raise a RecordError if the index of y has records or times that the index of X lacks.

    ``name`` is the name of y in the message.
    """
    refuse_masked(name, y)
    X_index, y_index = getattr(X, "index", None), getattr(y, "index", None)
    if not isinstance(y_index, pd.Index) or _has_no_time(y_index):
        return
    if isinstance(X_index, pd.Index) and not isinstance(X_index, pd.RangeIndex):
        if len(X_index) == len(y_index) and not X_index.equals(y_index):
            raise RecordError(
                f"The index of X and that of {name} must be equal. Got rows in another order or "
                f"of another recording instead; align them ({name}.loc[X.index])."
            )
    elif not y_index.equals(X_index):
        raise RecordError(
            f"The index of X must carry the records and times that the index of {name} carries. "
            "Got an X without them instead: a step before this one has returned an array. Call "
            'set_output(transform="pandas") on that step or on the pipeline, or pass '
            f"{name}.to_numpy() if the rows are one record."
        )


def refuse_masked(name, values):
    """Raise a RecordError if values are masked, which arithmetic of arrays would not see."""
    if np.ma.is_masked(values):
        raise RecordError(
            f"The values of {name} must be known. Got {np.ma.count_masked(values)} masked ones "
            "instead: leave out their rows, of frames with a time in the index, or weigh rows "
            "without a response by a 'sample_weight' of zero."
        )


def _has_no_time(index):
    """Whether an index has neither records nor times: consecutive integers, or other labels."""
    if isinstance(index, pd.MultiIndex):
        return False
    if isinstance(index, pd.RangeIndex):
        return index.step == 1
    if pd.api.types.is_integer_dtype(index.dtype):
        return bool(np.all(np.diff(index.to_numpy()) == 1))
    return not (pd.api.types.is_float_dtype(index.dtype) or index.dtype.kind in "mM")


def _pieces(stamps, bridge):
    """Cut the runs at their gaps; return (run, start, stop, lost samples) of each record."""
    pieces = []
    for run, (start, stop) in enumerate(pairwise(stamps.runs())):
        cuts = stamps.cuts(start, stop)
        missing = _missing(stamps.values, cuts) if bridge and len(cuts) > 2 else {}
        for a, b in pairwise([cut for cut in cuts if cut not in missing]):
            lost: list[int] = []
            for row in sorted(cut for cut in missing if a < cut < b):
                first = row - a + len(lost)
                lost += range(first, first + missing[row])
            pieces.append((run, a, b, tuple(lost)))
    single = [start for _, start, stop, _ in pieces if stop - start == 1]
    if len(stamps.values) == 1:
        raise RecordError(
            "A single row with a time does not determine the sampling interval. Give it together "
            "with its neighbours; to predict sample by sample, use the 'stepper' of a model."
        )
    if single and stamps.counts:
        steps = np.unique(np.abs(np.diff(stamps.values)))
        raise RecordError(
            "The integers in the index of X count samples, and must advance by one within a "
            f"record. Got steps of {', '.join(map(str, steps[:5]))} instead, and "
            f"{describe_rows(single)} without a neighbour. If they are times, or rows are left out "
            "(X.iloc[::2]) or lost, give times in seconds as floats: "
            "X.set_axis(X.index * seconds), with the seconds of one step of 1. If the rows are a "
            f"random subset: {SPLITTERS}."
        )
    if single:
        raise RecordError(
            f"A record must have at least two samples. Got {describe_rows(single)} instead, "
            f"without a neighbour one sampling interval away. {SPLITTERS}. If the sampling is "
            "uneven, call skhyst.records.resample_records, which EffectSearchCV does with "
            "resample='auto'."
        )
    return pieces


def _missing(values, cuts):
    """Return the number of rows that are lost before each of the cuts at which rows are lost."""
    start, *inner, stop = cuts
    gaps = np.array([values[row] - values[row - 1] for row in inner], dtype=float)
    # of all steps but those over the gaps
    n_steps = stop - start - 1 - len(inner)
    if not n_steps:
        return {}
    interval = float(values[stop - 1] - values[start] - gaps.sum()) / n_steps
    number = np.rint(gaps / interval)
    is_lost = (np.abs(gaps / interval - number) <= JITTER) & (number > 1) & (number <= BRIDGED)
    if number[is_lost].sum() - is_lost.sum() > MOST_LOST * (stop - start):
        return {}
    rows = zip(inner, number, is_lost, strict=True)
    return {row: int(n) - 1 for row, n, is_gap in rows if is_gap}


def _sampling_intervals(stamps, pieces, one_interval):
    """Return the sampling interval of each piece in s, equal for pieces of about one interval."""
    if stamps.counts:
        return [stamps.unit] * len(pieces)
    spans = np.array([float(stamps.values[b - 1] - stamps.values[a]) for _, a, b, _ in pieces])
    intervals = np.array([b - a - 1 + len(lost) for _, a, b, lost in pieces])
    means = spans / intervals
    shortest, longest = means.min() * stamps.unit, means.max() * stamps.unit
    if not 1.0 / LONGEST <= shortest <= longest <= LONGEST:
        raise RecordError(
            f"The sampling interval must be between {1.0 / LONGEST:g} and {LONGEST:g} s. Got "
            f"{shortest:g} to {longest:g} s instead; choose another unit of time."
        )
    # the clock's drift is tested apart from the jitter: over a long record it may add up to many
    # intervals, although neighbouring ones hardly differ
    for (run, a, b, lost), mean, span in zip(pieces, means, spans, strict=True):
        times = stamps.values[a:b] - stamps.values[a]
        samples = np.delete(np.arange(b - a + len(lost)), lost) if lost else np.arange(b - a)
        drift = np.abs(times - mean * samples).max()
        jitter = np.abs(np.diff(times) - mean * np.diff(samples)).max()
        if jitter > JITTER * mean or drift > max(JITTER * mean, DRIFT * span):
            raise RecordError(
                f"The sampling must be even. Got record {stamps.label(a, run)!r}, rows {a} to "
                f"{b - 1}, with a mean interval of {mean * stamps.unit:.6g} s from which single "
                f"intervals deviate by up to {jitter * stamps.unit:.3g} s and the clock by up to "
                f"{drift * stamps.unit:.3g} s instead; call skhyst.records.resample_records, which "
                f"EffectSearchCV does with resample='auto'. If the rows are a random subset: "
                f"{SPLITTERS}."
            )
    # the longest remaining piece has the most accurate interval: pieces that agree with it share it
    allowed = MISMATCH + JITTER / intervals
    assigned = np.zeros(len(pieces))
    while not assigned.all():
        remaining = assigned == 0.0
        reference = means[np.argmax(np.where(remaining, intervals, 0))]
        same = remaining & (np.abs(means - reference) <= allowed * reference)
        differs = np.flatnonzero(~same)
        if one_interval and differs.size:
            run, a, _, _ = pieces[differs[0]]
            raise RecordError(
                f"All records must have the same sampling interval. Got "
                f"{reference * stamps.unit:.6g} s, and {means[differs[0]] * stamps.unit:.6g} s in "
                f"record {stamps.label(a, run)!r} instead; call skhyst.records.resample_records. "
                f"If the rows have been shuffled: {SPLITTERS}."
            )
        # Nine digits: 0.001 s stays 0.001 s whatever rows a splitter picks.
        assigned[same] = float(f"{spans[same].sum() / intervals[same].sum() * stamps.unit:.9g}")
    return assigned.tolist()


@dataclasses.dataclass(frozen=True)
class TimeStamps:
    """The content of an index: time as numbers, and the record of each row.

    ``values * unit`` are seconds. ``codes`` is None for an index without a record level, else
    ``labels[codes]`` are the labels of the rows. ``dtype`` is that of the time labels, and
    ``counts`` is True for integers that count samples.
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
        """Return the bounds of the pieces of a run, cut at intervals longer than ``longest`` s."""
        steps = np.diff(self.values[start:stop])
        if steps.size == 0:
            return [start, stop]
        if longest is not None:
            longest = longest / self.unit
        elif self.counts:
            longest = GAP
        elif steps.max() * steps.size <= GAP * steps.sum():
            return [start, stop]  # quick: the longest interval is near the mean, so near the median
        else:
            longest = GAP * float(np.median(steps))
        gaps = np.flatnonzero(steps > longest) + start + 1
        return [start, *gaps.tolist(), stop]


def time_stamps(index, dt=1.0) -> TimeStamps:
    """Return the :class:`TimeStamps` of an index; integers count samples of interval ``dt``."""
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


def _numbers(times, dt, codes=None):
    """Turn time labels into numbers; ``codes`` are the positions in a level of a MultiIndex."""
    if isinstance(times.dtype, pd.ArrowDtype) and times.dtype.kind in "mM":
        times = pd.Index(times.array.to_numpy())
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
            f"count samples. Got values of type {dtype} instead; convert texts by pd.to_datetime "
            "(dates) or pd.to_timedelta (clock times hh:mm:ss), X.set_axis(pd.to_datetime("
            "X.index)). Only without times: X.reset_index(drop=True) makes one record of the rows."
        )
    if dtype.kind not in "mM":
        _refuse_other_unit(times.name)
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


def _refuse_other_unit(name):
    """Refuse numbers whose name says that they are times in another unit than seconds."""
    try:
        unit = time_unit_of(name)
    except ValueError:  # no unit of time
        return
    if unit not in ("", "s"):
        raise RecordError(
            f"The time in the index of X must be in seconds. Got the name {name!r}, of times in "
            f"{unit}, instead; multiply it by {SECONDS[unit]:g} and call it 'time'."
        )


def record_names(records) -> list:
    """Return the labels of records, with the time where several have the same one.

    Parameters
    ----------
    records : sequence of RecordSlice
        Those on both sides of a long gap share their label.

    Returns
    -------
    list of hashable
        All different.

    Examples
    --------
    >>> import numpy as np
    >>> import pandas as pd
    >>> from skhyst.records import record_names, record_slices
    >>> times = 0.1 * np.r_[0:10, 50:60]
    >>> record_names(record_slices(pd.DataFrame({"drive": times}, times)))
    ['0 from 0 s', '0 from 5 s']
    """
    labels = [record.label for record in records]
    units = ("sample" if record.time_unit == "sample" else "s" for record in records)
    return [
        label if labels.count(label) == 1 else f"{label} from {record.start_time:.9g} {unit}"
        for label, record, unit in zip(labels, records, units, strict=True)
    ]


def first_of_equals(records, *signals) -> np.ndarray:
    """Return for each record the number of the first record that equals it to the last bit.

    Two measurements of a device always differ: equal records are one that was stored twice.

    Parameters
    ----------
    records : sequence of RecordSlice
    *signals : array-like of shape (n_samples, ...)
        Drive and response.

    Returns
    -------
    ndarray of int of shape (n_records,)
    """
    first: dict[tuple, int] = {}
    values = [np.asarray(signal, dtype=float) for signal in signals]
    contents = [tuple(signal[r.rows].tobytes() for signal in values) for r in records]
    return np.array([first.setdefault(content, i) for i, content in enumerate(contents)])
