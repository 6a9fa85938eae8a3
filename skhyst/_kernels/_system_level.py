"""A slope that depends on the distance from the drive's last turning point.

With the distance ``s = |u - v|`` from the last turning point ``v`` and ``x = decay s``

    slope(s) = slope + curvature s E(x),    E(x) = (1 - exp(-x)) / x,

and its integral from the turning point is ``slope s + curvature s^2 H(x)`` where
``H(x) = (1 - E(x)) / x = sum_n (-x)^n / (n + 2)!``. Both have a limit for ``decay = 0``: the
Rayleigh law.
"""

import math

import numpy as np

from .._jit import jit

__all__ = ["saturation_terms", "system_level_run", "system_level_tangents"]

_H = tuple((-1.0) ** n / math.factorial(n + 2) for n in range(13))
_H1 = tuple((n + 1) * value for n, value in enumerate(_H[1:]))


@jit
def saturation_terms(x):
    """Return E(x), E'(x), H(x) and H'(x) for ``x >= 0``."""
    if x < 0.5:
        # the first term left out is x^13 / 15!
        h = _H[12]
        dh = 0.0
        for n in range(11, -1, -1):
            h = _H[n] + x * h
            dh = _H1[n] + x * dh
        return 1.0 - x * h, -(h + x * dh), h, dh
    e = -math.expm1(-x) / x
    de = (math.exp(-x) - e) / x
    h = (1.0 - e) / x
    return e, de, h, -(de + h) / x


@jit
def system_level_run(
    u, slope, curvature, decay, intercept, rate, printed, turning, base, last, direction, y
):
    """Write the response to ``y``; return the new ``turning, base, last, direction``.

    ``turning`` is the last turning point, ``base`` the response there less the intercept, ``last``
    the last drive, ``direction`` that in which it moved last (0 if it never has). ``rate`` weighs
    the change of the drive from sample to sample.
    """
    for k in range(u.size):
        value = u[k]
        step = value - last
        if step != 0.0:
            if step * direction < 0.0:
                s = abs(last - turning)
                h = saturation_terms(decay * s)[2]
                base += direction * s * (slope + curvature * s * h)
                turning = last
            direction = 1.0 if step > 0.0 else -1.0
        s = abs(value - turning)
        e, _, h, _ = saturation_terms(decay * s)
        if printed:
            y[k] = intercept + (slope + curvature * s * e) * value + rate * step
        else:
            y[k] = intercept + (base + direction * s * (slope + curvature * s * h))
        last = value
    return turning, base, last, direction


@jit
def system_level_tangents(
    u, du, slope, curvature, decay, rate, dt, printed, last, direction, dlast, dy
):
    """Write the tangents to ``dy``, (n_samples, m + 4), one column more if ``printed``.

    The first loading began at zero. The columns after the ``m`` upstream ones are the derivatives
    by slope, curvature, decay, intercept and, if ``printed``, by the weight of the rate in s;
    ``dlast`` (m,) are the tangents of ``last``.
    """
    m = du.shape[1]
    turning = 0.0
    dturning = np.zeros(m)
    dbase = np.zeros(m + 3)
    before = dlast.copy()
    for k in range(u.size):
        value = u[k]
        step = value - last
        if step != 0.0:
            if step * direction < 0.0:
                # the sample before was the turning point
                turning = last
                for q in range(m):
                    dturning[q] = before[q]
                for q in range(m + 3):
                    dbase[q] = dy[k - 1, q]
            direction = 1.0 if step > 0.0 else -1.0
        s = abs(value - turning)
        e, de, h, dh = saturation_terms(decay * s)
        gain = slope + curvature * s * e
        if printed:
            # s E(decay s) has the derivative exp(-decay s) by s
            bend = value * direction * curvature * (1.0 - decay * s * e)
            for q in range(m):
                dy[k, q] = (
                    gain * du[k, q]
                    + bend * (du[k, q] - dturning[q])
                    + rate * (du[k, q] - before[q])
                )
            dy[k, m] = value
            dy[k, m + 1] = value * s * e
            dy[k, m + 2] = value * curvature * s * s * de
            dy[k, m + 4] = step / dt
        else:
            for q in range(m):
                dy[k, q] = dbase[q] + gain * (du[k, q] - dturning[q])
            dy[k, m] = dbase[m] + direction * s
            dy[k, m + 1] = dbase[m + 1] + direction * s * s * h
            dy[k, m + 2] = dbase[m + 2] + direction * curvature * s * s * s * dh
        dy[k, m + 3] = 1.0
        for q in range(m):
            before[q] = du[k, q]
        last = value
