"""Long free runs, and recordings of many samples or many records, for every model.

Run from the root of the project::

    python tools/endurance.py [--samples 10000000] [--records 100000] [--models A,B]

Each model is fitted to a short recording and then runs freely over `--samples` samples of one
record; it is fitted to one record of a tenth of them, and to `--records` records of three samples,
and predicts these. A line has the seconds and the memory of each (GiB above that of the process
before), and, if so, why it was refused, that the result was not finite, or that it took longer than
`--limit` seconds, which ends the model's process and skips its further tasks.
"""

import argparse
import json
import os
import resource
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pandas as pd

from skhyst.discovery import all_estimators, declarable_models

DT = 1e-3  # s
OTHERS = ("NARMAXRegressor", "NARXRegressor", "ModalModel", "SCNRegressor")


def models():
    """Return the classes of the models that need no other, and respond to the drive, by name."""
    declarable = declarable_models().values()
    own = [(name, cls) for name, cls in all_estimators() if cls in declarable or name in OTHERS]
    return dict(own)


def recording(n_samples, n_records=1):
    """Return X and y of `n_records` records that share `n_samples` samples."""
    time_ = DT * np.arange(n_samples)
    drive = np.sin(2.0 * time_) + 0.5 * np.sin(31.0 * time_ + 1.0) + 0.2 * np.sin(170.0 * time_)
    response = np.empty_like(drive)
    state, rate = 0.0, 0.05
    for start in range(0, n_samples, 1_000_000):  # a lag, in blocks that fit the cache
        part = drive[start : start + 1_000_000]
        response[start : start + len(part)], state = _lag(part, state, rate)
    noise = np.random.default_rng(0).normal(size=n_samples)
    size = n_samples // n_records
    labels = np.repeat(np.arange(n_records), size)
    index = pd.MultiIndex.from_arrays([labels, DT * (np.arange(len(labels)) % size)])
    index.names = ["record", "time"]
    X = pd.DataFrame({"drive": drive[: len(labels)]}, index)
    return X, pd.Series((response + 0.01 * noise)[: len(labels)], index)


def _lag(part, state, rate):
    from scipy.signal import lfilter

    y, rest = lfilter([rate], [1.0, rate - 1.0], part, zi=[state])
    return y, rest[0]


def measure(action):
    """Return what an action took: seconds, memory, and a word where it was refused or is wrong."""
    held, start = _held(), time.perf_counter()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            word = "" if np.isfinite(action()).all() else "NOT FINITE"
        except (ValueError, TypeError) as error:
            word = f"refused: {error}"[:100]
    seconds = time.perf_counter() - start
    word += " diverged" if any(w.category.__name__ == "DivergenceWarning" for w in caught) else ""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return seconds, max(peak - held, 0) / 2**30, word.strip()


def _held():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def examine(name, n_samples, n_records, limit):
    """Print a JSON line for each of the tasks of one model."""
    cls = models()[name]
    short = recording(5_000)

    def fitted(data):
        model = cls() if name == "SCNRegressor" else cls(dt=DT)
        return model.fit(*data)

    def free_run():
        return model.predict(recording(n_samples)[0])

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = fitted(short)
    tasks = {
        "free run": free_run,
        "fit one": lambda: fitted(recording(n_samples // 10)).predict(short[0]),
        "fit many": lambda: fitted(recording(3 * n_records, n_records)).predict(short[0]),
        "run many": lambda: model.predict(recording(3 * n_records, n_records)[0]),
    }
    for task, action in tasks.items():
        print(json.dumps([task]), flush=True)
        signal.alarm(limit)
        found = measure(action)
        signal.alarm(0)
        print(json.dumps([task, *found]), flush=True)


def run(name, n_samples, n_records, limit):
    """Return task -> (seconds, GiB, word) of one model."""
    own = json.dumps([name, n_samples, n_records, limit])
    call = [sys.executable, __file__, "--work", own]
    done = subprocess.run(call, capture_output=True, text=True)
    lines = [json.loads(line) for line in done.stdout.splitlines() if line[:1] == "["]
    found = {task: values for task, *values in lines if values}
    for task, *values in lines:
        if not values and task not in found:
            long = done.returncode == -signal.SIGALRM
            found[task] = (limit, 0.0, f"more than {limit} s" if long else done.stderr[-200:])
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--samples", type=int, default=10_000_000)
    add("--records", type=int, default=100_000)
    add("--limit", type=int, default=600, help="s of each task")
    add("--models", default=",".join(models()))
    add("--work", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work:
        return examine(*json.loads(options.work))
    for name in options.models.split(","):
        for task, (seconds, memory, word) in run(
            name, options.samples, options.records, options.limit
        ).items():
            print(f"{name:32s}{task:10s}{seconds:8.1f} s{memory:7.2f} GiB  {word}", flush=True)
    return None


if __name__ == "__main__":
    main()
