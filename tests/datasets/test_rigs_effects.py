"""The effects of the simulated devices against closed forms and SciPy."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.signal import lsim

from skhyst.datasets._effects import EFFECTS, EffectPath, first_order, plays, refine
from skhyst.datasets._motion import Forces, _advance, bouc_wen, oscillate

DT = 1e-3
TIME = DT * np.arange(2000)
SLOW = np.sin(2 * np.pi * 0.5 * TIME)
NOISE = np.cumsum(np.random.default_rng(0).standard_normal(2000)) / 50.0


def path(effects, period=0.01):
    return EffectPath.resolve(effects, drive=1.0, response=1.0, period=period, caller="rig", seed=1)


def one(name, **settings):
    return path({name: settings})


@pytest.mark.parametrize("tau", [1e-4, 0.03, 1e4])
def test_first_order_is_exact_for_straight_lines(tau):
    _, expected, _ = lsim(([1.0], [tau, 1.0]), NOISE - NOISE[0], TIME)
    assert np.allclose(first_order(NOISE, DT, tau), NOISE[0] + expected, rtol=0, atol=1e-10)


@pytest.mark.parametrize("base", [0.0, 1.0])
def test_a_mode_without_forces_is_exact_for_straight_lines(base):
    w, zeta = 2 * np.pi * 30.0, 0.02
    numerator = [2 * zeta * w, w * w] if base else [w * w]
    _, expected, _ = lsim((numerator, [1.0, 2 * zeta * w, w * w]), NOISE - NOISE[0], TIME)
    found = oscillate(NOISE, DT, 30.0, zeta, base=base)
    assert np.allclose(found, NOISE[0] + expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("shape", [0.5, 0.6, 1.0])
def test_bouc_wen_is_exact(shape):
    def law(t, h):
        du = np.cos(t) * (1.0 + t)
        return du * (1 - np.abs(h) / 0.7 * (shape * np.sign(h * du) + 1 - shape))

    def drive(t):
        return (1.0 + t) * np.sin(t) + np.cos(t) - 1.0

    h, states = 0.0, []
    # exact for any steps that end where the drive turns
    points = np.concatenate([[0.0], np.pi * (np.arange(4) + 0.5), [12.0]])
    expected = [0.0]
    for start, end in pairwise(points):
        h = bouc_wen(h, drive(end) - drive(start), 0.7, shape)
        states.append(h)
        run = solve_ivp(law, (start, end), [expected[-1]], rtol=1e-10, atol=1e-12, max_step=0.02)
        expected.append(run.y[0, -1])
    assert np.allclose(states, expected[1:], rtol=0, atol=1e-6)


@settings(max_examples=30, deadline=None)
@given(
    h=st.floats(-1, 1),
    du=st.floats(-20, 20),
    part=st.floats(0, 1),
    shape=st.floats(0.5, 1.0),
)
def test_bouc_wen_is_a_flow(h, du, part, shape):
    """One step equals two, the state stays within its limit, and so does the plain Python."""
    whole = bouc_wen(h, du, 1.0, shape)
    halves = bouc_wen(bouc_wen(h, part * du, 1.0, shape), (1 - part) * du, 1.0, shape)
    assert halves == pytest.approx(whole, abs=1e-7)
    assert abs(whole) <= 1.0 + 1e-12
    assert bouc_wen.py_func(h, du, 1.0, shape) == pytest.approx(whole, abs=1e-12)


def test_compiled_motion_and_plays_equal_plain_python():
    numbers = (0.2, 0.1, 0.02, 1.5, 20.0, 0.3, 0.4)
    flow = np.array([[0.99, 9e-4, 0.01, 1e-6], [-9.0, 0.97, 9.0, 1e-3]])
    arguments = (NOISE[:300], NOISE[0], flow, DT, 1e4, numbers, 0.0, 0.0)
    assert np.allclose(_advance(*arguments), _advance.py_func(*arguments), rtol=1e-12, atol=0)
    weights, growth = np.array([0.5, 0.5]), np.linspace(1.0, 1.2, 300)
    arguments = (NOISE[:300], np.array([0.0, 0.3]), weights, growth)
    assert np.array_equal(plays(*arguments), plays.py_func(*arguments))


def test_the_splitting_is_of_second_order_with_forces():
    forces = Forces(1.0, cubic=0.3, hysteretic=0.2, width=0.4)
    drive = np.sin(2 * np.pi * 7.0 * np.arange(0.0, 0.4, 2e-3))
    runs = {
        n: oscillate(refine(drive, n), 2e-3 / n, 20.0, 0.05, forces=forces)[::n]
        for n in (4, 8, 16, 512)
    }
    errors = [np.abs(runs[n] - runs[512]).max() for n in (4, 8, 16)]
    assert errors[-1] < 1e-3
    assert np.log2(errors[0] / errors[2]) / 2 == pytest.approx(2.0, abs=0.25)


def test_an_undamped_hardening_spring_keeps_its_energy():
    """After a step, both turning points have the potential energy of the start, for ever."""
    cubic, step = 0.5, np.concatenate([[0.0], np.ones(60_000)])
    x = oscillate(step, 2e-5, 50.0, 0.0, forces=Forces(1.0, cubic=cubic))

    def potential(x):
        return 0.5 * (x - 1.0) ** 2 + 0.25 * cubic * x**4

    for part in (x[1000:6000], x[-5000:]):
        assert potential(part.min()) == pytest.approx(potential(0.0), rel=2e-2, abs=1e-4)
        assert potential(part.max()) == pytest.approx(potential(0.0), rel=1e-3)
    assert x[-5000:].max() == pytest.approx(x[1000:6000].max(), rel=1e-4)


def test_a_hysteretic_force_dissipates_and_nothing_moves_at_rest():
    forces = Forces(1.0, friction=0.05, presliding=0.02, hysteretic=0.3, width=0.3)
    step = np.concatenate([[0.0], np.ones(20_000)])
    x = oscillate(step, 1e-4, 20.0, 0.0, forces=forces)
    swings = [np.ptp(x[i : i + 500]) for i in (1, 2000, 19000)]
    assert swings[0] > 2 * swings[1] > swings[2]
    for level in (0.0, -0.7, 1e-9):
        at_rest = oscillate(np.full(50, level), 1e-4, 20.0, 0.0, forces=forces)
        assert np.allclose(at_rest, at_rest[0], rtol=1e-4, atol=0)


def test_slow_friction_opens_the_loop_by_twice_its_level():
    own = one("friction", strength=0.08, static=1.0, presliding=0.005)
    x = oscillate(refine(SLOW, 10), DT / 10, 100.0, 0.5, base=1.0, forces=own.forces())[::10]
    rising, falling = x[1500:1990], x[600:1400]
    assert np.median(SLOW[1500:1990] - rising) == pytest.approx(0.08, rel=0.02)
    assert np.median(SLOW[600:1400] - falling) == pytest.approx(-0.08, rel=0.02)


def test_slow_cubic_stiffness_is_a_static_curve():
    own = one("cubic_stiffness", strength=0.4)
    x = oscillate(refine(SLOW, 20), DT / 20, 200.0, 0.5, base=1.0, forces=own.forces())[::20]
    assert np.allclose(x + 0.4 * x**3, SLOW, atol=2e-3)


def test_limits_of_the_drive():
    assert np.abs(one("input_saturation", strength=0.4).before(SLOW, DT)).max() == 0.6
    dead = one("dead_zone", strength=0.2).before(SLOW, DT)
    assert np.array_equal(dead[np.abs(SLOW) < 0.2], np.zeros((np.abs(SLOW) < 0.2).sum()))
    assert dead.max() == pytest.approx(0.8)
    slow = one("slew_limit", frequency=0.25).before(SLOW, DT)
    assert np.abs(np.diff(slow)).max() == pytest.approx(2 * np.pi * 0.25 * DT, rel=1e-9)
    play = one("backlash", strength=0.1).before(SLOW, DT)
    assert np.abs(SLOW - play).max() == pytest.approx(0.1)
    late = one("backlash", strength=0.1, place="response")
    assert np.array_equal(late.before(SLOW, DT), SLOW)
    assert np.array_equal(late.sensor(SLOW), play)


def test_linear_effects_have_their_gains():
    step = np.concatenate([[0.0], np.ones(1999)])
    creep = one("creep", strength=0.3, time_constants=[0.02, 0.1]).dynamics(step, DT)
    assert creep[-1] == pytest.approx(1.3, abs=1e-6)
    assert 1.0 < creep[1] < 1.01
    lag = one("lag", strength=2.0, time_constant=0.1).dynamics(step, DT)
    assert lag[201] == pytest.approx(-np.expm1(-1.0), abs=5e-3)
    ringing = one("resonance", strength=0.2, frequency=20.0, damping=0.05).dynamics(step, DT)
    assert ringing.max() == pytest.approx(1.0 + 0.2 * np.exp(-np.pi * 0.05), rel=2e-3)
    late = one("delay", time=0.01).dynamics(NOISE, DT)
    assert np.allclose(late[10:], NOISE[:-10], atol=1e-9)


def test_rate_and_amplitude_dependence_and_asymmetry():
    own = one("rate_dependence", strength=0.5, frequency=0.5)
    assert own.growth(SLOW, DT).max() == pytest.approx(1.5, abs=1e-4)
    assert np.array_equal(own.growth(np.ones(5), DT), np.ones(5))
    assert one("amplitude_dependence", strength=0.2).gain(0.5 * SLOW) == pytest.approx(1.1)
    bent = one("asymmetry", strength=0.3, side=-1, threshold=0.5).after(SLOW)
    assert bent.max() == 1.0
    assert bent.min() == pytest.approx(-1.3)
    odd = one("static_nonlinearity", strength=0.1).sensor(SLOW)
    assert np.array_equal(odd, -one("static_nonlinearity", strength=0.1).sensor(-SLOW))
    even = one("static_nonlinearity", strength=-0.2, order=2).sensor(np.array([-1.0, 1.0]))
    assert even.tolist() == [-1.2, 0.8]


def test_what_is_beside_belongs_to_its_record_alone():
    own = path(["offset", "periodic_disturbance", "auxiliary_input", "drift"])
    (a, aux), (b, _), (c, _) = (own.beside(500, DT, record) for record in (0, 1, 0))
    assert np.array_equal(a, c)
    assert not np.array_equal(a, b)
    assert np.abs(aux).max() <= 1.0
    alone = path("periodic_disturbance").beside(500, DT, 0)[0]
    rest = path(["offset", "auxiliary_input", "drift"]).beside(500, DT, 0)[0]
    assert np.allclose(a, alone + rest, atol=1e-12)
    assert path("drift").beside(500, DT, 0)[0][0] == 0.0


@pytest.mark.parametrize("period", [1e-6, 1.0])
def test_defaults_follow_the_time_of_the_device(period):
    own = path(EFFECTS, period).settings
    assert tuple(own) == EFFECTS
    assert own["lag"]["time_constant"] == pytest.approx(0.5 * period)
    assert own["resonance"]["frequency"] == pytest.approx(0.4 / period)


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ("crep", "name effects among slew_limit, .* Got 'crep'"),
        (
            {"creep": {"tau": 1.0}},
            "parameters of 'creep' among strength, time_constants. Got 'tau'",
        ),
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
    with pytest.raises(ValueError, match=message):
        path(effects)
