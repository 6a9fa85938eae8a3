"""Time a search over all effects on 20,000 samples: `python benchmarks/bench_search.py`.

Prints each run, the median of the runs for each declared model, and the time of every stage.
The first search compiles the kernels and is not counted.
"""

import argparse
import statistics
import time

from plants import make_recording

from skhyst.compose import Cascade
from skhyst.diagnosis import EffectSearchCV
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import TransferFunction

LIMIT = 10.0  # s


def declared_model(name):
    if name == "prandtl_ishlinskii":
        return PrandtlIshlinskii()
    return Cascade([("hysteresis", PrandtlIshlinskii()), ("dynamics", TransferFunction(2))])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--effects", default="none,creep,resonance")
    options = parser.parse_args()
    for declared in ("prandtl_ishlinskii", "cascade"):
        for effect in options.effects.split(","):
            recording = make_recording(effect, declared, seed=8000)
            seconds = []
            for repeat in range(options.repeats + 1):
                search = EffectSearchCV(
                    declared_model(declared), n_jobs=options.jobs, random_state=0
                )
                start = time.perf_counter()
                search.fit(recording.X_train, recording.y_train)
                if repeat:
                    seconds.append(time.perf_counter() - start)
            named = ",".join(search.effects_) or "-"
            runs = ", ".join(f"{value:.2f}" for value in seconds)
            stages = ", ".join(f"{name} {value:.2f}" for name, value in search.seconds_.items())
            print(
                f"{declared}, {effect} missing, {named} named, {len(recording.y_train)} samples: "
                f"median {statistics.median(seconds):.2f} s (limit {LIMIT:g} s), all {runs}; "
                f"last: {stages}",
                flush=True,
            )


if __name__ == "__main__":
    main()
