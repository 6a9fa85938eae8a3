"""Drives, further columns, and noise, of a recording. Time counts in samples."""

import numpy as np
from scipy.signal import lfilter

N_TRAIN, N_TEST = 5, 3


def log_uniform(rng, low, high, size=None):
    return np.exp(rng.uniform(np.log(low), np.log(high), size))


def to_unit_peak(signal):
    return signal / np.abs(signal).max()


def triangles(n, rng):
    """Draw ramps between turning points of alternating sign and varying height, from zero."""
    half = 0.5 * log_uniform(rng, 200, 900)
    count = int(n / (0.75 * half)) + 3
    times = np.concatenate([[0.0], np.cumsum(half * rng.uniform(0.8, 1.2, count))])
    signs = rng.choice([-1.0, 1.0]) * (-1.0) ** np.arange(count)
    heights = np.concatenate([[0.0], signs * rng.uniform(0.4, 1.0, count)])
    return to_unit_peak(np.interp(np.arange(n), times, heights))


def swept_sine(n, rng):
    """Draw a sine whose frequency grows or falls exponentially, below every mode."""
    low, high = 1.0 / rng.uniform(1000, 2000), 1.0 / log_uniform(rng, 70, 150)
    if rng.random() < 0.5:
        low, high = high, low
    growth = np.log(high / low)
    cycles = low * n / growth * np.expm1(growth * np.arange(n) / n)
    return to_unit_peak(np.sin(2 * np.pi * cycles))


def steps(n, rng):
    """Draw random levels, each held for a while, joined by smooth edges of 4 to 20 samples."""
    rise = rng.uniform(4, 20)
    t = np.arange(n)
    signal = np.zeros(n)
    level, start = 0.0, rng.uniform(20, 100)
    while start < n:
        new = rng.uniform(-1, 1)
        while abs(new - level) < 0.4:
            new = rng.uniform(-1, 1)
        edge = 0.5 - 0.5 * np.cos(np.pi * np.clip((t - start) / rise, 0, 1))
        signal += (new - level) * edge
        level, start = new, start + rise + log_uniform(rng, 60, 700)
    return to_unit_peak(signal)


def multisine(n, rng):
    """Draw a periodic sum of harmonics of falling amplitude and random phase."""
    period, cutoff = log_uniform(rng, 600, 2000), 1.0 / log_uniform(rng, 30, 90)
    harmonics = np.arange(1, max(3, int(cutoff * period)) + 1)
    amplitudes = rng.uniform(0.3, 1.0, harmonics.size) / harmonics
    phases = rng.uniform(0, 2 * np.pi, harmonics.size)
    angles = 2 * np.pi * np.outer(np.arange(n), harmonics) / period + phases
    return to_unit_peak(np.sin(angles) @ amplitudes)


def band_limited_noise(n, rng):
    """Draw Gaussian noise whose spectrum falls with frequency and ends at a cutoff."""
    cutoff = 1.0 / log_uniform(rng, 30, 90)
    size = 2 * n
    frequencies = np.fft.rfftfreq(size)
    shape = np.where(frequencies < cutoff, 1.0 / (1.0 + (frequencies * 400) ** 2), 0.0)
    shape[frequencies < 1 / 3000] = 0.0
    signal = np.fft.irfft(np.fft.rfft(rng.standard_normal(size)) * shape, size)[:n]
    return to_unit_peak(signal - signal.mean())


SIGNALS = (triangles, swept_sine, steps, multisine, band_limited_noise)


def draw_drives(rng, n_samples, scale):
    """Draw one record of each kind to fit on, and three others, of unequal lengths."""
    shares = rng.uniform(0.85, 1.15, N_TRAIN)
    ends = np.round(n_samples * np.cumsum(shares) / shares.sum()).astype(int)
    lengths = np.diff(ends, prepend=0)
    lengths = np.append(lengths, rng.permutation(lengths)[:N_TEST])
    kinds = [*rng.permutation(len(SIGNALS)), *rng.permutation(len(SIGNALS))[:N_TEST]]
    amplitudes = rng.uniform(0.6, 1.0, N_TRAIN + N_TEST)
    amplitudes[rng.integers(N_TRAIN)] = 1.0
    amplitudes[N_TRAIN:] *= 0.96
    room = (1.0 - amplitudes) * (rng.random(amplitudes.size) < 0.5)
    offsets = room * rng.uniform(-1, 1, amplitudes.size)
    drives = [
        scale * (a * SIGNALS[kind](n, rng) + b)
        for kind, n, a, b in zip(kinds, lengths, amplitudes, offsets, strict=True)
    ]
    return drives, [SIGNALS[kind].__name__ for kind in kinds]


def spread_amplitudes(rng, drives, scale):
    """Return the drives with peaks from 0.3 to 1 of the scale, those held out between them."""
    fitted = rng.permutation(np.linspace(0.3, 1.0, N_TRAIN))
    peaks = np.append(fitted, rng.uniform(0.4, 0.95, N_TEST))
    return [scale * peak * to_unit_peak(drive) for peak, drive in zip(peaks, drives, strict=True)]


def wandering(n, rng):
    """Draw a slow random signal of unit size, as of a temperature."""
    periods = log_uniform(rng, 250, 2500, 4)
    phases = rng.uniform(0, 2 * np.pi, 4)
    return np.sin(2 * np.pi * np.arange(n)[:, None] / periods + phases) @ rng.dirichlet(np.ones(4))


def levels(n, rng):
    """Draw random levels within one, each held for a while, as of a load put on and taken off."""
    choices = rng.uniform(-1, 1, rng.integers(2, 5))
    choices[:2] = rng.permutation([-1.0, 1.0]) * rng.uniform(0.6, 1.0, 2)
    signal = np.empty(n)
    start, last = 0, -1
    while start < n:
        last = rng.choice([i for i in range(choices.size) if i != last])
        stop = start + int(log_uniform(rng, 120, 700))
        signal[start:stop] = choices[last]
        start = stop
    return signal


def draw_column(rng, lengths):
    """Draw a further column: its name, its values in each record, its middle and size."""
    law, name = ((wandering, "temperature"), (levels, "load"))[rng.integers(2)]
    middle, size = (25.0, rng.uniform(2, 8)) if law is wandering else (50.0, rng.uniform(5, 40))
    return name, [middle + size * law(n, rng) for n in lengths], middle, size


def draw_colour(rng):
    """Draw the law of coloured noise: three of four are autoregressive."""
    coefficient = rng.uniform(0.5, 0.97)
    if rng.random() < 0.75:
        return {"law": "autoregressive", "coefficient": coefficient}
    return {"law": "flicker"}


def draw_noise(rng, n, law, coefficient=0.0):
    """Draw stationary Gaussian noise of unit variance, white, of first order or flicker noise.

    The power of the last is one over the frequency, from half the sampling rate down to one cycle
    in two records.
    """
    if law == "white":
        return rng.standard_normal(n)
    if law == "autoregressive":
        innovations = rng.standard_normal(n)
        innovations[1:] *= np.sqrt(1.0 - coefficient**2)
        return lfilter([1.0], [1.0, -coefficient], innovations)
    gains = np.append(0.0, np.arange(1.0, n + 1.0) ** -0.5)
    gains *= np.sqrt(2 * n / (2.0 * np.sum(gains[:-1] ** 2) + gains[-1] ** 2))
    return np.fft.irfft(np.fft.rfft(rng.standard_normal(2 * n)) * gains, 2 * n)[:n]
