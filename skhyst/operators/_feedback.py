r"""Static feedback around linear dynamics: a nonlinear linear-fractional model.

With a linear operator G of the static gain g, and a memoryless curve s,

    w = G[u - f(q)],    q = w / g,    f(q) = s(q) - q,    y = w + c.

So q, in units of the drive, is the response of G with unit gain, and at rest ``s(q) = u``: for a
mass on a spring, s is the characteristic of the spring. With the identity as the curve, G is
unchanged. (Schoukens and Tóth, *IFAC-PapersOnLine*, 2020, call it NL-LFR; here the curve acts on
the output, and its force adds to the drive.) Or the force depends on the velocity,

    w = G[u - f(q')],    f = s,

for a G of ``C B = D = 0``, whose velocity ``w' = C A x`` does not jump with the drive; or on both,
``f(q, q') = s(q, q') - q``.

Over a substep h, drive and force are straight lines, for which G is solved exactly:

    x1 = Ad x0 + B0 (u0 - f0) + B1 (u1 - f1),    w1 = C x1 + D (u1 - f1).

Let z be w, or w', and E its row of the states, C or C A. The force f1 acts on z1 at once, by
``b = E B1 + D``, so f1 is the root of the scalar equation

    f(z1 / g) = f1,    z1 = r - b f1,    r = E (Ad x0 + B0 (u0 - f0) + B1 u1) + D u1,

which has one where ``1 + b f' / g > 0``: always for short substeps, since b goes to D with h, and a
loop without delay is well posed for the same D. Of both arguments there are two z, b and r, and
their products add up. The root is found by the secant method from a fixed point, in at most 30
trials. The scheme is of second order, exact for f = 0.
Tangents follow from the same equations, linear in the tangents: the derivatives of a root need no
trials.
"""

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from .._jit import bind, jit
from ._compiled_step import CompiledLaw
from ._composition import _Composition
from ._held_input import HeldInput
from ._protocol import as_signal
from ._root_inverse import RootInverseOperator

FEEDBACK_ARGUMENTS = ("displacement", "velocity", "both")
_TRIALS = 30  # most steps of the secant method, which needs two to five
_ROUNDING = 1e-15
_LARGEST = 1e60  # response of a diverged run: all later ones are NaN, no square overflows
_STEEPEST = 1e100  # derivative of such a run
_LEAST_SLOPE = 1e-3  # least slope of a secant; below it a fixed-point iteration is made


def step(u, c, s):
    """Placeholder of the curve's step, which ``bind`` puts in its place."""
    raise NotImplementedError


def first(u, c, s):
    """Return the step of a curve at the first number of a row."""
    return step(u[0], c, s)


def feedback_step(u, c, s):
    """Return the response; ``c`` is that of :meth:`FeedbackOperator._constants`, then the curve's.

    ``s`` are the states, the last force, the last drive, a mark that is zero before the first
    sample of a start from zero, workspace, and each z / g of each instant of the sample.
    """
    ad, b0, b1, output, d, gain, intercept = c[0], c[1], c[2], c[3], c[4], c[5], c[6]
    n_substeps, is_held, sensed, passed = int(c[7]), c[8], c[9], c[10]
    n, n_sensed = output.size, sensed.shape[0]
    at = n + 3 + max(n, n_sensed)  # of each r, and each b behind them
    before = s[n + 1]
    first = 0 if s[n + 2] > 0.0 else n_substeps
    last = n_substeps + 1 if is_held > 0.0 or first > 0 else n_substeps
    # the last pass, i = n_substeps, takes no time: it solves for the force at the sample itself,
    # where a held drive jumps, or where a start from zero has no substep before
    for i in range(first, last):
        start, stop = u, u
        if i < n_substeps:
            start, stop = before, before
            if is_held == 0.0:
                start = before + (u - before) * (i / n_substeps)
                stop = before + (u - before) * ((i + 1) / n_substeps)
            for j in range(n):
                value = b0[j] * (start - s[n]) + b1[j] * stop
                for k in range(n):
                    value += ad[j, k] * s[k]
                s[n + 3 + j] = value
            for j in range(n):
                s[j] = s[n + 3 + j]
        for a in range(n_sensed):
            b, r = d, 0.0
            for j in range(n):
                r += sensed[a, j] * s[j]
                if i < n_substeps:
                    b += sensed[a, j] * b1[j]
            s[at + a], s[at + n_sensed + a] = r + d * stop, b
        # root of f(z / g) = f1 by the secant method, from the last force
        guess, old, older, f = s[n], s[n], 0.0, 0.0
        for trial in range(_TRIALS + 1):
            for a in range(n_sensed):
                s[n + 3 + a] = (s[at + a] - s[at + n_sensed + a] * guess) / gain
            f = step(s[n + 3 :], c[11:], s) - passed * s[n + 3]
            error = f - guess
            close = True
            for a in range(n_sensed):
                size = abs(gain * s[n + 3 + a]) + abs(s[at + a])
                if abs(s[at + n_sensed + a] * error) > _ROUNDING * size:  # never where it is NaN
                    close = False
            if close or trial == _TRIALS:
                break
            slope = (older - error) / (guess - old) if trial > 0 and guess != old else 1.0
            old, older = guess, error
            # a slope near zero or below would throw the secant far away
            guess += error / slope if slope > _LEAST_SLOPE else error
        if not abs(gain * s[n + 3]) <= _LARGEST:  # also if it is NaN
            s[n + 3] = f = math.nan
        if i < n_substeps:
            for j in range(n):
                s[j] -= b1[j] * f
        s[n] = f
        for a in range(n_sensed):
            s[at + n_sensed * (2 + i) + a] = s[n + 3 + a]
    s[n + 1], s[n + 2] = u, 1.0
    w = d * (u - s[n])
    for j in range(n):
        w += output[j] * s[j]
    return w + intercept


def trace(u, c, s, y, q):
    """Write the response to ``y`` (n_samples,), z / g of all instants to ``q`` (n_samples, n)."""
    for k in range(len(u)):
        y[k] = step(u[k], c, s)
        for i in range(q.shape[1]):
            q[k, i] = s[s.size - q.shape[1] + i]


@cache
def _law(curve, both):
    return bind(feedback_step, curve if both else bind(first, curve, inline=True), inline=True)


@cache
def _trace(law):
    return bind(trace, law)


@jit
def _tangents(
    moving, resting, output, sensed, d, gain, at_gain, by_output, by_sensed, by_d, n_substeps,
    is_held, begun, u, du, before, dbefore, q, force, slope, by_curve, x, dx, f, df, dy,
):  # fmt: skip
    """Write the tangents (n_samples, m + p + n_curve) of w to ``dy``.

    The m columns are those of the drive, the p by the parameters of the linear part, of which
    number ``at_gain`` is the gain, the n_curve by those of the curve. ``moving`` is (Ad, B0, B1)
    and their derivatives for a substep, ``resting`` the same for a step of no duration. ``q`` is
    z / g for each row of ``sensed``; ``q``, the force there, its slopes by z / g and its
    derivatives ``by_curve`` are (n_samples, n_substeps + 1, ...), as :func:`trace` has stored them.
    ``x``, ``dx``, ``f`` and ``df`` are states, force and their tangents before the first sample;
    they are overwritten.
    """
    n, m, p, n_sensed = output.size, du.shape[1], by_d.size, len(sensed)
    free, dfree = np.empty(n), np.empty(n)
    for k in range(len(u)):
        first = 0 if begun else n_substeps
        last = n_substeps + 1 if is_held or not begun else n_substeps
        for i in range(first, last):
            ad, b0, b1, by_ad, by_b0, by_b1 = moving if i < n_substeps else resting
            begin = 0.0 if is_held else i / n_substeps
            end = 0.0 if is_held else (i + 1) / n_substeps
            if i == n_substeps:
                begin = end = 1.0
            v, stop = before + (u[k] - before) * begin - f, before + (u[k] - before) * end
            bent = 1.0  # becomes 1 + b f' / g, the derivative of the equation by the force
            for j in range(n):
                total = b0[j] * v + b1[j] * stop
                for h in range(n):
                    total += ad[j, h] * x[h]
                free[j] = total
            f, bend = force[k, i], slope[k, i]  # known from the run: no root is sought again
            for z in range(n_sensed):
                b = d
                for j in range(n):
                    b += sensed[z, j] * b1[j]
                bent += b * bend[z] / gain
            for z in range(m + p + by_curve.shape[2]):
                dv, dstop, a = -df[z], 0.0, z - m
                if z < m:
                    dv += dbefore[z] + (du[k, z] - dbefore[z]) * begin
                    dstop = dbefore[z] + (du[k, z] - dbefore[z]) * end
                is_linear = 0 <= a < p
                for j in range(n):
                    total = b0[j] * dv + b1[j] * dstop
                    for h in range(n):
                        total += ad[j, h] * dx[h, z]
                    if is_linear:
                        total += by_b0[a, j] * v + by_b1[a, j] * stop
                        for h in range(n):
                            total += by_ad[a, j, h] * x[h]
                    dfree[j] = total
                moved = by_curve[k, i, a - p] if a >= p else 0.0
                for y in range(n_sensed):
                    dr, db = d * dstop, 0.0
                    for j in range(n):
                        dr += sensed[y, j] * dfree[j]
                        if is_linear:
                            dr += by_sensed[y, a, j] * free[j]
                            db += by_sensed[y, a, j] * b1[j] + sensed[y, j] * by_b1[a, j]
                    if is_linear:
                        dr += by_d[a] * stop
                        db += by_d[a]
                    moved += bend[y] * (dr - db * f) / gain
                    if a == at_gain:
                        moved -= bend[y] * q[k, i, y] / gain
                df[z] = moved / bent  # implicit function theorem
                for j in range(n):
                    dx[j, z] = dfree[j] - b1[j] * df[z]
                    if is_linear:
                        dx[j, z] -= by_b1[a, j] * f
            for j in range(n):
                x[j] = free[j] - b1[j] * f
        begun, before = True, u[k]
        for z in range(m + p + by_curve.shape[2]):
            dw = -d * df[z]
            for j in range(n):
                dw += output[j] * dx[j, z]
            if z < m:
                dbefore[z] = du[k, z]
                dw += d * du[k, z]
            elif z < m + p:
                dw += by_d[z - m] * (u[k] - f)
                for j in range(n):
                    dw += by_output[z - m, j] * x[j]
            dy[k, z] = dw


def has_velocity(linear):
    """Whether the velocity of a linear operator does not jump with the drive: C B = D = 0."""
    _, b, c, d = linear.state_space()
    return d == 0.0 and abs(c @ b) <= _ROUNDING * (np.abs(c) @ np.abs(b))


@dataclass(frozen=True)
class FeedbackOperator(_Composition, HeldInput):
    r"""Linear dynamics with a memoryless curve in the feedback, see :class:`Feedback`.

    Parameters
    ----------
    names : tuple of str
        Names of the two, ``("linear", "curve")``.
    stages : tuple of Operator
        The linear part: ``discrete(dt)``, ``gain`` other than zero, ``intercept`` and a ``hold``,
        such as :class:`~skhyst.linear.TransferFunctionOperator`. The curve, which is memoryless and
        has a compiled step, or a function of a signal and its rate (``of_rate``).
    n_substeps : int, default=8
        Integration steps per sampling interval, above 0. Fixed structure.
    argument : {"displacement", "velocity", "both"}, default="displacement"
        What the curve is a function of: q, or its velocity in units of the drive per s, or both.
        Fixed structure.

    Raises
    ------
    ValueError
        If there are not two such stages, ``n_substeps`` is not above 0, ``argument`` none of these,
        or the velocity of the linear part jumps with the drive.

    Examples
    --------
    A hardening spring, at rest where ``q + 0.2 q^3`` is the drive:

    >>> import numpy as np
    >>> from skhyst.linear import SecondOrderModeOperator
    >>> from skhyst.operators import FeedbackOperator
    >>> from skhyst.static import PolynomialCurveOperator
    >>> cubic = PolynomialCurveOperator(np.array([0.0, 0.08]), center=0.0, scale=1.0)
    >>> stages = SecondOrderModeOperator(50.0, 0.5), cubic
    >>> stage = FeedbackOperator(("linear", "curve"), stages)
    >>> y, _ = stage.run(np.full(3, 0.5), 1e-2)
    >>> bool(np.allclose(cubic.run(y, 1e-2)[0], 0.5))
    True
    """

    n_substeps: int = 8
    argument: str = "displacement"

    structure_of = "Feedback"
    signal_linear = False
    owns_gain = True
    at_once = False
    memoryless = False
    stage_order = 10
    n_poles = (0, 0)

    def __post_init__(self):
        super().__post_init__()
        self._require("n_substeps", self.n_substeps > 0, "be above 0")
        is_right = len(self.stages) == 2
        is_right = is_right and (self.curve.of_rate if self._of_both else self.curve.memoryless)
        is_right = is_right and self.linear.has_matrices and hasattr(self.linear, "hold")
        curve = "function of a signal and its rate" if self._of_both else "memoryless curve"
        self._require("stages", is_right, f"be linear dynamics and a {curve}")
        self._require("stages", self.linear.gain != 0.0, "have a static gain other than zero")
        wanted = " or ".join(map(repr, FEEDBACK_ARGUMENTS))
        self._require("argument", self.argument in FEEDBACK_ARGUMENTS, f"be {wanted}")
        is_smooth = self.argument == "displacement" or has_velocity(self.linear)
        self._require("stages", is_smooth, "have a velocity that does not jump with the drive")

    @property
    def strictly_proper(self):
        return self.linear.strictly_proper

    @property
    def _of_velocity(self):
        return self.argument == "velocity"

    @property
    def _of_both(self):
        return self.argument == "both"

    @property
    def linear(self):
        """The linear part."""
        return self.stages[0]

    @property
    def curve(self):
        """The curve in the feedback."""
        return self.stages[1]

    @property
    def hold(self):
        """Assumed course of the drive between its samples, that of the linear part."""
        return self.linear.hold

    @property
    def causal(self):
        return self.linear.causal

    def linear_mode(self):
        return self.linear.linear_mode()

    def slowest_decay(self):
        return self.linear.slowest_decay()

    def _marked(self, parts):
        linear, curve = parts
        # the loop is linear in a gain that scales q only, if no other parameter has its units
        alone = sum(spec.linear for spec in linear) == sum(spec.is_shared for spec in linear)
        linear = [replace(s, linear=s.linear and (alone or s.is_constant)) for s in linear]
        return [linear, [replace(s, linear=False, held=s.held or s.is_shared) for s in curve]]

    def _finer(self, factor):
        linear = replace(self.linear, hold="foh")
        n_substeps = -(-self.n_substeps // factor)
        return replace(self, stages=(linear, self.curve), n_substeps=n_substeps)

    def _straight(self):
        """Return the linear part with straight lines over a substep, whatever its hold."""
        if "straight" not in self._memory:
            self._memory["straight"] = replace(self.linear, hold="foh")
        return self._memory["straight"]

    def _constants(self, dt):
        system = self._straight().discrete(dt / self.n_substeps)
        values = self.linear.gain, self.linear.intercept, self.n_substeps, self.linear.hold == "zoh"
        sensed = self._sensed(system[3], 0)
        return *system, *map(float, values), sensed, float(not self._of_velocity)

    def _sensed(self, output, which):
        """Return the rows of the states that give each z, or (1) their derivatives."""
        if self.argument == "displacement":
            return output[None]
        rate = self._straight().rate_row()[which][None]
        return rate if self._of_velocity else np.concatenate([output[None], rate])

    def poles_at(self, response):
        """Return the poles of the linearised loop about a rest.

        Parameters
        ----------
        response : float
            At rest.

        Returns
        -------
        ndarray of shape (n_states,), complex
            In rad/s.
        """
        q = (response - self.linear.intercept) / self.linear.gain
        _, slope, _ = self._force(self._at_rest(q))
        a, b, c, d = self.linear.state_space()
        share = slope[0] / self.linear.gain
        row = share @ self._sensed(c, 0)
        return np.linalg.eigvals(a - np.outer(b, row) / (1.0 + d * share[0]))

    def _at_rest(self, q):
        """Return what the curve is a function of where q rests, (1, n_arguments)."""
        return np.array([{"displacement": [q], "velocity": [0.0], "both": [q, 0.0]}[self.argument]])

    def _rest(self, u0):
        """Return q at rest, by Newton's method, or by bisection if that fails."""
        q = u0 = float(u0)
        if self._of_velocity:
            return u0 - float(self._force(self._at_rest(q))[0][0])
        for _ in range(_TRIALS):
            (force,), ((slope, *_),), _ = self._force(self._at_rest(q))
            error = q + force - u0
            if abs(error) <= _ROUNDING * max(abs(q), abs(u0)):
                return q
            if not 1.0 + slope > _LEAST_SLOPE:
                break
            q -= error / (1.0 + slope)
        return float(RootInverseOperator(self.curve).init(u0)[0])

    def _force(self, z):
        """Return the force f, its slopes and its derivatives by the entries of the curve."""
        if self._of_both:
            y, slope, by_entries = self.curve.surface(z)
        else:
            y, by = self.curve.sensitivities(z[:, 0], np.ones((len(z), 1)), 1.0)
            slope, by_entries = by[:, :1], by[:, 1:]
        if self._of_velocity:
            return y, slope, by_entries
        return y - z[:, 0], slope - np.eye(1, slope.shape[1]), by_entries

    def arguments(self, u, dt):
        """Return the argument of the curve, from rest.

        Parameters
        ----------
        u : ndarray of shape (n_samples,)
            Drive.
        dt : float
            Sampling interval in s.

        Returns
        -------
        ndarray of shape (n_samples, n_arguments)
            Units of the drive, of a velocity per s.
        """
        if not self.causal:  # straight between its samples
            return self._finer(1).arguments(u, dt)
        last = self.n_substeps - (self.linear.hold != "zoh")
        return self._traced(as_signal(u), dt, self.init(u[0]))[1][:, last]

    def _traced(self, u, dt, state):
        """Return the response, and z / g at each instant of each sample."""
        law = self.compiled_step(dt, state)
        y, z = np.empty(len(u)), np.zeros((len(u), (1 + self._of_both) * (self.n_substeps + 1)))
        _trace(law.step)(u, law.constants, law.state.copy(), y, z)
        return y, z.reshape(len(u), self.n_substeps + 1, -1)

    def init(self, u0, initial_state="rest"):
        if initial_state == "zero":
            return np.zeros_like(self._straight()._rest()), 0.0, 0.0, False
        q = self._rest(u0)
        return self._straight()._rest() * q, float(u0 - q), float(u0), True

    def run(self, u, dt, state=None):
        u = as_signal(u)
        compiled_step = self.compiled_step(dt, self.init(u[0]) if state is None else state)
        s, n = compiled_step.state.copy(), len(self._straight()._rest())
        y = compiled_step.streaming(s)(u)
        return y, (s[:n].copy(), float(s[n]), float(s[n + 1]), bool(s[n + 2]))

    def compiled_step(self, dt, state):
        x, force, before, begun = state
        both = self._of_both
        curve = self.curve.compiled_surface() if both else self.curve.compiled_step(dt, ())
        workspace = np.zeros(max(len(x), 1 + both) + (1 + both) * (self.n_substeps + 3))
        state = [*x, force, before, float(begun), *workspace]
        return CompiledLaw(_law(curve.step, both), (*self._constants(dt), *curve.constants), state)

    def sensitivities(self, u, du, dt, initial_state="rest"):
        u, du = as_signal(u), as_signal(du)
        (x, f, before, begun), h = self.init(u[0], initial_state), dt / self.n_substeps
        n_samples, m = du.shape
        y, q = self._traced(u, dt, (x, f, before, begun))
        force, slope, by_curve_values = self._force(q.reshape(-1, 1 + self._of_both))
        straight = self._straight()
        ad, b0, b1, output, d = straight.discrete(h)
        *by_moving, by_output, by_d, by_rest = straight._discrete_tangents(h)
        sensed, by_sensed = self._sensed(output, 0), self._sensed(by_output, 1)
        n, p = len(x), len(by_d)
        unmoved = [np.eye(n), np.zeros(n), np.zeros(n), *map(np.zeros_like, by_moving)]
        names = [name for name, _ in self.linear.entries()]
        dx, df, dbefore = np.zeros((n, m + self.n_parameters)), np.zeros(m + self.n_parameters), 0.0
        if begun:
            q0 = before - f
            _, ((bend, *_),), (by_curve,) = self._force(self._at_rest(q0))
            bend = 0.0 if self._of_velocity else bend
            dbefore = du[0]
            share = 1.0 / (1.0 + bend) if 1.0 + bend > 0.0 else 0.0  # a flat curve holds no place
            dq = share * np.concatenate([dbefore, np.zeros(p), -by_curve])
            df = np.concatenate([dbefore, np.zeros(p + len(by_curve))]) - dq
            dx = np.outer(straight._rest(), dq)
            dx[:, m : m + p] += q0 * by_rest.T
        dy = np.empty((n_samples, m + self.n_parameters))
        shape = n_samples, self.n_substeps + 1
        _tangents(
            (ad, b0, b1, *by_moving), tuple(unmoved), output, sensed, d, float(self.linear.gain),
            names.index("gain"), by_output, by_sensed, by_d, self.n_substeps,
            self.linear.hold == "zoh", begun, u, du, before, dbefore + np.zeros(m), q,
            force.reshape(shape), slope.reshape(*shape, -1), by_curve_values.reshape(*shape, -1),
            x.copy(), dx, f, df, dy,
        )  # fmt: skip
        dy[:, m + names.index("intercept")] = 1.0
        diverged = ~(np.abs(dy).max(axis=1, initial=0.0) <= _STEEPEST)
        if diverged.any():
            y[np.argmax(diverged) :] = dy[np.argmax(diverged) :] = np.nan
        return y, dy
