"""Rows that a recording has lost: one record, on which a model runs on, and which says so."""

import numpy as np
import pandas as pd
import pytest

from skhyst.autoregressive import NARXRegressor
from skhyst.compose import Cascade
from skhyst.diagnosis import EffectSearchCV
from skhyst.hysteresis import PrandtlIshlinskii, PrandtlIshlinskiiOperator
from skhyst.linear import FirstOrderLag, FirstOrderLagOperator
from skhyst.metrics import nrmse
from skhyst.model_selection import BlockedTimeSeriesSplit, RecordKFold, washout_scorer
from skhyst.records import (
    data_quality,
    fill_lost_rows,
    inspect_recording,
    record_names,
    record_slices,
    stack_records,
    with_lost_rows,
)

DT, N, TAU, NOISE = 1e-3, 8000, 0.012, 0.01
PLAYS = PrandtlIshlinskiiOperator(np.array([0.0, 1.0, 2.0, 3.0]), np.array([1.0, 0.5, 0.3, 0.2]))


def recording(n=N, n_lost=30, seed=0):
    """Return a recording of plays and a lag, whole, and which rows are left of it."""
    rng = np.random.default_rng(seed)
    time = DT * np.arange(n)
    u = 5.0 * np.sin(6.0 * np.pi * time) * np.sin(0.6 * np.pi * time + 0.5)
    u += np.convolve(rng.normal(size=n + 19), np.full(20, 0.05), mode="valid")
    y = FirstOrderLagOperator(TAU).run(PLAYS.run(u, DT)[0], DT)[0] + NOISE * rng.normal(size=n)
    lost = rng.choice(np.arange(1, n - 1), n_lost, replace=False)
    return pd.DataFrame({"drive": u}, time), pd.Series(y, time), ~np.isin(np.arange(n), lost)


def model():
    return Cascade([("plays", PrandtlIshlinskii()), ("lag", FirstOrderLag())])


INDEXES = {
    "seconds": lambda n: pd.Index(DT * np.arange(n)),
    "dates": lambda n: pd.date_range("2024-02-29", periods=n, freq="1ms"),
    "counted": lambda n: pd.Index(np.arange(n)),
    "records": lambda n: pd.MultiIndex.from_arrays(
        [np.repeat(["a", "b"], [n // 2, n - n // 2]), DT * np.arange(n)], names=["record", "time"]
    ),
    "time first": lambda n: pd.MultiIndex.from_arrays(
        [pd.date_range("2024-02-29", periods=n, freq="1ms"), np.zeros(n)],
        names=["time", "record"],
    ),
}


@pytest.mark.parametrize("index", INDEXES)
def test_what_is_lost_is_known_and_put_back(index):
    n, lost = 400, [30, 31, 120, 250, 251, 252, 253]
    u = np.interp(np.arange(n), [0, 100, 199, 200, 300, 399], [0, 4, 2, 1, 7, 3])
    whole = pd.DataFrame({"drive": u, "other": 2.0 * u}, INDEXES[index](n))
    kept = ~np.isin(np.arange(n), lost)
    X, y = whole[kept], 3.0 * whole["drive"][kept]
    slices = record_slices(X, dt=DT, bridge=True)
    starts = [0, n // 2] if index == "records" else [0]
    assert len(slices) == len(starts)
    assert [i + s for i, r in zip(starts, slices, strict=True) for s in r.lost] == lost
    own = np.concatenate([i + r.samples for i, r in zip(starts, slices, strict=True)])
    np.testing.assert_array_equal(own, np.flatnonzero(kept))
    X_whole, y_whole, read = fill_lost_rows(X, y)
    np.testing.assert_array_equal(read, kept)
    np.testing.assert_allclose(X_whole, whole, atol=1e-12)
    np.testing.assert_allclose(y_whole, 3.0 * u, atol=1e-12)
    assert list(X_whole.columns) == ["drive", "other"]
    assert X_whole.index.names == whole.index.names
    assert y_whole.index.equals(X_whole.index)
    assert X_whole[read].index.equals(X.index)
    assert len(record_slices(X_whole, dt=DT)) == len(starts)
    if index != "records":  # the other start in s
        np.testing.assert_allclose(slices[0].time - slices[0].start_time, DT * own, atol=1e-6)


def test_without_being_asked_for_a_gap_ends_a_record():
    X, _, kept = recording(n=400, n_lost=3)
    assert len(record_slices(X[kept])) == 4
    assert record_slices(X[kept])[0].lost == ()


@pytest.mark.parametrize(
    ("gap", "n_records"), [(2.0, 1), (5.0, 1), (6.0, 2), (100.0, 2), (2.5, 2), (4.7, 2)]
)
def test_only_a_short_gap_of_whole_intervals_is_lost_rows(gap, n_records):
    times = DT * np.concatenate([np.arange(100), 99 + gap + np.arange(100)])
    slices = record_slices(pd.DataFrame({"drive": times}, times), bridge=True)
    assert len(slices) == n_records
    assert [len(r.lost) for r in slices] == ([int(gap) - 1] if n_records == 1 else [0, 0])


@pytest.mark.parametrize(("every", "n_records"), [(25, 1), (15, 28)])
def test_a_subset_of_the_rows_is_no_recording_with_lost_rows(every, n_records):
    """More than 5 % is what a shuffled fold leaves out."""
    times = DT * np.arange(400)[np.arange(400) % every != 7]
    assert len(record_slices(pd.DataFrame({"drive": times}, times), bridge=True)) == n_records


def test_what_follows_lost_rows_may_be_single():
    times = DT * np.delete(np.arange(100), [40, 42])
    (record,) = record_slices(pd.DataFrame({"drive": times}, times), bridge=True)
    assert record.lost == (40, 42)


def test_nothing_lost_is_nothing_changed():
    X, y, _ = recording(n=50)
    slices = record_slices(X, bridge=True)
    assert slices == record_slices(X)
    assert with_lost_rows(slices, y.to_numpy())[0] is slices
    assert fill_lost_rows(X, y)[0] is X


def test_a_model_is_that_of_the_whole_recording():
    X, y, kept = recording()
    whole, found = model().fit(X, y), model().fit(X[kept], y[kept])
    assert len(found.records_) == 1
    assert len(found.records_[0].lost) == 30
    tau, std = (getattr(found, name)["lag__time_constant"] for name in ("params_", "params_std_"))
    assert abs(tau - whole.params_["lag__time_constant"]) < 0.5 * std
    assert found.fit_error_ == pytest.approx(whole.fit_error_, rel=0.02)
    predicted = found.predict(X[kept])
    assert predicted.shape == (N - 30,)
    # the lost drive is interpolated: up to a thousandth of the range
    assert np.abs(predicted - found.predict(X)[kept]).max() < 0.001 * np.ptp(y)
    assert found.drive_rate_ == pytest.approx(whole.drive_rate_, rel=0.2)


def test_what_is_lost_is_not_scored():
    """Rows that were put back are not there for the error, whatever stood in them."""
    X, y, kept = recording(n=1000, n_lost=10)
    found = FirstOrderLag().fit(X[kept], y[kept])
    residual = y[kept] - found.predict(X[kept])
    assert found.fit_error_ == pytest.approx(np.sqrt(np.mean(residual**2)), rel=1e-9)


def test_a_record_in_motion_goes_on_through_lost_rows():
    X, y, kept = recording(n=2000, n_lost=20)
    found = FirstOrderLag(initial_state="estimate").fit(X, y)
    late, known = X[1000:][kept[1000:]], y[1000:][kept[1000:]].copy()
    known.iloc[300:] = np.nan
    expected = found.predict(X[1000:], y[1000:].where(np.arange(1000) < 300, np.nan))
    own = found.predict(late, known)
    assert own.shape == (len(late),)
    assert np.abs(own - expected[kept[1000:]])[400:].max() < 0.05 * np.ptp(expected)


def test_what_an_autoregressive_model_predicts_goes_on_through_lost_rows():
    X, y, kept = recording(n=600, n_lost=5)
    found = NARXRegressor(input_lags=2, output_lags=2, dt=DT).fit(X, y)
    free = found.predict(X[kept])
    assert np.abs(free - found.predict(X)[kept]).max() < 0.05 * np.ptp(y)
    ahead = found.predict_one_step(X[kept], y[kept])
    assert np.abs(ahead - found.predict_one_step(X, y)[kept]).max() < 0.05 * np.ptp(y)


def test_a_search_claims_nothing_of_the_pieces():
    X, y, kept = recording(n=3000, n_lost=25)
    search = EffectSearchCV(model(), effects=["drift", "offset"], random_state=0)
    search.fit(X[kept], y[kept])
    assert search.effects_ == []
    assert len(search.records_) == 1
    assert search.error_after_ == pytest.approx(NOISE, rel=0.3)
    lost = search.data_quality_.query("fault == 'lost_rows'")
    assert lost["n_samples"].tolist() == [25]
    assert search.predict(X[kept]).shape == (2975,)
    assert search.held_out_error(X[kept], y[kept]) == pytest.approx(NOISE, rel=0.3)
    assert "lost\\_rows | 0 | 25 |" in search.report().to_markdown()


def test_data_quality_and_overview_tell_how_many():
    X, y, kept = recording(n=1000, n_lost=3, seed=1)
    rows = np.flatnonzero(np.diff(np.flatnonzero(kept)) > 1) + 1
    table = data_quality(X[kept], y[kept], record_slices(X[kept], bridge=True))
    assert table["fault"].tolist() == ["lost_rows"]
    assert table["n_samples"].tolist() == [3]
    assert table["rows"].tolist() == [tuple(rows)]
    table = X.assign(response=y)[kept].reset_index(names="t [s]")
    seen = inspect_recording(table, drive="drive", response="response", time="t [s]")
    assert "997 samples every 0.001 s, 1 s in all, 3 lost" in repr(seen)
    assert any("has lost 3 of 1000 rows" in fault for fault in seen.faults)


def test_records_beside_a_long_gap_are_told_apart():
    times = 0.1 * np.r_[0:50, 200:250]
    slices = record_slices(pd.DataFrame({"drive": times}, times), bridge=True)
    assert record_names(slices) == ["0 from 0 s", "0 from 20 s"]
    X, _ = stack_records([(np.zeros(5), np.zeros(5))] * 2, labels=["a", "b"], dt=0.1)
    assert record_names(record_slices(X)) == ["a", "b"]


def test_folds_and_scores_see_one_record():
    X, y, kept = recording(n=500, n_lost=5)
    X, y = X[kept], y[kept]
    with pytest.raises(ValueError, match="1 record"):
        next(RecordKFold(2).split(X))
    tests = [test for _, test in BlockedTimeSeriesSplit(3, washout=10).split(X, y)]
    np.testing.assert_array_equal(np.concatenate(tests), np.arange(495))
    found = FirstOrderLag().fit(X, y)
    late = record_slices(X, bridge=True)[0].samples >= 20
    expected = -nrmse(y[late], found.predict(X)[late])
    assert washout_scorer(nrmse, washout=20)(found, X, y) == pytest.approx(expected)


def test_a_search_takes_what_follows_a_gap_for_no_drift():
    t = DT * np.arange(700)
    u = np.sin(2.0 * np.pi * t / (120 * DT)) * np.linspace(2.0, 1.0, len(t))
    y = FirstOrderLagOperator(60 * DT).run(u, DT)[0]
    y += 1e-3 * np.random.default_rng(0).normal(size=len(t))
    kept = (np.arange(len(t)) < 300) | (np.arange(len(t)) >= 400)
    X = pd.DataFrame({"drive": u}, pd.Index(t, name="time"))[kept]
    search = EffectSearchCV(FirstOrderLag(), effects=["drift"], cv=3, random_state=0)
    search.fit(X, y[kept])
    assert search.effects_ == ["initial_state"]
    found = search.best_estimator_.params_["time_constant"]
    assert found == pytest.approx(60 * DT, rel=0.01)
