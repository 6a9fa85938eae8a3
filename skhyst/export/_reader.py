"""Read the Python source of a step into expressions and statements.

A function is read once for each signature that it is called with: shapes are known then, so sizes
are numbers and tuples are split into their elements. The source is read repeatedly until the kinds
of its variables no longer change: a variable that is first an integer may be real later.
"""

import ast
import inspect
import textwrap
from functools import cache, lru_cache

from ._expressions import (
    Array,
    Assign,
    Call,
    Expression,
    For,
    Function,
    If,
    Jump,
    Outside,
    Return,
    Store,
    While,
    arithmetic,
    constant,
    converted,
    joined,
    leaves,
    mentioned,
    renamed,
    shape_of,
    variable,
)
from ._values import Values, signature


@lru_cache(maxsize=1024)
def read(function, *signatures, with_numbers=False):
    """Return a :class:`Function`.

    Parameters
    ----------
    function : callable
        In plain Python.
    *signatures : str, or nested tuples
        Of the arguments, see :func:`signature`.
    with_numbers : bool, default=False
        Whether functions that are called are specialised for known values of their arguments.

    Raises
    ------
    ValueError
        With file and line of the source that cannot be written in C.
    """
    return _Reader(function, signatures, with_numbers).function


@cache
def _definition(function):
    """Return file and syntax tree of a function, with the line numbers of the file."""
    try:
        lines, first = inspect.getsourcelines(function)
    except OSError as error:
        raise ValueError(f"The source of {function.__qualname__} is not available.") from error
    tree = ast.parse(textwrap.dedent("".join(lines)))
    ast.increment_lineno(tree, first - 1)
    return inspect.getsourcefile(inspect.unwrap(function)), tree.body[0]


class _Reader(Values):
    """Reads one function; ``_read_...`` are named by the statements of :mod:`ast`."""

    def __init__(self, function, signatures, with_numbers):
        file, definition = _definition(function)
        super().__init__(function.__globals__, file, definition, with_numbers)
        names = [argument.arg for argument in definition.args.args]
        plain = ast.arguments([], definition.args.args, None, [], [], None, [])
        if len(names) != len(signatures) or ast.dump(plain) != ast.dump(definition.args):
            self._refuse("a call with other arguments, or arguments that are not plain,")
        self._result, self._changed = None, True
        while self._changed:
            self._begin()
            self._changed, self._loops = False, set()
            for name, kinds in zip(names, signatures, strict=True):
                elements = self._elements(name, definition)
                if isinstance(kinds, tuple) and len(kinds) == len(elements):
                    parts = zip(kinds, elements, strict=True)
                    self._env[name] = tuple(self._argument(kind, one) for kind, one in parts)
                else:
                    self._env[name] = self._argument(kinds, name)
            self._params = tuple(leaf for name in names for leaf in leaves(self._env[name]))
            for name in names:
                if name not in self._once and getattr(self._env[name], "op", None) == "const":
                    self._assign(ast.Name(name), self._env[name])
            self._read_block(definition.body)
        params = tuple(self._latest(p) if isinstance(p, Expression) else p for p in self._params)
        result = () if self._result is None else self._result
        body, writes = (*self._head, *self._block), frozenset(self._writes)
        self.function = Function(definition.name, params, body, result, self._kinds, writes)

    def _function(self, function, *signatures):
        if hasattr(function, "compiled_step"):
            from ._composed_step import (
                composed,  # which reads the steps of its parts with this module
            )

            return composed(function.compiled_step, self._with_numbers)
        return read(function, *signatures, with_numbers=self._with_numbers)

    @staticmethod
    def _elements(name, definition):
        """Return the names of the elements of a tuple argument that the first statement unpacks."""
        first = definition.body[bool(ast.get_docstring(definition))]
        uses = [n for n in ast.walk(definition) if isinstance(n, ast.Name) and n.id == name]
        match first:
            case ast.Assign([ast.Tuple(targets)], ast.Name(of)) if of == name and len(uses) == 1:
                names = [target.id for target in targets if isinstance(target, ast.Name)]
                params = {argument.arg for argument in definition.args.args}
                if len(targets) == len({*names} - params - {"_"}):
                    return names
        return []

    def _read_block(self, statements):
        for statement in statements:
            self._at = statement
            method = getattr(self, f"_read_{type(statement).__name__}", None)
            if method is None:
                self._refuse(f"'{type(statement).__name__}'")
            try:
                method(statement)
            except Outside as error:
                self._refuse(str(error))
            if self._block and isinstance(self._block[-1], (Return, Jump)):
                return  # nothing after it is reached

    def _inner(self, statements):
        outer, self._block = self._block, []
        self._read_block(statements)
        block, self._block = tuple(self._block), outer
        return block

    def _read_Pass(self, node):
        pass

    def _read_Expr(self, node):
        if not isinstance(node.value, ast.Constant):
            self._value(node.value)

    def _read_Assign(self, node):
        value = self._value(node.value)
        if len(node.targets) > 1 and any(map(mentioned, leaves(value))):
            value = renamed(value, self._kept)
        for target in node.targets:
            self._assign(target, value)

    def _read_AugAssign(self, node):
        target = node.target
        sides = map(self._as_number, self._in_order(target, node.value))
        self._assign(target, arithmetic(self._symbol(node.op), *sides))

    def _assign(self, target, value):
        """Bind names to values; several numbers are assigned simultaneously, as Python does."""
        pairs = []
        self._pair(target, value, pairs)
        for i, (place, x) in enumerate(pairs):  # copy values that would be overwritten before use
            earlier = {p if isinstance(p, str) else "[]" for p, _ in pairs[:i]}
            if earlier & mentioned(x) and x.op != "const":
                pairs[i] = place, self._kept(x)
        call = self._block[-1] if self._block else None
        outs = call.outs if isinstance(call, Call) else ()
        direct = {}
        for place, x in pairs:
            is_out = x.op == "name" and x.args[0] in outs
            if isinstance(place, str) and is_out and self._kinds[place] == x.kind:
                direct[x.args[0]] = place
        if direct and len(set(direct.values())) == len(direct):
            self._block[-1] = Call(call.function, call.args, tuple(direct.get(o, o) for o in outs))
        else:
            direct = {}
        for place, x in pairs:
            if x.op == "name" and x.args[0] in direct:
                continue
            if isinstance(place, str):
                if x != variable(place, x.kind):
                    self._block.append(Assign(place, converted(x, self._kinds[place])))
            else:
                array, index = place.args
                self._block.append(Store(array, index, converted(x, array.kind)))

    def _pair(self, target, value, pairs):
        match target:
            case ast.Name("_"):
                return
            case ast.Name(name):
                if name in self._loops:
                    self._refuse(f"{name!r}, which is the variable of a loop,")
                if name in self._once and self._stands_for_itself(value):
                    self._env[name] = value
                    return
                self._pair_name(name, (name,), value, pairs)
                self._env[name] = self._bound(name, value)
            case ast.Subscript():
                place = self._subscript(target)
                if not isinstance(place, Expression) or place.op != "load":
                    self._refuse("an assignment to a part that is not a number")
                if place.args[0].values is not None:
                    self._refuse("an assignment to a constant")
                self._writes.add(place.args[0].name)
                pairs.append((place, self._as_number(value)))
            case ast.Tuple(targets):
                if isinstance(value, Array):
                    value = tuple(value.at([constant(k)]) for k in range(value.shape[0]))
                if not isinstance(value, tuple) or len(value) != len(targets):
                    self._refuse("an assignment of another number of values")
                for one, part in zip(targets, value, strict=True):
                    self._pair(one, part, pairs)
            case _:
                self._refuse("this assignment")

    def _stands_for_itself(self, value):
        """Whether a variable is replaced by its value: known integers, and numbers on request."""
        known = isinstance(value, Expression) and value.value is not None
        return known and (value.kind != "real" or self._with_numbers)

    def _pair_name(self, name, path, value, pairs):
        """Append pairs of the variables that hold a value, and its numbers."""
        if isinstance(value, tuple):
            for k, part in enumerate(value):
                self._pair_name(name, (*path, k), part, pairs)
        elif isinstance(value, Expression):
            c_name = self._c_name(*path)
            self._widen(c_name, value.kind)
            pairs.append((c_name, value))

    def _bound(self, name, value, *path):
        """Return the value that a name has from here on."""
        before = self._env.get(name) if not path else None
        if isinstance(value, tuple):
            bound = tuple(self._bound(name, part, *path, k) for k, part in enumerate(value))
        elif isinstance(value, Expression):
            bound = self._latest(variable(self._c_name(name, *path), value.kind))
        elif isinstance(value, Array) and not mentioned(value.offset):
            bound = value
        else:
            self._refuse(f"this value of {name!r}")
        if before is not None and shape_of(before) != shape_of(bound):
            self._refuse(f"{name!r}, which changes its shape,")
        if isinstance(before, Array) and before != bound:
            self._refuse(f"{name!r}, which stands for several arrays,")
        return bound

    def _widen(self, name, kind):
        before = self._kinds.get(name, kind)
        self._kinds[name] = joined(before, kind)
        self._changed |= self._kinds[name] != before

    def _read_Return(self, node):
        value = () if node.value is None else self._value(node.value)
        if any(isinstance(leaf, Array) for leaf in leaves(value)):
            self._refuse("an array that is returned")
        if self._result is None:
            self._result = value
        if shape_of(self._result) != shape_of(value):
            self._refuse("a result of several shapes")
        widest = _widest(self._result, value)
        self._changed |= signature(widest) != signature(self._result)
        self._result = widest
        kinds = [leaf.kind for leaf in leaves(widest)]
        numbers = zip(leaves(value), kinds, strict=True)
        self._block.append(Return(tuple(converted(x, kind) for x, kind in numbers)))

    def _read_If(self, node):
        test = self._test(node.test)
        if test.value is not None:
            self._read_block(node.body if test.value else node.orelse)
            return
        self._block.append(If(test, self._inner(node.body), self._inner(node.orelse)))

    def _read_For(self, node):
        match node:
            case ast.For(ast.Name(name), ast.Call(ast.Name("range"), bounds, []), _, []):
                bounds = [self._number(bound) for bound in bounds]
            case _:
                self._refuse("a loop other than 'for ... in range(...)'")
        start, stop, step = {1: lambda n: (constant(0), n, constant(1))}.get(
            len(bounds), lambda *b: (*b, constant(1))[:3]
        )(*bounds)
        if not step.value or any(b.kind != "int" for b in (start, stop)):
            self._refuse("a range of numbers that are not integers, or of an unknown step")
        if name in self._env:
            self._refuse(f"the loop over {name!r}, which is a variable already,")
        if None not in (start.value, stop.value) and not range(start.value, stop.value, step.value):
            return
        c_name = self._c_name(name)
        end = node.iter.args[min(len(bounds), 2) - 1]
        if stop.value is None and not (isinstance(end, ast.Name) and end.id in self._once):
            stop = self._kept(stop)
        self._kinds[c_name] = "int"
        self._env[name] = variable(c_name, "int")
        self._loops.add(name)
        body = self._inner(node.body)
        del self._env[name]  # in C its value after the loop is another
        self._block.append(For(c_name, start, stop, step.value, body))

    def _read_While(self, node):
        if node.orelse:
            self._refuse("'else' of a loop")
        self._conditional += 1
        test = self._test(node.test)
        self._conditional -= 1
        self._block.append(While(test, self._inner(node.body)))

    def _read_Break(self, node):
        self._block.append(Jump("break"))

    def _read_Continue(self, node):
        self._block.append(Jump("continue"))


def _widest(a, b):
    if isinstance(a, tuple):
        return tuple(_widest(x, y) for x, y in zip(a, b, strict=True))
    return variable("", joined(a.kind, b.kind))
