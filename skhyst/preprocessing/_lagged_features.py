"""Past values of the inputs as features."""

from numbers import Integral

import numpy as np

from .._sklearn import Interval, StrOptions
from ._base import RecordTransformer, find_column


class LaggedFeatures(RecordTransformer):
    """Past values of the inputs, causal and within each record.

    Before a record the inputs are assumed to be at rest at their first values, so the first rows
    repeat these unless `before` says otherwise; no row is dropped. Leave these rows out of a score
    (washout) where the device was moving.

    Parameters
    ----------
    lags : int, array-like of int, or dict, default=2
        Lags in samples. A number ``n`` stands for ``0, 1, ..., n``. A dict maps columns, by
        position or name, to their lags, and replaces ``columns``.
    before : {"rest", "zero", "nan"}, default="rest"
        Inputs before a record: the first value of the record, 0, or NaN, for a regressor that
        supports missing values or for steps that drop such rows.

    Attributes
    ----------
    lags_ : tuple of (int, int)
        Position of the column and lag of each feature.

    See Also
    --------
    skhyst.autoregressive.NARXRegressor : Past values of the response, too.
    PlayOperators : Features with a memory of any length.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.preprocessing import LaggedFeatures
    >>> LaggedFeatures(lags=1).fit_transform(np.array([[1.0], [2.0], [3.0]]))
    array([[1., 1.],
           [2., 1.],
           [3., 2.]])
    """

    _parameter_constraints = {
        **RecordTransformer._parameter_constraints,
        "lags": [Interval(Integral, 0, None, closed="left"), "array-like", dict],
        "before": [StrOptions({"rest", "zero", "nan"})],
    }

    def __init__(self, lags=2, *, before="rest", columns=0):
        self.lags = lags
        self.before = before
        self.columns = columns

    def _fit_records(self, X, records):
        self.lags_ = read_lag_table(self, "lags", self.columns_)
        if isinstance(self.lags, dict):
            self.columns_ = tuple(dict.fromkeys(column for column, _ in self.lags_))

    def _transform_record(self, X, dt, out):
        lagged_columns(X, self.lags_, out=out)
        if self.before != "rest":
            for feature, (_, lag) in enumerate(self.lags_):
                out[:lag, feature] = 0.0 if self.before == "zero" else np.nan

    def sample_rules(self, rules, places, dt):
        if self.before != "rest":
            raise NotImplementedError(
                "LaggedFeatures cannot be stepped: its 'before' parameter must be 'rest'. Got "
                f"before={self.before!r} instead."
            )
        return [(places[column][0], places[column][1] + lag) for column, lag in self.lags_]

    def _names(self, names):
        return [f"{names[column]}_lag{lag}" for column, lag in self.lags_]


def read_lags(estimator, parameter, lags, first=0) -> list[int]:
    """Return the lags of a parameter as a list, after validation.

    Parameters
    ----------
    estimator : estimator
        Estimator that has the parameter, for the error message.
    parameter : str
        Name of the parameter.
    lags : int or array-like of int
        A number stands for all lags from ``first`` to it.
    first : {0, 1}, default=0
        Smallest lag allowed. Where it is 0 there must be at least one lag.

    Returns
    -------
    list of int

    Raises
    ------
    ValueError
        If the lags are not integers of at least ``first``.
    """
    if isinstance(lags, Integral):
        lags = range(first, lags + 1)
    lags = list(lags)
    are_valid = all(isinstance(lag, Integral) and lag >= first for lag in lags)
    if not are_valid or (first == 0 and not lags):
        requirement = "not negative" if first == 0 else "at least 1"
        raise ValueError(
            f"The '{parameter}' parameter of {type(estimator).__name__} must be integer numbers of "
            f"samples that are {requirement}. Got {getattr(estimator, parameter)!r} instead."
        )
    return [int(lag) for lag in lags]


def read_lag_table(estimator, parameter, columns) -> tuple[int, int]:
    """Return the lags of each input from a parameter of an estimator.

    Parameters
    ----------
    estimator : estimator
        Estimator with ``n_features_in_`` and, for names, ``feature_names_in_``.
    parameter : str
        Name of the parameter: lags as in :func:`read_lags`, or a dict of them by column.
    columns : iterable of int
        Columns to which the lags apply where the parameter is not a dict.

    Returns
    -------
    tuple of (int, int)
        Column and lag of each lagged input.
    """
    given = getattr(estimator, parameter)
    if not isinstance(given, dict):
        given = dict.fromkeys(columns, given)
    return tuple(
        (find_column(estimator, column, "columns" if parameter == "lags" else parameter), lag)
        for column, lags in given.items()
        for lag in read_lags(estimator, parameter, lags)
    )


def lagged_columns(X, table, first=0, stop=None, out=None) -> np.ndarray:
    """Return lagged inputs of one record; before it they have their first values.

    Parameters
    ----------
    X : ndarray of shape (n_samples, n_inputs)
        Inputs of the record.
    table : sequence of (int, int)
        Column and lag of each lagged input.
    first, stop : int, optional
        Range of rows to return; all by default.
    out : ndarray of shape (stop - first, len(table)), optional
        Array to write to.

    Returns
    -------
    ndarray of shape (stop - first, len(table))

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.preprocessing import lagged_columns
    >>> lagged_columns(np.array([[1.0], [2.0], [3.0]]), [(0, 0), (0, 1)])
    array([[1., 1.],
           [2., 1.],
           [3., 2.]])
    """
    n_rows = (len(X) if stop is None else stop) - first
    out = np.empty((n_rows, len(table))) if out is None else out
    for feature, (column, lag) in enumerate(table):
        missing = min(max(lag - first, 0), n_rows)
        out[:missing, feature] = X[0, column]
        start = first + missing - lag
        out[missing:, feature] = X[start : start + n_rows - missing, column]
    return out
