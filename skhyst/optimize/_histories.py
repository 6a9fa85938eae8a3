"""What a record's device went through before the record: one rest position a record."""

import dataclasses

import numpy as np

from ._identify import identify
from ._problem import OperatorProblem

__all__ = ["estimate_histories"]

_CANDIDATES = 33  # rest positions tried a record
_ROUNDS = 3


def estimate_histories(result, records, *, fixed=(), method="variable_projection"):
    """Refit with the drive at which the device had rested before each record as an unknown.

    The output depends on it piecewise smoothly at best, so it is searched on a grid over the
    drive's range (and zero), with the parameters held; the parameters follow.

    Parameters
    ----------
    result : IdentificationResult
        A fit from rest at each record's first value.
    records : sequence of RecordData
    fixed : collection of str
    method : str or Method, default="variable_projection"

    Returns
    -------
    result : IdentificationResult
    before : ndarray of shape (n_records,)
        Drive before each record, units of the drive.
    """
    records = list(records)
    low = min(record.u.min() for record in records)
    high = max(record.u.max() for record in records)
    grid = np.unique(np.r_[0.0, np.linspace(low, high, _CANDIDATES)])
    evaluations = result.n_evaluations
    for _ in range(_ROUNDS):
        chosen = []
        for record in records:
            trials = [record.u[0] if record.before is None else record.before, *grid]
            errors = []
            for value in trials:
                trial = dataclasses.replace(record, before=float(value))
                problem = OperatorProblem(
                    result.operator, [trial], disturbances=result.disturbances
                )
                gram = problem.total(problem.evaluate(problem.x0, jacobian=False))
                errors.append(gram[-1, -1])
            chosen.append(dataclasses.replace(record, before=float(trials[np.argmin(errors)])))
        evaluations += len(trials)
        same = all(a.before == b.before for a, b in zip(chosen, records, strict=True))
        records = chosen
        start = [(result.operator, result.disturbances)]
        result = identify(start, records, fixed=fixed, method=method)
        evaluations += result.n_evaluations
        if same:
            break
    result = dataclasses.replace(result, n_evaluations=evaluations)
    return result, np.array([record.before for record in records])
