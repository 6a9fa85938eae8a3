"""Errors of a predicted response.

``max_error``, the largest absolute error in units of the response, is that of scikit-learn. All
take ``(y_true, y_pred)`` and serve :func:`sklearn.metrics.make_scorer` and
:func:`skhyst.model_selection.washout_scorer`.
"""

from sklearn.metrics import max_error

from ._regression import fit_percent, mape, nrmse, smape

__all__ = ["fit_percent", "mape", "max_error", "nrmse", "smape"]
