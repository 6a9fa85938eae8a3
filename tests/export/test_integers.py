"""Programs in integers are right for every drive within their range, and saturate beyond it."""

import math
import re
import shutil
import subprocess

import numpy as np
import pytest
from c_programs import FLAGS

from skhyst.export import to_c
from skhyst.export._fixed import Fixed, FixedPrinter
from skhyst.fluid import TankChainOperator
from skhyst.hysteresis import BacklashOperator, DahlOperator, SlewLimitOperator
from skhyst.linear import SecondOrderModeOperator
from skhyst.operators import CompiledLaw, Stepper

NEEDS_COMPILER = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")
MOST = 2**62


def ran(folder, main, values, *sources):
    """Compile a program that reads numbers, and return those that it prints."""
    (folder / "main.c").write_text(main)
    command = ["cc", *FLAGS, "main.c", *sources, "-o", "program", "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    text = "\n".join(" ".join(map(str, row)) for row in values)
    done = subprocess.run("./program", cwd=folder, input=text, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return [int(word) for word in done.stdout.split()]


def answers(folder, name, counts):
    """Return what a program answers to a drive in counts."""
    main = f"""
#include <inttypes.h>
#include <stdio.h>
#include "{name}.h"
int main(void)
{{
    {name}_state state;
    int32_t u;
    {name}_init(&state);
    while (scanf("%" SCNd32, &u) == 1) {{
        printf("%" PRId32 "\\n", {name}_step(&state, u));
    }}
    return 0;
}}
"""
    return np.array(ran(folder, main, counts[:, None], f"{name}.c"))


def held(x):
    """Return an integer, or the nearest that a number can be."""
    return max(-MOST, min(x, MOST))


def rounded(x, n):
    """Return x / 2^n, rounded; halves away from zero."""
    size = (abs(x) + (2 ** (n - 1) if n else 0)) >> n
    return size if x >= 0 else -size


def quotient(a, b, n):
    """Return a 2^n / b towards zero."""
    size = (abs(a) << n) // abs(b) if b else MOST
    return size if (a < 0) == (b < 0) else -size


EXACT = {  # how it is called, what it is, and the largest shift
    "sum": ("a, b", lambda a, b, n: a + b, 0),
    "product": ("a, b, n", lambda a, b, n: rounded(a * b, n), 126),
    "ratio": ("a, b, n", quotient, 126),
    "shift": ("a, n", lambda a, b, n: rounded(a, n), 126),
    "floor": ("a, n", lambda a, b, n: a >> n, 62),
    "to_int32": ("a", lambda a, b, n: max(1 - 2**31, min(a, 2**31 - 1)), 0),
    "rescaled": ("a, 0, n", lambda a, b, n: a << n, 126),
}


@NEEDS_COMPILER
def test_arithmetic_is_exact_or_saturates(tmp_path):
    rng = np.random.default_rng(0)
    printer, rows, expected, cases = FixedPrinter("x", Fixed()), [], [], ""
    ends = [0, 1, 2, 3, MOST - 1, MOST, 2**61, 2**61 - 1, 2**31, 2**31 - 1, 2**32 - 1]
    drawn = [int(rng.integers(MOST)) >> int(rng.integers(62)) for _ in range(40)]
    numbers = [sign * x for x in ends + drawn for sign in (1, -1)]
    for k, (op, (args, exact, most)) in enumerate(EXACT.items()):
        call = f"{printer.helper(op, 'real')}({args})"
        cases += f"        case {k}: y = {call}; break;\n"
        least = 1 if op == "shift" else 0
        for a in numbers:
            for b in rng.choice(numbers, 8):
                n = int(rng.integers(least, most + 1)) if most else 0
                n = rng.choice([n, least, most])
                rows.append((k, a, b, n))
                expected.append(held(exact(a, int(b), int(n))))
    main = f"""
#include <inttypes.h>
#include <stdio.h>
{"".join(printer.texts)}
int main(void)
{{
    int k;
    int32_t n;
    int64_t a, b, y;
    while (scanf("%d %" SCNd64 " %" SCNd64 " %" SCNd32, &k, &a, &b, &n) == 4) {{
        switch (k) {{
{cases}        default: return 1;
        }}
        printf("%" PRId64 "\\n", y);
    }}
    return 0;
}}
"""
    assert ran(tmp_path, main, rows) == expected


@NEEDS_COMPILER
@pytest.mark.parametrize("scale", [1.0, 1e7])
def test_a_slew_limit_is_right_for_a_drive_faster_than_that_of_the_fit(tmp_path, scale):
    """Its drive is followed, so that neither a lead nor a fast change is seen in it."""
    counts = 5000
    unit = scale / counts
    u = scale * np.sin(np.linspace(0.0, 2 * np.pi, 300))
    limit = SlewLimitOperator(37.0 * scale)
    to_c(limit, tmp_path, "amplifier", "int32", dt=1e-3, drive=u, input_unit=unit, output_unit=unit)
    rng = np.random.default_rng(1)
    fast = np.concatenate([rng.integers(-counts, counts + 1, 200), np.tile([counts, -counts], 40)])
    fast = np.concatenate([fast, np.repeat([counts, -counts, 0], 60)])
    expected = limit.run(unit * fast, 1e-3, limit.init(0.0))[0] / unit
    assert np.ptp(expected) > counts
    assert abs(answers(tmp_path, "amplifier", fast) - expected).max() < 1.0


@NEEDS_COMPILER
@pytest.mark.parametrize(
    "operator",
    [
        SlewLimitOperator(30.0),
        BacklashOperator(0.2),
        SecondOrderModeOperator(200.0, 0.1),
        DahlOperator(1e11, 1e11),  # far below sliding
        # the drive of the test fills it, only a larger one makes it overflow
        TankChainOperator([0.11, 0.23], [0.5, 0.7], [1.07, 1.13], [0.7], drive_offset=-0.37),
    ],
)
def test_whatever_comes_is_held(tmp_path, operator):
    u = np.sin(np.linspace(0.0, 6.0, 100))
    to_c(operator, tmp_path, "x", "int32", dt=1e-3, drive=u, input_unit=1e-3, output_unit=1e-3)
    wild = np.random.default_rng(2).integers(-(2**31), 2**31, 400)
    wild[100:200] = np.tile([2**31 - 1, -(2**31)], 50)
    wild[200:300] = np.repeat([2**31 - 1, -(2**31)], 50)
    expected = operator.run(1e-3 * np.clip(wild, -16000, 16000), 1e-3, operator.init(0.0))[0]
    assert abs(answers(tmp_path, "x", wild) - 1e3 * expected).max() < 1.0


@NEEDS_COMPILER
def test_output_beyond_32_bits_is_held(tmp_path):
    mode = SecondOrderModeOperator(200.0, 0.1)
    u = np.sin(np.linspace(0.0, 6.0, 100))
    to_c(mode, tmp_path, "x", "int32", dt=1e-3, drive=u, input_unit=1e-3, output_unit=1e-9)
    wild = np.repeat([2**31 - 1, -(2**31)], 100)
    found = answers(tmp_path, "x", wild)
    assert (found[60], found[160]) == (2**31 - 1, 1 - 2**31)


def of_counters(u, c, s):
    """Count in integers, without an end."""
    n = math.floor(u * 1e9 + 0.5)
    n = n * 7 + n
    return float(n - 3)


@NEEDS_COMPILER
def test_integers_of_a_law_are_held(tmp_path):
    of_counters.py_func = of_counters
    law = CompiledLaw(of_counters, (), ())
    to_c(law, tmp_path, "x", "int32", drive=[0.0, 1e-8], input_unit=1e-9, output_unit=1.0)
    assert answers(tmp_path, "x", np.array([0, 10, -10, 160])).tolist() == [-3, 77, -83, 1277]
    to_c(law, tmp_path, "x", "int32", drive=[0.0, 1.0], input_unit=1e-3, output_unit=1.0)
    most = 2**31 - 1
    assert answers(tmp_path, "x", np.array([1000, -1000])).tolist() == [most - 3, -most]


def of_powers(u, c, s):
    """Take powers of numbers of both signs; zero is between constants that are next to it."""
    zero = 1.0 if abs(u) < 1e-100 and u > -1e-100 else 0.0
    return c[0] * u**3 - (c[1] * u) ** 5 + (c[2] * u) ** 7 + u**1 + u**0 + zero


@NEEDS_COMPILER
@pytest.mark.parametrize("scale", [1.0, 1e3, 1e-3])
def test_whole_powers_are_products(tmp_path, scale):
    of_powers.py_func = of_powers
    law = CompiledLaw(of_powers, (0.3 / scale**2, 0.5 / scale, 0.3 / scale), ())
    unit, u = scale * 1e-4, 2.0 * scale * np.sin(np.linspace(0.0, 6.0, 100))
    options = {"input_unit": unit, "output_unit": max(unit, 1e-4)}
    to_c(law, tmp_path, "x", "int32", drive=u, **options)
    counts = np.append(0, np.random.default_rng(0).integers(-20000, 20001, 200))
    expected = [of_powers(unit * count, law.constants, None) for count in counts]
    expected = np.array(expected) / options["output_unit"]
    assert abs(answers(tmp_path, "x", counts) - expected).max() < 1.0


def inputs(test):
    """Return the input of a test program, and what it says of branches."""
    text = test.read_text()
    rows = text.partition("_inputs[N_SAMPLES]")[2].partition("};")[0]
    rows = [int(x) for x in re.findall(r"\{(-?\d+)\}", rows)]
    return np.array(rows), re.search(r"; (\d+) of (\d+) branches taken(.*?)\\n", text).groups()


def test_the_test_takes_every_branch(tmp_path):
    """A slow drive keeps to one branch; what follows it jumps, rests and leaves the range."""
    u = np.sin(np.linspace(0.0, 6.0, 100))
    units = {"input_unit": 1e-3, "output_unit": 1e-3}
    *_, test = to_c(SlewLimitOperator(70.0), tmp_path, "x", "int32", dt=1e-3, drive=u, **units)
    counts, (taken, there_are, missed) = inputs(test)
    assert taken == there_are == "8"
    assert not missed
    assert (counts.min(), counts.max()) == (-(2**31), 2**31 - 1)
    assert abs(np.diff(counts[100:])).max() > 2000
    assert (np.diff(counts[100:]) == 0).any()


def of_ends(u, c, s):
    """Lead to a place beyond the input's limits, and to one that only arithmetic excludes."""
    if u != u:
        return 0.0
    if u > 100.0:
        return 1.0
    if u * u - u * u > 0.5:
        return 2.0
    if not abs(u + 1.0) < math.inf:  # arithmetic saturates
        return 3.0
    return u if u > 0.5 else 0.5


def test_branches_that_are_not_taken_are_told(tmp_path):
    """Those that no input within its limits reaches are not written."""
    of_ends.py_func = of_ends
    options = {"drive": [0.7, 1.0], "input_unit": 1e-3, "output_unit": 1e-3}
    _, source, test = to_c(Stepper(CompiledLaw(of_ends, (), ())), tmp_path, "x", "int32", **options)
    assert inputs(test)[1] == ("3", "4", ", not 1 of of_ends")
    assert len(re.findall(r"\bif \(", source.read_text().split("of_ends(")[1])) == 1


def of_marks(u, c, s):
    """Count up to three, with a mark that stands, a level that is never below zero, and a loop."""
    level = max(s[0] + u, 0.0)
    s[0] = level if level < 2.0 else 2.0
    if s[1] > 0.0:
        for k in range(3):
            if k > 2 or level < -1e-9:
                return -1.0
            u += 0.5 if s[0] > 3.0 else 0.25
        return u
    s[1] = 1.0
    return 0.0


@NEEDS_COMPILER
def test_what_a_state_never_is_leads_nowhere(tmp_path):
    """What is left out is what the state excludes: with another first state it is there."""
    of_marks.py_func = of_marks
    for mark, branches in ((1.0, "2"), (0.0, "4")):
        law = Stepper(CompiledLaw(of_marks, (), (0.0, mark)))
        options = {"drive": [0.7, -1.0], "input_unit": 1e-3, "output_unit": 1e-3}
        *_, test = to_c(law, tmp_path, "x", "int32", **options)
        assert inputs(test)[1] == (branches, branches, "")
        counts = np.random.default_rng(3).integers(-16000, 16000, 50)
        expected = [1e3 * law.step(1e-3 * count) for count in counts]
        assert abs(answers(tmp_path, "x", counts) - expected).max() < 1.0
