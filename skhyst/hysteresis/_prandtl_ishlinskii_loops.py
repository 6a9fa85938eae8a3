"""A weighted sum of play operators by its turning points.

The sum ``y = sum_k w_k F_k[v]`` remembers only the nested turning points ``e_1, e_2, ...`` of its
input (wiping-out). From the last of them the output follows one fixed curve (Madelung, Everett),

    y = y(e) + 2 Phi((v - e) / 2),    Phi(x) = sign(x) sum_k w_k max(|x| - r_k, 0),

and from the virgin state ``y = Phi(v)``. Phi is piecewise straight, so a sample costs one table
look-up, whatever the number of plays. The excursion ``D = |v - e|`` is looked up directly: row
``s`` of ``table`` holds ``[2 r_{s-1}, 2 Phi(r_{s-1}), slope, 2 r_s]``, where the slope is
``w_0 + ... + w_{s-1}``; ``bins`` leads from ``D * scale`` to the first row that may apply.

Of three successive excursions that end between the same two thresholds, the middle two turning
points are invisible to every play and can go: that bounds the stack by two entries a threshold.

The stack is ``points[1..top]`` with outputs ``values[1..top]``; ``points[0]`` mirrors the first
turning point, since beyond it the memory is virgin again (``top = 0``).
"""

import numpy as np

from .._jit import jit

__all__ = [
    "build_table",
    "restore_stack",
    "stack_size",
    "turning_point_run",
]


def stack_size(n_plays):
    """Return the length of the work arrays ``points`` and ``values``."""
    return 4 * n_plays + 16


@jit
def build_table(thresholds, weights, table, bins):
    """Fill ``table`` (K + 1, 4) and ``bins`` (B + 2,); return the scale from D to a bin."""
    n_plays = thresholds.size
    n_bins = bins.size - 2
    slope = 0.0
    ordinate = 0.0
    knot = 0.0
    for k in range(n_plays):
        table[k, 0] = knot
        table[k, 1] = ordinate
        table[k, 2] = slope
        table[k, 3] = 2.0 * thresholds[k]
        ordinate += slope * (2.0 * thresholds[k] - knot)
        knot = 2.0 * thresholds[k]
        slope += weights[k]
    table[n_plays, 0] = knot
    table[n_plays, 1] = ordinate
    table[n_plays, 2] = slope
    table[n_plays, 3] = np.inf
    scale = n_bins / knot if knot > 1e-290 else 0.0
    row = 0
    for b in range(bins.size):
        while row < n_plays and int(2.0 * thresholds[row] * scale) < b:
            row += 1
        bins[b] = row
    return scale


@jit
def find_row(distance, table, bins, scale):
    """Return the number of doubled thresholds below ``distance``."""
    last = table.shape[0] - 1
    if not distance <= table[last, 0]:
        return last
    b = int(distance * scale)
    row = bins[b]
    if distance > table[row, 3]:
        end = bins[b + 1]
        row += 1
        while end - row > 4:
            middle = (row + end) // 2
            if distance > table[middle, 3]:
                row = middle + 1
            else:
                end = middle
        while distance > table[row, 3]:
            row += 1
    return row


@jit
def branch(distance, table, bins, scale):
    """Return ``2 Phi(distance / 2)``."""
    row = find_row(distance, table, bins, scale)
    return table[row, 1] + table[row, 2] * (distance - table[row, 0])


@jit
def virgin(value, table, bins, scale):
    """Return ``Phi(value)``."""
    half = 0.5 * branch(2.0 * abs(value), table, bins, scale)
    return half if value > 0.0 else -half


@jit
def restore_stack(turning_points, points, values, table, bins, scale):
    """Load turning points into the stack and recompute their outputs; return ``top``."""
    top = turning_points.size
    if top == 0:
        return 0
    points[0] = -turning_points[0]
    points[1] = turning_points[0]
    values[1] = virgin(points[1], table, bins, scale)
    for i in range(2, top + 1):
        points[i] = turning_points[i - 1]
        step = points[i] - points[i - 1]
        if step * (points[i] - points[i - 2]) > 0.0:  # not nested: a broken state
            return i - 1
        part = branch(abs(step), table, bins, scale)
        values[i] = values[i - 1] + (part if step > 0.0 else -part)
    return top


@jit
def compress_stack(points, values, top, table, bins, scale):
    """Drop the turning points that no play sees; return the new ``top``."""
    end = 1
    for i in range(2, top + 1):
        end += 1
        points[end] = points[i]
        while end >= 4:
            a = find_row(abs(points[end] - points[end - 1]), table, bins, scale)
            b = find_row(abs(points[end - 1] - points[end - 2]), table, bins, scale)
            c = find_row(abs(points[end - 2] - points[end - 3]), table, bins, scale)
            if a != b or b != c:
                break
            end -= 2
            points[end] = points[end + 2]
    return restore_stack(points[1 : end + 1].copy(), points, values, table, bins, scale)


@jit
def turning_point_run(u, offset, intercept, table, bins, scale, points, values, top, last, y):
    """Write ``intercept + sum_k w_k F_k[u - offset]`` to ``y``; return ``top`` and the last input.

    ``points`` and ``values`` hold the stack (see :func:`restore_stack`), ``last`` the previous
    input less the offset.
    """
    one, two = np.uint64(1), np.uint64(2)  # unsigned: spares a test for negative indices
    room = np.uint64(points.size - 2)
    last_bin = float(bins.size - 1)
    depth = np.uint64(top)
    base = limit = start = 0.0
    if top == 0:
        sign = 1.0
        output = virgin(last, table, bins, scale)
    else:
        base, limit, start = points[top], points[top - 1], values[top]
        sign = 1.0 if base < limit else -1.0
        output = start + sign * branch(abs(last - base), table, bins, scale)
    for i in range(u.size):
        value = u[i] - offset
        if depth > 0:
            if sign * (value - last) < 0.0:
                depth += one
                points[depth] = last
                values[depth] = output
                base, limit, start = last, base, output
                sign = -sign
                if depth > room:
                    top = compress_stack(points, values, np.int64(depth), table, bins, scale)
                    depth = np.uint64(top)
                    base, limit, start = points[top], points[top - 1], values[top]
            if sign * (value - limit) >= 0.0:
                while depth > two:
                    depth -= two
                    limit = points[depth - one]
                    if sign * (value - limit) < 0.0:
                        break
                else:
                    depth -= depth
                base, start = points[depth], values[depth]
        elif abs(value) < abs(last):
            depth = one
            base, limit, start = last, -last, output
            points[0], points[1], values[1] = limit, base, start
            sign = 1.0 if last < 0.0 else -1.0
        if depth > 0:
            distance = abs(value - base)
            factor = sign
        else:
            distance = 2.0 * abs(value)
            start = 0.0
            factor = 0.5 if value > 0.0 else -0.5
        # find_row, written out: a call that hands over arrays would take longer than the rest.
        scaled = distance * scale
        b = np.uint32(scaled if scaled < last_bin else last_bin)
        row = np.uint64(bins[b])
        if distance > table[row, 3]:
            row += one
            if distance > table[row, 3]:
                row = np.uint64(find_row(distance, table, bins, scale))
        output = start + factor * (table[row, 1] + table[row, 2] * (distance - table[row, 0]))
        last = value
        y[i] = output + intercept
    return np.int64(depth), last
