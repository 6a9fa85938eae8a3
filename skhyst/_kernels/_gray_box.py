"""A recursion that adds a polynomial of past signals to a known output.

With the window ``z = [w(k), ..., w(k - n_w), y(k - 1), ..., y(k - n_y)]`` and ``x = mix z``

    y(k) = level(k) + sum_t weights[t] prod_j x[terms[t, j]]

where -1 among the ``terms`` is the factor one. ``w`` and ``y`` carry their past in front.
"""

import math

import numpy as np

from .._jit import jit

__all__ = ["gray_box_run", "gray_box_tangents"]

_BOUND = 1e100  # beyond, the recursion has left the range in which squares are finite


@jit
def gray_box_run(level, w, mix, terms, weights, y):
    """Fill ``y``, (n_y + n_samples,); from where it diverges on it is no number."""
    n_samples = level.size
    n_w, n_y = w.size - n_samples, y.size - n_samples
    x = np.empty(mix.shape[0])
    for k in range(n_samples):
        now = n_y + k
        if n_y > 0 and math.isnan(y[now - 1]):
            y[now] = math.nan
            continue
        for i in range(x.size):
            value = 0.0
            for j in range(n_w + 1):
                value += mix[i, j] * w[n_w + k - j]
            for j in range(1, n_y + 1):
                value += mix[i, n_w + j] * y[now - j]
            x[i] = value
        total = level[k]
        for t in range(weights.size):
            value = weights[t]
            for j in range(terms.shape[1]):
                if terms[t, j] >= 0:
                    value *= x[terms[t, j]]
            total += value
        y[now] = total if abs(total) <= _BOUND else math.nan


@jit
def gray_box_tangents(w, mix, terms, weights, y, dlevel, dw, dy):
    """Fill ``dy``, (n_y + n_samples, m), behind the past in front.

    ``dlevel`` (n_samples, m) and ``dw`` (n_w + n_samples, m) are the tangents of the known output
    and of ``w``; the last columns of ``dy`` are those of the weights. Returns the number of samples
    before the tangents leave the range of floating point.
    """
    n_samples, m = dlevel.shape
    n_w, n_y = w.size - n_samples, y.size - n_samples
    first = m - weights.size
    x, slopes = np.empty(mix.shape[0]), np.empty(mix.shape[0])
    for k in range(n_samples):
        now = n_y + k
        row = dy[now]
        for q in range(m):
            row[q] = dlevel[k, q]
        for i in range(x.size):
            value = 0.0
            for j in range(n_w + 1):
                value += mix[i, j] * w[n_w + k - j]
            for j in range(1, n_y + 1):
                value += mix[i, n_w + j] * y[now - j]
            x[i] = value
            slopes[i] = 0.0
        for t in range(weights.size):
            product = 1.0
            for j in range(terms.shape[1]):
                if terms[t, j] < 0:
                    continue
                product *= x[terms[t, j]]
                others = weights[t]
                for i in range(terms.shape[1]):
                    if i != j and terms[t, i] >= 0:
                        others *= x[terms[t, i]]
                slopes[terms[t, j]] += others
            row[first + t] += product
        for j in range(mix.shape[1]):
            slope = 0.0
            for i in range(x.size):
                slope += slopes[i] * mix[i, j]
            if slope == 0.0:
                continue
            past = dw[n_w + k - j] if j <= n_w else dy[now - (j - n_w)]
            for q in range(m):
                row[q] += slope * past[q]
        for q in range(m):
            if not abs(row[q]) <= _BOUND:
                return k
    return n_samples
