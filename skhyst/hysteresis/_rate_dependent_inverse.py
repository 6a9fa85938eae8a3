"""The inverse of plays that follow the rate of the drive.

With the rates known it is exact (Al Janaideh and Krejčí 2013). Here the rates are those of the
drive that is sought, which is found by repetition, beginning with the inverse at rest, as long as
the response comes closer. Repetition amplifies fast changes of the rate, as the root of each sample
would, so the rates are smoothed over windows of time, ever smaller ones.

What is left is worked off by damped least squares over stretches of the record, of each of which
the first half is kept, since what comes determines the drive too. Damping, as in Levenberg,
*Quarterly of Applied Mathematics*, 1944, keeps noise from growing by more than its inverse. Where
the motion turns, the response has a corner at the last drive: it may have no drive for a value near
by, and a part of the error stays.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from ..operators import InverseOperator, as_signal

_PASSES = 40  # of the inverse with one window, at most
_GAIN = 0.99  # part of the error that a pass must leave at most, for another one
_ENOUGH = 1e-12  # of the range
_STRETCH = 400  # samples: of what its end has wrong a zero at 1.1 leaves 1e-8 in the first half
_DIFFERENCE = 1e-7  # of the range of the drive: some roots of rounding
_DAMPING = 1e-4  # of the mean slope
_STEPS, _TRIALS = 20, 8  # of the least squares; of the damping of a step


@dataclass(frozen=True)
class RateDependentInverseOperator(InverseOperator):
    """From the response of plays that follow the rate of the drive to a drive that gives it."""

    causal = False

    def init(self, u0, initial_state="rest"):
        """Return the initial state by name: a record is inverted as a whole; see the base."""
        return initial_state

    def run(self, u, dt, state=None):
        """Return the drive (n_samples,) for a response, which begins in the state; see the base."""
        y, plays, initial_state = as_signal(u), self.operator, state or "rest"
        fastest = plays.fastest_monotone()

        def advance(rates):
            drive = plays.drive_at_rates(y, np.minimum(rates, fastest))
            back, _ = plays.run(drive, dt, plays.init(drive[0], initial_state))
            return drive, np.linalg.norm(back - y)

        best, smallest = advance(np.zeros(y.size))
        for half in [*(2 ** np.arange(max(y.size // 4, 1).bit_length())[::-1]), 0]:
            drive = best
            for _ in range(_PASSES):
                velocities = uniform_filter1d(np.diff(drive, prepend=drive[0]), 2 * half + 1) / dt
                if initial_state == "zero":
                    velocities[0] = drive[0] / dt
                drive, error = advance(plays.paces(velocities, dt)[0])
                gained = error < _GAIN * smallest
                if error < smallest:
                    best, smallest = drive, error
                if not gained:
                    break
        return self._polished(best, y, dt, plays.init(best[0], initial_state)), None

    def _polished(self, drive, y, dt, state):
        """Return a drive with a smaller error, stretch by stretch; all but the last overlap."""
        drive, enough = drive.copy(), _ENOUGH * np.ptp(y)
        for begin in range(0, len(y), _STRETCH // 2):
            part = slice(begin, begin + _STRETCH)
            is_last = part.stop >= len(y)
            drive[part] = self._improved(drive[part], y[part], dt, state, enough)
            _, state = self.operator.run(drive[begin : begin + _STRETCH // 2], dt, state)
            if is_last:
                break
        return drive

    def _improved(self, drive, y, dt, state, enough):
        """Return a drive whose squared error is less."""

        def left(u):
            return self.operator.run(u, dt, state)[0] - y

        error, change, damping = left(drive), _DIFFERENCE * (np.ptp(drive) or 1.0), _DAMPING
        for _ in range(_STEPS):
            if np.abs(error).max() <= enough:
                break
            matrix = [left(drive + change * unit) - error for unit in np.eye(len(y))]
            matrix = np.stack(matrix, axis=1) / change
            square = matrix.T @ matrix
            size = np.trace(square) / len(y) * np.eye(len(y))
            before = error @ error
            for _halving in range(_TRIALS):
                trial = drive - np.linalg.solve(square + damping**2 * size, matrix.T @ error)
                found = left(trial)
                if found @ found < before:
                    break
                damping *= 4.0
            else:
                break
            drive, error, damping = trial, found, max(0.25 * damping, _DAMPING)
            if not error @ error < _GAIN**2 * before:
                break
        return drive
