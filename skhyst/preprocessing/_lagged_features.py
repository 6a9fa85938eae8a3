"""Past values of the inputs as features."""

from numbers import Integral

from .._sklearn import Interval
from ._base import RecordTransformer

__all__ = ["LaggedFeatures"]


class LaggedFeatures(RecordTransformer):
    """Past values of the inputs, causal and within each record.

    Before a record the inputs are taken to have rested at their first values, so the first rows
    repeat these; no row is dropped. Score such rows apart (washout) where the device was moving.

    Parameters
    ----------
    lags : int, array-like of int, or dict, default=2
        Lags in samples. A number ``n`` stands for ``0, 1, ..., n``. A dict maps columns, by
        position or name, to their lags, and takes the place of ``columns``.
    columns : int, str or list of such, default=0
        Columns of ``X``, by position or name. All others are dropped.

    Attributes
    ----------
    lags_ : tuple of (int, int)
        Position of the column and lag of each feature.
    columns_ : tuple of int
        Positions of the columns.
    n_features_in_ : int
        Number of columns of ``X``.

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
    }

    def __init__(self, lags=2, *, columns=0):
        self.lags = lags
        self.columns = columns

    def _fit_records(self, X, records):
        if isinstance(self.lags, dict):
            self.columns_ = self._find_columns(list(self.lags))
            table = list(self.lags.values())
        else:
            table = [self.lags] * len(self.columns_)
        self.lags_ = tuple(
            (column, lag)
            for column, lags in zip(self.columns_, table, strict=True)
            for lag in self._read_lags(lags)
        )

    def _read_lags(self, lags):
        if isinstance(lags, Integral):
            lags = range(lags + 1)
        lags = list(lags)
        if not lags or not all(isinstance(lag, Integral) and lag >= 0 for lag in lags):
            raise ValueError(
                "The 'lags' parameter of LaggedFeatures must be whole numbers of samples that are "
                f"not negative. Got {self.lags!r} instead."
            )
        return [int(lag) for lag in lags]

    def _transform_record(self, X, dt, out):
        for feature, (column, lag) in enumerate(self.lags_):
            lag = min(lag, len(X))
            out[:lag, feature] = X[0, column]
            out[lag:, feature] = X[: len(X) - lag, column]

    def _names(self, names):
        return [f"{names[column]}_lag{lag}" for column, lag in self.lags_]
