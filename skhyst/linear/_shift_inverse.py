r"""The inverse of a shift in time by a part of a sample: that of its interpolation.

Each sample of the response is a sum of four of the drive. Their weights are the rows of a matrix
that has as many columns, which is solved from the opposite shift on, as in Fong and Saunders,
*SIAM Journal on Scientific Computing*, 2011. What of the drive no response tells of stays as the
opposite shift has it: what comes too late, and, behind a shift by half a sample, what alternates
from sample to sample. Samples of the response that read the drive before the record are taken as
the opposite shift has them, since no drive within it makes them what they should be: with the least
sum of squares it would alternate for long.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.linalg import lsmr

from ..operators import InverseOperator, LoweredStep, as_signal, in_weights, preview_step

_ROUNDING = 1e-15
_PASSES = 400  # at most
_LARGEST = 1e3  # by which noise may grow where the interpolation hardly lets anything through
_LONGEST = 64  # samples to either side that a step reads, beside those of the shift


@dataclass(frozen=True)
class InverseShiftOperator(InverseOperator):
    """From a signal that was shifted in time to the one before.

    Parameters
    ----------
    operator : DelayOperator or TimeShiftOperator

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import DelayOperator
    >>> delay = DelayOperator(0.37)
    >>> drive = np.sin(0.5 * np.arange(100)) * np.sin(np.linspace(0.0, np.pi, 100)) ** 4
    >>> y, _ = delay.run(drive, 1.0)
    >>> back, _ = delay.inverse().run(y, 1.0)
    >>> bool(np.abs(delay.run(back, 1.0)[0] - y).max() < 1e-12)
    True
    """

    signal_linear = True
    causal = False

    def init(self, u0, initial_state="rest"):
        """Return nothing: a record is inverted as a whole; see the base."""
        return None

    def run(self, u, dt, state=None):
        """Return the drive that gives a response (n_samples,) from rest; see the base."""
        y = as_signal(u)
        n, first = len(y), self.operator.opposite().run(y, dt)[0]
        places, weights = self.operator.read_at(n, dt)
        columns = np.clip(places[:, None] + np.arange(4), 0, n - 1)
        rows = np.repeat(np.arange(n), 4)
        matrix = csr_array((weights.ravel(), (rows, columns.ravel())), shape=(n, n))
        y = np.where(places < 0, matrix @ first, y)
        limits = {"atol": _ROUNDING, "btol": _ROUNDING, "conlim": _LARGEST, "maxiter": _PASSES}
        return lsmr(matrix, y, x0=first, **limits)[0], None

    def ahead(self, dt, u0, tol=1e-9):
        """Return one step that is fed the response some samples ahead, and their number.

        The drive is a sum over what is near, which :meth:`run` tells of a single sample. Shifts by
        nearly half a sample make it long: where it is too long, the opposite shift takes its place.
        """
        opposite = self.operator.opposite()
        if opposite.skew:
            return super().ahead(dt, u0, tol)
        half = _LONGEST + math.ceil(abs(opposite.shift) / dt)
        answer = self.run(np.eye(1, 2 * half + 1, half)[0], dt)[0]
        if abs(answer.sum() - 1.0) > tol:  # it has not died out at the ends
            return opposite.ahead(dt, u0, tol)
        left_out = np.cumsum(np.abs(answer)), np.cumsum(np.abs(answer[::-1]))
        begin, end = (int(np.argmax(part > 0.5 * tol)) for part in left_out)
        begin = min(begin, half)  # what is there at once is not waited for
        weights = answer[begin : len(answer) - end][::-1]
        nothing = np.zeros((0, 0)), np.zeros(0), np.zeros(0), 0.0
        state = [0.0, *np.full(len(weights), u0)]
        constants = weights / weights.sum(), *nothing
        return LoweredStep(preview_step, constants, state, possible=in_weights), half - begin
