"""The laws of a stage with a Bouc-Wen force in its equation of motion."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp

from skhyst.hysteresis import BoucWenOperator, BoucWenStageOperator
from skhyst.linear import SecondOrderModeOperator

W, ZETA, RHO, LEVEL = 60.0, 0.3, 4.0, 0.3
STAGE = BoucWenStageOperator(W, ZETA, RHO, LEVEL, 0.3)


def walk(n, seed=0):
    u = 0.3 * np.cumsum(np.random.default_rng(seed).normal(size=n))
    return u - u[0]


def reference(p, u, dt, **options):
    """Integrate the equation of motion of the physical quantities ``p`` between samples."""

    def rates(t, x, start, end, t0):
        position, v, z = x
        drive = p["drive_gain"] * (start + (end - start) * (t - t0) / dt)
        force = drive - p["stiffness"] * position - p["damping"] * v - z
        n = p["n"]
        slip = p["beta"] * abs(v) * abs(z) ** n * np.sign(z) + p["gamma"] * v * abs(z) ** n
        return [v, force / p["mass"], p["alpha"] * v - slip]

    x, found = [0.0, 0.0, 0.0], [0.0]
    for k in range(1, len(u)):
        t0 = dt * (k - 1)
        arguments = u[k - 1], u[k], t0
        x = solve_ivp(rates, (t0, t0 + dt), x, args=arguments, max_step=dt / 4, **options).y[:, -1]
        found.append(x[0])
    return np.array(found)


@pytest.mark.parametrize(("shape", "exponent"), [(0.3, 1.0), (1.6, 2.0), (-1.2, 1.0)])
def test_order_of_convergence(shape, exponent):
    """Against an integration of the printed equations, for a drive that pulls the other way too."""
    stage = dataclasses.replace(STAGE, shape=shape, exponent=exponent, gain=-2.0)
    dt, u = 0.01, 0.6 * walk(60)
    p = stage.physical(mass=3.0) | {"n": exponent}
    expected = reference(p, u, dt, method="LSODA", rtol=1e-9, atol=1e-10)
    substeps = np.array([4, 8, 16, 32])
    errors = [
        np.sqrt(
            np.mean((dataclasses.replace(stage, n_substeps=int(n)).run(u, dt)[0] - expected) ** 2)
        )
        for n in substeps
    ]
    order = -np.polyfit(np.log(substeps), np.log(errors), 1)[0]
    assert 1.7 < order < 2.4
    assert errors[-1] < 1e-3 * np.std(expected)


@pytest.mark.parametrize("off", [{"level": 0.0}, {"hysteresis_stiffness": 1e-12}])
def test_without_hysteretic_force_it_is_the_linear_mode(off):
    stage = dataclasses.replace(STAGE, gain=2.0, intercept=0.3, n_substeps=3, **off)
    u = 0.5 + walk(80)
    expected = SecondOrderModeOperator(W, ZETA, 2.0, 0.3).run(u, 0.02)[0]
    np.testing.assert_allclose(stage.run(u, 0.02)[0], expected, rtol=1e-9, atol=1e-9)


def test_small_motion_is_that_of_a_stiffer_linear_mode():
    stage = dataclasses.replace(STAGE, level=1e7, n_substeps=64)
    w = W * np.sqrt(1.0 + RHO)
    mode = SecondOrderModeOperator(w, ZETA * W / w, 1.0 / (1.0 + RHO))
    u = walk(60)
    expected = mode.run(u, 0.01)[0]
    np.testing.assert_allclose(stage.run(u, 0.01)[0], expected, atol=1e-3 * np.abs(expected).max())


@given(
    logs=st.tuples(*(st.floats(-2.0, 3.0) for _ in range(3))),
    shape=st.floats(-1.0, 1.0),
    exponent=st.sampled_from([1.0, 1.5, 2.0, 6.0]),
    damping=st.floats(1e-3, 3.0),
    seed=st.integers(0, 1000),
    dt=st.sampled_from([1e-4, 1e-2, 1.0]),
)
@settings(deadline=None, max_examples=40)
def test_energy_is_dissipated_at_any_step(logs, shape, exponent, damping, seed, dt):
    """While the drive rests, kinetic, spring's and hysteresis' energy does not grow."""
    rho, level, w = 10.0 ** np.array(logs)
    stage = BoucWenStageOperator(w, damping, rho, level, shape, exponent, n_substeps=1)
    limit = min(level * (1.0 + shape) ** (-1.0 / exponent) if shape > -1.0 else np.inf, 1e3 * level)
    rng = np.random.default_rng(seed)
    drive = rng.normal()
    state = (*rng.normal(size=2), limit * rng.uniform(-1.0, 1.0), drive)
    energies = []
    for _ in range(50):
        q, p, f, _ = state
        energies.append(0.5 * (p * p + (q - drive) ** 2 + f * f / rho))
        state, _ = stage.step(state, drive, dt)
    assert np.all(np.diff(energies) <= 1e-12 * energies[0])


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
    state = (*(0.3 * rng.normal(size=2)), 0.99 * limit * rng.uniform(-1.0, 1.0), drive)
    energies = []
    for _ in range(30):
        q, p, f, _ = state
        stored = quad(lambda x: x / (3.0 * (1.0 - shape * x / 0.5)), 0.0, abs(f))[0]
        energies.append(0.5 * (p * p + (q - drive) ** 2) + stored)
        state, _ = stage.step(state, drive, dt)
    assert np.all(np.diff(energies) <= 1e-10 * energies[0])


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


@pytest.mark.parametrize(("shape", "exponent"), [(0.3, 1.0), (-0.4, 4.0), (-1.5, 2.0), (2.0, 1.0)])
def test_rest_is_reached_by_a_slow_first_loading(shape, exponent):
    stage = dataclasses.replace(STAGE, shape=shape, exponent=exponent, gain=-2.0, intercept=1.0)
    for end in (0.05, 1.3, -0.8):
        _, state = stage.run(np.linspace(0.0, end, 20001), 0.01, stage.init(0.0))
        np.testing.assert_allclose(state, stage.init(end), atol=2e-4)


def test_feedback_is_undone_by_its_opposite():
    stage = dataclasses.replace(STAGE, gain=-2.0, intercept=1.0, n_substeps=64)
    tied = stage.with_feedback(-1.5, 0.7)
    np.testing.assert_allclose(tied.with_feedback(1.5, 0.7).pack(), stage.pack(), rtol=1e-12)
    u = walk(200)
    y, _ = stage.run(u, 1e-3)
    again, _ = stage.with_feedback(-1.5, 1.0).run(u - 1.5 * (y - 1.0), 1e-3)
    np.testing.assert_allclose(again, y, atol=2e-4 * np.ptp(y))


@pytest.mark.parametrize("unit", [1e-12, 1e12])
def test_unit_of_the_drive(unit):
    u = walk(60)
    scaled = dataclasses.replace(STAGE, level=LEVEL * unit, gain=1.0 / unit)
    np.testing.assert_allclose(scaled.run(unit * u, 0.02)[0], STAGE.run(u, 0.02)[0], rtol=1e-9)


def test_derivative_by_an_exponent_of_one():
    """From above, since the exponent ends there."""
    u = 0.4 + walk(60)
    _, dy = STAGE.linearize(u, np.empty((60, 0)), 0.02)
    runs = [dataclasses.replace(STAGE, exponent=1.0 + 1e-4 * i).run(u, 0.02)[0] for i in range(3)]
    slope = (-3.0 * runs[0] + 4.0 * runs[1] - runs[2]) / 2e-4
    np.testing.assert_allclose(dy[:, 5], slope, atol=1e-4 * np.abs(slope).max())


def test_lost_stage_ends_quietly():
    """A force that hardens without limit, driven far beyond any plant."""
    stage = BoucWenStageOperator(60.0, 0.01, 4.0, 1e-3, -2.0, 3.0)
    u = 50.0 * np.sin(0.5 * np.arange(400))
    y, _ = stage.run(u, 0.05)
    same, dy = stage.linearize(u, np.ones((400, 1)), 0.05)
    np.testing.assert_array_equal(y, same)
    assert np.nanmax(np.abs(y)) < 1e15
    assert not np.isinf(dy).any()
    assert np.isnan(dy[np.isnan(y), 0]).all()


def test_extreme_parameters_give_finite_values():
    u = walk(40)
    for level in (1e-90, 1e90):
        for rho in (1e-9, 1e9):
            for exponent in (1.0, 20.0):
                stage = BoucWenStageOperator(W, ZETA, rho, level, 0.3, exponent)
                assert np.isfinite(stage.run(u, 0.02)[0]).all()


@pytest.mark.parametrize("n", [0, 2.0, None])
def test_wrong_number_of_substeps(n):
    with pytest.raises(ValueError, match="'n_substeps' parameter of BoucWenStageOperator"):
        dataclasses.replace(STAGE, n_substeps=n)
