"""Play operators: loops over them, and where to put their thresholds.

A play of threshold ``r`` follows its input once the slack is used up::

    F[k] = max(u[k] - r, min(u[k] + r, F[k - 1]))
"""

import numpy as np

from .._jit import jit

__all__ = [
    "clip_play",
    "play_basis",
    "play_tangents",
    "play_thresholds",
    "stop_basis",
    "turning_points",
]


@jit
def clip_play(play, low, high):
    """Return a play that the ends of its slack have moved.

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
def stop_basis(u, thresholds, plays, out):
    """Write the stops ``u - play`` to ``out``, shape (n, K); ``plays`` (K,) is updated."""
    n_plays = thresholds.size
    for i in range(u.size):
        value = u[i]
        row = out[i]
        for k in range(n_plays):
            play = clip_play(plays[k], value - thresholds[k], value + thresholds[k])
            plays[k] = play
            row[k] = value - play


@jit
def play_tangents(u, du, thresholds, cumulative, plays, out):
    """Write the derivatives of ``sum_k w_k F_k[u]`` to ``out``, shape (n, m + K + 2).

    The first ``m`` columns are the tangents ``du`` (n, m) carried through, then the K plays (the
    derivatives with respect to the weights), a one (intercept) and the derivative with respect to
    an offset subtracted from ``u``. ``thresholds`` (K,) ascend, ``cumulative`` (K + 1,) holds
    ``w_0 + ... + w_{k-1}``, and ``plays`` (K,) the state, updated.

    A play that moves takes over the tangent of ``u``; one that sticks keeps the one it took last.
    Plays that moved last at the same sample are neighbours: they form a block, and the blocks
    form a stack. Block ``j`` holds the plays below ``edge[j]`` that no later block claims, with
    the tangent ``moved[j]``; ``held[j]`` is the weighted sum of the tangents from ``edge[j]`` on.
    So a sample costs ``m`` operations, not ``m K``.
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
    distance, and on the first loading from zero to ``v`` if it is below ``abs(v)``. A record shows
    the part of its first loading that comes after its first sample. Thresholds that no record
    moves are useless, so the largest one stays below the largest span of all records, where the
    span of a record is its largest absolute value if the first loading is seen (the first sample
    is within half the peak-to-peak value from zero), else half the peak-to-peak value.

    Parameters
    ----------
    drive : array-like of shape (n_samples,), or list of such
        The drive, or one array per record, in its own unit.
    n_operators : int
        Number K of thresholds.
    spacing : {"grid", "quantile"}, default="grid"
        ``"grid"``: ``r_k = span * k / K`` for ``k = 0 .. K - 1``; thesis, equation (3.6).
        ``"quantile"``: between successive thresholds equally many passages, where every branch
        passes all thresholds below its half-span once; dense where many branches end. For branches
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
