import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from skhyst.operators import play_basis, play_thresholds, turning_points

drives = arrays(float, st.integers(1, 50), elements=st.integers(-9, 9).map(float))
spacings = st.sampled_from(["grid", "quantile"])


@settings(deadline=None, max_examples=100)
@given(drives)
def test_drive_is_monotone_between_turning_points(u):
    points = turning_points(u)
    assert points[0] == u[0]
    assert points[-1] == u[-1]
    steps = np.diff(points)
    assert np.all(steps != 0.0)
    assert np.all(steps[1:] * steps[:-1] < 0.0)
    assert np.abs(steps).sum() == pytest.approx(np.abs(np.diff(u)).sum())


@settings(deadline=None, max_examples=200)
@given(st.lists(drives, min_size=1, max_size=3), st.integers(1, 12), spacings)
def test_every_threshold_is_moved(records, n_operators, spacing):
    thresholds = play_thresholds(records, n_operators, spacing)
    assert thresholds.shape == (n_operators,)
    assert thresholds[0] == 0.0
    assert np.all(np.diff(thresholds) > 0.0)
    moves = np.zeros(n_operators, dtype=bool)
    for u in records:
        plays = np.empty((u.size, n_operators))
        play_basis(u, thresholds, np.zeros(n_operators), plays)
        moves |= np.ptp(plays, axis=0) > 0.0
    assert moves.all() or not any(np.ptp(u) > 0.0 for u in records)


def test_grid_of_the_thesis():
    u = np.array([0.0, 10.0, 2.0, 10.0])
    np.testing.assert_allclose(play_thresholds(u, 5), [0.0, 2.0, 4.0, 6.0, 8.0])


def test_a_drive_far_from_zero_has_thresholds_of_its_swing():
    u = 100.0 + np.array([0.0, 1.0, -1.0, 1.0])
    np.testing.assert_allclose(play_thresholds(u, 4), [0.0, 0.25, 0.5, 0.75])


def test_the_largest_record_sets_the_span():
    records = [np.array([0.0, 1.0]), np.array([0.0, -8.0, 0.0])]
    np.testing.assert_allclose(play_thresholds(records, 4), [0.0, 2.0, 4.0, 6.0])


def test_quantiles_of_equal_branches_are_the_grid():
    u = np.tile([-2.0, 2.0], 50)
    np.testing.assert_allclose(play_thresholds(u, 8, "quantile"), play_thresholds(u, 8))


def test_quantiles_are_dense_where_branches_end():
    small = np.tile([0.0, 1.0], 200)
    u = np.concatenate(([0.0, 10.0], small))
    thresholds = play_thresholds(u, 20, "quantile")
    assert np.count_nonzero(thresholds < 0.5) >= 16
    assert np.count_nonzero(play_thresholds(u, 20) < 0.5) == 1


def test_drive_offset_moves_the_zero():
    u = np.array([5.0, 7.0, 3.0, 6.0])
    for spacing in ("grid", "quantile"):
        np.testing.assert_allclose(
            play_thresholds(u, 6, spacing, drive_offset=5.0),
            play_thresholds(u - 5.0, 6, spacing),
        )


@pytest.mark.parametrize("spacing", ["grid", "quantile"])
@pytest.mark.parametrize("unit", [1e-200, 1e-6, 1e200])
def test_unit_equivariance(spacing, unit):
    u = np.random.default_rng(0).standard_normal(300)
    expected = play_thresholds(u, 7, spacing) * unit
    np.testing.assert_allclose(play_thresholds(u * unit, 7, spacing), expected, rtol=1e-12)


@pytest.mark.parametrize(("level", "span"), [(0.0, 1.0), (-4.0, 4.0)])
def test_a_drive_that_rests(level, span):
    np.testing.assert_allclose(play_thresholds(np.full(9, level), 2), [0.0, 0.5 * span])


def test_spacing_is_checked():
    with pytest.raises(ValueError, match="'spacing' parameter of play_thresholds"):
        play_thresholds([0.0, 1.0], 3, "log")
