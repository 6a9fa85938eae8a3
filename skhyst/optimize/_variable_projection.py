r"""Separable least squares from normal equations.

The parameters x = (theta, c) minimise ``|r(theta, c)|^2`` where r is affine in c. Golub and Pereyra
(SIAM J. Numer. Anal. 10, 1973) eliminate c; with Kaufman's simplification (BIT 15, 1975) the step
in theta equals that of a Gauss-Newton step in all of x, followed by the exact solution for c
(Ruhe and Wedin, SIAM Review 22, 1980, algorithm 3). That is what is done here, damped as by
Levenberg and Marquardt with Nielsen's update, within bounds.

Everything that an iteration needs, and that a fold of a cross-validation needs, stands in the Gram
matrix of the columns ``[J, r]``, summed over stretches of the data. One pass over the
records yields it, so memory does not grow with their length and a fold costs no further pass. This
is why SciPy's ``least_squares`` is not used here: it wants the Jacobian itself, row by row.
"""

import time
from dataclasses import dataclass, field

import numpy as np

from ._bounded import bounded_step

__all__ = [
    "LARGEST_LOG_STEP",
    "Solution",
    "predicted_cost",
    "single_step",
    "solve_linear",
    "variable_projection",
]

LARGEST_LOG_STEP = 1.5  # a positive parameter changes by at most a factor e^1.5 a step
_CANCELLED = 1e-10  # part that an exact solution may leave before rounding shows in it
_STALE = 0.1  # part by which the exact solution of the start may reduce the sum of squares
_PARTS_OF_STEP = (1.0, 0.25, 0.06)


@dataclass
class Solution:
    """Outcome of one run of the solver, in the coordinates of the problem."""

    x: np.ndarray
    cost: float
    gram: np.ndarray
    n_evaluations: int
    converged: bool
    message: str
    seconds: float
    history: list = field(default_factory=list)
    damping: list = field(default_factory=list)  # one value an entry of the history, if known


def variable_projection(
    problem, x0, *, select=None, blocks=None, tolerance=1e-8, max_evaluations=100, callback=None
):
    """Minimise the sum of squares of a problem.

    Parameters
    ----------
    problem : OperatorProblem
        Gives ``evaluate(x, select=select)``, ``total(blocks, select)``, ``lower``, ``upper``,
        ``linear``, ``log``.
    x0 : ndarray of shape (n,)
        Start; its linear part is immaterial where the problem determines it.
    select : ndarray of bool of shape (n_segments,), optional
        The segments to fit; all by default.
    blocks : ndarray, optional
        ``problem.evaluate(x0, select=select)`` where it is known already.
    tolerance : float, default=1e-8
        Stops when a step would reduce, or has reduced, the sum of squares by less than this part.
    max_evaluations : int, default=100
        Budget of simulations of all records.
    callback : callable, optional
        Called with the number of evaluations and the cost after each accepted step; a true value
        ends the search.

    Returns
    -------
    Solution
    """
    start = time.perf_counter()
    lower, upper, linear = problem.lower, problem.upper, problem.linear
    x = np.clip(np.asarray(x0, dtype=float), lower, upper)
    n_evaluations = int(blocks is None)
    gram = problem.total(problem.evaluate(x, select=select) if blocks is None else blocks, select)
    history = []

    if not np.isfinite(gram).all():
        message = "The model is not finite at the starting values."
        return Solution(x, np.inf, gram, 1, False, message, time.perf_counter() - start)
    if linear.any():
        before = gram[-1, -1]
        x, gram = solve_linear(problem, x, gram)
        # the other columns were taken at the old linear part
        if gram[-1, -1] < before * (1.0 - _STALE):
            gram = problem.total(problem.evaluate(x, select=select), select)
            n_evaluations += 1
    history.append((n_evaluations, gram[-1, -1]))
    damping, factor = 1e-4, 2.0
    floor = 1e-28 * problem.scale
    converged, message = linear.all(), "All parameters are linear and were solved exactly."
    while not converged:
        if n_evaluations >= max_evaluations:
            message = f"The budget of {max_evaluations} evaluations is used up."
            break
        cost = gram[-1, -1]
        step, predicted = _step(problem, x, gram, damping)
        if not predicted > tolerance * cost + floor:
            converged, message = True, "No step reduces the sum of squares noticeably."
            break
        trial = np.clip(x + step, lower, upper)
        trial_gram = problem.total(problem.evaluate(trial, select=select), select)
        n_evaluations += 1
        if np.isfinite(trial_gram).all():
            before = trial_gram[-1, -1]
            trial, trial_gram = solve_linear(problem, trial, trial_gram)
            if trial_gram[-1, -1] < _CANCELLED * before:
                trial_gram = problem.total(problem.evaluate(trial, select=select), select)
                n_evaluations += 1
            gain = cost - trial_gram[-1, -1]
        else:
            gain = -np.inf
        if gain > 0.0:
            ratio = gain / predicted
            damping = max(damping * max(1.0 / 5.0, 1.0 - (2.0 * ratio - 1.0) ** 3), 1e-12)
            factor = 2.0
            x, gram = trial, trial_gram
            history.append((n_evaluations, gram[-1, -1]))
            if callback is not None and callback(n_evaluations, gram[-1, -1]):
                message = "The callback has ended the search."
                break
            if gain <= tolerance * cost + floor:
                converged, message = True, "The sum of squares no longer changes."
        else:
            damping *= factor
            factor *= 2.0
            if damping > 1e12:
                converged, message = True, "No step reduces the sum of squares."
    seconds = time.perf_counter() - start
    return Solution(
        x, gram[-1, -1], gram, n_evaluations, bool(converged), message, seconds, history
    )


def predicted_cost(problem, x):
    """Return the sum of squares that one Gauss-Newton step from ``x`` promises.

    The linear parameters are solved first; the promise is infinite where the model is not finite.
    """
    gram = problem.total(problem.evaluate(x))
    if not np.isfinite(gram).all():
        return np.inf
    before = gram[-1, -1]
    x, gram = solve_linear(problem, x, gram)
    if gram[-1, -1] < before * (1.0 - _STALE):
        gram = problem.total(problem.evaluate(x))
        if not np.isfinite(gram).all():
            return np.inf
    return max(gram[-1, -1] - _step(problem, x, gram)[1], 0.0)


def single_step(problem, x, blocks, select):
    """Return what one Gauss-Newton step for some segments makes of the solution for all.

    Nothing is differentiated again: a step that does not reduce the sum of squares is shortened,
    and where that does not help either the solution for all is returned.

    Parameters
    ----------
    problem : OperatorProblem
    x : ndarray of shape (n,)
        Solution for all segments.
    blocks : ndarray
        ``problem.evaluate(x)``, or of the selected segments.
    select : ndarray of bool of shape (n_segments,)
        The segments to fit.
    """
    gram = problem.total(blocks, select)
    if not np.isfinite(gram).all():
        return x
    step, _ = _step(problem, x, gram)
    for part in _PARTS_OF_STEP:
        trial = np.clip(x + part * step, problem.lower, problem.upper)
        if problem.linear.all():
            return trial  # exact
        reached = problem.evaluate(trial, jacobian=False, select=select)
        if problem.total(reached, select)[-1, -1] <= gram[-1, -1]:
            return trial
    return x


def _step(problem, x, gram, damping=0.0):
    """Return the damped step from ``x`` and the reduction of squares that it promises."""
    hessian, gradient = gram[:-1, :-1], gram[:-1, -1]
    reach = np.where(problem.log, LARGEST_LOG_STEP, np.inf)
    step = bounded_step(
        hessian + damping * np.diag(np.diag(hessian)),
        gradient,
        np.maximum(problem.lower - x, -reach),
        np.minimum(problem.upper - x, reach),
    )
    return step, -(2.0 * gradient @ step + step @ hessian @ step)


def solve_linear(problem, x, gram):
    """Solve the linear parameters exactly and carry the Gram matrix along."""
    if not problem.linear.any():
        return x, gram
    index = np.flatnonzero(problem.linear)
    step = np.zeros(len(x) + 1)
    step[index] = bounded_step(
        gram[np.ix_(index, index)],
        gram[index, -1],
        (problem.lower - x)[index],
        (problem.upper - x)[index],
    )
    step[-1] = 1.0
    moved = gram.copy()
    moved[:, -1] = gram @ step
    moved[-1, :] = moved[:, -1]
    moved[-1, -1] = max(step @ gram @ step, 0.0)
    return np.clip(x + step[:-1], problem.lower, problem.upper), moved
