r"""The free run of an operator over records, and its standard error.

To first order a run :math:`y(\theta)` has the variance :math:`\mathrm{diag}(J C J^T)`, with its
sensitivities :math:`J` and the covariance :math:`C` of :math:`\theta`. With a root
:math:`C = L L^T` these are the sums of squares of the rows of :math:`J L`, whose columns are
derivatives in the directions of L.
"""

import warnings

import numpy as np

from ..exceptions import DivergenceWarning
from ._composition import split_disturbances

_LARGEST = 1 << 24  # values of sensitivities in memory at once: 128 MB
_CHUNK = 4096  # samples whose derivatives are multiplied by the root at once
_STEP = 0.01  # step of a difference in standard errors; its relative error is the square of it


def run_records(operator, signal, slices, initial_state="rest", schedules=None):
    """Return the outputs of an operator for the records of a signal, (n_samples,), all finite.

    The signal is (n_samples,), or (n_samples, n_inputs) for an operator of several inputs;
    ``schedules`` are numbers for scheduled parameters, one per record, or None.
    """
    signal = np.ascontiguousarray(signal)
    parts = []
    with np.errstate(over="ignore", invalid="ignore"):  # divergence is reported below
        for record, schedule in zip(slices, schedules or [None] * len(slices), strict=True):
            u = signal[record.rows]
            of_record = operator if schedule is None else operator.at(schedule)
            parts.append(of_record.run(u, record.dt, of_record.init(u[0], initial_state))[0])
        y = parts[0] if len(parts) == 1 else np.concatenate(parts)
    return cut_off(y)


def cut_off(y):
    """Return an output with non-finite values replaced, and warn if there were any."""
    with np.errstate(over="ignore", invalid="ignore"):
        # one pass in the usual case; the sum may overflow although the values are finite
        is_finite = np.isfinite(y.sum()) or np.isfinite(y).all()
    if not is_finite:
        warnings.warn(
            "The simulation diverged; values beyond the range of floating point were cut off.",
            DivergenceWarning,
            stacklevel=4,
        )
        y = np.nan_to_num(y)
    return y


def run_variance(operator, covariance, u, dt, initial_state="rest", skip=0, by_start=None):
    """Return the variance of an operator's output due to the errors of its parameters.

    Derivatives are exact; for records so long that they need too much memory, they are central
    differences along the columns of the root of the covariance, one at a time.

    Parameters
    ----------
    operator : Operator
        With its additive disturbances.
    covariance : ndarray of shape (n_parameters + n_start, n_parameters + n_start)
        Of the values of ``pack``, and of how the record begins where this is estimated.
    u : ndarray of shape (n_samples,) or (n_samples, n_inputs)
        Input.
    dt : float
        Sampling interval in s.
    initial_state : {"rest", "zero"}, default="rest"
        State before the first sample.
    skip : int, default=0
        Samples of the input before the start of the record and of its time.
    by_start : ndarray of shape (n_samples - skip, n_start), default=None
        Derivatives of the output by how the record begins.

    Returns
    -------
    ndarray of shape (n_samples - skip,)
        Square of the unit of the response.
    """
    driven, additive = split_disturbances(operator)
    root, count = _root(covariance), driven.n_parameters
    time = dt * np.arange(len(u) - skip)
    signals = [np.empty((len(time), 0))]
    for disturbance in additive:
        signals += [
            disturbance.basis(time),
            disturbance.basis_tangents(time, np.ravel(disturbance.coefficients)),
        ]
    signals += [] if by_start is None else [by_start]
    signals = np.concatenate(signals, axis=1)
    if len(u) * count > _LARGEST:
        variance = np.zeros(len(time))
        for part in root.T:
            slope = _slope(driven, part[:count], u, dt, initial_state)[skip:]
            variance += np.square(slope + signals @ part[count:])
        return variance
    _, slopes = driven.sensitivities(u, np.empty((len(u), 0)), dt, initial_state)
    slopes, variance = slopes[skip:], np.empty(len(time))
    for start in range(0, len(time), _CHUNK):
        rows = slice(start, start + _CHUNK)
        parts = slopes[rows] @ root[:count] + signals[rows] @ root[count:]
        variance[rows] = np.square(parts).sum(axis=1)
    return variance


def _root(covariance):
    """Return the root (n, k) of a covariance (n, n) of rank k."""
    size = np.sqrt(np.diag(covariance))
    used = np.flatnonzero(size)
    root, size = np.zeros((len(size), len(used))), size[used, None]
    values, vectors = np.linalg.eigh(covariance[np.ix_(used, used)] / size / size.T)
    root[used] = size * vectors * np.sqrt(np.maximum(values, 0.0))
    return root


def _slope(operator, direction, u, dt, initial_state):
    """Return the derivative of a run in a direction of the parameters, by central differences."""
    values = operator.pack()
    lower, upper = np.transpose([(spec.lower, spec.upper) for _, spec in operator.entries()])
    ends = []
    for step in (-_STEP, _STEP):
        moved = operator.unpack(np.clip(values + step * direction, lower, upper))
        ends.append(moved.run(u, dt, moved.init(u[0], initial_state))[0])
    return (ends[1] - ends[0]) / (2.0 * _STEP)
