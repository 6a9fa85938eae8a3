"""The tree of operators and the estimator that it is the structure of say the same."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.base import clone
from sklearn.frozen import FrozenEstimator

from skhyst.compose import Cascade, Modulated, OnColumn, ScheduledParameters, Sum
from skhyst.disturbance import Drift, DriftOperator, Offset, OffsetOperator
from skhyst.hysteresis import (
    ModifiedPrandtlIshlinskii,
    PrandtlIshlinskii,
    PrandtlIshlinskiiOperator,
)
from skhyst.linear import (
    FirstOrderLag,
    FirstOrderLagOperator,
    Gain,
    GainOperator,
    SecondOrderMode,
    SecondOrderModeOperator,
)
from skhyst.operators import (
    Factor,
    FrozenOperator,
    OnColumnOperator,
    Scaled,
    Scheduled,
    Series,
    Stage,
    SumOperator,
    add_disturbances,
    add_parallel,
    series_stages,
    split_disturbances,
    stage_values,
    with_series_stages,
    with_stage_values,
)
from skhyst.static import MonotoneDeadZoneOperator

DT = 0.01
U = np.cumsum(np.random.default_rng(0).normal(size=(60, 3)), axis=0) / 5
PLAYS = PrandtlIshlinskiiOperator([0.0, 0.3], [1.0, 0.4])
ZONES = MonotoneDeadZoneOperator([0.6, 0.3], [-0.2, 0.3], n_lower=1)
LAG, MODE = FirstOrderLagOperator(0.05, 1.2, 0.1), SecondOrderModeOperator(30.0, 0.2, hold="zoh")
KNOWN = FrozenEstimator(FirstOrderLag(dt=DT).fit(U[:, :1], LAG.run(U[:, 0], DT)[0]))

# Pairs of an unfitted model and an operator, put together as a fit does, each by itself.
LEAVES = [
    (Gain(fit_intercept=False, dt=DT), GainOperator(3.0)),
    (FirstOrderLag(method="differential_evolution"), LAG),
    (SecondOrderMode(hold="zoh", initial_state="zero"), MODE),
    (PrandtlIshlinskii(thresholds=[0.0, 0.3]), PLAYS),
    (ModifiedPrandtlIshlinskii(2), Series(("plays", "zones"), (PLAYS, ZONES))),
]
DISTURBANCES = [
    (Offset(dt=DT), OffsetOperator(np.array([0.3]))),
    (Drift(1), DriftOperator(np.array([0.1, 0.2]), 1.0)),
]
HELD = KNOWN, FrozenOperator(KNOWN.estimator.operator_)
NAMES = ["first", "second", "third", "model"]  # of steps in series
SUMMANDS = ["one", "two", "three", "model"]  # of those in parallel
OPTIONS = st.fixed_dictionaries(
    {
        "initial_state": st.sampled_from(["rest", "zero", "estimate"]),
        "dt": st.sampled_from([1.0, DT]),
        "method": st.sampled_from(["variable_projection", "levenberg_marquardt"]),
    }
)


@st.composite
def series(draw, inside):
    parts = draw(st.lists(inside, min_size=1, max_size=3))
    names = draw(st.permutations(NAMES))[: len(parts)]
    steps = [(name, model) for name, (model, _) in zip(names, parts, strict=True)]
    operator = Series(tuple(names), tuple(operator for _, operator in parts))
    return Cascade(steps, warm_start=draw(st.booleans()), **draw(OPTIONS)), operator


@st.composite
def total(draw, inside, columns=(), disturbances=False):
    """Draw a sum; beside what reads columns the others read the first."""
    parts = draw(st.lists(inside, min_size=1, max_size=2))
    names = draw(st.permutations(SUMMANDS))[: len(parts)]
    additive = draw(st.lists(st.sampled_from(DISTURBANCES), max_size=2)) if disturbances else []
    branches = draw(st.lists(st.sampled_from(columns), max_size=2)) if columns else []
    parts, names = parts + branches, names + [f"column{i}" for i in range(len(branches))]
    own = [operator for _, operator in parts]
    if any(operator.reads_columns for operator in own):
        own = [op if op.reads_columns else OnColumnOperator(op, 0) for op in own]
    steps = [(name, model) for name, (model, _) in zip(names, parts, strict=True)]
    others = [(f"beside{i}", model) for i, (model, _) in enumerate(additive)]
    operator = SumOperator(tuple(names), tuple(own))
    found = add_disturbances(operator, tuple(op for _, op in additive), tuple(n for n, _ in others))
    order = draw(st.permutations(range(len(steps) + len(others))))
    steps = mixed(steps, others, order)
    return Sum(steps, **draw(OPTIONS)), found


def mixed(steps, others, order):
    """Return the steps with the others between them, both in their own order."""
    first, second = iter(steps), iter(others)
    return [next(first) if i < len(steps) else next(second) for i in order]


@st.composite
def scheduled(draw, inside):
    model, operator = draw(inside)
    free = model.tree(operator).free_mask()
    some = draw(st.booleans())
    degrees = [int(is_free and not (some and i % 2)) for i, is_free in enumerate(free)]
    entries = zip(operator.entries(), degrees, strict=True)
    names = [name for (name, _), degree in entries if degree] if some else None
    own = Scheduled.constant(operator, degrees, 1.0, 3.0)
    return ScheduledParameters(model, by=1, parameters=names, **draw(OPTIONS)), own


@st.composite
def scaled(draw, inside):
    model, operator = draw(inside)
    column = draw(st.sampled_from([1, 2, "amplitude"]))
    driven, additive = split_disturbances(operator)
    driven = driven if driven.reads_columns else OnColumnOperator(driven, 0)
    own = Scaled(driven, -1 if column == "amplitude" else column, 0.4, 0.1)
    return Modulated(model, column, **draw(OPTIONS)), add_disturbances(own, additive)


@st.composite
def on_column(draw, inside, column=1):
    model, operator = draw(inside)
    centered = draw(st.booleans())
    reference = 0.3 * centered
    model = OnColumn(model, column, centered=centered, **draw(OPTIONS))
    return model, OnColumnOperator(operator, column, reference)


LEAF = st.sampled_from(LEAVES)
BRANCHES = [
    (OnColumn(Gain(), 1, dt=DT), OnColumnOperator(GainOperator(0.5), 1)),
    (OnColumn(FirstOrderLag(), 2, centered=True), OnColumnOperator(LAG, 2, 0.3)),
]
OF_DRIVE = st.recursive(LEAF, lambda inside: series(inside) | total(inside), max_leaves=4)
CHAIN = OF_DRIVE | series(st.sampled_from([*LEAVES, HELD]))
WHOLE = st.one_of(
    CHAIN,
    scheduled(CHAIN),
    scaled(CHAIN),
    scaled(scaled(CHAIN) | scheduled(CHAIN)),
    on_column(CHAIN, 0),
    total(CHAIN | scaled(CHAIN) | scheduled(CHAIN), BRANCHES, disturbances=True),
    scaled(total(CHAIN, disturbances=True)),
    series(total(CHAIN, BRANCHES)).filter(lambda own: len(own[0].steps) == 1),
    st.sampled_from(DISTURBANCES),
)


def told(model):
    """Return all that an estimator is made of: classes, names and values of parameters."""
    found = {"": type(model)}
    for key, value in model.get_params().items():
        if key.split("__")[-1] == "steps":
            found[key] = [name for name, _ in value]
        else:
            found[key] = type(value) if hasattr(value, "get_params") else repr(value)
    return found


@settings(deadline=None, max_examples=60)
@given(WHOLE)
def test_there_and_back(whole):
    """From an estimator to its tree, back, and once more to the tree."""
    model, operator = whole
    tree = model.tree(operator)
    again = tree.estimator()
    assert told(again) == told(model)
    assert again is not model
    assert told(tree.estimator(dt=0.7)) == told(clone(model).set_params(dt=0.7))
    driven, disturbances = split_disturbances(tree)
    additive = tuple(own.released() for own in disturbances)
    same = again.tree((driven.released(), additive))
    assert repr(same) == repr(tree)
    np.testing.assert_array_equal(same.pack(), tree.pack())
    assert told(same.estimator()) == told(model)


@settings(deadline=None, max_examples=60)
@given(WHOLE)
def test_what_is_free(whole):
    """The tree knows which of its entries the model and another part's freedom hold."""
    model, operator = whole
    driven, _ = split_disturbances(model.tree(operator))
    names = [name for name, _ in driven.entries()]
    held = np.isin(names, list(model.held_parameters()))
    shared = np.array([spec.held for _, spec in driven.entries()], dtype=bool)
    np.testing.assert_array_equal(driven.free_mask(), ~(shared | held))


@settings(deadline=None, max_examples=60)
@given(CHAIN | scaled(CHAIN) | total(CHAIN, BRANCHES), st.sampled_from(DISTURBANCES))
def test_edits_that_change_nothing(whole, disturbance):
    model, operator = whole
    tree = Stage(None, model.tree(operator))
    stages = series_stages(tree)
    assert len({stage.name for stage in stages}) == len(stages)
    same = with_series_stages(tree, stages).operator
    u = U if same.reads_columns else U[:, 0]
    np.testing.assert_allclose(answer(same, u), answer(tree.operator, u), rtol=1e-12, atol=1e-12)
    assert stage_values(Stage(None, same)).keys() == stage_values(tree).keys()
    additive = add_parallel(tree, "further", disturbance[0].tree(disturbance[1]))
    assert [stage.name for stage in series_stages(additive)] == [stage.name for stage in stages]
    assert additive.operator.disturbance_names == ("further",)
    values = stage_values(tree)
    np.testing.assert_array_equal(with_stage_values(tree, values).pack(), tree.operator.pack())
    assert stage_values(additive).keys() == values.keys()


# --------------------------------------------------------------------------------- | + *


def answer(operator, u=U):
    return operator.run(u, DT, operator.init(u[0]))[0]


def test_in_series_one_drives_the_next():
    chain = PLAYS | LAG | MODE
    assert chain.names == ("prandtl_ishlinskii", "first_order_lag", "second_order_mode")
    expected = answer(MODE, answer(LAG, answer(PLAYS, U[:, 0])))
    np.testing.assert_array_equal(answer(chain, U[:, 0]), expected)
    assert chain == (PLAYS | (LAG | MODE))
    assert (LAG | LAG | LAG).names == ("first_order_lag", "first_order_lag_2", "first_order_lag_3")


def test_in_parallel_outputs_are_added():
    both = LAG + MODE
    expected = answer(LAG, U[:, 0]) + answer(MODE, U[:, 0])
    np.testing.assert_allclose(answer(both, U[:, 0]), expected, rtol=1e-14)
    assert answer(LAG + MODE + PLAYS, U[:, 0]) == pytest.approx(expected + answer(PLAYS, U[:, 0]))
    heat = OnColumnOperator(GainOperator(0.5), 1)
    expected = answer(LAG, U[:, 0]) + 0.5 * U[:, 1]
    np.testing.assert_allclose(answer(LAG + heat), expected, rtol=1e-13)


def test_a_factor_scales_the_response():
    warm = (PLAYS | LAG) * Factor(1, reference=0.4, sensitivity=0.3)
    expected = answer(PLAYS | LAG, U[:, 0]) * (1.0 + 0.3 * (U[:, 1] - 0.4))
    np.testing.assert_allclose(answer(warm), expected, rtol=1e-14)


def test_what_is_joined_is_an_estimator():
    plays, lag = (model.tree(operator) for model, operator in (LEAVES[3], LEAVES[1]))
    offset = DISTURBANCES[0][0].tree(DISTURBANCES[0][1])
    model = ((plays | lag) * Factor(2) + offset).estimator(dt=DT)
    names = ["prandtl_ishlinskii", "first_order_lag"]
    chain = Cascade([*zip(names, (LEAVES[3][0], LEAVES[1][0]), strict=True)])
    expected = Sum([("modulated", Modulated(chain, 2)), ("offset", DISTURBANCES[0][0])], dt=DT)
    assert told(model) == told(expected)


def test_wrong_operands():
    for wrong in (lambda: LAG | 1.0, lambda: LAG + 1.0, lambda: LAG * 2.0):
        with pytest.raises(TypeError, match="unsupported operand"):
            wrong()
    with pytest.raises(ValueError, match="PrandtlIshlinskiiOperator does not say which estimator"):
        (PLAYS | LAG).estimator()
