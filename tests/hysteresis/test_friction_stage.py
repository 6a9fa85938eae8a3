import numpy as np
import pandas as pd
import pytest

from skhyst.hysteresis import FrictionStage
from skhyst.operators import FrictionStageOperator

DT = 0.01
TIME = DT * np.arange(1500)
U = np.sin(0.7 * TIME) + 0.8 * np.sin(2.9 * TIME) + 0.3 * np.sin(11.0 * TIME)
PLANT = FrictionStageOperator(20.0, 0.5, 0.4, 0.7, 1.5, 10.0, 0.1, 3.0, 0.5, n_substeps=7)
NAMES = list(PLANT.parameter_specs())
N_PLANTS, N = 10, 1200


def drives(dt, frequency, rng):
    """Return five incommensurate sinusoids for each of the plants, (N, n_plants), from 0 to 1."""
    u = np.zeros((N, len(dt)))
    for part, amplitude in ((0.03, 1.0), (0.08, 1.0), (0.19, 0.6), (0.41, 0.4), (0.83, 0.25)):
        phase = part * frequency * dt * np.arange(N)[:, None]
        u += amplitude * np.sin(phase + rng.uniform(0.0, 6.28, len(dt)))
    u -= u[0]
    return u / np.abs(u).max(axis=0)


def plants():
    """Return true parameters, intervals, drives and responses of plants integrated here."""
    rng = np.random.default_rng(1)
    w = 2.0 * np.pi * rng.uniform(15.0, 60.0, N_PLANTS)
    p = {
        "natural_frequency": w,
        "damping_ratio": rng.uniform(0.1, 0.6, N_PLANTS),
        "static_level": rng.uniform(0.1, 0.4, N_PLANTS),
        "coulomb_ratio": rng.uniform(0.5, 0.85, N_PLANTS),
        "stribeck_velocity": rng.uniform(0.03, 0.12, N_PLANTS) * w,
        "bristle_stiffness": np.exp(rng.uniform(np.log(4.0), np.log(60.0), N_PLANTS)),
        "bristle_damping": rng.uniform(0.1, 0.5, N_PLANTS),
        "gain": rng.uniform(0.3, 3.0, N_PLANTS) * rng.choice([-1.0, 1.0], N_PLANTS),
        "intercept": rng.normal(size=N_PLANTS),
    }
    dt = 2.0 * np.pi / w / 30.0
    u = drives(dt, w, rng)
    return p, dt, u, p["gain"] * integrate(p, dt, u) + p["intercept"]


def integrate(p, dt, u, n_steps=16):
    """Integrate the equations of all plants at once by the method of Runge and Kutta."""
    w, zeta, static, ratio, vs, rho, bristle = (p[name] for name in NAMES[:7])

    def rates(x, drive):
        _, v, f = x
        level = static * (ratio + (1.0 - ratio) * np.exp(-((v / vs) ** 2)))
        slip = v - np.abs(v) * f / level
        force = drive - x[0] - f - 2.0 * bristle / w * slip
        return np.stack([v, w * w * force - 2.0 * zeta * w * v, rho * slip])

    x, h, q = np.zeros((3, len(w))), dt / n_steps, np.zeros_like(u)
    for k in range(1, len(u)):
        rise = (u[k] - u[k - 1]) / n_steps
        for i in range(n_steps):
            start = u[k - 1] + i * rise
            a = rates(x, start)
            b = rates(x + 0.5 * h * a, start + 0.5 * rise)
            c = rates(x + 0.5 * h * b, start + 0.5 * rise)
            d = rates(x + h * c, start + rise)
            x = x + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        q[k] = x[0]
    return q


@pytest.mark.filterwarnings("error")
def test_recovery_from_noise():
    """At the noise floor, and the standard errors are true, with starting values of its own."""
    p, dt, u, clean = plants()
    rng = np.random.default_rng(5)
    ratios, inside = [], []
    for i in range(N_PLANTS):
        noise = 0.005 * clean[:, i].std()
        y = clean[:, i] + noise * rng.normal(size=N)
        model = FrictionStage(dt=dt[i]).fit(u[:, [i]], y)
        ratios.append(model.fit_error_ / np.sqrt(np.mean((y - clean[:, i]) ** 2)))
        errors = [(model.params_[n] - p[n][i]) / model.params_std_[n] for n in NAMES]
        inside += [abs(error) < 1.96 for error in errors]
    assert max(ratios) < 1.02
    assert 0.9 < np.mean(inside) < 0.99


def test_all_parameters_come_back_and_the_mass_scales_them():
    y, _ = PLANT.run(U, DT)
    model = FrictionStage(n_substeps=7, mass=2.0, dt=DT).fit(U[:, None], y)
    np.testing.assert_allclose(model.operator_.pack(), PLANT.pack(), rtol=1e-5)
    assert model.operator_.n_substeps == 7
    assert model.physical_ == pytest.approx(PLANT.physical(2.0), rel=1e-5)


def test_without_stribeck_effect():
    plant = FrictionStageOperator(20.0, 0.5, 0.4, 1.0, 1.5, 10.0, 0.0, 3.0, n_substeps=7)
    y, _ = plant.run(U, DT)
    model = FrictionStage(
        False, fit_bristle_damping=False, fit_intercept=False, n_substeps=7, dt=DT
    )
    model.fit(U[:, None], y)
    assert list(model.params_) == [
        "natural_frequency",
        "damping_ratio",
        "static_level",
        "bristle_stiffness",
        "gain",
    ]
    found = model.operator_
    assert (found.coulomb_ratio, found.bristle_damping, found.intercept) == (1.0, 0.0, 0.0)
    assert found.static_level == pytest.approx(0.4, rel=1e-5)


@pytest.mark.parametrize(("drive", "response", "time"), [(1e3, 1e-9, 1.0), (1e-6, 1e6, 1e-4)])
def test_units(drive, response, time):
    y, _ = PLANT.run(U, DT)
    y = y + 0.01 * np.random.default_rng(0).normal(size=len(y))
    options = {"fit_bristle_damping": False}
    plain = FrictionStage(dt=DT, **options).fit(U[:, None], y)
    other = FrictionStage(dt=time * DT, **options).fit(drive * U[:, None], response * y)
    np.testing.assert_allclose(
        other.predict(drive * U[:, None]) / response, plain.predict(U[:, None]), atol=1e-4
    )
    assert other.operator_.static_level / drive == pytest.approx(
        plain.operator_.static_level, rel=1e-3
    )


def test_several_records_and_zero_state():
    index = pd.MultiIndex.from_product([["a", "b"], DT * np.arange(750)], names=["record", "time"])
    X = pd.DataFrame({"drive": U}, index)
    y = np.concatenate(
        [PLANT.run(part, DT, PLANT.init(part[0], "zero"))[0] for part in np.split(U, 2)]
    )
    model = FrictionStage(n_substeps=7, initial_state="zero").fit(X, y)
    np.testing.assert_allclose(model.operator_.pack(), PLANT.pack(), rtol=1e-4)


def test_records_too_short_for_a_balance_of_forces():
    y, _ = PLANT.run(U[:60], DT)
    model = FrictionStage(False, fit_bristle_damping=False, dt=DT).fit(U[:60, None], y)
    assert model.score(U[:60, None], y) > 0.99


@pytest.mark.parametrize(
    ("name", "value"), [("mass", 0.0), ("n_substeps", 0), ("stribeck", 2), ("fit_intercept", "no")]
)
def test_wrong_parameters(name, value):
    with pytest.raises(ValueError, match=f"The '{name}' parameter of FrictionStage"):
        FrictionStage(**{name: value}).fit(U[:, None], U)
