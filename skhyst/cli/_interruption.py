"""Ctrl-C and SIGTERM: a command ends within two seconds, and its worker processes with it.

What is written takes its place whole or not at all (`_files`), so it may end at any instant. The
exception may be swallowed, where compiled code or a destructor calls back into Python: then the
process ends without it.
"""

import os
import signal
import sys
import threading
from contextlib import contextmanager

_PATIENCE = 1.5  # s
_WORDS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}


class _Ended(KeyboardInterrupt):
    """A signal has ended the command; its exit code is ``code``, as a shell counts."""

    def __init__(self, number):
        super().__init__(_WORDS[number])
        self.code = 128 + number


@contextmanager
def ending_on_signals():
    """Raise `KeyboardInterrupt` on Ctrl-C and SIGTERM, and see that the process ends soon."""
    if threading.current_thread() is not threading.main_thread():  # others get no signals
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
    """Kill the processes of joblib's pool, where there is one."""
    loky = sys.modules.get("joblib.externals.loky")
    if loky is not None:
        loky.get_reusable_executor().shutdown(wait=False, kill_workers=True)


def _leave(number):
    print(f"skhyst: {_WORDS[number]}", file=sys.stderr, flush=True)
    os._exit(128 + number)
