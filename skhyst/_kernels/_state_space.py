"""Linear state-space recursions, several signals at once.

The discrete form is ``x[k] = Ad x[k-1] + B0 u[k-1] + B1 u[k]``, ``y[k] = C x[k] + D u[k]``, which
covers the zero-order hold (``B1 = 0``) and the first-order hold.
"""

import numpy as np

from .._jit import jit

__all__ = ["state_space_run", "state_space_tangents", "tangent_loop"]


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


def state_space_tangents(ad, b0, b1, c, d, dad, db0, db1, dc, dd, u, du, x, dx, u0, du0):
    """Return the output and its tangents.

    ``du`` (n, m) are tangents of the input; the arrays ``dad`` (p, n_states, n_states) to ``dd``
    (p,) are derivatives of the discrete form with respect to ``p`` parameters. ``dx``
    (n_states, m + p) are the tangents of the initial state ``x``, ``u0`` and ``du0`` (m,) the
    input and its tangents before the first sample.

    The recursion runs on ``w[k] = x[k] - B1 u[k]``, which needs one sample of the input only:
    ``w[k+1] = Ad w[k] + B u[k]``, ``y[k] = C w[k] + (D + C B1) u[k]`` with ``B = B0 + Ad B1``.
    """
    m = du.shape[1]
    b, direct = b0 + ad @ b1, d + c @ b1
    # derivatives by w and, last, by u; one column a parameter
    db = db0 + dad @ b1 + db1 @ ad.T
    by = np.concatenate([dad, db[:, :, None]], axis=2).transpose(1, 2, 0)
    output_by = np.concatenate([dc, (dd + dc @ b1 + db1 @ c)[:, None]], axis=1).T
    dw = ad @ dx
    dw[:, :m] += np.outer(b0, du0)
    dw[:, m:] += (dad @ x + db0 * u0).T
    return tangent_loop(
        (0,) * len(x),
        ad,
        b,
        c,
        float(direct),
        np.ascontiguousarray(by),
        np.ascontiguousarray(output_by),
        ad @ x + b0 * u0,
        dw,
        u,
        du,
    )


@jit
def tangent_loop(states, ad, b, c, direct, by, output_by, w_first, dw_first, u, du):
    """Run the recursion of :func:`state_space_tangents`; ``states`` is a tuple, one entry a state.

    The length of a tuple is known to the compiler, so all states of a column are one body of one
    loop over the columns, which is vectorised.
    """
    n_states = len(states)
    n_samples, m = du.shape
    p = output_by.shape[1]
    w = w_first.copy()
    w_new = np.empty(n_states)
    dw = dw_first.copy()
    dw_new = np.empty_like(dw)
    y = np.empty(n_samples)
    dy = np.empty((n_samples, m + p))
    for k in range(n_samples):
        u1 = u[k]
        output = direct * u1
        for i in range(n_states):
            output += c[i] * w[i]
            value = b[i] * u1
            for j in range(n_states):
                value += ad[i, j] * w[j]
            w_new[i] = value
        y[k] = output
        for q in range(m):
            v = du[k, q]
            output = direct * v
            for i in range(n_states):
                output += c[i] * dw[i, q]
                value = b[i] * v
                for j in range(n_states):
                    value += ad[i, j] * dw[j, q]
                dw_new[i, q] = value
            dy[k, q] = output
        for q in range(p):
            output = output_by[n_states, q] * u1
            for i in range(n_states):
                output += c[i] * dw[i, m + q] + output_by[i, q] * w[i]
                value = by[i, n_states, q] * u1
                for j in range(n_states):
                    value += ad[i, j] * dw[j, m + q] + by[i, j, q] * w[j]
                dw_new[i, m + q] = value
            dy[k, m + q] = output
        w, w_new = w_new, w
        dw, dw_new = dw_new, dw
    return y, dy
