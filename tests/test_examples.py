"""Every example runs in an empty folder, without a screen and without a warning.

Those of the papers take longer: building the documentation runs them, and fails where they do.
Those of measured recordings take some ten to forty seconds each, and run where SKHYST_DATA names
the folder of these.
"""

import os
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
from measured_recordings import CASES

pytestmark = pytest.mark.slow

plt = pytest.importorskip("matplotlib.pyplot", reason="the examples draw")

FOLDER = Path(__file__).parents[1] / "examples"
EXAMPLES = sorted(FOLDER.glob("plot_*.py"))
RECORDINGS = sorted(FOLDER.glob("recordings/plot_*.py"))


def test_there_are_examples():
    assert EXAMPLES
    assert RECORDINGS


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs(path, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    plt.switch_backend("agg")
    with plt.rc_context():
        try:
            runpy.run_path(str(path), run_name="__main__")
        except SystemExit as ended:
            if ended.code:
                raise
    plt.close("all")
    assert capsys.readouterr().out
    assert not list(tmp_path.iterdir())


def run(path, tmp_path, **environment):
    """Run an example in a process of its own and return what it prints."""
    done = subprocess.run(
        [sys.executable, "-W", "error", str(path)],
        cwd=tmp_path,
        env=os.environ | {"MPLBACKEND": "Agg"} | environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout
    assert not list(tmp_path.iterdir())
    return done.stdout


def recording(path):
    """Return the name of the recording that an example is about, and of its folder."""
    return path.stem.removeprefix("plot_")


def test_recordings_are_cases():
    assert {recording(path) for path in RECORDINGS} <= CASES.keys()


def test_recording_that_is_absent(tmp_path):
    printed = run(RECORDINGS[0], tmp_path, SKHYST_DATA=str(tmp_path / "nowhere"))
    assert f"{recording(RECORDINGS[0])} is absent" in printed
    assert "SKHYST_DATA" in printed


def needs(path):
    """Return the argument of a test of an example, which needs its recording."""
    mark = pytest.mark.needs_recordings(recording(path), named=True)
    return pytest.param(path, marks=mark, id=f"recordings/{path.stem}")


@pytest.mark.parametrize("path", [needs(path) for path in RECORDINGS])
def test_example_of_a_recording_runs(path, tmp_path):
    run(path, tmp_path)
