"""Loops of linear state-space models at one interval: runs, one step, and tangents."""

import numpy as np

from .._jit import jit


@jit
def state_space_run(ad, b0, b1, c, d, u, x, u_previous):
    """Return the output (n,) and the final state; ``x`` (n_states,) is not changed."""
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
def first_order_run(ad, b0, b1, c, d, u, x, u_previous):
    """Do :func:`state_space_run` for one state, kept in a register."""
    a00, b00, b10, c0 = ad[0, 0], b0[0], b1[0], c[0]
    x0 = x[0]
    y = np.empty(u.shape[0])
    for k in range(u.shape[0]):
        x0 = (b00 * u_previous + b10 * u[k]) + a00 * x0
        u_previous = u[k]
        y[k] = c0 * x0 + d * u_previous
    return y, np.array([x0])


@jit
def second_order_run(ad, b0, b1, c, d, u, x, u_previous):
    """Do :func:`state_space_run` for two states, kept in registers."""
    a00, a01, a10, a11 = ad[0, 0], ad[0, 1], ad[1, 0], ad[1, 1]
    b00, b01, b10, b11 = b0[0], b0[1], b1[0], b1[1]
    c0, c1 = c[0], c[1]
    x0, x1 = x[0], x[1]
    y = np.empty(u.shape[0])
    for k in range(u.shape[0]):
        force0 = b00 * u_previous + b10 * u[k]
        force1 = b01 * u_previous + b11 * u[k]
        x0, x1 = force0 + (a00 * x0 + a01 * x1), force1 + (a10 * x0 + a11 * x1)
        u_previous = u[k]
        y[k] = (c0 * x0 + c1 * x1) + d * u_previous
    return y, np.array([x0, x1])


@jit
def state_space_step(u, c, s):
    """Do one sample of :func:`state_space_run`.

    ``c`` is its matrices and the intercept, ``s`` the states, the last input, and workspace for
    the new states.
    """
    ad, b0, b1, output, d, intercept = c
    n_states = output.size
    y = d * u
    for i in range(n_states):
        value = b0[i] * s[n_states] + b1[i] * u
        for j in range(n_states):
            value += ad[i, j] * s[j]
        s[n_states + 1 + i] = value
        y += output[i] * value
    for i in range(n_states):
        s[i] = s[n_states + 1 + i]
    s[n_states] = u
    return y + intercept


@jit
def state_space_begin(u, c, s):
    """Do :func:`state_space_step` if no drive precedes the first sample.

    ``s`` ends with a mark that is zero before the first sample.
    """
    _, _, _, output, d, intercept = c
    n_states = output.size
    if s[2 * n_states + 1] > 0.0:
        return state_space_step(u, c, s)
    y = d * u
    for i in range(n_states):
        y += output[i] * s[i]
    s[n_states] = u
    s[2 * n_states + 1] = 1.0
    return y + intercept


def block_table(ad, b0, b1, c, d, length):
    """Return the matrix that advances ``length`` samples at once, for :func:`block_run`.

    The matrix (1 + length + n_states, length + n_states) maps the row vector of the last input, the
    inputs of the block and the state before it to that of the outputs and the state after it.
    """
    n_states = len(b0)
    reached = np.zeros((1 + length + n_states, n_states))
    reached[1 + length :] = np.eye(n_states)
    table = np.empty((1 + length + n_states, length + n_states))
    for k in range(length):
        reached = reached @ ad.T
        reached[k] += b0
        reached[k + 1] += b1
        table[:, k] = reached @ c
        table[k + 1, k] += d
    table[:, length:] = reached
    return table


@jit
def block_run(table, u, x, u_previous):
    """Do :func:`state_space_run` in blocks, for the complete blocks of ``u``.

    A step of one sample is a chain of ``n_states**2`` dependent products; a block has as many, plus
    those of the outputs, in vectorised loops. A value that is not finite also invalidates earlier
    outputs of its block.
    """
    n_in, n_out = table.shape
    n_states = x.shape[0]
    length = n_out - n_states
    n_blocks = u.shape[0] // length
    y = np.empty(n_blocks * length)
    given = np.empty(n_in)
    given[0] = u_previous
    for i in range(n_states):  # an assignment to a slice takes a second to compile
        given[1 + length + i] = x[i]
    found = np.empty(n_out)
    n_fours = n_in // 4 * 4
    for block in range(n_blocks):
        first = block * length
        for i in range(length):
            given[1 + i] = u[first + i]
        for i in range(n_out):
            found[i] = 0.0
        for j in range(0, n_fours, 4):
            v0, v1, v2, v3 = given[j], given[j + 1], given[j + 2], given[j + 3]
            for i in range(n_out):
                found[i] += (table[j, i] * v0 + table[j + 1, i] * v1) + (
                    table[j + 2, i] * v2 + table[j + 3, i] * v3
                )
        for j in range(n_fours, n_in):
            v0 = given[j]
            for i in range(n_out):
                found[i] += table[j, i] * v0
        for i in range(length):
            y[first + i] = found[i]
        given[0] = given[length]
        for i in range(n_states):
            given[1 + length + i] = found[length + i]
    return y, given[1 + length :].copy()


def state_space_tangents(ad, b0, b1, c, d, dad, db0, db1, dc, dd, u, du, x, dx, u0, du0):
    """Return the output and its tangents.

    ``du`` (n, m) are tangents of the input; the arrays ``dad`` (p, n_states, n_states) to ``dd``
    (p,) are derivatives of the discrete form with respect to ``p`` parameters. ``dx``
    (n_states, m + p) are the tangents of the initial state ``x``, ``u0`` and ``du0`` (m,) the
    input and its tangents before the first sample. Where ``u0`` is None, no input leads to the
    first sample, and ``x`` is the state there.

    The recursion runs on ``w[k] = x[k] - B1 u[k]``, which needs one sample of the input only:
    ``w[k+1] = Ad w[k] + B u[k]``, ``y[k] = C w[k] + (D + C B1) u[k]`` with ``B = B0 + Ad B1``.
    """
    m = du.shape[1]
    b, direct = b0 + ad @ b1, d + c @ b1
    # derivatives of the coefficients of w and, last, of u; one column per parameter
    db = db0 + dad @ b1 + db1 @ ad.T
    by = np.concatenate([dad, db[:, :, None]], axis=2).transpose(1, 2, 0)
    output_by = np.concatenate([dc, (dd + dc @ b1 + db1 @ c)[:, None]], axis=1).T
    if u0 is None:
        w, dw = x - b1 * u[0], dx.copy()
        dw[:, :m] -= np.outer(b1, du[0])
        dw[:, m:] -= (db1 * u[0]).T
    else:
        w, dw = ad @ x + b0 * u0, ad @ dx
        dw[:, :m] += np.outer(b0, du0)
        dw[:, m:] += (dad @ x + db0 * u0).T
    columns = np.ascontiguousarray(by), np.ascontiguousarray(output_by)
    system = np.ascontiguousarray(ad), b, c, float(direct), *columns, w, dw, u, du
    return _second_order_tangents(*system) if len(x) == 2 else _tangent_loop((0,) * len(x), *system)


@jit
def _second_order_tangents(ad, b, c, direct, by, output_by, w_first, dw_first, u, du):
    """Do :func:`_tangent_loop` for two states, whose tangents of a column stay in registers."""
    n_samples, m = du.shape
    p = output_by.shape[1]
    a00, a01, a10, a11 = ad[0, 0], ad[0, 1], ad[1, 0], ad[1, 1]
    b0, b1, c0, c1 = b[0], b[1], c[0], c[1]
    # copies of the rows: the compiler then knows that they do not alias the arrays written to
    by00, by01, by0u = by[0, 0].copy(), by[0, 1].copy(), by[0, 2].copy()
    by10, by11, by1u = by[1, 0].copy(), by[1, 1].copy(), by[1, 2].copy()
    out0, out1, outu = output_by[0].copy(), output_by[1].copy(), output_by[2].copy()
    w0, w1 = w_first[0], w_first[1]
    dw0, dw1 = dw_first[0].copy(), dw_first[1].copy()
    y = np.empty(n_samples)
    dy = np.empty((n_samples, m + p))
    for k in range(n_samples):
        u1 = u[k]
        y[k] = direct * u1 + c0 * w0 + c1 * w1
        upstream, row = du[k], dy[k]
        for q in range(m):
            v, s0, s1 = upstream[q], dw0[q], dw1[q]
            row[q] = direct * v + c0 * s0 + c1 * s1
            dw0[q] = b0 * v + a00 * s0 + a01 * s1
            dw1[q] = b1 * v + a10 * s0 + a11 * s1
        for q in range(p):
            s0, s1 = dw0[m + q], dw1[m + q]
            own = outu[q] * u1 + out0[q] * w0 + out1[q] * w1
            row[m + q] = own + (c0 * s0 + c1 * s1)
            own = by0u[q] * u1 + by00[q] * w0 + by01[q] * w1
            dw0[m + q] = own + (a00 * s0 + a01 * s1)
            own = by1u[q] * u1 + by10[q] * w0 + by11[q] * w1
            dw1[m + q] = own + (a10 * s0 + a11 * s1)
        w0, w1 = b0 * u1 + a00 * w0 + a01 * w1, b1 * u1 + a10 * w0 + a11 * w1
    return y, dy


@jit
def _tangent_loop(states, ad, b, c, direct, by, output_by, w_first, dw_first, u, du):
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
