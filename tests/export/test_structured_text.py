"""Function blocks in Structured Text answer as Python does, in a translator that is strict."""

import contextlib
import math

import numpy as np
import pytest
import structured_text
from operator_cases import DT, OPERATORS, make_drive
from test_c import everything, helper, sum_of_row_and_last

from skhyst.control import FeedforwardPI, InverseCompensator
from skhyst.export import to_structured_text
from skhyst.hysteresis import BacklashOperator, PrandtlIshlinskii
from skhyst.operators import CompiledLaw, Stepper, inverse_of

# what there is in laws: tables, loops, tests that need statements, several results, functions
CASES = [
    *("plays", "Bouc-Wen", "relays", "delay of several samples", "free mass, friction", "series"),
    *("soft saturation", "Coulomb friction", "Duhem", "restoring force", "sinusoid", "empty sum"),
]
BARS = {"float64": 1e-14, "float32": 1e-6}  # of the range


def blocks(folder, model, name="own", dtype="float64", **more):
    """Return what is in the text of a model."""
    structured_text.EXCEPTIONS.clear()
    return structured_text.blocks_of(*to_structured_text(model, folder, name, dtype, **more))


def error_of_test(units, name="own"):
    """Run the test program and return its largest error."""
    test, n = units[f"{name}_test"](), 0
    while not test.done:
        test()
        n += 1
    assert (test.passed, structured_text.EXCEPTIONS) == (True, [])
    return test.largest


@pytest.mark.parametrize("case", CASES)
def test_blocks_answer_as_in_python(tmp_path, case):
    operator, u = OPERATORS[case], make_drive()[:80]
    span = np.ptp([0.0, *operator.run(u, DT, operator.init(u[0]))[0]]) or 1.0
    for dtype, bar in BARS.items():
        step = operator.compiled_step(DT, operator.init(u[0]))
        if dtype == "float64" or not step.double_only:
            # a sinusoid of time in single precision is within the bar in this test, not much longer
            more = {"tolerance": 1e-5} if case == "sinusoid" and dtype == "float32" else {}
            units = blocks(tmp_path, operator, dtype=dtype, dt=DT, u0=u[0], drive=u, **more)
            assert error_of_test(units) <= bar * span


@pytest.mark.parametrize("case", ["plays", "Dahl friction", "curve"])
def test_inverses_answer_as_in_python(tmp_path, case):
    """Infinite limits of a root search are the largest number, and the same numbers are found."""
    operator, u = OPERATORS[case], make_drive()[:40]
    y, _ = operator.run(u, DT, operator.init(u[0]))
    units = blocks(tmp_path, inverse_of(operator), dt=DT, u0=y[0], drive=y)
    assert error_of_test(units) <= BARS["float64"] * np.ptp([0.0, *u])


def test_whatever_the_language_has(tmp_path):
    for function in (helper, everything):
        assert function.py_func is function
    table = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])
    own = CompiledLaw(everything, (table, 0.3, 0.7), (0.1, 0.2, 0.3))
    assert error_of_test(blocks(tmp_path, own, drive=np.linspace(-1.3, 1.7, 40))) <= 1e-15


def case_of_names(u, c, s):
    """Use names that differ in case alone, and words of the language."""
    U, mod, end_if, a__b = 2.0 * u, c[0], u + 1.0, 3.0
    mod = mod + a__b if u > 0.0 or 1.0 / (u - 2.0) > -0.4 else mod
    return U + mod * end_if


case_of_names.py_func = case_of_names


def test_names_are_those_of_the_standard(tmp_path):
    """Case does not count there; and what must not be evaluated at 2 is not."""
    law = CompiledLaw(case_of_names, (0.5,), ())
    assert error_of_test(blocks(tmp_path, law, drive=[0.1, 2.0, -1.0, -3.0])) == 0.0
    for name in ("2nd", "gear__1", "gear_", "End_If", "REAL", "State"):
        with pytest.raises(ValueError, match="'name' parameter of to_structured_text"):
            to_structured_text(law, tmp_path, name)
    with pytest.raises(ValueError, match="'dtype' parameter of to_structured_text"):
        to_structured_text(law, tmp_path, "gear", "int32")


@pytest.mark.parametrize("dtype", BARS)
def test_instances_flags_and_the_first_state(tmp_path, dtype):
    """Two blocks, of which one gets input that is not finite; then both begin again."""
    u = make_drive()[:, None]
    y = OPERATORS["plays"].run(u[:, 0], DT)[0]
    model = PrandtlIshlinskii(thresholds=np.array([0.0, 0.21, 0.43]), dt=DT).fit(u, y)
    compensator = InverseCompensator(model, drive_limits=(-0.1, 0.6)).fit(u, y)
    units = blocks(tmp_path, compensator, "inverse", dtype, drive=y, u0=y[0])
    pair = [units["inverse"]() for _ in range(2)]
    drives = np.stack([1.5 * y, 0.8 * y[::-1]], axis=1).astype(np.dtype(dtype)).astype(float)
    drives[7::9, 1] = np.nan
    drives[8::9, 1] = np.inf
    for _ in range(2):
        steppers = [compensator.stepper(None, y[0]) for _ in pair]
        for block, stepper in zip(pair, steppers, strict=True):
            block(init=True)
            assert block.y == pytest.approx(stepper.copy().step(y[0]), abs=1e-6)
        seen = set()
        for row in drives:
            for block, stepper, value in zip(pair, steppers, row, strict=True):
                block(u=float(value), init=False)
                with contextlib.suppress(ValueError):  # it is refused
                    stepper.step(value)
                assert {own for own in ("limited", "refused") if getattr(block, own)} == (
                    stepper.status & {"limited", "refused"}
                )
                assert block.y == pytest.approx(stepper.output, abs=BARS[dtype])
                seen |= stepper.status
        assert {"limited", "refused"} <= seen
    pair[0](u=0.3, init_at=True)
    pair[0](u=0.35, init_at=False)
    expected = compensator.stepper(None, float(np.dtype(dtype).type(0.3))).step(0.35)
    assert pair[0].y == pytest.approx(expected, abs=BARS[dtype])


def test_what_the_fit_has_not_seen_raises_a_flag(tmp_path):
    u = np.array([0.0, 1.0, 3.0, 4.0, 2.0, 1.0])  # from 0 to 4, by up to 2 per sample
    model = PrandtlIshlinskii(thresholds=np.array([0.0, 1.0]), dt=1.0).fit(u[:, None], 2.0 * u)
    block = blocks(tmp_path, model, drive=u, input_unit="V*)")["own"]()
    seen, found = [1.0, 3.0, 4.0, 4.5, 4.0, 1.5, 0.0, -0.25, 0.0], []
    for value in seen:
        block(u=value)
        found.append(block.extrapolated)
    assert found == [False, False, False, True, False, True, False, True, False]


def test_a_controller_takes_a_row(tmp_path):
    rows = np.random.default_rng(0).normal(size=(60, 2))
    controller = FeedforwardPI(1.0, 40.0, notch=(20.0, 0.1), drive_limits=(-0.5, 0.5))
    units = blocks(tmp_path, controller, dt=DT, drive=rows)
    assert error_of_test(units) == 0.0
    block, stepper = units["own"](), controller.stepper(DT)
    for row in ([0.3, 0.1], [1e308, -1e308], [0.3, 0.1], [0.2, 0.1]):
        block(u=row)
        assert (block.y, block.overrange) == (stepper.step(row), "overrange" in stepper.status)
    assert block.overrange
    law = CompiledLaw(sum_of_row_and_last, (), (0.5,), n_inputs=2)
    block = blocks(tmp_path, law, u0=(1.0, 2.0))["own"]()
    found = []
    for row in ([np.nan, 0.0], [4.0, 8.0], [np.inf, 1.0], [1.0, 1.0]):
        block(u=row)
        found.append((block.y, block.refused))
    assert found == [(3.5, True), (12.5, False), (12.5, True), (14.0, False)]


def of_angles(u, c, s):
    """Call what Structured Text does not have."""
    return math.atan2(u, 1.0)


of_angles.py_func = of_angles


def test_what_cannot_be_written_is_named(tmp_path):
    with pytest.raises(ValueError, match="'atan2' cannot be written in Structured Text"):
        to_structured_text(CompiledLaw(of_angles, (), ()), tmp_path, "own")


def test_the_test_program_sees_a_wrong_number(tmp_path):
    block, test = to_structured_text(BacklashOperator(0.2), tmp_path, "gear", dt=1.0)
    units = structured_text.blocks_of(block, test)
    error_of_test(units, "gear")
    text = block.read_text()
    assert "gear_c0" not in text
    block.write_text(text.replace("0.2", "0.2000001"))
    test_of = structured_text.blocks_of(block, test)["gear_test"]()
    while not test_of.done:
        test_of()
    assert not test_of.passed
    assert test_of.largest == pytest.approx(1e-7, rel=1e-3)


def test_a_program_keeps_its_stepper_and_its_form(tmp_path):
    stepper = Stepper(BacklashOperator(0.2).compiled_step(DT, BacklashOperator(0.2).init(0.0)), DT)
    stepper.run([1.0, 0.9])
    units = blocks(tmp_path, stepper, drive=[0.85, 0.3])
    assert error_of_test(units) == 0.0
    block = units["own"]()
    assert (block.y, block.cycle) == (stepper.output, DT)
    small = to_structured_text(OPERATORS["Bouc-Wen"], tmp_path, "wires", dt=DT, form="step")[0]
    assert len(small.read_text()) < 7000
