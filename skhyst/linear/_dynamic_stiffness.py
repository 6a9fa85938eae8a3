"""Force of a measured motion: mass, dashpot and spring."""

from numbers import Integral

from .._sklearn import Interval, StrOptions
from ..base import ParametricModel
from ..operators import DynamicStiffnessOperator

__all__ = ["DynamicStiffness"]


class DynamicStiffness(ParametricModel):
    r"""Equation of motion seen from the force: mass, dashpot and spring.

    .. math:: y = m \ddot u + d \dot u + k u + c, \qquad \text{or } y = m \dot u + d u + c

    The drive ``u`` is a measured displacement, or a velocity, and the response the force (current,
    pressure, voltage of a motor) that went with it: the declared model of a damper on a test bench,
    and of a robot's drive whose parameters are identified from its inverse. All parameters are
    linear and solved exactly. A friction force is added beside it in a
    :class:`~skhyst.compose.Sum`.

    Parameters
    ----------
    fit_mass, fit_damping : bool, default=True
        Whether ``m`` and ``d`` are fitted (0 otherwise).
    fit_stiffness : bool, default=True
        Whether ``k`` is fitted (0 otherwise, and for a velocity).
    fit_intercept : bool, default=True
        Whether the response has a constant (a force offset).
    drive : {"displacement", "velocity"}, default="displacement"
        What the drive is.
    smoothing : int, default=1
        Sampling intervals over which slopes are taken. 1 is the backward difference, exact for a
        drive that is straight between samples; take more for an encoder whose noise or steps
        differences would amplify.
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample: at rest there; all zero; or after a rest at a drive
        value that is fitted for each record.
    dt : float, default=1.0
        Sampling interval in s of data without a time index.
    method : str or Method, default="variable_projection"
        How the parameters are identified, see :mod:`skhyst.optimize`.

    Attributes
    ----------
    operator_ : DynamicStiffnessOperator
        ``mass`` in response s^2/drive, ``damping`` in response s/drive, ``stiffness`` in
        response/drive, ``intercept`` in units of the response. Of a velocity, ``mass`` is in
        response s/drive and ``damping`` in response/drive.
    params_, params_std_ : dict
        Parameters and their standard errors.

    Notes
    -----
    Derivatives are taken from the past alone. The velocity lags behind by ``smoothing / 2``
    intervals and the acceleration by ``smoothing``, so keep that short against the motion: a lag
    of the velocity is taken for a mass, about damping times lag.

    Its noise is that of derivatives: with a displacement that has a standard error e, accelerations
    from backward differences have 2.4 e/dt^2. Where the displacement is noisier than the force,
    identify a :class:`SecondOrderMode` from the force instead.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import DynamicStiffness
    >>> time = np.arange(4000) * 0.001
    >>> motion = np.sin(8.0 * time) + np.cos(21.0 * time) - 1.0
    >>> velocity = 8.0 * np.cos(8.0 * time) - 21.0 * np.sin(21.0 * time)
    >>> acceleration = -64.0 * np.sin(8.0 * time) - 441.0 * np.cos(21.0 * time)
    >>> force = 2.0 * acceleration + 30.0 * velocity + 500.0 * motion
    >>> model = DynamicStiffness(dt=0.001).fit(motion[:, None], force)
    >>> print(f"{model.operator_.mass:.2f} {model.operator_.stiffness:.0f}")
    2.01 499

    The velocity lags behind by half an interval, which is taken for a mass of about 30 times
    0.0005.
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "fit_mass": ["boolean"],
        "fit_damping": ["boolean"],
        "fit_stiffness": ["boolean"],
        "fit_intercept": ["boolean"],
        "drive": [StrOptions({"displacement", "velocity"})],
        "smoothing": [Interval(Integral, 1, None, closed="left")],
    }

    _rank = DynamicStiffnessOperator.rank

    def __init__(
        self,
        fit_mass=True,
        *,
        fit_damping=True,
        fit_stiffness=True,
        fit_intercept=True,
        drive="displacement",
        smoothing=1,
        initial_state="rest",
        dt=1.0,
        method="variable_projection",
    ):
        self.fit_mass = fit_mass
        self.fit_damping = fit_damping
        self.fit_stiffness = fit_stiffness
        self.fit_intercept = fit_intercept
        self.drive = drive
        self.smoothing = smoothing
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    def _starts(self, records):
        operator = DynamicStiffnessOperator(drive=self.drive, smoothing=int(self.smoothing))
        return [(operator, ())]

    def _fixed(self):
        free = {
            "mass": self.fit_mass,
            "damping": self.fit_damping,
            "stiffness": self.fit_stiffness,
            "intercept": self.fit_intercept,
        }
        return frozenset(name for name, is_free in free.items() if not is_free)
