"""A model taken apart, with something put in, is the model with something put in."""

from dataclasses import replace

import numpy as np
import pytest

from skhyst.compose import Cascade, Sum
from skhyst.diagnosis._structure import Schedule, Structure, snake_case
from skhyst.disturbance import Drift, DriftOperator, Offset, OffsetOperator
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import FirstOrderLag, FirstOrderLagOperator, SecondOrderMode, TransferFunction
from skhyst.optimize import RecordData
from skhyst.static import Saturation, SaturationOperator, SmoothCurve


def drive(seed=0, n=400):
    return np.cumsum(np.random.default_rng(seed).standard_normal(n)) / 10.0


@pytest.fixture(scope="module")
def records():
    rng = np.random.default_rng(9000)
    found = []
    for seed in range(3):
        u = drive(seed)
        y = u + 0.2 * np.sin(u) + 0.01 * rng.standard_normal(u.size)
        found.append(RecordData(u, y, 0.01))
    return found


def taken_apart(model, records):
    result = model._identify(records)
    return Structure.from_result(model, result), result


def cascade():
    return Cascade([("hysteresis", PrandtlIshlinskii(4)), ("dynamics", FirstOrderLag())])


@pytest.mark.parametrize("model", [PrandtlIshlinskii(4), cascade()], ids=["alone", "cascade"])
def test_it_runs_as_the_declared_model_does(model, records):
    structure, result = taken_apart(model, records)
    for record, y in zip(records, structure.run(records), strict=True):
        expected = result.operator.run(record.u, record.dt)[0]
        np.testing.assert_allclose(y, expected, atol=1e-12 * np.ptp(expected))


@pytest.mark.parametrize("model", [PrandtlIshlinskii(4), cascade()], ids=["alone", "cascade"])
def test_its_problem_starts_at_the_declared_solution(model, records):
    structure, result = taken_apart(model, records)
    problem = structure.problem(records)
    cost = problem.total(problem.evaluate(problem.x0))[-1, -1]
    n = sum(len(record.u) for record in records)
    assert cost == pytest.approx(n * result.error**2, rel=1e-9)


def test_stages_stand_in_the_order_of_the_signal(records):
    structure, _ = taken_apart(cascade(), records)
    for model, name in [
        (SmoothCurve(3), "sensor"),
        (Saturation(sides="upper", rank="sensor"), "limit"),
        (Saturation(sides="upper", rank="drive"), "amplifier"),
        (TransferFunction(n_poles=2), "mode"),
    ]:
        structure = structure.insert(name, model, model.starting_values(records)[0][0])
    ranks = [operator.rank for operator in structure.operators]
    assert ranks == sorted(ranks)
    assert structure.names == ("amplifier", "hysteresis", "dynamics", "mode", "sensor", "limit")
    assert len(structure.models) == len(structure.operators) == 6
    assert isinstance(structure.operators[0], SaturationOperator)


def test_a_stage_of_equal_rank_goes_behind(records):
    structure, _ = taken_apart(cascade(), records)
    operator = FirstOrderLag().starting_values(records)[0][0]
    assert structure.insert("lag", FirstOrderLag(), operator).names[-1] == "lag"


def test_nothing_is_changed_in_place(records):
    structure, _ = taken_apart(cascade(), records)
    before = structure.names, structure.operators, structure.disturbances
    structure.insert("lag", FirstOrderLag(), FirstOrderLag().starting_values(records)[0][0])
    structure.beside("offset", Offset(), OffsetOperator(np.zeros(1)))
    assert (structure.names, structure.operators, structure.disturbances) == before


def test_a_stretch_of_the_series_is_a_part_of_the_whole(records):
    structure, _ = taken_apart(cascade(), records)
    first = structure.run(records, last=1)
    second = structure.run(records, first=1, signals=first)
    for a, b in zip(second, structure.run(records), strict=True):
        np.testing.assert_array_equal(a, b)


def test_at_puts_the_solution_back(records):
    structure, _ = taken_apart(cascade(), records)
    problem = structure.problem(records)
    moved = structure.at(problem, problem.x0 + 0.01)
    np.testing.assert_allclose(moved.problem(records).x0, problem.x0 + 0.01, atol=1e-12)


def test_coefficients_are_those_of_the_disturbances(records):
    structure, _ = taken_apart(PrandtlIshlinskii(4), records)
    assert structure.n_coefficients() == 0
    structure = structure.beside("offset", Offset(), OffsetOperator(np.zeros(1)))
    structure = structure.beside("drift", Drift(3), DriftOperator(np.zeros(4), 1.0))
    assert structure.n_coefficients() == 5


def test_estimator_is_the_declared_model_with_what_was_added(records):
    declared = PrandtlIshlinskii(4, dt=0.01)
    structure, _ = taken_apart(declared, records)
    assert type(structure.estimator(declared)) is PrandtlIshlinskii
    lag = FirstOrderLag().starting_values(records)[0][0]
    model = structure.insert("lag", FirstOrderLag(), lag).estimator(declared)
    assert isinstance(model, Cascade)
    assert [name for name, _ in model.steps] == ["prandtl_ishlinskii", "lag"]
    assert model.dt == 0.01
    offset = OffsetOperator(np.zeros(1))
    model = structure.beside("offset", Offset(), offset).estimator(declared)
    assert isinstance(model, Sum)
    assert [name for name, _ in model.steps] == ["prandtl_ishlinskii", "offset"]


def test_fitted_model_predicts_what_the_structure_runs(records):
    declared = PrandtlIshlinskii(4, dt=0.01)
    structure, _ = taken_apart(declared, records)
    lag = FirstOrderLag().starting_values(records)[0][0]
    structure = structure.insert("lag", FirstOrderLag(), lag)
    model, result = structure.fitted(declared, records, ())
    model.n_features_in_ = 1
    u = drive(7)
    expected = result.operator.run(u, 0.01)[0]
    np.testing.assert_allclose(model.predict(u.reshape(-1, 1)), expected, atol=1e-12)


@pytest.mark.parametrize("schedule", [None, Schedule("amplitude", 1.0, 2.0, {})])
def test_a_second_stage_of_a_name_gets_a_name_of_its_own_and_goes_again(schedule, records):
    declared = Cascade([("hysteresis", PrandtlIshlinskii(4)), ("lag", FirstOrderLag())])
    structure, _ = taken_apart(declared, records)
    parts = "lag", FirstOrderLag(), FirstOrderLagOperator(0.02)
    if schedule is None:
        changed = structure.insert(*parts)
    else:
        changed = structure.inserted_by_record(*parts, schedule)
    assert len(set(changed.names)) == 3
    assert changed.operators[changed.place("lag")].time_constant == 0.02
    if schedule is None:
        names = [name for name, _ in changed.estimator(declared).steps]
        assert sorted(names) == sorted(changed.names)
    assert changed.without("lag") == structure


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


def behind_a_saturation(records):
    """Return a mode whose gain a saturation has made a nonlinear parameter."""
    result = SecondOrderMode()._identify(records)
    structure = Structure.from_result(SecondOrderMode(), result)
    mode = replace(result.operator, gain=3e-7, intercept=1e-8)
    structure = replace(structure, operators=(mode,))
    limit = SaturationOperator(-np.inf, 2e-7, rank=50)
    return structure.insert("output_saturation", Saturation(rank=50), limit)


def test_a_linear_stage_more_takes_the_gain_over(records):
    structure = behind_a_saturation(records)
    fast = FirstOrderLagOperator(1e-9)
    more = structure.insert("lag", FirstOrderLag(), fast)
    for y, expected in zip(more.run(records), structure.run(records), strict=True):
        np.testing.assert_allclose(y, expected, atol=1e-6 * np.ptp(expected))
    problem = more.problem(records)
    at_start = problem.predictions(problem.x0, np.ones(len(problem.segment_record), dtype=bool))
    for y, expected in zip(at_start, structure.run(records), strict=True):
        np.testing.assert_allclose(y, expected, atol=1e-6 * np.ptp(expected))


def test_a_linear_stage_less_gives_the_gain_back(records):
    structure = behind_a_saturation(records)
    lag = FirstOrderLagOperator(1e-9, 2.0, -1e-9)
    rest = structure.insert("lag", FirstOrderLag(), lag).without("lag")
    mode = rest.operators[0]
    assert mode.gain == pytest.approx(6e-7)
    assert mode.intercept == pytest.approx(2.0 * 1e-8 - 1e-9)
    assert rest.operators[1] == structure.operators[1]
