"""What the population methods share: the box, the objective, the budget, the polish."""

import time
from abc import abstractmethod
from dataclasses import dataclass, replace

import numpy as np

from ._method import Method, restrict, search_box
from ._variable_projection import Solution, solve_linear, variable_projection

__all__ = ["PopulationMethod"]


class _Finished(Exception):
    """The budget is used up, or the callback has ended the search."""


@dataclass(frozen=True, kw_only=True)
class PopulationMethod(Method):
    """Base of the methods that move a population of candidates at random.

    Parameters
    ----------
    population : int, default=50
        Number of candidates.
    max_iterations : int, default=300
    max_evaluations : int or None, default=None
        Budget of simulations of all records; the iterations alone limit them by default.
    project : bool, default=True
        Parameters that enter linearly are solved exactly for each candidate. Otherwise they are
        searched like the others, as the papers do.
    polish : bool, default=True
        The best candidate is refined by variable projection.
    bounds, random_state, callback, verbose
        See :class:`Method`. Without bounds the search is confined to a box around the model's
        starting values.
    """

    population: int = 50
    max_iterations: int = 300
    max_evaluations: int | None = None
    project: bool = True
    polish: bool = True

    @abstractmethod
    def _search(self, objective, lower, upper, rng):
        """Call ``objective`` with candidates (n, d) within the box until the iterations are over.

        It returns their sums of squares and remembers the best candidate.
        """

    def solve(self, problems):
        begin = time.perf_counter()
        for problem in problems:
            restrict(problem, self.bounds)
        problem = problems[0]
        lower, upper = search_box(problems)
        objective = _Objective(problem, self)
        message = "All iterations are done."
        if objective.searched.size:
            searched = objective.searched
            rng = np.random.default_rng(self.random_state)
            try:
                self._search(objective, lower[searched], upper[searched], rng)
            except _Finished:
                message = "The budget is used up, or the callback has ended the search."
        n_evaluations = objective.n_evaluations + 1
        if self.polish or not objective.searched.size:
            solution = variable_projection(problem, objective.best, callback=self._report)
        else:
            gram = problem.total(problem.evaluate(objective.best))
            solution = Solution(objective.best, gram[-1, -1], gram, 1, True, message, 0.0)
        n_evaluations += solution.n_evaluations
        shifted = [(objective.n_evaluations + 1 + n, cost) for n, cost in solution.history]
        solution = replace(
            solution,
            seconds=time.perf_counter() - begin,
            history=objective.history + shifted,
        )
        return problem, solution, n_evaluations


class _Objective:
    """Sums of squares of candidates; remembers the best one and how it was reached."""

    def __init__(self, problem, method):
        self.problem = problem
        self.method = method
        free = ~problem.linear if method.project else np.ones(len(problem.x0), dtype=bool)
        self.searched = np.flatnonzero(free)
        self.best = problem.x0
        self.least = np.inf
        self.n_evaluations = 0
        self.history = []

    def __call__(self, candidates):
        return np.array([self._one(candidate) for candidate in candidates])

    def _one(self, candidate):
        if self.method.max_evaluations is not None and (
            self.n_evaluations >= self.method.max_evaluations
        ):
            raise _Finished
        x = self.problem.x0.copy()
        x[self.searched] = candidate
        gram = self.problem.total(self.problem.evaluate(x, jacobian=self.method.project))
        self.n_evaluations += 1
        if not np.isfinite(gram).all():
            return np.inf
        if self.method.project:
            x, gram = solve_linear(self.problem, x, gram)
        cost = gram[-1, -1]
        if cost < self.least:
            self.least, self.best = cost, x
            self.history.append((self.n_evaluations, cost))
            if self.method._report(self.n_evaluations, cost):
                raise _Finished
        return cost
