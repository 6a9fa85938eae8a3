"""PrandtlIshlinskii with stops: force over displacement."""

import pickle

import numpy as np
import pytest
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import make_pipeline

from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.preprocessing import StopOperators

THRESHOLDS = np.array([0.0, 0.2, 0.5, 0.9])


def drive(rng, n=1500):
    turns = rng.uniform(0.3, 1.0, 16) * (-1.0) ** np.arange(16) * 2.0
    return np.interp(np.arange(n), np.linspace(0, n - 1, 17), np.append(0.0, turns))


def springs(u, weights, intercept):
    """Force of springs in parallel, each behind a slider that yields at its threshold."""
    force, total = np.zeros(3), []
    last = 0.0
    for value in u:
        force = np.clip(force + (value - last), -THRESHOLDS[1:], THRESHOLDS[1:])
        last = value
        total.append(intercept + weights[0] * value + weights[1:] @ force)
    return np.array(total)


def test_recovery_of_random_plants():
    covered = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        u, weights, intercept = drive(rng), rng.uniform(0.3, 2.0, 4), rng.normal()
        force = springs(u, weights, intercept)
        noise = 0.005 * force.std()
        X, y = u.reshape(-1, 1), force + noise * rng.normal(size=u.size)
        model = PrandtlIshlinskii(thresholds=THRESHOLDS, form="stop").fit(X, y)
        assert np.sqrt(np.mean((model.predict(X) - force) ** 2)) < 0.2 * noise
        assert model.fit_error_ < 1.02 * np.sqrt(np.mean((y - force) ** 2))
        truth = np.append(weights, intercept)
        found, std = (np.array(list(p.values())) for p in (model.params_, model.params_std_))
        covered += list(np.abs(found - truth) < 1.96 * std)
    assert 0.9 <= np.mean(covered) <= 0.99


def test_equals_a_linear_model_of_stops():
    rng = np.random.default_rng(3)
    u = drive(rng)
    X, y = u.reshape(-1, 1), np.tanh(u) + 0.1 * rng.normal(size=u.size)
    thresholds = [0.0, 0.3, 0.8]
    model = PrandtlIshlinskii(thresholds=thresholds, form="stop", non_negative=False).fit(X, y)
    plain = make_pipeline(StopOperators(thresholds=thresholds[1:]), LinearRegression()).fit(X, y)
    np.testing.assert_allclose(model.predict(X), plain.predict(X), atol=1e-8)


def test_free_weights_of_either_form_give_one_model():
    rng = np.random.default_rng(4)
    u = drive(rng)
    X, y = u.reshape(-1, 1), np.cumsum(rng.normal(size=u.size)) * 0.01 + u
    plays, stops = (
        PrandtlIshlinskii(6, form=form, non_negative=False).fit(X, y) for form in ("play", "stop")
    )
    np.testing.assert_allclose(stops.predict(X), plays.predict(X), atol=1e-8)
    np.testing.assert_allclose(stops.weights_[1:], -plays.weights_[1:], atol=1e-6)


def test_a_force_needs_stops():
    rng = np.random.default_rng(5)
    u = drive(rng)
    X, y = u.reshape(-1, 1), springs(u, np.array([0.3, 1.0, 1.0, 1.0]), 0.2)
    error = {form: PrandtlIshlinskii(form=form).fit(X, y).fit_error_ for form in ("play", "stop")}
    assert error["stop"] < 0.03 * error["play"]


def test_inverse_predict_after_pickling():
    rng = np.random.default_rng(6)
    u = drive(rng)
    X, y = u.reshape(-1, 1), springs(u, np.array([0.3, 1.0, 1.0, 1.0]), 0.2)
    model = PrandtlIshlinskii(thresholds=THRESHOLDS, form="stop").fit(X, y)
    model = pickle.loads(pickle.dumps(model))
    response = model.predict(X).reshape(-1, 1)
    np.testing.assert_allclose(
        model.inverse_predict(response), u, rtol=0, atol=1e-12 * np.ptp(u) * 11.0
    )


def test_form_is_checked():
    with pytest.raises(ValueError, match="'form' parameter of PrandtlIshlinskii"):
        PrandtlIshlinskii(form="spring").fit(np.zeros((5, 1)), np.zeros(5))
