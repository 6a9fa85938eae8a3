"""The minimum of a quadratic function within bounds, by SciPy's non-negative least squares."""

import numpy as np
from scipy.linalg import eigvalsh
from scipy.linalg.lapack import dposv, dpotrf, dtrtri
from scipy.optimize import nnls

_LEAST = np.sqrt(np.finfo(float).tiny)  # norm of a column; below it, a column counts as zero
_RIDGE = 1e-13  # relative to the scaled diagonal; keeps exactly collinear columns solvable
_ROUNDING = 1e-12  # part of the largest unknown


def bounded_step(hessian, gradient, lower, upper):
    """Minimise ``0.5 s' H s + g' s`` subject to ``lower <= s <= upper``, with ``s = 0`` feasible.

    With ``H = R' R`` and the unbounded minimum ``s0``, the step is ``s = s0 + R^-1 z`` with the
    smallest ``|z|`` within the bounds. Lawson and Hanson, *Solving Least Squares Problems*, 1974,
    chapter 23, find it by one non-negative least squares problem, whose unknowns are the
    multipliers of the bounds: those that are not zero tell which bounds hold, and Cholesky factors
    solve for the rest.

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
        The step; zero where the column of an entry is zero or overflows.
    """
    scale = np.sqrt(np.maximum(hessian.diagonal(), 0.0))  # rounding may make it negative
    moves = (scale > _LEAST) & np.isfinite(scale)  # an overflowing column has no step
    if not moves.any():
        return np.zeros(len(scale))
    if not moves.all():
        hessian = np.where(moves & moves[:, None], hessian, 0.0)
        gradient, scale = np.where(moves, gradient, 0.0), np.where(moves, scale, 1.0)
    inverse = moves / scale
    h = hessian * inverse * inverse[:, None]
    h.ravel()[:: len(h) + 1] += _RIDGE
    g = gradient * inverse
    low, high = lower * scale, upper * scale
    s = -solve_definite(h, g)
    if ((low <= s) & (s <= high)).all():
        return s * inverse
    active = _held(h, s, low, high)
    while True:
        free = np.isnan(active)
        s = np.where(free, 0.0, active)
        s[free] = -solve_definite(h[free][:, free], (g + h @ s)[free])
        inside = np.minimum(np.maximum(s, low), high)
        # for collinear columns, rounding may make the wrong bounds active
        outside = free & (np.abs(inside - s) > _ROUNDING * np.abs(s).max())
        if not outside.any():
            return inside * inverse
        active[outside] = inside[outside]


def _held(h, s0, low, high):
    """Return the bounds that are active at the minimum, NaN for the free unknowns."""
    factor, failed = dpotrf(h, clean=1)
    if failed:  # rounding has made it indefinite by more than the ridge
        factor, _ = dpotrf(h - 2.0 * eigvalsh(h)[0] * np.eye(len(h)), clean=1)
    inverse, _ = dtrtri(factor)
    beyond = np.concatenate([low - s0, s0 - high])
    finite = np.isfinite(beyond)
    if not finite.any():  # SciPy ends the process on a problem without unknowns
        return np.full(len(h), np.nan)
    distance = factor @ s0
    rows = np.empty((len(finite), len(h) + 1))
    rows[: len(h), :-1], rows[len(h) :, :-1] = inverse, -inverse
    # relative to the distance of s0 from the feasible zero, so that |z| is at most 1
    rows[:, -1] = beyond / np.sqrt(distance @ distance)
    rows = rows[finite]
    rows /= np.sqrt(np.einsum("ij,ij->i", rows, rows))[:, None]
    target = np.zeros(len(h) + 1)
    target[-1] = 1.0
    multipliers = np.zeros(len(finite))
    multipliers[finite], _ = nnls(rows.T, target, maxiter=10 * len(rows))
    below, above = multipliers.reshape(2, -1) > 0.0
    return np.where(below, low, np.where(above, high, np.nan))


def solve_definite(h, g):
    """Solve ``h x = g`` by a Cholesky factorisation, or least squares if h is not definite."""
    if not len(g):
        return g
    # LAPACK itself: the checks of scipy.linalg cost more than these few unknowns
    _, solution, failed = dposv(h, g)
    return np.linalg.lstsq(h, g, rcond=None)[0] if failed else solution
