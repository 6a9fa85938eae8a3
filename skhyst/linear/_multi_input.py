"""Several inputs, one response, common poles."""

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from ..operators import Operator, parameter
from ._delay import DelayOperator
from ._dynamics import TransferFunctionOperator
from ._linear import discretize
from ._state_space import state_space_run_many

__all__ = [
    "MultiInputTransferFunctionOperator",
]


@dataclass(frozen=True)
class MultiInputTransferFunctionOperator(Operator):
    r"""Transfer functions of several inputs with a common denominator, added.

    .. math:: y = \sum_i e^{-\theta_i s} \frac{N_i(s)}{D(s)} u_i + \text{intercept}

    Poles and numerators are those of :class:`TransferFunctionOperator`, one row of ``numerators``
    and one value of ``gains`` (the static gain) an input; ``delays`` has one value an input (s) or
    none. The state is that of the observable form (the transposed matrices of one input), so there
    are as many states as poles, for any number of inputs, beside the past of delayed inputs.

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
    signal_linear = True

    @property
    def n_inputs(self):
        """Number of inputs."""
        return np.size(self.gains)

    def entries(self):
        rows, columns = np.shape(self.numerators)
        numbered = [f"numerators[{i},{j}]" for i in range(rows) for j in range(columns)]
        names = iter(numbered)
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

    def poles(self):
        """Return the poles in rad/s, complex, shape (n_states,)."""
        return self.part(0).poles()

    def zeros(self):
        """Return the zeros of each input in rad/s: a list of complex arrays."""
        return [self.part(i).zeros() for i in range(self.n_inputs)]

    def state_space(self):
        """Return the continuous-time matrices A (n, n), B (n, n_inputs), C (n,), D (n_inputs,)."""
        parts = [self.part(i).state_space() for i in range(self.n_inputs)]
        a, b, _, _ = parts[0]
        return (
            np.ascontiguousarray(a.T),
            np.stack([c for _, _, c, _ in parts], axis=1),
            b,
            np.array([d for _, _, _, d in parts]),
        )

    def to_scipy(self):
        """Return the continuous-time ``scipy.signal.StateSpace``, without the intercept."""
        from ._conversion import scipy_system

        return scipy_system(self)

    def frequency_response(self, frequency):
        """Return the complex gains at ``frequency`` (n,) in Hz, shape (n, n_inputs)."""
        frequency = np.asarray(frequency, dtype=float)
        gains = [self.part(i).frequency_response(frequency) for i in range(self.n_inputs)]
        return np.stack(gains, axis=-1) * self._shift(frequency)

    def _shift(self, frequency):
        if not np.size(self.delays):
            return np.ones(self.n_inputs)
        return np.exp(-2j * np.pi * frequency[:, None] * self.delays)

    def frequency_tangents(self, frequency):
        """Return the complex gains and their derivatives by the parameters.

        Parameters
        ----------
        frequency : ndarray of shape (n,)
            Hz.

        Returns
        -------
        gain : ndarray of shape (n, n_inputs)
        tangents : ndarray of shape (n, n_inputs, n_parameters)
        """
        shift = self._shift(frequency)
        tangents = np.zeros((len(frequency), self.n_inputs, self.n_parameters), dtype=complex)
        gain = np.empty(tangents.shape[:2], dtype=complex)
        for i in range(self.n_inputs):
            g, dg = self.part(i).frequency_tangents(frequency)
            gain[:, i] = g[:, 0]
            self._place(tangents[:, i], i, dg[:, 0])
        gain, tangents = gain * shift, tangents * shift[..., None]
        for i in range(np.size(self.delays)):
            column = self._columns["delays"].start + i
            tangents[:, i, column] = -2j * np.pi * frequency * gain[:, i]
        return gain, tangents

    @cached_property
    def _columns(self):
        """Where each field stands in :meth:`pack`."""
        places, start = {}, 0
        for name, size in self.sizes().items():
            places[name] = slice(start, start + size)
            start += size
        return places

    def _place(self, tangents, i, own):
        """Add the derivatives by the parameters of ``part(i)``, but its intercept."""
        n_poles = self._columns["numerators"].start
        n_zeros = np.shape(self.numerators)[1]
        tangents[:, :n_poles] += own[:, :n_poles]
        first = n_poles + i * n_zeros
        tangents[:, first : first + n_zeros] += own[:, n_poles : n_poles + n_zeros]
        tangents[:, self._columns["gains"].start + i] += own[:, n_poles + n_zeros]

    @cached_property
    def _memory(self):
        return {}

    def __getstate__(self):
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def _discrete(self, dt):
        if dt not in self._memory:
            a, b, c, d = self.state_space()
            stacked = np.broadcast_to(a, (self.n_inputs, *a.shape))
            ad, b0, b1 = discretize(stacked, b.T, dt, self.hold)
            self._memory[dt] = tuple(
                np.ascontiguousarray(part) for part in (ad[0], b0.T, b1.T, c[None], d[None])
            )
        return self._memory[dt]

    def _delay(self, i):
        return DelayOperator(float(self.delays[i]))

    def init(self, u0, initial_state="rest"):
        u0 = np.asarray(u0, dtype=float)
        a, b, _, _ = self.state_space()
        at_rest = initial_state == "rest"
        x = -np.linalg.solve(a, b @ u0) if at_rest else np.zeros(len(a))
        pasts = tuple(
            self._delay(i).init(u0[i], initial_state) for i in range(np.size(self.delays))
        )
        return x, u0 * at_rest, pasts

    def run(self, u, dt, state=None):
        u = np.ascontiguousarray(u, dtype=float)
        x, previous, pasts = self.init(u[0]) if state is None else state
        if pasts:
            delayed = [
                self._delay(i).run(u[:, i], dt, past) if self.delays[i] > 0.0 else (u[:, i], past)
                for i, past in enumerate(pasts)
            ]
            u = np.stack([signal for signal, _ in delayed], axis=1)
            pasts = tuple(past for _, past in delayed)
        y, x = state_space_run_many(*self._discrete(dt), u, x, previous)
        return y[:, 0] + self.intercept, (x, u[-1].copy(), pasts)

    def step(self, state, u, dt):
        """Advance by one sample ``u`` (n_inputs,): return the new state and the output."""
        y, state = self.run(np.asarray(u, dtype=float)[None], dt, state)
        return state, float(y[0])

    def linearize(self, u, du, dt, initial_state="rest"):
        if du.shape[-1]:
            raise ValueError(
                "A model of several inputs must come first: it cannot be driven by another one."
            )
        u = np.ascontiguousarray(u, dtype=float)
        tangents = np.zeros((len(u), self.n_parameters))
        total, delayed = np.zeros(len(u)), np.size(self.delays) > 0
        for i in range(self.n_inputs):
            signal, carried = np.ascontiguousarray(u[:, i]), np.empty((len(u), 0))
            if delayed and self.delays[i] > 0.0:
                signal, carried = self._delay(i).linearize(signal, carried, dt, initial_state)
            y, own = self.part(i).linearize(signal, carried, dt, initial_state)
            total += y
            self._place(tangents, i, own[:, carried.shape[1] :])
            if carried.shape[1]:
                tangents[:, self._columns["delays"].start + i] = own[:, 0]
        tangents[:, -1] = 1.0
        return total + self.intercept, tangents
