"""
Fit a Prandtl-Ishlinskii model and compensate the hysteresis
============================================================

The weights are the solution of one non-negative least-squares problem, without starting values. The
fitted model has an exact inverse: the drive that makes the response follow a target.
"""

# %%
# A recording
# -----------
# The actuator is simulated here: a nearly continuous density of plays, which a model with a few
# thresholds can only approximate, and sensor noise of 0.1 % of the range.

import matplotlib.pyplot as plt
import numpy as np

from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.inspection import HysteresisLoopDisplay


def actuator(drive):
    """Return the response (um) to a drive (V): 400 plays, advanced sample by sample."""
    thresholds = np.linspace(0.0, 60.0, 400)
    density = 0.02 * np.exp(-thresholds / 20.0) * (thresholds[1] - thresholds[0])
    plays, response = np.zeros(400), np.empty(len(drive))
    for k, u in enumerate(drive):
        plays = np.maximum(u - thresholds, np.minimum(u + thresholds, plays))
        response[k] = 0.1 * u + density @ plays
    return response


rng = np.random.default_rng(0)
time = np.arange(6000) * 1e-3  # s
drive = 60.0 * np.sin(2 * np.pi * time) * (1.0 - 0.9 * time / 6.0)
clean = actuator(drive)
noise = 1e-3 * np.ptp(clean)
response = clean + noise * rng.normal(size=time.size)

# %%
# Fit
# ---

X = drive[:, None]
model = PrandtlIshlinskii(n_operators=20).fit(X, response)
print(f"residual {model.fit_error_ * 1e3:.1f} nm, sensor noise {noise * 1e3:.1f} nm")

display = HysteresisLoopDisplay.from_estimator(model, X, response, subtract_line=True)
plt.show()

# %%
# Every weight has a standard error; a weight at its bound, zero, has none.

errors = np.array([model.params_std_[f"weights[{k}]"] for k in range(20)])
figure, axes = plt.subplots(figsize=(6.0, 3.2), layout="constrained")
axes.errorbar(model.thresholds_[1:], model.weights_[1:], errors[1:], fmt="o", capsize=3)
axes.set(xlabel="threshold (V)", ylabel="weight (µm/V)")
plt.show()

# %%
# Compensate
# ----------
# The inverse model gives the drive for a target response, which is applied to the actuator. For
# comparison: the drive from the straight line that fits the recording best.

target = 4.0 * np.sin(2 * np.pi * 0.7 * time) + 2.0 * np.sin(2 * np.pi * 1.9 * time)  # um
compensated = actuator(model.inverse_predict(target[:, None]))
slope, intercept = np.polyfit(drive, response, 1)
uncompensated = actuator((target - intercept) / slope)

for name, reached in (("straight line", uncompensated), ("inverse model", compensated)):
    error = np.sqrt(np.mean((reached - target) ** 2)) / np.ptp(target)
    print(f"{name}: tracking error {100 * error:.2f} % of the range")

figure, axes = plt.subplots(figsize=(7.0, 3.4), layout="constrained")
axes.plot(time, uncompensated - target, label="straight line")
axes.plot(time, compensated - target, label="inverse model")
axes.set(xlabel="time (s)", ylabel="tracking error (µm)")
axes.legend()
plt.show()
