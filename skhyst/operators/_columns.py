"""Operators of inputs with several columns, made of operators of one signal."""

from dataclasses import dataclass, replace

import numpy as np

from ._base import Operator, ParameterSpec

__all__ = ["ColumnOperator", "ModulatedOperator", "sensitivity_name"]

_SENSITIVITY = ParameterSpec(unit="1/column")


class _Wrapper(Operator):
    """An operator whose parameters are those of another, and perhaps some more behind them."""

    @property
    def carries_scale(self):
        return self.operator.carries_scale

    @property
    def rank(self):
        return self.operator.rank

    def parameter_specs(self):
        return dict(self.entries())

    def sizes(self):
        return dict.fromkeys((name for name, _ in self.entries()), 1)

    def entries(self):
        return self.operator.entries()

    def pack(self):
        return self.operator.pack()

    def at(self, schedule):
        return replace(self, operator=self.operator.at(schedule))


@dataclass(frozen=True)
class ColumnOperator(_Wrapper):
    """An operator that one column of the input drives.

    Inputs are ``(n_samples, n_inputs)``. It stands first: nothing can come before it in a series.

    Parameters
    ----------
    operator : Operator
    column : int

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.operators import ColumnOperator, GainOperator
    >>> ColumnOperator(GainOperator(3.0), 1).run(np.array([[0.0, 1.0], [0.0, 2.0]]), 0.1)[0]
    array([3., 6.])
    """

    operator: Operator
    column: int

    @property
    def signal_linear(self):
        return self.operator.signal_linear

    def unpack(self, vector):
        return ColumnOperator(self.operator.unpack(vector), self.column)

    def linear_mask(self):
        return self.operator.linear_mask()

    def gauge_entries(self):
        return self.operator.gauge_entries()

    def gauge_mask(self):
        return self.operator.gauge_mask()

    def init(self, u0, initial_state="rest"):
        return self.operator.init(_one(u0, self.column), initial_state)

    def run(self, u, dt, state=None):
        return self.operator.run(_one(u, self.column), dt, state)

    def step(self, state, u, dt):
        return self.operator.step(state, _one(u, self.column), dt)

    def linearize(self, u, du, dt, initial_state="rest"):
        return self.operator.linearize(_one(u, self.column), du, dt, initial_state)


@dataclass(frozen=True)
class ModulatedOperator(_Wrapper):
    r"""An operator whose output is scaled by a column of the input.

    .. math:: y = \Gamma[u] \, (1 + b \, (a - a_0))

    Inputs are ``(n_samples, n_inputs)``. It stands first: nothing can come before it in a series.

    Parameters
    ----------
    operator : Operator
        Of the whole input. One that is modulated already keeps the name of its sensitivity; that of
        the next is ``sensitivity_2`` among the parameters.
    column : int
        Of a.
    reference : float
        ``a_0``, units of the column. Fixed structure.
    sensitivity : float, default=0.0
        ``b``, one over the units of the column.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.operators import ColumnOperator, GainOperator, ModulatedOperator
    >>> gain = ColumnOperator(GainOperator(3.0), 0)
    >>> warm = ModulatedOperator(gain, 1, reference=20.0, sensitivity=0.1)
    >>> warm.run(np.array([[1.0, 20.0], [1.0, 25.0]]), 0.1)[0]
    array([3. , 4.5])
    """

    operator: Operator
    column: int
    reference: float
    sensitivity: float = 0.0

    @property
    def _depth(self):
        return 1 + (self.operator._depth if isinstance(self.operator, ModulatedOperator) else 0)

    def entries(self):
        return [*self.operator.entries(), (sensitivity_name(self._depth), _SENSITIVITY)]

    def pack(self):
        return np.append(self.operator.pack(), self.sensitivity)

    def unpack(self, vector):
        return ModulatedOperator(
            self.operator.unpack(vector[:-1]), self.column, self.reference, float(vector[-1])
        )

    def linear_mask(self):
        return np.append(self.operator.linear_mask(), False)

    def gauge_entries(self):
        return np.append(self.operator.gauge_entries(), False)

    def gauge_mask(self):
        return np.append(self.operator.gauge_mask(), False)

    def init(self, u0, initial_state="rest"):
        return self.operator.init(u0, initial_state)

    def _factor(self, u):
        return 1.0 + self.sensitivity * (_one(u, self.column) - self.reference)

    def run(self, u, dt, state=None):
        y, state = self.operator.run(u, dt, state)
        return y * self._factor(u), state

    def linearize(self, u, du, dt, initial_state="rest"):
        y, dy = self.operator.linearize(u, du, dt, initial_state)
        factor = self._factor(u)
        own = y * (_one(u, self.column) - self.reference)
        return y * factor, np.column_stack([dy * factor[:, None], own])


def sensitivity_name(number):
    """Return what the sensitivity to the first, second, ... column is called as a parameter."""
    return "sensitivity" if number == 1 else f"sensitivity_{number}"


def _one(u, column):
    part = np.asarray(u, dtype=float)[..., column]
    return np.ascontiguousarray(part) if part.ndim else float(part)
