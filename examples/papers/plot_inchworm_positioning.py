"""
The inchworm motor in closed loop
=================================

The paper on the inchworm motor, Han et al., *An Identification Method for Dynamic Systems with SCNs
Hysteresis Compensator*, undated, ends with positions: under a learned hysteresis compensator and
proportional-integral control the motor settles within 1 nm of targets 1 um and 2 mm away. Here the
motor is simulated. It walks until one foot can reach the target, and that foot goes there under
control.
"""

# %%
# A recording and a model
# -----------------------
# One pair of benders is clamped: a voltage that dies away, for the hysteresis, and a sweep, for the
# mode. The sensor has 0.1 nm of noise and a resolution of 0.1 nm.

from itertools import pairwise

import matplotlib.pyplot as plt
import numpy as np
from scipy.ndimage import maximum_filter1d
from scipy.signal import cont2discrete
from sklearn.base import BaseEstimator, RegressorMixin

from skhyst.autoregressive import NARXRegressor
from skhyst.compose import Cascade
from skhyst.control import FeedforwardPI, IntegralResonantControl, InverseCompensator, simulate_loop
from skhyst.datasets import (
    decaying_sine,
    inchworm_motor_stepper,
    make_inchworm_motor,
    swept_sine,
    walking_drive,
)
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import SecondOrderMode
from skhyst.neural import SCNRegressor
from skhyst.records import stack_records

DT = 1e-4  # s
SENSOR = {"noise": 1e-4, "resolution": 1e-4}  # um

slow, sweep = (
    make_inchworm_motor(drive, random_state=seed, **SENSOR)[:2]
    for seed, drive in enumerate(
        [
            decaying_sine(5.0, 5.0, decay=1.0, duration=3.5, dt=DT),
            swept_sine(0.1, 800.0, duration=3.0, amplitude=0.5, dt=DT),
        ]
    )
)
steps = [("hysteresis", PrandtlIshlinskii(20)), ("mode", SecondOrderMode())]
model = Cascade(steps).fit(*stack_records([slow, sweep], labels=["slow", "sweep"], dt=DT))
mode = model.operator_.stages[1]
w, ratio = mode.natural_frequency, mode.damping_ratio
gain = np.polyfit(slow[0]["drive"], slow[1], 1)[0]
print(
    f"mode at {w / (2.0 * np.pi):.1f} Hz, damping ratio {ratio:.4f}; {1e3 * gain:.1f} nm/V; "
    f"the model leaves {1e3 * model.fit_error_:.1f} nm"
)

# %%
# Two feed-forwards
# -----------------
# One is the model, inverted. The other is the paper's: a stochastic configuration network of three
# inputs, (8), learned from response to voltage, with no model at all. As in
# :ref:`sphx_glr_auto_examples_papers_plot_inchworm_scn.py` it runs over the path of the signal in
# the place of time, so that its errors do not add up. Any regressor can be the inverse.


def by_path(signal, step):
    """Return a signal's path, and a grid on it: all turning points, and at most this step."""
    path = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(signal)))])
    way = np.sign(np.diff(signal))
    moves = np.flatnonzero(way)
    turns = moves[1:][way[moves[1:]] != way[moves[:-1]]]
    corners = np.unique(path[np.r_[0, turns, len(path) - 1]])
    parts = [np.linspace(a, b, 1 + int(np.ceil((b - a) / step)))[1:] for a, b in pairwise(corners)]
    return path, np.concatenate([[0.0], *parts])


def sampled(path, grid, signal):
    kept = np.r_[True, np.diff(path) > 0.0]
    return np.interp(grid, path[kept], signal[kept])


class NetworkByPath(RegressorMixin, BaseEstimator):
    """From response to drive."""

    def fit(self, X, y):
        grids = [by_path(y, step) for step in (0.25, 0.2, 0.16)]  # V
        samples = [tuple(sampled(*grid, signal) for signal in (np.ravel(X), y)) for grid in grids]
        network = SCNRegressor(80, scaling="whiten", tolerance=1e-6, random_state=0)
        self.network_ = NARXRegressor(network, initial_output=0.0).fit(*stack_records(samples))
        return self

    def predict(self, X):
        path, grid = by_path(np.ravel(X), 0.2 * gain)
        run = self.network_.predict(stack_records([sampled(path, grid, np.ravel(X))]))
        return np.interp(path, grid, run)


learned = InverseCompensator(NetworkByPath(), method="learned", rate_limit=2e3).fit(*slow)
inverse = InverseCompensator(model, bandwidth=500.0, rate_limit=2e3).fit(*slow)

# %%
# Walking
# -------
# Half a period of the four voltages is a step of some 0.7 um. Behind the last one the foot that is
# next stands clamped at its lowest voltage, and can carry the runner on by as much.

AMPLITUDE, TARGET = 4.0, 20.0  # V, um


def smooth(n):
    """Return n numbers from 0 to 1 that begin and end at rest."""
    t = np.arange(n) / (n - 1)
    return t**3 * (10.0 - 15.0 * t + 6.0 * t**2)


def voltages(bend, clamp, pair):
    """Return those of both pairs of benders; those of the other are opposite."""
    own, other = np.column_stack([bend, clamp]), -np.column_stack([bend, clamp])
    return np.hstack([other, own] if pair else [own, other])


step = walking_drive(1, amplitude=AMPLITUDE, frequency=50.0, dt=DT).to_numpy()[1:, :2].T
motor = inchworm_motor_stepper(voltages([-AMPLITUDE], [0.0], 0)[0], dt=DT)
travel, pair = [0.0], 0
while TARGET - travel[-1] > 0.7:
    travel += motor.run(voltages(*step, pair)).tolist()
    pair = 1 - pair
clamp = AMPLITUDE * np.append(smooth(500), np.ones(2500))
travel += motor.run(voltages(np.full(3000, -AMPLITUDE), clamp, pair)).tolist()
start = travel[-1]
print(f"{TARGET - start:.3f} um are left for the foot")

# %%
# The last half of a micrometre
# -----------------------------
# The mode rings: behind one integrator, its peak keeps a gain margin of 2 up to
# :math:`k_i = \zeta \omega / g`, a loop of 1.5 Hz. Integral resonant control damps it, and ten
# times that is safe. A compensator has to know what the foot has been through: it has come to its
# lowest voltage by walking.
#
# The paper has :math:`k_p = 10` and :math:`k_i = 145.836`, and no units. As V/um and V/(um s), on
# the published motor (15), such a loop diverges at slow rates and rings on at fast ones:

for rate in (1e3, 1e4, 5e4, 1e5):
    moved, past, _ = cont2discrete(([6.664, 0.2657e6], [3.04, 58.0, 2.312e6]), 1.0 / rate)
    feedback = np.polymul(moved.ravel(), [10.0 + 145.836 / rate, -10.0])
    poles = np.roots(np.polyadd(np.polymul(past, [1.0, -1.0]), feedback))
    ringing = rate * np.log(poles[np.argmax(poles.imag)])
    hertz, ratio_there = ringing.imag / (2.0 * np.pi), -ringing.real / np.abs(ringing)
    print(f"gains as printed at {rate:6.0f} Hz: {hertz:.0f} Hz, damping ratio {ratio_there:7.4f}")


class Foot:
    """The foot that stands, as a device of one voltage."""

    def __init__(self):
        self.motor = motor.copy()

    def step(self, u):
        return self.motor.step(voltages([u], [AMPLITUDE], pair)[0])


class Walked:
    """A compensator for a foot at its lowest voltage."""

    def __init__(self, compensator):
        self.compensator = compensator

    def drive_for(self, reference, dt):
        down = LOWEST * np.append(smooth(2000), np.ones(500))
        whole = np.concatenate([down, reference - start + LOWEST])
        return self.compensator.drive_for(whole, dt)[len(down) :]


LOWEST = model.operator_.run(-AMPLITUDE * smooth(2000), DT)[0][-1]
damping = IntegralResonantControl((w / (2.0 * np.pi), gain))
slack, firm = {"kp": 0.0, "ki": ratio * w / gain}, {"kp": 0.4 / gain, "ki": 10.0 * ratio * w / gain}
controllers = {
    "PI": FeedforwardPI(**slack),
    "PI, damped": FeedforwardPI(**firm, damping=damping),
    "network + PI": FeedforwardPI(**slack, compensator=Walked(learned)),
    "inverse + PI": FeedforwardPI(**slack, compensator=Walked(inverse)),
    "inverse + PI, damped": FeedforwardPI(**firm, compensator=Walked(inverse), damping=damping),
}
reference = start + (TARGET - start) * np.append(smooth(500), np.ones(7500))
loops = {
    name: simulate_loop(Foot(), controller, reference, DT, u0=-AMPLITUDE, random_state=0, **SENSOR)
    for name, controller in controllers.items()
}
print(f"{'nm':22s} {'largest error':>13s} {'rms, at rest':>13s} {'within 1 nm after':>18s}")
for name, loop in loops.items():
    error = 1e3 * np.abs(loop.response - reference)
    rest = np.sqrt(np.mean(error[-1000:] ** 2))
    settled = 1e3 * DT * (1 + np.flatnonzero(error > 1.0)[-1])
    print(f"{name:22s} {error.max():13.2f} {rest:13.2f} {settled:15.0f} ms")

# %%
# Left the walk, and the last part of it; right the largest error within one period of the mode.
# Feedback alone, slow as it must be, takes 0.6 s, and damped 0.3 s. Feed-forward is there within
# nanometres when the reference is, and then rings on for as long as the mode does. Damped, nothing
# rings. What is left there is the work of the sensor's noise: feedback makes a drive of it, and a
# Bouc-Wen law, unlike plays, slowly gives way to small motions. Without noise, or with plays in the
# motor, this loop is within 0.1 nm after 0.1 s.

figure, axes = plt.subplots(1, 2, figsize=(10.0, 4.0), layout="constrained")
axes[0].plot(1e3 * DT * np.arange(len(travel)), travel, "0.6", label="walk")
later = 1e3 * DT * (len(travel) + np.arange(len(reference)))
axes[0].plot(later, loops["inverse + PI"].response, "C0", label="foot, under control")
axes[0].axhline(TARGET, color="k", ls="--", lw=0.8)
axes[0].set(xlabel="time (ms)", ylabel="displacement (µm)", xlim=(0.0, 700.0))
axes[0].legend()
for name, loop in loops.items():
    error = maximum_filter1d(1e3 * np.abs(loop.response - reference), round(6.28 / w / DT))
    axes[1].semilogy(1e3 * loop.time, error, lw=1, label=name)
axes[1].axhline(1.0, color="k", ls="--", lw=0.8)
axes[1].set(xlabel="time (ms)", ylabel="error (nm)", ylim=(2e-2, 1e3), title="the last part")
axes[1].legend(loc="upper right", fontsize="small")
plt.show()
