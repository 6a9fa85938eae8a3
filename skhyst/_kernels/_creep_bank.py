"""Relaxing units side by side: one signal in, weighted sums of all units out."""

import numpy as np

from .._jit import jit

__all__ = ["creep_bank"]


@jit
def creep_bank(decay, b0, b1, weights, u, v, u_previous):
    """Return the sums (n_samples, n_sums) and the last state; ``v`` is left as it was.

    ``v[k] = decay v[k-1] + b0 u[k-1] + b1 u[k]`` for each of the units, whose states are weighted
    by ``weights`` (n_sums, n_units).
    """
    n_units = decay.shape[0]
    n_sums = weights.shape[0]
    state = v.copy()
    sums = np.empty((u.shape[0], n_sums))
    for k in range(u.shape[0]):
        for j in range(n_units):
            state[j] = decay[j] * state[j] + (b0[j] * u_previous + b1[j] * u[k])
        for i in range(n_sums):
            total = 0.0
            for j in range(n_units):
                total += weights[i, j] * state[j]
            sums[k, i] = total
        u_previous = u[k]
    return sums, state
