"""A sample is never predicted from itself, and halving keeps what is worth keeping."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import search_steps
from joblib import Parallel

from skhyst.diagnosis import effect_names
from skhyst.diagnosis._candidates import (
    extrapolated,
    halve,
    halves,
    held_out_residuals,
    level_folds,
    longest_block,
)
from skhyst.diagnosis._edits import Schedule
from skhyst.disturbance import Drift, Offset, PeriodicDisturbance
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import Gain, GainOperator, SecondOrderMode, SecondOrderModeOperator
from skhyst.optimize import OperatorProblem, RecordData, predicted_cost, variable_projection


def some_records(seed, n=240, count=3, n_segments=6):
    rng = np.random.default_rng(seed)
    records = []
    for _ in range(count):
        u = np.cumsum(rng.standard_normal(n)) / 5.0
        y = u + 0.3 * np.sin(u) + rng.standard_normal() + 0.02 * rng.standard_normal(n)
        segments = tuple(pairwise(np.linspace(0, n, n_segments + 1).astype(int).tolist()))
        records.append(RecordData(u, y, 0.01, segments=segments))
    return records


def declared_with(records, *disturbances):
    declared = PrandtlIshlinskii(4)
    tree = search_steps.fitted(declared, records)
    for i, model in enumerate(disturbances):
        (start,) = model.starting_values(records)
        tree = search_steps.with_disturbance(tree, f"beside{i}", model, start)
    return tree


def record_folds(records):
    record_of = np.concatenate([np.full(len(r.segments), i) for i, r in enumerate(records)])
    return [(record_of != k, record_of == k) for k in range(len(records))]


def block_folds(records):
    block = np.arange(sum(len(r.segments) for r in records)) // 2
    return [(block != k, block == k) for k in np.unique(block)]


BESIDE = {
    "nothing": (),
    "offset": (Offset(),),
    "drift": (Drift(3),),
    "line": (PeriodicDisturbance(1),),
    "offset and line": (Offset(), PeriodicDisturbance(1)),
}


@pytest.mark.parametrize("cut", [record_folds, block_folds])
@pytest.mark.parametrize("additive", BESIDE)
def test_a_segment_is_not_predicted_from_itself(additive, cut):
    """Change samples of one segment: its own prediction stays, bit for bit."""
    records = some_records(9000, count=1 if cut is block_folds else 3)
    tree = declared_with(records, *BESIDE[additive])
    folds = cut(records)
    reference = search_steps.candidate(tree, records, folds).predictions
    rng = np.random.default_rng(9001)
    for _ in range(4):
        number = rng.integers(len(records))
        start, stop = records[number].segments[rng.integers(len(records[0].segments))]
        y = records[number].y.copy()
        y[rng.integers(start, stop)] += 3.0
        moved = list(records)
        moved[number] = replace(records[number], y=y)
        changed = search_steps.candidate(tree, moved, folds).predictions
        np.testing.assert_array_equal(changed[number][start:stop], reference[number][start:stop])


def test_a_sample_does_move_the_predictions_of_others():
    """Otherwise the test above would hold for a prediction that uses no data."""
    records = some_records(9000)
    tree, folds = declared_with(records, Offset()), record_folds(records)
    reference = search_steps.candidate(tree, records, folds).predictions
    y = records[0].y.copy()
    y[5] += 3.0
    moved = [replace(records[0], y=y), *records[1:]]
    changed = search_steps.candidate(tree, moved, folds).predictions
    start, stop = records[0].segments[1]
    assert np.all(changed[0][start:stop] != reference[0][start:stop])  # its offset
    assert np.any(changed[1] != reference[1])  # the fit of the other folds


def test_a_fold_is_the_fit_to_its_training_records():
    """Against a fit that never had the other records."""
    records = some_records(9003)
    tree = declared_with(records)
    found = search_steps.candidate(tree, records, record_folds(records))
    problem = tree.problem(records[1:])
    alone = variable_projection(problem, problem.x0, tolerance=1e-12)
    expected = tree.problem(records[:1]).predictions(alone.x, np.zeros(6, dtype=bool))[0]
    np.testing.assert_allclose(found.predictions[0], expected, atol=1e-3 * np.ptp(records[0].y))


@pytest.mark.parametrize("weighed", [False, True])
def test_errors_are_those_of_the_predictions(weighed):
    records = some_records(9004)
    weights = np.ones(240)
    if weighed:
        weights = np.random.default_rng(0).uniform(0.0, 2.0, 240)
        records = [replace(r, weights=weights) for r in records]
    found = search_steps.candidate(declared_with(records), records, record_folds(records))
    residual = np.stack([r.y for r in records]) - np.stack(found.predictions)
    np.testing.assert_array_equal(np.stack(found.residuals), residual)
    expected = np.sqrt(np.sum(weights * residual**2) / np.sum(3.0 * weights))
    assert found.error == pytest.approx(expected, rel=1e-12)


def test_what_is_not_scored_is_nan():
    records = some_records(9005, count=1)
    first = np.arange(6) == 0
    found = search_steps.candidate(declared_with(records), records, [(first, ~first)])
    start, stop = records[0].segments[0]
    assert np.isnan(found.residuals[0][start:stop]).all()
    assert np.isfinite(found.residuals[0][stop:]).all()
    assert np.isfinite(found.error)


# ------------------------------------------------------------------------------------ halving


def halved(name, tree, records):
    base = search_steps.refit(search_steps.candidate(tree, records), records)
    variants = search_steps.variants(name, tree, records)
    (found,), kept = halve([(variants, records, base.cost)], Parallel())
    assert kept == ([0] if variants else [])
    return base, found


@pytest.mark.parametrize(
    "name", ["asymmetry", "static_nonlinearity", "creep", "offset", "drift", "periodic_disturbance"]
)
def test_an_effect_that_may_do_nothing_never_makes_the_fit_worse(name):
    records = some_records(9006)
    base, found = halved(name, declared_with(records), records)
    for candidate in found:
        assert candidate.effects == (name,)
        assert candidate.n_parameters >= base.n_parameters  # an offset takes an intercept's place
        best = search_steps.refit(candidate, records)
        assert best.cost <= 1.001 * base.cost
        assert best.predicted_cost == pytest.approx(best.cost, rel=1e-3)  # nothing more to come


@pytest.mark.parametrize("budget", [1, 3])
def test_a_start_far_from_its_solution_is_judged_by_its_next_step(budget):
    records = some_records(9010)
    tree = declared_with(records)
    outputs = tree.run(records)
    ends = np.quantile(np.concatenate(outputs), [0.3, 0.8])
    bent = [replace(r, y=np.clip(v, *ends)) for r, v in zip(records, outputs, strict=True)]
    candidate, *_ = search_steps.variants("dead_zone", tree, bent)
    early = search_steps.refit(candidate, bent, max_evaluations=budget, begun=candidate.solution)
    problem = early.structure.problem(bent)
    assert early.predicted_cost < early.cost
    assert predicted_cost(problem, problem.x0) <= early.predicted_cost * (1.0 + 1e-9)  # undamped


@pytest.mark.parametrize("name", effect_names())
def test_the_cost_of_a_candidate_is_that_of_its_model(name):
    records = some_records(9006)
    _, found = halved(name, declared_with(records), records)
    for candidate in found:
        problem = candidate.structure.problem(records)
        cost = problem.total(problem.evaluate(problem.x0))[-1, -1]
        assert cost == pytest.approx(candidate.cost, rel=1e-6)


@pytest.mark.parametrize("degree", [2, 3])
def test_the_simplest_variant_that_is_true_is_claimed(degree):
    records = some_records(9007, n=480)
    tree = declared_with(records)
    rng = np.random.default_rng(9008)
    bent = []
    for record, v in zip(records, tree.run(records), strict=True):
        z = v / 10.0
        y = v + 10.0 * (0.1 * z**2 if degree == 2 else 0.1 * z**3)
        y += 0.002 * np.ptp(y) * rng.standard_normal(len(y))
        bent.append(replace(record, y=y))
    folds = record_folds(bent)
    base = search_steps.candidate(tree, bent, folds)
    contest = search_steps.contest(bent, folds, "static_nonlinearity", max_effects=1)
    stages = contest.prune(contest.grow(base)[0]).structure
    assert stages.models[stages.names.index("static_nonlinearity")].degree == degree


def test_the_effects_that_explain_most_stay_three_at_least():
    records = some_records(9009)
    disturbed = [replace(r, y=r.y + 5.0 * np.sin(0.9 * np.arange(240))) for r in records]
    tree = declared_with(records)
    names = ["asymmetry", "creep", "offset", "periodic_disturbance", "delay", "lag"]
    groups = [(search_steps.variants(name, tree, disturbed), disturbed, 1.0) for name in names]
    variants, kept = halve(groups, Parallel())
    assert len(kept) == 3
    assert names[kept[0]] == "periodic_disturbance"
    costs = [min(c.predicted_cost for c in own) for own in variants]
    assert max(costs[i] for i in kept) <= min(c for i, c in enumerate(costs) if i not in kept)


def test_what_was_estimated_from_a_record_makes_its_error_larger():
    """Akaike's factor, for ten samples that count and two values before them."""
    u = np.arange(12.0)
    record = RecordData(u, u + 1.0, 1.0, before=np.array([0.0, 0.0]))
    problem = OperatorProblem(GainOperator(1.0), [record, replace(record, before=None)])
    known, plain = held_out_residuals(problem, [u, u], [2, 2])
    np.testing.assert_allclose(known[2:], np.sqrt(12.0 / 8.0))
    np.testing.assert_allclose(plain[2:], 1.0)
    assert np.isnan(known[:2]).all()


def test_levels_are_held_out_between_others():
    """Records at one level go together, and the ends of the range are predicted by nothing."""
    u = np.arange(40.0)
    records = [
        RecordData(u, u, 1.0, segments=((0, 20), (20, 40)), schedule=level)
        for level in (1.0, 2.0, 2.01, 3.0, 1.02)
    ]
    folds = level_folds(records)
    assert len(folds) == 2
    for train, test in folds:
        assert np.flatnonzero(test).tolist() == [2, 3, 4, 5]
        np.testing.assert_array_equal(train, ~test)
    assert level_folds([records[0], records[3]]) == []


def test_what_goes_beyond_the_drive_of_its_fold():
    u = np.arange(100.0)
    record = RecordData(u, u, 1.0, segments=((0, 20), (20, 40), (40, 100)))
    inner, last = np.array([False, True, False]), np.array([False, False, True])
    assert extrapolated([record], [(~inner, inner)]) == 0.0
    assert extrapolated([record], [(~inner, inner), (~last, last)]) == 60 / 80


@pytest.mark.parametrize(("gains", "told"), [((1.0, 1.2, 1.4), True), ((1.0, 2.2, 1.4), False)])
def test_a_line_in_the_level_must_suit_the_levels_between(gains, told):
    """Blocks of every record show that gains differ, not that they are on a line."""
    records = []
    for level, gain in enumerate(gains, start=1):
        u = level * np.sin(np.arange(240) / 7.0)
        rng = np.random.default_rng([9010, level])
        segments = tuple(pairwise(range(0, 241, 40)))
        y = gain * u + 0.01 * rng.standard_normal(240)
        records.append(RecordData(u, y, 1.0, segments=segments))
    tree = search_steps.fitted(Gain(), records)
    lines = tree.edited("amplitude_dependence", Schedule("amplitude", 1.0, 3.0, "all"))
    base, candidate = (
        search_steps.refit(search_steps.candidate(own, records), records) for own in (tree, lines)
    )
    assert candidate.cost < 0.9 * base.cost  # of the fit, in either case
    contest = search_steps.contest(records, block_folds(records), "amplitude_dependence")
    assert contest._predicts_levels(candidate, base, records) == told


def test_halves_and_blocks_are_counted_record_by_record():
    records = some_records(0, count=2)
    for train, test in halves(records):
        assert np.all(train != test)
        assert test.reshape(2, 6).sum(axis=1).tolist() == [3, 3]
    assert longest_block(records, block_folds(records)) == 0.8  # of two segments
    assert longest_block(records, record_folds(records)) == np.inf


@pytest.mark.parametrize(("truth", "damping", "needed"), [(1, 1e-3, 1), (0, 1e-3, 0), (0, 0.1, 1)])
def test_a_mode_that_outlasts_a_block_predicts_half_of_the_record(truth, damping, needed):
    """Without a mode in the data the shorter ringing is only tested in blocks."""
    mode = SecondOrderModeOperator(60.0, damping)
    [record] = some_records(3, count=1)
    noise = 0.02 * np.random.default_rng(3).standard_normal(len(record.u))
    y = (mode.run(record.u, 0.01)[0] if truth else record.u) + noise
    records = [replace(record, y=y)]
    base = search_steps.fitted(Gain(), records)
    trees = base, search_steps.with_stage(base, "resonance", SecondOrderMode(), mode)
    reduced, full = (search_steps.candidate(tree, records) for tree in trees)
    contest = search_steps.contest(records, block_folds(records))
    assert contest._predicts_halves(full, "resonance", reduced) == needed
