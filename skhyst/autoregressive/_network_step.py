"""Feed-forward networks, and networks of Gaussian nodes, with feedback of their past outputs.

Each law is implemented twice: as a loop over a record in SIMD arithmetic, which takes half the
time, and for one sample in plain arithmetic, which needs no arrays of its own and can be exported
to C.
"""

import math
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.special import expit

from .._jit import jit
from ._runs import Lags, clipped
from ._steps import Step

ACTIVATIONS = {"identity": 0, "relu": 1, "logistic": 2, "tanh": 3}

_LARGEST = 700.0  # largest exponent, which does not overflow
_LOG2_E = 1.4426950408889634
_LN2_HIGH = 6.93147180369123816490e-01  # few enough digits that integer multiples are exact
_LN2_LOW = 1.90821492927058770002e-10
_ROUND = 6755399441055744.0  # 1.5 * 2**52: adding it rounds to an integer, in the lowest bits


@jit(fastmath={"contract"})
def exponentials(x, width, bits, powers):
    """Replace ``x[:width]`` by its exponential, exact to the last digits, in SIMD arithmetic.

    ``exp(x) = 2^m exp(r)`` with ``|r| <= ln(2) / 2``, where the Taylor series to the 13th power is
    exact to the last digits. ``bits`` and ``powers`` are views of one buffer, as integers and as
    floats: a number that was rounded by adding ``_ROUND`` has ``m`` in its lowest bits, which are
    shifted into the exponent of a float. The powers of the series are paired, so that fewer
    products depend on each other.
    """
    for i in range(width):
        value = x[i]
        value = value if value > -_LARGEST else -_LARGEST
        value = value if value < _LARGEST else _LARGEST
        shifted = value * _LOG2_E + _ROUND
        powers[i] = shifted
        whole = shifted - _ROUND
        r = (value - whole * _LN2_HIGH) - whole * _LN2_LOW
        r2 = r * r
        r4 = r2 * r2
        low = (1.0 + r) + r2 * (0.5 + r * (1.0 / 6.0))
        mid = (1.0 / 24.0 + r * (1.0 / 120.0)) + r2 * (1.0 / 720.0 + r * (1.0 / 5040.0))
        high = (1.0 / 40320.0 + r * (1.0 / 362880.0)) + r2 * (
            1.0 / 3628800.0 + r * (1.0 / 39916800.0)
        )
        top = 1.0 / 479001600.0 + r * (1.0 / 6227020800.0)
        x[i] = low + r4 * (mid + r4 * (high + r4 * top))
    for i in range(width):
        bits[i] = (bits[i] + 1023) << 52
    for i in range(width):
        x[i] *= powers[i]


@jit(fastmath={"contract"})
def _activate(kind, x, width, bits, powers):
    """Apply an activation to ``x[:width]``; see :func:`exponentials`."""
    if kind == 0:
        return
    if kind == 1:
        for i in range(width):
            x[i] = x[i] if x[i] > 0.0 else 0.0
        return
    factor = -1.0 if kind == 2 else 2.0
    for i in range(width):
        x[i] *= factor
    exponentials(x, width, bits, powers)
    offset, scale = (0.0, 1.0) if kind == 2 else (1.0, -2.0)
    for i in range(width):
        x[i] = offset + scale / (1.0 + x[i])


@jit(fastmath={"contract", "reassoc", "nsz"})
def network_run(c, inputs, lags, bound, y):
    """Run a network over a record, see ``_steps.run``; ``c`` is that of :func:`network`."""
    first, offsets, widths, weights, biases, last, kind = c
    (n_samples, n_inputs), widest = inputs.shape, weights.shape[2]
    before = len(y) - n_samples
    now, after, powers = np.zeros(widest), np.zeros(widest), np.empty(widest)
    bits = powers.view(np.int64)
    for i in range(n_samples):
        k = before + i
        width = widths[0]
        for q in range(width):
            now[q] = offsets[q]
        for j in range(len(first)):
            signal = inputs[i, j] if j < n_inputs else y[k - lags[j - n_inputs]]
            row = first[j]
            for q in range(width):
                now[q] += signal * row[q]
        _activate(kind, now, width, bits, powers)
        for layer in range(len(weights)):
            matrix, n_in = weights[layer], width
            width = widths[layer + 1]
            for q in range(width):
                after[q] = biases[layer, q]
            for p in range(n_in, min(n_in + 3, widest)):
                now[p] = 0.0
            # four rows at a time: the sums are loaded and stored a quarter as often
            for p in range(0, n_in, 4):
                a, b, c, d = now[p], now[p + 1], now[p + 2], now[p + 3]
                row_a, row_b, row_c, row_d = matrix[p], matrix[p + 1], matrix[p + 2], matrix[p + 3]
                for q in range(width):
                    after[q] += (a * row_a[q] + b * row_b[q]) + (c * row_c[q] + d * row_d[q])
            _activate(kind, after, width, bits, powers)
            now, after = after, now
        value = last[width]
        for q in range(width):
            value += now[q] * last[q]
        y[k] = clipped(value, bound)


@jit
def activated(kind, value):
    """Return the output of a unit; see ``ACTIVATIONS``."""
    if kind < 2:
        return max(value, 0.0) if kind == 1 else value
    if kind == 2:
        return 1.0 / (1.0 + math.exp(min(-value, _LARGEST)))
    return 1.0 - 2.0 / (1.0 + math.exp(min(2.0 * value, _LARGEST)))


@jit
def network(x, at, c):
    """Return the output of a network; ``c`` are the fields of :class:`NetworkStep`.

    The work space holds the units of two layers.
    """
    first, offsets, widths, weights, biases, last, kind = c
    n_signals = first.shape[0]
    now, width = at + n_signals, int(widths[0])
    after = now + weights.shape[2]
    for q in range(width):
        value = offsets[q]
        for j in range(n_signals):
            value += x[at + j] * first[j, q]
        x[now + q] = activated(kind, value)
    for layer in range(widths.size - 1):
        n_in, width = width, int(widths[layer + 1])
        for q in range(width):
            value = biases[layer, q]
            for p in range(n_in):
                value += x[now + p] * weights[layer, p, q]
            x[after + q] = activated(kind, value)
        now, after = after, now
    y = last[width]
    for q in range(width):
        y += x[now + q] * last[q]
    return y


def _with_slopes(kind, values):
    """Return the outputs of units, and their derivatives; see ``ACTIVATIONS``."""
    if kind == 0:
        return values, np.ones_like(values)
    if kind == 1:
        return np.maximum(values, 0.0), (values > 0.0).astype(float)
    if kind == 2:
        out = expit(values)
        return out, out * (1.0 - out)
    out = np.tanh(values)
    return out, 1.0 - out**2


class _NodesStep(Step):
    """Base of both, whose constants are their fields; a subclass gives ``_law``."""

    def _constants(self):
        return tuple(getattr(self, field.name) for field in fields(self)[1:])

    def plain_law(self):
        return self._law, self._constants()

    @property
    def output_weights(self):
        return self.last

    def with_output_weights(self, weights):
        return replace(self, last=np.array(weights, dtype=float))


@dataclass(frozen=True)
class NetworkStep(_NodesStep):
    """Layers of units with one activation, and a linear output."""

    lags: Lags
    first: np.ndarray  # (n_signals, widths[0]): weights from the signals to the first hidden layer
    offsets: np.ndarray  # (widths[0],): biases of that layer
    widths: np.ndarray  # (n_layers,): units of each hidden layer
    weights: np.ndarray  # (n_layers - 1, widest, widest): from each hidden layer to the next, one
    # row per unit of the former; zero beyond the widths, widest is a multiple of 4
    biases: np.ndarray  # (n_layers - 1, widest): of the hidden layers after the first
    last: np.ndarray  # (widths[-1] + 1,): weights of the output and, at the end, its bias
    kind: int  # of the hidden layers, see ``ACTIVATIONS``

    _loop = staticmethod(network_run)
    _law = staticmethod(network)

    @property
    def room(self):
        return 2 * self.weights.shape[2]

    def output_columns(self, Z):
        widths, layers = self.widths, []
        values = Z @ self.first + self.offsets
        for layer, width in enumerate(widths):
            if layer:
                matrix = self.weights[layer - 1, : widths[layer - 1], :width]
                values = layers[-1][0] @ matrix + self.biases[layer - 1, :width]
            layers.append(_with_slopes(self.kind, values))
        slopes = self.last[:-1]
        for layer in range(len(widths) - 1, -1, -1):
            slopes = slopes * layers[layer][1]
            if layer:
                slopes = slopes @ self.weights[layer - 1, : widths[layer - 1], : widths[layer]].T
        return np.column_stack([layers[-1][0], np.ones(len(Z))]), slopes @ self.first.T

    @classmethod
    def from_layers(cls, lags, matrices, biases, activation):
        """Arrange the weights (n_in, n_out) and biases of all layers, the last one the output."""
        widths = np.array([matrix.shape[1] for matrix in matrices[:-1]], dtype=np.int64)
        widest = -(-int(widths.max()) // 4) * 4
        inner = np.zeros((len(widths) - 1, widest, widest))
        offsets = np.zeros((len(widths) - 1, widest))
        for layer in range(len(widths) - 1):
            matrix, bias = matrices[layer + 1], biases[layer + 1]
            inner[layer, : matrix.shape[0], : matrix.shape[1]] = matrix
            offsets[layer, : len(bias)] = bias
        last = np.append(matrices[-1][:, 0], biases[-1])
        first = np.ascontiguousarray(matrices[0])
        kind = ACTIVATIONS[activation]
        return cls(lags, first, np.array(biases[0]), widths, inner, offsets, last, kind)


@jit(fastmath={"contract", "reassoc", "nsz"})
def gaussian_run(c, inputs, lags, bound, y):
    """Run a network over a record, see ``_steps.run``; ``c`` is that of :func:`gaussians`."""
    scaling, centers, rates, last = c
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


@jit
def gaussians(x, at, c):
    """Return the output of a network; ``c`` are the fields of :class:`GaussianStep`.

    The work space holds the scaled signals.
    """
    scaling, centers, rates, last = c
    n_signals, n_components = scaling.shape
    place = at + n_signals
    for i in range(n_components):
        x[place + i] = 0.0
        for j in range(n_signals):
            x[place + i] += x[at + j] * scaling[j, i]
    y = last[rates.size]
    for q in range(rates.size):
        distance = 0.0
        for i in range(n_components):
            distance += (x[place + i] - centers[i, q]) ** 2
        y += last[q] * math.exp(rates[q] * distance)
    return y


@dataclass(frozen=True)
class GaussianStep(_NodesStep):
    """``y = last[-1] + sum_q last[q] exp(rates[q] |x S - c_q|^2)`` of the signals x."""

    lags: Lags
    scaling: np.ndarray  # (n_signals, n_components): the matrix S
    centers: np.ndarray  # (n_components, n_nodes): in scaled signals
    rates: np.ndarray  # (n_nodes,): -1 / (2 sigma^2)
    last: np.ndarray  # (n_nodes + 1,): weights of the output and, at the end, its constant

    _loop = staticmethod(gaussian_run)
    _law = staticmethod(gaussians)

    @property
    def room(self):
        return self.scaling.shape[1]

    def output_columns(self, Z):
        places = Z @ self.scaling
        away = [place[:, None] - row for place, row in zip(places.T, self.centers, strict=True)]
        nodes = np.exp(self.rates * sum(np.square(part) for part in away))
        parts = 2.0 * nodes * self.rates * self.last[:-1]
        back = np.column_stack([np.sum(parts * part, axis=1) for part in away])
        return np.column_stack([nodes, np.ones(len(Z))]), back @ self.scaling.T
