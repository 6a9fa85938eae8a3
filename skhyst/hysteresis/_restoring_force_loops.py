r"""Loops over a mass with polynomial spring and damper and a bilinear hysteretic force.

In units of the drive, with ``p = q'/w``, the force beside linear spring and damper is
``F = N(q, p) + z`` with odd polynomials without linear terms,

    N = sum_i c_i q (q/s)^(2i) + sum_i l_i p (p/s)^(2i),

and z moves with ``k_s q`` within ``+-z_s``. Over the way D of a substep (see ``_oscillator``) the
mean of z is known in closed form, and D is the root of a linear equation while z has not reached
its limit, of a quadratic one when it has (:func:`slide`). N is taken at the start for a first D,
then as the mean of both ends.
"""

import math

import numpy as np

from .._jit import jit
from ._oscillator import (
    FREE,
    OWN,
    SLOPE_B,
    SPEED,
    F,
    P,
    Q,
    begin,
    carry,
    loops,
    move_tangents,
    oscillator,
    solve_tangents,
)


@jit
def odd_terms(x, coefficients, scale):
    """Return ``sum_i coefficients_i x (x/scale)^(2i)``, i = 1, 2, ..., and its slope."""
    square = (x / scale) * (x / scale)
    value, slope, power = 0.0, 0.0, 1.0
    for i in range(coefficients.size):
        power *= square
        value += coefficients[i] * power
        slope += (2 * i + 3) * coefficients[i] * power
    return value * x, slope


@jit
def slide(c, b, z, k, limit):
    """Solve ``D = c - b mean(z)``; return D, the mean of z, z behind it, and a part of the way.

    That is the part on which z grows, 1 where it does not slip.
    """
    delta = (c - b * z) / (1.0 + 0.5 * b * k)
    new = z + k * delta
    if abs(new) <= limit:
        return delta, z + 0.5 * k * delta, new, 1.0
    sign = 1.0 if delta > 0.0 else -1.0
    # x^2 - e x - b gap^2 / (2 k) = 0 with x = |D|, e = sign c - b limit
    gap = limit - sign * z
    excess = sign * c - b * limit
    lag = 0.5 * b * gap * gap / k
    root = math.sqrt(excess * excess + 4.0 * lag)
    x = 0.5 * (excess + root) if excess > 0.0 else 2.0 * lag / (root - excess)
    part = gap / (k * x)
    return sign * x, sign * (limit - 0.5 * gap * part), sign * limit, part


@jit(inline=True)
def polynomials(q, p, scale, springs, dampers):
    """Return N(q, p)."""
    spring, _ = odd_terms(q, springs, scale)
    damper, _ = odd_terms(p, dampers, scale)
    return spring + damper


@jit(inline=True)
def restoring(mode, law, h, q, p, z, u0, u1):
    """Return q, p and z behind a substep.

    ``law`` is (k_s, z_s, preload, s, bound, spring's coefficients, damper's); beyond the bound,
    before anything overflows, the stage is lost: all that follows is NaN.
    """
    k_s, limit, preload, scale, bound, springs, dampers = law
    b, bp = mode[2], mode[3]
    reach, speed = oscillator(mode, q, p, preload + u0, preload + u1)
    force0 = polynomials(q, p, scale, springs, dampers)
    delta, mean, _, _ = slide(reach - b * force0, b, z, k_s, limit)
    end = speed - bp * (force0 + mean)
    force = 0.5 * (force0 + polynomials(q + delta, end, scale, springs, dampers))
    delta, mean, z, _ = slide(reach - b * force, b, z, k_s, limit)
    q += delta
    if not abs(q) <= bound:
        return math.nan, math.nan, math.nan
    return q, speed - bp * (force + mean), z


restoring_run, restoring_step = loops(restoring)


@jit
def add_powers(x, scale, out, first, n):
    """Add ``x (x/scale)^(2i)``, i = 1, ..., n, to ``out`` from column ``first`` on."""
    square = (x / scale) * (x / scale)
    for i in range(first, first + n):
        x *= square
        out[i] += x


@jit
def slide_tangents(b, k, delta, mean, part, polynomial, first, dpolynomial, by):
    """Write the derivatives of D, F and the new z behind :func:`slide` to ``by``.

    ``polynomial`` and ``dpolynomial`` are N and its derivatives, ``first`` is the column of k_s.
    """
    sign = 1.0 if delta > 0.0 else -1.0
    for j in range(by.shape[1]):
        by[1, j] = dpolynomial[j]
    by[1, F] += part
    by[1, first] += 0.5 * part * part * delta
    by[1, first + 1] += sign * (1.0 - part)
    solve_tangents(b, 0.5 * k * part * part, polynomial + mean, by)
    for j in range(by.shape[1]):
        by[2, j] = 0.0 if part < 1.0 else k * by[0, j]
    if part < 1.0:
        by[2, first + 1] = sign
    else:
        by[2, F] += 1.0
        by[2, first] += delta


@jit
def restoring_tangents(
    mode, mode_by, law, h, n_substeps, u, du, before, dbefore, q, p, z, d, out, dout
):
    """Write q and its tangents.

    The parameters are w, zeta, the coefficients of spring and damper, k_s, z_s and the preload.
    """
    k_s, limit, preload, scale, bound, springs, dampers = law
    b, bp = mode[2], mode[3]
    n_springs, n_dampers = springs.size, dampers.size
    first = OWN + 2 + n_springs + n_dampers
    step = np.empty((3, FREE + first + 3 - OWN))
    by = np.empty((3, first + 2))
    dforce0, dforce = np.empty((2, first + 2))
    for k in range(u.size):
        u0 = before + preload
        begin(step)
        for i in range(n_substeps):
            start, stop = i / n_substeps, (i + 1) / n_substeps
            u1 = preload + before + (u[k] - before) * stop
            reach, speed = oscillator(mode, q, p, u0, u1)
            # with the force at the start
            from_q, by_q = odd_terms(q, springs, scale)
            from_p, by_p = odd_terms(p, dampers, scale)
            force0 = from_q + from_p
            dforce0[:] = 0.0
            dforce0[Q], dforce0[P] = by_q, by_p
            add_powers(q, scale, dforce0, OWN + 2, n_springs)
            add_powers(p, scale, dforce0, OWN + 2 + n_springs, n_dampers)
            delta, mean, _, part = slide(reach - b * force0, b, z, k_s, limit)
            slide_tangents(b, k_s, delta, mean, part, force0, first, dforce0, by)
            # with the mean of both ends
            end = speed - bp * (force0 + mean)
            from_q, by_q = odd_terms(q + delta, springs, scale)
            from_p, by_p = odd_terms(end, dampers, scale)
            for j in range(dforce.size):
                dforce[j] = dforce0[j] + by_q * by[0, j] - by_p * bp * by[1, j]
            dforce[Q] += by_q
            dforce[SPEED] += by_p
            dforce[SLOPE_B] -= by_p * (force0 + mean)
            add_powers(q + delta, scale, dforce, OWN + 2, n_springs)
            add_powers(end, scale, dforce, OWN + 2 + n_springs, n_dampers)
            dforce *= 0.5
            force = 0.5 * (force0 + (from_q + from_p))
            delta, mean, z, part = slide(reach - b * force, b, z, k_s, limit)
            slide_tangents(b, k_s, delta, mean, part, force, first, dforce, by)
            force += mean
            move_tangents(mode, mode_by, force, by, q, p, u0, u1, start, stop, step)
            q += delta
            p = speed - bp * force
            u0 = u1
        if not abs(q) <= bound:
            out[k:] = np.nan
            dout[k:] = np.nan
            return
        # the preload acts as the drive before the sample and at it do together
        step[:, -1] = step[:, 3] + step[:, 4]
        carry(step, k, du, dbefore, d, dout)
        before = u[k]
        out[k] = q
