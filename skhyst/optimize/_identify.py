"""The front door of identification: starts, method, uncertainties, one result object."""

import time
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.linalg import norm

from ..operators import split_disturbances
from ._bounded_step import bounded_step
from ._levenberg_marquardt import LevenbergMarquardt
from ._population import CuckooSearch, DifferentialEvolution, ModifiedCuckooSearch, ParticleSwarm
from ._problem import OperatorProblem
from ._standard_errors import FEWEST, coloured_covariance
from ._variable_projection import VariableProjection

METHODS = {
    "variable_projection": VariableProjection,
    "differential_evolution": DifferentialEvolution,
    "particle_swarm": ParticleSwarm,
    "cuckoo_search": CuckooSearch,
    "modified_cuckoo_search": ModifiedCuckooSearch,
    "levenberg_marquardt": LevenbergMarquardt,
}

_SILENT = 1e-13  # of the response
_LOST = np.sqrt(np.finfo(float).tiny / np.finfo(float).eps)  # below it squares lose their digits
NOISELESS = 1e-8  # part of the response's power that is no noise, but what numbers are rounded to
_STIFF = 1e10  # of what the data determine, beside what they do not
_ROUNDING = 1e-6  # part of the linear unknowns that is no change of them
_SINGULAR = 1e-11  # relative eigenvalue of the scaled normal equations


@dataclass(frozen=True)
class IdentificationResult:
    """Result of identification.

    Parameters
    ----------
    operator : Operator
        The driven part, identified.
    disturbances : tuple of DisturbanceOperator
        Additive disturbances; coefficients are the mean over records.
    params : dict of str to float
        Values in their own units.
    record_coefficients : ndarray of shape (n_records, n_coefficients)
        Of the disturbances.
    error : float
        Root mean square of the residual, samples counted by their weights; units of the response.
    n_evaluations : int
        Simulations of all records.
    seconds : float
        Time that it took.
    converged : bool
        Whether it ended before its budget was used up.
    message : str
        Why it ended.
    history : list of (int, float)
        Evaluations and sum of squares after each accepted step.
    x : ndarray
        The solution in the coordinates of the problem.
    params_std : dict of str to float
        Standard errors, whatever the colour of the noise; NaN for a value at its bound. No errors,
        and nothing that follows from them, where they were not asked for.
    params_std_white : dict of str to float, default={}
        Standard errors if the noise is white.
    undetermined : tuple of str
        Parameters that the data do not determine.
    condition_number : float
        Of the scaled normal equations.
    covariance : ndarray of shape (n_parameters, n_parameters), default=None
        Of the values of ``params``, in that order and in their own units; NaN where the data do
        not determine a value or it is at a bound. None where it was not computed.
    short : tuple of str, default=()
        Parameters for which the records are worth fewer than two independent samples.
    damping : tuple of float, default=()
        One value per entry of ``history``, if steps were damped.
    input_history : ndarray of shape (n_records, n_values) or (n_records, n_values, n_inputs)
        Drive 1, 2, 4, ... samples before each record, in its units, if it was estimated.
    is_local : bool, default=False
        Whether the residual is coloured and further starts have ended elsewhere, each at another
        optimum.
    """

    operator: object
    disturbances: tuple
    params: dict
    record_coefficients: np.ndarray
    error: float
    n_evaluations: int
    seconds: float
    converged: bool
    message: str
    history: list
    x: np.ndarray
    params_std: dict = field(default_factory=dict)
    params_std_white: dict = field(default_factory=dict)
    undetermined: tuple = ()
    condition_number: float = np.nan
    covariance: np.ndarray | None = None
    short: tuple = ()
    damping: tuple = ()
    input_history: np.ndarray | None = None
    is_local: bool = False

    def released(self):
        """Return the result with operators that belong to no estimator, and none of them held."""
        beside = tuple(disturbance.released() for disturbance in self.disturbances)
        return replace(self, operator=self.operator.released(), disturbances=beside)

    def outputs(self, records, initial_state="rest"):
        """Return the fitted responses, each with the disturbances of its record.

        Parameters
        ----------
        records : sequence of RecordData
            Those of the fit.
        initial_state : {"rest", "zero"}, default="rest"
            State before each record.

        Returns
        -------
        list of ndarray of shape (n_samples,)
            One per record.
        """
        problem = OperatorProblem(
            self.operator, records, disturbances=self.disturbances, initial_state=initial_state
        )
        return problem.outputs(self.operator, self.disturbances, self.record_coefficients)


def _determined(problem, solution, powers):
    """Return what the data determine of the unknowns: root, marks, names of others, condition.

    The root (n, k) makes the columns of the Jacobian that are determined orthonormal; marks (n,)
    are NaN for what is at a bound, infinite for what is not determined, and zero. ``powers`` are
    the sums of squares of the columns of the Jacobian before the disturbances have taken their
    part.
    """
    hessian = solution.gram[:-1, :-1]
    x = solution.x
    scale = np.sqrt(np.maximum(np.diag(hessian), 0.0))
    # a change by a factor e that leaves the response where it is, but for rounding
    silent = scale <= np.where(problem.log, _SILENT * np.sqrt(problem.scale), _LOST)
    silent |= scale**2 <= _SINGULAR * powers
    undetermined = {
        name for name, is_silent in zip(problem.names, silent, strict=True) if is_silent
    }
    marks = np.where(silent, np.inf, np.nan)
    index = np.flatnonzero((x > problem.lower) & (x < problem.upper) & ~silent)
    root = np.zeros((len(x), len(index)))
    if not len(index):
        return root, marks, tuple(sorted(undetermined)), np.inf if undetermined else 1.0
    scale = scale[index]
    scaled = hessian[np.ix_(index, index)] / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(scaled)
    small = values < _SINGULAR * values[-1]
    for vector in vectors[:, small].T:
        undetermined.update(problem.names[i] for i in index[np.abs(vector) > 0.1])
    root[index] = vectors * np.where(small, 0.0, np.where(small, 1.0, values) ** -0.5)
    root[index] /= scale[:, None]
    marks[index] = 0.0
    marks[np.isin(problem.names, list(undetermined))] = np.inf
    reciprocal = values[0] / values[-1]
    condition = 1.0 / reciprocal if reciprocal > np.finfo(float).tiny else np.inf
    return root, marks, tuple(sorted(undetermined)), float(condition)


def _least_norm(problem, solution):
    """Return the solution with the least of what the data do not determine of linear unknowns.

    Else it would be what the start had. The norm is that of their parts of the response, so that
    it depends on no unit; what has none is as near to zero as its bounds let it be.
    """
    x, index = solution.x.copy(), np.flatnonzero(problem.linear)
    hessian = solution.gram[np.ix_(index, index)]
    scale = np.sqrt(np.maximum(np.diag(hessian), 0.0))
    shown = scale > _LOST
    silent = index[~shown]
    x[silent] = np.clip(0.0, problem.lower[silent], problem.upper[silent])
    index, scale = index[shown], scale[shown]
    if not len(index):
        return x
    values, vectors = np.linalg.eigh(hessian[np.ix_(shown, shown)] / np.outer(scale, scale))
    free = vectors[:, values < _SINGULAR * values[-1]]
    if not free.shape[1]:
        return x
    z = x[index] * scale
    step = -free @ (free.T @ z)
    low, high = problem.lower[index] * scale, problem.upper[index] * scale
    if not np.all((low <= z + step) & (z + step <= high)):
        # a way that the data determine costs so much that none is gone
        held = np.eye(len(z)) - free @ free.T
        step = bounded_step(np.eye(len(z)) + _STIFF * held, z, low - z, high - z)
        step = free @ (free.T @ step)
    if norm(step) > _ROUNDING * norm(z):
        x[index] = np.clip(z + step, low, high) / scale
    return x


def _errors(problem, x, covariance, marks):
    """Return the standard errors of the parameters and their covariance in their own units."""
    chain = np.where(problem.log, problem.values(x), 1.0)
    covariance = covariance * np.outer(chain, chain)
    std = np.where(marks == 0.0, np.sqrt(np.maximum(np.diag(covariance), 0.0)), marks)
    unknown = marks != 0.0
    covariance[unknown], covariance[:, unknown] = np.nan, np.nan
    return dict(zip(problem.names, std.tolist(), strict=True)), covariance


def identify(
    starts,
    records,
    *,
    fixed=(),
    initial_state="rest",
    method="variable_projection",
    with_errors=True,
):
    """Identify an operator from records, starting from each of several candidates.

    If an additive disturbance has a constant for each record, constants of the driven part are held
    at zero.

    Parameters
    ----------
    starts : sequence of Operator
        Starting values of one structure. A start may be a sum of a driven part and additive
        disturbances, or a tuple of the two.
    records : sequence of RecordData
        Some of their samples must have a weight above zero.
    fixed : collection of str, default=()
        Names of entries that are held.
    initial_state : {"rest", "zero"}, default="rest"
        State before each record.
    method : str or Method, default="variable_projection"
        Name of a method, such as ``"differential_evolution"``, or a configured one.
    with_errors : bool, default=True
        Whether standard errors, and what the data do not determine, are wanted: a fit on the way
        to another does without.

    Returns
    -------
    IdentificationResult
        Of the best start.

    Raises
    ------
    ValueError
        If the method is unknown, or no sample has a weight above zero.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import FirstOrderLagOperator
    >>> from skhyst.optimize import RecordData, identify
    >>> u = np.random.default_rng(0).normal(size=200)
    >>> y, _ = FirstOrderLagOperator(0.05).run(u, dt=0.01)
    >>> result = identify([FirstOrderLagOperator(0.1)], [RecordData(u, y, dt=0.01)])
    >>> round(result.operator.time_constant, 6)
    0.05
    """
    if not any(record.segment_weights().any() for record in records):
        raise ValueError(
            "The records' 'weights' must be above zero for some samples. Got zero for all instead."
        )
    problems = problems_of(starts, records, fixed=fixed, initial_state=initial_state)
    return solve(problems, method, with_errors)


def problems_of(starts, records, *, fixed=(), initial_state="rest"):
    """Return one problem for each start; arguments are those of :func:`identify`."""
    starts = list(map(split_disturbances, starts))
    constants = constant_entries(*starts[0])
    return [
        OperatorProblem(
            _without(constants, operator),
            records,
            disturbances=disturbances,
            fixed=constants.union(fixed),
            initial_state=initial_state,
        )
        for operator, disturbances in starts
    ]


def constant_entries(operator, disturbances):
    """Return the names of the entries whose constants disturbances have, one for each record."""
    if not any(disturbance.has_constant for disturbance in disturbances):
        return frozenset()
    return frozenset(name for name, spec in operator.entries() if spec.is_constant)


def _without(constants, operator):
    """Return an operator with some of its entries at zero."""
    if not constants:
        return operator
    held = [name in constants for name, _ in operator.entries()]
    return operator.unpack(np.where(held, 0.0, operator.pack()))


def solve(problems, method, with_errors=True):
    """Solve problems of one structure; return the result in physical units."""
    begin = time.perf_counter()
    method = METHODS[method]() if isinstance(method, str) else method
    problem, solution, n_evaluations = method.solve(problems)
    least = _least_norm(problem, solution)
    if np.any(least != solution.x):
        gram = problem.total(problem.evaluate(least))
        solution, n_evaluations = replace(solution, x=least, gram=gram), n_evaluations + 1
    seconds = time.perf_counter() - begin
    n_samples = problem.segment_weight.sum()  # a sample of weight 2 stands for two
    operator, disturbances = problem.unpack(solution.x)
    blocks = problem.evaluate(solution.x) if with_errors or disturbances else None
    if blocks is None:
        coefficients = np.empty((len(problem.records), 0))
    else:
        coefficients = problem.coefficients(blocks)
    uncertainty = _uncertainty(problem, solution, blocks, coefficients.size) if with_errors else {}
    start, filled = 0, []
    for disturbance in disturbances:
        size = np.size(disturbance.coefficients)
        own = disturbance.pack()
        own[:size] = coefficients[:, start : start + size].mean(axis=0)
        filled.append(disturbance.unpack(own))
        start += size
    return IdentificationResult(
        operator=operator,
        disturbances=tuple(filled),
        params=dict(zip(problem.names, problem.values(solution.x).tolist(), strict=True)),
        record_coefficients=coefficients,
        error=float(np.sqrt(solution.cost / n_samples)),
        n_evaluations=n_evaluations,
        seconds=seconds,
        converged=solution.converged,
        message=solution.message,
        history=solution.history,
        x=solution.x,
        damping=tuple(solution.damping),
        **uncertainty,
    )


def _uncertainty(problem, solution, blocks, n_coefficients):
    """Return standard errors, covariance, and what the data do not determine, by their names."""
    x, n_samples = solution.x, problem.segment_weight.sum()
    root, marks, undetermined, condition = _determined(problem, solution, problem.powers(blocks))
    # the coefficients of the disturbances are unknowns too
    variance = solution.cost / max(n_samples - n_coefficients - root.shape[1], 1)
    white = variance * root @ root.T
    covariance = coloured_covariance(lambda: problem.rows(x), root, n_samples)
    covariance = white if covariance is None else covariance
    few = (marks == 0.0) & (n_samples * np.diag(white) < FEWEST * np.diag(covariance))
    few &= solution.cost > NOISELESS * problem.scale
    params_std_white, _ = _errors(problem, x, white, marks)
    params_std, covariance = _errors(problem, x, covariance, marks)
    return {
        "params_std": params_std,
        "params_std_white": params_std_white,
        "covariance": covariance,
        "short": tuple(np.array(problem.names)[few].tolist()),
        "undetermined": undetermined,
        "condition_number": condition,
    }
