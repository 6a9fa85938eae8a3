"""The Duhem model: its laws, and what a fit finds."""

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from skhyst.hysteresis import Dahl, Duhem, DuhemOperator

CUBIC = DuhemOperator(2.3, [0.9, 0.1, -0.2], [0.4, 0.1, 0.2], 0.1, center=0.21, scale=1.3)


def test_solves_the_equation_of_coleman_and_hodgdon():
    u = np.cumsum(np.random.default_rng(0).normal(size=30)) * 0.7
    u -= u[0]

    def f(u):
        t = (u - 0.21) / 1.3
        return 1.3 * (0.9 * t + 0.1 * t**2 - 0.2 * t**3)

    def g(u):
        t = (u - 0.21) / 1.3
        return 0.4 + 0.1 * t + 0.2 * t**2

    # the memory starts at zero: the response stands on f
    h, expected = np.array([f(0.0)]), np.empty(30)
    for k in range(30):
        if k and u[k] != u[k - 1]:
            sign = np.sign(u[k] - u[k - 1])

            def slope(x, h, sign=sign):
                return sign * 2.3 * (f(x) - h) + g(x)

            span = (u[k - 1], u[k])
            h = solve_ivp(slope, span, h, rtol=1e-11, atol=1e-13, method="DOP853").y[:, -1]
        expected[k] = h[0] + 0.1
    np.testing.assert_allclose(CUBIC.run(u, 1.0)[0], expected, atol=1e-8)


def test_periodic_drive_ends_in_one_loop_of_positive_area():
    u = np.sin(np.linspace(0, 40 * np.pi, 40_001))
    y, _ = DuhemOperator(2.5, [0.9], [3.4]).run(u, 1.0)
    np.testing.assert_allclose(y[-2000:], y[-4000:-2000], atol=1e-10)
    last = slice(-2001, None)
    assert np.sum(0.5 * (y[last][1:] + y[last][:-1]) * np.diff(u[last])) > 0.1


@pytest.mark.parametrize("slope", [0.9, 0.9 - 1e-12])
def test_equal_slopes_have_no_memory(slope):
    u = np.cumsum(np.random.default_rng(0).normal(size=50))
    np.testing.assert_allclose(DuhemOperator(2.5, [0.9], [slope]).run(u, 1.0)[0], 0.9 * u)


def test_long_memory_leaves_the_slope():
    u = np.cumsum(np.random.default_rng(0).normal(size=50))
    y, _ = DuhemOperator(1e-9, [0.9], [0.3]).run(u, 1.0)
    np.testing.assert_allclose(y, 0.3 * u, atol=1e-6)


@pytest.mark.parametrize("degree", [1, 2, 5, 9])
@pytest.mark.parametrize("x", [0.0, 1e-9, 0.019, 0.021, 0.249, 0.251, 0.999, 1.001, 6.0, 300.0])
def test_memory_of_one_step_is_an_integral(x, degree):
    points = [max(1.0 - 30.0 / max(x, 1.0), 0.0)]
    for i in range(degree):
        operator = DuhemOperator(x, np.zeros(degree), np.eye(degree)[i])
        expected, _ = quad(
            lambda a, i=i: np.exp(-x * (1.0 - a)) * a**i, 0, 1, epsabs=1e-14, points=points
        )
        # upwards, x just above 1, the error grows by i a step
        assert operator.run([0.0, 1.0], 1.0)[0][1] == pytest.approx(
            expected, rel=1e-13 if i < 4 else 1e-8
        )


U = np.sin(np.linspace(0, 20, 800)) * np.linspace(0, 1, 800) + 0.3


def test_degree_one_is_dahl_friction_with_a_spring():
    y, _ = DuhemOperator(2.0, [1.0, 0.3], [3.0, 0.5], center=0.3).run(U, 1.0)
    duhem = Duhem().fit(U[:, None], y)
    dahl = Dahl(fit_stiffness=True, fit_damping=False).fit(U[:, None], y)
    np.testing.assert_allclose(duhem.predict(U[:, None]), dahl.predict(U[:, None]), atol=1e-4)
    assert Duhem(2).fit(U[:, None], y).fit_error_ < 0.01 * duhem.fit_error_


def test_at_rest_the_tangent_is_the_mean_of_both_ways():
    operator = DuhemOperator(3.1, np.array([0.9]), np.array([0.4]), 0.1)
    u, way = np.array([0.3, 0.7, 0.7, 0.2]), np.array([0.0, 0.0, 1.0, 0.0])
    tangent = operator.sensitivities(u, way[:, None], 0.01, operator.init(u[0]))[1][:, 0]
    up, down = (operator.run(u + h * way, 0.01, operator.init(u[0]))[0] for h in (1e-6, -1e-6))
    np.testing.assert_allclose(tangent, (up - down) / 2e-6, atol=1e-5)
    assert np.abs(up + down - 2.0 * operator.run(u, 0.01)[0]).max() > 1e-7  # there is a kink
