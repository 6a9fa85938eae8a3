"""The progress of a search or a comparison of models: a bar, lines, or what an application draws.

Each observer is called with a :class:`Progress` in the thread of the caller, never in a worker. An
exception in an observer ends the search.
"""

import multiprocessing
import sys
import threading
import time
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib.util import find_spec

_SILENT = 10.0  # s without a line, after which one says what is being tried


@dataclass(frozen=True)
class Progress:
    """The progress of a search or a comparison of models.

    Parameters
    ----------
    round : int or None
        Number of the round, 0 before the first; None in a comparison of models.
    trying : str
        The effect or effects of the current candidate, or its model; "" between steps.
    done, total : int
        Candidates of the current step; a round has several steps.
    seconds : float
        Since the start of the search.
    text : str
        A line to keep, such as a claim; "" within a step.
    remaining : float or None, default=None
        Seconds until the end of the step, at its mean speed since the first candidate, for which
        functions may be compiled; None before the second is done. The number of further steps is
        not known in advance.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.diagnosis import EffectSearchCV
    >>> from skhyst.hysteresis import PrandtlIshlinskii
    >>> drive = np.sin(np.arange(400) / 20) * np.linspace(0.5, 1, 400)
    >>> y = np.minimum(drive, 0.6) + 0.01 * np.random.default_rng(0).normal(size=400)
    >>> seen = []
    >>> search = EffectSearchCV(PrandtlIshlinskii(3), effects=["output_saturation"])
    >>> search = search.fit(drive.reshape(-1, 1), y, on_progress=seen.append)
    >>> next((step.round, step.trying, step.done, step.total) for step in seen if step.trying)
    (1, 'output_saturation', 0, 1)
    """

    round: int
    trying: str
    done: int
    total: int
    seconds: float
    text: str = ""
    remaining: float | None = None

    def __str__(self):
        left = "" if self.remaining is None else f", {_roughly(self.remaining)} left in this step"
        step = "comparing models" if self.round is None else f"round {self.round}"
        return f"{step}: {self.trying or 'step done'} ({self.done} of {self.total}){left}"


def _roughly(seconds):
    """Write a time that is known to a digit at most."""
    if seconds < 10.0:
        return "a few seconds"
    if seconds < 90.0:
        return f"about {10.0 * round(seconds / 10.0):.0f} s"
    return f"about {seconds / 60.0:.0f} min"


@contextmanager
def watched(name, verbose, on_progress):
    """Yield the function to report text, round, trying, done and total; lines begin with name."""
    begin = step = time.perf_counter()
    first = 0  # candidates that were done then
    with ExitStack() as stack:
        observers = [] if on_progress is None else [on_progress]
        if verbose:
            observers.append(stack.enter_context(_bar()) if _is_interactive() else _lines(name))

        def report_progress(text, round=0, trying="", done=0, total=0):
            nonlocal step, first
            now = time.perf_counter()
            step, first = (step, first) if done > 1 else (now, done)
            speed = (done - first) / (now - step) if done > first else 0.0
            left = 0.0 if done and done == total else (total - done) / speed if speed else None
            for observer in observers:
                observer(Progress(round, trying, done, total, now - begin, text, left))

        yield report_progress


def _lines(name):
    """Return an observer that prints each text, and after a silence what is being tried."""
    written = 0.0

    def write(progress):
        nonlocal written
        if progress.text or (progress.trying and progress.seconds - written > _SILENT):
            written = progress.seconds
            print(f"[{name}] {progress.text or progress}", file=sys.stderr, flush=True)

    return write


def _is_interactive():
    """Whether a bar can be drawn: in the main thread of the main process, on a terminal or page."""
    if (
        multiprocessing.parent_process()
        or threading.current_thread() is not threading.main_thread()
    ):
        return False
    if find_spec("rich") is None:
        return False
    from rich.console import Console

    console = Console(stderr=True)
    in_page = console.is_jupyter and find_spec("ipywidgets") is not None
    return in_page or (console.is_terminal and not console.is_dumb_terminal)


@contextmanager
def _bar():
    """Yield an observer that draws a bar on standard error, below the printed lines."""
    from rich import progress as bars
    from rich.console import Console

    columns = (
        bars.SpinnerColumn(),
        bars.TextColumn("{task.description}", markup=False),
        bars.BarColumn(),
        bars.TimeElapsedColumn(),
    )
    console = Console(stderr=True, highlight=False)
    with bars.Progress(*columns, console=console, redirect_stdout=False, transient=True) as bar:
        task = bar.add_task("starting", total=None)

        def draw(progress):
            if progress.text:
                console.print(progress.text, markup=False)
            elif progress.total:
                of_step = {"completed": progress.done, "total": progress.total}
                bar.update(task, description=str(progress), **of_step)

        yield draw
