"""Print functions in the intermediate representation as C99."""

import math
from dataclasses import dataclass, field

import numpy as np

from ._expressions import (
    Array,
    Assign,
    Call,
    Expression,
    For,
    If,
    Jump,
    Listed,
    Return,
    Store,
    While,
    leaves,
    variable,
)
from ._slice import called, needs, within

SYMBOLS = {  # with their precedence
    "or": ("||", 1),
    "and": ("&&", 2),
    "==": ("==", 3),
    "!=": ("!=", 3),
    "<": ("<", 4),
    "<=": ("<=", 4),
    ">": (">", 4),
    ">=": (">=", 4),
    "+": ("+", 5),
    "-": ("-", 5),
    "*": ("*", 6),
    "/": ("/", 6),
}
_CHANGES = ("+", "-", "*", "/")  # that have an assignment form such as +=
CHOICE, UNARY, ATOM = 0, 7, 8
_PARTS = ("body", "orelse")  # of a statement
# operations of Python that have no operator in C
_HELPERS = {
    "min": "{t} {n}({t} a, {t} b)\n{{\n    return b < a ? b : a;\n}}",
    "max": "{t} {n}({t} a, {t} b)\n{{\n    return b > a ? b : a;\n}}",
    "abs": "{t} {n}({t} a)\n{{\n    return a < 0 ? -a : a;\n}}",
    "%": "{t} {n}({t} a, {t} b)\n{{\n    const {t} rest = a % b;\n"
    "    return rest != 0 && (rest < 0) != (b < 0) ? rest + b : rest;\n}}",
    "//": "{t} {n}({t} a, {t} b)\n{{\n    const {t} whole = a / b;\n"
    "    return a % b != 0 && (a < 0) != (b < 0) ? whole - 1 : whole;\n}}",
    "cast": "{t} {n}(int32_t a)\n{{\n    return ({t})a;\n}}",
    # half of the range, to which a few more can be added
    "trunc": "int32_t {n}({t} a)\n{{\n    const {t} most = ({t})1073741823;\n"
    "    return a < most ? a > -most ? (int32_t)a : -1073741823 : 1073741823;\n}}",
    "powi": "{t} {n}({t} a, int32_t n)\n{{\n    {t} power = {one};\n"
    "    while (n > 0) {{\n        power *= n % 2 == 1 ? a : {one};\n        a *= a;\n"
    "        n /= 2;\n"
    "    }}\n    return power;\n}}",
}
_WORDS = {"%": "modulo", "//": "quotient", "powi": "power", "cast": "real_of", "trunc": "whole_of"}


@dataclass(frozen=True)
class Dialect:
    """The C type of real numbers.

    Parameters
    ----------
    type : str
    suffix : str
        Suffix of literals and of functions of the math library.
    number : numpy scalar type
    """

    type: str
    suffix: str
    number: type

    def literal(self, x):
        """Return the C literal of a number."""
        cast = "(double)" if self.type == "double" else ""  # of what <math.h> has as a float
        if math.isnan(x):
            return f"{cast}NAN"
        with np.errstate(over="ignore"):
            if np.isinf(self.number(x)):
                return f"{'-' if x < 0.0 else ''}{cast}INFINITY"
        return self.digits(x) + self.suffix

    def digits(self, x):
        """Return the digits of a finite number."""
        least = float(np.finfo(self.number).tiny)
        x = math.copysign(max(abs(x), least), x) if x else x  # no number becomes zero
        value = self.number(x)
        text = np.format_float_positional(value, trim="0")
        if len(text) > 12:
            text = min(text, np.format_float_scientific(value, trim="0", exp_digits=1), key=len)
        return text


@dataclass
class Printer:
    """Collects tables and functions, each printed once.

    Parameters
    ----------
    prefix : str
        Prefix of all global names.
    dialect : Dialect
    """

    prefix: str
    dialect: Dialect
    tables: dict = field(default_factory=dict)
    functions: dict = field(default_factory=dict)
    texts: list = field(default_factory=list)
    taken: set = field(default_factory=set)

    def name(self, wanted):
        """Return a name that is not taken yet."""
        name = wanted = f"{self.prefix}_{wanted.strip('_')}"
        count = 1
        while name in self.taken:
            count += 1
            name = f"{wanted}_{count}"
        self.taken.add(name)
        return name

    def type_of(self, kind):
        """Return the type of numbers of a kind."""
        return {"bool": "bool", "int": "int32_t", "real": self.dialect.type}[kind]

    def literal(self, array):
        """Return the function that writes the numbers of a constant array."""
        return self.dialect.literal

    def table(self, array):
        """Return the name of a constant array."""
        key = (array.kind, array.values)
        if key not in self.tables:
            name = self.name(array.name)
            values = array.values or (0,)
            literal = str if array.kind == "int" else self.literal(array)
            rows = "".join(f"    {literal(value)},\n" for value in values)
            head = f"static const {self.type_of(array.kind)} {name}[{len(values)}]"
            self.tables[key] = name, f"{head} = {{\n{rows}}};\n"
        return self.tables[key][0]

    def helper(self, op, kind):
        """Return the name of the function for an operation."""
        key = (op, kind)
        if key not in self.functions:
            self.functions[key] = name = self.name(_WORDS.get(op, op))
            one = self.dialect.literal(1.0) if op == "powi" else ""
            text = _HELPERS[op].format(t=self.type_of(kind), n=name, one=one)
            self.texts.append(f"static {text}\n")
        return self.functions[key]

    def written(self, part):
        """Return the text of a function."""
        return FunctionText(self, part)

    def function(self, part, *place):
        """Return the name of a function, see :class:`Slice`; ``place`` is that of the call."""
        key = (part, *place)
        if key not in self.functions:
            text = self.written(part, *place)
            body = text.lines().removesuffix("    return;\n")  # prints what it calls first
            self.functions[key] = name = self.name(part.function.name)
            self.texts.append(f"static {text.head(name)}\n{{\n{body}}}\n")
        return self.functions[key]


class FunctionText:
    """Prints one function."""

    def __init__(self, printer, part):
        self._printer, self._part = printer, part
        self._type = printer.type_of
        names = [p for p, taken in zip(part.function.params, part.taken, strict=True) if taken]
        self._params = names
        self._places = {}
        self._place(part.body, ())
        self._loops = loops = {s.target for s in within(part.body) if isinstance(s, For)}
        params = {p.args[0] for p in names if isinstance(p, Expression)}
        self._firsts = {name: self._first(name) for name in self._places.keys() - params - loops}
        results = zip(leaves(part.function.result), part.mask, strict=True)
        self._results = [x.kind for x, used in results if used]

    def head(self, name):
        """Return the line that declares the function."""
        params = []
        for p in self._params:
            if isinstance(p, Array):
                const = "" if p.name in self._part.function.writes else "const "
                params.append(f"{const}{self._type(p.kind)} *{p.name}")
            else:
                params.append(f"{self._type(p.kind)} {p.args[0]}")
        several = len(self._results) > 1
        if several:
            params += [f"{self._type(k)} *out{i}" for i, k in enumerate(self._results)]
        result = "void" if several or not self._results else self._type(self._results[0])
        return f"{result} {name}({', '.join(params) or 'void'})"

    def lines(self):
        """Return the body."""
        return self._block(self._part.body, ())

    def _place(self, body, path):
        """Note where variables are used: the path to a block is that of statements and parts."""
        for k, statement in enumerate(body):
            names = {*_read(statement), *assigned(statement), *getattr(statement, "carried", ())}
            for name in names & self._part.function.kinds.keys():
                self._places.setdefault(name, []).append((*path, (k, "")))
            for part in _PARTS:
                self._place(getattr(statement, part, ()), (*path, (k, part)))

    def _first(self, name):
        """Return the path of the innermost block that holds a variable, and the first use in it."""
        places = self._places[name]
        depth = 0
        while len({place[depth] for place in places}) == 1 and places[0][depth][1]:
            depth += 1
        return places[0][:depth], min(place[depth][0] for place in places)

    def _block(self, body, path):
        """Return the lines of statements; a variable is declared at its first use."""
        lines, pad = [], (len(path) + 1) * "    "
        for k, statement in enumerate(body):
            text = self._statement(statement, (*path, k))
            new = sorted(name for name, first in self._firsts.items() if first == (path, k))
            own = assigned(statement)
            if new == own and len(new) == 1 and new[0] not in _read(statement):
                once = [n for s in within(self._part.body) for n in assigned(s)].count(new[0]) == 1
                kind = ("const " if once else "") + self._kind(new[0])
                text = f"{pad}{kind} {text.lstrip()}"
            else:
                lines += [f"{pad}{self._kind(name)} {name};\n" for name in new]
            lines.append(text)
        return "".join(lines)

    def _kind(self, name):
        return self._type(self._part.function.kinds[name])

    def _statement(self, statement, path):
        pad = len(path) * "    "
        match statement:
            case Assign(target, value):
                before = variable(target, value.kind)
                text = f"{self._change(target, value, before)};"
            case Store(array, place, value):
                before = Expression("load", (array, place), array.kind)
                text = f"{self._change(self._element(array, place), value, before)};"
            case Listed(array, values):
                texts = ", ".join(self._put(x, array.name) for x in values)
                kind = self._type(array.kind)
                text = f"const {kind} {array.name}[{len(values)}] = {{{texts}}};"
            case Call(_, args, outs):
                text = self._call(called(statement, outs), args, outs, path)
            case Return(values) if len(values) > 1:
                texts = [f"*out{k} = {self._put(x, k)};" for k, x in enumerate(values)]
                text = f"\n{pad}".join([*texts, "return;"])
            case Return(values):
                text = f"return{''.join(f' {self._put(x, 0)}' for x in values)};"
            case Jump(word):
                text = f"{word};"
            case If():
                text = self._if(statement, path)
            case While(test, _):
                text = f"while ({self._text(test)}) {self._braced(statement, path)}"
            case For(name, start, stop, step):
                compare, change = ("<", f" += {step}") if step > 0 else (">", f" -= {-step}")
                change = change[1] * 2 if abs(step) == 1 else change
                head = f"int32_t {name} = {self._text(start)}; {name} {compare} {self._text(stop)}"
                text = f"for ({head}; {name}{change}) {self._braced(statement, path)}"
        return f"{pad}{text}\n"

    def _put(self, x, place):
        """Return the text that assigns to a variable, by its name, or to a result, by number."""
        return self._text(x)

    def _call(self, part, args, outs, path):
        kept = [out for out in outs if out is not None]
        if len(kept) > 1:
            return f"{self._called(part, args, kept)};"
        return f"{''.join(f'{out} = ' for out in kept)}{self._called(part, args)};"

    def _change(self, target, value, before):
        if value.op in _CHANGES and value.args[0] == before:
            return f"{target} {value.op}= {self._text(value.args[1])}"
        return f"{target} = {self._text(value)}"

    def _braced(self, statement, path, part="body"):
        text = self._block(getattr(statement, part), (*path[:-1], (path[-1], part)))
        return f"{{\n{text}{len(path) * '    '}}}"

    def _if(self, statement, path):
        if not statement.body:
            test = statement.test
            opposite = {"==": "!=", "!=": "=="}.get(test.op)
            if opposite:
                test = Expression(opposite, test.args, "bool")
            else:
                test = Expression("not", (test,), "bool")
            return f"if ({self._text(test)}) {self._braced(statement, path, 'orelse')}"
        text = f"if ({self._text(statement.test)}) {self._braced(statement, path)}"
        if not statement.orelse:
            return text
        other = self._block(statement.orelse, (*path[:-1], (path[-1], "orelse")))
        inner = statement.orelse[0]
        ends = isinstance(inner, If) and inner.body and inner.orelse  # as MISRA wants "else if"
        if ends and len(statement.orelse) == 1 and other.lstrip().startswith("if ("):
            other = other.strip().replace("\n    ", "\n")
            return f"{text} else {other}"
        return f"{text} else {{\n{other}{len(path) * '    '}}}"

    def _called(self, part, args, outs=()):
        texts = [self._text(arg) for arg in part.args(args)] + [f"&{out}" for out in outs]
        return f"{self._printer.function(part)}({', '.join(texts)})"

    def _element(self, array, place):
        name = array.name if array.values is None else self._printer.table(array)
        return f"{name}[{self._text(place)}]"

    def _text(self, x):
        """Return an expression or array."""
        if isinstance(x, Array):
            name = x.name if x.values is None else self._printer.table(x)
            return name if x.offset.value == 0 else f"{name} + {self._text(x.offset)}"
        return self._bound(x)[0]

    def _bound(self, x):
        """Return the text of an expression and how tightly it is bound."""
        op, args = x.op, x.args
        if op in SYMBOLS:
            symbol, binding = SYMBOLS[op]
            left, right = self._bound(args[0]), self._bound(args[1])
            # the left operand may have the same precedence; conditions are put in parentheses
            least = max(binding, 5)
            a = left[0] if left[1] >= least else f"({left[0]})"
            b = right[0] if right[1] > max(binding, 4) else f"({right[0]})"
            if op in ("and", "or") and args[0].op == op:
                a = left[0]
            return f"{a} {symbol} {b}", binding
        match op:
            case "const":
                return self._constant(*args, x.kind), UNARY
            case "name":
                return args[0], ATOM
            case "load":
                return self._element(*args), ATOM
            case "call":
                return self._called(called(x), args[1:]), ATOM
            case "choice":
                typed = "(int32_t)" if x.kind == "int" else ""  # constants alone are narrower
                texts = [self._tight(a, CHOICE + 1) for a in args]
                texts = [typed * (a.op == "const") + t for a, t in zip(args, texts, strict=True)]
                return "{} ? {} : {}".format(*texts), CHOICE
            case "neg" | "not":
                return ("-" if op == "neg" else "!") + self._tight(args[0], UNARY + 1), UNARY
            case "cast" if self._bound(args[0])[1] >= UNARY or args[0].kind == "bool":
                return f"({self._type(x.kind)}){self._tight(args[0], UNARY + 1)}", UNARY
            case "cast" if x.kind == "int":  # as MISRA wants: no cast of a sum or product
                return f"{self._printer.helper('trunc', 'real')}({self._text(args[0])})", ATOM
            case "abs" if x.kind == "real":
                op = "math.fabs"
            case "**":
                op = "math.pow"
        texts = ", ".join(self._text(a) for a in args)
        if op.startswith("math."):
            return f"{op[5:]}{self._printer.dialect.suffix}({texts})", ATOM
        return f"{self._printer.helper(op, x.kind)}({texts})", ATOM

    def _tight(self, x, least):
        text, binding = self._bound(x)
        return text if binding >= least else f"({text})"

    def _constant(self, value, kind):
        if kind == "real":
            return self._printer.dialect.literal(value)
        return str(value).lower()


def assigned(statement):
    """Return the variables that a statement itself writes."""
    if isinstance(statement, Assign):
        return [statement.target]
    if isinstance(statement, Call):
        return [out for out in statement.outs if out is not None]
    return []


def _read(statement):
    """Return the names that a statement itself reads, those of statements inside it aside."""
    match statement:
        case Assign(_, value):
            return needs(value)
        case Store(array, place, value):
            return needs(array, place, value)
        case Call(_, args, outs):
            return needs(*called(statement, outs).args(args))
        case Listed(_, values) | Return(values):
            return needs(*values)
        case If(test) | While(test):
            return needs(test)
        case For(_, start, stop):
            return needs(start, stop)
    return frozenset()
