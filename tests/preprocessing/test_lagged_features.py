import numpy as np
import pandas as pd
import pytest

from skhyst.preprocessing import LaggedFeatures
from skhyst.records import stack_records

RAMP = np.arange(1.0, 6.0).reshape(-1, 1)


def test_lags_shift_and_repeat_the_first_value():
    Z = LaggedFeatures([0, 2, 9]).fit_transform(RAMP)
    np.testing.assert_array_equal(Z.T, [[1, 2, 3, 4, 5], [1, 1, 1, 2, 3], [1, 1, 1, 1, 1]])


def test_a_number_stands_for_all_lags_up_to_it():
    np.testing.assert_array_equal(
        LaggedFeatures(3).fit_transform(RAMP), LaggedFeatures([0, 1, 2, 3]).fit_transform(RAMP)
    )
    np.testing.assert_array_equal(LaggedFeatures(0).fit_transform(RAMP), RAMP)


def test_lags_of_each_column():
    X = pd.DataFrame({"drive": [1.0, 2.0, 3.0], "load": [7.0, 8.0, 9.0]})
    Z = LaggedFeatures({"load": [1], 0: 1}).fit_transform(X)
    assert list(Z.columns) == ["load_lag1", "drive_lag0", "drive_lag1"]
    np.testing.assert_array_equal(Z, [[7, 1, 1], [7, 2, 1], [8, 3, 2]])


def test_lags_stay_within_a_record():
    X = stack_records([RAMP, RAMP + 10.0])
    Z = LaggedFeatures([2]).fit_transform(X)["drive_lag2"]
    np.testing.assert_array_equal(Z, [1, 1, 1, 2, 3, 11, 11, 11, 12, 13])


@pytest.mark.parametrize(("before", "value"), [("zero", 0.0), ("nan", np.nan)])
def test_what_stands_before_a_record(before, value):
    Z = LaggedFeatures([0, 2, 9], before=before).fit_transform(RAMP)
    expected = np.transpose([[1, 2, 3, 4, 5], [value] * 2 + [1, 2, 3], [value] * 5])
    np.testing.assert_array_equal(Z, expected)


@pytest.mark.parametrize("lags", [[], [-1], [0.5], {0: []}, {0: [-2]}])
def test_lags_are_checked(lags):
    with pytest.raises(ValueError, match="'lags' parameter of LaggedFeatures"):
        LaggedFeatures(lags).fit(RAMP)
