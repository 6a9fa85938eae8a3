"""Write a model as a C99 program, with a test program."""

import hashlib
import math
import re
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from string import Template

import numpy as np

from .._files import replacing
from .._validation import finite_numbers
from ..operators import Signal, Stepper
from ..records import chosen_interval
from ._fixed import MARGIN, Fixed, FixedPrinter, boundary
from ._interpreter import Interpreter
from ._model import model_step
from ._printer import Dialect, Printer
from ._ranges import Ranges, explore
from ._rest import rest_rules
from ._single import check_single
from ._tunable import configuration, derived, entries_of
from ._values import TAKEN

DIALECTS = {
    "float64": Dialect("double", "", np.float64),
    "float32": Dialect("float", "f", np.float32),
}
_OWN = (  # names of what is not of a model
    *("init", "step", "state", "status", "test", "refuses", "run", "init_at", "params", "defaults"),
    *("configure", "chebyshev"),
)
TOLERANCES = {"float64": 1e-12, "float32": 1e-6}  # as fractions of the response's range
_N_TEST = 200

_HEADER = Template("""\
/* $name: $what, written by skhyst.

   Compile with: cc -std=c99 -c $name.c
   Test with: cc -std=c99 -o ${name}_test ${name}_test.c $name.c -lm && ./${name}_test

$legend
   $units
   One call is one sampling interval. Nothing is allocated and loops are bounded. */
#ifndef ${name}_H
#define ${name}_H

${needs}#include <stdint.h>

${bits_of_double}#ifdef __cplusplus
extern "C" {
#endif

#define ${name}_DT $dt /* sampling interval in s */
#define ${name}_N_INPUTS $n_inputs
#define ${name}_PREVIEW $preview /* samples by which the input comes before its output */
/* SHA-256 of the program in double precision: of its laws, constants and initial state */
#define ${name}_HASH "$digest"

${params}typedef struct {
    $inner s[$n_states];
$kept$tuned} ${name}_state;

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
void ${name}_init(${name}_state *state)
{
    static const ${name}_state first = {{$first}$kept_first$tuned_first};
    *state = first;
}
$more_defined
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

$more_outputs${refuses}/* Run the test after the output y; return whether input was not refused. */
static int ${name}_run(${name}_state *state, const double *outputs, $type y, double *largest)
{
    int k, failed = 0;
    for (k = 0; k < N_SAMPLES; k++) {
$refused        y = ${name}_step(state, ${name}_inputs[k]$one);
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
    failed = ${name}_run(&state, ${name}_outputs, $last, &largest);
$more_runs    printf("$name: %.3g of $measure, %.3g allowed$covered\\n",
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
    **dict.fromkeys(("guard", "refuses", "refused", "needs", "bits_of_double"), ""),
}
_ADDED = (  # by what a program can do besides
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
$held    state->refused = $finite ? 0u : 1u;
    if (state->refused == 0u) {
        state->output = $call;
$forgotten    }
}
"""),
    "more_outputs": Template("""\
static const double ${name}_rest_outputs[N_SAMPLES] = {
$outputs};

"""),
    "more_runs": Template("""\
    ${name}_init_at(&state, $level);
    failed |= ${name}_run(&state, ${name}_rest_outputs, state.output, &largest);
"""),
}
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

"""),
    "more_runs": Template("""\
    {
        static const ${name}_params others = {$others};
        ${name}_params beyond;
        ${name}_init(&state);
        failed |= ${name}_configure(&state, &others);
        failed |= ${name}_run(&state, ${name}_tuned_outputs, $last, &largest);
        ${name}_defaults(&beyond);
        beyond.$one_field = $type_max;
        failed |= !${name}_configure(&state, &beyond);
    }
"""),
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
_BITS_OF_DOUBLE = """\
#if DBL_MANT_DIG < 53
#error "double has fewer than 64 bits here: write the program with dtype float32"
#endif

"""
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
) -> list[Path]:
    """Write a model, compensator, controller or operator as a C99 program, run sample by sample.

    Three files are written: the header ``name.h`` with ``name_state``, ``name_init``, ``name_step``
    and ``name_status``, the source ``name.c``, and the test program ``name_test.c``, which returns
    0 if its responses to a drive agree with those of the Python model. The header says how to
    compile. The status of a sample has a bit for each condition that holds, those named in
    :attr:`~skhyst.operators.Stepper.status`: ``name_LIMITED`` if limits have cut the output of a
    compensator or controller, ``name_UNREACHABLE`` if an inverse has found no drive for its
    reference, ``name_EXTRAPOLATED`` if the drive has left the range or the rate of the fit,
    ``name_REFUSED`` if the input was not finite. The header says what goes in and what comes out,
    with their units where they are given, and the preview of a compensator. C++ can include it.

    ``name_init_at`` puts the device to rest at another input, where the rest of every part is known
    as a function of it: of memories that one step reaches from rest at zero, and of linear parts.

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
        ``"step"``: laws that are looked up in tables, as that of Bouc and Wen, are integrated
        instead, in less than 2 kB; the header says how far the response is from that of the model
        under the drive of the test.
    tolerance : float, default=None
        Error that the test allows in floating point, as a fraction of the range of the response; by
        default as below. Single precision is refused where its error is larger. Laws that need
        double precision are written in single precision only if it is given.

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
        single precision is not sufficient: if its error in the test exceeds the tolerance. If a
        tunable parameter is none, or changes the structure of the program.

    Notes
    -----
    The tolerance of the test is 1e-12 of the range of the response (zero included) in double and
    1e-6 in single precision, and one unit of output in integers. In floating point it is at least
    twice the change of the Python model's response to a change of the input by half a unit in the
    last place. That is much more where the law jumps, or an inverse meets a flat part of its law.

    Integer arithmetic saturates: nothing overflows, for any input. A number that grows without
    bound, such as a count of time, stays at about 4096 times its largest value in the test.

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
            f"The 'name' parameter of to_c must be a name in C that begins with a letter. Got "
            f"{name!r} instead."
        )
    if dtype not in (*DIALECTS, "int32"):
        raise ValueError(
            f"The 'dtype' parameter of to_c must be one of {sorted((*DIALECTS, 'int32'))}. Got "
            f"{dtype!r} instead."
        )
    texts = program(
        *(model, name, dtype, dt, initial_state, u0, drive, (input_unit, output_unit), tunable),
        *(form, tolerance),
    )
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / file for file in texts.files]
    with replacing(*paths) as parts:
        for part, text in zip(parts, texts.files.values(), strict=True):
            part.write_text(text, encoding="utf-8")
    return paths


@dataclass(frozen=True)
class Program:
    """A program, and what is in it.

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
        Whether it can begin at rest at another input.
    """

    files: dict
    dt: float | None
    digest: str
    n_inputs: int
    by_row: bool
    entries: tuple
    begins_at: bool


def program(
    model, name, dtype, dt, initial_state, u0, drive, units, tunable, form="table", tolerance=None
):
    """Return the :class:`Program` that :func:`to_c` writes; parameters are as there."""
    what = type(model).__name__
    if form not in ("table", "step"):
        raise ValueError(
            f"The 'form' parameter of to_c must be 'table' or 'step'. Got {form!r} instead."
        )
    if tolerance is not None and not (isinstance(tolerance, Real) and 0.0 < tolerance < np.inf):
        raise ValueError(
            "The 'tolerance' parameter of to_c must be a number above 0 or None. Got "
            f"{tolerance!r} instead."
        )

    entries = None
    if tunable:
        if dtype == "int32" or hasattr(model, "bound") or isinstance(model, Stepper):
            raise ValueError(
                "The 'tunable' parameter of to_c must be empty for 'int32', whose numbers are "
                "sized by their constants, and for steppers, whose model is not known. Got "
                f"{tunable!r} instead."
            )
        entries, with_values = entries_of(model, tunable)
        model = with_values([entry.value for entry in entries])

    def at_rest(level, model=model):
        stepper, own = _stepper(model, dt, initial_state, level)
        return _compacted(stepper) if form == "step" else stepper, own

    stepper, dt = at_rest(u0)
    compiled_step = stepper.compiled_step
    if compiled_step.double_only and not (dtype == "float64" or (dtype == "float32" and tolerance)):
        raise ValueError(
            f"The 'dtype' parameter of to_c must be 'float64' for {compiled_step.double_only}, or "
            f"'float32' with a 'tolerance'. Got {dtype!r} instead."
        )
    n_inputs = compiled_step.n_inputs or 1
    tuned = None
    if tunable:
        tuned = derived(entries, lambda x: at_rest(u0, with_values(x))[0].compiled_step)
    step, double = model_step(compiled_step, tuned=tuned), DIALECTS["float64"]
    type_ = DIALECTS[dtype].type if dtype in DIALECTS else "int32_t"
    digest = hashlib.sha256(_program(step, stepper.state, tuned).encode()).hexdigest()
    common = dict.fromkeys(_ADDED, "") | {
        "name": name,
        "what": what,
        "dt": "NAN" if dt is None else double.literal(dt),
        "n_inputs": n_inputs,
        "covered": "",
        "one": "" if compiled_step.n_inputs else "[0]",
        "input": f"{type_} u" if compiled_step.n_inputs is None else f"const {type_} *u",
        "preview": stepper.preview,
        "needs": "#include <float.h>\n" if dtype == "float64" else "",
        "bits_of_double": _BITS_OF_DOUBLE if dtype == "float64" else "",
        "n_states": max(len(compiled_step.state), 1),
        "digest": digest,
        **_status(name, stepper, dtype),
    }
    if dtype == "int32":
        units = _units(drive, *units)
        common["legend"] = _legend(stepper, dt, None, None)
        drive = _inputs(drive, n_inputs)
        common["legend"] += _deviation(model, stepper, drive, dt, initial_state, u0, form)
        texts, rules = _in_integers(stepper, common, drive, units), None
    else:
        common["legend"] = _legend(stepper, dt, *units)
        drive = _test_drive(u0, n_inputs) if drive is None else _inputs(drive, n_inputs)
        drive = drive.astype(DIALECTS[dtype].number).astype(float)
        common["legend"] += _deviation(model, stepper, drive, dt, initial_state, u0, form)
        rules = ends = None
        if not isinstance(model, Stepper) and not hasattr(model, "bound"):
            rules, ends = rest_rules(lambda level: at_rest(_level(level, compiled_step))[0], drive)
        runs = [_Run(stepper.copy(), tuned and tuned.first)]
        if rules is not None:
            level = (0.61 * drive.max(axis=0) + 0.39 * drive.min(axis=0)).astype(
                DIALECTS[dtype].number
            )
            runs.append(_Run(at_rest(_level(level.astype(float), compiled_step))[0], runs[0].tuned))
            common |= {"level": level, "ends": ends}
        if tuned is not None:
            low, high = np.transpose([(entry.low, entry.high) for entry in entries])
            values = low + (high - low) * np.where(np.arange(len(low)) % 2, 0.3, 0.7)
            values = values.astype(DIALECTS[dtype].number).astype(float)
            other = Stepper(at_rest(u0, with_values(values))[0].compiled_step)
            other.state = stepper.state
            others, _ = rest_rules(
                lambda level: at_rest(_level(level, compiled_step), with_values(values))[0], drive
            )
            pairs = zip(rules or (), others or (), strict=False)
            if not (rules and others and all(a.agrees(b) for a, b in pairs)):
                rules = None  # the rest depends on the parameters
                del runs[1:]
            runs.append(_Run(other, tuned.at(values)))
            common |= configuration(name, entries, tuned, DIALECTS[dtype], values)
        tolerance = TOLERANCES[dtype] if tolerance is None else float(tolerance)
        texts = _in_reals(step, stepper, common, drive, u0, dtype, runs, tuned, rules, tolerance)
    by_row = compiled_step.n_inputs is not None
    return Program(texts, dt, digest, n_inputs, by_row, entries or (), rules is not None)


@dataclass(frozen=True)
class _Run:
    """A device that the test runs: its stepper, and its constants that can be changed."""

    stepper: Stepper
    tuned: np.ndarray | None

    def answers(self, drive):
        """Return the response (n_samples,) to a drive (n_samples, n_inputs)."""
        return _answers(self.stepper, drive)


def _compacted(stepper):
    """Return a stepper whose laws do without tables, in the same state."""
    step = stepper.compiled_step.compacted()
    if not np.array_equal(stepper.state, stepper.compiled_step.state):
        raise ValueError(
            "The 'form' parameter of to_c must be 'table' for a stepper under way. Got 'step' "
            "instead."
        )
    signals = {"inputs": stepper.inputs, "result": stepper.result, "preview": stepper.preview}
    return Stepper(step, stepper.dt, **signals)


def _deviation(model, stepper, drive, dt, initial_state, u0, form):
    """Return a line for the header: how far a program without tables is from its model."""
    if form == "table":
        return ""
    expected = _answers(_stepper(model, dt, initial_state, u0)[0], drive)
    error = np.abs(_answers(stepper, drive) - expected).max() / (np.ptp([0.0, *expected]) or 1.0)
    return (
        f"\n   Laws are integrated instead of looked up: within {1.05 * error:.1e} of the range\n"
        "   of the model's response under the drive of the test."
    )


def _level(level, compiled_step):
    """Return an input (n_inputs,) as a stepper takes its level of rest."""
    return float(level[0]) if compiled_step.n_inputs is None else level


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


def _legend(stepper, dt, input_unit, output_unit):
    """Return the lines of the header that say what goes in and what comes out."""
    n = stepper.compiled_step.n_inputs
    signals = (*(stepper.inputs or (Signal("input"),) * (n or 1)), stepper.result)
    signals = [*signals[:-1], signals[-1] or Signal("output")]
    listed = isinstance(input_unit, list | tuple)
    named = [*(input_unit if listed else [input_unit] * (n or 1)), output_unit]
    if len(named) != len(signals) or not all(u is None or isinstance(u, str) for u in named):
        raise ValueError(
            "The 'input_unit' and 'output_unit' parameters of to_c must be names of units, of the "
            f"inputs one name or {n or 1}. Got {input_unit!r} and {output_unit!r} instead."
        )
    places = [*(["u"] if n is None else [f"u[{k}]" for k in range(n)]), "returns"]
    lines = []
    for place, unit, signal in zip(places, named, signals, strict=True):
        text = f"   {place}: {signal.name}" + (f" in {unit}" if unit else "")
        if signal.is_limited:
            text += f"; the fit has seen {signal.low:.9g} to {signal.high:.9g}"
            text += f" and {signal.rate:.9g} per s" if np.isfinite(signal.rate) else ""
        lines.append(" ".join(text.replace("*/", "* /").replace("/*", "/ *").split()))
    if stepper.preview:
        seconds = "" if dt is None else f", {stepper.preview * dt:.6g} s,"
        lines.append(
            f"What it returns belongs to the input {stepper.preview} samples{seconds} earlier: give"
        )
        lines.append("the reference early by this preview.")
    return "\n".join(f"   {line}" for line in lines)


def _range_check(stepper, texts, literal, size, known, eps):
    """Return the parts of the program that tell whether a signal has left the range of the fit.

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
        Condition that ``{}`` holds the value of an earlier sample, followed by ``&&``; or ``""``.
    eps : float
        Relative rounding of the numbers of the program.

    Returns
    -------
    condition : str
        Empty if no range is known.
    lasts : list of str
        The signals whose last value is needed.
    """
    conditions, lasts = [], []
    for k, low, high, change in stepper.watched:
        rounding = eps * max(abs(x) for x in (low, high, 0.0) if np.isfinite(x))
        if np.isfinite(low):
            conditions.append(f"{texts[k]} < {literal(k, low - rounding, False)}")
        if np.isfinite(high):
            conditions.append(f"{texts[k]} > {literal(k, high + rounding, True)}")
        if np.isfinite(change):
            last = f"state->last[{len(lasts)}]"
            moved = f"{size()}({texts[k]} - {last}) > {literal(k, change + 2.0 * rounding, True)}"
            conditions.append(f"({known.format(last)}{moved})" if known else moved)
            lasts.append(texts[k])
    return " || ".join(conditions), lasts


def _kept(type_, condition, lasts, unknown, before=("", "")):
    """Return the members of the state outside the model, their first values, and statements."""
    members, first, lines = [before[0]], [before[1]], []
    if condition:
        members.append("    uint32_t extrapolated;\n")
        first.append(", 0u")
        lines.append(f"state->extrapolated = ({condition}) ? 1u : 0u;")
    if lasts:
        members.append(f"    {type_} last[{len(lasts)}]; /* of signals whose rate is known */\n")
        first.append(f", {{{', '.join([unknown] * len(lasts))}}}")
        lines += [f"state->last[{k}] = {text};" for k, text in enumerate(lasts)]
    return {"kept": "".join(members), "kept_first": "".join(first)}, lines


def _status(name, stepper, dtype):
    """Return the parts of header and source for the status bits, which are read from the state."""
    zero = DIALECTS[dtype].literal(0.0) if dtype in DIALECTS else "0"
    places = [(flag, f"s[{at}] != {zero}") for flag, at in stepper.compiled_step.flags]
    places += [("refused", "refused != 0u")] * (dtype in DIALECTS)
    places += [("extrapolated", "extrapolated != 0u")] * bool(stepper.watched)
    bits = {flag: f"{name}_{flag.upper()}" for flag, _ in places}
    lines = [
        f"    if (state->{holds}) {{\n        status |= {bits[flag]};\n    }}\n"
        for flag, holds in places
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


def _program(step, state, tuned):
    """Return the program in double precision without the prefix of its names, for the hash."""
    dialect = DIALECTS["float64"]
    printer = Printer("", dialect)
    printer.function(step)
    tables = (text for _, text in printer.tables.values())
    tuned = [] if tuned is None else [_listed(tuned.first, dialect.literal)]
    return "\n".join((*tables, *printer.texts, _listed(state, dialect.literal), *tuned))


def _listed(values, literal):
    return ", ".join(map(literal, values)) or "0"


def _answers(stepper, drive):
    """Return the response (n_samples,) of the Python model to a drive (n_samples, n_inputs)."""
    device, row = stepper.copy(), stepper.compiled_step.n_inputs
    return np.array([device.step(u if row else u[0]) for u in drive])


def _texts(common, printer, inputs, outputs):
    """Return the text of header, source and test program, by file name."""
    name, double = common["name"], DIALECTS["float64"]
    common |= {
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


_ARGS = ("u", "state->s", "state->k")  # of the step of a model


def _reserve(printer):
    printer.taken |= {f"{printer.prefix}_{own}" for own in _OWN}
    return printer


def _in_reals(step, stepper, common, drive, u0, dtype, runs, tuned, rules, tolerance):
    dialect = DIALECTS[dtype]
    printer = _reserve(Printer(common["name"], dialect))
    call = f"{printer.function(step)}({', '.join(step.args(_ARGS[: len(step.taken)]))})"
    outputs = [run.answers(drive) for run in runs]
    span = np.ptp([0.0, *np.ravel(outputs)]) or 1.0
    # change of the response under rounding errors of the input: alternating, and of one sign
    rounding = 0.5 * np.finfo(dialect.number).eps * (1.0 - 2.0 * (np.arange(len(drive)) % 2))
    moved = max(
        np.abs(run.answers(drive * (1.0 + each[:, None])) - own).max()
        for run, own in zip(runs, outputs, strict=True)
        for each in (rounding, -rounding, abs(rounding), -abs(rounding))
    )
    if tuned is not None:  # and under those of the constants, which the program computes
        alternating = 1.0 - 2.0 * (np.arange(len(tuned.first)) % 2)
        for sign in (alternating, -alternating):
            off = runs[-1].tuned * (1.0 + 2.0 * np.finfo(dialect.number).eps * sign)
            device = Interpreter(step, stepper.state, off)
            moved = max(moved, np.abs([device.answer(u) for u in drive] - outputs[-1]).max())
    tolerance = max(tolerance, 2.0 * moved / span)
    if dtype == "float32":
        for run, own in zip(runs, outputs, strict=True):
            given = drive, own, span, tolerance, () if run.tuned is None else run.tuned
            check_single(step, run.stepper.state, *given)
    name, n_inputs = common["name"], common["n_inputs"]
    last = stepper.output
    last = _answers(stepper, _at(u0, 1, n_inputs))[0] if last is None else last
    inputs = ["u"] if common["one"] else [f"u[{k}]" for k in range(n_inputs)]
    check = " && ".join(f"isfinite({u})" for u in inputs)
    condition, lasts = _range_check(
        stepper,
        [*inputs, "state->output"],
        lambda k, value, is_high: dialect.literal(value),
        lambda: f"fabs{dialect.suffix}",
        "",
        np.finfo(dialect.number).eps,
    )
    own = (
        f"    {dialect.type} output; /* of the last sample that was not refused */\n"
        "    uint32_t refused;\n",
        f", {dialect.literal(last)}, 0u",
    )
    kept, lines = _kept(dialect.type, condition, lasts, dialect.literal(math.nan), own)
    lines = "".join(f"        {line}\n" for line in (f"state->output = {call};", *lines))
    common |= kept | {
        "type": dialect.type,
        "inner": dialect.type,
        "guard": _FINITE_MATH,
        "units": "Input and output are in the units of the model's drive and response.",
        "caution": "Input that is not finite is refused: the state stays as it is and the\n"
        f"   output is the last one ({last:.9g} at first), see {name}_REFUSED.",
        "first": _listed(stepper.state, dialect.literal),
        "last": dialect.literal(last),
        "body": f"    state->refused = {check} ? 0u : 1u;\n    if (state->refused == 0u) {{\n"
        f"{lines}    }}\n    return state->output;\n",
        "tolerance": DIALECTS["float64"].literal(tolerance),
        "measure": "the range",
        "span": DIALECTS["float64"].literal(span),
        "refuses": _REFUSES.substitute(common, type=dialect.type),
        "refused": f"        failed |= !{name}_refuses(state, y);\n",
    }
    lists = ["".join(f"    {DIALECTS['float64'].literal(y)},\n" for y in own) for own in outputs]
    if rules is not None:
        forgotten = ["state->extrapolated = 0u;"] * bool(condition)
        forgotten += [f"state->last[{k}] = {dialect.literal(math.nan)};" for k in range(len(lasts))]
        common["forgotten"] = "".join(f"        {line}\n" for line in forgotten)
        _add(common, _INIT_AT, outputs=lists[1], **_rest(stepper, common, printer, rules, tuned))
    if tuned is not None:
        _add(common, _CONFIGURE, outputs=lists[-1])
    return _texts(common, printer, [_listed(row, dialect.literal) for row in drive], outputs[0])


def _add(common, templates, **more):
    """Append what templates make to the parts of the program."""
    made = {key: template.substitute(common, **more) for key, template in templates.items()}
    for key, text in made.items():
        common[key] += text


def _rest(stepper, common, printer, rules, tuned):
    """Return what the templates take to begin at rest at another input."""
    dialect, row = printer.dialect, not common["one"]
    rest = model_step(stepper.compiled_step, tuned=tuned, rules=rules)
    low, high = ([dialect.literal(x) for x in end] for end in common["ends"])
    given = [f"u[{k}]" for k in range(len(low))] if row else ["u"]
    holds = [
        f"{u} < {a} ? {a} : {u} > {b} ? {b} : {u}" for u, a, b in zip(given, low, high, strict=True)
    ]
    held = f"    const {dialect.type} held{f'[{len(low)}]' if row else ''} = "
    held += f"{{{', '.join(holds)}}};\n" if row else f"{holds[0]};\n"
    level = [dialect.literal(x) for x in common["level"]]
    kind = f"(const {dialect.type}[])"
    ranges = ", ".join(f"{a:.6g} to {b:.6g}" for a, b in common["ends"].T)
    arguments = rest.args(("held", *_ARGS[1:])[: len(rest.taken)])
    return {
        "range": f"Beyond {ranges} it is held at these ends.",
        "held": held if "held" in arguments else "",
        "finite": " && ".join(f"isfinite({u})" for u in given),
        "call": f"{printer.function(rest)}({', '.join(arguments)})",
        "level": f"{kind}{{{', '.join(level)}}}" if row else level[0],
    }


def _in_integers(stepper, common, drive, units):
    step = model_step(stepper.compiled_step, with_numbers=True)
    counts = np.round(drive / units[0]).astype(np.int64)
    ranges = Ranges(step, stepper.state, counts * units[0])
    counts, ends = explore(ranges, counts, units, MARGIN, lambda u: _answers(stepper, u))
    printer = _reserve(FixedPrinter(common["name"], Fixed(), ranges=ranges))
    body, first = boundary(printer, step, stepper, ends, units)
    n_inputs = stepper.compiled_step.n_inputs
    texts = ["u"] if n_inputs is None else [f"u[{k}]" for k in range(n_inputs)]
    condition, lasts = _range_check(
        stepper,
        [f"(int64_t){text}" for text in (*texts, "output")],
        lambda k, *end: _count(end[0], units[k == len(texts)], end[1], k < len(texts)),
        lambda: printer.helper("abs", "real"),
        "{} != INT64_MIN && ",
        0.0,
    )
    kept, lines = _kept("int64_t", condition, lasts, "INT64_MIN")
    body += "".join(f"    {line}\n" for line in (*lines, "return output;"))
    taken, there_are = ranges.branches
    missed = ", ".join(f"{n} of {name}" for name, n in sorted(ranges.passed_by.items()))
    common |= (
        _INTEGERS
        | kept
        | {
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
    )
    outputs = _answers(stepper, np.clip(counts, *ends) * units[0]) / units[1]
    outputs = np.clip(outputs, 1 - 2.0**31, 2.0**31 - 1)
    return _texts(common, printer, [_listed(row, str) for row in counts], outputs)


def _count(value, unit, is_high, is_input):
    """Return the literal of an end of a range in units of an integer.

    Integers at the input are exact, so those beyond the end are beyond it; the output is rounded.
    """
    count = (math.floor if is_high == is_input else math.ceil)(value / unit)
    return f"INT64_C({min(max(count, -(2**62)), 2**62)})"


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
