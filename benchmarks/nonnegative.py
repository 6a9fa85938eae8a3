"""Non-negative least squares beside SciPy's: ``python benchmarks/nonnegative.py``.

The quadratic programs are those of Preisach models of several sizes, fitted to one recording.
Printed are the unknowns, the seconds of either solver in one thread (the best of several runs), and
the largest difference of their solutions, relative to the largest unknown. `scipy.optimize.nnls`
gets the Cholesky factor of the program, whose time counts as its own.
"""

import time
from unittest import mock

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import nnls
from threadpoolctl import threadpool_limits

from skhyst.hysteresis import Preisach, _relay_grid
from skhyst.optimize import nonnegative_minimum

LEVELS = 10, 20, 40, 60
REPEATS = 3


def programs(levels=LEVELS, n_samples=4000):
    """Return the Hessian and the gradient of the programs of models with so many levels."""
    rng = np.random.default_rng(0)
    u = np.cumsum(rng.standard_normal(n_samples))
    u /= np.abs(u).max()
    y = np.tanh(2.0 * u) + 0.2 * np.convolve(u, np.ones(30) / 30)[:n_samples]
    y += 0.01 * rng.standard_normal(n_samples)
    with mock.patch.object(_relay_grid, "nonnegative_minimum", wraps=nonnegative_minimum) as seen:
        for n in levels:
            Preisach(n).fit(u[:, None], y)
    return [call.args[:2] for call in seen.call_args_list]


def by_scipy(hessian, gradient):
    """Return the minimum by SciPy's active sets."""
    factor = cholesky(hessian)
    right = solve_triangular(factor, -gradient, trans="T")
    return nnls(factor, right, maxiter=100 * len(gradient))[0]


def timed(solve, *program):
    """Return a solution and the seconds of the fastest run."""
    seconds = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        found = solve(*program)
        seconds.append(time.perf_counter() - start)
    return found, min(seconds)


def main():
    print("unknowns    skhyst      SciPy       difference")
    with threadpool_limits(1):
        for program in programs():
            (own, _), own_seconds = timed(nonnegative_minimum, *program)
            other, other_seconds = timed(by_scipy, *program)
            difference = np.abs(own - other).max() / own.max()
            print(f"{len(own):8d}{own_seconds:10.4f} s{other_seconds:10.4f} s{difference:14.0e}")


if __name__ == "__main__":
    main()
