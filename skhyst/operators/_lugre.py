"""LuGre friction."""

from dataclasses import dataclass

import numpy as np

from .._kernels._arrays import as_signal
from .._kernels._dahl import dahl_step
from .._kernels._lugre import lugre_run, lugre_tangents
from ._base import parameter
from ._friction import FrictionOperator

__all__ = ["LuGreOperator"]


@dataclass(frozen=True)
class LuGreOperator(FrictionOperator):
    r"""LuGre friction, a spring and a constant in parallel.

    .. math::

        \dot z = v - \frac{\sigma_0 |v|}{g(v)} z, \quad
        g(v) = F_c + (F_s - F_c) e^{-(v/v_s)^2}, \quad
        y = \sigma_0 z + \sigma_1 \dot z + \sigma_2 v + k u + c

    Parameters
    ----------
    presliding_displacement : float
        Largest deflection ``x_s = F_s / sigma_0`` of the bristles, that of slow sliding, units of
        the drive, positive.
    stribeck_velocity : float
        ``v_s`` in drive/s, positive.
    coulomb_ratio : float
        ``F_c / F_s``, from 0 to 1.
    static_force : float
        ``F_s``, units of the response.
    bristle_damping : float, default=0.0
        ``sigma_1`` in response s/drive.
    stiffness : float, default=0.0
        Spring ``k`` in response/drive.
    damping : float, default=0.0
        Viscous friction ``sigma_2`` in response s/drive.
    intercept : float, default=0.0
        Constant ``c`` in units of the response.

    Notes
    -----
    The drive is a straight line between samples, so the velocity is constant there and the bristles
    are stepped exactly, whatever their stiffness. At a sample ``v`` and ``dz/dt`` are those of the
    line that ends there (the backward difference). In ``"rest"`` the bristles have been bent by a
    slow first loading from zero to the first sample, where ``g = F_s``. The state is
    ``(w, last drive)`` with ``w = sigma_0 z / F_s``, within -1 and 1.

    Equations (2) to (4) of the NARMAX-LuGre paper print the displacement where the velocity is
    meant: ``dz/dt`` starts with ``v``, and the Stribeck curve is ``exp(-(v/v_s)^2)``.

    References
    ----------
    C. Canudas de Wit, H. Olsson, K. J. Astrom, P. Lischinsky, "A new model for control of systems
    with friction", IEEE Trans. Automatic Control 40(3), 1995, equations (1) to (4).

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.operators import LuGreOperator
    >>> operator = LuGreOperator(0.01, 0.1, 0.6, static_force=3.0)
    >>> time = np.arange(1000) * 1e-2
    >>> slow, fast = (operator.run(v * time, 1e-2)[0][-1] for v in (0.02, 10.0))
    >>> print(f"{slow:.2f} {fast:.2f}")
    2.95 1.80
    """

    presliding_displacement: float = parameter(log=True, lower=0.0, unit="drive")
    stribeck_velocity: float = parameter(log=True, lower=0.0, unit="drive/s")
    coulomb_ratio: float = parameter(lower=0.0, upper=1.0)
    static_force: float = parameter(linear=True, unit="response")
    bristle_damping: float = parameter(default=0.0, linear=True, unit="response s/drive")
    stiffness: float = parameter(default=0.0, linear=True, unit="response/drive")
    damping: float = parameter(default=0.0, linear=True, unit="response s/drive")
    intercept: float = parameter(default=0.0, linear=True, gauge=0.0, unit="response")

    @property
    def bristle_stiffness(self):
        """``sigma_0 = F_s / x_s`` in response/drive."""
        return self.static_force / self.presliding_displacement

    @property
    def coulomb_force(self):
        """``F_c`` in units of the response."""
        return self.static_force * self.coulomb_ratio

    def _shape(self):
        return (
            float(self.presliding_displacement),
            float(self.stribeck_velocity),
            float(self.coulomb_ratio),
        )

    def _first_loading(self, u0):
        """Return ``w`` after a slow way from zero to ``u0`` and its derivatives by u0 and x_s."""
        # slowly, g stays at F_s, and the bristles are those of a Dahl model
        w, _, by_u0, by_x_s = dahl_step(0.0, float(u0), self._shape()[0], 1.0)
        return w, by_u0, by_x_s

    def init(self, u0, initial_state="rest"):
        if initial_state == "zero":
            return 0.0, 0.0
        return float(self._first_loading(u0)[0]), float(u0)

    def run(self, u, dt, state=None):
        u = as_signal(u)
        if not u.size:
            return np.empty(0), state or self.init(0.0)
        w, before = state or self.init(u[0])
        force, slip = np.empty((2, u.size))
        lugre_run(u, before, w, float(dt), *self._shape(), force, slip)
        w = float(force[-1])
        y = self.static_force * force + self._beside(u, before, dt)
        if self.bristle_damping:
            y += self.bristle_damping * slip
        return y, (w, float(u[-1]))

    def linearize(self, u, du, dt, initial_state="rest"):
        u, du = as_signal(u), as_signal(du)
        m = du.shape[1]
        w, before, dw, dbefore = 0.0, 0.0, np.zeros(m + 3), as_signal(np.zeros(m))
        if initial_state == "rest" and u.size:
            w, by_u0, dw[m] = self._first_loading(u[0])
            before, dbefore = float(u[0]), du[0]
            dw[:m] = by_u0 * dbefore
        force, slip = np.empty((2, u.size))
        dforce, dslip = np.empty((2, u.size, m + 3))
        lugre_tangents(
            u,
            du,
            before,
            dbefore,
            float(w),
            dw,
            float(dt),
            *self._shape(),
            force,
            slip,
            dforce,
            dslip,
        )
        y = self.static_force * force + self.bristle_damping * slip
        dy = np.empty((u.size, m + self.n_parameters))
        dy[:, : m + 3] = self.static_force * dforce + self.bristle_damping * dslip
        dy[:, m + 3], dy[:, m + 4] = force, slip
        self._linearize_beside(u, du, dt, initial_state, y, dy)
        return y, dy
