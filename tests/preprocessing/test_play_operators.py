"""Plays and stops as features: thresholds, names, agreement with the model."""

import numpy as np
import pytest

from skhyst.hysteresis import PrandtlIshlinskiiOperator
from skhyst.operators import play_thresholds
from skhyst.preprocessing import PlayOperators, StopOperators
from skhyst.records import stack_records

X = np.random.default_rng(0).standard_normal((200, 2))


def test_features_are_those_of_the_model():
    transformer, weights = PlayOperators(7).fit(X), np.arange(1.0, 8.0)
    thresholds = transformer.thresholds_[0]
    expected, _ = PrandtlIshlinskiiOperator(thresholds, weights).run(X[:, 0], 1.0)
    np.testing.assert_allclose(transformer.transform(X) @ weights, expected, atol=1e-12)
    thresholds = [0.2, 1.0, 0.5]
    plays = PlayOperators(thresholds=thresholds).fit_transform(X)
    stops = StopOperators(thresholds=thresholds, include_drive=False).fit_transform(X)
    np.testing.assert_allclose(plays + stops, np.repeat(X[:, :1], 3, axis=1), atol=1e-15)


def test_default_thresholds():
    transformer = PlayOperators(5, columns=[0, 1]).fit(X)
    for row, column in zip(transformer.thresholds_, X.T, strict=True):
        np.testing.assert_array_equal(row, play_thresholds(column, 5))
    np.testing.assert_array_equal(transformer.transform(X)[:, [0, 5]], X)
    stops = StopOperators(5, spacing="quantile").fit(X)
    assert stops.thresholds_.shape == (1, 5)
    assert stops.thresholds_[0, 0] > 0.0


def test_thresholds_see_the_records():
    # Concatenated, the two records would span 100; each for itself moves by 1.
    records = stack_records([np.array([0.0, 1.0, 0.0]), np.array([100.0, 99.0, 100.0])])
    assert PlayOperators(4).fit(records).thresholds_.max() == 0.75


def test_drive_comes_first():
    Z = PlayOperators(3, include_drive=True, columns=[1, 0]).fit(X)
    np.testing.assert_array_equal(Z.transform(X)[:, [0, 4]], X[:, [1, 0]])
    names = Z.get_feature_names_out(["a", "b"])
    assert list(names[[0, 1, 4, 5]]) == ["b", "b_play0", "a", "a_play0"]


@pytest.mark.parametrize("thresholds", [[], [-1.0], [np.nan], [[0.0, 1.0]]])
@pytest.mark.parametrize("kind", [PlayOperators, StopOperators])
def test_thresholds_are_checked(kind, thresholds):
    with pytest.raises(ValueError, match=f"'thresholds' parameter of {kind.__name__}"):
        kind(thresholds=thresholds).fit(X)
