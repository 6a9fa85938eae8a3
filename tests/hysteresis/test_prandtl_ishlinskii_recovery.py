"""Weights of plants that are summed here come back, with standard errors that are true."""

import numpy as np

from skhyst.hysteresis import PrandtlIshlinskii

N_PLANTS, N = 25, 1500


def plant(u, thresholds, weights, intercept):
    plays, y = np.zeros(len(thresholds)), np.empty(len(u))
    for k, value in enumerate(u):
        plays = np.maximum(value - thresholds, np.minimum(value + thresholds, plays))
        y[k] = intercept + weights @ plays
    return y


def test_recovery_and_standard_errors():
    inside, errors = [], []
    for seed in range(N_PLANTS):
        rng = np.random.default_rng(seed)
        unit = 10.0 ** rng.uniform(-6, 6)
        u = np.cumsum(rng.normal(size=N)) / 8.0
        thresholds = np.array([0.0, 0.15, 0.35, 0.6]) * np.ptp(u) / 2.0
        weights = rng.uniform(0.3, 1.0, 4)
        clean = plant(u, thresholds, weights, 0.4)
        scale = 0.005 * np.ptp(clean)
        noise = scale * rng.normal(size=N)
        model = PrandtlIshlinskii(thresholds=thresholds)
        model.fit(u[:, None], unit * (clean + noise))
        errors.append(model.fit_error_ / (unit * np.sqrt(np.mean(noise**2))))
        truth = {f"weights[{i}]": w for i, w in enumerate(weights)} | {"intercept": 0.4}
        inside += [
            abs(model.params_[name] - unit * value) < 1.96 * model.params_std_[name]
            for name, value in truth.items()
        ]
    assert max(errors) < 1.02
    assert 0.90 <= np.mean(inside) <= 0.99
