"""Base of the models over the half plane ``alpha >= beta``: the grid and its identification.

Levels ``x_0 < ... < x_{n-1}`` of the drive cut the half plane into cells: interval ``i`` of alpha
(``x_i`` to ``x_{i+1}``) and interval ``j <= i`` of beta, with the number ``i (i + 1) / 2 + j``. The
response is linear in their weights, of which there are many, and data rarely determine all of them:
a major loop alone does not determine the minor loops inside it. The weights minimise

    |y - A w|^2 + lambda sum (v_a - v_b)^2,    w >= 0,

where the sum runs over neighbouring cells and v is the weight of a cell, twice that of a triangular
one on the diagonal, so that equal densities on an even grid have no penalty. The reversible part
has its own penalty. On an uneven grid the weights are smooth as functions of the level's number,
not of the drive. ``lambda`` is ``smoothness`` times the mean squared norm of the centred columns of
A, so that ``smoothness`` has no unit and does not depend on the number of samples. The normal
equations are accumulated over blocks of the records.
"""

import dataclasses
import time
from numbers import Integral, Real

import numpy as np
from scipy.linalg import cholesky, eigh
from scipy.linalg.lapack import dpocon, dpotri
from sklearn.utils.validation import check_array

from .._sklearn import Interval, StrOptions
from ..base import ParametricModel
from ..operators import Superposition, as_signal
from ..optimize import IdentificationResult, OperatorProblem, nonnegative_minimum
from ._common import in_direction, show

_BLOCK = 1024  # rows of the design matrix per block
_BINS = 200  # bins of the drive in which changes of the response are measured
_SILENT = 1e-13  # variance of a column (-1 to 1) below which it has not moved
_RIDGE = 1e-12  # added to the unit diagonal: exactly collinear columns stay solvable
_SINGULAR = 1e-11  # relative eigenvalue below which a direction is not determined


def cell_indices(n_levels):
    """Return the intervals of alpha and of beta of each cell, two arrays (n (n - 1) / 2,)."""
    return np.tril_indices(n_levels - 1)


class RelayGridOperator(Superposition):
    """Base of the operators over a grid: fields ``levels``, ``weights`` and ``center``.

    A subclass defines ``_fill(u, state, rows, first)``, which writes the derivatives by the weights
    to the columns of ``rows`` from ``first`` on and returns the state, and
    ``_propagate(u, du, state, out)``, which writes the tangents of the response for ``du`` to the
    first columns of ``out``.
    """

    def __post_init__(self):
        super().__post_init__()
        n, levels = self.levels.size, self.levels
        ascending = levels.ndim == 1 and n > 1 and np.all(levels[1:] > levels[:-1])
        self._require("levels", ascending, "be a list of two or more ascending values")
        n_cells = n * (n - 1) // 2
        wanted = f"have one value for each of the {n_cells} cells between {n} levels"
        self._require("weights", self.weights.shape == (n_cells,), wanted)

    @property
    def _center(self):
        return float(np.clip(self.center, self.levels[0], self.levels[-1]))

    def _before(self, u, initial_state="rest"):
        return self.init(u[0] if u.size else self._center, initial_state)

    def basis(self, u, state=None):
        """Return the derivatives of the response by the parameters.

        They are the mean states of the relays of each cell, or of the ramps, between -1 and 1, and
        1 for the intercept.

        Parameters
        ----------
        u : array-like of shape (n_samples,)
            Drive, as for :meth:`run`.
        state : tuple, default=None
            State before, as for :meth:`run`.

        Returns
        -------
        basis : ndarray of shape (n_samples, n_parameters)
            In the order of :meth:`pack`.
        state : tuple
            State behind the last sample.
        """
        u = as_signal(u)
        rows = np.ones((u.size, self.n_parameters))
        return rows, self._fill(u, self._before(u) if state is None else state, rows, 0)

    def sensitivities(self, u, du, dt, initial_state="rest"):
        u, du = as_signal(u), as_signal(du)
        state, m = self._before(u, initial_state), du.shape[1]
        dy = np.ones((u.size, m + self.n_parameters))
        if m:
            self._propagate(u, du, state, dy)
        self._fill(u, state, dy, m)
        return self.run(u, dt, state)[0], dy


class RelayGridModel(ParametricModel):
    """Base of the models whose weights lie on a grid over the half plane.

    Parameters
    ----------
    n_levels : int, default=20
        Number n of levels of the drive; there are n (n - 1) / 2 cells. Ignored where ``levels`` is
        an array.
    levels : {"grid", "response"} or array-like of shape (n_levels,), default="grid"
        "grid": evenly spaced from the lowest to the highest drive in the records of the fit.
        "response": over the same range, denser where the response changes more (half of the levels
        follow the drive, half the response), for responses that are steep in a part of the range
        and saturate elsewhere. Or given, in units of the drive. Beyond the levels the model is
        saturated: the response stays constant.
    smoothness : float, default=1e-3
        Weight of the penalty on the differences of neighbouring cells relative to that of the data,
        no unit; 0 for none. The penalty interpolates cells that the data do not determine from
        their neighbours. In a :class:`~skhyst.compose.Cascade` or a :class:`~skhyst.compose.Sum`
        all parameters are refined jointly and without the penalty: use few levels there.
    non_negative : bool, default=True
        Whether the weights have the same sign, so that branches are monotone and the model
        dissipates: none is below zero, or none above if the data show that the response falls as
        the drive rises.
    fit_intercept : bool, default=True
        Whether the response has a constant.
    center : float, default=0.0
        Drive at which the virgin device is demagnetised, units of the drive: cells whose
        ``alpha + beta`` is above ``2 center`` are down, the others up. ``-inf`` (or any value up to
        the lowest level, such as 0 for a drive from 0 to 150 V): all are down at first.
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample: at rest after a first loading from ``center``; the
        drive still at ``center``; or after a rest at a drive value that is fitted per record.

    Attributes
    ----------
    levels_ : ndarray of shape (n_levels,)
        Units of the drive.
    weights_, intercept_ : ndarray of shape (n_levels * (n_levels - 1) / 2,) and float
        Units of the response; the cell of interval i of alpha and interval j <= i of beta has the
        number i (i + 1) / 2 + j.
    params_, params_std_ : dict
        Parameters and their standard errors, which hold for the penalised estimate and white noise:
        they include neither its bias nor correlation of the noise. Cells that have not moved are
        named in ``identifiability_["undetermined"]``.
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "n_levels": [Interval(Integral, 2, None, closed="left")],
        "levels": [StrOptions({"grid", "response"}), "array-like"],
        "smoothness": [Interval(Real, 0, None, closed="left")],
        "non_negative": ["boolean"],
        "fit_intercept": ["boolean"],
        "center": [Interval(Real, None, None, closed="both")],
    }

    operator_class = RelayGridOperator
    _diagonal_is_reversible = False  # the cells (i, i) have no loop

    def __init__(
        self,
        n_levels=20,
        *,
        levels="grid",
        smoothness=1e-3,
        non_negative=True,
        fit_intercept=True,
        center=0.0,
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        super().__init__(initial_state=initial_state, dt=dt, drive=drive, method=method)
        self.n_levels = n_levels
        self.levels = levels
        self.smoothness = smoothness
        self.non_negative = non_negative
        self.fit_intercept = fit_intercept
        self.center = center

    def _levels(self, records):
        if not isinstance(self.levels, str):
            return check_array(self.levels, ensure_2d=False, dtype=np.float64)
        low = min(record.u.min() for record in records)
        high = max(record.u.max() for record in records)
        edges = np.linspace(low, high, _BINS + 1)
        if not np.all(np.diff(edges) > 0.0):  # constant drive
            half = max(abs(low), abs(high)) or 1.0
            return np.linspace(low - half, high + half, self.n_levels)
        if self.levels == "grid":
            return np.linspace(low, high, self.n_levels)
        return _response_levels(records, edges, self.n_levels)

    def starting_values(self, records):
        held, state = self.held_parameters(), self.free_run_state
        return in_direction([self._start(records)], records, held, state)

    def _start(self, records):
        """Return the operator over the grid, of weights of zero."""
        levels = self._levels(records)
        zeros = np.zeros(len(cell_indices(len(levels))[0]))
        options = {"center": self.center, "non_negative": self.non_negative}
        return self.operator_class(levels, zeros, **options)

    def identify(self, data):
        begin = time.perf_counter()
        problem, solution, cost = self._solved(data)
        x, covariance, marks, undetermined, condition, freedom = solution
        n_samples, names = problem.segment_weight.sum(), problem.names
        variance = cost / max(n_samples - freedom, 1.0)
        covariance = variance * covariance
        std = np.where(marks == 0.0, np.sqrt(np.maximum(covariance.diagonal(), 0.0)), marks)
        return IdentificationResult(
            operator=problem.unpack(x)[0],
            disturbances=(),
            params=dict(zip(names, x.tolist(), strict=True)),
            params_std=dict(zip(names, std.tolist(), strict=True)),
            undetermined=tuple(names[i] for i in np.flatnonzero(undetermined)),
            condition_number=condition,
            record_coefficients=np.empty((len(data), 0)),
            error=float(np.sqrt(cost / n_samples)),
            n_evaluations=1,
            seconds=time.perf_counter() - begin,
            converged=True,
            message="All parameters are linear and were solved exactly.",
            history=[(1, cost)],
            x=x,
            joint_covariance=covariance,
            noise_std=float(np.sqrt(variance)),
        )

    def _solved(self, data):
        """Return the problem, the solution as from :func:`_solve`, and the sum of squares.

        Those of the mirrored response, if that is better; see ``in_direction``. Sums of relays that
        follow one drive in opposite directions are not positively correlated: if one explains more
        than half of the power, the other explains less, and is not tried.
        """
        operator = self._start(data)
        fixed, state = self.held_parameters(), self.free_run_state
        problem = OperatorProblem(operator, data, fixed=fixed, initial_state=state)
        gram, shift, _ = _normal_equations(problem, self.fit_intercept)
        roughness = _roughness(operator, self._diagonal_is_reversible)

        def solved(sign):
            signs = np.ones(len(gram))
            signs[-1] = sign
            equations = gram * np.outer(signs, signs), sign * shift, self.fit_intercept
            x, *rest = _solve(*equations, roughness, self.smoothness, self.non_negative)
            cost = problem.total(problem.evaluate(sign * x, jacobian=False))[-1, -1]
            return (sign * x, *rest), float(cost)

        solution, cost = solved(1.0)
        n_samples, power = gram[-2, -2], gram[-1, -1] - gram[-1, -2] ** 2 / gram[-2, -2]
        if self.non_negative and cost > 0.5 * power:
            mirrored, least = solved(-1.0)
            if least * (1.0 + operator.weights.size / n_samples) < cost:
                operator = dataclasses.replace(operator, falling=True)
                problem = OperatorProblem(operator, data, fixed=fixed, initial_state=state)
                return problem, mirrored, least
        return problem, solution, cost

    def finish(self, result, records):
        super().finish(result, records)
        # the search for the input history has refitted all parameters without the penalty
        if self.initial_state == "estimate":
            drives = zip(records, self.initial_drive_, strict=True)
            records = [dataclasses.replace(record, before=u) for record, u in drives]
        if any(record.before is not None for record in records):
            self.adopt(self.identify(records))
        return self

    def adopt(self, result):
        super().adopt(result)
        show(self, self.operator_, "levels", "weights", "intercept")
        return self


def _response_levels(records, edges, n_levels):
    """Return levels between which the sum of the relative changes of drive and response is equal.

    The response is averaged over each passage of the drive through a bin, so that noise contributes
    little to its changes.
    """
    changes = np.zeros(len(edges))
    for record in records:
        bins = np.clip(np.searchsorted(edges, record.u, side="right") - 1, 0, len(edges) - 2)
        starts = np.flatnonzero(np.append(True, bins[1:] != bins[:-1]))
        means = np.add.reduceat(record.y, starts) / np.diff(np.append(starts, len(bins)))
        here, there = bins[starts][:-1], bins[starts][1:]
        share = np.abs(np.diff(means)) / (np.abs(there - here) + 1)
        np.add.at(changes, np.minimum(here, there), share)
        np.add.at(changes, np.maximum(here, there) + 1, -share)
    changes = np.maximum(np.cumsum(changes[:-1]), 0.0)
    weight = np.full(len(changes), 1.0 / len(changes))
    if changes.sum() > 0.0:
        weight += changes / changes.sum()
    cumulative = np.append(0.0, np.cumsum(weight))
    return np.interp(np.linspace(0.0, cumulative[-1], n_levels), cumulative, edges)


def _roughness(operator, diagonal_is_reversible):
    """Return the matrix of the penalty.

    Reversible weights are neighbours of each other only. They are those of the diagonal, or those
    that follow the weights of the cells, if any.
    """
    n, n_weights = operator.levels.size, operator.n_parameters - 1
    i, j = cell_indices(n)
    number, scale = np.full((n, n), -1), np.ones(n_weights)
    number[i, j] = np.arange(i.size)
    diagonal = np.arange(n - 1)
    if diagonal_is_reversible:
        line = number[diagonal, diagonal]
        number[diagonal, diagonal] = -1
    else:
        line = np.arange(i.size, n_weights)
        scale[number[diagonal, diagonal]] = 2.0
    here = number[i, j]
    a = np.concatenate((here, here, line[:-1]))
    b = np.concatenate((number[i + 1, j], number[i, j + 1], line[1:]))
    cells = (a >= 0) & (b >= 0)
    a, b = a[cells], b[cells]
    matrix = np.zeros((n_weights, n_weights))
    np.add.at(matrix, (a, a), scale[a] ** 2)
    np.add.at(matrix, (b, b), scale[b] ** 2)
    np.add.at(matrix, (a, b), -scale[a] * scale[b])
    np.add.at(matrix, (b, a), -scale[a] * scale[b])
    return matrix


def _normal_equations(problem, fit_intercept):
    """Return the Gram matrix of ``[A, 1, y - shift]``, the shift and ``fit_intercept``.

    The shift is the mean of y, subtracted to avoid cancellation.
    """
    weights = [record.counts() for record in problem.records]
    y = np.concatenate([record.y for record in problem.records])
    shift = np.average(y, weights=np.concatenate(weights)) if fit_intercept else 0.0
    operator, gram = problem.operator, 0.0
    for record, counts in zip(problem.records, weights, strict=True):
        u, skip = record.with_history
        _, state = operator.run(u[:skip], record.dt, operator.init(u[0], problem.initial_state))
        for start in range(0, len(record.u), _BLOCK):
            part = slice(start, start + _BLOCK)
            rows, state = operator.basis(record.u[part], state)
            rows = np.column_stack((rows, record.y[part] - shift))
            rows *= np.sqrt(counts[part, None])
            gram = gram + rows.T @ rows
    return gram, shift, fit_intercept


def _solve(gram, shift, fit_intercept, roughness, smoothness, non_negative):
    """Return estimate, covariance, marks, undetermined, condition number, degrees of freedom.

    The estimate contains the weights and the intercept, if any. Marks are NaN for a value at its
    bound, infinite for one that is not determined, else zero; ``undetermined`` is a mask of the
    weights; the degrees of freedom are the effective number of parameters. The covariance, per unit
    of the variance of noise, is that of the penalised estimate and does not include its bias.
    """
    n_samples, n = gram[-2, -2], len(gram) - 2
    mean, right, gram_y = gram[-2, :n] / n_samples, gram[-1, :n], gram[-1, -2]
    gram = gram[:n, :n]
    spread = gram.diagonal() - n_samples * mean**2
    silent = spread <= _SILENT * n_samples
    if fit_intercept:
        gram = np.where(silent | silent[:, None], 0.0, gram - n_samples * np.outer(mean, mean))
        right = np.where(silent, 0.0, right - mean * gram_y)
    matrix = gram + smoothness * max(spread.mean(), 0.0) * roughness
    # scaled to a unit diagonal, so that ridge and condition number do not depend on units
    index = np.flatnonzero(matrix.diagonal() > 0.0)
    scale = np.sqrt(matrix.diagonal()[index])
    matrix = matrix[np.ix_(index, index)] / np.outer(scale, scale)
    matrix[np.diag_indices_from(matrix)] += _RIDGE
    bounded = np.full(index.size, non_negative)
    solution, free = nonnegative_minimum(matrix, -right[index] / scale, bounded)
    x, undetermined = np.zeros(n), silent.copy()
    x[index] = solution / scale
    # weights at their bound are held: the covariance is that of the others
    free &= (solution > 0.0) | ~bounded
    index, scale, matrix = index[free], scale[free], matrix[np.ix_(free, free)]
    inverse, condition, unknown = (_inverse if smoothness > 0.0 else _pseudo_inverse)(matrix)
    undetermined[index[unknown]] = True
    resolution = inverse @ (gram[np.ix_(index, index)] / np.outer(scale, scale))
    covariance = np.zeros((n, n))
    covariance[np.ix_(index, index)] = resolution @ inverse / np.outer(scale, scale)
    marks = np.where(silent, np.inf, np.nan)
    marks[index] = 0.0
    marks[undetermined] = np.inf
    if fit_intercept:
        x, marks = np.append(x, shift - mean @ x), np.append(marks, 0.0)
        follow = np.concatenate([np.eye(n), -mean[None]])
        covariance = follow @ covariance @ follow.T
        covariance[-1, -1] += 1.0 / n_samples
    return (
        x,
        covariance,
        marks,
        undetermined,
        condition,
        float(np.trace(resolution)) + fit_intercept,
    )


def _inverse(matrix):
    """Return the inverse of a positive definite matrix, its condition number, and []."""
    if not len(matrix):
        return matrix, 1.0, []
    factor = cholesky(matrix)
    reciprocal, _ = dpocon(factor, np.abs(matrix).sum(axis=0).max())
    inverse = np.triu(dpotri(factor)[0])
    return inverse + np.triu(inverse, 1).T, _condition(reciprocal), []


def _pseudo_inverse(matrix):
    """Return the pseudo-inverse, the condition number, and a mask of undetermined unknowns."""
    if not len(matrix):
        return matrix, 1.0, []
    values, vectors = eigh(matrix)
    small = values < _SINGULAR * values[-1]
    inverse = np.where(small, 0.0, 1.0 / np.where(small, 1.0, values))
    unknown = (np.abs(vectors[:, small]) > 0.1).any(axis=1)
    return (vectors * inverse) @ vectors.T, _condition(values[0] / values[-1]), unknown


def _condition(reciprocal):
    return float(1.0 / reciprocal) if reciprocal > np.finfo(float).tiny else np.inf
