"""Metrics: definitions, invariances, extreme units and refusals."""

import numpy as np
import pytest
import sklearn.metrics
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.linear_model import LinearRegression
from sklearn.metrics import make_scorer, r2_score

from skhyst.metrics import fit_percent, mape, max_error, nrmse, smape

ALL = [fit_percent, mape, nrmse, smape]
PERFECT = {fit_percent: 100.0, mape: 0.0, nrmse: 0.0, smape: 0.0}
signals = st.builds(
    lambda seed, scale, offset: scale * (np.random.default_rng(seed).normal(size=(20, 2)) + offset),
    st.integers(0, 2**32 - 1),
    st.floats(1e-9, 1e9),
    st.floats(-10, 10),
)


@pytest.fixture
def pair():
    rng = np.random.default_rng(0)
    y = rng.uniform(1.0, 9.0, 200)
    return y, y + 0.3 * rng.standard_normal(200)


def test_values_by_hand():
    y, p = np.array([2.0, 4.0, 10.0]), np.array([3.0, 4.0, 8.0])
    assert nrmse(y, p) == pytest.approx(np.sqrt(5 / 3) / 8)
    deviation = np.sqrt(np.sum((y - 16 / 3) ** 2))
    assert fit_percent(y, p) == pytest.approx(100 * (1 - np.sqrt(5) / deviation))
    assert mape(y, p) == pytest.approx(100 * (1 / 2 + 0 + 2 / 10) / 3)
    assert smape(y, p) == pytest.approx(100 * (1 / 2.5 + 0 + 2 / 9) / 3)


def test_percentages_are_a_hundred_times_those_of_the_paper(pair):
    y, p = pair
    assert mape(y, p) == pytest.approx(100 * np.mean(np.abs((p - y) / y)))
    assert smape(y, p) == pytest.approx(100 * np.mean(np.abs(p - y) / ((p + y) / 2)))


def test_fit_percent_is_a_function_of_r2(pair):
    y, p = pair
    assert fit_percent(y, p) == pytest.approx(100 * (1 - np.sqrt(1 - r2_score(y, p))))


def test_fit_percent_of_the_mean_is_zero_and_of_worse_is_negative(pair):
    y, _ = pair
    assert fit_percent(y, np.full_like(y, y.mean())) == pytest.approx(0.0, abs=1e-9)
    assert fit_percent(y, -y) < 0


@pytest.mark.parametrize("metric", ALL)
def test_a_perfect_prediction(metric, pair):
    assert metric(pair[0], pair[0]) == PERFECT[metric]


@pytest.mark.parametrize("metric", ALL)
@pytest.mark.parametrize("unit", [1e-300, 1e-12, 1e9, 1e300])
def test_units_do_not_matter(metric, unit, pair):
    y, p = pair
    assert metric(unit * y, unit * p) == pytest.approx(metric(y, p), rel=1e-9)


@pytest.mark.parametrize("metric", [nrmse, fit_percent])
def test_offset_does_not_matter(metric, pair):
    y, p = pair
    assert metric(y + 50.0, p + 50.0) == pytest.approx(metric(y, p), rel=1e-9)


@settings(deadline=None, max_examples=40)
@given(signals, signals)
def test_smape_is_symmetric_and_bounded(y, p):
    assert smape(y, p) == pytest.approx(smape(p, y))
    assert 0 <= smape(y, p) <= 200 * (1 + 1e-12)


@settings(deadline=None, max_examples=25)
@given(signals, signals, st.integers(0, 2**32 - 1))
def test_integer_weights_repeat_samples(y, p, seed):
    weights = np.random.default_rng(seed).integers(1, 4, len(y))
    for metric in ALL:
        repeated = metric(np.repeat(y, weights, axis=0), np.repeat(p, weights, axis=0))
        assert metric(y, p, sample_weight=weights) == pytest.approx(repeated, rel=1e-9)


@pytest.mark.parametrize("metric", ALL)
def test_outputs_are_measured_one_by_one(metric, pair):
    y, p = pair
    both, guess = np.column_stack([y, y[::-1] + 1]), np.column_stack([p, p[::-1] + 2])
    raw = metric(both, guess, multioutput="raw_values")
    np.testing.assert_allclose(raw, [metric(both[:, i], guess[:, i]) for i in range(2)])
    assert metric(both, guess) == pytest.approx(raw.mean())
    assert metric(both, guess, multioutput=[3, 1]) == pytest.approx(raw @ [0.75, 0.25])


@pytest.mark.parametrize("metric", [nrmse, fit_percent])
def test_a_constant_response_is_refused(metric):
    with pytest.raises(ValueError, match=f"'y_true' parameter of {metric.__name__} must vary"):
        metric(np.ones(5), np.arange(5.0))


def test_mape_refuses_zeros_and_names_the_row():
    with pytest.raises(ValueError, match=r"2 zero\(s\), the first one in row 1, .*smape"):
        mape([1.0, 0.0, -0.0], [1.0, 1.0, 1.0])


def test_smape_where_both_are_zero_or_signs_differ():
    assert smape([0.0, 1.0], [0.0, 1.0]) == 0.0
    assert smape([0.0], [1e-300]) == 200.0
    assert smape([-1.0], [1.0]) == 200.0


@pytest.mark.parametrize("metric", ALL)
def test_broken_arguments_are_refused(metric):
    y = np.arange(1.0, 5.0)
    with pytest.raises(ValueError, match="NaN"):
        metric(y, [1.0, np.nan, 3.0, 4.0])
    with pytest.raises(ValueError, match="inconsistent"):
        metric(y, y[:3])
    with pytest.raises(ValueError, match="outputs"):
        metric(y, np.column_stack([y, y]))
    with pytest.raises(ValueError, match="multioutput"):
        metric(y, y, multioutput="mean")


def test_max_error_is_that_of_scikit_learn():
    assert max_error is sklearn.metrics.max_error


@pytest.mark.parametrize("metric", [nrmse, mape, smape])
def test_metrics_make_scorers(metric):
    X, y = np.arange(1.0, 6.0)[:, None], np.arange(2.0, 12.0, 2.0)
    scorer = make_scorer(metric, greater_is_better=False)
    assert scorer(LinearRegression().fit(X, y), X, y) == pytest.approx(0.0, abs=1e-9)
