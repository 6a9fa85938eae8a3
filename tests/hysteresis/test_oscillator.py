"""What holds for every stage with hysteresis in its equation of motion."""

import dataclasses
import math
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from skhyst.hysteresis import (
    BoucWenStage,
    BoucWenStageOperator,
    EndStops,
    EndStopsOperator,
    FrictionStage,
    FrictionStageOperator,
    RestoringForce,
    RestoringForceOperator,
)
from skhyst.hysteresis._oscillator import decay
from skhyst.linear import SecondOrderModeOperator
from skhyst.operators import resampled
from skhyst.optimize import RecordData

W, ZETA = 60.0, 0.3
FRICTION = FrictionStageOperator(W, ZETA, 0.3, 0.65, 4.0, 10.0, 0.2)
ALONG = dataclasses.replace(FRICTION, friction_gradient=1.3, friction_center=0.2)
BOUC_WEN = BoucWenStageOperator(W, ZETA, 4.0, 0.3, 0.3)
BILINEAR = RestoringForceOperator(W, ZETA, [0.3, 0.1], [0.2], 4.0, 0.2)
STOPS = EndStopsOperator(W, ZETA, 12.0, 0.2, -0.3, 0.4)


def walk(n, seed=0):
    u = 0.3 * np.cumsum(np.random.default_rng(seed).normal(size=n))
    return u - u[0]


def of_bouc_wen(shape, exponent):
    return dataclasses.replace(BOUC_WEN, shape=shape, exponent=exponent)


@pytest.mark.parametrize("a", [0.0, 1e-12, 1e-3, 0.0999999, 0.1, 0.3, 1.0, 30.0, 1e4, 1e100])
def test_decay(a):
    """Against the power series, or the closed form where that keeps its digits."""
    expected = [-math.expm1(-a)]
    if a < 1.0:
        expected += [sum((-a) ** j / math.factorial(j + k) for j in range(30)) for k in (1, 2, 3)]
    else:
        phi = expected[0] / a
        psi = (1.0 - phi) / a
        expected += [phi, psi, (0.5 - psi) / a]
    np.testing.assert_allclose(decay(a), expected, rtol=1e-11)


# ------------------------------------------------------------------------- the equation of motion


def friction(p, n):
    def force(x, v, z):
        fall = p["static_force"] - p["coulomb_force"]
        g = p["coulomb_force"] + fall * np.exp(-((v / p["stribeck_velocity"]) ** 2))
        slip = v - p["bristle_stiffness"] * np.abs(v) / g * z
        force = p["bristle_stiffness"] * z + p["bristle_damping"] * slip
        if "friction_gradient" in p:
            way = x - (p["friction_center"] - 1.0)  # about the intercept
            force *= np.maximum(1.0 + p["friction_gradient"] * way, 0.0)
        return p["stiffness"] * x + p["damping"] * v + force, slip

    return force


def bouc_wen(p, n):
    def force(x, v, z):
        slip = p["beta"] * np.abs(v) * np.abs(z) ** n * np.sign(z) + p["gamma"] * v * np.abs(z) ** n
        return p["stiffness"] * x + p["damping"] * v + z, p["alpha"] * v - slip

    return force


def bilinear(p, n):
    def force(x, v, z):
        curve = p["alpha_1"] * x + p["alpha_3"] * x**3 + p.get("alpha_5", 0.0) * x**5
        curve = curve + p["lambda_1"] * v + p["lambda_3"] * v**3 - p["preload"]
        held = (np.abs(z) >= p["z_s"]) & (z * v > 0.0)
        return curve + z, np.where(held, 0.0, p["alpha_s"] * v)

    return force


def stops(p, n):
    def force(x, v, z):
        beyond = x - np.clip(x, p["lower_stop"] - 1.0, p["upper_stop"] - 1.0)  # about the intercept
        touch = beyond != 0.0
        contact = p["stop_stiffness"] * beyond + p["stop_damping"] * v * touch
        return p["stiffness"] * x + p["damping"] * v + contact, 0.0

    return force


def motion(law, p, n=1.0):
    """Return the rates of (x, v, z) under a drive, in physical quantities."""
    force = law(p, n)

    def rates(s, drive):
        total, rate = force(*s)
        return np.array([s[1], (p["drive_gain"] * drive - total) / p["mass"], rate])

    return rates


def within(s, p):
    """Put the force of a bilinear law back on its limit."""
    return s if "z_s" not in p else np.array([*s[:2], np.clip(s[2], -p["z_s"], p["z_s"])])


def reference(law, stage, u, dt, **options):
    """Integrate the equation of motion in its physical quantities, from sample to sample."""
    p = stage.physical(mass=3.0)
    rates = motion(law, p, getattr(stage, "exponent", 1.0))
    x, _, z, *_ = stage.init(u[0])
    s, found = [stage.gain * x, 0.0, p["drive_gain"] * z], [stage.gain * x]
    for before, after in pairwise(u):

        def moved(t, s, before=before, after=after):
            return rates(s, before + (after - before) * t / dt)

        s = within(solve_ivp(moved, (0.0, dt), s, **options).y[:, -1], p)
        found.append(s[0])
    return stage.intercept + np.array(found)


STIFF = {"method": "LSODA", "rtol": 1e-10, "atol": 1e-12}
SMOOTH = {"method": "LSODA", "rtol": 1e-9, "atol": 1e-10, "max_step": 0.0025}
KINKED = {"method": "DOP853", "rtol": 1e-8, "atol": 1e-10, "max_step": 0.001}


@pytest.mark.parametrize(
    ("law", "stage", "u", "dt", "options", "coarsest", "bounds"),
    [
        (friction, FRICTION, walk(50), 0.02, STIFF, 8, (1.8, 2.3, 3e-5)),
        (friction, ALONG, walk(50), 0.02, STIFF, 8, (1.8, 2.3, 3e-5)),
        (bouc_wen, BOUC_WEN, 0.6 * walk(60), 0.01, SMOOTH, 4, (1.7, 2.4, 1e-3)),
        (bouc_wen, of_bouc_wen(1.6, 2.0), 0.6 * walk(60), 0.01, SMOOTH, 4, (1.7, 2.4, 1e-3)),
        (bouc_wen, of_bouc_wen(-1.2, 1.0), 0.6 * walk(60), 0.01, SMOOTH, 4, (1.7, 2.4, 1e-3)),
        (
            bilinear,
            dataclasses.replace(BILINEAR, preload=0.1, scale=0.8),
            walk(40),
            0.02,
            KINKED,
            4,
            (1.7, 2.4, 3e-4),
        ),
        (stops, STOPS, walk(40), 0.02, KINKED, 8, (1.7, 2.4, 3e-4)),
    ],
)
def test_order_of_convergence(law, stage, u, dt, options, coarsest, bounds):
    """To an integration of the equations as printed, for a drive that pulls the other way."""
    stage = dataclasses.replace(stage, gain=-2.0, intercept=1.0)
    expected = reference(law, stage, u, dt, **options)
    substeps = coarsest * 2 ** np.arange(4)
    runs = [dataclasses.replace(stage, n_substeps=int(n)).run(u, dt)[0] for n in substeps]
    errors = [np.sqrt(np.mean((y - expected) ** 2)) for y in runs]
    low, high, part = bounds
    assert low < -np.polyfit(np.log(substeps), np.log(errors), 1)[0] < high
    assert errors[-1] < part * np.std(expected)


@pytest.mark.parametrize(("damping_ratio", "n_substeps"), [(0.05, 1), (3.0, 7)])
@pytest.mark.parametrize(
    "stage",
    [
        dataclasses.replace(FRICTION, static_level=0.0, bristle_damping=0.0),
        dataclasses.replace(BOUC_WEN, level=0.0),
        dataclasses.replace(BOUC_WEN, hysteresis_stiffness=1e-12),
        RestoringForceOperator(W, ZETA, [0.0], [0.0], 4.0, 0.0),
        dataclasses.replace(STOPS, lower=-1e3, upper=1e3),
    ],
)
def test_without_other_forces_it_is_the_linear_mode(stage, damping_ratio, n_substeps):
    stage = dataclasses.replace(
        stage, damping_ratio=damping_ratio, gain=2.0, intercept=0.3, n_substeps=n_substeps
    )
    assert stage.linear_mode() == SecondOrderModeOperator(W, damping_ratio, 2.0, 0.3)
    u = 0.5 + walk(80)
    expected = stage.linear_mode().run(u, 0.02)[0]
    np.testing.assert_allclose(stage.run(u, 0.02)[0], expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("stage", "stiffness", "damping"),
    [
        (dataclasses.replace(FRICTION, static_level=1e7), 10.0, 0.5),
        (dataclasses.replace(BOUC_WEN, level=1e7), 4.0, 0.3),
        (RestoringForceOperator(W, ZETA, [], [], 4.0, 1e3), 4.0, 0.3),
        (EndStopsOperator(W, ZETA, 12.0, 0.2, -1e-9, 1e-9), 12.0, 0.5),
    ],
)
def test_small_motion_is_that_of_a_stiffer_linear_mode(stage, stiffness, damping):
    """Far below its limit the hysteretic force is a spring, and a damper where bristles are."""
    w = W * np.sqrt(1.0 + stiffness)
    assert stage.fastest_rate() == pytest.approx(w)
    u = walk(60)
    expected = SecondOrderModeOperator(w, damping * W / w, 1.0 / (1.0 + stiffness)).run(u, 0.01)[0]
    found, _ = dataclasses.replace(stage, n_substeps=64).run(u, 0.01)
    np.testing.assert_allclose(found, expected, atol=1e-3 * np.abs(expected).max())


@pytest.mark.parametrize("stage", [FRICTION, BOUC_WEN, BILINEAR])
def test_way_before_sliding(stage):
    """On it the force would reach its level if it kept its first slope."""
    level = 0.2 if stage is BILINEAR else 0.3
    moved = dataclasses.replace(stage, gain=-2.0)
    q, _, force, *_ = moved.init(1e-7)
    assert moved.presliding_displacement == pytest.approx(2.0 * level * q / force, rel=1e-5)
    assert RestoringForceOperator(W, ZETA, [0.1], [], 0.0, 0.5).presliding_displacement is None


def some_friction(w, damping, rho, level, speed, part, exponent):
    return FrictionStageOperator(w, damping, level, 0.5 * (1.0 + part), speed, rho, n_substeps=1)


def some_bouc_wen(w, damping, rho, level, speed, part, exponent):
    return BoucWenStageOperator(w, damping, rho, level, part, exponent, n_substeps=1)


def some_bilinear(w, damping, rho, level, speed, part, exponent):
    return RestoringForceOperator(w, damping, [], [], rho, level, n_substeps=1)


def some_stops(w, damping, rho, level, speed, part, exponent):
    return EndStopsOperator(w, damping, rho, speed, -level, level, n_substeps=1)


@pytest.mark.parametrize("make", [some_friction, some_bouc_wen, some_bilinear, some_stops])
@given(
    logs=st.tuples(*(st.floats(-2.0, 3.0) for _ in range(4))),
    part=st.floats(-1.0, 1.0),
    exponent=st.sampled_from([1.0, 1.5, 2.0, 6.0]),
    damping=st.floats(1e-3, 3.0),
    seed=st.integers(0, 1000),
    dt=st.sampled_from([1e-4, 1e-2, 1.0]),
)
@settings(deadline=None, max_examples=40)
def test_energy_is_dissipated_at_any_step(make, logs, part, exponent, damping, seed, dt):
    """While the drive rests, kinetic, spring's and hysteresis' energy does not grow.

    It holds for one step as for a thousand, however stiff the stage and coarse the step are.
    """
    w, rho, level, speed = 10.0 ** np.array(logs)
    stage = make(w, damping, rho, level, speed, part, exponent)
    limit = level
    if make is some_bouc_wen:
        limit *= min((1.0 + part) ** (-1.0 / exponent) if part > -1.0 else np.inf, 1e3)
    rng = np.random.default_rng(seed)
    drive = rng.normal()
    state = (*rng.normal(size=2), limit * rng.uniform(-1.0, 1.0), drive, 1.0)
    energies = []
    for _ in range(50):
        q, p, f, _, _ = state
        assert make is not some_bilinear or abs(f) <= level
        if make is some_stops:  # the spring of a stop
            beyond = max(abs(q) - level, 0.0)
            energies.append(0.5 * (p * p + (q - drive) ** 2 + rho * beyond**2))
        else:
            energies.append(0.5 * (p * p + (q - drive) ** 2 + f * f / rho))
        state, _ = stage.step(state, drive, dt)
    assert np.all(np.diff(energies) <= 1e-12 * energies[0])


@pytest.mark.parametrize(
    "stage",
    [
        FRICTION,
        *(of_bouc_wen(*law) for law in ((0.3, 1.0), (-0.4, 4.0), (-1.5, 2.0), (2.0, 1.0))),
        dataclasses.replace(BILINEAR, preload=0.3),
        STOPS,
    ],
)
def test_rest_is_reached_by_a_slow_first_loading(stage):
    stage = dataclasses.replace(stage, gain=-2.0, intercept=1.0)
    for end in (0.05, 1.3, -0.8):
        _, state = stage.run(np.linspace(0.0, end, 20001), 0.01, stage.init(0.0))
        np.testing.assert_allclose(state, stage.init(end), atol=2e-4)


@pytest.mark.parametrize("stage", [FRICTION, BOUC_WEN, BILINEAR, STOPS])
def test_a_start_from_zero_begins_at_the_first_sample(stage):
    """Nothing moves the stage before: a drive of straight lines is the same at any interval."""
    u = 1.0 + 0.3 * walk(40)
    fine = np.interp(np.arange(391) / 10, np.arange(40), u)
    stage = dataclasses.replace(stage, gain=-2.0, intercept=1.0, n_substeps=10)
    y, _ = stage.run(u, 0.02, stage.init(u[0], "zero"))
    assert y[0] == 1.0
    again = resampled(stage, 0.02, 0.002)
    assert again.n_substeps == 1
    np.testing.assert_allclose(again.run(fine, 0.002, again.init(u[0], "zero"))[0][::10], y)
    parts = [u[:1], u[1:9], u[9:]]
    state, found = stage.init(u[0], "zero"), []
    for part in parts:
        own, state = stage.run(part, 0.02, state)
        found.append(own)
    np.testing.assert_array_equal(np.concatenate(found), y)


@pytest.mark.parametrize("upper", [0.1, 0.6743709337368877])
def test_a_rigid_stop_is_where_the_stage_stays(upper):
    """Also where nothing is left of the way beyond it but rounding."""
    stage = EndStopsOperator(W, ZETA, 1e20, upper=upper)
    assert stage.init(1.1536769404689238)[0] == pytest.approx(upper)
    assert stage.init(-1.0)[0] == -1.0


@pytest.mark.parametrize(
    ("stage", "part"),
    [
        (FRICTION, 2e-4),
        (BOUC_WEN, 2e-4),
        (dataclasses.replace(BILINEAR, scale=0.7), 5e-4),
        (STOPS, 5e-4),
    ],
)
def test_feedback_is_undone_by_its_opposite(stage, part):
    stage = dataclasses.replace(stage, gain=-2.0, intercept=1.0, n_substeps=64)
    tied = stage.with_feedback(-1.5, 0.7)
    again = tied.with_feedback(1.5, 0.7).pack()
    np.testing.assert_allclose(again, stage.pack(), rtol=1e-12, atol=1e-15)
    u = walk(200)
    y, _ = stage.run(u, 1e-3)
    again, _ = stage.with_feedback(-1.5, 1.0).run(u - 1.5 * (y - 1.0), 1e-3)
    np.testing.assert_allclose(again, y, atol=part * np.ptp(y))


@pytest.mark.parametrize("unit", [1e-12, 1e12])
@pytest.mark.parametrize(
    ("stage", "names"),
    [
        (FRICTION, ("static_level", "stribeck_velocity")),
        (BOUC_WEN, ("level",)),
        (BILINEAR, ("slip_level", "scale")),
        (STOPS, ("lower", "upper")),
    ],
)
def test_unit_of_the_drive(stage, names, unit):
    u = walk(60)
    changes = {name: unit * getattr(stage, name) for name in names}
    scaled = dataclasses.replace(stage, gain=1.0 / unit, **changes)
    np.testing.assert_allclose(scaled.run(unit * u, 0.02)[0], stage.run(u, 0.02)[0], rtol=1e-9)


@pytest.mark.parametrize(
    ("stage", "u", "dt"),
    [
        # a force that hardens without limit, then a spring and a damper that soften
        (
            BoucWenStageOperator(W, 0.01, 4.0, 1e-3, -2.0, 3.0),
            50.0 * np.sin(0.5 * np.arange(400)),
            0.05,
        ),
        (
            RestoringForceOperator(W, ZETA, [-0.5], [-1.0], 4.0, 0.2),
            5.0 * np.sin(0.05 * np.arange(400)),
            0.01,
        ),
    ],
)
def test_lost_stage_ends_quietly(stage, u, dt):
    y, _ = stage.run(u, dt)
    same, dy = stage.sensitivities(u, np.ones((400, 1)), dt)
    np.testing.assert_array_equal(y, same)
    assert np.nanmax(np.abs(y)) < 1e14
    assert np.isnan(y).any()
    assert np.isnan(dy[np.isnan(y), 0]).all()
    assert not np.isinf(dy).any()


@pytest.mark.parametrize("level", [1e-90, 1e90])
@pytest.mark.parametrize("rho", [1e-9, 1e9])
@pytest.mark.parametrize("other", [0, 1])
def test_extreme_parameters_give_finite_values(level, rho, other):
    speed, exponent = (1e-90, 1e90)[other], (1.0, 20.0)[other]
    friction = FrictionStageOperator(W, ZETA, level, 0.65, speed, rho, 0.2)
    bouc_wen = BoucWenStageOperator(W, ZETA, rho, level, 0.3, exponent)
    for stage in (friction, bouc_wen):
        assert np.isfinite(stage.run(walk(40), 0.02)[0]).all()
    # the derivative by a level of 1e-90 itself may be anything
    _, dy = friction.sensitivities(walk(40), np.ones((40, 1)), 0.02)
    assert np.isfinite(dy[:, [0, 1, 2, 6, 7, 8, 9]]).all()


@pytest.mark.parametrize("stage", [FRICTION, BOUC_WEN, BILINEAR])
@pytest.mark.parametrize("n", [0, -1, 2.0, True, None])
def test_wrong_number_of_substeps(stage, n):
    with pytest.raises(ValueError, match=f"'n_substeps' parameter of {type(stage).__name__}"):
        dataclasses.replace(stage, n_substeps=n)


# ----------------------------------------------------------------------------------- estimators

DT = 0.01
TIME = DT * np.arange(1500)
U = np.sin(0.7 * TIME) + 0.8 * np.sin(2.9 * TIME) + 0.3 * np.sin(11.0 * TIME)
PLANTS = {
    "friction": (
        FrictionStageOperator(20.0, 0.5, 0.4, 0.7, 1.5, 10.0, 0.1, 3.0, 0.5, n_substeps=7),
        FrictionStage(dt=DT),
        1e-5,
    ),
    "Bouc-Wen": (
        BoucWenStageOperator(20.0, 0.3, 4.0, 0.3, 0.4, 1.0, 3.0, 0.5, n_substeps=5),
        BoucWenStage(dt=DT),
        1e-4,
    ),
    "Bouc-Wen without limit": (
        BoucWenStageOperator(20.0, 0.3, 4.0, 0.3, -1.2, 1.0, 3.0, 0.5, n_substeps=5),
        BoucWenStage(dt=DT),
        1e-4,
    ),
    "Bouc-Wen, exponent": (
        BoucWenStageOperator(20.0, 0.3, 4.0, 0.3, 0.4, 2.0, 3.0, 0.5, n_substeps=5),
        BoucWenStage(fit_exponent=True, dt=DT),
        1e-4,
    ),
    "bilinear": (
        RestoringForceOperator(
            20.0, 0.3, [0.4], [0.3], 4.0, 0.3, 0.2, 3.0, 0.5, scale=0.5 * np.ptp(U), n_substeps=5
        ),
        RestoringForce(3, damping_degree=3, dt=DT),
        1e-4,
    ),
    "end stops, pulled the other way": (
        EndStopsOperator(20.0, 0.3, 15.0, 0.2, -0.7, 1.0, -3.0, 0.5, n_substeps=5),
        EndStops(dt=DT),
        1e-4,
    ),
}


@pytest.mark.parametrize("case", PLANTS)
def test_all_parameters_come_back_and_the_mass_scales_them(case):
    plant, model, rtol = PLANTS[case]
    y, _ = plant.run(U, DT)
    model.set_params(n_substeps=plant.n_substeps, mass=2.0).fit(U[:, None], y)
    np.testing.assert_allclose(model.operator_.pack(), plant.pack(), rtol=rtol)
    assert model.operator_.n_substeps == plant.n_substeps
    assert model.physical_ == pytest.approx(plant.physical(2.0), rel=10.0 * rtol)


@pytest.mark.parametrize("case", ["friction", "Bouc-Wen"])
def test_several_records_and_zero_state(case):
    plant, model, _ = PLANTS[case]
    index = pd.MultiIndex.from_product([["a", "b"], DT * np.arange(750)], names=["record", "time"])
    X = pd.DataFrame({"drive": U}, index)
    halves = np.split(U, 2)
    y = np.concatenate([plant.run(u, DT, plant.init(u[0], "zero"))[0] for u in halves])
    model = type(model)(n_substeps=plant.n_substeps, initial_state="zero").fit(X, y)
    np.testing.assert_allclose(model.operator_.pack(), plant.pack(), rtol=1e-4)


# ------------------------------------------------------------------------------------- recovery


def plant_of(model, w, rng):
    """Return a plant of the kind that the model identifies, with random parameters."""
    zeta = rng.uniform(0.1, 0.5)
    scales = {"gain": rng.uniform(0.3, 3.0) * rng.choice([-1.0, 1.0]), "intercept": rng.normal()}
    if isinstance(model, BoucWenStage):
        own = 0.5 * 20.0 ** rng.uniform(), rng.uniform(0.05, 0.4), rng.uniform(-0.7, 0.9)
        return BoucWenStageOperator(w, zeta, *own, **scales)
    if isinstance(model, FrictionStage):
        own = rng.uniform(0.1, 0.4), rng.uniform(0.5, 0.85), rng.uniform(0.03, 0.12) * w
        bristles = 4.0 * 15.0 ** rng.uniform(), rng.uniform(0.1, 0.5)
        return FrictionStageOperator(w, zeta, *own, *bristles, **scales)
    curves = [rng.uniform(0.2, 0.8)], [rng.uniform(0.1, 0.5)]
    own = 0.5 * 40.0 ** rng.uniform(), rng.uniform(0.05, 0.3), rng.uniform(-0.3, 0.3)
    return RestoringForceOperator(w, zeta, *curves, *own, **scales)


def drives(n_samples, dt, w, rng):
    """Return five incommensurate sinusoids for each plant, (n_samples, n), half a swing is 1."""
    u = np.zeros((n_samples, len(dt)))
    for part, amplitude in ((0.03, 1.0), (0.08, 1.0), (0.19, 0.6), (0.41, 0.4), (0.83, 0.25)):
        phase = part * w * dt * np.arange(n_samples)[:, None]
        u += amplitude * np.sin(phase + rng.uniform(0.0, 6.28, len(dt)))
    u -= u[0]
    return 2.0 * u / np.ptp(u, axis=0)


def runge_kutta(rates, p, start, dt, u, n_steps=16):
    """Return the displacements by the method of Runge and Kutta, all plants at once."""
    s, h, found = start, dt / n_steps, [start[0]]
    for before, after in pairwise(u):
        rise = (after - before) / n_steps
        for i in range(n_steps):
            drive = before + i * rise
            a = rates(s, drive)
            b = rates(s + 0.5 * h * a, drive + 0.5 * rise)
            c = rates(s + 0.5 * h * b, drive + 0.5 * rise)
            d = rates(s + h * c, drive + rise)
            s = within(s + h / 6.0 * (a + 2.0 * b + 2.0 * c + d), p)
        found.append(s[0])
    return np.array(found)


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("model", "law", "n", "n_samples"),
    [
        (BoucWenStage(), bouc_wen, 5, 1000),
        (FrictionStage(), friction, 7, 1200),
        (RestoringForce(3, damping_degree=3), bilinear, 6, 1200),
    ],
)
def test_recovery_from_noise(model, law, n, n_samples):
    """At the noise floor, and the standard errors are true, with starting values of its own."""
    rng = np.random.default_rng(2)
    w = 2.0 * np.pi * rng.uniform(15.0, 60.0, n)
    plants = [plant_of(model, frequency, rng) for frequency in w]
    p = {name: np.array([s.physical()[name] for s in plants]) for name in plants[0].physical()}
    dt = 2.0 * np.pi / w / 30.0
    u = drives(n_samples, dt, w, rng)
    # each drive begins at zero, where only a preload moves the plant
    rest = np.array([[plant.gain * plant.init(0.0)[0], 0.0, 0.0] for plant in plants]).T
    clean = runge_kutta(motion(law, p), p, rest, dt, u)
    ratios, inside = [], []
    for i, plant in enumerate(plants):
        expected = clean[:, i] + plant.intercept
        y = expected + 0.005 * expected.std() * rng.normal(size=n_samples)
        found = model.set_params(dt=dt[i]).fit(u[:, [i]], y)
        ratios.append(found.fit_error_ / np.sqrt(np.mean((y - expected) ** 2)))
        truth = dict(zip([name for name, _ in plant.entries()], plant.pack(), strict=True))
        inside += [
            abs(v - truth[k]) < 1.96 * found.params_std_[k] for k, v in found.params_.items()
        ]
    assert max(ratios) < 1.02
    assert 0.9 < np.mean(inside) < 0.99


# --------------------------------------------------------------------------------------- starts

SLOW, LIGHT = 150.0, 0.1
STARTS = {
    "friction": (FrictionStageOperator(SLOW, LIGHT, 0.2, 0.7, 20.0, 10.0, 0.05), FrictionStage()),
    "Bouc-Wen": (BoucWenStageOperator(SLOW, LIGHT, 1.0, 0.1, 0.3), BoucWenStage()),
    "bilinear": (
        RestoringForceOperator(SLOW, LIGHT, [], [], 2.0, 0.1),
        RestoringForce(1, damping_degree=1),
    ),
    "Duffing": (
        RestoringForceOperator(SLOW, LIGHT, [1.5], [], 0.0, 0.0, 0.1),
        RestoringForce(3, damping_degree=1, fit_hysteresis=False),
    ),
    "end stops": (EndStopsOperator(SLOW, LIGHT, 30.0, 0.1, -0.3, 0.5), EndStops()),
    "Duffing, degree 5": (
        RestoringForceOperator(SLOW, LIGHT, [0.5, 1.0], [0.5], 0.0, 0.0),
        RestoringForce(5, damping_degree=3, fit_hysteresis=False),
    ),
}


def records(operator, n, dt=1e-3):
    rng = np.random.default_rng(0)
    time, found = dt * np.arange(n), []
    for amplitude in (0.4, 1.0):
        u = sum(
            np.sin(2.0 * np.pi * f * time + rng.uniform(0.0, 6.28))
            for f in np.geomspace(0.5, 40, 16)
        )
        u -= u[0]
        u *= amplitude / np.abs(u).max()
        y, _ = operator.run(u, dt)
        found.append(RecordData(u, 2.0 * y + 0.3 + 0.002 * rng.normal(size=n), dt))
    return found


def error(operator, data):
    """Return the root mean square of the free run, part of the response's deviation."""
    rest = np.concatenate([operator.run(r.u, r.dt)[0] - r.y for r in data])
    return np.std(rest) / np.std(np.concatenate([r.y for r in data]))


@pytest.mark.parametrize("case", STARTS)
@pytest.mark.parametrize("n", [4000, 25_000])
def test_starts(case, n):
    """Few, one nearly right, one nearly linear; also where only parts of the records are seen."""
    plant, model = STARTS[case]
    data = records(plant, n)
    starts = model.starting_values(data)
    assert 1 < len(starts) <= 12
    linear = min(error(start.linear_mode(), data) for start in starts)
    assert min(error(start, data) for start in starts) < 0.7 * linear
    last = data[-1]
    gaps = [
        np.std(start.run(last.u, last.dt)[0] - start.linear_mode().run(last.u, last.dt)[0])
        for start in starts
    ]
    assert min(gaps) < 0.05 * np.std(last.y)
