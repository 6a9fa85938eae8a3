"""One model a device: each as if it were fitted alone, and no failure spreads."""

import numpy as np
import pandas as pd
import pytest
from sklearn.exceptions import NotFittedError

from skhyst.fleet import PerDevice
from skhyst.linear import FirstOrderLag, FirstOrderLagOperator, Gain
from skhyst.records import stack_records


def recording(time_constant, seed, n=200):
    rng = np.random.default_rng(seed)
    u = rng.normal(size=n).cumsum()
    y, _ = FirstOrderLagOperator(time_constant).run(u, 0.01)
    return u, y + 0.01 * rng.normal(size=n)


def fleet(constants=(0.03, 0.05, 0.08), days=2):
    """Index levels device, day, record, time."""
    keys = [(f"stage {i}", day) for i in range(len(constants)) for day in range(days)]
    made = {
        (device, day): stack_records(
            {"a": recording(constants[int(device[-1])] + 0.01 * day, 7 * day + int(device[-1]))},
            dt=0.01,
        )
        for device, day in keys
    }
    names = ["device", "day"]
    X = pd.concat({key: X for key, (X, _) in made.items()}, names=names)
    return X, pd.concat({key: y for key, (_, y) in made.items()}, names=names)


@pytest.mark.parametrize("n_jobs", [None, 2])
def test_each_device_is_fitted_as_if_alone(n_jobs):
    X, y = fleet()
    weights = pd.Series(np.random.default_rng(9).integers(1, 4, len(y)), y.index)
    model = PerDevice(FirstOrderLag(), ["device", "day"], n_jobs=n_jobs)
    model.fit(X, y, sample_weight=weights)
    assert model.params_.index.names == ["device", "day"]
    response = pd.Series(model.predict(X), X.index)
    for label in model.labels_:
        alone = FirstOrderLag().fit(X.loc[label], y.loc[label], weights.loc[label])
        assert dict(model.params_.loc[label]) == alone.params_
        assert dict(model.params_std_.loc[label]) == alone.params_std_
        np.testing.assert_array_equal(response.loc[label], alone.predict(X.loc[label]))


def test_the_days_of_a_device_are_records_that_it_keeps():
    X, y = fleet(days=1)
    X, y = X.droplevel("day"), y.droplevel("day")
    model = PerDevice(FirstOrderLag(), "device").fit(X, y)
    np.testing.assert_allclose(model.params_["time_constant"], [0.03, 0.05, 0.08], rtol=0.05)
    assert model.score(X, y) > 0.99


def test_a_failure_is_kept_with_its_message():
    X, y = fleet(days=1)
    y = y.copy()
    y.loc["stage 1"] = np.nan
    model = PerDevice(FirstOrderLag(), ["device", "day"]).fit(X, y)
    assert list(model.failures_) == [("stage 1", 0)]
    assert "NaN" in model.failures_["stage 1", 0]
    assert model.params_["time_constant"].isna().tolist() == [False, True, False]
    missing = pd.Series(model.predict(X), X.index).isna()
    assert missing.groupby(level="device").all().tolist() == [False, True, False]


def test_records_are_devices_where_nothing_is_said():
    X, y = stack_records({"a": recording(0.03, 0), "b": recording(0.05, 1)}, dt=0.01)
    model = PerDevice(FirstOrderLag()).fit(X, y.to_numpy())
    assert model.labels_ == ["a", "b"]
    alone = FirstOrderLag().fit(X.loc["b"], y.loc["b"])
    known = y.where(np.arange(len(y)) % 200 < 10)
    expected = alone.predict(X.loc["b"], known.loc["b"], return_std=True)
    found = model.predict(X, known, return_std=True)
    np.testing.assert_array_equal(np.array(found)[:, 200:], expected)
    with pytest.raises(ValueError, match="not fitted to the device 'c'"):
        model.predict(X.rename(index={"a": "c"}, level=0))


def test_what_does_not_fit_is_refused():
    X, y = stack_records({"a": recording(0.03, 0), "b": recording(0.05, 1)}, dt=0.01)
    with pytest.raises(ValueError, match=r"'level' .* not 'device'\. Got \['record', 'time'\]"):
        PerDevice(Gain(), "device").fit(X, y)
    with pytest.raises(ValueError, match="'level'"):
        PerDevice(Gain(), "device").fit(X.to_numpy(), y.to_numpy())
    with pytest.raises(NotFittedError):
        PerDevice(Gain()).predict(X)
    with pytest.raises(ValueError, match="NaN"):  # no device at all can be fitted
        PerDevice(Gain()).fit(X, y * np.nan)
