r"""Rational transfer functions of one input and of several, as operators.

The poles are those of sections in series: first-order lags (``time_constants``), then second-order
ones (``natural_frequencies``, ``damping_ratios``, above 1 for two real poles), stable as long as
those numbers are positive. With L_0 = u, L_i the output of section i and L the last one,

    y = gain L + numerator . (L'/w, L_{m-1} - L, L_{m-1}'/w, L_{m-2} - L_{m-1}, ...) + intercept

where a first-order section gives no derivative term. The first ``n_zeros`` of these terms span
every numerator of that degree, and all of them vanish at rest, so ``gain`` is the static gain.

Several inputs share the denominator. Their state is that of the observable form, the transposed
matrices of one input, so there are as many states as poles, beside the past of delayed inputs.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import eig

from .._jit import jit
from ..operators import (
    LoweredColumn,
    LoweredSeries,
    LoweredStep,
    LoweredSum,
    parameter,
    state_space_step,
)
from ..optimize import sections
from ._conversion import poles_and_response, scipy_system
from ._delay import DelayOperator
from ._linear import DiscretizedOperator, LinearOperator, discretize
from ._second_order_mode import SecondOrderModeOperator, count_ringing, rates_of_sections

_EXACT = 1e-8  # relative error at which a numerator's degree suffices
_POINTS = 8  # on the frequency axis, a pole


@jit
def state_space_run_many(ad, b0, b1, c, d, u, x, u_previous):
    """Return the outputs (n, p) for inputs ``u`` (n, m), and the last state.

    ``b0`` and ``b1`` are (n_states, m), ``c`` is (p, n_states), ``d`` (p, m), ``u_previous`` (m,);
    the state ``x`` is left as it was.
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

    The sections are first-order lags (``time_constants``, s), then second-order ones
    (``natural_frequencies`` in rad/s, ``damping_ratios``, above 1 for two real poles). The
    ``numerator`` weighs slopes and differences of their outputs, last section first, which vanish
    at rest and are added to ``gain`` times the last output.
    """

    time_constants: np.ndarray = parameter(log=True, lower=0.0, unit="s")
    natural_frequencies: np.ndarray = parameter(log=True, lower=0.0, unit="rad/s")
    damping_ratios: np.ndarray = parameter(log=True, lower=0.0)
    numerator: np.ndarray = parameter(linear=True, unit="response/drive")
    gain: float = parameter(linear=True, gauge=1.0, unit="response/drive", default=1.0)
    intercept: float = parameter(linear=True, gauge=0.0, unit="response", default=0.0)
    hold: str = "foh"

    @classmethod
    def from_scipy(cls, system, *, hold="foh"):
        """Make one of a continuous-time system of SciPy or python-control.

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
        for n_zeros in range(len(poles) + 1):
            one = cls(*parts, np.zeros(n_zeros), hold=hold)
            linear = one.linear_mask()
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
        # those at infinity come out as large as rounding lets them
        return unit * found[np.argsort(np.abs(found))[: np.size(self.numerator)]]

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

    Poles and numerators are those of :class:`TransferFunctionOperator`, one row of ``numerators``
    and one value of ``gains`` (the static gain) an input; ``delays`` has one value an input (s) or
    none. There are as many states as poles, for any number of inputs.

    Inputs are ``(n_samples, n_inputs)``. It stands first: nothing can come before it in a series.
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

    def unpack(self, vector):
        moved = super().unpack(vector)
        return replace(moved, numerators=moved.numerators.reshape(np.shape(self.numerators)))

    def part(self, i):
        """Return the transfer function of input ``i``, without its delay and the intercept."""
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
        """Return the complex gains at ``frequency`` (n,) in Hz, shape (n, n_inputs)."""
        frequency = np.asarray(frequency, dtype=float)
        gains = [part.frequency_response(frequency) for part in self._parts()]
        return np.stack(gains, axis=-1) * self._shift(frequency)

    def _shift(self, frequency):
        if not np.size(self.delays):
            return np.ones(self.n_inputs)
        return np.exp(-2j * np.pi * frequency[:, None] * self.delays)

    def frequency_tangents(self, frequency):
        """Return the complex gains (n, n_inputs) at ``frequency`` (n,) in Hz and their derivatives.

        Those by the parameters are (n, n_inputs, n_parameters), in the order of :meth:`pack`.
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
        """Add the derivatives by the parameters of ``part(i)``, but its intercept."""
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
        return x, u0 * at_rest, tuple(pasts)

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
        y, x = state_space_run_many(*self._discrete(dt), u, x, previous)
        return y[:, 0] + self.intercept, (x, u[-1].copy(), pasts)

    def lowered(self, dt, state):
        # the inputs' responses add up, whichever of them the state is counted to
        x, previous, pasts = state
        ad, b0, b1, (c,), (d,) = self._discrete(dt)
        branches = []
        for i in range(self.n_inputs):
            constants = ad, b0[:, i], b1[:, i], c, d[i], self.intercept if i == 0 else 0.0
            own = x if i == 0 else np.zeros_like(x)
            stages = (LoweredStep(state_space_step, constants, [*own, previous[i], *own]),)
            if pasts:
                stages = self._delays()[i].lowered(dt, pasts[i]), *stages
            branches.append(LoweredColumn((LoweredSeries(stages),), i, 0.0))
        return LoweredSum(tuple(branches))

    def linearize(self, u, du, dt, initial_state="rest"):
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
                signal, carried = delays[i].linearize(signal, carried, dt, initial_state)
            y, own = part.linearize(signal, carried, dt, initial_state)
            total += y
            self._place(tangents, i, own[:, carried.shape[1] :])
            if delays:
                tangents[:, self._delay_column(i)] = own[:, 0]
        tangents[:, -1] = 1.0
        return total + self.intercept, tangents
