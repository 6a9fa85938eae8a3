"""Every composition: fitted from the operator that it has, taken apart and put together again."""

import re
import warnings

import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone
from sklearn.frozen import FrozenEstimator
from sklearn.model_selection import GridSearchCV
from sklearn.utils import estimator_html_repr

from skhyst.compose import (
    Cascade,
    Modulated,
    OnColumn,
    ScheduledParameters,
    Sum,
)
from skhyst.disturbance import Drift, Offset, PeriodicDisturbance
from skhyst.hysteresis import PrandtlIshlinskii, PrandtlIshlinskiiOperator
from skhyst.linear import (
    FirstOrderLag,
    FirstOrderLagOperator,
    Gain,
    KelvinVoigt,
    SecondOrderMode,
    SecondOrderModeOperator,
    TransferFunction,
    TransferFunctionOperator,
)
from skhyst.operators import (
    Series,
    Stage,
    series_stages,
    split_disturbances,
    stage_values,
    with_series_stages,
    with_stage_values,
)
from skhyst.optimize import RecordData, VariableProjection
from skhyst.records import stack_records

DT, N = 0.01, 300
PLAYS = PrandtlIshlinskiiOperator([0.0, 0.3], [1.0, 0.4])
PLANT = Series(("plays", "lag"), (PLAYS, FirstOrderLagOperator(0.04)))


@pytest.fixture(scope="module")
def data():
    records = []
    for k in range(3):
        rng = np.random.default_rng(k)
        u = np.cumsum(rng.normal(size=N)) / 6
        load = np.full(N, 10.0 * k)
        y = PLANT.run(u, DT)[0] * (1.0 + 0.01 * load) + 0.1 * k
        y += 0.05 * np.sin(2 * np.pi * 11.3 * DT * np.arange(N) + k) + 0.002 * rng.normal(size=N)
        records.append((pd.DataFrame({"drive": u, "load": load}), y))
    return stack_records(records, dt=DT)


def cascade():
    plays = PrandtlIshlinskii(thresholds=[0.0, 0.3])
    return Cascade([("plays", plays), ("lag", FirstOrderLag())])


def held_step(X):
    X = X.iloc[:N]  # the run is that of one record
    y = FirstOrderLagOperator(0.04).run(X["drive"], DT)[0]
    lag = FrozenEstimator(FirstOrderLag().fit(X, y))
    return Cascade([("plays", PrandtlIshlinskii(4)), ("lag", lag)])


BOTH, CHAIN = [("plays", PrandtlIshlinskii(3)), ("lag", FirstOrderLag())], ["plays", "lag"]
LINE, OFFSET, LOAD = PeriodicDisturbance(), ("offset", Offset()), ("load", OnColumn(Gain(), 1))
PLAYS_BY_LOAD = ScheduledParameters(PrandtlIshlinskii(3), by="load")
WEIGHTS_BY_LOAD = ScheduledParameters(cascade(), by="load", parameters=["plays__weights"])
MODELS = {  # and the names of the stages that follow the drive, where they can be exchanged
    "one model": (KelvinVoigt(1), ["kelvin_voigt"]),
    "cascade": (cascade(), CHAIN),
    "nested cascade": (
        Cascade([("inner", cascade()), ("mode", SecondOrderMode())]),
        ["inner", "mode"],
    ),
    "held step": (held_step, CHAIN),
    "offset alone": (Offset(), None),
    "sum": (Sum([("model", cascade()), ("line", LINE), ("drift", Drift(1))]), CHAIN),
    "sum of two": (Sum(BOTH), ["sum"]),
    "sum of two beside": (Sum([*BOTH, OFFSET]), ["model"]),
    "sum with a column": (Sum([("model", cascade()), LOAD]), CHAIN),
    "modulated": (Modulated(cascade(), 1), CHAIN),
    "modulated twice": (Modulated(Modulated(cascade(), 1), "amplitude"), CHAIN),
    "modulated beside": (Sum([("model", Modulated(cascade(), 1)), LOAD, OFFSET]), CHAIN),
    "widths": (
        Modulated(PrandtlIshlinskii(3), 1, scales="thresholds", degree=2),
        ["modulated"],
    ),
    "weights of a column": (
        Modulated(PrandtlIshlinskii(3), 1, scales=["weights"], magnitude=True),
        ["modulated"],
    ),
    "scheduled": (WEIGHTS_BY_LOAD, CHAIN),
    "scheduled beside": (Sum([("plays", PLAYS_BY_LOAD), OFFSET]), ["plays"]),
    # a schedule of the gain alone goes with the stage that has the gain, and is lost with it
    "scheduled and modulated": (
        Modulated(ScheduledParameters(Gain(), by="load"), "amplitude"),
        None,
    ),
}


@pytest.fixture(params=MODELS, scope="module")
def fitted(request, data):
    model, names = MODELS[request.param]
    model = held_step(data[0]) if model is held_step else clone(model)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "The data do not determine|No one set of parameters")
        return model.fit(*data), names


@pytest.mark.filterwarnings("ignore:(The data do not determine|No one set of parameters)")
def test_a_fit_from_the_solution_stays_there(fitted, data):
    X, y = data
    model, _ = fitted
    again = clone(model).fit_from(model.operator_, X, y)
    assert again.params_.keys() == model.params_.keys()
    assert again.fit_error_ <= 1.0001 * model.fit_error_
    assert again.n_evaluations_ <= 12
    np.testing.assert_allclose(again.predict(X), model.predict(X), atol=1e-3)
    np.testing.assert_array_equal(again.feature_names_in_, X.columns)
    assert again.n_features_in_ == 2
    assert again.records_ == model.records_
    assert vars(again).keys() == vars(model).keys()


def test_stages_go_out_and_in_again(fitted):
    model, names = fitted
    if names is None:
        return
    whole = Stage(None, model.tree(model.operator_))
    stages = series_stages(whole)
    assert [stage.name for stage in stages] == names
    lag = Stage("further", FirstOrderLag().tree(FirstOrderLagOperator(0.1)))
    more = with_series_stages(whole, [*stages, lag])
    operator, longer = (split_disturbances(tree.operator)[0] for tree in (whole, more))
    assert len(longer.entries()) == len(operator.entries()) + 3
    same = with_series_stages(more._replace(name=None), stages)
    values, before = stage_values(same), stage_values(whole)
    assert values.keys() == before.keys()
    for key, value in before.items():
        np.testing.assert_allclose(values[key], value, err_msg=str(key))
    moved = with_stage_values(whole, {key: 2.0 * value for key, value in before.items()})
    free = [not spec.held for _, spec in operator.entries()]
    np.testing.assert_allclose(moved.pack()[free], 2.0 * operator.pack()[free])
    assert [name for name, _ in moved.entries()] == [n for n, _ in operator.entries()]


def test_records_and_method_may_be_given(data):
    X, y = data
    weights, records = np.r_[np.zeros(50), np.ones(N - 50)], []
    for k, part in X["drive"].groupby(level="record"):
        records.append(RecordData(part.to_numpy(), y.loc[[k]].to_numpy(), DT, weights=weights))
    model = cascade().fit_from(PLANT, X, y, records=records, method="levenberg_marquardt")
    assert model.fit_error_ > 0.0
    assert model.records_[0].n_samples == N


@pytest.mark.filterwarnings("ignore:No one set of parameters")
def test_an_edited_tree_is_a_start(data):
    """A stage is put in, with a gain that another carries."""
    alone = cascade().fit(*data)
    names, stages = ("plays", "lag"), alone.operator_.stages
    first = FirstOrderLagOperator(0.01, gain=2.0)
    chain = Series((*names, "sensor"), (*stages, first))
    model = Cascade([*cascade().steps, ("sensor", FirstOrderLag())])
    model.fit_from(chain, *data)
    assert model.operators_["sensor"].gain == 1.0
    assert model.fit_error_ <= alone.fit_error_


@pytest.mark.parametrize(
    "model",
    [
        lambda by: Sum([("plays", ScheduledParameters(Gain(), by=by)), ("offset", Offset())]),
        lambda by: Modulated(ScheduledParameters(Gain(), by=by), "amplitude"),
    ],
)
def test_a_named_column_is_known_within_a_composition(model, data):
    X, y = data
    named, numbered = model("load").fit(X, y), model(1).fit(X, y)
    np.testing.assert_allclose(named.predict(X), numbered.predict(X), atol=1e-9)
    with pytest.raises(ValueError, match="a column of X: drive, load"):
        model("lead").fit(X, y)


def test_a_cascade_takes_the_gain_out_of_an_operator_and_nothing_else(data):
    """One evaluation, so that what is not linear stays where it starts."""
    stage = TransferFunctionOperator([], [30.0], [0.2], [0.5, -2.0], gain=4.0)
    plays = PrandtlIshlinskiiOperator([0.0, 0.2, 0.4, 0.6], [1.0, 0.4, 0.3, 0.2])
    plant = Series(("plays", "stage"), (plays, stage))
    u = data[0]["drive"].to_numpy()[:N]
    hysteresis = PrandtlIshlinskii(thresholds=plays.thresholds)
    model = Cascade([("plays", hysteresis), ("stage", TransferFunction(2))], dt=DT)
    method = VariableProjection(max_evaluations=1)
    model.fit_from(plant, u.reshape(-1, 1), plant.run(u, DT)[0], method=method)
    assert model.operators_["stage"].gain == 1.0
    assert model.fit_error_ < 1e-9


@pytest.mark.parametrize("without", [None, "first", "second"])
def test_gain_and_intercept_of_linear_stages_move_and_do_not_vanish(without, data):
    first = SecondOrderModeOperator(30.0, 0.3, 2.0, 0.4)
    second = FirstOrderLagOperator(0.05, 3.0, -0.5)
    whole = Series(("first", "second"), (first, second))
    u = data[0]["drive"].to_numpy()[:N]
    if without is None:
        found = whole.normalized()
        assert (found.stages[0].gain, found.stages[0].intercept) == (1.0, 0.0)
        np.testing.assert_allclose(found.run(u, DT)[0], whole.run(u, DT)[0], atol=1e-12)
        return
    (stage,) = whole.without(without).stages
    at_rest = np.full(5, 1.7)
    np.testing.assert_allclose(stage.run(at_rest, DT)[0], whole.run(at_rest, DT)[0])


def test_the_diagram_shows_what_stands_behind_and_what_beside():
    additive = Sum([("plays", PrandtlIshlinskii()), ("drift", Drift())])
    drawn = estimator_html_repr(Cascade([("stage", additive), ("lag", FirstOrderLag())]))
    serial, parallel = (re.search(rf'class="sk-{kind}"', drawn) for kind in ("serial", "parallel"))
    assert serial.start() < parallel.start()
    places = [drawn.index(f"<div>{name}</div>") for name in ("PrandtlIshlinskii", "Drift")]
    assert parallel.start() < min(places) < max(places) < drawn.index("<div>FirstOrderLag</div>")


# ------------------------------------------------------------------- steps, as those of a Pipeline

STEP_DT, N_STEPS = 0.01, 600
STEP_U = np.cumsum(np.random.default_rng(0).normal(size=(N_STEPS, 1)), axis=0)
STEP_Y = FirstOrderLagOperator(0.05).run(2.0 * STEP_U[:, 0] + 1.0, STEP_DT)[0]
TWO_STEPS = [("gain", Gain()), ("lag", FirstOrderLag())]
IN_PARALLEL = [("lag", FirstOrderLag()), ("drift", Drift(1))]


@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_step_that_is_left_out_has_no_part_in_further_starts(place):
    """These are tried where the residual is coloured, as of a curve that no step has."""
    u = np.cumsum(np.random.default_rng(5).normal(size=300)) / 5.0
    y = FirstOrderLagOperator(0.05).run(u, STEP_DT)[0] + 0.1 * u**3
    steps = [("plays", PrandtlIshlinskii(3)), ("lag", FirstOrderLag())]
    expected = Cascade(steps, dt=STEP_DT).fit(u[:, None], y).predict(u[:, None])
    steps.insert(place, ("none", "passthrough"))
    found = Cascade(steps, dt=STEP_DT).fit(u[:, None], y).predict(u[:, None])
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.ptp(y))


@pytest.mark.filterwarnings("ignore:The records do not begin at rest")  # those of folds
@pytest.mark.parametrize("word", ["passthrough", "drop"])
def test_a_step_of_a_cascade_is_left_out(word):
    """In a search too: with the lag the fit is exact, without it it is not."""
    model = Cascade(TWO_STEPS, dt=STEP_DT)
    grid = {"lag": [word, FirstOrderLag()]}
    search = GridSearchCV(model, grid, cv=2).fit(STEP_U, STEP_Y)
    assert list(search.best_estimator_.operators_) == ["gain", "lag"]
    without = clone(model).set_params(lag=word).fit(STEP_U, STEP_Y)
    alone = Gain(dt=STEP_DT).fit(STEP_U, STEP_Y)
    assert list(without.operators_) == ["gain"]
    assert without.named_steps["lag"] == word
    np.testing.assert_allclose(without.predict(STEP_U), alone.predict(STEP_U), rtol=1e-9)
    assert "gain" in without._repr_html_()


def test_a_branch_of_a_sum_is_left_out_or_the_drive_itself():
    y = STEP_Y + np.linspace(0.0, 3.0, N_STEPS)
    model = Sum(IN_PARALLEL, dt=STEP_DT)
    without = clone(model).set_params(drift="drop").fit(STEP_U, STEP_Y)
    assert list(without.operators_) == ["lag"]
    assert without.disturbance_names == ()
    np.testing.assert_allclose(without.predict(STEP_U), STEP_Y, atol=1e-6)
    through = Sum([*IN_PARALLEL, ("drive", "passthrough")], dt=STEP_DT)
    through.fit(STEP_U, y + STEP_U[:, 0])
    assert "drive" not in "".join(through.params_)  # it has unit gain
    np.testing.assert_allclose(through.predict(STEP_U), y + STEP_U[:, 0], atol=1e-6)
    assert through.operators_["lag"].time_constant == pytest.approx(0.05)


@pytest.mark.parametrize("kind", [Cascade, Sum])
def test_nothing_is_left(kind):
    with pytest.raises(ValueError, match="must have a model"):
        kind([("one", "drop"), ("two", "drop")]).fit(STEP_U, STEP_Y)
    with pytest.raises(TypeError, match="Got 'pass' as 'two' instead; 'drop' leaves"):
        kind([("one", Gain()), ("two", "pass")]).fit(STEP_U, STEP_Y)


def test_steps_by_number_name_and_slice():
    model = Cascade(TWO_STEPS, dt=STEP_DT)
    assert len(model) == 2
    assert model[1] is model["lag"] is TWO_STEPS[1][1]
    assert repr(model[:1]) == repr(Cascade(TWO_STEPS[:1], dt=STEP_DT))
    model.fit(STEP_U, STEP_Y)
    assert model[-1].params_["time_constant"] == pytest.approx(0.05)
    assert model["lag"].params_["gain"] == pytest.approx(2.0)
    first, last = model[:1], model[1:]
    assert isinstance(first, Cascade)
    np.testing.assert_allclose(first.predict(STEP_U), STEP_U[:, 0])  # the gain is in the lag
    behind = last.predict(first.predict(STEP_U)[:, None])
    np.testing.assert_allclose(behind, model.predict(STEP_U), atol=1e-9)
    assert last.params_ == model.params_
    assert last.params_std_ == model.params_std_
    assert first.params_ == {}
    np.testing.assert_array_equal(model[:].predict(STEP_U), model.predict(STEP_U))
    with pytest.raises(ValueError, match="must be 1"):
        model[::2]
    with pytest.raises(IndexError):
        model[2]
    with pytest.raises(KeyError):
        model["mode"]


def test_a_slice_of_a_sum_keeps_what_stands_beside():
    y = STEP_Y + 2.0 + np.sin(2.0 * np.pi * 7.0 * STEP_DT * np.arange(N_STEPS))
    steps = [("offset", Offset()), ("lag", FirstOrderLag()), ("line", PeriodicDisturbance())]
    model = Sum(steps, dt=STEP_DT).fit(STEP_U, y)
    part = model[1:]
    assert list(part.operators_) == ["lag", "line"]
    line = "disturbance{}__frequencies[0]".format  # numbered among those that are there
    assert part.params_[line(0)] == model.params_[line(1)] == pytest.approx(7.0)
    assert part.params_["lag__gain"] == model.params_["lag__gain"]
    n_offset = np.size(model.operators_["offset"].coefficients)
    kept = model.record_coefficients_[:, n_offset:]
    np.testing.assert_array_equal(part.record_coefficients_, kept)
    sizes = model[:2].record_coefficients_.shape, kept.shape
    assert sizes == ((1, n_offset), (1, model.record_coefficients_.shape[1] - n_offset))
    whole = model.predict(STEP_U)
    np.testing.assert_allclose(
        model[1:].predict(STEP_U) + model[:2].predict(STEP_U) - model[1:2].predict(STEP_U), whole
    )
    with pytest.raises(ValueError, match="a step that is driven"):
        model[:1]
