"""Fold: a signal is mirrored at a level, as by a sensor that reads a magnitude."""

from dataclasses import dataclass

import numpy as np

from .._jit import jit
from .._sklearn import StrOptions
from ..operators import parameter
from ._base import StaticModel, StaticOperator, range_of_drive

# starting levels, in addition to the extreme reading: fractions of the drive's range
_PARTS = (0.3, 0.5, 0.7, 0.9)


@jit
def fold(u, c, s):
    """Return ``a + s |u - a|``; ``c`` is (a, s)."""
    level, side = c
    return level + side * abs(u - level)


@dataclass(frozen=True)
class FoldOperator(StaticOperator):
    """``y = a + s |u - a|`` about the level a; see :class:`Fold`.

    Parameters
    ----------
    level : float
        ``a``, units of the drive.
    side : {1, -1}, default=1
        ``s``: values below the level are mirrored up (1), or values above it down (-1). Fixed
        structure.

    Raises
    ------
    ValueError
        If ``side`` is neither.

    Examples
    --------
    >>> from skhyst.static import FoldOperator
    >>> FoldOperator(0.0).run([-2.0, 0.5, 2.0], dt=1.0)[0]
    array([2. , 0.5, 2. ])
    """

    level: float = parameter(unit="drive")
    side: int = 1
    stage_order = 50

    curve = staticmethod(fold)

    def __post_init__(self):
        super().__post_init__()
        self._require("side", self.side in (-1, 1), "be -1 or 1")

    def curve_constants(self):
        return self.level, self.side

    def evaluate(self, v):
        slope = self.side * np.where(v < self.level, -1.0, 1.0)
        return self.level + slope * (v - self.level), slope, (1.0 - slope)[:, None]

    def unfolded(self, y):
        """Return a smooth signal that the fold maps to ``y``.

        Of the two values that each sample can come from, the one nearer to the straight line
        through the two previous samples is taken; the first two samples are kept. The sign about
        the level is not identifiable: the mirror image of the signal has the same fold.

        Parameters
        ----------
        y : ndarray of shape (n_samples,)
            Folded signal.

        Returns
        -------
        ndarray of shape (n_samples,)
            The signal.
        """
        away = np.asarray(y, dtype=float) - self.level
        unfolded = away.copy()
        for k in range(2, len(away)):
            extrapolated = 2.0 * unfolded[k - 1] - unfolded[k - 2]
            unfolded[k] = np.copysign(away[k], extrapolated)
        return self.level + unfolded


class Fold(StaticModel):
    r"""Fold: a reading mirrored at a level, such as that of a sensor that loses the sign.

    .. math:: y = a + |u - a| \text{ or } y = a - |u - a|

    It has no gain: put a model that has one before it in a :class:`~skhyst.compose.Cascade`. There
    the sign of the model is not identifiable: its mirror image about the level gives the same
    reading.

    Parameters
    ----------
    side : {"lower", "upper"}, default="lower"
        The end of the response at which it is mirrored.

    Attributes
    ----------
    operator_ : FoldOperator
        ``level`` a, units of the drive.

    See Also
    --------
    SmoothCurve : Smooth curves.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.static import Fold
    >>> u = np.linspace(-1, 1, 201)
    >>> model = Fold().fit(u.reshape(-1, 1), 0.2 + np.abs(u - 0.2))
    >>> round(model.operator_.level, 6)
    0.2
    """

    operator_class = FoldOperator
    any_interval = False
    _parameter_constraints = {
        **StaticModel._parameter_constraints,
        "side": [StrOptions({"lower", "upper"})],
    }

    def __init__(
        self,
        side="lower",
        *,
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        super().__init__(initial_state=initial_state, dt=dt, drive=drive, method=method)
        self.side = side

    def starting_values(self, records):
        low, high = range_of_drive(records)
        side = 1 if self.side == "lower" else -1
        end = side * min(float((side * record.y).min()) for record in records)
        return [FoldOperator(end, side)] + [
            FoldOperator(low + part * (high - low), side) for part in _PARTS
        ]
