"""Splitters: partitions, whole records, gaps, and life inside scikit-learn."""

import numpy as np
import pandas as pd
import pytest
import sklearn
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.linear_model import LinearRegression, Ridge
from sklearn.model_selection import GridSearchCV, check_cv, cross_val_predict, cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skhyst.exceptions import RecordError
from skhyst.model_selection import BlockedTimeSeriesSplit, RecordKFold
from skhyst.records import record_slices, stack_records

lengths = st.lists(st.integers(2, 60), min_size=2, max_size=8)


def stacked(sizes, seed=0):
    rng = np.random.default_rng(seed)
    u = [rng.standard_normal(n) for n in sizes]
    return stack_records([(x, 3.0 * x + 0.1) for x in u], dt=0.01)


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
def test_record_folds_partition_whole_records(sizes, shuffle, seed, data):
    X, _ = stacked(sizes)
    n_splits = data.draw(st.integers(2, len(sizes)))
    labels = X.index.get_level_values("record")
    cv = RecordKFold(n_splits, shuffle=shuffle, random_state=seed if shuffle else None)
    tested = []
    for train, test in cv.split(X):
        assert set(labels[train]).isdisjoint(labels[test])
        np.testing.assert_array_equal(np.sort(np.r_[train, test]), np.arange(len(X)))
        assert (np.diff(train) > 0).all()
        assert (np.diff(test) > 0).all()
        tested.append(test)
    np.testing.assert_array_equal(np.sort(np.concatenate(tested)), np.arange(len(X)))
    assert len(tested) == cv.get_n_splits()


def test_shuffling_deals_records_in_another_order():
    X, _ = stacked([5] * 20)
    plain = [test.tolist() for _, test in RecordKFold(4).split(X)]
    one, again, other = (
        [t.tolist() for _, t in RecordKFold(4, shuffle=True, random_state=seed).split(X)]
        for seed in (0, 0, 1)
    )
    assert one == again
    assert one != other
    assert one != plain


def test_pieces_of_one_record_stay_together():
    X, _ = stacked([20, 20])
    X = X.drop(X.index[5:9])
    for _, test in RecordKFold(2).split(X):
        assert len(set(X.index.get_level_values("record")[test])) == 1
    assert sorted(len(test) for _, test in RecordKFold(2).split(X)) == [16, 20]


def test_a_time_index_that_restarts_is_split_at_the_restarts():
    X = pd.DataFrame({"u": np.zeros(9)}, index=np.tile(np.arange(3) * 0.1, 3))
    assert [t.tolist() for _, t in RecordKFold(3).split(X)] == [[0, 1, 2], [3, 4, 5], [6, 7, 8]]


@pytest.mark.parametrize("X", [np.zeros((50, 1)), pd.DataFrame(np.zeros((50, 1)))])
def test_one_record_is_referred_to_blocks(X):
    with pytest.raises(ValueError, match=r"1 record\(s\) .* use BlockedTimeSeriesSplit"):
        RecordKFold(5).split(X)


def test_too_few_records_are_refused():
    with pytest.raises(ValueError, match=r"Got n_splits=5 and 3 record\(s\)"):
        RecordKFold(5).split(stacked([5, 5, 5])[0])


@settings(deadline=None, max_examples=60)
@given(lengths, st.integers(2, 5), st.integers(0, 6))
def test_blocks_partition_long_records_and_leave_gaps(sizes, n_splits, washout):
    X, _ = stacked([*sizes, 100])
    long = [r for r in record_slices(X) if r.n_samples >= 2 * n_splits]
    record = X.index.codes[0]
    tested = []
    for train, test in BlockedTimeSeriesSplit(n_splits, washout=washout).split(X):
        assert set(train).isdisjoint(test)
        left_out = np.setdiff1d(np.arange(len(X)), np.r_[train, test])
        for row in left_out:  # in the gap, or alone behind it
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


def test_short_records_are_always_trained_on():
    X, _ = stacked([40, 5, 40])
    for train, test in BlockedTimeSeriesSplit(4, washout=3).split(X):
        assert set(range(40, 45)) <= set(train)
        assert len(test) == 20


def test_blocks_refuse_what_leaves_nothing():
    with pytest.raises(ValueError, match="two samples in each block"):
        BlockedTimeSeriesSplit(5).split(np.zeros((9, 1)))
    with pytest.raises(ValueError, match="must leave rows to train on"):
        list(BlockedTimeSeriesSplit(2, washout=30).split(np.zeros((30, 1))))


def test_unlabelled_records_that_would_join_are_refused():
    times = np.concatenate([np.arange(4), np.arange(2), np.arange(4, 8)]) * 0.1
    X = pd.DataFrame({"u": np.zeros(10)}, index=times)
    with pytest.raises(RecordError, match="The records need labels"):
        list(RecordKFold(3).split(X))


def test_groups_are_not_used():
    X, _ = stacked([30, 30])
    with pytest.warns(UserWarning, match="groups parameter is ignored"):
        RecordKFold(2).split(X, groups=np.zeros(60))


def test_a_model_sees_the_hole_that_a_test_block_leaves():
    X, y = stacked([40])
    train, test = list(BlockedTimeSeriesSplit(4, washout=3).split(X))[1]
    pieces = record_slices(X.iloc[train], y.iloc[train])
    assert [p.n_samples for p in pieces] == [7, 17]
    assert pieces[1].start_time == pytest.approx(0.23)
    assert len(test) == 10


@pytest.mark.parametrize("cv", [RecordKFold(3), BlockedTimeSeriesSplit(3, washout=2)])
def test_splitters_inside_scikit_learn(cv):
    X, y = stacked([30, 40, 50, 60])
    pipeline = make_pipeline(StandardScaler().set_output(transform="pandas"), Ridge())
    search = GridSearchCV(pipeline, {"ridge__alpha": [1e-6, 1e6]}, cv=cv).fit(X, y)
    assert search.best_params_ == {"ridge__alpha": 1e-6}
    assert check_cv(cv) is cv
    RecordCounter.seen = ()
    scores = cross_val_score(RecordCounter(), X, y, cv=cv, scoring="r2")
    assert scores.shape == (3,)
    for fitted, predicted in RecordCounter.seen:
        assert {r.dt for r in (*fitted, *predicted)} == {0.01}


def test_blocks_work_on_arrays():
    X, y = (part.to_numpy() for part in stacked([90]))
    scores = cross_val_score(LinearRegression(), X, y, cv=BlockedTimeSeriesSplit(3))
    np.testing.assert_allclose(scores, 1.0)
    predicted = cross_val_predict(LinearRegression(), X, y, cv=BlockedTimeSeriesSplit(3))
    np.testing.assert_allclose(predicted, y)


def test_metadata_routing_may_be_on():
    X, y = stacked([30, 40, 50])
    with sklearn.config_context(enable_metadata_routing=True):
        cross_val_score(LinearRegression(), X, y, cv=RecordKFold(3))
        GridSearchCV(Ridge(), {"alpha": [1.0]}, cv=BlockedTimeSeriesSplit(3)).fit(X, y)


def test_representation_names_the_parameters():
    assert repr(RecordKFold(3)) == "RecordKFold(n_splits=3, random_state=None, shuffle=False)"
    assert (
        repr(BlockedTimeSeriesSplit(washout=7))
        == "BlockedTimeSeriesSplit(n_splits=5, staggered=False, washout=7)"
    )


@pytest.mark.parametrize("splitter", [RecordKFold, BlockedTimeSeriesSplit])
@pytest.mark.parametrize("n_splits", [1, 2.0, "3", None])
def test_number_of_splits_is_checked(splitter, n_splits):
    with pytest.raises(ValueError, match=r"'n_splits' parameter of \w+ must be an int"):
        splitter(n_splits).split(stacked([30, 30])[0])


def test_washout_is_checked():
    with pytest.raises(ValueError, match="'washout' parameter of BlockedTimeSeriesSplit"):
        BlockedTimeSeriesSplit(2, washout=-1).split(np.zeros((50, 1)))
