r"""Mass, spring and damper with LuGre friction.

In units of the drive, with ``v = q'`` and ``f = rho z``,

    q''/w^2 + 2 zeta q'/w + q + F = u,   F = f + (2 zeta_b / w) z',
    z' = v (1 - sgn(v) f / g(v)),        g(v) = Fs (c + (1 - c) exp(-(v / vs)^2))

(Canudas de Wit et al., *IEEE Transactions on Automatic Control*, 1995). Along the displacement D of
a substep h (see ``_oscillator``) f decays towards ``sgn(D) g``: with the exponent
``a = rho |D| / g``, ``E = exp(-a)``, ``phi = (1 - E) / a`` and ``psi = (1 - phi) / a``

    f1 = E f0 + rho phi D,   mean f = phi f0 + rho psi D,   mean z' = (f1 - f0) / (rho h),

which is linear in D while a is held. D is solved for twice: with the exponent for the speed at the
start of the substep, then with the exponent for the D found. This makes the method second order;
any exponent keeps the energy balance, because f1 and the mean are those of one solution.
"""

import math
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from .._jit import jit
from ..operators import parameter
from ._lugre import LuGreOperator
from ._oscillator import (
    FREE_D,
    OWN,
    PARAMETERS,
    SLOPE_B,
    B,
    F,
    OscillatorModel,
    OscillatorOperator,
    P,
    begin_sample,
    decay,
    loops,
    mean_factor,
    move_tangents,
    oscillator,
    propagate,
    pull_tangents,
    scaled,
    solve_tangents,
)

_TINY = 1e-100  # smallest level: without friction g = 0
_LARGEST = 1e100  # largest exponent
_W, _, _FS, _RATIO, _VS, _RHO, _BRISTLE = range(OWN, OWN + 7)  # columns of the derivatives
# the columns that are not zero
_NONZERO = np.array([FREE_D, P, F, B, _W, _FS, _RATIO, _VS, _RHO, _BRISTLE])


@jit
def exponent(guess, law):
    """Return the exponent a for the displacement ``guess``, ``1 / g`` and ``exp(-(v / vs)^2)``."""
    fs, ratio, inverse, rho, _ = law
    x = guess * inverse
    bell = math.exp(-min(x * x, 700.0))
    share = 1.0 / max(fs * (ratio + (1.0 - ratio) * bell), _TINY)
    return min(rho * abs(guess) * share, _LARGEST), share, bell


@jit
def displacement(guess, free_d, b, f, law):
    """Return D, the mean force F and the new f, with the exponent held at that of ``guess``.

    ``free_d`` is D without friction, b its decrease per force F, ``law`` the tuple (Fs, c,
    1 / (h vs), rho, eta) with ``eta = 2 zeta_b / (w h)``.
    """
    rho, eta = law[3], law[4]
    a, _, _ = exponent(guess, law)
    decayed, phi, psi, _ = decay(a)
    by_f = phi - eta / rho * decayed
    by_delta = rho * psi + eta * phi
    delta = (free_d - b * by_f * f) / (1.0 + b * by_delta)
    return delta, by_f * f + by_delta * delta, f - decayed * f + rho * phi * delta


@jit
def displacement_tangents(guess, free_d, b, f, law, vs, eta_w, eta_bristle, by):
    """Return the results of :func:`displacement` and write their derivatives to ``by``.

    On entry ``by[0]`` are the derivatives of the guess; ``eta_w`` and ``eta_bristle`` are those of
    eta by w and zeta_b.
    """
    fs, ratio, inverse, rho, eta = law
    a, share, bell = exponent(guess, law)
    decayed, phi, psi, chi = decay(a)
    lag = eta / rho
    force_f = phi - lag * decayed
    force_delta = rho * psi + eta * phi
    delta = (free_d - b * force_f * f) / (1.0 + b * force_delta)
    force = force_f * f + force_delta * delta
    # derivatives of the exponent; at rest the mean of both directions
    sign = 0.0 if guess == 0.0 else math.copysign(1.0, guess)
    x = guess * inverse
    bump = 2.0 * fs * (1.0 - ratio) * bell * x
    a_level = -a * share
    a_guess = rho * sign * share - a_level * bump * inverse
    for j in _NONZERO:
        by[2, j] = a_guess * by[0, j]
    by[2, _FS] += a_level * (ratio + (1.0 - ratio) * bell)
    by[2, _RATIO] += a_level * fs * (1.0 - bell)
    by[2, _VS] += a_level * bump * x * (1.0 / vs)
    by[2, _RHO] += abs(guess) * share
    # derivatives of F at constant D, then of D
    force_a = (psi - phi - lag * (1.0 - decayed)) * f
    force_a += (rho * (2.0 * chi - psi) + eta * (psi - phi)) * delta
    force_eta = phi * delta - decayed * f * (1.0 / rho)
    for j in _NONZERO:
        by[1, j] = force_a * by[2, j]
    by[1, F] += force_f
    by[1, _W] += force_eta * eta_w
    by[1, _RHO] += psi * delta + lag / rho * decayed * f
    by[1, _BRISTLE] += force_eta * eta_bristle
    solve_tangents(b, force_delta, force, by)
    # derivatives of the new f
    new_a = rho * (psi - phi) * delta - (1.0 - decayed) * f
    for j in _NONZERO:
        by[2, j] = rho * phi * by[0, j] + new_a * by[2, j]
    by[2, F] += 1.0 - decayed
    by[2, _RHO] += phi * delta
    return delta, force, f - decayed * f + rho * phi * delta


@jit(inline=True)
def friction(mode, law, h, q, p, f, u0, u1):
    """Return q, p and f after a substep; ``law`` is (w, Fs, c, vs, rho, zeta_b)."""
    w, fs, ratio, vs, rho, bristle = law
    constants = fs, ratio, 1.0 / (h * vs), rho, 2.0 * bristle / (w * h)
    free_d, free_p = oscillator(mode, q, p, u0, u1)
    delta, _, _ = displacement(h * w * p, free_d, mode[2], f, constants)
    delta, force, f = displacement(delta, free_d, mode[2], f, constants)
    return q + delta, free_p - mode[3] * force, f


@jit
def friction_tangents(
    mode, mode_by, law, h, n_substeps, u, du, factor, dfactor, before, dbefore, q, p, f, d,
    out, dout,
):  # fmt: skip
    """Write q and its tangents.

    The parameters are w, zeta, Fs, c, vs, rho, zeta_b and, if there is one, the gradient.
    """
    w, fs, ratio, vs, rho, bristle = law
    eta_bristle = 2.0 / (w * h)
    eta = bristle * eta_bristle
    constants = fs, ratio, 1.0 / (h * vs), rho, eta
    n_own = dout.shape[1] - du.shape[1]
    step = np.empty((3, PARAMETERS + n_own))
    by = np.zeros((3, OWN + n_own))
    for k in range(u.size):
        u0 = before
        first = begin_sample(d, du.shape[1], step)
        for i in range(n_substeps):
            start, stop = i / n_substeps, (i + 1) / n_substeps
            u1 = before + (u[k] - before) * stop
            loaded = scaled(mode, mean_factor(factor[k], factor[k + 1], start, stop), q, p)
            free_d, free_p = oscillator(loaded, q, p, u0, u1)
            delta, new = h * w * p, f
            for j in _NONZERO:
                by[0, j] = 0.0
            by[0, P], by[0, _W] = h * w, h * p
            by[1, SLOPE_B] = 0.0
            for _ in range(2):
                delta, force, new = displacement_tangents(
                    delta, free_d, loaded[2], f, constants, vs, -eta / w, eta_bristle, by
                )
            pull_tangents(loaded[3], force, by)
            if n_own > 7:
                for i_state in range(3):
                    by_factor = by[i_state, B] * loaded[6] + by[i_state, SLOPE_B] * loaded[7]
                    by[i_state, -1] = loaded[11] * by_factor
            move_tangents(loaded, mode_by, by, q, p, u0, u1, start, stop, step, first)
            q += delta
            p = free_p - loaded[3] * force
            f = new
            u0 = u1
        propagate(step, k, du, dfactor, dbefore, d, dout)
        before = u[k]
        out[k] = q


@dataclass(frozen=True)
class FrictionStageOperator(OscillatorOperator, loops=(*loops(friction), friction_tangents)):
    r"""Mass, spring and damper with LuGre friction, driven by a force or a voltage.

    The equations of :class:`FrictionStage` divided by ``b``: displacement ``q`` and forces are in
    units of the drive, and ``u`` moves the stage without friction by ``q = u`` at rest.

    Parameters
    ----------
    damping_ratio : float
        :math:`\zeta` of damper and viscous friction together.
    static_level : float
        ``F_s``: drive that overcomes the friction of very slow sliding, units of the drive.
    coulomb_ratio : float
        ``r = F_c / F_s``: friction in fast over friction in slow sliding, from 0 to 1.
    stribeck_velocity : float
        ``v_s`` in drive/s; in units of the response it is ``|gain| v_s``.
    bristle_stiffness : float
        :math:`\rho = \sigma_0 / k`, relative to the spring.
    bristle_damping : float, default=0.0
        :math:`\zeta_b = \sigma_1 / (2 \sqrt{k m})`, added to :math:`\zeta` before sliding.
    friction_gradient : float, default=0.0
        ``c``, one over the units of the drive: all friction but the viscous one is
        ``1 + c (q - q_f)`` times its own, but not below zero.
    friction_center : float, default=nan
        ``q_f``, units of the drive. NaN: friction is the same everywhere, and the gradient is not
        identified. Fixed structure.

    Notes
    -----
    State and substeps are those of :class:`OscillatorOperator`; at rest ``g = F_s``. With
    ``bristle_damping`` the LuGre model itself is not passive.

    Examples
    --------
    After a slow drive, friction holds the stage away from zero:

    >>> import numpy as np
    >>> from skhyst.hysteresis import FrictionStageOperator
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
    hold: str = "foh"
    friction_gradient: float = parameter(default=0.0, unit="1/drive")
    friction_center: float = math.nan

    _force = ("static_level", "bristle_stiffness")

    def parameter_specs(self):
        specs = super().parameter_specs()
        ends = {name: specs.pop(name) for name in ("gain", "intercept")}
        if not math.isfinite(self.friction_center):
            del specs["friction_gradient"]
        return specs | ends

    @property
    def _force_gradient(self):
        known = math.isfinite(self.friction_center)
        return (self.friction_gradient, self.friction_center) if known else (0.0, 0.0)

    def fastest_rate(self):
        # friction that changes along the way is a spring of either sign while the mass slides
        spring = self.static_level * abs(self._force_gradient[0])
        return float(self.natural_frequency * math.sqrt(1.0 + self.bristle_stiffness + spring))

    def physical(self, mass=1.0):
        """Return the quantities of the equation of motion for a known mass.

        Those of :meth:`OscillatorOperator.physical`, with the viscous friction in the damping, and
        ``coulomb_force``, ``static_force``, ``stribeck_velocity``, ``bristle_stiffness`` and
        ``bristle_damping``; where friction changes along the way, ``friction_gradient``, one over
        the units of the response, and the response ``friction_center``.
        """
        p = super().physical(mass)
        static_force = abs(p["drive_gain"]) * self.static_level
        along = {}
        if math.isfinite(self.friction_center):
            along["friction_gradient"] = self.friction_gradient / self.gain
            along["friction_center"] = float(self.gain * self.friction_center + self.intercept)
        return p | {
            "coulomb_force": static_force * self.coulomb_ratio,
            "static_force": static_force,
            "stribeck_velocity": abs(self.gain) * self.stribeck_velocity,
            "bristle_stiffness": self.bristle_stiffness * p["stiffness"],
            "bristle_damping": 2.0 * self.bristle_damping * self.natural_frequency * mass,
            **along,
        }

    def characteristics(self, seen):
        velocity = abs(self.gain) * self.stribeck_velocity
        falls = {"stribeck velocity": (velocity, "response/s")} if self.coulomb_ratio < 1.0 else {}
        return {
            "Coulomb force": (self.static_level * self.coulomb_ratio, "drive"),
            **falls,
            "presliding displacement": (self.presliding_displacement, "response"),
        }

    def _parameters_under_feedback(self, s, shift):
        return {
            "stribeck_velocity": self.stribeck_velocity * s,
            "bristle_stiffness": self.bristle_stiffness / s,
            "bristle_damping": self.bristle_damping / math.sqrt(s),
            "friction_gradient": self.friction_gradient / s,
            "friction_center": s * self.friction_center + shift,
        }

    def _rest(self, u0):
        level = float(self.static_level)
        rho, target = float(self.bristle_stiffness), abs(u0)
        # q + level (1 - exp(-rho q / level)) = |u0|: increasing and concave in q, so Newton's
        # method converges to the root from below
        q = max(target / (1.0 + rho), target - level)
        for _ in range(100):
            exponent = rho * q / level if level else math.inf
            decayed = -math.expm1(-exponent)
            step = (target - q - level * decayed) / (1.0 + rho * (1.0 - decayed))
            q += step
            if not step > 4e-16 * q:
                break
        exponent = rho * q / level if level else math.inf
        remaining = math.exp(-exponent)
        sign = math.copysign(1.0, u0)
        scaled = exponent * remaining if remaining else 0.0
        share = 1.0 / (1.0 + rho * remaining)
        by = np.zeros((2, 1 + self.n_parameters - 2))
        by[1, 0] = rho * remaining * share
        by[1, 3] = sign * (1.0 - remaining - scaled) * share
        by[1, 6] = sign * q * remaining * share
        by[0] = -by[1]
        by[0, 0] = share
        return sign * q, sign * (target - q), by

    def _law(self, largest):
        levels = self.static_level, self.coulomb_ratio, self.stribeck_velocity
        bristles = self.bristle_stiffness, self.bristle_damping
        return tuple(map(float, (self.natural_frequency, *levels, *bristles)))


# starting values: presliding displacement as fraction of the response's half range; Stribeck
# velocity over its root mean square speed; Coulomb ratio
_DISPLACEMENTS = (0.003, 0.01, 0.03, 0.1, 0.3)
_SPEEDS = (0.15, 0.5, 1.7)
_RATIOS = (0.85, 0.55)
# a fit is degenerate if its Stribeck velocity is a factor _FAR beyond those of all starting values,
# or its Coulomb ratio above _FLAT
_FAR, _FLAT = 5.0, 0.99
_N_RETRIES = 4


class FrictionStage(OscillatorModel):
    r"""Mass, spring and damper with LuGre friction: a positioning stage.

    .. math::

        m \ddot x + d \dot x + k x + F = b u, \qquad
        F = \sigma_0 z + \sigma_1 \dot z + \sigma_2 \dot x, \qquad y = x + c

        \dot z = v - \frac{\sigma_0 |v|}{g(v)} z, \quad
        g(v) = F_c + (F_s - F_c) e^{-(v/v_s)^2}, \quad v = \dot x

    The drive ``u`` is a force or a voltage, the response a displacement. The equation is divided by
    ``b``, since the response to a drive does not determine the mass; friction levels are then in
    units of the drive. :math:`\sigma_2` is included in ``d``: only their sum is identifiable.

    Parameters
    ----------
    stribeck : bool, default=True
        Whether friction falls from ``F_s`` to ``F_c`` as the velocity rises; with False both are
        equal.
    fit_bristle_damping : bool, default=True
        Whether :math:`\sigma_1` is fitted (0 otherwise).
    friction_gradient : bool, default=False
        Whether F but for :math:`\sigma_2` changes along the way, by a factor
        :math:`1 + c (x - x_f)`.

    Attributes
    ----------
    operator_ : FrictionStageOperator
        ``natural_frequency`` (rad/s), ``damping_ratio``, ``static_level`` (units of the drive),
        ``coulomb_ratio``, ``stribeck_velocity`` (drive/s), ``bristle_stiffness`` (relative to the
        spring), ``bristle_damping`` (a damping ratio), ``friction_gradient`` (1/drive), ``gain``,
        ``intercept``.

    See Also
    --------
    LuGre : The friction force alone, of a given motion.
    CoulombFriction : Friction that depends on the velocity alone.

    Notes
    -----
    Starting values come from the force balance, in which the friction follows from the measured
    displacement. Then the stage is identified while it is coupled to the measured response by
    springs of several stiffnesses, and finally in a free run. A record should contain both sticking
    and sliding, and sliding both below and above the Stribeck velocity; otherwise standard errors
    and ``identifiability_`` report which parameters are not determined.

    Equations (1) to (4) of Amor et al. print ``dz/dt = x - ...`` and the Stribeck curve
    ``exp(-(x / x')^2)``; velocities are meant.

    References
    ----------
    Amor, Kaddouri and Abdessemed, *International Journal of Power Electronics and Drive Systems*,
    2023, (1) to (4). Canudas de Wit et al., *IEEE Transactions on Automatic Control*, 1995.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import FrictionStage, FrictionStageOperator
    >>> time = np.arange(1500) * 0.01
    >>> drive = np.sin(0.7 * time) + 0.8 * np.sin(2.9 * time) + 0.3 * np.sin(11.0 * time)
    >>> plant = FrictionStageOperator(20.0, 0.5, 0.4, 0.7, 1.5, 10.0, gain=3.0)
    >>> y, _ = plant.run(drive, 0.01)
    >>> model = FrictionStage(fit_bristle_damping=False, mass=2.0, dt=0.01)
    >>> model = model.fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.operator_.static_level:.2f} {model.operator_.coulomb_ratio:.2f}")
    0.40 0.70
    >>> print(f"{model.physical_['stiffness']:.0f}")
    800
    """

    operator_class = FrictionStageOperator
    _parameter_constraints = {
        **OscillatorModel._parameter_constraints,
        "stribeck": ["boolean"],
        "fit_bristle_damping": ["boolean"],
        "friction_gradient": ["boolean"],
    }

    def __init__(
        self,
        stribeck=True,
        *,
        fit_bristle_damping=True,
        friction_gradient=False,
        fit_intercept=True,
        mass=1.0,
        n_substeps=None,
        hold="foh",
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        super().__init__(initial_state=initial_state, dt=dt, drive=drive, method=method)
        self.stribeck = stribeck
        self.fit_bristle_damping = fit_bristle_damping
        self.friction_gradient = friction_gradient
        self.fit_intercept = fit_intercept
        self.mass = mass
        self.n_substeps = n_substeps
        self.hold = hold

    def _laws(self, length, speed):
        kinds = product(_RATIOS, _SPEEDS) if self.stribeck else [(1.0, 1.0)]
        return [
            [(part * length, fraction * speed, ratio) for part in _DISPLACEMENTS]
            for ratio, fraction in kinds
        ]

    def _stage(self, law, mode, scales, factors=None, **level):
        stage = super()._stage(law, mode, scales, factors, **level)
        if stage is None or not self.friction_gradient:
            return stage
        return replace(stage, friction_center=float((scales[1] - stage.intercept) / stage.gain))

    def _forces(self, law, y, dt, length):
        displacement, speed, ratio = law
        return LuGreOperator(displacement, speed, ratio, displacement).run(y, dt)[0][:, None]

    def _own_parameters(self, law, gain, stiffness, level, swing):
        _, speed, ratio = law
        return {
            "static_level": level,
            "coulomb_ratio": ratio,
            "stribeck_velocity": speed / abs(gain),
            "bristle_stiffness": stiffness,
        }

    def _retries(self, stage, stages):
        """Return the starts with the highest Stribeck velocities if the fit is degenerate.

        If friction does not fall at the speeds of the records, the Stribeck parameters have no
        gradient, so the fit cannot leave such a stage by itself.
        """
        speeds = np.array([start.stribeck_velocity for start in stages])
        seen = speeds.min() / _FAR < stage.stribeck_velocity < speeds.max() * _FAR
        if not self.stribeck or (seen and stage.coulomb_ratio < _FLAT):
            return []
        fast = np.sort(speeds)[-min(_N_RETRIES, len(speeds))]
        return [start for start, speed in zip(stages, speeds, strict=True) if speed >= fast]

    def held_parameters(self) -> frozenset[str]:
        fixed = super().held_parameters()
        return fixed if self.stribeck else fixed | {"stribeck_velocity", "coulomb_ratio"}
