"""A paired comparison with another checkout: ``python tools/paired.py CHECKOUT``.

Every case is timed in two processes by turns, one with the package of this tree, one with that of
the other, so that both see the same machine; printed is the median ratio of the pairs, new over
old. Cases use public estimators only: free runs of 200,000 samples, fits to 20,000, the import of
the package with a first prediction. ``--repeats`` sets the pairs of a case, ``--only`` a part of
the names, ``--limit`` the largest ratio that is in order.
"""

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
N_RUN, N_FIT, DT = 200_000, 20_000, 1e-3  # samples, samples, s
LIMIT = 1.05
CALLS = 5  # in a turn, of which the fastest counts
KEPT = str(2**30)  # bytes of freed memory: whether pages come from the system is luck
FIRST = "import and first prediction"


def signals(n, seed=0):
    """Return a drive of decaying and band-limited parts, and a response with memory."""
    rng = np.random.default_rng(seed)
    time_ = DT * np.arange(n)
    slow = np.interp(time_, np.linspace(0.0, time_[-1], n // 50), rng.standard_normal(n // 50))
    drive = np.sin(2 * np.pi * 2.0 * time_) * np.exp(-time_ / time_[-1]) + slow
    weights = rng.uniform(0.2, 1.0, 6)
    response, states = 0.5 * drive, np.zeros(6)
    for i, u in enumerate(drive):
        states = np.clip(states, u - 0.2 * np.arange(1, 7), u + 0.2 * np.arange(1, 7))
        response[i] += weights @ states
    response += 0.02 * rng.standard_normal(n)
    return drive.reshape(-1, 1), response


def estimators():
    """Return the estimators of the cases by name."""
    from skhyst.autoregressive import NARXRegressor
    from skhyst.compose import Cascade
    from skhyst.hysteresis import BoucWen, Dahl, LuGre, PrandtlIshlinskii, Preisach, TanhHysteresis
    from skhyst.linear import KelvinVoigt, SecondOrderMode, TransferFunction

    steps = [("plays", PrandtlIshlinskii(10)), ("mode", SecondOrderMode())]
    return {
        "Prandtl-Ishlinskii": PrandtlIshlinskii(20, dt=DT),
        "Preisach": Preisach(10, dt=DT),
        "Bouc-Wen": BoucWen(dt=DT),
        "Dahl": Dahl(dt=DT),
        "LuGre": LuGre(dt=DT),
        "tanh": TanhHysteresis(dt=DT),
        "second-order mode": SecondOrderMode(dt=DT),
        "transfer function": TransferFunction(4, dt=DT),
        "creep": KelvinVoigt(3, dt=DT),
        "plays and mode": Cascade(steps, dt=DT),
        "NARX": NARXRegressor(),
    }


def work():
    """Answer each case read from the standard input with its seconds."""
    begin = time.perf_counter()
    models, (X, y), (long, _) = estimators(), signals(N_FIT), signals(N_RUN, 1)
    fitted = {}
    for line in sys.stdin:
        kind, name = line.rstrip("\n").split(" ", 1)
        if name not in fitted:  # compiles, too
            fitted[name] = models[name].fit(X, y)
            fitted[name].predict(long)
        times = []
        for _ in range(CALLS):
            begin = time.perf_counter()
            if kind == "fit":
                models[name].fit(X, y)
            else:
                fitted[name].predict(long)
            times.append(time.perf_counter() - begin)
        print(min(times), flush=True)


def first(tree):
    """Return the seconds of a process that imports the package of a tree and predicts once."""
    code = (
        "import numpy as np; from skhyst.hysteresis import PrandtlIshlinskii as P; "
        "X = np.sin(np.arange(200.0)).reshape(-1, 1); P(3).fit(X, X[:, 0]).predict(X)"
    )
    begin = time.perf_counter()
    subprocess.run([sys.executable, "-c", code], env=environment(tree), check=True)
    return time.perf_counter() - begin


def environment(tree):
    """Return the environment of a process that imports the package of a tree."""
    memory = {"MALLOC_TRIM_THRESHOLD_": KEPT, "MALLOC_MMAP_THRESHOLD_": KEPT}
    return os.environ | {"PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1"} | memory


def started(tree):
    """Start a process with the package of a tree that answers cases."""
    command = [sys.executable, __file__, "--work"]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, env=environment(tree), **pipes)


def answered(process, case):
    """Return the seconds of a case."""
    print(case, file=process.stdin, flush=True)
    return float(process.stdout.readline())


def main():
    parser = argparse.ArgumentParser(description=__doc__.split(":")[0])
    parser.add_argument("checkout", nargs="?", type=Path)
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--only", default="")
    parser.add_argument("--limit", type=float, default=LIMIT)
    parser.add_argument("--work", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work:
        work()
        return
    trees = ROOT, options.checkout.resolve()
    new, old = map(started, trees)
    cases = [f"{kind} {name}" for kind in ("run", "fit") for name in estimators()]
    above = 0
    for case in [*(c for c in cases if options.only in c), *([] if options.only else [FIRST])]:
        pairs = []
        for i in range(options.repeats):
            times = {}
            for side in (0, 1) if i % 2 else (1, 0):
                process = (new, old)[side]
                times[side] = first(trees[side]) if case == FIRST else answered(process, case)
            pairs.append((times[0], times[1]))
        times = np.array(pairs)
        ratio = np.median(times[:, 0] / times[:, 1])
        above += ratio > options.limit
        print(
            f"{case:32s} {np.median(times[:, 0]):9.4f} s, before {np.median(times[:, 1]):9.4f} s, "
            f"ratio {ratio:5.2f} {'ABOVE' if ratio > options.limit else 'ok'}",
            flush=True,
        )
    for process in (new, old):
        process.stdin.close()
        process.wait()
    print(f"{above} above {options.limit:g}")


if __name__ == "__main__":
    main()
