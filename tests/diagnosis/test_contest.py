"""The paired test keeps its level, and a sample is never predicted from itself."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from joblib import Parallel
from scipy.signal import lfilter
from scipy.stats import ttest_1samp

from skhyst.diagnosis import effect_names
from skhyst.diagnosis._contest import (
    Contestant,
    contest,
    held_out,
    independent_share,
    paired_p_value,
    screen,
)
from skhyst.diagnosis._effects import EFFECTS
from skhyst.diagnosis._structure import Structure
from skhyst.disturbance import Drift, Offset, PeriodicDisturbance
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.optimize import RecordData, variable_projection

N_RECORDS, N_SEGMENTS = 5, 32


def losses(rng, correlation, advantage=0.0, groups=N_RECORDS, segments=N_SEGMENTS):
    """Draw sums of squares of two models whose logarithmic difference is AR(1) within a record."""
    noise = rng.standard_normal((groups, segments + 200))
    ar = lfilter([np.sqrt(1.0 - correlation**2)], [1.0, -correlation], noise)[:, 200:].ravel()
    common = np.exp(rng.standard_normal(ar.size))  # segments differ a lot in size
    worse, better = common * np.exp(0.2 * ar), common * np.exp(-0.2 * ar - advantage)
    return worse, better, np.repeat(np.arange(groups), segments)


@pytest.mark.parametrize("correlation", [0.0, 0.3, 0.6, 0.8])
def test_equal_models_are_told_apart_no_more_often_than_the_level(correlation):
    trials = 2000
    p = [paired_p_value(*losses(np.random.default_rng(i), correlation)) for i in range(trials)]
    for level in (0.01, 0.05):
        margin = 3.0 * np.sqrt(level * (1.0 - level) / trials)  # standard errors of the rate
        assert np.mean(np.array(p) < level) <= level + margin


@pytest.mark.parametrize(("groups", "segments"), [(1, 30), (3, 10)])
def test_level_holds_for_short_recordings(groups, segments):
    p = [
        paired_p_value(*losses(np.random.default_rng(i), 0.3, 0.0, groups, segments))
        for i in range(2000)
    ]
    assert np.mean(np.array(p) < 0.01) <= 0.01 + 3.0 * np.sqrt(0.01 / 2000)


def test_independent_losses_use_the_level_up():
    """A test that never rejects would pass every calibration."""
    p = np.array([paired_p_value(*losses(np.random.default_rng(i), 0.0)) for i in range(2000)])
    assert np.mean(p < 0.05) > 0.02


def test_a_better_model_is_found_and_a_worse_one_is_not():
    rng = np.random.default_rng(9000)
    worse, better, groups = losses(rng, 0.3, advantage=0.3)
    assert paired_p_value(worse, better, groups) < 1e-3
    assert paired_p_value(better, worse, groups) > 1.0 - 1e-3


def test_an_effect_that_some_stretches_do_not_show_is_found():
    worse, better, groups = losses(np.random.default_rng(9000), 0.0)
    shown = np.arange(len(worse)) % N_SEGMENTS < 0.6 * N_SEGMENTS  # hangs together
    assert paired_p_value(np.where(shown, 50.0 * worse, worse), better, groups) < 1e-3


def test_candidates_that_remove_the_same_are_one_test():
    rng = np.random.default_rng(9000)
    own = [rng.standard_normal(200) for _ in range(6)]
    alike = [own[0] + 1e-6 * gain for gain in own]
    assert independent_share(own) == pytest.approx(1.0, abs=0.2)
    assert independent_share(alike) == pytest.approx(1.0 / 6.0, rel=0.01)
    assert independent_share(own[:1]) == independent_share([]) == 1.0


@settings(deadline=None, max_examples=50)
@given(seed=st.integers(0, 2**32 - 1), exponent=st.integers(-200, 200))
def test_unit_of_the_response_does_not_matter(seed, exponent):
    worse, better, groups = losses(np.random.default_rng(seed), 0.3, 0.05)
    scale = 2.0**exponent
    assert paired_p_value(scale * worse, scale * better, groups) == paired_p_value(
        worse, better, groups
    )


@settings(deadline=None, max_examples=50)
@given(seed=st.integers(0, 2**32 - 1))
def test_never_both_directions_are_significant(seed):
    worse, better, groups = losses(np.random.default_rng(seed), 0.5, 0.02)
    both = paired_p_value(worse, better, groups) + paired_p_value(better, worse, groups)
    assert both >= 1.0 - 1e-12


def test_an_effect_that_shows_more_in_one_record_is_found():
    worse, better, groups = losses(np.random.default_rng(9003), 0.5, advantage=0.1)
    better[groups > 0] *= 0.1
    assert paired_p_value(worse, better, groups) < 1e-6


def test_records_that_hang_together_are_compared_as_wholes():
    """Thirty segments of one record are then no more than one observation."""
    slow = np.repeat([0.9, 0.85, 0.95, 0.8, 0.9], N_SEGMENTS) + np.tile(
        np.linspace(-0.05, 0.05, N_SEGMENTS), N_RECORDS
    )
    groups = np.repeat(np.arange(N_RECORDS), N_SEGMENTS)
    assert paired_p_value(1.0 + slow, 1.0 - slow, groups) == pytest.approx(
        ttest_1samp([0.9, 0.85, 0.95, 0.8, 0.9], 0.0, alternative="greater").pvalue
    )


def test_one_segment_cannot_decide():
    """However bad one model is in one segment, it is one difference of one among many."""
    worse, better, groups = losses(np.random.default_rng(9001), 0.0)
    worse[7] = 1e12 * better[7]
    assert paired_p_value(worse, better, groups) > 0.05


def test_segments_that_were_not_scored_do_not_count():
    worse, better, groups = losses(np.random.default_rng(9002), 0.2, 0.05)
    expected = paired_p_value(worse, better, groups)
    gap = np.concatenate([worse[:32], [np.nan], worse[32:]])
    other = np.concatenate([better[:32], [1.0], better[32:]])
    assert paired_p_value(gap, other, np.insert(groups, 32, 0)) == expected


@pytest.mark.parametrize(
    ("worse", "better"),
    [([2.0, 2.0], [1.0, 1.0]), ([1.0] * 9, [1.0] * 9), ([0.0] * 9, [0.0] * 9), ([np.nan] * 9,) * 2],
    ids=["two segments", "the same", "no error at all", "nothing scored"],
)
def test_no_evidence_gives_one(worse, better):
    assert paired_p_value(np.array(worse), np.array(better), np.zeros(len(worse), int)) == 1.0


# --------------------------------------------------------------------------- held-out prediction


def some_records(seed, n=240, count=3, n_segments=6):
    rng = np.random.default_rng(seed)
    records = []
    for _ in range(count):
        u = np.cumsum(rng.standard_normal(n)) / 5.0
        y = u + 0.3 * np.sin(u) + rng.standard_normal() + 0.02 * rng.standard_normal(n)
        segments = tuple(pairwise(np.linspace(0, n, n_segments + 1).astype(int).tolist()))
        records.append(RecordData(u, y, 0.01, segments=segments))
    return records


def contestant_of(structure, records):
    problem = structure.problem(records)
    return Contestant("", structure, np.inf, len(problem.x0), problem.x0)


def declared_with(records, *disturbances):
    declared = PrandtlIshlinskii(4)
    structure = Structure.from_result(declared, declared._identify(records))
    for i, model in enumerate(disturbances):
        disturbance = model._disturbances(records)[0]
        structure = structure.beside(f"beside{i}", model, disturbance)
    return structure


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
@pytest.mark.parametrize("beside", BESIDE)
def test_a_segment_is_not_predicted_from_itself(beside, cut):
    """Change samples of one segment: its own prediction stays, bit for bit."""
    records = some_records(9000, count=1 if cut is block_folds else 3)
    structure = declared_with(records, *BESIDE[beside])
    folds = cut(records)
    reference = held_out(contestant_of(structure, records), records, folds).predictions
    rng = np.random.default_rng(9001)
    for _ in range(4):
        number = rng.integers(len(records))
        start, stop = records[number].segments[rng.integers(len(records[0].segments))]
        y = records[number].y.copy()
        y[rng.integers(start, stop)] += 3.0
        moved = list(records)
        moved[number] = RecordData(records[number].u, y, 0.01, segments=records[number].segments)
        changed = held_out(contestant_of(structure, moved), moved, folds).predictions
        np.testing.assert_array_equal(changed[number][start:stop], reference[number][start:stop])


def test_a_sample_does_move_the_predictions_of_others():
    """Otherwise the test above would hold for a prediction that uses no data."""
    records = some_records(9000)
    structure = declared_with(records, Offset())
    folds = record_folds(records)
    reference = held_out(contestant_of(structure, records), records, folds).predictions
    y = records[0].y.copy()
    y[5] += 3.0
    moved = [RecordData(records[0].u, y, 0.01, segments=records[0].segments), *records[1:]]
    changed = held_out(contestant_of(structure, moved), moved, folds).predictions
    start, stop = records[0].segments[1]
    assert np.all(changed[0][start:stop] != reference[0][start:stop])  # its offset
    assert np.any(changed[1] != reference[1])  # the fit of the other folds


def test_a_fold_is_the_fit_to_its_training_records():
    """Against a fit that never had the other records."""
    records = some_records(9003)
    structure = declared_with(records)
    found = held_out(contestant_of(structure, records), records, record_folds(records))
    problem = structure.problem(records[1:])
    alone = variable_projection(problem, problem.x0, tolerance=1e-12)
    expected = structure.problem(records[:1]).predictions(alone.x, np.zeros(6, dtype=bool))[0]
    np.testing.assert_allclose(found.predictions[0], expected, atol=1e-3 * np.ptp(records[0].y))


def test_errors_are_those_of_the_predictions():
    records = some_records(9004)
    found = held_out(contestant_of(declared_with(records), records), records, record_folds(records))
    y = np.concatenate([r.y for r in records])
    residual = y - np.concatenate(found.predictions)
    np.testing.assert_array_equal(np.concatenate(found.residuals), residual)
    assert found.error == pytest.approx(np.sqrt(np.mean(residual**2)), rel=1e-12)
    np.testing.assert_allclose(found.squared_errors, np.sum(residual.reshape(18, -1) ** 2, axis=1))


def test_what_is_not_scored_is_nan():
    records = some_records(9005, count=1)
    everything = np.ones(6, dtype=bool)
    first = np.arange(6) == 0
    found = held_out(
        contestant_of(declared_with(records), records), records, [(everything & ~first, ~first)]
    )
    start, stop = records[0].segments[0]
    assert np.isnan(found.residuals[0][start:stop]).all()
    assert np.isfinite(found.residuals[0][stop:]).all()
    assert np.isfinite(found.error)


# --------------------------------------------------------------------------- screening and contest


@pytest.mark.parametrize(
    "name", ["asymmetry", "static_nonlinearity", "creep", "offset", "drift", "periodic_disturbance"]
)
def test_an_effect_that_may_do_nothing_never_makes_the_fit_worse(name):
    records = some_records(9006)
    structure = declared_with(records)
    base = contestant_of(structure, records)
    cost = variable_projection(structure.problem(records), base.x).cost
    screened = screen(EFFECTS[name], [structure], records)
    refitted = contest([screened], records, Parallel(), lambda c: True)[0]
    assert refitted.effect == name
    assert refitted.cost <= 1.001 * cost
    assert refitted.n_parameters > base.n_parameters


@pytest.mark.parametrize("name", effect_names())
def test_screening_promises_what_it_has_reached(name):
    """The cost that orders the candidates is that of a model that stands in the list."""
    records = some_records(9006)
    structure = declared_with(records)
    screened = screen(EFFECTS[name], [structure], records)
    if not screened.beginnings:  # it has no place in plays alone
        return
    best = next(c for starts in screened.beginnings[0] for c in starts if c.cost == screened.cost)
    problem = best.structure.problem(records)
    cost = problem.total(problem.evaluate(best.x))[-1, -1]
    assert cost == pytest.approx(screened.cost, rel=1e-6)


@pytest.mark.parametrize("degree", [2, 3])
def test_the_contest_takes_the_simplest_variant_that_is_true(degree):
    records = some_records(9007, n=480)
    structure = declared_with(records)
    rng = np.random.default_rng(9008)
    bent = []
    for record, v in zip(records, structure.run(records), strict=True):
        z = v / 10.0
        y = v + 10.0 * (0.1 * z**2 if degree == 2 else 0.1 * z**3)
        y += 0.002 * np.ptp(y) * rng.standard_normal(len(y))
        bent.append(RecordData(record.u, y, record.dt, segments=record.segments))
    screened = screen(EFFECTS["static_nonlinearity"], [structure], bent)
    chosen = contest([screened], bent, Parallel(), lambda c: True)[0]
    curve = chosen.structure.models[chosen.structure.names.index("static_nonlinearity")]
    assert curve.degree == degree


def test_a_variant_that_is_not_plausible_leaves_the_effect_to_another():
    records = some_records(9007, n=480)
    time = np.arange(480) * records[0].dt
    lines = sum(np.sin(2 * np.pi * n * time / (480 * records[0].dt)) for n in (17.3, 31.9, 60.7))
    disturbed = [replace(record, y=record.y + lines) for record in records]
    screened = [screen(EFFECTS["periodic_disturbance"], [declared_with(records)], disturbed)]

    def count(c):
        return len(c.structure.disturbances[-1].frequencies)

    for most in (3, 2, 1):
        (chosen,) = contest(screened, disturbed, Parallel(), lambda c, m=most: count(c) <= m)
        assert count(chosen) == most
        assert [count(c) for c in chosen.simpler] == list(range(most - 1, 0, -1))
    assert contest(screened, disturbed, Parallel(), lambda c: False) == []
