import numpy as np
import pytest

from skhyst.compose import Cascade
from skhyst.hysteresis import KrasnoselskiiPokrovskii
from skhyst.linear import FirstOrderLag, FirstOrderLagOperator

LEVELS = np.linspace(-1.0, 1.0, 6)


def kernel_response(u, weights, intercept):
    """The plant: plays with saturated ramps; the first samples forget the start."""
    i, j = np.tril_indices(LEVELS.size - 1)
    z, y = np.where(i + j == 4, 0.0, np.where(i + j > 4, -1.0, 1.0)), np.empty(u.size)
    for k, value in enumerate(u):
        up = np.clip((value - LEVELS[i]) * 5.0 - 1.0, -1.0, 1.0)
        down = np.clip((value - LEVELS[j]) * 5.0 - 1.0, -1.0, 1.0)
        z = np.where(z < up, up, np.where(z > down, down, z))
        y[k] = intercept + weights @ z
    return y


def plant(seed):
    rng = np.random.default_rng(seed)
    ends = np.r_[0.0, 1.0, -1.0, rng.uniform(-1.0, 1.0, 110)]
    ends[5::8], ends[6::8] = 1.0, -1.0
    u = np.interp(np.arange(0, 14 * (ends.size - 1) + 1) / 14, np.arange(ends.size), ends)
    weights = rng.uniform(0.5, 1.5, 15)
    y = kernel_response(u, weights, 3.0)
    return u.reshape(-1, 1), y, 0.005 * np.ptp(y), np.r_[weights, 3.0]


def test_recovery_and_standard_errors():
    """Over 20 plants: at the noise floor, and the 95 % intervals hold."""
    inside, total = 0, 0
    for seed in range(20):
        X, y, noise, truth = plant(seed)
        error = noise * np.random.default_rng(100 + seed).normal(size=y.size)
        noisy = y + error
        model = KrasnoselskiiPokrovskii(n_levels=6, smoothness=0.0).fit(X, noisy)
        assert np.std(model.predict(X) - noisy) < 1.02 * np.std(error)
        assert np.std(model.predict(X) - y) < 0.3 * noise
        assert model.identifiability_["undetermined"] == ()
        found, std = np.array(list(model.params_.values())), np.array([*model.params_std_.values()])
        inside += np.count_nonzero(np.abs(found - truth) < 1.96 * std)
        total += np.count_nonzero(np.isfinite(std))
    coverage = inside / total
    print(f"coverage of the 95 % interval: {coverage:.3f} of {total}")
    assert total > 0.9 * 20 * 16
    assert 0.90 < coverage < 0.99


def test_default_smoothness_costs_little():
    X, y, noise, _ = plant(3)
    noisy = y + noise * np.random.default_rng(7).normal(size=y.size)
    model = KrasnoselskiiPokrovskii(n_levels=6).fit(X, noisy)
    assert np.std(model.predict(X) - y) < 0.5 * noise


def test_free_weights_and_no_intercept():
    X, _, _, _ = plant(0)
    weights = np.random.default_rng(0).uniform(-1, 1, 15)
    y = kernel_response(X[:, 0], weights, 0.0)
    options = {"smoothness": 0.0, "fit_intercept": False}
    free = KrasnoselskiiPokrovskii(6, non_negative=False, **options).fit(X, y)
    np.testing.assert_allclose(free.weights_, weights, atol=1e-8)
    assert free.intercept_ == 0.0
    assert KrasnoselskiiPokrovskii(6, **options).fit(X, y).weights_.min() == 0.0


def test_in_a_cascade():
    X, y, _, truth = plant(1)
    lagged = FirstOrderLagOperator(3.0).run(y, 1.0)[0]
    model = Cascade([("ramps", KrasnoselskiiPokrovskii(6)), ("lag", FirstOrderLag())])
    model.fit(X, lagged)
    assert model.operators_["lag"].time_constant == pytest.approx(3.0, rel=1e-4)
    np.testing.assert_allclose(model.operators_["ramps"].weights, truth[:15], rtol=1e-2)


def test_penalty_does_not_couple_reversible_kernels_to_loops():
    """A straight line needs equal reversible kernels and nothing else: it costs no roughness."""
    X = np.sin(np.linspace(0, 20, 500)).reshape(-1, 1)
    model = KrasnoselskiiPokrovskii(6, smoothness=10.0).fit(X, 3.0 * X[:, 0])
    np.testing.assert_allclose(model.predict(X), 3.0 * X[:, 0], atol=1e-6)


@pytest.mark.parametrize("levels", ["grid", "response"])
def test_units(levels):
    X, y, _, _ = plant(5)
    model = KrasnoselskiiPokrovskii(6, levels=levels)
    one = model.fit(X, y).predict(X)
    for scale in (1e-9, 1e9):
        other = model.fit(X * scale, y / scale).predict(X * scale)
        np.testing.assert_allclose(other * scale, one, rtol=0, atol=1e-4 * np.ptp(y))
