"""The default method: variable projection from data-driven and random starts."""

from dataclasses import dataclass

import numpy as np

from ._method import Method, restrict, search_box
from ._variable_projection import variable_projection

__all__ = ["VariableProjection"]

_FULL_RUNS = 2  # of many starts, so many are followed to the end
_TRIAL_EVALUATIONS = 4
_KEPT = 0.5  # part of the unknowns that a random start takes from the best solution so far


@dataclass(frozen=True, kw_only=True)
class VariableProjection(Method):
    """Separable least squares with exact derivatives; see :func:`variable_projection`.

    Every start is followed for a few evaluations, the best two to the end.

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
    >>> from skhyst.operators import SecondOrderModeOperator
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
        if len(starts) > _FULL_RUNS:
            trials = []
            for problem, x in starts:
                trial = variable_projection(problem, x, max_evaluations=_TRIAL_EVALUATIONS)
                evaluations += trial.n_evaluations
                trials.append((trial.cost, problem, trial.x))
            trials.sort(key=lambda trial: trial[0])
            starts = [trial[1:] for trial in trials[:_FULL_RUNS]]
        best = None
        for problem, x in starts:
            solution = variable_projection(
                problem,
                x,
                tolerance=self.tolerance,
                max_evaluations=self.max_evaluations,
                callback=self._report,
            )
            evaluations += solution.n_evaluations
            if best is None or solution.cost < best[1].cost:
                best = problem, solution
        return best, evaluations
