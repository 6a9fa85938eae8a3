"""Leave out the branches of a step that its input cannot reach, by interval arithmetic.

A step is run on intervals instead of numbers: from the first state, for any input within its
limits, until the intervals of the state no longer grow (Cousot and Cousot, *Symposium on Principles
of Programming Languages*, 1977). A side of a condition that is not entered then is never entered.

The intervals hold for fixed-point numbers, too. Rounding keeps zero, the sign of a number and the
order of two numbers, and moves a number by at most 2^-49 of the largest operand: results are
widened by more. There is no "not a number".
"""

import math
from dataclasses import replace
from itertools import count

from ._expressions import (
    COMPARISONS,
    Array,
    Assign,
    Call,
    For,
    Function,
    If,
    Jump,
    Listed,
    Return,
    Store,
    While,
    constant,
    leaves,
)
from ._slice import called, sliced

_ROUNDING = 2.0**-40  # of the largest operand
_LONGEST = 8  # iterations of a loop that are run one by one
_PATIENCE = 3  # rounds before ends that still move are widened, and after that
_MOST = 300_000  # operations, about a second
_WHOLE = 2**31  # integers saturate
_ANY, _EITHER = (-math.inf, math.inf), (0, 1)
_OPPOSITE = {"<": ">=", "<=": ">", ">": "<=", ">=": "<", "==": "!=", "!=": "=="}
_MIRRORED = {"<": ">", "<=": ">=", ">": "<", ">=": "<=", "==": "==", "!=": "!="}
_RISING = ("math.exp", "math.expm1", "math.log", "math.log1p", "math.sqrt", "math.tanh")
_ARRAYS = "[]"  # among the variables: the numbers of each array


class _TooMany(Exception):
    """There are more operations than are run."""


def reachable(model, state, ends):
    """Return the step of a model without the branches that no input reaches.

    Parameters
    ----------
    model : Slice
        See :func:`~skhyst.export._model.model_step`.
    state : ndarray of shape (n_states,)
        Before the first sample.
    ends : ndarray of shape (2, n_inputs)
        Limits of the input, in units of the drive.

    Returns
    -------
    Slice
        The model itself if it has more operations than are run.
    """
    param = model.function.params[0]
    inputs = [_wider(pair) for pair in ends.T.tolist()]
    first = [_wider((x, x)) for x in state.tolist()]
    run = _Run()

    def after(state):
        run.places = set()
        row = isinstance(param, Array)
        given = {
            "s": ("s", (0, 0), len(state)),
            "u": ("u", (0, 0), len(inputs)) if row else inputs[0],
        }
        _, arrays = run.results(model, None, given | {_ARRAYS: {"s": list(state), "u": inputs}})
        return list(map(_joined, first, arrays["s"]))

    try:
        state = first
        for k in count():
            new = list(map(_joined, state, after(state)))
            if new == state:
                break
            state = list(map(_widened, state, new)) if k >= _PATIENCE else new
        for _ in range(_PATIENCE):  # some ends have been widened too far
            state = after(state)
        after(state)
    except _TooMany:
        return model
    return sliced(_Pruning(run.places).function(model, None, True))


class _Pruning:
    """Writes functions anew, without the branches that are not among ``places``."""

    def __init__(self, places):
        self._places, self._made = places, {}

    def function(self, part, step, is_whole=False):
        """Return a function with the results that are used, and its arguments that are."""
        if (step, part) not in self._made:
            own = part.function
            used = [x for x, kept in zip(leaves(own.result), part.mask, strict=True) if kept]
            self._made[step, part] = Function(
                own.name,
                own.params if is_whole else tuple(part.args(own.params)),
                self._block(part.body, (step, part)),
                used[0] if len(used) == 1 else tuple(used),
                own.kinds,
                own.writes,
            )
        return self._made[step, part]

    def _block(self, body, frame):
        made = []
        for k, statement in enumerate(body):
            made += self._statement(statement, frame, k)
            if made and isinstance(made[-1], (Return, Jump)):
                break
        return tuple(made)

    def _statement(self, statement, frame, k):
        match statement:
            case If(test, body, orelse):
                held = [x for x in (False, True) if (frame, id(statement), x) in self._places]
                if len(held) < 2:
                    return self._block((orelse, body)[held[0]], frame) if held else ()
                sides = (self._block(side, frame) for side in (body, orelse))
                return (If(self._value(test, frame), *sides),)
            case Call(_, args, outs):
                outs = tuple(out for out in outs if out is not None)
                part, is_step = called(statement, outs), frame[0] is None
                function = self.function(part, k if is_step else frame[0], is_step)
                args = args if is_step else part.args(args)
                return (Call(function, self._values(args, frame), outs),)
            case For(_, start, stop):
                start, stop = self._values((start, stop), frame)
                body = self._block(statement.body, frame)
                return (replace(statement, start=start, stop=stop, body=body),)
            case While(test, body):
                return (While(self._value(test, frame), self._block(body, frame)),)
            case Store(array, place, value):
                return (Store(*self._values((array, place, value), frame)),)
            case Assign():
                return (replace(statement, value=self._value(statement.value, frame)),)
            case Listed() | Return():
                return (replace(statement, values=self._values(statement.values, frame)),)
        return (statement,)

    def _values(self, values, frame):
        return tuple(self._value(x, frame) for x in values)

    def _value(self, x, frame):
        if isinstance(x, Array):
            return replace(x, offset=self._value(x.offset, frame))
        if x.op in ("const", "name"):
            return x
        if x.op == "call":
            part = called(x)
            args = self._values(part.args(x.args[1:]), frame)
            return replace(x, args=(self.function(part, frame[0]), *args))
        if x.op in ("choice", "and", "or"):
            sides = [k for k in range(1, len(x.args)) if (frame, id(x), k) in self._places]
            if x.op == "choice" and len(sides) == 1:
                return self._value(x.args[sides[0]], frame)
            if x.op != "choice" and not sides:
                return constant(x.op == "or")
        return replace(x, args=self._values(x.args, frame))


class _Run:
    """A run of a step on intervals.

    Variables are intervals, arrays the key of their numbers, the interval of their first place
    among these, and the place after their last.

    Attributes
    ----------
    places : set
        Branches that may be taken.
    """

    def __init__(self):
        self.places, self._tables, self._left = set(), {}, _MOST

    def results(self, part, step, env):
        """Return the results of a function, and the arrays after it."""
        ends = []
        left = self._block(part.body, env, (step, part), ends)
        ends += [] if left is None else [((), left)]
        arrays = {}
        for _, end in ends:
            arrays = _both(arrays, end[_ARRAYS])
        results = zip(*(values for values, _ in ends), strict=True)
        return [_joined(*values) for values in results], arrays

    # statements: they change the variables and return them, or None if nothing follows

    def _block(self, body, env, frame, ends):
        for k, statement in enumerate(body):
            env = self._statement(statement, env, frame, ends, k)
            if env is None:
                return None
        return env

    def _statement(self, statement, env, frame, ends, k):
        match statement:
            case Assign(target, value):
                env[target] = self._value(value, env, frame)
            case Store(array, place, value):
                _store(*self._numbers(array, place, env, frame), self._value(value, env, frame))
            case Listed(array, values):
                key = (frame, array.name)
                env[_ARRAYS][key] = [self._value(x, env, frame) for x in values]
                env[array.name] = key, (0, 0), len(values)
            case Call(_, args, outs):
                outs = [out for out in outs if out is not None]
                part, step = called(statement, outs), k if frame[0] is None else frame[0]
                results, env[_ARRAYS] = self._call(part, args, env, frame, step)
                env.update(zip(outs, results, strict=True))
            case Jump(word):
                ends.append((word, env))
                return None
            case Return(values):
                ends.append((tuple(self._value(x, env, frame) for x in values), env))
                return None
            case If(test, body, orelse):
                return self._if(statement, test, (orelse, body), env, frame, ends)
            case For() | While():
                return self._loop(statement, env, frame, ends)
        return env

    def _if(self, statement, test, sides, env, frame, ends):
        after = None
        for held in _known(self._value(test, env, frame)):
            self.places.add((frame, id(statement), bool(held)))
            own = self._refined(test, held, self._copied(env), frame)
            after = _merged(after, self._block(sides[held], own, frame, ends))
        return after

    def _loop(self, loop, env, frame, ends):
        turns, after = None, None
        if isinstance(loop, For):
            start, stop = (self._value(x, env, frame) for x in (loop.start, loop.stop))
            if start[0] == start[1] and stop[0] == stop[1]:
                turns = range(int(start[0]), int(stop[0]), loop.step)
                # one by one, intervals stay narrow; long loops would take too many operations
                turns = turns if len(turns) <= _LONGEST else None
        for k in turns if turns is not None else count():
            begin = self._copied(env)
            if turns is not None:
                begin[loop.target] = k, k
            elif isinstance(loop, For):
                begin[loop.target] = (start[0], stop[1]) if loop.step > 0 else (stop[0], start[1])
            else:
                known = _known(self._value(loop.test, begin, frame))
                if 0 in known:
                    after = _merged(after, self._refined(loop.test, 0, self._copied(begin), frame))
                if 1 not in known:
                    return after
                begin = self._refined(loop.test, 1, begin, frame)
            inner = []
            new = self._block(loop.body, begin, frame, inner)
            for end, at in inner:
                if end == "continue":
                    new = _merged(new, at)
                elif end == "break":
                    after = _merged(after, at)
                else:
                    ends.append((end, at))
            if new is None:
                env = None if turns is not None or isinstance(loop, While) else env
                break
            if turns is not None:
                env = new
                continue
            # to a fixed point; widening makes sure that it is reached
            grown = _merged(self._copied(env), new, _widened if k >= _PATIENCE else _joined)
            if grown == env:
                env = env if isinstance(loop, For) else None
                break
            env = grown
        return after if env is None else _merged(after, env)

    # expressions

    def _value(self, x, env, frame):
        self._left -= 1
        if self._left < 0:
            raise _TooMany
        op, args = x.op, x.args
        match op:
            case "const":
                return _wider((x.value, x.value)) if x.kind == "real" else (x.value, x.value)
            case "name":
                return env.get(*args, _ANY)
            case "load":
                numbers, first, last = self._numbers(*args, env, frame)
                return _joined(*numbers[first : last + 1])
            case "call":
                return self._call(called(x), args[1:], env, frame, frame[0])[0][0]
            case "and" | "or" | "choice":
                return self._branches(x, env, frame)
        values = [self._value(arg, env, frame) for arg in args]
        if op in COMPARISONS:
            return _compared(op, *values, args[0] == args[1])
        return _result(op, x.kind, values)

    def _branches(self, x, env, frame):
        test, *sides = x.args
        first, results = self._value(test, env, frame), []
        for held in _known(first):
            if x.op != "choice" and held == (x.op == "or"):
                results.append((held, held))
                continue
            k = 2 - held if x.op == "choice" else 1
            self.places.add((frame, id(x), k))
            own = self._refined(test, held, {**env, _ARRAYS: {**env[_ARRAYS]}}, frame)
            results.append(self._value(sides[k - 1], own, frame))
        return _joined(*results)

    def _call(self, part, args, env, frame, step):
        """Return the results of a function that is called, and the arrays after it."""
        given = {_ARRAYS: env[_ARRAYS]}
        for arg, param in zip(part.args(args), part.args(part.function.params), strict=True):
            if isinstance(arg, Array):
                offset = self._value(arg.offset, env, frame)
                key, own, end = self._view(arg, env)
                own = own[0] + offset[0], own[1] + offset[1]
                given[param.name] = key, own, min(end, own[1] + math.prod(param.shape))
            else:
                given[param.args[0]] = self._value(arg, env, frame)
        return self.results(part, step, given)

    def _view(self, array, env):
        """Return the key of the numbers of an array, where it begins, and where it ends."""
        if array.values is None:
            return env[array.name]
        self._tables.setdefault(id(array.values), [_wider((x, x)) for x in array.values])
        return id(array.values), (0, 0), len(array.values)

    def _numbers(self, array, place, env, frame):
        """Return a list of numbers, and the first and the last place in it that may be meant."""
        key, begin, end = self._view(array, env)
        place = self._value(place, env, frame)
        numbers = self._tables.get(key) or env[_ARRAYS][key]
        first = int(min(begin[0] + max(place[0], 0), end - 1))  # a law keeps to its arrays
        last = int(max(first, min(begin[1] + place[1], end - 1)))
        self._left -= (last - first) // 16
        return numbers, first, last

    def _copied(self, env):
        arrays = {key: [*numbers] for key, numbers in env[_ARRAYS].items()}
        self._left -= 1 + sum(map(len, arrays.values())) // 16
        return {**env, _ARRAYS: arrays}

    def _refined(self, test, held, env, frame):
        """Return the variables where a condition holds, or not; those of ``env`` are changed."""
        op, args = test.op, test.args
        if op == "not":
            return self._refined(args[0], 1 - held, env, frame)
        if op in ("and", "or"):
            for side in args if held == (op == "and") else ():
                self._refined(side, held, env, frame)
        if op in COMPARISONS:
            values = [self._value(x, env, frame) for x in args]
            op = op if held else _OPPOSITE[op]
            self._meet(args[0], op, *values, args[1].op == "const", env, frame)
            self._meet(args[1], _MIRRORED[op], *values[::-1], args[0].op == "const", env, frame)
        return env

    def _meet(self, x, op, own, other, is_exact, env, frame):
        """Make the interval of a variable or an element smaller by a comparison with another."""
        low, high = other if is_exact and other == (0, 0) else _wider(other, own)
        low = low if op in (">", ">=", "==") else -math.inf
        high = high if op in ("<", "<=", "==") else math.inf
        met = max(own[0], low), min(own[1], high)
        if met[0] > met[1] or met == own:
            return
        if x.op == "name":
            env[x.args[0]] = met
        elif x.op == "load" and x.args[0].values is None:
            numbers, first, last = self._numbers(*x.args, env, frame)
            key, *_ = env[x.args[0].name]
            if first == last and key in env[_ARRAYS]:
                env[_ARRAYS][key] = numbers = [*numbers]
                numbers[first] = met


def _known(test):
    """Return the results that a condition may have."""
    return [held for held in (0, 1) if test[0] <= held <= test[1]]


def _joined(*intervals):
    return min(low for low, _ in intervals), max(high for _, high in intervals)


def _widened(old, new):
    """Return an interval that holds both, whose ends move no more than twice."""
    low, high = _joined(old, new)
    if low < old[0]:
        low = 0 if low >= 0 else -math.inf
    if high > old[1]:
        high = 0 if high <= 0 else math.inf
    return low, high


def _merged(env, other, join=_joined):
    """Return the variables after one of two paths, either of which may be None."""
    if env is None or other is None:
        return other if env is None else env
    merged = {**other, **env}
    for name in env.keys() & other.keys() - {_ARRAYS}:
        if env[name] != other[name]:
            merged[name] = join(env[name], other[name])
    merged[_ARRAYS] = _both(env[_ARRAYS], other[_ARRAYS], join)
    return merged


def _both(arrays, others, join=_joined):
    merged = {**others, **arrays}
    for key in arrays.keys() & others.keys():
        if arrays[key] != others[key]:
            merged[key] = list(map(join, arrays[key], others[key]))
    return merged


def _store(numbers, first, last, value):
    if first == last:
        numbers[first] = value
    else:
        numbers[first : last + 1] = [_joined(x, value) for x in numbers[first : last + 1]]


# arithmetic


def _size(*intervals):
    """Return the largest finite end."""
    return max((abs(x) for pair in intervals for x in pair if abs(x) < math.inf), default=0.0)


def _wider(interval, *operands):
    """Return an interval with what rounding adds: it keeps the sign of a number, and zero."""
    low, high = interval
    more = _ROUNDING * _size(interval, *operands)
    if low:
        low = max(low - more, 0.0) if low > 0 else low - more
    if high:
        high = min(high + more, 0.0) if high < 0 else high + more
    return low, high


def _compared(op, a, b, are_same):
    """Return the results that a comparison may have."""
    if are_same:
        return (1, 1) if op in ("<=", ">=", "==") else (0, 0)
    if op == "<":
        # numbers that are not far apart may become equal, but do not change their order
        return int(a[1] + _ROUNDING * _size(a, b) < b[0]), int(a[0] < b[1])
    if op == ">":
        return _compared("<", b, a, False)
    if op == "==":
        apart = any(_compared("<", *pair, False)[0] for pair in ((a, b), (b, a)))
        return 0, int(not apart)
    low, high = _compared(_OPPOSITE[op], a, b, False)
    return 1 - high, 1 - low


def _result(op, kind, values):
    """Return the result of an operation."""
    a, b = values if len(values) == 2 else (values[0], None)
    match op:
        case "neg":
            return -a[1], -a[0]
        case "not":
            return 1 - a[1], 1 - a[0]
        case "abs" | "math.fabs":
            return 0.0 if a[0] < 0 < a[1] else min(map(abs, a)), max(map(abs, a))
        case "math.copysign":
            high = max(map(abs, a))
            return -high if b[0] < 0 else 0.0, high if b[1] >= 0 else 0.0
        case "math.floor" | "math.ceil" | "math.trunc":
            return _called(getattr(math, op[5:]), (a[0] - _ROUNDING, a[1] + _ROUNDING))
        case "cast":
            low, high = (math.trunc(x) if abs(x) < _WHOLE else x for x in a)
            return _saturated((low, high)) if kind == "int" else a
        case "math.sin" | "math.cos":
            return _wider((-1.0, 1.0))
        case "min" | "max":
            pair = tuple(map(min if op == "min" else max, a, b))
        case "+":
            pair = _sum(a, b)
        case "-":
            pair = _sum(a, (-b[1], -b[0]))
        case "*":
            pair = _product(a, b)
        case "/":
            pair = _quotient(a, b)
        case "powi":
            n = b[0]
            ends = _called(pow, a, n)
            pair = 0.0 if n % 2 == 0 and a[0] < 0 < a[1] else min(ends), max(ends)
        case "**" | "math.pow" if a[0] >= 0:
            corners = [_power(x, y) for x in a for y in b]
            pair = min(corners), max(corners)
        case "//" if b[0] == b[1] > 0:
            pair = a[0] // b[0], a[1] // b[0]
        case "%" if b[0] == b[1] > 0:
            pair = 0, b[0] - 1
        case _ if op in _RISING:
            pair = _called(getattr(math, op[5:]), a)
        case _:
            return _ANY
    return _saturated(pair) if kind == "int" else _wider(pair, *values)


def _saturated(pair):
    return tuple(max(-_WHOLE, min(x, _WHOLE)) for x in pair)


def _sum(a, b):
    low, high = (x + y for x, y in zip(a, b, strict=True))
    if math.isnan(low) or math.isnan(high):
        return _ANY
    # a sum that is zero by chance, not of zeros, is rounded
    least = _ROUNDING * _size(a, b)
    return (low or -least if a[0] else low), (high or least if a[1] else high)


def _product(a, b):
    corners = [x * y if x and y else 0.0 for x in a for y in b]
    return min(corners), max(corners)


def _quotient(a, b):
    """Return a quotient: that by zero is the largest number, with the sign of the dividend."""
    if b[0] < 0 <= b[1] or (b[0] == 0 and a[0] < 0 <= a[1]):
        return _ANY
    return _product(a, tuple(1.0 / x if x else math.inf for x in b[::-1]))


def _power(x, y):
    return math.inf if x == 0 and y < 0 else _called(math.pow, (x,), y)[0]


def _called(function, xs, *more):
    """Return a function of each of several numbers, infinite where it is not defined."""
    found = []
    for x in xs:
        try:
            found.append(function(x, *more))
        except OverflowError:
            found.append(math.inf if x > 0 else -math.inf)
        except ValueError:
            found.append(-math.inf)
    return tuple(found)
