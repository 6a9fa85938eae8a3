"""Relays: their law, the Everett function, the staircase, recovery of plants."""

import dataclasses
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone

from skhyst.exceptions import ConvergenceWarning
from skhyst.hysteresis import (
    PrandtlIshlinskii,
    PrandtlIshlinskiiOperator,
    Preisach,
    PreisachOperator,
)

LEVELS = np.linspace(-1.0, 1.0, 6)


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
        slope = operator.linearize(path, du, 1.0)[1][-1, 0]
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


def test_long_states():
    operator = example()
    u = 1.2 * (-1.0) ** np.arange(2000) * np.linspace(1.0, 0.1, 2000)
    y, state = operator.run(u, 1.0)
    assert state[0].size > 1900
    rows, end = operator.basis(u)
    close(rows @ operator.pack(), y)
    np.testing.assert_array_equal(end[0], state[0])
    close(operator.basis(u[::-1], state)[0] @ operator.pack(), run(operator, u[::-1], state))


# Estimator


def excursions(rng, n_turns=110, n_steps=10):
    """Reversal curves of all sizes: every cell is switched alone now and then."""
    ends = np.r_[0.0, 1.0, -1.0, rng.uniform(-1.0, 1.0, n_turns)]
    ends[5::8], ends[6::8] = 1.0, -1.0
    time = np.arange(0, n_steps * (ends.size - 1) + 1) / n_steps
    return np.interp(time, np.arange(ends.size), ends)


def column(u):
    return np.reshape(u, (-1, 1))


def test_smoothness_fills_what_a_major_loop_leaves_open():
    """Minor loops are predicted from a major loop only as well as the penalty guesses."""
    operator = PreisachOperator(np.linspace(-1, 1, 16), np.full(120, 1 / 120), np.full(15, 1 / 30))
    major = np.cos(np.linspace(0, 4 * np.pi, 800))
    minor = 0.6 * np.cos(np.linspace(0, 4 * np.pi, 800))
    y = operator.run(major, 1.0)[0]
    smooth = Preisach(16).fit(column(major), y)
    expected = operator.run(minor, 1.0)[0]
    assert np.std(smooth.predict(column(minor)) - expected) < 0.02 * np.ptp(expected)


def test_an_even_density_costs_no_roughness():
    u = excursions(np.random.default_rng(0))
    even = np.ones((5, 5)) - 0.5 * np.eye(5)
    y = PreisachOperator(LEVELS, even[np.tril_indices(5)], np.full(5, 0.7)).run(u, 1.0)[0]
    model = Preisach(6, smoothness=10.0).fit(column(u), y)
    np.testing.assert_allclose(model.weights_, even[np.tril_indices(5)], rtol=1e-6)
    np.testing.assert_allclose(model.reversible_, 0.7, rtol=1e-6)


def test_cells_that_were_never_switched():
    u = np.sin(np.linspace(0, 30, 900)) * 0.5
    model = Preisach(levels=np.linspace(-1, 1, 9))
    with pytest.warns(ConvergenceWarning, match="do not determine"):
        model.fit(column(u), u)
    undetermined = set(model.identifiability_["undetermined"])
    i, j = np.tril_indices(8)
    still = (i >= 6) | (j <= 1)
    assert undetermined == {f"weights[{k}]" for k in np.flatnonzero(still)} | {
        f"reversible[{k}]" for k in (0, 1, 6, 7)
    }
    assert all(np.isinf(model.params_std_[name]) for name in undetermined)
    assert np.std(model.predict(column(u)) - u) < 1e-2
    with pytest.warns(ConvergenceWarning):
        hard = clone(model).set_params(smoothness=0.0).fit(column(u), u)
    np.testing.assert_array_equal(hard.weights_[still], 0.0)
    assert np.std(hard.predict(column(u)) - u) < 1e-6


def test_levels_follow_the_response():
    u = np.sin(np.linspace(0, 40, 4000))
    y = np.tanh(20 * u) + 0.01 * np.random.default_rng(0).normal(size=u.size)
    even = Preisach(10).fit(column(u), y)
    dense = Preisach(10, levels="response").fit(column(u), y)
    assert np.count_nonzero(np.abs(dense.levels_) < 0.2) >= 4
    assert dense.levels_[[0, -1]] == pytest.approx([u.min(), u.max()])
    assert np.diff(dense.levels_).max() < 0.5
    assert dense.fit_error_ < 0.5 * even.fit_error_


def test_amplitude_that_was_not_in_the_fit():
    """What plays cannot do: loops of an asymmetric density, at an amplitude in between."""
    levels = np.linspace(-1, 1, 25)
    i, j = np.tril_indices(24)
    middle = 0.5 * (levels[1:] + levels[:-1])
    density = np.exp(-((middle[i] - 0.25) ** 2 + (middle[j] + 0.1) ** 2) / 0.1)
    device = PreisachOperator(levels, density / density.sum(), np.full(24, 0.01))
    loop = np.cos(np.linspace(0, 4 * np.pi, 500))
    amplitudes = [1.0, 0.7, 0.45, 0.25]
    X = pd.DataFrame({"drive": np.concatenate([a * loop for a in amplitudes])})
    X.index = pd.MultiIndex.from_product([amplitudes, np.arange(500.0)], names=["record", "time"])
    y = np.concatenate([device.run(a * loop, 1.0)[0] for a in amplitudes])
    unseen = X[:500] * 0.57
    expected = device.run(unseen["drive"], 1.0)[0]
    errors = {
        model: np.std(model.fit(X, y).predict(unseen) - expected) / np.ptp(expected)
        for model in (Preisach(20), PrandtlIshlinskii(40))
    }
    relays, plays = errors.values()
    assert relays < 0.01
    assert plays > 5 * relays


def test_history_before_the_record():
    """Before the record the device had been at the lowest level; the weights stay smooth."""
    device = PreisachOperator(np.linspace(-1, 1, 11), np.full(55, 0.02), np.full(10, 0.01))
    u = excursions(np.random.default_rng(2))
    y = device.run(np.r_[-1.0, u], 1.0)[0][1:]
    rest = Preisach(11).fit(column(u), y)
    model = Preisach(11, initial_state="estimate").fit(column(u), y)
    assert model.initial_drive_[0] == pytest.approx(-1.0, abs=0.1)
    assert model.fit_error_ < 0.3 * rest.fit_error_
    assert model.fit_error_ < 1e-3 * np.ptp(y)


def test_many_cells():
    """1,225 cells of 50 levels from 3,000 samples: seconds, not minutes."""
    u = excursions(np.random.default_rng(0), n_turns=300, n_steps=10)
    y = np.tanh(u + 0.2 * np.random.default_rng(1).normal(size=u.size) * 0.01)
    model = Preisach(50, smoothness=1e-3).fit(column(u), y)
    assert model.weights_.size == 1225
    assert model.fit_error_ < 0.02
