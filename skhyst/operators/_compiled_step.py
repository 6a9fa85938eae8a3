"""One step of an operator in plain arithmetic, shared by streaming, control loops, C and FMUs.

A step is a function ``step(u, c, s) -> y`` of the input at one sample, of constants and of a state.
``c`` is a tuple of numbers and arrays, ``s`` one array of numbers, which the step changes. It is
written in a subset of Python that Numba compiles and that is translated to C: numbers, tuples of a
known length, elements of arrays, ``math``, ``abs``, ``min``, ``max``, ``int``, ``float``, ``if``,
``for ... in range``, ``while`` with a known bound, and such functions. It allocates nothing.

Steps are composed as their operators are: a series passes the output of one step to the next.
"""

import math
import warnings
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from reprlib import repr as shortened

import numpy as np

from .._jit import bind, jit
from ..exceptions import DivergenceWarning
from ..records import valid_interval
from ._protocol import as_constant, as_signal


def step(u, c, s):
    """Placeholder of an operator's step, which ``bind`` puts in its place."""
    raise NotImplementedError


def stream(u, c, s, y):
    """Write the output at each sample, or row, of the input to ``y`` (n,)."""
    for k in range(len(u)):
        y[k] = step(u[k], c, s)


@jit
def nothing(u, c, s):
    """Return zero."""
    return 0.0


@cache
def _loop(law):
    return bind(stream, law, allocates=False)


def in_ring(s, c):
    """Whether the first number of a state is an index of the others; see `CompiledLaw.possible`."""
    return s[0] in range(len(s) - 1)


def _stepping(law, c, s):
    return lambda u: law(u, c, s)


def _streaming(law, c, s):
    if getattr(law, "py_func", law) is law:  # plain Python, which no compiled loop can call
        return lambda u: np.array([law(row, c, s) for row in as_signal(u).tolist()], dtype=float)
    loop = _loop(law)

    def run(u):
        u = as_signal(u)
        y = np.empty(len(u))
        loop(u, c, s, y)
        return y

    return run


def _finite(u):
    """Return the input of a part, or raise if it is not finite."""
    if not (math.isfinite(u) if type(u) is float else np.isfinite(u).all()):
        raise OverflowError(f"The input of a part is {u!r}.")
    return u


def _checked_stepping(law, c, s):
    return lambda u: law(_finite(u), c, s)


def _checked_streaming(law, c, s):
    run = _streaming(law, c, s)
    return lambda u: run(_finite(u))


class CompiledStep:
    """Base of compiled steps.

    A subclass gives ``state`` and :meth:`bound`. Most are :class:`CompiledLaw`, or made of those.

    Attributes
    ----------
    state : ndarray of shape (n_states,)
        The state before the first sample.
    n_inputs : int or None
        Columns of the input that are read; None for a signal.
    double_only : str
        Why double precision is needed, in words; empty if it is not.
    flags : tuple of (str, int)
        Conditions of the last sample: name, and index in the state of a number that is nonzero
        while the condition holds. Entries with the same name are one flag.
    limits : tuple of (float, float, float) or None
        Lowest and highest output, and largest change of it from one sample to the next, which the
        step keeps; None if it has no limits.
    acting : int or None
        Column of the input from which the change is counted; None: from the last output.
    held : tuple of int
        Indices in the state of the last output that such limits remember, which a
        :class:`Stepper` leaves as they are where it begins anew.

    See Also
    --------
    CompiledLaw : A function with its constants and state.
    Stepper : Runs a step as a device.
    """

    n_inputs = None
    double_only = ""
    flags = ()
    limits = None
    acting = None
    held = ()

    def within(self, low, high, change):
        """Return the step with other limits of its output, where it has limits.

        Parameters
        ----------
        low, high, change : float
            As :attr:`limits`.

        Returns
        -------
        CompiledStep
            The step, in the same state.
        """
        return self

    def is_possible(self, s):
        """Return whether a step can continue from a state: the indices in it are within range.

        Compiled code does not check indices: one out of range crashes the interpreter.

        Parameters
        ----------
        s : ndarray of shape (n_states,)
            State, finite.

        Returns
        -------
        bool
            Whether it can.
        """
        return True

    def bound(self, s, binding):
        """Return the function of the input that ``binding`` makes of all steps.

        Parameters
        ----------
        s : ndarray of shape (n_states,)
            State, which the function changes.
        binding : callable
            ``binding(step, constants, s)`` returns a function of the input for one compiled step;
            ``s`` is the part of the state that belongs to it.

        Returns
        -------
        callable
            Function of the input.
        """
        raise NotImplementedError

    def compacted(self):
        """Return an equivalent step that needs less memory, if one of its laws has such a form.

        Returns
        -------
        CompiledStep
            It starts from the same state of the device, and its response is close to that of this
            step.
        """
        return self

    def stepping(self, s, checked=False):
        """Return a function of the input at one sample.

        Parameters
        ----------
        s : ndarray of shape (n_states,)
            State, which the function changes.
        checked : bool, default=False
            Whether the function raises OverflowError where the input of a part is not finite.

        Returns
        -------
        callable
            ``u -> y``: the output at the sample.
        """
        return self.bound(s, _checked_stepping if checked else _stepping)

    def streaming(self, s, checked=False):
        """Return a function of the input at many samples.

        Parameters
        ----------
        s : ndarray of shape (n_states,)
            State, which the function changes.
        checked : bool, default=False
            Whether the function raises OverflowError where the input of a part is not finite.

        Returns
        -------
        callable
            ``u -> y`` of the input (n_samples,) or (n_samples, n_inputs), with the output
            (n_samples,).
        """
        return self.bound(s, _checked_streaming if checked else _streaming)


@dataclass(frozen=True)
class CompiledLaw(CompiledStep):
    """A compiled step with its constants.

    Parameters
    ----------
    step : callable
        Compiled ``step(u, c, s) -> y``.
    constants : tuple of float and ndarray
        Constants ``c`` of the step.
    state : array-like of shape (n_states,)
        State before the first sample.
    n_inputs : int, default=None
        Columns of the input that are read; None for a signal.
    double_only : str, default=""
        Why double precision is needed, such as for differences of nearly equal numbers.
    possible : callable, default=None
        ``possible(s, c) -> bool``, if the state holds indices into tables or into itself: whether
        they are in range. None: the step takes any finite state.
    flags : tuple of (str, int), default=()
        As of :class:`CompiledStep`.
    limited : tuple of int, default=()
        Numbers of the constants that are the limits of the output: lowest, highest, and largest
        change if it is limited.
    acting, held : optional
        As of :class:`CompiledStep`.
    compact : CompiledLaw, default=None
        The law in a form with less memory and the same state: it computes values that this one
        tabulates.

    See Also
    --------
    Stepper : Runs it as a device.
    OneStateOperator : Makes one from a law.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import PrandtlIshlinskiiOperator
    >>> plays = PrandtlIshlinskiiOperator(np.array([0.0, 1.0]), np.array([1.0, 0.5]))
    >>> compiled_step = plays.compiled_step(1e-3, plays.init(0.0))
    >>> s = compiled_step.state.copy()
    >>> [compiled_step.step(u, compiled_step.constants, s) for u in (0.0, 4.0, 0.0)]
    [0.0, 5.5, 0.5]
    """

    step: object
    constants: tuple
    state: np.ndarray
    n_inputs: int | None = None
    double_only: str = ""
    possible: object = None
    flags: tuple = ()
    limited: tuple = ()
    acting: int | None = None
    held: tuple = ()
    compact: object = None

    @property
    def limits(self):
        """Lowest and highest output, and its largest change, None if it is not limited."""
        values = [self.constants[k] for k in self.limited]
        return (*values, *[math.inf] * (3 - len(values))) if values else None

    def within(self, low, high, change):
        constants = list(self.constants)
        for k, value in zip(self.limited, (low, high, change), strict=False):
            constants[k] = value
        return replace(self, constants=tuple(constants))

    def compacted(self):
        return self if self.compact is None else self.compact

    def __post_init__(self):
        constants = tuple(as_constant(c) if np.ndim(c) else float(c) for c in self.constants)
        object.__setattr__(self, "constants", constants)
        object.__setattr__(self, "state", as_constant(self.state))

    def behind(self, u):
        """Return a copy of the step that continues after an input.

        Parameters
        ----------
        u : array-like of shape (n_samples,)
            The input.

        Returns
        -------
        CompiledLaw
            The copy.
        """
        s = self.state.copy()
        step = self.stepping(s)
        for value in u:
            step(value)
        return replace(self, state=s, compact=None)

    def is_possible(self, s):
        return self.possible is None or bool(self.possible(s, self.constants))

    def bound(self, s, binding):
        return binding(self.step, self.constants, s)


@dataclass(frozen=True)
class CompiledParts(CompiledStep):
    """Base of the steps composed of others; a subclass gives ``_joined``.

    Parameters
    ----------
    parts : tuple of CompiledStep
    """

    parts: tuple

    @cached_property
    def state(self):
        """State before the first sample, that of one part after the other, shape (n_states,)."""
        return as_constant(np.concatenate([np.empty(0), *(part.state for part in self.parts)]))

    @cached_property
    def n_inputs(self):
        """Columns of the input that are read; None for a signal."""
        return max((part.n_inputs or 0 for part in self.parts), default=0) or None

    @property
    def double_only(self):
        """Why one of the parts needs double precision."""
        return next((part.double_only for part in self.parts if part.double_only), "")

    @property
    def flags(self):
        """Conditions of the parts, with their indices in the joint state."""
        parts = self._each(range(len(self.state)))
        return tuple((name, int(indices[at])) for part, indices in parts for name, at in part.flags)

    @property
    def held(self):
        """Indices in the joint state of what the parts hold."""
        parts = self._each(range(len(self.state)))
        return tuple(int(indices[at]) for part, indices in parts for at in part.held)

    def _each(self, s):
        """Yield each part with its slice of a state."""
        ends = np.cumsum([len(part.state) for part in self.parts])
        return zip(self.parts, np.split(s, ends[:-1]) if self.parts else (), strict=True)

    def compacted(self):
        return replace(self, parts=tuple(part.compacted() for part in self.parts))

    def is_possible(self, s):
        return all(part.is_possible(states) for part, states in self._each(s))

    def bound(self, s, binding):
        return self._joined([part.bound(states, binding) for part, states in self._each(s)])

    def _joined(self, functions):
        """Return the function that composes the functions of the parts."""
        raise NotImplementedError


@dataclass(frozen=True)
class CompiledCall(CompiledStep):
    """A step that calls Python: it can be stepped, but not translated to C.

    Parameters
    ----------
    function : callable
        ``function(u, s) -> y`` of the input at one sample and of the state, which it changes.
    state : array-like of shape (n_states,)
    name : str
        What it calls, for the error message where compiled code is needed.
    n_inputs : int, default=None
        Columns of the input that are read; None for a signal.

    Examples
    --------
    >>> import math
    >>> from skhyst.operators import CompiledCall, Stepper
    >>> Stepper(CompiledCall(lambda u, s: math.gamma(u), [], "gamma")).step(5.0)
    24.0
    """

    function: object
    state: np.ndarray
    name: str
    n_inputs: int | None = None

    def __post_init__(self):
        object.__setattr__(self, "state", np.array(self.state, dtype=float, ndmin=1))

    def bound(self, s, binding):
        if binding in (_stepping, _checked_stepping):
            return lambda u: self._called(u, s)
        if binding in (_streaming, _checked_streaming):
            return lambda u: np.array([self._called(row, s) for row in u])
        raise NotImplementedError(
            f"{self.name} has no step in plain arithmetic: it can be stepped in Python alone."
        )

    def _called(self, u, s):
        kept = s.copy()
        try:
            return self.function(u, s)
        except Exception:
            s[:] = kept
            raise


class CompiledSeries(CompiledParts):
    """Steps in series: the output of each is the input of the next."""

    @property
    def limits(self):
        """Those of the last step."""
        return self.parts[-1].limits if self.parts else None

    def within(self, low, high, change):
        *parts, last = self.parts
        return replace(self, parts=(*parts, last.within(low, high, change)))

    def _joined(self, functions):
        def series(u):
            for function in functions:
                u = function(u)
            return u

        return series


class CompiledSum(CompiledParts):
    """At least one step; the outputs are added."""

    def _joined(self, functions):
        first, *others = functions
        return lambda u: sum((function(u) for function in others), first(u))


@dataclass(frozen=True)
class CompiledColumn(CompiledParts):
    """A step whose input is one column, minus a reference.

    Parameters
    ----------
    parts : tuple of one CompiledStep
    column : int
    reference : float
    """

    column: int
    reference: float

    @property
    def n_inputs(self):
        """Columns of the input that are read."""
        return self.column + 1

    def _joined(self, functions):
        (function,) = functions
        return lambda u: function(u[..., self.column] - self.reference)


class CompiledProduct(CompiledParts):
    """The first output times the last, a factor.

    With a step in between, the output of the operator without its scaled part, the factor
    multiplies only the difference of the first output from that one.
    """

    def _joined(self, functions):
        function, *others, factor = functions
        if not others:
            return lambda u: function(u) * factor(u)
        [without] = others

        def partly(u):
            rest = without(u)
            return rest + factor(u) * (function(u) - rest)

        return partly


@dataclass(frozen=True)
class CompiledFed(CompiledParts):
    """A step of two inputs: column 0, and the output of the other step."""

    @property
    def n_inputs(self):
        """Columns of the input that are read."""
        return max(self.parts[1].n_inputs, 1)

    def _joined(self, functions):
        function, other = functions

        def fed(u):
            row = u[..., 0], other(u)
            return function(np.stack(row, axis=-1) if np.ndim(row[0]) else row)

        return fed


class _Replaced:
    """Rows of an input with another signal in place of column 0, without a copy of the others."""

    def __init__(self, first, u):
        self.first, self.u = first, u

    def __getitem__(self, key):
        return self.first if key == (..., 0) else self.u[key]


class CompiledColumnSeries(CompiledParts):
    """Two steps in series: the output of the first replaces column 0 of the input of the second."""

    def _joined(self, functions):
        first, second = functions
        return lambda u: second(_Replaced(first(u), u))


@dataclass(frozen=True)
class Signal:
    """An input or output of a step, with its range in the fit.

    Parameters
    ----------
    name : str
        Such as ``"drive"``.
    low, high : float, default=-inf, inf
        Range of the fit, in the unit of the signal.
    rate : float, default=inf
        Fastest change of the fit, units of the signal per s.

    See Also
    --------
    Stepper : Reports signals beyond their range.

    Examples
    --------
    >>> from skhyst.operators import Signal
    >>> low, high, change = Signal("drive", low=-1.0, high=1.0, rate=20.0).ends(dt=0.01)
    >>> round(high, 6), round(change, 6)
    (1.0, 0.2)
    """

    name: str
    low: float = -math.inf
    high: float = math.inf
    rate: float = math.inf

    @property
    def is_limited(self):
        """Whether a range or a rate is known."""
        return (self.low, self.high, self.rate) != (-math.inf, math.inf, math.inf)

    def ends(self, dt):
        """Return the lowest and highest value, and the largest change per sampling interval.

        Values beyond an end by no more than rounding are within it.

        Parameters
        ----------
        dt : float or None
            Interval in s; None where the change is not limited.

        Returns
        -------
        tuple of float
            In the unit of the signal.
        """
        span = self.high - self.low
        rounding = ROUNDING * (span if math.isfinite(span) else 0.0)
        change = math.inf if dt is None else self.rate * dt
        return self.low - rounding, self.high + rounding, change * (1.0 + ROUNDING) + rounding


ROUNDING = 1e-9  # relative to a range: a value beyond its end by less is still within


class Stepper:
    """A device that is run sample by sample.

    Parameters
    ----------
    compiled_step : CompiledStep
        The operator's step at its sampling interval, with the initial state.
    dt : float, default=None
        The sampling interval in s, if it is known.
    inputs : sequence of Signal, default=()
        Inputs of a step, one per column.
    result : Signal, default=None
        The output.
    preview : int, default=0
        Samples by which the input precedes the output that belongs to it.
    remake : callable, default=None
        Returns a stepper of this kind again, for pickling; by default the compiled step itself is
        pickled.

    Attributes
    ----------
    dt : float or None
        Sampling interval in s, if it is known.
    state : ndarray of shape (n_states,)
        Complete state: a copy, which may be stored and assigned later.
    output : float or None
        At the last accepted sample; None before the first, and after ``state`` is set.
    status : frozenset of str
        Conditions that hold at the last sample: ``"limited"``, limits have clipped the drive;
        ``"unreachable"``, an inverse by root finding has found no drive for its reference;
        ``"extrapolated"``, the drive is outside the range or the rate of the fit, or the acting
        drive outside the limits; ``"refused"``, the last input was refused, see :meth:`step`;
        ``"overrange"``, numbers have been beyond floating point since the start, see there.
    compiled_step : CompiledStep
        The compiled step, with its initial state.
    inputs, result, preview : tuple of Signal, Signal or None, int
        As given.
    watched : tuple of (int, float, float, float)
        Signals whose range is known: position among inputs and result, lowest and highest value,
        and largest change from one sample to the next.

    Raises
    ------
    ValueError
        If ``dt`` is not a positive number, or there is not one signal per input.

    See Also
    --------
    skhyst.base.ParametricModel.stepper : That of a fitted model.
    skhyst.export.to_c : The same step as a program.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import PrandtlIshlinskiiOperator
    >>> from skhyst.operators import Stepper
    >>> plays = PrandtlIshlinskiiOperator(np.array([0.0, 1.0]), np.array([1.0, 0.5]))
    >>> stepper = Stepper(plays.compiled_step(1e-3, plays.init(0.0)))
    >>> stepper.step(4.0)
    5.5
    >>> other = stepper.copy()
    >>> stepper.step(0.0), other.run([2.0, 0.0])
    (0.5, array([3.5, 0.5]))
    """

    def __init__(self, compiled_step, dt=None, *, inputs=(), result=None, preview=0, remake=None):
        self.compiled_step = compiled_step
        self.dt = None if dt is None else valid_interval(dt, "Stepper")
        self.inputs, self.result, self.preview = tuple(inputs), result, preview
        if self.inputs and len(self.inputs) != (compiled_step.n_inputs or 1):
            raise ValueError(
                f"The 'inputs' parameter of Stepper must be {compiled_step.n_inputs or 1} signals, "
                f"one per column. Got {inputs!r} instead."
            )
        self._remake = remake
        self.watched = tuple(
            (k, *signal.ends(self.dt))
            for k, signal in enumerate((*self.inputs, result))
            if signal is not None and signal.is_limited
        )
        self._begin(compiled_step.state)

    def _begin(self, state):
        self._forget()
        self._state = np.array(state)
        self._step = self.compiled_step.stepping(self._state, checked=True)

    @property
    def state(self):
        return self._state.copy()

    @state.setter
    def state(self, values):
        values = np.asarray(values, dtype=float)
        whole = values.shape == self._state.shape and np.isfinite(values).all()
        if not (whole and self.compiled_step.is_possible(values)):
            raise ValueError(
                f"The 'state' of a Stepper must be {self._state.size} finite numbers, as it was "
                f"read. Got {values!r} instead."
            )
        self._state[:] = values
        self._forget()

    def _forget(self):
        self.output, self._refused, self._overrange = None, False, False
        self._last = self._before = None  # input and output of the last two samples

    @property
    def status(self):
        names = {name for name, at in self.compiled_step.flags if self._state[at] != 0.0}
        names |= {"refused"} if self._refused else set()
        names |= {"overrange"} if self._overrange else set()
        return frozenset(names | {"extrapolated"} if self._is_extrapolating() else names)

    def _is_extrapolating(self):
        """Whether the last sample was beyond the range or the rate of a signal."""
        if self._last is None or not self.watched:
            return False
        now = (*np.ravel(self._last[0])[: len(self.inputs)], self._last[1])
        before = now if self._before is None else self._before
        if before is not now:
            before = (*np.ravel(before[0])[: len(self.inputs)], before[1])
        return any(
            now[k] < low or now[k] > high or abs(now[k] - before[k]) > change
            for k, low, high, change in self.watched
        )

    def step(self, u):
        """Return the response at the next sample.

        Where a finite input leads beyond floating point, no later sample would take such numbers
        out of the state. Then the last output is held, the status is ``"overrange"``, and the state
        begins anew; only limits continue from the output that is held.

        Parameters
        ----------
        u : float, or array-like of shape (n_inputs,)
            Drive, with the other columns if the model reads them.

        Returns
        -------
        float
            NaN if the first sample leads beyond floating point, so that there is none to hold.

        Raises
        ------
        ValueError
            If the input is not finite or of another shape: the state is unchanged, the status is
            ``"refused"``, and ``output`` is the last one, which a program in C returns again.
        """
        if self.compiled_step.n_inputs is None:
            try:
                value, wanted = float(u), "finite"
            except (TypeError, ValueError):
                value, wanted = math.nan, "one number"
            self._refused = not math.isfinite(value)
            if self._refused:
                raise ValueError(f"The drive must be {wanted}. Got {u!r} instead.")
        else:
            value = self._checked(u, 1)
        try:
            y = self._step(value)
        except OverflowError:  # by the law itself where it is not compiled
            y = math.inf
        if abs(y) < math.inf:
            self.output = y
        else:
            self._begin_anew()
            y = math.nan if self.output is None else self.output
        if self.watched:
            self._before, self._last = self._last, (value, y)
        return y

    def _begin_anew(self):
        held = list(self.compiled_step.held)
        kept = self._state[held]
        self._state[:] = self.compiled_step.state
        self._state[held], self._overrange = kept, True

    def run(self, u):
        """Return the response to many samples, and keep the state after the last.

        Parameters
        ----------
        u : array-like of shape (n_samples,) or (n_samples, n_inputs)
            Drives, as of :meth:`step`.

        Returns
        -------
        ndarray of shape (n_samples,)

        Raises
        ------
        ValueError
            As in :meth:`step`.

        Warns
        -----
        DivergenceWarning
            If numbers have left floating point, see :meth:`step`.
        """
        n_inputs = self.compiled_step.n_inputs
        u = self._checked(u, 1 if n_inputs is None else 2)
        begin = self._state.copy()
        try:
            y = self.compiled_step.streaming(self._state, checked=True)(u)
        except OverflowError:
            y = np.array([math.inf])
        if not np.isfinite(y).all():
            self._state[:] = begin
            y = np.array([self.step(row) for row in u])
            warnings.warn(
                "The numbers of the device have left floating point: it began anew, and held its "
                "last output meanwhile.",
                DivergenceWarning,
                stacklevel=2,
            )
        elif len(y):
            self.output = float(y[-1])
            before = (u[-2].copy(), float(y[-2])) if len(y) > 1 else self._last
            self._before, self._last = before, (u[-1].copy(), self.output)
        return y

    def _checked(self, u, ndim):
        n_inputs = self.compiled_step.n_inputs
        try:
            rows = np.array(u, dtype=float)
        except (TypeError, ValueError):
            rows = np.empty(())
        is_whole = rows.ndim == ndim and not (n_inputs and rows.shape[-1] < n_inputs)
        self._refused = not (is_whole and np.isfinite(rows).all())
        if self._refused:
            wanted = "finite"
            if not is_whole:
                row = "a number" if n_inputs is None else f"a row of {n_inputs} numbers or more"
                wanted = row if ndim == 1 and n_inputs else f"a sequence with {row} per sample"
            raise ValueError(f"The input must be {wanted}. Got {shortened(u)} instead.")
        return rows

    def copy(self):
        """Return an independent copy in the same state."""
        other = Stepper(self.compiled_step, self.dt, **self._described())
        other._begin(self._state)
        other._recall(self._known())
        return other

    def _described(self):
        names = "inputs", "result", "preview"
        return {name: getattr(self, name) for name in names} | {"remake": self._remake}

    def _known(self):
        return self.output, self._refused, self._overrange, self._last, self._before

    def _recall(self, known):
        self.output, self._refused, self._overrange, self._last, self._before = known

    __copy__ = copy

    def __deepcopy__(self, memo):
        return self.copy()

    def __reduce__(self):
        again = self._remake
        if again is None:
            again = partial(Stepper, self.compiled_step, self.dt, **self._described())
        return _restored, (again, self.state, self._known())


def _restored(again, state, known):
    """Return a stepper that continues from the state of a pickled one."""
    stepper = again()
    stepper.state = state
    stepper._recall(known)
    return stepper
