"""Errors relative to the response: to its range, its deviation from the mean, its value."""

import numpy as np
from sklearn.metrics import root_mean_squared_error
from sklearn.utils import check_array, check_consistent_length, column_or_1d

__all__ = ["fit_percent", "mape", "nrmse", "smape"]


def _check_responses(y_true, y_pred):
    """Return both as finite float arrays of shape (n_samples,), equally long."""
    options = {"ensure_2d": False, "dtype": np.float64}
    y_true = column_or_1d(check_array(y_true, input_name="y_true", **options))
    y_pred = column_or_1d(check_array(y_pred, input_name="y_pred", **options))
    check_consistent_length(y_true, y_pred)
    return y_true, y_pred


def _refuse_constant(y_true, caller):
    if np.ptp(y_true) == 0:
        raise ValueError(
            f"The 'y_true' parameter of {caller} must vary: the error is relative to its "
            f"variation. Got {y_true.size} sample(s) equal to {y_true[0]:.6g} instead; use "
            f"sklearn.metrics.root_mean_squared_error."
        )


def nrmse(y_true, y_pred):
    r"""Root mean square error over the range of the measured response.

    .. math:: \mathrm{NRMSE} = \frac{\sqrt{\frac{1}{n} \sum_t (y_t - \hat y_t)^2}}
       {\max_t y_t - \min_t y_t}

    Parameters
    ----------
    y_true : array-like of shape (n_samples,)
        Measured response.
    y_pred : array-like of shape (n_samples,)
        Predicted response, in the same units.

    Returns
    -------
    float
        A fraction, not percent; 0 is best. It does not depend on units or on an offset of both.

    Raises
    ------
    ValueError
        If ``y_true`` is constant, a value is not finite, or the lengths differ.

    References
    ----------
    Paper on inchworm motors and stochastic configuration networks, (11).

    Examples
    --------
    >>> from skhyst.metrics import nrmse
    >>> nrmse([0.0, 2.0, 4.0], [0.4, 2.4, 4.4])
    0.1...
    """
    y_true, y_pred = _check_responses(y_true, y_pred)
    _refuse_constant(y_true, "nrmse")
    return float(root_mean_squared_error(y_true, y_pred) / np.ptp(y_true))


def fit_percent(y_true, y_pred):
    r"""Part of the response that the model reproduces, in percent.

    .. math:: \mathrm{fit} = 100 \left(1 - \frac{\lVert y - \hat y \rVert_2}
       {\lVert y - \bar y \rVert_2}\right)

    It is :math:`100 (1 - \sqrt{1 - R^2})`, with the R2 of :func:`sklearn.metrics.r2_score`, but
    computed from the norms, since that root loses half of the digits of a good fit.

    Parameters
    ----------
    y_true : array-like of shape (n_samples,)
        Measured response.
    y_pred : array-like of shape (n_samples,)
        Predicted response, in the same units.

    Returns
    -------
    float
        100 is best, 0 is as good as the mean of ``y_true``, below 0 is worse than that mean.

    Raises
    ------
    ValueError
        If ``y_true`` is constant, a value is not finite, or the lengths differ.

    References
    ----------
    L. Ljung, "System Identification: Theory for the User", 2nd ed., Prentice Hall, 1999.

    Examples
    --------
    >>> from skhyst.metrics import fit_percent
    >>> fit_percent([-1.0, 1.0], [-0.5, 0.5])
    50.0
    """
    y_true, y_pred = _check_responses(y_true, y_pred)
    _refuse_constant(y_true, "fit_percent")
    error = np.linalg.norm(y_true - y_pred)
    return float(100 * (1 - error / np.linalg.norm(y_true - y_true.mean())))


def mape(y_true, y_pred):
    r"""Mean absolute error relative to each measured value, in percent.

    .. math:: \mathrm{MAPE} = \frac{100}{n} \sum_t \left| \frac{\hat y_t - y_t}{y_t} \right|

    Samples near zero dominate it: of a response that passes through zero, :func:`nrmse` says more.

    Parameters
    ----------
    y_true : array-like of shape (n_samples,)
        Measured response, nowhere zero.
    y_pred : array-like of shape (n_samples,)
        Predicted response, in the same units.

    Returns
    -------
    float
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
    Paper on the tanh model and cuckoo search, (20), there as a fraction.

    Examples
    --------
    >>> from skhyst.metrics import mape
    >>> mape([1.0, 2.0, 4.0], [1.5, 2.0, 3.0])
    25.0
    """
    y_true, y_pred = _check_responses(y_true, y_pred)
    zeros = np.flatnonzero(y_true == 0)
    if zeros.size:
        raise ValueError(
            f"The 'y_true' parameter of mape must not contain zeros: the error is relative to "
            f"each value. Got {zeros.size} zero(s), the first one in row {zeros[0]}, instead; use "
            f"nrmse or smape, or leave these rows out."
        )
    return float(100 * np.mean(np.abs((y_pred - y_true) / y_true)))


def smape(y_true, y_pred):
    r"""Mean absolute error relative to the mean magnitude of both values, in percent.

    .. math:: \mathrm{SMAPE} = \frac{100}{n} \sum_t \frac{|\hat y_t - y_t|}
       {(|\hat y_t| + |y_t|) / 2}

    A sample where both values are zero is predicted perfectly and counts 0; one where a single
    value is zero, or where the signs differ, counts 200.

    Parameters
    ----------
    y_true : array-like of shape (n_samples,)
        Measured response.
    y_pred : array-like of shape (n_samples,)
        Predicted response, in the same units.

    Returns
    -------
    float
        From 0 (best) to 200 percent. It does not depend on units, nor on which of the two comes
        first, but on the zero of the response.

    Raises
    ------
    ValueError
        If a value is not finite or the lengths differ.

    Notes
    -----
    The paper prints the denominator without absolute values, which is the same for its responses
    above zero; where the response changes its sign, terms would be negative or infinite.

    References
    ----------
    Paper on the tanh model and cuckoo search, (21), there as a fraction.

    Examples
    --------
    >>> from skhyst.metrics import smape
    >>> smape([0.0, 1.0, 3.0, 2.0], [0.0, 3.0, 1.0, 2.0])
    50.0
    """
    y_true, y_pred = _check_responses(y_true, y_pred)
    error = np.abs(y_pred - y_true)
    magnitude = np.abs(y_pred) / 2 + np.abs(y_true) / 2
    terms = np.divide(error, magnitude, out=np.zeros_like(error), where=magnitude > 0)
    return float(100 * np.mean(terms))
