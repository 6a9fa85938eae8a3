"""The loops of the Dahl model: compiled against plain Python, closed form against integration."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from skhyst.hysteresis._dahl import dahl_run, dahl_step, dahl_tangents
from skhyst.operators import as_signal

EXPONENTS = [0.5, 1.0, 1.7, 3.0]


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_compiled_equals_python(exponent):
    rng = np.random.default_rng(0)
    u = as_signal(np.append(np.cumsum(rng.normal(size=200)), [0.3, 0.3]))
    du = as_signal(rng.normal(size=(202, 3)))
    results = []
    for run, tangents in ((dahl_run, dahl_tangents), (dahl_run.py_func, dahl_tangents.py_func)):
        out, again, dout = np.empty(202), np.empty(202), np.empty((202, 4))
        run(u, 0.0, 0.0, 0.7, exponent, out)
        tangents(u, du, 0.7, exponent, again, dout)
        np.testing.assert_array_equal(out, again)
        results.append((out, dout))
    for compiled, python in zip(*results, strict=True):
        np.testing.assert_allclose(compiled, python, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("exponent", EXPONENTS)
@pytest.mark.parametrize("change", [-2.0, -0.1, 1e-6, 0.3, 1.9])
@pytest.mark.parametrize("w", [-0.95, 0.0, 0.6])
def test_closed_form_solves_the_equation(exponent, change, w):
    sign = np.sign(change)

    def slope(u, w):
        return np.maximum(1.0 - sign * w, 0.0) ** exponent / 0.7

    end = solve_ivp(slope, (0.0, change), [w], rtol=1e-11, atol=1e-13, max_step=0.01).y[0, -1]
    assert dahl_step(w, change, 0.7, exponent)[0] == pytest.approx(end, abs=2e-8)


@pytest.mark.parametrize("exponent", EXPONENTS)
@pytest.mark.parametrize("w", [-1.0, 1.0, 0.2])
@pytest.mark.parametrize("change", [1e300, -1e300, 1e-300, 0.0])
@pytest.mark.parametrize("x_c", [1e-150, 1e150])
def test_extreme_steps_are_finite(exponent, w, change, x_c):
    found = dahl_step(w, change, x_c, exponent)
    assert np.isfinite(found).all()
    assert abs(found[0]) <= 1.0
