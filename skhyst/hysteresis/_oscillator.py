r"""Stages with hysteresis in the equation of motion: a linear oscillator under any other force.

With the displacement q in units of the drive, the velocity ``p = q'/w`` and a force F that depends
on both and on a hysteretic force f,

    q''/w^2 + 2 zeta q'/w + q + F = u.

Over a substep h the drive is a straight line and F is replaced by its mean, for which the linear
oscillator is solved exactly:

    D = q1 - q0 = A p0 + B (u0 - q0 - F) + R (u1 - u0),
    p1 = A' p0 + B' (u0 - q0 - F) + R' (u1 - u0).

F is the mean along the straight line from q0 to q1, on which f is known in closed form, so D is the
root of a scalar equation that is solved to rounding: this is the averaged vector field method in
exponential form (Quispel and McLaren, *Journal of Physics A*, 2008). It is of second order, exact
for F = 0, and it keeps the energy balance: the work ``F D`` done on the hysteresis equals what f
stores and dissipates, at any substep.

The derivatives by the parameters are moved over every substep (:func:`move_tangents`). Tangents of
the input may be many: for them the Jacobian of a sample, which maps the state (q, p, f) and the
drive before and now to the next state, is accumulated over the substeps in the same way and applied
once per sample (:func:`propagate`); without such tangents it is not computed.
A law gives the derivatives of D, of ``B' F`` and of the new f by the quantities of the oscillator
that enter it (``FREE_D``: D without F, ``FREE_P``: p1 without F, then q, p, f, B and B'), and by
the parameters themselves.

A factor of the force, such as that of a load, is a straight line between samples and held at its
mean over a substep. If the force depends on the displacement by a factor ``1 + c (q - q_f)``, not
below zero, that is held at its value half a substep ahead of the start. Both are of second order.
The hysteretic force enters only as ``B F`` and ``B' F``, so a law under a factor is the same law
with B and B' multiplied by the factor (:func:`scaled`).
"""

import dataclasses
import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, lru_cache, partial
from numbers import Integral, Real

import numpy as np

from .._jit import bind, jit
from .._sklearn import Interval, StrOptions
from ..base import ParametricModel, refine
from ..linear import SecondOrderMode, SecondOrderModeOperator
from ..operators import CompiledLaw, HeldInput, ScaledWithin, WindowInverseOperator, as_signal
from ..optimize import VariableProjection

# columns of a law's derivatives; its own parameters begin at OWN
FREE_D, FREE_P, Q, P, F, B, SLOPE_B, OWN = range(8)
# columns of a sample's Jacobian, after those of the state: drive before and at the sample, factor
# of the force before and at it; then the tangents by the parameters
_DRIVES, _FACTORS, PARAMETERS = 3, 5, 7
_SERIES = 0.1  # below it the quotients cancel and the series converges fast
_LONGEST = 1 << 16  # samples of a simulation up to which its tangents are kept: 4 MB
_C3, _C4, _C5, _C6, _C7, _C8, _C9, _C10 = (1.0 / math.factorial(k) for k in range(3, 11))


@jit
def decay(a):
    """Return ``1 - exp(-a)``, ``phi = (1 - exp(-a)) / a``, psi and chi.

    ``psi = (1 - phi) / a`` and ``chi = (1/2 - psi) / a``.
    """
    if abs(a) < _SERIES:
        # sum of (-a)^k / (k + 3)!
        chi = _C3 - a * (_C4 - a * (_C5 - a * (_C6 - a * (_C7 - a * (_C8 - a * (_C9 - a * _C10))))))
        psi = 0.5 - a * chi
        phi = 1.0 - a * psi
        return a * phi, phi, psi, chi
    decayed, inverse = 1.0 - math.exp(-a), 1.0 / a
    phi = decayed * inverse
    psi = (1.0 - phi) * inverse
    return decayed, phi, psi, (0.5 - psi) * inverse


@jit
def gradient_factor(x, gradient, place):
    """Return the factor ``1 + gradient (x - place)`` of a force, not below zero, and its slope."""
    factor = 1.0 + gradient * (x - place)
    if factor > 0.0:
        return factor, gradient
    return 0.0, 0.0


@jit
def scaled(mode, factor, q, p):
    """Return the constants of a substep from the state q, p, under a factor of the force.

    ``mode`` is (A, A', B, B', R, R', gradient c and centre q_f of the force, w h / 2). The result
    is (A, A', B and B' of the force, R, R', B and B' of the drive, the complete factor, the part of
    it that depends on the displacement, the derivatives of the complete factor by q and by c,
    w h / 2).
    """
    b, bp = mode[2], mode[3]
    distance = q + mode[8] * p - mode[7]
    local, slope = gradient_factor(distance, mode[6], 0.0)
    by_gradient = factor * distance if local > 0.0 else 0.0
    total = factor * local
    return (
        mode[0], mode[1], total * b, total * bp, mode[4], mode[5], b, bp, total, local,
        factor * slope, by_gradient, mode[8],
    )  # fmt: skip


@jit
def mean_factor(loaded, load, start, stop):
    """Return the mean over a part of the interval in which a factor goes along a straight line."""
    return loaded + (load - loaded) * (0.5 * (start + stop))


@jit
def oscillator(mode, q, p, u0, u1):
    """Return D and p1 without a force F; ``mode`` is that of :func:`scaled`."""
    pull, slope = u0 - q, u1 - u0
    return (
        mode[0] * p + mode[6] * pull + mode[4] * slope,
        mode[1] * p + mode[7] * pull + mode[5] * slope,
    )


def step(mode, law, h, q, p, f, u0, u1):
    """Template of a law's substep h under a drive from u0 to u1; it returns the new q, p and f."""
    raise NotImplementedError


def sample(mode, law, h, n_substeps, before, u, loaded, load, q, p, f):
    """Return q, p and f after an interval in which the drive goes from ``before`` to ``u``.

    The factor of the force goes from ``loaded`` to ``load``.
    """
    u0 = before
    for i in range(n_substeps):
        start, stop = i / n_substeps, (i + 1) / n_substeps
        u1 = before + (u - before) * stop
        loaded_mode = scaled(mode, mean_factor(loaded, load, start, stop), q, p)
        q, p, f = step(loaded_mode, law, h, q, p, f, u0, u1)
        u0 = u1
    return q, p, f


def run(mode, law, h, n_substeps, u, factor, before, q, p, f, out):
    """Write q to ``out`` (n,) and return the last q, p and f; ``step`` is :func:`sample` here.

    ``factor`` (n + 1,) is that of the force, from before the first sample.
    """
    for k in range(u.size):
        q, p, f = step(mode, law, h, n_substeps, before, u[k], factor[k], factor[k + 1], q, p, f)
        before = u[k]
        out[k] = q
    return q, p, f


def compiled_step(u, c, s):
    """Return the response; ``c`` is (mode, h, number of substeps, gain, intercept, *law).

    ``s`` is (q, p, f, last drive, whether there was one); ``step`` is :func:`sample` here.
    """
    q, p, f = s[0], s[1], s[2]
    if s[4] > 0.0:
        q, p, f = step(c[0], c[5:], c[1], int(c[2]), s[3], u, 1.0, 1.0, q, p, f)
    s[0], s[1], s[2], s[3], s[4] = q, p, f, u, 1.0
    return c[3] * q + c[4]


def loaded_step(u, c, s):
    """Do :func:`compiled_step` for a drive and a factor of the force, the last state."""
    q, p, f = s[0], s[1], s[2]
    if s[4] > 0.0:
        q, p, f = step(c[0], c[5:], c[1], int(c[2]), s[3], u[0], s[5], u[1], q, p, f)
    s[0], s[1], s[2], s[3], s[4], s[5] = q, p, f, u[0], 1.0, u[1]
    return c[3] * q + c[4]


def loops(substep):
    """Return the run and the compiled steps of a law, given its substep (see :func:`step`)."""
    interval = bind(sample, substep, inline=True)
    return tuple(bind(loop, interval) for loop in (run, compiled_step, loaded_step))


@jit
def solve_tangents(b, slope, force, by):
    """Write the derivatives of the D that solves ``D = free_d - b F`` to ``by[0]``.

    ``by[1]`` holds the derivatives of F at constant D and is replaced by its total derivatives;
    ``slope`` is dF/dD.
    """
    inverse = 1.0 / (1.0 + b * slope)
    for j in range(by.shape[1]):
        change = inverse * by[1, j]
        by[0, j] = -b * change
        by[1, j] = change
    by[0, FREE_D] += inverse
    by[1, FREE_D] += slope * inverse
    by[0, B] -= inverse * force
    by[1, B] -= slope * inverse * force


@jit
def by_state(mode, by):
    """Return the derivatives by q, p and f, at constant drive, of the quantity of a row ``by``.

    They include those through D and p1 without F.
    """
    free_d, free_p = by[FREE_D], by[FREE_P]
    return (
        by[Q] - mode[6] * free_d - mode[7] * free_p,
        by[P] + mode[0] * free_d + mode[1] * free_p,
        by[F],
    )


@jit
def pull_tangents(slope_b, force, by):
    """Replace the derivatives of the mean F, ``force``, in ``by[1]`` by those of ``B' F``."""
    for j in range(by.shape[1]):
        by[1, j] *= slope_b
    by[1, SLOPE_B] += force


@jit
def begin_sample(d, n_inputs, step):
    """Set ``step`` before the first substep; return the first of its columns that is in use.

    The Jacobian of the sample is the identity, and used if there are tangents of the input; the
    tangents by the parameters are those of ``d``.
    """
    for i in range(3):
        for j in range(PARAMETERS):
            step[i, j] = 1.0 if i == j else 0.0
        for j in range(n_inputs, d.shape[1]):
            step[i, PARAMETERS + j - n_inputs] = d[i, j]
    return 0 if n_inputs else PARAMETERS


@jit(inline=True)
def add_tangent(by, free_d, free_p, db, dbp, step, j):
    """Add to column j of ``step`` the change by something that a substep depends on.

    ``free_d``, ``free_p``, ``db`` and ``dbp`` are the derivatives by it of D and p1 without F, and
    of B and B' of the force.
    """
    for k in range(3):
        value = by[k, FREE_D] * free_d + by[k, FREE_P] * free_p
        value += by[k, B] * db + by[k, SLOPE_B] * dbp
        step[k, j] += free_p - value if k == 1 else value


@jit
def move_tangents(mode, mode_by, by, q, p, u0, u1, start, stop, step, first):
    """Move the columns of ``step`` (3, 7 + n) from ``first`` on over a substep that begins at q, p.

    ``by`` (3, 7 + n) are the derivatives of D, of ``B' F`` (see :func:`pull_tangents`) and of the
    new f by ``FREE_D``, ... and by the n parameters; it may have further columns. B and B' are
    those of the force. ``mode`` is that of :func:`scaled`, ``mode_by`` (2, 9) are the derivatives
    of the ``mode`` given to it by the first two parameters. The substep lasts from ``start`` to
    ``stop``, fractions of the sampling interval.
    """
    # new q, p and f by the old ones: q1 = q + D, p1 = its value without F, less B' F
    a, b, c = by_state(mode, by[0])
    e, f, g = by_state(mode, by[1])
    x, y, z = by_state(mode, by[2])
    a, e, f, g = 1.0 + a, -mode[7] - e, mode[1] - f, -g
    # by the factor of the force, which depends on q and p along the way
    d_by = by[0, B] * mode[6] + by[0, SLOPE_B] * mode[7]
    p_by = -(by[1, B] * mode[6] + by[1, SLOPE_B] * mode[7])
    f_by = by[2, B] * mode[6] + by[2, SLOPE_B] * mode[7]
    by_q, by_p = mode[10], mode[10] * mode[12]
    a, e, x = a + by_q * d_by, e + by_q * p_by, x + by_q * f_by
    b, f, y = b + by_p * d_by, f + by_p * p_by, y + by_p * f_by
    for j in range(first, step.shape[1]):
        dq, dp, df = step[0, j], step[1, j], step[2, j]
        step[0, j] = a * dq + b * dp + c * df
        step[1, j] = e * dq + f * dp + g * df
        step[2, j] = x * dq + y * dp + z * df
    pull, slope = u0 - q, u1 - u0
    if first < PARAMETERS:  # drive and factor before and at the sample
        middle = 0.5 * (start + stop)
        for i in range(2):
            fraction, length = (start, stop - start) if i else (1.0 - start, start - stop)
            free_d = mode[6] * fraction + mode[4] * length
            free_p = mode[7] * fraction + mode[5] * length
            add_tangent(by, free_d, free_p, 0.0, 0.0, step, _DRIVES + i)
            moved = (middle if i else 1.0 - middle) * mode[9]
            add_tangent(by, 0.0, 0.0, moved * mode[6], moved * mode[7], step, _FACTORS + i)
    for i in range(2):
        m = mode_by[i]
        free_d = m[0] * p + m[2] * pull + m[4] * slope
        free_p = m[1] * p + m[3] * pull + m[5] * slope
        moved = mode[10] * m[8] * p
        db, dbp = mode[8] * m[2] + moved * mode[6], mode[8] * m[3] + moved * mode[7]
        add_tangent(by, free_d, free_p, db, dbp, step, PARAMETERS + i)
    for j in range(step.shape[1] - PARAMETERS):
        step[0, PARAMETERS + j] += by[0, OWN + j]
        step[1, PARAMETERS + j] -= by[1, OWN + j]
        step[2, PARAMETERS + j] += by[2, OWN + j]


@jit
def propagate(step, k, du, dfactor, dbefore, d, dout):
    """Move the tangents ``d`` (3, m + n) over sample k and write those of q to ``dout[k]``.

    The first m are tangents of the input: ``du`` (n_samples, m) are those of the drive, ``dbefore``
    (m,) those before the first sample, and ``dfactor`` (n_samples + 1, m) those of the factor of
    the force, from before it. The others are derivatives by parameters, which ``step`` (3, 7 + n)
    has moved already.
    """
    m = du.shape[1]
    for j in range(m):
        a, b, c = d[0, j], d[1, j], d[2, j]
        old = du[k - 1, j] if k else dbefore[j]
        for i in range(3):
            value = step[i, 0] * a + step[i, 1] * b + step[i, 2] * c
            value += step[i, _DRIVES] * old + step[i, _DRIVES + 1] * du[k, j]
            value += step[i, _FACTORS] * dfactor[k, j] + step[i, _FACTORS + 1] * dfactor[k + 1, j]
            d[i, j] = value
        dout[k, j] = d[0, j]
    for j in range(m, d.shape[1]):
        for i in range(3):
            d[i, j] = step[i, PARAMETERS + j - m]
        dout[k, j] = d[0, j]


class OscillatorOperator(HeldInput, ScaledWithin):
    r"""Mass, spring and damper with a hysteretic force; ``y = gain q + intercept``.

    The state is the tuple (q, q'/w, hysteretic force, last drive, whether there was one), all in
    units of the drive; in ``"rest"`` the stage has been loaded slowly from zero. Each substep
    solves the oscillator exactly under the mean of the other forces: second order, exact without
    them, and passive if the law is. Substeps should resolve the motion before sliding: with
    ``dt fastest_rate() / n_substeps = 0.1`` about three digits are exact.

    A subclass passes its loops, ``class MyOperator(OscillatorOperator, loops=(run, compiled_step,
    loaded_step, tangents))``, and defines the state at rest and the constants of the law. Its first
    two parameters are the first two here, its last two ``gain`` and ``intercept``.

    Parameters
    ----------
    natural_frequency : float
        :math:`\omega = \sqrt{k/m}` in rad/s.
    damping_ratio : float
        :math:`\zeta = d / (2 \sqrt{k m})`.
    gain : float, default=1.0
        ``G``: response to a drive at rest without other forces, response/drive.
    intercept : float, default=0.0
        ``c`` in units of the response.
    n_substeps : int, default=8
        Integration steps per sampling interval, above 0. Fixed structure.
    hold : {"foh", "bandlimited"}, default="foh"
        Drive between samples: a straight line, or without content above half the sampling rate.
        Fixed structure.

    Raises
    ------
    ValueError
        If ``n_substeps`` is not an integer above 0, or ``hold`` none of these.

    Examples
    --------
    See :class:`FrictionStageOperator`.
    """

    holds = ("foh", "bandlimited")
    strictly_proper = True
    owns_gain = True
    at_once = False
    stage_order = 10
    _force = ("level", "hysteresis_stiffness")  # limit of the hysteretic force, its initial slope
    _force_gradient = (0.0, 0.0)  # c and q_f of a force that depends on the displacement

    def __init_subclass__(cls, loops, **options):
        super().__init_subclass__(**options)
        cls._loop, *steps, cls._tangent_loop = map(staticmethod, loops)
        cls._compiled_step, cls._loaded_step = steps

    def __post_init__(self):
        super().__post_init__()
        self._require("n_substeps", self.n_substeps > 0, "be above 0")

    @abstractmethod
    def _rest(self, u0):
        """Return q and the hysteretic force at rest, and their derivatives (2, 1 + n_own).

        The derivatives are by ``u0`` and by all parameters but the last two.
        """

    @abstractmethod
    def _law(self, u):
        """Return the constants that the loops take as ``law``, for a drive of at most ``u``.

        A loop of tangents, ``(mode, mode_by, law, h, n_substeps, u, du, factor, dfactor, before,
        dbefore, q, p, f, d, out, dout)``, writes q (n,) and its tangents (n, m + n_own). The
        columns are those of ``du`` (n, m), then the derivatives by all parameters but the last two.
        ``factor`` (n + 1,) and ``dfactor`` (n + 1, m) are those of the force from before the first
        sample, ``dbefore`` (m,) and ``d`` (3, m + n_own) the tangents of the drive and of the state
        there.
        """

    @abstractmethod
    def physical(self, mass=1.0):
        """Return the quantities of the equation of motion for a known mass.

        Displacements are in units of the response; with the mass in kg and the response in m, all
        are in SI units.

        Parameters
        ----------
        mass : float, default=1.0
            Unit of your choice, such as kg.

        Returns
        -------
        dict of str to float
            ``mass``, ``damping``, ``stiffness``, ``drive_gain`` (force over drive), and those of
            the hysteretic force by their symbols in the equation of motion.
        """
        w = self.natural_frequency
        stiffness = mass * w**2
        return {
            "mass": float(mass),
            "damping": 2.0 * self.damping_ratio * w * mass,
            "stiffness": stiffness,
            "drive_gain": stiffness * self.gain,
        }

    @abstractmethod
    def _parameters_under_feedback(self, s, shift):
        """Return the subclass's own parameters under a feedback that divides the gain by ``s``.

        ``shift`` is the drive that the feedback adds at ``q = 0``, units of the drive.
        """

    def linear_mode(self):
        return SecondOrderModeOperator(
            float(self.natural_frequency), float(self.damping_ratio), self.gain, self.intercept
        )

    def n_ringing(self):
        return self.linear_mode().n_ringing()

    @property
    def presliding_displacement(self):
        """Displacement over which the hysteretic force builds up, units of the response."""
        level, stiffness = (getattr(self, name) for name in self._force)
        return float(abs(self.gain) * level / stiffness) if stiffness else None

    def fastest_rate(self):
        """Return the natural frequency of small motions, before sliding, rad/s."""
        stiffness = getattr(self, self._force[1])
        return float(self.natural_frequency * math.sqrt(1.0 + stiffness))

    def with_feedback(self, feedback, origin=0.0):
        """Return the operator that maps ``u + feedback (y - origin)`` to the y of this one for u.

        Parameters
        ----------
        feedback : float
            In drive/response; ``feedback gain > -1``.
        origin : float, default=0.0
            Units of the response.

        Returns
        -------
        OscillatorOperator
            Of the same class.
        """
        s = 1.0 + feedback * self.gain
        both = {
            "natural_frequency": self.natural_frequency * math.sqrt(s),
            "damping_ratio": self.damping_ratio / math.sqrt(s),
            "gain": self.gain / s,
            "intercept": origin + (self.intercept - origin) / s,
        }
        parameters = self._parameters_under_feedback(s, feedback * (self.intercept - origin))
        return dataclasses.replace(self, **(both | parameters))

    def inverse(self):
        """Return the operator from the response to the drive; it needs preview of the response."""
        return WindowInverseOperator(self)

    @cached_property
    def _mode(self):
        return self.linear_mode()  # kept, since it caches its discrete forms

    def _substep(self, dt):
        """Return the mode (9,) of :func:`scaled` for a substep, and its length in s."""
        h = float(dt) / self.n_substeps
        ad, b0, b1, _, _ = self._mode.discrete(h)
        ahead = 0.5 * h * self._mode.natural_frequency
        return np.array([ad[0, 1], ad[1, 1], *(b0 + b1), *b1, *self._force_gradient, ahead]), h

    def _substep_tangents(self, h):
        """Return the derivatives (2, 9) of the mode by frequency and damping ratio."""
        ad, b0, b1, _, _, _ = self._mode._discrete_tangents(h)
        zeros, ahead = np.zeros((2, 2)), [0.5 * h, 0.0]
        derivatives = ad[:2, 0, 1], ad[:2, 1, 1], (b0 + b1)[:2], b1[:2]
        return np.column_stack([*derivatives, zeros, ahead])

    def init(self, u0, initial_state="rest"):
        return self.scaled_init(u0, 1.0, initial_state)[:-1]

    def run(self, u, dt, state=None):
        u = as_signal(u)
        if state is None:
            state = self.init(u[0] if u.size else 0.0)
        y, state = self.scaled_run(u, np.ones(u.size), dt, (*state, 1.0))
        return y, state[:-1]

    def compiled_step(self, dt, state):
        return CompiledLaw(self._compiled_step, self._constants(dt), state)

    def _constants(self, dt):
        return *self._substep(dt), self.n_substeps, self.gain, self.intercept, *self._law(math.inf)

    def sensitivities(self, u, du, dt, initial_state="rest"):
        return self.scaled_sensitivities(u, du, np.ones(len(u)), 0.0 * du, dt, initial_state)

    # ------------------------------------------------------------ a force that follows a load

    @property
    def scaled_within(self):
        """The hysteretic force, where there is one and the drive is not refined between samples."""
        slides = self.causal and self.presliding_displacement is not None
        return ("friction",) if slides else ()

    def _loaded_rest(self, u0, factor):
        """Return q and the hysteretic force at rest, and their derivatives (2, 1 + n_own + 1).

        The derivatives are as in :meth:`_rest`, then those by the factor of the force. The state is
        that at rest, without a factor, under the drive v for which ``v + (factor - 1) f = u0``.
        Newton's method from zero converges to it, since the force of a first loading is concave.
        """
        gradient, place = self._force_gradient
        v = u0 if factor == 1.0 and gradient == 0.0 else 0.0
        for _ in range(_LOADINGS):
            q, force, by = self._rest(v)
            local, slope = gradient_factor(q, gradient, place)
            excess = factor * local - 1.0
            error, by_v = u0 - v - excess * force, 1.0 + excess * by[1, 0]
            by_v += factor * slope * force * by[0, 0]
            if not abs(error) > _ROUNDING * max(abs(u0), abs(v)):
                break
            v += error / by_v
        dexcess = factor * slope * by[0, 1:]
        if "friction_gradient" in self._sizes:  # the last of its own
            dexcess[-1] += factor * (q - place) * (local > 0.0)
        dv = np.concatenate([[1.0], -excess * by[1, 1:] - force * dexcess, [-local * force]]) / by_v
        tangents = by[:, :1] * dv
        tangents[:, 1:-1] += by[:, 1:]
        return q, force, tangents

    def scaled_init(self, u0, factor, initial_state="rest"):
        if initial_state == "zero":
            return 0.0, 0.0, 0.0, float(u0), 0.0, float(factor)
        return self._begun(float(u0), float(factor))[0]

    def _begun(self, u0, factor):
        """Return the state at rest, and its derivatives as in :meth:`_loaded_rest`."""
        q, force, by = self._loaded_rest(u0, factor)
        return (q, 0.0, force, u0, 1.0, factor), by

    def scaled_run(self, u, factor, dt, state):
        u, factor = as_signal(u), as_signal(factor)
        if not u.size:
            return np.empty(0), state
        *state, before, begun, loaded = state
        q, first = np.empty(u.size), _first(begun, u)
        q[:first] = state[0]
        if first:
            before, loaded = u[0], factor[0]
        (mode, h), law = self._substep(dt), self._law(np.abs(u).max())
        drive = u[first:], np.append(loaded, factor[first:]), before
        state = self._loop(mode, law, h, self.n_substeps, *drive, *state, q[first:])
        return self.gain * q + self.intercept, (*state, float(u[-1]), 1.0, float(factor[-1]))

    def scaled_step(self, dt, state):
        return CompiledLaw(self._loaded_step, self._constants(dt), state, n_inputs=2)

    def scaled_sensitivities(self, u, du, factor, dfactor, dt, initial_state="rest"):
        u, factor, dfactor = as_signal(u), as_signal(factor), as_signal(dfactor)
        m, p, n_own = du.shape[1], dfactor.shape[1], self.n_parameters - 2
        du = np.concatenate([du, np.zeros((u.size, p - m))], axis=1)  # none by those of the factor
        dy = np.empty((u.size, p + n_own + 2))
        if not u.size:
            return np.empty(0), dy
        simulation = partial(self._motion, u, du, factor, dfactor, dt, initial_state)
        if p or u.size > _LONGEST:
            q, dq = simulation()
        else:  # a search tries many parts behind a stage, and other gains of it
            fixed = (f.name for f in dataclasses.fields(self) if f.name not in self._sizes)
            own = type(self), *self._sizes.items(), *map(partial(getattr, self), fixed)
            values = (part.tobytes() for part in (self.pack()[:-2], u, factor))
            q, dq = _kept(_Simulation((*own, *values, dt, initial_state), simulation))
        by_own = dy[:, m : m + n_own + 2]
        dy[:, :m], dy[:, m + n_own + 2 :] = self.gain * dq[:, :m], self.gain * dq[:, m:p]
        by_own[:, :-2], by_own[:, -2], by_own[:, -1] = self.gain * dq[:, p:], q, 1.0
        return self.gain * q + self.intercept, dy

    def _motion(self, u, du, factor, dfactor, dt, initial_state):
        """Return q and its tangents, by the input and by all parameters but the last two."""
        p, n_own = du.shape[1], self.n_parameters - 2
        d = np.zeros((3, p + n_own))
        if initial_state == "zero":
            initial = self.scaled_init(u[0], factor[0], initial_state)
        else:
            initial, by = self._begun(float(u[0]), float(factor[0]))
            d[::2, :p] = np.outer(by[:, 0], du[0]) + np.outer(by[:, -1], dfactor[0])
            d[::2, p:] = by[:, 1:-1]
        *state, before, begun, loaded = initial
        q, dq, first = np.empty(u.size), np.empty((u.size, p + n_own)), _first(begun, u)
        q[:first] = dq[:first] = 0.0
        mode, h = self._substep(dt)
        head = mode, self._substep_tangents(h), self._law(np.abs(u).max()), h, self.n_substeps
        drive = u[first:], du[first:], np.append(loaded, factor[first:])
        past = np.concatenate([dfactor[:1], dfactor[first:]]), before, du[0]
        self._tangent_loop(*head, *drive, *past, *state, d, q[first:], dq[first:])
        return q, dq

    def _force_characteristics(self, level):
        """Return characteristics of a hysteretic force up to ``level`` (drive), {} without one."""
        if not self.hysteresis_stiffness > 0.0:
            return {}
        displacement = abs(self.gain) * level / self.hysteresis_stiffness
        return {
            "largest hysteretic force": (level, "drive"),
            "presliding displacement": (displacement, "response"),
        }


@dataclass(frozen=True)
class _Simulation:
    """A simulation, equal to another one if all that it depends on is equal."""

    key: tuple
    run: Callable = field(compare=False)


@lru_cache(maxsize=4)
def _kept(simulation):
    """Return the result of a simulation, one of the last few if it is equal to it."""
    return simulation.run()


def _first(begun, u):
    """Return the first sample that the stage moves to: 1 for a start from zero."""
    return 0 if begun else min(len(u), 1)


_LOADINGS, _ROUNDING = 100, 4e-16  # most steps to a rest under a factor, and its relative error
_COARSE, FINE = 0.3, 0.1  # longest substep, in radians of the fastest motion
_MOST_COARSE, _MOST_FINE = 16, 64  # most substeps per sampling interval
WINDOWS = (4, 10, 25, 60)  # half lengths of the modulating function, samples
_SMOOTH = 4  # half length of the window that smooths the response for the law, samples
_FEWEST = 100  # least number of equations of a force balance
_MOST = 30_000  # most samples from which starting values are computed
_LEVEL = 0.1  # hysteretic force if the data give none, fraction of the drive's half range
_QUIET = 0.01  # the same for a start that is almost linear
_N_STARTS = 12
_LEAST_DAMPING, _MOST_DAMPING = 0.01, 10.0
_COUPLINGS = (1.0, 3.0, 10.0)  # coupling spring over the stage's spring
_ROUGH = VariableProjection(tolerance=1e-5, max_evaluations=30)
_LAST_EVALUATIONS = 20


class OscillatorModel(ParametricModel):
    """Base of the stages: mass, substeps, intercept, and starting values in three steps.

    *Force balance.* For a given law the hysteretic force follows from the measured displacement
    up to factors, and the equation of motion is then linear in all other parameters. It is
    multiplied by a modulating function, whose derivatives replace those of the response (Shinbrot,
    *Transactions of the ASME*, 1957), and solved by least squares over a grid of laws.

    *Coupling.* The sum of squares of a free run has many minima, since the simulated stage sticks
    and slips at other times than the measured one. A spring that couples the simulated stage to the
    measured response reduces this. The coupled stage is the same stage driven by
    ``u + feedback y``, so its parameters convert exactly (Abarbanel et al., *SIAM Journal on
    Applied Dynamical Systems*, 2009).

    *Free run*, from all of these starting values.

    Parameters
    ----------
    fit_intercept : bool, default=True
        Whether the response has a constant.
    mass : float, default=1.0
        Mass of the stage, used for ``physical_`` only.
    n_substeps : int or None, default=None
        Integration steps per sampling interval. None: the number that the identified stage needs
        for a tenth of a radian of its fastest motion each, at most 64.
    hold : {"foh", "bandlimited"}, default="foh"
        Drive between samples: linear, or without content above half the sampling rate, as a drive
        that was recorded behind an anti-aliasing filter. A model of such a drive looks ahead, and
        is neither stepped nor inverted.

    Attributes
    ----------
    physical_ : dict
        The quantities of the equation of motion for the given mass, see ``operator_.physical``.
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "fit_intercept": ["boolean"],
        "mass": [Interval(Real, 0, None, closed="neither")],
        "n_substeps": [Interval(Integral, 1, None, closed="left"), None],
        "hold": [StrOptions(set(OscillatorOperator.holds))],
    }

    operator_class = OscillatorOperator

    @abstractmethod
    def _laws(self, length, speed):
        """Return a list of laws per kind, given half range and typical speed of the response."""

    @abstractmethod
    def _forces(self, law, y, dt, length):
        """Return the forces of a centred response (n_samples,) as columns, up to a factor each."""

    @abstractmethod
    def _own_parameters(self, law, gain, stiffness, level, swing):
        """Return the operator's own parameters by name.

        The hysteretic force has the initial slope ``stiffness``, relative to the spring, and the
        limit ``level`` (units of the drive); ``swing`` is half the range of the drive.
        """

    def _stage(self, law, mode, scales, factors=None, level=_LEVEL):
        """Return the operator, or None if the hysteretic stiffness is not positive.

        ``law`` begins with the presliding displacement, ``mode`` is the linear part, ``scales`` are
        half range and middle of the response and half range of the drive. ``factors`` are the
        coefficients of the columns of :meth:`_forces`; if they are None, the hysteretic force is
        the fraction ``level`` of the drive's half range.
        """
        displacement, gain, swing = law[0], mode.gain, scales[2]
        stiffness = (
            level * swing * abs(gain) / displacement if factors is None else factors[0] * gain
        )
        if not stiffness > 0.0:
            return None
        parameters = self._own_parameters(
            law, gain, float(stiffness), float(stiffness * displacement / abs(gain)), swing
        )
        linear = mode.natural_frequency, mode.damping_ratio
        parameters |= {"gain": gain, "intercept": mode.intercept, "hold": self.hold}
        return self.operator_class(*linear, **parameters)

    def _retries(self, stage, stages):
        """Return the starting stages to refine too, if the identified ``stage`` is degenerate."""
        return []

    def starting_values(self, records, mode=None):
        """Return at most a dozen operators, with fine substeps.

        Parameters
        ----------
        mode : SecondOrderModeOperator, default=None
            Linear part of one of them, which is almost linear.
        """
        stages = self._stages(records, mode)
        return [self._divided(stage, records, FINE, _MOST_COARSE) for stage in stages]

    def _stages(self, records, mode=None):
        """Return operators with coarse substeps, best first, among them an almost linear one."""
        swing = 0.5 * max(float(np.ptp(r.u)) for r in records) or 1.0
        low, high = min(float(r.y.min()) for r in records), max(float(r.y.max()) for r in records)
        length, middle = 0.5 * (high - low) or 1.0, 0.5 * (high + low)
        if not self.fit_intercept:
            middle = 0.0
        scales = length, middle, swing
        records, washout = around_largest_response(records, middle)
        kinds = []
        for window in WINDOWS:
            usable = [r for r in records if len(r.u) > 2 * window]
            if sum(len(r.u) - 2 * window for r in usable) < _FEWEST:
                break
            kinds += self._balanced(usable, window, scales)
        if mode is None:
            linear = SecondOrderMode(
                fit_intercept=self.fit_intercept,
                hold=self.hold,
                initial_state=self.free_run_state,
                method=rough_method(self.method),
            )
            starts = linear.starting_values(records)
            mode = refine(linear, starts, records, with_errors=False).operator
        # a gain of zero would scale no hysteretic force
        mode = dataclasses.replace(mode, gain=mode.gain or length / swing)
        laws = self._laws(length, mode.natural_frequency * length)
        if not kinds:
            kinds = [
                (kind, self._stage(law, mode, scales))
                for kind, group in enumerate(laws)
                for law in group
            ]
        group = laws[len(laws) // 2]
        kinds.append((len(laws), self._stage(group[len(group) // 2], mode, scales, level=_QUIET)))
        ranked = []
        for kind, stage in kinds:
            stage = self._divided(stage, records, _COARSE, _MOST_COARSE)
            ranked.append((self._error(stage, records, washout), kind, stage))
        ranked.sort(key=lambda entry: entry[0])
        # prefer different kinds of laws: the best of each, then the second best of each, ...
        ranks = [sum(k == kind for _, k, _ in ranked[:i]) for i, (_, kind, _) in enumerate(ranked)]
        chosen = np.argsort(ranks, kind="stable")[:_N_STARTS]
        return [ranked[i][2] for i in sorted(chosen)]

    def _balanced(self, records, window, scales):
        """Return (kind, stage) per kind of law, for the law with the least residual force."""
        length, middle, _ = scales
        motion = np.concatenate(
            [
                np.stack([weigh(r.y - middle, r.dt, window, order) for order in (2, 1, 0)], axis=1)
                for r in records
            ]
        )
        drive = np.concatenate([weigh(r.u, r.dt, window) for r in records])
        speed = float(np.sqrt(np.mean(motion[:, 1] ** 2))) or length / records[0].dt
        smooth = [weigh(np.pad(r.y - middle, _SMOOTH, mode="edge"), r.dt, _SMOOTH) for r in records]
        linear = [motion, np.ones(len(drive))] if self.fit_intercept else [motion]
        n_linear = 3 + self.fit_intercept
        best_of_kind = []
        for kind, laws in enumerate(self._laws(length, speed)):
            stages = []
            for law in laws:
                forces = [
                    np.apply_along_axis(weigh, 0, self._forces(law, y, r.dt, length), r.dt, window)
                    for y, r in zip(smooth, records, strict=True)
                ]
                columns = np.column_stack([*linear, np.concatenate(forces)])
                if not np.isfinite(columns).all():
                    continue
                factors, error = least_squares(columns, drive)
                mass, damping, stiffness = factors[:3].tolist()
                if not mass * stiffness > 0.0:
                    continue
                frequency = float(np.sqrt(stiffness / mass))
                ratio = 0.5 * damping * frequency / stiffness
                mode = SecondOrderModeOperator(
                    frequency,
                    float(np.clip(ratio, _LEAST_DAMPING, _MOST_DAMPING)),
                    1.0 / stiffness,
                    middle - float(factors[3]) / stiffness if self.fit_intercept else 0.0,
                )
                stage = self._stage(law, mode, scales, factors=factors[n_linear:])
                if stage is not None:
                    stages.append((error, stage))
            if stages:
                best_of_kind.append((kind, min(stages, key=lambda entry: entry[0])[1]))
        return best_of_kind

    def _error(self, stage, records, washout=0):
        """Return the residual sum of squares of the free run, gain and intercept solved.

        The first ``washout`` samples of each record are left out.
        """
        gram = np.zeros((3, 3))
        for r in records:
            y = stage.run(r.u, r.dt, stage.init(r.u[0], self.free_run_state))[0]
            columns = np.stack([y, np.full(y.size, float(self.fit_intercept)), r.y])[:, washout:]
            gram += columns @ columns.T
        if not np.isfinite(gram).all():
            return np.inf
        best = np.linalg.lstsq(gram[:2, :2], gram[:2, 2], rcond=None)[0]
        return float(gram[2, 2] - best @ gram[:2, 2])

    def _coupled(self, stages, records, coupling):
        """Return a list of the best stage while coupled to the response, and the evaluations.

        The list is empty if the coupling cannot be removed from the result.
        """
        feedback, origin = coupling / stages[0].gain, stages[0].intercept
        coupled = [s.with_feedback(feedback, origin) for s in stages if feedback * s.gain > -0.5]
        driven = [
            dataclasses.replace(r, u=r.u + feedback * (r.y - origin), before=None) for r in records
        ]
        stage = refine(self, coupled, driven, rough_method(self.method), with_errors=False)
        share = feedback * stage.operator.gain
        if not share < 1.0:
            return [], stage.n_evaluations
        # a held parameter, such as a preload, was not converted with the intercept
        held = {name: getattr(stages[0], name) for name in self.held_parameters()}
        free = dataclasses.replace(stage.operator.with_feedback(-feedback, origin), **held)
        return [self._divided(free, records, _COARSE, _MOST_COARSE)], stage.n_evaluations

    def _divided(self, stage, records, part, most):
        """Return the stage with substeps of ``part`` radians of its fastest motion."""
        n = self.n_substeps
        if n is None:
            longest = max(record.dt for record in records)
            n = np.clip(np.ceil(longest * stage.fastest_rate() / part), 1, most)
        return dataclasses.replace(stage, n_substeps=int(n))

    def identify(self, data):
        """Identify with coarse substeps, then again with those that the result needs."""
        stages = self._stages(data)
        starts, evaluations = [], 0
        if stages[0].gain:
            for coupling in _COUPLINGS:
                coupled, n = self._coupled(stages, data, coupling)
                starts += coupled
                evaluations += n
        result = refine(self, [*starts, *stages], data)
        evaluations += result.n_evaluations
        bounds = getattr(self.method, "bounds", None)
        for stage in self._retries(result.operator, stages):
            other = refine(self, [stage], data, VariableProjection(bounds=bounds))
            evaluations += other.n_evaluations
            result = other if other.error < result.error else result
        stage = self._divided(result.operator, data, FINE, _MOST_FINE)
        if stage.n_substeps > result.operator.n_substeps:
            method = VariableProjection(bounds=bounds, max_evaluations=_LAST_EVALUATIONS)
            finer = refine(self, [stage], data, method)
            evaluations += finer.n_evaluations
            # a motion too fast for any substeps may have no finite derivatives at finer ones
            result = finer if np.isfinite(finer.error) else result
        return dataclasses.replace(result, n_evaluations=evaluations)

    def adopt(self, result):
        super().adopt(result)
        self.physical_ = result.operator.physical(self.mass)
        return self


def rough_method(method):
    """Return the method for starting values, with no more evaluations than that of the fit."""
    most = getattr(method, "max_evaluations", None) or _ROUGH.max_evaluations
    return dataclasses.replace(_ROUGH, max_evaluations=min(most, _ROUGH.max_evaluations))


def around_largest_response(records, middle):
    """Return the part of each long record around its largest response, and a washout in samples.

    The washout is needed because the stage was not at rest before such a part.
    """
    n_samples = sum(len(r.u) for r in records)
    if n_samples <= _MOST:
        return records, 0
    parts = []
    for r in records:
        n = max(int(len(r.u) * _MOST / n_samples), 2)
        start = int(np.argmax(np.abs(r.y - middle))) - n // 2
        start = min(max(start, 0), len(r.u) - n)
        part = slice(start, start + n)
        parts.append(dataclasses.replace(r, u=r.u[part], y=r.y[part], segments=(), before=None))
    return parts, min(len(r.u) for r in parts) // 4


def least_squares(columns, right):
    """Return the coefficients of the columns (n_samples, n) and the residual sum of squares."""
    gram, moments = columns.T @ columns, columns.T @ right
    scale = np.sqrt(np.diag(gram))
    scale[scale == 0.0] = 1.0
    factors = np.linalg.lstsq(gram / np.outer(scale, scale), moments / scale, rcond=None)[0]
    factors /= scale
    return factors, float(right @ right - moments @ factors)


def weigh(values, dt, window, order=0):
    """Return a signal (n,) or a derivative of it, averaged with the weights (1 - x^2)^3.

    ``order`` is that of the derivative, 0 to 2; the result has the shape (n - 2 window,).
    """
    k = np.arange(-window, window + 1)
    x = k / (window + 1.0)
    bell = 1.0 - x * x
    if order == 0:
        weights = bell**3
        weights /= weights.sum()
    elif order == 1:
        weights = -x * bell**2
        weights /= -dt * (weights @ k)  # exact for a ramp
    else:
        weights = bell * (5.0 * x * x - 1.0)
        weights -= weights.mean()
        weights /= 0.5 * dt * dt * (weights @ k**2)  # exact for a parabola
    return np.convolve(values, weights, mode="valid")
