"""Pure shift in time, ``y(t) = u(t - delay)``."""

from dataclasses import dataclass

import numpy as np

from ..base import ParametricModel
from ..operators import Operator, parameter
from ._linear import log_grid, time_span


@dataclass(frozen=True)
class DelayOperator(Operator):
    """``y(t) = u(t - delay)``, exact for an input that is a straight line between samples."""

    delay: float = parameter(log=True, lower=0.0, unit="s")
    rank: int = 5
    signal_linear = True
    n_poles = (0, 0)

    def _shift(self, history, n, dt):
        """Return the shifted signal and its slope per sample; ``history`` ends in ``n`` samples."""
        position = np.arange(len(history) - n, len(history)) - self.delay / dt
        position = np.clip(position, 0.0, None)
        left = np.minimum(position.astype(int), len(history) - 2)
        part = (position - left).reshape(-1, *([1] * (history.ndim - 1)))
        slope = history[left + 1] - history[left]
        return history[left] + part * slope, slope

    def init(self, u0, initial_state="rest"):
        return float(u0) if initial_state == "rest" else 0.0  # all of the past, at rest

    def run(self, u, dt, state=None):
        u = np.asarray(u, dtype=float)
        length = int(np.ceil(self.delay / dt)) + 1
        past = self.init(u[0]) if state is None else state
        past = np.full(length, past) if np.ndim(past) == 0 else past
        history = np.concatenate([past, u])
        return self._shift(history, len(u), dt)[0], history[-length:]

    def linearize(self, u, du, dt, initial_state="rest"):
        # what lies before the record is constant, so two samples of it stand for all
        rest = float(initial_state == "rest")
        history = np.concatenate([np.full(2, u[0] * rest), u])
        y, slope = self._shift(history, len(u), dt)
        if du.shape[1]:
            du = np.concatenate([np.tile(du[:1] * rest, (2, 1)), du])
            du = self._shift(du, len(u), dt)[0]
        return y, np.concatenate([du, -slope[:, None] / dt], axis=1)


class Delay(ParametricModel):
    r"""Pure shift in time, by any part of a sample.

    .. math:: y(t) = u(t - \theta)

    It has no gain: put a model that has one before or behind it in a
    :class:`~skhyst.compose.Cascade`.

    Attributes
    ----------
    operator_ : DelayOperator
        ``delay`` in s.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import Delay
    >>> time = np.arange(300) * 0.01
    >>> drive, y = np.sin(time), np.sin(np.maximum(time - 0.125, 0.0))
    >>> print(f"{Delay(dt=0.01).fit(drive.reshape(-1, 1), y).operator_.delay:.3f} s")
    0.125 s
    """

    operator_class = DelayOperator
    _any_interval = True

    def starting_values(self, records):
        dt, span = time_span(records)
        return [
            DelayOperator(float(delay))
            for delay in [0.5 * dt, *log_grid(2.0 * dt, max(0.1 * span, 4.0 * dt), 5)]
        ]
