r"""Common modes of several inputs and responses, with memoryless curves in the feedback.

.. math::

    x_{k+1} = A x_k + B u_k + E w_k, \quad y_k = C x_k + D u_k + c, \quad
    w_k = \tanh(F x_k + G u_k + b) - \tanh b

Each loop has a signal, a row of F and G, and acts on the states by a column of E. Sums of such
functions approximate any static function of the states and inputs (Cybenko, *Mathematics of
Control, Signals, and Systems*, 1989). The loops act with a delay of one sample, so that they are
explicit. The poles of A are in blocks on its diagonal; tangents of the states by all parameters but
C, D and c run along with them, and of these only the Gram matrix is kept.
"""

import math
import warnings
from dataclasses import dataclass, replace
from numbers import Integral
from typing import Self

import numpy as np
from scipy.linalg import block_diag
from sklearn.utils import check_random_state

from .._jit import jit
from .._sklearn import Interval, fit_context
from ..base import one_thread
from ..exceptions import ConvergenceWarning
from ..linear import ModalModel, SampledStateSpace, SampledSystem
from ..noise import whiteness_p_value
from ..operators import CompiledLaw
from ..optimize import LEVEL, NOISELESS, variable_projection

_CHUNK = 512  # samples whose tangents are in memory at once
_TRIALS = 50  # most steps of Newton's method for the state at rest
_SINGULAR = 1e-10  # eigenvalue of a direction that is not determined, relative to the largest
_DETERMINED = 1e-6  # largest entry in such a direction of an unknown that is


@jit
def _move(u, c, s):
    """Advance the states, the first of ``s``, by a sample; the rest of ``s`` is workspace.

    ``c`` begins with A, B, E, F, G and the bias.
    """
    a, b, e, f, g, bias = c[:6]
    n, m, r = a.shape[0], b.shape[1], bias.size
    for i in range(r):
        total = bias[i]
        for j in range(n):
            total += f[i, j] * s[j]
        for j in range(m):
            total += g[i, j] * u[j]
        s[2 * n + i] = math.tanh(total) - math.tanh(bias[i])
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += a[i, j] * s[j]
        for j in range(m):
            total += b[i, j] * u[j]
        for j in range(r):
            total += e[i, j] * s[2 * n + j]
        s[n + i] = total
    for i in range(n):
        s[i] = s[n + i]


@jit
def _advance(c, u, s, y):
    """Write the responses (n_samples, n_outputs) to ``y``; ``s`` is that of :func:`_move`."""
    output, direct, intercept = c[6:]
    for k in range(len(u)):
        for i in range(intercept.size):
            total = intercept[i]
            for j in range(output.shape[1]):
                total += output[i, j] * s[j]
            for j in range(direct.shape[1]):
                total += direct[i, j] * u[k, j]
            y[k, i] = total
        _move(u[k], c, s)


@jit
def modal_feedback_step(u, c, s):
    """Return the single response; ``c`` and ``s`` are those of :func:`_move`."""
    output, direct, intercept = c[6:]
    y = intercept
    for j in range(output.size):
        y += output[j] * s[j]
    for j in range(direct.size):
        y += direct[j] * u[j]
    _move(u, c, s)
    return y


@jit
def _tangents(a, n_real, b, e, f, g, bias, c, u, x, dx, dy):
    """Write the tangents (n_samples, n_outputs, p + n_linear); advance ``x`` and ``dx``.

    The first p columns are by the entries of A, of B, E, F, G by rows, and the bias; the others,
    for each response, by its rows of C and D and its intercept, in which it is linear. A real pole
    has one entry in A, a pair two: real and imaginary part.
    """
    n, m, r, p = x.size, u.shape[1], bias.size, dx.shape[1]
    at_e = n + n * m
    at_f = at_e + n * r
    at_g = at_f + r * n
    new, dnew, w, dw = np.empty(n), np.empty_like(dx), np.empty(r), np.empty((r, p))
    for k in range(len(u)):
        # the responses, linear in the states
        for i in range(len(c)):
            row, at_response = dy[k, i], p + i * (n + m + 1)
            row[:] = 0.0
            for j in range(n):
                row[at_response + j] = x[j]
                for q in range(p):
                    row[q] += c[i, j] * dx[j, q]
            for j in range(m):
                row[at_response + n + j] = u[k, j]
            row[at_response + n + m] = 1.0
        # the loops: F and G act through the signal, the bias also through tanh(b)
        for i in range(r):
            total = bias[i]
            row = dw[i]
            row[:] = 0.0
            for j in range(n):
                total += f[i, j] * x[j]
                for q in range(p):
                    row[q] += f[i, j] * dx[j, q]
                row[at_f + i * n + j] += x[j]
            for j in range(m):
                total += g[i, j] * u[k, j]
                row[at_g + i * m + j] += u[k, j]
            value, value_at_zero = math.tanh(total), math.tanh(bias[i])
            w[i] = value - value_at_zero
            row *= 1.0 - value**2
            row[p - r + i] += value_at_zero**2 - value**2
        # the next states; A has a block for each pole, or pair, on its diagonal
        for i in range(n):
            row, total = dnew[i], 0.0
            row[:] = 0.0
            first = i if i < n_real else n_real + (i - n_real) // 2 * 2
            last = i + 1 if i < n_real else first + 2
            for j in range(first, last):
                total += a[i, j] * x[j]
                for q in range(p):
                    row[q] += a[i, j] * dx[j, q]
            if i < n_real:
                row[i] += x[i]
            else:
                row[first] += x[i]
                row[first + 1] += x[i + 1] if i == first else -x[i - 1]
            for j in range(m):
                total += b[i, j] * u[k, j]
                row[n + i * m + j] += u[k, j]
            for j in range(r):
                total += e[i, j] * w[j]
                for q in range(p):
                    row[q] += e[i, j] * dw[j, q]
                row[at_e + i * r + j] += w[j]
            new[i] = total
        x[:] = new
        dx[:] = dnew


@dataclass(frozen=True)
class SampledFeedback(SampledSystem):
    """Sampled state space with loops: see :class:`ModalFeedback`. Its state is (n_states,).

    Parameters
    ----------
    linear : SampledStateSpace
        Without the loops.
    e : ndarray of shape (n_states, n_loops)
        From the loops to the next state.
    f : ndarray of shape (n_loops, n_states)
        From the state to the signals of the loops.
    g : ndarray of shape (n_loops, n_inputs)
        From the inputs to these signals.
    bias : ndarray of shape (n_loops,)
        Signals at a state of zero.

    See Also
    --------
    ModalFeedback : Identifies one.
    skhyst.linear.SampledStateSpace : Without loops.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.compose import SampledFeedback
    >>> from skhyst.linear import SampledStateSpace
    >>> one = np.ones((1, 1))
    >>> linear = SampledStateSpace(0.5 * one, one, one, 0.0 * one, 0.1, np.zeros(1))
    >>> loop = SampledFeedback(linear, -0.2 * one, one, 0.0 * one, np.zeros(1))
    >>> loop.run([[0.0], [1.0], [1.0]], dt=0.1)[0].ravel()
    array([0., 0., 1.])
    """

    signal_linear = False

    linear: SampledStateSpace
    e: np.ndarray
    f: np.ndarray
    g: np.ndarray
    bias: np.ndarray

    @property
    def dt(self):
        """Sampling interval in s."""
        return self.linear.dt

    @property
    def intercept(self):
        """Constant of each response."""
        return self.linear.intercept

    def _arrays(self):
        linear = self.linear
        arrays = (
            linear.a,
            linear.b,
            self.e,
            self.f,
            self.g,
            self.bias,
            linear.c,
            linear.d,
            linear.intercept,
        )
        return tuple(np.ascontiguousarray(array, dtype=float) for array in arrays)

    def init(self, u0, initial_state="rest"):
        u0 = np.asarray(u0, dtype=float)
        if initial_state == "zero":
            return np.zeros(len(self.linear.a))
        x = self.linear.init(u0)[0]
        for _ in range(_TRIALS):
            z = self.f @ x + self.g @ u0 + self.bias
            moved = self.linear.a @ x + self.linear.b @ u0
            residual = moved + self.e @ (np.tanh(z) - np.tanh(self.bias)) - x
            step = np.linalg.solve(np.eye(len(x)) - self.slope(z), residual)
            x = x + step
            if np.abs(step).max(initial=0.0) <= 1e-13 * np.abs(x).max(initial=0.0):
                break
        return x

    def slope(self, z):
        """Return the derivative of the next state by the state.

        Parameters
        ----------
        z : ndarray of shape (n_loops,)
            Signals of the loops.

        Returns
        -------
        ndarray of shape (n_states, n_states)
            Matrix of the linearised loop.
        """
        return self.linear.a + (self.e * (1.0 - np.tanh(z) ** 2)) @ self.f

    def poles_at(self, u0):
        """Return the poles of small motions about the rest, in the z-plane.

        Parameters
        ----------
        u0 : array-like of shape (n_inputs,)
            Inputs at rest.

        Returns
        -------
        ndarray of shape (n_states,), complex
            Inside the unit circle where the rest is stable.
        """
        x, u0 = self.init(u0), np.asarray(u0, dtype=float)
        return np.linalg.eigvals(self.slope(self.f @ x + self.g @ u0 + self.bias))

    def run(self, u, dt, state=None):
        self.refuse_other(dt)
        u = np.ascontiguousarray(u, dtype=float)
        x = self.init(u[0]) if state is None else state
        s, y = self._with_workspace(x), np.empty((len(u), len(self.linear.c)))
        _advance(self._arrays(), u, s, y)
        return y, s[: len(x)]

    def _with_workspace(self, x):
        return np.concatenate([x, np.zeros(len(x) + len(self.bias))])

    def compiled_step(self, dt, state):
        self.refuse_several()
        self.refuse_other(dt)
        *loops, c, d, intercept = self._arrays()
        constants = *loops, c[0], d[0], float(intercept[0])
        s = list(self._with_workspace(state))
        return CompiledLaw(modal_feedback_step, constants, s, n_inputs=self.linear.b.shape[1])


def _in_blocks(linear):
    """Return a system with the poles in blocks on the diagonal of A, first the real ones."""
    poles, vectors = np.linalg.eig(linear.a)
    real, upper = np.flatnonzero(poles.imag == 0.0), np.flatnonzero(poles.imag > 0.0)
    basis, blocks = [vectors[:, real].real], [*poles[real].real]
    for i in upper:
        basis.append(np.column_stack([vectors[:, i].real, vectors[:, i].imag]))
        blocks.append([[poles[i].real, poles[i].imag], [-poles[i].imag, poles[i].real]])
    basis = np.concatenate(basis, axis=1)
    b, c = np.linalg.solve(basis, linear.b), linear.c @ basis
    return replace(linear, a=block_diag(*blocks), b=b, c=c)


def _in_units(linear, inputs, outputs):
    """Return a system in other units, of which ``inputs`` and ``outputs`` are the former."""
    return replace(
        linear,
        b=linear.b / inputs,
        c=np.ascontiguousarray(linear.c * outputs[:, None]),
        d=linear.d * outputs[:, None] / inputs,
        intercept=linear.intercept * outputs,
    )


class _Problem:
    """Least squares of the free run, with the interface that the solver needs.

    The linear part of ``start`` is one of :func:`_in_blocks`.
    """

    def __init__(self, records, start, washout):
        self.records, self.washout, self.dt = records, washout, start.dt
        a, b, e, f, g, bias, c, d, intercept = start._arrays()
        self.n_real = len(a) - 2 * np.count_nonzero(np.diag(a, 1))
        entries = np.diag(a).copy()
        entries[self.n_real + 1 :: 2] = np.diag(a, 1)[self.n_real :: 2]
        self.shapes = b.shape, e.shape, f.shape, g.shape, bias.shape
        output_rows = np.column_stack([c, d, intercept])
        self.x0 = np.concatenate([*map(np.ravel, (entries, b, e, f, g, bias, output_rows))])
        self.n_dynamic = len(self.x0) - output_rows.size
        self.lower, self.upper = np.full(len(self.x0), -np.inf), np.full(len(self.x0), np.inf)
        self.log = np.zeros(len(self.x0), dtype=bool)
        self.linear = np.arange(len(self.x0)) >= self.n_dynamic
        self.scale = float(sum(np.sum(y[washout:] ** 2) for _, y in records))

    def operator(self, x):
        """Return the operator of values."""
        (n, m), *_ = self.shapes
        a, k = np.diag(np.r_[x[: self.n_real], np.repeat(x[self.n_real : n : 2], 2)]), n
        first = np.arange(self.n_real, n, 2)
        a[first, first + 1], a[first + 1, first] = x[first + 1], -x[first + 1]
        parts = []
        for shape in self.shapes:
            size = int(np.prod(shape))
            parts.append(x[k : k + size].reshape(shape))
            k += size
        output_rows = x[k:].reshape(-1, n + m + 1)
        c, d, intercept = output_rows[:, :n], output_rows[:, n:-1], output_rows[:, -1].copy()
        linear = SampledStateSpace(a, parts[0], c, d, self.dt, intercept)
        return SampledFeedback(linear, *parts[1:])

    def tangents(self, operator, u, x, dx):
        """Return responses and their tangents; advance the state and its tangents."""
        dy = np.empty((len(u), len(operator.linear.c), len(self.x0)))
        *dynamic, output, _, _ = operator._arrays()
        _tangents(dynamic[0], self.n_real, *dynamic[1:], output, u, x.copy(), dx, dy)
        y, x[:] = operator.run(u, self.dt, x)
        return y, dy

    def begun(self, operator, u0):
        """Return the state at rest and its tangents."""
        x, dx = operator.init(u0), np.zeros((self.shapes[0][0], self.n_dynamic))
        # the next state by the parameters at a fixed state; at rest both states are the same
        self.tangents(operator, u0[None], x.copy(), dx)
        slope = operator.slope(operator.f @ x + operator.g @ u0 + operator.bias)
        return x, np.linalg.solve(np.eye(len(x)) - slope, dx)

    def evaluate(self, x, *, select=None):
        """Return the Gram matrix of ``[J, r]``."""
        operator, gram = self.operator(x), np.zeros((len(x) + 1,) * 2)
        with np.errstate(over="ignore", invalid="ignore"):
            for u, y in self.records:
                state, dx = self.begun(operator, u[0])
                for begin in range(0, len(u), _CHUNK):
                    rows = slice(begin, min(begin + _CHUNK, len(u)))
                    run, dy = self.tangents(operator, u[rows], state, dx)
                    kept = slice(max(self.washout - begin, 0), None)
                    residual = (run - y[rows])[kept].reshape(-1, 1)
                    columns = np.hstack([dy[kept].reshape(len(residual), len(x)), residual])
                    gram += columns.T @ columns
        return gram

    def total(self, blocks, select=None):
        """Return the Gram matrix."""
        return blocks

    def residuals(self, x):
        """Return the residual of each record, without the samples that are not scored."""
        operator = self.operator(x)
        return [(y - operator.run(u, self.dt)[0])[self.washout :] for u, y in self.records]

    def is_noise(self, solution):
        """Whether the residual is white at the level ``LEVEL``, or rounding."""
        if solution.cost <= NOISELESS * self.scale:
            return True
        series = [column for residual in self.residuals(solution.x) for column in residual.T]
        return whiteness_p_value(series) >= LEVEL

    def covariance(self, solution):
        """Return the covariance of the unknowns, and which of them the data determine.

        It assumes that the residual is white. The states of a block can be scaled and turned, which
        B, C, E and F exchange among each other: those directions are left out.
        """
        hessian = solution.gram[:-1, :-1]
        scale = np.sqrt(np.maximum(np.diag(hessian), np.finfo(float).tiny))
        values, vectors = np.linalg.eigh(hessian / np.outer(scale, scale))
        known = values > _SINGULAR * values[-1]
        n_rows = sum(max(len(y) - self.washout, 0) for _, y in self.records) * len(
            self.records[0][1].T
        )
        variance = solution.cost / max(n_rows - known.sum(), 1)
        root = vectors[:, known] / np.sqrt(values[known]) / scale[:, None]
        determined = np.abs(vectors[:, ~known]).max(axis=1, initial=0.0) < _DETERMINED
        return variance * root @ root.T, determined

    def pole_slopes(self, x, u0):
        """Return the poles of small motions about the rest at ``u0``, and their derivatives by x.

        The poles (n,) are in the z-plane. With its left and right vectors w and v, the derivative
        of an eigenvalue of M is ``w dM v / (w v)``.
        """
        operator, ((n, m), (_, n_loops), *_) = self.operator(x), self.shapes
        state, dstate = self.begun(operator, u0)
        e, f = operator.e, operator.f
        w = np.tanh(f @ state + operator.g @ u0 + operator.bias)
        poles, right = np.linalg.eig(operator.slope(f @ state + operator.g @ u0 + operator.bias))
        left = np.linalg.inv(right)
        by = np.zeros((n, len(x)), dtype=complex)
        # A, whose pairs have a real and an imaginary part
        for i in range(self.n_real):
            by[:, i] = left[:, i] * right[i]
        for i in range(self.n_real, n, 2):
            j = i + 1
            by[:, i] = left[:, i] * right[i] + left[:, j] * right[j]
            by[:, j] = left[:, i] * right[j] - left[:, j] * right[i]
        # E and F at a constant slope of the loops
        at_e = n + n * m
        at_f = at_e + n * n_loops
        at_g = at_f + n_loops * n
        slope, sensed, sent = 1.0 - w**2, f @ right, left @ e
        to_e = left[:, :, None] * (slope[:, None] * sensed).T[:, None, :]
        to_f = (sent * slope)[:, :, None] * right.T[:, None, :]
        by[:, at_e:at_f], by[:, at_f:at_g] = to_e.reshape(n, -1), to_f.reshape(n, -1)
        # the slopes of the loops, which depend on their signals at rest
        dsignal = np.zeros((n_loops, len(x)))
        dsignal[:, : self.n_dynamic] = f @ dstate
        for i in range(n_loops):
            dsignal[i, at_f + i * n : at_f + (i + 1) * n] += state
            dsignal[i, at_g + i * m : at_g + (i + 1) * m] += u0
            dsignal[i, self.n_dynamic - n_loops + i] += 1.0
        by += (sent * sensed.T) @ (-2.0 * (w * slope)[:, None] * dsignal)
        return poles, by


class ModalFeedback(ModalModel):
    r"""Common modes of several inputs and responses, with static nonlinear feedback.

    .. math::

        x_{k+1} = A x_k + B u_k + E w_k, \qquad y_k = C x_k + D u_k + c

    with one saturating curve per loop, :math:`w = \tanh(F x_k + G u_k + b) - \tanh b`. Loops act on
    all modes, and sums of them approximate any static function of states and inputs [1]_: a
    resonance that moves with the amplitude at all points of a structure, for instance. It is a
    nonlinear linear-fractional model (NL-LFR [2]_) in discrete time.

    The start is :class:`~skhyst.linear.ModalModel`, the best linear approximation; each loop senses
    a response. All parameters are then refined jointly on the free run by least squares with exact
    derivatives. Until the residual is white, further starts are tried whose loops sense random
    combinations of states and inputs, each with a standard deviation of 1 about a random point of
    the same distribution; the best fit is kept.

    Parameters
    ----------
    n_poles : int, default=4
        Number of states.
    n_loops : int, default=1
        Number of curves in the feedback.
    n_random_starts : int, default=12
        Most of these further starts.
    washout : int, default=0
        Samples at the start of each record that are not scored: those of an unknown initial state.
    fit_intercept : bool, default=True
        As of :class:`~skhyst.linear.ModalModel`, for the start.
    transient_periods : int, default=1
        As of :class:`~skhyst.linear.ModalModel`, for the start.
    initial_state : {"rest", "zero"}, default="rest"
        State before each record's first sample in :meth:`predict`; in ``fit`` it is rest.
    tolerance : float, default=1e-6
        Relative change of the sum of squares at which the least-squares fit stops.
    max_evaluations : int, default=60
        Largest number of evaluations of each fit.
    dt : float or None, default=None
        Sampling interval in s of data without a time index.
    random_state : int, RandomState instance or None, default=0
        Of the random starts.

    Attributes
    ----------
    operator_ : SampledFeedback
        ``linear``, ``e``, ``f``, ``g``, ``bias``; ``init``, ``step``, ``run`` and ``poles_at``.
    poles_ : ndarray of shape (n_poles,), complex
        rad/s, of small motions about the rest at the mean inputs.
    params_, params_std_ : dict of str to float
        Values and standard errors of the parameters that do not depend on the choice of states:
        ``"bias[i]"`` and ``"g[i,j]"`` (one over the units of the input) of loop i, ``"d[k,j]"`` and
        ``"intercept[k]"`` of response k. Standard errors, those of the poles too, assume that the
        residual is white; NaN: not determined.
    covariance_ : ndarray of shape (n_unknowns, n_unknowns)
        Of the unknowns of the fit: entries of A, then of B, E, F, G by rows, the bias, and for each
        response its rows of C and D and its intercept.
    noise_std_ : ndarray of shape (n_outputs,)
        Standard deviation of the residual, units of the responses.
    n_evaluations_ : int
    fit_error_ : float
        Root mean square of the residual, relative to the standard deviation of each response.

    Warns
    -----
    ConvergenceWarning
        If the budget does not suffice, or a rest within the range of the inputs is unstable.
    ExtrapolationWarning
        In ``predict``, if an input leaves its range in the fit.

    See Also
    --------
    Feedback : One input and response, in continuous time, with any curve.

    References
    ----------
    .. [1] Cybenko, *Mathematics of Control, Signals, and Systems*, 1989.
    .. [2] Schoukens and Tóth, *IFAC-PapersOnLine*, 2020.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.compose import ModalFeedback, SampledFeedback
    >>> from skhyst.linear import ModalModel
    >>> X = np.random.default_rng(0).normal(size=(300, 1))
    >>> y = np.zeros((300, 1))
    >>> for k in range(299):
    ...     y[k + 1] = 0.5 * y[k] + X[k] - 0.4 * np.tanh(y[k])
    >>> linear = ModalModel(1, dt=0.1).fit(X, y)
    >>> model = ModalFeedback(1, n_loops=1, dt=0.1).fit(X, y)
    >>> bool(np.std(y - model.predict(X)) < 0.2 * np.std(y - linear.predict(X)))
    True
    """

    _parameter_constraints = {
        **ModalModel._parameter_constraints,
        "n_loops": [Interval(Integral, 1, None, closed="left")],
        "n_random_starts": [Interval(Integral, 0, None, closed="left")],
        "random_state": ["random_state"],
        "washout": [Interval(Integral, 0, None, closed="left")],
    }

    def __init__(
        self,
        n_poles=4,
        *,
        n_loops=1,
        n_random_starts=12,
        washout=0,
        fit_intercept=True,
        transient_periods=1,
        initial_state="rest",
        tolerance=1e-6,
        max_evaluations=60,
        dt=None,
        random_state=0,
    ):
        super().__init__(
            n_poles,
            fit_intercept=fit_intercept,
            transient_periods=transient_periods,
            initial_state=initial_state,
            tolerance=tolerance,
            max_evaluations=max_evaluations,
            dt=dt,
        )
        self.n_loops = n_loops
        self.n_random_starts = n_random_starts
        self.washout = washout
        self.random_state = random_state

    @fit_context(prefer_skip_nested_validation=True)
    def fit(self, X, y) -> Self:
        slices, array, response = self._read(X, y)
        self._warn_unless_converged(self._fit_linear(slices, array, response), "ModalModel")
        sizes = [np.where(std > 0.0, std, 1.0) for std in (array.std(axis=0), response.std(axis=0))]
        scaled = _in_blocks(_in_units(self.operator_, 1.0 / sizes[0], 1.0 / sizes[1]))
        records = [(array[s.rows] / sizes[0], response[s.rows] / sizes[1]) for s in slices]
        limits = {"tolerance": self.tolerance, "max_evaluations": self.max_evaluations}
        problem = solution = None
        with one_thread():
            for start in self._starts(scaled, records, response.mean(axis=0) / sizes[1]):
                other = _Problem(records, start, self.washout)
                found = variable_projection(other, other.x0, **limits)
                self.n_evaluations_ += found.n_evaluations
                if solution is None or found.cost < solution.cost:
                    problem, solution = other, found
                    if problem.is_noise(solution):
                        break
        self.n_iter_ = self.n_evaluations_
        self._warn_unless_converged(solution, "ModalFeedback")
        residuals = np.vstack(problem.residuals(solution.x))
        self.fit_error_ = float(np.sqrt(np.mean(np.square(residuals)))) if len(residuals) else 0.0
        covariance, determined = problem.covariance(solution)

        def in_units(operator):
            return replace(
                operator, linear=_in_units(operator.linear, *sizes), g=operator.g / sizes[0]
            )

        self.operator_ = in_units(problem.operator(solution.x))
        # the units of X and y, relative to those of the fit, of each unknown
        units = _Problem([], in_units(problem.operator(np.ones(len(covariance)))), 0).x0
        self.covariance_ = units[:, None] * covariance * units
        rank = np.linalg.matrix_rank(covariance, hermitian=True)
        freedom = max(1.0 - rank / max(residuals.size, 1), np.finfo(float).eps)
        power = np.sum(np.square(residuals), axis=0) / max(len(residuals), 1)
        self.noise_std_ = sizes[1] * np.sqrt(power / freedom)
        problem = _Problem([], self.operator_, 0)
        poles, by = problem.pole_slopes(problem.x0, array.mean(axis=0))
        with np.errstate(divide="ignore", invalid="ignore"):
            by = np.where(np.abs(by) > 0.0, by / (poles[:, None] * self.operator_.dt), 0.0)
            poles = np.log(poles.astype(complex)) / self.operator_.dt
            self._set_modes(poles, by, self.covariance_)
        std = np.where(determined, np.sqrt(np.diag(self.covariance_)), np.nan)
        self._set_parameters(problem.operator(std))
        self._judge_rests(array)
        return self

    def _set_parameters(self, spread):
        """Store the parameters that do not depend on the choice of states, and their errors.

        ``spread`` is an operator with the standard errors in place of the parameters.
        """
        self.params_, self.params_std_ = {}, {}
        for name in ("bias", "g", "d", "intercept"):
            value, std = (
                getattr(found.linear if name == "d" else found, name)
                for found in (self.operator_, spread)
            )
            for at in np.ndindex(value.shape):
                key = f"{name}[{','.join(map(str, at))}]"
                self.params_[key], self.params_std_[key] = float(value[at]), float(std[at])

    def _variance(self, u):
        """Return the variance of the free run by the errors of the parameters."""
        problem, parts = _Problem([], self.operator_, 0), []
        state, dx = problem.begun(self.operator_, u[0])
        if self.initial_state == "zero":
            state[:], dx[:] = 0.0, 0.0
        for begin in range(0, len(u), _CHUNK):
            _, dy = problem.tangents(self.operator_, u[begin : begin + _CHUNK], state, dx)
            parts.append(np.sum((dy @ self.covariance_) * dy, axis=2))
        return np.concatenate(parts)

    def _state(self, x, u0):
        return x

    def _starts(self, linear, records, mean):
        """Yield loops of zero effect.

        First those that sense a response each, relative to its mean. With more loops than
        responses, further ones sense a response relative to a standard deviation above its mean,
        then below it, then two above, and so on. Then those that sense random combinations of
        states and inputs, of the linear model.
        """
        repetition, sensed = np.divmod(np.arange(self.n_loops), len(mean))
        distance = (repetition + 1) // 2 * np.where(repetition % 2, 1.0, -1.0)
        bias = (linear.intercept - mean)[sensed] - distance
        n = len(linear.a)
        e = np.zeros((n, self.n_loops))
        yield SampledFeedback(linear, e, linear.c[sensed], linear.d[sensed], bias)
        rng = check_random_state(self.random_state)
        to_states = replace(linear, c=np.eye(n), d=np.zeros_like(linear.b), intercept=np.zeros(n))
        signals = np.vstack([np.hstack([to_states.run(u, linear.dt)[0], u]) for u, _ in records])
        center = signals.mean(axis=0)
        _, size, directions = np.linalg.svd(signals - center, full_matrices=False)
        kept = size > size[0] * max(signals.shape) * np.finfo(float).eps
        to_white = directions[kept] / size[kept, None] * np.sqrt(len(signals))
        for _ in range(self.n_random_starts):
            weights = rng.normal(size=(self.n_loops, kept.sum()))
            rows = weights / np.linalg.norm(weights, axis=1, keepdims=True) @ to_white
            bias = rng.normal(size=self.n_loops) - rows @ center
            yield SampledFeedback(linear, e, rows[:, :n], rows[:, n:], bias)

    def _judge_rests(self, array):
        """Warn of rests that are unstable."""
        rests = [array.mean(axis=0), array.min(axis=0), array.max(axis=0)]
        if max(np.abs(self.operator_.poles_at(u0)).max() for u0 in rests) >= 1.0:
            warnings.warn(
                "ModalFeedback is not stable at rest at the lowest, mean or highest inputs: a free "
                "run leaves it.",
                ConvergenceWarning,
                stacklevel=3,
            )
