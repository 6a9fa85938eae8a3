"""The experiments of the gray-box paper: who identifies the stage best, and in how many epochs.

    python benchmarks/gray_box.py [--stage piezo|published] [--iterations 500] [--epochs 1000]

A stage with quasi-static hysteresis, equations (15) to (17), behind it a mode at 512 Hz, and an
encoder of 1.2 nm are simulated without skhyst. Table A is Table 1 of the paper: each method is
trained on the record at 0.5 Hz alone. In table B each is trained on the records at 0.5, 5, 10 and
25 Hz; the last column is a record of none of these, with loops within loops. Errors are the
largest ones, in nm, against what the encoder reads.

The paper's ratio to the best black box, 4.6, holds where there are several frequencies (table B).
In table A it does not: drive and gradient of one steady loop determine the response, and a network
that is trained to the end reaches the encoder's noise; the paper's stopped at 96 nm.

``--stage published`` has the paper's delta_d = 0.4783, gamma = -370.47 and V_c = 24629 in those
equations: its loop is narrower than 0.5 % of the stroke, and run through clockwise. ``piezo`` has
the loop of an ordinary actuator.
"""

import argparse
import time
import warnings
from types import SimpleNamespace

import numpy as np
from scipy.signal import cont2discrete, lfilter
from sklearn.exceptions import ConvergenceWarning as NotConverged
from sklearn.neural_network import MLPRegressor

from skhyst.exceptions import ConvergenceWarning
from skhyst.neural import GrayBoxHysteresis
from skhyst.optimize import LevenbergMarquardt, ParticleSwarm
from skhyst.preprocessing import GeneralizedInputGradient
from skhyst.records import stack_records

DT = 2e-4  # s
FREQUENCIES = (0.5, 5.0, 10.0, 25.0)  # Hz
OMEGA, ZETA = 2 * np.pi * 512.0, 0.03
RESOLUTION, NOISE = 1.2, 1.0  # nm
FINE = 8
# slope, curvature and decay of (16) and (17)
STAGES = {
    "piezo": (80.0, 0.9, 0.005),
    "published": (0.4783 * (1 + 370.47), -0.4783 * 370.47 / 24629, 1 / 24629),
}
NEURONS = (17, 25, 35)
ROWS = 1000  # of each record, for the networks: a static map needs no neighbours


def quasi_static(u, slope, curvature, decay):
    """Equation (15), in closed form from turning point to turning point."""
    turning, base, direction, last, y = 0.0, 0.0, 1.0, 0.0, np.empty(len(u))
    for k, value in enumerate(u):
        if (value - last) * direction < 0.0:
            base, turning, direction = y[k - 1], last, -direction
        s = abs(value - turning)
        y[k] = base + direction * (
            slope * s + curvature * (s + np.expm1(-decay * s) / decay) / decay
        )
        last = value
    return y


def stage(u, parameters, rng):
    """Return what the encoder reads; the mode is advanced on a finer grid."""
    time = np.arange(len(u))
    fine = np.interp(np.arange(FINE * (len(u) - 1) + 1) / FINE, time, u)
    numerator, denominator, _ = cont2discrete(
        ([OMEGA**2], [1.0, 2 * ZETA * OMEGA, OMEGA**2]), DT / FINE, method="foh"
    )
    y = lfilter(numerator.ravel(), denominator, quasi_static(fine, *parameters))[::FINE]
    return RESOLUTION * np.round((y + NOISE * rng.normal(size=len(y))) / RESOLUTION)


def simulate(name, seed=0):
    """Return the records by frequency, and the one that is held out."""
    rng, records = np.random.default_rng(seed), {}
    for f in FREQUENCIES:
        t = DT * np.arange(round(max(1.0 / f, 0.2) / DT))
        u = 50.0 - 50.0 * np.cos(2 * np.pi * f * t)
        records[f] = u.reshape(-1, 1), stage(u, STAGES[name], rng)
    t = DT * np.arange(round(1.0 / DT))
    u = 50.0 - 30.0 * np.cos(2 * np.pi * 2 * t) - 20.0 * np.cos(2 * np.pi * 15 * t)
    return records, (u.reshape(-1, 1), stage(u, STAGES[name], rng))


class Network:
    """One hidden layer on drive and generalised gradient, trained as the gray box is."""

    def __init__(self, neurons, max_epochs, seed=0):
        self.neurons, self.max_epochs, self.seed = neurons, max_epochs, seed

    def _forward(self, w, x, jacobian=False):
        p, n = x.shape[1], self.neurons
        inner, bias, outer = w[: p * n].reshape(p, n), w[p * n : -n - 1], w[-n - 1 : -1]
        h = np.tanh(x @ inner + bias)
        y = h @ outer + w[-1]
        if not jacobian:
            return y
        back = (1 - h**2) * outer
        columns = [x[:, [i]] * back for i in range(p)]
        return y, np.hstack([*columns, back, h, np.ones((len(x), 1))])

    def fit(self, x, y):
        """Train from random weights of unit variance, inputs and output scaled."""
        rng = np.random.default_rng(self.seed)
        self.x_mean, self.x_std = x.mean(axis=0), x.std(axis=0)
        self.y_mean, self.y_std = y.mean(), y.std()
        x, y = (x - self.x_mean) / self.x_std, (y - self.y_mean) / self.y_std
        w = rng.normal(size=(x.shape[1] + 2) * self.neurons + 1)
        mu, self.n_epochs_ = 1e-3, 0
        out, jacobian = self._forward(w, x, True)
        error = out - y
        while self.n_epochs_ < self.max_epochs and mu < 1e10:
            hessian, gradient = jacobian.T @ jacobian, jacobian.T @ error
            while mu < 1e10:
                step = np.linalg.solve(hessian + mu * np.eye(len(w)), gradient)
                moved = self._forward(w - step, x) - y
                if moved @ moved < error @ error:
                    break
                mu *= 10.0
            else:
                break
            w, mu, self.n_epochs_ = w - step, max(0.1 * mu, 1e-20), self.n_epochs_ + 1
            out, jacobian = self._forward(w, x, True)
            error = out - y
        self.w = w
        return self

    def predict(self, x):
        """Return the output."""
        return self.y_mean + self.y_std * self._forward(self.w, (x - self.x_mean) / self.x_std)


class Perceptron:
    """The same by scikit-learn, with its quasi-Newton method."""

    def __init__(self, neurons, max_epochs):
        self.model = MLPRegressor(
            hidden_layer_sizes=(neurons,),
            activation="tanh",
            solver="lbfgs",
            alpha=0.0,
            max_iter=max_epochs,
            max_fun=10**6,
            tol=1e-14,
            random_state=0,
        )

    def fit(self, x, y):
        """Train, inputs and output scaled."""
        self.scale = x.mean(axis=0), x.std(axis=0), y.mean(), y.std()
        self.model.fit(self._scaled(x), (y - self.scale[2]) / self.scale[3])
        self.n_epochs_ = self.model.n_iter_
        return self

    def _scaled(self, x):
        return (x - self.scale[0]) / self.scale[1]

    def predict(self, x):
        """Return the output."""
        return self.scale[2] + self.scale[3] * self.model.predict(self._scaled(x))


def features(u):
    """Return the extended input space of Theorem 1."""
    return GeneralizedInputGradient(dt=DT).fit_transform(u)


def black_box(model):
    """Return a function that trains a network on records and says how many epochs it took."""

    def train(records):
        thinned = [
            (features(u)[rows], y[rows])
            for u, y in records
            for rows in [np.linspace(0, len(y) - 1, min(len(y), ROWS)).astype(int)]
        ]
        model.fit(*map(np.concatenate, zip(*thinned, strict=True)))
        return lambda u: model.predict(features(u)), str(model.n_epochs_)

    return train


def gray_box(training, method, *, dynamic=True):
    """Return a function that trains a gray box, its quasi-static half alone unless ``dynamic``."""

    def train(records):
        lags = {} if dynamic else {"input_lags": 0, "output_lags": 0}
        model = GrayBoxHysteresis(training, method=method, dt=DT, **lags)
        model.fit(*stack_records(records, dt=DT))
        epochs = list(model.n_epochs_.values())
        if isinstance(method, ParticleSwarm):
            epochs = [method.max_iterations] * len(epochs)
        return lambda u: model.predict(stack_records([u], dt=DT)), "+".join(map(str, epochs))

    return train


def table(title, methods, records, columns):
    """Train each method on the records and print its largest error in every column."""
    print(f"\n{title}\n{'':27s}{'epochs':>14s}{'CPU s':>8s}", end="")
    print("".join(f"{name:>11s}" for name in columns), "  ratio")
    reference = None
    for name, train in methods.items():
        begin = time.process_time()
        with warnings.catch_warnings():
            # budgets and what the data do not determine are part of the experiment
            warnings.simplefilter("ignore", ConvergenceWarning)
            warnings.simplefilter("ignore", NotConverged)
            predict, epochs = train(records)
        seconds = time.process_time() - begin
        errors = [np.abs(predict(u) - y).max() for u, y in columns.values()]
        worst = max(errors[: len(records)])
        reference = reference or worst
        print(f"{name:27s}{epochs:>14s}{seconds:8.2f}", end="")
        print("".join(f"{error:11.2f}" for error in errors), f"{worst / reference:7.1f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--stage", choices=STAGES, default="piezo")
    parser.add_argument("--iterations", type=int, default=500, help="of the particle swarm")
    parser.add_argument("--epochs", type=int, default=1000, help="at most, of the networks")
    options = parser.parse_args()
    records, held_out = simulate(options.stage)
    columns = {f"{f:g} Hz": record for f, record in records.items()}
    swarm = ParticleSwarm(
        population=30, max_iterations=options.iterations, project=False, polish=False
    )
    trained, epochs = LevenbergMarquardt(), options.epochs
    networks = {
        f"{kind}, {n} neurons": black_box(model(n, epochs))
        for kind, model in (("black box, LM", Network), ("black box, L-BFGS", Perceptron))
        for n in NEURONS
    }
    slow = SimpleNamespace(records=[records[0.5]], columns={"0.5 Hz": columns["0.5 Hz"]})
    span = np.ptp(records[0.5][1])
    print(f"stage {options.stage!r}: stroke {span:.0f} nm, encoder {RESOLUTION} nm")
    table(
        "A. trained on 0.5 Hz alone: largest error in nm\n"
        "   (paper: gray box 20.77, swarm 1.5 times, best black box 4.6 times as much)",
        {
            "gray box": gray_box("staged", trained, dynamic=False),
            "gray box, swarm": gray_box("staged", swarm, dynamic=False),
            **networks,
        },
        slow.records,
        slow.columns,
    )
    table(
        "B. trained on all frequencies: largest error in nm",
        {
            "gray box, joint": gray_box("joint", trained),
            "gray box, staged": gray_box("staged", trained),
            "gray box, swarm": gray_box("staged", swarm),
            **networks,
        },
        list(records.values()),
        columns | {"held out": held_out},
    )
    print("\nratio: of the largest error in the records of the training to that of the first row.")
    print("A: one steady loop is a smooth curve of drive and gradient, so a black box reaches the")
    print("noise there, unlike in the paper. B: over several frequencies and held out it does not.")
    print("One seed. The swarm has 30 particles within limits around data-driven starts; L-BFGS")
    print("may stop before its budget, where SciPy sees no change of the loss.")


if __name__ == "__main__":
    main()
