"""Loops over a limit of the rate, exact for an input that is a straight line between samples.

With ``e`` the lead of the input over the output, ``s`` its slope and ``R`` the limit, the output
moves towards the input at ``R`` until they meet, after ``e / (R - s)`` for ``e > 0``; from there it
follows the input, or falls behind again where ``|s| > R``.
"""

from .._jit import jit

__all__ = ["slew_limit_run", "slew_limit_tangents"]


@jit
def slew_limit_run(u, before, y, rate, dt, out):
    """Write the output to ``out`` (n,), from ``y`` at the input ``before``."""
    reach = rate * dt
    for i in range(u.size):
        side = 1.0 if before > y or (before == y and u[i] > before) else -1.0
        lead, step = side * (before - y), side * (u[i] - before)
        if lead + step >= reach:
            y += side * reach
        elif step >= -reach:
            y = u[i]
        else:  # they meet, and the input runs away on the other side
            met = lead / (reach - step)
            y = before + side * (step * met - reach * (1.0 - met))
        before = u[i]
        out[i] = y


@jit
def slew_limit_tangents(u, du, before, dbefore, y, tangent, rate, dt, out, dout):
    """Write the output to ``out`` (n,) and its tangents to ``dout`` (n, m + 1).

    ``dbefore`` (m,) and ``tangent`` (m + 1,) are the tangents of ``before`` and ``y``, the latter
    overwritten; the last column is the derivative with respect to the rate.
    """
    m = du.shape[1]
    reach = rate * dt
    last = dbefore.copy()
    for i in range(u.size):
        side = 1.0 if before > y or (before == y and u[i] > before) else -1.0
        lead, step = side * (before - y), side * (u[i] - before)
        if lead + step >= reach:
            y += side * reach
            tangent[m] += side * dt
        elif step >= -reach:
            y = u[i]
            for q in range(m):
                tangent[q] = du[i, q]
            tangent[m] = 0.0
        else:
            closing = reach - step
            met = lead / closing
            y = before + side * (step * met - reach * (1.0 - met))
            by_met = side * (step + reach)
            for q in range(m):
                dlead, dstep = side * (last[q] - tangent[q]), side * (du[i, q] - last[q])
                dmet = (dlead + met * dstep) / closing
                tangent[q] = last[q] + side * dstep * met + by_met * dmet
            dmet = (-side * tangent[m] - met * dt) / closing
            tangent[m] = by_met * dmet - side * dt * (1.0 - met)
        before = u[i]
        for q in range(m):
            last[q] = du[i, q]
        out[i] = y
        for q in range(m + 1):
            dout[i, q] = tangent[q]
