"""The NARX model, against loops that call the regressor row by row."""

import pickle

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter
from sklearn.base import BaseEstimator, RegressorMixin, clone
from sklearn.compose import TransformedTargetRegressor
from sklearn.ensemble import (
    ExtraTreesRegressor,
    GradientBoostingRegressor,
    HistGradientBoostingRegressor,
    RandomForestRegressor,
)
from sklearn.linear_model import LinearRegression, Ridge
from sklearn.model_selection import GridSearchCV, LeaveOneGroupOut, cross_val_score
from sklearn.neighbors import KNeighborsRegressor
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import MinMaxScaler, PolynomialFeatures, StandardScaler
from sklearn.svm import SVR
from sklearn.tree import DecisionTreeRegressor
from sklearn.utils.estimator_checks import parametrize_with_checks

from skhyst.autoregressive import NARXRegressor
from skhyst.autoregressive._runs import Start
from skhyst.neural import SCNRegressor
from skhyst.preprocessing import PlayOperators
from skhyst.records import stack_records

pytestmark = pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")


def mlp(activation="relu", layers=(7, 5)):
    options = {"hidden_layer_sizes": layers, "activation": activation}
    return MLPRegressor(**options, max_iter=30, random_state=0)


def scn(activation, scaling):
    return SCNRegressor(12, activation=activation, scaling=scaling, random_state=0)


COMPILED = {
    "linear": LinearRegression(),
    "ridge behind a scaler": make_pipeline(StandardScaler(), Ridge(1e-3)),
    "polynomial": make_pipeline(PolynomialFeatures(2), LinearRegression()),
    "polynomial between scalers": make_pipeline(
        StandardScaler(), PolynomialFeatures(3), StandardScaler(), Ridge(1e-2)
    ),
    "relu": make_pipeline(MinMaxScaler(), mlp()),
    "tanh": TransformedTargetRegressor(mlp("tanh", (6,)), transformer=StandardScaler()),
    "logistic": mlp("logistic", (5, 4, 9)),
    "identity": mlp("identity"),
    "tree": DecisionTreeRegressor(max_leaf_nodes=40),
    "forest": make_pipeline(StandardScaler(), RandomForestRegressor(7, random_state=0)),
    "extra trees": ExtraTreesRegressor(5, random_state=0),
    "boosting": GradientBoostingRegressor(n_estimators=12),
    "boosting from zero": GradientBoostingRegressor(n_estimators=12, init="zero"),
    "histograms": HistGradientBoostingRegressor(max_iter=12),
    "search": GridSearchCV(Ridge(), {"alpha": [0.1, 1.0]}, cv=2),
    "sigmoid nodes": make_pipeline(StandardScaler(), scn("sigmoid", "standard")),
    "sigmoid nodes, whitened": scn("sigmoid", "whiten"),
    "Gaussian nodes": scn("rbf", "standard"),
    "Gaussian nodes, whitened": make_pipeline(StandardScaler(), scn("rbf", "whiten")),
}


INPUT_LAGS, OUTPUT_LAGS = {0: [0, 1, 3], 1: [0]}, [1, 2]


def narx(estimator=None, **options):
    options = {"input_lags": INPUT_LAGS, "output_lags": OUTPUT_LAGS} | options
    return NARXRegressor(estimator, **options)


def row_by_row(estimator, u, history):
    """The free run; the history has what was before the record, or its first samples too."""
    y, u = list(history), np.asarray(u)
    for k in range(len(history) - 2, len(u)):
        past = [u[max(k - lag, 0), column] for column in (0, 1) for lag in INPUT_LAGS[column]]
        row = [past + [y[k + 2 - lag] for lag in OUTPUT_LAGS]]
        y.append(float(np.ravel(estimator.predict(row))[0]))
    return np.array(y[2:])


@pytest.mark.parametrize("name", COMPILED)
def test_compiled_run_equals_row_by_row_and_python(name, data, drives, monkeypatch):
    model = narx(clone(COMPILED[name]), initial_output=[3.1, 2.9]).fit(*data)
    assert model.compiled_
    u = drives(60, 9)
    expected = row_by_row(model.estimator_, u, [2.9, 3.1])
    np.testing.assert_allclose(model.predict(u), expected, rtol=1e-9, atol=0)
    again = pickle.loads(pickle.dumps(model))
    np.testing.assert_array_equal(again.predict(u), model.predict(u))
    step, start = model._step, Start(u.to_numpy(), 3, np.array([2.9, 3.1]))
    if not hasattr(step, "_loop"):  # of the polynomials in test_loops
        return
    bounds = 1e9, 0.9 * np.abs(step.run(start, 1e9)[0]).max()
    compiled = [step.run(start, bound) for bound in bounds]
    monkeypatch.setattr(type(step), "_loop", staticmethod(step._loop.py_func))
    for (y, good), bound in zip(compiled, bounds, strict=True):
        plain, same = step.run(start, bound)
        assert good == same == (bound == 1e9)
        np.testing.assert_allclose(y, plain, rtol=1e-10, atol=1e-12)


class Halved(LinearRegression):
    """Predicts otherwise than its class, and is not read as such."""

    def predict(self, X):
        return 0.5 * super().predict(X)


@pytest.mark.parametrize(
    "estimator",
    [
        KNeighborsRegressor(3),
        SVR(C=10.0),
        Halved(),
        pytest.param(
            make_pipeline(PolynomialFeatures(2), KNeighborsRegressor(2)), marks=pytest.mark.slow
        ),
    ],
)
def test_any_regressor_runs_in_lock_step(estimator, data):
    model = narx(estimator, initial_output=3.0).fit(*data)
    assert not model.compiled_
    X = data[0]
    parts = [row_by_row(model.estimator_, X.loc[[r]], [3.0, 3.0]) for r in "abc"]
    np.testing.assert_allclose(model.predict(X), np.concatenate(parts), rtol=1e-12)


class Seen(RegressorMixin, BaseEstimator):
    def fit(self, X, y):
        self.seen_ = X, y
        return self

    def predict(self, X):
        return np.zeros(len(X))


def test_regression_has_no_lags_across_records_or_holes(data):
    X, y = data
    keep = np.r_[0:60, 75 : len(X)]
    model = narx(Seen()).fit(X.iloc[keep], y.iloc[keep])
    Z, target = model.estimator_.seen_
    expected = []
    for rows in (range(60), range(75, 150), range(150, 240), range(240, 360)):
        u, out = X.to_numpy()[rows], y.to_numpy()[rows]
        expected += [
            [u[k, 0], u[k - 1, 0], u[k - 3, 0], u[k, 1], out[k - 1], out[k - 2], out[k]]
            for k in range(3, len(rows))
        ]
    np.testing.assert_array_equal(np.column_stack([Z, target]), expected)
    a, b = X.columns
    inputs = [f"{a}(k)", f"{a}(k-1)", f"{a}(k-3)", f"{b}(k)"]
    assert model.lag_names_ == [*inputs, "y(k-1)", "y(k-2)"]


def test_an_estimator_predicts(data):
    with pytest.raises(ValueError, match="'estimator' parameter of NARXRegressor"):
        narx("ridge").fit(*data)


def test_coefficients_are_in_units_of_the_signals(data):
    X, y = data
    Z, target = narx(Seen()).fit(X, y).estimator_.seen_
    expected, *_ = np.linalg.lstsq(np.column_stack([np.ones(len(Z)), Z]), target)
    for estimator in (None, LinearRegression(), make_pipeline(StandardScaler(), Ridge(1e-9))):
        model = narx(estimator).fit(X, y)
        np.testing.assert_allclose([model.intercept_, *model.coef_], expected, rtol=1e-6)
    assert not hasattr(narx(KNeighborsRegressor(3)).fit(X, y), "coef_")


def test_oversampled_signals_keep_their_dynamics():
    """Neighbouring samples differ by 1e-6 of the range: the default is not cut off there."""
    u = np.sin(np.arange(4000) * 1e-3)[:, None]
    drive = np.append([0.0, 0.0], u[2:, 0])
    y = lfilter([0.005], [1.0, -1.9, 0.905], drive)
    model = NARXRegressor(input_lags=[0], output_lags=2).fit(u, y)
    np.testing.assert_allclose(model.coef_, [0.005, 1.9, -0.905], rtol=1e-4)


def test_exact_model_is_recovered_and_runs_freely(recordings):
    X, y = recordings(noise=0.0)
    model = NARXRegressor(
        make_pipeline(PolynomialFeatures(2), LinearRegression()),
        input_lags={0: [1], 1: [0]},
        output_lags=2,
        initial_output="measured",
    ).fit(X, y)
    np.testing.assert_allclose(model.predict(X, y), y, atol=1e-9)
    assert model.score(X, y) > 1 - 1e-12


# ------------------------------------------------------------------------------- initial outputs


@pytest.mark.parametrize("name", ["linear", "polynomial", "tanh", "relu"])
def test_rest_stays_at_rest(name, data):
    model = narx(clone(COMPILED[name])).fit(*data)
    y = model.predict(stack_records([np.tile([0.3, -0.2], (50, 1))]))
    np.testing.assert_allclose(y, y[0], rtol=1e-8)
    if name == "linear":
        weights, constant = model.coef_, model.intercept_
        level = (constant + weights[:4] @ [0.3, 0.3, 0.3, -0.2]) / (1.0 - weights[4:].sum())
        np.testing.assert_allclose(y, level, rtol=1e-9)


def test_integrator_starts_at_the_static_regression():
    rng = np.random.default_rng(0)
    u = rng.standard_normal((200, 1))
    y = 5.0 + np.cumsum(u[:, 0])
    model = NARXRegressor(input_lags=[0]).fit(u, y)
    slope, constant = np.polyfit(u[:, 0], y, 1)
    run = model.predict(u[:20] + 1.0)
    start = constant + slope * (u[0, 0] + 1.0)
    np.testing.assert_allclose(run, start + np.cumsum(u[:20, 0] + 1.0), rtol=1e-6)


def test_measured_start(data):
    X, y = data
    model = narx(initial_output="measured").fit(X, y)
    run = model.predict(X, y)
    out = y.loc["b"].to_numpy()
    np.testing.assert_array_equal(run[150:153], out[:3])
    known = row_by_row(model.estimator_, X.loc[["b"]], [0.0, 0.0, *out[:3]])
    np.testing.assert_allclose(run[150:240], known, rtol=1e-9)
    np.testing.assert_array_equal(
        model.predict(X), clone(model).set_params(initial_output="rest").fit(X, y).predict(X)
    )


def test_estimated_start_finds_the_outputs_before_the_record(data, drives):
    X, y = data
    model = narx(initial_output="estimate").fit(X, y)
    assert model.initial_outputs_.shape == (3, 2)
    u, history = drives(100, 4), [5.0, 4.0]
    truth = row_by_row(model.estimator_, u, history)
    np.testing.assert_allclose(model.predict(u, truth), truth, rtol=1e-6)
    assert model.score(u, truth) > 1 - 1e-9


# ---------------------------------------------------------------------------------- steps ahead


@pytest.mark.parametrize("name", ["polynomial", "neighbours"])
def test_steps_ahead_are_a_run_from_what_was_measured(name, data):
    X, y = data
    estimator = clone(COMPILED[name]) if name in COMPILED else KNeighborsRegressor(3)
    model = narx(estimator).fit(X, y)
    ahead, k = model.predict(X, y, horizon=4), 50
    past = [0.0, 0.0, *y.loc["b"].iloc[: k - 3]]
    run = row_by_row(model.estimator_, X.loc[["b"]].iloc[: k + 1], past)
    np.testing.assert_allclose(ahead[150 + k], run[k], rtol=1e-10)


def test_errors_grow_with_the_horizon(recordings):
    X, y = recordings(noise=0.05)
    model = narx().fit(X, y)
    errors = [np.std(model.predict(X, y, horizon=h) - y) for h in (1, 2, 4, 8)]
    assert errors == sorted(errors)


# ------------------------------------------------------------------------- properties and errors


@pytest.mark.parametrize("scale", [2.0**-30, 2.0**20])
def test_unit_equivariance(scale, data):
    X, y = data
    neighbours = make_pipeline(StandardScaler(), KNeighborsRegressor(3))
    for model in (narx(), narx(TransformedTargetRegressor(neighbours))):
        expected = clone(model).fit(X, y).predict(X)
        scaled = clone(model).fit(X, scale * y).predict(X)
        np.testing.assert_allclose(scaled, scale * expected, rtol=1e-9)
    drive = clone(narx()).fit(scale * X, y).predict(scale * X)
    np.testing.assert_allclose(drive, narx().fit(X, y).predict(X), rtol=1e-9)


def test_without_output_lags_it_is_a_static_map_of_the_inputs(data):
    X, y = data
    model = NARXRegressor(KNeighborsRegressor(3), input_lags=2, output_lags=[]).fit(X, y)
    np.testing.assert_array_equal(model.predict(X), model.predict(X, y, horizon=3))
    assert NARXRegressor(input_lags=2, output_lags=0).fit(X, y).score(X, y) > 0.3


# ----------------------------------------------------------------------------- scikit-learn tools


def test_grid_search_and_cross_validation(data):
    X, y = data
    groups = X.index.get_level_values("record")
    search = GridSearchCV(
        narx(Ridge()),
        {"estimator__alpha": [1e-6, 1e4], "output_lags": [1, 2]},
        cv=LeaveOneGroupOut(),
        error_score="raise",
    ).fit(X, y, groups=groups)
    assert search.best_params_ == {"estimator__alpha": 1e-6, "output_lags": 2}
    scores = cross_val_score(narx(), X, y, groups=groups, cv=LeaveOneGroupOut(), scoring="r2")
    assert scores.min() > 0.9


def test_behind_play_operators(data):
    X, _ = data
    y = pd.Series(
        PlayOperators(thresholds=[0.2, 0.6]).fit_transform(X).sum(axis=1).to_numpy(), X.index
    )
    plain = NARXRegressor(Ridge(1e-6)).fit(X, y).score(X, y)
    model = make_pipeline(
        PlayOperators(thresholds=[0.2, 0.6], include_drive=True), NARXRegressor(Ridge(1e-6))
    ).fit(X, y)
    assert model.score(X, y) > 0.999 > plain
    assert model[-1].lag_names_[2].endswith("play0(k)")


MEMORY = {
    "check_methods_sample_order_invariance": "the output depends on the past",
    "check_methods_subset_invariance": "the output depends on the past",
}

WEIGHTS = {
    "check_sample_weight_equivalence_on_dense_data": "the output depends on the past",
}


@pytest.mark.slow
@parametrize_with_checks(
    [NARXRegressor(KNeighborsRegressor(1)), NARXRegressor(objective="simulation")],
    expected_failed_checks=lambda _: MEMORY | WEIGHTS,
)
def test_scikit_learn_beyond_the_default(estimator, check):
    check(estimator)
