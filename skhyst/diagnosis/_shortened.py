"""Long records cut after their first part, in which a search looks around before it decides."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from ._constants import ENOUGH, MOST


def are_long(records):
    """Whether records have so many samples that their first parts are searched."""
    return sum(len(record.u) for record in records) > ENOUGH


def shortened(records, residuals):
    """Return the first part of each long record, or None where the records are short enough.

    A first part is simulated as the record is, from its own start. It is as long as it has to be to
    show what the rest of the record shows: where the residual is smaller in it than in the record
    on the whole, as where a slow effect builds up or a sweep comes late to a resonance, it is
    doubled.

    Parameters
    ----------
    records : sequence of RecordData
    residuals : sequence of ndarray of shape (n_samples,)
        Of the model so far; NaN where nothing counts.

    Returns
    -------
    list of RecordData or None
    """
    if not are_long(records):
        return None
    total = sum(len(record.u) for record in records)
    return [_first_part(r, e, ENOUGH / total) for r, e in zip(records, residuals, strict=True)]


def suffices(effect, structure, records, parts):
    """Whether first parts can show an effect.

    An additive disturbance may belong to the end of a record, and what depends on the
    amplitude of a record is seen in a part that has this amplitude.
    """
    if effect.beside:
        return False
    by = [getattr(variant, "by", None) for variant in effect.variants()]
    return not (structure.follows_amplitude or "amplitude" in by) or all(
        np.ptp(part.u) >= MOST * np.ptp(record.u)
        for record, part in zip(records, parts, strict=True)
    )


def _first_part(record, residual, share):
    n = len(record.u)
    power = np.square(np.where(np.isfinite(residual), residual, 0.0))
    if record.weights is not None:
        power *= record.weights
    known = np.cumsum(np.isfinite(residual))
    power = np.cumsum(power)
    least = MOST * power[-1] / max(known[-1], 1)
    stop = max(int(share * n), len(record.segments))
    while stop < n and power[stop - 1] < least * known[stop - 1]:
        stop *= 2
    return record if stop >= n else first_part(record, stop)


def first_part(record, stop):
    """Return a record up to a sample, in as many segments."""
    edges = np.linspace(0, stop, len(record.segments) + 1).astype(int)
    return replace(
        record,
        u=record.u[:stop],
        y=record.y[:stop],
        segments=tuple(pairwise(edges.tolist())),
        auxiliary=None if record.auxiliary is None else record.auxiliary[:stop],
        weights=None if record.weights is None else record.weights[:stop],
        explained=None if record.explained is None else record.explained[:stop],
    )
