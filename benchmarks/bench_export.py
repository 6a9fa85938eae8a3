"""Compare exported programs with Python: `python benchmarks/bench_export.py`.

Every operator of the acceptance test that can be stepped, and every inverse of one, from a preview
where it looks ahead, answers a drive as C in double and single precision and in integers, and
operators as a functional mock-up unit. An inverse is right where its drive is; else it is judged by
what its drive does: by the response of its operator to it against that to Python's drive, for the
same rounded input. Limits are twice what rounding makes, where that is more than the bar: of the
last digit of the input in a drive, and of the last digit of the input or the drive in a response,
as where the law is steep or jumps. Inverses have limits of the drive, since a rounded input may be
out of reach. Programs that are refused are listed with the reason. cppcheck is run where it is
found.

All of these, and fitted models of several kinds, compensators, controllers and observers, are run
under the sanitizers of the compiler. In integers with drives that they have not been sized by:
random ones, steps and full swings from sample to sample within the range, where all but inverses
have the same limits, and with inputs up to the ends of 32 bits, which are to be held. In double and
single precision with random, stepped, tiny and huge drives and with input that is not finite.
Headers are compiled as C and C++ with warnings as errors, cppcheck looks for required rules of
MISRA C:2012 that are broken, each parameter of an operator that can be changed at run time is, and
the program compared with the operator that has it, and programs run on emulated controllers, whose
memory and time are reported. All of them are written in Structured Text, too, and run by the
translator of the tests, which notes divisions by zero and overflow. ``--every 8`` runs one system
in eight.
"""

import argparse
import ctypes
import importlib
import itertools
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from bench_stepping import C_LIMIT, PLAYS, formatted, in_c

from skhyst.control import FeedforwardPI, InverseCompensator
from skhyst.export import EmulatedController, program_sizes, to_c, to_fmu, to_structured_text
from skhyst.export._content import whole_limits
from skhyst.hysteresis import BoucWenOperator, PrandtlIshlinskiiOperator
from skhyst.operators import RootInverseOperator, Stepper, inverse_of

BARS = {"float64": 1e-12, "float32": 1e-6, "int32": 1.0}
UNITS = {"float64": "of the range", "float32": "of the range", "int32": "units"}
C_TYPES = {"float64": "double", "float32": "float", "int32": "int32_t"}
STRICT = ("-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-pedantic", "-Werror")
NUMBERS = {"float64": ctypes.c_double, "float32": ctypes.c_float, "int32": ctypes.c_int32}
COUNTS = 2.0**20  # units of the range of input and output, in integers
CHECKS = ("--std=c99", "--enable=warning,performance,portability", "--addon=misra", "-q")
TOLD = r"return largest <= (\S+) \* (\S+) \?"  # in the test: what it allows, and the range
SANITIZED = (
    "-fsanitize=address,undefined,float-cast-overflow",
    "-fno-sanitize-recover=all",
)
UNKEPT = r"the advisory rules ([^*]+) are not kept"  # in the header
BRANCHES = r"; (\d+) of (\d+) branches taken(?:, not ([^\\]+))?"  # in the test
HELD = r"Input below (.+) or above (.+), and output"  # in the header: where input is held
CASES = Path(__file__).parents[1] / "tests" / "operators"  # of operator_cases


@dataclass(frozen=True)
class System:
    """What is exported: a stepper and its input; for an inverse its operator, too."""

    name: str
    operator: object
    stepper: Stepper
    u: np.ndarray
    ahead: int = 0  # samples by which the input of an inverse comes early
    is_inverse: bool = False

    def answers(self, u):
        """Return what Python answers to an input, without that of a preview's first samples."""
        return self.stepper.copy().run(u)[self.ahead :]

    def effect(self, drive):
        """Return the response of the operator to a drive, from where its inverse has it rest."""
        rest = self.answers(np.full(self.ahead + 1, self.u[0]))[0]
        return self.operator.run(drive, self.stepper.dt, self.operator.init(float(rest)))[0]


def systems(every=1):
    """Yield operators and inverses, or one in so many of them."""
    return itertools.islice(_systems(), 0, None, every)


def _systems():
    sys.path.insert(0, str(CASES))
    cases = importlib.import_module("operator_cases")
    u, dt = cases.make_drive(), cases.DT
    for name, operator in cases.OPERATORS.items():
        if operator.causal:
            stepper = Stepper(operator.compiled_step(dt, operator.init(float(u[0]))), dt)
            yield System(name, operator, stepper, u)
    for name, operator in cases.OPERATORS.items():
        y = operator.run(u, dt, operator.init(u[0]))[0]
        try:
            limits = u.min() - np.ptp(u), u.max() + np.ptp(u)
            compiled_step, ahead = inverse_of(operator, *limits).ahead(dt, float(y[0]))
        except (NotImplementedError, ValueError):
            continue  # it has none, or one of the whole record
        if ahead < len(y):
            y = np.append(y, np.full(ahead, y[-1]))
            yield System(name, operator, Stepper(compiled_step, dt), y, ahead, True)


def library(folder, name, dtype):
    """Return the step of a program, and what begins it."""
    file = f"{name}.so"
    command = ["cc", "-std=c99", "-O2", "-shared", "-fPIC", f"{name}.c", "-o", file, "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    program = ctypes.CDLL(str(folder / file))
    step, state = program[f"{name}_step"], ctypes.create_string_buffer(1 << 20)
    step.argtypes, step.restype = [ctypes.c_void_p, NUMBERS[dtype]], NUMBERS[dtype]
    return lambda value: step(state, value), lambda: program[f"{name}_init"](state)


def in_type(system, dtype, folder, name):
    """Return the error of a program and that of its effect, each with what rounding explains."""
    u, y = system.u, system.answers(system.u)
    units = {"input_unit": (np.ptp(u) or 1.0) / COUNTS, "output_unit": (np.ptp(y) or 1.0) / COUNTS}
    more = units if dtype == "int32" else {}
    *_, test = to_c(system.stepper, folder, name, dtype, drive=u, **more)
    tolerance, span = map(float, re.search(TOLD, test.read_text()).groups())
    step, begin = library(folder, name, dtype)
    begin()
    if dtype == "int32":
        counts = np.round(u / units["input_unit"])
        u, found = counts * units["input_unit"], [step(int(value)) for value in counts]
        found = units["output_unit"] * np.array(found)
        unit, effect_unit = units["output_unit"], units["input_unit"]
        of_u, of_y = 0.5 * effect_unit, 0.5 * unit
    else:
        u = u.astype(dtype).astype(float)
        found = np.array([step(value) for value in u])
        unit, effect_unit = span, np.ptp(system.u) or 1.0
        of_u, of_y = (0.5 * np.finfo(dtype).eps * np.abs(x) for x in (u, system.answers(u)))
    found, y = found[system.ahead :], system.answers(u)
    error = np.abs(found - y).max() / unit
    if not system.is_inverse:
        return error, tolerance, 0.0, 0.0
    sign = 1.0 - 2.0 * (np.arange(len(u)) % 2)
    moved = [system.effect(y + s * of_y) for s in (sign[: len(y)], -sign[: len(y)], 1.0, -1.0)]
    moved += [system.effect(system.answers(u + s * of_u)) for s in (sign, -sign, 1.0, -1.0)]
    effects = np.abs([system.effect(found), *moved] - system.effect(y)).max(axis=1) / effect_unit
    return error, tolerance, effects[0], 2.0 * effects[1:].max()


def fast_drives(low, high, seed):
    """Return counts within a range: random, steps, swings, a walk."""
    rng = np.random.default_rng(seed)
    swings = np.tile([high, low], 30)
    steps = np.repeat(rng.integers(low, high + 1, 12), 7)
    walk = np.clip(np.cumsum(rng.normal(size=60) * (high - low) / 100), low, high).astype(int)
    return np.concatenate([rng.integers(low, high + 1, 60), swings, steps, walk, swings])


DRIVER = """
#include "NAME.h"
#include <stdio.h>
int main(void)
{
    NAME_state s;
    TYPE u[NAME_N_INPUTS], y;
    uint32_t beyond;
    NAME_init(&s);
    while (fread(u, sizeof u, 1, stdin) == 1) {
        y = NAME_step(&s, ROW);
        beyond = NAME_status(&s) & NAME_OVERRANGE;
        fwrite(&y, sizeof y, 1, stdout);
        fwrite(&beyond, sizeof beyond, 1, stdout);
    }
}
"""


def sanitized(folder, name, dtype, by_row=False):
    """Compile a program with the sanitizers and return what runs it from its first state.

    That returns what the program answers to a drive, at which samples it says that this is beyond
    its numbers, and what the sanitizers say.
    """
    text = DRIVER.replace("NAME", name).replace("TYPE", C_TYPES[dtype])
    (folder / "main.c").write_text(text.replace("ROW", "u" if by_row else "u[0]"))
    command = ["cc", "-std=c99", *STRICT, *SANITIZED, "main.c", f"{name}.c"]
    subprocess.run([*command, "-o", name, "-lm"], cwd=folder, check=True)
    (folder / "main.cc").write_text(f'#include "{name}.h"\n')
    subprocess.run(["c++", *STRICT, "-fsyntax-only", "main.cc"], cwd=folder, check=True)

    def run(u):
        given = np.asarray(u, dtype=dtype).tobytes()
        done = subprocess.run(folder / name, input=given, capture_output=True)
        rows = np.frombuffer(done.stdout, dtype=[("y", dtype), ("beyond", "u4")])
        return rows["y"].astype(float), rows["beyond"] != 0, done.stderr.decode()

    return run


def in_integers(stepper, u, folder, name):
    """Return the error within the range, its limit, whether input is held, and what is reported.

    In between are the branches: those that its test takes, all, and the names of others.
    """
    u = np.asarray(u, dtype=float).reshape(len(u), -1)
    row = stepper.compiled_step.n_inputs is not None
    respond = lambda u: stepper.copy().run(u if row else u[:, 0])  # noqa: E731
    unit, of_y = ((np.ptp(x) or 1.0) / COUNTS for x in (u, respond(u)))
    stepper = whole_limits(stepper, of_y)
    options = {"drive": u, "input_unit": unit, "output_unit": of_y, "u0": u[0]}
    header, _, test = to_c(stepper, folder, name, "int32", **options)
    *branches, others = re.search(BRANCHES, test.read_text()).groups()
    ends = [np.fromstring(x, int, sep=",") for x in re.search(HELD, header.read_text()).groups()]
    counts = np.round(u / unit).astype(int)
    ranges = zip(counts.min(axis=0), counts.max(axis=0), range(u.shape[1]), strict=True)
    fast = np.stack([fast_drives(*own) for own in ranges], axis=1)
    rng = np.random.default_rng(1)
    wild = rng.integers(-(2**31), 2**31, (100, u.shape[1]))
    swings = np.tile([[2**31 - 1], [-(2**31)]], (30, u.shape[1]))
    wild = np.concatenate([wild, swings, fast])
    run = sanitized(folder, name, "int32", row)
    found, beyond, told = run(np.append(fast, wild, axis=0))
    clipped = np.clip(wild, *ends)
    held, *_ = run(np.append(fast, clipped, axis=0))
    is_beyond = np.append(np.zeros(len(fast), bool), (wild != clipped).any(axis=1))
    is_beyond = np.logical_or.accumulate(is_beyond)
    is_held = np.array_equal(found, held) and np.array_equal(beyond, is_beyond)
    expected = respond(unit * fast)
    rounding = 2.0**-40 * (1.0 - 2.0 * (np.arange(len(fast)) % 2))[:, None]
    moved = [respond(unit * fast * (1.0 + s * rounding)) for s in (1, -1)]
    allowed = 2.0 * np.abs(np.subtract(moved, expected)).max() / of_y
    expected = np.clip(expected / of_y, 1 - 2**31, 2**31 - 1)
    error = np.abs(found[: len(fast)] - expected).max() if len(found) >= len(fast) else np.inf
    return error, allowed, (*map(int, branches), others), is_held, told


def devices():
    """Yield fitted models, compensators, controllers and observers: name, object, input."""
    from sklearn.linear_model import LinearRegression
    from sklearn.tree import DecisionTreeRegressor

    from skhyst.autoregressive import NARMAXRegressor, NARXRegressor
    from skhyst.compose import Cascade, ModalFeedback, Modulated, Sum
    from skhyst.control import Observer
    from skhyst.hysteresis import (
        BoucWen,
        CoulombFriction,
        Dahl,
        DahlOperator,
        FreeMass,
        FrictionStage,
        PrandtlIshlinskii,
    )
    from skhyst.linear import FirstOrderLag, Gain, LogCreep, SecondOrderMode
    from skhyst.neural import GrayBoxHysteresis, SCNRegressor
    from skhyst.static import SmoothCurve, UnknownTerm

    rng, dt = np.random.default_rng(4), 1e-3
    n = 600
    u = np.convolve(rng.normal(size=n + 40), np.hanning(41), "valid")
    u *= 4.0 / np.abs(u).max()
    plays = PLAYS.run(u, dt)[0]
    late = np.convolve(np.append(np.full(20, plays[0]), plays), 0.2 * 0.8 ** np.arange(21), "valid")
    y = 0.9 * plays + 0.1 * late + 1e-4 * rng.normal(size=n)
    X, reference = u[:, None], y[:300]
    friction = DahlOperator(0.3, 0.8, stiffness=0.5).run(u, dt)[0]
    models = {
        "cascade of plays and creep": Cascade([("p", PrandtlIshlinskii(5)), ("c", LogCreep())]),
        "cascade of plays and mode": Cascade(
            [("p", PrandtlIshlinskii(5)), ("m", SecondOrderMode())]
        ),
        "cascade of plays, creep and mode": Cascade(
            [("p", PrandtlIshlinskii(5)), ("c", LogCreep()), ("m", SecondOrderMode())]
        ),
        "Bouc-Wen": BoucWen(),
        "friction": Dahl(),
        "friction beside a gain": Sum([("g", Gain()), ("f", Dahl())]),
        "curve beside plays": Sum(
            [("p", PrandtlIshlinskii(5)), ("c", SmoothCurve(4, passes=False))]
        ),
        "lag": FirstOrderLag(),
    }
    for name, model in models.items():
        model = model.set_params(**({"dt": dt} if "dt" in model.get_params() else {}))
        response = {"friction": friction, "friction beside a gain": friction + u}.get(name, y)
        fitted = model.fit(X, response)
        yield name, fitted, u[:300]
        compensator = InverseCompensator(fitted).fit(X, response)
        yield f"{name}, compensator", compensator, response[:300]
        loop = FeedforwardPI(0.1, 20.0, compensator=compensator)
        rows = np.stack([reference, y[1:301], u[:300]], axis=1)
        yield f"{name}, feedback with a compensator", loop, rows
    loop = FeedforwardPI(0.1, 20.0, kd=1e-4, filter_time=2e-3, drive_limits=(-2.0, 2.0))
    yield "feedback", loop, np.stack([reference, y[1:301]], axis=1)
    observer = Observer(FirstOrderLag(dt=dt), drift_std=0.1).fit(X, y)
    yield "observer", observer, np.stack([u[:300], reference], axis=1)
    regressors = {
        "NARX, linear": NARXRegressor(LinearRegression(), input_lags=[0, 1], output_lags=[1]),
        "NARX, tree": NARXRegressor(DecisionTreeRegressor(max_depth=4), input_lags=[0, 1]),
        "NARX, SCN": NARXRegressor(SCNRegressor(max_nodes=8, random_state=0), input_lags=[0, 1]),
        "NARMAX": NARMAXRegressor(),
        "gray box": GrayBoxHysteresis(),
    }
    for name, model in regressors.items():
        yield name, model.set_params(dt=dt).fit(X, y), u[:300]
    yield "unknown term", UnknownTerm().fit(X, y), u[:300]
    modal = ModalFeedback(1, n_loops=1, dt=dt)
    yield "modal feedback", modal.fit(X, y[:, None]), X[:300]
    loaded = np.stack([u, np.roll(u, 97)], axis=1)
    of_load = Modulated(Cascade([("p", PrandtlIshlinskii(5)), ("l", FirstOrderLag(dt=dt))]))
    yield "modulated", of_load.fit(loaded, y * (1.0 + 0.1 * loaded[:, 1])), loaded[:300]
    loads = {
        "friction of a load": (CoulombFriction(dt=dt), "coulomb_force"),
        "friction stage of a load": (FrictionStage(dt=dt), "friction"),
        "free mass with friction of a load": (FreeMass(friction=True, dt=dt), "friction"),
    }
    for name, (model, scaled) in loads.items():
        of_load = Modulated(model, 1, scales=[scaled], magnitude=True)
        yield name, of_load.fit(loaded, y), loaded[:300]


def any_drives(u):
    """Return drives by name: random, steps, tiny, large, huge, not finite."""
    rng = np.random.default_rng(1)
    low, high = u.min(axis=0), u.max(axis=0)
    random = rng.uniform(low, high, (100, *u.shape[1:]))
    steps = np.repeat(rng.uniform(low, high, (12, *u.shape[1:])), 8, axis=0)
    wrong = random.copy()
    for k, value in enumerate((np.nan, np.inf, -np.inf)):
        wrong[5 + k :: 9] = value
    return {"random": random, "steps": steps, "tiny": 1e-12 * random} | {
        "large": 30.0 * random,
        "huge": 1e9 * random,
        "not finite": wrong,
    }


def python_answers(stepper, drive):
    """Return what Python answers, which keeps its output where input is refused."""
    device, found = stepper.copy(), []
    for u in drive:
        if np.isfinite(u).all():
            found.append(device.step(u))
        else:  # at first the answer of rest, which C knows
            found.append(device.output if found else np.nan)
    return np.array(found)


def on_any_drive(stepper, u, folder, name, dtype, effect=None):
    """Return the largest error of each drive with its limit, and what the sanitizers say.

    An inverse is judged by the effect of its drive. Limits are twice what rounding the input makes,
    or the drive of an inverse; an error is infinite where C is finite and Python is not, or the
    other way round. Numbers of which the status says that they are beyond the range of the program
    are not judged; within the range of the input there are none.
    """
    header, _, test = to_c(stepper, folder, name, dtype, drive=u)
    by_row = re.search(rf"{name}_step\(.*\*u\)", header.read_text()) is not None
    run, errors, said = sanitized(folder, name, dtype, by_row), {}, ""
    span = float(re.search(TOLD, test.read_text())[2])
    span = span if effect is None else np.ptp(np.append(effect(stepper.copy().run(u)), 0.0))
    effect, eps = effect or np.asarray, np.finfo(dtype).eps
    for kind, drive in any_drives(np.asarray(u, dtype=float)).items():
        drive = drive.astype(dtype).astype(float)
        found, beyond, told = run(drive)
        said += told
        said += " flagged within the range" * bool(kind in ("random", "steps") and beyond.any())
        if len(found) < len(drive):
            errors[kind] = np.inf, 0.0
            continue
        with np.errstate(all="ignore"):
            answer, sign = python_answers(stepper, drive), 1.0 - 2.0 * (np.arange(len(drive)) % 2)
            rounding = 0.5 * eps * sign.reshape(-1, *[1] * (drive.ndim - 1))
            moved = [python_answers(stepper, drive * (1.0 + s * rounding)) for s in (1, -1)]
            moved += [answer * (1.0 + s * 0.5 * eps * sign) for s in (1, -1)]
            moved, expected = [effect(own) for own in moved], effect(answer)
            good = np.isfinite(expected) & ~beyond
            span = max(span, np.ptp(np.append(expected[good], 0.0)))
            error = np.abs(effect(found) - expected)[good].max(initial=0.0) / (span or 1.0)
            allowed = 2.0 * np.abs(np.subtract(moved, expected))[:, good].max(initial=0.0)
        errors[kind] = error if np.isfinite(error) else np.inf, allowed / (span or 1.0)
    return errors, said


def check_any_input(every):
    """Run all programs in floating point with any input, under the sanitizers."""
    found = {}
    said, refused, n = [], [], 0
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)

        def one(name, stepper, u, effect):
            nonlocal n
            for dtype in ("float64", "float32"):
                n += 1
                try:
                    errors, told = on_any_drive(stepper, u, folder, f"a{n}", dtype, effect)
                except (ValueError, NotImplementedError, TypeError) as reason:
                    refused.append(f"{name}, {dtype}: {str(reason)[:90]}")
                    continue
                said.extend([f"{name}, {dtype}: {told[:200]}"] * bool(told))
                for kind, pair in errors.items():
                    found.setdefault((dtype, kind), {})[name] = pair

        for name, stepper, u, _, effect in everything(every):
            one(name, stepper, u, effect)
    for reason in refused:
        print(f"any input, refused: {reason}")
    print(f"any input, {n} programs, C with warnings: nothing found by sanitizers: {verdict(said)}")
    for (dtype, kind), errors in found.items():
        line(f"any input, {dtype}, {kind}", errors, dtype)


def check_controllers(every):
    """Run the programs of models, compensators and controllers on an emulated Cortex-M4F."""
    found = {}
    with tempfile.TemporaryDirectory() as place:
        for k, (name, device, u) in enumerate(itertools.islice(devices(), 0, None, every)):
            for dtype in ("float64", "float32"):
                stepper, program = device.stepper(1e-3), f"e{k}_{dtype}"
                u = np.asarray(u, dtype=dtype).astype(float)
                try:
                    *_, test = to_c(stepper, place, program, dtype, drive=u)
                    controller = EmulatedController(place, program)
                except FileNotFoundError as reason:
                    print(f"Cortex-M4F: {reason}")
                    return
                except (ValueError, RuntimeError) as reason:
                    print(f"Cortex-M4F, {name}, {dtype}: refused: {str(reason)[:90]}")
                    continue
                allowed, span = map(float, re.search(TOLD, test.read_text()).groups())
                expected, counts, answers = python_answers(stepper, u), [], []
                with controller:
                    for value in u:
                        answers.append(controller.step(value))
                        counts.append(controller.instructions)
                error = np.abs(np.subtract(answers, expected)).max() / span
                found.setdefault(dtype, {})[name] = error, allowed
                most = f"{np.mean(counts):.0f} instructions a sample, {max(counts):.0f} at most"
                print(f"Cortex-M4F, {name}, {dtype}: {most}, {error:.2g} of the range", flush=True)
    for dtype, errors in found.items():
        line(f"Cortex-M4F, {dtype}", errors, dtype)


def check_structured_text(every):
    """Run the function blocks of all programs by the translator of the tests."""
    sys.path.insert(0, str(CASES.parent / "export"))
    translator = importlib.import_module("structured_text")
    stepped = [*everything(every)]
    for dtype in ("float64", "float32"):
        errors, stops, refused = {}, [], 0
        with tempfile.TemporaryDirectory() as place:
            for name, stepper, u, *_ in stepped:
                try:
                    files = to_structured_text(stepper, place, "own", dtype, drive=u[:60])
                except ValueError:
                    refused += 1
                    continue
                translator.EXCEPTIONS.clear()
                test = translator.blocks_of(*files)["own_test"]()
                while not test.done:
                    test()
                allowed, span = test.allowed, np.ptp([0.0, *test.outputs]) or 1.0
                errors[name] = test.largest / span, allowed / span
                stops += [name] * bool(translator.EXCEPTIONS)
        exact = sum(error == 0.0 for error, _ in errors.values())
        print(f"Structured Text, {dtype}: {refused} refused, {exact} equal to the last digit")
        print(f"Structured Text, {dtype}: nothing divided by zero: {verdict(stops)}")
        line(f"Structured Text, {dtype}", errors, dtype)


def as_units(system, folder, name):
    """Yield each version of FMI with whether the unit is the program, and what FMPy finds."""
    import fmpy
    from fmpy.validation import validate_fmu

    step, begin = library(folder, f"{name}_float64", "float64")
    u, dt = system.u, system.stepper.dt
    signal = np.rec.fromarrays([dt * np.arange(len(u)), u], names="time,input")
    for version in ("2.0", "3.0"):
        begin()
        expected = [step(value) for value in u]
        path = to_fmu(system.stepper, folder / f"{name}.fmu", version, u0=float(u[0]))
        stop = dt * len(u)
        found = fmpy.simulate_fmu(str(path), stop_time=stop, output_interval=dt, input=signal)
        yield np.array_equal(found["output"][1:], expected), validate_fmu(str(path))


CHECKED = (
    *("sizes", "types", "integers", "tunable", "any-input", "emulated", "structured-text", "speed"),
)


def verdict(missed):
    """Say whether a bar was kept, and by whom it was not."""
    return "kept" if not missed else f"MISSED by {', '.join(missed)}"


def check_types(every, is_simulated):
    """Compare programs in all types with Python, and functional mock-up units with them."""
    errors, unlike, findings, n_units = {}, [], [], 0
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for k, system in enumerate(systems(every)):
            group = "inverses" if system.is_inverse else "operators"
            for dtype in BARS:
                try:
                    error = in_type(system, dtype, folder, f"c{k}_{dtype}")
                except ValueError as reason:
                    print(f"{group}, {system.name}, {dtype}: refused: {reason}", flush=True)
                else:
                    errors.setdefault((group, dtype), {})[system.name] = error
            if is_simulated and not system.is_inverse:
                for same, found in as_units(system, folder, f"c{k}"):
                    n_units += 1
                    unlike += [] if same else [system.name]
                    findings += [f"{system.name}: {text}" for text in found]
        report(errors)
        if is_simulated:
            print(f"FMU, {n_units} units: equal to C to the last bit: {verdict(unlike)}")
            print(f"FMU, {n_units} units: FMPy's validation without a finding: {verdict(findings)}")
        check_rules(folder)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=200_000, help="of the timing")
    parser.add_argument("--no-fmu", action="store_true", help="leave units out")
    parser.add_argument("--every", type=int, default=1, help="run one system in so many")
    parser.add_argument("--only", choices=CHECKED, help="one of the checks alone")
    options = parser.parse_args()
    if shutil.which("cc") is None:
        sys.exit("There is no C compiler.")
    every = options.every
    checks = {
        "sizes": check_sizes,
        "types": lambda: check_types(every, not options.no_fmu),
        "integers": lambda: check_integers(every),
        "tunable": lambda: check_tunable(every),
        "any-input": lambda: check_any_input(every),
        "emulated": lambda: check_controllers(every),
        "structured-text": lambda: check_structured_text(every),
        "speed": lambda: print(
            f"20 plays in C: {formatted(in_c(PLAYS, options.samples, 7), 'ns', C_LIMIT)} a sample"
        ),
    }
    for check in [options.only] if options.only else CHECKED:
        checks[check]()


def _response(operator, at_rest, drive):
    return operator.run(drive, 1e-3, at_rest)[0]


def everything(every):
    """Yield name, stepper at rest, input from there, and whether it is an inverse, of all programs.

    Last comes the effect of the drive of an inverse or compensator without a preview, else None.
    """
    for system in systems(every):
        name = f"{system.name}{', inverse' * system.is_inverse}"
        effect = system.effect if system.is_inverse and not system.ahead else None
        yield name, system.stepper, system.u, system.is_inverse, effect
    for name, device, u in itertools.islice(devices(), 0, None, every):
        u = np.append(0.0 * u[:1], u, axis=0)
        stepper = device.stepper(1e-3)
        effect = None
        if isinstance(device, InverseCompensator) and not stepper.preview:
            operator = device.model_.operator_
            at_rest = operator.init(float(stepper.copy().step(0.0)))
            effect = partial(_response, operator, at_rest)
        yield name, stepper, u, "compensator" in name, effect


def check_integers(every):
    """Run all programs in integers with any input."""
    errors, not_held, findings, n, branches, others = {}, [], [], 0, np.zeros(2, dtype=int), []
    with tempfile.TemporaryDirectory() as place:
        for k, (name, stepper, u, is_inverse, _) in enumerate(everything(every)):
            try:
                *error, own, held, told = in_integers(stepper, u, Path(place), f"i{k}")
            except ValueError as reason:
                print(f"integers, {name}: refused: {str(reason)[:90]}", flush=True)
                continue
            n += 1
            branches += own[:2]
            others += [f"{name} ({own[2]})"] if own[2] else []
            not_held += [] if held else [name]
            findings += [f"{name}: {told[:200]}"] if told else []
            if not is_inverse:  # which need not reach what is asked
                errors[name] = error
    print(f"integers, any input, {n} programs: nothing found by sanitizers: {verdict(findings)}")
    print(
        f"integers, any input, {n} programs: input beyond is held, and flagged: {verdict(not_held)}"
    )
    taken, there_are = branches
    print(f"integers, {taken} of {there_are} branches have a test vector: {verdict(others)}")
    line("integers, fast drives within the range", errors, "int32")


def check_tunable(every):
    """Change each parameter of each operator at run time and compare with the operator that has it.

    The test of a program does: it is compared with the response of the changed operator in Python.
    """
    missed, refused, n = [], {}, 0
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for k, system in enumerate(systems(every)):
            names = dict.fromkeys(name.partition("[")[0] for name, _ in system.operator.entries())
            for name in names if not system.is_inverse else ():
                options = {"dt": system.stepper.dt, "drive": system.u[:100], "tunable": [name]}
                try:
                    to_c(system.operator, folder, f"t{k}_{name}", **options)
                except ValueError as reason:
                    refused.setdefault(str(reason)[:70], []).append(name)
                    continue
                n += 1
                sources = [f"t{k}_{name}.c", f"t{k}_{name}_test.c", "-o", "tuned", "-lm"]
                command = ["cc", "-std=c99", *STRICT, *SANITIZED, *sources]
                subprocess.run(command, cwd=folder, check=True)
                done = subprocess.run(folder / "tuned", capture_output=True, text=True)
                missed += [f"{system.name}, {name}"] * (done.returncode or bool(done.stderr))
        check_rules(folder)
    for reason, names in refused.items():
        print(f"changed at run time, {len(names)} refused: {reason}")
    print(
        f"changed at run time, {n} parameters, equal to the operator with them: {verdict(missed)}"
    )


def check_rules(folder):
    """Run cppcheck over the programs in a folder."""
    if shutil.which("cppcheck") is None:
        return
    sources = sorted(path.name for path in folder.glob("*.c") if "_test" not in path.name)
    sources.remove("main.c") if "main.c" in sources else None
    unkept = re.search(UNKEPT, (folder / sources[0]).with_suffix(".h").read_text())[1]
    unkept = {f"misra-c2012-{rule}" for rule in re.findall(r"\d+\.\d+", unkept)}
    command = ["cppcheck", *CHECKS, *sources]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    said = re.findall(r"^\S+: .* \[\S+\]$", done.stderr, re.M)
    said = [text for text in said if text.split("[")[-1][:-1] not in unkept]
    said = [*said[:3], f"{len(said)} findings"] if said else []
    print(f"cppcheck, {len(sources)} programs, no required rule of MISRA broken: {verdict(said)}")


def check_sizes():
    """Tell the memory and the time of programs on controllers, and whether they are small."""
    sys.path.insert(0, str(CASES))
    cases = importlib.import_module("operator_cases")
    plays = PrandtlIshlinskiiOperator([0.0, 0.3, 0.5], [1.0, 0.5, 0.2])
    wires = BoucWenOperator(0.4, 0.7, 0.31, 1.3, 0.7, 0.2, 0.1)
    friction = RootInverseOperator(cases.OPERATORS["Dahl friction"], -2.0, 2.0)
    units = {"input_unit": 2.0**-20, "output_unit": 2.0**-20}
    programs = [
        *(("3 plays", plays, dtype, {}) for dtype in BARS),
        ("Bouc-Wen, table", wires, "float64", {}),
        *(("Bouc-Wen, step", wires, d, {"form": "step"}) for d in ("float64", "float32")),
        *(("inverse of Dahl friction", friction, d, {}) for d in ("float64", "float32")),
        ("PI feedback", FeedforwardPI(0.3, 20.0, drive_limits=(-1.0, 1.0)), "float32", {}),
    ]
    u = cases.make_drive()[:100]
    with tempfile.TemporaryDirectory() as place:
        for k, (name, own, dtype, more) in enumerate(programs):
            more = more | (units if dtype == "int32" else {})
            drive = np.stack([u, 0.9 * u], axis=1) if name == "PI feedback" else u
            to_c(own, place, f"s{k}", dtype, dt=cases.DT, drive=drive, **more)
            sizes = program_sizes(place, f"s{k}")
            print(f"{name}, {dtype}:\n{sizes.to_string()}", flush=True)
            if "form" in more:
                print(f"{name}, {dtype}, at most 1500 bytes: {verdict(_larger(sizes, 1500))}")


def _larger(sizes, most):
    return [f"{target} ({size:.0f})" for target, size in sizes["flash"].items() if size > most]


def report(errors):
    """Print what was found of each type of each group."""
    for (group, dtype), found in errors.items():
        right = {name: (error, 0.0) for name, (error, *_) in found.items()}
        if group == "operators":
            line(f"{group}, {dtype}", right, dtype)
            continue
        right = {name: pair for name, pair in right.items() if pair[0] <= BARS[dtype]}
        others = {name: own[2:] for name, own in found.items() if name not in right}
        for what, pairs in {"the drive": right, "what the drive does": others}.items():
            if pairs:
                line(f"{group}, {dtype}, {what}", pairs, dtype)


def line(what, found, dtype):
    """Print how many errors there are, the one nearest to its limit, and which are above it."""
    bar, unit = BARS[dtype], UNITS[dtype]
    limits = {name: max(bar, allowed) for name, (_, allowed) in found.items()}
    worst = max(found, key=lambda name: found[name][0] / limits[name])
    moved = sum(limit > bar for limit in limits.values())
    missed = [
        f"{n} ({e:.2g}; {limits[n]:.2g})" for n, (e, _) in found.items() if not e <= limits[n]
    ]
    also = f", or twice what rounding makes of {moved} of them" if moved else ""
    print(
        f"{what}: {len(found)}, worst {found[worst][0]:.3g} {unit} ({worst}, {limits[worst]:.2g}); "
        f"at most {bar:g}{also}: {verdict(missed)}"
    )


if __name__ == "__main__":
    main()
