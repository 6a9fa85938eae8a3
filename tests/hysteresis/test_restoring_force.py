import numpy as np
import pytest
from scipy.integrate import solve_ivp

from skhyst.hysteresis import RestoringForce, RestoringForceOperator

DT = 0.01
TIME = DT * np.arange(1500)
U = np.sin(0.7 * TIME) + 0.8 * np.sin(2.9 * TIME) + 0.3 * np.sin(11.0 * TIME)
SCALE = 0.5 * np.ptp(U)
PLANT = RestoringForceOperator(
    20.0, 0.3, [0.4], [0.3], 4.0, 0.3, 0.2, 3.0, 0.5, scale=SCALE, n_substeps=5
)
NAMES = (
    "natural_frequency",
    "damping_ratio",
    "stiffness_coefficients[0]",
    "damping_coefficients[0]",
    "hysteresis_stiffness",
    "slip_level",
    "preload",
    "gain",
    "intercept",
)
N_PLANTS, N = 6, 1200


def plants():
    """Return true parameters, intervals, drives and responses of plants integrated here."""
    rng = np.random.default_rng(0)
    w = 2.0 * np.pi * rng.uniform(15.0, 60.0, N_PLANTS)
    values = (
        w,
        rng.uniform(0.1, 0.5, N_PLANTS),
        rng.uniform(0.2, 0.8, N_PLANTS),
        rng.uniform(0.1, 0.5, N_PLANTS),
        np.exp(rng.uniform(np.log(0.5), np.log(20.0), N_PLANTS)),
        rng.uniform(0.05, 0.3, N_PLANTS),
        rng.uniform(-0.3, 0.3, N_PLANTS),
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
    u *= 2.0 / np.ptp(u, axis=0)  # half a swing, by which the coefficients are scaled, is 1
    return p, dt, u, p["gain"] * integrate(p, dt, u) + p["intercept"]


def integrate(p, dt, u, n_steps=40):
    """Integrate all plants at once: the stop exactly along half steps, the velocity between."""
    w, zeta, cubic, damper, k, limit, preload = (p[name] for name in NAMES[:7])
    q = preload.copy()
    for _ in range(50):
        q -= (q + cubic * q**3 - preload) / (1.0 + 3.0 * cubic * q**2)
    v, z, h, found = np.zeros_like(w), np.zeros_like(w), dt / n_steps, np.zeros_like(u)
    found[0] = q

    def acceleration(v, drive):
        force = drive + preload - q - cubic * q**3 - z - damper * (v / w) ** 3
        return w * w * force - 2.0 * zeta * w * v

    for j in range(1, len(u)):
        for i in range(n_steps):
            drive = u[j - 1] + (i + 0.5) / n_steps * (u[j] - u[j - 1])
            q, z = q + 0.5 * h * v, np.clip(z + 0.5 * h * k * v, -limit, limit)
            middle = v + 0.5 * h * acceleration(v, drive)
            v = v + h * acceleration(middle, drive)
            q, z = q + 0.5 * h * v, np.clip(z + 0.5 * h * k * v, -limit, limit)
        found[j] = q
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
        model = RestoringForce(3, damping_degree=3, dt=dt[i]).fit(u[:, [i]], y)
        assert model.operator_.scale == pytest.approx(1.0)
        ratios.append(model.fit_error_ / np.sqrt(np.mean((y - clean[:, i]) ** 2)))
        errors = [(model.params_[n] - p[n][i]) / model.params_std_[n] for n in NAMES]
        inside += [abs(error) < 1.96 for error in errors]
    assert max(ratios) < 1.02
    assert 0.9 < np.mean(inside) < 0.99


def test_all_parameters_come_back_and_the_mass_scales_them():
    y, _ = PLANT.run(U, DT)
    model = RestoringForce(3, damping_degree=3, n_substeps=5, mass=2.0, dt=DT).fit(U[:, None], y)
    np.testing.assert_allclose(model.operator_.pack(), PLANT.pack(), rtol=1e-4)
    assert model.physical_ == pytest.approx(PLANT.physical(2.0), rel=1e-4)


@pytest.mark.parametrize("unit", [1e-6, 1e3])
@pytest.mark.parametrize("gain", [3.0, -3.0])
def test_duffing_oscillator(gain, unit):
    """Without hysteresis, the preload in the even term; against an integration in plain SciPy."""

    def motion(t, x):
        force = np.interp(t, TIME, U) + 0.2 - x[0] - 0.3 * x[0] ** 3 - x[1] / 20.0 * 0.3
        return [x[1], 400.0 * force]

    rest = np.roots([0.3, 0.0, 1.0, -0.2 - U[0]])
    rest = float(rest[np.isreal(rest)][0].real)
    q = solve_ivp(motion, (0.0, TIME[-1]), [rest, 0.0], t_eval=TIME, rtol=1e-8, max_step=DT).y[0]
    y = unit * (gain * q + 0.5)
    model = RestoringForce(3, damping_degree=1, fit_hysteresis=False, dt=DT).fit(U[:, None], y)
    assert set(model.params_) == {*NAMES} - {
        "damping_coefficients[0]",
        "hysteresis_stiffness",
        "slip_level",
    }
    expected = {
        "natural_frequency": 20.0,
        "damping_ratio": 0.15,
        "stiffness_coefficients[0]": 0.3 * SCALE**2,
        "preload": 0.2,
        "gain": unit * gain,
        "intercept": unit * 0.5,
    }
    assert model.params_ == pytest.approx(expected, rel=5e-3)
    assert model.fit_error_ < 1e-3 * np.std(y)
    assert np.isnan(model.physical_["x_s"])
    found = RestoringForce(3, damping_degree=1, fit_hysteresis=False, fit_preload=False, dt=DT)
    assert found.fit(U[:, None], y).operator_.preload == 0.0


@pytest.mark.parametrize(("degree", "size"), [(1, 0), (2, 0), (3, 1), (5, 2), (6, 2)])
def test_degrees(degree, size):
    y, _ = PLANT.run(U[:400], DT)
    for name, other in (("stiffness", "damping"), ("damping", "stiffness")):
        options = {f"{name}_degree": degree, f"{other}_degree": 1}
        model = RestoringForce(n_substeps=2, dt=DT, **options).fit(U[:400, None], y)
        assert len(getattr(model.operator_, f"{name}_coefficients")) == size
        # the preload of a linear spring is an intercept
        assert ("preload" in model.params_) == (name == "stiffness" and size > 0)


@pytest.mark.parametrize(("drive", "response", "time"), [(1e3, 1e-9, 1.0), (1e-6, 1e6, 1e-4)])
def test_units(drive, response, time):
    y, _ = PLANT.run(U, DT)
    y = y + 0.01 * np.random.default_rng(0).normal(size=len(y))
    plain = RestoringForce(3, damping_degree=1, dt=DT).fit(U[:, None], y)
    other = RestoringForce(3, damping_degree=1, dt=time * DT)
    other.fit(drive * U[:, None], response * y)
    np.testing.assert_allclose(
        other.predict(drive * U[:, None]) / response, plain.predict(U[:, None]), atol=1e-4
    )
    assert other.operator_.slip_level / drive == pytest.approx(plain.operator_.slip_level, rel=1e-3)


@pytest.mark.parametrize(
    ("name", "value"),
    [("stiffness_degree", 0), ("damping_degree", 1.5), ("fit_preload", 2), ("fit_hysteresis", 2)],
)
def test_wrong_parameters(name, value):
    with pytest.raises(ValueError, match=f"The '{name}' parameter of RestoringForce"):
        RestoringForce(**{name: value}).fit(U[:, None], U)
