"""Stages found again in noise, from plants that are integrated here."""

import numpy as np
import pytest

from skhyst.hysteresis import BoucWenStage, FrictionStage, RestoringForce


def spread(low, high, n, rng):
    return np.exp(rng.uniform(np.log(low), np.log(high), n))


def scales(n, rng):
    return {
        "gain": rng.uniform(0.3, 3.0, n) * rng.choice([-1.0, 1.0], n),
        "intercept": rng.normal(size=n),
    }


def bouc_wen(n, w, rng):
    """Return the parameters of plants, (n,) each, and what integrates them."""
    p = {
        "natural_frequency": w,
        "damping_ratio": rng.uniform(0.1, 0.5, n),
        "hysteresis_stiffness": spread(0.5, 10.0, n, rng),
        "level": rng.uniform(0.05, 0.4, n),
        "shape": rng.uniform(-0.7, 0.9, n),
    } | scales(n, rng)
    _, zeta, rho, level, shape, *_ = p.values()

    def rates(x, drive):
        q, v, f = x
        bend = np.abs(f) / level * (np.abs(v) * np.sign(f) + shape * v)
        return np.stack([v, w * w * (drive - q - f) - 2.0 * zeta * w * v, rho * (v - bend)])

    return p, lambda dt, u: runge_kutta(rates, dt, u)


def friction(n, w, rng):
    p = {
        "natural_frequency": w,
        "damping_ratio": rng.uniform(0.1, 0.6, n),
        "static_level": rng.uniform(0.1, 0.4, n),
        "coulomb_ratio": rng.uniform(0.5, 0.85, n),
        "stribeck_velocity": rng.uniform(0.03, 0.12, n) * w,
        "bristle_stiffness": spread(4.0, 60.0, n, rng),
        "bristle_damping": rng.uniform(0.1, 0.5, n),
    } | scales(n, rng)
    _, zeta, static, ratio, vs, rho, bristle, *_ = p.values()

    def rates(x, drive):
        q, v, f = x
        level = static * (ratio + (1.0 - ratio) * np.exp(-((v / vs) ** 2)))
        slip = v - np.abs(v) * f / level
        force = drive - q - f - 2.0 * bristle / w * slip
        return np.stack([v, w * w * force - 2.0 * zeta * w * v, rho * slip])

    return p, lambda dt, u: runge_kutta(rates, dt, u)


def bilinear(n, w, rng):
    p = {
        "natural_frequency": w,
        "damping_ratio": rng.uniform(0.1, 0.5, n),
        "stiffness_coefficients[0]": rng.uniform(0.2, 0.8, n),
        "damping_coefficients[0]": rng.uniform(0.1, 0.5, n),
        "hysteresis_stiffness": spread(0.5, 20.0, n, rng),
        "slip_level": rng.uniform(0.05, 0.3, n),
        "preload": rng.uniform(-0.3, 0.3, n),
    } | scales(n, rng)

    def integrate(dt, u, n_steps=40):
        """The stop exactly along half steps, the velocity between."""
        w, zeta, cubic, damper, k, limit, preload, *_ = p.values()
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

    return p, integrate


def drives(n_samples, dt, w, rng):
    """Return five incommensurate sinusoids for each plant, (n_samples, n), half a swing is 1."""
    u = np.zeros((n_samples, len(dt)))
    for part, amplitude in ((0.03, 1.0), (0.08, 1.0), (0.19, 0.6), (0.41, 0.4), (0.83, 0.25)):
        phase = part * w * dt * np.arange(n_samples)[:, None]
        u += amplitude * np.sin(phase + rng.uniform(0.0, 6.28, len(dt)))
    u -= u[0]
    return 2.0 * u / np.ptp(u, axis=0)


def runge_kutta(rates, dt, u, n_steps=16):
    """Return the displacements by the method of Runge and Kutta, all plants at once."""
    x, h, found = np.zeros((3, len(dt))), dt / n_steps, np.zeros_like(u)
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
    rng = np.random.default_rng(1)
    w = 2.0 * np.pi * rng.uniform(15.0, 60.0, n)
    p, integrate = law(n, w, rng)
    dt = 2.0 * np.pi / w / 30.0
    u = drives(n_samples, dt, w, rng)
    clean = p["gain"] * integrate(dt, u) + p["intercept"]
    ratios, inside = [], []
    for i in range(n):
        noise = 0.005 * clean[:, i].std()
        y = clean[:, i] + noise * rng.normal(size=n_samples)
        found = model.set_params(dt=dt[i]).fit(u[:, [i]], y)
        ratios.append(found.fit_error_ / np.sqrt(np.mean((y - clean[:, i]) ** 2)))
        errors = [(found.params_[k] - p[k][i]) / found.params_std_[k] for k in p]
        inside += [abs(error) < 1.96 for error in errors]
    assert max(ratios) < 1.02
    assert 0.9 < np.mean(inside) < 0.99
