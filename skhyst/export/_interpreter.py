"""Run a step in the intermediate representation, number by number.

Functions, statements and expressions become closures once, which then run for each sample. A
statement returns a tuple of results, "break", "continue" or None, and an expression its value, of
the variables ``env`` of the function.
"""

import math
import operator
from functools import cache

import numpy as np

from ._expressions import Array, Assign, Call, For, If, Jump, Listed, Return, Store, While
from ._slice import called


def _divided(a, b):
    return a / b if b else float(np.divide(a, b))


def _power(a, b):
    try:
        return math.pow(a, b)
    except (ValueError, OverflowError):  # infinite, or not a number
        return float(np.power(float(a), float(b)))


_OPERATORS = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": _divided,
    "//": operator.floordiv,
    "%": operator.mod,
    "**": _power,
    "powi": _power,
    "neg": operator.neg,
    "not": operator.not_,
    "abs": abs,
    "min": min,
    "max": max,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}
_CASTS = {"bool": bool, "int": int, "real": float}


class Interpreter:
    """Runs the step of a whole model, sample by sample.

    Numbers belong to a frame: the index of the step's call in the body of the model, None for the
    model itself, and the function.

    Parameters
    ----------
    model : Slice
        See :func:`~skhyst.export._model.model_step`.
    state : ndarray of shape (n_states,)
    tuned : ndarray of shape (n_constants,), optional
        Constants that can be changed at run time.
    """

    _longest = None  # largest number of iterations of a loop

    def __init__(self, model, state, tuned=()):
        self._model, self._state = model, np.array(state, dtype=float)
        self._tuned = np.array(tuned, dtype=float)
        self._row = isinstance(model.function.params[0], Array)
        self._functions = {}

    def answer(self, u):
        """Return the response to the next sample of a drive, (n_inputs,)."""
        seen = self._noted(None, "u")
        for value in u if seen else ():
            seen(value)
        given = [u if self._row else float(u[0]), self._state, self._tuned]
        given = given[: len(self._model.function.params)]
        with np.errstate(all="ignore"):
            return self._function(None, self._model)(self._model.args(given))[0]

    # hooks for subclasses; the functions that they return are called for each number

    def _noted(self, step, *key):
        """Return a function that sees a variable, an expression or a result, or None."""

    def _stored(self, step, *key):
        """Return a function that rounds real numbers as they are stored, or None.

        Constants have no key.
        """

    def _checked(self, op, frame):
        """Return a function that sees the operands of an operation, or None."""

    def _try(self, work, env, place):
        """Called for a branch that is not taken; ``work(copy of env)`` would run it."""

    def _enter_branch(self, place):
        """Called for a branch that is taken."""

    # functions and statements

    def _function(self, step, part):
        """Return a function of those arguments that are used."""
        if (step, part) not in self._functions:
            self._functions[step, part] = self._new_function(step, part)
        return self._functions[step, part]

    def _new_function(self, step, part):
        params, frame = part.args(part.function.params), (step, part)
        names = [p.name if isinstance(p, Array) else p.args[0] for p in params]
        numbers = [k for k, p in enumerate(params) if not isinstance(p, Array)]
        given = _all_of((k, self._noted(*frame, names[k])) for k in numbers)
        found = _all_of((k, self._noted(*frame, k)) for k in range(sum(part.mask)))
        body = self._block(part.body, frame)

        def run(args):
            for k, note in given:
                note(args[k])
            results = body(dict(zip(names, args, strict=True))) or ()
            for k, note in found:
                note(results[k])
            return results

        return run

    def _block(self, body, frame):
        works = [self._statement(x, frame, k, body[k + 1 :]) for k, x in enumerate(body)]

        def run(env):
            for work in works:
                end = work(env)
                if end is not None:
                    return end
            return None

        return works[0] if len(works) == 1 else run

    def _statement(self, statement, frame, k, rest):
        match statement:
            case Assign(target, value):
                return _assignment(target, self._value(value, frame), self._noted(*frame, target))
            case Store(array, place, value):
                memory, place = _memory(array), self._value(place, frame)
                return _store(memory, place, self._value(value, frame))
            case Listed(array, values):
                values = [self._value(x, frame) for x in values]
                return _listing(array.name, values, self._noted(*frame, array.name))
            case Call():
                return self._call(statement, frame, k)
            case Jump(word):
                return lambda env: word
            case If():
                return self._if(statement, frame, rest)
            case For(name, start, stop, step, body):
                bounds = self._value(start, frame), self._value(stop, frame)
                return self._loop(_for(name, *bounds, step), body, frame)
            case While(test, body):
                return self._loop(_while(self._value(test, frame)), body, frame)
        return _tuple([self._value(x, frame) for x in statement.values])

    def _call(self, call, frame, k):
        outs = [out for out in call.outs if out is not None]
        part, is_step = called(call, outs), frame[0] is None
        inner = k if is_step else frame[0]
        args = _tuple([self._value(arg, frame) for arg in part.args(call.args)])
        function, notes = self._function(inner, part), [self._noted(*frame, out) for out in outs]
        note = self._noted(inner, "s") if is_step else None
        own = self._value(call.args[-1], frame) if note else None  # the state of a whole step
        size = call.args[-1].shape[0] if note else 0

        def note_state(env):
            if note and "s" in env:
                numbers = own(env)[:size].tolist()
                ends = min(numbers, default=0.0), max(numbers, default=0.0)
                for x in ends if math.isfinite(ends[1] - ends[0]) else numbers:
                    note(x)

        def run(env):
            note_state(env)
            results = function(args(env))
            note_state(env)
            for out, seen, x in zip(outs, notes, results, strict=True):
                env[out] = seen(x) if seen else x

        return run

    def _if(self, statement, frame, rest):
        test = self._value(statement.test, frame)
        sides = statement.orelse, statement.body
        works = [self._block(side, frame) for side in sides]
        places = [(frame, id(statement), held) for held in (False, True)]
        # the other branch: with the later statements, if it leaves the block
        instead = [
            self._later((*sides[held], *rest) if _leaves(sides[not held]) else sides[held], frame)
            for held in (False, True)
        ]

        def run(env):
            held = bool(test(env))
            self._enter_branch(places[held])
            self._try(instead[not held], env, places[not held])
            return works[held](env)

        return run

    def _later(self, body, frame):
        """Return a block that is turned into closures when it is first run."""
        work = cache(lambda: self._block(body, frame))
        return lambda env: work()(env)

    def _loop(self, turns, body, frame):
        work = self._block(body, frame)

        def run(env):
            longest = self._longest
            for k, _ in enumerate(turns(env)):
                if k == longest:
                    break
                end = work(env)
                if end == "break":
                    break
                if isinstance(end, tuple):
                    return end
            return None

        return run

    # expressions

    def _value(self, x, frame):
        if isinstance(x, Array):
            return _view(_memory(x), self._value(x.offset, frame))
        if x.op == "const":
            stored = self._stored(frame[0]) if x.kind == "real" else None
            value = stored(x.value) if stored else x.value
            return lambda env: value
        if x.op == "name":
            return operator.itemgetter(x.args[0])
        stored = self._stored(*frame, id(x)) if x.kind == "real" else None
        return _then(self._result(x, frame), stored, self._noted(*frame, id(x)))

    def _result(self, x, frame):
        op, args = x.op, x.args
        match op:
            case "load":
                return _load(_memory(args[0]), self._value(args[1], frame), _CASTS[x.kind])
            case "call":
                part = called(x)
                values = _tuple([self._value(arg, frame) for arg in part.args(args[1:])])
                function = self._function(frame[0], part)
                return lambda env: function(values(env))[0]
            case "and" | "or" | "choice":
                return self._branches(x, frame)
        values = [self._value(arg, frame) for arg in args]
        if op == "cast":
            return _then(*values, _CASTS[x.kind])
        work = getattr(math, op[5:]) if op.startswith("math.") else _OPERATORS[op]
        return _operation(work, values, self._checked(op, frame))

    def _branches(self, x, frame):
        first, *sides = (self._value(arg, frame) for arg in x.args)
        places = [(frame, id(x), k) for k in range(1, len(x.args))]

        def choice(env):
            k = 0 if first(env) else 1
            self._try(sides[1 - k], env, places[1 - k])
            self._enter_branch(places[k])
            return sides[k](env)

        def logical(env):
            value = first(env)
            if value == (x.op == "or"):
                self._try(sides[0], env, places[0])
                return value
            self._enter_branch(places[0])
            return sides[0](env)

        return choice if x.op == "choice" else logical


def _all_of(notes):
    return [(k, note) for k, note in notes if note]


def _leaves(body):
    return bool(body) and isinstance(body[-1], (Return, Jump))


def _assignment(target, value, note):
    value = _then(value, note)

    def run(env):
        env[target] = value(env)

    return run


def _store(memory, place, value):
    def run(env):
        x = value(env)
        memory(env)[place(env)] = x

    return run


def _listing(name, values, note):
    values = [_then(value, note) for value in values]

    def run(env):
        env[name] = np.array([value(env) for value in values])

    return run


def _for(name, start, stop, step):
    def turns(env):
        for env[name] in range(start(env), stop(env), step):  # noqa: B020
            yield

    return turns


def _while(test):
    def turns(env):
        while test(env):
            yield

    return turns


def _tuple(values):
    return lambda env: tuple([value(env) for value in values])


def _then(value, *functions):
    """Return a function applied to the result of another; None is skipped."""
    for function in functions:
        if function:
            value = _composed(function, value)
    return value


def _composed(function, value):
    return lambda env: function(value(env))


def _memory(array):
    if array.values is None:
        return operator.itemgetter(array.name)
    table = np.array(array.values)
    return lambda env: table


def _view(memory, offset):
    return lambda env: memory(env)[offset(env) :]


def _load(memory, place, cast):
    return lambda env: cast(memory(env)[place(env)])


def _operation(work, values, check):
    if len(values) == 1:
        return _then(*values, check, work)
    first, second = values

    def checked(env):
        a, b = first(env), second(env)
        check(a, b)
        return work(a, b)

    return checked if check else lambda env: work(first(env), second(env))
