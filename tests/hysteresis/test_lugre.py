"""LuGre friction: its laws, and what a fit finds."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import solve_ivp

from skhyst.hysteresis import LuGre, LuGreOperator

drives = arrays(float, st.integers(2, 40), elements=st.floats(-50, 50, allow_subnormal=False))
FRICTION = LuGreOperator(0.02, 0.3, 0.6, 5.0, bristle_damping=0.2, damping=0.7, intercept=-1.0)


@pytest.mark.parametrize("v", [-20.0, -0.3, -1e-3, 1e-4, 0.05, 0.3, 1.0, 20.0])
def test_steady_sliding_is_the_stribeck_curve(v):
    u = v * np.linspace(0.0, 2.0 / abs(v), 1001)
    y, _ = FRICTION.run(u, 2e-3 / abs(v))
    level = 3.0 + 2.0 * np.exp(-((v / 0.3) ** 2))
    assert y[-1] == pytest.approx(np.sign(v) * level + 0.7 * v - 1.0, rel=1e-12)
    assert FRICTION.coulomb_force == pytest.approx(3.0, rel=1e-14)
    assert FRICTION.bristle_stiffness == pytest.approx(250.0, rel=1e-14)


@settings(deadline=None, max_examples=40)
@given(drives, st.sampled_from([1e-6, 1e-2, 1.0, 1e4]), st.floats(0.0, 1.0))
def test_bristles_never_bend_further_than_the_static_force(u, dt, ratio):
    operator = LuGreOperator(0.02, 0.3, ratio, 5.0)
    y, (w, _) = operator.run(u, dt)
    assert np.abs(y).max() <= 5.0 * (1 + 1e-12)
    assert abs(w) <= 1 + 1e-12


def test_stiff_bristles_are_stable():
    u = np.sin(np.linspace(0, 20, 200))
    y, _ = LuGreOperator(1e-9, 0.3, 0.6, 5.0, bristle_damping=10.0).run(u, 0.1)
    assert np.abs(y).max() <= 5.0


@pytest.mark.parametrize("change", [-0.5, -0.01, 1e-7, 0.003, 0.02])
@pytest.mark.parametrize("w", [-0.9, 0.0, 0.55])
def test_exact_step_solves_the_equation(change, w):
    x_s, v_s, ratio = 0.07, 0.8, 0.55
    dt, v = 0.01, change / 0.01
    gamma = ratio + (1.0 - ratio) * np.exp(-((v / v_s) ** 2))

    def rate(t, w):
        return (v - abs(v) * w / gamma) / x_s

    solution = solve_ivp(rate, (0.0, dt), [w], rtol=1e-12, atol=1e-14, method="DOP853")
    _, (bent, _) = LuGreOperator(x_s, v_s, ratio, 1.0).run([change], dt, (w, 0.0))
    assert bent == pytest.approx(solution.y[0, -1], abs=1e-11)
    # the slip speed is that of the equation at the end of the step
    slip, _ = LuGreOperator(x_s, v_s, ratio, 0.0, 1.0).run([change], dt, (w, 0.0))
    assert slip[0] == pytest.approx(x_s * rate(dt, bent), abs=1e-11)


@pytest.mark.parametrize("w", [-1.0, 1.0, 0.2])
@pytest.mark.parametrize("change", [1e100, -1e100, 1e-100, 0.0])
@pytest.mark.parametrize("x_s", [1e-100, 1e100])
@pytest.mark.parametrize("ratio", [0.0, 1.0])
def test_extreme_steps_are_finite(w, change, x_s, ratio):
    operator = LuGreOperator(x_s, 0.8, ratio, 1.0, bristle_damping=1.0)
    y, (bent, _) = operator.run([change], 1e-3, (w, 0.0))
    assert np.isfinite(y[0])
    assert abs(bent) <= 1.0
    for initial_state in ("rest", "zero"):
        _, dy = operator.sensitivities([change], np.ones((1, 1)), 1e-3, initial_state)
        assert np.isfinite(dy).all()


DT = 0.005
T = DT * np.arange(3000)
U = np.sin(T) + 0.3 * np.sin(4.4 * T) + 0.03 * np.sin(13.0 * T)


def test_no_stribeck_effect_is_a_ratio_at_its_bound():
    y, _ = LuGreOperator(0.05, 1.0, 1.0, 8.0, 0.4, damping=0.3).run(U, DT)
    y += 0.02 * np.random.default_rng(0).normal(size=len(y))
    model = LuGre(stribeck=False, dt=DT).fit(U[:, None], y)
    freer = LuGre(dt=DT)
    freer.fit(U[:, None], y)
    assert freer.operator_.coulomb_ratio > 0.98
    assert freer.fit_error_ == pytest.approx(model.fit_error_, rel=1e-3)
