r"""Stages with hysteresis in their equation of motion: the oscillator that moves under any force.

With the displacement q in units of the drive, the velocity ``p = q'/w`` and a force F that depends
on both and on a hysteretic force f,

    q''/w^2 + 2 zeta q'/w + q + F = u.

Over a substep h the drive is a straight line and F is replaced by its mean, under which the
oscillator moves exactly:

    D = q1 - q0 = A p0 + B (u0 - q0 - F) + R (u1 - u0),
    p1 = A' p0 + B' (u0 - q0 - F) + R' (u1 - u0).

F is the mean along the straight way from q0 to q1, on which f is known in closed form, so D is the
root of a scalar equation that is solved exactly: this is the averaged vector field method in
exponential form (Quispel and McLaren, *Journal of Physics A*, 2008). It is of second order, exact
where F = 0, and it inherits the energy balance: the work ``F D`` that goes into the hysteresis is
what f stores and dissipates, at any substep.

A sample is a map of the state (q, p, f) and of the drive before and now. Its Jacobian, together
with the derivatives by the parameters, is accumulated over the substeps (:func:`move_tangents`) and
applied once a sample to the tangents carried through (:func:`carry`). A law gives the derivatives
of D, of the mean F and of the new f by what it sees of the oscillator (``REACH``: D without F,
``SPEED``: p1 without F, then q, p, f, B and B'), and by the parameters themselves.
"""

import dataclasses
import math
from abc import abstractmethod
from functools import cached_property
from numbers import Integral, Real

import numpy as np

from .._documentation import inherit_documentation
from .._jit import bind, jit
from .._sklearn import Interval
from ..base import ParametricModel
from ..linear import SecondOrderMode, SecondOrderModeOperator
from ..operators import LoweredStep, Operator, WindowInverseOperator, as_signal
from ..optimize import VariableProjection

REACH, SPEED, Q, P, F, B, SLOPE_B, OWN = range(8)  # columns of a law's derivatives
FREE = 5  # first parameter's column in a sample's Jacobian, behind the state and both drives
_SERIES = 0.1  # below, the quotients lose digits and the series is short
_C3, _C4, _C5, _C6, _C7, _C8, _C9, _C10 = (1.0 / math.factorial(k) for k in range(3, 11))


@jit
def decay(a):
    """Return ``1 - exp(-a)``, its quotient phi by a, ``(1 - phi) / a`` and ``(1/2 - psi) / a``."""
    if abs(a) < _SERIES:
        # sum of (-a)^k / (k + 3)!
        chi = _C3 - a * (_C4 - a * (_C5 - a * (_C6 - a * (_C7 - a * (_C8 - a * (_C9 - a * _C10))))))
        psi = 0.5 - a * chi
        phi = 1.0 - a * psi
        return a * phi, phi, psi, chi
    gone, inverse = 1.0 - math.exp(-a), 1.0 / a
    phi = gone * inverse
    psi = (1.0 - phi) * inverse
    return gone, phi, psi, (0.5 - psi) * inverse


@jit
def oscillator(mode, q, p, u0, u1):
    """Return the way D and the velocity p1 without a force F; ``mode`` is A, A', B, B', R, R'."""
    pull, slope = u0 - q, u1 - u0
    return (
        mode[0] * p + mode[2] * pull + mode[4] * slope,
        mode[1] * p + mode[3] * pull + mode[5] * slope,
    )


def step(mode, law, h, q, p, f, u0, u1):
    """Stand for a law's substep of length h under a drive from u0 to u1; return new q, p and f."""
    raise NotImplementedError


def sample(mode, law, h, n_substeps, before, u, q, p, f):
    """Return q, p and f behind the interval over which the drive goes from ``before`` to ``u``."""
    u0 = before
    for i in range(n_substeps):
        u1 = before + (u - before) * ((i + 1) / n_substeps)
        q, p, f = step(mode, law, h, q, p, f, u0, u1)
        u0 = u1
    return q, p, f


def run(mode, law, h, n_substeps, u, before, q, p, f, out):
    """Write q to ``out`` (n,) and return the last q, p and f; ``step`` is that of a sample."""
    for k in range(u.size):
        q, p, f = step(mode, law, h, n_substeps, before, u[k], q, p, f)
        before = u[k]
        out[k] = q
    return q, p, f


def lowered(u, c, s):
    """Return the response; ``c`` is (mode, h, number of substeps, gain, intercept, *law).

    ``s`` is (q, p, f, last drive), and ``step`` that of a sample.
    """
    q, p, f = step(c[0], c[5:], c[1], int(c[2]), s[3], u, s[0], s[1], s[2])
    s[0], s[1], s[2], s[3] = q, p, f, u
    return c[3] * q + c[4]


def loops(substep):
    """Return the run and the lowered step of a law, see :func:`step`."""
    own = bind(sample, substep, inline=True)
    return bind(run, own), bind(lowered, own)


@jit
def solve_tangents(b, slope, force, by):
    """Write the derivatives of the D that solves ``D = reach - b F`` to ``by[0]``.

    ``by[1]`` has those of F at this D, and gets those of F; ``slope`` is the one by D.
    """
    one = 1.0 / (1.0 + b * slope)
    for j in range(by.shape[1]):
        change = one * by[1, j]
        by[0, j] = -b * change
        by[1, j] = change
    by[0, REACH] += one
    by[1, REACH] += slope * one
    by[0, B] -= one * force
    by[1, B] -= slope * one * force


@jit
def by_state(mode, by, i):
    """Return the derivatives of what row i of ``by`` is about by q, p and f, the drive held."""
    reach, speed = by[i, REACH], by[i, SPEED]
    return (
        by[i, Q] - mode[2] * reach - mode[3] * speed,
        by[i, P] + mode[0] * reach + mode[1] * speed,
        by[i, F],
    )


@jit
def move_tangents(mode, mode_by, force, by, q, p, u0, u1, start, stop, step):
    """Move the Jacobian ``step`` (3, 5 + n) of a sample over a substep that begins at q and p.

    ``by`` (3, 7 + n) are the derivatives of D, of the mean F (``force``) and of the new f by
    ``REACH``, ... and by the n parameters, ``mode_by`` (2, 6) those of ``mode`` by the first two;
    the substep goes from the part ``start`` of the sample's interval to ``stop``.
    """
    bp = mode[3]
    a, b, c = by_state(mode, by, 0)
    e, f, g = by_state(mode, by, 1)
    x, y, z = by_state(mode, by, 2)
    a, e, f, g = 1.0 + a, -bp - bp * e, mode[1] - bp * f, -bp * g
    for j in range(step.shape[1]):
        dq, dp, df = step[0, j], step[1, j], step[2, j]
        step[0, j] = a * dq + b * dp + c * df
        step[1, j] = e * dq + f * dp + g * df
        step[2, j] = x * dq + y * dp + z * df
    # by the drive before the sample and at it, then by the first two parameters
    pull, slope = u0 - q, u1 - u0
    for i in range(4):
        db = dbp = 0.0
        if i < 2:
            share = start if i else 1.0 - start
            length = stop - start if i else start - stop
            reach, speed = mode[2] * share + mode[4] * length, mode[3] * share + mode[5] * length
        else:
            m = mode_by[i - 2]
            db, dbp = m[2], m[3]
            reach = m[0] * p + db * pull + m[4] * slope
            speed = m[1] * p + dbp * pull + m[5] * slope
        for k in range(3):
            value = by[k, REACH] * reach + by[k, SPEED] * speed
            value += by[k, B] * db + by[k, SLOPE_B] * dbp
            if k == 1:
                value = speed - dbp * force - bp * value
            step[k, 3 + i] += value
    for j in range(by.shape[1] - OWN):
        step[0, FREE + j] += by[0, OWN + j]
        step[1, FREE + j] -= bp * by[1, OWN + j]
        step[2, FREE + j] += by[2, OWN + j]


@jit
def begin(step):
    """Write the Jacobian of a sample before its first substep."""
    for i in range(3):
        for j in range(step.shape[1]):
            step[i, j] = 1.0 if i == j else 0.0


@jit
def carry(step, k, du, dbefore, d, dout):
    """Move the tangents ``d`` (3, m + n) over sample k and write those of q to ``dout[k]``.

    The first m are carried through, ``du`` (n_samples, m) are those of the drive, ``dbefore`` (m,)
    those before the first sample; ``step`` (3, 5 + n) is the sample's Jacobian.
    """
    m = du.shape[1]
    for j in range(m):
        a, b, c = d[0, j], d[1, j], d[2, j]
        old = du[k - 1, j] if k else dbefore[j]
        for i in range(3):
            value = step[i, 0] * a + step[i, 1] * b + step[i, 2] * c
            d[i, j] = value + step[i, 3] * old + step[i, 4] * du[k, j]
        dout[k, j] = d[0, j]
    for j in range(m, d.shape[1]):
        a, b, c = d[0, j], d[1, j], d[2, j]
        for i in range(3):
            value = step[i, 0] * a + step[i, 1] * b + step[i, 2] * c
            d[i, j] = value + step[i, FREE + j - m]
        dout[k, j] = d[0, j]


class OscillatorOperator(Operator):
    r"""Mass, spring and damper with a hysteretic force; ``y = gain q + intercept``.

    The state is the tuple (q, q'/w, hysteretic force, last drive), all in units of the drive; in
    ``"rest"`` the stage has been loaded slowly from zero. Each substep moves the oscillator exactly
    under the mean of the other forces: second order, exact without them, and no source of energy
    where the law is none. Substeps should resolve the small motion: a ``dt fastest_rate() /
    n_substeps`` of 0.1 gives about three digits.

    A subclass names its loops, ``class MyOperator(OscillatorOperator, loops=(run, lowered,
    tangents))``, and gives the state at rest and the law's numbers; its first two parameters are
    the first two here, its last two ``gain`` and ``intercept``.

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
        Integration steps in a sampling interval, above 0. Fixed structure.

    Raises
    ------
    ValueError
        If ``n_substeps`` is not an integer above 0.
    """

    carries_scale = True
    at_once = False
    rank = 10
    _force = ("level", "hysteresis_stiffness")  # where the hysteretic force levels off, its slope

    def __init_subclass__(cls, loops, **options):
        super().__init_subclass__(**options)
        inherit_documentation(cls)
        cls._loop, cls._lowered, cls._tangent_loop = map(staticmethod, loops)

    def __post_init__(self):
        n = self.n_substeps
        is_right = isinstance(n, (int, np.integer)) and not isinstance(n, bool) and n > 0
        self._require("n_substeps", is_right, "be an integer above 0")

    @abstractmethod
    def _rest(self, u0):
        """Return q and the hysteretic force at rest, and their derivatives (2, 1 + n_own).

        The derivatives are those by ``u0`` and by all parameters but the last two.
        """

    @abstractmethod
    def _law(self, u):
        """Return the tuple that the loops take as their law, for a drive up to the size ``u``.

        A loop of tangents, ``(mode, mode_by, law, h, n_substeps, u, du, before, dbefore, q, p, f,
        d, out, dout)``, writes q (n,) and its tangents (n, m + n_own). The columns are those of
        ``du`` (n, m), then the derivatives by all parameters but the last two. ``dbefore`` (m,)
        and ``d`` (3, m + n_own) are the tangents of the drive and of the state before the first
        sample.
        """

    @abstractmethod
    def physical(self, mass=1.0):
        """Return the quantities of the equation of motion for a known mass.

        Displacements are in units of the response; with the mass in kg and the response in m all
        is in SI units.

        Parameters
        ----------
        mass : float, default=1.0

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
    def _fed_back(self, s, shift):
        """Return the subclass's own parameters behind a feedback that divides the gain by ``s``.

        ``shift`` is what the feedback makes of the intercept, in units of the drive.
        """

    def linear_mode(self):
        return SecondOrderModeOperator(
            float(self.natural_frequency), float(self.damping_ratio), self.gain, self.intercept
        )

    def n_ringing(self):
        return self.linear_mode().n_ringing()

    def way_before_sliding(self):
        level, stiffness = (getattr(self, name) for name in self._force)
        return float(abs(self.gain) * level / stiffness) if stiffness else None

    def fastest_rate(self):
        """Return the natural frequency of a small motion, before sliding, rad/s."""
        stiffness = getattr(self, self._force[1])
        return float(self.natural_frequency * math.sqrt(1.0 + stiffness))

    def with_feedback(self, feedback, origin=0.0):
        """Return the operator from ``u + feedback (y - origin)`` to y; this one is from u to y.

        ``feedback`` is in drive/response, with ``feedback gain > -1``, ``origin`` in units of the
        response.
        """
        s = 1.0 + feedback * self.gain
        both = {
            "natural_frequency": self.natural_frequency * math.sqrt(s),
            "damping_ratio": self.damping_ratio / math.sqrt(s),
            "gain": self.gain / s,
            "intercept": origin + (self.intercept - origin) / s,
        }
        own = self._fed_back(s, feedback * (self.intercept - origin))
        return dataclasses.replace(self, **(both | own))

    def inverse(self):
        """Return the operator from the response to the drive, which looks ahead."""
        return WindowInverseOperator(self)

    @cached_property
    def _mode(self):
        return self.linear_mode()  # which remembers its discrete forms

    def _substep(self, dt):
        """Return what moves the oscillator over a substep, (6,), and the substep's length."""
        h = float(dt) / self.n_substeps
        ad, b0, b1, _, _ = self._mode.discrete(h)
        return np.array([ad[0, 1], ad[1, 1], *(b0 + b1), *b1]), h

    def _substep_tangents(self, h):
        """Return the derivatives of the oscillator's step, (2, 6)."""
        ad, b0, b1, _, _, _ = self._mode._discrete_tangents(h)
        return np.column_stack([ad[:2, 0, 1], ad[:2, 1, 1], (b0 + b1)[:2], b1[:2]])

    def init(self, u0, initial_state="rest"):
        if initial_state == "zero":
            return 0.0, 0.0, 0.0, 0.0
        q, force, _ = self._rest(float(u0))
        return q, 0.0, force, float(u0)

    def run(self, u, dt, state=None):
        u = as_signal(u)
        if state is None:
            state = self.init(u[0] if u.size else 0.0)
        *state, before = state
        q = np.empty(u.size)
        mode, h = self._substep(dt)
        law = self._law(np.abs(u).max(initial=0.0))
        state = self._loop(mode, law, h, self.n_substeps, u, before, *state, q)
        return self.gain * q + self.intercept, (*state, float(u[-1]) if u.size else before)

    def lowered(self, dt, state):
        mode, h = self._substep(dt)
        own = mode, h, self.n_substeps, self.gain, self.intercept
        return LoweredStep(self._lowered, (*own, *self._law(math.inf)), state)

    def linearize(self, u, du, dt, initial_state="rest"):
        u, du = as_signal(u), as_signal(du)
        m, n_own = du.shape[1], self.n_parameters - 2
        u0 = float(u[0]) if u.size else 0.0
        d, dbefore = np.zeros((3, m + n_own)), np.zeros(m)
        *state, before = self.init(u0, initial_state)
        if initial_state == "rest" and u.size:
            dbefore = du[0]
            _, _, by = self._rest(u0)
            d[::2, :m] = np.outer(by[:, 0], dbefore)
            d[::2, m:] = by[:, 1:]
        q, dq = np.empty(u.size), np.empty((u.size, m + n_own))
        mode, h = self._substep(dt)
        largest = np.abs(u).max(initial=0.0)
        head = mode, self._substep_tangents(h), self._law(largest), h, self.n_substeps
        self._tangent_loop(*head, u, du, before, as_signal(dbefore), *state, d, q, dq)
        dy = np.empty((u.size, m + n_own + 2))
        dy[:, :-2] = self.gain * dq
        dy[:, -2] = q
        dy[:, -1] = 1.0
        return self.gain * q + self.intercept, dy

    def _force_characteristics(self, level):
        """Return those of a hysteretic force up to a level (units of the drive), if any."""
        if not self.hysteresis_stiffness > 0.0:
            return {}
        way = abs(self.gain) * level / self.hysteresis_stiffness
        return {
            "largest hysteretic force": (level, "drive"),
            "way before it yields": (way, "response"),
        }


_COARSE, _FINE = 0.3, 0.1  # part of a radian of the fastest motion that a substep may last
_MOST_COARSE, _MOST_FINE = 16, 64
_WINDOWS = (4, 10, 25, 60)  # half lengths of the modulating function, samples
_SMOOTH = 4  # half length of that which smooths the response for the law
_FEWEST = 100  # equations
_MOST = 30_000  # samples that starting values are taken from
_LEVEL = 0.1  # hysteretic force, part of the drive's half range, where the data give none
_QUIET = 0.01  # the same of a stage that is almost its linear part
_N_STARTS = 12
_LEAST_DAMPING, _MOST_DAMPING = 0.01, 10.0
_COUPLINGS = (1.0, 3.0, 10.0)
_ROUGHLY = VariableProjection(tolerance=1e-5, max_evaluations=30)
_LAST_EVALUATIONS = 20


class OscillatorModel(ParametricModel):
    """Base of the stages: mass, substeps, intercept, and starting values in three steps.

    *Balance of forces.* For a given law the hysteretic force follows from the measured displacement
    up to factors, and with it the equation of motion is linear in everything else. It is weighted
    with a modulating function, whose derivatives take the place of those of the response (Shinbrot,
    *Transactions of the ASME*, 1957), and solved by least squares over a grid of laws.

    *Coupling.* The sum of squares of a free run has many minima, since the stage sticks and slips
    at moments of its own. A stage that a spring ties to the measured response does so less: it is
    the same stage driven by ``u + feedback y``, so its parameters follow exactly (Abarbanel et al.,
    *SIAM Journal on Applied Dynamical Systems*, 2009).

    *Free run*, from all of these.

    Parameters
    ----------
    fit_intercept : bool, default=True
        Whether the response has a constant.
    mass : float, default=1.0
        Mass of the stage, for ``physical_``; nothing else depends on it.
    n_substeps : int or None, default=None
        Integration steps in a sampling interval. None: as many as the stage that was found needs, a
        tenth of a radian of its fastest motion each, 64 at most.

    Attributes
    ----------
    physical_ : dict
        The quantities of the equation above for the given mass, see
        ``physical`` of ``operator_``.
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "fit_intercept": ["boolean"],
        "mass": [Interval(Real, 0, None, closed="neither")],
        "n_substeps": [Interval(Integral, 1, None, closed="left"), None],
    }

    operator_class = OscillatorOperator

    @abstractmethod
    def _laws(self, length, speed):
        """Return lists of laws, one a kind, for the half range and the speed of the response."""

    @abstractmethod
    def _forces(self, law, y, dt, length):
        """Return the forces of a response (n_samples,), centred, as columns up to their factors."""

    @abstractmethod
    def _own(self, law, gain, stiffness, level, swing):
        """Return the operator's own parameters by name.

        The hysteretic force begins with the slope ``stiffness``, relative to the spring, and levels
        off at ``level``; ``swing`` is half the range of the drive.
        """

    def _stage(self, law, mode, scales, factors=None, level=_LEVEL):
        """Return the operator, or None where there is none.

        ``law`` begins with the way on which the force levels off, ``mode`` is the linear part,
        ``scales`` are half range and middle of the response and half range of the drive,
        ``factors`` belong to the columns of :meth:`_forces`; where they are unknown, the hysteretic
        force is the part ``level`` of the drive's half range.
        """
        way, gain, swing = law[0], mode.gain, scales[2]
        stiffness = level * swing * abs(gain) / way if factors is None else factors[0] * gain
        if not stiffness > 0.0:
            return None
        own = self._own(law, gain, float(stiffness), float(stiffness * way / abs(gain)), swing)
        linear = mode.natural_frequency, mode.damping_ratio
        return self.operator_class(*linear, gain=gain, intercept=mode.intercept, **own)

    def _retries(self, stage, stages):
        """Return those of the stages to follow to the end, because the one found is degenerate."""
        return []

    def starting_values(self, records, mode=None):
        """Return a dozen at most, with substeps that need not be made finer.

        One of them is almost linear: ``mode``, where the linear part is known already.
        """
        stages = self._stages(records, mode)
        return [self._divided(stage, records, _FINE, _MOST_COARSE) for stage in stages]

    def _stages(self, records, mode=None):
        """Return operators with coarse substeps, best first, among them an almost linear one."""
        swing = 0.5 * max(float(np.ptp(r.u)) for r in records) or 1.0
        low, high = min(float(r.y.min()) for r in records), max(float(r.y.max()) for r in records)
        length, middle = 0.5 * (high - low) or 1.0, 0.5 * (high + low)
        if not self.fit_intercept:
            middle = 0.0
        scales = length, middle, swing
        records, washout = _loudest(records, middle)
        kinds = []
        for window in _WINDOWS:
            usable = [r for r in records if len(r.u) > 2 * window]
            if sum(len(r.u) - 2 * window for r in usable) < _FEWEST:
                break
            kinds += self._balanced(usable, window, scales)
        if mode is None:
            linear = SecondOrderMode(
                fit_intercept=self.fit_intercept,
                initial_state=self._free_run_state(),
                method=self._roughly(),
            )
            mode = linear._identify(records).operator
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
        # the first of each kind, then the second of each, ...
        turns = [sum(k == kind for _, k, _ in ranked[:i]) for i, (_, kind, _) in enumerate(ranked)]
        chosen = np.argsort(turns, kind="stable")[:_N_STARTS]
        return [ranked[i][2] for i in sorted(chosen)]

    def _balanced(self, records, window, scales):
        """Return (kind, stage) of the law of each kind that balances the forces best."""
        length, middle, _ = scales
        motion = np.concatenate(
            [
                np.stack([_weigh(r.y - middle, r.dt, window, order) for order in (2, 1, 0)], axis=1)
                for r in records
            ]
        )
        drive = np.concatenate([_weigh(r.u, r.dt, window) for r in records])
        speed = float(np.sqrt(np.mean(motion[:, 1] ** 2))) or length / records[0].dt
        smooth = [
            _weigh(np.pad(r.y - middle, _SMOOTH, mode="edge"), r.dt, _SMOOTH) for r in records
        ]
        linear = [motion, np.ones(len(drive))] if self.fit_intercept else [motion]
        n_linear = 3 + self.fit_intercept
        found = []
        for kind, laws in enumerate(self._laws(length, speed)):
            stages = []
            for law in laws:
                forces = [
                    np.apply_along_axis(_weigh, 0, self._forces(law, y, r.dt, length), r.dt, window)
                    for y, r in zip(smooth, records, strict=True)
                ]
                columns = np.column_stack([*linear, np.concatenate(forces)])
                if not np.isfinite(columns).all():
                    continue
                factors, error = _least_squares(columns, drive)
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
                found.append((kind, min(stages, key=lambda entry: entry[0])[1]))
        return found

    def _error(self, stage, records, washout=0):
        """Return the sum of squares of the free run, gain and intercept solved.

        The first ``washout`` samples of each record do not count.
        """
        gram = np.zeros((3, 3))
        for r in records:
            y = stage.run(r.u, r.dt, stage.init(r.u[0], self._free_run_state()))[0]
            columns = np.stack([y, np.full(y.size, float(self.fit_intercept)), r.y])[:, washout:]
            gram += columns @ columns.T
        if not np.isfinite(gram).all():
            return np.inf
        best = np.linalg.lstsq(gram[:2, :2], gram[:2, 2], rcond=None)[0]
        return float(gram[2, 2] - best @ gram[:2, 2])

    def _coupled(self, stages, records, coupling):
        """Return the stage that fits best while it is tied to the response, [] without one."""
        feedback, origin = coupling / stages[0].gain, stages[0].intercept
        tied = [s.with_feedback(feedback, origin) for s in stages if feedback * s.gain > -0.5]
        driven = [
            dataclasses.replace(r, u=r.u + feedback * (r.y - origin), before=None) for r in records
        ]
        stage = self._refine(tied, driven, self._roughly())
        share = feedback * stage.operator.gain
        if not share < 1.0:
            return [], stage.n_evaluations
        # what is held, a preload for one, has not followed the intercept of the tied stage
        held = {name: getattr(stages[0], name) for name in self.held_parameters()}
        free = dataclasses.replace(stage.operator.with_feedback(-feedback, origin), **held)
        return [self._divided(free, records, _COARSE, _MOST_COARSE)], stage.n_evaluations

    def _divided(self, stage, records, part, most):
        """Return the stage with substeps that resolve its fastest motion."""
        n = self.n_substeps
        if n is None:
            longest = max(record.dt for record in records)
            n = np.clip(np.ceil(longest * stage.fastest_rate() / part), 1, most)
        return dataclasses.replace(stage, n_substeps=int(n))

    def _identify(self, data):
        """Identify with coarse substeps, then once more with those that the result asks for."""
        stages = self._stages(data)
        starts, evaluations = [], 0
        if stages[0].gain:
            for coupling in _COUPLINGS:
                found, n = self._coupled(stages, data, coupling)
                starts += found
                evaluations += n
        result = self._refine([*starts, *stages], data)
        evaluations += result.n_evaluations
        bounds = getattr(self.method, "bounds", None)
        for stage in self._retries(result.operator, stages):
            other = self._refine([stage], data, VariableProjection(bounds=bounds))
            evaluations += other.n_evaluations
            result = other if other.error < result.error else result
        stage = self._divided(result.operator, data, _FINE, _MOST_FINE)
        if stage.n_substeps > result.operator.n_substeps and np.isfinite(self._error(stage, data)):
            method = VariableProjection(bounds=bounds, max_evaluations=_LAST_EVALUATIONS)
            result = self._refine([stage], data, method)
            evaluations += result.n_evaluations
        return dataclasses.replace(result, n_evaluations=evaluations)

    def _roughly(self):
        """Return how starting values are identified: no longer than the result is."""
        most = getattr(self.method, "max_evaluations", None) or _ROUGHLY.max_evaluations
        return dataclasses.replace(_ROUGHLY, max_evaluations=min(most, _ROUGHLY.max_evaluations))

    def _adopt(self, result):
        super()._adopt(result)
        self.physical_ = result.operator.physical(self.mass)
        return self


def _loudest(records, middle):
    """Return a part of each long record, around its largest response, and samples to leave out.

    Before such a part the stage was not at rest.
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


def _least_squares(columns, right):
    """Return the coefficients of the columns (n_samples, n) and the sum of squares left."""
    gram, moments = columns.T @ columns, columns.T @ right
    scale = np.sqrt(np.diag(gram))
    scale[scale == 0.0] = 1.0
    factors = np.linalg.lstsq(gram / np.outer(scale, scale), moments / scale, rcond=None)[0]
    factors /= scale
    return factors, float(right @ right - moments @ factors)


def _weigh(values, dt, window, order=0):
    """Return a derivative of a signal, (n - 2 window,), averaged with the weights (1 - x^2)^3."""
    k = np.arange(-window, window + 1)
    x = k / (window + 1.0)
    bell = 1.0 - x * x
    if order == 0:
        weights = bell**3
        weights /= weights.sum()
    elif order == 1:
        weights = -x * bell**2
        weights /= -dt * (weights @ k)  # a ramp has its slope
    else:
        weights = bell * (5.0 * x * x - 1.0)
        weights -= weights.mean()
        weights /= 0.5 * dt * dt * (weights @ k**2)  # and a parabola its curvature
    return np.convolve(values, weights, mode="valid")
