"""Dahl friction: its laws, and what a fit finds."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from skhyst.hysteresis import DahlOperator
from skhyst.hysteresis._dahl import dahl_step


def test_loop_loses_four_coulomb_forces_times_the_amplitude():
    u = 50.0 * np.sin(np.linspace(0, 4 * np.pi, 200_001))
    y, _ = DahlOperator(0.01, 1.3).run(u, 1e-3)
    half = slice(100_000, None)
    work = np.sum(0.5 * (y[half][1:] + y[half][:-1]) * np.diff(u[half]))
    assert work == pytest.approx(4 * 1.3 * 50.0, rel=1e-3)


def test_exponents_meet_at_one():
    u = np.cumsum(np.random.default_rng(0).normal(size=100))
    y = [DahlOperator(0.8, 1.3, exponent=n).run(u, 1.0)[0] for n in (1 - 1e-6, 1, 1 + 1e-6)]
    np.testing.assert_allclose(y[0], y[1], atol=1e-5)
    np.testing.assert_allclose(y[2], y[1], atol=1e-5)


def test_damping_takes_the_velocity_behind():
    u = np.array([1.0, 1.0, 3.0, 2.0])
    y, _ = DahlOperator(1.0, 0.0, stiffness=2.0, damping=0.1, intercept=5.0).run(u, 0.5)
    np.testing.assert_allclose(y, 5.0 + 2.0 * u + 0.1 * np.array([0.0, 0.0, 4.0, -2.0]))


EXPONENTS = [0.5, 1.0, 1.7, 3.0]


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_far_below_sliding_it_is_a_spring_to_the_last_digits(exponent):
    """As where data do not reach sliding: force and displacement are large, their ratio is not."""
    u = np.random.default_rng(0).normal(size=50)
    y, _ = DahlOperator(1e13, 3e13, exponent=exponent).run(u, 1.0)
    np.testing.assert_allclose(y, 3.0 * u, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("exponent", EXPONENTS)
@pytest.mark.parametrize("change", [-2.0, -0.1, 1e-6, 0.3, 1.9])
@pytest.mark.parametrize("w", [-0.95, 0.0, 0.6])
def test_closed_form_solves_the_equation(exponent, change, w):
    sign = np.sign(change)

    def slope(u, w):
        return np.maximum(1.0 - sign * w, 0.0) ** exponent / 0.7

    end = solve_ivp(slope, (0.0, change), [w], rtol=1e-11, atol=1e-13, max_step=0.01).y[0, -1]
    y, _ = DahlOperator(0.7, 1.0, exponent=exponent).run([change], 1.0, (w, 0.0))
    assert y[0] == pytest.approx(end, abs=2e-8)


@pytest.mark.parametrize("exponent", EXPONENTS)
@pytest.mark.parametrize("w", [-1.0, 1.0, 0.2])
@pytest.mark.parametrize("change", [1e300, -1e300, 1e-300, 0.0])
@pytest.mark.parametrize("x_c", [1e-150, 1e150])
def test_extreme_steps_are_finite(exponent, w, change, x_c):
    operator = DahlOperator(x_c, 1.0, exponent=exponent)
    assert abs(operator.run([change], 1.0, (w, 0.0))[0][0]) <= 1.0
    assert np.isfinite(operator.sensitivities([change], np.ones((1, 1)), 1.0, "zero")[1]).all()


@pytest.mark.parametrize("exponent", [0.5, 1.0, 2.0])
def test_the_slope_at_standstill_is_the_mean_of_both_directions(exponent):
    step, values = 1e-6, (0.3, 2.0, 0.5, 0.0, 0.0, exponent)
    ahead, back = (dahl_step(0.4, 1.0, 1.0 + change, 1e-3, values)[1] for change in (step, -step))
    slope = dahl_step(0.4, 1.0, 1.0, 1e-3, values)[3][2]
    assert slope == pytest.approx((ahead - back) / (2.0 * step), rel=1e-4)
