"""Methods that move a population of candidates: the box, the objective, the budget, the polish."""

from abc import abstractmethod
from dataclasses import dataclass, replace
from math import gamma

import numpy as np
from scipy.optimize import differential_evolution

from ._variable_projection import (
    CANCELLED,
    Method,
    Solution,
    eliminate,
    restrict,
    search_box,
    variable_projection,
)

_LEVY = 1.5  # exponent of the flights
# Mantegna, *Physical Review E*, 1994; Xie et al. (2023), (8)
_SIGMA = (
    gamma(1.0 + _LEVY)
    * np.sin(0.5 * np.pi * _LEVY)
    / (gamma(0.5 * (1.0 + _LEVY)) * _LEVY * 2.0 ** (0.5 * (_LEVY - 1.0)))
) ** (1.0 / _LEVY)


class _Finished(Exception):
    """Raised when the budget is used up, or the callback has ended the search."""


@dataclass(frozen=True, kw_only=True)
class PopulationMethod(Method):
    """Base of the stochastic methods with a population of candidates.

    Parameters
    ----------
    population : int, default=50
        Number of candidates.
    max_iterations : int, default=300
        Budget of iterations.
    max_evaluations : int or None, default=None
        Budget of simulations of all records; the iterations alone limit them by default.
    project : bool, default=True
        Parameters that enter linearly are solved exactly for each candidate. Otherwise they are
        searched like the others, as Xie et al. (2023) do.
    polish : bool, default=True
        The best candidate is refined by variable projection.
    bounds : mapping of str to (float, float), optional
        Bounds of parameters by name, in their own units, within the model's own. Without them the
        search is confined to a box around the model's starting values.
    """

    population: int = 50
    max_iterations: int = 300
    max_evaluations: int | None = None
    project: bool = True
    polish: bool = True

    @abstractmethod
    def _search(self, objective, lower, upper, rng):
        """Call ``objective`` with candidates (n, d) within the box until the iterations are done.

        ``objective`` returns their sums of squares and remembers the best candidate.
        """

    def solve(self, problems):
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
            solution = Solution(objective.best, gram[-1, -1], gram, 1, True, message)
        n_evaluations += solution.n_evaluations
        shifted = [(objective.n_evaluations + 1 + n, cost) for n, cost in solution.history]
        solution = replace(solution, history=objective.history + shifted)
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
        x = self.best.copy()  # its linear part has the magnitude of the solution
        x[self.searched] = candidate
        gram = self.problem.total(self.problem.evaluate(x, jacobian=self.method.project))
        self.n_evaluations += 1
        if not np.isfinite(gram).all():
            return np.inf
        if self.method.project:
            x, gram, more = eliminate(self.problem, x, gram, CANCELLED)
            self.n_evaluations += more
        cost = gram[-1, -1]
        if cost < self.least:
            self.least, self.best = cost, x
            self.history.append((self.n_evaluations, cost))
            if self.method._report(self.n_evaluations, cost):
                raise _Finished
        return cost


@dataclass(frozen=True, kw_only=True)
class DifferentialEvolution(PopulationMethod):
    """Differential evolution, SciPy's, in batches.

    See Storn and Price, *Journal of Global Optimization*, 1997.

    Parameters
    ----------
    strategy : str, default="best1bin"
        See :func:`scipy.optimize.differential_evolution`.
    mutation : float or (float, float), default=(0.5, 1.0)
        See :func:`scipy.optimize.differential_evolution`.
    recombination : float, default=0.7
        See :func:`scipy.optimize.differential_evolution`.
    tolerance : float, default=0.0
        Relative spread of the population at which the search ends; 0 uses all iterations.

    See Also
    --------
    VariableProjection : The default method, by derivatives.
    """

    strategy: str = "best1bin"
    mutation: float | tuple = (0.5, 1.0)
    recombination: float = 0.7
    tolerance: float = 0.0

    def _search(self, objective, lower, upper, rng):
        n, d = max(self.population, 5), len(lower)
        cells = rng.permuted(np.tile(np.arange(n), (d, 1)), axis=1).T  # a Latin hypercube
        unit = (cells + rng.random((n, d))) / n
        differential_evolution(
            lambda x: objective(x.T),
            list(zip(lower, upper, strict=True)),
            strategy=self.strategy,
            maxiter=self.max_iterations,
            init=lower + unit * (upper - lower),
            mutation=self.mutation,
            recombination=self.recombination,
            tol=self.tolerance,
            rng=rng,
            polish=False,
            updating="deferred",
            vectorized=True,
        )


@dataclass(frozen=True, kw_only=True)
class ParticleSwarm(PopulationMethod):
    """Particle swarm with the settings of Xie et al. (2023), section 4.2.

    See Kennedy and Eberhart, *IEEE International Conference on Neural Networks*, 1995.

    Parameters
    ----------
    inertia : (float, float), default=(0.9, 0.1)
        At the first and at the last iteration; linear between.
    acceleration : float, default=1.5
        Towards the best position of the particle, and towards that of the swarm.

    See Also
    --------
    VariableProjection : The default method, by derivatives.
    """

    inertia: tuple = (0.9, 0.1)
    acceleration: float = 1.5

    def _search(self, objective, lower, upper, rng):
        shape = self.population, len(lower)
        x = rng.uniform(lower, upper, shape)
        velocity = np.zeros(shape)
        best_positions, best_costs = x.copy(), objective(x)
        for inertia in np.linspace(*self.inertia, self.max_iterations):
            leader = best_positions[np.argmin(best_costs)]
            velocity = (
                inertia * velocity
                + self.acceleration * rng.random(shape) * (best_positions - x)
                + self.acceleration * rng.random(shape) * (leader - x)
            )
            inside = np.clip(x + velocity, lower, upper)
            velocity[inside != x + velocity] = 0.0  # the boundary stops a particle
            x = inside
            cost = objective(x)
            better = cost < best_costs
            best_positions[better], best_costs[better] = x[better], cost[better]


@dataclass(frozen=True, kw_only=True)
class _Cuckoos(PopulationMethod):
    """The cuckoo searches; a subclass gives probability and step by the progress, 0 to 1."""

    renewal: str = "walk"

    def __post_init__(self):
        if self.renewal not in ("random", "walk"):
            raise ValueError(
                f"The 'renewal' parameter of {type(self).__name__} must be 'random' or 'walk'. "
                f"Got {self.renewal!r} instead."
            )

    @abstractmethod
    def _schedule(self, progress):
        """Return the probability of discovery and the factor of the step."""

    def _search(self, objective, lower, upper, rng):
        shape = self.population, len(lower)
        nests = rng.uniform(lower, upper, shape)
        costs = objective(nests)

        def settle(trials):
            trials = np.clip(trials, lower, upper)
            trial_costs = objective(trials)
            better = trial_costs < costs
            nests[better], costs[better] = trials[better], trial_costs[better]

        for iteration in range(self.max_iterations):
            discovery, step = self._schedule((iteration + 1) / self.max_iterations)
            flight = _SIGMA * rng.normal(size=shape) / np.abs(rng.normal(size=shape)) ** (1 / _LEVY)
            settle(nests + step * flight * (nests - nests[np.argmin(costs)]))
            if self.renewal == "walk":
                discovered = rng.random(shape) < discovery
                walk = nests[rng.permutation(len(nests))] - nests[rng.permutation(len(nests))]
                settle(nests + discovered * rng.random((len(nests), 1)) * walk)
            else:
                is_discovered = rng.random(len(nests)) < discovery
                is_discovered[np.argmin(costs)] = False
                nests[is_discovered] = rng.uniform(lower, upper, (is_discovered.sum(), len(lower)))
                costs[is_discovered] = objective(nests[is_discovered])


@dataclass(frozen=True, kw_only=True)
class CuckooSearch(_Cuckoos):
    r"""Cuckoo search (Yang and Deb 2009).

    See Yang and Deb, *World Congress on Nature and Biologically Inspired Computing*, 2009, and
    Yang and Deb, *Neural Computing and Applications*, 2014; Xie et al., *Smart Materials and
    Structures*, 2023.

    In each iteration every nest flies, :math:`x + s\,u / |v|^{1/\beta}\,(x - x_{best})` with normal
    u and v, and stays there if that is better; then nests are discovered.

    Parameters
    ----------
    renewal : {"random", "walk"}, default="walk"
        Treatment of a discovered nest. ``"random"``: it is replaced, whatever its cost, by a random
        one in the box, as in Yang and Deb (2009) and Xie et al. (2023), step 5; each nest but the
        best is discovered with probability p. ``"walk"``: it moves by the difference of two other
        nests if that improves it, as in Yang and Deb (2014); each coordinate is discovered with
        probability p.
    discovery : float, default=0.25
        Probability p.
    step : float, default=1.0
        Factor s.

    Raises
    ------
    ValueError
        If ``renewal`` is invalid.

    See Also
    --------
    ModifiedCuckooSearch : Discovery and step change while it runs.
    VariableProjection : The default method, by derivatives.
    """

    discovery: float = 0.25
    step: float = 1.0

    def _schedule(self, progress):
        return self.discovery, self.step


@dataclass(frozen=True, kw_only=True)
class ModifiedCuckooSearch(_Cuckoos):
    r"""Cuckoo search whose discovery and step fall while it runs (Xie et al. 2023, (5) to (10)).

    .. math::
       p = p_{min} + (p_{max} - p_{min}) e^{-5 (t/T)^3}, \qquad
       s = s_{max} (s_{min} / s_{max})^{t/T}

    Parameters
    ----------
    renewal : {"random", "walk"}, default="random"
        As in :class:`CuckooSearch`. ``"random"`` is step 5 of Xie et al. (2023); ``"walk"`` comes
        closer to the least error with the same number of iterations.
    discovery_range : (float, float), default=(0.0, 1.0)
        Least and largest probability.
    step_range : (float, float), default=(0.5, 2.0)
        Least and largest factor.

    Raises
    ------
    ValueError
        If ``renewal`` is invalid.

    See Also
    --------
    CuckooSearch : Constant discovery and step.
    """

    renewal: str = "random"
    discovery_range: tuple = (0.0, 1.0)
    step_range: tuple = (0.5, 2.0)

    def _schedule(self, progress):
        (least, most), (short, long) = self.discovery_range, self.step_range
        discovery = least + (most - least) * np.exp(-5.0 * progress**3)
        return discovery, long * (short / long) ** progress
