"""An operator and a frequency response as a least-squares problem."""

import numpy as np

from ._identify import solve
from ._problem import Unknowns


class FrequencyProblem(Unknowns):
    """Weighted least squares of an operator's frequency response.

    It has those methods of an ``OperatorProblem`` that the solver needs. A parameter that is
    searched as a logarithm keeps the sign of its starting value, so that a section with poles in
    the right half plane keeps them there.

    Parameters
    ----------
    operator : Operator
        Starting values; gives ``frequency_tangents(frequency)``.
    frequency : ndarray of shape (n,)
        Hz.
    response : ndarray of shape (n, n_inputs), complex
        Measured.
    weight : ndarray of shape (n, n_inputs)
        Reciprocal standard deviation.
    fixed : collection of str, default=()
        Names of entries that are held.
    """

    def __init__(self, operator, frequency, response, weight, *, fixed=()):
        self.operator = operator
        self.frequency, self.response, self.weight = frequency, response, weight
        entries = operator.entries()
        self._free = np.flatnonzero([name not in fixed for name, _ in entries])
        super().__init__([entries[i] for i in self._free], operator.pack()[self._free])
        self.lower = np.where(self.log, -np.inf, self.lower)
        self.upper = np.where(self.log, np.inf, self.upper)
        self.scale = float(np.sum(np.abs(weight * response) ** 2))
        self.segment_length = np.array([2 * response.size])
        self.segment_weight = self.segment_length.astype(float)

    def unpack(self, x):
        """Return the operator at ``x``, and no disturbances."""
        vector = self.operator.pack()
        vector[self._free] = self.values(x)
        return self.operator.unpack(vector), ()

    def evaluate(self, x, *, jacobian=True, select=None):
        """Return the Gram matrix of ``[J, r]``, shape (1, n + 1, n + 1)."""
        operator, _ = self.unpack(x)
        g, dg = operator.frequency_tangents(self.frequency)
        residual = (self.weight * (g - self.response)).reshape(-1, 1)
        if jacobian:
            columns = (dg[:, :, self._free] * self.chain(self.values(x))) * self.weight[:, :, None]
            residual = np.concatenate([columns.reshape(len(residual), -1), residual], axis=1)
        rows = np.concatenate([residual.real, residual.imag])
        return (rows.T @ rows)[None]

    def total(self, blocks, select=None):
        """Return the Gram matrix."""
        return blocks[0]

    def powers(self, blocks):
        """Return the sums of squares of the columns of J."""
        return np.diag(blocks[0])[:-1]

    def rows(self, x):
        """Return no rows: the noise at different frequencies is independent."""
        return ()

    def coefficients(self, blocks, select=None):
        """Return the coefficients of disturbances: there are none."""
        return np.empty((1, 0))


def identify_response(problems, *, method="variable_projection"):
    """Identify an operator from a frequency response, from several starts.

    Parameters
    ----------
    problems : sequence of FrequencyProblem
        Of one structure.
    method : str or Method, default="variable_projection"

    Returns
    -------
    IdentificationResult
        ``error`` is the root mean square of the weighted residual, real and imaginary parts.
    """
    return solve(problems, method)
