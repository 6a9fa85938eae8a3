r"""Mass without a spring, driven by a force against friction and between stops.

With the displacement x, the velocity v and the force u,

    m x'' + d(v) x' + F(v) + k_3 (x - x_0)^3 + S(x, v) = u + u_0 + r t,

where F is Coulomb friction: ``F = s F_s`` in sliding, ``s = sgn(v)``, and the balance of the other
forces at rest, as long as these are below ``q (F_c + F_d)``,

    F_s = q [F_c (1 + s a) + F_d exp(-(v / v_s)^2)],    d = d_0 (1 + s b),

with a factor q that is 1, or that of a load, which changes from sample to sample. If friction
depends on the displacement, q is also multiplied by ``1 + c (x - x_f)``, but not below zero.

Over a substep h the other forces are replaced by a straight line. Mass and damper then move by

    x1 - x0 = t phi v0 + t^2 psi a0 + t^3 chi j,    v1 = exp(-q t) v0 + t phi a0 + t^2 psi j

with ``q = d/m``, the acceleration a0 without damping at the start, its slope j, and the functions
phi, psi, chi of ``q t`` (see ``_oscillator.decay``), until the velocity is zero. The time at which
it is, the root of a scalar equation, is found to rounding; there the mass sticks, or turns round.
A mass that sticks breaks away when the force reaches the level of friction. So motion under Coulomb
friction (``F_d = 0``) is exact for a force that is held, or a straight line, between samples, as is
the linear part. The force of spring and stops, the level of the Stribeck curve and the dependence
of friction on the displacement are held over a substep: at their values at its start for a
predictor, then at the mean of both ends. This is of second order, and of first order where the
damper of a stop begins to act, since its force jumps. The factor of a load is a straight line
between samples, and held at its mean over a substep: second order.

Tangents include those of the times at which the mass stops and breaks away. Where it stops the
velocity is zero, and while it sticks so are all its derivatives.
"""

import dataclasses
import math
from dataclasses import dataclass
from itertools import pairwise, product
from numbers import Integral

import numpy as np

from .._jit import jit
from .._sklearn import Interval, StrOptions
from ..base import ParametricModel, refine
from ..operators import (
    CompiledLaw,
    HeldInput,
    Operator,
    ScaledWithin,
    StartValues,
    as_signal,
    parameter,
    resampled,
    with_substeps_resampled,
)
from ..optimize import (
    RecordData,
    best_from_own_starts,
    estimate_start_values,
    identify_from_own_starts,
)
from ._oscillator import (
    FINE,
    WINDOWS,
    decay,
    gradient_factor,
    least_squares,
    rough_method,
    weigh,
)

_EVENTS = 12  # most motions and sticks in a substep; a straight force causes at most three of each
_HALVINGS = 80  # most halvings of a bracket, down to rounding
_TOLERANCE = 1e-15
_C4, _C5, _C6, _C7, _C8, _C9 = (1.0 / math.factorial(k) for k in range(4, 10))
_LARGEST = 1e50  # displacement beyond which a run has diverged; squares of it do not overflow
_SERIES = 0.1  # below it the quotients suffer from cancellation
# quantities that a substep depends on, rows of its derivatives: the force at both ends, friction of
# sliding and of sticking forward and backward, damping forward and backward, mass
_START, _END, _AHEAD, _BACK, _STUCK_AHEAD, _STUCK_BACK, _DAMP_AHEAD, _DAMP_BACK, _MASS = range(9)


@jit
def flow(t, q, v, a, j):
    """Return displacement and velocity after a time t, from the velocity v."""
    gone, phi, psi, chi = decay(q * t)
    return t * (phi * v + t * (psi * a + t * chi * j)), v - gone * v + t * (phi * a + t * psi * j)


@jit
def stop_time(h, q, v, a, j, sign):
    """Return when the velocity, of the given sign, is zero for the first time; -1 if not by h.

    It has one extremum at most, since the acceleration is monotone.
    """
    _, end = flow(h, q, v, a, j)
    first = sign * (a - q * v)  # acceleration at the start, in the direction of motion
    turn = -1.0  # when the acceleration is zero
    ratio = q * (a - q * v)
    if j != 0.0 and first * sign * j < 0.0:
        z = -ratio / j
        turn = -(a - q * v) / j
        if z > -1.0 and abs(z) > 1e-12:
            turn = math.log1p(z) / q
    low, high = 0.0, h
    if sign * end > 0.0:
        if not (first < 0.0 and turn > 0.0 and turn < h):
            return -1.0
        _, least = flow(turn, q, v, a, j)
        if sign * least > 0.0:
            return -1.0
        high = turn
    elif v == 0.0:  # it has left zero, and returns after its largest value
        if not (turn > 0.0 and turn < h):
            return -1.0
        low = turn
    t = 0.5 * (low + high)
    for _ in range(_HALVINGS):
        _, now = flow(t, q, v, a, j)
        if sign * now > 0.0:
            low = t
        else:
            high = t
        slope = a + j * t - q * now
        new = 0.5 * (low + high)
        if slope != 0.0:
            step = t - now / slope
            if step > low and step < high:
                new = step
        if abs(new - t) <= _TOLERANCE * h or high - low <= _TOLERANCE * h:
            return new
        t = new
    return t


@jit
def direction(v, free, force, slope, stuck_ahead, stuck_back):
    """Return the direction of the motion that continues or begins; zero if the mass sticks.

    ``free`` is the direction in which it has just broken away, or zero.
    """
    if v > 0.0:
        return 1.0
    if v < 0.0:
        return -1.0
    if free != 0.0:
        return free
    if force > stuck_ahead:
        return 1.0
    if force < -stuck_back:
        return -1.0
    if stuck_ahead + stuck_back == 0.0:  # there is no friction
        return 1.0 if slope >= 0.0 else -1.0
    return 0.0


@jit
def breakaway_time(h, start, slope, stuck_ahead, stuck_back):
    """Return when in a substep the force exceeds friction; the end if it is constant."""
    level = stuck_ahead if slope > 0.0 else -stuck_back
    return (level - start) / slope if slope != 0.0 else h


@jit
def move(h, start, end, friction, x, v):
    """Return x and v after a substep under a force from ``start`` to ``end``.

    ``friction`` is (sliding forward, backward, sticking forward, backward, damping forward,
    backward, mass).
    """
    ahead, back, stuck_ahead, stuck_back, damp_ahead, damp_back, mass = friction
    slope = (end - start) / h
    now, free = 0.0, 0.0  # free: direction in which the mass breaks away
    for _ in range(_EVENTS):
        force = start + slope * now
        sign = direction(v, free, force, slope, stuck_ahead, stuck_back)
        if sign == 0.0:
            later = breakaway_time(h, start, slope, stuck_ahead, stuck_back)
            if not later < h:
                break
            now = max(later, now)
            free = 1.0 if slope > 0.0 else -1.0
            continue
        free = 0.0
        level, damping = (ahead, damp_ahead) if sign > 0.0 else (back, damp_back)
        q, a, j = damping / mass, (force - sign * level) / mass, slope / mass
        t = stop_time(h - now, q, v, a, j, sign)
        stops = t >= 0.0
        if not stops:
            t = h - now
        distance, speed = flow(t, q, v, a, j)
        x += distance
        v = 0.0 if stops else speed
        now += t
        if not stops:
            break
    return x, v


@jit
def flow_tangents(t, q, v, a, j, speed):
    """Return the derivatives of displacement and velocity after t by q, v, a, j and t.

    ``speed`` is that velocity.
    """
    z = q * t
    gone, phi, psi, chi = decay(z)
    if abs(z) < _SERIES:
        omega = _C4 - z * (_C5 - z * (_C6 - z * (_C7 - z * (_C8 - z * _C9))))
    else:
        omega = (1.0 / 6.0 - chi) / z
    by_phi, by_psi, by_chi = psi - phi, 2.0 * chi - psi, 3.0 * omega - chi
    square = t * t
    distance = (
        square * (by_phi * v + t * (by_psi * a + t * by_chi * j)),
        t * phi,
        square * psi,
        square * t * chi,
        speed,
    )
    rate = (
        t * ((gone - 1.0) * v + t * (by_phi * a + t * by_psi * j)),
        1.0 - gone,
        t * phi,
        square * psi,
        a + j * t - q * speed,
    )
    return distance, rate


@jit
def move_tangents(h, start, end, friction, x, v, by, d, dnow):
    """Do :func:`move`, and carry the derivatives ``d`` (2, n) of x and v along.

    ``by`` (9, n) are the derivatives of the quantities that the substep depends on, ``dnow`` (n,)
    is workspace for those of the time within it.
    """
    ahead, back, stuck_ahead, stuck_back, damp_ahead, damp_back, mass = friction
    slope = (end - start) / h
    n = d.shape[1]
    now, free = 0.0, 0.0
    dnow[:] = 0.0
    for _ in range(_EVENTS):
        force = start + slope * now
        sign = direction(v, free, force, slope, stuck_ahead, stuck_back)
        if sign == 0.0:
            for k in range(n):
                d[1, k] = 0.0
            later = breakaway_time(h, start, slope, stuck_ahead, stuck_back)
            if not later < h:
                break
            now = max(later, now)
            free = 1.0 if slope > 0.0 else -1.0
            # the time at which force and level are equal, by the implicit function theorem
            for k in range(n):
                by_level = by[_STUCK_AHEAD, k] if slope > 0.0 else -by[_STUCK_BACK, k]
                by_force = by[_START, k] + (by[_END, k] - by[_START, k]) * (now / h)
                dnow[k] = (by_level - by_force) / slope
            continue
        free = 0.0
        forward = sign > 0.0
        level, damping = (ahead, damp_ahead) if forward else (back, damp_back)
        q, a, j = damping / mass, (force - sign * level) / mass, slope / mass
        t = stop_time(h - now, q, v, a, j, sign)
        stops = t >= 0.0
        if not stops:
            t = h - now
        distance, speed = flow(t, q, v, a, j)
        by_distance, by_speed = flow_tangents(t, q, v, a, j, 0.0 if stops else speed)
        for k in range(n):
            # derivatives of a, j and q of the motion, of which a also depends on when it began
            dmass = by[_MASS, k]
            by_level, by_damping = by[_BACK, k], by[_DAMP_BACK, k]
            if forward:
                by_level, by_damping = by[_AHEAD, k], by[_DAMP_AHEAD, k]
            change = by[_END, k] - by[_START, k]
            da = by[_START, k] + change * (now / h) + slope * dnow[k] - sign * by_level - a * dmass
            da /= mass
            dj = (change / h - j * dmass) / mass
            dq = (by_damping - q * dmass) / mass
            ddistance = (
                by_distance[0] * dq
                + by_distance[1] * d[1, k]
                + by_distance[2] * da
                + by_distance[3] * dj
            )
            drate = by_speed[0] * dq + by_speed[1] * d[1, k] + by_speed[2] * da + by_speed[3] * dj
            if stops:  # at velocity zero, the displacement does not depend on the time of the stop
                if by_speed[4] != 0.0:
                    dnow[k] -= drate / by_speed[4]
                d[0, k] += ddistance
                d[1, k] = 0.0
            else:
                d[0, k] += ddistance - by_distance[4] * dnow[k]
                d[1, k] = drate - by_speed[4] * dnow[k]
        x += distance
        v = 0.0 if stops else speed
        now += t
        if not stops:
            break
    return x, v


@jit
def bell(v, stribeck):
    """Return the Stribeck curve at a velocity, and its slope."""
    z = v / stribeck
    value = math.exp(-min(z * z, 700.0))
    return value, -2.0 * z * value / stribeck


@jit
def spring(x, v, cubic, center, stiffness, damping, lower, upper):
    """Return force of spring and stops, its derivatives by x and v, and how far x is in a stop."""
    distance = x - center
    depth = 0.0
    if x > upper:
        depth = x - upper
    elif x < lower:
        depth = x - lower
    force = cubic * distance * distance * distance + stiffness * depth
    by_x = 3.0 * cubic * distance * distance
    if depth != 0.0:
        return force + damping * v, by_x + stiffness, damping, depth
    return force, by_x, 0.0, depth


@jit
def resistance(law, curve, factor):
    """Return the friction arguments of :func:`move` for a value of the Stribeck curve."""
    mass, damping, b, coulomb, a, more = law[:6]
    coulomb, more = factor * coulomb, factor * more
    ahead, back, stribeck = coulomb * (1.0 + a), coulomb * (1.0 - a), more * curve
    damp_ahead, damp_back = damping * (1.0 + b), damping * (1.0 - b)
    return ahead + stribeck, back + stribeck, ahead + more, back + more, damp_ahead, damp_back, mass


@jit
def sample(law, h, n_substeps, held, before, u, loaded, load, time, x, v):
    """Return x and v after an interval in which the drive goes from ``before`` to ``u``.

    The factor of the friction goes from ``loaded`` to ``load``.

    ``law`` is (m, d_0, b, F_c, a, F_d, v_s, k_3, x_0, k_s, d_s, lower, upper, u_0, r, c, x_f,
    whether forces are held over a substep); ``time`` is that since the first sample, ``held``
    whether the drive is constant in between.
    """
    _, _, _, _, _, _, stribeck, cubic, center, stiffness, damping, lower, upper = law[:13]
    offset, drift, gradient, place, bent = law[13:]
    change = 0.0 if held > 0.0 else u - before
    for i in range(n_substeps):
        start = before + change * (i / n_substeps) + offset + drift * (time + i * h)
        end = before + change * ((i + 1) / n_substeps) + offset + drift * (time + (i + 1) * h)
        factor = loaded + (load - loaded) * ((i + 0.5) / n_substeps)
        x1, v1, force, curve, local = x, v, 0.0, 0.0, 0.0
        for k in range(2 if bent > 0.0 else 1):
            held_force, _, _, _ = spring(x1, v1, cubic, center, stiffness, damping, lower, upper)
            level, _ = bell(v1, stribeck)
            share, _ = gradient_factor(x1, gradient, place)
            force = held_force if k == 0 else 0.5 * (force + held_force)
            curve = level if k == 0 else 0.5 * (curve + level)
            local = share if k == 0 else 0.5 * (local + share)
            friction = resistance(law, curve, factor * local)
            x1, v1 = move(h, start - force, end - force, friction, x, v)
        x, v = x1, v1
    if not abs(x) <= _LARGEST:
        return math.nan, math.nan
    return x, v


@jit
def free_mass_run(law, h, n_substeps, held, u, factor, before, loaded, time, begun, x, v, out):
    """Write x to ``out`` (n,), and return the last x, v and time; at the first sample it starts."""
    for k in range(u.size):
        if begun > 0.0:
            x, v = sample(law, h, n_substeps, held, before, u[k], loaded, factor[k], time, x, v)
            time += h * n_substeps
        begun = 1.0
        before, loaded = u[k], factor[k]
        out[k] = x
    return x, v, time


@jit
def free_mass_step(u, c, s):
    """Return the displacement at one sample.

    ``c`` is (h, number of substeps, whether the drive is held, *law of :func:`sample`), ``s`` is
    (x, v, last drive, time, whether it has started).
    """
    if s[4] > 0.0:
        x, v = sample(c[3:], c[0], int(c[1]), c[2], s[2], u, 1.0, 1.0, s[3], s[0], s[1])
        s[0], s[1] = x, v
        s[3] += c[0] * int(c[1])
    s[2], s[4] = u, 1.0
    return s[0]


@jit
def loaded_mass_step(u, c, s):
    """Do :func:`free_mass_step` for a drive and a factor of the friction, the last state."""
    if s[4] > 0.0:
        x, v = sample(c[3:], c[0], int(c[1]), c[2], s[2], u[0], s[5], u[1], s[3], s[0], s[1])
        s[0], s[1] = x, v
        s[3] += c[0] * int(c[1])
    s[2], s[4], s[5] = u[0], 1.0, u[1]
    return s[0]


# columns of the derivatives by the operator's own parameters, in the order of the law
_M, _D, _B, _FC, _A, _FD, _VS, _K3, _X0, _KS, _DS, _LOWER, _UPPER, _U0, _R, _C, _OWN = range(17)


@jit
def friction_tangents(law, curve, dcurve, factor, dfactor, by):
    """Write the derivatives of the values of :func:`resistance` to ``by``.

    ``dcurve`` (n,) are those of the value of the Stribeck curve, ``dfactor`` (n,) those of the
    factor; the last columns are by the operator's own parameters.
    """
    damping, b, coulomb, a, more = law[1], law[2], law[3], law[4], law[5]
    n = by.shape[1]
    first = n - _OWN
    ahead, back = coulomb * (1.0 + a), coulomb * (1.0 - a)
    for k in range(n):
        change = factor * more * dcurve[k]
        by[_AHEAD, k] = (ahead + more * curve) * dfactor[k] + change
        by[_BACK, k] = (back + more * curve) * dfactor[k] + change
        by[_STUCK_AHEAD, k] = (ahead + more) * dfactor[k]
        by[_STUCK_BACK, k] = (back + more) * dfactor[k]
        for row in range(_DAMP_AHEAD, _MASS + 1):
            by[row, k] = 0.0
    for row, sign in ((_AHEAD, 1.0), (_BACK, -1.0), (_STUCK_AHEAD, 1.0), (_STUCK_BACK, -1.0)):
        by[row, first + _FC] += factor * (1.0 + sign * a)
        by[row, first + _A] += factor * sign * coulomb
        by[row, first + _FD] += factor * (curve if row in (_AHEAD, _BACK) else 1.0)
    by[_DAMP_AHEAD, first + _D], by[_DAMP_BACK, first + _D] = 1.0 + b, 1.0 - b
    by[_DAMP_AHEAD, first + _B], by[_DAMP_BACK, first + _B] = damping, -damping
    by[_MASS, first + _M] = 1.0


@jit
def force_tangents(law, x, v, d, share, dforce, dcurve, dlocal):
    """Add ``share`` times the derivatives of the quantities that are held over a substep.

    These are the force of spring and stops, the Stribeck curve, and the factor of friction that
    depends on the displacement, at x and v, whose derivatives are ``d`` (2, n). Returns their
    values.
    """
    _, _, _, _, _, _, stribeck, cubic, center, stiffness, damping, lower, upper = law[:13]
    force, by_x, by_v, depth = spring(x, v, cubic, center, stiffness, damping, lower, upper)
    curve, slope = bell(v, stribeck)
    local, rise = gradient_factor(x, law[_C], law[_C + 1])
    n = dforce.size
    first = n - _OWN
    for k in range(n):
        dforce[k] += share * (by_x * d[0, k] + by_v * d[1, k])
        dcurve[k] += share * slope * d[1, k]
        dlocal[k] += share * rise * d[0, k]
    distance = x - center
    dforce[first + _K3] += share * distance * distance * distance
    dforce[first + _X0] -= share * 3.0 * cubic * distance * distance
    dforce[first + _KS] += share * depth
    if depth != 0.0:
        dforce[first + _DS] += share * v
        dforce[first + (_UPPER if depth > 0.0 else _LOWER)] -= share * stiffness
    dcurve[first + _VS] -= share * slope * v / stribeck
    dlocal[first + _C] += share * (x - law[_C + 1]) * (local > 0.0)
    return force, curve, local


@jit
def free_mass_tangents(
    law, h, n_substeps, held, u, du, factor, dfactor, before, time, begun, x, v, d, out, dout
):
    """Write x and its derivatives to ``out`` (n,) and ``dout`` (n, m + 16).

    ``du`` and ``dfactor`` (n, m) are those of the drive and of the factor of the friction; those by
    the law come behind them. ``d`` (2, m + 16) are those of x and v at the start.
    """
    m, n = du.shape[1], d.shape[1]
    offset, drift, _, _, bent = law[13:]
    by, old = np.zeros((9, n)), np.empty((2, n))
    dforce, dcurve, dlocal, dmean, dtotal = np.zeros((5, n))
    dnow = np.empty(n)
    dstart, dend = np.zeros(n), np.zeros(n)
    dstart[m + _U0] = dend[m + _U0] = 1.0
    for k in range(u.size):
        if begun > 0.0:
            drive_change = 0.0 if held > 0.0 else u[k] - before
            for i in range(n_substeps):
                # forces at both ends of the substep and their tangents, as in `sample`
                first, last = i / n_substeps, (i + 1) / n_substeps
                ramp = time + i * h, time + (i + 1) * h
                start = before + drive_change * first + offset + drift * ramp[0]
                end = before + drive_change * last + offset + drift * ramp[1]
                for q in range(m):
                    change = 0.0 if held > 0.0 else du[k, q] - du[k - 1, q]
                    dstart[q] = du[k - 1, q] + change * first
                    dend[q] = du[k - 1, q] + change * last
                    rise = dfactor[k, q] - dfactor[k - 1, q]
                    dmean[q] = dfactor[k - 1, q] + rise * (0.5 * (first + last))
                dstart[m + _R], dend[m + _R] = ramp
                mean = factor[k - 1] + (factor[k] - factor[k - 1]) * (0.5 * (first + last))
                x1, v1, force, curve, local = x, v, 0.0, 0.0, 1.0
                # both passes start from the same state, the second with the means of both ends
                for q in range(n):
                    old[0, q], old[1, q] = d[0, q], d[1, q]
                    dtotal[q] = dmean[q]
                for p in range(2 if bent > 0.0 else 1):
                    if bent > 0.0:
                        share = 1.0 if p == 0 else 0.5
                        for q in range(n):
                            dforce[q] *= 0.5 * p
                            dcurve[q] *= 0.5 * p
                            dlocal[q] *= 0.5 * p
                        held_now = force_tangents(law, x1, v1, d, share, dforce, dcurve, dlocal)
                        force = share * held_now[0] + 0.5 * p * force
                        curve = share * held_now[1] + 0.5 * p * curve
                        local = share * held_now[2] + 0.5 * p * local
                        for q in range(n):
                            dtotal[q] = mean * dlocal[q] + local * dmean[q]
                    friction_tangents(law, curve, dcurve, mean * local, dtotal, by)
                    for q in range(n):
                        by[_START, q], by[_END, q] = dstart[q] - dforce[q], dend[q] - dforce[q]
                        d[0, q], d[1, q] = old[0, q], old[1, q]
                    now = resistance(law, curve, mean * local)
                    x1, v1 = move_tangents(h, start - force, end - force, now, x, v, by, d, dnow)
                x, v = x1, v1
            if not abs(x) <= _LARGEST:
                x = v = math.nan
                d[:] = math.nan
            time += h * n_substeps
        begun = 1.0
        before = u[k]
        out[k] = x
        for q in range(n):
            dout[k, q] = d[0, q]


@dataclass(frozen=True)
class FreeMassOperator(HeldInput, ScaledWithin, StartValues):
    r"""Mass without a spring: the law of :class:`FreeMass`.

    Parameters
    ----------
    mass : float
        ``m`` in drive s^2/response, above 0.
    damping : float, default=0.0
        ``d_0`` in drive s/response: viscous friction, the mean of both directions.
    damping_asymmetry : float, default=0.0
        ``b``: viscous friction is ``d_0 (1 + b)`` forward, ``d_0 (1 - b)`` backward.
    friction : float, default=0.0
        ``F_c``, units of the drive: Coulomb friction, the mean of both directions.
    friction_asymmetry : float, default=0.0
        ``a``: Coulomb friction is ``F_c (1 + a)`` forward and ``F_c (1 - a)`` backward.
    stribeck_force : float, default=0.0
        ``F_d``, units of the drive: by how much a force that sets the mass in motion exceeds
        Coulomb friction.
    stribeck_velocity : float, default=inf
        ``v_s`` in response/s, over which this difference is lost. If infinite, friction does not
        depend on the speed, and neither of the two is identified.
    cubic_stiffness : float, default=0.0
        ``k_3`` in drive/response^3.
    center : float, default=nan
        ``x_0``: response at which the cubic force is zero, units of the response. NaN: there is
        none, and neither of the two is identified.
    stop_stiffness : float, default=0.0
        ``k_s`` of the end stops, drive/response.
    stop_damping : float, default=0.0
        ``d_s`` of the end stops, drive s/response.
    lower, upper : float, default=-inf, inf
        Responses at the stops. An infinite one means no stop and is not identified; stiffness and
        damping are not if both are infinite.
    force_offset : float, default=0.0
        ``u_0``: constant force added to the drive, units of the drive.
    force_drift : float, default=0.0
        ``r``: rate at which it grows with the time since the first sample, drive/s.
    friction_gradient : float, default=0.0
        ``c``, one over the units of the response: friction of both kinds is
        ``1 + c (x - x_f)`` times these, but not below zero.
    intercept : float, default=0.0
        Response at the first sample, units of the response.
    hold : {"foh", "zoh", "bandlimited"}, default="foh"
        Drive between samples: a straight line, constant, or without content above half the
        sampling rate. Fixed structure.
    n_substeps : int, default=1
        Integration steps per sampling interval, above 0; one is exact without Stribeck curve, cubic
        stiffness, stops and friction gradient. Fixed structure.
    friction_center : float, default=nan
        ``x_f``: response at which the friction has the values of its parameters. NaN: it is the
        same everywhere, and the gradient is not identified. Fixed structure.

    Raises
    ------
    ValueError
        If ``mass`` is not above 0, ``hold`` is unknown or ``n_substeps`` not an integer above 0.

    Notes
    -----
    The state is the tuple (displacement, velocity, last drive, time since the first sample, whether
    there was one). There is no state of rest at a drive: in ``"rest"`` as in ``"zero"`` the mass
    stands still at ``intercept``. ``init`` also takes displacement and velocity at the first sample
    (see ``n_start`` of :class:`~skhyst.operators.Operator`).

    Examples
    --------
    Friction stops a mass that has been pushed, and holds it against a smaller force:

    >>> import numpy as np
    >>> from skhyst.hysteresis import FreeMassOperator
    >>> drive = np.repeat([3.0, 0.0, 0.0, 0.9], 100)
    >>> y, _ = FreeMassOperator(2.0, friction=1.0, hold="zoh").run(drive, 0.01)
    >>> print(f"{y[100]:.2f} {y[-1]:.2f}")
    0.50 1.50
    """

    mass: float = parameter(log=True, lower=0.0, unit="drive s^2/response")
    damping: float = parameter(default=0.0, lower=0.0, unit="drive s/response")
    damping_asymmetry: float = parameter(default=0.0, lower=-1.0, upper=1.0)
    friction: float = parameter(default=0.0, lower=0.0, unit="drive")
    friction_asymmetry: float = parameter(default=0.0, lower=-1.0, upper=1.0)
    stribeck_force: float = parameter(default=0.0, lower=0.0, unit="drive")
    stribeck_velocity: float = parameter(default=math.inf, log=True, lower=0.0, unit="response/s")
    cubic_stiffness: float = parameter(default=0.0, unit="drive/response^3")
    center: float = parameter(default=math.nan, unit="response")
    stop_stiffness: float = parameter(default=0.0, lower=0.0, unit="drive/response")
    stop_damping: float = parameter(default=0.0, lower=0.0, unit="drive s/response")
    lower: float = parameter(default=-math.inf, unit="response")
    upper: float = parameter(default=math.inf, unit="response")
    force_offset: float = parameter(default=0.0, unit="drive")
    force_drift: float = parameter(default=0.0, unit="drive/s")
    friction_gradient: float = parameter(default=0.0, unit="1/response")
    intercept: float = parameter(default=0.0, linear=True, gauge=0.0, unit="response")
    hold: str = "foh"
    n_substeps: int = 1
    friction_center: float = math.nan

    owns_gain = True
    strictly_proper = True
    at_once = False
    stage_order = 10
    n_start = 2

    def __post_init__(self):
        super().__post_init__()
        self._require("mass", self.mass > 0.0, "be above 0")
        self._require("n_substeps", self.n_substeps > 0, "be above 0")

    def parameter_specs(self):
        specs = super().parameter_specs()
        if self._is_placed:  # its motion depends on where it starts
            specs["intercept"] = dataclasses.replace(specs["intercept"], linear=False, gauge=None)
        absent = {name for name in specs if not np.isfinite(getattr(self, name))}
        absent |= {"stribeck_force"} if "stribeck_velocity" in absent else set()
        absent |= {"cubic_stiffness"} if "center" in absent else set()
        absent |= set() if math.isfinite(self.friction_center) else {"friction_gradient"}
        absent |= {"stop_stiffness", "stop_damping"} if {"lower", "upper"} <= absent else set()
        return {name: spec for name, spec in specs.items() if name not in absent}

    @property
    def _has_stops(self):
        return math.isfinite(self.lower) or math.isfinite(self.upper)

    @property
    def _is_placed(self):
        return self._has_stops or math.isfinite(self.center) or math.isfinite(self.friction_center)

    @property
    def _is_bent(self):
        """Whether a substep is not exact."""
        return self._is_placed or math.isfinite(self.stribeck_velocity)

    @property
    def signal_linear(self):
        """Whether only mass, damper and constant forces act."""
        forces = self.friction, self.stribeck_force, self.damping * self.damping_asymmetry
        return not (any(forces) or self._is_placed)

    def _law_names(self):
        return [name for name in Operator.parameter_specs(self) if name != "intercept"]

    def _law(self):
        values = {name: float(getattr(self, name)) for name in self._law_names()}
        for name in (
            "stribeck_force",
            "cubic_stiffness",
            "center",
            "stop_stiffness",
            "friction_gradient",
        ):
            values[name] = values[name] if name in self._sizes else 0.0
        place = self.friction_center if math.isfinite(self.friction_center) else 0.0
        return *values.values(), float(place), float(self._is_bent)

    def init(self, u0, initial_state="rest"):
        if isinstance(initial_state, str):
            at_rest = initial_state == "rest"
            return float(self.intercept), 0.0, float(u0) * at_rest, 0.0, 0.0
        x, v = map(float, initial_state)
        return x, v, float(u0), 0.0, 0.0

    def run(self, u, dt, state=None):
        state = self.init(u[0] if len(u) else 0.0) if state is None else state
        y, state = self.scaled_run(u, np.ones(len(u)), dt, (*state, 1.0))
        return y, state[:-1]

    def compiled_step(self, dt, state):
        return CompiledLaw(free_mass_step, self._constants(dt), state, double_only=_ADDS_UP)

    def _constants(self, dt):
        held = float(self.hold == "zoh")
        return float(dt) / self.n_substeps, self.n_substeps, held, *self._law()

    def _arguments(self, dt):
        """Return the constants as the loops take them: the law as a tuple, then the substeps."""
        constants = self._constants(dt)
        return constants[3:], *constants[:3]

    def _tangents(self, signals, dt, state, d):
        """Return the displacement and its derivatives (n_samples, m + 16); ``d`` as the loop."""
        u, du, factor, dfactor = map(as_signal, signals)
        x, v, before, time, begun = state
        out, dout = np.empty(u.size), np.empty((u.size, d.shape[1]))
        law = self._arguments(dt)
        run = u, du, factor, dfactor, before, time, begun, x, v
        free_mass_tangents(*law, *run, d, out, dout)
        return out, dout

    def sensitivities(self, u, du, dt, initial_state="rest"):
        return self.scaled_sensitivities(u, du, np.ones(len(u)), 0.0 * du, dt, initial_state)

    def by_start(self, u, dt, start):
        return self.scaled_by_start(u, np.ones(len(u)), dt, start)

    # ------------------------------------------------------------ friction that follows a load

    @property
    def scaled_within(self):
        """The friction, where the drive is not refined between samples."""
        return ("friction",) if self.causal else ()

    def scaled_init(self, u0, factor, initial_state="rest"):
        return *self.init(u0, initial_state), float(factor)

    def scaled_run(self, u, factor, dt, state):
        u, (x, v, before, time, begun, loaded) = as_signal(u), state
        if not u.size:
            return np.empty(0), state
        out, law = np.empty(u.size), self._arguments(dt)
        run = u, as_signal(factor), before, loaded, time, begun, x, v
        x, v, time = free_mass_run(*law, *run, out)
        return out, (x, v, float(u[-1]), time, 1.0, float(factor[-1]))

    def scaled_step(self, dt, state):
        options = {"n_inputs": 2, "double_only": _ADDS_UP}
        return CompiledLaw(loaded_mass_step, self._constants(dt), state, **options)

    def scaled_sensitivities(self, u, du, factor, dfactor, dt, initial_state="rest"):
        m, p = du.shape[1], dfactor.shape[1]
        state = self.init(u[0] if len(u) else 0.0, initial_state)
        # one column more among those of the input: the displacement at the start, which is the
        # intercept
        d, empty = np.zeros((2, p + 1 + _OWN)), np.zeros((len(u), p + 1 - m))
        d[0, p] = float(isinstance(initial_state, str))
        signals = np.column_stack([du, empty]), factor, np.column_stack([dfactor, empty[:, :1]])
        y, dy = self._tangents((u, *signals), dt, state, d)
        columns = [p + 1 + i for i, name in enumerate(self._law_names()) if name in self._sizes]
        return y, np.ascontiguousarray(dy[:, [*range(m), *columns, p, *range(m, p)]])

    def scaled_by_start(self, u, factor, dt, start):
        d, empty = np.zeros((2, 2 + _OWN)), np.zeros((len(u), 2))
        d[0, 0] = d[1, 1] = 1.0
        signals, state = (u, empty, factor, empty), self.init(u[0], start)
        return self._tangents(signals, dt, state, d)[1][:, :2].copy()

    def starts(self, u, y, dt):
        candidates = [np.array([y[0], 0.0])]
        for window in _STARTING:
            if window <= len(y):
                line = np.polynomial.Polynomial.fit(dt * np.arange(window), y[:window], 2)
                candidates.append(np.array([line(0.0), line.deriv()(0.0)]))
        return candidates

    def fastest_rate(self, reach=0.0):
        """Return the fastest rate of the dynamics that are not exact in one substep, rad/s.

        Parameters
        ----------
        reach : float, default=0.0
            Largest distance from ``center``, units of the response.

        Returns
        -------
        float
            0 where one substep is exact.
        """
        m, stiffness = self.mass, 3.0 * abs(self.cubic_stiffness) * reach**2
        # friction that changes along the way is a spring of either sign while the mass slides
        stiffness += (self.friction + self.stribeck_force) * abs(self.friction_gradient)
        rates = [self.stribeck_force / (m * self.stribeck_velocity)]
        if self._has_stops:
            stiffness += self.stop_stiffness
            rates.append(self.stop_damping / m)
        return float(max(math.sqrt(stiffness / m), *rates))


_ADDS_UP = "a mass without a spring, which accumulates the rounding of every sample"
_STARTING = (3, 10, 30, 100)  # samples from which a velocity at the start is estimated


_SLOW = (0.02, 0.1)  # velocities counted as rest, relative to the root mean square velocity
_SPEEDS = (0.05, 0.15, 0.5)  # starting Stribeck velocities over it
_ENDS = (0.6, 0.75, 0.9, 0.97)  # starting stops, fractions of the response's half range
_STIFF = 10.0  # starting stops: force at full depth over the half range of the drive
_LITTLE = 0.05  # a new force of a start, relative to the root mean square of the drive
_PIECES = (16, 4)  # pieces per record in multiple shooting, many short ones first
_FEWEST = 40  # least samples of a piece
_N_STARTS = 12
_MOST_COARSE, _MOST_FINE = 16, 64  # most substeps per sampling interval
# entries of each flag
_OF = {
    "friction": {"friction"},
    "friction_asymmetry": {"friction_asymmetry"},
    "damping_asymmetry": {"damping_asymmetry"},
    "stribeck": {"stribeck_force", "stribeck_velocity"},
    "friction_gradient": {"friction_gradient"},
    "cubic_stiffness": {"cubic_stiffness", "center"},
}


@resampled.register
def _(operator: FreeMassOperator, own, dt):
    return with_substeps_resampled(operator, own, dt) if operator._is_bent else operator


class FreeMass(ParametricModel):
    r"""Mass without a spring, from force to displacement: a motor, a linear axis, a carriage.

    .. math::

        m \ddot x + d(\dot x) \dot x + F(\dot x) + k_3 (x - x_0)^3 + S(x, \dot x) = u + u_0 + r t,
        \qquad y = x

        F = \operatorname{sgn}(\dot x) \left(F_c (1 \pm a) + F_d e^{-(\dot x/v_s)^2}\right)
        \left(1 + c (x - x_f)\right), \qquad d = d_0 (1 \pm b)

    with the upper sign forward, the lower one backward. At rest F balances the other forces, as
    long as they do not exceed ``F_c (1 +- a) + F_d``: the mass sticks. S is the force of end stops,
    ``k_s (x - x_s) + d_s x'`` beyond a stop at ``x_s``. The drive ``u`` is a force, or a voltage
    or current that is proportional to one; forces are in its units.

    Without Stribeck curve, gradient, cubic stiffness and stops the response is exact for a drive
    that is held or a straight line between samples.

    Parameters
    ----------
    friction : bool, default=False
        Whether there is Coulomb friction ``F_c``.
    friction_asymmetry : bool, default=False
        Whether it differs forward and backward. While the mass slides, this cannot be distinguished
        from a force offset; only where it sticks can it.
    damping_asymmetry : bool, default=False
        Whether viscous friction differs forward and backward.
    stribeck : bool, default=False
        Whether friction falls by ``F_d`` as the speed rises.
    friction_gradient : bool, default=False
        Whether friction changes along the way, as that of a guide that is tighter at one end.
    cubic_stiffness : bool, default=False
        Whether there is a cubic spring.
    lower_stop, upper_stop : bool, default=False
        Whether there is an end stop at the lower, the upper end of the response.
    fit_stop_damping : bool, default=False
        Whether the damping of the stops is fitted (0 otherwise).
    fit_force_offset : bool, default=True
        Whether there is a constant force in addition to the drive, such as a weight or an
        amplifier's offset (0 otherwise).
    fit_force_drift : bool, default=False
        Whether that force grows with the time since the first sample of a record, as the offset of
        an amplifier that warms up (0 otherwise).
    fit_intercept : bool, default=True
        Whether the response at the first sample of the records is fitted (0 otherwise). With
        ``initial_state="estimate"`` each record has its own.
    hold : {"foh", "zoh", "bandlimited", "auto"}, default="foh"
        Drive between samples: a straight line, constant, or without content above half the
        sampling rate. "auto": a straight line or constant, with which the fit has the smaller
        error, which is then the ``hold`` of ``operator_``.
    n_substeps : int or None, default=None
        Integration steps per sampling interval. None: one, or with forces that are not exact a
        tenth of a radian of the fastest motion each, at most 64.
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        A mass without a spring has no displacement at rest that belongs to a drive. ``"rest"`` and
        ``"zero"``: every record starts at one displacement, the ``intercept``, with velocity zero.
        ``"estimate"``: displacement and velocity at the first sample are fitted for each record
        (``initial_values_``); ``predict`` then starts at the mean displacement, and
        ``y_start`` of :meth:`predict`.

    Attributes
    ----------
    operator_ : FreeMassOperator
        ``mass`` (drive s^2/response), ``damping`` (drive s/response), ``damping_asymmetry`` b,
        ``friction`` F_c, ``friction_asymmetry`` a, ``stribeck_force`` F_d, ``stribeck_velocity``
        v_s, ``friction_gradient`` c, ``friction_center`` x_f, ``cubic_stiffness`` k_3, ``center``
        x_0, ``stop_stiffness``, ``stop_damping``, ``lower``, ``upper``, ``force_offset`` u_0,
        ``force_drift`` r, ``intercept``.

    See Also
    --------
    FrictionStage : With a spring.
    skhyst.linear.DynamicStiffness : From displacement to force.
    skhyst.linear.TransferFunction : Poles at zero in addition to others.

    Notes
    -----
    The free run of an integrator accumulates every error of the force: an error of a tenth of a per
    cent may dominate the error of the displacement after some time, and the sum of squares has many
    minima. Starting values come from the force balance (see :class:`FrictionStage`). They are
    refined on pieces of the records, each with its own displacement and velocity at the start
    (multiple shooting; Bock, *Progress in Scientific Computing*, 1983), then in a free run.

    Errors of a force that is not modelled add up to a random walk, whose variance grows with the
    time: a fit with equal weights may move the start of a record to make up for its end. Weights
    of one over the time since the first sample (``sample_weight``) keep it where the record begins.

    References
    ----------
    Armstrong-Hélouvry, Dupont and Canudas de Wit, *Automatica*, 1994. Janot, Gautier and Brunot,
    *Workshop on Nonlinear System Identification Benchmarks*, 2019.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import FreeMass, FreeMassOperator
    >>> time = np.arange(1500) * 0.01
    >>> drive = 3.0 * np.sin(1.7 * time) + 2.0 * np.sin(4.9 * time)
    >>> plant = FreeMassOperator(0.5, 0.8, friction=1.0, force_offset=0.1)
    >>> y, _ = plant.run(drive, 0.01)
    >>> model = FreeMass(friction=True, dt=0.01).fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.operator_.mass:.2f} {model.operator_.friction:.2f}")
    0.50 1.00
    """

    operator_class = FreeMassOperator
    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        **{key: ["boolean"] for key in _OF},
        "lower_stop": ["boolean"],
        "upper_stop": ["boolean"],
        "fit_stop_damping": ["boolean"],
        "fit_force_offset": ["boolean"],
        "fit_force_drift": ["boolean"],
        "fit_intercept": ["boolean"],
        "hold": [StrOptions({*HeldInput.holds, "auto"})],
        "n_substeps": [Interval(Integral, 1, None, closed="left"), None],
    }

    def __init__(
        self,
        friction=False,
        *,
        friction_asymmetry=False,
        damping_asymmetry=False,
        stribeck=False,
        friction_gradient=False,
        cubic_stiffness=False,
        lower_stop=False,
        upper_stop=False,
        fit_stop_damping=False,
        fit_force_offset=True,
        fit_force_drift=False,
        fit_intercept=True,
        hold="foh",
        n_substeps=None,
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        super().__init__(initial_state=initial_state, dt=dt, drive=drive, method=method)
        self.friction = friction
        self.friction_asymmetry = friction_asymmetry
        self.damping_asymmetry = damping_asymmetry
        self.stribeck = stribeck
        self.friction_gradient = friction_gradient
        self.cubic_stiffness = cubic_stiffness
        self.lower_stop = lower_stop
        self.upper_stop = upper_stop
        self.fit_stop_damping = fit_stop_damping
        self.fit_force_offset = fit_force_offset
        self.fit_force_drift = fit_force_drift
        self.fit_intercept = fit_intercept
        self.hold = hold
        self.n_substeps = n_substeps

    @property
    def any_interval(self):
        """Whether the response to a straight drive is the same at any sampling interval."""
        bent = self.stribeck, self.friction_gradient, self.cubic_stiffness
        return self.hold == "foh" and not any((*bent, self.lower_stop, self.upper_stop))

    def held_parameters(self) -> frozenset[str]:
        held = super().held_parameters()
        for flag, names in _OF.items():
            held = held if getattr(self, flag) else held | names
        # where each record has its own start
        return held | {"intercept"} if self.initial_state == "estimate" else held

    def starting_values(self, records, near=None):
        """Return at most a dozen operators.

        Parameters
        ----------
        near : FreeMassOperator, default=None
            Operator of the model without some of its forces; some starts are this one with small
            values of those.
        """
        scales = _Scales.of(records)
        starts = [] if near is None else self._richer(near, scales)
        for window in WINDOWS:
            usable = [r for r in records if len(r.u) > 2 * window + 4]
            if sum(len(r.u) - 2 * window for r in usable) < _FEWEST:
                break
            starts += self._balanced(usable, window, scales)
        starts = starts or self._guessed(scales)
        hold = "foh" if self.hold == "auto" else self.hold
        y0 = float(np.mean([r.y[0] for r in records])) if self.fit_intercept else 0.0
        start = {} if self.initial_state == "estimate" else {"intercept": y0}
        starts = [dataclasses.replace(operator, hold=hold, **start) for operator in starts]
        return [self._divided(operator, records, _MOST_COARSE) for operator in starts]

    def _richer(self, near, scales):
        """Return operators with a small value of each force that the model has and ``near`` not."""
        operators, little = [], _LITTLE * scales.force
        speeds = _SPEEDS if self.stribeck and not math.isfinite(near.stribeck_velocity) else [None]
        for speed, stops in product(speeds, self._stops(scales)):
            forces = {}
            if self.friction and not near.friction:
                forces["friction"] = little
            if self.damping_asymmetry and not near.damping_asymmetry:
                forces["damping_asymmetry"] = _LITTLE
            if speed is not None:
                forces |= {"stribeck_force": little, "stribeck_velocity": speed * scales.speed}
            if self.friction_gradient and not math.isfinite(near.friction_center):
                forces["friction_center"] = scales.middle
            if self.cubic_stiffness and not math.isfinite(near.center):
                stiffness = little / scales.length**3
                forces |= {"cubic_stiffness": stiffness, "center": scales.middle}
            operators.append(dataclasses.replace(near, **forces, **stops))
        return operators

    def _stops(self, scales):
        """Return possible stops, parameters of an operator each; one empty set without any."""
        if not (self.lower_stop or self.upper_stop):
            return [{}]
        sets = []
        for part in _ENDS:
            stiffness = _STIFF * scales.swing / ((1.0 - part) * scales.length)
            stop = {"stop_stiffness": stiffness}
            if self.lower_stop:
                stop["lower"] = scales.middle - part * scales.length
            if self.upper_stop:
                stop["upper"] = scales.middle + part * scales.length
            sets.append(stop)
        return sets

    def _balanced(self, records, window, scales):
        """Return operators from the balance of forces, a regression of the drive on its terms."""
        x, v, a, u, time = _motion(records, window)
        operators = []
        speeds = [part * scales.speed for part in _SPEEDS] if self.stribeck else [math.inf]
        slow = _SLOW if self.friction or self.stribeck else (0.0,)
        for part, speed, stops in product(slow, speeds, self._stops(scales)):
            # while the mass sticks, friction is not given by its law: those rows are left out
            moves = np.abs(v) > part * scales.speed if part else np.ones(len(v), dtype=bool)
            if moves.sum() < _FEWEST:
                continue
            sign = np.sign(v)
            position = (x - scales.middle) / scales.length
            columns = {"mass": a, "damping": v}
            if self.damping_asymmetry:
                columns["asymmetric"] = np.abs(v)
            if self.friction:
                columns["friction"] = sign
            if self.friction_asymmetry and not self.fit_force_offset:
                columns["ahead"] = np.ones(len(v))
            if self.stribeck:
                columns["stribeck_force"] = sign * np.exp(-np.minimum((v / speed) ** 2, 700.0))
            if self.friction_gradient:
                columns["along"] = sign * position
            if self.cubic_stiffness:
                columns |= {"cube": position**3, "square": position**2, "line": position}
            if self.fit_force_offset or self.cubic_stiffness:
                columns["constant"] = np.ones(len(v))
            if self.fit_force_drift:
                columns["force_drift"] = -time
            # rows within an assumed stop are left out too: its force is not among the columns
            free = np.ones(len(v), dtype=bool)
            for side, sign_of in (("lower", -1.0), ("upper", 1.0)):
                if side in stops:
                    free &= sign_of * (x - stops[side]) < 0.0
            rows = moves & free
            if rows.sum() < _FEWEST:
                continue
            matrix = np.column_stack(list(columns.values()))[rows]
            factors, _ = least_squares(matrix, u[rows])
            by_name = dict(zip(columns, factors.tolist(), strict=True))
            operator = self._operator(by_name, speed, stops, scales)
            if operator is not None:
                operators.append(operator)
        return operators

    def _operator(self, factors, speed, stops, scales):
        """Return the operator of the factors of a force balance, None without a positive mass."""
        if not factors["mass"] > 0.0:
            return None
        little = _LITTLE * scales.force
        parameters = {"damping": max(factors["damping"], 1e-3 * factors["mass"] / scales.span)}
        if self.damping_asymmetry:
            parameters["damping_asymmetry"] = _within(factors["asymmetric"] / parameters["damping"])
        if self.friction:
            parameters["friction"] = factors["friction"] if factors["friction"] > 0.0 else little
            if "ahead" in factors:
                parameters["friction_asymmetry"] = _within(
                    factors["ahead"] / parameters["friction"]
                )
        if self.stribeck:
            force = factors["stribeck_force"] if factors["stribeck_force"] > 0.0 else little
            parameters |= {"stribeck_force": force, "stribeck_velocity": speed}
        if self.friction_gradient:
            parameters["friction_center"] = scales.middle
            level = parameters.get("friction", 0.0) + parameters.get("stribeck_force", 0.0)
            if level:
                parameters["friction_gradient"] = _within(factors["along"] / level) / scales.length
        offset = -factors.get("constant", 0.0)
        if self.cubic_stiffness:
            cube, square = factors["cube"], factors["square"]
            shift = _within(-square / (3.0 * cube)) if cube else 0.0
            parameters["cubic_stiffness"] = cube / scales.length**3
            parameters["center"] = scales.middle + shift * scales.length
            offset -= cube * shift**3
        if self.fit_force_offset:
            parameters["force_offset"] = offset
        if self.fit_force_drift:
            parameters["force_drift"] = factors["force_drift"]
        return FreeMassOperator(factors["mass"], **parameters, **stops)

    def _guessed(self, scales):
        """Return operators of records that are too short for a force balance."""
        mass = scales.force * scales.span**2 / scales.length
        plain = FreeMassOperator(mass)
        return [
            dataclasses.replace(richer, mass=mass * part, damping=mass * part / scales.span)
            for part in (0.01, 0.1, 1.0)
            for richer in self._richer(plain, scales)
        ]

    def _divided(self, operator, records, most):
        """Return the operator with the number of substeps that it needs, or that the model sets."""
        n = self.n_substeps
        if n is None:
            reach = 0.0
            if math.isfinite(operator.center):
                reach = max(float(np.abs(r.y - operator.center).max()) for r in records)
            longest = max(record.dt for record in records)
            n = np.clip(np.ceil(longest * operator.fastest_rate(reach) / FINE), 1, most)
        return dataclasses.replace(operator, n_substeps=int(n))

    def identify(self, data):
        """Identify on pieces of the records, then in a free run, with the substeps it needs."""
        starts, evaluations = self.starting_values(data)[: 4 * _N_STARTS], 0
        found = []  # the longer pieces may lead away: their starts have many minima, too
        for count in _PIECES:
            pieces = _cut(data, count)
            if len(pieces) <= len(data):
                continue
            starts, runs = best_from_own_starts(starts, pieces)
            evaluations += runs
            starts, runs = self._shot(starts, pieces)
            evaluations += runs
            found += starts
        result = self._free(found or starts, data)
        fine = self._divided(result.operator, data, _MOST_FINE)
        if fine.n_substeps > result.operator.n_substeps:
            evaluations += result.n_evaluations
            result = self._free([fine], data)
        return dataclasses.replace(result, n_evaluations=evaluations + result.n_evaluations)

    def _shot(self, starts, pieces):
        """Return the results of starts fitted to pieces of records, and the evaluations."""
        operators, evaluations = [], 0
        # the force drift is a function of the time since the start of the record, not of the piece:
        # it is held, at its mean, as a force offset
        held = self.held_parameters() | {"intercept", "force_drift"}
        for start in starts:
            drift = start.force_drift if self.fit_force_offset else 0.0
            later = 0.5 * drift * _span(pieces) if drift else 0.0
            still = dataclasses.replace(
                start, force_drift=0.0, force_offset=start.force_offset + later
            )
            result, _ = estimate_start_values(
                still if drift else start,
                (),
                pieces,
                fixed=held,
                method=rough_method(self.method),
                with_errors=False,
            )
            evaluations += result.n_evaluations
            operator = result.operator
            if drift:
                offset = operator.force_offset - later
                operator = dataclasses.replace(operator, force_drift=drift, force_offset=offset)
            operators.append(operator)
        return operators, evaluations

    def _free(self, starts, data):
        """Return the result of a free run."""
        if self.initial_state != "estimate":
            return refine(self, starts, data)
        options = {"fixed": self.held_parameters(), "method": self.method}
        return identify_from_own_starts(starts, data, **options)

    def adopt(self, result):
        if result.input_history is not None:  # from which the run of another record starts
            middle = float(result.input_history[:, 0].mean())
            centred = dataclasses.replace(result.operator, intercept=middle)
            result = dataclasses.replace(result, operator=centred)
        return super().adopt(result)


@dataclass(frozen=True)
class _Scales:
    """Scales of the data.

    Half range and middle of the response, its root mean square velocity, root mean square and half
    range of the drive, and the duration of the longest record.
    """

    length: float
    middle: float
    speed: float
    force: float
    swing: float
    span: float

    @classmethod
    def of(cls, records):
        low, high = min(float(r.y.min()) for r in records), max(float(r.y.max()) for r in records)
        span = max(len(r.u) * r.dt for r in records)
        length = 0.5 * (high - low) or 1.0
        slopes = [np.gradient(r.y, r.dt) for r in records if len(r.y) > 1]
        speed = float(np.sqrt(np.mean(np.concatenate([*slopes, [0.0]]) ** 2)))
        force = float(np.sqrt(np.mean(np.concatenate([r.u for r in records]) ** 2))) or 1.0
        swing = 0.5 * max(float(np.ptp(r.u)) for r in records) or 1.0
        return cls(length, 0.5 * (high + low), speed or length / span, force, swing, span)


def _motion(records, window):
    """Return displacement, velocity, acceleration, drive and time, weighted over a window."""
    parts = [[weigh(r.y, r.dt, window, order) for r in records] for order in range(3)]
    parts.append([weigh(r.u, r.dt, window) for r in records])
    parts.append([r.dt * np.arange(window, len(r.u) - window) for r in records])
    return map(np.concatenate, parts)


def _within(share):
    """Return a relative parameter limited to 0.9 of its bounds, so that a fit can move it."""
    return float(np.clip(share, -0.9, 0.9))


def _span(records):
    return max(len(r.u) * r.dt for r in records) * len(records)


def _cut(records, count):
    """Return pieces of the records, which have start values of their own; see :class:`FreeMass`."""
    pieces = []
    for record in records:
        n = len(record.u)
        edges = np.linspace(0, n, max(min(count, n // _FEWEST), 1) + 1).astype(int)
        for start, stop in pairwise(edges.tolist()):
            part, counts = slice(start, stop), record.counts()[start:stop]
            if counts.any():
                rows = {"u": record.u[part], "y": record.y[part], "weights": counts}
                pieces.append(RecordData(dt=record.dt, **rows))
    return pieces
