"""What the models over the half plane ``alpha >= beta`` share: the grid and its identification.

The response is linear in the weights, of which there are many, and data rarely determine all of
them: a major loop alone says nothing about where inside it minor loops differ. The weights minimise

    |y - A w|^2 + lambda sum (v_a - v_b)^2,    w >= 0,

where the sum runs over neighbouring cells and v is the weight of a cell, twice that of a triangular
one on the diagonal: equal densities on an even grid cost nothing. The reversible part is smooth for
itself. On an uneven grid the weights are smooth as functions of the level's number, not of the
drive. ``lambda`` is ``smoothness`` times the mean squared norm of the columns of A less their
means, so that ``smoothness`` has no unit and does not depend on the number of samples. The normal
equations are added up over stretches of the records.

What the operators over the half plane ``alpha >= beta`` share: levels and cells.
"""

import dataclasses
import time
from abc import abstractmethod
from numbers import Integral, Real

import numpy as np
from scipy.linalg import cholesky, eigh
from scipy.linalg.lapack import dpocon, dpotri
from scipy.sparse import coo_array
from sklearn.utils.validation import check_array

from .._sklearn import Interval, StrOptions
from ..base import ParametricModel
from ..optimize import IdentificationResult, nonnegative_minimum

__all__ = [
    "RelayGridModel",
    "cell_indices",
    "check_grid",
]


def cell_indices(n_levels):
    """Return the intervals of alpha and of beta of each cell, two arrays (n (n - 1) / 2,)."""
    return np.tril_indices(n_levels - 1)


def check_grid(operator):
    """Turn array fields into read-only arrays; refuse levels and weights that do not fit."""
    kind = type(operator).__name__
    for name in ("levels", "weights", "reversible"):
        if hasattr(operator, name):
            constant = np.array(getattr(operator, name), dtype=float, ndmin=1)
            constant.flags.writeable = False
            object.__setattr__(operator, name, constant)
    levels, weights = operator.levels, operator.weights
    if levels.ndim != 1 or levels.size < 2 or not np.all(levels[1:] > levels[:-1]):
        raise ValueError(
            f"The 'levels' parameter of {kind} must be a list of two or more ascending values. "
            f"Got {levels!r} instead."
        )
    n_cells = levels.size * (levels.size - 1) // 2
    if weights.shape != (n_cells,):
        raise ValueError(
            f"The 'weights' parameter of {kind} must have one value for each of the {n_cells} "
            f"cells between {levels.size} levels. Got shape {weights.shape} instead."
        )


_STRETCH = 1024  # rows of the design matrix at a time
_BINS = 200  # of the drive, to see where the response changes
_SILENT = 1e-13  # mean square of a column, of 1, below which it has not moved
_RIDGE = 1e-12  # relative to the scaled diagonal; keeps exactly collinear columns solvable
_SINGULAR = 1e-11  # relative eigenvalue of the scaled normal equations


class RelayGridModel(ParametricModel):
    """Base of the models whose weights lie on a grid over the half plane."""

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "n_levels": [Interval(Integral, 2, None, closed="left")],
        "levels": [StrOptions({"grid", "response"}), "array-like"],
        "smoothness": [Interval(Real, 0, None, closed="left")],
        "non_negative": ["boolean"],
        "fit_intercept": ["boolean"],
        "center": [Interval(Real, None, None, closed="both")],
    }

    series_rank = 10
    _diagonal_is_reversible = False  # the cells (i, i) have no loop

    @abstractmethod
    def _operator(self, levels):
        """Return the operator over a grid, all weights zero."""

    def _levels(self, records):
        if not isinstance(self.levels, str):
            return check_array(self.levels, ensure_2d=False, dtype=np.float64)
        low = min(record.u.min() for record in records)
        high = max(record.u.max() for record in records)
        if not np.all(np.diff(np.linspace(low, high, _BINS + 1)) > 0.0):  # the drive rests
            half = max(abs(low), abs(high)) or 1.0
            return np.linspace(low - half, high + half, self.n_levels)
        if self.levels == "grid":
            return np.linspace(low, high, self.n_levels)
        return _response_levels(records, np.linspace(low, high, _BINS + 1), self.n_levels)

    def starting_values(self, records):
        return [(self._operator(self._levels(records)), ())]

    def held_parameters(self):
        return frozenset() if self.fit_intercept else frozenset({"intercept"})

    def _identify(self, data):
        begin = time.perf_counter()
        operator = self._operator(self._levels(data))
        problem = _WeightProblem(operator, data, self._free_run_state(), self.fit_intercept)
        weights, std, undetermined, condition = problem.solve(
            _roughness(operator.levels.size, problem.n_weights, self._diagonal_is_reversible),
            self.smoothness,
            self.non_negative,
        )
        operator = operator.unpack(np.append(weights, problem.intercept(weights)))
        cost = problem.cost(operator)
        deviation = np.sqrt(cost / max(problem.n_samples - problem.freedom, 1.0))
        std[np.isfinite(std)] *= deviation
        names = [name for name, _ in operator.entries()][: len(std)]
        return IdentificationResult(
            operator=operator,
            disturbances=(),
            params=dict(zip(names, operator.pack().tolist(), strict=False)),
            params_std=dict(zip(names, std.tolist(), strict=True)),
            undetermined=tuple(names[i] for i in np.flatnonzero(undetermined)),
            condition_number=condition,
            record_coefficients=np.empty((len(data), 0)),
            error=float(np.sqrt(cost / problem.n_samples)),
            n_evaluations=1,
            seconds=time.perf_counter() - begin,
            converged=True,
            message="All parameters are linear and were solved exactly.",
            history=[(1, cost)],
            x=operator.pack()[: len(std)],
        )

    def _finish(self, result, data):
        super()._finish(result, data)
        if self.initial_state == "estimate":  # the search for histories refits without penalty
            drives = zip(data, self.initial_drive_, strict=True)
            data = [dataclasses.replace(record, before=float(u)) for record, u in drives]
            self._adopt(self._identify(data))
        return self

    def _adopt(self, result):
        super()._adopt(result)
        self.levels_ = np.array(self.operator_.levels)
        self.weights_ = np.array(self.operator_.weights)
        self.intercept_ = float(self.operator_.intercept)
        return self


def _response_levels(records, edges, n_levels):
    """Return levels between which the drive and the response change by equal shares.

    The response is averaged over each passage of the drive through a bin, so that its noise adds
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
    place = np.append(0.0, np.cumsum(weight))
    return np.interp(np.linspace(0.0, place[-1], n_levels), place, edges)


def _roughness(n_levels, n_weights, diagonal_is_reversible):
    """Return the matrix of the penalty.

    Reversible weights are neighbours of each other only: those of the diagonal, or else those
    behind the cells, if any.
    """
    i, j = cell_indices(n_levels)
    number = np.full((n_levels, n_levels), -1)
    number[i, j] = np.arange(i.size)
    scale = np.ones(n_weights)
    if diagonal_is_reversible:
        line = number.diagonal()[:-1].copy()
        number[np.diag_indices_from(number)] = -1
    else:
        line = np.arange(i.size, n_weights)
        scale[number.diagonal()[:-1]] = 2.0
    here = number[i, j]
    first = np.concatenate((here, here, line[:-1]))
    second = np.concatenate((number[i + 1, j], number[i, j + 1], line[1:]))
    both = (first >= 0) & (second >= 0)
    first, second = first[both], second[both]
    row = np.arange(first.size)
    difference = coo_array(
        (
            np.concatenate((scale[first], -scale[second])),
            (np.tile(row, 2), np.concatenate((first, second))),
        ),
        shape=(first.size, n_weights),
    ).tocsr()
    return (difference.T @ difference).tocoo()


class _WeightProblem:
    """The normal equations of all weights."""

    def __init__(self, operator, records, initial_state, fit_intercept):
        self.records, self.initial_state = records, initial_state
        self.n_weights = operator.n_parameters - 1
        self.fit_intercept = fit_intercept
        self.n_samples = sum(record.segment_weights().sum() for record in records)
        mean = sum(_weights(record) @ record.y for record in records) / self.n_samples
        self.shift = mean if fit_intercept else 0.0
        gram = np.zeros((self.n_weights + 2,) * 2)
        for record in records:
            self._add(operator, record, gram)
        n = self.n_weights
        self.mean = gram[n, :n] / self.n_samples
        self.gram = gram[:n, :n]
        spread = self.gram.diagonal() - self.n_samples * self.mean**2
        self.silent = spread <= _SILENT * self.n_samples
        self.power = max(spread.mean(), 0.0) if n else 0.0
        self.right = gram[n + 1, :n]
        if fit_intercept:
            self.gram = self.gram - self.n_samples * np.outer(self.mean, self.mean)
            self.right = self.right - self.mean * gram[n + 1, n]
            self.gram[self.silent] = 0.0
            self.gram[:, self.silent] = 0.0
            self.right[self.silent] = 0.0

    def _add(self, operator, record, gram):
        """Add the Gram matrix of ``[A, 1, y]`` over the rows of a record that count."""
        state = operator.init(_first(record), self.initial_state)
        if record.before is not None:
            _, state = operator.run([record.before], record.dt, state)
        weights = _weights(record)
        counts, roots = weights > 0.0, np.sqrt(weights)
        for start in range(0, len(record.u), _STRETCH):
            part = slice(start, start + _STRETCH)
            rows, state = operator.basis(record.u[part], state)
            rows = np.column_stack((rows, record.y[part] - self.shift))[counts[part]]
            if record.weights is not None:
                rows *= roots[part][counts[part], None]
            gram += rows.T @ rows

    def solve(self, roughness, smoothness, non_negative):
        """Return weights, standard errors per unit of noise, what is undetermined, condition.

        Sets ``freedom``, the effective number of parameters. The standard errors are those of the
        penalised estimate; what the penalty pulls away from the truth is not in them.
        """
        matrix = self.gram.copy()
        matrix[roughness.coords] += smoothness * self.power * roughness.data
        scale = np.sqrt(matrix.diagonal())
        moves = scale > 0.0
        index = np.flatnonzero(moves)
        scale = scale[moves]
        matrix = matrix[np.ix_(moves, moves)] / np.outer(scale, scale)
        matrix[np.diag_indices_from(matrix)] += _RIDGE
        weights, undetermined = np.zeros(self.n_weights), self.silent.copy()
        if not non_negative:
            bounded = np.zeros(index.size, dtype=bool)
        else:
            bounded = np.ones(index.size, dtype=bool)
        solution, free = nonnegative_minimum(matrix, -self.right[moves] / scale, bounded)
        weights[moves] = solution / scale
        free &= (solution > 0.0) | ~bounded
        std = np.where(self.silent, np.inf, np.nan)
        index, scale, matrix = index[free], scale[free], matrix[np.ix_(free, free)]
        if smoothness > 0.0:
            inverse, condition = _inverse(matrix)
        else:
            inverse, condition, unknown = _pseudo_inverse(matrix)
            undetermined[index[unknown]] = True
        data = self.gram[np.ix_(index, index)] / np.outer(scale, scale)
        resolution = inverse @ data
        covariance = resolution @ inverse
        self.freedom = float(np.trace(resolution)) + self.fit_intercept
        std[index] = np.sqrt(np.maximum(covariance.diagonal(), 0.0)) / scale
        std[undetermined] = np.inf
        if self.fit_intercept:
            mean = self.mean[index] / scale
            std = np.append(std, np.sqrt(1.0 / self.n_samples + mean @ covariance @ mean))
        return weights, std, undetermined, condition

    def intercept(self, weights):
        return self.shift - self.mean @ weights if self.fit_intercept else 0.0

    def cost(self, operator):
        """Return the sum of squares of the residual, from the residual itself."""
        cost = 0.0
        for record in self.records:
            state = operator.init(_first(record), self.initial_state)
            if record.before is not None:
                _, state = operator.run([record.before], record.dt, state)
            residual = operator.run(record.u, record.dt, state)[0] - record.y
            cost += _weights(record) @ residual**2
        return float(cost)


def _weights(record):
    """Return how much each sample of a record counts, (n_samples,)."""
    weights = np.zeros(len(record.u))
    for start, stop in record.segments:
        weights[start:stop] = 1.0 if record.weights is None else record.weights[start:stop]
    return weights


def _first(record):
    return record.u[0] if record.before is None else record.before


def _inverse(matrix):
    """Return the inverse of a positive definite matrix and its condition number."""
    if not len(matrix):
        return matrix, 1.0
    factor = cholesky(matrix)
    reciprocal, _ = dpocon(factor, np.abs(matrix).sum(axis=0).max())
    inverse, _ = dpotri(factor)
    inverse = np.triu(inverse)
    return inverse + np.triu(inverse, 1).T, _condition(reciprocal)


def _pseudo_inverse(matrix):
    """Return the inverse where the matrix has one, condition number, unknowns without one."""
    if not len(matrix):
        return matrix, 1.0, np.zeros(0, dtype=bool)
    values, vectors = eigh(matrix)
    small = values < _SINGULAR * values[-1]
    inverse = np.where(small, 0.0, 1.0 / np.where(small, 1.0, values))
    unknown = (np.abs(vectors[:, small]) > 0.1).any(axis=1)
    return (vectors * inverse) @ vectors.T, _condition(values[0] / values[-1]), unknown


def _condition(reciprocal):
    return float(1.0 / reciprocal) if reciprocal > np.finfo(float).tiny else np.inf
