"""Friction that depends on the velocity alone."""

import dataclasses

import numpy as np
import pytest

from skhyst.hysteresis import CoulombFriction, CoulombFrictionOperator

DT = 1e-3
TIME = DT * np.arange(6000)
# to and fro, slower and faster, with rests between
SPEED = np.where(
    np.sin(5.0 * TIME) ** 2 > 0.2, np.sin(2.2 * TIME) * np.interp(TIME, [0.0, 6.0], [0.2, 1.0]), 0.0
)
MOTION = DT * np.cumsum(SPEED)


def test_force_of_steady_sliding_and_of_creeping():
    operator = CoulombFrictionOperator(0.01, 3.0, 0.1, 2.0, 0.5, damping=4.0, intercept=1.0)
    for v in (0.06, 2.0):
        level = 3.0 + 2.0 * np.exp(-((v / 0.1) ** 2))
        forward, backward = (operator.run(s * v * TIME[:5], DT)[0][-1] for s in (1, -1))
        assert forward == pytest.approx(level + 0.5 + 4.0 * v + 1.0, rel=2e-3)
        assert backward == pytest.approx(-level + 0.5 - 4.0 * v + 1.0, rel=2e-3)
    slope = (operator.run(1e-6 * TIME[:5], DT)[0][-1] - 1.0) / 1e-6
    assert slope == pytest.approx(5.0 / 0.01 + 4.0, rel=1e-3)


def test_levels_of_both_directions():
    y = np.where(SPEED > 0.0, 5.0, np.where(SPEED < 0.0, -3.0, 0.0)) + 0.7 * SPEED + 2.0
    y += 0.01 * np.random.default_rng(0).normal(size=len(y))
    v = np.r_[0.0, np.diff(MOTION)] / DT
    assert np.count_nonzero(v == 0.0) > 100
    model = CoulombFriction(asymmetry=True, dt=DT).fit(MOTION[:, None], y)
    assert model.operator_.coulomb_force == pytest.approx(4.0, abs=0.01)
    assert model.operator_.asymmetry == pytest.approx(1.0, abs=0.01)
    assert model.operator_.intercept == pytest.approx(2.0, abs=0.01)
    assert model.operator_.damping == pytest.approx(0.7, abs=0.03)
    plain = CoulombFriction(dt=DT).fit(MOTION[:, None], y)
    assert plain.fit_error_ > 10 * model.fit_error_


@pytest.mark.parametrize("smoothing", [1, 8])
@pytest.mark.parametrize("unit", [1.0, 1e-9])
def test_noise_of_an_encoder_does_not_chatter(smoothing, unit):
    """The force while the drive rests is small, though its noise goes to and fro."""
    rng = np.random.default_rng(1)
    noise = 2e-6
    u = unit * (MOTION + noise * rng.normal(size=len(MOTION)))
    y = 5.0 * np.sign(SPEED) + 0.7 * SPEED + 0.01 * rng.normal(size=len(MOTION))
    model = CoulombFriction(smoothing=smoothing, dt=DT).fit(u[:, None], y)
    slope = np.std(np.convolve(noise * rng.normal(size=9000), _weights(smoothing), "valid")) / DT
    assert model.operator_.transition_velocity > 2.0 * slope * unit
    assert model.operator_.slowest == pytest.approx(3.0 * slope * unit, rel=0.3)
    rest = np.convolve(SPEED != 0.0, np.ones(2 * smoothing + 1), "same") == 0
    assert np.std(model.predict(u[:, None])[rest]) < 2.0


def test_corners_of_the_drive_are_no_noise():
    rng = np.random.default_rng(0)
    ramps = np.convolve(np.repeat(rng.uniform(-1.0, 1.0, 40), 10), np.ones(9) / 9, "valid")
    plant = CoulombFrictionOperator(5.0, 2.0)
    y = plant.run(ramps, DT)[0] + 0.01 * rng.normal(size=len(ramps))
    model = CoulombFriction(dt=DT).fit(ramps[:, None], y)
    assert model.operator_.transition_velocity == pytest.approx(5.0, rel=0.02)


def _weights(n):
    """Return what the least-squares slope over n intervals multiplies the samples with."""
    places = np.arange(n + 1) - 0.5 * n
    return places / np.sum(places**2)


def test_short_drives():
    model = CoulombFriction(fit_damping=False, fit_intercept=False, dt=DT)
    with pytest.warns(UserWarning, match="do not determine"):
        model.fit([[0.0], [1.0], [3.0]], [0.0, 1.0, 1.0])
    np.testing.assert_allclose(model.predict([[0.0], [1.0], [3.0]]), [0.0, 1.0, 1.0], atol=1e-9)


def test_of_a_velocity_it_is_a_curve():
    """The same law as over the displacement, with the velocity that the backward difference is."""
    rng = np.random.default_rng(0)
    v = 0.3 * np.sin(3.0 * DT * np.arange(800)) + 0.1 * np.sin(17.0 * DT * np.arange(800))
    y = 0.7 * np.tanh(v / 0.02) + 0.4 * v + 0.05
    model = CoulombFriction(motion="velocity", dt=DT)
    model.fit(v[:, None], y + 1e-3 * rng.normal(size=800))
    true = {"transition_velocity": 0.02, "coulomb_force": 0.7, "damping": 0.4, "intercept": 0.05}
    assert set(model.params_) == set(true)
    for name, value in true.items():
        assert abs(model.params_[name] - value) < 3.0 * model.params_std_[name], name
    own = model.operator_
    by_place = dataclasses.replace(own, motion="displacement")
    place = DT * np.cumsum(v)
    np.testing.assert_allclose(by_place.run(place, DT)[0][1:], own.run(v, DT)[0][1:], atol=1e-12)
    with pytest.raises(ValueError, match="'stiffness' parameter of CoulombFrictionOperator"):
        dataclasses.replace(own, stiffness=1.0)
