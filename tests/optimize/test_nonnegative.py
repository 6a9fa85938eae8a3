import numpy as np
import pytest
from scipy.optimize import nnls

from skhyst.optimize import nonnegative_minimum


@pytest.mark.parametrize("n", [1, 5, 60, 300])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_agrees_with_nnls(n, seed):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2 * n, n)), rng.normal(size=2 * n)
    a += 0.7 * a[:, :1]  # correlated columns
    a /= np.linalg.norm(a, axis=0)
    x, free = nonnegative_minimum(a.T @ a, -a.T @ b)
    expected, _ = nnls(a, b)
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
