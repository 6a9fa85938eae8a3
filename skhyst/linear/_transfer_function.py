r"""Rational transfer functions of one input and of several.

The poles are those of sections in series: first-order lags (``time_constants``), then second-order
ones (``natural_frequencies``, ``damping_ratios``, above 1 for two real poles), stable as long as
those numbers are positive. With L_0 = u, L_i the output of section i and L the last one,

    y = gain L + numerator . (L'/w, L_{m-1} - L, L_{m-1}'/w, L_{m-2} - L_{m-1}, ...) + intercept

where a first-order section gives no derivative term. The first ``n_zeros`` of these terms span
every numerator of that degree, and all of them vanish at rest, so ``gain`` is the static gain.

Several inputs share the denominator. Their state is that of the observable form, the transposed
matrices of one input, so there are as many states as poles, plus the past of delayed inputs.
"""

import warnings
from dataclasses import dataclass, replace
from functools import partial
from numbers import Integral, Real
from typing import Self

import numpy as np
from scipy.linalg import eig
from sklearn.utils.validation import check_array, check_is_fitted

from .._jit import jit
from .._sklearn import Interval, StrOptions
from .._validation import read_slices
from ..base import one_thread, refine
from ..exceptions import DivergenceWarning
from ..operators import (
    CompiledColumn,
    CompiledLaw,
    CompiledSeries,
    CompiledSum,
    Series,
    parameter,
    run_records,
    state_space_begin,
    state_space_step,
)
from ..optimize import (
    FrequencyProblem,
    RationalBlock,
    identify_response,
    pole_starts,
    record_poles,
    sections,
    vector_fit,
)
from ..records import with_lost_rows
from ._conversion import control_system, poles_and_response, scipy_system
from ._delay import DelayOperator
from ._estimate_response import chosen_columns
from ._linear import (
    DiscretizedOperator,
    LinearModel,
    LinearOperator,
    decay_of,
    discretize,
    log_grid,
    refuse_open_hold,
    time_span,
)
from ._modes import ModesMixin, section_poles
from ._second_order_mode import SecondOrderModeOperator, count_ringing, rates_of_sections

_EXACT = 1e-8  # relative error at which a numerator's degree suffices
_POINTS = 8  # frequencies per pole


@jit
def state_space_run_many(ad, b0, b1, c, d, u, x, u_previous):
    """Return the outputs (n, p) for inputs ``u`` (n, m), and the last state.

    ``b0`` and ``b1`` are (n_states, m), ``c`` is (p, n_states), ``d`` (p, m), ``u_previous`` (m,);
    the state ``x`` is not modified.
    """
    n_states, m = b0.shape
    p = c.shape[0]
    old = x.copy()
    new = np.empty(n_states)
    y = np.empty((u.shape[0], p))
    for k in range(u.shape[0]):
        for i in range(n_states):
            value = 0.0
            for j in range(m):
                last = u_previous[j] if k == 0 else u[k - 1, j]
                value += b0[i, j] * last + b1[i, j] * u[k, j]
            for j in range(n_states):
                value += ad[i, j] * old[j]
            new[i] = value
        for i in range(p):
            output = 0.0
            for j in range(m):
                output += d[i, j] * u[k, j]
            for j in range(n_states):
                output += c[i, j] * new[j]
            y[k, i] = output
        old, new = new, old
    return y, old


@dataclass(frozen=True)
class TransferFunctionOperator(LinearOperator):
    """Rational transfer function, poles as stable sections in series, numerator linear.

    The sections are first-order lags, then second-order ones. The numerator weighs slopes and
    differences of their outputs, last section first, which vanish at rest and are added to ``gain``
    times the last output.

    Parameters
    ----------
    time_constants : ndarray of shape (n_real,)
        In s.
    natural_frequencies : ndarray of shape (n_pairs,)
        In rad/s.
    damping_ratios : ndarray of shape (n_pairs,)
        Above 1 for two real poles.
    numerator : ndarray of shape (n_zeros,)
        Weights, at most one per pole.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import TransferFunctionOperator
    >>> lag = TransferFunctionOperator(np.array([1.0]), np.empty(0), np.empty(0), np.empty(0))
    >>> lag.run([0.0, 1.0, 1.0], dt=1.0)[0].round(3).tolist()
    [0.0, 0.368, 0.767]
    """

    time_constants: np.ndarray = parameter(log=True, lower=0.0, unit="s")
    natural_frequencies: np.ndarray = parameter(log=True, lower=0.0, unit="rad/s")
    damping_ratios: np.ndarray = parameter(log=True, lower=0.0)
    numerator: np.ndarray = parameter(linear=True, unit="response/drive")
    gain: float = parameter(linear=True, gauge=1.0, unit="response/drive", default=1.0)
    intercept: float = parameter(linear=True, gauge=0.0, unit="response", default=0.0)
    hold: str = "foh"

    def __post_init__(self):
        super().__post_init__()
        self._require_size("damping_ratios", np.size(self.natural_frequencies), "natural frequency")

    @classmethod
    def from_scipy(cls, system, *, hold="foh"):
        """Convert a continuous-time system of SciPy or python-control.

        Parameters
        ----------
        system : scipy.signal.lti, control.StateSpace or control.TransferFunction
            Continuous time, one response, one input or several, no pole at zero.
        hold : {"foh", "zoh"}, default="foh"
            Input between samples.

        Returns
        -------
        TransferFunctionOperator
            For several inputs a :class:`MultiInputTransferFunctionOperator`.

        Raises
        ------
        ValueError
            If the system is in discrete time, has several responses, no pole, or a pole at zero.
        """
        poles, response = poles_and_response(system)
        size = np.abs(poles)
        count = _POINTS * (len(poles) + 2)
        omega = np.geomspace(0.03 * size.min(), 30.0 * size.max(), count)
        gains, parts = response(omega), sections(poles)
        # the smallest degree of the numerator that reproduces the response
        for n_zeros in range(len(poles) + 1):
            one = cls(*parts, np.zeros(n_zeros), hold=hold)
            linear = [spec.linear for _, spec in one.entries()]
            linear[-1] = False  # the intercept
            columns = one.frequency_tangents(omega / (2.0 * np.pi))[1][:, 0, linear]
            weight = 1.0 / np.abs(columns).max(axis=1, keepdims=True)
            rows, targets = (
                np.concatenate([part.real, part.imag])
                for part in (columns * weight, gains * weight)
            )
            found = np.linalg.lstsq(rows, targets, rcond=None)[0]
            if np.abs(rows @ found - targets).max() <= _EXACT * np.abs(targets).max():
                break
        if gains.shape[1] == 1:
            return cls(*parts, found[:-1, 0], float(found[-1, 0]), hold=hold)
        return MultiInputTransferFunctionOperator(*parts, found[:-1].T.copy(), found[-1], hold=hold)

    def to_scipy(self):
        """Return the continuous-time ``scipy.signal.StateSpace``, without the intercept."""
        return scipy_system(self)

    def zeros(self):
        """Return the zeros in rad/s, complex, shape (n_zeros,)."""
        a, b, c, d = self.state_space()
        unit = float(np.abs(self.poles()).max())
        pencil = np.block([[a / unit, b[:, None] / unit], [c[None, :], np.array([[d]])]])
        found = eig(pencil, np.diag(np.r_[np.ones(len(b)), 0.0]), right=False)
        found = found[np.isfinite(found)]
        # zeros at infinity come out finite but large, by rounding: keep the smallest ones
        return unit * found[np.argsort(np.abs(found))[: np.size(self.numerator)]]

    def in_order(self):
        """Return the operator with its modes by frequency; see the base."""
        order = np.argsort(self.natural_frequencies, kind="stable")
        return self if np.all(np.diff(order) > 0) else self.with_modes(order)

    def with_modes(self, order):
        """Return the operator with its second-order sections in another order.

        The numerator weighs other outputs then; that it gives the same response at a few more
        frequencies than it has weights determines these.

        Parameters
        ----------
        order : ndarray of shape (n_pairs,)
            Numbers of the sections.

        Returns
        -------
        TransferFunctionOperator
        """
        moved = replace(
            self,
            natural_frequencies=self.natural_frequencies[order],
            damping_ratios=self.damping_ratios[order],
        )
        if not np.size(self.numerator):
            return moved
        size = np.concatenate([self.natural_frequencies, np.abs(1.0 / self.time_constants)])
        count = _POINTS * (sum(self.n_poles) + 2)
        frequency = np.geomspace(0.1 * size.min(), 10.0 * size.max(), count) / (2.0 * np.pi)
        first, n = len(size) + len(order), np.size(self.numerator)
        columns = moved.frequency_tangents(frequency)[1][:, 0, first : first + n]
        plain = replace(moved, numerator=np.zeros(n)).frequency_response(frequency)
        target = self.frequency_response(frequency) - plain
        rows, target = (np.concatenate([part.real, part.imag]) for part in (columns, target))
        scale = np.abs(rows).max(axis=0)
        found = np.linalg.lstsq(rows / scale, target, rcond=None)[0] / scale
        return replace(moved, numerator=found)

    @property
    def n_poles(self):
        return np.size(self.time_constants), np.size(self.natural_frequencies)

    def with_poles(self, rates, pairs):
        frequencies, dampings = np.array(pairs, dtype=float).reshape(-1, 2).T
        return replace(
            self,
            time_constants=1.0 / np.array(rates, dtype=float),
            natural_frequencies=frequencies,
            damping_ratios=dampings,
        )

    def n_ringing(self):
        return count_ringing(self.damping_ratios)

    def lag_rates(self):
        if np.size(self.numerator):
            return []
        return rates_of_sections(self.time_constants, self.natural_frequencies, self.damping_ratios)

    def linear_mode(self):
        if self.n_poles != (0, 1) or np.size(self.numerator):
            return None
        pair = float(self.natural_frequencies[0]), float(self.damping_ratios[0])
        return SecondOrderModeOperator(*pair, self.gain, self.intercept, self.hold)

    def _matrices(self, p):
        n_first, n_second = self.n_poles
        lengths = n_first, n_second, n_second, np.size(self.numerator)
        tau, w, zeta, numerator, (gain, _) = np.split(p, np.cumsum(lengths))
        n = n_first + 2 * n_second
        # rows over (states, u): derivatives of the states, and outputs of the sections
        system = np.zeros((n, n + 1), dtype=p.dtype)
        unit = np.eye(n + 1, dtype=p.dtype)
        level, terms = unit[n], []
        for i in range(n_first):
            system[i] = (level - unit[i]) / tau[i]
            terms.append([level - unit[i]])
            level = unit[i]
        for j in range(n_second):
            row = n_first + 2 * j
            after, velocity = unit[row], unit[row + 1]
            system[row] = w[j] * velocity
            system[row + 1] = w[j] * (level - after - 2.0 * zeta[j] * velocity)
            terms.append([velocity, level - after])
            level = after
        output = gain * level
        columns = [column for section in reversed(terms) for column in section]
        for weight, column in zip(numerator, columns, strict=False):
            output = output + weight * column
        return system[:, :n], system[:, n], output[:n], output[n]


@dataclass(frozen=True)
class MultiInputTransferFunctionOperator(DiscretizedOperator):
    r"""Transfer functions of several inputs with a common denominator, added.

    .. math:: y = \sum_i e^{-\theta_i s} \frac{N_i(s)}{D(s)} u_i + \text{intercept}

    Poles and numerators are those of :class:`TransferFunctionOperator`. There are as many states as
    poles, for any number of inputs. Inputs are ``(n_samples, n_inputs)``. In a series it must be
    the first stage.

    Parameters
    ----------
    time_constants : ndarray of shape (n_real,)
        In s.
    natural_frequencies : ndarray of shape (n_pairs,)
        In rad/s.
    damping_ratios : ndarray of shape (n_pairs,)
        Above 1 for two real poles.
    numerators : ndarray of shape (n_inputs, n_zeros)
        One row per input.
    gains : ndarray of shape (n_inputs,)
        Static gains, response/drive.
    delays : ndarray of shape (n_inputs,), default=()
        In s; empty where there are none.
    intercept : float, default=0.0
        Units of the response.
    hold : {"foh", "zoh"}, default="foh"
        Inputs between samples: straight lines, or constant. Fixed structure.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import MultiInputTransferFunctionOperator
    >>> lag = MultiInputTransferFunctionOperator(
    ...     np.array([1.0]), np.empty(0), np.empty(0), np.empty((2, 0)), np.array([1.0, 2.0])
    ... )
    >>> lag.run(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.0]]), dt=1.0)[0].round(3).tolist()
    [0.0, 0.368, 0.767]
    """

    time_constants: np.ndarray = parameter(log=True, lower=0.0, unit="s")
    natural_frequencies: np.ndarray = parameter(log=True, lower=0.0, unit="rad/s")
    damping_ratios: np.ndarray = parameter(log=True, lower=0.0)
    numerators: np.ndarray = parameter(linear=True, unit="response/drive")
    gains: np.ndarray = parameter(linear=True, unit="response/drive")
    delays: np.ndarray = parameter(log=True, lower=0.0, unit="s", default=())
    intercept: float = parameter(linear=True, gauge=0.0, unit="response", default=0.0)
    hold: str = "foh"
    reads_columns = True

    def __post_init__(self):
        super().__post_init__()
        self._require_size("damping_ratios", np.size(self.natural_frequencies), "natural frequency")
        is_right = np.shape(self.numerators)[:1] == (self.n_inputs,)
        self._require("numerators", is_right, f"have {self.n_inputs} row(s), one per gain")
        if np.size(self.delays):
            self._require_size("delays", self.n_inputs, "gain")

    def in_order(self):
        """Return the operator with its modes by frequency; see the base."""
        order = np.argsort(self.natural_frequencies, kind="stable")
        if np.all(np.diff(order) > 0):
            return self
        return replace(
            self,
            natural_frequencies=self.natural_frequencies[order],
            damping_ratios=self.damping_ratios[order],
            numerators=np.stack([part.with_modes(order).numerator for part in self._parts()]),
        )

    @property
    def n_inputs(self):
        """Number of inputs."""
        return np.size(self.gains)

    def entries(self):
        names = iter([f"numerators[{i},{j}]" for i, j in np.ndindex(np.shape(self.numerators))])
        return [
            (next(names) if name.startswith("numerators[") else name, spec)
            for name, spec in super().entries()
        ]

    def part(self, i):
        """Return the transfer function of one input, without its delay and the intercept.

        Parameters
        ----------
        i : int
            Number of the input.

        Returns
        -------
        TransferFunctionOperator
            With the common poles.
        """
        return TransferFunctionOperator(
            self.time_constants,
            self.natural_frequencies,
            self.damping_ratios,
            self.numerators[i],
            float(self.gains[i]),
            hold=self.hold,
        )

    def _parts(self):
        return [self.part(i) for i in range(self.n_inputs)]

    def poles(self):
        """Return the poles in rad/s, complex, shape (n_states,)."""
        return self.part(0).poles()

    def slowest_decay(self):
        return decay_of(self.poles())

    def zeros(self):
        """Return the zeros of each input in rad/s: a list of complex arrays."""
        return [part.zeros() for part in self._parts()]

    def n_ringing(self):
        return count_ringing(self.damping_ratios)

    def state_space(self):
        """Return the continuous-time matrices A (n, n), B (n, n_inputs), C (n,), D (n_inputs,)."""
        a, b, c, d = zip(*(part.state_space() for part in self._parts()), strict=True)
        return np.ascontiguousarray(a[0].T), np.stack(c, axis=1), b[0], np.array(d)

    def to_scipy(self):
        """Return the continuous-time ``scipy.signal.StateSpace``, without the intercept."""
        return scipy_system(self, self.delays)

    def frequency_response(self, frequency):
        """Return the complex gains of the inputs.

        Parameters
        ----------
        frequency : ndarray of shape (n,)
            Hz.

        Returns
        -------
        ndarray of shape (n, n_inputs)
            A column for each input.
        """
        frequency = np.asarray(frequency, dtype=float)
        gains = [part.frequency_response(frequency) for part in self._parts()]
        return np.stack(gains, axis=-1) * self._shift(frequency)

    def _shift(self, frequency):
        if not np.size(self.delays):
            return np.ones(self.n_inputs)
        return np.exp(-2j * np.pi * frequency[:, None] * self.delays)

    def frequency_tangents(self, frequency):
        """Return the complex gains of the inputs and their derivatives by the parameters.

        Parameters
        ----------
        frequency : ndarray of shape (n,)
            Hz.

        Returns
        -------
        gain : ndarray of shape (n, n_inputs)
            The complex gain of each input.
        tangents : ndarray of shape (n, n_inputs, n_parameters)
            Derivatives in the order of :meth:`pack`.
        """
        tangents = np.zeros((len(frequency), self.n_inputs, self.n_parameters), dtype=complex)
        gain = np.empty(tangents.shape[:2], dtype=complex)
        for i, part in enumerate(self._parts()):
            g, dg = part.frequency_tangents(frequency)
            gain[:, i] = g[:, 0]
            self._place(tangents[:, i], i, dg[:, 0])
        shift = self._shift(frequency)
        gain, tangents = gain * shift, tangents * shift[..., None]
        for i in range(np.size(self.delays)):
            tangents[:, i, self._delay_column(i)] = -2j * np.pi * frequency * gain[:, i]
        return gain, tangents

    def _delay_column(self, i):
        return self.n_parameters - 1 - np.size(self.delays) + i  # the intercept is last

    def _place(self, tangents, i, own):
        """Add the derivatives by the parameters of ``part(i)``, without its intercept, in place."""
        n_poles = sum(self.part(i).n_poles) + np.size(self.damping_ratios)
        n_inputs, n_zeros = np.shape(self.numerators)
        first = n_poles + i * n_zeros
        tangents[:, :n_poles] += own[:, :n_poles]
        tangents[:, first : first + n_zeros] += own[:, n_poles : n_poles + n_zeros]
        tangents[:, n_poles + n_inputs * n_zeros + i] += own[:, n_poles + n_zeros]

    def _discrete(self, dt):
        if dt not in self._memory:
            a, b, c, d = self.state_space()
            stacked = np.broadcast_to(a, (self.n_inputs, *a.shape))
            ad, b0, b1 = discretize(stacked, b.T, dt, self.hold)
            self._memory[dt] = tuple(
                np.ascontiguousarray(part) for part in (ad[0], b0.T, b1.T, c[None], d[None])
            )
        return self._memory[dt]

    def _delays(self):
        return [DelayOperator(float(delay)) for delay in self.delays]

    def init(self, u0, initial_state="rest"):
        u0 = np.asarray(u0, dtype=float)
        a, b, _, _ = self.state_space()
        at_rest = initial_state == "rest"
        x = -np.linalg.solve(a, b @ u0) if at_rest else np.zeros(len(a))
        pasts = (o.init(v, initial_state) for o, v in zip(self._delays(), u0, strict=False))
        previous = None if self.hold == "foh" and not at_rest else u0 * at_rest
        return x, previous, tuple(pasts)

    def run(self, u, dt, state=None):
        u = np.ascontiguousarray(u, dtype=float)
        x, previous, pasts = self.init(u[0]) if state is None else state
        if pasts:
            delayed = [
                delay.run(signal, dt, past)
                for delay, signal, past in zip(self._delays(), u.T, pasts, strict=True)
            ]
            u = np.stack([signal for signal, _ in delayed], axis=1)
            pasts = tuple(past for _, past in delayed)
        discrete = self._discrete(dt)
        if previous is None:
            first = discrete[-2] @ x + discrete[-1] @ u[0]
            y, x = state_space_run_many(*discrete, u[1:], x, u[0])
            y = np.vstack([first, y])
        else:
            y, x = state_space_run_many(*discrete, u, x, previous)
        return y[:, 0] + self.intercept, (x, u[-1].copy(), pasts)

    def compiled_step(self, dt, state):
        # the responses to the inputs add up, so the first can carry the whole state
        x, previous, pasts = state
        ad, b0, b1, (c,), (d,) = self._discrete(dt)
        branches = []
        for i in range(self.n_inputs):
            constants = ad, b0[:, i], b1[:, i], c, d[i], self.intercept if i == 0 else 0.0
            own = x if i == 0 else np.zeros_like(x)
            if self.hold == "foh":
                begun = previous is not None
                state = [*own, previous[i] if begun else 0.0, *own, float(begun)]
                law = CompiledLaw(state_space_begin, constants, state)
            else:
                law = CompiledLaw(state_space_step, constants, [*own, previous[i], *own])
            stages = (law,)
            if pasts:
                stages = self._delays()[i].compiled_step(dt, pasts[i]), *stages
            branches.append(CompiledColumn((CompiledSeries(stages),), i, 0.0))
        return CompiledSum(tuple(branches))

    def sensitivities(self, u, du, dt, initial_state="rest"):
        if du.shape[-1]:
            raise ValueError(
                "A model of several inputs must come first: it cannot be driven by another one."
            )
        u = np.ascontiguousarray(u, dtype=float)
        tangents = np.zeros((len(u), self.n_parameters))
        total, delays = np.zeros(len(u)), self._delays()
        for i, part in enumerate(self._parts()):
            signal, carried = np.ascontiguousarray(u[:, i]), np.empty((len(u), 0))
            if delays:
                signal, carried = delays[i].sensitivities(signal, carried, dt, initial_state)
            y, own = part.sensitivities(signal, carried, dt, initial_state)
            total += y
            self._place(tangents, i, own[:, carried.shape[1] :])
            if delays:
                tangents[:, self._delay_column(i)] = own[:, 0]
        tangents[:, -1] = 1.0
        return total + self.intercept, tangents


_PATIENCE = 3  # orders without improvement after which the search for an order ends
_NOISELESS = 1e-20  # fraction of the response's power below which a residual counts as zero
_WIDE = 3  # poles from which on vector fitting of records is worth its time
_FEWEST_DELAYS, _MOST_DELAYS = 9, 60  # number of candidates of a fitted delay
_TURN = 0.4  # largest step between two candidates, in periods of the highest line
_FOLLOWED = 6  # best starts, which are refined by least squares


def choose_orders(fit, n_poles, n_zeros, max_poles):
    """Return the fit with the orders that minimise Schwarz's criterion (BIC), where not given.

    The number of poles ("auto") is chosen first, with one zero less than poles unless the zeros are
    given; then the number of zeros (None). Of orders without residual, the smallest is chosen.
    ``fit(n_poles, n_zeros)`` returns a result, the number of real residuals and the sum of squares
    of the response.
    """
    tried = {}

    def criterion(order):
        if order not in tried:
            result, n, power = fit(*order)
            squares = max(result.error**2, _NOISELESS * power / n, np.finfo(float).tiny)
            tried[order] = n * np.log(squares) + len(result.params) * np.log(n), result
        return tried[order][0]

    def usual(n):
        return n, n - 1 if n_zeros is None else n_zeros

    if n_poles == "auto":
        best = lowest = max(n_zeros or 1, 1)
        for n in range(lowest, max(max_poles, lowest) + 1):
            if criterion(usual(n)) < criterion(usual(best)):
                best = n
            elif n - best >= _PATIENCE:
                break
        n_poles = best
    orders = [(n_poles, m) for m in (range(n_poles + 1) if n_zeros is None else [n_zeros])]
    result = tried[min(orders, key=criterion)][1]
    return replace(result, n_evaluations=sum(r.n_evaluations for _, r in tried.values()))


def _behind_delay(operator, delays):
    """Return the operator of a single input after its delay, if it has one."""
    if not np.size(delays):
        return operator
    return Series(("delay", "transfer_function"), (DelayOperator(float(delays[0])), operator))


def _several(parts, n_zeros, n_inputs, delays, hold):
    """Return an operator of several inputs with the sections ``parts`` and zero numerators."""
    numerators, gains = np.zeros((n_inputs, n_zeros)), np.ones(n_inputs)
    return MultiInputTransferFunctionOperator(*parts, numerators, gains, delays, hold=hold)


def held_names(n_inputs, delay, fit_gain):
    """Return the entries of an operator of several inputs that are not fitted."""
    held = set() if fit_gain else {f"gains[{i}]" for i in range(n_inputs)}
    if not isinstance(delay, str):
        held |= {f"delays[{i}]" for i in range(np.size(delay))}
    return held


def record_starts(records, n_poles, n_zeros, delay, hold):
    """Return starting operators for records, whose ``u`` is (n_samples,) or of several inputs.

    ``delay`` is "fit", or the delays in s: one per input, or an empty array for none.
    """
    dt, span = time_span(records)
    several = records[0].u.ndim > 1
    n_inputs = records[0].u.shape[1] if several else 1
    data = [(record.u, record.y, record.dt) for record in records]
    found = [] if several else pole_starts(data, n_poles)
    if several or n_poles >= _WIDE:
        poles = record_poles(data, n_poles)
        found = found if poles is None else [poles, *found]
    candidates = [sections(poles) for poles in found]
    n_first, n_second = n_poles % 2, n_poles // 2
    for w in log_grid(6.0 / span, 1.5 / dt, 2):
        spread = w * 1.5 ** np.arange(n_second)
        candidates.append((np.full(n_first, 1.0 / w), spread, np.full(n_second, 0.2)))
    delays = np.full(n_inputs, dt) if isinstance(delay, str) else delay
    if several:
        return [_several(parts, n_zeros, n_inputs, delays, hold) for parts in candidates]
    return [
        _behind_delay(TransferFunctionOperator(*parts, np.zeros(n_zeros), hold=hold), delays)
        for parts in candidates
    ]


def fit_response(
    frequency, response, std, n_poles, n_zeros, *, delay, hold, stable, single, fit_gain, method
):
    """Fit a frequency response (n, n_inputs) with given orders; see :func:`choose_orders`.

    ``delay`` is as in :func:`record_starts`; ``single`` asks for the operator of a single input.
    """
    n_inputs = response.shape[1]
    weight = _weight(response, std)
    s = 2j * np.pi * frequency
    candidates = [delay] if not isinstance(delay, str) else _delays(frequency, response, weight)
    found = []
    for delays in candidates:
        undelayed = response * np.exp(s[:, None] * delays) if np.size(delays) else response
        blocks = [
            RationalBlock(undelayed[:, i], np.ones((len(s), 1)), weight[:, i])
            for i in range(n_inputs)
        ]
        poles, cost = vector_fit(s, blocks, n_poles, feedthrough=n_zeros >= n_poles, stable=stable)
        found.append((cost, _several(sections(poles), n_zeros, n_inputs, delays, hold)))
    fixed = held_names(n_inputs, delay, fit_gain) | {"intercept"}
    problems = [
        FrequencyProblem(operator, frequency, response, weight, fixed=fixed)
        for _, operator in sorted(found, key=lambda start: start[0])[:_FOLLOWED]
    ]
    result = identify_response(problems, method=method)
    if single:
        result = _single(result)
    return result, 2 * response.size, float(np.sum(np.abs(weight * response) ** 2))


def _weight(response, std):
    """Return reciprocal standard deviations, or 1 / RMS of the response where none are known."""
    if std is None or not np.any(std > 0.0):
        return np.full(response.shape, 1.0 / np.sqrt(np.mean(np.abs(response) ** 2)))
    # a line counts at most as much as a hundred typical ones: a standard deviation near 0 is chance
    return 1.0 / np.maximum(std, 0.1 * np.median(std[std > 0.0]))


def _delays(frequency, response, weight):
    """Return candidate delays in s, up to the largest one that the slope of the phase allows."""
    steps = np.angle(response[1:] * response[:-1].conj())
    power = (weight[1:] * np.abs(response[1:])) ** 2
    slopes = -steps / (2.0 * np.pi * np.diff(frequency)[:, None])
    most = max(float(np.max(np.sum(power * slopes, axis=0) / np.sum(power, axis=0))), 0.0)
    most, shortest = 1.2 * most, 0.01 / frequency.max()
    count = int(np.clip(most * frequency.max() / _TURN, _FEWEST_DELAYS, _MOST_DELAYS))
    parts = np.linspace(0.0, most, count)
    return [np.full(response.shape[1], max(part, shortest)) for part in parts]


def _single(result):
    """Return the result of one input with the operator and the names of a single input."""
    many = result.operator
    prefix = "transfer_function__" if np.size(many.delays) else ""

    def renamed(name):
        if name == "delays[0]":
            return "delay__delay"
        return prefix + name.replace("numerators[0,", "numerator[").replace("gains[0]", "gain")

    return replace(
        result,
        operator=_behind_delay(many.part(0), many.delays),
        params={renamed(name): value for name, value in result.params.items()},
        params_std={renamed(name): value for name, value in result.params_std.items()},
        params_std_white={renamed(n): value for n, value in result.params_std_white.items()},
        undetermined=tuple(map(renamed, result.undetermined)),
    )


class TransferFunction(ModesMixin, LinearModel):
    r"""Rational transfer functions of one input or several, with a delay.

    .. math:: y = \sum_i G_i\, u_i, \qquad G_i(s) = e^{-\theta_i s} \frac{N_i(s)}{D(s)}

    All inputs share the denominator: as many states as poles. The poles are stable by
    construction, the numerators are solved exactly for given poles.

    :meth:`fit` identifies the free run over records, starting from the iteration of Steiglitz and
    McBride [1]_ and from vector fitting [2]_ of the records' transforms;
    :meth:`fit_frequency_response` identifies :math:`G(j \omega)` itself, weighted by its
    uncertainty.

    Parameters
    ----------
    n_poles : int or "auto", default=2
        Degree of the denominator. ``"auto"`` tries 1, 2, ... ``max_poles`` and takes the one with
        the smallest BIC of the residual, which is assumed white: a residual of other effects raises
        the order.
    n_zeros : int or None, default=0
        Degree of the numerators, at most ``n_poles``; None chooses it by the same criterion.
    max_poles : int, default=8
        Largest degree that ``"auto"`` tries.
    inputs : {"drive", "all"} or list of int or str, default="drive"
        The columns of X that are inputs: the first, all, or those with these positions or names. A
        model of several inputs must come first in a composition; there, inputs go by position.
    delay : float, array-like of shape (n_inputs,) or "fit", default=0.0
        Delay in s, fixed, for all inputs or one for each; or fitted, one for each.
    stable : bool, default=True
        False lets :meth:`fit_frequency_response` keep poles in the right half-plane.
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample; ``"estimate"`` only with ``inputs="drive"``.

    Attributes
    ----------
    operator_ : TransferFunctionOperator, behind a DelayOperator where there is a delay
        ``time_constants`` (s), ``natural_frequencies`` (rad/s), ``damping_ratios``, ``numerator``,
        ``gain``, ``intercept``; ``poles()``, ``frequency_response(frequency)``. With ``inputs``
        other than "drive" a MultiInputTransferFunctionOperator.
    zeros_ : ndarray of shape (n_zeros,), complex, or list of such
        rad/s; a list, one array per input, unless ``inputs="drive"``.
    fit_error_ : float
        Root mean square of the residual; after :meth:`fit_frequency_response` that of real and
        imaginary parts in units of their standard deviation.

    Raises
    ------
    ValueError
        If ``n_zeros`` exceeds ``n_poles``, or an input does not exist.

    See Also
    --------
    ModalModel : Several inputs and responses with common modes.
    SecondOrderMode : A single mode.
    frequency_response : The response without a model.

    References
    ----------
    .. [1] Steiglitz and McBride, *IEEE Transactions on Automatic Control*, 1965.
    .. [2] Gustavsen and Semlyen, *IEEE Transactions on Power Delivery*, 1999.
    .. [3] Pintelon and Schoukens, *System Identification*, 2012, ch. 6, 9 and 11.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import SecondOrderModeOperator, TransferFunction
    >>> drive = np.random.default_rng(0).normal(size=500)
    >>> y, _ = SecondOrderModeOperator(60.0, 0.05, gain=3.0).run(drive, 0.01)
    >>> model = TransferFunction(n_poles=2, dt=0.01).fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.operator_.gain:.3f}")
    3.000
    """

    _parameter_constraints = {
        **LinearModel._parameter_constraints,
        "n_poles": [Interval(Integral, 1, None, closed="left"), StrOptions({"auto"})],
        "n_zeros": [Interval(Integral, 0, None, closed="left"), None],
        "max_poles": [Interval(Integral, 1, None, closed="left")],
        "inputs": [StrOptions({"drive", "all"}), list, tuple],
        "delay": [Interval(Real, 0, None, closed="left"), StrOptions({"fit"}), "array-like"],
        "stable": ["boolean"],
    }

    def __init__(
        self,
        n_poles=2,
        *,
        n_zeros=0,
        max_poles=8,
        inputs="drive",
        delay=0.0,
        stable=True,
        fit_gain=True,
        fit_intercept=True,
        hold="foh",
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        self.n_poles = n_poles
        self.n_zeros = n_zeros
        self.max_poles = max_poles
        self.inputs = inputs
        self.delay = delay
        self.stable = stable
        self.fit_gain = fit_gain
        self.fit_intercept = fit_intercept
        self.hold = hold
        self.initial_state = initial_state
        self.dt = dt
        self.drive = drive
        self.method = method

    @property
    def reads_columns(self):
        """Whether further columns of X are read."""
        return not (isinstance(self.inputs, str) and self.inputs == "drive")

    def operator_input(self, X, slices):
        signal, schedules = super().operator_input(X, slices)
        return X[:, self._columns(X.shape[1])] if self.reads_columns else signal, schedules

    def _columns(self, n_columns, names=None):
        """Return the positions of the inputs among the columns of X."""
        if isinstance(self.inputs, str):
            return list(range(n_columns if self.inputs == "all" else 1))
        if names is None:
            names = getattr(self, "feature_names_in_", ())
        return chosen_columns(self.inputs, names, n_columns, "TransferFunction")

    def _delay_of(self, n_inputs):
        """Return "fit", or the delays in s: one per input, or an empty array for none."""
        if isinstance(self.delay, str):
            return self.delay
        delays = np.asarray(self.delay, dtype=float)
        if delays.ndim > 1 or delays.size not in (1, n_inputs) or not np.all(delays >= 0.0):
            raise ValueError(
                "The 'delay' parameter of TransferFunction must be a number that is not negative, "
                f"or one for each of {n_inputs} input(s). Got {self.delay!r} instead."
            )
        delays = np.broadcast_to(delays, n_inputs).astype(float)
        return delays if delays.any() else np.empty(0)

    def held_parameters(self) -> frozenset[str]:
        fixed = super().held_parameters()
        if self.reads_columns:
            n_inputs = getattr(self, "_n_inputs", 1)
            held = held_names(n_inputs, self._delay_of(n_inputs), self.fit_gain)
            return frozenset(held | (fixed & {"intercept"}))
        delay = self._delay_of(1)
        if not np.size(delay):
            return fixed
        held = set() if isinstance(delay, str) else {"delay__delay"}
        return frozenset(held | {f"transfer_function__{name}" for name in fixed})

    def _check_orders(self):
        n_poles = self.max_poles if self.n_poles == "auto" else self.n_poles
        if self.n_zeros is not None and self.n_zeros > n_poles:
            name = "max_poles" if self.n_poles == "auto" else "n_poles"
            raise ValueError(
                f"The 'n_zeros' parameter of TransferFunction must be at most '{name}' = "
                f"{n_poles}. Got {self.n_zeros} instead."
            )

    def record_data(self, slices, X, y):
        self.__dict__.pop("_response_inputs", None)  # of an earlier fit to a frequency response
        records = super().record_data(slices, X, y)
        if self.reads_columns:
            self._n_inputs = records[0].u.shape[1]
            if self.initial_state == "estimate":
                raise ValueError(
                    "The 'initial_state' parameter of TransferFunction must be 'rest' or 'zero' "
                    "unless 'inputs' is 'drive'. Got 'estimate' instead."
                )
        return records

    def starting_values(self, records):
        self._check_orders()
        if self.n_poles == "auto" or self.n_zeros is None:
            return [self._choose(records).operator]
        return self._starts_of(records, self.n_poles, self.n_zeros)

    def _starts_of(self, records, n_poles, n_zeros):
        n_inputs = records[0].u.shape[1] if self.reads_columns else 1
        return record_starts(records, n_poles, n_zeros, self._delay_of(n_inputs), self.hold)

    def identify(self, data):
        self._check_orders()
        return self._choose(data)

    def _choose(self, records):
        n_samples = sum(record.segment_weights().sum() for record in records)
        power = sum(record.power() for record in records)

        def fit(n_poles, n_zeros):
            starts = self._starts_of(records, n_poles, n_zeros)
            return refine(self, starts, records), n_samples, power

        return choose_orders(fit, self.n_poles, self.n_zeros, self.max_poles)

    def fit_frequency_response(self, response) -> Self:
        r"""Identify the model from a frequency response.

        Minimises :math:`\sum_{k,i} |\hat G_i(f_k) - G_i(f_k)|^2 / \sigma_i(f_k)^2` over
        continuous-time G, which assumes that inputs are band-limited between samples. There is no
        intercept.

        Parameters
        ----------
        response : FrequencyResponse
            With ``std``, the lines are weighted by it.

        Returns
        -------
        self

        Raises
        ------
        ValueError
            If there are fewer lines than the parameters need, or several inputs while ``inputs``
            is "drive".
        """
        self._validate_params()
        refuse_open_hold(self.hold)
        self._check_orders()
        g, std = response.response, response.std
        if g.shape[1] > 1 and not self.reads_columns:
            raise ValueError(
                "The 'inputs' parameter of TransferFunction must be 'all' or a list for a "
                f"frequency response of {g.shape[1]} inputs. Got 'drive' instead."
            )
        columns = self._columns(g.shape[1], response.input_names)
        used = response.frequency > 0.0
        frequency, g = response.frequency[used], g[used][:, columns]
        std = None if std is None else std[used][:, columns]
        fewest = (self.n_zeros or 1) if self.n_poles == "auto" else self.n_poles
        n_unknowns = fewest + len(columns) * ((self.n_zeros or 0) + 1)
        if 2 * g.size <= n_unknowns or not np.any(g):
            raise ValueError(
                f"The 'response' must have more than {n_unknowns // (2 * len(columns)) + 1} lines "
                f"above zero, and not be zero at all of them. Got {len(frequency)} lines instead."
            )

        fit = partial(
            fit_response,
            frequency,
            g,
            std,
            delay=self._delay_of(len(columns)),
            hold=self.hold,
            stable=self.stable,
            single=not self.reads_columns,
            fit_gain=self.fit_gain,
            method=self.method,
        )
        with one_thread():
            result = choose_orders(fit, self.n_poles, self.n_zeros, self.max_poles)
        self._response_inputs = tuple(response.input_names[i] for i in columns)
        self._n_inputs = self.n_features_in_ = len(columns)
        self.records_, self.time_unit_ = (), response.time_unit
        self.dt_ = response.dt if self.dt is None else None  # it is in continuous time
        return self.adopt(result)

    def adopt(self, result):
        super().adopt(result)
        names = list(result.params)
        wanted = [
            i
            for field in ("time_constants", "natural_frequencies", "damping_ratios")
            for i, name in enumerate(names)
            if name.removeprefix("transfer_function__").startswith(f"{field}[")
        ]
        self._adopt_poles(result.covariance[np.ix_(wanted, wanted)])
        return self

    def _adopt_poles(self, covariance):
        rational, _ = self._rational()
        parts = rational.time_constants, rational.natural_frequencies, rational.damping_ratios
        self._set_modes(*section_poles(*parts), covariance)
        self.zeros_ = rational.zeros()

    def _rational(self):
        """Return the fitted operator without the delay of a single input, and the delays."""
        operator = self.operator_
        if hasattr(operator, "stages"):
            return operator.stages[1], operator.stages[0].delay
        return operator, getattr(operator, "delays", 0.0)

    @classmethod
    def from_system(cls, system, **params) -> Self:
        """Make a fitted model from a continuous-time system, such as that of a data sheet.

        Parameters
        ----------
        system : scipy.signal.lti, control.StateSpace or control.TransferFunction
            One response, no pole at zero.
        **params
            Parameters of the model, such as ``dt``, ``hold`` and ``initial_state``.

        Returns
        -------
        TransferFunction
            With ``operator_``, poles and zeros; standard errors are zero.

        Examples
        --------
        >>> from scipy.signal import lti
        >>> from skhyst.linear import TransferFunction
        >>> model = TransferFunction.from_system(lti([2.0], [0.5, 1.0]), dt=0.1)
        >>> model.predict([[1.0], [1.0]]).round(6)
        array([2., 2.])
        """
        model = cls(**params)
        refuse_open_hold(model.hold)
        operator = TransferFunctionOperator.from_scipy(system, hold=model.hold)
        single = isinstance(operator, TransferFunctionOperator)
        shape = np.shape(operator.numerator if single else operator.numerators)
        model.set_params(
            n_poles=len(operator.poles()), n_zeros=shape[-1], inputs="drive" if single else "all"
        )
        model._validate_params()
        entries = [name for name, _ in operator.entries()]
        n_inputs = 1 if single else operator.n_inputs
        model._n_inputs = model.n_features_in_ = n_inputs
        model._response_inputs = tuple(f"input{i}" for i in range(n_inputs))
        model.operator_, model.records_ = operator, ()
        model.dt_, model.time_unit_ = None, "s"
        model.params_ = dict(zip(entries, operator.pack().tolist(), strict=True))
        model.params_std_ = dict.fromkeys(entries, 0.0)
        model.params_std_white_ = dict.fromkeys(entries, 0.0)
        model._adopt_poles(np.zeros((model.n_poles, model.n_poles)))
        return model

    def to_scipy(self):
        """Return the fitted model as a continuous-time ``scipy.signal.StateSpace``.

        The intercept is left out.

        Raises
        ------
        ValueError
            If the model has a delay, which no finite state space has.
        """
        check_is_fitted(self)
        return scipy_system(*self._rational())

    def to_control(self):
        """Return the fitted model as a ``control.StateSpace``, as :meth:`to_scipy` does.

        Raises
        ------
        ImportError
            If the package ``control`` is not installed.
        """
        check_is_fitted(self)
        return control_system(*self._rational())

    def predict(self, X) -> np.ndarray:
        """Return the free run: the response to the inputs alone, each record from its own start.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_columns)
            After :meth:`fit_frequency_response` the inputs are taken by name from a DataFrame that
            has these names, otherwise by position.

        Returns
        -------
        ndarray of shape (n_samples,)
            Units of the response, always finite. An unstable model gives a
            :class:`~skhyst.exceptions.DivergenceWarning`.
        """
        check_is_fitted(self)
        if np.any(self.poles_.real > 0.0):
            warnings.warn(
                "The model is unstable: its free run grows without bound.",
                DivergenceWarning,
                stacklevel=2,
            )
        if not hasattr(self, "_response_inputs"):
            return super().predict(X)
        names = list(getattr(X, "columns", ()))
        if set(self._response_inputs) <= set(names):
            X = X[list(self._response_inputs)]
        array = check_array(X, dtype=np.float64)
        if array.shape[1] < self._n_inputs:
            raise ValueError(
                f"X must have the {self._n_inputs} input(s) {list(self._response_inputs)}. Got "
                f"{array.shape[1]} column(s) instead."
            )
        signal = array[:, : self._n_inputs] if self.reads_columns else array[:, 0]
        slices = read_slices(self, X, reset=False, bridge=True)
        slices, signal, read = with_lost_rows(slices, signal)
        y = run_records(self.operator_, signal, slices, self.free_run_state, [None] * len(slices))
        return y if read is None else y[read]
