"""Compiled loops give what the same loops give as plain Python."""

import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from operator_cases import responses

import skhyst

PLAIN = (
    "import operator_cases, pickle, sys; pickle.dump(operator_cases.responses(), sys.stdout.buffer)"
)


@pytest.fixture(scope="module")
def plain():
    folders = [Path(skhyst.__file__).parents[1], Path(__file__).parent]
    environment = os.environ | {
        "NUMBA_DISABLE_JIT": "1",
        "PYTHONPATH": os.pathsep.join(map(str, folders)),
    }
    run = subprocess.run([sys.executable, "-c", PLAIN], env=environment, capture_output=True)
    assert run.returncode == 0, run.stderr.decode()
    return pickle.loads(run.stdout)


def test_compiled_equals_plain(plain):
    compiled = responses()
    assert set(compiled) == set(plain)
    for name, found in compiled.items():
        scale = np.abs(plain[name]).max(axis=0, initial=1e-300)
        np.testing.assert_allclose(
            found / scale, plain[name] / scale, rtol=0, atol=1e-12, err_msg=name
        )
