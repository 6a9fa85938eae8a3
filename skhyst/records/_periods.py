"""Periodicity of a drive: exact and approximate."""

import numpy as np

# power of the difference between the signal and the shifted signal, relative to that of both
_AWAY = 0.2  # above it, the signal has left its initial course
_BACK = 0.05  # below it, the signal repeats
_PROBES = 64  # samples that rule out most lags
_FINE = 4  # lags per sample: a parabola then has the depth of a period of three samples to 1e-3


def repeats(a, b):
    """Whether two signals are equal except for rounding."""
    return np.max(np.abs(a - b)) <= 1e-6 * np.ptp(a)


def drive_period(u):
    """Return the shortest period of a moving signal in samples, or 0."""
    n = len(u)
    if n < 6 or not np.ptp(u) > 0.0:
        return 0
    v, correlation = _autocorrelation(u)
    lags = np.arange(2, n // 2)
    # a period makes the overlap's correlation about equal to its power
    lags = lags[correlation[lags] > 0.99 * (v @ v) * (1.0 - lags / n)]
    probes = np.linspace(0, n - n // 2 - 1, _PROBES).astype(int)
    for probe in probes:
        lags = lags[np.abs(u[probe + lags] - u[probe]) <= 1e-6 * np.ptp(u)]
    for lag in lags:
        if repeats(u[lag:], u[:-lag]):
            return int(lag)
    return 0


def _autocorrelation(u, fine=1):
    """Return the signal minus its mean, and its autocovariance sums at ``fine`` lags per sample.

    Those between the samples are of the band-limited signal.
    """
    v, n = u - u.mean(), len(u)
    spectrum = np.square(np.abs(np.fft.rfft(v, 2 * n)))
    spectrum[-1] /= 1.0 if fine == 1 else 2.0  # the line at half the rate is two of a finer one
    return v, fine * np.fft.irfft(spectrum, 2 * n * fine)[: n * fine]


def near_period(u):
    """Return the period in samples after which a moving signal repeats approximately, or 0.

    Such as the measured drive of a periodic motion. Within a period, the signal must differ from
    its start, so that a slow start is not taken for a repetition.
    """
    n = len(u)
    if n < 6 or not np.ptp(u) > 0.0:
        return 0
    v, correlation = _autocorrelation(u, _FINE)
    # lags up to half of the signal, so that it contains two periods, and one more for the minimum
    lags = np.arange(_FINE * (n // 2 + 1) + 1) / _FINE
    correlation, rows = correlation[: len(lags)], np.arange(n + 1)
    power = np.concatenate([[0.0], np.cumsum(v * v)])
    overlap_power = np.interp(n - lags, rows, power) + power[n] - np.interp(lags, rows, power)
    difference = 1.0 - 2.0 * correlation / np.maximum(overlap_power, np.finfo(float).tiny)
    low, middle, high = difference[:-2], difference[1:-1], difference[2:]
    has_left = np.maximum.accumulate(difference)[1:-1] > _AWAY
    candidates = np.flatnonzero(has_left & (middle < low) & (middle <= high))
    # the vertex of the parabola through three samples
    low, middle, high = low[candidates], middle[candidates], high[candidates]
    depths = middle - (low - high) ** 2 / (8.0 * (low - 2.0 * middle + high))
    best = depths.min(initial=np.inf)
    if best > _BACK:
        return 0
    # the first of about equal minima: others are multiples of the period; 2 / n is the uncertainty
    # of an overlap whose end lies between samples
    lag = 1 + candidates[np.argmax(depths <= 2.0 * best + 2.0 / n)]
    return _between_samples(difference, int(lag)) / _FINE


def _between_samples(difference, lag):
    """Return the lag of the smallest difference near a lag, refined by its multiples."""
    period, multiple = float(lag), 1
    while True:
        centre = round(multiple * period)
        if not 0 < centre < len(difference) - 1:
            return period
        low, middle, high = difference[centre - 1 : centre + 2]
        curvature = low - 2.0 * middle + high
        if not (curvature > 0.0 and abs(low - high) <= 2.0 * curvature):  # none near by
            return period
        period = (centre + 0.5 * (low - high) / curvature) / multiple
        multiple *= 2
