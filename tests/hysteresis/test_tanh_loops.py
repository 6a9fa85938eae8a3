"""Compiled loops of the hyperbolic tangent model against plain Python, and its derivatives."""

import numpy as np

from skhyst.hysteresis._tanh import tanh_run, tanh_tangents

VALUES = {"dt": 0.01, "k0": 0.3, "alpha": -0.02, "beta": 0.7, "gamma": 1.9}


def test_compiled_equals_python():
    rng = np.random.default_rng(0)
    u, du, dlast = rng.normal(size=50), rng.normal(size=(50, 2)), rng.normal(size=2)
    outputs = []
    for run, tangents in ((tanh_run, tanh_tangents), (tanh_run.py_func, tanh_tangents.py_func)):
        y, dy = np.empty(50), np.empty((50, 7))
        run(u, *VALUES.values(), 0.1, 0.4, y)
        tangents(u, du, *VALUES.values(), 0.4, dlast, dy)
        outputs.append((y, dy))
    np.testing.assert_allclose(outputs[0][0], outputs[1][0], rtol=1e-13, atol=1e-14)
    np.testing.assert_allclose(outputs[0][1], outputs[1][1], rtol=1e-12, atol=1e-13)
    rate = np.diff(u, prepend=0.4) / 0.01
    np.testing.assert_allclose(
        outputs[0][0], 0.1 + 0.3 * u - 0.02 * rate + 0.7 * np.tanh(1.9 * u), atol=1e-13
    )


def test_step_has_no_derivative_by_its_steepness():
    u = np.array([0.0, 1e-3, 2.0, -5.0])
    dy = np.empty((4, 5))
    tanh_tangents(u, np.empty((4, 0)), 0.01, 0.3, 0.0, 0.7, 5e5, 0.0, np.empty(0), dy)
    np.testing.assert_array_equal(dy[:, 2], np.sign(u))
    np.testing.assert_array_equal(dy[:, 3], 0.0)
