"""Base of the stages that have hysteresis inside their equation of motion."""

import dataclasses
import math
from abc import abstractmethod
from functools import cached_property

import numpy as np

from .._kernels._arrays import as_signal
from ._base import Operator
from ._dynamics import SecondOrderModeOperator

__all__ = ["OscillatorOperator"]


class OscillatorOperator(Operator):
    """Mass, spring and damper with a hysteretic force; ``y = gain q + intercept``.

    The first two parameters are ``natural_frequency`` and ``damping_ratio``, the last two ``gain``
    and ``intercept``. The state is the tuple (q, q'/w, hysteretic force, last drive), all in units
    of the drive. A subclass gives the state at rest and the loops.
    """

    carries_scale = True
    rank = 10

    def __post_init__(self):
        n = self.n_substeps
        if isinstance(n, bool) or not isinstance(n, (int, np.integer)) or n < 1:
            raise ValueError(
                f"The 'n_substeps' parameter of {type(self).__name__} must be an integer above 0. "
                f"Got {n!r} instead."
            )

    @abstractmethod
    def _rest(self, u0):
        """Return q and the hysteretic force at rest, and their derivatives (2, 1 + n_own).

        The derivatives are those by ``u0`` and by all parameters but the last two.
        """

    @abstractmethod
    def _run(self, mode, h, u, before, state, out):
        """Write q (n,) and return the last (q, p, f)."""

    @abstractmethod
    def _tangents(self, mode, mode_by, h, u, du, before, dbefore, state, d, out, dout):
        """Write q (n,) and its tangents (n, m + n_own)."""

    @abstractmethod
    def _fed_back(self, s, shift):
        """Return the subclass's own parameters behind a feedback that divides the gain by ``s``.

        ``shift`` is what the feedback makes of the intercept, in units of the drive.
        """

    def with_feedback(self, feedback, origin=0.0):
        """Return the operator from ``u + feedback (y - origin)`` to y; this one is from u to y.

        Parameters
        ----------
        feedback : float
            In drive/response, with ``feedback gain > -1``.
        origin : float, default=0.0
            Units of the response.

        Returns
        -------
        operator
            Of the same kind.
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

    @cached_property
    def _mode(self):
        return SecondOrderModeOperator(float(self.natural_frequency), float(self.damping_ratio))

    def _substep(self, dt):
        """Return the length of a substep and what moves the oscillator over it, (6,)."""
        h = float(dt) / self.n_substeps
        ad, b0, b1, _, _ = self._mode._discrete(h)
        return h, np.array([ad[0, 1], ad[1, 1], *(b0 + b1), *b1])

    def _substep_tangents(self, dt):
        """Return the derivatives of the oscillator's step, (2, 6)."""
        ad, b0, b1, _, _, _ = self._mode._discrete_tangents(float(dt) / self.n_substeps)
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
        h, mode = self._substep(dt)
        state = self._run(mode, h, u, before, state, q)
        return self.gain * q + self.intercept, (*state, float(u[-1]) if u.size else before)

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
        h, mode = self._substep(dt)
        mode_by = self._substep_tangents(dt)
        self._tangents(mode, mode_by, h, u, du, before, as_signal(dbefore), state, d, q, dq)
        dy = np.empty((u.size, m + n_own + 2))
        dy[:, :-2] = self.gain * dq
        dy[:, -2] = q
        dy[:, -1] = 1.0
        return self.gain * q + self.intercept, dy
