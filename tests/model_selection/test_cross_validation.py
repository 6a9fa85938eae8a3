"""Splitters against scikit-learn's, across holes, nested, and with a model that has memory."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.base import clone
from sklearn.linear_model import Ridge
from sklearn.metrics import make_scorer, root_mean_squared_error
from sklearn.model_selection import GridSearchCV, KFold, cross_val_score, cross_validate

from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.metrics import nrmse
from skhyst.model_selection import BlockedTimeSeriesSplit, RecordKFold, washout_scorer
from skhyst.records import stack_records


def hysteresis_records(n_records=4, n_samples=200):
    """Return records of two plays, each driven from zero to a swing of its own."""
    rng = np.random.default_rng(0)
    records = []
    for _ in range(n_records):
        turns = np.r_[0.0, rng.uniform(0.3, 1.0, 8) * (-1.0) ** np.arange(8)]
        drive = np.interp(np.linspace(0, 8, n_samples), np.arange(9), turns)
        plays, response = np.zeros(2), []
        for u in drive:
            plays = np.maximum(u - [0.0, 0.2], np.minimum(u + [0.0, 0.2], plays))
            response.append(plays @ [1.0, 0.7])
        records.append((drive, np.array(response)))
    return stack_records(records, dt=0.01)


@settings(deadline=None, max_examples=30)
@given(st.integers(2, 6), st.integers(0, 40))
def test_blocks_of_one_record_are_the_folds_of_kfold(n_splits, more):
    X = np.zeros((2 * n_splits + more, 1))
    ours, theirs = BlockedTimeSeriesSplit(n_splits).split(X), KFold(n_splits).split(X)
    for (_, test), (_, expected) in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(test, expected)


@pytest.mark.parametrize("options", [{}, {"shuffle": True, "random_state": 3}])
def test_records_are_dealt_as_kfold_deals_rows(options):
    X = stack_records([np.zeros(n) for n in (3, 5, 2, 4, 6, 3, 2)])
    record = X.index.codes[0]
    theirs = KFold(3, **options).split(np.zeros(7))
    for (_, test), (_, expected) in zip(RecordKFold(3, **options).split(X), theirs, strict=True):
        np.testing.assert_array_equal(np.unique(record[test]), expected)


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
    for ours, plain in zip(framed, cv.split(np.zeros((60, 1))), strict=True):
        np.testing.assert_array_equal(ours[0], plain[0])
        np.testing.assert_array_equal(ours[1], plain[1])


def test_constructors_assign_and_nothing_else():
    for cv in (RecordKFold("many", random_state=1), BlockedTimeSeriesSplit(-1, washout="long")):
        assert cv.get_n_splits() == cv.n_splits
        assert clone(cv, safe=False).n_splits == cv.n_splits
    X = stack_records([np.zeros(4), np.zeros(4)])
    with pytest.raises(ValueError, match="random_state"):
        RecordKFold(2, random_state=1).split(X)


def test_splitting_changes_nothing_in_its_arguments():
    X, y = hysteresis_records()
    before = X.copy(), y.copy()
    list(BlockedTimeSeriesSplit(3, washout=4).split(X, y))
    list(RecordKFold(2, shuffle=True, random_state=0).split(X, y))
    pd.testing.assert_frame_equal(X, before[0])
    pd.testing.assert_series_equal(y, before[1])


def test_a_model_with_memory_is_identified_in_every_fold_of_records():
    X, y = hysteresis_records()
    model = PrandtlIshlinskii(thresholds=[0.0, 0.2])
    scores = cross_validate(model, X, y, cv=RecordKFold(4), scoring="r2", error_score="raise")
    np.testing.assert_allclose(scores["test_score"], 1.0, atol=1e-9)


@pytest.mark.parametrize("strip", [False, True], ids=["labelled frame", "array"])
def test_a_model_with_memory_runs_on_blocks(strip):
    X, y = hysteresis_records(1, 600)
    if strip:
        X, y = X.to_numpy(), y.to_numpy()
    model, cv = PrandtlIshlinskii(5), BlockedTimeSeriesSplit(3, washout=20)
    scores = cross_val_score(model, X, y, cv=cv, scoring="r2", error_score="raise")
    assert np.isfinite(scores).all()


def test_the_washout_takes_the_unknown_memory_out_of_the_score():
    X, y = hysteresis_records()
    used = X.groupby(level="record").cumcount() >= 60  # a device in use before the record
    X, y = X[used], y[used]
    model = PrandtlIshlinskii(thresholds=[0.0, 0.2]).fit(*hysteresis_records())
    whole = washout_scorer(root_mean_squared_error, washout=0)(model, X, y)
    settled = washout_scorer(root_mean_squared_error, washout=100)(model, X, y)
    assert whole < -1e-3
    assert settled == pytest.approx(0.0, abs=1e-9)


def test_scorer_without_washout_is_that_of_make_scorer():
    X, y = hysteresis_records()
    model = Ridge().fit(X, y)
    ours = washout_scorer(nrmse, washout=0)
    assert ours(model, X, y) == make_scorer(nrmse, greater_is_better=False)(model, X, y)


def test_searches_nest():
    X, y = hysteresis_records(6)
    inner = BlockedTimeSeriesSplit(2, washout=5)
    scorer = washout_scorer(root_mean_squared_error, washout=5)
    search = GridSearchCV(Ridge(), {"alpha": [1e-6, 1e4]}, cv=inner, scoring=scorer)
    for outer in (RecordKFold(3), BlockedTimeSeriesSplit(3, washout=5)):
        fitted = cross_validate(search, X, y, cv=outer, return_estimator=True, error_score="raise")[
            "estimator"
        ]
        assert [one.best_params_["alpha"] for one in fitted] == [1e-6] * 3
