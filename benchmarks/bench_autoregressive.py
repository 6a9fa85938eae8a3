"""Free runs of autoregressive models: ``python benchmarks/bench_autoregressive.py``.

Prints the time a sample of `predict`, validation included, its limit, and how far the result
is from calling the regressor row by row. `fastcan` and `sysidentpy` run the same polynomial where
they are installed (`pip install fastcan sysidentpy`; skhyst does not need them). Best of several
runs in one thread, in processor time, after compilation; `sysidentpy` 0.9 needs NumPy below 2.4.
"""

import argparse
import time

import numpy as np
from sklearn.ensemble import RandomForestRegressor
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, WhiteKernel
from sklearn.linear_model import LinearRegression
from sklearn.neighbors import KNeighborsRegressor
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures
from sklearn.svm import SVR
from threadpoolctl import threadpool_limits

from skhyst.autoregressive import NARXRegressor
from skhyst.autoregressive._runs import Start
from skhyst.records import stack_records

LAGS = {"input_lags": (1, 2), "output_lags": (1, 2), "initial_output": "measured"}


def recording(n_samples, seed=0):
    """Return drive (n, 1) and response of a stable nonlinear recursion of second order."""
    rng = np.random.default_rng(seed)
    time_steps = np.arange(n_samples)
    u = np.sin(np.outer(time_steps, [0.003, 0.019, 0.071]) + rng.uniform(0, 6, 3)).sum(axis=1) / 3.0
    noise = 1e-3 * rng.standard_normal(n_samples)
    y = np.zeros(n_samples)
    for k in range(2, n_samples):
        y[k] = 1.2 * y[k - 1] - 0.4 * y[k - 2] + 0.15 * u[k - 1] + 0.05 * u[k - 2]
        y[k] += 0.04 * y[k - 1] * u[k - 1] - 0.03 * y[k - 1] ** 2 + noise[k]
    return u[:, None], y


def seconds(call, repeats):
    """Return the shortest processor time of a call, after one to warm up."""
    call()
    best = np.inf
    for _ in range(repeats):
        start = time.process_time()
        call()
        best = min(best, time.process_time() - start)
    return best


def row_by_row(estimator, u, y, n_samples):
    """Return the free run from two measured samples, and its processor time a sample."""
    run = list(y[:2])
    start = time.process_time()
    for k in range(2, n_samples):
        row = np.array([[u[k - 1, 0], u[k - 2, 0], run[-1], run[-2]]])
        run.append(float(estimator.predict(row)[0]))
    return np.array(run), (time.process_time() - start) / (n_samples - 2)


def distance(run, other):
    """Return the largest difference in parts of the largest value."""
    return np.abs(run - other).max() / np.abs(other).max()


def line(name, value, limit, note=""):
    print(f"  {name:<44}{value:>12}{limit:>14}  {note}")


def fastcan_run(model, u, y):
    """Return a call that runs the polynomial in fastcan, or None."""
    try:
        from fastcan.narx import NARX
    except ImportError:
        return None
    features, linear = model.estimator_.named_steps.values()
    ids, delays = [], []
    for powers in features.powers_[1:]:
        factors = np.repeat([0, 0, 1, 1], powers), np.repeat([1, 2, 1, 2], powers)
        missing = 2 - powers.sum()
        ids.append([-1] * missing + list(factors[0]))
        delays.append([-1] * missing + list(factors[1]))
    narx = NARX(feat_ids=np.array(ids), delay_ids=np.array(delays)).fit(u[:200], y[:200])
    narx.coef_, narx.intercept_ = linear.coef_[1:], np.array([linear.intercept_])
    return lambda: np.ravel(narx.predict(u, y_init=y[:2]))


def sysidentpy_run(model, u, y):
    """Return a call that runs the polynomial in sysidentpy, or None."""
    try:
        from sysidentpy.basis_function import Polynomial
        from sysidentpy.simulation import SimulateNARMAX
    except ImportError:
        return None
    features, linear = model.estimator_.named_steps.values()
    codes = [
        np.append(
            np.repeat([2002, 2001, 1002, 1001], powers[[1, 0, 3, 2]]), [0] * (2 - powers.sum())
        ).astype(int)
        for powers in features.powers_
    ]
    order = sorted(range(len(codes)), key=lambda t: tuple(codes[t][::-1]))
    coefficients = linear.coef_ + np.append(linear.intercept_, np.zeros(len(codes) - 1))

    def run():
        simulation = SimulateNARMAX(basis_function=Polynomial(degree=2), estimate_parameter=False)
        return simulation.simulate(
            X_test=u,
            y_test=y[:, None],
            model_code=np.array([codes[t] for t in order]),
            theta=coefficients[order][:, None],
        )[:, 0]

    return run


def polynomial(n_samples, repeats):
    print(f"polynomial NARX, 15 terms, {n_samples} samples in one record")
    u, y = recording(n_samples)
    few = min(n_samples, 20_000)
    regressor = make_pipeline(PolynomialFeatures(2), LinearRegression())
    model = NARXRegressor(regressor, **LAGS).fit(u[:few], y[:few])
    own = seconds(lambda: model.predict(u, y), repeats) / n_samples
    expected, naive = row_by_row(model.estimator_, u, y, min(n_samples, 1000))
    run = model.predict(u, y)
    off = distance(run[: len(expected)], expected)
    start = Start(u, 2, y[:2])
    loop = seconds(lambda: model._step.run(start, model.bound_), 3 * repeats) / n_samples
    line("free run", f"{loop * 1e9:.1f} ns", "20 ns", f"off row by row: {off:.1e}")
    line("NARXRegressor.predict: read, check, run", f"{own * 1e9:.1f} ns", "")
    line("row by row", f"{naive * 1e6:.0f} us", "", f"{naive / own:.0f} times")
    for name, make in (("fastcan", fastcan_run), ("sysidentpy", sysidentpy_run)):
        other = make(model, u, y)
        if other is None:
            line(name, "absent", "")
            continue
        try:
            its = seconds(other, 1) / n_samples
        except AttributeError as error:  # an older library with a newer NumPy
            line(name, "fails", "", str(error))
            continue
        off = distance(run, other())
        line(name, f"{its * 1e9:.0f} ns", "", f"{its / own:.0f} times (100), off {off:.1e} (1e-9)")


def compiled(n_samples, repeats):
    print(f"compiled regressors, fitted to 10000 samples, {n_samples} samples in one record")
    u, y = recording(10_000)
    drive, start = recording(n_samples, seed=1)
    for name, estimator, limit, n_naive in (
        ("linear", None, "", 300),
        ("MLPRegressor (32, 32), relu", mlp("relu"), "0.4 us", 300),
        ("MLPRegressor (32, 32), tanh", mlp("tanh"), "", 300),
        ("random forest, 100 trees", RandomForestRegressor(100, random_state=0), "30 us", 60),
    ):
        model = NARXRegressor(estimator, **LAGS).fit(u, y)
        own = seconds(lambda m=model: m.predict(drive, start), repeats) / n_samples
        expected, naive = row_by_row(model.estimator_, drive, start, n_naive)
        off = distance(model.predict(drive, start)[:n_naive], expected)
        note = f"row by row {naive * 1e6:.0f} us, off {off:.1e} (1e-9)"
        line(name, f"{own * 1e6:.3f} us", limit, note)


def mlp(activation):
    return MLPRegressor(hidden_layer_sizes=(32, 32), activation=activation, random_state=0)


def lock_step(n_records=64, n_samples=60):
    print(f"other regressors in lock-step, {n_records} records of {n_samples} samples")
    u, y = recording(300)
    parts = [recording(n_samples, seed=seed) for seed in range(n_records)]
    X, measured = stack_records(parts)
    for name, estimator in (
        ("KNeighborsRegressor", KNeighborsRegressor()),
        ("SVR", SVR(C=10.0, epsilon=0.01)),
        ("GaussianProcessRegressor", GaussianProcessRegressor(RBF() + WhiteKernel(1e-4))),
    ):
        frame, response = stack_records([(u, y)])
        model = NARXRegressor(estimator, **LAGS).fit(frame, response)
        own = seconds(lambda m=model: m.predict(X, measured), 2) / len(X)
        expected, naive = row_by_row(model.estimator_, *parts[0], n_samples)
        off = distance(model.predict(X, measured)[:n_samples], expected)
        note = f"row by row {naive * 1e6:.0f} us: {naive / own:.0f} times (30), off {off:.1e}"
        line(name, f"{own * 1e6:.1f} us", "", note)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--samples", type=int, default=100_000)
    parser.add_argument("--repeats", type=int, default=7)
    arguments = parser.parse_args()
    with threadpool_limits(1):
        polynomial(arguments.samples, arguments.repeats)
        compiled(max(arguments.samples // 5, 1000), arguments.repeats)
        lock_step()


if __name__ == "__main__":
    main()
