"""The laws of simulated plants against closed forms and SciPy, and that they share no code."""

import ast
from functools import partial
from importlib.util import resolve_name
from itertools import pairwise
from pathlib import Path

import numpy as np
import plants
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp
from scipy.signal import lsim

import skhyst
from skhyst.datasets import simulation
from skhyst.datasets.simulation import (
    Plant,
    PlantEffect,
    bouc_wen,
    first_order,
    kelvin_voigt,
    oscillate,
    plays,
    pure_delay,
    refine,
    reversal_curves,
    slew_limited,
)

DT = 1e-3
TIME = DT * np.arange(2000)
NOISE = np.cumsum(np.random.default_rng(0).standard_normal(2000)) / 50.0
PLAYS = partial(plays, thresholds=[0.0, 0.1, 0.4], weights=[0.5, 0.3, 0.2])


def test_what_makes_data_and_what_finds_effects_share_the_recording_alone():
    home = Path(skhyst.__file__).parent
    files = dict.fromkeys(home.glob("datasets/*.py"), "skhyst.datasets")
    files |= dict.fromkeys(Path(plants.__file__).parent.glob("*.py"), "plants")
    imported = set()
    for path, package in {**files, home / "cli" / "_demo_recording.py": "skhyst.cli"}.items():
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                imported |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                origin = resolve_name("." * node.level + (node.module or ""), package)
                imported |= {f"{origin}.{alias.name}" for alias in node.names}
    own = {name.split(".")[1] for name in imported if name.split(".")[0] == "skhyst"}
    assert own == {"_documentation", "_jit", "records", "exceptions", "datasets"}


def test_refined_drive_is_the_piecewise_linear_one():
    drive = NOISE[:20]
    fine = refine(drive, 8)
    np.testing.assert_array_equal(fine[::8], drive)
    slopes = np.diff(fine).reshape(-1, 8) * 8
    np.testing.assert_allclose(slopes, np.repeat(np.diff(drive)[:, None], 8, axis=1), atol=1e-12)


def test_stages_and_effects_enter_at_their_places():
    plant = Plant({"core": (PLAYS,), "late": ()})
    delays = [partial(pure_delay, delay=2.0), partial(pure_delay, delay=0.0)]
    late, plain = PlantEffect("late", delays).changes([plant, plant])
    drive = NOISE[:300]
    np.testing.assert_allclose(plain.respond(drive, 4), PLAYS(drive, 1.0), atol=1e-12)
    np.testing.assert_allclose(late.respond(drive, 4)[2:], plain.respond(drive, 4)[:-2], atol=1e-12)
    own = PlantEffect(alter=lambda p, number: p.adapt("core", weights=[number, 0.0, 0.0]))
    for number, changed in enumerate(own.changes([plant, plant])):
        np.testing.assert_allclose(changed.respond(drive), number * drive, atol=1e-12)


# ----------------------------------------------------------------------------------------- plays


def test_plays_follow_the_virgin_curve_and_the_main_loop():
    up = np.linspace(0, 2, 201)
    out = plays(np.concatenate([up, up[-2::-1]]), 1.0, [0.5], [1.0])
    np.testing.assert_allclose(out[:201], np.maximum(up - 0.5, 0), atol=1e-14)
    np.testing.assert_allclose(out[201:], np.minimum(1.5, up[-2::-1] + 0.5), atol=1e-14)


@pytest.mark.parametrize("first", [-1.0, 0.3, 2.0])
def test_plays_start_as_if_loaded_for_the_first_time(first):
    ramp = PLAYS(np.linspace(0, first, 50), 1.0)
    assert PLAYS(np.array([first]), 1.0)[0] == pytest.approx(ramp[-1])


def test_plays_are_rate_independent_unless_their_thresholds_grow():
    drive = NOISE[:100]
    slow = np.interp(np.arange(496) / 5, np.arange(100), drive)
    np.testing.assert_allclose(PLAYS(slow, 1.0)[::5], PLAYS(drive, 1.0), atol=1e-12)
    ramp = 3.0 * np.arange(100.0) * DT
    grown = plays(ramp, DT, [0.0, 0.05], [1.0, 1.0], stretch=0.2, widening=0.01)
    wide = 0.05 * (1.0 + 0.2 * 3.0) + 0.01 * 3.0
    np.testing.assert_allclose(grown[1:], (ramp + np.maximum(ramp - wide, 0.0))[1:], atol=1e-12)


def test_reversal_curves_have_their_slope_from_every_turning_point():
    """Along the drive the slope is integrated numerically, in either direction."""
    law = {"slope": 2.0, "curvature": 3.0, "decay": 0.7}
    turns, y = [0.0, 1.5, -0.4, 0.9, 0.9], [0.0]
    for start, end in pairwise(turns):
        way, _ = quad(lambda s: 2.0 + 3.0 * (1.0 - np.exp(-0.7 * s)) / 0.7, 0.0, abs(end - start))
        y.append(y[-1] + np.sign(end - start) * way)
    drive = np.interp(np.arange(401) / 100, np.arange(5), turns)
    out = reversal_curves(drive, DT, **law)
    np.testing.assert_allclose(out[::100], y, rtol=1e-12)
    memory = {}
    parts = [
        reversal_curves(part, DT, **law, memory=memory) for part in np.split(drive, [130, 250])
    ]
    np.testing.assert_array_equal(np.concatenate(parts), out)


# -------------------------------------------------------------------------------------- dynamics


@pytest.mark.parametrize("tau", [1e-4, 0.03, 1e4])
def test_first_order_is_exact_for_straight_lines(tau):
    _, expected, _ = lsim(([1.0], [tau, 1.0]), NOISE - NOISE[0], TIME)
    assert np.allclose(first_order(NOISE, DT, tau), NOISE[0] + expected, rtol=0, atol=1e-10)


def test_creep_creeps_to_its_settled_share():
    step = np.concatenate([np.zeros(1), np.ones(1999)])
    out = kelvin_voigt(step, DT, [0.02, 0.1], [0.1, 0.2])
    assert out[1] == pytest.approx(1.0, abs=0.01)  # the elastic part is immediate
    assert np.all(np.diff(1.3 - out[1:1500]) < 0)
    # the slow unit is alone in the end and decays by its own time constant
    assert (1.3 - out[800]) / (1.3 - out[900]) == pytest.approx(np.e, rel=1e-3)
    assert out[-1] == pytest.approx(1.3, abs=1e-6)


def test_delay_and_slew_limit():
    fine = refine(NOISE, 2)
    np.testing.assert_allclose(pure_delay(NOISE, DT, 3 * DT)[3:], NOISE[:-3], atol=1e-9)
    np.testing.assert_allclose(pure_delay(NOISE, DT, 2.5 * DT)[3:], fine[1:-4:2], atol=1e-9)
    np.testing.assert_allclose(slew_limited(NOISE, DT, 1e3), NOISE, atol=1e-12)
    step = np.concatenate([np.zeros(3), np.full(20, 1.0)])
    np.testing.assert_allclose(np.diff(slew_limited(step, 0.5, 0.2))[2:12], 0.1, atol=1e-12)


@pytest.mark.parametrize("base", [0.0, 1.0])
def test_a_mode_without_forces_is_exact_for_straight_lines(base):
    w, zeta = 2 * np.pi * 30.0, 0.02
    numerator = [2 * zeta * w, w * w] if base else [w * w]
    _, expected, _ = lsim((numerator, [1.0, 2 * zeta * w, w * w]), NOISE - NOISE[0], TIME)
    found = oscillate(NOISE, DT, 30.0, zeta, base=base)
    assert np.allclose(found, NOISE[0] + expected, rtol=0, atol=1e-9)


# ------------------------------------------------------------------------------------------ forces


@pytest.mark.parametrize("shape", [0.5, 0.6, 1.0])
def test_bouc_wen_is_exact(shape):
    def law(t, h):
        du = np.cos(t) * (1.0 + t)
        return du * (1 - np.abs(h) / 0.7 * (shape * np.sign(h * du) + 1 - shape))

    def drive(t):
        return (1.0 + t) * np.sin(t) + np.cos(t) - 1.0

    h, expected = 0.0, 0.0
    # exact for any steps that end where the drive turns
    for start, end in pairwise([0.0, *(np.pi * (np.arange(4) + 0.5)), 12.0]):
        h = bouc_wen(h, drive(end) - drive(start), 0.7, shape)
        run = solve_ivp(law, (start, end), [expected], rtol=1e-10, atol=1e-12, max_step=0.02)
        expected = run.y[0, -1]
        assert h == pytest.approx(expected, abs=1e-6)


@settings(max_examples=30, deadline=None)
@given(st.floats(-1, 1), st.floats(-20, 20), st.floats(0, 1), st.floats(0.5, 1.0))
def test_bouc_wen_is_a_flow(h, du, part, shape):
    """One step equals two, the state stays within its limit, and so does the plain Python."""
    whole = bouc_wen(h, du, 1.0, shape)
    halves = bouc_wen(bouc_wen(h, part * du, 1.0, shape), (1 - part) * du, 1.0, shape)
    assert halves == pytest.approx(whole, abs=1e-7)
    assert abs(whole) <= 1.0 + 1e-12
    assert bouc_wen.py_func(h, du, 1.0, shape) == pytest.approx(whole, abs=1e-12)


FORCES = {"cubic": 0.3, "friction": 0.1, "presliding": 0.02, "hysteretic": 0.2, "width": 0.4}


def test_compiled_laws_equal_plain_python(monkeypatch):
    compiled = oscillate(NOISE[:300], DT, 20.0, 0.05, **FORCES), PLAYS(NOISE, DT, stretch=0.1)
    for name in ("_advance", "_plays"):
        monkeypatch.setattr(simulation, name, getattr(simulation, name).py_func)
    plain = oscillate(NOISE[:300], DT, 20.0, 0.05, **FORCES), PLAYS(NOISE, DT, stretch=0.1)
    for one, two in zip(compiled, plain, strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-12, atol=1e-14)


def test_the_splitting_is_of_second_order_with_forces():
    drive = np.sin(2 * np.pi * 7.0 * np.arange(0.0, 0.4, 2e-3))
    motion = partial(oscillate, frequency=20.0, damping=0.05, cubic=0.3, hysteretic=0.2, width=0.4)
    plant = Plant({"motion": (motion,)})
    exact = plant.respond(drive, 512, 2e-3)
    errors = [np.abs(plant.respond(drive, n, 2e-3) - exact).max() for n in (4, 8, 16)]
    assert errors[-1] < 1e-3
    assert np.log2(errors[0] / errors[2]) / 2 == pytest.approx(2.0, abs=0.25)


def test_an_undamped_hardening_spring_keeps_its_energy():
    """After a step, both turning points have the potential energy of the start, for ever."""
    cubic, step = 0.5, np.concatenate([[0.0], np.ones(60_000)])
    x = oscillate(step, 2e-5, 50.0, 0.0, cubic=cubic)

    def potential(x):
        return 0.5 * (x - 1.0) ** 2 + 0.25 * cubic * x**4

    for part in (x[1000:6000], x[-5000:]):
        assert potential(part.min()) == pytest.approx(potential(0.0), rel=2e-2, abs=1e-4)
        assert potential(part.max()) == pytest.approx(potential(0.0), rel=1e-3)
    assert x[-5000:].max() == pytest.approx(x[1000:6000].max(), rel=1e-4)


def test_a_hysteretic_force_dissipates_and_nothing_moves_at_rest():
    forces = {"friction": 0.05, "presliding": 0.02, "hysteretic": 0.3, "width": 0.3}
    x = oscillate(np.concatenate([[0.0], np.ones(20_000)]), 1e-4, 20.0, 0.0, **forces)
    swings = [np.ptp(x[i : i + 500]) for i in (1, 2000, 19000)]
    assert swings[0] > 2 * swings[1] > swings[2]
    for level in (0.0, -0.7, 1e-9):
        at_rest = oscillate(np.full(50, level), 1e-4, 20.0, 0.0, **forces)
        assert np.allclose(at_rest, at_rest[0], rtol=1e-4, atol=0)
