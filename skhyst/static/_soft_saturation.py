"""Saturation with a rounded knee."""

from .._sklearn import StrOptions
from ..base import ParametricModel
from ..operators import SoftSaturationOperator
from ._curves import limits_of_drive

__all__ = ["SoftSaturation"]

_LEVELS = (0.5, 0.8, 1.3)  # of the largest distance from the centre
_KNEES = (1.0, 2.0, 4.0)
_SIDES = {"both": 0, "lower": -1, "upper": 1}


class SoftSaturation(ParametricModel):
    r"""Saturation with a rounded knee, as of a magnetic core or an amplifier.

    .. math:: y = c + \frac{v}{(1 + |v / L|^n)^{1/n}}, \qquad v = u - c

    The slope is 1 at the centre c, and far from it y approaches :math:`c \pm L`. With n = 1 this is
    the anhysteretic curve of Frohlich [1]_; the larger n, the sharper the knee, and
    :class:`Saturation` is the limit. It has no gain: put a model that has one before or behind it
    in a :class:`~skhyst.compose.Cascade`.

    Parameters
    ----------
    sides : {"both", "lower", "upper"}, default="both"
        Which sides of the centre saturate; the other one is straight.
    rank : {"drive", "sensor"}, default="sensor"
        Where it stands when an effect search has to find its place in a series: before everything
        else, or behind it.
    fit_center : bool, default=True
        Whether the centre is fitted; otherwise it is held at 0, for a symmetric device.
    initial_state, dt, method
        As for every model; a memoryless model depends on neither.

    Attributes
    ----------
    operator_ : SoftSaturationOperator
        ``level`` L and ``center`` c, units of the signal; ``knee`` n, from 0.3 to 50;
        ``inverse(y)``.

    References
    ----------
    .. [1] D. C. Jiles, D. L. Atherton, "Theory of ferromagnetic hysteresis", Journal of Magnetism
       and Magnetic Materials 61 (1986) 48-60, on anhysteretic curves.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.static import SoftSaturation
    >>> u = np.linspace(-3, 3, 201)
    >>> model = SoftSaturation(fit_center=False).fit(u.reshape(-1, 1), u / (1 + abs(u / 2)))
    >>> round(model.operator_.level, 6), round(model.operator_.knee, 6)
    (2.0, 1.0)
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "sides": [StrOptions(set(_SIDES))],
        "rank": [StrOptions({"drive", "sensor"})],
        "fit_center": ["boolean"],
    }

    def __init__(
        self,
        *,
        sides="both",
        rank="sensor",
        fit_center=True,
        initial_state="rest",
        dt=1.0,
        method="variable_projection",
    ):
        self.sides = sides
        self.rank = rank
        self.fit_center = fit_center
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    @property
    def _rank(self):
        return 0 if self.rank == "drive" else 50

    def _fixed(self):
        return frozenset() if self.fit_center else frozenset({"center"})

    def _starts(self, records):
        low, high = limits_of_drive(records)
        center = 0.5 * (low + high) if self.fit_center else 0.0
        reach = max(high - center, center - low) or 1.0
        return [
            (SoftSaturationOperator(part * reach, n, center, _SIDES[self.sides], self._rank), ())
            for part in _LEVELS
            for n in _KNEES
        ]
