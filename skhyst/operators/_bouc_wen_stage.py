"""Mass, spring and damper with a Bouc-Wen force."""

import math
from dataclasses import dataclass

import numpy as np

from .._kernels._bouc_wen_stage import bouc_wen_run, bouc_wen_tangents, first_loading
from ._base import parameter
from ._oscillator import OscillatorOperator

__all__ = ["BoucWenStageOperator"]

_LARGEST = 1e12  # displacement or force, of the drive and the level: no plant


@dataclass(frozen=True)
class BoucWenStageOperator(OscillatorOperator):
    r"""Mass, spring and damper with a Bouc-Wen force, driven by a force or a voltage.

    .. math::

        \frac{\ddot q}{\omega^2} + \frac{2 \zeta}{\omega} \dot q + q + f = u, \qquad y = G q + c

        \dot f = \rho \left[\dot q - \left|\frac{f}{L}\right|^n
        (|\dot q| \operatorname{sgn} f + g \dot q)\right]

    Displacement ``q`` and forces are in units of the drive: ``u`` moves the stage without
    hysteretic force by ``q = u`` at rest.

    Parameters
    ----------
    natural_frequency : float
        :math:`\omega = \sqrt{k/m}` in rad/s.
    damping_ratio : float
        :math:`\zeta`.
    hysteresis_stiffness : float
        :math:`\rho = \alpha / k`: slope of the hysteretic force at ``f = 0``, relative to the
        spring.
    level : float
        ``L``, units of the drive: force at which the law's two terms are as large as its first.
        For ``g > -1`` the largest force is ``L (1 + g)^(-1/n)``.
    shape : float, default=0.0
        :math:`g = \gamma / \beta`. From -1 to 1 the force is loaded along a curve that levels off
        and unloaded along a steeper one. Below -1 the loading branch grows steeper too and has no
        limit; above 1 the unloading branch is flatter than a first loading.
    exponent : float, default=1.0
        ``n`` from 1 to 20, sharpness of the transition.
    gain : float, default=1.0
        ``G``: response to a drive at rest without hysteretic force, response/drive.
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
    The equations are those of :math:`m \ddot x + d \dot x + k x + z = b u`,
    :math:`\dot z = \alpha \dot x - \beta |\dot x| |z|^{n-1} z - \gamma \dot x |z|^n`,
    ``x = y - c``, divided by ``b``; :math:`L = (\alpha/\beta)^{1/n} / |b|`. See :meth:`physical`.

    Each substep moves the oscillator exactly under the mean hysteretic force, and for ``n = 1``
    that force exactly along the way of the substep: second order, and never a source of energy at
    any step, since with :math:`\beta > 0` the law itself is none. For other exponents ``|f|^(n-1)``
    is held over a substep, and the same is true for ``|g| <= 1``. Steps should resolve the small
    motion: ``dt natural_frequency sqrt(1 + hysteresis_stiffness) / n_substeps`` of 0.1 gives about
    three digits.

    The state is the tuple ``(q, q' / w, f, last drive)``. In ``"rest"`` the stage has been loaded
    slowly from zero. Where the law has no limit (``g < -1``) a large motion can leave the range of
    any plant; what follows is then NaN.

    References
    ----------
    R. Bouc, "Forced vibration of mechanical systems with hysteresis", 1967; Y.-K. Wen, "Method for
    random vibration of hysteretic systems", J. Eng. Mech. Div. 102, 1976. Classes of the law by
    the signs of its coefficients: F. Ikhouane, J. Rodellar, "Systems with Hysteresis", Wiley, 2007.
    Averaged vector field: G. R. W. Quispel, D. I. McLaren, J. Phys. A 41, 2008.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.operators import BoucWenStageOperator
    >>> stage = BoucWenStageOperator(50.0, 0.5, 4.0, 0.2)
    >>> drive = np.interp(np.arange(4000) * 1e-2, [0.0, 20.0, 40.0], [0.0, 1.0, 0.0])
    >>> y, _ = stage.run(drive, 1e-2)
    >>> print(f"{y.max():.2f} {y[-1]:.2f}")
    0.80 0.20
    """

    natural_frequency: float = parameter(log=True, lower=0.0, unit="rad/s")
    damping_ratio: float = parameter(log=True, lower=0.0)
    hysteresis_stiffness: float = parameter(log=True, lower=0.0)
    level: float = parameter(log=True, lower=0.0, unit="drive")
    # far beyond, the term without this factor is not seen
    shape: float = parameter(default=0.0, lower=-20.0, upper=20.0)
    exponent: float = parameter(default=1.0, log=True, lower=1.0, upper=20.0)
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
            ``mass``, ``damping``, ``stiffness``, ``drive_gain`` (force over drive), ``alpha``
            (force/displacement), ``beta`` and ``gamma`` (``force^(1-n)/displacement``; NaN or
            infinite beyond the range of floating point); displacements are in units of the
            response, and with the mass in kg and the response in m all is in SI units.
        """
        stiffness = mass * self.natural_frequency**2
        drive_gain = stiffness * self.gain
        alpha = self.hysteresis_stiffness * stiffness
        with np.errstate(all="ignore"):
            beta = np.float64(alpha) * np.float64(abs(drive_gain) * self.level) ** -self.exponent
            gamma = self.shape * beta
        return {
            "mass": float(mass),
            "damping": 2.0 * self.damping_ratio * self.natural_frequency * mass,
            "stiffness": stiffness,
            "drive_gain": drive_gain,
            "alpha": alpha,
            "beta": float(beta),
            "gamma": float(gamma),
        }

    def fastest_rate(self):
        """Return the natural frequency of a small motion, rad/s."""
        return float(self.natural_frequency * math.sqrt(1.0 + self.hysteresis_stiffness))

    def _fed_back(self, s, shift):
        return {"hysteresis_stiffness": self.hysteresis_stiffness / s}

    def _rest(self, u0):
        rho, level, shape, exponent, _ = self._law(np.empty(0))
        own = np.empty(5)
        force = first_loading(abs(u0), rho, level, shape, exponent, own)
        sign = math.copysign(1.0, u0)
        by = np.zeros((2, 1 + self.n_parameters - 2))
        by[1, 0] = own[0]
        by[1, 3:] = sign * own[1:]
        by[0] = -by[1]
        by[0, 0] += 1.0
        return u0 - sign * force, sign * force, by

    def _law(self, u):
        largest = float(np.abs(u).max(initial=0.0)) + float(self.level)
        return (
            float(self.hysteresis_stiffness),
            float(self.level),
            float(self.shape),
            float(self.exponent),
            _LARGEST * largest,
        )

    def _run(self, mode, h, u, before, state, out):
        return bouc_wen_run(mode, self._law(u), h, self.n_substeps, u, before, *state, out)

    def _tangents(self, mode, mode_by, h, u, du, before, dbefore, state, d, out, dout):
        bouc_wen_tangents(
            mode,
            mode_by,
            self._law(u),
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
