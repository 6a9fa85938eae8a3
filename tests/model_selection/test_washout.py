"""The washout scorer: what it scores, its sign, and life inside scikit-learn."""

import pickle

import numpy as np
import pandas as pd
import pytest
from sklearn.base import BaseEstimator, RegressorMixin, clone
from sklearn.metrics import make_scorer, mean_squared_error, r2_score, root_mean_squared_error
from sklearn.model_selection import GridSearchCV, cross_validate
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skhyst.linear import FirstOrderLag, FirstOrderLagOperator
from skhyst.metrics import fit_percent, mape, max_error, nrmse, smape
from skhyst.model_selection import BlockedTimeSeriesSplit, washout_scorer
from skhyst.records import record_slices, stack_records


class Transient(RegressorMixin, BaseEstimator):
    """Right, but for an error of 1 in the first samples of each record it is asked to predict."""

    def __init__(self, length=5):
        self.length = length

    def fit(self, X, y):
        self.fitted_ = True
        return self

    def predict(self, X):
        y = np.asarray(X)[:, 0].copy()
        for record in record_slices(X):
            y[record.rows.start : record.rows.start + self.length] += 1.0
        return y


@pytest.fixture
def data():
    rng = np.random.default_rng(1)
    return stack_records([(u, u) for u in rng.standard_normal((3, 60))], dt=0.1)


def test_the_washout_of_every_record_is_left_out(data):
    X, y = data
    model = Transient(5).fit(X, y)
    assert washout_scorer(r2_score, washout=5)(model, X, y) == 1.0
    short = washout_scorer(mean_squared_error, washout=4, greater_is_better=False)(model, X, y)
    assert short == pytest.approx(-3 / (3 * 56))
    X, y = X.iloc[:63], y.iloc[:63]  # a record shorter than the washout does not count
    assert washout_scorer(r2_score, washout=5)(model, X, y) == 1.0
    with pytest.raises(ValueError, match="records of 60 samples at most"):
        washout_scorer(r2_score, washout=60)(model, X, y)


@pytest.mark.parametrize(
    ("metric", "sign"),
    [
        *((metric, 1) for metric in (r2_score, fit_percent)),
        *((metric, -1) for metric in (nrmse, smape, mape, max_error, mean_squared_error)),
    ],
)
def test_names_of_metrics_tell_what_is_better(metric, sign, data):
    X, y = data
    model = Transient(5).fit(X, y)
    plain = make_scorer(metric, greater_is_better=sign > 0)(model, X, y)
    assert plain == sign * metric(y, model.predict(X))
    assert washout_scorer(metric, washout=0)(model, X, y) == plain
    flipped = washout_scorer(metric, washout=0, greater_is_better=sign < 0)
    assert flipped(model, X, y) == -plain


@pytest.mark.parametrize(
    ("metric", "options", "name"),
    [
        (lambda y_true, y_pred: 0.0, {}, "greater_is_better"),
        (r2_score, {"greater_is_better": "yes"}, "greater_is_better"),
        ("r2", {}, "metric"),
        (r2_score, {"initial_state": "rest"}, "initial_state"),
        *((r2_score, {"washout": washout}, "washout") for washout in (-1, 1.5, None)),
    ],
)
def test_parameters_are_checked(metric, options, name):
    with pytest.raises(ValueError, match=f"'{name}' parameter of washout_scorer"):
        washout_scorer(metric, **{"washout": 0} | options)


def test_it_composes_with_blocks_on_frames_and_arrays(data):
    X, y = data
    cv = BlockedTimeSeriesSplit(3, washout=5)
    scoring = {
        name: washout_scorer(r2_score, washout=n) for name, n in (("clean", 5), ("early", 4))
    }
    scores = cross_validate(Transient(5), X, y, cv=cv, scoring=scoring)
    np.testing.assert_array_equal(scores["test_clean"], 1.0)
    assert (scores["test_early"] < 1.0).all()
    scores = cross_validate(Transient(5), X.to_numpy(), y.to_numpy(), cv=cv, scoring=scoring)
    np.testing.assert_array_equal(scores["test_clean"], 1.0)


def test_it_selects_in_a_grid_search(data):
    X, y = data
    scorer = washout_scorer(nrmse, washout=5, greater_is_better=False)
    cv = BlockedTimeSeriesSplit(3, washout=5)
    search = GridSearchCV(Transient(), {"length": [9, 2]}, scoring=scorer, cv=cv).fit(X, y)
    assert search.best_params_ == {"length": 2}
    assert clone(search).scoring.washout == 5


def test_options_reach_the_metric_and_it_pickles(data):
    X, y = data
    scorer = washout_scorer(r2_score, washout=5, multioutput="raw_values")
    assert scorer(Transient().fit(X, y), X, y).shape == (1,)
    assert repr(pickle.loads(pickle.dumps(scorer))) == (
        "washout_scorer(r2_score, washout=5, greater_is_better=True, multioutput='raw_values')"
    )


# ----------------------------------------------------------------- the state from the washout

DT, NOISE = 0.01, 2e-3
LAG = FirstOrderLagOperator(0.5)
MODEL = FirstOrderLag(dt=DT, initial_state="estimate")
STEPS = make_pipeline(StandardScaler(), MODEL).set_output(transform="pandas")


@pytest.fixture(scope="module")
def recording():
    rng = np.random.default_rng(0)
    u = np.cumsum(rng.normal(size=1200)) * 0.1
    return u[:, None], LAG.run(u, DT)[0] + NOISE * rng.normal(size=1200)


@pytest.mark.slow
def test_the_state_of_a_fold_comes_from_its_washout(recording):
    """A block that is cut out of a record begins under way; what is left is the noise."""
    X, y = recording
    options = {"cv": BlockedTimeSeriesSplit(4), "error_score": "raise"}

    def error(model, state="estimate"):
        scorer = washout_scorer(root_mean_squared_error, washout=30, initial_state=state)
        found = cross_validate(model, pd.DataFrame(X), y, scoring=scorer, **options)
        return -found["test_score"].mean()

    estimated = error(MODEL)
    assert estimated < 1.2 * NOISE < 5.0 * NOISE < error(MODEL, None)
    assert error(make_pipeline(MODEL)) == estimated
    assert error(STEPS) == pytest.approx(estimated, rel=0.02)


def test_what_is_scored_does_not_tell_the_state(recording):
    """Only the washout does: another response behind it changes no prediction."""
    X, y = recording
    model = FirstOrderLag(dt=DT).fit(X, y)
    seen = []

    def keep(y_true, y_pred):
        seen.append(y_pred)
        return 0.0

    scorer = washout_scorer(keep, washout=30, greater_is_better=True, initial_state="estimate")
    for response in (y, np.where(np.arange(len(y)) < 30, y, 7.0)):
        scorer(model, X[600:], np.r_[y[600:630], response[630:]])
    np.testing.assert_array_equal(*seen)
    known = np.r_[y[600:630], np.full(570, np.nan)]
    np.testing.assert_array_equal(seen[0], model.predict(X[600:], known)[30:])
    rest, estimated = (
        -washout_scorer(nrmse, washout=30, initial_state=own)(model, X[600:], y[600:])
        for own in (None, "estimate")
    )
    assert estimated < 0.1 * rest


def test_an_estimator_that_cannot_take_a_state(data):
    X, y = data
    scorer = washout_scorer(r2_score, washout=5, initial_state="estimate")
    assert "initial_state='estimate'" in repr(scorer)
    with pytest.raises(ValueError, match="does not take"):
        scorer(Transient().fit(X, y), X, y)
