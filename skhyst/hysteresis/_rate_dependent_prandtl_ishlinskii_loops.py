"""Loops over play operators whose thresholds, or weights, follow the rate of the drive.

At sample ``i`` the rate is ``v``, the play ``k`` has the threshold ``r_k + growth_k v`` and the
weight ``w_k + v s_k``. Threshold and drive are straight lines between samples, so the ends of the
slack are too, and a play, which lies between them at the start, is moved by one of them at most:
clipping it to their last values is exact.
"""

import numpy as np

from .._jit import jit

__all__ = [
    "rate_play_inverse",
    "rate_play_run",
    "rate_play_tangents",
]


@jit
def rate_play_run(u, rates, thresholds, growth, weights, rate_weights, plays, out):
    """Write ``sum_k (w_k + v s_k) F_k[u]`` to ``out`` (n,); ``plays`` (K,) is updated.

    ``rates`` (n,) are not negative; ``growth`` and the ``rate_weights`` ``s_k`` are (K,).
    """
    n_plays = thresholds.size
    for i in range(u.size):
        value = u[i]
        rate = rates[i]
        for k in range(n_plays):
            slack = thresholds[k] + growth[k] * rate
            low = value - slack
            high = value + slack
            play = plays[k]
            play = high if high < play else play
            plays[k] = low if low > play else play
        total = 0.0
        for k in range(n_plays):
            total += (weights[k] + rate * rate_weights[k]) * plays[k]
        out[i] = total


@jit
def rate_play_inverse(y, rates, thresholds, growth, weights, rate_weights, plays, out):
    """Write to ``out`` (n,) the drive whose :func:`rate_play_run` is ``y`` at the given rates.

    The first threshold is zero and does not grow; the sums of the first weights are positive at
    all rates; growth is the same for all other plays. The response is then a rising function of
    the drive, straight between the values at which one play after the other starts to move: these
    are passed in order, upwards or downwards. ``plays`` (K,) is updated.
    """
    n_plays = thresholds.size
    for i in range(y.size):
        rate = rates[i]
        rest = y[i]
        for k in range(1, n_plays):
            rest -= (weights[k] + rate * rate_weights[k]) * plays[k]
        slope = weights[0] + rate * rate_weights[0]
        value = rest / slope
        sign = 0.0
        for k in range(1, n_plays):
            slack = thresholds[k] + growth[k] * rate
            if sign >= 0.0 and value > plays[k] + slack:
                sign = 1.0
            elif sign <= 0.0 and value < plays[k] - slack:
                sign = -1.0
            else:
                break
            weight = weights[k] + rate * rate_weights[k]
            slope += weight
            rest += weight * (plays[k] + sign * slack)
            value = rest / slope
        for k in range(n_plays):
            slack = thresholds[k] + growth[k] * rate
            low = value - slack
            high = value + slack
            play = plays[k]
            play = high if high < play else play
            plays[k] = low if low > play else play
        out[i] = value


@jit
def rate_play_tangents(
    u, du, rates, drates, thresholds, grows, dilation, weights, rate_weights, plays, out
):
    """Write the derivatives of :func:`rate_play_run` to ``out``, shape (n, m + K + S + 2).

    The first ``m`` columns are the tangents ``du`` (n, m) of the drive and ``drates`` (n, m) of the
    rates, carried through; then come the derivatives with respect to the weights, to the ``S``
    rate weights, to an intercept, and to the ``dilation``, where ``growth = dilation grows``. There
    are ``S = K`` rate weights or none. ``plays`` (K,) is updated.

    A play that moves takes over the tangent of the end of its slack; one that sticks keeps the
    one it took last.
    """
    n_plays = thresholds.size
    n_rates = rate_weights.size
    m = du.shape[1]
    tangents = np.zeros((n_plays, m + 1))  # of the plays; the last by the dilation
    total = np.zeros(m + 1)
    for i in range(u.size):
        value = u[i]
        rate = rates[i]
        row = out[i]
        total[:] = 0.0
        for k in range(n_plays):
            slack = thresholds[k] + dilation * grows[k] * rate
            play = plays[k]
            sign = 0.0
            if value - slack >= play:
                play = value - slack
                sign = -1.0
            elif value + slack <= play:
                play = value + slack
                sign = 1.0
            plays[k] = play
            if sign != 0.0:
                for j in range(m):
                    tangents[k, j] = du[i, j] + sign * dilation * grows[k] * drates[i, j]
                tangents[k, m] = sign * grows[k] * rate
            weight = weights[k]
            row[m + k] = play
            if n_rates > 0:
                weight += rate * rate_weights[k]
                row[m + n_plays + k] = rate * play
                for j in range(m):
                    total[j] += rate_weights[k] * play * drates[i, j]
            for j in range(m + 1):
                total[j] += weight * tangents[k, j]
        for j in range(m):
            row[j] = total[j]
        row[m + n_plays + n_rates] = 1.0
        row[m + n_plays + n_rates + 1] = total[m]
