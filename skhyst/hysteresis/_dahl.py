"""Dahl friction model."""

from numbers import Real

import numpy as np

from .._sklearn import Interval
from ..operators import DahlOperator
from ._friction import FrictionModel, half_range, swing

__all__ = ["Dahl"]

_STARTS = np.geomspace(0.003, 1.0, 6)  # presliding displacements, parts of the drive's swing


class Dahl(FrictionModel):
    r"""Dahl friction, with viscous damping and a spring beside it.

    .. math::

        y = F_c w + k u + d \dot u + c, \qquad
        \frac{dw}{du} = \frac{(1 - w \operatorname{sgn} \dot u)^n}{x_c}

    The drive ``u`` is a displacement, the response a force (or anything that follows it). Forces,
    stiffness, damping and intercept are solved exactly; only ``x_c`` is searched.

    Parameters
    ----------
    exponent : float, default=1.0
        Shape ``n`` of the transition from one direction to the other; 1 is exponential, below 1
        the friction saturates after a finite way, above 1 it approaches saturation slowly.
    fit_damping : bool, default=True
        Whether a viscous force ``d`` times the velocity is fitted (0 otherwise).
    fit_stiffness : bool, default=False
        Whether a spring ``k`` is fitted (0 otherwise).
    fit_intercept : bool, default=True
        Whether the response has a constant (a force offset).
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample: at rest after a first loading from zero; all
        zero; or after a rest at a drive value that is fitted for each record.
    dt : float, default=1.0
        Sampling interval in s of data without a time index.
    method : str or Method, default="variable_projection"
        How the parameters are identified, see :mod:`skhyst.optimize`.

    Attributes
    ----------
    operator_ : DahlOperator
        ``presliding_displacement`` in units of the drive, ``coulomb_force`` and ``intercept`` in
        units of the response, ``stiffness`` in response/drive, ``damping`` in response s/drive.
    params_, params_std_ : dict
        Parameters and their standard errors.

    Notes
    -----
    Without damping the model is rate-independent. The velocity at a sample is the backward
    difference of the drive. A force that acts against the direction in which it is counted has
    a negative ``coulomb_force``.

    References
    ----------
    P. R. Dahl, "A solid friction model", The Aerospace Corporation, TOR-0158(3107-18)-1 (1968).

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import Dahl
    >>> from skhyst.operators import DahlOperator
    >>> drive = np.sin(np.linspace(0, 20, 2000))
    >>> y, _ = DahlOperator(0.1, coulomb_force=5.0, damping=0.3).run(drive, 0.01)
    >>> model = Dahl(dt=0.01).fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.operator_.coulomb_force:.2f} {model.operator_.damping:.2f}")
    5.00 0.30
    """

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
        dt=1.0,
        method="variable_projection",
    ):
        self.exponent = exponent
        self.fit_damping = fit_damping
        self.fit_stiffness = fit_stiffness
        self.fit_intercept = fit_intercept
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    def _starts(self, records):
        length, force = swing(records), half_range(records)
        return [
            (DahlOperator(float(part * length), force, exponent=float(self.exponent)), ())
            for part in _STARTS
        ]
