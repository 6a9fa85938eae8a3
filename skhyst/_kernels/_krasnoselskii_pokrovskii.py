"""Loops over the kernels of Krasnosel'skii and Pokrovskii.

Kernel ``(i, j)``, ``j <= i``, rises along the ramp of interval ``i`` and falls along that of
interval ``j``, where the ramp of interval ``k`` goes from -1 at ``levels[k]`` to 1 at
``levels[k + 1]``::

    z = max(ramp_i(u), min(ramp_j(u), z))

Kernels are numbered ``i (i + 1) / 2 + j``. Since ``ramp_i <= ramp_j``, the order does not matter.
"""

import numpy as np

from .._jit import jit

__all__ = ["ramp_basis", "ramp_run", "ramp_tangents"]


@jit
def fill_ramps(value, levels, ramps):
    """Write the ramps of all intervals."""
    for k in range(ramps.size):
        part = 2.0 * (value - levels[k]) / (levels[k + 1] - levels[k]) - 1.0
        ramps[k] = min(max(part, -1.0), 1.0)


@jit
def move(ramps, kernels):
    """Update the kernels."""
    start = 0
    for i in range(ramps.size):
        low = ramps[i]
        for j in range(i + 1):
            high = ramps[j]
            kernel = kernels[start + j]
            kernel = high if high < kernel else kernel
            kernels[start + j] = low if low > kernel else kernel
        start += i + 1


@jit
def ramp_run(u, levels, weights, kernels, y):
    """Write the weighted sum of the kernels to ``y``; ``kernels`` (K,) is updated."""
    ramps = np.empty(levels.size - 1)
    for k in range(u.size):
        fill_ramps(u[k], levels, ramps)
        move(ramps, kernels)
        total = 0.0
        for c in range(kernels.size):
            total += weights[c] * kernels[c]
        y[k] = total


@jit
def ramp_basis(u, levels, kernels, out):
    """Write the kernels to ``out[:, :K]``; ``kernels`` (K,) is updated."""
    ramps = np.empty(levels.size - 1)
    for k in range(u.size):
        fill_ramps(u[k], levels, ramps)
        move(ramps, kernels)
        row = out[k]
        for c in range(kernels.size):
            row[c] = kernels[c]


@jit
def ramp_tangents(u, du, levels, weights, kernels, out):
    """Write the tangents carried through to ``out[:, :m]``; ``kernels`` (K,) is updated.

    A kernel on a ramp has the tangent of the ramp, one between the ramps keeps the one it had.
    """
    n_ramps, m = levels.size - 1, du.shape[1]
    ramps = np.empty(n_ramps)
    held = np.zeros((kernels.size, m))
    for k in range(u.size):
        value = u[k]
        fill_ramps(value, levels, ramps)
        move(ramps, kernels)
        for t in range(m):
            out[k, t] = 0.0
        c = 0
        for i in range(n_ramps):
            for j in range(i + 1):
                kernel = kernels[c]
                rises = kernel == ramps[i]
                if rises or kernel == ramps[j]:
                    ramp = i if rises else j
                    low, high = levels[ramp], levels[ramp + 1]
                    slope = 2.0 / (high - low) if low < value < high else 0.0
                    for t in range(m):
                        held[c, t] = slope * du[k, t]
                for t in range(m):
                    out[k, t] += weights[c] * held[c, t]
                c += 1
