"""Loops over plays and stops, and thresholds that a drive moves."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from skhyst.operators import play_basis, play_tangents, play_thresholds, stop_basis, turning_points

drives = arrays(float, st.integers(1, 60), elements=st.floats(-1e3, 1e3))
thresholds = arrays(float, st.integers(1, 9), elements=st.floats(0, 500)).map(np.sort)
# Multiples of an eighth: sums are exact, so a play touches the end of its slack or does not.
eighths = st.integers(-80, 80).map(lambda i: i / 8)
exact_drives = arrays(float, st.integers(1, 60), elements=eighths)
exact_thresholds = arrays(float, st.integers(1, 9), elements=eighths.map(abs)).map(np.sort)
spacings = st.sampled_from(["grid", "quantile"])


def basis(kernel, u, r, plays=None):
    plays = np.zeros(r.size) if plays is None else plays
    out = np.full((u.size, r.size), np.nan)
    kernel(u, r, plays, out)
    return out, plays


@settings(deadline=None, max_examples=50)
@given(drives, thresholds)
def test_plays_and_stops_follow_their_definition(u, r):
    play, state = basis(play_basis, u, r)
    before = np.vstack((np.zeros(r.size), play[:-1]))
    expected = np.maximum(u[:, None] - r, np.minimum(u[:, None] + r, before))
    np.testing.assert_array_equal(play, expected)
    np.testing.assert_array_equal(state, play[-1])
    stop, stop_state = basis(stop_basis, u, r)
    np.testing.assert_array_equal(stop, u[:, None] - play)
    np.testing.assert_array_equal(stop_state, state)


@pytest.mark.parametrize("kernel", [play_basis, stop_basis])
@pytest.mark.parametrize("cut", [1, 37, 99])
def test_a_drive_can_be_cut_anywhere(kernel, cut):
    u = np.random.default_rng(0).standard_normal(100)
    r = np.linspace(0.0, 2.0, 7)
    whole, _ = basis(kernel, u, r)
    first, plays = basis(kernel, u[:cut], r)
    second, _ = basis(kernel, u[cut:], r, plays)
    np.testing.assert_array_equal(np.vstack((first, second)), whole)


@settings(deadline=None, max_examples=100)
@given(exact_drives, exact_thresholds, st.integers(0, 2**32 - 1))
def test_tangents_are_the_weighted_sum_over_all_plays(u, r, seed):
    rng = np.random.default_rng(seed)
    du, w = rng.standard_normal((u.size, 3)), rng.standard_normal(r.size)
    out = np.empty((u.size, 3 + r.size + 2))
    play_tangents(u, du, r, np.append(0.0, np.cumsum(w)), np.zeros(r.size), out)
    plays, _ = basis(play_basis, u, r)
    np.testing.assert_array_equal(out[:, 3:-2], plays)
    # One tangent a play: that of the drive where the play touches an end of its slack.
    touches = (plays == u[:, None] - r) | (plays == u[:, None] + r)
    tangent, offset = np.zeros((r.size, 3)), np.zeros(r.size)
    for k in range(u.size):
        tangent[touches[k]] = du[k]
        offset[touches[k]] = -1.0
        np.testing.assert_allclose(out[k, :3], w @ tangent, atol=1e-12)
        np.testing.assert_allclose(out[k, -1], w @ offset, atol=1e-12)
        assert out[k, -2] == 1.0


@settings(deadline=None, max_examples=100)
@given(exact_drives)
def test_drive_is_monotone_between_turning_points(u):
    points = turning_points(u)
    assert points[0] == u[0]
    assert points[-1] == u[-1]
    steps = np.diff(points)
    assert np.all(steps != 0.0)
    assert np.all(steps[1:] * steps[:-1] < 0.0)
    assert np.abs(steps).sum() == pytest.approx(np.abs(np.diff(u)).sum())


@settings(deadline=None, max_examples=200)
@given(st.lists(exact_drives, min_size=1, max_size=3), st.integers(1, 12), spacings)
def test_every_threshold_is_moved(records, n_operators, spacing):
    found = play_thresholds(records, n_operators, spacing)
    assert found.shape == (n_operators,)
    assert found[0] == 0.0
    assert np.all(np.diff(found) > 0.0)
    moves = [np.ptp(basis(play_basis, u, found)[0], axis=0) > 0.0 for u in records]
    assert np.any(moves, axis=0).all() or not any(np.ptp(u) > 0.0 for u in records)


@pytest.mark.parametrize(
    ("drive", "expected"),
    [
        ([0.0, 8.0, 2.0, 8.0], [0.0, 2.0, 4.0, 6.0]),  # the grid of Steinbusch (2020)
        ([100.0, 101.0, 99.0, 101.0], [0.0, 0.25, 0.5, 0.75]),  # far from zero: of its swing
        ([[0.0, 1.0], [0.0, -8.0, 0.0]], [0.0, 2.0, 4.0, 6.0]),  # the largest record's span
        ([0.0] * 9, [0.0, 0.25, 0.5, 0.75]),  # a drive that rests
        ([-4.0] * 9, [0.0, 1.0, 2.0, 3.0]),
    ],
)
def test_grid_of_thresholds(drive, expected):
    np.testing.assert_allclose(play_thresholds(drive, 4), expected)


def test_quantiles_are_dense_where_branches_end():
    equal = np.tile([-2.0, 2.0], 50)
    np.testing.assert_allclose(play_thresholds(equal, 8, "quantile"), play_thresholds(equal, 8))
    u = np.concatenate(([0.0, 10.0], np.tile([0.0, 1.0], 200)))
    assert np.count_nonzero(play_thresholds(u, 20, "quantile") < 0.5) >= 16
    assert np.count_nonzero(play_thresholds(u, 20) < 0.5) == 1


@pytest.mark.parametrize("spacing", ["grid", "quantile"])
@pytest.mark.parametrize("unit", [1e-200, 1e-6, 1e200])
def test_unit_and_zero_of_the_drive(spacing, unit):
    u = np.random.default_rng(0).standard_normal(300)
    expected = play_thresholds(u, 7, spacing)
    np.testing.assert_allclose(play_thresholds(u * unit, 7, spacing), expected * unit, rtol=1e-12)
    moved = play_thresholds(u + 5.0, 7, spacing, drive_offset=5.0)
    np.testing.assert_allclose(moved, expected, rtol=1e-12)


def test_spacing_is_checked():
    with pytest.raises(ValueError, match="'spacing' parameter of play_thresholds"):
        play_thresholds([0.0, 1.0], 3, "log")
