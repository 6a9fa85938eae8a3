"""Turning points of a drive."""

import numpy as np

from ..hysteresis import PrandtlIshlinskiiOperator
from ._constants import NOTICEABLE


def turns(u):
    """Return the samples at which a signal reverses by more than a twentieth of its range."""
    r = 0.5 * NOTICEABLE * np.ptp(u)
    if not r > 0.0:
        return np.empty(0, dtype=int)
    ways = np.diff(PrandtlIshlinskiiOperator([r], [1.0], drive_offset=float(u[0])).run(u, 1.0)[0])
    moving = np.flatnonzero(ways)
    rising = ways[moving] > 0.0
    return 1 + moving[:-1][rising[1:] != rising[:-1]]
