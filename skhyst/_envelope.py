"""Outline of a long signal."""

import numpy as np


def envelope(values, n_bins):
    """Return the rows that keep the outline of long signals, (n_samples,) or one per column.

    The rows of the smallest and of the largest value in each of ``n_bins`` parts of equal length
    are kept, so that no peak is lost. NaN is ignored.
    """
    values = np.asarray(values, dtype=float)
    signals = values[:, None] if values.ndim == 1 else values
    n_samples, n_signals = signals.shape
    if n_samples <= 2 * n_signals * n_bins:
        return np.arange(n_samples)
    starts = np.linspace(0, n_samples, n_bins + 1).astype(int)
    length = int(np.max(np.diff(starts)))
    rows = np.minimum(starts[:-1, None] + np.arange(length), starts[1:, None] - 1)
    kept = [np.array([0, n_samples - 1])]
    at = np.arange(n_bins)
    for signal in signals.T:
        block = signal[rows]
        kept.append(rows[at, np.argmin(np.where(np.isnan(block), np.inf, block), axis=1)])
        kept.append(rows[at, np.argmax(np.where(np.isnan(block), -np.inf, block), axis=1)])
    return np.unique(np.concatenate(kept))
