"""A sampled linear system of several inputs and responses."""

from dataclasses import dataclass

import numpy as np

from .._kernels._state_space import state_space_run_many

__all__ = ["SampledStateSpace"]


@dataclass(frozen=True)
class SampledStateSpace:
    """Sampled state space: ``x[k+1] = a x[k] + b u[k]``, ``y[k] = c x[k] + d u[k] + intercept``.

    It has ``init``, ``step`` and ``run`` as operators have, for inputs (n_samples, n_inputs) and
    responses (n_samples, n_outputs), but only at its own sampling interval, and it enters no
    composition.

    Parameters
    ----------
    a : ndarray of shape (n_states, n_states)
    b : ndarray of shape (n_states, n_inputs)
    c : ndarray of shape (n_outputs, n_states)
    d : ndarray of shape (n_outputs, n_inputs)
    dt : float
        Sampling interval in s.
    intercept : ndarray of shape (n_outputs,)
        Units of the responses.
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: np.ndarray
    dt: float
    intercept: np.ndarray

    def init(self, u0, initial_state="rest"):
        """Return the state before the first sample ``u0`` (n_inputs,): at rest there, or zero."""
        u0 = np.asarray(u0, dtype=float)
        if initial_state == "zero":
            return np.zeros(len(self.a)), np.zeros(len(u0))
        return np.linalg.solve(np.eye(len(self.a)) - self.a, self.b @ u0), u0

    def run(self, u, dt, state=None):
        """Map inputs (n_samples, n_inputs); return the responses and the state after them.

        Raises
        ------
        ValueError
            If ``dt`` is another interval than the system's own.
        """
        if abs(dt - self.dt) > 1e-3 * self.dt:
            raise ValueError(
                f"The system is sampled every {self.dt:g} s and runs at no other interval. Got "
                f"dt = {dt:g} s instead."
            )
        u = np.ascontiguousarray(u, dtype=float)
        x, previous = self.init(u[0]) if state is None else state
        y, x = state_space_run_many(self.a, self.b, 0.0 * self.b, self.c, self.d, u, x, previous)
        return y + self.intercept, (x, u[-1].copy())

    def step(self, state, u, dt):
        """Advance by one sample ``u`` (n_inputs,); return the state and the responses."""
        y, state = self.run(np.asarray(u, dtype=float)[None], dt, state)
        return state, y[0]

    def poles(self):
        """Return the poles in the plane of z, complex, shape (n_states,)."""
        return np.linalg.eigvals(self.a)

    def frequency_response(self, frequency):
        """Return the complex gains at ``frequency`` (n,) in Hz, (n, n_outputs, n_inputs)."""
        z = np.exp(2j * np.pi * self.dt * np.asarray(frequency, dtype=float))
        x = np.linalg.solve(
            z[:, None, None] * np.eye(len(self.a)) - self.a,
            np.broadcast_to(self.b, (len(z), *self.b.shape)),
        )
        return self.c @ x + self.d
