"""Linear state-space recursions, several signals at once.

The discrete form is ``x[k] = Ad x[k-1] + B0 u[k-1] + B1 u[k]``, ``y[k] = C x[k] + D u[k]``, which
covers the zero-order hold (``B1 = 0``) and the first-order hold.
"""

import numpy as np

from .._jit import jit

__all__ = ["state_space_run", "state_space_tangents"]


@jit
def state_space_run(ad, b0, b1, c, d, u, x, u_previous):
    """Return the output and the last state; ``x`` (n_states,) is left as it was."""
    n_states = ad.shape[0]
    old = x.copy()
    new = np.empty(n_states)
    y = np.empty(u.shape[0])
    for k in range(u.shape[0]):
        output = d * u[k]
        for i in range(n_states):
            value = b0[i] * u_previous + b1[i] * u[k]
            for j in range(n_states):
                value += ad[i, j] * old[j]
            new[i] = value
            output += c[i] * value
        y[k] = output
        u_previous = u[k]
        old, new = new, old
    return y, old


@jit
def state_space_tangents(ad, b0, b1, c, d, dad, db0, db1, dc, dd, u, du, x, dx, u0, du0):
    """Return the output and its tangents.

    ``du`` (n, m) are tangents of the input; the arrays ``dad`` (p, n_states, n_states) to ``dd``
    (p,) are derivatives of the discrete form with respect to ``p`` parameters. ``dx``
    (n_states, m + p) are the tangents of the initial state ``x``, ``u0`` and ``du0`` (m,) the
    input and its tangents before the first sample.
    """
    n_samples, m = du.shape
    n_states = ad.shape[0]
    p = dd.shape[0]
    columns = m + p
    x_old = x.copy()
    x_new = np.empty(n_states)
    old = dx.copy()
    new = np.empty((n_states, columns))
    y = np.empty(n_samples)
    dy = np.empty((n_samples, columns))
    for k in range(n_samples):
        u1 = u[k]
        output = d * u1
        for i in range(n_states):
            value = b0[i] * u0 + b1[i] * u1
            for j in range(n_states):
                value += ad[i, j] * x_old[j]
            x_new[i] = value
            output += c[i] * value
        y[k] = output
        for i in range(n_states):
            for q in range(m):
                new[i, q] = b0[i] * du0[q] + b1[i] * du[k, q]
            for q in range(p):
                value = db0[q, i] * u0 + db1[q, i] * u1
                for j in range(n_states):
                    value += dad[q, i, j] * x_old[j]
                new[i, m + q] = value
            for j in range(n_states):
                weight = ad[i, j]
                if weight != 0.0:
                    for q in range(columns):
                        new[i, q] += weight * old[j, q]
        for q in range(m):
            dy[k, q] = d * du[k, q]
            du0[q] = du[k, q]
        for q in range(p):
            value = dd[q] * u1
            for j in range(n_states):
                value += dc[q, j] * x_new[j]
            dy[k, m + q] = value
        for i in range(n_states):
            weight = c[i]
            if weight != 0.0:
                for q in range(columns):
                    dy[k, q] += weight * new[i, q]
            for q in range(columns):
                old[i, q] = new[i, q]
        u0 = u1
        for i in range(n_states):
            x_old[i] = x_new[i]
    return y, dy
