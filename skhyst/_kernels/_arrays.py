"""The one kind of array that kernels get as a signal."""

import numpy as np

__all__ = ["as_signal"]


def as_signal(values):
    """Return a contiguous read-only view of floats, copied only where needed.

    A kernel is compiled once for each kind of array; a column of a frame is read-only, an array
    mostly is not.
    """
    signal = np.ascontiguousarray(values, dtype=float).view()
    signal.flags.writeable = False
    return signal
