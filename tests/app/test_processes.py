"""Each session of the page has worker processes of its own."""

import os
import time
import warnings
from threading import Event, Thread

from joblib import Parallel, delayed

from skhyst.app._processes import own_processes


def squared(number, seconds):
    time.sleep(seconds)
    return number**2, os.getpid()


def is_running(process):
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def numbers(count, seconds=0.0):
    parallel = Parallel(n_jobs=2, batch_size=1, return_as="generator")
    return parallel(delayed(squared)(number, seconds) for number in range(count))


def test_one_that_is_stopped_ends_no_other():
    done, started, stopped = [], Event(), Event()

    def other():
        with own_processes():
            found = numbers(6, 0.05)
            done.append(next(found))
            started.set()
            stopped.wait(60.0)
            done.extend(found)
            done.extend(numbers(2))

    thread = Thread(target=other)
    thread.start()
    assert started.wait(60.0)
    with own_processes():  # which is stopped
        found = numbers(6, 0.05)
        own = {next(found)[1]}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of joblib, on what still runs
            found.close()
    stopped.set()
    thread.join(60.0)
    assert [square for square, _ in done] == [0, 1, 4, 9, 16, 25, 0, 1]
    processes = {process for _, process in done}
    assert len(processes) <= 2  # which stay from call to call
    assert not processes & own
    assert not any(is_running(process) for process in processes | own)
