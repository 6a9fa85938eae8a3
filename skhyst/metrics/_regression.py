"""Errors relative to the response: to its range, its deviation from the mean, its value."""

import numpy as np
import pandas as pd
from sklearn.metrics import root_mean_squared_error
from sklearn.utils import check_array, check_consistent_length, column_or_1d

from .._documentation import documented_like
from ..records import refuse_masked


def _check_responses(y_true, y_pred, sample_weight):
    """Return both as finite arrays of one shape (n_samples, n_outputs), and the weights."""
    own, other = (getattr(values, "index", None) for values in (y_true, y_pred))
    timed = all(isinstance(i, pd.Index) and not isinstance(i, pd.RangeIndex) for i in (own, other))
    if timed and len(own) == len(other) and not own.equals(other):
        raise ValueError(
            "The index of y_true and that of y_pred must be equal. Got rows in another order or of "
            "another recording instead; align them (y_pred.loc[y_true.index])."
        )
    if sample_weight is None:
        sample_weight = np.ones(len(y_true))
    named = {"y_true": y_true, "y_pred": y_pred, "sample_weight": sample_weight}
    for name, values in named.items():
        refuse_masked(name, values)
    arrays = [
        check_array(values, ensure_2d=False, dtype=np.float64, input_name=name)
        for name, values in named.items()
    ]
    check_consistent_length(*arrays)
    y_true, y_pred = (y[:, None] if y.ndim == 1 else y for y in arrays[:2])
    sample_weight = column_or_1d(arrays[2])
    if y_true.shape != y_pred.shape:
        raise ValueError(
            f"The 'y_pred' parameter must have as many outputs as y_true, {y_true.shape[1]}. Got "
            f"{y_pred.shape[1]} instead."
        )
    return y_true, y_pred, sample_weight


def _standardised(y_true, y_pred, caller):
    """Return both in units of the range of y_true, from its minimum: no square overflows."""
    low, high = y_true.min(axis=0), y_true.max(axis=0)
    if (high == low).any():
        raise ValueError(
            f"The 'y_true' parameter of {caller} must vary: the error is relative to its "
            f"variation. Got {len(y_true)} sample(s) equal to {low[high == low][0]:.6g} instead; "
            f"use sklearn.metrics.root_mean_squared_error."
        )
    return (y_true - low) / (high - low), (y_pred - low) / (high - low)


def _combine(errors, multioutput):
    if not isinstance(multioutput, str):
        return float(np.average(errors, weights=multioutput))
    if multioutput == "raw_values":
        return errors
    if multioutput == "uniform_average":
        return float(np.average(errors))
    raise ValueError(
        f"The 'multioutput' parameter must be 'raw_values', 'uniform_average' or weights. Got "
        f"{multioutput!r} instead."
    )


def nrmse(
    y_true, y_pred, *, sample_weight=None, multioutput="uniform_average"
) -> float | np.ndarray:
    r"""Root mean square error over the range of the measured response.

    .. math:: \mathrm{NRMSE} = \frac{\sqrt{\frac{1}{n} \sum_t (y_t - \hat y_t)^2}}
       {\max_t y_t - \min_t y_t}

    Parameters
    ----------
    y_true : array-like of shape (n_samples,) or (n_samples, n_outputs)
        Measured response.
    y_pred : array-like of shape (n_samples,) or (n_samples, n_outputs)
        Predicted response, in the same units.
    sample_weight : array-like of shape (n_samples,), optional
        Weights of the samples in all sums and means.
    multioutput : {"raw_values", "uniform_average"} or array-like of shape (n_outputs,)
        How outputs are combined: not at all, by their mean, or by a mean with these weights.

    Returns
    -------
    float, or ndarray of shape (n_outputs,) for ``multioutput="raw_values"``
        A fraction, not percent; 0 is best. It does not depend on units or on an offset of both.

    Raises
    ------
    ValueError
        If ``y_true`` is constant, a value is not finite, or the lengths differ.

    References
    ----------
    .. [1] Han et al., *An Identification Method for Dynamic Systems with SCNs Hysteresis
       Compensator*, undated, (11).

    Examples
    --------
    >>> from skhyst.metrics import nrmse
    >>> nrmse([0.0, 2.0, 4.0], [0.4, 2.4, 4.4])
    0.1...
    """
    y_true, y_pred, weights = _check_responses(y_true, y_pred, sample_weight)
    errors = root_mean_squared_error(
        *_standardised(y_true, y_pred, "nrmse"), sample_weight=weights, multioutput="raw_values"
    )
    return _combine(errors, multioutput)


@documented_like(nrmse)
def fit_percent(
    y_true, y_pred, *, sample_weight=None, multioutput="uniform_average"
) -> float | np.ndarray:
    r"""Fit in percent: 100 for an exact prediction, 0 for the mean of the response.

    .. math:: \mathrm{fit} = 100 \left(1 - \frac{\lVert y - \hat y \rVert_2}
       {\lVert y - \bar y \rVert_2}\right)

    It is :math:`100 (1 - \sqrt{1 - R^2})`, with the R2 of :func:`sklearn.metrics.r2_score`, but
    computed from the norms, since that root loses half of the digits of a good fit.

    Returns
    -------
    float, or ndarray of shape (n_outputs,) for ``multioutput="raw_values"``
        100 is best, 0 is as good as the mean of ``y_true``, below 0 is worse than that mean.

    Raises
    ------
    ValueError
        If ``y_true`` is constant, a value is not finite, or the lengths differ.

    References
    ----------
    .. [1] Ljung, *System Identification*, 1999.

    Examples
    --------
    >>> from skhyst.metrics import fit_percent
    >>> fit_percent([-1.0, 1.0], [-0.5, 0.5])
    50.0
    """
    y_true, y_pred, weights = _check_responses(y_true, y_pred, sample_weight)
    y_true, y_pred = _standardised(y_true, y_pred, "fit_percent")
    deviation = y_true - np.average(y_true, axis=0, weights=weights)
    ratio = np.sqrt((weights @ (y_true - y_pred) ** 2) / (weights @ deviation**2))
    return _combine(100 * (1 - ratio), multioutput)


@documented_like(nrmse)
def mape(
    y_true, y_pred, *, sample_weight=None, multioutput="uniform_average"
) -> float | np.ndarray:
    r"""Mean absolute error relative to each measured value, in percent.

    .. math:: \mathrm{MAPE} = \frac{100}{n} \sum_t \left| \frac{\hat y_t - y_t}{y_t} \right|

    Samples near zero dominate it: for a response that passes through zero, use :func:`nrmse`.

    Returns
    -------
    float, or ndarray of shape (n_outputs,) for ``multioutput="raw_values"``
        In percent; 0 is best. It does not depend on units, but on the zero of the response.

    Raises
    ------
    ValueError
        If a value of ``y_true`` is zero, a value is not finite, or the lengths differ.

    Notes
    -----
    100 times :func:`sklearn.metrics.mean_absolute_percentage_error`, except where
    ``abs(y_true) < 2.2e-16``: scikit-learn divides by 2.2e-16 there, which returns a number
    without meaning for a zero and makes the result depend on the unit.

    References
    ----------
    .. [1] Xie et al., *Smart Materials and Structures*, 2023, (20). There it is a fraction: 0.0276
       there is 2.76 here.

    Examples
    --------
    >>> from skhyst.metrics import mape
    >>> mape([1.0, 2.0, 4.0], [1.5, 2.0, 3.0])
    25.0
    """
    y_true, y_pred, weights = _check_responses(y_true, y_pred, sample_weight)
    zeros = np.flatnonzero((y_true == 0).any(axis=1))
    if zeros.size:
        raise ValueError(
            f"The 'y_true' parameter of mape must not contain zeros: the error is relative to "
            f"each value. Got {zeros.size} zero(s), the first one in row {zeros[0]}, instead; use "
            f"nrmse or smape, or leave these rows out."
        )
    errors = np.average(np.abs((y_pred - y_true) / y_true), axis=0, weights=weights)
    return _combine(100 * errors, multioutput)


@documented_like(nrmse)
def smape(
    y_true, y_pred, *, sample_weight=None, multioutput="uniform_average"
) -> float | np.ndarray:
    r"""Mean absolute error relative to the mean magnitude of both values, in percent.

    .. math:: \mathrm{SMAPE} = \frac{100}{n} \sum_t \frac{|\hat y_t - y_t|}
       {(|\hat y_t| + |y_t|) / 2}

    A sample where both values are zero is predicted perfectly and counts 0; one where a single
    value is zero, or where the signs differ, counts 200.

    Returns
    -------
    float, or ndarray of shape (n_outputs,) for ``multioutput="raw_values"``
        From 0 (best) to 200 percent. It does not depend on units, nor on which of the two comes
        first, but on the zero of the response.

    Raises
    ------
    ValueError
        If a value is not finite or the lengths differ.

    Notes
    -----
    Xie et al. (2023) print the denominator without absolute values, which is the same for responses
    above zero; where the response changes its sign, terms would be negative or infinite.

    References
    ----------
    .. [1] Xie et al., *Smart Materials and Structures*, 2023, (21). There it is a fraction.

    Examples
    --------
    >>> from skhyst.metrics import smape
    >>> smape([0.0, 1.0, 3.0, 2.0], [0.0, 3.0, 1.0, 2.0])
    50.0
    """
    y_true, y_pred, weights = _check_responses(y_true, y_pred, sample_weight)
    error = np.abs(y_pred - y_true)
    magnitude = np.abs(y_pred) / 2 + np.abs(y_true) / 2
    terms = np.divide(error, magnitude, out=np.zeros_like(error), where=magnitude > 0)
    return _combine(100 * np.average(terms, axis=0, weights=weights), multioutput)
