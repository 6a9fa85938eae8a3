"""Metrics: definitions, invariances, extreme units, what they accept and refuse."""

import numpy as np
import pandas as pd
import pytest
import sklearn.metrics
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.linear_model import LinearRegression
from sklearn.metrics import make_scorer, r2_score

from skhyst.metrics import fit_percent, mape, max_error, nrmse, smape

ALL = [fit_percent, mape, nrmse, smape]
PERFECT = {fit_percent: 100.0, mape: 0.0, nrmse: 0.0, smape: 0.0}
every_metric = pytest.mark.parametrize("metric", ALL)
signals = st.builds(
    lambda seed, scale, offset: scale * (np.random.default_rng(seed).normal(size=(20, 2)) + offset),
    st.integers(0, 2**32 - 1),
    st.floats(1e-9, 1e9),
    st.floats(-10, 10),
)


def responses(seed=0):
    rng = np.random.default_rng(seed)
    y = rng.uniform(1.0, 9.0, 50)
    return y, y + 0.3 * rng.normal(size=50)


def test_values_by_hand():
    y, p = np.array([2.0, 4.0, 10.0]), np.array([3.0, 4.0, 8.0])
    assert nrmse(y, p) == pytest.approx(np.sqrt(5 / 3) / 8)
    deviation = np.sqrt(np.sum((y - 16 / 3) ** 2))
    assert fit_percent(y, p) == pytest.approx(100 * (1 - np.sqrt(5) / deviation))
    assert mape(y, p) == pytest.approx(100 * (1 / 2 + 0 + 2 / 10) / 3)
    assert smape(y, p) == pytest.approx(100 * (1 / 2.5 + 0 + 2 / 9) / 3)


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_equal_to_scikit_learn_where_that_is_defined(seed):
    y, p = responses(seed)
    relative = sklearn.metrics.mean_absolute_percentage_error(y, p)
    assert mape(y, p) == pytest.approx(100 * relative, rel=1e-12)
    error = sklearn.metrics.root_mean_squared_error(y, p)
    assert nrmse(y, p) * np.ptp(y) == pytest.approx(error, rel=1e-12)
    assert fit_percent(y, p) == pytest.approx(100 * (1 - np.sqrt(1 - r2_score(y, p))))
    assert max_error is sklearn.metrics.max_error


def test_fit_percent_of_the_mean_is_zero_and_of_worse_is_negative():
    y, _ = responses()
    assert fit_percent(y, np.full_like(y, y.mean())) == pytest.approx(0.0, abs=1e-9)
    assert fit_percent(y, -y) < 0


@every_metric
@settings(deadline=None, max_examples=15)
@given(seed=st.integers(0, 2**32 - 1), unit=st.sampled_from([1e-300, 1e-12, 1.0, 1e9, 1e300]))
def test_neither_units_nor_the_order_of_samples_matter(metric, seed, unit):
    y, p = responses(seed)
    order = np.random.default_rng(seed).permutation(50)
    assert metric(unit * y[order], unit * p[order]) == pytest.approx(metric(y, p), rel=1e-9)
    assert metric(unit * y, unit * y) == PERFECT[metric]
    if metric in (nrmse, fit_percent):
        assert metric(y + 50.0, p + 50.0) == pytest.approx(metric(y, p), rel=1e-9)


@settings(deadline=None, max_examples=25)
@given(signals, signals, st.integers(0, 2**32 - 1))
def test_integer_weights_repeat_samples(y, p, seed):
    weights = np.random.default_rng(seed).integers(1, 4, len(y))
    for metric in ALL:
        repeated = metric(np.repeat(y, weights, axis=0), np.repeat(p, weights, axis=0))
        assert metric(y, p, sample_weight=weights) == pytest.approx(repeated, rel=1e-9)
    assert smape(y, p) == pytest.approx(smape(p, y))
    assert 0 <= smape(y, p) <= 200 * (1 + 1e-12)


def test_smape_where_both_are_zero_or_signs_differ():
    assert smape([0.0, 1.0], [0.0, 1.0]) == 0.0
    assert smape([0.0], [1e-300]) == 200.0
    assert smape([-1.0], [1.0]) == 200.0


@every_metric
def test_outputs_are_measured_one_by_one(metric):
    y, p = responses()
    both, guess = np.column_stack([y, y[::-1] + 1]), np.column_stack([p, p[::-1] + 2])
    raw = metric(both, guess, multioutput="raw_values")
    np.testing.assert_allclose(raw, [metric(both[:, i], guess[:, i]) for i in range(2)])
    assert metric(both, guess) == pytest.approx(raw.mean())
    assert metric(both, guess, multioutput=[3, 1]) == pytest.approx(raw @ [0.75, 0.25])


@every_metric
def test_lists_series_and_columns_are_the_same_and_stay_unchanged(metric):
    y, p = responses()
    before = y.copy(), p.copy()
    value = metric(y, p)
    assert metric(y.tolist(), p.tolist()) == value
    assert metric(y[:, None], p) == value
    # Rows are paired by position, not by index.
    assert metric(pd.Series(y), pd.Series(p, index=np.arange(50)[::-1])) == value
    np.testing.assert_array_equal((y, p), before)


@every_metric
def test_broken_arguments_are_refused_by_name(metric):
    y, p = responses()
    for bad in (np.nan, np.inf):
        broken = np.where(np.arange(50) == 7, bad, y)
        with pytest.raises(ValueError, match="y_true"):
            metric(broken, p)
        with pytest.raises(ValueError, match="y_pred"):
            metric(y, broken)
        with pytest.raises(ValueError, match="sample_weight"):
            metric(y, p, sample_weight=broken)
    times = pd.Index(0.1 * np.arange(50))
    with pytest.raises(ValueError, match="index of y_true and that of y_pred must be equal"):
        metric(pd.Series(y, times), pd.Series(p, times[::-1]))
    with pytest.raises(ValueError, match=r"values of y_pred must be known\. Got 2 masked"):
        metric(y, np.ma.array(p, mask=np.arange(50) < 2))
    with pytest.raises(ValueError, match="minimum of 1"):
        metric([], [])
    with pytest.raises(ValueError, match="inconsistent"):
        metric(y, y[:3])
    with pytest.raises(ValueError, match="outputs"):
        metric(y, np.column_stack([y, y]))
    with pytest.raises(ValueError, match="multioutput"):
        metric(y, y, multioutput="mean")


def test_what_an_error_cannot_be_relative_to_is_refused():
    for metric in (nrmse, fit_percent):
        with pytest.raises(ValueError, match=f"'y_true' parameter of {metric.__name__} must vary"):
            metric(np.ones(5), np.arange(5.0))
    with pytest.raises(ValueError, match=r"2 zero\(s\), the first one in row 1, .*smape"):
        mape([1.0, 0.0, -0.0], [1.0, 1.0, 1.0])


@every_metric
def test_metrics_make_scorers(metric):
    X, y = np.arange(1.0, 6.0)[:, None], np.arange(2.0, 12.0, 2.0)
    scorer = make_scorer(metric)
    found = scorer(LinearRegression().fit(X, y), X, y)
    assert found == pytest.approx(PERFECT[metric], abs=1e-9)
