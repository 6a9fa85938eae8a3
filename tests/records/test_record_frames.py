"""Stacking, iterating and resampling."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skhyst.exceptions import RecordError
from skhyst.records import (
    iter_records,
    record_slices,
    resample_like,
    resample_records,
    resampling_error,
    stack_records,
)


def sine(frequency, dt, n, dates=False):
    times = np.arange(n) * dt
    index = pd.Timestamp("2024-05-01") + pd.to_timedelta(times, unit="s") if dates else times
    return pd.DataFrame({"drive": np.sin(2 * np.pi * frequency * times)}, index=pd.Index(index))


@settings(deadline=None, max_examples=40)
@given(
    st.lists(st.integers(2, 30), min_size=1, max_size=6),
    st.integers(1, 3),
    st.sampled_from([None, 1e-6, 0.01, 5.0]),
)
def test_iterating_undoes_stacking(sizes, n_inputs, dt):
    rng = np.random.default_rng(0)
    records = [(rng.standard_normal((n, n_inputs)), rng.standard_normal(n)) for n in sizes]
    X, y = stack_records(records, dt=dt)
    assert X.index.equals(y.index)
    assert list(X.index.names) == ["record", "time"]
    assert list(X.columns) == ["drive", "auxiliary1", "auxiliary2"][:n_inputs]
    back = list(iter_records(X, y))
    assert [label for label, _, _ in back] == list(range(len(sizes)))
    for (x, response), (_, x_part, y_part) in zip(records, back, strict=True):
        np.testing.assert_array_equal(x_part, x)
        np.testing.assert_array_equal(y_part, response)
    assert record_slices(X)[0].dt == pytest.approx(1.0 if dt is None else dt)


def test_without_dt_the_time_level_counts_and_the_model_says_how_long():
    X = stack_records([np.zeros(3), np.zeros(4)])
    assert X.index.levels[1].dtype.kind == "i"
    assert {r.dt for r in record_slices(X, dt=0.002)} == {0.002}


def test_labels_come_from_the_user_a_dict_or_the_records():
    u = np.zeros(3)
    by_list = stack_records([u, u], labels=["a", "b"], dt=0.1)
    by_dict = stack_records({"a": u, "b": u}, dt=0.1)
    pd.testing.assert_frame_equal(by_list, by_dict)
    again = stack_records([by_list, stack_records({"c": u}, dt=0.1)])
    assert [label for label, _, _ in iter_records(again)] == ["a", "b", "c"]


def test_times_and_columns_of_frames_are_kept():
    parts = [sine(1.0, 0.1, 20, dates=True).assign(load=2.0) for _ in range(2)]
    X, y = stack_records([(part, part["load"]) for part in parts])
    assert list(X.columns) == ["drive", "load"]
    assert y.name == "load"
    pd.testing.assert_index_equal(
        X.loc[1].index, pd.DatetimeIndex(parts[1].index), check_names=False, exact="equiv"
    )
    assert parts[0].index.name is None


LINE = sine(1, 0.1, 4)


@pytest.mark.parametrize(
    ("records", "options", "message"),
    [
        ([], {}, "at least one record"),
        ([np.zeros(3)] * 2, {"labels": ["a"]}, "one label per record, 2 in all. Got 1"),
        ([np.zeros(3)] * 2, {"labels": ["a", "a"]}, "must differ"),
        ([np.zeros(3), (np.zeros(3), np.zeros(3))], {}, "mixture"),
        ([(np.zeros(3),)], {}, "mixture"),
        ([[np.zeros(3), np.zeros(3)]], {}, r"pairs as tuples \(X, y\)"),
        ([[np.zeros((3, 2)), np.zeros(3)]], {}, r"pairs as tuples \(X, y\)"),
        ([(np.zeros(3), np.zeros(4))], {}, "equally many rows. Got 3 and 4"),
        ([(np.zeros(3), np.zeros((3, 2)))], {}, "one dimension"),
        ([np.zeros((3, 2, 2))], {}, "one or two dimensions"),
        ([np.zeros((3, 1)), np.zeros((3, 2))], {}, "same columns"),
        ([sine(1, 0.1, 4), sine(1, 0.1, 4, dates=True)], {}, "same type of times"),
        ([np.zeros(3)], {"dt": 0.0}, "'dt' parameter of stack_records"),
        ([stack_records([np.zeros(3)] * 2)], {"labels": ["a"]}, "left out for frames that hold"),
        ([stack_records([np.zeros(3)])] * 2, {}, "give the 'labels' parameter"),
        ([LINE.rename_axis("time_ms")], {}, "must be in seconds. Got the name 'time_ms'"),
        ([LINE], {"dt": 0.2}, "must not contradict the times of the records. Got 0.2, and"),
        *(
            ([(LINE, y)], {}, "The index of X and that of y must be equal")
            for y in (LINE["drive"][::-1], LINE["drive"].set_axis(2.0 * LINE.index))
        ),
        ([(np.zeros(4), LINE["drive"])], {}, "The index of X must carry the records and times"),
    ],
)
def test_records_that_do_not_stack(records, options, message):
    with pytest.raises(RecordError, match=message.replace(".", r"\.")):
        stack_records(records, **options)


def test_a_series_is_a_drive():
    drive = pd.Series([1.0, 2.0, 4.0], index=[0.0, 0.1, 0.2], name="V")
    for X in (stack_records([drive]), resample_records(drive, dt=0.1)):
        assert (list(X.columns), X["V"].tolist()) == (["V"], drive.tolist())
    assert stack_records([drive.rename(None)]).columns.tolist() == ["drive"]
    pd.testing.assert_frame_equal(stack_records([drive], dt=0.1), stack_records([drive]))


def test_iterating_over_arrays_and_without_a_response():
    ((label, x, y),) = iter_records([[0.0], [1.0]], [2.0, 3.0])
    assert (label, x.tolist(), y.tolist()) == (0, [[0.0], [1.0]], [2.0, 3.0])
    assert next(iter_records(np.zeros((3, 1))))[2] is None
    with pytest.raises(RecordError, match="equally many rows"):
        list(iter_records(np.zeros((3, 1)), np.zeros(4)))


def test_iterating_splits_at_holes():
    X = stack_records([np.arange(9.0)], dt=0.1).drop([(0, 0.30000000000000004), (0, 0.4)])
    assert [part["drive"].tolist() for _, part, _ in iter_records(X)] == [[0, 1, 2], [5, 6, 7, 8]]


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.floats(0.02, 0.5))
def test_straight_lines_survive_resampling(seed, dt):
    times = np.cumsum(np.random.default_rng(seed).uniform(0.5, 1.5, 100)) * 0.1
    X = pd.DataFrame({"drive": 3.0 * times - 1.0}, index=times)
    y = pd.Series(-2.0 * times, index=times, name="um")
    X_new, y_new = resample_records(X, y, dt=dt, anti_alias=False)
    new = X_new.index.get_level_values("time").to_numpy()
    np.testing.assert_allclose(X_new["drive"], 3.0 * new - 1.0, atol=1e-9)
    np.testing.assert_allclose(y_new, -2.0 * new, atol=1e-9)
    assert record_slices(X_new, y_new)[0].dt == pytest.approx(dt)
    assert times[-1] - dt < new[-1] <= times[-1] + 1e-6 * dt
    assert y_new.name == "um"


def test_data_in_samples_are_not_resampled_at_seconds():
    line = np.arange(9.0)
    for counted in (line, pd.DataFrame({"drive": line}), stack_records([line])):
        for dt in (0.5, 2.0):
            with pytest.raises(RecordError, match=r"integers, which count samples.*stack_records"):
                resample_records(counted, line, dt=dt)
        same = resample_records(counted, line, dt="auto")
        np.testing.assert_array_equal(np.column_stack(same), np.c_[line, line])
    X, y = resample_records(*stack_records([(line, line)], dt=1.0), dt=0.5)
    np.testing.assert_allclose(np.column_stack([X, y]), np.repeat(0.5 * np.c_[:17], 2, axis=1))


@pytest.mark.parametrize("ratio", [2, 5, 10, 2.5])
def test_a_coarser_grid_keeps_what_is_slow_and_removes_what_would_fold(ratio):
    dt, new = 1e-3, 1e-3 * ratio
    nyquist = 0.5 / new
    slow, fast = (sine(part * nyquist, dt, 20_000) for part in (0.1, 1.7))
    kept = resample_records(slow, dt=new)["drive"]
    exact = np.sin(2 * np.pi * 0.1 * nyquist * kept.index.get_level_values("time"))
    inner = slice(100, -100)
    assert np.abs(kept - exact)[inner].max() < 0.02
    assert resample_records(fast, dt=new)["drive"].abs()[inner].max() < 0.03
    assert resample_records(fast, dt=new, anti_alias=False)["drive"].abs()[inner].max() > 0.3


def test_drive_and_response_get_the_same_filter_of_unit_gain():
    X = sine(3.0, 0.001, 3000).assign(constant=7.0)
    X_new, y_new = resample_records(X, 5.0 * X["drive"], dt=0.02)
    np.testing.assert_allclose(y_new, 5.0 * X_new["drive"], atol=1e-9)
    np.testing.assert_allclose(X_new["constant"], 7.0, rtol=1e-9)


def test_different_intervals_become_one():
    X = pd.concat({"slow": sine(0.5, 0.1, 50), "fast": sine(0.5, 0.03, 400)})
    X.index.names = ["record", "time"]
    with pytest.raises(RecordError):
        record_slices(X)
    found = record_slices(resample_records(X, dt=0.05))
    assert [r.label for r in found] == ["slow", "fast"]
    assert found[0].dt == 0.05


def test_long_gaps_are_kept_and_short_ones_filled():
    times = np.r_[0:50, 53:100, 200:250] * 0.01
    X = pd.DataFrame({"drive": times}, index=times)
    assert [r.n_samples for r in record_slices(resample_records(X, dt=0.01))] == [100, 50]
    tight = resample_records(X, dt=0.01, max_gap=0.02)
    assert [r.n_samples for r in record_slices(tight)] == [50, 47, 50]
    wide = resample_records(X, dt=0.01, max_gap=10.0)
    np.testing.assert_allclose(wide["drive"], np.arange(250) * 0.01, atol=1e-9)


@pytest.mark.parametrize(
    "times",
    [
        np.arange(200) * 0.01,
        pd.date_range("2024-05-01", periods=200, freq="10ms"),
        pd.date_range("2024-05-01", periods=200, freq="10ms", tz="Europe/Berlin"),
        pd.timedelta_range("1s", periods=200, freq="10ms"),
    ],
    ids=["seconds", "dates", "zone", "durations"],
)
def test_type_of_time_is_kept(times):
    X = sine(1.0, 0.01, 200).set_axis(times)
    same = resample_records(X, dt=0.01)  # the same grid changes nothing
    np.testing.assert_allclose(same["drive"], X["drive"], atol=1e-9)
    new = resample_records(X, dt=0.03).index.get_level_values("time")
    assert new.dtype.kind == X.index.dtype.kind
    assert new[0] == X.index[0]
    assert str(getattr(new, "tz", None)) == str(getattr(X.index, "tz", None))


def test_what_cannot_be_resampled_is_refused():
    X = sine(1.0, 0.01, 50)
    for bad in (np.nan, np.inf):
        y = np.where(np.isin(np.arange(50), [4, 9]), bad, 1.0)
        with pytest.raises(RecordError, match=r"2 row\(s\) \(4, 9\) with NaN or infinite"):
            resample_records(X, y, dt=0.02)
    with pytest.raises(RecordError, match="length of every record"):
        resample_records(X, dt=1.0)
    with pytest.raises(RecordError, match="not in the order of time"):
        resample_records(X.sample(frac=1.0, random_state=0), dt=0.02)
    with pytest.raises(RecordError, match="at least two samples"):
        resample_records(X.iloc[:1], dt=0.02)
    with pytest.raises(RecordError, match="equally many rows"):
        resample_records(X, np.zeros(49), dt=0.02)
    for options in ({"dt": 0.0}, {"dt": np.nan}, {"dt": "1"}, {"dt": 0.1, "max_gap": -1.0}):
        with pytest.raises(RecordError, match="parameter of resample_records must be"):
            resample_records(X, **options)


def test_inputs_are_not_changed():
    X = sine(1.0, 0.01, 50)
    y = X["drive"] * 2
    before = X.copy(), y.copy()
    stack_records([(X, y)])
    resample_records(X, y, dt=0.03)
    pd.testing.assert_frame_equal(X, before[0])
    pd.testing.assert_series_equal(y, before[1])


SIGNALS = {
    "sine": lambda t: np.sin(40.0 * t),
    "three sines": lambda t: np.sin(19.0 * t) + 0.3 * np.sin(57.0 * t + 1.0) + 0.1 * np.sin(99 * t),
    "sweep": lambda t: np.sin(3.0 * t + 1.5 * t**2),
    "triangle": lambda t: np.arcsin(np.sin(19.0 * t)),
    "clipped": lambda t: np.clip(np.sin(19.0 * t), -0.6, 0.6),
}
SPACINGS = {
    "uniform": lambda rng: rng.uniform(0.5, 1.5, 2000),
    "random": lambda rng: 0.05 + rng.exponential(1.0, 2000),
    "lost": lambda rng: rng.geometric(0.6, 2000) * 0.6,
}


@pytest.mark.parametrize("noise", [0.0, 0.05])
@pytest.mark.parametrize("spacing", SPACINGS)
@pytest.mark.parametrize("signal", SIGNALS)
def test_the_error_of_a_grid_is_told_within_a_factor_of_two(signal, spacing, noise):
    rng = np.random.default_rng(7)
    times, exact = 0.01 * np.cumsum(SPACINGS[spacing](rng)), SIGNALS[signal]
    X, clean = pd.DataFrame({"drive": times}, times), exact(times)
    new = resample_records(X, clean, dt="auto")[1]
    true = np.sqrt(np.mean((new - exact(new.index.get_level_values("time").to_numpy())) ** 2))
    told = resampling_error(X, clean + noise * rng.normal(size=len(times)))
    assert 0.5 < told / true < 2.0
    assert resampling_error(X, 7.0 * clean) == pytest.approx(7.0 * resampling_error(X, clean))


def test_what_is_straight_or_even_costs_nothing():
    times = np.cumsum(np.random.default_rng(0).uniform(0.5, 1.5, 300))
    X = pd.DataFrame({"drive": times}, times)
    assert resampling_error(X, 3.0 * times - 1.0) == pytest.approx(0.0, abs=1e-9)
    even = sine(1.0, 0.01, 500)
    assert resampling_error(even, even["drive"] ** 2) == 0.0
    assert resampling_error(even, even["drive"] ** 2, dt=0.005) > 0.0
    assert resample_records(even, dt="auto") is even


def test_intervals_of_records_that_are_sampled_alike_are_one():
    rng = np.random.default_rng(0)
    sizes = {"a": 0.01, "b": 0.0101, "c": 0.043, "d": 0.0099}
    parts = {}
    for name, dt in sizes.items():
        times = dt * np.cumsum(rng.uniform(0.7, 1.3, 400))
        parts[name] = pd.DataFrame({"drive": np.sin(times)}, times)
    X = pd.concat(parts, names=["record", "time"])
    medians = {name: np.median(np.diff(part.index)) for name, part in parts.items()}
    records = record_slices(resample_records(X, dt="auto"), one_interval=False)
    found = {record.label: record.dt for record in records}
    least = min(medians.values())
    assert found["a"] == found["b"] == found["d"] == pytest.approx(least)
    assert found["c"] == pytest.approx(4.0 * least)
    assert all(found[name] <= 1.0001 * medians[name] for name in sizes)


def test_a_grid_is_read_at_the_instants_of_the_readings():
    rng = np.random.default_rng(0)
    times = [np.cumsum(rng.uniform(0.5, 1.5, 50)) for _ in range(2)]
    X = stack_records([pd.DataFrame({"drive": 2.0 * t + 1.0}, t) for t in times])
    grid = resample_records(X, dt="auto")["drive"]
    read = resample_like(grid, X)
    inner = read[read < grid.max()]
    assert len(read) == len(X)
    assert len(inner) > 95
    np.testing.assert_allclose(read[:49], X["drive"][:49], atol=1e-9)


def test_integers_that_count_have_no_interval_to_find():
    X = pd.DataFrame({"drive": np.arange(5.0)}, index=[0, 1, 3, 4, 8])
    with pytest.raises(RecordError, match="integers, which count samples"):
        resample_records(X, dt="auto")
