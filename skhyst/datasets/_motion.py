"""A mass on a spring, with forces that are not linear, for the simulated devices."""

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

from .._jit import jit

__all__ = ["bouc_wen", "oscillate"]


@jit
def bouc_wen(h, du, limit, shape):
    """Advance dh = du (1 - |h| / limit (shape sign(h du) + 1 - shape)) exactly by a step du.

    With the shape 0.5 it unloads along a straight line, with 1 along an exponential.
    """
    if du == 0.0:
        return h
    side = 1.0 if du > 0.0 else -1.0
    q, s = side * h / limit, side * du / limit
    if q < 0.0:
        rate = 2.0 * shape - 1.0
        to_zero = np.log1p(-rate * q) / rate if abs(rate) > 1e-9 else -q
        if s <= to_zero:
            if abs(rate) > 1e-9:
                return side * limit * (q * np.exp(-rate * s) - np.expm1(-rate * s) / rate)
            return side * limit * (q + s)
        q, s = 0.0, s - to_zero
    return side * limit * (q * np.exp(-s) - np.expm1(-s))


@jit
def _advance(signal, x, h, flow, step, pull, forces):
    """Advance from rest; ``flow`` maps (x, v, u, u') over a step, x in units of full scale."""
    cubic, friction, presliding, static, stribeck, hysteretic, width = forces
    out = np.empty(signal.size)
    v = z = 0.0
    out[0] = x
    force = pull * (cubic * x * x * x + hysteretic * h / width)
    for i in range(1, signal.size):
        v -= 0.5 * step * force
        u, rate, before = signal[i - 1], (signal[i] - signal[i - 1]) / step, x
        x, v = (
            flow[0, 0] * x + flow[0, 1] * v + flow[0, 2] * u + flow[0, 3] * rate,
            flow[1, 0] * x + flow[1, 1] * v + flow[1, 2] * u + flow[1, 3] * rate,
        )
        level = 1.0 + (static - 1.0) * np.exp(-((v / stribeck) ** 2))
        # the bristles bend by the way, towards the level of sliding
        z = bouc_wen(z, (x - before) / presliding, level, 1.0)
        h = bouc_wen(h, x - before, width, 0.5)
        force = pull * (cubic * x * x * x + friction * z + hysteretic * h / width)
        v -= 0.5 * step * force
        out[i] = x
    return out


def oscillate(
    signal,
    step,
    frequency,
    damping,
    base=0.0,
    scale=1.0,
    cubic=0.0,
    friction=0.0,
    presliding=1.0,
    static=1.0,
    stribeck=1.0,
    hysteretic=0.0,
    width=1.0,
):
    """Return the displacement x of a mode driven by a signal u, from rest.

    With w = 2 pi frequency, full scale Y and the normalised forces f,

        x'' = w^2 (u - x) + 2 damping w (base u' - x') - w^2 Y f,
        f = cubic (x / Y)^3 + friction z + hysteretic h.

    The linear part is advanced exactly, by the exponential of the matrix, for an input that is a
    straight line within a step; the forces f act as half a kick before and half a kick after each
    step (Strang splitting). So the motion is exact without f and of second order with it.

    Parameters
    ----------
    signal : ndarray of shape (n_samples,)
        Input u, units of the displacement.
    step : float
        Interval, s.
    frequency, damping : float
        Undamped frequency in Hz and damping ratio.
    base : float
        Share of the damper that stands on the input instead of on the ground.
    scale : float
        Full scale Y of the displacement.
    cubic, friction, hysteretic : float
        Strengths: shares of the spring's force at full scale.
    presliding, width : float
        Displacements over which the friction and the hysteretic force build up, shares of Y.
    static : float
        Static over Coulomb friction.
    stribeck : float
        Velocity at which the static part fades, a share of w Y.

    Returns
    -------
    ndarray of shape (n_samples,)
    """
    w = 2.0 * np.pi * frequency
    c = 2.0 * damping * w
    law = np.zeros((4, 4))  # of x, v, u, u'
    law[0, 1] = law[2, 3] = 1.0
    law[1] = [-w * w, -c, w * w, c * base]
    flow = expm(law * step)[:2].copy()
    scaled = np.ascontiguousarray(signal, dtype=float) / scale
    x, h = _rest(scaled[0], cubic, hysteretic, width)
    forces = (cubic, friction, presliding, static, stribeck * w, hysteretic, width)
    return scale * _advance(scaled, x, h, flow, step, w * w, tuple(map(float, forces)))


def _rest(u, cubic, hysteretic, width):
    """Return the position of rest and the hysteretic force's state after a first loading."""

    def excess(x):
        return x + cubic * x**3 + hysteretic * bouc_wen(0.0, x, width, 0.5) / width - u

    if cubic == 0.0 and hysteretic == 0.0:
        return u, 0.0
    x = brentq(excess, -abs(u) - 1e-300, abs(u) + 1e-300, xtol=1e-300, rtol=1e-14)
    return x, bouc_wen(0.0, x, width, 0.5)
