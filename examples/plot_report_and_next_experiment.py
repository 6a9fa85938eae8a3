"""
A report, and what to record next
=================================

A recording may not distinguish two effects. The report says so, and the next experiment is the
drive that distinguishes them, as a file for the signal generator.
"""

# %%
# A recording at one frequency
# ----------------------------
# The response is delayed by three samples. At one frequency a delay and a lag are nearly
# equivalent.

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from skhyst.datasets import sine
from skhyst.diagnosis import EffectSearchCV, next_experiment
from skhyst.linear import Gain
from skhyst.records import read_records

folder = TemporaryDirectory()
path, dt = Path(folder.name, "first.csv"), 2e-3


def device(drive, rng):
    """Return the response (um) to a drive (V)."""
    late = np.r_[np.full(3, drive[0]), drive[:-3]]
    return 0.8 * late + 0.02 * rng.normal(size=len(drive))


rng = np.random.default_rng(0)
drive = sine(1.0, 2.0, n_cycles=4, dt=dt)["drive"].to_numpy()
columns = {"time [s]": dt * np.arange(len(drive)), "voltage [V]": drive}
pd.DataFrame(columns | {"position [um]": device(drive, rng)}).to_csv(path, index=False)

# %%
# The search
# ----------

X, y = read_records(path)
tried = ["delay", "lag", "offset"]
search = EffectSearchCV(Gain(), effects=tried, random_state=0).fit(X, y)
report = search.report()
print(report.sentence)
page = report.to_html(Path(folder.name, "report.html"))
print(f"report.html: {len(page) / 1e6:.2f} MB, self-contained")

# %%
# What to record next
# -------------------
# Within the limits of the amplifier: 1 V to either side, 50 V/s.

experiment = next_experiment(search, (-1.0, 1.0), rate_limit=50.0)
print(experiment.reason)
experiment.save(Path(folder.name, "next_drive.csv"))
figure, axes = plt.subplots(figsize=(7.0, 2.6), layout="constrained")
axes.plot(experiment.drive[:0.5])
axes.set(xlabel="time (s)", ylabel="drive (V)")
plt.show()

# %%
# Record it
# ---------
# A search of both recordings together: the name is now unambiguous.

drive = experiment.drive.to_numpy()
columns = {"time [s]": dt * np.arange(len(drive)), "voltage [V]": drive}
second = Path(folder.name, "second.csv")
pd.DataFrame(columns | {"position [um]": device(drive, rng)}).to_csv(second, index=False)
X, y = read_records([path, second])
search.fit(X, y)
print(search.effects_, "ambiguous with", search.history_["ambiguous_with"][0] or "nothing")
folder.cleanup()
