"""Relays with ramps: their definition, agreement with relays, recovery of plants."""

import numpy as np
import pytest

from skhyst.compose import Cascade
from skhyst.hysteresis import (
    KrasnoselskiiPokrovskii,
    KrasnoselskiiPokrovskiiOperator,
    PreisachOperator,
)
from skhyst.linear import FirstOrderLag, FirstOrderLagOperator

LEVELS = np.linspace(-1.0, 1.0, 6)


def run(operator, u, state=None):
    return operator.run(u, 1.0, state)[0]


def test_kernels_follow_their_definition():
    levels, rng = np.array([-1.0, -0.2, 0.3, 0.7, 1.4]), np.random.default_rng(0)
    u, z, weights = 1.2 * rng.normal(size=200), rng.uniform(-1, 1, 10), rng.random(10)
    operator = KrasnoselskiiPokrovskiiOperator(levels, weights, 0.3)
    rows, state = operator.basis(u, z)
    y, end = operator.run(u, 1.0, z)
    i, j = np.tril_indices(levels.size - 1)
    expected = []
    for value in u:
        ramps = np.clip(2 * (value - levels[:-1]) / np.diff(levels) - 1, -1, 1)
        z = np.maximum(ramps[i], np.minimum(ramps[j], z))
        expected.append(z)
    np.testing.assert_allclose(rows[:, :-1], expected, rtol=0, atol=1e-14)
    np.testing.assert_allclose(y, expected @ weights + 0.3, rtol=0, atol=1e-13)
    np.testing.assert_array_equal(state, rows[-1, :-1])
    np.testing.assert_array_equal(end, state)


def test_kernels_are_not_congruent_but_relays_are():
    """A loop inside one interval moves kernels that stand on their ramp, so its history shows."""
    operator = KrasnoselskiiPokrovskiiOperator([0.0, 1.0, 2.0], [0.0, 1.0, 0.0])
    loop = np.array([1.2, 1.6, 1.2])
    low = run(operator, np.concatenate(([0.0, 1.0], loop)))[-3:]
    high = run(operator, np.concatenate(([0.0, 2.0], loop)))[-3:]
    assert low[1] - low[0] == pytest.approx(0.8)
    assert high[1] - high[0] == 0.0


def test_major_branches_agree_with_relays_on_a_fine_grid():
    """With the same weight in each cell, kernels and spread relays differ by the grid's width."""
    errors = []
    u = 1.3 * np.sin(np.linspace(0, 25, 800)) * np.linspace(1, 0.3, 800)
    for n in (9, 33):
        levels = np.linspace(-1.5, 1.5, n)
        i, j = np.tril_indices(n - 1)
        middle = 0.5 * (levels[1:] + levels[:-1])
        density = np.exp(-((middle[i] - 0.4) ** 2 + (middle[j] + 0.4) ** 2) / 0.2)
        density[i == j] *= 0.5
        weights = density / density.sum()
        kernels = KrasnoselskiiPokrovskiiOperator(levels, weights)
        errors.append(np.abs(run(kernels, u) - run(PreisachOperator(levels, weights), u)).max())
    assert errors[1] < 0.4 * errors[0]
    assert errors[1] < 0.05


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
    assert total > 0.9 * 20 * 16
    assert 0.90 < inside / total < 0.99


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
