"""Intermediate representation of a step: expressions of numbers, arrays, and statements.

Every number has a kind: ``"bool"``, ``"int"`` or ``"real"``. Tuples are Python tuples of these
values; they are split into their elements when they are read, so that statements are about single
numbers.
"""

import math
from dataclasses import dataclass, field, replace

KINDS = ("bool", "int", "real")  # each can hold those before
_FOLDED = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "//": lambda a, b: a // b,
    "%": lambda a, b: a % b,
    "<": lambda a, b: a < b,
    "<=": lambda a, b: a <= b,
    ">": lambda a, b: a > b,
    ">=": lambda a, b: a >= b,
    "==": lambda a, b: a == b,
    "!=": lambda a, b: a != b,
}
COMPARISONS = ("<", "<=", ">", ">=", "==", "!=")


class Outside(Exception):
    """The source is outside the part of Python that can be written in C."""


@dataclass(frozen=True)
class Expression:
    """A number: an operation on others.

    ``args`` are the value of a ``"const"``, the name of a ``"name"``, array and index of a
    ``"load"``, the function and its arguments of a ``"call"``; else the operands.
    """

    op: str
    args: tuple
    kind: str

    @property
    def value(self):
        """The number, if it is known, else None."""
        return self.args[0] if self.op == "const" else None

    def __add__(self, other):
        return arithmetic("+", self, constant(other))

    def __radd__(self, other):
        return arithmetic("+", constant(other), self)

    def __sub__(self, other):
        return arithmetic("-", self, constant(other))

    def __mul__(self, other):
        return arithmetic("*", self, constant(other))

    def __rmul__(self, other):
        return arithmetic("*", constant(other), self)


def constant(value):
    """Return a number as an expression; an expression is returned unchanged."""
    if isinstance(value, Expression):
        return value
    if isinstance(value, bool):
        return Expression("const", (value,), "bool")
    try:
        return Expression("const", (value.__index__(),), "int")
    except AttributeError:
        return Expression("const", (float(value),), "real")


def variable(name, kind):
    """Return the value of a variable."""
    return Expression("name", (name,), kind)


def joined(*kinds):
    """Return the kind that can hold them all."""
    return max(kinds, key=KINDS.index)


def converted(x, kind):
    """Return a number as one of another kind."""
    if x.kind == kind:
        return x
    if x.op == "const" and math.isfinite(x.value):
        return constant({"bool": bool, "int": int, "real": float}[kind](x.value))
    return Expression("cast", (x,), kind)


def compared(op, a, b):
    """Return a comparison."""
    return _folded(op, a, b) or _of_equals(op, a, b, "bool")


def arithmetic(op, a, b):
    """Return the result of ``+ - * / // % **``."""
    kind = "real" if op == "/" else joined(a.kind, b.kind, "int")
    if op == "**":
        if b.kind == "int" and b.value is not None and b.value >= 0:
            return Expression("powi", (converted(a, "real"), b), "real")
        kind = "real"
    elif op in ("//", "%") and kind == "real":
        raise Outside(f"'{op}' of numbers that are not integers")
    return _folded(op, a, b) or _of_equals(op, a, b, kind, kind)


def _folded(op, a, b):
    """Return the constant result if it is known, else None; real arithmetic is not folded."""
    exact = a.kind == b.kind == "int" or op in COMPARISONS
    if op in _FOLDED and exact and None not in (a.value, b.value):
        return constant(_FOLDED[op](a.value, b.value))
    if exact and op in ("+", "-") and 0 in (a.value, b.value) and (op == "+" or b.value == 0):
        return a if b.value == 0 else b
    if exact and op == "*" and {0, 1} & {a.value, b.value}:
        return constant(0) if 0 in (a.value, b.value) else a if b.value == 1 else b
    if op in ("+", "-") and "real" in (a.kind, b.kind):  # infinity plus anything is infinity
        infinite = [x.value is not None and math.isinf(x.value) for x in (a, b)]
        if infinite == [True, False]:
            return a
        if infinite == [False, True]:
            return b if op == "+" else constant(-b.value)
    return None


def _of_equals(op, a, b, kind, operands=None):
    operands = operands or joined(a.kind, b.kind)
    return Expression(op, (converted(a, operands), converted(b, operands)), kind)


ZERO = constant(0)


@dataclass(frozen=True)
class Array:
    """An array of numbers, in row-major order.

    Parameters
    ----------
    name : str
    shape : tuple of int
    values : tuple of numbers, optional
        Values of a constant table, in row-major order; None for an argument.
    offset : Expression
        Index of the first number in the memory of the array.
    kind : str
    """

    name: str
    shape: tuple
    values: tuple | None = None
    offset: Expression = ZERO
    kind: str = "real"

    def at(self, indices):
        """Return a number, or a row where an index is missing; negative ones must be known."""
        place, sizes = self.offset, self.shape
        if len(indices) > len(sizes):
            raise Outside(f"{len(indices)} indices of an array of {len(sizes)} dimensions")
        for k, index in enumerate(indices):
            if index.kind != "int":
                raise Outside("an index that is not an integer")
            if index.value is not None:
                if not -sizes[k] <= index.value < sizes[k]:
                    raise Outside(f"index {index.value} of {sizes[k]}")
                index = constant(index.value % sizes[k])
            stride = constant(math.prod(sizes[k + 1 :]))
            step = index if stride.value == 1 else arithmetic("*", index, stride)
            place = step if place == ZERO else arithmetic("+", place, step)
        if len(indices) < len(sizes):
            return replace(self, shape=sizes[len(indices) :], offset=place)
        return Expression("load", (self, place), self.kind)

    def part(self, rows):
        """Return a contiguous range of the rows."""
        start, stop, step = rows.indices(self.shape[0])
        if step != 1:
            raise Outside("a part of an array that leaves numbers out")
        offset = self.offset + start * math.prod(self.shape[1:]) if start else self.offset
        return replace(self, shape=(max(stop - start, 0), *self.shape[1:]), offset=offset)

    def __getitem__(self, index):
        """Return ``array[..., k]``, as compositions read a column of their input."""
        return self.at([constant(index[-1])])


@dataclass(frozen=True)
class Assign:
    """``target = value``."""

    target: str
    value: Expression


@dataclass(frozen=True)
class Store:
    """``array[place] = value``."""

    array: Array
    place: Expression
    value: Expression


@dataclass(frozen=True)
class Call:
    """``outs = function(args)``; an output that is not used may be None."""

    function: object
    args: tuple
    outs: tuple


@dataclass(frozen=True)
class Listed:
    """A local array, initialised with numbers."""

    array: Array
    values: tuple


@dataclass(frozen=True)
class If:
    """``if test: body else: orelse``."""

    test: Expression
    body: tuple
    orelse: tuple


@dataclass(frozen=True)
class For:
    """``for target in range(start, stop, step): body``; ``carried`` are live where it begins."""

    target: str
    start: Expression
    stop: Expression
    step: int
    body: tuple
    carried: frozenset = frozenset()


@dataclass(frozen=True)
class While:
    """``while test: body``."""

    test: Expression
    body: tuple
    carried: frozenset = frozenset()


@dataclass(frozen=True)
class Return:
    """``return values``."""

    values: tuple


@dataclass(frozen=True)
class Jump:
    """``break`` or ``continue``."""

    word: str


@dataclass(frozen=True, eq=False)
class Function:
    """A function for arguments of known kinds and shapes.

    Parameters
    ----------
    name : str
    params : tuple of Expression and Array
        Arguments, with tuples split into their elements.
    body : tuple of statements
    result : Expression, or nested tuple of them
        One expression per number that is returned; only its kind matters.
    kinds : dict of str to str
        Kinds of the variables.
    writes : frozenset of str
        Arrays among the arguments that are written.
    """

    name: str
    params: tuple
    body: tuple
    result: object
    kinds: dict = field(repr=False)
    writes: frozenset


def leaves(value):
    """Return the numbers and arrays of a nested tuple."""
    if isinstance(value, tuple):
        return [leaf for part in value for leaf in leaves(part)]
    return [value]


def shape_of(value):
    """Return how tuples are nested."""
    if isinstance(value, tuple):
        return tuple(shape_of(part) for part in value)
    return value.shape if isinstance(value, Array) else None


def renamed(value, new):
    """Return nested tuples with each number replaced by ``new(number)``."""
    if isinstance(value, tuple):
        return tuple(renamed(part, new) for part in value)
    return new(value)


def mentioned(x, args_of=lambda call: call.args[1:]):
    """Return the names in a value, and ``"[]"`` where it reads an array that may change.

    ``args_of`` says which arguments of a call count.
    """
    if isinstance(x, Array):
        return mentioned(x.offset, args_of) | ({x.name, "[]"} if x.values is None else set())
    if not isinstance(x, Expression) or x.op == "const":
        return set()
    if x.op == "name":
        return {x.args[0]}
    args = args_of(x) if x.op == "call" else x.args
    return set().union(*(mentioned(arg, args_of) for arg in args))
