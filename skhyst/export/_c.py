"""Write a model as a C99 program, with a test program."""

import hashlib
import re
from numbers import Real
from pathlib import Path
from string import Template

import numpy as np

from .._files import replacing
from .._validation import finite_numbers
from ..operators import Stepper
from ..records import chosen_interval
from ._fixed import MARGIN, Fixed, FixedPrinter, boundary
from ._model import model_step
from ._printer import Dialect, Printer
from ._ranges import Ranges, explore
from ._single import check_single
from ._values import TAKEN

DIALECTS = {
    "float64": Dialect("double", "", np.float64),
    "float32": Dialect("float", "f", np.float32),
}
TOLERANCES = {"float64": 1e-12, "float32": 1e-6}  # as fractions of the response's range
_N_TEST = 200

_HEADER = Template("""\
/* $name: $what, written by skhyst.

   Compile with: cc -std=c99 -c $name.c
   Test with: cc -std=c99 -o ${name}_test ${name}_test.c $name.c -lm && ./${name}_test

   $units
   One call is one sampling interval. Nothing is allocated and loops are bounded. */
#ifndef ${name}_H
#define ${name}_H

#include <stdint.h>

#define ${name}_DT $dt /* sampling interval in s */
#define ${name}_N_INPUTS $n_inputs
/* SHA-256 of the program in double precision: of its laws, constants and initial state */
#define ${name}_HASH "$digest"

typedef struct {
    $inner s[$n_states];
$kept} ${name}_state;

/* The state before the first sample. */
void ${name}_init(${name}_state *state);

/* One sample. $caution */
$type ${name}_step(${name}_state *state, $input);

${bits}/* Conditions of the last sample: a bit is set for each that holds. */
uint32_t ${name}_status(const ${name}_state *state);

#endif
""")
_SOURCE = Template("""\
#include <math.h>
#include <stdbool.h>
#include <stdint.h>

#include "$name.h"

$guard$tables$functions
void ${name}_init(${name}_state *state)
{
    static const ${name}_state first = {{$first}$kept_first};
    *state = first;
}

$type ${name}_step(${name}_state *state, $input)
{
$body}

uint32_t ${name}_status(const ${name}_state *state)
{
$conditions}
""")
_TEST = Template("""\
/* Test of $name.c: returns 0 if its outputs agree with those of the Python model. */
#include <math.h>
#include <stdio.h>

#include "$name.h"

#define N_SAMPLES $n_samples

static const $type ${name}_inputs[N_SAMPLES][$n_inputs] = {
$inputs};

static const double ${name}_outputs[N_SAMPLES] = {
$outputs};

${refuses}int main(void)
{
    ${name}_state state;
    double largest = 0.0;
    $type y = $last;
    int k, failed = 0;
    ${name}_init(&state);
    for (k = 0; k < N_SAMPLES; k++) {
$refused        y = ${name}_step(&state, ${name}_inputs[k]$one);
        const double error = fabs((double)y - ${name}_outputs[k]);
        largest = error <= largest ? largest : error;
    }
    printf("$name: %.3g of $measure, %.3g allowed$covered\\n", largest / $span, $tolerance);
    return largest <= $tolerance * $span ? failed : 1;
}
#undef N_SAMPLES
""")
_INTEGERS = {
    "type": "int32_t",
    "inner": "int64_t",
    "tolerance": 1.0,
    "measure": "a unit of output",
    "span": "1.0",
    "last": "0",
    **dict.fromkeys(("kept", "kept_first", "guard", "refuses", "refused"), ""),
}
_REFUSES = Template("""\
/* Whether input that is not finite is refused: each column in turn. */
static int ${name}_refuses(${name}_state *state, $type last)
{
    static const $type wrong[] = {NAN, INFINITY, -INFINITY};
    int k;
    for (k = 0; k < 3 * ${name}_N_INPUTS; k++) {
        $type u[${name}_N_INPUTS] = {0};
        u[k / 3] = wrong[k % 3];
        if (${name}_step(state, u$one) != last || !(${name}_status(state) & ${name}_REFUSED)) {
            return 0;
        }
    }
    return 1;
}

""")
_FINITE_MATH = """\
#if defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__
#error "isfinite is needed: compile without -ffast-math and -ffinite-math-only"
#endif

"""


def to_c(
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
) -> list[Path]:
    """Write a model, compensator, controller or operator as a C99 program, run sample by sample.

    Three files are written: the header ``name.h`` with ``name_state``, ``name_init``, ``name_step``
    and ``name_status``, the source ``name.c``, and the test program ``name_test.c``, which returns
    0 if its responses to a drive agree with those of the Python model. The header says how to
    compile. The status of a sample has a bit for each condition that holds, those named in
    :attr:`~skhyst.operators.Stepper.status`: ``name_LIMITED`` if limits have cut the output of a
    compensator or controller, ``name_REFUSED`` if the input was not finite.

    Input that is not finite is refused: the state stays as it is, and the output is that of the
    last sample before, or the response to ``u0`` where there was none. Integers are always finite.

    Parameters
    ----------
    model : object with ``stepper``, Stepper, Operator or CompiledStep
        A fitted model, a compensator, a controller, ...; a stepper in its present state; an
        operator; or a compiled step. Of an object its ``stepper(dt, u0, initial_state=...)`` is
        called, the last two arguments only if they are not the default.
    folder : str or Path
        Created if it is missing.
    name : str
        Name of the files and prefix of all names in C: letters, digits and underscores.
    dtype : {"float64", "float32", "int32"}, default="float64"
        Type of input and output. ``"float64"`` and ``"float32"`` compute in ``double`` and
        ``float``; ``"int32"`` in integers alone, for machines without floating point.
    dt : float, optional
        Sampling interval in s; that of the records of the fit by default. Needed for an operator.
    initial_state : {"rest", "zero"}, default=None
        State before the first sample; by default that of ``predict``, of an operator that of rest.
    u0 : float or array-like of shape (n_inputs,), default=0.0
        Input at which the device rests: a drive, or the reference of a compensator.
    drive : array-like of shape (n_samples,) or (n_samples, n_inputs), optional
        Input of the test program, units of the drive; further columns are not used. By default the
        sum of a decaying and a steady sine, of amplitude one about ``u0``. ``"int32"`` needs it:
        the fixed point of each number is chosen so that it can hold 4096 times the largest value
        under this drive and under jumps between its ends. Input is limited to up to 16 times its
        largest value, as far as numbers can hold the response to jumps from there. The test
        continues with these jumps, with rests and with limited input, where responses do not depend
        on rounding, and prints how many branches of the law it takes.
    input_unit, output_unit : float, optional
        For ``"int32"``: the drive (the same for all inputs) and the response that correspond to the
        integer 1.

    Returns
    -------
    list of Path
        Header, source and test program.

    Raises
    ------
    NotImplementedError
        If the output depends on later input.
    TypeError
        If the model cannot be run sample by sample, or has no compiled step in plain arithmetic.
    ValueError
        If the model's law is outside the part of Python that can be written in C, with file and
        line; see :class:`~skhyst.operators.CompiledStep`. If it cannot be written in integers, or
        single precision is not sufficient: if its error in the test exceeds the tolerance.

    Notes
    -----
    The tolerance of the test is 1e-12 of the range of the response (zero included) in double and
    1e-6 in single precision, and one unit of output in integers. In floating point it is at least
    twice the change of the Python model's response to a change of the input by half a unit in the
    last place. That is much more where the law jumps, or an inverse meets a flat part of its law.

    Integer arithmetic saturates: nothing overflows, for any input. A number that grows without
    bound, such as a count of time, stays at about 4096 times its largest value in the test.

    Integers have no ``exp``, ``tanh``, ``cos``, ... and no powers but squares: laws that need
    them are refused by name.

    Examples
    --------
    >>> import tempfile
    >>> from skhyst.export import to_c
    >>> from skhyst.hysteresis import BacklashOperator
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     paths = to_c(BacklashOperator(0.2), folder, "gear", dt=1e-3)
    ...     [path.name for path in paths]
    ['gear.h', 'gear.c', 'gear_test.c']
    """
    if not re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII) or name in TAKEN:
        raise ValueError(
            f"The 'name' parameter of to_c must be a name in C that begins with a letter. Got "
            f"{name!r} instead."
        )
    if dtype not in (*DIALECTS, "int32"):
        raise ValueError(
            f"The 'dtype' parameter of to_c must be one of {sorted((*DIALECTS, 'int32'))}. Got "
            f"{dtype!r} instead."
        )
    what = type(model).__name__
    stepper, dt = _stepper(model, dt, initial_state, u0)
    compiled_step = stepper.compiled_step
    if dtype != "float64" and compiled_step.double_only:
        raise ValueError(
            f"The 'dtype' parameter of to_c must be 'float64' for {compiled_step.double_only}. "
            f"Got {dtype!r} instead."
        )
    n_inputs = compiled_step.n_inputs or 1
    step, double = model_step(compiled_step), DIALECTS["float64"]
    common = {
        "name": name,
        "what": what,
        "dt": "NAN" if dt is None else double.literal(dt),
        "n_inputs": n_inputs,
        "covered": "",
        "one": "" if compiled_step.n_inputs else "[0]",
        "n_states": max(len(compiled_step.state), 1),
        "digest": hashlib.sha256(_program(step, stepper.state).encode()).hexdigest(),
        **_status(name, compiled_step.flags, refuses=dtype != "int32"),
    }
    if dtype == "int32":
        units = _units(drive, input_unit, output_unit)
        drive = _inputs(drive, n_inputs)
        texts = _in_integers(stepper, common, drive, units)
    else:
        drive = _test_drive(u0, n_inputs) if drive is None else _inputs(drive, n_inputs)
        texts = _in_reals(step, stepper, common, drive, u0, dtype)
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / file for file in texts]
    with replacing(*paths) as parts:
        for part, text in zip(parts, texts.values(), strict=True):
            part.write_text(text, encoding="utf-8")
    return paths


def _stepper(model, dt, initial_state, u0):
    """Return a model as a stepper, and the sampling interval, None where it is not known."""
    dt = None if dt is None else chosen_interval((), dt, "to_c")
    finite_numbers(u0, "to_c", "u0", "a finite number, or one for each input")
    if hasattr(model, "stepper"):
        more = {} if initial_state is None else {"initial_state": initial_state}
        model = model.stepper(dt, *([u0] if np.any(u0) else []), **more)
    elif hasattr(model, "init"):
        if dt is None:
            raise ValueError("The 'dt' parameter of to_c must be given, in s, for an operator.")
        model = model.compiled_step(dt, model.init(u0, initial_state or "rest"))
    if hasattr(model, "bound"):
        model = Stepper(model)
    if not isinstance(model, Stepper):
        raise TypeError(
            "The 'model' parameter of to_c must be a fitted model, or have a 'stepper' that "
            f"is a Stepper, or an operator. Got {model!r} instead."
        )
    return model, model.dt if dt is None else dt


def _status(name, flags, refuses):
    """Return the parts of header and source for the status bits, which are read from the state."""
    places = [(flag, f"s[{at}]") for flag, at in flags] + [("refused", "refused")] * refuses
    bits = {flag: f"{name}_{flag.upper()}" for flag, _ in places}
    lines = [
        f"    if (state->{at} != 0) {{\n        status |= {bits[flag]};\n    }}\n"
        for flag, at in places
    ]
    lines = ["    uint32_t status = 0u;\n", *lines, "    return status;\n"]
    return {
        "bits": "".join(f"#define {bit} {1 << k}u\n" for k, bit in enumerate(bits.values())),
        "conditions": "".join(lines if places else ["    (void)state;\n    return 0u;\n"]),
    }


def _units(drive, *units):
    for name, unit in zip(("input_unit", "output_unit"), units, strict=True):
        if not (isinstance(unit, Real) and 0.0 < unit < np.inf):
            raise ValueError(
                f"The {name!r} parameter of to_c must be a number above 0 for 'int32'. Got "
                f"{unit!r} instead."
            )
    if drive is None:
        raise ValueError("The 'drive' parameter of to_c must be given for 'int32'.")
    return units


def _program(step, state):
    """Return the program in double precision without the prefix of its names, for the hash."""
    dialect = DIALECTS["float64"]
    printer = Printer("", dialect)
    printer.function(step)
    tables = (text for _, text in printer.tables.values())
    return "\n".join((*tables, *printer.texts, _listed(state, dialect.literal)))


def _listed(values, literal):
    return ", ".join(map(literal, values)) or "0"


def _answers(stepper, drive):
    """Return the response (n_samples,) of the Python model to a drive (n_samples, n_inputs)."""
    device, row = stepper.copy(), stepper.compiled_step.n_inputs
    return np.array([device.step(u if row else u[0]) for u in drive])


def _texts(common, printer, inputs, outputs):
    """Return the text of header, source and test program, by file name."""
    name, double = common["name"], DIALECTS["float64"]
    argument = "const {} *u" if not common["one"] else "{} u"
    common |= {
        "input": argument.format(common["type"]),
        "tables": "".join(f"{text}\n" for _, text in printer.tables.values()),
        "functions": "\n".join(printer.texts),
        "n_samples": len(outputs),
        "inputs": "".join(f"    {{{row}}},\n" for row in inputs),
        "outputs": "".join(f"    {double.literal(y)},\n" for y in outputs),
    }
    return {
        f"{name}.h": _HEADER.substitute(common),
        f"{name}.c": _SOURCE.substitute(common),
        f"{name}_test.c": _TEST.substitute(common),
    }


def _reserve(printer):
    printer.taken |= {
        f"{printer.prefix}_{own}" for own in ("init", "step", "state", "status", "test", "refuses")
    }
    return printer


def _in_reals(step, stepper, common, drive, u0, dtype):
    dialect = DIALECTS[dtype]
    printer = _reserve(Printer(common["name"], dialect))
    call = f"{printer.function(step)}({', '.join(step.args(['u', 'state->s']))})"
    drive = drive.astype(dialect.number).astype(float)
    outputs = _answers(stepper, drive)
    span = np.ptp([0.0, *outputs]) or 1.0
    # change of the response under rounding errors of the input: alternating, and of one sign
    rounding = 0.5 * np.finfo(dialect.number).eps * (1.0 - 2.0 * (np.arange(len(drive)) % 2))
    moved = max(
        np.abs(_answers(stepper, drive * (1.0 + each[:, None])) - outputs).max()
        for each in (rounding, -rounding, abs(rounding), -abs(rounding))
    )
    tolerance = max(TOLERANCES[dtype], 2.0 * moved / span)
    if dtype == "float32":
        check_single(step, stepper.state, drive, outputs, span, tolerance)
    name, n_inputs = common["name"], common["n_inputs"]
    last = stepper.output
    last = _answers(stepper, _at(u0, 1, n_inputs))[0] if last is None else last
    inputs = ["u"] if common["one"] else [f"u[{k}]" for k in range(n_inputs)]
    check = " && ".join(f"isfinite({u})" for u in inputs)
    common |= {
        "type": dialect.type,
        "inner": dialect.type,
        "kept": f"    {dialect.type} output; /* of the last sample that was not refused */\n"
        "    uint32_t refused;\n",
        "guard": _FINITE_MATH,
        "units": "Input and output are in the units of the model's drive and response.",
        "caution": "Input that is not finite is refused: the state stays as it is and the\n"
        f"   output is the last one ({last:.9g} at first), see {name}_REFUSED.",
        "first": _listed(stepper.state, dialect.literal),
        "last": dialect.literal(last),
        "kept_first": f", {dialect.literal(last)}, 0u",
        "body": f"    state->refused = {check} ? 0u : 1u;\n    if (state->refused == 0u) {{\n"
        f"        state->output = {call};\n    }}\n    return state->output;\n",
        "tolerance": DIALECTS["float64"].literal(tolerance),
        "measure": "the range",
        "span": DIALECTS["float64"].literal(span),
        "refuses": _REFUSES.substitute(common, type=dialect.type),
        "refused": f"        failed |= !{name}_refuses(&state, y);\n",
    }
    return _texts(common, printer, [_listed(row, dialect.literal) for row in drive], outputs)


def _in_integers(stepper, common, drive, units):
    step = model_step(stepper.compiled_step, with_numbers=True)
    counts = np.round(drive / units[0]).astype(np.int64)
    ranges = Ranges(step, stepper.state, counts * units[0])
    counts, ends = explore(ranges, counts, units, MARGIN, lambda u: _answers(stepper, u))
    printer = _reserve(FixedPrinter(common["name"], Fixed(), ranges=ranges))
    body, first = boundary(printer, step, stepper, ends, units)
    taken, there_are = ranges.branches
    missed = ", ".join(f"{n} of {name}" for name, n in sorted(ranges.passed_by.items()))
    common |= _INTEGERS | {
        "units": f"An input of 1 is {units[0]!r} and an output of 1 is {units[1]!r}, in the\n"
        "   units of the model's drive and response.",
        "caution": "Input below {} or above {}, and output beyond 32 bits, are held.".format(
            *(_listed(end, str) for end in ends.tolist())
        ),
        "first": first,
        "body": body,
        "covered": f"; {taken} of {there_are} branches taken"
        + (f", not {missed}" if missed else ""),
    }
    outputs = _answers(stepper, np.clip(counts, *ends) * units[0]) / units[1]
    outputs = np.clip(outputs, 1 - 2.0**31, 2.0**31 - 1)
    return _texts(common, printer, [_listed(row, str) for row in counts], outputs)


def _inputs(drive, n_inputs):
    """Return a drive as an array (n_samples, n_inputs), without further columns."""
    drive = np.asarray(drive, dtype=float)
    drive = drive[:, None] if drive.ndim == 1 else drive
    if drive.shape[1] < n_inputs:
        raise ValueError(
            f"The 'drive' parameter of to_c must have {n_inputs} columns. Got {drive.shape[1]} "
            "instead."
        )
    return drive[:, :n_inputs]


def _test_drive(u0, n_inputs):
    """Return a drive with turning points at many levels, which starts smoothly from ``u0``."""
    part = np.arange(_N_TEST) / _N_TEST
    swing = np.sin(2 * np.pi * 5 * part) * (1.0 - part) + 0.3 * np.sin(2 * np.pi * 17 * part)
    return _at(u0, _N_TEST, n_inputs) + swing[:, None] / 1.3


def _at(u0, n_samples, n_inputs):
    """Return an input that rests, (n_samples, n_inputs)."""
    return np.zeros((n_samples, n_inputs)) + np.ravel(u0)[:n_inputs]
