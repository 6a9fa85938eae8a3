"""
Stochastic configuration networks as hysteresis model and compensator
=====================================================================

In Han et al., *An Identification Method for Dynamic Systems with SCNs Hysteresis Compensator*,
undated, the authors model hysteresis by a stochastic configuration network of three inputs, (8):
the voltage, the previous voltage, and the previous hysteresis. The reported error is within 2 nm.
Here the motor is simulated, and the network is evaluated in the free run, in which it uses its own
past output and no measurement; so is the compensator based on it.
"""

# %%
# The recording
# -------------
# The voltage (12) decays over 3.5 s, sampled at 0.1 ms. The sensor has 0.1 nm of noise and a
# resolution of 0.1 nm, as the paper's interferometer. The target of the network is not measured: by
# (4) the hysteresis is computed from the displacement by the linear equation of motion, known from
# (15).

from itertools import pairwise

import matplotlib.pyplot as plt
import numpy as np
from scipy.signal import cont2discrete, lfilter, lsim, savgol_filter
from sklearn.linear_model import Ridge
from sklearn.pipeline import make_pipeline

from skhyst.autoregressive import NARXRegressor
from skhyst.datasets import decaying_sine, make_inchworm_motor, sine, swept_sine
from skhyst.linear import frequency_response
from skhyst.neural import SCNRegressor
from skhyst.preprocessing import PlayOperators
from skhyst.records import stack_records

DT = 1e-4  # s
OPTIONS = {"noise": 1e-4, "dt": DT}


def record(X, seed):
    """Return drive (V), measured and noise-free displacement, hysteresis and foot (um)."""
    X, y, truth = make_inchworm_motor(X, random_state=seed, **OPTIONS)
    signals = truth.signals
    columns = (X["drive"], y, truth.response, signals["hysteresis"], signals["actuator"])
    return [column.to_numpy() for column in columns]


parameters = make_inchworm_motor(sine(), **OPTIONS)[2].parameters
mass, damping, stiffness = (parameters[name] for name in ("mass", "damping", "stiffness"))
C1 = 1e6 * parameters["bending"]  # um/V


motion = cont2discrete(([damping, stiffness], [mass, damping, stiffness]), DT, method="foh")


def moved(foot):
    """Return the displacement of the runner, which follows the foot by (3), from rest at zero."""
    return lfilter(motion[0].ravel(), motion[1], foot)


def foot_of(x):
    """Return the foot's displacement for that of the runner: (3) inverted, by smoothed slopes."""
    slopes = [savgol_filter(x, 41, 4, deriv=order, delta=DT) for order in range(3)]
    force = mass * slopes[2] + damping * slopes[1] + stiffness * slopes[0]
    _, foot, _ = lsim([[1.0], [damping, stiffness]], force, DT * np.arange(len(x)))
    return foot


u, x, _, h_true, _ = record(decaying_sine(), 0)
foot = foot_of(x)
h = C1 * u - foot
error = 1e3 * np.abs(h - h_true)
print(f"hysteresis error {np.sqrt(np.mean(error**2)):.2f} nm rms, {error.max():.2f} nm at most")

# %%
# As printed
# ----------
# One step ahead (8) is very accurate, as any model would be: in 0.1 ms the hysteresis changes by
# less than a nanometre. In the free run the same network drifts: its output depends on the
# difference of two neighbouring voltages, a thousandth of either, and the errors of 35,000 steps
# add up. Whitening (``scaling="whiten"``) amplifies the difference, but the number of steps
# remains. With the output weights fitted to the free run (``objective="simulation"``) a network
# with the printed inputs and the printed step follows the recording (12) within a nanometre.
#
# This holds for this recording only. At 1 and 10 Hz the voltage has increments that do not occur at
# these voltages in (12), and the error of the same network is large: a model with these inputs may
# fit (12) and be wrong at other rates, which (12) alone cannot show. What is missing is not a
# better fit but the knowledge that the motor's hysteresis is rate independent.


def free_run(model, drive, target=None):
    """Return the free run, and where there is a target its largest error one step ahead (nm)."""
    ahead = None
    if target is not None:
        one_step = model.predict_one_step(drive[:, None], target)
        ahead = 1e3 * np.abs(one_step - target).max()
    return model.predict(drive[:, None]), ahead


other_rates = [record(sine(3.0, f, n_cycles=int(3 * f), dt=DT), 1) for f in (1.0, 10.0)]
print("(8) as printed, largest errors in nm: one step ahead, free run, free run at 1 and 10 Hz")
for scaling, objective in (
    ("standard", "one_step"),
    ("whiten", "one_step"),
    ("whiten", "simulation"),
):
    network = SCNRegressor(80, scaling=scaling, tolerance=1e-6, random_state=0)
    printed = NARXRegressor(network, objective=objective, initial_output=0.0).fit(u[:, None], h)
    run, ahead = free_run(printed, u, h)
    errors = [1e3 * np.abs(run - h_true).max()]
    for drive, _, _, hysteresis, _ in other_rates:
        errors.append(1e3 * np.abs(free_run(printed, drive)[0] - hysteresis).max())
    print(f"{scaling:9s}{objective:11s}{ahead:8.2f}" + "".join(f"{e:8.1f}" for e in errors))

# %%
# Path length instead of time
# ---------------------------
# Rate-independent hysteresis does not depend on time: a record may be sampled in equal steps of the
# path length of the voltage, with every turning point among the samples. The step can then be
# chosen freely, and a record of 1 Hz is the same as one of 10 Hz. Three grids of the same record
# give three training records, which prevents overfitting to one of them.


def by_path(signal, step):
    """Return the path length of a signal, and a grid with all turning points and this step."""
    path = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(signal)))])
    direction = np.sign(np.diff(signal))
    turns = 1 + np.flatnonzero(direction[1:] != direction[:-1])
    corners = np.unique(path[np.r_[0, turns, len(path) - 1]])
    parts = [np.linspace(a, b, 1 + int(np.ceil((b - a) / step)))[1:] for a, b in pairwise(corners)]
    return path, np.concatenate([[0.0], *parts])


def sampled(path, grid, signal):
    kept = np.r_[True, np.diff(path) > 0.0]
    return np.interp(grid, path[kept], signal[kept])


def run_by_path(model, signal, step):
    """Return the free run over the path length of a signal, at the signal's own samples."""
    path, grid = by_path(signal, step)
    return np.interp(path, grid, model.predict(stack_records([sampled(path, grid, signal)])))


grids = [by_path(u, step) for step in (0.25, 0.2, 0.16)]  # V
U, H = [[sampled(*grid, signal) for grid in grids] for signal in (u, h)]


def network_of(drives, responses, seed=0):
    network = SCNRegressor(80, scaling="whiten", tolerance=1e-6, random_state=seed)
    model = NARXRegressor(network, initial_output=0.0)
    return model.fit(*stack_records(list(zip(drives, responses, strict=True))))


models = [network_of(U, H, seed) for seed in range(3)]
X_path, H_path = stack_records(list(zip(U, H, strict=True)))
ahead = 1e3 * (models[0].predict_one_step(X_path, H_path) - H_path).abs().max()
print(f"{len(H_path)} samples by path, largest error one step ahead {ahead:.2f} nm")

# %%
# Held out are sinusoids of 1 and 10 Hz, of 3 V, within the range of the training, and of 3.5 V,
# outside it. A static map of play states is another model with memory: it needs no feedback of the
# output and cannot diverge. It does not represent Bouc-Wen hysteresis exactly, whose memory is not
# erased like that of plays.

plays = make_pipeline(PlayOperators(12), Ridge(1e-6)).fit(u[::10, None], h[::10])
plays_scn = make_pipeline(
    PlayOperators(12), SCNRegressor(40, tolerance=1e-3, alpha=1e-2, random_state=0)
).fit(u[::10, None], h[::10])

tests = {"(12), trained on": (u, moved(C1 * u - h_true))}
for amplitude in (3.0, 3.5):
    for frequency in (1.0, 10.0):
        X = sine(amplitude, frequency, n_cycles=int(3 * frequency), dt=DT)
        drive, _, clean, _, _ = record(X, 1)
        tests[f"{amplitude} V, {frequency:g} Hz"] = drive, clean
print(f"{'largest error (nm)':18s} by path, three seeds   of stroke   plays, SCN   plays, ridge")
runs = {}
for name, (drive, clean) in tests.items():
    found = [moved(C1 * drive - run_by_path(model, drive, 0.2)) for model in models]
    found += [moved(C1 * drive - p.predict(drive[:, None])) for p in (plays_scn, plays)]
    worst = [1e3 * np.abs(run - clean).max() for run in found]
    runs[name], percent = found[0], 0.1 * max(worst[:3]) / np.ptp(clean)
    paths = "".join(f"{value:7.2f}" for value in worst[:3])
    print(f"{name:18s} {paths} {percent:11.2f} % {worst[3]:11.1f} {worst[4]:13.1f}")

# %%
# Within the voltages of the training the errors of all three networks stay within 2 nm, a quarter
# of a percent of the stroke, in the free run over three seconds.

figure, axes = plt.subplots(1, 3, figsize=(11.0, 3.8), layout="constrained")
time = DT * np.arange(len(u))
axes[0].plot(time, u, "0.6", lw=1)
axes[0].set(xlabel="time (s)", ylabel="drive (V)", title="(12), trained on")
for name, color in {"3.0 V, 1 Hz": "C0", "3.0 V, 10 Hz": "C1"}.items():
    drive, clean = tests[name]
    last = slice(len(drive) * 2 // 3, None)
    axes[1].plot(drive[last], clean[last], color=color, lw=4, alpha=0.3)
    axes[1].plot(drive[last], runs[name][last], color=color, lw=1, label=name)
    axes[2].plot(drive, 1e3 * (runs[name] - clean), color=color, lw=0.6, label=name)
axes[1].set(xlabel="drive (V)", ylabel="displacement (µm)", title="held out: motor and free run")
axes[2].set(xlabel="drive (V)", ylabel="error (nm)", ylim=(-3.0, 3.0), title="held out: free run")
for level in (-2.0, 2.0):
    axes[2].axhline(level, color="0.5", ls="--", lw=0.8)
axes[1].legend()
axes[2].legend(loc="lower right")
plt.show()

# %%
# How many nodes
# --------------
# The three algorithms draw nodes in the same way and differ in the output weights that they solve
# for: that of the new node alone (SC-I), those of the last ten (SC-II), all (SC-III). SC-I
# stagnates: the weights of its first nodes are never revised.

signals = np.vstack([np.c_[a[1:], a[:-1], b[:-1]] for a, b in zip(U, H, strict=True)])
target = np.concatenate([b[1:] for b in H])
figure, axis = plt.subplots(figsize=(6.0, 3.8), layout="constrained")
for algorithm in ("SC-I", "SC-II", "SC-III"):
    network = SCNRegressor(
        150, algorithm=algorithm, scaling="whiten", tolerance=5e-3, random_state=0
    ).fit(signals, target)
    residual = network.history_["residual"]
    needed = [
        str(1 + np.argmax(residual <= level)) if residual[-1] <= level else "over 150"
        for level in (0.1, 0.03, 0.01, 0.005)
    ]
    print(f"{algorithm:7s} nodes to 10, 3, 1, 0.5 % of the hysteresis: {', '.join(needed)}")
    axis.loglog(1 + np.arange(len(residual)), residual, label=algorithm)
axis.set(xlabel="nodes", ylabel="residual over standard deviation", title="one step ahead")
axis.legend()
plt.show()

# %%
# The compensator
# ---------------
# The inverse (13) is the same network with foot and voltage swapped: it maps the desired
# displacement of the foot, its previous displacement, and the previous voltage to the voltage. It
# is trained on the same samples.

inverse = network_of([C1 * a - b for a, b in zip(U, H, strict=True)], U)
sweep = swept_sine(0.1, 800.0, duration=10.0, amplitude=0.2, dt=DT)  # um
reference = sweep["drive"].to_numpy()
gain = 3.0 / np.abs(C1 * U[1] - H[1])[U[1] > 2.9].mean()  # V/um, of the loop as a whole
drives = {"no compensator": gain * reference}
drives["SCN compensator"] = run_by_path(inverse, reference, 0.2 / gain)

figure, axes = plt.subplots(1, 3, figsize=(11.0, 3.8), layout="constrained")
for name, color in {"no compensator": "C3", "SCN compensator": "C0"}.items():
    _, x, _, _, foot = record(sweep.assign(drive=drives[name]), 2)
    response = frequency_response(sweep, x, method="h1", segment_length=10_000)
    shown = response.restrict(2.0, 500.0)
    G = shown.response[:, 0]
    near = response.restrict(120.0, 160.0)
    slope, level = np.polyfit(near.frequency**2, (1.0 / near.response[:, 0]).real, 1)
    low = response.restrict(2.0, 40.0)
    phase = np.degrees(np.angle(low.response)).mean()
    print(
        f"{name:16s} foot off by {1e3 * np.abs(foot - reference).max():6.1f} nm at most, "
        f"phase below 40 Hz {phase:6.2f} deg, 1 - coherence {1 - np.median(low.coherence):.1e}, "
        f"mode {np.sqrt(-level / slope):.2f} Hz"
    )
    axes[0].loglog(shown.frequency, np.abs(G), color=color, label=name)
    axes[1].semilogx(shown.frequency, np.degrees(np.unwrap(np.angle(G))), color=color)
    axes[2].loglog(shown.frequency, 1.0 - shown.coherence, color=color)
s = 2j * np.pi * shown.frequency
exact = (damping * s + stiffness) / (mass * s**2 + damping * s + stiffness)
axes[0].loglog(shown.frequency, np.abs(exact), "k--", lw=0.8, label="(15)")
axes[1].semilogx(shown.frequency, np.degrees(np.unwrap(np.angle(exact))), "k--", lw=0.8)
axes[1].set(xlabel="frequency (Hz)", ylabel="phase (deg)", ylim=(-20.0, 5.0))
axes[0].set(xlabel="frequency (Hz)", ylabel="displacement / reference")
axes[2].set(xlabel="frequency (Hz)", ylabel="1 - coherence")
axes[0].legend()
plt.show()

# %%
# Without compensator the loop appears as a phase lag at low frequency, which linear dynamics cannot
# have, and the gain holds for one amplitude only. With it the sweep shows the mode (15), and little
# else.
