r"""Output weights, those that enter the model linearly, fitted to the free run.

One step ahead :math:`y(k) = \sum_q w_q h_q(x(k))`, where the signals x contain past outputs. In the
free run these are the model's own, so that the derivatives by the weights follow the recursion

.. math:: \frac{dy(k)}{dw} = h(x(k)) + \sum_j \frac{\partial f}{\partial y(k - m_j)}
    \frac{dy(k - m_j)}{dw}

which is exact, and gives Gauss-Newton steps, started from the weights of the one-step fit. The
hidden weights of a network are fixed.
"""

import warnings

import numpy as np

from .._jit import jit
from ..exceptions import ConvergenceWarning
from ..preprocessing import lagged_columns
from ._initial_outputs import is_equilibrium
from ._nonlinear_selection import Descent

_EVALUATIONS, _TOLERANCE = 150, 1e-8  # runs; least predicted relative decrease of the squares


@jit
def propagate_tangents(columns, slopes, lags, before):
    """Turn the direct derivatives ``columns`` (n, n_weights) into tangents of the run, in place.

    ``slopes`` (n, n_lags) are the derivatives by past outputs, ``before`` (start, n_weights) the
    tangents of the initial outputs.
    """
    start = len(before)
    for k in range(len(columns)):
        for j in range(len(lags)):
            at = k - lags[j]
            for q in range(columns.shape[1]):
                past = columns[at, q] if at >= 0 else before[start + at, q]
                columns[k, q] += slopes[k, j] * past


class OutputWeightsProblem:
    """The free run of a model as a function of its output weights."""

    def __init__(self, model, starting_values):
        self.model, self.starting_values = model, starting_values
        self.starts = starting_values()

    def blocks(self, subset, theta, pull=0.0):
        """Return the tangents and the error of each record, and whether no run was cut off."""
        model = self.model
        step = model._step = model._step.with_output_weights(theta)
        lags = np.array(step.lags.outputs, dtype=np.int64)
        out, all_good = [], True
        self.starts = self.starting_values()
        for start in self.starts:
            y, good = step.run(start, model.bound_)
            n_before, all_good = len(start.history), all_good and good
            past = np.append(start.history, y)
            inputs = lagged_columns(start.inputs, step.lags.inputs, start.n_past)
            signals = np.column_stack(
                [inputs, *(past[n_before - lag : len(past) - lag] for lag in lags)]
            )
            columns, slopes = step.output_columns(signals)
            slopes = slopes[:, inputs.shape[1] :]
            cut = np.abs(y) >= model.bound_  # there the output is constant
            columns[cut], slopes[cut] = 0.0, 0.0
            before = np.zeros((n_before, columns.shape[1]))
            if model._start_kind() == "rest" and n_before and len(y):
                before[:] = self._rest_tangents(step, start)
            propagate_tangents(columns, slopes, lags, before)
            out.append(start.weighted(columns, start.measured - y))
        return out, all_good

    def _rest_tangents(self, step, start):
        """Return the derivatives of the output at rest, by the implicit function theorem."""
        first = start.inputs[0, [column for column, _ in step.lags.inputs]]
        level = start.history[-1]
        signals = np.append(first, np.full(len(step.lags.outputs), level))[None]
        columns, slopes = step.output_columns(signals)
        gain = slopes[0, len(first) :].sum()
        if not is_equilibrium(level, step.rows(signals)[0], gain, self.model._span()):
            return 0.0
        return columns[0] / (1.0 - gain)


def fit_output_weights(model, starting_values):
    """Fit the output weights of ``model._step`` to the free run; return the number of runs."""
    problem = OutputWeightsProblem(model, starting_values)
    descent = Descent(problem)
    with np.errstate(over="ignore", invalid="ignore"):  # a step to a diverging run is rejected
        theta, converged = descent.descend(
            None, model._step.output_weights, 0.0, _EVALUATIONS, _TOLERANCE
        )
    model._step = model._step.with_output_weights(theta)
    if not converged:
        warnings.warn(
            "The fit of NARXRegressor to the free run has not converged; the best fit so far is "
            "returned.",
            ConvergenceWarning,
            stacklevel=6,
        )
    return descent.n_evaluations
