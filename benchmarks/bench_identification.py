"""Identification methods side by side: ``python benchmarks/bench_identification.py``.

First the five parameters of a Bouc-Wen model, 2,000 samples, 0.5 % noise: every method on the same
objective. Variable projection starts from the data; the population methods search all parameters
in wide bounds, 50 candidates over 300 iterations, without a polish, as the papers do. Then the
objective of Xie et al. (Smart Mater. Struct. 32, 015013, 2023): its published
parameters at 40 V and 20 Hz, one cycle with 1 nm of noise, searched by a swarm and by the cuckoos
of both renewals. Then a hard case: the hysteresis drives a resonance with a damping ratio of 0.01
whose frequency may lie anywhere in three decades; random starts are added to those from the data.
Last the time that a cascade of three steps takes on 100,000 samples, which should be at most 5 s.
``--seeds``, ``--swarms``, ``--hard``, ``--long`` and ``--first-seed`` set how many of each, and
which.
"""

import argparse
import time
import warnings
from functools import partial

import numpy as np
from bench_bouc_wen import AT_FLOOR, plant

from skhyst.compose import Cascade
from skhyst.datasets import make_tanh_recording, steps, triangle
from skhyst.hysteresis import (
    BoucWen,
    BoucWenOperator,
    PrandtlIshlinskii,
    PrandtlIshlinskiiOperator,
    TanhHysteresisOperator,
)
from skhyst.linear import KelvinVoigt, KelvinVoigtOperator, SecondOrderMode, SecondOrderModeOperator
from skhyst.operators import Series
from skhyst.optimize import (
    CuckooSearch,
    DifferentialEvolution,
    ModifiedCuckooSearch,
    ParticleSwarm,
    RecordData,
    VariableProjection,
    identify,
)

INTERVAL = 1e-3  # s
N_SAMPLES = 2000
NOISE = 0.005  # of the standard deviation of the response
N_LONG, LONG_INTERVAL, LONG_LIMIT = 100_000, 1e-4, 5.0  # samples, s, s
WIDE = {
    "gain": (-3.0, 3.0),
    "alpha": (-3.0, 3.0),
    "limit": (0.03, 1.0),
    "ratio": (0.0, 4.0),
    "exponent": (1.0, 4.0),
}
TANH = {"k0": (0, 0.5), "alpha": (-1e-3, 1e-3), "beta": (0, 1), "gamma": (1e4, 2e6)}
DECADES = {"mode__natural_frequency": (1.0, 3000.0), "mode__damping_ratio": (1e-4, 1.0)}


def ringing(seed):
    """Return a drive, a noisy response, and the error of the true plant."""
    rng = np.random.default_rng(seed)
    time_ = INTERVAL * np.arange(N_SAMPLES)
    frequencies = rng.uniform(0.5, 40.0, 5)
    phases = 2 * np.pi * np.outer(time_, frequencies) + rng.uniform(0.0, 6.0, 5)
    u = np.sin(phases) @ (1.0 / np.sqrt(frequencies))
    hysteresis = BoucWenOperator(
        gain=rng.uniform(0.2, 1.5),
        alpha=rng.uniform(0.3, 2.0) * rng.choice([-1, 1]),
        limit=np.exp(rng.uniform(np.log(0.05), np.log(0.5))) * np.abs(u).max(),
        ratio=rng.uniform(0.05, 3.0),
        exponent=np.exp(rng.uniform(0.0, np.log(3.0))),
    )
    mode = SecondOrderModeOperator(np.exp(rng.uniform(np.log(20.0), np.log(1500.0))), 0.01)
    clean = mode.run(hysteresis.run(u, INTERVAL)[0], INTERVAL)[0]
    noise = NOISE * clean.std() * rng.normal(size=N_SAMPLES)
    return u, clean + noise, np.sqrt(np.mean(noise**2))


def compare(label, make, draw, seeds):
    """Fit a model to a plant for each seed; print how often it ends at the noise."""
    if not seeds:
        return
    errors, evaluations, seconds = [], [], []
    for seed in seeds:
        u, y, floor = draw(seed)
        start = time.perf_counter()
        model = make().fit(u[:, None], y)
        seconds.append(time.perf_counter() - start)
        errors.append(model.fit_error_ / floor)
        evaluations.append(model.n_evaluations_)
    print(
        f"  {label:<24}{np.sum(np.array(errors) < AT_FLOOR):>3} of {len(errors):<3} at the noise, "
        f"median {np.median(errors):.4f}, worst {max(errors):.4f} of it; evaluations: median "
        f"{np.median(evaluations):.0f}, most {max(evaluations)}; median {np.median(seconds):.3f} s",
        flush=True,
    )


def tanh_searches(seeds):
    """Search the four parameters of the tanh model; print the errors that are reached."""
    X, y = make_tanh_recording(40, 20.0, n_cycles=1, noise=1e-3, random_state=0)
    record = RecordData(X["drive"].to_numpy(), y.to_numpy(), 0.000128)
    start = TanhHysteresisOperator(k0=0.1, alpha=1e-4, beta=0.1, gamma=1e5)
    print("tanh model, four parameters, 40 V and 20 Hz, 1 nm of noise: RMSE in nm")
    searches = {
        "particle swarm": ParticleSwarm,
        "cuckoos, new nests": partial(CuckooSearch, renewal="random"),
        "modified cuckoos, new nests": ModifiedCuckooSearch,
        "cuckoos, walk": CuckooSearch,
        "modified cuckoos, walk": partial(ModifiedCuckooSearch, renewal="walk"),
    }
    for name, make in searches.items():
        options = {"bounds": TANH, "project": False, "polish": False}
        results = [
            identify(
                [start], [record], fixed=("intercept",), method=make(random_state=seed, **options)
            )
            for seed in seeds
        ]
        errors = np.array([1e3 * result.error for result in results])
        print(
            f"  {name:<28} median {np.median(errors):7.4f}, {errors.min():.4f} to "
            f"{errors.max():.4f}, {np.median([r.n_evaluations for r in results]):.0f} evaluations",
            flush=True,
        )


def stage(seed):
    """Return the drive and the noisy response of plays, creep and a resonance, 100,000 samples."""
    rng = np.random.default_rng(seed)
    loops = triangle(
        [1.0, 0.5, 0.8, 0.2, 1.0, 0.6, 0.3],
        [2.0, 3.0, 10.0, 25.0, 100.0, 7.0, 1.0],
        n_cycles=[2, 2, 5, 10, 20, 5, 1],
        dt=LONG_INTERVAL,
    )
    rests = steps(rng.uniform(-1.0, 1.0, 100), hold=0.1, dt=LONG_INTERVAL)
    u = np.concatenate([loops["drive"], rests["drive"]])[:N_LONG]
    plays = PrandtlIshlinskiiOperator(np.arange(10) / 10, np.r_[1.0, np.full(9, 0.1)])
    creep = KelvinVoigtOperator(np.array([0.05, 0.1]), np.array([0.02, 1.0]))
    mode = SecondOrderModeOperator(2 * np.pi * 700.0, 0.03)
    series = Series(("hysteresis", "creep", "mode"), (plays, creep, mode))
    y = series.run(u, LONG_INTERVAL)[0]
    noise = 1e-3 * y.std()
    return u, y + noise * rng.normal(size=len(u)), noise


def long_cascade(seeds):
    """Fit three steps jointly to 100,000 samples; print the time."""
    print(f"Prandtl-Ishlinskii, Kelvin-Voigt, mode: {N_LONG} samples (limit {LONG_LIMIT:g} s)")
    for seed in seeds:
        u, y, noise = stage(seed)
        model = Cascade(
            [
                ("hysteresis", PrandtlIshlinskii(10)),
                ("creep", KelvinVoigt(2)),
                ("mode", SecondOrderMode()),
            ],
            dt=LONG_INTERVAL,
        )
        wall, cpu = time.perf_counter(), time.process_time()
        model.fit(u[:, None], y)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        verdict = "" if wall <= LONG_LIMIT else ", above the limit"
        print(
            f"  seed {seed}: {wall:.1f} s ({cpu:.1f} s of processor), {model.n_evaluations_} "
            f"evaluations, error {model.fit_error_ / noise:.4f} of the noise{verdict}",
            flush=True,
        )


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--swarms", type=int, default=3, help="seeds of the population methods")
    parser.add_argument("--hard", type=int, default=20, help="seeds of the hard case")
    parser.add_argument("--long", type=int, default=1, help="seeds of the long cascade")
    parser.add_argument("--first-seed", type=int, default=0)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    first = options.first_seed
    options_of_all = {"bounds": WIDE, "project": False, "polish": False}
    print(f"Bouc-Wen, five parameters, {N_SAMPLES} samples, {NOISE:.1%} noise")
    compare(
        "variable projection",
        lambda: BoucWen("fit", fit_intercept=False),
        plant,
        range(first, first + options.seeds),
    )
    for kind in (DifferentialEvolution, ParticleSwarm, CuckooSearch, ModifiedCuckooSearch):
        compare(
            kind.__name__,
            lambda kind=kind: BoucWen("fit", fit_intercept=False, method=kind(**options_of_all)),
            plant,
            range(first, first + options.swarms),
        )
    if options.swarms:
        tanh_searches(range(first, first + options.swarms))
    print(
        f"Bouc-Wen before a resonance, damping ratio 0.01, {N_SAMPLES} samples, {NOISE:.1%} noise"
    )
    for n_starts in (0, 30):
        method = VariableProjection(n_random_starts=n_starts, bounds=DECADES)
        compare(
            f"{n_starts} random starts",
            lambda method=method: Cascade(
                [("hysteresis", BoucWen("fit", fit_intercept=False)), ("mode", SecondOrderMode())],
                dt=INTERVAL,
                method=method,
            ),
            ringing,
            range(first, first + options.hard),
        )
    long_cascade(range(first, first + options.long))


if __name__ == "__main__":
    main()
