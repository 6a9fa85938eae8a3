"""Operators of one state: the compiled loops are cached, and a law of one's own fits in."""

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import skhyst
from skhyst.hysteresis import BacklashOperator, PrandtlIshlinskiiOperator, SlewLimitOperator
from skhyst.operators import OneStateOperator, check_operator, parameter
from skhyst.static import DeadBandOperator

COUNT = """
import numpy as np
from skhyst.hysteresis import BacklashOperator, SlewLimitOperator

for operator in (BacklashOperator(0.1), SlewLimitOperator(0.1)):
    operator.run([0.0, 1.0], 0.1)
    operator.sensitivities([0.0, 1.0], np.ones((2, 1)), 0.1)
    for loop in (operator._run, operator._tangents):
        print(sum(loop.stats.cache_hits.values()), sum(loop.stats.cache_misses.values()))
    print(sum(operator._law.stats.cache_misses.values()))
"""


@pytest.mark.slow
def test_loops_of_each_law_come_from_the_cache(tmp_path):
    root = str(Path(skhyst.__file__).parents[1])
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": root}
    first, second = (
        subprocess.run(
            [sys.executable, "-c", COUNT], env=environment, capture_output=True, check=True
        ).stdout.split()
        for _ in range(2)
    )
    assert first == [b"0", b"1", b"0", b"1", b"1"] * 2
    assert second == [b"1", b"0", b"1", b"0", b"0"] * 2


def low_pass(x, u0, u1, dt, values):
    """Go a part of the way to the drive, and show the middle of that way times a gain."""
    tau, gain = values
    share = dt / (dt + tau)
    way = share * (u1 - x)
    by_tau = -0.5 * gain * way / (dt + tau)
    return (
        x + way,
        gain * (x + 0.5 * way),
        (1.0 - share, 0.0, share, -way / (dt + tau)),
        (gain * (1.0 - 0.5 * share), 0.0, 0.5 * gain * share, by_tau, x + 0.5 * way),
    )


@dataclass(frozen=True)
class LowPassOperator(OneStateOperator, step=low_pass):
    tau: float = parameter(log=True)
    gain: float = parameter(default=1.0, linear=True)

    def rest(self, u0):
        return u0, (1.0, 0.0)


@pytest.mark.parametrize("initial_state", ["rest", "zero"])
def test_law_equals_a_loop_written_by_hand(initial_state):
    u, operator, share = np.random.default_rng(0).normal(size=50), LowPassOperator(0.3, 1.7), 0.25
    x, expected = u[0] if initial_state == "rest" else 0.0, []
    for value in u:
        before, x = x, x + share * (value - x)
        expected.append(0.5 * 1.7 * (before + x))
    y, state = operator.run(u, 0.1, operator.init(u[0], initial_state))
    np.testing.assert_allclose(y, expected, rtol=0, atol=1e-12)
    assert state == (pytest.approx(x, abs=1e-12), u[-1])
    check_operator(operator, u, 0.1)


def test_empty_signal():
    operator = LowPassOperator(0.3)
    assert operator.run([], 0.1, (1.0, 2.0))[1] == (1.0, 2.0)
    y, dy = operator.sensitivities(np.empty(0), np.empty((0, 3)), 0.1)
    assert (y.shape, dy.shape) == ((0,), (0, 5))


def test_base_alone_is_abstract():
    with pytest.raises(TypeError, match="abstract"):
        OneStateOperator()


# ------------------------------------------------------------------------- limits of the drive

DT = 0.01


@pytest.fixture
def u():
    return np.cumsum(np.random.default_rng(1).normal(size=400)) / 10


def test_backlash_is_one_play(u):
    expected, _ = PrandtlIshlinskiiOperator([0.3], [1.0]).run(u, DT)
    np.testing.assert_allclose(BacklashOperator(0.3).run(u, DT)[0], expected, atol=1e-14)


@given(a=st.floats(0.01, 0.5), b=st.floats(0.01, 0.5))
@settings(deadline=None, max_examples=20)
def test_gaps_in_series_add_up(a, b):
    u = np.cumsum(np.random.default_rng(2).normal(size=300)) / 10
    twice = BacklashOperator(b).run(BacklashOperator(a).run(u, DT)[0], DT)[0]
    np.testing.assert_allclose(twice, BacklashOperator(a + b).run(u, DT)[0], atol=1e-12)


def test_dead_band_and_clipping_add_up_to_the_drive(u):
    band = DeadBandOperator(half_width=0.4, center=0.1)
    np.testing.assert_allclose(band.run(u, DT)[0] + np.clip(u, -0.3, 0.5), u, atol=1e-14)


def test_a_slew_limit_holds_under_any_drive():
    """However large the drive is: the output is no difference of large numbers."""
    u = np.append(0.0, 1e12 * np.random.default_rng(0).uniform(-1.0, 1.0, 200))
    y, _ = SlewLimitOperator(0.37).run(u, DT)
    assert np.abs(np.diff(y)).max() <= 0.37 * DT * (1.0 + 1e-12)


def test_slew_limit_of_a_slow_drive_is_the_drive(u):
    fastest = np.abs(np.diff(u)).max() / DT
    np.testing.assert_array_equal(SlewLimitOperator(fastest).run(u, DT)[0], u)


@pytest.mark.parametrize("part", [0.02, 0.2, 0.7])
def test_slew_limit_solves_its_law(u, part):
    u, fine = u[:120], 100
    rate = part * np.abs(np.diff(u)).max() / DT
    time = DT * np.arange(len(u))
    signal = np.interp(np.linspace(0.0, time[-1], fine * (len(u) - 1) + 1), time, u)
    y, reach, slow = signal[0], rate * DT / fine, [signal[0]]
    for value in signal[1:]:
        y += np.clip(value - y, -reach, reach)
        slow.append(y)
    exact = SlewLimitOperator(rate).run(u, DT)[0]
    # the plain steps are late by less than one of them
    np.testing.assert_allclose(exact, slow[::fine], atol=3.0 * np.abs(np.diff(u)).max() / fine)
    assert np.abs(np.diff(exact)).max() <= rate * DT * (1 + 1e-12)
