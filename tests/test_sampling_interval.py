"""A fitted model answers at the interval of its fit, and refuses what contradicts it."""

import pickle

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lti
from sklearn.base import clone
from sklearn.frozen import FrozenEstimator
from sklearn.linear_model import LinearRegression, Ridge
from sklearn.pipeline import make_pipeline

from skhyst.autoregressive import NARMAXRegressor, NARXRegressor
from skhyst.compose import (
    Cascade,
    Corrected,
    Feedback,
    Modulated,
    OnColumn,
    ScheduledParameters,
    Sum,
)
from skhyst.control import FeedforwardPI, InverseCompensator, Monitor, Observer
from skhyst.diagnosis import EffectSearchCV
from skhyst.exceptions import ConvergenceWarning, RecordError
from skhyst.export import to_c
from skhyst.fluid import TankChain
from skhyst.hysteresis import FreeMass, FreeMassOperator, PrandtlIshlinskii
from skhyst.linear import (
    Delay,
    DelayOperator,
    FirstOrderLag,
    FirstOrderLagOperator,
    Gain,
    SecondOrderMode,
    TransferFunction,
    frequency_response,
)
from skhyst.operators import Series, SumOperator, resampled
from skhyst.optimize import VariableProjection
from skhyst.preprocessing import GeneralizedInputGradient, LaggedFeatures
from skhyst.records import Units, stack_records
from skhyst.static import SmoothCurve

DT, N, TIME_CONSTANT = 0.002, 400, 0.0195


@pytest.fixture(scope="module")
def data():
    """A lag of 19.5 ms, driven by a random walk, sampled every 2 ms."""
    u = np.random.default_rng(0).normal(size=N).cumsum()
    y, _ = FirstOrderLagOperator(TIME_CONSTANT).run(u, DT)
    X = pd.DataFrame({"u": u}, index=pd.Index(DT * np.arange(N), name="time"))
    return X, pd.Series(y, X.index)


def without_time(X):
    """Yield the same rows in containers that have no time."""
    yield X.to_numpy()
    yield X.reset_index(drop=True)
    yield X.set_axis(np.arange(3, 3 + len(X)))
    pl = pytest.importorskip("polars")
    yield pl.DataFrame({name: X[name].to_numpy() for name in X})


MODELS = {
    "lag": FirstOrderLag(),
    "cascade": Cascade([("gain", Gain()), ("lag", FirstOrderLag())]),
    "sum": Sum([("gain", Gain()), ("lag", FirstOrderLag())]),
    "scheduled": ScheduledParameters(FirstOrderLag(), degree=0),
    "modulated": Modulated(FirstOrderLag(), 0),
    "transfer function": TransferFunction(1),
    "NARX": NARXRegressor(),
    "NARMAX with a rate": NARMAXRegressor(1, features=[GeneralizedInputGradient()], n_terms=None),
    "lagged features": make_pipeline(LaggedFeatures([0, 1, 2]), Ridge(1e-9)),
    "rate": make_pipeline(GeneralizedInputGradient(), Ridge(1e-9)),
    "corrected": Corrected(LinearRegression(), FirstOrderLag(), cv=2, max_iter=0),
}


@pytest.mark.filterwarnings("ignore:X does not have valid feature names")
@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ShortRecordWarning")
@pytest.mark.parametrize("name", MODELS)
def test_data_without_a_time_are_answered_at_the_interval_of_the_fit(name, data):
    X, y = data
    model = MODELS[name].fit(X, y)
    expected = model.predict(X)
    for fitted in (model, pickle.loads(pickle.dumps(model))):
        for given in without_time(X):
            np.testing.assert_array_equal(fitted.predict(given), expected)


def test_the_lag_is_that_of_the_device_and_says_its_unit(data):
    X, y = data
    model = FirstOrderLag().fit(X, y)
    assert model.operator_.time_constant == pytest.approx(TIME_CONSTANT, rel=1e-9)
    assert (model.dt, model.dt_, model.time_unit_) == (None, DT, "s")
    counted = FirstOrderLag().fit(X.to_numpy(), y.to_numpy())
    assert counted.operator_.time_constant == pytest.approx(TIME_CONSTANT / DT, rel=1e-9)
    assert (counted.dt_, counted.time_unit_) == (1.0, "sample")
    assert Units(time=counted.time_unit_).of("s") == "samples"
    assert counted.records_[0].time_unit == "sample"


def test_an_interval_of_one_second_can_be_said(data):
    X, y = data
    model = FirstOrderLag(dt=1.0).fit(X.to_numpy(), y.to_numpy())
    assert (model.dt_, model.time_unit_, model.records_[0].time_unit) == (1.0, "s", "s")


def test_a_lag_in_seconds_holds_at_any_rate_that_the_time_says(data):
    X, y = data
    model = FirstOrderLag().fit(X, y)
    fine = np.repeat(X["u"].to_numpy(), 1)
    other = pd.DataFrame({"u": fine}, index=10.0 * X.index)
    expected, _ = FirstOrderLagOperator(TIME_CONSTANT).run(fine, 10.0 * DT)
    np.testing.assert_allclose(model.predict(other), expected, rtol=1e-9, atol=1e-9)


def test_what_contradicts_the_fit_is_refused(data):
    X, y = data
    array, response = X.to_numpy(), y.to_numpy()
    said = FirstOrderLag(dt=DT).fit(array, response).set_params(dt=2.0 * DT)
    with pytest.raises(RecordError, match=r"'dt' parameter .* must be that of the fit, 0\.002 s"):
        said.predict(array)
    counted = FirstOrderLag().fit(array, response)
    with pytest.raises(RecordError, match="fitted without a time"):
        counted.predict(pd.DataFrame(array, X.index))
    u = array[:, 0]
    two = [(pd.DataFrame({"u": u}, own.index), own) for own in (y, y.set_axis(2.0 * X.index))]
    with pytest.warns(ConvergenceWarning, match="No one set of parameters"):
        model = FirstOrderLag().fit(*stack_records(two))
    assert model.dt_ is None
    with pytest.raises(RecordError, match="several sampling intervals"):
        model.predict(X.reset_index(drop=True))


IN_SAMPLES = {
    "Corrected": lambda X, y, timed: (
        Corrected(LinearRegression(), FirstOrderLag(), cv=2).fit(X, y).predict(timed)
    ),
    "rate": lambda X, y, timed: GeneralizedInputGradient().fit(X).transform(timed),
    "stepper": lambda X, y, timed: FirstOrderLag().fit(X, y).stepper(DT),
    "inverse": lambda X, y, timed: InverseCompensator(FirstOrderLag()).fit(X, y).predict(timed),
    "drive_for": lambda X, y, timed: (
        InverseCompensator(Cascade(steps_of())).fit(X, y).drive_for(y, DT)
    ),
    "inverse of a model": lambda X, y, timed: InverseCompensator(FirstOrderLag().fit(X, y)).fit(
        timed, y
    ),
    "controller": lambda X, y, timed: FeedforwardPI(
        1.0, 0.0, compensator=InverseCompensator(Gain()).fit(X, y)
    ).stepper(DT),
    "random walk": lambda X, y, timed: Observer(Gain()).fit(X, y).stepper(DT),
    "random walk of a monitor": lambda X, y, timed: Monitor(Observer(Gain()).fit(X, y)).fit(
        timed, y
    ),
    "observer": lambda X, y, timed: Observer(FirstOrderLag()).fit(X, y).filter(timed, y),
    "to_c": lambda X, y, timed: to_c(FirstOrderLag().fit(X, y), "never written", "lag", dt=DT),
    "delay of many samples": lambda X, y, timed: (
        Delay().fit(X[:, :1], np.append(np.full(50, X[0, 0]), X[:-50, 0])).stepper(DT)
    ),
}


@pytest.mark.parametrize("name", IN_SAMPLES)
def test_constants_in_samples_are_not_taken_for_seconds(name, data):
    X, y = data
    array, response = X.to_numpy(), y.to_numpy()
    with pytest.raises(RecordError, match="fitted without a time"):
        IN_SAMPLES[name](array, response, pd.DataFrame(array, X.index))


ALREADY_FITTED = {
    "lag": lambda X, y: FirstOrderLag().fit(X, y),
    "cascade": lambda X, y: Cascade(steps_of()).fit(X, y),
    "array": lambda X, y: FirstOrderLag(dt=DT).fit(X.to_numpy(), y.to_numpy()),
}


@pytest.mark.filterwarnings("ignore:X .* feature names")
@pytest.mark.parametrize("name", ALREADY_FITTED)
def test_what_is_around_a_fitted_model_has_the_interval_of_its_own_fit(name, data):
    """Of the same device at twice the interval."""
    X, y = data
    model, slow, u = ALREADY_FITTED[name](X, y), X.set_axis(2.0 * X.index), X["u"].to_numpy()
    response, _ = FirstOrderLagOperator(TIME_CONSTANT).run(u, 2.0 * DT)
    free_run = {"disturbance": None, "noise_std": 1.0, "process_std": 0.0}
    observer = Observer(model, **free_run).fit(slow, response)
    for own in (observer, pickle.loads(pickle.dumps(observer))):
        rows = np.column_stack([u, response])
        estimates = [own.update(*row) for row in rows]
        np.testing.assert_allclose(estimates, response, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(own.stepper(u0=u[0]).run(rows), response, rtol=1e-6, atol=1e-6)
        filtered = own.filter(X.to_numpy(), response)
        np.testing.assert_allclose(filtered, response, rtol=1e-6, atol=1e-6)
    no_limits = {"drive_limits": None, "rate_limit": None}
    inverse = InverseCompensator(model, **no_limits).fit(slow, response)
    reference = pd.DataFrame({"u": response})
    np.testing.assert_allclose(inverse.predict(reference)[1:-1], u[1:-1], rtol=1e-5, atol=1e-5)
    stepper = inverse.stepper(reference=response[0])
    delayed = stepper.run(response)[stepper.preview + 1 :]
    np.testing.assert_allclose(delayed, u[1 : N - stepper.preview], rtol=1e-5, atol=1e-5)
    limited = InverseCompensator(model, drive_limits=None).fit(slow, response).stepper()
    largest = np.abs(np.diff(limited.run(np.append(0.0, np.full(20, 1e3))))).max()
    assert largest == pytest.approx(model.drive_rate_ * 2.0 * DT)


@pytest.mark.filterwarnings("ignore:X does not have valid feature names")
def test_a_monitor_around_a_fitted_observer_has_the_interval_of_its_own_fit(data):
    X, y = data
    noise = 0.02 * np.random.default_rng(1).normal(size=N)
    variances = {"noise_std": 0.02, "drift_std": 0.0, "process_std": 0.0}
    observer = Observer(FirstOrderLag(), **variances).fit(X, y + noise)
    slow = X.set_axis(2.0 * X.index)
    reading = FirstOrderLagOperator(TIME_CONSTANT).run(X["u"].to_numpy(), 2.0 * DT)[0] + noise
    for around in (observer, Observer(observer.model_, **variances)):
        monitor = Monitor(around).fit(slow, reading)
        for row in zip(X["u"], reading, strict=True):
            monitor.update(*row)
            assert not monitor.drift_detected
    again = Monitor(monitor.observer_).fit(X.to_numpy(), reading)
    assert (again.dt_, again.observer_.stepper().dt) == (2.0 * DT, 2.0 * DT)


def test_what_does_not_depend_on_time_is_not_asked_for_it(data):
    X, y = data
    model = PrandtlIshlinskii(3).fit(X.to_numpy(), y.to_numpy())
    frame = pd.DataFrame(X.to_numpy(), X.index)
    np.testing.assert_array_equal(model.predict(frame), model.predict(X.to_numpy()))
    run = model.stepper(DT, u0=X.iloc[0, 0]).run(X.to_numpy()[:, 0])
    np.testing.assert_allclose(run, model.predict(frame), rtol=1e-12)
    rests = GeneralizedInputGradient(include_rate=False).fit(X.to_numpy())
    np.testing.assert_array_equal(rests.transform(frame), rests.transform(X.to_numpy()))


# --------------------------------------------------------------------- models that count samples


COUNTING = {
    "NARX": NARXRegressor(),
    "NARMAX": NARMAXRegressor(1),
    "lagged features": make_pipeline(LaggedFeatures([0, 1, 2]), Ridge(1e-9)),
    "corrected": Corrected(NARXRegressor(), Gain(), cv=2, max_iter=0),
    "corrected pipeline": Corrected(
        make_pipeline(LaggedFeatures([0, 1, 2]), Ridge(1e-9)), Gain(), cv=2, max_iter=0
    ),
}


@pytest.mark.parametrize("name", COUNTING)
@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_another_interval_is_refused(name, factor, data):
    X, y = data
    model = COUNTING[name].fit(X, y)
    other = X.set_axis(factor * X.index)
    with pytest.raises(RecordError, match=r"must be sampled at 0\.002 s"):
        model.predict(other)
    if hasattr(model, "predict_one_step"):
        with pytest.raises(RecordError, match=r"must be sampled at 0\.002 s"):
            model.predict_one_step(other, y.to_numpy())
    with pytest.raises(RecordError, match=r"must be sampled at 0\.002 s"):
        model.score(other, y.to_numpy())


@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ConvergenceWarning")
def test_a_search_around_an_autoregressive_model_refuses_too(data):
    X, y = data
    search = EffectSearchCV(NARXRegressor(), effects=["offset"], cv=2, max_effects=1)
    search.fit(X, y + 1e-3 * np.random.default_rng(1).normal(size=N))
    with pytest.raises(RecordError, match=r"must be sampled at 0\.002 s"):
        search.predict(X.set_axis(10.0 * X.index))


def held(n, columns=1):
    return np.random.default_rng(2).normal(size=(n, columns))


@pytest.mark.parametrize("factor", [0.1, 0.5, 0.7, 1.0, 3.0])
def test_a_linear_model_of_a_lag_is_that_of_the_lag_at_any_interval(factor):
    """The discrete lag with a held drive has the pole exp(-dt/T)."""
    X = held(300)
    pole = np.exp(-DT / TIME_CONSTANT)
    y = np.zeros(300)
    for k in range(1, 300):
        y[k] = pole * y[k - 1] + 2.0 * (1.0 - pole) * X[k - 1, 0] + 0.3
    model = NARXRegressor(input_lags=[1], dt=DT).fit(X, y).resampled(factor * DT)
    new = np.exp(-factor * DT / TIME_CONSTANT)
    expected = [2.0 * (1.0 - new), new, 0.3 * (1.0 - new) / (1.0 - pole)]
    np.testing.assert_allclose(model.coef_, expected, rtol=1e-7)
    assert model.dt_ == pytest.approx(factor * DT)
    assert model.stepper().dt == model.dt_


def test_two_inputs_at_half_and_at_twice_the_interval():
    X = held(300, 2)
    y = np.zeros(300)
    for k in range(2, 300):
        past = 1.5 * y[k - 1] - 0.7 * y[k - 2]
        y[k] = past + 0.2 * X[k, 0] + 0.1 * X[k - 1, 0] + 0.3 * X[k - 2, 1] + 0.2
    model = NARMAXRegressor(1, n_terms=None, dt=DT).fit(X, y)
    fine = model.resampled(DT / 2.0)
    expected = model.predict(X)
    np.testing.assert_allclose(fine.predict(np.repeat(X, 2, axis=0))[::2], expected, atol=1e-9)
    coarse = model.resampled(2.0 * DT)
    whole = model.predict(np.repeat(X, 2, axis=0))[::2]
    np.testing.assert_allclose(coarse.predict(X), whole, atol=1e-9)
    back = pickle.loads(pickle.dumps(fine)).resampled(DT)
    np.testing.assert_allclose(back.predict(X), expected, atol=1e-9)


def test_where_it_is_not_exact_it_says_so():
    X = held(300)
    y = np.append([0.0, 0.0], X[:-2, 0])
    delay = NARXRegressor(input_lags=[2], output_lags=[1], dt=DT).fit(X, y)
    with pytest.raises(ValueError, match=r"no exact one at 0\.5 times"):
        delay.resampled(DT / 2.0)
    np.testing.assert_allclose(
        delay.resampled(2.0 * DT).predict(X), delay.predict(np.repeat(X, 2, axis=0))[::2], atol=1e-9
    )
    y = np.zeros(300)
    for k in range(1, 300):
        y[k] = -0.5 * y[k - 1] + X[k - 1, 0]
    with pytest.raises(ValueError, match="negative"):
        NARXRegressor(dt=DT).fit(X, y).resampled(0.3 * DT)
    product = NARMAXRegressor(2, n_terms=3, dt=DT).fit(X, X[:, 0] ** 2 + 0.5 * y)
    with pytest.raises(ValueError, match="exact for linear terms"):
        product.resampled(DT / 2.0)
    with pytest.raises(ValueError, match="'dt' parameter"):
        delay.resampled(0.0)


WALK = np.abs(np.cumsum(held(60)[:, 0]))


def between(u, n):
    """Return a drive of straight lines at n times as many samples."""
    return np.interp(np.arange(n * (len(u) - 1) + 1) / n, np.arange(len(u)), u)


IN_SUBSTEPS = {
    "feedback": Feedback(SecondOrderMode(), SmoothCurve(3), n_substeps=4),
    "held feedback": Feedback(SecondOrderMode(hold="zoh"), SmoothCurve(3), n_substeps=4),
    "Stribeck curve": FreeMass(stribeck=True, n_substeps=4),
    "tanks": TankChain(1, n_substeps=4),
}


@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ConvergenceWarning")
@pytest.mark.parametrize("name", IN_SUBSTEPS)
def test_what_is_integrated_in_substeps_keeps_them(name):
    """Half the interval has half of them; where it would have no whole number it is refused."""
    fine = np.repeat(WALK, 2) if name == "held feedback" else between(WALK, 2)
    X, y = WALK[:, None], FirstOrderLagOperator(0.05).run(WALK, 0.02)[0]
    brief = VariableProjection(max_evaluations=2)
    model = clone(IN_SUBSTEPS[name]).set_params(dt=0.02, method=brief).fit(X, y)
    again = pickle.loads(pickle.dumps(model.resampled(0.01)))
    expected = model.predict(X)
    np.testing.assert_allclose(again.predict(fine[:, None])[::2], expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(again.resampled(0.02).predict(X), expected, rtol=1e-9, atol=1e-12)
    assert again.stepper().dt == 0.01
    with pytest.raises(ValueError, match=r"'dt' .*\.resampled must be a multiple of 0\.005 s"):
        model.resampled(0.006)


@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ConvergenceWarning")
@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_a_free_mass_is_exact_at_any_interval(hold):
    """From one sample to the next it moves by ``x'' = (u -+ F) / m - d x'``, solved exactly."""
    own = FreeMassOperator(0.5, 1.0, friction=0.3, hold=hold)
    model = FreeMass(hold=hold, dt=0.06, method=VariableProjection(max_evaluations=2))
    model.fit(WALK[:, None], own.run(WALK, 0.06)[0])
    fine = between(WALK, 3) if hold == "foh" else np.repeat(WALK, 3)
    found = model.resampled(0.02).predict(fine[:, None])
    np.testing.assert_allclose(found[::3], model.predict(WALK[:, None]), atol=1e-9)


def test_dynamics_behind_a_delay_by_whole_samples_and_sums_are_exact():
    delay, lag = DelayOperator(2.0 * DT), FirstOrderLagOperator(0.7 * DT)
    u = np.random.default_rng(0).normal(size=50)
    fine = between(u, 2)
    series = Series(("delay", "lag"), (delay, lag))
    for system in (series, SumOperator(("delayed", "lag"), (series, lag))):
        again = resampled(system, DT, 0.5 * DT).run(fine, 0.5 * DT)[0]
        np.testing.assert_allclose(again[::2], system.run(u, DT)[0], atol=1e-12)
    assert resampled(series, DT, 1.5 * DT) is None  # between two samples


def test_where_a_model_has_no_exact_one_at_another_interval_it_says_so(data):
    X, y = data
    model = Cascade([("plays", PrandtlIshlinskii(3)), ("lag", FirstOrderLag())]).fit(X, y)
    with pytest.raises(ValueError, match=r"'dt' .* Cascade\.resampled must be that of the fit"):
        model.resampled(0.5 * DT)
    plays = PrandtlIshlinskii(3, dt=DT).fit(X.to_numpy(), y.to_numpy())
    again = plays.resampled(0.3 * DT)  # which do not depend on time
    np.testing.assert_array_equal(again.predict(X.to_numpy()), plays.predict(X.to_numpy()))
    counted = FirstOrderLag().fit(X.to_numpy(), y.to_numpy())
    with pytest.raises(RecordError, match="constants are in samples"):
        counted.resampled(0.5)


# ------------------------------------------------------------------------------------ compositions


def steps_of(**params):
    return [("gain", Gain()), ("lag", FirstOrderLag(**params))]


COMPOSED = {
    "Cascade": lambda **own: Cascade(steps_of(**own)),
    "nested": lambda **own: Cascade([("all", Cascade(steps_of(**own)))]),
    "Modulated": lambda **own: Modulated(FirstOrderLag(**own), 0),
    "ScheduledParameters": lambda **own: ScheduledParameters(FirstOrderLag(**own), degree=0),
    "OnColumn": lambda **own: OnColumn(FirstOrderLag(**own), 0),
    "Corrected": lambda **own: Corrected(
        LinearRegression(), FirstOrderLag(**own), cv=2, max_iter=0
    ),
}


@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ConvergenceWarning")
@pytest.mark.parametrize("name", COMPOSED)
def test_a_composition_has_the_interval_of_its_steps(name, data):
    X, y = data
    model = COMPOSED[name](dt=DT).fit(X.to_numpy(), y.to_numpy())
    assert (model.dt_, model.time_unit_) == (DT, "s")
    found = [value for key, value in model.params_.items() if key.endswith("time_constant")]
    found += [v for k, v in model.params_.items() if k.startswith("time_constant[")]
    near = 0.1 if name == "Corrected" else 1e-6  # identified from predictions out of fold
    assert found == [pytest.approx(TIME_CONSTANT, rel=near)]


def test_a_cascade_starts_as_its_steps_do():
    u = 1.0 + np.random.default_rng(0).normal(size=N).cumsum()
    operator = FirstOrderLagOperator(TIME_CONSTANT)
    y, _ = operator.run(u, DT, operator.init(u[0], "zero"))
    model = Cascade([("lag", FirstOrderLag(initial_state="zero", dt=DT))]).fit(u[:, None], y)
    np.testing.assert_allclose(model.predict(u[:, None]), y, atol=1e-7)
    assert model.stepper().run(u) == pytest.approx(y, abs=1e-7)


def test_steps_that_contradict_each_other_are_refused_and_the_composition_decides(data):
    X, y = data
    array, response = X.to_numpy(), y.to_numpy()
    lags = [("one", FirstOrderLag(dt=DT)), ("other", FirstOrderLag(dt=1.0))]
    for kind in (Cascade, Sum):
        with pytest.raises(RecordError, match=r"'dt' parameter of .* must be given"):
            kind(lags).fit(array, response)
    with pytest.raises(RecordError, match="'dt' parameter of Corrected must be given"):
        Corrected(NARXRegressor(dt=1.0), FirstOrderLag(dt=DT), cv=2).fit(array, response)
    start = [("gain", Gain()), ("lag", FirstOrderLag(initial_state="zero", dt=DT))]
    with pytest.raises(RecordError, match="'initial_state' parameter of Cascade must be given"):
        Cascade(start).fit(array, response)
    model = Cascade(start, initial_state="rest").fit(array, response)
    assert model.params_["lag__time_constant"] == pytest.approx(TIME_CONSTANT, rel=1e-6)


def test_a_held_step_has_the_interval_of_its_fit(data):
    X, y = data
    lag = FirstOrderLag().fit(X, y)
    steps = [("gain", Gain()), ("lag", FrozenEstimator(lag))]
    model = Cascade(steps).fit(X.to_numpy(), 3.0 * y.to_numpy())
    assert model.dt_ == DT
    assert model.params_["gain__gain"] == pytest.approx(3.0, rel=1e-9)
    counted = FirstOrderLag().fit(X.to_numpy(), y.to_numpy())
    for inner in (steps[:1], [("inner", Cascade(steps[:1]))]):
        whole = Cascade([*inner, ("lag", FrozenEstimator(counted))])
        with pytest.raises(RecordError, match="its constants are in samples"):
            whole.fit(X, y)
        assert whole.fit(X.to_numpy(), y.to_numpy()).fit_error_ < 1e-9


# -------------------------------------------------------------------------------------- the drive


def with_temperature(data):
    """A frame whose first column is a temperature, as a ColumnTransformer leaves it."""
    X, y = data
    return X.assign(temp=np.linspace(20.0, 25.0, N))[["temp", "u"]], y


@pytest.mark.parametrize("drive", ["u", 1, -1])
@pytest.mark.parametrize(
    "kind",
    [FirstOrderLag, lambda drive: Cascade([("gain", Gain()), ("lag", FirstOrderLag(drive=drive))])],
)
def test_the_drive_is_a_column_by_name_or_position(kind, drive, data):
    X, y = with_temperature(data)
    model = kind(drive=drive).fit(X, y)
    np.testing.assert_allclose(model.predict(X), y, atol=1e-6)
    u = X["u"].to_numpy()
    assert model.drive_range_ == (u.min(), u.max())
    stepper = model.stepper(u0=[20.0, u[0]])
    np.testing.assert_allclose(stepper.run(u), y, atol=1e-6)


@pytest.mark.parametrize("kind", [FirstOrderLag, NARXRegressor])
def test_another_drive_than_that_of_the_fit_is_refused(kind, data):
    X, y = with_temperature(data)
    model = pickle.loads(pickle.dumps(kind(drive="u").fit(X, y)))
    expected = model.predict(X)
    np.testing.assert_array_equal(model.set_params(drive=-1).predict(X), expected)
    for drive in ("temp", None):
        with pytest.raises(ValueError, match="must be that of the fit, column 1"):
            model.set_params(drive=drive).predict(X)


def test_features_of_a_narmax_model_are_those_of_its_drive(data):
    X, y = with_temperature(data)
    options = {"features": ["rate_sign"], "n_terms": None}
    first = NARMAXRegressor(1, **options).fit(X[["u", "temp"]], y)
    model = NARMAXRegressor(1, drive="u", **options).fit(X, y)
    np.testing.assert_allclose(model.predict(X), first.predict(X[["u", "temp"]]), atol=1e-6)
    u = X["u"].to_numpy()
    assert model.drive_range_ == (u.min(), u.max())
    run = model.stepper(u0=X.to_numpy()[0]).run(X.to_numpy())
    np.testing.assert_allclose(run, model.predict(X), atol=1e-6)


def test_a_drive_that_is_not_there_is_refused(data):
    X, y = with_temperature(data)
    with pytest.raises(ValueError, match=r"'drive' parameter of FirstOrderLag .* Got 'v'"):
        FirstOrderLag(drive="v").fit(X, y)
    with pytest.raises(ValueError, match="Got 'u' instead"):
        FirstOrderLag(drive="u", dt=DT).fit(X.to_numpy(), y.to_numpy())
    with pytest.raises(ValueError, match="must be a name or a position"):
        FirstOrderLag(drive=True).fit(X, y)
    with pytest.raises(RecordError, match="'drive' parameter of Cascade must be given"):
        Cascade([("gain", Gain(drive=0)), ("lag", FirstOrderLag(drive="u"))]).fit(X, y)


@pytest.mark.parametrize(
    "model",
    [
        Sum([("lag", FirstOrderLag(drive="u")), ("temperature", OnColumn(Gain(), 0))]),
        EffectSearchCV(FirstOrderLag(drive="u"), effects=["offset"]),
        Corrected(LinearRegression(), FirstOrderLag(drive="u")),
    ],
)
def test_where_further_columns_are_read_the_drive_must_be_the_first(model, data):
    with pytest.raises(ValueError, match="The drive must be column 0 of X"):
        model.fit(*with_temperature(data))


@pytest.mark.filterwarnings("ignore:The data do not determine")
@pytest.mark.filterwarnings("ignore:The records do not begin at rest")  # nor does the wrong drive
def test_a_drive_that_explains_less_than_a_column_beside_it_is_told(data):
    X, y = with_temperature(data)
    with pytest.warns(UserWarning, match="straight line through column 'u' .* column 'temp'"):
        FirstOrderLag().fit(X, y)
    FirstOrderLag().fit(X[["u", "temp"]], y)


def test_a_model_in_seconds_without_an_interval_asks_for_one(data):
    X, y = data
    model = TransferFunction.from_system(lti([1.0], [TIME_CONSTANT, 1.0]))
    np.testing.assert_allclose(model.predict(X), y, atol=1e-9)
    with pytest.raises(RecordError, match="must have a time index, or 'dt' must be given"):
        model.predict(X.to_numpy())
    np.testing.assert_allclose(model.set_params(dt=DT).predict(X.to_numpy()), y, atol=1e-9)


def test_a_fit_to_a_frequency_response_has_its_interval(data):
    X, y = data
    model = TransferFunction(1, hold="foh").fit_frequency_response(frequency_response(X, y))
    assert (model.dt_, model.time_unit_) == (DT, "s")
    np.testing.assert_array_equal(model.predict(X.to_numpy()), model.predict(X))
    counted = frequency_response(X.to_numpy(), y.to_numpy())
    model = TransferFunction(1, hold="foh").fit_frequency_response(counted)
    with pytest.raises(RecordError, match="fitted without a time"):
        model.predict(X)


@pytest.mark.filterwarnings("ignore:X does not have valid feature names")
def test_a_search_and_its_best_model_answer_at_the_interval_of_the_fit(data):
    X, y = data
    noise = 1e-2 * np.random.default_rng(1).normal(size=N)
    search = EffectSearchCV(FirstOrderLag(), effects=["offset"], cv=2, max_effects=1)
    search.fit(X, y + noise)
    expected = search.predict(X)
    np.testing.assert_allclose(expected, y, atol=0.05)
    for model in (search, search.best_estimator_, search.declared_estimator_):
        np.testing.assert_array_equal(model.predict(X.to_numpy()), model.predict(X))
