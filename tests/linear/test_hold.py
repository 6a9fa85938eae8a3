"""The hold of the drive that a fit finds by itself, on data held by steps and by lines."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lsim
from sklearn.frozen import FrozenEstimator

from skhyst.compose import Cascade, OnColumn, Sum
from skhyst.diagnosis import EffectSearchCV
from skhyst.export import to_c
from skhyst.fluid import TankChainOperator
from skhyst.hysteresis import PrandtlIshlinskii, RestoringForceOperator
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
from skhyst.operators import Stepper, check_operator, is_straight
from skhyst.operators._held_input import finer_samples
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


@pytest.mark.slow
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
    declared = FirstOrderLag(hold="auto")
    search = EffectSearchCV(declared, effects=effects, cv=2, random_state=0).fit(X, y)
    assert search.effects_ == ["output_saturation"]
    assert search.declared_estimator_.operator_.hold == hold
    assert search.best_estimator_.operators_["first_order_lag"].hold == hold
    assert search.best_estimator_.get_params()["first_order_lag__hold"] == hold


def test_what_no_record_can_decide_is_refused(u):
    with pytest.raises(
        ValueError, match=r"'hold' parameter of FirstOrderLagOperator must be 'foh'"
    ):
        FirstOrderLagOperator(TAU, hold="auto")
    with pytest.raises(ValueError, match=r"'hold' must be .*'zoh' or 'bandlimited' here.*'auto'"):
        TransferFunction.from_system(MODE, hold="auto")
    measured = frequency_response(u[:, None], response(MODE, u, "foh"), dt=DT)
    with pytest.raises(ValueError, match=r"'hold' must be .*'zoh' or 'bandlimited' here.*'auto'"):
        TransferFunction(hold="auto").fit_frequency_response(measured)
    with pytest.raises(ValueError, match="'hold' parameter of FirstOrderLag"):
        FirstOrderLag(hold="both").fit(u[:, None], u)


TIME = DT * np.arange(400)


def recorded(time):
    """Return a drive whose content ends at 0.35 of the sampling rate, within the record."""
    rng = np.random.default_rng(3)
    lines = 2.0 * np.pi * np.linspace(0.2, 0.35 / DT, 30)
    parts = rng.normal(size=30) * np.sin(np.outer(time, lines) + rng.uniform(0.0, 6.0, 30))
    return 0.1 * parts.sum(axis=1) * np.exp(-(((time - 2.0) / 0.9) ** 4))


def integrated(force):
    """Return the motion of a mass, driven between the samples too, by Runge-Kutta steps."""
    fine = 40
    h = DT / fine
    drive = recorded(0.5 * h * np.arange(2 * fine * len(TIME)))
    x, v, found = 0.0, 0.0, np.empty(len(TIME))

    def slope(x, v, u):
        return v, OMEGA**2 * (u - x - force * x**3) - 2.0 * ZETA * OMEGA * v

    for k in range(fine * len(TIME) - fine + 1):
        if k % fine == 0:
            found[k // fine] = x
        before, middle, after = drive[2 * k : 2 * k + 3]
        a = slope(x, v, before)
        b = slope(x + 0.5 * h * a[0], v + 0.5 * h * a[1], middle)
        c = slope(x + 0.5 * h * b[0], v + 0.5 * h * b[1], middle)
        d = slope(x + h * c[0], v + h * c[1], after)
        x += h / 6.0 * (a[0] + 2.0 * b[0] + 2.0 * c[0] + d[0])
        v += h / 6.0 * (a[1] + 2.0 * b[1] + 2.0 * c[1] + d[1])
    return found


@pytest.mark.parametrize(
    ("operator", "cubic"),
    [
        (SecondOrderModeOperator(OMEGA, ZETA), 0.0),
        (TransferFunctionOperator([], np.array([OMEGA]), np.array([ZETA]), []), 0.0),
        (RestoringForceOperator(OMEGA, ZETA, [0.4], [], 0.0, 0.5, n_substeps=64), 0.4),
    ],
    ids=lambda o: type(o).__name__,
)
def test_a_band_limited_drive_is_read_between_its_samples(operator, cubic):
    expected = integrated(cubic)
    missed = {}
    for hold in ("foh", "bandlimited"):
        y, _ = replace(operator, hold=hold).run(recorded(TIME), DT)
        missed[hold] = np.std(y - expected) / np.std(expected)
    assert missed["bandlimited"] < 1e-4  # of the window
    assert missed["foh"] > 100.0 * missed["bandlimited"]


def test_a_constant_stays_one_and_content_far_below_half_the_sampling_rate_is_kept():
    wave = np.sin(0.9 * np.arange(200.0))  # 0.14 cycles a sample
    for proper, factor in ((True, 4), (False, 16)):
        np.testing.assert_allclose(finer_samples(np.full(5, 0.7), proper), 0.7, rtol=1e-14)
        inside = slice(40 * factor, -40 * factor)
        true = np.sin(0.9 * np.arange(199 * factor + 1) / factor)
        # of a wave at f samples straight lines leave sinc(f / m)^2
        larger = np.sinc(0.9 / (2.0 * np.pi * factor)) ** -2 if proper else 1.0
        points = finer_samples(wave, proper)
        np.testing.assert_allclose(points[inside], larger * true[inside], atol=2e-4)
    assert is_straight(np.sin(0.01 * np.arange(2000.0)))
    assert not is_straight(np.random.default_rng(0).normal(size=2000))


def test_several_band_limited_inputs_are_the_sum_of_single_ones(u):
    X = np.column_stack([u, u[::-1]])
    gains = np.array([2.0, -1.0])
    several = MultiInputTransferFunctionOperator(
        *POLES, np.zeros((2, 1)), gains, hold="bandlimited"
    )
    expected = sum(several.part(i).run(X[:, i], DT)[0] for i in range(2))
    np.testing.assert_allclose(several.run(X, DT)[0], expected, atol=1e-10)
    check_operator(several, X[:60], DT)


def test_a_model_of_a_band_limited_drive_finds_the_parameters_and_is_not_stepped():
    X = recorded(TIME)[:, None]
    model = SecondOrderMode(hold="bandlimited", dt=DT).fit(X, integrated(0.0))
    assert model.params_["natural_frequency"] == pytest.approx(OMEGA, rel=2e-4)
    assert model.params_["damping_ratio"] == pytest.approx(ZETA, rel=2e-3)
    for refused in (model.stepper, lambda: to_c(model, "unused", name="m")):
        with pytest.raises(NotImplementedError, match="hold='bandlimited'"):
            refused()
    for operator in (model.operator_, RestoringForceOperator(9.0, 0.3, [], [], 0.0, 0.5)):
        with pytest.raises(ValueError, match="has no inverse: with hold='bandlimited'"):
            replace(operator, hold="bandlimited").inverse()
    with pytest.raises(ValueError, match="'hold' parameter of RestoringForceOperator"):
        RestoringForceOperator(9.0, 0.3, [], [], 0.0, 0.5, hold="zoh")


@pytest.mark.slow
def test_a_search_names_the_drive_between_the_samples():
    rng, pairs = np.random.default_rng(5), []
    for _ in range(4):
        u = recorded(TIME) if not pairs else np.roll(pairs[-1][0], 7)
        mode = SecondOrderModeOperator(OMEGA, ZETA, hold="bandlimited")
        pairs.append((u, mode.run(u, DT)[0] + 1e-4 * rng.normal(size=len(u))))
    X, y = stack_records(pairs, dt=DT)
    effects = ["timing", "delay", "creep"]
    search = EffectSearchCV(SecondOrderMode(), effects=effects, random_state=0).fit(X, y)
    assert search.effects_ == ["timing"]
    assert search.best_estimator_.operator_.hold == "bandlimited"


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
