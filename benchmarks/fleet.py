"""Search many recordings on a cluster: nothing lost, nothing other than one by one.

    python benchmarks/fleet.py [--recordings 200] [--engines dask ray]

Small recordings of a plant with a lag, or without, are written; one of them is corrupt. They are
searched one by one, on a `dask.distributed` LocalCluster one of whose workers is killed meanwhile,
and on Ray by its backend for joblib (extra `cluster`). Each figure is printed with its limit.
"""

import argparse
import os
import signal
import tempfile
import threading
import time
import warnings
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pandas as pd
from joblib import parallel_config

from skhyst.diagnosis import EffectSearchCV
from skhyst.fleet import PerDevice, diagnose_files, read_summary
from skhyst.linear import FirstOrderLag, FirstOrderLagOperator, Gain
from skhyst.records import read_records

READING = {"drive": "u", "response": "y", "time": "t"}
N_SAMPLES, DT = 200, 0.01
WORKERS = 2


def write_fleet(folder, n_recordings, corrupt=1):
    """Write the recordings, of which every other plant has a lag; return their paths."""
    files = []
    for number in range(n_recordings):
        rng = np.random.default_rng(number)
        t = DT * np.arange(N_SAMPLES)
        u = np.sin(2 * np.pi * 2.0 * t) + 0.3 * rng.normal(size=t.size)
        y = 2.0 * u
        if number % 2:
            y, _ = FirstOrderLagOperator(rng.uniform(0.02, 0.08)).run(y, DT)
        y = y + 0.05 * rng.normal(size=t.size)
        files.append(Path(folder, f"stage_{number:03d}.csv"))
        pd.DataFrame({"t": t, "u": u, "y": y}).to_csv(files[-1], index=False)
    files[corrupt].write_bytes(b"\x00\xff\x00 no recording")
    return files


def searched(files, summary=None, on_done=None, n_jobs=None):
    """Return the table of the searches."""
    search = EffectSearchCV(Gain(), effects=["lag"], random_state=0)
    return diagnose_files(
        files, search, reading=READING, summary=summary, n_jobs=n_jobs, on_done=on_done
    )


def fitted(files, n_jobs=None):
    """Return the parameters of one model for each recording that can be read."""
    records = {}
    for file in files:
        try:
            records[file.stem] = read_records(file, **READING)
        except ValueError:
            continue
    X, y = (
        pd.concat([pair[i].droplevel("record") for pair in records.values()], keys=records)
        for i in (0, 1)
    )
    names = ["record", "time"]
    X, y = X.rename_axis(names), y.rename_axis(names)
    return PerDevice(FirstOrderLag(), n_jobs=n_jobs).fit(X, y).params_


class Killer:
    """Kills a process, once, a moment after the first recordings have been searched."""

    def __init__(self, pid):
        self.pid, self.killed = pid, False

    def __call__(self, rows):
        """Kill it, if it has not been killed."""
        if not self.killed:
            self.killed = True
            threading.Timer(0.2, os.kill, [self.pid, signal.SIGKILL]).start()


@contextmanager
def on_dask():
    """Run joblib on a local cluster; give a function that kills one of its workers."""
    from distributed import Client, LocalCluster

    options = {"n_workers": WORKERS, "threads_per_worker": 1, "dashboard_address": None}
    with LocalCluster(**options) as cluster, Client(cluster) as client:
        pid = next(iter(client.run(os.getpid).values()))
        with parallel_config("dask", n_jobs=WORKERS):
            yield Killer(pid)


@contextmanager
def on_ray():
    """Run joblib on a local Ray; nothing is killed."""
    import ray
    from ray.util.joblib import register_ray

    ray.init(num_cpus=WORKERS, include_dashboard=False, log_to_driver=False)
    register_ray()
    try:
        with parallel_config("ray", n_jobs=WORKERS):
            yield None
    finally:
        ray.shutdown()


ENGINES = {"dask": on_dask, "ray": on_ray}


def lost(found, serial):
    """Return how many rows are missing or other than those of the serial run."""
    if list(found.index) != list(serial.index):
        return len(serial.index.symmetric_difference(found.index)) or len(serial)
    same = (found == serial) | (found.isna() & serial.isna())
    return int((~same.all(axis=1)).sum())


def bar(name, value, wanted):
    """Print a figure and its limit; return whether it is kept."""
    kept = value == wanted
    print(f"{name:56s} {value:6} (bar {wanted}) {'kept' if kept else 'MISSED'}", flush=True)
    return kept


def report(name, table, written, params, serial, serial_params):
    """Print the figures of one engine; return whether all bars are kept."""
    failures = table["failure"].astype(bool)
    return all(
        [
            bar(f"{name}: rows in the file that was written", len(written), len(serial)),
            bar(f"{name}: rows other than the serial ones", lost(table, serial), 0),
            bar(f"{name}: recordings with a failure, the corrupt one", int(failures.sum()), 1),
            bar(f"{name}: models other than the serial ones", lost(params, serial_params), 0),
        ]
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recordings", type=int, default=200)
    parser.add_argument("--engines", nargs="*", choices=tuple(ENGINES), default=tuple(ENGINES))
    arguments = parser.parse_args()
    with warnings.catch_warnings(action="ignore"), tempfile.TemporaryDirectory() as folder:
        files = write_fleet(folder, arguments.recordings)
        begun = time.perf_counter()
        serial, serial_params = searched(files), fitted(files)
        print(f"serial: {time.perf_counter() - begun:.1f} s, effects named:")
        print(serial["effects"].value_counts().to_string())
        kept = True
        for name in arguments.engines:
            summary = Path(folder, f"{name}.csv")
            with ENGINES[name]() as killer:
                begun = time.perf_counter()
                table = searched(files, summary, killer)
                params = fitted(files)
                print(f"{name}: {time.perf_counter() - begun:.1f} s")
            kept &= report(name, table, read_summary(summary), params, serial, serial_params)
            if killer is not None:
                kept &= bar(f"{name}: workers killed", int(killer.killed), 1)
    return 0 if kept else 1


if __name__ == "__main__":
    raise SystemExit(main())
