"""What `NARMAXRegressor` promises: `python benchmarks/narmax_structure.py`.

Prints, with the limits,

- of ten known polynomial systems with noise, for how many exactly the true terms are selected:
  with equation noise one step ahead, in simulation with a tenth of the response on the sensor;
- how often an interval of two standard errors about each coefficient holds the true value, for
  white equation noise, coloured equation noise and white noise on the sensor;
- the processor's time of a fit for simulation error: 15 terms, 10,000 samples, one thread.

The systems are simulated here, by plain Python, from the equations next to them.
"""

import argparse
import time

import numpy as np

from skhyst.autoregressive import NARMAXRegressor

EXACT, COVERED, SECONDS = 9, (0.90, 0.99), 0.2

# name: (terms and coefficients, standard deviation of e, lags and degree of the candidates); a term
# is a product of factors "signal lag", and u, v are the inputs
SYSTEMS = {
    "linear, second order": ({"y1": 1.5, "y2": -0.7, "u1": 1.0, "u2": 0.5}, 0.1, 3),
    "static quadratic after a lag": ({"y1": 0.5, "u2": 1.0, "u2 u2": 0.1}, 0.05, 3),
    "bilinear": ({"y2": 0.75, "u1": 0.25, "y2 u1": -0.2}, 0.02, 3),
    "squared output": ({"y1": -0.605, "y2 y2": -0.163, "u1": 0.588, "u2": -0.24}, 0.03, 3),
    "quadratic and cubic": (
        {"y1 u1": 0.7, "y2": -0.5, "u2 u2": 0.6, "y2 u2 u2": -0.7},
        0.05,
        3,
    ),
    "cubic output": (
        {"y1 y1 y1": -0.2, "y1 u1": 0.5, "u2 u2": 0.6, "y2 u2 u2": -0.4, "y2": -0.5},
        0.02,
        3,
    ),
    "Volterra": ({"u1": 0.8, "u2": 0.4, "u1 u2": -0.3, "u2 u2": 0.5}, 0.05, 3),
    "hardening resonance": ({"y1": 1.6, "y2": -0.8, "u1": 0.2, "y1 y1 y1": -0.05}, 0.01, 3),
    "Hammerstein, cubic": ({"y1": 0.8, "u1": 0.4, "u1 u1": 0.4, "u1 u1 u1": 0.4}, 0.05, 3),
    "two inputs and a constant": (
        {"": 0.3, "y1": 0.6, "u1": 1.0, "v2": -0.4, "u1 v1": 0.25},
        0.05,
        2,
    ),
}


def simulate(terms, n_samples, rng, *, noise=0.0, colour=0.0, sensor=0.0):
    """Return inputs and response of a system; ``colour`` is the coefficient of ``e(k-1)``."""
    products = [([(f[0], int(f[1])) for f in name.split()], c) for name, c in terms.items()]
    two = any(factor[0] == "v" for factors, _ in products for factor in factors)
    signals = {name: rng.uniform(-1.0, 1.0, n_samples) for name in ("u", "v")}
    signals["u"][:2] = signals["v"][:2] = 0.0  # as before the record
    y = signals["y"] = np.zeros(n_samples)
    e = noise * rng.normal(size=n_samples)
    for k in range(2, n_samples):
        y[k] = e[k] + colour * e[k - 1]
        for factors, coefficient in products:
            value = coefficient
            for name, lag in factors:
                value *= signals[name][k - lag]
            y[k] += value
    X = np.column_stack([signals["u"], signals["v"]] if two else [signals["u"]])
    return X, y + sensor * rng.normal(size=n_samples)


STRUCTURES = {
    "equation noise": {},
    "sensor noise": {"sensor": 0.1, "objective": "simulation"},
}


def spelled(terms):
    """Return terms in the spelling of ``terms_``."""
    two = any("v" in name for name in terms)
    names = {"u": "u1" if two else "u", "v": "u2", "y": "y"}
    result = {}
    for name, coefficient in terms.items():
        factors = sorted(name.split(), key=lambda f: (f[0] != "y", f))
        powers = {f: factors.count(f) for f in factors}
        text = [
            f"{names[f[0]]}(k-{f[1]})" + (f"^{power}" if power > 1 else "")
            for f, power in powers.items()
        ]
        result[" ".join(text) or "1"] = coefficient
    return result


def structure(n_samples, seeds, *, sensor=0.0, **options):
    """Return for each system the part of the seeds with exactly the true terms.

    The noise is that of the equation, or ``sensor`` standard deviations of the response on it.
    """
    rates = {}
    for name, (terms, noise, degree) in SYSTEMS.items():
        hits = 0
        for seed in range(seeds):
            rng = np.random.default_rng(seed)
            X, y = simulate(terms, n_samples, rng, noise=0.0 if sensor else noise)
            y = y + sensor * np.std(y) * rng.normal(size=n_samples)
            model = NARMAXRegressor(
                degree, input_lags=(1, 2, 3), output_lags=(1, 2, 3), **options
            ).fit(X, y)
            hits += set(model.terms_["term"]) == set(spelled(terms))
        rates[name] = hits / seeds
    return rates


QUADRATIC = {"y1": 0.5, "y2": -0.2, "u2": 1.0, "y1 u1": 0.3, "u1 u1": 0.2}
NOISES = {
    "white equation noise": ({"noise": 0.1}, {}),
    "coloured equation noise": ({"noise": 0.1, "colour": 0.7}, {"noise_lags": (1,)}),
    "white sensor noise": ({"sensor": 0.1}, {"objective": "simulation"}),
}


def coverage(kind, n_samples, seeds):
    """Return how often 1.96 standard errors hold the true value, each coefficient and seed."""
    noise, options = NOISES[kind]
    truth = spelled(QUADRATIC)
    if "colour" in noise:
        truth["e(k-1)"] = noise["colour"]
    inside = []
    for seed in range(seeds):
        X, y = simulate(QUADRATIC, n_samples, np.random.default_rng(seed), **noise)
        model = NARMAXRegressor(
            2, input_lags=(1, 2), output_lags=(1, 2), initial_output=0.0, **options
        ).fit(X, y)
        table = model.terms_.set_index("term")
        if set(table.index) == set(truth):
            values = np.array([truth[name] for name in table.index])
            inside.append(np.abs(table["coefficient"] - values) <= 1.96 * table["standard_error"])
    return np.mean(inside), len(inside)


def fit_time(n_samples=10_000, n_terms=15):
    """Return the shortest of three times of a fit for simulation error, s of the processor."""
    X, y = simulate(QUADRATIC, n_samples, np.random.default_rng(0), sensor=0.1)
    model = NARMAXRegressor(2, n_terms=n_terms, objective="simulation")
    model.fit(X, y)
    times = []
    for _ in range(3):
        start = time.process_time()
        model.fit(X, y)
        times.append(time.process_time() - start)
    return min(times)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--samples", type=int, default=1000)
    arguments = parser.parse_args()
    for kind, options in STRUCTURES.items():
        rates = structure(arguments.samples, arguments.seeds, **options)
        for name, rate in rates.items():
            print(f"{name:32s}{100 * rate:6.0f} % of the seeds with exactly the true terms")
        exact = sum(rate > 0.5 for rate in rates.values())
        mean = 10 * np.mean(list(rates.values()))
        print(f"{kind}: exact in most seeds: {exact} of 10, mean {mean:.1f}   limit {EXACT}")
    for kind in NOISES:
        rate, n_runs = coverage(kind, arguments.samples, 10 * arguments.seeds)
        print(
            f"{kind:32s}{100 * rate:6.1f} % covered in {n_runs} runs   "
            f"limits {100 * COVERED[0]:.0f} to {100 * COVERED[1]:.0f} %"
        )
    print(
        f"{'fit of 10,000 samples, 15 terms':32s}{fit_time():6.3f} s of the processor   "
        f"limit {SECONDS} s"
    )


if __name__ == "__main__":
    main()
