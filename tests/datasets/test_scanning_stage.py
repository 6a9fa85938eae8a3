"""The simulated scanning stage: published numbers, physics, effects, and what is found of it."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp
from sklearn.frozen import FrozenEstimator

from skhyst.compose import Cascade
from skhyst.datasets import load_scanning_stage_parameters, make_scanning_stage
from skhyst.exceptions import RecordError
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import FrequencyResponse, KelvinVoigt, TransferFunction, frequency_response
from skhyst.records import record_slices

RATE = 250e3
STAGE = load_scanning_stage_parameters()


def transfer(frequency, gain=1.0):
    """The small-signal response, V to um: the plays of threshold zero, creep, (4.1)."""
    s = 2j * np.pi * np.asarray(frequency)
    creep = 1.0 + sum(
        1.0 / (k * s + c) for c, k in zip(STAGE.stiffnesses, STAGE.dampings, strict=True)
    )
    return gain * creep * np.polyval(STAGE.numerator, s) / np.polyval(STAGE.denominator, s)


def test_published_numbers():
    np.testing.assert_allclose(STAGE.natural_frequencies, [24.39e3, 37.25e3], rtol=2e-4)
    np.testing.assert_allclose(STAGE.damping_ratios, [0.0221, 0.0113], rtol=2e-3)
    assert STAGE.weights.sum() == pytest.approx(1.49347)
    # 80 V give a few um, less than the 8 um that the element does at 100 V
    X, y, _ = make_scanning_stage(noise=0.0, quantize=False)
    assert 3.0 < np.ptp(y) < 4.0
    assert X["drive"].abs().max() == 40.0


def test_small_drives_see_the_linear_response():
    """Within the first threshold there is no hysteresis: a sine gives the transfer function."""
    time = np.arange(5000) / RATE
    for frequency in (500.0, 20e3, 37e3):
        u = np.sin(2 * np.pi * frequency * time)
        _, y, truth = make_scanning_stage(u, noise=0.0, quantize=False)
        late = slice(4000, None)
        waves = np.column_stack([u, np.cos(2 * np.pi * frequency * time), np.ones_like(u)])[late]
        (a, b, _), *_ = np.linalg.lstsq(waves, y.to_numpy()[late], rcond=None)
        # straight lines between samples are a weaker sine
        gain = STAGE.weights[:2].sum() * np.sinc(frequency / RATE) ** 2
        assert abs(a + 1j * b - transfer(frequency, gain)) < 2e-3 * abs(transfer(frequency, gain))
        np.testing.assert_allclose(truth.hysteresis, STAGE.weights[:2].sum() * u, atol=1e-12)


def test_stage_by_an_ordinary_differential_equation():
    """One cycle at 1 kHz, integrated by SciPy in the controllable form of the whole chain."""
    X, y, truth = make_scanning_stage(noise=0.0, quantize=False)
    u, response = X.loc["1000 Hz", "drive"].to_numpy()[:250], y.loc["1000 Hz"].to_numpy()[:250]
    fine = np.linspace(0.0, 249 / RATE, 249 * 40 + 1)
    drive = np.interp(fine, np.arange(250) / RATE, u)
    hysteresis, play = np.zeros(len(fine)), np.zeros(6)
    for i, value in enumerate(drive):
        play = np.clip(play, value - STAGE.thresholds, value + STAGE.thresholds)
        hysteresis[i] = STAGE.weights @ play
    np.testing.assert_allclose(
        hysteresis[::40], truth.hysteresis.loc["1000 Hz"].iloc[:250], atol=1e-9
    )
    unit = 1e5  # rad/s
    powers = unit ** np.arange(9.0)
    denominator = STAGE.denominator / powers
    numerator = STAGE.numerator / powers[6:]
    rates = 1.0 / STAGE.time_constants

    def motion(t, x):
        v = np.interp(t, fine, hysteresis)
        bending = rates * (STAGE.compliances * v - x[:3])
        force = v + x[:3].sum()
        chain = np.append(x[4:], force - denominator[:0:-1] @ x[3:])
        return np.concatenate([bending, unit * chain])

    options = {"method": "LSODA", "rtol": 1e-8, "atol": 1e-10, "max_step": 1e-6}
    found = solve_ivp(motion, (0.0, fine[-1]), np.zeros(11), t_eval=fine[::40], **options).y
    np.testing.assert_allclose(numerator[::-1] @ found[3:6], response, atol=2e-4 * np.ptp(response))


def test_sensor():
    X, y, truth = make_scanning_stage(random_state=0)
    assert truth.resolution == pytest.approx(10.0 / 2**16)
    steps = y / truth.resolution
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    assert np.std(y - truth.response) == pytest.approx(5e-4, rel=0.03)
    again = make_scanning_stage(random_state=0)[1]
    pd.testing.assert_series_equal(y, again)
    other = make_scanning_stage(random_state=1)[1]
    assert np.std(other - y) > 5e-4
    intervals = [record.dt for record in record_slices(X, one_interval=False)]
    np.testing.assert_allclose(intervals, [2e-3, 2e-4, 2e-5, 4e-6])


def test_velocity_is_the_derivative():
    options = {"noise": 0.0, "quantize": False, "random_state": 3}
    rng = np.random.default_rng(0)
    u = np.convolve(rng.normal(size=4000), np.hanning(30), "same")
    _, position, _ = make_scanning_stage(u, **options)
    _, velocity, _ = make_scanning_stage(u, measured="velocity", **options)
    covered = np.cumsum(0.5 * (velocity.to_numpy()[1:] + velocity.to_numpy()[:-1])) / RATE
    moved = position.to_numpy()[1:] - position.to_numpy()[0]
    np.testing.assert_allclose(covered, moved, atol=0.01 * np.ptp(moved))


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"drive": "fast"}, ValueError, "'drive' parameter of make_scanning_stage"),
        ({"drive": [1.0, np.nan]}, RecordError, "finite"),
        ({"drive": []}, RecordError, "samples"),
        ({"measured": "force"}, ValueError, "'measured' parameter"),
        ({"noise": -1.0}, ValueError, "'noise' parameter"),
        ({"effects": "kreep"}, ValueError, "'effects' parameter of make_scanning_stage"),
    ],
)
def test_wrong_arguments(options, error, message):
    with pytest.raises(error, match=message):
        make_scanning_stage(**options)


def test_range_of_the_sensor_ends():
    with pytest.warns(UserWarning, match="range of the sensor"):
        _, y, _ = make_scanning_stage(np.linspace(0.0, 200.0, 500))
    assert y.max() == 5.0


def test_hold_of_the_drive_is_taken_out():
    frequency = np.linspace(1e3, 100e3, 50)
    lines = np.sinc(frequency / RATE)
    straight = FrequencyResponse(frequency, 3.0 * lines**2, std=lines**2, dt=1 / RATE)
    found = straight.compensate_hold()
    np.testing.assert_allclose(found.response, 3.0)
    np.testing.assert_allclose(found.std, 1.0)
    held = FrequencyResponse(frequency, lines * np.exp(-1j * np.pi * frequency / RATE), dt=1 / RATE)
    np.testing.assert_allclose(held.compensate_hold("zoh").response, 1.0)
    with pytest.raises(ValueError, match="compensate_hold"):
        straight.compensate_hold("soh")


@pytest.fixture(scope="module")
def vibration():
    """The small-signal response, (4.1) and the fast spring-damper unit in one transfer function."""
    found = frequency_response(*make_scanning_stage("small_signal", random_state=2)[:2])
    found = found.compensate_hold().restrict(100.0, 60e3)
    return TransferFunction(9, n_zeros=3).fit_frequency_response(found)


def test_resonances_from_white_noise(vibration):
    modes = np.argsort(vibration.damping_ratios_)[:2]
    modes = modes[np.argsort(vibration.natural_frequencies_[modes])]
    frequencies = vibration.natural_frequencies_[modes] / (2 * np.pi)
    np.testing.assert_allclose(frequencies, STAGE.natural_frequencies, rtol=0.005)
    np.testing.assert_allclose(vibration.damping_ratios_[modes], STAGE.damping_ratios, rtol=0.05)


@pytest.mark.slow
def test_cascade_of_the_thesis_predicts_all_its_experiments(vibration):
    """Vibration held, four triangles to fit on, RMS error below 0.1 % of the stroke everywhere."""
    X, y, _ = make_scanning_stage(random_state=0)
    steps = [
        ("hysteresis", PrandtlIshlinskii(5)),
        ("creep", KelvinVoigt(2)),
        ("vibration", FrozenEstimator(vibration)),
    ]
    model = Cascade(steps).fit(X, y)
    for recording in ((X, y), make_scanning_stage("validation", random_state=1)[:2]):
        error = (recording[1] - model.predict(recording[0])).groupby("record").std()
        stroke = recording[1].groupby("record").agg(np.ptp)
        assert (error / stroke).max() < 1e-3
    # the slow units, relative to the static gain of the fast one, which is in the vibration
    fast = 1.0 + STAGE.compliances[1]
    found = model.operators_["creep"]
    assert found.time_constants[1] == pytest.approx(STAGE.time_constants[0], rel=0.05)
    assert found.compliances[1] == pytest.approx(STAGE.compliances[0] / fast, rel=0.05)
