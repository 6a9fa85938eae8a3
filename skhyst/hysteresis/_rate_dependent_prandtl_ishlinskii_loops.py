"""Loops of the plays whose thresholds or weights follow a rate: run, inverse, tangents."""

import numpy as np

from .._jit import jit
from ..operators import clip_play


@jit
def rate_play_run(u, rates, thresholds, growth, weights, rate_weights, plays, out):
    """Write ``sum_k (w_k + s_k rate) F_k[u]`` to ``out`` (n,); ``plays`` (K,) is updated.

    ``rates`` (n,) are not negative; ``growth`` of the thresholds and ``rate_weights`` are (K,).
    """
    n_plays = thresholds.size
    for i in range(u.size):
        value = u[i]
        rate = rates[i]
        for k in range(n_plays):
            slack = thresholds[k] + growth[k] * rate
            plays[k] = clip_play(plays[k], value - slack, value + slack)
        total = 0.0
        for k in range(n_plays):
            total += (weights[k] + rate * rate_weights[k]) * plays[k]
        out[i] = total


@jit
def rate_play_inverse(y, rates, thresholds, growth, weights, rate_weights, plays, out):
    """Write to ``out`` (n,) the drive whose :func:`rate_play_run` is ``y`` at the given rates.

    The first threshold is zero and does not grow, and the response rises with the drive, whichever
    plays move: it is straight between the values at which one of them starts to. Newton's steps
    lead from one such piece to another, within a bracket, until one leads to itself. ``plays`` (K,)
    is updated.
    """
    for i in range(y.size):
        rate = rates[i]
        value, low, high = plays[0], -np.inf, np.inf
        while True:
            slope = offset = 0.0
            for k in range(thresholds.size):
                slack = thresholds[k] + growth[k] * rate
                weight = weights[k] + rate * rate_weights[k]
                if value - slack >= plays[k]:
                    slope += weight
                    offset -= weight * slack
                elif value + slack <= plays[k]:
                    slope += weight
                    offset += weight * slack
                else:
                    offset += weight * plays[k]
            goal = (y[i] - offset) / slope
            if goal > value:
                low = value
            elif goal < value:
                high = value
            else:
                break
            if not low < goal < high:
                goal = 0.5 * (low + high)
                if not low < goal < high:  # the next number is on the other side
                    break
            value = goal
        for k in range(thresholds.size):
            slack = thresholds[k] + growth[k] * rate
            plays[k] = clip_play(plays[k], value - slack, value + slack)
        out[i] = value


@jit
def rate_play_tangents(u, du, rates, drates, thresholds, growth, weights, rate_weights, plays, out):
    """Write to ``out`` (n, m + K) the tangents carried through by the plays, and the plays.

    ``du`` (n, m) are the tangents of the drive, ``drates`` (n, m) those of the rates, which act
    by the thresholds here, not by the weights. ``plays`` (K,) is updated. A play that moves takes
    over the tangent of the end of its slack; one that sticks keeps the one it took last.
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
