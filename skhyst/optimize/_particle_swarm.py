"""Particle swarm."""

from dataclasses import dataclass

import numpy as np

from ._population import PopulationMethod

__all__ = ["ParticleSwarm"]


@dataclass(frozen=True, kw_only=True)
class ParticleSwarm(PopulationMethod):
    """Particle swarm (Kennedy and Eberhart 1995) with the settings of the tanh paper, section 4.2.

    Parameters
    ----------
    inertia : (float, float), default=(0.9, 0.1)
        At the first and at the last iteration; linear between.
    acceleration : float, default=1.5
        Towards a particle's own best place, and towards the swarm's.
    population, max_iterations, max_evaluations, project, polish
        See :class:`PopulationMethod`.
    bounds, random_state, callback, verbose
        See :class:`Method`.
    """

    inertia: tuple = (0.9, 0.1)
    acceleration: float = 1.5

    def _search(self, objective, lower, upper, rng):
        shape = self.population, len(lower)
        x = rng.uniform(lower, upper, shape)
        velocity = np.zeros(shape)
        own, least = x.copy(), objective(x)
        for inertia in np.linspace(*self.inertia, self.max_iterations):
            best = own[np.argmin(least)]
            velocity = (
                inertia * velocity
                + self.acceleration * rng.random(shape) * (own - x)
                + self.acceleration * rng.random(shape) * (best - x)
            )
            inside = np.clip(x + velocity, lower, upper)
            velocity[inside != x + velocity] = 0.0  # a wall stops a particle
            x = inside
            cost = objective(x)
            better = cost < least
            own[better], least[better] = x[better], cost[better]
