r"""Alternating fits of a black box and of the effects behind it.

A black box f gives the prediction :math:`p = f(X)`, effects map it to the response,
:math:`y = E[p]`. E is identified from predictions out of fold, since a flexible f leaves no
residual in the rows that it was trained on. Then the f of each fold is fitted to the response with
the effects removed, :math:`p + d`: d is the change of the prediction that explains the residual
:math:`r = y - E[p]`, which minimises

.. math:: \|r - L d\|^2 + \lambda \|d\|^2

where L is the derivative of E. For an additive effect, d is nearly r, as in backfitting of additive
models (Buja, Hastie and Tibshirani, *Annals of Statistics*, 1989); before a low-pass, frequencies
that it attenuates are restored as far as the noise allows. A linear L reduces the error of p by
:math:`\lambda / (|L|^2 + \lambda)` at each frequency, whatever the phase; with r itself as the
change it would grow where :math:`|1 - L| > 1`, as before a resonance or a long delay.
"""

import warnings
from dataclasses import dataclass

import numpy as np
import pandas as pd
from sklearn.base import clone

from .._validation import fit_weighted, select_rows
from ..exceptions import ExtrapolationWarning
from ..operators import FrozenOperator, Series, SumOperator, propagate
from ._columns import OnColumnOperator, Scaled
from ._scheduled_parameters import Scheduled

_DAMPING = 0.1  # lambda: squared gain of the effects above which they are inverted
_STEPS = 12  # most steps of conjugate gradients
_ENOUGH = 1e-4  # reduction of the gradient at which they stop
_REMEMBERED = 3  # earlier turns that are mixed with the last


def fold_of_rows(slices, cv):
    """Return the fold of each row: whole records, or contiguous blocks of a single one."""
    sizes = [s.n_samples for s in slices]
    if len(slices) > 1:
        return np.repeat(np.arange(len(slices)) % min(cv, len(slices)), sizes)
    bounds = np.linspace(0, sizes[0], cv + 1).astype(int)
    return np.repeat(np.arange(cv), np.diff(bounds))


@dataclass(frozen=True)
class Turn:
    """State after one turn of backfitting.

    Attributes
    ----------
    targets, predictions : ndarray of shape (n_folds, n_samples)
        Targets and predictions of the clone of each fold, for all rows.
    effects : object
        The fitted effects, as returned by ``refit``.
    error : float
        Of the effects driven by the out-of-fold predictions.
    number : int
        Number of the turn.
    """

    targets: np.ndarray
    predictions: np.ndarray
    effects: object
    error: float
    number: int = 0


class Backfitting:
    """A regressor that is fitted once per fold, to the rows outside it.

    Parameters
    ----------
    estimator : estimator
        Clones of it are fitted.
    X : DataFrame or array-like of shape (n_samples, n_inputs)
        Inputs.
    slices : sequence of RecordSlice
        Rows of each record.
    fold : ndarray of int of shape (n_samples,)
        Fold of each row.
    weights : ndarray of shape (n_samples,), default=None
        Weight of each row in the fit of a clone; None: one.
    """

    def __init__(self, estimator, X, slices, fold, weights=None):
        # rows of an index, so that the rows on both sides of a fold are no neighbours
        self._table = X if hasattr(X, "iloc") else pd.DataFrame(X)
        self._estimator, self._X = estimator, X
        self._weights = np.ones(len(fold)) if weights is None else weights
        self._slices, self._fold = slices, fold
        self.n_folds = int(fold.max()) + 1

    def predict(self, targets):
        """Return the predictions (n_folds, n_samples) of clones fitted to a row of targets each.

        Every clone predicts all rows, so that a memory is not cut at the borders of a fold.
        """
        predictions = np.empty_like(targets)
        for k, target in enumerate(targets):
            rows = np.flatnonzero(self._fold != k)
            fitted = self._fitted(select_rows(self._table, rows), target[rows], self._weights[rows])
            with warnings.catch_warnings():  # a fold may exceed the range of the others
                warnings.simplefilter("ignore", ExtrapolationWarning)
                predictions[k] = np.ravel(fitted.predict(self._table))
        return predictions

    def _fitted(self, X, y, weights):
        return fit_weighted(clone(self._estimator), X, y, weights, "Corrected")

    def fitted(self, targets):
        """Return a clone that is fitted to all rows."""
        return self._fitted(self._X, self.merged(targets), self._weights)

    def out_of_fold(self, predictions):
        """Return for each row the prediction of the clone that was not trained on it."""
        return predictions[self._fold, np.arange(len(self._fold))]

    def alternate(self, start, problem_of, refit, folds, turns, least=0.01):
        """Fit the regressor and the effects in turn until the error no longer falls.

        If f can nearly represent the effects, turns converge slowly along the same directions: the
        targets of a few turns are mixed such that the next turn would change them least (Anderson,
        *Journal of the ACM*, 1965).

        Parameters
        ----------
        start : Turn
        problem_of : callable
            Returns the :class:`OperatorProblem` of fitted effects, for a prediction (n_samples,).
        refit : callable
            Takes fitted effects and predictions (n_folds, n_samples); returns the effects fitted to
            these out of fold, and their error.
        folds : sequence of ndarray of bool
            Segments of the problem outside each fold.
        turns : int
            The largest number.
        least : float, default=0.01
            Relative fall of the error that is worth another turn.

        Returns
        -------
        Turn
        """
        best, past = start, []
        for _ in range(turns):
            past = [*past[-_REMEMBERED:], (best.targets, self._renewed(best, problem_of, folds))]
            turn = self._turn(best, _mixed(past), refit)
            if len(past) > 1 and not turn.error < (1.0 - least) * best.error:
                past = past[-1:]
                turn = self._turn(best, past[0][1], refit)
            if not turn.error < (1.0 - least) * best.error:
                break
            best = turn
        return best

    def _turn(self, last, targets, refit):
        predictions = self.predict(targets)
        effects, error = refit(last.effects, predictions)
        return Turn(targets, predictions, effects, error, last.number + 1)

    def _renewed(self, turn, problem_of, folds):
        """Return the response with the effects removed, as targets for the clone of each fold.

        It is computed from the predictions of that clone, so that the data of its fold stay unseen.
        """
        targets = turn.predictions.copy()
        for k, (target, train) in enumerate(zip(targets, folds, strict=True)):
            problem = problem_of(turn.effects, target)
            outputs = problem.predictions(problem.x0, train)
            for s, record, output in zip(self._slices, problem.records, outputs, strict=True):
                residual = np.where(self._fold[s.rows] != k, record.y - output, 0.0)
                if record.weights is not None:
                    residual *= np.minimum(record.weights, 1.0)
                target[s.rows] += explained_change(
                    problem.operator, record, residual, problem.initial_state
                )
        return targets

    def merged(self, targets):
        """Return one target per row: the mean over the clones that were fitted to the row."""
        learned = self._fold != np.arange(self.n_folds)[:, None]
        return np.sum(targets, axis=0, where=learned) / learned.sum(axis=0)


def _mixed(past):
    """Return the mixture of new targets that changes least in a turn."""
    old, new = past[-1]
    if len(past) == 1:
        return new
    change = (new - old).ravel()
    others = np.stack([change - (b - a).ravel() for a, b in past[:-1]], axis=1)
    # turns that change along the same direction are collinear
    weights = np.linalg.lstsq(others, change, rcond=1e-6)[0]
    return new - sum(w * (new - b) for w, (_, b) in zip(weights, past[:-1], strict=True))


def explained_change(operator, record, residual, state="rest"):
    """Return the change of the first column of a record's input that explains the residual.

    Both are (n_samples,); ``operator`` is that of the effects. The damped least-squares problem of
    the module is solved by conjugate gradients, which need L and its adjoint only as functions.
    """
    if record.schedule is not None:
        operator = operator.at(record.schedule)

    def forward(change):
        return _derivative(operator, record.u, change, record.dt, state)

    def adjoint(change):
        return _derivative(operator, record.u, change, record.dt, state, adjoint=True)

    change, unexplained = np.zeros_like(residual), residual
    gradient = adjoint(unexplained)
    direction, size = gradient, gradient @ gradient
    first = size
    for _ in range(_STEPS):
        if not size > _ENOUGH**2 * first:
            break
        moved_output = forward(direction)
        step = size / (moved_output @ moved_output + _DAMPING * (direction @ direction))
        change, unexplained = change + step * direction, unexplained - step * moved_output
        gradient = adjoint(unexplained) - _DAMPING * change
        before, size = size, gradient @ gradient
        direction = gradient + size / before * direction
    return change if np.isfinite(change).all() else np.zeros_like(residual)


def _derivative(operator, u, change, dt, state, adjoint=False):
    """Return the directional derivative of the output along a change of the drive, or its adjoint.

    The adjoint is the derivative of each stage run backwards in time: exact for stages that are
    linear or have no memory.
    """
    if isinstance(operator, FrozenOperator | Scheduled):
        return _derivative(operator.operator, u, change, dt, state, adjoint)
    if operator.is_disturbance:
        return np.zeros_like(change)
    if isinstance(operator, SumOperator):
        parts = (_derivative(s, u, change, dt, state, adjoint) for s in operator.stages)
        return sum(parts, np.zeros_like(change))
    if isinstance(operator, OnColumnOperator):
        if operator.column != 0:
            return np.zeros_like(change)
        drive = np.ascontiguousarray(u[:, 0])
        return _derivative(operator.operator, drive, change, dt, state, adjoint)
    if isinstance(operator, Scaled) and not operator.scales and operator.column != 0:
        factor = operator.factor(u, dt)
        if adjoint:
            return _derivative(operator.operator, u, factor * change, dt, state, True)
        return factor * _derivative(operator.operator, u, change, dt, state)
    if isinstance(operator, Series):
        inputs = [u]
        for stage in operator.stages[:-1]:
            inputs.append(stage.run(inputs[-1], dt, stage.init(inputs[-1][0], state))[0])
        chain = list(zip(operator.stages, inputs, strict=True))
        for stage, drive in reversed(chain) if adjoint else chain:
            change = _derivative(stage, drive, change, dt, state, adjoint)
        return change
    order = slice(None, None, -1 if adjoint else 1)
    drive, dchange = np.ascontiguousarray(u[order]), np.ascontiguousarray(change[order, None])
    start = "zero" if operator.signal_linear else state
    return np.ascontiguousarray(propagate(operator, drive, dchange, dt, start)[1][order, 0])
