"""The hold of the drive that a fit finds by itself, on data held by steps and by lines."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lsim
from sklearn.frozen import FrozenEstimator

from skhyst.compose import Cascade, OnColumn, Sum
from skhyst.diagnosis import EffectSearchCV
from skhyst.fluid import TankChainOperator
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import (
    FirstOrderLag,
    FirstOrderLagOperator,
    KelvinVoigtOperator,
    LogCreep,
    LogCreepOperator,
    MultiInputTransferFunctionOperator,
    SecondOrderMode,
    SecondOrderModeOperator,
    TransferFunction,
    TransferFunctionOperator,
    frequency_response,
)
from skhyst.operators import Stepper, check_operator
from skhyst.records import stack_records

DT, TAU, OMEGA, ZETA = 0.01, 0.03, 60.0, 0.2
LAG = ([1.0], [TAU, 1.0])
MODE = ([OMEGA**2], [1.0, 2.0 * ZETA * OMEGA, OMEGA**2])
HOLDS = ["foh", "zoh"]


def response(system, u, hold):
    """Return what a continuous-time system at rest makes of a drive that is held so."""
    _, y, _ = lsim(system, u - u[0], DT * np.arange(len(u)), interp=hold == "foh")
    gain = system[0][-1] / system[1][-1]
    return y + gain * u[0]


@pytest.fixture
def u():
    return np.cumsum(np.random.default_rng(0).normal(size=600)) / 5


@pytest.mark.parametrize("hold", HOLDS)
@pytest.mark.parametrize(
    ("model", "system", "expected"),
    [
        (FirstOrderLag, LAG, {"time_constant": TAU}),
        (SecondOrderMode, MODE, {"natural_frequency": OMEGA, "damping_ratio": ZETA}),
        (TransferFunction, MODE, {"natural_frequencies[0]": OMEGA, "damping_ratios[0]": ZETA}),
    ],
)
def test_the_hold_of_the_data_is_found_with_the_parameters(model, system, expected, hold, u):
    y = response(system, u, hold)
    found = model(hold="auto", dt=DT).fit(u[:, None], y)
    assert found.operator_.hold == hold
    assert found.hold == "auto"
    for name, value in expected.items():
        assert found.params_[name] == pytest.approx(value, rel=1e-4)
    other = model(hold=HOLDS[1 - HOLDS.index(hold)], dt=DT).fit(u[:, None], y)
    assert other.fit_error_ > 10.0 * found.fit_error_
    np.testing.assert_allclose(found.predict(u[:, None]), y, atol=1e-4 * np.ptp(y))


@pytest.mark.parametrize("hold", HOLDS)
def test_the_first_dynamics_of_a_series_take_the_hold_and_those_behind_a_straight_line(hold, u):
    # the lag between the samples is no straight line, but nearly one for a slow lag
    fine = 50
    held = np.interp(np.arange(fine * len(u)) / fine, np.arange(len(u)), u)
    held = held if hold == "foh" else np.repeat(u, fine)
    time = DT / fine * np.arange(len(held))
    _, x, _ = lsim(LAG, held - u[0], time, interp=hold == "foh")
    _, y, _ = lsim(MODE, x, time)
    y = (y + u[0])[::fine]
    steps = [
        ("plays", PrandtlIshlinskii(thresholds=[0.0])),
        ("lag", FirstOrderLag(hold="auto")),
        ("mode", SecondOrderMode(hold="auto")),
    ]
    model = Cascade(steps, dt=DT).fit(u[:, None], y)
    assert model.operators_["lag"].hold == hold
    assert model.operators_["mode"].hold == "foh"
    # the two may have changed nothing but the order of their product
    assert model.params_["mode__natural_frequency"] == pytest.approx(OMEGA, rel=0.05)
    assert model.params_["lag__time_constant"] == pytest.approx(TAU, rel=0.05)


@pytest.mark.parametrize("hold", HOLDS)
def test_what_is_parallel_sees_the_same_drive(hold, u):
    X = np.column_stack([u, np.roll(u, 7)])
    y = response(LAG, u, hold) + response(MODE, X[:, 1], hold)
    steps = [
        ("drive", FirstOrderLag(hold="auto")),
        ("other", OnColumn(SecondOrderMode(hold="auto"), 1)),
    ]
    model = Sum(steps, dt=DT).fit(X, y)
    assert model.operators_["drive"].operator.hold == hold
    assert model.operators_["other"].operator.hold == hold
    assert model.params_["drive__time_constant"] == pytest.approx(TAU, rel=1e-3)


def test_a_step_that_is_held_keeps_its_hold(u):
    moved = response(LAG, u, "zoh")
    lag = FirstOrderLag(dt=DT, hold="auto").fit(u[:, None], moved)
    steps = [("lag", FrozenEstimator(lag)), ("mode", SecondOrderMode(hold="auto"))]
    model = Cascade(steps, dt=DT).fit(u[:, None], response(MODE, moved, "foh"))
    assert model.operators_["lag"] is lag.operator_
    assert model.operators_["mode"].hold == "foh"


def test_logarithmic_creep_finds_it_too(u):
    time = DT * np.arange(1, len(u) + 1)
    changes = np.diff(u, prepend=u[0])
    y = u.copy()
    for k in np.flatnonzero(changes):  # each step creeps from the moment when it is made
        y[k:] += changes[k] * 0.1 * np.log10(1.0 + (time[: len(u) - k] - DT) / 0.05)
    model = LogCreep(dt=DT, hold="auto").fit(u[:, None], y)
    assert model.operator_.hold == "zoh"
    assert model.params_["creep"] == pytest.approx(0.1, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("hold", HOLDS)
def test_a_declared_auto_is_what_was_fitted_in_a_search(hold):
    rng, pairs = np.random.default_rng(1), []
    for _ in range(4):
        u = np.cumsum(rng.normal(size=400)) / 5
        y = response(LAG, u, hold) + 1e-3 * rng.normal(size=400)
        pairs.append((u, np.minimum(y, np.quantile(y, 0.9))))
    X, y = stack_records(pairs, dt=DT)
    effects = ["timing", "output_saturation", "delay"]
    search = EffectSearchCV(FirstOrderLag(hold="auto"), effects=effects, random_state=0).fit(X, y)
    assert search.effects_ == ["output_saturation"]
    assert search.declared_estimator_.operator_.hold == hold
    assert search.best_estimator_.operators_["first_order_lag"].hold == hold
    assert search.best_estimator_.get_params()["first_order_lag__hold"] == hold


def test_what_no_record_can_decide_is_refused(u):
    with pytest.raises(ValueError, match=r"'hold' must be 'foh' or 'zoh' here.*'auto' instead"):
        FirstOrderLagOperator(TAU, hold="auto").run(u, DT)
    with pytest.raises(ValueError, match="'hold' must be 'foh' or 'zoh' here"):
        TransferFunction.from_system(MODE, hold="auto")
    measured = frequency_response(u[:, None], response(MODE, u, "foh"), dt=DT)
    with pytest.raises(ValueError, match="'hold' must be 'foh' or 'zoh' here"):
        TransferFunction(hold="auto").fit_frequency_response(measured)
    with pytest.raises(ValueError, match="'hold' parameter of FirstOrderLag"):
        FirstOrderLag(hold="both").fit(u[:, None], u)


POLES = np.array([0.05]), np.array([OMEGA]), np.array([ZETA])
HELD = [
    FirstOrderLagOperator(TAU, gain=2.0, intercept=0.5),
    KelvinVoigtOperator(np.array([0.2]), np.array([0.1])),
    LogCreepOperator(0.1, time_constant=0.02, intercept=0.5),
    SecondOrderModeOperator(OMEGA, ZETA, intercept=-1.0),
    TankChainOperator(np.array([0.1, 0.2]), np.array([0.5, 1.0]), gain=2.0, intercept=0.5),
    TransferFunctionOperator(*POLES, np.array([0.3, 0.2, 0.1])),
]
SERIES = HELD[-1] | FirstOrderLagOperator(TAU) | LogCreepOperator(0.1, time_constant=0.02)


@pytest.mark.parametrize("operator", HELD, ids=lambda o: type(o).__name__)
def test_no_ramp_leads_to_a_start_from_zero(operator):
    """A constant drive is a straight line and held: both holds start alike, at the first sample."""
    u, levels = np.ones(50), []
    for hold in HOLDS:
        own = replace(operator, hold=hold)
        levels.append(own.run(u, DT, own.init(1.0, "zero"))[0])
        stepper = Stepper(own.compiled_step(DT, own.init(1.0, "zero")))
        np.testing.assert_allclose([stepper.step(v) for v in u], levels[-1], rtol=1e-12)
    np.testing.assert_allclose(*levels, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("operator", [*HELD, SERIES], ids=lambda o: type(o).__name__)
def test_a_start_from_zero_keeps_the_protocol(operator, u):
    check_operator(operator, 2.0 + u[:60], DT)


def test_several_inputs_start_from_zero_as_the_sum_of_single_ones(u):
    several = MultiInputTransferFunctionOperator(
        *POLES, np.array([[0.3], [0.1]]), np.array([2.0, -1.0])
    )
    X = np.column_stack([u, 1.0 + u[::-1]])
    expected = 0.0
    for i in range(2):
        part = several.part(i)
        expected = expected + part.run(X[:, i], DT, part.init(X[0, i], "zero"))[0]
    start = several.init(X[0], "zero")
    np.testing.assert_allclose(several.run(X, DT, start)[0], expected, atol=1e-12)
    stepper = Stepper(several.compiled_step(DT, start))
    np.testing.assert_allclose([stepper.step(x) for x in X], expected, atol=1e-12)
    y, _ = several.sensitivities(X, np.empty((len(X), 0)), DT, "zero")
    np.testing.assert_allclose(y, expected, atol=1e-12)


@pytest.mark.parametrize("system", [LAG, MODE], ids=["lag", "mode"])
def test_a_model_that_starts_from_zero_is_that_of_scipy(system, u):
    u = 1.0 + u
    _, y, _ = lsim(system, u, DT * np.arange(len(u)))
    order = len(system[1]) - 1
    model = TransferFunction(order, initial_state="zero", dt=DT).fit(u[:, None], y)
    np.testing.assert_allclose(model.predict(u[:, None]), y, atol=1e-8)
    assert model.params_["gain"] == pytest.approx(1.0, abs=1e-7)
    assert model.params_["intercept"] == pytest.approx(0.0, abs=1e-7)


def test_the_gain_of_a_step_at_the_first_sample_is_right():
    y = 10.0 * (1.0 - np.exp(-np.arange(100.0) / 4.0))
    model = TransferFunction(1, initial_state="zero").fit(np.ones((100, 1)), y)
    assert model.params_["gain"] == pytest.approx(10.0)
    assert model.params_["intercept"] == pytest.approx(0.0, abs=1e-9)
    assert model.params_["time_constants[0]"] == pytest.approx(4.0)
