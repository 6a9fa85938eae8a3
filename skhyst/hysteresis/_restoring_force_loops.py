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
from ._oscillator_loops import FREE, carry, oscillator, oscillator_tangents

__all__ = [
    "restoring_run",
    "restoring_tangents",
    "slide",
]


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
    """Solve ``D = c - b mean(z)``; return D, the mean of z, z behind it and whether it slips.

    Then follow the derivatives of D by (c, b, z, k, limit).
    """
    one = 1.0 / (1.0 + 0.5 * b * k)
    delta = (c - b * z) * one
    new = z + k * delta
    if abs(new) <= limit:
        mean = z + 0.5 * k * delta
        by = (one, -one * mean, -one * b, -0.5 * one * b * delta, 0.0)
        return delta, mean, new, False, by
    sign = 1.0 if delta > 0.0 else -1.0
    # x^2 - e x - b gap^2 / (2 k) = 0 with x = |D|, e = sign c - b limit
    gap = limit - sign * z
    excess = sign * c - b * limit
    lag = 0.5 * b * gap * gap / k
    root = math.sqrt(excess * excess + 4.0 * lag)
    x = 0.5 * (excess + root) if excess > 0.0 else 2.0 * lag / (root - excess)
    mean = sign * (limit - 0.5 * gap * gap / (k * x))
    # derivatives of x
    by_excess = x / root
    by_gap = b * gap / (k * root)
    return (
        sign * x,
        mean,
        sign * limit,
        True,
        (
            by_excess,
            sign * (0.5 * gap * gap / (k * root) - limit * by_excess),
            -by_gap,
            -sign * lag / (k * root),
            sign * (by_gap - b * by_excess),
        ),
    )


@jit
def restoring_run(mode, law, springs, dampers, h, n_substeps, u, before, q, p, z, out):
    """Write q to ``out`` (n,) and return the last q, p and z.

    ``law`` is (k_s, z_s, preload, s, bound); beyond the bound, before anything overflows, the
    stage is lost: all that follows is NaN.
    """
    k_s, limit, preload, scale, bound = law
    b, bp = mode[2], mode[3]
    for k in range(u.size):
        u0 = before + preload
        for i in range(n_substeps):
            u1 = preload + before + (u[k] - before) * ((i + 1) / n_substeps)
            reach, speed = oscillator(mode, q, p, u0, u1)
            force0 = odd_terms(q, springs, scale)[0] + odd_terms(p, dampers, scale)[0]
            delta, mean, _, _, _ = slide(reach - b * force0, b, z, k_s, limit)
            end = speed - bp * (force0 + mean)
            force = odd_terms(q + delta, springs, scale)[0] + odd_terms(end, dampers, scale)[0]
            force = 0.5 * (force0 + force)
            delta, mean, z, _, _ = slide(reach - b * force, b, z, k_s, limit)
            q += delta
            p = speed - bp * (force + mean)
            u0 = u1
        if not abs(q) <= bound:
            out[k:] = np.nan
            return np.nan, np.nan, np.nan
        before = u[k]
        out[k] = q
    return q, p, z


@jit
def powers(x, scale, out):
    """Write ``x (x/scale)^(2i)``, i = 1, 2, ..., to ``out``."""
    square = (x / scale) * (x / scale)
    for i in range(out.size):
        x *= square
        out[i] = x


@jit
def slide_tangents(
    by, slips, delta, z, k, limit, b, dreach, dforce, force, mode_by, step, first, ddelta, dmean
):
    """Write the tangents of D and of the mean of z, (n_columns,), behind :func:`slide`.

    ``force`` and ``dforce`` are N and its tangents, ``first`` is the column of k.
    """
    for j in range(dreach.size):
        ddelta[j] = by[0] * (dreach[j] - b * dforce[j]) + by[2] * step[2, j]
    for i in range(2):
        ddelta[FREE + i] += (by[1] - by[0] * force) * mode_by[i, 2]
    ddelta[first] += by[3]
    ddelta[first + 1] += by[4]
    if not slips:
        for j in range(dreach.size):
            dmean[j] = step[2, j] + 0.5 * k * ddelta[j]
        dmean[first] += 0.5 * delta
    else:
        sign = 1.0 if delta > 0.0 else -1.0
        gap, x = limit - sign * z, abs(delta)
        for j in range(dreach.size):
            dmean[j] = (gap * step[2, j] + 0.5 * gap * gap / x * ddelta[j]) / (k * x)
        dmean[first] += sign * 0.5 * gap * gap / (k * k * x)
        dmean[first + 1] += sign * (1.0 - gap / (k * x))


@jit
def apply_step(dspeed, dforce, ddelta, dhidden, bp, force, mode_by, dstate):
    """Move the tangents of the state ``dstate`` (3, n_columns) over a substep."""
    for j in range(dspeed.size):
        dstate[0, j] += ddelta[j]
        dstate[1, j] = dspeed[j] - bp * dforce[j]
        dstate[2, j] = dhidden[j]
    dstate[1, FREE] -= mode_by[0, 3] * force
    dstate[1, FREE + 1] -= mode_by[1, 3] * force


@jit
def restoring_tangents(
    mode,
    mode_by,
    law,
    springs,
    dampers,
    h,
    n_substeps,
    u,
    du,
    before,
    dbefore,
    q,
    p,
    z,
    d,
    out,
    dout,
):
    """Write q (n,) and its tangents (n, m + p).

    The columns are those of ``du`` (n, m), then the derivatives by w, zeta, the coefficients of
    spring and damper, k_s, z_s and the preload. ``dbefore`` (m,) and ``d`` (3, m + p) are the
    tangents of the drive and of the state before the first sample; ``law`` as in
    :func:`restoring_run`.
    """
    k_s, limit, preload, scale, bound = law
    b, bp = mode[2], mode[3]
    spring = FREE + 2
    damper = spring + springs.size
    first = damper + dampers.size
    n_columns = first + 3
    step = np.empty((3, n_columns))
    dreach, dspeed, ddelta, dmean, dforce0, dforce, dhidden = np.empty((7, n_columns))
    spring_powers, spring_ends = np.empty((2, springs.size))
    damper_powers, damper_ends = np.empty((2, dampers.size))
    for k in range(u.size):
        u0 = before + preload
        step[:] = 0.0
        step[0, 0] = step[1, 1] = step[2, 2] = 1.0
        for i in range(n_substeps):
            start, stop = i / n_substeps, (i + 1) / n_substeps
            u1 = preload + before + (u[k] - before) * stop
            reach, speed = oscillator(mode, q, p, u0, u1)
            oscillator_tangents(mode, mode_by, q, p, u0, u1, start, stop, step, dreach, dspeed)
            dreach[first + 2] += b
            dspeed[first + 2] += bp
            # with the force at the start
            from_q, by_q = odd_terms(q, springs, scale)
            from_p, by_p = odd_terms(p, dampers, scale)
            force0 = from_q + from_p
            powers(q, scale, spring_powers)
            powers(p, scale, damper_powers)
            for j in range(n_columns):
                dforce0[j] = by_q * step[0, j] + by_p * step[1, j]
            for j in range(springs.size):
                dforce0[spring + j] += spring_powers[j]
            for j in range(dampers.size):
                dforce0[damper + j] += damper_powers[j]
            delta, mean, new, slips, by = slide(reach - b * force0, b, z, k_s, limit)
            slide_tangents(
                by,
                slips,
                delta,
                z,
                k_s,
                limit,
                b,
                dreach,
                dforce0,
                force0,
                mode_by,
                step,
                first,
                ddelta,
                dmean,
            )
            # with the mean of both ends
            end = speed - bp * (force0 + mean)
            from_q, by_q = odd_terms(q + delta, springs, scale)
            from_p, by_p = odd_terms(end, dampers, scale)
            force = 0.5 * (force0 + (from_q + from_p))
            for j in range(n_columns):
                dend = dspeed[j] - bp * (dforce0[j] + dmean[j])
                dforce[j] = dforce0[j] + by_q * (step[0, j] + ddelta[j]) + by_p * dend
            for j in range(2):
                dforce[FREE + j] -= by_p * mode_by[j, 3] * (force0 + mean)
            powers(q + delta, scale, spring_ends)
            powers(end, scale, damper_ends)
            for j in range(springs.size):
                dforce[spring + j] += spring_ends[j]
            for j in range(dampers.size):
                dforce[damper + j] += damper_ends[j]
            for j in range(n_columns):
                dforce[j] *= 0.5
            delta, mean, new, slips, by = slide(reach - b * force, b, z, k_s, limit)
            slide_tangents(
                by,
                slips,
                delta,
                z,
                k_s,
                limit,
                b,
                dreach,
                dforce,
                force,
                mode_by,
                step,
                first,
                ddelta,
                dmean,
            )
            for j in range(n_columns):
                dhidden[j] = 0.0 if slips else step[2, j] + k_s * ddelta[j]
                dforce[j] += dmean[j]
            if slips:
                dhidden[first + 1] = 1.0 if delta > 0.0 else -1.0
            else:
                dhidden[first] += delta
            force += mean
            apply_step(dspeed, dforce, ddelta, dhidden, bp, force, mode_by, step)
            q += delta
            p = speed - bp * force
            z = new
            u0 = u1
        if not abs(q) <= bound:
            out[k:] = np.nan
            dout[k:] = np.nan
            return
        carry(step, dbefore if k == 0 else du[k - 1], du[k], d)
        before = u[k]
        out[k] = q
        dout[k] = d[0]
