r"""Loops over the Dahl model, exact on straight pieces of the drive.

The normalised force ``w`` moves with the displacement alone, ``dw/du = (1 - s w)^n / x_c`` with
``s`` the sign of the motion. The gap ``q = 1 - s w`` to the saturated force then decays along the
way ``l``: ``dq/dl = -q^n / x_c``, so ``q = q0 exp(-l/x_c)`` for ``n = 1`` and
``q = q0 (1 + (n - 1) q0^(n-1) l/x_c)^(-1/(n-1))`` otherwise; for ``n < 1`` it reaches zero.
"""

import math

from .._jit import jit

__all__ = ["dahl_run", "dahl_step", "dahl_tangents"]

_LONGEST = 1e300  # in presliding displacements; an infinite way times a gap of zero is no number


@jit
def dahl_step(w, change, x_c, exponent):
    """Return ``w`` after the displacement ``change`` and its derivatives by w, change and x_c.

    Where the drive stands still, the derivative by ``change`` is the mean of both directions.
    """
    if change == 0.0:
        slope = 1.0
        if exponent != 1.0:
            slope = 0.5 * ((1.0 - w) ** exponent + (1.0 + w) ** exponent)
        return w, 1.0, slope / x_c, 0.0
    sign = 1.0 if change > 0.0 else -1.0
    way = min(abs(change) / x_c, _LONGEST)
    gap = max(1.0 - sign * w, 0.0)
    if exponent == 1.0:
        by_w = math.exp(-way)
        gap *= by_w
        slope = gap
    else:
        power = exponent - 1.0
        # a gap of zero to a negative power is infinite, so that the base is negative
        base = 1.0 + power * gap**power * way
        if base > 0.0:
            gap *= base ** (-1.0 / power)
            by_w = base ** (-exponent / power)
            slope = gap**exponent
        else:
            gap = by_w = slope = 0.0
    return sign - sign * gap, by_w, slope / x_c, -sign * slope * way / x_c


@jit
def dahl_run(u, before, w, x_c, exponent, out):
    """Write the normalised force of ``u`` to ``out`` (n,), from the force ``w`` at ``before``."""
    for k in range(u.size):
        w = dahl_step(w, u[k] - before, x_c, exponent)[0]
        before = u[k]
        out[k] = w


@jit
def dahl_tangents(u, du, x_c, exponent, out, dout):
    """Write the normalised force (n,), and its tangents (n, m + 1): those of ``du``, by ``x_c``.

    The device is virgin and stands at zero.
    """
    m = du.shape[1]
    w = 0.0
    before = 0.0
    for k in range(u.size):
        w, by_w, by_change, by_x_c = dahl_step(w, u[k] - before, x_c, exponent)
        before = u[k]
        out[k] = w
        if k == 0:
            for q in range(m):
                dout[k, q] = by_change * du[k, q]
            dout[k, m] = by_x_c
        else:
            for q in range(m):
                dout[k, q] = by_w * dout[k - 1, q] + by_change * (du[k, q] - du[k - 1, q])
            dout[k, m] = by_w * dout[k - 1, m] + by_x_c
