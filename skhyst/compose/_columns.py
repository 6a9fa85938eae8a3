"""Models that are driven by a further column of X, or scaled by it."""

from dataclasses import replace
from numbers import Integral, Real
from typing import Self

import numpy as np

from .._sklearn import HasMethods, Interval, StrOptions
from .._validation import common_parameter
from ..base import ParametricModel, as_node, informed, with_params
from ..linear import FirstOrderLagOperator
from ..operators import OnColumnOperator, Scaled, add_disturbances, can_scale, split_disturbances

_CONSTANT = 1e-3  # largest spread within a record of a constant column, relative to its magnitude


def amplitude(drive):
    """Return half the range of a record's drive."""
    return float(np.ptp(0.5 * drive))  # halved first: the range of extreme values would overflow


def is_constant(values, size):
    """Whether a column is constant within a record; ``size`` is its largest magnitude overall."""
    return bool(np.ptp(values) <= _CONSTANT * size)


def _mean(records, column, magnitude=False):
    """Return the mean of a column of the inputs of all records, or of its magnitude."""
    values = np.concatenate([r.u[:, column] for r in records])
    return float((np.abs(values) if magnitude else values).mean())


def lags_of_column(records):
    """Return starting lags of a column, a decade apart, from two samples to half a record."""
    dt = min(record.dt for record in records)
    span = max(len(record.u) * record.dt for record in records)
    times = np.geomspace(2.0 * dt, max(0.5 * span, 4.0 * dt), max(int(np.log10(span / dt)) + 1, 2))
    return [FirstOrderLagOperator(float(time)) for time in times]


class AroundModel(ParametricModel):
    """Base of the models around another model.

    Parameters
    ----------
    estimator : estimator
        A parametric model of skhyst, or a cascade of them, of one input.
    initial_state : {"rest", "zero", "estimate"} or None, default=None
        State before each record's first sample; None: that of the model.
    dt : float or None, default=None
        Sampling interval in s of data without a time index; None: that of the model.
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "initial_state": [*ParametricModel._parameter_constraints["initial_state"], None],
        "estimator": [HasMethods(["fit", "predict"])],
    }

    around_columns = False  # whether the model inside may read columns of X

    def held_parameters(self) -> frozenset[str]:
        return self.estimator.held_parameters()

    def with_hold(self, hold):
        estimator = self.estimator.with_hold(hold)
        return self if estimator is self.estimator else with_params(self, estimator=estimator)

    def _starting_model(self, model):
        """Return the model inside with the initial state of the whole."""
        return with_params(model, initial_state=common_parameter(self, "initial_state"))

    def _check_estimator(self):
        if not isinstance(self.estimator, ParametricModel):
            raise TypeError(
                f"The 'estimator' parameter of {type(self).__name__} must be a parametric model of "
                f"skhyst. Got {self.estimator!r} instead."
            )
        if self.estimator.reads_columns and not self.around_columns:
            raise TypeError(
                f"The 'estimator' parameter of {type(self).__name__} must be a model of one input. "
                f"Got {self.estimator!r}, which reads columns of X, instead."
            )
        self.estimator._validate_params()  # its `fit`, which would validate, is not called


class _ColumnModel(AroundModel):
    """Base of the models that read further columns of X."""

    _parameter_constraints = {
        **AroundModel._parameter_constraints,
        "column": [Interval(Integral, 0, None, closed="left")],
    }
    reads_columns = True

    def __init__(
        self,
        estimator,
        column=1,
        *,
        initial_state=None,
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        self.estimator = estimator
        self.column = column
        self.initial_state = initial_state
        self.dt = dt
        self.drive = drive
        self.method = method

    @property
    def stage_order(self) -> int:
        return self.estimator.stage_order

    def operator_input(self, X, slices):
        self._check_estimator()
        model = informed(self.estimator, self)
        signal, schedules = model.operator_input(X, slices)
        signal = signal if model.reads_columns else X
        if self.column != "amplitude":
            if self.column >= X.shape[1]:
                raise ValueError(
                    f"The 'column' parameter of {type(self).__name__} must be the number of a "
                    f"column of X, which has {X.shape[1]}. Got {self.column} instead."
                )
            return signal, schedules
        if signal.shape[1] > X.shape[1]:  # the model reads the amplitudes itself
            return signal, schedules
        amplitudes = np.empty(len(X))
        for s in slices:
            amplitudes[s.rows] = amplitude(X[s.rows, 0])
        return np.column_stack([X, amplitudes]), schedules

    def _driven(self):
        """Return the model of the operator inside."""
        return self.estimator

    def subtree(self, driven, disturbances):
        inside = self._driven().subtree(driven.operator, disturbances)
        return replace(driven, operator=inside, model=as_node(self, estimator=None))


class OnColumn(_ColumnModel):
    """A model that is driven by one column of X, such as a temperature.

    It is added to the model of the drive in a :class:`Sum`. If that is the first step of a
    :class:`Cascade`, the column acts on the input of the later steps, as a bias voltage does.

    Parameters
    ----------
    column : int, default=1
        Number of the column of X.
    centered : bool, default=False
        Whether the mean of the column over the records of the fit is subtracted. Otherwise a column
        that is added to the drive shifts the thresholds and curves of the driven model.

    Attributes
    ----------
    operator_ : OnColumnOperator

    See Also
    --------
    Modulated : A response that is scaled by a column.
    Sum : Adds the response to the column to another response.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.compose import OnColumn, Sum
    >>> from skhyst.linear import Gain
    >>> X = np.random.default_rng(0).normal(size=(100, 2))
    >>> y = 3.0 * X[:, 0] + 0.5 * X[:, 1]
    >>> model = Sum([("drive", Gain()), ("temperature", OnColumn(Gain(), 1))]).fit(X, y)
    >>> round(model.operators_["temperature"].operator.gain, 6)
    0.5
    """

    _parameter_constraints = {**_ColumnModel._parameter_constraints, "centered": ["boolean"]}

    def __init__(
        self,
        estimator,
        column=1,
        *,
        centered=False,
        initial_state=None,
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        super().__init__(
            estimator, column, initial_state=initial_state, dt=dt, drive=drive, method=method
        )
        self.centered = centered

    def starting_values(self, records):
        reference = _mean(records, self.column) if self.centered else 0.0
        column_records = [
            replace(r, u=np.ascontiguousarray(r.u[:, self.column]) - reference) for r in records
        ]
        starts = map(
            split_disturbances, self._starting_model(self.estimator).starting_values(column_records)
        )
        return [
            add_disturbances(OnColumnOperator(driven, self.column, reference), additive)
            for driven, additive in starts
        ]

    def unfitted(self, operator) -> Self:
        centered = self.centered or operator.reference != 0.0
        estimator = operator.operator.unfitted()
        return with_params(self, estimator=estimator, column=operator.column, centered=centered)


class FirstColumn(OnColumn):
    """A model of the drive within a model that reads all columns; a node of the tree only."""

    def subtree(self, driven, disturbances):
        return replace(super().subtree(driven, disturbances), model=None)


class Modulated(_ColumnModel):
    r"""A model whose response, or some of its parameters, are scaled by a column of X per sample.

    .. math:: y = \Gamma[u] \, (1 + b \, (a - a_0))

    with the model :math:`\Gamma` of the drive u, the column a (behind a first-order lag, if
    requested) or the half range of the drive in each record, and a reference :math:`a_0`. If
    parameters are scaled, the factor applies to them instead of the response: a friction force that
    grows with the load, a hysteresis whose width depends on the temperature. It is the outermost
    model, the first step of a :class:`Cascade`, a step of a :class:`Sum`, or is modulated again by
    another column.

    Parameters
    ----------
    estimator : estimator
        A parametric model of skhyst, or a cascade of them, of one input; or another ``Modulated``.
    column : int or "amplitude", default=1
        Number of the column of X, or the half range of the drive in a record. 0 is the drive, such
        as the position at which friction acts.
    scales : "response", "thresholds" or list of str, default="response"
        What is scaled: the whole response; all thresholds of a
        :class:`~skhyst.hysteresis.PrandtlIshlinskii`; ``["friction"]`` of a
        :class:`~skhyst.hysteresis.FreeMass`, :class:`~skhyst.hysteresis.FrictionStage`,
        :class:`~skhyst.hysteresis.BoucWenStage` or :class:`~skhyst.hysteresis.RestoringForce`: all
        friction but the viscous one, or the hysteretic force, in the equation of motion; or
        parameters in which the response is linear, by their names in ``params_``, such as
        ``["coulomb_force"]``. ``"weights"`` stands for all of ``"weights[0]"``, ...
    reference : float or None, default=None
        :math:`a_0`, units of the column, at which the factor is one; None: the mean of a over the
        records of the fit.
    degree : int, default=1
        Degree of the factor as a polynomial in :math:`a - a_0`.
    magnitude : bool, default=False
        Whether a is the magnitude of the column, such as of a bearing's load.
    lag : bool, default=False
        Whether the column acts through a first-order lag, as the current of a coil lags behind its
        voltage, or the temperature of a part behind the power of its heater.

    Attributes
    ----------
    operator_ : Scaled
        ``sensitivity`` b in one over the units of the column, ``curvature``, the coefficients of
        the higher powers, ``reference`` :math:`a_0`, and ``lag``, whose ``time_constant`` is in s.

    Raises
    ------
    ValueError
        If ``scales`` is not as above.

    See Also
    --------
    OnColumn : A model that the column drives.
    ScheduledParameters : Parameters that depend on a value per record.

    Notes
    -----
    A play whose threshold changes stays where it is until an end of its slack moves it: ``F[k] =
    max(u[k] - q[k] r, min(u[k] + q[k] r, F[k - 1]))`` with the factor q, bounded below by zero.
    While the column rests, the model is rate-independent if :math:`\Gamma` is. The friction of a
    mass is bounded below by zero, too; the factor is a straight line between samples.

    The friction :math:`(F_{c0} + \mu |N|) \tanh(v/v_0)` of a load N is that of a `CoulombFriction`
    whose ``coulomb_force`` is scaled by the magnitude of N, with the reference 0: then
    :math:`F_{c0}` is ``coulomb_force``, and :math:`\mu` is ``coulomb_force`` times ``sensitivity``.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.compose import Modulated
    >>> from skhyst.linear import Gain
    >>> X = np.random.default_rng(0).normal(size=(100, 2))
    >>> X[:, 1] -= X[:, 1].mean()
    >>> model = Modulated(Gain(), 1).fit(X, 3.0 * X[:, 0] * (1.0 + 0.1 * X[:, 1]))
    >>> round(model.operator_.sensitivity, 6)
    0.1

    A friction force of 0.5 and 0.2 times a load:

    >>> from skhyst.hysteresis import CoulombFriction
    >>> drive, load = np.sin(np.arange(400) / 9), 5.0 * np.sin(np.arange(400) / 31)
    >>> y = (0.5 + 0.2 * np.abs(load)) * np.tanh(np.diff(drive, prepend=0.0) / 0.01)
    >>> friction = CoulombFriction(fit_damping=False, fit_intercept=False)
    >>> of_load = {"scales": ["coulomb_force"], "magnitude": True, "reference": 0.0}
    >>> model = Modulated(friction, 1, **of_load).fit(np.column_stack([drive, load]), y)
    >>> print(f"{model.params_['coulomb_force']:.3f} {model.params_['sensitivity']:.3f}")
    0.500 0.400
    """

    _parameter_constraints = {
        **_ColumnModel._parameter_constraints,
        "column": [*_ColumnModel._parameter_constraints["column"], StrOptions({"amplitude"})],
        "scales": [StrOptions({"response", "thresholds"}), list, tuple],
        "reference": [Interval(Real, None, None, closed="neither"), None],
        "degree": [Interval(Integral, 1, None, closed="left")],
        "magnitude": ["boolean"],
        "lag": ["boolean"],
    }

    around_columns = True

    def __init__(
        self,
        estimator,
        column=1,
        *,
        scales="response",
        reference=None,
        degree=1,
        magnitude=False,
        lag=False,
        initial_state=None,
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        super().__init__(
            estimator, column, initial_state=initial_state, dt=dt, drive=drive, method=method
        )
        self.scales = scales
        self.reference = reference
        self.degree = degree
        self.magnitude = magnitude
        self.lag = lag

    def _driven(self):
        """Return the modulated model, as one of the whole input."""
        model = informed(self.estimator, self)
        return model if model.reads_columns else FirstColumn(model, 0)

    def starting_values(self, records):
        column = -1 if self.column == "amplitude" else self.column
        reference = self.reference
        if reference is None:
            reference = _mean(records, column, self.magnitude)
        model = self._starting_model(self._driven())
        options = {
            "curvature": (0.0,) * (self.degree - 1),
            "magnitude": self.magnitude,
            "scales": self._scaled(),
        }
        starts = list(map(split_disturbances, model.starting_values(records)))
        for driven, _ in starts:
            self._check_scaled(driven)
        return [
            add_disturbances(Scaled(driven, column, float(reference), lag=lag, **options), additive)
            for driven, additive in starts
            for lag in (lags_of_column(records) if self.lag else [None])
        ]

    def _scaled(self):
        if isinstance(self.scales, str):
            return () if self.scales == "response" else (self.scales,)
        return tuple(self.scales)

    def _check_scaled(self, operator):
        """Refuse to scale parameters that an operator does not have, or not linearly."""
        if self.scales == "response" or can_scale(operator, self._scaled()):
            return
        linear = ", ".join(name for name, spec in operator.entries() if spec.linear)
        raise ValueError(
            "The 'scales' parameter of Modulated must be 'response', 'thresholds' of a "
            "PrandtlIshlinskii, ['friction'] of a FreeMass, or of a FrictionStage, BoucWenStage or "
            "RestoringForce with hysteresis, without hold='bandlimited', or names of parameters in "
            "which the response is linear: "
            f"{linear}. Got {self.scales!r} instead."
        )

    def unfitted(self, operator) -> Self:
        scales = "response" if not operator.scales else list(operator.scales)
        params = {
            "column": "amplitude" if operator.column == -1 else operator.column,
            "scales": "thresholds" if scales == ["thresholds"] else scales,
            "reference": None if self.reference is None else operator.reference,
            "degree": 1 + len(operator.curvature),
            "magnitude": operator.magnitude,
            "lag": operator.lag is not None,
        }
        return with_params(self, estimator=operator.operator.unfitted(), **params)
