"""Mass, spring and damper with LuGre friction."""

from itertools import product

import numpy as np

from ..operators import FrictionStageOperator, LuGreOperator
from ._oscillator import LEVEL, OscillatorModel

__all__ = ["FrictionStage"]

# way before sliding, parts of the response's half range; Stribeck velocity, parts of its root mean
# square speed; fast over slow friction
_WAYS = (0.003, 0.01, 0.03, 0.1, 0.3)
_SPEEDS = (0.15, 0.5, 1.7)
_RATIOS = (0.85, 0.55)
# a law has degenerated: a Stribeck velocity so far beyond all starts, or no fall of friction
_FAR, _FLAT = 5.0, 0.99
_N_RETRIES = 4


class FrictionStage(OscillatorModel):
    r"""Mass, spring and damper with LuGre friction: a positioning stage.

    .. math::

        m \ddot x + d \dot x + k x + F = b u, \qquad
        F = \sigma_0 z + \sigma_1 \dot z + \sigma_2 \dot x, \qquad y = x + c

        \dot z = v - \frac{\sigma_0 |v|}{g(v)} z, \quad
        g(v) = F_c + (F_s - F_c) e^{-(v/v_s)^2}, \quad v = \dot x

    The drive ``u`` is a force or a voltage, the response a displacement. The equation is divided by
    ``b``, since a response to a drive does not tell the mass; :math:`\sigma_2` is part of ``d``,
    since only their sum can be told. Friction levels are then in units of the drive.

    Parameters
    ----------
    stribeck : bool, default=True
        Whether friction falls from ``F_s`` to ``F_c`` as the velocity rises; with False both are
        one.
    fit_bristle_damping : bool, default=True
        Whether :math:`\sigma_1` is fitted (0 otherwise).
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
    operator_ : FrictionStageOperator
        ``natural_frequency`` (rad/s), ``damping_ratio``, ``static_level`` (units of the drive),
        ``coulomb_ratio``, ``stribeck_velocity`` (drive/s), ``bristle_stiffness`` (relative to the
        spring), ``bristle_damping`` (a damping ratio), ``gain``, ``intercept``.
    params_, params_std_ : dict
        Parameters and their standard errors.
    physical_ : dict
        The quantities of the equation above for the given mass, see
        :meth:`FrictionStageOperator.physical <skhyst.operators.FrictionStageOperator.physical>`.

    Notes
    -----
    Starting values come from the balance of forces, in which the friction follows from the measured
    displacement. Then the stage is identified while springs of several stiffnesses tie it to the
    response, and last in a free run. A record should show both sticking and sliding, and sliding
    both below and above the Stribeck velocity; otherwise standard errors and ``identifiability_``
    say which parameters are missing.

    Equations (1) to (4) are printed with ``dz/dt = x - ...`` and the Stribeck curve
    ``exp(-(x / x')^2)``; velocities are meant.

    References
    ----------
    O. Amor, A. Kaddouri, R. Abdessemed, "NARMAX approach for micro positioning stage piezoelectric
    actuator hysteresis identification", (1) to (4); C. Canudas de Wit, H. Olsson, K. J. Astrom, P.
    Lischinsky, "A new model for control of systems with friction", IEEE Trans. Automatic Control
    40(3), 1995.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import FrictionStage
    >>> from skhyst.operators import FrictionStageOperator
    >>> time = np.arange(1500) * 0.01
    >>> drive = np.sin(0.7 * time) + 0.8 * np.sin(2.9 * time) + 0.3 * np.sin(11.0 * time)
    >>> plant = FrictionStageOperator(20.0, 0.5, 0.4, 0.7, 1.5, 10.0, gain=3.0)
    >>> y, _ = plant.run(drive, 0.01)
    >>> model = FrictionStage(fit_bristle_damping=False, mass=2.0, dt=0.01)
    >>> model = model.fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.operator_.static_level:.2f} {model.operator_.coulomb_ratio:.2f}")
    0.40 0.70
    >>> print(f"{model.physical_['stiffness']:.0f}")
    800
    """

    _complete = {"stribeck": True, "fit_bristle_damping": True}

    _parameter_constraints = {
        **OscillatorModel._parameter_constraints,
        "stribeck": ["boolean"],
        "fit_bristle_damping": ["boolean"],
    }

    def __init__(
        self,
        stribeck=True,
        *,
        fit_bristle_damping=True,
        fit_intercept=True,
        mass=1.0,
        n_substeps=None,
        initial_state="rest",
        dt=1.0,
        method="variable_projection",
    ):
        self.stribeck = stribeck
        self.fit_bristle_damping = fit_bristle_damping
        self.fit_intercept = fit_intercept
        self.mass = mass
        self.n_substeps = n_substeps
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    def _laws(self, length, speed):
        kinds = product(_RATIOS, _SPEEDS) if self.stribeck else [(1.0, 1.0)]
        return [
            [(part * length, fraction * speed, ratio) for part in _WAYS]
            for ratio, fraction in kinds
        ]

    def _forces(self, law, y, dt, length):
        way, speed, ratio = law
        return LuGreOperator(way, speed, ratio, 1.0).run(y, dt)[0][:, None]

    def _stage(self, law, mode, scales, factors=None, level=LEVEL):
        way, speed, ratio = law
        gain = mode.gain or scales.length / scales.swing
        level = level * scales.swing if factors is None else np.sign(gain) * float(factors[0])
        if not level > 0.0:
            return None
        return FrictionStageOperator(
            mode.natural_frequency,
            mode.damping_ratio,
            level,
            ratio,
            speed / abs(gain),
            level * abs(gain) / way,
            gain=gain,
            intercept=mode.intercept,
        )

    def _retries(self, stage, stages):
        """Without a fall of friction at the speeds of the records nothing leads back to one."""
        speeds = np.array([start.stribeck_velocity for start in stages])
        seen = speeds.min() / _FAR < stage.stribeck_velocity < speeds.max() * _FAR
        if not self.stribeck or (seen and stage.coulomb_ratio < _FLAT):
            return []
        fast = np.sort(speeds)[-min(_N_RETRIES, len(speeds))]
        return [start for start, speed in zip(stages, speeds, strict=True) if speed >= fast]

    def _fixed(self):
        fixed = super()._fixed()
        if not self.stribeck:
            fixed |= {"stribeck_velocity", "coulomb_ratio"}
        return fixed if self.fit_bristle_damping else fixed | {"bristle_damping"}
