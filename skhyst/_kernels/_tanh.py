"""The hyperbolic tangent model: a static curve plus a term in the drive's rate."""

import math

from .._jit import jit

__all__ = ["tanh_run", "tanh_tangents"]


@jit
def tanh_run(u, dt, k0, alpha, beta, gamma, intercept, last, y):
    """Write the response to ``y``; ``last`` is the drive before the first sample."""
    damping = alpha / dt
    for k in range(u.size):
        value = u[k]
        y[k] = intercept + k0 * value + damping * (value - last) + beta * math.tanh(gamma * value)
        last = value


@jit
def tanh_tangents(u, du, dt, k0, alpha, beta, gamma, last, dlast, dy):
    """Write the tangents to ``dy``, shape (n_samples, m + 5).

    The last five columns are the derivatives by k0, alpha, beta, gamma and the intercept;
    ``dlast`` (m,) are the tangents of ``last``.
    """
    m = du.shape[1]
    damping = alpha / dt
    before = dlast.copy()
    for k in range(u.size):
        value = u[k]
        bend = math.tanh(gamma * value)
        slope = (1.0 - bend) * (1.0 + bend)
        gain = k0 + beta * gamma * slope
        for q in range(m):
            dy[k, q] = gain * du[k, q] + damping * (du[k, q] - before[q])
            before[q] = du[k, q]
        dy[k, m] = value
        dy[k, m + 1] = (value - last) / dt
        dy[k, m + 2] = bend
        dy[k, m + 3] = beta * value * slope
        dy[k, m + 4] = 1.0
        last = value
