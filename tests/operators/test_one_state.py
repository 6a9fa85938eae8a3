"""Operators of one state: the compiled loops are cached, and a law of one's own fits in."""

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import skhyst
from skhyst.operators import OneStateOperator, check_operator, parameter

COUNT = """
import numpy as np
from skhyst.hysteresis import BacklashOperator, SlewLimitOperator

for operator in (BacklashOperator(0.1), SlewLimitOperator(0.1)):
    operator.run([0.0, 1.0], 0.1)
    operator.linearize([0.0, 1.0], np.ones((2, 1)), 0.1)
    for loop in (operator._run, operator._tangents):
        print(sum(loop.stats.cache_hits.values()), sum(loop.stats.cache_misses.values()))
    print(sum(operator._law.stats.cache_misses.values()))
"""


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

    def _rest(self, u0):
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
    y, dy = operator.linearize(np.empty(0), np.empty((0, 3)), 0.1)
    assert (y.shape, dy.shape) == ((0,), (0, 5))


def test_base_alone_is_abstract():
    with pytest.raises(TypeError, match="abstract"):
        OneStateOperator()
