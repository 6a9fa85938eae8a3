"""Errors of a predicted response, and figures of the loops of a recording.

``max_error``, the largest absolute error in units of the response, is that of scikit-learn. All
errors take ``(y_true, y_pred)`` and serve :func:`sklearn.metrics.make_scorer` and
:func:`skhyst.model_selection.washout_scorer`.
"""

from sklearn.metrics import max_error

from ._loop_figures import FIGURES as FIGURES
from ._loop_figures import branches as branches
from ._loop_figures import closed_loops as closed_loops
from ._loop_figures import figures_of as figures_of
from ._loop_figures import loop_figures
from ._loop_figures import read_loops as read_loops
from ._loop_figures import response_at as response_at
from ._loop_figures import sections as sections
from ._loop_figures import widest_opening as widest_opening
from ._regression import fit_percent, mape, nrmse, smape

__all__ = ["fit_percent", "loop_figures", "mape", "max_error", "nrmse", "smape"]
