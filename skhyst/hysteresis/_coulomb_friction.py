"""Coulomb friction model."""

from itertools import product
from numbers import Integral

import numpy as np

from .._sklearn import Interval
from ..operators import CoulombFrictionOperator
from ._friction import FrictionModel, half_range, speed_noise, top_speed

__all__ = ["CoulombFriction"]

# parts of the drive's top speed: transition and Stribeck velocities to start from, bounds of both
_TRANSITIONS = (0.0005, 0.005, 0.03, 0.15)
_VELOCITIES = (0.03, 0.1, 0.3, 0.9)
_SLOWEST, _NOISIEST, _FASTEST = 1e-5, 0.1, 3.0
_QUIET = 3.0  # standard errors of the velocity, below which friction follows it


class CoulombFriction(FrictionModel):
    r"""Coulomb friction: a force that depends on the velocity alone.

    .. math::

        y = \left(F_c + F_d e^{-(v/v_s)^2} + a s\right) s + k u + d v + c, \qquad
        s = \tanh(v / v_0), \quad v = \dot u

    The drive ``u`` is a displacement, the response a force (or anything that follows it).
    Velocities ``v_0`` and ``v_s`` are searched, all that is linear then is solved exactly. Take
    :class:`Dahl`, :class:`MaxwellSlip` or :class:`LuGre` where friction builds up with the way
    rather than with the velocity.

    Parameters
    ----------
    stribeck : bool, default=False
        Whether friction is larger by ``F_d`` in slow sliding, below the Stribeck velocity ``v_s``.
    asymmetry : bool, default=False
        Whether friction is ``F_c + a`` forward and ``F_c - a`` backward. In a drive that never
        rests this cannot be told from the constant ``c``.
    fit_damping : bool, default=True
        Whether a viscous force ``d`` times the velocity is fitted (0 otherwise).
    fit_stiffness : bool, default=False
        Whether a spring ``k`` is fitted (0 otherwise).
    fit_intercept : bool, default=True
        Whether the response has a constant (a force offset).
    smoothing : int, default=1
        Sampling intervals over which the velocity is taken, a least-squares slope that lags behind
        by half of them; 1 is the backward difference.
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample: at rest there; all zero; or after a rest at a drive
        value that is fitted for each record.
    dt : float, default=1.0
        Sampling interval in s of data without a time index.
    method : str or Method, default="variable_projection"
        How the parameters are identified, see :mod:`skhyst.optimize`.

    Attributes
    ----------
    operator_ : CoulombFrictionOperator
        ``transition_velocity`` and ``stribeck_velocity`` in drive/s; ``coulomb_force``,
        ``stribeck_force`` F_d, ``asymmetry`` a and ``intercept`` in units of the response;
        ``stiffness`` in response/drive, ``damping`` in response s/drive.
    params_, params_std_ : dict
        Parameters and their standard errors.

    Notes
    -----
    The transition velocity is at least three standard errors of the velocity, as far as that is
    below a tenth of the drive's top speed, so that the force does not chatter while the drive
    rests.

    References
    ----------
    B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, "A survey of models, analysis tools and
    compensation methods for the control of machines with friction", Automatica 30(7), 1994.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import CoulombFriction
    >>> drive = np.sin(np.linspace(0, 20, 2000))
    >>> velocity = np.diff(drive, prepend=0.0) / 0.01
    >>> y = 5.0 * np.tanh(velocity / 0.05) + 0.3 * velocity
    >>> model = CoulombFriction(dt=0.01).fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.operator_.coulomb_force:.2f} {model.operator_.damping:.2f}")
    5.00 0.30
    """

    _parameter_constraints = {
        **FrictionModel._parameter_constraints,
        "stribeck": ["boolean"],
        "asymmetry": ["boolean"],
        "smoothing": [Interval(Integral, 1, None, closed="left")],
    }

    def __init__(
        self,
        stribeck=False,
        *,
        asymmetry=False,
        fit_damping=True,
        fit_stiffness=False,
        fit_intercept=True,
        smoothing=1,
        initial_state="rest",
        dt=1.0,
        method="variable_projection",
    ):
        self.stribeck = stribeck
        self.asymmetry = asymmetry
        self.fit_damping = fit_damping
        self.fit_stiffness = fit_stiffness
        self.fit_intercept = fit_intercept
        self.smoothing = smoothing
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    def _starts(self, records):
        smoothing, force = int(self.smoothing), half_range(records)
        top = top_speed(records, smoothing)
        noise = min(_QUIET * speed_noise(records, smoothing), _NOISIEST * top)
        slowest, fastest = max(_SLOWEST * top, noise), _FASTEST * top
        transitions = np.unique(np.maximum(np.multiply(_TRANSITIONS, top), 1.5 * slowest))
        velocities = np.multiply(_VELOCITIES, top) if self.stribeck else [fastest]
        return [
            (
                CoulombFrictionOperator(
                    float(transition),
                    force,
                    float(velocity),
                    slowest=slowest,
                    fastest=fastest,
                    smoothing=smoothing,
                ),
                (),
            )
            for transition, velocity in product(transitions, velocities)
            if velocity > transition
        ]

    def _fixed(self):
        fixed = super()._fixed()
        if not self.stribeck:
            fixed |= {"stribeck_velocity", "stribeck_force"}
        return fixed if self.asymmetry else fixed | {"asymmetry"}
