"""
Hysteresis and resonance, fitted jointly
========================================

A fast stage has hysteresis and a resonance. If the two are fitted one after the other, the
hysteresis model absorbs a part of the resonance; a :class:`~skhyst.compose.Cascade` fits both
jointly.
"""

# %%
# A recording
# -----------
# A stage with hysteresis and a mode at 180 Hz with 2 % damping, recorded at 5 kHz: a sweep, random
# levels held for a while, and a multisine. The mode is integrated here, by classical Runge-Kutta
# steps, four per sample.

import matplotlib.pyplot as plt
import numpy as np

from skhyst.compose import Cascade
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import TransferFunction
from skhyst.records import stack_records

DT, N, FINE = 2e-4, 3000, 4  # s, samples per record, steps per sample
FREQUENCY, DAMPING = 2 * np.pi * 180.0, 0.02
rng = np.random.default_rng(1)
time = DT * np.arange(N)


def force(target, position, velocity):
    """Return the acceleration of the mode."""
    return FREQUENCY**2 * (target - position) - 2 * DAMPING * FREQUENCY * velocity


def stage(drive):
    """Return the response (um) to a drive (V)."""
    thresholds = np.linspace(0.0, 45.0, 60)
    plays, bent = np.zeros(60), np.empty(N)
    for k, u in enumerate(drive):
        plays = np.maximum(u - thresholds, np.minimum(u + thresholds, plays))
        bent[k] = 0.08 * u + 0.001 * plays.sum()

    position, velocity, h = bent[0], 0.0, DT / FINE
    response = np.empty(N)
    for k, (level, slope) in enumerate(zip(bent, np.diff(bent, append=0.0) / DT, strict=True)):
        response[k] = position
        for m in range(FINE):
            start = level + slope * h * m
            middle, end = start + slope * h / 2, start + slope * h
            a1 = force(start, position, velocity)
            v2 = velocity + h / 2 * a1
            a2 = force(middle, position + h / 2 * velocity, v2)
            v3 = velocity + h / 2 * a2
            a3 = force(middle, position + h / 2 * v2, v3)
            v4 = velocity + h * a3
            a4 = force(end, position + h * v3, v4)
            position += h / 6 * (velocity + 2 * v2 + 2 * v3 + v4)
            velocity += h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    return response


sweep = 45.0 * np.sin(2 * np.pi * (2.0 * time + 60.0 * time**2))
levels = np.repeat(rng.uniform(-45.0, 45.0, 12), N // 12)
edge = np.hanning(42)[1:-1] / np.hanning(42).sum()
steps = np.convolve(np.r_[np.zeros(39), levels], edge, mode="valid")
tones = np.sin(2 * np.pi * np.outer(time, rng.uniform(3, 120, 12)) + rng.uniform(0, 6.28, 12))
multisine = 40.0 * tones.sum(axis=1) / np.abs(tones.sum(axis=1)).max()

drives = [sweep, steps, multisine]
clean = [stage(drive) for drive in drives]
noise = 2e-3 * np.ptp(np.concatenate(clean))
records = [(drive, y + noise * rng.normal(size=N)) for drive, y in zip(drives, clean, strict=True)]
X, y = stack_records(records, ["sweep", "steps", "multisine"], dt=DT)
train = X.index.get_level_values("record") != "multisine"

# %%
# Joint fit
# ---------
# The index carries the sampling interval. The hysteresis has the static gain; that of the dynamics
# is one.

joint = Cascade([("hysteresis", PrandtlIshlinskii()), ("dynamics", TransferFunction(n_poles=2))])
joint.fit(X[train], y[train])
for name in ("natural_frequencies[0]", "damping_ratios[0]"):
    value, std = joint.params_[f"dynamics__{name}"], joint.params_std_[f"dynamics__{name}"]
    if name.startswith("natural"):
        value, std, name = value / (2 * np.pi), std / (2 * np.pi), "frequency (Hz)"
    print(f"{name:20s} {value:9.5f} +- {std:.5f}")

# %%
# One after the other
# -------------------
# The same two models; the dynamics are fitted with the prediction of the hysteresis as drive.

hysteresis = PrandtlIshlinskii().fit(X[train], y[train])
dynamics = TransferFunction(n_poles=2)
bent = X.assign(drive=hysteresis.predict(X))
dynamics.fit(bent[train], y[train])

predictions = {
    "hysteresis alone": hysteresis.predict(X),
    "one after the other": dynamics.predict(bent),
    "jointly": joint.predict(X),
}
print(f"error on the multisine, which no model has seen, over the noise of {noise:.4f} um:")
for name, prediction in predictions.items():
    error = np.sqrt(np.mean((y - prediction)[~train] ** 2))
    print(f"  {name:20s} {error / noise:6.2f}")

# %%
# The prediction of each for a step, and its residual for the multisine.

styles = {"hysteresis alone": "C0:", "one after the other": "C1", "jointly": "C2"}
figure, (left, right) = plt.subplots(1, 2, figsize=(10.0, 3.8), layout="constrained")
part = slice(980, 1180)
left.plot(1e3 * time[part], y["steps"].iloc[part], color="0.7", linewidth=4, label="measured")
for name, style in styles.items():
    step_response = predictions[name][N : 2 * N]
    left.plot(1e3 * time[part], step_response[part], style, label=name)
left.set(xlabel="time (ms)", ylabel="response (µm)")
left.legend(fontsize="small")
part = slice(1000, 1500)
for name, style in styles.items():
    residual = (y - predictions[name])["multisine"]
    right.plot(1e3 * time[part], residual.iloc[part], style, label=name)
right.set(xlabel="time (ms)", ylabel="residual of the multisine (µm)")
right.legend(fontsize="small")
plt.show()
