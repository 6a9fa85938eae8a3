"""Fewer samples of the same records, to find starting values in."""

from dataclasses import replace

import numpy as np

__all__ = ["thin_records"]

_ENOUGH = 5_000  # samples in all
_LONG = 20_000  # of which thinning pays
_CHANGE = 0.01  # of the drive's standard deviation, that thinning may cost


def thin_records(records):
    """Return records with every n-th sample, about ``_ENOUGH`` in all, or None where it is no use.

    A response stays as it is at the samples that are left, however fast it moves between them. The
    drive must be what it was: a record is thinned only as far as straight lines between its
    samples say so.

    Parameters
    ----------
    records : sequence of RecordData

    Returns
    -------
    list of RecordData or None
    """
    total = sum(len(record.u) for record in records)
    if total < _LONG or any(len(record.segments) > 1 for record in records):
        return None
    thinned = [_thin(record, total // _ENOUGH) for record in records]
    return thinned if 2 * sum(len(record.u) for record in thinned) <= total else None


def _thin(record, step):
    while step > 1:
        kept = record.u[::step]
        covered = (len(kept) - 1) * step + 1
        lines = np.interp(np.arange(covered), np.arange(0, covered, step), kept)
        change = np.sqrt(np.mean(np.square(record.u[:covered] - lines)))
        if len(kept) > 1 and change <= _CHANGE * record.u.std():
            weights = None if record.weights is None else record.weights[::step]
            return replace(
                record,
                u=kept,
                y=record.y[::step],
                dt=step * record.dt,
                segments=(),
                weights=weights,
            )
        step //= 2
    return record
