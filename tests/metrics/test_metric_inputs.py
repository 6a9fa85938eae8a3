"""Metrics: equality with scikit-learn, order of samples, and what they accept."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.metrics import mean_absolute_percentage_error, root_mean_squared_error

from skhyst.metrics import fit_percent, mape, nrmse, smape

ALL = [fit_percent, mape, nrmse, smape]


def responses(seed):
    rng = np.random.default_rng(seed)
    y = rng.uniform(1.0, 9.0, 50)
    return y, y + rng.normal(size=50)


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_equal_to_scikit_learn_where_that_is_defined(seed):
    y, p = responses(seed)
    assert mape(y, p) == pytest.approx(100 * mean_absolute_percentage_error(y, p), rel=1e-12)
    assert nrmse(y, p) * np.ptp(y) == pytest.approx(root_mean_squared_error(y, p), rel=1e-12)


@pytest.mark.parametrize("metric", ALL)
@settings(deadline=None, max_examples=15)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_order_of_samples_does_not_matter(metric, seed):
    y, p = responses(seed)
    order = np.random.default_rng(seed).permutation(50)
    assert metric(y[order], p[order]) == pytest.approx(metric(y, p), rel=1e-12)


@pytest.mark.parametrize("metric", ALL)
def test_lists_series_and_columns_are_the_same_and_stay_unchanged(metric):
    y, p = responses(0)
    before = y.copy(), p.copy()
    value = metric(y, p)
    assert metric(y.tolist(), p.tolist()) == value
    assert metric(y[:, None], p) == value
    # Rows are paired by position, not by index.
    assert metric(pd.Series(y), pd.Series(p, index=np.arange(50)[::-1])) == value
    np.testing.assert_array_equal((y, p), before)


@pytest.mark.parametrize("metric", ALL)
def test_broken_values_are_refused_by_name(metric):
    y, p = responses(0)
    for bad in (np.nan, np.inf):
        broken = np.where(np.arange(50) == 7, bad, y)
        with pytest.raises(ValueError, match="y_true"):
            metric(broken, p)
        with pytest.raises(ValueError, match="y_pred"):
            metric(y, broken)
        with pytest.raises(ValueError, match="sample_weight"):
            metric(y, p, sample_weight=broken)
    with pytest.raises(ValueError, match="minimum of 1"):
        metric([], [])
