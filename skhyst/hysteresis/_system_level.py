"""System-level model: the slope depends on the distance from the last turning point."""

import numpy as np

from .._sklearn import StrOptions
from ..base import ParametricModel
from ..operators import SystemLevelOperator

__all__ = ["SystemLevelHysteresis"]

_DECAYS = (0.1, 1.0, 4.0, 15.0, 60.0)  # starts: decay times the span of the drive


class SystemLevelHysteresis(ParametricModel):
    r"""System-level model of hysteresis: the slope depends on the last turning point.

    .. math:: d(s) = p + \kappa \frac{1 - e^{-\lambda s}}{\lambda}, \qquad s = |u - V_{shift}|

    where :math:`V_{shift}` is the drive at its last turning point. The response is
    :math:`y = c + \int d(s)\, du`, the true integral of the paper's (15), or as printed in (21)
    and (22), :math:`y = c + d(s)\, u + h_s \dot u`, with the causal backward difference as rate.

    Parameters
    ----------
    variant : {"integral", "printed"}, default="integral"
        The integral is rate-independent and continuous. The printed form multiplies by the drive
        in place of integrating, so it jumps where the drive turns.
    fit_intercept : bool, default=True
        Whether the response has a constant.
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample: at rest after a first loading from zero; all
        zero; or after a rest at a drive value that is fitted for each record.
    dt : float, default=1.0
        Sampling interval in s of data without a time index. The integral does not depend on it.
    method : str or Method, default="variable_projection"
        How the parameters are identified, see :mod:`skhyst.optimize`.

    Attributes
    ----------
    operator_ : SystemLevelOperator
        ``slope`` p in response/drive, ``curvature`` kappa in response/drive^2, ``decay`` lambda in
        1/drive and, as printed, ``rate_gain`` h_s in response s/drive.
    params_, params_std_ : dict
        Parameters and their standard errors.

    Notes
    -----
    In terms of the paper, ``slope = d_o + Delta d (1 - gamma)``, ``curvature = Delta d gamma /
    V_c`` and ``decay = 1 / V_c``. Its identified values have ``V_c`` 250 times the largest
    distance: then gamma and V_c appear only as their ratio, which stands in the curvature, and
    the standard error of ``decay`` shows how much is known of V_c alone.

    The only memory is the last turning point, and any reversal of the drive is one, however small:
    use the drive as it was commanded, not a noisy reading of it.

    References
    ----------
    "Modeling and identification of rate dependent hysteresis in piezoelectric actuated nano-stage:
    a gray box neural network based approach", equations (15) to (22). M. Lallart et al.,
    "System-level modeling of nonlinear hysteretic piezoelectric actuators in quasi-static
    operations", Mech. Syst. Signal Process. 116 (2019) 985-996.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import SystemLevelHysteresis
    >>> from skhyst.operators import SystemLevelOperator
    >>> drive = 50.0 - 50.0 * np.cos(np.linspace(0.0, 20.0, 500))
    >>> y, _ = SystemLevelOperator(0.1, 0.002, 0.03).run(drive, 1.0)
    >>> model = SystemLevelHysteresis().fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.operator_.decay:.4f}")
    0.0300
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "variant": [StrOptions({"integral", "printed"})],
        "fit_intercept": ["boolean"],
    }

    _rank = SystemLevelOperator.rank

    def __init__(
        self,
        variant="integral",
        *,
        fit_intercept=True,
        initial_state="rest",
        dt=1.0,
        method="variable_projection",
    ):
        self.variant = variant
        self.fit_intercept = fit_intercept
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    def _starts(self, records):
        # a first loading from zero is a branch too
        span = max(np.ptp(np.append(record.u, 0.0)) for record in records) or 1.0
        return [
            (SystemLevelOperator(0.0, 1.0, decay / span, variant=self.variant), ())
            for decay in _DECAYS
        ]

    def _fixed(self):
        return frozenset() if self.fit_intercept else frozenset({"intercept"})
