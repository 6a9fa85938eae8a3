"""Mass, spring and damper with a Bouc-Wen force."""

from itertools import product
from numbers import Real

import numpy as np

from .._kernels._bouc_wen_stage import follow
from .._sklearn import Interval
from ..operators import BoucWenStageOperator
from ._oscillator import LEVEL, OscillatorModel

__all__ = ["BoucWenStage"]

# level of the force over its first slope, parts of the response's half range; gamma / beta;
# exponent where it is fitted
_WAYS = (0.05, 0.15, 0.5, 1.5, 5.0)
_SHAPES = (-1.3, -0.4, 0.5)
_EXPONENTS = (1.2, 2.5)


class BoucWenStage(OscillatorModel):
    r"""Mass, spring and damper with a Bouc-Wen force: hysteresis with a smooth transition.

    .. math::

        m \ddot x + d \dot x + k x + z = b u, \qquad y = x + c

        \dot z = \alpha \dot x - \beta |\dot x| |z|^{n-1} z - \gamma \dot x |z|^n

    The drive ``u`` is a force or a voltage, the response a displacement. The equation is divided by
    ``b``, since a response to a drive does not tell the mass; the hysteretic force is then in units
    of the drive.

    Parameters
    ----------
    exponent : float, default=1.0
        ``n`` from 1 to 20, sharpness of the transition. Not used where it is fitted.
    fit_exponent : bool, default=False
        Whether ``n`` is fitted.
    fit_intercept : bool, default=True
        Whether the response has a constant.
    mass : float, default=1.0
        Mass of the stage, for ``physical_``; nothing else depends on it.
    n_substeps : int or None, default=None
        Integration steps in a sampling interval. None: as many as the stage that was found needs, a
        tenth of a radian of its fastest motion each, 64 at most.
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample: at rest after a slow first loading from zero; all
        zero; or after a rest at a drive value that is fitted for each record.
    dt : float, default=1.0
        Sampling interval in s of data without a time index.
    method : str or Method, default="variable_projection"
        How the parameters are identified, see :mod:`skhyst.optimize`.

    Attributes
    ----------
    operator_ : BoucWenStageOperator
        ``natural_frequency`` (rad/s), ``damping_ratio``, ``hysteresis_stiffness`` (relative to the
        spring), ``level`` (units of the drive), ``shape`` (:math:`\gamma / \beta`), ``exponent``,
        ``gain``, ``intercept``.
    params_, params_std_ : dict
        Parameters and their standard errors.
    physical_ : dict
        The quantities of the equation above for the given mass, see
        :meth:`BoucWenStageOperator.physical <skhyst.operators.BoucWenStageOperator.physical>`.

    Notes
    -----
    Starting values come as those of :class:`FrictionStage`. Records should show motions both small
    and large against the way on which the force bends; a force that hardly bends is a part of the
    spring, and standard errors and ``identifiability_`` say so. Unlike that of :class:`BoucWen`,
    the law may lack a limit (:math:`\gamma < -\beta`), since the spring limits the motion.

    References
    ----------
    R. Bouc, "Forced vibration of mechanical systems with hysteresis", 1967; Y.-K. Wen, "Method for
    random vibration of hysteretic systems", J. Eng. Mech. Div. 102, 1976. J.-P. Noel and
    M. Schoukens, "Hysteretic benchmark with a dynamic nonlinearity", Workshop on Nonlinear System
    Identification Benchmarks, 2016.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import BoucWenStage
    >>> from skhyst.operators import BoucWenStageOperator
    >>> time = np.arange(1500) * 0.01
    >>> drive = np.sin(0.7 * time) + 0.8 * np.sin(2.9 * time) + 0.3 * np.sin(11.0 * time)
    >>> plant = BoucWenStageOperator(20.0, 0.5, 5.0, 0.3, 0.4, gain=3.0)
    >>> y, _ = plant.run(drive, 0.01)
    >>> model = BoucWenStage(dt=0.01).fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.operator_.level:.2f} {model.operator_.hysteresis_stiffness:.1f}")
    0.30 5.0
    """

    _complete = {"fit_exponent": True}

    _parameter_constraints = {
        **OscillatorModel._parameter_constraints,
        "exponent": [Interval(Real, 1.0, 20.0, closed="both")],
        "fit_exponent": ["boolean"],
    }

    def __init__(
        self,
        exponent=1.0,
        *,
        fit_exponent=False,
        fit_intercept=True,
        mass=1.0,
        n_substeps=None,
        initial_state="rest",
        dt=1.0,
        method="variable_projection",
    ):
        self.exponent = exponent
        self.fit_exponent = fit_exponent
        self.fit_intercept = fit_intercept
        self.mass = mass
        self.n_substeps = n_substeps
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    def _laws(self, length, speed):
        exponents = _EXPONENTS if self.fit_exponent else (float(self.exponent),)
        return [
            [(part * length, shape, exponent) for part in _WAYS]
            for shape, exponent in product(_SHAPES, exponents)
        ]

    def _forces(self, law, y, dt, length):
        force = np.empty_like(y)
        follow(np.ascontiguousarray(y), *law, force)
        return force[:, None]

    def _stage(self, law, mode, scales, factors=None, level=LEVEL):
        way, shape, exponent = law
        gain = mode.gain or scales.length / scales.swing
        stiffness = level * scales.swing * abs(gain) / way if factors is None else factors[0] * gain
        if not stiffness > 0.0:
            return None
        return BoucWenStageOperator(
            mode.natural_frequency,
            mode.damping_ratio,
            float(stiffness),
            float(stiffness * way / abs(gain)),
            shape,
            exponent,
            gain=gain,
            intercept=mode.intercept,
        )

    def _fixed(self):
        fixed = super()._fixed()
        return fixed if self.fit_exponent else fixed | {"exponent"}
