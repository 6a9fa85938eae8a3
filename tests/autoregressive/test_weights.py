"""Weights of samples, and rows that were lost: what is not read changes nothing."""

import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone
from sklearn.linear_model import LinearRegression, Ridge
from sklearn.neighbors import KNeighborsRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skhyst.autoregressive import NARMAXRegressor, NARXRegressor
from skhyst.records import stack_records

N, DT = 400, 0.01
LAGS = {"input_lags": [1], "output_lags": [1]}
MODELS = {
    "linear": NARXRegressor(**LAGS),
    "pipeline": NARXRegressor(make_pipeline(StandardScaler(), Ridge(1e-9)), **LAGS),
    "free run": NARXRegressor(objective="simulation", **LAGS),
    "polynomial": NARMAXRegressor(1, n_terms=3, **LAGS),
    "polynomial, free run": NARMAXRegressor(1, n_terms=3, objective="simulation", **LAGS),
    "initial outputs": NARMAXRegressor(
        1, n_terms=3, objective="simulation", initial_output="estimate", **LAGS
    ),
}


def record(seed, noise=0.05):
    """Return a drive that is slow, so that little is lost with a row of it, and a response."""
    rng = np.random.default_rng(seed)
    u = np.sin(np.cumsum(rng.uniform(0.05, 0.3, N)))
    y = np.full(N, (0.5 * u[0] + 0.1) / 0.2)  # at rest
    for k in range(1, N):
        y[k] = 0.8 * y[k - 1] + 0.5 * u[k - 1] + 0.1
    return u[:, None], y + noise * rng.normal(size=N)


@pytest.fixture(params=MODELS)
def model(request):
    return clone(MODELS[request.param])


def test_a_weight_of_two_is_the_record_twice(model):
    first, second = record(0), record(1)
    X, y = stack_records([first, second], dt=DT)
    twice = stack_records([first, first, second], dt=DT)
    weights = np.repeat([2.0, 1.0], N)
    found, expected = (clone(model).fit(X, y, sample_weight=weights), clone(model).fit(*twice))
    np.testing.assert_allclose(found.coef_, expected.coef_, rtol=1e-6)
    if isinstance(model, NARMAXRegressor) and model.initial_output == "rest":
        np.testing.assert_allclose(found.noise_std_, expected.noise_std_, rtol=1e-6)
        np.testing.assert_allclose(found.coef_std_white_, expected.coef_std_white_, rtol=1e-6)


def test_what_stands_in_a_response_of_weight_zero_is_not_read(model):
    X, y = record(2)
    weights = np.ones(N)
    weights[[0, 70, 71, 200, N - 1]] = 0.0
    wrong = np.where(weights > 0.0, y, 1e3)
    found, expected = (clone(model).fit(X, own, sample_weight=weights) for own in (y, wrong))
    np.testing.assert_array_equal(found.coef_, expected.coef_)
    assert np.abs(found.coef_ - clone(model).fit(X, y).coef_).max() < 0.02
    assert found.output_range_[1] < 10.0


def test_lost_rows_cut_no_record(model):
    X, y = record(3, noise=0.0)
    kept = np.ones(N, dtype=bool)
    kept[[50, 51, 130, 260]] = False
    time = pd.Index(DT * np.arange(N), name="time")
    frame = pd.DataFrame(X, time, columns=["u"])[kept]
    found = model.fit(frame, pd.Series(y, time)[kept])
    assert [own.lost for own in found.records_] == [(50, 51, 130, 260)]
    step = found.predict_one_step(frame, y[kept])
    if found.objective == "one_step":  # which leaves out what is not known
        assert found.predict(frame) == pytest.approx(y[kept], abs=0.1)
        known = np.ones(N, dtype=bool)
        known[[52, 131, 261]] = False
        assert step[known[kept]] == pytest.approx(y[kept][known[kept]], abs=1e-6)
    # the response is not read there, but foretold, from a drive on a straight line
    assert np.abs(step - y[kept]).max() < 0.05


def test_errors_that_are_regressors_need_each_response():
    X, y = record(4)
    weights = np.random.default_rng(0).uniform(0.5, 2.0, N)
    model = NARMAXRegressor(1, noise_lags=(1,), **LAGS).fit(X, y, sample_weight=weights)
    assert model.fit(X, y).records_[0].n_samples == N
    weights[7] = 0.0
    with pytest.raises(ValueError, match=r"'noise_lags'.* Got 1 zero"):
        model.fit(X, y, sample_weight=weights)


def test_a_regressor_that_takes_no_weights():
    X, y = record(5)
    model = NARXRegressor(KNeighborsRegressor(3), **LAGS)
    one = np.where(np.arange(N) == 9, 0.0, 1.0)
    assert model.fit(X, y, sample_weight=one).estimator_.n_samples_fit_ == N - 3
    with pytest.raises(ValueError, match=r"whose fit takes none\. Got KNeighborsRegressor"):
        model.fit(X, y, sample_weight=np.linspace(1.0, 2.0, N) * one)


def test_no_sample_is_left():
    X, y = record(6)
    every_other = np.arange(N) % 2.0
    with pytest.raises(ValueError, match="must have a weight above zero"):
        NARXRegressor(LinearRegression()).fit(X, y, sample_weight=every_other)
