"""Time a model that is fed sample by sample: from Python, in a compiled loop, and as C.

Run from the root of the project::

    python benchmarks/bench_stepping.py [--samples 200000] [--repeats 7]

Each line is the least of the repetitions, beside its limit where there is one. C is left out where
there is no compiler.
"""

import argparse
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

from skhyst.export import to_c
from skhyst.hysteresis import BoucWenOperator, LuGreOperator, PrandtlIshlinskiiOperator
from skhyst.linear import SecondOrderModeOperator
from skhyst.operators import SeriesOperator, Stepper, inverse_of

DT = 1e-4  # s
CALL_LIMIT, LOOP_LIMIT, C_LIMIT = 3.0, 100.0, 100.0  # us; ns; ns, of 20 plays
PLAYS = PrandtlIshlinskiiOperator(np.linspace(0.0, 3.8, 20), np.full(20, 0.1))
MODE = SecondOrderModeOperator(2.0 * np.pi * 400.0, 0.02)
OPERATORS = {
    "20 plays": PLAYS,
    "20 plays and a mode": SeriesOperator(("plays", "mode"), (PLAYS, MODE)),
    "Bouc-Wen": BoucWenOperator(0.4, 0.7, 0.31, 0.6, 1.0, 0.0, 0.1),
    "LuGre friction": LuGreOperator(0.11, 2.3, 0.6, 0.8, 0.03, 0.3, 0.02, 0.1),
}
LOOP = """
#include <stdio.h>
#include <time.h>
#include "device.h"
int main(void)
{
    static device_state state;
    static double u[%(n)d];
    double sum = 0.0, best = 1e9;
    for (long k = 0; k < %(n)d; k++) {
        u[k] = 4.0 * (double)((k * 2654435761UL) %% 1000003UL) / 1000003.0;
    }
    for (int r = 0; r < %(repeats)d; r++) {
        device_init(&state);
        clock_t begin = clock();
        for (long k = 0; k < %(n)d; k++) {
            sum += device_step(&state, u[k]);
        }
        double seconds = (double)(clock() - begin) / CLOCKS_PER_SEC;
        best = seconds < best ? seconds : best;
    }
    printf("%%g %%g\\n", 1e9 * best / %(n)d, sum);
    return 0;
}
"""


def least(work, repeats):
    """Return the shortest time that some work took, in s."""
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return min(times)


def in_c(operator, samples, repeats):
    """Return ns a sample of the C program, None without a compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        to_c(operator, folder, "device", dt=DT)
        main, program = Path(folder, "main.c"), Path(folder, "main")
        main.write_text(LOOP % {"n": samples, "repeats": repeats})
        sources = [str(Path(folder, "device.c")), str(main)]
        subprocess.run(
            [compiler, "-std=c99", "-O2", "-o", str(program), *sources, "-lm"], check=True
        )
        found = subprocess.run([str(program)], check=True, capture_output=True, text=True)
    return float(found.stdout.split()[0])


def told(value, unit, limit=None):
    """Format a time beside its limit."""
    if value is None:
        return "no compiler"
    verdict = f" (at most {limit:g}: {'kept' if value <= limit else 'MISSED'})" if limit else ""
    return f"{value:.2f} {unit}{verdict}"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=200_000)
    parser.add_argument("--repeats", type=int, default=7)
    options = parser.parse_args()
    u = 4.0 * np.random.default_rng(0).uniform(size=options.samples)
    few = u[:20_000].tolist()
    for name, operator in OPERATORS.items():
        stepper = Stepper(operator.lowered(DT, operator.init(0.0)))
        stepper.run(u[:10]), stepper.step(0.0)  # compiles
        call = least(lambda s=stepper: [s.step(value) for value in few], options.repeats)
        loop = least(lambda s=stepper: s.run(u), options.repeats)
        limits = (CALL_LIMIT, LOOP_LIMIT, C_LIMIT) if name == "20 plays" else (None,) * 3
        parts = [
            "a call " + told(1e6 * call / len(few), "us", limits[0]),
            "a sample " + told(1e9 * loop / len(u), "ns", limits[1]),
            "in C " + told(in_c(operator, options.samples, options.repeats), "ns", limits[2]),
        ]
        y, _ = operator.run(u[:20_000], DT)
        inverse = inverse_of(operator)
        inverse.run(y[:10], DT)
        seconds = least(lambda i=inverse, r=y: i.run(r, DT), options.repeats)
        parts.append(f"inverse {told(1e9 * seconds / len(y), 'ns')} a sample")
        print(f"{name}: " + ", ".join(parts), flush=True)


if __name__ == "__main__":
    main()
