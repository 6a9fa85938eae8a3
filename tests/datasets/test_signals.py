"""Test signals: closed forms, spectra, and what they refuse."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import chirp, sawtooth

from skhyst.datasets import (
    band_limited_noise,
    decaying_sine,
    first_order_reversal_curves,
    multisine,
    signals_within,
    sine,
    steps,
    swept_sine,
    triangle,
)
from skhyst.records import record_slices

DT = 1e-3


def values(X):
    return X["drive"].to_numpy()


def records(X):
    return [X.to_numpy()[record.rows] for record in record_slices(X)]


def test_time_is_in_seconds():
    (record,) = record_slices(triangle(frequency=4.0, n_cycles=3, dt=2e-3))
    assert (record.label, record.start_time, record.n_samples) == (0, 0.0, 375)
    assert record.dt == pytest.approx(2e-3)


def test_a_triangle_and_a_sine_by_their_formulas():
    time = DT * np.arange(600)
    phase = 2 * np.pi * 5.0 * time
    options = {"frequency": 5.0, "n_cycles": 3, "dt": DT, "offset": -1.0}
    expected = {
        "triangle": 2.0 * sawtooth(phase + 0.5 * np.pi, 0.5),
        "sine": 2.0 * np.sin(phase),
        "triangle, one side": sawtooth(phase, 0.5) + 1.0,
        "sine, one side": 1.0 - np.cos(phase),
    }
    for name, wave in expected.items():
        make = triangle if name.startswith("triangle") else sine
        found = values(make(2.0, unipolar="one side" in name, **options))
        np.testing.assert_allclose(found, wave - 1.0, atol=1e-9)


@settings(deadline=None, max_examples=40)
@given(
    st.lists(
        st.tuples(st.floats(-3.0, 3.0), st.floats(0.5, 40.0), st.integers(1, 4)),
        min_size=1,
        max_size=4,
    ),
    st.booleans(),
    st.sampled_from([triangle, sine]),
)
def test_programmes_are_continuous(stretches, unipolar, make):
    """No step is larger than the steepest slope allows; each stretch has its own amplitude."""
    amplitude, frequency, n_cycles = (list(part) for part in zip(*stretches, strict=True))
    u = values(make(amplitude, frequency, n_cycles=n_cycles, dt=DT, offset=0.3, unipolar=unipolar))
    assert u[0] == 0.3
    slopes = (4.0 if make is triangle else 2 * np.pi) * np.abs(amplitude) * np.array(frequency)
    limit = slopes.max() * DT * (0.5 if unipolar else 1.0)
    assert np.abs(np.diff(u)).max(initial=0.0) <= limit * (1 + 1e-9) + 1e-12
    duration = np.cumsum(np.divide(n_cycles, frequency))
    assert len(u) == pytest.approx(duration[-1] / DT, abs=1.0)
    start = 0.0
    for height, end, slope in zip(amplitude, duration, slopes, strict=True):
        part = u[int(np.ceil(start / DT)) : int(end / DT)] - 0.3
        largest = np.abs(part).max()
        assert abs(height) - slope * DT - 1e-12 <= largest <= abs(height) * (1 + 1e-9) + 1e-12
        start = end


def test_sweep_by_its_formula():
    """(14) of Han et al. (undated), and the logarithmic sweep of SciPy."""
    u = values(swept_sine(0.1, 800.0, duration=3.0, amplitude=5.0, dt=1e-4, phase=0.5 * np.pi))
    time = 1e-4 * np.arange(30001)
    expected = 5 * np.sin(2 * np.pi * (0.1 * time + 0.5 * 799.9 / 3 * time**2) + 0.5 * np.pi)
    np.testing.assert_allclose(u, expected, atol=1e-9)
    for spacing in ("linear", "logarithmic"):
        for start, stop in ((2.0, 300.0), (300.0, 2.0), (7.0, 7.0)):
            u = values(swept_sine(start, stop, duration=1.5, dt=DT, spacing=spacing, offset=1.0))
            time = DT * np.arange(1501)
            expected = chirp(time, start, 1.5, stop, spacing, phi=-90)
            np.testing.assert_allclose(u, 1.0 + expected, atol=1e-8)


def test_decaying_sine_is_that_of_the_paper():
    """(12): 3.5 sin(10 pi t) exp(-t), 35,001 samples at 0.1 ms."""
    time = 1e-4 * np.arange(35001)
    expected = 3.5 * np.sin(2.0 * np.pi * 5.0 * time) * np.exp(-time)
    np.testing.assert_array_equal(values(decaying_sine()), expected)


# ---------------------------------------------------------------------------------- random phases


@pytest.mark.parametrize("grid", ["full", "odd", "random_odd"])
def test_multisine_excites_its_lines_and_no_others(grid):
    n, band = 1000, (20.0, 300.0)
    own = {"rms": 3.0, "offset": 0.5, "n_periods": 2, "n_realizations": 3, "random_state": 1}
    X = multisine(n, band=band, grid=grid, amplitude=lambda f: 1.0 / f, dt=DT, **own)
    assert list(X.index.unique("record")) == [f"realization{i}" for i in range(3)]
    excited, spectra = None, []
    for part in records(X):
        first, second = part.reshape(2, n)
        np.testing.assert_array_equal(first, second)
        assert first.mean() == pytest.approx(0.5, abs=1e-12)
        assert first.std() == pytest.approx(3.0, rel=1e-12)
        spectrum = np.fft.rfft(first - 0.5)
        lines = np.flatnonzero(np.abs(spectrum) > 1e-8)
        assert excited is None or np.array_equal(lines, excited)
        excited = lines
        power = np.abs(spectrum[lines]) * lines
        np.testing.assert_allclose(power, power[0], rtol=1e-9)
        spectra.append(spectrum[lines])
    everything = np.arange(20, 301)
    if grid == "full":
        np.testing.assert_array_equal(excited, everything)
    else:
        odd = everything[everything % 2 == 1]
        assert set(excited) <= set(odd)
        missing = len(odd) // 4 if grid == "random_odd" else 0
        assert len(odd) - len(excited) == missing
        for group in odd[: 4 * missing].reshape(-1, 4):
            assert len(set(group) - set(excited)) == 1
    # phases of different realisations are unrelated
    correlation = np.mean(np.exp(1j * (np.angle(spectra[0]) - np.angle(spectra[1]))))
    assert abs(correlation) < 4.0 / np.sqrt(len(excited))


@pytest.mark.parametrize("n_inputs", [2, 3, 5])
def test_experiments_are_orthogonal_at_each_line(n_inputs):
    rms = np.arange(1.0, n_inputs + 1)
    X = multisine(200, rms=rms, n_realizations=2, n_inputs=n_inputs, dt=DT, random_state=3)
    assert list(X.columns) == ["drive", *(f"drive_{i}" for i in range(1, n_inputs))]
    parts = np.array(records(X))
    np.testing.assert_allclose(parts.std(axis=1), np.tile(rms, (2 * n_inputs, 1)), rtol=1e-12)
    assert X.index.unique("record")[1] == "realization0_experiment1"
    spectra = np.fft.rfft(parts, axis=1)[:, 1:100]
    for group in (spectra[:n_inputs], spectra[n_inputs:]):
        matrix = group.transpose(1, 0, 2) / rms
        gram = matrix.conj().transpose(0, 2, 1) @ matrix
        expected = np.abs(gram[0, 0, 0]) * np.eye(n_inputs)
        np.testing.assert_allclose(gram, np.broadcast_to(expected, gram.shape), atol=1e-8)


def test_noise_is_gaussian_and_stays_in_its_band():
    own = {"n_realizations": 40, "n_inputs": 2, "random_state": 0}
    X = band_limited_noise(2000, band=(50.0, 200.0), rms=[2.0, 0.1], dt=DT, **own)
    parts = np.array(records(X))
    np.testing.assert_allclose(parts.std(axis=1), np.tile([2.0, 0.1], (40, 1)), rtol=1e-12)
    power = np.abs(np.fft.rfft(parts, axis=1)) ** 2 / np.array([4.0, 0.01])
    inside = np.arange(1001) * 0.5
    inside = (inside >= 50.0) & (inside <= 200.0)
    assert power[:, ~inside].max() < 1e-16 * power.max()
    # the power of a line is exponentially distributed: its standard deviation equals its mean
    line = power[:, inside].ravel()
    assert line.std() / line.mean() == pytest.approx(1.0, abs=0.05)
    assert abs(np.corrcoef(parts.reshape(-1, 2).T)[0, 1]) < 0.05


@pytest.mark.parametrize("make", [multisine, band_limited_noise])
def test_the_seed_fixes_everything(make):
    np.testing.assert_array_equal(make(random_state=5), make(random_state=5))
    assert not np.allclose(make(random_state=5), make(random_state=6))


# ----------------------------------------------------------------------------------------- levels


def test_steps_rest_and_rise():
    u = values(steps([1.0, 3.0, -1.0], hold=[0.2, 0.3, 0.1], rise_time=0.1, dt=0.02))
    expected = [1.0] * 10 + [1.4, 1.8, 2.2, 2.6] + [3.0] * 15 + [2.2, 1.4, 0.6, -0.2] + [-1.0] * 5
    np.testing.assert_allclose(u, expected, atol=1e-12)


@settings(deadline=None, max_examples=40)
@given(st.integers(1, 7), st.sampled_from([-30.0, 1e-3]), st.floats(0.05, 1.0), st.booleans())
def test_reversal_curves_turn_where_they_should(n_curves, amplitude, share, both_sides):
    rate = share * abs(amplitude) / (n_curves * DT)
    X = first_order_reversal_curves(
        amplitude, n_curves, rate=rate, dt=DT, offset=amplitude, both_sides=both_sides
    )
    u = (values(X) - amplitude) / amplitude
    assert np.abs(np.diff(u)).max() <= share / n_curves * (1 + 1e-6)
    turns = u[1:-1][np.diff(np.sign(np.diff(u))) != 0]
    levels = 1.0 - 2.0 * np.arange(1, n_curves + 1) / n_curves
    up = np.column_stack([np.ones(n_curves), levels]).ravel()
    # after the last curve the mirrored ones go on from 1 down to -1, where they turn first
    expected = np.r_[up, 1.0, -up, -1.0] if both_sides else np.r_[up, 1.0]
    np.testing.assert_allclose(np.r_[turns, u[-1]], expected, atol=1e-9)


# --------------------------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("call", "parameter"),
    [
        (lambda: triangle(frequency=500.0, dt=DT), "frequency"),
        (lambda: sine(frequency=[1.0, 700.0], dt=DT), "frequency"),
        (lambda: sine(frequency=0.0), "frequency"),
        (lambda: triangle(n_cycles=1.5), "n_cycles"),
        (lambda: triangle(n_cycles=[]), "n_cycles"),
        (lambda: triangle([1.0, 2.0], [1.0, 2.0, 3.0]), "amplitude"),
        (lambda: triangle(np.nan), "amplitude"),
        (lambda: triangle(dt=0.0), "dt"),
        (lambda: triangle(dt=[1e-3, 1e-2]), "dt"),
        (lambda: sine(offset="1 V"), "offset"),
        (lambda: swept_sine(0.1, 800.0, dt=DT), "stop_frequency"),
        (lambda: swept_sine(0.0, 80.0, spacing="logarithmic"), "start_frequency"),
        (lambda: swept_sine(1.0, 80.0, spacing="octaves"), "spacing"),
        (lambda: decaying_sine(decay=-1.0), "decay"),
        (lambda: decaying_sine(frequency=5e3), "frequency"),
        (lambda: multisine(band=(1.0, 500.0), dt=DT), "band"),
        (lambda: multisine(band=(100.1, 100.2), dt=DT), "band"),
        (lambda: multisine(100, band=(20.0, 20.0), grid="odd", dt=DT), "band"),
        (lambda: multisine(band=(50.0, 20.0)), "band"),
        (lambda: multisine(grid="even"), "grid"),
        (lambda: multisine(grid="random_odd", group_size=1), "group_size"),
        (lambda: multisine(10, amplitude=[1.0, 2.0]), "amplitude"),
        (lambda: multisine(10, amplitude=np.zeros(4)), "amplitude"),
        (lambda: multisine(n_samples=100.0), "n_samples"),
        (lambda: multisine(n_realizations=0), "n_realizations"),
        (lambda: multisine(n_inputs=2, rms=[1.0, 2.0, 3.0]), "rms"),
        (lambda: band_limited_noise(band=(0.0, 1e4)), "band"),
        (lambda: band_limited_noise(2), "n_samples"),
        (lambda: steps(hold=1e-5), "hold"),
        (lambda: steps([0.0, 1.0], hold=[1.0, 1.0, 1.0]), "hold"),
        (lambda: steps(rise_time=-1.0), "rise_time"),
        (lambda: first_order_reversal_curves(0.0), "amplitude"),
        (lambda: first_order_reversal_curves(rate=1e4), "rate"),
    ],
)
def test_refusals(call, parameter):
    with pytest.raises(ValueError, match=rf"The '{parameter}' parameter of \w+ must be .* Got "):
        call()


@given(
    low=st.floats(-100.0, 100.0),
    span=st.floats(1e-3, 1e3),
    n=st.integers(64, 700),
    slowness=st.floats(0.0, 3.5),
)
@settings(max_examples=15, deadline=None)
def test_the_catalogue_keeps_the_limits(low, span, n, slowness):
    fastest = 20.0 * span / (n * DT) / np.exp(slowness)
    limits = (low, low + span)
    for u in signals_within(limits, n * DT, DT, rate_limit=fastest).values():
        assert len(u) == n
        assert u.min() >= limits[0]
        assert u.max() <= limits[1]
        assert np.abs(np.diff(u)).max() <= fastest * DT * (1.0 + 1e-6)


def test_the_catalogue_has_every_form_over_the_whole_range():
    signals = signals_within((0.0, 10.0), 2.0, DT)
    forms = ("sine", "triangle", "ever", "decaying", "multisine", "sweep", "steps", "reversal")
    for form in forms:
        own = [u for name, u in signals.items() if form in name]
        assert max(np.ptp(u) for u in own) > 8.0, form
        assert min(np.ptp(u) for u in own) < 4.0, form


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"drive_limits": (1.0, 1.0)}, "drive_limits"),
        ({"drive_limits": (0.0, np.inf)}, "drive_limits"),
        ({"drive_limits": (0.0, 1.0, 2.0)}, "drive_limits"),
        ({"duration": 63 * DT}, "duration"),
        ({"rate_limit": -1.0}, "rate_limit"),
        ({"rate_limit": 0.1}, "rate_limit"),
    ],
)
def test_the_catalogue_refuses(options, name):
    options = {"drive_limits": (0.0, 1.0), "duration": 1.0, "dt": DT} | options
    with pytest.raises(ValueError, match=f"The '{name}' parameter of signals_within"):
        signals_within(**options)
