"""Folds for models that are fitted to complete records: segments, and folds as masks of segments.

A segment lies completely inside or outside the training and the test rows of every fold, so that
sums over segments are computed once, and a fold selects among them.
"""

from itertools import chain, pairwise
from numbers import Integral

import numpy as np

from ..records import first_of_equals, near_period

_WASHOUT = 0.05  # of a block of a single record


def by_content(records, X=None, y=None) -> np.ndarray:
    """Return the numbers of the records in an order independent of that in the data.

    They are sorted by length, then by the mean of the response and of the drive, which no choice of
    units changes.

    Parameters
    ----------
    records : sequence of RecordSlice
    X : array-like of shape (n_samples, n_inputs) or (n_samples,), optional
        Column 0 is the drive.
    y : array-like of shape (n_samples,), optional
        Response.

    Returns
    -------
    ndarray of int of shape (n_records,)

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.model_selection import by_content
    >>> from skhyst.records import record_slices, stack_records
    >>> by_content(record_slices(stack_records([np.zeros(3), np.zeros(2)])))
    array([1, 0])
    """
    drive = None if X is None else np.asarray(X)
    if drive is not None and drive.ndim > 1:
        drive = drive[:, 0]
    signals = [np.array(s, dtype=float) for s in (drive, y) if s is not None]
    means = [[signal[r.rows].mean() for r in records] for signal in signals]
    return np.lexsort([*means, [r.n_samples for r in records]])


def stretches(start, stop, most=32, shortest=16) -> list[tuple[int, int]]:
    """Cut rows into stretches of one length; the last takes the remainder.

    Parameters
    ----------
    start, stop : int
        The rows.
    most : int, default=32
        Largest number of stretches.
    shortest : int, default=16
        Least number of samples of a stretch, if there are that many.

    Returns
    -------
    list of (start, stop)

    Examples
    --------
    >>> from skhyst.model_selection import stretches
    >>> stretches(0, 11, most=3, shortest=2)
    [(0, 3), (3, 6), (6, 11)]
    """
    count = max(min(most, (stop - start) // shortest), 1)
    length = (stop - start) // count
    firsts = [int(start) + i * length for i in range(count)]
    return list(zip(firsts, [*firsts[1:], int(stop)], strict=True))


def segment_folds(
    records, cv=5, X=None, y=None, *, groups=None, washout=None, n_segments=32, shortest=16
) -> tuple[tuple, list[tuple[np.ndarray, np.ndarray]]]:
    """Cut records into segments, and folds over these segments.

    Parameters
    ----------
    records : sequence of RecordSlice
        All records, as :func:`skhyst.records.record_slices` returns them.
    cv : int, splitter or iterable, default=5
        As in ``GridSearchCV``. An int: that many folds, each of a contiguous block of every record,
        at different positions, so that the test samples of a fold lie within the range of its
        training samples. As in ``TimeSeriesSplit`` there is one more block, the first one, which is
        in the training set of each of these folds: the first response of a device's memory is not
        repeated later. A last fold, trained on everything, scores these first blocks. A record
        whose blocks would be shorter than ``shortest`` is in one fold as a whole. Records are
        assigned by their content (:func:`by_content`), independent of their order. Else an object
        with ``split(X, y, groups)``, or an iterable of (train, test) row numbers, which is consumed
        once.
    X : DataFrame or array-like of shape (n_samples, n_inputs), optional
        For a splitter, and to distinguish records of one length.
    y : array-like of shape (n_samples,), optional
        The same.
    groups : array-like of shape (n_samples,), optional
        Passed to a splitter.
    washout : int or None, default=None
        Samples at the start of each record that are neither fitted nor scored, in no fold and no
        segment. At least one sample of each record is in a segment. None: 5 % of the shortest block
        of a single record, whose past is unknown; none for several records, each from its own
        start.
    n_segments : int, default=32
        Largest number of segments per record, where the folds allow it.
    shortest : int, default=16
        Least number of samples of a segment, where the folds allow it.

    Returns
    -------
    segments : tuple of tuple of (start, stop)
        For each record, its segments in order, which cover the rows after its washout; rows count
        from its start. They are about equally long, except at the ends of blocks.
    folds : list of (train, test)
        Boolean masks over the segments of all records: those fitted, those scored. What a fold
        neither trains on nor tests (gaps) is in neither.

    Raises
    ------
    ValueError
        If there are fewer than two folds, a fold trains on rows that it tests or has no training or
        test rows, row numbers are out of range, or rows are assigned one by one.

    See Also
    --------
    RecordKFold : Folds of whole records, for scikit-learn.
    BlockedTimeSeriesSplit : Folds of blocks of records, for scikit-learn.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.model_selection import segment_folds
    >>> from skhyst.records import record_slices
    >>> segments, folds = segment_folds(record_slices(np.zeros((90, 1))), cv=2, n_segments=6)
    >>> segments
    (((1, 30), (30, 60), (60, 90)),)
    >>> for train, test in folds:
    ...     print(train.astype(int), test.astype(int))
    [1 0 1] [0 1 0]
    [1 1 0] [0 0 1]
    [1 1 1] [1 0 0]
    """
    for name, value, least in (("n_segments", n_segments, 1), ("shortest", shortest, 1)):
        check_integer(name, value, least, "segment_folds")
    if washout is not None:
        check_integer("washout", washout, 0, "segment_folds")
    first = np.zeros(records[-1].rows.stop, dtype=bool)
    first[[record.rows.start for record in records]] = True
    if isinstance(cv, Integral):
        check_integer("cv", cv, 2, "segment_folds")
        begins = _begins(records, washout, records[0].n_samples // (cv + 1))
        train, test = _even_folds(records, cv, X, y, shortest, begins)
    else:
        train, test = _given_folds(cv, X, y, groups, first)
        blocks = (runs(mask, first) for mask in test)
        begins = _begins(records, washout, min(np.min(b - a) for a, b in blocks))
    firsts = [r.rows.start + begin for r, begin in zip(records, begins, strict=True)]
    for record, counted in zip(records, firsts, strict=True):
        train[:, record.rows.start : counted] = test[:, record.rows.start : counted] = False
    empty = np.flatnonzero(~(train.any(axis=1) & test.any(axis=1)))
    if empty.size:
        raise ValueError(
            f"The 'washout' parameter must leave training rows, and test rows to score. Got "
            f"{washout!r} and none in fold {empty[0]} instead."
        )
    changed = [(part[:, 1:] != part[:, :-1]).any(axis=0) for part in (train, test)]
    first[firsts] = True
    cuts = np.flatnonzero(first | np.append(False, np.logical_or.reduce(changed)))
    segments = []
    for record, counted in zip(records, firsts, strict=True):
        start, stop = record.rows.start, record.rows.stop
        starts = cuts[(cuts >= counted) & (cuts < stop)].tolist()
        counts = _shares(np.diff([*starts, stop]), n_segments)
        parts = [
            stretches(a - start, b - start, count, shortest)
            for (a, b), count in zip(pairwise([*starts, stop]), counts, strict=True)
        ]
        segments.append(tuple(chain.from_iterable(parts)))
    rows = [r.rows.start + a for r, parts in zip(records, segments, strict=True) for a, _ in parts]
    masks = zip(train[:, rows], test[:, rows], strict=True)
    return tuple(segments), list(masks)


def check_integer(name, value, least, caller):
    """Refuse a parameter that is no int or too small."""
    if not isinstance(value, Integral) or isinstance(value, bool) or value < least:
        raise ValueError(
            f"The {name!r} parameter of {caller} must be an int that is at least {least}. Got "
            f"{value!r} instead."
        )


def runs(mask, first):
    """Return where the runs of True start and stop; a new one starts where ``first`` holds."""
    before, after = np.append(False, mask[:-1]), np.append(mask[1:], False)
    starts = mask & (first | ~before)
    stops = mask & (np.append(first[1:], True) | ~after)
    return np.flatnonzero(starts), np.flatnonzero(stops) + 1


def _begins(records, washout, block):
    """Return the first sample of each record that counts."""
    if washout is None:
        washout = int(_WASHOUT * block) if len(records) == 1 else 0
    return [min(washout, record.n_samples - 1) for record in records]


def _even_folds(records, cv, X, y, shortest, begins):
    """Return masks (n_folds, n_samples) of a block of every record, or of all of a short one."""
    fold_of = []
    order = np.argsort(by_content(records, X, y))
    if X is not None and y is not None:  # equal records are never on both sides of a fold
        order = order[first_of_equals(records, X, y)]
    for record, position, begin in zip(records, order, begins, strict=True):
        n = record.n_samples - begin
        if len(records) == 1 and n < 2 * (cv + 1):
            raise ValueError(
                f"The 'cv' parameter must leave two samples in each block of a record: at least "
                f"{2 * cv + 2} samples behind the washout for {cv} folds. Got {n} instead."
            )
        block = np.zeros(n, dtype=int)
        if n >= (cv + 1) * shortest or len(records) == 1:
            drive = np.empty(0) if X is None else np.asarray(X, dtype=float)[record.rows]
            block = _blocks(drive if drive.ndim == 1 else drive[:, 0], n, cv, shortest)
        fold_of += [np.full(begin, -2), np.where(block < 0, -1, (position + block) % cv)]
    fold_of = np.concatenate(fold_of)
    numbers = np.unique(fold_of[fold_of >= -1])
    test = fold_of == np.roll(numbers, -int(numbers[0] < 0))[:, None]
    return ~test | (test & (fold_of < 0)), test


def _blocks(drive, n, cv, shortest):
    """Return the number of the block of each of the last n samples, -1 for the first block.

    Blocks of a periodic drive are parts of the period, counted from its maximum, so that every
    level is passed in two different parts: no part alone covers a part of the range.
    """
    period = near_period(drive)
    if not 2 * cv * shortest <= period <= n:
        return (np.arange(1, n + 1) * (cv + 1) - 1) // n - 1
    phase = (np.arange(len(drive)) - np.argmax(drive)) / period % 1.0
    return (2 * cv * phase[-n:]).astype(int)


def _given_folds(cv, X, y, groups, first):
    """Return masks (n_folds, n_samples) of the folds of a splitter or an iterable."""
    if hasattr(cv, "split") and not isinstance(cv, str):
        if X is None:
            raise ValueError("The 'X' parameter must be given where 'cv' is a splitter. Got None.")
        folds = list(cv.split(X, y, groups))
    else:
        folds = list(cv) if np.iterable(cv) else [cv]
    if not all(np.iterable(fold) and len(fold) == 2 for fold in folds):
        raise ValueError(
            f"The 'cv' parameter must be an int, a splitter or an iterable of (train, test) row "
            f"numbers. Got {cv!r} instead."
        )
    if len(folds) < 2:
        raise ValueError(
            f"The 'cv' parameter must give at least two folds. Got {len(folds)} instead."
        )
    train, test = np.zeros((2, len(folds), first.size), dtype=bool)
    for k, fold in enumerate(folds):
        for part, mask, numbers in zip(("training", "test"), (train, test), fold, strict=True):
            mask[k, _row_numbers(numbers, first.size, f"{part} rows of fold {k}")] = True
            starts, stops = runs(mask[k], first)
            single = starts[stops - starts == 1]
            if single.size:
                raise ValueError(
                    f"The 'cv' parameter must keep rows together that follow each other. Got row "
                    f"{single[0]} alone in the {part} rows of fold {k} instead; use "
                    f"skhyst.model_selection.RecordKFold or BlockedTimeSeriesSplit."
                )
        both = np.flatnonzero(train[k] & test[k])
        if both.size:
            raise ValueError(
                f"The folds of the 'cv' parameter must test other rows than they train on. Got "
                f"{both.size} row(s) of fold {k} in both, the first one row {both[0]}, instead."
            )
    return train, test


def _row_numbers(numbers, n_rows, where):
    rows = np.asarray(numbers)
    if rows.size == 0:
        raise ValueError(f"The {where} of the 'cv' parameter must not be empty. Got none.")
    if rows.dtype.kind not in "iu" or rows.ndim != 1:
        raise ValueError(
            f"The {where} of the 'cv' parameter must be row numbers. Got an array of type "
            f"{rows.dtype} and shape {rows.shape} instead."
        )
    outside = rows[(rows < 0) | (rows >= n_rows)]
    if outside.size:
        raise ValueError(
            f"The {where} of the 'cv' parameter must lie from 0 to {n_rows - 1}. Got {outside[0]} "
            f"instead."
        )
    return rows


def _shares(lengths, n_segments):
    """Return the number of segments of each part of a record: equal for parts of equal length."""
    # in multiples of the shortest, since the blocks of an even division differ by one sample
    sizes = np.maximum(np.round(lengths / lengths.min()), 1.0)
    for size in np.unique(sizes / np.arange(1, n_segments + 1)[:, None]):
        counts = np.maximum(np.floor(sizes / size * (1.0 + 1e-12)), 1.0)
        if counts.sum() <= n_segments:
            return counts.astype(int).tolist()
    return [1] * len(lengths)
