"""Minimum of a quadratic function within bounds."""

import numpy as np
from scipy.linalg.lapack import dposv

_LEAST = np.sqrt(np.finfo(float).tiny)  # norm of a column; below it, a column counts as zero
_RIDGE = 1e-13  # relative to the scaled diagonal; keeps exactly collinear columns solvable


def bounded_step(hessian, gradient, lower, upper):
    """Minimise ``0.5 s' H s + g' s`` subject to ``lower <= s <= upper``, with ``s = 0`` feasible.

    A primal active-set method: along each unconstrained direction the step stops at the first
    bound, which is then held; a bound is released when its multiplier has the wrong sign. It is the
    method of Lawson and Hanson, *Solving Least Squares Problems*, 1974, chapter 23, and of Stark
    and Parker, *Computational Statistics*, 1995, written for normal equations, because one pass
    over the data has already condensed it to these.

    Parameters
    ----------
    hessian : ndarray of shape (n, n)
        Positive semidefinite.
    gradient : ndarray of shape (n,)
        At ``s = 0``.
    lower, upper : ndarray of shape (n,)
        ``lower <= 0 <= upper``, possibly infinite.

    Returns
    -------
    ndarray of shape (n,)
        The step; zero where the column of an entry is zero.
    """
    scale = np.sqrt(np.maximum(np.diag(hessian), 0.0))  # rounding may make it negative
    moves = scale > _LEAST
    if not moves.any():
        return np.zeros(len(scale))
    scale[~moves] = 1.0
    inverse = moves / scale
    h = hessian * inverse * inverse[:, None]
    h[np.diag_indices_from(h)] += _RIDGE
    g = gradient * inverse
    low, high = lower * scale, upper * scale
    n = len(g)
    s = -solve_definite(h, g)
    if np.all((low <= s) & (s <= high)):
        return s * inverse
    s = np.clip(s, low, high)  # most bounds active here are active at the solution
    free = moves & (low < s) & (s < high)
    for _ in range(10 * n + 10):
        if free.any():
            residual = g[free] + h[np.ix_(free, ~free)] @ s[~free]
            target = -solve_definite(h[np.ix_(free, free)], residual)
            move = target - s[free]
            with np.errstate(divide="ignore", invalid="ignore"):
                room = np.where(move > 0.0, (high[free] - s[free]) / move, np.inf)
                room = np.where(move < 0.0, (low[free] - s[free]) / move, room)
            first = np.argmin(room)
            if room[first] < 1.0:
                index = np.flatnonzero(free)[first]
                s[free] += room[first] * move
                s[index] = high[index] if move[first] > 0.0 else low[index]
                free[index] = False
                continue
            s[free] = target
        slope = h @ s + g
        held = moves & ~free
        wrong = np.where(s <= low, -slope, slope)
        wrong[~held | (low == high)] = 0.0
        worst = np.argmax(wrong)
        if wrong[worst] <= 1e-12 * np.abs(g).max(initial=0.0):
            break
        free[worst] = True
    return s * inverse


def solve_definite(h, g):
    """Solve ``h x = g`` by a Cholesky factorisation, or least squares if h is not definite."""
    if not len(g):
        return g
    # LAPACK itself: the checks of scipy.linalg cost more than these few unknowns
    _, solution, failed = dposv(h, g)
    return np.linalg.lstsq(h, g, rcond=None)[0] if failed else solution
