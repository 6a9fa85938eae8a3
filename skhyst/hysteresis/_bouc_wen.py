r"""Bouc-Wen model: hysteresis with a smooth transition to a limit, integrated exactly.

While the input moves in one direction, the law is autonomous in the path length ``phi`` of the
input, so every branch is a translate of the same curve. In units of the limit, with ``w`` positive
while the hysteretic part is loaded and negative while the last branch is unloaded,

    dw/dphi = f(w) = 1 + rho |w|^n,    rho = -1 for w > 0,    rho = ratio for w < 0,

and ``phi(w) = int_0^w dx / f(x)``. The curve from ``w = -1`` to ``w = 1`` is cut at fixed values
of ``w``: ``phi`` there comes from Gauss-Legendre quadrature, and the cells between carry Hermite
polynomials through the values and the derivatives, which ``f`` gives. A sample then costs one
polynomial, for any exponent and length of the step; at a reversal Newton's method finds the
position on the curve. There is no step size, and no exponent is a special case.

The cells shrink like a power of the distance towards ``w = 0``, where the curve has a term
``|phi|^(n+1)``, and towards ``w = 1``, which it approaches exponentially. For exponents from 1 to
20 the curve is right to 1e-11 of the limit for ratios up to 1, and to 1e-8 up to 30, where it rises
steeply; below 1 the kink of its slope at 0 costs digits (1e-9 at 0.5). Its derivatives by the
parameters are right to 1e-8 for ratios up to 5 and to 3e-6 up to 30. Only the values of ``phi`` and
``f`` depend on the parameters, so the remaining error depends smoothly on them. ``bins`` divide the
curve evenly and give, for a position, the first cell that may hold it.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from numbers import Real

import numpy as np

from .._jit import jit
from .._sklearn import Interval, StrOptions
from ..base import ParametricModel, refine
from ..operators import CompiledLaw, Operator, as_signal, by_fields, parameter
from ._common import force_characteristics, show

N_BINS = 1024  # bins of the path along a curve
_LONGEST = 1 / 32  # step of the integration without tables, as a fraction of the limit
_VALUE_BINS = 256  # bins of w from 0 to the limit


def _make_grid(n_near=40, n_far=64, n_undone=32, order=6):
    """Return the grid of w, and for each bin of w the cell in which it begins.

    The grid is a tuple: nodes (ascending values of w between cells), their logarithms (exact close
    to 0 and 1), logarithms of the quadrature points, quadrature weights, index of the node
    ``w = 0``.
    """
    near = 0.5 * (np.arange(n_near + 1) / n_near) ** 4  # distance from 0
    far = 0.5 * (1.0 - np.arange(1, n_far) / n_far) ** 8  # distance from 1
    undone = 0.5 * (1.0 - np.arange(1, n_undone + 1) / n_undone) ** 2
    x, weight = np.polynomial.legendre.leggauss(order)
    x = 0.5 * (1.0 + x)

    def side(rest):
        from_one = np.append(0.5, rest)
        low = near[:-1, None] + np.diff(near)[:, None] * x
        high = from_one[:-1, None] + np.diff(from_one)[:, None] * x
        nodes = np.append(near, 1.0 - rest)
        logs = np.concatenate([[0.0], np.log(near[1:]), np.log1p(-rest)])
        width = np.append(np.diff(near), -np.diff(from_one))
        return nodes, logs, np.append(np.log(low), np.log1p(-high), axis=0), width

    nodes, logs, log_points, width = side(undone)
    onward = side(far)
    zero = len(width)
    nodes = np.append(-nodes[:0:-1], onward[0])
    edges = np.arange(2 * _VALUE_BINS + 1) / _VALUE_BINS - 1.0
    grid = (
        nodes,
        np.append(logs[:0:-1], onward[1]),
        np.append(log_points[::-1], onward[2], axis=0),
        0.5 * np.append(width[::-1], onward[3])[:, None] * weight,
        zero,
    )
    return grid, np.searchsorted(nodes[:-1], edges, side="right") - 1


_GRID, _CELL_AT = _make_grid()


def curves(exponent, pairs):
    """Return the tables of one curve per pair: ratio and limit for ``w < 0``, then for ``w > 0``.

    The curves follow each other in each of the tables (places, curve, changes, bins, scales):

    - places: the positions (units of the input) where the cells begin, the end of the last cell,
      and infinity;
    - curve: per cell the reciprocal of its width and the coefficients of its polynomial in the
      fraction of the width; after the last cell the constant at which the curve ends;
    - changes: per cell the polynomials (6 coefficients each) of the derivatives by exponent and by
      ratio, at constant limits;
    - bins: per bin of the path the last cell that begins at or before it;
    - scales: the factors from a position to a bin, and from an output below and above 0 to ``w``.

    A last table is common to all curves: per bin of ``w``, from -1 to 1, the first cell that may
    hold it.
    """
    n_curves, n_rows = len(pairs), len(pairs) * (len(_GRID[0]) + 1)
    tables = (
        np.empty(n_rows),
        np.empty((n_rows, 9)),
        np.empty((n_rows, 12)),
        np.empty(n_curves * (N_BINS + 1), dtype=np.int16),
        np.empty((n_curves, 3)),
    )
    for number, ((ratio, below), (_, above)) in enumerate(pairs):
        build_curve(_GRID, exponent, ratio, below, above, number, tables)
    return (*tables, _CELL_AT)


@jit
def build_curve(grid, exponent, ratio, below, above, number, tables):
    """Write one curve as number ``number`` of the tables.

    ``below`` and ``above`` are the limits for w below and above 0; ``ratio`` is that below.
    """
    nodes, logs, log_points, measure, zero = grid
    places, curve, changes, bins, scales = tables
    n_cells = measure.shape[0]
    phi = np.zeros(n_cells + 1)
    # derivatives of w by path (1st, 2nd, 3rd), then those by exponent and by ratio, each with its
    # first and second derivative by path
    at = np.zeros((n_cells + 1, 9))
    # from w = 0 outwards on either side: phi by quadrature, and the derivatives at each node
    for side in range(2):
        rho = ratio if side == 0 else -1.0
        sign = -1.0 if side == 0 else 1.0
        total, by_exponent, by_ratio = 0.0, 0.0, 0.0
        at[zero, 0] = 1.0
        for step in range(zero if side == 0 else n_cells - zero):
            cell = zero - 1 - step if side == 0 else zero + step
            for g in range(measure.shape[1]):
                log = log_points[cell, g]
                # of |w|^n - 1: close to w = 1 the difference 1 - |w|^n would cancel
                power = np.expm1(exponent * log)
                f = (1.0 + rho) + rho * power
                power += 1.0
                part = measure[cell, g] / f
                total += part
                part *= power / f
                by_exponent += part * rho * log
                by_ratio += part
            node = cell if side == 0 else cell + 1
            phi[node] = sign * total
            w, log = abs(nodes[node]), logs[node]
            power = np.expm1(exponent * log)
            f = (1.0 + rho) + rho * power
            power += 1.0
            slope = sign * rho * exponent * power / w
            bend = rho * exponent * (exponent - 1.0) * power / (w * w)
            at[node, 0] = f
            at[node, 1] = f * slope
            at[node, 2] = f * (slope * slope + f * bend)
            # a parameter p changes w at a given path by f times -dphi/dp at a given w
            value = sign * f * by_exponent
            first = slope * value + rho * power * log
            at[node, 3] = value
            at[node, 4] = first
            at[node, 5] = (
                bend * f * value
                + slope * first
                + f * sign * rho * (1.0 + exponent * log) * power / w
            )
            if side == 0:
                value = sign * f * by_ratio
                first = slope * value + power
                at[node, 6] = value
                at[node, 7] = first
                at[node, 8] = bend * f * value + slope * first + f * sign * exponent * power / w
    # per cell the Hermite polynomials of the curve and of its derivatives by the parameters
    first = number * (n_cells + 2)
    curve[first : first + n_cells + 2] = 0.0
    changes[first : first + n_cells + 2] = 0.0
    for i in range(n_cells):
        scale = below if i < zero else above
        h = phi[i + 1] - phi[i]
        places[first + i] = scale * phi[i]
        curve[first + i, 0] = 1.0 / (scale * h)
        # next to w = 0 the higher derivatives need not exist
        smooth = i != zero - 1 and i != zero
        c = curve[first + i, 1:]
        c[0] = nodes[i]
        c[1] = h * at[i, 0]
        if smooth:  # Hermite: value and three derivatives at both ends
            c[2] = 0.5 * h * h * at[i, 1]
            c[3] = h * h * h * at[i, 2] / 6.0
            d0 = nodes[i + 1] - (c[0] + c[1] + c[2] + c[3])
            d1 = h * at[i + 1, 0] - (c[1] + 2.0 * c[2] + 3.0 * c[3])
            d2 = h * h * at[i + 1, 1] - (2.0 * c[2] + 6.0 * c[3])
            d3 = h * h * h * at[i + 1, 2] - 6.0 * c[3]
            c[4] = 35.0 * d0 - 15.0 * d1 + 2.5 * d2 - d3 / 6.0
            c[5] = -84.0 * d0 + 39.0 * d1 - 7.0 * d2 + 0.5 * d3
            c[6] = 70.0 * d0 - 34.0 * d1 + 6.5 * d2 - 0.5 * d3
            c[7] = -20.0 * d0 + 10.0 * d1 - 2.0 * d2 + d3 / 6.0
        else:
            d0 = nodes[i + 1] - (c[0] + c[1])
            d1 = h * at[i + 1, 0] - c[1]
            c[2] = 3.0 * d0 - d1
            c[3] = d1 - 2.0 * d0
        c *= scale
        for k in range(2):
            c = changes[first + i, 6 * k : 6 * k + 6]
            a = at[i, 3 + 3 * k : 6 + 3 * k]
            b = at[i + 1, 3 + 3 * k : 6 + 3 * k]
            c[0] = a[0]
            c[1] = h * a[1]
            if smooth:
                c[2] = 0.5 * h * h * a[2]
                d0 = b[0] - (c[0] + c[1] + c[2])
                d1 = h * b[1] - (c[1] + 2.0 * c[2])
                d2 = h * h * b[2] - 2.0 * c[2]
                c[3] = 10.0 * d0 - 4.0 * d1 + 0.5 * d2
                c[4] = -15.0 * d0 + 7.0 * d1 - d2
                c[5] = 6.0 * d0 - 3.0 * d1 + 0.5 * d2
            else:
                d0 = b[0] - (c[0] + c[1])
                d1 = h * b[1] - c[1]
                c[2] = 3.0 * d0 - d1
                c[3] = d1 - 2.0 * d0
            c *= scale
    # after the last cell the curve is constant
    end = first + n_cells
    places[end] = above * phi[n_cells]
    places[end + 1] = np.inf
    curve[end, 1] = above * nodes[n_cells]
    scales[number, 0] = N_BINS / (places[end] - places[first])
    scales[number, 1] = 1.0 / below
    scales[number, 2] = 1.0 / above
    cell = first
    for b in range(N_BINS + 1):
        while cell < end and (places[cell + 1] - places[first]) * scales[number, 0] <= b:
            cell += 1
        bins[number * (N_BINS + 1) + b] = cell


@jit(inline=True, allocates=False)
def polynomial(curve, cell, x):
    """Return the value of the curve in a cell, at the fraction ``x`` of its width."""
    x2 = x * x
    low = (curve[cell, 1] + curve[cell, 2] * x) + (curve[cell, 3] + curve[cell, 4] * x) * x2
    high = (curve[cell, 5] + curve[cell, 6] * x) + (curve[cell, 7] + curve[cell, 8] * x) * x2
    return low + high * (x2 * x2)


@jit(inline=True, allocates=False)
def slope_of(curve, cell, x):
    """Return the derivative of :func:`polynomial` by ``x``."""
    x2 = x * x
    low = 2.0 * curve[cell, 3] * x + (3.0 * curve[cell, 4] + 4.0 * curve[cell, 5] * x) * x2
    high = (5.0 * curve[cell, 6] + 6.0 * curve[cell, 7] * x) + 7.0 * curve[cell, 8] * x2
    return curve[cell, 2] + low + high * (x2 * x2)


@jit(inline=True, allocates=False)
def find(level, first, end, below, above, curve, cell_at):
    """Return the cell (``first`` to ``end``) and the fraction of it where the curve is level.

    ``below`` and ``above`` are the factors from a level to w on either side of 0.
    """
    if not level > curve[first, 1]:  # also if level is NaN
        return first, 0.0
    w = min(level * (below if level < 0.0 else above), 1.0)
    cell = min(first + int(cell_at[int((1.0 + w) * _VALUE_BINS)]), end - 1)
    while cell + 1 < end and curve[cell + 1, 1] <= level:
        cell += 1
    # inverse series to third order as first guess, then Newton's method
    r = 1.0 / curve[cell, 2]
    t = (level - curve[cell, 1]) * r
    bend = curve[cell, 3]
    x = t - t * t * r * (bend - t * (2.0 * bend * bend * r - curve[cell, 4]))
    for _ in range(8):
        step = (level - polynomial(curve, cell, x)) / slope_of(curve, cell, x)
        x += step
        # the error after Newton's step is about its square: below rounding
        if abs(step) < 1e-8:
            break
    return cell, min(max(x, 0.0), 1.0)


@jit(inline=True, allocates=False)
def move(v, z, last, direction, origin, cell, stride, places, curve, bins, scales, cell_at):
    """Move the input from ``last`` to v; z is the hysteretic part before.

    The current branch starts at the input ``origin`` in ``direction``; its last position is in
    ``cell``. Returns the new z, direction, origin, cell and fraction of the cell, then the cell and
    the fraction at which a branch has begun in this step, or the cell -1 if none has. The tables
    hold the curve of a rising input, then that of a falling one if it differs. They are
    concatenated, because a view of a part of a table costs more time than the sample.
    """
    start, begun = -1, 0.0
    turns = direction == 0.0 or (v - last) * direction < 0.0
    if turns:
        direction = 1.0 if v >= last else -1.0
    number = 0 if direction > 0.0 else scales.shape[0] - 1
    first = number * stride
    end = first + stride - 2
    if turns:
        below, above = scales[number, 1], scales[number, 2]
        start, begun = find(direction * z, first, end, below, above, curve, cell_at)
        cell = start
        path = begun / curve[cell, 0] if begun > 0.0 else 0.0
        origin = last - direction * (places[cell] + path)
    place = direction * (v - origin)
    if place >= places[cell + 1]:
        part = (place - places[first]) * scales[number, 0]
        if part < N_BINS:
            cell = int(bins[number * (N_BINS + 1) + int(part)])
            while places[cell + 1] <= place:
                cell += 1
        else:
            cell = end
    x = (place - places[cell]) * curve[cell, 0]
    z = direction * polynomial(curve, cell, x)
    return z, direction, origin, cell, x, start, begun


@jit(allocates=False)
def curve_run(u, weights, tables, z, last, y, trace):
    """Write the response to ``y``; return the hysteretic part and the input after the last sample.

    ``weights`` are gain, alpha and intercept; for the tables see :func:`curves`. Unless it is
    empty, ``trace`` (n_samples, 5) receives direction, cell and fraction of the cell, then the cell
    and the fraction at which a branch began in this step, the cell -1 if none did.
    """
    gain, alpha, intercept = weights
    places, curve, _, bins, scales, cell_at = tables
    direction, origin, cell, stride = 0.0, 0.0, 0, places.size // scales.shape[0]
    for k in range(u.size):
        v = u[k]
        z, direction, origin, cell, x, start, begun = move(
            v, z, last, direction, origin, cell, stride, places, curve, bins, scales, cell_at
        )
        last = v
        y[k] = gain * v + alpha * z + intercept
        if trace.size > 0:
            trace[k, 0], trace[k, 1], trace[k, 2] = direction, cell, x
            trace[k, 3], trace[k, 4] = start, begun
    return z, last


@jit(allocates=False)
def curve_step(u, c, s):
    """Return the response at one sample; ``s`` is (z, last, direction, origin, cell).

    ``s`` and the tables are those of :func:`move`; ``c`` is (gain, alpha, intercept, *tables).
    """
    gain, alpha, y, places, curve, bins, scales, cell_at = c
    stride = places.size // scales.shape[0]
    z, direction, origin, cell, _, _, _ = move(
        u, s[0], s[1], s[2], s[3], int(s[4]), stride, places, curve, bins, scales, cell_at
    )
    s[0], s[1], s[2], s[3], s[4] = z, u, direction, origin, cell
    return y + gain * u + alpha * z


@jit
def runge_kutta(z, h, exponent, share, scale):
    """Return z after the input has moved by ``h``, by a step of the classical Runge-Kutta method.

    Its change per change of the input is ``1 - share (scale |z|)^exponent``: z keeps its sign.
    """
    at, total = z, 0.0
    for stage in range(4):
        rate = 1.0 - share * (abs(at) * scale) ** exponent
        at = z + (h if stage == 2 else 0.5 * h) * rate
        total += rate if stage % 3 == 0 else 2.0 * rate
    return z + h * total / 6.0


@jit
def integrated_step(u, c, s):
    """Return the response at one sample without tables; ``s`` is (z, last).

    The law is integrated along the path of the input, in steps that are a fraction of the limit;
    one of them ends where z changes its sign, since the law has a kink there. ``c`` is (gain,
    alpha, intercept, exponent, factor of the law while z rises above zero, while it falls below,
    and else, one over the limit, longest step, largest number of steps).
    """
    gain, alpha, y, exponent, above, below, unloading, scale, longest, most = c
    z, remaining = s[0], u - s[1]
    d = 1.0 if remaining > 0.0 else -1.0
    loading = above if remaining > 0.0 else below
    for _step in range(int(most)):
        if remaining == 0.0:
            break
        h = d * min(longest, abs(remaining))
        share = unloading if z * d < 0.0 else loading
        moved = runge_kutta(z, h, exponent, share, scale)
        if z * d < 0.0 and moved * d > 0.0:
            # end at the kink: linear interpolation, then Newton's method, as dz/du is 1 at z = 0
            h = h * z / (z - moved)
            for _newton in range(3):
                h -= runge_kutta(z, h, exponent, share, scale)
            moved = 0.0
        z = moved
        remaining -= h
    s[0], s[1] = z, u
    return y + gain * u + alpha * z


def on_branch(s, c):
    """Return whether direction and cell in a state of :func:`curve_step` match."""
    places, scales = c[3], c[6]
    direction, cell, stride = s[2], s[4], len(places) // len(scales)
    first = 0 if direction > 0.0 else (len(scales) - 1) * stride
    cells = range(first, first + stride - 1)
    return direction == 0.0 or (abs(direction) == 1.0 and cell in cells)


@jit
def change(c, k, x):
    """Return the value of the polynomial of degree 5 that begins at ``c[k]``."""
    x2 = x * x
    return (c[k] + c[k + 1] * x) + x2 * ((c[k + 2] + c[k + 3] * x) + x2 * (c[k + 4] + c[k + 5] * x))


@jit
def curve_tangents(u, du, weights, tables, limits, chain, trace, dy):
    """Write the tangents, shape (n_samples, m + 3 + p), of a run from the virgin state.

    ``limits`` (2,) are the limits above and below zero, ``chain`` (2, 3, p) the derivatives there
    of limit, exponent and ratio by p parameters of the operator. The columns of ``dy`` are: m
    tangents of the input, gain, alpha, the p parameters, intercept.

    On a branch ``z = direction Z(direction (u - origin))``: the tangents of z are those of the
    input, the origin and the curve Z. The origin changes only at a reversal.
    """
    gain, alpha = weights
    places, curve, changes, _, _, _ = tables
    m = du.shape[1]
    p = chain.shape[2]
    origins = np.zeros(m + p)
    slope, z, side = 1.0, 0.0, 0  # in the virgin state the slope is 1 in both directions
    by_limit, by_exponent, by_ratio = 0.0, 0.0, 0.0  # derivatives of z at constant origin
    for k in range(u.size):
        direction = trace[k, 0]
        if trace[k, 3] >= 0.0:
            cell, x = int(trace[k, 3]), trace[k, 4]
            start = slope_of(curve, cell, x) * curve[cell, 0]
            # at the limit z no longer depends on the past
            inverse = 1.0 / start if start > 0.0 else 0.0
            ratio_of_slopes = slope * inverse
            for q in range(m):
                before = du[k - 1, q] if k > 0 else 0.0
                origins[q] = before + ratio_of_slopes * (origins[q] - before)
            # at the reversal z is continuous, so the origin absorbs the change of the curve
            path = places[cell] + (x / curve[cell, 0] if x > 0.0 else 0.0)
            by_limit -= (z - direction * path * start) / limits[side]
            by_exponent -= direction * change(changes[cell], 0, x)
            by_ratio -= direction * change(changes[cell], 6, x)
            for q in range(p):
                origins[m + q] = ratio_of_slopes * origins[m + q] - inverse * (
                    by_limit * chain[side, 0, q]
                    + by_exponent * chain[side, 1, q]
                    + by_ratio * chain[side, 2, q]
                )
        cell, x = int(trace[k, 1]), trace[k, 2]
        z = direction * polynomial(curve, cell, x)
        slope = slope_of(curve, cell, x) * curve[cell, 0]
        side = 0 if z > 0.0 else 1
        path = places[cell] + (x / curve[cell, 0] if x > 0.0 else 0.0)
        by_limit = (z - direction * path * slope) / limits[side]
        by_exponent = direction * change(changes[cell], 0, x)
        by_ratio = direction * change(changes[cell], 6, x)
        pull = alpha * slope
        total = gain + pull
        for q in range(m):
            dy[k, q] = total * du[k, q] - pull * origins[q]
        dy[k, m] = u[k]
        dy[k, m + 1] = z
        for q in range(p):
            dy[k, m + 2 + q] = (
                alpha
                * (
                    by_limit * chain[side, 0, q]
                    + by_exponent * chain[side, 1, q]
                    + by_ratio * chain[side, 2, q]
                )
                - pull * origins[m + q]
            )
        dy[k, m + 2 + p] = 1.0


@dataclass(frozen=True)
class BoucWenOperator(Operator):
    r"""Bouc-Wen hysteresis in normalised form, :math:`g = \alpha z` in :class:`BoucWen`.

    .. math::

        y = k u + \alpha z + c, \qquad
        z' = u' \left\{1 - |z|^n \left[\gamma_z + \beta_z \operatorname{sgn}(u' z)
        + \varphi_z (\operatorname{sgn} u' + \operatorname{sgn} z)\right]\right\}

    with :math:`\beta_z + \gamma_z = D^{-n}`, :math:`\beta_z - \gamma_z = r D^{-n}` and
    :math:`2 \varphi_z = a D^{-n}`, the term of Wang and Wen.

    Parameters
    ----------
    gain : float
        ``k`` in response/drive.
    alpha : float
        Slope of the hysteretic part at ``z = 0``, in response/drive.
    limit : float
        ``D``, positive, in units of the drive: the hysteretic part ``z`` stays within ``+-D`` (for
        ``asymmetry = 0``), so the loop is at most ``2 |alpha| D`` high.
    ratio : float, default=1.0
        ``r``: right after the reversal of a large loop the slope is ``(1 + r) alpha``. At least 0,
        so that the model dissipates: ``beta_z >= |gamma_z|``.
    exponent : float, default=1.0
        ``n``, positive: sharpness of the transition to the limit.
    asymmetry : float, default=0.0
        ``a`` in (-1, 1): the limits are ``D (1 + a)^(-1/n)`` above and ``-D (1 - a)^(-1/n)`` below
        zero.
    intercept : float, default=0.0
        Constant ``c`` in units of the response.

    Raises
    ------
    ValueError
        If ``limit`` or ``exponent`` is not positive, ``ratio`` is negative or ``asymmetry`` not
        between -1 and 1.

    Notes
    -----
    The drive is a straight line between samples and the law is integrated exactly, for every
    exponent, so the result does not depend on the length of a step. The operator is
    rate-independent: ``dt`` is not used. The state is ``(z, last drive)``. ``"rest"`` is the state
    after a first loading from zero to the first sample; in ``"zero"`` the drive was zero. Both give
    the same output, since the step to the first sample is that first loading.

    Examples
    --------
    >>> from skhyst.hysteresis import BoucWenOperator
    >>> operator = BoucWenOperator(gain=0.5, alpha=1.0, limit=2.0)
    >>> y, state = operator.run([0.0, 20.0, -20.0], dt=1e-3)
    >>> y.round(3)
    array([  0., 12., -12.])
    >>> BoucWenOperator.from_coefficients(alpha=1.0, beta=0.5, gamma=0.5, exponent=2.0).limit
    1.0
    """

    gain: float = parameter(linear=True, unit="response/drive")
    alpha: float = parameter(linear=True, unit="response/drive")
    limit: float = parameter(log=True, lower=0.0, unit="drive")
    ratio: float = parameter(default=1.0, lower=0.0)
    # below 0.5 data do not resolve the curvature at z = 0; above 20 the knee is a kink
    exponent: float = parameter(default=1.0, log=True, lower=0.5, upper=20.0)
    asymmetry: float = parameter(default=0.0, lower=-0.95, upper=0.95)
    intercept: float = parameter(default=0.0, linear=True, gauge=0.0, unit="response")

    owns_gain = True
    stage_order = 10

    def __post_init__(self):
        super().__post_init__()
        self._require("limit", self.limit > 0.0, "be positive")
        self._require("ratio", self.ratio >= 0.0, "be at least 0")
        self._require("exponent", self.exponent > 0.0, "be positive")
        self._require("asymmetry", -1.0 < self.asymmetry < 1.0, "be between -1 and 1")

    def __reduce__(self):  # without the cached tables
        return by_fields(self)

    def elastic_and_memory(self):
        """Return the gain of the elastic part, and the operator of the hysteretic part alone."""
        return self.gain, replace(self, gain=0.0)

    @classmethod
    def from_coefficients(cls, alpha, beta, gamma, exponent=1.0, *, gain=0.0, intercept=0.0):
        """Return the operator of the law as printed.

        ``y = k u + g + c`` with ``g' = alpha u' - beta |u'| |g|^(n-1) g - gamma u' |g|^n``.

        Parameters
        ----------
        alpha : float
            Not zero.
        beta, gamma : float
            With ``beta > 0`` and ``beta >= |gamma|``, where at most one of the two signs of
            ``gamma`` is an equality.
        exponent : float, default=1.0
            ``n``.
        gain, intercept : float, default=0.0
            ``k`` and ``c`` of ``y = k u + g + c``.

        Returns
        -------
        BoucWenOperator

        Raises
        ------
        ValueError
            If the law is not bounded or does not dissipate.
        """
        # with g = alpha z, and sgn(u' g) the opposite of sgn(u' z) where alpha is negative
        gamma_on = gamma * np.sign(alpha)
        if not beta + gamma_on > 0.0 or not beta - gamma_on >= 0.0:
            raise ValueError(
                "BoucWenOperator.from_coefficients needs 'beta' > 0 and 'beta' >= |'gamma'|, and "
                "more than -'gamma' (than 'gamma' where 'alpha' is negative): the law must be "
                f"bounded and dissipate. Got beta={beta!r}, gamma={gamma!r} instead."
            )
        # limit of g, which is the limit of z times |alpha|
        bound = (abs(alpha) / (beta + gamma_on)) ** (1.0 / exponent)
        return cls(
            gain=gain,
            alpha=alpha,
            limit=float(bound / abs(alpha)),
            ratio=float((beta - gamma_on) / (beta + gamma_on)),
            exponent=exponent,
            intercept=intercept,
        )

    def coefficients(self):
        """Return ``alpha, beta, gamma`` of the law as printed, see :meth:`from_coefficients`.

        Without the asymmetry; ``beta = (1 + r)/2 |alpha|^(1-n) D^-n`` and ``gamma = sgn(alpha)
        (1 - r)/2 |alpha|^(1-n) D^-n`` are infinite beyond the range of floating point, as for
        ``alpha = 0``.
        """
        n, size = self.exponent, abs(self.alpha)
        with np.errstate(over="ignore"):
            log = (1.0 - n) * np.log(size) - n * np.log(self.limit) if size > 0.0 else np.inf
            scale = np.exp(log)
        turned = np.sign(self.alpha) * 0.5 * (1.0 - self.ratio)
        gamma = turned * scale if turned != 0.0 else 0.0
        return float(self.alpha), float(0.5 * (1.0 + self.ratio) * scale), float(gamma)

    @property
    def presliding_displacement(self):
        """Displacement over which the force builds up, units of the drive."""
        return float(self.limit)

    def characteristics(self, seen):
        return force_characteristics(abs(self.alpha) * self.limit, abs(self.alpha))

    @cached_property
    def _sides(self):
        """Sign, limit, ratio and factor ``1 + sign a`` above zero, then below."""
        n, r, a = float(self.exponent), float(self.ratio), float(self.asymmetry)
        factors = (1.0, 1.0 + a), (-1.0, 1.0 - a)
        return [(s, self.limit * f ** (-1.0 / n), r / f, f) for s, f in factors]

    @cached_property
    def _curves(self):
        """The tables of the curve of a rising drive, and of a falling one if it differs."""
        above, below = ((ratio, limit) for _, limit, ratio, _ in self._sides)
        pairs = [(below, above), (above, below)][: 1 + (self.asymmetry != 0.0)]
        return curves(float(self.exponent), pairs)

    def init(self, u0, initial_state="rest"):
        virgin = 0.0, 0.0
        return self.run([u0], 1.0, virgin)[1] if initial_state == "rest" else virgin

    def run(self, u, dt, state=None):
        return self._follow(as_signal(u), state or (0.0, 0.0), np.empty((0, 5)))

    def compiled_step(self, dt, state):
        places, curve, _, *rest = self._curves
        constants = self.gain, self.alpha, self.intercept, places, curve, *rest
        compact = CompiledLaw(integrated_step, self._without_tables(), state)
        state = [*state, 0.0, 0.0, 0.0]
        return CompiledLaw(curve_step, constants, state, possible=on_branch, compact=compact)

    def _without_tables(self):
        """Return the constants of :func:`integrated_step`."""
        longest = min(_LONGEST, 1.0 / (4.0 * self.exponent))
        # at the limit the distance to it falls by exp(-n) per limit, to rounding in 37 / n
        most = math.ceil((4.0 + 37.0 / min(self.exponent, 1.0)) / longest)
        return (
            *(self.gain, self.alpha, self.intercept, self.exponent),
            *(1.0 + self.asymmetry, 1.0 - self.asymmetry, -self.ratio),
            *(1.0 / self.limit, longest * self.limit, float(most)),
        )

    def _follow(self, u, state, trace):
        y = np.empty(u.size)
        weights = float(self.gain), float(self.alpha), float(self.intercept)
        state = curve_run(u, weights, self._curves, float(state[0]), float(state[1]), y, trace)
        return y, state

    def sensitivities(self, u, du, dt, initial_state="rest"):
        u, du = as_signal(u), as_signal(du)
        trace = np.empty((u.size, 5))
        y, _ = self._follow(u, (0.0, 0.0), trace)
        dy = np.empty((u.size, du.shape[1] + self.n_parameters))
        n, r = float(self.exponent), float(self.ratio)
        # derivatives of limit, exponent and ratio of a side by limit, ratio, exponent and asymmetry
        chain = [
            (
                (limit / self.limit, 0.0, limit * math.log(f) / n**2, -sign * limit / (n * f)),
                (0.0, 0.0, 1.0, 0.0),
                (0.0, 1.0 / f, 0.0, -sign * r / f**2),
            )
            for sign, limit, _, f in self._sides
        ]
        limits = np.array([limit for _, limit, _, _ in self._sides])
        weights = float(self.gain), float(self.alpha)
        curve_tangents(u, du, weights, self._curves, limits, np.array(chain), trace, dy)
        return y, dy


_STARTS = 3
_SCREENED = 400  # samples on which starting values are compared
_LIMITS = np.geomspace(0.04, 2.0, 5)  # fractions of half the drive's range
_RATIOS = (0.3, 2.0)
_EXPONENTS = (1.2, 2.5)


class BoucWen(ParametricModel):
    r"""Bouc-Wen model of rate-independent hysteresis.

    .. math::

        y = k u + g + c, \qquad
        g' = \alpha u' - \beta |u'| |g|^{n-1} g - \gamma u' |g|^n

    (Xie et al. 2023, (1) and (2), with the last exponent as in the original law). The drive is a
    straight line between samples and the law is integrated exactly. For ``alpha > 0`` the
    hysteretic part ``g`` leads the drive, as a friction force does; for ``alpha < 0`` it
    makes the response lag behind the drive, as in a piezo.

    It is identified as ``g = alpha z`` with the limit ``D`` of ``z`` (a drive) and the ratio ``r``,
    because ``k``, ``alpha`` and ``c`` are then linear and solved exactly, and the bounds
    ``D > 0``, ``r >= 0`` are just the condition that the model is bounded and dissipates,
    ``beta > 0`` and ``beta >= |gamma|``:

    .. math::

        \beta = \frac{1 + r}{2} |\alpha|^{1-n} D^{-n}, \qquad
        \gamma = \operatorname{sgn}(\alpha) \frac{1 - r}{2} |\alpha|^{1-n} D^{-n}

    Parameters
    ----------
    exponent : float or "fit", default=1.0
        ``n``, sharpness of the transition to the limit, between 0.5 and 20.
    asymmetry : bool, default=False
        Whether the loop may differ above and below: the generalised law of Wang and Wen,
        ``z' = u' {1 - |z|^n [gamma_z + beta_z sgn(u' z) + phi_z (sgn u' + sgn z)]}``, in which one
        parameter ``asymmetry = 2 phi_z / (beta_z + gamma_z)`` between -0.95 and 0.95 is added.
    fit_gain : bool, default=True
        Whether the elastic part ``k u`` is fitted (0 otherwise). Set it to False in parallel with a
        model that has its own spring.
    fit_intercept : bool, default=True
        Whether the response has a constant.

    Attributes
    ----------
    alpha_, beta_, gamma_ : float
        Coefficients of the law above: response/drive, ``response^(1-n)/drive``,
        ``response^(1-n)/drive``. They follow from ``alpha``, ``limit``, ``ratio`` and ``exponent``.
    exponent_ : float
        ``n``.
    intercept_ : float
        Units of the response.
    params_, params_std_ : dict
        ``gain`` (``k``), ``alpha``, ``limit`` (``D``), ``ratio`` (``r``), ``exponent``,
        ``asymmetry``, ``intercept``, those that are fitted, and their standard errors.

    See Also
    --------
    BoucWenStage : The same force on a mass with a spring and a damper.
    Duhem : Branches whose shapes are polynomials of the drive.
    Dahl : Friction, with a shape of its transition of another kind.

    References
    ----------
    Bouc, *Fourth Conference on Nonlinear Oscillations*, 1967. Wen, *Journal of the Engineering
    Mechanics Division*, 1976. Xie et al., *Smart Materials and Structures*, 2023, section 2.1,
    where (2) is misprinted. Normalised form: Ikhouane and Rodellar, *Systems with Hysteresis*,
    2007. Asymmetry: Wang and Wen, *Journal of Structural Engineering*, 2000; compared with others
    by Song and Der Kiureghian, *Journal of Engineering Mechanics*, 2006.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import BoucWen, BoucWenOperator
    >>> drive = np.sin(np.linspace(0, 20, 500)) * np.linspace(0, 1, 500)
    >>> truth = BoucWenOperator.from_coefficients(alpha=2.0, beta=1.5, gamma=0.5, gain=0.7)
    >>> response, _ = truth.run(drive, dt=1.0)
    >>> model = BoucWen().fit(drive.reshape(-1, 1), response)
    >>> print(f"{model.alpha_:.4f} {model.beta_:.4f} {model.gamma_:.4f}")
    2.0000 1.5000 0.5000
    """

    operator_class = BoucWenOperator
    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "exponent": [Interval(Real, 0.5, 20.0, closed="both"), StrOptions({"fit"})],
        "asymmetry": ["boolean"],
        "fit_gain": ["boolean"],
        "fit_intercept": ["boolean"],
    }

    def __init__(
        self,
        exponent=1.0,
        *,
        asymmetry=False,
        fit_gain=True,
        fit_intercept=True,
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        super().__init__(initial_state=initial_state, dt=dt, drive=drive, method=method)
        self.exponent = exponent
        self.asymmetry = asymmetry
        self.fit_gain = fit_gain
        self.fit_intercept = fit_intercept

    def starting_values(self, records):
        """Return operators at the three best limits of a coarse grid.

        The linear parameters are solved on a subset of the samples. Three, because an additive
        disturbance may change which limit fits best.
        """
        half_range = 0.5 * max(np.ptp(record.u) for record in records)
        if not half_range > 0.0:
            half_range = max(np.abs(record.u).max() for record in records) or 1.0
        exponents = _EXPONENTS if self.exponent == "fit" else (float(self.exponent),)
        step = 1 + sum(stop - start for r in records for start, stop in r.segments) // _SCREENED
        drives, rows, response = [], [], []
        for r in records:
            wanted = np.concatenate([np.arange(*part) for part in r.segments])[::step]
            # the law is rate-independent: of the other samples only turning points are simulated
            rising = np.diff(r.u, prepend=0.0) > 0.0
            kept = np.append(rising[1:] != rising[:-1], True)
            kept[wanted] = True
            drives.append(r.u[kept])
            rows.append(np.cumsum(kept)[wanted] - 1)
            response.append(r.y[wanted])
        drive = np.concatenate([u[part] for u, part in zip(drives, rows, strict=True)])
        response = np.concatenate(response)
        free = [bool(self.fit_gain), bool(self.fit_intercept)]
        known = np.column_stack((drive, np.ones(len(drive))))[:, free]
        basis, _ = np.linalg.qr(known)
        residual = response - basis @ (basis.T @ response)
        best_of_limit = {}
        for ratio, exponent in product(_RATIOS, exponents):
            # one curve serves all limits: z / limit is a function of u / limit
            unit = BoucWenOperator(0.0, 1.0, 1.0, ratio, exponent)
            for limit in half_range * _LIMITS:
                runs = [unit.run(u / limit, 1.0)[0] for u in drives]
                z = np.concatenate([z[part] for z, part in zip(runs, rows, strict=True)])
                orthogonal = z - basis @ (basis.T @ z)
                power = orthogonal @ orthogonal
                explained = (orthogonal @ residual) ** 2 / power if power > 1e-20 * (z @ z) else 0.0
                if limit not in best_of_limit or explained > best_of_limit[limit][0]:
                    best_of_limit[limit] = explained, ratio, exponent, limit * z
        best = sorted(best_of_limit.items(), key=lambda item: -item[1][0])[:_STARTS]
        return [
            (self._start(float(limit), ratio, exponent, z, known, response), ())
            for limit, (_, ratio, exponent, z) in best
        ]

    def identify(self, data):
        # without additive disturbances the best starting value suffices
        return refine(self, self.starting_values(data)[:1], data)

    def _start(self, limit, ratio, exponent, z, known, response):
        linear = np.linalg.lstsq(np.column_stack((z, known)), response, rcond=None)[0]
        alpha, *others = linear.tolist()
        gain = others.pop(0) if self.fit_gain else 0.0
        return BoucWenOperator(gain, alpha, limit, ratio, exponent, intercept=sum(others))

    def held_parameters(self) -> frozenset[str]:
        held = super().held_parameters() | (set() if self.asymmetry else {"asymmetry"})
        return held if self.exponent == "fit" else held | {"exponent"}

    def adopt(self, result):
        super().adopt(result)
        self.alpha_, self.beta_, self.gamma_ = self.operator_.coefficients()
        show(self, self.operator_, "exponent", "intercept")
        return self
