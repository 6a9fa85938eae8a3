import numpy as np
import pytest
from scipy.integrate import solve_ivp

from skhyst.hysteresis import BoucWenOperator, BoucWenStageOperator
from skhyst.hysteresis._bouc_wen_stage_loops import (
    bouc_wen_run,
    bouc_wen_tangents,
    branch,
    branch_derivatives,
    first_loading,
    follow,
)

U = 0.25 * np.cumsum(np.random.default_rng(3).normal(size=60))


@pytest.mark.parametrize(("behind", "ahead"), [(0.7, 1.3), (-0.6, 2.5), (2.0, -0.4), (0.0, 0.0)])
@pytest.mark.parametrize("w", [-0.3, -0.02, 0.0, 0.3])
@pytest.mark.parametrize("t", [1e-3, 0.05, 0.4, 3.0])
def test_branch(t, w, behind, ahead):
    """Against an integration of the piecewise linear equation and of its mean."""

    def rates(_, x):
        return [1.0 - (behind if x[0] < 0.0 else ahead) * x[0], x[0]]

    x = solve_ivp(rates, (0.0, t), [w, 0.0], rtol=1e-10, atol=1e-12, max_step=t / 50).y[:, -1]
    end, mean, slope = branch(t, w, behind, ahead)
    assert end == pytest.approx(x[0], abs=1e-7)
    assert mean == pytest.approx(x[1] / t, abs=1e-7)
    point = np.array([t, w, behind, ahead])
    by_end, by_mean = branch_derivatives(*point)
    assert by_mean[0] == pytest.approx(slope, abs=1e-12)
    for i in range(4):
        if i == 1 and w == 0.0:
            continue  # a kink
        step = np.zeros(4)
        step[i] = 1e-6
        high, low = branch(*(point + step)), branch(*(point - step))
        assert by_end[i] == pytest.approx((high[0] - low[0]) / 2e-6, abs=1e-7)
        assert by_mean[i] == pytest.approx((high[1] - low[1]) / 2e-6, abs=1e-7)


@pytest.mark.parametrize(("shape", "exponent"), [(0.3, 1.0), (-0.5, 2.5), (-1.6, 1.4), (2.0, 8.0)])
def test_first_loading(shape, exponent):
    rho, level = 3.0, 0.4

    def rates(_, f):
        slope = rho * (1.0 - (1.0 + shape) * (f / level) ** exponent)
        return slope / (1.0 + slope)

    by = np.empty(5)
    found = first_loading(0.7, rho, level, shape, exponent, by)
    expected = solve_ivp(rates, (0.0, 0.7), [0.0], rtol=1e-10, atol=1e-12).y[0, -1]
    assert found == pytest.approx(expected, rel=1e-6)
    point, other = np.array([0.7, rho, level, shape, exponent]), np.empty(5)
    for i in range(5):
        step = np.zeros(5)
        step[i] = 1e-6
        values = [first_loading(*(point + sign * step), other) for sign in (1.0, -1.0)]
        assert by[i] == pytest.approx((values[0] - values[1]) / 2e-6, abs=1e-6)


def test_prescribed_motion_gives_the_exactly_integrated_law():
    law = BoucWenOperator.from_coefficients(1.0, 0.5 / 0.3, -0.3 * 0.5 / 0.3)
    q = np.concatenate([[0.0], U])
    found = np.empty_like(q)
    follow(q, 0.6, -0.3, 1.0, found)
    np.testing.assert_allclose(found, law.run(q, 1.0)[0], atol=1e-9)


@pytest.mark.parametrize("exponent", [1.0, 2.3])
def test_compiled_equals_plain_python(exponent):
    stage = BoucWenStageOperator(90.0, 0.15, 2.0, 0.2, 0.4, exponent, n_substeps=3)
    h, mode = stage._substep(0.01)
    head = (mode, stage._law(U), h, 3, U, U[0], 0.1, 0.0, 0.05)
    y, expected = np.empty((2, U.size))
    last = bouc_wen_run(*head, y)
    assert bouc_wen_run.py_func(*head, expected) == pytest.approx(last, rel=1e-12)
    np.testing.assert_allclose(y, expected, rtol=1e-12, atol=1e-14)
    rng = np.random.default_rng(0)
    du, dbefore = rng.normal(size=(U.size, 2)), rng.normal(size=2)
    du.flags.writeable = dbefore.flags.writeable = False
    d = rng.normal(size=(3, 8))
    head = (mode, stage._substep_tangents(0.01), stage._law(U), h, 3, U, du, U[0], dbefore)
    results = []
    for function in (bouc_wen_tangents, bouc_wen_tangents.py_func):
        y, dy = np.empty(U.size), np.empty((U.size, 8))
        function(*head, 0.1, 0.0, 0.05, d.copy(), y, dy)
        results.append((y, dy))
    for found, expected in zip(*results, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-12)
