"""Folds that suit records: whole ones, or parts of each where they go further than each other."""

import numpy as np

from ._split import BlockedTimeSeriesSplit

_FOLDS = 5  # as everywhere in scikit-learn
_FEW = 0.05  # of the samples


def suited_cv(records, X):
    """Return what to hold out of records.

    Whole records are the harder test, and the fairer one, as long as they foretell each other.
    Where the drive of some goes beyond all others, in more than a twentieth of all samples, held
    out they tell how a model extrapolates: then a part of each record is held out in turn. Blocks
    of a single record are held out in any case.

    Parameters
    ----------
    records : sequence of RecordSlice
    X : DataFrame or array-like of shape (n_samples, n_inputs)
        Column 0 is the drive.

    Returns
    -------
    int or BlockedTimeSeriesSplit
        The ``cv`` of :func:`segment_folds` and of :class:`~skhyst.diagnosis.EffectSearchCV`.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.model_selection import suited_cv
    >>> from skhyst.records import record_slices, stack_records
    >>> wave = np.sin(np.linspace(0, 60, 500))[:, None]
    >>> X = stack_records([wave, wave])
    >>> suited_cv(record_slices(X), X)
    5
    >>> X = stack_records([wave, 2 * wave, 3 * wave])
    >>> suited_cv(record_slices(X), X)
    BlockedTimeSeriesSplit(n_splits=5, staggered=True, washout=0)
    """
    if len(records) < 2:
        return _FOLDS
    drive = np.asarray(X, dtype=float)[:, 0]
    parts = [drive[record.rows] for record in records]
    ends = np.array([(u.min(), u.max()) for u in parts])
    outside = 0
    for number, u in enumerate(parts):
        others = np.delete(ends, number, axis=0)
        outside += np.count_nonzero((u < others[:, 0].min()) | (u > others[:, 1].max()))
    extrapolates = outside > _FEW * len(drive)
    return BlockedTimeSeriesSplit(_FOLDS, staggered=True) if extrapolates else _FOLDS
