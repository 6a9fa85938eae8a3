"""Models that a further column of X drives, or whose gain it changes."""

from dataclasses import replace
from numbers import Integral

import numpy as np

from .._sklearn import HasMethods, Interval, StrOptions
from ..base import ParametricModel
from ..operators import ColumnOperator, ModulatedOperator
from ._record_numbers import amplitude

__all__ = ["Modulated", "OnColumn"]


class _ColumnModel(ParametricModel):
    """Base of the models that read more of X than its first column."""

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "estimator": [HasMethods(["fit", "predict"])],
        "column": [Interval(Integral, 0, None, closed="left")],
    }
    _reads_columns = True

    def __init__(
        self, estimator, column=1, *, initial_state="rest", dt=1.0, method="variable_projection"
    ):
        self.estimator = estimator
        self.column = column
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    @property
    def _rank(self):
        return self.estimator._rank

    def _signal(self, X, slices):
        if not isinstance(self.estimator, ParametricModel):
            raise TypeError(
                f"The 'estimator' parameter of {type(self).__name__} must be a parametric model of "
                f"skhyst. Got {self.estimator!r} instead."
            )
        signal = self.estimator._signal(X, slices) if self.estimator._reads_columns else X
        if self.column != "amplitude":
            if self.column >= X.shape[1]:
                raise ValueError(
                    f"The 'column' parameter of {type(self).__name__} must be the number of a "
                    f"column of X, which has {X.shape[1]}. Got {self.column} instead."
                )
            return signal
        if signal.shape[1] > X.shape[1]:  # the model reads the amplitudes already
            return signal
        amplitudes = np.empty(len(X))
        for s in slices:
            amplitudes[s.rows] = amplitude(X[s.rows, 0])
        return np.column_stack([X, amplitudes])

    def _schedules(self, slices, X):
        return self.estimator._schedules(slices, X)

    def _fixed(self):
        return self.estimator._fixed()


class OnColumn(_ColumnModel):
    """A model that one column of X drives, such as a temperature.

    It stands beside the model of the drive in a :class:`Sum`.

    Parameters
    ----------
    estimator : estimator
        A parametric model of skhyst, or a cascade of them, of one input.
    column : int, default=1
        Number of the column of X.
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample; that of the model is not used.
    dt : float, default=1.0
        Sampling interval in s of data without a time index; that of the model is not used.
    method : str or Method, default="variable_projection"
        How the parameters are identified, see :mod:`skhyst.optimize`.

    Attributes
    ----------
    operator_ : ColumnOperator
    params_, params_std_ : dict
        Parameters and their standard errors.

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

    def _starts(self, records):
        own = [replace(r, u=np.ascontiguousarray(r.u[:, self.column])) for r in records]
        return [
            (ColumnOperator(operator, self.column), disturbances)
            for operator, disturbances in self.estimator._starts(own)
        ]


class Modulated(_ColumnModel):
    r"""A model whose response is scaled by a column of X, such as a temperature.

    .. math:: y = \Gamma[u] \, (1 + b \, (a - a_0))

    with the model :math:`\Gamma` of the drive u, the column a, or the half range of the drive in
    each record, and its mean :math:`a_0` in the records of the fit. It stands outermost, or is a
    step of a :class:`Sum`, or is modulated once more by another column.

    Parameters
    ----------
    estimator : estimator
        A parametric model of skhyst, or a cascade of them, of one input; or another `Modulated`.
    column : int or "amplitude", default=1
        Number of the column of X, or the half range of the drive in a record.
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample; that of the model is not used.
    dt : float, default=1.0
        Sampling interval in s of data without a time index; that of the model is not used.
    method : str or Method, default="variable_projection"
        How the parameters are identified, see :mod:`skhyst.optimize`.

    Attributes
    ----------
    operator_ : ModulatedOperator
        ``sensitivity`` b in one over the units of the column, ``reference`` :math:`a_0`.
    params_, params_std_ : dict
        Parameters and their standard errors.

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
    """

    _parameter_constraints = {
        **_ColumnModel._parameter_constraints,
        "column": [*_ColumnModel._parameter_constraints["column"], StrOptions({"amplitude"})],
    }

    def _starts(self, records):
        nested = isinstance(self.estimator, Modulated)
        driven = self.estimator if nested else OnColumn(self.estimator, 0)
        column = -1 if self.column == "amplitude" else self.column
        reference = float(np.concatenate([r.u[:, column] for r in records]).mean())
        return [
            (ModulatedOperator(operator, column, reference), disturbances)
            for operator, disturbances in driven._starts(records)
        ]
