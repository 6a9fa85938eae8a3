"""Writes a model as C99, with a test program."""

import hashlib
import re
from pathlib import Path
from string import Template

import numpy as np
from sklearn.utils.validation import check_is_fitted

from ..operators import Stepper
from ._model import model_step
from ._printer import Dialect, Printer
from ._values import TAKEN

DIALECTS = {
    "float64": Dialect("double", "", np.float64),
    "float32": Dialect("float", "f", np.float32),
}
TOLERANCES = {"float64": 1e-12, "float32": 1e-6}  # of the response's range
_N_TEST = 200

_HEADER = Template("""\
/* $name: $what, written by skhyst.

   Compile with: cc -std=c99 -c $name.c
   Test with: cc -std=c99 -o ${name}_test ${name}_test.c $name.c -lm && ./${name}_test

   Input and output are in the units of the model's drive and response. One call is one sampling
   interval. Nothing is allocated, loops are bounded, and a state belongs to who holds it. */
#ifndef ${name}_H
#define ${name}_H

#define ${name}_DT $dt /* sampling interval in s */
#define ${name}_N_INPUTS $n_inputs
/* SHA-256 of the program in double precision: of laws, constants and first state */
#define ${name}_HASH "$digest"

typedef struct {
    $type s[$n_states];
} ${name}_state;

/* The state before the first sample. */
void ${name}_init(${name}_state *state);

/* One sample. Returns NAN, and leaves the state as it is, if the input is not finite. */
$type ${name}_step(${name}_state *state, $input);

#endif
""")
_SOURCE = Template("""\
#include <math.h>
#include <stdbool.h>
#include <stdint.h>

#include "$name.h"

$tables$functions
void ${name}_init(${name}_state *state)
{
    static const ${name}_state first = {$first};
    *state = first;
}

$type ${name}_step(${name}_state *state, $input)
{
$unused$check    return $call;
}
""")
_TEST = Template("""\
/* Test of $name.c: returns 0 where it answers as the Python model did. */
#include <math.h>
#include <stdio.h>

#include "$name.h"

#define N_SAMPLES $n_samples

static const $type ${name}_inputs[N_SAMPLES][$n_inputs] = {
$inputs};

static const double ${name}_outputs[N_SAMPLES] = {
$outputs};

int main(void)
{
    ${name}_state state;
    double largest = 0.0;
    int k;
    ${name}_init(&state);
    for (k = 0; k < N_SAMPLES; k++) {
        const $type y = ${name}_step(&state, $argument);
        const double error = fabs((double)y - ${name}_outputs[k]);
        largest = error <= largest ? largest : error;
    }
    printf("$name: %.3g of the range, %.3g allowed\\n", largest / $span, $tolerance);
    return largest <= $tolerance * $span ? 0 : 1;
}
#undef N_SAMPLES
""")


def to_c(
    model,
    folder,
    name,
    dtype="float64",
    *,
    dt=None,
    initial_state="rest",
    u0=0.0,
    drive=None,
):
    """Write a model as a C99 program, which answers sample by sample as the model does.

    Three files are made: the header ``name.h`` with ``name_state``, ``name_init`` and
    ``name_step``, the source ``name.c``, and the test program ``name_test.c``, which returns 0
    where the answers to a drive are those of the model in Python. How to compile is said in the
    header.

    Parameters
    ----------
    model : estimator, Operator or Lowered
        A fitted model, or what it is made of.
    folder : str or Path
        Made where it is missing.
    name : str
        Of the files, and how all names in C begin: letters, digits and underscores.
    dtype : {"float64", "float32"}, default="float64"
        Type of input, output, state and arithmetic: ``double`` or ``float``.
    dt : float, optional
        Sampling interval in s; that of the records of the fit by default. Needed for an operator.
    initial_state : {"rest", "zero"}, default="rest"
        State before the first sample.
    u0 : float or array-like of shape (n_inputs,), default=0.0
        Input at which the device rests, in units of the drive.
    drive : array-like of shape (n_samples,) or (n_samples, n_inputs), optional
        Input of the test program, units of the drive. By default two sines that decay, of
        amplitude one about ``u0``.

    Returns
    -------
    list of Path
        Header, source and test program.

    Raises
    ------
    NotImplementedError
        If the model's output depends on later input.
    ValueError
        If the model's law is outside the part of Python that can be written in C, with file and
        line; see :class:`~skhyst.operators.Lowered`.

    Notes
    -----
    The test allows 1e-12 of the range of the response (zero included) in double and 1e-6 in single
    precision.

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
    if dtype not in DIALECTS:
        raise ValueError(
            f"The 'dtype' parameter of to_c must be one of {sorted(DIALECTS)}. Got {dtype!r} "
            "instead."
        )
    what, lowered, dt = _lowered(model, dt, initial_state, u0)
    step, dialect = model_step(lowered), DIALECTS[dtype]
    common = {
        "name": name,
        "what": what,
        "dt": "NAN" if dt is None else Dialect("double", "", np.float64).literal(dt),
        "n_inputs": lowered.n_inputs or 1,
        "type": dialect.type,
        "input": f"const {dialect.type} *u" if lowered.n_inputs else f"{dialect.type} u",
        "n_states": max(len(lowered.state), 1),
        "digest": hashlib.sha256(_program(step, lowered, DIALECTS["float64"]).encode()).hexdigest(),
    }
    texts = {
        f"{name}.h": _HEADER.substitute(common),
        f"{name}.c": _source(step, lowered, dialect, common),
        f"{name}_test.c": _test(lowered, dialect, common, TOLERANCES[dtype], u0, drive),
    }
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    for file, text in texts.items():
        (folder / file).write_text(text)
    return [folder / file for file in texts]


def _lowered(model, dt, initial_state, u0):
    """Return a model's name, its step and the sampling interval."""
    what = type(model).__name__
    if hasattr(model, "bound"):
        return what, model, dt
    operator = model
    if hasattr(model, "fit"):
        check_is_fitted(model, "operator_")
        operator, dt = model.operator_, model.records_[0].dt if dt is None else dt
    if dt is None:
        raise ValueError("The 'dt' parameter of to_c must be given, in s, for an operator.")
    return what, operator.lowered(dt, operator.init(u0, initial_state)), dt


def _program(step, lowered, dialect):
    """Return all that is computed, whatever its name is."""
    printer = Printer("", dialect)
    printer.function(step)
    tables = (text for _, text in printer.tables.values())
    return "\n".join((*tables, *printer.texts, _listed(lowered.state, dialect)))


def _listed(values, dialect):
    return ", ".join(map(dialect.literal, values)) or "0"


def _source(step, lowered, dialect, common):
    printer = Printer(common["name"], dialect)
    printer.taken |= {f"{printer.prefix}_{own}" for own in ("init", "step", "state")}
    model = printer.function(step)
    unused = zip(("u", "state"), step.taken, strict=True)
    check = "!isfinite(u)"
    if lowered.n_inputs:
        check = " || ".join(f"!isfinite(u[{k}])" for k in range(lowered.n_inputs))
    return _SOURCE.substitute(
        common,
        tables="".join(f"{text}\n" for _, text in printer.tables.values()),
        functions="\n".join(printer.texts),
        first=f"{{{_listed(lowered.state, dialect)}}}",
        unused="".join(f"    (void){arg};\n" for arg, used in unused if not used and arg != "u"),
        check=f"    if ({check}) {{\n        return NAN;\n    }}\n",
        call=f"{model}({', '.join(step.args(['u', 'state->s']))})",
    )


def _test(lowered, dialect, common, tolerance, u0, drive):
    drive = _test_drive(u0, lowered.n_inputs or 1) if drive is None else drive
    drive = np.asarray(drive, dtype=dialect.number).astype(float).reshape(len(drive), -1)
    stepper = Stepper(lowered)
    outputs = np.array([stepper.step(u if lowered.n_inputs else u[0]) for u in drive])
    span = max(outputs.max(), 0.0) - min(outputs.min(), 0.0)
    double = DIALECTS["float64"]
    return _TEST.substitute(
        common,
        n_samples=len(drive),
        inputs="".join(f"    {{{_listed(row, dialect)}}},\n" for row in drive),
        outputs="".join(f"    {double.literal(y)},\n" for y in outputs),
        argument=f"{common['name']}_inputs[k]{'' if lowered.n_inputs else '[0]'}",
        span=double.literal(span or 1.0),
        tolerance=tolerance,
    )


def _test_drive(u0, n_inputs):
    """Return a drive that turns at many levels, and leaves ``u0`` smoothly."""
    part = np.arange(_N_TEST) / _N_TEST
    swing = np.sin(2 * np.pi * 5 * part) * (1.0 - part) + 0.3 * np.sin(2 * np.pi * 17 * part)
    return np.zeros(n_inputs) + u0 + swing[:, None] / 1.3
