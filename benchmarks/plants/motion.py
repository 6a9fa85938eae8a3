"""Equations of motion of one degree of freedom.

The drive is a force in units of the spring's, w = 2 pi frequency::

    x'' / w^2 + 2 z x' / w + x + (what the law adds) = u

Each is advanced by classical Runge-Kutta steps, u linear within a step, from rest at the first
drive value after a slow first loading from zero.
"""

import numba
import numpy as np

from .physics import PARTS, WEIGHTS, bouc_wen_move, bouc_wen_slope


@numba.njit(cache=True)
def _rest(u, law, p1, p2, p3, p4):
    """Find the displacement where x + force(x) = u by bisection, and that force."""
    sign, low, high = np.sign(u), 0.0, abs(u)
    force = 0.0
    for _ in range(60):
        x = 0.5 * (low + high)
        if law == 0:  # a bristle on its virgin curve
            force = p1 * (1.0 - np.exp(-p2 * x / p1))
        else:
            force = p1 * bouc_wen_move(0.0, x, p2, p3, p4)
        if x + force > abs(u):
            high = x
        else:
            low = x
    return sign * x, sign * force


@numba.njit(cache=True)
def mode(
    signal,
    step,
    frequency,
    damping,
    cubic=0.0,
    stiffness=0.0,
    limit=1.0,
    ratio=0.5,
    exponent=1.0,
    depth=0.0,
    pump=0.0,
    phase=0.0,
):
    """Add cubic x^3, or stiffness z with the Bouc-Wen law z of x, or let the spring pulsate.

    Its force is then (1 + depth sin(2 pi pump t + phase)) x.
    """
    w, p = 2.0 * np.pi * frequency, 2.0 * np.pi * pump
    a, b = w * w, 2.0 * damping * w
    out = np.empty(signal.size)
    x, v, z = signal[0] / (1.0 + depth * np.sin(phase)), 0.0, 0.0
    if stiffness != 0.0:
        x, force = _rest(signal[0], 1, stiffness, limit, ratio, exponent)
        z = force / stiffness
    elif cubic != 0.0:
        for _ in range(50):
            x -= (x + cubic * x**3 - signal[0]) / (1.0 + 3.0 * cubic * x * x)
    out[0] = x
    for i in range(1, signal.size):
        u0, u2 = signal[i - 1], signal[i]
        drives = (u0, 0.5 * (u0 + u2), 0.5 * (u0 + u2), u2)
        dx = dv = dz = sum_x = sum_v = sum_z = 0.0
        for k in range(4):
            h = PARTS[k] * step
            y, ahead, q = x + h * dx, v + h * dv, z + h * dz
            more = cubic * y**3 + stiffness * q
            if depth != 0.0:
                more += depth * np.sin(p * step * (i - 1 + PARTS[k]) + phase) * y
            dv = a * (drives[k] - x - h * dx - more) - b * ahead
            dx = ahead
            if stiffness != 0.0:
                dz = dx * bouc_wen_slope(q, dx, limit, ratio, exponent)
            sum_x += WEIGHTS[k] * dx
            sum_v += WEIGHTS[k] * dv
            sum_z += WEIGHTS[k] * dz
        x += step / 6.0 * sum_x
        v += step / 6.0 * sum_v
        z += step / 6.0 * sum_z
        out[i] = x
    return out


@numba.njit(cache=True)
def stopped_mode(signal, step, frequency, damping, gap, stiffer):
    """Add a second spring, `stiffer` times as stiff, to both sides of a gap."""
    w = 2.0 * np.pi * frequency
    a, b = w * w, 2.0 * damping * w
    out = np.empty(signal.size)
    x, v = signal[0], 0.0
    if abs(x) > gap:
        x = np.sign(x) * (abs(x) + stiffer * gap) / (1.0 + stiffer)
    out[0] = x
    for i in range(1, signal.size):
        u0, u2 = signal[i - 1], signal[i]
        drives = (u0, 0.5 * (u0 + u2), 0.5 * (u0 + u2), u2)
        dx = dv = sum_x = sum_v = 0.0
        for k in range(4):
            y, ahead = x + PARTS[k] * step * dx, v + PARTS[k] * step * dv
            more = stiffer * np.sign(y) * max(abs(y) - gap, 0.0)
            dv = a * (drives[k] - y - more) - b * ahead
            dx = ahead
            sum_x += WEIGHTS[k] * dx
            sum_v += WEIGHTS[k] * dv
        x += step / 6.0 * sum_x
        v += step / 6.0 * sum_v
        out[i] = x
    return out


@numba.njit(cache=True)
def _stribeck(v, static, coulomb, velocity, curve=0):
    """The fall is a bell, by default, an exponential (1), or one over a square (2)."""
    s = abs(v) / velocity
    if curve == 1:
        part = np.exp(-s)
    elif curve == 2:
        part = 1.0 / (1.0 + s * s)
    else:
        part = np.exp(-(s**2))
    return coulomb + (static - coulomb) * part


@numba.njit(cache=True)
def _lugre_slope(force, v, bristle, static, coulomb, velocity):
    return bristle * (v - abs(v) * force / _stribeck(v, static, coulomb, velocity))


@numba.njit(cache=True)
def lugre_mode(
    signal, step, frequency, damping, static, coulomb, velocity, bristle, bristle_damping
):
    """Add the force of a LuGre bristle, relative to the spring `bristle` times as stiff.

    The bristle's own damping acts on its rate. Steps are refined while sliding makes it stiff.
    """
    w = 2.0 * np.pi * frequency
    a, b, d = w * w, 2.0 * damping * w, bristle_damping / w / bristle
    out = np.empty(signal.size)
    x, h = _rest(signal[0], 0, static, bristle, 0.0, 0.0)
    v = 0.0
    out[0] = x
    for i in range(1, signal.size):
        start, slope = signal[i - 1], signal[i] - signal[i - 1]
        count = 1 + int(step * (bristle * abs(v) / min(static, coulomb) + d * bristle * a) / 0.1)
        s = step / count
        for k in range(count):
            u0, u2 = start + slope * k / count, start + slope * (k + 1) / count
            drives = (u0, 0.5 * (u0 + u2), 0.5 * (u0 + u2), u2)
            dx = dv = dh = sum_x = sum_v = sum_h = 0.0
            for j in range(4):
                y, dx, q = x + PARTS[j] * s * dx, v + PARTS[j] * s * dv, h + PARTS[j] * s * dh
                dh = _lugre_slope(q, dx, bristle, static, coulomb, velocity)
                dv = a * (drives[j] - y - q - d * dh) - b * dx
                sum_x += WEIGHTS[j] * dx
                sum_v += WEIGHTS[j] * dv
                sum_h += WEIGHTS[j] * dh
            x += s / 6.0 * sum_x
            v += s / 6.0 * sum_v
            h += s / 6.0 * sum_h
        out[i] = x
    return out


@numba.njit(cache=True)
def _slide(x, v, u0, u2, s, a, b, sign, *level):
    """Advance by a step in which the friction keeps its sign."""
    u1 = 0.5 * (u0 + u2)
    v1 = v
    f1 = a * (u0 - x - sign * _stribeck(v1, *level)) - b * v1
    v2 = v + 0.5 * s * f1
    f2 = a * (u1 - x - 0.5 * s * v1 - sign * _stribeck(v2, *level)) - b * v2
    v3 = v + 0.5 * s * f2
    f3 = a * (u1 - x - 0.5 * s * v2 - sign * _stribeck(v3, *level)) - b * v3
    v4 = v + s * f3
    f4 = a * (u2 - x - s * v3 - sign * _stribeck(v4, *level)) - b * v4
    new_x = x + s / 6.0 * (v1 + 2.0 * v2 + 2.0 * v3 + v4)
    return new_x, v + s / 6.0 * (f1 + 2.0 * f2 + 2.0 * f3 + f4)


@numba.njit(cache=True)
def coulomb_mode(signal, step, frequency, damping, static, coulomb, velocity, curve=0, inner=8):
    """Add Coulomb friction, with a Stribeck fall where it is static above coulomb.

    It sticks while the force on it is below `static`; the moment where the velocity turns is found
    within a step.
    """
    w = 2.0 * np.pi * frequency
    a, b = w * w, 2.0 * damping * w
    out = np.empty(signal.size)
    u = signal[0]
    x, v, sign = np.sign(u) * max(abs(u) - static, 0.0), 0.0, 0.0
    out[0] = x
    s = step / inner
    for i in range(1, signal.size):
        start, slope = signal[i - 1], signal[i] - signal[i - 1]
        for k in range(inner):
            u0, u2 = start + slope * k / inner, start + slope * (k + 1) / inner
            left = 1.0  # part of the step that is still to be made
            for _ in range(4):
                if sign == 0.0:
                    if abs(u2 - x) <= static:
                        break
                    # it breaks away where the force reaches the limit, at once if it does already
                    ub = u2 - left * (u2 - u0)
                    if abs(ub - x) < static:
                        left *= (abs(u2 - x) - static) / (abs(u2 - x) - abs(ub - x))
                    sign = np.sign(u2 - x)
                ub = u2 - left * (u2 - u0)
                xn, vn = _slide(
                    x, v, ub, u2, left * s, a, b, sign, static, coulomb, velocity, curve
                )
                if vn * sign >= 0.0:
                    x, v, left = xn, vn, 0.0
                    break
                part = v / (v - vn)
                um = ub + part * (u2 - ub)
                x, _ = _slide(
                    x, v, ub, um, part * left * s, a, b, sign, static, coulomb, velocity, curve
                )
                left *= 1.0 - part
                v = 0.0
                sign = 0.0 if abs(um - x) <= static else -sign
        out[i] = x
    return out
