r"""LuGre friction model.

Loops over the LuGre model, exact while the velocity is constant.

With ``w = sigma_0 z / F_s``, ``x_s = F_s / sigma_0`` and ``gamma = g / F_s`` the bristles follow
``w' = (v - |v| w / gamma(v)) / x_s``, ``gamma = ratio + (1 - ratio) exp(-(v/v_s)^2)`` with
``ratio = F_c / F_s``. The velocity is constant between two samples, so ``w`` decays exponentially
along the way ``l = |v| dt`` towards ``gamma sgn(v)``, over the length ``x_s gamma``.

LuGre friction.
"""

import math
from dataclasses import dataclass
from itertools import product

import numpy as np

from .._jit import jit
from ..operators import as_signal, parameter
from ._dahl import dahl_step
from ._friction import FrictionModel, FrictionOperator, half_range, swing, top_speed

__all__ = [
    "LuGre",
    "LuGreOperator",
    "lugre_run",
    "lugre_step",
    "lugre_tangents",
]

# exponents at which a decay is zero for all purposes; their quotients still are numbers
_FASTEST, _LONGEST = 230.0, 1e150


@jit
def lugre_step(w, change, dt, x_s, v_s, ratio):
    """Step the bristles over the displacement ``change``.

    Returns ``w``, its derivatives by the old w, ``change`` and gamma; gamma, its derivatives by the
    velocity, v_s and ratio; the slip speed ``x_s w'`` at the end of the step, its derivatives by
    the old w, ``change`` and gamma; the way over the length of decay, and the old gap. Derivatives
    by change are taken at constant gamma; at rest they are the mean of both directions.
    """
    if change == 0.0:
        return w, 1.0, 1.0 / x_s, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0 / dt, 0.0, 0.0, 0.0
    velocity = change / dt
    square = min((velocity / v_s) ** 2, _FASTEST)
    bell = math.exp(-square)
    gamma = ratio + (1.0 - ratio) * bell
    steep = 2.0 * (1.0 - ratio) * bell * square
    sign = 1.0 if change > 0.0 else -1.0
    way = min(abs(change) / (x_s * gamma), _LONGEST)
    passed = -math.expm1(-way)
    left = 1.0 - passed
    gap = sign * gamma - w
    # at the end: x_s w' = |v| (sgn(v) gamma - w) / gamma, without the difference of equal numbers
    slip = abs(velocity) * gap * left / gamma
    return (
        w + gap * passed,
        left,
        sign * gap * left / (x_s * gamma),
        sign * passed - gap * left * way / gamma,
        gamma,
        -steep / velocity,
        steep / v_s,
        1.0 - bell,
        slip,
        -abs(velocity) * left / gamma,
        slip * (1.0 - way) / change,
        abs(velocity) * left * (sign + gap * (way - 1.0) / gamma) / gamma,
        way,
        gap,
    )


@jit
def lugre_run(u, before, w, dt, x_s, v_s, ratio, out, slip):
    """Write ``w`` to ``out`` (n,) and ``x_s w'`` to ``slip`` (n,), from ``w`` at ``before``."""
    for k in range(u.size):
        step = lugre_step(w, u[k] - before, dt, x_s, v_s, ratio)
        w = step[0]
        before = u[k]
        out[k] = w
        slip[k] = step[8]


@jit
def lugre_tangents(u, du, before, dbefore, w, dw, dt, x_s, v_s, ratio, out, slip, dout, dslip):
    """Write what :func:`lugre_run` writes, and the tangents ``dout``, ``dslip`` (n, m + 3).

    The columns are those of ``du`` (n, m), then the derivatives by ``x_s``, ``v_s`` and ``ratio``.
    ``dbefore`` (m,) and ``dw`` (m + 3,) are the tangents of the drive and of ``w`` before the
    first sample.
    """
    m = du.shape[1]
    last = dw
    last_du = dbefore
    for k in range(u.size):
        (
            w,
            by_w,
            by_change,
            by_gamma,
            _,
            gamma_by_v,
            gamma_by_v_s,
            gamma_by_ratio,
            out_slip,
            slip_by_w,
            slip_by_change,
            slip_by_gamma,
            way,
            gap,
        ) = lugre_step(w, u[k] - before, dt, x_s, v_s, ratio)
        before = u[k]
        out[k] = w
        slip[k] = out_slip
        by_change += by_gamma * gamma_by_v / dt
        slip_by_change += slip_by_gamma * gamma_by_v / dt
        for q in range(m):
            change = du[k, q] - last_du[q]
            dout[k, q] = by_w * last[q] + by_change * change
            dslip[k, q] = slip_by_w * last[q] + slip_by_change * change
        dout[k, m] = by_w * (last[m] - gap * way / x_s)
        dslip[k, m] = slip_by_w * last[m] + out_slip * way / x_s
        dout[k, m + 1] = by_w * last[m + 1] + by_gamma * gamma_by_v_s
        dslip[k, m + 1] = slip_by_w * last[m + 1] + slip_by_gamma * gamma_by_v_s
        dout[k, m + 2] = by_w * last[m + 2] + by_gamma * gamma_by_ratio
        dslip[k, m + 2] = slip_by_w * last[m + 2] + slip_by_gamma * gamma_by_ratio
        last = dout[k]
        last_du = du[k]


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


# presliding displacements, parts of the drive's swing; Stribeck velocities, parts of its top speed
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
    follows it). Searched are ``x_s = F_s/sigma_0``, ``v_s`` and ``F_c/F_s``, which do not depend
    on the unit of the response; all that is linear then (``F_s``, ``sigma_1``, ``sigma_2``, ``k``,
    ``c``) is solved exactly.

    Parameters
    ----------
    stribeck : bool, default=True
        Whether sliding friction falls from ``F_s`` to ``F_c`` as the velocity rises; with False
        ``g = F_s = F_c``.
    fit_bristle_damping : bool, default=True
        Whether ``sigma_1`` is fitted (0 otherwise).
    fit_damping : bool, default=True
        Whether the viscous friction ``sigma_2`` is fitted (0 otherwise).
    fit_stiffness : bool, default=False
        Whether a spring ``k`` beside the friction is fitted (0 otherwise).
    fit_intercept : bool, default=True
        Whether the response has a constant (a force offset).
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample: at rest after a slow first loading from zero; all
        zero; or after a rest at a drive value that is fitted for each record.
    dt : float, default=1.0
        Sampling interval in s of data without a time index.
    method : str or Method, default="variable_projection"
        How the parameters are identified, see :mod:`skhyst.optimize`.

    Attributes
    ----------
    operator_ : LuGreOperator
        ``presliding_displacement`` in units of the drive, ``stribeck_velocity`` in drive/s,
        ``coulomb_ratio`` F_c/F_s, ``static_force`` F_s in units of the response,
        ``bristle_damping`` sigma_1 and ``damping`` sigma_2 in response s/drive;
        ``bristle_stiffness`` sigma_0 and ``coulomb_force`` F_c follow.
    params_, params_std_ : dict
        Parameters and their standard errors.

    Notes
    -----
    The velocity is constant between samples and the bristles are stepped exactly; at a sample the
    velocity is the backward difference of the drive. See :class:`~skhyst.hysteresis.LuGreOperator`.

    References
    ----------
    C. Canudas de Wit, H. Olsson, K. J. Astrom, P. Lischinsky, "A new model for control of systems
    with friction", IEEE Trans. Automatic Control 40(3), 1995; NARMAX-LuGre paper, (1)-(4).

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import LuGre
    >>> from skhyst.hysteresis import LuGreOperator
    >>> time = np.arange(4000) * 0.005
    >>> drive = np.sin(time) + 0.3 * np.sin(4.4 * time) + 0.02 * np.sin(13.0 * time)
    >>> plant = LuGreOperator(0.05, 0.5, 0.6, static_force=8.0, bristle_damping=0.4, damping=0.3)
    >>> y, _ = plant.run(drive, 0.005)
    >>> model = LuGre(dt=0.005).fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.operator_.coulomb_ratio:.3f} {model.operator_.stribeck_velocity:.3f}")
    0.600 0.500
    """

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
        dt=1.0,
        method="variable_projection",
    ):
        self.stribeck = stribeck
        self.fit_bristle_damping = fit_bristle_damping
        self.fit_damping = fit_damping
        self.fit_stiffness = fit_stiffness
        self.fit_intercept = fit_intercept
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    def starting_values(self, records):
        length, speed, force = swing(records), top_speed(records), half_range(records)
        velocities, ratio = (_VELOCITIES, _RATIO) if self.stribeck else ((1.0,), 1.0)
        return [
            (LuGreOperator(part * length, velocity * speed, ratio, force), ())
            for part, velocity in product(_LENGTHS, velocities)
        ]

    def held_parameters(self):
        fixed = super().held_parameters()
        if not self.stribeck:
            fixed |= {"stribeck_velocity", "coulomb_ratio"}
        return fixed if self.fit_bristle_damping else fixed | {"bristle_damping"}
