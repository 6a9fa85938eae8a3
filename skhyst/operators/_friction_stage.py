"""Mass, spring and damper with LuGre friction."""

import math
from dataclasses import dataclass

import numpy as np

from .._kernels._friction_stage import friction_run, friction_tangents
from ._base import parameter
from ._oscillator import OscillatorOperator

__all__ = ["FrictionStageOperator"]


@dataclass(frozen=True)
class FrictionStageOperator(OscillatorOperator):
    r"""Mass, spring and damper with LuGre friction, driven by a force or a voltage.

    .. math::

        \frac{\ddot q}{\omega^2} + \frac{2 \zeta}{\omega} \dot q + q + f
        + \frac{2 \zeta_b}{\omega} \dot z = u, \qquad y = G q + c

        \dot z = v - \frac{|v|}{g(v)} f, \quad f = \rho z, \quad v = \dot q, \quad
        g(v) = F_s \left(r + (1 - r) e^{-(v / v_s)^2}\right)

    Displacement ``q`` and forces are in units of the drive: ``u`` moves the stage without friction
    by ``q = u`` at rest. Only what the response to a drive can tell appears; see Notes.

    Parameters
    ----------
    natural_frequency : float
        :math:`\omega = \sqrt{k/m}` in rad/s.
    damping_ratio : float
        :math:`\zeta`, of the damper and the viscous friction together.
    static_level : float
        ``F_s``: drive that overcomes the friction of very slow sliding, units of the drive.
    coulomb_ratio : float
        ``r = F_c / F_s``: friction of fast over that of slow sliding, from 0 to 1.
    stribeck_velocity : float
        ``v_s`` in drive/s; in units of the response it is ``|gain| v_s``.
    bristle_stiffness : float
        :math:`\rho = \sigma_0 / k`, relative to the spring.
    bristle_damping : float, default=0.0
        :math:`\zeta_b = \sigma_1 / (2 \sqrt{k m})`; before sliding the damping ratio is that of
        the sum with :math:`\zeta`.
    gain : float, default=1.0
        ``G``: response to a drive at rest without friction, response/drive.
    intercept : float, default=0.0
        ``c`` in units of the response.
    n_substeps : int, default=8
        Integration steps in a sampling interval. Fixed structure.

    Raises
    ------
    ValueError
        If ``n_substeps`` is not an integer above 0.

    Notes
    -----
    The equations are those of :math:`m \ddot x + d \dot x + k x + \sigma_0 z + \sigma_1 \dot z +
    \sigma_2 \dot x = b u`, ``x = y - c``, divided by ``b``. For a known mass ``m``:
    :math:`k = m \omega^2`, :math:`d + \sigma_2 = 2 \zeta \omega m` (only the sum can be told),
    ``b = k G``, :math:`\sigma_0 = \rho k`, :math:`\sigma_1 = 2 \zeta_b \omega m`, forces are
    ``|b|`` times the levels; see :meth:`physical`.

    Each substep moves the oscillator exactly under the mean friction force, and the friction force
    exactly along the way of the substep: second order, exact without friction, and never a source
    of energy, however stiff the bristles are (``bristle_damping`` apart, with which the LuGre model
    itself is not passive). Steps should resolve the motion before sliding: ``dt natural_frequency
    sqrt(1 + bristle_stiffness) / n_substeps`` of 0.1 gives about three digits.

    The state is the tuple ``(q, q' / w, f, last drive)``. In ``"rest"`` the stage has been loaded
    slowly from zero, with ``g = F_s``.

    References
    ----------
    NARMAX-LuGre paper, (1) to (4), with ``z'`` and the Stribeck curve functions of the velocity; C.
    Canudas de Wit, H. Olsson, K. J. Astrom, P. Lischinsky, "A new model for control of systems with
    friction", IEEE Trans. Automatic Control 40(3), 1995. Averaged vector field: G. R. W. Quispel,
    D. I. McLaren, J. Phys. A 41, 2008.

    Examples
    --------
    A slow drive leaves the stage where friction holds it:

    >>> import numpy as np
    >>> from skhyst.operators import FrictionStageOperator
    >>> stage = FrictionStageOperator(50.0, 0.5, 0.24, 0.8, 0.1, 40.0)
    >>> drive = np.interp(np.arange(4000) * 1e-2, [0.0, 20.0, 40.0], [0.0, 1.0, 0.0])
    >>> y, _ = stage.run(drive, 1e-2)
    >>> print(f"{y.max():.2f} {y[-1]:.2f}")
    0.78 0.21
    """

    natural_frequency: float = parameter(log=True, lower=0.0, unit="rad/s")
    damping_ratio: float = parameter(log=True, lower=0.0)
    static_level: float = parameter(log=True, lower=0.0, unit="drive")
    coulomb_ratio: float = parameter(lower=0.0, upper=1.0)
    stribeck_velocity: float = parameter(log=True, lower=0.0, unit="drive/s")
    bristle_stiffness: float = parameter(log=True, lower=0.0)
    bristle_damping: float = parameter(default=0.0, lower=0.0)
    gain: float = parameter(default=1.0, linear=True, unit="response/drive")
    intercept: float = parameter(default=0.0, linear=True, gauge=0.0, unit="response")
    n_substeps: int = 8

    def physical(self, mass=1.0):
        """Return the quantities of the equation of motion for a known mass.

        Parameters
        ----------
        mass : float, default=1.0

        Returns
        -------
        dict of str to float
            ``mass``, ``damping`` (viscous friction included), ``stiffness``, ``drive_gain`` (force
            over drive), ``coulomb_force``, ``static_force``, ``stribeck_velocity``,
            ``bristle_stiffness``, ``bristle_damping``; displacements are in units of the response,
            and with the mass in kg and the response in m all is in SI units.
        """
        stiffness = mass * self.natural_frequency**2
        drive_gain = stiffness * self.gain
        return {
            "mass": float(mass),
            "damping": 2.0 * self.damping_ratio * self.natural_frequency * mass,
            "stiffness": stiffness,
            "drive_gain": drive_gain,
            "coulomb_force": abs(drive_gain) * self.static_level * self.coulomb_ratio,
            "static_force": abs(drive_gain) * self.static_level,
            "stribeck_velocity": abs(self.gain) * self.stribeck_velocity,
            "bristle_stiffness": self.bristle_stiffness * stiffness,
            "bristle_damping": 2.0 * self.bristle_damping * self.natural_frequency * mass,
        }

    def fastest_rate(self):
        """Return the natural frequency before sliding, rad/s."""
        return float(self.natural_frequency * math.sqrt(1.0 + self.bristle_stiffness))

    def _fed_back(self, s, shift):
        return {
            "stribeck_velocity": self.stribeck_velocity * s,
            "bristle_stiffness": self.bristle_stiffness / s,
            "bristle_damping": self.bristle_damping / math.sqrt(s),
        }

    def _rest(self, u0):
        level = float(self.static_level)
        rho, target = float(self.bristle_stiffness), abs(u0)
        # q + level (1 - exp(-rho q / level)) = |u0|: increasing and concave, so that Newton's
        # method rises to the root from below
        q = max(target / (1.0 + rho), target - level)
        for _ in range(100):
            exponent = rho * q / level if level else math.inf
            gone = -math.expm1(-exponent)
            step = (target - q - level * gone) / (1.0 + rho * (1.0 - gone))
            q += step
            if not step > 4e-16 * q:
                break
        exponent = rho * q / level if level else math.inf
        left = math.exp(-exponent)
        sign = math.copysign(1.0, u0)
        spent = exponent * left if left else 0.0
        by_level, by_rho = sign * (1.0 - left - spent), sign * q * left
        share = 1.0 / (1.0 + rho * left)
        by = np.zeros((2, 1 + self.n_parameters - 2))
        by[:, 0] = share, rho * left * share
        for column, slope in ((3, by_level), (6, by_rho)):
            by[:, column] = -slope * share, slope * share
        return sign * q, sign * (target - q), by

    def _law(self):
        return (
            float(self.static_level),
            float(self.coulomb_ratio),
            float(self.stribeck_velocity),
            float(self.bristle_stiffness),
        )

    def _run(self, mode, h, u, before, state, out):
        w, bristle = float(self.natural_frequency), float(self.bristle_damping)
        return friction_run(
            mode, w, self._law(), bristle, h, self.n_substeps, u, before, *state, out
        )

    def _tangents(self, mode, mode_by, h, u, du, before, dbefore, state, d, out, dout):
        w, bristle = float(self.natural_frequency), float(self.bristle_damping)
        friction_tangents(
            mode,
            mode_by,
            w,
            self._law(),
            bristle,
            h,
            self.n_substeps,
            u,
            du,
            before,
            dbefore,
            *state,
            d,
            out,
            dout,
        )
