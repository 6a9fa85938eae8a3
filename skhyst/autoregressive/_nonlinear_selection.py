"""Term selection for models whose error is a nonlinear function of the coefficients.

The fit of a subset of terms and the search for a better subset alternate: the Jacobian of all
candidates at the solution and the error, condensed, are a linear problem, whose best subset is
fitted next. Gauss-Newton steps are damped (Levenberg-Marquardt), on condensed data. The Jacobian of
a diverged run does not show how to return; such a run is first pulled towards the measured
response, by a fraction that is reduced to zero in steps.

An equation with longer lags than the true one can be the true one multiplied by a common factor: a
linear combination of the true equation and its own past. The free run is the same for any factor,
except that a factor with a pole near the unit circle can fit noise. No single removal leads from
there to the true equation, so subsets are tried too that lack the longest-lagged of the terms that
are shifts in time of each other.
"""

import warnings
from typing import Any, NamedTuple

import numpy as np

from ..exceptions import ConvergenceWarning
from ._problems import initial_basis
from ._selection import Search, condense, condense_folds, subset_solution

_TOLERANCE = 1e-10  # predicted relative decrease of the sum of squares at which a fit stops
_ROUGH = 1e-5  # the same while subsets are compared
_EVALUATIONS = 150  # of the final fit
_FEW = 10  # evaluations of an intermediate fit
_PULLS = (0.5, 0.2, 0.05)  # fractions by which a diverged run is pulled to the measured response
_SIZES = (3, 6, 12)  # numbers of terms to start from if the chosen subset is unstable
_ROUNDS = 10  # of search and fit


class _State(NamedTuple):
    """A fitted subset of the terms, with all unknowns, and the search around it."""

    subset: list
    theta: np.ndarray
    search: Search
    value: Any
    converged: bool


def improve(problem, search, n_terms):
    """Return the best subset, its unknowns, the search on the Jacobian there, the number of runs.

    It starts from the search of the linear problem one step ahead. ``n_terms`` is None where the
    criterion decides.
    """
    fits = _Fits(problem, search.criterion, n_terms)
    state = min(fits.begin(search), key=lambda state: state.value)
    for _ in range(_ROUNDS):
        for other in fits.trials(state):
            if other.value < state.value:
                state = other
                break
        else:
            break
    state = fits.settle(state.subset, state.theta[: len(state.subset)], rough=False)
    if not state.converged:
        warnings.warn(
            "The fit of NARMAXRegressor has not converged; the best fit so far is returned.",
            ConvergenceWarning,
            stacklevel=5,
        )
    return state.subset, state.theta, state.search, fits.n_evaluations


class Descent:
    """Damped Gauss-Newton steps on a problem; counts its evaluations."""

    def __init__(self, problem):
        self.problem = problem
        self.n_evaluations = 0

    def descend(self, subset, theta, pull, budget, tolerance):
        """Take damped Gauss-Newton steps from ``theta``; return the end and if it has converged."""
        factor = self._condensed(subset, theta, pull)
        if not np.isfinite(factor).all():
            return theta, False
        last, damping, growth, k = self.n_evaluations + budget - 1, 1e-6, 2.0, len(theta)
        scale = sum(float(start.measured @ start.measured) for start in self.problem.starts)
        while self.n_evaluations < last:
            r, target = factor[:k, :k], factor[:k, -1]
            cost = float(np.sum(factor[:, -1] ** 2))
            weights = np.sqrt(damping) * np.linalg.norm(r, axis=0)
            matrix = np.concatenate([r, np.diag(np.where(weights > 0.0, weights, 1.0))])
            norms = np.linalg.norm(matrix, axis=0)
            padded = np.append(target, np.zeros(k))
            step = np.linalg.lstsq(matrix / norms, padded, rcond=None)[0] / norms
            predicted = float(np.sum(target**2) - np.sum((target - r @ step) ** 2))
            if not predicted > tolerance * cost + 1e-28 * scale:
                return theta, True
            # damping by the gain ratio (Nielsen): it falls after a good step and grows ever faster
            # after bad ones
            trial = self._condensed(subset, theta + step, pull)
            gain = cost - float(np.sum(trial[:, -1] ** 2))
            if np.isfinite(trial).all() and gain > 0.0:
                ratio = gain / predicted
                damping = max(damping * max(0.2, 1.0 - (2.0 * ratio - 1.0) ** 3), 1e-14)
                growth = 2.0
                theta, factor = theta + step, trial
            else:
                damping, growth = damping * growth, growth * 2.0
                if damping > 1e12:
                    return theta, True
        return theta, False

    def _condensed(self, subset, theta, pull):
        """Return the condensed Jacobian and error of all records."""
        self.n_evaluations += 1
        blocks, _ = self.problem.blocks(subset, theta, pull)
        return condense(np.column_stack(block) for block in blocks)


class _Fits(Descent):
    """Fits of subsets and the subsets to try next; parameters as in :func:`improve`."""

    def __init__(self, problem, criterion, n_terms):
        super().__init__(problem)
        self.criterion, self.n_terms = criterion, n_terms
        self.shifts = problem.shifts()

    def begin(self, search):
        """Yield states to start from: one, or several where its run has diverged."""
        subset, theta = self._best(search, self.n_terms)
        diverges = self.problem.diverges(subset, theta)
        if diverges and self.n_terms is None:
            for size in _SIZES:  # few terms, mostly linear ones, are often stable
                if size < len(subset):
                    yield self.settle(*self._best(search, size))
        for pull in _PULLS if diverges else ():
            subset, theta = self._best(self.settle(subset, theta, pull).search, self.n_terms)
        yield self.settle(subset, theta)

    def _best(self, search, n_terms):
        subset = search.best(n_terms)
        return subset, subset_solution(search.factor, subset)[0]

    def neighbours(self, state):
        """Yield subsets with a better predicted criterion: the best, then the best single move."""
        best = state.search.best(self.n_terms)
        if set(best) != set(state.subset):
            yield best
        near = state.search.refine(state.subset, sized=self.n_terms is not None, rounds=1)
        if set(near) not in (set(state.subset), set(best)):
            yield near

    def trials(self, state):
        """Yield other subsets, fitted: the neighbours, then those without a common factor.

        A common factor may have replaced a term, so the search is repeated from these.
        """
        for subset in self.neighbours(state):
            yield self.settle(subset, subset_solution(state.search.factor, subset)[0])
        for subset in _shortened(state.subset, self.shifts) if self.n_terms is None else ():
            shortened = self.settle(subset, subset_solution(state.search.factor, subset)[0])
            yield shortened
            yield self.settle(*self._best(shortened.search, None))

    def settle(self, subset, theta, pull=0.0, *, rough=True):
        """Fit a subset, and set up the search around it on the Jacobian of all candidates."""
        problem, n_own, n_terms = self.problem, len(subset), len(self.problem.terms)
        theta, converged = self._solve(subset, theta, pull, rough)
        full = np.concatenate([np.zeros(n_terms), theta[n_own:]])
        full[subset] = theta[:n_own]
        blocks, cost = [], 0.0
        for tangents, error in problem.blocks(range(n_terms), full, pull)[0]:
            cost += float(error @ error)
            # the linearised problem: the target is what all coefficients together have to explain
            target = error + tangents[:, subset] @ full[subset]
            block = np.column_stack([tangents[:, :n_terms], target])
            # initial outputs are unknowns of every subset, so their effect is projected out
            q = initial_basis(tangents[:, n_terms:])
            block -= q @ (q.T @ block)
            blocks.append(block)
        rows, left_out = np.concatenate(blocks), self.criterion.name == "cv"
        folds = condense_folds([len(block) for block in blocks], left_out, rows.__getitem__)
        search = Search(folds, self.criterion)
        if self.n_terms is not None:
            value = (-n_own, cost)
        else:
            value = search.value(subset) if left_out else self.criterion(cost, n_own)
        return _State(list(subset), theta, search, value, converged)

    def _solve(self, subset, coefficients, pull, rough):
        """Return the unknowns that minimise the sum of squares, and whether the fit converged.

        A rough solution is good enough to compare subsets.
        """
        theta = np.array(self.problem.unknowns(np.asarray(coefficients, dtype=float)))
        # a diverged run is pulled to the measured response, less from fit to fit
        if not pull and self.problem.diverges(subset, coefficients):
            for step in _PULLS:
                theta, _ = self.descend(subset, theta, step, _FEW, _ROUGH)
        budget = _FEW if pull else _FEW * 2 if rough else _EVALUATIONS
        return self.descend(subset, theta, pull, budget, _ROUGH if rough else _TOLERANCE)


def _shortened(subset, shifts):
    """Yield a subset without the last, the last two, ... of its terms that are shifts of others."""
    chains = {}
    for column in sorted(subset, key=lambda column: shifts[column][1]):
        chains.setdefault(shifts[column][0], []).append(column)
    for count in range(1, max(map(len, chains.values()), default=1)):
        yield [
            column for chain in chains.values() for column in chain[: max(len(chain) - count, 1)]
        ]
