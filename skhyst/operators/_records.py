"""The free run of an operator over records."""

import warnings

import numpy as np

from ..exceptions import DivergenceWarning


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
            own = operator if schedule is None else operator.at(schedule)
            parts.append(own.run(u, record.dt, own.init(u[0], initial_state))[0])
        y = parts[0] if len(parts) == 1 else np.concatenate(parts)
        # one pass in the usual case; the sum may overflow although the values are finite
        is_finite = np.isfinite(y.sum()) or np.isfinite(y).all()
    if not is_finite:
        warnings.warn(
            "The simulation diverged; values beyond the range of floating point were cut off.",
            DivergenceWarning,
            stacklevel=3,
        )
        y = np.nan_to_num(y)
    return y
