"""Every method behind one front door, on problems whose solution is known."""

import dataclasses
import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import ks_2samp, kstest
from sklearn.base import clone
from sklearn.model_selection import GridSearchCV, KFold

from skhyst.hysteresis import PrandtlIshlinskiiOperator
from skhyst.linear import (
    KelvinVoigtOperator,
    SecondOrderMode,
    SecondOrderModeOperator,
)
from skhyst.optimize import (
    METHODS,
    CuckooSearch,
    DifferentialEvolution,
    LevenbergMarquardt,
    Method,
    ModifiedCuckooSearch,
    OperatorProblem,
    ParticleSwarm,
    RecordData,
    VariableProjection,
    identify,
)
from skhyst.optimize._population import PopulationMethod
from skhyst.optimize._variable_projection import restrict, search_box

DT = 0.01
TRUTH = SecondOrderModeOperator(60.0, 0.05, gain=2.0, intercept=0.3)
START = SecondOrderModeOperator(40.0, 0.2)
LOCAL = [VariableProjection, LevenbergMarquardt]
POPULATIONS = [DifferentialEvolution, ParticleSwarm, CuckooSearch, ModifiedCuckooSearch]


def record(noise=0.0, n=300, operator=TRUTH):
    rng = np.random.default_rng(0)
    u = rng.normal(size=n)
    return RecordData(u, operator.run(u, DT)[0] + noise * rng.normal(size=n), DT)


def of_kind(kind, **options):
    """Return a method, a population of few and rough."""
    rough = {"population": 10, "max_iterations": 15, "polish": False}
    return kind(**options) if kind in LOCAL else kind(**(rough | options))


@pytest.mark.parametrize("name", METHODS)
def test_every_method_finds_the_mode_and_reports_alike(name):
    kind = METHODS[name]
    method = kind() if kind in LOCAL else kind(population=12, max_iterations=15)
    # the best of several starts wins, an operator is a start as well as a pair with disturbances
    others = (1.0, 5.0, 70.0) if kind in LOCAL else (40.0,)
    starts = [(START, ()), *(SecondOrderModeOperator(w, 0.05) for w in others)]
    result = identify(starts, [record()], method=method)
    assert result.operator.natural_frequency == pytest.approx(60.0, rel=1e-6)
    assert result.converged
    assert result.operator.damping_ratio == pytest.approx(0.05, rel=1e-5)
    assert result.error < 1e-7
    assert set(result.params) == set(result.params_std)
    assert result.undetermined == ()
    assert result.condition_number > 1.0
    assert result.seconds > 0.0
    evaluations, costs = zip(*result.history, strict=True)
    assert list(evaluations) == sorted(evaluations)
    assert evaluations[-1] <= result.n_evaluations
    assert costs[-1] == min(costs)


@pytest.mark.slow
@pytest.mark.parametrize("kind", POPULATIONS)
def test_a_population_alone_comes_close(kind):
    """All four parameters are searched, as the papers do, and nothing is refined."""
    bounds = {
        "natural_frequency": (10.0, 300.0),
        "damping_ratio": (0.01, 1.0),
        "gain": (0.0, 5.0),
        "intercept": (-1.0, 1.0),
    }
    options = {"renewal": "walk"} if kind is ModifiedCuckooSearch else {}  # the accurate one
    method = kind(
        population=30, max_iterations=150, project=False, polish=False, bounds=bounds, **options
    )
    data = record()
    result = identify([START], [data], method=method)
    assert result.error < 0.05 * np.std(data.y)
    for name, (low, high) in bounds.items():
        assert low <= result.params[name] <= high


@pytest.mark.parametrize("kind", POPULATIONS)
def test_evaluations_are_counted_and_limited(kind):
    calls = []

    class Counted(SecondOrderModeOperator):
        def run(self, u, dt, state=None):
            calls.append(1)
            return super().run(u, dt, state)

    method = of_kind(kind, max_evaluations=57, max_iterations=300, project=False)
    result = identify([Counted(40.0, 0.2)], [record()], method=method)
    # one for the box, one for the standard errors; summarize and sensitivities add their own
    assert result.n_evaluations == 57 + 2
    assert 57 <= len(calls) <= 57 + 4


@pytest.mark.parametrize("kind", POPULATIONS)
def test_same_seed_same_result_and_another_seed_another(kind):
    def found(seed):
        method = of_kind(kind, max_iterations=4, random_state=seed)
        return identify([START], [record(0.1)], method=method).x

    np.testing.assert_array_equal(found(1), found(1))
    assert np.any(found(1) != found(2))


@pytest.mark.parametrize("kind", [*LOCAL, *POPULATIONS])
def test_a_callback_ends_the_search_and_keeps_the_best(kind, capsys):
    seen = []

    def stop(n_evaluations, cost):
        seen.append((n_evaluations, cost))
        return len(seen) == 2

    method = of_kind(kind, callback=stop, verbose=1)
    result = identify([START], [record(0.1)], method=method)
    assert len(seen) == 2
    assert result.error**2 * 300 <= seen[-1][1] * (1.0 + 1e-9)
    assert kind.__name__ in capsys.readouterr().err


@pytest.mark.parametrize("kind", [*LOCAL, *POPULATIONS])
def test_bounds_hold(kind):
    bounds = {"damping_ratio": (0.1, 0.5)}
    polish = {} if kind in LOCAL else {"polish": True}
    result = identify([START], [record()], method=of_kind(kind, bounds=bounds, **polish))
    assert result.operator.damping_ratio == pytest.approx(0.1)
    assert np.isnan(result.params_std["damping_ratio"])


@pytest.mark.parametrize(
    ("bounds", "message"),
    [
        ({"damping": (0.1, 0.5)}, "'damping', which is not among"),
        ({"gain": (2.0, 1.0)}, "no value"),
    ],
)
def test_wrong_bounds_are_refused(bounds, message):
    with pytest.raises(ValueError, match=message):
        identify([START], [record()], method=VariableProjection(bounds=bounds))


def test_bounds_narrow_those_of_the_model():
    creep = KelvinVoigtOperator(np.array([0.2]), np.array([0.1]))
    problem = OperatorProblem(creep, [record()])
    restrict(problem, {"compliances[0]": (-1.0, 0.5), "time_constants[0]": (-1.0, 10.0)})
    assert (problem.lower[0], problem.upper[0]) == (0.0, 0.5)
    assert (problem.lower[1], problem.upper[1]) == (-np.inf, np.log(10.0))


def test_a_far_start_needs_random_ones():
    """A hundred Hz off, gradients lead to the wrong place; seeded random starts mend it."""
    lightly = SecondOrderModeOperator(250.0, 0.01, gain=2.0)
    data = [record(0.01, 600, lightly)]
    poor = [SecondOrderModeOperator(1.0, 0.9)]
    assert identify(poor, data).error > 0.5 * np.std(data[0].y)
    method = VariableProjection(n_random_starts=40, bounds={"natural_frequency": (1.0, 300.0)})
    result = identify(poor, data, method=method)
    assert result.operator.natural_frequency == pytest.approx(250.0, rel=1e-3)
    assert result.error == pytest.approx(0.01, rel=0.1)


def test_linear_problems_need_no_population():
    plays = PrandtlIshlinskiiOperator(np.array([0.0, 0.5]), np.zeros(2))
    truth = PrandtlIshlinskiiOperator(np.array([0.0, 0.5]), np.array([1.0, 0.3]))
    data = [record(operator=truth)]
    result = identify([(plays, ())], data, fixed=("drive_offset",), method="particle_swarm")
    np.testing.assert_allclose(result.operator.weights, truth.weights, atol=1e-9)
    assert result.n_evaluations < 5


def test_the_box_holds_the_starts_and_follows_the_unit():
    data = record()
    problems = [OperatorProblem(SecondOrderModeOperator(w, 0.2), [data]) for w in (20.0, 90.0)]
    lower, upper = search_box(problems)
    for problem in problems:
        assert np.all((lower <= problem.x0) & (problem.x0 <= upper))
    scaled = dataclasses.replace(data, y=1e-9 * data.y)
    tiny = SecondOrderModeOperator(20.0, 0.2, gain=1e-9)
    low, high = search_box([OperatorProblem(tiny, [scaled])])
    names = problems[0].names
    gain = names.index("gain")
    assert high[gain] - low[gain] < 1e-7
    restrict(problems[0], {"gain": (0.5, 3.0)})
    lower, upper = search_box(problems)
    assert (lower[gain], upper[gain]) == (0.5, 3.0)


def test_schedules_of_the_modified_search():
    """Xie et al. (2023), (9) and (10), with p in [0, 1] and the step in [0.5, 2]."""
    schedule = ModifiedCuckooSearch()._schedule
    np.testing.assert_allclose(schedule(0.0), (1.0, 2.0))
    np.testing.assert_allclose(schedule(1.0), (np.exp(-5.0), 0.5))
    np.testing.assert_allclose(schedule(0.5), (np.exp(-0.625), 1.0))


@pytest.fixture(scope="module")
def cuckoos():
    """Return the nests and, where none is better, where they fly and what is discovered."""
    seen = []

    def flat(candidates):
        seen.append(candidates.copy())
        return np.zeros(len(candidates))

    ends = np.full(50, -1.0), np.full(50, 1.0)
    method = CuckooSearch(population=20_000, max_iterations=1, discovery=0.3)
    method._search(flat, *ends, np.random.default_rng(0))
    return seen


def test_flights_are_those_of_levy(cuckoos):
    """Mantegna's quotient for the exponent 1.5, whose scale is 0.6966 (Yang and Deb 2009)."""
    nests, flown, _ = cuckoos
    best = nests[0]
    # short steps from the middle, which the ends of the box do not cut off
    short = (np.abs(nests - best) < 0.02) & (np.abs(nests) < 0.5) & (nests != best)
    steps = np.clip((flown - nests)[short] / (nests - best)[short], -25.0, 25.0)
    u, v = np.random.default_rng(1).normal(size=(2, 200_000))
    expected = np.clip(0.6966 * u / np.abs(v) ** (2.0 / 3.0), -25.0, 25.0)
    assert len(steps) > 3000
    assert ks_2samp(steps, expected).pvalue > 1e-3


def test_a_coordinate_is_discovered_with_its_probability(cuckoos):
    nests, _, discovered = cuckoos
    assert np.mean(discovered != nests) == pytest.approx(0.3, abs=0.005)


@pytest.mark.parametrize("discovery", [0.3, 1.0])
def test_a_discovered_nest_is_left_for_a_new_one(discovery):
    """Step 5 of Xie et al. (2023): anywhere in the box, whatever its cost; the best stays."""
    seen = []

    def rising(candidates):  # the first is the best, and whoever comes later is worse
        seen.append(candidates.copy())
        return np.arange(len(candidates)) + 1e6 * len(seen)

    n = 20_000
    method = CuckooSearch(
        population=n, max_iterations=2, renewal="random", discovery=discovery, step=0.0
    )
    method._search(rising, np.full(3, -1.0), np.full(3, 1.0), np.random.default_rng(0))
    before, _, new, after, _ = seen  # without a step a flight ends where it began
    left = (after != before).all(axis=1)
    np.testing.assert_array_equal(after[left], new)
    np.testing.assert_array_equal(after[~left], before[~left])
    assert not left[0]
    assert left[1:].mean() == pytest.approx(discovery, abs=0.01)
    assert kstest(new.ravel(), "uniform", args=(-1.0, 2.0)).pvalue > 1e-3


def test_a_new_nest_is_judged_by_its_own_cost():
    """It gives way to what is better than it, if worse than the nest that was left for it."""
    seen = []

    class Staged(CuckooSearch):
        def _schedule(self, progress):  # all nests are new after the first flight, none later
            return float(progress < 0.5), float(progress < 0.9)

    def costs(candidates):  # at first, flown, new, flown
        seen.append(candidates.copy())
        return np.full(len(candidates), [0.0, 1.0, 2.0, 1.0, 9.0, 9.0, 9.0][len(seen) - 1])

    method = Staged(population=10, max_iterations=3, renewal="random")
    method._search(costs, np.full(2, -1.0), np.full(2, 1.0), np.random.default_rng(0))
    np.testing.assert_array_equal(seen[5][1:], seen[3][1:])


def test_renewals_are_two():
    assert ModifiedCuckooSearch().renewal == "random"
    assert CuckooSearch().renewal == "walk"
    with pytest.raises(ValueError, match="'renewal' parameter of CuckooSearch must be"):
        CuckooSearch(renewal="none")


def test_methods_are_values():
    method = ParticleSwarm(population=7)
    assert method == ParticleSwarm(population=7)
    assert pickle.loads(pickle.dumps(method)) == method
    assert issubclass(ParticleSwarm, PopulationMethod)
    assert issubclass(PopulationMethod, Method)
    with pytest.raises(dataclasses.FrozenInstanceError):
        method.population = 8
    model = SecondOrderMode(method=method)
    assert clone(model).get_params()["method"] == method


@pytest.mark.filterwarnings("ignore:The records do not begin at rest")  # those of folds
def test_grid_search_over_methods():
    data = record(0.01)
    methods = ["variable_projection", ParticleSwarm(population=8, max_iterations=5)]
    search = GridSearchCV(SecondOrderMode(dt=DT), {"method": methods}, cv=KFold(2))
    search.fit(data.u.reshape(-1, 1), data.y)
    assert np.ptp(search.cv_results_["mean_test_score"]) < 1e-3
    assert search.best_score_ > 0.9


def test_an_unknown_method_is_refused_by_name():
    with pytest.raises(ValueError, match="'method' parameter of SecondOrderMode"):
        SecondOrderMode(method="bees").fit(np.zeros((9, 1)), np.zeros(9))


def test_levenberg_marquardt_counts_epochs_and_moves_its_damping():
    """The damping falls by a tenth after each epoch, and rises tenfold for each step refused."""
    result = identify([START], [record(0.1)], method="levenberg_marquardt")
    mu, costs = np.array(result.damping), np.array([cost for _, cost in result.history])
    assert len(mu) == len(costs)
    assert mu[0] == LevenbergMarquardt().mu
    assert np.all(np.diff(costs) < 0.0)
    refused = np.diff([n for n, _ in result.history]) - 1
    np.testing.assert_allclose(mu[1:] / mu[:-1], 0.1 * 10.0**refused, rtol=1e-12)
    few = identify([START], [record()], method=LevenbergMarquardt(max_epochs=2))
    assert len(few.history) == 3
    goal = identify([START], [record()], method=LevenbergMarquardt(goal=1e-3))
    power = np.sum(record().y ** 2)
    assert goal.history[-1][1] <= 1e-3 * power < goal.history[-2][1]


@pytest.mark.filterwarnings("ignore:The records do not begin at rest")  # those of folds
@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ConvergenceWarning")  # of a limit of 1
@pytest.mark.parametrize(
    ("method", "limit"),
    [
        (ParticleSwarm(population=8, max_iterations=3, polish=False), "max_iterations"),
        (VariableProjection(max_evaluations=3), "max_evaluations"),
    ],
    ids=lambda given: type(given).__name__,
)
def test_a_grid_over_what_a_method_is_given(method, limit):
    """A search sets parameters of the method of its own copy of a model, by name."""
    data = record(0.01)
    model = SecondOrderMode(dt=DT, method=method)
    search = GridSearchCV(model, {f"method__{limit}": [1, 9]}, cv=KFold(2))
    search.fit(data.u[:, None], data.y)
    assert search.best_params_ == {f"method__{limit}": 9}
    assert search.best_estimator_.method == replace(method, **{limit: 9})
    assert getattr(model.method, limit) == 3
    names = {f"method__{own.name}" for own in dataclasses.fields(method)}
    assert names < set(model.get_params())


@pytest.mark.parametrize("kind", METHODS.values())
def test_parameters_of_a_method(kind):
    method = kind()
    assert kind(**method.get_params()) == method
    assert clone(method) == method
    assert method.set_params(verbose=1) is method
    assert method == kind(verbose=1)
    with pytest.raises(ValueError, match="'populations' instead"):
        method.set_params(populations=3)


def test_a_parameter_that_is_set_is_checked():
    method = CuckooSearch()
    with pytest.raises(ValueError, match="'renewal' parameter of CuckooSearch must be"):
        method.set_params(renewal="none")
    assert method == CuckooSearch()
