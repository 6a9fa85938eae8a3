"""Compile exported programs and run their tests: `python tools/compile_exports.py clang -O2`.

The arguments are the compiler and its options. Programs are those of all operators of the
acceptance test in double precision, and of every fourth one in single precision and in integers.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "operators"))
from operator_cases import DT, OPERATORS, make_drive

from skhyst.export import to_c


def written(folder):
    """Write programs and return their names."""
    u, names = make_drive(), []
    for k, operator in enumerate(OPERATORS.values()):
        units = {}
        for dtype in ("float64", "float32", "int32")[: 3 if k % 4 == 0 else 1]:
            if dtype == "int32":
                span = np.ptp(operator.run(u, DT, operator.init(u[0]))[0]) or 1.0
                units = {"input_unit": 2.0**-20, "output_unit": 2.0**-20 * span}
            try:
                to_c(operator, folder, f"c{k}_{dtype}", dtype, dt=DT, u0=u[0], drive=u, **units)
            except (NotImplementedError, ValueError):
                continue  # refused, which the tests look at
            names.append(f"c{k}_{dtype}")
    return names


def main():
    compiler = sys.argv[1:] or ["cc"]
    failed = []
    with tempfile.TemporaryDirectory() as folder:
        names = written(folder)
        libraries = [] if sys.platform == "win32" else ["-lm"]
        for name in names:
            program = str(Path(folder, f"{name}.exe"))
            sources = [f"{name}.c", f"{name}_test.c", "-o", program, *libraries]
            done = subprocess.run([*compiler, *sources], cwd=folder)
            if done.returncode == 0 and "-c" not in compiler:
                done = subprocess.run([program], capture_output=True, text=True)
                print(done.stdout, end="")
            failed += [name] if done.returncode else []
    print(f"{len(names)} programs, failed: {', '.join(failed) or 'none'}")
    sys.exit(bool(failed))


if __name__ == "__main__":
    main()
