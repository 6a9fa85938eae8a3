"""Run a step in the intermediate representation, number by number."""

import math
import operator
from functools import cache

import numpy as np

from ._expressions import Array, Assign, Call, For, If, Jump, Listed, Return, Store, While
from ._slice import called

_OPERATORS = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": np.divide,
    "//": operator.floordiv,
    "%": operator.mod,
    "**": np.power,
    "powi": np.power,
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

    def answer(self, u):
        """Return the response to the next sample of a drive, (n_inputs,)."""
        self._note((None, "u"), *u)
        given = [u if self._row else float(u[0]), self._state, self._tuned]
        given = given[: len(self._model.function.params)]
        with np.errstate(all="ignore"):
            return self._call(self._model, self._model.args(given), None)[0]

    # hooks for subclasses

    def _note(self, key, *values):
        """Called with the values of a variable, an expression or a result."""

    def _try(self, work, env, place):
        """Called for a branch that is not taken; ``work(copy of env)`` would run it."""

    def _lead(self, place):
        """Called for a branch that is taken."""

    def _computed(self, op, values, frame):
        """Called for an operation with its operands."""

    def _number(self, value, step, *key):
        """Return a real number as it is stored, for instance rounded; constants have no key."""
        return value

    # the run

    def _call(self, part, args, step):
        params = part.args(part.function.params)
        names = [p.name if isinstance(p, Array) else p.args[0] for p in params]
        env = dict(zip(names, args, strict=True))
        for name, value in env.items():
            if not isinstance(value, np.ndarray):
                self._note((step, part, name), value)
        results = self._block(part.body, env, (step, part)) or ()
        for k, value in enumerate(results):
            self._note((step, part, k), value)
        return results

    def _block(self, body, env, frame):
        """Run statements; return a tuple of results, "break", "continue" or None."""
        for k, statement in enumerate(body):
            end = self._run(statement, env, frame, k, body[k + 1 :])
            if end is not None:
                return end
        return None

    def _run(self, statement, env, frame, k, rest):
        match statement:
            case Assign(target, value):
                self._set(target, self._value(value, env, frame), env, frame)
            case Store(array, place, value):
                x = self._value(value, env, frame)
                self._array(array, env, frame, False)[self._value(place, env, frame)] = x
            case Listed(array, values):
                env[array.name] = np.array([self._value(x, env, frame) for x in values])
                self._note((*frame, array.name), *env[array.name])
            case Call(_, args, outs):
                outs = [out for out in outs if out is not None]
                step, part = frame[0], called(statement, outs)
                inner = k if step is None else step
                own = args[-1] if step is None else None  # the state of a whole step
                own = (
                    []
                    if own is None or "s" not in env
                    else self._array(own, env, frame)[: own.shape[0]]
                )
                self._note((inner, "s"), *own)
                results = self._call(part, self._args(part, args, env, frame), inner)
                self._note((inner, "s"), *own)
                for out, x in zip(outs, results, strict=True):
                    self._set(out, x, env, frame)
            case Jump(word):
                return word
            case If(test, body, orelse):
                held = bool(self._value(test, env, frame))
                chosen, other = (body, orelse) if held else (orelse, body)
                self._lead((frame, id(statement), held))
                if chosen and isinstance(chosen[-1], (Return, Jump)):
                    other = (*other, *rest)
                place = (frame, id(statement), not held)
                self._try(lambda copy: self._block(other, copy, frame), env, place)
                return self._block(chosen, env, frame)
            case For(name, start, stop, step, body):
                bounds = (self._value(x, env, frame) for x in (start, stop))
                return self._loop(({name: i} for i in range(*bounds, step)), body, env, frame)
            case While(test, body):
                turns = iter(lambda: {} if self._value(test, env, frame) else None, None)
                return self._loop(turns, body, env, frame)
            case _:
                return tuple(self._value(x, env, frame) for x in statement.values)
        return None

    def _loop(self, turns, body, env, frame):
        for k, turn in enumerate(turns):
            if k == self._longest:
                break
            env.update(turn)
            end = self._block(body, env, frame)
            if end == "break":
                break
            if isinstance(end, tuple):
                return end
        return None

    def _set(self, name, value, env, frame):
        env[name] = value
        self._note((*frame, name), value)

    def _args(self, part, args, env, frame):
        return [self._value(arg, env, frame) for arg in part.args(args)]

    def _array(self, array, env, frame, shift=True):
        values = _table(array.values) if array.values is not None else env[array.name]
        return values[self._value(array.offset, env, frame) :] if shift else values

    def _value(self, x, env, frame):
        if isinstance(x, Array):
            return self._array(x, env, frame)
        if x.op == "const":
            return self._number(x.value, frame[0]) if x.kind == "real" else x.value
        if x.op == "name":
            return env[x.args[0]]
        value = self._result(x, env, frame)
        value = self._number(value, *frame, id(x)) if x.kind == "real" else value
        self._note((*frame, id(x)), value)
        return value

    def _result(self, x, env, frame):
        op, args = x.op, x.args
        match op:
            case "load":
                value = self._array(args[0], env, frame, False)[self._value(args[1], env, frame)]
                return _CASTS[x.kind](value)
            case "call":
                part = called(x)
                return self._call(part, self._args(part, args[1:], env, frame), frame[0])[0]
            case "and" | "or":
                first = self._value(args[0], env, frame)
                done = first == (op == "or")
                second = self._either(x, 1, env, frame, tried=done)
                return first if done else second
            case "choice":
                held = bool(self._value(args[0], env, frame))
                self._either(x, 1 + held, env, frame, tried=True)
                return self._either(x, 2 - held, env, frame)
            case "cast":
                return _CASTS[x.kind](self._value(args[0], env, frame))
        values = [self._value(arg, env, frame) for arg in args]
        self._computed(op, values, frame)
        if op.startswith("math."):
            return getattr(math, op[5:])(*values)
        return _OPERATORS[op](*values)

    def _either(self, x, which, env, frame, tried=False):
        """Return the value of an operand, or with ``tried`` only try one that is not evaluated."""
        place = (frame, id(x), which)
        if tried:
            return self._try(lambda copy: self._value(x.args[which], copy, frame), env, place)
        self._lead(place)
        return self._value(x.args[which], env, frame)


@cache
def _table(values):
    return np.array(values)
