import numpy as np
import pytest

from skhyst.hysteresis._prandtl_ishlinskii_loops import (
    branch,
    build_table,
    compress_stack,
    find_row,
    restore_stack,
    stack_size,
    turning_point_run,
    virgin,
)
from skhyst.operators import play_basis

THRESHOLDS = {
    "one": np.array([0.0]),
    "one_positive": np.array([0.7]),
    "even": np.linspace(0.0, 2.0, 25),
    "crowded": np.append(0.0, np.geomspace(1e-9, 2.0, 60)),
    "crowded_far": 2.0 - np.geomspace(1.0, 1e-9, 60),
    "repeated": np.array([0.0, 0.5, 0.5, 0.5, 1.0, 1.0]),
    "all_zero": np.zeros(3),
    "tiny": np.linspace(0.0, 1e-305, 4),
}


@pytest.fixture(params=THRESHOLDS)
def thresholds(request):
    return THRESHOLDS[request.param]


def tables(r, w, build=build_table):
    table, bins = np.empty((r.size + 1, 4)), np.empty(16 * r.size + 2, np.int32)
    return table, bins, build(r, w, table, bins)


def weights(r):
    return np.random.default_rng(3).random(r.size) + 0.1


def drives():
    rng = np.random.default_rng(4)
    k = np.arange(4000)
    return {
        "noise": rng.standard_normal(4000),
        "walk": 0.1 * np.cumsum(rng.standard_normal(4000)),
        "decay": 3.0 * np.cos(2.5 * k) * (1.0 - k / 4000),
        "growth": 3.0 * np.cos(2.5 * k) * k / 4000,
        "steps": np.round(rng.standard_normal(4000)),
    }


def simulate(kernel, u, r, w, chunk=None):
    table, bins, scale = tables(r, w)
    points, values = np.zeros((2, stack_size(r.size)))
    y, top, last = np.empty(u.size), 0, 0.0
    for start in range(0, u.size, chunk or u.size):
        part = slice(start, start + (chunk or u.size))
        top = restore_stack(points[1 : top + 1].copy(), points, values, table, bins, scale)
        top, last = kernel(
            u[part], 0.3, -1.0, table, bins, scale, points, values, top, last, y[part]
        )
    return y, points[1 : top + 1], last


@pytest.mark.parametrize("drive", drives())
def test_turning_points_equal_the_sum_of_plays(thresholds, drive):
    u, w = drives()[drive], weights(thresholds)
    plays = np.empty((u.size, thresholds.size))
    play_basis(u - 0.3, thresholds, np.zeros(thresholds.size), plays)
    y, _, _ = simulate(turning_point_run, u, thresholds, w)
    expected = plays @ w - 1.0
    np.testing.assert_allclose(y, expected, rtol=0, atol=1e-12 * np.ptp(expected))


@pytest.mark.parametrize("drive", drives())
def test_chunks_equal_the_whole_to_the_bit(thresholds, drive):
    u, w = drives()[drive], weights(thresholds)
    whole, points, last = simulate(turning_point_run, u, thresholds, w)
    parts, points_of_parts, last_of_parts = simulate(turning_point_run, u, thresholds, w, chunk=7)
    np.testing.assert_array_equal(parts, whole)
    np.testing.assert_array_equal(points_of_parts, points)
    assert last_of_parts == last


@pytest.mark.parametrize("drive", ["noise", "decay", "steps"])
def test_compiled_equals_python(thresholds, drive):
    u, w = drives()[drive][:1500], weights(thresholds)
    compiled = simulate(turning_point_run, u, thresholds, w)
    python = simulate(turning_point_run.py_func, u, thresholds, w)
    for a, b in zip(compiled, python, strict=True):
        np.testing.assert_array_equal(a, b)


def test_compiled_tables_equal_python(thresholds):
    w = weights(thresholds)
    for a, b in zip(tables(thresholds, w), tables(thresholds, w, build_table.py_func), strict=True):
        np.testing.assert_array_equal(a, b)
    table, bins, scale = tables(thresholds, w)
    for kernel in (branch, virgin):
        assert kernel(0.9, table, bins, scale) == kernel.py_func(0.9, table, bins, scale)


@pytest.mark.parametrize("kernel", [find_row, find_row.py_func])
def test_row_counts_the_thresholds_below(thresholds, kernel):
    table, bins, scale = tables(thresholds, weights(thresholds))
    doubled = 2.0 * thresholds
    rng = np.random.default_rng(5)
    distances = np.concatenate(
        (
            doubled,
            np.nextafter(doubled, np.inf),
            np.nextafter(doubled, 0.0),
            rng.random(300) * 5.0,
            doubled[-1] * rng.random(100),
            [0.0, np.inf],
        )
    )
    for distance in distances:
        row = kernel(distance, table, bins, scale)
        assert row == np.count_nonzero(doubled < distance)


def test_first_loading_is_the_sum_of_dead_zones(thresholds):
    w = weights(thresholds)
    table, bins, scale = tables(thresholds, w)
    for v in (-3.0, -0.4, 0.0, 0.7, 2.5):
        expected = np.sign(v) * np.sum(w * np.maximum(abs(v) - thresholds, 0.0))
        assert virgin(v, table, bins, scale) == pytest.approx(expected, rel=1e-13)


@pytest.mark.parametrize("compress", [compress_stack, compress_stack.py_func])
def test_compression_changes_no_play(thresholds, compress):
    nested = 3.0 * (-1.0) ** np.arange(400) * np.linspace(1.0, 0.0, 400)
    table, bins, scale = tables(thresholds, weights(thresholds))
    points, values = np.zeros((2, 500))
    top = restore_stack(nested, points, values, table, bins, scale)
    assert top == nested.size
    top = compress(points, values, top, table, bins, scale)
    assert top <= 2 * (thresholds.size + 1) + 2
    ends = []
    for path in (nested, points[1 : top + 1].copy()):
        plays = np.empty((path.size, thresholds.size))
        play_basis(path, thresholds, np.zeros(thresholds.size), plays)
        ends.append(plays[-1])
    np.testing.assert_array_equal(*ends)


def test_stack_of_a_long_decay_stays_bounded(thresholds):
    u = 3.0 * (-1.0) ** np.arange(20_000) * np.linspace(1.0, 0.0, 20_000)
    _, points, _ = simulate(turning_point_run, u, thresholds, weights(thresholds))
    assert points.size <= stack_size(thresholds.size)


@pytest.mark.parametrize("restore", [restore_stack, restore_stack.py_func])
def test_a_stack_that_is_not_nested_is_cut(thresholds, restore):
    table, bins, scale = tables(thresholds, weights(thresholds))
    points, values = np.zeros((2, 20))
    broken = np.array([3.0, -2.0, 1.0, -2.5])
    assert restore(broken, points, values, table, bins, scale) == 3


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite_stay_harmless(thresholds, value):
    u = np.random.default_rng(6).standard_normal(500)
    u[100::50] = value
    y, points, _ = simulate(turning_point_run, u, thresholds, weights(thresholds))
    clean, _, _ = simulate(turning_point_run, u[:100], thresholds, weights(thresholds))
    np.testing.assert_array_equal(y[:100], clean)
    assert points.size <= stack_size(thresholds.size)
