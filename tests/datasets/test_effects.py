"""The effects of the simulated devices by their closed forms, and what is refused of them."""

from functools import cache, partial

import numpy as np
import pandas as pd
import pytest

from skhyst.datasets import make_inchworm_motor, make_scanning_stage, swept_sine, triangle
from skhyst.datasets._device import EFFECTS, Device, complete_effects, path
from skhyst.datasets.simulation import oscillate, plays
from skhyst.records import record_slices, stack_records

DT = 1e-3
SLOW = np.sin(2 * np.pi * 0.5 * DT * np.arange(2000))
STEP = np.concatenate([[0.0], np.ones(1999)])


def nothing(signal, step, **_):
    return signal


def with_effect(name, drive, substeps=1, core=nothing, motion=nothing, **parameters):
    """Return the response of a device of full scale 1 and of nothing but one effect."""
    settings = complete_effects({name: parameters}, 0.01, "rig")[name]
    effect = getattr(Device(1.0, 1.0, ()), name)(**settings)
    (plant,) = effect.changes([path(partial(core), partial(motion))])
    return plant.adapt("gain", peak=np.abs(drive).max()).respond(drive, substeps, DT)


def test_limits_of_the_drive_and_of_the_sensor():
    assert np.abs(with_effect("input_saturation", SLOW, strength=0.4)).max() == 0.6
    assert np.abs(with_effect("output_saturation", SLOW, strength=0.4)).max() == 0.6
    dead = with_effect("dead_zone", SLOW, strength=0.2)
    assert np.array_equal(dead == 0.0, np.abs(SLOW) <= 0.2)
    assert dead.max() == pytest.approx(0.8)
    slow = with_effect("slew_limit", SLOW, frequency=0.25)
    assert np.abs(np.diff(slow)).max() == pytest.approx(2 * np.pi * 0.25 * DT, rel=1e-9)
    play = with_effect("backlash", SLOW, strength=0.1)
    assert np.abs(SLOW - play).max() == pytest.approx(0.1)
    half = partial(plays, thresholds=[0.0], weights=[0.5])
    late = with_effect("backlash", SLOW, core=half, strength=0.1, place="response")
    assert np.array_equal(late, plays(0.5 * SLOW, DT, [0.1], [1.0]))


def test_linear_effects_have_their_gains():
    creep = with_effect("creep", STEP, strength=0.3, time_constants=[0.02, 0.1])
    assert creep[-1] == pytest.approx(1.3, abs=1e-6)
    assert 1.0 < creep[1] < 1.01
    lag = with_effect("lag", STEP, strength=2.0, time_constant=0.1)
    assert lag[201] == pytest.approx(-np.expm1(-1.0), abs=5e-3)
    ringing = with_effect("resonance", STEP, strength=0.2, frequency=20.0, damping=0.05)
    assert ringing.max() == pytest.approx(1.0 + 0.2 * np.exp(-np.pi * 0.05), rel=2e-3)
    late = with_effect("delay", SLOW, time=0.01)
    assert np.allclose(late[10:], SLOW[:-10], atol=1e-9)


def test_memory_and_curves():
    def core(signal, step, stretch=0.0):
        return plays(signal, step, [0.2], [1.0], stretch)

    ramp = 2.0 * np.pi * DT * np.arange(200)  # as fast as a sine of 1 Hz and full scale
    wide = with_effect("rate_dependence", ramp, core=core, strength=0.5, frequency=1.0)
    assert np.allclose(wide[60:], ramp[60:] - 0.3)
    assert np.allclose(with_effect("amplitude_dependence", 0.5 * SLOW, strength=0.2), 0.55 * SLOW)
    bent = with_effect("asymmetry", SLOW, strength=0.3, side=-1, threshold=0.5)
    assert bent.max() == 1.0
    assert bent.min() == pytest.approx(-1.3)
    for order, ends in ((3, (-0.8, 0.8)), (2, (-1.2, 0.8))):
        curve = with_effect("static_nonlinearity", SLOW, strength=-0.2, order=order)
        assert np.allclose((curve.min(), curve.max()), ends)


def test_slow_forces():
    """Friction opens the loop by twice its level, a cubic spring is a static curve."""
    motion = partial(oscillate, frequency=200.0, damping=0.5, base=1.0)
    options = {"static": 1.0, "presliding": 0.005}
    x = with_effect("friction", SLOW, 10, motion=motion, strength=0.08, **options)
    for part, level in ((slice(1500, 1990), 0.08), (slice(600, 1400), -0.08)):
        assert np.median((SLOW - x)[part]) == pytest.approx(level, rel=0.02)
    x = with_effect("cubic_stiffness", SLOW, 20, motion=motion, strength=0.4)
    assert np.allclose(x + 0.4 * x**3, SLOW, atol=2e-3)


def test_what_is_beside_belongs_to_its_record_alone():
    X = stack_records([SLOW[:500], SLOW[:500]], dt=DT)
    device = Device(1.0, 1.0, record_slices(X), seed=1)
    alone = Device(1.0, 1.0, record_slices(X)[:1], seed=1)
    random = ("offset", "periodic_disturbance", "auxiliary_input")
    for name in random:
        a, b = getattr(device, name)().additive
        assert np.array_equal(a, getattr(alone, name)().additive[0])
        assert not np.array_equal(a, b)
    name, (column, _) = device.auxiliary_input().column
    assert name == "temperature"
    assert np.abs(column).max() <= 1.0
    drift = device.drift(time_constant=0.1).additive[0]
    assert (drift[0], drift[100]) == pytest.approx((0.0, -0.1 * np.expm1(-1.0)))


@cache
def made(device, effects):
    if device == "motor":
        sweep = swept_sine(0.1, 300.0, duration=0.2, amplitude=5.0, dt=1e-4)["drive"]
        u = np.concatenate([sweep, np.full(500, 2.0)])
        return make_inchworm_motor(u, effects=effects and dict(effects), random_state=3)
    u = triangle(40.0, 1000.0, n_cycles=4, dt=4e-6)
    return make_scanning_stage(u, effects=effects and dict(effects), random_state=3)


@pytest.mark.parametrize("name", EFFECTS)
@pytest.mark.parametrize("device", ["motor", "stage"])
def test_every_effect_acts_and_none_at_zero_strength(device, name):
    X, y, truth = made(device, None)
    X_zero, y_zero, truth_zero = made(device, ((name, 0.0),))
    pd.testing.assert_frame_equal(X, X_zero)
    pd.testing.assert_series_equal(y, y_zero)
    assert truth_zero.effects == {}
    X_more, y_more, truth_more = made(device, ((name, True),))
    assert list(truth_more.effects) == [name]
    assert np.isfinite(y_more).all()
    change = np.abs(truth_more.response - truth.response).max()
    full_scale = {"motor": 0.57, "stage": 1.7}[device]  # um
    assert change > 0.005 * full_scale
    # the noise is the same, whatever the effects
    resolution = {"motor": 1e-4, "stage": 1.6e-4}[device]
    noise = y - truth.response
    assert np.allclose(y_more - truth_more.response, noise, atol=1.01 * resolution)
    assert list(X_more) == (["drive", "temperature"] if name == "auxiliary_input" else ["drive"])
    if name != "output_saturation":  # at a small strength it clips at full scale, at zero it ends
        small = made(device, ((name, 1e-7),))[2].response
        assert np.allclose(small, truth.response, atol=1e-3 * full_scale)


@pytest.mark.parametrize("period", [1e-6, 1.0])
def test_defaults_follow_the_time_of_the_device(period):
    own = complete_effects(EFFECTS, period, "rig")
    assert tuple(own) == EFFECTS
    assert own["lag"]["time_constant"] == pytest.approx(0.5 * period)
    assert own["resonance"]["frequency"] == pytest.approx(0.4 / period)


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ("crep", "name effects among slew_limit, .* Got 'crep'"),
        ({"creep": {"tau": 1.0}}, "'creep' among strength, time_constants. Got 'tau'"),
        ({"creep": "much"}, "as a mapping, or its strength as a number. Got 'much'"),
        ({"creep": -0.1}, "'strength' of 'creep' to a number from 0 to inf. Got -0.1"),
        ({"creep": {"time_constants": []}}, "sequence of positive numbers"),
        ({"creep": np.nan}, "Got nan"),
        ({"lag": {"time_constant": 0.0}}, "a positive number. Got 0.0"),
        ({"asymmetry": {"threshold": 1.0}}, "from 0 to below 1"),
        ({"asymmetry": {"side": 0}}, r"one of \(-1, 1\). Got 0"),
        ({"lag": {"time_constant": "slow"}}, "a positive number. Got 'slow'"),
    ],
)
def test_wrong_effects_are_refused(effects, message):
    with pytest.raises(ValueError, match=f"'effects' parameter of rig must .*{message}"):
        complete_effects(effects, 0.01, "rig")
