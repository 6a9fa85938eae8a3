"""Play operators and weighted sums of them: loops, tangents, and the choice of thresholds.

A play of threshold ``r`` follows its input once the slack is used up::

    F[k] = max(u[k] - r, min(u[k] + r, F[k - 1]))

The sum ``y = sum_k w_k F_k[v]`` remembers only the nested turning points ``e_1, e_2, ...`` of its
input (wiping-out). From the last of them the output follows one fixed curve (Madelung, Everett),

    y = y(e) + 2 Phi((v - e) / 2),    Phi(x) = sign(x) sum_k w_k max(|x| - r_k, 0),

and from the virgin state ``y = Phi(v)``. Phi is piecewise straight, so a sample costs one table
look-up, whatever the number of plays. The excursion ``D = |v - e|`` is looked up directly: row
``s`` of ``table`` holds ``[2 r_{s-1}, 2 Phi(r_{s-1}), slope, 2 r_s]``, where the slope is
``w_0 + ... + w_{s-1}``; ``bins`` leads from ``D * scale`` to the first row that may apply.

Of three successive excursions that end between the same two thresholds, the middle two turning
points are invisible to every play and can go: that bounds the stack by two entries per threshold.

The stack is ``points[1..top]`` with outputs ``values[1..top]``; ``points[0]`` mirrors the first
turning point, since beyond it the memory is virgin again (``top = 0``).
"""

import dataclasses

import numpy as np

from .._jit import jit
from ._protocol import Operator, as_constant, by_fields


@jit
def clip_play(play, low, high):
    """Return a play, moved so far that it lies between the ends of its slack.

    The comparisons compile to packed ``vminpd`` and ``vmaxpd`` without relaxed arithmetic.
    """
    play = high if high < play else play
    return low if low > play else play


@jit
def play_basis(u, thresholds, plays, out):
    """Write the plays of ``u`` to ``out``, shape (n, K); ``plays`` (K,) is updated."""
    before = plays
    for i in range(u.size):
        value = u[i]
        row = out[i]
        for k in range(thresholds.size):
            row[k] = clip_play(before[k], value - thresholds[k], value + thresholds[k])
        before = row
    for k in range(thresholds.size):
        plays[k] = before[k]


@jit
def play_sum_step(u, c, s):
    """Return a weighted sum of plays at one sample; ``s`` (K,) are the plays.

    ``c`` is (thresholds (K,), weights (K,), intercept, offset of the drive).
    """
    thresholds, weights, y, offset = c
    value = u - offset
    for k in range(s.size):
        s[k] = clip_play(s[k], value - thresholds[k], value + thresholds[k])
        y += weights[k] * s[k]
    return y


@jit
def stop_basis(u, thresholds, plays, out):
    """Write the stops ``u - play`` to ``out``, shape (n, K); ``plays`` (K,) is updated."""
    play_basis(u, thresholds, plays, out)
    for i in range(u.size):
        for k in range(thresholds.size):
            out[i, k] = u[i] - out[i, k]


@jit
def play_tangents(u, du, thresholds, cumulative, plays, out):
    """Write the derivatives of ``sum_k w_k F_k[u]`` to ``out``, shape (n, m + K + 2).

    The first ``m`` columns are the tangents ``du`` (n, m) propagated, then the K plays (the
    derivatives with respect to the weights), a one (intercept) and the derivative with respect to
    an offset of ``u``. ``thresholds`` (K,) ascend, ``cumulative`` (K + 1,) holds
    ``w_0 + ... + w_{k-1}``, and ``plays`` (K,) the state, updated.

    A play that moves has the tangent of ``u``; one that sticks keeps its last tangent. Plays that
    last moved at the same sample are neighbours: they form a block, and the blocks form a stack.
    Block ``j`` holds the plays below ``edge[j]`` that belong to no later block, with the tangent
    ``moved[j]``; ``held[j]`` is the weighted sum of the tangents from ``edge[j]`` on. So a sample
    costs ``m`` operations, not ``m K``.
    """
    n_plays = thresholds.size
    m = du.shape[1]
    edge = np.empty(n_plays + 2, np.int64)
    held = np.zeros((n_plays + 2, m))
    moved = np.zeros((n_plays + 2, m))
    edge[0] = n_plays
    top = 0
    reached = 0
    for i in range(u.size):
        value = u[i]
        row = out[i]
        count = 0
        for k in range(n_plays):
            low = value - thresholds[k]
            high = value + thresholds[k]
            play = clip_play(plays[k], low, high)
            plays[k] = play
            row[m + k] = play
            count += (play == low) | (play == high)
        reached = max(reached, count)
        row[m + n_plays] = 1.0
        row[m + n_plays + 1] = -cumulative[reached]
        if m == 0:
            continue
        if count > 0:
            while top > 0 and edge[top] < count:
                top -= 1
            if edge[top] > count:
                share = cumulative[edge[top]] - cumulative[count]
                for j in range(m):
                    held[top + 1, j] = held[top, j] + share * moved[top, j]
                top += 1
                edge[top] = count
            for j in range(m):
                moved[top, j] = du[i, j]
        total = cumulative[edge[top]]
        for j in range(m):
            row[j] = held[top, j] + total * moved[top, j]


@jit
def threshold_tangents(u, slacks, growth, plays, out):
    """Write the derivatives of the plays of ``u`` by their thresholds to ``out``, (n, K).

    The slack of a play at a sample is ``slacks[i, k]``, with the derivative ``growth[i]`` by its
    threshold; either has one row if it is constant. A play that has last risen stands at ``u -
    slack``, one that has last fallen at ``u + slack``. ``plays`` (K,) is updated.
    """
    held = np.zeros(plays.size)
    for i in range(u.size):
        value = u[i]
        row = slacks[min(i, slacks.shape[0] - 1)]
        rate = growth[min(i, growth.size - 1)]
        for k in range(plays.size):
            if value - row[k] > plays[k]:
                plays[k] = value - row[k]
                held[k] = -rate
            elif value + row[k] < plays[k]:
                plays[k] = value + row[k]
                held[k] = rate
            out[i, k] = held[k]


@jit(inline=True)
def rate_play_sample(value, rate, thresholds, growth, weights, rate_weights, plays):
    """Return ``sum_k (w_k + s_k rate) F_k[u]`` at one sample; ``plays[:K]`` are updated."""
    for k in range(thresholds.size):
        slack = thresholds[k] + growth[k] * rate
        plays[k] = clip_play(plays[k], value - slack, value + slack)
    total = 0.0
    for k in range(thresholds.size):
        total += (weights[k] + rate * rate_weights[k]) * plays[k]
    return total


@jit
def rate_play_run(u, rates, thresholds, growth, weights, rate_weights, plays, out):
    """Write ``sum_k (w_k + s_k rate) F_k[u]`` to ``out`` (n,); ``plays`` (K,) is updated.

    ``rates`` (n,) are not negative; ``growth`` of the thresholds and ``rate_weights`` are (K,).
    """
    for i in range(u.size):
        out[i] = rate_play_sample(u[i], rates[i], thresholds, growth, weights, rate_weights, plays)


@jit
def rate_play_tangents(u, du, rates, drates, thresholds, growth, weights, rate_weights, plays, out):
    """Write to ``out`` (n, m + K) the tangents of the weighted sum of plays, then the plays.

    ``du`` (n, m) are the tangents of the drive, ``drates`` (n, m) those of the rates; here rates
    act through the thresholds only, not through the weights. ``plays`` (K,) is updated. A play that
    moves has the tangent of the end of its slack; one that sticks keeps its last tangent.
    """
    m = du.shape[1]
    tangents = np.zeros((thresholds.size, m))
    for i in range(u.size):
        value = u[i]
        rate = rates[i]
        row = out[i]
        row[:m] = 0.0
        for k in range(thresholds.size):
            slack = thresholds[k] + growth[k] * rate
            play = plays[k]
            sign = 0.0
            if value - slack >= play:
                play = value - slack
                sign = -1.0
            elif value + slack <= play:
                play = value + slack
                sign = 1.0
            plays[k] = play
            row[m + k] = play
            weight = weights[k] + rate * rate_weights[k]
            for j in range(m):
                if sign != 0.0:
                    tangents[k, j] = du[i, j] + sign * growth[k] * drates[i, j]
                row[j] += weight * tangents[k, j]


@jit
def widened_play_step(u, c, s):
    """Return a sum of plays, at one sample, whose thresholds are all scaled by one factor.

    ``u`` is the drive and the factor, ``c`` is (thresholds (K,), weights (K,), intercept, offset of
    the drive), ``s`` (K,) are the plays.
    """
    thresholds, weights, y, offset = c
    value, factor = u[0] - offset, u[1]
    for k in range(s.size):
        slack = factor * thresholds[k]
        s[k] = clip_play(s[k], value - slack, value + slack)
        y += weights[k] * s[k]
    return y


def play_sum_table(thresholds, weights):
    """Tabulate the branches of a sum of plays, for :func:`play_sum_run`.

    Parameters
    ----------
    thresholds, weights : ndarray of shape (n_plays,)
        Ascending thresholds in units of the drive; response/drive.

    Returns
    -------
    table : ndarray of shape (n_plays + 1, 4)
    bins : ndarray of shape (16 * n_plays + 2,)
    scale : float
    """
    table = np.empty((thresholds.size + 1, 4))
    bins = np.empty(16 * thresholds.size + 2, dtype=np.int32)
    return table, bins, _fill_table(thresholds, weights, table, bins)


def play_sum_run(u, offset, intercept, tables, turning_points, last):
    """Run ``y = intercept + sum_k w_k F_k[u - offset]``, whatever the number of plays.

    Parameters
    ----------
    u : ndarray of shape (n_samples,)
        Drive.
    offset, intercept : float
        Units of the drive; of the response.
    tables : tuple
        What :func:`play_sum_table` returned.
    turning_points : ndarray of shape (n_points,)
        Nested turning points of ``u - offset`` so far, the oldest and largest first.
    last : float
        Last value of ``u - offset``.

    Returns
    -------
    y : ndarray of shape (n_samples,)
        Response.
    turning_points : ndarray of shape (n_points_left,)
    last : float
        The memory after the last sample.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.operators import play_sum_run, play_sum_table
    >>> tables = play_sum_table(np.array([0.0, 1.0]), np.array([1.0, 0.5]))
    >>> play_sum_run(np.array([0.0, 4.0, 0.0]), 0.0, 0.0, tables, np.empty(0), 0.0)
    (array([0. , 5.5, 0.5]), array([4.]), 0.0)
    """
    size = 4 * tables[0].shape[0] + 12
    if turning_points.size > size - 2:
        size += turning_points.size
    points, values = np.empty((2, size))
    # a writable copy, like the arrays of `_compress_stack`: one array type to compile for
    top = _restore_stack(np.array(turning_points, dtype=float), points, values, *tables)
    y = np.empty(u.size)
    top, last = _run(u, offset, intercept, *tables, points, values, top, last, y)
    return y, points[1 : top + 1].copy(), last


@jit
def _fill_table(thresholds, weights, table, bins):
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
    # of a smaller knot the quotient would overflow
    scale = n_bins / knot if knot > 1e-290 else 0.0
    row = 0
    for b in range(bins.size):
        while row < n_plays and int(2.0 * thresholds[row] * scale) < b:
            row += 1
        bins[b] = row
    return scale


@jit
def _find_row(distance, table, bins, scale):
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
def _branch(distance, table, bins, scale):
    """Return ``2 Phi(distance / 2)``."""
    row = _find_row(distance, table, bins, scale)
    return table[row, 1] + table[row, 2] * (distance - table[row, 0])


@jit
def _virgin(value, table, bins, scale):
    """Return ``Phi(value)``."""
    half = 0.5 * _branch(2.0 * abs(value), table, bins, scale)
    return half if value > 0.0 else -half


@jit
def _restore_stack(turning_points, points, values, table, bins, scale):
    """Load turning points into the stack and recompute their outputs; return ``top``."""
    top = turning_points.size
    if top == 0:
        return 0
    points[0] = -turning_points[0]
    points[1] = turning_points[0]
    values[1] = _virgin(points[1], table, bins, scale)
    for i in range(2, top + 1):
        points[i] = turning_points[i - 1]
        step = points[i] - points[i - 1]
        if step * (points[i] - points[i - 2]) > 0.0:  # not nested: a broken state
            return i - 1
        part = _branch(abs(step), table, bins, scale)
        values[i] = values[i - 1] + (part if step > 0.0 else -part)
    return top


@jit
def _compress_stack(points, values, top, table, bins, scale):
    """Drop the turning points that affect no play; return the new ``top``."""
    end = 1
    for i in range(2, top + 1):
        end += 1
        points[end] = points[i]
        while end >= 4:
            a = _find_row(abs(points[end] - points[end - 1]), table, bins, scale)
            b = _find_row(abs(points[end - 1] - points[end - 2]), table, bins, scale)
            c = _find_row(abs(points[end - 2] - points[end - 3]), table, bins, scale)
            if a != b or b != c:
                break
            end -= 2
            points[end] = points[end + 2]
    return _restore_stack(points[1 : end + 1].copy(), points, values, table, bins, scale)


@jit
def _run(u, offset, intercept, table, bins, scale, points, values, top, last, y):
    """Write ``intercept + sum_k w_k F_k[u - offset]`` to ``y``; return ``top`` and the last input.

    ``points`` and ``values`` hold the stack (see :func:`_restore_stack`), ``last`` the previous
    input less the offset.
    """
    # This loop is the free run of every sum of plays: what it needs of the top of the stack, the
    # last turning point, the one before it, where the branch closes a loop, and the output at the
    # former, is in ``base``, ``limit`` and ``start``; ``sign`` is the direction of the branch.
    one, two = np.uint64(1), np.uint64(2)  # unsigned: spares a test for negative indices
    room = np.uint64(points.size - 2)
    last_bin = float(bins.size - 1)
    depth = np.uint64(top)
    base = limit = start = 0.0
    if top == 0:
        sign = 1.0
        output = _virgin(last, table, bins, scale)
    else:
        base, limit, start = points[top], points[top - 1], values[top]
        sign = 1.0 if base < limit else -1.0
        output = start + sign * _branch(abs(last - base), table, bins, scale)
    for i in range(u.size):
        value = u[i] - offset
        if depth > 0:
            if sign * (value - last) < 0.0:  # a turn: the last value goes on the stack
                depth += one
                points[depth] = last
                values[depth] = output
                base, limit, start = last, base, output
                sign = -sign
                if depth > room:
                    top = _compress_stack(points, values, np.int64(depth), table, bins, scale)
                    depth = np.uint64(top)
                    base, limit, start = points[top], points[top - 1], values[top]
            if sign * (value - limit) >= 0.0:  # wiping-out: a closed loop leaves no memory
                while depth > two:
                    depth -= two
                    limit = points[depth - one]
                    if sign * (value - limit) < 0.0:
                        break
                else:
                    depth -= depth
                base, start = points[depth], values[depth]
        elif abs(value) < abs(last):  # the first turn after the virgin curve
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
        # _find_row, inlined: the call with its array arguments would take longer than the rest.
        scaled = distance * scale
        b = np.uint32(scaled if scaled < last_bin else last_bin)
        row = np.uint64(bins[b])
        if distance > table[row, 3]:
            row += one
            if distance > table[row, 3]:
                row = np.uint64(_find_row(distance, table, bins, scale))
        output = start + factor * (table[row, 1] + table[row, 2] * (distance - table[row, 0]))
        last = value
        y[i] = output + intercept
    return np.int64(depth), last


class Superposition(Operator):
    """Base of the weighted sums of plays, stops, relays or ramps.

    Fields that are arrays are read-only. Weights are linear parameters, bounded below by zero only
    if the field ``non_negative`` is true; if ``falling`` is true too, zero is an upper bound, and
    the response mirrors a rising one.
    """

    owns_gain = True
    stage_order = 10

    def __post_init__(self):
        super().__post_init__()
        for field in dataclasses.fields(self):
            if field.type is np.ndarray:
                object.__setattr__(self, field.name, as_constant(getattr(self, field.name)))

    def __reduce__(self):
        return by_fields(self)

    def parameter_specs(self):
        """Return the identifiable fields; the weights have a bound if ``non_negative``."""
        specs = super().parameter_specs()
        if not self.non_negative or self.falling:
            upper = 0.0 if self.non_negative else np.inf
            for name, spec in specs.items():
                if spec.linear and spec.lower == 0.0:
                    specs[name] = dataclasses.replace(spec, lower=-np.inf, upper=upper)
        return specs


def turning_points(drive):
    """Return the values between which a signal is monotone, its two ends included.

    Parameters
    ----------
    drive : array-like of shape (n_samples,)
        Signal with one sample at least.

    Returns
    -------
    points : ndarray of shape (n_points,)
        First value, every extremum (a flat top counts once), last value; a constant signal has
        one point.

    See Also
    --------
    play_thresholds : Thresholds of plays that a drive moves.

    Examples
    --------
    >>> from skhyst.operators import turning_points
    >>> turning_points([0.0, 1.0, 2.0, 2.0, -1.0])
    array([ 0.,  2., -1.])
    """
    drive = np.asarray(drive, dtype=float)
    drive = drive[np.append(True, drive[1:] != drive[:-1])]
    rising = drive[1:] > drive[:-1]
    ends = np.append(True, rising[1:] != rising[:-1])[: rising.size]
    return drive[np.append(ends, True)]


def play_thresholds(drive, n_operators, spacing="grid", *, drive_offset=0.0):
    """Return thresholds of play operators that the drive moves.

    A play moves on a branch between two turning points if its threshold is below half their
    distance, and on the first loading from zero to ``v`` if it is below ``abs(v)``. A record
    contains the part of its first loading after its first sample. Thresholds that no record moves
    are useless, so the largest one is below the largest span of all records. The span of a record
    is its largest absolute value if it contains the first loading (its first sample is within half
    the peak-to-peak value from zero), else half the peak-to-peak value.

    Parameters
    ----------
    drive : array-like of shape (n_samples,), or list of such
        The drive, or one array per record, in its own unit.
    n_operators : int
        Number K of thresholds.
    spacing : {"grid", "quantile"}, default="grid"
        ``"grid"``: ``r_k = span * k / K`` for ``k = 0 .. K - 1``; Steinbusch (2020), (3.6).
        ``"quantile"``: equally many passages between successive thresholds, where every branch
        passes each threshold below its half-span once; dense where many branches end. For branches
        of one span this is the grid.
    drive_offset : float, default=0.0
        Drive at which the virgin device rests.

    Returns
    -------
    thresholds : ndarray of shape (n_operators,)
        Strictly ascending from 0, in the unit of the drive. A drive that never moves gives a grid
        below its absolute value, or below 1 if that is zero.

    Raises
    ------
    ValueError
        If ``spacing`` is neither of the two.

    See Also
    --------
    turning_points : The ends of the branches of a drive.
    skhyst.hysteresis.PrandtlIshlinskii : A weighted sum of plays.

    Examples
    --------
    >>> from skhyst.operators import play_thresholds
    >>> play_thresholds([0.0, 8.0, -8.0, 8.0], n_operators=4)
    array([0., 2., 4., 6.])
    """
    if spacing not in ("grid", "quantile"):
        raise ValueError(
            "The 'spacing' parameter of play_thresholds must be 'grid' or 'quantile'. "
            f"Got {spacing!r} instead."
        )
    records = [drive] if np.ndim(drive[0]) == 0 else drive
    records = [np.asarray(record, dtype=float) - drive_offset for record in records]
    records = [record for record in records if record.size]
    levels = np.arange(n_operators) / n_operators
    span = max(map(_span, records), default=0.0)
    if not span > 0.0:
        span = max((np.abs(record).max() for record in records), default=0.0)
        return (span if span > 0.0 else 1.0) * levels
    if spacing == "grid":
        return span * levels
    half_spans = np.sort(np.concatenate([_half_spans(record) for record in records]))
    # Passages below r: sum_i min(h_i, r), straight between the sorted half-spans.
    remaining = np.arange(half_spans.size, 0, -1)
    passages = np.cumsum(np.diff(half_spans, prepend=0.0) * remaining)
    return np.interp(levels * passages[-1], np.append(0.0, passages), np.append(0.0, half_spans))


def _first_loading_is_seen(record):
    return abs(record[0]) <= 0.5 * np.ptp(record)


def _span(record):
    return np.abs(record).max() if _first_loading_is_seen(record) else 0.5 * np.ptp(record)


def _half_spans(record):
    """Return half the length of each branch; the first loading counts with its full length."""
    half_spans = 0.5 * np.abs(np.diff(turning_points(record)))
    if _first_loading_is_seen(record) and half_spans.size:
        half_spans = np.append(half_spans, np.abs(record).max())
    return half_spans
