"""One-step models as plain arrays, with compiled loops over their own past outputs.

Each has ``rows(Z)``, the next outputs for rows of lagged signals, and ``run(start, bound)``, the
free run over one record.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.special import expit

from ..preprocessing._lagged_features import write_lags
from ._gaussian_loops import gaussian_run
from ._polynomial_loops import polynomial_run
from ._recurrent_loops import ACTIVATIONS, linear_run, network_run
from ._terms import term_products
from ._tree_loops import trees_rows, trees_run

__all__ = ["GaussianStep", "Lags", "LinearStep", "NetworkStep", "PolynomialStep", "TreesStep"]

_BLOCK = 4096  # rows of lagged inputs at a time


class Lags(NamedTuple):
    """The signals that a model sees: lagged inputs, then lagged outputs."""

    inputs: tuple  # (column, lag) each
    outputs: tuple
    n_columns: int


class _Step:
    """A model with a compiled loop; a subclass gives ``lags``, ``rows`` and ``_fill``."""

    def run(self, start, bound):
        """Return the free run from a start and the samples before the first that was cut off."""
        before, n_samples = len(start.history), start.n_samples
        lags = np.array(self.lags.outputs, dtype=np.int64)
        y = np.empty(before + n_samples)
        y[:before] = start.history
        n_good = n_samples
        for first in range(0, n_samples, _BLOCK):
            inputs = np.empty((min(_BLOCK, n_samples - first), len(self.lags.inputs)))
            write_lags(start.inputs, self.lags.inputs, inputs, start.n_past + first)
            good = self._fill(inputs, lags, float(bound), y[first : first + before + len(inputs)])
            if good < len(inputs):
                n_good = min(n_good, first + good)
        return y[before:], n_good


@dataclass(frozen=True)
class LinearStep(_Step):
    """``y = intercept + weights . signals``."""

    lags: Lags
    weights: np.ndarray
    intercept: float

    def rows(self, Z):
        return Z @ self.weights + self.intercept

    def _fill(self, inputs, lags, bound, y):
        return linear_run(inputs, self.weights, self.intercept, lags, bound, y)


@dataclass(frozen=True)
class PolynomialStep(_Step):
    """A sum of products of signals."""

    lags: Lags
    terms: np.ndarray
    coefficients: np.ndarray
    plan: tuple

    def rows(self, Z):
        return term_products(Z, self.terms) @ self.coefficients

    def run(self, start, bound):
        return polynomial_run(
            self.plan, self.coefficients, start.inputs, start.history, bound, start.n_past
        )


@dataclass(frozen=True)
class NetworkStep(_Step):
    """Layers of units with one activation, and a linear output; fields as in ``network_run``."""

    lags: Lags
    first: np.ndarray
    offsets: np.ndarray
    widths: np.ndarray
    weights: np.ndarray
    biases: np.ndarray
    last: np.ndarray
    kind: int

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

    def rows(self, Z):
        x = _activate(self.kind, Z @ self.first + self.offsets)
        for layer, (n_in, n_out) in enumerate(pairwise(self.widths)):
            matrix, bias = self.weights[layer, :n_in, :n_out], self.biases[layer, :n_out]
            x = _activate(self.kind, x @ matrix + bias)
        return x @ self.last[:-1] + self.last[-1]

    def _fill(self, inputs, lags, bound, y):
        return network_run(
            inputs,
            self.first,
            self.offsets,
            self.widths,
            self.weights,
            self.biases,
            self.last,
            self.kind,
            lags,
            bound,
            y,
        )


@dataclass(frozen=True)
class GaussianStep(_Step):
    """Gaussian nodes, and a linear output; fields as in ``gaussian_run``."""

    lags: Lags
    scaling: np.ndarray
    centers: np.ndarray
    rates: np.ndarray
    last: np.ndarray

    def rows(self, Z):
        distance = np.zeros((len(Z), len(self.rates)))
        for place, centers in zip((Z @ self.scaling).T, self.centers, strict=True):
            distance += np.square(place[:, np.newaxis] - centers)
        return np.exp(self.rates * distance) @ self.last[:-1] + self.last[-1]

    def _fill(self, inputs, lags, bound, y):
        return gaussian_run(
            inputs, self.scaling, self.centers, self.rates, self.last, lags, bound, y
        )


@dataclass(frozen=True)
class TreesStep(_Step):
    """``offset + factor * sum of trees``; fields as in ``trees_run``."""

    lags: Lags
    nodes: np.ndarray
    roots: np.ndarray
    centre: np.ndarray
    scale: np.ndarray
    single: bool
    offset: float
    factor: float

    def rows(self, Z):
        out = np.empty(len(Z))
        Z = np.ascontiguousarray(Z)
        trees_rows(self.nodes, self.roots, self.centre, self.scale, self.single, Z, out)
        return self.offset + self.factor * out

    def _fill(self, inputs, lags, bound, y):
        return trees_run(
            self.nodes,
            self.roots,
            self.centre,
            self.scale,
            self.single,
            self.offset,
            self.factor,
            inputs,
            lags,
            bound,
            y,
        )


def _activate(kind, x):
    if kind == ACTIVATIONS["relu"]:
        return np.maximum(x, 0.0)
    if kind == ACTIVATIONS["logistic"]:
        return expit(x)
    return np.tanh(x) if kind == ACTIVATIONS["tanh"] else x
