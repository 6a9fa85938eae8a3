"""The noise floor: from repetitions, else from a black box that must not see noise as structure."""

import numpy as np
import pytest
import search_steps
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter
from threadpoolctl import threadpool_limits

from skhyst.diagnosis._structure import by_shifted_drive, repeatability
from skhyst.diagnosis._verdict import judge_residual
from skhyst.hysteresis import PrandtlIshlinskiiOperator
from skhyst.optimize import RecordData
from skhyst.records import _periods, repeats

NOISE = 0.03


def response(u, rng, noise=NOISE):
    return u + 0.3 * np.tanh(3.0 * u) + noise * rng.standard_normal(u.size)


def wave(n, period, rng, count=5):
    """Draw a periodic drive without a shorter period inside."""
    phases = rng.uniform(0.0, 2.0 * np.pi, count)
    cycles = np.outer(np.arange(n), np.arange(1, count + 1)) / period
    return np.sin(2.0 * np.pi * cycles + phases) @ (1.0 / np.arange(1, count + 1))


def smooth(n, rng, width=41):
    return np.convolve(rng.standard_normal(n + width - 1), np.hanning(width), mode="valid")


@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 2**32 - 1), noise=st.sampled_from([1e-9, 1e-3, 0.1, 1e6]))
def test_repeated_records_give_the_noise(seed, noise):
    rng = np.random.default_rng(seed)
    u = smooth(8000, rng)  # the bound is six standard deviations: Hypothesis draws many seeds
    records = [RecordData(u, response(u, rng, noise), 1e-3) for _ in range(2)]
    assert repeatability(records) == pytest.approx(noise, rel=0.06)


@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 2**32 - 1), period=st.integers(40, 700))
def test_repeated_periods_give_the_noise(seed, period):
    rng = np.random.default_rng(seed)
    u = wave(6000, period, rng)
    assert repeatability([RecordData(u, response(u, rng), 1e-3)]) == pytest.approx(NOISE, rel=0.08)


def test_the_first_period_does_not_count():
    """It still depends on how the record began."""
    rng = np.random.default_rng(9000)
    u = wave(3000, 500, rng)
    y = response(u, rng)
    y[:500] += np.linspace(5.0, 0.0, 500)
    assert repeatability([RecordData(u, y, 1e-3)]) == pytest.approx(NOISE, rel=0.08)


def test_repetitions_are_found_among_other_records():
    rng = np.random.default_rng(9001)
    u, other = smooth(4000, rng), smooth(4000, rng)
    records = [RecordData(v, response(v, rng), 1e-3) for v in (u, other, u)]
    assert repeatability(records) == pytest.approx(NOISE, rel=0.06)


def test_no_repetition_gives_none():
    rng = np.random.default_rng(9002)
    records = [RecordData(u, response(u, rng), 1e-3) for u in (smooth(900, rng), smooth(900, rng))]
    assert repeatability(records) is None
    sweep = np.sin(2.0 * np.pi * (0.001 + 1e-6 * np.arange(3000)) * np.arange(3000))
    assert repeatability([RecordData(sweep, response(sweep, rng), 1e-3)]) is None


def test_two_periods_are_too_few():
    rng = np.random.default_rng(9003)
    u = wave(1000, 500, rng)
    assert repeatability([RecordData(u, response(u, rng), 1e-3)]) is None


def test_a_resting_drive_repeats_nothing():
    """Neighbouring samples of a slow noise differ by less than the noise."""
    rng = np.random.default_rng(9004)
    rests = [RecordData(np.ones(600), np.cumsum(rng.standard_normal(600)), 1e-3) for _ in range(2)]
    assert repeatability(rests[:1]) is None
    assert repeatability(rests) is None
    step = np.r_[np.zeros(5), np.ones(595)]
    assert repeatability([RecordData(step, rests[0].y, 1e-3)]) is None


@pytest.mark.parametrize("across", ["records", "periods"])
def test_a_slow_drift_between_repetitions_is_no_noise(across):
    rng = np.random.default_rng(9005)
    u = wave(6000, 500, rng)
    part = np.linspace(0.0, 1.0, u.size)
    drift = 30.0 * NOISE * np.log1p(20.0 * part)
    if across == "periods":
        records = [RecordData(u, response(u, rng) + drift, 1e-3)]
    else:
        v = smooth(u.size, rng)
        records = [RecordData(v, response(v, rng) + d, 1e-3) for d in (drift, 5.0 - part)]
    assert repeatability(records) == pytest.approx(NOISE, rel=0.1)


def test_a_different_memory_is_no_noise():
    """A hysteresis remembers it until the drive has been at both ends of its range."""
    rng = np.random.default_rng(9006)
    plays = PrandtlIshlinskiiOperator(
        np.array([0.0, 0.3, 0.6, 1.2]), np.array([0.5, 0.4, 0.4, 0.4])
    )
    growth = np.interp(np.arange(4000), [0, 2000, 4000], [0.1, 1.5, 0.5])
    u = growth * np.sin(np.linspace(0.0, 60.0, 4000))
    records = []
    for before in (-3.0, 3.0):
        y = plays.run(np.r_[before, u], 1.0)[0][1:]
        records.append(RecordData(u, y + NOISE * rng.standard_normal(u.size), 1e-3))
    assert np.std(records[0].y - records[1].y) > 3.0 * NOISE
    assert repeatability(records) == pytest.approx(NOISE, rel=0.08)


def test_what_settles_is_no_noise():
    rng = np.random.default_rng(9007)
    u = smooth(4000, rng)
    settles = np.exp(-np.arange(4000) / 100.0)
    records = [RecordData(u, response(u, rng) + a * settles, 1e-3) for a in (1.0, -1.0)]
    assert repeatability(records) == pytest.approx(NOISE, rel=0.1)


def test_few_lags_of_a_slow_drive_are_compared_at_all_samples(monkeypatch):
    """Every lag of a slow drive looks like a period from far: thousands would take long."""
    compared = []

    def counting(a, b):
        compared.append(len(a))
        return repeats(a, b)

    monkeypatch.setattr(_periods, "repeats", counting)
    rng = np.random.default_rng(9008)
    u = wave(40_000, 10_000, rng)
    found = repeatability([RecordData(u, response(u, rng), 1e-3)])
    assert found == pytest.approx(NOISE, rel=0.02)
    assert compared[-1] == 30_000
    assert len(compared) <= 3


# ------------------------------------------------------------------------------------ black box


def judged(residual, seed, n_records=4, n=1200):
    """Return what the black box achieves on ``residual(u, rng)`` of random records."""
    rng = np.random.default_rng(seed)
    records, residuals, predictions = [], [], []
    for _ in range(n_records):
        u = smooth(n, rng)
        r = residual(u, rng)
        records.append(RecordData(u, u + r, 1e-3))
        residuals.append(r)
        predictions.append(u)
    with threadpool_limits(limits=1):  # as within a search
        rms = np.sqrt(np.mean(np.square(residuals)))
        found = judge_residual(records, residuals, predictions, rng, search_steps.USUAL)
    return found, rms


def test_white_noise_is_not_structure():
    for seed in (9000, 9001):
        found, rms = judged(lambda u, rng: NOISE * rng.standard_normal(u.size), seed)
        assert found.verdict == "noise"
        assert found.ceiling == pytest.approx(rms)
        assert 0.95 * NOISE < found.floor <= rms


@pytest.mark.parametrize(
    "law",
    [
        lambda u: np.sin(2.0 * u),
        lambda u: np.gradient(u) * u,
        lambda u: np.sign(np.gradient(u)),
        lambda u: u - np.concatenate([np.full(8, u[0]), u[:-8]]),
    ],
    ids=["curve", "product", "direction", "lag"],
)
def test_what_the_drive_explains_is_structure(law):
    def residual(u, rng):
        part = law(u)
        return 3.0 * NOISE * part / part.std() + NOISE * rng.standard_normal(u.size)

    found, rms = judged(residual, 9000)
    assert found.structured
    assert found.p_value < 1e-3
    assert 0.95 * NOISE < found.ceiling < 0.7 * rms  # nothing predicts noise
    assert 0.9 * NOISE < found.floor < 1.3 * NOISE


@pytest.mark.slow
def test_units_of_the_response_do_not_matter():
    scale = 2.0**-13

    def judged_in(unit):
        def residual(u, rng):
            return unit * (np.sin(u) + rng.standard_normal(u.size))

        return judged(residual, 9001, 2, 600)[0]

    plain, other = judged_in(1.0), judged_in(scale)
    assert other.ceiling / scale == pytest.approx(plain.ceiling, rel=0.02)
    assert other.floor / scale == pytest.approx(plain.floor, rel=0.02)


def test_rows_without_a_residual_are_left_out():
    rng = np.random.default_rng(9002)
    u = smooth(1500, rng)
    r = NOISE * rng.standard_normal(1500)
    r[:300] = np.nan
    p = np.where(np.isfinite(r), u, np.nan)
    with threadpool_limits(limits=1):
        found = judge_residual([RecordData(u, u, 1e-3)], [r], [p], rng, search_steps.USUAL)
    assert found.ceiling == pytest.approx(np.sqrt(np.nanmean(r**2)), rel=0.1)
    assert 0.0 <= found.p_value <= 1.0


def test_records_of_very_different_length_and_size():
    """A curve of the drive is one curve, however far a record goes and however long it is."""
    rng = np.random.default_rng(9003)
    records, residuals = [], []
    for n, size in [(3000, 1.0), (200, 0.3), (900, 0.6), (40, 0.1)]:
        u = size * smooth(n, rng)
        r = 0.1 * np.sin(u) + 0.01 * rng.standard_normal(n)
        records.append(RecordData(u, u + r, 1e-3))
        residuals.append(r)
    with threadpool_limits(limits=1):
        found = judge_residual(
            records, residuals, [record.u for record in records], rng, search_steps.USUAL
        )
    assert found.p_value < 1e-6
    assert found.floor == pytest.approx(0.01, rel=0.05)
    # what the drive's past predicts; what the residual's own past does may be noise
    assert 0.01 < found.ceiling < 0.35 * np.std(np.concatenate(residuals))


def no_function_of_the_drive(u, rng):
    """Return signals that no model driven by ``u`` can give."""
    n = u.size
    chaos, state = np.empty(n), np.array([1.0, 1.0, 20.0])
    for k in range(n):
        for _ in range(4):
            x, y, z = state
            state = state + 0.005 * np.array(
                [10.0 * (y - x), x * (28.0 - z) - y, x * y - 8 / 3 * z]
            )
        chaos[k] = state[0]
    return {
        "chaos": chaos,
        "switching gain": u * np.where(np.cumsum(rng.random(n) < 0.005) % 2, 1.0, -1.0),
        "modulated gain": u * np.sin(0.013 * np.arange(n)),
    }


@pytest.mark.parametrize("name", no_function_of_the_drive(np.ones(1), np.random.default_rng(0)))
def test_what_the_drive_does_not_explain_is_structure_too(name):
    rng = np.random.default_rng(9010)
    u = smooth(4000, rng)
    part = no_function_of_the_drive(u, rng)[name]
    r = 2.0 * NOISE * part / part.std() + NOISE * rng.standard_normal(u.size)
    with threadpool_limits(limits=1):
        found = judge_residual([RecordData(u, u + r, 1e-3)], [r], [u], rng, search_steps.USUAL)
    assert found.structured
    assert not found.repeated
    assert found.share < 0.7
    assert NOISE * 0.95 < found.ceiling < 0.85 * np.std(r)
    assert found.floor <= 1.05 * NOISE


@pytest.mark.parametrize("law", ["white", "grows with the drive", "tiny colour"])
def test_noise_is_noise(law):
    for seed in (9020, 9021):
        rng = np.random.default_rng(seed)
        u = smooth(2000, rng)
        r = NOISE * rng.standard_normal(u.size)
        if law == "grows with the drive":
            r *= 0.3 + np.abs(u)
        elif law == "tiny colour":
            r += 0.1 * NOISE * np.sin(0.05 * np.arange(u.size))
        with threadpool_limits(limits=1):
            found = judge_residual([RecordData(u, u + r, 1e-3)], [r], [u], rng, search_steps.USUAL)
        assert found.verdict == "noise"
        assert found.ceiling == pytest.approx(np.sqrt(np.mean(r**2)), rel=0.05)


def coloured(law, rng, n):
    """Return noise of unit variance that hangs together."""
    if law == "flicker":
        gains = np.append(0.0, np.arange(1.0, n + 1.0) ** -0.5)
        noise = np.fft.irfft(np.fft.rfft(rng.standard_normal(2 * n)) * gains)[:n]
        return noise / noise.std()
    return lfilter([np.sqrt(1.0 - law**2)], [1.0, -law], rng.standard_normal(n + 200))[200:]


@pytest.mark.parametrize(
    "law", [*(pytest.param(own, marks=pytest.mark.slow) for own in (0.6, 0.97)), 0.9, "flicker"]
)
def test_coloured_noise_is_noise(law):
    """What has a past is no structure if it knows nothing of the drive.

    Of a correlation of 0.97 a sample its own past predicts more than of noise can be told.
    """
    rng = np.random.default_rng(9040)
    drives = [smooth(1500, rng, 301) for _ in range(4)]
    noise = [NOISE * coloured(law, rng, u.size) for u in drives]
    records = [RecordData(u, u + r, 1e-3) for u, r in zip(drives, noise, strict=True)]
    with threadpool_limits(limits=1):
        found = judge_residual(records, noise, drives, rng, search_steps.USUAL)
    assert found.verdict == ("undetermined" if law == 0.97 else "noise")
    assert found.ceiling == pytest.approx(np.sqrt(np.mean(np.square(noise))))
    assert found.floor < found.ceiling
    assert found.noise.law == ("power_law" if law == "flicker" else "autoregressive")


def test_slow_noise_in_a_short_record_is_no_structure():
    """Neighbours have it in common, and their drive too: that proves nothing."""
    for seed in (9060, 9061):
        rng = np.random.default_rng(seed)
        u, r = smooth(500, rng), NOISE * coloured(0.97, rng, 500)
        with threadpool_limits(limits=1):
            found = judge_residual([RecordData(u, u + r, 1e-3)], [r], [u], rng, search_steps.USUAL)
        assert not found.structured


@pytest.mark.slow
def test_between_noise_and_structure_a_short_record_cannot_tell():
    rng = np.random.default_rng(9061)
    u = smooth(500, rng)
    noise, found = NOISE * coloured(0.9, rng, u.size), []
    for size in np.geomspace(0.1, 10.0, 6):
        r = noise + size * NOISE * np.sin(2.0 * u)
        judgement = judge_residual([RecordData(u, u + r, 1e-3)], [r], [u], rng, search_steps.USUAL)
        found.append(judgement.verdict)
    order = ["noise", "undetermined", "unexplained"]
    assert found == sorted(found, key=order.index)
    assert (found[0], found[-1]) == ("noise", "unexplained")


@pytest.mark.parametrize("law", [0.9, "flicker"])
def test_what_the_drive_explains_stands_out_of_coloured_noise(law):
    rng = np.random.default_rng(9050)
    drives = [smooth(1500, rng) for _ in range(4)]
    noise = [NOISE * coloured(law, rng, u.size) for u in drives]
    left = [r + 1.5 * NOISE * np.sin(2.0 * u) for u, r in zip(drives, noise, strict=True)]
    records = [RecordData(u, u + r, 1e-3) for u, r in zip(drives, left, strict=True)]
    with threadpool_limits(limits=1):
        found = judge_residual(records, left, drives, rng, search_steps.USUAL)
    assert found.structured
    size = np.sqrt(np.mean(np.square(noise)))
    assert size < found.ceiling < 0.9 * np.sqrt(np.mean(np.square(left)))


@pytest.mark.slow
def test_repetitions_tell_coloured_noise_from_structure():
    rng = np.random.default_rng(9030)
    u = wave(8000, 500, rng)
    noise = np.convolve(rng.standard_normal(u.size + 19), np.full(20, 0.25), mode="valid")
    for structure in (0.0 * u, u**3 / np.std(u**3)):
        r = noise + structure
        found = judge_residual([RecordData(u, u + r, 1e-3)], [r], [u], rng, search_steps.USUAL)
        assert found.repeated
        assert found.structured == structure.any()
        assert found.verdict == ("unexplained" if structure.any() else "noise")
        assert found.ceiling == pytest.approx(noise.std(), rel=0.15)


def test_nothing_left_is_noise():
    u = smooth(500, np.random.default_rng(0))
    found = judge_residual(
        [RecordData(u, u, 1e-3)], [0.0 * u], [u], np.random.default_rng(0), search_steps.USUAL
    )
    assert (found.verdict, found.floor, found.ceiling) == ("noise", 0.0, 0.0)


# ----------------------------------------------------------------------- the drive shifted in time


def shifted(u, r):
    return by_shifted_drive([RecordData(u, u + r, 1e-3)], [r], [u])


def test_slow_noise_follows_the_drive_no_better_than_the_drive_shifted():
    """The level holds however slow noise and drive are."""
    p_values = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        u, r = np.cumsum(smooth(700, rng)), coloured(0.99, rng, 700)
        p_values.append(shifted(u, r).p_value)
    # three standard deviations of 60 draws
    assert np.mean(np.array(p_values) <= 0.1) <= 0.1 + 3.0 * np.sqrt(0.09 / 60)


def test_a_play_follows_the_drive_at_its_own_time():
    rng = np.random.default_rng(9100)
    u = smooth(2000, rng)
    play = PrandtlIshlinskiiOperator(np.array([0.5 * np.std(u)]), np.array([1.0])).run(u, 1.0)[0]
    trial = shifted(u, play + 0.5 * coloured(0.9, rng, u.size))
    assert trial.p_value < 0.01
    assert trial.share < 0.8


def test_one_sine_is_the_same_function_of_its_past_at_any_time():
    u = np.sin(2.0 * np.pi * np.arange(2000) / 250.0)
    rng = np.random.default_rng(9101)
    assert shifted(u, u**3 + 0.01 * rng.standard_normal(u.size)).p_value > 0.01


def test_a_resting_drive_has_no_shifts():
    assert shifted(np.ones(500), np.random.default_rng(0).standard_normal(500)) == (1.0, 1.0, None)


def test_a_short_record_has_no_shifts():
    u = np.arange(5.0)
    assert shifted(u, u**2) == (1.0, 1.0, None)
