"""How well records determine the gain at rest of a chain of relaxing units."""

import numpy as np

from ..disturbance import DriftOperator
from ..operators import SumOperator
from ..optimize import OperatorProblem
from ._dynamics import FirstOrderLagOperator

__all__ = ["static_gain_error"]

_SLOWER = 10.0  # the unit that may have been missed, in durations of the longest record
_SILENT = 1e-11  # part of a column's power that rounding leaves
_SINGULAR = 1e-12  # relative eigenvalue of the scaled normal equations
_TOUCHED = 1e-3  # part of the gradient along a direction without information


def static_gain_error(operator, records, *, fixed=(), initial_state="rest", error):
    """Return the standard error of the static gain, infinite where the data do not determine it.

    A unit far slower than the records may act beside those of the model, so the gain at rest is
    known only as far as the records would have shown such a unit. What it was before a record is
    unknown unless the record starts from zero, so a constant and a trend of each record tell
    nothing.

    Parameters
    ----------
    operator : KelvinVoigtOperator
        The fitted chain.
    records : sequence of RecordData
    fixed : collection of str
        Names of entries that were held.
    initial_state : {"rest", "zero"}
    error : float
        Root mean square of the residual, units of the response.

    Returns
    -------
    float
        Response units over drive units.
    """
    span = max(len(record.u) * record.dt for record in records)
    slow = FirstOrderLagOperator(_SLOWER * span, gain=0.0, hold=operator.hold)
    held = {f"model__{name}" for name in fixed} | {"slow__time_constant", "slow__intercept"}
    disturbances = ()
    if initial_state == "rest":
        disturbances = (DriftOperator(np.zeros(2), span),)
        held.add("model__intercept")
    problem = OperatorProblem(
        SumOperator(("model", "slow"), (operator, slow)),
        records,
        disturbances=disturbances,
        fixed=held,
        initial_state=initial_state,
    )
    blocks = problem.evaluate(problem.x0)
    gram = problem.total(blocks)[:-1, :-1]
    slope = np.zeros(len(problem.names))
    for i, name in enumerate(problem.names):
        if name.startswith("model__compliances"):
            slope[i] = operator.gain
        elif name == "model__gain":
            slope[i] = 1.0 + np.sum(operator.compliances)
        elif name == "slow__gain":
            slope[i] = 1.0
    power = np.diag(gram)
    silent = power <= _SILENT * problem.powers(blocks)
    if slope[silent].any():
        return np.inf
    kept = np.flatnonzero(~silent)
    scale = np.sqrt(power[kept])
    values, vectors = np.linalg.eigh(gram[np.ix_(kept, kept)] / np.outer(scale, scale))
    parts = vectors.T @ (slope[kept] / scale)
    lost = values < _SINGULAR * values[-1]
    if np.linalg.norm(parts[lost]) > _TOUCHED * np.linalg.norm(parts):
        return np.inf
    return float(error * np.sqrt(np.sum(parts[~lost] ** 2 / values[~lost])))
