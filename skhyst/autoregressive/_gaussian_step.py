"""Networks of Gaussian nodes that see their own past outputs.

``y = last[-1] + sum_q last[q] exp(rates[q] |x S - c_q|^2)`` of the signals x.
"""

from dataclasses import dataclass

import numpy as np

from .._jit import jit
from ._network_step import exponentials
from ._runs import Lags, clipped
from ._steps import Step

__all__ = ["GaussianStep"]


@jit(fastmath={"contract", "reassoc", "nsz"})
def gaussian_run(scaling, centers, rates, last, inputs, lags, bound, y):
    """Run a network over its past outputs; see :class:`GaussianStep`."""
    (n_samples, n_inputs), (n_signals, n_components) = inputs.shape, scaling.shape
    before, n_nodes = len(y) - n_samples, len(rates)
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
        exponentials(distance, n_nodes, bits, powers)
        value = last[n_nodes]
        for q in range(n_nodes):
            value += last[q] * distance[q]
        y[k] = clipped(value, bound)


@dataclass(frozen=True)
class GaussianStep(Step):
    """Gaussian nodes, and a linear output."""

    lags: Lags
    scaling: np.ndarray  # (n_signals, n_components): the matrix S
    centers: np.ndarray  # (n_components, n_nodes): in scaled signals
    rates: np.ndarray  # (n_nodes,): -1 / (2 sigma^2)
    last: np.ndarray  # (n_nodes + 1,): weights of the output and, at the end, its constant

    _loop = staticmethod(gaussian_run)
