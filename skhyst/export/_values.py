"""Read the expressions in the source of a step: names, operators, elements and calls."""

import ast
import math
import re
from abc import ABC, abstractmethod
from dataclasses import replace

import numpy as np

from ._expressions import (
    Array,
    Assign,
    Call,
    Expression,
    Listed,
    arithmetic,
    compared,
    constant,
    converted,
    joined,
    leaves,
    mentioned,
    renamed,
    shape_of,
    variable,
)

MATH = frozenset(
    """
    acos acosh asin asinh atan atan2 atanh copysign cos cosh erf erfc exp expm1 fabs fmod hypot
    log log10 log1p log2 pow sin sinh sqrt tan tanh
    """.split()  # noqa: SIM905
)
ROUNDED = frozenset(("ceil", "floor", "trunc"))  # these return integers
_TESTS = ("isfinite", "isinf", "isnan")
_BUILTINS = {f.__name__: f for f in (abs, float, int, max, min)}
_OPERATORS = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
    ast.FloorDiv: "//",
    ast.Mod: "%",
    ast.Pow: "**",
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Gt: ">",
    ast.GtE: ">=",
    ast.Eq: "==",
    ast.NotEq: "!=",
}
# keywords of C and C++, and names that the printed text uses
_WORDS = frozenset(
    """
    auto bool break case char const continue default do double else enum extern false float for
    goto if inline int int32_t int64_t isfinite isnan long main register restrict return short
    signed sizeof static struct switch true typedef union uint64_t unsigned void volatile while
    alignas alignof and asm bitand bitor catch class compl concept const_cast constexpr decltype
    delete dynamic_cast explicit export friend mutable namespace new noexcept not nullptr operator
    or private protected public reinterpret_cast requires static_assert static_cast template this
    thread_local throw try typeid typename using virtual wchar_t xor
    """.split()  # noqa: SIM905
)
TAKEN = _WORDS | MATH | ROUNDED | {f"{name}f" for name in MATH | ROUNDED}


def signature(value, with_numbers=False):
    """Return the signature of an argument: its kind and shape, or its value.

    The value is kept only of a known number under ``with_numbers``.
    """
    if isinstance(value, tuple):
        return tuple(signature(part, with_numbers) for part in value)
    if with_numbers and isinstance(value, Expression) and value.value is not None:
        return value
    return Array("", value.shape, kind=value.kind) if isinstance(value, Array) else value.kind


class Values(ABC):
    """Reads the values in one function; see :func:`signature` about ``with_numbers``."""

    def __init__(self, global_names, file, definition, with_numbers):
        self._with_numbers = with_numbers
        self._globals, self._file, self._at = global_names, file, definition
        params = [argument.arg for argument in definition.args.args]
        nodes = [n for n in ast.walk(definition) if isinstance(n, ast.Name)]
        stored = params + [n.id for n in nodes if isinstance(n.ctx, ast.Store)]
        self._arguments, self._local = {*params}, {*stored}
        self._once = {name for name in stored if stored.count(name) == 1}  # and never changed
        self._kinds = {}

    def _begin(self):
        """Discard the reading so far, except the kinds of variables."""
        self._env, self._c_names = {}, {}
        self._head, self._block, self._writes, self._conditional = [], [], set(), 0
        self._n_writing = 0  # number of calls so far that write to arrays

    @abstractmethod
    def _function(self, function, *signatures):
        """Return another function, or the composed step of an object, for such arguments."""

    def _refuse(self, what):
        line = getattr(self._at, "lineno", "?")
        raise ValueError(f"{self._file}:{line}: {what} cannot be written in C.")

    def _c_name(self, name, *path):
        """Return a legal name in C, of a variable or of an element of a tuple."""
        key = (name, *path)
        if key not in self._c_names:
            legal = "_".join(map(str, key)).lstrip("_") or "t"
            if not re.fullmatch(r"[A-Za-z]\w*", legal, re.ASCII):
                self._refuse(f"the name {name!r}")
            used = {*self._c_names.values(), *(self._local - {name}), *TAKEN}
            while legal in used:
                legal += "_"
            self._c_names[key] = legal
        return self._c_names[key]

    def _argument(self, kinds, *path):
        if isinstance(kinds, str):
            name = self._c_name(*path)
            return variable(name, self._kinds.setdefault(name, kinds))
        if isinstance(kinds, Expression):
            return kinds
        if isinstance(kinds, Array):
            return replace(kinds, name=self._c_name(*path))
        return tuple(self._argument(part, *path, k) for k, part in enumerate(kinds))

    def _temporary(self, kind):
        name = self._c_name(f"t{len(self._c_names)}")
        self._kinds[name] = kind
        return variable(name, kind)

    def _kept(self, x):
        """Return a copy of a number, which later assignments do not change."""
        kept = self._temporary(x.kind)
        self._block.append(Assign(kept.args[0], x))
        return kept

    def _latest(self, x):
        """Return a variable with its present kind; a constant is returned unchanged."""
        return x if x.op == "const" else variable(x.args[0], self._kinds[x.args[0]])

    def _known(self, name):
        """Return the value of a name that is not a variable."""
        if name in self._local:
            self._refuse(f"{name!r}, which has no value yet,")
        value = self._globals.get(name, _BUILTINS.get(name))
        if isinstance(value, (bool, int, float, np.integer, np.floating)):
            return constant(value)
        if isinstance(value, np.ndarray) and value.dtype.kind in "if":
            kind = "real" if value.dtype.kind == "f" else "int"
            return Array(name, value.shape, tuple(value.ravel().tolist()), kind=kind)
        if isinstance(value, tuple) and all(isinstance(v, (int, float)) for v in value):
            return tuple(constant(v) for v in value)
        if value is None:
            self._refuse(f"the name {name!r}")
        return value

    def _in_order(self, *nodes):
        """Return the values of nodes that Python evaluates one after the other."""
        values = []
        for node in nodes:
            written = self._n_writing
            values.append(self._value(node))
            if self._n_writing > written and any("[]" in mentioned(x) for x in leaves(values[:-1])):
                self._refuse("what is read from an array before a call in the same line writes,")
        return values

    def _number(self, node):
        return self._as_number(self._value(node))

    def _as_number(self, value):
        if not isinstance(value, Expression):
            self._refuse("a tuple, an array or a function in the place of a number")
        return value

    def _value(self, node):
        match node:
            case ast.Constant(bool() | int() | float() as value):
                return constant(value)
            case ast.Name(name):
                return self._env[name] if name in self._env else self._known(name)
            case ast.Tuple(elements):
                return tuple(self._in_order(*elements))
            case ast.Attribute(of, name):
                return self._attribute(self._value(of), name)
            case ast.Subscript():
                return self._subscript(node)
            case ast.UnaryOp(ast.USub(), operand):
                x = self._number(operand)
                if x.value is not None:
                    return constant(-x.value)
                return Expression("neg", (x,), joined(x.kind, "int"))
            case ast.UnaryOp(ast.UAdd(), operand):
                return self._number(operand)
            case ast.UnaryOp(ast.Not(), _) | ast.Compare() | ast.BoolOp():
                return self._test(node, strict=True)
            case ast.BinOp(left, operator, right):
                sides = map(self._as_number, self._in_order(left, right))
                return arithmetic(self._symbol(operator), *sides)
            case ast.IfExp():
                return self._choice(node)
            case ast.Call():
                return self._call(node)
        self._refuse(f"'{type(node).__name__}'")

    def _symbol(self, operator):
        if type(operator) not in _OPERATORS:
            self._refuse(f"'{type(operator).__name__}'")
        return _OPERATORS[type(operator)]

    def _attribute(self, value, name):
        if value is math and isinstance(getattr(math, name, None), float):
            return constant(getattr(math, name))
        if value is math:
            return getattr(math, name, None)
        if isinstance(value, Array) and name == "size":
            return constant(math.prod(value.shape))
        if isinstance(value, Array) and name == "shape":
            return tuple(constant(n) for n in value.shape)
        self._refuse(f"the attribute {name!r}")

    def _subscript(self, node):
        value = self._value(node.value)
        if not isinstance(value, (Array, tuple)):
            self._refuse("an element of this")
        if isinstance(node.slice, ast.Slice):
            ends = node.slice.lower, node.slice.upper, node.slice.step
            numbers = [None if end is None else self._number(end).value for end in ends]
            if any(n is None and end is not None for n, end in zip(numbers, ends, strict=True)):
                self._refuse("a part whose ends are not known")
            part = slice(*numbers)
            return value.part(part) if isinstance(value, Array) else value[part]
        if isinstance(value, Array):
            indices = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
            return value.at([self._number(index) for index in indices])
        index = self._number(node.slice)
        if index.value is not None:
            if not -len(value) <= index.value < len(value):
                self._refuse(f"element {index.value} of {len(value)}")
            return value[index.value]
        return self._listed(value, node).at([index])

    def _listed(self, value, node):
        """Return a tuple of numbers as an array, so that C can index it by a variable."""
        numbers = [converted(self._as_number(x), "real") for x in value]
        name = node.value.id if isinstance(node.value, ast.Name) else "t"
        if all(x.value is not None for x in numbers):
            return Array(name, (len(value),), tuple(x.value for x in numbers))
        if self._conditional and name not in self._once:
            self._refuse("an element of a tuple that is chosen under a condition")
        array = Array(self._c_name(name, "all"), (len(value),))
        listed = Listed(array, tuple(numbers))
        place = self._head if name in self._arguments & self._once else self._block
        if listed not in place:
            place.append(listed)
        return array

    def _test(self, node, strict=False):
        """Return a condition; under ``strict`` a number is refused as one."""
        match node:
            case ast.BoolOp(operator, values):
                tests = [self._test(values[0], strict)]
                self._conditional += 1
                tests += [self._test(value, strict) for value in values[1:]]
                self._conditional -= 1
                return _logical("and" if isinstance(operator, ast.And) else "or", tests)
            case ast.UnaryOp(ast.Not(), operand):
                x = self._test(operand, strict)
                return Expression("not", (x,), "bool") if x.value is None else constant(not x.value)
            case ast.Compare(left, operators, rights):
                sides = [self._as_number(side) for side in self._in_order(left, *rights)]
                pairs = zip(operators, sides[:-1], sides[1:], strict=True)
                return _logical("and", [compared(self._symbol(op), a, b) for op, a, b in pairs])
        x = self._number(node)
        if x.kind == "bool":
            return x
        if strict:
            self._refuse("a number in the place of a condition")
        return compared("!=", x, converted(constant(0), x.kind))

    def _choice(self, node):
        test = self._test(node.test)
        if test.value is not None:
            return self._value(node.body if test.value else node.orelse)
        self._conditional += 1
        values = self._value(node.body), self._value(node.orelse)
        self._conditional -= 1
        if shape_of(values[0]) != shape_of(values[1]):
            self._refuse("a choice between values of several shapes")
        return _chosen(test, *values)

    def _call(self, node):
        if node.keywords or any(isinstance(a, ast.Starred) for a in node.args):
            self._refuse("a call with arguments that are not plain")
        function = self._value(node.func)
        args = self._in_order(*node.args)
        name = getattr(function, "__name__", None)
        if hasattr(function, "py_func"):
            return self._call_function(function.py_func, args)
        if hasattr(function, "compiled_step"):
            return self._call_function(function, (args[0], args[-1]))
        if _BUILTINS.get(name) is function:
            return self._builtin(name, [self._as_number(arg) for arg in args])
        if getattr(math, str(name), None) is function and name in _TESTS:
            return self._tested(name, converted(self._as_number(*args), "real"))
        if getattr(math, str(name), None) is function:
            reals = tuple(converted(self._as_number(arg), "real") for arg in args)
            if name in MATH:
                return Expression(f"math.{name}", reals, "real")
            if name in ROUNDED:
                return Expression("cast", (Expression(f"math.{name}", reals, "real"),), "int")
        self._refuse(f"a call of {ast.unparse(node.func)!r}")

    @staticmethod
    def _tested(name, x):
        """Return a condition on a number, without a function."""
        if name == "isnan":
            return compared("!=", x, x)
        size = Expression("abs", (x,), "real")
        return compared("==" if name == "isinf" else "<", size, constant(math.inf))

    def _builtin(self, name, args):
        kind = joined(*(x.kind for x in args), "int")
        if name in ("min", "max") and len(args) > 1:
            first, *others = (converted(x, kind) for x in args)
            for x in others:
                known = None not in (first.value, x.value)
                folded = constant(_BUILTINS[name](first.value, x.value)) if known else None
                first = folded or Expression(name, (first, x), kind)
            return first
        if len(args) == 1 and name == "abs":
            return Expression("abs", (converted(args[0], kind),), kind)
        if len(args) == 1 and name in ("int", "float"):
            return converted(args[0], "int" if name == "int" else "real")
        self._refuse(f"this call of {name!r}")

    def _call_function(self, python, args):
        try:
            numbers = self._with_numbers
            function = self._function(python, *(signature(arg, numbers) for arg in args))
        except RecursionError:
            self._refuse(f"{python.__name__!r}, which calls itself,")
        flat = []
        for x, param in zip(leaves(tuple(args)), function.params, strict=True):
            flat.append(x if isinstance(x, Array) else converted(x, param.kind))
            if isinstance(x, Array) and param.name in function.writes:
                if x.values is not None:
                    self._refuse("a constant that is written to")
                self._writes.add(x.name)
        if isinstance(function.result, Expression) and not function.writes:
            return Expression("call", (function, *flat), function.result.kind)
        if self._conditional:
            self._refuse("a call of several results, or that writes, under a condition")
        self._n_writing += bool(function.writes)
        result = renamed(function.result, lambda x: self._temporary(x.kind))
        outs = tuple(leaf.args[0] for leaf in leaves(result))
        self._block.append(Call(function, tuple(flat), outs))
        return result


def _chosen(test, a, b):
    if isinstance(a, tuple):
        return tuple(_chosen(test, x, y) for x, y in zip(a, b, strict=True))
    kind = joined(a.kind, b.kind)
    if a == b and a.value is not None:
        return a
    return Expression("choice", (test, converted(a, kind), converted(b, kind)), kind)


def _logical(word, tests):
    """Return the conjunction or disjunction, simplified by conditions whose value is known."""
    end = constant(word == "or")
    tests = [test for test in tests if test.value is None or test == end]
    if not tests:
        return constant(word == "and")
    if end in tests:
        tests = tests[: tests.index(end)]
        if not tests:
            return end
    whole = tests[0]
    for test in tests[1:]:
        whole = Expression(word, (whole, test), "bool")
    return whole
