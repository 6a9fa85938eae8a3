"""Further laws of the plants than those of `skhyst.datasets.simulation`, written plainly.

Stages are called with a signal and the time between its samples, and start at rest.
"""

import numba
import numpy as np

# of the classical Runge-Kutta step: where in the step, and what each rate counts
PARTS, WEIGHTS = (0.0, 0.5, 0.5, 1.0), (1.0, 2.0, 2.0, 1.0)


@numba.njit(cache=True)
def first_order(signal, step, tau):
    """Solve tau x' + x = u by Runge-Kutta steps; u is linear within a step, x starts settled."""
    out = np.empty(signal.size)
    x = signal[0]
    out[0] = x
    for i in range(1, signal.size):
        u0, u2 = signal[i - 1], signal[i]
        drives = (u0, 0.5 * (u0 + u2), 0.5 * (u0 + u2), u2)
        dx = total = 0.0
        for k in range(4):
            dx = (drives[k] - x - PARTS[k] * step * dx) / tau
            total += WEIGHTS[k] * dx
        x += step / 6.0 * total
        out[i] = x
    return out


def bend_tanh(signal, step, scale, bend):
    return scale / bend * np.tanh(bend * signal / scale)


def bend_cubic(signal, step, scale, bend):
    return signal * (1.0 + bend * (signal / scale) ** 2)


def bend_exponential(signal, step, scale, bend):
    return scale / bend * np.expm1(bend * signal / scale)


@numba.njit(cache=True)
def bouc_wen_slope(z, direction, limit, ratio, exponent):
    share = ratio * np.sign(direction * z) + 1.0 - ratio
    return 1.0 - share * (np.abs(z) / limit) ** exponent


@numba.njit(cache=True)
def bouc_wen_move(z, way, limit, ratio, exponent):
    """Advance z by Runge-Kutta steps of a hundredth of the limit at most."""
    count = 1 + int(100.0 * abs(way) / limit)
    du = way / count
    for _ in range(count):
        k1 = bouc_wen_slope(z, du, limit, ratio, exponent)
        k2 = bouc_wen_slope(z + 0.5 * du * k1, du, limit, ratio, exponent)
        k3 = bouc_wen_slope(z + 0.5 * du * k2, du, limit, ratio, exponent)
        k4 = bouc_wen_slope(z + du * k3, du, limit, ratio, exponent)
        z += du / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return z


@numba.njit(cache=True)
def bouc_wen(signal, step, gain, share, limit, ratio, exponent):
    """Return gain (u - share z), dz/du = 1 - (ratio sgn(z u') + 1 - ratio) |z / limit|^exponent."""
    out = np.empty(signal.size)
    z = bouc_wen_move(0.0, signal[0], limit, ratio, exponent)
    out[0] = gain * (signal[0] - share * z)
    for i in range(1, signal.size):
        z = bouc_wen_move(z, signal[i] - signal[i - 1], limit, ratio, exponent)
        out[i] = gain * (signal[i] - share * z)
    return out


@numba.njit(cache=True)
def pinned(signal, step, obstacles):
    """Stick where it is until the signal is an obstacle away, then jump there; each is met once."""
    out = np.empty(signal.size)
    at, k = signal[0], 0
    for i, y in enumerate(signal):
        if abs(y - at) > obstacles[k % obstacles.size]:
            at = y
            k += 1
        out[i] = at
    return out


def scaled(signal, step, gain):
    return gain * signal


def modulated(signal, step, gains):
    """Multiply by a gain that is a straight line between samples."""
    return signal * np.interp(step * np.arange(signal.size), np.arange(gains.size), gains)


def delayed_by_itself(signal, step, shortest, growth):
    """Delay each moment by a time that grows with the signal there."""
    t = step * np.arange(signal.size)
    return np.interp(t - shortest - growth * np.abs(signal), t, signal)
