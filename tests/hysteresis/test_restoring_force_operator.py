"""The laws of a mass with polynomial spring and damper and a bilinear hysteretic force."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from skhyst.hysteresis import RestoringForceOperator
from skhyst.linear import SecondOrderModeOperator

W, ZETA, K, LIMIT = 60.0, 0.3, 4.0, 0.2
STAGE = RestoringForceOperator(W, ZETA, [0.3, 0.1], [0.2], K, LIMIT)


def walk(n, seed=0):
    u = 0.3 * np.cumsum(np.random.default_rng(seed).normal(size=n))
    return u - u[0]


def reference(stage, u, dt):
    """Integrate with a law that is smooth only where the stop neither yields nor returns."""
    s = stage.scale
    springs, dampers = stage.stiffness_coefficients, stage.damping_coefficients

    def motion(t, x, start, end, t0):
        q, v, z = x
        p = v / W
        force = start + (end - start) * (t - t0) / dt + stage.preload - q - z
        force -= sum(c * q * (q / s) ** (2 * i) for i, c in enumerate(springs, 1))
        force -= sum(c * p * (p / s) ** (2 * i) for i, c in enumerate(dampers, 1))
        yields = abs(z) >= LIMIT and z * v > 0.0
        return [v, W * W * force - 2.0 * ZETA * W * v, 0.0 if yields else K * v]

    q, _, z, _ = stage.init(u[0])
    x, found = [q, 0.0, z], [q]
    for k in range(1, len(u)):
        t0 = dt * (k - 1)
        options = {"method": "DOP853", "rtol": 1e-8, "atol": 1e-10, "max_step": dt / 20}
        x = solve_ivp(motion, (t0, t0 + dt), x, args=(u[k - 1], u[k], t0), **options).y[:, -1]
        x[2] = np.clip(x[2], -LIMIT, LIMIT)
        found.append(x[0])
    return np.array(found)


def test_order_of_convergence():
    stage = dataclasses.replace(STAGE, preload=0.1)
    dt, u = 0.02, walk(40)
    expected = reference(stage, u, dt)
    substeps = np.array([4, 8, 16, 32])
    errors = [
        np.sqrt(
            np.mean((dataclasses.replace(stage, n_substeps=int(n)).run(u, dt)[0] - expected) ** 2)
        )
        for n in substeps
    ]
    order = -np.polyfit(np.log(substeps), np.log(errors), 1)[0]
    assert 1.7 < order < 2.4
    assert errors[-1] < 3e-4 * np.std(expected)


@pytest.mark.parametrize("n_substeps", [1, 7])
def test_without_slip_level_and_polynomials_it_is_the_linear_mode(n_substeps):
    stage = RestoringForceOperator(
        W, ZETA, [0.0], [0.0], K, 0.0, gain=2.0, intercept=0.3, n_substeps=n_substeps
    )
    u = 0.5 + walk(80)
    expected = SecondOrderModeOperator(W, ZETA, 2.0, 0.3).run(u, 0.02)[0]
    np.testing.assert_allclose(stage.run(u, 0.02)[0], expected, rtol=1e-9, atol=1e-9)


def test_without_slip_it_is_a_stiffer_linear_mode():
    stage = RestoringForceOperator(W, ZETA, [], [], K, 1e3, n_substeps=64)
    w = W * np.sqrt(1.0 + K)
    mode = SecondOrderModeOperator(w, ZETA * W / w, 1.0 / (1.0 + K))
    u = walk(60)
    expected = mode.run(u, 0.01)[0]
    np.testing.assert_allclose(stage.run(u, 0.01)[0], expected, atol=1e-3 * np.abs(expected).max())


@given(
    logs=st.tuples(*(st.floats(-2.0, 3.0) for _ in range(3))),
    damping=st.floats(1e-3, 3.0),
    seed=st.integers(0, 1000),
    dt=st.sampled_from([1e-4, 1e-2, 1.0]),
)
@settings(deadline=None, max_examples=40)
def test_energy_is_dissipated_at_any_step(logs, damping, seed, dt):
    """While the drive rests, kinetic, spring's and stop's energy does not grow."""
    k, limit, w = 10.0 ** np.array(logs)
    stage = RestoringForceOperator(w, damping, [], [], k, limit, n_substeps=1)
    rng = np.random.default_rng(seed)
    drive = rng.normal()
    state = (*rng.normal(size=2), limit * rng.uniform(-1.0, 1.0), drive)
    energies = []
    for _ in range(50):
        q, p, z, _ = state
        assert abs(z) <= limit
        energies.append(0.5 * (p * p + (q - drive) ** 2 + z * z / k))
        state, _ = stage.step(state, drive, dt)
    assert np.all(np.diff(energies) <= 1e-12 * energies[0])


def test_force_unloads_when_the_motion_turns_round():
    """As (7) is printed it would stay at its limit for ever."""
    u = np.interp(np.arange(4001) / 1000.0, [0, 1, 2, 3, 4], [0.0, 1.0, -1.0, 1.0, 0.0])
    state, forces = STAGE.init(0.0), []
    for value in u:
        state, _ = STAGE.step(state, value, 0.01)
        forces.append(state[2])
    assert max(forces) == pytest.approx(LIMIT)
    assert min(forces) == pytest.approx(-LIMIT)
    assert np.abs(np.diff(forces)).max() < 0.05 * LIMIT


def test_slow_loop_encloses_the_work_of_the_slips():
    """Quasi-static: the width of the loop between both branches is twice the slip level."""
    stage = RestoringForceOperator(W, ZETA, [], [], K, LIMIT)
    u = np.interp(np.arange(5001) / 1000.0, [0, 1, 3, 5], [0.0, 1.0, -1.0, 1.0])
    y, _ = stage.run(u, 1.0)
    down, up = y[1000:3001], y[3000:]
    middle = np.interp(0.0, u[3000:], up) - np.interp(0.0, -u[1000:3001], down)
    assert middle == pytest.approx(-2.0 * LIMIT, rel=1e-3)


def test_rest_is_reached_by_a_slow_first_loading():
    stage = dataclasses.replace(STAGE, preload=0.3, gain=-2.0, intercept=1.0)
    for end in (0.05, 1.3, -0.8):
        _, state = stage.run(np.linspace(0.0, end, 20001), 0.01, stage.init(0.0))
        np.testing.assert_allclose(state, stage.init(end), atol=2e-4)


def test_rest_without_equilibrium_is_finite():
    """A softening spring holds no more than so much."""
    stage = RestoringForceOperator(W, ZETA, [-0.5], [], K, LIMIT)
    state = stage.init(30.0)
    assert np.isfinite(state).all()


def test_lost_stage_ends_quietly():
    stage = RestoringForceOperator(W, ZETA, [-0.5], [-1.0], K, LIMIT)
    u = 5.0 * np.sin(0.05 * np.arange(400))
    y, _ = stage.run(u, 0.01)
    same, dy = stage.linearize(u, np.ones((400, 1)), 0.01)
    lost = np.isnan(y)
    assert lost.any()
    assert np.abs(y[~lost]).max() < 1e14
    np.testing.assert_array_equal(y, same)
    assert np.isnan(dy[lost, 0]).all()


def test_feedback_is_undone_by_its_opposite():
    stage = dataclasses.replace(STAGE, gain=-2.0, intercept=1.0, scale=0.7, n_substeps=64)
    tied = stage.with_feedback(-1.5, 0.7)
    np.testing.assert_allclose(
        tied.with_feedback(1.5, 0.7).pack(), stage.pack(), rtol=1e-12, atol=1e-15
    )
    u = walk(200)
    y, _ = stage.run(u, 1e-3)
    again, _ = stage.with_feedback(-1.5, 1.0).run(u - 1.5 * (y - 1.0), 1e-3)
    np.testing.assert_allclose(again, y, atol=5e-4 * np.ptp(y))


def test_physical_quantities_solve_the_equation_of_motion():
    stage = dataclasses.replace(
        STAGE, preload=0.1, gain=-2.0, intercept=1.0, scale=0.8, n_substeps=32
    )
    p = stage.physical(mass=3.0)
    assert p["x_s"] == pytest.approx(p["z_s"] / p["alpha_s"])
    dt, u = 2e-3, 0.8 * np.sin(0.02 * np.arange(400))
    y, _ = stage.run(u, dt)
    time = dt * np.arange(400)

    def motion(t, s):
        x, v, z = s
        yields = abs(z) >= p["z_s"] and z * v > 0.0
        force = p["drive_gain"] * np.interp(t, time, u) + p["preload"] - z
        force -= p["alpha_1"] * x + p["alpha_3"] * x**3 + p["alpha_5"] * x**5
        force -= p["lambda_1"] * v + p["lambda_3"] * v**3
        return [v, force / p["mass"], 0.0 if yields else p["alpha_s"] * v]

    x = solve_ivp(
        motion, (0.0, time[-1]), [y[0] - 1.0, 0.0, 0.0], t_eval=time, rtol=1e-7, max_step=dt / 4
    ).y[0]
    np.testing.assert_allclose(y - 1.0, x, atol=1e-3 * np.ptp(x))


@pytest.mark.parametrize("unit", [1e-12, 1e12])
def test_unit_of_the_drive(unit):
    u = walk(60)
    scaled = dataclasses.replace(STAGE, slip_level=LIMIT * unit, scale=unit, gain=1.0 / unit)
    np.testing.assert_allclose(scaled.run(unit * u, 0.02)[0], STAGE.run(u, 0.02)[0], rtol=1e-9)


def test_wrong_parameters():
    with pytest.raises(ValueError, match="'n_substeps' parameter of RestoringForceOperator"):
        dataclasses.replace(STAGE, n_substeps=0)
    with pytest.raises(ValueError, match="'scale' parameter of RestoringForceOperator"):
        dataclasses.replace(STAGE, scale=0.0)
