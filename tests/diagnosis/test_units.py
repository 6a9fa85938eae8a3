"""Units in words: those of the columns' names, and samples where nobody has said a time."""

import json

import numpy as np
import pandas as pd
import pytest

from skhyst.diagnosis import EffectSearchCV, next_experiment
from skhyst.exceptions import RecordError
from skhyst.hysteresis import PrandtlIshlinskiiOperator
from skhyst.inspection import FrequencyResponseDisplay, PoleZeroDisplay, ResidualDisplay
from skhyst.linear import FirstOrderLagOperator, Gain, TransferFunction
from skhyst.operators import Series, SumOperator
from skhyst.records import Units
from skhyst.static import SaturationOperator

N, TAU = 1500, 8.0  # samples


def recording():
    """Return the drive and the response of a lag."""
    rng = np.random.default_rng(0)
    drive = np.cumsum(rng.normal(size=N)) / 20.0
    response, _ = FirstOrderLagOperator(TAU).run(drive, 1.0)
    return drive, response + 0.003 * rng.normal(size=N)


@pytest.fixture(
    scope="module",
    params=["array", pytest.param("interval", marks=pytest.mark.slow)],
)
def searched(request):
    """A search, and the interval in s where it is known."""
    drive, response = recording()
    dt = 0.002 if request.param == "interval" else None
    return EffectSearchCV(Gain(dt=dt), effects=["lag", "delay"]).fit(drive[:, None], response), dt


@pytest.mark.slow
def test_without_a_time_all_is_counted_in_samples_and_never_in_seconds(searched):
    search, dt = searched
    evidence = search.evidence_["lag"]
    value, _, unit = evidence.numbers["time constant"]
    corner, _, per = evidence.numbers["corner frequency"]
    assert (unit, per) == (("samples", "cycles/sample") if dt is None else ("s", "Hz"))
    assert value == pytest.approx(TAU * (dt or 1.0), rel=0.01)
    assert corner == pytest.approx(0.5 / np.pi / value)
    lowest = evidence.picture.below or evidence.picture
    assert lowest.x_label == f"frequency ({per})"
    rows = search.residual_location_.set_index("by")["unit"]
    assert set(rows["frequency"]) == {per}
    report = search.report()
    texts = [report.to_markdown(), report.to_html(), evidence.statement]
    for text in [*texts, next_experiment(search, (-1.0, 1.0)).reason]:
        assert per in text
        assert {"s": "cycles/sample", "samples": "Hz"}[unit] not in text
    assert json.loads(report.to_json())["units"]["time"] == ("sample" if dt is None else "s")


def test_axes_count_samples_where_there_is_no_time():
    drive, response = recording()
    for dt, unit in ((None, "cycles/sample"), (0.01, "Hz")):
        model = TransferFunction(1, dt=dt).fit(drive[:, None], response)
        (*_, spectrum), bode = (
            ResidualDisplay.from_estimator(model, drive[:, None], response).ax_.ravel(),
            FrequencyResponseDisplay.from_recording(drive[:, None], response, dt=dt).ax_,
        )
        poles = PoleZeroDisplay.from_estimator(model).ax_
        for axes in (spectrum, bode[-1, 0], poles):
            assert f"({unit})" in axes.get_xlabel()


def refused(X, y):
    """Return what a search says of data that it refuses."""
    with pytest.raises(RecordError) as error:
        EffectSearchCV(Gain(), effects=["lag"]).fit(X, y)
    return str(error.value)


def test_signals_of_no_experiment_are_refused():
    drive, response = recording()
    X = np.column_stack([drive, response])
    assert "column 1 of X twice" in refused(X, response)
    assert "must move. Got 0.7" in refused(drive[:, None], np.full(N, 0.7))


@pytest.mark.parametrize("scale", [1.0, 1e3, 500.0])
@pytest.mark.parametrize("n_records", [1, 2])
def test_a_drive_that_is_the_time_is_refused(scale, n_records):
    _, response = recording()
    time = np.tile(0.002 * np.arange(N // n_records), n_records)
    index = pd.MultiIndex.from_arrays([np.repeat(range(n_records), N // n_records), time])
    X = pd.DataFrame({"u": scale * (time + 7.0)}, index.set_names(["record", "time"]))
    assert "counts the time or the samples" in refused(X, response)
    if scale == 1.0:
        X["u"] *= 1.01  # a ramp of its own slope is a drive
        EffectSearchCV(Gain(), effects=[]).fit(X, response)


@pytest.mark.slow
def test_units_of_the_names_reach_everything_that_is_told():
    drive, response = recording()
    time = pd.Index(0.001 * np.arange(N), name="time")
    X, y = pd.DataFrame({"u [V]": drive}, time), pd.Series(response, time, name="x (um)")
    search = EffectSearchCV(Gain(), effects=["lag"]).fit(X, y)
    assert search.units_ == Units("V", "um", "s")
    report = json.loads(search.report().to_json())
    assert report["units"] == {"drive": "V", "response": "um", "time": "s"}
    units = {row["name"]: row["unit"] for row in report["parameters"]["augmented"]}
    assert {name.split("__")[-1]: unit for name, unit in units.items()} == {
        "gain": "um/V",
        "intercept": "um",
        "time_constant": "s",
    }
    assert [row["unit"] for row in report["parameters"]["declared"]] == ["um/V", "um"]
    assert {row["unit"] for row in report["location"]} <= {"s", "V", "V/s", "Hz"}
    axes = ResidualDisplay.from_search(search).ax_.ravel()
    assert axes[0].get_ylabel() == "residual of x (um)"
    assert axes[-1].get_ylabel() == "residual (um/√Hz)"
    assert "um" in search.report().sentence


def test_parameters_have_units_of_the_signals_that_they_stand_between():
    plays = PrandtlIshlinskiiOperator(np.array([0.0, 1.0]), np.ones(2))
    stages = (
        SaturationOperator(-1.0, 1.0),
        plays,
        FirstOrderLagOperator(0.1),
        SaturationOperator(-2.0, 2.0),
    )
    series = Series(("amplifier", "plays", "lag", "sensor"), stages)
    units = {name: spec.unit for name, spec in series.entries()}
    assert units["amplifier__lower"] == "drive"
    assert units["plays__weights[1]"] == "response/drive"
    assert units["lag__gain"] == ""
    assert units["sensor__upper"] == "response"
    additive = SumOperator(("plays", "lag"), (plays, FirstOrderLagOperator(0.1)))
    assert dict(additive.entries())["lag__gain"].unit == "response/drive"
