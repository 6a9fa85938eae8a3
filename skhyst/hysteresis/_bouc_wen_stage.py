"""Mass, spring and damper with a Bouc-Wen force; the loops are in ``_bouc_wen_stage_loops``."""

import math
from dataclasses import dataclass
from itertools import product
from numbers import Real

import numpy as np

from .._sklearn import Interval
from ..operators import parameter
from ._bouc_wen_stage_loops import (
    bouc_wen_run,
    bouc_wen_step,
    bouc_wen_tangents,
    first_loading,
    follow,
)
from ._oscillator import OscillatorOperator
from ._oscillator_model import OscillatorModel

_LARGEST = 1e12  # displacement or force, of the drive and the level: no plant


@dataclass(frozen=True)
class BoucWenStageOperator(
    OscillatorOperator, loops=(bouc_wen_run, bouc_wen_step, bouc_wen_tangents)
):
    r"""Mass, spring and damper with a Bouc-Wen force, driven by a force or a voltage.

    The equations of :class:`BoucWenStage` divided by ``b``: displacement ``q`` and forces are in
    units of the drive, and ``u`` moves the stage without hysteretic force by ``q = u`` at rest.

    Parameters
    ----------
    hysteresis_stiffness : float
        :math:`\rho = \alpha / k`: slope of the hysteretic force at ``f = 0``, relative to the
        spring.
    level : float
        :math:`L = (\alpha/\beta)^{1/n} / |b|`, units of the drive: force at which the law's two
        terms are as large as its first. For ``g > -1`` the largest force is
        ``L (1 + g)^(-1/n)``.
    shape : float, default=0.0
        :math:`g = \gamma / \beta`. From -1 to 1 the force is loaded along a curve that levels off
        and unloaded along a steeper one. Below -1 the loading branch grows steeper too and has no
        limit; above 1 the unloading branch is flatter than a first loading.
    exponent : float, default=1.0
        ``n`` from 1 to 20, sharpness of the transition.

    Notes
    -----
    State and substeps are those of :class:`OscillatorOperator`. For ``n = 1`` the law is never a
    source of energy, since :math:`\beta > 0`; for other exponents, with ``|f|^(n-1)`` held over a
    substep, it is none for ``|g| <= 1``. Where the law has no limit (``g < -1``) a large motion can
    leave the range of any plant; what follows is then NaN.

    References
    ----------
    Classes of the law by the signs of its coefficients: Ikhouane and Rodellar, *Systems with
    Hysteresis*, 2007.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import BoucWenStageOperator
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

        Those of :meth:`OscillatorOperator.physical`, ``alpha`` (force/displacement), ``beta`` and
        ``gamma`` (``force^(1-n)/displacement``; NaN or infinite beyond the range of floating
        point).
        """
        p = super().physical(mass)
        alpha, force = self.hysteresis_stiffness * p["stiffness"], abs(p["drive_gain"]) * self.level
        with np.errstate(all="ignore"):
            beta = np.float64(alpha) * np.float64(force) ** -self.exponent
            gamma = self.shape * beta
        return p | {"alpha": alpha, "beta": float(beta), "gamma": float(gamma)}

    def characteristics(self, seen):
        bounded = self.shape > -1.0
        factor = (1.0 + self.shape) ** (-1.0 / self.exponent) if bounded else 1.0
        return self._force_characteristics(self.level * factor)

    def _fed_back(self, s, shift):
        return {"hysteresis_stiffness": self.hysteresis_stiffness / s}

    def _rest(self, u0):
        own, sign = np.empty(5), math.copysign(1.0, u0)
        force = first_loading(abs(u0), *self._law(0.0)[:4], own)
        by = np.zeros((2, 1 + self.n_parameters - 2))
        by[1, 0] = own[0]
        by[1, 3:] = sign * own[1:]
        by[0] = -by[1]
        by[0, 0] += 1.0
        return u0 - sign * force, sign * force, by

    def _law(self, largest):
        own = self.hysteresis_stiffness, self.level, self.shape, self.exponent
        return tuple(map(float, (*own, _LARGEST * (largest + self.level))))


# level of the force over its first slope, parts of the response's half range; gamma / beta;
# exponent where it is fitted
_WAYS = (0.05, 0.15, 0.5, 1.5, 5.0)
_SHAPES = (-1.3, -0.4, 0.5)
_EXPONENTS = (1.2, 2.5)


class BoucWenStage(OscillatorModel):
    r"""Mass, spring and damper with a Bouc-Wen force: hysteresis with a smooth transition.

    .. math::

        m \ddot x + d \dot x + k x + z = b u, \qquad y = x + c

        \dot z = \alpha \dot x - \beta |\dot x| |z|^{n-1} z - \gamma \dot x |z|^n

    The drive ``u`` is a force or a voltage, the response a displacement. The equation is divided by
    ``b``, since a response to a drive does not tell the mass; the hysteretic force is then in units
    of the drive.

    Parameters
    ----------
    exponent : float, default=1.0
        ``n`` from 1 to 20, sharpness of the transition. Not used where it is fitted.
    fit_exponent : bool, default=False
        Whether ``n`` is fitted.

    Attributes
    ----------
    operator_ : BoucWenStageOperator
        ``natural_frequency`` (rad/s), ``damping_ratio``, ``hysteresis_stiffness`` (relative to the
        spring), ``level`` (units of the drive), ``shape`` (:math:`\gamma / \beta`), ``exponent``,
        ``gain``, ``intercept``.

    Notes
    -----
    Starting values come as those of :class:`FrictionStage`. Records should show motions both small
    and large against the way on which the force bends; a force that hardly bends is a part of the
    spring, and standard errors and ``identifiability_`` say so. Unlike that of :class:`BoucWen`,
    the law may lack a limit (:math:`\gamma < -\beta`), since the spring limits the motion.

    References
    ----------
    Bouc, *Fourth Conference on Nonlinear Oscillations*, 1967. Wen, *Journal of the Engineering
    Mechanics Division*, 1976. Noël and Schoukens, *Workshop on Nonlinear System Identification
    Benchmarks*, 2016.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import BoucWenStage, BoucWenStageOperator
    >>> time = np.arange(1500) * 0.01
    >>> drive = np.sin(0.7 * time) + 0.8 * np.sin(2.9 * time) + 0.3 * np.sin(11.0 * time)
    >>> plant = BoucWenStageOperator(20.0, 0.5, 5.0, 0.3, 0.4, gain=3.0)
    >>> y, _ = plant.run(drive, 0.01)
    >>> model = BoucWenStage(dt=0.01).fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.operator_.level:.2f} {model.operator_.hysteresis_stiffness:.1f}")
    0.30 5.0
    """

    operator_class = BoucWenStageOperator
    _parameter_constraints = {
        **OscillatorModel._parameter_constraints,
        "exponent": [Interval(Real, 1.0, 20.0, closed="both")],
        "fit_exponent": ["boolean"],
    }

    def __init__(
        self,
        exponent=1.0,
        *,
        fit_exponent=False,
        fit_intercept=True,
        mass=1.0,
        n_substeps=None,
        initial_state="rest",
        dt=1.0,
        method="variable_projection",
    ):
        super().__init__(initial_state=initial_state, dt=dt, method=method)
        self.exponent = exponent
        self.fit_exponent = fit_exponent
        self.fit_intercept = fit_intercept
        self.mass = mass
        self.n_substeps = n_substeps

    def _laws(self, length, speed):
        exponents = _EXPONENTS if self.fit_exponent else (float(self.exponent),)
        return [
            [(part * length, shape, exponent) for part in _WAYS]
            for shape, exponent in product(_SHAPES, exponents)
        ]

    def _forces(self, law, y, dt, length):
        force = np.empty_like(y)
        follow(np.ascontiguousarray(y), *law, force)
        return force[:, None]

    def _own(self, law, gain, stiffness, level, swing):
        _, shape, exponent = law
        own = {"hysteresis_stiffness": stiffness, "level": level}
        return own | {"shape": shape, "exponent": exponent}
