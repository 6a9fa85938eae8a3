"""Pure delay."""

from ..operators import DelayOperator
from ._base import LinearModel, log_grid, time_span

__all__ = ["Delay"]


class Delay(LinearModel):
    r"""Pure shift in time, by any part of a sample.

    .. math:: y(t) = u(t - \theta)

    It has no gain: put a model that has one before or behind it in a
    :class:`~skhyst.compose.Cascade`.

    Parameters
    ----------
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample.
    dt : float, default=1.0
        Sampling interval in s of data without a time index.
    method : str or Method, default="variable_projection"
        How the parameters are identified, see :mod:`skhyst.optimize`.

    Attributes
    ----------
    operator_ : DelayOperator
        ``delay`` in s.
    params_, params_std_ : dict
        The delay and its standard error.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import Delay
    >>> time = np.arange(300) * 0.01
    >>> drive, y = np.sin(time), np.sin(np.maximum(time - 0.125, 0.0))
    >>> print(f"{Delay(dt=0.01).fit(drive.reshape(-1, 1), y).operator_.delay:.3f} s")
    0.125 s
    """

    _rank = DelayOperator.rank

    def __init__(self, *, initial_state="rest", dt=1.0, method="variable_projection"):
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    def _fixed(self):
        return frozenset()

    def _starts(self, records):
        dt, span = time_span(records)
        return [
            (DelayOperator(float(delay)), ())
            for delay in [0.5 * dt, *log_grid(2.0 * dt, max(0.1 * span, 4.0 * dt), 5)]
        ]
