"""Nodes of the tree, themselves operators: series, sums, and wrappers of one operator."""

import copy
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from math import comb
from operator import attrgetter

import numpy as np
from numpy.polynomial import Polynomial
from scipy.linalg import block_diag

from .._jit import jit
from ..records import Units
from ._compiled_step import (
    CompiledColumn,
    CompiledFed,
    CompiledLaw,
    CompiledProduct,
    CompiledSeries,
    CompiledSum,
    nothing,
)
from ._held_input import holding_what_moves, holds_of_input, resampled
from ._linear_inverse import InverseLinearOperator
from ._part import JOIN, Stage, StartValues
from ._protocol import MOST_STEPS, Operator, ParameterSpec, propagate
from ._root_inverse import RootInverseOperator, inverse_of

_DRIVEN = "model"  # name of the driven part, where there are additive disturbances
_SENSITIVITY = ParameterSpec(unit="1/column")


def _forwarded(path):
    """Return a property that forwards to an attribute of another operator."""
    name = path.rpartition(".")[2]
    return property(attrgetter(path), doc=f"The ``{name}`` of the operator within.")


def _of_stages(which, name):
    """Return a property that is true where an attribute of all or any stages is."""
    return property(
        lambda node: which(getattr(stage, name) for stage in node.stages),
        doc=f"Whether {which.__name__} stages have ``{name}``.",
    )


class _ByEntries(Operator, StartValues):
    """An operator whose entries do not correspond to fields of its own."""

    def parameter_specs(self):
        return dict(self.entries())

    @cached_property
    def n_parameters(self):
        """Number of values in :meth:`pack`."""
        return len(self.entries())


class WrappedOperator(_ByEntries):
    """Base of nodes that wrap one operator, the field ``operator``, and forward its members."""

    signal_linear = _forwarded("_like.signal_linear")
    owns_gain = _forwarded("_like.owns_gain")
    stage_order = _forwarded("_like.stage_order")
    n_poles = _forwarded("_like.n_poles")
    memoryless = _forwarded("_like.memoryless")
    causal = _forwarded("_like.causal")
    at_once = _forwarded("_like.at_once")
    reads_columns = _forwarded("_like.reads_columns")
    linear_mode = _forwarded("_like.linear_mode")
    entries = _forwarded("_like.entries")
    pack = _forwarded("_like.pack")

    @property
    def _like(self):
        return self.operator

    @property
    def children(self):
        return (self._like,)

    def unpack(self, vector):
        return self._with_values({"operator": self.operator.unpack(vector)})

    def at(self, schedule):
        return self._with(self.operator.at(schedule))

    def init(self, u0, initial_state="rest"):
        return self.operator.init(u0, initial_state)

    def run(self, u, dt, state=None):
        return self.operator.run(u, dt, state)

    def by_start(self, u, dt, start):
        return self.operator.by_start(u, dt, start)

    def starts(self, u, y, dt):
        return self.operator.starts(u, y, dt)

    def compiled_step(self, dt, state):
        return self.operator.compiled_step(dt, state)

    def inverse(self):
        """Return the inverse of the operator within."""
        return inverse_of(self.operator)

    def released(self):
        return replace(self, operator=self.operator.released(), model=None)

    def held_entries(self):
        return self._like.held_entries()

    def split(self):
        driven, disturbances = self.operator.split()
        return self if driven is None else self._with(driven), disturbances

    def inner(self, name=None):
        return Stage(name, bare(self.operator))

    def with_inner(self, stage, name=None):
        return self._with(stage.operator)

    def keys(self, name=None):
        return self._like.keys(name)

    def _with(self, operator):
        """Return the same node around another operator."""
        return self if operator is self.operator else replace(self, operator=operator)


@dataclass(frozen=True)
class FrozenOperator(WrappedOperator):
    """An operator with known parameters: none of them is identified.

    In a series it keeps its own gain and intercept, and does not take over those of others.

    Parameters
    ----------
    operator : Operator
        With its parameters.

    Examples
    --------
    >>> from skhyst.linear import FirstOrderLagOperator
    >>> from skhyst.operators import FrozenOperator
    >>> lag = FirstOrderLagOperator(0.03, gain=1.4)
    >>> lag.n_parameters, FrozenOperator(lag).n_parameters
    (3, 0)
    """

    operator: Operator
    owns_gain = False

    def entries(self):
        return []

    def pack(self):
        return np.empty(0)

    def unpack(self, vector):
        return self

    def unfitted(self):
        return Operator.unfitted(self) if self.model is None else self.model

    def released(self):
        return self.operator.released()

    def held_entries(self):
        return frozenset()

    split, inner, keys = Operator.split, Operator.inner, Operator.keys

    def sensitivities(self, u, du, dt, initial_state="rest"):
        return propagate(self.operator, u, du, dt, initial_state)


@dataclass(frozen=True)
class OnColumnOperator(WrappedOperator):
    """An operator that one column of the input drives.

    Inputs are ``(n_samples, n_inputs)``. In a series it has to be the first stage.

    Parameters
    ----------
    operator : Operator
        Of one input.
    column : int
        Number of the column.
    reference : float, default=0.0
        Value of the column at which the input of the operator is zero. Fixed structure.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import GainOperator
    >>> from skhyst.operators import OnColumnOperator
    >>> OnColumnOperator(GainOperator(3.0), 1).run(np.array([[0.0, 1.0], [0.0, 2.0]]), 0.1)[0]
    array([3., 6.])
    """

    operator: Operator
    column: int
    reference: float = 0.0
    reads_columns = True
    structure_of = "OnColumn"

    @property
    def driving_column(self):
        """Number of the column."""
        return self.column

    @property
    def _is_implied(self):
        """Whether it only passes column 0 to a part of the drive, in a tree that reads columns."""
        return self.model is None and self.column == 0 and self.reference == 0.0

    def unfitted(self):
        return self.operator.unfitted() if self._is_implied else super().unfitted()

    def inner(self, name=None):
        return super().inner(name) if self.column == 0 else None

    def keys(self, name=None):
        return super().keys(name) if self.column == 0 else Operator.keys(self, name)

    def _own(self, u):
        return _one(u, self.column) - self.reference

    def init(self, u0, initial_state="rest"):
        return self.operator.init(self._own(u0), initial_state)

    def run(self, u, dt, state=None):
        return self.operator.run(self._own(u), dt, state)

    def by_start(self, u, dt, start):
        return self.operator.by_start(self._own(u), dt, start)

    def starts(self, u, y, dt):
        return self.operator.starts(self._own(u), y, dt)

    def compiled_step(self, dt, state):
        inner = self.operator.compiled_step(dt, state)
        return CompiledColumn((inner,), self.column, self.reference)

    def step(self, state, u, dt):
        return self.operator.step(state, self._own(u), dt)

    def sensitivities(self, u, du, dt, initial_state="rest"):
        return self.operator.sensitivities(
            self._own(u), _tangents_of(du, self.column), dt, initial_state
        )


@holds_of_input.register
def _(operator: OnColumnOperator):
    return {(operator.column, hold) for _, hold in holds_of_input(operator.operator)}


@jit
def factor_step(a, c, s):
    """Return the factor of :class:`Scaled` for a column; ``s`` is empty.

    ``c`` is (coefficients by powers of ``a - a_0`` from the first, a_0, whether a is a magnitude,
    whether the factor stops at zero).
    """
    coefficients, reference, magnitude, stops = c
    x = (abs(a) if magnitude > 0.0 else a) - reference
    power = factor = 1.0
    for k in range(coefficients.size):
        power *= x
        factor += coefficients[k] * power
    return max(factor, 0.0) if stops > 0.0 else factor


@dataclass(frozen=True)
class Scaled(WrappedOperator):
    r"""An operator whose output, or some parameters, are scaled by a column of the input.

    .. math:: y = \Gamma[u] \, (1 + b \, (a - a_0) + c_2 (a - a_0)^2 + ...)

    With a ``lag``, a is the output of a lag with the column as its input, such as the current of a
    coil for its voltage, or the temperature of a part for the power of its heater. Inputs are
    ``(n_samples, n_inputs)``. In a series it has to be the first stage.

    Parameters
    ----------
    operator : Operator
        Of the whole input. If it is modulated itself, it keeps the name of its sensitivity; that of
        the outer one is ``sensitivity_2`` among the parameters.
    column : int
        Column of a.
    reference : float
        ``a_0``, units of the column. Fixed structure.
    sensitivity : float, default=0.0
        ``b``, one over the units of the column.
    lag : Operator or None, default=None
        Acts on the column, with unit gain, from rest at its first value. Its other values are
        parameters.
    curvature : tuple of float, default=()
        ``c_2``, ..., one over powers of the units of the column.
    magnitude : bool, default=False
        Whether a is the magnitude of the column, or of the output of the lag.
    scales : tuple of str, default=()
        What is scaled: entries in which the output is linear; parameters that the operator scales
        within itself (``scaled_within``), by a factor of zero or above; the whole output by
        default.

    Raises
    ------
    ValueError
        If the operator cannot scale what ``scales`` names.

    See Also
    --------
    Factor : Makes one, by ``operator * Factor(column)``.
    skhyst.compose.Modulated : Its estimator.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import GainOperator
    >>> from skhyst.operators import OnColumnOperator, Scaled
    >>> gain = OnColumnOperator(GainOperator(3.0), 0)
    >>> warm = Scaled(gain, 1, reference=20.0, sensitivity=0.1)
    >>> warm.run(np.array([[1.0, 20.0], [1.0, 25.0]]), 0.1)[0]
    array([3. , 4.5])
    """

    operator: Operator
    column: int
    reference: float
    sensitivity: float = 0.0
    lag: Operator | None = None
    curvature: tuple = ()
    magnitude: bool = False
    scales: tuple = ()
    signal_linear = False
    reads_columns = True
    structure_of = "Modulated"

    @property
    def memoryless(self):
        return self.lag is None and self.operator.memoryless

    def __post_init__(self):
        super().__post_init__()
        wanted = "be names of entries in which the output is linear, or what is scaled within"
        self._require("scales", not self.scales or can_scale(self.operator, self.scales), wanted)

    def inner(self, name=None):
        # scaled parameters belong to this operator, not to a stage that may be replaced
        return None if self.scales else super().inner(name)

    def with_inner(self, stage, name=None):
        return self._with(of_columns(stage.operator))

    def keys(self, name=None):
        if self.scales:
            return Operator.keys(self, name)
        column = "amplitude" if self.column == -1 else str(self.column)
        lag = [(f"lag of column {column}", name) for name, _ in self._of_lag()]
        curve = [(f"scaled by {column}", str(k + 2)) for k in range(len(self.curvature))]
        return [*self.operator.keys(name), ("scaled by", column), *curve, *lag]

    @property
    def _depth(self):
        return 1 + (self.operator._depth if isinstance(self.operator, Scaled) else 0)

    def entries(self):
        suffix = "" if self._depth == 1 else f"_{self._depth}"
        scaled = [(name, replace(spec, additive=False)) for name, spec in self.operator.entries()]
        lag = [(f"lag_{name}{suffix}", spec) for name, spec in self._of_lag()]
        curve = [
            (f"curvature{suffix}[{k}]", ParameterSpec(unit=f"1/column^{k + 2}"))
            for k in range(len(self.curvature))
        ]
        return [*scaled, (f"sensitivity{suffix}", _SENSITIVITY), *curve, *lag]

    def _of_lag(self):
        """Return the entries of the lag that are parameters: all but gain and intercept."""
        entries = [] if self.lag is None else self.lag.entries()
        return [(name, spec) for name, spec in entries if spec.gauge is None]

    def _rows_of_lag(self):
        names = {name for name, _ in self._of_lag()}
        return [i for i, (name, _) in enumerate(self.lag.entries()) if name in names]

    def pack(self):
        lag = [] if self.lag is None else self.lag.pack()[self._rows_of_lag()]
        return np.concatenate([self.operator.pack(), self._coefficients, lag])

    @property
    def _coefficients(self):
        """Coefficients of the factor by powers of ``a - a_0``, from the first."""
        return np.array([self.sensitivity, *self.curvature], dtype=float)

    def unpack(self, vector):
        n, lag = self.operator.n_parameters, self.lag
        sensitivity, *curvature = vector[n : n + 1 + len(self.curvature)]
        if lag is not None:
            values = lag.pack()
            values[self._rows_of_lag()] = vector[n + 1 + len(curvature) :]
            lag = lag.unpack(values)
        changes = {"sensitivity": float(sensitivity), "curvature": tuple(map(float, curvature))}
        return self._with_values(
            {"operator": self.operator.unpack(vector[:n]), "lag": lag, **changes}
        )

    @cached_property
    def _is_within(self):
        return _scales_within(self.operator, self.scales)

    def _scaled_entries(self):
        """Return a mask of the entries that are scaled; an array may be named as a whole."""
        names = [name for name, _ in self.operator.entries()]
        return np.array([not {name, name.split("[")[0]}.isdisjoint(self.scales) for name in names])

    @cached_property
    def _others(self):
        """The operator without its scaled part: with the scaled linear entries at zero."""
        return self.operator.unpack(np.where(self._scaled_entries(), 0.0, self.operator.pack()))

    def __getstate__(self):
        return {k: v for k, v in self.__dict__.items() if k not in ("_others", "_is_within")}

    def _factor_law(self):
        constants = self._coefficients, self.reference, self.magnitude, self._is_within
        return CompiledLaw(factor_step, constants, ())

    def _factor(self, a):
        law = self._factor_law()
        return law.streaming(law.state)(a)

    def init(self, u0, initial_state="rest"):
        # the lag of the column has settled, whatever the drive
        lag = None if self.lag is None else self.lag.init(_one(u0, self.column))
        if self._is_within:
            # at rest the output of the lag, of unit gain, is its input
            [factor] = self._factor(np.array([_one(u0, self.column)]))
            inner = bare(self.operator).scaled_init(_one(u0, 0), factor, initial_state)
        else:
            inner = self.operator.init(u0, initial_state)
            if self.scales:
                inner = inner, self._others.init(u0, initial_state)
        return inner if lag is None else (inner, lag)

    def run(self, u, dt, state=None):
        if state is None:
            state = self.init(np.asarray(u, dtype=float)[0])
        a = _one(u, self.column)
        inner, lag = (state, None) if self.lag is None else state
        if self.lag is not None:
            a, lag = self.lag.run(a, dt, lag)
        factor = self._factor(a)
        if self._is_within:
            y, inner = bare(self.operator).scaled_run(_one(u, 0), factor, dt, inner)
        elif self.scales:
            y, whole = self.operator.run(u, dt, inner[0])
            rest, others = self._others.run(u, dt, inner[1])
            y, inner = rest + factor * (y - rest), (whole, others)
        else:
            y, inner = self.operator.run(u, dt, inner)
            y = y * factor
        return y, inner if self.lag is None else (inner, lag)

    def factor(self, u, dt):
        """Return the factor at each sample of a record.

        Parameters
        ----------
        u : ndarray of shape (n_samples, n_inputs)
            Input.
        dt : float
            Sampling interval in s.

        Returns
        -------
        ndarray of shape (n_samples,)
            No unit.
        """
        a = _one(u, self.column)
        return self._factor(a if self.lag is None else self.lag.run(a, dt)[0])

    def by_start(self, u, dt, start):
        factor = self.factor(u, dt)
        if self._is_within:
            return bare(self.operator).scaled_by_start(_one(u, 0), factor, dt, start)
        dy = self.operator.by_start(u, dt, start)
        rest = self._others.by_start(u, dt, start) if self.scales else 0.0
        return rest + (dy - rest) * factor[:, None]

    def compiled_step(self, dt, state):
        inner, lag = (state, None) if self.lag is None else state
        factor = self._factor_law()
        if self.lag is not None:
            factor = CompiledSeries((self.lag.compiled_step(dt, lag), factor))
        factor = CompiledColumn((factor,), self.column, 0.0)
        if self._is_within:
            return CompiledFed((bare(self.operator).scaled_step(dt, inner), factor))
        if not self.scales:
            return CompiledProduct((self.operator.compiled_step(dt, inner), factor))
        parts = self.operator.compiled_step(dt, inner[0]), self._others.compiled_step(dt, inner[1])
        return CompiledProduct((*parts, factor))

    def _factor_sensitivities(self, u, du, dt):
        """Return the factor and its derivatives by ``du`` and by its own parameters."""
        a, da, m = _one(u, self.column), _tangents_of(du, self.column), du.shape[-1]
        if self.lag is not None:
            a, da = self.lag.sensitivities(a, da, dt)
            da = da[:, [*range(m), *(m + i for i in self._rows_of_lag())]]
        factor = self._factor(a)
        sign = np.sign(a) if self.magnitude else np.ones(len(a))
        x, coefficients = sign * a - self.reference, self._coefficients
        powers = x[:, None] ** np.arange(len(coefficients) + 1)
        slope = sign * (powers[:, :-1] @ (coefficients * np.arange(1, len(coefficients) + 1)))
        da = slope[:, None] * da
        dfactor = np.column_stack([da[:, :m], powers[:, 1:], da[:, m:]])
        if self._is_within:
            dfactor[factor <= 0.0] = 0.0
        return factor, dfactor

    def sensitivities(self, u, du, dt, initial_state="rest"):
        m = du.shape[-1]
        factor, dfactor = self._factor_sensitivities(u, du, dt)
        if self._is_within:
            signals = _one(u, 0), _tangents_of(du, 0), factor, dfactor
            return bare(self.operator).scaled_sensitivities(*signals, dt, initial_state)
        y, dy = self.operator.sensitivities(u, du, dt, initial_state)
        rest, drest = np.zeros_like(y), np.zeros_like(dy)
        if self.scales:
            rest, drest = self._others.sensitivities(u, du, dt, initial_state)
            drest[:, m:][:, self._scaled_entries()] = 0.0
        y, dy = y - rest, drest + (dy - drest) * factor[:, None]
        dfactor = y[:, None] * dfactor
        dy[:, :m] += dfactor[:, :m]
        return rest + y * factor, np.column_stack([dy, dfactor[:, m:]])


@dataclass(frozen=True)
class Scheduled(WrappedOperator):
    """Parameters are polynomials of a schedule, such as the amplitude of the record.

    A polynomial of degree d is given by its Bernstein coefficients over the range of the schedule.
    The parameter stays between the least and the largest of them, so that a bound of the parameter
    is a bound of each coefficient; the first and the last are its values at the ends of the range.

    Parameters
    ----------
    base : Operator
        The operator, for everything but the scheduled values.
    degrees : tuple of int
        Degree of the polynomial of each value of ``base.pack()``.
    coefficients : ndarray of shape (sum(degrees) + len(degrees),)
        Bernstein coefficients, those of one value after the other.
    low, high : float
        Range of the schedule.
    schedule : float, default=None
        Schedule value of the record, set by :meth:`at`.

    Raises
    ------
    ValueError
        If there is not one degree per parameter of ``base``, or the number of coefficients does not
        match the degrees.

    See Also
    --------
    skhyst.compose.ScheduledParameters : Its estimator.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import GainOperator
    >>> from skhyst.operators import Scheduled
    >>> gain = Scheduled(GainOperator(), (1, 0), np.array([1.0, 3.0, 0.0]), low=0.0, high=2.0)
    >>> gain.at(1.0).run(np.array([0.0, 1.0]), dt=1.0)[0]
    array([0., 2.])
    """

    base: Operator
    degrees: tuple
    coefficients: np.ndarray
    low: float
    high: float
    schedule: float | None = field(default=None)
    structure_of = "ScheduledParameters"
    is_scheduled = True

    def __post_init__(self):
        super().__post_init__()
        n = self.base.n_parameters
        is_right = len(self.degrees) == n and all(
            degree in range(MOST_STEPS) for degree in self.degrees
        )
        self._require("degrees", is_right, f"be {n} integers from 0, one per parameter")
        self._require_size("coefficients", sum(self.degrees) + n, "coefficient of a polynomial")

    @property
    def _like(self):
        return self.base

    @property
    def schedule_range(self):
        return (self.low, self.high) if any(self.degrees) else None

    @classmethod
    def constant(cls, base, degrees, low, high):
        """Return an operator whose parameters are the same at all schedule values.

        Parameters
        ----------
        base : Operator
            With the values of all parameters.
        degrees : sequence of int
            Degree of the polynomial of each value of ``base.pack()``.
        low, high : float
            Range of the schedule.

        Returns
        -------
        Scheduled
            With equal coefficients of each value.
        """
        coefficients = np.repeat(base.pack(), np.asarray(degrees, dtype=int) + 1)
        return cls(base, tuple(degrees), coefficients, low, high)

    @classmethod
    def along(cls, stage, low, high, lines, model=None):
        """Return the operator of a stage with some entries linear in the schedule.

        Parameters
        ----------
        stage : Stage
            The stage; its other entries are constant.
        low, high : float
            Range of the schedule.
        lines : dict of (str, str) to array-like of shape (2,)
            Values at ``low`` and at ``high`` by key, see :meth:`keys`.
        model : ScheduledParameters, default=None
            Unfitted estimator; it gets the names of these entries as its ``parameters``.

        Returns
        -------
        Scheduled
            Of degrees 0 and 1.
        """
        base = stage.operator
        values = zip(base.keys(stage.name), base.pack(), strict=True)
        coefficients = [np.asarray(lines.get(key, [value])) for key, value in values]
        rows = zip(base.entries(), coefficients, strict=True)
        names = [name for (name, _), line in rows if len(line) > 1]
        if model is not None:
            model = copy.copy(model).set_params(parameters=names)
        degrees = tuple(len(line) - 1 for line in coefficients)
        return cls(base, degrees, np.concatenate(coefficients), low, high, model=model)

    def entries(self):
        return [
            (f"{name}[{k}]" if degree else name, spec)
            for (name, spec), degree in zip(self.base.entries(), self.degrees, strict=True)
            for k in range(degree + 1)
        ]

    def pack(self):
        return np.array(self.coefficients, dtype=float)

    def unpack(self, vector):
        return self._with_values({"coefficients": np.array(vector, dtype=float)})

    def released(self):
        return replace(self.over(self.base.released()), model=None)

    def over(self, base):
        """Return the same polynomials for a base in which other entries are held.

        Parameters
        ----------
        base : Operator
            With some of the entries of the present base, or more. An entry without a polynomial is
            constant.

        Returns
        -------
        Scheduled
            With polynomials of the entries of ``base`` alone.
        """
        ends = zip(self.base.entries(), self._counts, np.cumsum(self._counts), strict=True)
        known = {name: self.coefficients[end - n : end] for (name, _), n, end in ends}
        values = zip(base.entries(), base.pack(), strict=True)
        polynomials = [known.get(name, np.array([value])) for (name, _), value in values]
        degrees = tuple(len(coefficients) - 1 for coefficients in polynomials)
        coefficients = np.concatenate([np.empty(0), *polynomials])
        return replace(self, base=base, degrees=degrees, coefficients=coefficients)

    split = Operator.split

    def inner(self, name=None):
        """Return the operator at the schedule, or at the mean coefficients if none is set."""
        if self.schedule is not None:
            return Stage(name, self.operator)
        sums = np.add.reduceat(self.coefficients, np.cumsum(self._counts) - self._counts)
        return Stage(name, self.base.unpack(sums / self._counts))

    def with_inner(self, stage, name=None):
        part, values = stage.operator, {}
        for key, value in zip(self.keys(name), self.coefficients, strict=True):
            values[key] = np.append(values.get(key, []), value)
        lines = {key: coefficients for key, coefficients in values.items() if len(coefficients) > 1}
        keys = part.keys(stage.name)
        rows = zip(keys, part.entries(), strict=True)
        free = [key for key, (_, spec) in rows if not spec.held]
        present = dict(zip(keys, part.pack(), strict=True))
        for key in set(lines) - set(free):  # the line of a gain goes to the stage that has it now
            line = lines.pop(key)
            owners = [other for other in free if other[1] == key[1] and other not in lines]
            if key in keys and len(owners) == 1 and line.mean():
                lines[owners[0]] = line * (present[owners[0]] / line.mean())
        return self.along(stage, self.low, self.high, lines, self.model)

    def keys(self, name=None):
        keys = zip(self.base.keys(name), self._counts, strict=True)
        return [key for key, count in keys for _ in range(count)]

    @property
    def _counts(self):
        return np.asarray(self.degrees, dtype=int) + 1

    def at(self, schedule):
        """Return the operator of a record with this schedule."""
        return self._with_values({"schedule": float(schedule)})

    @cached_property
    def _basis(self):
        """The Bernstein polynomials at the schedule, shape of ``coefficients``."""
        if self.schedule is None:
            raise ValueError(
                "The parameters depend on a number of the record: it must be given, to 'at' of the "
                "operator or as the 'schedule' of a stepper."
            )
        span = self.high - self.low
        t = (self.schedule - self.low) / span if span > 0.0 else 0.0
        terms = [(d, k) for d in self.degrees for k in range(d + 1)]
        return np.array([comb(d, k) * t**k * (1.0 - t) ** (d - k) for d, k in terms])

    @cached_property
    def operator(self):
        """The operator with plain parameters at the schedule.

        Beyond the range of the schedule polynomials are extrapolated, up to the parameters' bounds.
        """
        starts = np.cumsum(np.r_[0, self._counts[:-1]])
        values = np.add.reduceat(self.coefficients * self._basis, starts)
        specs = [spec for _, spec in self.base.entries()]
        return self.base.unpack(
            np.clip(values, [spec.lower for spec in specs], [spec.upper for spec in specs])
        )

    def polynomials(self):
        """Return the coefficients by powers of the schedule, lowest first, by name."""
        span = self.high - self.low
        t = Polynomial([-self.low / span, 1.0 / span]) if span > 0.0 else Polynomial([0.0])
        polynomials, start = {}, 0
        for (name, _), d in zip(self.base.entries(), self.degrees, strict=True):
            bernstein = self.coefficients[start : start + d + 1]
            terms = (comb(d, k) * bernstein[k] * t**k * (1 - t) ** (d - k) for k in range(d + 1))
            power = sum(terms, Polynomial([0.0])).coef
            polynomials[name] = np.pad(power, (0, max(d + 1 - len(power), 0)))[: d + 1]
            start += d + 1
        return polynomials

    def __getstate__(self):
        return {k: v for k, v in self.__dict__.items() if k not in ("_basis", "operator")}

    def sensitivities(self, u, du, dt, initial_state="rest"):
        y, dy = self.operator.sensitivities(u, du, dt, initial_state)
        m = du.shape[-1]
        by_coefficients = np.repeat(dy[:, m:], self._counts, axis=1) * self._basis
        return y, np.concatenate([dy[:, :m], by_coefficients], axis=1)


@dataclass(frozen=True)
class _Composition(_ByEntries):
    names: tuple
    stages: tuple

    @property
    def children(self):
        return self.stages

    signal_linear = _of_stages(all, "signal_linear")
    owns_gain = _of_stages(any, "owns_gain")
    memoryless = _of_stages(all, "memoryless")
    causal = _of_stages(all, "causal")
    reads_columns = _of_stages(any, "reads_columns")
    at_once = _of_stages(all, "at_once")

    @property
    def stage_order(self):
        return max((stage.stage_order for stage in self.stages), default=Operator.stage_order)

    @property
    def n_poles(self):
        counts = [stage.n_poles for stage in self.stages]
        return sum(real for real, _ in counts), sum(pairs for _, pairs in counts)

    def linear_mode(self):
        return self.stages[0].linear_mode() if len(self.stages) == 1 else None

    def entries(self):
        return list(self._entries)

    @cached_property
    def _entries(self):
        parts = [stage.entries() for stage in self.stages]
        specs = self._marked([[spec for _, spec in entries] for entries in parts])
        return [
            (f"{name}__{entry}", spec)
            for name, entries, marked in zip(self.names, parts, specs, strict=True)
            for (entry, _), spec in zip(entries, marked, strict=True)
        ]

    def _marked(self, parts):
        """Return the specs of each stage as seen from the whole."""
        return parts

    @property
    def is_composed(self):
        """Whether it is a node of a tree, not the inner structure of a single model."""
        return self.model is None or isinstance(self.model, self.estimator_class())

    def members(self):
        """Return the stages with their names."""
        return [Stage(*pair) for pair in zip(self.names, self.stages, strict=True)]

    def held_entries(self):
        if not self.is_composed:
            return super().held_entries()
        return frozenset(
            f"{name}__{entry}"
            for name, stage in zip(self.names, self.stages, strict=True)
            for entry in stage.held_entries()
        )

    def pack(self):
        return np.concatenate([np.empty(0), *[stage.pack() for stage in self.stages]])

    def unpack(self, vector):
        stages, start = [], 0
        for stage in self.stages:
            end = start + stage.n_parameters
            stages.append(stage.unpack(vector[start:end]))
            start = end
        return self._with_values({"stages": tuple(stages)})

    @cached_property
    def n_parameters(self):
        return sum([stage.n_parameters for stage in self.stages])

    def in_order(self):
        return self.with_stages([stage.in_order() for stage in self.stages])

    def with_stages(self, stages):
        """Return the node with other stages of the same names.

        Parameters
        ----------
        stages : sequence of Operator
            As many as the node has.

        Returns
        -------
        Operator
            The node itself if the stages are its own.
        """
        if stages is self.stages:
            return self
        same = all(new is old for new, old in zip(stages, self.stages, strict=True))
        return self if same else replace(self, stages=tuple(stages))

    def normalized(self):
        """Return a copy whose held static gains and intercepts are at their gauge values."""
        return self._at_gauge()

    def _at_gauge(self):
        specs, vector = [spec for _, spec in self.entries()], self.pack()
        values = [s.gauge if s.held else v for s, v in zip(specs, vector, strict=True)]
        return self if values == vector.tolist() else self.unpack(np.array(values, dtype=float))

    def released(self):
        return replace(self, stages=tuple(stage.released() for stage in self.stages), model=None)

    def at(self, schedule):
        return self._with_values({"stages": tuple(stage.at(schedule) for stage in self.stages)})

    def starts(self, u, y, dt):
        return next(stage.starts(u, y, dt) for stage in self.stages if stage.n_start)

    def _compiled_step(self, dt, states):
        """Return each stage's step."""
        return tuple(
            s.compiled_step(dt, state) for s, state in zip(self.stages, states, strict=True)
        )


def _each_resampled(node, own, dt):
    stages = tuple(resampled(stage, own, dt) for stage in node.stages)
    return None if None in stages else replace(node, stages=stages)


@holding_what_moves.register
def _(node: _Composition, name=None):
    return [own for key, part in _keyed(node, name) for own in holding_what_moves(part, key)]


def _keyed(node, name):
    """Return the stages with their full names; those within a single model have its name."""
    if not node.is_composed:
        return [(name, stage) for stage in node.stages]
    return [(own if name is None else f"{name}__{own}", part) for own, part in node.members()]


def _begins(stages, initial_state):
    """Return the initial state of each part; start values are only for a part without rest."""
    if isinstance(initial_state, str):
        return (initial_state,) * len(stages)
    return [initial_state if stage.n_start else "rest" for stage in stages]


class Series(_Composition):
    """Operators in series: the output of one is the input of the next.

    Parameters
    ----------
    names : tuple of str
        Names of the stages.
    stages : tuple of Operator
        In the order of the series.

    See Also
    --------
    SumOperator : Operators in parallel.
    skhyst.compose.Cascade : Its estimator.

    Examples
    --------
    >>> from skhyst.linear import FirstOrderLagOperator, GainOperator
    >>> from skhyst.operators import Series
    >>> series = Series(("gain", "lag"), (GainOperator(2.0), FirstOrderLagOperator(1.0)))
    >>> series.run([0.0, 1.0, 1.0], dt=1.0)[0].round(3).tolist()
    [0.0, 0.736, 1.535]
    """

    structure_of = "Cascade"

    def _marked(self, parts):
        owners, n = self._owners(parts), len(parts)
        held = [
            [s.held or (s.is_shared and i not in owners) for s in specs]
            for i, specs in enumerate(parts)
        ]
        # The response is linear in the parameters of one stage at a time, since those of two
        # stages multiply each other, and only if all later stages are linear in the signal. The
        # stage with most such parameters is chosen: more of them are then solved exactly.
        linear = [
            [s.linear and not is_held for s, is_held in zip(specs, marks, strict=True)]
            for specs, marks in zip(parts, held, strict=True)
        ]
        first = max(n - 1, 0)  # becomes the first stage that only linear ones follow
        while first > 0 and self.stages[first].signal_linear:
            first -= 1
        best = max(range(n - 1, first - 1, -1), key=lambda i: sum(linear[i]), default=None)
        # signals are in units of the drive up to the stage that owns the gain, then of the response
        owner = max(owners, default=n - 1)
        words = ["drive" if i <= owner else "response" for i in range(n + 1)]
        return [
            [
                _set(s, h, is_linear and i == best, s.movable, s.additive and i >= first, around)
                for s, h, is_linear in zip(parts[i], held[i], linear[i], strict=True)
            ]
            for i, around in enumerate(pairwise(words))
        ]

    def _owners(self, parts):
        """Return the number of the stage that keeps gain and intercept, in a list; or none."""
        owners = [i for i, stage in enumerate(self.stages) if stage.owns_gain][:1]
        return (
            owners or [i for i, specs in enumerate(parts) if any(s.is_shared for s in specs)][-1:]
        )

    def normalized(self):
        """Return a copy whose held static gains and intercepts are at their gauge values.

        If all stages are linear, the stage that keeps them takes over those of the others.
        """
        return self.with_stages(_gathered(self.stages))._at_gauge()

    def without(self, name):
        """Return the series without a stage; linear ones take over its static gain and intercept.

        Parameters
        ----------
        name : str
            Of the stage.

        Returns
        -------
        Series
            A copy.

        Examples
        --------
        >>> from skhyst.linear import FirstOrderLagOperator, SecondOrderModeOperator
        >>> from skhyst.operators import Series
        >>> stages = SecondOrderModeOperator(30.0, 0.1), FirstOrderLagOperator(0.1, gain=2.0)
        >>> Series(("mode", "lag"), stages).without("lag").stages[0].gain
        2.0
        """
        at = self.names.index(name)
        names = self.names[:at] + self.names[at + 1 :]
        return replace(self, names=names, stages=_gathered(self.stages, without=at))

    def series(self, name=None):
        if not self.is_composed:
            return super().series(name)
        return self.members()

    def keys(self, name=None):
        if not self.is_composed:
            return super().keys(name)
        return [
            key for stage_name, stage in self.series() for key in Operator.keys(stage, stage_name)
        ]

    def init(self, u0, initial_state="rest"):
        states, begins = [], _begins(self.stages, initial_state)
        for stage, begin in zip(self.stages, begins, strict=True):
            state = stage.init(u0, begin)
            states.append(state)
            if len(states) < len(self.stages):
                # the output at rest is the rest input of the next stage, whatever the interval
                u0 = stage.run(np.array([u0], dtype=float), 1.0, state)[0][0]
        return tuple(states)

    def run(self, u, dt, state=None):
        states = []
        for stage, old in zip(self.stages, state or [None] * len(self.stages), strict=True):
            u, new = stage.run(u, dt, old)
            states.append(new)
        return u, tuple(states)

    def compiled_step(self, dt, state):
        return CompiledSeries(self._compiled_step(dt, state))

    def ahead(self, dt, u0, tol=1e-9):
        """Return the steps of the stages and their total preview; see the base class."""
        compiled_step, samples = [], 0
        for stage in self.stages:
            stage_step, preview = stage.ahead(dt, u0, tol)
            compiled_step.append(stage_step)
            samples += preview
            u0 = stage.run(np.array([u0]), dt)[0][0]
        return CompiledSeries(tuple(compiled_step)), samples

    def inverse(self):
        """Return the series of the inverses, last stage first."""
        return Series(self.names[::-1], tuple(map(inverse_of, reversed(self.stages))))

    def sensitivities(self, u, du, dt, initial_state="rest"):
        begins = _begins(self.stages, initial_state)
        for stage, state in zip(self.stages, begins, strict=True):
            u, du = stage.sensitivities(u, du, dt, state)
        return u, du

    def by_start(self, u, dt, start):
        du = np.zeros((len(u), len(start)))
        for stage, state in zip(self.stages, _begins(self.stages, start), strict=True):
            by_own_start = stage.by_start(u, dt, start) if stage.n_start else 0.0
            u, du = propagate(stage, u, du, dt, state)
            du = du + by_own_start
        return du


@propagate.register
def _(series: Series, u, du, dt, initial_state="rest"):
    begins = _begins(series.stages, initial_state)
    for stage, state in zip(series.stages, begins, strict=True):
        u, du = propagate(stage, u, du, dt, state)
    return u, du


@resampled.register
def _(series: Series, own, dt):
    # behind other stages the input is no straight line between samples
    straight = all(getattr(stage, "keeps_lines", False) for stage in series.stages[:-1])
    return _each_resampled(series, own, dt) if straight else None


@holds_of_input.register
def _(series: Series):
    found = set()
    for stage in series.stages:
        first = series.stages[0].driving_column
        found |= {(first or column, hold) for column, hold in holds_of_input(stage)}
        if stage.moves_at_rest:
            break
    return found


@holding_what_moves.register
def _(series: Series, name=None):
    found, moves = [], False
    for key, stage in _keyed(series, name):
        holds = moves and "zoh" in {hold for _, hold in holds_of_input(stage)}
        found += [key] if holds else holding_what_moves(stage, key)
        moves = moves or stage.moves_at_rest
    return found


class SumOperator(_Composition):
    """Operators in parallel: their outputs are added.

    Parameters
    ----------
    names : tuple of str
        Names of the branches.
    stages : tuple of Operator
        The branches.

    Examples
    --------
    >>> from skhyst.linear import FirstOrderLagOperator, GainOperator
    >>> from skhyst.operators import SumOperator
    >>> total = SumOperator(("gain", "lag"), (GainOperator(2.0), FirstOrderLagOperator(1.0)))
    >>> total.run([0.0, 1.0, 1.0], dt=1.0)[0].round(3).tolist()
    [0.0, 2.368, 2.767]
    """

    structure_of = "Sum"
    has_matrices = _of_stages(all, "has_matrices")

    def _marked(self, parts):
        marked, taken = [], False
        for i, specs in enumerate(parts):
            # A common gain can be factored out of the first branch only. Intercepts add up to one:
            # the first branch with an intercept keeps it.
            constant = [s.gauge == 0.0 for s in specs]
            marked.append(
                [
                    _set(
                        s,
                        s.held or (c and taken),
                        s.linear,
                        s.movable and (c or i == 0),
                        s.additive,
                    )
                    for s, c in zip(specs, constant, strict=True)
                ]
            )
            taken = taken or any(c and not s.held for s, c in zip(specs, constant, strict=True))
        return marked

    def init(self, u0, initial_state="rest"):
        begins = _begins(self.stages, initial_state)
        return tuple(s.init(u0, state) for s, state in zip(self.stages, begins, strict=True))

    def by_start(self, u, dt, start):
        return sum(stage.by_start(u, dt, start) for stage in self.stages if stage.n_start)

    def run(self, u, dt, state=None):
        states, total = [], np.zeros(len(u))
        for stage, old in zip(self.stages, state or [None] * len(self.stages), strict=True):
            y, new = stage.run(u, dt, old)
            total += y
            states.append(new)
        return total, tuple(states)

    @property
    def intercept(self):
        """Sum of the intercepts of the parts, if all are linear."""
        return sum(stage.intercept for stage in self.stages)

    def discrete(self, dt):
        """Return the block-diagonal system of all parts.

        Parameters
        ----------
        dt : float
            Sampling interval in s.

        Returns
        -------
        tuple
            As :meth:`skhyst.linear.LinearOperator.discrete` returns it.
        """
        ad, b0, b1, c, d = zip(*(stage.discrete(dt) for stage in self.stages), strict=True)
        return block_diag(*ad), *map(np.concatenate, (b0, b1, c)), sum(d)

    def inverse(self):
        """Return the inverse of the sum; with a preview if all parts are linear.

        Raises
        ------
        ValueError
            If there are no parts.
        """
        if not self.stages:
            raise ValueError("A sum without terms has no inverse.")
        return InverseLinearOperator(self) if self.has_matrices else RootInverseOperator(self)

    def compiled_step(self, dt, state):
        return CompiledSum(self._compiled_step(dt, state) or (CompiledLaw(nothing, (), ()),))

    def sensitivities(self, u, du, dt, initial_state="rest"):
        m = du.shape[-1]
        total, propagated, by_parameters = np.zeros(len(u)), np.zeros((len(u), m)), []
        begins = _begins(self.stages, initial_state)
        for stage, state in zip(self.stages, begins, strict=True):
            y, dy = stage.sensitivities(u, du, dt, state)
            total += y
            propagated += dy[:, :m]
            by_parameters.append(dy[:, m:])
        return total, np.concatenate([propagated, *by_parameters], axis=1)

    def split(self):
        driven, disturbances = {}, []
        for name, stage in zip(self.names, self.stages, strict=True):
            part, removed = stage.split()
            disturbances += removed
            if not stage.is_disturbance:
                driven[name] = part
        if not disturbances or not self.is_composed:
            return self, ()
        if self.model is None and tuple(driven) == (_DRIVEN,):  # see add_disturbances
            return driven[_DRIVEN], tuple(disturbances)
        parts = {"names": tuple(driven), "stages": tuple(driven.values())}
        return replace(self, **parts), tuple(disturbances)

    @property
    def disturbance_names(self):
        return tuple(n for n, s in zip(self.names, self.stages, strict=True) if s.is_disturbance)

    def parts(self):
        """Return the driven stages, the branches of further columns, and the disturbances."""
        kinds = [], [], []
        for name, stage in zip(self.names, self.stages, strict=True):
            kind = 2 if stage.is_disturbance else int(stage.driving_column != 0)
            kinds[kind].append(Stage(name, bare(stage)))
        return kinds

    @classmethod
    def of_parts(cls, parts, model=None):
        """Return the sum of stages, additive disturbances last.

        If one of them reads columns of the input, the others are given its first column.

        Parameters
        ----------
        parts : sequence of Stage
            The branches.
        model : Sum, default=None
            Unfitted estimator of the node.

        Returns
        -------
        SumOperator
            Of all parts.
        """
        parts = sorted(parts, key=lambda part: part.operator.is_disturbance)
        names, stages = zip(*parts, strict=True)
        if any(stage.reads_columns for stage in stages):
            stages = tuple(map(of_columns, stages))
        return cls(names, stages, model=model)

    def inner(self, name=None):
        driven = self.parts()[0] if self.is_composed else []
        if len(driven) == 1:
            return driven[0]
        if driven and len(driven) < len(self.stages):
            return Stage(_DRIVEN, self.of_parts(driven, self.model).normalized())
        return None

    def with_inner(self, stage, name=None):
        _, branches, disturbances = self.parts()
        return self.of_parts([stage, *branches, *disturbances], self.model).normalized()

    def keys(self, name=None):
        part, (driven, branches, _) = self.inner(name), self.parts()
        if part is None:
            return super().keys(name)
        stage_keys = []
        for stage_name, stage in self.members():
            if stage_name in dict(branches):
                stage_keys += Operator.keys(stage, stage_name)
            elif stage_name in dict(driven):
                keys = bare(stage).keys(stage_name)
                several = [(part.name, f"{stage_name}__{entry}") for entry, _ in stage.entries()]
                stage_keys += keys if len(driven) == 1 else several
        return stage_keys


resampled.register(SumOperator, _each_resampled)


@lru_cache(maxsize=1024)  # of the few specs of a model, in every series that a fit tries
def _set(spec, held, linear, movable, additive, around=("drive", "response")):
    """Return a spec with other marks, and its unit in terms of the units around its stage."""
    marks = {"held": held, "linear": linear, "movable": movable, "additive": additive}
    marks["unit"] = Units(*around).of(spec.unit)
    return spec if marks.items() <= vars(spec).items() else replace(spec, **marks)


def _gathered(stages, without=None):
    """Return stages with static gain and intercept moved to the last linear one.

    ``without`` leaves out a stage. Nothing is moved if a stage owns its gain or is not linear.
    """
    has_owner = any(stage.owns_gain for stage in stages)
    if has_owner and without is None:
        return stages
    kept = [i for i in range(len(stages)) if i != without]
    scaled = [i for i in range(len(stages)) if not has_owner and _has_transferable_gain(stages[i])]
    between = stages[scaled[0] : scaled[-1] + 1] if scaled else ()
    if (
        not set(scaled) & set(kept)
        or not all(stage.signal_linear for stage in between)
        or not all({"gain", "intercept"} <= set(stages[i].parameter_specs()) for i in scaled)
    ):
        return tuple(stages[i] for i in kept)
    owner = max(set(scaled) & set(kept))
    gain, intercept = 1.0, 0.0
    for i in scaled:
        gain *= stages[i].gain
        intercept = stages[i].gain * intercept + stages[i].intercept
    gains = dict.fromkeys(scaled, (1.0, 0.0)) | {owner: (gain, intercept)}
    return tuple(_with_gain(stages[i], *gains[i]) if i in gains else stages[i] for i in kept)


def _has_transferable_gain(stage):
    """Whether a stage has a gain or an intercept that others may take over."""
    specs = [spec for _, spec in stage.entries()]
    mask = [spec.is_shared for spec in specs]
    gauges = [spec.gauge for spec in specs if spec.is_shared]
    is_bare = isinstance(stage, SumOperator) and stage.pack()[mask].tolist() == gauges
    return bool(gauges) and not is_bare


def _with_gain(stage, gain, intercept):
    """Return a linear stage of the same dynamics with another static gain and intercept."""
    specs = stage.parameter_specs()
    if stage.gain and specs["gain"].linear:  # then all linear entries have units of the response
        linear = [spec.linear for _, spec in stage.entries()]
        stage = stage.unpack(np.where(linear, gain / stage.gain, 1.0) * stage.pack())
    return replace(stage, gain=gain, intercept=intercept)


def add_disturbances(operator, disturbances, names=None):
    """Return the sum of a driven operator and additive disturbances."""
    if not disturbances:
        return operator
    names = names or tuple(f"disturbance{i}" for i in range(len(disturbances)))
    return SumOperator((_DRIVEN, *names), (operator, *disturbances))


def split_disturbances(start):
    """Return the driven part of an operator, and a tuple of its additive disturbances.

    Parameters
    ----------
    start : Operator or tuple of (Operator, tuple of Operator)
        A pair is returned as it is.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.disturbance import OffsetOperator
    >>> from skhyst.linear import GainOperator
    >>> from skhyst.operators import SumOperator, split_disturbances
    >>> total = SumOperator(("gain", "offset"), (GainOperator(2.0), OffsetOperator(np.zeros(1))))
    >>> driven, disturbances = split_disturbances(total)
    >>> driven.names, len(disturbances)
    (('gain',), 1)
    """
    if isinstance(start, tuple):
        return start
    return (SumOperator((), ()), (start,)) if start.is_disturbance else start.split()


def bare(operator):
    """Return the operator within an OnColumnOperator that only selects the drive."""
    implied = isinstance(operator, OnColumnOperator) and operator._is_implied
    return operator.operator if implied else operator


def can_scale(operator, names):
    """Whether parameters of an operator can be scaled sample by sample, see :class:`Scaled`."""
    if _scales_within(operator, names):
        return True
    linear = {name for name, spec in operator.entries() if spec.linear}
    return bool(names) and (linear | {n.split("[")[0] for n in linear}).issuperset(names)


def _scales_within(operator, names):
    """Whether an operator scales these parameters within itself, sample by sample."""
    return bool(names) and tuple(names) == bare(operator).scaled_within


def of_columns(operator):
    """Return an operator that reads the whole input; a disturbance ignores its input anyway."""
    is_one = operator.reads_columns or operator.is_disturbance
    return operator if is_one else OnColumnOperator(operator, 0)


def _one(u, column):
    part = np.asarray(u, dtype=float)[..., column]
    return np.ascontiguousarray(part) if part.ndim else float(part)


def _tangents_of(du, column):
    """Return the tangents of a column of the input; a single input is column 0."""
    if du.ndim > 2:
        return np.ascontiguousarray(du[:, column])
    return du if column == 0 else np.zeros_like(du)


def _together(kind, *operands):
    """Return the stages of a joined node; operands of the same kind contribute their stages."""
    stages = []
    for operand in operands:
        is_node = isinstance(operand, kind) and operand.is_composed
        names = operand.names if is_node else (operand.label,)
        for name, part in zip(names, operand.stages if is_node else (operand,), strict=True):
            same = sum(other.rstrip("0123456789").rstrip("_") == name for other, _ in stages)
            stages.append(Stage(f"{name}_{same + 1}" if same else name, part))
    return stages


def _in_series(first, second):
    return Series(*zip(*_together(Series, first, second), strict=True))


def _in_parallel(first, second):
    return SumOperator.of_parts(_together(SumOperator, first, second))


def _scaled(operator, factor):
    return Scaled(of_columns(operator), *factor)


JOIN.update({"|": _in_series, "+": _in_parallel, "*": _scaled})
