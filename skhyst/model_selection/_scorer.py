"""Scores without the washout of each record."""

from collections.abc import Callable
from dataclasses import dataclass
from inspect import signature

import numpy as np
from sklearn.pipeline import Pipeline
from sklearn.utils import check_consistent_length

from ..metrics import fit_percent, mape, nrmse, smape
from ..records import record_slices
from ._folds import check_integer

# Names in scikit-learn say which way is better; the metrics of skhyst are known.
BETTER_HIGH = ("_score",)
BETTER_LOW = ("_error", "_loss", "_deviance")


def washout_scorer(
    metric, *, washout, greater_is_better=None, initial_state=None, **metric_options
) -> Callable[..., float]:
    """Build a scorer that leaves the first samples of every record out.

    The estimator predicts all rows; the first ``washout`` samples of each record, which still
    depend on an unknown initial state, then do not count. A cut that a splitter has made starts a
    new record, as the index has a hole there. Records that are not longer than the washout do not
    count at all. In an array, which has no index, the rows of a fold are one record.

    Parameters
    ----------
    metric : callable
        ``metric(y_true, y_pred, **metric_options) -> float``, of :mod:`skhyst.metrics`,
        :mod:`sklearn.metrics` or one's own.
    washout : int
        Samples at the start of each record that are left out, at least 0.
    greater_is_better : bool or None, default=None
        Whether a high value of the metric is good; if not, the scorer returns its negative.
        None: taken from the name of a metric of skhyst, and of one that ends in
        ``_score`` (high is good) or ``_error``, ``_loss``, ``_deviance`` (low is good).
    initial_state : {"estimate"} or None, default=None
        State before each record. None: that of ``predict``. "estimate": the input history of a
        record is estimated from its washout, by the ``y_start`` of ``predict`` of the estimator or
        of the last step of a pipeline; for example for a fold that is cut out of a recording, which
        does not begin at rest.
    **metric_options : dict
        Passed on to the metric.

    Returns
    -------
    callable
        ``scorer(estimator, X, y) -> float``, for ``scoring=`` of ``cross_validate``,
        ``GridSearchCV`` and the like. It can be pickled if the metric can. It raises ValueError
        where no record is longer than the washout, and where the initial state is to be estimated
        for an estimator whose ``predict`` does not take ``y_start``.

    Raises
    ------
    ValueError
        If a parameter is out of its range, or the metric's name does not show which sign is better.

    See Also
    --------
    BlockedTimeSeriesSplit : Leaves training rows out next to the test rows.
    sklearn.metrics.make_scorer : The same without a washout.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn.dummy import DummyRegressor
    >>> from sklearn.metrics import max_error
    >>> from skhyst.model_selection import washout_scorer
    >>> X, y = np.zeros((5, 1)), np.array([9.0, 9.0, 1.0, 2.0, 3.0])
    >>> model = DummyRegressor(strategy="constant", constant=2.0).fit(X, y)
    >>> print(washout_scorer(max_error, washout=2)(model, X, y))
    -1.0
    """
    if not callable(metric):
        raise ValueError(
            f"The 'metric' parameter of washout_scorer must be a function of (y_true, y_pred). "
            f"Got {metric!r} instead."
        )
    check_integer("washout", washout, 0, "washout_scorer")
    if greater_is_better is None:
        greater_is_better = _high_is_good(metric)
    if not isinstance(greater_is_better, bool | np.bool_):
        raise ValueError(
            f"The 'greater_is_better' parameter of washout_scorer must be a bool, or None for a "
            f"metric whose name shows it. Got {greater_is_better!r} and the metric "
            f"{getattr(metric, '__name__', metric)!r} instead."
        )
    if initial_state not in (None, "estimate"):
        raise ValueError(
            "The 'initial_state' parameter of washout_scorer must be 'estimate' or None. Got "
            f"{initial_state!r} instead."
        )
    return _WashoutScorer(
        metric, int(washout), bool(greater_is_better), metric_options, initial_state
    )


def _high_is_good(metric):
    """Return True or False, or None where the metric's name does not say it."""
    if metric in (nrmse, mape, smape):
        return False
    name = getattr(metric, "__name__", "")
    if metric is fit_percent or name.endswith(BETTER_HIGH):
        return True
    return False if name.endswith(BETTER_LOW) else None


def predicted_from(estimator, X, known):
    """Return the prediction that continues a known response; None if the estimator cannot.

    Parameters
    ----------
    estimator : estimator
        Fitted; in a pipeline the last step continues the response.
    X : array-like of shape (n_samples, n_inputs)
    known : array-like of shape (n_samples,)
        NaN where unknown.

    Returns
    -------
    ndarray of shape (n_samples,) or None
    """
    while isinstance(estimator, Pipeline):
        X = estimator[:-1].transform(X) if len(estimator) > 1 else X
        estimator = estimator[-1]
    if "y_start" not in signature(estimator.predict).parameters:
        return None
    return estimator.predict(X, y_start=known)


@dataclass(frozen=True, repr=False)
class _WashoutScorer:
    metric: Callable
    washout: int
    greater_is_better: bool
    metric_options: dict
    initial_state: str | None = None

    def __call__(self, estimator, X, y):
        """Return the score of the predicted rows that count."""
        check_consistent_length(X, y)
        records = record_slices(X, y, one_interval=False, bridge=True)
        counts = np.zeros(len(y), dtype=bool)
        for record in records:
            counts[record.rows] = record.samples >= self.washout
        if not counts.any():
            longest = max((record.n_samples for record in records), default=0)
            raise ValueError(
                f"The 'washout' parameter of washout_scorer must be shorter than a record. Got "
                f"washout={self.washout} and records of {longest} samples at most instead."
            )
        y_pred = self._predicted(estimator, X, np.where(counts, np.nan, np.asarray(y)))
        check_consistent_length(y, y_pred)
        value = self.metric(np.asarray(y)[counts], y_pred[counts], **self.metric_options)
        return value if self.greater_is_better else -value

    def _predicted(self, estimator, X, known):
        """Return the prediction from rest, or from the known part of the response."""
        if self.initial_state is None:
            return np.asarray(estimator.predict(X))
        prediction = predicted_from(estimator, X, known)
        if prediction is None:
            raise ValueError(
                "The 'initial_state' parameter of washout_scorer must be None for an estimator "
                "whose predict does not take 'y_start'. Got 'estimate' and "
                f"{estimator!r} instead."
            )
        return prediction

    def __repr__(self):
        state = f", initial_state={self.initial_state!r}" if self.initial_state else ""
        options = "".join(f", {name}={value!r}" for name, value in self.metric_options.items())
        return (
            f"washout_scorer({getattr(self.metric, '__name__', self.metric)}, "
            f"washout={self.washout}, greater_is_better={self.greater_is_better}{state}{options})"
        )
