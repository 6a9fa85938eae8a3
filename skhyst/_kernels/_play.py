"""Loops over play operators.

A play of threshold ``r`` follows its input once the slack is used up::

    F[k] = max(u[k] - r, min(u[k] + r, F[k - 1]))

The comparisons are written as ``a if a > b else b``, the form that compiles to packed
``vmaxpd``/``vminpd`` without relaxed arithmetic. The thresholds of :func:`play_tangents` ascend, so
the plays that move at one sample are always the first ones.
"""

import numpy as np

from .._jit import jit

__all__ = ["play_basis", "play_tangents", "stop_basis"]


@jit
def play_basis(u, thresholds, plays, out):
    """Write the plays of ``u`` to ``out``, shape (n, K); ``plays`` (K,) is updated."""
    before = plays
    for i in range(u.size):
        value = u[i]
        row = out[i]
        for k in range(thresholds.size):
            low = value - thresholds[k]
            high = value + thresholds[k]
            play = before[k]
            play = high if high < play else play
            row[k] = low if low > play else play
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
            low = value - thresholds[k]
            high = value + thresholds[k]
            play = plays[k]
            play = high if high < play else play
            play = low if low > play else play
            plays[k] = play
            row[k] = value - play


@jit
def play_tangents(u, du, thresholds, cumulative, plays, out):
    """Write the derivatives of ``sum_k w_k F_k[u]`` to ``out``, shape (n, m + K + 2).

    The first ``m`` columns are the tangents ``du`` (n, m) carried through, then the K plays (the
    derivatives with respect to the weights), a one (intercept) and the derivative with respect to
    an offset subtracted from ``u``. ``cumulative`` (K + 1,) holds ``w_0 + ... + w_{k-1}``, and
    ``plays`` (K,) the state, updated.

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
            play = plays[k]
            play = high if high < play else play
            play = low if low > play else play
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
