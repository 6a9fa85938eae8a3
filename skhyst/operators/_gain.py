"""A static gain."""

from dataclasses import dataclass

import numpy as np

from .._kernels._arrays import as_signal
from ._base import Operator, parameter

__all__ = ["GainOperator"]


@dataclass(frozen=True)
class GainOperator(Operator):
    r"""A static gain and a constant: :math:`y = g u + c`.

    Parameters
    ----------
    gain : float, default=1.0
        ``g`` in response/drive.
    intercept : float, default=0.0
        ``c``, units of the response.

    Examples
    --------
    >>> from skhyst.operators import GainOperator
    >>> GainOperator(2.0, 1.0).run([0.0, 1.5], 0.1)[0]
    array([1., 4.])
    """

    gain: float = parameter(default=1.0, linear=True, gauge=1.0, unit="response/drive")
    intercept: float = parameter(default=0.0, linear=True, gauge=0.0, unit="response")

    signal_linear = True

    def init(self, u0, initial_state="rest"):
        return None

    def run(self, u, dt, state=None):
        return self.gain * as_signal(u) + self.intercept, None

    def inverse(self):
        """Return the gain that undoes this one."""
        return GainOperator(1.0 / self.gain, -self.intercept / self.gain)

    def linearize(self, u, du, dt, initial_state="rest"):
        u = as_signal(u)
        m = du.shape[1]
        dy = np.empty((u.size, m + 2))
        np.multiply(du, self.gain, out=dy[:, :m])
        dy[:, m] = u
        dy[:, m + 1] = 1.0
        return self.gain * u + self.intercept, dy
