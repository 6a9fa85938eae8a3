"""Learning models on measured benchmarks: `python benchmarks/learning_on_recordings.py`.

Prints the error of the free run on test records and published figures. The recordings are not
part of the project; their folder lies next to the checkout or is named by --data.

Orders and sizes are chosen on held-out samples of the estimation data, and the model is then fitted
to all that the choice has seen, before the script looks at a test record. Where several networks or
structures do about as well as each other, the mean of their free runs is the prediction; its
held-out error is printed too for the tanks. A free run begins

- silverbox and tanks: after as many measured samples as the longest output lag, not counted in the
  error, since both records begin in an unknown state;
- Bouc-Wen multisine: one period ahead of the period that is measured, which is in steady state;
- Bouc-Wen sweep: at rest.

Limits: silverbox multisine at most 4 mV, Bouc-Wen multisine at most 5e-5 m.
"""

import argparse
import time
import warnings
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
from joblib import Parallel, delayed
from recordings import (
    SHARED,
    load_bouc_wen_benchmark,
    load_cascaded_tanks,
    load_silverbox,
)
from sklearn.base import clone
from sklearn.compose import TransformedTargetRegressor
from sklearn.exceptions import ConvergenceWarning as NetworkWarning
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skhyst.autoregressive import NARMAXRegressor, NARXRegressor
from skhyst.exceptions import ConvergenceWarning, DivergenceWarning

SILVERBOX_ROWS = 20_000  # of the estimation data, for the sake of time
SILVERBOX_CANDIDATES = [(2, 12), (2, 56), (3, 12), (3, 20)]  # lags, terms
BOUC_WEN_PERIOD = 8192
BOUC_WEN_CANDIDATES = [(10, 30), (15, 30), (15, 60), (15, 100)]  # lags, nodes
N_NETWORKS = 4
TANKS_CANDIDATES = list(product((2, 3), (2, 3), (5, 7, 9, 12)))  # degree, lags, terms
TANKS_FOLDS = 4
N_STRUCTURES = 5


def rmse(error):
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(error))))


def quietly(function, *arguments):
    """Return the result: candidates may diverge, and networks stop at their last iteration."""
    with warnings.catch_warnings():
        for category in (ConvergenceWarning, DivergenceWarning, NetworkWarning):
            warnings.simplefilter("ignore", category)
        return function(*arguments)


def fitted(model, X, y):
    """Return a fitted clone."""
    return quietly(clone(model).fit, X, y)


def free_run_error(models, X, y):
    """Return the RMSE of the mean of the free runs behind the first measured samples."""
    runs = [np.asarray(quietly(model.predict, X, y)) for model in models]
    known = max(max(model.output_lags_) for model in models)
    return rmse((np.mean(runs, axis=0) - np.asarray(y))[known:])


def held_out_error(models, X, y, folds):
    """Return the RMSE over folds, pairs of boolean masks of what is fitted and what is left out."""
    return rmse(
        [
            free_run_error([fitted(model, X[fit], y[fit]) for model in models], X[out], y[out])
            for fit, out in folds
        ]
    )


def ranked(candidates, make, X, y, folds, jobs):
    """Return the candidates and their held-out errors, best first."""
    errors = Parallel(jobs)(
        delayed(held_out_error)([make(*values)], X, y, folds) for values in candidates
    )
    order = np.argsort(errors)
    return [candidates[i] for i in order], [errors[i] for i in order]


def last_part(n_samples, part):
    """Return the one fold that leaves out the last part of the samples."""
    out = np.arange(n_samples) >= (1.0 - part) * n_samples
    return [(~out, out)]


def polynomial(degree, lags, n_terms, first_lag=0):
    """Return a polynomial whose terms and coefficients are those of the best free run."""
    return NARMAXRegressor(
        degree,
        input_lags=range(first_lag, lags + 1),
        output_lags=lags,
        n_terms=n_terms,
        objective="simulation",
        initial_output="measured",
    )


def silverbox(data, jobs):
    """Yield rows: nine tenths of the multisines are for the fit, the last one for the test."""
    start = time.perf_counter()
    X, y = load_silverbox("multisine", data)
    cut = int(0.9 * len(X))
    X_test, y_test = X[cut:], y[cut:]
    X_fit, y_fit = X[:SILVERBOX_ROWS], y[:SILVERBOX_ROWS]
    (best, *_), (held_out, *_) = ranked(
        SILVERBOX_CANDIDATES,
        lambda lags, n_terms: polynomial(3, lags, n_terms),
        X_fit,
        y_fit,
        last_part(len(X_fit), 0.3),
        jobs,
    )
    model = fitted(polynomial(3, *best), X_fit, y_fit)
    seconds = time.perf_counter() - start
    name = f"NARMAX, cubic, {best[0]} lags, {best[1]} terms"
    for part, published, limit in (
        ("multisine", "NARX 7.7 mV, best < 1 mV", "4 mV"),
        ("arrow", "NARX 4.1 mV, best < 1 mV", "-"),
    ):
        if part == "arrow":
            X_test, y_test = load_silverbox("arrow", data)
        error = 1e3 * free_run_error([model], X_test, y_test)
        yield {
            "recording": "silverbox",
            "test set": part,
            "model": name,
            "held out": f"{1e3 * held_out:.3f} mV",
            "free-run RMSE": f"{error:.3f} mV",
            "published": published,
            "limit": limit,
            "seconds": seconds,
        }


def network(lags, nodes, seed=0):
    """Return a NARX model around a network with one layer."""
    net = MLPRegressor(
        hidden_layer_sizes=(nodes,),
        activation="tanh",
        solver="lbfgs",
        alpha=1e-7,
        max_iter=1500,
        max_fun=10**6,
        tol=1e-9,
        random_state=seed,
    )
    scaled = TransformedTargetRegressor(
        make_pipeline(StandardScaler(), net), transformer=StandardScaler()
    )
    return NARXRegressor(
        scaled, input_lags=lags - 1, output_lags=lags, initial_output="measured", dt=1 / 750
    )


def bouc_wen_benchmark(data, jobs):
    """Yield rows: the mean of the steady periods is for the fit."""
    start = time.perf_counter()
    X, y = load_bouc_wen_benchmark(data=data)
    X = X[:BOUC_WEN_PERIOD]
    y = y.reshape(-1, BOUC_WEN_PERIOD)[1:].mean(axis=0)
    (best, *_), (held_out, *_) = ranked(
        BOUC_WEN_CANDIDATES, network, X, y, last_part(len(X), 0.25), jobs
    )
    models = Parallel(jobs)(
        delayed(fitted)(network(*best, seed), X, y) for seed in range(N_NETWORKS)
    )
    seconds = time.perf_counter() - start
    name = f"NARX, mean of {N_NETWORKS} networks, {best[0]} lags, {best[1]} nodes"
    for signal, published, limit in (
        ("multisine", "NFIR 16.3e-5, dynoNet 4.5e-5, PNLSS 1.87e-5", "5e-5 m"),
        ("sinesweep", "-", "-"),
    ):
        X_test, y_test = load_bouc_wen_benchmark("test", signal, data)
        led = np.concatenate([X_test, X_test]) if signal == "multisine" else X_test
        run = np.mean([model.predict(led)[-len(X_test) :] for model in models], axis=0)
        error = rmse(run - y_test)
        yield {
            "recording": "bouc_wen_benchmark",
            "test set": signal,
            "model": name,
            "held out": f"{1e5 * held_out:.2f}e-5 m",
            "free-run RMSE": f"{1e5 * error:.2f}e-5 m",
            "published": published,
            "limit": limit,
            "seconds": seconds,
        }


def cascaded_tanks(data, jobs):
    """Yield a row: structures are compared on fourths of the estimation record."""
    start = time.perf_counter()
    X, y = load_cascaded_tanks("train", data)
    blocks = np.arange(len(X)) * TANKS_FOLDS // len(X)
    index = pd.MultiIndex.from_arrays([blocks, 4.0 * np.arange(len(X))], names=["record", "time"])
    X, y = pd.DataFrame(X, index=index, columns=["u"]), pd.Series(y, index=index)
    folds = [(blocks != block, blocks == block) for block in range(TANKS_FOLDS)]
    order, held_out = ranked(TANKS_CANDIDATES, tank_polynomial, X, y, folds, jobs)
    models = [tank_polynomial(*values) for values in order[:N_STRUCTURES]]
    together = held_out_error(models, X, y, folds)
    X, y = load_cascaded_tanks("train", data)
    X_test, y_test = load_cascaded_tanks("test", data)
    models = [fitted(model, X, y) for model in models]
    seconds = time.perf_counter() - start
    for count, expected in ((1, held_out[0]), (N_STRUCTURES, together)):
        error = free_run_error(models[:count], X_test, y_test)
        name = f"NARMAX, mean of {count} structures"
        if count == 1:
            name = "NARMAX, degree {}, {} lags, {} terms".format(*order[0])
        yield {
            "recording": "cascaded_tanks",
            "test set": "uVal",
            "model": name,
            "held out": f"{expected:.3f} V",
            "free-run RMSE": f"{error:.3f} V",
            "published": "linear 0.757, PNLSS 0.450, NLSS2 0.343 V",
            "limit": "-",
            "seconds": seconds,
        }


def tank_polynomial(degree, lags, n_terms):
    """Return a polynomial in which the pump acts a sample later."""
    return polynomial(degree, lags, n_terms, first_lag=1)


def main():
    tasks = {task.__name__: task for task in (silverbox, bouc_wen_benchmark, cascaded_tanks)}
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=SHARED)
    parser.add_argument("--only", choices=list(tasks))
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()
    found = []
    for name, task in tasks.items():
        if options.only in (None, name):
            if (options.data / name).exists():
                found += list(task(options.data, options.jobs))
            else:
                print(f"{options.data / name} is absent.")
    if found:
        print(pd.DataFrame(found).to_string(index=False, float_format="%.1f"))


if __name__ == "__main__":
    main()
