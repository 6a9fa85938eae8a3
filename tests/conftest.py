"""What all tests share: threads, and measured recordings, which are not part of the project."""

import gc
import os

import pytest
import recordings
from threadpoolctl import threadpool_limits

_SHORT = "not slow"  # the tests that run by default, as in pyproject.toml


@pytest.fixture(scope="session", autouse=True)
def one_thread():
    """Small matrices and trees: threads of linear algebra or OpenMP would wait for each other."""
    with threadpool_limits(limits=1):
        yield


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Thousands of tests stay until the end: do not visit them with each collection of garbage."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_configure(config):
    if any("::" in str(argument) for argument in config.args) and config.option.markexpr == _SHORT:
        config.option.markexpr = ""  # what is named by its id is run, slow or not
    config.addinivalue_line(
        "markers",
        "needs_recordings(name, named=False): reads measured recordings and is skipped where their "
        "folder is absent; with named=True where SKHYST_DATA does not name it, too.",
    )


def pytest_runtest_setup(item):
    for mark in item.iter_markers("needs_recordings"):
        path = recordings.SHARED.joinpath(*mark.args)
        if not path.exists():
            pytest.skip(f"there is no {path}")
        if mark.kwargs.get("named") and "SKHYST_DATA" not in os.environ:
            pytest.skip(f"it takes long; SKHYST_DATA={recordings.SHARED} runs it")


@pytest.hookimpl(wrapper=True, tryfirst=True)  # below the list of what failed or was skipped
def pytest_terminal_summary(terminalreporter):
    """Say in one line how many tests of measured recordings ran, and how many did not."""
    result = yield

    def count(*outcomes):
        reports = (r for outcome in outcomes for r in terminalreporter.stats.get(outcome, ()))
        return sum("needs_recordings" in getattr(report, "keywords", ()) for report in reports)

    ran, skipped = count("passed", "failed"), count("skipped")
    if ran or skipped:
        where = f"in {recordings.SHARED.resolve()}; SKHYST_DATA names their folder"
        terminalreporter.write_line(
            f"measured recordings: {ran} tests ran, {skipped} were SKIPPED ({where})",
            yellow=bool(skipped),
        )
    return result
