"""The hyperbolic tangent model of a piezo actuator."""

from dataclasses import dataclass

import numpy as np

from .._kernels._arrays import as_signal
from .._kernels._tanh import tanh_run, tanh_tangents
from ._base import Operator, parameter

__all__ = ["TanhHysteresisOperator"]


@dataclass(frozen=True)
class TanhHysteresisOperator(Operator):
    r"""Static curve plus a term in the drive's rate.

    .. math:: z = k_0 u + \alpha \dot u + \beta \tanh(\gamma u) + c

    The rate is the slope of the straight line that leads to a sample, the backward difference
    ``(u[k] - u[k-1]) / dt``: it needs no future sample.

    Parameters
    ----------
    k0 : float
        Slope far from zero, response/drive.
    alpha : float
        Weight of the rate, response s/drive; negative values make the response lag.
    beta : float
        Height of the bend at zero, units of the response.
    gamma : float
        Steepness of the bend, 1/drive, positive.
    intercept : float, default=0.0
        Constant ``c``, units of the response.

    Notes
    -----
    The state is the last drive, a float. ``"rest"`` has it at the first sample, so that the rate
    begins at zero; ``"zero"`` at zero. The model has no other memory: its loop closes through
    ``alpha`` alone, and has an area in proportion to the frequency.

    References
    ----------
    "Modeling and identification of nonlinear hysteresis behavior of piezoelectric actuators using
    a computationally efficient phenomenological model and modified cuckoo search algorithm",
    Smart Mater. Struct. 32 (2023) 015013, equation (3).

    Examples
    --------
    >>> from skhyst.operators import TanhHysteresisOperator
    >>> operator = TanhHysteresisOperator(k0=0.1, alpha=-1e-4, beta=0.5, gamma=100.0)
    >>> operator.run([0.0, 10.0, 10.0], dt=1e-3)[0]
    array([0. , 0.5, 1.5])
    """

    k0: float = parameter(linear=True, unit="response/drive")
    alpha: float = parameter(linear=True, unit="response s/drive")
    beta: float = parameter(linear=True, unit="response")
    gamma: float = parameter(log=True, lower=0.0, unit="1/drive")
    intercept: float = parameter(default=0.0, linear=True, gauge=0.0, unit="response")

    carries_scale = True
    rank = 10

    def init(self, u0, initial_state="rest"):
        """Return the state before the first sample ``u0``: the last drive."""
        return float(u0) if initial_state == "rest" else 0.0

    def run(self, u, dt, state=None):
        """Map a drive of shape (n_samples,) to the response; see :meth:`Operator.run`."""
        u = as_signal(u)
        y = np.empty(u.size)
        if state is None:
            state = self.init(u[0] if u.size else 0.0)
        tanh_run(u, float(dt), *map(float, self.pack()), float(state), y)
        return y, float(u[-1]) if u.size else state

    def linearize(self, u, du, dt, initial_state="rest"):
        """Return the response and its tangents; see :meth:`Operator.linearize`."""
        u, du = as_signal(u), as_signal(du)
        last = self.init(u[0] if u.size else 0.0, initial_state)
        y, _ = self.run(u, dt, last)
        dlast = np.zeros(du.shape[1])
        if initial_state == "rest" and u.size:
            dlast += du[0]
        dy = np.empty((u.size, du.shape[1] + 5))
        values = map(float, (dt, self.k0, self.alpha, self.beta, self.gamma, last))
        tanh_tangents(u, du, *values, dlast, dy)
        return y, dy
