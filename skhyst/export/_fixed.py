"""Print functions in fixed-point arithmetic: integers of 64 bits with a fixed binary point.

Each number has ``f`` binary digits after the point, in short its digits. They are chosen so that
its largest value under a drive leaves ``MARGIN`` bits to spare, and about 50 significant bits
remain. Intermediate products and quotients have 128 bits.
"""

import math
from dataclasses import dataclass, field
from string import Formatter

from ._expressions import COMPARISONS, Array, Call, If, compared, constant
from ._fixed_functions import CONSTANTS, FUNCTIONS
from ._printer import ATOM, CHOICE, SYMBOLS, UNARY, FunctionText, Printer
from ._ranges import exponent
from ._slice import called

_BITS = 62  # of a number without its sign
MARGIN = 12  # bits by which a number may exceed its largest value under the drive
_EXACT = 52  # bits of the mantissa of a double after the first
_INFINITY = 2**62
_LONGEST_SHIFT = 126  # of a product or quotient
# of `a op b`, if a positive b or a negative a is rounded to zero, and if the other one is
_UPPER_ROUNDED, _LOWER_ROUNDED = {"<": "<=", ">=": ">"}, {">": ">=", "<=": "<"}
_OF_ONE_NUMBER = ("cos", "exp", "expm1", "log", "log1p", "sin", "tanh")


@dataclass(frozen=True)
class Fixed:
    """The dialect of fixed-point numbers."""

    type: str = "int64_t"


def digits(largest, bits=_BITS - MARGIN):
    """Return the number of binary digits after the point, for numbers up to a largest value."""
    return bits - exponent(largest)


def is_within(value, f):
    """Whether a constant is in the range of numbers with ``f`` digits."""
    return math.isfinite(value) and (not value or math.frexp(value)[1] + f < _BITS)


def scaled(value, f, is_limit=False):
    """Return the literal of a constant; a limit that is out of range becomes infinite."""
    if is_within(value, f):
        return str(round(math.ldexp(value, f)))
    if math.isnan(value) or not (is_limit or math.isinf(value)):
        raise ValueError(f"The constant {value!r} has no form in integers.")
    return str(_INFINITY if value > 0.0 else -_INFINITY)


@dataclass
class FixedPrinter(Printer):
    """A printer of fixed-point arithmetic.

    Parameters
    ----------
    ranges : Ranges

    Attributes
    ----------
    places : set
        Branches that the program contains, as the interpreter names them.
    """

    ranges: object = None
    places: set = field(default_factory=set)

    def literal(self, array):
        """Return the function that writes the numbers of a constant array."""
        f = table_digits(array)
        return lambda value: scaled(value, f)

    def helper(self, op, kind):
        """Return the name of the function for an operation."""
        if op not in FUNCTIONS:
            return super().helper(op, kind)
        if op not in self.functions:
            words = {word for _, word, _, _ in Formatter().parse(FUNCTIONS[op]) if word} - {"n"}
            calls = {word: self.helper(word, kind) for word in sorted(words - CONSTANTS.keys())}
            self.functions[op] = self.name(op)
            self.texts.append(FUNCTIONS[op].format(n=self.functions[op], **calls, **CONSTANTS))
        return self.functions[op]

    def written(self, part, step=None, arrays=()):
        """Return the text of a function, see :class:`FixedText`."""
        return FixedText(self, part, step, arrays)


def table_digits(array):
    """Return the binary digits of a constant array."""
    return digits(max((abs(x) for x in array.values if math.isfinite(x)), default=0.0), _EXACT)


class FixedText(FunctionText):
    """Prints one function.

    Parameters
    ----------
    printer : FixedPrinter
    part : Slice
    step : int or None
        The step of the model that it belongs to, see :class:`Ranges`.
    arrays : tuple of (int, bool)
        Digits of each array argument, and whether one of its numbers may be infinite.
    """

    def __init__(self, printer, part, step=None, arrays=()):
        super().__init__(printer, part)
        self._step = step
        names = [p.name for p in self._params if isinstance(p, Array)]
        self._arrays = dict(zip(names, arrays, strict=False))

    def _digits(self, *key, part=None, step=None):
        """Return the digits of a variable, a result by its number, or an expression by its id."""
        step = self._step if step is None else step
        largest = self._printer.ranges.of(step, part or self._part, *key)
        if largest is None:
            raise ValueError(
                f"The 'drive' must lead through all branches of '{self._part.function.name}', so "
                "that the size of their numbers is known. Got a drive that misses some."
            )
        return digits(largest)

    def _array(self, array, step):
        """Return the digits of an array, and whether one of its numbers may be infinite."""
        ranges = self._printer.ranges
        if array.values is not None:
            is_infinite = any(map(math.isinf, array.values))
            return table_digits(array) if array.kind == "real" else 0, is_infinite
        if self._step is None:
            key = (step if array.name == "s" else None, array.name)
            return digits(ranges.of(*key)), ranges.may_be_infinite(*key)
        if array.name in self._arrays:
            return self._arrays[array.name]
        return self._digits(array.name), self._may_be_infinite(array.name)

    def _may_be_infinite(self, *key, part=None):
        """Whether a number may be infinite, by its key as in :meth:`_digits`."""
        return self._printer.ranges.may_be_infinite(self._step, part or self._part, *key)

    def _is_unbounded(self, x):
        """Whether an expression may be infinite."""
        match x.op:
            case "name":
                return self._may_be_infinite(*x.args)
            case "load":
                return self._array(x.args[0], None)[1]
            case "call":
                return self._may_be_infinite(0, part=called(x))
        return self._may_be_infinite(id(x))

    def _digits_of(self, x):
        """Return the digits of an expression; None for constants, which can have any."""
        if x.value is not None:
            return None
        match x.op:
            case "name":
                return self._digits(*x.args)
            case "load":
                return self._array(x.args[0], None)[0]
            case "call":
                return self._digits(0, part=called(x))
        return self._digits(id(x))

    def _common(self, *values):
        """Return the digits at which numbers can be added and compared: the fewest of them."""
        known = [self._digits_of(x) for x in values]
        return min((f for f in known if f is not None), default=digits(1.0))

    def _statement(self, statement, path):
        result = self._decided(statement.test) if isinstance(statement, If) else None
        if result is None:
            if isinstance(statement, If):
                self._note_branches(statement, False, True)
            return super()._statement(statement, path)
        taken = "body" if result else "orelse"
        pad = len(path) * "    "
        return f"{pad}{self._braced(statement, path, taken)}\n" if getattr(statement, taken) else ""

    def _note_branches(self, x, *sides):
        """Note that the program contains these branches of a statement or an expression."""
        self._printer.places |= {((self._step, self._part), id(x), side) for side in sides}

    def _put(self, x, place):
        """Return the text that assigns to a variable, or to a result, with its digits."""
        return self._fitted(x, self._digits(place))[0] if x.kind == "real" else self._text(x)

    def _change(self, target, value, before):
        if value.kind != "real":
            return f"{target} = {self._text(value)}"
        return f"{target} = {self._fitted(value, self._digits_of(before))[0]}"

    def _call(self, part, args, outs, path):
        outs = [out for out in outs if out is not None]
        step = path[-1] if self._step is None else self._step
        text = self._called(part, args, outs if len(outs) > 1 else (), step)
        kinds = self._part.function.kinds
        pairs = [(self._digits(k, part=part, step=step), out) for k, out in enumerate(outs)]
        if len(outs) == 1 and kinds[outs[0]] == "real":
            ((f, out),) = pairs
            return f"{out} = {self._rescaled(text, ATOM, f, self._digits(out))[0]};"
        if len(outs) == 1:
            return f"{outs[0]} = {text};"
        moves = [
            f"\n{len(path) * '    '}{out} = {self._rescaled(out, ATOM, f, self._digits(out))[0]};"
            for f, out in pairs
            if kinds[out] == "real" and f != self._digits(out)
        ]
        return "".join((f"{text};", *moves))

    def _called(self, part, args, outs=(), step=None):
        """Return the text of a call; the digits of its arguments are those of the parameters."""
        step = self._step if step is None else step
        texts, arrays = [], []
        for arg, param in zip(part.args(args), part.args(part.function.params), strict=True):
            if isinstance(arg, Array):
                arrays.append(self._array(arg, step))
                texts.append(self._text(arg))
            elif arg.kind == "real":
                f = self._digits(*param.args, part=part, step=step)
                texts.append(self._fitted(arg, f)[0])
            else:
                texts.append(self._text(arg))
        texts += [f"&{out}" for out in outs]
        return f"{self._printer.function(part, step, tuple(arrays))}({', '.join(texts)})"

    def _bound(self, x):
        """Return the text of an integer or a condition, and its precedence."""
        if x.op in ("and", "or", "choice"):
            self._note_branches(x, *range(1, len(x.args)))
        if x.op in COMPARISONS and x.args[0].kind == "real":
            f = self._common(*x.args)
            symbol, binding = SYMBOLS[_exact_comparison(x, f)]
            a, b = (self._bracketed(y, f, 5, True) for y in x.args)
            return f"{a} {symbol} {b}", binding
        if x.op == "cast" and x.args[0].kind == "real":
            return self._as_integer(x.args[0]), ATOM
        if x.op in ("+", "-", "*") and not self._is_place(x):
            a, b = map(self._wide, x.args)
            return self._helper("to_int32", f"{a} {x.op} {b}"), ATOM
        return super()._bound(x)

    def _wide(self, x):
        """Return the text of an integer as one of 64 bits, in which no sum overflows."""
        if x.op in ("+", "-", "*") and self._is_place(x):
            a, b = map(self._wide, x.args)
            return f"({a} {x.op} {b})"
        return f"(int64_t){self._tight(x, ATOM)}"

    def _is_place(self, x):
        """Whether an integer is computed from constants and loop variables only."""
        if x.op == "name":
            return x.args[0] in self._loops
        return x.op == "const" or (x.op in ("+", "-", "*") and all(map(self._is_place, x.args)))

    def _as_integer(self, x):
        """Return the text of a real number as an integer: truncated, or its floor or ceiling."""
        rounding = x.op.removeprefix("math.") if x.op.startswith("math.") else "trunc"
        (number,) = x.args if x.op.startswith("math.") else (x,)
        f = min(max(self._common(number), 0), _BITS)
        text = self._fitted(number, f)[0]
        if rounding == "trunc":
            return self._helper("to_int32", f"{self._bracketed(number, f, 7)} / {2**f}")
        if rounding == "floor":
            return self._helper("to_int32", self._helper("floor", text, f))
        return self._helper("to_int32", f"-{self._helper('floor', f'-({text})', f)}")

    def _helper(self, op, *args):
        """Return the text of a call of a helper function."""
        return f"{self._printer.helper(op, 'real')}({', '.join(map(str, args))})"

    def _bracketed(self, x, f, precedence, is_limit=False):
        """Return the text of :meth:`_fitted`, in parentheses if it has a lower precedence."""
        text, binding = self._fitted(x, f, is_limit)
        return text if binding >= precedence else f"({text})"

    def _rescaled(self, text, binding, f_own, f, may_be_infinite=False):
        """Return a number of ``f_own`` digits with ``f`` digits, and its precedence."""
        if may_be_infinite and f_own != f:
            return self._helper("rescaled_finite", text, f_own, f), ATOM
        if f_own > f:
            return self._helper("shift", text, f_own - f), ATOM
        if f_own < f:
            return self._helper("rescaled", text, f_own, f), ATOM
        return text, binding

    def _fitted(self, x, f, is_limit=False):
        """Return the text of a real number with ``f`` digits, and its precedence."""
        if x.value is not None:
            return scaled(float(x.value), f, is_limit), UNARY
        op, args = x.op, x.args
        match op:
            case "name" | "load":
                text = super()._bound(x)[0]
                return self._rescaled(text, ATOM, self._digits_of(x), f, self._is_unbounded(x))
            case "cast":
                text, binding = super()._bound(x)
                return self._rescaled(text, binding, 0, f)
            case "call":
                text = self._called(called(x), args[1:])
                return self._rescaled(text, ATOM, self._digits_of(x), f, self._is_unbounded(x))
            case "+" | "-":
                f_args = self._common(*args, x)
                b = self._bracketed(args[1], f_args, ATOM) if op == "-" else None
                b = f"-{b}" if op == "-" else self._fitted(args[1], f_args)[0]
                text = self._helper("sum", self._fitted(args[0], f_args)[0], b)
                return self._rescaled(text, ATOM, f_args, f)
            case "*" | "/":
                return self._product(op, *args, f)
            case "powi" if args[1].value is not None:
                return self._whole_power(args[0], args[1].value, f)
            case "neg":
                return f"-{self._bracketed(args[0], f, ATOM)}", UNARY
            case "choice":
                return self._choice(x, f)
            case "min" | "max" | "abs" | "math.fabs":
                f_args = self._common(*args)
                texts = [self._fitted(y, f_args, True)[0] for y in args]
                text = self._helper(op[-3:], *texts)
                return self._rescaled(text, ATOM, f_args, f, self._is_unbounded(x))
            case "math.sqrt":
                return self._power(args[0], constant(0.5), f)
            case "**" | "math.pow":
                return self._power(*args, f)
            case "math.copysign":
                size = self._helper("abs", self._fitted(args[0], f)[0])
                sign = self._bracketed(args[1], self._common(args[1]), 5)
                return f"{sign} < 0 ? -{size} : {size}", CHOICE
        name = op.removeprefix("math.")
        if name in _OF_ONE_NUMBER:
            f_args = self._common(*args)
            return self._helper(name, self._fitted(args[0], f_args)[0], f_args, f), ATOM
        raise ValueError(
            f"{name!r} in '{self._part.function.name}' has no form in "
            "integers: the 'dtype' must be 'float32' or 'float64'."
        )

    def _choice(self, x, f):
        test, a, b = x.args
        result = self._decided(test)
        if result is not None:
            return self._fitted(a if result else b, f)
        self._note_branches(x, 1, 2)
        a, b = (self._bracketed(y, f, CHOICE + 1) for y in (a, b))
        return f"{self._tight(test, CHOICE + 1)} ? {a} : {b}", CHOICE

    def _decided(self, test):
        """Return the result of a test that is always the same, None for other tests.

        Such a test compares equal expressions, or a number with a constant beyond its range.
        """
        if test.op in ("and", "or"):
            results = [self._decided(side) for side in test.args]
            deciding = test.op == "or"
            return deciding if deciding in results else None if None in results else not deciding
        if test.op == "not":
            result = self._decided(*test.args)
            return None if result is None else not result
        if test.op not in COMPARISONS or test.args[0].kind != "real":
            return None
        if test.args[0] == test.args[1]:
            return compared(test.op, constant(0.0), constant(0.0)).value
        numbers = [x for x in test.args if x.value is None]
        if len(numbers) != 1:
            return None
        (bound,) = (float(x.value) for x in test.args if x.value is not None)
        is_out_of_range = not (math.isnan(bound) or is_within(bound, self._common(*numbers)))
        if not is_out_of_range or (math.isinf(bound) and self._is_unbounded(*numbers)):
            return None
        return compared(test.op, *(constant(0.0) if x in numbers else x for x in test.args)).value

    def _product(self, op, a, b, f):
        """Return the product or quotient of two numbers."""
        fa, fb = (
            digits(float(x.value), _EXACT) if x.value is not None else self._digits_of(x)
            for x in (a, b)
        )
        texts = self._fitted(a, fa)[0], self._fitted(b, fb)[0]
        n = fa + fb - f if op == "*" else f - fa + fb
        shift = min(max(n, 0), _LONGEST_SHIFT)
        text = self._helper("product" if op == "*" else "ratio", *texts, shift)
        remaining = n - shift  # that the helper cannot do
        return self._rescaled(text, ATOM, remaining if op == "*" else -remaining, 0)

    def _whole_power(self, a, n, f):
        """Return a power with a constant integer exponent, by products."""
        if n == 0:
            return scaled(1.0, f), UNARY
        if n == 2:
            return self._product("*", a, a, f)
        f_base = self._common(a)
        base = text = self._fitted(a, f_base)[0]
        bits = _BITS - MARGIN
        f_power = f_base
        for power in range(2, n + 1):
            previous = f_power
            f_power = bits - power * (bits - f_base)  # the power of the largest base has `bits`
            text = self._helper("product", text, base, previous + f_base - f_power)
        return self._rescaled(text, ATOM, f_power, f)

    def _power(self, a, b, f):
        """Return a power of a non-negative number."""
        fa, fb = self._common(a), min(max(self._common(b), 0), _BITS)
        texts = self._fitted(a, fa)[0], self._fitted(b, fb)[0]
        return self._helper("pow", *texts, fa, fb, f), ATOM


def _exact_comparison(x, f):
    """Return the comparison of numbers of ``f`` digits that is equivalent to one of real numbers.

    They differ where a constant is rounded to zero: a number that is zero would be equal to it.
    """
    vanishing = [k for k, y in enumerate(x.args) if y.value and abs(y.value) < 0.5 ** (f + 1)]
    if len(vanishing) != 1:
        return x.op
    is_upper = (x.args[vanishing[0]].value > 0.0) == (vanishing[0] == 1)  # of the other number
    return (_UPPER_ROUNDED if is_upper else _LOWER_ROUNDED).get(x.op, x.op)


def boundary(printer, model, stepper, ends, units, change=None):
    """Return the body of the public step, and the initial state.

    Parameters
    ----------
    printer : FixedPrinter
    model : Slice
    stepper : Stepper
    ends : ndarray of shape (2, n_inputs)
        Limits of the input, in its units.
    units : tuple of float
        Drive and response that correspond to the integer 1.
    change : int, optional
        Largest change of the output, from ``state->output``.
    """
    ranges, n_inputs = printer.ranges, stepper.compiled_step.n_inputs
    by_row, state = n_inputs is not None, stepper.state
    f = digits(ranges.of(None, "u"))
    f_unit = min(max(digits(units[0], _EXACT), f), f + _LONGEST_SHIFT)
    unit = f"{scaled(units[0], f_unit)}, {f_unit - f}"
    product, least, most = (printer.helper(op, "real") for op in ("product", "min", "max"))
    names = [f"u[{k}]" for k in range(n_inputs)] if by_row else ["u"]
    inputs = [
        f"{product}({least}({most}({u}, {low}), {high}), {unit})"
        for u, low, high in zip(names, *ends.tolist(), strict=True)
    ]
    lines = [f"const int64_t x{f'[{len(inputs)}]' if by_row else ''} = "]
    lines[0] += f"{{{', '.join(inputs)}}};" if by_row else f"{inputs[0]};"
    f = digits(ranges.of(None, model, 0))
    f_unit = min(max(digits(1.0 / units[1], _EXACT), -f), _LONGEST_SHIFT - f)
    unit = f"{scaled(1.0 / units[1], f_unit)}, {f + f_unit}"
    call = f"{printer.function(model)}({', '.join(model.args(['x', 'state->s']))})"
    lines += [f"const int64_t y = {product}({call}, {unit});"]
    to_int32 = printer.helper("to_int32", "real")
    if change is None:
        lines += [f"const int32_t output = {to_int32}(y);"]
    else:  # numbers at half a unit may be rounded in different directions
        nearest = f"{least}({most}(y, state->output - {change}), state->output + {change})"
        lines += [
            "const int32_t output =",
            f"    {to_int32}(state->output == INT64_MIN ? y : {nearest});",
        ]
    arguments = zip(("x", "state"), model.taken, strict=True)
    lines[1:1] = [f"(void){name};" for name, used in arguments if not used]
    first = []
    for step, statement in enumerate(model.body):
        if not isinstance(statement, Call):
            continue
        part = statement.args[-1]  # of the state
        begin, f = part.offset.value, digits(ranges.of(step, "s"))
        first += [scaled(x, f) for x in state[begin : begin + part.shape[0]]]
    return "".join(f"    {line}\n" for line in lines), ", ".join(first) or "0"
