"""Tests of measured recordings are never skipped silently."""

from pathlib import Path

import pytest
import recordings

pytest_plugins = ["pytester"]

TESTS = """
import pytest


@pytest.mark.needs_recordings
def test_of_all():
    pass


@pytest.mark.needs_recordings("one")
@pytest.mark.parametrize("value", [1, 2])
def test_of_one(value):
    assert value == 1


@pytest.mark.needs_recordings("one", named=True)
def test_that_takes_long():
    pass


@pytest.mark.skip
def test_of_something_else():
    pass
"""


@pytest.fixture
def summary(pytester, monkeypatch):
    """Run tests with the recordings in a folder; return the lines that speak of recordings."""
    monkeypatch.setattr(recordings, "SHARED", pytester.path / "data")
    monkeypatch.delenv("SKHYST_DATA", raising=False)
    pytester.makeconftest((Path(__file__).parent / "conftest.py").read_text())

    def run(tests=TESTS):
        pytester.makepyfile(tests)
        done = pytester.runpytest_inprocess("-p", "no:cacheprovider", "-p", "no:xdist")
        lines = [line for line in done.outlines if line]
        assert not any(line.startswith("measured recordings:") for line in lines[:-2])
        return done, [line for line in lines[-2:] if line.startswith("measured recordings:")]

    return run


def test_absent_recordings_are_counted_in_one_line(summary, pytester):
    done, lines = summary()
    done.assert_outcomes(skipped=5)
    (line,) = lines
    assert line.startswith("measured recordings: 0 tests ran, 4 were SKIPPED")
    assert str(pytester.path / "data") in line


def test_present_recordings_are_read(summary, pytester, monkeypatch):
    (pytester.path / "data" / "one").mkdir(parents=True)
    done, (line,) = summary()
    done.assert_outcomes(passed=2, failed=1, skipped=2)
    assert line.startswith("measured recordings: 3 tests ran, 1 were SKIPPED")
    monkeypatch.setenv("SKHYST_DATA", str(pytester.path / "data"))
    done, (line,) = summary()
    done.assert_outcomes(passed=3, failed=1, skipped=1)
    assert line.startswith("measured recordings: 4 tests ran, 0 were SKIPPED")


def test_a_run_without_such_tests_says_nothing(summary):
    assert summary("def test_a():\n    pass\n")[1] == []
