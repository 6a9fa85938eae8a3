"""Leave out the branches of a step that its input cannot reach, by interval arithmetic.

This is abstract interpretation (Cousot and Cousot, *Symposium on Principles of Programming
Languages*, 1977): a step is run on intervals instead of numbers, from the first state, for any
input within its limits, until the intervals of the state no longer grow. A side of a condition that
has not been entered then is never entered.

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

_ROUNDING = 2.0**-40  # bound of a rounding error, relative to the largest operand
_LONGEST = 8  # iterations of a loop up to which they are run one by one
_LONGEST_COPY = 1000  # the same where it only copies
_PATIENCE = 3  # rounds before ends that still move are widened, and rounds after that
_MOST = 300_000  # operations of an analysis at most, about a second
_WHOLE = 2**31  # integers saturate here
_ANY, _EITHER = (-math.inf, math.inf), (0, 1)
_OPPOSITE = {"<": ">=", "<=": ">", ">": "<=", ">=": "<", "==": "!=", "!=": "=="}
_MIRRORED = {"<": ">", "<=": ">=", ">": "<", ">=": "<=", "==": "==", "!=": "!="}
_RISING = ("math.exp", "math.expm1", "math.log", "math.log1p", "math.sqrt", "math.tanh")
_ARRAYS = "[]"  # key, among the variables, of the numbers of each array


class _TooMany(Exception):
    """The analysis needs more than ``_MOST`` operations."""


def reachable(model, state, ends):
    """Return the step of a model without the branches that no input reaches.

    Parameters
    ----------
    model : Slice
        See :func:`~skhyst.export._composed_step.model_step`.
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
        env = {
            "s": ("s", (0, 0), len(state)),
            "u": ("u", (0, 0), len(inputs)) if row else inputs[0],
        }
        _, arrays = run.results(model, None, env | {_ARRAYS: {"s": list(state), "u": inputs}})
        return list(map(_joined, first, arrays["s"]))

    try:
        state = first
        for k in count():
            new = list(map(_joined, state, after(state)))
            if new == state:
                break
            state = list(map(_widened, state, new)) if k >= _PATIENCE else new
        # narrowing: some ends have been widened too far, and steps from a fixed point stay within
        for _ in range(_PATIENCE):
            state = after(state)
        after(state)  # the branches of this last step are those that are kept
    except _TooMany:
        return model
    return sliced(_Pruning(run.places).function(model, None, True))


class _Pruning:
    """Rewrites functions without the branches that are not among ``places``."""

    def __init__(self, places):
        self._places, self._made = places, {}

    def function(self, part, step, is_whole=False):
        """Return a function with only those results and arguments that are used."""
        if (step, part) not in self._made:
            function = part.function
            results = [
                x for x, kept in zip(leaves(function.result), part.mask, strict=True) if kept
            ]
            self._made[step, part] = Function(
                function.name,
                function.params if is_whole else tuple(part.args(function.params)),
                self._block(part.body, (step, part)),
                results[0] if len(results) == 1 else tuple(results),
                function.kinds,
                function.writes,
            )
        return self._made[step, part]

    def _block(self, body, frame):
        made = []
        for k, statement in enumerate(body):
            made += self._statement(statement, frame, k)
            if made and isinstance(made[-1], (Return, Jump)):  # nothing behind it is reached
                break
        return tuple(made)

    def _statement(self, statement, frame, k):
        match statement:
            case If(test, body, orelse):
                reached = [x for x in (False, True) if (frame, id(statement), x) in self._places]
                if len(reached) < 2:  # the condition itself is left out, too
                    return self._block((orelse, body)[reached[0]], frame) if reached else ()
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

    Variables are intervals. Arrays are views: the key of a list of numbers, the interval of the
    position in it where the array begins, and the position after its last number.

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
        env_at_end = self._block(part.body, env, (step, part), ends)
        ends += [] if env_at_end is None else [((), env_at_end)]
        arrays = {}
        for _, end in ends:
            arrays = _both(arrays, end[_ARRAYS])
        results = zip(*(values for values, _ in ends), strict=True)
        return [_joined(*values) for values in results], arrays

    # statements: they change the variables and return them, or None if what follows is not reached

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
            refined = self._refined(test, held, self._copied(env), frame)
            after = _merged(after, self._block(sides[held], refined, frame, ends))
        return after

    def _loop(self, loop, env, frame, ends):
        iterations, after = None, None
        if isinstance(loop, For):
            start, stop = (self._value(x, env, frame) for x in (loop.start, loop.stop))
            if start[0] == start[1] and stop[0] == stop[1]:
                iterations = range(int(start[0]), int(stop[0]), loop.step)
                # one by one, intervals stay narrow; long loops would take too many operations
                longest = _LONGEST_COPY if _only_stores(loop.body) else _LONGEST
                iterations = iterations if len(iterations) <= longest else None
        for k in iterations if iterations is not None else count():
            begin = self._copied(env)
            if iterations is not None:
                begin[loop.target] = k, k
            elif isinstance(loop, For):
                begin[loop.target] = (start[0], stop[1]) if loop.step > 0 else (stop[0], start[1])
            else:
                outcomes = _known(self._value(loop.test, begin, frame))
                if 0 in outcomes:
                    after = _merged(after, self._refined(loop.test, 0, self._copied(begin), frame))
                if 1 not in outcomes:
                    return after
                begin = self._refined(loop.test, 1, begin, frame)
            inner = []
            new = self._block(loop.body, begin, frame, inner)
            for jump, env_at_jump in inner:
                if jump == "continue":
                    new = _merged(new, env_at_jump)
                elif jump == "break":
                    after = _merged(after, env_at_jump)
                else:
                    ends.append((jump, env_at_jump))
            if new is None:
                env = None if iterations is not None or isinstance(loop, While) else env
                break
            if iterations is not None:
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
        if op == "<" and args[1].value == math.inf and _is_computed(args[0]):
            return 1, 1  # arithmetic saturates below infinity
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
            refined = self._refined(test, held, {**env, _ARRAYS: {**env[_ARRAYS]}}, frame)
            results.append(self._value(sides[k - 1], refined, frame))
        return _joined(*results)

    def _call(self, part, args, env, frame, step):
        """Return the results of a function that is called, and the arrays after it."""
        callee_env = {_ARRAYS: env[_ARRAYS]}
        for arg, param in zip(part.args(args), part.args(part.function.params), strict=True):
            if isinstance(arg, Array):
                offset = self._value(arg.offset, env, frame)
                key, begin, end = self._view(arg, env)
                begin = begin[0] + offset[0], begin[1] + offset[1]
                callee_env[param.name] = key, begin, min(end, begin[1] + math.prod(param.shape))
            else:
                callee_env[param.args[0]] = self._value(arg, env, frame)
        return self.results(part, step, callee_env)

    def _view(self, array, env):
        """Return the key of the numbers of an array, and the positions of its begin and its end."""
        if array.values is None:
            return env[array.name]
        self._tables.setdefault(id(array.values), [_wider((x, x)) for x in array.values])
        return id(array.values), (0, 0), len(array.values)

    def _numbers(self, array, place, env, frame):
        """Return the numbers of an array, and the first and last position that ``place`` may be."""
        key, begin, end = self._view(array, env)
        place = self._value(place, env, frame)
        numbers = self._tables.get(key) or env[_ARRAYS][key]
        # intervals may exceed an array, but a law never reads outside of it
        first = int(min(begin[0] + max(place[0], 0), end - 1))
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

    def _meet(self, x, op, interval, other, is_exact, env, frame):
        """Cut the interval of a variable or an element down to where a comparison holds."""
        low, high = other if is_exact and other == (0, 0) else _wider(other, interval)
        low = low if op in (">", ">=", "==") else -math.inf
        high = high if op in ("<", "<=", "==") else math.inf
        met = max(interval[0], low), min(interval[1], high)
        if met[0] > met[1] or met == interval:
            return
        if x.op == "name":
            env[x.args[0]] = met
        elif x.op == "load" and x.args[0].values is None:
            numbers, first, last = self._numbers(*x.args, env, frame)
            key, *_ = env[x.args[0].name]
            # an element is known only if its position is
            if first == last and key in env[_ARRAYS]:
                env[_ARRAYS][key] = numbers = [*numbers]
                numbers[first] = met


def _is_computed(x):
    """Whether a number is the result of arithmetic."""
    return x.op in ("+", "-", "*", "/") or (x.op == "abs" and _is_computed(x.args[0]))


def _only_stores(body):
    return all(isinstance(statement, Store) for statement in body)


def _known(test):
    """Return the results, 0 or 1, that a condition may have."""
    return [held for held in (0, 1) if test[0] <= held <= test[1]]


def _joined(*intervals):
    """Return the smallest interval that holds all intervals."""
    return min(low for low, _ in intervals), max(high for _, high in intervals)


def _widened(old, new):
    """Return an interval that holds both; ends that move go to zero, or else to infinity.

    So an end moves twice at most, and a loop of widened intervals ends.
    """
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
    """Return the arrays after one of two paths."""
    merged = {**others, **arrays}
    for key in arrays.keys() & others.keys():
        if arrays[key] != others[key]:
            merged[key] = list(map(join, arrays[key], others[key]))
    return merged


def _store(numbers, first, last, value):
    """Store a value at a position between two: where it is not known, the old values may stay."""
    if first == last:
        numbers[first] = value
    else:
        numbers[first : last + 1] = [_joined(x, value) for x in numbers[first : last + 1]]


# arithmetic


def _size(*intervals):
    """Return the largest finite end."""
    return max((abs(x) for pair in intervals for x in pair if abs(x) < math.inf), default=0.0)


def _wider(interval, *operands):
    """Return an interval wider by the rounding error, which changes neither signs nor zeros."""
    low, high = interval
    error = _ROUNDING * _size(interval, *operands)
    if low:
        low = max(low - error, 0.0) if low > 0 else low - error
    if high:
        high = min(high + error, 0.0) if high < 0 else high + error
    return low, high


def _compared(op, a, b, are_same):
    """Return the interval of the results, 0 or 1, that a comparison may have."""
    if are_same:
        return (1, 1) if op in ("<=", ">=", "==") else (0, 0)
    if op == "<":
        # numbers that are not far apart may become equal, but do not change their order
        return int(a[1] + _ROUNDING * _size(a, b) < b[0]), int(a[0] < b[1])
    if op == ">":
        return _compared("<", b, a, False)
    if op == "==":
        differ = any(_compared("<", *pair, False)[0] for pair in ((a, b), (b, a)))
        return 0, int(not differ)
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
        case "math.floor" | "math.ceil" | "math.trunc":  # rounding may reach the next integer
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
            # an even power is least at zero
            pair = 0.0 if n % 2 == 0 and a[0] < 0 < a[1] else min(ends), max(ends)
        case "**" | "math.pow" if a[0] >= 0:
            # monotone in either operand: the extremes are at the corners
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
    """Return a quotient; by zero it is the largest number, with the sign of the dividend."""
    if b[0] < 0 <= b[1] or (b[0] == 0 and a[0] < 0 <= a[1]):
        return _ANY
    return _product(a, tuple(1.0 / x if x else math.inf for x in b[::-1]))


def _power(x, y):
    return math.inf if x == 0 and y < 0 else _called(math.pow, (x,), y)[0]


def _called(function, xs, *more):
    """Return a function of each of several numbers, infinite where it is not defined."""
    values = []
    for x in xs:
        try:
            values.append(function(x, *more))
        except OverflowError:
            values.append(math.inf if x > 0 else -math.inf)
        except ValueError:
            values.append(-math.inf)
    return tuple(values)
