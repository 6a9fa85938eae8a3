"""Creep in logarithmic time."""

from numbers import Real

from .._sklearn import Interval, StrOptions
from ..operators import LogCreepOperator
from ._base import LinearModel, log_grid, slope, time_span

__all__ = ["LogCreep"]

_SHORTEST = 0.1  # of the sampling interval
_LONGEST = 10.0  # of the longest record


class LogCreep(LinearModel):
    r"""Creep in logarithmic time: a step's response grows by the same part in every decade.

    .. math:: u = \text{step of size } a \text{ at } t_0 \quad\Rightarrow\quad
       y = g\,a\,\Bigl(1 + \gamma \log_{10}\bigl(1 + \tfrac{t - t_0}{\tau_0}\bigr)\Bigr)

    and for any other drive the superposition of its changes. Two parameters describe creep from
    milliseconds to hours, for which :class:`KelvinVoigt` needs one unit a decade.

    The law has no equilibrium: after a step the response creeps for ever. ``initial_state="rest"``
    therefore means that the drive has stood at its first value so long that the creep still to come
    is taken for none: the response starts at :math:`g u_0` and only later changes of the drive
    creep. With ``"zero"`` the drive comes from zero at the first sample, and creeps.

    Parameters
    ----------
    time_constant : "fit" or float, default="fit"
        :math:`\tau_0` in s, fitted or held; 0.1 s is a convention in the literature. The data
        determine it where the drive changes fast and is sampled densely afterwards; where all
        samples lie far beyond it, its logarithm is a part of the gain.
    fit_gain, fit_intercept : bool, default=True
        Whether the prompt gain (1 otherwise) and a constant response (0 otherwise) are fitted.
    hold : {"foh", "zoh"}, default="foh"
        Drive between samples: a straight line, or constant.
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample.
    dt : float, default=1.0
        Sampling interval in s of data without a time index.
    method : str or Method, default="variable_projection"
        How the parameters are identified, see :mod:`skhyst.optimize`.

    Attributes
    ----------
    operator_ : LogCreepOperator
        ``creep`` (:math:`\gamma`, the part a decade), ``time_constant`` in s, ``gain``. It follows
        the law to 3e-4 of the creep, for ten times the longest record of the fit.
    params_, params_std_ : dict
        Parameters and their standard errors.

    References
    ----------
    T. Fett and G. Thun, "Determination of room-temperature tensile creep of PZT", *Journal of
    Materials Science Letters* 17, 1998.
    H. Jung and D.-G. Gweon, "Creep characteristics of piezoelectric actuators", *Review of
    Scientific Instruments* 71(4), 2000.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.datasets import steps
    >>> from skhyst.linear import LogCreep
    >>> X = steps([0.0, 1.0], hold=[1.0, 100.0], dt=0.1)
    >>> time = np.arange(-10, 1000) * 0.1
    >>> y = np.where(time < 0, 0.0, 1.0 + 0.02 * np.log10(1.0 + np.maximum(time, 0.0) / 0.5))
    >>> model = LogCreep(hold="zoh").fit(X, y)
    >>> print(f"{model.operator_.creep:.4f}, {model.operator_.time_constant:.2f} s")
    0.0200, 0.50 s
    """

    _parameter_constraints = {
        **LinearModel._parameter_constraints,
        "time_constant": [StrOptions({"fit"}), Interval(Real, 0, None, closed="neither")],
    }

    def __init__(
        self,
        time_constant="fit",
        *,
        fit_gain=True,
        fit_intercept=True,
        hold="foh",
        initial_state="rest",
        dt=1.0,
        method="variable_projection",
    ):
        super().__init__(
            fit_gain=fit_gain,
            fit_intercept=fit_intercept,
            hold=hold,
            initial_state=initial_state,
            dt=dt,
            method=method,
        )
        self.time_constant = time_constant

    def _fixed(self):
        held = frozenset() if self.time_constant == "fit" else {"time_constant"}
        return super()._fixed() | held

    def _starts(self, records):
        dt, span = time_span(records)
        if self.time_constant == "fit":
            constants = log_grid(dt, max(span, 10.0 * dt), 1)
        else:
            constants = [self.time_constant]
        options = {"shortest": _SHORTEST * dt, "longest": _LONGEST * span, "hold": self.hold}
        gain = slope(records) if self.fit_gain else 1.0
        return [(LogCreepOperator(0.05, float(tau), gain, **options), ()) for tau in constants]
