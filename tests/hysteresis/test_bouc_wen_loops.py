"""The tabulated Bouc-Wen curve: cells fit together, compiled equals plain Python."""

import numpy as np
import pytest

from skhyst.hysteresis._bouc_wen_curve import (
    GRID,
    N_BINS,
    build_curve,
    curve_run,
    curve_tangents,
    polynomial,
    slope_of,
)

NODES = GRID[0]
N_CELLS = len(NODES) - 1


def tables(exponent, ratio, behind=0.7, ahead=0.5, build=build_curve):
    rows = N_CELLS + 2
    made = (
        np.empty(rows),
        np.empty((rows, 9)),
        np.empty((rows, 12)),
        np.empty(N_BINS + 1, dtype=np.int16),
        np.empty((1, 3)),
    )
    build(*GRID[:-1], exponent, ratio, behind, ahead, 0, *made)
    return made


@pytest.fixture(params=[(1.0, 0.6), (1.7, 0.0), (0.6, 2.0), (6.0, 1.0)], ids=str)
def curve_parameters(request):
    return request.param


def test_grid():
    nodes, logs, log_points, measure, zero, value_bins = GRID
    assert nodes[0] == -1.0
    assert nodes[zero] == 0.0
    assert np.all(np.diff(nodes) > 0.0)
    inner = np.flatnonzero(nodes)
    np.testing.assert_allclose(np.exp(logs[inner]), np.abs(nodes[inner]), rtol=1e-13)
    np.testing.assert_allclose(measure.sum(axis=1), np.diff(nodes), rtol=1e-6)
    low, high = np.minimum(*np.abs([nodes[:-1], nodes[1:]])), np.abs(nodes).max()
    assert np.all(np.exp(log_points) > low[:, None])
    assert np.all(np.exp(log_points) <= high)
    assert value_bins[0] == 0
    assert np.all(np.diff(value_bins) >= 0)


def test_cells_join_with_equal_slopes(curve_parameters):
    places, curve, changes, _, _ = tables(*curve_parameters)
    assert np.all(np.diff(places) > 0.0)
    for cell in range(N_CELLS - 1):
        row, following = curve[cell], curve[cell + 1]
        assert polynomial(row, 1.0) == pytest.approx(following[1], abs=1e-15)
        if NODES[cell + 1] != 0.0:  # where the limits differ, so does the scale
            slope = slope_of(row, 1.0) * row[0]
            assert slope == pytest.approx(following[2] * following[0], rel=1e-8, abs=1e-12)
        for k in (0, 6):
            end = changes[cell, k : k + 6].sum()
            assert end == pytest.approx(changes[cell + 1, k], rel=1e-9, abs=1e-15)


def follow(made, u, z=0.0, last=0.0, kernel=curve_run, traced=True):
    places, curve, _, bins, scales = made
    y, trace = np.empty(len(u)), np.full((len(u) if traced else 0, 5), np.nan)
    kernel(u, 0.3, -1.2, 0.1, places, curve, bins, scales, GRID[-1], z, last, y, trace)
    return y, trace


def test_a_branch_begins_at_the_value_before_it(curve_parameters):
    made = tables(*curve_parameters)
    places, curve = made[:2]
    values = np.concatenate([np.linspace(-0.7, 0.49, 301), 0.5 - np.geomspace(1e-14, 0.1, 40)])
    for z in np.append(values, [-1e-9, 1e-9, 0.0]):
        _, trace = follow(made, np.array([1e-3]), z=z)
        cell, part = int(trace[0, 3]), trace[0, 4]
        assert polynomial(curve[cell], part) == pytest.approx(z, abs=1e-15)
    beyond = [follow(made, np.array([1e-3]), z=z)[1][0, 3] for z in (-9.0, 9.0)]
    assert beyond == [0, len(places) - 2]


def test_trace(curve_parameters):
    made = tables(*curve_parameters)
    u = np.array([0.0, 0.2, 0.5, 0.5, 0.4, 0.1, 0.3])
    y, trace = follow(made, u)
    np.testing.assert_array_equal(trace[:, 0], [0, 1, 1, 1, -1, -1, 1])
    np.testing.assert_array_equal(trace[:, 3] >= 0, [False, True, False, False, True, False, True])
    for k in range(1, len(u)):
        z = trace[k, 0] * polynomial(made[1][int(trace[k, 1])], trace[k, 2])
        assert y[k] == 0.3 * u[k] - 1.2 * z + 0.1
    np.testing.assert_array_equal(y, follow(made, u, traced=False)[0])


def test_bins_never_lead_beyond_a_cell(curve_parameters):
    places, _, _, bins, scales = tables(*curve_parameters)
    rng = np.random.default_rng(0)
    samples = rng.uniform(places[0], places[N_CELLS], 2000)
    first = bins[((samples - places[0]) * scales[0, 0]).astype(int)]
    assert np.all(places[first] <= samples + 1e-12)


def test_compiled_equals_plain_python(curve_parameters):
    plain = tables(*curve_parameters, build=build_curve.py_func)
    compiled = tables(*curve_parameters)
    for a, b in zip(plain, compiled, strict=True):
        np.testing.assert_allclose(a[:-1], b[:-1], rtol=1e-8, atol=1e-15)

    rng = np.random.default_rng(1)
    u = 0.5 * np.cumsum(rng.normal(size=120))
    u[50:55] = u[50]
    du = rng.normal(size=(120, 2))
    found = [follow(compiled, u, 0.1, 0.2, kernel) for kernel in (curve_run, curve_run.py_func)]
    for a, b in zip(*found, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-13)

    _, trace = follow(compiled, u)
    chain, limits = rng.normal(size=(2, 3, 4)), np.array([0.5, 0.7])
    dy = np.empty((2, 120, 9))
    for part, kernel in zip(dy, (curve_tangents, curve_tangents.py_func), strict=True):
        kernel(u, du, 0.3, -1.2, *compiled[:3], limits, chain, trace, part)
    np.testing.assert_allclose(dy[0], dy[1], rtol=1e-9, atol=1e-11)


def test_not_a_number_does_no_harm():
    made = tables(1.3, 0.5)
    assert follow(made, np.array([0.1, 0.3, -0.2]), z=np.nan)[0].shape == (3,)
    assert np.isnan(follow(made, np.full(3, np.nan))[0]).all()
