"""Write a model as a function block in Structured Text (IEC 61131-3), with a test program.

The block holds the state, the constants and the tables. Functions take such an array as
``VAR_IN_OUT``, with the index where their part of it begins, since there are no pointers, methods
or global variables. What Python evaluates only under a condition becomes an ``IF``, since ``AND``,
``OR`` and ``SEL`` evaluate all operands. Infinite limits become the largest number, which raises no
floating-point exception.
"""

import math
import re
import textwrap
from pathlib import Path

import numpy as np

from ._c import DIALECTS, digest_of
from ._composed_step import model_step
from ._content import Source, legend, range_tests, written
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
)
from ._printer import assigned
from ._slice import called, within

_TYPES = {"float64": "LREAL", "float32": "REAL"}
# operators with their precedence
_SYMBOLS = {
    **{"or": ("OR", 1), "and": ("AND", 2), "==": ("=", 3), "!=": ("<>", 3)},
    **{"<": ("<", 4), "<=": ("<=", 4), ">": (">", 4), ">=": (">=", 4)},
    **{"+": ("+", 5), "-": ("-", 5), "*": ("*", 6), "/": ("/", 6)},
}
_UNARY, _ATOM = 7, 8
_FUNCTIONS = {  # operation -> function of the standard
    **{f"math.{own}": own.upper() for own in ("acos", "asin", "atan", "cos", "exp", "sin", "sqrt")},
    **{"math.tan": "TAN", "math.log": "LN", "math.log10": "LOG", "math.fabs": "ABS"},
    **{"abs": "ABS", "min": "MIN", "max": "MAX", "**": "EXPT", "math.pow": "EXPT"},
}
_EAGER = {*_SYMBOLS, "neg", "not", "abs", "min", "max"} - {"/"}  # operations that never fail
# replacements for missing functions: name and type, inputs, variables, and statements, in which {n}
# is the result
_HELPERS = {
    "//": (
        "quotient : DINT",
        "a : DINT; b : DINT",
        "",
        "{n} := a / b;\nIF (a MOD b <> 0) AND ((a < 0) <> (b < 0)) THEN\n    {n} := {n} - 1;\n"
        "END_IF",
    ),
    "%": (
        "modulo : DINT",
        "a : DINT; b : DINT",
        "",
        "{n} := a MOD b;\nIF ({n} <> 0) AND (({n} < 0) <> (b < 0)) THEN\n    {n} := {n} + b;\n"
        "END_IF",
    ),
    "math.floor": (
        "floor : DINT",
        "a : {t}",
        "",
        "{n} := TRUNC(a);\nIF DINT_TO_{t}({n}) > a THEN\n    {n} := {n} - 1;\nEND_IF",
    ),
    "math.ceil": (
        "ceil : DINT",
        "a : {t}",
        "",
        "{n} := TRUNC(a);\nIF DINT_TO_{t}({n}) < a THEN\n    {n} := {n} + 1;\nEND_IF",
    ),
    "math.copysign": (
        "copysign : {t}",
        "a : {t}; b : {t}",
        "",
        "{n} := ABS(a);\nIF b < {0} THEN\n    {n} := -{n};\nEND_IF",
    ),
    "powi": (
        "power : {t}",
        "a : {t}; k : DINT",
        "x : {t}; i : DINT",
        "{n} := {1};\nx := a;\ni := k;\nWHILE i > 0 DO\n    IF i MOD 2 = 1 THEN\n"
        "        {n} := {n} * x;\n    END_IF\n    i := i / 2;\n    IF i > 0 THEN\n"
        "        x := x * x;\n    END_IF\nEND_WHILE",
    ),
    # Kahan: the logarithm of the rounded e^a cancels its rounding error
    "math.expm1": (
        "expm1 : {t}",
        "a : {t}",
        "x : {t}",
        "x := EXP(a);\nIF x = {1} THEN\n    {n} := a;\nELSIF (x < {half}) OR (x > {2}) THEN\n"
        "    {n} := x - {1};\nELSE\n    {n} := (x - {1}) * a / LN(x);\nEND_IF",
    ),
    "math.log1p": (
        "log1p : {t}",
        "a : {t}",
        "x : {t}",
        "x := {1} + a;\nIF x = {1} THEN\n    {n} := a;\nELSIF (x < {half}) OR (x > {2}) THEN\n"
        "    {n} := LN(x);\nELSE\n    {n} := LN(x) * a / (x - {1});\nEND_IF",
    ),
    # e^-2|a| - 1 as above; from 20 on it is -1 to the last digit
    "math.tanh": (
        "tanh : {t}",
        "a : {t}",
        "x : {t}",
        "IF ABS(a) > {20} THEN\n    {n} := {1};\nELSE\n    x := {expm1}(a := -{2} * ABS(a));\n"
        "    {n} := -x / ({2} + x);\nEND_IF\nIF a < {0} THEN\n    {n} := -{n};\nEND_IF",
    ),
    "nan": (
        "nan : {t}",
        "zero : {t}",
        "",
        "{n} := zero / zero; (* of a law that has diverged *)",
    ),
}
_WORDS = frozenset(  # and the names of the first program in TwinCAT and CODESYS
    """
    abs acos action add adr and any array asin at atan atan2 begin bool by byte cal calc case ceil
    concat configuration constant continue cos date delete di dint div do dt dword else elsif end eq
    exit exp expt exptd extends external f_edge f_trig false final find floor for from function ge
    global goto gt if implements in include indexof init inout input insert int interface internal
    interval jmp jmpc jmpcn ld le left len limit ln log lreal lt lword max method mid min mod move
    mul mux namespace ne not null of on operator or out output override pi pointer priority private
    program project property protected public r_edge r_trig read_only read_write real ref
    reference replace resource resume ret retain return right rol ror rs s1 sel shl shr single sin
    sint sizeof sqrt sr st step stn string struct sub super system tan task then this time to tod
    ton tof tp trunc true type udint uint ulint union until usint using var var_access var_config
    var_external var_global var_in_out var_input var_inst var_output var_stat var_temp while with
    word wstring xor lint ctu ctd ctud jmpn r s end_action end_case end_configuration end_for
    end_function end_function_block end_if end_interface end_method end_namespace end_program
    end_property end_repeat end_resource end_step end_struct end_transition end_type end_var
    end_while function_block main plc_prg
    """.split()  # noqa: SIM905
)
_OF_BLOCK = frozenset(  # names of the function block's variables
    """
    cycle extrapolated first hash held init init_at kept known last limited next overrange refused
    row state u unreachable y
    """.split()  # noqa: SIM905
)


def to_structured_text(
    model,
    folder,
    name,
    dtype="float64",
    *,
    dt=None,
    initial_state=None,
    u0=0.0,
    drive=None,
    input_unit=None,
    output_unit=None,
    form="table",
    tolerance=None,
) -> list[Path]:
    """Write a model, compensator, controller or operator as a function block for a PLC.

    Two files in Structured Text (IEC 61131-3) are written, ``name.st`` with the function block and
    the functions that it calls, and ``name_test.st`` with a program that makes one sample of the
    test in each cycle: ``passed`` becomes true with ``done`` if the outputs are those of Python.

    One call of the block is one sample: it takes ``u`` and gives ``y``, and a flag for each
    condition of :func:`to_c` that can hold: ``limited``, ``unreachable``, ``extrapolated``,
    ``refused``, ``overrange``. While ``init`` is true it is in its first state; while ``init_at``
    is true, at rest at ``u``, if that is known. Call it from a task whose cycle is the sampling
    interval.

    Parameters
    ----------
    model : object with ``stepper``, Stepper, Operator or CompiledStep
        As for :func:`to_c`.
    folder : str or Path
        Created if it is missing.
    name : str
        Name of the files and of the block, and prefix of its functions: letters, digits and single
        underscores.
    dtype : {"float64", "float32"}, default="float64"
        ``LREAL`` or ``REAL``.
    dt, initial_state, u0, drive : optional
        As for :func:`to_c`.
    input_unit, output_unit : str, optional
        Names of the units of inputs and output for the comments, as for :func:`to_c`.
    form, tolerance : optional
        As for :func:`to_c`.

    Returns
    -------
    list of Path
        Function block and test program.

    Raises
    ------
    NotImplementedError, TypeError
        As :func:`to_c`.
    ValueError
        As :func:`to_c`; or if the law calls a function that Structured Text does not have.

    See Also
    --------
    to_c : A program in C.

    Notes
    -----
    The text uses the common subset of TwinCAT 3 and CODESYS V3. For laws in plain arithmetic its
    numbers equal those of C and Python to the last digit. ``expm1``, ``log1p`` and ``tanh``, which
    the standard does not have, are computed from ``EXP`` and ``LN``, with an error of some units of
    the last digit.

    References
    ----------
    IEC 61131-3, *Programmable controllers, part 3: programming languages*, 3rd edition, 2013.

    Examples
    --------
    >>> import tempfile
    >>> from skhyst.export import to_structured_text
    >>> from skhyst.hysteresis import BacklashOperator
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     paths = to_structured_text(BacklashOperator(0.2), folder, "gear", dt=1e-3)
    ...     [path.name for path in paths]
    ['gear.st', 'gear_test.st']
    """
    legal = isinstance(name, str) and re.fullmatch(r"[A-Za-z](_?[A-Za-z0-9])*", name)
    if not legal or name.lower() in _WORDS | _OF_BLOCK:
        raise ValueError(
            "The 'name' parameter of to_structured_text must be a name of IEC 61131-3 that begins "
            f"with a letter, no word of the language, none of {sorted(_OF_BLOCK)}, and not 'main' "
            f"or 'plc_prg', the first program of a project. Got {name!r} instead."
        )
    if dtype not in _TYPES:
        raise ValueError(
            f"The 'dtype' parameter of to_structured_text must be one of {sorted(_TYPES)}. Got "
            f"{dtype!r} instead."
        )
    source = Source(model, dtype, dt, initial_state, u0, (), form, tolerance)
    signals = legend(source.stepper, source.dt, (input_unit, output_unit))
    expected = source.tested(drive)
    block = _Block(source, expected, name, dtype, signals)
    texts = {f"{name}.st": block.text(), f"{name}_test.st": block.test()}
    return written(folder, {file: _wrapped(text) for file, text in texts.items()})


def _wrapped(text):
    """Return a text whose lines longer than 100 characters, such as tables, are broken."""
    lines = []
    for line in text.splitlines():
        pad = " " * (len(line) - len(line.lstrip()) + 4)
        options = {"break_long_words": False, "break_on_hyphens": False}
        lines += textwrap.wrap(line, 100, subsequent_indent=pad, **options) or [""]
    return "\n".join(lines) + "\n"


def _section(word, rows):
    """Return the text of declarations; rows are (name, type, initial value, comment), or ""."""
    if not rows:
        return ""
    lines = [f"{word}\n"]
    for name, type_, first, note in rows:
        value, comment = (f" := {first}" if first else ""), (f" (* {note} *)" if note else "")
        lines.append(f"    {name} : {type_}{value};{comment}\n")
    return f"{''.join(lines)}END_VAR\n"


def _array(n, type_):
    return f"ARRAY[0..{n - 1}] OF {type_}"


class _Printer:
    """Writes functions, each once, and collects them and the tables that they read."""

    def __init__(self, prefix, dtype):
        self.prefix, self.type, self._dialect = prefix, _TYPES[dtype], DIALECTS[dtype]
        self.texts, self.tables = [], {}
        self._functions, self._taken = {}, {prefix.lower(), f"{prefix}_test".lower()}

    def name(self, wanted):
        """Return a name that is not yet used in the whole program; case does not count."""
        wanted = name = re.sub("_+", "_", f"{self.prefix}_{wanted.strip('_')}").strip("_")
        count = 1
        while name.lower() in self._taken:
            count += 1
            name = f"{wanted}_{count}"
        self._taken.add(name.lower())
        return name

    def type_of(self, kind):
        """Return the type of numbers of a kind."""
        return {"bool": "BOOL", "int": "DINT", "real": self.type}[kind]

    def number(self, x):
        """Return a number for a declaration; an infinite one becomes the largest."""
        largest = float(np.finfo(self._dialect.number).max)
        return self._dialect.digits(min(max(x, -largest), largest)).upper()

    def literal(self, x, kind="real"):
        """Return a constant for an expression; literals of ``REAL`` have a prefix, ``REAL#``."""
        if kind != "real":
            return str(x).upper()
        sign, digits = ("-" if math.copysign(1.0, x) < 0.0 else ""), self.number(abs(x))
        return f"{sign}{'REAL#' if self.type == 'REAL' else ''}{digits}"

    def values(self, array):
        """Return the initial value of an array."""
        return f"[{', '.join(map(self.number if array.kind == 'real' else str, array.values))}]"

    def table(self, array):
        """Return the name of a constant array."""
        key = (array.kind, array.values or (0.0,))
        if key not in self.tables:
            self.tables[key] = self.name(array.name)
        return self.tables[key]

    def helper(self, op):
        """Return the name of the function for an operation that the standard does not have."""
        if op not in self._functions:
            if op not in _HELPERS:
                raise ValueError(
                    f"The function {op.removeprefix('math.')!r} cannot be written in Structured "
                    "Text."
                )
            head, inputs, variables, body = _HELPERS[op]
            numbers = {str(k): self.literal(float(k)) for k in (0, 1, 2, 20)}
            substitutions = numbers | {"half": self.literal(0.5), "t": self.type}
            if "{expm1}" in body:
                substitutions["expm1"] = self.helper("math.expm1")
            short_name, _, type_ = head.partition(" : ")
            self._functions[op] = name = self.name(short_name)
            for key, value in substitutions.items():
                body, type_, inputs, variables = (
                    text.replace(f"{{{key}}}", value) for text in (body, type_, inputs, variables)
                )
            rows = [
                [(*row.split(" : "), "", "") for row in text.split("; ") if row]
                for text in (inputs, variables)
            ]
            self.texts.append(
                f"FUNCTION {name} : {type_}\n{_section('VAR_INPUT', rows[0])}"
                f"{_section('VAR', rows[1])}{body.replace('{n}', name)}\nEND_FUNCTION\n"
            )
        return self._functions[op]

    def function(self, part, *memories):
        """Return the function for arrays stored in ``memories``, see :class:`_Function`.

        Lengths of arrays are part of their type: each combination has a function of its own.
        """
        key = (part, *memories)
        if key not in self._functions:
            function = _Function(self, part, memories)
            self._functions[key] = function
            self.texts.append(function.text)
        return self._functions[key]


class _Function:
    """Writes one function.

    Parameters
    ----------
    printer : _Printer
    part : Slice
    memories : sequence of (str, bool)
        Type of the array that each array argument is a part of, its memory, and whether the
        argument begins where the memory does.
    """

    def __init__(self, printer, part, memories):
        self._printer, self._part = printer, part
        function = part.function
        self.name = printer.name(function.name)
        self._names, self._lines, self._depth, self._n_new = {}, [], 0, 0
        self.tables = {}  # of this function and those that it calls, with their types
        self._variables, inputs, shared = [], [], []
        memories, self._memories, self.params = iter(memories), {}, []
        changed = {name for statement in within(part.body) for name in assigned(statement)}
        for p in part.args(function.params):
            if isinstance(p, Array):
                name, (type_, begins) = self._local(p.name), next(memories)
                begin = None if begins else self._new("at")
                self._memories[p.name] = type_, begin
                shared.append((name, type_, "", ""))
                inputs += [] if begins else [(begin, "DINT", "", "")]
                self.params.append((name, begin))
            else:
                variable, type_ = self._local(p.args[0]), printer.type_of(p.kind)
                name = variable
                if p.args[0] in changed:  # inputs are read only
                    name = self._local(f"{p.args[0]} in")
                    self._variables.append((variable, type_, "", ""))
                    self._put(f"{variable} := {name};")
                inputs.append((name, type_, "", ""))
                self.params.append((name, None))
        param_names = {p.name if isinstance(p, Array) else p.args[0] for p in function.params}
        for statement in within(part.body):
            if isinstance(statement, Listed):
                array = statement.array
                type_ = _array(len(statement.values), printer.type_of(array.kind))
                self._memories[array.name] = type_, None
                self._variables.append((self._local(array.name), type_, "", ""))
        leaves = _numbers(function.result)
        kinds = [x.kind for x, is_used in zip(leaves, part.mask, strict=True) if is_used]
        self.outs = [self._new("out") for _ in kinds[1:]]
        self._result = printer.type_of(kinds[0]) if kinds else "BOOL"
        if not kinds:
            self._put(f"{self.name} := TRUE;")
        self._block(part.body)
        if self._lines[-1:] == ["RETURN;"]:
            self._lines.pop()
        local_names = [n for n in self._names if n in function.kinds and n not in param_names]
        self._variables += [
            (self._names[n], printer.type_of(function.kinds[n]), "", "") for n in local_names
        ]
        outs = zip(self.outs, kinds[1:], strict=True)
        self.text = (
            f"FUNCTION {self.name} : {self._result}\n"
            + _section("VAR_INPUT", inputs)
            + _section("VAR_IN_OUT", [*shared, *((n, t, "", "") for n, t in self.tables.items())])
            + _section("VAR_OUTPUT", [(n, printer.type_of(k), "", "") for n, k in outs])
            + _section("VAR", self._variables)
            + "".join(f"{line}\n" for line in self._lines)
            + "END_FUNCTION\n"
        )

    # names and lines

    def _local(self, name):
        """Return the legal name of a variable: case does not count, and keywords are reserved."""
        if name not in self._names:
            legal = re.sub("[ _]+", "_", name).strip("_") or "t"
            taken = {unique.lower() for unique in self._names.values()} | {self.name.lower()}
            unique, count = legal, 1
            while unique.lower() in taken or unique.lower() in _WORDS:
                count += 1
                unique = f"{legal}_{count}"
            self._names[name] = unique
        return self._names[name]

    def _new(self, word):
        """Return the name of a new variable."""
        self._n_new += 1
        return self._local(f"{word} {self._n_new}")  # with a space, which no variable has

    def _temporary(self, kind):
        name = self._new("h")
        self._variables.append((name, self._printer.type_of(kind), "", ""))
        return name

    def _put(self, line):
        self._lines.append("    " * self._depth + line)

    def _under(self, head, write, end=None):
        self._put(head)
        self._depth += 1
        write()
        self._depth -= 1
        if end:
            self._put(end)

    # statements

    def _block(self, body):
        for statement in body:
            self._statement(statement)

    def _statement(self, statement):
        match statement:
            case Assign(target, value):
                self._assign(self._local(target), value)
            case Store(array, place, value):
                self._assign(self._element(array, place), value)
            case Listed(array, values):
                for k, x in enumerate(values):
                    self._assign(f"{self._local(array.name)}[{k}]", x)
            case Call(_, args, outs):
                outs = [out for out in outs if out is not None]
                names = [self._local(out) for out in outs] or [self._temporary("bool")]
                text = self._called(called(statement, outs), args, names[1:])
                self._put(f"{names[0]} := {text};")
            case Return(values):
                for name, x in zip((self.name, *self.outs), values, strict=False):
                    self._assign(name, x)
                self._put("RETURN;")
            case Jump(word):
                self._put({"break": "EXIT;", "continue": "CONTINUE;"}[word])
            case If():
                self._if(statement)
            case While(test, body):
                self._while(test, body)
            case For(name, start, stop, step, body):
                # FOR includes its last value, Python's range does not
                first, last = self._text(start), self._tight(stop, 5)
                last = (
                    str(stop.value - step // abs(step))
                    if stop.value is not None
                    else (f"{last} {'-' if step > 0 else '+'} 1")
                )
                by = f" BY {step}" if step != 1 else ""
                head = f"FOR {self._local(name)} := {first} TO {last}{by} DO"
                self._under(head, lambda: self._block(body), "END_FOR")

    def _if(self, statement):
        test, body, orelse = statement.test, statement.body, statement.orelse
        if not body:
            test, body, orelse = Expression("not", (test,), "bool"), orelse, ()
        self._under(f"IF {self._text(test)} THEN", lambda: self._block(body))
        if orelse:
            self._under("ELSE", lambda: self._block(orelse))
        self._put("END_IF")

    def _while(self, test, body):
        """Write a loop; statements that its test needs become the first of its body."""
        lines, self._lines = self._lines, []
        text = self._text(test)
        test_lines, self._lines = self._lines, lines
        if not test_lines:
            self._under(f"WHILE {text} DO", lambda: self._block(body), "END_WHILE")
            return

        def write():
            self._lines += [f"    {line}" for line in test_lines]
            self._under(f"IF NOT ({text}) THEN", lambda: self._put("EXIT;"), "END_IF")
            self._block(body)

        self._under("WHILE TRUE DO", write, "END_WHILE")

    def _assign(self, target, x):
        """Write an assignment, or an ``IF`` with one for each side of a condition."""
        lazy = x.op in ("and", "or") and not _is_eager(x.args[1])
        if x.op != "choice" and not lazy:
            if not self._is(target, x):
                self._put(f"{target} := {self._text(x)};")
            return
        true, false = Expression("const", (True,), "bool"), Expression("const", (False,), "bool")
        sides = {
            "choice": x.args[1:],
            "and": (x.args[1], false),
            "or": (true, x.args[-1]),
        }[x.op]
        test, same = x.args[0], [self._is(target, side) for side in sides]
        if same[0]:
            test, sides, same = Expression("not", (test,), "bool"), sides[::-1], same[::-1]
        self._under(f"IF {self._text(test)} THEN", lambda: self._assign(target, sides[0]))
        if not same[1]:
            self._under("ELSE", lambda: self._assign(target, sides[1]))
        self._put("END_IF")

    def _is(self, target, x):
        """Whether an expression is the variable that it would be assigned to."""
        return x.op == "name" and self._local(x.args[0]) == target

    # expressions

    def _called(self, part, args, outs=()):
        """Return the text of a call; an array is given by its memory and where it begins in it."""
        args, texts, memories = part.args(args), [], []
        for x in args:
            if isinstance(x, Array):
                name, type_, begin = self._memory(x)
                begins = begin == "0"
                memories.append((type_, begins))
                texts.append((name, None if begins else begin))
            else:
                texts.append((self._text(x), None))
        function = self._printer.function(part, *memories)
        assignments = []
        for (name, at_name), (text, begin) in zip(function.params, texts, strict=True):
            assignments.append(f"{name} := {text}")
            assignments += [f"{at_name} := {begin}"] if at_name else []
        assignments += [f"{name} := {name}" for name in function.tables]
        # who calls a function needs its tables, too: they are all variables of the block
        self.tables |= function.tables
        assignments += [f"{name} => {out}" for name, out in zip(function.outs, outs, strict=True)]
        return f"{function.name}({', '.join(assignments)})"

    def _memory(self, array):
        """Return the name of an array's memory, its type, and where the array begins in it."""
        offset = self._text(array.offset)
        if array.values is not None:
            name = self._printer.table(array)
            type_ = _array(len(array.values or (0,)), self._printer.type_of(array.kind))
            self.tables[name] = type_
            return name, type_, offset
        type_, begin = self._memories[array.name]
        if begin is not None:
            offset = begin if offset == "0" else f"{begin} + {self._tight(array.offset, 5)}"
        return self._local(array.name), type_, offset

    def _element(self, array, place):
        """Return the text of an element of an array; ``place`` counts from the array's begin."""
        if array.values is not None:
            return f"{self._memory(array)[0]}[{self._text(place)}]"
        _, begin = self._memories[array.name]
        text = self._text(place)
        if begin is not None:
            text = begin if text == "0" else f"{begin} + {self._tight(place, 5)}"
        return f"{self._local(array.name)}[{text}]"

    def _text(self, x):
        return self._bound(x)[0]

    def _tight(self, x, least):
        text, binding = self._bound(x)
        return text if binding >= least else f"({text})"

    def _assigned_temporary(self, x):
        """Write the assignment of an expression to a temporary variable, and return its name."""
        name = self._temporary(x.kind)
        self._assign(name, x)
        return name, _ATOM

    def _bound(self, x):
        """Return the text of an expression and the precedence of its outermost operator."""
        op, args = x.op, x.args
        if op in ("==", "!=") and any(_is_infinite(a) for a in args):
            return self._at_infinity(x)
        if op in ("and", "or") and not _is_eager(args[1]):
            return self._assigned_temporary(x)
        if op in _SYMBOLS:
            symbol, binding = _SYMBOLS[op]
            leasts = (max(binding, 5), max(binding, 4) + 1)  # conditions are put in parentheses
            a, b = (self._tight(arg, least) for arg, least in zip(args, leasts, strict=True))
            # no operator may follow another, as in "a - -b"
            b = f"({b})" if b.startswith("-") else b
            return f"{a} {symbol} {b}", binding
        match op:
            case "const" if x.kind == "real" and math.isnan(x.value):
                zero = self._printer.literal(0.0)
                return f"{self._printer.helper('nan')}(zero := {zero})", _ATOM
            case "const":
                text = self._printer.literal(x.value, x.kind)
                return text, _UNARY if text.startswith("-") else _ATOM
            case "name":
                return self._local(args[0]), _ATOM
            case "load":
                return self._element(*args), _ATOM
            case "call":
                return self._called(called(x), args[1:]), _ATOM
            case "choice":
                return self._assigned_temporary(x)
            case "neg" | "not":
                word = "-" if op == "neg" else "NOT "
                return word + self._tight(args[0], _ATOM), _UNARY
            case "cast":
                return self._cast(x)
        texts = [self._text(arg) for arg in args]
        if op in _FUNCTIONS:
            return f"{_FUNCTIONS[op]}({', '.join(texts)})", _ATOM
        name = self._printer.helper(op)
        names = [declaration.split(" : ")[0] for declaration in _HELPERS[op][1].split("; ")]
        assignments = ", ".join(f"{n} := {text}" for n, text in zip(names, texts, strict=True))
        return f"{name}({assignments})", _ATOM

    def _cast(self, x):
        """Return a conversion; from a real number towards zero, as Python's ``int``."""
        arg = x.args[0]
        if arg.kind == "real":
            if arg.op in ("math.floor", "math.ceil"):
                return f"{self._printer.helper(arg.op)}(a := {self._text(arg.args[0])})", _ATOM
            arg = arg.args[0] if arg.op == "math.trunc" else arg
            return f"TRUNC({self._text(arg)})", _ATOM
        types = self._printer.type_of(arg.kind), self._printer.type_of(x.kind)
        return f"{types[0]}_TO_{types[1]}({self._text(arg)})", _ATOM

    def _at_infinity(self, x):
        """Return a comparison with an infinite number, which the largest number stands for."""
        a, b = x.args if _is_infinite(x.args[1]) else x.args[::-1]
        is_positive = b.value > 0.0
        symbol = (">=" if is_positive else "<=") if x.op == "==" else ("<" if is_positive else ">")
        return f"{self._tight(a, 5)} {symbol} {self._printer.literal(b.value)}", 4


def _numbers(value):
    return [x for part in value for x in _numbers(part)] if isinstance(value, tuple) else [value]


def _is_infinite(x):
    return x.kind == "real" and x.value is not None and math.isinf(x.value)


def _is_eager(x):
    """Whether an expression cannot fail, so that it may be evaluated without its condition."""
    if x.op == "load":
        return x.args[1].value is not None
    if x.op in ("const", "name"):
        return x.kind != "real" or x.value is None or not math.isnan(x.value)
    is_safe = x.op in _EAGER or (x.op == "cast" and x.args[0].kind != "real")
    return is_safe and all(map(_is_eager, x.args))


class _Block:
    """The function block, and its test."""

    def __init__(self, source, expected, name, dtype, signals):
        self._source, self._expected, self._name = source, expected, name
        self._dtype, (self._signals, self._preview) = dtype, signals
        self._printer = _Printer(name, dtype)
        self._flags = [flag for flag, _ in source.compiled_step.flags]

    def text(self):
        """Return the function block, after the functions that it calls."""
        source, printer, expected = self._source, self._printer, self._expected
        real = printer.type
        inputs = [f"u[{k}]" for k in range(source.n_inputs)] if source.by_row else ["u"]
        step, tables = self._call(source.step, "u")
        rest_call = None
        if expected.rules is not None:
            rest_call, rest_tables = self._call(
                model_step(source.compiled_step, rules=expected.rules), "held"
            )
            tables |= rest_tables
        extrapolated, lasts = self._range(inputs)
        largest = printer.number(np.inf)
        largest = f"REAL#{largest}" if real == "REAL" else largest
        finite = (f"({x} >= -{largest}) AND ({x} <= {largest})" for x in inputs)
        # after a start there is no last sample to compare with: no rate is known
        hold = [*["y := {y};"], *["extrapolated := FALSE;"] * bool(extrapolated)]
        hold += ["known := FALSE;"] * bool(lasts)
        start = ["state := first;", *hold, "overrange := FALSE;"]
        lines = [
            "refused := FALSE;",
            "IF init THEN",
            *[f"    {line}" for line in start],
            "ELSE",
            f"    refused := NOT ({' AND '.join(finite)});",
            "END_IF",
            "IF NOT (init OR refused) THEN",
        ]
        copy_row = ["row := u;"] if source.by_row else []
        held = list(enumerate(source.compiled_step.held))
        sample = [
            *copy_row,
            f"next := {step};",
            # the largest number stands for an infinite one
            f"IF (next > -{largest}) AND (next < {largest}) THEN",
            "    y := next;",
            "ELSE (* the last output is held; only limits continue from it *)",
            *(f"    kept[{k}] := state[{at}];" for k, at in held),
            "    state := first;",
            *(f"    state[{at}] := kept[{k}];" for k, at in held),
            *("    overrange := TRUE;", "END_IF"),
            *self._watch(extrapolated, lasts),
        ]
        if expected.checked is not None:
            sample.append(f"overrange := overrange OR {self._beyond(inputs, expected.checked)};")
        if rest_call is None:
            lines += [f"    {line}" for line in sample]
        else:
            clips = []
            for k, (low, high) in enumerate(expected.ends.T):
                target = f"held[{k}]" if source.by_row else "held"
                low, high = printer.literal(low), printer.literal(high)
                clips.append(f"{target} := MIN(MAX({inputs[k]}, {low}), {high});")
            clips.append(f"overrange := {self._beyond(inputs, expected.ends)};")
            begin = [*clips, f"y := {rest_call};", *[line for line in hold if "{y}" not in line]]
            lines += ["    IF init_at THEN", *[f"        {line}" for line in begin], "    ELSE"]
            lines += [*[f"        {line}" for line in sample], "    END_IF"]
        lines.append("END_IF")
        for flag, at in source.compiled_step.flags:
            kept = "overrange OR " if flag == "overrange" else ""
            lines.append(f"{flag} := {kept}(state[{at}] <> {printer.literal(0.0)});")
        body = "\n".join(lines).replace("{y}", printer.literal(expected.last))
        if not len(source.stepper.state):
            body = re.sub(" +state := first;\n", "", body)
        return (
            self._head()
            + "\n".join(
                [*printer.texts, self._declared(tables, lasts, rest_call is not None) + body + "\n"]
            )
            + "END_FUNCTION_BLOCK\n"
        )

    def _beyond(self, inputs, ends):
        """Return the condition that an input is beyond its ends."""
        literal = self._printer.literal
        tests = zip(inputs, *ends, strict=True)
        return " OR ".join(f"({u} < {literal(a)}) OR ({u} > {literal(b)})" for u, a, b in tests)

    def _declared(self, tables, lasts, begins_at):
        source, printer, real = self._source, self._printer, self._printer.type
        row, n = _array(source.n_inputs, real), len(source.stepper.state)
        init_at = [("init_at", "BOOL", "", "rest at u instead of a sample")] * begins_at
        note = (
            self._signals[0]
            if not source.by_row
            else "; ".join(f"[{k}] {signal}" for k, signal in enumerate(self._signals[:-1]))
        )
        inputs = [
            ("u", row if source.by_row else real, "", note),
            ("init", "BOOL", "", "the first state again instead of a sample"),
            *init_at,
        ]
        flags = [(flag, "BOOL", "", "") for flag in self._flags if flag != "overrange"]
        flags += [("extrapolated", "BOOL", "", "")] * bool(source.stepper.watched)
        dt = [] if source.dt is None else [("cycle", real, printer.number(source.dt), "s")]
        outputs = [
            ("y", real, printer.number(self._expected.last), self._signals[-1]),
            *flags,
            ("refused", "BOOL", "", ""),
            ("overrange", "BOOL", "", "numbers have been beyond the range, since the start"),
            *dt,
            ("hash", "STRING(64)", f"'{digest_of(source)}'", "SHA-256, as of the program in C"),
        ]
        first = f"[{', '.join(map(printer.number, source.stepper.state))}]"
        variables = [(name, _array(n, real), first, "") for name in ("state", "first") if n]
        variables += [("row", row, "", "")] * source.by_row
        variables += [("held", row if source.by_row else real, "", "")] * begins_at
        variables += [("next", real, "", "")]
        n_held = len(source.compiled_step.held)
        variables += [("kept", _array(n_held, real), "", "")] * (n_held > 0)
        variables += [("last", _array(len(lasts), real), "", "")] * bool(lasts)
        variables += [("known", "BOOL", "", "")] * bool(lasts)
        for (kind, values), name in printer.tables.items():
            if name in tables:  # a table that no call of the block reads is left out
                array = Array("", (len(values),), values, kind=kind)
                variables.append(
                    (name, _array(len(values), printer.type_of(kind)), printer.values(array), "")
                )
        return (
            f"FUNCTION_BLOCK {self._name}\n"
            + _section("VAR_INPUT", inputs)
            + _section("VAR_OUTPUT", outputs)
            + _section("VAR", variables)
        )

    def _head(self):
        source = self._source
        lines = [
            f"{self._name}: {source.what}, written by skhyst.",
            "",
            *(f"u: {s}" for s in self._signals[:-1] if not source.by_row),
            *(f"u[{k}]: {s}" for k, s in enumerate(self._signals[:-1]) if source.by_row),
            f"y: {self._signals[-1]}",
            *self._preview,
            *self._limits(),
            *source.bounds(),
            *source.deviates(self._expected.drive),
            "One call is one sample"
            + ("" if source.dt is None else f": the cycle of its task is {source.dt:.9g} s")
            + ".",
            "Input that is not finite is refused: the state and the output stay as they are.",
            "Where finite input leads beyond floating point the output stays, and the state begins",
            "anew.",
        ]
        if self._expected.checked is not None:
            lines += self._expected.precision()
            lines.append("Input beyond these ends: overrange is true until the next start.")
        if any("zero / zero" in text for text in self._printer.texts):
            lines.append(
                "Where the law diverges its output is not a number: turn the exceptions of"
            )
            lines.append("floating point off for the task.")
        return "(*\n" + "".join(f"   {line}".rstrip() + "\n" for line in lines) + "*)\n\n"

    def _limits(self):
        """Return lines on the limits of the output."""
        words = "y is at least {}.", "y is at most {}.", "y changes by at most {} from {}."
        acting = self._source.compiled_step.acting
        last = "one input that is not refused to the next"
        if acting is not None:
            last = f"u[{acting}] where that is within the limits, else from the last y"
        limits = self._expected.limits or ()
        return [
            word.format(f"{x:.9g}", last)
            for word, x in zip(words, limits, strict=False)
            if np.isfinite(x)
        ]

    def _call(self, step, u):
        """Return the call of the step of a whole model, and the tables that it reads."""
        printer, source = self._printer, self._source
        memories, assignments = [], []
        for p in step.args(step.function.params):
            if isinstance(p, Array):
                memories.append((_array(p.shape[0], printer.type), True))
        function = printer.function(step, *memories)
        names = {"u": "row" if source.by_row and u == "u" else u, "s": "state"}
        for p, (name, _) in zip(step.args(step.function.params), function.params, strict=True):
            assignments.append(f"{name} := {names[p.name if isinstance(p, Array) else p.args[0]]}")
        assignments += [f"{name} := {name}" for name in function.tables]
        return f"{function.name}({', '.join(assignments)})", dict(function.tables)

    def _range(self, inputs):
        """Return the condition that a signal has left the range of the fit.

        Signals whose rate is limited, too, are returned as a second list: their last values are
        needed.
        """
        literal, texts = self._printer.literal, [*inputs, "y"]
        conditions, lasts = [], []
        eps = np.finfo(DIALECTS[self._dtype].number).eps
        for k, relation, value, place in range_tests(self._source.stepper, eps):
            if place is None:
                conditions.append(f"({texts[k]} {relation} {literal(value)})")
            else:
                moved = f"ABS({texts[k]} - last[{place}]) {relation} {literal(value)}"
                conditions.append(f"(known AND ({moved}))")
                lasts.append(texts[k])
        return " OR ".join(conditions), lasts

    @staticmethod
    def _watch(extrapolated, lasts):
        lines = [f"extrapolated := {extrapolated};"] * bool(extrapolated)
        lines += [f"last[{k}] := {text};" for k, text in enumerate(lasts)]
        return lines + ["known := TRUE;"] * bool(lasts)

    def test(self):
        """Return the program that tests the block, one sample in a cycle."""
        source, expected, real = self._source, self._expected, self._printer.type
        number, n = self._printer.number, len(expected.drive)
        double = _Printer("", "float64").number
        runs = expected.outputs[: 2 if expected.rules is not None else 1]
        u = [
            f"inputs[{source.n_inputs} * k + {j}]" if source.by_row else "inputs[k]"
            for j in range(source.n_inputs)
        ]
        of_level = [] if len(runs) < 2 else [number(x) for x in expected.level]
        listed = lambda values, write: f"[{', '.join(map(write, values))}]"  # noqa: E731
        variables = [
            ("device", self._name, "", ""),
            (
                "inputs",
                _array(expected.drive.size, real),
                listed(expected.drive.ravel(), number),
                "",
            ),
            ("outputs", _array(n * len(runs), "LREAL"), listed(np.ravel(runs), double), ""),
            *[("u", _array(source.n_inputs, real), "", "")] * source.by_row,
            ("k", "DINT", "", ""),
            ("of_run", "DINT", "", ""),
            ("error", "LREAL", "", ""),
            ("largest", "LREAL", "", "error"),
            ("allowed", "LREAL", double(expected.tolerance * expected.span), ""),
            ("failed", "BOOL", "", ""),
            ("done", "BOOL", "", "all samples have been compared"),
            ("passed", "BOOL", "", ""),
        ]
        # the outputs of Python stay in double precision, so that only the block's are rounded
        y = "device.y" if real == "LREAL" else "REAL_TO_LREAL(device.y)"
        row_lines = [f"u[{j}] := {text};" for j, text in enumerate(u)] if source.by_row else []
        input_text = "u" if source.by_row else "inputs[k]"
        init_at = ", init_at := FALSE" if of_level else ""
        # NOT (error <= allowed) holds for an error that is not a number, too
        lines = [
            *row_lines,
            f"device(u := {input_text}{init_at});",
            f"error := ABS({y} - outputs[{n} * of_run + k]);",
            "largest := MAX(largest, error);",
            "failed := failed OR NOT (error <= allowed);",
            "k := k + 1;",
        ]
        if of_level:
            literals = [self._printer.literal(x) for x in expected.level]
            level = [f"u[{j}] := {x};" for j, x in enumerate(literals)] if source.by_row else []
            begin = f"device(u := {'u' if source.by_row else literals[0]}, init_at := TRUE);"
            lines += [
                f"IF (k = {n}) AND (of_run = 0) THEN (* once more, from rest at another input *)",
                *[f"    {line}" for line in (*level, begin, "k := 0;", "of_run := 1;")],
                "END_IF",
            ]
        lines += [f"done := k = {n};", "passed := done AND NOT failed;"]
        body = "".join(f"    {line}\n" for line in lines)
        return (
            f"(* Test of {self._name}: call it until done. *)\n\nPROGRAM {self._name}_test\n"
            f"{_section('VAR', variables)}IF NOT done THEN\n{body}END_IF\nEND_PROGRAM\n"
        )
