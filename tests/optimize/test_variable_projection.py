"""Separable least squares from Gram matrices: the truth, SciPy's answer, folds, disturbances."""

import dataclasses
from itertools import compress, pairwise

import numpy as np
import pytest
from scipy.optimize import least_squares

from skhyst.disturbance import DriftOperator, OffsetOperator, SinusoidOperator
from skhyst.hysteresis import PrandtlIshlinskiiOperator
from skhyst.linear import (
    DelayOperator,
    FirstOrderLagOperator,
    KelvinVoigtOperator,
    SecondOrderModeOperator,
)
from skhyst.operators import Series, SumOperator
from skhyst.optimize import (
    OperatorProblem,
    RecordData,
    predicted_cost,
    single_step,
    variable_projection,
)

DT = 0.01


def drive(seed, n=400):
    rng = np.random.default_rng(seed)
    time = DT * np.arange(n)
    phases = rng.uniform(0, 2 * np.pi, 6)
    frequencies = np.geomspace(0.3, 12.0, 6)
    return np.sin(2 * np.pi * np.outer(time, frequencies) + phases).sum(axis=1) / 2


def records(operator, noise=0.0, n_records=2, n=400):
    found = []
    for i in range(n_records):
        u = drive(i, n)
        y, _ = operator.run(u, DT)
        y = y + noise * np.random.default_rng(100 + i).normal(size=n)
        found.append(RecordData(u, y, DT))
    return found


def chain(time_constant=0.03, natural_frequency=60.0, damping_ratio=0.1, weights=(1.0, 0.4, 0.3)):
    return Series(
        ("plays", "lag", "mode"),
        (
            PrandtlIshlinskiiOperator(np.array([0.0, 0.3, 0.7]), np.array(weights), 0.2),
            FirstOrderLagOperator(time_constant),
            SecondOrderModeOperator(natural_frequency, damping_ratio),
        ),
    )


FIXED = ("plays__drive_offset",)
CASES = {
    "lag": (FirstOrderLagOperator(0.04, gain=2.0, intercept=0.3), FirstOrderLagOperator(0.4)),
    "mode": (
        SecondOrderModeOperator(40.0, 0.08, gain=2.0, intercept=0.3),
        SecondOrderModeOperator(30.0, 0.3),
    ),
    "creep": (
        KelvinVoigtOperator(np.array([0.3, 0.2]), np.array([0.02, 0.4]), 1.5, 0.3),
        KelvinVoigtOperator(np.array([0.1, 0.1]), np.array([0.04, 1.0]), 1.0),
    ),
    "delay": (DelayOperator(0.123), DelayOperator(0.11)),
    "chain": (chain(), chain(0.1, 45.0, 0.4, (0.0, 0.0, 0.0))),
    "sum": (
        SumOperator(
            ("slow", "fast"), (FirstOrderLagOperator(0.4, 2.0), FirstOrderLagOperator(0.02, -0.5))
        ),
        SumOperator(("slow", "fast"), (FirstOrderLagOperator(0.8), FirstOrderLagOperator(0.01))),
    ),
}


@pytest.fixture(params=CASES)
def case(request):
    return request.param


def problem_of(case, **options):
    """Return the problem of a case, from its start."""
    truth, start = CASES[case]
    return OperatorProblem(start, records(truth, **options), fixed=FIXED)


def residuals(problem, x):
    operator, _ = problem.unpack(x)
    return np.concatenate([problem.simulate(operator, r) - r.y for r in problem.records])


def test_recovers_the_truth(case):
    problem = problem_of(case)
    solution = variable_projection(problem, problem.x0)
    assert solution.converged
    found, _ = problem.unpack(solution.x)
    np.testing.assert_allclose(found.pack(), CASES[case][0].pack(), rtol=1e-5, atol=1e-6)


def test_agrees_with_scipy(case):
    problem = problem_of(case, noise=0.05)
    solution = variable_projection(problem, problem.x0, tolerance=1e-15)
    scipy = least_squares(
        lambda x: residuals(problem, x),
        problem.x0 + 0.9 * (solution.x - problem.x0),
        bounds=(problem.lower, problem.upper),
        x_scale="jac",
        jac="3-point",
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-14,
    )
    assert solution.cost == pytest.approx(2 * scipy.cost, rel=1e-9)
    np.testing.assert_allclose(solution.x, scipy.x, rtol=1e-6, atol=1e-6)


def test_default_tolerance_is_far_below_the_standard_errors(case):
    problem = problem_of(case, noise=0.05)
    rough = variable_projection(problem, problem.x0)
    exact = variable_projection(problem, problem.x0, tolerance=1e-15)
    curvature = exact.gram[:-1, :-1]
    miss = rough.x - exact.x
    # the miss in units of the noise, along its own direction
    assert miss @ curvature @ miss < 0.05**2 * 0.05**2 * len(miss) * 400


def test_gram_holds_cost_gradient_and_curvature(case):
    problem = problem_of(case, noise=0.05)
    rng = np.random.default_rng(0)
    x = problem.x0 + np.where(problem.linear, 0.1, 0.05) * rng.uniform(0.5, 1, len(problem.x0))
    gram = problem.total(problem.evaluate(x))
    r = residuals(problem, x)
    columns = []
    for h in 1e-6 * np.eye(len(x)):
        columns.append((residuals(problem, x + h) - residuals(problem, x - h)) / 2e-6)
    full = np.stack([*columns, r], axis=1)
    expected = full.T @ full
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(gram / scale, expected / scale, atol=1e-6)


# -------------------------------------------------------------------------------------- segments


def cut(record, count):
    edges = np.linspace(0, len(record.u), count + 1).astype(int).tolist()
    return dataclasses.replace(record, segments=tuple(pairwise(edges)))


@pytest.mark.parametrize("disturbances", [(), (OffsetOperator(np.zeros(1)),)])
@pytest.mark.parametrize("count", [4, 7])
def test_fold_equals_a_problem_of_its_rows(disturbances, count):
    data = [cut(record, count) for record in records(chain(), noise=0.05)]
    options = {"disturbances": disturbances, "fixed": FIXED}
    whole = OperatorProblem(CASES["chain"][1], data, **options)
    select = np.random.default_rng(1).random(2 * count) < 0.6
    kept = []
    for record, own in zip(data, select.reshape(2, count), strict=True):
        segments = tuple(compress(record.segments, own))
        kept.append(dataclasses.replace(record, segments=segments))
    part = OperatorProblem(CASES["chain"][1], kept, **options)
    x = whole.x0 + 0.01
    one, other = whole.total(whole.evaluate(x), select), part.total(part.evaluate(x))
    np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9 * np.abs(one).max())
    fold = variable_projection(whole, whole.x0, select=select)
    refit = variable_projection(part, part.x0)
    assert fold.cost == pytest.approx(refit.cost, rel=1e-9)
    np.testing.assert_allclose(fold.x, refit.x, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(
        whole.coefficients(whole.evaluate(fold.x), select),
        part.coefficients(part.evaluate(fold.x)),
        rtol=1e-9,
        atol=1e-12,
    )


def test_rows_outside_the_segments_do_not_count():
    record = records(chain(), noise=0.05, n_records=1)[0]
    spoiled = record.y.copy()
    spoiled[:50] = spoiled[300:] = 1e6
    problem = OperatorProblem(
        chain(), [dataclasses.replace(record, y=spoiled, segments=((50, 200), (200, 300)))]
    )
    cost = problem.total(problem.evaluate(problem.x0, jacobian=False))[-1, -1]
    operator, _ = problem.unpack(problem.x0)
    expected = problem.simulate(operator, record)[50:300] - record.y[50:300]
    assert cost == pytest.approx(expected @ expected)


def test_without_jacobian_only_the_cost():
    problem = OperatorProblem(chain(), records(chain(), noise=0.1))
    full = problem.total(problem.evaluate(problem.x0))
    alone = problem.total(problem.evaluate(problem.x0, jacobian=False))
    assert alone.shape == (1, 1)
    assert alone[0, 0] == pytest.approx(full[-1, -1])


# ---------------------------------------------------------------------------------- disturbances


@pytest.mark.parametrize(
    "disturbances",
    [
        (OffsetOperator(np.zeros(1)),),
        (DriftOperator(np.zeros(4), 4.0),),
        (DriftOperator(np.zeros(3), 4.0), SinusoidOperator(np.zeros(2), np.array([5.3]))),
    ],
    ids=["offset", "drift", "drift and line"],
)
def test_eliminated_disturbances_equal_explicit_columns(disturbances):
    """All unknowns are linear here, so the answer is one least-squares problem."""
    plays = PrandtlIshlinskiiOperator(np.array([0.0, 0.3, 0.7]), np.zeros(3), non_negative=False)
    data = records(chain(), noise=0.05, n_records=3)
    fixed = ("drive_offset", "intercept", "frequencies[0]")
    problem = OperatorProblem(plays, data, disturbances=disturbances, fixed=fixed)
    moving = np.array([name.startswith("disturbance") for name in problem.names])
    own = [plays.sensitivities(record.u, np.empty((400, 0)), DT)[1][:, :3] for record in data]
    block = np.concatenate([d.basis(DT * np.arange(400)) for d in disturbances], axis=1)
    width = block.shape[1]
    design = np.column_stack([np.concatenate(own), np.kron(np.eye(3), block)])
    y = np.concatenate([record.y for record in data])
    expected, cost, *_ = np.linalg.lstsq(design, y, rcond=None)
    if moving.any():  # the frequency would move: hold it, by solving the linear part only
        problem.lower = np.where(moving, problem.x0, problem.lower)
        problem.upper = np.where(moving, problem.x0, problem.upper)
    solution = variable_projection(problem, problem.x0)
    np.testing.assert_allclose(solution.x[~moving], expected[:3], rtol=1e-7, atol=1e-9)
    assert solution.cost == pytest.approx(cost[0], rel=1e-8)
    coefficients = problem.coefficients(problem.evaluate(solution.x))
    np.testing.assert_allclose(coefficients, expected[3:].reshape(3, width), rtol=1e-6, atol=1e-8)


def test_predictions_do_not_see_what_they_predict():
    """Offsets of held-out records come from the other half of their segments."""
    lag = FirstOrderLagOperator(0.05, gain=2.0)
    data = [cut(record, 8) for record in records(lag)]
    spoiled = data[1].y + 3.0
    spoiled[100:150] += 100.0  # segment 2
    data[1] = dataclasses.replace(data[1], y=spoiled)
    problem = OperatorProblem(lag, data, disturbances=(OffsetOperator(np.zeros(1)),))
    select = problem.segment_record == 0
    known, unknown = problem.predictions(problem.x0, select)
    np.testing.assert_allclose(known, data[0].y, atol=1e-9)
    clean, _ = lag.run(data[1].u, DT)
    np.testing.assert_allclose((unknown - clean)[:50], 3.0, atol=1e-9)  # even: from odd segments
    np.testing.assert_allclose((unknown - clean)[50:100], 3.0 + 25.0, atol=1e-9)
    np.testing.assert_allclose((unknown - clean)[100:150], 3.0, atol=1e-9)


# ------------------------------------------------------------------------------------- the solver


@pytest.mark.parametrize("value", [0.0, 10.0])
def test_linear_problem_is_solved_at_once(value):
    plays = PrandtlIshlinskiiOperator(np.array([0.0, 0.3]), np.array([1.0, 0.5]), 0.2)
    start = dataclasses.replace(
        plays, weights=np.full(2, value), intercept=-value, drive_offset=0.0
    )
    problem = OperatorProblem(start, records(plays), fixed=("drive_offset",))
    solution = variable_projection(problem, problem.x0)
    assert solution.converged
    assert solution.n_evaluations <= 2
    np.testing.assert_allclose(solution.x, [1.0, 0.5, 0.2], rtol=1e-8)


def test_bounds_hold_at_every_step():
    """The best weight is negative, so it ends at zero and the others make up for it."""
    truth = PrandtlIshlinskiiOperator(
        np.array([0.0, 0.3]), np.array([1.0, -0.4]), non_negative=False
    )
    start = PrandtlIshlinskiiOperator(np.array([0.0, 0.3]), np.zeros(2))
    problem = OperatorProblem(start, records(truth), fixed=("drive_offset",))
    x = variable_projection(problem, problem.x0).x
    assert x[1] == 0.0
    u, y = np.concatenate([(r.u, r.y) for r in problem.records], axis=1)
    slope, intercept = np.polyfit(u, y, 1)
    assert x[0] == pytest.approx(slope, rel=1e-6)
    assert x[2] == pytest.approx(intercept, abs=1e-6)


def test_a_positive_parameter_moves_by_a_bounded_factor_a_step():
    """Far from the solution the gradient tells a direction, but no distance."""
    truth, _ = CASES["mode"]
    problem = OperatorProblem(SecondOrderModeOperator(1.0, 0.9), records(truth))
    visited, evaluate = [], problem.evaluate

    def remembered(x, **options):
        visited.append(np.array(x)[problem.log])
        return evaluate(x, **options)

    problem.evaluate = remembered
    variable_projection(problem, problem.x0, max_evaluations=20)
    assert len(visited) > 3
    for i, x in enumerate(visited[1:], 1):
        assert np.abs(x - visited[:i]).max(axis=1).min() <= 1.5 + 1e-9


def test_history_and_callback_go_down():
    problem = problem_of("chain", noise=0.05)
    calls = []
    solution = variable_projection(problem, problem.x0, callback=lambda *c: calls.append(c))
    assert solution.history[1:] == calls
    evaluations, costs = zip(*solution.history, strict=True)
    assert list(evaluations) == sorted(set(evaluations))
    assert list(costs) == sorted(costs, reverse=True)
    assert evaluations[-1] <= solution.n_evaluations
    assert costs[-1] == solution.cost


@pytest.mark.parametrize("budget", [1, 2, 5])
def test_budget(budget):
    problem = problem_of("chain")
    solution = variable_projection(problem, problem.x0, max_evaluations=budget)
    assert not solution.converged
    assert "budget" in solution.message
    assert solution.n_evaluations <= max(budget, 2)


def test_known_blocks_cost_no_evaluation():
    problem = problem_of("lag")
    plain = variable_projection(problem, problem.x0)
    given = variable_projection(problem, problem.x0, blocks=problem.evaluate(problem.x0))
    np.testing.assert_allclose(given.x, plain.x, rtol=1e-9)
    assert given.n_evaluations == plain.n_evaluations - 1


def test_start_that_is_not_finite_is_given_up():
    problem = problem_of("lag")
    problem.evaluate = lambda x, **options: np.full((2, 4, 4), np.nan)
    solution = variable_projection(problem, problem.x0)
    assert solution.cost == np.inf
    assert not solution.converged
    assert predicted_cost(problem, problem.x0) == np.inf


def test_predicted_cost_is_exact_for_linear_parameters():
    plays = PrandtlIshlinskiiOperator(np.array([0.0, 0.3]), np.zeros(2), non_negative=False)
    problem = OperatorProblem(plays, records(chain(), noise=0.1), fixed=("drive_offset",))
    solution = variable_projection(problem, problem.x0)
    assert predicted_cost(problem, problem.x0) == pytest.approx(solution.cost, rel=1e-9)


def test_predicted_cost_near_the_minimum():
    truth, _ = CASES["mode"]
    problem = OperatorProblem(truth, records(truth, noise=0.05))
    best = variable_projection(problem, problem.x0)
    predicted = predicted_cost(problem, best.x + 1e-3)
    assert predicted == pytest.approx(best.cost, rel=1e-3)
    assert predicted < problem.total(problem.evaluate(best.x + 1e-3))[-1, -1]


def test_single_step_towards_the_minimum_of_a_fold():
    truth, _ = CASES["mode"]
    problem = OperatorProblem(truth, records(truth, noise=0.1, n_records=4))
    best = variable_projection(problem, problem.x0)
    blocks = problem.evaluate(best.x)
    train = np.array([True, True, True, False])
    there = variable_projection(problem, best.x, select=train, tolerance=1e-14)
    x = single_step(problem, best.x, blocks, train)
    way = np.abs(there.x - best.x)
    assert np.all(np.abs(x - there.x) <= 0.05 * way.max())


@pytest.mark.parametrize("frequency", [2.0, 50.0, 300.0])
def test_single_step_never_makes_the_fit_worse(frequency):
    """Far from the minimum the full step overshoots."""
    problem = OperatorProblem(SecondOrderModeOperator(frequency, 0.02), records(CASES["mode"][0]))
    select = np.array([True, False])
    blocks = problem.evaluate(problem.x0)
    x = single_step(problem, problem.x0, blocks, select)
    reached = problem.total(problem.evaluate(x), select)[-1, -1]
    assert reached <= problem.total(blocks, select)[-1, -1]


def test_single_step_that_leads_nowhere_is_not_taken():
    problem = problem_of("mode")
    blocks = problem.evaluate(problem.x0)
    problem.evaluate = lambda x, **options: np.full_like(blocks, np.nan)
    x = single_step(problem, problem.x0, blocks, np.ones(len(blocks), dtype=bool))
    np.testing.assert_array_equal(x, problem.x0)


class Growing:
    """Fit c exp(rate t) to a line: a step of the rate makes c's old value overshoot by far."""

    def __init__(self):
        self.time = np.linspace(0.0, 40.0, 200)
        self.y = 1.0 + self.time
        self.linear, self.log = np.array([True, False]), np.zeros(2, dtype=bool)
        self.lower, self.upper = np.full(2, -np.inf), np.full(2, np.inf)
        self.scale = self.y @ self.y

    def evaluate(self, x, select=None):
        with np.errstate(over="ignore", invalid="ignore"):
            growth = np.exp(x[1] * self.time)
            columns = np.stack([growth, x[0] * self.time * growth, x[0] * growth - self.y], axis=1)
            return (columns.T @ columns)[None]

    def total(self, blocks, select=None):
        return blocks[0]


@pytest.mark.parametrize("rate", np.linspace(-2.0, 2.0, 9))
def test_the_cost_is_that_of_the_solution(rate):
    problem = Growing()
    solution = variable_projection(problem, np.array([1.0, rate]))
    true = problem.evaluate(solution.x)[0, -1, -1]
    assert solution.cost == pytest.approx(true, rel=1e-6)


def test_a_refused_step_is_halved_at_least():
    """A step that was refused is not tried again at about the same length."""
    truth, _ = CASES["mode"]
    problem = OperatorProblem(SecondOrderModeOperator(150.0, 0.01), records(truth))
    tried, evaluate = [], problem.evaluate

    def remembered(x, **options):
        blocks = evaluate(x, **options)
        tried.append((np.array(x), problem.total(blocks)))
        return blocks

    problem.evaluate = remembered
    variable_projection(problem, problem.x0, max_evaluations=40, project=False)
    (x, gram), refused, n_refused = tried[0], None, 0
    for rival, own in tried[1:]:
        step = rival - x
        length = np.sqrt(step @ (np.diag(gram)[:-1] * step))
        if refused is not None:
            assert length <= 0.5 * refused * (1.0 + 1e-9)
        refused = None if own[-1, -1] < gram[-1, -1] else length
        n_refused += refused is not None
        x, gram = (x, gram) if refused is not None else (rival, own)
    assert n_refused > 1


def test_what_diverges_costs_infinitely_much():
    """Without a warning of its own: the fit takes another step."""
    operator, u = FirstOrderLagOperator(0.1), drive(0)
    for weights in (None, np.ones(len(u))):
        problem = OperatorProblem(operator, [RecordData(u, 1e200 * u, DT, weights=weights)])
        assert problem.total(problem.evaluate(problem.x0))[-1, -1] == np.inf
