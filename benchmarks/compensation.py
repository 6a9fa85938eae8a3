"""Drive the simulated scanning stage along references: `python benchmarks/compensation.py`.

    python benchmarks/compensation.py [--trials 6] [--seed 0]

The cascade of Steinbusch (2020) is identified from recordings of the stage, noise on, and inverted.
Each line is a reference, a sine that begins and ends at rest: the root mean square error over its
range with the gain of the slowest triangle alone, with the compensator, and after trials on the
stage, and the noise of its sensor. The stage shares no code with the models.
"""

import argparse
import warnings

import numpy as np
import pandas as pd
from thesis_cascade import cascade, fit, identify_vibration, resonances

from skhyst.control import InverseCompensator
from skhyst.datasets import make_scanning_stage
from skhyst.exceptions import ReachWarning

RATE = 250e3  # Hz
STROKE = 2.0  # um, peak to peak
PERIODS, SAMPLES = 4, 400  # of a reference; at the least in a period, but for the sampling rate
TENTH, TWICE = 0.1, 2.0  # bars: of the error with the gain alone; noise after the trials


def reference(frequency):
    """Return a sine at rest at both ends, (n_samples,) in um, and its interval in s."""
    dt = max(1.0 / (SAMPLES * frequency), 1.0 / RATE)
    time = dt * np.arange(round((PERIODS + 2) / frequency / dt))
    inside = np.minimum(time * frequency - 1.0, PERIODS + 1.0 - time * frequency)
    window = np.clip(inside, 0.0, 1.0)
    rise = window**3 * (10.0 - 15.0 * window + 6.0 * window**2)
    return 0.5 * STROKE * rise * np.sin(2.0 * np.pi * frequency * time), dt


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=6)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)

    def seed():
        return int(rng.integers(2**31))

    vibration = identify_vibration(*make_scanning_stage("small_signal", random_state=seed())[:2])
    X, y, truth = make_scanning_stage("identification", random_state=seed())
    model, seconds = fit(cascade(vibration), X, y)
    print(f"identified in {seconds:.1f} s; sensor noise {truth.noise_std} um")
    slow = X.loc["1 Hz"].iloc[:, 0].to_numpy(), y.loc["1 Hz"].to_numpy()
    gain, offset = np.polyfit(*slow, 1)
    (first, *_), _ = resonances(vibration)
    limits = {"drive_limits": None, "rate_limit": None}  # the simulated stage has none
    compensator = InverseCompensator(model, bandwidth=RATE / 4.0, **limits).fit(X, y)
    for frequency in (1.0, 10.0, 100.0, 1e3, 5e3, 0.7 * first):
        wanted, dt = reference(frequency)

        def measure(u, dt=dt, clean=False):
            frame = pd.DataFrame({"drive": u}, pd.Index(dt * np.arange(len(u)), name="time"))
            _, y, truth = make_scanning_stage(frame, random_state=seed())
            return (truth.response if clean else y).to_numpy()

        def error(u, wanted=wanted, measure=measure):
            left = measure(u, clean=True) - wanted
            return np.sqrt(np.mean(left**2)) / np.ptp(wanted)

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ReachWarning)
            alone = error((wanted - offset) / gain)
            compensated = error(compensator.drive_for(wanted, dt))
            frame = pd.DataFrame({"drive": wanted}, pd.Index(dt * np.arange(len(wanted))))
            frame.index.name = "time"
            refined = error(compensator.refine(frame, measure, options.trials))
        noise = truth.noise_std / np.ptp(wanted)
        verdicts = [
            "kept" if value <= limit else "MISSED"
            for value, limit in ((compensated, TENTH * alone), (refined, TWICE * noise))
        ]
        print(
            f"{frequency:8.0f} Hz: gain alone {100 * alone:7.3f} %, compensated "
            f"{100 * compensated:7.4f} % (at most a tenth: {verdicts[0]}), after {options.trials} "
            f"trials {100 * refined:7.4f} % (at most {100 * TWICE * noise:.3f} %: {verdicts[1]})",
            flush=True,
        )


if __name__ == "__main__":
    main()
