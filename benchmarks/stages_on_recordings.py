"""Stages with a nonlinear force in their equation of motion, fitted to recordings of others.

    python benchmarks/stages_on_recordings.py

*bouc_wen_benchmark* (simulated, 750 Hz, mass 2 kg): fitted to the five noisy periods, free run on
the noise-free multisine (a few periods of lead-in) and sweep. Limit: 2e-5 m on the multisine;
published: dynoNet 4.5e-5, PNLSS 1.87e-5. *silverbox* (measured, 610 Hz): fitted to nine of ten
realisations of the multisine, free run on the tenth and on the arrow. Limit: 1 mV on the multisine.

Both drives were smooth between samples: the plant of the first was integrated at a multiple of the
rate and filtered before it was thinned out. A stage takes them as straight lines, which at a tenth
of the rate attenuates by 3 %. With ``--upsampling 4`` (the second pass) drive and response are
interpolated band-limited first; errors are those at the recorded samples.
"""

import argparse
import time

import numpy as np
from recordings import load_bouc_wen_benchmark, load_silverbox
from scipy.signal import resample

from skhyst.hysteresis import BoucWenStage, RestoringForce

BOUC_WEN_RATE, SILVERBOX_RATE = 750.0, 610.35  # Hz
LEAD_IN = 5  # periods
N_REALISATIONS = 10


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def finer(signal, factor):
    """Interpolate a band-limited signal."""
    return resample(signal, len(signal) * factor) if factor > 1 else signal


def run(model, drive, factor):
    """Return the free run at the recorded samples."""
    return model.predict(finer(drive, factor)[:, None])[::factor]


def bouc_wen(factor):
    X, y = load_bouc_wen_benchmark()
    model = BoucWenStage(mass=2.0, dt=1.0 / BOUC_WEN_RATE / factor)
    model.fit(finer(X[:, 0], factor)[:, None], finer(y, factor))
    X, y = load_bouc_wen_benchmark("test")
    steady = run(model, np.tile(X[:, 0], 1 + LEAD_IN), factor)[-len(y) :]
    errors = {"multisine": rms(steady - y)}
    X, y = load_bouc_wen_benchmark("test", "sinesweep")
    errors["sweep"] = rms(run(model, X[:, 0], factor) - y)
    return model, errors, 2e-5, "m"


def silverbox(factor):
    X, y = load_silverbox("multisine")
    n = len(y) * (N_REALISATIONS - 1) // N_REALISATIONS
    model = RestoringForce(
        3, damping_degree=1, fit_hysteresis=False, dt=1.0 / SILVERBOX_RATE / factor
    )
    model.fit(finer(X[:n, 0], factor)[:, None], finer(y[:n], factor))
    errors = {"multisine": rms((run(model, X[:, 0], factor) - y)[n:])}
    X, y = load_silverbox("arrow")
    errors["arrow"] = rms(run(model, X[:, 0], factor) - y)
    return model, errors, 1e-3, "V"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--upsampling", type=int, nargs="+", default=[1, 4])
    parser.add_argument("--only", choices=["bouc_wen", "silverbox"])
    arguments = parser.parse_args()
    for name, measure in (("bouc_wen", bouc_wen), ("silverbox", silverbox)):
        if arguments.only not in (None, name):
            continue
        for factor in arguments.upsampling:
            begin = time.process_time()
            model, errors, limit, unit = measure(factor)
            seconds = time.process_time() - begin
            found = "  ".join(f"{part} {error:.3g} {unit}" for part, error in errors.items())
            verdict = "met" if errors["multisine"] <= limit else "missed"
            print(f"{name}, upsampling {factor}: {found}; limit {limit:g} {unit} {verdict}")
            print(f"    fit and runs {seconds:.0f} s of processor time; {model.operator_}")
            print(f"    {model.physical_}")


if __name__ == "__main__":
    main()
