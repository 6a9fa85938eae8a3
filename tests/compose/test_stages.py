"""The series inside a composition: what is put back is what was taken out."""

import numpy as np
import pytest
from sklearn.frozen import FrozenEstimator

from skhyst.compose import (
    Cascade,
    Modulated,
    OnColumn,
    ScheduledParameters,
    Stage,
    Sum,
    series_stages,
    stage_values,
    with_series_stages,
    with_stage_values,
)
from skhyst.disturbance import Offset
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import FirstOrderLag, FirstOrderLagOperator, Gain, SecondOrderModeOperator
from skhyst.operators import SeriesOperator, take_apart
from skhyst.records import stack_records

DT = 0.01
PLAYS = PrandtlIshlinskii(thresholds=[0.0, 0.3])
RNG = np.random.default_rng(3)
RECORDS = [np.cumsum(RNG.normal(size=(200, 2)), axis=0) / 10.0 for _ in range(3)]
X, y = stack_records([(X, X[:, 0] + 0.1 * X[:, 1]) for X in RECORDS], dt=DT)


def series():
    held = FirstOrderLag(dt=DT).fit(X, y)
    return Cascade([("plays", PLAYS), ("lag", FirstOrderLag()), ("known", FrozenEstimator(held))])


@pytest.mark.parametrize(
    ("model", "names"),
    [
        (PLAYS, ["prandtl_ishlinskii"]),
        (series(), ["plays", "lag", "known"]),
        (Modulated(Modulated(series()), "amplitude"), ["plays", "lag", "known"]),
        (ScheduledParameters(series(), parameters=["plays__weights"]), ["plays", "lag", "known"]),
        (Sum([("plant", PLAYS), ("offset", Offset())]), ["plant"]),
        (
            Sum([("plant", Modulated(series())), ("heat", OnColumn(Gain(), 1)), ("b", Offset())]),
            ["plays", "lag", "known"],
        ),
        (Sum([("a", PLAYS), ("b", FirstOrderLag())]), ["sum"]),
        (Sum([("a", PLAYS), ("b", FirstOrderLag()), ("offset", Offset())]), ["model"]),
    ],
)
@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ConvergenceWarning")
def test_stages_go_out_and_in_again(model, names):
    fitted = model.fit(X, y)
    operator = fitted._with_held(take_apart(fitted.operator_)[0])
    whole = Stage(None, model, operator)
    stages = series_stages(whole)
    assert [stage.name for stage in stages] == names
    lag = Stage("further", FirstOrderLag(), FirstOrderLagOperator(0.1))
    _, more, longer = with_series_stages(whole, [*stages, lag])
    assert len(longer.entries()) == len(operator.entries()) + 3
    same = with_series_stages(Stage(None, more, longer), stages)
    values, before = stage_values(same), stage_values(whole)
    assert values.keys() == before.keys()
    for key, value in before.items():
        np.testing.assert_allclose(values[key], value, err_msg=str(key))
    moved = with_stage_values(whole, {key: 2.0 * value for key, value in before.items()})
    free = ~operator.gauge_mask()
    np.testing.assert_allclose(moved.operator.pack()[free], 2.0 * operator.pack()[free])
    assert [name for name, _ in moved.operator.entries()] == [n for n, _ in operator.entries()]


@pytest.mark.parametrize("without", [None, "first", "second"])
def test_gain_and_intercept_of_linear_stages_move_and_do_not_vanish(without):
    first = SecondOrderModeOperator(30.0, 0.3, 2.0, 0.4)
    second = FirstOrderLagOperator(0.05, 3.0, -0.5)
    whole = SeriesOperator(("first", "second"), (first, second))
    u = RECORDS[0][:, 0]
    if without is None:
        found = whole.normalized()
        assert (found.stages[0].gain, found.stages[0].intercept) == (1.0, 0.0)
        np.testing.assert_allclose(found.run(u, DT)[0], whole.run(u, DT)[0], atol=1e-12)
        return
    (stage,) = whole.without(without).stages
    at_rest = np.full(5, 1.7)
    np.testing.assert_allclose(stage.run(at_rest, DT)[0], whole.run(at_rest, DT)[0])
