"""The law of a stage with LuGre friction; what holds for all stages is in test_oscillator.py."""

import dataclasses

import numpy as np
import pytest

from skhyst.hysteresis import FrictionStage, FrictionStageOperator
from skhyst.hysteresis._friction_stage import displacement, displacement_tangents
from skhyst.hysteresis._oscillator import OWN, P

W, ZETA, FS, RATIO, VS, RHO, BRISTLE = 60.0, 0.3, 0.3, 0.65, 4.0, 10.0, 0.2
STAGE = FrictionStageOperator(W, ZETA, FS, RATIO, VS, RHO, BRISTLE)
DT = 0.01
TIME = DT * np.arange(1500)
U = np.sin(0.7 * TIME) + 0.8 * np.sin(2.9 * TIME) + 0.3 * np.sin(11.0 * TIME)


def test_it_sticks_below_the_limit():
    """A stage at rest in the middle stays there, but for the bend of the bristles."""
    stage = FrictionStageOperator(W, ZETA, 1.0, 0.8, VS, 1e4, n_substeps=32)
    u = 0.5 * np.sin(8e-3 * np.arange(4000))
    y, _ = stage.run(u, 1e-3)
    assert np.abs(y).max() < 1.5 * 0.5 / 1e4
    moving, _ = stage.run(4.0 * u, 1e-3)
    assert np.abs(moving).max() > 0.5


@pytest.mark.parametrize(("velocity", "level"), [(0.01, FS), (40.0, FS * RATIO)])
def test_slow_sliding_takes_the_static_force_and_fast_sliding_the_coulomb_force(velocity, level):
    """On a ramp the stage lags behind by friction and viscous force."""
    stage = dataclasses.replace(STAGE, n_substeps=16)
    time = np.linspace(0.0, 4.0, 2001) / (velocity if velocity < 1 else 4.0)
    u = velocity * time
    y, state = stage.run(u, time[1])
    assert u[-1] - y[-1] == pytest.approx(level + 2.0 * ZETA / W * velocity, rel=1e-3)
    assert state[2] == pytest.approx(level, rel=1e-3)


def test_friction_that_does_not_fall_has_no_stribeck_velocity():
    level = dataclasses.replace(STAGE, coulomb_ratio=1.0)
    told = STAGE.characteristics(None).keys() - level.characteristics(None).keys()
    assert told == {"stribeck velocity"}


def test_slow_motion_is_independent_of_the_rate():
    stage = dataclasses.replace(STAGE, coulomb_ratio=1.0, bristle_damping=0.0)
    u = np.interp(np.arange(4001) / 1000.0, [0, 1, 2, 3, 4], [0.0, 1.0, -0.5, 0.7, 0.2])
    slow, slower = (stage.run(u, dt)[0] for dt in (0.02, 0.04))
    np.testing.assert_allclose(slow, slower, atol=1e-3)


def test_derivatives_at_rest_are_the_mean_of_both_directions():
    """The exponent grows with the size of the displacement: its derivative at zero is zero."""
    law, free_d, b, f, h = (
        (FS, RATIO, 1.0 / (DT * VS), RHO, 2.0 * BRISTLE / (W * DT)),
        0.1,
        0.3,
        0.2,
        1e-6,
    )
    by = np.zeros((3, OWN + 7))
    by[0, P] = 1.0  # the guess alone depends on it
    value = displacement_tangents(0.0, free_d, b, f, law, VS, 0.0, 0.0, by)
    np.testing.assert_allclose(value, displacement(0.0, free_d, b, f, law))
    ahead, behind = (np.array(displacement(d, free_d, b, f, law)) for d in (h, -h))
    np.testing.assert_allclose(by[:, P], (ahead - behind) / (2.0 * h), atol=1e-6)
    assert np.abs(ahead - value).max() > 1e-3 * h  # to either side it is not


@pytest.mark.parametrize("gradient", [0.0, 0.3])
def test_without_stribeck_effect(gradient):
    """The level of friction that changes along the way is that at its centre."""
    plant = FrictionStageOperator(20.0, 0.5, 0.4, 1.0, 1.5, 10.0, 0.0, 3.0, n_substeps=7)
    if gradient:
        plant = dataclasses.replace(plant, friction_gradient=gradient, friction_center=0.0)
    y, _ = plant.run(U, DT)
    model = FrictionStage(
        False,
        fit_bristle_damping=False,
        friction_gradient=gradient != 0.0,
        fit_intercept=False,
        n_substeps=7,
        dt=DT,
    )
    found = model.fit(U[:, None], y).operator_
    held = ("coulomb_ratio", "stribeck_velocity", "bristle_damping", "intercept")
    assert list(model.params_) == [name for name in plant.parameter_specs() if name not in held]
    assert (found.coulomb_ratio, found.bristle_damping, found.intercept) == (1.0, 0.0, 0.0)
    at_center = 1.0 + gradient * found.friction_center if gradient else 1.0
    assert found.static_level == pytest.approx(0.4 * at_center, rel=1e-5)
    assert found.friction_gradient == pytest.approx(gradient / at_center, rel=1e-4)


def test_records_too_short_for_a_balance_of_forces():
    plant = FrictionStageOperator(20.0, 0.5, 0.4, 0.7, 1.5, 10.0, 0.1, 3.0, 0.5, n_substeps=7)
    y, _ = plant.run(U[:60], DT)
    model = FrictionStage(False, fit_bristle_damping=False, dt=DT).fit(U[:60, None], y)
    assert model.score(U[:60, None], y) > 0.99
