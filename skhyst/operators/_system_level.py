"""The system-level model: the slope depends on the distance from the last turning point."""

from dataclasses import dataclass

import numpy as np

from .._kernels._arrays import as_signal
from .._kernels._system_level import system_level_run, system_level_tangents
from ._base import Operator, parameter

__all__ = ["SystemLevelOperator"]


@dataclass(frozen=True)
class SystemLevelOperator(Operator):
    r"""Hysteresis whose slope depends on the distance from the drive's last turning point.

    .. math:: d(s) = p + \kappa \frac{1 - e^{-\lambda s}}{\lambda}, \qquad s = |u - V_{shift}|

    ``variant="integral"``: :math:`y = c + \int d(s)\, du`, rate-independent.
    ``variant="printed"``: :math:`y = c + d(s)\, u + h_s \dot u`, where the rate is the backward
    difference ``(u[k] - u[k-1]) / dt``.

    Parameters
    ----------
    slope : float
        Slope ``p`` just after a turning point, response/drive.
    curvature : float
        Growth ``kappa`` of the slope with the distance, response/drive^2.
    decay : float
        Rate ``lambda`` at which the growth fades, 1/drive, not negative; zero is the Rayleigh law.
    intercept : float, default=0.0
        Constant ``c``, units of the response.
    rate_gain : float, default=0.0
        Weight ``h_s`` of the drive's rate, response s/drive; only with ``variant="printed"``.
    variant : {"integral", "printed"}, default="integral"
        The true integral of the paper's (15), or its (21) and (22), which multiply by the drive.

    Raises
    ------
    ValueError
        If the variant is unknown, ``decay`` is negative, or the integral has a ``rate_gain``.

    Notes
    -----
    The paper's ``d_o``, ``Delta d``, ``gamma`` and ``V_c`` are ``slope = d_o + Delta d (1 -
    gamma)``, ``curvature = Delta d gamma / V_c`` and ``decay = 1 / V_c``; see :meth:`from_paper`.
    While ``s`` is much smaller than ``V_c``, gamma and V_c appear in the curvature alone.

    The state is the tuple (last turning point, response there less the intercept, last drive,
    direction in which it moved last). ``"rest"`` is the first loading from zero to the first
    sample; in ``"zero"`` all four are zero. Both turn at zero, so the integral is the same; only
    the rate of the first sample differs. The integral closes every minor loop, but does not wipe
    it out: beyond the loop it goes on from the last turning point, the only one it knows. The
    printed form jumps where the drive turns.

    References
    ----------
    "Modeling and identification of rate dependent hysteresis in piezoelectric actuated nano-stage:
    a gray box neural network based approach", equations (15) to (22). M. Lallart et al.,
    "System-level modeling of nonlinear hysteretic piezoelectric actuators in quasi-static
    operations", Mech. Syst. Signal Process. 116 (2019) 985-996.

    Examples
    --------
    >>> from skhyst.operators import SystemLevelOperator
    >>> operator = SystemLevelOperator(slope=1.0, curvature=0.5, decay=0.0)
    >>> operator.run([0.0, 2.0, 1.0, 0.0], dt=1.0)[0]
    array([0.  , 3.  , 1.75, 0.  ])
    """

    slope: float = parameter(linear=True, unit="response/drive")
    curvature: float = parameter(linear=True, unit="response/drive^2")
    decay: float = parameter(lower=0.0, unit="1/drive")
    intercept: float = parameter(default=0.0, linear=True, gauge=0.0, unit="response")
    rate_gain: float = parameter(default=0.0, linear=True, unit="response s/drive")
    variant: str = "integral"

    carries_scale = True
    rank = 10

    def __post_init__(self):
        if self.variant not in ("integral", "printed"):
            raise ValueError(
                "The 'variant' parameter of SystemLevelOperator must be 'integral' or 'printed'. "
                f"Got {self.variant!r} instead."
            )
        if not self.decay >= 0.0:
            raise ValueError(
                "The 'decay' parameter of SystemLevelOperator must not be negative. "
                f"Got {self.decay!r} instead."
            )
        if self.variant == "integral" and self.rate_gain != 0.0:
            raise ValueError(
                "The 'rate_gain' parameter of SystemLevelOperator must be 0 with "
                f"variant='integral', which is rate-independent. Got {self.rate_gain!r} instead."
            )

    @classmethod
    def from_paper(cls, delta_d, gamma, v_c, *, d_o=0.0, h_s=0.0, variant="integral"):
        """Return the operator for the parameters of the paper.

        Parameters
        ----------
        delta_d : float
            ``Delta d``, response/drive.
        gamma : float
            No unit.
        v_c : float
            ``V_c``, units of the drive, positive.
        d_o : float, default=0.0
            In (16) a slope (response/drive), in (21) a constant (response).
        h_s : float, default=0.0
            Weight of the drive's rate in (22), response s/drive.
        variant : {"integral", "printed"}, default="integral"
            As in the class.

        Returns
        -------
        operator : SystemLevelOperator

        Notes
        -----
        The factor ``T`` of (22), a constant, belongs to ``delta_d``.
        """
        printed = variant == "printed"
        return cls(
            slope=delta_d * (1.0 - gamma) + (0.0 if printed else d_o),
            curvature=delta_d * gamma / v_c,
            decay=1.0 / v_c,
            intercept=d_o if printed else 0.0,
            rate_gain=h_s,
            variant=variant,
        )

    def parameter_specs(self):
        """Return the identifiable fields; the integral has no ``rate_gain``."""
        specs = super().parameter_specs()
        if self.variant == "integral":
            del specs["rate_gain"]
        return specs

    def init(self, u0, initial_state="rest"):
        """Return the state before the first sample ``u0``; see the Notes of the class."""
        last = float(u0) if initial_state == "rest" else 0.0
        return 0.0, 0.0, last, float(np.sign(last))

    def run(self, u, dt, state=None):
        """Map a drive of shape (n_samples,) to the response; see :meth:`Operator.run`."""
        u = as_signal(u)
        y = np.empty(u.size)
        if state is None:
            state = self.init(u[0] if u.size else 0.0)
        state = system_level_run(
            u,
            float(self.slope),
            float(self.curvature),
            float(self.decay),
            float(self.intercept),
            float(self.rate_gain) / dt,
            self.variant == "printed",
            *state,
            y,
        )
        return y, state

    def linearize(self, u, du, dt, initial_state="rest"):
        """Return the response and its tangents; see :meth:`Operator.linearize`."""
        u, du = as_signal(u), as_signal(du)
        start = self.init(u[0] if u.size else 0.0, initial_state)
        y, _ = self.run(u, dt, start)
        dy = np.empty((u.size, du.shape[1] + self.n_parameters))
        if u.size:
            dlast = du[0] if initial_state == "rest" else np.zeros(du.shape[1])
            system_level_tangents(
                u,
                du,
                float(self.slope),
                float(self.curvature),
                float(self.decay),
                float(self.rate_gain) / dt,
                float(dt),
                self.variant == "printed",
                *start[2:],
                as_signal(dlast),
                dy,
            )
        return y, dy
