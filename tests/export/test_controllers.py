"""Programs on emulated controllers: their numbers, their memory and their time."""

import shutil

import numpy as np
import pytest
from operator_cases import DT, OPERATORS

from skhyst.control import FeedforwardPI
from skhyst.export import EmulatedController, program_sizes, to_c
from skhyst.hysteresis import PrandtlIshlinskiiOperator
from skhyst.operators import RootInverseOperator, Stepper

TOOLS = {
    "Cortex-M0": ("arm-none-eabi-gcc", "qemu-system-arm"),
    "Cortex-M4F": ("arm-none-eabi-gcc", "qemu-system-arm"),
    "AVR": ("avr-gcc", "simavr"),
    "x86-64": ("x86_64-linux-gnu-gcc",),
}


def need(target):
    """Skip a test where the tools for a target are not installed."""
    missing = [tool for tool in TOOLS[target] if shutil.which(tool) is None]
    if missing:
        pytest.skip(f"{target} needs {' and '.join(missing)}")


@pytest.mark.parametrize(
    ("target", "dtype", "bar"),
    [
        ("Cortex-M4F", "float64", 1e-12),
        ("Cortex-M4F", "float32", 1e-6),
        ("Cortex-M0", "float64", 1e-12),
        ("AVR", "float32", 1e-6),
    ],
)
def test_a_compensator_gives_the_numbers_of_python(tmp_path, target, dtype, bar):
    need(target)
    inverse = RootInverseOperator(OPERATORS["Dahl friction"], -2.0, 2.0)
    stepper = Stepper(inverse.compiled_step(DT, inverse.init(0.0)), DT)
    reference = np.sin(0.3 * np.arange(20)).astype(np.float32).astype(float)
    to_c(stepper, tmp_path, "inverse", dtype, drive=reference)
    expected = stepper.run(reference)
    with EmulatedController(tmp_path, "inverse", target) as controller:
        found = np.array([controller.step(r) for r in reference])
        counted, cycles = controller.instructions, controller.cycles
        assert controller.step(np.nan) == found[-1]
        assert controller.status == 2  # bits: unreachable, refused
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=bar * np.ptp(expected))
    assert counted > 100
    assert 1.0 < cycles / counted < 2.5 if target == "AVR" else np.isnan(cycles)


def test_a_controller_takes_rows(tmp_path):
    need("Cortex-M4F")
    feedback = FeedforwardPI(0.3, 20.0, drive_limits=(-1.0, 1.0))
    stepper, rows = feedback.stepper(DT), [[1.0, 0.2], [1.0, 5.0], [-3.0, 0.1]]
    to_c(feedback, tmp_path, "loop", dt=DT)
    with EmulatedController(tmp_path, "loop") as controller:
        assert [controller.step(row) for row in rows] == [stepper.step(row) for row in rows]
        with pytest.raises(ValueError, match="'u' parameter of step must have 2 numbers"):
            controller.step(1.0)


def test_what_is_missing_is_named(tmp_path, monkeypatch):
    to_c(OPERATORS["backlash"], tmp_path, "gear", dt=DT)
    with pytest.raises(ValueError, match="'target' parameter of EmulatedController"):
        EmulatedController(tmp_path, "gear", "PDP-11")
    with pytest.raises(FileNotFoundError, match="There is no program"):
        EmulatedController(tmp_path, "cam")
    if shutil.which("avr-gcc") and shutil.which("simavr"):
        with pytest.raises(RuntimeError, match=r"for AVR: [^$]*fewer than 64 bits"):
            EmulatedController(tmp_path, "gear", "AVR")
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(FileNotFoundError, match="There is no arm-none-eabi-gcc"):
        EmulatedController(tmp_path, "gear")


@pytest.mark.slow
def test_sizes_are_those_of_the_compiler(tmp_path, monkeypatch):
    plays = PrandtlIshlinskiiOperator([0.0, 0.3, 0.5], [1.0, 0.5, 0.2])
    to_c(plays, tmp_path, "plays", "float32", drive=np.sin(np.arange(8)), dt=DT)
    sizes = program_sizes(tmp_path, "plays")
    assert sizes.index.tolist() == list(TOOLS)
    found = sizes.dropna(subset="flash")
    assert (found["state"] == 4 * (3 + 3)).all()  # three plays, the output and two flags
    assert found["flash"].between(100, 2000).all()
    counted = sizes.dropna(subset="instructions")
    assert (counted["instructions"] <= counted["most_instructions"]).all()
    assert counted["most_instructions"].between(20, 5000).all()
    monkeypatch.setattr(shutil, "which", lambda name: None)
    assert program_sizes(tmp_path, "plays").isna().all(axis=None)
    with pytest.raises(FileNotFoundError, match="There is no program"):
        program_sizes(tmp_path, "stops")
