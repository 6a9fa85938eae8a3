"""Best linear approximations of a measured mirror, and how its resonances move with amplitude.

    python benchmarks/frequency_responses.py [--data ../shared/data] [--modes 6] [--figure PATH]

The fine steering mirror (three piezo stacks, three displacements) was excited by orthogonal
multisines of 100, 200 and 300 mV rms. For each level: the median size of the response, of its noise
and of its nonlinear distortion; and the resonances, from a local fit to all nine responses at once.
Their standard errors are by jackknife over the realisations; what the local fit leaves out of the
neighbouring modes is not in them, and about the same at each level. Looked for is a shift: the
hysteresis of the stacks makes them softer at larger amplitudes.
"""

import argparse
from pathlib import Path

import numpy as np
import pandas as pd
from recordings import SHARED, load_piezo_fsm
from scipy.optimize import least_squares
from scipy.signal import find_peaks, peak_widths

from skhyst.inspection import FrequencyResponseDisplay
from skhyst.linear import frequency_response

LEVELS = (100, 200, 300)  # mV rms


def recording(level, data):
    """Return all steady-state realisations of one level, by record."""
    splits = ("train", "test") if level != 300 else ("train",)  # no test records at 300 mV
    parts = [load_piezo_fsm(level, split, data) for split in splits]
    return [pd.concat(frames) for frames in zip(*parts, strict=True)]


def responses(X, Y):
    """Return the best linear approximation of each displacement."""
    return [frequency_response(X, Y[name], transient_periods=0) for name in Y]


def stacked(found):
    """Return the lines and the nine responses and their deviations, shape (n, 9)."""
    return (
        found[0].frequency,
        np.hstack([g.response for g in found]),
        np.hstack([g.std for g in found]),
    )


def find_modes(found, count):
    """Return (centre, half width) in Hz of the first peaks of the mean magnitude."""
    frequency, g, std = stacked(found)
    size = np.mean(np.log(np.abs(g) ** 2 + std**2), axis=1)
    size = np.convolve(size, np.ones(3) / 3.0, mode="same")
    usable = frequency > 100.0
    peaks, _ = find_peaks(np.where(usable, size, size[usable].min()), prominence=0.7)
    widths = peak_widths(size, peaks, rel_height=0.5)[0]
    step = frequency[1] - frequency[0]
    return [(frequency[p], step * max(6.0, w)) for p, w in zip(peaks, widths, strict=True)][:count]


def fit_mode(found, centre, half_width):
    """Fit one mode with residues of its own and a straight background; return Hz, damping."""
    frequency, g, std = stacked(
        [part.restrict(centre - half_width, centre + half_width) for part in found]
    )
    weight = 1.0 / np.sqrt(np.mean(std**2, axis=0))
    s = 1j * frequency / centre

    def residual(p):
        frequency_, damping = np.exp(p)
        mode = 1.0 / (s**2 + 2.0 * damping * frequency_ * s + frequency_**2)
        basis = np.column_stack([mode, s * mode, np.ones_like(s), s - 1j])
        left = (g - basis @ np.linalg.lstsq(basis, g, rcond=None)[0]) * weight
        return np.concatenate([left.real.ravel(), left.imag.ravel()])

    p = least_squares(residual, np.log([1.0, 0.3 * half_width / centre]), x_scale=[1e-3, 0.1]).x
    return np.array([centre * np.exp(p[0]), np.exp(p[1])])


def jackknife(X, Y, modes):
    """Return the fitted modes (n_modes, 2) and their standard errors."""
    records = X.index.get_level_values("record")
    labels = records.unique()
    found = responses(X, Y)
    values = np.array([fit_mode(found, *mode) for mode in modes])
    others = []
    for label in labels:
        kept = records != label
        part = responses(X[kept], Y[kept])
        others.append([fit_mode(part, *mode) for mode in modes])
    n, n_inputs = len(labels), X.shape[1]
    spread = (n - 1) * np.var(others, axis=0)
    # least squares for n_inputs unknowns: leaving one of n out moves it too far by this factor
    return found, values, np.sqrt(spread * (n - n_inputs) / (n - 1))


def summary(level, found):
    """Print the size of response, noise and distortion, one line an output."""
    for part in found:
        size = np.sqrt(np.sum(np.abs(part.response) ** 2, axis=1))
        noise, distortion, total = (
            100 * np.median(np.sqrt(np.sum(values**2, axis=1)) / size)
            for values in (part.noise_std, part.distortion_std, part.std)
        )
        print(
            f"{level:>5}  {part.output_name:<6} {len(size):>5} {1e6 * np.median(size):>14.3f}"
            f" {noise:>14.3f} {total:>14.3f} {distortion:>18.3f}"
        )


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=SHARED)
    parser.add_argument("--modes", type=int, default=6, help="how many resonances")
    parser.add_argument("--figure", type=Path, help="PNG file of the responses to write")
    options = parser.parse_args()
    loaded = {level: recording(level, options.data) for level in LEVELS}
    modes = find_modes(responses(*loaded[100]), options.modes)
    found, values, errors = {}, {}, {}
    print("medians over the lines; of the response's size: noise and all errors of the mean over")
    print("realisations, distortion of one realisation")
    print("level  output lines  response um/V  noise of mean %  error of mean %  distortion %")
    for level in LEVELS:
        found[level], values[level], errors[level] = jackknife(*loaded[level], modes)
        summary(level, found[level])
    print("\nresonance at 100 mV, and its shift from there (standard errors)")
    for m in range(len(modes)):
        f, damping = values[100][m]
        df, dz = errors[100][m]
        line = f"{f:8.2f} ({df:.2f}) Hz, damping {100 * damping:.3f} ({100 * dz:.3f}) %"
        for level in LEVELS[1:]:
            shift = values[level][m, 0] - f
            error = np.hypot(errors[level][m, 0], df)
            line += f";  {level} mV {shift:+.2f} ({error:.2f}) Hz, {100 * shift / f:+.2f} %"
        print(line)
    if options.figure:
        others = {f"{level} mV": found[level][0] for level in LEVELS[1:]}
        display = FrequencyResponseDisplay.from_response(
            found[100][0].restrict(500.0, 1200.0),
            {name: part.restrict(500.0, 1200.0) for name, part in others.items()},
            log_frequency=False,
        )
        display.figure_.savefig(options.figure, dpi=110)


if __name__ == "__main__":
    main()
