import numpy as np
import pandas as pd
import pytest

from skhyst.hysteresis import BoucWenStage
from skhyst.operators import BoucWenStageOperator

DT = 0.01
TIME = DT * np.arange(1500)
U = np.sin(0.7 * TIME) + 0.8 * np.sin(2.9 * TIME) + 0.3 * np.sin(11.0 * TIME)
PLANT = BoucWenStageOperator(20.0, 0.3, 4.0, 0.3, 0.4, 1.0, 3.0, 0.5, n_substeps=5)
NAMES = (
    "natural_frequency",
    "damping_ratio",
    "hysteresis_stiffness",
    "level",
    "shape",
    "gain",
    "intercept",
)
N_PLANTS, N = 5, 1000


def plants():
    """Return true parameters, intervals, drives and responses of plants integrated here."""
    rng = np.random.default_rng(2)
    w = 2.0 * np.pi * rng.uniform(15.0, 60.0, N_PLANTS)
    values = (
        w,
        rng.uniform(0.1, 0.5, N_PLANTS),
        np.exp(rng.uniform(np.log(0.5), np.log(10.0), N_PLANTS)),
        rng.uniform(0.05, 0.4, N_PLANTS),
        rng.uniform(-0.7, 0.9, N_PLANTS),
        rng.uniform(0.3, 3.0, N_PLANTS) * rng.choice([-1.0, 1.0], N_PLANTS),
        rng.normal(size=N_PLANTS),
    )
    p = dict(zip(NAMES, values, strict=True))
    dt = 2.0 * np.pi / w / 30.0
    u = np.zeros((N, N_PLANTS))
    for part, amplitude in ((0.03, 1.0), (0.08, 1.0), (0.19, 0.6), (0.41, 0.4), (0.83, 0.25)):
        phase = part * w * dt * np.arange(N)[:, None]
        u += amplitude * np.sin(phase + rng.uniform(0.0, 6.28, N_PLANTS))
    u -= u[0]
    u /= np.abs(u).max(axis=0)
    return p, dt, u, p["gain"] * integrate(p, dt, u) + p["intercept"]


def integrate(p, dt, u, n_steps=12):
    """Integrate the equations of all plants at once by the method of Runge and Kutta."""
    w, zeta, rho, level, shape = (p[name] for name in NAMES[:5])

    def rates(x, drive):
        q, v, f = x
        bend = np.abs(f) / level * (np.abs(v) * np.sign(f) + shape * v)
        return np.stack([v, w * w * (drive - q - f) - 2.0 * zeta * w * v, rho * (v - bend)])

    x, h, found = np.zeros((3, len(w))), dt / n_steps, np.zeros_like(u)
    for k in range(1, len(u)):
        rise = (u[k] - u[k - 1]) / n_steps
        for i in range(n_steps):
            start = u[k - 1] + i * rise
            a = rates(x, start)
            b = rates(x + 0.5 * h * a, start + 0.5 * rise)
            c = rates(x + 0.5 * h * b, start + 0.5 * rise)
            d = rates(x + h * c, start + rise)
            x = x + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        found[k] = x[0]
    return found


@pytest.mark.filterwarnings("error")
def test_recovery_from_noise():
    """At the noise floor, and the standard errors are true, with starting values of its own."""
    p, dt, u, clean = plants()
    rng = np.random.default_rng(5)
    ratios, inside = [], []
    for i in range(N_PLANTS):
        noise = 0.005 * clean[:, i].std()
        y = clean[:, i] + noise * rng.normal(size=N)
        model = BoucWenStage(dt=dt[i]).fit(u[:, [i]], y)
        ratios.append(model.fit_error_ / np.sqrt(np.mean((y - clean[:, i]) ** 2)))
        errors = [(model.params_[n] - p[n][i]) / model.params_std_[n] for n in NAMES]
        inside += [abs(error) < 1.96 for error in errors]
    assert max(ratios) < 1.02
    assert np.mean(inside) > 0.85


@pytest.mark.parametrize(("shape", "exponent"), [(0.4, 1.0), (-1.2, 1.0), (0.4, 2.0)])
def test_all_parameters_come_back_and_the_mass_scales_them(shape, exponent):
    plant = BoucWenStageOperator(20.0, 0.3, 4.0, 0.3, shape, exponent, 3.0, 0.5, n_substeps=5)
    y, _ = plant.run(U, DT)
    model = BoucWenStage(fit_exponent=exponent > 1.0, n_substeps=5, mass=2.0, dt=DT)
    model.fit(U[:, None], y)
    np.testing.assert_allclose(model.operator_.pack(), plant.pack(), rtol=1e-4)
    assert model.physical_ == pytest.approx(plant.physical(2.0), rel=1e-3)


@pytest.mark.parametrize(("drive", "response", "time"), [(1e3, 1e-9, 1.0), (1e-6, 1e6, 1e-4)])
def test_units(drive, response, time):
    y, _ = PLANT.run(U, DT)
    y = y + 0.01 * np.random.default_rng(0).normal(size=len(y))
    plain = BoucWenStage(dt=DT).fit(U[:, None], y)
    other = BoucWenStage(dt=time * DT).fit(drive * U[:, None], response * y)
    np.testing.assert_allclose(
        other.predict(drive * U[:, None]) / response, plain.predict(U[:, None]), atol=1e-4
    )
    assert other.operator_.level / drive == pytest.approx(plain.operator_.level, rel=1e-3)


def test_several_records_and_zero_state():
    index = pd.MultiIndex.from_product([["a", "b"], DT * np.arange(750)], names=["record", "time"])
    X = pd.DataFrame({"drive": U}, index)
    y = np.concatenate(
        [PLANT.run(part, DT, PLANT.init(part[0], "zero"))[0] for part in np.split(U, 2)]
    )
    model = BoucWenStage(n_substeps=5, initial_state="zero").fit(X, y)
    np.testing.assert_allclose(model.operator_.pack(), PLANT.pack(), rtol=1e-4)


@pytest.mark.parametrize(("name", "value"), [("exponent", 0.5), ("fit_exponent", 2), ("mass", 0.0)])
def test_wrong_parameters(name, value):
    with pytest.raises(ValueError, match=f"The '{name}' parameter of BoucWenStage"):
        BoucWenStage(**{name: value}).fit(U[:, None], U)
