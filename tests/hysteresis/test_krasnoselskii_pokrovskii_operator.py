import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from skhyst.hysteresis import KrasnoselskiiPokrovskiiOperator, PreisachOperator
from skhyst.hysteresis._relay_grid import cell_indices

signals = arrays(float, st.integers(2, 40), elements=st.floats(-12, 12, width=32))


@st.composite
def operators(draw):
    n = draw(st.integers(2, 8))
    levels = np.cumsum(draw(arrays(float, n, elements=st.floats(0.1, 5)))) - draw(st.floats(0, 20))
    return KrasnoselskiiPokrovskiiOperator(
        levels,
        draw(arrays(float, n * (n - 1) // 2, elements=st.floats(0, 10))),
        draw(st.floats(-50, 50)),
        draw(st.sampled_from([0.0, -np.inf, np.inf, levels[0]])),
    )


def run(operator, u, state=None):
    return operator.run(u, 1.0, state)[0]


def example(n=7):
    weights = np.random.default_rng(0).random(n * (n - 1) // 2)
    return KrasnoselskiiPokrovskiiOperator(np.linspace(-1.5, 2.0, n), weights, 0.7, 0.2)


def close(a, b, tolerance=1e-9):
    np.testing.assert_allclose(a, b, rtol=0, atol=tolerance)


@settings(deadline=None, max_examples=40)
@given(operators(), signals)
def test_output_is_the_weighted_sum_of_the_kernels(operator, u):
    rows, state = operator.basis(u)
    y, end = operator.run(u, 1.0)
    close(rows @ operator.pack(), y)
    np.testing.assert_array_equal(state, end)
    assert np.abs(state).max() <= 1.0


@settings(deadline=None, max_examples=40)
@given(operators(), signals, st.integers(0, 2**32 - 1))
def test_rate_independence(operator, u, seed):
    rng = np.random.default_rng(seed)
    time = np.arange(u.size, dtype=float)
    warped = np.sort(np.concatenate((time, time, rng.random(2 * u.size) * (u.size - 1))))
    slow = run(operator, np.interp(warped, time, u))
    close(slow[np.searchsorted(warped, time)], run(operator, u), 1e-8)


@settings(deadline=None, max_examples=40)
@given(operators(), signals, signals)
def test_wiping_out(operator, u, loop):
    direct = np.concatenate((u, [30.0, -30.0], u))
    detour = np.concatenate((u, loop, [30.0, -30.0], u))
    close(run(operator, detour)[-u.size :], run(operator, direct)[-u.size :])


@settings(deadline=None, max_examples=40)
@given(operators(), signals)
def test_monotone_branches(operator, u):
    assert np.all(np.diff(run(operator, u)) * np.sign(np.diff(u)) >= -1e-10)


@settings(deadline=None, max_examples=30)
@given(operators(), signals)
def test_dissipation(operator, u):
    period = np.append(u, u[0])
    pieces = itertools.pairwise(period)
    steps = np.concatenate([np.linspace(a, b, 400) for a, b in pieces])
    y = run(operator, np.concatenate((steps, steps)))[-steps.size :]
    assert np.trapezoid(steps, y) >= -1e-3 * np.ptp(steps) * (np.ptp(y) + 1e-9)


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
        i, j = cell_indices(n)
        middle = 0.5 * (levels[1:] + levels[:-1])
        density = np.exp(-((middle[i] - 0.4) ** 2 + (middle[j] + 0.4) ** 2) / 0.2)
        density[i == j] *= 0.5
        weights = density / density.sum()
        kernels = KrasnoselskiiPokrovskiiOperator(levels, weights)
        errors.append(np.abs(run(kernels, u) - run(PreisachOperator(levels, weights), u)).max())
    assert errors[1] < 0.4 * errors[0]
    assert errors[1] < 0.05


def test_odd_symmetry():
    operator = KrasnoselskiiPokrovskiiOperator(
        np.linspace(-1, 1, 4), [0.5, 0.3, 0.2, 0.9, 0.3, 0.5]
    )
    u = np.random.default_rng(3).normal(size=500)
    close(run(operator, -u), -run(operator, u), 1e-12)
    assert run(operator, [0.0])[0] == pytest.approx(0.0, abs=1e-14)


def test_first_loading():
    operator = KrasnoselskiiPokrovskiiOperator(np.linspace(0, 150, 6), np.arange(15.0))
    up = np.linspace(0, 150, 40)
    y = run(operator, np.concatenate((up, [0.0], up)))
    assert y[0] == -operator.weights.sum()
    close(y[:40], y[41:], 1e-12)
    close(run(dataclasses.replace(operator, center=-np.inf), up), y[:40], 1e-12)
    np.testing.assert_array_equal(run(operator, up + 200.0), operator.weights.sum())


@pytest.mark.parametrize("m", [0, 3])
def test_tangents_are_central_differences(m):
    operator, rng = example(), np.random.default_rng(6)
    u, du = rng.normal(size=400), rng.normal(size=(400, m))
    y, dy = operator.linearize(u, du, 1.0)
    np.testing.assert_array_equal(y, run(operator, u))
    h = 1e-7
    for c in range(m):
        moved = run(operator, u + h * du[:, c]) - run(operator, u - h * du[:, c])
        close(dy[:, c], moved / (2 * h), 2e-6)


@pytest.mark.parametrize("drive_unit", [1e-150, 1e-9, 1e9, 1e150])
def test_unit_equivariance(drive_unit):
    operator, u = example(), np.random.default_rng(7).normal(size=300)
    other = dataclasses.replace(
        operator, levels=operator.levels * drive_unit, center=operator.center * drive_unit
    )
    close(run(other, u * drive_unit), run(operator, u), 1e-10)


@pytest.mark.parametrize(
    ("levels", "weights", "message"),
    [([0.0], [], "two or more ascending"), ([0.0, 1.0], [1.0, 2.0], "1 cells")],
)
def test_wrong_fields(levels, weights, message):
    with pytest.raises(ValueError, match=message):
        KrasnoselskiiPokrovskiiOperator(levels, weights)
