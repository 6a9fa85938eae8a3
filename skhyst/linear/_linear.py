"""Linear operators, stepped exactly.

A linear operator is given by its continuous-time matrices ``x' = A x + B u``, ``y = C x + D u``
(+ intercept) as functions of its parameters. Between samples the input is linear (first-order hold,
"foh") or constant (zero-order hold, "zoh"); for such an input the discrete form is exact; a
band-limited one is sampled more finely, see :mod:`skhyst.operators._held_input`. With
``h`` the sampling interval,

    exp [[A h, B h, 0], [0, 0, 1], [0, 0, 0]] = [[Ad, G1, G2], [0, 1, 1], [0, 0, 1]]

gives ``x[k] = Ad x[k-1] + (G1 - G2) u[k-1] + G2 u[k]`` for the first-order hold and
``x[k] = Ad x[k-1] + G1 u[k-1]`` for the zero-order hold (Van Loan, *IEEE Transactions on Automatic
Control*, 1978). Derivatives with respect to the parameters are taken by a complex step through the
same formulas, which is exact to rounding (Al-Mohy and Higham, *Numerical Algorithms*, 2010).
"""

from abc import abstractmethod

import numpy as np
from scipy.linalg import expm
from scipy.special import factorial

from .._sklearn import StrOptions
from ..base import ParametricModel
from ..operators import (
    CompiledLaw,
    HeldInput,
    InverseLinearOperator,
    Operator,
    StartValues,
    as_signal,
    block_run,
    block_table,
    first_order_run,
    propagate,
    second_order_run,
    state_space_begin,
    state_space_run,
    state_space_step,
    state_space_tangents,
    tangent_system,
)

# norm above which `expm` scales and squares: Al-Mohy and Higham, SIAM J. Matrix Anal. Appl., 2009
_SQUARED = 4.25
_SERIES = 1.0 / factorial(np.arange(20, 1, -1))  # coefficients of (exp(z) - 1 - z) / z^2
_STEP = 1e-30  # complex step; far below rounding, far above underflow
_BLOCK = 16  # samples that are advanced at once
_LONG = 512  # number of samples above which a run in blocks saves more time than its table costs


def refuse_open_hold(hold, possible=("foh", "zoh")):
    """Refuse the hold "auto", which only a fit to records decides, and others not ``possible``."""
    if hold not in possible:
        raise ValueError(
            f"The 'hold' must be {' or '.join(map(repr, possible))} here: 'auto' is decided only "
            "when the complete model is fitted to records, and there is no sampled form for a "
            f"'bandlimited' drive. Got {hold!r} instead."
        )


def _exponentials(z):
    """Return ``exp(z)``, ``(exp(z) - 1) / z`` and ``(exp(z) - 1 - z) / z**2``, limits at zero."""
    small = abs(z) < 1.0
    inside, outside = np.where(small, z, 0.0), np.where(small, 1.0, z)
    second = np.polyval(_SERIES, inside)
    exponential = np.exp(z)
    first = np.where(small, 1.0 + inside * second, (exponential - 1.0) / outside)
    return exponential, first, np.where(small, second, (first - 1.0) / outside)


def discretize(a, b, dt, hold):
    """Return Ad, B0, B1 for stacked matrices ``a`` (..., n, n) and ``b`` (..., n)."""
    n = a.shape[-1]
    z = np.diagonal(a, axis1=-2, axis2=-1) * dt
    # `expm` is slow where it squares triangular matrices (a Python loop), and for complex ones,
    # which it takes one by one; diagonal matrices have a closed form
    slow = np.iscomplexobj(a) or np.max(abs(z), initial=0.0) > _SQUARED
    if slow and np.array_equal(z[..., None] * np.eye(n), a * dt):
        e, phi1, phi2 = _exponentials(z)
        ad, g1, g2 = e[..., None] * np.eye(n), phi1 * b * dt, phi2 * b * dt
    else:
        block = np.zeros((*a.shape[:-2], n + 2, n + 2), dtype=a.dtype)
        block[..., :n, :n] = a * dt
        block[..., :n, n] = b * dt
        block[..., n, n + 1] = 1.0
        e = expm(block)
        parts = e[..., :n, :n], e[..., :n, n], e[..., :n, n + 1]
        ad, g1, g2 = map(np.ascontiguousarray, parts)  # kernels are compiled once for each layout
    if hold == "foh":
        return ad, g1 - g2, g2
    refuse_open_hold(hold)
    return ad, g1, np.zeros_like(g1)


def complex_gain(a, b, c, d, points):
    """Return C (s - A)^-1 B + D at the complex points s (n,), (n, n_outputs, n_inputs)."""
    resolvent = points[:, None, None] * np.eye(len(a)) - a
    return c @ np.linalg.solve(resolvent, np.broadcast_to(b, (len(points), *b.shape))) + d


def decay_of(poles):
    """Return the longest time in s in which a mode of poles (rad/s) decays to 1/e."""
    slowest = np.max(np.real(poles), initial=-np.inf)
    return float(-1.0 / slowest) if slowest < 0.0 else np.inf


def _equilibrium(a, b, integrators=0):
    """Return the state at rest for a unit input; the state of an integrator is zero.

    The last states are those of the integrators: only the others have a rest.
    """
    if integrators:
        n = a.shape[-1] - integrators
        rest = _equilibrium(a[..., :n, :n], b[..., :n])
        return np.concatenate([rest, np.zeros((*rest.shape[:-1], integrators))], axis=-1)
    try:
        return -np.linalg.solve(a, b[..., None])[..., 0]
    except np.linalg.LinAlgError:  # a pole at zero
        return -(np.linalg.pinv(a) @ b[..., None])[..., 0]


class LinearOperator(HeldInput, StartValues):
    """Base of the linear operators; a subclass gives ``_matrices`` and may set ``hold``.

    ``n_poles`` is the number of real poles and of pairs; :meth:`with_poles` replaces them.

    Parameters
    ----------
    gain : float, default=1.0
        Static gain, response/drive.
    intercept : float, default=0.0
        Units of the response.
    hold : {"foh", "zoh", "bandlimited"}, default="foh"
        Input between samples: a straight line, constant, or without content above half the
        sampling rate. Fixed structure.

    Examples
    --------
    See :class:`FirstOrderLagOperator`.
    """

    signal_linear = True
    has_matrices = True
    intercept = 0.0
    n_poles = (0, 0)
    integrators = 0  # poles at zero, whose states are the last ones

    @property
    def strictly_proper(self):
        if "proper" not in self._memory:
            self._memory["proper"] = not (self.state_space()[3] or np.any(self._stepped()[3]))
        return self._memory["proper"]

    @abstractmethod
    def with_poles(self, rates, pairs):
        """Return a copy with other poles.

        Parameters
        ----------
        rates : sequence of float
            Of the real poles, rad/s.
        pairs : sequence of (float, float)
            Natural frequency, rad/s, and damping ratio of each pair.

        Returns
        -------
        LinearOperator
            As many poles of each kind as ``n_poles`` says.
        """

    @abstractmethod
    def _matrices(self, p):
        """Return A (n, n, n_points), B (n, n_points), C and D (n_points,), analytic in ``p``.

        ``p`` (n_parameters, n_points) has the values of :meth:`pack` at several points; it is
        complex where derivatives are taken by a complex step.
        """

    def state_space(self):
        """Return the continuous-time matrices A (n, n), B (n,), C (n,) and the number D."""
        if "matrices" not in self._memory:
            a, b, c, d = self._matrices(self.pack()[:, None])
            self._memory["matrices"] = a[..., 0].copy(), b[:, 0].copy(), c[:, 0].copy(), float(d[0])
        return self._memory["matrices"]

    def frequency_response(self, frequency):
        """Return the complex gain.

        Parameters
        ----------
        frequency : float or ndarray
            Hz.

        Returns
        -------
        complex or ndarray
            Shape of ``frequency``.
        """
        frequency = np.asarray(frequency, dtype=float)
        a, b, c, d = self.state_space()
        gain = complex_gain(a, b[:, None], c[None], d, 2j * np.pi * frequency.ravel())
        return gain.reshape(frequency.shape)[()]

    def frequency_tangents(self, frequency):
        """Return the complex gain and its derivatives by the parameters.

        Parameters
        ----------
        frequency : ndarray of shape (n,)
            Hz.

        Returns
        -------
        gain : ndarray of shape (n, n_inputs)
            The complex gain of each input; one for a signal.
        tangents : ndarray of shape (n, n_inputs, n_parameters)
            Derivatives in the order of :meth:`pack`.
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

    def slowest_decay(self):
        return decay_of(self.poles())

    def _rest(self):
        """Return the state at rest for a unit input."""
        if "rest" not in self._memory:
            a, b, _, _ = self.state_space()
            self._memory["rest"] = _equilibrium(a, b, self.integrators)
        return self._memory["rest"]

    def discrete(self, dt):
        """Return the discrete form, for :func:`state_space_run`.

        Parameters
        ----------
        dt : float
            Sampling interval in s.

        Returns
        -------
        Ad : ndarray of shape (n_states, n_states)
            Of the state.
        B0, B1, C : ndarray of shape (n_states,)
            Of the last and of the present input; of the output.
        D : float
            From the present input to the output.
        """
        if dt not in self._memory:
            a, b, c, d = self.state_space()
            self._memory[dt] = (*discretize(a, b, dt, self.hold), c, float(d))
        return self._memory[dt]

    def rate_row(self):
        """Return the row C A that gives the rate of the output where C B = D = 0.

        Returns
        -------
        row : ndarray of shape (n_states,)
            Of the states.
        tangents : ndarray of shape (n_parameters, n_states)
            Its derivatives, in the order of :meth:`pack`.
        """
        if "rate" not in self._memory:
            a, _, c, _ = self._stepped()
            row = np.einsum("pi,pij->pj", c, a)
            parts = row[0].real, row.imag / _STEP
            self._memory["rate"] = [np.ascontiguousarray(part) for part in parts]
        return self._memory["rate"]

    def _stepped(self):
        """Return A, B, C, D for a complex step in each parameter, (n_parameters, ...) each."""
        points = self.pack()[:, None] + 1j * _STEP * np.eye(self.n_parameters)
        a, b, c, d = self._matrices(points)
        return a.transpose(2, 0, 1), b.T, c.T, d

    def _discrete_tangents(self, dt):
        """Return the derivatives of the discrete form and of the state at rest, by parameter."""
        if (dt, "tangents") not in self._memory:
            a, b, c, d = self._stepped()
            by = [np.ascontiguousarray(part.imag / _STEP) for part in (a, b, b, c, d, b)]
            # parameters that change A or B; the others enter the output equation only
            moves = by[0].any(axis=(1, 2)) | by[1].any(axis=1)
            if moves.any():
                a, b = a[moves], b[moves]
                parts = *discretize(a, b, dt, self.hold), _equilibrium(a, b, self.integrators)
                for position, part in zip((0, 1, 2, 5), parts, strict=True):
                    by[position][moves] = part.imag / _STEP
            self._memory[dt, "tangents"] = by
        return self._memory[dt, "tangents"]

    def inverse(self):
        """Return the operator from the response to the drive; it is not causal.

        Raises
        ------
        ValueError
            If there are integrators.
        """
        self._require("integrators", not self.integrators, "be 0 to have an inverse from a rest")
        return InverseLinearOperator(self)

    @property
    def n_start(self):
        """Number of states if there are integrators, which have no rest; else 0."""
        return len(self._rest()) if self.integrators else 0

    def init(self, u0, initial_state="rest"):
        if not isinstance(initial_state, str):  # the states at the first sample
            return np.array(initial_state, dtype=float), None
        if initial_state == "zero":  # a ramp from zero would lead to the first sample
            begun = self.hold == "zoh" and not self.integrators
            return np.zeros_like(self._rest()), 0.0 if begun else None
        # an integrator continues from its value at the first sample
        return self._rest() * u0, None if self.integrators else float(u0)

    def by_start(self, u, dt, start):
        ad, _, _, c, _ = self.discrete(dt)
        dy, row = np.empty((len(u), len(c))), c
        for k in range(len(u)):
            dy[k] = row
            row = row @ ad
        return dy

    def starts(self, u, y, dt):
        return [self._rest() * u[0]]

    def run(self, u, dt, state=None):
        u = as_signal(u)
        x, previous = self.init(u[0]) if state is None else state
        if previous is None:
            _, _, _, c, d = self.discrete(dt)
            first = c @ x + d * u[0]
            y, x = self._advance(u[1:], dt, x, float(u[0]))
            y = np.append(first, y)
        else:
            y, x = self._advance(u, dt, x, previous)
        return y + self.intercept, (x, float(u[-1]))

    def compiled_step(self, dt, state):
        x, previous = state
        constants = *self.discrete(dt), self.intercept
        if self.hold == "foh" or self.integrators:
            begun = previous is not None
            state = [*x, previous if begun else 0.0, *x, float(begun)]
            return CompiledLaw(state_space_begin, constants, state)
        return CompiledLaw(state_space_step, constants, [*x, previous, *x])

    def _advance(self, u, dt, x, previous):
        """Return the output without intercept and the last state, by the fastest kernel."""
        discrete = self.discrete(dt)
        if len(x) in (1, 2):
            run = first_order_run if len(x) == 1 else second_order_run
            return run(*discrete, u, x, previous)
        # in a block a value that is not finite would reach earlier outputs
        if len(x) == 0 or len(u) < _LONG or not np.isfinite(u).all():
            return state_space_run(*discrete, u, x, previous)
        if (dt, "block") not in self._memory:
            self._memory[dt, "block"] = block_table(*discrete, _BLOCK)
        y, x = block_run(self._memory[dt, "block"], u, x, previous)
        rest, x = state_space_run(*discrete, u[len(y) :], x, float(u[len(y) - 1]))
        return np.concatenate([y, rest]), x

    def sensitivities(self, u, du, dt, initial_state="rest"):
        y, dy = self._tangents(u, du, dt, initial_state, by_parameters=True)
        at = du.shape[1]
        for name, size in self._sizes.items():
            if name == "intercept":
                dy[:, at] = 1.0
            at += size
        return y, dy

    def _tangents(self, u, du, dt, initial_state, by_parameters):
        """Return the output and its tangents: of the input, then, if asked for, by parameters."""
        begins_at_rest = isinstance(initial_state, str) and initial_state == "rest"
        key = dt, begins_at_rest, by_parameters
        if key not in self._memory:
            self._memory[key] = self._tangent_system(*key)
        system = self._memory[key]
        start = np.zeros(len(system[0]))
        if not isinstance(initial_state, str):  # the states at the first sample
            start = np.array(initial_state, dtype=float)
        y, dy = state_space_tangents(system, start, as_signal(u), as_signal(du))
        return y + self.intercept, dy

    def _tangent_system(self, dt, begins_at_rest, by_parameters):
        """Return what the tangents of every input have in common."""
        discrete = self.discrete(dt)
        n = len(discrete[0])
        shapes = (n, n), (n,), (n,), (n,), (), (n,)
        if by_parameters:
            *by, rest_by = self._discrete_tangents(dt)
        else:
            *by, rest_by = (np.empty((0, *shape)) for shape in shapes)
        # otherwise the state at the first sample is zero, or given (B1 is zero for "zoh")
        rest = self._rest() if begins_at_rest else np.zeros(n)
        rest_by = rest_by if begins_at_rest else np.zeros_like(rest_by)
        return tangent_system(discrete, by, rest, rest_by, begins_at_rest and not self.integrators)


@propagate.register
def _(operator: LinearOperator, u, du, dt, initial_state="rest"):
    if du.shape[1] == 0 or not operator.causal:
        return propagate.dispatch(Operator)(operator, u, du, dt, initial_state)
    return operator._tangents(u, du, dt, initial_state, by_parameters=False)


class LinearModel(ParametricModel):
    """Base of the linear models: static gain, intercept, hold.

    Parameters
    ----------
    fit_gain, fit_intercept : bool, default=True
        Whether the gain (1 otherwise) and a constant response (0 otherwise) are fitted.
    hold : {"foh", "zoh", "bandlimited", "auto"}, default="foh"
        Drive between samples: linear, constant, or without content above half the sampling rate,
        as a drive that was recorded behind an anti-aliasing filter; a model of such a drive looks
        ahead, and is neither stepped nor inverted. "auto": linear or constant, with which the fit
        has the smaller error, which is then the ``hold`` of ``operator_``.
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "fit_gain": ["boolean"],
        "fit_intercept": ["boolean"],
        "hold": [StrOptions({"foh", "zoh", "bandlimited", "auto"})],
    }

    def __init__(
        self,
        *,
        fit_gain=True,
        fit_intercept=True,
        hold="foh",
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        self.fit_gain = fit_gain
        self.fit_intercept = fit_intercept
        self.hold = hold
        self.initial_state = initial_state
        self.dt = dt
        self.drive = drive
        self.method = method

    @property
    def any_interval(self):
        """Whether the response to a straight drive is the same at any sampling interval."""
        return getattr(self, "hold", "foh") == "foh"  # Gain has no hold


def time_span(records):
    """Return the shortest interval and the longest record's duration, in s."""
    return min(r.dt for r in records), max(len(r.u) * r.dt for r in records)


def log_grid(low, high, per_decade):
    """Return logarithmically spaced values from ``low`` to ``high``, both included."""
    decades = max(np.log10(high / low), 0.0)
    return np.geomspace(low, high, max(int(np.ceil(per_decade * decades)) + 1, 2))
