"""Speed and identification of the Bouc-Wen model: ``python benchmarks/bench_bouc_wen.py``.

Prints the time a sample of ``BoucWenOperator.run`` and ``sensitivities`` for several drives, the
best of several interleaved runs in one thread. White noise turns in two of three samples, where
nobody foresees it; the zigzag turns in each, in a pattern of four that a processor foresees. From
it and the triangle comes the least that noise can cost, with the limit of 20 ns. Then identifies
five parameters from 2,000 samples with 0.5 % noise for many seeds, and does the same with SciPy's
differential evolution, whose objective runs the same compiled operator. Both take one thread, and
CPU time is compared, so that a busy machine does not matter. ``--seeds`` and ``--evolutions`` set
how many of each.
"""

import argparse
import time

import numpy as np
from scipy.optimize import differential_evolution
from threadpoolctl import threadpool_limits

from skhyst.hysteresis import BoucWen, BoucWenOperator
from skhyst.optimize import RecordData, identify

N_SAMPLES = 100_000
N_FIT = 2_000
NOISE = 0.005  # of the standard deviation of the response
AT_FLOOR = 1.02
REPEATS = 15
BAR = 20.0  # ns a sample of noise with the exponent 1
# gain, alpha, logarithm of the limit, ratio, logarithm of the exponent
BOUNDS = [(-3, 3), (-3, 3), (np.log(0.03), np.log(1.0)), (0.0, 4.0), (0.0, np.log(4.0))]


def signals(n_samples):
    """Return the drives: sines of 100 and 1,000 samples a period, a triangle, a zigzag, noise."""
    k = np.arange(n_samples)
    return {
        "sine, 100": np.sin(2 * np.pi * k / 100),
        "sine, 1000": np.sin(2 * np.pi * k / 1000),
        "triangle": np.abs(k % 2000 - 1000) / 500.0 - 1.0,
        "zigzag": np.resize([0.8, -0.7, 0.6, -0.9], n_samples),
        "noise": np.random.default_rng(0).standard_normal(n_samples),
    }


def best(calls, repeats=REPEATS):
    """Return the shortest time in s of each call, run in turns after one warm-up."""
    shortest = dict.fromkeys(calls, np.inf)
    for call in calls.values():
        call()
    for _ in range(repeats):
        for name, call in calls.items():
            start = time.perf_counter()
            call()
            shortest[name] = min(shortest[name], time.perf_counter() - start)
    return shortest


class Run:
    """A hundred thousand samples through the operator."""

    params = ((1.0, 1.7), tuple(signals(1)))
    param_names = ("exponent", "drive")

    def setup(self, exponent, drive):
        """Make the drive and the operator."""
        self.drive = signals(N_SAMPLES)[drive]
        self.operator = BoucWenOperator(0.3, 1.0, 0.3, 0.6, exponent)
        self.nothing = np.empty((N_SAMPLES, 0))

    def time_run(self, exponent, drive):
        """Run from rest."""
        self.operator.run(self.drive, 1.0)

    def time_sensitivities(self, exponent, drive):
        """Return the response and the tangents of seven parameters."""
        self.operator.sensitivities(self.drive, self.nothing, 1.0)


def plant(seed):
    """Return a drive, a noisy response and the error of the true operator."""
    rng = np.random.default_rng(seed)
    t = np.arange(N_FIT) / N_FIT
    u = np.sin(6 * np.pi * t) * (0.3 + 0.7 * t)
    u += rng.uniform(0.0, 0.4) * np.sin(22 * np.pi * t + 1.0)
    truth = BoucWenOperator(
        gain=rng.uniform(0.2, 1.5) * rng.choice([-1, 1]),
        alpha=rng.uniform(0.3, 2.0) * rng.choice([-1, 1]),
        limit=np.exp(rng.uniform(np.log(0.08), np.log(0.6))),
        ratio=rng.uniform(0.05, 3.0),
        exponent=np.exp(rng.uniform(0.0, np.log(3.0))),
    )
    clean = truth.run(u, 1.0)[0]
    noise = NOISE * clean.std() * rng.normal(size=N_FIT)
    return u, clean + noise, np.sqrt(np.mean(noise**2))


def fit(u, y):
    """Return the error, the evaluations, and CPU seconds with and without validation."""
    model = BoucWen("fit", fit_intercept=False)
    start = time.process_time()
    model.fit(u[:, None], y)
    whole = time.process_time() - start
    records = [RecordData(u, y, 1.0)]
    start = time.process_time()
    result = identify(model.starting_values(records), records, fixed=model.held_parameters())
    return result.error, model.n_evaluations_, whole, time.process_time() - start


def evolve(u, y, seed):
    """Return the error, the evaluations and the CPU seconds of differential evolution."""

    def error(x):
        gain, alpha, limit, ratio, exponent = x
        operator = BoucWenOperator(gain, alpha, np.exp(limit), max(ratio, 0.0), np.exp(exponent))
        rest = operator.run(u, 1.0)[0] - y
        return rest @ rest

    start = time.process_time()
    found = differential_evolution(error, BOUNDS, seed=seed)
    seconds = time.process_time() - start
    return np.sqrt(found.fun / len(y)), found.nfev, seconds


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--evolutions", type=int, default=5)
    options = parser.parse_args()

    for name, label in (("time_run", "run"), ("time_sensitivities", "sensitivities")):
        cases, calls = Run.params, {}
        for exponent in cases[0]:
            for drive in cases[1]:
                case = Run()
                case.setup(exponent, drive)
                calls[exponent, drive] = lambda case=case: getattr(case, name)(None, None)  # noqa: B023
        seconds = best(calls)
        print(f"BoucWenOperator.{label}, {N_SAMPLES} samples, ns a sample")
        print("  exponent" + "".join(f"{drive:>12}" for drive in cases[1]))
        for exponent in cases[0]:
            row = (seconds[exponent, drive] / N_SAMPLES * 1e9 for drive in cases[1])
            print(f"  {exponent:<8}" + "".join(f"{value:>12.1f}" for value in row))
        if name == "time_run":
            turn, on, noise = (
                seconds[1.0, drive] / N_SAMPLES * 1e9 for drive in ("zigzag", "triangle", "noise")
            )
            verdict = "kept" if noise <= BAR else "MISSED"
            print(f"  noise {noise:.1f} ns (at most {BAR:.0f}: {verdict}); if all were foreseen")
            print(f"  2/3 {turn:.1f} + 1/3 {on:.1f} = {(2.0 * turn + on) / 3.0:.1f} ns")
    fresh = best({"": lambda: BoucWenOperator(0.3, 1.0, 0.3, 0.6, 1.7).run([0.0], 1.0)})[""]
    print(f"  one sample of a new operator: {fresh * 1e6:.0f} us")

    with threadpool_limits(limits=1, user_api="blas"):
        fit(*plant(0)[:2])
        print(f"Five parameters, {N_FIT} samples, {NOISE:.1%} noise")
        rows = []
        for seed in range(options.seeds):
            u, y, floor = plant(seed)
            error, evaluations, whole, bare = fit(u, y)
            rows.append((error / floor, evaluations, whole, bare))
        ours = np.array(rows)
        print(
            f"  BoucWen.fit: {np.sum(ours[:, 0] < AT_FLOOR)} of {options.seeds} within "
            f"{AT_FLOOR} of the noise (worst {ours[:, 0].max():.4f}), evaluations: median "
            f"{np.median(ours[:, 1]):.0f}, most {ours[:, 1].max():.0f}; median "
            f"{np.median(ours[:, 2]) * 1e3:.1f} ms, of which {np.median(ours[:, 3]) * 1e3:.1f} ms "
            "identification"
        )
        rows, ratios = [], []
        for seed in range(options.evolutions):
            u, y, floor = plant(seed)
            additive = [fit(u, y)[2:] for _ in range(10)]
            error, evaluations, seconds = evolve(u, y, seed)
            additive += [fit(u, y)[2:] for _ in range(10)]
            rows.append((error / floor, evaluations, seconds))
            ratios.append(seconds / np.median(additive, axis=0))
        theirs = np.array(rows)
        print(
            f"  differential_evolution: {np.sum(theirs[:, 0] < AT_FLOOR)} of "
            f"{options.evolutions} within {AT_FLOOR}, evaluations: median "
            f"{np.median(theirs[:, 1]):.0f}; median {np.median(theirs[:, 2]):.2f} s (CPU)"
        )
        with_validation, without = np.median(ratios, axis=0)
        print(
            f"  ratio of times, median over seeds: {with_validation:.0f} with, {without:.0f} "
            "without validation of the data"
        )


if __name__ == "__main__":
    main()
