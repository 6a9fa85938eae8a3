"""Linear models on measured recordings: `python benchmarks/linear_models.py`.

Prints the error of the free run on test records and published figures of linear models. The
recordings are not part of the project; their folder is next to the checkout, or named by --data.

Limits: piezo_fsm at 100 mV at most 0.120 um, with at most 28 states, fitted in at most 60 s.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import pandas as pd
from recordings import SHARED, load_cascaded_tanks, load_piezo_fsm, load_silverbox

from skhyst.linear import ModalModel, TransferFunction, frequency_response
from skhyst.optimize._problem import path_of

FSM_PERIOD = 8192
FSM_PUBLISHED = {100: 0.114, 200: 0.555}  # um, linear model of 28 states fitted at 100 mV
TANKS_PUBLISHED = 0.757  # V
TRAIN_PART = 0.9


def rmse(error):
    """Return the root mean square over the samples of each column."""
    return np.sqrt(np.mean(np.square(error), axis=0))


def piezo_fsm(data):
    """Yield rows of the table: three piezo stacks, three displacements, one model."""
    X, Y = load_piezo_fsm(100, data=data)
    dt = X.index.get_level_values("time")[1]

    def test_errors(model, level):
        X_test, Y_test = load_piezo_fsm(level, "test", data=data)
        # the first period of each record is the lead-in into the steady state
        kept = np.arange(len(X_test)) % (2 * FSM_PERIOD) >= FSM_PERIOD
        return 1e6 * rmse((model.predict(X_test) - Y_test.to_numpy())[kept])

    start, processor = time.perf_counter(), time.process_time()
    model = ModalModel(28, transient_periods=0, dt=dt).fit(X, Y)
    wall, processor = time.perf_counter() - start, time.process_time() - processor
    for level, published in FSM_PUBLISHED.items():
        errors = test_errors(model, level)
        yield {
            "recording": f"piezo_fsm, {level} mV",
            "model": f"ModalModel, {model.n_states_} states",
            "error": f"{errors.mean():.4f} um ({', '.join(f'{e:.4f}' for e in errors)})",
            "published linear": f"{published} um",
            "fit": f"{wall:.1f} s wall, {processor:.1f} s processor",
        }
    start, parts = time.perf_counter(), []
    for column in Y:
        response = frequency_response(X, Y[column], method="periodic", transient_periods=0)
        tf = TransferFunction(9, n_zeros=9, inputs="all", dt=dt)
        tf.fit_frequency_response(response)
        X_test, Y_test = load_piezo_fsm(100, "test", data=data)
        kept = np.arange(len(X_test)) % (2 * FSM_PERIOD) >= FSM_PERIOD
        parts.append(1e6 * rmse((tf.predict(X_test) - Y_test[column].to_numpy())[kept]))
    yield {
        "recording": "piezo_fsm, 100 mV",
        "model": "three TransferFunction of 9 states",
        "error": f"{np.mean(parts):.4f} um ({', '.join(f'{e:.4f}' for e in parts)})",
        "published linear": f"{FSM_PUBLISHED[100]} um",
        "fit": f"{time.perf_counter() - start:.1f} s wall",
    }


def cascaded_tanks(data):
    """Yield a row: both records start from the same unknown state."""
    X, y = load_cascaded_tanks("train", data)
    X_test, y_test = load_cascaded_tanks("test", data)
    start = time.perf_counter()
    model = TransferFunction(2, dt=4.0, initial_state="estimate").fit(X, y)
    wall = time.perf_counter() - start
    # what the fit has found before its own record
    before = path_of(model.initial_drive_[0])[:, None]
    left = model.predict(np.concatenate([before, X_test]))[len(before) :] - y_test
    error, late = rmse(left), rmse(left[50:])
    yield {
        "recording": "cascaded_tanks",
        "model": f"TransferFunction, {model.n_states_} poles",
        "error": f"{error:.3f} V ({late:.3f} V from sample 50 on)",
        "published linear": f"{TANKS_PUBLISHED} V",
        "fit": f"{wall:.1f} s wall",
    }


def silverbox(data):
    """Yield rows: fitted on nine tenths of the multisines, tested on the last, and on the arrow."""
    X, y = load_silverbox("multisine", data)
    cut = int(TRAIN_PART * len(X))
    start = time.perf_counter()
    model = TransferFunction(2, n_zeros=None, dt=1.0 / 610.35).fit(X[:cut], y[:cut])
    wall = time.perf_counter() - start
    tests = {"multisine": (X[cut:], y[cut:]), "arrow": load_silverbox("arrow", data)}
    for name, (X_test, y_test) in tests.items():
        yield {
            "recording": f"silverbox, {name}",
            "model": f"TransferFunction, {model.n_states_} poles",
            "error": f"{1e3 * rmse(model.predict(X_test) - y_test):.2f} mV",
            "published linear": "-",
            "fit": f"{wall:.1f} s wall",
        }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=SHARED)
    parser.add_argument("--only", choices=["piezo_fsm", "cascaded_tanks", "silverbox"])
    options = parser.parse_args()
    found = []
    for task in (piezo_fsm, cascaded_tanks, silverbox):
        if options.only in (None, task.__name__):
            if (options.data / task.__name__).exists():
                found += list(task(options.data))
            else:
                print(f"{options.data / task.__name__} is absent.")
    print(pd.DataFrame(found).to_string(index=False))


if __name__ == "__main__":
    main()
