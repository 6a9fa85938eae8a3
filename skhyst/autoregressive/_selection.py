r"""Which terms a model needs: orthogonal regression on condensed data.

A linear least-squares problem :math:`y = \Phi \theta` with many candidate columns is condensed once
to the triangular factor ``R`` of :math:`[\Phi, y]`. Every subset of the columns has the same
solution and the same sum of squares in ``R`` as in the data, so the search costs the same for a
thousand samples as for a million, and squares no condition number as normal equations do.

The search starts with forward orthogonal regression (Chen, Billings and Luo, Int. J. Control 50,
1989): the column that explains most of what is left is taken, and all others are made orthogonal to
it. Greedy steps may pick a column that stands for two others, so the result is then refined by
single removals, additions and exchanges for as long as the criterion falls.
"""

import numpy as np
from scipy.linalg import qr, solve_triangular

__all__ = ["Criterion", "Search", "condense", "error_reduction", "subset_solution"]

_CHUNK = 4096  # rows that are condensed at once
_COLLINEAR = 1e-8  # part of a column that must be left for it to count as new
_SINGULAR = 1e-14  # the same, where a subset that was asked for is solved
_FLOOR = 1e-24  # part of the sum of squares of y below which there is only rounding
_MARGIN = 1e-9  # a criterion has fallen when it has by this part of the number of samples
_BEYOND = 6  # terms that the forward search goes on beyond the best number
_ROUNDS = 200


def condense(blocks, factor=None):
    """Return the triangular factor of all blocks of rows (n, p + 1), on top of a known one."""
    for block in blocks:
        for start in range(0, len(block), _CHUNK):
            part = block[start : start + _CHUNK]
            part = part if factor is None else np.concatenate([factor, part])
            factor = qr(part, mode="r", check_finite=False)[0][: part.shape[1]]
    return factor


def subset_solution(factor, subset):
    """Return the coefficients, the inverse of the triangle and the sum of squares of a subset.

    Where the subset is collinear, the coefficients are the smallest and the inverse is infinite.
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
    """Return a subset in the order of forward regression, and each term's part of y'y."""
    columns = factor[:, list(subset)].copy()
    rest = factor[:, -1].copy()
    total = rest @ rest
    left = list(range(len(subset)))
    order, parts = [], []
    for _ in range(len(subset)):
        gains = _gains(columns[:, left], rest)
        best = left[int(np.argmax(gains))]
        order.append(subset[best])
        parts.append(float(max(gains.max(), 0.0) / total) if total > 0.0 else 0.0)
        left.remove(best)
        q = _unit(columns[:, best])
        rest -= q * (q @ rest)
        columns[:, left] -= np.outer(q, q @ columns[:, left])
    return order, parts


def _unit(column):
    norm = np.linalg.norm(column)
    return column / norm if norm > 0.0 else column


def _gains(columns, rest):
    squares = np.einsum("ij,ij->j", columns, columns)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(squares > 0.0, (columns.T @ rest) ** 2 / squares, 0.0)


class Criterion:
    """What a search makes small: a penalised likelihood, or the error in folds left out.

    Parameters
    ----------
    name : {"ebic", "bic", "aic", "aicc", "cv"}
    n_samples : int
        Number of samples.
    n_candidates : int
        Number of candidate terms, which ``"ebic"`` pays for.
    scale : float
        Sum of squares of the target.
    """

    def __init__(self, name, n_samples, n_candidates, scale):
        self.name, self.n_samples, self.n_candidates = name, n_samples, n_candidates
        self.floor = _FLOOR * scale

    def __call__(self, rest, size):
        """Return the criterion of a sum of squares with a number of terms."""
        n, p = self.n_samples, self.n_candidates
        if size >= n - 2:
            return np.inf
        value = n * np.log(max(rest, self.floor, np.finfo(float).tiny) / n)
        if self.name == "aic":
            return value + 2.0 * size
        if self.name == "aicc":
            return value + 2.0 * size * n / (n - size - 1.0)
        value += size * np.log(n)
        if self.name == "ebic":
            value += 2.0 * size * np.log(p)
        return value


class Search:
    """Search for the best subset of the columns of condensed data.

    Parameters
    ----------
    folds : list of ndarray of shape (p + 1, p + 1)
        Condensed parts of the data; one is enough but for cross-validation.
    criterion : Criterion
    forced : sequence of int
        Columns that are in every subset.
    """

    def __init__(self, folds, criterion, forced=()):
        self.factor = folds[0] if len(folds) == 1 else condense(folds)
        norms = np.linalg.norm(self.factor[:, :-1], axis=0)
        self.norms = np.where(norms > 0.0, norms, 1.0)
        self.candidates = np.flatnonzero(norms > 0.0)
        self.criterion, self.forced = criterion, list(forced)
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
            self.known[key] = self._value(sorted(subset))
        return self.known[key]

    def _value(self, subset):
        if not self.folds:
            return self.criterion(subset_solution(self.factor, subset)[2], len(subset))
        return self._logarithm(self._fold_errors(subset).sum())

    def rest(self, subset):
        """Return the criterion without its price for terms."""
        return self._logarithm(subset_solution(self.factor, subset)[2])

    def _logarithm(self, rest):
        n = self.criterion.n_samples
        return n * np.log(max(rest, self.criterion.floor, np.finfo(float).tiny) / n)

    def _fold_errors(self, subset):
        """Return the sum of squares in each fold of the fit to the others."""
        errors = [
            fold[:, -1] - fold[:, subset] @ subset_solution(others, subset)[0]
            for fold, others in zip(self.folds, self.others, strict=True)
        ]
        return np.array([error @ error for error in errors])

    def best(self, n_terms=None):
        """Return the best subset, or the best one of ``n_terms`` columns that can be found."""
        limit = len(self.candidates) if n_terms is None else n_terms
        path, lowest, size = list(self.forced), np.inf, len(self.forced)
        for found in self._forward(path, limit):
            value = self.value(found) if n_terms is None else -len(found)
            if value < lowest:
                lowest, size = value, len(found)
            if n_terms is None and len(found) > 2 * size + _BEYOND:
                break
            path = found
        if self.folds and n_terms is None:
            path = path[: self._simplest(path, size)]
        if self.folds or n_terms is not None:
            return self.refine(path, moves=("exchange",))
        starts = [path[:size], self._backward(path)]
        return min((self.refine(start) for start in starts), key=self.value)

    def _simplest(self, path, size):
        """Return the smallest number of terms that is worse by less than its standard error.

        The fold errors have a flat minimum; its place is chance.
        """
        least, n_folds = self._fold_errors(path[:size]), len(self.folds)
        for fewer in range(len(self.forced), size):
            excess = self._fold_errors(path[:fewer]) - least
            if excess.sum() <= np.sqrt(n_folds) * excess.std(ddof=1):
                return fewer
        return size

    def _forward(self, subset, limit):
        """Yield growing subsets, each with the column that explains most of what is left."""
        columns = self.factor[:, :-1] / self.norms
        rest = self.factor[:, -1].copy()
        subset = list(subset)
        for column in subset:
            rest = _deflate(columns, rest, columns[:, column].copy())
        yield list(subset)
        while len(subset) < limit:
            squares = np.einsum("ij,ij->j", columns, columns)
            squares[subset] = 0.0
            fresh = squares > _COLLINEAR**2
            if not fresh.any():
                return
            with np.errstate(divide="ignore", invalid="ignore"):
                gains = np.where(fresh, (columns.T @ rest) ** 2 / squares, -1.0)
            column = int(np.argmax(gains))
            subset.append(column)
            # a second time: what is left of a nearly collinear column is rounding in part
            rest = _deflate(columns, rest, columns[:, column].copy())
            yield list(subset)

    def _backward(self, subset):
        """Return the best of the subsets that are left as the weakest terms go one by one."""
        best = current = list(subset)
        while len(current) > len(self.forced):
            current = self._without_weakest(current)
            if self.value(current) < self.value(best):
                best = current
        return best

    def _without_weakest(self, subset):
        coefficients, inverse, _ = subset_solution(self.factor, subset)
        losses = coefficients**2 / np.einsum("ij,ij->i", inverse, inverse)
        losses[[i for i, column in enumerate(subset) if column in self.forced]] = np.inf
        weakest = int(np.argmin(losses))
        return subset[:weakest] + subset[weakest + 1 :]

    def _with_best(self, subset):
        """Return the subset with the column that explains most of what it leaves, or None."""
        scaled = self.factor[:, :-1] / self.norms
        rest = self.factor[:, -1]
        if subset:
            q = qr(scaled[:, subset], mode="economic", check_finite=False)[0]
            scaled = scaled - q @ (q.T @ scaled)
            rest = rest - q @ (q.T @ rest)
        squares = np.einsum("ij,ij->j", scaled, scaled)
        squares[subset] = 0.0
        fresh = squares > _COLLINEAR**2
        if not fresh.any():
            return None
        with np.errstate(divide="ignore", invalid="ignore"):
            gains = np.where(fresh, (scaled.T @ rest) ** 2 / squares, -1.0)
        return [*subset, int(np.argmax(gains))]

    def refine(self, subset, moves=("removal", "addition", "exchange"), rounds=_ROUNDS):
        """Return a subset that no single move improves."""
        current = list(subset)
        exchanged_by = self.value if "removal" in moves else self.rest
        for _ in range(rounds):
            trials = []
            if "removal" in moves and len(current) > len(self.forced):
                trials.append(self._without_weakest(current))
            if "addition" in moves:
                trials.append(self._with_best(current))
            better = self._better(trials, current, exchanged_by)
            if better is None:
                kept = [column for column in current if column not in self.forced]
                trials = [self._with_best([c for c in current if c != out]) for out in kept]
                better = self._better(trials, current, exchanged_by)
            if better is None:
                break
            current = better
        return current

    def _better(self, trials, current, value):
        values = [np.inf if trial is None else value(trial) for trial in trials]
        if values and min(values) < value(current) - _MARGIN * self.criterion.n_samples:
            return trials[int(np.argmin(values))]
        return None


def _deflate(columns, rest, direction):
    """Make all columns, in place, and the rest orthogonal to a direction; return the rest."""
    q = _unit(direction)
    columns -= np.outer(q, q @ columns)
    return rest - q * (q @ rest)
