"""The law of a stage with a Bouc-Wen force; what holds for all stages is in test_oscillator.py."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp

from skhyst.hysteresis import BoucWenOperator, BoucWenStageOperator
from skhyst.hysteresis._bouc_wen_stage import branch, branch_tangents, follow, sharpness

W, ZETA, RHO, LEVEL = 60.0, 0.3, 4.0, 0.3
STAGE = BoucWenStageOperator(W, ZETA, RHO, LEVEL, 0.3)


def walk(n):
    u = 0.3 * np.cumsum(np.random.default_rng(0).normal(size=n))
    return u - u[0]


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
    same, same_mean, by_end, by_mean = branch_tangents(*point)
    assert (same, same_mean) == pytest.approx((end, mean), rel=1e-14)
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
    """At rest under a load, which the spring and the hysteretic force share."""
    stage = dataclasses.replace(STAGE, shape=shape, exponent=exponent)

    def rates(_, f):
        slope = RHO * (1.0 - (1.0 + shape) * (f / LEVEL) ** exponent)
        return slope / (1.0 + slope)

    expected = solve_ivp(rates, (0.0, 0.7), [0.0], rtol=1e-10, atol=1e-12).y[0, -1]
    q, _, force, *_ = stage.init(0.7)
    assert force == pytest.approx(expected, rel=1e-6)
    assert q + force == pytest.approx(0.7)


def test_prescribed_motion_gives_the_exactly_integrated_law():
    law = BoucWenOperator.from_coefficients(1.0, 0.5 / 0.3, -0.3 * 0.5 / 0.3)
    q = walk(61)
    found = np.empty_like(q)
    follow(q, 0.6, -0.3, 1.0, found)
    np.testing.assert_allclose(found, law.run(q, 1.0)[0], atol=1e-9)


@pytest.mark.parametrize(("shape", "exponent"), [(0.3, 1.0), (-0.4, 3.0)])
def test_slow_force_is_the_rate_independent_law_of_the_displacement(shape, exponent):
    """In slow motion ``u - q`` is the force that the exactly integrated law gives for q."""
    stage = dataclasses.replace(STAGE, shape=shape, exponent=exponent)
    limit = LEVEL * (1.0 + shape) ** (-1.0 / exponent) / RHO
    law = BoucWenOperator(0.0, RHO, limit, (1.0 - shape) / (1.0 + shape), exponent)
    u = np.interp(np.arange(4001) / 1000.0, [0, 1, 2, 3, 4], [0.0, 1.0, -0.5, 0.7, 0.2])
    q, _ = stage.run(u, 1.0)
    np.testing.assert_allclose(u - q, law.run(q, 1.0)[0], atol=2e-3 * LEVEL)
    np.testing.assert_allclose(stage.run(u, 2.0)[0], q, atol=1e-3 * LEVEL)


@given(
    shape=st.floats(-2.5, 4.0),
    seed=st.integers(0, 1000),
    dt=st.sampled_from([1e-3, 1e-2, 0.1]),
)
@settings(deadline=None, max_examples=30)
def test_no_law_with_positive_beta_is_a_source(shape, seed, dt):
    """For n = 1 the force stores ``int f df / (rho (1 - g |f| / L))`` at most, whatever g."""
    stage = BoucWenStageOperator(30.0, 0.05, 3.0, 0.5, shape, n_substeps=1)
    limit = 0.5 / (1.0 + shape) if shape > -1.0 else 0.5
    rng = np.random.default_rng(seed)
    drive = 0.3 * rng.normal()
    state = (*(0.3 * rng.normal(size=2)), 0.99 * limit * rng.uniform(-1.0, 1.0), drive, 1.0)
    energies = []
    for _ in range(30):
        q, p, f, *_ = state
        stored = quad(lambda x: x / (3.0 * (1.0 - shape * x / 0.5)), 0.0, abs(f))[0]
        energies.append(0.5 * (p * p + (q - drive) ** 2) + stored)
        state, _ = stage.step(state, drive, dt)
    assert np.all(np.diff(energies) <= 1e-10 * energies[0])


def test_derivative_by_an_exponent_of_one():
    """From above, since the exponent ends there."""
    u = 0.4 + walk(60)
    _, dy = STAGE.sensitivities(u, np.empty((60, 0)), 0.02)
    runs = [dataclasses.replace(STAGE, exponent=1.0 + 1e-4 * i).run(u, 0.02)[0] for i in range(3)]
    slope = (-3.0 * runs[0] + 4.0 * runs[1] - runs[2]) / 2e-4
    np.testing.assert_allclose(dy[:, 5], slope, atol=1e-4 * np.abs(slope).max())


@pytest.mark.parametrize("level", [1e-90, 1e90])
@pytest.mark.parametrize("rho", [1e-9, 1e9])
@pytest.mark.parametrize("exponent", [1.0, 20.0])
def test_extreme_parameters_give_finite_values(level, rho, exponent):
    stage = BoucWenStageOperator(W, ZETA, rho, level, 0.3, exponent)
    assert np.isfinite(stage.run(walk(40), 0.02)[0]).all()


@pytest.mark.parametrize("shape", [-0.5, 0.7])
@pytest.mark.parametrize("exponent", [1.5, 3.0])
def test_the_law_goes_on_beyond_its_limit(shape, exponent):
    """At the limit ``(1 + shape)^(-1 / n)`` sigma is continuous; beyond it, the slope is zero."""
    limit = (1.0 + shape) ** (-1.0 / exponent)
    inside, outside = (sharpness(limit * part, shape, exponent)[0] for part in (1 - 1e-9, 1 + 1e-9))
    assert outside == pytest.approx(inside, rel=1e-7)
    for w in (0.5 * limit, -1.7 * limit):
        values = np.array([w, shape, exponent])
        _, *exact = sharpness(*values)
        for k, derivative in enumerate(exact):
            h = 1e-6 * np.eye(3)[k]
            difference = (sharpness(*(values + h))[0] - sharpness(*(values - h))[0]) / 2e-6
            assert derivative == pytest.approx(difference, abs=1e-7)
