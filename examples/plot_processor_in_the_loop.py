"""
A controller in the loop that is not this computer
==================================================

Before a program is flashed, it is to be seen on its processor: does it give the numbers of Python
there, and how many instructions does a sample take? Here the compensator and the feedback of a
scanning stage run on an emulated ARM Cortex-M4F, compiled by its compiler, and close the loop of
the simulated stage sample by sample, over the serial port of the emulated board.
"""

# %%
# The stage and its controller
# ----------------------------
# The stage of :ref:`sphx_glr_auto_examples_plot_scanning_triangle.py`: hysteresis, creep, and
# vibration that is identified from a small signal. The compensator needs a preview.

import sys
import tempfile

import matplotlib.pyplot as plt
import numpy as np
from sklearn.frozen import FrozenEstimator

from skhyst.compose import Cascade
from skhyst.control import FeedforwardPI, InverseCompensator
from skhyst.datasets import make_scanning_stage, scanning_stage_stepper
from skhyst.export import EmulatedController, to_c
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import KelvinVoigt, TransferFunction, frequency_response

DT = 4e-6  # s

small = make_scanning_stage("small_signal", random_state=1)[:2]
measured = frequency_response(*small).compensate_hold().restrict(100.0, 60e3)
vibration = TransferFunction(9, n_zeros=3).fit_frequency_response(measured)
X, y, _ = make_scanning_stage("identification", random_state=0)
stages = {
    "hysteresis": PrandtlIshlinskii(5, fit_intercept=False),
    "creep": KelvinVoigt(2),
    "vibration": FrozenEstimator(vibration),
}
model = Cascade(list(stages.items())).fit(X, y)
compensator = InverseCompensator(model, bandwidth=20e3, rate_limit=2e6).fit(X, y)  # V/s
gain = np.polyfit(X.loc["1 Hz", "drive"], y.loc["1 Hz"], 1)[0]
feedback = FeedforwardPI(0.1 / gain, 2.0 * np.pi * 1500.0 / gain, compensator=compensator)

# %%
# The loop
# --------
# It takes anything with a ``step``. The reading of a sample gives the drive of the next interval;
# the reference comes early by the preview. The reference is a triangle of 500 Hz with rounded
# corners; glue that has softened since the recording makes the stage creep by 5 % more.

n = round(1.0 / (500.0 * DT))
slope = np.sign(np.cos(2.0 * np.pi * np.arange(n) / n)) * 4.0 / n
slope = np.concatenate([np.zeros(n // 4), slope, np.zeros(n // 4)])
reference = np.cumsum(np.convolve(slope, np.full(n // 20, 20.0 / n), mode="same"))
time = 1e3 * DT * np.arange(len(reference))  # ms
preview = compensator.stepper(DT).preview


def closed_loop(feedback, compensator, dtype):
    """Return the drive and the response of the stage, with converters of a type."""
    stage = scanning_stage_stepper(effects={"creep": 0.05})
    early = np.append(reference, np.full(preview + 1, reference[-1])).astype(dtype)
    for value in early[:preview]:
        compensator.step(value)
    drive, response, reading = np.empty(len(reference)), np.empty(len(reference)), 0.0
    for k, wanted in enumerate(reference):
        row = wanted, reading, compensator.step(early[k + preview])
        drive[k] = feedback.step(np.array(row, dtype=dtype))
        response[k] = reading = stage.step(drive[k])
    return drive, response


in_python = {
    dtype: closed_loop(feedback.stepper(DT), compensator.stepper(DT), dtype)
    for dtype in ("float64", "float32")
}

# %%
# The same on the controller
# --------------------------
# Both parts are written as C, compiled for the processor and run there. Without its compiler and
# QEMU the example ends here; :class:`~skhyst.export.EmulatedController` says what to install. A
# Cortex-M4F computes in single precision; its double precision is software.


def on_controller(folder, dtype):
    """Return drive and response with the controller in the loop, and instructions of a sample."""
    parts = {"feedback": feedback, "compensator": compensator}
    for name, part in parts.items():
        to_c(part, folder, f"{name}_{dtype}", dtype, dt=DT, tolerance=1e-5)  # of the range
    with (
        EmulatedController(folder, f"feedback_{dtype}") as loop,
        EmulatedController(folder, f"compensator_{dtype}") as inverse,
    ):
        return closed_loop(loop, inverse, dtype), loop.instructions + inverse.instructions


results = {}
with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
    for dtype in in_python:
        try:
            results[dtype], count = on_controller(folder, dtype)
        except FileNotFoundError as reason:
            print(f"{reason} The loop has run in Python alone.")
            sys.exit()
        print(f"{dtype}: {count:.0f} instructions for a sample")


def change(one, other):
    """Return the largest difference of two drives and of two responses, as parts of the ranges."""
    return [np.abs(a - b).max() / np.ptp(b) for a, b in zip(one, other, strict=True)]


for dtype, found in results.items():
    told = "drive {:.1e}, response {:.1e} of the range".format(*change(found, in_python[dtype]))
    print(f"{dtype}, controller and Python on the same numbers: {told}")
told = "drive {:.1e}, response {:.1e}".format(*change(in_python["float32"], in_python["float64"]))
print(f"input in single instead of double precision: {told}")

# %%
# In double precision the controller gives the numbers of Python to the last digit (a difference of
# zero is drawn at 1e-13 nm). In single precision the last digit, of the reference and of what is
# computed from it, is differentiated by the inverse of the vibration: the response changes by up to
# the sensor's noise of 0.5 nm, in Python as on the controller. At a tenth of the instructions it is
# still a fiftieth of the error that the loop leaves.

figure, axes = plt.subplots(2, sharex=True, figsize=(8.0, 5.0), layout="constrained")
wanted = in_python["float64"][1]
axes[0].plot(time, 1e3 * (wanted - reference))
axes[0].set(ylabel="error (nm)", title="response minus reference")
for dtype, (_, response) in results.items():
    difference = 1e3 * np.abs(response - wanted)
    axes[1].plot(time, np.maximum(difference, 1e-13), label=f"controller, {dtype}")
axes[1].axhline(0.5, color="k", ls="--", lw=0.8, label="noise of the sensor")
axes[1].set(ylabel="difference (nm)", xlabel="time (ms)", title="response minus that in Python")
axes[1].set(yscale="log")
axes[1].legend(fontsize="small")
plt.show()
