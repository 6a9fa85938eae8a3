r"""The Jiles-Atherton equation, integrated over the drive.

With the magnetisation ``m`` in units of its saturation, the drive ``H``, ``x = H / a + 3 b m`` (the
effective field over the shape parameter a; ``b = alpha Ms / (3 a)`` is the coupling), the Langevin
function L and the direction ``d`` of the drive,

    dm/dH = (X + c L'(x) / a) / (1 - 3 b c L'(x)),    X = e / (k - 3 a b e),  e = d (L(x) - m),

where X counts for positive e alone. Since L' <= 1/3, e never exceeds k / (3 a) and the denominator
of X stays above k (1 - b) while b < 1: in X, e is held to half the way from there to the pole, and
m to [-1, 1]. Neither limit acts on a solution, but both keep coarse steps finite.

An interval is divided by the length of the step in H, so the number of steps depends on the drive
and on ``max_step`` alone, and the result is a smooth function of the parameters. The steps are
those of Runge and Kutta, of order four; where e changes its sign, once after a reversal, X has a
kink, and the one step that meets it is of order two.
"""

import math

import numpy as np

from .._jit import jit

__all__ = [
    "jiles_atherton_run",
    "jiles_atherton_tangents",
    "langevin",
]

_MOST_STEPS = 10000.0  # an interval; an absurd drive must come to an end
# 2^(2n) B(2n) / (2n)!, the coefficients of x^(2n-1) in L(x); B are the Bernoulli numbers
_L = (
    1 / 3,
    -1 / 45,
    2 / 945,
    -1 / 4725,
    2 / 93555,
    -1382 / 638512875,
    4 / 18243225,
    -3617 / 162820783125,
    87734 / 38979295480125,
    -349222 / 1531329465290625,
    310732 / 13447856940643125,
    -472728182 / 201919571963756521875,
    2631724 / 11094481976030578125,
)
_L1 = tuple((2 * n + 1) * value for n, value in enumerate(_L))
_L2 = tuple(2 * n * value for n, value in enumerate(_L1))


@jit
def langevin(x):
    """Return ``L(x) = coth(x) - 1 / x`` and its first two derivatives."""
    z = x * x
    if z < 0.25:
        value = _L[12]
        first = _L1[12]
        second = _L2[12]
        for n in range(11, 0, -1):
            value = _L[n] + z * value
            first = _L1[n] + z * first
            second = _L2[n] + z * second
        return x * (_L[0] + z * value), _L1[0] + z * first, x * second
    decay = math.exp(-2.0 * abs(x))
    quotient = 1.0 / (1.0 - decay)
    coth = math.copysign((1.0 + decay) * quotient, x)
    inverse = 1.0 / x
    square = 4.0 * decay * quotient * quotient  # 1 / sinh(x)^2
    return (
        coth - inverse,
        inverse * inverse - square,
        2.0 * (coth * square - inverse * inverse * inverse),
    )


@jit
def susceptibility(field, m, direction, a, k, b, c):
    """Return dm/dH and its derivatives by field, m, a, k, b and c."""
    curve, slope, bend = langevin(field / a + 3.0 * b * m)
    e = direction * (curve - m)
    # X and its derivatives by e, and at constant e by a, k and b
    feedback = 3.0 * a * b
    loss = by_e = by_a = by_k = by_b = 0.0
    if 2.0 * feedback * e > k * (1.0 + b):
        loss = (1.0 + b) / ((1.0 - b) * feedback)
        by_a = -loss / a
        by_b = 2.0 / ((1.0 - b) * (1.0 - b) * feedback) - loss / b
    elif e > 0.0:
        inverse = 1.0 / (k - feedback * e)
        loss = e * inverse
        by_e = k * inverse * inverse
        by_k = -loss * inverse
        by_a = 3.0 * b * loss * loss
        by_b = 3.0 * a * loss * loss
    # the quotient; by x, then at constant x by the others
    reversible = slope / a
    inverse = 1.0 / (1.0 - 3.0 * b * c * slope)
    value = (loss + c * reversible) * inverse
    by_x = (by_e * direction * slope + c * bend / a + value * 3.0 * b * c * bend) * inverse
    return (
        value,
        by_x / a,
        by_x * 3.0 * b - by_e * direction * inverse,
        (by_a - c * reversible / a) * inverse - by_x * field / (a * a),
        by_k * inverse,
        (by_b + value * 3.0 * c * slope) * inverse + by_x * 3.0 * m,
        (reversible + value * 3.0 * b * slope) * inverse,
    )


@jit
def count_steps(change, max_step):
    """Return the number of steps of one interval."""
    return math.ceil(min(max(abs(change) / max_step, 1.0), _MOST_STEPS))


@jit
def jiles_atherton_run(u, a, k, b, c, max_step, m, last, out):
    """Write the magnetisation to ``out``; return its last value and the last drive."""
    for i in range(u.size):
        change = u[i] - last
        if change != 0.0:
            direction = 1.0 if change > 0.0 else -1.0
            n = count_steps(change, max_step)
            h = change / n
            for j in range(n):
                field = last + j * h
                k1 = h * susceptibility(field, m, direction, a, k, b, c)[0]
                middle = field + 0.5 * h
                k2 = h * susceptibility(middle, m + 0.5 * k1, direction, a, k, b, c)[0]
                k3 = h * susceptibility(middle, m + 0.5 * k2, direction, a, k, b, c)[0]
                k4 = h * susceptibility(field + h, m + k3, direction, a, k, b, c)[0]
                m += (k1 + 2.0 * (k2 + k3) + k4) / 6.0
                m = min(max(m, -1.0), 1.0)
        out[i] = m
        last = u[i]
    return m, last


@jit
def stage(h, fraction, part, n, at, dm, t, increment):
    """Write to ``increment`` the tangents of ``h`` times the susceptibility; see the caller.

    ``fraction`` is the place of the stage within the interval; ``dm`` + ``part`` times ``t`` are
    the tangents of the magnetisation there.
    """
    for q in range(7):
        increment[q] = h * at[2] * (dm[q] + part * t[q])
    increment[1] += h * at[1]
    increment[2] += at[0] / n + h * at[1] * fraction
    for q in range(4):
        increment[3 + q] += h * at[3 + q]


@jit
def jiles_atherton_tangents(u, du, a, k, b, c, max_step, out, dout):
    """Write the magnetisation to ``out`` and its tangents to ``dout``, (n_samples, m + 4).

    The first sample is reached from zero along a straight line, the device demagnetised before.
    The last four columns are the derivatives by a, k, b and c.

    The state is one number, so an interval acts on all columns alike: seven tangents are carried
    through its steps, those by the magnetisation and the drive at its beginning, by the change of
    the drive, and by the four parameters, and the columns are combined from them once.
    """
    n_columns = du.shape[1]
    m = last = 0.0
    seeds = np.zeros(7)
    t1 = np.zeros(7)
    t2 = np.zeros(7)
    t3 = np.zeros(7)
    t4 = np.zeros(7)
    before = np.zeros(n_columns)
    now = np.zeros(n_columns + 4)
    for i in range(u.size):
        change = u[i] - last
        if change != 0.0:
            direction = 1.0 if change > 0.0 else -1.0
            n = count_steps(change, max_step)
            h = change / n
            seeds[:] = 0.0
            seeds[0] = 1.0
            for j in range(n):
                field = last + j * h
                at = susceptibility(field, m, direction, a, k, b, c)
                k1 = h * at[0]
                stage(h, j / n, 0.0, n, at, seeds, seeds, t1)
                middle = field + 0.5 * h
                at = susceptibility(middle, m + 0.5 * k1, direction, a, k, b, c)
                k2 = h * at[0]
                stage(h, (j + 0.5) / n, 0.5, n, at, seeds, t1, t2)
                at = susceptibility(middle, m + 0.5 * k2, direction, a, k, b, c)
                k3 = h * at[0]
                stage(h, (j + 0.5) / n, 0.5, n, at, seeds, t2, t3)
                at = susceptibility(field + h, m + k3, direction, a, k, b, c)
                k4 = h * at[0]
                stage(h, (j + 1.0) / n, 1.0, n, at, seeds, t3, t4)
                m += (k1 + 2.0 * (k2 + k3) + k4) / 6.0
                if abs(m) > 1.0:
                    m = min(max(m, -1.0), 1.0)
                    seeds[:] = 0.0
                else:
                    for q in range(7):
                        seeds[q] += (t1[q] + 2.0 * (t2[q] + t3[q]) + t4[q]) / 6.0
            for q in range(n_columns):
                now[q] = (
                    seeds[0] * now[q] + seeds[1] * before[q] + seeds[2] * (du[i, q] - before[q])
                )
                before[q] = du[i, q]
            for q in range(4):
                now[n_columns + q] = seeds[0] * now[n_columns + q] + seeds[3 + q]
        else:
            for q in range(n_columns):
                before[q] = du[i, q]
        out[i] = m
        for q in range(n_columns + 4):
            dout[i, q] = now[q]
        last = u[i]
