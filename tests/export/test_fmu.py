"""A functional mock-up unit is the C program to the last bit, and keeps to the standard."""

import ctypes
import shutil
import subprocess
from zipfile import ZipFile

import numpy as np
import pytest

from skhyst.export import to_c, to_fmu
from skhyst.hysteresis import BacklashOperator, BoucWenOperator, PrandtlIshlinskiiOperator
from skhyst.linear import FirstOrderLagOperator, SecondOrderModeOperator
from skhyst.operators import CompiledLaw, Series, Stepper

fmpy = pytest.importorskip("fmpy", reason="FMUs are run and validated by the extra fmi")
validation = pytest.importorskip("fmpy.validation")
NEEDS_COMPILER = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")
VERSIONS = ("2.0", "3.0")
DT, N = 1e-3, 500
CASES = {
    "stage": Series(
        ("plays", "mode"),
        (
            PrandtlIshlinskiiOperator([0.0, 0.2, 0.5], [1.0, 0.5, 0.3]),
            SecondOrderModeOperator(2.0 * np.pi * 40.0, 0.02),
        ),
    ),
    "wires": BoucWenOperator(0.4, 0.7, 0.31, 0.6, 1.0, 0.0, 0.1),
}


def answers_of_c(operator, folder, u):
    """Return what the C program answers."""
    to_c(operator, folder, "own", dt=DT, u0=u[0])
    flags = ("-std=c99", "-O2", "-shared", "-fPIC")
    subprocess.run(["cc", *flags, "own.c", "-o", "own.so", "-lm"], cwd=folder, check=True)
    library = ctypes.CDLL(str(folder / "own.so"))
    library.own_step.argtypes = [ctypes.c_void_p, ctypes.c_double]
    library.own_step.restype = ctypes.c_double
    state = (ctypes.c_double * 1000)()
    library.own_init(state)
    return np.array([library.own_step(state, value) for value in u])


@NEEDS_COMPILER
@pytest.mark.parametrize("name", CASES)
def test_simulated_units_are_the_program(tmp_path, name):
    operator, time = CASES[name], DT * np.arange(N + 1)
    u = 0.3 + np.sin(40.0 * time) * np.exp(-2.0 * time)
    expected = Stepper(operator.compiled_step(DT, operator.init(u[0]))).run(u[:N])
    program = answers_of_c(operator, tmp_path, u[:N])
    signal = np.rec.fromarrays([time, u], names="time,input")
    for version in VERSIONS:
        units = {"input_unit": "V", "output_unit": "<m>"}
        path = to_fmu(operator, tmp_path / f"{name}.fmu", version, dt=DT, u0=u[0], **units)
        assert validation.validate_fmu(str(path)) == []
        found = fmpy.simulate_fmu(str(path), stop_time=N * DT, output_interval=DT, input=signal)
        np.testing.assert_array_equal(found["output"][1:], program)
        tolerance = 1e-12 * np.ptp(expected)
        np.testing.assert_allclose(found["output"][1:], expected, rtol=0.0, atol=tolerance)
        described = fmpy.read_model_description(str(path)).modelVariables
        assert [v.unit for v in described] == ["s", "<m>", "V"]


class Unit:
    """An FMU in memory, with the messages that it logged."""

    def __init__(self, path, folder, token=None):
        described = fmpy.read_model_description(str(path))
        module = {"2.0": fmpy.fmi2, "3.0": fmpy.fmi3}[described.fmiVersion]
        slave = {"2.0": "FMU2Slave", "3.0": "FMU3Slave"}[described.fmiVersion]
        self.messages = []
        self.fmu = getattr(module, slave)(
            guid=token or described.guid,
            unzipDirectory=fmpy.extract(str(path), str(folder)),
            modelIdentifier=described.coSimulation.modelIdentifier,
            instanceName="it",
        )
        if module is fmpy.fmi2:
            told = module.fmi2CallbackLoggerTYPE(lambda *args: self.messages.append(args[-1]))
            self.callbacks = module.fmi2CallbackFunctions()
            self.callbacks.logger = told
            self.fmu.instantiate(callbacks=self.callbacks)
            self.set, self.get = self.fmu.setReal, self.fmu.getReal
            self.fmu.setupExperiment(startTime=-7.0)
            self.fmu.enterInitializationMode()
            self.save, self.load = self.fmu.serializeFMUstate, self.fmu.deSerializeFMUstate
        else:
            told = module.fmi3LogMessageCallback(lambda *args: self.messages.append(args[-1]))
            self.fmu.instantiate(logMessage=told)
            self.set, self.get = self.fmu.setFloat64, self.fmu.getFloat64
            self.fmu.enterInitializationMode(startTime=-7.0)
            self.save, self.load = self.fmu.serializeFMUState, self.fmu.deserializeFMUState
        self.told = told
        self.fmu.exitInitializationMode()

    def run(self, u, size=DT):
        answers = []
        for value in u:
            self.set([2], [value])
            self.fmu.doStep(self.get([0])[0], size)
            answers.append(self.get([1])[0])
        return answers

    def is_refused(self, call, message):
        with pytest.raises(fmpy.fmi1.FMICallException) as error:
            call()
        assert error.value.status == 3  # fmiError
        assert message in self.messages[-1]


@NEEDS_COMPILER
@pytest.mark.parametrize("version", VERSIONS)
def test_state_returns_and_what_is_wrong_is_refused(tmp_path, version):
    path = to_fmu(CASES["wires"], tmp_path / "wires.fmu", version, dt=DT)
    unit = Unit(path, tmp_path / "out")
    u = np.sin(np.arange(20.0))
    first = unit.run(u)
    assert unit.get([0])[0] == pytest.approx(-7.0 + 20 * DT, abs=1e-12)
    state = unit.fmu.getFMUState()
    saved = unit.save(state)
    after = unit.run(u)
    assert after != first
    unit.fmu.setFMUState(state)
    assert unit.run(u) == after
    restored = unit.load(saved)
    unit.fmu.setFMUState(restored)
    assert unit.run(u) == after
    for held in (state, restored):
        unit.fmu.freeFMUState(held)
    unit.fmu.reset()
    assert unit.run(u) == first
    unit.fmu.reset()
    at_once = unit.run([0.7, 0.2], 3 * DT)
    unit.fmu.reset()
    assert unit.run(np.repeat([0.7, 0.2], 3))[2::3] == at_once
    for size in (0.0, -DT, 0.5 * DT, 1.001 * DT, np.nan, np.inf):
        unit.is_refused(lambda size=size: unit.fmu.doStep(0.0, size), b"not a whole multiple")
    unit.is_refused(lambda: unit.run([np.nan]), b"not finite")
    unit.is_refused(lambda: unit.set([1], [0.0]), b"only inputs")
    unit.is_refused(lambda: unit.get([3]), b"no such variable")
    unit.is_refused(lambda: unit.load(saved[:-1]), b"another state")
    unit.fmu.terminate()
    unit.fmu.freeInstance()
    with pytest.raises(Exception, match="instantiate"):
        Unit(path, tmp_path / "other", token="another")


@NEEDS_COMPILER
@pytest.mark.parametrize("version", VERSIONS)
def test_start_values_and_parameters_act(tmp_path, version):
    """The device has rested at the start value of its input, with the parameters that are set."""
    lag, time = FirstOrderLagOperator(0.05, gain=2.0), DT * np.arange(101)
    path = to_fmu(lag, tmp_path / "lag.fmu", version, dt=DT, tunable=["gain", "time_constant"])
    assert validation.validate_fmu(str(path)) == []
    described = fmpy.read_model_description(str(path)).modelVariables
    own = [(v.name, v.causality, v.start, v.min, v.max) for v in described[3:]]
    assert own == [
        ("gain", "parameter", "2.0", "1.0", "3.0"),
        ("time_constant", "parameter", "0.05", "0.025", "0.07500000000000001"),
    ]
    u = 0.7 + np.sin(40.0 * time)
    signal = np.rec.fromarrays([time, u], names="time,input")
    for values in ({"input": 0.7}, {"input": 0.7, "gain": 1.5, "time_constant": 0.03}):
        found = fmpy.simulate_fmu(
            str(path), stop_time=0.1, output_interval=DT, input=signal, start_values=values
        )
        other = FirstOrderLagOperator(values.get("time_constant", 0.05), values.get("gain", 2.0))
        expected, _ = other.run(u[:-1], DT, other.init(0.7))
        np.testing.assert_allclose(found["output"][1:], expected, rtol=0.0, atol=1e-12)
    unit = Unit(path, tmp_path / "out")
    unit.set([3], [3.0])
    unit.is_refused(lambda: unit.set([3], [3.5]), b"out of its range")
    assert unit.get([3]) == [3.0]
    assert np.isfinite(unit.run([1.7e308] * 40)).all()  # three times that is not
    assert b"left floating point" in unit.messages[-1]


def row(u, c, s):
    """Read an input of two columns."""
    return c[0] * u[0] + u[1]


row.py_func = row


@pytest.mark.parametrize("version", VERSIONS)
def test_sources_stand_alone(tmp_path, version, monkeypatch):
    rows = CompiledLaw(row, (2.0,), ())
    object.__setattr__(rows, "n_inputs", 2)
    with monkeypatch.context() as without:
        without.setattr(shutil, "which", lambda name: None)
        path = to_fmu(rows, tmp_path / "rows.fmu", version, dt=0.1, u0=[1.0, 2.0])
        first = path.read_bytes()
        to_fmu(rows, path, version, dt=0.1, u0=[1.0, 2.0])
    assert path.read_bytes() == first
    assert validation.validate_fmu(str(path)) == []
    described = fmpy.read_model_description(str(path))
    assert [v.name for v in described.modelVariables] == ["time", "output", "input_1", "input_2"]
    assert [v.start for v in described.modelVariables][2:] == ["1.0", "2.0"]
    with ZipFile(path) as archive:
        assert not any(name.startswith("binaries") for name in archive.namelist())
        archive.extractall(tmp_path)
    if shutil.which("cc"):
        flags = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-fsyntax-only")
        prefix = f"-DFMI{version[0]}_FUNCTION_PREFIX=rows_"
        for more in ((), (prefix,)):
            subprocess.run(["cc", *flags, *more, tmp_path / "sources/rows_fmu.c"], check=True)


@pytest.mark.skipif(
    shutil.which("x86_64-w64-mingw32-gcc") is None, reason="there is no cross-compiler for Windows"
)
def test_windows_has_a_library(tmp_path):
    path = to_fmu(BacklashOperator(0.2), tmp_path / "gear.fmu", "3.0", dt=DT)
    first = path.read_bytes()
    with ZipFile(path) as archive:
        library = archive.read("binaries/x86_64-windows/gear.dll")
    assert library.startswith(b"MZ")
    assert b"fmi3DoStep" in library
    assert to_fmu(BacklashOperator(0.2), path, "3.0", dt=DT).read_bytes() == first


def test_wrong_arguments(tmp_path):
    with pytest.raises(ValueError, match=r"'version' parameter of to_fmu .* Got '1.0'"):
        to_fmu(BacklashOperator(0.2), tmp_path / "gear.fmu", "1.0", dt=DT)
    gear = BacklashOperator(0.2)
    compiled_step = gear.compiled_step(DT, gear.init(0.0))
    with pytest.raises(ValueError, match="'dt' parameter of to_fmu must be given"):
        to_fmu(compiled_step, tmp_path / "gear.fmu")
