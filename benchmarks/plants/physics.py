"""Laws of the plants, written in the plainest way: plays by their recursion, the rest integrated.

Stages are called with a signal and the time between its samples, and start at rest.
"""

import numba
import numpy as np


def refine(drive, substeps):
    """Put `substeps` equal intervals between each two samples of a piecewise linear drive."""
    n = drive.size
    fine = np.interp(np.arange((n - 1) * substeps + 1) / substeps, np.arange(n), drive)
    fine[::substeps] = drive
    return fine


@numba.njit(cache=True)
def plays(drive, thresholds, weights):
    """Weighted sum of play operators in their virgin state, sample by sample."""
    out = np.zeros(drive.size)
    for r, w in zip(thresholds, weights):  # noqa: B905
        state = 0.0
        for i, u in enumerate(drive):
            state = max(u - r, min(u + r, state))
            out[i] += w * state
    return out


@numba.njit(cache=True)
def first_order(signal, step, tau):
    """Solve tau x' + x = u by Runge-Kutta steps; u is linear within a step, x starts settled."""
    out = np.empty(signal.size)
    x = signal[0]
    out[0] = x
    for i in range(1, signal.size):
        u0, u2 = signal[i - 1], signal[i]
        u1 = 0.5 * (u0 + u2)
        k1 = (u0 - x) / tau
        k2 = (u1 - x - 0.5 * step * k1) / tau
        k3 = (u1 - x - 0.5 * step * k2) / tau
        k4 = (u2 - x - step * k3) / tau
        x += step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        out[i] = x
    return out


@numba.njit(cache=True)
def second_order(signal, step, frequency, damping):
    """Solve x'' + 2 z w x' + w^2 x = w^2 u, w = 2 pi frequency, in the same way."""
    w = 2.0 * np.pi * frequency
    a, b = w * w, 2.0 * damping * w
    out = np.empty(signal.size)
    x, v = signal[0], 0.0
    out[0] = x
    for i in range(1, signal.size):
        u0, u2 = signal[i - 1], signal[i]
        u1 = 0.5 * (u0 + u2)
        v1, f1 = v, a * (u0 - x) - b * v
        v2 = v + 0.5 * step * f1
        f2 = a * (u1 - x - 0.5 * step * v1) - b * v2
        v3 = v + 0.5 * step * f2
        f3 = a * (u1 - x - 0.5 * step * v2) - b * v3
        v4 = v + step * f3
        f4 = a * (u2 - x - step * v3) - b * v4
        x += step / 6.0 * (v1 + 2.0 * v2 + 2.0 * v3 + v4)
        v += step / 6.0 * (f1 + 2.0 * f2 + 2.0 * f3 + f4)
        out[i] = x
    return out


def kelvin_voigt(signal, step, taus, compliances):
    """Add a chain of Kelvin-Voigt units to the signal that loads them."""
    units = zip(taus, compliances, strict=True)
    return signal + sum(c * first_order(signal, step, tau) for tau, c in units)


def pure_delay(signal, step, delay):
    """Shift in time; before the start the signal stood at its first value."""
    t = step * np.arange(signal.size)
    return np.interp(t - delay, t, signal)


def dead_zones(signal, step, side, thresholds, weights):
    """Add one-sided dead zones, all on the positive (`side` 1) or the negative side (-1)."""
    terms = zip(thresholds, weights, strict=True)
    return signal + side * sum(w * np.maximum(side * signal - r, 0.0) for r, w in terms)


def clip(signal, step, low, high):
    return np.clip(signal, low, high)


def bend_tanh(signal, step, scale, bend):
    return scale / bend * np.tanh(bend * signal / scale)


def bend_cubic(signal, step, scale, bend):
    return signal * (1.0 + bend * (signal / scale) ** 2)


def bend_exponential(signal, step, scale, bend):
    return scale / bend * np.expm1(bend * signal / scale)


@numba.njit(cache=True)
def rate_dependent_plays(signal, step, thresholds, weights, growth):
    """Weighted sum of plays, the thresholds of which (but zero) grow with the rate of the drive."""
    out = np.zeros(signal.size)
    for r, w in zip(thresholds, weights):  # noqa: B905
        state = max(signal[0] - r, min(signal[0] + r, 0.0))
        out[0] += w * state
        for i in range(1, signal.size):
            u = signal[i]
            wide = r + growth * abs(u - signal[i - 1]) / step if r > 0.0 else r
            state = max(u - wide, min(u + wide, state))
            out[i] += w * state
    return out


@numba.njit(cache=True)
def _bouc_wen_slope(z, direction, limit, ratio, exponent):
    share = ratio * np.sign(direction * z) + 1.0 - ratio
    return 1.0 - share * (np.abs(z) / limit) ** exponent


@numba.njit(cache=True)
def _bouc_wen_move(z, way, limit, ratio, exponent):
    """Advance z by Runge-Kutta steps of a hundredth of the limit at most."""
    count = 1 + int(100.0 * abs(way) / limit)
    du = way / count
    for _ in range(count):
        k1 = _bouc_wen_slope(z, du, limit, ratio, exponent)
        k2 = _bouc_wen_slope(z + 0.5 * du * k1, du, limit, ratio, exponent)
        k3 = _bouc_wen_slope(z + 0.5 * du * k2, du, limit, ratio, exponent)
        k4 = _bouc_wen_slope(z + du * k3, du, limit, ratio, exponent)
        z += du / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return z


@numba.njit(cache=True)
def bouc_wen(signal, step, gain, share, limit, ratio, exponent):
    """Return gain (u - share z), dz/du = 1 - (ratio sgn(z u') + 1 - ratio) |z / limit|^exponent."""
    out = np.empty(signal.size)
    z = _bouc_wen_move(0.0, signal[0], limit, ratio, exponent)
    out[0] = gain * (signal[0] - share * z)
    for i in range(1, signal.size):
        z = _bouc_wen_move(z, signal[i] - signal[i - 1], limit, ratio, exponent)
        out[i] = gain * (signal[i] - share * z)
    return out


@numba.njit(cache=True)
def slew_limited(signal, step, rate):
    """Follow the signal, at most so fast."""
    out = np.empty(signal.size)
    out[0] = signal[0]
    for i in range(1, signal.size):
        way = signal[i] - out[i - 1]
        out[i] = out[i - 1] + max(-rate * step, min(rate * step, way))
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


def play_bank(signal, step, thresholds, weights):
    return plays(signal, thresholds, weights)


def one_play(signal, step, half_width):
    return plays(signal, np.array([half_width]), np.ones(1))


def scaled(signal, step, gain):
    return gain * signal


def dead_band(signal, step, center, half_width):
    """Nothing within the band; beyond it what is left."""
    above = np.maximum(signal - center - half_width, 0.0)
    return above + np.minimum(signal - center + half_width, 0.0)


def modulated(signal, step, gains):
    """Multiply by a gain that is a straight line between samples."""
    return signal * np.interp(step * np.arange(signal.size), np.arange(gains.size), gains)


def delayed_by_itself(signal, step, shortest, growth):
    """Delay each moment by a time that grows with the signal there."""
    t = step * np.arange(signal.size)
    return np.interp(t - shortest - growth * np.abs(signal), t, signal)
