"""Coulomb friction: a function of the velocity alone."""

import dataclasses
import math
from dataclasses import dataclass
from itertools import product
from numbers import Integral

import numpy as np

from .._jit import jit
from .._sklearn import Interval, StrOptions
from ..base import refine
from ..noise import largest_noise
from ..operators import (
    CompiledLaw,
    Operator,
    as_signal,
    latest,
    parameter,
    samples_before,
    slope_step,
    slopes,
    stepped_slopes,
)
from ._common import FrictionModel, half_range, largest_drive, speed_noise, top_speed

_FAR = 30.0  # largest v / v_s: beyond it exp(-(v/v_s)^2) is zero, and its square stays small


def response(u, v, s, fall, values):
    """Return the response at the velocity v, its smooth sign s and the Stribeck curve ``fall``."""
    coulomb, stribeck, asymmetry, stiffness, damping, intercept = values
    level = coulomb + stribeck * fall + asymmetry * s
    return level * s + stiffness * u + damping * v + intercept


compiled_response = jit(response)


@jit
def coulomb_step(u, c, s):
    """Return the response at one sample; ``s`` is the state of :func:`slope_step`.

    ``c`` is (weights of the differences, whether the drive is a velocity, v_0, v_s, *values of
    :func:`response`).
    """
    weights, is_velocity, transition, stribeck = c[:4]
    v = slope_step(u, weights, s, 0)
    if is_velocity > 0.0:
        v = u
    ratio = min(max(v / stribeck, -_FAR), _FAR)
    return compiled_response(u, v, math.tanh(v / transition), math.exp(-ratio * ratio), c[4:])


@dataclass(frozen=True)
class CoulombFrictionOperator(Operator):
    """Coulomb friction, a spring, a dashpot and a constant: the law of :class:`CoulombFriction`.

    Parameters
    ----------
    transition_velocity : float
        ``v_0`` in drive/s, positive: far below it friction is proportional to the velocity.
    coulomb_force : float
        ``F_c``, friction of fast sliding, units of the response.
    stribeck_velocity : float, default=1.0
        ``v_s`` in drive/s, positive.
    stribeck_force : float, default=0.0
        ``F_d = F_s - F_c``: additional friction of slow sliding, units of the response.
    asymmetry : float, default=0.0
        ``a``, units of the response: friction is ``F_c + a`` forward and ``F_c - a`` backward.
    stiffness : float, default=0.0
        Spring ``k`` in response/drive.
    damping : float, default=0.0
        Dashpot ``d`` in response s/drive.
    intercept : float, default=0.0
        Constant ``c`` in units of the response.
    slowest, fastest : float, default=0.0 and infinity
        Bounds of ``v_0`` and ``v_s`` in drive/s. Fixed structure.
    smoothing : int, default=1
        Sampling intervals over which the velocity is estimated. Fixed structure.
    motion : {"displacement", "velocity"}, default="displacement"
        Kind of the drive. With a velocity there is no stiffness, and the units of ``v_0``, ``v_s``
        and ``d`` are those of the drive, without 1/s. Fixed structure.

    Raises
    ------
    ValueError
        If ``motion`` is unknown, or there is a stiffness and the drive is a velocity.

    Notes
    -----
    The velocity is the least-squares slope over the last ``smoothing`` intervals, the backward
    difference by default, and lags by half of them. In ``"rest"`` it is zero until a record is that
    long. The state is the array of the last samples, at most ``smoothing``.

    Examples
    --------
    >>> from skhyst.hysteresis import CoulombFrictionOperator
    >>> operator = CoulombFrictionOperator(0.01, coulomb_force=3.0, damping=1.0)
    >>> operator.run([0.0, 0.5, 1.0, 1.0, 0.0], dt=1.0)[0]
    array([ 0. ,  3.5,  3.5,  0. , -4. ])
    """

    transition_velocity: float = parameter(log=True, lower=0.0, unit="drive/s")
    coulomb_force: float = parameter(linear=True, unit="response")
    stribeck_velocity: float = parameter(default=1.0, log=True, lower=0.0, unit="drive/s")
    stribeck_force: float = parameter(default=0.0, linear=True, unit="response")
    asymmetry: float = parameter(default=0.0, linear=True, unit="response")
    stiffness: float = parameter(default=0.0, linear=True, unit="response/drive")
    damping: float = parameter(default=0.0, linear=True, unit="response s/drive")
    intercept: float = parameter(default=0.0, linear=True, gauge=0.0, unit="response")
    slowest: float = 0.0
    fastest: float = np.inf
    smoothing: int = 1
    motion: str = "displacement"

    owns_gain = True
    stage_order = 10

    def __post_init__(self):
        super().__post_init__()
        self._require("smoothing", self.smoothing > 0, "be above 0")
        known = self.motion in ("displacement", "velocity")
        self._require("motion", known, "be 'displacement' or 'velocity'")
        is_right = self.motion == "displacement" or not self.stiffness
        self._require("stiffness", is_right, "be 0 where the drive is a velocity")

    @property
    def memoryless(self):
        """Whether the drive is a velocity."""
        return self.motion == "velocity"

    def parameter_specs(self):
        specs = super().parameter_specs()
        if self.motion == "velocity":  # one derivative less in each unit, and no stiffness
            specs["damping"] = specs.pop("stiffness")
            for name in ("transition_velocity", "stribeck_velocity"):
                specs[name] = dataclasses.replace(specs[name], unit="drive")
        for name in ("transition_velocity", "stribeck_velocity"):
            specs[name] = dataclasses.replace(specs[name], lower=self.slowest, upper=self.fastest)
        return specs

    def _curves(self, v):
        """Return ``s``, the Stribeck curve, and ``v/v_s``, limited to +-_FAR."""
        ratio = np.clip(v / self.stribeck_velocity, -_FAR, _FAR)
        return np.tanh(v / self.transition_velocity), np.exp(-(ratio**2)), ratio

    def init(self, u0, initial_state="rest"):
        return samples_before((), self.smoothing, initial_state)

    def _velocity(self, u, past, dt):
        if self.motion == "velocity":
            return u
        return latest(slopes(np.concatenate([past, u]), dt, self.smoothing), len(u))

    def run(self, u, dt, state=None):
        u = as_signal(u)
        if state is None:
            state = self.init(u[0] if u.size else 0.0)
        if not u.size:
            return np.empty(0), state
        v = self._velocity(u, state, dt)
        after = np.concatenate([state, u])[-self.smoothing :]
        s, fall, _ = self._curves(v)
        return response(u, v, s, fall, self._values()), after

    def _values(self):
        levels = self.coulomb_force, self.stribeck_force, self.asymmetry
        return *levels, self.stiffness, self.damping, self.intercept

    def compiled_step(self, dt, state):
        weights, begin = stepped_slopes(dt, self.smoothing)
        is_velocity = float(self.motion == "velocity")
        constants = weights, is_velocity, self.transition_velocity, self.stribeck_velocity
        return CompiledLaw(coulomb_step, (*constants, *self._values()), begin).behind(state)

    def sensitivities(self, u, du, dt, initial_state="rest"):
        u, m = as_signal(u), du.shape[1]
        v = self._velocity(u, self.init(u[0], initial_state), dt)
        s, fall, ratio = self._curves(v)
        dy = np.empty((u.size, m + self.n_parameters))
        by_s = self.coulomb_force + self.stribeck_force * fall + 2.0 * self.asymmetry * s
        steep = by_s * (1.0 - s**2) / self.transition_velocity
        stribeck_slope = 2.0 * self.stribeck_force * s * fall * ratio / self.stribeck_velocity
        if m:
            dv = self._velocity(du, samples_before((m,), self.smoothing, initial_state), dt)
            by_v = steep - stribeck_slope + self.damping
            dy[:, :m] = by_v[:, None] * dv + self.stiffness * du
        dy[:, m] = -steep * (v / self.transition_velocity)
        dy[:, m + 1] = s
        dy[:, m + 2] = stribeck_slope * ratio
        dy[:, m + 3] = fall * s
        dy[:, m + 4] = s**2
        if self.motion == "displacement":
            dy[:, -3] = u
        dy[:, -2], dy[:, -1] = v, 1.0
        return response(u, v, s, fall, self._values()), dy


# fractions of the drive's top speed: starting transition and Stribeck velocities, bounds of both
_TRANSITIONS = (0.0005, 0.005, 0.03, 0.15)
_VELOCITIES = (0.03, 0.1, 0.3, 0.9)
_SLOWEST, _NOISIEST, _FASTEST = 1e-5, 0.1, 3.0
_QUIET = 3.0  # least transition velocity, in standard errors of the velocity


class CoulombFriction(FrictionModel):
    r"""Coulomb friction: a force that depends on the velocity alone.

    .. math::

        y = \left(F_c + F_d e^{-(v/v_s)^2} + a s\right) s + k u + d v + c, \qquad
        s = \tanh(v / v_0), \quad v = \dot u

    The drive ``u`` is a displacement, the response a force (or anything that follows it).
    Only ``v_0`` and ``v_s`` are searched; all other parameters are linear and solved exactly. Use
    :class:`Dahl`, :class:`MaxwellSlip` or :class:`LuGre` if friction builds up with the
    displacement rather than with the velocity.

    Parameters
    ----------
    stribeck : bool, default=False
        Whether friction is larger by ``F_d`` in slow sliding, below the Stribeck velocity ``v_s``.
    asymmetry : bool, default=False
        Whether friction is ``F_c + a`` forward and ``F_c - a`` backward. For a drive that never
        rests, ``a`` cannot be distinguished from the constant ``c``.
    smoothing : int, default=1
        Sampling intervals over which the velocity is estimated by a least-squares slope, which lags
        by half of them; 1 is the backward difference.
    motion : {"displacement", "velocity"}, default="displacement"
        Kind of the drive: a displacement, whose velocity is estimated, or the velocity itself, such
        as from a tachometer. Then there is no stiffness.

    Attributes
    ----------
    operator_ : CoulombFrictionOperator
        ``transition_velocity`` and ``stribeck_velocity`` in drive/s; ``coulomb_force``,
        ``stribeck_force`` F_d, ``asymmetry`` a and ``intercept`` in units of the response;
        ``stiffness`` in response/drive, ``damping`` in response s/drive.

    See Also
    --------
    LuGre : Friction with presliding and the Stribeck effect.
    FrictionStage : A mass whose motion friction resists.

    Notes
    -----
    The transition velocity is at least three standard errors of the velocity, or a tenth of the
    drive's top speed if that is less, so that the force does not chatter while the drive rests;
    unless the residual is coloured and the error without this limit is noticeably lower.

    References
    ----------
    Armstrong-Hélouvry, Dupont and Canudas de Wit, *Automatica*, 1994.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import CoulombFriction
    >>> drive = np.sin(np.linspace(0, 20, 2000))
    >>> velocity = np.diff(drive, prepend=0.0) / 0.01
    >>> y = 5.0 * np.tanh(velocity / 0.05) + 0.3 * velocity
    >>> model = CoulombFriction(dt=0.01).fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.operator_.coulomb_force:.2f} {model.operator_.damping:.2f}")
    5.00 0.30
    """

    operator_class = CoulombFrictionOperator
    _parameter_constraints = {
        **FrictionModel._parameter_constraints,
        "stribeck": ["boolean"],
        "asymmetry": ["boolean"],
        "smoothing": [Interval(Integral, 1, None, closed="left")],
        "motion": [StrOptions({"displacement", "velocity"})],
    }

    def __init__(
        self,
        stribeck=False,
        *,
        asymmetry=False,
        fit_damping=True,
        fit_stiffness=False,
        fit_intercept=True,
        smoothing=1,
        motion="displacement",
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        super().__init__(initial_state=initial_state, dt=dt, drive=drive, method=method)
        self.stribeck = stribeck
        self.asymmetry = asymmetry
        self.fit_damping = fit_damping
        self.fit_stiffness = fit_stiffness
        self.fit_intercept = fit_intercept
        self.smoothing = smoothing
        self.motion = motion

    def starting_values(self, records):
        if self.motion == "velocity":
            return self._starts(records, max(largest_noise(record.u) for record in records))
        return self._starts(records, speed_noise(records, int(self.smoothing)))

    def identified_otherwise(self, data, starts):
        # corners of the drive look like noise, which limits the transition velocity
        yield refine(self, self._starts(data, 0.0), data)
        yield from super().identified_otherwise(data, starts)

    def _starts(self, records, noise):
        """Return starting values for a standard error of the velocity, in drive/s."""
        smoothing, force = int(self.smoothing), half_range(records)
        is_velocity = self.motion == "velocity"
        top = largest_drive(records) if is_velocity else top_speed(records, smoothing)
        noise = min(_QUIET * noise, _NOISIEST * top)
        slowest, fastest = max(_SLOWEST * top, noise), _FASTEST * top
        transitions = np.unique(np.maximum(np.multiply(_TRANSITIONS, top), 1.5 * slowest))
        velocities = np.multiply(_VELOCITIES, top) if self.stribeck else [fastest]
        return [
            CoulombFrictionOperator(
                float(transition),
                force,
                float(velocity),
                slowest=slowest,
                fastest=fastest,
                smoothing=smoothing,
                motion=self.motion,
            )
            for transition, velocity in product(transitions, velocities)
            if velocity > transition
        ]

    def held_parameters(self) -> frozenset[str]:
        held = super().held_parameters() | (set() if self.asymmetry else {"asymmetry"})
        held = held - {"stiffness"} if self.motion == "velocity" else held
        return held if self.stribeck else held | {"stribeck_velocity", "stribeck_force"}
