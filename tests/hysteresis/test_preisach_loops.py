import numpy as np
import pytest

from skhyst.hysteresis import PreisachOperator
from skhyst.hysteresis import _preisach_loops as kernels

LEVELS = {
    "even": np.linspace(-1.0, 1.0, 9),
    "two": np.array([-0.3, 0.8]),
    "crowded": np.r_[-1.0, np.geomspace(1e-7, 1.5, 12)],
    "far": 1e6 + np.array([0.0, 0.4, 0.7, 3.0]),
}


@pytest.fixture(params=LEVELS)
def operator(request):
    levels = LEVELS[request.param]
    rng = np.random.default_rng(0)
    n = levels.size
    center = levels[0] + 0.37 * np.ptp(levels)
    return PreisachOperator(levels, rng.random(n * (n - 1) // 2), rng.random(n - 1), center=center)


def drive(operator, seed=1, n=300):
    low, high = operator.levels[[0, -1]]
    noise = np.random.default_rng(seed).normal(size=n)
    return 0.5 * (low + high) + 0.4 * (high - low) * noise


def plain(monkeypatch):
    """Let every kernel be called as plain Python, those it calls as well."""
    for name, function in list(vars(kernels).items()):
        if hasattr(function, "py_func"):
            monkeypatch.setattr(kernels, name, function.py_func)


def test_interval_of_a_value(operator):
    levels = operator.levels
    bins, scale = operator._bins
    rng = np.random.default_rng(2)
    values = np.r_[levels, rng.uniform(levels[0], levels[-1], 500)]
    found = [kernels.find_interval(v, levels, bins, scale) for v in values]
    expected = np.minimum(np.searchsorted(levels, values, side="right") - 1, levels.size - 2)
    np.testing.assert_array_equal(found, expected)


def test_compiled_equals_plain_python(operator, monkeypatch):
    u = drive(operator)
    du = np.random.default_rng(3).normal(size=(u.size, 2))
    y, state = operator.run(u, 1.0)
    rows, _ = operator.basis(u)
    _, dy = operator.linearize(u, du, 1.0)
    plain(monkeypatch)
    for name in ("build_bins", "everett_run", "everett_tangents", "find_interval"):
        monkeypatch.setattr(f"skhyst.hysteresis._preisach.{name}", getattr(kernels, name))
    for name in ("first_loading_table", "restore_values", "staircase_rows"):
        monkeypatch.setattr(f"skhyst.hysteresis._preisach.{name}", getattr(kernels, name))
    again = operator.unpack(operator.pack())
    other, other_state = again.run(u, 1.0)
    np.testing.assert_allclose(other, y, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(other_state.turning_points, state.turning_points)
    np.testing.assert_allclose(again.basis(u)[0], rows, rtol=0, atol=1e-12)
    np.testing.assert_allclose(again.linearize(u, du, 1.0)[1], dy, rtol=1e-9, atol=1e-9)


def test_everett_sum_equals_the_areas_of_the_cells(operator):
    """Two ways that share the turning points only."""
    u = drive(operator, n=3000)
    y, _ = operator.run(u, 1.0)
    rows, _ = operator.basis(u)
    np.testing.assert_allclose(rows @ operator.pack(), y, rtol=0, atol=1e-9)
    assert np.abs(rows).max() <= 1.0 + 1e-12


def test_slope_is_the_derivative_of_the_value(operator):
    levels, everett, diagonal, _, bins, scale = operator._tables
    rng = np.random.default_rng(5)
    span = np.ptp(levels)
    for e, v in rng.uniform(levels[0], levels[-1], (200, 2)):
        i = kernels.find_interval(e, levels, bins, scale)
        j = kernels.find_interval(v, levels, bins, scale)
        width = levels[j + 1] - levels[j]
        h = 1e-4 * width
        above, below = (
            kernels.everett_value(e, i, w, j, levels, everett, diagonal) for w in (v + h, v - h)
        )
        if abs(v - e) < 2 * h:
            continue
        slope = kernels.everett_slope(e, i, v, j, levels, everett, diagonal)
        # quadratic at most, so the central difference is exact but for rounding
        tolerance = 1e-10 * np.abs(everett).max() / h + 1e-9 * np.abs(levels).max() / span
        assert (above - below) / (2 * h) * np.sign(v - e) == pytest.approx(slope, abs=tolerance)


def test_first_loading_ends_at_both_saturations(operator):
    total = operator.weights.sum() + operator.reversible.sum()
    _, _, _, loading, _, _ = operator._tables
    assert loading[0, 1] == -total
    assert kernels.first_loading(operator.levels[-1], loading) == pytest.approx(total, rel=1e-10)
