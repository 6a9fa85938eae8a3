"""Whether new samples lie within the standard deviation: `python benchmarks/prediction_std.py`.

    python benchmarks/prediction_std.py [--plants 50] [--seed 0]

Plants of random numbers are simulated by other code than that of the models
(`skhyst.datasets.simulation`, SciPy), with white noise, or noise of the first order with a
correlation of 0.9 a sample, of 3 % of the response. Each is fitted from a short record (400
samples) and predicts a record of 2,000 samples of another drive. Printed is which part of the
new samples, of all plants, lies within 1.96 standard deviations of the prediction
(`predict(X, return_std=True)`); what it should be is 95 %, the bar is 90 to 99 %. Beside it stands
the part within 1.96 of the noise alone: where it is lower, the errors of the parameters matter.
"""

import argparse
import warnings

import numpy as np
from scipy.signal import lfilter

from skhyst.compose import Cascade, Sum
from skhyst.datasets.simulation import first_order, oscillate, plays, refine
from skhyst.disturbance import Offset
from skhyst.exceptions import ConvergenceWarning, ExtrapolationWarning
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import FirstOrderLag, SecondOrderMode, TransferFunction
from skhyst.static import SmoothCurve

DT, SHORT, LONG, SUBSTEPS = 1e-3, 400, 2000, 8
THRESHOLDS = (0.0, 0.3, 0.6)
LEVELS = 0.90, 0.99


def main():
    parser = argparse.ArgumentParser(description=__doc__.split(":")[0])
    parser.add_argument("--plants", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    print(f"{'plant':22s} {'noise':10s} {'within':>7s} {'of the noise alone':>19s}")
    missed = 0
    for name in PLANTS:
        for colour in (0.0, 0.9):
            counts = [counted(name, colour, args.seed + i) for i in range(args.plants)]
            within, alone = np.mean(counts, axis=0)
            missed += not LEVELS[0] <= within <= LEVELS[1]
            noise = "AR(1) 0.9" if colour else "white"
            print(f"{name:22s} {noise:10s} {within:7.1%} {alone:19.1%}")
    print(f"{missed} of {2 * len(PLANTS)} outside of {LEVELS[0]:.0%} to {LEVELS[1]:.0%}")


def counted(name, colour, seed):
    """Return the parts of new samples within the standard deviation, and within the noise."""
    rng = np.random.default_rng(seed)
    respond, model = PLANTS[name](rng)
    known, new = drive(SHORT, rng), drive(LONG, rng)
    clean = [respond(refine(u, SUBSTEPS))[::SUBSTEPS] for u in (known, new)]
    size = 0.03 * np.ptp(clean[0])
    y, later = (part + noise(len(part), size, colour, rng) for part in clean)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        warnings.simplefilter("ignore", ExtrapolationWarning)
        model.set_params(dt=DT).fit(known[:, None], y)
        found, std = model.predict(new[:, None], return_std=True)
    away = np.abs(later - found)
    return np.mean(away < 1.96 * std), np.mean(away < 1.96 * model.noise_std_)


def drive(n, rng):
    """Return filtered noise from -1 to 1, after a rise from zero."""
    waves = np.convolve(rng.normal(size=n + 60), np.hanning(40), "valid")[:n]
    waves = 2.0 * (waves - waves.min()) / np.ptp(waves) - 1.0
    return waves * np.minimum(np.arange(n) / 40.0, 1.0)


def noise(n, size, colour, rng):
    """Return white noise, or noise of the first order, of this standard deviation."""
    white = rng.normal(size=n + 200)
    return size * np.sqrt(1.0 - colour**2) * lfilter([1.0], [1.0, -colour], white)[200:]


def mode(rng):
    frequency, damping = rng.uniform(20.0, 60.0), rng.uniform(0.05, 0.3)
    return (lambda u: oscillate(u, DT / SUBSTEPS, frequency, damping)), SecondOrderMode()


def lag(rng):
    constant = rng.uniform(5e-3, 3e-2)
    return (lambda u: first_order(u, DT / SUBSTEPS, constant)), FirstOrderLag()


def hysteresis(rng):
    weights = rng.uniform(0.2, 1.0, 3)
    model = PrandtlIshlinskii(thresholds=list(THRESHOLDS))
    return (lambda u: plays(u, DT / SUBSTEPS, np.array(THRESHOLDS), weights)), model


def stage(rng):
    (first, model), (second, behind) = hysteresis(rng), lag(rng)
    return (lambda u: second(first(u))), Cascade([("plays", model), ("lag", behind)])


def curved_stage(rng):
    (first, model), curve = lag(rng), rng.uniform(-0.2, 0.2)

    def respond(u):
        y = first(u)
        return y + curve * y**3

    return respond, Cascade([("lag", model), ("curve", SmoothCurve(3))])


def offset_stage(rng):
    (respond, model), constant = stage(rng), rng.normal()
    parts = [("stage", model), ("offset", Offset())]
    return (lambda u: respond(u) + constant), Sum(parts)


def two_poles(rng):
    (respond, _), (further, _) = mode(rng), lag(rng)
    return (lambda u: further(respond(u))), TransferFunction(3)


PLANTS = {
    "lag": lag,
    "mode": mode,
    "three poles": two_poles,
    "plays": hysteresis,
    "plays | lag": stage,
    "lag | curve": curved_stage,
    "(plays | lag) + offset": offset_stage,
}

if __name__ == "__main__":
    main()
