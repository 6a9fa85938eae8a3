"""Inputs and output of a step of a fitted model, with their ranges in the fit."""

import numpy as np

from ._validation import drive_column
from .operators import Signal


def drive_signal(estimator, name="drive"):
    """Return the drive with the range and the rate of the fit, where they are known."""
    low, high = getattr(estimator, "drive_range_", (-np.inf, np.inf))
    return Signal(name, low, high, getattr(estimator, "drive_rate_", np.inf))


def input_signals(estimator, n_inputs):
    """Return the signals that a step of a fitted model takes.

    Parameters
    ----------
    estimator : estimator
        Fitted; the step reads the columns of its X from the first on.
    n_inputs : int or None
        Number of columns that it reads; None for the drive alone.

    Returns
    -------
    tuple of Signal
        By the names of the columns where they have names.
    """
    drive = drive_column(estimator)
    names = list(getattr(estimator, "feature_names_in_", ()))
    if n_inputs is None:
        return (drive_signal(estimator, str(names[drive]) if names else "drive"),)
    known = [str(name) for name in names[:n_inputs]]
    known += [f"column {k}" if k != drive else "drive" for k in range(len(known), n_inputs)]
    return tuple(
        drive_signal(estimator, name) if k == drive else Signal(name)
        for k, name in enumerate(known)
    )
