"""One-sided dead zones given by their slopes: strictly monotone, with an exact inverse."""

from dataclasses import dataclass, replace

import numpy as np

from ..operators import parameter
from ._static import StaticOperator

__all__ = [
    "MonotoneDeadZoneOperator",
]

_FLATTEST = 1e-3  # slope of the curve, response over response; below it an inverse is of no use


@dataclass(frozen=True)
class MonotoneDeadZoneOperator(StaticOperator):
    r"""Superposition of one-sided dead zones whose slopes are positive.

    .. math:: y = v + \sum_j w_j D_j(v)

    (Kuhnen 2003, section 4) where :math:`D_j(v) = \max(v - t_j, 0)` above the centre and
    :math:`\min(v - t_j, 0)` below it. From one threshold to the next the curve is straight with
    slope :math:`s_j`, one plus the weights of the dead zones that are open; between the two
    thresholds of the centre the slope is one. The slopes, not the weights, are the parameters:
    so the curve is monotone within simple bounds.

    Parameters
    ----------
    slopes : ndarray of shape (n_zones,)
        Slope on the far side of each threshold, seen from the centre. Bounded below by 0.001 when
        they are identified.
    thresholds : ndarray of shape (n_zones,)
        Ascending, units of the response. Fixed structure.
    n_lower : int
        Number of thresholds below the centre.

    References
    ----------
    K. Kuhnen, "Modeling, identification and compensation of complex hysteretic nonlinearities",
    European Journal of Control 9 (2003).

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.static import MonotoneDeadZoneOperator
    >>> curve = MonotoneDeadZoneOperator(np.array([2.0, 0.5]), np.array([-1.0, 1.0]), n_lower=1)
    >>> y, _ = curve.run([-3.0, 0.0, 3.0], dt=1.0)
    >>> y
    array([-5.,  0.,  2.])
    >>> curve.inverse().run(y, dt=1.0)[0]
    array([-3.,  0.,  3.])
    """

    slopes: np.ndarray = parameter(linear=True, lower=_FLATTEST)
    thresholds: np.ndarray
    n_lower: int

    rank = 20

    @property
    def side(self):
        """Side to which each dead zone opens, -1 or +1, shape (n_zones,)."""
        return np.where(np.arange(np.size(self.thresholds)) < self.n_lower, -1, 1)

    @property
    def weights(self):
        """Weights of the dead zones, as those of a ``DeadZoneOperator``, shape (n_zones,)."""
        below, above = np.split(np.asarray(self.slopes, dtype=float), [self.n_lower])
        return np.concatenate([-np.diff(below, append=1.0), np.diff(above, prepend=1.0)])

    def parts(self, v):
        """Return the centre's part of ``v`` (n,) and what lies behind each threshold (n, n_zones).

        Their sum is ``v``; weighted by the slopes, it is the output.
        """
        t, k = np.asarray(self.thresholds, dtype=float), self.n_lower
        gaps = np.diff(t, prepend=-np.inf, append=np.inf)
        low = np.concatenate([-gaps[:k], np.zeros(t.size - k)])
        high = np.concatenate([np.zeros(k), gaps[k + 1 :]])
        ends = np.concatenate([[-np.inf], t, [np.inf]])[k : k + 2]
        return np.clip(v, *ends), np.clip(v[:, None] - t, low, high)

    def _segments(self):
        """Return the slope of each segment (n_zones + 1,) and the output at each threshold."""
        slopes = np.insert(np.asarray(self.slopes, dtype=float), self.n_lower, 1.0)
        levels = np.append(0.0, np.cumsum(np.diff(self.thresholds) * slopes[1:-1]))
        centre = max(self.n_lower - 1, 0)
        return slopes, levels + (self.thresholds[centre] - levels[centre])

    def run(self, u, dt, state=None):
        """Map a signal of shape (n_samples,); see :meth:`Operator.run`."""
        v, t = np.asarray(u, dtype=float), self.thresholds
        slopes, levels = self._segments()
        y = np.interp(v, t, levels)
        y += slopes[0] * np.minimum(v - t[0], 0.0) + slopes[-1] * np.maximum(v - t[-1], 0.0)
        return y, ()

    def _evaluate(self, v):
        slopes, _ = self._segments()
        _, parts = self.parts(v)
        return self.run(v, 1.0)[0], slopes[np.searchsorted(self.thresholds, v)], parts

    def inverse(self):
        """Return the exact inverse, an operator of the same kind.

        Raises
        ------
        ValueError
            If a slope is not positive.
        """
        if not np.all(np.asarray(self.slopes) > 0.0):
            raise ValueError(
                "MonotoneDeadZoneOperator.inverse needs positive slopes: the curve must be "
                f"strictly monotone. Got slopes={self.slopes!r} instead."
            )
        _, thresholds = self._segments()
        return replace(self, slopes=1.0 / np.asarray(self.slopes), thresholds=thresholds)
