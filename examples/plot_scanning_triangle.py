"""
A triangle on a scanning stage
==============================

Scanners follow triangles. A stage does not follow them exactly: its hysteresis bends the lines, its
creep shifts them, and its dynamics delay the motion and round the corners. Here a stage is
identified, its model is inverted, and the remaining error is reduced by iterative learning on the
stage itself, or by feedback.
"""

# %%
# The stage and its model
# -----------------------
# The stage is simulated with published parameters and shares no code with the models. The
# recordings are four triangles of 1 Hz to 1 kHz, and the response to white noise that is too small
# for hysteresis, which identifies the vibration. The sensor has 0.5 nm of noise.

import warnings

import matplotlib.pyplot as plt
import numpy as np
from sklearn.frozen import FrozenEstimator

from skhyst.compose import Cascade
from skhyst.control import FeedforwardPI, InverseCompensator, simulate_loop
from skhyst.datasets import make_scanning_stage, scanning_stage_stepper
from skhyst.exceptions import ReachWarning
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import KelvinVoigt, TransferFunction, frequency_response
from skhyst.records import stack_records

DT, NOISE = 4e-6, 5e-4  # s, um
TODAY = {"creep": 0.05}

small = make_scanning_stage("small_signal", random_state=1)[:2]
measured = frequency_response(*small).compensate_hold().restrict(100.0, 60e3)
vibration = TransferFunction(9, n_zeros=3).fit_frequency_response(measured)
X, y, _ = make_scanning_stage("identification", random_state=0)
model = Cascade(
    [
        ("hysteresis", PrandtlIshlinskii(5, fit_intercept=False)),
        ("creep", KelvinVoigt(2)),
        ("vibration", FrozenEstimator(vibration)),
    ]
).fit(X, y)
print(f"residual of the model: {1e3 * model.fit_error_:.2f} nm")

# %%
# The reference
# -------------
# Two micrometres at 500 Hz. No stage with mass can reverse abruptly, so each corner is replaced by
# a parabola over a twentieth of the period. The reference begins and ends at rest.

FREQUENCY, STROKE, PERIODS = 500.0, 2.0, 5
n = round(1.0 / (FREQUENCY * DT))
slope = np.sign(np.cos(2.0 * np.pi * np.arange(PERIODS * n) / n)) * 2.0 * STROKE / n
slope = np.concatenate([np.zeros(n), slope, np.zeros(n)])
slope = np.convolve(slope, np.full(n // 20, 20.0 / n), mode="same")
reference = np.cumsum(slope)
time = 1e3 * DT * np.arange(len(reference))  # ms
lines = np.abs(slope) > 0.999 * slope.max()  # where a scanner records

# %%
# Open loop
# ---------
# Without a model only a constant gain is used, that of the slowest triangle. The compensator gives
# the drive under which the model follows the reference. The stage has changed since the recordings:
# softened glue adds a creep of 5 % within milliseconds, which is not in the model. So the drive is
# learned on the stage itself: ``refine`` corrects the drive by the error of each trial.

slow = X.loc["1 Hz", "drive"].to_numpy(), y.loc["1 Hz"].to_numpy()
gain = np.polyfit(*slow, 1)[0]
compensator = InverseCompensator(model, bandwidth=20e3, rate_limit=2e6).fit(X, y)  # V/s
warnings.simplefilter("ignore", ReachWarning)  # its turns are faster than those of the recording


def stage(drive, noise=0.0, seed=0):
    """Return the response of the stage, from rest."""
    response = scanning_stage_stepper(drive[0], effects=TODAY).run(drive)
    return response + noise * np.random.default_rng(seed).standard_normal(len(drive))


trials = iter(range(100))
record = stack_records([reference], dt=DT)
drives = {
    "gain alone": reference / gain,
    "compensated": compensator.drive_for(reference, DT),
    "learned, 6 trials": compensator.refine(record, lambda u: stage(u, NOISE, next(trials))),
}
responses = {name: stage(drive) for name, drive in drives.items()}
print("errors of the trials kept (nm):", np.round(1e3 * np.array(compensator.errors_), 2))

# %%
# Closed loop
# -----------
# Feedback corrects model errors without trials, but with a delay: alone, it is worse at 500 Hz than
# no feedback at all. With the compensator it only has to correct a small error. The gains are
# moderate: the loop gain is one near 1.3 kHz, and a quarter at the first resonance.

kp, ki = 0.1 / gain, 2.0 * np.pi * 1500.0 / gain
for name, own in {"PI": None, "compensated + PI": compensator}.items():
    controller = FeedforwardPI(kp, ki, compensator=own)
    loop = simulate_loop(
        scanning_stage_stepper(effects=TODAY),
        controller,
        reference,
        DT,
        noise=NOISE,
        random_state=0,
    )
    drives[name], responses[name] = loop.drive, loop.response

print(f"{'on the lines (nm)':20s} {'rms':>8s} {'largest':>8s}")
for name, response in responses.items():
    error = 1e3 * (response - reference)[lines]
    print(f"{name:20s} {np.sqrt(np.mean(error**2)):8.2f} {np.abs(error).max():8.2f}")

# %%
# The responses, and the error on two scales. With the gain alone the response is delayed, with an
# error of more than a tenth of the stroke, and so it is under feedback alone.

colors = {name: f"C{k}" for k, name in enumerate(responses)}
figure, axes = plt.subplots(2, 2, figsize=(10.0, 6.0), layout="constrained", sharex=True)
for name in ("gain alone", "PI", "compensated"):
    axes[0, 0].plot(time, responses[name], color=colors[name], lw=1, label=name)
    axes[1, 0].plot(time, responses[name] - reference, color=colors[name], lw=1)
axes[0, 0].plot(time, reference, "k--", lw=0.8, label="reference")
axes[0, 0].set(title="displacement", ylabel="µm")
axes[1, 0].set(title="error", ylabel="µm", xlabel="time (ms)")
for name in ("gain alone", "compensated"):
    axes[0, 1].plot(time, drives[name], color=colors[name], lw=1, label=name)
axes[0, 1].set(title="drive", ylabel="V")
for name in ("compensated", "compensated + PI", "learned, 6 trials"):
    axes[1, 1].plot(
        time, 1e3 * (responses[name] - reference), color=colors[name], lw=0.8, label=name
    )
axes[1, 1].set(title="error, enlarged", ylabel="nm", xlabel="time (ms)")
axes[1, 1].set(xlim=(time[n // 2], time[-n // 2]))
for axis in (axes[0, 0], axes[0, 1], axes[1, 1]):
    axis.legend(loc="lower left", fontsize="small")
plt.show()

# %%
# Displacement over reference for one period, forth and back: the distance between the two lines
# appears in a scanner as a shadow of every edge.

figure, axis = plt.subplots(figsize=(6.0, 4.0), layout="constrained")
period = slice(3 * n - n // 4, 4 * n - n // 4)
for name in ("gain alone", "PI", "compensated"):
    axis.plot(reference[period], responses[name][period], color=colors[name], label=name)
axis.set(xlabel="reference (µm)", ylabel="displacement (µm)", title="one period, forth and back")
axis.legend()
plt.show()
