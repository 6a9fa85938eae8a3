"""Compensators and whatever else is stepped are exported as models are."""

import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from c_programs import FLAGS, error_of
from operator_cases import DT, OPERATORS, make_drive
from sklearn.base import clone

from skhyst.control import FeedforwardPI, InverseCompensator
from skhyst.control._drive_limits import DriveLimits
from skhyst.exceptions import DivergenceWarning
from skhyst.export import to_c
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import Gain, SecondOrderMode, SecondOrderModeOperator
from skhyst.operators import CompiledLaw, CompiledSeries, Stepper, inverse_of
from skhyst.static import SaturationOperator

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")
# one of each way to invert: in closed form, by the root of a step, and of a composition
INVERTED = [
    *("plays", "Dahl friction", "Duhem", "held"),
    *(pytest.param(own, marks=pytest.mark.slow) for own in ("curve", "creep, logarithmic", "sum")),
]
BARS = {"float64": 1e-12, "float32": 1e-6, "int32": 1.0}  # of the range; units of output


@pytest.mark.parametrize("case", INVERTED)
def test_inverses_answer_as_in_python(tmp_path, case):
    operator, u = OPERATORS[case], make_drive()
    if case == "curve":  # where a curve folds, rounding decides whether it has an inverse
        operator = replace(operator, coefficients=np.array([0.1, -0.05, 0.02]))
    y, _ = operator.run(u, DT, operator.init(u[0]))
    inverse = inverse_of(operator)
    for dtype, bar in BARS.items():
        units = {"input_unit": 2.0**-20 * np.ptp(y), "output_unit": 2.0**-20 * np.ptp(u)}
        more = units if dtype == "int32" else {}
        to_c(inverse, tmp_path, dtype, dtype, dt=DT, u0=y[0], drive=y, **more)
        assert error_of(tmp_path, dtype) <= bar


def fitted():
    u = make_drive()[:, None]
    y = OPERATORS["plays"].run(u[:, 0], DT)[0]
    thresholds = np.array([0.0, 0.21, 0.43])
    model = PrandtlIshlinskii(thresholds=thresholds, dt=DT).fit(u, y)
    return InverseCompensator(model, drive_limits=(-0.1, 0.6)).fit(u, y), y


def test_a_fast_inverse_keeps_its_digits_in_single_precision(tmp_path):
    """It is made of changes of the reference: its multiples would cancel to 3e-5 of the drive."""
    law, _ = SecondOrderModeOperator(2.0 * np.pi * 4e3, 0.02).inverse().ahead(4e-6, 0.0)
    reference = np.sin(2.0 * np.pi * 500.0 * 4e-6 * np.arange(500)).astype(np.float32)
    to_c(Stepper(law, 4e-6), tmp_path, "fast", "float32", drive=reference)
    assert error_of(tmp_path, "fast") < 1e-6


def test_a_compensator_keeps_its_limits(tmp_path):
    compensator, y = fitted()
    header, *_ = to_c(compensator, tmp_path, "inverse", drive=y, u0=y[0])
    assert f"#define inverse_DT {DT}" in header.read_text()
    assert "InverseCompensator" in header.read_text()
    assert error_of(tmp_path, "inverse") <= BARS["float64"]
    drive = compensator.stepper(None, y[0]).run(y)
    assert (drive.min(), drive.max()) == (-0.1, 0.6)


WATCH = """
#include <stdio.h>
#include "$name.h"

int main(void)
{
    $name_state state;
    double u[$n];
    $name_init(&state);
    while ($scan) {
        const $real y = ($real)$name_step(&state, $u);
        printf("%u %.17g\\n", (unsigned)($name_status(&state) & $name_LIMITED), y);
    }
    return 0;
}
"""


def flags_of(folder, name, rows, flag="LIMITED", number=("double", "lf")):
    """Return which samples of an input (n_samples, n_inputs) raise the flag in C."""
    return answers_of(folder, name, rows, flag, number)[0]


def answers_of(folder, name, rows, flag, number=("double", "lf")):
    """Return which samples of an input (n_samples, n_inputs) raise the flag in C, and outputs."""
    n = rows.shape[1]
    scan = " && ".join(f'scanf("%{number[1]}", &u[{k}]) == 1' for k in range(n))
    text = WATCH.replace("$scan", scan).replace("$u)", "u)" if n > 1 else "u[0])")
    text = text.replace("double", number[0]).replace("LIMITED", flag)
    text = text.replace("$name", name).replace("$n", str(n)).replace("$real", "double")
    (folder / "watch.c").write_text(text)
    command = ["cc", *FLAGS, f"{name}.c", "watch.c", "-o", "watch", "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    given = "\n".join(" ".join(f"{value:.17g}" for value in row) for row in rows)
    run = subprocess.run(folder / "watch", input=given, capture_output=True, text=True, check=True)
    raised, outputs = np.array(run.stdout.split()).reshape(-1, 2).T
    return raised != "0", outputs.astype(float)


def test_what_the_fit_has_not_seen_raises_a_flag(tmp_path):
    """Levels and rates of the drive beyond those of the records, in Python and in C."""
    u = np.array([0.0, 1.0, 3.0, 4.0, 2.0, 1.0])  # from 0 to 4, by up to 2 per sample
    model = Gain(dt=1.0).fit(u[:, None], 2.0 * u)
    seen = np.array([1.0, 3.0, 4.0, 4.5, 4.0, 1.5, 0.0, -0.25, 0.0])
    expected = [False, False, False, True, False, True, False, True, False]
    stepper = model.stepper()
    assert [(stepper.step(x), "extrapolated" in stepper.status)[1] for x in seen] == expected
    to_c(model, tmp_path, "own", drive=u)
    assert flags_of(tmp_path, "own", seen[:, None], "EXTRAPOLATED").tolist() == expected
    to_c(model, tmp_path, "whole", "int32", drive=u, input_unit=0.25, output_unit=0.25)
    counts = (4.0 * seen[:, None]).astype(int)
    found = flags_of(tmp_path, "whole", counts, "EXTRAPOLATED", ("int32_t", "d"))
    assert found.tolist() == expected
    other = model.stepper()
    other.run(seen[:6])
    assert other.status == {"extrapolated"}


def test_an_output_that_no_input_gives_raises_a_flag(tmp_path):
    """A saturation gives at most one; its inverse then stays where it was."""
    inverse = inverse_of(SaturationOperator(upper=1.0))
    y = np.array([0.5, 2.0, 0.75])
    stepper = Stepper(inverse.compiled_step(DT, inverse.init(0.0)))
    flags = [(stepper.step(x), "unreachable" in stepper.status)[1] for x in y]
    assert (flags, stepper.output) == ([False, True, False], 0.75)
    to_c(inverse, tmp_path, "own", dt=DT)
    assert flags_of(tmp_path, "own", y[:, None], "UNREACHABLE").tolist() == flags


@pytest.mark.parametrize("rate_limit", [None, 0.5])
def test_a_cut_drive_raises_a_flag(tmp_path, rate_limit):
    """In Python and in C, at each sample where the drive is not the one that it is without."""
    compensator, y = fitted()
    compensator.set_params(rate_limit=rate_limit)
    to_c(compensator, tmp_path, "inverse", drive=y, u0=y[0])
    free = (
        clone(compensator)
        .set_params(drive_limits=None, rate_limit=None)
        .fit(make_drive()[:, None], y)
    )
    stepper, wanted = compensator.stepper(None, y[0]), free.stepper(None, y[0]).run(y)
    drive, flags = [], []
    for value in y:
        drive.append(stepper.step(value))
        flags.append("limited" in stepper.status)
    cut = np.abs(np.array(drive) - wanted) > 1e-8
    assert 0 < cut.sum() < len(cut)
    assert rate_limit is None or np.abs(np.diff(drive)).max() <= 0.5 * DT * (1.0 + 1e-12)
    np.testing.assert_array_equal(flags, cut)
    np.testing.assert_array_equal(flags_of(tmp_path, "inverse", y[:, None]), cut)
    units = {"input_unit": 2.0**-20, "output_unit": 2.0**-20}
    to_c(compensator, tmp_path, "whole", "int32", drive=y, u0=y[0], **units)
    assert error_of(tmp_path, "whole") <= BARS["int32"]


def test_a_limited_drive_outlasts_numbers_beyond_floating_point(tmp_path):
    """It stays within limits and rate, and is right again once the inverse has forgotten them.

    The test of the program sees what is broken in it.
    """
    mode, limits = SecondOrderModeOperator(2.0 / DT, 0.5), DriveLimits(-1.0, 1.0, 0.3 / DT)
    parts = mode.inverse().ahead(DT, 0.0)[0], limits.compiled_step(DT, 0.0)
    stepper = Stepper(CompiledSeries(parts), DT)
    reference = 0.7 * np.sin(0.3 * np.arange(120))
    wanted = stepper.copy().run(reference)
    reference[[20, 21, 22, 30, 40, 41]] = [1e308, -1e308, 1e308, 1e200, -1e308, 1e308]
    drive = [stepper.step(u) for u in reference]
    assert np.abs(drive).max() <= 1.0
    assert np.abs(np.diff([0.0, *drive])).max() <= 0.3 * (1.0 + 1e-12)
    assert stepper.status == {"overrange"}
    np.testing.assert_allclose(drive[-15:], wanted[-15:], rtol=1e-12)
    again = Stepper(CompiledSeries(parts), DT)
    with pytest.warns(DivergenceWarning, match="began anew"):
        np.testing.assert_array_equal(again.run(reference), drive)
    header, source, _ = to_c(Stepper(CompiledSeries(parts), DT), tmp_path, "own", drive=wanted)
    right = source.read_text()
    assert "#define own_CHANGE 0.3 /* the output differs by at most this from" in header.read_text()
    assert error_of(tmp_path, "own") <= BARS["float64"]
    subprocess.run(["cc", "-c", "own_test.c"], cwd=tmp_path, check=True)
    for part, broken in (
        ("if (!(fabs(y0) <", "if (!(0.0 <"),
        ("overrange = 1u", "overrange = 0u"),
        ("|= own_LIMITED", "|= 0u"),
        ("return y2", "return 1.001 * y2"),
    ):
        assert part in right
        source.write_text(right.replace(part, broken))
        command = ["cc", "own.c", "own_test.o", "-o", "own", "-lm"]
        subprocess.run(command, cwd=tmp_path, check=True)
        done = subprocess.run(tmp_path / "own", capture_output=True, text=True)
        assert (done.returncode, "a status, a limit" in done.stdout) == (1, True), broken


def test_limits_are_kept_in_whole_units(tmp_path):
    """They are rounded inwards, and a change of less than a unit is none."""
    limits = DriveLimits(-0.27, 0.34, 0.26 / DT)
    stepper, steps = Stepper(limits.compiled_step(DT, 0.05), DT), 0.5 * (-1.0) ** np.arange(60)
    options = {"drive": steps, "input_unit": 1e-3}
    header, *_ = to_c(stepper, tmp_path, "own", "int32", output_unit=0.1, **options)
    ends = dict(re.findall(r"own_(LOW|HIGH|CHANGE) INT32_C\((\S+)\)", header.read_text()))
    assert ends == {"LOW": "-2", "HIGH": "3", "CHANGE": "2"}
    assert error_of(tmp_path, "own") <= BARS["int32"]
    with pytest.raises(ValueError, match="must be at most the largest change"):
        to_c(stepper, tmp_path, "own", "int32", output_unit=0.3, **options)


def test_the_header_says_what_goes_in_and_comes_out(tmp_path):
    u = make_drive()[:, None]
    mode = SecondOrderModeOperator(0.5 / DT, 0.2)
    y = mode.run(u[:, 0], DT)[0]
    compensator = InverseCompensator(SecondOrderMode(dt=DT), drive_limits=None).fit(u, y)
    header, *_ = to_c(compensator, tmp_path, "inverse", input_unit="um", output_unit="V")
    text, preview = header.read_text(), compensator.preview()
    assert 0 < preview == compensator.stepper().preview
    assert f"#define inverse_PREVIEW {preview} " in text
    assert "u: reference in um\n" in text
    assert "returns: drive in V; range: " in text
    assert "There is no inverse_init_at" not in text
    assert f"the input {preview} samples, {preview * DT:g} s, earlier" in text
    loop = FeedforwardPI(1.0, 40.0, compensator=compensator)
    text = to_c(loop, tmp_path, "loop", dt=DT, input_unit=["um", "um??/", "V"])[0].read_text()
    assert "u[0]: reference in um\n   u[1]: reading in um? ?/\n   u[2]: drive of the comp" in text
    with pytest.raises(ValueError, match="one name or 3"):
        to_c(loop, tmp_path, "loop", dt=DT, input_unit=["um", "um"])
    with pytest.raises(ValueError, match="names of units"):
        to_c(compensator, tmp_path, "inverse", input_unit=2.0)


def beside_its_cube(u, c, s):
    """Lose digits of large input."""
    cube = u * u * u
    return (u + cube) - cube


@pytest.mark.parametrize("dtype", ["float32", "int32"])
def test_input_beyond_the_numbers_raises_a_flag(tmp_path, dtype):
    """Until the next start; what is not flagged is right."""
    law, drive = CompiledLaw(beside_its_cube, (), ()), np.linspace(-1.0, 1.0, 50)
    beside_its_cube.py_func = beside_its_cube
    unit = 2.0**-20 if dtype == "int32" else 1.0
    units = {"input_unit": unit, "output_unit": unit} if dtype == "int32" else {}
    header, *_ = to_c(law, tmp_path, "own", dtype, dt=DT, drive=drive, **units)
    ends = re.search(r"from (\S+) to (\S+)\.\n|below (\S+) or above (\S+),", header.read_text())
    low, high = (unit * float(end) for end in ends.groups() if end)
    assert low == -high
    assert 1.0 <= high <= 16.0
    u = np.array([0.3, 0.999 * high, -0.7, 0.2, -1.001 * high, 0.1])
    number = {"float32": ("float", "f"), "int32": ("int32_t", "d")}[dtype]
    given = np.round(u / unit) if dtype == "int32" else u
    found = flags_of(tmp_path, "own", given[:, None], "OVERRANGE", number)
    assert found.tolist() == [False, False, False, False, True, True]


def test_a_cut_controller_raises_a_flag(tmp_path):
    controller = FeedforwardPI(1.0, 40.0, drive_limits=(-0.5, 0.5))
    rows = np.stack([np.linspace(-2.0, 2.0, 50), np.zeros(50)], axis=1)
    to_c(controller, tmp_path, "loop", dt=1e-3, drive=rows)
    at_limits = np.abs(controller.stepper(1e-3).run(rows)) == 0.5
    assert 0 < at_limits.sum() < len(rows)
    np.testing.assert_array_equal(flags_of(tmp_path, "loop", rows), at_limits)
    header, *_ = to_c(OPERATORS["plays"], tmp_path, "plays", dt=DT)  # which has no limits
    assert "plays_LIMITED" not in header.read_text()
    units = {"input_unit": 1e-3, "output_unit": 1e-3, "drive": [0.0, 1.0]}
    header, *_ = to_c(OPERATORS["plays"], tmp_path, "plays", "int32", dt=DT, **units)
    assert "plays_REFUSED" not in header.read_text()  # integers are finite


def test_a_stepper_is_exported_as_it_stands(tmp_path):
    compensator, y = fitted()
    stepper = compensator.stepper()
    stepper.run(y[:30])
    expected = stepper.copy().run(y[30:])
    _, _, test = to_c(stepper, tmp_path, "late", drive=y[30:])
    assert error_of(tmp_path, "late") <= BARS["float64"]
    written = re.findall(r"[-\d.e]+", test.read_text().partition("late_outputs[N_SAMPLES]")[2])
    np.testing.assert_allclose([float(x) for x in written[: len(expected)]], expected, atol=1e-12)
    assert stepper.state.tolist() == pytest.approx(stepper.copy().state.tolist())


def integral(u, c, s):
    """Return the drive for a row of reference and reading."""
    s[0] += c[0] * (u[0] - u[1])
    return s[0]


integral.py_func = integral


class Integral:
    """A controller of one's own."""

    def stepper(self, dt, reference=0.0):
        """Return what is fed rows of reference and reading."""
        return Stepper(CompiledLaw(integral, (3.0 * dt,), (reference,), 2))


def test_a_controller_of_ones_own_is_fed_rows(tmp_path):
    header, *_ = to_c(Integral(), tmp_path, "own", dt=DT, u0=0.5)
    text = header.read_text()
    assert "own_step(own_state *state, const double *u)" in text
    assert f"#define own_DT {DT}" in text
    assert error_of(tmp_path, "own") <= BARS["float64"]


def test_what_rounding_makes_of_a_flat_part_is_allowed(tmp_path):
    """Where every input gives the same, which one is found hangs on the last digit."""
    flat = inverse_of(SaturationOperator(upper=0.413))
    y = np.minimum(make_drive(), 0.413)
    to_c(flat, tmp_path, "flat", "float32", dt=DT, u0=y[0], drive=y)
    assert error_of(tmp_path, "flat") > BARS["float32"]


def test_a_controller_with_all_its_parts_answers_as_in_python(tmp_path):
    rows = np.random.default_rng(0).normal(size=(200, 3))
    more = {"kd": 1e-3, "setpoint_weight": 0.5, "rate_limit": 400.0, "tracking_time": 0.01}
    controller = FeedforwardPI(
        0.7, 30.0, notch=(20.0, 0.1), drive_limits=(-2.0, 2.0), start_time=0.2, **more
    )
    units = {"input_unit": 2.0**-20, "output_unit": 2.0**-20}
    for dtype, bar in BARS.items():
        own = units if dtype == "int32" else {}
        to_c(controller, tmp_path, dtype, dtype, dt=DT, drive=rows, **own)
        assert error_of(tmp_path, dtype) <= bar
    rows[50], rows[90], rows[120, 2] = (1e308, -1e308, 0.5), (1e308, -1e308, 50.0), 50.0
    stepper, drive, status = controller.stepper(DT), [], []
    for row in rows:
        drive.append(stepper.step(row))
        status.append(stepper.status)
    for flag in ("EXTRAPOLATED", "OVERRANGE"):
        raised, outputs = answers_of(tmp_path, "float64", rows, flag)
        assert raised.tolist() == [flag.lower() in names for names in status]
        np.testing.assert_array_equal(outputs, drive)
