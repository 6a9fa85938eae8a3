"""Runs what has been read, to see how large its numbers become.

A branch that no sample leads to is tried, on a copy of what there is, wherever it is passed by: its
numbers are taken for as large as they would be there. Such a trial may fail, and then the branch
has no sizes.
"""

import math
import operator
from functools import cache

import numpy as np

from ._slice import called
from ._tree import COMPARISONS, Array, Assign, Call, For, If, Jump, Listed, Return, Store, While

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
# what is done with an infinite number, but for arithmetic
_OF_INFINITY = {*COMPARISONS, "min", "max", "abs", "neg", "math.fabs", "math.copysign"}
_LONGEST_TRIAL = 1000  # turns of a loop, which may have no end where it would not begin
_FAILED = (ArithmeticError, ValueError, IndexError, KeyError)
_CASTS = {"bool": bool, "int": int, "real": float}


class Ranges:
    """The largest size of each number, over a drive.

    Numbers are told apart by the step of the model that they belong to, ``step``, the place of its
    call in the body of the whole model; None for the model itself.

    Parameters
    ----------
    model : Slice
        See :func:`~skhyst.export._model.model_step`.
    state : ndarray of shape (n_states,)
    drive : ndarray of shape (n_samples, n_inputs)
    """

    def __init__(self, model, state, drive):
        self._seen, self._tried, self._infinite, self._led = {}, {}, set(), set()
        self._sizes = self._seen
        state = np.array(state, dtype=float)
        row = isinstance(model.function.params[0], Array)
        with np.errstate(all="ignore"):
            for u in drive:
                self._note((None, "u"), *u)
                self._call(model, model.args([u if row else float(u[0]), state]), None)

    def of(self, step, *key):
        """Return the largest size, None where no sample and no trial led there."""
        return self._seen.get((step, *key), self._tried.get((step, *key)))

    def may_be_infinite(self, step, *key):
        """Say whether a number was seen that is."""
        return (step, *key) in self._infinite

    def _note(self, key, *values):
        if any(map(math.isinf, values)):
            self._infinite.add(key)
        sizes = [abs(float(v)) for v in values if math.isfinite(v)]
        self._sizes[key] = max([self._sizes.get(key, 0.0), *sizes])

    def _try(self, work, env, place):
        """Do some work on a copy, unless a sample has led to that place."""
        if place in self._led:
            return
        before, self._sizes = self._sizes, self._tried
        try:
            work({k: x.copy() if isinstance(x, np.ndarray) else x for k, x in env.items()})
        except _FAILED:
            pass
        finally:
            self._sizes = before

    def _lead(self, place):
        if self._sizes is self._seen:
            self._led.add(place)

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
        """Run statements; return what they return, or the word of a jump."""
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
            if self._sizes is self._tried and k == _LONGEST_TRIAL:
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
            return x.value
        if x.op == "name":
            return env[x.args[0]]
        value = self._result(x, env, frame)
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
        real = self._sizes is self._seen
        if real and op not in _OF_INFINITY and any(map(math.isinf, values)):
            raise ValueError(
                f"'{frame[1].function.name}' computes with an infinite number, which has no form "
                "in integers."
            )
        if op.startswith("math."):
            return getattr(math, op[5:])(*values)
        return _OPERATORS[op](*values)

    def _either(self, x, which, env, frame, tried=False):
        """Return an operand that counts, or try one that does not."""
        place = (frame, id(x), which)
        if tried:
            return self._try(lambda copy: self._value(x.args[which], copy, frame), env, place)
        self._lead(place)
        return self._value(x.args[which], env, frame)


@cache
def _table(values):
    return np.array(values)
