"""What the drive did before a record, where a device had not rested at its first value.

What a device remembers of its drive it remembers the more coarsely the longer it is ago: a mode
knows the last few periods, creep the decades before, a hysteresis its largest turns. So the drive
before a record is a straight line between values at 1, 2, 4, ... samples before it, up to half of
the record, with a rest at the first of them. With the parameters held, each record has its own
least-squares problem.

The output depends on these values piecewise smoothly at best: plays that did not move do not tell
where they would have turned. So rests at many levels, with some way from there, and pasts that the
record itself has seen are tried; the best few are searched on by steps of all sizes in one value
after the other, and by a trust-region search. What the record does not tell is kept at rest: to
change by the whole range from one value to the next costs as much as the mean sample leaves.

The parameters come first from the later half of each record, of which its start tells least. Then
both are identified in turn, the parameters with what a change of these values would add to each
record taken out.
"""

from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from ._identify import identify
from ._problem import OperatorProblem

_LEVELS = 17  # of a rest, over three times the range of the drive
_PASTS = 50  # of the record itself, which are tried as what came before it
_STARTS = 3
_SWEEPS = 3
_STEPS = np.outer(2.0 ** -np.arange(8), (1.0, -1.0)).ravel()  # relative to the limits
_EVALUATIONS, _FEW = 30, 5  # of each trust-region search, and of one that is not thorough
_ROUNDS = 5
_FAR = 1e10  # what a run that diverges leaves, relative to the response
_STILL = 0.01  # part by which the error falls that is worth another round


def estimate_histories(operator, disturbances, records, *, fixed=(), method="variable_projection"):
    """Identify parameters and the drive before each record.

    Parameters
    ----------
    operator, disturbances : Operator, sequence of DisturbanceOperator
        A fit from rest at each record's first value, or from known histories.
    records : sequence of RecordData
    fixed : collection of str
    method : str or Method, default="variable_projection"

    Returns
    -------
    result : IdentificationResult
    histories : ndarray of shape (n_records, n_values)
        Drive 1, 2, 4, ... samples before each record, in its units.
    """
    count = _count(records)
    records = [r if np.size(r.before) == count else _rested(r, count) for r in records]
    start = [(operator, disturbances)]
    best = identify(start, records, fixed=fixed, method=method)
    late = [
        replace(r, weights=r.counts() * (np.arange(len(r.u)) >= len(r.u) // 2)) for r in records
    ]
    result, evaluations = identify(start, late, fixed=fixed, method=method), 0
    for _ in range(_ROUNDS):
        operator, disturbances = result.operator, result.disturbances
        found, runs = histories_of(operator, disturbances, records)
        trial = [replace(r, before=own) for r, own in zip(records, found, strict=True)]
        result = identify([(operator, disturbances)], trial, fixed=fixed, method=method)
        evaluations += runs + result.n_evaluations
        gain = 1.0 - result.error / best.error if best.error > 0.0 else 0.0
        if gain > 0.0:
            records, best = trial, result
        if gain < _STILL:
            break
        problem = OperatorProblem(best.operator, records, disturbances=best.disturbances)
        loose = [replace(r, beside=_tangents(problem, r)) for r in records]
        start = [(best.operator, best.disturbances)]
        result = identify(start, loose, fixed=fixed, method=method)
    histories = np.array([record.before for record in records])
    return replace(best, n_evaluations=best.n_evaluations + evaluations), histories


def _count(records):
    """Return how many values of the drive before a record are asked for."""
    longest = max(len(record.u) for record in records)
    return int(np.log2(max(longest // 2, 1))) + 1


def _rested(record, count):
    """Return the record after a rest at its first value."""
    return replace(record, before=np.full(count, record.drive[0]))


def _tangents(problem, record):
    """Return the derivatives of the output by what came before a record, (n, n_values)."""
    step = 1e-6 * (np.ptp(np.concatenate([record.drive, record.before])) or 1.0)
    sides = [
        [
            problem.simulate(problem.operator, replace(record, before=record.before + change))
            for change in (own, -own)
        ]
        for own in step * np.eye(len(record.before))
    ]
    return np.stack([(a - b) / (2.0 * step) for a, b in sides], axis=1)


def histories_of(operator, disturbances, records, *, thorough=True):
    """Return the drive before each record with the parameters held, and how often all were run.

    ``histories`` is (n_records, n_values). If not ``thorough``, the best of those that are tried at
    first is followed down, and no more.
    """
    drives = [record.drive for record in records]
    low, high = min(u.min() for u in drives), max(u.max() for u in drives)
    # what came before may have gone as far again
    limits, count = (2.0 * low - high, 2.0 * high - low), _count(records)
    problem = OperatorProblem(operator, records, disturbances=disturbances)
    found = [_history(problem, record, limits, count, thorough) for record in problem.records]
    return np.array([own for own, _ in found]), max(runs for _, runs in found)


def _history(problem, record, limits, count, thorough):
    """Return the drive before one record, and the number of runs that it took."""
    low, high = limits
    size = high - low
    if not size > 0.0:
        return np.full(count, low), 0
    misfit = _Misfit(problem, record, low, size)
    starts = sorted(_starts(record, low, size, count), key=misfit.cost)[:_STARTS]
    misfit.hold(starts[0])
    if thorough:
        starts = [_searched(misfit, start) for start in starts]
    else:
        starts = [starts[0], misfit.polished(starts[0], _FEW)]
    best = min(starts, key=misfit.cost)
    return low + size * best, misfit.runs


def _starts(record, low, size, count):
    """Return what may have come before a record, relative to the limits."""
    drive, age = (record.drive - low) / size, np.arange(count)
    starts = [np.full(count, drive[0])]
    if np.size(record.before) == count:
        starts.append(np.clip((record.before - low) / size, 0.0, 1.0))
    for way in (0, count // 2, count - 1):  # values from the rest to the record
        part = np.minimum(age / max(way, 1), 1.0) if way else np.ones(count)
        starts += [drive[0] + (level - drive[0]) * part for level in np.linspace(0.0, 1.0, _LEVELS)]
    back = 2**age
    for now in np.linspace(back[-1], len(drive), _PASTS).astype(int):  # pasts of its own
        starts.append(drive[np.clip(now - back, 0, len(drive) - 1)])
    return starts


def _searched(misfit, values):
    """Return the minimum near a start: by steps of all sizes in each value, and by descent."""
    values = misfit.polished(values)
    for _ in range(_SWEEPS):
        before = misfit.cost(values)
        at, least = values.copy(), before
        for place in range(len(values))[::-1]:
            here = at.copy()
            for step in _STEPS:
                trial = here.copy()
                trial[place] = np.clip(here[place] + step, 0.0, 1.0)
                cost = misfit.cost(trial)
                if cost < least:
                    at, least = trial, cost
        values = min(values, misfit.polished(at), key=misfit.cost)
        if misfit.cost(values) > (1.0 - _STILL) * before:
            break
    return values


class _Misfit:
    """What a record leaves as a function of the drive before it, relative to the limits."""

    def __init__(self, problem, record, low, size):
        self._problem, self._record, self._low, self._size = problem, record, low, size
        self._root, self._basis = np.sqrt(record.counts()), None
        if problem.disturbances:
            columns = self._root[:, None] * problem.basis(problem.disturbances, record)
            self._basis = np.linalg.qr(columns)[0]
        self._scale = np.linalg.norm(self._root * record.y) or 1.0
        self._last = (record.drive[0] - low) / size
        self._stiffness = 0.0
        self.runs = 0

    def hold(self, values):
        """Let changes from value to value cost as much as the mean sample leaves here."""
        self._stiffness = 0.0
        self._stiffness = np.sqrt(self.cost(values) / len(self._root))

    def __call__(self, values):
        self.runs += 1
        record = replace(self._record, before=self._low + self._size * values)
        left = self._root * (self._problem.simulate(self._problem.operator, record) - record.y)
        if self._basis is not None:
            left -= self._basis @ (self._basis.T @ left)
        changes = self._stiffness * np.diff(values, prepend=self._last)
        return np.nan_to_num(np.concatenate([left / self._scale, changes]), nan=_FAR, posinf=_FAR)

    def cost(self, values):
        """Return the sum of squares."""
        left = self(values)
        return left @ left

    def polished(self, values, evaluations=_EVALUATIONS):
        """Return the minimum that a trust-region search reaches."""
        inside = np.clip(values, 1e-6, 1.0 - 1e-6)
        return least_squares(self, inside, bounds=(0.0, 1.0), max_nfev=evaluations).x
