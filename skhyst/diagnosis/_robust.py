"""Weights that keep gross errors of the measurement from the fit, and leave structure alone."""

import numpy as np
from scipy.ndimage import median_filter

__all__ = ["huber_weights"]

_BLOCK = 32  # samples that have a scale of their own


def huber_weights(residuals, threshold=1.345, *, lost=None):
    r"""Return how much each sample counts in a fit that gross errors must not bend.

    Huber's weights of what a residual sticks out of its neighbours by,

    .. math:: w = \min(1, c \, s / |r - \operatorname{med}_7 r|),

    with a running median over seven samples and the scale s from the median absolute deviation
    about it, of the record or of the 32 samples around, whichever is larger. What is slow, and what
    moves as much nearby, is no outlier: it is what a search for structure looks for. Beyond twelve
    standard deviations the weight is zero.

    Parameters
    ----------
    residuals : sequence of ndarray of shape (n_samples,)
        Of each record; a sample without one, NaN, counts in full.
    threshold : float, default=1.345
        Standard deviations up to which a sample counts in full: the default loses 5 % of the
        efficiency where all errors are normal.
    lost : sequence of ndarray of bool, optional
        Lost readings of each record, of weight zero; see
        :func:`~skhyst.diagnosis._data_quality.lost_readings`.

    Returns
    -------
    list of ndarray of shape (n_samples,)
        Between 0 and 1.

    References
    ----------
    P. J. Huber, "Robust estimation of a location parameter", Ann. Math. Statist. 35 (1964).

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.diagnosis._robust import huber_weights
    >>> residual = np.random.default_rng(0).normal(size=1000)
    >>> residual[500] = 40.0
    >>> weights, = huber_weights([residual])
    >>> float(weights[500]), round(float(weights.mean()), 1)
    (0.0, 1.0)
    """
    if not threshold > 0.0:
        raise ValueError(
            "The 'threshold' parameter of huber_weights must be above zero. "
            f"Got {threshold!r} instead."
        )
    found = []
    for number, residual in enumerate(residuals):
        known = np.isfinite(residual)
        if lost is not None:
            known &= ~lost[number]
        weights = np.ones(len(residual))
        weights[known] = _weights(residual[known], threshold)
        if lost is not None:
            weights[lost[number]] = 0.0
        found.append(weights)
    return found


def _weights(r, threshold):
    n = len(r)
    if n < 7:
        return np.ones(n)
    # what lasts half as long as the window of the running median is no outlier
    off = np.abs(r - median_filter(r, 7, mode="nearest"))
    # 1.814 is the deviation of white normal noise over the median size of what is left of it
    scale = 1.814 * np.maximum(np.median(off), _nearby(off))
    # what equals its neighbours but for rounding cannot tell how far is far
    scale = np.maximum(scale, 1e-9 * np.max(np.abs(r)))
    times = off / np.where(scale > 0.0, scale, 1.0)
    weights = np.minimum(1.0, threshold / np.maximum(times, threshold))
    return np.where(times > 12.0, 0.0, weights)


def _nearby(off):
    """Return the largest of the median deviations of a sample's block and the two beside it."""
    n = len(off)
    count = max(n // _BLOCK, 1)
    edges = np.arange(count + 1) * _BLOCK
    edges[-1] = n
    own = np.empty(count)
    own[:-1] = np.median(off[: edges[-2]].reshape(count - 1, _BLOCK), axis=1)
    own[-1] = np.median(off[edges[-2] :])
    wide = np.concatenate([own[:1], own, own[-1:]])
    wide = np.maximum(np.maximum(wide[:-2], wide[2:]), own)
    return np.repeat(wide, np.diff(edges))
