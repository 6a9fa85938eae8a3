"""Measured recordings that end unexplained: what a term without a name adds, and black boxes.

    python benchmarks/unknown_on_recordings.py [--only NAMES] [--samples N] [--data FOLDER]

Each recording is searched from the model that `measured_recordings.py` declares, with all effects,
and then a term is sought. Printed are the errors on what is held out: of the declared model, after
the effects, with the term; and those of black boxes that were fitted to the same samples and run
freely: a polynomial NARX of degree 3 (`fastcan`, where it is installed) and a NARX of a stochastic
configuration network, each with 5 lags of both signals, and such a network on plays of the drive,
which knows no response. Black boxes of recordings whose records
differ in more than the drive see all columns of X. A long recording is cut to its first N samples
(printed); what is held out is whole.
"""

import argparse
import contextlib
import time
import warnings
from pathlib import Path

import numpy as np
from measured_recordings import CASES, Case
from recordings import SHARED, load_wiener_hammerstein
from sklearn.pipeline import make_pipeline

from skhyst.autoregressive import NARXRegressor
from skhyst.linear import TransferFunction
from skhyst.neural import SCNRegressor
from skhyst.preprocessing import PlayOperators
from skhyst.records import iter_records, stack_records

LAGS = 5
RATE = 51.2e3  # Hz, of the Wiener-Hammerstein circuit


def wiener_hammerstein(data):
    """Return X, y to search and X, y held out."""
    return *load_wiener_hammerstein("train", data), *load_wiener_hammerstein("test", data)


OWN = {
    "wiener_hammerstein": Case(
        wiener_hammerstein,
        lambda: TransferFunction(6, dt=1.0 / RATE),
        (("static_nonlinearity",),),
        "mV",
        scale=1e3,
        reference="best linear 56 mV, by hand 0.26 mV",
        lead=50,
    ),
}
NAMES = ["silverbox", "wiener_hammerstein", "emps", "mr_damper", "friction_damper", "piezo_fsm"]


def cut(X, y, n):
    """Return the first samples of one record, or the first of each of several."""
    if getattr(getattr(X, "index", None), "nlevels", 1) == 1:
        return X[:n], y[:n]
    parts = list(iter_records(X, y))
    most = max(n // len(parts), 1)
    found = {name: (a[:most], b[:most]) for name, a, b in parts}
    return stack_records(
        {k: (a.droplevel("record"), b.droplevel("record")) for k, (a, b) in found.items()}
    )


def black_boxes():
    """Yield name and unfitted black box."""
    lags = {"input_lags": list(range(LAGS + 1)), "output_lags": list(range(1, LAGS + 1))}
    network = SCNRegressor(max_nodes=60, random_state=0)
    yield "SCN NARX", NARXRegressor(network, **lags)
    yield "SCN of plays", make_pipeline(PlayOperators(), network)
    try:
        from fastcan.narx import make_narx
    except ImportError:
        print("  fastcan is not installed")
        return
    yield "fastcan NARX", Polynomial(make_narx)


class Polynomial:
    """A polynomial NARX of fastcan, of one input and one record after another."""

    def __init__(self, make):
        self._make = make

    def fit(self, X, y):
        """Select 30 terms up to degree 3 and fit them."""
        parts = [(np.asarray(a), np.asarray(b).ravel()) for _, a, b in iter_records(X, y)]
        sizes = [len(b) for _, b in parts]
        X, y = (np.concatenate(own) for own in zip(*parts, strict=True))
        self._lead = sizes
        own = {"max_delay": LAGS, "poly_degree": 3, "random_state": 0, "refine_verbose": 0}
        own |= {"session_sizes": sizes} if len(sizes) > 1 else {}
        self._narx = self._make(X, y[:, None], 30, **own)
        self._narx.fit(X, y[:, None], **({"session_sizes": sizes} if len(sizes) > 1 else {}))
        return self

    def predict(self, X):
        """Run freely from zero."""
        parts = [np.asarray(a) for _, a, _ in iter_records(X, np.zeros(len(X)))]
        return np.concatenate([self._narx.predict(part).ravel() for part in parts])


def error_of(prediction, y, X, lead):
    """Return the root mean square error of all records behind their first samples."""
    left = np.asarray(y, dtype=float).ravel() - np.asarray(prediction, dtype=float).ravel()
    parts = [part for _, _, part in iter_records(X, left)]
    left = np.concatenate([np.asarray(part).ravel()[lead or 0 :] for part in parts])
    return float(np.sqrt(np.mean(np.square(left)))) if np.isfinite(left).all() else np.inf


def study(name, case, data, n):
    """Print what is found of one recording."""
    X, y, X_test, y_test = case.load(data)
    whole = len(X)
    if whole > n:
        X, y = cut(X, y, n)
    begin = time.process_time()
    search = case.search(n_jobs=1, unknown=True).fit(X, y)
    seconds = time.process_time() - begin
    lead = case.lead or case.washout or LAGS
    models = [search.declared_estimator_, search.best_estimator_]
    print(f"{name}: {len(X)} of {whole} samples, {seconds:.0f} s of processor")
    print(f"  effects: {', '.join(search.effects_) or 'none'}; {search.verdict_}")
    found = search.unknown_
    print(f"  term: {found}")
    while found is not None:
        models.append(found.estimator)
        found = found.second
    errors = [error_of(model.predict(X_test), y_test, X_test, lead) for model in models]
    print("  declared, after, with the term (and the second): ", end="")
    print(", ".join(f"{case.scale * e:.4g}" for e in errors), case.unit, flush=True)
    term = search.seconds_.get("unknown term", 0.0)
    before = sum(search.seconds_.values()) - term
    print(f"  the term took {term / max(before, 1e-9):.2f} times the search before it")
    for label, box in black_boxes():
        try:
            with contextlib.redirect_stdout(None):
                run = box.fit(X, y).predict(X_test)
            e = error_of(run, y_test, X_test, lead)
            print(f"  {label}: {case.scale * e:.4g} {case.unit}", flush=True)
        except Exception as error:  # a box that fails is no reason to lose the others
            print(f"  {label}: failed, {type(error).__name__}: {error}", flush=True)


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help=f"of {', '.join(NAMES)}, by commas")
    parser.add_argument("--samples", type=int, default=8192, help="of a recording, at most")
    parser.add_argument("--data", type=Path, default=SHARED)
    options = parser.parse_args(argv)
    warnings.simplefilter("ignore")
    for name in [own for own in options.only.split(",") if own] or NAMES:
        try:
            study(name, {**CASES, **OWN}[name], options.data, options.samples)
        except Exception as error:  # one recording does not keep the others from the table
            print(f"{name}: failed, {type(error).__name__}: {error}", flush=True)


if __name__ == "__main__":
    main()
