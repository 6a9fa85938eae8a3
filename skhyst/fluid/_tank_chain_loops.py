"""Loops over tanks in a row, each with the balance ``tau w' = q - o(w)``.

The outflow is ``o(w) = w (w^2 + e^2)^((p - 1) / 2)``: the power ``w^p``, and proportional to the
level where that is below ``e``, so that its slope stays finite in an empty tank.

Over a substep h the inflow q is constant and o is replaced by its tangent, for which the balance is
solved exactly: with ``k = h / tau`` and ``z = -k o'(w)`` the level moves by

    D = k (q - o(w)) (exp(z) - 1) / z,

the exponential Rosenbrock-Euler method: of second order, stable for any h, exact for p = 1
(Hochbruck and Ostermann, *Acta Numerica*, 2010, section 2.4). The mean outflow is what the balance
leaves, ``q - D / k``, so nothing is lost between the tanks. A level that would pass its ceiling c
ends there; for the part of the substep in which it has, ``q - o(c)`` flows over.
"""

import math

import numpy as np

from .._jit import jit

LAMINAR = 1e-2  # e
_SMALL = 1e-4  # |z| below which quotients are series
_GONE = -40.0  # z below which nothing is left of exp(z) beside 1


@jit
def outflow(w, p):
    """Return o, its derivatives by w and by p, and the derivatives of the first of these."""
    s = w * w + LAMINAR * LAMINAR
    half, power = 0.5 * math.log(s), s ** (0.5 * (p - 3.0))
    o = w * s * power
    slope = power * (LAMINAR * LAMINAR + p * w * w)
    bend = (p - 1.0) * w * power / s * (3.0 * LAMINAR * LAMINAR + p * w * w)
    return o, slope, o * half, bend, slope * half + power * w * w


@jit
def _move(w, q, k, p):
    """Return D and its derivatives by w, q, k and p."""
    o, slope, o_p, bend, slope_p = outflow(w, p)
    z = -k * slope
    if z > -_SMALL:
        part = k * (1.0 + 0.5 * z)  # k (exp(z) - 1) / z
        part_k, part_slope = 1.0 + z, -0.5 * k * k
    else:
        rest = math.exp(z) if z > _GONE else 0.0  # squares of less would underflow
        part = (1.0 - rest) / slope
        part_k, part_slope = rest, (k * rest - part) / slope
    f = q - o
    return (
        f * part,
        f * part_slope * bend - slope * part,
        part,
        f * part_k,
        f * part_slope * slope_p - o_p * part,
    )


@jit(inline=True)
def tank_sample(before, u, levels, k, p, ceiling, share, offset, scale, n_substeps, held):
    """Move the levels, with which ``levels`` begins, over an interval of the drive.

    ``k``, ``p``, ``ceiling`` and ``share``, the part of its overflow that a tank passes on, are
    (n_tanks,); ``held`` keeps the drive of the last sample over the interval.
    """
    for s in range(n_substeps):
        part = 0.0 if held else (s + 0.5) / n_substeps
        q = max((before + part * (u - before) - offset) / scale, 0.0)
        for j in range(k.size):
            w = levels[j]
            move, _, _, _, _ = _move(w, q, k[j], p[j])
            over = 0.0
            if w + move > ceiling[j]:
                room = ceiling[j] - w
                most, _, _, _, _ = outflow(ceiling[j], p[j])
                over = max(q - most, 0.0) * (1.0 - room / move)
                move = room
                levels[j] = ceiling[j]
            elif w + move < 0.0:
                move = -w
                levels[j] = 0.0
            else:
                levels[j] = w + move
            q = q - over - move / k[j] + share[j] * over
            if q < 0.0:
                q = 0.0


@jit
def tank_run(u, before, levels, k, p, ceiling, share, offset, scale, n_substeps, held, out):
    """Write the level of the last tank to ``out`` (n,); ``levels`` (n_tanks,) are overwritten."""
    for i in range(u.size):
        tank_sample(before, u[i], levels, k, p, ceiling, share, offset, scale, n_substeps, held)
        before = u[i]
        out[i] = levels[-1]


@jit
def tank_step(u, c, s):
    """Return the response at one sample; ``s`` are the levels and the last drive.

    ``c`` is (k, p, ceiling, share, offset, scale, n_substeps, held) of :func:`tank_sample`, then
    (gain, intercept, most that the sensor reads).
    """
    k, p, ceiling, share, offset, scale, n_substeps, held, gain, intercept, most = c
    n = k.size
    tank_sample(s[n], u, s, k, p, ceiling, share, offset, scale, int(n_substeps), held > 0.0)
    s[n] = u
    return gain * min(s[n - 1], most) + intercept


@jit
def tank_tangents(
    u, du, before, dbefore, levels, d, k, tau, p, ceiling, share, offset, scale, n_substeps, held,
    out, dout,
):  # fmt: skip
    """Write what :func:`tank_run` does, and its tangents to ``dout`` (n, n_columns).

    Behind the m columns of ``du`` are those of the time constants, the exponents, where there are
    limits the ceilings and shares but the last, and the offset. ``dbefore`` (m,) and ``d``
    (n_tanks, n_columns), overwritten, are the tangents of ``before`` and ``levels``.
    """
    m, n, n_columns = du.shape[1], levels.size, d.shape[1]
    limited = n_columns > m + 2 * n + 1
    dq, dmove, dover = np.empty(n_columns), np.empty(n_columns), np.empty(n_columns)
    last = dbefore.copy()
    for i in range(u.size):
        for s in range(n_substeps):
            part = 0.0 if held else (s + 0.5) / n_substeps
            q = (before + part * (u[i] - before) - offset) / scale
            dq[:] = 0.0
            if q > 0.0:
                for c in range(m):
                    dq[c] = (last[c] + part * (du[i, c] - last[c])) / scale
                dq[-1] = -1.0 / scale
            else:
                q = 0.0
            for j in range(n):
                w = levels[j]
                own = m + j
                move, by_w, by_q, by_k, by_p = _move(w, q, k[j], p[j])
                for c in range(n_columns):
                    dmove[c] = by_w * d[j, c] + by_q * dq[c]
                    dover[c] = 0.0
                dmove[own] -= by_k * k[j] / tau[j]
                dmove[own + n] += by_p
                over = 0.0
                if w + move > ceiling[j]:
                    room = ceiling[j] - w
                    o, slope, o_p, _, _ = outflow(ceiling[j], p[j])
                    full, excess = 1.0 - room / move, q - o
                    if excess > 0.0:
                        over = excess * full
                        for c in range(n_columns):
                            dover[c] = full * dq[c] + excess * (
                                d[j, c] / move + room / move * (dmove[c] / move)
                            )
                        dover[own + n] -= full * o_p
                        if limited:
                            dover[own + 2 * n] -= full * slope + excess / move
                    for c in range(n_columns):
                        dmove[c] = -d[j, c]
                        d[j, c] = 0.0
                    if limited:
                        dmove[own + 2 * n] += 1.0
                        d[j, own + 2 * n] = 1.0
                    move = room
                    levels[j] = ceiling[j]
                elif w + move < 0.0:
                    for c in range(n_columns):
                        dmove[c] = -d[j, c]
                        d[j, c] = 0.0
                    move = -w
                    levels[j] = 0.0
                else:
                    for c in range(n_columns):
                        d[j, c] += dmove[c]
                    levels[j] = w + move
                q = q - over - move / k[j] + share[j] * over
                if q < 0.0:
                    q = 0.0
                    dq[:] = 0.0
                else:
                    for c in range(n_columns):
                        dq[c] += (share[j] - 1.0) * dover[c] - dmove[c] / k[j]
                    dq[own] -= move / (k[j] * tau[j])
                    if limited and j < n - 1:
                        dq[own + 3 * n] += over
        before = u[i]
        for c in range(m):
            last[c] = du[i, c]
        out[i] = levels[-1]
        for c in range(n_columns):
            dout[i, c] = d[-1, c]
