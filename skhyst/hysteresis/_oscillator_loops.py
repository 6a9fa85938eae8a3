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

__all__ = [
    "FREE",
    "carry",
    "move_linearly",
    "oscillator",
    "oscillator_tangents",
]

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
    for j in range(dreach.size):
        dreach[j] = mode[0] * dstate[1, j] - mode[2] * dstate[0, j]
        dspeed[j] = mode[1] * dstate[1, j] - mode[3] * dstate[0, j]
    for i in range(4):
        reach, speed = own_terms(i, mode, mode_by, q, p, u0, u1, start, stop)
        dreach[3 + i] += reach
        dspeed[3 + i] += speed


@jit
def own_terms(i, mode, mode_by, q, p, u0, u1, start, stop):
    """Return the derivatives of what :func:`oscillator` returns where the state is held.

    They are those by the drive before the sample and at it, then by the first two parameters.
    """
    if i < 2:
        share = start if i else 1.0 - start
        length = stop - start if i else start - stop
        return mode[2] * share + mode[4] * length, mode[3] * share + mode[5] * length
    by, pull, slope = mode_by[i - 2], u0 - q, u1 - u0
    return (
        by[0] * p + by[2] * pull + by[4] * slope,
        by[1] * p + by[3] * pull + by[5] * slope,
    )


@jit
def move_linearly(mode, mode_by, q, p, u0, u1, start, stop, by_state, by_reach, step):
    """Move the tangents ``step`` (3, n_columns) over a substep that is a linear map.

    The new state is ``by_state`` (3 by 3) times the old one, plus the vector ``by_reach`` times
    the way that the oscillator would go without a force, plus the speed that it would have. What
    follows from the state is in ``by_state`` already.
    """
    (a, b, c), (e, f, g), (h, k, m) = by_state
    x, y, z = by_reach
    for j in range(step.shape[1]):
        dq, dp, df = step[0, j], step[1, j], step[2, j]
        step[0, j] = a * dq + b * dp + c * df
        step[1, j] = e * dq + f * dp + g * df
        step[2, j] = h * dq + k * dp + m * df
    for i in range(4):
        reach, speed = own_terms(i, mode, mode_by, q, p, u0, u1, start, stop)
        step[0, 3 + i] += x * reach
        step[1, 3 + i] += y * reach + speed
        step[2, 3 + i] += z * reach


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
