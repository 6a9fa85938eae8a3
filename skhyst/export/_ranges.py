"""Runs what has been read, to see how large its numbers become."""

import math
import operator
from functools import cache

import numpy as np

from ._slice import called
from ._tree import Array, Assign, Call, For, If, Jump, Listed, Store, While

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
        self._largest = {}
        state = np.array(state, dtype=float)
        row = isinstance(model.function.params[0], Array)
        with np.errstate(all="ignore"):
            for u in drive:
                self._note((None, "u"), *u)
                self._call(model, model.args([u if row else float(u[0]), state]), None)

    def of(self, step, *key):
        """Return the largest size, None where no sample led there."""
        return self._largest.get((step, *key))

    def _note(self, key, *values):
        sizes = [abs(float(v)) for v in values if math.isfinite(v)]
        self._largest[key] = max([self._largest.get(key, 0.0), *sizes])

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
            end = self._run(statement, env, frame, k)
            if end is not None:
                return end
        return None

    def _run(self, statement, env, frame, k):
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
                chosen = body if self._value(test, env, frame) else orelse
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
        for turn in turns:
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
                return first if first == (op == "or") else self._value(args[1], env, frame)
            case "choice":
                return self._value(args[2 - bool(self._value(args[0], env, frame))], env, frame)
            case "cast":
                return _CASTS[x.kind](self._value(args[0], env, frame))
        values = [self._value(arg, env, frame) for arg in args]
        if op.startswith("math."):
            return getattr(math, op[5:])(*values)
        return _OPERATORS[op](*values)


@cache
def _table(values):
    return np.array(values)
