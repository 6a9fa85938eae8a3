"""Write a model as a C99 program, with a test program."""

import hashlib
import math
import re
from dataclasses import dataclass, replace
from numbers import Real
from pathlib import Path
from string import Template

import numpy as np

from ..operators import Stepper
from ._composed_step import model_step
from ._content import (
    Source,
    answers,
    certain_bits,
    conditions,
    legend,
    range_tests,
    whole_limits,
    written,
)
from ._fixed import MARGIN, Fixed, FixedPrinter, boundary
from ._printer import Dialect, Printer
from ._ranges import Ranges, check_fast, explore, limits
from ._reach import reachable
from ._tunable import configuration
from ._values import TAKEN

DIALECTS = {
    "float64": Dialect("double", "", np.float64),
    "float32": Dialect("float", "f", np.float32),
}
_OUTER = "overrange", "extrapolated"  # conditions that the state outside the model tells
_SIMULINK_TYPES = {"float64": "SS_DOUBLE", "float32": "SS_SINGLE", "int32": "SS_INT32"}
_RESERVED = (  # names in every program, which functions of a model cannot have
    *("init", "step", "state", "status", "test", "refuses", "run", "init_at", "params", "defaults"),
    *("configure", "chebyshev", "first", "begin_anew"),
)

_HEADER = Template("""\
/* $name: $what, written by skhyst.

   Compile with: cc -std=c99 -c $name.c
   Test with: cc -std=c99 -o ${name}_test ${name}_test.c $name.c -lm && ./${name}_test

$legend
   $units
   One call is one sampling interval. Nothing is allocated and loops are bounded.

   MISRA C:2012, as checked by cppcheck: no required rule is broken; the advisory rules 2.5, 8.9,
   12.1, 15.4, 15.5, 17.8 and 18.4 are not kept. */
#ifndef ${name}_H
#define ${name}_H

${needs}#include <stdint.h>

${bits_of_double}#ifdef __cplusplus
extern "C" {
#endif

#define ${name}_DT $dt /* sampling interval in s */
#define ${name}_N_INPUTS $n_inputs
#define ${name}_PREVIEW $preview /* samples by which the input comes before its output */
$limits/* SHA-256 of the program in double precision: of its laws, constants and initial state */
#define ${name}_HASH "$digest"

${params}typedef struct {
    $inner s[$n_states];
$members$tuned} ${name}_state;

/* The state before the first sample. */
void ${name}_init(${name}_state *state);
${more_declared}
/* One sample. $caution */
$type ${name}_step(${name}_state *state, $input);

${bits}/* Conditions of the last sample: a bit is set for each that holds. */
uint32_t ${name}_status(const ${name}_state *state);

#ifdef __cplusplus
}
#endif

#endif
""")
_SOURCE = Template("""\
#include <math.h>
#include <stdbool.h>
#include <stdint.h>

#include "$name.h"

$guard$tables$functions
static const ${name}_state ${name}_first = {{$first}$members_first$tuned_first};

void ${name}_init(${name}_state *state)
{
    *state = ${name}_first;
}
$more_defined
$type ${name}_step(${name}_state *state, $input)
{
$body}

uint32_t ${name}_status(const ${name}_state *state)
{
$conditions}
""")
# Functions that the library of AVR lacks, by Kahan's formulas: the logarithm of a rounded value
# cancels its rounding error.
_AVR_FUNCTIONS = {
    "expm1": """
static $t expm1$f($t a)
{
    const $t x = exp$f(a);
    if (x == $one) {
        return a;
    }
    return (x < $half || x > $two) ? x - $one : (x - $one) * a / log$f(x);
}
""",
    "log1p": """
static $t log1p$f($t a)
{
    const $t x = $one + a;
    if (x == $one) {
        return a;
    }
    return (x < $half || x > $two) ? log$f(x) : log$f(x) * a / (x - $one);
}
""",
}
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

/* Bits of the status that are set, and that are not; others depend on rounding. */
static const uint8_t ${name}_bits[N_SAMPLES][2] = {$bits_of_run};

$more_outputs${refuses}\
/* Run one sample after the output *y. Return whether its status is wrong, or it leaves limits. */
static int ${name}_test_sample(${name}_state *state, int k, const $type *u, const uint8_t *bits,
                          $type *y)
{
    int failed = 0;
    uint32_t status;
    const $type last = *y;
$refused    *y = ${name}_step(state, u$one_u);
    status = ${name}_status(state);
    failed |= (status & bits[0]) != bits[0] || (status & bits[1]) != 0u;
$within    return failed;
}

/* Run the test after the output y. Return whether a sample is wrong but for its output. */
static int ${name}_run(${name}_state *state, const double *outputs, const uint8_t (*bits)[2],
                       $type y, double *largest)
{
    int k, failed = 0;
    for (k = 0; k < N_SAMPLES; k++) {
        failed |= ${name}_test_sample(state, k, ${name}_inputs[k], bits[k], &y);
        const double error = fabs((double)y - outputs[k]);
        if (!(error <= *largest) && !isnan(*largest)) {
            *largest = error;
        }
    }
    return failed;
}

int main(void)
{
    ${name}_state state;
    double largest = 0.0;
    int failed;
    ${name}_init(&state);
    failed = ${name}_run(&state, ${name}_outputs, ${name}_bits, $last, &largest);
$more_runs    if (failed) {
        printf("$name: a status, a limit or what is refused is wrong\\n");
    }
    printf("$name: %.3g of $measure, %.3g allowed$covered\\n",
           largest / $span, $tolerance);
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
    **dict.fromkeys(("guard", "refuses", "refused", "needs", "bits_of_double", "finite"), ""),
}
_OPTIONAL = (  # parts of the templates that optional functions of a program add
    *("params", "tuned", "tuned_first", "more_declared", "more_defined"),
    *("more_outputs", "more_runs"),
)
_INIT_AT = {
    "more_declared": Template("""
/* Rest at another input, after ${name}_init. $range */
void ${name}_init_at(${name}_state *state, $input);
"""),
    "more_defined": Template("""
void ${name}_init_at(${name}_state *state, $input)
{
$held    state->refused = 1u;
    if ($finite) {
        state->refused = 0u;
        state->overrange = 0u;
        if ($beyond) {
            state->overrange = 1u;
        }
        state->output = $call;
$forgotten    }
}
"""),
    "more_outputs": Template("""\
static const double ${name}_rest_outputs[N_SAMPLES] = {
$outputs};

static const uint8_t ${name}_rest_bits[N_SAMPLES][2] = {$bits_of_run};

"""),
    "more_runs": Template("""\
    {
        static const $type level[] = {$level};
        ${name}_init_at(&state, level$one);
        failed |= ${name}_run(&state, ${name}_rest_outputs, ${name}_rest_bits, state.output,
                              &largest);
    }
"""),
}
_BEGIN_ANEW = Template("""
/* Only limits continue from the output that is held. */
static void ${name}_begin_anew(${name}_state *state)
{
    int32_t i;
$held    for (i = 0; i < $n_states; i++) {
        state->s[i] = ${name}_first.s[i];
    }
$kept    state->overrange = 1u;
}
""")
_CONFIGURE = {
    "params": Template("""\
/* Parameters that can be changed at run time. */
typedef struct {
$fields} ${name}_params;

"""),
    "tuned": Template("    $type k[$n_constants]; /* constants that depend on the parameters */\n"),
    "tuned_first": Template(", {$constants}"),
    "more_declared": Template("""
/* Those of the fit, which are in force after ${name}_init. */
void ${name}_defaults(${name}_params *params);

/* Put parameters in force from the next sample on: the state stays. Returns 1, and changes nothing,
   if one is outside its range, else 0. */
int ${name}_configure(${name}_state *state, const ${name}_params *params);
"""),
    "more_defined": Template("""
void ${name}_defaults(${name}_params *params)
{
    static const ${name}_params first = {$values};
    *params = first;
}

${helpers}int ${name}_configure(${name}_state *state, const ${name}_params *params)
{
    static const $type low[$n] = {$low};
    static const $type high[$n] = {$high};
    $type p[$n_and_one]; /* as fractions of their ranges, and one */
    int32_t i;
$read    for (i = 0; i < $n; i++) {
        if (!(p[i] >= low[i] && p[i] <= high[i])) {
            return 1;
        }
    }
    for (i = 0; i < $n; i++) {
        p[i] = (p[i] - $half * (low[i] + high[i])) / ($half * (high[i] - low[i]));
    }
    p[$n] = $unity;
$derive    return 0;
}
"""),
    "more_outputs": Template("""\
static const double ${name}_tuned_outputs[N_SAMPLES] = {
$outputs};

static const uint8_t ${name}_tuned_bits[N_SAMPLES][2] = {$bits_of_run};

/* Put one parameter in force, the others as fitted. Return whether that is not refused as it
   should be. */
#define TRIED(field, value, is_refused) \\
    (${name}_defaults(&tried), tried.field = (value), \\
     ${name}_configure(&state, &tried) != (is_refused))

"""),
    "more_runs": Template("""\
    {
        static const ${name}_params others = {$others};
        ${name}_params tried;
        ${name}_init(&state);
        failed |= ${name}_configure(&state, &others);
        failed |= ${name}_run(&state, ${name}_tuned_outputs, ${name}_tuned_bits, $last, &largest);
$trials    }
"""),
}
_EXTREMES = {
    "more_outputs": Template("""\
/* Beyond the inputs above, and back. */
static const $type ${name}_extremes[$n_extremes][$n_inputs] = {
$extremes};

static const uint8_t ${name}_extreme_bits[$n_extremes][2] = {$bits_of_run};

"""),
    "more_runs": Template("""\
    {
        $type y = $last;
        int k;
        ${name}_init(&state);
        for (k = 0; k < $n_extremes; k++) {
            failed |= ${name}_test_sample(&state, k, ${name}_extremes[k], ${name}_extreme_bits[k],
                                    &y);
        }
    }
"""),
}
_REFUSES = Template("""\
/* Whether input that is not finite is refused: each column in turn. */
static int ${name}_refuses(${name}_state *state, $type last)
{
    static const $type wrong[] = {($type)NAN, ($type)INFINITY, -($type)INFINITY};
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
_NO_INIT_AT = """\
There is no {}_init_at: the state of rest is not known as a function of the input and
the constants alone."""
_DEFAULT_DRIVE = """\
Single precision has been tested for a drive of amplitude one, whatever the device takes: write
the program with a drive over its range."""
_NOTES = {  # on the bits of the status
    "limited": "the drive has been limited",
    "unreachable": "no drive gives the reference: the last one stays",
    "extrapolated": "a drive is beyond the range or rate of the fit, or the acting one the limits",
    "refused": "the input was not finite",
    "overrange": "since the start numbers have been beyond the range of the program",
}
# on small controllers a double may be a float, with whose digits the constants are not enough
_BITS_OF_DOUBLE = """\
#if DBL_MANT_DIG < 53
#error "double has fewer than 64 bits here: write the program with dtype float32"
#endif

"""
# these flags let the compiler take isfinite as true, so that nothing would be refused
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
    tunable=(),
    form="table",
    tolerance=None,
    simulink=False,
) -> list[Path]:
    """Write a model, compensator, controller or operator as a C99 program, run sample by sample.

    Three files are written: the header ``name.h`` with ``name_state``, ``name_init``, ``name_step``
    and ``name_status``, the source ``name.c``, and the test program ``name_test.c``, which returns
    0 if its responses to a drive agree with those of the Python model. The header says how to
    compile. The status of a sample has a bit for each condition that holds, those named in
    :attr:`~skhyst.operators.Stepper.status`: ``name_LIMITED`` if limits have cut the output of a
    compensator or controller, ``name_UNREACHABLE`` if an inverse has found no drive for its
    reference, ``name_EXTRAPOLATED`` if the drive has left the range or the rate of the fit,
    ``name_REFUSED`` if the input was not finite, ``name_OVERRANGE`` if numbers have been beyond the
    range of the program since the start: integers are held at its ends, single precision may have
    lost digits, and where a finite input leads beyond floating point the last output is held while
    the state begins anew, see :meth:`~skhyst.operators.Stepper.step`. The header gives the range
    and describes input and output, with their units if they are given, the limits of the output
    and the preview of a compensator. C++ can include it.

    ``name_init_at`` puts the device to rest at another input. The program has it if the state of
    rest of every part is known as a function of the input: for hysteresis that one step from rest
    at zero brings there, and for linear parts.

    Input that is not finite is refused: the state is unchanged, and the output is that of the last
    accepted sample, or the response to ``u0`` if there was none. Integers are always finite.

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
        begins with a sample at ``u0`` and continues with these jumps, with rests and with limited
        input, where responses do not depend on rounding, and prints how many branches of the law
        it takes.
    input_unit, output_unit : float or str, optional
        For ``"int32"`` numbers: the input (the same for all inputs) and the output that correspond
        to the integer 1. Else names of units, such as ``"V"``, for the header; of several inputs
        one name each, or one for all.
    tunable : sequence of str, or dict of str to (float, float), default=()
        Parameters that can be changed at run time, by name: of the operator, such as ``"gain"``
        or, in a cascade, ``"plays__weights"``, or numbers of a controller, such as ``"kp"``; with
        their ranges, by default half of the value on either side. The program has a struct
        ``name_params``, ``name_defaults``, and ``name_configure``, which computes the constants
        that depend on them; the state stays. Not for ``"int32"``.
    form : {"table", "step"}, default="table"
        ``"step"``: laws with lookup tables, such as Bouc-Wen, are integrated instead, in at most
        1.5 kB; the header states the deviation of the response from the model's under the drive of
        the test.
    tolerance : float, default=None
        Error that the test allows in floating point, as a fraction of the range of the response; by
        default as below. Single precision is refused where its error is larger. Laws that need
        double precision are written in single precision only if it is given.
    simulink : bool, default=False
        Whether ``name_sfun.c`` is written, too: the program as an S-function of Simulink. Its
        outputs are that of ``name_step`` and the status; parameters are those of the fit.

    Returns
    -------
    list of Path
        Header, source and test program, and the S-function where it is asked for.

    Raises
    ------
    NotImplementedError
        If the output depends on later input.
    TypeError
        If the model cannot be run sample by sample, or has no compiled step in plain arithmetic.
    ValueError
        If the model's law is outside the part of Python that can be written in C, with file and
        line; see :class:`~skhyst.operators.CompiledStep`. If it cannot be written in integers, or
        its numbers have too few digits for fast drives. If the error of single precision in the
        test exceeds the tolerance. If a name in ``tunable`` is no parameter that can be changed, or
        its value changes the structure of the program.

    See Also
    --------
    to_fmu : A functional mock-up unit around the program.
    to_structured_text : A function block for a PLC.
    EmulatedController : Run the program on an emulated controller.

    Notes
    -----
    The tolerance of the test is 1e-12 of the range of the response (zero included) in double and
    1e-6 in single precision, and one unit of output in integers. In floating point it is at least
    twice the change of the Python model's response to a change of the input by half a unit in the
    last place. That is much more where the law jumps, or an inverse meets a flat part of its law.

    Integer arithmetic saturates: nothing overflows, for any input. A number that grows without
    bound, such as a time count, saturates at about 4096 times its largest value in the test.

    Integers have ``exp``, ``log``, ``pow`` of positive numbers, ``sqrt``, ``tanh``, ``sin``,
    ``cos``, ``expm1``, ``log1p`` and whole powers: laws that need other functions are refused by
    name.

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
            "The 'name' parameter of to_c must be letters, digits and underscores, begin with a "
            f"letter, and not be a word that C or C++ uses itself. Got {name!r} instead."
        )
    if dtype not in (*DIALECTS, "int32"):
        raise ValueError(
            f"The 'dtype' parameter of to_c must be one of {sorted((*DIALECTS, 'int32'))}. Got "
            f"{dtype!r} instead."
        )
    texts = program(
        *(model, name, dtype, dt, initial_state, u0, drive, (input_unit, output_unit), tunable),
        *(form, tolerance, simulink),
    )
    return written(folder, texts.files)


@dataclass(frozen=True)
class Program:
    """A program and its parts.

    Parameters
    ----------
    files : dict of str to str
        Texts of header, source and test, by the names of the files.
    dt : float or None
    digest : str
        Of the program.
    n_inputs : int
    by_row : bool
        Whether a step takes an array.
    entries : tuple of Entry
        Parameters that can be changed at run time.
    begins_at : bool
        Whether it has ``name_init_at``, for rest at another input.
    """

    files: dict
    dt: float | None
    digest: str
    n_inputs: int
    by_row: bool
    entries: tuple
    begins_at: bool


def program(
    model,
    name,
    dtype,
    dt,
    initial_state,
    u0,
    drive,
    units,
    tunable,
    form="table",
    tolerance=None,
    simulink=False,
):
    """Return the :class:`Program` that :func:`to_c` writes; parameters are as there."""
    source = Source(model, dtype, dt, initial_state, u0, tunable, form, tolerance)
    if simulink and source.dt is None:
        raise ValueError("The 'dt' parameter of to_c must be given, in s, for Simulink.")
    type_ = DIALECTS[dtype].type if dtype in DIALECTS else "int32_t"
    digest = digest_of(source)
    common = dict.fromkeys(_OPTIONAL, "") | {
        "name": name,
        "what": source.what,
        "dt": "NAN" if source.dt is None else DIALECTS["float64"].literal(source.dt),
        "n_inputs": source.n_inputs,
        "covered": "",
        "one": "" if source.compiled_step.n_inputs else "[0]",
        "input": f"const {type_} *u" if source.by_row else f"{type_} u",
        "preview": source.stepper.preview,
        "needs": "#include <float.h>\n" if dtype == "float64" else "",
        "bits_of_double": _BITS_OF_DOUBLE if dtype == "float64" else "",
        "n_states": max(len(source.compiled_step.state), 1),  # C has no empty arrays
        "digest": digest,
        "one_u": "" if source.by_row else "[0]",
        **_status(name, source.stepper, dtype),
    }
    is_integer = dtype == "int32"
    signals, preview = legend(source.stepper, source.dt, (None, None) if is_integer else units)
    names = [*([f"u[{k}]" for k in range(source.n_inputs)] if source.by_row else ["u"]), "returns"]
    lines = [f"{place}: {signal}" for place, signal in zip(names, signals, strict=True)]
    is_default = drive is None
    if is_integer:
        units = _units(drive, *units)
        # the ranges of numbers are those under this drive, which begins where the device rests
        drive, begins_at = np.append(source.rest, source.inputs(drive), axis=0), False
    else:
        expected = source.tested(drive)
        drive, begins_at = expected.drive, expected.rules is not None
    lines += [*preview, *source.bounds(), *source.deviates(drive)]
    if not begins_at and not is_integer:
        lines += _NO_INIT_AT.format(name).splitlines()
    if is_default and dtype == "float32" and not all(x.is_limited for x in source.stepper.inputs):
        lines += _DEFAULT_DRIVE.splitlines()
    common["legend"] = "\n".join(f"   {line}" for line in lines)
    if is_integer:
        texts = _in_integers(source.stepper, common, drive, units)
    else:
        texts = _in_reals(source, expected, common, dtype)
    if simulink:
        template = Path(__file__).with_name("sfunction.c").read_text(encoding="utf-8")
        types = {"type": type_, "simulink_type": _SIMULINK_TYPES[dtype]}
        texts[f"{name}_sfun.c"] = Template(template).substitute(common | types)
    inputs = source.n_inputs, source.by_row
    return Program(texts, source.dt, digest, *inputs, source.entries, begins_at)


def _range_check(stepper, texts, literal, size, known, eps):
    """Return the parts of the program that detect whether a signal has left the range of the fit.

    Parameters
    ----------
    stepper : Stepper
    texts : list of str
        Each input, and the output.
    literal : callable
        ``literal(k, value, is_high)`` writes an end of the range of signal ``k`` in its unit.
    size : callable
        Returns the name of the function for an absolute value, which is written if it is used.
    known : str
        Condition that ``{}`` is the value of an earlier sample, followed by ``&&``; or ``""``.
    eps : float
        Relative rounding of the numbers of the program.

    Returns
    -------
    condition : str
        Empty if no range is known.
    watched : list of str
        The signals whose last value is needed, since their rate is limited.
    """
    conditions, watched = [], []
    for k, relation, value, place in range_tests(stepper, eps):
        end = literal(k, value, relation == ">")
        if place is None:
            conditions.append(f"{texts[k]} {relation} {end}")
        else:
            last = f"state->last[{place}]"
            moved = f"{size()}({texts[k]} - {last}) {relation} {end}"
            conditions.append(f"({known.format(last)}{moved})" if known else moved)
            watched.append(texts[k])
    return " || ".join(conditions), watched


def _outer_state(type_, condition, watched, unknown, beyond, first_members=("", "")):
    """Return the members of the state outside the model with their first values, and statements.

    ``beyond`` is the condition that the input exceeds the range of the numbers, or empty.
    ``first_members`` is the text of members that precede the others, and of their first values.
    """
    members = [first_members[0], "    uint32_t overrange; /* since the start */\n"]
    first, lines = [first_members[1], ", 0u"], []
    lines += [f"if ({beyond}) {{", "    state->overrange = 1u;", "}"] if beyond else []
    if condition:
        members.append("    uint32_t extrapolated;\n")
        first.append(", 0u")
        lines += ["state->extrapolated = 0u;", f"if ({condition}) {{"]
        lines += ["    state->extrapolated = 1u;", "}"]
    if watched:
        members.append(f"    {type_} last[{len(watched)}]; /* of signals whose rate is known */\n")
        first.append(f", {{{', '.join([unknown] * len(watched))}}}")
        lines += [f"state->last[{k}] = {text};" for k, text in enumerate(watched)]
    return {"members": "".join(members), "members_first": "".join(first)}, lines


def _status(name, stepper, dtype):
    """Return the parts of header and source for the status bits, which are read from the state."""
    is_real = dtype in DIALECTS
    zero = DIALECTS[dtype].literal(0.0) if is_real else "0"
    tests = [(flag, f"state->s[{index}] != {zero}") for flag, index in stepper.compiled_step.flags]
    flags = conditions(stepper, is_real)
    outer = [flag for flag in flags if flag not in dict(tests) or flag == "overrange"]
    tests += [(flag, f"state->{flag} != 0u") for flag in outer]
    bits = {flag: f"{name}_{flag.upper()}" for flag in flags}
    lines = [
        f"    if ({test}) {{\n        status |= {bits[flag]};\n    }}\n" for flag, test in tests
    ]
    return {
        "bits": "".join(
            f"#define {bit} {1 << k}u" + (f" /* {_NOTES[flag]} */" if flag in _NOTES else "") + "\n"
            for k, (flag, bit) in enumerate(bits.items())
        ),
        "conditions": "".join(["    uint32_t status = 0u;\n", *lines, "    return status;\n"]),
    }


def _beyond(inputs, ends):
    """Return the condition that an input is beyond its ends, given as literals or None."""
    tests = [
        f"{u} {relation} {end}"
        for u, *pair in zip(inputs, *ends, strict=True)
        for relation, end in zip("<>", pair, strict=True)
        if end is not None
    ]
    return tests[0] if len(tests) == 1 else " || ".join(f"({test})" for test in tests)


def _units(drive, *units):
    """Return the units of a program in integers; refuse missing ones, and a missing drive."""
    for name, unit in zip(("input_unit", "output_unit"), units, strict=True):
        if not (isinstance(unit, Real) and 0.0 < unit < np.inf):
            raise ValueError(
                f"The {name!r} parameter of to_c must be a number above 0 for 'int32'. Got "
                f"{unit!r} instead."
            )
    if drive is None:
        raise ValueError("The 'drive' parameter of to_c must be given for 'int32'.")
    return units


def digest_of(source):
    """Return the SHA-256 of a program in double precision, without the prefix of its names."""
    # so that programs of one model in other number types, or with another name, have one digest
    dialect = DIALECTS["float64"]
    printer = Printer("", dialect)
    printer.function(source.step)
    tables = (text for _, text in printer.tables.values())
    tuned = [] if source.tuned is None else [_listed(source.tuned.first, dialect.literal)]
    text = (*tables, *printer.texts, _listed(source.stepper.state, dialect.literal), *tuned)
    return hashlib.sha256("\n".join(text).encode()).hexdigest()


def _listed(values, literal):
    """Return the literals of values as a list in C, which cannot be empty."""
    return ", ".join(map(literal, values)) or "0"


def _listed_bits(bits):
    """Return the rows of bits of a status, ten on a line."""
    rows = [f"{{{', '.join(map(str, row))}}}" for row in bits.tolist()]
    lines = (", ".join(rows[k : k + 10]) for k in range(0, len(rows), 10))
    return "".join(f"\n    {line}," for line in lines) + "\n"


def _limits(name, limits, acting, literal, eps):
    """Return the parts of header and test for the limits of the output.

    Parameters
    ----------
    name : str
    limits : tuple of (float, float, float) or None
        Lowest and highest output, and its largest change.
    acting : int or None
        Column of the input from which the change is counted, else from the last output.
    literal : callable
        Writes a number of the type of the output.
    eps : float
        Relative rounding of this type.
    """
    header, test = "", ""
    words = "LOW", "HIGH", "CHANGE"
    last = "last output, of input that was not refused"
    if acting is not None:
        last = f"acting drive u[{acting}] where that is within the limits, else from the {last}"
    notes = "is at least this", "is at most this", f"differs by at most this from the {last}"
    # of a sum and of the difference that is tested
    rounding = f" + {2.0 * eps!r} * (fabs((double)*y) + fabs((double)last))" if eps else ""
    moved = "k > 0 && fabs((double)*y - (double)last)"  # before the first, what acted is unknown
    wrong = "*y < {}", "*y > {}", f"{moved} > (double){{}}{rounding}"
    for word, note, wrong_if, value in zip(words, notes, wrong, limits or (), strict=False):
        if np.isfinite(value):
            macro = f"{name}_{word}"
            header += f"#define {macro} {literal(value)} /* the output {note} */\n"
            if word != "CHANGE" or acting is None:
                test += f"    failed |= {wrong_if.format(macro)};\n"
    unused = "" if "last" in test else "    (void)last;\n    (void)k;\n"
    return {"limits": header, "within": test + unused}


def _texts(common, printer, inputs, outputs):
    """Return the text of header, source and test program, by file name."""
    name, double = common["name"], DIALECTS["float64"]
    common |= {
        "tables": "".join(f"{text}\n" for _, text in printer.tables.values()),
        "functions": _of_avr(printer) + "\n".join(printer.texts),
        "n_samples": len(outputs),
        "inputs": "".join(f"    {{{row}}},\n" for row in inputs),
        "outputs": "".join(f"    {double.literal(y)},\n" for y in outputs),
    }
    return {
        f"{name}.h": _HEADER.substitute(common),
        f"{name}.c": _SOURCE.substitute(common),
        f"{name}_test.c": _TEST.substitute(common),
    }


def _of_avr(printer):
    """Return those functions of a program that the library of AVR lacks, to be compiled there."""
    dialect, texts = printer.dialect, []
    if not isinstance(dialect, Dialect):  # integers have functions of their own
        return ""
    for word, text in _AVR_FUNCTIONS.items():
        if any(re.search(rf"\b{word}{dialect.suffix}\(", function) for function in printer.texts):
            numbers = {"half": dialect.literal(0.5), "one": dialect.literal(1.0)}
            numbers |= {"two": dialect.literal(2.0), "t": dialect.type, "f": dialect.suffix}
            texts.append(Template(text).substitute(numbers))
    return "\n".join(["#ifdef __AVR__", *texts, "#endif", "", ""]) if texts else ""


_ARGS = ("u", "state->s", "state->k")  # of the step of a model


def _reserve(printer):
    """Return a printer that does not give a reserved name to another function."""
    printer.taken |= {f"{printer.prefix}_{name}" for name in _RESERVED}
    return printer


def _in_reals(source, expected, common, dtype):
    """Return the texts of a program in floating point by file name."""
    dialect, step, stepper, tuned = DIALECTS[dtype], source.step, source.stepper, source.tuned
    double = DIALECTS["float64"].literal
    printer = _reserve(Printer(common["name"], dialect))
    call = f"{printer.function(step)}({', '.join(step.args(_ARGS[: len(step.taken)]))})"
    name, last = common["name"], expected.last
    inputs = [f"u[{k}]" for k in range(source.n_inputs)] if source.by_row else ["u"]
    check = _are_finite(inputs)
    condition, watched = _range_check(
        stepper,
        [*inputs, "state->output"],
        lambda k, value, is_high: dialect.literal(value),
        lambda: f"fabs{dialect.suffix}",
        "",
        np.finfo(dialect.number).eps,
    )
    output = (
        f"    {dialect.type} output; /* of the last sample that was not refused */\n"
        "    uint32_t refused;\n",
        f", {dialect.literal(last)}, 0u",
    )
    checked, beyond, range_text = expected.checked, "", ""
    if checked is not None:
        beyond = _beyond(inputs, [[dialect.literal(x) for x in end] for end in checked])
        lines = *expected.precision(), f"Beyond these ends {name}_OVERRANGE is set until a start."
        range_text = "".join(f"\n   {line}" for line in lines)
    nan = dialect.literal(math.nan)
    members, lines = _outer_state(dialect.type, condition, watched, nan, beyond, output)
    lines = [
        f"const {dialect.type} y = {call};",
        *("if (isfinite(y) != 0) {", "    state->output = y;", "} else {"),
        *(f"    {name}_begin_anew(state);", "}", *lines),
    ]
    lines = "".join(f"        {line}\n" for line in lines)
    held = list(enumerate(stepper.compiled_step.held))
    common |= members | {
        "type": dialect.type,
        "inner": dialect.type,
        "guard": _FINITE_MATH,
        "units": "Input and output are in the units of the model's drive and response.",
        "caution": "Input that is not finite is refused: the state stays as it is and the\n"
        f"   output is the last one ({last:.9g} at first), see {name}_REFUSED.{range_text}",
        "first": _listed(stepper.state, dialect.literal),
        "last": dialect.literal(last),
        "body": f"    state->refused = 1u;\n    if ({check}) {{\n        state->refused = 0u;\n"
        f"{lines}    }}\n    return state->output;\n",
        "tolerance": double(expected.tolerance),
        "measure": "the range",
        "span": double(expected.span),
        "refuses": _REFUSES.substitute(common, type=dialect.type),
        "refused": f"    failed |= !{name}_refuses(state, last);\n",
        "bits_of_run": _listed_bits(expected.bits[0]),
        **_limits(
            *(name, expected.limits, source.compiled_step.acting),
            *(dialect.literal, float(np.finfo(dialect.number).eps)),
        ),
    }
    common["within"] += "    failed |= isfinite(*y) == 0;\n"
    responses = ["".join(f"    {double(y)},\n" for y in response) for response in expected.outputs]
    if expected.rules is not None:
        # a jump to another rest is no rate of the drive: the last values are unknown after it
        forgotten = ["state->extrapolated = 0u;"] * bool(condition)
        forgotten += [f"state->last[{k}] = {nan};" for k in range(len(watched))]
        common["forgotten"] = "".join(f"        {line}\n" for line in forgotten)
        values = _rest(source, expected, printer)
        values |= {"outputs": responses[1], "bits_of_run": _listed_bits(expected.bits[1])}
        _add(common, _INIT_AT, **values)
    if tuned is not None:
        common |= configuration(name, source.entries, tuned, dialect, expected.values)
        bits = _listed_bits(expected.bits[-2])
        _add(common, _CONFIGURE, outputs=responses[-1], bits_of_run=bits)
    extremes = "".join(f"    {{{_listed(row, dialect.literal)}}},\n" for row in expected.extremes)
    values = {"extremes": extremes, "n_extremes": len(expected.extremes)}
    _add(common, _EXTREMES, bits_of_run=_listed_bits(expected.bits[-1]), **values)
    common["more_defined"] += _BEGIN_ANEW.substitute(
        common,
        held="".join(f"    const {dialect.type} held_{k} = state->s[{at}];\n" for k, at in held),
        kept="".join(f"    state->s[{at}] = held_{k};\n" for k, at in held),
    )
    inputs = [_listed(row, dialect.literal) for row in expected.drive]
    return _texts(common, printer, inputs, expected.outputs[0])


def _are_finite(inputs):
    """Return the condition that inputs are finite."""
    tests = [f"isfinite({u}) != 0" for u in inputs]
    return tests[0] if len(tests) == 1 else " && ".join(f"({test})" for test in tests)


def _add(common, templates, **values):
    """Append the text of templates to the parts of the program."""
    values = common | values
    texts = {key: template.substitute(values) for key, template in templates.items()}
    for key, text in texts.items():
        common[key] += text


def _rest(source, expected, printer):
    """Return the values of the templates for a start at rest at another input."""
    dialect, by_row = printer.dialect, source.by_row
    rest = model_step(source.compiled_step, tuned=source.tuned, rules=expected.rules)
    low, high = ends = [[dialect.literal(x) for x in end] for end in expected.ends]
    inputs = [f"u[{k}]" for k in range(len(low))] if by_row else ["u"]
    limited = [
        f"{u} < {a} ? {a} : {u} > {b} ? {b} : {u}"
        for u, a, b in zip(inputs, low, high, strict=True)
    ]
    declaration = f"    const {dialect.type} held{f'[{len(low)}]' if by_row else ''} = "
    declaration += f"{{{', '.join(limited)}}};\n" if by_row else f"{limited[0]};\n"
    ranges = ", ".join(f"{a:.6g} to {b:.6g}" for a, b in expected.ends.T)
    arguments = rest.args(("held", *_ARGS[1:])[: len(rest.taken)])
    return {
        "range": f"Beyond {ranges} it is held at these ends,\n"
        f"   and {printer.prefix}_OVERRANGE is set.",
        "beyond": _beyond(inputs, ends),
        "held": declaration if "held" in arguments else "",
        "finite": _are_finite(inputs),
        "call": f"{printer.function(rest)}({', '.join(arguments)})",
        "level": ", ".join(dialect.literal(x) for x in expected.level),
    }


def _in_integers(stepper, common, drive, units):
    """Return the texts of a program in integers by file name."""
    counts = np.round(drive / units[0]).astype(np.int64)
    stepper = whole_limits(stepper, units[1])
    step = model_step(stepper.compiled_step, with_numbers=True)
    # branches that no input within the limits takes would need a fixed point, too
    step = reachable(step, stepper.state, limits(counts)[0] * units[0])
    ranges = Ranges(step, stepper.state, counts * units[0])
    recorded, options = counts, (units, MARGIN, lambda u: answers(stepper, u))
    counts, ends = explore(ranges, recorded, *options)
    check_fast(ranges, recorded, *options)
    printer = _reserve(FixedPrinter(common["name"], Fixed(), ranges=ranges))
    kept, acting = stepper.compiled_step.limits, stepper.compiled_step.acting
    kept = None if kept is None else [x / units[1] for x in kept]
    change = round(kept[2]) if kept and kept[2] < 2**32 and acting is None else None
    body, first = boundary(printer, step, stepper, ends, units, change)
    n_inputs = stepper.compiled_step.n_inputs
    texts = ["u"] if n_inputs is None else [f"u[{k}]" for k in range(n_inputs)]
    condition, watched = _range_check(
        stepper,
        [f"(int64_t){text}" for text in (*texts, "output")],
        lambda k, *end: _count(end[0], units[k == len(texts)], end[1], k < len(texts)),
        lambda: printer.helper("abs", "real"),
        "{} != INT64_MIN && ",
        0.0,
    )
    most = np.array([-(2**31), 2**31 - 1])[:, None]
    literals = [
        [None if full else str(x) for x, full in zip(*pair, strict=True)]
        for pair in zip(ends.tolist(), ends == most, strict=True)
    ]
    beyond = _beyond(texts, literals)
    members, lines = _outer_state("int64_t", condition, watched, "INT64_MIN", beyond)
    if change is not None:
        lines.append("state->output = output;")
        members["members"] += "    int64_t output; /* of the last sample */\n"
        members["members_first"] += ", INT64_MIN"
    body += "".join(f"    {line}\n" for line in (*lines, "return output;"))
    ranges.keep(printer.places)
    taken, known = ranges.branches
    bits = _bits_in_integers(stepper, counts, ends, units)
    missed = ", ".join(f"{n} of {name}" for name, n in sorted(ranges.not_taken.items()))
    common |= (
        _INTEGERS
        | members
        | {
            "units": f"An input of 1 is {units[0]!r} and an output of 1 is {units[1]!r}, in the\n"
            "   units of the model's drive and response.",
            "caution": "Input below {} or above {}, and output beyond 32 bits, are held.\n"
            "   Such input sets {}_OVERRANGE until the next start.".format(
                *(_listed(end, str) for end in ends.tolist()), common["name"]
            ),
            "first": first,
            "body": body,
            "bits_of_run": _listed_bits(bits),
            **_limits(common["name"], kept, acting, _held_count, 0.0),
            "covered": f"; {taken} of {known} branches taken"
            + (f", not {missed}" if missed else ""),
        }
    )
    limited = np.clip(counts, *ends)
    outputs = answers(stepper, limited * units[0]) / units[1]
    outputs = np.clip(outputs, 1 - 2.0**31, 2.0**31 - 1)  # as the program holds them
    return _texts(common, printer, [_listed(row, str) for row in counts], outputs)


def _bits_in_integers(stepper, counts, ends, units):
    """Return the certain bits of the status of a program in integers, see :func:`certain_bits`."""
    names, held = conditions(stepper, False), np.clip(counts, *ends)
    # the output is rounded, and so is its change
    widened = (0.0, 2.0, -2.0) if stepper.watched else (0.0,)
    near = [_ranging(stepper, by * units[1]) for by in widened]
    bits = [certain_bits(other, held * units[0], names, units[0]) for other in near]
    bits, beyond = np.bitwise_and.reduce(bits), (counts != held).any(axis=1)
    overrange, extrapolated = (2 ** names.index(x) if x in names else 0 for x in _OUTER)
    lost = np.logical_or.accumulate(beyond)
    bits[lost] = bits[lost] & ~overrange | (overrange, 0)
    # what is held moves less
    bits[beyond | np.append(False, beyond[:-1])] &= ~extrapolated
    return bits


def _ranging(stepper, by):
    """Return a stepper in the same state, of which the range of the output is larger."""
    signals = {"inputs": stepper.inputs, "result": stepper.result}
    if signals["result"] is not None:
        low, high, rate = (getattr(stepper.result, x) for x in ("low", "high", "rate"))
        rate = rate if stepper.dt is None else max(rate + by / stepper.dt, 0.0)
        signals["result"] = replace(stepper.result, low=low - by, high=high + by, rate=rate)
    other = Stepper(stepper.compiled_step, stepper.dt, **signals)
    other.state = stepper.state
    return other


def _held_count(count):
    """Return the literal of a limit in units of an integer, which saturates."""
    return f"INT32_C({round(min(max(count, 1 - 2.0**31), 2.0**31 - 1))})"


def _count(value, unit, is_high, is_input):
    """Return the literal of an end of a range in units of an integer.

    Integers at the input are exact, so those beyond the end are beyond it; the output is rounded.
    """
    count = (math.floor if is_high == is_input else math.ceil)(value / unit)
    return f"INT64_C({min(max(count, -(2**62)), 2**62)})"
