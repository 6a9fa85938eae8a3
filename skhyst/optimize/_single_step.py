"""One Gauss-Newton step: its predicted cost, and the solution after it."""

import numpy as np

from ._variable_projection import damped_step, start_descent

_PARTS_OF_STEP = (1.0, 0.25, 0.06)


def predicted_cost(problem, x):
    """Return the sum of squares that one Gauss-Newton step from ``x`` is predicted to reach.

    The linear parameters are solved first; it is infinite where the model is not finite.
    """
    return start_descent_and_predict(problem, x).predicted_cost


def start_descent_and_predict(problem, x):
    """Return :func:`start_descent` at ``x`` with the attribute :func:`predicted_cost`."""
    solution = start_descent(problem, x)
    if np.isfinite(solution.gram).all():
        _, reduction = damped_step(problem, solution.x, solution.gram)
        solution.predicted_cost = max(solution.cost - reduction, 0.0)
    return solution


def single_step(problem, x, blocks, select):
    """Return the solution for some segments, one Gauss-Newton step from the solution for all.

    No derivatives are evaluated. A step that does not reduce the sum of squares is shortened; if
    that does not help either, the solution for all segments is returned.

    Parameters
    ----------
    problem : OperatorProblem
    x : ndarray of shape (n,)
        Solution for all segments.
    blocks : ndarray
        ``problem.evaluate(x)``, for all or for the selected segments.
    select : ndarray of bool of shape (n_segments,)
        The segments to fit.

    Returns
    -------
    ndarray of shape (n,)
    """
    gram = problem.total(blocks, select)
    if not np.isfinite(gram).all():
        return x
    step, _ = damped_step(problem, x, gram)
    for part in _PARTS_OF_STEP:
        trial = np.clip(x + part * step, problem.lower, problem.upper)
        if problem.linear.all():
            return trial  # exact
        reached = problem.evaluate(trial, jacobian=False, select=select)
        if problem.total(reached, select)[-1, -1] <= gram[-1, -1]:
            return trial
    return x
