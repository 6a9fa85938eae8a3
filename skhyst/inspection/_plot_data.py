"""Numbers behind the pictures: thinning, cycles, branches, binned means and spectra."""

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import welch

from .._envelope import envelope


def cycle_length(drive):
    """Return the mean length of a cycle in samples, from the crossings of the middle of the range.

    Only crossings that continue to a tenth of the range beyond the middle count, so sensor noise
    makes no cycles. A drive that never returns is one cycle.
    """
    low, high = np.min(drive), np.max(drive)
    offset = np.asarray(drive, dtype=float) - 0.5 * (low + high)
    side = np.sign(offset) * (np.abs(offset) > 0.1 * (high - low))
    side = side[side != 0]
    passages = np.count_nonzero(np.diff(side))
    return 2.0 * len(drive) / max(passages + 1, 2)


def branch(drive) -> np.ndarray:
    """Return +1 where the drive rises and -1 where it falls, with sensor noise smoothed out.

    Parameters
    ----------
    drive : ndarray of shape (n_samples,)
        It is smoothed over a fiftieth of a cycle first.

    Returns
    -------
    ndarray of int of shape (n_samples,)

    Examples
    --------
    >>> from skhyst.inspection import branch
    >>> branch([0.0, 1.0, 2.0, 1.5, 1.0]).tolist()
    [1, 1, 1, -1, -1]
    """
    width = max(1, int(cycle_length(drive) / 50))
    smooth = uniform_filter1d(np.asarray(drive, dtype=float), width, mode="nearest")
    return np.where(np.gradient(smooth) >= 0.0, 1, -1) if len(smooth) > 1 else np.ones(1, int)


def thin_path(x, y, n_points):
    """Return the rows that keep the outline of a path, at most ``n_points`` + 2."""
    return envelope(np.column_stack([x, y]), max(1, n_points // 4))


def loop_spans(drive, spans, max_cycles):
    """Choose the parts of a recording to draw as loops; return the slice and cycles of each.

    Only a few cycles are distinguishable in one picture. If there are more, every record (or, of
    very many records, some at even distances) contributes complete cycles around its largest
    excursion.
    """
    if len(spans) > max_cycles:
        spans = [spans[k] for k in np.linspace(0, len(spans) - 1, max_cycles).astype(int)]
    lengths = [cycle_length(drive[span]) for span in spans]
    cycles = [(span.stop - span.start) / n for span, n in zip(spans, lengths, strict=True)]
    share = min(1.0, max_cycles / sum(cycles))
    middle = 0.5 * (np.min(drive) + np.max(drive))
    chosen = []
    for span, length, count in zip(spans, lengths, cycles, strict=True):
        size = span.stop - span.start
        count = count if share == 1.0 else min(count, max(1.0, share * count))
        kept = min(size, int(np.ceil(count * length)))
        peak = span.start + int(np.argmax(np.abs(drive[span] - middle)))
        start = min(max(span.start, peak - kept // 2), span.stop - kept)
        chosen.append((slice(start, start + kept), count))
    return chosen


def binned_statistics(
    x, values, n_bins=40, min_count=5
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the mean and the scatter of values in bins of equal width along a signal.

    Parameters
    ----------
    x, values : ndarray of shape (n_samples,)
        The signal along which bins are formed, and the values.
    n_bins : int, default=40
        Number of bins over the range of ``x``.
    min_count : int, default=5
        Fewest finite values of a bin that is returned.

    Returns
    -------
    center, mean, std : ndarray of shape (n_found,)
        Means of ``x`` and of ``values``, and the standard deviation of the latter.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.inspection import binned_statistics
    >>> x = np.linspace(0.0, 1.0, 100)
    >>> binned_statistics(x, 2.0 * x, n_bins=2)[1].round(1).tolist()
    [0.5, 1.5]
    """
    valid = np.isfinite(x) & np.isfinite(values)
    x, values = x[valid], values[valid]
    if x.size == 0:
        return (np.empty(0),) * 3
    low, high = x.min(), x.max()
    at = np.zeros(x.size, dtype=int)
    if high > low:
        at = np.minimum((n_bins * ((x - low) / (high - low))).astype(int), n_bins - 1)
    count = np.bincount(at, minlength=n_bins)
    used = count >= min(min_count, x.size)
    count = count[used]
    mean = np.bincount(at, values, n_bins)[used] / count
    center = np.bincount(at, x, n_bins)[used] / count
    full_mean = np.zeros(n_bins)
    full_mean[used] = mean
    square = np.bincount(at, (values - full_mean[at]) ** 2, n_bins)[used] / count
    return center, mean, np.sqrt(square)


def finite_runs(values, spans):
    """Return the slices, within the records, where ``values`` has no gap."""
    runs = []
    for span in spans:
        edges = np.diff(np.concatenate([[0], np.isfinite(values[span]).astype(int), [0]]))
        starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
        runs += [
            slice(span.start + int(a), span.start + int(b))
            for a, b in zip(starts, stops, strict=True)
        ]
    return runs


def spectrum(values, spans, dt, max_segment=8192, per_decade=None) -> tuple[np.ndarray, np.ndarray]:
    """Return the amplitude spectral density of a signal with gaps, averaged over its runs.

    Welch's method (Welch, *IEEE Transactions on Audio and Electroacoustics*, 1967) with Hann
    windows, every run weighted by its number of samples. A run that is shorter than the window is
    one window, padded with zeros to the same frequencies.

    Parameters
    ----------
    values : ndarray of shape (n_samples,)
        NaN in the gaps.
    spans : list of slice
        The records.
    dt : float
        Sampling interval, s.
    max_segment : int, default=8192
        Largest number of samples of a window.
    per_decade : int, optional
        Bands of equal width on a logarithmic axis over which the power is averaged.

    Returns
    -------
    frequency, density : ndarray of shape (n_frequencies,)
        Hz, without zero, and units of the signal per root Hz; empty where no run has 16 samples.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.inspection import spectrum
    >>> signal = np.sin(2 * np.pi * 50.0 * np.arange(4000) * 1e-3)
    >>> frequency, density = spectrum(signal, [slice(0, 4000)], 1e-3)
    >>> float(frequency[density.argmax()])
    50.0
    """
    runs = [run for run in finite_runs(values, spans) if run.stop - run.start >= 16]
    if not runs:
        return np.empty(0), np.empty(0)
    lengths = np.array([run.stop - run.start for run in runs])
    order = np.sort(lengths)[::-1]
    typical = order[np.searchsorted(np.cumsum(order), 0.5 * order.sum())]
    segment = int(min(max_segment, typical))
    power, weight, frequency = 0.0, 0, None
    for run, length in zip(runs, lengths, strict=True):
        window = min(segment, length)
        frequency, density = welch(values[run], 1.0 / dt, nperseg=window, nfft=segment)
        power, weight = power + length * density, weight + length
    found = frequency[1:], np.sqrt(power[1:] / weight)
    return found if per_decade is None else log_average(*found, per_decade)


def log_average(frequency, density, per_decade=40):
    """Average a spectral density over bands of equal width on a logarithmic axis.

    Narrow lines are kept where the bands are narrower than the frequency resolution; the high end
    becomes smooth. Power is averaged, so the area is kept.
    """
    if frequency.size == 0:
        return frequency, density
    band = np.floor(per_decade * np.log10(frequency / frequency[0]) + 1e-9).astype(int)
    _, at = np.unique(band, return_inverse=True)
    count = np.bincount(at)
    return np.bincount(at, frequency) / count, np.sqrt(np.bincount(at, density**2) / count)
