"""Folds over segments: partitions, what a splitter says, dealing by content, refusals."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from sklearn.model_selection import GroupKFold, KFold, ShuffleSplit, TimeSeriesSplit

from skhyst.model_selection import BlockedTimeSeriesSplit, RecordKFold, segment_folds, stretches
from skhyst.records import record_slices, stack_records

sizes = st.lists(st.integers(20, 700), min_size=1, max_size=5)
washouts = st.one_of(st.none(), st.integers(0, 30))


def recording(lengths, seed=0):
    rng = np.random.default_rng(seed)
    return stack_records([tuple(rng.normal(size=(2, n))) for n in lengths], dt=0.01)


def by_rows(records, segments, folds):
    """Return the masks of the folds over rows, (n_folds, 2, n_samples)."""
    number = np.full(records[-1].rows.stop, -1)  # of the segment that a row is in
    spans = [
        (r.rows.start, *part) for r, own in zip(records, segments, strict=True) for part in own
    ]
    for i, (first, start, stop) in enumerate(spans):
        number[first + start : first + stop] = i
    return np.array([[np.append(mask, False)[number] for mask in fold] for fold in folds])


def begins(records, washout, block):
    """Return the first sample of each record that counts."""
    if washout is None:
        washout = int(0.05 * block) if len(records) == 1 else 0
    return [min(washout, record.n_samples - 1) for record in records]


def check_partition(records, segments, folds, firsts):
    assert len(segments) == len(records)
    for record, own, first in zip(records, segments, firsts, strict=True):
        assert own[0][0] == first
        assert own[-1][1] == record.n_samples
        assert all(a < b == c for (a, b), (c, _) in pairwise(own))
    for train, test in folds:
        assert train.shape == test.shape == (sum(map(len, segments)),)
        assert train.any()
        assert test.any()
        assert not (train & test).any() or train.all()  # that of what records begin with


@settings(deadline=None, max_examples=30)
@given(sizes, st.integers(2, 9), washouts)
def test_an_int_holds_out_a_block_of_every_record(lengths, cv, washout):
    X, y = recording(lengths)
    records = record_slices(X, y)
    begun = begins(records, washout, lengths[0] // (cv + 1))
    assume(len(lengths) > 1 or lengths[0] - begun[0] >= 2 * (cv + 1))
    segments, folds = segment_folds(records, cv, X, y, washout=washout)
    check_partition(records, segments, folds, begun)
    train, scored = by_rows(records, segments, folds).transpose(1, 0, 2)
    counted = [n - begin for n, begin in zip(lengths, begun, strict=True)]
    whole = [len(lengths) > 1 and n < 16 * (cv + 1) for n in counted]
    # a last fold scores what records begin with
    assert len(folds) == (min(cv, len(lengths)) if all(whole) else cv) + (not all(whole))
    firsts = []
    for record, is_whole, begin in zip(records, whole, begun, strict=True):
        n, tested = record.n_samples, ~train[:, record.rows]
        tested[:, :begin] = False
        edges = np.diff(np.pad(tested, ((0, 0), (1, 1))).astype(int), axis=1)
        blocks = sorted(np.flatnonzero(own).tolist() for own in edges if own.any())
        assert len(blocks) == (1 if is_whole else cv)
        # what comes first is trained on by every fold; each row behind it is held out once
        assert blocks[0][0] == begin + (0 if is_whole else (n - begin) // (cv + 1))
        assert blocks[-1][1] == n
        assert all(a[1] == b[0] for a, b in pairwise(blocks))
        sizes = [stop - start for start, stop in blocks]
        assert max(sizes) - min(sizes) <= 1
        scores = scored[:, record.rows].sum(axis=0)
        np.testing.assert_array_equal(scores, np.arange(n) >= begin)
        firsts.append(int(np.argmax(tested[:, blocks[0][0]])))
    # the first blocks of different records are in different folds, as far as there are folds
    assert np.bincount(firsts).max() == -(-len(lengths) // cv)


def test_segments_of_a_single_record_as_recorded():
    X, y = recording([203])
    segments, _ = segment_folds(record_slices(X), 3, X, y)
    assert segments == (
        (
            *((2, 18), (18, 34), (34, 52)),
            *((52, 68), (68, 84), (84, 102)),
            *((102, 118), (118, 134), (134, 152)),
            *((152, 169), (169, 186), (186, 203)),
        ),
    )


def test_no_part_of_a_period_is_on_both_sides_of_a_fold():
    """Each fold holds out one part of the way up and one of the way down, in every period."""
    time = np.arange(1000)
    drive = np.cos(2.0 * np.pi * time / 200)[:, None]
    records = record_slices(drive)
    segments, folds = segment_folds(records, 5, drive, washout=0)
    train, scored = by_rows(records, segments, folds).transpose(1, 0, 2)
    part, inside = time % 200 // 20, time % 20 > 0  # the period is known to rounding
    for k in range(5):
        np.testing.assert_array_equal(scored[k, inside], part[inside] % 5 == k)
        np.testing.assert_array_equal(train[k], ~scored[k])
        assert np.ptp(drive[train[k]]) > 1.999  # the range of what is held out, but for the peak
    # a period too short for parts of 16 samples, and a drive that does not repeat itself
    for other in (np.cos(2.0 * np.pi * time / 150), np.cos(1e-5 * time**2)):
        _, folds = segment_folds(records, 5, other[:, None], washout=0)
        assert len(folds) == 6


@pytest.mark.parametrize("cv", [2, 3, 5, 7, 32, 40])
def test_blocks_that_differ_by_a_sample_get_equally_many_segments(cv):
    X, y = recording([16 * 40 * cv + 1])
    segments, folds = segment_folds(record_slices(X), cv, X, y, washout=0)
    for _, test in folds:
        assert np.sum(test) == max(32 // (cv + 1), 1)
    lengths = [b - a for a, b in segments[0]]
    assert np.sum(lengths) == len(X)


SPLITTERS = [
    RecordKFold(3),
    RecordKFold(3, shuffle=True, random_state=1),
    BlockedTimeSeriesSplit(4),
    BlockedTimeSeriesSplit(2, washout=7, staggered=True),
    KFold(2),
    TimeSeriesSplit(2, gap=4),
    GroupKFold(3),
]
several = st.lists(st.integers(5, 60).map(lambda n: 12 * n), min_size=3, max_size=5)
blocks = st.integers(2, 5).map(lambda n: BlockedTimeSeriesSplit(n, washout=3))
single = st.tuples(st.tuples(st.integers(160, 900)), blocks)  # longer than a washout


@settings(deadline=None, max_examples=50)
@given(
    st.one_of(st.tuples(several, st.sampled_from(SPLITTERS)), single),
    washouts,
    st.integers(4, 40),
)
def test_a_splitter_is_followed_row_by_row(case, washout, n_segments):
    """But for what is washed out at the start of a record."""
    lengths, cv = case
    X, y = recording(lengths)
    records, groups = record_slices(X, y), X.index.codes[0]
    own = {"groups": groups} if isinstance(cv, GroupKFold) else {}
    splits = list(cv.split(X, y, **own))
    segments, folds = segment_folds(
        records, cv, X, y, washout=washout, n_segments=n_segments, **own
    )
    shortest = lengths[0] // getattr(cv, "n_splits", 1) if len(lengths) == 1 else 0
    begun = begins(records, washout, shortest)
    check_partition(records, segments, folds, begun)
    masks = by_rows(records, segments, folds)
    counts = [np.arange(n) >= begin for n, begin in zip(lengths, begun, strict=True)]
    counts = np.concatenate(counts)
    for (train, test), (fitted, scored) in zip(splits, masks, strict=True):
        np.testing.assert_array_equal(np.flatnonzero(fitted), train[counts[train]])
        np.testing.assert_array_equal(np.flatnonzero(scored), test[counts[test]])


@settings(deadline=None, max_examples=25)
@given(
    st.lists(st.integers(80, 90), min_size=2, max_size=6),
    st.sampled_from([2, 4, BlockedTimeSeriesSplit(3, washout=2, staggered=True)]),
    st.randoms(),
)
def test_the_order_of_records_does_not_matter(lengths, cv, random):
    rng = np.random.default_rng(0)
    parts = [tuple(rng.normal(size=(2, n))) for n in lengths]
    order = list(range(len(parts)))
    random.shuffle(order)

    def seen(places):
        X, y = stack_records([parts[i] for i in places], dt=0.01)
        segments, folds = segment_folds(record_slices(X, y), cv, X, y, washout=5)
        cuts = np.cumsum(list(map(len, segments)))[:-1]
        masks = [np.split(mask, cuts) for fold in folds for mask in fold]
        sorted_masks = [[own[k].tolist() for k in np.argsort(places)] for own in masks]
        return [segments[k] for k in np.argsort(places)], sorted_masks

    assert seen(range(len(parts))) == seen(order)


def test_a_generator_is_consumed_once():
    X, y = recording([90, 90])
    splits = list(BlockedTimeSeriesSplit(3).split(X))
    generated = segment_folds(record_slices(X), iter(splits), X, y)
    for found, expected in zip(generated, segment_folds(record_slices(X), splits), strict=True):
        np.testing.assert_equal(found, expected)


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 50), st.integers(1, 500), st.integers(1, 40), st.integers(1, 30))
def test_stretches_are_of_one_length(start, n, most, shortest):
    found = stretches(start, start + n, most, shortest)
    lengths = [b - a for a, b in found]
    assert [found[0][0], *(b for _, b in found)] == [*(a for a, _ in found), start + n]
    assert len(found) <= most
    assert len(set(lengths[:-1])) <= 1
    assert len(found) == 1 or min(lengths) >= shortest
    assert lengths[-1] < lengths[0] + len(found)


ROWS = np.arange(40)
SPLIT = [(ROWS[:20], ROWS[20:]), (ROWS[20:], ROWS[:20])]


@pytest.mark.parametrize(
    ("cv", "message"),
    [
        ([(ROWS[:21], ROWS[20:]), SPLIT[1]], r"1 row\(s\) of fold 0 in both, the first one row 20"),
        ([SPLIT[0], (ROWS[20:], ROWS[:20] - 1)], r"test rows of fold 1 .* 0 to 39. Got -1 instead"),
        ([SPLIT[0], (ROWS[20:] + 1, ROWS[:20])], r"training rows of fold 1 .* Got 40 instead"),
        ([SPLIT[0], (ROWS, [])], "test rows of fold 1 .* must not be empty"),
        ([SPLIT[0], ([], ROWS)], "training rows of fold 1 .* must not be empty"),
        ([SPLIT[0], (ROWS < 20, ROWS >= 20)], "must be row numbers. Got an array of type bool"),
        ([], "at least two folds. Got 0 instead"),
        (SPLIT[:1], "at least two folds. Got 1 instead"),
        (KFold(4, shuffle=True, random_state=0), "RecordKFold or BlockedTimeSeriesSplit"),
        (ShuffleSplit(random_state=0), "RecordKFold or BlockedTimeSeriesSplit"),
        (1, "'cv' parameter of segment_folds must be an int that is at least 2. Got 1 instead"),
        (True, "must be an int that is at least 2. Got True instead"),
        (21, "44 samples behind the washout for 21 folds. Got 40 instead"),
        (2.5, r"an int, a splitter or an iterable .* Got 2.5 instead"),
        ("five", r"an int, a splitter or an iterable .* Got 'five' instead"),
        ([1, 2], r"an int, a splitter or an iterable .* Got \[1, 2\] instead"),
    ],
)
def test_folds_that_say_nothing_are_refused(cv, message):
    X, y = recording([40])
    with pytest.raises(ValueError, match=message):
        segment_folds(record_slices(X), cv, X, y)


def test_other_refusals():
    X, y = recording([40, 40])
    records = record_slices(X)
    with pytest.raises(ValueError, match="'X' parameter must be given where 'cv' is a splitter"):
        segment_folds(records, RecordKFold(2))
    for name, value in (("washout", -1), ("washout", 0.5), ("n_segments", 0), ("shortest", None)):
        with pytest.raises(ValueError, match=f"'{name}' parameter of segment_folds must be an int"):
            segment_folds(records, 2, X, y, **{name: value})
    with pytest.raises(ValueError, match=r"test rows to score. Got 20 and none in fold 0"):
        segment_folds(records, BlockedTimeSeriesSplit(2), X, y, washout=20)
