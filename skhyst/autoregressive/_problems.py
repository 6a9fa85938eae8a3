r"""Polynomial models whose error is no linear function of their coefficients, and their fit.

The error of a free run depends on the coefficients through all earlier outputs, that of a model
with noise terms through all earlier errors. Both are recursions of the same kernel, which gives the
exact Jacobian: of the run over :math:`y`, or of

.. math:: e(k) = y(k) - \hat y(u, y, e), \qquad e(k < 0) = 0

with the measured outputs as further inputs. With all noise coefficients at zero the tangents of the
noise terms are the earlier errors themselves, so that one step from there is an iteration of
extended least squares; iterated to the end it is the prediction-error method, whose covariance is
the inverse of the Gram matrix of the tangents.

A problem gives, for a subset of the candidate terms, the Jacobian of the prediction and the error
of each record. Gauss-Newton steps are damped as by Levenberg and Marquardt, on condensed data.
"""

from typing import NamedTuple

import numpy as np
from numpy.polynomial.polynomial import polyval

from ..preprocessing._lagged_features import write_lags
from ._polynomial_loops import plan_polynomial, polynomial_run, polynomial_tangents
from ._runs import bounded
from ._selection import condense
from ._starts import rest_outputs
from ._terms import term_products

__all__ = ["PULLS", "FreeRunProblem", "InnovationProblem", "RecordPart", "innovations", "solve"]

_TOLERANCE = 1e-10  # part of the sum of squares that a further step must promise
_ROUGH = 1e-5  # the same while subsets are compared
_EVALUATIONS = 150
_FEW = 10  # on the way
PULLS = (0.5, 0.2, 0.05)  # of the run towards the measurement, before it is let go
_SPLIT = 1e-8  # distance from an integrator at which its resting point is lost


class RecordPart(NamedTuple):
    """One record in scaled units, as in ``Start``; ``measured`` begins after the past."""

    inputs: np.ndarray
    n_past: int
    history: np.ndarray
    measured: np.ndarray


class InnovationProblem:
    """Prediction one step ahead with noise terms.

    Parameters
    ----------
    terms : ndarray of int, shape (n_terms, degree)
        Candidates: factors are inputs, then outputs, then errors.
    lags : tuple of (input_lags, output_lags, noise_lags)
    parts : list of RecordPart
    bound : float
        Magnitude at which errors are cut off.
    """

    n_extra = 0

    def __init__(self, terms, lags, parts, bound):
        self.terms, self.lags, self.parts, self.bound = terms, lags, parts, bound

    def start(self, coefficients):
        """Return the vector of unknowns that belongs to coefficients."""
        return coefficients

    def lost(self, subset, coefficients):
        """Whether the errors have left the data: they have a way back of their own."""
        return False

    def blocks(self, subset, theta, pull=0.0):
        """Return Jacobian and error of each record, and whether none was cut off."""
        plan = error_plan(self.terms[list(subset)], self.lags, self.parts[0].inputs.shape[1])
        coefficients = np.append(1.0, -np.asarray(theta))
        out, good = [], True
        for part in self.parts:
            signals, n_past = error_inputs(part)
            error, tangents, n_good = polynomial_tangents(
                plan,
                coefficients,
                signals,
                np.zeros(plan.start),
                np.zeros((plan.start, len(coefficients))),
                self.bound,
                n_past,
            )
            out.append((tangents[:, 1:], error))
            good &= n_good == len(error)
        return out, good


def error_plan(terms, lags, n_columns):
    """Return the plan of the recursion of the errors; its first term is the measured output."""
    input_lags, output_lags, noise_lags = lags
    inputs = [*input_lags, *((n_columns, lag) for lag in output_lags), (n_columns, 0)]
    table = np.full((len(terms) + 1, terms.shape[1]), -1, dtype=np.int64)
    table[0, 0] = len(inputs) - 1
    table[1:] = terms + (terms >= len(inputs) - 1)
    return plan_polynomial(table, inputs, noise_lags, n_columns + 1)


def error_inputs(part):
    """Return inputs and outputs of a record side by side, and how many rows lie before it."""
    n_before = len(part.history)
    n_past = max(n_before, part.n_past)
    first = part.history[0] if n_before else 0.0
    past = np.append(np.full(n_past - n_before, first), part.history)
    inputs = np.concatenate([np.repeat(part.inputs[:1], n_past - part.n_past, axis=0), part.inputs])
    return np.column_stack([inputs, np.append(past, part.measured)]), n_past


def innovations(terms, coefficients, lags, part, bound, horizon):
    """Return the prediction ``horizon`` steps ahead of a model with noise terms.

    Errors that lie ahead of the last measured output are expected to be zero, and so are those
    before the record.

    Returns
    -------
    y : ndarray of shape (n_samples,)
    good : bool
        Whether nothing was cut off.
    """
    plan = error_plan(terms, lags, part.inputs.shape[1])
    signals, n_past = error_inputs(part)
    initial = np.zeros(plan.start)
    errors, n_good = polynomial_run(
        plan, np.append(1.0, -coefficients), signals, initial, bound, n_past
    )
    good = n_good == len(errors)
    if horizon == 1:
        return part.measured - errors, good
    input_lags, output_lags, noise_lags = lags
    rows, before = len(errors), len(part.history)
    inputs = np.empty((rows, len(input_lags)))
    write_lags(part.inputs, input_lags, inputs, part.n_past)
    # runs[j] has the predictions j steps ahead, after the outputs before the record
    runs = [np.append(part.history, part.measured)]
    errors = np.append(np.zeros(max(noise_lags)), errors)
    for step in range(1, min(horizon, rows) + 1):
        past = [runs[max(step - lag, 0)][before - lag :][:rows] for lag in output_lags]
        noise = [
            errors[max(noise_lags) - lag :][:rows] if lag >= step else np.zeros(rows)
            for lag in noise_lags
        ]
        values = term_products(np.column_stack([inputs, *past, *noise]), terms) @ coefficients
        values, whole = bounded(values, bound)
        good &= whole
        runs.append(np.append(part.history, values))
    return runs[-1][before:], good


class FreeRunProblem:
    """Free run of the model.

    Parameters
    ----------
    terms, parts, bound
        As for :class:`InnovationProblem`.
    lags : tuple of (input_lags, output_lags)
    line : tuple of (float, ndarray), optional
        Intercept and slopes of the guess of the output at rest; where given, each record starts at
        rest.
    limits : tuple of float
        Least and largest output.
    free : bool
        Whether the outputs before each record are unknowns too.
    """

    def __init__(self, terms, lags, parts, bound, *, line=None, limits=(-1.0, 1.0), free=False):
        self.terms, self.lags, self.parts, self.bound = terms, lags, parts, bound
        self.line, self.limits = line, limits
        self.n_before = max(lags[1], default=0)
        self.n_extra = self.n_before * len(parts) if free else 0

    def start(self, coefficients):
        """Return the vector of unknowns that belongs to coefficients."""
        if not self.n_extra:
            return coefficients
        return np.concatenate([coefficients, *(part.history for part in self.parts)])

    def lost(self, subset, coefficients):
        """Whether the run is cut off, or worse than a constant."""
        blocks, good = self.blocks(subset, self.start(np.asarray(coefficients, dtype=float)))
        measured = np.concatenate([part.measured for part in self.parts])
        error = np.concatenate([error for _, error in blocks])
        return not good or error @ error > np.sum((measured - measured.mean()) ** 2)

    def blocks(self, subset, theta, pull=0.0):
        """Return Jacobian and error of each record, and whether none was cut off."""
        terms = self.terms[list(subset)]
        plan = plan_polynomial(terms, *self.lags, self.parts[0].inputs.shape[1])
        n_terms = len(terms)
        coefficients = theta[:n_terms]
        rests = self._rests(terms, coefficients) if self.line is not None else None
        out, good = [], True
        for i, part in enumerate(self.parts):
            history = part.history
            d_history = np.zeros((self.n_before, n_terms + self.n_extra))
            if self.n_extra:
                own = n_terms + i * self.n_before + np.arange(self.n_before)
                history = theta[own]
                d_history[:, own] = np.eye(self.n_before)
            elif rests is not None:
                history = np.full(self.n_before, rests[i])
                d_history[:, :n_terms] = self._rest_tangents(plan, coefficients, part, history)
            y, tangents, n_good = polynomial_tangents(
                plan,
                coefficients,
                part.inputs,
                history,
                d_history,
                self.bound,
                part.n_past,
                part.measured,
                pull,
            )
            out.append((tangents, part.measured - y))
            good &= n_good == len(y)
        return out, good

    def _rests(self, terms, coefficients):
        """Return the output at rest under the first inputs of each record."""
        firsts = np.array([part.inputs[0] for part in self.parts])
        n_inputs = len(self.lags[0])
        inputs = firsts[:, [column for column, _ in self.lags[0]]]
        # at rest all outputs are one, and the next one is a polynomial in it for each record
        products = term_products(inputs, np.where(terms < n_inputs, terms, -1)) * coefficients
        powers = np.sum(terms >= n_inputs, axis=1)
        rising = np.stack(
            [products[:, powers == power].sum(axis=1) for power in range(terms.shape[1] + 1)]
        )
        return rest_outputs(
            lambda Z: polyval(Z[:, 1], rising[:, Z[:, 0].astype(int)], tensor=False),
            np.arange(len(firsts))[:, None],
            1,
            self.line[0] + firsts @ self.line[1],
            *self.limits,
        )

    def _rest_tangents(self, plan, coefficients, part, history):
        """Return the derivatives of the output at rest: those of an implicit function."""
        if not self.n_before:
            return 0.0
        d_history = np.zeros((self.n_before, len(coefficients) + 1))
        d_history[:, -1] = 1.0
        y, dy, _ = polynomial_tangents(plan, coefficients, part.inputs[:1], history, d_history)
        gap = 1.0 - dy[0, -1]
        span = self.limits[1] - self.limits[0]
        if abs(gap) < _SPLIT or abs(y[0] - history[0]) > _SPLIT * max(span, abs(y[0])):
            return 0.0
        return dy[0, :-1] / gap


def join(blocks):
    """Return the condensed Jacobian and error of all records."""
    return condense(np.column_stack(block) for block in blocks)


def solve(problem, subset, coefficients, pull=0.0, *, rough=False):
    """Minimise the sum of squares over the coefficients of a subset.

    A ``rough`` solution is good enough to compare subsets.

    Returns
    -------
    theta : ndarray
        Coefficients, then the further unknowns of the problem.
    converged : bool
    n_evaluations : int
    """
    theta = np.array(problem.start(np.asarray(coefficients, dtype=float)))
    n_evaluations = 0
    if not pull and problem.lost(subset, coefficients):
        for step in PULLS:
            theta, _, more = _descend(problem, subset, theta, step, _FEW, _ROUGH)
            n_evaluations += more
    theta, converged, more = _descend(
        problem,
        subset,
        theta,
        pull,
        _FEW if pull else _FEW * 2 if rough else _EVALUATIONS,
        _ROUGH if rough else _TOLERANCE,
    )
    return theta, converged, n_evaluations + more


def _descend(problem, subset, theta, pull, budget, tolerance):
    factor = join(problem.blocks(subset, theta, pull)[0])
    n_evaluations, damping, growth = 1, 1e-6, 2.0
    k = len(theta)
    scale = sum(float(part.measured @ part.measured) for part in problem.parts)
    while n_evaluations < budget:
        r, target = factor[:k, :k], factor[:k, -1]
        cost = float(np.sum(factor[:, -1] ** 2))
        weights = np.sqrt(damping) * np.linalg.norm(r, axis=0)
        matrix = np.concatenate([r, np.diag(np.where(weights > 0.0, weights, 1.0))])
        norms = np.linalg.norm(matrix, axis=0)
        step = (
            np.linalg.lstsq(matrix / norms, np.append(target, np.zeros(k)), rcond=None)[0] / norms
        )
        predicted = cost - float(np.sum((factor[:, -1][:k] - r @ step) ** 2))
        predicted -= float(np.sum(factor[k:, -1] ** 2))
        if not predicted > tolerance * cost + 1e-28 * scale:
            return theta, True, n_evaluations
        trial = join(problem.blocks(subset, theta + step, pull)[0])
        n_evaluations += 1
        gain = cost - float(np.sum(trial[:, -1] ** 2))
        if np.isfinite(trial).all() and gain > 0.0:
            ratio = gain / predicted
            damping = max(damping * max(0.2, 1.0 - (2.0 * ratio - 1.0) ** 3), 1e-14)
            growth = 2.0
            theta, factor = theta + step, trial
        else:
            damping, growth = damping * growth, growth * 2.0
            if damping > 1e12:
                return theta, True, n_evaluations
    return theta, False, n_evaluations
