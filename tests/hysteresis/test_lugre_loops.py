"""The loops of the LuGre model: compiled against plain Python, exact step against integration."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from skhyst.hysteresis._lugre import lugre_run, lugre_step, lugre_tangents
from skhyst.operators import as_signal

SHAPE = (0.07, 0.8, 0.55)


def test_compiled_equals_python():
    rng = np.random.default_rng(0)
    u = as_signal(np.append(0.1 * np.cumsum(rng.normal(size=200)), [0.3, 0.3]))
    du = as_signal(rng.normal(size=(202, 3)))
    dw, dbefore = rng.normal(size=6), as_signal(rng.normal(size=3))
    results = []
    for run, tangents in ((lugre_run, lugre_tangents), (lugre_run.py_func, lugre_tangents.py_func)):
        first, again = np.empty((2, 202)), np.empty((2, 202))
        dout, dslip = np.empty((2, 202, 6))
        run(u, 0.1, 0.2, 0.01, *SHAPE, *first)
        tangents(u, du, 0.1, dbefore, 0.2, dw, 0.01, *SHAPE, *again, dout, dslip)
        np.testing.assert_array_equal(first, again)
        results.append((first, dout, dslip))
    for compiled, python in zip(*results, strict=True):
        np.testing.assert_allclose(compiled, python, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("change", [-0.5, -0.01, 1e-7, 0.003, 0.02])
@pytest.mark.parametrize("w", [-0.9, 0.0, 0.55])
def test_exact_step_solves_the_equation(change, w):
    x_s, v_s, ratio = SHAPE
    dt, v = 0.01, change / 0.01
    gamma = ratio + (1.0 - ratio) * np.exp(-((v / v_s) ** 2))

    def rate(t, w):
        return (v - abs(v) * w / gamma) / x_s

    solution = solve_ivp(rate, (0.0, dt), [w], rtol=1e-12, atol=1e-14, method="DOP853")
    found = lugre_step(w, change, dt, *SHAPE)
    assert found[0] == pytest.approx(solution.y[0, -1], abs=1e-11)
    # the slip speed is that of the equation at the end of the step
    assert found[8] == pytest.approx(x_s * rate(dt, found[0]), abs=1e-11)


@pytest.mark.parametrize("w", [-1.0, 1.0, 0.2])
@pytest.mark.parametrize("change", [1e100, -1e100, 1e-100, 0.0])
@pytest.mark.parametrize("x_s", [1e-100, 1e100])
@pytest.mark.parametrize("ratio", [0.0, 1.0])
def test_extreme_steps_are_finite(w, change, x_s, ratio):
    found = lugre_step(w, change, 1e-3, x_s, 0.8, ratio)
    assert np.isfinite(found).all()
    assert abs(found[0]) <= 1.0
