"""The entry point of identification: starts, method, uncertainties, and the result object."""

import time
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.linalg import norm

from ..operators import split_disturbances
from ._bounded_step import bounded_step
from ._levenberg_marquardt import LevenbergMarquardt
from ._population import CuckooSearch, DifferentialEvolution, ModifiedCuckooSearch, ParticleSwarm
from ._problem import OperatorProblem
from ._standard_errors import FEWEST, coloured_covariance, penalised_covariance
from ._variable_projection import Solution, VariableProjection, start_descent

METHODS = {
    "variable_projection": VariableProjection,
    "differential_evolution": DifferentialEvolution,
    "particle_swarm": ParticleSwarm,
    "cuckoo_search": CuckooSearch,
    "modified_cuckoo_search": ModifiedCuckooSearch,
    "levenberg_marquardt": LevenbergMarquardt,
}

_SILENT = 1e-13  # of the response: a smaller effect of a parameter is rounding
_LOST = np.sqrt(np.finfo(float).tiny / np.finfo(float).eps)  # norm below which squares lose digits
NOISELESS = 1e-8  # fraction of the response's power below which a residual is rounding, not noise
_STIFF = 1e10  # weight of determined directions relative to undetermined ones
_ROUNDING = 1e-6  # of the linear unknowns: a smaller change is rounding
_QUANTILE = 1.96  # of the normal distribution, for an interval that holds 95 %
_SINGULAR = 1e-11  # relative eigenvalue of the scaled normal equations


@dataclass(frozen=True)
class IdentificationResult:
    """Result of identification.

    Parameters
    ----------
    operator : Operator
        The driven part, identified.
    disturbances : tuple of DisturbanceOperator
        Additive disturbances; their coefficients are means over records.
    params : dict of str to float
        Values in their own units.
    record_coefficients : ndarray of shape (n_records, n_coefficients)
        Of the additive disturbances.
    error : float
        Root mean square of the residual, weighted; units of the response.
    n_evaluations : int
        Number of simulations of all records.
    seconds : float
        Duration.
    converged : bool
        Whether it ended before its budget was exhausted.
    message : str
        Reason for the end.
    history : list of (int, float)
        Evaluations and sum of squares after each accepted step.
    x : ndarray
        The solution in the coordinates of the problem.
    params_std : dict of str to float
        Standard errors under noise of any colour; NaN for a value at its bound. Empty, like all
        that depends on them, if they were not requested.
    params_std_white : dict of str to float, default={}
        Standard errors under white noise.
    undetermined : tuple of str
        Parameters that the data do not determine: they do not affect the response; or, on a
        logarithmic scale, the upper end of the confidence interval exceeds the value by a factor
        larger than the number of samples, the ratio of the longest to the shortest time scale in a
        record, and fits too.
    condition_number : float
        Of the scaled normal equations.
    joint_covariance : ndarray of shape (n, n), default=None
        Of the values of ``params``, in that order and in their own units, followed by those of the
        disturbances' coefficients in a record outside of the fit. Zero in directions that the data
        do not determine, and at a bound. None if it was not computed.
    noise_std : float or None, default=None
        Standard deviation of the noise, units of the response: from the residual, corrected for the
        noise that the fit has absorbed.
    short : tuple of str, default=()
        Parameters whose effective sample size is below two.
    silent : tuple of str, default=()
        Undetermined parameters that do not affect the response.
    damping : tuple of float, default=()
        One value per entry of ``history``, if steps were damped.
    input_history : ndarray of shape (n_records, n_values) or (n_records, n_values, n_inputs)
        Drive 1, 2, 4, ... samples before each record, in its units, if it was estimated.
    is_local : bool, default=False
        Whether the residual is coloured and every further start has ended at another optimum.

    See Also
    --------
    identify : Returns it.
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
    joint_covariance: np.ndarray | None = None
    noise_std: float | None = None
    short: tuple = ()
    silent: tuple = ()
    damping: tuple = ()
    input_history: np.ndarray | None = None
    is_local: bool = False

    @property
    def covariance(self):
        """Covariance of the values of ``params``, in that order, or None.

        NaN for a value at a bound or not determined by the data.
        """
        if self.joint_covariance is None:
            return None
        unknown = ~np.isfinite([self.params_std[name] for name in self.params])
        covariance = self.joint_covariance[: len(unknown), : len(unknown)].copy()
        covariance[unknown], covariance[:, unknown] = np.nan, np.nan
        return covariance

    def narrowed(self, wide):
        """Return the result with the standard errors of a result that has more parameters.

        Parameters
        ----------
        wide : IdentificationResult
            For the same response, with the parameters of this result among its own.

        Returns
        -------
        IdentificationResult
            With the parameters of this one.
        """
        names = list(wide.params)
        indices = [names.index(name) for name in self.params]
        indices += range(len(names), len(wide.joint_covariance))
        return replace(
            self,
            params_std={name: wide.params_std[name] for name in self.params},
            params_std_white={name: wide.params_std_white[name] for name in self.params},
            joint_covariance=wide.joint_covariance[np.ix_(indices, indices)],
        )

    def operator_covariance(self):
        """Return the covariance of all values of the operator with its disturbances, or None.

        Returns
        -------
        ndarray of shape (n, n) or None
            In the order of ``pack`` of their sum; zero for values that are held.
        """
        if self.joint_covariance is None:
            return None
        places, coefficients = places_in_sum(self.operator, self.disturbances)
        indices = [*(places[name] for name in self.params), *coefficients]
        covariance = np.zeros((len(places) + len(coefficients),) * 2)
        covariance[np.ix_(indices, indices)] = self.joint_covariance
        return covariance

    def released(self):
        """Return the result with operators that have no estimator and no held entries.

        Returns
        -------
        IdentificationResult
            A copy.
        """
        additive = tuple(disturbance.released() for disturbance in self.disturbances)
        return replace(self, operator=self.operator.released(), disturbances=additive)

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


def places_in_sum(driven, disturbances):
    """Return the indices in the pack of a sum: of parameters by name, and of coefficients."""
    places = {name: i for i, (name, _) in enumerate(driven.entries())}
    start, coefficients = len(places), []
    for number, disturbance in enumerate(disturbances):
        size = np.size(disturbance.coefficients)
        coefficients += range(start, start + size)
        for i, (name, _) in enumerate(disturbance.entries()[size:]):
            places[f"disturbance{number}__{name}"] = start + size + i
        start += disturbance.n_parameters
    return places, coefficients


def calibrated(operator, record, covariance=None, noise_std=None, precision=None, by_history=None):
    """Return an operator with the coefficients of its disturbances in a record.

    Parameters
    ----------
    operator : Operator
        With its additive disturbances.
    record : RecordData
        Its known response, and how it begins.
    covariance : ndarray of shape (n_parameters, n_parameters), default=None
        Of the values of ``pack``; the result includes the errors of what is estimated from this
        record.
    noise_std : float, default=None
        Standard deviation of the noise, with a covariance.
    precision : ndarray of shape (n_start, n_start), default=None
        Inverse covariance of the record's input history or start values before its response was
        known, if these have been estimated.
    by_history : ndarray of shape (n_samples, n_start), default=None
        Derivatives of the output by these, if they are known.

    Returns
    -------
    operator : Operator
    covariance : ndarray of shape (n_parameters + n_start, n_parameters + n_start) or None
        Of the values of ``pack`` and of how the record begins.
    """
    driven, additive = split_disturbances(operator)
    places, own = places_in_sum(driven, additive)
    if own:
        problem = OperatorProblem(driven, [record], disturbances=additive)
        coefficients = problem.coefficients(problem.evaluate(problem.x0, jacobian=False))[0]
        values = operator.pack()
        values[own] = coefficients
        operator = operator.unpack(values)
    if covariance is None or (not own and precision is None):
        return operator, covariance
    n_start = 0 if precision is None else len(precision)
    if n_start:
        if by_history is None:
            by_history = OperatorProblem(driven, [record]).history_sensitivities(driven, record)
        record = replace(record, eliminated=by_history)
        size = len(covariance)
        own = [*own, *range(size, size + n_start)]
        covariance = np.pad(covariance, (0, n_start))
    problem = OperatorProblem(driven, [record], disturbances=additive)
    blocks = problem.evaluate(problem.x0)
    if n_start:
        estimated = slice(len(own) - n_start, len(own))
        blocks[0, estimated, estimated] += noise_std**2 * precision
    propagation = np.eye(len(covariance))
    propagation[own] = 0.0
    slopes, chain = problem.coefficient_slopes(blocks)[0], problem.chain(problem.values(problem.x0))
    # zero where a value at its bound has no slope
    slopes = np.divide(slopes, chain, out=np.zeros_like(slopes), where=chain != 0.0)
    propagation[np.ix_(own, [places[name] for name in problem.names])] = -slopes
    covariance = propagation @ covariance @ propagation.T
    covariance[np.ix_(own, own)] += (noise_std or 0.0) ** 2 * _inverse(blocks, len(own))
    return operator, covariance


def _inverse(blocks, d):
    """Return the inverse of the Gram matrix of the columns of d coefficients."""
    gram = blocks.sum(axis=0)[:d, :d]
    scale = np.sqrt(gram.diagonal())
    scale[scale == 0.0] = 1.0
    return np.linalg.pinv(gram / scale / scale[:, None], hermitian=True) / scale / scale[:, None]


def _determined(problem, solution, powers):
    """Return the determined directions of the unknowns: root, marks, other names, condition.

    The root (n, k) makes the determined directions of the Jacobian orthonormal; marks (n,) are NaN
    for an unknown at a bound, infinite for one that is not determined, else zero. ``powers`` are
    the sums of squares of the columns of the Jacobian before the disturbances are projected out.
    """
    hessian = solution.gram[:-1, :-1]
    x = solution.x
    scale = np.sqrt(np.maximum(np.diag(hessian), 0.0))
    # a change by a factor e does not affect the response, except for rounding
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
    """Return the solution of least norm in the undetermined directions of linear unknowns.

    Otherwise the start would decide there. The norm is that of the unknowns' contributions to the
    response, so that it depends on no unit; unknowns without a contribution are as close to zero as
    their bounds allow.
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
        # a determined direction is so costly that it does not move
        held = np.eye(len(z)) - free @ free.T
        step = bounded_step(np.eye(len(z)) + _STIFF * held, z, low - z, high - z)
        step = free @ (free.T @ step)
    if norm(step) > _ROUNDING * norm(z):
        x[index] = np.clip(z + step, low, high) / scale
    return x


def _errors(problem, covariance, marks):
    """Return the standard errors of the parameters by their names."""
    std = np.where(marks == 0.0, np.sqrt(np.maximum(np.diag(covariance), 0.0)), marks)
    return dict(zip(problem.names, std.tolist(), strict=True))


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
        Whether to compute standard errors and undetermined parameters; an intermediate fit needs
        neither.

    Returns
    -------
    IdentificationResult
        Of the best start.

    Raises
    ------
    ValueError
        If the method is unknown, or no sample has a weight above zero.

    See Also
    --------
    VariableProjection : The default method.
    skhyst.base.ParametricModel : Estimators that call it.

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
    """Return the names of constant entries that are replaced by a disturbance's own per record."""
    if not any(disturbance.has_constant for disturbance in disturbances):
        return frozenset()
    return frozenset(name for name, spec in operator.entries() if spec.is_constant)


def _without(constants, operator):
    """Return an operator with some of its entries at zero."""
    if not constants:
        return operator
    is_zero = [name in constants for name, _ in operator.entries()]
    return operator.unpack(np.where(is_zero, 0.0, operator.pack()))


def solve(problems, method, with_errors=True):
    """Solve problems of one structure; return the result in physical units."""
    begin = time.perf_counter()
    method = METHODS[method]() if isinstance(method, str) else method
    problem, solution, n_evaluations = method.solve(problems)
    # not if no start has finite derivatives: the error is infinite then
    is_finite = bool(np.isfinite(solution.gram).all())
    minimum_norm = _least_norm(problem, solution) if is_finite else solution.x
    if np.any(minimum_norm != solution.x):
        gram = problem.total(problem.evaluate(minimum_norm))
        solution, n_evaluations = replace(solution, x=minimum_norm, gram=gram), n_evaluations + 1
    seconds = time.perf_counter() - begin
    n_samples = problem.segment_weight.sum()  # a sample of weight 2 counts as two
    operator, disturbances = problem.unpack(solution.x)
    blocks = problem.evaluate(solution.x) if with_errors or disturbances else None
    if blocks is None:
        coefficients = np.empty((len(problem.records), 0))
    else:
        coefficients = problem.coefficients(blocks)
    uncertainty = {}
    if with_errors and is_finite:
        uncertainty = _uncertainty(problem, solution, blocks, coefficients)
    start, filled = 0, []
    for disturbance in disturbances:
        size = np.size(disturbance.coefficients)
        values = disturbance.pack()
        values[:size] = coefficients[:, start : start + size].mean(axis=0)
        filled.append(disturbance.unpack(values))
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


def as_of(result, operator, records, *, fixed=(), initial_state="rest"):
    """Return a result with the parameters and errors of another operator of the same response.

    Such as one whose positions of terms are free parameters too, which makes the standard errors of
    the other parameters larger.

    Parameters
    ----------
    result : IdentificationResult
    operator : Operator
        Without additive disturbances, at its solution.
    records, fixed, initial_state
        As for :func:`identify`.

    Returns
    -------
    IdentificationResult
        With the parameters and the errors of the operator. Nothing is fitted.
    """
    start = operator, result.disturbances
    (problem,) = problems_of([start], records, fixed=fixed, initial_state=initial_state)
    blocks = problem.evaluate(problem.x0)
    gram = problem.total(blocks)
    solution = Solution(problem.x0, float(gram[-1, -1]), gram, 1, result.converged, result.message)
    return replace(
        result,
        operator=operator,
        params=dict(zip(problem.names, problem.values(solution.x).tolist(), strict=True)),
        x=solution.x,
        **_uncertainty(problem, solution, blocks, problem.coefficients(blocks)),
    )


def _uncertainty(problem, solution, blocks, coefficients):
    """Return standard errors, covariance, and undetermined parameters, by name."""
    x, n_samples = solution.x, problem.segment_weight.sum()
    root, marks, undetermined, condition = _determined(problem, solution, problem.powers(blocks))
    # the coefficients of the disturbances are unknowns too
    variance = solution.cost / max(n_samples - coefficients.size - root.shape[1], 1)
    white = variance * root @ root.T
    coloured = coloured_covariance(lambda: problem.rows(x), root, n_samples)
    penalised = np.flatnonzero(problem.penalty)
    covariance, _ = penalised_covariance(problem, white, coloured, variance, penalised)
    is_wide = problem.log & (marks == 0.0)
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    is_wide &= _QUANTILE * errors > np.log(max(n_samples, 2.0))
    for i in np.flatnonzero(is_wide):
        is_wide[i] = _is_open(problem, solution, i, errors[i], variance)
    marks[is_wide] = np.inf
    names = np.array(problem.names)
    is_short = (marks == 0.0) & (n_samples * np.diag(white) < FEWEST * np.diag(covariance))
    is_short &= solution.cost > NOISELESS * problem.scale
    # the fit has absorbed the trace of H C of the noise, which for white noise is sigma^2 p
    absorbed = np.sum(solution.gram[:-1, :-1] * covariance)
    noise = (solution.cost + absorbed) / max(n_samples - coefficients.size, 1)
    scale = problem.chain(problem.values(x))
    scale_products = np.outer(scale, scale)
    covariance = covariance * scale_products
    return {
        "params_std": _errors(problem, covariance, marks),
        "params_std_white": _errors(problem, white * scale_products, marks),
        "joint_covariance": _joint(problem, blocks, coefficients, covariance, scale, noise),
        "noise_std": float(np.sqrt(noise)),
        "short": tuple(names[is_short].tolist()),
        "undetermined": tuple(sorted({*undetermined, *names[is_wide].tolist()})),
        "silent": undetermined,
        "condition_number": condition,
    }


def _is_open(problem, solution, i, error, variance):
    """Whether the upper end of the interval of a scale parameter fits the data as well.

    ``error`` is that of its logarithm. A wide linear interval alone is not sufficient: it is wide
    for two equal poles, which are determined, and near zero, where only the upper end shows it.
    """
    x = solution.x.copy()
    x[i] = min(x[i] + np.log1p(_QUANTILE * error), problem.upper[i])
    cost = start_descent(problem, x).cost
    # data do not contradict an end at which the derivatives overflow
    return not np.isfinite(cost) or cost < solution.cost + _QUANTILE**2 * variance


def _joint(problem, blocks, coefficients, covariance, chain, noise):
    """Return the covariance of the parameters and of the coefficients of a new record.

    Coefficients follow the parameters by ``-B^+ J`` and vary between records by the scatter over
    those of the fit. With a single record only its estimation error is known.
    """
    m, d = coefficients.shape
    # without those of parallel signals
    n_kept = (
        sum(np.size(disturbance.coefficients) for disturbance in problem.disturbances) if d else 0
    )
    if not n_kept:
        return covariance
    slopes = -problem.coefficient_slopes(blocks).mean(axis=0)[:n_kept] / chain
    if m > 1:
        scatter = np.atleast_2d(np.cov(coefficients[:, :n_kept].T)) * (1.0 + 1.0 / m)
    else:
        scatter = noise * _inverse(blocks, d)[:n_kept, :n_kept]
    propagation = np.concatenate([np.eye(len(chain)), slopes])
    joint = propagation @ covariance @ propagation.T
    joint[len(chain) :, len(chain) :] += scatter
    return joint
