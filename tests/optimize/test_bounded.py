"""Bounded quadratic programs against SciPy."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear, nnls

from skhyst.optimize import bounded_step, nonnegative_minimum


def objective(a, r, s):
    return 0.5 * np.sum((a @ s + r) ** 2)


def make_problem(seed, n, degenerate):
    rng = np.random.default_rng(seed)
    a, r = rng.normal(size=(n + rng.integers(0, 20), n)), None
    if "duplicate" in degenerate and n > 1:
        a[:, -1] = a[:, 0]
    if "zero" in degenerate:
        a[:, n // 2] = 0.0
    if "wide" in degenerate:
        a = a[: max(n // 2, 1)]
    if "collinear" in degenerate and n > 2:
        a[:, 1] = a[:, 0] * 0.3 - a[:, 2]
    if "scales" in degenerate:  # last: the normal equations do not hold what differs by 1e-9 only
        a = a * 10.0 ** rng.uniform(-6, 6, n)
    r = rng.normal(size=len(a))
    size = 1.0 / np.maximum(np.linalg.norm(a, axis=0), 1e-3)
    lower = -np.where(rng.random(n) < 0.3, np.inf, size * rng.exponential(size=n))
    upper = np.where(rng.random(n) < 0.3, np.inf, size * rng.exponential(size=n))
    lower[rng.random(n) < 0.3] = 0.0
    return a, r, lower, upper


KINDS = ["duplicate", "zero", "wide", "scales", "collinear"]


@settings(deadline=None, max_examples=200)
@given(
    seed=st.integers(0, 10**6),
    n=st.integers(1, 12),
    degenerate=st.lists(st.sampled_from(KINDS), max_size=2, unique=True),
)
def test_reaches_the_minimum_of_lsq_linear(seed, n, degenerate):
    a, r, lower, upper = make_problem(seed, n, degenerate)
    step = bounded_step(a.T @ a, a.T @ r, lower, upper)
    assert np.all(step >= lower * (1 + 1e-12))
    assert np.all(step <= upper * (1 + 1e-12))
    scale = np.maximum(np.linalg.norm(a, axis=0), 1e-300)  # SciPy stops early on bad scales
    reference = lsq_linear(
        a / scale, -r, bounds=(lower * scale, np.maximum(upper * scale, 1e-300)), method="bvls"
    )
    assume(np.abs(reference.x).max() < 1e9)  # SciPy runs off along equal columns at times
    best = 0.5 * np.sum(reference.fun**2)
    assert objective(a, r, step) <= best + 1e-9 * 0.5 * (r @ r)


@settings(deadline=None, max_examples=200)
@given(
    seed=st.integers(0, 10**6),
    n=st.integers(1, 30),
    degenerate=st.lists(st.sampled_from(KINDS), max_size=2, unique=True),
    ties=st.booleans(),
)
def test_conditions_of_a_minimum(seed, n, degenerate, ties):
    """Karush, Kuhn and Tucker: a multiplier is zero between bounds, of the right sign at one."""
    a, r, lower, upper = make_problem(seed, n, degenerate)
    if ties:  # a minimum whose bounds hold with multipliers of zero
        middle = np.where(np.isfinite(upper), upper, np.random.default_rng(seed).normal(size=n))
        r = -a @ np.clip(middle, lower, upper)
    s = bounded_step(a.T @ a, a.T @ r, lower, upper)
    assert_minimum(a, r, s, lower, upper)
    if "wide" not in degenerate:  # it is given definite programs only
        a /= np.maximum(np.linalg.norm(a, axis=0), 1e-150)
        x, free = nonnegative_minimum(a.T @ a + 1e-12 * np.eye(n), a.T @ r, np.isfinite(lower))
        assert_minimum(a, r, x, np.where(np.isfinite(lower), 0.0, -np.inf), np.inf)
        assert np.all(free | (x == 0.0))


def assert_minimum(a, r, s, lower, upper):
    size = np.maximum(np.linalg.norm(a, axis=0), 1e-150)
    near = 1e-9 * np.abs(s * size).max()
    below, above = (s - lower) * size, (upper - s) * size
    assert min(below.min(), above.min()) >= -near
    slope = a.T @ (a @ s + r) / size
    tolerance = 1e-9 * (np.linalg.norm(r) + np.abs(s * size).max())
    assert np.all(slope[above > near] >= -tolerance)
    assert np.all(slope[below > near] <= tolerance)


def test_pinned_unknowns_stay():
    a = np.random.default_rng(0).normal(size=(20, 4))
    b = np.ones(20)
    bound = np.array([0.0, np.inf, 0.0, np.inf])
    step = bounded_step(a.T @ a, -a.T @ b, -bound, bound)
    np.testing.assert_array_equal(step[[0, 2]], 0.0)
    np.testing.assert_allclose(step[[1, 3]], np.linalg.lstsq(a[:, [1, 3]], b, rcond=None)[0])


def test_nothing_to_do():
    assert bounded_step(np.empty((0, 0)), np.empty(0), np.empty(0), np.empty(0)).shape == (0,)
    free = np.full(2, np.inf)
    np.testing.assert_array_equal(bounded_step(np.zeros((2, 2)), np.zeros(2), -free, free), 0.0)


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_units_do_not_matter(unit):
    a, r, lower, upper = make_problem(3, 6, ["duplicate"])
    units = np.array([unit, 1.0, 1 / unit, 1.0, unit**0.5, 1.0])
    step = bounded_step(a.T @ a, a.T @ r, lower, upper)
    a = a * units
    other = bounded_step(a.T @ a, a.T @ r, lower / units, upper / units)
    assert objective(a, r, other) == pytest.approx(objective(a / units, r, step), rel=1e-9)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("rounding", [1e-318, -1e-17])
def test_an_unknown_that_moves_nothing_but_rounding_stays(rounding):
    hessian = np.diag([1.0, rounding])
    step = bounded_step(hessian, np.array([-2.0, -1e-170]), *np.array([[-9.0] * 2, [9.0] * 2]))
    np.testing.assert_allclose(step, [2.0, 0.0], rtol=1e-12)


def test_rounding_that_makes_the_hessian_indefinite_does_no_harm():
    hessian = np.array([[1.0, 1.0 + 1e-12], [1.0 + 1e-12, 1.0]])  # two equal columns
    step = bounded_step(hessian, -np.ones(2), np.full(2, -np.inf), np.array([0.3, np.inf]))
    assert step[0] <= 0.3
    assert step.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("n", [1, 5, 60, 300])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_agrees_with_nnls(n, seed):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2 * n, n)), rng.normal(size=2 * n)
    a += 0.7 * a[:, :1]  # correlated columns
    a /= np.linalg.norm(a, axis=0)
    expected, _ = nnls(a, b)
    if n <= 60:
        step = bounded_step(a.T @ a, -a.T @ b, np.zeros(n), np.full(n, np.inf))
        np.testing.assert_allclose(step, expected, atol=1e-8)
    x, free = nonnegative_minimum(a.T @ a, -a.T @ b)
    np.testing.assert_allclose(x, expected, rtol=0, atol=1e-9 * np.abs(expected).max(initial=1.0))
    np.testing.assert_array_equal(free, expected > 0.0)


def test_cumulative_columns():
    """Neighbouring columns that nearly agree, as those of a grid of relays do."""
    rng = np.random.default_rng(3)
    a = np.tril(np.ones((150, 150)))
    a /= np.linalg.norm(a, axis=0)
    b = a @ np.maximum(rng.normal(size=150), 0.0) + 0.1 * rng.normal(size=150)
    x, _ = nonnegative_minimum(a.T @ a, -a.T @ b)
    expected, residual = nnls(a, b, maxiter=10_000)
    assert np.linalg.norm(a @ x - b) == pytest.approx(residual, rel=1e-9)
    np.testing.assert_allclose(x, expected, rtol=0, atol=1e-6)


def test_free_unknowns():
    rng = np.random.default_rng(4)
    a, b = rng.normal(size=(40, 6)), rng.normal(size=40)
    bounded = np.array([True, False, True, False, True, False])
    x, free = nonnegative_minimum(a.T @ a, -a.T @ b, bounded)
    expected, _ = nnls(np.column_stack((a, -a[:, ~bounded])), b)
    expected, negative = expected[:6], expected[6:]
    expected[~bounded] -= negative
    np.testing.assert_allclose(x, expected, rtol=0, atol=1e-10)
    assert free[~bounded].all()
    x, _ = nonnegative_minimum(a.T @ a, -a.T @ b, np.zeros(6, dtype=bool))
    np.testing.assert_allclose(x, np.linalg.lstsq(a, b)[0], rtol=0, atol=1e-10)


@pytest.mark.parametrize("largest", [1e304, np.inf])
def test_a_column_that_overflows_has_no_step(largest):
    """And the others have theirs; SciPy would end the process on the rest of such a problem."""
    step = bounded_step(np.diag([largest, 4.0]), np.array([0.0, -8.0]), np.zeros(2), np.ones(2))
    assert step.tolist() == [0.0, 1.0]
    step = bounded_step(np.full((2, 2), np.inf), np.ones(2), np.zeros(2), np.ones(2))
    assert step.tolist() == [0.0, 0.0]
    unknown = bounded_step(np.eye(2), np.array([np.nan, 0.0]), -np.ones(2), np.ones(2))
    assert np.isnan(unknown[0])
