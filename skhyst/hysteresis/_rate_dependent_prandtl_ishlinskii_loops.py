"""Loops of the plays whose thresholds or weights follow a rate: run, inverse, tangents."""

import numpy as np

from .._jit import jit
from ..operators import clip_play


@jit(inline=True)
def rate_play_sample(value, rate, thresholds, growth, weights, rate_weights, plays):
    """Return ``sum_k (w_k + s_k rate) F_k[u]`` at one sample; ``plays`` begins with those (K,)."""
    for k in range(thresholds.size):
        slack = thresholds[k] + growth[k] * rate
        plays[k] = clip_play(plays[k], value - slack, value + slack)
    total = 0.0
    for k in range(thresholds.size):
        total += (weights[k] + rate * rate_weights[k]) * plays[k]
    return total


@jit
def rate_play_step(u, c, s):
    """Return the response at one sample; ``s`` is the plays, the last drive and low-pass.

    ``c`` is (thresholds, growth, weights, rate_weights, intercept, dt, what is left of the low-pass
    and what is gone of it, whether the rate keeps its sign in it).
    """
    thresholds, growth, weights, rate_weights, intercept, dt, fade, gain, signed = c
    n = thresholds.size
    velocity = (u - s[n]) / dt
    smooth = gain * (velocity if signed > 0.0 else abs(velocity)) + fade * s[n + 1]
    s[n], s[n + 1] = u, smooth
    rate = abs(smooth)
    y = rate_play_sample(u, rate, thresholds, growth, weights, rate_weights, s)
    return y + intercept


@jit
def rate_play_run(u, rates, thresholds, growth, weights, rate_weights, plays, out):
    """Write ``sum_k (w_k + s_k rate) F_k[u]`` to ``out`` (n,); ``plays`` (K,) is updated.

    ``rates`` (n,) are not negative; ``growth`` of the thresholds and ``rate_weights`` are (K,).
    """
    for i in range(u.size):
        out[i] = rate_play_sample(u[i], rates[i], thresholds, growth, weights, rate_weights, plays)


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
