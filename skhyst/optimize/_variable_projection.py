r"""Separable least squares from normal equations.

The parameters x = (theta, c) minimise ``|r(theta, c)|^2`` where r is affine in c. Golub and
Pereyra, *SIAM Journal on Numerical Analysis*, 1973, eliminate c; with the simplification of
Kaufman, *BIT*, 1975, the step in theta equals that of a Gauss-Newton step in all of x, followed by
the exact solution for c (Ruhe and Wedin, *SIAM Review*, 1980, algorithm 3). That is what is done
here, damped as by Levenberg and Marquardt with the update of Nielsen, *Damping Parameter in
Marquardt's Method*, 1999, within bounds that an active-set method keeps.

An iteration, or a fold of a cross-validation, only needs the Gram matrix of the columns ``[J, r]``,
summed over segments of the data. One pass over the records gives it, so memory does not grow with
their length and a fold costs no further pass. SciPy's ``least_squares`` is not used because it
needs the Jacobian itself.
"""

import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Self

import numpy as np
from joblib import Parallel, delayed

from .._documentation import inherit_documentation
from ._bounded_step import bounded_step

_LARGEST_LOG_STEP = 1.5  # a positive parameter changes by at most a factor e^1.5 per step
CANCELLED = 1e-10  # fraction of the sum of squares below which rounding errors matter
STALE = 0.1  # reduction by the linear solution at which the Jacobian is evaluated again
_DECADES = 1.5  # of the search box beyond the starting values of a positive parameter
_REACH = 2.0  # of the search box beyond the starting values of other parameters, in their magnitude
_FULL_RUNS = 2  # starts that are followed to convergence
_TRIAL_EVALUATIONS = 4
_TRIALS = 4  # starts that are followed on long records: those of lowest cost
_LONG = 50_000  # samples
_KEPT = 0.5  # fraction of the unknowns that a random start takes from the best solution so far
_PARTS_OF_STEP = (1.0, 0.25, 0.06)  # that are tried of a single step
_NEAREST = 0.01  # least distance of a start from the best solution it is drawn around, relative


@dataclass
class Solution:
    """Result of one run of a solver, in the coordinates of the problem."""

    x: np.ndarray
    cost: float
    gram: np.ndarray
    n_evaluations: int
    converged: bool
    message: str
    history: list = field(default_factory=list)
    damping: list = field(default_factory=list)  # one value per entry of the history, if recorded
    predicted_cost: float = np.inf  # cost that the next step is predicted to reach, if there is one


class _Nielsen:
    """Damping by the ratio of the actual to the predicted reduction of the last step."""

    value, largest = 1e-4, 1e12
    shorter = 0.5  # length of a step relative to a refused one: damping increases until then
    _factor = 2.0

    def accepted(self, ratio):
        self.value = max(self.value * max(1.0 / 5.0, 1.0 - (2.0 * ratio - 1.0) ** 3), 1e-12)
        self._factor = 2.0

    def refused(self):
        self.value *= self._factor
        self._factor *= 2.0


def variable_projection(
    problem,
    x0,
    *,
    select=None,
    blocks=None,
    begun=None,
    tolerance=1e-8,
    max_evaluations=100,
    callback=None,
    project=True,
    **options,
):
    """Minimise the sum of squares of a problem.

    Parameters
    ----------
    problem : OperatorProblem
        Gives ``evaluate(x, select=select)``, ``total(blocks, select)``, ``lower``, ``upper``,
        ``linear``, ``log``.
    x0 : ndarray of shape (n,)
        Start; its linear part is irrelevant if the problem determines it.
    select : ndarray of bool of shape (n_segments,), optional
        The segments to fit; all by default.
    blocks : ndarray, optional
        ``problem.evaluate(x0, select=select)`` where it is known already.
    begun : Solution, optional
        What :func:`start_descent` returns for x0, where it is known already.
    tolerance : float, default=1e-8
        Stops when a step is predicted to reduce, or has reduced, the sum of squares by less than
        this fraction.
    max_evaluations : int, default=100
        Budget of simulations of all records.
    callback : callable, optional
        Called with the number of evaluations and the cost after each accepted step; a true value
        ends the search.
    project : bool, default=True
        Solve the linear parameters exactly after each step, not only at the start.
    **options
        ``damping``, an object with a ``value``, its ``largest``, methods ``accepted`` and
        ``refused`` that change it after a step, and the fraction ``shorter`` of its length that the
        step after a refused one may have, by default Nielsen's; ``max_steps`` that reduce the cost;
        ``goal``, fraction of the power of the response at which to stop.

    Returns
    -------
    Solution
    """
    if begun is None:
        solution = start_descent(problem, x0, select, blocks)
    else:  # a copy, since it is changed
        solution = replace(begun, history=[*begun.history], damping=[], predicted_cost=np.inf)
    if not solution.message:
        if project and problem.linear.all():
            solution.converged = True
            solution.message = "All parameters are linear and were solved exactly."
        else:
            limits = tolerance, max_evaluations
            _descend(problem, solution, limits, callback, (select, project), **options)
    solution.predicted_cost = min(solution.predicted_cost, solution.cost)
    return solution


def start_descent(problem, x0, select=None, blocks=None):
    """Return the solution that a descent starts from: ``x0`` with its linear parameters solved."""
    x = np.clip(np.asarray(x0, dtype=float), problem.lower, problem.upper)
    gram = problem.total(problem.evaluate(x, select=select) if blocks is None else blocks, select)
    solution = Solution(x, gram[-1, -1], gram, int(blocks is None), False, "")
    if not np.isfinite(gram).all():
        solution.cost, solution.n_evaluations = np.inf, 1
        solution.message = "The model is not finite at the starting values."
        return solution
    # the columns of the other parameters were evaluated with the linear ones of the start
    solution.x, gram, more = eliminate(problem, x, gram, 1.0 - STALE, select)
    solution.n_evaluations += more
    solution.gram, solution.cost = gram, gram[-1, -1]
    solution.history.append((solution.n_evaluations, solution.cost))
    return solution


def _descend(problem, solution, limits, callback, how, *, damping=None, max_steps=np.inf, goal=0.0):
    """Take damped steps until none reduces the sum of squares noticeably."""
    damping = damping or _Nielsen()
    tolerance, max_evaluations = limits
    solution.damping.append(damping.value)
    longest = np.inf
    while not solution.message:
        cost = solution.cost
        # of a perfect fit, the sum of squares is rounding, which no step reduces by a fraction
        enough = tolerance * cost + 1e-28 * problem.scale
        if solution.n_evaluations >= max_evaluations or len(solution.history) > max_steps:
            solution.message = f"The budget of {min(max_evaluations, max_steps)} is used up."
            _, predicted = damped_step(problem, solution.x, solution.gram, damping.value)
            solution.predicted_cost = cost - predicted
        elif goal > 0.0 and cost <= goal * problem.scale:
            solution.converged, solution.message = True, "The goal is reached."
        else:
            step, predicted = damped_step(problem, solution.x, solution.gram, damping.value)
            if not predicted > enough:
                solution.converged = True
                solution.message = "No step reduces the sum of squares noticeably."
                break
            length = np.sqrt(step @ (np.diag(solution.gram)[:-1] * step))
            # a step about as long as a refused one costs an evaluation and is refused again
            if length > longest and damping.value <= damping.largest:
                damping.refused()
                continue
            x, gram, more = _tried(problem, solution.x + step, *how)
            solution.n_evaluations += more
            gain = cost - gram[-1, -1] if np.isfinite(gram).all() else -np.inf
            if not gain > 0.0:
                damping.refused()
                longest = damping.shorter * length
                if damping.value > damping.largest:
                    solution.converged = True
                    solution.message = "No step reduces the sum of squares."
                continue
            damping.accepted(gain / predicted)
            longest = np.inf
            solution.x, solution.gram, solution.cost = x, gram, gram[-1, -1]
            solution.history.append((solution.n_evaluations, solution.cost))
            solution.damping.append(damping.value)
            if callback is not None and callback(solution.n_evaluations, solution.cost):
                solution.message = "The callback has ended the search."
            elif gain <= enough:
                solution.converged = True
                solution.message = "The sum of squares no longer changes."


def _tried(problem, x, select, project):
    """Return x within the bounds, the Gram matrix there, and the number of evaluations."""
    x = np.clip(x, problem.lower, problem.upper)
    gram = problem.total(problem.evaluate(x, select=select), select)
    if not (project and np.isfinite(gram).all()):
        return x, gram, 1
    x, gram, more = eliminate(problem, x, gram, CANCELLED, select)
    return x, gram, 1 + more


def damped_step(problem, x, gram, damping=0.0):
    """Return the damped step from ``x`` and the predicted reduction of the sum of squares."""
    hessian, gradient = gram[:-1, :-1], gram[:-1, -1]
    reach = np.where(problem.log, _LARGEST_LOG_STEP, np.inf)
    damped = hessian.copy()
    damped.ravel()[:: len(damped) + 1] *= 1.0 + damping
    step = bounded_step(
        damped,
        gradient,
        np.maximum(problem.lower - x, -reach),
        np.minimum(problem.upper - x, reach),
    )
    return step, -(2.0 * gradient @ step + step @ hessian @ step)


def start_descent_and_predict(problem, x):
    """Return :func:`start_descent` at ``x`` with the attribute :func:`predicted_cost`."""
    solution = start_descent(problem, x)
    if np.isfinite(solution.gram).all():
        _, reduction = damped_step(problem, solution.x, solution.gram)
        solution.predicted_cost = max(solution.cost - reduction, 0.0)
    return solution


def predicted_cost(problem, x):
    """Return the sum of squares that one Gauss-Newton step from ``x`` is predicted to reach.

    The linear parameters are solved first; it is infinite where the model is not finite.
    """
    return start_descent_and_predict(problem, x).predicted_cost


def single_step(problem, x, blocks, select):
    """Return the solution for some segments, one Gauss-Newton step from the solution for all.

    No derivatives are evaluated. A step that does not reduce the sum of squares is shortened; if
    that does not help either, the solution for all segments is returned.

    Parameters
    ----------
    problem : OperatorProblem
    x : ndarray of shape (n,)
        Solution for all segments.
    blocks : ndarray
        ``problem.evaluate(x)``, for all or for the selected segments.
    select : ndarray of bool of shape (n_segments,)
        The segments to fit.

    Returns
    -------
    ndarray of shape (n,)
    """
    gram = problem.total(blocks, select)
    if not np.isfinite(gram).all():
        return x
    step, _ = damped_step(problem, x, gram)
    for part in _PARTS_OF_STEP:
        trial = np.clip(x + part * step, problem.lower, problem.upper)
        if problem.linear.all():
            return trial  # exact
        reached = problem.evaluate(trial, jacobian=False, select=select)
        if problem.total(reached, select)[-1, -1] <= gram[-1, -1]:
            return trial
    return x


def solve_linear(problem, x, gram):
    """Solve the linear parameters exactly; return the solution and the Gram matrix there."""
    if not problem.linear.any():
        return x, gram
    index = np.flatnonzero(problem.linear)
    step = np.zeros(len(x) + 1)
    step[index] = bounded_step(
        gram[np.ix_(index, index)],
        gram[index, -1],
        (problem.lower - x)[index],
        (problem.upper - x)[index],
    )
    step[-1] = 1.0
    moved = gram.copy()
    moved[:, -1] = gram @ step
    moved[-1, :] = moved[:, -1]
    moved[-1, -1] = max(step @ gram @ step, 0.0)
    return np.clip(x + step[:-1], problem.lower, problem.upper), moved


def eliminate(problem, x, gram, part, select=None):
    """Solve the linear parameters exactly; evaluate again if the cost falls below ``part`` of it.

    At a distant start, such as a gain of 1 in other units, rounding errors may exceed the response:
    then the linear parameters are solved again.
    """
    n_evaluations = 0
    while True:
        before = gram[-1, -1]
        x, gram = solve_linear(problem, x, gram)
        if gram[-1, -1] >= part * before:
            return x, gram, n_evaluations
        gram = problem.total(problem.evaluate(x, select=select), select)
        n_evaluations += 1
        if not problem.scale < gram[-1, -1] < part * before:
            return x, gram, n_evaluations


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

    See Also
    --------
    VariableProjection : The default method.
    identify : Run a method.
    """

    bounds: Mapping | None = None
    random_state: int | None = 0
    callback: Callable | None = None
    verbose: int = 0

    def __init_subclass__(cls, **options):
        super().__init_subclass__(**options)
        inherit_documentation(cls)

    def get_params(self, deep=True) -> dict:
        """Return the parameters by name, as scikit-learn reads them.

        Parameters
        ----------
        deep : bool, default=True
            Ignored: no parameter has parameters of its own.

        Returns
        -------
        dict
        """
        return {parameter.name: getattr(self, parameter.name) for parameter in fields(self)}

    def set_params(self, **params) -> Self:
        """Set parameters, as a search over ``method__max_evaluations`` does.

        Parameters
        ----------
        **params : dict
            By name.

        Returns
        -------
        self

        Raises
        ------
        ValueError
            If a name is no parameter.
        """
        known = self.get_params()
        for name in params:
            if name not in known:
                raise ValueError(
                    f"The parameters of {type(self).__name__} are {', '.join(known)}. Got "
                    f"{name!r} instead."
                )
        vars(self).update(vars(replace(self, **params)))  # checked as the constructor does
        return self

    @abstractmethod
    def solve(self, problems):
        """Solve the first of several problems that differ in their starting values.

        Parameters
        ----------
        problems : sequence of OperatorProblem
            What is minimised: ``evaluate``, ``total``, ``x0``, ``lower``, ``upper``, ``linear``.

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

    Finite limits of the model or the user are kept. Otherwise the box extends beyond the starting
    values: by decades for a positive parameter, else by the change that moves the response by its
    own size.
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


def random_starts(box, linear, bases, count, random_state):
    """Return starts (count, n) in a search box, each with about half of a base.

    Part of a solution may be right already: starts that keep it are most often successful. Bases
    (k, n) are drawn at random, the first as often as all others together.
    """
    rng = np.random.default_rng(random_state)
    shape = count, len(linear)
    drawn = rng.uniform(*box, shape)
    kept = rng.random(shape) < _KEPT
    kept[kept[:, ~linear].all(axis=1)] = False  # the linear ones are solved anyway
    if len(bases) > 1:
        others = rng.integers(1, len(bases), count)
        bases = np.asarray(bases)[np.where(rng.random(count) < 0.5, 0, others)]
    return np.where(kept, bases, drawn)


def starts_near(box, base, count, random_state):
    """Return starts (count, n) between a base (n,) and values drawn from a search box.

    The distance from the base is random, too, uniform in its logarithm.
    """
    rng = np.random.default_rng(random_state)
    drawn = rng.uniform(*box, (count, len(base)))
    return base + np.exp(rng.uniform(np.log(_NEAREST), 0.0, (count, 1))) * (drawn - base)


@dataclass(frozen=True, kw_only=True)
class VariableProjection(Method):
    """Separable least squares with exact derivatives: variable projection.

    Each step is a Gauss-Newton step in all parameters, damped and within their bounds, followed by
    the exact solution for those that enter linearly.

    Every start is followed for a few evaluations, the best two to convergence. On long records
    (more than 50,000 samples) only those starts are followed that fit best after their linear
    parameters are solved, in as many parallel threads as there are processors.

    Parameters
    ----------
    tolerance : float, default=1e-8
        Relative change of the sum of squares at which a run ends.
    max_evaluations : int, default=100
        Budget of a run.
    n_random_starts : int, default=0
        Further starts around the best solution found from the data, with about half of the unknowns
        drawn at random within the bounds.

    See Also
    --------
    LevenbergMarquardt : All parameters in one damped step.
    DifferentialEvolution : A global method, for costs that are not smooth.

    References
    ----------
    Golub and Pereyra, *SIAM Journal on Numerical Analysis*, 1973; Ruhe and Wedin, *SIAM Review*,
    1980, algorithm 3; damping: Nielsen, *Damping Parameter in Marquardt's Method*, 1999.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import SecondOrderMode, SecondOrderModeOperator
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
        alternatives = [p for p in problems if p is not problem]
        box = search_box([problem, *alternatives])
        drawing = self.n_random_starts, self.random_state
        drawn = random_starts(box, problem.linear, [solution.x], *drawing)
        other, more = self._best_of([(problem, x) for x in drawn])
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
            budget = min(_TRIAL_EVALUATIONS, self.max_evaluations)
            trials = parallel(
                delayed(variable_projection)(problem, x, max_evaluations=budget)
                for problem, x in starts
            )
            evaluations += sum(trial.n_evaluations for trial in trials)
            order = np.argsort([trial.cost for trial in trials], kind="stable")[:_FULL_RUNS]
            starts = [(starts[i][0], trials[i].x) for i in order]
        if self.callback is not None or self.verbose:
            parallel = Parallel(n_jobs=1)  # so that reports are in order
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
    """Return the sum of squares at ``x`` after the linear parameters are solved."""
    gram = problem.total(problem.evaluate(x))
    return solve_linear(problem, x, gram)[1][-1, -1] if np.isfinite(gram).all() else np.inf
