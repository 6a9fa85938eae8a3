"""The base of all transformers: validation, records, choice of columns, DataFrames."""

from abc import abstractmethod
from numbers import Integral
from typing import Self

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted

from .._documentation import inherit_documentation
from .._sklearn import check_feature_names_in, fit_context
from .._validation import as_floats, find_column, read_slices, refuse_drawn, refuse_large
from ..records import with_lost_rows

_EXTREME = 1e250  # largest values, whose differences over a short interval are finite


class RecordTransformer(TransformerMixin, BaseEstimator):
    """Base of the transformers that map some columns, each record on its own.

    A subclass gives :meth:`_fit_records`, :meth:`_transform_record` and :meth:`_names`.

    Parameters
    ----------
    columns : int, str or list of such, default=0
        Columns of ``X``, by position or name. All others are dropped.

    Attributes
    ----------
    columns_ : tuple of int
        Positions of the columns.
    n_features_in_ : int
        Number of columns of ``X``.
    """

    one_interval = True  # features may depend on the sampling interval

    _parameter_constraints = {"columns": [Integral, str, "array-like"]}

    def __init_subclass__(cls, **options):
        super().__init_subclass__(**options)
        inherit_documentation(cls)

    @abstractmethod
    def _fit_records(self, X, records):
        """Learn from the validated array and its records."""

    @abstractmethod
    def _transform_record(self, X, dt, out):
        """Write the features of one record, shape (n_rows, n_features_out), to ``out``."""

    def sample_rules(self, rules, places, dt):
        """Add the rules that update the features at one sample; return position and lag of each.

        Parameters
        ----------
        rules : SampleRules
            The rules so far, to which those of this transformer are added.
        places : sequence of (int, int)
            Position in the row, and lag in samples, of each column of ``X``.
        dt : float
            Sampling interval in s.

        Returns
        -------
        list of (int, int)
            Position in the row, and lag in samples, of each feature.

        Raises
        ------
        NotImplementedError
            If a feature cannot be computed sample by sample.
        """
        raise NotImplementedError(
            f"{type(self).__name__} cannot be stepped: it defines no 'sample_rules'."
        )

    def _drives(self, places):
        """Return the positions of the columns that are used; refuse lagged ones."""
        drives = [places[column] for column in self.columns_]
        if any(lag for _, lag in drives):
            raise NotImplementedError(
                f"{type(self).__name__} cannot be stepped after lagged features."
            )
        return [place for place, _ in drives]

    @abstractmethod
    def _names(self, names):
        """Return the names of the features, given those of all input columns."""

    @fit_context(prefer_skip_nested_validation=True)
    def fit(self, X, y=None) -> Self:
        """Learn the settings that depend on the range of the data.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            Inputs; the index carries records and time.
        y : array-like of shape (n_samples,), optional
            Not used for the features. Its index must agree with that of ``X``, and rows that have
            been drawn at random are recognised by it.

        Returns
        -------
        self

        Raises
        ------
        RecordError
            If the rows are not a recording in the order of time.
        """
        array = as_floats(self, X, ensure_min_samples=2)
        is_single = isinstance(self.columns, str | Integral)
        given = [self.columns] if is_single else self.columns
        self.columns_ = tuple(find_column(self, column, "columns") for column in given)
        if not self.columns_:
            raise ValueError(
                f"The 'columns' parameter of {type(self).__name__} must name at least one column."
            )
        refuse_large("X", array[:, self.columns_], _EXTREME)
        given = () if y is None else (y,)
        records = read_slices(self, X, *given, reset=True)
        response = np.asarray(y)
        if response.shape == (len(array),) and response.dtype.kind in "biuf":
            refuse_drawn(X, array[:, self.columns_[0]], array, response.astype(float))
        self._fit_records(array, records)
        return self

    def transform(self, X) -> pd.DataFrame:
        """Return the features, each record from its own start.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            Inputs; the index carries records and time.

        Returns
        -------
        features : DataFrame or ndarray of shape (n_samples, n_features_out)
            A DataFrame with the index of ``X`` where ``X`` is a DataFrame.
        """
        check_is_fitted(self)
        array = as_floats(self, X, reset=False)
        refuse_large("X", array[:, self.columns_], _EXTREME)
        names = self.get_feature_names_out()
        records, array, read = with_lost_rows(read_slices(self, X, reset=False, bridge=True), array)
        features = np.empty((len(array), len(names)))
        for record in records:
            self._transform_record(array[record.rows], record.dt, features[record.rows])
        features = features if read is None else features[read]
        if hasattr(X, "iloc"):
            return type(X)(features, index=X.index, columns=names, copy=False)
        return features

    def get_feature_names_out(self, input_features=None) -> np.ndarray:
        """Return the names of the features.

        Parameters
        ----------
        input_features : array-like of str, optional
            Names of the inputs; those seen in ``fit``, else ``x0``, ``x1``, ..., by default.

        Returns
        -------
        names : ndarray of str, shape (n_features_out,)
        """
        check_is_fitted(self)
        names = check_feature_names_in(self, input_features)
        return np.asarray(self._names(names), dtype=object)
