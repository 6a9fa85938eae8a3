r"""The inverse of a fractional shift in time: the inverse of its interpolation.

Each sample of the response is a weighted sum of four of the drive. The weights are the rows of a
square sparse matrix; the linear system is solved by LSMR (Fong and Saunders, *SIAM Journal on
Scientific Computing*, 2011), started from the opposite shift. Components that the response does not
determine remain as in this start: the end of the drive, which a delay moves out of the record, and,
for a shift by half a sample, alternation from sample to sample. Samples of the response that depend
on the drive before the record are replaced by those of the start, since no drive within the record
can reproduce them: the least-squares solution would alternate over many samples.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.linalg import lsmr

from ..operators import InverseOperator, as_signal, previewed

_ROUNDING = 1e-15
_PASSES = 400  # largest number of iterations
_LARGEST = 1e3  # limit of the condition number: largest amplification of noise
_LONGEST = 64  # samples to either side that a step reads, in addition to those of the shift


@dataclass(frozen=True)
class InverseShiftOperator(InverseOperator):
    """Inverse of a shift in time: from the shifted signal to the original one.

    Parameters
    ----------
    operator : DelayOperator or TimeShiftOperator

    Examples
    --------
    If the drive rests during the first few samples, the shift is undone to rounding:

    >>> import numpy as np
    >>> from skhyst.linear import DelayOperator
    >>> delay = DelayOperator(0.37)
    >>> motion = np.sin(0.5 * np.arange(100)) * np.sin(np.linspace(0.0, np.pi, 100)) ** 4
    >>> drive = np.append(np.zeros(6), motion)
    >>> y, _ = delay.run(drive, 1.0)
    >>> back, _ = delay.inverse().run(y, 1.0)
    >>> bool(np.abs(delay.run(back, 1.0)[0] - y).max() < 1e-12)
    True
    """

    signal_linear = True
    causal = False

    def init(self, u0, initial_state="rest"):
        """Return None: a record is inverted at once; see the base."""
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
        """Return a step with preview of the response, and the preview in samples.

        The step is a finite impulse response filter, the response of :meth:`run` to an impulse. For
        shifts by nearly half a sample it is long: if it is too long, the opposite shift is used.
        """
        opposite = self.operator.opposite()
        if opposite.skew:
            return super().ahead(dt, u0, tol)
        half = _LONGEST + math.ceil(abs(opposite.shift) / dt)
        pulse = self.run(np.eye(1, 2 * half + 1, half)[0], dt)[0]
        if abs(pulse.sum() - 1.0) > tol:  # it has not decayed at the ends
            return opposite.ahead(dt, u0, tol)
        # the tails at both ends are cut off, each up to a sum of tol / 2
        left_out = np.cumsum(np.abs(pulse)), np.cumsum(np.abs(pulse[::-1]))
        begin, end = (int(np.argmax(part > 0.5 * tol)) for part in left_out)
        begin = min(begin, half)  # the preview is not negative
        weights = pulse[begin : len(pulse) - end][::-1]
        nothing = np.zeros((0, 0)), np.zeros(0), np.zeros(0)
        return previewed(weights / weights.sum(), nothing, 0.0, u0), half - begin
