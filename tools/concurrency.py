"""Compare every estimator in threads, processes and nested jobs with a single-threaded run.

Run from the root of the project::

    python tools/concurrency.py [--rounds 5]

A line names what was done, how many results were compared with those of one thread, and how many
differed in any bit. A step that takes longer than ten minutes ends the command with the stacks of
all threads.
"""

import argparse
import faulthandler
import multiprocessing
import sys
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pandas as pd
from joblib import parallel_config
from sklearn.base import clone
from sklearn.model_selection import GridSearchCV

from skhyst.autoregressive import NARXRegressor
from skhyst.diagnosis import EffectSearchCV
from skhyst.fleet import PerDevice
from skhyst.hysteresis import PrandtlIshlinskii, PrandtlIshlinskiiOperator
from skhyst.linear import FirstOrderLag, FirstOrderLagOperator
from skhyst.model_selection import RecordKFold

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests" / "attack"))
from attack import fitted_use, instance
from hostile_data import Case
from small_estimators import small_estimators

DT, THREADS, LIMIT = 0.01, 8, 600
SEARCH = EffectSearchCV(
    PrandtlIshlinskii(5), effects=["lag", "creep"], cv=2, max_effects=1, random_state=0
)


def records():
    """Return X and y of four records of a hysteresis and a lag."""
    rng, frames, parts = np.random.default_rng(0), [], []
    plant = PrandtlIshlinskiiOperator([0.0, 0.3, 0.8], [0.5, 0.4, 0.4])
    for label in "abcd":
        u = np.convolve(rng.normal(size=600), np.ones(25) / 8.0, mode="same")
        y, _ = FirstOrderLagOperator(0.04).run(plant.run(u, DT)[0], DT)
        index = pd.MultiIndex.from_product([[label], DT * np.arange(600)], names=["record", "time"])
        frames.append(pd.DataFrame({"drive": u}, index))
        parts.append(pd.Series(y + 0.01 * rng.normal(size=600), index))
    return pd.concat(frames), pd.concat(parts)


def result(name):
    """Return the results of a new small estimator for the plain case."""
    return fitted_use(instance(name), *Case().given())


def differing(found, expected):
    return sum(not np.array_equal(own, expected, equal_nan=True) for own in found)


def tell(what, found, expected, start):
    faulthandler.dump_traceback_later(LIMIT, exit=True)  # anew for the next step
    count = differing(found, expected)
    took = time.perf_counter() - start
    print(f"{what:60s}{len(found):5d}{count:5d}{took:8.0f} s", flush=True)
    return count


def in_threads(rounds):
    """Fit every estimator in threads at once."""
    total = 0
    for name in small_estimators():
        start, expected = time.perf_counter(), result(name)
        with ThreadPoolExecutor(THREADS) as pool:
            found = list(pool.map(result, [name] * (rounds * THREADS)))
        total += tell(f"{name} in {THREADS} threads", found, expected, start)
    return total


def in_processes():
    """Fit some estimators in processes of every start method."""
    names, total = ["PrandtlIshlinskii", "FirstOrderLag", "NARXRegressor", "Preisach"], 0
    for method in multiprocessing.get_all_start_methods():
        for name in names:
            start, model, data = time.perf_counter(), instance(name), Case().given()
            with multiprocessing.get_context(method).Pool(2) as pool:
                fits = [pool.apply_async(clone(model).fit, data) for _ in range(4)]
                found = [fit.get(LIMIT).predict(data[0]) for fit in fits]
            total += tell(f"{name} by {method}", found, result(name), start)
    return total


def with_jobs():
    """Search with one job and with two, in one another too, on joblib's backends."""
    X, y = records()
    folds = RecordKFold(2)
    grid = GridSearchCV(SEARCH, {"estimator__n_operators": [3, 5]}, cv=folds)
    devices = PerDevice(FirstOrderLag())
    network = GridSearchCV(NARXRegressor(), {"output_lags": [1, 2]}, cv=folds)
    cases = {
        "EffectSearchCV": (SEARCH, {"n_jobs": 2}),
        "PerDevice": (devices, {"n_jobs": 2}),
        "GridSearchCV of NARXRegressor": (network, {"n_jobs": 2}),
        "GridSearchCV of EffectSearchCV": (grid, {"n_jobs": 2}),
        "GridSearchCV of EffectSearchCV of two jobs": (grid, {"n_jobs": 2, "estimator__n_jobs": 2}),
    }
    total = 0
    for what, (search, jobs) in cases.items():
        expected = clone(search).fit(X, y).predict(X)
        for backend in ("loky", "threading"):
            start = time.perf_counter()
            with parallel_config(backend):
                found = clone(search).set_params(**jobs).fit(X, y).predict(X)
            total += tell(f"{what}, {backend}", [found], expected, start)
    return total


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5, help="fits of each thread")
    parser.add_argument("--parts", default="jobs,processes,threads")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    parts = {
        "jobs": with_jobs,
        "processes": in_processes,
        "threads": lambda: in_threads(options.rounds),
    }
    total = 0
    print(f"{'':60s}{'fits':>5s}{'other':>6s}")
    faulthandler.dump_traceback_later(LIMIT, exit=True)
    for part in options.parts.split(","):
        total += parts[part]()
    faulthandler.cancel_dump_traceback_later()
    return int(total > 0)


if __name__ == "__main__":
    sys.exit(main())
