"""Pure shift in time."""

from dataclasses import dataclass

import numpy as np

from ._base import Operator, parameter

__all__ = ["DelayOperator"]


@dataclass(frozen=True)
class DelayOperator(Operator):
    """``y(t) = u(t - delay)``, exact for an input that is a straight line between samples."""

    delay: float = parameter(log=True, lower=0.0, unit="s")
    rank: int = 5
    signal_linear = True

    def _shift(self, history, n, dt):
        """Return the shifted signal and its slope per sample; ``history`` ends in ``n`` samples."""
        position = np.arange(len(history) - n, len(history)) - self.delay / dt
        position = np.clip(position, 0.0, None)
        left = np.minimum(position.astype(int), len(history) - 2)
        part = (position - left).reshape(-1, *([1] * (history.ndim - 1)))
        slope = history[left + 1] - history[left]
        return history[left] + part * slope, slope

    def _length(self, dt):
        return int(np.ceil(self.delay / dt)) + 1

    def init(self, u0, initial_state="rest"):
        return float(u0) if initial_state == "rest" else 0.0  # all of the past, at rest

    def run(self, u, dt, state=None):
        u = np.asarray(u, dtype=float)
        length = self._length(dt)
        past = self.init(u[0]) if state is None else state
        past = np.full(length, past) if np.ndim(past) == 0 else past
        history = np.concatenate([past, u])
        return self._shift(history, len(u), dt)[0], history[-length:]

    def linearize(self, u, du, dt, initial_state="rest"):
        # what lies before the record is constant, so two samples of it stand for all
        length, rest = 2, float(initial_state == "rest")
        history = np.concatenate([np.full(length, u[0] * rest), u])
        y, slope = self._shift(history, len(u), dt)
        if du.shape[1]:
            du = np.concatenate([np.tile(du[:1] * rest, (length, 1)), du])
            du = self._shift(du, len(u), dt)[0]
        return y, np.concatenate([du, -slope[:, None] / dt], axis=1)
