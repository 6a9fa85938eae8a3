"""Dahl friction: its laws, and what a fit finds."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import solve_ivp

from skhyst.hysteresis import Dahl, DahlOperator

drives = arrays(float, st.integers(2, 40), elements=st.floats(-50, 50, allow_subnormal=False))


exponents = st.sampled_from([0.5, 1.0, 1.6])


def between(u, parts):
    """Return ``u`` with points on the straight lines between its samples."""
    return np.interp(np.arange((len(u) - 1) * parts + 1) / parts, np.arange(len(u)), u)


@settings(deadline=None, max_examples=30)
@given(drives, exponents)
def test_rate_independent(u, exponent):
    operator = DahlOperator(0.8, 1.3, stiffness=0.2, exponent=exponent)
    y, _ = operator.run(u, 1e-3)
    np.testing.assert_array_equal(operator.run(u, 7.0)[0], y)
    fine, _ = operator.run(between(u, 5), 1e-3)
    np.testing.assert_allclose(fine[::5], y, rtol=0, atol=1e-7 if exponent < 1 else 1e-9)


@settings(deadline=None, max_examples=30)
@given(drives, exponents)
def test_never_above_the_coulomb_force(u, exponent):
    y, _ = DahlOperator(0.8, 1.3, exponent=exponent).run(u, 1e-3)
    assert np.abs(y).max() <= 1.3


@settings(deadline=None, max_examples=20)
@given(drives, exponents)
def test_dissipates(u, exponent):
    """The work put in is never below the energy of the bent bristles, which is never negative."""
    u = np.append(0.0, u)
    fine = between(u, 400)
    y, _ = DahlOperator(0.8, 1.3, exponent=exponent).run(fine, 1e-3)
    work = np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(fine))
    assert work.min(initial=0.0) >= -1e-3 * 1.3 * np.abs(np.diff(u)).sum()


def test_loop_loses_four_coulomb_forces_times_the_amplitude():
    u = 50.0 * np.sin(np.linspace(0, 4 * np.pi, 200_001))
    y, _ = DahlOperator(0.01, 1.3).run(u, 1e-3)
    half = slice(100_000, None)
    work = np.sum(0.5 * (y[half][1:] + y[half][:-1]) * np.diff(u[half]))
    assert work == pytest.approx(4 * 1.3 * 50.0, rel=1e-3)


@pytest.mark.parametrize("exponent", [0.5, 1.0, 2.0])
def test_tiny_motion_meets_a_spring(exponent):
    u = 1e-6 * np.sin(np.linspace(0, 20, 500))
    y, _ = DahlOperator(0.8, 1.3, exponent=exponent).run(u, 1e-3)
    np.testing.assert_allclose(y, 1.3 / 0.8 * u, rtol=0, atol=1e-11)


@pytest.mark.parametrize("exponent", [0.5, 1.0, 2.0])
def test_odd(exponent):
    u = np.cumsum(np.random.default_rng(0).normal(size=100))
    operator = DahlOperator(0.8, 1.3, damping=0.1, exponent=exponent)
    np.testing.assert_allclose(operator.run(-u, 0.1)[0], -operator.run(u, 0.1)[0], atol=1e-14)


def test_exponents_meet_at_one():
    u = np.cumsum(np.random.default_rng(0).normal(size=100))
    y = [DahlOperator(0.8, 1.3, exponent=n).run(u, 1.0)[0] for n in (1 - 1e-6, 1, 1 + 1e-6)]
    np.testing.assert_allclose(y[0], y[1], atol=1e-5)
    np.testing.assert_allclose(y[2], y[1], atol=1e-5)


def test_damping_takes_the_velocity_behind():
    u = np.array([1.0, 1.0, 3.0, 2.0])
    y, _ = DahlOperator(1.0, 0.0, stiffness=2.0, damping=0.1, intercept=5.0).run(u, 0.5)
    np.testing.assert_allclose(y, 5.0 + 2.0 * u + 0.1 * np.array([0.0, 0.0, 4.0, -2.0]))


def test_rest_is_a_first_loading_from_zero():
    operator = DahlOperator(0.8, 1.3, damping=0.4)
    loaded, _ = operator.run([0.0, 0.5], 1e-3)
    assert operator.run([0.5], 1e-3)[0][0] == pytest.approx(loaded[1] - 0.4 * 500.0)
    assert operator.run([], 1e-3)[0].shape == (0,)


EXPONENTS = [0.5, 1.0, 1.7, 3.0]


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
    assert np.isfinite(operator.linearize([change], np.ones((1, 1)), 1.0, "zero")[1]).all()


DT = 0.01


U = np.sin(np.linspace(0, 20, 800)) * np.linspace(0, 1, 800)


@pytest.mark.parametrize("exponent", [0.6, 1.0, 1.8])
def test_all_parameters_come_back(exponent):
    plant = DahlOperator(0.12, -3.0, stiffness=1.5, damping=0.2, intercept=7.0, exponent=exponent)
    y, _ = plant.run(U, DT)
    model = Dahl(exponent, fit_stiffness=True, dt=DT).fit(U[:, None], y)
    np.testing.assert_allclose(model.operator_.pack(), plant.pack(), rtol=1e-4)
    np.testing.assert_allclose(model.predict(U[:, None]), y, atol=1e-5)


def test_what_is_not_fitted_stands_at_zero():
    y, _ = DahlOperator(0.12, 3.0, stiffness=1.5, damping=0.2, intercept=7.0).run(U, DT)
    model = Dahl(fit_damping=False, fit_intercept=False, dt=DT).fit(U[:, None], y)
    assert set(model.params_) == {"presliding_displacement", "coulomb_force"}
    operator = model.operator_
    assert (operator.stiffness, operator.damping, operator.intercept) == (0.0, 0.0, 0.0)


def test_first_loading_before_the_record_is_estimated():
    y, _ = DahlOperator(0.12, 3.0).run(np.r_[0.9, U], DT)
    known = {"fit_damping": False, "dt": DT}
    rest = Dahl(**known).fit(U[:, None], y[1:])
    estimated = Dahl(initial_state="estimate", **known).fit(U[:, None], y[1:])
    assert estimated.fit_error_ < 0.1 * rest.fit_error_


@pytest.mark.parametrize("exponent", [0.0, -1.0, "1"])
def test_wrong_exponent(exponent):
    with pytest.raises(ValueError, match="The 'exponent' parameter of Dahl must be"):
        Dahl(exponent).fit(U[:, None], U)
