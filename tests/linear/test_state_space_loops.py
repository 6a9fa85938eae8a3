"""Compiled loops against their plain Python originals, and against matrix algebra."""

from unittest.mock import patch

import numpy as np
import pytest

from skhyst.linear._state_space import (
    block_run,
    block_table,
    first_order_run,
    second_order_run,
    second_order_tangents,
    state_space_run,
    state_space_tangents,
    tangent_loop,
)


def make_system(n_states, p, m, seed):
    rng = np.random.default_rng(seed)
    ad = rng.normal(size=(n_states, n_states)) / (1 + 2 * n_states)
    ad[rng.random(ad.shape) < 0.3] = 0.0
    vectors = rng.normal(size=(3, n_states))
    discrete = (ad, *vectors, 0.3)
    steps = (
        rng.normal(size=(p, n_states, n_states)),
        *rng.normal(size=(3, p, n_states)),
        rng.normal(size=p),
    )
    u, du = rng.normal(size=40), rng.normal(size=(40, m))
    x, dx = rng.normal(size=n_states), rng.normal(size=(n_states, m + p))
    return discrete, steps, u, du, x, dx, 0.7, rng.normal(size=m)


SHAPES = [(1, 1, 0), (1, 2, 3), (2, 0, 2), (4, 3, 1), (0, 1, 2)]


@pytest.mark.parametrize(("n_states", "p", "m"), SHAPES)
def test_compiled_equals_python(n_states, p, m):
    discrete, steps, u, du, x, dx, u0, du0 = make_system(n_states, p, m, seed=n_states)
    compiled = state_space_run(*discrete, u, x, u0)
    plain = state_space_run.py_func(*discrete, u, x, u0)
    for a, b in zip(compiled, plain, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-13)
    compiled = state_space_tangents(*discrete, *steps, u, du, x, dx, u0, du0)
    kernel = second_order_tangents if n_states == 2 else tangent_loop
    with patch(f"skhyst.linear._state_space.{kernel.__name__}", kernel.py_func):
        plain = state_space_tangents(*discrete, *steps, u, du, x, dx, u0, du0)
    for a, b in zip(compiled, plain, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(("n_states", "p", "m"), SHAPES)
def test_recursion(n_states, p, m):
    (ad, b0, b1, c, d), _, u, _, x, *_ = make_system(n_states, p, m, seed=7)
    kept = x.copy()
    y, last = state_space_run(ad, b0, b1, c, d, u, x, 0.7)
    np.testing.assert_array_equal(x, kept)
    previous = 0.7
    for k, value in enumerate(u):
        x = ad @ x + b0 * previous + b1 * value
        previous = value
        assert y[k] == pytest.approx(c @ x + d * value, abs=1e-12)
    np.testing.assert_allclose(last, x, atol=1e-12)


@pytest.mark.parametrize(("n_states", "run"), [(1, first_order_run), (2, second_order_run)])
def test_one_and_two_states_in_registers(n_states, run):
    discrete, _, u, _, x, *_ = make_system(n_states, 1, 0, seed=5)
    kept = x.copy()
    expected = state_space_run(*discrete, u, x, 0.7)
    for kernel in (run, run.py_func):
        for found, wanted in zip(kernel(*discrete, u, x, 0.7), expected, strict=True):
            np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-13)
    np.testing.assert_array_equal(x, kept)


@pytest.mark.parametrize("length", [1, 3, 16])
@pytest.mark.parametrize("n_states", [1, 3, 4, 9])
def test_blocks_are_the_recursion(n_states, length):
    discrete, _, u, _, x, *_ = make_system(n_states, 1, 0, seed=6)
    kept, whole = x.copy(), len(u) // length * length
    expected, last = state_space_run(*discrete, u[:whole], x, 0.7)
    table = block_table(*discrete, length)
    for kernel in (block_run, block_run.py_func):
        y, state = kernel(table, u, x, 0.7)
        np.testing.assert_allclose(y, expected, rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(state, last, rtol=1e-11, atol=1e-12)
    np.testing.assert_array_equal(x, kept)
    # the input of a sample reaches no output before it
    for k in range(length):
        assert not table[1 + k, :k].any()


@pytest.mark.parametrize("n_states", [2, 3])
def test_tangents_by_central_differences(n_states):
    discrete, steps, u, du, x, dx, u0, du0 = make_system(n_states, 2, 2, seed=2)
    y, dy = state_space_tangents(*discrete, *steps, u, du, x, dx, u0, du0)
    np.testing.assert_allclose(y, state_space_run(*discrete, u, x, u0)[0], rtol=1e-12)
    h = 1e-6
    for column in range(4):
        own = column - 2

        def shifted(sign, column=column, own=own):
            moved = discrete
            signal, first = u, u0
            if own >= 0:
                parts = zip(discrete, steps, strict=True)
                moved = tuple(part + sign * h * step[own] for part, step in parts)
            else:
                signal, first = u + sign * h * du[:, column], u0 + sign * h * du0[column]
            return state_space_run(*moved, signal, x + sign * h * dx[:, column], first)[0]

        expected = (shifted(1) - shifted(-1)) / (2 * h)
        np.testing.assert_allclose(dy[:, column], expected, atol=1e-7, rtol=1e-7)
