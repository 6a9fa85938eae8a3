"""Creep as a chain of Kelvin-Voigt units: Steinbusch (2020), (3.7), its k_0 part of the gain."""

import warnings
from dataclasses import dataclass, replace
from numbers import Integral
from typing import Self

import numpy as np

from .._sklearn import Interval
from ..base import with_params
from ..disturbance import DriftOperator
from ..exceptions import ConvergenceWarning
from ..operators import Resolution, SumOperator, parameter
from ..optimize import OperatorProblem
from ._first_order_lag import FirstOrderLagOperator
from ._gain import slope
from ._linear import LinearModel, LinearOperator, log_grid, time_span

_PER_DECADE = 2  # time constants per decade that are tried for further units
_SPREAD = 10.0  # ratio of neighbouring time constants at the start
_KNOWN = 0.01  # largest relative standard error of a static gain that counts as determined
_SLOWER = 10.0  # time constant of a unit that the records do not show, in lengths of the longest
_SILENT = 1e-11  # fraction of a column's power below which the column is rounding error
_SINGULAR = 1e-12  # smallest relative eigenvalue of the scaled normal equations
_TOUCHED = 1e-3  # largest part of the gain's gradient along undetermined directions, relative to it


@dataclass(frozen=True)
class KelvinVoigtOperator(LinearOperator):
    """Creep: ``gain (1 + sum_i c_i / (tau_i s + 1))``.

    Parameters
    ----------
    compliances : ndarray of shape (n_units,)
        Coefficients c_i, relative to the prompt response.
    time_constants : ndarray of shape (n_units,)
        Times tau_i in s.

    Raises
    ------
    ValueError
        If there is not one time constant per compliance.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import KelvinVoigtOperator
    >>> creep = KelvinVoigtOperator(np.array([0.1]), np.array([1.0]))
    >>> creep.run([0.0, 1.0, 1.0], dt=1.0)[0].round(3).tolist()
    [0.0, 1.037, 1.077]
    """

    compliances: np.ndarray = parameter(linear=True, lower=0.0)
    time_constants: np.ndarray = parameter(log=True, lower=0.0, unit="s")
    gain: float = parameter(gauge=1.0, unit="response/drive", default=1.0)
    intercept: float = parameter(linear=True, gauge=0.0, unit="response", default=0.0)
    hold: str = "foh"

    resolution = Resolution("Kelvin-Voigt units", "compliances", "time_constants")

    def __post_init__(self):
        super().__post_init__()
        self._require_size("time_constants", np.size(self.compliances), "compliance")

    def finer(self, records):
        """Return time constants of further units, from two samples to the longest record."""
        dt, span = time_span(records)
        return log_grid(2.0 * dt, max(span, 4.0 * dt), _PER_DECADE)

    def in_order(self):
        """Return the operator with its units by time constant; see the base."""
        order = np.argsort(self.time_constants, kind="stable")
        if np.all(np.diff(order) > 0):
            return self
        fields = {name: getattr(self, name)[order] for name in ("compliances", "time_constants")}
        return replace(self, **fields)

    @property
    def n_poles(self):
        return np.size(self.compliances), 0

    def with_poles(self, rates, pairs):
        return replace(self, time_constants=1.0 / np.array(rates))

    def characteristics(self, seen):
        creep = 100.0 * (1.0 - 1.0 / (1.0 + np.sum(self.compliances)))
        return {"creep over the settled response": (creep, "%")}

    def _matrices(self, p):
        n = np.size(self.compliances)
        rates = 1.0 / p[n : 2 * n]
        return np.eye(n)[..., None] * -rates, rates, p[2 * n] * p[:n], p[2 * n]


class KelvinVoigt(LinearModel):
    r"""Creep: the prompt response plus units that relax.

    .. math:: G(s) = g\,\Bigl(1 + \sum_i \frac{c_i}{\tau_i s + 1}\Bigr)

    This is (3.7) of Steinbusch, *Hysteresis and Dynamics Compensation for Accurate Positioning in
    High Speed Piezo Scanning Stages*, 2020, with corrected names: there :math:`c_i` is a stiffness
    and :math:`k_i` a damping; here ``compliances`` are relative to the prompt response.

    **Which experiment.** The static gain, :math:`g\,(1 + \sum_i c_i)`, is the gain after all creep.
    Records whose drive never rests do not determine it, however many periods they have: a unit
    slower than the period only moves the mean of the response, and a chain fitted to such records
    may predict a false offset after every step. Record steps with rests at least as long as the
    creep to be described. ``static_gain_std_`` therefore accounts for a unit ten times slower than
    the longest record that the fit may have missed; where it exceeds 1 % of the gain, "static_gain"
    is listed in ``identifiability_["undetermined"]`` and a
    :class:`~skhyst.exceptions.ConvergenceWarning` is raised. :class:`LogCreep` is the alternative
    where creep extends over many decades of time.

    Parameters
    ----------
    n_units : int, default=2
        Number of relaxing units.

    Attributes
    ----------
    operator_ : KelvinVoigtOperator
        ``compliances`` (n_units,), ``time_constants`` (n_units,) in s, ``gain``.
    static_gain_, static_gain_std_ : float
        Gain at rest and its standard error, units of the response over those of the drive.

    See Also
    --------
    LogCreep : Creep over decades of time with one parameter.
    skhyst.disturbance.Drift : Slow motion whatever the drive.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import KelvinVoigt, KelvinVoigtOperator
    >>> truth = KelvinVoigtOperator(np.array([0.2]), np.array([0.5]))
    >>> drive = np.repeat([0.0, 1.0, -1.0, 0.5], 100)
    >>> y, _ = truth.run(drive, 0.01)
    >>> model = KelvinVoigt(n_units=1, dt=0.01).fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.operator_.time_constants[0]:.3f} s")
    0.500 s
    """

    operator_class = KelvinVoigtOperator
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
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        self.n_units = n_units
        self.fit_gain = fit_gain
        self.fit_intercept = fit_intercept
        self.hold = hold
        self.initial_state = initial_state
        self.dt = dt
        self.drive = drive
        self.method = method

    def resolved(self, operator) -> Self:
        return with_params(self, n_units=np.size(operator.compliances))

    def starting_values(self, records):
        dt, span = time_span(records)
        gain = slope(records) if self.fit_gain else 1.0
        compliances = np.full(self.n_units, 0.1 / self.n_units)
        ratios = _SPREAD ** np.arange(self.n_units)
        fastest = log_grid(2.0 * dt, max(0.5 * span / ratios[-1], 4 * dt), 1)
        return [
            KelvinVoigtOperator(compliances, tau * ratios, gain=gain, hold=self.hold)
            for tau in fastest
        ]

    def finish(self, result, records):
        super().finish(result, records)
        operator = self.operator_
        if self.initial_state == "estimate":
            drives = zip(records, self.initial_drive_, strict=True)
            records = [replace(record, before=drive) for record, drive in drives]
        self.static_gain_ = float(operator.gain * (1.0 + np.sum(operator.compliances)))
        held = self.held_parameters()
        variance = _static_gain_variance(operator, records, held, self.free_run_state)
        self.static_gain_std_ = float(self.fit_error_ * np.sqrt(variance))
        if not self.static_gain_std_ <= _KNOWN * abs(self.static_gain_):
            undetermined = self.identifiability_["undetermined"]
            self.identifiability_["undetermined"] = (*undetermined, "static_gain")
            warnings.warn(
                "The data do not determine the static gain of KelvinVoigt: it is "
                f"{self.static_gain_:.3g} with a standard error of {self.static_gain_std_:.2g}, "
                "since these records do not show slow creep. Add a record with steps and rests as "
                "long as the creep.",
                ConvergenceWarning,
                stacklevel=3,
            )
        return self


def _static_gain_variance(operator, records, fixed, initial_state):
    """Return the variance of the static gain for a residual of unit power.

    The model is extended by a unit much slower than the records, whose gain the data may not
    determine. Its state before a record is unknown unless the record starts from zero, so an offset
    and a linear trend are free in each record.
    """
    span = max(len(record.u) * record.dt for record in records)
    slow = FirstOrderLagOperator(_SLOWER * span, gain=0.0, hold=operator.hold)
    held = {f"model__{name}" for name in fixed} | {"slow__time_constant", "slow__intercept"}
    disturbances = ()
    if initial_state == "rest":
        disturbances = (DriftOperator(np.zeros(2), span),)
        held.add("model__intercept")
    problem = OperatorProblem(
        SumOperator(("model", "slow"), (operator, slow)),
        records,
        disturbances=disturbances,
        fixed=held,
        initial_state=initial_state,
    )
    blocks = problem.evaluate(problem.x0)
    gram = problem.total(blocks)[:-1, :-1]
    by = {"model__compliances": operator.gain, "slow__gain": 1.0}
    by["model__gain"] = 1.0 + np.sum(operator.compliances)
    gradient = np.array([by.get(name.partition("[")[0], 0.0) for name in problem.names])
    power = np.diag(gram)
    silent = power <= _SILENT * problem.powers(blocks)
    if gradient[silent].any():  # the records do not respond to a parameter of the gain
        return np.inf
    kept = np.flatnonzero(~silent)
    scale = np.sqrt(power[kept])
    values, vectors = np.linalg.eigh(gram[np.ix_(kept, kept)] / np.outer(scale, scale))
    # the variance is infinite if the gain changes along a direction that the data do not determine
    parts = vectors.T @ (gradient[kept] / scale)
    lost = values < _SINGULAR * values[-1]
    if np.linalg.norm(parts[lost]) > _TOUCHED * np.linalg.norm(parts):
        return np.inf
    return np.sum(parts[~lost] ** 2 / values[~lost])
