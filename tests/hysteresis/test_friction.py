"""Friction: theorems of all its models, and their parameters found again."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from skhyst.hysteresis import (
    CoulombFriction,
    CoulombFrictionOperator,
    Dahl,
    DahlOperator,
    Duhem,
    DuhemOperator,
    LuGre,
    LuGreOperator,
    MaxwellSlip,
    MaxwellSlipOperator,
)
from skhyst.linear import TransferFunctionOperator
from skhyst.operators import Series, Stepper

R, K = np.array([0.5, 1.3, 4.0, 20.0]), np.array([2.0, 0.7, 0.2, 0.05])
CUBIC = DuhemOperator(2.3, [0.9, 0.1, -0.2], [0.4, 0.1, 0.2], 0.1, center=0.21, scale=1.3)
EXPONENTS = {"Dahl": 1.0, "Dahl, hard": 0.5, "Dahl, soft": 1.6}
DAHL = {name: DahlOperator(0.8, 1.3, exponent=n) for name, n in EXPONENTS.items()}
drives = arrays(float, st.integers(2, 40), elements=st.floats(-50, 50, allow_subnormal=False))


def between(u, parts):
    """Return ``u`` with points on the straight lines between its samples."""
    return np.interp(np.arange((len(u) - 1) * parts + 1) / parts, np.arange(len(u)), u)


SMOOTH = {  # part of the drives, tolerance
    **{name: (operator, 1.0, 1e-9) for name, operator in DAHL.items()},
    "Dahl, hard": (DAHL["Dahl, hard"], 1.0, 1e-7),
    "LuGre": (LuGreOperator(0.02, 0.3, 0.6, 5.0, 0.2, damping=0.7, intercept=-1.0), 0.02, 1e-10),
    "slip elements": (MaxwellSlipOperator(R, K, stiffness=0.1), 1.0, 1e-11),
    "Duhem": (CUBIC, 0.06, 1e-10),
}
EVERY = pytest.mark.parametrize("name", SMOOTH)


@EVERY
@settings(deadline=None, max_examples=30)
@given(u=drives)
def test_more_samples_on_the_same_lines_change_nothing(name, u):
    operator, part, tolerance = SMOOTH[name]
    y, _ = operator.run(part * u, 0.01)
    fine, _ = operator.run(between(part * u, 5), 0.01 / 5)
    np.testing.assert_allclose(fine[::5], y, rtol=0, atol=tolerance)
    if name != "LuGre":
        np.testing.assert_array_equal(operator.run(part * u, 7.0)[0], y)


@EVERY
def test_a_velocity_drives_it_behind_an_integrator(name):
    """The straight line between two velocities is a way that both ends share."""
    operator, part, tolerance = SMOOTH[name]
    integrator = TransferFunctionOperator(*4 * (np.empty(0),), integrators=1)
    model = Series(("displacement", "friction"), (integrator, operator))
    v = 30.0 * part * np.cumsum(np.random.default_rng(2).normal(size=60))
    way = 0.1 * np.cumsum(0.5 * (v + np.r_[0.0, v[:-1]]) * np.r_[0.0, np.ones(59)])
    expected, _ = operator.run(way, 0.1)
    np.testing.assert_allclose(model.run(v, 0.1)[0], expected, rtol=0, atol=1e3 * tolerance)
    stepped = Stepper(model.compiled_step(0.1, model.init(v[0]))).run(v)
    np.testing.assert_allclose(stepped, expected, rtol=0, atol=1e3 * tolerance)


@EVERY
def test_rest_is_a_slow_first_loading_from_zero(name):
    operator, _, _ = SMOOTH[name]
    y, _ = operator.run(np.linspace(0.0, 0.013, 50), 1e9)
    assert operator.run([0.013], 1e-3)[0][0] == pytest.approx(y[-1], abs=1e-10)
    assert operator.run([], 1e-3)[0].shape == (0,)


@pytest.mark.parametrize("name", [*DAHL, "slip elements"])
@settings(deadline=None, max_examples=30)
@given(u=drives)
def test_never_above_the_force_of_sliding(name, u):
    operator, limit = (DAHL[name], 1.3) if name in DAHL else (MaxwellSlipOperator(R, K), K @ R)
    assert np.abs(operator.run(u, 1e-3)[0]).max() <= limit + 1e-11 * (name not in DAHL)


FORCES = {  # largest friction, part of the work that the sum over the samples may miss
    **{name: (operator, 1.3, 1e-3) for name, operator in DAHL.items()},
    "LuGre": (LuGreOperator(0.8, 3.0, 0.6, 5.0, damping=0.1), 5.0, 1e-2),
    "slip elements": (MaxwellSlipOperator(R, K, damping=0.1), K @ R, 1e-3),
}


@pytest.mark.parametrize("name", FORCES)
@settings(deadline=None, max_examples=20)
@given(u=drives)
def test_dissipates(name, u):
    """The work put in is never below the energy of the bent bristles, which is never negative."""
    operator, force, missed = FORCES[name]
    path = between(np.append(0.0, u), 400)
    y, _ = operator.run(path, 1e-3)
    # bristles: the force of the straight line that ends at a sample
    mean = y[1:] if name == "LuGre" else 0.5 * (y[1:] + y[:-1])
    work = np.cumsum(mean * np.diff(path))
    assert work.min(initial=0.0) >= -missed * force * np.abs(np.diff(path)).sum()


@pytest.mark.parametrize(
    ("operator", "size", "spring", "dashpot", "tolerance"),
    [
        *((DahlOperator(0.8, 1.3, exponent=n), 1e-6, 1.3 / 0.8, 0.0, 1e-11) for n in (0.5, 1, 2)),
        (LuGreOperator(0.02, 0.3, 0.6, 5.0, bristle_damping=0.2), 1e-9, 250.0, 0.2, 1e-13),
        (MaxwellSlipOperator(R, K), 1e-9, K.sum(), 0.0, 1e-22),
    ],
)
def test_tiny_motion_meets_a_spring_and_a_dashpot(operator, size, spring, dashpot, tolerance):
    u = size * np.sin(np.linspace(0, 20, 500))
    y, _ = operator.run(u, 1e-3)
    expected = spring * u + dashpot * np.diff(u, prepend=0.0) / 1e-3
    np.testing.assert_allclose(y, expected, rtol=0, atol=tolerance)


@settings(deadline=None, max_examples=30)
@given(drives)
def test_degree_one_of_duhem_is_dahl_friction_beside_a_spring(u):
    y, _ = DuhemOperator(2.5, [0.9], [3.4], 0.2).run(0.06 * u, 1.0)
    dahl, _ = DahlOperator(0.4, 1.0, stiffness=0.9, intercept=0.2).run(0.06 * u, 1.0)
    np.testing.assert_allclose(y, dahl, rtol=0, atol=1e-12)


def test_lugre_without_stribeck_effect_is_dahl_friction():
    u = 0.1 * np.cumsum(np.random.default_rng(0).normal(size=100))
    lugre, _ = LuGreOperator(0.2, 0.3, 1.0, 5.0, damping=0.1).run(u, 0.01)
    dahl, _ = DahlOperator(0.2, 5.0, damping=0.1).run(u, 0.01)
    np.testing.assert_allclose(lugre, dahl, atol=1e-12)


# ------------------------------------------------------------------------------ data without noise

U = np.sin(np.linspace(0, 20, 800)) * np.linspace(0, 1, 800)
SHIFTED = U + 0.3
T = 0.005 * np.arange(3000)
WAVES = np.sin(T) + 0.3 * np.sin(4.4 * T) + 0.03 * np.sin(13.0 * T)
BEYOND = {"center": 0.5 * (SHIFTED.max() + SHIFTED.min()), "scale": 0.5 * np.ptp(SHIFTED)}
PLANTS_WITHOUT_NOISE = [
    *(
        (Dahl(n, fit_stiffness=True, dt=0.01), DahlOperator(0.12, -3.0, 1.5, 0.2, 7.0, n), U, 1e-4)
        for n in (0.6, 1.0, 1.8)
    ),
    (
        LuGre(fit_stiffness=True, dt=0.005),
        LuGreOperator(0.05, 0.5, 0.6, 8.0, 0.4, stiffness=2.0, damping=0.3, intercept=1.0),
        WAVES,
        1e-5,
    ),
    (
        MaxwellSlip(thresholds=[0.1, 0.3, 0.6], fit_stiffness=True, dt=0.01),
        MaxwellSlipOperator([0.1, 0.3, 0.6], [3.0, 1.0, 0.5], 0.4, 0.2, 7.0),
        U,
        1e-6,
    ),
    *(
        (
            Duhem(d),
            DuhemOperator(
                4.0, *np.random.default_rng(d).normal(size=(2, d)), 0.7, **BEYOND if d > 1 else {}
            ),
            SHIFTED,
            0.0,
        )
        for d in (1, 2, 3, 5)
    ),
]


@pytest.mark.parametrize(("model", "plant", "u", "rtol"), PLANTS_WITHOUT_NOISE)
def test_all_parameters_come_back(model, plant, u, rtol):
    y, _ = plant.run(u, model.dt)
    model.fit(u[:, None], y)
    found, atol = model.operator_.pack(), 0.0 if rtol else 1e-3
    np.testing.assert_allclose(found, plant.pack(), rtol=rtol, atol=atol)
    np.testing.assert_allclose(model.predict(u[:, None]), y, atol=1e-5)


@pytest.mark.parametrize(
    ("model", "fitted"),
    [
        (
            Dahl(fit_damping=False, fit_intercept=False),
            {"presliding_displacement", "coulomb_force"},
        ),
        (
            LuGre(stribeck=False, fit_bristle_damping=False),
            {"presliding_displacement", "static_force", "damping", "intercept"},
        ),
        (Duhem(fit_intercept=False), {"alpha", "curve[0]", "slope[0]"}),
    ],
)
def test_what_is_not_fitted_stands_at_zero(model, fitted):
    y, _ = DahlOperator(0.12, 3.0, stiffness=1.5, damping=0.2, intercept=7.0).run(U, 0.01)
    operator = model.set_params(dt=0.01).fit(U[:, None], y).operator_
    assert set(model.params_) == fitted
    others = set(operator.parameter_specs()) - {name.split("[")[0] for name in fitted}
    held = {name: getattr(operator, name) for name in others - {"stribeck_velocity"}}
    assert held.pop("coulomb_ratio", 1.0) == 1.0
    assert not any(held.values())


# --------------------------------------------------------------------------------- data with noise

N, PLANTS, NOISE = 1500, 20, 0.005
TIME = np.linspace(0.0, 1.0, N)
THRESHOLDS = np.array([0.05, 0.2, 0.5, 1.1])
POWERS = {  # of the units of drive, response and time
    "": (0, 0, 0),
    "drive": (1, 0, 0),
    "1/drive": (-1, 0, 0),
    "drive/s": (1, 0, -1),
    "response": (0, 1, 0),
    "response/drive": (-1, 1, 0),
    "response s/drive": (-1, 1, 1),
}


def motions(rng):
    """Swings of many sizes, slow and fast, (N, PLANTS); they start at zero."""
    frequencies = np.geomspace(1.3, 21.0, 6)[:, None]
    phases = rng.uniform(0.0, 2 * np.pi, (6, PLANTS))
    sizes = rng.uniform(0.5, 1.5, (6, PLANTS)) / frequencies**1.2
    u = sum(
        size * np.sin(2 * np.pi * f * TIME[:, None] + phase)
        for f, size, phase in zip(frequencies, sizes, phases, strict=True)
    )
    u -= u[0]
    return 2.0 * u / np.ptp(u, axis=0)


def coulomb(rng):
    low, high = np.log([[0.1], [2.0], [0.5]]), np.log([[0.4], [6.0], [4.0]])
    v_0, v_s, force = np.exp(rng.uniform(low, high, (3, PLANTS)))
    more, d, c = rng.uniform(0.3, 1.0, (3, PLANTS)) * [[2.0], [0.05], [1.0]]
    none = np.zeros(PLANTS)
    return map(CoulombFrictionOperator, v_0, force, v_s, more, none, none, d, c)


def dahl(rng):
    x_c, force = np.exp(rng.uniform(np.log([[0.03], [0.5]]), np.log([[0.4], [4.0]]), (2, PLANTS)))
    return map(DahlOperator, x_c, force, *rng.uniform(-1, 1, (3, PLANTS)) * [[1.0], [0.02], [1.0]])


def lugre(rng):
    low, high = np.log([[0.05], [1.0], [0.5]]), np.log([[0.3], [5.0], [4.0]])
    x_s, v_s, force = np.exp(rng.uniform(low, high, (3, PLANTS)))
    ratio = rng.uniform(0.3, 0.8, PLANTS)
    micro, d, c = rng.uniform(0.0, 1.0, (3, PLANTS)) * [[0.05], [0.05], [1.0]]
    return map(LuGreOperator, x_s, v_s, ratio, force, micro, np.zeros(PLANTS), d, c)


def maxwell_slip(rng):
    weights = rng.uniform(0.2, 2.0, (4, PLANTS))
    d, c = rng.uniform(-1.0, 1.0, (2, PLANTS)) * [[0.02], [1.0]]
    thresholds = np.tile(THRESHOLDS, (PLANTS, 1))
    return map(MaxwellSlipOperator, thresholds, weights.T, np.zeros(PLANTS), d, c)


def duhem(rng):
    alpha = np.exp(rng.uniform(np.log(2.0), np.log(20.0), PLANTS))
    curve, slope, intercept = rng.uniform([[0.5], [2], [-1]], [[1.5], [6], [1]], (3, PLANTS))
    return map(DuhemOperator, alpha, curve[:, None], slope[:, None], intercept)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "make"),
    [
        (CoulombFriction(stribeck=True), coulomb),
        (Dahl(fit_stiffness=True), dahl),
        (LuGre(), lugre),
        (MaxwellSlip(), maxwell_slip),
        (Duhem(), duhem),
    ],
)
def test_plants_are_recovered_to_the_noise_with_honest_errors(model, make, assert_recovered):
    rng = np.random.default_rng(4)
    u, operators = motions(rng), list(make(rng))
    noise = rng.normal(size=(N, PLANTS))
    # units of the drive, of the response and of time, none of them the natural one
    units = 10.0 ** rng.uniform(-9.0, 9.0, (3, PLANTS))
    held = model.held_parameters()

    def in_units(i):
        length, force, time = units[:, i]
        clean = force * operators[i].run(u[:, i], TIME[1])[0]
        size = NOISE * clean.std()
        truth = {
            name: value * np.prod(units[:, i] ** POWERS[spec.unit])
            for (name, spec), value in zip(operators[i].entries(), operators[i].pack(), strict=True)
            if name not in held
        }
        options = {"dt": TIME[1] * time}
        if isinstance(model, MaxwellSlip):
            options["thresholds"] = THRESHOLDS * length
        rms = size * np.sqrt(np.mean(noise[:, i] ** 2))
        return length * u[:, i], clean, clean + size * noise[:, i], rms, truth, options

    assert_recovered(model, map(in_units, range(PLANTS)))
