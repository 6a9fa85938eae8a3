"""
A file with milliseconds, decimal commas and lost readings
==========================================================

A logger wrote a preamble, semicolons, decimal commas, a time in milliseconds, and -9999 where it
had no reading. Frequencies and time constants are right only if all of that is interpreted
correctly.
"""

# %%
# The file
# --------

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np

from skhyst.datasets import sine
from skhyst.exceptions import RecordError
from skhyst.inspection import PredictionDisplay
from skhyst.linear import FirstOrderLag
from skhyst.records import inspect_recording, read_records

folder = TemporaryDirectory()
path = Path(folder.name, "logger.csv")
dt, time_constant = 2e-3, 0.05  # s
drive = sum(sine(a, f, n_cycles=8 * f, dt=dt)["drive"].to_numpy() for a, f in ((2, 1), (1, 6)))
response, state = np.empty(len(drive)), drive[0]
for k, u in enumerate(drive):
    state += (1.0 - np.exp(-dt / time_constant)) * (0.5 * (u + drive[max(k - 1, 0)]) - state)
    response[k] = state
response += 0.01 * np.random.default_rng(0).normal(size=len(drive))
response[[300, 301, 777]] = -9999.0
rows = (
    f"{1e3 * dt * k:.1f};{u:.5f};{y:.5f}".replace(".", ",")
    for k, (u, y) in enumerate(zip(drive, response, strict=True))
)
head = ["Messung 7;;", "Prüfer: Müller;;", "Zeit [ms];Spannung [V];Weg [µm]"]
path.write_text("\n".join([*head, *rows]), encoding="latin-1")
print("\n".join(path.read_text(encoding="latin-1").splitlines()[:6]))

# %%
# What is recognised, and what has to be specified
# -------------------------------------------------
# The layout, the unit of the time and the roles of the columns are recognised. The code of a lost
# reading is reported, and you choose what happens to such rows.

print(inspect_recording(path))
try:
    read_records(path, missing_code=-9999.0)
except RecordError as error:
    print(error)
X, y = read_records(path, missing_code=-9999.0, on_missing="interpolate")

# %%
# A time constant in seconds
# --------------------------

model = FirstOrderLag().fit(X, y)
found, error = (values["time_constant"] for values in (model.params_, model.params_std_))
print(f"time constant {1e3 * found:.2f} ms +- {1e3 * error:.2f} ms, in the device 50 ms")
PredictionDisplay.from_estimator(model, X, y)
plt.show()
folder.cleanup()
