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
    block_in = np.empty(n_in)
    block_in[0] = u_previous
    for i in range(n_states):  # an assignment to a slice takes a second to compile
        block_in[1 + length + i] = x[i]
    block_out = np.empty(n_out)
    n_fours = n_in // 4 * 4
    for block in range(n_blocks):
        first = block * length
        for i in range(length):
            block_in[1 + i] = u[first + i]
        for i in range(n_out):
            block_out[i] = 0.0
        for j in range(0, n_fours, 4):
            v0, v1, v2, v3 = block_in[j], block_in[j + 1], block_in[j + 2], block_in[j + 3]
            for i in range(n_out):
                block_out[i] += (table[j, i] * v0 + table[j + 1, i] * v1) + (
                    table[j + 2, i] * v2 + table[j + 3, i] * v3
                )
        for j in range(n_fours, n_in):
            v0 = block_in[j]
            for i in range(n_out):
                block_out[i] += table[j, i] * v0
        for i in range(length):
            y[first + i] = block_out[i]
        block_in[0] = block_in[length]
        for i in range(n_states):
            block_in[1 + length + i] = block_out[length + i]
    return y, block_in[1 + length :].copy()


def tangent_system(discrete, by, rest, rest_by, one_before):
    """Return the arguments of :func:`state_space_tangents` that do not depend on the input.

    ``discrete`` is the discrete form, ``by`` its derivatives by p parameters, ``dad``
    (p, n_states, n_states) to ``dd`` (p,). The state begins as ``rest`` (n_states,) times the first
    input, ``rest_by`` (p, n_states) are its derivatives. That is the state one interval before the
    first sample, with the same input there (``one_before``), or the state at the first sample.

    The recursion runs on ``w[k] = x[k] - B1 u[k]``, which needs one sample of the input only:
    ``w[k+1] = Ad w[k] + B u[k]``, ``y[k] = C w[k] + (D + C B1) u[k]`` with ``B = B0 + Ad B1``.
    """
    ad, b0, b1, c, d = discrete
    dad, db0, db1, dc, dd = by
    if one_before:
        first, first_by = ad @ rest + b0, dad @ rest + rest_by @ ad.T + db0
    else:
        first, first_by = rest - b1, rest_by - db1
    # derivatives of the coefficients of w and, last, of u; one column per parameter
    n, p = len(b0), len(dd)
    columns, output_by = np.empty((n, n + 1, p)), np.empty((n + 1, p))
    columns[:, :n] = dad.transpose(1, 2, 0)
    columns[:, n] = (db0 + dad @ b1 + db1 @ ad.T).T
    output_by[:n] = dc.T
    output_by[n] = dd + dc @ b1 + db1 @ c
    first_by = np.ascontiguousarray(first_by.T)
    return ad, b0 + ad @ b1, c, float(d + c @ b1), columns, output_by, first, first_by


def state_space_tangents(system, start, u, du):
    """Return the output and its tangents; see :func:`tangent_system`.

    ``du`` (n, m) are tangents of the input; ``start`` (n_states,) is added to the state at the
    first sample, and depends on nothing.
    """
    if len(start) == 2:
        return _second_order_tangents(*system, start, u, du)
    return _tangent_loop((0,) * len(start), *system, start, u, du)


@jit
def _second_order_tangents(ad, b, c, direct, by, output_by, first, first_by, start, u, du):
    """Do :func:`_tangent_loop` for two states; their tangents stay in registers."""
    n_samples, m = du.shape
    p = output_by.shape[1]
    a00, a01, a10, a11 = ad[0, 0], ad[0, 1], ad[1, 0], ad[1, 1]
    b0, b1, c0, c1 = b[0], b[1], c[0], c[1]
    # copies of the rows: the compiler then knows that they do not alias the arrays written to
    by00, by01, by0u = by[0, 0].copy(), by[0, 1].copy(), by[0, 2].copy()
    by10, by11, by1u = by[1, 0].copy(), by[1, 1].copy(), by[1, 2].copy()
    out0, out1, outu = output_by[0].copy(), output_by[1].copy(), output_by[2].copy()
    w0, w1 = start[0] + first[0] * u[0], start[1] + first[1] * u[0]
    dw0, dw1 = np.empty(m + p), np.empty(m + p)
    for q in range(m):
        dw0[q], dw1[q] = first[0] * du[0, q], first[1] * du[0, q]
    for q in range(p):
        dw0[m + q], dw1[m + q] = first_by[0, q] * u[0], first_by[1, q] * u[0]
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
            direct_part = outu[q] * u1 + out0[q] * w0 + out1[q] * w1
            row[m + q] = direct_part + (c0 * s0 + c1 * s1)
            direct_part = by0u[q] * u1 + by00[q] * w0 + by01[q] * w1
            dw0[m + q] = direct_part + (a00 * s0 + a01 * s1)
            direct_part = by1u[q] * u1 + by10[q] * w0 + by11[q] * w1
            dw1[m + q] = direct_part + (a10 * s0 + a11 * s1)
        w0, w1 = b0 * u1 + a00 * w0 + a01 * w1, b1 * u1 + a10 * w0 + a11 * w1
    return y, dy


@jit
def _tangent_loop(states, ad, b, c, direct, by, output_by, first, first_by, start, u, du):
    """Run the recursion of :func:`state_space_tangents`; ``states`` is a tuple, one entry a state.

    The length of a tuple is known to the compiler, so all states of a column are one body of one
    loop over the columns, which is vectorised.
    """
    n_states = len(states)
    n_samples, m = du.shape
    p = output_by.shape[1]
    w = np.empty(n_states)
    w_new = np.empty(n_states)
    dw = np.empty((n_states, m + p))
    dw_new = np.empty_like(dw)
    for i in range(n_states):
        w[i] = start[i] + first[i] * u[0]
        for q in range(m):
            dw[i, q] = first[i] * du[0, q]
        for q in range(p):
            dw[i, m + q] = first_by[i, q] * u[0]
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
        # the parameters also act through the states, which have to be those before the step
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
