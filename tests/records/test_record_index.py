"""Where records begin, how they are sampled, and which indexes are refused."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from sklearn.model_selection import KFold, train_test_split
from sklearn.preprocessing import StandardScaler

from skhyst.exceptions import RecordError
from skhyst.records import record_slices, sampling_interval

INTERVALS = [1e-9, 2e-5, 1 / 1024, 1 / 3000, 0.1, 1.0, 3600.0]


def frame(*records, names=("record", "time")):
    """Return a frame with a record level from pairs (label, times)."""
    labels = [label for label, times in records for _ in times]
    times = np.concatenate([times for _, times in records])
    index = pd.MultiIndex.from_arrays([labels, times], names=names)
    return pd.DataFrame({"drive": np.arange(float(len(times)))}, index=index)


def single(times):
    return pd.DataFrame({"drive": np.zeros(len(times))}, index=pd.Index(times))


def spans(X, **options):
    return [(r.label, r.rows.start, r.rows.stop) for r in record_slices(X, **options)]


@pytest.mark.parametrize("X", [np.zeros((7, 2)), np.zeros(7), [[0.0]] * 7, single(range(7))])
def test_rows_without_times_are_one_record(X):
    (record,) = record_slices(X, dt=0.25)
    assert (record.label, record.rows, record.dt) == (0, slice(0, 7), 0.25)
    np.testing.assert_allclose(record.time, 0.25 * np.arange(7))


def test_no_rows_and_one_row():
    assert record_slices(np.zeros((0, 1))) == ()
    with pytest.raises(RecordError, match="must have rows"):
        sampling_interval(np.zeros((0, 1)))
    assert spans(np.zeros((1, 1))) == [(0, 0, 1)]  # of an array the interval is known


@settings(deadline=None, max_examples=50)
@given(
    st.lists(st.tuples(st.integers(2, 40), st.floats(0, 100)), min_size=1, max_size=6),
    st.sampled_from(INTERVALS),
)
def test_labelled_records_are_found(records, dt):
    X = frame(*((f"r{i}", dt * (start + np.arange(n))) for i, (n, start) in enumerate(records)))
    found = record_slices(X)
    assert [r.label for r in found] == [f"r{i}" for i in range(len(records))]
    assert [r.n_samples for r in found] == [n for n, _ in records]
    assert [r.start_time for r in found] == pytest.approx([dt * s for _, s in records])
    assert found[0].dt == pytest.approx(dt, rel=1e-8)
    assert sum(len(X.iloc[r.rows]) for r in found) == len(X)


@pytest.mark.parametrize("scale", [1e-12, 1e12])
def test_tiny_and_huge_times(scale):
    assert sampling_interval(single(scale * np.arange(100))) == pytest.approx(scale)


@pytest.mark.parametrize(
    "times",
    [
        pd.date_range("2024-02-28 23:59:59", periods=20, freq="5ms"),
        pd.date_range("2024-02-28", periods=20, freq="5ms", tz="Europe/Berlin"),
        pd.date_range("2024-02-28", periods=20, freq="5ms", unit="us"),
        pd.timedelta_range("1s", periods=20, freq="5ms"),
        pd.Index(1.0 + 0.005 * np.arange(20)),
        pd.Index(1.0 + 0.005 * np.arange(20), dtype="float32"),
        pd.Index(1.0 + 0.005 * np.arange(20), dtype="Float64"),
    ],
)
def test_types_of_time(times):
    assert sampling_interval(single(times)) == pytest.approx(0.005, rel=1e-4)
    stacked = frame(("a", times))
    assert sampling_interval(stacked) == pytest.approx(0.005, rel=1e-4)
    cut = stacked.drop(stacked.index[8:11])
    assert spans(cut) == [("a", 0, 8), ("a", 8, 17)]


def test_start_time_of_dates_is_unix_time():
    times = pd.date_range("2024-02-28", periods=4, freq="1s")
    assert record_slices(single(times))[0].start_time == times[0].timestamp()
    assert record_slices(single(pd.timedelta_range("2s", periods=4, freq="1s")))[0].start_time == 2


def test_levels_go_by_their_names_and_labels_are_plain_python():
    records = ("a", [0.0, 0.1]), ("b", [0.0, 0.1])
    for X in (frame(*records).swaplevel(), frame(*records, names=(None, None))):
        assert spans(X) == [("a", 0, 2), ("b", 2, 4)]
    assert type(record_slices(frame((1, [0.0, 0.1])))[0].label) is int


def test_an_integer_index_counts_samples_and_its_holes_split():
    X = single(np.r_[0:10, 15:20])
    assert spans(X, dt=0.1) == [(0, 0, 10), (0, 10, 15)]
    assert [r.start_time for r in record_slices(X, dt=0.1)] == pytest.approx([0.0, 1.5])
    assert sampling_interval(X, dt=0.1) == 0.1


@pytest.mark.parametrize("step", [0.1, 1])
def test_a_restart_and_the_same_label_again_start_a_record(step):
    X = single(np.concatenate([np.arange(5), np.arange(7), np.arange(3)]) * step)
    assert spans(X) == [(0, 0, 5), (1, 5, 12), (2, 12, 15)]
    times = np.arange(4) * step
    X = frame(("a", times), ("b", times), ("a", times + 90 * step))
    assert spans(X) == [("a", 0, 4), ("b", 4, 8), ("a", 8, 12)]


@settings(deadline=None, max_examples=50)
@given(st.integers(20, 200), st.data())
def test_a_gap_splits_and_a_missing_half_interval_does_not(n, data):
    cut = data.draw(st.integers(2, n - 2))
    gap = data.draw(st.floats(0.8, 1000))
    times = np.arange(n) * 0.01
    times[cut:] += gap * 0.01
    assert spans(single(times)) == [(0, 0, cut), (0, cut, n)]
    assert spans(frame(("a", times))) == [("a", 0, cut), ("a", cut, n)]
    times[cut:] -= (gap - 0.2) * 0.01
    assert len(record_slices(single(times))) == 1


def test_what_a_splitter_cuts_out_is_seen():
    X = frame(("a", np.arange(50) * 0.1), ("b", np.arange(50) * 0.1))
    train, test = list(KFold(5).split(X))[1]
    assert spans(X.iloc[train]) == [("a", 0, 20), ("a", 20, 30), ("b", 30, 80)]
    assert spans(X.iloc[test]) == [("a", 0, 20)]


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1), st.sampled_from(INTERVALS), st.integers(20, 400))
def test_time_stamps_rounded_by_a_tenth_are_even(seed, dt, n):
    rounding = np.random.default_rng(seed).uniform(-0.1, 0.1, n)
    found = record_slices(single(dt * (np.arange(n) + rounding)))
    assert len(found) == 1
    assert found[0].dt == pytest.approx(dt, rel=0.2 / (n - 1) + 1e-8)


def test_rounding_of_files_and_of_a_unix_time_is_even():
    X = single(np.round(np.arange(20_000) / 102_400, 6))
    assert sampling_interval(X) == pytest.approx(1 / 102_400, rel=5.2e-6)  # 1 us of 0.195 s
    X = single(1.7e9 + 1e-5 * np.arange(5000))
    assert sampling_interval(X) == pytest.approx(1e-5, rel=1e-4)


@pytest.mark.parametrize("dt", [0.001, 1 / 1024, 0.00015625])
def test_the_interval_does_not_depend_on_the_rows_picked(dt):
    X = single(np.arange(1000) * dt)
    assert {sampling_interval(X.iloc[a:b]) for a, b in [(0, 1000), (3, 90), (500, 503)]} == {dt}


@settings(deadline=None, max_examples=40)
@example(2414619, 20, 1, False)
@given(st.integers(0, 2**32 - 1), st.integers(20, 300), st.integers(1, 4), st.booleans())
def test_shuffled_rows_are_refused(seed, n, n_records, labelled):
    X = frame(*((i, np.arange(n) * 0.1) for i in range(n_records)))
    X = X if labelled else single(np.arange(n) * 0.1)
    X = X.sample(frac=1.0, random_state=seed)
    with pytest.raises(RecordError, match=r"RecordKFold|same time"):
        record_slices(X)


@pytest.mark.parametrize("index", ["float", "integer", "range", "stacked", "dates"])
def test_random_splits_and_reversed_rows_are_refused_with_the_remedy(index):
    n = 200
    X = {
        "float": single(np.arange(n) * 0.1),
        "integer": single(np.arange(n)),
        "range": pd.DataFrame({"drive": np.zeros(n)}),
        "stacked": frame((0, np.arange(n) * 0.1)),
        "dates": single(pd.date_range("2024-01-01", periods=n, freq="1ms")),
    }[index]
    train, test = next(KFold(4, shuffle=True, random_state=0).split(X))
    for part in (X.iloc[train], X.iloc[test], *train_test_split(X, random_state=0), X.iloc[::-1]):
        with pytest.raises(RecordError, match="RecordKFold or BlockedTimeSeriesSplit"):
            record_slices(part)


TIMES = np.arange(9) * 0.1
TWO = frame(("a", TIMES), ("b", TIMES))
LOST = np.isin(np.arange(10), [3, 7])
UNEVEN = (
    np.cumsum(np.random.default_rng(0).uniform(0.6, 1.4, 100)),
    np.geomspace(1.0, 2.0, 50),
    np.r_[0:50, 50 + 1.1 * np.arange(50)],
    np.r_[np.arange(100), 100 + 2 * np.arange(100)] * 0.5,
)
NO_TIMES = (list("abcd"), [True, False] * 2, pd.period_range("2024", periods=4, freq="D"))
LEVELS = pd.MultiIndex.from_arrays([[0, 0], [0, 0], [0.0, 0.1]])
REFUSED = [
    (TWO.sort_index(level="time"), "sort_index"),
    (single([0.0, 0.1, 0.1, 0.2]), "Rows 1 and 2 have the same time"),
    (frame(("a", TIMES), ("b", [0.0]), ("c", TIMES)), r"two samples. Got 1 row\(s\) \(9\)"),
    (single([0.5]), "does not determine the sampling interval"),
    (single(np.arange(0, 40, 2)), "steps of 2 instead.*give times in seconds as floats"),
    (single(1000 * np.arange(20)), "steps of 1000 instead.*If they are times"),
    *((single(times), "resample_records") for times in UNEVEN),
    *(
        (X, r"2 row\(s\) \(3, 7\) without a finite time")
        for bad in (np.nan, np.inf)
        for times in [np.where(LOST, bad, 0.1 * np.arange(10))]
        for X in (single(times), frame(("a", times)))
    ),
    (frame(("a", [0.0, 0.1]), (None, [0.0, 0.1])), r"label. Got 2 row\(s\) \(2, 3\)"),
    *((single(index), r"pd\.to_timedelta.*reset_index\(drop=True\)") for index in NO_TIMES),
    (pd.DataFrame({"u": [0.0, 0.0]}, LEVELS), "3 levels"),
]


@pytest.mark.parametrize(("X", "message"), REFUSED)
def test_what_forms_no_even_records_is_refused_with_the_remedy(X, message):
    with pytest.raises(RecordError, match=message):
        record_slices(X)


@pytest.mark.parametrize("ratio", [1.05, 2.0, 10.0])
def test_records_of_different_intervals_are_refused(ratio):
    X = frame(("slow", np.arange(100) * 0.1 * ratio), ("fast", np.arange(300) * 0.1))
    with pytest.raises(RecordError, match=r"same sampling interval.*'slow'.*resample_records"):
        record_slices(X)
    found = [record.dt for record in record_slices(X, one_interval=False)]
    assert found == pytest.approx([0.1 * ratio, 0.1])


@pytest.mark.parametrize("dt", [0.0, -1.0, np.nan, np.inf, "1", 1j])
def test_dt_is_checked(dt):
    with pytest.raises(RecordError, match="'dt' parameter of record_slices"):
        record_slices(np.zeros((3, 1)), dt=dt)


def test_an_index_that_only_y_has_is_refused():
    y = TWO["drive"]
    scaled = StandardScaler().fit_transform(TWO)
    hole = pd.Series(np.zeros(30)).drop(range(10, 20))
    for X, own in ((scaled, y), (pd.DataFrame(scaled), y), (np.zeros((20, 1)), hole)):
        with pytest.raises(RecordError, match=r'set_output\(transform="pandas"\)'):
            record_slices(X, own)
    kept = StandardScaler().set_output(transform="pandas").fit_transform(TWO)
    for X, own in ((kept, y), (TWO, y.to_numpy()), (TWO, y.copy())):
        assert record_slices(X, own) == record_slices(TWO)
    assert len(record_slices(np.zeros((30, 1)), pd.Series(np.zeros(30)))) == 1
    with pytest.raises(RecordError, match="must be equal"):
        record_slices(TWO, y.iloc[::-1])


def test_nothing_is_changed():
    before = TWO.copy()
    record_slices(TWO, TWO["drive"])
    assert record_slices(TWO.sort_index(level="time").sort_index()) == record_slices(TWO)
    pd.testing.assert_frame_equal(TWO, before)


@pytest.mark.parametrize("values", [np.arange(0.0, 40.0, 10.0), np.arange(0, 40, 10)])
def test_numbers_named_in_another_unit_than_seconds_are_refused(values):
    with pytest.raises(RecordError, match=r"must be in seconds.*of times in ms.*by 0\.001"):
        record_slices(pd.DataFrame({"u": values}, pd.Index(values, name="time (ms)")))
    stamps = pd.to_timedelta(values, unit="ms").rename("time_ms")
    [record] = record_slices(pd.DataFrame({"u": values}, stamps))
    assert record.dt == pytest.approx(0.01)
