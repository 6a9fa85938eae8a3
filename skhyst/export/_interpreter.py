"""Run a step in the intermediate representation, number by number.

Each function is written in Python, number by number, and compiled when it is first called.
Subclasses add lines that see or round each number. A variable is written ``v_x``, an array as a
list ``a_x`` and the place ``o_x`` where it begins in it.
"""

import itertools
import math
import re

import numpy as np

from ._expressions import (
    COMPARISONS,
    Array,
    Assign,
    Call,
    For,
    If,
    Jump,
    Listed,
    Return,
    Store,
    While,
)
from ._slice import called


def _power(a, b):
    try:
        return math.pow(a, b)
    except (ValueError, OverflowError):  # infinite, or not a number
        return float(np.power(float(a), float(b)))


_TYPES = {"bool": bool, "int": int, "real": float}
_FORMS = {  # of operations that are not a function of their name
    **{op: f"{{}} {op} {{}}" for op in ("+", "-", "*", "//", "%", *COMPARISONS)},
    "/": "{0} / {1} if {1} else float(divide({0}, {1}))",
    "neg": "-{}",
    "not": "not {}",
    "**": "power({}, {})",
    "powi": "power({}, {})",
}
_VARIABLES = re.compile(r"\b[vao]_\w+")


class Interpreter:
    """Runs the step of a whole model, sample by sample.

    Numbers belong to a frame: the index of the step's call in the body of the model, None for the
    model itself, and the function.

    Parameters
    ----------
    model : Slice
        See :func:`~skhyst.export._composed_step.model_step`.
    state : ndarray of shape (n_states,)
    tuned : ndarray of shape (n_constants,), optional
        Constants that can be changed at run time.
    """

    _first = ""  # line of each function

    def __init__(self, model, state, tuned=()):
        self._model, self._state = model, np.array(state, dtype=float).tolist()
        self._tuned = np.array(tuned, dtype=float).tolist()
        self._row = isinstance(model.function.params[0], Array)
        self._functions, self._trials, self._numbers = {}, [], {}
        self._names = {"math": math, "power": _power, "divide": np.divide, "self": self}
        self._names |= {"inf": math.inf, "nan": math.nan}

    def answer(self, u):
        """Return the response to the next sample of a drive, (n_inputs,)."""
        u = [float(x) for x in u]
        given = [(u, 0) if self._row else u[:1], (self._state, 0), (self._tuned, 0)]
        given = self._model.args(given[: len(self._model.function.params)])
        with np.errstate(all="ignore"):
            return self._names[self._function(None, self._model)](*itertools.chain(*given))[0]

    # hooks for subclasses: they return a line, or nothing

    def _noted(self, name, *key, operands=()):
        """See a variable, an expression or a result; one that is infinite where operands are."""

    def _noted_state(self, name, step):
        """See the numbers of the state of a step, in a list."""

    def _stored(self, name, *key):
        """Round a real number as it is stored."""

    def _constant(self, value, step):
        """Return a real constant as it is stored."""
        return value

    def _compared(self, names, args, frame):
        """Return the texts of two real numbers as they are compared."""
        return names

    def _checked(self, op, name, part):
        """See an operand of an operation."""

    def _tried(self, place, trial):
        """See a branch that is not taken; ``trial()`` returns the number of its trial."""

    def _entered(self, place):
        """See a branch that is taken."""

    def _counted(self, n):
        """Count operations that follow."""

    def _turns(self):
        """Return what a loop without an end runs over."""
        return itertools.repeat(None)

    # functions

    def _number(self, *key):
        """Return the number by which lines name something."""
        return self._numbers.setdefault(key, len(self._numbers))

    def _function(self, step, part):
        """Return the name of a function of those arguments that are used."""
        if (step, part) not in self._functions:
            text = _Text(self, (step, part))
            self._functions[step, part] = self._compiled(text.function(), text)
        return self._functions[step, part]

    def _table(self, array):
        """Return the name of the numbers of a constant array."""
        name = f"c{self._number(array.kind, array.values)}"
        self._names.setdefault(name, [_TYPES[array.kind](x) for x in array.values])
        return name

    def _later(self, frame, write):
        """Return the number of a trial, which ``write(text)`` writes when it is first run."""
        self._trials.append((frame, write))
        return len(self._trials) - 1

    def _run_trial(self, trial, variables):
        """Run a branch on a copy of the variables."""
        if isinstance(self._trials[trial], tuple):
            frame, write = self._trials[trial]
            text = _Text(self, frame, is_trial=True)
            write(text)
            self._trials[trial] = self._compiled(["variables"], text)
        self._names[self._trials[trial]](variables)

    def _compiled(self, params, text):
        """Return the name of a new function."""
        name = f"f{len(self._names)}"
        source = f"def {name}({', '.join(params)}):\n{text}"
        exec(compile(source, f"<{name}>", "exec"), self._names)
        return name


class _Text:
    """Writes one function, or a branch of it that is tried.

    Parameters
    ----------
    runner : Interpreter
    frame : tuple
    is_trial : bool
        A jump or a result ends a trial.
    """

    def __init__(self, runner, frame, is_trial=False):
        self._runner, self._frame, self._is_trial = runner, frame, is_trial
        self._lines, self._depth, self._n, self._loops = [], 1, 0, 0
        self._counts = []  # number of operations of each block
        self._line(runner._first)
        self._count()

    def __str__(self):
        lines = [
            (depth, self._runner._counted(*line) or "pass" if isinstance(line, list) else line)
            for depth, line in self._lines
        ]
        text = "\n".join(" " * depth + line for depth, line in lines)
        if not self._is_trial:
            return text
        given = (
            f" if '{name}' in variables: {name} = variables['{name}']{'[:]' * (name[0] == 'a')}"
            for name in sorted(set(_VARIABLES.findall(text)))
        )
        return "\n".join((*given, text))

    def _line(self, text):
        if text:
            self._lines.append((self._depth, text))

    def _count(self):
        """Begin to count operations, in a line that is written last."""
        self._counts.append([0])
        self._lines.append((self._depth, self._counts[-1]))

    def _under(self, head, write, *args):
        """Write lines that belong to another."""
        self._line(head)
        self._depth += 1
        self._count()
        write(*args)
        self._counts.pop()
        self._depth -= 1

    def _new(self, text):
        """Return the name of a new number."""
        self._n += 1
        self._line(f"t{self._n} = {text}")
        return f"t{self._n}"

    def _see(self, name, kind, *key, operands=()):
        if kind != "bool":
            self._line(self._runner._noted(name, *self._frame, *key, operands=operands))

    # functions and statements

    def function(self):
        """Write the function of the frame and return its arguments."""
        _, part = self._frame
        params, names = part.args(part.function.params), []
        for p in params:
            names += [f"a_{p.name}", f"o_{p.name}"] if isinstance(p, Array) else [self.value(p)]
        for p in params:
            if not isinstance(p, Array):
                self._see(self.value(p), p.kind, *p.args)
        self.block(part.body)
        self._line("return ()")
        return names

    def block(self, body):
        """Write statements."""
        for k, statement in enumerate(body):
            self._statement(statement, k, body[k + 1 :])

    def _statement(self, statement, k, rest):
        match statement:
            case Assign(target, value):
                self._line(f"v_{target} = {self.value(value)}")
                self._see(f"v_{target}", value.kind, target)
            case Store(array, place, value):
                value = self.value(value)
                self._line(f"{self._element(array, place)} = {value}")
            case Listed(array, values):
                values = ", ".join(map(self.value, values))
                self._line(f"a_{array.name}, o_{array.name} = [{values}], 0")
                self._line(f"for x in a_{array.name}:")
                self._depth += 1
                self._line("pass")
                self._see("x", array.kind, array.name)
                self._depth -= 1
            case Call():
                self._call(statement, k)
            case Jump(word):
                self._line(word if self._loops else "return ()")
            case If():
                self._if(statement, rest)
            case For(name, start, stop, step, body):
                bounds = f"{self.value(start)}, {self.value(stop)}, {step}"
                self._loop(f"for v_{name}, _ in zip(range({bounds}), self._turns()):", body)
            case While(test, body):
                self._loop("for _ in self._turns():", body, test)
            case Return(values):
                names = [self.value(x) for x in values]
                for place, (name, x) in enumerate(zip(names, values, strict=True)):
                    if not self._is_trial:
                        self._see(name, x.kind, place)
                self._line(f"return ({''.join(f'{name}, ' for name in names)})")

    def _call(self, call, k):
        outs = [out for out in call.outs if out is not None]
        part, note = called(call, outs), None
        step, whole = self._frame
        if step is None:
            step, own = k, call.args[-1]
            if whole.taken[1]:
                memory, begin = self._view(own)
                note = f"{memory}[{begin}:{begin} + {own.shape[0]}]"
                note = self._runner._noted_state(note, step)
        text = self._called(part, call.args, step)
        self._line(note)
        self._line(f"{''.join(f'v_{out}, ' for out in outs)}{'= ' * bool(outs)}{text}")
        self._line(note)
        for out in outs:
            self._see(f"v_{out}", whole.function.kinds[out], out)

    def _if(self, statement, rest):
        sides, test = (statement.orelse, statement.body), self.value(statement.test)
        places = [(self._frame, id(statement), held) for held in (False, True)]

        def write(held):
            # the other branch: with the later statements, if this one leaves the block
            other = (*sides[not held], *rest) if _leaves(sides[held]) else sides[not held]
            self._line(self._runner._entered(places[held]))
            self._try(places[not held], lambda text: text.block(other))
            self.block(sides[held])

        self._under(f"if {test}:", write, True)
        self._under("else:", write, False)

    def _try(self, place, write):
        self._line(self._runner._tried(place, lambda: self._runner._later(self._frame, write)))

    def _loop(self, head, body, test=None):
        def write():
            self._line(f"if not {self.value(test)}: break" if test else None)
            self.block(body)

        self._loops += 1
        self._under(head, write)
        self._loops -= 1

    # expressions

    def value(self, x):
        """Write the lines that compute a number, and return its name or its literal."""
        if x.op == "const":
            value = _TYPES[x.kind](x.value)
            return repr(
                self._runner._constant(value, self._frame[0]) if x.kind == "real" else value
            )
        if x.op == "name":
            return f"v_{x.args[0]}"
        name, operands = self._computed(x)
        if x.kind == "real":
            self._line(self._runner._stored(name, *self._frame, id(x)))
        self._see(name, x.kind, id(x), operands=operands)
        return name

    def _computed(self, x):
        """Return the name of a new number; operands too, where one makes it infinite."""
        op, args = x.op, x.args
        match op:
            case "load":
                return self._new(self._element(*args)), ()
            case "call":
                return self._new(f"{self._called(called(x), args[1:], self._frame[0])}[0]"), ()
            case "and" | "or" | "choice":
                return self._branches(x), ()
        names = [self.value(arg) for arg in args]
        if op == "cast":
            return self._new(f"{_TYPES[x.kind].__name__}({names[0]})"), ()
        self._counts[-1][0] += 1
        reals = [name for name, arg in zip(names, args, strict=True) if arg.kind == "real"]
        if op in COMPARISONS and reals:
            names = self._runner._compared(names, args, self._frame)
        is_sum = op in ("+", "-", "*")
        for name in () if is_sum else reals:
            self._line(self._runner._checked(op, name, self._frame[1]))
        text = _FORMS[op].format(*names) if op in _FORMS else f"{op}({', '.join(names)})"
        return self._new(text), reals if is_sum else ()

    def _branches(self, x):
        test, *sides = x.args
        first = self.value(test)
        name = self._new(first)

        def write(k, other):
            if other:
                self._try((self._frame, id(x), other), lambda text: text.value(sides[other - 1]))
            if k:
                self._line(self._runner._entered((self._frame, id(x), k)))
                self._line(f"{name} = {self.value(sides[k - 1])}")

        cases = {"choice": ((1, 2), (2, 1)), "and": ((1, 0), (0, 1)), "or": ((0, 1), (1, 0))}
        for head, case in zip((f"if {first}:", "else:"), cases[x.op], strict=True):
            self._under(head, write, *case)
        return name

    def _called(self, part, args, step):
        texts = []
        for arg in part.args(args):
            texts += self._view(arg) if isinstance(arg, Array) else [self.value(arg)]
        return f"{self._runner._function(step, part)}({', '.join(texts)})"

    def _view(self, array):
        """Return an array as a list and the place where it begins."""
        offset = self.value(array.offset)
        if array.values is not None:
            return self._runner._table(array), offset
        return f"a_{array.name}", f"o_{array.name} + {offset}"

    def _element(self, array, place):
        place = self.value(place)
        if array.values is not None:
            return f"{self._runner._table(array)}[{place}]"
        return f"a_{array.name}[o_{array.name} + {place}]"


def _leaves(body):
    return bool(body) and isinstance(body[-1], (Return, Jump))
