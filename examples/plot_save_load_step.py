"""
A model that is saved, loaded and stepped
=========================================

A model is fitted once, in the laboratory, and used sample by sample elsewhere. Loading its file
does not execute anything in it.
"""

# %%
# Fit and save
# ------------

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from skhyst.compose import Cascade
from skhyst.datasets import decaying_sine, triangle
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import FirstOrderLag
from skhyst.persistence import load_model, save_model
from skhyst.records import read_records

dt = 2e-3
folder = TemporaryDirectory()
recording, file = Path(folder.name, "stage.csv"), Path(folder.name, "stage.skops")
drive = decaying_sine(30.0, 2.0, decay=0.3, duration=5.0, dt=dt)["drive"].to_numpy()
play, late, response = 0.0, 0.0, np.empty(len(drive))
for k, u in enumerate(drive):
    play = max(u - 6.0, min(u + 6.0, play))
    late += (1.0 - np.exp(-dt / 0.01)) * (0.06 * u + 0.04 * play - late)
    response[k] = late
response += 5e-3 * np.random.default_rng(0).normal(size=len(drive))
columns = {"time [s]": dt * np.arange(len(drive)), "voltage [V]": drive, "position [um]": response}
pd.DataFrame(columns).to_csv(recording, index=False)

X, y = read_records(recording)
model = Cascade([("hysteresis", PrandtlIshlinskii()), ("lag", FirstOrderLag())]).fit(X, y)
save_model(model, file)
print(f"{file.name}: {file.stat().st_size / 1024:.0f} kB")

# %%
# Load and step
# -------------
# `stepper` returns the model for use sample by sample: one call per sample, with its memory in
# `state`. It begins at rest at the first drive. A copy made during the run is independent from then
# on.

device = load_model(file).stepper(dt=dt)
new_drive = triangle(20.0, 1.0, n_cycles=2, dt=dt)["drive"].to_numpy()
half = len(new_drive) // 2
first = [device.step(u) for u in new_drive[:half]]
other = device.copy()
second = [device.step(u) for u in new_drive[half:]]
held = [other.step(new_drive[half]) for _ in new_drive[half:]]

# %%
# Sample by sample gives the same result as one run.

whole = model.stepper(dt=dt).run(new_drive)
print(f"largest difference to the whole run: {np.max(np.abs(whole - [*first, *second])):.1e} um")

figure, axes = plt.subplots(figsize=(7.0, 3.2), layout="constrained")
time = dt * np.arange(len(new_drive))
axes.plot(time, whole, label="as driven")
axes.plot(time[half:], held, label="a copy, at constant drive")
axes.set(xlabel="time (s)", ylabel="position (um)")
axes.legend()
plt.show()
folder.cleanup()
