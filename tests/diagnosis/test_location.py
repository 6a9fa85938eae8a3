"""Where a residual stands is found, and white noise stands everywhere."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skhyst.diagnosis import EffectSearchCV
from skhyst.diagnosis._location import locate
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.records import RecordSlice, Units

N, DT = 4000, 0.001
TIME = DT * np.arange(N)
SLICES = [RecordSlice(k, slice(i * N, (i + 1) * N), DT, 0.0, N) for i, k in enumerate("ab")]
DRIVE = np.concatenate([a * np.sin(2 * np.pi * 3.0 * TIME) for a in (1.0, 2.0)])


def noise(seed=0):
    return 0.01 * np.random.default_rng(seed).normal(size=2 * N)


def strongest(residual, by):
    table = locate(SLICES, DRIVE, residual, Units())
    return table[table["by"] == by].iloc[0]


def test_white_noise_stands_everywhere():
    table = locate(SLICES, DRIVE, noise(), Units())
    wide = table[(table["by"] != "frequency") | (table["high"] > 30.0)]
    assert wide["concentration"].between(0.75, 1.25).all()


def test_a_burst_is_found_by_record_and_time():
    residual = noise()
    residual[N:][(TIME > 1.3) & (TIME < 1.5)] += 0.1
    assert strongest(residual, "record")["record"] == "b"
    place = strongest(residual, "time")
    assert (place["record"], place["low"]) == ("b", pytest.approx(1.2, abs=0.01))


def test_a_level_of_the_drive_is_found():
    place = strongest(noise() + 0.1 * (DRIVE > 1.7), "drive")
    assert place["high"] == pytest.approx(2.0)
    assert place["concentration"] > 3.0


def test_a_line_is_found():
    place = strongest(noise() + np.tile(0.1 * np.sin(2 * np.pi * 111.0 * TIME), 2), "frequency")
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
