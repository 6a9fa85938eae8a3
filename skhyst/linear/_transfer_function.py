"""Rational transfer function."""

from numbers import Integral, Real

import numpy as np

from .._sklearn import Interval, StrOptions
from ..operators import DelayOperator, SeriesOperator, TransferFunctionOperator
from ..optimize import pole_starts, sections
from ._base import LinearModel, log_grid, time_span

__all__ = ["TransferFunction"]


class TransferFunction(LinearModel):
    r"""Rational transfer function with a delay.

    .. math:: G(s) = e^{-\theta s} \frac{N(s)}{D(s)}

    The poles are stable by construction, the numerator is solved exactly for given poles.

    Parameters
    ----------
    n_poles : int, default=2
        Degree of the denominator.
    n_zeros : int, default=0
        Degree of the numerator, at most ``n_poles``.
    delay : float or "fit", default=0.0
        Delay in s, fixed, or fitted.
    fit_gain, fit_intercept : bool, default=True
        Whether the static gain (1 otherwise) and a constant response (0 otherwise) are fitted.
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
    operator_ : TransferFunctionOperator, behind a DelayOperator where there is a delay
        ``time_constants`` (s), ``natural_frequencies`` (rad/s), ``damping_ratios``, ``numerator``,
        ``gain``, ``intercept``; ``poles()``, ``frequency_response(frequency)``.
    params_, params_std_ : dict
        Parameters and their standard errors.

    Raises
    ------
    ValueError
        If ``n_zeros`` exceeds ``n_poles``.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import TransferFunction
    >>> from skhyst.operators import SecondOrderModeOperator
    >>> drive = np.random.default_rng(0).normal(size=500)
    >>> y, _ = SecondOrderModeOperator(60.0, 0.05, gain=3.0).run(drive, 0.01)
    >>> model = TransferFunction(n_poles=2, dt=0.01).fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.operator_.gain:.3f}")
    3.000
    """

    _parameter_constraints = {
        **LinearModel._parameter_constraints,
        "n_poles": [Interval(Integral, 1, None, closed="left")],
        "n_zeros": [Interval(Integral, 0, None, closed="left")],
        "delay": [Interval(Real, 0, None, closed="left"), StrOptions({"fit"})],
    }

    def __init__(
        self,
        n_poles=2,
        *,
        n_zeros=0,
        delay=0.0,
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
        self.n_poles = n_poles
        self.n_zeros = n_zeros
        self.delay = delay

    def _fixed(self):
        fixed = super()._fixed()
        if self.delay == 0.0:
            return fixed
        fixed = {f"transfer_function__{name}" for name in fixed}
        return frozenset(fixed if self.delay == "fit" else fixed | {"delay__delay"})

    def _starts(self, records):
        if self.n_zeros > self.n_poles:
            raise ValueError(
                "The 'n_zeros' parameter of TransferFunction must be at most 'n_poles' = "
                f"{self.n_poles}. Got {self.n_zeros} instead."
            )
        dt, span = time_span(records)
        data = [(record.u, record.y, record.dt) for record in records]
        candidates = [sections(p) for p in pole_starts(data, self.n_poles)]
        n_first, n_second = self.n_poles % 2, self.n_poles // 2
        for w in log_grid(6.0 / span, 1.5 / dt, 2):
            spread = w * 1.5 ** np.arange(n_second)
            candidates.append((np.full(n_first, 1.0 / w), spread, np.full(n_second, 0.2)))
        starts = []
        for constants, frequencies, dampings in candidates:
            operator = TransferFunctionOperator(
                constants, frequencies, dampings, np.zeros(self.n_zeros), hold=self.hold
            )
            if self.delay != 0.0:
                delay = dt if self.delay == "fit" else float(self.delay)
                operator = SeriesOperator(
                    ("delay", "transfer_function"), (DelayOperator(delay), operator)
                )
            starts.append((operator, ()))
        return starts
