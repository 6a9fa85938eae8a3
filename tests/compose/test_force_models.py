"""A friction force beside a declared force model, identified jointly."""

import numpy as np
import pytest

from skhyst.compose import Cascade, Sum
from skhyst.hysteresis import (
    BoucWen,
    BoucWenOperator,
    CoulombFriction,
    CoulombFrictionOperator,
    Dahl,
    DahlOperator,
    LuGre,
    LuGreOperator,
    MaxwellSlip,
    MaxwellSlipOperator,
)
from skhyst.linear import DynamicStiffness, FirstOrderLag, FirstOrderLagOperator

N, PLANTS, NOISE = 1500, 4, 0.005
TIME = np.linspace(0.0, 1.0, N)
DT = TIME[1]
THRESHOLDS = np.array([0.05, 0.2, 0.5])


def motion(rng):
    frequencies = np.geomspace(1.3, 21.0, 6)
    waves = np.sin(2 * np.pi * np.outer(TIME, frequencies) + rng.uniform(0.0, 2 * np.pi, 6))
    u = waves @ (rng.uniform(0.5, 1.5, 6) / frequencies**1.2)
    return 2.0 * (u - u[0]) / np.ptp(u)


def coulomb(rng, fastest):
    return CoulombFrictionOperator(rng.uniform(0.01, 0.1) * fastest, 1.0)


def stribeck(rng, fastest):
    speed = rng.uniform(0.1, 0.4) * fastest
    return CoulombFrictionOperator(0.1 * speed, 1.0, speed, rng.uniform(0.3, 1.0))


def dahl(rng, fastest):
    return DahlOperator(rng.uniform(0.02, 0.3), 1.0)


def lugre(rng, fastest):
    speed = rng.uniform(0.1, 0.4) * fastest
    return LuGreOperator(rng.uniform(0.02, 0.3), speed, rng.uniform(0.4, 0.8), 1.0)


def bouc_wen(rng, fastest):
    return BoucWenOperator(0.0, 1.0, rng.uniform(0.05, 0.4), rng.uniform(0.3, 2.0), 1.5)


def slip(rng, fastest):
    return MaxwellSlipOperator(THRESHOLDS, rng.uniform(0.5, 2.0, 3))


CASES = {
    "Coulomb": (coulomb, lambda: CoulombFriction(fit_damping=False)),
    "Stribeck": (stribeck, lambda: CoulombFriction(stribeck=True, fit_damping=False)),
    "Dahl": (dahl, lambda: Dahl(fit_damping=False)),
    "LuGre": (lugre, lambda: LuGre(fit_damping=False)),
    "BoucWen": (bouc_wen, lambda: BoucWen(1.5, fit_gain=False)),
    "MaxwellSlip": (slip, lambda: MaxwellSlip(thresholds=THRESHOLDS, fit_damping=False)),
}


def plants(name, count=PLANTS):
    """Yield motion, force without noise, and mass, damping, stiffness."""
    rng = np.random.default_rng(1)
    for _ in range(count):
        u = motion(rng)
        v = np.diff(u, prepend=u[0]) / DT
        a = np.diff(v, prepend=v[0]) / DT
        a[:2] = 0.0
        terms = np.stack([a, v, u], axis=1)
        values = rng.uniform(0.3, 1.0, 3) / terms.std(axis=0)
        friction = CASES[name][0](rng, np.abs(v).max()).run(u, DT)[0]
        friction *= rng.uniform(0.3, 1.0) / np.abs(friction).max()
        yield u[:, None], terms @ values + friction + 0.5, values


@pytest.mark.parametrize("name", CASES)
def test_friction_beside_a_declared_model(name):
    hits, rng = [], np.random.default_rng(2)
    for u, force, values in plants(name):
        noise = NOISE * force.std() * rng.normal(size=N)
        steps = [("declared", DynamicStiffness()), ("friction", CASES[name][1]())]
        # a parameter that is there twice would be named in a warning, which is an error
        model = Sum(steps, dt=DT).fit(u, force + noise)
        assert model.fit_error_ <= 1.02 * np.sqrt(np.mean(noise**2))
        assert "friction__intercept" not in model.params_
        for parameter, value in zip(("mass", "damping", "stiffness"), values, strict=True):
            parameter = f"declared__{parameter}"
            hits.append(abs(model.params_[parameter] - value) <= 3 * model.params_std_[parameter])
    assert np.mean(hits) >= 0.9


@pytest.mark.parametrize("name", ["Coulomb", "LuGre"])
def test_behind_them_a_lag(name):
    """The sensor of the force is slow."""
    rng, tau = np.random.default_rng(3), 5.0 * DT
    for u, force, _ in plants(name, 2):
        y = FirstOrderLagOperator(tau).run(force, DT)[0]
        noise = NOISE * y.std() * rng.normal(size=N)
        both = Sum([("declared", DynamicStiffness()), ("friction", CASES[name][1]())])
        model = Cascade([("force", both), ("lag", FirstOrderLag())], dt=DT).fit(u, y + noise)
        assert model.fit_error_ <= 1.02 * np.sqrt(np.mean(noise**2))
        assert {n for n in model.params_ if n.startswith("lag")} == {"lag__time_constant"}
        assert model.params_["lag__time_constant"] == pytest.approx(tau, rel=0.05)
