"""What the small parts of the search decide by: a theorem each, on signals made for it."""

from dataclasses import replace
from itertools import cycle, pairwise
from types import SimpleNamespace

import numpy as np
import pytest
import search_steps

from skhyst.compose import Cascade, amplitude
from skhyst.diagnosis import EFFECTS, _structure
from skhyst.diagnosis._changes import _before
from skhyst.diagnosis._constants import FULL, LAGS, PLAYS
from skhyst.diagnosis._structure import (
    N_PRESENT,
    Trial,
    _black_box_data,
    _black_box_residuals,
    _by_black_box,
    _drive_features,
    _past_features,
    _settled,
    _wiped,
    by_black_boxes,
    by_shifted_drive,
    in_repetitions,
    repeatability,
    repetitions,
)
from skhyst.diagnosis._turns import turns
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import FirstOrderLag, FirstOrderLagOperator, Gain
from skhyst.optimize import RecordData
from skhyst.records import drive_period, near_period, repeats
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


@pytest.mark.parametrize("period", [4.3, 6.5, 10.5, 20.5, 33.4])
def test_a_period_is_found_between_the_samples(period):
    """Of a sinusoid, to a thousandth, though no sample comes back, or only after two turns."""
    u = np.sin(2.0 * np.pi * np.arange(300) / period + 0.3)
    assert near_period(u) == pytest.approx(period, rel=1e-3)


def test_a_period_is_known_after_two_turns():
    u = np.sin(2.0 * np.pi * np.arange(102) / 50.0)
    assert near_period(u[:101]) == pytest.approx(50.0, rel=0.02)
    assert near_period(u[:97]) == 0
    for n in range(1, 6):
        assert drive_period(np.resize([0.0, 1.0], n)) == near_period(u[:n]) == 0
    assert drive_period(np.resize([0.0, 1.0], 6)) == 2


@pytest.mark.parametrize(("scale", "offset"), [(1e-9, 0.0), (-1.0, 0.0), (1e6, 3e6), (1.0, -200.0)])
def test_periods_and_turns_have_neither_a_unit_nor_an_offset(scale, offset):
    rng = np.random.default_rng(0)
    turn = 2.0 * np.pi * np.arange(400) / 37.3
    noise = rng.normal(size=400)
    for u in (np.tile(rng.normal(size=40), 10), np.sin(turn) + 0.02 * noise, noise):
        other = scale * u + offset
        assert drive_period(other) == drive_period(u)
        assert near_period(other) == pytest.approx(near_period(u), rel=1e-6)
        np.testing.assert_array_equal(turns(other), turns(u))
        for error, same in ((0.9e-6, True), (1.1e-6, False)):
            changed = u + error * np.ptp(u) * (np.arange(400) == 7)
            assert repeats(other, scale * changed + offset) == same


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
    assert _wiped(5.0 + 1e-4 * u) == expected


@pytest.mark.parametrize("n", [20, 64, 1000])
def test_stationary_noise_between_repetitions_counts_whole(n):
    """All of it counts, but for the freedom of a cubic drift."""
    noise = np.random.default_rng(0).permutation(np.resize([1.0, -1.0], n))
    power, freedom = _settled(noise)
    assert freedom == n - 4  # coefficients of a cubic
    time = np.linspace(-1.0, 1.0, n)
    rest = noise - np.polynomial.Polynomial.fit(time, noise, 3)(time)
    assert power == pytest.approx(rest @ rest)


@pytest.mark.parametrize("n", [7, 24, 160])
def test_how_a_repetition_began_does_not_count(n):
    """A transient in the first sixteenth of the difference goes with it, and no more."""
    noise = np.random.default_rng(1).permutation(np.resize([1.0, -1.0], n))
    begun = noise.copy()
    size = max(n // 16, 1)
    begun[:size] += 100.0
    power, freedom = _settled(begun)
    assert (power, freedom) == (pytest.approx(_settled(noise[size:])[0]), n - size - 4)


@pytest.mark.parametrize("n", [1, 2, 4, 5])
def test_a_drift_takes_all_freedom_of_few_samples(n):
    assert _settled(np.ones(n))[1] == max(n - 4, 0)


def test_of_what_does_not_settle_seven_times_a_sixteenth_goes():
    noise = np.random.default_rng(0).normal(size=6400) * np.exp(-0.01 * np.arange(6400))
    assert _settled(noise)[1] == pytest.approx(6400 * (15 / 16) ** 7, rel=0.01)


def test_rounding_between_repetitions_is_no_start():
    difference = np.zeros(160)
    difference[:3] = 2.0**-52
    difference[80] = 1.0
    assert _settled(difference)[1] == 160 - 4


@pytest.mark.parametrize("part", [0.0, 0.04, 0.06, 0.5])
def test_a_candidate_matters_by_the_error_that_it_takes_away(part):
    """Shares are of the power: what takes the part p of the error leaves (1 - p)^2 of that."""
    criterion = search_steps.USUAL
    assert Trial((1.0 - part) ** 2, 0.0, None).improves_enough(criterion) == (part >= 0.05)
    assert Trial((1.0 - part) ** 2, 0.0, None).is_structure(criterion) == (part >= 0.05)
    assert not Trial((1.0 - part) ** 2, 0.02, None).is_structure(criterion)


def test_the_noise_is_that_of_one_of_two_repetitions():
    """The difference of two has twice the variance; a cubic drift has taken its freedom."""
    rng = np.random.default_rng(0)
    u = np.r_[1.0, -1.0, rng.uniform(-1.0, 1.0, 98)]
    noise = rng.permutation(np.resize([1.0, -1.0], 99))
    records = [RecordData(u, np.r_[0.0, y], 0.01) for y in (0.3 * noise, -0.3 * noise)]
    power, freedom = _settled(0.6 * noise)
    assert freedom == 99 - 4
    assert repeatability(records) == pytest.approx(np.sqrt(0.5 * power / freedom))
    assert repeatability(records) == pytest.approx(np.sqrt(0.5) * 0.6, rel=0.05)


def test_repetitions_have_the_same_drive_at_the_same_interval():
    """Each is compared with the next, so that three give two pairs."""
    rng = np.random.default_rng(0)
    u = np.r_[1.0, -1.0, rng.uniform(-1.0, 1.0, 98)]
    other = u + 1e-3 * rng.normal(size=100)
    drives = [(u, 0.01), (other, 0.01), (u, 0.01), (u[:-1], 0.01), (u, 0.02), (u, 0.01)]
    records = [RecordData(0.1 * own, own, dt) for own, dt in drives]
    assert [(i, j) for i, _, j, _ in repetitions(records)] == [(0, 2), (2, 5)]


def test_periods_are_compared_from_the_second_on():
    u = np.tile(np.random.default_rng(0).normal(size=30), 4)[:-5]
    found = list(repetitions([RecordData(u, u, 0.01)]))
    assert found == [(0, slice(60, 115), 0, slice(30, 85))]
    assert list(repetitions([RecordData(u[:89], u[:89], 0.01)])) == []


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
    short, long = (np.array(list(own)) for own in _drive_features(records, [u**2, rested**2], LAGS))
    in_time = np.arange(len(short)) >= len(short) - 2  # in proportion to the time in the record
    np.testing.assert_allclose(short[~in_time], long[~in_time, n:], atol=1e-9)
    assert not np.allclose(short[in_time], long[in_time, n:])
    assert np.linalg.matrix_rank(short) == len(short)  # none says what others say


def test_features_that_need_no_past_come_first():
    rng = np.random.default_rng(0)
    u = rng.normal(size=50)
    at = rng.permutation(50)
    records = [RecordData(own, own, 0.1) for own in (u, u[at])]
    first, second = (np.array(list(own)) for own in _drive_features(records, [u**3, u[at] ** 3]))
    np.testing.assert_array_equal(first[:N_PRESENT, at], second[:N_PRESENT])
    same = [np.allclose(a[at], b) for a, b in zip(first, second, strict=True)]
    assert same == [True] * N_PRESENT + [False] * (len(first) - N_PRESENT)


def boxes_of(y, x, *, blocks=9):
    block = np.arange(len(y)) * blocks // len(y)
    return _black_box_residuals(x, y, block, np.random.default_rng(0)), block


def test_a_black_box_is_a_ridge_of_little_shrinkage_whatever_the_units_of_its_columns():
    """Of one column of variance 1, a penalty of 0.001 a sample keeps the part 1 / 1.001."""
    x = np.random.default_rng(0).normal(size=(900, 1)) + 5.0
    y = 3.0 * (x[:, 0] - 5.0)
    (ridge, trees), _ = boxes_of(y, x)
    inner = np.abs(y) < 3.0  # further out a prediction may be limited to what was fitted
    assert ridge[inner] @ y[inner] == pytest.approx(1e-3 * y[inner] @ y[inner], rel=0.2)
    assert trees @ trees < 0.01 * y @ y
    for unit in (1e-6, 1e6):
        np.testing.assert_allclose(
            boxes_of(y, np.c_[unit * x, np.ones(900)])[0][0], ridge, atol=1e-9
        )


def test_trees_see_what_no_straight_line_does():
    x = np.random.default_rng(0).uniform(-1.0, 1.0, size=(900, 1))
    y = np.sign(np.abs(x[:, 0]) - 0.5)
    (ridge, trees), _ = boxes_of(y, x)
    assert ridge @ ridge > 0.9 * y @ y
    assert trees @ trees < 0.2 * y @ y


def test_what_a_black_box_leaves_of_a_stretch_was_not_learned_there():
    """Another residual there is left with the same prediction, within what was learned from."""
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(600, 3)), rng.normal(size=600)
    left, block = boxes_of(y, x)
    for fold in range(3):
        own = block % 3 == fold
        other = np.where(own, rng.normal(size=600), y)
        again, _ = boxes_of(other, x)
        np.testing.assert_allclose((again - other)[:, own], (left - y)[:, own], atol=1e-9)
        assert np.any(again[:, ~own] != left[:, ~own])
    far = np.where(block % 3 == 0, 100.0, 1.0)[:, None] * x
    prediction = boxes_of(far[:, 0] / 100.0, far)[0][0] - far[:, 0] / 100.0
    assert np.abs(prediction[block % 3 == 0]).max() <= 0.04  # it was fitted to less than that


@pytest.mark.parametrize("blocks", [1, 2])
def test_of_few_stretches_those_are_predicted_that_others_teach(blocks):
    x = np.random.default_rng(0).normal(size=(200, 1))
    left, _ = boxes_of(x[:, 0], x, blocks=blocks)
    if blocks == 1:
        np.testing.assert_array_equal(left, np.stack([x[:, 0]] * 2))
    else:
        assert np.abs(left[0]).max() < 0.5 * np.abs(x).max()


def box_trial(monkeypatch, law, leaves, p_values=(0.001,)):
    """Return the trial of black boxes that leave those parts in turn, and what they were shown."""
    parts, chances, shown = iter(leaves), cycle(p_values), []

    def left_by_boxes(x, y, block, rng):
        shown.append((x, y))
        part = next(parts)
        return np.stack([max(part, 1.0) * y, part * y])

    noise = SimpleNamespace(law=law, innovations=lambda series: [0.5 * own for own in series])
    monkeypatch.setattr(_structure, "fit_noise", lambda _: noise)
    monkeypatch.setattr(_structure, "_black_box_residuals", left_by_boxes)
    monkeypatch.setattr(_structure, "paired_p_value", lambda *_: next(chances))
    rng = np.random.default_rng(0)
    records = [RecordData(u, u, 0.01) for u in rng.normal(size=(2, 200))]
    residuals = list(rng.normal(size=(2, 200)))
    residuals[0][7] = 0.0
    predictions = [r.u**2 for r in records]
    trial = _by_black_box(
        records, residuals, predictions, rng, replace(search_steps.USUAL, alpha=0.02)
    )
    return trial, shown, np.concatenate(residuals)


def test_a_black_box_of_white_noise_is_one_of_two(monkeypatch):
    """The better one counts, and its p-value twice."""
    trial, shown, residual = box_trial(monkeypatch, "white", [0.5])
    assert (trial.share, trial.p_value) == (pytest.approx(0.25), 0.002)
    np.testing.assert_allclose(np.concatenate(trial.left), 0.5 * residual)
    assert [len(part) for part in trial.left] == [200, 200]  # nothing follows across records
    assert len(shown) == 1
    assert box_trial(monkeypatch, "white", [2.0])[0].share == 1.0  # nothing is taken away
    assert box_trial(monkeypatch, "white", [0.5], [0.9])[0].p_value == 1.0


def test_black_boxes_of_coloured_noise_are_a_family(monkeypatch):
    """Of two boxes, three targets, and errors as they are and as innovations: twelve."""
    leaves, chances = [0.99, 0.98, 0.999], [0.004, 0.001]
    trial, shown, residual = box_trial(monkeypatch, "autoregressive", leaves, chances)
    assert (trial.share, trial.p_value) == (pytest.approx(0.98**2), pytest.approx(0.012))
    targets = [y for _, y in shown]
    rest = np.square(0.5 * residual)  # what its law predicts of the residual
    for target, right in zip(targets, [residual, 0.5 * residual, rest - rest.mean()], strict=True):
        np.testing.assert_allclose(target, right)
    driven, past, also_driven = (x for x, _ in shown)
    np.testing.assert_array_equal(driven, also_driven)
    np.testing.assert_array_equal(past[:, :N_PRESENT], driven[:, :N_PRESENT])
    own = len(list(_past_features(residual[:200], residual[:200])))
    assert past.shape[1] == N_PRESENT + own
    swapped = box_trial(monkeypatch, "autoregressive", leaves, chances[::-1])[0]
    assert swapped.p_value == pytest.approx(0.012)


@pytest.mark.parametrize("which", [0, 1, 2])
def test_structure_in_coloured_noise_is_what_is_found_of_the_whole(monkeypatch, which):
    """What the drive alone explains is that; the residual is judged by all that can be seen."""
    leaves = [0.5 if k == which else 1.0 for k in range(3)]
    trial, shown, residual = box_trial(monkeypatch, "autoregressive", [*leaves, 0.25])
    assert trial.p_value == pytest.approx(0.012)
    part = 0.25 if which else 0.5
    assert trial.share == pytest.approx(part**2)
    np.testing.assert_allclose(np.concatenate(trial.left), part * residual)
    assert len(shown) == (4 if which else 3)
    if which:
        np.testing.assert_array_equal(shown[3][1], residual)
        driven, own = shown[0][0], shown[1][0][:, N_PRESENT:]
        np.testing.assert_array_equal(shown[3][0], np.c_[driven, own])


@pytest.mark.parametrize(("slow", "length"), [(False, 10), (True, 200)])
def test_of_long_records_evenly_spread_stretches_are_seen(slow, length, monkeypatch):
    """A stretch lasts as long as neighbours have something in common, but nine are left.

    Rows without a residual are left out, and none is taken to follow another across a gap.
    """
    monkeypatch.setattr(_structure, "ENOUGH", 600)
    rng = np.random.default_rng(0)
    sizes = 1505, 300
    records = [RecordData(u, u, 0.01) for u in (rng.normal(size=n) for n in sizes)]
    residuals = [rng.normal(size=n) for n in sizes]
    if slow:
        residuals = [np.cumsum(own) for own in residuals]
    residuals[0][500:505] = np.nan
    noise = SimpleNamespace(innovations=lambda series: [2.0 * own for own in series])
    predictions = [r.u for r in records]
    x, n_driven, y, new, block, ends = _black_box_data(records, residuals, predictions, rng, noise)
    assert len(x) == len(y) == len(block) == pytest.approx(600, abs=length)
    np.testing.assert_array_equal(new, 2.0 * y)
    every = np.concatenate(residuals)
    rows = np.array([np.flatnonzero(every == value).item() for value in y])
    parts = np.split(rows, ends)
    assert all(np.all(np.diff(own) == 1) for own in parts)
    begins = [own[0] for own in parts[1:]]
    assert all(b > a[-1] + 1 or b == 1505 for a, b in zip(parts, begins, strict=False))
    numbers = [block[rows == row].item() for row in rows]
    np.testing.assert_array_equal(np.unique(numbers), np.arange(block[-1] + 1))
    seen = np.bincount(block)
    assert seen.max() == length
    assert np.count_nonzero(seen == length) >= len(seen) - 2  # all but the ends of records
    assert np.diff(rows).max() <= 2 * length + 6  # two of three stretches, and the hole
    drives = np.concatenate([r.u for r in records])
    np.testing.assert_allclose(x[:, 0], (drives[rows] - drives.mean()) / np.ptp(drives))
    assert n_driven == len(list(next(_drive_features(records, predictions, LAGS))))


def test_units_of_drive_and_prediction_do_not_matter_to_a_black_box():
    """A cubic of the prediction is seen exactly, whatever its level."""
    rng = np.random.default_rng(0)
    u, p = np.cumsum(rng.normal(size=(2, 100)), axis=1)
    record = RecordData(u, u, 0.01)
    own = np.array(list(next(_drive_features([record], [p], LAGS))))
    other = replace(record, u=1e3 * u + 5.0)
    np.testing.assert_allclose(
        np.array(list(next(_drive_features([other], [1e-6 * p - 7.0], LAGS)))), own, atol=1e-9
    )
    cubic = (p - 3.0) ** 3
    basis = np.c_[np.ones(100), own[1:N_PRESENT].T]
    left = cubic - basis @ np.linalg.lstsq(basis, cubic, rcond=None)[0]
    assert np.abs(left).max() < 1e-9 * np.abs(cubic).max()


@pytest.mark.parametrize(("n", "largest"), [(60, 16), (70, 64), (1000, 256), (1030, 1024)])
def test_slow_reactions_are_seen_up_to_the_length_of_the_longest_record(n, largest):
    """A first-order reaction to a step is 1 - 1/e after its time constant: a power of four."""
    u = np.r_[0.0, np.ones(n - 1)]
    records = [RecordData(own, own, 0.01) for own in (u, u[:9])]
    features = np.array(list(next(_drive_features(records, [r.u for r in records]))))
    first = features[N_PRESENT + PLAYS :]
    constants = [4**k for k in range(1, 6) if 4**k <= largest]
    level = np.ptp(u) * (1.0 - np.exp(-1.0))
    found = [np.argmax(own >= level - 1e-9) for own in first[: len(constants)]]
    np.testing.assert_array_equal(
        found, [constant if constant < n else 0 for constant in constants]
    )
    assert len(first) == 2 * len(constants) + 2


def test_the_time_in_a_record_is_counted_from_its_middle():
    u = np.sin(np.linspace(0.0, np.pi, 101))  # the same backwards
    in_time = np.array(list(next(_drive_features([RecordData(u, u, 0.01)], [u]))))[-2:]
    np.testing.assert_allclose(in_time, -in_time[:, ::-1], atol=1e-12)
    assert np.abs(in_time).max() > 0.1


def test_a_residual_is_seen_by_its_past_alone():
    """What a residual is from a sample on changes no feature of its past up to there."""
    rng = np.random.default_rng(0)
    u, r = rng.normal(size=(2, 200))
    changed = np.r_[r[:100], rng.normal(size=100)]
    before, after = np.array(list(_past_features(u, r))), np.array(list(_past_features(u, changed)))
    np.testing.assert_array_equal(before[:, :101], after[:, :101])
    assert np.sum(np.any(before != after, axis=1)) == len(before) - 1  # all but the time
    np.testing.assert_allclose(before[-1], np.linspace(0.0, 1.0, 200, endpoint=False))
    assert np.count_nonzero(before[:-1, 0]) == 0  # nothing has been
    n_changes = len(LAGS[4::4])  # gains with the change of the drive, which there was none of
    assert np.count_nonzero(before[-1 - n_changes : -1, 1]) == 0


def test_a_gain_that_the_residual_had_with_the_drive_predicts_it():
    """Of a gain on the drive beside its mean, the features of that gain are the residual."""
    u = 3.0 + 0.01 * np.random.default_rng(0).choice([-1.0, 1.0], size=2000)
    residual = 0.7 * (u - u.mean())
    features = np.array(list(_past_features(u, residual)))[:, 1000:]
    sizes = features @ residual[1000:] / (residual[1000:] @ residual[1000:])
    shrunk = (sizes > 0.998) & (sizes < 1.0)  # by a thousandth, so that nothing is divided by zero
    assert np.count_nonzero(shrunk) == len(LAGS[4::4])
    off = np.max(np.abs(features - 0.7 * (u - u.mean())[1000:]), axis=1)
    assert np.count_nonzero(off < 1e-4) == len(LAGS[4::4])
    change = 0.7 * np.diff(u, prepend=u[0])  # or of one on the change of the drive
    features = np.array(list(_past_features(u, change)))[:, 1000:]
    off = np.max(np.abs(features - change[1000:]), axis=1)
    assert np.count_nonzero(off < 1e-4) == len(LAGS[4::4])


def shifted_trial(residuals, drives, **known):
    records = [RecordData(u, u, 0.01, **known) for u in drives]
    return by_shifted_drive(records, residuals, drives)


@pytest.mark.parametrize(("n", "shifts"), [(400, 100), (800, 200), (1200, 200)])
def test_what_follows_the_drive_now_does_so_better_than_at_any_shift(n, shifts):
    """It is the first of r + 1, with a quarter of the record, but 200, to either side."""
    u = np.random.default_rng(0).normal(size=n)
    for residual in (u, 1e-6 * u**3 + 4.0):
        trial = shifted_trial([residual], [u])
        assert trial.p_value == pytest.approx(1 / (shifts + 1))
        assert trial.share < 1e-6
    to_come = shifted_trial([np.r_[u[1:], 0.0]], [u])
    assert to_come.p_value > 1.5 / (shifts + 1)
    assert to_come.share > 0.9


def test_what_the_drive_explains_of_a_residual_is_a_part_of_its_power():
    rng = np.random.default_rng(0)
    u, noise = rng.normal(size=(2, 4000))
    trial = shifted_trial([u + 2.0 * noise], [u])
    assert trial.share == pytest.approx(0.8, abs=0.05)
    assert trial.p_value == pytest.approx(1 / 201)
    flat = shifted_trial([noise], [u])
    assert flat.share == pytest.approx(1.0, abs=0.05)
    assert flat.p_value > 0.01


def test_one_sample_elsewhere_is_no_repetition():
    u = np.sin(np.arange(50) / 7.0)
    assert repeats(u, u + 1e-9)
    assert not repeats(u, u + 1e-3 * (np.arange(50) == 30))


def test_a_drive_that_repeats_itself_is_shifted_by_less_than_a_third_of_its_period():
    u = np.tile(np.random.default_rng(0).normal(size=120), 5)
    trial = shifted_trial([u + 3.0], [u])
    assert trial.p_value == pytest.approx(1 / 41)
    assert trial.share < 1e-6


def test_records_are_shifted_together_as_far_as_the_longest_allows():
    u, short = (np.random.default_rng(0).normal(size=n) for n in (400, 80))
    for drives in ([u, short], [short, u]):
        trial = shifted_trial(drives, drives)
        assert trial.p_value == pytest.approx(1 / 101)
        assert trial.share < 1e-6


def test_of_long_records_some_rows_are_enough(monkeypatch):
    monkeypatch.setattr(_structure, "ENOUGH", 300)
    u = np.random.default_rng(0).normal(size=1000)
    trial = shifted_trial([u + 3.0], [u])
    assert (trial.share, trial.p_value) == (pytest.approx(0.0, abs=1e-6), pytest.approx(1 / 201))


def test_where_nothing_is_left_nothing_is_found():
    u = np.random.default_rng(0).normal(size=200)
    rest = np.zeros(200)
    criterion = search_steps.USUAL
    trial = _by_black_box(
        [RecordData(u, u, 0.01)], [rest], [u], np.random.default_rng(0), criterion
    )
    assert (trial.share, trial.p_value) == (1.0, 1.0)


def test_records_with_gaps_and_columns_that_say_nothing_new_change_nothing():
    rng = np.random.default_rng(0)
    u, noise, other = rng.normal(size=(3, 600))
    right = shifted_trial(
        [np.r_[np.full(9, np.nan), u + noise][:600]], [np.r_[np.zeros(9), u][:600]]
    )
    drive, residual = np.r_[np.zeros(9), u][:600], np.r_[np.full(9, np.nan), u + noise][:600]
    gap = np.where(np.arange(600) == 300, np.nan, other)
    records = [RecordData(own, own, 0.01) for own in (drive, drive)]
    found = by_shifted_drive(records, [gap, residual], [drive, drive])
    assert (found.share, found.p_value) == pytest.approx((right.share, right.p_value), rel=1e-6)
    again = shifted_trial([residual], [drive], auxiliary=np.c_[np.ones(600), 5.0 * drive])
    assert (again.share, again.p_value) == pytest.approx((right.share, right.p_value), rel=1e-6)


@pytest.mark.parametrize("n", [3, 20, *range(48, 74, 2)])
def test_too_few_samples_follow_no_drive(n):
    """Twice as many samples as features are asked for, in the middle half of the record."""
    u = np.random.default_rng(0).normal(size=n)
    features = np.array(list(next(_drive_features([RecordData(u, u, 0.01)], [u]))))
    features = features[:, n // 4 : n - n // 4]
    features -= features.mean(axis=1, keepdims=True)
    features /= np.maximum(features.std(axis=1, keepdims=True), 1e-300)
    rank = np.linalg.matrix_rank(features, rtol=1e-6)
    assert (shifted_trial([u], [u]) == Trial(1.0, 1.0, None)) == (features.shape[1] < 2 * rank)
    assert shifted_trial([np.full(n, np.nan)], [u]) == Trial(1.0, 1.0, None)
    assert shifted_trial([u], [np.ones(n)]) == Trial(1.0, 1.0, None)


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
    power, freedom = _settled(drift - drift[0])
    assert power < 1e-20 * (drift @ drift)
    assert freedom == n - 4  # rounding is no transient


def changed(effect, number, records, **tree):
    """Return what is done to a model for a variant of an effect."""
    variant = EFFECTS[effect].variants()[number]
    known = {"input_history": (), "lines": (), "multi_input": False, "scaled_by": ()}
    fake = SimpleNamespace(**{**known, "edited": lambda name, edit: edit, **tree})
    return variant.trees("effect", SimpleNamespace(tree=fake, records=records, residuals=records))


def test_the_response_is_scaled_by_what_differs_between_records():
    rng = np.random.default_rng(0)
    drives = [np.r_[-a, a, np.zeros(n - 2)] for a, n in ((1.0, 100), (4.0, 300))]
    columns = [
        np.c_[rng.normal(size=len(u)), np.ones(len(u)), np.full(len(u), u[1])] for u in drives
    ]
    records = [RecordData(u, u, 0.01, auxiliary=c) for u, c in zip(drives, columns, strict=True)]
    sizes = [amplitude(u) for u in drives]
    (edit,) = changed("amplitude_dependence", 0, records)
    assert (edit.column, edit.reference) == (
        "amplitude",
        pytest.approx(0.25 * sizes[0] + 0.75 * sizes[1]),
    )
    assert changed("amplitude_dependence", 0, records[:1] * 2) == []
    assert changed("amplitude_dependence", 0, records, scaled_by=("amplitude",)) == []
    assert changed("amplitude_dependence", 0, records, multi_input=True) == []
    found = changed("auxiliary_input", 4, records)
    means = np.concatenate(columns).mean(axis=0)
    assert [(edit.column, edit.reference) for edit in found] == [
        (1, pytest.approx(means[0])),
        (3, pytest.approx(means[2])),
    ]
    assert [edit.column for edit in changed("auxiliary_input", 4, records, scaled_by=("1",))] == [3]
    alike = [replace(records[0], u=size * records[0].u) for size in (1.0, 1.01)]
    assert changed("amplitude_dependence", 0, alike) == []


@pytest.mark.parametrize("segments", [1, 60])
def test_what_came_before_records_is_seen_in_their_first_third(segments):
    u = np.sin(np.arange(90.0))
    edges = np.linspace(0, 90, segments + 1).astype(int).tolist()
    record = RecordData(u, u, 0.01, segments=tuple(pairwise(edges)))
    seen = []
    known = {
        "model": Cascade([("lag", FirstOrderLag()), ("gain", Gain())]),
        "operators": [SimpleNamespace(memoryless=False), SimpleNamespace(memoryless=True)],
        "with_estimated_history": lambda parts: (
            seen.extend(parts) or SimpleNamespace(input_history=("past",))
        ),
        "edited": lambda name, edit: SimpleNamespace(
            edit=edit, with_input_history=lambda records: records
        ),
    }
    start, together = changed("initial_state", 0, [record], **known)
    assert (start.edit.input_history, together) == (("past",), [record])
    assert [len(part.u) for part in seen] == [max(30, segments)]
    still = {**known, "operators": [SimpleNamespace(memoryless=True)]}
    assert changed("initial_state", 0, [record], **still) == []
    zero = {**known, "model": Cascade([("lag", FirstOrderLag(initial_state="zero"))])}
    assert changed("initial_state", 0, [record], **zero) == []
    start, _ = changed("initial_state", 0, [record], **{**known, "multi_input": True})
    assert start.edit.input_history == ("past",)


def test_a_start_in_motion_shows_although_the_parameters_have_compensated_for_it():
    """Fitted one after the other, a ninth of the sum of squares would be left."""
    t = np.arange(300.0)
    u = np.sin(t / 15.0) + 0.5 * np.sin(t / 37.0)
    at_rest, _ = FirstOrderLagOperator(40.0).run(u, 1.0)
    records = [RecordData(u, at_rest + 0.8 * np.exp(-t / 40.0), 1.0)]
    tree = search_steps.fitted(FirstOrderLag(), records)
    problem = tree.problem(records)
    cost = problem.total(problem.evaluate(problem.x0))[-1, -1]
    (found,) = search_steps.variants("initial_state", tree, records)
    assert found.predicted_cost < 1e-3 * cost


def test_a_candidate_is_nested_up_to_what_the_noise_of_its_parameters_hides():
    """The misfit to the other's prediction is compared with the variance for each parameter."""
    rng = np.random.default_rng(0)
    u = np.cumsum(rng.normal(size=400)) / 5.0
    records = [RecordData(u, u + 0.1 * np.sin(3.0 * u), 0.01)]
    plays, line = (search_steps.fitted(m, records) for m in (PrandtlIshlinskii(4), Gain()))
    small = search_steps.candidate(plays, cost=1.0, n_parameters=5)
    basis = np.stack([u, np.ones(400)], axis=1)
    predicted = plays.run(records)[0]
    misfit = predicted - basis @ np.linalg.lstsq(basis, predicted, rcond=None)[0]
    contest = search_steps.contest(records, [])
    for part, contained in ((0.9, True), (1.1, False)):
        cost = misfit @ misfit / part / 2 * 400  # of noise that two parameters follow
        large = search_steps.candidate(line, cost=cost, n_parameters=2)
        assert contest._contains(large, small) == contained


@pytest.mark.parametrize("folds_back", [True, False])
def test_a_reading_is_folded_where_it_is_smoother_without(folds_back):
    """The record that moves most is unfolded, about the end of all records."""
    turn = np.linspace(0.5, 20.0, 800)
    moves = np.sin(turn)
    records = [
        RecordData(turn, 0.2 + scale * (np.abs(moves) if folds_back else moves + 1.0), 0.01)
        for scale in (0.5, 1.0, 0.7)
    ]
    identified = []
    tree = SimpleNamespace(
        input_history=(),
        lines=(),
        identified=lambda records: identified.extend(records) or tree,
        edited=lambda name, edit: edit.operator,
    )
    scene = SimpleNamespace(tree=tree, records=records)
    found = EFFECTS["rectification"].variants()[0].trees("rectification", scene)
    if not folds_back:
        assert found == identified == []
        return
    ((operator,), (record,)) = found, identified
    level = min(record.y.min() for record in records)
    assert (operator.level, operator.side) == (level, 1)
    np.testing.assert_allclose(np.abs(record.y - 0.2), np.abs(moves), atol=0.01)
    np.testing.assert_allclose(record.y - 0.2, np.sign(moves[0]) * moves, atol=0.02)


@pytest.mark.parametrize(("times", "repeats"), [(0.9, False), (1.1, True)])
def test_a_sinusoid_repeats_in_the_longest_record(times, repeats):
    dt, rng = 0.01, np.random.default_rng(0)
    records = [RecordData(rng.normal(size=n), np.zeros(n), dt) for n in (300, 500)]
    operator = SimpleNamespace(frequencies=np.array([times * 2.0 / (500 * dt)]))
    assert (EFFECTS["periodic_disturbance"].plausible(operator, None, records) > 0.0) == repeats


def test_before_a_knee_an_error_counts_by_the_slope_of_the_knee():
    knee = SoftSaturationOperator(1.0, 3.0, 0.1)
    before = np.linspace(-1.5, 1.5, 50)
    record = RecordData(before, knee.run(before, 0.01)[0], 0.01)
    undone = _before(record, knee)
    np.testing.assert_allclose(undone.y, before, atol=1e-9)
    slope = (knee.run(before + 1e-6, 0.01)[0] - knee.run(before - 1e-6, 0.01)[0]) / 2e-6
    np.testing.assert_allclose(undone.weights, slope**2, atol=1e-6)
    far = np.linspace(-9.0, 9.0, 50)  # undone as far as it is well conditioned
    beyond = knee.run(_before(replace(record, y=far), knee).y, 0.01)[0]
    np.testing.assert_allclose(beyond, np.clip(far, 0.1 - FULL, 0.1 + FULL))
    weighted = _before(replace(record, weights=2.0 * np.ones(50)), knee)
    np.testing.assert_allclose(weighted.weights, 2.0 * undone.weights)
