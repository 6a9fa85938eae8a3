"""What the small parts of the search decide by: a theorem each, on signals made for it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from skhyst.diagnosis import EFFECTS, _open_questions, _structure
from skhyst.diagnosis._candidates import Candidate
from skhyst.diagnosis._changes import _before, _differ
from skhyst.diagnosis._claim import Claim
from skhyst.diagnosis._constants import FLAT, LAGS, PLAYS, REPEATS, SLOW
from skhyst.diagnosis._contest import Contest
from skhyst.diagnosis._criterion import Criterion
from skhyst.diagnosis._edits import Drive
from skhyst.diagnosis._location import locate
from skhyst.diagnosis._open_questions import Intervals
from skhyst.diagnosis._periods import drive_period, near_period, turns
from skhyst.diagnosis._plausibility import has_own_lines, levels_off, stops
from skhyst.diagnosis._starts import starting_trees
from skhyst.diagnosis._structure import (
    N_PRESENT,
    Trial,
    _driven,
    _own,
    _settled,
    _wiped,
    by_black_boxes,
    by_shifted_drive,
    in_repetitions,
    moved,
    past_mean,
    repeatability,
)
from skhyst.diagnosis._tree import Tree
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import Gain, GainOperator
from skhyst.noise import NoiseModel
from skhyst.noise._block_test import _autocovariance
from skhyst.optimize import RecordData
from skhyst.records import RecordSlice, Units
from skhyst.static import SoftSaturationOperator


@pytest.mark.parametrize("period", [2, 3, 4, 5, 17])
def test_the_period_of_a_drive_is_its_shortest(period):
    drive = np.random.default_rng(period).normal(size=period)
    assert drive_period(np.tile(drive, 6)) == period


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("odd", [0.0, 0.3])
def test_a_rough_period_is_neither_a_multiple_nor_a_half_that_repeats_worse(odd, seed):
    """With an odd harmonic, half a period repeats all but that."""
    n, period = 500, 100 if odd else 50
    turn = 2 * np.pi * np.arange(n) / 100
    u = np.sin(2.0 * turn) + odd * np.sin(turn)
    u += 0.05 * np.random.default_rng(seed).normal(size=n)
    assert near_period(u) == pytest.approx(period, rel=0.01)


def test_a_drive_that_does_not_come_back_has_no_rough_period():
    assert near_period(np.linspace(0.0, 1.0, 200)) == 0
    assert near_period(np.random.default_rng(0).normal(size=200)) == 0
    assert near_period(np.ones(200)) == 0


@pytest.mark.parametrize(("ripple", "expected"), [(0.02, [50, 150]), (0.2, [25, 30, 50, 150])])
def test_a_drive_turns_where_it_reverses_by_more_than_a_twentieth_of_its_range(ripple, expected):
    corners = [(0, 0.0), (25, 0.5), (30, 0.5 - ripple), (50, 1.0), (150, -1.0), (200, 0.0)]
    u = np.interp(np.arange(201), *zip(*corners, strict=True))
    np.testing.assert_array_equal(turns(u), expected)


@pytest.mark.parametrize(("first", "second", "expected"), [(20, 60, 60), (60, 20, 60), (20, 90, 0)])
def test_a_memory_is_wiped_out_once_both_ends_are_reached(first, second, expected):
    """It is borne where less than a quarter of the record would be left."""
    u = np.zeros(100)
    u[first], u[second] = 1.0, -1.0
    assert _wiped(u) == expected
    assert _wiped(-u) == expected
    assert _wiped(5.0 + u) == expected


@pytest.mark.parametrize("n", [20, 64, 1000])
def test_stationary_noise_between_repetitions_counts_whole(n):
    """All of it counts, but for the freedom of a cubic drift."""
    noise = np.random.default_rng(0).permutation(np.resize([1.0, -1.0], n))
    power, freedom = _settled(noise)
    assert freedom == n - SLOW - 1
    time = np.linspace(-1.0, 1.0, n)
    rest = noise - np.polynomial.Polynomial.fit(time, noise, 3)(time)
    assert power == pytest.approx(rest @ rest)


@pytest.mark.parametrize("n", [24, 160])
def test_how_a_repetition_began_does_not_count(n):
    """A transient in the first sixteenth of the difference goes with it, and no more."""
    noise = np.random.default_rng(1).permutation(np.resize([1.0, -1.0], n))
    begun = noise.copy()
    size = n // 16
    begun[:size] += 100.0
    power, freedom = _settled(begun)
    assert (power, freedom) == (pytest.approx(_settled(noise[size:])[0]), n - size - SLOW - 1)


def test_rounding_between_repetitions_is_no_start():
    difference = np.zeros(160)
    difference[:3] = 2.0**-52
    difference[80] = 1.0
    assert _settled(difference)[1] == 160 - SLOW - 1


@pytest.mark.parametrize("common", [0.0, 0.5, 1.0])
def test_what_repetitions_have_in_common_is_a_part_of_the_power(common):
    q = np.linalg.qr(np.random.default_rng(0).normal(size=(300, 3)))[0].T
    both, first, second = np.sqrt(300.0) * q  # power one, none is seen in another
    residuals = [np.sqrt(common) * both + np.sqrt(1.0 - common) * own for own in (first, second)]
    rows = slice(0, 300)
    trial = in_repetitions([(0, rows, 1, rows)], residuals, 1.0)
    assert trial.share == pytest.approx(1.0 - common)
    assert np.mean(np.square(trial.left[0])) == pytest.approx(1.0 - common)
    opposite = in_repetitions([(0, rows, 1, rows)], [both, -both], 1.0)
    assert opposite.share == 1.0


def test_black_boxes_of_several_intervals_are_a_family(monkeypatch):
    """The p-value is Bonferroni's, and shares count by the power that they are of."""
    found = iter([Trial(0.5, 0.001, ["a"]), Trial(0.9, 0.7, ["b"])])
    monkeypatch.setattr(_structure, "_by_black_box", lambda *_: next(found))
    u = np.arange(10.0)
    records = [RecordData(u, u, dt) for dt in (0.1, 0.2)]
    residuals = [np.full(10, 1.0), np.full(10, np.sqrt(3.0))]
    trial = by_black_boxes(records, residuals, [u, u], None, None)
    assert trial.p_value == pytest.approx(0.002)
    assert trial.share == pytest.approx(0.25 * 0.5 + 0.75 * 0.9)
    assert trial.left == ["a", "b"]
    found = iter([Trial(1.0, 0.6, []), Trial(1.0, 0.7, [])])
    assert by_black_boxes(records, residuals, [u, u], None, None).p_value == 1.0


def test_a_rest_before_a_record_changes_nothing_that_a_black_box_sees_of_its_drive():
    """A device rests at the first value of its drive until the record begins."""
    rng, n = np.random.default_rng(0), 300
    u = np.cumsum(rng.normal(size=n)) + 3.0
    rested = np.concatenate([np.full(n, u[0]), u])
    records = [RecordData(own, own, 0.1) for own in (u, rested)]
    short, long = (np.array(list(own)) for own in _driven(records, [u**2, rested**2], LAGS))
    in_time = np.arange(len(short)) >= len(short) - 2  # in proportion to the time in the record
    np.testing.assert_allclose(short[~in_time], long[~in_time, n:], atol=1e-9)
    assert not np.allclose(short[in_time], long[in_time, n:])
    assert np.linalg.matrix_rank(short) == len(short)  # none says what others say


def test_features_that_need_no_past_come_first():
    rng = np.random.default_rng(0)
    u = rng.normal(size=50)
    at = rng.permutation(50)
    records = [RecordData(own, own, 0.1) for own in (u, u[at])]
    first, second = (np.array(list(own)) for own in _driven(records, [u**3, u[at] ** 3]))
    np.testing.assert_array_equal(first[:N_PRESENT, at], second[:N_PRESENT])
    same = [np.allclose(a[at], b) for a, b in zip(first, second, strict=True)]
    assert same == [True] * N_PRESENT + [False] * (len(first) - N_PRESENT)


@pytest.mark.parametrize("size", [1, 2, 5, 40])
def test_means_and_values_of_the_past_end_before_the_sample(size):
    signal = np.random.default_rng(0).normal(size=20)
    means = [signal[max(k - size, 0) : k].mean() if k else 0.0 for k in range(20)]
    np.testing.assert_allclose(past_mean(signal, size), means, atol=1e-12)
    values = [signal[k - size] if k >= size else 7.0 for k in range(20)]
    np.testing.assert_array_equal(moved(signal, size, 7.0), values)


def test_a_residual_is_seen_by_its_past_alone():
    """What a residual is from a sample on changes no feature of its past up to there."""
    rng = np.random.default_rng(0)
    u, r = rng.normal(size=(2, 200))
    changed = np.r_[r[:100], rng.normal(size=100)]
    before, after = np.array(list(_own(u, r))), np.array(list(_own(u, changed)))
    np.testing.assert_array_equal(before[:, :101], after[:, :101])
    assert np.sum(np.any(before != after, axis=1)) == len(before) - 1  # all but the time


def test_a_gain_that_the_residual_had_with_the_drive_foretells_it():
    """Of a gain on the drive beside its mean, the features of that gain are the residual."""
    u = 3.0 + np.random.default_rng(0).choice([-1.0, 1.0], size=2000)
    features = np.array(list(_own(u, 0.7 * (u - u.mean()))))[:, 1000:]
    off = np.max(np.abs(features - 0.7 * (u - u.mean())[1000:]), axis=1)
    assert np.count_nonzero(off < 0.01) == len(LAGS[4::4])


def test_a_resting_record_does_not_hide_that_others_repeat():
    rng = np.random.default_rng(0)
    u = np.sin(np.linspace(0.0, 20.0, 400))
    moving = [RecordData(u, u + 0.1 * rng.normal(size=400), 0.01) for _ in range(2)]
    rest = RecordData(np.zeros(400), 0.1 * rng.normal(size=400), 0.01)
    assert repeatability([rest]) is None
    assert repeatability([rest, *moving]) == pytest.approx(repeatability(moving)) != 0.0


@pytest.mark.parametrize("n", [13, 20, 24, 60])
def test_a_cubic_drift_between_repetitions_is_no_noise(n):
    time = np.linspace(-1.0, 2.0, n)
    drift = 3.0 - time + 2.0 * time**3
    assert _settled(drift)[0] < 1e-20 * (drift @ drift)


def test_shares_of_octaves_are_those_of_the_power():
    """Of two lines, one of twice the amplitude has four fifths."""
    n, dt = 4000, 1e-3
    time = dt * np.arange(n)
    residual = np.sin(2 * np.pi * 20.0 * time) + 2.0 * np.sin(2 * np.pi * 300.0 * time)
    table = locate([RecordSlice("a", slice(0, n), dt, 0.0, n)], np.sin(time), residual, Units())
    table = table[table["by"] == "frequency"]
    shares = [
        table[(table["low"] < f) & (f <= table["high"])]["share"].item() for f in (20.0, 300.0)
    ]
    np.testing.assert_allclose(shares, [0.2, 0.8], atol=1e-3)


def test_what_a_column_adds_starts_from_that_column():
    rng = np.random.default_rng(0)
    u, *columns = np.linalg.qr(rng.normal(size=(500, 3)))[0].T * 20.0  # none is seen in another
    y = u + 2.0 * columns[0] - 3.0 * columns[1]
    records = [RecordData(u, y, 0.1, auxiliary=np.stack(columns, axis=1))]
    tree = Tree.of(Gain(), GainOperator(1.0))
    found = starting_trees(EFFECTS["auxiliary_input"], tree, records)
    edits = [edit for variant in found for one in variant for _, edit in one.edits]
    gains = {(e.column, round(e.operator.gain, 1)) for e in edits if type(e) is Drive}
    assert {(1, 2.0), (2, -3.0)} <= gains


def test_a_curve_levels_off_by_its_slope_at_the_end_of_the_motion():
    knee, end = SoftSaturationOperator(1.3, 2.0, 0.2), 1.1
    above, below = (knee.run(np.array([end + h]), 0.01)[0][0] for h in (1e-6, -1e-6))
    motion = knee.run(np.linspace(-0.3, end, 50), 0.01)[0]
    slope = (above - below) / 2e-6
    assert levels_off(knee, motion, []) == pytest.approx(FLAT - slope, abs=1e-6)


@pytest.mark.parametrize("beside", [0.1, 0.24, 0.26, 0.4])
def test_a_sinusoid_is_a_harmonic_where_half_of_its_power_is_in_the_mean_of_the_turns(beside):
    period, dt = 200, 0.01
    time, u = dt * np.arange(2 * period), np.sin(2 * np.pi * np.arange(2 * period) / period)
    frequency = (7.0 + beside) / (period * dt)
    line = np.exp(2j * np.pi * frequency * time)  # of any phase
    kept = np.mean(np.abs(line.reshape(2, period).mean(axis=0)) ** 2)
    operator, record = SimpleNamespace(frequencies=np.array([frequency])), RecordData(u, u, dt)
    assert (has_own_lines(operator, None, [record]) > 0.0) == (kept < 0.5)


@pytest.mark.parametrize(("times", "repeats"), [(0.9, False), (1.1, True)])
def test_a_sinusoid_repeats_in_the_longest_record(times, repeats):
    dt, rng = 0.01, np.random.default_rng(0)
    records = [RecordData(rng.normal(size=n), np.zeros(n), dt) for n in (300, 500)]
    operator = SimpleNamespace(frequencies=np.array([times * REPEATS / (500 * dt)]))
    assert (has_own_lines(operator, None, records) > 0.0) == repeats


def test_a_parameter_at_its_bound_has_no_interval():
    """Weights of plays are not negative; those of a straight line but the first are zero."""
    rng = np.random.default_rng(0)
    u = np.cumsum(rng.normal(size=400)) / 5.0
    model, records = PrandtlIshlinskii(4), [RecordData(u, 2.0 * u - 0.01 * np.cos(u), 0.01)]
    tree = Tree.from_result(model, model.identify(records))
    problem = tree.problem(records)
    at_bound = (problem.x0 <= problem.lower) | (problem.x0 >= problem.upper)
    assert 0 < np.count_nonzero(at_bound) < len(at_bound)
    search = SimpleNamespace(
        _structure=tree,
        _records=records,
        noise_model_=NoiseModel("white", 0.01),
        response_=u,
        verdict_="noise",
    )
    np.testing.assert_array_equal(Intervals(search)._inner, np.flatnonzero(~at_bound))


def test_without_a_covariance_errors_are_independent():
    values = {"a": (1.0, 0.5), "b": (3.0, 0.1)}
    claim = SimpleNamespace(result=SimpleNamespace(covariance=None), values=values)
    np.testing.assert_allclose(Claim.covariance(claim, ["b", "a"]), np.diag([0.01, 0.25]))


@pytest.mark.parametrize(("worse_by", "chosen"), [(1.02, 1), (1.2, 5)])
def test_the_simplest_variant_is_kept_that_foretells_about_as_well(worse_by, chosen):
    residual = np.random.default_rng(0).normal(size=400)

    def variant(n_parameters, factor):
        known = {"residuals": (factor * residual,), "weights": (None,), "error": factor}
        return Candidate((), None, 1.0, 1.0, n_parameters, np.empty(0), **known)

    contest = SimpleNamespace(criterion=Criterion(1e-300, 0.05))
    variants = [variant(5, 1.0), variant(1, worse_by)]
    assert Contest._variant(contest, variants).n_parameters == chosen


def test_before_a_knee_an_error_counts_by_the_slope_of_the_knee():
    knee = SoftSaturationOperator(1.0, 3.0, 0.1)
    before = np.linspace(-1.5, 1.5, 50)
    record = RecordData(before, knee.run(before, 0.01)[0], 0.01)
    undone = _before(record, knee)
    np.testing.assert_allclose(undone.y, before, atol=1e-9)
    slope = (knee.run(before + 1e-6, 0.01)[0] - knee.run(before - 1e-6, 0.01)[0]) / 2e-6
    np.testing.assert_allclose(undone.weights, slope**2, atol=1e-6)
    weighted = _before(replace(record, weights=2.0 * np.ones(50)), knee)
    np.testing.assert_allclose(weighted.weights, 2.0 * undone.weights)


def test_numbers_of_records_differ_by_parts_of_the_largest():
    assert _differ([0.0, 1.0])
    assert _differ([-1.0, 1.0, 1.0])
    assert not _differ([1.0, 1.01])
    assert not _differ([0.0, 0.0])
    assert not _differ([3.0])


@pytest.mark.parametrize(
    ("stiffness", "lower", "upper", "plausible"),
    [
        (10.0, -1.0, 0.5, True),  # motion goes from -1 to 1
        (0.5, -1.0, 0.5, False),  # softer than the spring
        (10.0, -1.5, 1.5, False),  # out of reach
        (10.0, -0.01, 0.01, False),  # always touched
    ],
)
def test_a_stop_is_stiff_reached_and_left(stiffness, lower, upper, plausible):
    operator = SimpleNamespace(
        stop_stiffness=stiffness, lower=lower, upper=upper, gain=2.0, intercept=0.3
    )
    motion = 0.3 + 2.0 * np.sin(np.linspace(0.0, 20.0, 500))
    assert (stops(operator, motion, []) > 0.0) == plausible


def test_what_came_near_a_claim_is_of_the_last_round(monkeypatch):
    ranking = pd.DataFrame(
        [
            (1, "lag", 0.5, 1.0),
            (2, "creep", 0.5, 1.1),
            (2, "delay", 0.5, 0.9),
            (2, "drift", 0.0, 1),
        ],
        columns=["round", "effect", "screen", "error_after"],
    )
    search = SimpleNamespace(
        verdict_="unexplained",
        ranking_=ranking,
        min_improvement=0.05,
        _structure=SimpleNamespace(effects=("lag",)),
        _records=[],
    )
    monkeypatch.setattr(_open_questions, "_with_effect", lambda name, tree, search: [name])
    monkeypatch.setattr(_open_questions, "Fitted", lambda tree, records: "as it is")
    found = [(name, other) for name, other, _ in _open_questions._near_claims(search)]
    assert found == [("delay", "none"), ("creep", "none")]
    search._structure.effects = ()
    found = [name for name, *_ in _open_questions._near_claims(search)]
    assert found == ["delay", "creep"]


@pytest.mark.parametrize("size", [0, 3, 19, 40])
def test_products_at_a_distance_are_summed(size):
    values = np.random.default_rng(size).normal(size=20)
    direct = [values[lag:] @ values[: max(20 - lag, 0)] for lag in range(size + 1)]
    np.testing.assert_allclose(_autocovariance(values, size), direct, atol=1e-12)
