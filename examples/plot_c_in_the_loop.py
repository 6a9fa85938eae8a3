"""
From a recording to a controller in C
=====================================

A positioning stage has hysteresis and creep. A model is fitted, inverted, exported as C, compiled,
and called in a closed loop, in double and single precision and in integers: how much accuracy is
lost, and how long does a sample take?
"""

# %%
# A recording
# -----------
# The stage is simulated here and shares no code with the package: sixty plays, and creep by seven
# relaxations with time constants from 10 ms to 10 s. It is sampled at 500 Hz; its sensor has a
# noise of 2 nm.

import ctypes
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from skhyst.compose import Cascade
from skhyst.control import FeedforwardPI, InverseCompensator, simulate_loop
from skhyst.export import to_c
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import LogCreep

DT, NOISE = 2e-3, 2e-3  # s, um
TIMES = np.logspace(-2, 1, 7)  # s


class Stage:
    """Moves by um at a drive in V."""

    def __init__(self, gain=1.0):
        self.gain = gain
        self.plays, self.relaxed = np.zeros(60), np.zeros(7)

    def step(self, drive):
        """Return the position one sample later."""
        thresholds = np.linspace(0.0, 45.0, 60)
        self.plays = np.maximum(drive - thresholds, np.minimum(drive + thresholds, self.plays))
        prompt = 0.08 * drive + 0.001 * self.plays.sum()
        self.relaxed += -np.expm1(-DT / TIMES) * (prompt - self.relaxed)
        return self.gain * (prompt + 0.01 * self.relaxed.sum())


rng = np.random.default_rng(0)
clock = DT * np.arange(5000)
swell = np.sin(2 * np.pi * 0.11 * clock)
drive = 50.0 * swell * np.sin(2 * np.pi * 0.7 * clock) + 20.0 * np.sign(np.sin(2.0 * clock)) * swell
stage = Stage()
position = np.array([stage.step(u) for u in drive]) + NOISE * rng.normal(size=len(drive))

model = Cascade([("plays", PrandtlIshlinskii(30)), ("creep", LogCreep())], dt=DT)
model.fit(drive[:, None], position)
residual = np.std(model.predict(drive[:, None]) - position)
print(f"residual {1e3 * residual:.1f} nm of a range of {np.ptp(position):.1f} um")

# %%
# The programs
# ------------
# The compensator is the inverse model: creep is inverted by root finding at each sample, plays in
# closed form. In C it is a structure with its state and a function for one sample. Integers are in
# units of the resolution of 20-bit converters. Without a C compiler, the example ends here.

COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
if COMPILER is None:
    print("There is no C compiler: nothing to compare.")
    sys.exit()
TYPES = {"float64": ctypes.c_double, "float32": ctypes.c_float, "int32": ctypes.c_int32}
VOLT, MICRON = 200.0 / 2**20, 20.0 / 2**20  # a step of the converters
LOOP = """
#include "inverse.h"

void run(inverse_state *state, const TYPE *u, TYPE *y, int n)
{
    for (int k = 0; k < n; k++) {
        y[k] = inverse_step(state, u[k]);
    }
}
"""


class Program:
    """A compensator as compiled C, with the `step` of a stepper."""

    def __init__(self, compensator, dtype, folder):
        self.type, self.units = TYPES[dtype], (1.0, 1.0)
        more = {}
        if dtype == "int32":
            self.units = MICRON, VOLT
            more = {"input_unit": MICRON, "output_unit": VOLT, "drive": position[::25]}
        to_c(compensator, folder, "inverse", dtype, **more)
        kind = {"int32": "int32_t", "float32": "float"}.get(dtype, "double")
        Path(folder, "run.c").write_text(LOOP.replace("TYPE", kind))
        command = [COMPILER, "-std=c99", "-O2", "-shared", "-fPIC", "run.c", "inverse.c"]
        subprocess.run([*command, "-o", f"{dtype}.so", "-lm"], cwd=folder, check=True)
        self.library = ctypes.CDLL(str(Path(folder, f"{dtype}.so")))
        self.state = ctypes.create_string_buffer(1 << 16)
        self.library.inverse_step.argtypes = [ctypes.c_void_p, self.type]
        self.library.inverse_step.restype = self.type
        self.library.inverse_init(self.state)

    def step(self, value):
        """Return the output for one sample."""
        value = value / self.units[0]
        value = round(value) if self.type is ctypes.c_int32 else value
        return self.units[1] * self.library.inverse_step(self.state, value)

    def seconds(self, values):
        """Return the time per sample (s) of a loop in C."""
        values = np.round(values / self.units[0]) if self.type is ctypes.c_int32 else values
        values = np.ascontiguousarray(values, dtype=np.dtype(self.type))
        pointer = ctypes.POINTER(self.type)
        into = np.empty_like(values).ctypes.data_as(pointer)
        begun = time.perf_counter()
        self.library.run(self.state, values.ctypes.data_as(pointer), into, len(values))
        return (time.perf_counter() - begun) / len(values)


class Streamed:
    """A compensator that is fed the reference sample by sample."""

    def __init__(self, step):
        self.step = step

    def drive_for(self, reference, dt):
        """Return the drive (n_samples,)."""
        return np.array([self.step(value) for value in reference])


compensator = InverseCompensator(model, drive_limits=(-80.0, 80.0)).fit(drive[:, None], position)

# %%
# The loop
# --------
# The reference is a triangle, then steps. The gain of the stage is now 2 % lower than when it was
# recorded. With a constant gain alone the error is several per cent; the compensator removes
# hysteresis and creep, and feedback removes the remaining error.

clock = DT * np.arange(3000)
triangle = 3.0 * np.abs((2.0 * clock + 1.0) % 4.0 - 2.0) - 3.0
reference = np.where(clock < 4.0, triangle, np.select([clock < 5.0], [2.0], -1.0))
gain = np.polyfit(drive, position, 1)[0]


def loop(compensator, ki=0.0):
    """Return the loop of the stage with a compensator and integral feedback."""
    controller = FeedforwardPI(0.0, ki, compensator=compensator)
    return simulate_loop(Stage(0.98), controller, reference, DT, noise=NOISE, random_state=1)


variants = {
    "the gain alone": loop(Streamed(lambda r: r / gain)),
    "compensator": loop(Streamed(compensator.stepper().step)),
    "compensator and feedback": loop(Streamed(compensator.stepper().step), ki=200.0),
}
for name, found in variants.items():
    error = np.std(found.response - reference)
    print(f"{name}: {1e3 * error:.0f} nm ({100 * error / np.ptp(reference):.2g} % of the range)")

# %%
# The same loop with each program instead of the compensator in Python. Double precision gives the
# same numbers; the changes by single precision and integers are far below the noise of the sensor.
# Integers are for machines without floating point: on this one they take the longest.

changes = {}
stepper = compensator.stepper()
begun = time.perf_counter()
for value in reference:
    stepper.step(value)
print(f"Python: {1e9 * (time.perf_counter() - begun) / len(reference):.0f} ns per sample")
with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
    for dtype in TYPES:
        program = Program(compensator, dtype, folder)
        found = loop(Streamed(program.step), ki=200.0)
        changes[dtype] = np.abs(found.response - variants["compensator and feedback"].response)
        print(
            f"{dtype}: the position changes by {1e3 * changes[dtype].max():.2g} nm at most; "
            f"{1e9 * program.seconds(reference):.0f} ns per sample"
        )

colours = dict(zip(variants, ("tab:blue", "tab:orange", "tab:green"), strict=True))
legend = {"loc": "center left", "bbox_to_anchor": (1.0, 0.5), "frameon": False}
fig, axes = plt.subplots(3, sharex=True, figsize=(9, 7), layout="constrained")
for name, found in variants.items():
    axes[0].plot(clock, found.response, color=colours[name], label=name)
    error = 1e3 * np.abs(found.response - reference)
    axes[1].plot(clock, error, color=colours[name], label=name)
axes[0].plot(clock, reference, "k--", lw=1, label="reference")
axes[0].set(ylabel="position (um)")
axes[1].set(yscale="log", ylabel="error (nm)", ylim=(0.1, None))
for dtype, colour in (("int32", "tab:red"), ("float32", "tab:purple")):
    axes[2].plot(clock, 1e3 * changes[dtype], color=colour, lw=0.8, label=f"C, {dtype}")
axes[2].plot([], [], " ", label="C, float64: none")
axes[2].set(yscale="log", ylabel="change by the type (nm)", xlabel="time (s)", ylim=(1e-6, 10.0))
for ax in axes[1:]:
    ax.axhline(1e3 * NOISE, color="k", ls=":", label="noise of the sensor")
for ax in axes:
    ax.legend(**legend)
plt.show()
