"""Who watches a search sees every step of it, and can end it."""

import multiprocessing

import numpy as np
import pytest
from joblib import Parallel, delayed, parallel_config
from sklearn.exceptions import NotFittedError

from skhyst._progress import _is_interactive
from skhyst.diagnosis import EffectSearchCV
from skhyst.hysteresis import PrandtlIshlinskii

EFFECTS = ["output_saturation", "offset"]


class Stopped(BaseException):
    """As an application ends its script."""


@pytest.fixture(scope="module")
def data():
    rng = np.random.default_rng(0)
    drive = np.cumsum(rng.normal(size=600)) / 20
    y = np.minimum(drive, np.quantile(drive, 0.8)) + 0.005 * rng.normal(size=600)
    return drive.reshape(-1, 1), y


def search(**options):
    return EffectSearchCV(PrandtlIshlinskii(3), effects=EFFECTS, **options)


@pytest.fixture(scope="module")
def seen(data):
    seen = []
    assert search().fit(*data, on_progress=seen.append).effects_ == ["output_saturation"]
    return seen


def test_every_step_is_told(seen):
    steps = [step for step in seen if step.total]
    assert all(0 <= step.done <= step.total for step in steps)
    assert all(bool(step.trying) == (step.done < step.total) for step in steps)
    # functions of time alone are tried where nothing that responds to the drive helps
    assert {step.trying for step in steps if step.round == 1} == {"output_saturation", ""}
    assert {step.trying for step in steps} == {*EFFECTS, ""}
    for step in steps:  # the first candidate shows no speed
        assert (step.remaining is None) == (step.done < min(2, step.total))
    assert all(step.remaining == 0.0 for step in steps if step.done == step.total)
    for name in ("round", "seconds"):
        told = [getattr(step, name) for step in seen]
        assert told == sorted(told)


def test_lines_are_told(seen):
    lines = [step.text for step in seen if step.text]
    assert lines[0].startswith("declared model: held-out error")
    assert any(line.startswith("round 1: output_saturation: held-out error") for line in lines)


@pytest.mark.parametrize("backend", ["sequential", "threading"])
def test_an_observer_ends_the_search(data, backend):
    def stop(progress):
        if progress.done:
            raise Stopped

    stopped = search()
    stopped.failed_ = stopped.verdict_ = None  # of an earlier fit
    with parallel_config(backend, n_jobs=2), pytest.raises(Stopped):
        stopped.fit(*data, on_progress=stop)
    with pytest.raises(NotFittedError):
        stopped.predict(data[0])
    assert not hasattr(stopped, "verdict_")


def test_a_terminal_has_a_bar_on_the_standard_error_stream(data, monkeypatch, capsys):
    pytest.importorskip("rich")
    monkeypatch.setenv("FORCE_COLOR", "1")  # for rich the stream is a terminal
    monkeypatch.setenv("TERM", "xterm")
    search(verbose=1).fit(*data)
    written = capsys.readouterr()
    assert written.out == ""
    assert "declared model" in written.err
    assert "0:00:0" in written.err
    assert "round 1: output_saturation: held-out error" in written.err


def test_workers_have_no_bar(monkeypatch):
    pytest.importorskip("rich")
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    assert _is_interactive()
    threads = Parallel(n_jobs=2, backend="threading")
    assert threads(delayed(_is_interactive)() for _ in range(2)) == [False, False]
    monkeypatch.setattr(multiprocessing, "parent_process", multiprocessing.current_process)
    assert not _is_interactive()
