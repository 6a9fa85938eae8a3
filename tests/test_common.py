"""What every estimator must do: scikit-learn's checks, and those of a package with memory."""

import inspect
import pickle
from contextlib import suppress
from functools import partial
from unittest import SkipTest

import numpy as np
import pandas as pd
import pytest
from sklearn.base import BaseEstimator, clone
from sklearn.compose import ColumnTransformer
from sklearn.model_selection import GridSearchCV, LeaveOneGroupOut, cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils.estimator_checks import (
    check_param_validation,
    estimator_checks_generator,
    parametrize_with_checks,
)
from sklearn.utils.validation import has_fit_parameter
from small_estimators import NO_GAIN, SLOW, small_estimators

from skhyst.base import ParametricModel
from skhyst.compose import Cascade, Feedback, Sum
from skhyst.diagnosis import EffectSearchCV
from skhyst.discovery import all_estimators
from skhyst.disturbance import Drift
from skhyst.exceptions import RecordError
from skhyst.fluid import TankChain
from skhyst.hysteresis import (
    BoucWenStage,
    CoulombFriction,
    Duhem,
    EndStops,
    FreeMass,
    FrictionStage,
    KrasnoselskiiPokrovskii,
    LuGre,
    MaxwellSlip,
    ModifiedPrandtlIshlinskii,
    PrandtlIshlinskii,
    PrandtlIshlinskiiOperator,
    Preisach,
    RateDependentPrandtlIshlinskii,
    RestoringForce,
)
from skhyst.linear import (
    Delay,
    DynamicStiffness,
    FirstOrderLag,
    FirstOrderLagOperator,
    KelvinVoigt,
    TransferFunction,
)
from skhyst.neural import GrayBoxHysteresis
from skhyst.optimize import LevenbergMarquardt, VariableProjection
from skhyst.persistence import from_json, load_model, save_model, to_json
from skhyst.static import DeadZones, Saturation, SmoothCurve, SoftSaturation

DT = 0.01
N = 240
# data from elsewhere do not determine all parameters of a model, and ask for other drives
pytestmark = [
    pytest.mark.filterwarnings("ignore::skhyst.exceptions.ConvergenceWarning"),
    pytest.mark.filterwarnings("ignore::skhyst.exceptions.ReachWarning"),
]

# nothing is remembered from one sample to the next
MEMORYLESS = {
    "DeadBand",
    "DeadZones",
    "Fold",
    "Gain",
    "Saturation",
    "SCNRegressor",
    "SmoothCurve",
    "SoftSaturation",
    "UnknownTerm",
    "Offset",
    "InverseCompensator",  # of a regressor
    "Observer",  # nothing is predicted from X alone
    "Monitor",
}

MEMORY = {
    "check_methods_sample_order_invariance": "the output depends on the past",
    "check_methods_subset_invariance": "the output depends on the past",
}


# rows that are repeated are further samples in time; a weight repeats the sample alone
WEIGHTS = {"check_sample_weight_equivalence_on_dense_data": "the output depends on the past"}
# a search that ends at a tolerance, from quantiles that repeated rows move: equal to 1e-5 of it
NONLINEAR = {
    *("DeadBand", "DeadZones", "Saturation", "SmoothCurve", "SoftSaturation"),
    "UnknownTerm",  # whose smoothness follows from the number of samples
}

# its response is the drive itself, which a search refuses
NO_EXPERIMENT = {"check_regressors_no_decision_function": "the response is a column of X"}


def expected_failed_checks(estimator):
    """Exactly the checks that contradict memory; strict, as pytest is configured."""
    if isinstance(estimator, EffectSearchCV):
        return MEMORY | NO_EXPERIMENT
    name = type(estimator).__name__
    if name in {*MEMORYLESS, "Delay"}:
        return WEIGHTS if name in {*NONLINEAR, "Delay"} else {}
    return MEMORY | (WEIGHTS if has_fit_parameter(estimator, "sample_weight") else {})


# models share the code that these checks are about: the default run has some of each kind
OF_THEIR_KIND = {
    *("BoucWen", "Cascade", "Delay", "FirstOrderLag", "Offset", "PrandtlIshlinskii", "Saturation"),
}
QUICK = {
    name
    for name, cls in all_estimators()
    if name not in SLOW and (name in OF_THEIR_KIND or not issubclass(cls, ParametricModel))
}


@parametrize_with_checks(
    [estimator for name, estimator in small_estimators().items() if name in QUICK],
    expected_failed_checks=expected_failed_checks,
)
def test_scikit_learn(estimator, check):
    if isinstance(estimator, Delay) and check.func.__name__ in MEMORY:
        pytest.skip("their data have no delay: the fitted one is next to zero")
    check(estimator)


def briefly(estimator, max_evaluations=3):
    """Return an estimator whose fit ends early: for what does not depend on where it ends."""
    method = getattr(estimator, "method", None)
    if method == "variable_projection" or isinstance(method, VariableProjection):
        estimator.set_params(method=VariableProjection(max_evaluations=max_evaluations))
    return estimator


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ExtrapolationWarning")
@pytest.mark.parametrize("name", [name for name in small_estimators() if name not in QUICK])
def test_scikit_learn_of_all_others(name):
    """All checks but those that contradict memory: some of each kind show that they fail."""
    # a weight is as good as repeated rows only at the optimum
    known = briefly(small_estimators()[name], 4 if name in MEMORYLESS else 1)
    contradicted = expected_failed_checks(known)
    for estimator, check in estimator_checks_generator(known):
        if check.func.__name__ not in contradicted:
            with suppress(SkipTest):
                check(estimator)


@pytest.mark.parametrize(("name", "estimator"), small_estimators().items())
def test_wrong_parameters(name, estimator):
    """Every parameter is refused where its type or value is wrong, by name."""
    check_param_validation(name, estimator)


def test_discovery():
    found = all_estimators()
    names = [name for name, _ in found]
    assert names == sorted(set(names))
    assert MEMORYLESS | {"Cascade", "PlayOperators", "TransferFunction"} < set(names)
    for name, cls in found:
        assert issubclass(cls, BaseEstimator)
        assert cls.__name__ == name
        assert not inspect.isabstract(cls)
        assert cls.__module__.startswith("skhyst.")
    assert "ParametricModel" not in names


# --------------------------------------------------------------------------- the models and data

# the amplitude of a record is not known before its end, or X has more columns: tests/compose
ELSEWHERE = {"ScheduledParameters", "Modulated", "OnColumn"}
MODELS = {
    name: partial(cls, dt=DT)
    for name, cls in all_estimators()
    if issubclass(cls, ParametricModel) and name not in ELSEWHERE
}
MODELS |= {
    "PrandtlIshlinskii": lambda: PrandtlIshlinskii(6, dt=DT),
    "PrandtlIshlinskii, quantiles": lambda: PrandtlIshlinskii(4, thresholds="quantile", dt=DT),
    "PrandtlIshlinskii, stops": lambda: PrandtlIshlinskii(6, form="stop", dt=DT),
    "ModifiedPrandtlIshlinskii": lambda: ModifiedPrandtlIshlinskii(4, n_dead_zones=1, dt=DT),
    "RateDependentPrandtlIshlinskii": lambda: RateDependentPrandtlIshlinskii(4, dt=DT),
    "RateDependentPrandtlIshlinskii, slope": lambda: RateDependentPrandtlIshlinskii(
        4, variant="slope", dt=DT
    ),
    "RateDependentPrandtlIshlinskii, proportional": lambda: RateDependentPrandtlIshlinskii(
        4, variant="proportional", smoothing="speed", dt=DT
    ),
    "Preisach": lambda: Preisach(6, dt=DT),
    "KrasnoselskiiPokrovskii": lambda: KrasnoselskiiPokrovskii(6, dt=DT),
    "CoulombFriction": lambda: CoulombFriction(True, asymmetry=True, dt=DT),
    "LuGre": lambda: LuGre(fit_stiffness=True, dt=DT),
    "MaxwellSlip": lambda: MaxwellSlip(5, dt=DT),
    "Duhem, degree 3": lambda: Duhem(3, dt=DT),
    "GrayBoxHysteresis": lambda: GrayBoxHysteresis(dt=DT, method=LevenbergMarquardt(max_epochs=60)),
    "BoucWenStage": lambda: BoucWenStage(n_substeps=2, dt=DT),
    "EndStops": lambda: EndStops("upper", fit_stop_damping=False, n_substeps=2, dt=DT),
    "FreeMass": lambda: FreeMass(dt=DT),
    "FrictionStage": lambda: FrictionStage(False, fit_bristle_damping=False, n_substeps=2, dt=DT),
    "RestoringForce": lambda: RestoringForce(
        1, damping_degree=1, fit_preload=False, n_substeps=2, dt=DT
    ),
    "RestoringForce, no hysteresis": lambda: RestoringForce(
        3, damping_degree=1, fit_hysteresis=False, fit_preload=False, n_substeps=2, dt=DT
    ),
    "DynamicStiffness, velocity": lambda: DynamicStiffness(drive="velocity", smoothing=3, dt=DT),
    "KelvinVoigt": lambda: KelvinVoigt(1, dt=DT),
    "TransferFunction": lambda: TransferFunction(2, n_zeros=1, dt=DT),
    "TransferFunction, integrator": lambda: TransferFunction(1, integrators=1, dt=DT),
    "TransferFunction, delay": lambda: TransferFunction(1, delay=2 * DT, dt=DT),
    "TankChain, overflow": lambda: TankChain(1, overflow=True, fit_exponents=True, dt=DT),
    "DeadZones": lambda: DeadZones(1, dt=DT),
    "Saturation": lambda: Saturation(sides="upper", dt=DT),
    "SmoothCurve": lambda: SmoothCurve(3, dt=DT),
    "SoftSaturation": lambda: SoftSaturation(sides="upper", dt=DT),
    "Drift": lambda: Drift(2, dt=DT),
    "Feedback": lambda: Feedback(
        FirstOrderLag(), SmoothCurve(3), n_substeps=2, dt=DT, method=VariableProjection()
    ),
    "Cascade": lambda: Cascade(
        [("hysteresis", PrandtlIshlinskii(4)), ("lag", FirstOrderLag())], dt=DT
    ),
    "Sum": lambda: Sum([("hysteresis", PrandtlIshlinskii(4)), ("drift", Drift(1))], dt=DT),
}
PLAYS = {
    "PrandtlIshlinskii",
    "PrandtlIshlinskii, quantiles",
    "PrandtlIshlinskii, stops",
    "ModifiedPrandtlIshlinskii",
    "RateDependentPrandtlIshlinskii",
    "RateDependentPrandtlIshlinskii, slope",
    "RateDependentPrandtlIshlinskii, proportional",
    "Preisach",
    "KrasnoselskiiPokrovskii",
    "MaxwellSlip",
}
# weights or a mass that are not negative; one side that is clipped, or where a stop or a fold is
ONE_SIGN = PLAYS | {
    "EndStops",
    "FreeMass",
    "Fold",
    "JilesAtherton",
    "Cascade",
    "Sum",
    "Saturation",
    "SoftSaturation",
}


def drive(seed, n=N):
    rng = np.random.default_rng(seed)
    time = DT * np.arange(n)
    frequencies = np.geomspace(0.4, 15.0, 7)
    waves = np.sin(2 * np.pi * np.outer(time, frequencies) + rng.uniform(0, 6.28, 7))
    return waves @ (1.0 / np.arange(1, 8))


def plant(u, seed):
    plays = PrandtlIshlinskiiOperator([0.0, 0.2, 0.5], [0.6, 0.3, 0.3])
    y, _ = FirstOrderLagOperator(0.02).run(plays.run(u, DT)[0], DT)
    y = np.minimum(y, 0.8) + 0.1 * np.sin(2 * np.pi * 7.0 * DT * np.arange(len(u)))
    return y + 0.01 * np.random.default_rng(100 + seed).normal(size=len(u))


def make_records(labels=("a", "b", "c"), *, n=N):
    frames = [pd.DataFrame({"drive": drive(i, n)}) for i in range(len(labels))]
    responses = [plant(frame["drive"].to_numpy(), i) for i, frame in enumerate(frames)]
    index = pd.MultiIndex.from_tuples(
        [(label, k * DT) for label in labels for k in range(n)], names=["record", "time"]
    )
    X = pd.concat(frames, ignore_index=True).set_index(index)
    return X, pd.Series(np.concatenate(responses), index, name="response")


@pytest.fixture(scope="module")
def data():
    return make_records()


@pytest.fixture(
    params=[
        pytest.param(name, marks=pytest.mark.slow) if name.split(",")[0] in SLOW else name
        for name in MODELS
    ],
    scope="module",
)
def name(request):
    return request.param


@pytest.fixture(scope="module")
def model(name):
    return MODELS[name]()


@pytest.fixture(scope="module")
def fitted(model, data):
    return clone(model).fit(*data)


# --------------------------------------------------------------------------------------- memory


@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ExtrapolationWarning")
def test_future_does_not_change_the_past(fitted, data):
    X, _ = data
    if not fitted.operator_.causal:
        pytest.skip("it looks ahead")
    whole = fitted.predict(X)
    for stop in (1, 2, 100, N - 1):
        changed = X.iloc[:N].copy()
        changed.iloc[stop:] += 1.0
        np.testing.assert_array_equal(fitted.predict(changed)[:stop], whole[:stop])


def test_state_carried_from_chunk_to_chunk(fitted, data):
    if not fitted.operator_.causal:
        pytest.skip("it looks ahead")
    u = data[0]["drive"].to_numpy()[:N]
    whole = fitted.predict(data[0])[:N]
    operator, parts = fitted.operator_, []
    state = operator.init(u[0])
    for part in np.split(u, [1, 7, 150, 151]):
        y, state = operator.run(part, DT, state)
        parts.append(y)
    np.testing.assert_allclose(np.concatenate(parts), whole, rtol=1e-9, atol=1e-11)
    state, y = operator.init(u[0]), np.empty(40)
    for k in range(40):
        state, y[k] = operator.step(state, u[k], DT)
    np.testing.assert_allclose(y, whole[:40], rtol=1e-9, atol=1e-11)


def assert_steps(stepper, u, whole):
    """A stepper that rests at ``u[0]`` gives ``whole``, also from where it was before."""
    cut, allowed = len(u) // 3, 1e-12 * (np.ptp(whole) or 1.0)
    other, first = stepper.copy(), stepper.state
    steps = [stepper.step(row) for row in u[:cut]]
    kept = stepper.state
    rest = stepper.run(u[cut:])
    np.testing.assert_allclose([*steps, *rest], whole, rtol=0, atol=allowed)
    stepper.state = kept
    for wrong in (np.nan, np.inf):
        with pytest.raises(ValueError, match="must be finite"):
            stepper.step(u[0] * wrong)
        with pytest.raises(ValueError, match="must be finite"):
            stepper.run(np.append(u[:3], u[:1] + wrong, axis=0))
    np.testing.assert_array_equal(stepper.state, kept)
    np.testing.assert_array_equal(stepper.run(u[cut:]), rest)
    np.testing.assert_array_equal(other.state, first)  # whatever the one it was copied from did
    np.testing.assert_allclose(other.run(u), whole, rtol=0, atol=allowed)


def test_step_by_step(fitted, data):
    u = data[0]["drive"].to_numpy()[:N]
    if not fitted.operator_.causal:
        with pytest.raises(NotImplementedError, match="looks ahead"):
            fitted.stepper()
        return
    assert_steps(fitted.stepper(u0=u[0]), u, fitted.predict(data[0])[:N])


def test_going_on_from_what_is_known(fitted, data):
    """A stepper after the known part of a record gives what a run from that part predicts."""
    X, y = (part.loc["a"] for part in data)
    known = y.where(np.arange(N) < 20)
    whole = fitted.predict(X, y_start=known)
    if not fitted.operator_.causal:
        with pytest.raises(NotImplementedError, match="looks ahead"):
            fitted.stepper_from(X[:20], y[:20])
        return
    later = fitted.stepper_from(X[:20], y[:20]).run(X["drive"].to_numpy()[20:])
    np.testing.assert_allclose(later, whole[20:], rtol=0, atol=1e-9 * (np.ptp(whole) or 1.0))


def test_standard_deviation_of_a_new_sample(fitted, data):
    """That of the noise, and what the errors of the parameters add, whatever the records beside."""
    X, _ = data
    found, std = fitted.predict(X, return_std=True)
    np.testing.assert_array_equal(found, fitted.predict(X))
    assert std.shape == found.shape
    assert np.all((0.0 < fitted.noise_std_ <= std) & np.isfinite(std))
    alone = [fitted.predict(X.loc[[label]], return_std=True)[1] for label in "abc"]
    np.testing.assert_array_equal(std, np.concatenate(alone))


ORDER = ["c", "a", "b"]


def in_order(signal):
    return pd.concat([signal.loc[[label]] for label in ORDER])


def test_records_do_not_know_each_other(fitted, data):
    X, _ = data
    alone = {label: fitted.predict(X.loc[[label]]) for label in "abc"}
    np.testing.assert_array_equal(fitted.predict(X), np.concatenate([*alone.values()]))
    swapped = np.concatenate([alone[label] for label in ORDER])
    np.testing.assert_array_equal(fitted.predict(in_order(X)), swapped)


# ---------------------------------------------------------------------------------------- units


def test_neither_units_nor_an_offset_nor_the_order_of_records_matter(name, model, fitted, data):
    """All at once, turned around where it may be: what changes with one of them changes."""
    response, drive, time, offset = -250.0, 1e-6, 1000.0, 50.0
    if name in ONE_SIGN:
        response = abs(response)
    if name in NO_GAIN:
        drive = response
    if name not in {"Offset", "Drift", "Sum"} and "intercept" not in " ".join(fitted.params_):
        offset = 0.0
    X, y = data
    index = X.index.set_levels(X.index.levels[1] * time, level="time")
    delay = {"delay": time * model.delay} if hasattr(model, "delay") else {}
    X_other = (drive * X).set_axis(index)
    y_other = (response * (y + offset)).set_axis(index)
    other = clone(model).set_params(**delay).fit(in_order(X_other), in_order(y_other))
    np.testing.assert_allclose(
        other.predict(X_other) / response, fitted.predict(X) + offset, rtol=0.0, atol=2e-4
    )


def test_index_and_dt_say_the_same(model, data):
    X, y = data[0].loc["a"], data[1].loc["a"]
    with_index = briefly(clone(model), 1).fit(X, y)
    array = briefly(clone(model), 1).set_params(dt=DT).fit(X.to_numpy(), y.to_numpy())
    np.testing.assert_array_equal(array.predict(X.to_numpy()), with_index.predict(X))


# ----------------------------------------------------------------------------- scikit-learn tools


def test_results(fitted, data):
    X, y = data
    assert set(fitted.params_) == set(fitted.params_std_)
    assert fitted.n_evaluations_ >= 1
    assert set(fitted.identifiability_) == {"undetermined", "condition_number"}
    assert [record.label for record in fitted.records_] == ["a", "b", "c"]
    assert fitted.fit_error_ <= 1.01 * np.sqrt(np.mean((fitted.predict(X) - y) ** 2))
    np.testing.assert_array_equal(fitted.feature_names_in_, ["drive"])
    again = pickle.loads(pickle.dumps(fitted))
    np.testing.assert_array_equal(again.predict(X), fitted.predict(X))


def test_model_files_are_safe(fitted, data, tmp_path):
    pytest.importorskip("skops.io")
    save_model(fitted, tmp_path / "model.skops")
    again = load_model(tmp_path / "model.skops")
    np.testing.assert_array_equal(again.predict(data[0]), fitted.predict(data[0]))


NOT_AS_JSON = {"Corrected", "EffectSearchCV", "InverseCompensator", "Monitor", "NARXRegressor"}
NO_PREDICTION = {"Observer": "filter", "Monitor": "alarms"}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name
        for name, _ in all_estimators()
        if name not in MODELS
    ],
)
def test_every_other_estimator_travels(name, tmp_path):
    """What is no model of the tests below goes through skops and, if it can, JSON."""
    X, y = make_records(("a", "b"), n=120)
    estimator = small_estimators()[name].fit(X, y)
    names = NO_PREDICTION.get(name), "predict", "transform"
    call = next(n for n in names if n is not None and hasattr(estimator, n))
    seen = (X, y) if name in NO_PREDICTION else (X,)
    save_model(estimator, tmp_path / "it.skops")
    again = [load_model(tmp_path / "it.skops")]
    if name in NOT_AS_JSON:
        with pytest.raises(TypeError, match=r"written as JSON: save the model as \.skops"):
            to_json(estimator)
    else:
        again.append(from_json(to_json(estimator)))
    for other in again:
        found, expected = (np.asarray(getattr(e, call)(*seen)) for e in (other, estimator))
        np.testing.assert_array_equal(found, expected)


def test_a_model_is_the_same_as_json(fitted, data):
    again = from_json(to_json(fitted))
    np.testing.assert_array_equal(again.predict(data[0]), fitted.predict(data[0]))


def test_clone_and_parameters(model):
    params = model.get_params(deep=False)
    again = clone(model)
    assert again is not model
    assert again.get_params(deep=False).keys() == params.keys()
    for key in set(params) - {"steps", "linear", "curve"}:
        assert again.get_params(deep=False)[key] == params[key]
    again.set_params(initial_state="zero", dt=0.5)
    assert (again.initial_state, again.dt) == ("zero", 0.5)
    assert (model.initial_state, model.dt) == (params["initial_state"], params["dt"])
    signature = inspect.signature(type(model).__init__).parameters
    further = list(signature.values())[2:]
    # a model in another one's place is said without its name too
    kinds = [p.kind for p in further if p.default is not inspect.Parameter.empty]
    assert all(kind is inspect.Parameter.KEYWORD_ONLY for kind in kinds)


@pytest.mark.parametrize("name", ["PrandtlIshlinskii", "FirstOrderLag", "Cascade"])
def test_folds_of_scikit_learn_keep_the_records(name, data):
    X, y = data
    groups = X.index.get_level_values("record")
    cv = LeaveOneGroupOut()
    scores = cross_val_score(MODELS[name](), X, y, groups=groups, cv=cv, error_score="raise")
    by_hand = []
    for label in "abc":
        train = groups != label
        model = MODELS[name]().fit(X[train], y[train])
        by_hand.append(model.score(X[~train], y[~train]))
    np.testing.assert_allclose(scores, by_hand)
    assert min(scores) > 0.8


def test_hole_cut_by_a_splitter_starts_a_new_record(data):
    X, y = data
    keep = np.r_[0:100, 180:N]
    model = FirstOrderLag().fit(X.iloc[keep], y.iloc[keep])
    assert [record.n_samples for record in model.records_] == [100, N - 180]
    array = model.predict(X.iloc[keep])
    np.testing.assert_array_equal(array[100:], model.predict(X.iloc[180:N]))


@pytest.mark.slow
def test_grid_search(data):
    X, y = data
    search = GridSearchCV(
        Cascade([("hysteresis", PrandtlIshlinskii()), ("lag", FirstOrderLag())]),
        {"hysteresis__n_operators": [1, 6], "lag": [FirstOrderLag(), Delay()]},
        cv=3,
        error_score="raise",
    ).fit(X, y)
    assert isinstance(search.best_estimator_.named_steps["lag"], FirstOrderLag)
    assert search.best_params_["hysteresis__n_operators"] == 6
    assert search.best_score_ > 0.9
    assert len(search.best_estimator_.operators_["hysteresis"].weights) == 6


@pytest.mark.parametrize(
    "scaler",
    [
        StandardScaler(),
        ColumnTransformer([("scale", StandardScaler(), ["drive"])], remainder="passthrough"),
    ],
    ids=["all columns", "one column"],
)
def test_scaler_that_loses_the_index_is_refused(scaler, data):
    X, y = data
    given = X if isinstance(scaler, StandardScaler) else X.assign(temperature=20.0)
    pipeline = make_pipeline(scaler, FirstOrderLag())
    with pytest.raises(RecordError, match=r'set_output\(transform="pandas"\)'):
        pipeline.fit(given, y)
    pipeline.set_output(transform="pandas").fit(given, y)
    plain = FirstOrderLag().fit(X, y)
    np.testing.assert_allclose(pipeline.predict(given), plain.predict(X), atol=1e-4)
    scores = cross_val_score(pipeline, given, y, cv=3, error_score="raise")
    assert np.isfinite(scores).all()


def test_metadata_routing_asks_for_nothing(model):
    request = model.get_metadata_routing()
    for method in ("fit", "predict", "score"):
        asked = getattr(request, method).requests
        assert {key for key, value in asked.items() if value} == set()
