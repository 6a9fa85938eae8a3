"""Models in series: fitted jointly, with one static gain."""

import warnings

import numpy as np
import optima
import pytest
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from sklearn.frozen import FrozenEstimator
from sklearn.linear_model import Ridge
from sklearn.utils.validation import check_is_fitted

from skhyst.compose import Cascade, Sum
from skhyst.compose._cascade import thin_records
from skhyst.disturbance import Drift
from skhyst.hysteresis import PrandtlIshlinskii, PrandtlIshlinskiiOperator
from skhyst.linear import (
    Delay,
    DelayOperator,
    FirstOrderLag,
    FirstOrderLagOperator,
    Gain,
    KelvinVoigt,
    KelvinVoigtOperator,
    SecondOrderMode,
    SecondOrderModeOperator,
    TransferFunction,
    TransferFunctionOperator,
)
from skhyst.operators import Series
from skhyst.optimize import RecordData, VariableProjection
from skhyst.static import (
    DeadBand,
    DeadBandOperator,
    DeadZoneOperator,
    DeadZones,
    Saturation,
    SaturationOperator,
)

DT = 0.005
THRESHOLDS = (0.0, 0.3, 0.8)
NOISE = 0.005
HYSTERESIS = PrandtlIshlinskiiOperator(THRESHOLDS, [1.0, 0.4, 0.3], 0.5)
LAG = FirstOrderLagOperator(0.02)
MODE = SecondOrderModeOperator(80.0, 0.05)
CREEP = KelvinVoigtOperator(np.array([0.2]), np.array([1.5]))


def plays(**options):
    return PrandtlIshlinskii(thresholds=THRESHOLDS, **options)


def drive(n=1500):
    time = DT * np.arange(n)
    rng = np.random.default_rng(0)
    fast = sum(np.sin(2 * np.pi * f * time + rng.uniform(0, 6)) / 6 for f in (5.1, 9.3, 14.7, 23.0))
    steps = np.repeat(rng.uniform(-1, 1, 15), n // 15)
    return np.sin(2 * np.pi * 0.4 * time) + fast + 0.5 * steps


def measure(*operators, noise=NOISE, n=1500):
    u = drive(n)
    y = u
    for operator in operators:
        y, _ = operator.run(y, DT)
    return u.reshape(-1, 1), y + noise * np.random.default_rng(1).normal(size=n)


def assert_recovered(model, truth):
    """Every parameter within 3.5 of its standard errors, which are small themselves."""
    for name, true in truth.items():
        std = model.params_std_[name]
        assert abs(model.params_[name] - true) < 3.5 * std, name
        assert std < 0.1 * abs(true), name


PLAYS = {f"plays__weights[{i}]": weight for i, weight in enumerate([1.0, 0.4, 0.3])}
PLAYS["plays__intercept"] = 0.5
STEP, LAG_STEP = ("plays", plays()), ("lag", FirstOrderLag())
ZONES = DeadZoneOperator(np.array([0.4]), np.array([1.2]), np.array([1]))
CASES = {
    "resonance": (
        (HYSTERESIS, MODE),
        [STEP, ("mode", SecondOrderMode())],
        {"mode__natural_frequency": 80.0, "mode__damping_ratio": 0.05},
    ),
    "creep and lag": (
        (HYSTERESIS, CREEP, LAG),
        [STEP, ("creep", KelvinVoigt(1)), LAG_STEP],
        {"creep__compliances[0]": 0.2, "creep__time_constants[0]": 1.5, "lag__time_constant": 0.02},
    ),
    "delay and lag": (
        (DelayOperator(0.0163), HYSTERESIS, LAG),
        [("delay", Delay()), STEP, LAG_STEP],
        {"delay__delay": 0.0163, "lag__time_constant": 0.02},
    ),
    "asymmetry and lag": (
        (HYSTERESIS, ZONES, LAG),
        [STEP, ("zones", DeadZones(1, sides="upper")), LAG_STEP],
        {"zones__weights[0]": 0.4, "zones__thresholds[0]": 1.2, "lag__time_constant": 0.02},
    ),
    "lag and limit": (
        (HYSTERESIS, LAG, SaturationOperator(upper=1.4)),
        [STEP, LAG_STEP, ("limit", Saturation(sides="upper"))],
        {"limit__upper": 1.4, "lag__time_constant": 0.02},
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_joint_fit_recovers_the_plant(name):
    operators, steps, truth = CASES[name]
    X, y = measure(*operators)
    model = Cascade(steps, dt=DT).fit(X, y)
    assert_recovered(model, PLAYS | truth)
    assert model.fit_error_ == pytest.approx(NOISE, rel=0.06)
    assert model.identifiability_["undetermined"] == ()
    clean, _ = Series(tuple("abc"[: len(operators)]), operators).run(X[:, 0], DT)
    assert np.sqrt(np.mean((model.predict(X) - clean) ** 2)) < 0.2 * NOISE


@pytest.mark.parametrize("unit", [1e-6, 1e3])
def test_a_delay_before_a_hysteresis_is_found_in_whatever_units(unit):
    X, y = measure(DelayOperator(0.0163), HYSTERESIS)
    model = Cascade([("delay", Delay()), STEP], dt=DT).fit(X, unit * y)
    assert model.operators_["delay"].delay == pytest.approx(0.0163, rel=0.05)
    assert model.fit_error_ == pytest.approx(unit * NOISE, rel=0.06)


def test_clean_data_give_the_exact_plant():
    X, y = measure(HYSTERESIS, MODE, noise=0.0)
    model = Cascade([STEP, ("mode", SecondOrderMode())], dt=DT).fit(X, y)
    assert model.operators_["mode"].natural_frequency == pytest.approx(80.0, rel=1e-6)
    np.testing.assert_allclose(model.predict(X), y, atol=1e-6)


def test_static_gain_without_hysteresis_belongs_to_the_last_step():
    X, y = measure(LAG, SecondOrderModeOperator(80.0, 0.05, gain=3.0, intercept=0.5))
    model = Cascade([("lag", FirstOrderLag()), ("mode", SecondOrderMode())], dt=DT).fit(X, y)
    assert {name for name in model.params_ if "gain" in name} == {"mode__gain"}
    assert_recovered(model, {"mode__gain": 3.0, "mode__intercept": 0.5, "lag__time_constant": 0.02})


def test_one_step_is_the_model_itself():
    X, y = measure(HYSTERESIS)
    alone = plays().fit(X, y)
    model = Cascade([STEP]).fit(X, y)
    np.testing.assert_allclose(model.predict(X), alone.predict(X), rtol=1e-9)
    assert model.params_ == pytest.approx({f"plays__{k}": v for k, v in alone.params_.items()})


def test_nested_cascades_are_one_chain():
    X, y = measure(HYSTERESIS, LAG, MODE)
    flat = [STEP, LAG_STEP, ("mode", SecondOrderMode())]
    inner = Cascade(flat[:2])
    nested = Cascade([("inner", inner), flat[2]], dt=DT).fit(X, y)
    model = Cascade(flat, dt=DT).fit(X, y)
    np.testing.assert_allclose(nested.predict(X), model.predict(X), atol=1e-4)
    kept = {name for name in model.params_ if "gain" in name or "intercept" in name}
    assert kept == {"plays__intercept"}
    for name in ("lag", "mode"):
        assert (model.operators_[name].gain, model.operators_[name].intercept) == (1.0, 0.0)
    renamed = {name.removeprefix("inner__"): value for name, value in nested.params_.items()}
    assert renamed == pytest.approx(model.params_, rel=1e-2, abs=1e-2)


def test_sum_as_a_step():
    first, second = SecondOrderModeOperator(80.0, 0.05), SecondOrderModeOperator(25.0, 0.1, 0.3)
    X, _ = measure(HYSTERESIS)
    middle, _ = HYSTERESIS.run(X[:, 0], DT)
    y = first.run(middle, DT)[0] + second.run(middle, DT)[0]
    y += NOISE * np.random.default_rng(1).normal(size=len(y))
    modes = Sum([("first", SecondOrderMode()), ("second", SecondOrderMode())])
    model = Cascade([STEP, ("modes", modes)], dt=DT).fit(X, y)
    found = {model.params_[f"modes__{name}__natural_frequency"] for name in ("first", "second")}
    assert sorted(found) == pytest.approx([25.0, 80.0], rel=0.02)
    assert model.fit_error_ == pytest.approx(NOISE, rel=0.1)


# ------------------------------------------------------------------------------- held steps, speed


def small_signal(operator):
    """A recording in which the hysteresis is a gain of one: the plays beyond zero never move."""
    u = 0.1 * np.random.default_rng(5).uniform(-1, 1, 1500)
    y, _ = operator.run(u, DT)
    return u.reshape(-1, 1), y + 1e-4 * np.random.default_rng(6).normal(size=len(u))


@pytest.mark.slow
def test_a_held_step_stays_until_it_is_set_free():
    """With a warm start everything is then set free from there."""
    mode = SecondOrderModeOperator(80.0, 0.05, gain=3.0, intercept=0.2)
    known = SecondOrderMode(dt=DT).fit(*small_signal(mode))
    X, y = measure(HYSTERESIS, CREEP, mode)
    steps = [STEP, ("creep", KelvinVoigt(1)), ("mode", FrozenEstimator(known))]
    model = Cascade(steps, dt=DT, warm_start=True).fit(X, y)
    assert model.operators_["mode"] is known.operator_
    assert not any(name.startswith("mode") for name in model.params_)
    # its gain is its own, so the plays have theirs, up to what the small signal knew of it
    ratio = 3.0 / known.operator_.gain
    np.testing.assert_allclose(model.operators_["plays"].weights, ratio * HYSTERESIS.weights, 0.02)
    assert model.operators_["creep"].gain == 1.0
    assert model.params_["creep__time_constants[0]"] == pytest.approx(1.5, rel=0.1)
    assert model.fit_error_ == pytest.approx(NOISE, rel=0.1)
    free = Cascade([*steps[:2], ("mode", SecondOrderMode())], dt=DT).fit(X, y)
    assert model.n_evaluations_ < free.n_evaluations_
    model.set_params(mode=SecondOrderMode()).fit(X, y)
    assert model.n_evaluations_ < 15
    assert_recovered(model, {"mode__natural_frequency": 80.0, "mode__damping_ratio": 0.05})
    np.testing.assert_allclose(model.operators_["plays"].weights, 3.0 * HYSTERESIS.weights, 0.02)
    # other steps than before: from the beginning
    model.set_params(creep=FirstOrderLag()).fit(X, y)
    fresh = Cascade(model.steps, dt=DT).fit(X, y)
    assert model.params_ == fresh.params_


def test_what_is_left_free_carries_the_gain_of_a_held_hysteresis():
    known = plays().fit(*measure(HYSTERESIS, noise=0.0))
    X, y = measure(HYSTERESIS, FirstOrderLagOperator(0.02, gain=2.5, intercept=0.1))
    steps = [("plays", FrozenEstimator(known)), ("lag", FirstOrderLag())]
    model = Cascade(steps, dt=DT).fit(X, y)
    assert_recovered(model, {"lag__gain": 2.5, "lag__time_constant": 0.02})
    again = clone(model).fit(X, y)  # a frozen model survives cloning
    np.testing.assert_array_equal(again.predict(X), model.predict(X))


@pytest.mark.parametrize("initial_state", ["rest", "zero", "estimate"])
def test_everything_held_is_the_operators_in_series(initial_state):
    lag, mode = FirstOrderLag(dt=DT), SecondOrderMode(dt=DT)
    lag.fit(*small_signal(LAG))
    mode.fit(*small_signal(MODE))
    X, y = measure(LAG, MODE)
    steps = [("lag", FrozenEstimator(lag)), ("mode", FrozenEstimator(mode))]
    model = Cascade(steps, dt=DT, initial_state=initial_state).fit(X, y)
    assert model.params_ == {}
    series = Series(("lag", "mode"), (lag.operator_, mode.operator_))
    state = series.init(X[0, 0], "zero" if initial_state == "zero" else "rest")
    np.testing.assert_array_equal(model.predict(X), series.run(X[:, 0], DT, state)[0])


def test_a_cascade_is_held_as_one_step():
    inner = Cascade([("lag", FirstOrderLag()), ("mode", SecondOrderMode())], dt=DT)
    inner.fit(*small_signal(Series(("lag", "mode"), (LAG, MODE))))
    X, y = measure(HYSTERESIS, LAG, MODE)
    model = Cascade([STEP, ("dynamics", FrozenEstimator(inner))], dt=DT).fit(X, y)
    assert_recovered(model, {name: value for name, value in PLAYS.items() if "weights" in name})
    assert set(model.params_) == set(PLAYS)


def test_long_records_are_thinned_on_the_way_only():
    """Slow creep and a fast mode, of which every second sample would suffice."""
    time = DT * np.arange(20_000)
    u = np.sin(2 * np.pi * 0.05 * time) + 0.3 * np.sin(2 * np.pi * 1.3 * time)
    clean, _ = Series(tuple("abc"), (HYSTERESIS, CREEP, MODE)).run(u, DT)
    y = clean + NOISE * np.random.default_rng(1).normal(size=len(u))
    steps = [STEP, ("creep", KelvinVoigt(1)), ("mode", SecondOrderMode())]
    model = Cascade(steps, dt=DT).fit(u.reshape(-1, 1), y)
    assert model.fit_error_ == pytest.approx(NOISE, rel=0.02)
    assert np.sqrt(np.mean((model.predict(u.reshape(-1, 1)) - clean) ** 2)) < 0.05 * NOISE


@pytest.mark.parametrize("n", [20_000, 50_001])
def test_thinning_keeps_the_samples_and_the_drive(n):
    time = np.arange(n) / n
    record = RecordData(np.sin(9 * time), np.cos(999 * time), 1e-3, weights=1.0 + time)
    (thinned,) = thin_records([record])
    step = round(thinned.dt / record.dt)
    assert step == n // 5_000
    np.testing.assert_array_equal(thinned.y, record.y[::step])
    np.testing.assert_array_equal(thinned.weights, record.weights[::step])
    assert thinned.segments == ((0, len(thinned.u)),)
    noise = np.random.default_rng(0).normal(size=n)
    assert thin_records([RecordData(noise, noise, 1e-3)]) is None
    assert thin_records([RecordData(time[:19_999], time[:19_999], 1e-3)]) is None


# ------------------------------------------------------------------------------------ parameters


def test_steps_are_left_as_they_were_and_what_the_composition_says_is_in_place_of_theirs():
    X, y = measure(HYSTERESIS, LAG)
    steps = [STEP, LAG_STEP]
    model = Cascade(steps, dt=DT).fit(X, y)
    assert model.steps is steps
    for _, step in model.steps:
        with pytest.raises(Exception, match="not fitted"):
            check_is_fitted(step)
    steps = [("plays", plays(dt=7.0)), ("lag", FirstOrderLag(dt=3.0, initial_state="zero"))]
    other = Cascade(steps, initial_state="rest", dt=DT).fit(X, y)
    np.testing.assert_array_equal(other.predict(X), model.predict(X))


def test_named_steps_are_fitted_after_a_fit():
    X, y = measure(HYSTERESIS, LAG)
    model = Cascade([STEP, LAG_STEP], dt=DT).fit(X, y)
    steps = model.named_steps
    assert list(steps) == ["plays", "lag"]
    signal = X
    for name, step in steps.items():
        assert step.operator_ is model.operators_[name]
        own = {f"{name}__{key}": value for key, value in step.params_.items()}
        assert own == {key: model.params_[key] for key in own}
        assert len(own) > 0
        signal = step.predict(signal)[:, None]
    np.testing.assert_allclose(signal[:, 0], model.predict(X), rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(steps["plays"].weights_, model.operators_["plays"].weights)
    assert not hasattr(dict(model.steps)["lag"], "operator_")


def test_parameters_reach_into_steps():
    model = Cascade([STEP, LAG_STEP])
    params = model.get_params()
    assert params["plays__non_negative"] is True
    assert params["lag"] is model.steps[1][1]
    model.set_params(plays__non_negative=False, lag__hold="zoh", dt=0.3)
    assert model.named_steps["plays"].non_negative is False
    assert model.named_steps["lag"].hold == "zoh"
    assert model.dt == 0.3
    nested = Cascade([("inner", model)]).set_params(inner__lag__hold="foh")
    assert nested.get_params()["inner__lag__hold"] == "foh"
    with pytest.raises(ValueError, match="Invalid parameter 'wrong'"):
        model.set_params(wrong=1)


HELD = {"hold": "zoh", "dt": DT}
BOTH = [("lag", FirstOrderLag(**HELD)), ("mode", SecondOrderMode(**HELD))]


@pytest.mark.parametrize(
    ("model", "said"),
    [
        (Cascade(BOTH), "The input of 'mode' is held"),
        (Sum([("gain", Gain(dt=DT)), ("inner", Cascade(BOTH))]), "The input of 'inner__mode' is"),
        (Sum([BOTH[0], ("creep", KelvinVoigt(1, dt=DT))]), "with the holds 'foh' and 'zoh'"),
        (Cascade([("gain", Gain(dt=DT)), ("delay", Delay(dt=DT)), BOTH[1]]), None),
        (Cascade([BOTH[0], ("mode", SecondOrderMode(dt=DT))]), None),
    ],
)
def test_a_fit_warns_of_a_held_input_that_moves(model, said):
    u = np.repeat(np.random.default_rng(0).normal(size=15), 4)
    y, _ = Series(("lag", "mode"), (FirstOrderLagOperator(0.03, hold="zoh"), MODE)).run(u, DT)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        model.set_params(method=VariableProjection(max_evaluations=1)).fit(u[:, None], y)
    found = [str(w.message) for w in caught if "zoh" in str(w.message)]
    assert [said in text for text in found] == [True] if said else not found


@pytest.mark.parametrize("kind", [Cascade, Sum])
@pytest.mark.parametrize(
    ("steps", "error", "message"),
    [
        ([], ValueError, "The 'steps' parameter of {} must not be empty"),
        ("lag", ValueError, "The 'steps' parameter of {} must be"),
        ([("a", FrozenEstimator(FirstOrderLag()))], NotFittedError, "'a' of {} is frozen"),
        ([("a", FrozenEstimator(Ridge()))], TypeError, "of {} must be parametric models of skhyst"),
        ([("a", 3)], TypeError, "must be parametric models of skhyst. Got 3 as 'a'"),
        ([("a", FirstOrderLag), ("b", Delay())], TypeError, "must be parametric models"),
        ([("a", Delay()), ("a", FirstOrderLag())], ValueError, "unique"),
        ([("a__b", FirstOrderLag())], ValueError, "__"),
        ([("dt", FirstOrderLag())], ValueError, "conflict"),
    ],
)
def test_wrong_steps(kind, steps, error, message):
    X, y = measure(HYSTERESIS, n=60)
    with pytest.raises(error, match=message.format(kind.__name__)):
        kind(steps).fit(X, y)


@pytest.mark.parametrize("wrong", [("drift", Drift()), ("sum", Sum([LAG_STEP, ("b", Drift())]))])
def test_a_disturbance_is_no_stage(wrong):
    X, y = measure(HYSTERESIS, n=60)
    with pytest.raises(ValueError, match=f"'{wrong[0]}' of Cascade is a disturbance"):
        Cascade([STEP, wrong]).fit(X, y)


@pytest.mark.parametrize(("slow_first", "n_zeros"), [(True, 0), (False, 0), (False, 1)])
def test_a_curve_between_two_transfer_functions_needs_no_starts(slow_first, n_zeros):
    """Whichever half is slower, and whichever has the zero."""
    lag = TransferFunctionOperator(
        np.array([0.05]), np.empty(0), np.empty(0), np.full(n_zeros, 0.3)
    )
    mode = TransferFunctionOperator(np.empty(0), np.array([80.0]), np.array([0.3]), np.empty(0))
    filters = (lag, mode) if slow_first else (mode, lag)
    X, y = measure(filters[0], DeadBandOperator(0.4, 0.1), filters[1])
    orders = [(sum(f.n_poles) + f.n_poles[1], len(f.numerator)) for f in filters]
    first, second = (TransferFunction(p, n_zeros=z) for p, z in orders)
    steps = [("first", first), ("dead_zone", DeadBand()), ("second", second)]
    model = Cascade(steps, dt=DT).fit(X, y)
    own = ("first", "second") if slow_first else ("second", "first")
    truth = {
        f"{own[0]}__time_constants[0]": 0.05,
        f"{own[1]}__natural_frequencies[0]": 80.0,
        f"{own[1]}__damping_ratios[0]": 0.3,
        "dead_zone__half_width": 0.4,
        "dead_zone__center": 0.1,
    }
    assert_recovered(model, truth)


def test_the_starts_of_a_mode_set_the_thresholds_of_the_plays_behind_it():
    rng = np.random.default_rng([5500308, 9])
    u, size = optima.drive(rng)
    y = optima.series(optima.mode, optima.prandtl_ishlinskii)(rng, size)(u)
    noise = rng.uniform(0.003, 0.03) * np.std(y) * rng.normal(size=len(y))
    steps = [("mode", SecondOrderMode()), ("plays", PrandtlIshlinskii(10))]
    model = Cascade(steps, dt=optima.DT).fit(u[:, None], y + noise)
    assert model.fit_error_ < optima.BAR * np.std(noise)  # three times, from one start of the mode
