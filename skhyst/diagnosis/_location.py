"""Where what is left stands: in which record, when, at which drive, at which frequency."""

from itertools import pairwise

import numpy as np
import pandas as pd

__all__ = ["locate"]

_PARTS = 10  # of a record's duration, of the drive's and of its rate's range of quantiles
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
        time = record.dt * np.flatnonzero(keep)
        last = record.dt * (len(keep) - 1)
        rows.append(row("record", label, 0.0, last, "s", own.sum(), own.size))
        edges = np.linspace(0.0, last, _PARTS + 1)
        which = np.clip(np.searchsorted(edges, time, side="right") - 1, 0, _PARTS - 1)
        for i, (low, high) in enumerate(pairwise(edges)):
            inside = own[which == i]
            if inside.size:
                rows.append(row("time", label, low, high, "s", inside.sum(), inside.size))
    everything = np.concatenate(power)
    for by, unit, signal in (
        ("drive", "drive", [r.u[k] for r, k in zip(records, known, strict=True)]),
        (
            "rate",
            "drive/s",
            [np.gradient(r.u, r.dt)[k] for r, k in zip(records, known, strict=True)],
        ),
    ):
        values = np.concatenate(signal)
        edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, _PARTS + 1)))
        which = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
        for i, (low, high) in enumerate(pairwise(edges)):
            inside = everything[which == i]
            rows.append(row(by, None, low, high, unit, inside.sum(), inside.size))
    rows += [
        ("frequency", None, low, high, "Hz", share, concentration)
        for low, high, share, concentration in _octaves(records, residuals)
    ]
    table = pd.DataFrame(rows, columns=_COLUMNS)
    order = {"record": 0, "time": 1, "drive": 2, "rate": 3, "frequency": 4}
    table["order"] = table["by"].map(order)
    table = table.sort_values(["order", "concentration"], ascending=[True, False])
    return table.drop(columns="order").reset_index(drop=True)


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
