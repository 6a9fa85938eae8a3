r"""What stages with hysteresis in their equation of motion share.

With the displacement q in units of the drive, the velocity ``p = q'/w`` and a force F that depends
on both and on a hysteretic force f,

    q''/w^2 + 2 zeta q'/w + q + F = u.

Over a substep h the drive is a straight line and F is replaced by its mean, under which the
oscillator moves exactly:

    D = q1 - q0 = A p0 + B (u0 - q0 - F) + R (u1 - u0),
    p1 = A' p0 + B' (u0 - q0 - F) + R' (u1 - u0).

F is the mean along the straight way from q0 to q1, on which f is known in closed form, so D is the
root of a scalar equation that is solved exactly: this is the averaged vector field method in
exponential form. It is of second order, exact where F = 0, and it inherits the energy balance: the
work ``F D`` that goes into the hysteresis is what f stores and dissipates, at any substep.

A sample is a map of the state (q, p, f) and of the drive before and now. Its Jacobian, together
with the derivatives by the parameters, is accumulated over the substeps and applied once a sample
to the tangents carried through (:func:`carry`).
"""

from .._jit import jit

__all__ = ["FREE", "carry", "oscillator", "oscillator_tangents"]

FREE = 5  # first column of the parameters in a Jacobian, behind the state and both drives


@jit
def oscillator(mode, q, p, u0, u1):
    """Return the displacement D and the velocity p1 without a force F; ``mode`` is A, A', ... ."""
    pull, slope = u0 - q, u1 - u0
    return (
        mode[0] * p + mode[2] * pull + mode[4] * slope,
        mode[1] * p + mode[3] * pull + mode[5] * slope,
    )


@jit
def oscillator_tangents(mode, mode_by, q, p, u0, u1, start, stop, dstate, dreach, dspeed):
    """Write the tangents of what :func:`oscillator` returns to ``dreach``, ``dspeed`` (n_columns,).

    ``mode_by`` (2, 6) are the derivatives of ``mode`` by the first two parameters, ``dstate``
    (3, n_columns) the tangents of the state; the substep goes from the part ``start`` of the
    sample's interval to ``stop``.
    """
    pull, slope = u0 - q, u1 - u0
    for j in range(dreach.size):
        dreach[j] = mode[0] * dstate[1, j] - mode[2] * dstate[0, j]
        dspeed[j] = mode[1] * dstate[1, j] - mode[3] * dstate[0, j]
    length = stop - start
    dreach[3] += mode[2] * (1.0 - start) - mode[4] * length
    dspeed[3] += mode[3] * (1.0 - start) - mode[5] * length
    dreach[4] += mode[2] * start + mode[4] * length
    dspeed[4] += mode[3] * start + mode[5] * length
    for i in range(2):
        dreach[FREE + i] += mode_by[i, 0] * p + mode_by[i, 2] * pull + mode_by[i, 4] * slope
        dspeed[FREE + i] += mode_by[i, 1] * p + mode_by[i, 3] * pull + mode_by[i, 5] * slope


@jit
def carry(step, du0, du1, d):
    """Move the tangents ``d`` (3, m + p) over a sample; the first m are carried through.

    ``step`` (3, 5 + p) is the sample's Jacobian, ``du0`` and ``du1`` (m,) are the tangents of the
    drive before and now.
    """
    m = du0.size
    for j in range(m):
        a, b, c = d[0, j], d[1, j], d[2, j]
        for i in range(3):
            value = step[i, 0] * a + step[i, 1] * b + step[i, 2] * c
            d[i, j] = value + step[i, 3] * du0[j] + step[i, 4] * du1[j]
    for j in range(m, d.shape[1]):
        a, b, c = d[0, j], d[1, j], d[2, j]
        for i in range(3):
            value = step[i, 0] * a + step[i, 1] * b + step[i, 2] * c
            d[i, j] = value + step[i, FREE + j - m]
