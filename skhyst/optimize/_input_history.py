"""What the drive did before a record, where a device had not rested at its first value.

What a device remembers of its drive it remembers the more coarsely the longer it is ago: a mode
knows the last few periods, creep the decades before, a hysteresis its largest turns. So the drive
before a record is a straight line between values at 1, 2, 4, ... samples before it, up to half of
the record, with a rest at the first of them. With the parameters held, each record has its own
least-squares problem.

The output depends on these values piecewise smoothly at best: plays that did not move do not tell
where they would have turned. So the search begins with the best few of a rest and pasts that the
record itself has seen, or with the best one where one of them is known from before. In turn it
steps in one value after the other, the longest ago first, and descends along the derivatives, which
the operator carries from its input. What the record does not tell is kept at rest: to change by the
whole range from one value to the next costs as much as the mean sample leaves.

The parameters come first from the later half of each record, of which its start tells least. Then
both are identified in turn, the parameters with what a change of these values would add to each
record taken out.

Each of these goes on while the sum of squares falls by more than chance would let it: of n samples
of noise, k values are expected to take the part k / n.
"""

from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from ._identify import identify
from ._problem import OperatorProblem, ages, scheduled

_THIRDS = 3.0 ** -np.arange(1, 5)  # of the limits: the range of the drive, to a few per cent of it
_STEPS = np.outer(_THIRDS, (1.0, -1.0)).ravel()
_DEPTH = 3  # evaluations a value, of a descent: with one, one record of 30 misses its minimum
# of 25 records of plays, one start misses the minimum in 3, and three starts in none
_STARTS = 3  # where nothing is known
_FAR = 1e10  # what a run that diverges leaves, relative to the response


def estimate_input_history(
    operator, disturbances, records, *, fixed=(), method="variable_projection"
):
    """Identify parameters and the drive before each record.

    Parameters
    ----------
    operator, disturbances : Operator, sequence of DisturbanceOperator
        A fit from rest at each record's first value, or from known input_history.
    records : sequence of RecordData
    fixed : collection of str
    method : str or Method, default="variable_projection"

    Returns
    -------
    result : IdentificationResult
    input_history : ndarray of shape (n_records, n_values)
        Drive 1, 2, 4, ... samples before each record, in its units.
    """
    count = _count(records)
    records = [r if _is_known(r, count) else replace(r, before=None) for r in records]
    start = [(operator, disturbances)]
    best = identify(start, records, fixed=fixed, method=method)
    late = [
        replace(r, weights=r.counts() * (np.arange(len(r.u)) >= len(r.u) // 2)) for r in records
    ]
    chance = count * len(records) / sum(record.counts().sum() for record in records)
    result, evaluations, gain = identify(start, late, fixed=fixed, method=method), 0, 1.0
    while gain > chance:
        operator, disturbances = result.operator, result.disturbances
        found, runs = input_history_of(operator, disturbances, records)
        trial = [replace(r, before=own) for r, own in zip(records, found, strict=True)]
        result = identify([(operator, disturbances)], trial, fixed=fixed, method=method)
        evaluations += runs + result.n_evaluations
        gain = 1.0 - (result.error / best.error) ** 2 if best.error > 0.0 else 0.0
        if gain > 0.0:
            records, best = trial, result
        if gain > chance:
            problem = OperatorProblem(best.operator, records, disturbances=best.disturbances)
            loose = [replace(r, beside=problem.carried(best.operator, r)) for r in records]
            start = [(best.operator, best.disturbances)]
            result = identify(start, loose, fixed=fixed, method=method)
    input_history = np.array([_rest(r, count) if r.before is None else r.before for r in records])
    return replace(best, n_evaluations=best.n_evaluations + evaluations), input_history


def with_input_history(result, records, method="variable_projection"):
    """Return what identification found, fitted again together with the drive before each record.

    What it has held is held again; see :func:`estimate_input_history`.
    """
    fixed = {name for name, _ in result.operator.entries()} - set(result.params)
    found, drives = estimate_input_history(
        result.operator, result.disturbances, records, fixed=fixed, method=method
    )
    evaluations = result.n_evaluations + found.n_evaluations
    return replace(found, n_evaluations=evaluations, input_history=drives)


def _count(records):
    """Return how many values of the drive before a record are asked for."""
    longest = max(len(record.u) for record in records)
    return int(np.log2(max(longest // 2, 1))) + 1


def _is_known(record, count):
    """Whether so many values of the drive before a record are given."""
    return record.before is not None and np.size(record.before) == count


def _rest(record, count):
    """Return the drive before a record that begins at rest."""
    return np.full(count, record.drive[0])


def input_history_of(operator, disturbances, records):
    """Return the drive before each record with the parameters held, and how often all were run.

    ``input_history`` is (n_records, n_values).
    """
    drives = [record.drive for record in records]
    low, high = min(u.min() for u in drives), max(u.max() for u in drives)
    # what came before may have gone as far again
    limits, count = (2.0 * low - high, 2.0 * high - low), _count(records)
    problem = OperatorProblem(operator, records, disturbances=disturbances)
    found = [_history(problem, record, limits, count) for record in problem.records]
    return np.array([own for own, _ in found]), max(runs for _, runs in found)


def _history(problem, record, limits, count):
    """Return the drive before one record, and the number of runs that it took."""
    low, high = limits
    size = high - low
    if not size > 0.0:
        return np.full(count, low), 0
    misfit = _Misfit(problem, record, low, size)
    starts = _starts(record, low, size, count)
    left = np.array([misfit.cost(start) for start in starts])
    misfit.hold(left.min())
    # many pasts leave the same: what their changes cost tells them apart
    left += [np.square(misfit.changes(start)).sum() for start in starts]
    order = np.argsort(left)[: 1 if _is_known(record, count) else _STARTS]
    chance = count / max(record.counts().sum(), 1.0)
    best, _ = min((_searched(misfit, starts[i], chance) for i in order), key=lambda own: own[1])
    return low + size * best, misfit.runs


def _starts(record, low, size, count):
    """Return what may have come before a record, relative to the limits."""
    drive, back = (record.drive - low) / size, ages(np.empty(count))
    starts = [np.full(count, drive[0])]
    if _is_known(record, count):
        starts.append(np.clip((record.before - low) / size, 0.0, 1.0))
    # pasts of its own, as many as there are steps in all values
    for now in np.linspace(back[-1], len(drive), count * len(_STEPS)).astype(int):
        starts.append(drive[np.clip(now - back, 0, len(drive) - 1)])
    return starts


def _searched(misfit, values, chance):
    """Return the minimum near a start, and its sum of squares."""
    before, least = np.inf, misfit.cost(values)
    while least < (1.0 - chance) * before:
        before = least
        values, least = misfit.descended(*misfit.stepped(values, least))
    return values, least


class _Misfit:
    """What a record leaves as a function of the drive before it, relative to the limits."""

    def __init__(self, problem, record, low, size):
        self._problem, self._low, self._size = problem, low, size
        self._operator = scheduled(problem.operator, record)
        self._record = replace(record, schedule=None)
        self._root, self._basis = np.sqrt(record.counts()), None
        if problem.disturbances:
            columns = self._root[:, None] * problem.basis(problem.disturbances, record)
            self._basis = np.linalg.qr(columns)[0]
        self._scale = np.linalg.norm(self._root * record.y) or 1.0
        self._last = (record.drive[0] - low) / size
        self._stiffness = 0.0
        self.runs = 0

    def hold(self, least):
        """Let changes from value to value cost as much as the mean sample leaves of the least."""
        self._stiffness = np.sqrt(least / len(self._root))

    def changes(self, values):
        """Return what changes from value to value count beside what the response leaves."""
        return self._stiffness * np.diff(values, prepend=self._last)

    def __call__(self, values):
        record = self._begun(values)
        left = self._left(self._problem.simulate(self._operator, record) - record.y)
        return np.nan_to_num(np.concatenate([left, self.changes(values)]), nan=_FAR, posinf=_FAR)

    def _begun(self, values):
        self.runs += 1
        return replace(self._record, before=self._low + self._size * values)

    def _left(self, part):
        """Return what is left of columns of the response, relative to it."""
        part = (part.T * (self._root / self._scale)).T
        return part if self._basis is None else part - self._basis @ (self._basis.T @ part)

    def _derivatives(self, values):
        part = self._problem.carried(self._operator, self._begun(values))
        count = len(values)
        changes = self._stiffness * (np.eye(count) - np.eye(count, k=-1))
        found = np.concatenate([self._left(self._size * part), changes])
        return np.nan_to_num(found, posinf=0.0, neginf=0.0)

    def cost(self, values):
        """Return the sum of squares."""
        left = self(values)
        return left @ left

    def stepped(self, values, least):
        """Return the best that steps in one value after the other reach, and its sum of squares."""
        for place in range(len(values))[::-1]:
            for step in _STEPS:
                trial = values.copy()
                trial[place] = np.clip(values[place] + step, 0.0, 1.0)
                cost = self.cost(trial)
                if cost < least:
                    values, least = trial, cost
        return values, least

    def descended(self, values, least):
        """Return the minimum that a trust-region search reaches, and its sum of squares."""
        inside = np.clip(values, 1e-6, 1.0 - 1e-6)
        found = least_squares(
            self, inside, jac=self._derivatives, bounds=(0.0, 1.0), max_nfev=_DEPTH * len(values)
        )
        return (found.x, 2.0 * found.cost) if 2.0 * found.cost < least else (values, least)
