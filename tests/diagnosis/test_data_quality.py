"""Faults of a measurement are found, and physics is not taken for one."""

import numpy as np
import pandas as pd
import pytest
from plants import MATRIX, make_recording

from skhyst.diagnosis import EffectSearchCV, data_quality
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.records import record_slices, stack_records

N = 4000


@pytest.fixture
def signals():
    rng = np.random.default_rng(4)
    time = np.linspace(0.0, 40.0, N)
    drive = np.sin(time) * np.linspace(0.2, 1.0, N)
    return drive, 3.0 * drive + 0.01 * rng.normal(size=N)


def faults(drive, y):
    X = drive[:, None]
    return data_quality(X, y, record_slices(X))


def test_clean_and_coarse_signals_have_none(signals):
    drive, y = signals
    assert faults(drive, y).empty
    assert faults(drive, np.round(y, 1)).empty


def test_outliers_by_row(signals):
    drive, y = signals
    y[[77, 1200, 2903]] += [0.5, -0.7, 4.0]
    found = faults(drive, y)[["fault", "rows"]]
    assert found.to_numpy().tolist() == [["outlier", (77, 1200, 2903)]]


def test_lost_readings_by_their_code(signals):
    drive, y = signals
    lost = np.r_[500, 900:904, 3300]
    y[lost] = -99.0
    found = faults(drive, y)[["fault", "value", "n_samples"]]
    assert found.to_numpy().tolist() == [["lost_reading", -99.0, len(lost)]]


def test_stuck_sensor(signals):
    drive, y = signals
    y[1010:1075] = y[1010]
    table = faults(drive, y)
    assert table[["fault", "n_samples"]].to_numpy().tolist() == [["stuck_sensor", 65]]
    rest = drive.copy()
    rest[1005:1080] = rest[1005]
    assert faults(rest, y).empty


def test_clipping_at_the_converter_is_not_that_of_the_device(signals):
    drive, y = signals
    noise = y - 3.0 * drive
    assert faults(drive, np.minimum(3.0 * drive, 2.0) + noise).empty
    table = faults(drive, np.minimum(y, 2.0))
    assert table[["fault", "value"]].to_numpy().tolist() == [["clipped_range", 2.0]]


@pytest.mark.parametrize("period", [97.3, 250.0, 1000.0])
@pytest.mark.parametrize("levels", [50, 400])
def test_the_top_of_a_wave_in_steps_of_the_converter_is_not_clipped(period, levels):
    drive = np.sin(2 * np.pi * np.arange(4000) / period)
    noise = 0.5 / levels * np.random.default_rng(0).normal(size=4000)
    y = np.round((drive + noise) * levels) / levels
    assert "clipped_range" not in set(faults(drive, y)["fault"])
    clipped = faults(drive, np.minimum(y, np.round(0.9 * levels) / levels))
    assert "clipped_range" in set(clipped["fault"])


def test_a_rest_below_a_step_of_the_converter_is_no_stuck_sensor(signals):
    """A device that sticks rests while the drive moves; readings in between tell it from noise."""
    drive, _ = signals
    device = np.where(np.arange(N) < N // 2, 1.3 * drive, 1.3 * drive[N // 2])
    steps = np.round(300 * device) / 300
    assert "stuck_sensor" not in set(faults(drive, steps)["fault"])


def test_a_counter_that_overflows():
    time = np.arange(3000) / 300.0
    drive = np.sin(time) + 0.5 * np.sin(2.7 * time)
    way = 3.0 * drive + 0.001 * np.random.default_rng(3).normal(size=3000)
    turn = 0.7 * np.ptp(way)
    found = faults(drive, np.mod(way - way.min(), turn))
    (row,) = found[found["fault"] == "wrapped_reading"].itertuples()
    assert row.value == pytest.approx(turn, rel=0.05)
    assert "wrapped_reading" not in set(faults(drive, way)["fault"])
    # a device that the drive lets jump
    jumps = np.sign(np.sin(np.arange(3000) / 200.0))
    assert "wrapped_reading" not in set(faults(jumps, jumps + 0.01 * way)["fault"])


@pytest.mark.parametrize("scale", [1e-9, 1e9])
def test_units_do_not_matter(signals, scale):
    drive, y = signals
    y[77] += 0.5
    y[1010:1075] = y[1010]
    names = ["fault", "n_samples", "rows"]
    pd.testing.assert_frame_equal(faults(drive, y)[names], faults(drive / scale, scale * y)[names])


def test_clock_jitter():
    rng = np.random.default_rng(0)
    time = 0.01 * (np.arange(500) + 0.08 * rng.normal(size=500).clip(-1.2, 1.2))
    X = pd.DataFrame({"drive": np.sin(time)}, index=pd.Index(time, name="time"))
    table = data_quality(X, np.sin(time), record_slices(X))
    assert table["fault"].tolist() == ["clock_jitter"]
    assert table["value"].iloc[0] == pytest.approx(np.diff(time).std() / 0.01, rel=0.01)


@pytest.mark.parametrize("effect", [*MATRIX["cascade"], "none"])
def test_physics_is_no_fault(effect):
    recording = make_recording(effect, "cascade", 7, n_samples=4000, noise=0.0005, substeps=4)
    X, y = recording.X_train, recording.y_train
    assert data_quality(X, y, record_slices(X)).empty


def test_a_pulse_of_the_drive_explains_a_pulse_of_the_response(signals):
    drive, y = signals
    y[300] += 2.0 * np.ptp(y)
    assert faults(drive, y)["rows"].tolist() == [(300,)]
    drive[300] += 2.0 * np.ptp(drive)
    assert faults(drive, y).empty


def test_record_and_rows_of_several_records(signals):
    drive, y = signals
    spiked = y.copy()
    spiked[10] += 3.0
    X, both = stack_records([(drive, y), (drive, spiked)], dt=0.1, labels=["a", "b"])
    table = data_quality(X, both, record_slices(X))
    assert table["record"].tolist() == ["b"]
    assert table["rows"].tolist() == [(N + 10,)]


def test_search_reports_faults(signals):
    drive, y = signals
    y[77] += 0.5
    search = EffectSearchCV(PrandtlIshlinskii(3), effects=["offset"]).fit(drive[:, None], y)
    assert search.data_quality_["fault"].tolist() == ["outlier"]
    report = search.report()
    assert report.to_dict()["data"]["faults"][0]["rows"] == [77]
    assert "outlier" in report.to_html()
    assert "| outlier |" in report.to_markdown()
