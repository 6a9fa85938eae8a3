r"""Mass, spring and damper between end stops.

In units of the drive, with ``p = q'/w`` and the distances ``x`` by which q is beyond the stops,

    q''/w^2 + 2 zeta q'/w + q + F = u,   F = kappa x + 2 zeta_s x'/w   (upper stop, less the lower).

Along the displacement D of a substep (see ``_oscillator``), a straight line, the mean of x and its
change are known in closed form. ``D + b F(D)`` increases with D, so its root lies between 0 and the
displacement under the force at ``D = 0``; Newton's method, safeguarded by bisection, finds it
there.
"""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from .._jit import jit
from .._sklearn import StrOptions
from ..operators import parameter
from ._oscillator import (
    OWN,
    PARAMETERS,
    OscillatorModel,
    OscillatorOperator,
    Q,
    begin_sample,
    loops,
    mean_factor,
    move_tangents,
    oscillator,
    propagate,
    pull_tangents,
    scaled,
    solve_tangents,
)

_STEPS = 60  # halvings that reduce the bracket to rounding
_TOLERANCE = 1e-15
_W, _, _STIFFNESS, _DAMPING, _LEVELS = range(OWN, OWN + 5)  # columns of the derivatives


@jit
def contact(x0, x1):
    """Return the mean of ``max(x, 0)`` from x0 to x1, its derivatives by both, and its change."""
    deep, shallow = max(x0, x1), min(x0, x1)
    if deep <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    if shallow >= 0.0:
        return 0.5 * (x0 + x1), 0.5, 0.5, x1 - x0
    share = deep / (deep - shallow)  # fraction of the displacement in contact
    near, far = share - 0.5 * share * share, 0.5 * share * share
    if x1 > x0:
        return 0.5 * share * deep, far, near, x1
    return 0.5 * share * deep, near, far, -x0


@jit
def stops(q, delta, kappa, eta, lower, upper):
    """Return the mean force of both stops from q to ``q + delta`` and its slope by ``delta``."""
    # in contact q is near the stop: its distance has more digits than the displacement
    over, under = q - upper, lower - q
    above, _, by_above, more_above = contact(over, over + delta)
    below, _, by_below, more_below = contact(under, under - delta)
    touching = (1.0 if over + delta > 0.0 else 0.0) + (1.0 if under - delta > 0.0 else 0.0)
    force = kappa * (above - below) + eta * (more_above - more_below)
    return force, kappa * (by_above + by_below) + eta * touching


@jit(inline=True)
def stopped(free_d, b, q, kappa, eta, lower, upper):
    """Return the D that solves ``D = free_d - b F``, the mean F and its slope by D."""
    delta = free_d - b * kappa * (max(q - upper, 0.0) - max(lower - q, 0.0))
    near, far = 0.0, delta
    for _ in range(_STEPS):
        force, slope = stops(q, delta, kappa, eta, lower, upper)
        excess = delta + b * force - free_d
        # the excess increases with delta: of the same sign as the far end, delta is beyond the root
        if excess * far > 0.0:
            far = delta
        else:
            near = delta
        step = -excess / (1.0 + b * slope)
        if abs(step) <= _TOLERANCE * abs(delta):
            break
        delta += step
        if not (delta >= min(near, far) and delta <= max(near, far)):
            delta = 0.5 * (near + far)
    force, slope = stops(q, delta, kappa, eta, lower, upper)
    return delta, force, slope


@jit(inline=True)
def impact(mode, law, h, q, p, f, u0, u1):
    """Return q, p and f after a substep; ``law`` is (w, kappa, zeta_s, lower, upper)."""
    w, kappa, damping, lower, upper = law
    eta = 2.0 * damping / (w * h)
    free_d, free_p = oscillator(mode, q, p, u0, u1)
    delta, force, _ = stopped(free_d, mode[2], q, kappa, eta, lower, upper)
    return q + delta, free_p - mode[3] * force, f


@jit
def end_stops_tangents(
    mode, mode_by, law, h, n_substeps, u, du, factor, dfactor, before, dbefore, q, p, f, d,
    out, dout,
):  # fmt: skip
    """Write q and its tangents; the parameters are w, zeta, kappa, zeta_s and finite levels."""
    w, kappa, damping, lower, upper = law
    eta_damping = 2.0 / (w * h)
    eta = damping * eta_damping
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
            delta, force, slope = stopped(free_d, loaded[2], q, kappa, eta, lower, upper)
            end = q + delta
            above, above0, above1, more_above = contact(q - upper, end - upper)
            below, below0, below1, more_below = contact(lower - q, lower - end)
            by_upper = kappa * (above0 + above1) + eta * (1.0 * (end > upper) - 1.0 * (q > upper))
            by_lower = kappa * (below0 + below1) + eta * (1.0 * (end < lower) - 1.0 * (q < lower))
            by[1] = 0.0
            by[1, Q] = by_upper + by_lower
            by[1, _W] = -eta / w * (more_above - more_below)
            by[1, _STIFFNESS] = above - below
            by[1, _DAMPING] = eta_damping * (more_above - more_below)
            column = _LEVELS
            if lower > -math.inf:
                by[1, column] = -by_lower
                column += 1
            if upper < math.inf:
                by[1, column] = -by_upper
            solve_tangents(loaded[2], slope, force, by)
            pull_tangents(loaded[3], force, by)
            move_tangents(loaded, mode_by, by, q, p, u0, u1, start, stop, step, first)
            q = end
            p = free_p - loaded[3] * force
            u0 = u1
        propagate(step, k, du, dfactor, dbefore, d, dout)
        before = u[k]
        out[k] = q


@dataclass(frozen=True)
class EndStopsOperator(OscillatorOperator, loops=(*loops(impact), end_stops_tangents)):
    r"""Mass, spring and damper between end stops.

    The equations of :class:`EndStops` divided by ``b``: displacement ``q`` and forces are in units
    of the drive; a constant ``u`` holds the stage at ``q = u`` if it touches no stop.

    Parameters
    ----------
    stop_stiffness : float
        :math:`\kappa = k_s / k`, relative to the spring.
    stop_damping : float, default=0.0
        :math:`\zeta_s = d_s / (2 \sqrt{k m})`, added to :math:`\zeta` while the stage touches a
        stop.
    lower, upper : float, default=-inf, inf
        Positions of the stops, units of the drive: the static drive that just reaches them. An
        infinite one means no stop and is not identified. Stops that overlap clamp the stage.

    Notes
    -----
    State and substeps are those of :class:`OscillatorOperator`; the hysteretic force is zero.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import EndStopsOperator
    >>> stage = EndStopsOperator(50.0, 0.5, 19.0, upper=0.6)
    >>> drive = np.interp(np.arange(4000) * 1e-2, [0.0, 20.0, 40.0], [0.0, 1.0, -1.0])
    >>> y, _ = stage.run(drive, 1e-2)
    >>> print(f"{y.max():.2f} {y.min():.2f}")
    0.62 -1.00
    """

    natural_frequency: float = parameter(log=True, lower=0.0, unit="rad/s")
    damping_ratio: float = parameter(log=True, lower=0.0)
    stop_stiffness: float = parameter(log=True, lower=0.0)
    stop_damping: float = parameter(default=0.0, lower=0.0)
    lower: float = parameter(default=-math.inf, unit="drive")
    upper: float = parameter(default=math.inf, unit="drive")
    gain: float = parameter(default=1.0, linear=True, unit="response/drive")
    intercept: float = parameter(default=0.0, linear=True, gauge=0.0, unit="response")
    n_substeps: int = 8
    hold: str = "foh"

    def parameter_specs(self):
        specs = super().parameter_specs()
        return {name: spec for name, spec in specs.items() if np.isfinite(getattr(self, name))}

    def physical(self, mass=1.0):
        """Return the quantities of the equation of motion for a known mass.

        Those of :meth:`OscillatorOperator.physical`, ``stop_stiffness``, ``stop_damping``, and
        the responses at the stops, ``lower_stop`` and ``upper_stop``.
        """
        p = super().physical(mass)
        lower, upper = self._ends()
        return p | {
            "stop_stiffness": p["stiffness"] * self.stop_stiffness,
            "stop_damping": 2.0 * self.stop_damping * self.natural_frequency * p["mass"],
            "lower_stop": lower,
            "upper_stop": upper,
        }

    def characteristics(self, seen):
        lower, upper = (end if math.isfinite(end) else math.nan for end in self._ends())
        return {
            "stiffness of the stop over that of the spring": (self.stop_stiffness, ""),
            "lower stop": (lower, "response"),
            "upper stop": (upper, "response"),
        }

    def _ends(self):
        """Return the responses at the lower and the upper stop."""
        ends = [float(self.gain * level + self.intercept) for level in (self.lower, self.upper)]
        return ends if self.gain > 0.0 else ends[::-1]

    @property
    def presliding_displacement(self):
        """None: a stop has no friction."""
        return None

    def fastest_rate(self):
        return self.natural_frequency * math.sqrt(1.0 + self.stop_stiffness)

    def _parameters_under_feedback(self, s, shift):
        return {
            "stop_stiffness": self.stop_stiffness / s,
            "stop_damping": self.stop_damping / math.sqrt(s),
            "lower": s * self.lower + shift,
            "upper": s * self.upper + shift,
        }

    def _rest(self, u0):
        by, kappa = np.zeros((2, self.n_parameters - 1)), self.stop_stiffness
        overlap = kappa * max(self.lower - self.upper, 0.0)  # overlapping stops clamp the stage
        touched = {"lower": u0 < self.lower + overlap, "upper": u0 > self.upper - overlap}
        levels = [getattr(self, name) for name in touched if touched[name]]
        share = 1.0 / (1.0 + kappa * len(levels))
        q = share * (u0 + kappa * sum(levels))
        by[0, 0] = share
        by[0, 3] = share * sum(level - q for level in levels)
        for column, name in enumerate(list(self._sizes)[4:-2], start=5):
            by[0, column] = kappa * share * touched[name]
        return q, 0.0, by

    def _law(self, largest):
        parameters = self.stop_stiffness, self.stop_damping, self.lower, self.upper
        return tuple(map(float, (self.natural_frequency, *parameters)))


_PARTS = (0.2, 0.4, 0.6, 0.75, 0.9)  # starting stops, fractions of the response's half range


class EndStops(OscillatorModel):
    r"""Mass, spring and damper between end stops: a stage with impacts at the ends of its travel.

    .. math::

        m \ddot x + d \dot x + k x + F = b u, \qquad y = x + c

        F = k_s (x - x_s) + d_s \dot x \text{ beyond a stop at } x_s, \text{ else } 0

    The drive ``u`` is a force or a voltage, the response a displacement. The equation is divided by
    ``b``, since the response to a drive does not determine the mass; both stops have the same
    stiffness and damping.

    Parameters
    ----------
    sides : {"both", "lower", "upper"}, default="both"
        Ends of the response at which there is a stop.
    fit_stop_damping : bool, default=True
        Whether :math:`d_s` is fitted (0 otherwise).

    Attributes
    ----------
    operator_ : EndStopsOperator
        ``natural_frequency`` (rad/s), ``damping_ratio``, ``stop_stiffness`` (relative to the
        spring), ``stop_damping`` (a damping ratio), ``lower`` and ``upper`` (units of the drive),
        ``gain``, ``intercept``.

    See Also
    --------
    RestoringForce : A spring that hardens smoothly.
    skhyst.linear.SecondOrderMode : The stage without stops.

    Notes
    -----
    Starting values are found as for :class:`FrictionStage`. The damper of a stop pulls as well as
    pushes (Kelvin-Voigt contact).

    References
    ----------
    Shaw and Holmes, *Journal of Sound and Vibration*, 1983.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import EndStops, EndStopsOperator
    >>> time = np.arange(1500) * 0.01
    >>> drive = np.sin(0.7 * time) + 0.8 * np.sin(2.9 * time) + 0.3 * np.sin(11.0 * time)
    >>> plant = EndStopsOperator(20.0, 0.2, 30.0, upper=0.9, gain=3.0)
    >>> y, _ = plant.run(drive, 0.01)
    >>> model = EndStops("upper", fit_stop_damping=False, dt=0.01).fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.operator_.upper:.2f} {model.operator_.stop_stiffness:.0f}")
    0.90 30
    """

    operator_class = EndStopsOperator
    _parameter_constraints = {
        **OscillatorModel._parameter_constraints,
        "sides": [StrOptions({"both", "lower", "upper"})],
        "fit_stop_damping": ["boolean"],
    }

    def __init__(
        self,
        sides="both",
        *,
        fit_stop_damping=True,
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
        self.sides = sides
        self.fit_stop_damping = fit_stop_damping
        self.fit_intercept = fit_intercept
        self.mass = mass
        self.n_substeps = n_substeps
        self.hold = hold

    def _signs(self):
        return [
            sign for sign, side in ((-1.0, "lower"), (1.0, "upper")) if self.sides in (side, "both")
        ]

    def _laws(self, length, speed):
        return [[((1.0 - part) * length, part * length)] for part in _PARTS]

    def _forces(self, law, y, dt, length):
        depths = [sign * np.maximum(sign * y - law[1], 0.0) for sign in self._signs()]
        return np.sum(depths, axis=0)[:, None]

    def _own_parameters(self, law, gain, stiffness, level, swing):
        return {"stop_stiffness": stiffness}

    def _stage(self, law, mode, scales, factors=None, **level):
        stage = super()._stage(law, mode, scales, factors, **level)
        if stage is None:
            return None
        ends = [(scales[1] + s * law[1] - mode.intercept) / mode.gain for s in self._signs()]
        sides = ["upper" if sign * mode.gain > 0.0 else "lower" for sign in self._signs()]
        return dataclasses.replace(stage, **dict(zip(sides, ends, strict=True)))
