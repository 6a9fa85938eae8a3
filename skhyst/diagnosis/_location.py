"""Location of the residual: by record, time, drive, rate and frequency."""

from itertools import pairwise

import numpy as np
import pandas as pd

from ..records import record_names

_COLUMNS = ["by", "record", "low", "high", "unit", "share", "concentration"]


def locate(slices, drive, residual, units):
    """Return how the power of a residual is distributed over the records, in these units.

    There is one row per record, per tenth of the time of a record, of the drive and of the rate of
    the drive (by number of samples), and per octave of frequency: ``by``, ``record`` (for times
    only), ``low``, ``high``, ``unit``, ``share``, the fraction of the power of the residual, and
    ``concentration``, the mean power there relative to that of all samples, by which rows are
    sorted within each ``by``. White noise has a concentration of one everywhere. The residual is
    NaN where it does not count.
    """
    residuals, drives = ([signal[s.rows] for s in slices] for signal in (residual, drive))
    known = [np.isfinite(r) for r in residuals]
    power = [np.square(r[k]) for r, k in zip(residuals, known, strict=True)]
    total, count = sum(p.sum() for p in power), sum(p.size for p in power)
    if not total > 0.0:
        return pd.DataFrame(columns=_COLUMNS)

    def row(by, record, low, high, unit, own, size):
        share = float(own / total)
        concentration = share * count / max(size, 1)
        return by, record, float(low), float(high), units.of(unit), share, concentration

    rows = []
    for s, name, keep, own in zip(slices, record_names(slices), known, power, strict=True):
        time, last = s.dt * np.flatnonzero(keep), s.dt * (len(keep) - 1)
        rows.append(row("record", name, 0.0, last, "s", own.sum(), own.size))
        parts = _parts(np.linspace(0.0, last, 11), time, own)
        rows += [row("time", name, low, high, "s", *own) for low, high, *own in parts if own[1]]
    rates = [np.gradient(u, s.dt) for u, s in zip(drives, slices, strict=True)]
    for by, unit, signals in (("drive", "drive", drives), ("rate", "drive/s", rates)):
        values = np.concatenate([own[k] for own, k in zip(signals, known, strict=True)])
        edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, 11)))
        parts = _parts(edges, values, np.concatenate(power))
        rows += [row(by, None, low, high, unit, *own) for low, high, *own in parts]
    hertz = units.of("Hz")
    rows += [("frequency", None, *own[:2], hertz, *own[2:]) for own in _octaves(slices, residuals)]
    order = ["record", "time", "drive", "rate", "frequency"]
    rows.sort(key=lambda own: (order.index(own[0]), -own[-1]))
    return pd.DataFrame(rows, columns=_COLUMNS)


def _parts(edges, values, power):
    """Yield low, high, power and number of samples of the stretches between edges of a signal."""
    which = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    for i, (low, high) in enumerate(pairwise(edges)):
        yield low, high, power[which == i].sum(), np.count_nonzero(which == i)


def _octaves(slices, residuals):
    """Yield low, high (Hz), fraction and concentration of the power of the residual by octaves."""
    top = 0.5 / min(s.dt for s in slices)
    longest = max(s.dt * s.n_samples for s in slices)
    count = max(int(np.floor(np.log2(top * longest))), 1)
    edges = np.concatenate([[0.0], top * 2.0 ** np.arange(-count + 1.0, 1.0)])
    own, width = np.zeros(count), np.zeros(count)
    for s, residual in zip(slices, residuals, strict=True):
        spectrum = np.abs(np.fft.rfft(np.nan_to_num(residual))) ** 2
        frequency = np.fft.rfftfreq(s.n_samples, s.dt)
        which = np.clip(np.searchsorted(edges, frequency, side="left") - 1, 0, count - 1)
        own += np.bincount(which, spectrum, minlength=count) / s.n_samples
        width += np.bincount(which, minlength=count)
    share, part = own / own.sum(), width / width.sum()
    for i in np.flatnonzero(part > 0.0):
        yield float(edges[i]), float(edges[i + 1]), float(share[i]), float(share[i] / part[i])
