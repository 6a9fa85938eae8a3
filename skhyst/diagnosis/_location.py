"""Where what is left stands: in which record, when, at which drive, at which frequency."""

from itertools import pairwise

import numpy as np
import pandas as pd

__all__ = ["locate"]

_COLUMNS = ["by", "record", "low", "high", "unit", "share", "concentration"]


def locate(records, residuals, labels):
    """Return how the power of a residual is spread.

    Parameters
    ----------
    records : sequence of RecordData
    residuals : sequence of ndarray of shape (n_samples,)
        Of each record, NaN where nothing counts.
    labels : sequence
        Of the records.

    Returns
    -------
    DataFrame
        One row a record, a tenth of a record's time, of the drive, of the drive's rate (tenths by
        number of samples), and an octave of frequency: ``by``, ``record`` (of its time only),
        ``low``, ``high``, ``unit``, ``share`` of the residual's power, and ``concentration``, the
        mean power there over that of the whole. White noise has a concentration of one everywhere.
        Sorted by concentration within each ``by``.
    """
    known = [np.isfinite(r) for r in residuals]
    power = [np.square(r[k]) for r, k in zip(residuals, known, strict=True)]
    total, count = sum(p.sum() for p in power), sum(p.size for p in power)
    if not total > 0.0:
        return pd.DataFrame(columns=_COLUMNS)

    def row(by, record, low, high, unit, own, size):
        share = float(own / total)
        return by, record, float(low), float(high), unit, share, share * count / max(size, 1)

    rows = []
    for label, record, keep, own in zip(labels, records, known, power, strict=True):
        time, last = record.dt * np.flatnonzero(keep), record.dt * (len(keep) - 1)
        rows.append(row("record", label, 0.0, last, "s", own.sum(), own.size))
        parts = _parts(np.linspace(0.0, last, 11), time, own)
        rows += [row("time", label, low, high, "s", *part) for low, high, *part in parts if part[1]]
    everything = np.concatenate(power)
    drives = [(r.u, np.gradient(r.u, r.dt)) for r in records]
    for i, (by, unit) in enumerate((("drive", "drive"), ("rate", "drive/s"))):
        values = np.concatenate([pair[i][k] for pair, k in zip(drives, known, strict=True)])
        edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, 11)))
        parts = _parts(edges, values, everything)
        rows += [row(by, None, low, high, unit, *part) for low, high, *part in parts]
    rows += [("frequency", None, *own[:2], "Hz", *own[2:]) for own in _octaves(records, residuals)]
    order = ["record", "time", "drive", "rate", "frequency"]
    rows.sort(key=lambda own: (order.index(own[0]), -own[-1]))
    return pd.DataFrame(rows, columns=_COLUMNS)


def _parts(edges, values, power):
    """Yield low, high, power and number of samples of the stretches between edges of a signal."""
    which = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    for i, (low, high) in enumerate(pairwise(edges)):
        yield low, high, power[which == i].sum(), np.count_nonzero(which == i)


def _octaves(records, residuals):
    """Yield low, high (Hz), share and concentration of the residual's spectrum, by octaves."""
    top = 0.5 / min(record.dt for record in records)
    longest = max(len(record.u) * record.dt for record in records)
    count = max(int(np.floor(np.log2(top * longest))), 1)
    edges = np.concatenate([[0.0], top * 2.0 ** np.arange(-count + 1.0, 1.0)])
    own, width = np.zeros(count), np.zeros(count)
    for record, residual in zip(records, residuals, strict=True):
        filled = np.where(np.isfinite(residual), residual, 0.0)
        spectrum = np.abs(np.fft.rfft(filled)) ** 2
        frequency = np.fft.rfftfreq(len(filled), record.dt)
        which = np.clip(np.searchsorted(edges, frequency, side="left") - 1, 0, count - 1)
        own += np.bincount(which, spectrum, minlength=count) / len(filled)
        width += np.bincount(which, minlength=count)
    share, part = own / own.sum(), width / width.sum()
    for i in range(count):
        if part[i] > 0.0:
            yield float(edges[i]), float(edges[i + 1]), float(share[i]), float(share[i] / part[i])
