"""
Several files are several records
=================================

Each run of an experiment has a file of its own. Together they are one `X` and one `y`, whose index
says which file a row came from, so that whole files can be held out.
"""

# %%
# The files
# ---------
# Four runs of one actuator, each at a different amplitude.

import warnings
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from sklearn.model_selection import cross_val_score

from skhyst.datasets import decaying_sine
from skhyst.exceptions import ExtrapolationWarning
from skhyst.hysteresis import ModifiedPrandtlIshlinskii, PrandtlIshlinskii
from skhyst.inspection import HysteresisLoopDisplay
from skhyst.model_selection import RecordKFold
from skhyst.records import read_records

folder = TemporaryDirectory()
rng, thresholds = np.random.default_rng(0), np.linspace(0.0, 20.0, 30)
for amplitude in (10, 20, 30, 40):
    run = decaying_sine(amplitude, 0.5, decay=0.1, duration=10.0, dt=0.02)
    response, plays = np.empty(len(run)), np.zeros(30)
    for k, u in enumerate(run["drive"]):
        plays = np.maximum(u - thresholds, np.minimum(u + thresholds, plays))
        memory = 0.05 * u + 0.004 * plays.sum()
        response[k] = memory + 0.03 * max(memory - 1.0, 0.0) ** 2 + 2e-3 * rng.normal()
    time = 0.02 * np.arange(len(run))
    table = pd.DataFrame({"t [s]": time, "U [V]": run["drive"].to_numpy(), "x [um]": response})
    table.to_csv(Path(folder.name, f"run_{amplitude}V.csv"), index=False)

# %%
# One call reads them all
# -----------------------

paths = sorted(Path(folder.name).glob("*.csv"))
X, y = read_records(paths)
print(X.groupby(level="record").size())

# %%
# A file is held out as a whole
# -----------------------------
# Every splitter and scorer of scikit-learn works: a model always knows where a record ends. The
# static curve after the hysteresis reduces the error at amplitudes that were not in the fit: models
# warn of these, which is what is asked for here.

warnings.simplefilter("ignore", ExtrapolationWarning)
for model in (PrandtlIshlinskii(), ModifiedPrandtlIshlinskii()):
    scores = -cross_val_score(model, X, y, cv=RecordKFold(4), scoring="neg_root_mean_squared_error")
    print(f"{type(model).__name__:26s}", *(f"{1e3 * own:6.1f} nm" for own in scores))

model = ModifiedPrandtlIshlinskii().fit(X, y)
HysteresisLoopDisplay.from_estimator(model, X, y, subtract_line=True)
plt.show()
folder.cleanup()
