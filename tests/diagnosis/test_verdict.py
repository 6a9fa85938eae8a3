"""Verdicts of searches on what is known: a smooth misfit is no coloured noise."""

import numpy as np
import pytest
from scipy.signal import lfilter

from skhyst.compose import Cascade
from skhyst.diagnosis import EffectSearchCV
from skhyst.diagnosis._verdict import _against_noise, _drive_period, noise_floor
from skhyst.linear import Gain, SecondOrderMode
from skhyst.noise import fit_noise
from skhyst.optimize import RecordData
from skhyst.records import stack_records
from skhyst.static import SmoothCurve

NOISE = 1e-3


def searched(model, u, clean, effects, **options):
    y = clean + NOISE * np.random.default_rng(0).normal(size=len(u))
    return EffectSearchCV(model, effects=effects, random_state=0, **options).fit(u[:, None], y)


def assert_unexplained(search, noise=NOISE):
    assert search.verdict_ == "unexplained", search.verdict_reason_
    assert 0.9 * noise < search.noise_floor_ < 1.3 * noise
    assert search.noise_floor_ <= search.noise_ceiling_ <= search.error_after_
    assert (search.ranking_["error_after"].dropna() >= search.noise_floor_).all()


def test_creep_after_one_step_is_no_noise():
    t = 0.2 * np.arange(1000)
    after = np.clip(t - 20.0, 0.0, None)
    u = np.where(t > 20.0, 1.0, 0.0)
    search = searched(Gain(dt=0.2), u, u + 0.2 * np.log1p(after / 0.5), ["offset"])
    assert_unexplained(search)


def test_a_gain_that_steps_is_no_noise():
    n = np.arange(1500)
    u = np.sin(2.0 * np.pi * n / 210.0) + 0.5 * np.sin(2.0 * np.pi * n / 97.0)
    gain = np.where(n > 700, 1.0, 1.03)
    search = searched(Gain(), u, gain * u, ["offset"])
    assert_unexplained(search)


def test_a_cubic_spring_is_no_noise():
    """Its restoring force grows with the cube of the motion: simulated in ten steps a sample."""
    n, dt, position, speed = 1500, 0.02, 0.0, 0.0
    u = np.sin(2.0 * np.pi * np.arange(n) / 300.0) * np.linspace(0.2, 1.0, n)
    y = np.empty(n)
    for k in range(n):
        y[k] = position
        for _ in range(10):
            speed += 0.1 * dt * (100.0 * (u[k] - position - 0.5 * position**3) - 4.0 * speed)
            position += 0.1 * dt * speed
    search = searched(SecondOrderMode(dt=dt), u, y, ["offset"])
    assert_unexplained(search)


@pytest.mark.parametrize(("law", "slow"), [("white", 10.0), ("autoregressive", 1.0)])
def test_noise_on_an_exact_model_is_noise(law, slow):
    """Also where it is slow for the drive, but short for the record."""
    rng = np.random.default_rng(1)
    noise = NOISE * rng.normal(size=1500)
    for k in range(1, 1500) if law == "autoregressive" else ():
        noise[k] = 0.9 * noise[k - 1] + np.sqrt(0.19) * noise[k]
    u = np.sin(np.arange(1500) / 4.0 / slow) + 0.3 * np.sin(np.arange(1500) / 2.3 / slow)
    search = EffectSearchCV(Gain(), effects=["offset"], random_state=0).fit(u[:, None], u + noise)
    assert (search.effects_, search.verdict_) == ([], "noise")
    assert search.noise_model_.law == law
    assert search.noise_floor_ <= 1.02 * np.std(noise)
    assert search.noise_ceiling_ >= 0.98 * np.std(noise)


def test_a_floor_is_known_before_any_model():
    """Of the response itself: what is smooth in it takes no part."""
    rng = np.random.default_rng(2)
    y = np.sin(np.arange(3000) / 40.0) + NOISE * rng.normal(size=3000)
    assert noise_floor([y], [y]) == pytest.approx(NOISE, rel=0.05)
    assert noise_floor([y], [y], scatter=0.1 * NOISE) == 0.1 * NOISE


def test_what_blocks_predict_and_records_do_not_is_no_noise():
    """Each record alone is described well, but the others say nothing about it."""
    rng, n = np.random.default_rng(0), 800
    ends = ([[0.0], [2.0]], [[1.0], [3.0]])
    drives = [np.where(rng.random(n) < 0.5, *rng.uniform(*ends, (2, n))) for _ in range(2)]
    drives.append(rng.uniform(1.0, 2.0, n))
    parts = {
        number: (
            u[:, None],
            u + 0.3 * np.cos(9.0 * (u - 1.5)) + 1e-3 * rng.standard_normal(n),
        )
        for number, u in enumerate(drives)
    }
    declared = Cascade([("curve", SmoothCurve(36)), ("gain", Gain())])
    search = EffectSearchCV(declared, effects=["offset"]).fit(*stack_records(parts, dt=1e-3))
    assert search.verdict_ == "undetermined"
    assert search.verdict_reason_.startswith("the held-out error is ")
    assert search.error_after_ > 3.0 * search.noise_floor_


def test_the_period_of_a_drive_has_two_turns():
    """Of a drive that never turns it is the longest record."""
    sine = np.sin(2.0 * np.pi * np.arange(1000) / 100)
    records = [RecordData(u, u, 1.0) for u in (sine, sine[:500])]
    assert _drive_period(records) == pytest.approx(100.0, rel=0.02)
    ramps = [RecordData(np.arange(n), np.zeros(n), 1.0) for n in (30, 80)]
    assert _drive_period(ramps) == 80


def test_what_is_flat_between_jumps_is_no_noise():
    """A staircase has the spectrum of first-order noise; noise with outliers is no staircase.

    Noise has no held-out error that is twice that of the fit.
    """
    rng = np.random.default_rng(3)
    white = rng.standard_normal(3000)
    noise = lfilter([1.0], [1.0, -0.9], white)
    steps = np.repeat(rng.uniform(-1.0, 1.0, 300), 10) + 0.03 * white
    lost = np.where(rng.random(3000) < 0.05, 8.0 * noise.std() * white, 0.0)
    for r, excess, number in ((noise, 1, 0), (noise + lost, 1, 0), (steps, 1, 1), (noise, 2, 1)):
        law = fit_noise([r])
        assert law.law == "autoregressive"
        records = [RecordData(np.sin(np.arange(3000) / 10.0), r, 1.0)]
        floor = noise_floor([r], [r], law)
        assert len(list(_against_noise(records, [r], law, floor, excess))) == number
