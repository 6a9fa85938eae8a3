"""A translator of Structured Text to Python, for what exported function blocks are made of.

It keeps to the standard where it is strict: declared types agree without conversion, names do not
depend on case, inputs are read only, all operands are evaluated, indices are within their arrays.
``EXCEPTIONS`` collects what would stop a controller: divisions by zero, overflow.
"""

import math
import re

import numpy as np

EXCEPTIONS = []
_TOKENS = re.compile(
    r"\s*(?:\(\*.*?\*\)\s*)*("
    r"'[^']*'|(?:REAL#)?\d+\.\d+(?:E[-+]?\d+)?|\d+|[A-Za-z]\w*|:=|=>|<=|>=|<>|\.\.|[-+*/=<>(),;:.\[\]]"
    r"|$)",
    re.DOTALL,
)
_ENDS = {"END_IF", "ELSE", "ELSIF", "END_FOR", "END_WHILE", "END_FUNCTION"} | {
    "END_FUNCTION_BLOCK",
    "END_PROGRAM",
}
_PRECEDENCE = [["OR"], ["AND"], ["=", "<>"], ["<", ">", "<=", ">="], ["+", "-"], ["*", "/", "MOD"]]
_PYTHON = {"OR": "|", "AND": "&", "=": "==", "<>": "!=", "MOD": "%"}
_OF_REALS = ("SQRT", "EXP", "LN", "LOG", "SIN", "COS", "TAN", "ASIN", "ACOS", "ATAN", "EXPT")
_REALS = ("REAL", "LREAL")


def single(x):
    """Round to single precision."""
    with np.errstate(over="ignore"):
        return float(np.float32(x))


def _over(a, b):
    if b == 0:
        EXCEPTIONS.append("division by zero")
        return float(np.divide(a, b)) if a else math.nan
    return a / b


def _whole(a, b):
    return int(math.copysign(abs(a) // abs(b), a * b)) if a else 0


def _trunc(x):
    n = int(x)
    assert -(2**31) <= n < 2**31
    return n


def _at(k, n):
    assert 0 <= k < n
    return k


def _of_math(name):
    own = {"ln": "log", "log": "log10", "expt": "pow"}.get(name.lower(), name.lower())

    def called(*args):
        try:
            return getattr(math, own)(*args)
        except (ValueError, OverflowError) as error:
            EXCEPTIONS.append(f"{name}: {error}")
            with np.errstate(all="ignore"):
                return float(getattr(np, {"pow": "power"}.get(own, own))(*args))

    return called


RUNTIME = {"_over": _over, "_whole": _whole, "_trunc": _trunc, "_at": _at, "single": single}
RUNTIME |= {"_rest": math.fmod} | {f"_{name.lower()}": _of_math(name) for name in _OF_REALS}


class Translator:
    """Translates a text to ``units``: Python functions and classes by name, in lower case."""

    def __init__(self, text):
        self._tokens = [m[1] for m in _TOKENS.finditer(text)]
        assert "".join(self._tokens) == re.sub(
            r"\s+", "", re.sub(r"\(\*.*?\*\)", "", text, flags=re.DOTALL)
        )
        self._k, self._declared, self.units = 0, {}, dict(RUNTIME)
        while self._tokens[self._k]:
            self._unit()

    def _peek(self):
        return self._tokens[self._k].upper()

    def _take(self, *wanted):
        token = self._tokens[self._k]
        assert not wanted or token.upper() in wanted, (token, wanted)
        self._k += 1
        return token

    def _is(self, *words):
        if self._peek() not in words:
            return False
        self._k += 1
        return True

    def _type(self):
        word = self._take().upper()
        if word == "ARRAY":
            for mark in ("[", "0", ".."):
                self._take(mark)
            n = int(self._take()) + 1
            self._take("]")
            self._take("OF")
            return n, self._take("REAL", "LREAL", "DINT", "BOOL")
        if word == "STRING":
            for mark in ("(", "64", ")"):
                self._take(mark)
        else:
            assert word in ("BOOL", "DINT", *_REALS) or word.lower() in self._declared, word
        return word

    def _unit(self):
        kind, name = self._take("FUNCTION", "FUNCTION_BLOCK", "PROGRAM").upper(), self._take()
        self._own, self._names, self._is_function = name.lower(), {}, kind == "FUNCTION"
        assert self._own not in self._declared
        result = (self._take(":"), self._type())[1] if self._is_function else None
        sections = {}
        while self._peek().startswith("VAR"):
            word = self._take().upper()
            for own, type_, first in self._variables():
                assert own not in {*self._names, self._own}
                self._names[own] = type_, word
                sections.setdefault(word, []).append((own, type_, first))
        if self._is_function:
            self._names[self._own] = result, "VAR"
        self._declared[self._own] = kind, result, sections
        body = self._block(1)
        self._take(f"END_{kind}")
        firsts = [
            f"{self._variable(own)} = {first}"
            for word, rows in sections.items()
            for own, _, first in rows
            if not self._is_function or word in ("VAR", "VAR_OUTPUT")
        ]
        if self._is_function:
            given = [
                own for word in ("VAR_INPUT", "VAR_IN_OUT") for own, *_ in sections.get(word, ())
            ]
            outs = [f"v_{self._own}", *(f"v_{own}" for own, *_ in sections.get("VAR_OUTPUT", ()))]
            self._outs = f"return {', '.join(outs)}"
            lines = [f"def {self._own}({', '.join(f'v_{own}' for own in given)}):"]
            lines += [f"    {line}" for line in firsts]
            lines += [line.replace("RETURN", self._outs) for line in body] + [f"    {self._outs}"]
        else:
            lines = [f"class {self._own}:", "  def __init__(self):", *(f"    {f}" for f in firsts)]
            lines += ["  def __call__(self, **given):", "    self.__dict__.update(given)", *body]
        exec("\n".join(lines), self.units)

    def _variables(self):
        while not self._is("END_VAR"):
            name = self._take().lower()
            self._take(":")
            type_ = self._type()
            first = self._first(type_) if self._is(":=") else None
            self._take(";")
            yield name, type_, first or self._zero(type_)

    def _zero(self, type_):
        if isinstance(type_, tuple):
            return f"[{self._zero(type_[1])}] * {type_[0]}"
        zeros = {"BOOL": "False", "DINT": "0", "STRING": "''"} | dict.fromkeys(_REALS, "0.0")
        return zeros.get(type_, f"{type_.lower()}()")

    def _first(self, type_):
        if not isinstance(type_, tuple):
            sign = "-" if self._is("-") else ""
            text = self._take()
            assert ("." in text) == (type_ in _REALS) or type_ == "STRING"
            return f"single({sign}{text})" if type_ == "REAL" else sign + text
        self._take("[")
        values = [self._first(type_[1])]
        while self._is(","):
            values.append(self._first(type_[1]))
        self._take("]")
        assert len(values) == type_[0]
        return f"[{', '.join(values)}]"

    def _variable(self, name):
        return f"v_{name}" if self._is_function else f"self.{name}"

    # statements

    def _block(self, depth):
        lines = []
        while self._peek() not in _ENDS:
            lines += [f"{'    ' * depth}{line}" for line in self._statement(depth)]
        return lines or [f"{'    ' * depth}pass"]

    def _statement(self, depth):
        word = self._take()
        match word.upper():
            case "IF":
                lines = [f"if {self._condition()}:", *self._inner("THEN")]
                while self._is("ELSIF"):
                    lines += [f"elif {self._condition()}:", *self._inner("THEN")]
                lines += ["else:", *self._inner("ELSE")] if self._peek() == "ELSE" else []
                self._take("END_IF")
            case "FOR":
                name = self._take().lower()
                assert self._names[name] == ("DINT", "VAR")
                self._take(":=")
                first, last = self._of("DINT"), (self._take("TO"), self._of("DINT"))[1]
                step = self._of("DINT") if self._is("BY") else "1"
                end = f"{last} + {'-1' if step.startswith('-') else '1'}"
                lines = [f"for {self._variable(name)} in range({first}, {end}, {step}):"]
                lines += self._inner("DO")
                self._take("END_FOR")
            case "WHILE":
                lines = [f"while {self._condition()}:", *self._inner("DO")]
                self._take("END_WHILE")
            case "EXIT" | "CONTINUE" | "RETURN":
                return [{"EXIT": "break", "CONTINUE": "continue"}.get(word, self._end())]
            case _ if self._peek() == "(":  # of an instance
                name = word.lower()
                block = self._declared[self._names[name][0].lower()]
                inputs = {own: type_ for own, type_, _ in block[2]["VAR_INPUT"]}
                args, _ = self._arguments(inputs, {}, {})
                self._take(";")
                given = [f"{k}={v}" + "[:]" * isinstance(inputs[k], tuple) for k, v in args.items()]
                return [f"{self._variable(name)}({', '.join(given)})"]
            case _:
                target, type_ = self._place(word)
                assert self._names[word.lower()][1] in ("VAR", "VAR_OUTPUT", "VAR_IN_OUT"), word
                self._take(":=")
                text, outs = self._with_outs(type_)
                self._take(";")
                assert not isinstance(type_, tuple) or target.startswith("self.")
                return [f"{', '.join([target, *outs])} = {text}" + "[:]" * isinstance(type_, tuple)]
        self._take(";") if self._peek() == ";" else None
        return lines

    def _end(self):
        self._take(";")
        return "RETURN"

    def _inner(self, word):
        self._take(word)
        return self._block(1)

    def _condition(self):
        return self._of("BOOL")

    # expressions: text and type

    def _of(self, wanted):
        text, type_ = self._expression()
        assert type_ == wanted, (text, type_, wanted)
        return text

    def _with_outs(self, wanted):
        """Return the text of what is assigned, and where further outputs of a call go."""
        self._targets = []
        text = self._of(wanted)
        outs, self._targets = self._targets, []
        return text, outs

    def _expression(self, level=0):
        if level == len(_PRECEDENCE):
            return self._unary()
        a, type_ = self._expression(level + 1)
        while self._peek() in _PRECEDENCE[level]:
            symbol = self._take().upper()
            b, other = self._expression(level + 1)
            assert type_ == other, (a, type_, symbol, b, other)
            if level < 2:
                assert type_ == "BOOL"
            elif level >= 3:
                assert type_ == "DINT" if symbol == "MOD" else type_ in ("DINT", *_REALS)
            a = self._operation(symbol, a, b, type_)
            type_ = "BOOL" if level in (2, 3) else type_
        return a, type_

    @staticmethod
    def _operation(symbol, a, b, type_):
        if symbol == "/":
            text = f"_whole({a}, {b})" if type_ == "DINT" else f"_over({a}, {b})"
        elif symbol == "MOD":
            text = f"int(_rest({a}, {b}))"
        else:
            text = f"({a} {_PYTHON.get(symbol, symbol)} {b})"
        return f"single({text})" if type_ == "REAL" and symbol in "+-*/" else text

    def _unary(self):
        if self._is("-"):
            text, type_ = self._unary()
            assert type_ in ("DINT", *_REALS)
            return f"(-{text})" if not text.isdigit() else f"-{text}", type_
        if self._is("NOT"):
            text, type_ = self._unary()
            assert type_ == "BOOL"
            return f"(not {text})", type_
        if self._is("("):
            text, type_ = self._expression()
            self._take(")")
            return f"({text})", type_
        token = self._take()
        if token.upper() in ("TRUE", "FALSE"):
            return token.capitalize(), "BOOL"
        if token.startswith("REAL#"):
            return repr(single(token[5:])), "REAL"
        if token[0].isdigit():
            return token, "LREAL" if "." in token else "DINT"
        return self._call(token.upper()) if self._peek() == "(" else self._place(token)

    def _place(self, word):
        name = word.lower()
        type_, _ = self._names[name]
        text = self._variable(name)
        if self._is("."):
            rows = self._declared[type_.lower()][2]["VAR_OUTPUT"]
            own = self._take().lower()
            return f"{text}.{own}", {n: t for n, t, _ in rows}[own]
        if not self._is("["):
            return text, type_
        index = self._of("DINT")
        self._take("]")
        n, type_ = type_
        if index.isdigit():
            assert int(index) < n
            return f"{text}[{index}]", type_
        return f"{text}[_at({index}, {n})]", type_

    def _call(self, name):
        if name.lower() in self._declared:
            kind, result, sections = self._declared[name.lower()]
            assert kind == "FUNCTION"
            inputs, shared, outs = (
                {own: type_ for own, type_, _ in sections.get(word, ())}
                for word in ("VAR_INPUT", "VAR_IN_OUT", "VAR_OUTPUT")
            )
            args, targets = self._arguments(inputs, shared, outs)
            assert ({*args}, {*targets}) == ({*inputs, *shared}, {*outs})
            if outs:  # only as a whole right-hand side
                assert (self._peek(), self._targets) == (";", [])
                self._targets = [targets[own] for own in outs]
            return f"{name.lower()}({', '.join(f'v_{k}={v}' for k, v in args.items())})", result
        self._take("(")
        args = [self._expression()]
        while self._is(","):
            args.append(self._expression())
        self._take(")")
        texts, types = zip(*args, strict=True)
        conversion = re.fullmatch(r"(BOOL|DINT|REAL|LREAL)_TO_(DINT|REAL|LREAL)", name)
        given = ", ".join(texts)
        if conversion:
            assert types == (conversion[1],)
            to = {"DINT": "int", "REAL": "single", "LREAL": "float"}[conversion[2]]
            return f"{to}({given})", conversion[2]
        if name == "TRUNC":
            assert types in (("REAL",), ("LREAL",))
            return f"_trunc({given})", "DINT"
        assert {*types} in ({"DINT"}, {"REAL"}, {"LREAL"})
        if name in ("ABS", "MIN", "MAX"):
            return f"{name.lower()}({given})", types[0]
        assert (name in _OF_REALS, len(types)) == (True, 1 + (name == "EXPT"))
        assert types[0] in _REALS
        text = f"_{name.lower()}({given})"
        return (f"single({text})" if types[0] == "REAL" else text), types[0]

    def _arguments(self, inputs, shared, outs):
        self._take("(")
        args, targets = {}, {}
        while not self._is(")"):
            name = self._take().lower()
            assert name not in args
            if name in outs:
                self._take("=>")
                targets[name], type_ = self._place(self._take())
                assert type_ == outs[name]
            else:
                self._take(":=")
                if name in shared:
                    own = self._peek().lower()
                    assert self._names[own][1] != "VAR_INPUT"
                args[name] = self._of({**inputs, **shared}[name])
            assert self._is(",") or self._peek() == ")"
        return args, targets


def blocks_of(*paths):
    """Return the functions, function blocks and programs of files by name, in lower case."""
    return Translator("\n".join(path.read_text() for path in paths)).units
