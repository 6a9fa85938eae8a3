"""Ctrl-C and SIGTERM: a command and its worker processes end within two seconds.

Files are replaced completely or not at all (`_files`), so a command may end at any time. The
exception may be swallowed where compiled code or a destructor calls back into Python; a timer then
ends the process.
"""

import os
import signal
import sys
import threading
from contextlib import contextmanager

_PATIENCE = 1.5  # s, until the process is ended without an exception
_WORDS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}


class _Ended(KeyboardInterrupt):
    """A signal has ended the command; ``code`` is its exit code, 128 plus the signal number."""

    def __init__(self, number):
        super().__init__(_WORDS[number])
        self.code = 128 + number


@contextmanager
def ending_on_signals():
    """Raise `KeyboardInterrupt` on Ctrl-C and SIGTERM, and end the process soon in any case."""
    if threading.current_thread() is not threading.main_thread():  # only it can handle signals
        yield
        return
    timers, earlier = [], {}

    def end(number, frame):
        if not timers:
            for delay, function in ((0.5 * _PATIENCE, _kill_workers), (_PATIENCE, _leave)):
                timers.append(threading.Timer(delay, function, [number]))
                timers[-1].daemon = True
                timers[-1].start()
        raise _Ended(number)

    for number in _WORDS:
        earlier[number] = signal.signal(number, end)
    try:
        yield
    except KeyboardInterrupt:
        if timers:
            _kill_workers()
        raise
    finally:
        for timer in timers:
            timer.cancel()
        for number, handler in earlier.items():
            signal.signal(number, handler)


def _kill_workers(number=None):
    """Kill the processes of joblib's pool, if there is one; a timer calls it with the signal."""
    loky = sys.modules.get("joblib.externals.loky")
    if loky is not None:
        loky.get_reusable_executor().shutdown(wait=False, kill_workers=True)


def _leave(number):
    print(f"skhyst: {_WORDS[number]}", file=sys.stderr, flush=True)
    os._exit(128 + number)
