"""Feed models sample by sample: how far that is from their free run, and the time it takes.

Run from the root of the project::

    python benchmarks/bench_stepping.py [--samples 200000] [--repeats 7]

First every model and composition, fitted briefly: the largest difference from `predict` on another
drive, in parts of the range, of steps one by one, of a run, and of what follows when the state is
put back to where it was in between. Then times: each line is the least of the
repetitions, with its limit where there is one. C is left out where there is no compiler.
"""

import argparse
import shutil
import subprocess
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
from sklearn.ensemble import GradientBoostingRegressor, HistGradientBoostingRegressor
from sklearn.linear_model import Ridge
from sklearn.neighbors import KNeighborsRegressor
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures, StandardScaler

from skhyst.autoregressive import NARMAXRegressor, NARXRegressor
from skhyst.compose import Cascade, Corrected, Modulated, OnColumn, ScheduledParameters, Sum
from skhyst.discovery import all_estimators
from skhyst.disturbance import Drift
from skhyst.export import to_c
from skhyst.hysteresis import (
    BoucWenOperator,
    LuGreOperator,
    PrandtlIshlinskii,
    PrandtlIshlinskiiOperator,
)
from skhyst.linear import FirstOrderLag, KelvinVoigt, SecondOrderMode, SecondOrderModeOperator
from skhyst.neural import SCNRegressor
from skhyst.operators import Series, Stepper, inverse_of
from skhyst.optimize import VariableProjection
from skhyst.preprocessing import LaggedFeatures, PlayOperators
from skhyst.records import stack_records

DT = 1e-4  # s
AGREE = 1e-12  # of the range
CALL_LIMIT, LOOP_LIMIT, C_LIMIT = 3.0, 100.0, 100.0  # us; ns; ns, of 20 plays
PLAYS = PrandtlIshlinskiiOperator(np.linspace(0.0, 3.8, 20), np.full(20, 0.1))
MODE = SecondOrderModeOperator(2.0 * np.pi * 400.0, 0.02)
OPERATORS = {
    "20 plays": PLAYS,
    "20 plays and a mode": Series(("plays", "mode"), (PLAYS, MODE)),
    "Bouc-Wen": BoucWenOperator(0.4, 0.7, 0.31, 0.6, 1.0, 0.0, 0.1),
    "LuGre friction": LuGreOperator(0.11, 2.3, 0.6, 0.8, 0.03, 0.3, 0.02, 0.1),
}
LOOP = """
#include <stdio.h>
#include <time.h>
#include "device.h"
int main(void)
{
    static device_state state;
    static double u[%(n)d];
    double sum = 0.0, best = 1e9;
    for (long k = 0; k < %(n)d; k++) {
        u[k] = 4.0 * (double)((k * 2654435761UL) %% 1000003UL) / 1000003.0;
    }
    for (int r = 0; r < %(repeats)d; r++) {
        device_init(&state);
        clock_t begin = clock();
        for (long k = 0; k < %(n)d; k++) {
            sum += device_step(&state, u[k]);
        }
        double seconds = (double)(clock() - begin) / CLOCKS_PER_SEC;
        best = seconds < best ? seconds : best;
    }
    printf("%%g %%g\\n", 1e9 * best / %(n)d, sum);
    return 0;
}
"""


def compositions():
    """Return models that are made of others, or need something said, by what they are."""
    plays, lag, mode = PrandtlIshlinskii(8), FirstOrderLag(), SecondOrderMode()
    chain = Cascade([("plays", plays), ("creep", KelvinVoigt(1)), ("mode", mode)])
    lags = {"input_lags": (0, 1, 2), "output_lags": (1, 2)}
    layers = make_pipeline(
        StandardScaler(), MLPRegressor(hidden_layer_sizes=(8, 6), max_iter=60, random_state=0)
    )
    scn = SCNRegressor(20, random_state=0)
    return {
        "Cascade of plays, creep and a mode": chain,
        "Sum of plays, a lag of a column, and drift": Sum(
            [("plays", plays), ("load", OnColumn(lag, 1)), ("drift", Drift(2))]
        ),
        "Modulated cascade": Modulated(chain, 1),
        "ScheduledParameters of a cascade": ScheduledParameters(chain, by=1),
        "NARX, polynomial": NARXRegressor(make_pipeline(PolynomialFeatures(2), Ridge()), **lags),
        "NARX, layers": NARXRegressor(layers, **lags),
        "NARX, trees": NARXRegressor(GradientBoostingRegressor(n_estimators=20), **lags),
        "NARX, histograms": NARXRegressor(HistGradientBoostingRegressor(max_iter=20), **lags),
        "NARX, SCN": NARXRegressor(scn, **lags),
        "NARX, SCN of Gaussian nodes": NARXRegressor(
            SCNRegressor(20, activation="rbf", random_state=0), **lags
        ),
        "NARX, neighbours": NARXRegressor(KNeighborsRegressor(), **lags),
        "NARMAX of features": NARMAXRegressor(
            2, features=["play", "generalized_gradient", "rate_sign"], n_terms=8
        ),
        "Corrected SCN": Corrected(scn, mode, max_iter=0),
        "Corrected NARX": Corrected(NARXRegressor(), mode, max_iter=0),
        "Corrected lags of plays": Corrected(
            make_pipeline(PlayOperators(5), LaggedFeatures({0: 2}), Ridge()), lag, max_iter=0
        ),
        "Corrected neighbours, by a column": Corrected(
            KNeighborsRegressor(), Modulated(lag, 1), max_iter=0
        ),
    }


def every_model():
    """Return all models by name."""
    found = {}
    for name, kind in all_estimators():
        if hasattr(kind, "stepper") and name != "InverseCompensator":  # that is of a reference
            try:
                found[name] = kind()
            except TypeError:  # it is made of others: a composition
                continue
    return found | compositions()


def recording(n_samples, rng):
    """Return a drive and a load that is constant, (n_samples, 2), and the response of a stage."""
    time = DT * np.arange(n_samples)
    frequencies = np.geomspace(3.0, 300.0, 7)
    phases = 2.0 * np.pi * np.outer(time, frequencies) + rng.uniform(0.0, 6.28, 7)
    u = np.sin(phases) @ frequencies**-0.3
    load = rng.uniform(0.5, 1.5)
    y, _ = Series(("plays", "mode"), (PLAYS, MODE)).run(u, DT)
    return np.column_stack([u, np.full(n_samples, load)]), y * (1.0 + 0.1 * load)


def difference(model, X, whole):
    """Return how far steps, runs and what follows a state that was put back are from a run."""
    options = {"schedule": X[0, 1]} if isinstance(model, ScheduledParameters) else {}
    stepper = model.stepper(u0=X[0], **options)
    u = X[:, 0] if stepper.compiled_step.n_inputs is None else X
    middle = len(u) // 2
    steps = [stepper.step(row) for row in u[:middle]]
    kept = stepper.state
    steps += [stepper.step(row) for row in u[middle:]]
    stepper.state = kept
    back, fresh = stepper.run(u[middle:]), model.stepper(u0=X[0], **options)
    span = np.ptp([0.0, *whole]) or 1.0
    parts = (np.array(steps) - whole, back - whole[middle:], fresh.run(u) - whole)
    return max(np.abs(part).max() for part in parts) / span


def agreement(n_samples=1000):
    """Print the difference of every model, and the largest of all."""
    rng, largest = np.random.default_rng(0), 0.0
    records = [recording(300, rng) for _ in range(3)]
    X, y = stack_records(records, dt=DT)
    test, _ = stack_records([recording(n_samples, rng)], dt=DT)
    for name, model in every_model().items():
        for option, value in (("method", VariableProjection(max_evaluations=3)), ("dt", DT)):
            if option in model.get_params(deep=False):
                model.set_params(**{option: value})
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that three evaluations do not identify a model
            model.fit(X, y)
            whole = model.predict(test)
        try:
            found = difference(model, test.to_numpy(), whole)
        except NotImplementedError as error:
            print(f"{name}: {error}", flush=True)
            continue
        largest = max(largest, found)
        print(f"{name}: {found:.1e} of the range{verdict(found, AGREE)}", flush=True)
    print(f"the largest of all: {largest:.1e} of the range{verdict(largest, AGREE)}", flush=True)


def verdict(value, limit):
    """Return a limit, and whether it was kept."""
    return f" (at most {limit:g}: {'kept' if value <= limit else 'MISSED'})"


def least(work, repeats):
    """Return the shortest time that some work took, in s."""
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return min(times)


def in_c(operator, samples, repeats):
    """Return ns a sample of the C program, None without a compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        to_c(operator, folder, "device", dt=DT)
        main, program = Path(folder, "main.c"), Path(folder, "main")
        main.write_text(LOOP % {"n": samples, "repeats": repeats})
        sources = [str(Path(folder, "device.c")), str(main)]
        subprocess.run(
            [compiler, "-std=c99", "-O2", "-o", str(program), *sources, "-lm"], check=True
        )
        found = subprocess.run([str(program)], check=True, capture_output=True, text=True)
    return float(found.stdout.split()[0])


def formatted(value, unit, limit=None):
    """Format a time and its limit."""
    if value is None:
        return "no compiler"
    return f"{value:.2f} {unit}{verdict(value, limit) if limit else ''}"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=200_000)
    parser.add_argument("--repeats", type=int, default=7)
    options = parser.parse_args()
    agreement()
    u = 4.0 * np.random.default_rng(0).uniform(size=options.samples)
    few = u[:20_000].tolist()
    for name, operator in OPERATORS.items():
        stepper = Stepper(operator.compiled_step(DT, operator.init(0.0)))
        stepper.run(u[:10]), stepper.step(0.0)  # compiles
        call = least(lambda s=stepper: [s.step(value) for value in few], options.repeats)
        loop = least(lambda s=stepper: s.run(u), options.repeats)
        limits = (CALL_LIMIT, LOOP_LIMIT, C_LIMIT) if name == "20 plays" else (None,) * 3
        parts = [
            "a call " + formatted(1e6 * call / len(few), "us", limits[0]),
            "a sample " + formatted(1e9 * loop / len(u), "ns", limits[1]),
            "in C " + formatted(in_c(operator, options.samples, options.repeats), "ns", limits[2]),
        ]
        y, _ = operator.run(u[:20_000], DT)
        inverse = inverse_of(operator)
        inverse.run(y[:10], DT)
        seconds = least(lambda i=inverse, r=y: i.run(r, DT), options.repeats)
        parts.append(f"inverse {formatted(1e9 * seconds / len(y), 'ns')} a sample")
        print(f"{name}: " + ", ".join(parts), flush=True)


if __name__ == "__main__":
    main()
