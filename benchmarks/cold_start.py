"""How long the first things take: ``python benchmarks/cold_start.py``.

Each is done in processes of its own, with an empty cache of Numba, so that what is compiled counts.
Printed are seconds on the clock and of the processor, and the limit, which is for the clock of an
idle machine; where the load average says that others work, the processor's seconds are the better
guide. ``--only`` takes a part of the names.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

BARS = {  # s
    "import skhyst, beyond scikit-learn": 0.5,
    "first prediction": 2.0,
    "first search, beyond the second": 15.0,
    "skhyst demo": 60.0,
}
REPEATS = 3

CLOCKS = """
import json, sys, time
def clocks():
    return time.perf_counter(), time.process_time()
def since(start):
    return [now - then for now, then in zip(clocks(), start)]
"""
RECORDING = """
import numpy as np
from skhyst.hysteresis import PrandtlIshlinskii, PrandtlIshlinskiiOperator
rng = np.random.default_rng(0)
u = np.sin(np.arange(4000) / 50.0) * np.linspace(0.5, 1.0, 4000)
plays = PrandtlIshlinskiiOperator(np.linspace(0.0, 0.5, 4), np.array([1.0, 0.3, 0.2, 0.1]))
"""
PREDICTION = f"""
{CLOCKS}
from skhyst.persistence import from_json
model = from_json(open(sys.argv[1]).read())
start = clocks()
model.predict([[0.1 * k] for k in range(100)])
print(json.dumps(since(start)))
"""
SEARCH = f"""
{CLOCKS}
{RECORDING}
from skhyst.diagnosis import EffectSearchCV
y = np.minimum(plays.run(u, 1e-3)[0], 0.7) + 0.01 * rng.standard_normal(4000)
taken = []
for _ in range(2):
    start = clocks()
    EffectSearchCV(PrandtlIshlinskii(dt=1e-3), random_state=0).fit(u[:, None], y)
    taken.append(since(start))
print(json.dumps([first - second for first, second in zip(*taken)]))
"""


def run(*arguments, cache=None):
    """Return the output of Python, and the seconds of the clock and of the processor."""
    settings = os.environ | {"NUMBA_CACHE_DIR": str(cache)} if cache else os.environ
    start, before = time.perf_counter(), os.times()
    done = subprocess.run(
        [sys.executable, *arguments], env=settings, capture_output=True, text=True, check=True
    )
    after = os.times()
    used = after.children_user + after.children_system
    used -= before.children_user + before.children_system
    return done.stdout, (time.perf_counter() - start, used)


def imported(folder):
    """Return the seconds of the import beyond those of scikit-learn, the best of several."""
    best = [
        [min(own) for own in zip(*taken, strict=True)]
        for taken in (
            [run("-c", f"import {name}", cache=folder)[1] for _ in range(REPEATS)]
            for name in ("skhyst, sklearn", "sklearn")
        )
    ]
    return [own - other for own, other in zip(*best, strict=True)]


def predicted(folder):
    """Return the seconds of a prediction by a model from a file."""
    file = folder / "model.json"
    code = f"{RECORDING}\nfrom skhyst.persistence import to_json\n"
    code += "print(to_json(PrandtlIshlinskii().fit(u[:, None], plays.run(u, 1e-3)[0])))"
    file.write_text(run("-c", code)[0], encoding="utf-8")
    return json.loads(run("-c", PREDICTION, str(file), cache=folder)[0])


def searched(folder):
    """Return the seconds of a search less those of the same search after it."""
    return json.loads(run("-c", SEARCH, cache=folder)[0])


def demonstrated(folder):
    """Return the seconds of the demonstration, with all that it imports and compiles."""
    output = str(folder / "demo")
    return run("-m", "skhyst", "demo", "--quiet", "--output", output, cache=folder)[1]


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", default="", metavar="TEXT")
    only = parser.parse_args(arguments).only
    measures = dict(zip(BARS, (imported, predicted, searched, demonstrated), strict=True))
    print(f"{'':38s}clock  processor    bar")
    for name, measure in measures.items():
        if only in name:
            with tempfile.TemporaryDirectory() as folder:
                clock, processor = measure(Path(folder))
            print(f"{name:36s}{clock:7.2f} {processor:10.2f} {BARS[name]:6.1f}")
    if hasattr(os, "getloadavg"):
        load = os.getloadavg()[0]
        print(f"load average {load:.1f} on {os.cpu_count()} processors", end="")
        print(": busy with other work" if load > os.cpu_count() else "")


if __name__ == "__main__":
    main()
