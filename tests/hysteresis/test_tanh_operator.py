"""Laws of the hyperbolic tangent model."""

import dataclasses

import numpy as np
import pytest

from skhyst.hysteresis import TanhHysteresisOperator

OPERATOR = TanhHysteresisOperator(k0=0.12, alpha=-4e-5, beta=0.4, gamma=0.3, intercept=0.2)


def loop(frequency, n=2000):
    """Two periods of a sine; the rate has settled in the second."""
    u = 20.0 * np.sin(2 * np.pi * np.arange(2 * n) / n)
    y, _ = OPERATOR.run(u, 1.0 / (frequency * n))
    return u[n:], y[n:]


def area(u, y):
    return 0.5 * np.sum(u * np.roll(y, -1) - np.roll(u, -1) * y)


def test_area_is_in_proportion_to_the_frequency():
    """The loop closes through the rate alone: integral of alpha u' du = alpha w pi A^2."""
    for frequency in (1e-3, 1.0, 40.0):
        expected = 4e-5 * (2 * np.pi * frequency) * np.pi * 20.0**2
        assert area(*loop(frequency)) == pytest.approx(expected, rel=1e-4)


def test_slow_drive_has_no_memory():
    u, y = loop(1e-9)
    np.testing.assert_allclose(y, 0.2 + 0.12 * u + 0.4 * np.tanh(0.3 * u), atol=1e-9)


def test_odd_symmetry():
    odd = dataclasses.replace(OPERATOR, intercept=0.0)
    u = np.random.default_rng(0).normal(size=100)
    np.testing.assert_array_equal(odd.run(-u, 0.01)[0], -odd.run(u, 0.01)[0])


def test_memory_is_one_sample():
    _, state = OPERATOR.run([7.0, -3.0, 2.0], 0.01)
    assert state == 2.0
    assert OPERATOR.run([], 0.01, state)[1] == 2.0


def test_first_rate_depends_on_the_initial_state():
    rest = OPERATOR.run([5.0], 1e-4, OPERATOR.init(5.0, "rest"))[0]
    zero = OPERATOR.run([5.0], 1e-4, OPERATOR.init(5.0, "zero"))[0]
    np.testing.assert_allclose(zero - rest, -4e-5 * 5.0 / 1e-4)
