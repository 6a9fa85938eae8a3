"""Speed of the play kernels against this machine: ``python benchmarks/bench_kernels.py``.

Prints the write rate of the play basis and that of plain writes to the same array, the time a
sample of a Prandtl-Ishlinskii operator for few and many plays, the time of its linearisation, and
the time a sample and state of linear steps with 1 to 28 states, which should be at most 5 ns.
All numbers are the best of several interleaved runs in one thread. The classes are benchmarks for
asv as well.
"""

import time
from functools import partial

import numpy as np

from skhyst._jit import jit
from skhyst.hysteresis import PrandtlIshlinskii, PrandtlIshlinskiiOperator
from skhyst.linear import LogCreepOperator, TransferFunctionOperator
from skhyst.operators import play_basis, stop_basis

REPEATS = 9
LINEAR_LIMIT = 5.0  # ns a sample and state


@jit
def store_rows(values, out):
    """Write one row of constants to each row of ``out``: the plain form of the basis' loop."""
    for i in range(out.shape[0]):
        row = out[i]
        for k in range(values.size):
            row[k] = values[k]


def signals(n_samples):
    """Return the drives: white noise, a triangle, a sine whose frequency rises."""
    ramp = np.arange(n_samples)
    return {
        "noise": np.random.default_rng(0).standard_normal(n_samples),
        "triangle": np.abs(ramp % 2000 - 1000) / 500.0 - 1.0,
        "sweep": np.sin(np.linspace(0.0, 1000.0, n_samples) ** 2 / 10.0),
    }


def operator(n_plays):
    """Return an operator with evenly spaced thresholds below 1."""
    return PrandtlIshlinskiiOperator(np.arange(n_plays) / n_plays, np.full(n_plays, 1.0 / n_plays))


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


class PlayBasis:
    """Plays of a random walk, shape (1,000,000, 100), written to one warm array."""

    shape = (1_000_000, 100)

    def setup(self):
        """Make the drive and the array."""
        self.out = np.ones(self.shape)
        self.thresholds = np.arange(self.shape[1]) / self.shape[1]
        steps = np.random.default_rng(0).standard_normal(self.shape[0])
        self.drive = 0.01 * np.cumsum(steps)

    def time_play_basis(self):
        """Write the plays."""
        play_basis(self.drive, self.thresholds, np.zeros(self.shape[1]), self.out)

    def time_stop_basis(self):
        """Write the stops."""
        stop_basis(self.drive, self.thresholds, np.zeros(self.shape[1]), self.out)

    def time_fill(self):
        """Fill the same array: what the machine can do."""
        self.out.fill(1.0)

    def time_store_rows(self):
        """Write constant rows in a compiled loop."""
        store_rows(self.thresholds, self.out)


class Run:
    """A million samples through the operator."""

    n_samples = 1_000_000
    params = ((10, 100, 1000), ("noise", "triangle", "sweep"))
    param_names = ("n_plays", "drive")

    def setup(self, n_plays, drive):
        """Make the drive and the operator."""
        self.drive = signals(self.n_samples)[drive]
        self.operator = operator(n_plays)

    def time_run(self, n_plays, drive):
        """Run from rest."""
        self.operator.run(self.drive, 1.0)


class Predict:
    """A million samples through the fitted estimator, validation included."""

    n_samples = 1_000_000
    params = ((10, 1000), ("noise", "triangle", "sweep"))
    param_names = ("n_plays", "drive")

    def setup(self, n_plays, drive):
        """Make the drive and fit the estimator to the start of it."""
        self.X = signals(self.n_samples)[drive].reshape(-1, 1)
        few = self.X[:5000]
        self.model = PrandtlIshlinskii(thresholds=np.arange(n_plays) / n_plays).fit(few, few[:, 0])
        self.model.operator_ = operator(n_plays)

    def time_predict(self, n_plays, drive):
        """Predict one record."""
        self.model.predict(self.X)


class Linearize:
    """Twenty thousand samples, twenty plays, with tangents from upstream."""

    n_samples = 20_000
    params = (0, 5)
    param_names = ("n_tangents",)

    def setup(self, n_tangents):
        """Make the drive, its tangents and the operator."""
        rng = np.random.default_rng(0)
        self.drive = 0.02 * np.cumsum(rng.standard_normal(self.n_samples))
        self.tangents = rng.standard_normal((self.n_samples, n_tangents))
        self.operator = operator(20)

    def time_sensitivities(self, n_tangents):
        """Return the response and all tangents."""
        self.operator.sensitivities(self.drive, self.tangents, 1.0)


class LinearRun:
    """A hundred thousand samples through a transfer function with many poles, ringing ones."""

    n_samples = 100_000
    params = (1, 2, 3, 4, 8, 16, 28)
    param_names = ("n_states",)

    def setup(self, n_states):
        """Make the drive and the operator."""
        n_first, n_second = n_states % 2, n_states // 2
        self.drive = np.random.default_rng(0).standard_normal(self.n_samples)
        self.operator = TransferFunctionOperator(
            np.full(n_first, 0.1),
            60.0 * 1.3 ** np.arange(n_second),
            np.full(n_second, 0.05),
            np.zeros(0),
        )

    def time_run(self, n_states):
        """Run from rest."""
        self.operator.run(self.drive, 1e-3)


class LogCreepRun:
    """A hundred thousand samples through a bank of relaxing units."""

    n_samples = 100_000

    def setup(self):
        """Make the drive and the operator: 31 units."""
        self.drive = np.cumsum(np.random.default_rng(0).standard_normal(self.n_samples))
        self.operator = LogCreepOperator(0.1, 0.1, shortest=1e-4, longest=1e3)
        self.n_states = len(self.operator.init(0.0)[0])

    def time_run(self):
        """Run from rest."""
        self.operator.run(self.drive, 1e-3)


def linear_table():
    """Print the time a sample and state of linear steps."""
    print(f"linear steps, ns a sample and state (limit {LINEAR_LIMIT:g})")
    cases, states = {}, {}
    for n_states in LinearRun.params:
        case, name = LinearRun(), f"{n_states} poles"
        case.setup(n_states)
        cases[name], states[name] = partial(case.time_run, n_states), n_states
    creep = LogCreepRun()
    creep.setup()
    name = f"LogCreep, {creep.n_states} units"
    cases[name], states[name] = creep.time_run, creep.n_states
    for name, value in best(cases).items():
        cost = value / LinearRun.n_samples * 1e9 / states[name]
        print(f"  {name:<20}{cost:6.2f}  {'' if cost <= LINEAR_LIMIT else 'above the limit'}")


def main():
    basis = PlayBasis()
    basis.setup()
    names = ("fill", "store_rows", "play_basis", "stop_basis")
    seconds = best({name: getattr(basis, f"time_{name}") for name in names})
    rates = {name: basis.out.nbytes / 1e9 / seconds[name] for name in names}
    machine = max(rates["fill"], rates["store_rows"])
    print(f"writes to {basis.shape[0]} x {basis.shape[1]} doubles, one thread")
    for name, rate in rates.items():
        print(f"  {name:<12}{rate:6.2f} GB/s  {rate / machine:5.0%}")

    for kind, name, label in (
        (Run, "time_run", "PrandtlIshlinskiiOperator.run"),
        (Predict, "time_predict", "PrandtlIshlinskii.predict"),
    ):
        print(f"{label}, ns a sample")
        print("  plays " + "".join(f"{drive:>10}" for drive in kind.params[1]))
        cases = {}
        for n_plays in kind.params[0]:
            for drive in kind.params[1]:
                case = kind()
                case.setup(n_plays, drive)
                cases[n_plays, drive] = partial(getattr(case, name), None, None)
        seconds = best(cases)
        for n_plays in kind.params[0]:
            row = (seconds[n_plays, drive] / kind.n_samples * 1e9 for drive in kind.params[1])
            print(f"  {n_plays:<6}" + "".join(f"{value:>10.1f}" for value in row))

    print("PrandtlIshlinskiiOperator.sensitivities, 20000 samples, 20 plays")
    cases = {}
    for n_tangents in Linearize.params:
        case = Linearize()
        case.setup(n_tangents)
        cases[n_tangents] = lambda case=case: case.time_sensitivities(None)
    for n_tangents, value in best(cases, 3 * REPEATS).items():
        print(f"  {n_tangents} tangents{value * 1e3:8.2f} ms")
    linear_table()


if __name__ == "__main__":
    main()
