"""As many terms as the data ask for, where they stand: found by exchange."""

import numpy as np
import pytest
import small_inputs

from skhyst.disturbance import OffsetOperator
from skhyst.hysteresis import (
    MaxwellSlip,
    PrandtlIshlinskii,
    PrandtlIshlinskiiOperator,
)
from skhyst.operators import has_weight, same_places, select_terms, with_terms
from skhyst.optimize import (
    Alone,
    OperatorProblem,
    RecordData,
    block_folds,
    exchanged,
    merged_segments,
    record_folds,
    whole_record_folds,
)

THRESHOLDS = np.array([0.0, 0.37, 1.13, 2.41])  # on no even grid
WEIGHTS = np.array([1.0, 0.7, 0.5, 0.9])


def plays(u, thresholds=THRESHOLDS, weights=WEIGHTS):
    return small_inputs.plays(u, thresholds, weights)


def wandering(seed, n=1500):
    """Return a smooth random drive that covers the range from -5 to 5."""
    u = np.convolve(np.random.default_rng(seed).normal(size=n + 59), np.ones(60), "valid")
    return 10.0 * (u - u.min()) / np.ptp(u) - 5.0


def noisy(y, noise, seed=0):
    return y + noise * np.random.default_rng([seed, 1]).normal(size=len(y))


@pytest.mark.parametrize("declared", [8, 20])
@pytest.mark.parametrize("seed", [0, 1])
def test_four_plays_are_found_where_they_are(declared, seed):
    u, noise = wandering(seed), 0.02
    records = [RecordData(u, noisy(plays(u) + 3.0, noise, seed), 1.0)]
    model = PrandtlIshlinskii(declared)
    start = model.identify(records).operator
    cut, folds = block_folds(records)
    found = exchanged(Alone(start, cut, model.held_parameters()), folds).part
    assert 4 <= found.thresholds.size <= 6
    # the standard error of a threshold, from the sensitivities at the truth
    nearest = [np.argmin(np.abs(found.thresholds - r)) for r in THRESHOLDS[1:]]
    errors = found.thresholds[nearest] - THRESHOLDS[1:]
    step = 1e-6
    columns = [np.ones_like(u)]
    for k in range(4):
        columns.append(plays(u, THRESHOLDS, np.eye(4)[k]))
    for k in range(1, 4):
        moved = THRESHOLDS + step * np.eye(4)[k]
        columns.append((plays(u, moved) - plays(u)) / step)
    covariance = noise**2 * np.linalg.inv(np.transpose(columns).T @ np.transpose(columns))
    assert np.all(np.abs(errors) < 4.0 * np.sqrt(np.diag(covariance)[-3:]))
    clean = found.run(u, 1.0)[0] - plays(u) - 3.0
    assert np.std(clean) < 0.2 * noise  # eight unknowns of 1500 samples explain 0.07 by chance


def test_the_option_finds_plays_and_stops_in_any_unit():
    u = wandering(3)
    for drive, response in ((1.0, 1.0), (1e-6, 1e3)):
        X = drive * u[:, None]
        y = response * noisy(plays(u), 1e-3)
        model = PrandtlIshlinskii(thresholds="auto").fit(X, y)
        np.testing.assert_allclose(model.thresholds_ / drive, THRESHOLDS, atol=5e-3)
        np.testing.assert_allclose(model.weights_ * drive / response, WEIGHTS, rtol=0.02)
    force = noisy(u - plays(u, np.array([1.5]), np.ones(1)), 1e-3)
    slip = MaxwellSlip(thresholds="auto", fit_damping=False).fit(u[:, None], force)
    np.testing.assert_allclose(slip.thresholds_, [1.5], atol=1e-3)
    stop = PrandtlIshlinskii(thresholds="auto").fit(u[:, None], -8.0 * force)
    assert (stop.operator_.form, stop.operator_.falling) == ("stop", True)
    np.testing.assert_allclose(stop.thresholds_, [0.0, 1.5], atol=1e-3)


def test_weights_of_either_sign_and_several_records():
    weights, drives = np.array([1.0, -0.4, 0.7, -0.2]), [wandering(4), 0.6 * wandering(5)]
    records = [RecordData(u, noisy(plays(u, weights=weights), 0.01), 1.0) for u in drives]
    model = PrandtlIshlinskii(12, non_negative=False)
    start = model.identify(records).operator
    cut, folds = block_folds(records)
    place = Alone(start, cut, model.held_parameters())
    found = exchanged(place, whole_record_folds(cut, folds)).part
    assert 4 <= found.thresholds.size <= 6
    for r, w in zip(THRESHOLDS, weights, strict=True):
        near = np.abs(found.thresholds - r) < 0.1
        assert found.weights[near].sum() == pytest.approx(w, abs=0.03)


def test_a_zero_state_and_a_fixed_intercept_are_respected():
    u = wandering(6)
    records = [RecordData(u, noisy(plays(u), 0.01), 1.0)]
    model = PrandtlIshlinskii(8, fit_intercept=False, initial_state="zero")
    start = model.identify(records).operator
    cut, folds = block_folds(records)
    found = exchanged(Alone(start, cut, model.held_parameters(), "zero"), folds).part
    assert found.intercept == 0.0
    assert 4 <= found.thresholds.size <= 6


def test_what_is_fine_enough_or_too_short_stays_as_it_is():
    u = wandering(7)
    start = PrandtlIshlinskiiOperator([0.0, 1.0], [1.0, 0.5])
    exact = [RecordData(u, start.run(u, 1.0)[0], 1.0)]
    cut, folds = block_folds(exact)
    place = Alone(start, cut, frozenset({"drive_offset"}))
    np.testing.assert_allclose(exchanged(place, folds).part.run(u, 1.0)[0], exact[0].y, atol=1e-9)
    short = [RecordData(u[:20], exact[0].y[:20], 1.0)]
    cut, folds = block_folds(short)
    assert folds == []
    place = Alone(start, cut)
    assert exchanged(place, folds) is place


def test_a_fixed_number_of_terms_changes_no_output():
    start = PrandtlIshlinskiiOperator([0.0, 2.0], [1.0, 0.5], 0.3)
    finer, further = with_terms(start, [1.0, 3.0])
    u = wandering(8)
    np.testing.assert_array_equal(further, [False, True, False, True])
    np.testing.assert_allclose(finer.run(u, 1.0)[0], start.run(u, 1.0)[0], atol=1e-12)
    back = select_terms(finer, has_weight(finer))
    assert same_places(back, start)
    assert not same_places(finer, start)


def test_blocks_and_whole_records_are_held_out():
    small, large = np.sin(np.arange(120)), 3.0 * np.sin(np.arange(120))
    records = [RecordData(u, u, 1.0) for u in (small, large, small)]
    cut, folds = block_folds(records)
    assert [len(own.segments) for own in cut] == [6, 6, 6]
    for train, test in folds:
        assert not np.any(train & test)
        assert train[[0, 6, 12]].all()
    owner = np.repeat([0, 1, 2], 6)
    whole = whole_record_folds(cut, folds)
    for train, test in whole:
        held = {i for i in (0, 1, 2) if test[owner == i].any()}
        assert len(held) == 1
        if held != {1}:  # the large one goes further than the others: its blocks are held out
            assert not train[owner == held.pop()].any()
    scored = np.sum([test for _, test in whole], axis=0)
    np.testing.assert_array_equal(scored, np.sum([test for _, test in folds], axis=0))


def test_a_record_whose_column_goes_further_is_not_held_out():
    u, heat = np.sin(np.arange(120)), np.ones((120, 1))
    records = [RecordData(u, u, 1.0, auxiliary=level * heat) for level in (0.0, 1.0, 0.5)]
    ((train, test),) = record_folds(records)
    np.testing.assert_array_equal(test, [False, False, True])
    np.testing.assert_array_equal(train, ~test)
    assert record_folds(records[:2]) == record_folds(records[:1]) == []


@pytest.mark.parametrize("additive", [(), (OffsetOperator(np.zeros(1)),)])
def test_the_power_that_a_step_leaves_is_that_of_the_predictions(additive):
    """Of a linear problem the Gram matrices tell what the predictions of its solution leave."""
    rng = np.random.default_rng(0)
    records, folds = block_folds(
        [
            RecordData(u, plays(u) + rng.normal() + 0.1 * rng.normal(size=len(u)), 1.0)
            for u in (wandering(1, 300), wandering(2, 300))
        ]
    )
    folds.append((np.arange(12) < 6, np.arange(12) >= 6))  # a whole record
    start = PrandtlIshlinskiiOperator([0.0, 1.0], [0.5, 0.1])
    held = {"drive_offset", "intercept"} if additive else {"drive_offset"}
    problem = OperatorProblem(start, records, disturbances=additive, fixed=held)
    blocks, step = problem.evaluate(problem.x0), np.array([0.1, 0.3, 0.2])[: len(problem.x0)]
    for train, test in folds:
        predictions = problem.predictions(problem.x0 + step, train)
        left = 0.0
        for i, (record, prediction) in enumerate(zip(records, predictions, strict=True)):
            for (a, b), scored in zip(record.segments, test[6 * i : 6 * i + 6], strict=True):
                left += scored * np.sum(np.square(record.y - prediction)[a:b])
        assert problem.predicted_power(blocks, step, train, test) == pytest.approx(left, rel=1e-8)


def test_segments_that_no_fold_divides_are_one():
    records = [RecordData(wandering(i, 120), wandering(i, 120), 1.0) for i in (1, 2)]
    cut, folds = block_folds(records)
    whole = [(np.arange(12) < 6, np.arange(12) >= 6), (np.arange(12) >= 6, np.arange(12) < 6)]
    merged, same = merged_segments(cut, whole)
    assert [own.segments for own in merged] == [((0, 120),), ((0, 120),)]
    np.testing.assert_array_equal(
        same, [[[True, False], [False, True]], [[False, True], [True, False]]]
    )
    merged, same = merged_segments(cut, folds)
    assert [len(own.segments) for own in merged] == [6, 6]
    np.testing.assert_array_equal(same, folds)
