"""Differential evolution, as SciPy has it."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import differential_evolution

from ._population import PopulationMethod

__all__ = ["DifferentialEvolution"]


@dataclass(frozen=True, kw_only=True)
class DifferentialEvolution(PopulationMethod):
    """Differential evolution (Storn and Price, J. Global Optim. 11, 1997), SciPy's, in batches.

    Parameters
    ----------
    strategy : str, default="best1bin"
    mutation : float or (float, float), default=(0.5, 1.0)
    recombination : float, default=0.7
        See :func:`scipy.optimize.differential_evolution`.
    tolerance : float, default=0.0
        Relative spread of the population at which the search ends; 0 uses all iterations.
    population, max_iterations, max_evaluations, project, polish
        See :class:`PopulationMethod`.
    bounds, random_state, callback, verbose
        See :class:`Method`.
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
