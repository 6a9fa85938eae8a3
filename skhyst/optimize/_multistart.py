"""The default method: variable projection from data-driven and random starts."""

from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed

from ._method import Method, restrict, search_box
from ._variable_projection import solve_linear, variable_projection

__all__ = ["VariableProjection"]

_FULL_RUNS = 2  # of many starts, so many are followed to the end
_TRIAL_EVALUATIONS = 4
_TRIALS = 4  # of the starts on long records, those that fit best as they are
_LONG = 50_000  # samples
_KEPT = 0.5  # part of the unknowns that a random start takes from the best solution so far


@dataclass(frozen=True, kw_only=True)
class VariableProjection(Method):
    """Separable least squares with exact derivatives; see :func:`variable_projection`.

    Every start is followed for a few evaluations, the best two to the end. On long records (more
    than 50,000 samples) only those are followed that fit best once their linear parameters are
    solved, and starts go side by side in threads, as many as there are processors.

    Parameters
    ----------
    tolerance : float, default=1e-8
        Relative change of the sum of squares at which a run ends.
    max_evaluations : int, default=100
        Budget of a run.
    n_random_starts : int, default=0
        Starts drawn at random within the bounds, in about half of the unknowns each, from the best
        solution that the starts from the data have led to.
    bounds, random_state, callback, verbose
        See :class:`Method`.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import SecondOrderMode
    >>> from skhyst.linear import SecondOrderModeOperator
    >>> from skhyst.optimize import VariableProjection
    >>> drive = np.random.default_rng(0).normal(size=500)
    >>> y, _ = SecondOrderModeOperator(60.0, 0.01).run(drive, 0.01)
    >>> method = VariableProjection(n_random_starts=20, bounds={"damping_ratio": (1e-3, 1.0)})
    >>> model = SecondOrderMode(dt=0.01, method=method).fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.params_['damping_ratio']:.4f}")
    0.0100
    """

    tolerance: float = 1e-8
    max_evaluations: int = 100
    n_random_starts: int = 0

    def solve(self, problems):
        for problem in problems:
            restrict(problem, self.bounds)
        found, evaluations = self._best_of([(problem, problem.x0) for problem in problems])
        if not self.n_random_starts:
            return *found, evaluations
        problem, solution = found
        rng = np.random.default_rng(self.random_state)
        lower, upper = search_box([problem, *(p for p in problems if p is not problem)])
        shape = self.n_random_starts, len(lower)
        drawn = rng.uniform(lower, upper, shape)
        # where a part of the solution is right already, a start that keeps it is worth most
        kept = rng.random(shape) < _KEPT
        starts = [(problem, x) for x in np.where(kept, solution.x, drawn)]
        other, more = self._best_of(starts)
        best = min(found, other, key=lambda pair: pair[1].cost)
        return *best, evaluations + 1 + more

    def _best_of(self, starts):
        """Return the best problem and solution, and the number of evaluations."""
        evaluations = 0
        long = starts[0][0].segment_length.sum() > _LONG
        parallel = Parallel(n_jobs=-1 if long else 1, prefer="threads")
        if long and len(starts) > _TRIALS:
            costs = parallel(delayed(_solved_cost)(problem, x) for problem, x in starts)
            evaluations += len(starts)
            starts = [starts[i] for i in np.argsort(costs, kind="stable")[:_TRIALS]]
        if len(starts) > _FULL_RUNS:
            trials = parallel(
                delayed(variable_projection)(problem, x, max_evaluations=_TRIAL_EVALUATIONS)
                for problem, x in starts
            )
            evaluations += sum(trial.n_evaluations for trial in trials)
            order = np.argsort([trial.cost for trial in trials], kind="stable")[:_FULL_RUNS]
            starts = [(starts[i][0], trials[i].x) for i in order]
        if self.callback is not None or self.verbose:
            parallel = Parallel(n_jobs=1)  # what is reported comes in order
        solutions = parallel(
            delayed(variable_projection)(
                problem,
                x,
                tolerance=self.tolerance,
                max_evaluations=self.max_evaluations,
                callback=self._report,
            )
            for problem, x in starts
        )
        evaluations += sum(solution.n_evaluations for solution in solutions)
        best = min(range(len(starts)), key=lambda i: solutions[i].cost)
        return (starts[best][0], solutions[best]), evaluations


def _solved_cost(problem, x):
    """Return the sum of squares at ``x`` once the linear parameters are solved."""
    gram = problem.total(problem.evaluate(x))
    return solve_linear(problem, x, gram)[1][-1, -1] if np.isfinite(gram).all() else np.inf
