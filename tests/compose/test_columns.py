"""Columns of X that drive models of their own, or scale those of the drive."""

import numpy as np
import pandas as pd
import pytest

from skhyst.compose import Modulated, OnColumn, ScheduledParameters, Sum
from skhyst.disturbance import Offset
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import FirstOrderLag, Gain

DT, N = 0.01, 400


def plays(u):
    y, out = 0.0, np.empty(len(u))
    for i, value in enumerate(u):
        y = max(value - 0.3, min(value + 0.3, y))
        out[i] = 0.6 * value + 0.4 * y
    return out


@pytest.fixture
def X():
    rng = np.random.default_rng(1)
    t = DT * np.arange(N)
    parts = []
    for k in range(3):
        drive = (0.5 + 0.25 * k) * np.sin(2 * np.pi * (1 + k) * t) * np.linspace(0, 1, N)
        load = np.interp(t, np.linspace(0, t[-1], 9), rng.normal(size=9))
        index = pd.MultiIndex.from_product([[k], t], names=["record", "time"])
        parts.append(pd.DataFrame({"drive": drive, "load": load}, index=index))
    return pd.concat(parts)


def by_record(X, law):
    return np.concatenate([law(part) for _, part in X.groupby(level="record")])


def thresholds():
    return PrandtlIshlinskii(thresholds=[0.0, 0.3])


def test_a_column_acts_through_a_lag_of_its_own(X):
    def law(part):
        load, state = part["load"].to_numpy(), part["load"].iloc[0]
        out = np.empty(N)
        a, tau = np.exp(-DT / 0.1), 0.1
        for i, value in enumerate(load):
            if i:  # exact for a straight line between samples
                slope = (value - load[i - 1]) / DT
                state = a * (state - load[i - 1] + slope * tau) + value - slope * tau
            out[i] = state
        return plays(part["drive"].to_numpy()) + 0.8 * out

    y = by_record(X, law)
    model = Sum([("drive", thresholds()), ("load", OnColumn(FirstOrderLag(), 1))]).fit(X, y)
    assert model.operators_["load"].operator.time_constant == pytest.approx(0.1, rel=1e-6)
    assert model.operators_["load"].operator.gain == pytest.approx(0.8, rel=1e-6)
    np.testing.assert_allclose(model.predict(X), y, atol=1e-8)


def test_a_column_scales_the_response_beside_an_offset(X):
    def law(part):
        scaled = plays(part["drive"].to_numpy()) * (1.0 + 0.2 * part["load"].to_numpy())
        return scaled + part.index[0][0]

    y = by_record(X, law)
    model = Sum([("model", Modulated(thresholds(), 1)), ("offset", Offset())]).fit(X, y)
    operator = model.operators_["model"]
    slope = operator.sensitivity / (1.0 - operator.sensitivity * operator.reference)
    assert slope == pytest.approx(0.2, rel=1e-6)


def test_the_amplitude_and_a_column_scale_the_response(X):
    amplitude = X["drive"].groupby(level="record").transform(np.ptp) / 2
    factor = (1.0 + 0.3 * amplitude) * (1.0 - 0.2 * X["load"])
    y = by_record(X, lambda part: plays(part["drive"].to_numpy())) * factor
    for model in (
        Modulated(Modulated(thresholds(), "amplitude"), 1),
        Modulated(Modulated(thresholds(), 1), "amplitude"),
    ):
        model.fit(X, y)
        np.testing.assert_allclose(model.predict(X), y, atol=1e-8)
        np.testing.assert_allclose(model.predict(X.loc[[2]]), y.loc[[2]], atol=1e-8)
        assert {"sensitivity", "sensitivity_2"} <= set(model.params_)


def test_scheduled_parameters_beside_a_column_and_an_offset(X):
    def law(part):
        drive = part["drive"].to_numpy()
        gain = 1.0 + 0.5 * np.ptp(drive) / 2
        return gain * drive + 0.4 * part["load"].to_numpy()

    y = by_record(X, law)
    steps = [
        ("drive", ScheduledParameters(Gain(), parameters=["gain"])),
        ("load", OnColumn(Gain(), 1)),
    ]
    np.testing.assert_allclose(Sum(steps).fit(X, y).predict(X), y, atol=1e-8)
    both = Sum([*steps, ("offset", Offset())]).fit(X, y)
    np.testing.assert_allclose(both.predict(X), y, atol=1e-8)


@pytest.mark.parametrize("kind", [OnColumn, Modulated])
def test_wrong_columns_and_models(kind, X):
    y = X["drive"]
    with pytest.raises(ValueError, match="column"):
        kind(Gain(), 2).fit(X, y)
    with pytest.raises(ValueError, match="column"):
        kind(Gain(), "load").fit(X, y)
