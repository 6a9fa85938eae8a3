"""LuGre friction model."""

from itertools import product

from ..operators import LuGreOperator
from ._friction import FrictionModel, half_range, swing, top_speed

__all__ = ["LuGre"]

# presliding displacements, parts of the drive's swing; Stribeck velocities, parts of its top speed
_LENGTHS = (0.003, 0.02, 0.1, 0.5)
_VELOCITIES = (0.03, 0.15, 0.6)
_RATIO = 0.6


class LuGre(FrictionModel):
    r"""LuGre friction: bristles that bend and slip, with the Stribeck effect.

    .. math::

        \dot z = v - \frac{\sigma_0 |v|}{g(v)} z, \quad
        g(v) = F_c + (F_s - F_c) e^{-(v/v_s)^2}, \quad
        y = \sigma_0 z + \sigma_1 \dot z + \sigma_2 v + k u + c

    The drive ``u`` is a displacement, ``v`` its velocity, the response a force (or anything that
    follows it). Searched are ``x_s = F_s/sigma_0``, ``v_s`` and ``F_c/F_s``, which do not depend
    on the unit of the response; all that is linear then (``F_s``, ``sigma_1``, ``sigma_2``, ``k``,
    ``c``) is solved exactly.

    Parameters
    ----------
    stribeck : bool, default=True
        Whether sliding friction falls from ``F_s`` to ``F_c`` as the velocity rises; with False
        ``g = F_s = F_c``.
    fit_bristle_damping : bool, default=True
        Whether ``sigma_1`` is fitted (0 otherwise).
    fit_damping : bool, default=True
        Whether the viscous friction ``sigma_2`` is fitted (0 otherwise).
    fit_stiffness : bool, default=False
        Whether a spring ``k`` beside the friction is fitted (0 otherwise).
    fit_intercept : bool, default=True
        Whether the response has a constant (a force offset).
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample: at rest after a slow first loading from zero; all
        zero; or after a rest at a drive value that is fitted for each record.
    dt : float, default=1.0
        Sampling interval in s of data without a time index.
    method : str or Method, default="variable_projection"
        How the parameters are identified, see :mod:`skhyst.optimize`.

    Attributes
    ----------
    operator_ : LuGreOperator
        ``presliding_displacement`` in units of the drive, ``stribeck_velocity`` in drive/s,
        ``coulomb_ratio`` F_c/F_s, ``static_force`` F_s in units of the response,
        ``bristle_damping`` sigma_1 and ``damping`` sigma_2 in response s/drive;
        ``bristle_stiffness`` sigma_0 and ``coulomb_force`` F_c follow.
    params_, params_std_ : dict
        Parameters and their standard errors.

    Notes
    -----
    The velocity is constant between samples and the bristles are stepped exactly; at a sample the
    velocity is the backward difference of the drive. See :class:`~skhyst.operators.LuGreOperator`.

    References
    ----------
    C. Canudas de Wit, H. Olsson, K. J. Astrom, P. Lischinsky, "A new model for control of systems
    with friction", IEEE Trans. Automatic Control 40(3), 1995; NARMAX-LuGre paper, (1)-(4).

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import LuGre
    >>> from skhyst.operators import LuGreOperator
    >>> time = np.arange(4000) * 0.005
    >>> drive = np.sin(time) + 0.3 * np.sin(4.4 * time) + 0.02 * np.sin(13.0 * time)
    >>> plant = LuGreOperator(0.05, 0.5, 0.6, static_force=8.0, bristle_damping=0.4, damping=0.3)
    >>> y, _ = plant.run(drive, 0.005)
    >>> model = LuGre(dt=0.005).fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.operator_.coulomb_ratio:.3f} {model.operator_.stribeck_velocity:.3f}")
    0.600 0.500
    """

    _parameter_constraints = {
        **FrictionModel._parameter_constraints,
        "stribeck": ["boolean"],
        "fit_bristle_damping": ["boolean"],
    }

    def __init__(
        self,
        stribeck=True,
        *,
        fit_bristle_damping=True,
        fit_damping=True,
        fit_stiffness=False,
        fit_intercept=True,
        initial_state="rest",
        dt=1.0,
        method="variable_projection",
    ):
        self.stribeck = stribeck
        self.fit_bristle_damping = fit_bristle_damping
        self.fit_damping = fit_damping
        self.fit_stiffness = fit_stiffness
        self.fit_intercept = fit_intercept
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    def _starts(self, records):
        length, speed, force = swing(records), top_speed(records), half_range(records)
        velocities, ratio = (_VELOCITIES, _RATIO) if self.stribeck else ((1.0,), 1.0)
        return [
            (LuGreOperator(part * length, velocity * speed, ratio, force), ())
            for part, velocity in product(_LENGTHS, velocities)
        ]

    def _fixed(self):
        fixed = super()._fixed()
        if not self.stribeck:
            fixed |= {"stribeck_velocity", "coulomb_ratio"}
        return fixed if self.fit_bristle_damping else fixed | {"bristle_damping"}
