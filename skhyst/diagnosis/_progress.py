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


@contextmanager
def watched(verbose, on_progress):
    """Yield what a search tells its progress to: text, round, trying, done and total, in order."""
    begin = time.perf_counter()
    with ExitStack() as stack:
        observers = [] if on_progress is None else [on_progress]
        if verbose:
            observers.append(stack.enter_context(_bar()) if _is_interactive() else _line)

        def tell(text, round=0, trying="", done=0, total=0):
            seconds = time.perf_counter() - begin
            for observer in observers:
                observer(Progress(round, trying, done, total, seconds, text))

        yield tell


def _line(progress):
    if progress.text:
        print(f"[EffectSearchCV] {progress.text}", file=sys.stderr, flush=True)


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
        bars.MofNCompleteColumn(),
        bars.TimeElapsedColumn(),
    )
    console = Console(stderr=True, highlight=False)
    with bars.Progress(*columns, console=console, redirect_stdout=False, transient=True) as bar:
        task = bar.add_task("declared model", total=None)

        def draw(progress):
            if progress.text:
                console.print(progress.text, markup=False)
            elif progress.total:
                about = f"round {progress.round}: {progress.trying}"
                bar.update(task, description=about, completed=progress.done, total=progress.total)

        yield draw
