"""Where a residual stands is found, and white noise stands everywhere."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import search_steps
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from skhyst.diagnosis import EffectSearchCV
from skhyst.diagnosis._location import locate, out_of_line, strongest
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import Gain
from skhyst.records import RecordSlice, Units

N, DT = 4000, 0.001
TIME = DT * np.arange(N)
SLICES = [RecordSlice(k, slice(i * N, (i + 1) * N), DT, 0.0, N) for i, k in enumerate("ab")]
DRIVE = np.concatenate([a * np.sin(2 * np.pi * 3.0 * TIME) for a in (1.0, 2.0)])


def noise(seed=0):
    return 0.01 * np.random.default_rng(seed).normal(size=2 * N)


def strongest_by(residual, by):
    table = locate(SLICES, DRIVE, residual, Units())
    return table[table["by"] == by].iloc[0]


def test_white_noise_stands_everywhere():
    table = locate(SLICES, DRIVE, noise(), Units())
    wide = table[(table["by"] != "frequency") | (table["high"] > 30.0)]
    assert wide["concentration"].between(0.75, 1.25).all()
    within = (table["concentration_low"] <= 1.0) & (table["concentration_high"] >= 1.0)
    assert within.groupby(table["by"]).all().sum() >= 6  # of seven, 95 % each
    assert strongest(table).empty


def test_the_interval_of_a_share_is_that_of_independent_powers():
    # half of n squares of normal noise, whose mean square is 3
    rows = pd.DataFrame([strongest_by(noise(seed), "direction") for seed in range(12)])
    half = 0.5 * (rows["concentration_high"] - rows["concentration_low"]).mean()
    share = np.sqrt(3.0 * 2 * N * 0.25) / (2 * N)
    assert half == pytest.approx(2.24 * 2.0 * share, rel=0.1)  # two rows at 95 %


def test_the_larger_amplitude_and_the_falling_branch_are_found():
    falling = np.tile(np.cos(2 * np.pi * 3.0 * TIME) < 0.0, 2)
    residual = noise(4) + 0.05 * (falling & (np.arange(2 * N) >= N))
    place = strongest_by(residual, "direction")
    assert (place["low"], place["share"] > 0.9) == (-1.0, True)
    place = strongest_by(residual, "amplitude")
    assert (place["high"], place["share"] > 0.9) == (pytest.approx(2.0, rel=0.01), True)


@pytest.mark.parametrize("correlation", [0.0, 0.9])
@pytest.mark.parametrize(
    ("error", "response", "named"),
    [(1.0, 1.0, []), (2.5, 1.0, [1]), (1.0, 0.4, []), (2.5, 2.5, [])],
)
def test_a_record_is_out_of_line_where_its_error_is_larger_also_for_its_response(
    error, response, named, correlation
):
    rng, scales = np.random.default_rng(61), [(1.0, 1.0), (error, response), (1.0, 1.0)]
    own = [lfilter([1.0], [1.0, -correlation], rng.normal(size=1500)) for _ in scales]
    residuals = [scale * r for (scale, _), r in zip(scales, own, strict=True)]
    responses = [scale * rng.normal(size=1500) for _, scale in scales]
    residuals[0][:50] = np.nan
    found = out_of_line(residuals, responses, search_steps.USUAL)
    assert list(found) == named
    assert list(found.values()) == pytest.approx([error] * len(named), rel=0.15)
    assert not out_of_line(residuals[1:2], responses[1:2], search_steps.USUAL)  # no others


def test_noise_puts_no_record_out_of_line():
    rng, found = np.random.default_rng(62), 0
    for _ in range(40):
        signals = np.cumsum(rng.normal(size=(3, 200)), axis=1)
        found += bool(
            out_of_line(signals[:, :150], signals[:, 50:], replace(search_steps.USUAL, alpha=0.2))
        )
    assert found <= 8  # slow, so that a record is one block


def test_a_record_of_another_gain_is_said():
    drive = np.sin(0.2 * np.arange(900.0) + np.linspace(0.0, 4.0, 900) ** 2)
    index = pd.MultiIndex.from_product([["a", "b", "c"], DT * np.arange(300)])
    index.names = ["record", "time"]
    y = drive * np.repeat([1.0, 1.0, 1.2], 300) + noise(8)[:900]
    search = EffectSearchCV(Gain(), effects=["offset"], max_effects=0, cv=3, random_state=0)
    search.fit(pd.DataFrame({"u": drive}, index), pd.Series(y, index))
    [said] = search.warnings_
    assert said.startswith("The error of record c is ")
    assert said in search.report().remarks


def test_parameters_without_the_place_of_the_misfit():
    # a slope of 2, beyond a drive of 1.43 of 5
    rng = np.random.default_rng(6)
    drive = 1.5 * np.sin(np.linspace(0.0, 60.0, 900) + np.linspace(0.0, 4.0, 900) ** 2)
    y = 2.0 * drive + 3.0 * np.maximum(drive - 1.43, 0.0) + 0.005 * rng.normal(size=900)
    search = EffectSearchCV(Gain(), effects=["offset"], max_effects=0, cv=3, random_state=0)
    search.fit(drive[:, None], y)
    table = search.parameters_without_
    row = table[(table["by"] == "drive") & (table["parameter"] == "gain")].iloc[0]
    assert row["moved"]
    assert row["high"] == drive.max()
    assert abs(row["value_without"] - 2.0) < 0.3 * abs(row["value"] - 2.0)
    said = [remark for remark in search.report().remarks if "where the drive is from" in remark]
    assert "gain is" in said[0]


def test_of_noise_no_parameter_moves():
    drive = 1.5 * np.sin(np.linspace(0.0, 60.0, 900))
    y = 2.0 * drive + noise(7)[:900]
    search = EffectSearchCV(Gain(), effects=["offset"], max_effects=0, cv=3, random_state=0)
    assert search.fit(drive[:, None], y).parameters_without_.empty
    assert search.warnings_ == []  # nor does a straight line explain more than a gain


def test_a_burst_is_found_by_record_and_time():
    residual = noise()
    residual[N:][(TIME > 1.3) & (TIME < 1.5)] += 0.1
    assert strongest_by(residual, "record")["record"] == "b"
    place = strongest_by(residual, "time")
    assert (place["record"], place["low"]) == ("b", pytest.approx(1.2, abs=0.01))


def test_a_level_of_the_drive_is_found():
    place = strongest_by(noise() + 0.1 * (DRIVE > 1.7), "drive")
    assert place["high"] == pytest.approx(2.0)
    assert place["concentration"] > 3.0


def test_a_line_is_found():
    place = strongest_by(noise() + np.tile(0.1 * np.sin(2 * np.pi * 111.0 * TIME), 2), "frequency")
    assert place["low"] < 111.0 < place["high"]
    assert place["share"] > 0.9


@given(hole=st.integers(1, N - 1))
@settings(deadline=None, max_examples=10)
def test_shares_add_up_to_one(hole):
    residual = noise(1)
    residual[:hole] = np.nan
    sums = locate(SLICES, DRIVE, residual, Units()).groupby("by")["share"].sum()
    np.testing.assert_allclose(sums, 1.0, rtol=1e-9)


def test_nothing_left_stands_nowhere():
    assert locate(SLICES, DRIVE, 0.0 * noise(), Units()).empty


@pytest.mark.slow
def test_search_says_where_the_unexplained_stands():
    """A glitch of the plant at a level of the drive that no effect describes."""
    rng = np.random.default_rng(5)
    drive = np.sin(np.linspace(0.0, 150.0, 4000)) * np.linspace(0.8, 1.0, 4000)
    y = drive + 0.002 * rng.normal(size=4000)
    y += 0.1 * np.sin(20.0 * drive) * (drive > 0.3)
    search = EffectSearchCV(PrandtlIshlinskii(5), effects=["offset", "lag"], random_state=0)
    search.fit(drive[:, None], y)
    assert search.verdict_ == "unexplained"
    table = search.residual_location_
    assert table[table["by"] == "drive"].iloc[0]["low"] > 0.2
    report = search.report()
    assert "drive" in {row["by"] for row in report.to_dict()["location"]}
    for text in (report.to_html(), report.to_markdown()):
        assert "The residual is strongest here" in text


def test_shares_of_octaves_are_those_of_the_power():
    """Of two lines, one of twice the amplitude has four fifths."""
    n, dt = 4000, 1e-3
    time = dt * np.arange(n)
    residual = np.sin(2 * np.pi * 20.0 * time) + 2.0 * np.sin(2 * np.pi * 300.0 * time)
    table = locate([RecordSlice("a", slice(0, n), dt, 0.0, n)], np.sin(time), residual, Units())
    table = table[table["by"] == "frequency"]
    shares = [
        table[(table["low"] < f) & (f <= table["high"])]["share"].item() for f in (20.0, 300.0)
    ]
    np.testing.assert_allclose(shares, [0.2, 0.8], atol=1e-3)


def test_octaves_are_those_of_the_longest_record_and_of_the_shortest_interval():
    """Lines of one amplitude share by the numbers of samples, each within an octave."""
    intervals, sizes, lines = (1e-3, 1e-2, 1e-3), (4000, 1000, 200), (300.0, 0.6, 35.0)
    stops = np.cumsum(sizes)
    slices = [
        RecordSlice(k, slice(stop - n, stop), dt, 0.0, n)
        for k, stop, n, dt in zip("abc", stops, sizes, intervals, strict=True)
    ]
    residual = np.concatenate(
        [
            np.sin(2 * np.pi * f * dt * np.arange(n) + 0.3)
            for f, n, dt in zip(lines, sizes, intervals, strict=True)
        ]
    )
    table = locate(slices, np.sin(np.arange(stops[-1])), residual, Units())
    table = table[table["by"] == "frequency"].sort_values("low")
    np.testing.assert_allclose(table["high"].iloc[1:] / table["low"].iloc[1:], 2.0)
    assert table["high"].iloc[-1] == 500.0
    assert 2.0 / 10.0 <= table["high"].iloc[0] < 4.0 / 10.0  # of ten seconds
    for f, n in zip(lines, sizes, strict=True):
        at = (table["low"] < f) & (f <= table["high"])
        assert table[at]["share"].item() == pytest.approx(n / stops[-1], abs=0.02)


def test_concentration_is_the_power_relative_to_that_of_all_samples():
    n, dt = 1000, 0.01
    u = np.linspace(0.0, 2.0, n) ** 2
    residual = np.where(np.arange(n) < 100, 3.0, 1.0)  # 900 and 900 of a power of 1800
    slices = [RecordSlice("a", slice(0, n), dt, 0.0, n)]
    table = locate(slices, u, residual, Units())
    for by, low, high in (("time", 0.0, 0.999), ("drive", 0.0, 0.04), ("rate", 0.0, 0.08)):
        row = table[table["by"] == by].iloc[0]
        assert (row["low"], row["high"]) == pytest.approx((low, high), abs=0.01)
        assert (row["share"], row["concentration"]) == pytest.approx((0.5, 5.0), rel=0.02)
    whole = table[table["by"] == "record"].iloc[0]
    assert tuple(whole[["low", "high", "share", "concentration"]]) == pytest.approx((0, 9.99, 1, 1))


def test_each_sample_of_a_few_has_the_concentration_of_its_power():
    """All power in one of ten samples is ten times as much as the mean."""
    residual, u = 7.0 * (np.arange(10) == 4), np.arange(10.0) ** 2
    table = locate([RecordSlice("a", slice(0, 10), 0.1, 0.0, 10)], u, residual, Units())
    for by, low in (("time", 0.36), ("drive", 16.0)):
        row = table[table["by"] == by].iloc[0]
        assert (row["share"], row["concentration"]) == pytest.approx((1.0, 10.0))
        assert row["low"] <= low + 1e-9
        assert row["high"] >= 0.4
