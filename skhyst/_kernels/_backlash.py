"""Loops over one play whose gap is identified, with its tangents."""

from .._jit import jit

__all__ = ["backlash_run", "backlash_tangents"]


@jit
def backlash_run(u, half_gap, play, out):
    """Write the play of ``u`` to ``out`` (n,), from ``play`` before the first sample."""
    for i in range(u.size):
        if play > u[i] + half_gap:
            play = u[i] + half_gap
        elif play < u[i] - half_gap:
            play = u[i] - half_gap
        out[i] = play


@jit
def backlash_tangents(u, du, half_gap, play, tangent, out, dout):
    """Write the play to ``out`` (n,) and its tangents to ``dout`` (n, m + 1).

    ``tangent`` (m + 1,) are those of ``play`` before the first sample, overwritten; the last column
    is the derivative with respect to the half gap.
    """
    m = du.shape[1]
    for i in range(u.size):
        side = 0.0
        if play > u[i] + half_gap:
            side = 1.0
        elif play < u[i] - half_gap:
            side = -1.0
        if side != 0.0:
            play = u[i] + side * half_gap
            for q in range(m):
                tangent[q] = du[i, q]
            tangent[m] = side
        out[i] = play
        for q in range(m + 1):
            dout[i, q] = tangent[q]
