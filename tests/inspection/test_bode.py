"""Bode diagrams: what they store, what is drawn, what is refused."""

import numpy as np
import pytest
from matplotlib import pyplot

from skhyst.inspection import FrequencyResponseDisplay
from skhyst.linear import (
    FirstOrderLag,
    FrequencyResponse,
    SecondOrderModeOperator,
    frequency_response,
)
from skhyst.records import stack_records

MODE = SecondOrderModeOperator(60.0, 0.05, gain=3.0)


@pytest.fixture(scope="module")
def recording():
    rng = np.random.default_rng(0)
    drive = rng.normal(size=4000)
    return drive[:, None], MODE.run(drive, 0.01)[0] + 0.1 * rng.normal(size=4000)


@pytest.fixture(scope="module")
def periodic():
    rng = np.random.default_rng(1)
    drives = [np.tile(rng.normal(size=(200, 2)), (4, 1)) for _ in range(3)]
    records = [(u, u @ [1.0, 2.0] + u[:, 0] ** 3 + 0.01 * rng.normal(size=800)) for u in drives]
    return frequency_response(*stack_records(records, dt=0.01))


class TwoInputs:
    def frequency_response(self, frequency):
        return np.ones((*np.shape(frequency), 1)) * [1.0, 2.0j]


def labels(ax):
    return [" ".join(text.get_text().split()) for text in ax.get_legend().get_texts()]


def test_recording_and_models(recording):
    X, y = recording
    lag = FirstOrderLag(dt=0.01).fit(X, y)
    display = FrequencyResponseDisplay.from_recording(
        X, y, {"mode": MODE, "lag": lag}, dt=0.01, segment_length=400
    )
    expected = frequency_response(X, y, dt=0.01, segment_length=400)
    np.testing.assert_array_equal(display.response.response, expected.response)
    assert list(display.models) == ["mode", "lag"]
    frequency, values = display.models["lag"]
    np.testing.assert_array_equal(values[:, 0], lag.operator_.frequency_response(frequency))
    magnitude, phase, coherence = display.ax_[:, 0]
    assert labels(magnitude) == ["measured, 95 % band", "mode", "lag"]
    measured, *models = magnitude.lines
    np.testing.assert_array_equal(measured.get_ydata(), np.abs(expected.response[:, 0]))
    peak = models[0].get_xdata()[np.argmax(models[0].get_ydata())]
    assert peak == pytest.approx(60.0 / (2 * np.pi), rel=0.01)
    np.testing.assert_array_equal(coherence.lines[0].get_ydata(), expected.coherence)
    assert phase.get_ylabel() == "phase (°)"
    display.figure_.canvas.draw()


@pytest.mark.slow
def test_levels_of_noise_and_distortion(periodic):
    display = FrequencyResponseDisplay.from_response(periodic, [TwoInputs(), TwoInputs()])
    assert display.ax_.shape == (2, 2)
    assert list(display.models) == ["TwoInputs", "TwoInputs 2"]
    assert labels(display.ax_[0, -1])[-2:] == ["distortion, one realisation", "noise of the mean"]
    titles = [ax.get_title(loc="left") for ax in display.ax_[0]]
    assert titles == ["from drive", "from auxiliary1"]
    noise = display.ax_[0, 1].lines[-1].get_ydata()
    rms = np.sqrt(np.mean(periodic.noise_std[:, 1] ** 2))
    assert np.nanmin(noise) < rms < np.nanmax(noise)
    display.figure_.canvas.draw()


@pytest.mark.slow
def test_bands_have_the_promised_level(periodic):
    displays = [FrequencyResponseDisplay.from_response(periodic, level=a) for a in (0.99, 0.5)]
    bands = [display.ax_[0, 0].collections[0].get_paths()[0] for display in displays]
    wide, narrow = (band.vertices[:, 1].max() for band in bands)
    assert wide > narrow
    top = np.abs(periodic.response[:, 0]) + periodic.confidence_radius(0.99)[:, 0]
    assert wide == pytest.approx(top.max())


def test_given_axes_and_another_response(periodic):
    figure, axes = pyplot.subplots(2, 2)
    display = FrequencyResponseDisplay.from_response(
        periodic, {"low": periodic.restrict(0.0, 10.0)}, ax=axes, log_frequency=False
    )
    assert display.figure_ is figure
    assert list(display.ax_.ravel()) == list(axes.ravel())
    assert display.models["low"][0].max() <= 10.0
    assert display.ax_[0, 0].get_xscale() == "linear"
    assert pyplot.get_fignums() == [figure.number]


def test_bare_and_zero_responses_are_drawn():
    std = np.array([0.0, 1.0, 1.0])
    bare = FrequencyResponse([0.0, 1.0, 2.0], [0.0, 0.0, 1j], std, std, 0.0 * std)
    FrequencyResponseDisplay.from_response(bare, MODE).figure_.canvas.draw()
    FrequencyResponseDisplay.from_response(FrequencyResponse([1.0], [0.0])).figure_.canvas.draw()


def test_phase_is_not_drawn_across_the_circle():
    frequency = np.linspace(1.0, 50.0, 400)
    delayed = FrequencyResponse(frequency, np.exp(-2j * np.pi * frequency * 0.1))
    display = FrequencyResponseDisplay.from_response(delayed, delayed)
    drawn = display.ax_[1, 0].lines[-1].get_ydata()
    steps = np.abs(np.diff(drawn))
    assert np.nanmax(steps) < 90.0
    assert np.count_nonzero(np.isnan(drawn)) == 5


def test_models_that_do_not_fit_are_refused(periodic):
    with pytest.raises(TypeError, match=r"Got 'dict', a dict, without it"):
        FrequencyResponseDisplay.from_response(periodic, [{}])
    with pytest.raises(ValueError, match=r"must have 2 input\(s\)"):
        FrequencyResponseDisplay.from_response(periodic, MODE)
    with pytest.raises(ValueError, match=r"one Axes or 4 Axes"):
        FrequencyResponseDisplay.from_response(periodic, ax=pyplot.subplots(1, 3)[1])
