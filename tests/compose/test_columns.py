"""Columns of X that drive models of their own, or scale those of the drive."""

import numpy as np
import pandas as pd
import pytest

from skhyst.compose import (
    Cascade,
    Modulated,
    OnColumn,
    ScheduledParameters,
    Sum,
)
from skhyst.disturbance import Offset
from skhyst.hysteresis import PrandtlIshlinskii, PrandtlIshlinskiiOperator
from skhyst.linear import (
    FirstOrderLag,
    FirstOrderLagOperator,
    Gain,
    GainOperator,
    SecondOrderMode,
    SecondOrderModeOperator,
)
from skhyst.operators import (
    OnColumnOperator,
    Scaled,
    Scheduled,
    SumOperator,
    check_operator,
)
from skhyst.persistence import from_json, to_json

DT, N = 0.01, 400


LAG = FirstOrderLagOperator(0.05, gain=1.2)
PLAYS = PrandtlIshlinskiiOperator([0.0, 0.3], [0.6, 0.4])


def plays(part):
    return PLAYS.run(part["drive"].to_numpy(), DT)[0]


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


def test_tangents_are_those_of_the_drive():
    """What moves the drive does not move a further column."""
    u, along = np.random.default_rng(0).normal(size=(2, N, 2))
    along[:, 1] = 0.0
    both = SumOperator(
        ("drive", "load"), (OnColumnOperator(LAG, 0), OnColumnOperator(GainOperator(3.0), 1))
    )
    ends = [both.run(u + way * along, DT)[0] for way in (0.5, -0.5)]  # it is linear
    _, dy = both.sensitivities(u, along[:, :1], DT)
    np.testing.assert_allclose(dy[:, 0], ends[0] - ends[1], atol=1e-12)


def test_a_column_acts_through_a_lag_of_its_own(X):
    lag = FirstOrderLagOperator(0.1, 0.8)
    y = by_record(X, lambda part: plays(part) + lag.run(part["load"].to_numpy(), DT)[0])
    model = Sum([("drive", thresholds()), ("load", OnColumn(FirstOrderLag(), 1))]).fit(X, y)
    assert model.operators_["load"].operator.time_constant == pytest.approx(0.1, rel=1e-6)
    assert model.operators_["load"].operator.gain == pytest.approx(0.8, rel=1e-6)
    np.testing.assert_allclose(model.predict(X), y, atol=1e-8)


@pytest.mark.parametrize("centered", [False, True])
def test_a_column_acts_on_what_goes_into_a_mode_behind_it(X, centered):
    """In a unit of its own, so that its reference is far from zero."""
    X = X.assign(load=20.0 + X["load"])
    reference = X["load"].mean() if centered else 0.0
    mode = SecondOrderModeOperator(9.0, 0.3, 2.0, 0.5)

    def law(part):
        bias = 0.3 * (part["load"].to_numpy() - reference)
        return mode.run(part["drive"].to_numpy() + bias, DT)[0]

    y = by_record(X, law)
    load = OnColumn(Gain(fit_intercept=False), 1, centered=centered)
    drive = Sum([("drive", Gain(fit_intercept=False)), ("load", load)])
    model = Cascade([("input", drive), ("mode", SecondOrderMode())]).fit(X, y)
    branch = model.operators_["input"].stages[1]
    assert branch.reference == pytest.approx(reference)
    assert branch.operator.gain == pytest.approx(0.3, rel=1e-6)
    assert model.operators_["mode"].gain == pytest.approx(2.0, rel=1e-6)
    np.testing.assert_allclose(model.predict(X), y, atol=1e-8 * np.ptp(y))


def test_a_column_scales_the_response_beside_an_offset(X):
    y = by_record(X, lambda part: plays(part) * (1.0 + 0.2 * part["load"]) + part.index[0][0])
    model = Sum([("model", Modulated(thresholds(), 1)), ("offset", Offset())]).fit(X, y)
    operator = model.operators_["model"]
    slope = operator.sensitivity / (1.0 - operator.sensitivity * operator.reference)
    assert slope == pytest.approx(0.2, rel=1e-6)


def test_the_amplitude_and_a_column_scale_the_response(X):
    amplitude = X["drive"].groupby(level="record").transform(np.ptp) / 2
    factor = (1.0 + 0.3 * amplitude) * (1.0 - 0.2 * X["load"])
    y = by_record(X, plays) * factor
    for model in (
        Modulated(Modulated(thresholds(), "amplitude"), 1),
        Modulated(Modulated(thresholds(), 1), "amplitude"),
    ):
        model.fit(X, y)
        np.testing.assert_allclose(model.predict(X), y, atol=1e-8)
        np.testing.assert_allclose(model.predict(X.loc[[2]]), y.loc[[2]], atol=1e-8)
        assert {"sensitivity", "sensitivity_2"} <= set(model.params_)


def test_what_came_before_a_record_of_several_columns(X):
    """Where a column scales the response, the record begins as its known part says."""
    law = FirstOrderLagOperator(0.5)
    y = by_record(X, lambda part: law.run(part["drive"].to_numpy(), DT)[0] * (2.0 + part["load"]))
    noise = np.random.default_rng(0).normal(0.0, 0.01, len(y))
    model = Modulated(FirstOrderLag(), column=1).fit(X, y + noise)
    late, expected = X.loc[[2]][200:], y[-200:]
    known = np.where(np.arange(200) < 50, expected + noise[-200:], np.nan)
    found, std = model.predict(late, known, return_std=True)
    assert np.abs(found - expected).max() < 0.05 < np.abs(model.predict(late) - expected).max()
    assert np.mean(np.abs(noise[-200:] + expected - found) < 1.96 * std) > 0.9
    later = model.stepper_from(late[:50], known[:50]).run(late.to_numpy()[50:])
    np.testing.assert_allclose(later, found[50:], atol=1e-12)


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
    for column in (2, "load"):
        with pytest.raises(ValueError, match="column"):
            kind(Gain(), column).fit(X, y)


# --------------------------------------------------------------------------------- the operators


OPERATORS = {
    "column": OnColumnOperator(LAG, 1),
    "modulated": Scaled(OnColumnOperator(PLAYS, 0), 2, 0.4, 0.3),
    "modulated twice": Scaled(Scaled(OnColumnOperator(PLAYS, 0), 2, 0.4, 0.3), 1, -0.1, 0.2),
    "sum": SumOperator(
        ("model", "load"),
        (
            Scaled(OnColumnOperator(LAG, 0), -1, 0.1, -0.2),
            OnColumnOperator(GainOperator(0.7), 1),
        ),
    ),
}


U = np.cumsum(np.random.default_rng(0).normal(size=(80, 3)), axis=0) / 5


def test_a_column_drives_the_operator():
    expected, _ = LAG.run(U[:, 1], DT, LAG.init(U[0, 1]))
    found = OnColumnOperator(LAG, 1)
    np.testing.assert_array_equal(found.run(U, DT, found.init(U[0]))[0], expected)


def test_modulation_scales_the_output():
    expected = PLAYS.run(U[:, 0], DT)[0] * (1.0 + 0.3 * (U[:, 2] - 0.4))
    found = OPERATORS["modulated"]
    np.testing.assert_allclose(found.run(U, DT, found.init(U[0]))[0], expected, rtol=1e-14)


@pytest.mark.parametrize("name", OPERATORS)
def test_derivatives_and_pieces(name):
    check_operator(OPERATORS[name], U, DT)


def test_a_scheduled_operator_within_takes_the_number_of_the_record():
    scheduled = Scheduled.constant(LAG, (1, 0, 0), 1.0, 3.0)
    x = scheduled.pack()
    x[:2] = 0.05, 0.15
    inside = SumOperator(
        ("model", "load"),
        (OnColumnOperator(scheduled.unpack(x), 0), OnColumnOperator(GainOperator(0.0), 1)),
    )
    own = inside.at(2.0)
    expected = FirstOrderLagOperator(0.1, gain=1.2).run(U[:, 0], DT)[0]
    np.testing.assert_allclose(own.run(U, DT, own.init(U[0]))[0], expected, rtol=1e-12)


def lagged_gain(n, noise=0.0, time_constant=0.4, seed=0):
    """Return X and y of a gain that a coil's current sets, behind the coil's voltage, (n, 2)."""
    rng = np.random.default_rng(seed)
    drive = np.sin(0.21 * np.arange(n)) + 0.3 * rng.normal(size=n)
    voltage = np.repeat(rng.uniform(1.0, 3.0, n // 50), 50)  # steps, each at one sample
    current, now = [], voltage[0]
    for before, after in zip(np.append(voltage[0], voltage[:-1]), voltage, strict=True):
        # exact for a straight line between the samples
        slope, fade = (after - before) / DT, np.exp(-DT / time_constant)
        now = after - slope * time_constant + (now - before + slope * time_constant) * fade
        current.append(now)
    y = (2.0 * drive + 0.5) * (1.0 + 0.25 * (np.array(current) - 2.0))
    return np.column_stack([drive, voltage]), y + noise * rng.normal(size=n)


def test_a_column_scales_behind_a_lag():
    X, y = lagged_gain(1000)
    model = Modulated(Gain(), 1, lag=True, dt=DT).fit(X, y)
    np.testing.assert_allclose(model.predict(X), y, atol=1e-6)
    assert model.operator_.lag.time_constant == pytest.approx(0.4, rel=1e-4)
    assert model.params_["lag_time_constant"] == pytest.approx(0.4, rel=1e-4)
    at_two = 1.0 + model.operator_.sensitivity * (2.0 - model.operator_.reference)
    assert model.operator_.sensitivity / at_two == pytest.approx(0.25, rel=1e-4)
    check_operator(model.operator_, X[:60], DT)
    stepper = model.stepper(u0=X[0])
    np.testing.assert_allclose([stepper.step(row) for row in X], y, atol=1e-6)
    again = from_json(to_json(model))
    np.testing.assert_array_equal(again.predict(X), model.predict(X))
    assert Modulated(Gain(), 1, dt=DT).fit(X, y).fit_error_ > 0.02


def test_a_lag_of_the_column_is_a_part_of_the_tree():
    operator = Scaled(OnColumnOperator(GainOperator(2.0), 0), 1, 2.0, 0.25, LAG)
    tree = Modulated(Gain(), 1, lag=True).tree(operator)
    assert tree.estimator().lag is True
    keys = tree.keys()
    assert len(keys) == tree.n_parameters
    assert ("lag of column 1", "time_constant") in keys
