"""The exported C answers as Python does."""

import math
import re
import shutil
import subprocess

import numpy as np
import pytest
from c_programs import FLAGS
from operator_cases import DT, OPERATORS, make_drive

from skhyst.control import FeedforwardPI
from skhyst.exceptions import DivergenceWarning
from skhyst.export import to_c
from skhyst.hysteresis import (
    BacklashOperator,
    BoucWenOperator,
    JilesAthertonOperator,
    PrandtlIshlinskiiOperator,
    TanhHysteresisOperator,
)
from skhyst.linear import FirstOrderLag
from skhyst.operators import CompiledColumn, CompiledLaw, CompiledSeries, Stepper
from skhyst.operators._compiled_step import CompiledProduct
from skhyst.operators._composition import factor_step
from skhyst.static import SoftSaturationOperator

BARS = {"float64": 1e-12, "float32": 1e-6, "int32": 1.0}  # of the range; units of output
NEEDS_COMPILER = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")


def compiled(folder, *sources):
    """Compile to a program and return what happened when it ran."""
    subprocess.run(["cc", *FLAGS, *sources, "-o", "program", "-lm"], cwd=folder, check=True)
    return subprocess.run("./program", cwd=folder, capture_output=True, text=True)


def parted(line):
    """Return the name and what is said of it."""
    name, _, told = line.partition(": ")
    return name, told


def answers_of_all(folder, names):
    """Run the test programs of models as one, and return what it said."""
    lines = []
    for name in names:
        lines += [f"#define main {name}_main", f'#include "{name}.c"', f'#include "{name}_test.c"']
        lines += ["#undef main"]
    calls = "".join(f"    failed += {name}_main();\n" for name in names)
    lines += [f"int main(void)\n{{\n    int failed = 0;\n{calls}    return failed;\n}}\n"]
    (folder / "all.c").write_text("\n".join(lines))
    done = compiled(folder, "all.c")
    return done.returncode, done.stdout.splitlines(), done.stderr


# a phase loses digits with time, a stop 300 times stiffer than the spring in each contact
TOLERANCES = {"sinusoid": 1e-5, "upper end stop": 2e-6}


@NEEDS_COMPILER
@pytest.mark.parametrize(
    "dtype",
    [
        "float64",
        pytest.param("float32", marks=pytest.mark.slow),
        pytest.param("int32", marks=pytest.mark.slow),
    ],
)
def test_every_operator_answers_as_in_python(tmp_path, dtype):
    u, written = make_drive(), {}
    for k, (case, operator) in enumerate(OPERATORS.items()):
        options = {}
        if dtype == "int32":
            span = np.ptp(operator.run(u, DT, operator.init(u[0]))[0]) or 1.0
            options = {"input_unit": 2.0**-20, "output_unit": 2.0**-20 * span}
        if dtype == "float32" and case in TOLERANCES:
            options = {"tolerance": TOLERANCES[case]}
        options |= {"dt": DT, "u0": u[0], "drive": u}
        try:
            step = operator.compiled_step(DT, operator.init(u[0]))
            if step.double_only and dtype != "float64":
                with pytest.raises(ValueError, match=r"must be 'float64' for "):
                    to_c(operator, tmp_path, f"c{k}", dtype, **options)
                continue
            to_c(operator, tmp_path, f"c{k}", dtype, **options)
        except NotImplementedError:
            continue
        written[f"c{k}"] = case
    _, lines, errors = answers_of_all(tmp_path, written)
    found = {written[name]: float(told.split()[0]) for name, told in map(parted, lines)}
    assert len(found) == len(written)
    bars = dict.fromkeys(found, BARS[dtype])
    if dtype == "float32":
        bars |= {"upper end stop": TOLERANCES["upper end stop"]}
    assert {case: error for case, error in found.items() if not error <= bars[case]} == {}
    assert not errors


TABLE = np.array([[1, -2, 3], [4, 5, -6]])
PLAIN = (0.5, 0.25, 3.0)


def helper(x, n):
    """Return several things."""
    if n < 0:
        return n, (x, -x), x > 0.0
    return n // 2 - n % 3, (x**2, x**3), 0.0 < x <= 1.0


def total(a, k):
    """Return the sum of a column of an array."""
    y = 0
    for i in range(a.shape[0]):
        y += a[i, k]
    return y


def shift(u, s):
    """Write to the state."""
    for k in range(s.size - 1, 0, -1):
        s[k] = s[k - 1]
    s[0] = u


def everything(u, c, s):
    """Use what there is to be used."""
    table, (gain, offset) = c[0], c[1:3]
    shift(u, s)
    n = int(10.0 * u) - 3
    whole, pair, inside = helper(u, n)
    a, b = pair
    a, b = b, a
    count = k = 0
    while count < 20:
        count += 1
        if count % 2:
            continue
        k += count
        if k > abs(n) and not inside:
            break
    scale = 1 if inside else 2.5
    for j in range(2):
        _, (a, _), _ = helper(a, -j)
        scale = scale + table[j, -1] * PLAIN[j]
    s[1] += math.copysign(0.1, u)
    y = gain * a + offset * b + whole + total(TABLE, 1) + min(k, n, 7) + max(u, -0.5)
    return (
        y * scale + (math.floor(u) - math.ceil(b)) + math.fabs(s[2]) ** 1.5 + -(2**-n if n else 1)
    )


def sum_of_row(u, c, s):
    """Read an input of several columns."""
    return c[0] * u[0] + u[1]


def sum_of_row_and_last(u, c, s):
    """Add the row to the sum of the last one."""
    y = u[0] + u[1] + s[0]
    s[0] = u[0] + u[1]
    return y


for function in (helper, total, shift, everything, sum_of_row, sum_of_row_and_last):
    function.py_func = function


@NEEDS_COMPILER
def test_whatever_the_language_has(tmp_path):
    table = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])
    own = CompiledLaw(everything, (table, 0.3, 0.7), (0.1, 0.2, 0.3))
    to_c(own, tmp_path, "own", drive=np.linspace(-1.3, 1.7, 40))
    factor = CompiledLaw(factor_step, ([0.3, -0.1], 0.1, 1.0, 1.0), ())
    parts = CompiledColumn((own,), 1, 0.2), CompiledColumn((factor,), 2, 0.0)
    to_c(CompiledProduct(parts), tmp_path, "columns")
    rows = CompiledLaw(sum_of_row, (2.0,), ())
    object.__setattr__(rows, "n_inputs", 2)
    to_c(rows, tmp_path, "rows")
    units = {"input_unit": 1e-4, "output_unit": 1e-4, "drive": np.ones((3, 2))}
    to_c(rows, tmp_path, "row_counts", "int32", **units)
    code, lines, errors = answers_of_all(tmp_path, ("own", "columns", "rows", "row_counts"))
    assert code == 0, (lines, errors)


@pytest.mark.skipif(shutil.which("cppcheck") is None, reason="there is no cppcheck")
def test_no_required_rule_of_misra_is_broken(tmp_path):
    """What is not kept are the advisory rules of the header."""
    own = CompiledLaw(everything, (np.array([[0.1, 0.2, 0.3]] * 2), 0.3, 0.7), (0.1, 0.2, 0.3))
    header, *_ = to_c(own, tmp_path, "own", drive=np.linspace(-1.3, 1.7, 40))
    backlash = BacklashOperator(0.2)
    to_c(backlash, tmp_path, "single", "float32", dt=1.0, tunable=["half_gap"])
    units = {"input_unit": 1e-3, "output_unit": 1e-3, "drive": [0.0, 1.0]}
    to_c(backlash, tmp_path, "whole", "int32", dt=1.0, **units)
    command = ["cppcheck", "--std=c99", "--addon=misra", "-q", "own.c", "single.c", "whole.c"]
    said = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True).stderr
    found = set(re.findall(r"misra-c2012-([\d.]+)", said))
    kept = re.search(r"the advisory rules ([^*]+) are not kept", header.read_text())[1]
    assert {"15.5"} <= found <= {*re.findall(r"\d+\.\d+", kept)}


@NEEDS_COMPILER
def test_models_are_linked_and_what_is_wrong_is_found(tmp_path):
    to_c(PrandtlIshlinskiiOperator([0.0, 0.3], [1.0, 0.5]), tmp_path, "register_1", dt=1.0)
    _, _, test = to_c(BacklashOperator(0.2), tmp_path, "gear", dt=1.0)
    (tmp_path / "main.c").write_text("""
#include "gear.h"
#include "register_1.h"
int main(void)
{
    gear_state gear;
    register_1_state plays;
    gear_init(&gear);
    register_1_init(&plays);
    return gear_step(&gear, 1.0) == 0.8 && register_1_step(&plays, 1.0) == 1.35 ? 0 : 2;
}
""")
    assert compiled(tmp_path, "main.c", "gear.c", "register_1.c").returncode == 0
    text = test.read_text()
    start = text.index("_outputs[N_SAMPLES] = {\n") + len("_outputs[N_SAMPLES] = {\n")
    test.write_text(text[:start] + "    1e-9 +" + text[start:].lstrip(" "))
    assert compiled(tmp_path, "gear.c", "gear_test.c").returncode == 1


@NEEDS_COMPILER
@pytest.mark.skipif(shutil.which("g++") is None, reason="there is no C++ compiler")
@pytest.mark.parametrize("dtype", ["float64", "float32", "int32"])
def test_a_program_is_called_from_c_plus_plus(tmp_path, dtype):
    """Compiled as C and linked to C++, and compiled as C++ itself, without a warning."""
    more = {"input_unit": 0.25, "output_unit": 0.25, "drive": [0.0, 1.0]}
    more = more if dtype == "int32" else {}
    to_c(BacklashOperator(0.25), tmp_path, "gear", dtype, dt=1.0, **more)
    (tmp_path / "main.cpp").write_text("""
#include "gear.h"
int main()
{
    gear_state gear;
    gear_init(&gear);
    return gear_step(&gear, 4) == GEAR ? 0 : 2;
}
""")
    answer = {"float64": "3.75", "float32": "3.75f", "int32": "3"}
    strict = ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wdouble-promotion", "-Werror"]
    cpp = ["g++", "-std=c++17", *strict, f"-DGEAR={answer[dtype]}"]
    subprocess.run(["cc", "-std=c99", *strict, "-c", "gear.c"], cwd=tmp_path, check=True)
    for source in (["gear.o"], ["-x", "c++", "gear.c", "-x", "none"]):
        command = [*cpp, "main.cpp", *source, "-o", "program", "-lm"]
        subprocess.run(command, cwd=tmp_path, check=True)
        assert subprocess.run(tmp_path / "program").returncode == 0


@NEEDS_COMPILER
def test_a_double_of_32_bits_is_refused_by_the_compiler(tmp_path):
    """As that of the small AVR controllers is; single precision compiles there."""
    small = ["-U__DBL_MANT_DIG__", "-D__DBL_MANT_DIG__=24", "-Wno-builtin-macro-redefined"]
    for dtype, refused in (("float64", True), ("float32", False)):
        to_c(BacklashOperator(0.2), tmp_path, "gear", dtype, dt=1.0)
        command = ["cc", *small, "-c", "gear.c"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
        assert ("double has fewer than 64 bits" in done.stderr) == refused == bool(done.returncode)


@NEEDS_COMPILER
@pytest.mark.parametrize(
    ("dtype", "real", "most"), [("float64", "double", "DBL_MAX"), ("float32", "float", "FLT_MAX")]
)
def test_input_that_is_not_finite_is_refused(tmp_path, dtype, real, most):
    """The state stays, the output is the last one, the status says so, as that of Python does.

    Where finite input leads beyond floating point the output is the last one, too, and the state
    the first one again.
    """
    rows = CompiledLaw(sum_of_row_and_last, (), (0.5,), n_inputs=2)
    to_c(rows, tmp_path, "rows", dtype, u0=(1.0, 2.0))
    (tmp_path / "main.c").write_text(f"""
#include <float.h>
#include <math.h>
#include <stdio.h>
#include "rows.h"
int main(void)
{{
    static const {real} u[9][2] = {{
        {{NAN, 0.0f}}, {{4.0f, 8.0f}}, {{0.0f, NAN}}, {{INFINITY, 1.0f}}, {{1.0f, -INFINITY}},
        {{NAN, NAN}}, {{1.0f, 1.0f}}, {{{most}, {most}}},
        {{2.0f, 2.0f}}
    }};
    rows_state state;
    int k;
    rows_init(&state);
    for (k = 0; k < 9; k++) {{
        const double y = rows_step(&state, u[k]);
        const uint32_t status = rows_status(&state);
        printf("%g %d\\n", y, status == rows_REFUSED ? 1 : status == rows_OVERRANGE ? 2 : 0);
    }}
    return 0;
}}
""")
    found = compiled(tmp_path, "main.c", "rows.c").stdout.split()
    # at rest 1 + 2 + 0.5; then 4 + 8 + 0.5, four times refused, 1 + 1 + (4 + 8), and 2 + 2 + 0.5
    assert found[::2] == ["3.5", *5 * ["12.5"], "14", "14", "4.5"]
    assert found[1::2] == ["1", "0", "1", "1", "1", "1", "0", "2", "2"]
    stepper = Stepper(rows)
    for row in ([np.nan, 0.0], [1.0, np.inf]):
        with pytest.raises(ValueError, match="must be finite"):
            stepper.step(row)
        assert (stepper.status, stepper.state.tolist()) == ({"refused"}, [0.5])
    assert stepper.output is None
    assert (stepper.step([4.0, 8.0]), stepper.status) == (12.5, set())
    with pytest.raises(ValueError, match="must be finite"):
        stepper.run([[1.0, 1.0], [1.0, np.nan]])
    other = stepper.copy()
    assert (other.status, other.output) == (stepper.status, stepper.output) == ({"refused"}, 12.5)
    header, *_ = to_c(stepper, tmp_path, "later", dtype)  # a program goes on from there
    assert "(12.5 at first)" in header.read_text()
    assert (stepper.run([[1.0, 1.0]])[0], stepper.status, stepper.output) == (14.0, set(), 14.0)
    other = stepper.copy()
    beyond = [[1e308, 1e308], [2.0, 2.0]]
    with np.errstate(over="ignore"):
        found = [(stepper.step(row), stepper.status) for row in beyond]
        with pytest.warns(DivergenceWarning, match="began anew"):
            assert other.run(beyond).tolist() == [14.0, 4.5]
    assert found == [(14.0, {"overrange"}), (4.5, {"overrange"})]
    assert other.status == {"overrange"}
    other.state = [0.5]
    assert other.status == set()
    with np.errstate(over="ignore"):
        assert math.isnan(other.step(beyond[0]))  # no output to hold


@NEEDS_COMPILER
def test_the_test_program_sees_what_is_not_refused(tmp_path):
    _, source, _ = to_c(BacklashOperator(0.2), tmp_path, "gear", dt=1.0)
    text = source.read_text()
    assert compiled(tmp_path, "gear.c", "gear_test.c").returncode == 0
    for broken in ("true", "!isnan(u)", "(isfinite(u) || u < 0.0)"):
        source.write_text(text.replace("isfinite(u) != 0", broken))
        assert compiled(tmp_path, "gear.c", "gear_test.c").returncode == 1
    command = ["cc", "-ffast-math", "-c", "gear.c"]
    source.write_text(text)
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert "isfinite is needed" in done.stderr


@NEEDS_COMPILER
@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_a_law_without_tables_is_small_and_close(tmp_path, dtype):
    """The deviation is at most that which the header states, and known from the closed form."""
    wires = BoucWenOperator(0.4, 0.7, 0.31, 1.0, 1.0, 0.0, 0.1)  # r = n = 1: exponential branches
    u = make_drive()
    options = {"dt": DT, "drive": u}
    header, source, _ = to_c(wires, tmp_path, "wires", dtype, form="step", **options)
    stated = float(re.search(r"within (\S+) of the range", header.read_text())[1])
    assert stated < 1e-7
    z, last, branch = 0.0, 0.0, []
    for value in u:  # dz/du = 1 - z sgn(u') / D
        d = np.sign(value - last)
        z = d * 0.31 - (d * 0.31 - z) * np.exp(-abs(value - last) / 0.31)
        branch.append(0.4 * value + 0.7 * z + 0.1)
        last = value
    closed = Stepper(wires.compiled_step(DT, wires.init(0.0)).compacted()).run(u)
    np.testing.assert_allclose(closed, branch, rtol=0.0, atol=stated * np.ptp([0.0, *branch]))
    done = compiled(tmp_path, "wires.c", "wires_test.c")
    assert done.returncode == 0, (done.stdout, done.stderr)
    subprocess.run(["cc", "-Os", "-c", "wires.c"], cwd=tmp_path, check=True)
    told = subprocess.run(["size", "wires.o"], cwd=tmp_path, capture_output=True, text=True).stdout
    assert 300 < sum(map(int, told.splitlines()[1].split()[:2])) <= 1500
    table = to_c(wires, tmp_path, "table", dtype, **options)[1]
    assert len(table.read_text()) > 5 * len(source.read_text())


def test_a_tolerance_is_as_asked(tmp_path):
    law = of_weights
    law.py_func = law
    step = CompiledLaw(law, (), ())
    with pytest.raises(ValueError, match=r"1.0e-06 is allowed"):
        to_c(step, tmp_path, "single", "float32")
    test = to_c(step, tmp_path, "single", "float32", tolerance=0.01)[2].read_text()
    assert "return largest <= 0.01 *" in test
    for tolerance in (0.0, "small", np.nan):
        with pytest.raises(ValueError, match="'tolerance' parameter of to_c"):
            to_c(step, tmp_path, "single", tolerance=tolerance)
    with pytest.raises(ValueError, match="'form' parameter of to_c"):
        to_c(step, tmp_path, "single", form="small")


def test_derivatives_are_left_out_and_the_hash_is_that_of_the_numbers(tmp_path):
    def written(operator, name, dtype="float64"):
        header, source, _ = to_c(operator, tmp_path, name, dtype, dt=0.1)
        lines = header.read_text().splitlines()
        return source.read_text(), next(line.split()[2] for line in lines if "_HASH" in line)

    magnet = JilesAthertonOperator(1.3, 0.11, 0.15, 0.6, 0.2, 0.3, 0.1)
    text, _ = written(magnet, "magnet")
    assert "slope" in text
    assert not any(word in text for word in ("by_", "bend", "s_1", "_L2"))
    bound = "At most 10000 turns of a loop per call of 'jiles_atherton_step'."
    assert bound in (tmp_path / "magnet.h").read_text()
    _, one = written(TanhHysteresisOperator(0.3, -0.002, 0.4, 2.3, 0.1), "one")
    _, same = written(TanhHysteresisOperator(0.3, -0.002, 0.4, 2.3, 0.1), "same", "float32")
    _, other = written(TanhHysteresisOperator(0.3, -0.002, 0.4, 2.3, 0.2), "other")
    assert one == same != other


def test_a_fitted_model_has_the_interval_of_its_records(tmp_path):
    u = np.sin(np.arange(200.0))
    model = FirstOrderLag(dt=0.01).fit(
        u[:, None], np.convolve(u, 0.1 * 0.9 ** np.arange(200))[:200]
    )
    header, *_ = to_c(model, tmp_path / "new", "stage")
    assert "#define stage_DT 0.01 " in header.read_text()


def of_numpy(u, c, s):
    """Call what C does not have."""
    return np.sin(u)


def of_strings(u, c, s):
    """Use what is no number."""
    x = "a"
    return x


def of_handlers(u, c, s):
    """Use exceptions."""
    try:
        return u
    finally:
        s[0] = u


def of_lists(u, c, s):
    """Loop over something else."""
    for x in (1.0, 2.0):
        u += x
    return u


def of_shapes(u, c, s):
    """Return several shapes."""
    if u > 0.0:
        return u, u
    return u


def of_constants(u, c, s):
    """Write to what is constant."""
    PLAIN[0] = u
    return u


def of_later(u, c, s):
    """Use the variable of a loop behind it."""
    for k in range(3):
        u += k
    return u + k


def of_itself(u, c, s):
    """Call itself."""
    return of_itself(u, c, s)


def of_remainders(u, c, s):
    """Take a remainder that is not whole."""
    return u % 2.0


def of_places(u, c, s):
    """Read what is not there."""
    return s[3]


@pytest.mark.parametrize(
    ("law", "line", "what"),
    [
        (of_numpy, 2, "'sin'"),
        (of_strings, 2, "'Constant'"),
        (of_handlers, 2, "'Try'"),
        (of_lists, 2, "a loop other than"),
        (of_shapes, 4, "several shapes"),
        (of_constants, 2, "an assignment to"),
        (of_later, 4, "'k', which has no value"),
        (of_itself, 2, "calls itself"),
        (of_remainders, 2, "not integers"),
        (of_places, 2, "index 3 of 1"),
    ],
)
def test_what_cannot_be_written_is_named_with_its_line(tmp_path, law, line, what):
    law.py_func = law
    with pytest.raises(ValueError, match=what) as error:
        to_c(CompiledLaw(law, (), (0.0,)), tmp_path, "law")
    place = f"{__file__}:{law.__code__.co_firstlineno + line}:"
    assert place in str(error.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"name": "2nd"}, "'name' parameter"),
        ({"name": "tanh"}, "not be a word that C or C\\+\\+ uses itself. Got 'tanh'"),
        ({"dtype": "int8"}, "'dtype' parameter"),
        ({"dt": None}, "'dt' parameter"),
        ({"dtype": "int32"}, "'input_unit' parameter"),
        ({"dtype": "int32", "input_unit": 1.0, "output_unit": 1.0}, "'drive' parameter"),
    ],
)
def test_options_are_checked(tmp_path, options, message):
    with pytest.raises(ValueError, match=message):
        to_c(BacklashOperator(0.2), tmp_path, **{"name": "gear", "dt": 1.0} | options)


def test_what_cannot_be_stepped_is_refused(tmp_path):
    with pytest.raises(TypeError, match="'model' parameter of to_c"):
        to_c("gear", tmp_path, "gear", dt=1.0)


def test_a_drive_has_the_columns_of_the_program(tmp_path):
    drive = np.arange(12.0).reshape(4, 3)
    rows = CompiledLaw(sum_of_row, (2.0,), ())
    object.__setattr__(rows, "n_inputs", 2)
    texts = [to_c(rows, tmp_path, "rows", drive=u)[2].read_text() for u in (drive, drive[:, :2])]
    assert texts[0] == texts[1]  # X has columns that a model does not read
    with pytest.raises(ValueError, match=r"2 columns\. Got 1"):
        to_c(rows, tmp_path, "rows", drive=drive[:, 0])


def of_chaos(u, c, s):
    """Double a rounding each sample, whatever the drive."""
    s[0] = 3.99 * s[0] * (1.0 - s[0])
    return u + s[0]


def of_weights(u, c, s):
    """Cancel."""
    return (u + 1e4) - 1e4


def of_memory(u, c, s):
    """Forget."""
    s[0] = 0.9 * s[0] + 0.1 * u
    return s[0]


@pytest.mark.parametrize("law", [of_chaos, of_weights])
def test_what_single_precision_cannot_hold_is_named(tmp_path, law):
    law.py_func, of_memory.py_func = law, of_memory
    bad, good = (CompiledLaw(own, (), (0.3,)) for own in (law, of_memory))
    series = CompiledSeries((good, bad, good))
    to_c(series, tmp_path, "twice")
    with pytest.raises(ValueError, match=rf"cannot hold '{law.__name__}'.* of the range"):
        to_c(series, tmp_path, "single", "float32")
    to_c(good, tmp_path, "single", "float32")


def test_a_knee_has_no_infinite_number_at_its_centre(tmp_path):
    knee, options, unit = (
        SoftSaturationOperator(0.4),
        {"dt": DT, "drive": [-1.0, 0.0, 1.0]},
        2.0**-18,
    )
    to_c(knee, tmp_path, "knee", "float32", **options)
    to_c(knee, tmp_path, "knee", "int32", input_unit=unit, output_unit=unit, **options)


def of_jumps(u, c, s):
    """Cancel where the input jumps."""
    change = 1e4 * abs(u - s[0])
    s[0] = u
    return (u + change) - change


def test_jumps_that_single_precision_cannot_hold_are_refused(tmp_path):
    slow = np.linspace(0.0, 1.0, 2000)
    law = CompiledLaw(of_jumps, (), (0.0,))
    of_jumps.py_func = of_jumps
    with pytest.raises(ValueError, match="cannot hold the response to jumps within the range"):
        to_c(law, tmp_path, "law", "float32", drive=slow)
    to_c(law, tmp_path, "law", "float32", drive=slow, tolerance=1e-2)


def of_turns(u, c, s):
    """Turn as often as the input is large."""
    y = u
    for _ in range(int(min(abs(u), 1e3))):
        y = 0.5 * (y + u)
    return y


@pytest.mark.parametrize(("most", "end"), [(1e6, 256), (1e3, 1)])
def test_far_inputs_that_take_long_are_not_tried(tmp_path, monkeypatch, most, end):
    monkeypatch.setattr("skhyst.export._single.MAX_OPERATIONS", most)
    of_turns.py_func = of_turns
    options = {"dt": DT, "drive": [-1.0, 0.0, 1.0]}
    header, *_ = to_c(CompiledLaw(of_turns, (), ()), tmp_path, "law", "float32", **options)
    assert re.search(rf"from -{end} to {end}\.\n.* the largest error was 0.0e", header.read_text())


@pytest.mark.parametrize("dtype", ["float32", "int32"])
def test_what_needs_double_precision_says_so(tmp_path, dtype):
    compiled_step, _ = OPERATORS["friction stage"].inverse().ahead(DT, 0.0)
    with pytest.raises(ValueError, match="'float64' for the inverse of FrictionStageOperator"):
        to_c(CompiledSeries((compiled_step,)), tmp_path, "law", dtype)


def test_what_needs_double_precision_is_single_with_a_tolerance(tmp_path):
    operator, u = OPERATORS["free mass"], make_drive()
    with pytest.raises(ValueError, match="cannot hold 'free_mass_step'"):
        to_c(operator, tmp_path, "law", "float32", dt=DT, drive=u, tolerance=1e-9)
    to_c(operator, tmp_path, "law", "float32", dt=DT, drive=u, tolerance=1e-4)


def of_angles(u, c, s):
    """Call what integers do not have."""
    return math.atan(u)


def of_branches(u, c, s):
    """Lead to a place that the drive does not reach."""
    if u < 9.0:
        return u
    x = 1.0 - u / 3.0
    return x * x


def of_secrets(u, c, s):
    """Lead to a place of which nothing can be known from elsewhere, and which no drive reaches."""
    if u * u < u - 1.0:  # which intervals do not tell to be false for any number
        u = math.log(u - 95.0)
        x = u - 1.0
        return x * x
    return u


def of_large(u, c, s):
    """Cancel, far beyond the digits of integers."""
    return (u + 1e13) - 1e13


def of_infinity(u, c, s):
    """Compute with what is no number."""
    s[0] = math.inf
    return u / s[0]


@pytest.mark.parametrize(
    ("law", "message"),
    [
        (of_angles, "'atan' in 'of_angles'"),
        (of_secrets, "lead through all branches of 'of_secrets'"),
        (of_large, r"cannot hold the response to fast drives: .* by 7\.\d* units"),
        (of_infinity, "'of_infinity' computes with an infinite number"),
    ],
)
def test_integers_name_what_they_do_not_have(tmp_path, law, message):
    law.py_func = law
    units = {"input_unit": 1e-3, "output_unit": 1e-3, "drive": [0.0, 1.0]}
    with pytest.raises(ValueError, match=message):
        to_c(CompiledLaw(law, (), (0.0,)), tmp_path, "x", "int32", **units)


@NEEDS_COMPILER
def test_integers_are_ready_for_a_branch_that_the_drive_passes_by(tmp_path):
    of_branches.py_func = of_branches
    units = {"input_unit": 1e-3, "output_unit": 1e-3, "drive": [0.0, 1.0]}
    to_c(CompiledLaw(of_branches, (), ()), tmp_path, "law", "int32", **units)
    (tmp_path / "main.c").write_text("""
#include "law.h"
int main(void)
{
    law_state state;
    law_init(&state);
    return law_step(&state, 500) == 500 && law_step(&state, 12000) == 9000 ? 0 : 1;
}
""")
    assert compiled(tmp_path, "main.c", "law.c").returncode == 0


_SIMSTRUC = """
#include <stdint.h>
#include <string.h>
typedef double real_T;
typedef int int_T;
typedef uint32_t uint32_T;
typedef struct { int parameters, width, type, through; double dt; real_T work[2][64];
                 void *u; void *y[2]; } SimStruct;
enum { SS_DOUBLE, SS_SINGLE, SS_INT32, SS_UINT32 };
#define SS_OPTION_EXCEPTION_FREE_CODE 0
#define ssSetNumSFcnParams(S, n) ((S)->parameters = (n))
#define ssGetNumSFcnParams(S) ((S)->parameters)
#define ssGetSFcnParamsCount(S) 0
#define ssSetNumInputPorts(S, n) ((S) && (n) == 1)
#define ssSetNumOutputPorts(S, n) ((S) && (n) == 2)
#define ssSetInputPortWidth(S, k, n) ((S)->width = (n))
#define ssSetInputPortDataType(S, k, t) ((S)->type = (t))
#define ssSetInputPortRequiredContiguous(S, k, n) ((void)(S))
#define ssSetInputPortDirectFeedThrough(S, k, n) ((S)->through = (n))
#define ssSetOutputPortWidth(S, k, n) ((void)(S))
#define ssSetOutputPortDataType(S, k, t) ((void)(S))
#define ssSetNumDWork(S, n) ((void)(S))
#define ssSetDWorkWidth(S, k, n) ((void)((n) <= 64 ? (S) : 0))
#define ssSetDWorkDataType(S, k, t) ((void)(S))
#define ssSetNumSampleTimes(S, n) ((void)(S))
#define ssSetOptions(S, n) ((void)(S))
#define ssSetSampleTime(S, k, t) ((S)->dt = (t))
#define ssSetOffsetTime(S, k, t) ((void)(S))
#define ssGetDWork(S, k) ((void *)(S)->work[k])
#define ssGetInputPortSignal(S, k) ((S)->u)
#define ssGetOutputPortSignal(S, k) ((S)->y[k])
"""
_SIMULATION = """
#include <stdio.h>
int main(void)
{
    static SimStruct S;
    double u[2], y;
    uint32_T bits;
    S.u = u;
    S.y[0] = &y;
    S.y[1] = &bits;
    mdlInitializeSizes(&S);
    mdlInitializeSampleTimes(&S);
    mdlInitializeConditions(&S);
    printf("%d %d %g\\n", S.width, S.through, S.dt);
    while (scanf("%lf %lf", u, u + 1) == 2) {
        u[0] += 0.3;
        mdlOutputs(&S, 0); /* of a trial input, in an algebraic loop */
        u[0] -= 0.3;
        mdlOutputs(&S, 0);
        mdlUpdate(&S, 0);
        printf("%.17g %u\\n", y, bits);
    }
    mdlTerminate(&S);
    return 0;
}
"""


@NEEDS_COMPILER
def test_an_s_function_answers_as_python(tmp_path):
    """With the functions that Simulink would call; trial inputs leave no trace."""
    loop = FeedforwardPI(0.1, 20.0, kd=1e-4, filter_time=2e-3, drive_limits=(-0.1, 0.2))
    *_, path = to_c(loop, tmp_path, "loop", dt=1e-3, simulink=True)
    (tmp_path / "simstruc.h").write_text(_SIMSTRUC)
    (tmp_path / "cg_sfun.h").write_text(_SIMULATION)
    rows = np.random.default_rng(0).normal(size=(30, 2)).round(3)
    flags = [*FLAGS, "-fsanitize=address,undefined", path.name, "loop.c", "-o", "program", "-lm"]
    subprocess.run(["cc", *flags], cwd=tmp_path, check=True)
    given = "\n".join(f"{r} {y}" for r, y in rows)
    done = subprocess.run("./program", cwd=tmp_path, input=given, capture_output=True, text=True)
    assert done.stderr == ""
    sizes, *lines = done.stdout.splitlines()
    assert sizes.split() == ["2", "1", "0.001"]
    stepper = loop.stepper(1e-3)
    for row, (y, bits) in zip(rows, map(str.split, lines), strict=True):
        assert float(y) == pytest.approx(stepper.step(row), abs=1e-14)
        assert (int(bits) != 0) == bool(stepper.status)
    with pytest.raises(ValueError, match="'dt' parameter of to_c must be given"):
        to_c(loop.stepper(1e-3).compiled_step, tmp_path, "x", simulink=True)
