"""Linear operators, stepped exactly.

A linear operator is given by its continuous-time matrices ``x' = A x + B u``, ``y = C x + D u``
(+ intercept) as functions of its parameters. Between samples the input is a straight line
(first-order hold, "foh") or constant (zero-order hold, "zoh"); for such an input the discrete form
is exact. With ``h`` the interval,

    exp [[A h, B h, 0], [0, 0, 1], [0, 0, 0]] = [[Ad, G1, G2], [0, 1, 1], [0, 0, 1]]

gives ``x[k] = Ad x[k-1] + (G1 - G2) u[k-1] + G2 u[k]`` for the first-order hold and
``x[k] = Ad x[k-1] + G1 u[k-1]`` for the zero-order hold (Van Loan, IEEE Trans. Autom. Control
23(3), 1978). Derivatives with respect to the parameters are taken by a complex step through the
same formulas, which is exact to rounding (Al-Mohy and Higham, Numer. Algorithms 53, 2010).
"""

from abc import abstractmethod
from functools import cached_property

import numpy as np
from scipy.linalg import expm

from .._jit import jit
from .._sklearn import StrOptions
from ..base import ParametricModel
from ..operators import LoweredStep, Operator

_STEP = 1e-30  # of the complex step; far below rounding, far above underflow
_BLOCK = 16  # samples that are advanced at once
_LONG = 512  # samples for which the table of a block pays


@jit
def state_space_run(ad, b0, b1, c, d, u, x, u_previous):
    """Return the output and the last state; ``x`` (n_states,) is left as it was."""
    n_states = ad.shape[0]
    old = x.copy()
    new = np.empty(n_states)
    y = np.empty(u.shape[0])
    for k in range(u.shape[0]):
        output = d * u[k]
        for i in range(n_states):
            value = b0[i] * u_previous + b1[i] * u[k]
            for j in range(n_states):
                value += ad[i, j] * old[j]
            new[i] = value
            output += c[i] * value
        y[k] = output
        u_previous = u[k]
        old, new = new, old
    return y, old


@jit
def first_order_run(ad, b0, b1, c, d, u, x, u_previous):
    """Do :func:`state_space_run` for one state, kept in a register."""
    a00, b00, b10, c0 = ad[0, 0], b0[0], b1[0], c[0]
    x0 = x[0]
    y = np.empty(u.shape[0])
    for k in range(u.shape[0]):
        x0 = (b00 * u_previous + b10 * u[k]) + a00 * x0
        u_previous = u[k]
        y[k] = c0 * x0 + d * u_previous
    return y, np.array([x0])


@jit
def second_order_run(ad, b0, b1, c, d, u, x, u_previous):
    """Do :func:`state_space_run` for two states, kept in registers."""
    a00, a01, a10, a11 = ad[0, 0], ad[0, 1], ad[1, 0], ad[1, 1]
    b00, b01, b10, b11 = b0[0], b0[1], b1[0], b1[1]
    c0, c1 = c[0], c[1]
    x0, x1 = x[0], x[1]
    y = np.empty(u.shape[0])
    for k in range(u.shape[0]):
        force0 = b00 * u_previous + b10 * u[k]
        force1 = b01 * u_previous + b11 * u[k]
        x0, x1 = force0 + (a00 * x0 + a01 * x1), force1 + (a10 * x0 + a11 * x1)
        u_previous = u[k]
        y[k] = (c0 * x0 + c1 * x1) + d * u_previous
    return y, np.array([x0, x1])


@jit
def state_space_step(u, c, s):
    """Do one sample of :func:`state_space_run`.

    ``c`` is its matrices and the intercept, ``s`` the states, the last input, and room for the
    states.
    """
    ad, b0, b1, output, d, intercept = c
    n_states = output.size
    y = d * u
    for i in range(n_states):
        value = b0[i] * s[n_states] + b1[i] * u
        for j in range(n_states):
            value += ad[i, j] * s[j]
        s[n_states + 1 + i] = value
        y += output[i] * value
    for i in range(n_states):
        s[i] = s[n_states + 1 + i]
    s[n_states] = u
    return y + intercept


def block_table(ad, b0, b1, c, d, length):
    """Return what ``length`` samples at once do, for :func:`block_run`.

    The table (1 + length + n_states, length + n_states) takes the row vector of the last input,
    the inputs of the block and the state before it to that of the outputs and the state after.
    """
    n_states = len(b0)
    reached = np.zeros((1 + length + n_states, n_states))
    reached[1 + length :] = np.eye(n_states)
    table = np.empty((1 + length + n_states, length + n_states))
    for k in range(length):
        reached = reached @ ad.T
        reached[k] += b0
        reached[k + 1] += b1
        table[:, k] = reached @ c
        table[k + 1, k] += d
    table[:, length:] = reached
    return table


@jit
def block_run(table, u, x, u_previous):
    """Do :func:`state_space_run` block by block, for the whole blocks of ``u``.

    A step of one sample is a chain of ``n_states**2`` products; that of a block has as many and
    the outputs' in loops that are vectorised. A value that is not finite would reach the outputs
    before it in its block.
    """
    n_in, n_out = table.shape
    n_states = x.shape[0]
    length = n_out - n_states
    n_blocks = u.shape[0] // length
    y = np.empty(n_blocks * length)
    given = np.empty(n_in)
    given[0] = u_previous
    given[1 + length :] = x
    found = np.empty(n_out)
    n_fours = n_in // 4 * 4
    for block in range(n_blocks):
        first = block * length
        for i in range(length):
            given[1 + i] = u[first + i]
        for i in range(n_out):
            found[i] = 0.0
        for j in range(0, n_fours, 4):
            v0, v1, v2, v3 = given[j], given[j + 1], given[j + 2], given[j + 3]
            for i in range(n_out):
                found[i] += (table[j, i] * v0 + table[j + 1, i] * v1) + (
                    table[j + 2, i] * v2 + table[j + 3, i] * v3
                )
        for j in range(n_fours, n_in):
            v0 = given[j]
            for i in range(n_out):
                found[i] += table[j, i] * v0
        for i in range(length):
            y[first + i] = found[i]
        given[0] = given[length]
        for i in range(n_states):
            given[1 + length + i] = found[length + i]
    return y, given[1 + length :].copy()


def state_space_tangents(ad, b0, b1, c, d, dad, db0, db1, dc, dd, u, du, x, dx, u0, du0):
    """Return the output and its tangents.

    ``du`` (n, m) are tangents of the input; the arrays ``dad`` (p, n_states, n_states) to ``dd``
    (p,) are derivatives of the discrete form with respect to ``p`` parameters. ``dx``
    (n_states, m + p) are the tangents of the initial state ``x``, ``u0`` and ``du0`` (m,) the
    input and its tangents before the first sample.

    The recursion runs on ``w[k] = x[k] - B1 u[k]``, which needs one sample of the input only:
    ``w[k+1] = Ad w[k] + B u[k]``, ``y[k] = C w[k] + (D + C B1) u[k]`` with ``B = B0 + Ad B1``.
    """
    m = du.shape[1]
    b, direct = b0 + ad @ b1, d + c @ b1
    # derivatives by w and, last, by u; one column a parameter
    db = db0 + dad @ b1 + db1 @ ad.T
    by = np.concatenate([dad, db[:, :, None]], axis=2).transpose(1, 2, 0)
    output_by = np.concatenate([dc, (dd + dc @ b1 + db1 @ c)[:, None]], axis=1).T
    dw = ad @ dx
    dw[:, :m] += np.outer(b0, du0)
    dw[:, m:] += (dad @ x + db0 * u0).T
    columns = np.ascontiguousarray(by), np.ascontiguousarray(output_by)
    system = ad, b, c, float(direct), *columns, ad @ x + b0 * u0, dw, u, du
    return _second_order_tangents(*system) if len(x) == 2 else _tangent_loop((0,) * len(x), *system)


@jit
def _second_order_tangents(ad, b, c, direct, by, output_by, w_first, dw_first, u, du):
    """Do :func:`_tangent_loop` for two states, whose values at a column stay in registers."""
    n_samples, m = du.shape
    p = output_by.shape[1]
    a00, a01, a10, a11 = ad[0, 0], ad[0, 1], ad[1, 0], ad[1, 1]
    b0, b1, c0, c1 = b[0], b[1], c[0], c[1]
    # a row of each array as one of its own: the compiler sees that none is written through another
    by00, by01, by0u = by[0, 0].copy(), by[0, 1].copy(), by[0, 2].copy()
    by10, by11, by1u = by[1, 0].copy(), by[1, 1].copy(), by[1, 2].copy()
    out0, out1, outu = output_by[0].copy(), output_by[1].copy(), output_by[2].copy()
    w0, w1 = w_first[0], w_first[1]
    dw0, dw1 = dw_first[0].copy(), dw_first[1].copy()
    y = np.empty(n_samples)
    dy = np.empty((n_samples, m + p))
    for k in range(n_samples):
        u1 = u[k]
        y[k] = direct * u1 + c0 * w0 + c1 * w1
        upstream, row = du[k], dy[k]
        for q in range(m):
            v, s0, s1 = upstream[q], dw0[q], dw1[q]
            row[q] = direct * v + c0 * s0 + c1 * s1
            dw0[q] = b0 * v + a00 * s0 + a01 * s1
            dw1[q] = b1 * v + a10 * s0 + a11 * s1
        for q in range(p):
            s0, s1 = dw0[m + q], dw1[m + q]
            own = outu[q] * u1 + out0[q] * w0 + out1[q] * w1
            row[m + q] = own + (c0 * s0 + c1 * s1)
            own = by0u[q] * u1 + by00[q] * w0 + by01[q] * w1
            dw0[m + q] = own + (a00 * s0 + a01 * s1)
            own = by1u[q] * u1 + by10[q] * w0 + by11[q] * w1
            dw1[m + q] = own + (a10 * s0 + a11 * s1)
        w0, w1 = b0 * u1 + a00 * w0 + a01 * w1, b1 * u1 + a10 * w0 + a11 * w1
    return y, dy


@jit
def _tangent_loop(states, ad, b, c, direct, by, output_by, w_first, dw_first, u, du):
    """Run the recursion of :func:`state_space_tangents`; ``states`` is a tuple, one entry a state.

    The length of a tuple is known to the compiler, so all states of a column are one body of one
    loop over the columns, which is vectorised.
    """
    n_states = len(states)
    n_samples, m = du.shape
    p = output_by.shape[1]
    w = w_first.copy()
    w_new = np.empty(n_states)
    dw = dw_first.copy()
    dw_new = np.empty_like(dw)
    y = np.empty(n_samples)
    dy = np.empty((n_samples, m + p))
    for k in range(n_samples):
        u1 = u[k]
        output = direct * u1
        for i in range(n_states):
            output += c[i] * w[i]
            value = b[i] * u1
            for j in range(n_states):
                value += ad[i, j] * w[j]
            w_new[i] = value
        y[k] = output
        for q in range(m):
            v = du[k, q]
            output = direct * v
            for i in range(n_states):
                output += c[i] * dw[i, q]
                value = b[i] * v
                for j in range(n_states):
                    value += ad[i, j] * dw[j, q]
                dw_new[i, q] = value
            dy[k, q] = output
        for q in range(p):
            output = output_by[n_states, q] * u1
            for i in range(n_states):
                output += c[i] * dw[i, m + q] + output_by[i, q] * w[i]
                value = by[i, n_states, q] * u1
                for j in range(n_states):
                    value += ad[i, j] * dw[j, m + q] + by[i, j, q] * w[j]
                dw_new[i, m + q] = value
            dy[k, m + q] = output
        w, w_new = w_new, w
        dw, dw_new = dw_new, dw
    return y, dy


def refuse_open_hold(hold):
    """Refuse a hold that nothing has decided."""
    if hold not in ("foh", "zoh"):
        raise ValueError(
            f"The 'hold' must be 'foh' or 'zoh' here: records alone decide on 'auto', when the "
            f"whole model is fitted to them. Got {hold!r} instead."
        )


def discretize(a, b, dt, hold):
    """Return Ad, B0, B1 for stacked matrices ``a`` (..., n, n) and ``b`` (..., n)."""
    refuse_open_hold(hold)
    n = a.shape[-1]
    block = np.zeros((*a.shape[:-2], n + 2, n + 2), dtype=a.dtype)
    block[..., :n, :n] = a * dt
    block[..., :n, n] = b * dt
    block[..., n, n + 1] = 1.0
    e = expm(block)
    ad, g1, g2 = e[..., :n, :n], e[..., :n, n], e[..., :n, n + 1]
    return (ad, g1 - g2, g2) if hold == "foh" else (ad, g1, np.zeros_like(g1))


def complex_gain(a, b, c, d, points):
    """Return C (s - A)^-1 B + D at the complex points s (n,), (n, n_outputs, n_inputs)."""
    resolvent = points[:, None, None] * np.eye(len(a)) - a
    return c @ np.linalg.solve(resolvent, np.broadcast_to(b, (len(points), *b.shape))) + d


def _equilibrium(a, b):
    """Return the state at rest for a unit input; what never comes to rest begins at zero."""
    try:
        return -np.linalg.solve(a, b[..., None])[..., 0]
    except np.linalg.LinAlgError:  # a pole at zero
        return -(np.linalg.pinv(a) @ b[..., None])[..., 0]


class DiscretizedOperator(Operator):
    """Base of what remembers its discrete form by the interval."""

    signal_linear = True

    @cached_property
    def _memory(self):
        return {}  # discretising costs as much as a short record

    def __getstate__(self):
        return {k: v for k, v in self.__dict__.items() if k != "_memory"}


class LinearOperator(DiscretizedOperator):
    """Base of the linear operators; a subclass gives ``_matrices`` and may set ``hold``.

    ``n_poles`` is the number of real poles and of pairs; ``with_poles(rates, pairs)`` puts them:
    rates in rad/s, pairs as (natural frequency in rad/s, damping ratio).
    """

    hold = "foh"
    intercept = 0.0
    n_poles = (0, 0)

    @abstractmethod
    def with_poles(self, rates, pairs):
        """Return a copy with other poles."""

    @abstractmethod
    def _matrices(self, p):
        """Return A (n, n), B (n,), C (n,), D as analytic functions of ``p``, shaped as `pack`."""

    def state_space(self):
        """Return the continuous-time matrices A (n, n), B (n,), C (n,) and the number D."""
        a, b, c, d = self._matrices(self.pack())
        return (*(np.ascontiguousarray(np.real(part)) for part in (a, b, c)), float(np.real(d)))

    def frequency_response(self, frequency):
        """Return the complex gain at ``frequency`` (Hz), shape of ``frequency``."""
        frequency = np.asarray(frequency, dtype=float)
        a, b, c, d = self.state_space()
        gain = complex_gain(a, b[:, None], c[None], d, 2j * np.pi * frequency.ravel())
        return gain.reshape(frequency.shape)[()]

    def frequency_tangents(self, frequency):
        """Return the complex gain (n, 1) at ``frequency`` (n,) in Hz and its derivatives.

        Those by the parameters are (n, 1, n_parameters), in the order of :meth:`pack`.
        """
        a, b, c, d = self.state_space()
        da, db, dc, dd = [part.imag / _STEP for part in self._stepped()]
        s, eye = 2j * np.pi * np.asarray(frequency, dtype=float), np.eye(len(b))
        x, z = (complex_gain(m, v[:, None], eye, 0.0, s)[..., 0] for m, v in ((a, b), (a.T, c)))
        tangents = x @ dc.T + dd + z @ db.T
        for q in np.flatnonzero(np.any(da, axis=(1, 2))):
            tangents[:, q] += np.sum(z * (x @ da[q].T), axis=1)
        return (x @ c + d)[:, None], tangents[:, None, :]

    def poles(self):
        """Return the poles in rad/s, complex, shape (n_states,)."""
        return np.linalg.eigvals(self.state_space()[0])

    def _rest(self):
        """Return the state at rest for a unit input."""
        if "rest" not in self._memory:
            a, b, _, _ = self.state_space()
            self._memory["rest"] = _equilibrium(a, b)
        return self._memory["rest"]

    def _discrete(self, dt):
        """Return Ad, B0, B1, C, D."""
        if dt not in self._memory:
            a, b, c, d = self.state_space()
            self._memory[dt] = (*discretize(a, b, dt, self.hold), c, float(d))
        return self._memory[dt]

    def _stepped(self):
        """Return A, B, C, D at complex steps in each parameter, (p, ...) each."""
        values = self.pack()
        points = values + 1j * _STEP * np.eye(values.size)
        return [
            np.stack([np.asarray(part, dtype=complex) for part in parts])
            for parts in zip(*(self._matrices(point) for point in points), strict=True)
        ]

    def _discrete_tangents(self, dt):
        """Return the derivatives of the discrete form and of the state at rest, (p, ...) each."""
        if (dt, "tangents") not in self._memory:
            a, b, c, d = self._stepped()
            parts = (*discretize(a, b, dt, self.hold), c, d, _equilibrium(a, b))
            self._memory[dt, "tangents"] = [
                np.ascontiguousarray(part.imag / _STEP) for part in parts
            ]
        return self._memory[dt, "tangents"]

    def init(self, u0, initial_state="rest"):
        if initial_state == "zero":
            return np.zeros_like(self._rest()), 0.0
        return self._rest() * u0, float(u0)

    def run(self, u, dt, state=None):
        u = np.ascontiguousarray(u, dtype=float)
        x, previous = self.init(u[0]) if state is None else state
        y, x = self._advance(u, dt, x, previous)
        return y + self.intercept, (x, float(u[-1]))

    def lowered(self, dt, state):
        x, previous = state
        constants = *self._discrete(dt), self.intercept
        return LoweredStep(state_space_step, constants, [*x, previous, *x])

    def _advance(self, u, dt, x, previous):
        """Return the output without intercept and the last state, by the shortest way."""
        discrete = self._discrete(dt)
        if len(x) in (1, 2):
            run = first_order_run if len(x) == 1 else second_order_run
            return run(*discrete, u, x, previous)
        if len(x) == 0 or len(u) < _LONG or not np.isfinite(u).all():
            return state_space_run(*discrete, u, x, previous)
        if (dt, "block") not in self._memory:
            self._memory[dt, "block"] = block_table(*discrete, _BLOCK)
        y, x = block_run(self._memory[dt, "block"], u, x, previous)
        rest, x = state_space_run(*discrete, u[len(y) :], x, float(u[len(y) - 1]))
        return np.concatenate([y, rest]), x

    def linearize(self, u, du, dt, initial_state="rest"):
        y, dy = self._tangents(u, du, dt, initial_state, self._discrete_tangents(dt))
        names = [name for name, _ in self.entries()]
        if "intercept" in names:
            dy[:, du.shape[1] + names.index("intercept")] = 1.0
        return y, dy

    def carry(self, u, du, dt, initial_state="rest"):
        if du.shape[1] == 0:
            return super().carry(u, du, dt, initial_state)
        n = len(self._rest())
        none = [np.empty((0, *shape)) for shape in ((n, n), (n,), (n,), (n,), (), (n,))]
        return self._tangents(u, du, dt, initial_state, none)

    def _tangents(self, u, du, dt, initial_state, own):
        """Return the output and its tangents, those of the parameters by ``own``."""
        u = np.ascontiguousarray(u, dtype=float)
        m = du.shape[1]
        *steps, rest_steps = own
        x, u0 = self.init(u[0], initial_state)
        dx = np.zeros((len(x), m + len(rest_steps)))
        du0 = np.zeros(m)
        if initial_state == "rest":
            du0 = du[0].copy()
            dx[:, :m] = np.outer(self._rest(), du0)
            dx[:, m:] = u0 * rest_steps.T
        y, dy = state_space_tangents(
            *self._discrete(dt), *steps, u, np.ascontiguousarray(du), x, dx, u0, du0
        )
        return y + self.intercept, dy


class LinearModel(ParametricModel):
    """Base of the linear models: static gain, intercept, hold.

    Parameters
    ----------
    fit_gain, fit_intercept : bool, default=True
        Whether the gain (1 otherwise) and a constant response (0 otherwise) are fitted.
    hold : {"foh", "zoh", "auto"}, default="foh"
        Drive between samples: a straight line, or constant. "auto": the one with which the fit has
        the smaller error; the ``hold`` of ``operator_`` says which.
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "fit_gain": ["boolean"],
        "fit_intercept": ["boolean"],
        "hold": [StrOptions({"foh", "zoh", "auto"})],
    }

    def __init__(
        self,
        *,
        fit_gain=True,
        fit_intercept=True,
        hold="foh",
        initial_state="rest",
        dt=1.0,
        method="variable_projection",
    ):
        self.fit_gain = fit_gain
        self.fit_intercept = fit_intercept
        self.hold = hold
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    @property
    def _any_interval(self):
        return getattr(self, "hold", "foh") == "foh"  # a gain has none


def time_span(records):
    """Return the shortest interval and the longest record's duration, in s."""
    return min(r.dt for r in records), max(len(r.u) * r.dt for r in records)


def log_grid(low, high, per_decade):
    """Return logarithmically spaced values from ``low`` to ``high``, both included."""
    decades = max(np.log10(high / low), 0.0)
    return np.geomspace(low, high, max(int(np.ceil(per_decade * decades)) + 1, 2))
