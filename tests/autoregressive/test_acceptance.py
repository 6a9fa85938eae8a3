"""What holds for every autoregressive model."""

import pickle

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from sklearn.linear_model import LinearRegression
from sklearn.neighbors import KNeighborsRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skhyst.autoregressive import NARMAXRegressor, NARXRegressor
from skhyst.exceptions import ConvergenceWarning, DivergenceWarning, RecordError

LAGS = {"input_lags": {0: [0, 1, 3], 1: [0]}, "output_lags": [1, 2]}
MODELS = {
    "linear": NARXRegressor(**LAGS),
    "neighbours": NARXRegressor(make_pipeline(StandardScaler(), KNeighborsRegressor(3)), **LAGS),
    "polynomial": NARMAXRegressor(2, n_terms=8, **LAGS),
    "noise terms": NARMAXRegressor(1, noise_lags=(1,), **LAGS),
    "simulation": NARMAXRegressor(2, n_terms=8, objective="simulation", **LAGS),
    "features": NARMAXRegressor(1, features=["rate_sign", "play"], n_terms=9, **LAGS),
}


@pytest.fixture(scope="module")
def data(recordings):
    return recordings(noise=0.02)


@pytest.fixture(params=MODELS)
def model(request):
    return clone(MODELS[request.param])


def test_future_does_not_change_the_past(model, data):
    X, y = data
    changed = X.copy()
    changed.iloc[50:] += 1.0
    model.fit(X, y)
    np.testing.assert_array_equal(model.predict(changed)[:50], model.predict(X)[:50])


def test_records_do_not_know_each_other(model, data):
    X, y = data
    model.set_params(initial_output=0.0).fit(X, y)
    alone = np.concatenate([model.predict(X.loc[[label]]) for label in "abc"])
    np.testing.assert_array_equal(model.predict(X), alone)
    again = pickle.loads(pickle.dumps(model))
    np.testing.assert_array_equal(again.predict(X), alone)
    other = [pd.concat([part.loc[[label]] for label in "cab"]) for part in data]
    permuted = clone(model).fit(*other).predict(X)
    np.testing.assert_allclose(permuted, alone, rtol=1e-7, atol=1e-9)
    keep = np.r_[0:60, 75 : len(X)]
    assert len(clone(model).fit(X.iloc[keep], y.iloc[keep]).records_) == 4


@pytest.mark.parametrize("initial_output", ["rest", "measured"])
def test_horizons(model, initial_output, data):
    X, y = data
    model.set_params(initial_output=initial_output).fit(X, y)
    np.testing.assert_array_equal(model.predict_one_step(X, y), model.predict(X, y, horizon=1))
    far = model.predict(X, y, horizon=1000)
    np.testing.assert_allclose(far, model.predict(X, y), rtol=1e-10, atol=1e-12)


def test_going_on_from_what_is_known(model, data):
    """As the prediction after the longest lag does, wherever the known part ends."""
    X, y = (part.loc["a"] for part in data)
    model.set_params(initial_output="measured").fit(X, y)
    expected, k = model.predict(X, y), 3
    found = model.predict(X, y_start=y.where(np.arange(len(y)) < k))
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-12)
    for rows in (k, k + 20):
        stepper = model.stepper_from(X[:rows], y[:rows].where(np.arange(rows) < k))
        later = stepper.run(X.to_numpy()[rows:])
        np.testing.assert_allclose(later, expected[rows:], rtol=1e-9, atol=1e-12)
    with pytest.raises(ValueError, match="'y_start' parameter"):
        model.predict(X, y, y_start=y)
    with pytest.raises(ValueError, match=r"'return_std' parameter .* whose past outputs"):
        model.predict(X, return_std=True)


def test_horizon_is_limited_by_the_record(model, recordings):
    X, y = recordings((60, 6, 3))
    model.fit(X, y)
    for horizon in (1, 3, 5, 6, 7, 60, 61):
        both = model.predict(X, y, horizon=horizon)
        alone = [model.predict(X.loc[[r]], y.loc[[r]], horizon=horizon) for r in "abc"]
        np.testing.assert_allclose(both, np.concatenate(alone), rtol=1e-12, atol=1e-14)


def test_constant_data(model):
    X, names = np.full((40, 2), 2.0), {"input_lags": [0, 1]}
    for level in (3.0, 0.0):
        y = np.full(40, level)
        with pytest.warns(ConvergenceWarning, match="drive does not move: it is 2 in every sample"):
            model.set_params(**names).fit(X, y)
        np.testing.assert_allclose(model.predict(X), y, atol=1e-9)


class Called(LinearRegression):
    """Predicts otherwise than its class, and so has no compiled form."""

    def predict(self, X):
        return super().predict(X) + 1e-6


@pytest.mark.parametrize("model", [NARXRegressor(), NARXRegressor(Called()), NARMAXRegressor(1)])
def test_divergence_is_caught(model):
    rng = np.random.default_rng(0)
    u = rng.standard_normal((120, 1))
    y = lfilter([1.0], [1.0, -1.02], np.append(0.0, u[1:, 0]))
    model = clone(model).set_params(input_lags=[0], output_lags=1, initial_output=0.0).fit(u, y)
    with pytest.warns(DivergenceWarning, match="diverged"):
        run = model.predict(rng.standard_normal((3000, 1)) + 1.0)
    assert np.isfinite(run).all()
    assert np.abs(run).max() == pytest.approx(np.abs(y).max() + 100.0 * np.ptp(y))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("input_lags", [-1]),
        ("input_lags", []),
        ("input_lags", {"nothing": [1]}),
        ("output_lags", [0]),
        ("output_lags", [1.5]),
        ("initial_output", "asleep"),
        ("initial_output", [1.0]),
        ("initial_output", float("nan")),
        ("dt", 0.0),
    ],
)
@pytest.mark.parametrize("kind", [NARXRegressor, NARMAXRegressor])
def test_wrong_parameters(kind, name, value, data):
    with pytest.raises(ValueError, match=f"'{name}' parameter of {kind.__name__}"):
        kind(**LAGS | {name: value}).fit(*data)


@pytest.mark.parametrize("kind", [NARXRegressor, NARMAXRegressor])
def test_wrong_calls(kind, data):
    X, y = data
    with pytest.raises(NotFittedError):
        kind(**LAGS).predict(X)
    model = kind(**LAGS).fit(X, y)
    with pytest.raises(ValueError, match="'horizon' parameter"):
        model.predict(X, y, horizon=0)
    with pytest.raises(ValueError, match="'y' parameter"):
        model.predict(X, horizon=2)
    with pytest.raises(ValueError, match="NaN"):
        model.predict(X, y.where(y > y.min()), horizon=2)
    with pytest.raises(RecordError, match="longer than the longest lag"):
        kind(input_lags=[500]).fit(X, y)
    with pytest.raises(RecordError, match="set_output"):
        kind(**LAGS).fit(X.to_numpy(), y)
