"""Cuckoo search, and the tanh paper's modification of it."""

from abc import abstractmethod
from dataclasses import dataclass
from math import gamma

import numpy as np

from ._population import PopulationMethod

__all__ = ["CuckooSearch", "ModifiedCuckooSearch"]

_LEVY = 1.5  # exponent of the flights
# Mantegna (Phys. Rev. E 49, 1994); tanh paper (8)
_SIGMA = (
    gamma(1.0 + _LEVY)
    * np.sin(0.5 * np.pi * _LEVY)
    / (gamma(0.5 * (1.0 + _LEVY)) * _LEVY * 2.0 ** (0.5 * (_LEVY - 1.0)))
) ** (1.0 / _LEVY)


class _Cuckoos(PopulationMethod):
    """The search itself; a subclass gives the probability and the step by progress, 0 to 1."""

    @abstractmethod
    def _schedule(self, progress):
        """Return the probability of discovery and the factor of the step."""

    def _search(self, objective, lower, upper, rng):
        shape = self.population, len(lower)
        nests = rng.uniform(lower, upper, shape)
        costs = objective(nests)

        def settle(places):
            places = np.clip(places, lower, upper)
            found = objective(places)
            better = found < costs
            nests[better], costs[better] = places[better], found[better]

        for iteration in range(self.max_iterations):
            discovery, step = self._schedule((iteration + 1) / self.max_iterations)
            flight = _SIGMA * rng.normal(size=shape) / np.abs(rng.normal(size=shape)) ** (1 / _LEVY)
            settle(nests + step * flight * (nests - nests[np.argmin(costs)]))
            discovered = rng.random(shape) < discovery
            walk = nests[rng.permutation(len(nests))] - nests[rng.permutation(len(nests))]
            settle(nests + discovered * rng.random((len(nests), 1)) * walk)


@dataclass(frozen=True, kw_only=True)
class CuckooSearch(_Cuckoos):
    r"""Cuckoo search (Yang and Deb 2009; tanh paper, section 3.1).

    In each iteration every nest flies, :math:`x + s\,u / |v|^{1/\beta}\,(x - x_{best})` ((5)-(8)),
    with normal u and v; then each coordinate of a nest is discovered with probability p and moves
    by the difference of two other nests. A nest is replaced by a better one only.

    Parameters
    ----------
    discovery : float, default=0.25
        Probability p.
    step : float, default=1.0
        Factor s.
    population, max_iterations, max_evaluations, project, polish
        See :class:`PopulationMethod`. An iteration evaluates every nest twice.
    bounds, random_state, callback, verbose
        See :class:`Method`.
    """

    discovery: float = 0.25
    step: float = 1.0

    def _schedule(self, progress):
        return self.discovery, self.step


@dataclass(frozen=True, kw_only=True)
class ModifiedCuckooSearch(_Cuckoos):
    r"""Cuckoo search whose discovery and step fall while it runs (tanh paper (9), (10)).

    .. math::
       p = p_{min} + (p_{max} - p_{min}) e^{-5 (t/T)^3}, \qquad
       s = s_{max} (s_{min} / s_{max})^{t/T}

    Parameters
    ----------
    discovery_range : (float, float), default=(0.0, 1.0)
        Least and largest probability.
    step_range : (float, float), default=(0.5, 2.0)
        Least and largest factor.
    population, max_iterations, max_evaluations, project, polish
        See :class:`PopulationMethod`.
    bounds, random_state, callback, verbose
        See :class:`Method`.
    """

    discovery_range: tuple = (0.0, 1.0)
    step_range: tuple = (0.5, 2.0)

    def _schedule(self, progress):
        (least, most), (short, long) = self.discovery_range, self.step_range
        discovery = least + (most - least) * np.exp(-5.0 * progress**3)
        return discovery, long * (short / long) ** progress
