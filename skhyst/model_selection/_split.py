"""Splitters that keep records whole, or cut them into blocks with gaps between them.

Rows that are neighbours in time share the state of the device: a model that was fitted to one of
them nearly knows the other. So a fold consists of whole records, or of contiguous blocks of them.
"""

import warnings
from abc import abstractmethod
from collections.abc import Iterator
from numbers import Integral

import numpy as np
import pandas as pd
from sklearn.model_selection import BaseCrossValidator, KFold
from sklearn.utils import indexable

from ..exceptions import RecordError
from ..records import first_of_equals, record_slices
from ._folds import by_content, check_integer, runs


class _RecordSplitter(BaseCrossValidator):
    """Splitter that reads the records from the index of X, and checks its parameters."""

    @abstractmethod
    def _folds(self, records, labelled, X, y):
        """Check the parameters; return an iterator of boolean masks (train, test).

        ``labelled`` says whether the index has a record level.
        """

    def split(self, X, y=None, groups=None) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Return an iterator over the folds.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            The index carries records and time.
        y : array-like of shape (n_samples,), optional
            Response; its index must not have records or times that the index of ``X`` lacks.
        groups : None
            Ignored, exists for compatibility.

        Returns
        -------
        iterator of (train, test)
            Row numbers in increasing order.

        Raises
        ------
        RecordError
            If the rows form no records, or two records without a label of their own would follow
            each other as if they were one.
        ValueError
            If a parameter is out of its range, or there are too few records or rows.
        """
        if groups is not None:
            warnings.warn(
                f"The groups parameter is ignored by {type(self).__name__}: the index of X says "
                f"which rows belong together.",
                UserWarning,
                stacklevel=2,
            )
        check_integer("n_splits", self.n_splits, 2, type(self).__name__)
        X, y = indexable(X, y)
        records = record_slices(X, y, one_interval=False, bridge=True)
        labelled = isinstance(getattr(X, "index", None), pd.MultiIndex)
        return self._row_numbers(records, labelled, self._folds(records, labelled, X, y))

    def get_n_splits(self, X=None, y=None, groups=None) -> int:
        """Return the number of folds.

        Parameters
        ----------
        X, y, groups : object, default=None
            Ignored.

        Returns
        -------
        int
            The number of folds.
        """
        return self.n_splits

    def _row_numbers(self, records, labelled, folds):
        labels = np.repeat([0 if labelled else r.label for r in records], _sizes(records))
        several = labels.size and labels[-1] != labels[0]
        time = np.concatenate([r.time for r in records]) if several else None
        for masks in folds:
            train, test = map(np.flatnonzero, masks)
            if several:
                longest = 1.5 * max(record.dt for record in records)
                _refuse_joined(train, labels, time, longest)
                _refuse_joined(test, labels, time, longest)
            yield train, test


def _sizes(records):
    return np.array([record.n_samples for record in records], dtype=int)


def _refuse_joined(rows, labels, time, gap):
    """Refuse rows of two records that follow each other in time as if they were one record."""
    step = np.diff(time[rows])
    joined = np.flatnonzero((np.diff(labels[rows]) != 0) & (step >= 0) & (step <= gap))
    if joined.size:
        raise RecordError(
            f"The records need labels, as in this fold the times alone do not distinguish them: "
            f"rows {rows[joined[0]]} and {rows[joined[0] + 1]} belong to different records, but "
            f"follow each other in time. skhyst.records.stack_records builds an index with labels."
        )


class RecordKFold(_RecordSplitter):
    """K folds of whole records.

    Each record is in the test rows of exactly one fold. All rows with one label of the record
    level stay together, also where rows are missing between them; without a record level, a
    record is what :func:`skhyst.records.record_slices` finds.

    Parameters
    ----------
    n_splits : int, default=5
        Number of folds, from 2 to the number of records.
    shuffle : bool, default=False
        Whether records are assigned to the folds at random, not in their order. Rows stay in order.
    random_state : int, RandomState instance or None, default=None
        Seed of the shuffle.

    See Also
    --------
    BlockedTimeSeriesSplit : For a single record, or records fewer than folds.
    sklearn.model_selection.KFold : Assigns single rows; this one assigns records in the same way.

    Notes
    -----
    An array, or a frame with a default index, is a single record and cannot be split by records.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.model_selection import RecordKFold
    >>> from skhyst.records import stack_records
    >>> X = stack_records([np.zeros(2), np.zeros(3), np.zeros(2)])
    >>> for train, test in RecordKFold(3).split(X):
    ...     print(train, test)
    [2 3 4 5 6] [0 1]
    [0 1 5 6] [2 3 4]
    [0 1 2 3 4] [5 6]
    """

    def __init__(self, n_splits=5, *, shuffle=False, random_state=None):
        self.n_splits = n_splits
        self.shuffle = shuffle
        self.random_state = random_state

    def _folds(self, records, labelled, X, y):
        keys = [record.label if labelled else i for i, record in enumerate(records)]
        if X is not None and y is not None:  # equal records stay on one side
            keys = [keys[first] for first in first_of_equals(records, X, y)]
        numbers = {key: i for i, key in enumerate(dict.fromkeys(keys))}
        if len(numbers) < self.n_splits:
            raise ValueError(
                f"The 'n_splits' parameter of RecordKFold must be at most the number of records. "
                f"Got n_splits={self.n_splits} and {len(numbers)} record(s) in the index of X "
                f"instead; {_remedy(len(numbers))}"
            )
        # StackingRegressor sets a generator whether there is a shuffle or not, which KFold refuses
        given = isinstance(self.random_state, Integral)
        seed = self.random_state if self.shuffle or given else None
        deal = KFold(self.n_splits, shuffle=self.shuffle, random_state=seed)
        row_numbers = np.repeat([numbers[key] for key in keys], _sizes(records))
        tests = [test for _, test in deal.split(np.arange(len(numbers)))]
        masks = (np.isin(row_numbers, test) for test in tests)
        return ((~mask, mask) for mask in masks)


def _remedy(n_records):
    blocks = "use BlockedTimeSeriesSplit, which cuts each record into blocks"
    if n_records > 1:
        return f"{blocks}, or at most {n_records} folds."
    return f"{blocks}. If there are more records: skhyst.records.stack_records builds their index."


class BlockedTimeSeriesSplit(_RecordSplitter):
    """K folds of contiguous blocks: the k-th fold tests the k-th block of every long record.

    Every row of a record that is long enough for blocks of two samples is in the test rows of
    exactly one fold; shorter records are always trained on. Training rows lie before and after
    the test block: the score says how well the model describes the device, not how well it
    extrapolates in time.

    Parameters
    ----------
    n_splits : int, default=5
        Number of blocks in each record, at least 2.
    washout : int, default=0
        Training rows that are left out on either side of each test block, in sampling intervals:
        the memory of the device, so that training and test rows share none of it.
    staggered : bool, default=False
        Whether the k-th fold tests different blocks of different records, so that each fold trains
        on all parts of a drive that the records repeat. The assignment depends on
        the content of the records, not on their order.

    See Also
    --------
    RecordKFold : Folds of whole records.
    washout_scorer : Leaves the first samples of each test block out of the score.
    sklearn.model_selection.TimeSeriesSplit : Tests only on rows after the training rows.

    Notes
    -----
    In a frame, the rows before and after a cut are two records, since the index then has a hole. An
    array loses its index when it is sliced: the rows of each fold are then treated as one record,
    although the training rows jump at each cut. A frame, even one with a default index, avoids
    that.

    A training row without a neighbour is left out: a record has at least two samples.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.model_selection import BlockedTimeSeriesSplit
    >>> for train, test in BlockedTimeSeriesSplit(3, washout=1).split(np.zeros((9, 1))):
    ...     print(train, test)
    [4 5 6 7 8] [0 1 2]
    [0 1 7 8] [3 4 5]
    [0 1 2 3 4] [6 7 8]
    """

    def __init__(self, n_splits=5, *, washout=0, staggered=False):
        self.n_splits = n_splits
        self.washout = washout
        self.staggered = staggered

    def _folds(self, records, labelled, X, y):
        check_integer("washout", self.washout, 0, "BlockedTimeSeriesSplit")
        long = [record for record in records if record.n_samples >= 2 * self.n_splits]
        if not long:
            raise ValueError(
                f"The 'n_splits' parameter of BlockedTimeSeriesSplit must leave two samples in "
                f"each block. Got n_splits={self.n_splits} and records of "
                f"{max(_sizes(records), default=0)} samples at most instead; use RecordKFold for "
                f"many short records."
            )
        place = np.zeros(len(long), dtype=int)
        if self.staggered:
            place = np.argsort(by_content(long, X, y))
        return self._blocks(records, long, place)

    def _blocks(self, records, long, place):
        clock = _clock(records, self.washout)
        apart = np.diff(clock, prepend=-2) != 1
        first = np.array([record.rows.start for record in long])
        size, longer = np.divmod(_sizes(long), self.n_splits)
        for k in range(self.n_splits):
            block = (k - place) % self.n_splits
            starts = first + block * size + np.minimum(block, longer)
            stops = starts + size + (block < longer)
            near = np.searchsorted(clock, clock[starts] - self.washout)
            far = np.searchsorted(clock, clock[stops - 1] + self.washout, side="right")
            test = _mask(clock.size, starts, stops)
            train = ~_mask(clock.size, near, far)
            starts, stops = runs(train, apart)
            train[starts[stops - starts == 1]] = False
            if not train.any():
                raise ValueError(
                    f"The 'washout' parameter of BlockedTimeSeriesSplit must leave rows to train "
                    f"on. Got washout={self.washout} and n_splits={self.n_splits}, with records "
                    f"of {_sizes(records).max()} samples at most, instead."
                )
            yield train, test


def _mask(n_samples, starts, stops):
    mask = np.zeros(n_samples, dtype=bool)
    for start, stop in zip(starts, stops, strict=True):
        mask[start:stop] = True
    return mask


def _clock(records, washout):
    """Return increasing integers, one per row: time in intervals, records separated by the washout.

    The two sides of a hole in a record are as far apart as the hole is long.
    """
    ticks = []
    last, previous = -1, None
    for record in records:
        jump = 1 if previous is None else washout + 2
        if previous is not None and record.label == previous.label:
            ahead = record.start_time - previous.start_time
            if ahead > 0:
                jump = max(round(ahead / record.dt) - previous.samples[-1], 2)
        ticks.append(last + jump + record.samples)
        last, previous = ticks[-1][-1], record
    return np.concatenate(ticks)
