r"""Loops over a mass, spring and damper with a Bouc-Wen force.

In units of the drive, with the level L and the shape g,

    f' = rho q' - rho |f/L|^n (|q'| sgn f + g q').

Along the way D of a substep (see ``_oscillator``), in the direction s of D, ``w = s f / L`` is a
function of ``t = rho |D| / L``,

    dw/dt = 1 - c w,   c = (1 + g) sigma for w > 0, (1 - g) sigma for w < 0,   sigma = |w|^(n-1),

which is linear in two pieces while sigma is held: its end and its mean over the way are known in
closed form (:func:`branch`), for any sign of c. D is the root of an increasing function, found by
Newton's method (:func:`way`). Sigma is 1 for ``n = 1``. Otherwise D is solved for twice, with sigma
at the start of the substep, then with that of the mean w found; it never exceeds its value at the
limit of w, so that substeps of any length end there. The end and the mean belong together, which
keeps the energy balance.
"""

import math

import numpy as np

from .._jit import jit
from ._oscillator import (
    FREE,
    OWN,
    F,
    begin,
    carry,
    decay,
    loops,
    move_tangents,
    oscillator,
    solve_tangents,
)

_TINY = 1e-100  # level: without hysteresis it may be 0
_STEEPEST = 600.0  # exponent of a force that grows: far beyond what ends a run
_LONGEST = 1e100  # way in units of the level
_FAR = 1e6  # force in units of the level
_SENSITIVE = 1e100  # tangents
_ITERATIONS = 60
_CLOSE = 1e-8  # relative step of Newton's method behind which the square is rounding
_PART, _FEWEST, _MOST = 0.05, 32, 100_000  # of a time constant of the first loading; steps
_SETTLED = 1e-14
_RHO, _LEVEL, _SHAPE, _EXPONENT = range(OWN + 2, OWN + 6)  # columns of the derivatives


@jit
def piece(t, w, c):
    """Return the end and the mean over the way t, and the quotients of ``a = c t``."""
    a = min(max(c * t, -_STEEPEST), _LONGEST)
    gone, phi, psi, chi = decay(a)
    return w - gone * w + t * phi, phi * w + t * psi, gone, phi, psi, chi, a


@jit
def crossing(w, c):
    """Return the way from ``w < 0`` to 0; infinite where there is none."""
    z = -c * w
    if z == 0.0:
        return -w
    return -w * math.log1p(z) / z if z > -1.0 else math.inf


@jit
def branch(t, w, behind, ahead):
    """Return w behind the way t, its mean over the way, and the slope of the mean by t.

    ``behind`` and ``ahead`` are c below and above zero.
    """
    c = behind if w < 0.0 else ahead
    if w < 0.0:
        first = crossing(w, behind)
        if t > first:
            _, mean, _, _, _, _, _ = piece(first, w, behind)
            end, rest, _, _, _, _, _ = piece(t - first, 0.0, ahead)
            mean = (first * mean + (t - first) * rest) / t
            return end, mean, (end - mean) / t
    end, mean, _, phi, psi, chi, a = piece(t, w, c)
    return end, mean, c * w * (psi - phi) + psi + a * (2.0 * chi - psi)


@jit
def piece_tangents(t, w, c):
    """Return the end and the mean over the way t, and the derivatives of each by (t, w, c)."""
    end, mean, gone, phi, psi, chi, a = piece(t, w, c)
    left = 1.0 - gone
    by_end = left * (1.0 - c * w), left, t * (t * (psi - phi) - left * w)
    bend = 2.0 * chi - psi
    by_mean = c * w * (psi - phi) + psi + a * bend, phi, t * (w * (psi - phi) + t * bend)
    return end, mean, by_end, by_mean


@jit
def branch_tangents(t, w, behind, ahead):
    """Return w behind the way t, its mean, and their derivatives by (t, w, behind, ahead)."""
    if w < 0.0:
        first = crossing(w, behind)
        if t > first:
            rest = t - first
            # of w at the way ``first``, on which the way to zero depends with the opposite sign
            _, mean, (_, zero_w, zero_c), (_, mean_w, mean_c) = piece_tangents(first, w, behind)
            end, rest_mean, by_end, by_mean = piece_tangents(rest, 0.0, ahead)
            mean = (first * mean + rest * rest_mean) / t
            return (
                end,
                mean,
                (by_end[0], by_end[0] * zero_w, by_end[0] * zero_c, by_end[2]),
                (
                    (end - mean) / t,
                    (first * mean_w + end * zero_w) / t,
                    (first * mean_c + end * zero_c) / t,
                    rest * by_mean[2] / t,
                ),
            )
        end, mean, by_end, by_mean = piece_tangents(t, w, behind)
        return end, mean, (*by_end, 0.0), (*by_mean, 0.0)
    end, mean, by_end, by_mean = piece_tangents(t, w, ahead)
    return (
        end,
        mean,
        (by_end[0], by_end[1], 0.0, by_end[2]),
        (by_mean[0], by_mean[1], 0.0, by_mean[2]),
    )


@jit
def sharpness(w, shape, exponent):
    """Return sigma and its derivatives by (w, shape, exponent)."""
    if exponent == 1.0:
        return 1.0, 0.0, 0.0, math.log(max(abs(w), _TINY)) if w != 0.0 else 0.0
    n, size = exponent, abs(w)
    if shape > -1.0:
        limit = (1.0 + shape) ** (-1.0 / n)
        if size > limit:
            sigma = limit ** (n - 1.0)
            return (
                sigma,
                0.0,
                -(1.0 - 1.0 / n) * sigma / (1.0 + shape),
                -sigma * math.log(1.0 + shape) / (n * n),
            )
    if size < _TINY:
        return 0.0, 0.0, 0.0, 0.0
    sigma = size ** (n - 1.0)
    return sigma, (n - 1.0) * sigma / w, 0.0, sigma * math.log(size)


@jit
def way(reach, b, w, rate, level, shape, sigma):
    """Return ``x = |D| >= 0`` that solves ``x + b level mean(w) = reach``; the end and mean of w.

    ``rate`` is rho / level.
    """
    behind, ahead = (1.0 - shape) * sigma, (1.0 + shape) * sigma
    pull = b * level
    left = reach - pull * w
    if not left > 0.0:
        return 0.0, w, w
    start = 1.0 - (behind if w < 0.0 else ahead) * w
    x = left / (1.0 + 0.5 * pull * rate * max(start, 0.0))
    end, mean = w, w
    for _ in range(_ITERATIONS):
        t = min(rate * x, _LONGEST)
        end, mean, slope = branch(t, w, behind, ahead)
        step = (reach - x - pull * mean) / (1.0 + pull * rate * max(slope, 0.0))
        # a step back never passes the begin
        step = max(step, -0.9 * x)
        x += step
        if abs(step) <= _CLOSE * x:
            # the rest is a straight line
            mean += slope * rate * step
            end += (1.0 - (behind if end < 0.0 else ahead) * end) * rate * step
            break
    return x, end, mean


@jit(inline=True)
def bouc_wen(mode, law, h, q, p, f, u0, u1):
    """Return q, p and f behind a substep.

    ``law`` is (rho, level, shape, exponent, bound); beyond the bound the stage is lost: all that
    follows is NaN.
    """
    rho, level, shape, exponent, bound = law
    size = max(level, _TINY)
    rate = rho / size
    b = mode[2]
    reach, speed = oscillator(mode, q, p, u0, u1)
    side = 1.0 if reach >= b * f else -1.0
    w = side * f / size
    sigma = 1.0
    if exponent != 1.0:
        sigma, _, _, _ = sharpness(w, shape, exponent)
        _, _, mean = way(side * reach, b, w, rate, size, shape, sigma)
        sigma, _, _, _ = sharpness(mean, shape, exponent)
    x, end, mean = way(side * reach, b, w, rate, size, shape, sigma)
    q += side * x
    f = side * size * end
    if not (abs(q) <= bound and abs(f) <= bound):
        return math.nan, math.nan, math.nan
    return q, speed - mode[3] * side * size * mean, f


bouc_wen_run, bouc_wen_step = loops(bouc_wen)


@jit
def sharpness_tangents(w, side, shape, exponent, level, by, dsigma):
    """Return sigma and write its derivatives; ``by[1]`` are those of the force ``side w level``."""
    sigma, by_w, by_shape, by_exponent = sharpness(w, shape, exponent)
    share = side * by_w / level
    for j in range(dsigma.size):
        dsigma[j] = share * by[1, j]
    dsigma[_LEVEL] -= by_w * w / level
    dsigma[_SHAPE] += by_shape
    dsigma[_EXPONENT] += by_exponent
    return sigma


@jit
def way_tangents(x, side, b, w, rho, level, shape, sigma, dsigma, by):
    """Write the derivatives of D, of the mean force and of the new force to ``by``.

    ``x``, ``w`` and ``sigma`` are as in :func:`way`, ``side`` is the direction of D.
    """
    t = min(rho / level * x, _LONGEST)
    behind, ahead = (1.0 - shape) * sigma, (1.0 + shape) * sigma
    end, mean, by_end, by_mean = branch_tangents(t, w, behind, ahead)
    force_tangents(side, level * mean, x, t, w, rho, level, shape, sigma, by_mean, dsigma, by, 1)
    solve_tangents(b, by_mean[0] * rho, side * level * mean, by)
    force_tangents(side, level * end, x, t, w, rho, level, shape, sigma, by_end, dsigma, by, 2)
    for j in range(by.shape[1]):
        by[2, j] += by_end[0] * rho * by[0, j]


@jit
def force_tangents(side, force, x, t, w, rho, level, shape, sigma, by_branch, dsigma, by, i):
    """Write the derivatives of ``side force``, behind a given way, to ``by[i]``.

    ``by_branch`` are those of the result of :func:`branch` that is ``force / level``.
    """
    by_t, by_w, by_behind, by_ahead = by_branch
    by_sigma = side * level * ((1.0 - shape) * by_behind + (1.0 + shape) * by_ahead)
    for j in range(by.shape[1]):
        by[i, j] = by_sigma * dsigma[j]
    by[i, F] += by_w
    by[i, _RHO] += side * by_t * x
    by[i, _LEVEL] += side * (force / level - by_t * t - by_w * w)
    by[i, _SHAPE] += side * level * sigma * (by_ahead - by_behind)


@jit
def bouc_wen_tangents(
    mode, mode_by, law, h, n_substeps, u, du, before, dbefore, q, p, f, d, out, dout
):
    """Write q and its tangents, the parameters being w, zeta, rho, level, shape and exponent."""
    rho, level, shape, exponent, bound = law
    size = max(level, _TINY)
    rate = rho / size
    b, bp = mode[2], mode[3]
    step = np.empty((3, FREE + 6))
    by = np.zeros((3, OWN + 6))
    dsigma = np.zeros(OWN + 6)
    for k in range(u.size):
        u0 = before
        begin(step)
        for i in range(n_substeps):
            start, stop = i / n_substeps, (i + 1) / n_substeps
            u1 = before + (u[k] - before) * stop
            reach, speed = oscillator(mode, q, p, u0, u1)
            side = 1.0 if reach >= b * f else -1.0
            w = side * f / size
            sigma = 1.0
            if exponent != 1.0:
                for j in range(by.shape[1]):
                    by[1, j] = 1.0 if j == F else 0.0
                sigma = sharpness_tangents(w, side, shape, exponent, size, by, dsigma)
                x, _, mean = way(side * reach, b, w, rate, size, shape, sigma)
                way_tangents(x, side, b, w, rho, size, shape, sigma, dsigma, by)
                sigma = sharpness_tangents(mean, side, shape, exponent, size, by, dsigma)
            x, end, mean = way(side * reach, b, w, rate, size, shape, sigma)
            if exponent == 1.0:
                dsigma[_EXPONENT] = sharpness(mean, shape, exponent)[3]
            way_tangents(x, side, b, w, rho, size, shape, sigma, dsigma, by)
            force = side * size * mean
            move_tangents(mode, mode_by, force, by, q, p, u0, u1, start, stop, step)
            q += side * x
            p = speed - bp * force
            f = side * size * end
            u0 = u1
        if not (abs(q) <= bound and abs(f) <= bound):
            out[k:] = np.nan
            dout[k:] = np.nan
            return
        carry(step, k, du, dbefore, d, dout)
        before = u[k]
        out[k] = q
        largest = 0.0
        for i in range(3):
            for j in range(d.shape[1]):
                largest = max(largest, abs(d[i, j]))
        if not largest <= _SENSITIVE:
            # a chaotic motion, whose sums of squares would overflow
            dout[k + 1 :] = np.nan
            bouc_wen_run(mode, law, h, n_substeps, u[k + 1 :], before, q, p, f, out[k + 1 :])
            return


@jit
def slope_at(f, rho, level, shape, exponent, by):
    """Return ``df/dq`` of a first loading; its derivatives by f and four parameters go to ``by``.

    The parameters are rho, level, shape and exponent.
    """
    w = f / level
    if w <= 0.0:
        by[:] = 0.0
        by[1] = 1.0
        return rho
    log = math.log(w)
    power = math.exp(min(exponent * log, _STEEPEST))
    by[0] = -rho * (1.0 + shape) * exponent * power / f
    by[1] = 1.0 - (1.0 + shape) * power
    by[2] = -by[0] * w
    by[3] = -rho * power
    by[4] = -rho * (1.0 + shape) * power * log
    return rho * by[1]


@jit
def first_loading(load, rho, level, shape, exponent, by):
    """Return the force f at rest under ``load = q + f`` and write its derivatives to ``by`` (5,).

    These are by the load and by rho, level, shape and exponent. Over the load as it grows from zero
    ``df = k / (1 + k)`` with ``k = df/dq``, which is always bounded.
    """
    by[:] = 0.0
    if not (rho > 0.0 and level > 0.0):
        return 0.0
    if not load > 0.0:
        by[0] = rho / (1.0 + rho)
        return 0.0
    # at most so steep, where f is largest
    largest = load
    if shape > -1.0:
        largest = min(load, level * (1.0 + shape) ** (-1.0 / exponent))
    slopes, rates = np.empty((2, 5))
    k = slope_at(largest, rho, level, shape, exponent, slopes)
    steep = load * abs(slopes[0]) / (1.0 + max(k, 0.0))
    n = int(min(max(steep / _PART, _FEWEST), _MOST))
    h = load / n
    f = 0.0
    weights = (0.0, 0.5, 0.5, 1.0)
    values, change = np.zeros((2, 5))
    for _ in range(n):
        total, last = 0.0, 0.0
        change[:] = 0.0
        rates[:] = 0.0
        for stage in range(4):
            part = weights[stage] * h
            k = slope_at(f + part * last, rho, level, shape, exponent, slopes)
            last = k / (1.0 + k)
            # of the rate, by the force and directly
            inner = 1.0 / ((1.0 + k) * (1.0 + k))
            share = (1.0 if stage == 0 or stage == 3 else 2.0) / 6.0
            total += share * last
            for j in range(1, 5):
                rates[j] = inner * (slopes[j] + slopes[0] * (values[j] + part * rates[j]))
                change[j] += share * rates[j]
        f += h * total
        for j in range(1, 5):
            values[j] += h * change[j]
        if total < _SETTLED:
            break
    k = slope_at(f, rho, level, shape, exponent, slopes)
    by[0] = k / (1.0 + k)
    by[1:] = values[1:]
    return f


@jit
def follow(q, level, shape, exponent, out):
    """Write the force of a stage that moves as ``q`` (n,) prescribes, rho = 1, to ``out`` (n,).

    A law without a limit ends in NaN where it leaves all bounds.
    """
    f, before = 0.0, q[0] if q.size else 0.0
    for k in range(q.size):
        change = q[k] - before
        if change != 0.0:
            side = 1.0 if change > 0.0 else -1.0
            w, t = side * f / level, abs(change) / level
            sigma, _, _, _ = sharpness(w, shape, exponent)
            if exponent != 1.0:
                _, mean, _ = branch(t, w, (1.0 - shape) * sigma, (1.0 + shape) * sigma)
                sigma, _, _, _ = sharpness(mean, shape, exponent)
            w, _, _ = branch(t, w, (1.0 - shape) * sigma, (1.0 + shape) * sigma)
            f = side * level * w
        if not abs(f) <= _FAR * level:
            out[k:] = np.nan
            return
        before = q[k]
        out[k] = f
