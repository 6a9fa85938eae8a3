"""Velocity of a sampled motion from past samples.

The least-squares slope of the last ``n + 1`` samples is a mean of the last ``n`` backward
differences whose weights are a parabola, ``6 (i + 1) (n - i) / (n (n + 1) (n + 2))`` for
``i = 0 ... n - 1``; with ``n = 1`` it is the backward difference. So the velocity of a drive at
rest is exactly zero, whatever its level.
"""

from functools import cache

import numpy as np

from .._jit import jit


@cache
def _weights(n):
    i = np.arange(n)
    weights = 6.0 * (i + 1) * (n - i) / (n * (n + 1) * (n + 2))
    weights.flags.writeable = False
    return weights


def slopes(values, dt, n):
    """Return the slopes of a signal over ``n`` intervals, from its sample ``n`` on.

    Parameters
    ----------
    values : ndarray of shape (n_samples, ...)
    dt : float
        Sampling interval in s.
    n : int
        Intervals of each slope.

    Returns
    -------
    ndarray of shape (max(n_samples - n, 0), ...)
        At the samples from ``n`` on.
    """
    changes = np.diff(values, axis=0)
    size = max(len(values) - n, 0)
    total = np.zeros((size, *values.shape[1:]))
    # term by term, so that rounding does not depend on where a signal is cut
    for i, weight in enumerate(_weights(n)):
        total += (weight / dt) * changes[i : i + size]
    return total


@jit
def slope_step(value, weights, s, at):
    """Return the slope of :func:`slopes` at one sample, zero before sample n.

    ``weights`` (n,) are those of the last differences, divided by the interval. ``s[at]`` is the
    number of samples still needed, n + 1 at first; then the last value and the last n differences.
    """
    n = weights.size
    change = value - s[at + 1]
    s[at + 1] = value
    slope = 0.0
    for i in range(n):
        s[at + 2 + i] = s[at + 3 + i] if i < n - 1 else change
        slope += weights[i] * s[at + 2 + i]
    s[at] = max(s[at] - 1.0, 0.0)
    return slope if s[at] == 0.0 else 0.0


def stepped_slopes(dt, n):
    """Return weights (n,) and initial state (n + 2,) of :func:`slope_step`."""
    return _weights(n) / dt, np.append(n + 1.0, np.zeros(n + 1))


def samples_before(shape, n, initial_state):
    """Return the samples before a record: n zeros for "zero", none for "rest".

    A record often begins in motion. If a rest before it were assumed, the velocity would jump at
    its first sample, and the acceleration there would be the largest of the record.
    """
    return np.zeros((n if initial_state == "zero" else 0, *shape))


def latest(values, n):
    """Return the last ``n`` values, (n, ...), with zeros in front if there are fewer."""
    missing = n - len(values)
    if missing <= 0:
        return values[len(values) - n :]
    return np.concatenate([np.zeros((missing, *values.shape[1:])), values])
