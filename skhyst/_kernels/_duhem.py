r"""Loops over the Duhem model of Coleman and Hodgdon, exact on straight pieces of the drive.

The memory terms follow ``dH_j/du = -s alpha H_j + t^j`` with ``s`` the sign of the motion and
``t = (u - center)/scale``, j = 0 .. d-1. On a straight piece with ``x = alpha |change|``,
``H_j = exp(-x) H_j0 + change M_j``, ``M_j = int_0^1 exp(-x (1 - a)) (t0 + (t1 - t0) a)^j da``.
"""

import math

import numpy as np

from .._jit import jit

__all__ = ["MAX_TERMS", "duhem_moments", "duhem_run", "duhem_tangents", "exponential_moments"]

_LONGEST = 1e300  # in units of 1/alpha; an infinite way times zero is no number
MAX_TERMS = 9  # upwards from x = 1 the error grows by a factor i a step, 9! in all
# I_n = sum_k (-x)^k n!/(n+k+1)!, one row an n; so many terms are exact to rounding
_SMALL, _MIDDLE, _LARGE = (0.02, 8), (0.25, 12), (1.0, 18)
_SERIES = np.cumprod(
    np.where(np.arange(_LARGE[1]) == 0, 1.0, -1.0)
    / (np.arange(MAX_TERMS + 1.0)[:, None] + np.arange(1.0, _LARGE[1] + 1.0)),
    axis=1,
)


@jit
def exponential_moments(x, moments):
    """Write ``int_0^1 exp(-x (1 - a)) a^i da``, i = 0 .., to ``moments``; return ``exp(-x)``.

    By parts, ``x I_i = 1 - i I_(i-1)``: for small x downwards from a series, for large x upwards,
    either way stable. There may be ``MAX_TERMS`` + 1 moments.
    """
    last = moments.size - 1
    if x < 1.0:
        n_terms = _SMALL[1] if x < _SMALL[0] else (_MIDDLE[1] if x < _MIDDLE[0] else _LARGE[1])
        # even and odd powers apart: two short chains of operations in place of a long one
        even = 0.0
        odd = 0.0
        square = x * x
        for k in range(n_terms - 2, -2, -2):
            even = even * square + _SERIES[last, k]
            odd = odd * square + _SERIES[last, k + 1]
        value = even + x * odd
        for i in range(last, 0, -1):
            moments[i] = value
            value = (1.0 - x * value) / i
        moments[0] = value
        return 1.0 - x * value
    decay = math.exp(-x)
    value = (1.0 - decay) / x
    moments[0] = value
    for i in range(1, last + 1):
        value = (1.0 - i * value) / x
        moments[i] = value
    return decay


@jit
def duhem_moments(x, t0, step, work, moments):
    """Write ``M_ij = int_0^1 exp(-x (1 - a)) a^i (t0 + step a)^j da`` to ``moments`` (k, d).

    ``work`` has shape (d + k - 1,). Returns ``exp(-x)``.
    """
    decay = exponential_moments(x, work)
    k, d = moments.shape
    for i in range(k):
        moments[i, 0] = work[i]
    for j in range(1, d):
        for i in range(work.size - j):
            work[i] = t0 * work[i] + step * work[i + 1]
        for i in range(k):
            moments[i, j] = work[i]
    return decay


@jit
def duhem_run(u, before, h, alpha, center, scale, out):
    """Write the memory terms of ``u`` to ``out`` (n, d), from ``h`` (d,) at ``before``."""
    d = h.size
    if d == 1:  # the classical model: numbers instead of arrays take a third of the time
        value = h[0]
        for k in range(u.size):
            x = min(alpha * abs(u[k] - before), _LONGEST)
            decay = math.exp(-x)
            moment = -math.expm1(-x) / x if x > 0.0 else 1.0
            value = decay * value + (u[k] - before) * moment
            out[k, 0] = value
            before = u[k]
        return
    work = np.empty(d)
    moments = np.empty((1, d))
    last = h
    for k in range(u.size):
        change = u[k] - before
        x = min(alpha * abs(change), _LONGEST)
        t0 = (before - center) / scale
        decay = duhem_moments(x, t0, change / scale, work, moments)
        for j in range(d):
            out[k, j] = decay * last[j] + change * moments[0, j]
        last = out[k]
        before = u[k]


@jit
def duhem_tangents(u, du, alpha, center, scale, out, dout):
    """Write the memory terms (n, d) and their tangents (n, d, m + 1): of ``du``, by ``alpha``.

    The device is virgin and stands at zero.
    """
    d = out.shape[1]
    m = du.shape[1]
    work = np.empty(d + 1)
    moments = np.empty((2, d))
    last = np.zeros(d)
    before = 0.0
    for k in range(u.size):
        change = u[k] - before
        sign = 0.0 if change == 0.0 else (1.0 if change > 0.0 else -1.0)
        x = min(alpha * abs(change), _LONGEST)
        t0 = (before - center) / scale
        decay = duhem_moments(x, t0, change / scale, work, moments)
        for j in range(d):
            # by x; then by the end and by the start of the piece
            by_x = -decay * last[j] - change * (moments[0, j] - moments[1, j])
            by_end = moments[0, j] + alpha * sign * by_x
            by_start = -by_end
            if j > 0:
                by_end += j * change / scale * moments[1, j - 1]
                by_start += j * change / scale * (moments[0, j - 1] - moments[1, j - 1])
            out[k, j] = decay * last[j] + change * moments[0, j]
            if k == 0:
                for q in range(m):
                    dout[k, j, q] = by_end * du[k, q]
                dout[k, j, m] = by_x * abs(change)
            else:
                for q in range(m):
                    value = decay * dout[k - 1, j, q] + by_end * du[k, q]
                    dout[k, j, q] = value + by_start * du[k - 1, q]
                dout[k, j, m] = decay * dout[k - 1, j, m] + by_x * abs(change)
        last = out[k]
        before = u[k]
