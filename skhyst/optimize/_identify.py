"""The front door of identification: starts, method, uncertainties, one result object."""

import time
from dataclasses import dataclass

import numpy as np

from ..operators import take_apart
from ._levenberg_marquardt import LevenbergMarquardt
from ._population import CuckooSearch, DifferentialEvolution, ModifiedCuckooSearch, ParticleSwarm
from ._problem import OperatorProblem
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
_SINGULAR = 1e-11  # relative eigenvalue of the scaled normal equations


@dataclass(frozen=True)
class IdentificationResult:
    """What identification found.

    Attributes
    ----------
    operator : Operator
    disturbances : tuple of DisturbanceOperator
        Coefficients are the mean over records.
    params, params_std : dict of str to float
        Values in their own units and standard errors; NaN for a value at its bound.
    undetermined : tuple of str
        Parameters that the data do not determine.
    condition_number : float
        Of the scaled normal equations.
    record_coefficients : ndarray of shape (n_records, n_coefficients)
    error : float
        Root mean square of the residual, samples counted by their weights; units of the response.
    n_evaluations : int
    seconds : float
    converged : bool
    message : str
    history : list of (int, float)
        Evaluations and sum of squares after each accepted step.
    x : ndarray
        The solution in the coordinates of the problem.
    covariance : ndarray of shape (n_parameters, n_parameters) or None
        Of the values of ``params``, in that order and in their own units; NaN where the data do
        not determine a value or it is at a bound. None where it was not computed.
    damping : tuple of float
        One value an entry of ``history``, where steps were damped; else empty.
    """

    operator: object
    disturbances: tuple
    params: dict
    params_std: dict
    undetermined: tuple
    condition_number: float
    record_coefficients: np.ndarray
    error: float
    n_evaluations: int
    seconds: float
    converged: bool
    message: str
    history: list
    x: np.ndarray
    covariance: np.ndarray | None = None
    damping: tuple = ()

    def outputs(self, records, initial_state="rest"):
        """Return the fitted response of each record, its own disturbance coefficients included."""
        problem = OperatorProblem(
            self.operator, records, disturbances=self.disturbances, initial_state=initial_state
        )
        return problem.outputs(self.operator, self.disturbances, self.record_coefficients)


def _uncertainty(problem, solution, n_samples, powers):
    """Return standard errors, undetermined names, the condition number and the covariance.

    ``powers`` are the sums of squares of the columns of the Jacobian before the disturbances have
    taken their part.
    """
    hessian = solution.gram[:-1, :-1]
    x = solution.x
    scale = np.sqrt(np.maximum(np.diag(hessian), 0.0))
    # a change by a factor e that leaves the response where it is, but for rounding
    silent = scale <= np.where(problem.log, _SILENT * np.sqrt(problem.scale), 0.0)
    silent |= scale**2 <= _SINGULAR * powers
    undetermined = {
        name for name, is_silent in zip(problem.names, silent, strict=True) if is_silent
    }
    std = np.where(silent, np.inf, np.nan)
    covariance = np.full_like(hessian, np.nan)
    index = np.flatnonzero((x > problem.lower) & (x < problem.upper) & ~silent)
    if not len(index):
        return std, tuple(sorted(undetermined)), np.inf if undetermined else 1.0, covariance
    scale = scale[index]
    scaled = hessian[np.ix_(index, index)] / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(scaled)
    small = values < _SINGULAR * values[-1]
    for vector in vectors[:, small].T:
        undetermined.update(problem.names[i] for i in index[np.abs(vector) > 0.1])
    variance = solution.cost / max(n_samples - len(index), 1)
    inverse = np.where(small, 0.0, 1.0 / np.where(small, 1.0, values))
    std[index] = np.sqrt(variance * (vectors**2 @ inverse)) / scale
    chain = np.where(problem.log, problem.values(x), 1.0)
    std *= np.abs(chain)
    covariance[np.ix_(index, index)] = variance * (vectors * inverse) @ vectors.T
    covariance[np.ix_(index, index)] *= np.outer(chain[index] / scale, chain[index] / scale)
    for i, name in enumerate(problem.names):
        if name in undetermined:
            std[i] = np.inf
            covariance[i] = covariance[:, i] = np.nan
    reciprocal = values[0] / values[-1]
    condition = 1.0 / reciprocal if reciprocal > np.finfo(float).tiny else np.inf
    return std, tuple(sorted(undetermined)), float(condition), covariance


def identify(starts, records, *, fixed=(), initial_state="rest", method="variable_projection"):
    """Identify an operator from records, starting from each of several candidates.

    Parameters
    ----------
    starts : sequence of Operator
        Starting values of one structure; see :func:`skhyst.operators.take_apart` for what may stand
        beside what is driven.
    records : sequence of RecordData
        Some of their samples must have a weight above zero.
    fixed : collection of str
        Names of entries that are held.
    initial_state : {"rest", "zero"}
    method : str or Method, default="variable_projection"
        A name among those of ``METHODS`` or a configured method.

    Returns
    -------
    IdentificationResult
    """
    if not any(record.segment_weights().any() for record in records):
        raise ValueError(
            "The records' 'weights' must be above zero for some samples. Got zero for all instead."
        )
    problems = [
        OperatorProblem(
            operator, records, disturbances=disturbances, fixed=fixed, initial_state=initial_state
        )
        for operator, disturbances in map(take_apart, starts)
    ]
    return solve(problems, method)


def solve(problems, method):
    """Solve problems of one structure; return the result in physical units."""
    begin = time.perf_counter()
    method = METHODS[method]() if isinstance(method, str) else method
    problem, solution, n_evaluations = method.solve(problems)
    seconds = time.perf_counter() - begin
    n_samples = problem.segment_weight.sum()  # a sample of weight 2 stands for two
    operator, disturbances = problem.unpack(solution.x)
    blocks = problem.evaluate(solution.x)
    coefficients = problem.coefficients(blocks)
    # the coefficients of the disturbances are unknowns too
    std, undetermined, condition, covariance = _uncertainty(
        problem, solution, n_samples - coefficients.size, problem.powers(blocks)
    )
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
        params_std=dict(zip(problem.names, std.tolist(), strict=True)),
        undetermined=undetermined,
        condition_number=condition,
        record_coefficients=coefficients,
        error=float(np.sqrt(solution.cost / n_samples)),
        n_evaluations=n_evaluations,
        seconds=seconds,
        converged=solution.converged,
        message=solution.message,
        history=solution.history,
        x=solution.x,
        covariance=covariance,
        damping=tuple(solution.damping),
    )
