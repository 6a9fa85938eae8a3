"""Output weights fitted to the free run: their tangents, and what the objective is for."""

import warnings

import numpy as np
import pytest
from sklearn.compose import TransformedTargetRegressor
from sklearn.linear_model import LinearRegression
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures, StandardScaler
from sklearn.tree import DecisionTreeRegressor

from skhyst.autoregressive import NARMAXRegressor, NARXRegressor
from skhyst.autoregressive._output_weights import OutputWeightsProblem
from skhyst.base import read_data
from skhyst.exceptions import ConvergenceWarning
from skhyst.neural import SCNRegressor
from skhyst.records import stack_records


def device(u):
    """A first-order lag with a bend, and hysteresis of one play."""
    y, state, play = np.empty(len(u)), 0.0, 0.0
    for k, value in enumerate(u):
        play = max(value - 0.3, min(value + 0.3, play))
        state = 0.7 * state + 0.3 * np.tanh(value + 0.5 * play)
        y[k] = state
    return y


def recording(seed, noise=0.0, n=300):
    rng = np.random.default_rng(seed)
    records = []
    for offset in (0.0, 0.4):
        u = offset + np.convolve(rng.normal(size=n), np.hanning(9), "same")
        records.append((u, device(u) + noise * rng.normal(size=n)))
    return stack_records(records)


def perceptron(**options):
    network = MLPRegressor(max_iter=300, random_state=0, solver="lbfgs", **options)
    scaled = make_pipeline(StandardScaler(), network)
    return TransformedTargetRegressor(scaled, transformer=StandardScaler())


ESTIMATORS = {
    "linear": None,
    "relu": perceptron(hidden_layer_sizes=(6,), activation="relu"),
    "tanh, two layers": perceptron(hidden_layer_sizes=(5, 4), activation="tanh"),
    "logistic": perceptron(hidden_layer_sizes=(5,), activation="logistic"),
    "identity": perceptron(hidden_layer_sizes=(3,), activation="identity"),
    "SCN": SCNRegressor(8, scaling="whiten", random_state=0),
    "SCN, Gaussian": SCNRegressor(8, activation="rbf", random_state=0),
}


@pytest.fixture(params=ESTIMATORS)
def estimator(request):
    return ESTIMATORS[request.param]


@pytest.fixture(autouse=True)
def _short_trainings():
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", module="sklearn")
        warnings.filterwarnings("ignore", message="No candidate", category=ConvergenceWarning)
        yield


@pytest.mark.parametrize("initial_output", ["rest", 0.1, "measured"])
def test_tangents_are_differences(estimator, initial_output):
    X, y = recording(0, 0.01)
    lags = {"input_lags": [0, 1], "output_lags": [1, 3]}
    model = NARXRegressor(estimator, **lags, initial_output=initial_output).fit(X, y)
    records, values, response = read_data(model, X, y, reset=False, dt=1.0)
    problem = OutputWeightsProblem(model, lambda: model.starting_values(values, records, response))
    weights = model._step.output_weights.copy()

    def errors(theta):
        blocks, good = problem.blocks(None, theta)
        assert good
        return np.concatenate([error for _, error in blocks])

    tangents = np.concatenate([part for part, _ in problem.blocks(None, weights)[0]])
    for q in range(len(weights)):
        h = 1e-5 * max(1.0, abs(weights[q])) * np.eye(len(weights))[q]
        slope = (errors(weights - h) - errors(weights + h)) / (2.0 * h[q])
        scale = np.abs(tangents[:, q]).max()
        np.testing.assert_allclose(tangents[:, q], slope, atol=2e-5 * scale)


def test_the_free_run_is_never_worse_and_no_weights_nearby_are_better(estimator):
    X, y = recording(1, 0.02)
    one_step = NARXRegressor(estimator).fit(X, y)
    model = NARXRegressor(estimator, objective="simulation").fit(X, y)
    error = np.sum((model.predict(X) - y) ** 2)
    assert error <= np.sum((one_step.predict(X) - y) ** 2)
    assert model.n_evaluations_ > 0 == one_step.n_evaluations_
    np.testing.assert_array_equal(model.output_weights_, model._step.output_weights)
    assert not hasattr(one_step, "output_weights_")
    rng = np.random.default_rng(0)
    best = model.output_weights_
    for _ in range(10):
        model._step = model._step.with_output_weights(
            best * (1 + 1e-3 * rng.normal(size=best.size))
        )
        assert np.sum((model.predict(X) - y) ** 2) > error * (1 - 1e-6)


def test_noise_on_the_sensor_biases_one_step_and_not_the_free_run():
    rng = np.random.default_rng(0)
    u, clean = rng.normal(size=4000), np.zeros(4000)
    for k in range(1, 4000):
        clean[k] = 0.9 * clean[k - 1] + 0.1 * u[k]
    y = clean + 0.1 * rng.normal(size=4000)
    options = {"input_lags": [0], "initial_output": 0.0}
    pole = {
        objective: NARXRegressor(objective=objective, **options).fit(u[:, None], y).coef_[-1]
        for objective in ("one_step", "simulation")
    }
    assert pole["one_step"] < 0.8
    assert pole["simulation"] == pytest.approx(0.9, abs=0.01)
    same = NARMAXRegressor(
        1, output_lags=[1], n_terms=None, include_bias=True, objective="simulation", **options
    ).fit(u[:, None], y)
    coefficients = dict(zip(same.terms_["term"], same.coef_, strict=True))
    assert coefficients["y(k-1)"] == pytest.approx(pole["simulation"], abs=1e-5)


@pytest.mark.parametrize(
    "estimator",
    [
        DecisionTreeRegressor(max_depth=3),
        make_pipeline(PolynomialFeatures(2), LinearRegression()),
    ],
)
def test_what_has_no_output_weights_is_refused(estimator):
    X, y = recording(2)
    with pytest.raises(ValueError, match="'objective' parameter of NARXRegressor must be"):
        NARXRegressor(estimator, objective="simulation").fit(X, y)


@pytest.mark.slow
def test_units_and_steppers():
    X, y = recording(3)
    network = SCNRegressor(8, scaling="whiten", random_state=0)
    model = NARXRegressor(network, objective="simulation", initial_output=0.0).fit(X, y)
    other = NARXRegressor(network, objective="simulation", initial_output=0.0).fit(X, 1e-9 * y)
    np.testing.assert_allclose(1e9 * other.predict(X), model.predict(X), atol=1e-4)
    first = X.loc[[0]]
    u = first.to_numpy()[:, 0]
    np.testing.assert_allclose(model.stepper(u0=u[0]).run(u), model.predict(first), atol=1e-9)
