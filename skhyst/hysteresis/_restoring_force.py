r"""Mass with polynomial spring and damper and a bilinear hysteretic force.

In units of the drive, with ``p = q'/w``, the force in parallel with the linear spring and damper
is ``F = N(q, p) + z`` with odd polynomials without linear terms,

    N = sum_i c_i q (q/s)^(2i) + sum_i l_i p (p/s)^(2i),

and z follows ``k_s q``, limited to ``+-z_s``. Along the displacement D of a substep (see
``_oscillator``) the mean of z is known in closed form, and D is the root of a linear equation while
z is within its limit, of a quadratic one if it reaches it (:func:`slide`). N is taken at the start
for a first D, then as the mean of both ends.
"""

import math
from dataclasses import dataclass
from numbers import Integral

import numpy as np
from numpy.polynomial import Polynomial
from scipy.optimize import brentq

from .._jit import jit
from .._sklearn import Interval
from ..operators import as_signal, parameter
from ._oscillator import (
    FREE_D,
    FREE_P,
    OWN,
    PARAMETERS,
    SLOPE_B,
    F,
    OscillatorModel,
    OscillatorOperator,
    P,
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
from ._prandtl_ishlinskii import PrandtlIshlinskiiOperator


@jit
def odd_terms(x, coefficients, scale):
    """Return ``sum_i coefficients_i x (x/scale)^(2i)``, i = 1, 2, ..., and its slope."""
    square = (x / scale) * (x / scale)
    value, slope, power = 0.0, 0.0, 1.0
    for i in range(coefficients.size):
        power *= square
        value += coefficients[i] * power
        slope += (2 * i + 3) * coefficients[i] * power
    return value * x, slope


@jit
def slide(c, b, z, k, limit):
    """Solve ``D = c - b mean(z)``; return D, the mean of z, the new z, and a fraction of D.

    It is the fraction over which z changes before it slips, 1 if it does not slip.
    """
    delta = (c - b * z) / (1.0 + 0.5 * b * k)
    new = z + k * delta
    if abs(new) <= limit:
        return delta, z + 0.5 * k * delta, new, 1.0
    sign = 1.0 if delta > 0.0 else -1.0
    # x^2 - e x - b gap^2 / (2 k) = 0 with x = |D|, e = sign c - b limit
    gap = limit - sign * z
    excess = sign * c - b * limit
    lag = 0.5 * b * gap * gap / k
    root = math.sqrt(excess * excess + 4.0 * lag)
    # z slips only where excess > gap (1 / k - b / 2)
    x = 0.5 * (excess + root) if b * k <= 2.0 or excess > 0.0 else 2.0 * lag / (root - excess)
    part = gap / (k * x)
    return sign * x, sign * (limit - 0.5 * gap * part), sign * limit, part


@jit(inline=True)
def polynomials(q, p, scale, springs, dampers):
    """Return N(q, p)."""
    spring, _ = odd_terms(q, springs, scale)
    damper, _ = odd_terms(p, dampers, scale)
    return spring + damper


@jit(inline=True)
def restoring(mode, law, h, q, p, z, u0, u1):
    """Return q, p and z after a substep.

    ``law`` is (k_s, z_s, preload, s, bound, spring's coefficients, damper's). Beyond the bound,
    below overflow, the simulation has diverged and all following values are NaN.
    """
    k_s, limit, preload, scale, bound, springs, dampers = law
    b_z, bp_z, b, bp = mode[2], mode[3], mode[6], mode[7]
    free_d, free_p = oscillator(mode, q, p, preload + u0, preload + u1)
    force0 = polynomials(q, p, scale, springs, dampers)
    delta, mean, _, _ = slide(free_d - b * force0, b_z, z, k_s, limit)
    end = free_p - bp * force0 - bp_z * mean
    force = 0.5 * (force0 + polynomials(q + delta, end, scale, springs, dampers))
    delta, mean, z, _ = slide(free_d - b * force, b_z, z, k_s, limit)
    q += delta
    if not abs(q) <= bound:
        return math.nan, math.nan, math.nan
    return q, free_p - bp * force - bp_z * mean, z


@jit
def add_powers(x, scale, out, first, n):
    """Add ``x (x/scale)^(2i)``, i = 1, ..., n, to ``out`` from column ``first`` on."""
    square = (x / scale) * (x / scale)
    for i in range(first, first + n):
        x *= square
        out[i] += x


@jit
def slide_tangents(b, b_z, k, delta, mean, part, force, dforce, first, by):
    """Write the derivatives of D, of the mean of z and of the new z of :func:`slide` to ``by``.

    The polynomials' ``force``, whose derivatives are ``dforce``, acts by ``b``, which does not
    follow a load, and by whose entry of the last two columns the derivatives are, too. ``first`` is
    the column of k_s.
    """
    sign = 1.0 if delta > 0.0 else -1.0
    for j in range(by.shape[1]):
        by[1, j] = 0.0
    by[1, F] = part
    by[1, first] = 0.5 * part * part * delta
    by[1, first + 1] = sign * (1.0 - part)
    solve_tangents(b_z, 0.5 * k * part * part, mean, by)
    held = k if part == 1.0 else 0.0
    for j in range(by.shape[1]):
        by[2, j] = held * by[0, j]
    if part < 1.0:
        by[2, first + 1] = sign
    else:
        by[2, F] += 1.0
        by[2, first] += delta
    for i in range(3):
        pull = by[i, FREE_D]
        for j in range(by.shape[1]):
            by[i, j] -= pull * b * dforce[j]
        by[i, _B] -= pull * force


_B, _SLOPE_B = -2, -1  # columns of the derivatives by B and B' of the polynomials


@jit
def restoring_tangents(
    mode, mode_by, law, h, n_substeps, u, du, factor, dfactor, before, dbefore, q, p, z, d,
    out, dout,
):  # fmt: skip
    """Write q and its tangents.

    The parameters are w, zeta, the coefficients of spring and damper, k_s, z_s and the preload.
    """
    k_s, limit, preload, scale, bound, springs, dampers = law
    n_springs, n_dampers = springs.size, dampers.size
    own = OWN + 2 + n_springs + n_dampers  # column of k_s
    step = np.empty((3, PARAMETERS + own + 3 - OWN))
    by = np.empty((3, own + 5))
    dforce0, dforce = np.empty((2, own + 5))
    for k in range(u.size):
        u0 = before + preload
        first = begin_sample(d, du.shape[1], step)
        for i in range(n_substeps):
            start, stop = i / n_substeps, (i + 1) / n_substeps
            u1 = preload + before + (u[k] - before) * stop
            loaded = scaled(mode, mean_factor(factor[k], factor[k + 1], start, stop), q, p)
            b_z, bp_z, b, bp = loaded[2], loaded[3], loaded[6], loaded[7]
            free_d, free_p = oscillator(loaded, q, p, u0, u1)
            # with the force at the start
            from_q, by_q = odd_terms(q, springs, scale)
            from_p, by_p = odd_terms(p, dampers, scale)
            force0 = from_q + from_p
            for j in range(dforce0.size):
                dforce0[j] = 0.0
            dforce0[Q], dforce0[P] = by_q, by_p
            add_powers(q, scale, dforce0, OWN + 2, n_springs)
            add_powers(p, scale, dforce0, OWN + 2 + n_springs, n_dampers)
            delta, mean, _, part = slide(free_d - b * force0, b_z, z, k_s, limit)
            slide_tangents(b, b_z, k_s, delta, mean, part, force0, dforce0, own, by)
            # with the mean of both ends
            end = free_p - bp * force0 - bp_z * mean
            from_q, by_q = odd_terms(q + delta, springs, scale)
            from_p, by_p = odd_terms(end, dampers, scale)
            for j in range(dforce.size):
                dend = -bp * dforce0[j] - bp_z * by[1, j]
                dforce[j] = dforce0[j] + by_q * by[0, j] + by_p * dend
            dforce[Q] += by_q
            dforce[FREE_P] += by_p
            dforce[SLOPE_B] -= by_p * mean
            dforce[_SLOPE_B] -= by_p * force0
            add_powers(q + delta, scale, dforce, OWN + 2, n_springs)
            add_powers(end, scale, dforce, OWN + 2 + n_springs, n_dampers)
            for j in range(dforce.size):
                dforce[j] *= 0.5
            force = 0.5 * (force0 + (from_q + from_p))
            delta, mean, z, part = slide(free_d - b * force, b_z, z, k_s, limit)
            slide_tangents(b, b_z, k_s, delta, mean, part, force, dforce, own, by)
            pull_tangents(bp_z, mean, by)
            for j in range(dforce.size):
                by[1, j] += bp * dforce[j]
            by[1, _SLOPE_B] += force
            for i_state in range(3):
                for m in range(2):  # w and zeta act through the polynomials' B and B', too
                    change = by[i_state, _B] * mode_by[m, 2] + by[i_state, _SLOPE_B] * mode_by[m, 3]
                    by[i_state, OWN + m] += change
                # the preload is added to the drive
                by[i_state, own + 2] = by[i_state, FREE_D] * b + by[i_state, FREE_P] * bp
            by[1, own + 2] -= bp
            move_tangents(loaded, mode_by, by, q, p, u0, u1, start, stop, step, first)
            q += delta
            p = free_p - bp * force - bp_z * mean
            u0 = u1
        if not abs(q) <= bound:
            out[k:] = np.nan
            dout[k:] = np.nan
            return
        propagate(step, k, du, dfactor, dbefore, d, dout)
        before = u[k]
        out[k] = q


_POLISH = 3  # Newton steps after the bracketing root finder
_GROWTH, _BRACKETS = 1.5, 200  # factor from one bracket to the next, most brackets
_LARGEST = 1e12  # bound of the displacement relative to the drive; its squares do not overflow


@dataclass(frozen=True, eq=False)
class RestoringForceOperator(OscillatorOperator, loops=(*loops(restoring), restoring_tangents)):
    r"""Mass with polynomial spring and damper and a bilinear hysteretic force.

    The equations of :class:`RestoringForce` divided by ``b``: displacement ``q``, forces and
    :math:`p = \dot q / \omega` are in units of the drive. The centre of the polynomials is a static
    displacement ``x_0`` away from the rest position, caused by the preload.

    Parameters
    ----------
    natural_frequency : float
        :math:`\omega = \sqrt{\alpha_1/m}` in rad/s.
    damping_ratio : float
        :math:`\zeta = \lambda_1 / (2 \sqrt{\alpha_1 m})`.
    stiffness_coefficients : array-like of shape (n_stiffness,)
        Coefficients of the degrees 3, 5, ...: forces relative to the linear spring force at
        ``q = s``.
    damping_coefficients : array-like of shape (n_damping,)
        Coefficients of the degrees 3, 5, ...: forces relative to the linear spring force at
        ``p = q = s``.
    hysteresis_stiffness : float
        Stiffness of the hysteretic force relative to the spring, 0 without hysteretic force.
    slip_level : float
        Largest hysteretic force, units of the drive.
    preload : float, default=0.0
        Constant force, units of the drive. With linear spring and damper it cannot be
        distinguished from the intercept.
    intercept : float, default=0.0
        ``c``: response at the centre of the polynomials, units of the response.
    scale : float, default=1.0
        ``s`` in units of the drive, above 0. Fixed structure.

    Raises
    ------
    ValueError
        If ``scale`` is not above 0, or as for :class:`OscillatorOperator`.

    Notes
    -----
    State and substeps are those of :class:`OscillatorOperator`; at rest the preload has been
    applied without hysteretic force. With negative coefficients the spring loses its stiffness, or
    the damper supplies energy, at large amplitude, and a simulation may diverge.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import RestoringForceOperator
    >>> stage = RestoringForceOperator(50.0, 0.5, [0.1], [], 4.0, 0.2)
    >>> drive = np.interp(np.arange(4000) * 1e-2, [0.0, 20.0, 40.0], [0.0, 1.0, 0.0])
    >>> y, _ = stage.run(drive, 1e-2)
    >>> print(f"{y.max():.2f} {y[-1]:.2f}")
    0.76 0.20
    """

    natural_frequency: float = parameter(log=True, lower=0.0, unit="rad/s")
    damping_ratio: float = parameter(log=True, lower=0.0)
    stiffness_coefficients: np.ndarray = parameter()
    damping_coefficients: np.ndarray = parameter()
    hysteresis_stiffness: float = parameter(log=True, lower=0.0)
    slip_level: float = parameter(log=True, lower=0.0, unit="drive")
    preload: float = parameter(default=0.0, unit="drive")
    gain: float = parameter(default=1.0, linear=True, unit="response/drive")
    intercept: float = parameter(default=0.0, linear=True, gauge=0.0, unit="response")
    scale: float = 1.0
    n_substeps: int = 8
    hold: str = "foh"

    _force = ("slip_level", "hysteresis_stiffness")

    def __post_init__(self):
        super().__post_init__()
        self._require("scale", self.scale > 0.0, "be above 0")
        for name in ("stiffness_coefficients", "damping_coefficients"):
            object.__setattr__(self, name, np.array(getattr(self, name), dtype=float, ndmin=1))

    def physical(self, mass=1.0):
        """Return the quantities of the equation of motion for a known mass.

        As :meth:`OscillatorOperator.physical`: ``mass``, ``drive_gain``, ``alpha_1``, ``alpha_3``,
        ..., ``lambda_1``, ``lambda_3``, ..., ``alpha_s``, ``z_s``, ``x_s = z_s / alpha_s`` (NaN
        without hysteretic force) and ``preload`` (a force).
        """
        p, w = super().physical(mass), self.natural_frequency
        stiffness, drive_gain = p["stiffness"], p["drive_gain"]
        length = abs(self.gain) * self.scale
        quantities = {"mass": p["mass"], "drive_gain": drive_gain, "alpha_1": stiffness}
        for i, value in enumerate(self.stiffness_coefficients.tolist(), 1):
            quantities[f"alpha_{2 * i + 1}"] = stiffness * value / length ** (2 * i)
        quantities["lambda_1"] = p["damping"]
        for i, value in enumerate(self.damping_coefficients.tolist(), 1):
            quantities[f"lambda_{2 * i + 1}"] = stiffness / w * value / (w * length) ** (2 * i)
        displacement = self.presliding_displacement
        return quantities | {
            "alpha_s": stiffness * self.hysteresis_stiffness,
            "z_s": abs(drive_gain) * self.slip_level,
            "x_s": math.nan if displacement is None else displacement,
            "preload": drive_gain * self.preload,
        }

    def characteristics(self, seen):
        return self._swing(seen) | self._force_characteristics(self.slip_level)

    def _swing(self, seen):
        """Return the effects of the spring's nonlinearity at the largest amplitude."""
        frequency, c = self.natural_frequency / (2.0 * np.pi), self.stiffness_coefficients
        if not np.any(c):
            return {"resonance at small amplitude": (frequency, "Hz")}
        half = max(np.abs(y - self.intercept).max() for y in seen.outputs)
        # force over the linear force at full amplitude, a polynomial in the cosine of the phase:
        # its Chebyshev coefficients are the harmonics
        force, degrees = np.zeros(2 * c.size + 2), 2 * np.arange(1, c.size + 1)
        force[1] = 1.0
        force[degrees + 1] = c * (half / abs(self.gain * self.scale)) ** degrees
        _, first, _, third, *_ = np.polynomial.chebyshev.poly2cheb(force)
        excess, resonance = force.sum() - 1.0, frequency * np.sqrt(max(first, 0.0))
        return {
            "nonlinear over linear spring force at full amplitude": (100.0 * excess, "%"),
            "full amplitude": (half, "response"),
            "resonance at small amplitude": (frequency, "Hz"),
            "resonance at full amplitude": (resonance, "Hz"),
            "third harmonic of the force": (100.0 * abs(third / first), "%"),
        }

    def _parameters_under_feedback(self, s, shift):
        springs = np.arange(1, self.stiffness_coefficients.size + 1)
        dampers = np.arange(1, self.damping_coefficients.size + 1)
        return {
            "stiffness_coefficients": self.stiffness_coefficients / s ** (2 * springs + 1),
            "damping_coefficients": self.damping_coefficients / s ** (dampers + 0.5),
            "hysteresis_stiffness": self.hysteresis_stiffness / s,
            "preload": self.preload - shift,  # q keeps its origin
            "intercept": self.intercept,
        }

    def _spring(self, q):
        """Return the spring's force and its slope."""
        force, slope = odd_terms(q, as_signal(self.stiffness_coefficients), float(self.scale))
        return q + force, 1.0 + slope

    def _by_coefficients(self, q):
        """Return the derivatives of the spring's force by the coefficients."""
        return q * (q / self.scale) ** (2 * np.arange(1, self.stiffness_coefficients.size + 1))

    def _hysteresis(self, displacement):
        """Return the hysteretic force after a first loading by ``displacement``, and its slope."""
        force = self.hysteresis_stiffness * displacement
        if abs(force) < self.slip_level:
            return float(force), float(self.hysteresis_stiffness)
        return math.copysign(self.slip_level, displacement), 0.0

    def _rest(self, u0):
        n = self.stiffness_coefficients.size
        first = 1 + 2 + n + self.damping_coefficients.size
        by = np.zeros((2, first + 3))
        # the preload alone, without hysteretic force
        center = _equilibrium(self._spring, 0.0, float(self.preload))
        _, slope = self._spring(center)
        center_by = np.zeros(first + 3)
        center_by[3 : 3 + n] = -self._by_coefficients(center) / slope
        center_by[first + 2] = 1.0 / slope

        def both(q):
            force, slope = self._spring(q)
            hysteretic, steeper = self._hysteresis(q - center)
            return force + hysteretic, slope + steeper

        q = _equilibrium(both, center, u0 + float(self.preload)) if u0 else center
        _, slope = self._spring(q)
        z, steeper = self._hysteresis(q - center)
        # derivatives of z at constant q
        if abs(z) < self.slip_level:
            by[1] -= steeper * center_by
            by[1, first] += q - center
        else:
            by[1, first + 1] += math.copysign(1.0, q - center)
        by[0] -= by[1]
        by[0, 0] += 1.0
        by[0, 3 : 3 + n] -= self._by_coefficients(q)
        by[0, first + 2] += 1.0
        by[0] /= slope + steeper
        by[1] += steeper * by[0]
        return q, z, by

    def _law(self, largest):
        parameters = self.hysteresis_stiffness, self.slip_level, self.preload, self.scale
        bound = _LARGEST * (self.scale + largest)
        coefficients = self.stiffness_coefficients, self.damping_coefficients
        return (*map(float, (*parameters, bound)), *map(as_signal, coefficients))


def _equilibrium(force, start, target):
    """Return the first q from ``start`` on at which ``force(q)[0]`` is ``target``.

    If there is none, return ``target``, the q of the linear spring.
    """
    side = target - force(start)[0]
    if side == 0.0:
        return start
    near, step = start, 0.25 * side
    for _ in range(_BRACKETS):
        far = near + step
        if np.sign(target - force(far)[0]) != np.sign(side):
            break
        near, step = far, _GROWTH * step
    else:
        return target
    # Brent's method needs at most the square of the number of steps of a bisection
    q = brentq(lambda q: force(q)[0] - target, near, far, maxiter=_BRACKETS**2)
    for _ in range(_POLISH):
        value, slope = force(q)
        if slope > 0.0:
            q += (target - value) / slope
    return float(q)


# starting displacements at which the hysteretic force slips, fractions of the response's half range
_DISPLACEMENTS = (0.003, 0.01, 0.03, 0.08, 0.2, 0.5)


class RestoringForce(OscillatorModel):
    r"""Mass with polynomial spring and damper and a bilinear hysteretic force.

    .. math::

        m \ddot x + \sum_{i\,\mathrm{odd}} \alpha_i (x + x_0)^i
        + \sum_{i\,\mathrm{odd}} \lambda_i \dot x^i + z = b u + F_0

        \dot z = \alpha_s \dot x \text{ while } |z| < z_s \text{ or } z \dot x < 0,
        \text{ else } 0

    The drive ``u`` is a force or a voltage, the response a displacement. The equation is divided by
    ``b``, since the response to a drive does not determine the mass; forces are then in units of
    the drive. ``x + x_0 = y - c``: the preload ``F_0`` causes a static displacement ``x_0`` of the
    rest position from the centre of the polynomials.

    Parameters
    ----------
    stiffness_degree : int, default=5
        Degree of the spring's polynomial; an even degree is replaced by the next lower one.
    damping_degree : int, default=5
        Degree of the damper's polynomial; an even degree is replaced by the next lower one.
    fit_hysteresis : bool, default=True
        Whether there is a hysteretic force. Without one the model with a cubic spring is a Duffing
        oscillator.
    fit_preload : bool, default=True
        Whether a preload is fitted (0 otherwise), which gives the spring even terms about the rest
        position. With a linear spring it cannot be distinguished from the intercept and is held.

    Attributes
    ----------
    operator_ : RestoringForceOperator
        ``natural_frequency`` (rad/s), ``damping_ratio``, ``stiffness_coefficients`` and
        ``damping_coefficients`` (relative to the linear spring force at ``scale``, half the largest
        peak-to-peak drive), ``hysteresis_stiffness`` (relative to the spring), ``slip_level`` and
        ``preload`` (units of the drive), ``gain``, ``intercept``.

    See Also
    --------
    BoucWenStage : A hysteretic force with a smooth transition.
    EndStops : Stops at the ends of the travel.
    skhyst.linear.SecondOrderMode : Linear spring and damper.

    Notes
    -----
    Starting values are found as for :class:`FrictionStage`. If the spring is almost linear, the
    preload and the spring's coefficients are hardly distinguishable, and their standard errors,
    which are those of a linearised model, are too small.

    Equation (7) as printed, ``z' = (alpha_s / 2) (1 + sgn(z_s - |z|)) x'``, stays at its limit:
    the bracket is zero there in both directions. Meant is an elastic, ideally plastic element (a
    stop operator), which is elastic again as soon as the motion reverses. Equation (6) prints
    ``lambda_9 x'^9``; the text announces six coefficients, so ``lambda_5 x'^5`` is meant.

    References
    ----------
    O. Amor, A. Kaddouri, R. Abdessemed, "NARMAX approach for micro positioning stage piezoelectric
    actuator hysteresis identification", (6) to (8).

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import RestoringForce, RestoringForceOperator
    >>> time = np.arange(1500) * 0.01
    >>> drive = np.sin(0.7 * time) + 0.8 * np.sin(2.9 * time) + 0.3 * np.sin(11.0 * time)
    >>> plant = RestoringForceOperator(20.0, 0.5, [], [], 5.0, 0.3, gain=3.0)
    >>> y, _ = plant.run(drive, 0.01)
    >>> model = RestoringForce(1, damping_degree=1, dt=0.01).fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.operator_.slip_level:.2f} {model.operator_.hysteresis_stiffness:.1f}")
    0.30 5.0
    """

    operator_class = RestoringForceOperator
    _parameter_constraints = {
        **OscillatorModel._parameter_constraints,
        "stiffness_degree": [Interval(Integral, 1, None, closed="left")],
        "damping_degree": [Interval(Integral, 1, None, closed="left")],
        "fit_hysteresis": ["boolean"],
        "fit_preload": ["boolean"],
    }

    def __init__(
        self,
        stiffness_degree=5,
        *,
        damping_degree=5,
        fit_hysteresis=True,
        fit_preload=True,
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
        self.stiffness_degree = stiffness_degree
        self.damping_degree = damping_degree
        self.fit_hysteresis = fit_hysteresis
        self.fit_preload = fit_preload
        self.fit_intercept = fit_intercept
        self.mass = mass
        self.n_substeps = n_substeps
        self.hold = hold

    def _laws(self, length, speed):
        laws = [part * length for part in _DISPLACEMENTS] if self.fit_hysteresis else [speed]
        return [[(law,)] for law in laws]

    def _forces(self, law, y, dt, length):
        if self.fit_hysteresis:
            play, _ = PrandtlIshlinskiiOperator(law, [1.0]).run(y, dt)
            return (y - play)[:, None]
        v = np.gradient(y, dt)
        springs = [y * (y / length) ** (degree - 1) for degree in self._spring_degrees()]
        dampers = [v * (v / law[0]) ** (degree - 1) for degree in _odd(self.damping_degree)]
        return np.array([*springs, *dampers]).reshape(-1, len(y)).T

    def _spring_degrees(self):
        """Return the degrees above 1 of the spring's polynomial about the response's middle."""
        if "preload" in self.held_parameters() or not self.fit_intercept:
            return _odd(self.stiffness_degree)
        return list(range(2, _odd(self.stiffness_degree)[-1] + 1))

    def _own_parameters(self, law, gain, stiffness, level, swing):
        return {
            "stiffness_coefficients": np.zeros(len(_odd(self.stiffness_degree))),
            "damping_coefficients": np.zeros(len(_odd(self.damping_degree))),
            "hysteresis_stiffness": stiffness,
            "slip_level": level,
            "scale": swing,
        }

    def _stage(self, law, mode, scales, factors=None, **level):
        """Return an operator with hysteresis, or with a spring odd about its inflection point.

        Without hysteresis ``law`` is the speed by which the damper's coefficients are scaled.
        """
        if self.fit_hysteresis:
            return super()._stage(law, mode, scales, factors, **level)
        gain, (speed,), (length, middle, swing) = mode.gain, law, scales
        odd, center, preload, intercept = _odd(self.stiffness_degree), 0.0, 0.0, mode.intercept
        stiffness = 1.0 / gain
        spring, dampers = np.zeros(len(odd)), np.zeros(len(_odd(self.damping_degree)))
        if factors is not None:
            degrees = np.array(self._spring_degrees(), dtype=int)
            curve = np.zeros(2 if not odd else odd[-1] + 1)
            curve[1] = stiffness
            curve[degrees] = factors[: len(degrees)] / length ** (degrees - 1.0)
            curve = Polynomial(curve)
            if len(degrees) > len(odd):
                roots = curve.deriv(2).roots()
                roots = roots[(np.abs(roots.imag) < 1e-9 * length)].real
                roots = roots[(np.abs(roots) < length) & (curve.deriv()(roots) * gain > 0.0)]
                center = float(roots[np.argmin(np.abs(roots))]) if len(roots) else 0.0
                # the constant of the force balance, which is part of the intercept of the linear
                # part
                preload = (intercept - middle) * stiffness - float(curve(center))
                intercept = middle + center
            taylor = [curve.deriv(k)(center) / math.factorial(k) for k in (1, *odd)]
            stiffness, *spring = map(float, taylor)
            dampers = factors[len(degrees) :] / speed ** (np.array(_odd(self.damping_degree)) - 1.0)
        stiffening = stiffness * gain
        frequency = mode.natural_frequency * math.sqrt(stiffening)
        powers = np.array(odd, dtype=float), np.array(_odd(self.damping_degree), dtype=float)
        size = swing ** (powers[0] - 1.0), swing ** (powers[1] - 1.0)
        return RestoringForceOperator(
            frequency,
            mode.damping_ratio / math.sqrt(stiffening),
            np.array(spring) * size[0] / stiffness ** powers[0],
            dampers * size[1] / (stiffness / frequency) ** powers[1],
            0.0,
            0.0,
            preload,
            1.0 / stiffness,
            intercept,
            scale=swing,
            hold=self.hold,
        )

    def held_parameters(self) -> frozenset[str]:
        fixed = super().held_parameters() - {"hysteresis"}
        if not self.fit_hysteresis:
            fixed |= {"hysteresis_stiffness", "slip_level"}
        # the preload of a linear spring is equivalent to an intercept
        held = self.stiffness_degree < 3 and self.fit_intercept
        return fixed | {"preload"} if held else fixed


def _odd(degree):
    """Return the odd degrees from 3 to ``degree``."""
    return list(range(3, degree + 1, 2))
