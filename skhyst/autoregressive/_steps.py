"""One-step models as plain arrays, with compiled loops over their own past outputs.

Each has ``rows(Z)``, the next outputs for rows of lagged signals, and ``run(start, bound)``, the
free run over one record.
"""

from dataclasses import dataclass, fields

import numpy as np

from .._jit import jit
from ..preprocessing import lagged_columns
from ._runs import Lags, clipped

_BLOCK = 16_384  # rows of lagged inputs at a time


class Step:
    """A model with a compiled loop; a subclass gives ``lags``, fields and ``_loop``.

    ``_loop(*fields, inputs, lags, bound, y)`` sees lagged inputs of shape (n, n_inputs), the first
    signals of the model, the lags of its outputs, (n_lags,), the signals after them, and the
    magnitude beyond which outputs are cut off. ``y``, (start + n,), holds the outputs before the
    run; the loop fills the rest.
    """

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
        """Return the next outputs: a run whose signals are all inputs."""
        y = np.empty(len(Z))
        self._fill(np.ascontiguousarray(Z), np.empty(0, dtype=np.int64), np.inf, y)
        return y

    def _fill(self, inputs, lags, bound, y):
        own = [getattr(self, field.name) for field in fields(self)[1:]]
        self._loop(*own, inputs, lags, float(bound), y)


@jit
def linear_run(weights, intercept, inputs, lags, bound, y):
    """Fill ``y`` with ``intercept + weights . signals``; ``weights`` (n_inputs + n_lags,)."""
    n_samples, n_inputs = inputs.shape
    before = len(y) - n_samples
    for i in range(n_samples):
        k = before + i
        value = intercept
        for j in range(n_inputs):
            value += weights[j] * inputs[i, j]
        for j in range(len(lags)):
            value += weights[n_inputs + j] * y[k - lags[j]]
        y[k] = clipped(value, bound)


@dataclass(frozen=True)
class LinearStep(Step):
    """``y = intercept + weights . signals``."""

    lags: Lags
    weights: np.ndarray
    intercept: float

    _loop = staticmethod(linear_run)
