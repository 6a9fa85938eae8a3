"""The protocol of an operator: constant numbers and a state, which map a signal to a signal.

An operator is a frozen dataclass whose fields are physical parameters. It knows no data and no
estimator. Fields made with :func:`parameter` can be identified; all others are fixed structure
(thresholds, orders). ``pack`` lists the parameters as one vector, ``unpack`` puts such a vector
back, ``sensitivities`` returns the output together with its exact derivatives (forward mode), so
that a series or a sum of operators, which is an operator again, is differentiated by propagating
tangents from one to the next.

Between two samples the input is a straight line (first-order hold) unless an operator says
otherwise. The state before sample ``k`` holds everything that the operator remembers of the
samples before ``k``, the last input included, so a signal may be cut anywhere:
``run(u)`` equals ``run(u[:m])`` followed by ``run(u[m:], state=...)``.

The members of an operator are those of its class here, ten. What a tree needs of its parts in
addition is declared in ``_part``, as attributes and methods with defaults. What a single concern
needs is a function of its own, which single classes implement otherwise (``singledispatch``):
:func:`propagate`, ``resampled``, ``holds_of_input``.
"""

import dataclasses
from abc import ABC, abstractmethod
from functools import cache, cached_property, singledispatch
from numbers import Integral, Real
from types import UnionType
from typing import Any, get_args

import numpy as np

from ._part import Part


def as_signal(values):
    """Return a contiguous read-only view of floats, copied only where needed.

    Numba compiles a loop once per array type, and read-only arrays, such as columns of a frame, are
    a type of their own: with all of them read-only, there is one.
    """
    signal = np.ascontiguousarray(values, dtype=float).view()
    signal.flags.writeable = False
    return signal


def as_constant(values):
    """Return a read-only copy of numbers, at least one-dimensional, as :func:`as_signal` does."""
    constant = np.array(values, dtype=float, ndmin=1)
    constant.flags.writeable = False
    return constant


@dataclasses.dataclass(frozen=True)
class ParameterSpec:
    """How one field of an operator is identified.

    Parameters
    ----------
    linear : bool
        The output is an affine function of all such fields together, the others being constant.
    lower, upper : float
        Bounds in the field's own unit.
    log : bool
        The field is positive and is searched on a logarithmic scale.
    gauge : float or None
        Value at which the field is held if another stage of a series has the same freedom (a static
        gain at 1, an intercept at 0). None: the freedom is the operator's own.
    unit : str
        Unit in terms of ``s``, ``drive`` and ``response``, for reports.
    penalty : float
        Identification adds this times the square of the value to the squared error of each sample;
        for linear fields only.
    held : bool
        Another part of the tree has the freedom. Nodes set this and the next two.
    movable : bool
        Another stage of a series can carry the freedom, if there is a gauge.
    additive : bool
        A field of gauge 0 only adds a constant to the output.

    See Also
    --------
    parameter : Declares a field with one.

    Examples
    --------
    >>> from skhyst.linear import FirstOrderLagOperator
    >>> spec = FirstOrderLagOperator(0.1).parameter_specs()["time_constant"]
    >>> spec.log, spec.lower, spec.unit
    (True, 0.0, 's')
    """

    linear: bool = False
    lower: float = -np.inf
    upper: float = np.inf
    log: bool = False
    gauge: float | None = None
    unit: str = ""
    penalty: float = 0.0
    held: bool = False
    movable: bool = True
    additive: bool = True

    @cached_property
    def is_shared(self) -> bool:
        """Whether another stage of a series can carry the freedom."""
        return self.movable and self.gauge is not None

    @cached_property
    def is_constant(self) -> bool:
        """Whether the field only adds a constant to the output."""
        return self.additive and self.gauge == 0.0


def parameter(*, default=dataclasses.MISSING, **options):
    """Declare a dataclass field as an identifiable parameter.

    Parameters
    ----------
    default : object, default=MISSING
        Default of the field; by default it has none.
    **options : object
        Fields of :class:`ParameterSpec`, such as ``linear``, ``lower``, ``upper``, ``log``,
        ``unit``.

    Returns
    -------
    dataclasses.Field
        For a field of an operator.

    See Also
    --------
    ParameterSpec : The options.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> import numpy as np
    >>> from skhyst.operators import Operator, parameter
    >>> @dataclass(frozen=True)
    ... class Doubler(Operator):
    ...     gain: float = parameter(linear=True, unit="response/drive", default=2.0)
    ...     def init(self, u0, initial_state="rest"):
    ...         return None
    ...     def run(self, u, dt, state=None):
    ...         return self.gain * u, None
    ...     def sensitivities(self, u, du, dt, initial_state="rest"):
    ...         return self.gain * u, np.column_stack([self.gain * du, u])
    >>> [(name, spec.unit) for name, spec in Doubler().entries()]
    [('gain', 'response/drive')]
    """
    return dataclasses.field(default=default, metadata={"parameter": ParameterSpec(**options)})


class Operator(Part, ABC):
    """Base of all operators. Subclasses are frozen dataclasses.

    They give :meth:`init`, :meth:`run` and :meth:`sensitivities`, and :meth:`compiled_step` if they
    can be stepped and exported; the rest follows from the fields.

    Raises
    ------
    ValueError
        If the value of a field is not of the annotated type.

    See Also
    --------
    OneStateOperator : The shortest way to an operator, from one step of a law.
    check_operator : Checks an operator against the protocol.
    skhyst.base.ParametricModel : The estimator of an operator.

    Examples
    --------
    See :func:`parameter` for an operator in a few lines.
    """

    def __post_init__(self):
        for name, kinds, is_right, wanted in _checks(type(self)):
            value = getattr(self, name)
            if not isinstance(value, kinds) or (
                is_right and value is not None and not is_right(value)
            ):
                self._require(name, False, wanted)

    def _require_size(self, name, size, why):
        """Refuse an array of another size: compiled code does not check indices."""
        wanted = f"have {size} value(s), one per {why}"
        self._require(name, np.shape(getattr(self, name)) == (size,), wanted)

    def parameter_specs(self) -> dict[str, ParameterSpec]:
        """Return the identifiable fields, in the order of declaration."""
        return dict(_declared(type(self)))

    def entries(self) -> list[tuple[str, ParameterSpec]]:
        """Return (name, spec) for each value of :meth:`pack`; array fields are numbered."""
        sizes = self._sizes
        return [
            (name if np.ndim(getattr(self, name)) == 0 else f"{name}[{i}]", spec)
            for name, spec in self.parameter_specs().items()
            for i in range(sizes[name])
        ]

    @cached_property
    def _sizes(self):
        sizes = {}
        for name in self.parameter_specs():
            value = getattr(self, name)
            sizes[name] = 1 if isinstance(value, float) else np.size(value)  # which makes an array
        return sizes

    @cached_property
    def n_parameters(self) -> int:
        """Number of values in :meth:`pack`."""
        return sum(self._sizes.values())

    def pack(self) -> np.ndarray:
        """Return all identifiable values as one vector."""
        vector, start = np.empty(self.n_parameters), 0
        for name, size in self._sizes.items():
            vector[start : start + size] = np.ravel(getattr(self, name))
            start += size
        return vector

    def unpack(self, vector) -> "Operator":
        """Return a copy with other values of the identifiable parameters.

        The values are not checked: a search keeps to the bounds.

        Parameters
        ----------
        vector : array-like of shape (n_parameters,)
            As :meth:`pack` returns it.

        Returns
        -------
        Operator
            A copy.
        """
        vector = np.array(vector, dtype=float)
        changes, start = {}, 0
        for name, size in self._sizes.items():
            old, part = getattr(self, name), vector[start : start + size]
            if np.ndim(old):
                part = part.reshape(np.shape(old))
                # compiled loops distinguish arrays that are read-only
                part.flags.writeable = np.asarray(old).flags.writeable
                changes[name] = part
            else:
                changes[name] = float(part[0])
            start += size
        return self._with_values(changes)

    def _with_values(self, changes):
        """Return a copy with other values of the same structure, which is not checked again."""
        old, new = vars(self), object.__new__(type(self))
        for name in _lasting(type(self)):
            if name in old:
                vars(new)[name] = old[name]
        vars(new).update(changes)
        return new

    @abstractmethod
    def init(self, u0: float, initial_state: str = "rest") -> Any:
        """Return the state before the first sample.

        Parameters
        ----------
        u0 : float
            Input at the first sample.
        initial_state : {"rest", "zero"}, default="rest"
            ``"rest"``: the device has rested at ``u0`` until all dynamics settled, and its
            hysteresis memory is that of a first loading from zero to ``u0``. ``"zero"``: every
            state is zero and so was the input; an operator with a ``hold`` has zero state at the
            first sample, whose input was applied as a step.

        Returns
        -------
        object
            The state: a value that is never changed in place.
        """

    @abstractmethod
    def run(self, u, dt: float, state=None) -> tuple[np.ndarray, Any]:
        """Map an input to the output.

        Parameters
        ----------
        u : array-like of shape (n_samples,)
            Input; (n_samples, n_inputs) if :attr:`reads_columns`.
        dt : float
            Sampling interval in s.
        state : object, default=None
            State before the first sample, as :meth:`init` and :meth:`run` return it; None: at rest
            at the first input. It is not changed.

        Returns
        -------
        y : ndarray of shape (n_samples,)
            Output.
        state : object
            State after the last sample.
        """

    @abstractmethod
    def sensitivities(self, u, du, dt: float, initial_state: str = "rest"):
        """Return the output and its tangents.

        Parameters
        ----------
        u : ndarray of shape (n_samples,)
            Input.
        du : ndarray of shape (n_samples, m), or (n_samples, n_inputs, m) of several inputs
            Derivatives of the input with respect to ``m`` parameters upstream; ``m`` may be 0.
        dt : float
            Sampling interval in s.
        initial_state : {"rest", "zero"}, default="rest"
            As in :meth:`init`.

        Returns
        -------
        y : ndarray of shape (n_samples,)
            The same as :meth:`run` returns.
        dy : ndarray of shape (n_samples, m + n_parameters), C-contiguous
            The ``m`` tangents propagated to the output, then the derivatives with respect to the
            operator's own parameters in the order of :meth:`pack`.
        """

    def compiled_step(self, dt: float, state):
        """Return one step in plain arithmetic.

        Parameters
        ----------
        dt : float
            Sampling interval in s.
        state : object
            State before the first sample, as :meth:`init` and :meth:`run` return it.

        Returns
        -------
        CompiledStep
            The step, for Python, control loops, C and FMUs.

        Raises
        ------
        NotImplementedError
            If the output depends on later input, so that it cannot be computed sample by sample, or
            the operator has no compiled step.
        """
        why = "it defines no 'compiled_step'" if self.causal else "it looks ahead"
        raise NotImplementedError(f"{type(self).__name__} cannot be stepped: {why}.")

    def step(self, state, u: float, dt: float) -> tuple[Any, float]:
        """Advance by one sample.

        Parameters
        ----------
        state : object
            As :meth:`init`, :meth:`run` and :meth:`step` return it.
        u : float
            Input at the sample.
        dt : float
            Sampling interval in s.

        Returns
        -------
        state : object
            State after the sample.
        y : float
            Output at the sample.
        """
        y, state = self.run(np.array([u], dtype=float), dt, state)
        return state, float(y[0])

    def _require(self, name, is_right, wanted):
        """Refuse an invalid field; ``wanted`` completes "must", such as "be above 0"."""
        if not is_right:
            raise ValueError(
                f"The '{name}' parameter of {type(self).__name__} must {wanted}. "
                f"Got {getattr(self, name)!r} instead."
            )


@singledispatch
def propagate(operator, u, du, dt, initial_state="rest"):
    """Return the output of an operator and the tangents of the input propagated to it.

    The tangents are the first columns of ``sensitivities``, without the derivatives by the
    operator's own parameters; linear operators and series have a faster implementation.

    Parameters
    ----------
    operator : Operator
        The operator.
    u : ndarray of shape (n_samples,)
        Input.
    du : ndarray of shape (n_samples, m), or (n_samples, n_inputs, m) of several inputs
        Derivatives of the input with respect to ``m`` parameters upstream; ``m`` may be 0.
    dt : float
        Sampling interval in s.
    initial_state : {"rest", "zero"}, default="rest"
        As in ``init``.

    Returns
    -------
    y : ndarray of shape (n_samples,)
        The same as ``run`` returns.
    dy : ndarray of shape (n_samples, m)
        Derivatives of the output.
    """
    m = du.shape[-1]
    if m == 0:
        return operator.run(u, dt, operator.init(u[0], initial_state))[0], du
    y, dy = operator.sensitivities(u, du, dt, initial_state)
    return y, np.ascontiguousarray(dy[:, :m])


def by_fields(operator):
    """Return the ``__reduce__`` of an operator without the tables that it has cached."""
    fields = [f.name for f in dataclasses.fields(operator) if not f.kw_only]
    state = None if operator.model is None else {"model": operator.model}
    return type(operator), tuple(getattr(operator, name) for name in fields), state


# Largest number of substeps, lags, samples of a window, ...: at about 0.1 us each, a sample then
# takes less than a millisecond.
MOST_STEPS = 4096


def _is_integer(value):
    return not isinstance(value, bool) and abs(value) <= MOST_STEPS


def is_array(value):
    """Whether a value is an array, a list or a tuple of numbers."""
    return isinstance(value, np.ndarray | list | tuple) and np.asarray(value).dtype.kind in "biuf"


_KINDS = (  # (annotation of a field, classes of its value, further check or None, requirement)
    (bool, (bool, np.bool_), None, "be True or False"),
    (int, (Integral,), _is_integer, f"be an integer of at most {MOST_STEPS}"),
    (float, (Real,), None, "be a number"),
    (str, (str,), None, "be text"),
    (np.ndarray, (np.ndarray, list, tuple), is_array, "be an array of numbers"),
    (tuple, (tuple,), None, "be a tuple"),
    (Part, (Part,), None, "be an operator"),
)


_STRUCTURE = ("_sizes", "n_parameters", "_entries")  # cached properties that no value changes


@cache
def _checks(kind):
    """Return (name, classes, check, requirement) of the fields that can be checked."""
    checks = []
    for field in dataclasses.fields(kind):
        annotation, *other = (
            get_args(field.type) if isinstance(field.type, UnionType) else (field.type,)
        )
        for kind_of_field, *check in _KINDS:
            if (
                isinstance(annotation, type)
                and issubclass(annotation, kind_of_field)
                and other in ([], [type(None)])
            ):
                classes, is_right, wanted = check
                checks.append((field.name, (*classes, *other), is_right, wanted))
                break
    return tuple(checks)


@cache
def _lasting(kind):
    """Return the names of attributes that are copied with other values."""
    return (*(field.name for field in dataclasses.fields(kind)), *_STRUCTURE)


@cache
def _declared(kind):
    fields = dataclasses.fields(kind)
    return {f.name: f.metadata["parameter"] for f in fields if "parameter" in f.metadata}
