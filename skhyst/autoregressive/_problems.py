r"""Polynomial models whose error is a nonlinear function of their coefficients.

The error of a free run depends on the coefficients through all earlier outputs, that of a model
with noise terms through all earlier errors. Both are recursions of the same kernel, which gives the
exact Jacobian: of the free run :math:`y`, or of

.. math:: e(k) = y(k) - \hat y(u, y, e), \qquad e(k < 0) = 0

with the measured outputs as further inputs. With all noise coefficients at zero the tangents of the
noise terms are the earlier errors themselves, so that one step from there is an iteration of
extended least squares; iterated to convergence it is the prediction-error method, whose covariance
is the inverse of the Gram matrix of the tangents.

A problem gives, for a subset of the candidate terms, the Jacobian of the prediction and the error
of each record. All values are in scaled units.
"""

import numpy as np

from ..preprocessing import lagged_columns
from ._initial_outputs import is_equilibrium, rest_outputs
from ._polynomial import (
    PolynomialStep,
    plan_polynomial,
    polynomial_run,
    polynomial_tangents,
    term_products,
)
from ._runs import bounded


class InnovationProblem:
    """Prediction one step ahead with noise terms: factors are inputs, then outputs, then errors.

    ``starts`` are records with their measured outputs; errors are cut off at ``bound``.
    """

    n_extra = 0

    def __init__(self, terms, lags, noise_lags, starts, bound):
        self.terms, self.lags, self.noise_lags = terms, lags, noise_lags
        self.starts, self.bound = starts, bound

    def shifts(self):
        """Return the pattern of each candidate term up to a shift in time, and that shift."""
        return _shifts(self.terms, self.lags, self.noise_lags)

    def unknowns(self, coefficients):
        """Return the vector of unknowns for the coefficients."""
        return coefficients

    def diverges(self, subset, coefficients):
        """Return False: measured outputs keep the errors from diverging for good."""
        return False

    def blocks(self, subset, theta, pull=0.0):
        """Return Jacobian and error of each record, and whether none was cut off."""
        plan = _error_plan(self.terms[list(subset)], self.lags, self.noise_lags)
        coefficients = np.append(1.0, -np.asarray(theta))
        before = np.zeros(plan.start), np.zeros((plan.start, len(coefficients)))
        out, good = [], True
        for start in self.starts:
            signals, n_past = _error_inputs(start)
            error, tangents, within = polynomial_tangents(
                plan, coefficients, signals, *before, self.bound, n_past
            )
            out.append(start.weighted(tangents[:, 1:], error))
            good &= within
        return out, good


def initial_basis(tangents):
    """Return an orthonormal basis of the effects of the initial outputs, those in ``tangents``."""
    return np.linalg.qr(tangents[:, np.any(tangents != 0.0, axis=0)])[0]


def _shifts(terms, lags, noise_lags=()):
    """Return (pattern, shift) of each term: factors with lags from 0 on, and the shortest lag."""
    factors = [*lags.inputs, *((-1, lag) for lag in lags.outputs), *((-2, n) for n in noise_lags)]
    patterns = []
    for term in terms:
        members = [factors[i] for i in term if i >= 0]
        shift = min((lag for _, lag in members), default=0)
        patterns.append((tuple(sorted((signal, lag - shift) for signal, lag in members)), shift))
    return patterns


def _error_plan(terms, lags, noise_lags):
    """Return the plan of the recursion of the errors; its first term is the measured output."""
    n = lags.n_columns
    inputs = [*lags.inputs, *((n, lag) for lag in lags.outputs), (n, 0)]
    table = np.full((len(terms) + 1, terms.shape[1]), -1, dtype=np.int64)
    table[0, 0] = len(inputs) - 1
    table[1:] = terms + (terms >= len(inputs) - 1)
    return plan_polynomial(table, inputs, noise_lags, n + 1)


def _error_inputs(start):
    """Return inputs and outputs of a record as columns, and the number of rows before it."""
    n_before = len(start.history)
    n_past = max(n_before, start.n_past)
    first = start.history[0] if n_before else 0.0
    past = np.append(np.full(n_past - n_before, first), start.history)
    rest = np.repeat(start.inputs[:1], n_past - start.n_past, axis=0)
    inputs = np.concatenate([rest, start.inputs])
    return np.column_stack([inputs, np.append(past, start.measured)]), n_past


def innovations(terms, coefficients, lags, noise_lags, start, bound, horizon):
    """Return the prediction ``horizon`` steps ahead of a model with noise terms.

    Errors after the last measured output and before the record are assumed to be zero. The second
    value is whether no output was cut off.
    """
    plan = _error_plan(terms, lags, noise_lags)
    signals, n_past = _error_inputs(start)
    errors, good = polynomial_run(
        plan, np.append(1.0, -coefficients), signals, np.zeros(plan.start), bound, n_past
    )
    if horizon == 1:
        return start.measured - errors, good
    rows, before, oldest = len(errors), len(start.history), max(noise_lags)
    inputs = lagged_columns(start.inputs, lags.inputs, start.n_past)
    # runs[j] has the predictions j steps ahead, after the outputs before the record
    runs = [np.append(start.history, start.measured)]
    errors = np.append(np.zeros(oldest), errors)
    for step in range(1, min(horizon, rows) + 1):
        past = [runs[max(step - lag, 0)][before - lag :][:rows] for lag in lags.outputs]
        noise = [errors[oldest - lag :][:rows] * (lag >= step) for lag in noise_lags]
        values = term_products(np.column_stack([inputs, *past, *noise]), terms) @ coefficients
        values, within = bounded(values, bound)
        good &= within
        runs.append(np.append(start.history, values))
    return runs[-1][before:], good


class FreeRunProblem:
    """Free run of the model; where ``free``, the outputs before each record are unknowns too.

    ``line`` is (intercept, slopes) of the guess of the output at rest; if it is given, each record
    starts at rest. ``limits`` are the smallest and the largest output.
    """

    def __init__(self, terms, lags, starts, bound, *, line=None, limits=(-1.0, 1.0), free=False):
        self.terms, self.lags, self.starts, self.bound = terms, lags, starts, bound
        self.line, self.limits = line, limits
        self.n_before = max(lags.outputs, default=0)
        self.n_extra = self.n_before * len(starts) if free else 0

    def shifts(self):
        """Return the pattern of each candidate term up to a shift in time, and that shift."""
        return _shifts(self.terms, self.lags)

    def unknowns(self, coefficients):
        """Return the vector of unknowns for the coefficients, with outputs before each record."""
        if not self.n_extra:
            return coefficients
        return np.concatenate([coefficients, *(start.history for start in self.starts)])

    def diverges(self, subset, coefficients):
        """Return whether the free run is cut off, or worse than a constant."""
        blocks, good = self.blocks(subset, self.unknowns(np.asarray(coefficients, dtype=float)))
        measured = np.concatenate([start.measured for start in self.starts])
        counts = np.concatenate([start.counts() for start in self.starts])
        error = np.concatenate([error for _, error in blocks])
        centred = measured - np.average(measured, weights=counts)
        return not good or error @ error > counts @ centred**2

    def blocks(self, subset, theta, pull=0.0):
        """Return Jacobian and error of each record, and whether none was cut off."""
        terms = self.terms[list(subset)]
        n_terms, n_before = len(terms), self.n_before
        coefficients = theta[:n_terms]
        step = PolynomialStep(self.lags, terms, coefficients)
        rests = self._rests(step) if self.line is not None else None
        out, good = [], True
        for i, start in enumerate(self.starts):
            history = start.history
            d_history = np.zeros((n_before, n_terms + self.n_extra))
            if self.n_extra:
                columns = n_terms + i * n_before + np.arange(n_before)
                history, d_history[:, columns] = theta[columns], np.eye(n_before)
            elif rests is not None:
                history = np.full(n_before, rests[i])
                d_history[:] = self._rest_tangents(step, start, history)
            initial = history, d_history, self.bound, start.n_past, start.measured, pull
            model = step.plan, coefficients
            y, tangents, within = polynomial_tangents(*model, start.inputs, *initial)
            out.append(start.weighted(tangents, start.measured - y))
            good &= within
        return out, good

    def rows(self, subset, theta):
        """Yield the rows of each record for :func:`~skhyst.optimize.coloured_covariance`."""
        blocks = self.blocks(subset, theta)[0]
        for (tangents, error), start in zip(blocks, self.starts, strict=True):
            basis = initial_basis(tangents[:, len(subset) :])
            jacobian, residual = (
                part - basis @ (basis.T @ part) for part in (tangents[:, : len(subset)], error)
            )
            yield jacobian, residual, basis, start.counts() > 0.0, 1.0

    def _rests(self, step):
        """Return the output at rest for the first inputs of each record."""
        firsts = np.array([start.inputs[0] for start in self.starts])
        inputs = firsts[:, [column for column, _ in self.lags.inputs]]
        guesses = self.line[0] + firsts @ self.line[1]
        return rest_outputs(step.rows, inputs, len(self.lags.outputs), guesses, *self.limits)

    def _rest_tangents(self, step, start, history):
        """Return the derivatives of the output at rest, by the implicit function theorem."""
        if not self.n_before:
            return 0.0
        d_history = np.zeros((self.n_before, len(step.coefficients) + 1))
        d_history[:, -1] = 1.0
        model = step.plan, step.coefficients
        y, dy, _ = polynomial_tangents(*model, start.inputs[:1], history, d_history)
        gain, span = dy[0, -1], self.limits[1] - self.limits[0]
        if not is_equilibrium(history[0], y[0], gain, span):
            return 0.0
        return dy[0, :-1] / (1.0 - gain)
