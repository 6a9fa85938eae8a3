"""Free run of a network of Gaussian nodes that sees its own past outputs."""

import numpy as np

from .._jit import jit
from ._recurrent_loops import _exponentials

__all__ = [
    "gaussian_run",
]


@jit(fastmath={"contract", "reassoc", "nsz"})
def gaussian_run(inputs, scaling, centers, rates, last, lags, bound, y):
    """Run ``last[-1] + sum_q last[q] exp(rates[q] |x S - c_q|^2)`` over its past outputs.

    Parameters
    ----------
    inputs : ndarray of shape (n, n_inputs)
        Lagged inputs, the first signals that the network sees; the past outputs come after them.
    scaling : ndarray of shape (n_inputs + n_lags, n_components)
        The matrix S.
    centers : ndarray of shape (n_components, n_nodes)
        Centres in scaled signals.
    rates : ndarray of shape (n_nodes,)
        ``-1 / (2 sigma^2)``.
    last : ndarray of shape (n_nodes + 1,)
        Weights of the output and, at the end, its constant.
    lags : ndarray of int, shape (n_lags,)
        Lags of the output.
    bound : float
        Magnitude beyond which outputs are cut off.
    y : ndarray of shape (start + n,)
        Outputs: those before the run in front, the rest is filled.

    Returns
    -------
    int
        Samples before the first one that was cut off.
    """
    (n_samples, n_inputs), (n_signals, n_components) = inputs.shape, scaling.shape
    before, n_nodes = len(y) - n_samples, len(rates)
    n_good = n_samples
    place, distance, powers = np.empty(n_components), np.empty(n_nodes), np.empty(n_nodes)
    bits = powers.view(np.int64)
    for i in range(n_samples):
        k = before + i
        for c in range(n_components):
            place[c] = 0.0
        for j in range(n_signals):
            signal = inputs[i, j] if j < n_inputs else y[k - lags[j - n_inputs]]
            for c in range(n_components):
                place[c] += signal * scaling[j, c]
        for q in range(n_nodes):
            distance[q] = 0.0
        for c in range(n_components):
            row = centers[c]
            for q in range(n_nodes):
                away = place[c] - row[q]
                distance[q] += away * away
        for q in range(n_nodes):
            distance[q] *= rates[q]
        _exponentials(distance, n_nodes, bits, powers)
        value = last[n_nodes]
        for q in range(n_nodes):
            value += last[q] * distance[q]
        if not abs(value) <= bound:
            n_good = min(n_good, i)
            value = -bound if value < 0.0 else bound
        y[k] = value
    return n_good
