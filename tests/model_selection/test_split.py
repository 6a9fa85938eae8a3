"""Splitters: partitions, whole records, gaps, and life inside scikit-learn."""

import numpy as np
import pandas as pd
import pytest
import sklearn
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.base import BaseEstimator, RegressorMixin, clone
from sklearn.experimental import enable_halving_search_cv  # noqa: F401
from sklearn.linear_model import LinearRegression, Ridge
from sklearn.metrics import root_mean_squared_error
from sklearn.model_selection import (
    GridSearchCV,
    HalvingGridSearchCV,
    KFold,
    check_cv,
    cross_val_predict,
    cross_val_score,
    cross_validate,
)
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skhyst.exceptions import RecordError
from skhyst.hysteresis import PrandtlIshlinskii, PrandtlIshlinskiiOperator
from skhyst.model_selection import BlockedTimeSeriesSplit, RecordKFold, washout_scorer
from skhyst.records import record_slices, stack_records

NO_NUMBERS = (1, 2.0, "3", None)
lengths = st.lists(st.integers(2, 60), min_size=2, max_size=8)


def stacked(sizes, seed=0):
    rng = np.random.default_rng(seed)
    u = [rng.standard_normal(n) for n in sizes]
    return stack_records([(x, 3.0 * x + 0.1) for x in u], dt=0.01)


def hysteresis_records(n_records=4, n_samples=200):
    """Return records of two plays, each driven from zero to a swing of its own."""
    rng = np.random.default_rng(0)
    records, plays = [], PrandtlIshlinskiiOperator([0.0, 0.2], [1.0, 0.7])
    for _ in range(n_records):
        turns = np.r_[0.0, rng.uniform(0.3, 1.0, 8) * (-1.0) ** np.arange(8)]
        drive = np.interp(np.linspace(0, 8, n_samples), np.arange(9), turns)
        records.append((drive, plays.run(drive, 0.01)[0]))
    return stack_records(records, dt=0.01)


class RecordCounter(RegressorMixin, BaseEstimator):
    """Reads the records in fit and in predict, as a dynamic model does."""

    seen = ()

    def fit(self, X, y):
        self.fitted_ = record_slices(X, y)
        return self

    def predict(self, X):
        RecordCounter.seen += ((self.fitted_, record_slices(X)),)
        return np.zeros(len(X))


@settings(deadline=None, max_examples=40)
@given(lengths, st.booleans(), st.integers(0, 5), st.data())
def test_record_folds_partition_whole_records_as_kfold_does_rows(sizes, shuffle, seed, data):
    X, _ = stacked(sizes)
    n_splits = data.draw(st.integers(2, len(sizes)))
    labels = X.index.get_level_values("record")
    options = {"shuffle": shuffle, "random_state": seed if shuffle else None}
    cv = RecordKFold(n_splits, **options)
    rows = KFold(n_splits, **options).split(np.zeros(len(sizes)))
    for (train, test), (_, expected) in zip(cv.split(X), rows, strict=True):
        assert np.unique(labels[test]).tolist() == expected.tolist()
        assert set(labels[train]).isdisjoint(labels[test])
        np.testing.assert_array_equal(np.sort(np.r_[train, test]), np.arange(len(X)))
        assert (np.diff(train) > 0).all()
        assert (np.diff(test) > 0).all()
    assert cv.get_n_splits() == n_splits


def test_pieces_of_one_record_stay_together():
    X, _ = stacked([20, 20])
    X = X.drop(X.index[5:9])
    for _, test in RecordKFold(2).split(X):
        assert len(set(X.index.get_level_values("record")[test])) == 1
    assert sorted(len(test) for _, test in RecordKFold(2).split(X)) == [16, 20]


def test_a_time_index_that_restarts_is_split_at_the_restarts():
    X = pd.DataFrame({"u": np.zeros(9)}, index=np.tile(np.arange(3) * 0.1, 3))
    assert [t.tolist() for _, t in RecordKFold(3).split(X)] == [[0, 1, 2], [3, 4, 5], [6, 7, 8]]


@settings(deadline=None, max_examples=60)
@given(lengths, st.integers(2, 5), st.integers(0, 6), st.booleans())
def test_blocks_partition_long_records_and_leave_gaps(sizes, n_splits, washout, staggered):
    X, y = stacked([*sizes, 100])
    long = [r for r in record_slices(X) if r.n_samples >= 2 * n_splits]
    record = X.index.codes[0]
    tested = []
    cv = BlockedTimeSeriesSplit(n_splits, washout=washout, staggered=staggered)
    for train, test in cv.split(X, y):
        assert set(train).isdisjoint(test)
        left_out = np.setdiff1d(np.arange(len(X)), np.r_[train, test])
        for row in left_out:  # in the gap, or alone behind it; never in a short record
            near = test[record[test] == record[row]]
            assert np.abs(near - row).min() <= washout + 1
        for row in train:
            near = test[record[test] == record[row]]
            assert near.size == 0 or np.abs(near - row).min() > washout
        assert len(record_slices(X.iloc[test])) == len(long)
        record_slices(X.iloc[train])  # nothing is left standing alone
        tested.append(test)
    expected = np.concatenate([np.arange(r.rows.start, r.rows.stop) for r in long])
    np.testing.assert_array_equal(np.sort(np.concatenate(tested)), expected)


@settings(deadline=None, max_examples=30)
@given(st.integers(2, 6), st.integers(0, 40))
def test_blocks_of_one_record_are_the_folds_of_kfold(n_splits, more):
    X = np.zeros((2 * n_splits + more, 1))
    ours, theirs = BlockedTimeSeriesSplit(n_splits).split(X), KFold(n_splits).split(X)
    for (_, test), (_, expected) in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(test, expected)


def test_staggered_blocks_train_on_all_parts_of_a_repeated_drive():
    drive = np.sin(np.arange(60))
    X, y = stack_records([(drive, k * drive) for k in range(1, 4)])
    part = np.tile(np.arange(60), 3)
    for train, test in BlockedTimeSeriesSplit(3, staggered=True).split(X, y):
        np.testing.assert_array_equal(np.unique(part[train]), np.arange(60))
        np.testing.assert_array_equal(np.sort(part[test]), np.arange(60))


@pytest.mark.parametrize("hole", [3, 30])
def test_the_washout_reaches_across_a_short_hole_and_not_across_a_long_one(hole):
    time = np.r_[0:20, 20 + hole : 40 + hole] * 0.1
    labels = np.zeros(40, dtype=int)
    X = pd.DataFrame(
        {"u": 0.0}, index=pd.MultiIndex.from_arrays([labels, time], names=["record", "time"])
    )
    train, test = next(BlockedTimeSeriesSplit(2, washout=5).split(X))
    np.testing.assert_array_equal(test, np.r_[0:10, 20:30])
    # Row 19 is hole + 1 intervals before row 20, which is tested.
    last = 18 if hole == 3 else 20
    np.testing.assert_array_equal(train, np.r_[15:last, 35:40])


@pytest.mark.parametrize(
    "index",
    [
        pd.RangeIndex(60),
        pd.Index(np.arange(60) * 0.01, name="time"),
        pd.date_range("2024-01-01", periods=60, freq="10ms"),
        pd.timedelta_range(0, periods=60, freq="10ms"),
    ],
    ids=["default", "seconds", "datetimes", "timedeltas"],
)
def test_every_kind_of_index_gives_the_same_blocks(index):
    cv = BlockedTimeSeriesSplit(4, washout=2)
    framed = cv.split(pd.DataFrame({"u": np.zeros(60)}, index=index))
    np.testing.assert_equal(list(framed), list(cv.split(np.zeros((60, 1)))))


def test_a_model_sees_the_hole_that_a_test_block_leaves():
    X, y = stacked([40])
    train, test = list(BlockedTimeSeriesSplit(4, washout=3).split(X))[1]
    pieces = record_slices(X.iloc[train], y.iloc[train])
    assert [p.n_samples for p in pieces] == [7, 17]
    assert pieces[1].start_time == pytest.approx(0.23)
    assert len(test) == 10


@pytest.mark.parametrize(
    ("cv", "X", "message"),
    [
        *((RecordKFold(n), [30, 30], "'n_splits' parameter of RecordKFold") for n in NO_NUMBERS),
        (BlockedTimeSeriesSplit(1), [30], "'n_splits' parameter of BlockedTimeSeriesSplit"),
        (BlockedTimeSeriesSplit(2, washout=-1), [50], "'washout' parameter of BlockedTimeSeriesSp"),
        (RecordKFold(5), np.zeros((50, 1)), r"1 record\(s\) .* use BlockedTimeSeriesSplit"),
        (RecordKFold(5), pd.DataFrame(np.zeros((50, 1))), "use BlockedTimeSeriesSplit"),
        (RecordKFold(5), [5, 5, 5], r"Got n_splits=5 and 3 record\(s\)"),
        (RecordKFold(2, random_state=1), [4, 4], "random_state"),
        (BlockedTimeSeriesSplit(5), [9], "two samples in each block"),
        (BlockedTimeSeriesSplit(2, washout=30), [30], "must leave rows to train on"),
    ],
)
def test_what_cannot_be_split_is_refused(cv, X, message):
    X = stacked(X)[0] if isinstance(X, list) else X
    with pytest.raises(ValueError, match=message):
        list(cv.split(X))


def test_unlabelled_records_that_would_join_are_refused():
    times = np.concatenate([np.arange(4), np.arange(2), np.arange(4, 8)]) * 0.1
    X = pd.DataFrame({"u": np.zeros(10)}, index=times)
    with pytest.raises(RecordError, match="The records need labels"):
        list(RecordKFold(3).split(X))


def test_groups_are_not_used_and_nothing_is_changed():
    X, y = stacked([30, 30])
    before = X.copy(), y.copy()
    list(BlockedTimeSeriesSplit(3, washout=4, staggered=True).split(X, y))
    with pytest.warns(UserWarning, match="groups parameter is ignored"):
        list(RecordKFold(2, shuffle=True, random_state=0).split(X, y, groups=np.zeros(60)))
    pd.testing.assert_frame_equal(X, before[0])
    pd.testing.assert_series_equal(y, before[1])


def test_constructors_assign_and_the_representation_names_the_parameters():
    for cv in (RecordKFold("many", random_state=1), BlockedTimeSeriesSplit(-1, washout="long")):
        assert cv.get_n_splits() == cv.n_splits
        assert clone(cv, safe=False).n_splits == cv.n_splits
    assert repr(RecordKFold(3)) == "RecordKFold(n_splits=3, random_state=None, shuffle=False)"
    blocks = "BlockedTimeSeriesSplit(n_splits=5, staggered=False, washout=7)"
    assert repr(BlockedTimeSeriesSplit(washout=7)) == blocks


@pytest.mark.parametrize("routing", [False, True])
@pytest.mark.parametrize("cv", [RecordKFold(3), BlockedTimeSeriesSplit(3, washout=2)])
def test_splitters_inside_scikit_learn(cv, routing):
    X, y = stacked([30, 40, 50, 60])
    pipeline = make_pipeline(StandardScaler().set_output(transform="pandas"), Ridge())
    RecordCounter.seen = ()
    with sklearn.config_context(enable_metadata_routing=routing):
        search = GridSearchCV(pipeline, {"ridge__alpha": [1e-6, 1e6]}, cv=cv).fit(X, y)
        scores = cross_val_score(RecordCounter(), X, y, cv=cv, scoring="r2", params={})
    assert search.best_params_ == {"ridge__alpha": 1e-6}
    assert check_cv(cv) is cv
    assert scores.shape == (3,)
    for fitted, predicted in RecordCounter.seen:
        assert {r.dt for r in (*fitted, *predicted)} == {0.01}


def test_searches_nest():
    X, y = hysteresis_records(6)
    inner = BlockedTimeSeriesSplit(2, washout=5)
    scorer = washout_scorer(root_mean_squared_error, washout=5)
    search = GridSearchCV(Ridge(), {"alpha": [1e-6, 1e4]}, cv=inner, scoring=scorer)
    for outer in (RecordKFold(3), BlockedTimeSeriesSplit(3, washout=5)):
        options = {"cv": outer, "return_estimator": True, "error_score": "raise"}
        fitted = cross_validate(search, X, y, **options)["estimator"]
        assert [one.best_params_["alpha"] for one in fitted] == [1e-6] * 3


@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ExtrapolationWarning")
def test_blocks_work_on_arrays():
    X, y = (part.to_numpy() for part in stacked([90]))
    scores = cross_val_score(LinearRegression(), X, y, cv=BlockedTimeSeriesSplit(3))
    np.testing.assert_allclose(scores, 1.0)
    predicted = cross_val_predict(LinearRegression(), X, y, cv=BlockedTimeSeriesSplit(3))
    np.testing.assert_allclose(predicted, y)
    X, y = (part.to_numpy() for part in hysteresis_records(1, 600))
    cv = BlockedTimeSeriesSplit(3, washout=20)
    assert np.isfinite(cross_val_score(PrandtlIshlinskii(5), X, y, cv=cv)).all()


@pytest.mark.filterwarnings("ignore:The records do not begin at rest")  # those of blocks
@pytest.mark.parametrize("cv", [RecordKFold(4), BlockedTimeSeriesSplit(3, washout=20)])
def test_a_model_with_memory_is_identified_in_every_fold(cv):
    """Blocks begin with a memory that nobody knows, so only the fits of whole records are exact."""
    X, y = hysteresis_records()
    model = PrandtlIshlinskii(thresholds=[0.0, 0.2])
    scores = cross_val_score(model, X, y, cv=cv, scoring="r2", error_score="raise")
    np.testing.assert_allclose(scores, 1.0, atol=1e-9 if isinstance(cv, RecordKFold) else 0.2)


def test_the_washout_takes_the_unknown_memory_out_of_the_score():
    X, y = hysteresis_records()
    used = X.groupby(level="record").cumcount() >= 60  # a device in use before the record
    X, y = X[used], y[used]
    model = PrandtlIshlinskii(thresholds=[0.0, 0.2]).fit(*hysteresis_records())
    whole = washout_scorer(root_mean_squared_error, washout=0)(model, X, y)
    settled = washout_scorer(root_mean_squared_error, washout=100)(model, X, y)
    assert whole < -1e-3
    assert settled == pytest.approx(0.0, abs=1e-9)


@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ExtrapolationWarning")
def test_a_search_that_halves_takes_a_parameter_as_its_resource():
    rng = np.random.default_rng(0)
    records = [np.cumsum(rng.normal(size=(200, 1)), axis=0) for _ in range(4)]
    X, y = stack_records([(u, u[:, 0] + 0.1 * rng.normal(size=200)) for u in records], dt=0.01)
    grid = {"thresholds": ["grid", "quantile"]}
    options = {"cv": RecordKFold(2), "error_score": "raise", "random_state": 0}
    search = HalvingGridSearchCV(
        PrandtlIshlinskii(), grid, resource="n_operators", max_resources=6, **options
    ).fit(X, y)
    assert search.best_estimator_.n_operators <= 6
    with pytest.raises(RecordError, match="needs a parameter as its resource"):
        HalvingGridSearchCV(PrandtlIshlinskii(), grid, **options).fit(X, y)
