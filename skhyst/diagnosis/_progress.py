"""The progress of a search, for whoever watches: a bar, lines, or an application.

A search calls each observer with a :class:`Progress`, in the thread that `fit` was called in and
never in a worker. What an observer raises ends the search.
"""

import multiprocessing
import sys
import threading
import time
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib.util import find_spec

_SILENT = 10.0  # s after which a line says what is tried


@dataclass(frozen=True)
class Progress:
    """How far a search has come.

    Parameters
    ----------
    round : int
        Number of the round, 0 before the first.
    trying : str
        The effect, or the effects, that a step is at; "" between steps.
    done, total : int
        Candidates of the step, of which a round has several.
    seconds : float
        Since the search began.
    text : str
        A line worth keeping, such as a claim; "" where a step goes on.
    remaining : float or None, default=None
        Seconds that the step still takes at its mean speed so far; None before a candidate is done.
        How many steps follow is not known before they are done.

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
        left = "" if self.remaining is None else f", about {self.remaining:.0f} s left in this step"
        return (
            f"round {self.round}: {self.trying or 'step done'} ({self.done} of {self.total}){left}"
        )


@contextmanager
def watched(verbose, on_progress):
    """Yield what a search tells its progress to: text, round, trying, done and total, in order."""
    begin = step = time.perf_counter()
    with ExitStack() as stack:
        observers = [] if on_progress is None else [on_progress]
        if verbose:
            observers.append(stack.enter_context(_bar()) if _is_interactive() else _lines())

        def tell(text, round=0, trying="", done=0, total=0):
            nonlocal step
            now = time.perf_counter()
            step = step if done else now
            left = (now - step) * (total - done) / done if done else None
            for observer in observers:
                observer(Progress(round, trying, done, total, now - begin, text, left))

        yield tell


def _lines():
    """Return an observer that writes each text, and what is tried where nothing was for a while."""
    written = 0.0

    def write(progress):
        nonlocal written
        if progress.text or (progress.trying and progress.seconds - written > _SILENT):
            written = progress.seconds
            print(f"[EffectSearchCV] {progress.text or progress}", file=sys.stderr, flush=True)

    return write


def _is_interactive():
    """Whether a bar can be drawn: by the main thread of the main process, on a terminal or page."""
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
    """Yield an observer that draws a bar on the standard error stream, below the lines."""
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
        task = bar.add_task("declared model", total=None)

        def draw(progress):
            if progress.text:
                console.print(progress.text, markup=False)
            elif progress.total:
                of_step = {"completed": progress.done, "total": progress.total}
                bar.update(task, description=str(progress), **of_step)

        yield draw
