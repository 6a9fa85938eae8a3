"""Gross errors do not bend a fit, and without them hardly anything is lost."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plants import make_recording

from skhyst.diagnosis import EffectSearchCV
from skhyst.diagnosis._robust import huber_weights
from skhyst.hysteresis import PrandtlIshlinskii, PrandtlIshlinskiiOperator
from skhyst.optimize import RecordData, identify
from skhyst.records import lost_readings, record_slices

TRUTH = PrandtlIshlinskiiOperator(
    np.array([0.0, 0.3, 0.7]), np.array([0.6, 0.3, 0.2]), non_negative=True
)
NOISE = 0.02


def drive(n):
    time = np.linspace(0.0, 60.0, n)
    return np.sin(time) * (0.3 + 0.7 * np.sin(0.11 * time) ** 2)


def fit(u, y, weights=None):
    result = identify([(TRUTH, ())], [RecordData(u, y, 1.0, weights=weights)])
    return np.array(list(result.params.values())), np.array(list(result.params_std.values()))


def refit(u, y):
    first = identify([(TRUTH, ())], [RecordData(u, y, 1.0)])
    residual = y - first.operator.run(u, 1.0)[0]
    return fit(u, y, huber_weights([residual])[0])


@pytest.mark.parametrize("one_sided", [False, True])
def test_gross_outliers_leave_prandtl_ishlinskii_alone(one_sided):
    rng, n = np.random.default_rng(3), 4000
    u = drive(n)
    clean = TRUTH.run(u, 1.0)[0]
    noisy = clean + NOISE * rng.normal(size=n)
    spoilt = noisy.copy()
    rows = rng.choice(n, n // 100, replace=False)
    size = rng.uniform(0.5, 50.0, rows.size)
    spoilt[rows] += size if one_sided else size * rng.choice([-1.0, 1.0], rows.size)
    without, std = fit(u, noisy)
    bent, _ = fit(u, spoilt)
    robust, robust_std = refit(u, spoilt)
    assert np.max(np.abs(bent - without) / std) > 10.0
    assert np.max(np.abs(robust - without) / std) < 2.0
    np.testing.assert_allclose(robust_std, std, rtol=0.25)


@pytest.mark.slow
def test_efficiency_without_outliers():
    """Of normal errors: the variance of the plain fit over that of the robust one."""
    rng, n = np.random.default_rng(4), 600
    u = drive(n)
    clean, found = TRUTH.run(u, 1.0)[0], []
    for _ in range(150):
        y = clean + NOISE * rng.normal(size=n)
        found.append((fit(u, y)[0], refit(u, y)[0]))
    plain, robust = np.var(np.array(found), axis=0)
    assert np.mean(plain / robust) > 0.9


def structures(n, rng):
    time = np.arange(n)
    ring = np.sin(0.9 * time) * np.exp(-(time % 1000) / 60.0)
    return {
        "curve": np.sin(0.01 * time) ** 3,
        "steps": np.sign(np.sin(0.02 * time)),
        "ringing after steps": ring,
        "creep": np.log1p(0.1 * (time % 2000)),
        "burst of noise": rng.normal(size=n) * (time % 2000 < 300),
        "edges of four samples": 1.0 * (time % 500 < 4),
    }


@pytest.mark.parametrize("name", structures(10, np.random.default_rng(0)))
def test_structure_keeps_its_weight(name):
    rng = np.random.default_rng(5)
    structure = 20.0 * NOISE * structures(8000, rng)[name]
    (weights,) = huber_weights([structure + NOISE * rng.normal(size=8000)])
    share = np.sum(weights * structure**2) / np.sum(structure**2)
    assert share > 0.85


@settings(deadline=None, max_examples=20)
@given(exponent=st.integers(-100, 100), seed=st.integers(0, 99))
def test_units_do_not_matter(exponent, seed):
    rng = np.random.default_rng(seed)
    residual = rng.standard_t(2, size=300)
    residual[rng.random(300) < 0.1] = np.nan
    (plain,) = huber_weights([residual])
    (other,) = huber_weights([2.0**exponent * residual])
    np.testing.assert_array_equal(plain, other)
    assert np.all((plain >= 0.0) & (plain <= 1.0))
    assert np.all(plain[np.isnan(residual)] == 1.0)


@pytest.mark.parametrize(
    "residual", [np.zeros(100), np.ones(3), np.full(50, np.nan), np.array([7.0]), np.arange(99.0)]
)
def test_nothing_sticks_out(residual):
    np.testing.assert_array_equal(huber_weights([residual])[0], 1.0)


def test_lost_readings_do_not_count():
    rng = np.random.default_rng(6)
    u = drive(3000)
    y = TRUTH.run(u, 1.0)[0] + NOISE * rng.normal(size=3000)
    y[100:115] = y[2000] = y[2900:2903] = -7.0
    lost = lost_readings(u, y, record_slices(u[:, None]))
    (weights,) = huber_weights([y - TRUTH.run(u, 1.0)[0]], lost=lost)
    assert not weights[y == -7.0].any()
    assert weights[y != -7.0].mean() > 0.9


@pytest.mark.slow
def test_a_search_with_a_robust_loss_finds_the_lag_behind_gross_errors():
    recording = make_recording("lag", "prandtl_ishlinskii", 3000, n_samples=2500)
    y, rng = recording.y_train.copy(), np.random.default_rng(0)
    y.iloc[rng.choice(len(y), 25, replace=False)] += 0.5 * np.ptp(y)
    options = {"loss": "huber", "cv": 2, "random_state": 0}
    search = EffectSearchCV(PrandtlIshlinskii(), effects=["lag", "offset", "drift"], **options)
    search.fit(recording.X_train, y)
    assert search.effects_ == ["lag"]
    assert search.verdict_ == "noise"
    error = search.held_out_error(recording.X_test, recording.y_test)
    assert error < 1.1 * recording.noise_std
