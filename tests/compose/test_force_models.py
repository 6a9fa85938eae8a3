"""A friction force beside a declared force model, identified jointly, on plants in plain numpy."""

import numpy as np
import pytest

from skhyst.compose import Cascade, Sum
from skhyst.hysteresis import BoucWen, CoulombFriction, Dahl, LuGre, MaxwellSlip
from skhyst.linear import DynamicStiffness, FirstOrderLag

N, PLANTS, NOISE = 1500, 4, 0.005
TIME = np.linspace(0.0, 1.0, N)
DT = TIME[1]
THRESHOLDS = np.array([0.05, 0.2, 0.5])


def motions(rng):
    frequencies = np.geomspace(1.3, 21.0, 6)[:, None]
    phases = rng.uniform(0.0, 2 * np.pi, (6, PLANTS))
    sizes = rng.uniform(0.5, 1.5, (6, PLANTS)) / frequencies**1.2
    waves = np.sin(2 * np.pi * frequencies * TIME[:, None, None] + phases)
    u = np.sum(sizes * waves, axis=1)
    return 2.0 * (u - u[0]) / np.ptp(u, axis=0)


def walk(u, move, substeps=1):
    """Return what ``move(state, change)`` makes of zero along the straight lines of ``u``."""
    found, state = np.zeros_like(u), np.zeros(PLANTS)
    for k in range(1, N):
        for _ in range(substeps):
            state = move(state, (u[k] - u[k - 1]) / substeps)
        found[k] = state
    return found


def coulomb(rng, u, v):
    return np.tanh(v / (rng.uniform(0.01, 0.1, PLANTS) * np.abs(v).max(axis=0)))


def stribeck(rng, u, v):
    speed = rng.uniform(0.1, 0.4, PLANTS) * np.abs(v).max(axis=0)
    more = rng.uniform(0.3, 1.0, PLANTS) * np.exp(-((v / speed) ** 2))
    return (1.0 + more) * np.tanh(v / (0.1 * speed))


def dahl(rng, u, v):
    x_c = rng.uniform(0.02, 0.3, PLANTS)

    def move(w, change):
        sign = np.sign(change)
        return sign - (sign - w) * np.exp(-np.abs(change) / x_c)

    return walk(u, move)


def lugre(rng, u, v):
    x_s, ratio = rng.uniform([[0.02], [0.4]], [[0.3], [0.8]], (2, PLANTS))
    speed = rng.uniform(0.1, 0.4, PLANTS) * np.abs(v).max(axis=0)

    def move(w, change):
        g = np.sign(change) * (ratio + (1.0 - ratio) * np.exp(-((change / DT / speed) ** 2)))
        return g - (g - w) * np.exp(-np.abs(change / g) / x_s)

    return walk(u, move)


def bouc_wen(rng, u, v):
    limit, ratio = rng.uniform([[0.05], [0.3]], [[0.4], [2.0]], (2, PLANTS))

    def rate(z, sign):
        return 1.0 - np.abs(z) ** 1.5 * np.where(sign * z > 0.0, 1.0, -ratio)

    def move(z, change):
        half = z + 0.5 * change / limit * rate(z, np.sign(change))
        return z + change / limit * rate(half, np.sign(change))

    return walk(u, move, 40)


def slip(rng, u, v):
    weights = rng.uniform(0.5, 2.0, (3, PLANTS))
    return sum(
        weight * walk(u, lambda x, change, r=r: np.clip(x + change, -r, r))
        for weight, r in zip(weights, THRESHOLDS, strict=True)
    )


CASES = {
    "Coulomb": (coulomb, lambda: CoulombFriction(fit_damping=False)),
    "Stribeck": (stribeck, lambda: CoulombFriction(stribeck=True, fit_damping=False)),
    "Dahl": (dahl, lambda: Dahl(fit_damping=False)),
    "LuGre": (lugre, lambda: LuGre(fit_damping=False)),
    "BoucWen": (bouc_wen, lambda: BoucWen(1.5, fit_gain=False)),
    "MaxwellSlip": (slip, lambda: MaxwellSlip(thresholds=THRESHOLDS, fit_damping=False)),
}


def plants(name):
    """Return motions, forces without noise, and mass, damping, stiffness, one column a plant."""
    rng = np.random.default_rng(1)
    u = motions(rng)
    v = np.diff(u, axis=0, prepend=u[:1]) / DT
    a = np.diff(v, axis=0, prepend=v[:1]) / DT
    a[:2] = 0.0
    terms = np.array([a, v, u])
    values = rng.uniform(0.3, 1.0, (3, PLANTS)) / terms.std(axis=1)
    friction = CASES[name][0](rng, u, v)
    friction *= rng.uniform(0.3, 1.0, PLANTS) / np.abs(friction).max(axis=0)
    return u, np.einsum("tnp,tp->np", terms, values) + friction + 0.5, values


@pytest.mark.parametrize("name", CASES)
def test_friction_beside_a_declared_model(name):
    u, force, values = plants(name)
    hits, rng = [], np.random.default_rng(2)
    for i in range(PLANTS):
        noise = NOISE * force[:, i].std() * rng.normal(size=N)
        steps = [("declared", DynamicStiffness()), ("friction", CASES[name][1]())]
        # a parameter that is there twice would be named in a warning, which is an error
        model = Sum(steps, dt=DT).fit(u[:, [i]], force[:, i] + noise)
        assert model.fit_error_ <= 1.02 * np.sqrt(np.mean(noise**2))
        assert "friction__intercept" not in model.params_
        for parameter, value in zip(("mass", "damping", "stiffness"), values[:, i], strict=True):
            parameter = f"declared__{parameter}"
            hits.append(abs(model.params_[parameter] - value) <= 3 * model.params_std_[parameter])
    assert np.mean(hits) >= 0.9


@pytest.mark.parametrize("name", ["Coulomb", "LuGre"])
def test_behind_them_a_lag(name):
    """The sensor of the force is slow; its response to straight lines is written out."""
    u, force, _ = plants(name)
    rng, tau = np.random.default_rng(3), 5.0 * DT
    for i in range(2):
        y, decay = np.empty(N), np.exp(-DT / tau)
        y[0] = force[0, i]
        for k in range(1, N):
            slope = (force[k, i] - force[k - 1, i]) / DT
            y[k] = force[k, i] - tau * slope + decay * (y[k - 1] - force[k - 1, i] + tau * slope)
        noise = NOISE * y.std() * rng.normal(size=N)
        both = Sum([("declared", DynamicStiffness()), ("friction", CASES[name][1]())])
        model = Cascade([("force", both), ("lag", FirstOrderLag())], dt=DT)
        model.fit(u[:, [i]], y + noise)
        assert model.fit_error_ <= 1.02 * np.sqrt(np.mean(noise**2))
        assert {n for n in model.params_ if n.startswith("lag")} == {"lag__time_constant"}
        assert model.params_["lag__time_constant"] == pytest.approx(tau, rel=0.05)
