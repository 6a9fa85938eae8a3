"""One-step models as plain arrays, with compiled loops over their own past outputs.

The law of a model is a function ``law(x, at, c) -> y``: its signals are in ``x`` from index ``at``
on, followed by ``room`` numbers of work space, and ``c`` holds its constants. Loops over records
are compiled around it, and so is the compiled step, which can be exported to C.

Each model has ``rows(Z)``, the next outputs for rows of lagged signals, ``run(start, bound)``, the
free run over one record, and ``plain_law()``.
"""

from dataclasses import dataclass, replace

import numpy as np

from .._jit import bind, jit
from ..preprocessing import lagged_columns
from ._runs import Lags, clipped

_BLOCK = 16_384  # rows of lagged inputs at a time


def step(x, at, c):
    """Placeholder of a model's law, which `bind` puts in its place."""
    raise NotImplementedError


def run(c, inputs, lags, bound, y):
    """Fill ``y``, (start + n,), which holds the outputs before the run.

    The signals are lagged ``inputs`` (n, n_inputs) and the outputs with ``lags``. Outputs beyond
    ``bound`` are cut off there. The law must not need work space.
    """
    n_samples, n_inputs = inputs.shape
    before = len(y) - n_samples
    x = np.empty(n_inputs + len(lags))
    for i in range(n_samples):
        k = before + i
        for j in range(n_inputs):
            x[j] = inputs[i, j]
        for j in range(len(lags)):
            x[n_inputs + j] = y[k - lags[j]]
        y[k] = clipped(step(x, 0, c), bound)


class Step:
    """A model with a compiled loop; a subclass gives ``lags``, ``_loop`` and its constants.

    ``_loop`` is :func:`run` bound to a law, or another with its arguments.
    """

    room = 0  # numbers after the signals that the plain law uses as work space
    output_weights = None  # (n_weights,): weights that enter the output linearly, if there are any

    def _constants(self):
        """Return the constants of the loop."""
        raise NotImplementedError

    def plain_law(self):
        """Return the law in plain arithmetic, see :mod:`skhyst.operators`, and its constants."""
        raise NotImplementedError

    def with_output_weights(self, weights):
        """Return the same model with other output weights."""
        raise NotImplementedError

    def output_columns(self, Z):
        """Return the regressors of the output weights, (n, n_weights), for rows of lagged signals.

        The second value are the derivatives of the output by each signal, (n, n_signals).
        """
        raise NotImplementedError

    def run(self, start, bound):
        """Return the free run from a start, and whether all of it stayed within the bound."""
        lags = np.array(self.lags.outputs, dtype=np.int64)
        before, n_samples = len(start.history), len(start.inputs) - start.n_past
        y = np.empty(before + n_samples)
        y[:before] = start.history
        for first in range(0, n_samples, _BLOCK):
            size = min(_BLOCK, n_samples - first)
            at = start.n_past + first
            inputs = lagged_columns(start.inputs, self.lags.inputs, at, at + size)
            self._fill(inputs, lags, bound, y[first : first + before + size])
        y = y[before:]
        return y, bool(-bound < y.min(initial=0.0) and y.max(initial=0.0) < bound)

    def rows(self, Z):
        """Return the next outputs (n,) for rows of lagged signals."""
        y = np.empty(len(Z))
        self._fill(np.ascontiguousarray(Z), np.empty(0, dtype=np.int64), np.inf, y)
        return y

    def _fill(self, inputs, lags, bound, y):
        self._loop(self._constants(), inputs, lags, float(bound), y)


@jit
def linear(x, at, c):
    """Return the output of a linear model; ``c`` is (weights, intercept)."""
    weights, y = c
    for j in range(weights.size):
        y += weights[j] * x[at + j]
    return y


@dataclass(frozen=True)
class LinearStep(Step):
    """``y = intercept + weights . signals``."""

    lags: Lags
    weights: np.ndarray
    intercept: float

    _loop = staticmethod(bind(run, linear))

    def _constants(self):
        return self.weights, float(self.intercept)

    def plain_law(self):
        return linear, self._constants()

    @property
    def output_weights(self):
        return np.append(self.weights, self.intercept)

    def with_output_weights(self, weights):
        return replace(self, weights=weights[:-1].copy(), intercept=float(weights[-1]))

    def output_columns(self, Z):
        return np.column_stack([Z, np.ones(len(Z))]), np.tile(self.weights, (len(Z), 1))
