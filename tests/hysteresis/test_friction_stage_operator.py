"""The laws of a stage with LuGre friction in its equation of motion."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from skhyst.hysteresis import FrictionStageOperator
from skhyst.linear import SecondOrderModeOperator

W, ZETA, FS, RATIO, VS, RHO, BRISTLE = 60.0, 0.3, 0.3, 0.65, 4.0, 10.0, 0.2
STAGE = FrictionStageOperator(W, ZETA, FS, RATIO, VS, RHO, BRISTLE)


def walk(n, seed=0):
    u = 0.3 * np.cumsum(np.random.default_rng(seed).normal(size=n))
    return u - u[0]


def rates(t, x, start, end, t0, dt):
    """Return the equation of motion; the drive is a line from ``start`` to ``end``."""
    q, v, f = x
    drive = start + (end - start) * (t - t0) / dt
    slip = v - abs(v) * f / (FS * (RATIO + (1.0 - RATIO) * np.exp(-((v / VS) ** 2))))
    force = drive - q - f - 2.0 * BRISTLE / W * slip
    return [v, W * W * force - 2.0 * ZETA * W * v, RHO * slip]


def test_order_of_convergence():
    dt, u = 0.02, walk(50)
    x, reference = [0.0, 0.0, 0.0], [0.0]
    for k in range(1, len(u)):
        t0 = dt * (k - 1)
        x = solve_ivp(
            rates,
            (t0, t0 + dt),
            x,
            args=(u[k - 1], u[k], t0, dt),
            method="LSODA",
            rtol=1e-10,
            atol=1e-12,
        ).y[:, -1]
        reference.append(x[0])
    substeps = np.array([8, 16, 32, 64])
    errors = [
        np.sqrt(
            np.mean((dataclasses.replace(STAGE, n_substeps=int(n)).run(u, dt)[0] - reference) ** 2)
        )
        for n in substeps
    ]
    order = -np.polyfit(np.log(substeps), np.log(errors), 1)[0]
    assert 1.8 < order < 2.3
    assert errors[-1] < 3e-5 * np.std(reference)


@pytest.mark.parametrize("n_substeps", [1, 7])
@pytest.mark.parametrize("damping_ratio", [0.05, 3.0])
def test_without_friction_it_is_the_linear_mode(damping_ratio, n_substeps):
    stage = FrictionStageOperator(
        W, damping_ratio, 0.0, RATIO, VS, RHO, gain=2.0, intercept=0.3, n_substeps=n_substeps
    )
    mode = SecondOrderModeOperator(W, damping_ratio, 2.0, 0.3)
    u = 0.5 + walk(80)
    np.testing.assert_allclose(stage.run(u, 0.02)[0], mode.run(u, 0.02)[0], rtol=1e-9, atol=1e-9)


def test_before_sliding_it_is_a_stiffer_linear_mode():
    """Far below the limit the bristles are a spring and a damper."""
    stage = dataclasses.replace(STAGE, n_substeps=64, static_level=1e7)
    w = W * np.sqrt(1.0 + RHO)
    mode = SecondOrderModeOperator(w, (ZETA + BRISTLE) * W / w, 1.0 / (1.0 + RHO))
    u = walk(60)
    expected = mode.run(u, 0.01)[0]
    np.testing.assert_allclose(stage.run(u, 0.01)[0], expected, atol=1e-3 * np.abs(expected).max())


@given(
    logs=st.tuples(*(st.floats(-2.0, 3.0) for _ in range(4))),
    ratio=st.floats(0.0, 1.0),
    damping=st.floats(1e-3, 3.0),
    seed=st.integers(0, 1000),
    dt=st.sampled_from([1e-4, 1e-2, 1.0]),
)
@settings(deadline=None, max_examples=40)
def test_energy_is_dissipated_at_any_step(logs, ratio, damping, seed, dt):
    """While the drive rests, kinetic, spring's and bristles' energy does not grow.

    It holds for one step as for a thousand, however stiff the stage and coarse the step are.
    """
    level, vs, rho, w = 10.0 ** np.array(logs)
    stage = FrictionStageOperator(w, damping, level, ratio, vs, rho, n_substeps=1)
    rng = np.random.default_rng(seed)
    drive = rng.normal()
    state = (*rng.normal(size=2), level * rng.uniform(-1.0, 1.0), drive)
    energies = []
    for _ in range(50):
        q, p, f, _ = state
        energies.append(0.5 * (p * p + (q - drive) ** 2 + f * f / rho))
        state, _ = stage.step(state, drive, dt)
    assert np.all(np.diff(energies) <= 1e-12 * energies[0])


def test_it_sticks_below_the_limit():
    """A stage at rest in the middle stays there, but for the bend of the bristles."""
    stage = FrictionStageOperator(W, ZETA, 1.0, 0.8, VS, 1e4, n_substeps=32)
    time = 1e-3 * np.arange(4000)
    u = 0.5 * np.sin(8.0 * time)
    y, _ = stage.run(u, 1e-3)
    assert np.abs(y).max() < 1.5 * 0.5 / 1e4
    moving, _ = stage.run(4.0 * u, 1e-3)
    assert np.abs(moving).max() > 0.5


def test_slow_sliding_takes_the_static_force_and_fast_sliding_the_coulomb_force():
    """On a ramp the stage lags behind by friction and viscous force."""
    for velocity, level in ((0.01, FS), (40.0, FS * RATIO)):
        stage = dataclasses.replace(STAGE, n_substeps=16)
        time = np.linspace(0.0, 4.0, 2001) / (velocity if velocity < 1 else 4.0)
        u = velocity * time
        y, state = stage.run(u, time[1])
        assert u[-1] - y[-1] == pytest.approx(level + 2.0 * ZETA / W * velocity, rel=1e-3)
        assert state[2] == pytest.approx(level, rel=1e-3)


def test_slow_motion_is_independent_of_the_rate():
    stage = dataclasses.replace(STAGE, coulomb_ratio=1.0, bristle_damping=0.0)
    u = np.interp(np.arange(4001) / 1000.0, [0, 1, 2, 3, 4], [0.0, 1.0, -0.5, 0.7, 0.2])
    slow, slower = (stage.run(u, dt)[0] for dt in (0.02, 0.04))
    np.testing.assert_allclose(slow, slower, atol=1e-3)


def test_rest_is_reached_by_a_slow_first_loading():
    stage = dataclasses.replace(STAGE, gain=-2.0, intercept=1.0)
    for end in (0.05, 1.3, -0.8):
        _, state = stage.run(np.linspace(0.0, end, 20001), 0.01, stage.init(0.0))
        np.testing.assert_allclose(state, stage.init(end), atol=2e-4)


def test_feedback_is_undone_by_its_opposite():
    stage = dataclasses.replace(STAGE, gain=-2.0, intercept=1.0, n_substeps=64)
    tied = stage.with_feedback(-1.5, 0.7)
    np.testing.assert_allclose(tied.with_feedback(1.5, 0.7).pack(), stage.pack(), rtol=1e-12)
    u = walk(200)
    y, _ = stage.run(u, 1e-3)
    tied = stage.with_feedback(-1.5, 1.0)
    again, _ = tied.run(u - 1.5 * (y - 1.0), 1e-3)
    np.testing.assert_allclose(again, y, atol=2e-4 * np.ptp(y))


def test_physical_quantities_solve_the_equation_of_motion():
    stage = dataclasses.replace(STAGE, gain=-2.0, intercept=1.0, n_substeps=32)
    p = stage.physical(mass=3.0)
    dt, u = 2e-3, 0.8 * np.sin(0.02 * np.arange(600))
    y, _ = stage.run(u, dt)

    def motion(t, s):
        x, v, z = s
        g = p["coulomb_force"] + (p["static_force"] - p["coulomb_force"]) * np.exp(
            -((v / p["stribeck_velocity"]) ** 2)
        )
        slip = v - p["bristle_stiffness"] * abs(v) / g * z
        friction = p["bristle_stiffness"] * z + p["bristle_damping"] * slip
        drive = p["drive_gain"] * np.interp(t, dt * np.arange(600), u)
        force = drive - p["stiffness"] * x - p["damping"] * v - friction
        return [v, force / p["mass"], slip]

    time = dt * np.arange(600)
    x = solve_ivp(
        motion, (0.0, time[-1]), [0.0] * 3, t_eval=time, method="LSODA", rtol=1e-7, max_step=dt
    ).y[0]
    np.testing.assert_allclose(y - 1.0, x, atol=1e-4 * np.ptp(x))


@pytest.mark.parametrize("unit", [1e-12, 1e12])
def test_unit_of_the_drive(unit):
    u = walk(60)
    scaled = dataclasses.replace(
        STAGE, static_level=FS * unit, stribeck_velocity=VS * unit, gain=1.0 / unit
    )
    np.testing.assert_allclose(scaled.run(unit * u, 0.02)[0], STAGE.run(u, 0.02)[0], rtol=1e-9)


@pytest.mark.parametrize("n", [0, -1, 2.0, True, None])
def test_wrong_number_of_substeps(n):
    with pytest.raises(ValueError, match="'n_substeps' parameter of FrictionStageOperator"):
        dataclasses.replace(STAGE, n_substeps=n)


def test_extreme_parameters_give_finite_values():
    u = walk(40)
    for level in (1e-90, 1e90):
        for vs in (1e-90, 1e90):
            for rho in (1e-9, 1e9):
                stage = FrictionStageOperator(W, ZETA, level, RATIO, vs, rho, BRISTLE)
                y, dy = stage.linearize(u, np.ones((40, 1)), 0.02)
                assert np.isfinite(y).all()
                # the derivative by a level of 1e-90 itself may be anything
                assert np.isfinite(dy[:, [0, 1, 2, 6, 7, 8, 9]]).all()
