r"""Dahl friction.

The normalised force ``w`` moves with the displacement alone, ``dw/du = (1 - s w)^n / x_c`` with
``s`` the sign of the motion. The gap ``q = 1 - s w`` to the saturated force then decays along the
path length ``l``: ``dq/dl = -q^n / x_c``, so ``q = q0 exp(-l/x_c)`` for ``n = 1`` and
``q = q0 (1 + (n - 1) q0^(n-1) l/x_c)^(-1/(n-1))`` otherwise; for ``n < 1`` it reaches zero.
"""

import math
from dataclasses import dataclass
from numbers import Real

import numpy as np

from .._sklearn import Interval
from ..operators import OneStateOperator, parameter
from ._common import FrictionModel, force_characteristics, half_range, largest_peak_to_peak

_LONGEST = 1e300  # path in units of x_c; infinity times a gap of zero would be NaN


def dahl_step(w, u0, u1, dt, values):
    """Return the next normalised force and the total force, each with its derivatives."""
    x_c, force, stiffness, damping, intercept, exponent = values
    change = u1 - u0
    by_w, by_x_c = 1.0, 0.0
    if change == 0.0:  # without a direction of motion, the slope is the mean of both
        slope = 1.0
        if exponent != 1.0:
            slope = 0.5 * ((1.0 - w) ** exponent + (1.0 + w) ** exponent)
    else:
        sign = 1.0 if change > 0.0 else -1.0
        path = min(abs(change) / x_c, _LONGEST)
        gap = max(1.0 - sign * w, 0.0)
        # the part of the gap that closes, and w by its change, which keep the digits of small ones
        if exponent == 1.0:
            closed = -math.expm1(-path)
            by_w = 1.0 - closed
            slope = gap * by_w
        else:
            power = exponent - 1.0
            # for power < 0 a gap of zero gives infinity below zero: the force is saturated
            rise = power * gap**power * path
            if rise > -1.0:
                steps = math.log1p(rise) / power
                closed = -math.expm1(-steps)
                by_w = math.exp(-exponent * steps)
                slope = (gap * (1.0 - closed)) ** exponent
            else:
                closed, by_w, slope = 1.0, 0.0, 0.0
        w = min(max(w + sign * gap * closed, -1.0), 1.0)
        by_x_c = -sign * slope * path / x_c
    slope /= x_c
    drag = damping / dt
    y = force * w + stiffness * u1 + drag * change + intercept
    by_u = force * slope + drag
    y_by = (force * by_w, -by_u, by_u + stiffness, force * by_x_c, w, u1, change / dt, 1.0)
    return w, y, (by_w, -slope, slope, by_x_c), y_by


@dataclass(frozen=True)
class DahlOperator(OneStateOperator, step=dahl_step):
    """Dahl friction, a spring, a dashpot and a constant in parallel: the law of :class:`Dahl`.

    Parameters
    ----------
    presliding_displacement : float
        ``x_c``: displacement over which the friction reverses, units of the drive, positive.
    coulomb_force : float
        Force ``F_c`` of steady sliding, units of the response.
    stiffness : float, default=0.0
        Spring ``k`` in response/drive.
    damping : float, default=0.0
        Dashpot ``d`` in response s/drive.
    intercept : float, default=0.0
        Constant ``c`` in units of the response.
    exponent : float, default=1.0
        Shape ``n >= 0`` of the transition. Fixed structure.

    Raises
    ------
    ValueError
        If the exponent is negative.

    Notes
    -----
    The step along the straight line between two samples is exact; the velocity at a sample is that
    of the line that ends there. The state is ``(w, last drive)``, with ``w`` within -1 and 1.

    Examples
    --------
    >>> from skhyst.hysteresis import DahlOperator
    >>> y, state = DahlOperator(1.0, coulomb_force=2.0).run([0.0, 1.0, 40.0, 39.0], dt=1e-3)
    >>> y.round(3)
    array([ 0.   ,  1.264,  2.   , -0.528])
    """

    presliding_displacement: float = parameter(log=True, lower=0.0, unit="drive")
    coulomb_force: float = parameter(linear=True, unit="response")
    stiffness: float = parameter(default=0.0, linear=True, unit="response/drive")
    damping: float = parameter(default=0.0, linear=True, unit="response s/drive")
    intercept: float = parameter(default=0.0, linear=True, gauge=0.0, unit="response")
    exponent: float = 1.0

    owns_gain = True
    stage_order = 10
    structure = ("exponent",)

    def __post_init__(self):
        super().__post_init__()
        self._require("exponent", self.exponent >= 0.0, "not be negative")

    def characteristics(self, seen):
        force = abs(self.coulomb_force)
        return force_characteristics(force, force / self.presliding_displacement)


_STARTS = np.geomspace(0.003, 1.0, 6)  # starting x_c, fractions of the peak-to-peak drive


class Dahl(FrictionModel):
    r"""Dahl friction, with viscous damping and a spring in parallel.

    .. math::

        y = F_c w + k u + d \dot u + c, \qquad
        \frac{dw}{du} = \frac{(1 - w \operatorname{sgn} \dot u)^n}{x_c}

    The drive ``u`` is a displacement, the response a force (or anything that follows it). All but
    ``x_c`` is linear and solved exactly.

    Parameters
    ----------
    exponent : float, default=1.0
        Shape ``n`` of the transition from one direction to the other; 1 is exponential, below 1
        the friction saturates after a finite displacement, above 1 it approaches saturation slowly.

    Attributes
    ----------
    operator_ : DahlOperator
        ``presliding_displacement`` in units of the drive, ``coulomb_force`` and ``intercept`` in
        units of the response, ``stiffness`` in response/drive, ``damping`` in response s/drive.

    See Also
    --------
    LuGre : Bristles, with the Stribeck effect.
    MaxwellSlip : Presliding in straight pieces, by elements that slip.

    Notes
    -----
    Without damping the model is rate-independent. A force that acts against the direction in which
    it is counted has a negative ``coulomb_force``.

    References
    ----------
    Dahl, *A Solid Friction Model*, 1968.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import Dahl, DahlOperator
    >>> drive = np.sin(np.linspace(0, 20, 2000))
    >>> y, _ = DahlOperator(0.1, coulomb_force=5.0, damping=0.3).run(drive, 0.01)
    >>> model = Dahl(dt=0.01).fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.operator_.coulomb_force:.2f} {model.operator_.damping:.2f}")
    5.00 0.30
    """

    operator_class = DahlOperator
    _parameter_constraints = {
        **FrictionModel._parameter_constraints,
        "exponent": [Interval(Real, 0, None, closed="neither")],
    }

    def __init__(
        self,
        exponent=1.0,
        *,
        fit_damping=True,
        fit_stiffness=False,
        fit_intercept=True,
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        super().__init__(initial_state=initial_state, dt=dt, drive=drive, method=method)
        self.exponent = exponent
        self.fit_damping = fit_damping
        self.fit_stiffness = fit_stiffness
        self.fit_intercept = fit_intercept

    def starting_values(self, records):
        force, lengths = half_range(records), (_STARTS * largest_peak_to_peak(records)).tolist()
        return [DahlOperator(x_c, force, exponent=float(self.exponent)) for x_c in lengths]
