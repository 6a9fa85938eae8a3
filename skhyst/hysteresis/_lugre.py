r"""LuGre friction.

With ``w = sigma_0 z / F_s``, ``x_s = F_s / sigma_0`` and ``gamma = g / F_s`` the bristles follow
``w' = (v - |v| w / gamma(v)) / x_s``, ``gamma = ratio + (1 - ratio) exp(-(v/v_s)^2)`` with
``ratio = F_c / F_s``. The velocity is constant between two samples, so ``w`` decays exponentially
along the path ``l = |v| dt`` towards ``gamma sgn(v)``, over the length ``x_s gamma``, and
``x_s w'`` at the end is ``|v| (sgn(v) gamma - w) / gamma``.

Equations (2) to (4) of Amor, Kaddouri and Abdessemed (2023) print the displacement where the
velocity is meant: ``dz/dt`` starts with ``v``, and the Stribeck curve is ``exp(-(v/v_s)^2)``.
"""

import math
from dataclasses import dataclass
from itertools import product

from ..operators import OneStateOperator, parameter
from ._common import FrictionModel, half_range, largest_peak_to_peak, top_speed

# limits of exponents: the exponentials are negligible there, and quotients remain finite
_FASTEST, _LONGEST = 230.0, 1e150


def lugre_step(w, u0, u1, dt, values):
    """Return the next bristle deflection and the total force, each with its derivatives."""
    x_s, v_s, ratio, force, bristle_damping, stiffness, damping, intercept = values
    change = u1 - u0
    velocity = change / dt
    by_w, by_x_s, by_v_s, by_ratio = 1.0, 0.0, 0.0, 0.0
    slip, slip_by_w, slip_by_x_s, slip_by_v_s, slip_by_ratio = 0.0, 0.0, 0.0, 0.0, 0.0
    if change == 0.0:  # without a direction of motion, derivatives are the mean of both
        by_change, slip_by_change = 1.0 / x_s, 1.0 / dt
    else:
        square = min((velocity / v_s) ** 2, _FASTEST)
        bell = math.exp(-square)
        gamma = ratio + (1.0 - ratio) * bell
        steep = 2.0 * (1.0 - ratio) * bell * square  # d gamma / d ln v_s
        sign, speed = (1.0, velocity) if change > 0.0 else (-1.0, -velocity)
        path = min(abs(change) / (x_s * gamma), _LONGEST)
        decayed = -math.expm1(-path)
        by_w = 1.0 - decayed
        gap = sign * gamma - w
        w += gap * decayed
        slip = speed * gap * by_w / gamma  # without cancellation, unlike sgn(v) gamma - w
        slip_by_w = -speed * by_w / gamma
        by_gamma = sign * decayed - gap * by_w * path / gamma
        slip_by_gamma = speed * by_w * (sign + gap * (path - 1.0) / gamma) / gamma
        by_change = sign * gap * by_w / (x_s * gamma) - by_gamma * steep / change
        slip_by_change = (slip * (1.0 - path) - slip_by_gamma * steep) / change
        by_x_s, slip_by_x_s = -by_w * gap * path / x_s, slip * path / x_s
        by_v_s, slip_by_v_s = by_gamma * steep / v_s, slip_by_gamma * steep / v_s
        by_ratio, slip_by_ratio = by_gamma * (1.0 - bell), slip_by_gamma * (1.0 - bell)
    drag = damping / dt
    y = force * w + bristle_damping * slip + stiffness * u1 + drag * change + intercept
    by_u = force * by_change + bristle_damping * slip_by_change + drag
    y_by = (
        force * by_w + bristle_damping * slip_by_w,
        -by_u,
        by_u + stiffness,
        force * by_x_s + bristle_damping * slip_by_x_s,
        force * by_v_s + bristle_damping * slip_by_v_s,
        force * by_ratio + bristle_damping * slip_by_ratio,
        w,
        slip,
        u1,
        velocity,
        1.0,
    )
    return w, y, (by_w, -by_change, by_change, by_x_s, by_v_s, by_ratio), y_by


@dataclass(frozen=True)
class LuGreOperator(OneStateOperator, step=lugre_step):
    """LuGre friction, a spring and a constant in parallel: the law of :class:`LuGre`.

    Parameters
    ----------
    presliding_displacement : float
        ``x_s = F_s / sigma_0``: largest deflection of the bristles, in slow sliding, units of the
        drive, positive.
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

    Raises
    ------
    ValueError
        If the presliding displacement is not above 0.

    Notes
    -----
    The velocity is constant between samples and the bristles are stepped exactly, whatever their
    stiffness. At a sample ``v`` and ``dz/dt`` are those of the straight line that ends there (the
    backward difference). In ``"rest"`` the bristles have been deflected by a slow first loading
    from zero to the first sample, with ``g = F_s``. The state is ``(w, last drive)`` with
    ``w = sigma_0 z / F_s``, within -1 and 1.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import LuGreOperator
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

    owns_gain = True
    stage_order = 10

    def __post_init__(self):
        super().__post_init__()
        self._require("presliding_displacement", self.presliding_displacement > 0.0, "be above 0")

    @property
    def bristle_stiffness(self):
        """``sigma_0 = F_s / x_s`` in response/drive."""
        return self.static_force / self.presliding_displacement

    @property
    def coulomb_force(self):
        """``F_c`` in units of the response."""
        return self.static_force * self.coulomb_ratio

    def rest(self, u0):
        x_s = float(self.presliding_displacement)
        decay = math.exp(-abs(u0) / x_s)
        by_u0 = decay / x_s
        return math.copysign(1.0 - decay, u0), (by_u0, -by_u0 * u0 / x_s, 0.0, 0.0)


# starting values: presliding displacements as fractions of the peak-to-peak drive, Stribeck
# velocities as fractions of its top speed
_LENGTHS = (0.003, 0.02, 0.1, 0.5)
_VELOCITIES = (0.03, 0.15, 0.6)
_RATIO = 0.6


class LuGre(FrictionModel):
    r"""LuGre friction: bristles that bend and slip, with the Stribeck effect.

    .. math::

        \dot z = v - \frac{\sigma_0 |v|}{g(v)} z, \quad
        g(v) = F_c + (F_s - F_c) e^{-(v/v_s)^2}, \quad
        y = \sigma_0 z + \sigma_1 \dot z + \sigma_2 v + k u + c

    The drive ``u`` is a displacement, ``v`` its velocity, the response a force (or anything that
    follows it). Only ``x_s = F_s/sigma_0``, ``v_s`` and ``F_c/F_s`` are searched, which do not
    depend on the unit of the response; ``F_s``, ``sigma_1``, ``sigma_2``, ``k`` and ``c`` are then
    linear and solved exactly.

    Parameters
    ----------
    stribeck : bool, default=True
        Whether sliding friction falls from ``F_s`` to ``F_c`` as the velocity rises; with False
        ``g = F_s = F_c``.
    fit_bristle_damping : bool, default=True
        Whether ``sigma_1`` is fitted (0 otherwise).
    fit_damping : bool, default=True
        Whether the viscous friction ``sigma_2`` is fitted (0 otherwise).

    Attributes
    ----------
    operator_ : LuGreOperator
        ``presliding_displacement`` in units of the drive, ``stribeck_velocity`` in drive/s,
        ``coulomb_ratio`` F_c/F_s, ``static_force`` F_s in units of the response,
        ``bristle_damping`` sigma_1 and ``damping`` sigma_2 in response s/drive;
        ``bristle_stiffness`` sigma_0 and ``coulomb_force`` F_c follow from these.

    See Also
    --------
    Dahl : Without the Stribeck effect.
    CoulombFriction : Without presliding.
    FrictionStage : A mass whose motion this friction resists.

    References
    ----------
    Canudas de Wit et al., *IEEE Transactions on Automatic Control*, 1995. Amor, Kaddouri and
    Abdessemed, *International Journal of Power Electronics and Drive Systems*, 2023, (1) to (4).

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import LuGre, LuGreOperator
    >>> time = np.arange(4000) * 0.005
    >>> drive = np.sin(time) + 0.3 * np.sin(4.4 * time) + 0.02 * np.sin(13.0 * time)
    >>> plant = LuGreOperator(0.05, 0.5, 0.6, static_force=8.0, bristle_damping=0.4, damping=0.3)
    >>> y, _ = plant.run(drive, 0.005)
    >>> model = LuGre(dt=0.005).fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.operator_.coulomb_ratio:.3f} {model.operator_.stribeck_velocity:.3f}")
    0.600 0.500
    """

    operator_class = LuGreOperator
    _parameter_constraints = {
        **FrictionModel._parameter_constraints,
        "stribeck": ["boolean"],
        "fit_bristle_damping": ["boolean"],
    }

    def __init__(
        self,
        stribeck=True,
        *,
        fit_bristle_damping=True,
        fit_damping=True,
        fit_stiffness=False,
        fit_intercept=True,
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        super().__init__(initial_state=initial_state, dt=dt, drive=drive, method=method)
        self.stribeck = stribeck
        self.fit_bristle_damping = fit_bristle_damping
        self.fit_damping = fit_damping
        self.fit_stiffness = fit_stiffness
        self.fit_intercept = fit_intercept

    def starting_values(self, records):
        length, speed, force = (
            largest_peak_to_peak(records),
            top_speed(records),
            half_range(records),
        )
        velocities, ratio = (_VELOCITIES, _RATIO) if self.stribeck else ((1.0,), 1.0)
        return [
            LuGreOperator(part * length, velocity * speed, ratio, force)
            for part, velocity in product(_LENGTHS, velocities)
        ]

    def held_parameters(self) -> frozenset[str]:
        held = super().held_parameters()
        return held if self.stribeck else held | {"stribeck_velocity", "coulomb_ratio"}
