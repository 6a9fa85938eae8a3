r"""Term selection: orthogonal regression on condensed data.

A linear least-squares problem :math:`y = \Phi \theta` with many candidate columns is condensed once
to the triangular factor ``R`` of :math:`[\Phi, y]`. Every subset of the columns has the same
solution and the same sum of squares in ``R`` as in the data, so the search costs the same for a
thousand samples as for a million, and does not square the condition number as normal equations do.

The search starts with forward orthogonal regression (Chen, Billings and Luo, *International Journal
of Control*, 1989): the column that explains most of the residual is selected, and all others are
made orthogonal to it. Greedy steps may select one column in place of two others, so the result is
refined by single removals, additions and exchanges as long as the criterion decreases.
"""

from itertools import pairwise

import numpy as np
from scipy.linalg import qr, solve_triangular

from ..exceptions import RecordError

_CHUNK = 4096  # rows that are condensed at once
_FOLDS = 5
_COLLINEAR = 1e-8  # least fraction of a candidate column that is orthogonal to the selected ones
_SINGULAR = 1e-14  # the same in the solution of a given subset
_FLOOR = 1e-24  # fraction of the sum of squares of y below which there is only rounding
_MARGIN = 1e-9  # least decrease of a criterion that counts, per sample
_BEYOND = 6  # the forward search ends this many terms beyond twice the best number
_ROUNDS = 200  # largest number of moves of a refinement


def condense(blocks):
    """Return the triangular factor of all blocks of rows (n, p + 1)."""
    factor = None
    for block in blocks:
        for start in range(0, len(block), _CHUNK):
            part = block[start : start + _CHUNK]
            part = part if factor is None else np.concatenate([factor, part])
            factor = qr(part, mode="r", check_finite=False)[0][: part.shape[1]]
    return factor


def condense_folds(sizes, left_out, block):
    """Return the condensed data of each fold of records, one fold where none is left out.

    ``sizes`` are the numbers of rows of the records; ``block`` returns the rows of a slice.
    """
    ends = np.cumsum(sizes)
    parts = [(end - size, end) for end, size in zip(ends, sizes, strict=True)]
    n_folds = 1
    if left_out:
        if len(parts) == 1:  # fifths of a single record
            parts = [(a, b) for a, b in pairwise(np.linspace(0, sizes[0], _FOLDS + 1, dtype=int))]
            parts = [(a, b) for a, b in parts if b > a]
        n_folds = min(_FOLDS, len(parts))
        if n_folds < 2:
            raise RecordError(
                "The records must have at least two samples beyond the longest lag where "
                "'criterion' is 'cv'. Got one instead."
            )
    return [
        condense(
            block(slice(first, min(first + _CHUNK, b)))
            for a, b in parts[fold::n_folds]
            for first in range(a, b, _CHUNK)
        )
        for fold in range(n_folds)
    ]


def subset_solution(factor, subset):
    """Return the coefficients, the inverse of the triangular factor and the sum of squares.

    Where the subset is collinear, the coefficients are those of minimum norm and the inverse is
    infinite.
    """
    subset = list(subset)
    r = qr(factor[:, [*subset, -1]], mode="r", check_finite=False)[0]
    k = len(subset)
    rest = float(np.sum(r[k:, -1] ** 2))
    if k == 0:
        return np.empty(0), np.empty((0, 0)), rest
    norms = np.linalg.norm(r[:k, :k], axis=0)
    if not np.all(np.abs(np.diag(r)[:k]) > _SINGULAR * norms):
        norms[norms == 0.0] = 1.0
        solution = np.linalg.lstsq(r[:, :k] / norms, r[:, -1], rcond=_SINGULAR)[0] / norms
        rest = float(np.sum((r[:, -1] - r[:, :k] @ solution) ** 2))
        return solution, np.full((k, k), np.inf), rest
    inverse = solve_triangular(r[:k, :k], np.eye(k), check_finite=False)
    return inverse @ r[:k, -1], inverse, rest


def error_reduction(factor, subset):
    """Return a subset in the order of forward regression, and each term's fraction of y'y."""
    columns, rest = factor[:, list(subset)].copy(), factor[:, -1].copy()
    total = rest @ rest
    remaining, order, ratios = list(range(len(subset))), [], []
    while remaining:
        gains = _gains(columns[:, remaining], rest, 0.0)
        best = remaining.pop(int(np.argmax(gains)))
        order.append(subset[best])
        ratios.append(float(max(gains.max(), 0.0) / total) if total > 0.0 else 0.0)
        rest = _deflate(columns, rest, best)
    return order, ratios


def _gains(columns, rest, least):
    """Return the reduction of the sum of squares of ``rest`` by each column.

    It is -1 for columns whose sum of squares is at most ``least``.
    """
    squares = np.einsum("ij,ij->j", columns, columns)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(squares > least, (columns.T @ rest) ** 2 / squares, -1.0)


def _best_column(columns, rest, taken):
    """Return the column that explains most of ``rest``, None if all are collinear or taken."""
    gains = _gains(columns, rest, _COLLINEAR**2)
    gains[taken] = -1.0
    return int(np.argmax(gains)) if (gains >= 0.0).any() else None


def _deflate(columns, rest, best):
    """Make all columns, in place, and ``rest`` orthogonal to one of them; return ``rest``."""
    norm = np.linalg.norm(columns[:, best])
    q = columns[:, best] / (norm if norm > 0.0 else 1.0)
    columns -= np.outer(q, q @ columns)
    return rest - q * (q @ rest)


class SelectionCriterion:
    """What a search minimises: a penalised likelihood, or the cross-validation error (``"cv"``).

    ``"ebic"`` also penalises the number of candidates; ``scale`` is the target's sum of squares.
    """

    def __init__(self, name, n_samples, n_candidates, scale):
        self.name, self.n_samples, self.n_candidates = name, n_samples, n_candidates
        self.floor = _FLOOR * scale

    def likelihood(self, rest):
        """Return the criterion of a sum of squares without the penalty for terms."""
        least = max(self.floor, np.finfo(float).tiny)
        return self.n_samples * np.log(max(rest, least) / self.n_samples)

    def __call__(self, rest, size):
        """Return the criterion of a sum of squares with a number of terms."""
        n, value = self.n_samples, self.likelihood(rest)
        if size >= n - 2:
            return np.inf
        if self.name == "aic":
            return value + 2.0 * size
        if self.name == "aicc":
            return value + 2.0 * size * n / (n - size - 1.0)
        value += size * np.log(n)
        if self.name == "ebic":
            value += 2.0 * size * np.log(self.n_candidates)
        return value


class Search:
    """Search for the best subset of the columns of condensed data.

    The folds are condensed parts of the data; one suffices except for cross-validation.
    """

    def __init__(self, folds, criterion):
        self.factor = folds[0] if len(folds) == 1 else condense(folds)
        norms = np.linalg.norm(self.factor[:, :-1], axis=0)
        self.columns = self.factor[:, :-1] / np.where(norms > 0.0, norms, 1.0)
        self.criterion = criterion
        self.folds = folds if criterion.name == "cv" else ()
        self.others = [
            condense([part for j, part in enumerate(self.folds) if j != i])
            for i in range(len(self.folds))
        ]
        self.known = {}

    def value(self, subset):
        """Return the criterion of a subset."""
        key = frozenset(subset)
        if key not in self.known:
            subset = sorted(subset)
            if self.folds:
                self.known[key] = self.criterion.likelihood(self._fold_errors(subset).sum())
            else:
                self.known[key] = self.criterion(self._rest(subset), len(subset))
        return self.known[key]

    def _rest(self, subset):
        return subset_solution(self.factor, subset)[2]

    def _fold_errors(self, subset):
        """Return the sum of squares in each fold of the fit to the others."""
        errors = [
            fold[:, -1] - fold[:, subset] @ subset_solution(others, subset)[0]
            for fold, others in zip(self.folds, self.others, strict=True)
        ]
        return np.array([error @ error for error in errors])

    def best(self, n_terms=None):
        """Return the best subset, or the best one of ``n_terms`` columns that can be found."""
        path, lowest, size = [], np.inf, 0
        for subset in self._forward(self.columns.shape[1] if n_terms is None else n_terms):
            value = self.value(subset) if n_terms is None else -len(subset)
            if value < lowest:
                lowest, size = value, len(subset)
            if n_terms is None and len(subset) > 2 * size + _BEYOND:
                break
            path = subset
        if self.folds and n_terms is None:
            path = path[: self._simplest(path, size)]
        if self.folds or n_terms is not None:
            return self.refine(path, sized=True)
        # forward selection may keep a term that later ones make needless, backward elimination not
        starts = [path[:size], self._backward(path)]
        return min((self.refine(start) for start in starts), key=self.value)

    def _simplest(self, path, size):
        """Return the smallest number of terms that is worse by at most one standard error.

        The minimum of the fold errors is flat, so its exact position is chance.
        """
        errors, n_folds = self._fold_errors(path[:size]), len(self.folds)
        for fewer in range(size):
            excess = self._fold_errors(path[:fewer]) - errors
            if excess.sum() <= np.sqrt(n_folds) * excess.std(ddof=1):
                return fewer
        return size

    def _forward(self, limit):
        """Yield growing subsets, each with the column that explains most of the residual."""
        columns, rest, subset = self.columns.copy(), self.factor[:, -1], []
        yield []
        while len(subset) < limit:
            column = _best_column(columns, rest, subset)
            if column is None:
                return
            rest = _deflate(columns, rest, column)
            subset = [*subset, column]
            yield subset

    def _backward(self, subset):
        """Return the best of the subsets from which the weakest terms are removed one by one."""
        best = current = list(subset)
        while current:
            current = self._without_weakest(current)
            if self.value(current) < self.value(best):
                best = current
        return best

    def _without_weakest(self, subset):
        coefficients, inverse, _ = subset_solution(self.factor, subset)
        weakest = int(np.argmin(coefficients**2 / np.einsum("ij,ij->i", inverse, inverse)))
        return subset[:weakest] + subset[weakest + 1 :]

    def _with_best(self, subset):
        """Return the subset with the column that explains most of its residual, or None."""
        columns, rest = self.columns, self.factor[:, -1]
        if subset:
            q = qr(columns[:, subset], mode="economic", check_finite=False)[0]
            columns, rest = columns - q @ (q.T @ columns), rest - q @ (q.T @ rest)
        column = _best_column(columns, rest, subset)
        return None if column is None else [*subset, column]

    def refine(self, subset, *, sized=False, rounds=_ROUNDS):
        """Return a subset that no single move improves; ``sized`` keeps the number of terms."""
        current = list(subset)
        # exchanges keep the number of terms, so that the penalty is the same
        value = self._likelihood if sized else self.value
        for _ in range(rounds):
            trials = [] if sized or not current else [self._without_weakest(current)]
            trials += [] if sized else [self._with_best(current)]
            better = self._better(trials, current, value)
            if better is None:
                trials = [self._with_best([c for c in current if c != out]) for out in current]
                better = self._better(trials, current, value)
            if better is None:
                break
            current = better
        return current

    def _likelihood(self, subset):
        return self.criterion.likelihood(self._rest(subset))

    def _better(self, trials, current, value):
        values = [np.inf if trial is None else value(trial) for trial in trials]
        if values and min(values) < value(current) - _MARGIN * self.criterion.n_samples:
            return trials[int(np.argmin(values))]
        return None
