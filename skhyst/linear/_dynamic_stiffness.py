"""Force from a measured motion: mass, dashpot and spring, ``y = m u'' + d u' + k u + c``.

The first derivative is the least-squares slope over the last ``smoothing`` intervals, the backward
difference by default; the second is the same slope of the first. Both are causal and lag by
``smoothing / 2`` and ``smoothing`` intervals. With "rest" the motion before a record is unknown,
since a record may begin in motion: a derivative is zero until the record is as long as its window.
"""

from dataclasses import dataclass
from numbers import Integral

import numpy as np

from .._jit import jit
from .._sklearn import Interval, StrOptions
from ..base import ParametricModel
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


@jit
def stiffness_step(u, c, s):
    """Return the force at one sample; ``s`` is the state of one or two :func:`slope_step`.

    ``c`` is (weights of the differences, mass, damping, stiffness, intercept, whether the drive is
    a velocity).
    """
    weights, mass, damping, stiffness, y, is_velocity = c
    first = slope_step(u, weights, s, 0)
    if is_velocity > 0.0:
        return y + mass * first + damping * u
    second = 0.0
    if s[0] == 0.0:  # before, the first slope is not known and must not enter the second
        second = slope_step(first, weights, s, weights.size + 2)
    return y + mass * second + damping * first + stiffness * u


@dataclass(frozen=True)
class DynamicStiffnessOperator(Operator):
    """Equation of motion with the force as response, see :class:`DynamicStiffness`.

    The state is the last samples, at most ``2 smoothing`` of a displacement and ``smoothing`` of a
    velocity.

    Parameters
    ----------
    mass : float, default=0.0
        ``m`` in response s^2/drive; if the drive is a velocity, in response s/drive.
    damping : float, default=0.0
        ``d`` in response s/drive; if the drive is a velocity, in response/drive.
    stiffness : float, default=0.0
        Spring ``k`` in response/drive; 0 if the drive is a velocity.
    intercept : float, default=0.0
        Constant ``c`` in units of the response.
    drive : {"displacement", "velocity"}, default="displacement"
        What the drive is. Fixed structure.
    smoothing : int, default=1
        Intervals over which a slope is taken. Fixed structure.

    Raises
    ------
    ValueError
        If ``smoothing`` is not above 0, ``drive`` is unknown, or there is a stiffness and the drive
        is a velocity.

    Examples
    --------
    >>> from skhyst.linear import DynamicStiffnessOperator
    >>> operator = DynamicStiffnessOperator(mass=2.0, damping=1.0, stiffness=10.0)
    >>> operator.run([0.0, 0.0, 0.5, 1.5, 2.5], dt=1.0)[0]
    array([ 0. ,  0. ,  6.5, 17. , 26. ])
    """

    mass: float = parameter(default=0.0, linear=True, unit="response s^2/drive")
    damping: float = parameter(default=0.0, linear=True, unit="response s/drive")
    stiffness: float = parameter(default=0.0, linear=True, unit="response/drive")
    intercept: float = parameter(default=0.0, linear=True, gauge=0.0, unit="response")
    drive: str = "displacement"
    smoothing: int = 1
    signal_linear = True
    owns_gain = True
    stage_order = 10

    def __post_init__(self):
        super().__post_init__()
        self._require("smoothing", self.smoothing > 0, "be above 0")
        known = self.drive in ("displacement", "velocity")
        self._require("drive", known, "be 'displacement' or 'velocity'")
        is_right = self.drive == "displacement" or not self.stiffness
        self._require("stiffness", is_right, "be 0 where the drive is a velocity")

    def parameter_specs(self):
        specs = super().parameter_specs()
        if self.drive == "velocity":  # one derivative less in each unit, and no stiffness
            specs["mass"], specs["damping"] = specs["damping"], specs["stiffness"]
            del specs["stiffness"]
        return specs

    @property
    def _n_past(self):
        return self.smoothing * (2 if self.drive == "displacement" else 1)

    def _terms(self, u, past, dt):
        """Return the regressors of mass, damping and, for a displacement, stiffness."""
        first = slopes(np.concatenate([past, u]), dt, self.smoothing)
        if self.drive == "velocity":
            return latest(first, len(u)), u
        return latest(slopes(first, dt, self.smoothing), len(u)), latest(first, len(u)), u

    def init(self, u0, initial_state="rest"):
        return samples_before((), self._n_past, initial_state)

    def run(self, u, dt, state=None):
        u = as_signal(u)
        if state is None:
            state = self.init(u[0] if u.size else 0.0)
        if not u.size:
            return np.empty(0), state
        y = np.full(u.size, float(self.intercept))
        for value, term in zip(self.pack(), self._terms(u, state, dt), strict=False):
            if value:
                y += value * term
        return y, np.concatenate([state, u])[-self._n_past :]

    def compiled_step(self, dt, state):
        weights, begin = stepped_slopes(dt, self.smoothing)
        values = self.mass, self.damping, self.stiffness, self.intercept, self.drive == "velocity"
        n_slopes = self._n_past // self.smoothing
        return CompiledLaw(stiffness_step, (weights, *values), np.tile(begin, n_slopes)).behind(
            state
        )

    def sensitivities(self, u, du, dt, initial_state="rest"):
        u, m = as_signal(u), du.shape[1]
        values = self.pack()
        dy = np.zeros((u.size, m + len(values)))
        y = np.full(u.size, float(self.intercept))
        terms = self._terms(u, self.init(u[0], initial_state), dt)
        propagated = self._terms(du, samples_before((m,), self._n_past, initial_state), dt)
        for i, (term, tangents) in enumerate(zip(terms, propagated, strict=True)):
            dy[:, m + i] = term
            y += values[i] * term
            dy[:, :m] += values[i] * tangents
        dy[:, -1] = 1.0
        return y, dy


class DynamicStiffness(ParametricModel):
    r"""Inverse dynamics of mass, dashpot and spring: the force that goes with a motion.

    .. math:: y = m \ddot u + d \dot u + k u + c, \qquad \text{or } y = m \dot u + d u + c

    The drive ``u`` is a measured displacement or velocity, and the response the force (current,
    pressure, voltage of a motor) measured with it: the model of a damper on a test bench, and of a
    robot joint that is identified from its inverse dynamics. All parameters are linear and solved
    exactly. A friction force is added in parallel in a :class:`~skhyst.compose.Sum`.

    Parameters
    ----------
    fit_mass, fit_damping : bool, default=True
        Whether ``m`` and ``d`` are fitted (0 otherwise).
    fit_stiffness : bool, default=True
        Whether ``k`` is fitted (0 otherwise, and for a velocity).
    fit_intercept : bool, default=True
        Whether the response has a constant (a force offset).
    drive : {"displacement", "velocity"}, default="displacement"
        What the drive, column 0 of X, is.
    smoothing : int, default=1
        Sampling intervals over which slopes are taken. 1 is the backward difference, exact for a
        drive that is linear between samples; take more for an encoder whose noise or quantisation
        differences would amplify.

    Attributes
    ----------
    operator_ : DynamicStiffnessOperator
        ``mass``, ``damping``, ``stiffness`` and ``intercept``.

    See Also
    --------
    SecondOrderMode : The motion under a force.

    Notes
    -----
    Derivatives are causal: the velocity lags by ``smoothing / 2`` intervals and the acceleration
    by ``smoothing``. Keep these lags short relative to the motion: a lag of the velocity appears as
    an additional mass of about damping times lag.

    Differentiation amplifies noise: where the displacement has a standard error e, acceleration
    from backward differences has 2.4 e/dt^2. Where the displacement is noisier than the force,
    identify a :class:`SecondOrderMode` with the force as drive instead.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import DynamicStiffness
    >>> time = np.arange(4000) * 0.001
    >>> motion = np.sin(8.0 * time) + np.cos(21.0 * time) - 1.0
    >>> velocity = 8.0 * np.cos(8.0 * time) - 21.0 * np.sin(21.0 * time)
    >>> acceleration = -64.0 * np.sin(8.0 * time) - 441.0 * np.cos(21.0 * time)
    >>> force = 2.0 * acceleration + 30.0 * velocity + 500.0 * motion
    >>> model = DynamicStiffness(dt=0.001, initial_state="estimate").fit(motion[:, None], force)
    >>> print(f"{model.operator_.mass:.2f} {model.operator_.stiffness:.0f}")
    2.01 500

    The velocity lags by half an interval, which appears as an additional mass of about 30 times
    0.0005.
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "fit_mass": ["boolean"],
        "fit_damping": ["boolean"],
        "fit_stiffness": ["boolean"],
        "fit_intercept": ["boolean"],
        "drive": [StrOptions({"displacement", "velocity"})],
        "smoothing": [Interval(Integral, 1, None, closed="left")],
    }

    operator_class = DynamicStiffnessOperator
    redefined = ("drive",)  # says which quantity it is, not which column

    def __init__(
        self,
        fit_mass=True,
        *,
        fit_damping=True,
        fit_stiffness=True,
        fit_intercept=True,
        drive="displacement",
        smoothing=1,
        initial_state="rest",
        dt=None,
        method="variable_projection",
    ):
        super().__init__(initial_state=initial_state, dt=dt, method=method)
        self.fit_mass = fit_mass
        self.fit_damping = fit_damping
        self.fit_stiffness = fit_stiffness
        self.fit_intercept = fit_intercept
        self.drive = drive
        self.smoothing = smoothing

    def starting_values(self, records):
        return [DynamicStiffnessOperator(drive=self.drive, smoothing=int(self.smoothing))]
