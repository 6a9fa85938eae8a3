r"""Limits of a drive: its range, and how fast it may change.

Sample by sample, a drive that is too fast is followed with delay, at the largest rate allowed. Over
a whole record, the signal within the rate limit that is closest to a drive ``u``, by the largest
difference, is the mean of the largest such signal below it and the smallest above it,

.. math:: \tfrac12 \min_j (u_j + c |k - j|) + \tfrac12 \max_j (u_j - c |k - j|),

with the largest change ``c`` from sample to sample (McShane, *Bulletin of the American
Mathematical Society*, 1934).
"""

import math
from dataclasses import dataclass

import numpy as np

from .._jit import jit
from ..operators import CompiledLaw


@jit
def range_step(u, c, s):
    """Return the drive within its range.

    ``c`` is (lowest, highest). ``s`` is 1 where the drive is at a limit, else 0: an inverse by root
    finding stops at the limit by itself, so that clipping alone would not show it.
    """
    low, high = c
    s[0] = 1.0 if u <= low or u >= high else 0.0
    return min(max(u, low), high)


@jit
def limit_step(u, c, s):
    """Return the drive within its range, and within its largest change from the last sample.

    ``c`` is (lowest, highest, largest change, rounding). ``s`` is the drive of the last sample, and
    1 where the drive is at a limit or more than rounding was cut, else 0.
    """
    low, high, change, rounding = c
    y = min(max(u, low), high)
    y = min(max(y, s[0] - change), s[0] + change)
    s[0] = y
    s[1] = 1.0 if u <= low or u >= high or abs(u - y) > rounding else 0.0
    return y


@jit
def slow_down(u, change, low, high):
    """Write the signal nearest to ``u`` (n,) within a rate limit to ``low``.

    ``change`` is the largest change per sample, ``high`` (n,) is work space. The first value stays.
    """
    n = u.size
    low[0] = high[0] = u[0]
    for k in range(1, n):
        low[k] = min(u[k], low[k - 1] + change)
        high[k] = max(u[k], high[k - 1] - change)
    for k in range(n - 2, -1, -1):
        low[k] = min(low[k], low[k + 1] + change)
        high[k] = max(high[k], high[k + 1] - change)
    high[0] = low[0] = u[0]
    for k in range(1, n):
        middle = 0.5 * (low[k] + high[k])
        low[k] = min(max(middle, low[k - 1] - change), low[k - 1] + change)
    return 0.0


@dataclass(frozen=True)
class DriveLimits:
    """Limits of a drive.

    Parameters
    ----------
    low, high : float
        Units of the drive.
    rate : float
        Units of the drive per s.
    rounding : float, default=0.0
        Excess over the limits below which nothing is reported, units of the drive.
    """

    low: float = -math.inf
    high: float = math.inf
    rate: float = math.inf
    rounding: float = 0.0

    def __bool__(self):
        """Whether anything is limited."""
        return (self.low, self.high, self.rate) != (-math.inf, math.inf, math.inf)

    def __str__(self):
        parts = []
        if (self.low, self.high) != (-math.inf, math.inf):
            parts.append(f"{self.low:.6g} to {self.high:.6g}")
        if not math.isinf(self.rate):
            parts.append(f"{self.rate:.6g} per s")
        return ", ".join(parts)

    def compiled_step(self, dt, u0):
        """Return one step, from rest at ``u0``; its flag ``limited`` is raised at a limit."""
        change, start = self.rate * dt, min(max(u0, self.low), self.high)
        if math.isinf(change):
            constants = self.low, self.high
            flags = (("limited", 0),)
            return CompiledLaw(range_step, constants, [0.0], flags=flags, limited=(0, 1))
        constants, flags = (self.low, self.high, change, self.rounding), (("limited", 1),)
        return CompiledLaw(
            limit_step, constants, [start, 0.0], flags=flags, limited=(0, 1, 2), held=(0,)
        )

    def applied(self, drive, dt):
        """Return the nearest drive (n_samples,) within the limits, from rest at its first value."""
        drive = np.clip(drive, self.low, self.high)
        if math.isinf(self.rate):
            return drive
        slower = np.empty_like(drive)
        slow_down(drive, self.rate * dt, slower, np.empty_like(drive))
        return slower

    def exceeded(self, drive, dt):
        """Return a mask (n_samples,) of the samples of a drive beyond the limits."""
        beyond = (drive < self.low - self.rounding) | (drive > self.high + self.rounding)
        beyond[1:] |= np.abs(np.diff(drive)) > self.rate * dt + self.rounding
        return beyond
