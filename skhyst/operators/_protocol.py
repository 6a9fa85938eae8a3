"""The protocol of an operator: frozen numbers plus a state, that map a signal to a signal.

An operator is a frozen dataclass whose fields are physical parameters. It knows no data and no
estimator. Fields made with :func:`parameter` can be identified; all others are fixed structure
(thresholds, orders). ``pack`` lists the parameters as one vector, ``unpack`` puts such a vector
back, ``sensitivities`` returns the output together with its exact derivatives (forward mode), so
that a series or a sum of operators, which is an operator again, is differentiated by handing
tangents from one to the next.

Between two samples the input is a straight line (first-order hold) unless an operator says
otherwise. The state before sample ``k`` holds everything that the operator remembers of the
samples before ``k``, the last input included, so a signal may be cut anywhere:
``run(u)`` equals ``run(u[:m])`` followed by ``run(u[m:], state=...)``.

An operator has the members on this page. What a tree asks of its parts besides is declared in
``_part``, as an attribute or a method with a default; nothing asks for a class.
"""

import dataclasses
from abc import ABC, abstractmethod
from functools import cache, cached_property
from typing import Any

import numpy as np

from ._part import Part


def as_signal(values):
    """Return a contiguous read-only view of floats, copied only where needed.

    A kernel is compiled once for each kind of array; a column of a frame is read-only, an array
    mostly is not.
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
        The output is an affine function of the field while all other fields stand still; of all
        such fields together.
    lower, upper : float
        Bounds in the field's own unit.
    log : bool
        The field is positive and is searched on a logarithmic scale.
    gauge : float or None
        Value at which the field is held when another stage of a series carries the same freedom
        (a static gain at 1, an intercept at 0). None: the freedom is the operator's own.
    unit : str
        Unit in terms of ``s``, ``drive`` and ``response``, for reports.
    held : bool
        Another part of the tree carries the freedom. Nodes set this and what follows.
    movable : bool
        Another stage of a series can carry the freedom, where there is a gauge.
    additive : bool
        A field of gauge 0 only adds a constant to the output.
    """

    linear: bool = False
    lower: float = -np.inf
    upper: float = np.inf
    log: bool = False
    gauge: float | None = None
    unit: str = ""
    held: bool = False
    movable: bool = True
    additive: bool = True

    @property
    def is_shared(self) -> bool:
        """Whether another stage of a series can carry the freedom."""
        return self.movable and self.gauge is not None

    @property
    def is_constant(self) -> bool:
        """Whether the field only adds a constant to the output."""
        return self.additive and self.gauge == 0.0


def parameter(*, default=dataclasses.MISSING, **options):
    """Declare a dataclass field as an identifiable parameter; see :class:`ParameterSpec`."""
    return dataclasses.field(default=default, metadata={"parameter": ParameterSpec(**options)})


class Operator(Part, ABC):
    """Base of all operators. Subclasses are frozen dataclasses.

    They give :meth:`init`, :meth:`run` and :meth:`sensitivities`, and :meth:`compiled_step` where
    they can be stepped and exported; the rest follows from the fields.
    """

    def parameter_specs(self) -> dict[str, ParameterSpec]:
        """Return the identifiable fields, in the order of declaration."""
        return dict(_declared(type(self)))

    def entries(self) -> list[tuple[str, ParameterSpec]]:
        """Return one (name, spec) a value of :meth:`pack`; array fields are numbered."""
        sizes = self._sizes
        return [
            (name if np.ndim(getattr(self, name)) == 0 else f"{name}[{i}]", spec)
            for name, spec in self.parameter_specs().items()
            for i in range(sizes[name])
        ]

    @cached_property
    def _sizes(self):
        found = {}
        for name in self.parameter_specs():
            value = getattr(self, name)
            found[name] = 1 if isinstance(value, float) else np.size(value)  # which makes an array
        return found

    @cached_property
    def n_parameters(self) -> int:
        """Number of values in :meth:`pack`."""
        return sum(self._sizes.values())

    def pack(self) -> np.ndarray:
        """Return all identifiable values as one vector."""
        values = [np.ravel(getattr(self, name)) for name in self._sizes]
        return np.concatenate(values).astype(float) if values else np.empty(0)

    def unpack(self, vector) -> "Operator":
        """Return a copy with the identifiable values taken from ``vector``."""
        vector = np.asarray(vector, dtype=float)
        changes, start = {}, 0
        for name, size in self._sizes.items():
            part = vector[start : start + size]
            changes[name] = float(part[0]) if np.ndim(getattr(self, name)) == 0 else part.copy()
            start += size
        return dataclasses.replace(self, **changes)

    @abstractmethod
    def init(self, u0: float, initial_state: str = "rest") -> Any:
        """Return the state before the first sample ``u0``.

        ``"rest"``: the device has rested at ``u0`` until all dynamics settled, and its hysteresis
        memory is that of a first loading from zero to ``u0``. ``"zero"``: every state is zero and
        so was the input.
        """

    @abstractmethod
    def run(self, u, dt: float, state=None) -> tuple[np.ndarray, Any]:
        """Map a signal of shape (n_samples,), interval ``dt`` in s; ``state=None`` means at rest.

        Returns the output, shape (n_samples,), and the state after the last sample. The state
        passed in is left as it was.
        """

    @abstractmethod
    def sensitivities(self, u, du, dt: float, initial_state: str = "rest"):
        """Return the output and its tangents.

        Parameters
        ----------
        u : ndarray of shape (n_samples,)
            Input.
        du : ndarray of shape (n_samples, m)
            Derivatives of the input with respect to ``m`` parameters upstream; ``m`` may be 0.
        dt : float
            Sampling interval in s.
        initial_state : {"rest", "zero"}
            As in :meth:`init`.

        Returns
        -------
        y : ndarray of shape (n_samples,)
            The same as :meth:`run` returns.
        dy : ndarray of shape (n_samples, m + n_parameters), C-contiguous
            The ``m`` tangents carried through, then the derivatives with respect to the
            operator's own parameters in the order of :meth:`pack`.
        """

    def propagate(self, u, du, dt: float, initial_state: str = "rest"):
        """Return the output and the tangents carried through, (n_samples, m), of no own parameter.

        The first columns of :meth:`sensitivities`, which they are taken from unless an operator
        knows a shorter way.
        """
        m = du.shape[1]
        if m == 0:
            return self.run(u, dt, self.init(u[0], initial_state))[0], du
        y, dy = self.sensitivities(u, du, dt, initial_state)
        return y, np.ascontiguousarray(dy[:, :m])

    def compiled_step(self, dt: float, state):
        """Return one step in plain arithmetic: a :class:`~skhyst.operators.CompiledStep`.

        Parameters
        ----------
        dt : float
            Sampling interval in s.
        state : object
            The state before the first sample, as :meth:`init` and :meth:`run` return it.

        Raises
        ------
        NotImplementedError
            If the output depends on later input, so that it is not known sample by sample, or the
            operator gives no step.
        """
        why = "it gives no step ('compiled_step')" if self.causal else "it looks ahead"
        raise NotImplementedError(f"{type(self).__name__} cannot be stepped: {why}.")

    def step(self, state, u: float, dt: float) -> tuple[Any, float]:
        """Advance by one sample: return the new state and the output."""
        y, state = self.run(np.array([u], dtype=float), dt, state)
        return state, float(y[0])

    def _require(self, name, is_right, wanted):
        """Refuse a field that is not what is wanted of it, such as "be above 0"."""
        if not is_right:
            raise ValueError(
                f"The '{name}' parameter of {type(self).__name__} must {wanted}. "
                f"Got {getattr(self, name)!r} instead."
            )


def by_fields(operator):
    """Return what ``__reduce__`` of an operator gives that leaves out tables beside its fields."""
    fields = [f.name for f in dataclasses.fields(operator) if not f.kw_only]
    state = None if operator.model is None else {"model": operator.model}
    return type(operator), tuple(getattr(operator, name) for name in fields), state


@cache
def _declared(kind):
    fields = dataclasses.fields(kind)
    return {f.name: f.metadata["parameter"] for f in fields if "parameter" in f.metadata}
