"""The noise floor: from repetitions, else from a black box that must not see noise as structure."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from threadpoolctl import threadpool_limits

from skhyst.diagnosis._noise import black_box_gain, repeatability
from skhyst.optimize import RecordData

NOISE = 0.03


def response(u, rng, noise=NOISE):
    return u + 0.3 * np.tanh(3.0 * u) + noise * rng.standard_normal(u.size)


def wave(n, period, rng, count=5):
    """Draw a periodic drive without a shorter period inside."""
    phases = rng.uniform(0.0, 2.0 * np.pi, count)
    cycles = np.outer(np.arange(n), np.arange(1, count + 1)) / period
    return np.sin(2.0 * np.pi * cycles + phases) @ (1.0 / np.arange(1, count + 1))


def smooth(n, rng):
    return np.convolve(rng.standard_normal(n + 40), np.hanning(41), mode="valid")


@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 2**32 - 1), noise=st.sampled_from([1e-9, 1e-3, 0.1, 1e6]))
def test_repeated_records_give_the_noise(seed, noise):
    rng = np.random.default_rng(seed)
    u = smooth(3000, rng)
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


def test_a_constant_drive_is_no_reason_to_fail():
    rng = np.random.default_rng(9004)
    found = repeatability([RecordData(np.ones(600), rng.standard_normal(600), 1e-3)])
    assert found is None or np.isfinite(found)


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
        error, p = black_box_gain(records, residuals, predictions, rng)
    return error, p, np.sqrt(np.mean(np.square(residuals)))


def test_white_noise_is_not_structure():
    for seed in range(9000, 9008):
        error, p, rms = judged(lambda u, rng: NOISE * rng.standard_normal(u.size), seed)
        assert p > 0.01
        assert error == pytest.approx(rms, rel=0.02)
        assert error <= rms * (1.0 + 1e-12)


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

    error, p, rms = judged(residual, 9000)
    assert p < 1e-3
    assert error < 0.7 * rms
    assert error > 0.95 * NOISE  # nothing predicts noise


@settings(deadline=None, max_examples=3)
@given(exponent=st.integers(-20, 20))
def test_units_of_the_response_do_not_matter(exponent):
    scale = 2.0**exponent
    plain = judged(lambda u, rng: np.sin(u) + rng.standard_normal(u.size), 9001, 2, 600)
    other = judged(lambda u, rng: scale * (np.sin(u) + rng.standard_normal(u.size)), 9001, 2, 600)
    assert other[0] / scale == pytest.approx(plain[0], rel=0.02)


def test_rows_without_a_residual_are_left_out():
    rng = np.random.default_rng(9002)
    u = smooth(1500, rng)
    r = NOISE * rng.standard_normal(1500)
    r[:300] = np.nan
    p = np.where(np.isfinite(r), u, np.nan)
    with threadpool_limits(limits=1):
        error, value = black_box_gain([RecordData(u, u, 1e-3)], [r], [p], rng)
    assert error == pytest.approx(np.sqrt(np.nanmean(r**2)), rel=0.1)
    assert 0.0 <= value <= 1.0


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
        error, p = black_box_gain(records, residuals, [record.u for record in records], rng)
    assert p < 1e-6
    assert error < 0.02
