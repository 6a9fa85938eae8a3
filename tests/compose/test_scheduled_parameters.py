"""Parameters that depend on the record: recovered, within bounds, and refused where they cannot."""

import pickle

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import Polynomial
from sklearn.frozen import FrozenEstimator
from sklearn.utils._param_validation import InvalidParameterError

from skhyst.compose import Cascade, ScheduledParameters, Sum
from skhyst.disturbance import Offset
from skhyst.exceptions import ConvergenceWarning, ExtrapolationWarning, RecordError
from skhyst.hysteresis import PrandtlIshlinskii, PrandtlIshlinskiiOperator
from skhyst.linear import (
    FirstOrderLag,
    FirstOrderLagOperator,
    Gain,
    KelvinVoigtOperator,
    SecondOrderMode,
    SecondOrderModeOperator,
)
from skhyst.operators import Scheduled, Series
from skhyst.records import stack_records

DT = 0.01


def drive(seed, n=400):
    return np.cumsum(np.random.default_rng(seed).normal(size=n)) / 5


def recording(law, amplitudes=(1.0, 2.0, 3.5, 5.0), noise=0.0, seed=0):
    """Records of a plant whose operator is ``law(amplitude)``."""
    rng = np.random.default_rng(seed)
    records = []
    for i, amplitude in enumerate(amplitudes):
        u = drive(10 * seed + i)
        u *= amplitude / (0.5 * np.ptp(u))
        y, _ = law(amplitude).run(u, DT)
        records.append((u, y + noise * rng.normal(size=len(u))))
    return stack_records(records, dt=DT)


def mode(amplitude):
    """A stiffness that falls with the amplitude, as a piezo's does."""
    return SecondOrderModeOperator(60.0 - 4.0 * amplitude, 0.1, gain=1.0 + 0.2 * amplitude)


@pytest.mark.filterwarnings("ignore:No one set of parameters")
def test_a_mode_that_moves_with_the_amplitude():
    X, y = recording(mode, noise=1e-3)
    model = ScheduledParameters(SecondOrderMode(), parameters=["natural_frequency", "gain"])
    model.fit(X, y)
    np.testing.assert_allclose(model.schedule_, [1.0, 2.0, 3.5, 5.0])
    np.testing.assert_allclose(model.polynomials_["natural_frequency"], [60.0, -4.0], rtol=1e-3)
    np.testing.assert_allclose(model.polynomials_["gain"], [1.0, 0.2], rtol=1e-3)
    assert model.polynomials_["damping_ratio"].shape == (1,)
    # ends of the range
    assert model.params_["natural_frequency[0]"] == pytest.approx(56.0, rel=1e-3)
    assert model.params_["natural_frequency[1]"] == pytest.approx(40.0, rel=1e-3)
    assert model.fit_error_ == pytest.approx(1e-3, rel=0.05)
    new_X, new_y = recording(mode, amplitudes=(2.7,), seed=5)
    error = np.std(model.predict(new_X) - new_y)
    assert error < 1e-3
    with pytest.warns(ConvergenceWarning, match="No one set of parameters of SecondOrderMode"):
        constant = SecondOrderMode().fit(X, y)
    assert np.std(constant.predict(new_X) - new_y) > 20 * error


@pytest.mark.slow
def test_standard_errors_cover():
    hits = []
    for seed in range(12):
        X, y = recording(mode, noise=0.02, seed=seed)
        model = ScheduledParameters(SecondOrderMode(fit_intercept=False)).fit(X, y)
        truth = {"natural_frequency": (56.0, 40.0), "damping_ratio": (0.1, 0.1), "gain": (1.2, 2.0)}
        hits += [
            abs(model.params_[f"{name}[{k}]"] - value) < 1.96 * model.params_std_[f"{name}[{k}]"]
            for name, values in truth.items()
            for k, value in enumerate(values)
        ]
    assert 0.85 <= np.mean(hits) <= 1.0


def test_weights_stay_non_negative_over_the_range():
    def plays(amplitude):
        return PrandtlIshlinskiiOperator([0.0, 0.4], [1.0, 0.5 - 0.1 * amplitude])

    X, y = recording(plays)
    base = PrandtlIshlinskii(thresholds=[0.0, 0.4], fit_intercept=False)
    model = ScheduledParameters(base).fit(X, y)
    np.testing.assert_allclose(model.polynomials_["weights[1]"], [0.5, -0.1], atol=1e-6)
    for amplitude in np.linspace(1.0, 5.0, 7):
        assert np.all(model.operator_.at(amplitude).operator.weights >= 0.0)
    # beyond the range the polynomial goes on, up to the bound
    assert model.operator_.at(9.0).operator.weights[1] == 0.0


def test_a_column_schedules_a_cascade():
    records, hysteresis = [], PrandtlIshlinskiiOperator([0.0, 0.5], [1.0, 0.4])
    for i, temperature in enumerate((10.0, 25.0, 40.0)):
        lag = FirstOrderLagOperator(0.02 + 0.001 * temperature)
        u = drive(i, 600)
        y, _ = lag.run(hysteresis.run(u, DT)[0], DT)
        frame = pd.DataFrame({"voltage": u, "temperature": temperature})
        records.append((frame, y))
    X, y = stack_records(records, dt=DT)
    plays = PrandtlIshlinskii(thresholds=[0.0, 0.5])
    cascade = Cascade([("plays", plays), ("lag", FirstOrderLag())])
    own = {"parameters": ["lag__time_constant"]}
    model = ScheduledParameters(cascade, by="temperature", **own).fit(X, y)
    np.testing.assert_allclose(model.polynomials_["lag__time_constant"], [0.02, 0.001], rtol=1e-3)
    np.testing.assert_allclose(model.predict(X), y, atol=1e-4)
    again = pickle.loads(pickle.dumps(model))
    np.testing.assert_array_equal(again.predict(X), model.predict(X))
    number = ScheduledParameters(cascade, by=1, **own).fit(X, y)
    np.testing.assert_allclose(number.predict(X), model.predict(X), atol=1e-6)


def test_a_part_that_is_known_has_no_polynomial():
    u = drive(9)
    lag = FirstOrderLagOperator(0.05)
    known = FrozenEstimator(FirstOrderLag(dt=DT).fit(u[:, None], lag.run(u, DT)[0]))
    plays = PrandtlIshlinskii(thresholds=[0.0, 0.5])

    def law(amplitude):
        own = PrandtlIshlinskiiOperator([0.0, 0.5], [1.0 + 0.2 * amplitude, 0.4])
        return Series(("plays", "lag"), (own, lag))

    X, y = recording(law)
    model = ScheduledParameters(Cascade([("plays", plays), ("lag", known)])).fit(X, y)
    assert all(name.startswith("plays") for name in model.params_)
    np.testing.assert_allclose(model.predict(X), y, atol=1e-6)
    with pytest.raises(ValueError, match="has no free parameter"):
        ScheduledParameters(Cascade([("lag", known)])).fit(X, y)


def test_the_parameters_of_what_is_inside_are_checked():
    X, y = recording(mode)
    plays = PrandtlIshlinskii(n_operators=[0.0, 0.5])
    for model in (ScheduledParameters(plays), Cascade([("plays", plays)]), Sum([("plays", plays)])):
        with pytest.raises(InvalidParameterError, match="'n_operators' parameter of Prandtl"):
            model.fit(X, y)


def test_degree_two():
    def lag(amplitude):
        return FirstOrderLagOperator(0.1, gain=1.0 + 0.3 * amplitude - 0.02 * amplitude**2)

    X, y = recording(lag)
    model = ScheduledParameters(FirstOrderLag(), degree=2, parameters=["gain"]).fit(X, y)
    np.testing.assert_allclose(model.polynomials_["gain"], [1.0, 0.3, -0.02], atol=1e-5)


def test_one_amplitude_does_not_determine_a_slope():
    X, y = recording(mode, amplitudes=(2.0,), noise=1e-3)
    model = ScheduledParameters(SecondOrderMode(), parameters=["gain"])
    with pytest.warns(ConvergenceWarning, match=r"gain\[1\]"):
        model.fit(X, y)
    assert "gain[1]" in model.identifiability_["undetermined"]


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"by": "temperature"}, RecordError, "constant in each record"),
        ({"by": "load"}, ValueError, "'by' parameter"),
        ({"by": 3}, ValueError, "'by' parameter"),
        ({"parameters": ["gian"]}, ValueError, "'gian'"),
        (
            {"estimator": Sum([("gain", Gain()), ("offset", Offset())])},
            ValueError,
            "coefficients for each record",
        ),
        ({"degree": -1}, ValueError, "'degree' parameter"),
    ],
)
def test_wrong_parameters_are_refused(options, error, message):
    X, y = recording(mode)
    X = X.assign(temperature=np.linspace(0.0, 1.0, len(X)))
    model = ScheduledParameters(**{"estimator": SecondOrderMode(), **options})
    with pytest.raises(error, match=message):
        model.fit(X, y)


def test_inside_a_cascade_it_says_where_it_belongs():
    X, y = recording(mode)
    inside = Cascade([("mode", ScheduledParameters(SecondOrderMode())), ("lag", FirstOrderLag())])
    with pytest.raises(ValueError, match="outermost"):
        inside.fit(X, y)


@pytest.mark.parametrize("of", [lambda own: own, lambda own: Sum([("own", own), ("at", Offset())])])
def test_an_amplitude_that_was_not_measured_is_told(of):
    """Also of a linear model, which any drive of one amplitude would tell as much of."""
    X, y = recording(lambda amplitude: FirstOrderLagOperator(0.1, gain=1.0 + 0.2 * amplitude))
    model = of(ScheduledParameters(FirstOrderLag(), parameters=["gain"])).fit(X, y)
    model.predict(0.6 * X)  # 0.6 to 3 of 1 to 5: quiet
    told = "depend on an amplitude, or a column, from 1 to 5"
    with pytest.warns(ExtrapolationWarning, match=told):
        model.predict(1.5 * X)
    with pytest.warns(ExtrapolationWarning, match=told):
        model.stepper(schedule=0.1)


# --------------------------------------------------------------------------------- the operator


@settings(deadline=None, max_examples=25)
@given(st.lists(st.floats(0.1, 5.0), min_size=3, max_size=3), st.floats(2.0, 7.0))
def test_a_parameter_stays_between_its_coefficients_on_its_polynomial(coefficients, schedule):
    operator = Scheduled(
        FirstOrderLagOperator(0.1), (2, 0, 0), np.array([*coefficients, 1.0, 0.0]), 2.0, 7.0
    )
    value = operator.at(schedule).operator.time_constant
    assert min(coefficients) - 1e-12 <= value <= max(coefficients) + 1e-12
    polynomial = Polynomial(operator.polynomials()["time_constant"])
    assert polynomial(schedule) == pytest.approx(value, rel=1e-9, abs=1e-9)
    assert operator.at(2.0).operator.time_constant == pytest.approx(coefficients[0])
    assert operator.at(7.0).operator.time_constant == pytest.approx(coefficients[2])


@pytest.mark.parametrize("schedule", [0.0, 3.5, 12.0])
def test_beyond_the_range_a_parameter_follows_its_polynomial_up_to_its_bound(schedule):
    creep, values = KelvinVoigtOperator(np.array([0.1]), np.array([0.5])), [0.3, 0.2, 0.5, 1.0, 0.0]
    operator = Scheduled(creep, (1, 0, 0, 0), np.array(values), 2.0, 4.0)
    [value] = operator.at(schedule).operator.compliances
    assert value == pytest.approx(max(0.3 - 0.05 * (schedule - 2.0), 0.0))
