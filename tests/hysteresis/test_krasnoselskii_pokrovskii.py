"""Relays with ramps: their definition, agreement with relays, recovery of plants."""

import numpy as np
import pytest

from skhyst.hysteresis import (
    KrasnoselskiiPokrovskii,
    KrasnoselskiiPokrovskiiOperator,
    PreisachOperator,
)

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


def test_penalty_does_not_couple_reversible_kernels_to_loops():
    """A straight line needs equal reversible kernels and nothing else: it costs no roughness."""
    X = np.sin(np.linspace(0, 20, 500)).reshape(-1, 1)
    model = KrasnoselskiiPokrovskii(6, smoothness=10.0).fit(X, 3.0 * X[:, 0])
    np.testing.assert_allclose(model.predict(X), 3.0 * X[:, 0], atol=1e-6)
