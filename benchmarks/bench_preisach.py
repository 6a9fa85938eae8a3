"""Speed of the Preisach models: ``python benchmarks/bench_preisach.py``.

Prints the time a sample of ``Preisach.predict`` with 4,950 relay cells (validation included) for
several drives, that of ``KrasnoselskiiPokrovskii.predict`` for a few grids, and the time of fits.
A prediction of the Preisach model costs the same for any number of cells; the bar is 25 ns a sample
on sweeps and triangles. All times are the best of several runs in one thread. The classes are
benchmarks for asv as well.
"""

import time

import numpy as np

from skhyst.hysteresis import (
    KrasnoselskiiPokrovskii,
    KrasnoselskiiPokrovskiiOperator,
    Preisach,
    PreisachOperator,
)

BAR = 25.0  # ns a sample
REPEATS = 9


def signals(n_samples):
    """Return drives within -1 to 1."""
    ramp = np.arange(n_samples)
    rng = np.random.default_rng(0)
    return {
        "sweep": np.sin(np.linspace(0.0, 1000.0, n_samples) ** 2 / 10.0),
        "triangle": np.abs(ramp % 2000 - 1000) / 500.0 - 1.0,
        "sine": np.sin(ramp / 1000.0),
        "walk": np.sin(0.01 * np.cumsum(rng.standard_normal(n_samples))),
        "noise": np.clip(rng.standard_normal(n_samples) / 3.0, -1.0, 1.0),
    }


def device(n_levels):
    """Return an operator of a peaked density."""
    i, j = np.tril_indices(n_levels - 1)
    middle = np.linspace(-1.0, 1.0, n_levels - 1)
    density = np.exp(-4.0 * ((middle[i] - 0.2) ** 2 + (middle[j] + 0.2) ** 2))
    return PreisachOperator(
        np.linspace(-1.0, 1.0, n_levels), density / density.sum(), np.full(n_levels - 1, 0.01)
    )


def nanoseconds(call, n_samples, repeats=REPEATS):
    """Return the shortest processor time of a call, in ns a sample, after one warm-up."""
    call()
    shortest = np.inf
    for _ in range(repeats):
        start = time.thread_time()  # of this thread alone, whatever else runs on the machine
        call()
        shortest = min(shortest, time.thread_time() - start)
    return shortest / n_samples * 1e9


class Predict:
    """A million samples through the fitted estimator with 4,950 cells."""

    n_samples = 1_000_000
    params = tuple(signals(2))
    param_names = ("drive",)

    def setup(self, drive):
        """Make the drive, fit the estimator and give it the operator of 100 levels."""
        self.X = signals(self.n_samples)[drive].reshape(-1, 1)
        self.model = Preisach(4).fit(self.X[:5000], self.X[:5000, 0])
        self.model.operator_ = device(100)

    def time_predict(self, drive):
        """Predict one record."""
        self.model.predict(self.X)


class PredictRamps:
    """A hundred thousand samples through kernels with ramps."""

    n_samples = 100_000
    params = (10, 20, 40)
    param_names = ("n_levels",)

    def setup(self, n_levels):
        """Make the drive and the model."""
        self.X = signals(self.n_samples)["sweep"].reshape(-1, 1)
        self.model = KrasnoselskiiPokrovskii(4).fit(self.X[:5000], self.X[:5000, 0])
        relays = device(n_levels)
        self.model.operator_ = KrasnoselskiiPokrovskiiOperator(relays.levels, relays.weights)

    def time_predict(self, n_levels):
        """Predict one record."""
        self.model.predict(self.X)


class Fit:
    """Ten thousand samples of reversal curves with noise."""

    n_samples = 10_000
    params = (10, 20, 50, 100)
    param_names = ("n_levels",)

    def setup(self, n_levels):
        """Make the recording."""
        rng = np.random.default_rng(1)
        ends = np.r_[0.0, 1.0, -1.0, rng.uniform(-1.0, 1.0, 498)]
        drive = np.interp(np.linspace(0, 500, self.n_samples), np.arange(501), ends)
        self.X = drive.reshape(-1, 1)
        y, _ = device(60).run(drive, 1.0)
        self.y = y + 0.005 * np.ptp(y) * rng.standard_normal(self.n_samples)

    def time_fit(self, n_levels):
        """Fit one record."""
        self.model = Preisach(n_levels).fit(self.X, self.y)


def main():
    print(f"Preisach.predict, 4,950 cells, ns a sample (bar: {BAR:.0f} on sweep and triangle)")
    for drive in Predict.params:
        case = Predict()
        case.setup(drive)
        value = nanoseconds(lambda case=case: case.time_predict(None), case.n_samples)
        verdict = "" if drive not in ("sweep", "triangle") else f"  {value <= BAR}"
        print(f"  {drive:<10}{value:8.1f}{verdict}")
    print("KrasnoselskiiPokrovskii.predict, ns a sample")
    for n_levels in PredictRamps.params:
        case = PredictRamps()
        case.setup(n_levels)
        value = nanoseconds(lambda case=case: case.time_predict(None), case.n_samples, 3)
        print(f"  {n_levels * (n_levels - 1) // 2:>5} kernels{value:10.1f}")
    print("Preisach.fit, 10,000 samples")
    for n_levels in Fit.params:
        case = Fit()
        case.setup(n_levels)
        case.time_fit(n_levels)  # n_levels, warm
        start = time.perf_counter()
        case.time_fit(n_levels)
        seconds = time.perf_counter() - start
        cells = n_levels * (n_levels - 1) // 2
        print(f"  {cells:>5} cells{seconds:8.2f} s   RMS residual {case.model.fit_error_:.5f}")


if __name__ == "__main__":
    main()
