"""A model with something put in is the model with something put in, and without it as before."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from skhyst.compose import Cascade, Modulated, OnColumn, ScheduledParameters, Sum
from skhyst.diagnosis._edits import (
    AddDisturbance,
    AddForce,
    Bias,
    Drive,
    Enrich,
    Hold,
    Insert,
    InsertAt,
    Modulate,
    Schedule,
)
from skhyst.diagnosis._tree import Tree, as_read
from skhyst.disturbance import Drift, DriftOperator, Offset, OffsetOperator
from skhyst.hysteresis import (
    CoulombFriction,
    CoulombFrictionOperator,
    Dahl,
    DahlOperator,
    PrandtlIshlinskii,
    PrandtlIshlinskiiOperator,
    RestoringForce,
    RestoringForceOperator,
)
from skhyst.linear import (
    DynamicStiffness,
    DynamicStiffnessOperator,
    FirstOrderLag,
    FirstOrderLagOperator,
    Gain,
    GainOperator,
    SecondOrderMode,
    SecondOrderModeOperator,
    TransferFunction,
)
from skhyst.operators import Series, parts_with_resolution, snake_case, split_disturbances
from skhyst.optimize import RecordData
from skhyst.records import stack_records
from skhyst.static import (
    DeadBand,
    DeadBandOperator,
    PolynomialCurveOperator,
    Saturation,
    SaturationOperator,
    SmoothCurve,
)

DT = 0.01


def drive(seed=0, n=400):
    return np.cumsum(np.random.default_rng(seed).standard_normal(n)) / 10.0


@pytest.fixture(scope="module")
def records():
    rng = np.random.default_rng(9000)
    found = []
    for seed in range(3):
        u = drive(seed)
        y = u + 0.2 * np.sin(u) + 0.01 * rng.standard_normal(u.size)
        column = 1.0 + seed + 0.2 * drive(seed + 20)
        found.append(RecordData(u, y, DT, auxiliary=column[:, None]))
    return found


def taken_apart(model, records):
    result = model.identify(records)
    return Tree.from_result(model, result), result


def cascade():
    return Cascade([("hysteresis", PrandtlIshlinskii(4)), ("dynamics", FirstOrderLag())])


def start_of(model, records):
    return split_disturbances(model.starting_values(records)[0])[0]


@pytest.mark.parametrize("model", [PrandtlIshlinskii(4), cascade()], ids=["alone", "cascade"])
def test_it_is_the_declared_model_at_its_solution(model, records):
    tree, result = taken_apart(model, records)
    expected = [result.operator.run(record.u, record.dt)[0] for record in records]
    np.testing.assert_allclose(tree.run(records), expected, atol=1e-12)
    np.testing.assert_allclose(tree.respond(records), expected, atol=1e-12)
    problem = tree.problem(records)
    cost = problem.total(problem.evaluate(problem.x0))[-1, -1]
    assert cost == pytest.approx(sum(len(r.u) for r in records) * result.error**2, rel=1e-9)


def test_stages_stand_in_the_order_of_the_signal(records):
    declared, _ = taken_apart(cascade(), records)
    tree = declared
    for model, name in [
        (SmoothCurve(3), "sensor"),
        (Saturation(sides="upper", place="sensor"), "limit"),
        (Saturation(sides="upper", place="drive"), "amplifier"),
        (TransferFunction(n_poles=2), "mode"),  # of the stage order of the dynamics: behind them
    ]:
        tree = tree.edited(name, Insert(model, start_of(model, records)))
    ranks = [operator.stage_order for operator in tree.operators]
    assert ranks == sorted(ranks)
    assert tree.names == ("amplifier", "hysteresis", "dynamics", "mode", "sensor", "limit")
    assert len(tree.models) == len(tree.operators) == 6
    assert isinstance(tree.operators[0], SaturationOperator)
    assert declared.names == ("hysteresis", "dynamics")  # nothing is changed in place


def test_a_stretch_of_the_series_is_a_part_of_the_whole(records):
    tree, _ = taken_apart(cascade(), records)
    first = tree.run(records, last=1)
    np.testing.assert_array_equal(tree.run(records, first=1, signals=first), tree.run(records))


def test_at_puts_the_solution_back(records):
    tree, _ = taken_apart(cascade(), records)
    problem = tree.problem(records)
    moved = tree.at(problem, problem.x0 + 0.01)
    np.testing.assert_allclose(moved.problem(records).x0, problem.x0 + 0.01, atol=1e-12)


def test_coefficients_are_those_of_the_disturbances(records):
    tree, _ = taken_apart(PrandtlIshlinskii(4), records)
    assert tree.n_further_estimates() == 0
    tree = tree.edited("offset", AddDisturbance(Offset(), OffsetOperator(np.zeros(1))))
    assert "intercept" not in "".join(tree.problem(records).names)  # each record has its own
    tree = tree.edited("drift", AddDisturbance(Drift(3), DriftOperator(np.zeros(4), 1.0)))
    assert tree.n_further_estimates() == 5
    tree = replace(tree, input_history=tuple(np.zeros((3, 2))))  # and two values before each
    assert tree.n_further_estimates() == 7


def test_estimator_is_the_declared_model_with_what_was_added(records):
    tree, _ = taken_apart(PrandtlIshlinskii(4, dt=DT), records)
    assert type(tree.estimator) is PrandtlIshlinskii
    lag = Insert(FirstOrderLag(), FirstOrderLagOperator(0.02))
    model = tree.edited("lag", lag).estimator
    assert isinstance(model, Cascade)
    assert [name for name, _ in model.steps] == ["prandtl_ishlinskii", "lag"]
    assert model.dt == DT
    model = tree.edited("offset", AddDisturbance(Offset(), OffsetOperator(np.zeros(1)))).estimator
    assert isinstance(model, Sum)
    assert [name for name, _ in model.steps] == ["prandtl_ishlinskii", "offset"]


def test_a_second_stage_of_a_name_gets_a_name_of_its_own(records):
    declared = Cascade([("hysteresis", PrandtlIshlinskii(4)), ("lag", FirstOrderLag())])
    tree, _ = taken_apart(declared, records)
    changed = tree.edited("lag", Insert(FirstOrderLag(), FirstOrderLagOperator(0.02)))
    assert changed.names == ("hysteresis", "lag", "lag_2")
    assert changed.part("lag").time_constant == 0.02
    assert [name for name, _ in changed.estimator.steps] == list(changed.names)
    assert changed.without("lag").names == tree.names


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("PrandtlIshlinskii", "prandtl_ishlinskii"),
        ("Delay", "delay"),
        ("SecondOrderMode", "second_order_mode"),
    ],
)
def test_snake_case(name, expected):
    assert snake_case(name) == expected


# ---------------------------------------------------------------------- in and out again


MODE = SecondOrderModeOperator(30.0, 0.4, 2.5, 0.3)
PLAYS = PrandtlIshlinskiiOperator([0.0, 0.3], [0.8, 0.4])
ADDED = {
    "lag": [Insert(FirstOrderLag(), FirstOrderLagOperator(0.05))],
    "resonance": [Insert(SecondOrderMode(), SecondOrderModeOperator(80.0, 0.1))],
    "output_saturation": [Insert(Saturation(place="sensor"), SaturationOperator(-1.5, 1.5, 50))],
    "offset": [AddDisturbance(Offset(), OffsetOperator(np.zeros(1)))],
    "auxiliary_input": [Drive(Gain(fit_intercept=False), GainOperator(0.7), 1)],
    "bias": [Bias(FirstOrderLag(fit_intercept=False), FirstOrderLagOperator(0.05, 0.3), 1, 0.2)],
    "scaled": [Modulate(1, 1.5)],
    "amplitude_dependence": [Modulate("amplitude", 1.0)],
    "scheduled": [Schedule("amplitude", 0.5, 2.0, "dynamics")],
}
IN_MOTION = {
    "cubic_stiffness": [
        Enrich(
            "second_order_mode",
            RestoringForce(3, damping_degree=1, fit_hysteresis=False),
            RestoringForceOperator(30.0, 0.4, [0.2], [], 0.0, 0.0, 0.0, 2.5, 0.3),
        )
    ],
    "hysteresis": [
        Enrich(
            "second_order_mode",
            RestoringForce(1, damping_degree=1),
            RestoringForceOperator(30.0, 0.4, [], [], 3.0, 0.2, 0.0, 2.5, 0.3),
        )
    ],
}
FORCES = {
    "friction": [
        AddForce(
            "dynamic_stiffness",
            CoulombFriction(fit_damping=False, fit_intercept=False),
            CoulombFrictionOperator(0.1, 0.3),
        )
    ],
    "hysteresis": [
        AddForce(
            "dynamic_stiffness",
            Dahl(fit_damping=False, fit_intercept=False),
            DahlOperator(0.1, 0.3),
        )
    ],
}
SLOW = [("offset", "lag", "scheduled"), ("auxiliary_input", "scaled", "output_saturation")]


def two_and_three(names):
    return [*permutations(names, 2), *(p for own in SLOW for p in permutations(own))]


DECLARED = {
    "mode": (SecondOrderMode(), MODE, ADDED | IN_MOTION),
    "plays": (PrandtlIshlinskii(thresholds=[0.0, 0.3]), PLAYS, ADDED),
    "forces": (DynamicStiffness(), DynamicStiffnessOperator(0.1, 0.2, 1.0), ADDED | FORCES),
}


def structure(tree):
    """Return all of a tree but its values."""
    params = tree.model.get_params()
    plain = {key: value for key, value in params.items() if not hasattr(value, "fit")}
    names = [name for name, _ in tree.operator.entries()]
    return tree.names, repr(plain), names, tree.disturbance_names, type(tree.model)


@pytest.mark.parametrize("kind", DECLARED)
def test_what_is_taken_out_leaves_the_rest_as_it_was(kind, records):
    model, operator, effects = DECLARED[kind]
    declared = Tree.of(model, operator)
    before = declared.respond(records)
    for order in two_and_three(effects):
        tree = declared
        for name in order:
            tree = tree.edited(name, *effects[name])
        for out in order:
            rest = declared
            for name in order:
                if name != out:
                    rest = rest.edited(name, *effects[name])
            less = tree.without(out)
            assert structure(less) == structure(rest), (order, out)
            assert less.effects == rest.effects
            own, expected = less.respond(records), rest.respond(records)
            np.testing.assert_allclose(own, expected, atol=1e-9, err_msg=f"{order} {out}")
        for out in order[1:] + order[:1]:
            tree = tree.without(out)
        assert structure(tree) == structure(declared), order
        np.testing.assert_allclose(tree.respond(records), before, atol=1e-9, err_msg=f"{order}")


def test_two_enrichments_of_one_stage_are_one_stage(records):
    declared = Tree.of(SecondOrderMode(), MODE)
    for order in permutations(IN_MOTION):
        tree = declared
        for name in order:
            tree = tree.edited(name, *IN_MOTION[name])
        (stage,) = tree.operators
        assert stage.stiffness_coefficients.tolist() == [0.2]
        assert (stage.hysteresis_stiffness, stage.slip_level) == (3.0, 0.2)
        (model,) = tree.models
        assert model.fit_hysteresis
        assert model.stiffness_degree == 3


def test_a_value_that_has_moved_stays_where_it_is(records):
    tree = Tree.of(SecondOrderMode(), MODE).edited("lag", *ADDED["lag"])
    tree = tree.edited("scheduled", *ADDED["scheduled"])
    problem = tree.problem(records)
    moved = tree.at(problem, problem.x0 + 0.1).without("scheduled").without("lag")
    (mode,) = moved.operators
    assert mode.natural_frequency == pytest.approx(30.0 * np.exp(0.1))
    assert mode.gain == pytest.approx(2.6)  # the lag has had it


# ---------------------------------------------------------------------- gains


def behind_a_saturation():
    """Return a mode whose gain a saturation has made a nonlinear parameter."""
    tree = Tree.of(SecondOrderMode(), replace(MODE, gain=3e-7, intercept=1e-8))
    limit = SaturationOperator(-np.inf, 2e-7, stage_order=50)
    return tree.edited("output_saturation", Insert(Saturation(place="sensor"), limit))


def test_a_part_of_a_sum_keeps_its_terms_without_another_part(records):
    """Whose members differ: the curve alone is what it was, the force is gone."""
    force = AddForce("gain", Dahl(), DahlOperator(0.2, 1.5))
    start = PolynomialCurveOperator(np.zeros(2), 0.0, 3.0, passed=0.0)
    curve = AddForce("gain", SmoothCurve(3, passes=False), start)
    tree, _ = taken_apart(Gain(), records)
    whole = tree.edited("friction", force).edited("bend", curve)
    [(_, part, put)] = parts_with_resolution(whole.operators[0])
    terms = np.arange(1.0, 5.0)
    more = replace(part, coefficients=terms, model=SmoothCurve(5, passes=False))
    left = whole.with_stage(0, put(more)).without("friction").operators[0]
    assert left.names == ("gain", "bend")
    np.testing.assert_array_equal(left.stages[1].coefficients, terms)
    assert left.stages[1].model.degree == 5


def test_a_linear_stage_more_takes_the_gain_over(records):
    tree = behind_a_saturation()
    more = tree.edited("lag", Insert(FirstOrderLag(), FirstOrderLagOperator(1e-9)))
    problem = more.problem(records)
    at_start = problem.predictions(problem.x0, np.ones(len(problem.segment_record), dtype=bool))
    for found in (more.run(records), at_start):
        for y, expected in zip(found, tree.run(records), strict=True):
            np.testing.assert_allclose(y, expected, atol=1e-6 * np.ptp(expected))


def test_a_linear_stage_less_gives_the_gain_back():
    tree = behind_a_saturation()
    lag = FirstOrderLagOperator(1e-9, 2.0, -1e-9)
    rest = tree.edited("lag", Insert(FirstOrderLag(), lag)).without("lag")
    mode = rest.operators[0]
    assert mode.gain == pytest.approx(6e-7)
    assert mode.intercept == pytest.approx(2.0 * 1e-8 - 1e-9)
    assert rest.operators[1] == tree.operators[1]


# ---------------------------------------------------------------------- as an estimator


def data(records):
    return stack_records([(np.column_stack([r.u, r.auxiliary]), r.y) for r in records], dt=DT)


@pytest.mark.filterwarnings("ignore:No one set of parameters")
@pytest.mark.parametrize("names", [("lag",), ("offset",), ("auxiliary_input", "scaled")])
def test_a_clone_of_the_fitted_model_comes_out_where_the_tree_is(names, records):
    model = PrandtlIshlinskii(thresholds=[0.0, 0.3], dt=DT)
    tree, _ = taken_apart(model, records)
    for name in names:
        tree = tree.edited(name, *ADDED[name])
    _, result = tree.fitted(records, ())
    anew = tree.identified(records)
    assert structure(anew) == structure(tree)
    again = tree.estimator.fit(*data(records))
    assert again.fit_error_ == pytest.approx(result.error, rel=1e-3)
    for own, found in zip(result.params.items(), again.params_.items(), strict=True):
        assert found == (own[0], pytest.approx(own[1], rel=0.05, abs=0.02))


@pytest.mark.parametrize("names", [("auxiliary_input", "lag"), ("amplitude_dependence", "offset")])
def test_what_has_been_found_can_be_declared_again(names, records):
    tree = Tree.of(PrandtlIshlinskii(thresholds=[0.0, 0.3], dt=DT), PLAYS)
    for name in names:
        tree = tree.edited(name, *ADDED[name])
    declared = Tree.of(tree.model, tree.operator, tree.disturbances)
    assert declared.names == tree.names
    np.testing.assert_allclose(declared.respond(records), tree.respond(records))
    more = declared.edited("resonance", *ADDED["resonance"])
    assert more.names == (*tree.names, "resonance")
    assert structure(more.without("resonance")) == structure(declared)
    anew = declared.identified(records)
    assert structure(anew) == structure(declared)


def test_compositions_nested_in_a_declared_model_are_looked_through(records):
    inside = Cascade([("plays", PrandtlIshlinskii(4)), ("lag", FirstOrderLag())])
    model = Sum(
        [
            ("plant", Modulated(ScheduledParameters(inside, parameters=["lag__time_constant"]), 1)),
            ("heat", OnColumn(Gain(fit_intercept=False), 1)),
            ("offset", Offset()),
        ]
    )
    model.n_features_in_ = 2
    result = model.identify(as_read(model, records))
    declared = Tree.from_result(model, result)
    assert declared.names == ("plays", "lag")
    assert set(declared.lines) == {("lag", "time_constant")}
    more = declared.edited("resonance", *ADDED["resonance"])
    assert more.names == ("plays", "lag", "resonance")
    assert more.disturbance_names == ("offset",)
    assert set(more.lines) == {("lag", "time_constant")}
    np.testing.assert_allclose(
        more.without("resonance").respond(records), declared.respond(records), atol=1e-9
    )


def test_records_begin_as_declared_with_an_added_part():
    plays = PrandtlIshlinskii(2, initial_state="estimate")
    operator = PrandtlIshlinskiiOperator(np.array([0.0, 0.5]), np.ones(2))
    both = Cascade([("plays", plays), ("lag", FirstOrderLag(initial_state="estimate"))])
    series = Series(("plays", "lag"), (operator, FirstOrderLagOperator(0.1)))
    for model, of_model in ((plays, operator), (both, series)):
        declared = Tree.of(model, of_model)
        parallel = AddForce(declared.names[0], Gain(fit_intercept=False), GainOperator(1.0))
        offset = AddDisturbance(Offset(), OffsetOperator(np.ones(1)))
        behind = Insert(FirstOrderLag(), FirstOrderLagOperator(0.2))
        for edit in (parallel, offset, behind):
            tree = declared.edited("added", edit)
            assert tree.state == declared.state
            assert tree.model.initial_state == "estimate"


def test_what_was_done_to_an_added_stage_goes_with_it():
    tree = Tree.of(Gain(), GainOperator(1.0))
    tree = tree.edited("lag", Insert(FirstOrderLag(), FirstOrderLagOperator(0.1)))
    tree = tree.edited("timing", Hold("lag", "zoh"))
    assert tree.without("timing").effects == ("lag",)
    assert tree.without("timing").part("lag").hold == "foh"
    assert tree.without("lag").effects == ()


def test_what_stands_behind_an_added_stage_moves_up_without_it():
    tree = Tree.of(Gain(), GainOperator(1.0))
    tree = tree.edited("lag", Insert(FirstOrderLag(), FirstOrderLagOperator(0.1)))
    band = InsertAt("lag", DeadBand(), DeadBandOperator(0.2, 0.0))
    less = tree.edited("dead_zone", band).without("lag")
    assert less.names == ("gain", "dead_zone")
    assert less.part("dead_zone").half_width == 0.2
