"""Where a residual stands is found, and white noise stands everywhere."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skhyst.diagnosis import EffectSearchCV
from skhyst.diagnosis._location import locate
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.optimize import RecordData

N, DT = 4000, 0.001


def make(seed=0):
    rng = np.random.default_rng(seed)
    time = DT * np.arange(N)
    records = [RecordData(a * np.sin(2 * np.pi * 3.0 * time), np.zeros(N), DT) for a in (1.0, 2.0)]
    return records, [0.01 * rng.normal(size=N) for _ in records], time


def strongest(records, residuals, by):
    table = locate(records, residuals, ["a", "b"])
    return table[table["by"] == by].iloc[0]


def test_white_noise_stands_everywhere():
    records, residuals, _ = make()
    table = locate(records, residuals, ["a", "b"])
    wide = table[(table["by"] != "frequency") | (table["high"] > 30.0)]
    assert wide["concentration"].between(0.75, 1.25).all()


def test_a_burst_is_found_by_record_and_time():
    records, residuals, time = make()
    residuals[1][(time > 1.3) & (time < 1.5)] += 0.1
    assert strongest(records, residuals, "record")["record"] == "b"
    place = strongest(records, residuals, "time")
    assert (place["record"], place["low"]) == ("b", pytest.approx(1.2, abs=0.01))


def test_a_level_of_the_drive_is_found():
    records, residuals, _ = make()
    for record, residual in zip(records, residuals, strict=True):
        residual[record.u > 1.7] += 0.1
    place = strongest(records, residuals, "drive")
    assert place["high"] == pytest.approx(2.0)
    assert place["concentration"] > 3.0


def test_a_line_is_found():
    records, residuals, time = make()
    for residual in residuals:
        residual += 0.1 * np.sin(2 * np.pi * 111.0 * time)
    place = strongest(records, residuals, "frequency")
    assert place["low"] < 111.0 < place["high"]
    assert place["share"] > 0.9


@given(hole=st.integers(1, N - 1))
@settings(deadline=None, max_examples=10)
def test_shares_add_up_to_one(hole):
    records, residuals, _ = make(1)
    residuals[0][:hole] = np.nan
    table = locate(records, residuals, ["a", "b"])
    sums = table.groupby("by")["share"].sum()
    np.testing.assert_allclose(sums, 1.0, rtol=1e-9)


def test_nothing_left_stands_nowhere():
    records, residuals, _ = make()
    assert locate(records, [0.0 * r for r in residuals], ["a", "b"]).empty


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
    assert "What is left is strongest here" in report.to_html()
    assert "What is left is strongest here" in report.to_markdown()
