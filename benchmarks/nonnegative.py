"""Least squares with bounds, compared with SciPy's: ``python benchmarks/nonnegative.py``.

First the quadratic programs of Preisach models of several sizes, fitted to one recording: as they
are, with every column doubled (collinear), and with a response that leaves every bound a multiplier
of zero (ties). `scipy.optimize.nnls` gets the Cholesky factor of the program, whose time counts as
its own. Then the steps of cascades of several sizes, which `bounded_step` finds by `nnls`, and
`scipy.optimize.lsq_linear` with the method "bvls". Printed are the unknowns, the seconds of either
solver in one thread (the best of several runs), and the largest difference of the responses of
their solutions, relative to the larger.
"""

import time
from unittest import mock

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import lsq_linear, nnls
from threadpoolctl import threadpool_limits

from skhyst.compose import Cascade
from skhyst.hysteresis import PrandtlIshlinskii, Preisach, _relay_grid
from skhyst.linear import FirstOrderLag
from skhyst.optimize import _variable_projection, bounded_step, nonnegative_minimum

LEVELS = 10, 20, 40, 60
PLAYS = 5, 20, 40
REPEATS = 3
RIDGE = 1e-12  # that of the models


def recording(n_samples=4000):
    """Return a drive and a response with a loop and noise."""
    rng = np.random.default_rng(0)
    u = np.cumsum(rng.standard_normal(n_samples))
    u /= np.abs(u).max()
    y = np.tanh(2.0 * u) + 0.2 * np.convolve(u, np.ones(30) / 30)[:n_samples]
    return u, y + 0.01 * rng.standard_normal(n_samples)


def programs(levels=LEVELS):
    """Yield name, Hessian and gradient of the programs of models with so many levels."""
    u, y = recording()
    with mock.patch.object(_relay_grid, "nonnegative_minimum", wraps=nonnegative_minimum) as seen:
        for n in levels:
            Preisach(n).fit(u[:, None], y)
    for hessian, gradient, _ in (call.args for call in seen.call_args_list):
        yield "as fitted", hessian, gradient
        if len(gradient) < 1000:
            double = np.kron(np.ones((2, 2)), hessian) + RIDGE * np.eye(2 * len(hessian))
            yield "collinear", double, np.concatenate([gradient, gradient])
            yield "ties", hessian, -hessian @ nonnegative_minimum(hessian, gradient)[0]


def steps(plays=PLAYS):
    """Return Hessian, gradient and bounds of a step of cascades, those that bounds cut short."""
    u, y = recording()
    found = []
    with mock.patch.object(_variable_projection, "bounded_step", wraps=bounded_step) as seen:
        for n in plays:
            seen.reset_mock()
            Cascade([("h", PrandtlIshlinskii(n)), ("lag", FirstOrderLag())], dt=1e-3).fit(
                u[:, None], y
            )
            largest = max(len(call.args[1]) for call in seen.call_args_list)
            found += [c.args for c in seen.call_args_list if len(c.args[1]) == largest][:1]
    return found


def by_nnls(hessian, gradient):
    """Return the minimum by SciPy's active sets."""
    factor = cholesky(hessian)
    right = solve_triangular(factor, -gradient, trans="T")
    return nnls(factor, right, maxiter=100 * len(gradient))[0]


def by_bvls(hessian, gradient, lower, upper):
    """Return the step by SciPy's least squares between bounds; where they meet, it is zero."""
    moves = (np.diag(hessian) > 0.0) & (lower < upper)
    scale = np.sqrt(np.diag(hessian)[moves])
    h = hessian[np.ix_(moves, moves)] / np.outer(scale, scale)
    factor = cholesky(h + RIDGE * np.eye(len(h)))
    right = solve_triangular(factor, -gradient[moves] / scale, trans="T")
    bounds = lower[moves] * scale, upper[moves] * scale
    step = np.zeros(len(gradient))
    step[moves] = lsq_linear(factor, right, bounds, "bvls").x / scale
    return step


def timed(solve, *program):
    """Return a solution and the seconds of the fastest run."""
    seconds = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        found = solve(*program)
        seconds.append(time.perf_counter() - start)
    return found, min(seconds)


def compare(name, own, other, *program):
    """Print one line."""
    (mine, seconds), (theirs, other_seconds) = timed(own, *program), timed(other, *program)

    def size(x):
        return np.sqrt(x @ program[0] @ x)

    difference = size(mine - theirs) / max(size(mine), size(theirs))
    line = f"{name:12s}{len(mine):6d}{seconds:12.6f} s{other_seconds:12.6f} s{difference:10.0e}"
    print(line, flush=True)


def main():
    with threadpool_limits(1):
        print("programs, unknowns, skhyst, nnls, difference")
        for name, *program in programs():
            compare(name, lambda *own: nonnegative_minimum(*own)[0], by_nnls, *program)
        print("steps, unknowns, skhyst (nnls), lsq_linear, difference")
        for program in steps():
            compare("bounded", bounded_step, by_bvls, *program)


if __name__ == "__main__":
    main()
