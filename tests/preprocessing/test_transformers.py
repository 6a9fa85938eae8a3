"""What holds for every transformer."""

import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone
from sklearn.linear_model import LinearRegression
from sklearn.model_selection import GridSearchCV, LeaveOneGroupOut
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils.estimator_checks import parametrize_with_checks

from skhyst.exceptions import RecordError
from skhyst.preprocessing import (
    GeneralizedInputGradient,
    LaggedFeatures,
    PlayOperators,
    StopOperators,
)
from skhyst.records import stack_records

VARIANTS = [
    PlayOperators(3, spacing="quantile", include_drive=True),
    StopOperators(thresholds=[0.5, 1.0], include_drive=False),
    LaggedFeatures([0, 3], before="zero"),
    GeneralizedInputGradient("forward", include_drive=False),
]
TRANSFORMERS = [
    *(PlayOperators(4), StopOperators(4), LaggedFeatures(), LaggedFeatures([0, 3, 7])),
    *(GeneralizedInputGradient(turning_points=3), *VARIANTS),
]
MEMORY = ("check_methods_sample_order_invariance", "check_methods_subset_invariance")


@pytest.mark.slow  # of the defaults test_common checks it
@parametrize_with_checks(
    VARIANTS,
    expected_failed_checks=lambda estimator: dict.fromkeys(MEMORY, "samples before it matter"),
)
def test_sklearn(estimator, check):
    check(estimator)


@pytest.fixture(params=TRANSFORMERS, ids=str)
def transformer(request):
    return clone(request.param)


def recordings(n_records=3, n_columns=2, dt=0.01):
    rng = np.random.default_rng(0)
    return stack_records(
        [np.cumsum(rng.standard_normal((40 + 9 * k, n_columns)), 0) for k in range(n_records)],
        labels=list("abcdefgh"[:n_records]),
        dt=dt,
    )


def test_frame_in_frame_out(transformer):
    X = recordings()
    Z = transformer.fit_transform(X)
    assert isinstance(Z, pd.DataFrame)
    pd.testing.assert_index_equal(Z.index, X.index)
    assert list(Z.columns) == list(transformer.get_feature_names_out())
    assert len(set(Z.columns)) == Z.shape[1]
    pd.testing.assert_frame_equal(transformer.set_output(transform="pandas").transform(X), Z)


def test_array_in_array_out(transformer):
    X = recordings(1).to_numpy()
    Z = transformer.fit(X).transform(X)
    assert isinstance(Z, np.ndarray)
    frame = transformer.set_output(transform="pandas").transform(X)
    assert isinstance(frame, pd.DataFrame)
    np.testing.assert_array_equal(frame, Z)
    assert frame.columns[0].startswith("x0")


def test_every_record_starts_anew(transformer):
    X = recordings()
    Z = transformer.fit(X).transform(X)
    for label in "abc":
        pd.testing.assert_frame_equal(transformer.transform(X.loc[[label]]), Z.loc[[label]])
    behind_a_hole = transformer.transform(X.drop(X.index[20:25])).iloc[20 : len(X.loc["a"]) - 5]
    pd.testing.assert_frame_equal(behind_a_hole, transformer.transform(X.loc[["a"]].iloc[25:]))
    other = pd.concat([X.loc[[label]] for label in "cab"])
    permuted = clone(transformer).fit(other).transform(other)
    pd.testing.assert_frame_equal(permuted.loc[X.index], Z, rtol=1e-13)


def test_causality(transformer):
    X = recordings(1)
    changed = X.copy()
    changed.iloc[25:] += 3.0
    transformer.fit(X)
    seen = 24 if getattr(transformer, "method", "") == "forward" else 25
    pd.testing.assert_frame_equal(
        transformer.transform(X).iloc[:seen], transformer.transform(changed).iloc[:seen]
    )


def test_inputs_are_left_alone(transformer):
    X = recordings()
    before = X.copy()
    transformer.fit(X).transform(X)
    pd.testing.assert_frame_equal(X, before)
    array = X.to_numpy().copy()
    array.flags.writeable = False
    transformer.fit(array).transform(array)


@pytest.mark.parametrize("unit", [1e-120, 1e120])
def test_unit_equivariance(transformer, unit):
    X = recordings()
    Z = clone(transformer).fit(X).transform(X)
    thresholds = transformer.get_params().get("thresholds")
    if thresholds is not None:
        transformer.set_params(thresholds=np.array(thresholds) * unit)
    scaled = transformer.fit(X * unit).transform(X * unit)
    np.testing.assert_allclose(scaled / unit, Z, rtol=0, atol=1e-10 * np.abs(Z).max().max())


def test_columns_by_name_and_position(transformer):
    X = recordings(n_columns=3)
    swapped = X[["auxiliary2", "drive", "auxiliary1"]]
    expected = clone(transformer).fit(X).transform(X)
    for column in ("drive", 1, -2):
        chosen = clone(transformer).set_params(columns=column)
        pd.testing.assert_frame_equal(chosen.fit(swapped).transform(swapped), expected)
    both = transformer.set_params(columns=["drive", "auxiliary1"]).fit(X).transform(X)
    pd.testing.assert_frame_equal(both[expected.columns], expected, rtol=1e-13)
    assert both.shape[1] == 2 * expected.shape[1]


@pytest.mark.parametrize("columns", [2, -3, "nothing", [0, 2], [], [0.5]])
def test_unknown_columns(transformer, columns):
    with pytest.raises(ValueError, match="'columns' parameter of"):
        transformer.set_params(columns=columns).fit(recordings())


def test_lost_index_is_refused(transformer):
    X = recordings()
    y = X["drive"]
    with pytest.raises(RecordError, match="set_output"):
        transformer.fit(X.to_numpy(), y)


def test_pipeline_and_grid_search():
    X = recordings(4, 1)
    y = PlayOperators(thresholds=[0.0, 1.5]).fit_transform(X) @ np.array([1.0, 0.8])
    # No centring: the virgin device rests at zero.
    scaler = StandardScaler(with_mean=False).set_output(transform="pandas")
    model = make_pipeline(scaler, PlayOperators(), LinearRegression())
    search = GridSearchCV(model, {"playoperators__n_operators": [1, 30]}, cv=LeaveOneGroupOut())
    search.fit(X, y, groups=X.index.get_level_values("record"))
    assert search.best_params_ == {"playoperators__n_operators": 30}
    assert search.best_score_ > 0.99
