"""How often intervals hold the truth, by the noise's colour: `python benchmarks/intervals.py`.

    python benchmarks/intervals.py [--seeds 100] [--first-seed 0] [--samples 2000]

Plants of known parameters are driven by random multisines and read with noise of 2 % of the range
that is white, autoregressive with the coefficient 0.9, or has a power of one over the frequency.
Each line is a model and a noise: how many of the intervals of 1.96 standard errors hold the true
value, over all seeds and parameters, and the limits of 90 to 99 %; the parameter whose intervals
hold least often; and what the standard errors of white noise give. The terms of NARMAX are found in
the data: those that the plant has are counted, and how often there are no others is told.
"""

import argparse
import time
import warnings

import numpy as np
from narmax_structure import QUADRATIC, spelled
from plants.signals import draw_noise

from skhyst.autoregressive import NARMAXRegressor
from skhyst.exceptions import ShortRecordWarning
from skhyst.hysteresis import (
    BoucWen,
    BoucWenOperator,
    PrandtlIshlinskii,
    PrandtlIshlinskiiOperator,
)
from skhyst.linear import TransferFunction, TransferFunctionOperator

BAR = 0.90, 0.99
LEVEL = 0.02  # of the range
DT = 0.005  # s
NOISES = {
    "white": {"law": "white"},
    "AR(1) 0.9": {"law": "autoregressive", "coefficient": 0.9},
    "1/f": {"law": "flicker"},
}
THRESHOLDS = np.array([0.0, 0.3, 0.6, 0.9])
PLANTS = {
    "Bouc-Wen": (
        BoucWen(dt=DT),
        BoucWenOperator(0.5, 1.0, 0.6, 0.7, intercept=0.1),
    ),
    "Prandtl-Ishlinskii": (
        PrandtlIshlinskii(4, thresholds=THRESHOLDS, dt=DT),
        PrandtlIshlinskiiOperator(THRESHOLDS, np.array([1.0, 0.4, 0.3, 0.2]), 0.1),
    ),
    "transfer function": (
        TransferFunction(2, n_zeros=1, dt=DT),
        TransferFunctionOperator(
            np.empty(0), np.array([30.0]), np.array([0.3]), np.array([0.3]), 1.3, 0.2
        ),
    ),
}


def multisine(rng, n):
    """Return twelve sines of one to sixty periods in the record."""
    periods = rng.permutation(np.arange(1, 61))[:12]
    phases = rng.uniform(0.0, 2.0 * np.pi, (12, 1))
    return 0.25 * np.sin(2.0 * np.pi * np.outer(periods, np.arange(n) / n) + phases).sum(axis=0)


def polynomial(u):
    """Return the free run of ``narmax_structure.QUADRATIC`` from zero."""
    y, u = np.zeros(len(u) + 2), np.append([0.0, 0.0], u)
    c = QUADRATIC
    for k in range(2, len(y)):
        y[k] = c["y1"] * y[k - 1] + c["y2"] * y[k - 2] + c["u2"] * u[k - 2]
        y[k] += c["y1 u1"] * y[k - 1] * u[k - 1] + c["u1 u1"] * u[k - 1] ** 2
    return y[2:]


def read(clean, rng, noise):
    """Return a response with noise on it."""
    return clean + LEVEL * np.ptp(clean) * draw_noise(rng, len(clean), **NOISES[noise])


def errors(name, noise, n, seed):
    """Return the names of the parameters, errors over the standard errors, and over the white.

    Last comes whether the parameters are those of the plant, and no others.
    """
    rng = np.random.default_rng(seed)
    if name == "NARMAX, simulation":
        u = rng.uniform(-1.0, 1.0, n)
        options = {"objective": "simulation", "initial_output": 0.0}
        model = NARMAXRegressor(2, input_lags=(1, 2), output_lags=(1, 2), **options)
        table = model.fit(u[:, None], read(polynomial(u), rng, noise)).terms_
        names, truth = list(table["term"]), spelled(QUADRATIC)
        values, std, white = model.coef_, model.coef_std_, model.coef_std_white_
    else:
        model, plant = PLANTS[name]
        u = multisine(rng, n)
        model.fit(u[:, None], read(plant.run(u, DT)[0], rng, noise))
        names = list(model.params_)
        truth = dict(zip((key for key, _ in plant.entries()), plant.pack(), strict=True))
        values, std, white = (
            np.array(list(own.values()))
            for own in (model.params_, model.params_std_, model.params_std_white_)
        )
    found = [i for i, key in enumerate(names) if key in truth]
    names = [names[i] for i in found]
    missed = np.abs(values[found] - [truth[key] for key in names])
    exact = len(names) == len(values) and (name in PLANTS or len(names) == len(truth))
    return names, missed / std[found], missed / white[found], exact


def coverage(name, noise, n, seeds):
    """Return whether intervals hold, by parameter; how often with the errors of white noise.

    Last comes how often the parameters are just those of the plant.
    """
    inside, white, exact = {}, [], []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ShortRecordWarning)
        for seed in seeds:
            names, own, plain, right = errors(name, noise, n, seed)
            exact.append(right)
            for key, value in zip(names, own, strict=True):
                inside.setdefault(key, []).append(value < 1.96)
            white += list(plain < 1.96)
    return inside, np.mean(white), np.mean(exact)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--samples", type=int, default=2000)
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    begin = time.perf_counter()
    for name in (*PLANTS, "NARMAX, simulation"):
        for noise in NOISES:
            inside, white, exact = coverage(name, noise, options.samples, seeds)
            rate = np.mean(np.concatenate(list(inside.values())))
            often = {key: own for key, own in inside.items() if 2 * len(own) > len(seeds)}
            least = min(often, key=lambda key, often=often: np.mean(often[key]))
            verdict = "kept" if BAR[0] <= rate <= BAR[1] else "MISSED"
            terms = "" if name in PLANTS else f"; no other terms in {100 * exact:.0f} %"
            print(
                f"{name:20s}{noise:10s}{100 * rate:6.1f} % (bar {100 * BAR[0]:.0f} to "
                f"{100 * BAR[1]:.0f} %: {verdict}), least {100 * np.mean(often[least]):3.0f} % of "
                f"{least}; as if white {100 * white:5.1f} %{terms}",
                flush=True,
            )
    print(f"{time.perf_counter() - begin:.0f} s")


if __name__ == "__main__":
    main()
