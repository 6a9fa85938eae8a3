"""Speed of the friction models: `python benchmarks/bench_friction.py`.

Prints the time a sample of ``run`` and of ``sensitivities`` for 100,000 samples, best of several
runs in one thread, and the limit for ``run``.
"""

import time

import numpy as np

from skhyst.hysteresis import DahlOperator, DuhemOperator, LuGreOperator, MaxwellSlipOperator

LIMIT = 150.0  # ns a sample
N_SAMPLES = 100_000
REPEATS = 7
DT = 1e-3

OPERATORS = {
    "Dahl": DahlOperator(0.1, 2.0, damping=0.1),
    "Dahl, exponent 1.5": DahlOperator(0.1, 2.0, damping=0.1, exponent=1.5),
    "LuGre": LuGreOperator(0.1, 0.5, 0.6, 3.0, 0.1, damping=0.1),
    "Duhem": DuhemOperator(10.0, [1.0], [0.5]),
    "Duhem, degree 3": DuhemOperator(10.0, [1.0, 0.1, 0.2], [0.5, 0.1, 0.1]),
    "Maxwell slip, 10": MaxwellSlipOperator(np.arange(1, 11) / 5.0, np.ones(10), damping=0.1),
    "Maxwell slip, 100": MaxwellSlipOperator(np.arange(1, 101) / 50.0, np.ones(100), damping=0.1),
}


def drives():
    """Return a noisy drive, where nothing repeats, and a smooth one."""
    ramp = np.arange(N_SAMPLES) * DT
    walk = np.cumsum(np.random.default_rng(0).standard_normal(N_SAMPLES)) * 0.02
    return {"walk": walk, "sine": np.sin(2 * np.pi * ramp)}


def best(method, *arguments):
    """Return the shortest time of a call in ns a sample, after a warm-up."""
    method(*arguments)
    shortest = np.inf
    for _ in range(REPEATS):
        start = time.perf_counter()
        method(*arguments)
        shortest = min(shortest, time.perf_counter() - start)
    return shortest / N_SAMPLES * 1e9


def main():
    signals, none = drives(), np.empty((N_SAMPLES, 0))
    print(f"{'ns a sample':<20}{'run, walk':>12}{'run, sine':>12}{'sensitivities':>12}")
    for name, operator in OPERATORS.items():
        times = [best(operator.run, u, DT) for u in signals.values()]
        tangents = best(operator.sensitivities, signals["sine"], none, DT)
        late = "" if max(times) <= LIMIT else f"  above {LIMIT:g}"
        print(f"{name:<20}" + "".join(f"{t:>12.1f}" for t in (*times, tangents)) + late)


if __name__ == "__main__":
    main()
