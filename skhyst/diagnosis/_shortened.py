"""Long records cut after their first part, in which a search looks around before it decides."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

__all__ = ["are_long", "shortened", "suffices"]

# Samples in all, above which records are cut, and which are left of them. With independent noise,
# chance changes the gain of an effect that removes the part p of the error by sqrt(2 / (p n)) of
# that gain: by 6 % for the least that is claimed by default.
_ENOUGH = 10_000
_REACHED = 0.9  # range of the drive in a first part, relative to the whole record's
_SHARE = 0.8  # mean power of the residual in the first part, relative to the whole record's


def are_long(records):
    """Whether records have so many samples that their first parts are searched."""
    return sum(len(record.u) for record in records) > _ENOUGH


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
    return [_first_part(r, e, _ENOUGH / total) for r, e in zip(records, residuals, strict=True)]


def suffices(effect, structure, records, parts):
    """Whether first parts can show an effect.

    What stands beside the driven part may belong to the end of a record, and what depends on the
    amplitude of a record is seen in a part that has this amplitude.
    """
    if effect.beside:
        return False
    by = [getattr(variant, "by", None) for variant in effect.variants()]
    return not (structure.follows_amplitude or "amplitude" in by) or all(
        np.ptp(part.u) >= _REACHED * np.ptp(record.u)
        for record, part in zip(records, parts, strict=True)
    )


def _first_part(record, residual, share):
    n = len(record.u)
    power = np.square(np.where(np.isfinite(residual), residual, 0.0))
    if record.weights is not None:
        power *= record.weights
    known = np.cumsum(np.isfinite(residual))
    power = np.cumsum(power)
    least = _SHARE * power[-1] / max(known[-1], 1)
    stop = max(int(share * n), len(record.segments))
    while stop < n and power[stop - 1] < least * known[stop - 1]:
        stop *= 2
    if stop >= n:
        return record
    edges = np.linspace(0, stop, len(record.segments) + 1).astype(int)
    return replace(
        record,
        u=record.u[:stop],
        y=record.y[:stop],
        segments=tuple(pairwise(edges.tolist())),
        auxiliary=None if record.auxiliary is None else record.auxiliary[:stop],
        weights=None if record.weights is None else record.weights[:stop],
    )
