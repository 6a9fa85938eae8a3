"""The criterion keeps its level whatever the colour of the noise, and finds what is there."""

from dataclasses import replace

import numpy as np
import pytest
import search_steps
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from skhyst.diagnosis._candidates import root_mean_square
from skhyst.diagnosis._criterion import Criterion, paired_p_value, weighted

N, RECORDS = 600, 4


def coloured(rng, correlation, n=N):
    """Draw AR(1) noise of unit variance."""
    white = np.sqrt(1.0 - correlation**2) * rng.standard_normal(n + 2000)
    return lfilter([1.0], [1.0, -correlation], white)[2000:]


def difference(kind, rng, n=N):
    """Return what the rival predicts beyond the model: of the drive, and slow."""
    phase = 2.0 * np.pi * np.arange(n) / 37.0 + rng.uniform(0.0, 6.0)
    return {
        "smooth": 0.2 * np.sin(0.2 * phase),
        "edges": 0.15 * np.sign(np.sin(phase)) + 0.05,
        "slow": 0.3 * (np.arange(n) / n - rng.uniform()),
    }[kind]


def equal_models(rng, correlation, kind, records=RECORDS):
    """Return residuals of two models that are wrong by equal and opposite amounts."""
    worse, better = [], []
    for _ in range(records):
        noise, delta = coloured(rng, correlation), difference(kind, rng)
        worse.append(noise + 0.5 * delta)
        better.append(noise - 0.5 * delta)
    return worse, better


@pytest.mark.parametrize("records", [1, RECORDS])
@pytest.mark.parametrize("kind", ["smooth", "edges", "slow"])
@pytest.mark.parametrize("correlation", [0.0, 0.6, 0.9, 0.97, 0.995])
def test_equal_models_are_told_apart_no_more_often_than_the_level(correlation, kind, records):
    trials = 300
    rng = np.random.default_rng(9000)
    p = [paired_p_value(*equal_models(rng, correlation, kind, records)) for _ in range(trials)]
    for level in (0.001, 0.01):
        margin = 3.0 * np.sqrt(level / trials) + 2.0 / trials  # of the rate that is seen
        assert np.mean(np.array(p) < level) <= level + margin


def test_white_noise_uses_the_level_up():
    """A test that never rejects would pass every calibration."""
    rng = np.random.default_rng(9001)
    p = [paired_p_value(*equal_models(rng, 0.0, "edges")) for _ in range(1000)]
    assert np.mean(np.array(p) < 0.1) == pytest.approx(0.1, abs=0.03)


@pytest.mark.parametrize("correlation", [0.0, 0.97])
def test_a_needless_parameter_is_hardly_ever_significant(correlation):
    """What a rival has learned of noise makes it worse elsewhere."""
    rng = np.random.default_rng(9002)
    rejected = 0
    for _ in range(400):
        noise = [coloured(rng, correlation) for _ in range(RECORDS)]
        deltas = [difference("smooth", rng) for _ in range(RECORDS)]
        rejected += (
            paired_p_value(noise, [e - d for e, d in zip(noise, deltas, strict=True)]) < 0.01
        )
    assert rejected <= 4


@pytest.mark.parametrize("shown", [1.0, 0.1])
@pytest.mark.parametrize("correlation", [0.0, 0.9])
def test_an_effect_is_found_also_where_it_shows_for_a_tenth_of_the_time(correlation, shown):
    rng = np.random.default_rng(9003)
    better = [coloured(rng, correlation) for _ in range(RECORDS)]
    shows = np.arange(N) < shown * N
    worse = [e + 6.0 * shows * difference("edges", rng) for e in better]
    assert paired_p_value(worse, better) < 1e-4
    assert paired_p_value(better, worse) == 1.0


def test_rest_has_no_part_in_the_decision():
    """Where both predict the same there is no evidence, however long that lasts."""
    rng = np.random.default_rng(9004)
    better = [coloured(rng, 0.5) for _ in range(RECORDS)]
    worse = [e + difference("edges", rng) for e in better]
    alone = paired_p_value(worse, better)
    rests = [100.0 * rng.standard_normal(N) for _ in range(30)]
    together = paired_p_value([*worse, *rests], [*better, *rests])
    assert 0.0 < alone < 1e-3
    assert together <= alone  # more blocks, none of which says anything against it


def test_a_gain_in_one_stretch_that_is_chance_is_no_evidence():
    """The rival happens to do well at one place, and as badly at others of its kind."""
    rng = np.random.default_rng(9005)
    worse = [coloured(rng, 0.0) for _ in range(RECORDS)]
    better = [w.copy() for w in worse]
    better[1][100:130] += 3.0 * worse[1][100:130].sum() / 90.0
    better[2][200:230] *= 0.5
    assert paired_p_value(worse, better) > 0.001


@settings(deadline=None, max_examples=50)
@given(seed=st.integers(0, 2**32 - 1), exponent=st.integers(-200, 200))
def test_unit_of_the_response_does_not_matter(seed, exponent):
    worse, better = equal_models(np.random.default_rng(seed), 0.3, "edges")
    scaled = [[2.0**exponent * e for e in own] for own in (worse, better)]
    assert paired_p_value(*scaled) == paired_p_value(worse, better)


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 2**32 - 1))
def test_order_of_records_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    worse, better = equal_models(rng, 0.5, "smooth")
    order = rng.permutation(RECORDS)
    expected = paired_p_value(worse, better)
    found = paired_p_value([worse[i] for i in order], [better[i] for i in order])
    assert found == pytest.approx(expected, rel=1e-6)


@settings(deadline=None, max_examples=50)
@given(seed=st.integers(0, 2**32 - 1))
def test_never_both_directions_are_significant(seed):
    worse, better = equal_models(np.random.default_rng(seed), 0.5, "slow")
    assert max(paired_p_value(worse, better), paired_p_value(better, worse)) == 1.0


def test_weights_count_samples_and_what_is_not_scored_does_not_count():
    rng = np.random.default_rng(9006)
    worse, better = equal_models(rng, 0.0, "edges")
    better = [0.98 * b for b in better]
    gap = rng.random(N) < 0.3
    weights = [np.where(gap, 0.0, 1.0)] * RECORDS
    holes = [np.where(gap, np.nan, w) for w in worse]
    expected = paired_p_value(holes, better)
    assert 0.0 < expected < 1.0
    assert paired_p_value(weighted(worse, weights), weighted(better, weights)) == expected


@pytest.mark.parametrize(
    ("worse", "better"),
    [([1.0] * 9, [1.0] * 9), ([0.0] * 9, [0.0] * 9), ([np.nan] * 9,) * 2, ([], [])],
    ids=["the same", "no error at all", "nothing scored", "no sample"],
)
def test_no_evidence_gives_one(worse, better):
    assert paired_p_value([np.array(worse, dtype=float)], [np.array(better, dtype=float)]) == 1.0


def contestant(cost, *residuals):
    weights = (None,) * len(residuals)
    error = root_mean_square(residuals, weights)
    own = {"residuals": residuals, "weights": weights, "error": error}
    return search_steps.candidate(None, cost=cost, **own)


def test_what_both_explain_alike_is_no_evidence():
    """The difference of the two is the instrument, whatever the models have in common."""
    rng = np.random.default_rng(9011)
    noise, delta = rng.standard_normal(2000), difference("smooth", rng, 2000)
    criterion, found = search_steps.USUAL, []
    for common in (np.zeros(2000), 50.0 * rng.standard_normal(2000)):
        base = replace(contestant(2400.0, noise + delta), explained=(common,))
        better = replace(contestant(2000.0, noise), explained=(common + delta,))
        found.append(criterion.p_value(base, better))
    assert found[0] == pytest.approx(found[1], rel=1e-6)


def test_a_better_model_is_better_held_out_and_in_the_fit():
    rng = np.random.default_rng(9010)
    noise = rng.standard_normal(2000)
    criterion = search_steps.USUAL
    base = contestant(1.2 * 2000, noise + 0.5 * difference("smooth", rng, 2000) / 0.2)
    better = contestant(1.0 * 2000, noise)
    assert criterion.is_better(base, better)
    assert not criterion.is_better(better, base)
    assert not Criterion(0.01, 0.3).is_better(base, better)  # not by enough
    assert not criterion.is_better(base, better, n_tried=1e300)


def test_every_candidate_that_was_tried_counts():
    rng = np.random.default_rng(9011)
    criterion = search_steps.USUAL
    noise = rng.standard_normal(300)
    base = contestant(400.0, noise + 0.4 * np.sign(np.sin(0.3 * np.arange(300))))
    better = contestant(300.0, noise)
    alone = criterion.p_value(base, better)
    assert criterion.p_value(base, better, 190) == pytest.approx(min(1.0, 190 * alone))


def test_models_are_told_apart_by_what_matters():
    rng = np.random.default_rng(9012)
    noise = rng.standard_normal(5000)
    criterion = search_steps.USUAL
    best = contestant(1.0, noise)
    slow = np.sin(0.1 * np.arange(5000))
    assert not criterion.is_better(contestant(1.0, noise + 0.4 * slow), best)  # by 4 %
    assert criterion.is_better(contestant(1.0, noise + 0.5 * slow), best)  # by 6 %
    assert not criterion.is_better(contestant(1.0, rng.permutation(1.06 * noise)), best)


@pytest.mark.slow
@pytest.mark.parametrize("records", [1, RECORDS])
@pytest.mark.parametrize("kind", ["smooth", "edges", "slow"])
def test_two_tests_together_keep_the_level(kind, records):
    trials, level, rng, correlation = 100, 0.01, np.random.default_rng(9020), 0.995
    criterion, rejected = Criterion(level, 0.0), 0
    for _ in range(trials):
        worse, better = equal_models(rng, correlation, kind, records)
        p_value = criterion.p_value(contestant(1.0, *worse), contestant(1.0, *better))
        rejected += p_value < level
    assert rejected / trials <= level + 3.0 * np.sqrt(level / trials) + 2.0 / trials


def test_a_quick_gain_shows_beside_slow_noise():
    """Where models differ both slowly and quickly, noise drowns the one and not the other."""
    rng = np.random.default_rng(9021)
    better = [coloured(rng, 0.97) for _ in range(RECORDS)]
    quick = 0.1 * np.sign(np.sin(np.arange(N)))
    worse = [e + quick + 0.5 * difference("smooth", rng) / 0.2 for e in better]
    p_value = Criterion(0.01, 0.0).p_value(contestant(1.0, *worse), contestant(1.0, *better))
    assert p_value < 1e-6 < paired_p_value(worse, better)


def test_what_is_weighed_out_is_in_neither_test():
    rng = np.random.default_rng(9022)
    worse, better = equal_models(rng, 0.9, "edges")
    gap = rng.random(N) < 0.1
    found = []
    for filled in (1.0, 1e3):
        own = []
        for residuals in (worse, better):
            spoilt = [np.where(gap, filled * e, e) for e in residuals]
            own.append(replace(contestant(1.0, *spoilt), weights=(1.0 - gap,) * RECORDS))
        found.append(Criterion(0.01, 0.0).p_value(*own))
    assert found[0] == found[1] < 1.0


def test_the_size_of_a_record_is_no_evidence():
    """Noise that is louder in one record does not drown what the others show."""
    rng = np.random.default_rng(9023)
    better = [size * coloured(rng, 0.9) for size in (1.0, 1.0, 1.0, 30.0)]
    quick = 0.3 * np.sign(np.sin(np.arange(N)))
    worse = [e + quick for e in better]
    p_value = Criterion(0.01, 0.0).p_value(contestant(1.0, *worse), contestant(1.0, *better))
    assert p_value < 1e-6 < paired_p_value(worse, better)


def test_the_smaller_of_two_p_values_counts_twice():
    """Where the noise has no colour there is one test."""
    rng = np.random.default_rng(9024)
    for correlation, size, factor in ((0.0, 0.2, 1.0), (0.9, 0.7, 2.0)):
        better = [coloured(rng, correlation) for _ in range(RECORDS)]
        slow = size * np.sin(np.arange(N) / 20.0)
        pair = [contestant(1.0, *own) for own in ([e + slow for e in better], better)]
        noise = pair[1].noise
        whitened = (noise.innovations(c.residuals) for c in pair)
        single = paired_p_value(*(c.residuals for c in pair)), paired_p_value(*whitened)
        assert 0.0 < min(single) < 0.3
        p_value = Criterion(0.01, 0.0).p_value(*pair)
        assert p_value == pytest.approx(factor * min(single), rel=0.2)  # sizes of records apart


def test_an_instrument_that_does_not_follow_the_difference_shows_nothing():
    """However much would be gained by what it knows: their product is what counts."""
    better = [np.full(20, 2.0)]
    worse = [np.resize([1.0, 1.2], 20)]
    against, along = ([sign * 0.01 * np.resize([1.0, 2.0], 20)] for sign in (1.0, -1.0))
    assert paired_p_value(worse, better, against) == 1.0
    assert paired_p_value(better, worse, against) < 1.0
    assert paired_p_value(better, worse, along) == 1.0
    own = [worse[0] - better[0]]
    assert paired_p_value(better, worse, [-own[0]]) == pytest.approx(paired_p_value(better, worse))
