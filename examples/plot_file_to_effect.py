"""
From a CSV file to a named effect
=================================

Voltage and position of a stage were recorded. The declared model is a hysteresis. What does it
lack?
"""

# %%
# The file
# --------
# It is generated here, from a simulated stage that is unknown to everything below: forty plays,
# then a mass on a spring that rings at 60 Hz. In your laboratory the file already exists.

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from scipy.signal import lfilter

from skhyst.datasets import band_limited_noise
from skhyst.diagnosis import EffectSearchCV
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.inspection import EvidenceDisplay, PredictionDisplay
from skhyst.records import inspect_recording, read_records

folder = TemporaryDirectory()
path = Path(folder.name, "stage.csv")
dt, thresholds = 1e-3, np.linspace(0.0, 30.0, 40)
drive = band_limited_noise(2000, band=(1.0, 80.0), rms=15.0, dt=dt, random_state=0)
drive = drive["drive"].to_numpy()
plays, slow = np.zeros(40), np.empty(len(drive))
for k, u in enumerate(drive):
    plays = np.maximum(u - thresholds, np.minimum(u + thresholds, plays))
    slow[k] = 0.05 * u + 0.002 * plays.sum()
pole = np.exp((-0.04 + 1j) * 2.0 * np.pi * 60.0 * dt)
denominator = np.real(np.poly([pole, pole.conj()]))
position = lfilter([0.0, denominator.sum()], denominator, slow)
position += 2e-3 * np.ptp(position) * np.random.default_rng(1).normal(size=len(position))
table = {"time [ms]": 1e3 * dt * np.arange(len(drive)), "voltage [V]": drive}
pd.DataFrame(table | {"position [um]": position}).to_csv(path, index=False)

# %%
# What is in it
# -------------
# Columns are recognised by their names and units. Nothing is fitted yet.

print(inspect_recording(path))
X, y = read_records(path)

# %%
# What is missing
# ---------------

tried = ["lag", "delay", "resonance", "creep", "output_saturation"]
search = EffectSearchCV(PrandtlIshlinskii(), effects=tried, random_state=0).fit(X, y)
print(search.effects_, search.verdict_)
print(f"{search.error_before_:.3f} um -> {search.error_after_:.3f} um, held out")
print(search.evidence_["resonance"].statement)

# %%
# The frequency response from the declared model to the response: a peak, and a phase of 180
# degrees.

EvidenceDisplay.from_search(search, effect="resonance")
PredictionDisplay.from_search(search)
plt.show()
folder.cleanup()
