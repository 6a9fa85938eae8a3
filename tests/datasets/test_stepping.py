"""Simulated devices in motion: stepping is the recording."""

import numpy as np
import pytest

from skhyst.datasets import (
    inchworm_motor_stepper,
    make_inchworm_motor,
    make_scanning_stage,
    scanning_stage_stepper,
    walking_drive,
)

EFFECTS = [
    {},
    {"slew_limit": 5.0, "creep": 0.1, "resonance": 0.2, "delay": {"time": 3.3e-4}},
    {"backlash": {"place": "response"}, "rate_dependence": 0.5, "lag": 1.0, "asymmetry": 0.2},
    {"friction": 0.1, "cubic_stiffness": 0.2, "hysteretic_force": 0.1, "input_saturation": 0.2},
    {"dead_zone": 0.1, "static_nonlinearity": 0.1, "output_saturation": 0.4},
]
TIME = np.arange(400)
DRIVE = 0.4 + np.sin(0.11 * TIME) * np.sin(0.013 * TIME)  # of full scale


def motor(drive, effects):
    options = {"noise": 0.0, "resolution": 0.0}
    return make_inchworm_motor(drive, effects=effects, **options)[1].to_numpy()


def stage(drive, effects):
    return make_scanning_stage(drive, effects=effects, noise=0.0, quantize=False)[1].to_numpy()


def same(device, expected, drive):
    """Whether the device steps as is expected of it, alone, in parts, and copied."""
    close = {"rtol": 0.0, "atol": 1e-12 * np.ptp(expected)}
    other = device.copy()
    np.testing.assert_allclose([device.step(u) for u in drive[:100]], expected[:100], **close)
    np.testing.assert_allclose(device.run(drive[100:101]), expected[100:101], **close)
    np.testing.assert_allclose(device.copy().run(drive[101:]), expected[101:], **close)
    np.testing.assert_allclose(device.run(drive[101:]), expected[101:], **close)
    np.testing.assert_allclose(other.run(drive), expected, **close)


@pytest.mark.parametrize("effects", EFFECTS)
@pytest.mark.parametrize("hysteresis", ["bouc_wen", "prandtl_ishlinskii"])
def test_motor(effects, hysteresis):
    drive = 4.0 * DRIVE
    options = {"effects": effects, "hysteresis": hysteresis}
    _, y, _ = make_inchworm_motor(drive, noise=0.0, resolution=0.0, **options)
    same(inchworm_motor_stepper(drive[0], **options), y.to_numpy()[1:], drive[1:])


@pytest.mark.parametrize("effects", [{}, EFFECTS[1]])
def test_motor_that_walks(effects):
    drive = walking_drive(8, frequency=80.0).to_numpy()
    same(inchworm_motor_stepper(drive[0], effects=effects), motor(drive, effects)[1:], drive[1:])


@pytest.mark.parametrize("effects", EFFECTS)
def test_stage(effects):
    drive = 30.0 * DRIVE
    same(scanning_stage_stepper(drive[0], effects=effects), stage(drive, effects)[1:], drive[1:])


def test_slow_stage_with_forces_has_finer_steps():
    drive, options = 30.0 * DRIVE[:60], {"dt": 1e-4, "effects": "friction"}
    _, y, _ = make_scanning_stage(drive, noise=0.0, quantize=False, **options)
    device = scanning_stage_stepper(drive[0], **options)
    np.testing.assert_allclose([device.step(u) for u in drive[1:]], y[1:], rtol=0.0, atol=1e-11)


@pytest.mark.parametrize("effect", ["drift", "offset", "auxiliary_input", "amplitude_dependence"])
@pytest.mark.parametrize("stepper", [inchworm_motor_stepper, scanning_stage_stepper])
def test_effects_of_whole_records_are_refused(stepper, effect):
    with pytest.raises(ValueError, match=f"{stepper.__name__} must not hold '{effect}'"):
        stepper(effects=effect)


@pytest.mark.parametrize("wrong", [np.nan, [1.0, 2.0], []])
def test_a_wrong_drive_leaves_the_device_as_it_is(wrong):
    device = inchworm_motor_stepper(effects={"creep": 0.1})
    device.run(3.0 * DRIVE)
    other = device.copy()
    with pytest.raises(ValueError, match="finite numbers, 1 per sample"):
        device.step(wrong)
    with pytest.raises(ValueError, match="finite numbers, 1 per sample"):
        device.run([[1.0, 2.0]])
    assert device.step(1.0) == other.step(1.0)


@pytest.mark.parametrize(
    ("stepper", "options", "name"),
    [
        (inchworm_motor_stepper, {"u0": [1.0, 2.0]}, "u0"),
        (inchworm_motor_stepper, {"u0": np.inf}, "u0"),
        (inchworm_motor_stepper, {"hysteresis": "none"}, "hysteresis"),
        (inchworm_motor_stepper, {"u0": np.zeros(4), "effects": "cubic_stiffness"}, "effects"),
        (scanning_stage_stepper, {"u0": np.nan}, "u0"),
        (scanning_stage_stepper, {"dt": 0.0}, "dt"),
        (scanning_stage_stepper, {"effects": "wear"}, "effects"),
    ],
)
def test_bad_parameters_are_named(stepper, options, name):
    with pytest.raises(ValueError, match=f"'{name}' parameter of {stepper.__name__}"):
        stepper(**options)
