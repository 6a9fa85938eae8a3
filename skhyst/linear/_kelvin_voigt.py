"""Creep as a chain of Kelvin-Voigt units."""

from numbers import Integral

import numpy as np

from .._sklearn import Interval
from ..operators import KelvinVoigtOperator
from ._base import LinearModel, log_grid, time_span

__all__ = ["KelvinVoigt"]

_SPREAD = 10.0  # ratio of neighbouring time constants at the start


class KelvinVoigt(LinearModel):
    r"""Creep: the prompt response plus units that relax.

    .. math:: G(s) = g\,\Bigl(1 + \sum_i \frac{c_i}{\tau_i s + 1}\Bigr)

    This is (3.7) of the thesis with its names put right: there :math:`c_i` is a stiffness and
    :math:`k_i` a damping; here ``compliances`` are relative to the prompt response.

    Parameters
    ----------
    n_units : int, default=2
        Number of relaxing units.
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
    operator_ : KelvinVoigtOperator
        ``compliances`` (n_units,), ``time_constants`` (n_units,) in s, ``gain``.
    params_, params_std_ : dict
        Parameters and their standard errors.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import KelvinVoigt
    >>> from skhyst.operators import KelvinVoigtOperator
    >>> truth = KelvinVoigtOperator(np.array([0.2]), np.array([0.5]))
    >>> drive = np.repeat([0.0, 1.0, -1.0, 0.5], 100)
    >>> y, _ = truth.run(drive, 0.01)
    >>> model = KelvinVoigt(n_units=1, dt=0.01).fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.operator_.time_constants[0]:.3f} s")
    0.500 s
    """

    _parameter_constraints = {
        **LinearModel._parameter_constraints,
        "n_units": [Interval(Integral, 1, None, closed="left")],
    }

    def __init__(
        self,
        n_units=2,
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
        self.n_units = n_units

    def _starts(self, records):
        dt, span = time_span(records)
        slope = _slope(records)
        return [
            (
                KelvinVoigtOperator(
                    np.full(self.n_units, 0.1 / self.n_units),
                    tau * _SPREAD ** np.arange(self.n_units),
                    gain=slope,
                    hold=self.hold,
                ),
                (),
            )
            for tau in log_grid(
                2.0 * dt, max(0.5 * span / _SPREAD ** (self.n_units - 1), 4 * dt), 1
            )
        ]


def _slope(records):
    """Return the least-squares slope of the response over the drive."""
    u = np.concatenate([record.u for record in records])
    y = np.concatenate([record.y for record in records])
    u, y = u - u.mean(), y - y.mean()
    power = u @ u
    return float(u @ y / power) if power > 0.0 else 1.0
