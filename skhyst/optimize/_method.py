"""What every identification method is, and how it reports."""

import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

__all__ = ["Method", "restrict", "search_box"]

_DECADES = 1.5  # beyond the starting values of a positive parameter without bounds
_REACH = 2.0  # beyond those of any other, in their own size


@dataclass(frozen=True, kw_only=True)
class Method(ABC):
    """Base of the identification methods.

    Parameters
    ----------
    bounds : mapping of str to (float, float), optional
        Bounds of parameters by name, in their own units, within the model's own.
    random_state : int or None, default=0
        Seed. The default gives the same result each time.
    callback : callable, optional
        Called with the number of evaluations and the sum of squares after each improvement; a
        true value ends the search, and the best solution so far is kept.
    verbose : int, default=0
        Above 0, improvements are written to the standard error stream.
    """

    bounds: Mapping | None = None
    random_state: int | None = 0
    callback: Callable | None = None
    verbose: int = 0

    @abstractmethod
    def solve(self, problems):
        """Solve the first of several problems that differ in their starting values.

        Parameters
        ----------
        problems : sequence of OperatorProblem

        Returns
        -------
        problem : OperatorProblem
            The one whose structure the solution has.
        solution : Solution
        n_evaluations : int
            Simulations of all records.
        """

    def _report(self, n_evaluations, cost):
        if self.verbose:
            print(
                f"[{type(self).__name__}] {n_evaluations} evaluations, sum of squares {cost:.6g}",
                file=sys.stderr,
                flush=True,
            )
        return self.callback is not None and self.callback(n_evaluations, cost)


def restrict(problem, bounds):
    """Narrow the bounds of a problem.

    Raises
    ------
    ValueError
        If a name is no parameter of the problem, or the bounds leave nothing.
    """
    for name, (low, high) in (bounds or {}).items():
        if name not in problem.names:
            raise ValueError(
                f"The 'bounds' name '{name}', which is not among the free parameters: "
                f"{', '.join(problem.names)}."
            )
        i = problem.names.index(name)
        if problem.log[i]:
            with np.errstate(divide="ignore"):
                low, high = np.log(max(low, 0.0)), np.log(max(high, 0.0))
        problem.lower[i], problem.upper[i] = max(problem.lower[i], low), min(problem.upper[i], high)
        if not problem.lower[i] < problem.upper[i]:
            raise ValueError(f"The 'bounds' of '{name}' leave no value that the model allows.")


def search_box(problems):
    """Return finite lower and upper limits of the unknowns, in the problem's coordinates.

    Limits of the model or the user stand where they are finite. Elsewhere the box reaches beyond
    the starting values: by decades for a positive parameter, else by the change that moves the
    response by its own size.
    """
    first = problems[0]
    same = [p for p in problems if p.names == first.names]
    starts = np.clip([p.x0 for p in same], first.lower, first.upper)
    blocks = first.evaluate(starts[0])
    power = np.diag(first.total(blocks))[:-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        natural = np.sqrt(first.scale / power)
    natural = np.where(np.isfinite(natural), natural, 1.0)
    reach = np.maximum(_REACH * np.abs(starts).max(axis=0), natural)
    reach = np.where(first.log, _DECADES * np.log(10.0), reach)
    lower = np.where(np.isfinite(first.lower), first.lower, starts.min(axis=0) - reach)
    upper = np.where(np.isfinite(first.upper), first.upper, starts.max(axis=0) + reach)
    return lower, np.maximum(upper, lower)
