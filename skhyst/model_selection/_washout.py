"""A scorer that leaves out the samples which still depend on an unknown initial state."""

from numbers import Integral

import numpy as np

from ..exceptions import RecordError
from ..records import record_slices


def washout_scorer(metric, *, washout, greater_is_better=True, **kwargs):
    """Make a scorer that leaves out the first samples of every record.

    All rows are predicted, since a free run has to pass through the washout; the metric sees the
    others. A cut by a splitter starts a new record, so this composes with
    :class:`BlockedTimeSeriesSplit`.

    Parameters
    ----------
    metric : callable
        ``metric(y_true, y_pred, **kwargs)`` returns a number, such as those of
        :mod:`sklearn.metrics` and :mod:`skhyst.metrics`.
    washout : int
        Samples to leave out at the start of every record.
    greater_is_better : bool, default=True
        Whether the metric is a score; an error is multiplied by -1.
    **kwargs : dict
        Passed to the metric.

    Returns
    -------
    callable
        ``scorer(estimator, X, y)``, for the ``scoring`` parameter of scikit-learn.

    Raises
    ------
    ValueError
        If ``washout`` is not an integer of at least 0.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn.linear_model import LinearRegression
    >>> from sklearn.metrics import r2_score
    >>> from sklearn.model_selection import cross_val_score
    >>> from skhyst.model_selection import BlockedTimeSeriesSplit, washout_scorer
    >>> X = np.linspace(0.0, 1.0, 60)[:, None]
    >>> cv = BlockedTimeSeriesSplit(n_splits=3, washout=5)
    >>> scorer = washout_scorer(r2_score, washout=5)
    >>> cross_val_score(LinearRegression(), X, 2.0 * X[:, 0], cv=cv, scoring=scorer).round(6)
    array([1., 1., 1.])
    """
    if not isinstance(washout, Integral) or washout < 0:
        raise ValueError(
            f"The 'washout' parameter of washout_scorer must be an integer of at least 0. Got "
            f"{washout!r} instead."
        )
    return _WashoutScorer(metric, washout, greater_is_better, kwargs)


class _WashoutScorer:
    """The callable that :func:`washout_scorer` makes."""

    def __init__(self, metric, washout, greater_is_better, kwargs):
        self.metric = metric
        self.washout = washout
        self.greater_is_better = greater_is_better
        self.kwargs = kwargs

    def __call__(self, estimator, X, y):
        scored = np.zeros(len(y), dtype=bool)
        for record in record_slices(X, y):
            scored[record.rows.start + self.washout : record.rows.stop] = True
        if not scored.any():
            raise RecordError(
                f"The 'washout' parameter of washout_scorer must be shorter than the longest "
                f"record. Got {self.washout} samples, which leave nothing to score, instead."
            )
        predicted = np.asarray(estimator.predict(X))
        value = self.metric(np.asarray(y)[scored], predicted[scored], **self.kwargs)
        return value if self.greater_is_better else -value

    def __repr__(self):
        name = getattr(self.metric, "__name__", repr(self.metric))
        options = "".join(f", {key}={value!r}" for key, value in self.kwargs.items())
        return (
            f"washout_scorer({name}, washout={self.washout}, "
            f"greater_is_better={self.greater_is_better}{options})"
        )
