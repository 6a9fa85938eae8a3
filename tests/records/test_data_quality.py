"""Faults of a measurement are found, and physics is not taken for one."""

import numpy as np
import pandas as pd
import pytest
from plants import MATRIX, make_recording

from skhyst.datasets.simulation import first_order, plays
from skhyst.diagnosis import EffectSearchCV
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.records import RecordSlice, data_quality, record_slices, stack_records
from skhyst.records._data_quality import _clipped, _jitter, _noisy, _runs, _spikes, _stuck, _wrapped

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
    # with play, it begins to move after the drive
    drive, way = np.r_[np.zeros(200), np.sin(0.12 * np.arange(1500))], np.zeros(1700)
    for k in range(1, 1700):
        way[k] = np.clip(way[k - 1], drive[k] - 0.2, drive[k] + 0.2)
    way += 0.0003 * np.random.default_rng(0).normal(size=1700)
    assert faults(drive, np.round(600 * way) / 600).empty


@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_a_counter_that_overflows(unit):
    time = np.arange(3000) / 300.0
    drive = np.sin(time) + 0.5 * np.sin(2.7 * time)
    way = 3.0 * drive + 0.001 * np.random.default_rng(3).normal(size=3000)
    turn = 0.7 * np.ptp(way)
    found = faults(unit * drive, np.mod(way - way.min(), turn))
    (row,) = found[found["fault"] == "wrapped_reading"].itertuples()
    assert row.value == pytest.approx(turn, rel=0.05)
    assert "wrapped_reading" not in set(faults(drive, way)["fault"])
    # a device that the drive lets jump
    jumps = np.sign(np.sin(np.arange(3000) / 200.0))
    assert "wrapped_reading" not in set(faults(jumps, jumps + 0.01 * way)["fault"])
    # one that switches between two states, at rest in each or not
    noise = way - 3.0 * drive
    for slope in (0.0, 0.5):
        assert faults(drive, 5.0 * (drive > 0.0) + slope * drive + noise).empty


@pytest.mark.parametrize("scale", [1e-9, 1e9])
def test_units_do_not_matter(signals, scale):
    drive, y = signals
    y[77] += 0.5
    y[1010:1075] = y[1010]
    names = ["fault", "n_samples", "rows"]
    pd.testing.assert_frame_equal(faults(drive, y)[names], faults(drive / scale, scale * y)[names])


def test_clock_jitter():
    rng = np.random.default_rng(0)
    jittered = 0.01 * (np.arange(500) + 0.08 * rng.normal(size=500).clip(-1.2, 1.2))
    time = np.concatenate([0.01 * np.arange(400), jittered])  # the second record starts at row 400
    X = pd.DataFrame({"drive": np.sin(time)}, index=pd.Index(time, name="time"))
    table = data_quality(X, 2.0 * np.sin(time), record_slices(X))
    assert table[["fault", "rows"]].to_numpy().tolist() == [
        ["clock_jitter", tuple(range(400, 405))]
    ]
    assert table["value"].iloc[0] == pytest.approx(np.diff(jittered).std() / 0.01, rel=0.01)


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


SCALES = [(1.0, 1.0), (1e-9, -1e9), (-1e9, 1e-9)]


def kinds(drive, y):
    return set(faults(drive, y)["fault"])


def in_units(drive, y, scales):
    """Return both channels in other units, with another zero."""
    return scales[0] * (drive - 0.3), scales[1] * (y + 0.2)


@pytest.fixture
def lagging():
    """A smooth drive, and a response that follows it through plays and a lag."""
    angles = np.arange(N) / np.array([[60.0], [25.0], [14.0]])
    drive = np.array([1.0, 0.6, 0.4]) @ np.sin(angles + [[1.0], [0.0], [2.0]])
    y = first_order(plays(drive, 1.0, [0.0, 0.2, 0.6], [1.0, 0.5, 0.5]), 1.0, 3.0)
    return drive, y + 0.004 * np.random.default_rng(2).normal(size=N)


@pytest.mark.parametrize("scales", SCALES)
@pytest.mark.parametrize("number", [1, 2, 5])
def test_lost_samples_by_row_and_number(signals, scales, number):
    drive, y = signals[0], 3.0 * signals[0] + 0.001 * np.random.default_rng(1).normal(size=N)
    kept = np.delete(np.arange(N), [3040 + np.arange(number), 3355 + np.arange(number)])
    assert faults(*in_units(drive, y, scales)).empty
    found = faults(*in_units(drive[kept], y[kept], scales))[["fault", "rows", "value"]]
    rows = (3040, 3355 - number)
    assert found.to_numpy().tolist() == [["lost_samples", rows, number]]
    # a drive that jumps ahead alone has lost nothing
    assert "lost_samples" not in kinds(drive[kept], y[: len(kept)])


@pytest.mark.parametrize("scales", SCALES)
def test_exchanged_channels(lagging, scales):
    drive, y = in_units(*lagging, scales)
    assert faults(drive, y).empty
    assert kinds(y, drive) == {"swapped_channels"}


@pytest.mark.parametrize("scales", SCALES)
def test_noise_on_the_recorded_drive(lagging, scales):
    drive, y = lagging
    noise = 0.05 * np.random.default_rng(5).normal(size=N)
    (row,) = faults(*in_units(drive + noise, y, scales)).itertuples()
    assert row.fault == "noisy_drive"
    assert row.value == pytest.approx(abs(scales[0]) * 0.05, rel=0.1)


ROUGH = {
    "white": lambda rng: rng.normal(size=N),
    "walk": lambda rng: np.cumsum(rng.normal(size=N)),
    "binary": lambda rng: np.repeat(rng.choice([-1.0, 1.0], N // 5), 5),
    "chirp": lambda rng: np.sin(np.pi * np.arange(N) ** 2 / (2.0 * N)),
    "steps": lambda rng: np.repeat(rng.normal(size=N // 100), 100),
    "dither": lambda rng: np.sin(np.arange(N) / 100.0) + 0.01 * rng.normal(size=N),
}


@pytest.mark.parametrize("name", ROUGH)
@pytest.mark.parametrize("lag", [0.0, 3.0, 30.0])
def test_a_rough_drive_is_none_of_these(name, lag):
    rng = np.random.default_rng(6)
    drive = ROUGH[name](rng)
    y = plays(drive, 1.0, [0.0, 0.1], [1.0, 0.5])
    y = first_order(y, 1.0, lag) if lag else y
    y = y + 0.002 * np.ptp(y) * rng.normal(size=N)
    assert not kinds(drive, y) & {"noisy_drive", "swapped_channels", "lost_samples"}


@pytest.mark.parametrize("feedback", [0.0, 0.3])
def test_a_search_tells_a_drive_that_reacts_to_the_noise(signals, feedback):
    noise = 0.02 * np.random.default_rng(8).normal(size=N)
    drive, y, heard = np.empty(N), np.empty(N), 0.0
    for t, reference in enumerate(signals[0]):
        drive[t] = reference - feedback * heard
        y[t] = 2.0 * drive[t] + noise[t]
        heard = y[t]
    search = EffectSearchCV(PrandtlIshlinskii(3), effects=["offset"]).fit(drive[:, None], y)
    assert search.verdict_ == "noise"
    assert ("closed_loop" in set(search.data_quality_["fault"])) == (feedback > 0.0)


@pytest.mark.slow
def test_search_reports_faults(signals):
    drive, y = (signal[:1000] for signal in signals)
    y[77] += 0.5
    search = EffectSearchCV(PrandtlIshlinskii(3), effects=["offset"]).fit(drive[:, None], y)
    assert search.data_quality_["fault"].tolist() == ["outlier"]
    report = search.report()
    (fault,) = report.to_dict()["data"]["faults"]
    assert fault["rows"] == [77]
    assert fault["value"] is None
    assert "outlier" in report.to_html()
    assert "| outlier |" in report.to_markdown()


def test_runs_at_the_top_of_a_wave_are_no_clipping():
    """Of n readings in the step below, n + 2 sqrt(n) are within chance, times 1 + sqrt(2)."""
    step, below = 0.1, 25
    usual = (1.0 + np.sqrt(2.0)) * (below + 2.0 * np.sqrt(below))

    def found(n_top):
        top, low = np.full(n_top, 1.0), np.linspace(-1.0, 0.0, 200)
        y = np.concatenate([low, np.full(below, 1.0 - step), top])
        starts, lengths = np.array([0, 200, 200 + below]), np.array([1, below, n_top])
        return [kind for kind, *_ in _clipped(y, starts, lengths, np.array([]), step)]

    assert found(int(usual)) == []
    assert found(int(usual) + 1) == ["clipped_range"]


@pytest.mark.parametrize("row", [1, 2, 50, 97, 98])
def test_a_spike_is_found_wherever_it_stands_between_readings(row):
    y = 1e-3 * np.random.default_rng(0).normal(size=100)
    y[row] = 2.0
    found = _spikes(np.zeros(100), y, np.arange(100), np.ones(100, dtype=int))
    assert row in np.concatenate([np.ravel(rows) for _, rows, *_ in found])


def test_two_intervals_have_a_jitter():
    X = pd.DataFrame({"u": np.zeros(3)}, pd.Index([0.0, 1.0, 3.0], name="time"))
    assert _jitter(X, RecordSlice("a", slice(0, 3), 1.0, 0.0, 3)) == pytest.approx(1.0 / 3.0)


@pytest.mark.parametrize(
    ("lengths", "noisy"), [([1, 1, 1, 4], True), ([1, 1, 4, 4], False), ([4, 4, 1], False)]
)
def test_readings_are_noisy_where_most_differ_from_the_one_before(lengths, noisy):
    assert _noisy(np.array(lengths)) == noisy


@pytest.mark.parametrize(
    ("y", "starts", "lengths"),
    [
        ([5.0, 5.0, 7.0], [0, 2], [2, 1]),
        ([1.0, 2.0, 2.0, 2.0], [0, 1], [1, 3]),
        ([3.0], [0], [1]),
    ],
)
def test_runs_begin_with_the_first_reading_and_end_with_the_last(y, starts, lengths):
    np.testing.assert_array_equal(np.stack(_runs(np.array(y))), [starts, lengths])


def test_clipping_at_the_start_of_a_record_is_clipping(signals):
    drive, y = signals
    y[:40] = 3.2
    table = faults(drive, y)
    assert table[["fault", "n_samples", "value"]].to_numpy().tolist() == [
        ["clipped_range", 40, 3.2]
    ]


@pytest.mark.parametrize(("part", "are_faults"), [(0.01, True), (0.018, True), (0.025, False)])
def test_more_than_one_in_fifty_belongs_to_the_signal(part, are_faults, signals):
    drive, y = signals
    rows = np.linspace(10, N - 10, int(part * N)).astype(int)
    y[rows] += np.linspace(5.0, 6.0, len(rows))
    table = faults(drive, y)
    assert table["fault"].tolist() == (["outlier"] if are_faults else [])
    assert table["n_samples"].tolist() == ([len(rows)] if are_faults else [])


def spikes(y, u=None):
    y = np.asarray(y, dtype=float)
    return list(_spikes(np.zeros(len(y)) if u is None else u, y, *_runs(y)))


@pytest.mark.parametrize(("height", "found"), [(0.9, 0), (1.1, 1)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_spike_is_higher_than_twelve_deviations(height, found, sign):
    """Of the distance from the mean of the neighbours, whatever the slope; one way only."""
    noise = np.random.default_rng(0).normal(size=2001)
    noise[1000] = 0.5 * (noise[999] + noise[1001])
    distance = noise[1:-1] - 0.5 * (noise[:-2] + noise[2:])
    deviation = np.median(np.abs(distance - np.median(distance))) / 0.67449
    y = noise + sign * np.where(np.arange(2001) == 1000, 12.0 * height * deviation, 0.0)
    off = abs(noise[999] - noise[1001])
    assert off < 0.5 * deviation  # else the height is that above the nearer neighbour
    assert len(spikes(y)) == found
    step = np.where(np.arange(2001) >= 1000, 500.0 * deviation, 0.0)
    assert spikes(noise + sign * step) == []


@pytest.mark.parametrize(("length", "found"), [(20, True), (21, False)])
def test_a_code_lasts_up_to_twenty_readings(length, found):
    y = np.sin(np.arange(3000))
    y[1500 : 1500 + length] = -9.0
    assert [kind for kind, *_ in spikes(y)] == (["lost_reading"] if found else [])


@pytest.mark.parametrize(("span", "found"), [(0.1, True), (0.9, True), (1.1, False)])
def test_a_spike_goes_where_it_came_from(span, found):
    """Between readings that differ by less than half of its height."""
    y = np.where(np.arange(400) < 200, 0.0, 0.5 * span) + 1e-9 * np.sin(np.arange(400) ** 2)
    y[200] = 1.0 + 0.5 * span  # one above the reading behind
    assert [rows.tolist() for _, rows, _ in spikes(y)] == ([[200]] if found else [])


@pytest.mark.parametrize(("moves", "found"), [(0.2, True), (0.4, False)])
def test_a_jump_there_and_back_of_the_drive_explains_a_spike(moves, found):
    """By a third of what it would take, relative to the ranges."""
    y, u = np.sin(np.arange(2000)), np.zeros(2000)
    y[1000] = 9.0
    u[0], u[1000] = 1.0, moves
    height = (9.0 - max(y[999], y[1001])) / np.ptp(y)
    assert len(spikes(y, u)) == (moves < 0.3 * height) == found


@pytest.mark.parametrize(("drive_moves", "stuck"), [(0.02, False), (0.04, True)])
@pytest.mark.parametrize(("length", "long"), [(9, False), (10, True)])
def test_a_sensor_is_stuck_where_the_drive_moves(drive_moves, stuck, length, long):
    """Over three per cent of its range, during ten readings or more, inside the range."""
    y, u = np.sin(np.arange(300.0)), np.zeros(300)
    u[0], u[299] = -0.5, 0.5
    rows = slice(100, 100 + length)
    y[rows], u[rows] = 0.3, np.linspace(0.0, drive_moves, length)
    found = list(_stuck(u, y, *_runs(y)))
    assert len(found) == (stuck and long)
    for kind, at, value in found:
        assert (kind, at.tolist(), value) == ("stuck_sensor", list(range(100, 110)), 0.3)
    y[rows] = y.max() + 1.0
    assert list(_stuck(u, y, *_runs(y))) == []


def test_a_counter_overflows_by_one_size_while_the_drive_goes_on():
    turns = np.linspace(0.0, 3.5, 700)
    y = 8.0 * (turns % 1.0)
    at = [200, 400, 600]
    (found,) = _wrapped(turns, y)
    assert (found[0], found[1].tolist()) == (
        "wrapped_reading",
        (1 + np.flatnonzero(np.diff(y) < 0)).tolist(),
    )
    np.testing.assert_allclose(found[1], at, atol=1)
    assert found[2] == pytest.approx(8.0, rel=0.01)
    jumping = turns + np.where(np.arange(700) >= found[1][0], 1.5, 0.0)  # 0.3 of its range
    assert list(_wrapped(jumping, y)) == []
    assert list(_wrapped(np.roll(y, -3), y)) == []  # a sawtooth, three samples late
    uneven = y - 2.0 * (turns > 2.0)  # its jumps are of several sizes
    assert list(_wrapped(turns, uneven)) == []
    assert list(_wrapped(turns, np.tile([0.0, 1.0], 350))) == []  # it does nothing but jump
    assert list(_wrapped(turns, np.tile([0.0, 1.0, 1.0], 234)[:700])) == []  # nor much else
    assert list(_wrapped(turns, np.sin(turns))) == []


def kinds_of(found):
    return [(kind, np.ravel(rows).tolist()) for kind, rows, *_ in found]


@pytest.mark.parametrize("n", [50, 200])
def test_a_code_comes_again_and_an_outlier_does_not(n):
    """A fiftieth of the readings at most are off; more belong to the signal."""
    y = 1e-3 * np.random.default_rng(0).normal(size=n)
    y[[7, 20]] = 4.0, -9.0
    found = kinds_of(_spikes(np.zeros(n), y, *_runs(y)))
    assert found == ([] if n == 50 else [("outlier", [7, 20])])
    y[20] = y[7]
    found = kinds_of(_spikes(np.zeros(n), y, *_runs(y)))
    assert found == ([] if n == 50 else [("lost_reading", [7, 20])])


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
def test_a_few_readings_have_no_fault(n):
    assert faults(np.arange(n) % 2.0, np.arange(n) ** 2.0 + 3.0).empty == (n > 1)
    assert set(faults(np.arange(n) + 1.0, np.zeros(n))["fault"]) <= {"constant_drive"}


@pytest.mark.parametrize(("levels", "wraps"), [(11, False), (12, True)])
def test_a_wrap_is_ten_times_as_large_as_what_moves_otherwise(levels, wraps):
    """A counter of so many levels goes back by one less; twice a step is a fifth of ten."""
    y = np.arange(10.0 * levels) % levels
    found = list(_wrapped(np.zeros(len(y)), y))
    assert len(found) == wraps
    for kind, rows, value in found:
        assert (kind, value) == ("wrapped_reading", levels - 1.0)
        assert rows.tolist() == list(range(levels, len(y), levels))
    for part, explains in ((0.1, False), (0.3, True)):  # of its range by which the drive jumps
        u = part * (y < 5.0)
        u[1] = 1.0
        assert (not list(_wrapped(u, y))) == (explains or not wraps)
        assert (not list(_wrapped(1e-9 * u, 1e9 * y))) == (explains or not wraps)


def test_a_sensor_is_stuck_between_the_ends_of_the_range():
    u = np.arange(100.0)
    for value, stuck in ((-1.0, False), (0.3, True), (2.0, False)):
        y = np.random.default_rng(0).uniform(-1.0, 2.0, size=100)
        y[[0, 99]], y[40:52] = (-1.0, 2.0), value
        rows = [("stuck_sensor", list(range(40, 52)))] if stuck else []
        assert kinds_of(_stuck(u, y, *_runs(y))) == rows
        assert kinds_of(_stuck(0.0 * u, y, *_runs(y))) == []  # the drive rests, too
        y[49:52] = 0.1, 0.2, 0.1
        assert kinds_of(_stuck(u, y, *_runs(y))) == []  # nine readings


@pytest.mark.parametrize(
    ("tops", "clipped"),
    [((3, 2), True), ((2, 2, 1), False), ((3, 1), False), ((5,), True), ((1,) * 20, False)],
)
@pytest.mark.parametrize("end", [1.0, -1.0])
def test_clipping_is_five_readings_of_which_three_in_a_row(tops, clipped, end):
    y = np.linspace(-0.7, 0.7, 200)
    for k, n in enumerate(tops):
        y = np.insert(y, 9 * k, np.full(n, end))
    y[-8:-2] = 0.123  # a run elsewhere is none
    found = kinds_of(_clipped(y, *_runs(y), [], 1e-3))
    assert found == ([("clipped_range", np.flatnonzero(y == end).tolist())] if clipped else [])
    assert kinds_of(_clipped(y, *_runs(y), [end], 1e-3)) == []  # it is the code of a lost reading


def test_one_interval_has_no_jitter():
    X = pd.DataFrame({"u": np.zeros(2)}, pd.Index([0.0, 1.0], name="time"))
    assert _jitter(X, RecordSlice("a", slice(0, 2), 1.0, 0.0, 2)) == 0.0


def test_a_column_that_is_the_drive_is_told_whichever_it_is(signals):
    drive, y = signals
    other = np.random.default_rng(0).normal(size=N)
    for columns, same in (((other,), False), ((other, drive), True), ((drive, other), True)):
        X = np.stack([drive, *columns], axis=1)
        assert (set(data_quality(X, y, record_slices(X))["fault"]) == {"same_signal"}) == same
    assert set(faults(drive, drive)["fault"]) == {"same_signal"}
    assert set(faults(np.ones(N), y)["fault"]) == {"constant_drive"}
