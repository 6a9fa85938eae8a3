"""Watch simulated stages in service: `python benchmarks/monitoring.py`.

    python benchmarks/monitoring.py [--samples 10000000] [--plants 60] [--rate 1e-5] [--seed 0]

Each stage has plays, a lag, and a mode, of its own numbers, and shares no code with the models: its
signal path is advanced on a grid eight times finer than the samples. It is driven by triangles of
varying size, identified once from a recording with the sensor's noise, and watched from then on:
how often there is an alarm while nothing has changed, how soon a gain that has changed by 2 %, at
once or bit by bit, is found, and whether the parameter that has changed is named. One that cannot
be told from others is named together with them: both counts are printed.
"""

import argparse
import warnings
from dataclasses import dataclass, replace

import numpy as np

from skhyst.compose import Cascade
from skhyst.control import Monitor, Observer
from skhyst.datasets.simulation import first_order, oscillate, plays, refine
from skhyst.exceptions import ConvergenceWarning
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import FirstOrderLag, SecondOrderMode

DT, PERIOD, SUBSTEPS = 1e-3, 200, 8  # s; samples of a triangle; of a sample
THRESHOLDS = np.arange(4.0)
NOISE = 0.02  # the response is about 20 from end to end
RECORD = 1_000_000  # samples of a record in service
LEARNT, SERVED = 20_000, 20  # samples of the recording; periods after a change
FACTOR, DRIFT, FOUND, NAMED = 2.0, 0.02, 10, 0.9  # bars


@dataclass(frozen=True)
class Stage:
    """A signal path: plays, a lag, a mode."""

    weights: np.ndarray
    lag: float  # s
    frequency: float  # Hz
    damping: float

    def respond(self, u, gain=1.0):
        """Return the response at the samples; the gain is a number, or one at each sample."""
        h = DT / SUBSTEPS
        gain = refine(np.broadcast_to(gain, u.shape), SUBSTEPS)
        y = gain * plays(refine(u, SUBSTEPS), h, THRESHOLDS, self.weights)
        y = first_order(y, h, self.lag)
        return oscillate(y, h, self.frequency, self.damping)[::SUBSTEPS]


def stages(rng):
    """Return a stage."""
    weights = np.r_[1.0, rng.uniform(0.2, 0.5, len(THRESHOLDS) - 1)]
    numbers = rng.uniform([0.002, 50.0, 0.02], [0.006, 80.0, 0.06])
    return Stage(weights, *numbers.tolist())


def triangles(n, rng):
    """Return triangles of 5 Hz whose size changes from one to the next, from zero."""
    periods = np.arange(n) / PERIOD
    sizes = rng.uniform(2.0, 6.0, int(periods[-1]) + 2)
    wave = 1.0 - 4.0 * np.abs((periods + 0.25) % 1.0 - 0.5)
    return -wave * np.interp(periods, np.arange(len(sizes)), sizes)


def changes(stage, rng):
    """Return a parameter's name in the model, and the stage with this one changed."""
    share = 1.0 + rng.choice([-1.0, 1.0]) * rng.uniform(0.02, 0.1)
    kind = rng.choice(["gain", "weight", "frequency", "damping", "lag"])
    if kind == "gain":
        return "gain", replace(stage, weights=share * stage.weights)
    if kind == "weight":
        j = rng.integers(len(stage.weights))
        own = np.where(np.arange(len(stage.weights)) == j, share, 1.0)
        return f"plays__weights[{j}]", replace(stage, weights=own * stage.weights)
    names = {
        "frequency": "mode__natural_frequency",
        "damping": "mode__damping_ratio",
        "lag": "lag__time_constant",
    }
    return names[kind], replace(stage, **{kind: share * getattr(stage, kind)})


def reading(response, rng):
    """Return what the sensor reads."""
    return response + NOISE * rng.normal(size=len(response))


def watched(stage, rate, rng):
    """Return the monitor of a stage that has been identified."""
    u = triangles(LEARNT, rng)
    steps = [
        ("plays", PrandtlIshlinskii(thresholds=THRESHOLDS)),
        ("lag", FirstOrderLag()),
        ("mode", SecondOrderMode()),
    ]
    monitor = Monitor(Observer(Cascade(steps, dt=DT)), false_alarms=rate)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        return monitor.fit(u[:, None], reading(stage.respond(u), rng))


def false_alarms(monitor, stage, samples, rng):
    """Return the number of alarms while nothing has changed."""
    count = 0
    for start in range(0, samples, RECORD):
        u = triangles(min(RECORD, samples - start), rng)
        count += int(monitor.alarms(u[:, None], reading(stage.respond(u), rng)).sum())
    return count


def periods_until_found(monitor, stage, gain, rng):
    """Return the periods until a gain that changes with time, or at once, is found."""
    n = SERVED * PERIOD
    u = triangles(n, rng)
    y = stage.respond(u, gain)
    found = np.flatnonzero(monitor.alarms(u[:, None], reading(y, rng)))
    return (found[0] + 1) / PERIOD if len(found) else np.inf


def verdict(kept):
    """Return the word for a bar."""
    return "kept" if kept else "MISSED"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=10_000_000)
    parser.add_argument("--plants", type=int, default=60)
    parser.add_argument("--rate", type=float, default=1e-5)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)

    stage = stages(rng)
    monitor = watched(stage, options.rate, rng)
    count, nominal = (
        false_alarms(monitor, stage, options.samples, rng),
        options.rate * options.samples,
    )
    within = nominal / FACTOR <= count <= nominal * FACTOR
    print(
        f"false alarms in {options.samples:.0e} samples: {count}, nominal {nominal:.0f} (within a "
        f"factor of {FACTOR:g}: {verdict(within)})",
        flush=True,
    )
    ramp = np.clip(np.arange(SERVED * PERIOD) / (FOUND * PERIOD), 0.0, 1.0)
    longest, named, first, together = {"at once": 0.0, "bit by bit": 0.0}, 0, 0, []
    for _ in range(options.plants):
        stage = stages(rng)
        monitor = watched(stage, options.rate, rng)
        for way, course in (("at once", np.ones_like(ramp)), ("bit by bit", ramp)):
            periods = periods_until_found(monitor, stage, 1.0 + DRIFT * course, rng)
            longest[way] = max(longest[way], periods)
        name, changed = changes(stage, rng)
        periods_until_found(monitor, changed, 1.0, rng)
        suspects = monitor.suspect_
        named += name in suspects
        first += name == "".join(suspects[:1])
        together.append(len(suspects))
        if name not in suspects:
            print(f"  {name} has changed, suspected: {', '.join(suspects) or 'nothing'}")
    for way, periods in longest.items():
        print(
            f"a gain that changes by {100.0 * DRIFT:g} % {way}: found after {periods:.1f} periods "
            f"at the most (at most {FOUND}: {verdict(periods <= FOUND)})"
        )
    print(
        f"the parameter that has changed: named in {named} of {options.plants}, first in {first}; "
        f"{np.mean(together):.1f} names on average (at least {NAMED:.0%}: "
        f"{verdict(first >= NAMED * options.plants)})"
    )


if __name__ == "__main__":
    main()
