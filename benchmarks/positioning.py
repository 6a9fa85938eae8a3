"""Position the simulated inchworm motor, and damp what rings: `python benchmarks/positioning.py`.

    python benchmarks/positioning.py [--seed 0]

The motor walks to where its foot can reach the target, 1 um or 2 mm away; then the foot goes there
along a smooth step under proportional-integral control, alone and behind two feed-forwards: the
paper's, a stochastic configuration network that is learned from response to drive, and the inverse
of an identified model. Settled is the largest error in the last 100 ms, the sensor's noise not
counted. Needs python-control.

Gains are those of the largest bandwidth (-3 dB of the closed loop) among all for which
python-control finds the loop around the identified mode stable, with a gain margin of 2 at least
and no peak above 3 dB; a drive acts one sample late. The same search around the published dynamics
of the scanning stage follows. The devices share no code with the models.
"""

import argparse
import warnings
from itertools import pairwise

import control
import numpy as np
from sklearn.base import BaseEstimator, RegressorMixin

from skhyst.autoregressive import NARXRegressor
from skhyst.compose import Cascade
from skhyst.control import FeedforwardPI, IntegralResonantControl, InverseCompensator, simulate_loop
from skhyst.datasets import (
    decaying_sine,
    inchworm_motor_stepper,
    load_scanning_stage_parameters,
    make_inchworm_motor,
    swept_sine,
    walking_drive,
)
from skhyst.exceptions import ReachWarning
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import SecondOrderMode
from skhyst.neural import SCNRegressor
from skhyst.records import stack_records

DT, STAGE_DT = 1e-4, 4e-6  # s
SENSOR = {"noise": 1e-4, "resolution": 1e-4}  # um, as the paper's interferometer
TARGETS = 1.0, 2000.0  # um
AMPLITUDE, WALK = 4.0, 50.0  # V and Hz, of the steps
RISE, HOLD = 0.05, 1.0  # s, of the smooth step and of the rest behind it
SETTLED, FIFTH, THREE = 1e-3, 0.2, 3.0  # bars: um, of PI's error, times PI's bandwidth
MARGIN, PEAK = 2.0, 10.0 ** (3.0 / 20.0)
RATIOS = 0.5, 0.1, 0.02, 0.005  # of damping, on the stage: at 0.5 no loop around it is stable
KPS = np.linspace(0.0, 3.0, 61)


def smooth(n):
    """Return n numbers from 0 to 1 that begin and end at rest."""
    t = np.arange(n) / (n - 1)
    return t**3 * (10.0 - 15.0 * t + 6.0 * t**2)


def kept(holds):
    return "kept" if holds else "MISSED"


# ---------------------------------------------------------------------------------- linear design


def widest(plant, dt, damping=None, kps=KPS):
    """Return bandwidth in Hz and the gains kp, ki around N(s) / D(s) of gain one."""
    top = 0.49 / dt
    f = np.union1d(np.geomspace(1e-4 * top, top, 1500), np.linspace(0.0, top, 4000)[1:])
    z = np.exp(2j * np.pi * f * dt)
    # coefficients that span forty decades in seconds do not in samples
    numerator, denominator = (c / dt ** np.arange(len(c))[::-1] for c in plant)
    sampled = control.sample_system(control.tf(numerator, denominator), 1.0, "foh")
    plant = control.ss(sampled * control.tf([1.0], [1.0, 0.0], 1.0))
    damps = control.tf([0.0], [1.0], 1.0)
    if damping is not None:
        b0, _, _, a1, _ = damping.section(dt)
        damps = control.tf([b0, 0.0], [1.0, a1], 1.0)
    p, d = plant(z), damps(z)
    found = []
    for kp in kps:
        for ki in np.geomspace(1e-5, 1.0, 151) / dt:
            pi = kp + ki * dt / (1.0 - 1.0 / z)
            gain = np.abs(pi * p / (1.0 + (pi - d) * p))
            if gain.max() <= PEAK:
                found.append((f[np.argmax(gain < np.sqrt(0.5))], kp, ki))
    for bandwidth, kp, ki in sorted(found, reverse=True):
        pi = control.tf([kp + ki * dt, -kp], [1.0, -1.0], 1.0)
        loop = control.ss(pi - damps) * plant
        if np.abs(control.poles(control.feedback(loop, 1))).max() < 1.0:
            measured = control.frd(loop(z), 2.0 * np.pi * f * dt)
            margins = np.atleast_1d(control.stability_margins(measured, returnall=True)[0])
            if margins[margins > 1.0].min(initial=np.inf) >= MARGIN:
                return bandwidth, kp, ki
    return 0.0, 0.0, 0.0


def compared(alone, damped):
    """Return what is said of two bandwidths."""
    share = damped[0] / alone[0]
    return (
        f"{alone[0]:.1f} Hz, {damped[0]:.1f} Hz with damping ({share:.2f} times; at least "
        f"{THREE:g}: {kept(share >= THREE)})"
    )


def scanning_stage():
    """Return the published vibration of the scanning stage, of gain one, and its first mode."""
    stage = load_scanning_stage_parameters()
    numerator = stage.numerator * stage.denominator[-1] / stage.numerator[-1]
    poles = np.roots(stage.denominator)
    w = 2.0 * np.pi * stage.natural_frequencies[0]
    first = poles[np.argmin(np.abs(poles - 1j * w))]
    residue = np.polyval(numerator, first) / np.prod(first - poles[poles != first])
    share = -2.0 * (residue / first).real
    return (numerator, stage.denominator), (w / (2.0 * np.pi), share)


# -------------------------------------------------------------------------------------- the motor


def identify(seed):
    """Return the recording of a slow drive, and a model of the foot that is clamped."""
    drives = (
        decaying_sine(5.0, 5.0, decay=1.0, duration=3.5, dt=DT),
        swept_sine(0.1, 800.0, duration=3.0, amplitude=0.5, dt=DT),
    )
    (slow, fast) = [
        make_inchworm_motor(drive, random_state=seed + k, **SENSOR)[:2]
        for k, drive in enumerate(drives)
    ]
    X, y = stack_records([slow, fast], labels=["slow", "sweep"], dt=DT)
    steps = [("hysteresis", PrandtlIshlinskii(20)), ("mode", SecondOrderMode())]
    return *slow, Cascade(steps).fit(X, y)


class Motor:
    """The motor, which walks by all voltages and is controlled by that of the foot that stands."""

    def __init__(self, seed):
        self._motor = inchworm_motor_stepper(self._rows([-AMPLITUDE], [0.0], 0)[0], dt=DT)
        self._rng = np.random.default_rng(seed)
        self._pair = 0
        self._stand()

    @staticmethod
    def _rows(bend, clamp, pair):
        """Return the voltages of both pairs, those of the other one being opposite."""
        own, other = np.column_stack([bend, clamp]), -np.column_stack([bend, clamp])
        return np.hstack([other, own] if pair else [own, other])

    def _run(self, bend, clamp):
        return self._motor.run(self._rows(bend, clamp, self._pair))

    def _stand(self):
        """Clamp the foot that is at its lowest voltage, and wait."""
        rise = AMPLITUDE * np.append(smooth(500), np.ones(3000))
        self._run(np.full(rise.size, -AMPLITUDE), rise)

    def walk(self, n_steps):
        """Walk, and stand on the foot that is next."""
        self._run(np.full(500, -AMPLITUDE), AMPLITUDE * smooth(500)[::-1])
        half = walking_drive(1, amplitude=AMPLITUDE, frequency=WALK, dt=DT).to_numpy()[1:]
        for _ in range(n_steps):
            self._run(half[:, 0], half[:, 1])
            self._pair = 1 - self._pair
        self._stand()

    def read(self):
        """Return the mean of a hundred readings at rest."""
        readings = self._run(np.full(100, -AMPLITUDE), np.full(100, AMPLITUDE))
        return np.mean(readings + SENSOR["noise"] * self._rng.standard_normal(100))

    def foot(self):
        """Return the device that is fed the voltage of the foot that stands, from here."""
        row = self._rows([-AMPLITUDE], [AMPLITUDE], self._pair)[0]
        return Foot(self._motor.copy(), row, 2 * self._pair)


class Foot:
    """The clamped foot of a motor."""

    def __init__(self, motor, row, column):
        self._motor, self._row, self._column = motor, row, column

    def step(self, u):
        """Return the position of the runner."""
        self._row[self._column] = u
        return self._motor.step(self._row)


class ByPath(RegressorMixin, BaseEstimator):
    """The network of (8) from response to drive, over the path of the drive in the place of time.

    Hysteresis knows no time, and in steps of the path errors do not add up: see the example on the
    paper's network.
    """

    def __init__(self, steps=(0.25, 0.2, 0.16), random_state=0):
        self.steps = steps  # V
        self.random_state = random_state

    def fit(self, X, y):
        """Learn the drive y from the response X."""
        x = np.ravel(X)
        samples = []
        for step in self.steps:
            path, grid = by_path(y, step)
            samples.append(tuple(np.interp(grid, *moving(path, signal)) for signal in (x, y)))
        self.share_ = np.ptp(x) / np.ptp(y)
        network = SCNRegressor(80, scaling="whiten", tolerance=1e-6, random_state=self.random_state)
        self.network_ = NARXRegressor(network, initial_output=0.0).fit(*stack_records(samples))
        return self

    def predict(self, X):
        """Return the drive for a response."""
        x = np.ravel(X)
        path, grid = by_path(x, self.steps[1] * self.share_)
        run = self.network_.predict(stack_records([np.interp(grid, *moving(path, x))]))
        return np.interp(path, grid, run)


def by_path(signal, step):
    """Return a signal's path, and a grid on it: all turning points, and at most this step."""
    path = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(signal)))])
    way = np.sign(np.diff(signal))
    moves = np.flatnonzero(way)
    turns = moves[1:][way[moves[1:]] != way[moves[:-1]]]
    corners = np.unique(path[np.r_[0, turns, len(path) - 1]])
    parts = [np.linspace(a, b, 1 + int(np.ceil((b - a) / step)))[1:] for a, b in pairwise(corners)]
    return path, np.concatenate([[0.0], *parts])


def moving(path, signal):
    """Return path and signal where the path goes on."""
    kept = np.r_[True, np.diff(path) > 0.0]
    return path[kept], signal[kept]


class Behind:
    """A compensator for a foot that has come to its lowest voltage, as in walking."""

    def __init__(self, compensator, lowest, start):
        self.compensator, self.lowest, self.start = compensator, lowest, start

    def drive_for(self, reference, dt):
        """Return the drive (n_samples,) from there."""
        down = np.concatenate([self.lowest * smooth(2000), np.full(500, self.lowest)])
        whole = np.concatenate([down, reference - self.start + self.lowest])
        return self.compensator.drive_for(whole, dt)[len(down) :]


def approach(motor, target, stroke):
    """Walk until the foot can reach the target; return where the runner is, and the steps."""
    steps, where = 0, motor.read()
    while target - where > 0.9 * stroke:
        n_steps = max(1, int(0.9 * (target - where - 0.05 * stroke) / stroke))
        motor.walk(n_steps)
        before, where = where, motor.read()
        stroke, steps = (where - before) / n_steps, steps + n_steps
    return where, steps


def followed(controller, frequency, amplitude=0.05):
    """Return amplitude over that of a sine of the reference, which the simulated motor follows."""
    periods = 4
    n = round(1.0 / (frequency * DT)) * periods
    wave = np.exp(2j * np.pi * periods / n * np.arange(2 * n))
    reference = amplitude * wave.imag
    response = simulate_loop(inchworm_motor_stepper(dt=DT), controller, reference, DT).response
    return np.abs(np.mean(response[n:] * wave[n:].conj())) / (0.5 * amplitude)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    warnings.simplefilter("ignore", ReachWarning)

    drive, response, model = identify(options.seed)
    mode = model.operator_.stages[1]
    frequency = mode.natural_frequency / (2.0 * np.pi)
    gain = float(np.polyfit(drive["drive"], response, 1)[0])  # um/V
    print(
        f"identified to {1e3 * model.fit_error_:.1f} nm: {frequency:.1f} Hz, damping ratio "
        f"{mode.damping_ratio:.4f}, {1e3 * gain:.1f} nm/V"
    )
    w, ratio = mode.natural_frequency, mode.damping_ratio
    resonant = [1.0], [w**-2, 2.0 * ratio / w, 1.0]
    unit = IntegralResonantControl((frequency, 1.0))
    alone, damped = widest(resonant, DT), widest(resonant, DT, unit)
    print(f"motor: bandwidth with PI {compared(alone, damped)}")
    damping = IntegralResonantControl((frequency, gain))
    for (bandwidth, kp, ki), own in ((alone, None), (damped, damping)):
        controller = FeedforwardPI(kp / gain, ki / gain, damping=own)
        level = 20.0 * np.log10(followed(controller, bandwidth))
        print(f"  there the simulated motor follows 50 nm by {level:.1f} dB")
    stage, first = scanning_stage()
    for name, kps in {"I": KPS[:1], "PI": KPS}.items():
        own = max(
            widest(stage, STAGE_DT, IntegralResonantControl(first, damping_ratio=ratio), kps)
            for ratio in RATIOS
        )
        both = compared(widest(stage, STAGE_DT, kps=kps), own)
        print(f"scanning stage: bandwidth with {name} {both}", flush=True)

    learned = InverseCompensator(ByPath(), method="learned", rate_limit=2e3).fit(drive, response)
    inverse = InverseCompensator(model, bandwidth=500.0, rate_limit=2e3).fit(drive, response)
    down = -AMPLITUDE * smooth(2000)
    lowest = float(model.operator_.run(down, DT)[0][-1])
    for target in TARGETS:
        motor = Motor(options.seed)
        start, n_steps = approach(motor, target, 2.0 * AMPLITUDE * gain)
        wanted = start + (target - start) * np.concatenate(
            [smooth(round(RISE / DT)), np.ones(round(HOLD / DT))]
        )
        print(f"{target:g} um: {n_steps} steps, then {target - start:.3f} um by the foot")
        errors = {}
        for (_, kp, ki), own_damping in ((alone, None), (damped, damping)):
            for name, own in {"PI": None, "SCN + PI": learned, "inverse + PI": inverse}.items():
                controller = FeedforwardPI(
                    kp / gain,
                    ki / gain,
                    compensator=own and Behind(own, lowest, start),
                    damping=own_damping,
                    drive_limits=(-5.0, 5.0),
                )
                loop = simulate_loop(
                    motor.foot(),
                    controller,
                    wanted,
                    DT,
                    u0=-AMPLITUDE,
                    random_state=options.seed,
                    **SENSOR,
                )
                left = loop.response - wanted
                errors[name] = np.sqrt(np.mean(left**2))
                last = 1e3 * np.abs(left[-round(0.1 / DT) :]).max()
                bar = 1e3 * (SETTLED + SENSOR["noise"])
                share = errors[name] / errors["PI"]
                judged = "" if own is None else f" (at most {FIFTH:g}: {kept(share <= FIFTH)})"
                print(
                    f"  {name + (', damped' if own_damping else ''):21s} error "
                    f"{1e3 * errors[name]:8.3f} nm, {share:5.3f} of PI's{judged}, settled "
                    f"{last:.3f} nm (at most {bar:.1f}: {kept(last <= bar)})",
                    flush=True,
                )


if __name__ == "__main__":
    main()
