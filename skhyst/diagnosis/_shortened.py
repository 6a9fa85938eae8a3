"""Long records cut to their first parts, on which a search screens effects."""

import numpy as np

from ._constants import ENOUGH, MOST


def are_long(records):
    """Whether records are so long that only their first parts are screened."""
    return sum(len(record.u) for record in records) > ENOUGH


def shortened(records, residuals):
    """Return the first part of each long record, or None if the records are short enough.

    A first part is simulated like the record, from its own start. It is doubled until the mean
    square of the residual in it is about that of the whole record; a slow effect may build up late,
    or a sweep may reach a resonance late.

    Parameters
    ----------
    records : sequence of RecordData
    residuals : sequence of ndarray of shape (n_samples,)
        Of the current model; NaN where nothing is scored.

    Returns
    -------
    list of RecordData or None
    """
    if not are_long(records):
        return None
    total = sum(len(record.u) for record in records)
    return [_first_part(r, e, ENOUGH / total) for r, e in zip(records, residuals, strict=True)]


def suffices(effect, structure, records, parts):
    """Whether the first parts of records are enough to show an effect.

    An additive disturbance may occur at the end of a record, and an effect that depends on the
    amplitude of a record shows only in a part with the same amplitude.
    """
    if effect.additive:
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
    least = MOST**2 * power[-1] / max(known[-1], 1)
    stop = max(int(share * n), len(record.segments))
    while stop < n and power[stop - 1] < least * known[stop - 1]:
        stop *= 2
    return record if stop >= n else record.first_part(stop)
