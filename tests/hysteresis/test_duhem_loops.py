"""The loops of the Duhem model: compiled against plain Python, closed form against integration."""

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from skhyst.hysteresis._duhem import duhem_moments, duhem_run, duhem_tangents, exponential_moments
from skhyst.operators import as_signal

SHAPE = (2.3, 0.2, 1.4)  # alpha, center, scale


@pytest.mark.parametrize("d", [1, 2, 4])
def test_compiled_equals_python(d):
    rng = np.random.default_rng(d)
    u = as_signal(np.append(np.cumsum(rng.normal(size=100)), [0.3, 0.3]))
    du = as_signal(rng.normal(size=(102, 3)))
    results = []
    for run, tangents in ((duhem_run, duhem_tangents), (duhem_run.py_func, duhem_tangents.py_func)):
        out, again, dout = np.empty((102, d)), np.empty((102, d)), np.empty((102, d, 4))
        run(u, 0.0, np.zeros(d), *SHAPE, out)
        tangents(u, du, *SHAPE, again, dout)
        np.testing.assert_allclose(out, again, rtol=1e-12, atol=1e-13)
        results.append((out, dout))
    for compiled, python in zip(*results, strict=True):
        np.testing.assert_allclose(compiled, python, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("count", [1, 2, 5, 10])
@pytest.mark.parametrize("x", [0.0, 1e-9, 0.019, 0.021, 0.249, 0.251, 0.999, 1.001, 6.0, 300.0])
def test_exponential_moments(x, count):
    moments = np.empty(count)
    assert exponential_moments(x, moments) == pytest.approx(np.exp(-x), rel=1e-13, abs=1e-15)
    for i, value in enumerate(moments):
        points = [max(1.0 - 30.0 / max(x, 1.0), 0.0)]
        expected, _ = quad(
            lambda a, i=i: np.exp(-x * (1.0 - a)) * a**i, 0, 1, epsabs=1e-14, points=points
        )
        # upwards, x just above 1, the error grows by i a step
        assert value == pytest.approx(expected, rel=1e-13 if i < 4 else 1e-8)


def test_moments_of_shifted_powers():
    x, t0, step = 0.7, 1.3, -0.4
    moments = np.empty((2, 4))
    duhem_moments(x, t0, step, np.empty(5), moments)
    for i in range(2):
        for j in range(4):
            expected, _ = quad(
                lambda a, i=i, j=j: np.exp(-x * (1.0 - a)) * a**i * (t0 + step * a) ** j, 0, 1
            )
            assert moments[i, j] == pytest.approx(expected, abs=1e-13)


@pytest.mark.parametrize("change", [-3.0, -1e-3, 0.4, 5.0])
def test_closed_form_solves_the_equation(change):
    alpha, center, scale = SHAPE
    sign, start = np.sign(change), np.array([0.3, -0.2, 0.1])

    def slope(u, h):
        return -sign * alpha * h + ((u - center) / scale) ** np.arange(3)

    span = (0.7, 0.7 + change)
    expected = solve_ivp(slope, span, start, rtol=1e-12, atol=1e-14, method="DOP853").y[:, -1]
    out = np.empty((1, 3))
    duhem_run(as_signal([span[1]]), span[0], start, *SHAPE, out)
    np.testing.assert_allclose(out[0], expected, rtol=0, atol=1e-9)
