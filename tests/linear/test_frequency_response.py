"""Frequency responses: the definitions, the promised uncertainties, what is refused."""

import pickle

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recordings import load_piezo_fsm
from scipy import signal
from scipy.stats import chi2

from skhyst.exceptions import RecordError
from skhyst.linear import FrequencyResponse, frequency_response
from skhyst.records import stack_records

TAPS = np.array([0.3, 1.0, -0.5, 0.2])
SEEDS = 200


def fir(u, taps=TAPS):
    return signal.lfilter(taps, 1.0, u)


def true_response(frequency, dt=1.0, taps=TAPS):
    return signal.freqz(taps, worN=2 * np.pi * frequency * dt)[1]


def noise_recording(rng, n=4096, noise=0.5, n_inputs=1):
    """White drives through FIR filters, white noise in the response."""
    u = rng.normal(size=(n, n_inputs))
    taps = [np.roll(TAPS, i) for i in range(n_inputs)]
    y = sum(fir(u[:, i], taps[i]) for i in range(n_inputs)) + noise * rng.normal(size=n)
    return u, y, taps


def multisine(rng, period, lines):
    """A period of a random-phase multisine of unit power."""
    spectrum = np.zeros(period // 2 + 1, dtype=complex)
    spectrum[lines] = np.exp(2j * np.pi * rng.random(len(lines)))
    u = np.fft.irfft(spectrum, period)
    return u / u.std()


def through(u, taps=TAPS):
    """Periodic steady state of an FIR filter."""
    return np.fft.irfft(np.fft.rfft(u) * np.fft.rfft(taps, u.size), u.size)


def inside(found, true, level=0.95):
    return np.abs(found.response - true) < found.confidence_radius(level)


# ------------------------------------------------------------------------------- the definitions


@pytest.mark.parametrize("options", [{}, {"overlap": 0.75, "window": "hamming"}, {"overlap": 0.0}])
def test_welch_is_that_of_scipy(options):
    rng = np.random.default_rng(0)
    u = signal.lfilter([1.0], [1.0, -0.7], rng.normal(size=3000)) + 3.0
    y = fir(u) + 0.3 * rng.normal(size=u.size) - 7.0
    dt, length = 1e-3, 250
    known = {
        "fs": 1 / dt,
        "window": options.get("window", "hann"),
        "nperseg": length,
        "noverlap": round(length * options.get("overlap", 0.5)),
    }
    frequency, uy = signal.csd(u, y, **known)
    uu, yy = signal.welch(u, **known)[1], signal.welch(y, **known)[1]
    coherence = signal.coherence(u, y, **known)[1]
    inner = slice(1, -1)  # without zero and half the sampling rate
    expected = {"h1": uy / uu, "h2": yy / uy.conj(), "hv": np.sqrt(yy / uu) * uy / np.abs(uy)}
    for method, true in expected.items():
        found = frequency_response(
            u[:, None], y, method=method, segment_length=length, dt=dt, **options
        )
        np.testing.assert_allclose(found.frequency, frequency[inner], rtol=1e-12)
        np.testing.assert_allclose(found.response[:, 0], true[inner], rtol=1e-12)
        np.testing.assert_allclose(found.coherence, coherence[inner], rtol=1e-12)


def test_records_are_averaged_and_never_joined():
    rng = np.random.default_rng(1)
    pairs = [(u[:, 0], y) for u, y, _ in (noise_recording(rng, n) for n in (900, 1500))]
    X, y = stack_records(pairs, dt=0.1)
    found = frequency_response(X, y, method="h1", segment_length=100)
    sums = [0.0, 0.0]
    for u, response in pairs:
        count = (len(u) - 100) // 50 + 1
        sums[0] += count * signal.csd(u, response, 10.0, nperseg=100)[1]
        sums[1] += count * signal.welch(u, 10.0, nperseg=100)[1]
    np.testing.assert_allclose(found.response[:, 0], (sums[0] / sums[1])[1:-1], rtol=1e-12)
    assert found.dt == pytest.approx(0.1)


def test_several_inputs_are_told_apart():
    rng = np.random.default_rng(2)
    u, y, taps = noise_recording(rng, 40_000, noise=0.0, n_inputs=3)
    u[:, 1] += 0.8 * u[:, 0]  # correlated drives
    y = sum(fir(u[:, i], taps[i]) for i in range(3))
    found = frequency_response(u, y, method="h1", segment_length=512)
    for i in range(3):
        true = true_response(found.frequency, taps=taps[i])
        assert np.max(np.abs(found.response[:, i] - true)) < 0.02
    assert found.coherence.min() > 0.998
    alone = frequency_response(u, y, method="h1", segment_length=512, inputs=[2, 0])
    assert alone.input_names == ("input2", "input0")
    assert alone.coherence.max() < found.coherence.min()


def test_whole_periods_are_exact():
    rng = np.random.default_rng(3)
    period, lines = 120, np.arange(2, 50, 3)
    parts = [multisine(rng, period, lines) for _ in range(2)]
    pairs = [(np.tile(u, 3), np.tile(through(u), 3)) for u in parts]
    for _, y in pairs:
        y[:period] += np.exp(-np.arange(period) / 20.0)  # a transient, in the first period
    found = frequency_response(*stack_records(pairs, dt=0.01))
    np.testing.assert_allclose(found.frequency, lines / (period * 0.01), rtol=1e-12)
    true = true_response(found.frequency, 0.01)
    np.testing.assert_allclose(found.response[:, 0], true, rtol=1e-11)
    assert found.coherence is None


@settings(max_examples=20, deadline=None)
@given(
    st.floats(-90, 90), st.floats(-90, 90), st.sampled_from(["h1", "h2", "hv", "periodic", "auto"])
)
def test_units_do_not_matter(drive_power, response_power, method):
    rng = np.random.default_rng(4)
    u = np.tile(multisine(rng, 100, np.arange(1, 40)), 5)
    y = fir(u) + 0.1 * rng.normal(size=u.size)
    plain = frequency_response(u[:, None], y, method=method)
    scales = 10.0**drive_power, 10.0**response_power
    other = frequency_response(scales[0] * u[:, None], scales[1] * y, method=method)
    assert other.frequency.size == plain.frequency.size
    for name in ("response", "std"):
        expected = getattr(plain, name) / scales[0] * scales[1]
        np.testing.assert_allclose(
            getattr(other, name), expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max()
        )


# ------------------------------------------------------------------------- promised uncertainties


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "n_inputs", "overlap", "seeds"),
    [
        ("h1", 1, 0.5, SEEDS),
        ("h1", 1, 0.75, SEEDS // 2),
        ("h2", 1, 0.5, SEEDS // 2),
        ("hv", 1, 0.5, SEEDS // 2),
        ("h1", 2, 0.5, SEEDS // 2),
    ],
)
def test_welch_uncertainty_covers(method, n_inputs, overlap, seeds):
    """Circles of 95 % hold the truth in 95 % of recordings; h2 and hv with their own noise."""
    shares, squares, variances = [], 0.0, 0.0
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        u, y, taps = noise_recording(rng, 3000, 0.0 if method != "h1" else 0.4, n_inputs)
        measured = u
        if method == "h2":
            measured = u + 0.3 * rng.normal(size=u.shape)
        elif method == "hv":  # the same ratio of noise to signal in both, at every line
            measured = u + 0.3 * rng.normal(size=u.shape)
            y = y + 0.3 * fir(rng.normal(size=y.size))
        found = frequency_response(measured, y, method=method, segment_length=100, overlap=overlap)
        true = np.stack([true_response(found.frequency, taps=t) for t in taps], axis=1)
        shares.append(np.mean(inside(found, true)))
        squares += np.mean(np.abs(found.response - true) ** 2 / np.abs(true) ** 2)
        variances += np.mean(found.std**2 / np.abs(true) ** 2)
    assert 0.93 < np.mean(shares) < 0.97
    assert variances / squares == pytest.approx(1.0, abs=0.06)


@pytest.mark.slow
@pytest.mark.parametrize(("n_inputs", "drive_noise"), [(1, 0.02), (2, 0.0)])
def test_periodic_noise_uncertainty_covers(n_inputs, drive_noise):
    """As many experiments as inputs, periods scatter: chi-square and F laws hold line by line."""
    period, lines, periods, noise = 64, np.arange(1, 25), 5, 0.3
    covered, in_interval = [], []
    for seed in range(SEEDS):
        rng = np.random.default_rng(seed)
        pairs = []
        for _ in range(n_inputs):
            u = np.stack([multisine(rng, period, lines) for _ in range(n_inputs)])
            y = np.tile(sum(through(u[i], (i + 1) * TAPS) for i in range(n_inputs)), periods)
            u = np.tile(u, periods).T
            measured = u + drive_noise * rng.normal(size=u.shape)
            pairs.append((measured, y + noise * rng.normal(size=y.size)))
        X, y = stack_records(pairs)
        found = frequency_response(X, y, period=period, transient_periods=0)
        assert found.distortion_std is None
        np.testing.assert_array_equal(found.std, found.noise_std)
        assert found.degrees_of_freedom == n_inputs * (periods - 1)
        base = true_response(found.frequency)[:, None]
        true = base * np.arange(1, n_inputs + 1)
        covered.append(np.mean(inside(found, true)))
        if n_inputs == 1:  # |U|^2 of unit power over the lines, P^2/(2 n_lines); noise P sigma^2
            power = 2.0 * len(lines) / period
            variance = (noise**2 + (drive_noise * np.abs(base)) ** 2) * power / periods
            ratio = 2 * found.degrees_of_freedom * found.noise_std**2 / variance
            low, high = chi2.ppf([0.025, 0.975], 2 * found.degrees_of_freedom)
            in_interval.append(np.mean((ratio > low) & (ratio < high)))
    assert 0.93 < np.mean(covered) < 0.97
    if in_interval:
        assert 0.93 < np.mean(in_interval) < 0.97


def hammerstein(rng, period, lines, a=0.2, cubic=True):
    u = multisine(rng, period, lines)
    return u, through(u + a * u**3 if cubic else u)


def realizations(rng, count, periods, noise, **options):
    period, lines = 128, np.arange(1, 41)
    pairs = [hammerstein(rng, period, lines, **options) for _ in range(count)]
    u, y = (
        np.concatenate([np.tile(part, periods) for part in parts])
        for parts in zip(*pairs, strict=True)
    )
    index = pd.MultiIndex.from_product(
        [range(count), np.arange(0.0, periods * period)], names=["record", "time"]
    )
    return pd.DataFrame({"drive": u}, index=index), y + noise * rng.normal(size=y.size)


def test_distortion_is_that_of_many_realizations():
    """Static cubic, then an FIR filter: levels against 1500 simulated realisations."""
    rng = np.random.default_rng(5)
    period, lines = 128, np.arange(1, 41)
    direct = np.empty((1500, lines.size), dtype=complex)
    for row in direct:
        u, y = hammerstein(rng, period, lines)
        row[:] = (np.fft.rfft(y) / np.where(np.fft.rfft(u) == 0, 1, np.fft.rfft(u)))[lines]
    best, level = direct.mean(axis=0), direct.std(axis=0)
    assert np.max(np.abs(best / true_response(lines / period) - 1.6)) < 0.1  # 1 + 3 a

    covered, distortion, noise = [], 0.0, 0.0
    for _ in range(SEEDS // 2):
        X, y = realizations(rng, 8, 2, 0.2)
        found = frequency_response(X, y, period=period, transient_periods=0)
        covered.append(np.mean(inside(found, best[:, None])))
        distortion = distortion + found.distortion_std[:, 0] ** 2 / (SEEDS // 2)
        noise = noise + found.noise_std[:, 0] ** 2 / (SEEDS // 2)
    assert 0.93 < np.mean(covered) < 0.97
    assert np.sqrt(distortion / level**2).mean() == pytest.approx(1.0, abs=0.04)
    power = 2.0 * lines.size / period
    assert np.sqrt(noise.mean()) == pytest.approx(0.2 * np.sqrt(power / 16), rel=0.03)


def test_a_linear_plant_has_no_distortion():
    """Nor where some recordings are noisier than others."""
    rng = np.random.default_rng(6)
    noise_levels = np.repeat(np.linspace(0.1, 0.3, 8), 4 * 128)
    total, noise, none = 0.0, 0.0, []
    for _ in range(30):
        X, y = realizations(rng, 8, 4, noise_levels, cubic=False)
        found = frequency_response(X, y, period=128, transient_periods=0)
        total, noise = total + np.mean(found.std**2), noise + np.mean(found.noise_std**2)
        none.append(np.mean(found.distortion_std == 0.0))
    assert total / noise == pytest.approx(1.0, abs=0.05)
    assert 0.4 < np.mean(none) < 0.65  # half of the differences are negative


def test_orthogonal_experiments_and_their_distortion():
    """Two inputs: a cubic in the first makes distortion, told apart from noise."""
    rng = np.random.default_rng(7)
    period, lines = 128, np.arange(1, 41)
    pairs, quiet = [], []
    for _ in range(30):
        u = np.stack([multisine(rng, period, lines) for _ in range(2)])
        for sign in (1.0, -1.0):
            drives = np.stack([u[0], sign * u[1]], axis=1)
            y = through(u[0] + 0.2 * u[0] ** 3) + 2.0 * through(sign * u[1])
            pairs.append((np.tile(drives, (2, 1)), np.tile(y, 2)))
            quiet.append((np.tile(drives, (2, 1)), 3.0 * np.tile(through(sign * u[1]), 2)))
    found = frequency_response(*stack_records(pairs), period=period)
    assert found.degrees_of_freedom == 58
    assert found.noise_std is None  # one period is left after the transient
    steady = frequency_response(*stack_records(pairs), transient_periods=0)
    np.testing.assert_allclose(steady.distortion_std, steady.std * np.sqrt(30), rtol=1e-6)
    assert np.max(steady.noise_std) < 1e-9
    true = true_response(found.frequency)[:, None] * [1.6, 2.0]
    assert np.mean(inside(found, true)) > 0.85  # 1.6 holds for infinitely many lines
    linear = frequency_response(*stack_records(quiet), transient_periods=0)
    assert np.max(linear.distortion_std) < 1e-9


# ------------------------------------------------------------------------------ periods, records


@settings(max_examples=25, deadline=None)
@given(st.integers(12, 300), st.integers(2, 6), st.floats(0.0, 0.004), st.integers(0, 10**6))
def test_the_period_is_found(period, periods, noise, seed):
    rng = np.random.default_rng(seed)
    u = multisine(rng, period, np.arange(1, max(period // 4, 3)))
    drive = np.tile(u, periods + 1)[: periods * period + period // 3]
    drive = drive + noise * rng.normal(size=drive.size)
    found = frequency_response(drive[:, None], fir(drive), method="periodic")
    assert found.frequency[0] == pytest.approx(1.0 / period)


def test_smooth_drives_have_the_period_of_the_whole():
    t = np.arange(4000)
    for drive, period in (
        (np.sin(2 * np.pi * t / 800), 800),
        (np.sin(2 * np.pi * t / 100.5), 201),
        (signal.sawtooth(2 * np.pi * t / 500, 0.5), 500),
        (np.sin(2 * np.pi * t / 250) + 0.1 * np.sin(2 * np.pi * t / 1000), 1000),
    ):
        found = frequency_response(drive[:, None], 2.0 * drive)
        assert np.gcd.reduce(np.rint(found.frequency * period).astype(int)) >= 1
        np.testing.assert_allclose(found.frequency * period, np.rint(found.frequency * period))
        np.testing.assert_allclose(found.response, 2.0, rtol=1e-9)


def test_a_drive_without_a_period_is_averaged_in_segments():
    rng = np.random.default_rng(8)
    u, y, _ = noise_recording(rng)
    assert frequency_response(u, y).coherence is not None
    with pytest.raises(RecordError, match=r"must repeat after a common period"):
        frequency_response(u, y, method="periodic")


def test_the_same_drive_again_is_no_further_realization():
    """Not even when the recording starts elsewhere in the period."""
    rng = np.random.default_rng(9)
    u, y = hammerstein(rng, 128, np.arange(1, 41))
    pairs = []
    for start in (0, 0, 37, 90):
        noisy = np.tile(np.roll(y, -start), 3) + 0.1 * rng.normal(size=3 * 128)
        pairs.append((np.tile(np.roll(u, -start), 3), noisy))
    found = frequency_response(*stack_records(pairs))
    assert found.distortion_std is None
    assert found.degrees_of_freedom == 4 * 2 - 1
    one = (np.fft.rfft(y)[1:41] / np.fft.rfft(u)[1:41])[:, None]
    assert np.mean(inside(found, one)) > 0.85


def test_order_of_records_and_columns_does_not_matter():
    rng = np.random.default_rng(10)
    pairs = [(rng.normal(size=(400, 2)), rng.normal(size=400)) for _ in range(3)]
    a = frequency_response(*stack_records(pairs), method="h1", segment_length=50)
    turned = [(u[:, ::-1], y) for u, y in pairs[::-1]]
    b = frequency_response(*stack_records(turned), method="h1", segment_length=50)
    np.testing.assert_allclose(a.response, b.response[:, ::-1], rtol=1e-9)
    np.testing.assert_allclose(a.std, b.std[:, ::-1], rtol=1e-9)


# --------------------------------------------------------------------------------- what it does


def given_response():
    rng = np.random.default_rng(11)
    frequency = np.array([0.0, 1.0, 2.0, 5.0])
    g = rng.normal(size=(4, 2)) + 1j * rng.normal(size=(4, 2))
    return FrequencyResponse(
        frequency, g, 0.1 * np.abs(g), None, 0.3 * np.abs(g), np.full(4, 0.9), ("a", "b")
    )


def test_delay_and_integration():
    given_one = given_response()
    omega = 2 * np.pi * given_one.frequency[:, None]
    back = given_one.compensate_delay([0.1, 0.3])
    expected = given_one.response * np.exp(1j * omega * [0.1, 0.3])
    np.testing.assert_allclose(back.response, expected)
    np.testing.assert_allclose(back.std, given_one.std)
    twice = given_one.integrate(2)
    np.testing.assert_array_equal(twice.frequency, [1.0, 2.0, 5.0])
    np.testing.assert_allclose(twice.response, -(given_one.response / omega.clip(1e-9) ** 2)[1:])
    np.testing.assert_allclose(
        twice.distortion_std, (given_one.distortion_std / omega.clip(1) ** 2)[1:]
    )
    np.testing.assert_allclose(twice.integrate(-2).response, given_one.response[1:])
    assert twice.coherence.shape == (3,)
    assert twice.noise_std is None


def test_restrict_frame_pickle():
    given_one = given_response()
    kept = given_one.restrict(1.0, 2.0)
    np.testing.assert_array_equal(kept.frequency, [1.0, 2.0])
    np.testing.assert_array_equal(kept.std, given_one.std[1:3])
    frame = given_one.to_frame()
    assert list(frame.columns) == [
        *("response", "magnitude", "phase", "std", "distortion_std", "coherence")
    ]
    np.testing.assert_allclose(frame.loc["b", "magnitude"], np.abs(given_one.response[:, 1]))
    again = pickle.loads(pickle.dumps(given_one))
    np.testing.assert_array_equal(again.response, given_one.response)
    with pytest.raises(ValueError, match=r"enclose a line between 0 and 5 Hz"):
        given_one.restrict(2.5, 3.0)
    assert FrequencyResponse([1.0], [1j]).confidence_radius() is None


# ------------------------------------------------------------------------------ what it refuses


def test_broken_responses_are_refused():
    with pytest.raises(ValueError, match=r"one-dimensional, strictly increasing"):
        FrequencyResponse([2.0, 1.0], [1.0, 1.0])
    with pytest.raises(ValueError, match=r"'std' parameter .* of shape \(2, 1\)"):
        FrequencyResponse([1.0, 2.0], [1.0, 1.0], [1.0])
    with pytest.raises(ValueError, match=r"1 value\(s\) not finite"):
        FrequencyResponse([1.0, 2.0], [1.0, np.nan])
    for call, message in (
        (lambda g: g.integrate(0.5), "'order' parameter"),
        (lambda g: g.compensate_delay([1, 2, 3]), "one for each of 2 input"),
    ):
        with pytest.raises(ValueError, match=message):
            call(given_response())


U = np.random.default_rng(12).normal(size=(400, 2))
Y = U @ [1.0, 2.0]
TWICE = np.vstack([U[:100], U[:100]])


@pytest.mark.parametrize(
    ("X", "y", "options", "message"),
    [
        (np.where(U > 3, np.nan, U) * [[np.nan, 1.0]], Y, {}, "NaN"),
        (U * [1.0, 0.0] + 20.0, Y, {}, r"constant 20 in column 'input1'"),
        (U, 0.0 * Y, {}, r"'y' parameter .* must vary"),
        (U[:, [0, 0]], Y, {"method": "h1"}, "linearly independent"),
        (U, Y, {"method": "h2"}, "'h1' or 'periodic' for several"),
        (U, Y, {"method": "h3"}, "'method' parameter"),
        (U, Y, {"segment_length": 401}, "401 samples. Got 400 samples"),
        (U, Y, {"segment_length": 400}, "more segments than inputs"),
        (U, Y, {"segment_length": 40, "window": np.ones(39)}, "'window' parameter"),
        (U, Y, {"inputs": "voltage"}, r"name \(\['input0', 'input1'\]\)"),
        (U, Y, {"inputs": [0, 0]}, "none twice"),
        (U, Y, {"inputs": []}, "at least one column"),
        (U, Y, {"overlap": 1.0}, "'overlap' parameter"),
        (U[:, :1], Y, {"period": 90}, "repeat after the 'period'"),
        (TWICE, Y[:200], {"period": 100, "transient_periods": 2}, r"\+ 1 = 3 periods of 100"),
        (TWICE, Y[:200], {"period": 100}, "as many records with different drives as inputs, 2"),
        (U, Y[:-1], {}, "inconsistent numbers"),
    ],
)
def test_what_it_refuses(X, y, options, message):
    with pytest.raises(ValueError, match=message):
        frequency_response(X, y, **options)


def test_records_are_checked():
    time = np.cumsum(np.random.default_rng(13).random(400) + 0.5)
    with pytest.raises(RecordError, match=r"sampling must be even|at least two samples"):
        frequency_response(pd.DataFrame(U, index=time), Y)
    X, y = stack_records([(U, Y), (U[:30], Y[:30])], labels=["long", "short"])
    with pytest.raises(RecordError, match=r"Got 30 samples in record 'short'"):
        frequency_response(X, y, segment_length=50)


# ------------------------------------------------------------------------------- a measured plant


@pytest.mark.slow
@pytest.mark.needs_recordings("piezo_fsm")
def test_a_measured_mirror_grows_softer():
    """Three piezo stacks: the first resonance falls with amplitude, far beyond its errors."""
    found = {}
    for level in (100, 300):
        X, Y = load_piezo_fsm(level)
        found[level] = frequency_response(X, Y["y0"], transient_periods=0)
        assert found[level].frequency.size == 3839
        np.testing.assert_allclose(found[level].frequency, np.arange(1, 3840) * 6400 / 8192)
    near = {level: g.restrict(600.0, 660.0) for level, g in found.items()}
    peaks = [g.frequency[np.argmax(np.abs(g.response[:, 0]))] for g in near.values()]
    assert 2.0 < peaks[0] - peaks[1] < 10.0
    change = np.abs(near[100].response - near[300].response)
    error = np.hypot(near[100].std, near[300].std)
    assert np.sqrt(np.mean(change**2) / np.mean(error**2)) > 5.0
    assert (
        np.sqrt(np.mean(near[300].distortion_std ** 2) / np.mean(near[300].noise_std ** 2)) > 10.0
    )
