"""Several responses whose models have parameters in common."""

import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone
from sklearn.linear_model import Ridge

from skhyst.compose import Cascade, ScheduledParameters, SharedParameters, Sum
from skhyst.compose._shared_parameters import _factors, _power, _starts
from skhyst.disturbance import Offset
from skhyst.hysteresis import FreeMassOperator, PrandtlIshlinskii
from skhyst.hysteresis import PrandtlIshlinskiiOperator as Plays
from skhyst.linear import (
    FirstOrderLag,
    FirstOrderLagOperator,
    Gain,
    SecondOrderMode,
    TransferFunction,
    TransferFunctionOperator,
)
from skhyst.linear import SecondOrderModeOperator as Mode
from skhyst.operators import FeedbackOperator, Series, check_operator
from skhyst.persistence import from_json, to_json
from skhyst.static import PolynomialCurveOperator as Curve

DT = 0.01
PLAYS = Plays([0.0, 0.5], [1.0, 0.4])
SPRING = Curve(np.array([0.0, 0.2]), 0.0, 1.0)


def drive(n=800, seed=0):
    return np.cumsum(np.random.default_rng(seed).normal(size=n)) / 5


def modes(numerator):
    linear = np.array([]), np.array([40.0, 90.0]), np.array([0.1, 0.05])
    return TransferFunctionOperator(*linear, np.array(numerator), 1.0)


def model(*steps):
    return Cascade([("plays", PrandtlIshlinskii(thresholds=[0.0, 0.5])), *steps], dt=DT)


def two_points(noise, seed=0):
    """Return the drive, and the responses of a hysteretic structure at two of its points."""
    u, rng = drive(), np.random.default_rng(seed)
    force = PLAYS.run(u, DT)[0]
    points = [modes(own).run(force, DT)[0] for own in ([0.01, 2e-4, 1e-5], [-0.01, 1e-4, -1e-5])]
    y = np.column_stack([points[0], 3e-6 - 2e-6 * points[1]])
    return u[:, None], y + noise * y.std(axis=0) * rng.normal(size=y.shape)


def test_modes_of_a_hysteretic_structure_at_two_points():
    """Standard errors hold, and are smaller than those of a response alone."""
    X, y = two_points(0.01)
    declared = model(("modes", TransferFunction(4, n_zeros=3)))
    shared = SharedParameters(declared, own=["modes__numerator"]).fit(X, y)
    one, two = shared.estimators_
    alone = declared.fit(X, y[:, 1])
    assert shared.gains_[0] == 1.0
    assert abs(shared.gains_[1] / -2e-6 - 1.0) < 0.02
    for i, (frequency, damping) in enumerate(((40.0, 0.1), (90.0, 0.05))):
        for name, value in (("natural_frequencies", frequency), ("damping_ratios", damping)):
            key = f"modes__{name}[{i}]"
            assert key in shared.shared_
            assert one.params_[key] == two.params_[key]
            assert abs(one.params_[key] - value) < 4.0 * one.params_std_[key]
            assert two.params_std_[key] < 0.9 * alone.params_std_[key]
    assert "modes__numerator[0]" not in shared.shared_
    for k, own in enumerate(shared.estimators_):
        weights = [own.params_[f"plays__weights[{i}]"] for i in range(2)]
        expected = np.array([1.0, 0.4]) * (1.0, -2e-6)[k]
        np.testing.assert_allclose(weights, expected, rtol=0.02)
        assert shared.error_alone_[k] <= own.fit_error_ < 1.05 * shared.error_alone_[k]
    np.testing.assert_allclose(two.params_["plays__intercept"], 3e-6, rtol=0.02)
    found, std = shared.predict(X, return_std=True)
    assert found.shape == std.shape == y.shape
    assert 0.9 < np.mean(np.abs(y - found) < 1.96 * std) < 0.99


def test_the_derivatives_of_the_joint_operator():
    """By differences, of each response."""
    X, y = two_points(0.01)
    declared = model(("modes", TransferFunction(4, n_zeros=3)))
    alone = [clone(declared).fit(X, own) for own in y.T]
    for start in _starts(alone, ["modes__numerator"], np.array([0.05, 1e-7])):
        for k in range(2):
            check_operator(start.at(k), X[:60, 0], DT)


@pytest.mark.parametrize("gain", [3.0, -0.7])
@pytest.mark.parametrize(
    "operator",
    [
        FreeMassOperator(0.5, 0.8, friction=1.0, cubic_stiffness=0.2, center=0.1, intercept=0.2),
        Series(("plays", "mode"), (PLAYS, Mode(60.0, 0.1))),
        FeedbackOperator(("linear", "curve"), (Mode(30.0, 0.2), SPRING)),
    ],
    ids=["mass", "hysteresis and mode", "curved spring"],
)
def test_a_gain_of_the_response_is_that_of_values_in_its_unit(operator, gain):
    """A mass per drive is divided by it, a weight is multiplied."""
    if gain < 0.0 and hasattr(operator, "mass"):
        pytest.skip("a mass has a sign")
    u, specs = 3.0 * drive(200), [spec for _, spec in operator.entries()]
    power = np.array([_power(spec.unit) for spec in specs])
    factors = _factors(gain, power, np.array([spec.log for spec in specs]))
    y, other = (own.run(u, DT)[0] for own in (operator, operator.unpack(factors * operator.pack())))
    np.testing.assert_allclose(other, gain * y, rtol=1e-9, atol=1e-9 * np.ptp(y))


def test_a_response_that_does_not_share_is_told_by_its_error():
    u = drive(300)
    y = np.column_stack([Mode(40.0, 0.1).run(u, DT)[0], Mode(55.0, 0.1).run(u, DT)[0]])
    y += 1e-3 * np.random.default_rng(1).normal(size=y.shape)
    shared = SharedParameters(SecondOrderMode(dt=DT)).fit(u[:, None], y)
    assert all(own.fit_error_ > 10.0 * shared.error_alone_.max() for own in shared.estimators_)
    apart = SharedParameters(SecondOrderMode(dt=DT), own=["natural_frequency"]).fit(u[:, None], y)
    assert all(own.fit_error_ < 1.1e-3 for own in apart.estimators_)
    assert apart.shared_ == ("damping_ratio", "gain")


def test_records_names_files_and_what_goes_on():
    X, y = two_points(0.01)
    index = pd.MultiIndex.from_arrays([np.repeat([0, 1], 400), np.tile(DT * np.arange(400), 2)])
    index.names = ["record", "time"]
    X, y = pd.DataFrame(X, index), pd.DataFrame(y, index, columns=["a", "b"])
    own = Cascade([("plays", PrandtlIshlinskii(3)), ("mode", SecondOrderMode())])
    shared = SharedParameters(own).fit(X, y)
    again = from_json(to_json(shared))
    np.testing.assert_array_equal(again.predict(X), shared.predict(X))
    stepper = shared.estimators_[1].stepper(u0=X.iloc[0, 0])
    np.testing.assert_allclose(
        stepper.run(X.iloc[:400, 0]), shared.predict(X)[:400, 1], atol=1e-12 * np.ptp(y["b"])
    )
    known = y.where(np.repeat(np.arange(800)[:, None] % 400 < 30, 2, axis=1))
    assert shared.predict(X, y_start=known).shape == (800, 2)
    with pytest.raises(ValueError, match=r"must have 2 column\(s\)"):
        shared.predict(X, y_start=known["a"])


def test_what_cannot_be_shared_is_refused():
    X, y = two_points(0.01)
    X, y = X[:200], y[:200]
    for wrong, why, kind in (
        (SharedParameters(Ridge()), "must be a parametric model of skhyst", TypeError),
        (SharedParameters(Gain(), own=["w"]), "free parameters of the model: gain", ValueError),
        (SharedParameters(Sum([("g", Gain()), ("o", Offset())])), "no additive", ValueError),
        (SharedParameters(Gain(initial_state="estimate")), "'rest' or 'zero'", ValueError),
        (SharedParameters(ScheduledParameters(Gain(), degree=0)), "not depend on", ValueError),
    ):
        with pytest.raises(kind, match=why):
            wrong.fit(X, y)


@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ConvergenceWarning")
@pytest.mark.parametrize("silent", [0, 1])
def test_a_silent_response_does_not_spoil_the_other(silent):
    X, y = two_points(0.01)
    X, y = X[:300], y[:300]
    y[:, silent] = 3.0
    shared = SharedParameters(model()).fit(X, y)
    np.testing.assert_allclose(shared.predict(X)[:, silent], 3.0, atol=1e-6)
    other = 1 - silent
    assert shared.estimators_[other].fit_error_ < (1.0 + 1e-6) * shared.error_alone_[other]


def test_responses_of_weight_zero_are_not_read():
    u = drive(200)
    weights = np.repeat([1.0, 0.0, 1.0], [80, 40, 80])
    lag = FirstOrderLagOperator(0.05).run(u, DT)[0] + 1e-3 * np.cos(np.arange(200.0))
    y = np.column_stack([lag, -2.0 * lag])
    spoilt = np.where(weights[:, None], y, 1e6)
    found = [
        SharedParameters(FirstOrderLag(dt=DT)).fit(u[:, None], own, sample_weight=weights)
        for own in (y, spoilt)
    ]
    np.testing.assert_array_equal(found[1].predict(u[:, None]), found[0].predict(u[:, None]))
    assert found[1].estimators_[0].params_["time_constant"] == pytest.approx(0.05, rel=0.02)
    assert found[1].estimators_[0].fit_error_ < 1e-3
