"""Relays: their law, the Everett function, the staircase."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest

from skhyst.hysteresis import (
    PrandtlIshlinskiiOperator,
    PreisachOperator,
)


def run(operator, u, state=None):
    return operator.run(u, 1.0, state)[0]


def close(a, b, tolerance=1e-9):
    np.testing.assert_allclose(a, b, rtol=0, atol=tolerance)


def example(n=7):
    rng = np.random.default_rng(0)
    weights = rng.random(n * (n - 1) // 2)
    return PreisachOperator(np.linspace(-1.5, 2.0, n), weights, rng.random(n - 1), 0.7, 0.2)


# Operator


def relay_sum(operator, u, fine):
    """Add up relays, ``fine`` squared in each cell; those on the diagonal itself do not count."""
    x, width = operator.levels, np.diff(operator.levels)
    part = (np.arange(fine) + 0.5) / fine
    alphas, betas, weights = [], [], []
    for k, (i, j) in enumerate(zip(*np.tril_indices(x.size - 1), strict=True)):
        alpha, beta = np.meshgrid(x[i] + part * width[i], x[j] + part * width[j], indexing="ij")
        inside = alpha > beta
        alphas.append(alpha[inside])
        betas.append(beta[inside])
        weights.append(np.full(inside.sum(), operator.weights[k] / inside.sum()))
    alpha, beta, weight = map(np.concatenate, (alphas, betas, weights))
    relays = np.where(alpha + beta > 2 * np.clip(operator.center, x[0], x[-1]), -1.0, 1.0)
    y = []
    for value in u:
        relays[alpha <= value] = 1.0
        relays[beta >= value] = -1.0
        ramps = 2 * np.clip((value - x[:-1]) / width, 0, 1) - 1
        y.append(operator.intercept + weight @ relays + operator.reversible @ ramps)
    return np.array(y)


@pytest.mark.parametrize("center", [0.2, 0.0, -0.9, -np.inf, np.inf])
def test_equals_relays_on_a_fine_grid(center):
    operator = dataclasses.replace(example(), center=center)
    u = 1.3 * np.random.default_rng(1).normal(size=150)
    y = run(operator, u)
    errors = [np.abs(relay_sum(operator, u, fine) - y).max() for fine in (10, 40)]
    assert errors[1] < 0.01 * np.ptp(y)
    assert errors[1] < 0.5 * errors[0]


GRIDS = {
    "even": np.linspace(-1.0, 1.0, 9),
    "two": np.array([-0.3, 0.8]),
    "crowded": np.r_[-1.0, np.geomspace(1e-7, 1.5, 12)],
    "far": 1e6 + np.array([0.0, 0.4, 0.7, 3.0]),
}


@pytest.fixture(params=GRIDS)
def operator(request):
    levels, rng = GRIDS[request.param], np.random.default_rng(0)
    n, center = levels.size, levels[0] + 0.37 * np.ptp(levels)
    weights = rng.random(n * (n - 1) // 2)
    return PreisachOperator(levels, weights, rng.random(n - 1), center=center)


def test_everett_sum_equals_the_areas_of_the_cells(operator):
    """Two ways that share the turning points only."""
    low, high = operator.levels[[0, -1]]
    noise = np.random.default_rng(1).normal(size=3000)
    u = np.r_[0.5 * (low + high) + 0.4 * (high - low) * noise, operator.levels, low]
    rows, _ = operator.basis(u)
    close(rows @ operator.pack(), run(operator, u))
    assert np.abs(rows).max() <= 1.0 + 1e-12


def test_tangent_is_the_slope_of_a_branch(operator):
    """Within a cell a branch is quadratic at most, so the central difference is exact."""
    levels, width = operator.levels, np.diff(operator.levels)
    rng, du = np.random.default_rng(5), np.array([[0.0], [0.0], [0.0], [1.0]])
    scale = 2.0 * (operator.weights.sum() + operator.reversible.sum())
    for start in rng.uniform(*levels[[0, -1]], 200):
        j = rng.integers(0, width.size)
        v, h = levels[j] + rng.uniform(0.01, 0.99) * width[j], 1e-4 * width[j]
        if abs(v - start) < 2.0 * h:
            continue
        path = np.array([levels[0], levels[-1], start, v])
        slope = operator.sensitivities(path, du, 1.0)[1][-1, 0]
        above, below = (run(operator, path + s * du[:, 0])[-1] for s in (h, -h))
        tolerance = 1e-10 * scale / h + 1e-9 * np.abs(levels).max() / np.ptp(levels)
        assert (above - below) / (2 * h) == pytest.approx(slope, abs=tolerance)


def test_area_of_the_major_loop():
    """It is twice the density times the width alpha - beta, over the half plane."""
    operator = PreisachOperator([0.0, 1.0, 2.0], [0.0, 3.0, 0.0], [0.4, 0.7])
    u = np.concatenate((np.linspace(0, 2, 2001), np.linspace(2, 0, 2001)))
    area = np.trapezoid(u, run(operator, u))
    assert area == pytest.approx(2.0 * 3.0 * (1.5 - 0.5), rel=1e-6)


@pytest.mark.parametrize("r", [0.0, 0.5])
def test_diagonal_lines_are_plays(r):
    """A density on the line alpha - beta = 2 r is a play of threshold r."""
    n = 121
    levels = np.linspace(-1.2, 1.2, n)
    width = levels[1] - levels[0]
    i, j = np.tril_indices(n - 1)
    weights = np.where((i - j == round(2 * r / width)) & (r > 0.0), 0.5 * width, 0.0)
    reversible = np.full(n - 1, 0.5 * width if r == 0.0 else 0.0)
    relays = PreisachOperator(levels, weights, reversible)
    plays = PrandtlIshlinskiiOperator([r], [1.0])
    u = 0.35 * np.random.default_rng(4).normal(size=400)
    u = np.clip(u, -0.65, 0.65)  # on the line, alpha and beta stay within the levels
    y, expected = run(relays, u), plays.run(u, 1.0, (np.empty(0), 0.0))[0]
    assert np.abs(y - expected).max() < (1e-12 if r == 0.0 else 0.6 * width)


def test_everett_function():
    operator, u = example(), np.array([-9.0, 0.9, -0.4])
    y = run(operator, u)
    assert y[1] - y[0] == pytest.approx(2 * operator.everett(0.9, -9.0), rel=1e-12)
    assert y[1] - y[2] == pytest.approx(2 * operator.everett(0.9, -0.4), rel=1e-12)
    total = operator.weights.sum() + operator.reversible.sum()
    assert operator.everett(99.0, -99.0) == pytest.approx(total, rel=1e-12)
    assert operator.everett(0.3, 0.3) == 0.0


def test_continuous():
    u = np.repeat([-1.2, 1.7, -0.8, 1.1, -0.3, 0.6], 2)
    steps = np.concatenate([np.linspace(a, b, 4000) for a, b in pairwise(u)])
    y = run(example(), steps)
    assert np.abs(np.diff(y)).max() < 30 * np.abs(np.diff(steps)).max()


def test_demagnetised_by_decaying_swings():
    """Swings that decay slowly about the centre lead to the virgin state."""
    operator = example()
    u = 0.2 + 1.8 * (1 - np.arange(20000) / 20000) * (-1.0) ** np.arange(20000)
    _, state = operator.run(np.append(u, 0.2), 1.0)
    after = np.array([0.5, -0.3, 1.2])
    close(run(operator, after, state), run(operator, after, operator.init(0.2)), 2e-3)


def test_a_step_remembers_what_matters_most():
    """Each pair of turning points that it must drop is worth less than it is said to be."""
    width = np.tril(np.full((9, 9), 2.0), -1) + np.eye(9)  # a density that is even
    operator = PreisachOperator(np.linspace(-1.0, 1.0, 10), width[np.tril_indices(9)])
    u = (-1.0) ** np.arange(600) * np.linspace(1.0, 0.0, 600)
    u = np.append(u, np.linspace(0.0, 1.0, 300))
    y, _ = operator.run(u, 1.0)
    compiled_step = operator.compiled_step(1.0, operator.init(u[0]))
    found = compiled_step.streaming(compiled_step.state.copy())(u)
    close(found[:600], y[:600])
    n_kept = (compiled_step.state.size - 3) // 2 - 1
    bound = ((600 - n_kept) / 2 + 1) * 2.0 / n_kept**2
    assert 0.0 < np.abs(found - y).max() < bound * np.ptp(y)


@pytest.mark.parametrize("count", [510, 511, 512, 513, 600])
def test_a_step_goes_on_from_a_long_state(count):
    """It holds all turning points of the state, and drops a pair where there is no room."""
    operator = example()
    u = (-1.0) ** np.arange(count + 2) * np.linspace(1.2, 0.1, count + 2)
    _, state = operator.run(u, 1.0)
    assert abs(len(state[0]) - count) <= 2
    after = np.r_[0.0, 0.05, -0.02, np.linspace(-0.02, 1.1, 50), np.linspace(1.1, -1.1, 50)]
    compiled_step = operator.compiled_step(1.0, state)
    assert compiled_step.possible(compiled_step.state, compiled_step.constants)
    found = compiled_step.streaming(compiled_step.state.copy())(after)
    y = run(operator, after, state)
    close(found, y, 2.0 * 2.0 / 512**2 * np.ptp(y))


def test_long_states():
    operator = example()
    u = 1.2 * (-1.0) ** np.arange(2000) * np.linspace(1.0, 0.1, 2000)
    y, state = operator.run(u, 1.0)
    assert state[0].size > 1900
    rows, end = operator.basis(u)
    close(rows @ operator.pack(), y)
    np.testing.assert_array_equal(end[0], state[0])
    close(operator.basis(u[::-1], state)[0] @ operator.pack(), run(operator, u[::-1], state))
