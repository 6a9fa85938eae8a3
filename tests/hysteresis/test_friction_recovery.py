"""Friction models find the parameters of plants that were integrated without them."""

import numpy as np
import pytest

from skhyst.hysteresis import CoulombFriction, Dahl, Duhem, LuGre, MaxwellSlip

N, PLANTS, SUBSTEPS, NOISE = 1500, 20, 24, 0.005
TIME = np.linspace(0.0, 1.0, N)
DT = TIME[1]
THRESHOLDS = np.array([0.05, 0.2, 0.5, 1.1])


def drives(rng):
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


def integrate(rate, u, n_states=1):
    """Integrate ``rate(u, v, states)`` along the straight lines of ``u`` by fine Runge-Kutta steps.

    Returns states of shape (n_states, N, PLANTS) from zero, and the velocity behind each sample.
    """
    v = np.diff(u, axis=0, prepend=u[:1]) / DT
    found = np.zeros((n_states, N, PLANTS))
    x, h = np.zeros((n_states, PLANTS)), DT / SUBSTEPS
    for k in range(1, N):
        for i in range(SUBSTEPS):
            at = u[k - 1] + h * i * v[k]
            a = rate(at, v[k], x)
            b = rate(at + 0.5 * h * v[k], v[k], x + 0.5 * h * a)
            c = rate(at + 0.5 * h * v[k], v[k], x + 0.5 * h * b)
            d = rate(at + h * v[k], v[k], x + h * c)
            x = x + h / 6.0 * (a + 2 * b + 2 * c + d)
        found[:, k] = x
    return found, v


def coulomb(rng, u):
    low, high = np.log([[0.1], [2.0], [0.5]]), np.log([[0.4], [6.0], [4.0]])
    v_0, v_s, force = np.exp(rng.uniform(low, high, (3, PLANTS)))
    more, d, c = rng.uniform(0.3, 1.0, (3, PLANTS)) * [[2.0], [0.05], [1.0]]
    v = np.diff(u, axis=0, prepend=u[:1]) / DT
    truth = {
        "transition_velocity": (v_0, 1, 0, -1),
        "coulomb_force": (force, 0, 1, 0),
        "stribeck_velocity": (v_s, 1, 0, -1),
        "stribeck_force": (more, 0, 1, 0),
        "damping": (d, -1, 1, 1),
        "intercept": (c, 0, 1, 0),
    }
    return (force + more * np.exp(-((v / v_s) ** 2))) * np.tanh(v / v_0) + d * v + c, truth


def dahl(rng, u):
    x_c, force = np.exp(rng.uniform(np.log([[0.03], [0.5]]), np.log([[0.4], [4.0]]), (2, PLANTS)))
    k, d, c = rng.uniform(-1.0, 1.0, (3, PLANTS)) * [[1.0], [0.02], [1.0]]
    (w,), v = integrate(lambda u, v, w: (v - np.abs(v) * w) / x_c, u)
    truth = {
        "presliding_displacement": (x_c, 1, 0, 0),
        "coulomb_force": (force, 0, 1, 0),
        "stiffness": (k, -1, 1, 0),
        "damping": (d, -1, 1, 1),
        "intercept": (c, 0, 1, 0),
    }
    return force * w + k * u + d * v + c, truth


def lugre(rng, u):
    low, high = np.log([[0.05], [1.0], [0.5]]), np.log([[0.3], [5.0], [4.0]])
    x_s, v_s, force = np.exp(rng.uniform(low, high, (3, PLANTS)))
    ratio = rng.uniform(0.3, 0.8, PLANTS)
    micro, d, c = rng.uniform(0.0, 1.0, (3, PLANTS)) * [[0.05], [0.05], [1.0]]

    def bristles(u, v, w):
        gamma = ratio + (1.0 - ratio) * np.exp(-((v / v_s) ** 2))
        return (v - np.abs(v) * w / gamma) / x_s

    (w,), v = integrate(bristles, u)
    truth = {
        "presliding_displacement": (x_s, 1, 0, 0),
        "stribeck_velocity": (v_s, 1, 0, -1),
        "coulomb_ratio": (ratio, 0, 0, 0),
        "static_force": (force, 0, 1, 0),
        "bristle_damping": (micro, -1, 1, 1),
        "damping": (d, -1, 1, 1),
        "intercept": (c, 0, 1, 0),
    }
    return force * w + micro * x_s * bristles(u, v, w) + d * v + c, truth


def maxwell_slip(rng, u):
    weights = rng.uniform(0.2, 2.0, (4, PLANTS))
    d, c = rng.uniform(-1.0, 1.0, (2, PLANTS)) * [[0.02], [1.0]]
    v = np.diff(u, axis=0, prepend=u[:1]) / DT
    element, y = np.zeros((4, PLANTS)), np.zeros((N, PLANTS))
    for k in range(N):
        element = element + v[k] * DT
        element = np.minimum(np.maximum(element, -THRESHOLDS[:, None]), THRESHOLDS[:, None])
        y[k] = np.sum(weights * element, axis=0)
    truth = {f"weights[{i}]": (weights[i], -1, 1, 0) for i in range(4)}
    truth |= {"damping": (d, -1, 1, 1), "intercept": (c, 0, 1, 0)}
    return y + d * v + c, truth


def duhem(rng, u):
    alpha = np.exp(rng.uniform(np.log(2.0), np.log(20.0), PLANTS))
    a, b, c = rng.uniform([[0.5], [2.0], [-1.0]], [[1.5], [6.0], [1.0]], (3, PLANTS))
    (h,), _ = integrate(lambda u, v, h: alpha * np.abs(v) * (a * u - h) + b * v, u)
    truth = {
        "alpha": (alpha, -1, 0, 0),
        "curve[0]": (a, -1, 1, 0),
        "slope[0]": (b, -1, 1, 0),
        "intercept": (c, 0, 1, 0),
    }
    return h + c, truth


CASES = {
    "CoulombFriction": (coulomb, lambda unit: CoulombFriction(stribeck=True)),
    "Dahl": (dahl, lambda unit: Dahl(fit_stiffness=True)),
    "LuGre": (lugre, lambda unit: LuGre()),
    "MaxwellSlip": (maxwell_slip, lambda unit: MaxwellSlip(thresholds=THRESHOLDS * unit)),
    "Duhem": (duhem, lambda unit: Duhem()),
}


@pytest.mark.parametrize("name", CASES)
def test_plants_are_recovered_to_the_noise_with_honest_errors(name):
    plant, make = CASES[name]
    rng = np.random.default_rng(4)
    u = drives(rng)
    y, truth = plant(rng, u)
    noise = NOISE * y.std(axis=0) * rng.normal(size=y.shape)
    # units of the drive, of the response and of time, none of them the natural one
    units = 10.0 ** rng.uniform(-9.0, 9.0, (3, PLANTS))
    hits, evaluations = [], []
    for i in range(PLANTS):
        length, force, time = units[:, i]
        model = make(length).set_params(dt=DT * time)
        model.fit((length * u[:, i])[:, None], force * (y[:, i] + noise[:, i]))
        assert model.fit_error_ <= 1.02 * force * np.sqrt(np.mean(noise[:, i] ** 2))
        assert set(model.params_) == set(truth)
        for parameter, (value, *powers) in truth.items():
            error = model.params_[parameter] - value[i] * np.prod(units[:, i] ** powers)
            hits.append(abs(error) <= 1.96 * model.params_std_[parameter])
        evaluations.append(model.n_evaluations_)
    coverage = np.mean(hits)
    print(f"{name}: coverage {coverage:.3f}, evaluations {np.median(evaluations):g}")
    assert 0.90 <= coverage <= 0.99
