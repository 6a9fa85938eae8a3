"""Plants that only a feedback keeps in bounds, from predictions one step ahead."""

import dataclasses
import pickle

import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone

from skhyst.compose import Cascade, Feedback, Modulated, Sum
from skhyst.exceptions import DivergenceWarning
from skhyst.linear import SecondOrderMode, TransferFunction, TransferFunctionOperator
from skhyst.linear._prediction_error import _errors
from skhyst.persistence import from_json, to_json
from skhyst.static import SmoothCurve

DT, NONE = 0.01, np.empty(0)
LEVITATION = TransferFunctionOperator(np.array([-0.2, 0.1]), NONE, NONE, NONE, 1.0, 0.3, hold="zoh")
NOISE = 0.01


def closed_loop(seed, n=3000):
    """Return drive and response under a proportional and differential feedback."""
    rng = np.random.default_rng(seed)
    ad, b0, _, c, _ = LEVITATION.discrete(DT)
    x, u, y = np.zeros(2), np.zeros(n), np.zeros(n)
    wanted = np.repeat(rng.normal(size=n // 10), 10)
    for k in range(n):
        x = ad @ x + b0 * u[k - 1] if k else x
        y[k] = c @ x + LEVITATION.intercept + NOISE * rng.normal()
        u[k] = wanted[k] + 2.5 * y[k] + 15.0 * (y[k] - y[k - 1])
    return u[:, None], y


@pytest.fixture(scope="module")
def fitted():
    return TransferFunction(2, stable=False, hold="zoh", dt=DT).fit(*closed_loop(1))


def test_the_unstable_pole_is_found_within_its_error(fitted):
    true = dict(zip(fitted.params_, LEVITATION.pack(), strict=True))
    for name, value in true.items():
        assert abs(fitted.params_[name] - value) < 3.0 * fitted.params_std_[name], name
    np.testing.assert_allclose(np.sort(fitted.poles_.real), [-10.0, 5.0], rtol=0.02)
    assert fitted.poles_covariance_[0, 0, 0] > 0.0
    assert NOISE < fitted.fit_error_ < 1.2 * NOISE


def test_predictions_of_other_records(fitted):
    """One step ahead as good as in the fit; the known past of a record starts a free run."""
    X, y = closed_loop(2, 1000)
    error = y - fitted.predict_one_step(X, y)
    assert np.sqrt(np.mean(error**2)) < 1.2 * fitted.fit_error_
    known = np.where(np.arange(1000) < 500, y, np.nan)
    found = fitted.predict(X, y_start=known)
    np.testing.assert_allclose(found[:500], fitted.predict_one_step(X[:500], y[:500]), atol=1e-9)
    late = np.abs(found - y)[500:]
    assert late[:20].max() < 0.2  # it grows by e in 20 samples
    with pytest.warns(DivergenceWarning, match="unstable"):
        fitted.predict(X)


def test_two_records_are_as_good_as_one(fitted):
    parts = [closed_loop(seed, 1500) for seed in (3, 4)]
    index = pd.MultiIndex.from_product([["a", "b"], DT * np.arange(1500)], names=["record", "time"])
    X = pd.DataFrame(np.concatenate([u for u, _ in parts]), index)
    y = pd.Series(np.concatenate([y for _, y in parts]), index)
    model = TransferFunction(2, stable=False, hold="zoh").fit(X, y)
    for name, value in zip(model.params_, LEVITATION.pack(), strict=True):
        assert abs(model.params_[name] - value) < 3.0 * model.params_std_[name], name
    assert model.params_std_["gain"] == pytest.approx(fitted.params_std_["gain"], rel=0.5)


def test_derivatives_of_the_errors():
    """By parameters, gain of the predictor and start, against differences."""
    u, y = closed_loop(0, 80)
    y[30:35] = np.nan
    gain, start = np.array([0.3, -0.1]), np.array([0.1, 0.2])
    plant = dataclasses.replace(LEVITATION, numerator=np.array([0.2]), hold="foh")

    def errors(values):
        own = plant.unpack(values[:5])
        return _errors(own, values[5:7], u[:, 0], y, DT, values[7:], by_parameters=False)[0]

    values = np.concatenate([plant.pack(), gain, start])
    _, found = _errors(plant, gain, u[:, 0], y, DT, start)
    read = np.isfinite(y)
    for j, h in enumerate(1e-6 * np.maximum(np.abs(values), 0.1)):
        move = h * (np.arange(len(values)) == j)
        slope = (errors(values + move) - errors(values - move)) / (2.0 * h)
        scale = max(np.abs(slope[read]).max(), 1.0)
        np.testing.assert_allclose(found[read, j], slope[read], atol=1e-6 * scale)


def test_the_predictor_is_kept(fitted):
    X, y = closed_loop(5, 300)
    expected = fitted.predict_one_step(X, y)
    for again in (pickle.loads(pickle.dumps(fitted)), from_json(to_json(fitted))):
        np.testing.assert_allclose(again.predict_one_step(X, y), expected, rtol=1e-12)
    stable = TransferFunction(1, dt=DT).fit(np.cos(X), np.sin(y))
    with pytest.raises(AttributeError, match="stable=False"):
        stable.predict_one_step(X, y)


@pytest.mark.parametrize(
    ("params", "name"),
    [({"delay": 0.1}, "delay"), ({"n_poles": "auto"}, "n_poles"), ({"inputs": "all"}, "inputs")],
)
def test_what_it_does_not_know_is_refused(params, name):
    with pytest.raises(ValueError, match=f"The '{name}' parameter of TransferFunction must"):
        TransferFunction(stable=False, dt=DT).set_params(**params).fit(*closed_loop(0, 100))


@pytest.mark.parametrize(
    "around",
    [
        lambda part: Cascade([("plant", part), ("curve", SmoothCurve(3))], dt=DT),
        lambda part: Sum([("plant", part), ("mode", SecondOrderMode())], dt=DT),
        lambda part: Feedback(part, SmoothCurve(3), dt=DT),
        lambda part: Modulated(part, 0, dt=DT),
    ],
)
def test_no_part_of_another_model_is_unstable(around):
    with pytest.raises(ValueError, match="The 'stable' parameter of TransferFunction must be True"):
        around(TransferFunction(2, stable=False)).fit(*closed_loop(0, 100))


def test_an_integrator_in_the_loop():
    rng, n = np.random.default_rng(0), 2000
    u, y, place, speed = np.zeros(n), np.zeros(n), 0.0, 0.0
    a, w = np.exp(-DT / 0.2), np.repeat(rng.normal(size=n // 20), 20)
    for k in range(1, n):  # G = 2 / (s (0.2 s + 1)), held drive
        place += 2.0 * u[k - 1] * DT + (speed - 2.0 * u[k - 1]) * 0.2 * (1.0 - a)
        speed = 2.0 * u[k - 1] + (speed - 2.0 * u[k - 1]) * a
        y[k] = place + NOISE * rng.normal()
        u[k] = w[k] - 2.0 * y[k]
    model = TransferFunction(1, integrators=1, stable=False, hold="zoh", dt=DT)
    model.fit(u[:, None], y)
    for name, value in {"time_constants[0]": 0.2, "gain": 2.0}.items():
        assert abs(model.params_[name] - value) < 3.0 * model.params_std_[name], name
    assert model.poles_[0] == 0.0


def test_a_fit_from_an_operator_is_that_of_a_free_run_and_refused(fitted):
    with pytest.raises(ValueError, match=r"'stable' parameter of .* in 'fit_from'"):
        clone(fitted).fit_from(fitted.operator_, *closed_loop(0, 100))
