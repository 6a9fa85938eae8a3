"""Dahl friction."""

from dataclasses import dataclass

import numpy as np

from .._kernels._arrays import as_signal
from .._kernels._dahl import dahl_run, dahl_tangents
from ._base import parameter
from ._friction import FrictionOperator

__all__ = ["DahlOperator"]


@dataclass(frozen=True)
class DahlOperator(FrictionOperator):
    r"""Dahl friction, a spring, a dashpot and a constant in parallel.

    .. math::

        y = F_c w + k u + d \dot u + c, \qquad
        \frac{dw}{du} = \frac{(1 - w \operatorname{sgn} \dot u)^n}{x_c}

    Parameters
    ----------
    presliding_displacement : float
        Length ``x_c`` over which the friction turns around, units of the drive, positive.
    coulomb_force : float
        Force ``F_c`` of steady sliding, units of the response.
    stiffness : float, default=0.0
        Spring ``k`` in response/drive.
    damping : float, default=0.0
        Dashpot ``d`` in response s/drive.
    intercept : float, default=0.0
        Constant ``c`` in units of the response.
    exponent : float, default=1.0
        Shape ``n > 0`` of the transition. Fixed structure.

    Notes
    -----
    The drive is a straight line between samples, and the step from one to the next is exact. The
    velocity at a sample is that of the line that ends there. ``w`` depends on the path of the
    drive alone, not on its rate, and stays within -1 and 1. The state is ``(w, last drive)``.

    References
    ----------
    P. R. Dahl, "A solid friction model", The Aerospace Corporation, TOR-0158(3107-18)-1 (1968).

    Examples
    --------
    >>> from skhyst.operators import DahlOperator
    >>> y, state = DahlOperator(1.0, coulomb_force=2.0).run([0.0, 1.0, 40.0, 39.0], dt=1e-3)
    >>> y.round(3)
    array([ 0.   , 1.264, 2.   , -0.528])
    """

    presliding_displacement: float = parameter(log=True, lower=0.0, unit="drive")
    coulomb_force: float = parameter(linear=True, unit="response")
    stiffness: float = parameter(default=0.0, linear=True, unit="response/drive")
    damping: float = parameter(default=0.0, linear=True, unit="response s/drive")
    intercept: float = parameter(default=0.0, linear=True, gauge=0.0, unit="response")
    exponent: float = 1.0

    def _friction(self, u, before, w):
        out = np.empty(u.size)
        x_c, exponent = float(self.presliding_displacement), float(self.exponent)
        dahl_run(u, before, w, x_c, exponent, out)
        return out

    def init(self, u0, initial_state="rest"):
        if initial_state == "zero":
            return 0.0, 0.0
        return float(self._friction(as_signal([u0]), 0.0, 0.0)[0]), float(u0)

    def run(self, u, dt, state=None):
        u = as_signal(u)
        if not u.size:
            return np.empty(0), state or self.init(0.0)
        w, before = state or self.init(u[0])
        friction = self._friction(u, before, w)
        y = self.coulomb_force * friction + self._beside(u, before, dt)
        return y, (float(friction[-1]), float(u[-1]))

    def linearize(self, u, du, dt, initial_state="rest"):
        # from rest or from zero: either way the path starts at zero, and its rate is immaterial
        u, du = as_signal(u), as_signal(du)
        m = du.shape[1]
        friction, tangents = np.empty(u.size), np.empty((u.size, m + 1))
        x_c, exponent = float(self.presliding_displacement), float(self.exponent)
        dahl_tangents(u, du, x_c, exponent, friction, tangents)
        y = self.coulomb_force * friction
        dy = np.empty((u.size, m + self.n_parameters))
        dy[:, : m + 1] = self.coulomb_force * tangents
        dy[:, m + 1] = friction
        self._linearize_beside(u, du, dt, initial_state, y, dy)
        return y, dy
