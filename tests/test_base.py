"""The base of all models: data in every shape, units of every size, states, pickles."""

import copy
import pickle
import subprocess
import sys
import warnings

import numpy as np
import pandas as pd
import pytest
import sklearn
from scipy.signal import lfilter, lti
from sklearn.base import clone
from sklearn.exceptions import DataConversionWarning
from sklearn.frozen import FrozenEstimator
from sklearn.linear_model import LinearRegression
from sklearn.metrics import root_mean_squared_error
from sklearn.model_selection import GridSearchCV
from sklearn.pipeline import make_pipeline

import skhyst
from skhyst.autoregressive import NARXRegressor
from skhyst.base import ParametricModel
from skhyst.compose import Cascade, Corrected, OnColumn, ScheduledParameters, Sum
from skhyst.control import Observer
from skhyst.disturbance import Offset
from skhyst.exceptions import (
    ConvergenceWarning,
    DivergenceWarning,
    ExtrapolationWarning,
    RecordError,
)
from skhyst.hysteresis import (
    FreeMass,
    FreeMassOperator,
    MaxwellSlip,
    PrandtlIshlinskii,
    PrandtlIshlinskiiOperator,
    Preisach,
)
from skhyst.linear import (
    FirstOrderLag,
    FirstOrderLagOperator,
    Gain,
    SecondOrderMode,
    SecondOrderModeOperator,
    TransferFunction,
)
from skhyst.model_selection import washout_scorer
from skhyst.operators import Series, run_records, run_variance
from skhyst.optimize import OperatorProblem
from skhyst.persistence import from_json, to_json
from skhyst.records import record_slices, stack_records
from skhyst.static import SaturationOperator

DT, N = 0.01, 300
TIME = DT * np.arange(N)


def drive(seed=0):
    rng = np.random.default_rng(seed)
    frequencies = np.geomspace(0.4, 12.0, 6)
    waves = np.sin(2 * np.pi * np.outer(TIME, frequencies) + rng.uniform(0, 6, 6))
    return waves @ (1.0 / np.arange(1, 7))


PLANT = Series(
    ("plays", "lag"),
    (PrandtlIshlinskiiOperator([0.0, 0.3], [1.0, 0.4], 0.2), FirstOrderLagOperator(0.04)),
)
U = drive()
Y = PLANT.run(U, DT)[0] + 0.002 * np.random.default_rng(5).normal(size=N)
X = U.reshape(-1, 1)

MODELS = {
    "hysteresis": PrandtlIshlinskii(5, dt=DT),
    "lag": FirstOrderLag(dt=DT),
    "cascade": Cascade(
        [("plays", PrandtlIshlinskii(2, thresholds=[0.0, 0.3])), ("lag", FirstOrderLag())], dt=DT
    ),
}


@pytest.fixture(params=MODELS)
def model(request):
    return clone(MODELS[request.param])


def frame(u=U, start=0.0, record=None):
    index = pd.Index(TIME[: len(u)] + start, name="time")
    if record is not None:
        index = pd.MultiIndex.from_product([[record], index], names=["record", "time"])
    return pd.DataFrame({"drive": u}, index)


# ----------------------------------------------------------------------------------------- units


@pytest.mark.parametrize(
    ("drive_unit", "response_unit"), [(1e-9, 1e12), (1e9, 1e-12), (1e-9, 1e-12)]
)
def test_units(model, drive_unit, response_unit):
    """Nothing but the numbers' size changes."""
    if isinstance(model, Cascade):
        model.set_params(plays__thresholds=[0.0, 0.3 * drive_unit])
    reference = clone(model)
    if isinstance(model, Cascade):
        reference.set_params(plays__thresholds=[0.0, 0.3])
    reference.fit(X, Y)
    model.fit(X * drive_unit, Y * response_unit)
    expected = reference.predict(X)
    found = model.predict(X * drive_unit) / response_unit
    np.testing.assert_allclose(found, expected, atol=1e-5)
    assert model.fit_error_ / response_unit == pytest.approx(reference.fit_error_, rel=1e-3)
    assert model.identifiability_["undetermined"] == reference.identifiability_["undetermined"]


@pytest.mark.parametrize("interval", [1e-9, 1e6])
def test_interval(interval):
    model = FirstOrderLag(dt=interval).fit(X, Y)
    expected = FirstOrderLag(dt=DT).fit(X, Y)
    ratio = model.operator_.time_constant / interval
    assert ratio == pytest.approx(expected.operator_.time_constant / DT, rel=1e-3)


def test_large_offsets(model):
    model.fit(X, Y + 1e4)
    np.testing.assert_allclose(model.predict(X) - 1e4, clone(model).fit(X, Y).predict(X), atol=1e-3)


@pytest.mark.parametrize("unit", [1e150, 1e-150])
def test_units_beyond_floating_point_are_refused(model, unit):
    with pytest.raises(RecordError, match=r"largest value of X.*another unit"):
        model.fit(X * unit, Y)
    with pytest.raises(RecordError, match=r"largest value of y.*another unit"):
        model.fit(X, Y * unit)


# ------------------------------------------------------------------------------------ broken data


def test_no_and_one_sample(model):
    with pytest.raises(ValueError, match="minimum of 2 is required"):
        model.fit(X[:1], Y[:1])
    with pytest.raises(ValueError, match="0 sample"):
        model.fit(X[:0], Y[:0])
    model.fit(X, Y)
    with pytest.raises(ValueError, match="0 sample"):
        model.predict(X[:0])
    assert model.predict(X[:1])[0] == model.predict(X)[0]


def test_two_samples(model):
    with pytest.warns(ConvergenceWarning, match="do not determine"):
        model.fit(X[:2], Y[:2])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExtrapolationWarning)
        assert np.isfinite(model.predict(X)).all()


@pytest.mark.filterwarnings("ignore:The data do not determine")
@pytest.mark.parametrize("level", [0.0, 2.5])
@pytest.mark.parametrize("response", [0.0, -3.0])
def test_constant_drive(model, level, response):
    """The response at that drive is learnt, and nothing else is claimed."""
    with pytest.warns(ConvergenceWarning, match=f"The drive does not move: it is {level:g}"):
        model.fit(np.full((N, 1), level), np.full(N, response))
    np.testing.assert_allclose(model.predict(np.full((5, 1), level)), response, atol=1e-6)
    assert np.isfinite(model.predict(X)).all()
    if response:  # what is zero has no scale to be small against
        known = {name for name, std in model.params_std_.items() if np.isfinite(std)}
        assert known <= {"intercept", "plays__intercept"}


@pytest.mark.parametrize(("first", "state"), [(0.0, "zero"), (4.5, "estimate"), (None, None)])
def test_records_that_begin_otherwise_than_at_rest_are_told(first, state):
    """x' = (2 u - x) / 0.1 s, a drive that is held between samples."""
    rng, y = np.random.default_rng(0), np.zeros(400)
    u = np.repeat(rng.uniform(0.5, 1.5, 20), 20)
    y[0] = 2.0 * u[0] if first is None else first
    for k in range(1, 400):
        y[k] = 2.0 * u[k - 1] + (y[k - 1] - 2.0 * u[k - 1]) * np.exp(-0.1)
    y += 1e-3 * rng.normal(size=400)
    model = FirstOrderLag(hold="zoh", dt=0.01)
    if first is None:
        model.fit(u[:, None], y)
    else:
        with pytest.warns(ConvergenceWarning, match=f"with initial_state='{state}' the error is"):
            model.fit(u[:, None], y)
        model.set_params(initial_state=state).fit(u[:, None], y)
    assert model.fit_error_ < 1.1e-3
    assert model.operator_.time_constant == pytest.approx(0.1, rel=1e-2)


def test_a_single_row_with_a_time_tells_no_interval():
    frame = pd.DataFrame({"u": U}, pd.Index(TIME, name="time"))
    model = Gain().fit(frame, 2.0 * U)
    with pytest.raises(RecordError, match=r"A single row with a time.*'stepper'"):
        model.predict(frame[:1])


def test_records_whose_start_is_known_are_run_once(monkeypatch):
    """The others begin at rest."""
    X, y = stack_records([(U[:100], Y[:100]), (U[100:], Y[100:])], dt=DT)
    model, n_run = PrandtlIshlinskii(5).fit(X, y), []
    run = skhyst.base.run_records
    monkeypatch.setattr(
        skhyst.base, "run_records", lambda *own: n_run.append(len(own[2])) or run(*own)
    )
    found = model.predict(X, y_start=np.where(np.arange(N) < 120, np.nan, y))
    assert n_run == [1]
    np.testing.assert_array_equal(found[:100], model.predict(X)[:100])
    model.predict(X, y_start=y)
    assert n_run == [1, 2]


def test_rows_behind_missing_ones_begin_elsewhere():
    """A fit finds out how; a prediction, which cannot know, says so wherever rows follow."""
    u = drive().cumsum() / 10
    u -= u[0]  # from rest and from zero
    y = FirstOrderLagOperator(0.4).run(u, DT)[0] + 1e-3 * np.random.default_rng(0).normal(size=N)
    frame = pd.DataFrame({"u": u}, pd.Index(TIME, name="time"))
    with pytest.warns(ConvergenceWarning, match="do not begin at rest.*'estimate'"):
        FirstOrderLag().fit(frame[80:], y[80:])
    kept = (np.arange(N) < 60) | (np.arange(N) >= 80)
    for state in ("zero", "estimate", "rest"):
        model = FirstOrderLag(initial_state=state).fit(frame[kept], y[kept])
        assert model.fit_error_ < 1.1e-3
        for name, value in {"gain": 1.0, "time_constant": 0.4}.items():
            error = 4.0 * model.params_std_[name]
            assert model.params_[name] == pytest.approx(value, abs=error)
            assert error < 0.01 * value
    with pytest.warns(ConvergenceWarning, match="missing before row 60"):
        model.predict(frame[kept])
    known = FrozenEstimator(LinearRegression().fit(frame, u))
    around = Corrected(known, FirstOrderLag(), cv=2, max_iter=1)
    around.fit(frame[kept], y[kept])  # warnings are errors
    assert around.fit_error_ < 1.1e-3
    assert around.params_["time_constant"] == pytest.approx(0.4, rel=0.01)
    with pytest.warns(ConvergenceWarning, match="missing before row 60.*Corrected"):
        around.predict(frame[kept])
    known = np.where(np.arange(N) < 120, y, np.nan)[kept]
    found = model.predict(frame[kept], y_start=known)  # warnings are errors
    np.testing.assert_allclose(found, y[kept], atol=0.02)


@pytest.mark.filterwarnings("ignore:The (data do not|records hold|records do not begin)")
@pytest.mark.parametrize("state", ["rest", "estimate"])
def test_records_of_no_common_parameters_are_told(state):
    """Such as of an offset, which would end in a time constant of hundreds of records."""
    u, plant, half = drive().cumsum() / 10, FirstOrderLagOperator(0.4), N // 2
    y = np.concatenate([plant.run(part, DT)[0] for part in (u[:half], u[half:])])
    y += 1e-3 * np.random.default_rng(0).normal(size=N)
    index = pd.MultiIndex.from_product([["a", "b"], TIME[:half]], names=["record", "time"])
    X, second = pd.DataFrame({"u": u}, index), np.arange(N) >= half
    for other in (y + 5.0 * second, y * np.where(second, 1e3, 1.0)):
        with pytest.warns(ConvergenceWarning, match="No one set of parameters of FirstOrderLag"):
            FirstOrderLag(initial_state=state).fit(X, other)
    model = Sum([("lag", FirstOrderLag()), ("offset", Offset())], initial_state=state)
    model.fit(X, y + 5.0 * second)  # warnings are errors
    assert model.params_["lag__time_constant"] == pytest.approx(0.4, rel=0.01)


@pytest.mark.parametrize("factor", [1e3, 1e-3, -1.0])
def test_a_known_response_that_no_start_leads_to_is_told(factor):
    model = FirstOrderLag(dt=DT).fit(X, Y + 1e-3 * np.random.default_rng(0).normal(size=N))
    known = np.where(np.arange(N) < 40, Y, np.nan)
    model.predict(X, y_start=known)  # warnings are errors
    model.predict(X, y_start=np.where(np.arange(N) < 1, Y, np.nan))
    model.stepper_from(X[:40], Y[:40])
    with pytest.warns(ConvergenceWarning, match="does not follow the known response"):
        model.predict(X, y_start=factor * known)
    with pytest.warns(ConvergenceWarning, match="does not follow the known response"):
        model.stepper_from(X[:40], factor * Y[:40])
    with pytest.warns(ConvergenceWarning, match="does not follow the known response"):
        model.predict(X, y_start=factor * Y)
    observer = Observer(model, noise_std=1e-3, drift_std=0.1, process_std=0.1).fit(X, Y)
    observer.filter(X, Y + 7.0)  # which the random walk follows
    with pytest.warns(ConvergenceWarning, match="does not follow the known response"):
        observer.filter(X, factor * Y)


@pytest.mark.parametrize("name", ["lag", "mode", "mass"])
def test_what_readings_do_not_determine_is_at_rest_and_in_the_standard_deviation(name):
    """Errors relative to it, over all rows: no reading invents a velocity, or a start before it."""
    rng = np.random.default_rng(4)
    u = rng.normal(size=400).cumsum() / 5.0
    if name == "mass":  # whose motion stays in one place
        u = np.cos(np.outer(0.02 * np.arange(400), [2.0, 3.1])) @ [1.0, 0.5]
    plant, model = {
        "lag": (FirstOrderLagOperator(0.2), FirstOrderLag(dt=0.02)),
        "mode": (SecondOrderModeOperator(8.0, 0.05), TransferFunction(2, n_zeros=0, dt=0.02)),
        "mass": (FreeMassOperator(1.0), FreeMass(dt=0.02, initial_state="estimate")),
    }[name]
    y = plant.run(u, 0.02)[0]
    y += 3e-3 * np.std(y[:200]) * rng.normal(size=400)
    model.fit(u[:200, None], y[:200])
    late = y[200:]
    for rows in (list(range(80, 120)), [0, 1, 2, 3], [0]):  # with a reading
        known = np.full(200, np.nan)
        known[rows] = late[rows]
        found, std = model.predict(u[200:, None], y_start=known, return_std=True)
        assert np.mean(np.abs(found - late) < 1.96 * std) > 0.8
        assert np.abs(found - late).max() < 4.5 * std[np.argmax(np.abs(found - late))]
        np.testing.assert_allclose(found[rows], late[rows], atol=4.0 * model.noise_std_)
    # the last from a single one
    if name == "mass":  # without a force it stays where it was read
        force = model.operator_.force_offset
        rested = model.predict(np.full((200, 1), -force), y_start=known)
        np.testing.assert_allclose(rested, late[0], atol=4.0 * model.noise_std_)
        assert std[1] > 2.0 * model.noise_std_
    else:  # motion that the reading shows, and no more
        rest = model.predict(u[200:, None])
        assert np.abs(found - rest).max() < 1.5 * abs(late[0] - rest[0]) + 4.0 * std[0]


def test_a_start_is_found_from_readings_that_it_hardly_changes():
    """Most of them are read when it has been forgotten."""
    plant, u = FirstOrderLagOperator(0.2), np.random.default_rng(4).normal(size=600).cumsum() / 5.0
    y = plant.run(u, 0.02)[0] + 0.03 * np.random.default_rng(5).normal(size=600)
    model = FirstOrderLag(dt=0.02).fit(u[:300, None], y[:300])
    moving = y + 2.0 * np.exp(-0.1 * (np.arange(600) - 300))
    known = np.where(np.arange(300) < 25, np.nan, moving[300:])
    found = model.predict(u[300:, None], y_start=known)
    np.testing.assert_allclose(found, moving[300:], atol=0.6)


@pytest.mark.filterwarnings("ignore:The data do not determine")  # but the ratio of both
def test_the_start_of_a_slow_pole_is_found_to_the_noise():
    """Whose rest, at the gain of an integrator, is far beyond all that it does."""
    u = np.repeat(np.random.default_rng(0).uniform(-1.0, 1.0, 30), 20)
    lags = FirstOrderLagOperator(1e7, gain=1e7), FirstOrderLagOperator(0.1)
    plant = Series(("slow", "fast"), lags)
    y, _ = plant.run(u, DT, plant.init(u[0], "zero"))
    y += 1e-3 * np.random.default_rng(1).normal(size=600)
    model = TransferFunction(2, n_zeros=0, dt=DT, initial_state="zero").fit(u[:300, None], y[:300])
    late, known = y[300:], np.full(300, np.nan)
    known[:6] = late[:6]
    found, std = model.predict(u[300:, None], y_start=known, return_std=True)
    assert np.abs(found - late).max() < 4.0 * std.max() < 0.02


def test_what_data_do_not_determine_is_told_whatever_its_start():
    model = FirstOrderLag(dt=DT)
    with pytest.warns(ConvergenceWarning, match="do not determine.*: time_constant"):
        model.fit_from(FirstOrderLagOperator(1.4), X, np.zeros(N))
    assert model.params_std_["time_constant"] == np.inf
    np.testing.assert_allclose(model.predict(X), 0.0, atol=1e-12)


def test_drives_and_times_that_may_be_in_another_unit_are_told():
    X, y = frame(), pd.Series(Y, frame().index)
    model = FirstOrderLag().fit(X, y)
    model.predict(20.0 * X)  # warnings are errors
    with pytest.warns(ExtrapolationWarning, match="Are they in the same unit"):
        model.predict(1e3 * X)
    counted = X.set_axis(1e3 * X.index)
    with pytest.warns(ExtrapolationWarning, match="1000 times as much"):
        model.predict(counted)
    Gain().fit(X, y).predict(counted)  # whatever the interval
    with pytest.warns(ConvergenceWarning, match="have X and y been swapped"):
        FirstOrderLag().fit(X.set_axis(["response"], axis=1), y.rename("drive"))


def test_a_response_of_weight_zero_may_be_missing():
    weights = np.where(np.arange(N) % 7 == 3, 0.0, 1.0)
    missing = np.where(weights > 0.0, Y, np.nan)
    for model in (FirstOrderLag(dt=DT), NARXRegressor(dt=DT), Corrected(LinearRegression(), dt=DT)):
        whole = clone(model).fit(X, Y, weights).predict(X)
        np.testing.assert_allclose(clone(model).fit(X, missing, weights).predict(X), whole)
    with pytest.raises(ValueError, match="NaN"):
        FirstOrderLag(dt=DT).fit(X, missing)


@pytest.mark.parametrize("kind", [FirstOrderLag, Corrected, Observer])
def test_a_response_in_another_unit_than_that_of_the_fit_is_refused(kind):
    lag = FirstOrderLag(dt=DT)
    first = {Corrected: [LinearRegression(), lag], Observer: [lag]}.get(kind, [])
    model = kind(*first, **({} if first else {"dt": DT}))
    model.fit(X, pd.Series(Y, name="position [µm]"))
    uses = {
        FirstOrderLag: ("predict", "stepper_from", "score"),
        Corrected: ("predict", "score"),
        Observer: ("filter", "innovations"),
    }
    for use in uses[kind]:
        by = {"y_start" if use == "predict" else "y": pd.Series(1e3 * Y, name="position (nm)")}
        with pytest.raises(RecordError, match=f"must be in um, as in the fit of {kind.__name__}"):
            getattr(model, use)(X, **by)
        by = {own: pd.Series(Y, name="x / um") for own in by}
        getattr(model, use)(X, **by)


@pytest.mark.parametrize("name", ["lag", "cascade"])
def test_constant_response(name):
    """No gain, so there is nothing to see of the time constant."""
    model = clone(MODELS[name])
    with pytest.warns(ConvergenceWarning, match=r"do not determine.*time_constant"):
        model.fit(X, np.full(N, 1.5))
    np.testing.assert_allclose(model.predict(X), 1.5, atol=1e-6)


def test_shuffled_rows(model):
    order = np.random.default_rng(0).permutation(N)
    shuffled = frame().iloc[order]
    with pytest.raises(RecordError, match=r"not in the order of time.*RecordKFold"):
        model.fit(shuffled, Y[order])
    with pytest.raises(RecordError, match="not in the order of time"):
        model.fit(frame(), Y).predict(shuffled)


def test_samples_that_count_and_a_drive_that_rests_in_them():
    """No straight line is held against the model: warnings of a division are errors."""
    step = (np.arange(N) > 0.0)[:, None].astype(float)
    with pytest.warns(ConvergenceWarning, match="do not determine"):
        Gain(dt=DT).fit(step, Y, sample_weight=step[:, 0])


def test_masked_values_are_refused():
    masked = np.arange(N) == 5
    drive_, response = np.ma.array(X, mask=masked[:, None]), np.ma.array(Y, mask=masked)
    model = FirstOrderLag(dt=DT).fit(np.ma.array(X), np.ma.array(Y))
    for attempt in (
        lambda: model.fit(drive_, Y),
        lambda: model.fit(X, response),
        lambda: model.fit(X, Y, sample_weight=np.ma.array(np.ones(N), mask=masked)),
        lambda: model.predict(drive_),
        lambda: model.predict(X, y_start=response),
        lambda: stack_records([(drive_, Y)], dt=DT),
        lambda: stack_records([(X, response)], dt=DT),
    ):
        with pytest.raises(RecordError, match=r"must be known\. Got 1 masked"):
            attempt()


@pytest.mark.parametrize("wrong", [None, "nan"])
def test_a_response_of_objects_is_numbers(wrong):
    y = Y.astype(object)
    assert FirstOrderLag(dt=DT).fit(X, y).fit_error_ == FirstOrderLag(dt=DT).fit(X, Y).fit_error_
    y[7] = wrong
    with pytest.raises(RecordError, match="response y must be"):
        FirstOrderLag(dt=DT).fit(X, y)


def test_a_fit_from_an_operator_of_another_model_is_refused():
    with pytest.raises(ValueError, match="must be a SecondOrderModeOperator"):
        SecondOrderMode(dt=DT).fit_from(FirstOrderLagOperator(0.1), X, Y)
    steps = [("a", FirstOrderLag()), ("b", FirstOrderLag())]
    for model in (Cascade(steps, dt=DT), Sum(steps, dt=DT), ScheduledParameters(steps[0][1])):
        for wrong in (FirstOrderLagOperator(0.1), FirstOrderLag(), None):
            with pytest.raises(ValueError, match="must have the parts of this model"):
                model.fit_from(wrong, X, Y)


def test_a_known_response_is_that_of_the_rows(model):
    model.fit(frame(), Y)
    for known in (pd.Series(Y, frame().index[::-1]), pd.Series(Y, frame(record="b").index)):
        with pytest.raises(RecordError, match="index of X and that of y must be equal"):
            model.predict(frame(), y_start=known)
    with pytest.warns(DataConversionWarning, match="column-vector"):
        found = model.predict(frame(), y_start=Y[:, None])
    same = pd.Series(Y, frame().index)
    np.testing.assert_array_equal(found, model.predict(frame(), y_start=same))


def test_each_record_runs_at_its_own_interval(model):
    other = frame(record="b")
    other.index = pd.MultiIndex.from_product([["b"], 3 * TIME], names=["record", "time"])
    model.fit(frame(record="a"), Y)
    both = model.predict(pd.concat([frame(record="a"), other]))
    parts = [model.predict(frame(record="a")), model.predict(other)]
    np.testing.assert_array_equal(both, np.concatenate(parts))


def test_uneven_sampling(model):
    uneven = frame()
    uneven.index = TIME**1.1
    with pytest.raises(RecordError, match="resample_records"):
        model.fit(uneven, Y)


def test_lost_index(model):
    index = frame(record="a").index
    with pytest.raises(RecordError, match=r'set_output\(transform="pandas"\)'):
        model.fit(X, pd.Series(Y, index))


# ---------------------------------------------------------------------------------- shapes of data


def test_further_columns_do_not_matter_yet(model):
    wide = np.hstack([X, np.random.default_rng(0).normal(size=(N, 2))])
    assert model.fit(wide, Y).n_features_in_ == 3
    np.testing.assert_array_equal(model.predict(wide), clone(model).fit(X, Y).predict(X))


@pytest.mark.parametrize(
    "convert",
    [
        lambda u: u.tolist(),
        lambda u: np.asfortranarray(u),
        lambda u: u[::-1][::-1],
        lambda u: pd.DataFrame(u),
        lambda u: pd.DataFrame({"drive": u[:, 0]}, TIME),
        lambda u: pd.DataFrame({"drive": u[:, 0]}, pd.to_timedelta(TIME, unit="s")),
        lambda u: pd.DataFrame(
            {"drive": u[:, 0]}, pd.Timestamp("2024-01-01") + pd.to_timedelta(TIME, unit="s")
        ),
    ],
    ids=["list", "fortran", "strided", "frame", "seconds", "timedelta", "datetime"],
)
def test_containers(model, convert):
    expected = clone(model).fit(X, Y).predict(X)
    given = convert(X)
    np.testing.assert_allclose(model.fit(given, Y).predict(given), expected, atol=1e-7)


def test_inputs_are_left_alone(model):
    given, response = frame(record="a"), pd.Series(Y, frame(record="a").index)
    kept = given.copy(deep=True), response.copy(deep=True)
    model.fit(given, response).predict(given)
    pd.testing.assert_frame_equal(given, kept[0])
    pd.testing.assert_series_equal(response, kept[1])
    frozen, target = X.copy(), Y.copy()
    frozen.flags.writeable = target.flags.writeable = False
    clone(model).fit(frozen, target).predict(frozen)


def test_index_overrules_the_interval():
    model = FirstOrderLag(dt=123.0).fit(frame(), Y)
    plain = FirstOrderLag(dt=DT).fit(X, Y)
    assert model.operator_.time_constant == pytest.approx(plain.operator_.time_constant)
    # another interval in the prediction than in the fit
    finer = pd.DataFrame(
        {"drive": np.interp(np.arange(2 * N - 1) / 2, np.arange(N), U)},
        DT / 2 * np.arange(2 * N - 1),
    )
    np.testing.assert_allclose(model.predict(finer)[::2], plain.predict(X), atol=1e-9)


# --------------------------------------------------------------------------------- initial states


def test_rest_and_zero():
    u = 1.0 + U
    for state in ("rest", "zero"):
        y, _ = PLANT.run(u, DT, PLANT.init(u[0], state))
        model = clone(MODELS["cascade"]).set_params(initial_state=state)
        model.fit(u.reshape(-1, 1), y)
        assert model.operators_["lag"].time_constant == pytest.approx(0.04, rel=1e-4)
        np.testing.assert_allclose(model.predict(u.reshape(-1, 1)), y, atol=1e-5)
    y, _ = PLANT.run(u, DT, PLANT.init(u[0], "zero"))
    with pytest.warns(ConvergenceWarning, match="with initial_state='zero' the error is"):
        wrong = clone(MODELS["cascade"]).fit(u.reshape(-1, 1), y)
    assert wrong.fit_error_ > 0.01


def test_estimated_history():
    """Two records that start after a rest at -2 and at +2."""
    plays = PrandtlIshlinskiiOperator([0.0, 0.5, 1.0], [1.0, 0.5, 0.4])
    u = [0.8 * drive(0), 0.8 * drive(1)]
    parts = [
        plays.run(np.r_[before, part], DT)[0][1:] for before, part in zip((-2, 2), u, strict=True)
    ]
    data = pd.concat([frame(part, record=i) for i, part in enumerate(u)]), np.concatenate(parts)
    options = {"thresholds": [0.0, 0.5, 1.0]}
    with pytest.warns(ConvergenceWarning, match="with initial_state='estimate' the error is"):
        rest = PrandtlIshlinskii(**options).fit(*data)
    model = PrandtlIshlinskii(**options, initial_state="estimate").fit(*data)
    assert model.fit_error_ < 0.2 * rest.fit_error_
    assert model.initial_drive_.shape == (2, int(np.log2(N // 2)) + 1)
    assert model.initial_drive_[0].min() < -1.0 < 1.0 < model.initial_drive_[1].max()
    # a new record has no known history
    operator, first = model.operator_, data[0].iloc[:N]
    expected, _ = operator.run(first["drive"].to_numpy(), DT)
    np.testing.assert_array_equal(model.predict(first), expected)


@pytest.mark.parametrize(
    "model",
    [
        Sum([("drive", Gain()), ("temperature", OnColumn(FirstOrderLag()))], dt=DT),
        TransferFunction(1, n_zeros=1, inputs="all", dt=DT),
    ],
)
def test_what_came_before_several_inputs(model):
    """Only the past of the second one matters; a fit, a prediction and a score find it."""
    X = np.column_stack([drive(0), drive(1) + 3.0 * np.cos(3.0 * TIME)])
    noise = 1e-3 * np.random.default_rng(0).normal(size=N)
    y = 2.0 * X[:, 0] + FirstOrderLagOperator(0.3, gain=2.0).run(X[:, 1], DT)[0] + noise
    late, rest = slice(100, None), clone(model).fit(X, y)
    own = clone(model).set_params(initial_state="estimate").fit(X[late], y[late])
    assert own.initial_drive_.shape == (1, 7, 2)
    assert own.fit_error_ < 1.2e-3
    known = np.where(np.arange(N - 100) < 40, y[late], np.nan)
    errors = [found - y[late] for found in (rest.predict(X[late]), rest.predict(X[late], known))]
    assert np.std(errors[1][40:]) < 1.3e-3 < 0.1 < np.std(errors[0][40:])
    options = {"washout": 40, "initial_state": "estimate"}
    score = washout_scorer(root_mean_squared_error, **options)(rest, X[late], y[late])
    assert -score < 1.3e-3


def test_a_record_that_tells_nothing_begins_as_in_predict():
    """What stands beside it is then the mean over the records of the fit, as in predict."""
    u = [drive(0), drive(1)]
    data = pd.concat([frame(part, record=i) for i, part in enumerate(u)])
    y = np.concatenate([PLANT.run(u[0], DT)[0] + 2.0, PLANT.run(u[1], DT)[0] + 4.0])
    model = Sum([("plant", MODELS["cascade"]), ("offset", Offset())], dt=DT).fit(data, y)
    y[N:] = np.nan
    free, told = model.predict(data), model.predict(data, y)
    np.testing.assert_array_equal(told[N:], free[N:])
    assert np.abs(free[N:]).mean() > 1.0
    assert np.nanmax(np.abs(told - y)) < 0.01 < 0.9 < np.nanmax(np.abs(free - y))


def test_what_is_known_of_a_long_record_is_enough(monkeypatch):
    """To find how it began, no more is simulated than the known part and as much before it."""
    u = np.tile(drive(), 20)
    y = PLANT.run(u, DT)[0]
    model = clone(MODELS["cascade"]).fit(u[:2000, None], y[:2000])
    lengths, simulate = [], OperatorProblem.simulate

    def counted(self, operator, record):
        lengths.append(len(record.with_history[0]))
        return simulate(self, operator, record)

    monkeypatch.setattr(OperatorProblem, "simulate", counted)
    known = np.where(np.arange(len(u) - 2000) < 50, y[2000:], np.nan)
    found = model.predict(u[2000:, None], known)
    assert np.max(lengths[:-1]) < 2 * 50  # the last one is the prediction
    away = [np.abs(own - y[2000:]).max() for own in (model.predict(u[2000:, None]), found)]
    assert away[1] < 0.02 < 0.1 < away[0]


# ----------------------------------------------------------------------- standard deviations


def line_and_noise(n, seed=0):
    rng = np.random.default_rng(seed)
    u = rng.normal(size=n) + 2.0
    return u, 3.0 * u + 1.0 + rng.normal(0.0, 0.2, n)


@pytest.mark.parametrize("offset", [False, True])
def test_standard_deviation_of_a_straight_line(offset):
    """That of linear regression, ``s^2 (1 + x^T (X^T X)^-1 x)``, whichever part has the constant.

    The noise of this seed is white, and taken to be.
    """
    u, y = line_and_noise(200)
    model = Sum([("gain", Gain()), ("offset", Offset())], dt=DT) if offset else Gain(dt=DT)
    new = np.array([-50.0, 2.0, 80.0])
    model.fit(pd.DataFrame(u, DT * np.arange(len(u))), y)  # white, but in order
    found, std = model.predict(new[:, None], return_std=True)
    columns, rows = (np.column_stack([x, np.ones(len(x))]) for x in (u, new))
    coefficients, rest, *_ = np.linalg.lstsq(columns, y)
    variance = rest[0] / (len(u) - 2)
    spread = rows @ np.linalg.inv(columns.T @ columns) @ rows.T
    np.testing.assert_allclose(found, rows @ coefficients, rtol=1e-8)
    np.testing.assert_allclose(std, np.sqrt(variance * (1.0 + np.diag(spread))), rtol=1e-6)
    assert model.noise_std_ == pytest.approx(np.sqrt(variance))


def test_standard_deviation_with_constants_of_records():
    """A new record's constant is as far from the mean as those of the fit are from each other.

    Where a part of it is known, only its mean and the slope that the other records say are left.
    """
    constants, n, k = np.array([0.0, 4.0, -1.0]), 100, 25
    u, noisy = line_and_noise(3 * n)
    X = pd.DataFrame({"u": u}, pd.MultiIndex.from_product([range(3), DT * np.arange(n)]))
    X.index.names = ["record", "time"]
    model = Sum([("gain", Gain()), ("offset", Offset())])
    model.fit(X, noisy + np.repeat(constants, n))
    slope, noise = model.params_std_["gain__gain"], model.noise_std_
    new = pd.DataFrame({"u": u[:n]}, X.index[:n])
    told = np.where(np.arange(n) < k, 3.0 * u[:n] - 7.0, np.nan)
    own = u.reshape(3, n).mean(axis=1)
    spread = np.var(model.record_coefficients_, ddof=1) * (4.0 / 3.0)
    for known, center, constant in ((None, own.mean(), spread), (told, u[:k].mean(), noise**2 / k)):
        _, std = model.predict(new, known, return_std=True)
        expected = noise**2 + (slope * (u[:n] - center)) ** 2 + constant
        np.testing.assert_allclose(std, np.sqrt(expected), rtol=1e-6)


def test_standard_deviation_of_a_long_record(monkeypatch):
    """Where sensitivities need too much memory, differences say the same."""
    model = clone(MODELS["cascade"]).fit(X, Y)
    exact = run_variance(model.operator_, model.covariance_, U, DT)
    monkeypatch.setattr("skhyst.operators._records._LARGEST", 0)
    found = run_variance(model.operator_, model.covariance_, U, DT)
    np.testing.assert_allclose(found, exact, rtol=1e-5, atol=1e-5 * exact.max())
    assert exact.max() > 0.0


@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ShortRecordWarning")
def test_new_samples_lie_within_the_standard_deviation():
    """Also where errors of few samples dominate; the response is that of SciPy's filter.

    One new sample a fit, so that they are independent.
    """
    rng, within = np.random.default_rng(0), []
    for _ in range(60):
        u = rng.normal(size=60).cumsum()
        y = 2.0 * lfilter([1.0 - np.exp(-0.2)], [1.0, -np.exp(-0.2)], np.append(0.0, u[:-1]))
        y += rng.normal(0.0, 0.5, 60)
        model = FirstOrderLag(dt=DT, hold="zoh", initial_state="zero")
        model.fit_from(FirstOrderLagOperator(0.1, hold="zoh"), u[:30, None], y[:30])
        found, std = model.predict(u[:, None], return_std=True)
        within.append(np.abs(y - found)[-1] < 1.96 * std[-1])
    assert 0.9 <= np.mean(within) <= 0.99


def test_a_standard_deviation_that_is_not_known_is_refused():
    whole = clone(MODELS["cascade"]).fit(X, Y)
    told = TransferFunction.from_system(lti([2.0], [0.5, 1.0]), dt=DT)
    for model, why in (
        (whole.named_steps["lag"], "noise is not known"),
        (told, "without the covariance"),
    ):
        with pytest.raises(ValueError, match=f"'return_std' parameter of .* {why}"):
            model.predict(X, return_std=True)
    pipeline = make_pipeline(clone(MODELS["lag"])).fit(X, Y)
    assert pipeline.predict(X, return_std=True)[1].shape == (N,)
    held = Cascade([("plays", FrozenEstimator(whole[:1])), ("lag", FirstOrderLag())], dt=DT)
    assert held.fit(X, Y).predict(X, return_std=True)[1].min() > 0.0


def test_going_on_asks_for_one_record():
    data = pd.concat([frame(U, record="a"), frame(U, record="b")])
    model = FirstOrderLag().fit(data, np.tile(Y, 2))
    with pytest.raises(ValueError, match=r"stepper_from must be one record\. Got 2"):
        model.stepper_from(data, np.tile(Y, 2))


# -------------------------------------------------------------------------------------- results


def test_error_of_the_fit(model):
    model.fit(X, Y)
    assert model.fit_error_ == pytest.approx(np.sqrt(np.mean((model.predict(X) - Y) ** 2)))
    assert model.score(X, Y) > 0.9


@pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")
def test_a_model_knows_the_range_and_the_rate_of_its_drive(model):
    """Over all records, each at its own interval; what is not sampled in a row is no change."""
    first, second = frame(U[:40], record="a"), frame(U[40:80] - 5.0, record="b")
    second.index = pd.MultiIndex.from_product([["b"], 2.0 * TIME[:40]], names=["record", "time"])
    X = pd.concat([first, second])
    y = model.fit(X, X["drive"]).predict(X)
    changes = (np.abs(np.diff(U[:40])).max() / DT, np.abs(np.diff(U[40:80])).max() / (2.0 * DT))
    assert model.drive_range_ == (X["drive"].min(), X["drive"].max())
    np.testing.assert_allclose(model.drive_rate_, max(changes), rtol=1e-9)
    for again in (pickle.loads(pickle.dumps(model)), from_json(to_json(model))):
        assert (again.drive_range_, again.drive_rate_) == (model.drive_range_, model.drive_rate_)
    older = copy.copy(model)
    del older.drive_range_, older.drive_rate_
    np.testing.assert_array_equal(from_json(to_json(older)).predict(X), y)
    assert not hasattr(clone(model), "drive_range_")


@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ShortRecordWarning")  # turned round
def test_refit_forgets(model):
    first = clone(model).fit(X[::-1], 2.0 * Y[::-1])
    np.testing.assert_array_equal(first.fit(X, Y).predict(X), model.fit(X, Y).predict(X))


@pytest.mark.slow
def test_pickles_run_in_a_fresh_process(tmp_path):
    models = [clone(model).fit(X, Y) for model in MODELS.values()]
    (tmp_path / "models.pickle").write_bytes(pickle.dumps((models, X)))
    code = (
        "import pickle, numpy as np\n"
        "models, X = pickle.load(open('models.pickle', 'rb'))\n"
        "np.save('found.npy', [model.predict(X) for model in models])\n"
    )
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True, timeout=120)
    expected = [model.predict(X) for model in models]
    np.testing.assert_array_equal(np.load(tmp_path / "found.npy"), expected)


def test_diverging_run_is_cut_off():
    class Growing(SaturationOperator):
        def run(self, u, dt, state=None):
            return np.where(u > 0, np.inf, np.nan), ()

    u = np.array([1.0, -1.0, 2.0])
    with pytest.warns(DivergenceWarning, match="diverged"):
        y = run_records(Growing(), u, record_slices(u))
    assert np.isfinite(y).all()
    np.testing.assert_array_equal(y, [np.finfo(float).max, 0.0, np.finfo(float).max])


def test_undetermined_parameters_are_reported():
    with pytest.warns(ConvergenceWarning, match="PrandtlIshlinskii: weights\\[1\\]"):
        model = PrandtlIshlinskii(thresholds=[0.0, 50.0]).fit(X, Y)
    assert model.identifiability_["undetermined"] == ("weights[1]",)
    assert model.params_std_["weights[1]"] == np.inf
    assert np.isfinite(model.params_std_["weights[0]"])


def test_a_model_of_ones_own():
    """A subclass gives the starting values and nothing else."""

    class Mode(ParametricModel):
        operator_class = SecondOrderModeOperator

        def starting_values(self, records):
            return [SecondOrderModeOperator(30.0, 0.5)]

    y, _ = SecondOrderModeOperator(40.0, 0.2, gain=2.0).run(U, DT)
    assert Mode().stage_order == SecondOrderModeOperator.stage_order
    own, ready = Mode(dt=DT).fit(X, y), SecondOrderMode(dt=DT).fit(X, y)
    assert own.params_ == pytest.approx(ready.params_, rel=1e-4, abs=1e-6)


@pytest.mark.parametrize("model", [PrandtlIshlinskii(5), Preisach(5), MaxwellSlip(5)])
def test_a_response_that_falls_is_followed_as_one_that_rises(model):
    drive = np.sin(np.linspace(0.0, 20.0, 400)) * np.linspace(1.0, 0.2, 400)
    X = drive.reshape(-1, 1)
    y = drive - 0.5 * PrandtlIshlinskiiOperator([0.4], [1.0]).run(drive, 1.0)[0]
    rising, falling = clone(model).fit(X, y), clone(model).fit(X, -y)
    np.testing.assert_allclose(falling.predict(X), -rising.predict(X), atol=1e-9)
    clone(model).fit(X, np.full(400, 0.1))  # which has no direction


# ------------------------------------------------------------------------------------- weights


def test_weights_count_as_repetitions_do(model):
    """A record of weight two is one that was recorded twice."""
    X, y = stack_records([(drive(i)[:, None], PLANT.run(drive(i), DT)[0]) for i in (0, 1)], dt=DT)
    y = y + 0.002 * np.random.default_rng(5).normal(size=len(y))
    weighted = clone(model).fit(X, y, sample_weight=np.repeat([2.0, 1.0], N))
    again = X.iloc[:N], y.iloc[:N]
    again = [own.rename(index={0: "again"}, level="record") for own in again]
    repeated = clone(model).fit(pd.concat([again[0], X]), pd.concat([again[1], y]))
    for name in ("params_", "params_std_white_"):  # NaN at a bound
        expected = pytest.approx(getattr(repeated, name), rel=1e-5, abs=1e-9, nan_ok=True)
        assert getattr(weighted, name) == expected
    assert weighted.fit_error_ == pytest.approx(repeated.fit_error_)


@pytest.mark.parametrize("scale", [1.0, 3e-5, 36.0])
def test_inverse_variances_are_relative(scale):
    """Standard errors are those of the scatter under them, whatever their scale."""
    rng = np.random.default_rng(2)
    std = np.repeat([0.5, 3.0], 100)  # 36 times the inverse variances are whole numbers
    found = []
    for _ in range(40):
        u = rng.normal(size=200)
        y = u + std * rng.normal(size=200)
        found.append(Gain().fit(u[:, None], y, sample_weight=scale / std**2))
    scatter = np.std([fit.params_["gain"] for fit in found])
    told = np.mean([fit.params_std_["gain"] for fit in found])
    assert told == pytest.approx(scatter, rel=0.3)  # of 40 draws: 11 % standard error


def test_weights_of_other_rows_are_refused():
    """As a response of other rows is."""
    time = pd.Index(0.01 * np.arange(50), name="time")
    X = pd.DataFrame({"u": np.sin(np.arange(50.0))}, index=time)
    weights = pd.Series(np.arange(50.0), index=time)
    Gain().fit(X, X["u"], sample_weight=weights)
    with pytest.raises(RecordError, match="that of sample_weight must be equal"):
        Gain().fit(X, X["u"], sample_weight=weights[::-1])


def test_a_response_of_weight_zero_is_not_read(model):
    """The drive goes on below it, so that what follows is simulated as before."""
    weights = np.ones(N)
    weights[100:140] = 0.0
    spoilt = np.where(weights, Y, 5.0)
    found = [clone(model).fit(X, y, sample_weight=weights) for y in (Y, spoilt)]
    np.testing.assert_array_equal(found[1].predict(X), found[0].predict(X))
    clean, wrong = (clone(model).fit(X, y).predict(X) for y in (Y, spoilt))
    away = [np.abs(other - clean).max() for other in (found[1].predict(X), wrong)]
    assert away[0] < 0.1 * away[1]


@pytest.mark.parametrize(
    ("weights", "told"),
    [
        (np.ones(N - 1), "sample_weight.shape"),
        (np.ones((N, 2)), "must be 1D"),
        (-np.ones(N), "Negative values"),
        (np.full(N, np.nan), "NaN"),
        (np.zeros(N), "zero"),
    ],
)
def test_weights_that_are_none(weights, told):
    with pytest.raises(ValueError, match=told):
        FirstOrderLag(dt=DT).fit(X, Y, sample_weight=weights)


@pytest.mark.filterwarnings("ignore:The data do not determine")
def test_a_column_that_is_doubted_is_weighed():
    """Where the drive is another column, a warning says so; of rows without weight it says none."""
    weights = np.repeat([1.0, 0.0], [200, 100])
    spoilt = np.where(weights, Y, 5.0)
    two = np.column_stack([U, np.where(weights, 0.0, 5.0)])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        FirstOrderLag(dt=DT).fit(two, spoilt, sample_weight=weights)
    with pytest.warns(ConvergenceWarning, match="A straight line through column 1"):
        FirstOrderLag(dt=DT).fit(two, spoilt)


@pytest.mark.filterwarnings("ignore:The records do not begin at rest")  # those of folds
def test_weights_through_a_pipeline_and_a_search():
    """As scikit-learn routes them: to the fit of the model in each fold, by name or by request."""
    weights = np.ones(N)
    weights[100:140] = 0.0
    spoilt = np.where(weights, Y, 5.0)
    expected = FirstOrderLag(dt=DT).fit(X, spoilt, sample_weight=weights).params_
    named = make_pipeline(FirstOrderLag(dt=DT))
    named.fit(X, spoilt, firstorderlag__sample_weight=weights)
    assert named[-1].params_ == expected
    with sklearn.config_context(enable_metadata_routing=True):
        model = FirstOrderLag(dt=DT).set_fit_request(sample_weight=True)
        model = model.set_score_request(sample_weight=True)
        search = GridSearchCV(make_pipeline(model), {"firstorderlag__hold": ["foh", "zoh"]}, cv=2)
        search.fit(X, spoilt, sample_weight=weights)
    assert search.best_params_ == {"firstorderlag__hold": "foh"}
    assert search.best_estimator_[-1].params_ == expected


def test_a_prediction_beyond_the_range_of_the_fit_is_told():
    t = np.arange(400) * 0.01
    u = np.sin(2.0 * np.pi * t) * t[::-1]
    plays = PrandtlIshlinskii(5, dt=0.01).fit(u[:, None], u)
    low, high = plays.drive_range_
    with pytest.warns(ExtrapolationWarning, match=f"from {low:g} to {high:g}. Got"):
        plays.predict(1.5 * u[:, None])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plays.predict(1.1 * u[:, None])  # no more than another record may go
        plays.predict(0.1 * u[:, None])
        Gain(dt=0.01).fit(u[:, None], u).predict(9.0 * u[:, None])  # linear
