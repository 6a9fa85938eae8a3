"""Displays: what they store, where they draw, what a long or broken signal becomes."""

import sys

import numpy as np
import pandas as pd
import pytest
from matplotlib import pyplot
from plants import make_recording

from skhyst.datasets.simulation import plays
from skhyst.diagnosis import EffectSearchCV
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.inspection import (
    EffectRankingDisplay,
    EvidenceDisplay,
    HysteresisLoopDisplay,
    LoopFiguresDisplay,
    PredictionDisplay,
    RecordingDisplay,
    ResidualDisplay,
)

DISPLAYS = [HysteresisLoopDisplay, PredictionDisplay, ResidualDisplay]
all_displays = pytest.mark.parametrize("display_class", DISPLAYS)


@pytest.fixture(scope="module")
def recording():
    return make_recording("resonance", "prandtl_ishlinskii", 3, n_samples=4000)


@pytest.fixture(scope="module")
def search(recording):
    options = {"effects": ["resonance", "lag"], "cv": 2, "random_state": 0}
    search = EffectSearchCV(PrandtlIshlinskii(), **options)
    return search.fit(recording.X_train, recording.y_train)


@pytest.fixture(scope="module")
def estimator(recording):
    return PrandtlIshlinskii().fit(recording.X_train, recording.y_train)


def sweep(n_samples=2000, cycles=5.0):
    """A drive and a response with a loop, as arrays."""
    phase = np.linspace(0.0, 2.0 * np.pi * cycles, n_samples)
    return np.sin(phase), np.sin(phase) + 0.1 * np.cos(phase)


def loops(drive, response, predictions, **options):
    return HysteresisLoopDisplay.from_predictions(drive[:, None], response, predictions, **options)


def residual(drive, values, **options):
    """Show a residual with these values; the model predicts the drive."""
    return ResidualDisplay.from_predictions(drive[:, None], drive + values, drive, **options)


def curves(ax):
    """Return what is drawn on an axes, empty legend handles left out."""
    lines = [np.column_stack([line.get_xdata(), line.get_ydata()]) for line in ax.lines]
    return [line for line in lines if len(line)]


# ------------------------------------------------------------------------------- what is stored


@all_displays
def test_from_estimator_stores_the_free_run(display_class, estimator, recording):
    X, y = recording.X_train, recording.y_train
    display = display_class.from_estimator(estimator, X, y)
    np.testing.assert_array_equal(display.drive, X["drive"])
    np.testing.assert_array_equal(display.response, y)
    assert list(display.predictions) == ["PrandtlIshlinskii"]
    np.testing.assert_array_equal(display.predictions["PrandtlIshlinskii"], estimator.predict(X))
    assert (display.drive_name, display.response_name) == ("drive", "response")
    lengths = [record.n_samples for record in display.records]
    assert lengths == X.groupby(level="record").size().tolist()
    assert isinstance(display, display_class)
    assert display.figure_ is np.ravel(display.ax_)[0].figure


@all_displays
def test_from_predictions_stores_names_and_interval(display_class):
    drive, response = sweep()
    X = pd.DataFrame({"voltage (V)": drive, "temperature": 20.0})
    y = pd.Series(response, name="position (um)")
    given = {"one": response - 0.1, "two": response + 0.1}
    display = display_class.from_predictions(X, y, given, dt=0.25)
    assert list(display.predictions) == ["one", "two"]
    for name, values in given.items():
        np.testing.assert_array_equal(display.predictions[name], values)
    assert display.drive_name == "voltage (V)"
    assert display.response_name == "position (um)"
    assert [record.dt for record in display.records] == [0.25]
    display = display_class.from_predictions(drive[:, None], response, drive)
    np.testing.assert_array_equal(display.drive, drive)
    (prediction,) = display.predictions.values()
    np.testing.assert_array_equal(prediction, drive)


@pytest.mark.slow
@all_displays
def test_from_search_stores_held_out_predictions(display_class, search):
    measured = search.response_.copy()
    display = display_class.from_search(search)
    assert search.effects_ == ["resonance"]
    before, after = display.predictions.values()
    np.testing.assert_array_equal(before, search.prediction_before_)
    np.testing.assert_array_equal(after, search.prediction_after_)
    np.testing.assert_array_equal(display.drive, search.drive_)
    np.testing.assert_array_equal(display.response, measured)
    assert display.noise_floor == search.noise_floor_
    assert "resonance" in list(display.predictions)[1]
    options = {"subtract_line": True} if display_class is HysteresisLoopDisplay else {}
    display.plot(**options)
    np.testing.assert_array_equal(search.response_, measured)


def test_residuals_are_measured_minus_predicted(search):
    found = ResidualDisplay.from_search(search).residuals().values()
    for values, kept in zip(found, (search.residual_before_, search.residual_after_), strict=True):
        np.testing.assert_allclose(values, kept, atol=1e-12 * np.ptp(search.response_))


# ------------------------------------------------------------------------------- where it draws


def test_loops_on_given_axes():
    drive, response = sweep()
    display = loops(drive, response, {"a": drive, "b": drive})
    assert display.ax_.shape == (2,)
    _, ax = pyplot.subplots()
    assert display.plot(ax=ax) is display
    assert display.ax_ is ax
    assert display.figure_ is ax.figure
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels == ["measured", "a", "b"]
    figure, pair = pyplot.subplots(1, 2)
    open_figures = pyplot.get_fignums()
    display.plot(ax=pair)
    assert list(display.ax_) == list(pair)
    assert display.figure_ is figure
    assert pyplot.get_fignums() == open_figures


def test_residuals_on_given_axes():
    display = residual(sweep()[0], 0.1)
    _, four = pyplot.subplots(2, 2)
    open_figures = pyplot.get_fignums()
    assert display.plot(ax=four) is display
    assert list(display.ax_.ravel()) == list(four.ravel())
    host_figure, host = pyplot.subplots()
    display.plot(ax=host)
    assert display.ax_.shape == (2, 2)
    assert display.figure_ is host_figure
    assert pyplot.get_fignums() == [*open_figures, host_figure.number]
    _, one = pyplot.subplots()
    display.plot(ax=one, kind="spectrum")
    assert display.ax_ is one


def test_refusals(search):
    drive, response = sweep()
    with pytest.raises(ValueError, match=r"2000 samples\. Got 1999 samples instead"):
        loops(drive, response, drive[:-1])
    assert not pyplot.get_fignums()
    with pytest.raises(ValueError, match=r"one Axes or 4 Axes\. Got 3 Axes instead"):
        residual(drive, 0.1, ax=pyplot.subplots(1, 3)[1])
    with pytest.raises(ValueError, match=r"'kind' parameter .* Got 'phase' instead"):
        residual(drive, 0.1, kind="phase")
    with pytest.raises(ValueError, match=r"must be one of \[1, 2.*\]\. Got 7 instead"):
        EffectRankingDisplay.from_search(search, round=7)
    with pytest.raises(ValueError, match=r"\['resonance'\]\. Got 'creep' instead"):
        EvidenceDisplay.from_search(search, "creep")


# ------------------------------------------------------------------------------- what is drawn


def test_straight_line_is_subtracted():
    drive, _ = sweep()
    display = loops(drive, 3.0 * drive + 7.0, 3.0 * drive + 8.0, subtract_line=True)
    measured, *predicted = curves(display.ax_)
    np.testing.assert_allclose(measured[:, 1], 0.0, atol=1e-12)
    np.testing.assert_allclose(np.concatenate(predicted)[:, 1], 1.0, atol=1e-12)


def test_every_drawn_loop_point_was_measured():
    drive, response = sweep(200_000, cycles=400.0)
    display = loops(drive, response, drive)
    points = set(zip(drive, response, strict=True)) | set(zip(drive, drive, strict=True))
    drawn = np.concatenate(curves(display.ax_))
    assert {tuple(point) for point in drawn} <= points
    assert len(drawn) < 20_000


def test_long_residual_keeps_its_peaks_and_a_short_one_is_drawn_whole():
    drive, _ = sweep(200_000, cycles=50.0)
    values = 0.01 * np.random.default_rng(0).normal(size=drive.size)
    values[[12_345, 150_001]] = 1.0, -2.0
    (drawn,) = curves(residual(drive, values, kind="time", max_points=2000).ax_)
    assert len(drawn) <= 2002
    assert drawn[:, 1].max() == pytest.approx(1.0)
    assert drawn[:, 1].min() == pytest.approx(-2.0)
    assert np.all(np.diff(drawn[:, 0]) > 0.0)
    display = residual(drive[:500], values[:500], kind="time")
    (drawn,) = curves(display.ax_)
    np.testing.assert_array_equal(drawn[:, 1], display.residuals()["model"])


def test_branches_carry_their_own_residual():
    drive, _ = sweep(20_000, cycles=10.25)
    display = residual(drive, np.where(np.gradient(drive) >= 0.0, 0.3, -0.2), kind="drive")
    up, down = (np.median(line[:, 1]) for line in curves(display.ax_)[:2])
    assert up == pytest.approx(0.3)
    assert down == pytest.approx(-0.2)


def test_white_noise_lies_on_the_line_of_the_floor():
    """White noise of standard deviation s sampled every dt has the density s sqrt(2 dt)."""
    drive, _ = sweep(50_000)
    dt, std = 1e-3, 0.4
    values = std * np.random.default_rng(1).normal(size=drive.size)
    display = residual(drive, values, dt=dt, kind="spectrum")
    display.noise_floor = std
    noise, floor = curves(display.plot(kind="spectrum").ax_)
    np.testing.assert_allclose(floor[:, 1], std * np.sqrt(2.0 * dt))
    assert np.median(noise[:, 1]) == pytest.approx(floor[0, 1], rel=0.05)
    assert noise[-1, 0] <= 0.5 / dt


@all_displays
def test_washout_is_left_out_and_no_prediction_survived(display_class):
    drive, response = sweep(4000)
    prediction = response - 0.1 * np.random.default_rng(2).normal(size=drive.size)
    prediction[:300] = prediction[2000:2100] = np.nan
    display = display_class.from_predictions(drive[:, None], response, prediction)
    np.testing.assert_array_equal(display.predictions["model"], prediction)
    for ax in np.ravel(display.ax_):
        drawn = np.concatenate(curves(ax))
        assert np.isfinite(drawn).mean() > 0.5
        assert np.all(np.isfinite([*ax.get_xlim(), *ax.get_ylim()]))
    display.figure_.canvas.draw()
    display = display_class.from_predictions(drive[:, None], response, np.full(4000, np.nan))
    display.figure_.canvas.draw()


def test_records_that_start_anew_follow_each_other():
    drive, response = sweep(1000)
    index = pd.MultiIndex.from_product([[0, 1], 0.1 * np.arange(500)], names=["record", "time"])
    once = 0.1 * np.arange(1000) + 5.0 * (np.arange(1000) >= 500)
    for times, running in ((index, 0.1 * np.arange(1000)), (once, once)):
        X, y = pd.DataFrame({"u": drive}, index=times), pd.Series(response, index=times)
        display = ResidualDisplay.from_predictions(X, y, drive, kind="time")
        np.testing.assert_allclose(display.running_time(), running)


def test_a_prediction_is_shown_where_it_is_furthest_off_within_one_record():
    drive, response = sweep(1000)
    index = pd.MultiIndex.from_product([[0, 1], 0.1 * np.arange(500)], names=["record", "time"])
    X, y = (
        pd.DataFrame({"u": drive}, index=index),
        pd.Series(response.copy(), index=index, name="x [um]"),
    )
    y.iloc[510] += 3.0
    given = {"first": response, "second": np.full(1000, np.nan)}
    display = PredictionDisplay.from_predictions(X, y, given, n_samples=100)
    assert display.furthest_off(100) == slice(500, 600)
    assert display.furthest_off(5000) == slice(500, 1000)
    whole, closer = display.ax_
    assert max(np.ptp(line[:, 0]) for line in curves(closer)) == pytest.approx(9.9)
    assert max(line[:, 1].max() for line in curves(whole)) == y.max()  # no peak is lost
    assert whole.get_ylabel() == closer.get_ylabel() == "x [um]"


@all_displays
def test_legends_stand_beside_the_data(display_class):
    drive, response = sweep()
    display = display_class.from_predictions(drive[:, None], response, {"a": drive, "b": drive})
    display.figure_.canvas.draw()
    legends = [ax.get_legend() for ax in np.ravel(display.ax_)]
    assert any(legends)
    for ax in np.ravel(display.ax_):
        for legend in filter(None, legends):
            assert not ax.get_window_extent().overlaps(legend.get_window_extent())
    narrow = pyplot.figure(figsize=(4.8, 4.0), layout="constrained")
    display.plot(ax=narrow.subplots(*np.shape(display.ax_) or (1, 1)))
    narrow.canvas.draw()
    (legend,) = narrow.legends
    assert not any(
        ax.get_window_extent().overlaps(legend.get_window_extent()) for ax in narrow.axes
    )


def test_names_are_no_formulas():
    drive, response = sweep()
    name = r"$\notacommand{ & <b>"
    X, y = pd.DataFrame({name: drive}), pd.Series(response, name=name)
    ResidualDisplay.from_predictions(X, y, {name: drive}).figure_.canvas.draw()


# ------------------------------------------------------------------------- ranking and evidence


def test_ranking_is_that_of_the_search(search):
    _, ax = pyplot.subplots()
    display = EffectRankingDisplay.from_search(search, ax=ax)
    table = search.ranking_[search.ranking_["round"] == 1]
    assert display.ax_ is ax
    assert sorted(display.ranking["effect"]) == sorted(table["effect"])
    texts = [text.get_text() for text in ax.get_yticklabels()]
    names = dict(zip(ax.get_yticks(), texts, strict=True))
    assert names[max(names)] == "resonance"
    rings = [line.get_xydata()[0] for line in ax.lines if line.get_marker() == "o"]
    marks = {names[height]: error for error, height in rings}
    contested = table.dropna(subset="error_after").set_index("effect")["error_after"]
    assert marks == pytest.approx(contested.to_dict())


def test_evidence_is_that_of_the_search(search):
    """The mode's gain, and its phase below it, in the place of one Axes."""
    figure, ax = pyplot.subplots()
    display = EvidenceDisplay.from_search(search, "resonance", ax=ax)
    assert display.figure_ is figure
    picture = search.evidence_["resonance"].picture
    for own, panel in zip((picture, picture.below), display.ax_, strict=True):
        assert panel.get_title(loc="left") == own.title
        assert panel.get_xscale() == ("log" if own.x_log else "linear")
        for (_, x, y, _), drawn in zip(own.curves, curves(panel), strict=True):
            np.testing.assert_array_equal(drawn, np.column_stack([x, y]))


# ------------------------------------------------------------------------- without matplotlib


def test_missing_matplotlib_names_the_extra(monkeypatch, search):
    drive, response = sweep()
    display = residual(drive, 0.1)
    stored = display.residuals()
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    for draw in (
        display.plot,
        lambda: loops(drive, response, drive),
        lambda: EffectRankingDisplay.from_search(search),
        lambda: EvidenceDisplay.from_search(search, "resonance"),
    ):
        with pytest.raises(ImportError, match=r"Display needs matplotlib.*skhyst\[plot\]"):
            draw()
    np.testing.assert_array_equal(display.residuals()["model"], stored["model"])


def test_loops_and_what_characterises_them():
    """A play of half width 0.2, whose loop is 2 (A - 0.2) high: the marks stand on its sides."""
    drive = 1.0 - 4.0 * np.abs(np.arange(1601) / 400 % 1.0 - 0.5)
    X = pd.DataFrame({"u [V]": drive})
    response = pd.Series(plays(drive, 1.0, [0.2], [1.0]), name="x [um]")
    display = LoopFiguresDisplay.from_recording(X, response, skip=1)
    display.figure_.canvas.draw()
    (line,) = display.lines()
    assert line.startswith("record 0, 3 cycles from -1 to 1 V, 400 samples each: coercivity 0.2 ±")
    for told in ("remanence 0.2 ±", "area 0.64 ±", "V um", "opening 0.4 ±", "closure"):
        assert told in line
    marked = [own for own in display.ax_.get_lines() if own.get_marker() in "so"]
    found = [np.sort(own.get_xydata(), axis=0) for own in marked]
    np.testing.assert_allclose(found[0], [[-0.2, 0.0], [0.2, 0.0]], atol=1e-12)
    np.testing.assert_allclose(found[1], [[0.0, -0.2], [0.0, 0.2]], atol=1e-12)
    assert display.ax_.get_xlabel() == "u [V]"
    steps = np.concatenate([drive, 2.0 * drive, 3.0 * drive[:801]])
    display = LoopFiguresDisplay.from_recording(steps, steps)
    assert [line[:18] for line in display.lines(2)[:2]] == ["record 0, 4 cycles"] * 2
    assert display.lines(2)[2] == "and 1 more with fewer cycles"
    display = LoopFiguresDisplay.from_recording(X[:100], response[:100])
    assert display.lines() == ["record 0: no closed loop"]
    assert [text.get_text() for text in display.ax_.texts] == ["no closed loop"]


PART = "10 cycles around the largest excursion"


@pytest.mark.parametrize(("n_cycles", "title"), [(30, PART), (3, "")])
def test_a_part_of_the_loops_is_called_one(n_cycles, title):
    drive = np.sin(np.linspace(0.0, 2.0 * np.pi * n_cycles, 900))
    *_, loop = RecordingDisplay.from_recording(drive[:, None], drive**3).ax_
    assert loop.get_title(loc="left") == title
