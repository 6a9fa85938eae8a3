"""Numbers of a record that parameters may depend on."""

import numpy as np

__all__ = ["amplitude", "is_held"]

_CONSTANT = 1e-3  # spread of a column within a record, relative to its size


def amplitude(drive):
    """Return half the range of a record's drive."""
    return 0.5 * float(np.ptp(drive))


def is_held(values, size):
    """Whether a column, of which ``size`` is the largest magnitude, is constant in a record."""
    return bool(np.ptp(values) <= _CONSTANT * size)
