"""Kernel of the Jiles-Atherton model against plain Python and against quadrature."""

from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skhyst.hysteresis import _jiles_atherton_loops as _jiles_atherton
from skhyst.hysteresis._jiles_atherton_loops import (
    count_steps,
    jiles_atherton_run,
    jiles_atherton_tangents,
    langevin,
    stage,
    susceptibility,
)

NODES, WEIGHTS = np.polynomial.legendre.leggauss(200)
SMALL = [1e-300, 1e-12, 1e-5, 1e-2, 0.3, 0.4999, 0.5001, 0.8]


@pytest.mark.parametrize("x", [*SMALL, 2.0, 7.0, 30.0])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_langevin_is_the_mean_of_a_dipole(x, sign):
    """L, L' and L'' are mean, variance and third moment of cos(angle) with weight exp(x cos)."""
    density = WEIGHTS * np.exp(x * (NODES - 1.0))
    density /= density.sum()
    mean = density @ NODES
    moments = [sign * mean, density @ (NODES - mean) ** 2, sign * density @ (NODES - mean) ** 3]
    np.testing.assert_allclose(langevin(sign * x), moments, rtol=1e-12, atol=2e-15)
    np.testing.assert_allclose(langevin.py_func(sign * x), langevin(sign * x), rtol=1e-14)


def test_langevin_near_zero_and_far_away():
    assert langevin(0.0) == (0.0, 1 / 3, 0.0)
    value, slope, bend = langevin(1e-160)
    np.testing.assert_allclose([value, slope, bend], [1e-160 / 3, 1 / 3, -2e-160 / 15], rtol=1e-12)
    np.testing.assert_allclose(langevin(1e4), [1.0 - 1e-4, 1e-8, -2e-12], rtol=1e-12)
    np.testing.assert_allclose(langevin(-1e4), [1e-4 - 1.0, 1e-8, 2e-12], rtol=1e-12)
    assert np.isfinite(langevin(1e200)).all()


@settings(deadline=None, max_examples=60)
@given(
    st.floats(-5, 5),
    st.floats(-1, 1),
    st.sampled_from([-1.0, 1.0]),
    st.floats(0.2, 3.0),
    st.floats(0.1, 3.0),
    st.floats(0.02, 0.9),
    st.floats(0.05, 0.95),
)
def test_derivatives_of_the_susceptibility(field, m, direction, a, k, b, c):
    point = np.array([field, m, a, k, b, c])

    def value(p):
        return susceptibility(p[0], p[1], direction, *p[2:])[0]

    found = susceptibility(field, m, direction, a, k, b, c)
    assert found[0] >= 0.0
    for i, step in enumerate(1e-6 * np.eye(6)):
        above, below = value(point + step), value(point - step)
        one_sided = [(above - found[0]) / 1e-6, (found[0] - below) / 1e-6]
        # where a case of the equation begins, either side will do
        scale = 1e-4 * max(1.0, *map(abs, found))
        bends = abs(one_sided[0] - one_sided[1]) > scale
        if bends:
            assert min(abs(found[1 + i] - side) for side in one_sided) < scale
        else:
            assert found[1 + i] == pytest.approx(np.mean(one_sided), abs=scale)


def test_compiled_equals_python():
    rng = np.random.default_rng(1)
    u, du = np.cumsum(rng.normal(size=30)), rng.normal(size=(30, 2))
    values = (0.9, 0.6, 0.5, 0.2, 0.4)
    plain = {f.__name__: f.py_func for f in (langevin, susceptibility, count_steps, stage)}
    outputs = []
    m, dm = np.empty(30), np.empty((30, 6))
    state = jiles_atherton_run(u, *values, 0.2, 0.1, m)
    tangent_m = np.empty(30)
    jiles_atherton_tangents(u, du, *values, tangent_m, dm)
    outputs.append((m, np.array(state), tangent_m, dm))
    m, dm, tangent_m = np.empty(30), np.empty((30, 6)), np.empty(30)
    with patch.multiple(_jiles_atherton, **plain):
        state = jiles_atherton_run.py_func(u, *values, 0.2, 0.1, m)
        jiles_atherton_tangents.py_func(u, du, *values, tangent_m, dm)
    outputs.append((m, np.array(state), tangent_m, dm))
    for compiled, python in zip(*outputs, strict=True):
        np.testing.assert_allclose(compiled, python, rtol=1e-11, atol=1e-13)


def test_number_of_steps():
    assert [count_steps(x, 0.1) for x in (0.0, 0.05, 0.1, -0.25)] == [1, 1, 1, 3]
    assert count_steps(1e300, 1e-300) == 10000
