r"""Loops over the LuGre model, exact while the velocity is constant.

With ``w = sigma_0 z / F_s``, ``x_s = F_s / sigma_0`` and ``gamma = g / F_s`` the bristles follow
``w' = (v - |v| w / gamma(v)) / x_s``, ``gamma = ratio + (1 - ratio) exp(-(v/v_s)^2)`` with
``ratio = F_c / F_s``. The velocity is constant between two samples, so ``w`` decays exponentially
along the way ``l = |v| dt`` towards ``gamma sgn(v)``, over the length ``x_s gamma``.
"""

import math

from .._jit import jit

__all__ = ["lugre_run", "lugre_step", "lugre_tangents"]

# exponents at which a decay is zero for all purposes; their quotients still are numbers
_FASTEST, _LONGEST = 230.0, 1e150


@jit
def lugre_step(w, change, dt, x_s, v_s, ratio):
    """Step the bristles over the displacement ``change``.

    Returns ``w``, its derivatives by the old w, ``change`` and gamma; gamma, its derivatives by the
    velocity, v_s and ratio; the slip speed ``x_s w'`` at the end of the step, its derivatives by
    the old w, ``change`` and gamma; the way over the length of decay, and the old gap. Derivatives
    by change are taken at constant gamma; at rest they are the mean of both directions.
    """
    if change == 0.0:
        return w, 1.0, 1.0 / x_s, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0 / dt, 0.0, 0.0, 0.0
    velocity = change / dt
    square = min((velocity / v_s) ** 2, _FASTEST)
    bell = math.exp(-square)
    gamma = ratio + (1.0 - ratio) * bell
    steep = 2.0 * (1.0 - ratio) * bell * square
    sign = 1.0 if change > 0.0 else -1.0
    way = min(abs(change) / (x_s * gamma), _LONGEST)
    passed = -math.expm1(-way)
    left = 1.0 - passed
    gap = sign * gamma - w
    # at the end: x_s w' = |v| (sgn(v) gamma - w) / gamma, without the difference of equal numbers
    slip = abs(velocity) * gap * left / gamma
    return (
        w + gap * passed,
        left,
        sign * gap * left / (x_s * gamma),
        sign * passed - gap * left * way / gamma,
        gamma,
        -steep / velocity,
        steep / v_s,
        1.0 - bell,
        slip,
        -abs(velocity) * left / gamma,
        slip * (1.0 - way) / change,
        abs(velocity) * left * (sign + gap * (way - 1.0) / gamma) / gamma,
        way,
        gap,
    )


@jit
def lugre_run(u, before, w, dt, x_s, v_s, ratio, out, slip):
    """Write ``w`` to ``out`` (n,) and ``x_s w'`` to ``slip`` (n,), from ``w`` at ``before``."""
    for k in range(u.size):
        step = lugre_step(w, u[k] - before, dt, x_s, v_s, ratio)
        w = step[0]
        before = u[k]
        out[k] = w
        slip[k] = step[8]


@jit
def lugre_tangents(u, du, before, dbefore, w, dw, dt, x_s, v_s, ratio, out, slip, dout, dslip):
    """Write what :func:`lugre_run` writes, and the tangents ``dout``, ``dslip`` (n, m + 3).

    The columns are those of ``du`` (n, m), then the derivatives by ``x_s``, ``v_s`` and ``ratio``.
    ``dbefore`` (m,) and ``dw`` (m + 3,) are the tangents of the drive and of ``w`` before the
    first sample.
    """
    m = du.shape[1]
    last = dw
    last_du = dbefore
    for k in range(u.size):
        (
            w,
            by_w,
            by_change,
            by_gamma,
            _,
            gamma_by_v,
            gamma_by_v_s,
            gamma_by_ratio,
            out_slip,
            slip_by_w,
            slip_by_change,
            slip_by_gamma,
            way,
            gap,
        ) = lugre_step(w, u[k] - before, dt, x_s, v_s, ratio)
        before = u[k]
        out[k] = w
        slip[k] = out_slip
        by_change += by_gamma * gamma_by_v / dt
        slip_by_change += slip_by_gamma * gamma_by_v / dt
        for q in range(m):
            change = du[k, q] - last_du[q]
            dout[k, q] = by_w * last[q] + by_change * change
            dslip[k, q] = slip_by_w * last[q] + slip_by_change * change
        dout[k, m] = by_w * (last[m] - gap * way / x_s)
        dslip[k, m] = slip_by_w * last[m] + out_slip * way / x_s
        dout[k, m + 1] = by_w * last[m + 1] + by_gamma * gamma_by_v_s
        dslip[k, m + 1] = slip_by_w * last[m + 1] + slip_by_gamma * gamma_by_v_s
        dout[k, m + 2] = by_w * last[m + 2] + by_gamma * gamma_by_ratio
        dslip[k, m + 2] = slip_by_w * last[m + 2] + slip_by_gamma * gamma_by_ratio
        last = dout[k]
        last_du = du[k]
