r"""Preisach model: relays with a density over the half plane of their thresholds.

    y = c + integral of mu(alpha, beta) gamma[u] over alpha >= beta + sum_k g_k s_k(u)

with relays gamma, and ``s_k`` that rise from -1 to 1 between levels ``k`` and ``k + 1``. The
density mu is constant in the cells of a grid, see ``_relay_grid``; the response is evaluated from
the turning points of the drive.

The levels ``x_0 < ... < x_{n-1}`` cut the half plane ``alpha >= beta`` into cells: interval ``i``
of ``alpha`` (``x_i`` to ``x_{i+1}``) and interval ``j <= i`` of ``beta``; those on the diagonal
are triangles. Cells are numbered ``i (i + 1) / 2 + j``. The weight of a cell is its density times
its area.

From the last turning point ``e`` the output follows (Everett)

    y = y(e) +- S(e, v),    S(e, v) = 2 E(max(e, v), min(e, v)),

with E (the Everett function) the integral of the density over the triangle of all relays that
switch between e and v. In a cell off the diagonal S is bilinear between its values at the corners,
less the quadratic terms of the triangular cells at both ends; in a cell on the diagonal it is
quadratic. The reversible part (relays of equal thresholds) is piecewise linear in the drive and
included in S. On the first loading the staircase ends on the line ``alpha + beta = 2 center``;
there the slope of the output is that of S at ``e = 2 center - v``, which is piecewise linear in
``v``.

The stack of turning points is ``points[1..top]`` with outputs ``values[1..top]``; ``points[0]`` is
the mirror image of the first turning point about the centre, beyond which the device is on its
first loading again (``top = 0``). All drives are clipped to the range of the levels: no relay
switches outside.
"""

import dataclasses
import math
from functools import cached_property

import numpy as np

from .._jit import jit
from ..operators import CompiledLaw, as_signal, parameter
from ._common import show
from ._relay_grid import RelayGridModel, RelayGridOperator, cell_indices


@jit
def build_bins(levels, bins):
    """Fill ``bins`` (B + 2,) with the first interval that may hold a value; return their scale."""
    last = bins.size - 1
    scale = (last - 1) / (levels[-1] - levels[0])
    j, bins[last] = 0, levels.size - 2
    for b in range(last):
        while j < levels.size - 2 and int((levels[j + 1] - levels[0]) * scale) < b:
            j += 1
        bins[b] = j
    return scale


@jit
def find_interval(value, levels, bins, scale):
    """Return the index of the interval of a value within the range of the levels."""
    b = int((value - levels[0]) * scale)
    j, n = int(bins[b]), int(bins[b + 1] - bins[b]) + 1
    while n > 1:  # of the n intervals from j on
        half = n // 2
        j += half * int(value >= levels[j + half])
        n -= half
    return j


@jit
def everett_value(e, i, v, j, levels, everett, diagonal):
    """Return S(e, v) for ``e`` in interval ``i`` and ``v`` in interval ``j``."""
    width = levels[j + 1] - levels[j]
    if i == j:
        d = abs(v - e) / width
        return d * (diagonal[j, 0] * d + diagonal[j, 1])
    s = (e - levels[i]) / (levels[i + 1] - levels[i])
    t = (v - levels[j]) / width
    low = everett[i, j] + s * (everett[i + 1, j] - everett[i, j])
    high = everett[i, j + 1] + s * (everett[i + 1, j + 1] - everett[i, j + 1])
    # the triangular cells at both ends are quadratic: subtract their deviation from a straight line
    bend = diagonal[i, 0] * s * (1.0 - s) + diagonal[j, 0] * t * (1.0 - t)
    return low + t * (high - low) - bend


@jit
def everett_slope(e, i, v, j, levels, everett, diagonal):
    """Return ``|dS/dv|``: the slope of the response at ``v`` on the branch from ``e``."""
    width = levels[j + 1] - levels[j]
    if i == j:
        return (2.0 * diagonal[j, 0] * abs(v - e) / width + diagonal[j, 1]) / width
    s = (e - levels[i]) / (levels[i + 1] - levels[i])
    low = everett[i, j] + s * (everett[i + 1, j] - everett[i, j])
    high = everett[i, j + 1] + s * (everett[i + 1, j + 1] - everett[i, j + 1])
    t = (v - levels[j]) / width
    slope = (high - low - diagonal[j, 0] * (1.0 - 2.0 * t)) / width
    return slope if j > i else -slope


@jit
def first_loading_table(knots, center, levels, everett, diagonal, bins, scale, table):
    """Fill rows ``[knot, output, rise, bend]`` of the first-loading curve.

    At the fraction ``t`` between a knot and the next the output is ``output + t (rise + t bend)``.
    ``knots`` are the levels, their mirror images about the centre and the centre. On entry
    ``table[0, 1]`` is the output at the first knot, the lowest level.
    """
    low, high = levels[0], levels[-1]
    for k in range(knots.size - 1):
        start, width = knots[k], knots[k + 1] - knots[k]
        v = start + 0.5 * width
        j = find_interval(v, levels, bins, scale)
        e = min(max(2.0 * center - v, low), high)
        i = find_interval(e, levels, bins, scale)
        slopes = np.empty(2)
        for end in range(2):
            v = knots[k + end]
            e = min(max(2.0 * center - v, low), high)
            slopes[end] = everett_slope(e, i, v, j, levels, everett, diagonal)
        table[k, 0] = start
        table[k, 2] = slopes[0] * width
        table[k, 3] = 0.5 * (slopes[1] - slopes[0]) * width
        table[k + 1, 1] = table[k, 1] + 0.5 * (slopes[0] + slopes[1]) * width
    table[-1, 0] = knots[-1]
    table[-1, 2:] = 0.0


@jit
def first_loading_row(value, table):
    """Return the row of the first-loading table for a value."""
    row, n = 0, table.shape[0] - 1
    while n > 1:  # of the n rows from this one on
        half = n // 2
        row += half * int(value >= table[row + half, 0])
        n -= half
    return row


@jit
def first_loading(value, table):
    """Return the output on the first loading."""
    row = first_loading_row(value, table)
    t = (value - table[row, 0]) / (table[row + 1, 0] - table[row, 0])
    return table[row, 1] + t * (table[row, 2] + t * table[row, 3])


@jit
def advance(points, depth, center, last, value):
    """Move the drive from ``last`` to ``value``: push or wipe out turning points; return depth."""
    if depth == 0:
        if abs(value - center) < abs(last - center):
            points[0] = 2.0 * center - last
            points[1] = last
            return 1
        return 0
    sign = 1.0 if points[depth] < points[depth - 1] else -1.0
    if sign * (value - last) < 0.0:
        depth += 1
        points[depth] = last
        sign = -sign
    while depth > 0 and sign * (value - points[depth - 1]) >= 0.0:
        depth = max(depth - 2, 0)
    return depth


@jit
def response(value, depth, points, values, at, levels, everett, diagonal, loading, bins, scale):
    """Return the output after ``points[1..depth]``, whose outputs begin at ``values[at + 1]``."""
    if depth == 0:
        return first_loading(value, loading)
    e = points[depth]
    i = find_interval(e, levels, bins, scale)
    j = find_interval(value, levels, bins, scale)
    part = everett_value(e, i, value, j, levels, everett, diagonal)
    return values[at + depth] + (part if e < points[depth - 1] else -part)


@jit
def restore_values(points, top, values, levels, everett, diagonal, loading, bins, scale):
    """Recompute the outputs at the turning points ``points[1..top]``."""
    tables = levels, everett, diagonal, loading, bins, scale
    for k in range(top):
        values[k + 1] = response(points[k + 1], k, points, values, 0, *tables)


@jit
def forget(points, values, at, depth):
    """Drop the pair of turning points, except the first, of least effect; return the new depth.

    Dropping a pair changes the state of the relays in one rectangle of the half plane. On either
    axis the sides of all n rectangles add up to at most the drive's range, so the smallest
    rectangle has an area below ``(range / n)^2``.
    """
    least, place = math.inf, 2
    for k in range(2, depth - 1):
        area = abs((points[k + 2] - points[k]) * (points[k + 1] - points[k - 1]))
        if area < least:
            least, place = area, k
    for k in range(place, depth - 1):
        points[k] = points[k + 2]
        values[at + k] = values[at + k + 2]
    return depth - 2


@jit
def everett_step(u, c, s):
    """Return the response at one sample.

    ``c`` is (center, intercept, *tables). ``s`` is the stack of n turning points, the n outputs
    there, the depth of the stack, the last drive and its output.
    """
    center, y, levels, everett, diagonal, loading, bins, scale = c
    n = (s.size - 3) // 2
    value = min(max(u, levels[0]), levels[levels.size - 1])
    depth = int(s[2 * n])
    if depth == n - 1:
        depth = forget(s, s, n, depth)
    s[n + depth + 1] = s[2 * n + 2]  # used only if the last drive becomes a turning point
    depth = advance(s, depth, center, s[2 * n + 1], value)
    output = response(value, depth, s, s, n, levels, everett, diagonal, loading, bins, scale)
    s[2 * n], s[2 * n + 1], s[2 * n + 2] = depth, value, output
    return y + output


def in_tables(s, c):
    """Return whether a state of :func:`everett_step` has a valid depth and drives in range."""
    n, levels = (len(s) - 3) // 2, c[2]
    depth, last = s[2 * n : 2 * n + 2]
    if depth not in range(n):
        return False
    drives = [*s[1 : int(depth) + 1], last]
    return levels[0] <= min(drives) and max(drives) <= levels[-1]


@jit
def everett_run(
    u, center, levels, everett, diagonal, loading, bins, scale, points, values, top, last, y
):
    """Write the response, less its intercept, to ``y``; return ``top`` and the last drive."""
    low, high = levels[0], levels[-1]
    inverse = 1.0 / (levels[1:] - levels[:-1])
    one = np.uint64(1)  # unsigned indices save the check for negative ones
    depth = top
    stale = True  # the values cached for the last turning point are outdated
    row = np.uint64(0)
    start, sign, limit, s, bend = 0.0, 1.0, 0.0, 0.0, 0.0
    tables = levels, everett, diagonal, loading, bins, scale
    output = response(last, depth, points, values, 0, *tables)
    for k in range(u.size):
        value = min(max(u[k], low), high)
        if depth == 0 or sign * (value - last) < 0.0 or sign * (value - limit) >= 0.0 or stale:
            before = depth
            values[depth + 1] = output  # used only if ``last`` becomes a turning point
            depth = advance(points, depth, center, last, value)
            if depth > 0 and (depth != before or stale):
                e, limit, start = points[depth], points[depth - 1], values[depth]
                sign = 1.0 if e < limit else -1.0
                row = np.uint64(find_interval(e, levels, bins, scale))
                s = (e - levels[row]) * inverse[row]
                bend = start - sign * diagonal[row, 0] * s * (1.0 - s)
                stale = False
        last = value
        if depth == 0:
            output = first_loading(value, loading)
        else:
            # find_interval and everett_value inlined, with the cached values of ``e``
            j = np.uint64(bins[np.uint64((value - low) * scale)])
            if value >= levels[j + one]:
                j = np.uint64(find_interval(value, levels, bins, scale))
            t = (value - levels[j]) * inverse[j]
            if row == j:
                t = abs(t - s)
                output = start + sign * t * (diagonal[j, 0] * t + diagonal[j, 1])
            else:
                a = everett[row, j]
                b = everett[row, j + one]
                a += s * (everett[row + one, j] - a)
                b += s * (everett[row + one, j + one] - b)
                output = bend + sign * (a + t * (b - a - diagonal[j, 0] * (1.0 - t)))
        y[k] = output
    return depth, last


@jit
def everett_tangents(
    u, du, center, levels, everett, diagonal, loading, bins, scale, points, last, out
):
    """Write the tangents of the response to those of the drive to ``out[:, :m]``.

    The run starts on the first loading, at ``last``.
    """
    low, high = levels[0], levels[-1]
    m = du.shape[1]
    held = np.zeros((points.size, m))  # tangents of the outputs at the turning points
    moved = np.zeros((points.size, m))  # tangents of the turning points themselves
    before, output = np.zeros(m), np.zeros(m)
    depth = 0
    for k in range(u.size):
        value = min(max(u[k], low), high)
        inside = 1.0 if low < u[k] < high else 0.0
        for c in range(m):
            held[depth + 1, c] = output[c]
            moved[depth + 1, c] = before[c]
        depth = advance(points, depth, center, last, value)
        j = find_interval(value, levels, bins, scale)
        for c in range(m):
            before[c] = inside * du[k, c]
        if depth == 0:
            row = first_loading_row(value, loading)
            width = loading[row + 1, 0] - loading[row, 0]
            slope = (
                loading[row, 2] + 2.0 * loading[row, 3] * (value - loading[row, 0]) / width
            ) / width
            for c in range(m):
                output[c] = slope * before[c]
        else:
            e = points[depth]
            i = find_interval(e, levels, bins, scale)
            here = everett_slope(e, i, value, j, levels, everett, diagonal)
            there = everett_slope(value, j, e, i, levels, everett, diagonal)
            for c in range(m):
                output[c] = held[depth, c] + here * before[c] - there * moved[depth, c]
        last = value
        for c in range(m):
            out[k, c] = output[c]


@jit
def spread(r, j, upper, lower, level, slope, edges, areas):
    """Add one piece of the staircase to the cells of row ``r``; return the cell where it ends.

    Between ``upper`` and ``lower`` (of beta) relays are up below ``level + slope * beta``. The
    piece must not cross the upper edge of the row.
    """
    while j >= 0:
        high, low = min(upper, edges[j + 1]), max(lower, edges[j])
        if high > low:
            middle = 0.5 * (high + low)
            height = min(level + slope * middle, edges[r + 1])
            height -= middle if j == r else edges[r]
            if height > 0.0:
                areas[j] += (high - low) * height
        if lower >= edges[j]:
            break
        j -= 1
    return j


@jit
def row_areas(r, sign, value, center, edges, points, top, areas):
    """Write the areas switched up in the cells of row ``r``, an interval of alpha, to ``areas``.

    Relays are up below the staircase. As beta decreases, its height is the drive down to the last
    minimum, then the maximum before that down to the minimum before it, and so on; on the first
    loading it is ``2 center - beta``. With ``sign = -1`` and mirrored ``edges`` the roles of alpha
    and beta are exchanged: row ``r`` is interval ``n - 2 - r`` of beta, and the areas are those
    switched down.
    """
    areas[: r + 1] = 0.0
    v = sign * value
    axis = 2.0 * sign * center
    k = top
    if top == 0:
        lower = min(v, axis - v)
    elif sign * points[top] < v:
        lower = sign * points[top]
    else:  # the last turning point is a maximum: the drive itself is the last minimum
        lower = v
        k = top + 1
    level = upper = v
    j = r
    while True:
        if level >= edges[r + 1]:
            spread(r, j, upper, -np.inf, level, 0.0, edges, areas)
            return
        j = spread(r, j, upper, lower, level, 0.0, edges, areas)
        upper = lower
        if k < 2:
            break
        level = sign * points[k - 1]
        k -= 2
        lower = sign * points[k]
    end = axis - edges[r + 1]
    j = spread(r, j, min(upper, axis - edges[r]), end, axis, -1.0, edges, areas)
    spread(r, j, min(upper, end), -np.inf, edges[r + 1], 0.0, edges, areas)


@jit
def fill_row(r, sign, value, center, edges, points, top, areas, cells):
    """Write the mean relay states of the cells of row ``r``, see :func:`row_areas`."""
    row_areas(r, sign, value, center, edges, points, top, areas)
    height = edges[r + 1] - edges[r]
    n = edges.size
    for j in range(r + 1):
        area = height * (edges[j + 1] - edges[j])
        if j == r:
            area *= 0.5
        state = sign * (2.0 * min(areas[j] / area, 1.0) - 1.0)
        if sign > 0.0:
            cells[r * (r + 1) // 2 + j] = state
        else:
            i, column = n - 2 - j, n - 2 - r
            cells[i * (i + 1) // 2 + column] = state


@jit
def staircase_rows(
    u, center, levels, mirrored, bins, scale, n_reversible, points, top, last, out, first
):
    """Write the mean relay states of all cells, then of the reversible part, to ``out[:, first:]``.

    These are the derivatives of the response with respect to the weights. ``mirrored`` is
    ``-levels[::-1]``. Returns ``top`` and the last drive. A rising drive changes only the cells of
    the intervals of alpha that it passes, a falling one those of beta; in the last of these
    intervals the areas are computed anew.
    """
    n = levels.size
    low, high = levels[0], levels[-1]
    n_cells = n * (n - 1) // 2
    cells, areas = np.empty(n_cells), np.empty(n)
    for r in range(n - 1):
        fill_row(r, 1.0, last, center, levels, points, top, areas, cells)
    for k in range(u.size):
        value = min(max(u[k], low), high)
        top = advance(points, top, center, last, value)
        j = find_interval(value, levels, bins, scale)
        if value > last:
            for i in range(find_interval(last, levels, bins, scale), j):
                cells[i * (i + 1) // 2 : (i + 1) * (i + 2) // 2] = 1.0
            fill_row(j, 1.0, value, center, levels, points, top, areas, cells)
        elif value < last:
            for column in range(j + 1, find_interval(last, levels, bins, scale) + 1):
                for i in range(column, n - 1):
                    cells[i * (i + 1) // 2 + column] = -1.0
            fill_row(n - 2 - j, -1.0, value, center, mirrored, points, top, areas, cells)
        last = value
        row = out[k, first:]
        for c in range(n_cells):
            row[c] = cells[c]
        for c in range(n_reversible):
            part = (value - levels[c]) / (levels[c + 1] - levels[c])
            row[n_cells + c] = 2.0 * min(max(part, 0.0), 1.0) - 1.0
    return top, last


# most turning points in the state of a step. Dropping one changes less than 2 / _CORNERS^2 of all
# relays, half the resolution of a 16-bit converter
_CORNERS = 512


@dataclasses.dataclass(frozen=True, eq=False)
class PreisachOperator(RelayGridOperator):
    """Superposition of relays with a piecewise-constant density; :class:`Preisach` gives the law.

    The output is continuous. The time of a run does not depend on the number of cells. The operator
    is rate-independent: ``dt`` is not used.

    Parameters
    ----------
    levels : array-like of shape (n,)
        Levels of the drive, ascending, units of the drive. Fixed structure. Beyond the first and
        the last the model is saturated: no relay switches and the output stays constant.
    weights : array-like of shape (n (n - 1) / 2,)
        Density times area of each cell, units of the response. The cell of interval ``i`` of alpha
        and interval ``j <= i`` of beta has the number ``i (i + 1) / 2 + j``.
    reversible : array-like of shape (n - 1,) or (0,), default=()
        Weights of the reversible part, units of the response.
    intercept : float, default=0.0
        Midway between the two saturations, units of the response.
    center : float, default=0.0
        Drive at which the virgin device is demagnetised: relays with ``alpha + beta`` above
        ``2 center`` are down, the others up. ``-inf`` (or the lowest level): all down at first,
        ``inf``: all up.
    non_negative : bool, default=True
        Whether the weights are bounded below by zero when they are identified.
    falling : bool, default=False
        Whether that bound is an upper one: all weights are zero or below, and the response falls
        where the drive rises.

    Raises
    ------
    ValueError
        If the levels do not ascend, or the number of weights does not match them.

    Notes
    -----
    The state is the tuple (turning points, last drive), clipped to the range of the levels. The
    turning points are nested, the oldest and largest first; there are none during the first
    loading. ``"rest"`` is the state after the first loading from ``center`` to the first sample,
    ``"zero"`` the state before it. Both give the same output.

    Examples
    --------
    >>> from skhyst.hysteresis import PreisachOperator
    >>> operator = PreisachOperator(levels=[-1.0, 0.0, 1.0], weights=[0.0, 1.0, 0.0])
    >>> y, state = operator.run([0.0, 1.0, 0.0, -0.5, -1.0, 0.5], dt=1e-3)
    >>> y
    array([ 0.,  1.,  1.,  0., -1.,  0.])
    """

    levels: np.ndarray
    weights: np.ndarray = parameter(linear=True, lower=0.0, unit="response")
    reversible: np.ndarray = parameter(default=(), linear=True, lower=0.0, unit="response")
    intercept: float = parameter(default=0.0, linear=True, gauge=0.0, unit="response")
    center: float = 0.0
    non_negative: bool = True
    falling: bool = False

    def __post_init__(self):
        super().__post_init__()
        n = self.levels.size - 1
        wanted = f"be empty or have one value for each of the {n} intervals"
        self._require("reversible", self.reversible.size in (0, n), wanted)

    @cached_property
    def _bins(self):
        bins = np.empty(4 * self.levels.size + 2, dtype=np.int64)
        return bins, build_bins(self.levels, bins)

    @cached_property
    def _tables(self):
        n = self.levels.size
        grid = np.zeros((n - 1, n - 1))
        grid[np.tril_indices(n - 1)] = self.weights
        reversible = self.reversible if self.reversible.size else np.zeros(n - 1)
        # E between two levels: all cells and reversible weights in between; S is twice that
        everett = np.zeros((n, n))
        everett[1:, :-1] = np.cumsum(np.cumsum(grid[:, ::-1], axis=1)[:, ::-1], axis=0)
        everett += np.tril(np.subtract.outer(*2 * [np.append(0.0, np.cumsum(reversible))]))
        everett = 2.0 * np.tril(everett, -1)
        everett += everett.T
        diagonal = 2.0 * np.column_stack((grid.diagonal(), reversible))
        low, high = self.levels[[0, -1]]
        knots = np.unique(np.r_[self.levels, 2.0 * self._center - self.levels, self._center])
        knots = knots[(knots >= low) & (knots <= high)]
        loading = np.zeros((knots.size, 4))
        loading[0, 1] = -(self.weights.sum() + reversible.sum())
        grid = self.levels, everett, diagonal
        first_loading_table(knots, self._center, *grid, *self._bins, loading)
        return *grid, loading, *self._bins

    def init(self, u0, initial_state="rest"):
        last = np.clip(u0, *self.levels[[0, -1]]) if initial_state == "rest" else self._center
        return np.empty(0), float(last)

    def _stack(self, state, n_samples):
        """Return a stack with space for ``n_samples`` more points, its depth and the last drive."""
        turning_points, last = state
        top = turning_points.size
        points = np.empty(top + n_samples + 2)
        points[1 : top + 1] = turning_points
        if top:
            points[0] = 2.0 * self._center - points[1]
        return points, top, float(last)

    def run(self, u, dt, state=None):
        u = as_signal(u)
        points, top, last = self._stack(state or self._before(u), u.size)
        values, y = np.empty(points.size), np.empty(u.size)
        restore_values(points, top, values, *self._tables)
        top, last = everett_run(u, self._center, *self._tables, points, values, top, last, y)
        y += self.intercept
        return y, (points[1 : top + 1].copy(), last)

    def compiled_step(self, dt, state):
        points, top, last = self._stack(state, 0)
        n = max(_CORNERS, top) + 1
        s = np.zeros(2 * n + 3)
        if top:
            s[: top + 1] = points[: top + 1]
        restore_values(s, top, s[n:], *self._tables)
        s[2 * n :] = top, last, response(last, top, s, s, n, *self._tables)
        constants = self._center, self.intercept, *self._tables
        return CompiledLaw(everett_step, constants, s, possible=in_tables)

    def _fill(self, u, state, rows, first):
        points, *place = self._stack(state, u.size)
        grid = self.levels, as_signal(-self.levels[::-1]), *self._bins, self.reversible.size
        top, last = staircase_rows(u, self._center, *grid, points, *place, rows, first)
        return points[1 : top + 1].copy(), last

    def _propagate(self, u, du, state, out):
        points, _, last = self._stack(state, u.size)
        everett_tangents(u, du, self._center, *self._tables, points, last, out)

    def everett(self, alpha, beta):
        """Return the Everett function: half the change of the response over an ascending branch.

        The branch goes from ``beta`` up to ``alpha``. Beyond the levels the function is constant.

        Parameters
        ----------
        alpha, beta : float
            Upper and lower drive.

        Returns
        -------
        float
            Units of the response.
        """
        high, low = np.clip([alpha, beta], *self.levels[[0, -1]])
        levels, everett, diagonal, _, *bins = self._tables
        i, j = find_interval(high, levels, *bins), find_interval(low, levels, *bins)
        return 0.5 * everett_value(high, i, low, j, levels, everett, diagonal)


class Preisach(RelayGridModel):
    r"""Preisach model of rate-independent hysteresis with a free density.

    .. math::

        y = c + \iint_{\alpha \ge \beta} \mu(\alpha, \beta)\, \gamma_{\alpha\beta}[u]\,
        d\alpha\, d\beta + \sum_k g_k\, s_k(u)

    A relay :math:`\gamma_{\alpha\beta}` is +1 once the drive has reached alpha and -1 once it has
    fallen to beta. The density is constant in the cells of a grid over the range of the drive; the
    last sum is the density on the line alpha = beta, the reversible part. The density is solved
    exactly by (non-negative) least squares with a penalty on the differences of neighbouring
    cells; no starting values are needed. The time of a prediction does not depend on the number of
    cells.

    Parameters
    ----------
    reversible : bool, default=True
        Whether there is a reversible part. Without it the slope of the response is zero right after
        each reversal of the drive.

    Attributes
    ----------
    density_ : ndarray of shape (n_levels - 1, n_levels - 1)
        Density in each cell, alpha by beta, zero above the diagonal; units of the response over
        those of the drive squared.
    reversible_ : ndarray of shape (n_levels - 1,) or (0,)
        Weights of the reversible part, units of the response.

    See Also
    --------
    KrasnoselskiiPokrovskii : Continuous elements in place of relays.
    PrandtlIshlinskii : Fewer weights, with an inverse in closed form.

    References
    ----------
    Mayergoyz, *Mathematical Models of Hysteresis and Their Applications*, 2003, sections 1.2
    (staircase, wiping-out, congruency) and 1.3 (Everett function, numerical form).

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import Preisach
    >>> drive = np.sin(np.linspace(0, 20, 500)) * np.linspace(0, 1, 500)
    >>> X = drive.reshape(-1, 1)
    >>> model = Preisach(n_levels=5).fit(X, drive)
    >>> bool(np.allclose(model.predict(X), drive, atol=1e-3))
    True
    """

    _parameter_constraints = {**RelayGridModel._parameter_constraints, "reversible": ["boolean"]}

    operator_class = PreisachOperator

    def __init__(
        self,
        n_levels=20,
        *,
        levels="grid",
        smoothness=1e-3,
        reversible=True,
        non_negative=True,
        fit_intercept=True,
        center=0.0,
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        super().__init__(
            n_levels,
            levels=levels,
            smoothness=smoothness,
            non_negative=non_negative,
            fit_intercept=fit_intercept,
            center=center,
            initial_state=initial_state,
            dt=dt,
            drive=drive,
            method=method,
        )
        self.reversible = reversible

    def _start(self, records):
        operator = super()._start(records)
        zeros = np.zeros(operator.levels.size - 1 if self.reversible else 0)
        return dataclasses.replace(operator, reversible=zeros)

    def adopt(self, result):
        super().adopt(result)
        show(self, self.operator_, "reversible")
        width = np.diff(self.levels_)
        area = np.outer(width, width)
        area[np.diag_indices_from(area)] *= 0.5
        self.density_ = np.zeros_like(area)
        self.density_[cell_indices(self.levels_.size)] = self.weights_
        self.density_ /= area
        return self
