"""Compare exported programs with Python: `python benchmarks/bench_export.py`.

Every operator of the acceptance test that can be stepped, and every inverse of one, answers a drive
as C in double and single precision and in integers, and as a functional mock-up unit. An inverse is
told apart where rounding its input moves its answers by more than the bar, as on flat parts of the
law, where every drive is right. cppcheck is run where it is found.
"""

import argparse
import ctypes
import importlib
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from bench_stepping import C_LIMIT, PLAYS, in_c, told

from skhyst.export import to_c, to_fmu
from skhyst.operators import inverse_of

BARS = {"float64": 1e-12, "float32": 1e-6, "int32": 1.0}
UNITS = {"float64": "of the range", "float32": "of the range", "int32": "units"}
COUNTS = 2.0**20  # units of the range of input and output, in integers
CHECKS = ("--std=c99", "--enable=warning,performance,portability", "--error-exitcode=1", "-q")
CASES = Path(__file__).parents[1] / "tests" / "operators"  # of operator_cases


def systems():
    """Yield group, name, operator and input of all that is exported, and the sampling interval."""
    sys.path.insert(0, str(CASES))
    cases = importlib.import_module("operator_cases")
    u = cases.make_drive()
    for name, operator in cases.OPERATORS.items():
        if operator.causal:
            yield "operators", name, operator, u, cases.DT
        y = operator.run(u, cases.DT, operator.init(u[0]))[0]
        try:
            inverse = inverse_of(operator)
            if inverse.causal:
                inverse.lowered(cases.DT, inverse.init(float(y[0])))
                yield "inverses", name, inverse, y, cases.DT
        except (NotImplementedError, ValueError):
            continue  # it has none, or one that looks ahead


def in_types(operator, u, dt, folder, name):
    """Yield each type with the error of its program, and the error that it allows."""
    y = operator.run(u, dt, operator.init(float(u[0])))[0]
    units = {
        "input_unit": (np.ptp(u) or 1.0) / COUNTS,
        "output_unit": (np.ptp(y) or 1.0) / COUNTS,
    }
    for dtype in BARS:
        more = units if dtype == "int32" else {}
        to_c(operator, folder, f"{name}_{dtype}", dtype, dt=dt, u0=float(u[0]), drive=u, **more)
        sources = [f"{name}_{dtype}.c", f"{name}_{dtype}_test.c"]
        command = ["cc", "-std=c99", "-O2", *sources, "-o", "program", "-lm"]
        subprocess.run(command, cwd=folder, check=True)
        done = subprocess.run(["./program"], cwd=folder, capture_output=True, text=True)
        yield dtype, *map(float, re.search(r": (\S+) of .*, (\S+) allowed", done.stdout).groups())


def as_units(operator, u, dt, folder, name):
    """Yield each version of FMI with whether the unit is the program, and what FMPy finds."""
    import fmpy
    from fmpy.validation import validate_fmu

    library = f"{name}.so"
    command = ["cc", "-std=c99", "-O2", "-shared", "-fPIC", f"{name}_float64.c", "-o", library]
    subprocess.run([*command, "-lm"], cwd=folder, check=True)
    program = ctypes.CDLL(str(folder / library))
    step = program[f"{name}_float64_step"]
    step.argtypes, step.restype = [ctypes.c_void_p, ctypes.c_double], ctypes.c_double
    state = ctypes.create_string_buffer(1 << 20)
    signal = np.rec.fromarrays([dt * np.arange(len(u)), u], names="time,input")
    for version in ("2.0", "3.0"):
        program[f"{name}_float64_init"](state)
        expected = [step(state, value) for value in u]
        path = to_fmu(operator, folder / f"{name}.fmu", version, dt=dt, u0=float(u[0]))
        stop = dt * len(u)
        found = fmpy.simulate_fmu(str(path), stop_time=stop, output_interval=dt, input=signal)
        yield np.array_equal(found["output"][1:], expected), validate_fmu(str(path))


def verdict(missed):
    """Say whether a bar was kept, and by whom it was not."""
    return "kept" if not missed else f"MISSED by {', '.join(missed)}"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=200_000, help="of the timing")
    parser.add_argument("--no-fmu", action="store_true", help="leave units out")
    options = parser.parse_args()
    if shutil.which("cc") is None:
        sys.exit("There is no C compiler.")
    errors, unlike, findings, n_units = {}, [], [], 0
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for k, (group, name, operator, u, dt) in enumerate(systems()):
            try:
                for dtype, error, allowed in in_types(operator, u, dt, folder, f"c{k}"):
                    errors.setdefault((group, dtype), {})[name] = error, allowed
            except ValueError as error:
                print(f"{group}, {name}: refused: {error}")
                continue
            if group == "operators" and not options.no_fmu:
                for same, found in as_units(operator, u, dt, folder, f"c{k}"):
                    n_units += 1
                    unlike += [] if same else [name]
                    findings += [f"{name}: {text}" for text in found]
        report(errors)
        if not options.no_fmu:
            print(f"FMU, {n_units} units: equal to C to the last bit: {verdict(unlike)}")
            print(f"FMU, {n_units} units: FMPy's validation without a finding: {verdict(findings)}")
        if shutil.which("cppcheck"):
            sources = sorted(path.name for path in folder.glob("*.c") if "_test" not in path.name)
            command = ["cppcheck", *CHECKS, *sources]
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
            said = done.stderr.strip().splitlines()[:3]
            print(f"cppcheck, {len(sources)} programs without a finding: {verdict(said)}")
    print(f"20 plays in C: {told(in_c(PLAYS, options.samples, 7), 'ns', C_LIMIT)} a sample")


def report(errors):
    """Print each type of each group: how many, the worst, and whether the bar was kept."""
    for (group, dtype), found in errors.items():
        bar = BARS[dtype]
        free = {name for name, (_, allowed) in found.items() if allowed > bar}
        free = free if group == "inverses" else set()
        bound = {name: error for name, (error, _) in found.items() if name not in free}
        worst = max(bound, key=bound.get)
        missed = [name for name, error in bound.items() if not error <= bar]
        print(
            f"{group}, {dtype}: {len(bound)}, worst {bound[worst]:.3g} {UNITS[dtype]} ({worst}); "
            f"at most {bar:g}: {verdict(missed)}"
        )
        beyond = [n for n in sorted(free) if not found[n][0] <= found[n][1]]
        if free:
            print(
                f"    {len(free)} whose answers rounding of the input moves by more than that "
                f"({', '.join(sorted(free))}): within twice what it does: {verdict(beyond)}"
            )


if __name__ == "__main__":
    main()
