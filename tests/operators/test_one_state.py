"""Operators of one state: the compiled loops are cached, and a law of one's own fits in."""

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import skhyst
from skhyst.operators import OneStateOperator, parameter

COUNT = """
import numpy as np
from skhyst.hysteresis import BacklashOperator, DahlOperator

for operator in (DahlOperator(0.1, 1.0), BacklashOperator(0.1)):
    operator.run([0.0, 1.0], 0.1)
    operator.linearize([0.0, 1.0], np.ones((2, 1)), 0.1)
    for loop in (operator._law, operator._run, operator._tangents):
        print(sum(loop.stats.cache_hits.values()), sum(loop.stats.cache_misses.values()))
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
    assert first == [b"0", b"1"] * 6
    assert second == [b"1", b"0"] * 6


def low_pass(x, u0, u1, dt, values):
    """Follow a zero-order hold of the drive: an implicit Euler step of x' = (u - x) / tau."""
    tau, gain = values
    share = dt / (dt + tau)
    x1 = x + share * (u1 - x)
    by_tau = -share * (u1 - x) / (dt + tau)
    state_by = 1.0 - share, 0.0, share, by_tau
    return x1, gain * x1, state_by, tuple([gain * by for by in state_by] + [x1])


@dataclass(frozen=True)
class LowPassOperator(OneStateOperator, step=low_pass):
    tau: float = parameter(log=True)
    gain: float = parameter(default=1.0, linear=True)

    def _rest(self, u0):
        return u0, (1.0, 0.0)
