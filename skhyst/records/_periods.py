"""Periodicity of a drive: exact and approximate."""

import numpy as np

# as parts of the power of the difference to the shifted drive
_AWAY = 0.2  # it has moved on
_BACK = 0.05  # it is there again
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
    """Return the period in samples after which a moving signal repeats itself roughly, or 0.

    As a motion does that is driven periodically. Before that time the signal has to have been away.
    """
    n = len(u)
    if n < 6 or not np.ptp(u) > 0.0:
        return 0
    v, correlation = _autocorrelation(u, _FINE)
    # two turns, and what tells that the second one is the end
    lags = np.arange(_FINE * (n // 2 + 1) + 1) / _FINE
    correlation, rows = correlation[: len(lags)], np.arange(n + 1)
    power = np.concatenate([[0.0], np.cumsum(v * v)])
    both = np.interp(n - lags, rows, power) + power[n] - np.interp(lags, rows, power)
    difference = 1.0 - 2.0 * correlation / np.maximum(both, np.finfo(float).tiny)
    low, least, high = difference[:-2], difference[1:-1], difference[2:]
    back = np.maximum.accumulate(difference)[1:-1] > _AWAY
    at = np.flatnonzero(back & (least < low) & (least <= high))
    # the vertex of the parabola through three samples
    low, least, high = low[at], least[at], high[at]
    depths = least - (low - high) ** 2 / (8.0 * (low - 2.0 * least + high))
    best = depths.min(initial=np.inf)
    if best > _BACK:
        return 0
    # not a multiple of the period; an overlap that ends between samples is known but for these
    lag = 1 + at[np.argmax(depths <= 2.0 * best + 2.0 / n)]
    return _between_samples(difference, int(lag)) / _FINE


def _between_samples(difference, lag):
    """Return the place of least difference near a lag, refined by means of its multiples."""
    period, multiple = float(lag), 1
    while True:
        at = round(multiple * period)
        if not 0 < at < len(difference) - 1:
            return period
        low, least, high = difference[at - 1 : at + 2]
        bend = low - 2.0 * least + high
        if not (bend > 0.0 and abs(low - high) <= 2.0 * bend):  # none near by
            return period
        period = (at + 0.5 * (low - high) / bend) / multiple
        multiple *= 2
