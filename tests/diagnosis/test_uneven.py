"""Records that are sampled unevenly, in a search that brings them to even grids."""

from functools import cache

import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone

from skhyst.diagnosis import EffectSearchCV
from skhyst.exceptions import RecordError
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.records import resample_like, resample_records, stack_records

FINE, DT, TAU, NOISE = 2e-4, 0.004, 0.05, 4e-3
THRESHOLDS = [0.0, 0.4]


@cache
def recording(uneven, seed=0, n_records=3):
    """Integrate two plays and a lag on a fine grid, and read them evenly or at random times."""
    rng, pairs = np.random.default_rng(seed), []
    for _ in range(n_records):
        time = FINE * np.arange(round(1000 * DT / FINE))
        u = sum(np.sin(rng.uniform(2, 20) * time + rng.uniform(0, 6)) for _ in range(4))
        u = u * np.minimum(2.0 * time, 1.0)
        z, x, y = 0.0, 0.0, np.empty_like(u)
        for k, value in enumerate(u.tolist()):
            z = min(max(z, value - THRESHOLDS[1]), value + THRESHOLDS[1])
            x += (0.6 * value + 0.4 * z - x) * FINE / TAU
            y[k] = x
        steps = rng.uniform(0.3, 1.7, 1000) if uneven else np.ones(1000)
        rows = np.r_[0, np.cumsum(np.round(steps * DT / FINE).astype(int))]
        rows = rows[rows < len(time)]
        read = y[rows] + NOISE * rng.normal(size=len(rows))
        index = pd.Index(time[rows], name="time")
        pairs.append(
            (pd.DataFrame({"drive": u[rows]}, index), pd.Series(read, index, name="x (um)"))
        )
    return stack_records(pairs)


def search(**options):
    effects = ["lag", "delay", "resonance", "offset"]
    options = {"effects": effects, "cv": 2, "random_state": 0} | options
    return EffectSearchCV(PrandtlIshlinskii(thresholds=THRESHOLDS), **options)


@pytest.fixture(scope="module")
def uneven():
    return search(resample="auto").fit(*recording(True))


@pytest.mark.slow
def test_an_uneven_recording_gives_the_name_and_the_number_of_the_device(uneven):
    assert uneven.effects_ == ["lag"]
    value, std, _ = uneven.evidence_["lag"].numbers["time constant"]
    assert abs(value - TAU) < np.nanmax([4.0 * std, 0.02 * TAU])
    assert uneven.error_after_ < 1.2 * NOISE


@pytest.mark.slow
def test_even_records_are_left_as_they_are():
    X, y = recording(False)
    even = search(resample="auto", effects=["offset"]).fit(X, y)
    plain = search(effects=["offset"]).fit(X, y)
    np.testing.assert_array_equal(even.residual_after_, plain.residual_after_)
    assert "interpolated" not in plain.report().to_markdown()
    arrays = search(resample="auto", effects=["offset"]).fit(X.to_numpy(), y.to_numpy())
    assert arrays.resampling_error_ == 0.0


def test_what_is_told_refers_to_the_grid_and_predictions_to_the_readings(uneven):
    X, y = recording(True)
    grid, response = resample_records(X, y, dt="auto")
    np.testing.assert_array_equal(uneven.drive_, grid["drive"])
    np.testing.assert_array_equal(uneven.response_, response)
    assert len(uneven.residual_after_) == len(grid)
    assert len({record.dt for record in uneven.records_}) == 1
    predicted = uneven.predict(X)
    assert predicted.shape == y.shape
    # of what rests after each reading, the response is as far as noise goes
    assert np.sqrt(np.mean((predicted - y.to_numpy()) ** 2)) < 1.2 * NOISE
    even = uneven.best_estimator_.predict(grid)
    np.testing.assert_array_equal(predicted, resample_like(pd.Series(even, grid.index), X))
    assert uneven.held_out_error(*recording(True, seed=1)) < 1.3 * NOISE


def test_the_error_of_the_grid_is_told(uneven):
    fine = recording(False)[1]
    assert 0.0 < uneven.resampling_error_ < np.ptp(fine) / 100.0
    report = uneven.report()
    assert report.to_dict()["data"]["resampling_error"] == uneven.resampling_error_
    assert "interpolated between them, which changes the response by about" in report.to_markdown()


def test_without_the_option_they_are_refused_with_its_name():
    with pytest.raises(RecordError, match="resample='auto'"):
        search().fit(*recording(True))
    with pytest.raises(ValueError, match="'resample' parameter of EffectSearchCV"):
        search(resample="yes").fit(*recording(True))


def test_what_is_no_uneven_sampling_is_still_refused():
    X, y = recording(True, n_records=1)
    with pytest.raises(RecordError, match="index of X and that of y must be equal"):
        search(resample="auto").fit(X, y[::-1])
    order = np.random.default_rng(0).permutation(len(X))
    with pytest.raises(RecordError, match="not in the order of time"):
        search(resample="auto").fit(X.iloc[order], y.iloc[order])
    counted = X.set_axis(np.cumsum(np.random.default_rng(0).integers(1, 4, len(X))))
    with pytest.raises(RecordError, match="integers, which count samples"):
        search(resample="auto").fit(counted, y.to_numpy())
    assert clone(search(resample="auto")).resample == "auto"
