"""Ctrl-C and SIGTERM, at any time."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pandas as pd
import pytest

from skhyst.cli import _interruption

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")

CHILD = """
import sys, threading, time
from skhyst.cli._interruption import ending_on_signals
from joblib import Parallel, delayed

def work(kind):
    while True:
        try:
            time.sleep(0.05)
        except KeyboardInterrupt:
            if kind == "kind":
                raise

def main():
    with ending_on_signals():
        print("ready", flush=True)
        if sys.argv[1] == "workers":
            Parallel(n_jobs=2)(delayed(time.sleep)(60) for _ in range(4))
        work(sys.argv[1])

try:
    main()
except KeyboardInterrupt as ended:
    sys.exit(ended.code)
"""


def is_gone(session):
    """Whether nothing of a session is left, after five seconds at most."""
    for _ in range(100):
        try:
            os.killpg(session, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.05)
    return False


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("kind", ["kind", "deaf", "workers"])
def test_a_signal_ends_a_command_and_its_workers(kind, number, tmp_path):
    """Also one that swallows what the signal raises."""
    if kind == "workers" and number == signal.SIGINT:
        pytest.skip("the same path as SIGTERM")
    path = tmp_path / "child.py"
    path.write_text(CHILD)
    command = [sys.executable, str(path), kind]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, start_new_session=True
    ) as child:
        assert child.stdout.readline() == "ready\n"
        if kind == "workers":
            time.sleep(1.0)  # at work
        child.send_signal(number)
        assert child.wait(timeout=30) == 128 + number
        assert is_gone(child.pid)


def test_handlers_are_put_back():
    before = signal.getsignal(signal.SIGINT)
    with _interruption.ending_on_signals():
        assert signal.getsignal(signal.SIGINT) is not before
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.slow
def test_a_search_on_the_command_line_is_terminated(tmp_path):
    t = 1e-3 * np.arange(4000)
    u = np.sin(2.0 * np.pi * (1.0 + 20.0 * t) * t)
    table = pd.DataFrame({"t": t, "u": u, "y": u + 0.3 * np.abs(u)})
    table.to_csv(tmp_path / "data.csv", index=False)
    command = [sys.executable, "-m", "skhyst", "diagnose", str(tmp_path / "data.csv")]
    command += ["--drive", "u", "--response", "y", "--time", "t", "--jobs", "1", "--model", "gain"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as child:
        child.stderr.readline()  # progress
        child.terminate()
        assert child.wait(timeout=30) == 143
        assert child.stderr.read().endswith("skhyst: terminated\n")
