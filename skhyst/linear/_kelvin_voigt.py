"""Creep as a chain of Kelvin-Voigt units."""

import warnings
from dataclasses import replace
from numbers import Integral

import numpy as np

from .._sklearn import Interval
from ..exceptions import ConvergenceWarning
from ._base import LinearModel, log_grid, slope, time_span
from ._dynamics import KelvinVoigtOperator
from ._static_gain import static_gain_error

__all__ = ["KelvinVoigt"]

_SPREAD = 10.0  # ratio of neighbouring time constants at the start
_KNOWN = 0.01  # largest relative standard error of a static gain that counts as determined


class KelvinVoigt(LinearModel):
    r"""Creep: the prompt response plus units that relax.

    .. math:: G(s) = g\,\Bigl(1 + \sum_i \frac{c_i}{\tau_i s + 1}\Bigr)

    This is (3.7) of the thesis with its names put right: there :math:`c_i` is a stiffness and
    :math:`k_i` a damping; here ``compliances`` are relative to the prompt response.

    **Which experiment.** The gain at rest, :math:`g\,(1 + \sum_i c_i)`, is what the drive has after
    all creep. Records whose drive never stops, however many their periods, do not show it: a unit
    slower than their period moves the mean of the response only, and a chain fitted to them may put
    a false offset behind every step. Record steps with rests at least as long as the creep that is
    to be described. ``static_gain_std_`` therefore includes a unit that is ten times slower than
    the longest record and may have been missed, and where it exceeds 1 % of the gain, "static_gain"
    stands in ``identifiability_["undetermined"]`` and a
    :class:`~skhyst.exceptions.ConvergenceWarning` says so. :class:`LogCreep` is the alternative
    where creep goes on over many decades of time.

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
    static_gain_, static_gain_std_ : float
        Gain at rest and its standard error, units of the response over those of the drive.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import KelvinVoigt
    >>> from skhyst.linear import KelvinVoigtOperator
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

    def starting_values(self, records):
        dt, span = time_span(records)
        gain = slope(records) if self.fit_gain else 1.0
        return [
            (
                KelvinVoigtOperator(
                    np.full(self.n_units, 0.1 / self.n_units),
                    tau * _SPREAD ** np.arange(self.n_units),
                    gain=gain,
                    hold=self.hold,
                ),
                (),
            )
            for tau in log_grid(
                2.0 * dt, max(0.5 * span / _SPREAD ** (self.n_units - 1), 4 * dt), 1
            )
        ]

    def _complete(self, result, data):
        super()._complete(result, data)
        operator, state = self.operator_, self._free_run_state()
        if self.initial_state == "estimate":
            drives = zip(data, self.initial_drive_, strict=True)
            data = [replace(record, before=float(drive)) for record, drive in drives]
        self.static_gain_ = float(operator.gain * (1.0 + np.sum(operator.compliances)))
        self.static_gain_std_ = static_gain_error(
            operator, data, fixed=self.held_parameters(), initial_state=state, error=self.fit_error_
        )
        if not self.static_gain_std_ <= _KNOWN * abs(self.static_gain_):
            undetermined = self.identifiability_["undetermined"]
            self.identifiability_["undetermined"] = (*undetermined, "static_gain")
            warnings.warn(
                "The data do not determine the static gain of KelvinVoigt: it is "
                f"{self.static_gain_:.3g} with a standard error of {self.static_gain_std_:.2g}, "
                "since a slow unit would not have shown. Add a record with steps and rests as long "
                "as the creep.",
                ConvergenceWarning,
                stacklevel=3,
            )
        return self
