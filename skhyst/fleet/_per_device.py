"""One fitted model per device, or per label of any level of the index."""

from typing import Literal, Self, overload

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, MetaEstimatorMixin, clone
from sklearn.utils import get_tags
from sklearn.utils.validation import check_is_fitted, validate_data

from .._documentation import documented_like
from .._sklearn import HasMethods, fit_context
from .._validation import (
    ScoredMixin,
    fit_weighted,
    in_native_order,
    read_weights,
    select_rows,
    store_response_units,
)
from ..base import ParametricModel
from ..exceptions import RecordError
from ._workers import workers


class PerDevice(MetaEstimatorMixin, ScoredMixin, BaseEstimator):
    """One fitted model per device.

    The index of ``X`` identifies the rows of a device: by one of its levels, or by several
    together, such as device and day. The remaining levels, record and time, are passed to the
    model. A device whose data cannot be fitted does not affect the others.

    Parameters
    ----------
    estimator : estimator
        Any regressor; one clone of it is fitted for each device.
    level : str or list of str, default="record"
        Levels of the index that identify a device. Data without records are one device, 0.
    n_jobs : int, default=None
        Number of devices fitted in parallel, by joblib; its backend, a cluster included, is chosen
        by :class:`joblib.parallel_config`.

    Attributes
    ----------
    labels_ : list
        Names of the devices; tuples where there are several levels.
    estimators_ : list of estimator
        Fitted models, one per device; None where the fit failed.
    failures_ : dict of label to str
        Error messages of the devices that could not be fitted.
    n_features_in_ : int
        Number of columns of ``X``.

    See Also
    --------
    skhyst.inspection.FleetDisplay : Picture of parameters over devices and time.
    diagnose_files : Searches each of many recordings for missing effects.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.fleet import PerDevice
    >>> from skhyst.linear import Gain
    >>> from skhyst.records import stack_records
    >>> u = np.linspace(0.0, 1.0, 50)
    >>> X, y = stack_records({"stage 1": (u, 2.0 * u), "stage 2": (u, 3.0 * u)}, dt=0.1)
    >>> PerDevice(Gain()).fit(X, y).params_["gain"].round(6).to_dict()
    {'stage 1': 2.0, 'stage 2': 3.0}
    """

    one_interval = False  # unless its estimator asks for one

    _parameter_constraints = {
        "estimator": [HasMethods(["fit", "predict"])],
        "level": [str, list],
        "n_jobs": [int, None],
    }

    def __init__(self, estimator, level="record", *, n_jobs=None):
        self.estimator = estimator
        self.level = level
        self.n_jobs = n_jobs

    def __sklearn_tags__(self):
        tags = super().__sklearn_tags__()
        tags.regressor_tags.poor_score = get_tags(self.estimator).regressor_tags.poor_score
        return tags

    @fit_context(prefer_skip_nested_validation=False)
    @documented_like(ParametricModel.fit)
    def fit(self, X, y, sample_weight=None) -> Self:
        """Fit one model per device.

        Raises
        ------
        ValueError
            If the index lacks the level. If no device can be fitted, the error of the first.
        """
        validate_data(self, X, reset=True, dtype=None, ensure_all_finite=False)
        devices, X, y = self._devices(X), in_native_order(X), in_native_order(y)
        weights = read_weights(sample_weight, X)
        store_response_units(self, y)
        jobs = [
            (clone(self.estimator), *(self._part(own, rows) for own in (X, y, weights)))
            for rows in devices.values()
        ]
        with workers(self.n_jobs) as run:
            fitted = run(_fitted, jobs)
        errors = [error for _, error in fitted]
        if all(errors):
            raise errors[0]
        self.labels_ = list(devices)
        self.estimators_ = [model for model, _ in fitted]
        labelled = zip(devices, errors, strict=True)
        self.failures_ = {label: f"{type(e).__name__}: {e}" for label, e in labelled if e}
        return self

    @overload
    def predict(self, X, y_start=None, return_std: Literal[False] = False) -> np.ndarray: ...
    @overload
    def predict(
        self, X, y_start=None, *, return_std: Literal[True]
    ) -> tuple[np.ndarray, np.ndarray]: ...
    @documented_like(ParametricModel.predict)
    def predict(
        self, X, y_start=None, return_std=False
    ) -> np.ndarray | tuple[np.ndarray, np.ndarray]:
        """Return the response of each device by its own model, NaN where the fit has failed.

        Raises
        ------
        RecordError
            If a device was not among those of the fit.
        """
        check_is_fitted(self)
        options = {"return_std": True} if return_std else {}
        # values that are not finite are refused by the model of their device, if at all
        array = validate_data(self, X, reset=False, dtype=None, ensure_all_finite=False)
        known = dict(zip(self.labels_, self.estimators_, strict=True))
        X = in_native_order(X)
        found = np.full((1 + return_std, len(array)), np.nan)
        for label, rows in self._devices(X).items():
            if label not in known:
                raise RecordError(f"PerDevice was not fitted to the device {label!r}.")
            if known[label] is not None:
                if y_start is not None:
                    options["y_start"] = self._part(y_start, rows)
                found[:, rows] = known[label].predict(self._part(X, rows), **options)
        return (found[0], found[1]) if return_std else found[0]

    @property
    def params_(self) -> pd.DataFrame:
        """Parameters as a frame: one row per device, NaN where the fit has failed."""
        return self._table("params_")

    @property
    def params_std_(self) -> pd.DataFrame:
        """Standard errors of the parameters, as a frame of the same shape."""
        return self._table("params_std_")

    def _table(self, attribute):
        check_is_fitted(self)
        rows = [getattr(model, attribute, {}) for model in self.estimators_]
        if isinstance(self.level, str):
            index = pd.Index(self.labels_, name=self.level)
        else:
            index = pd.MultiIndex.from_tuples(self.labels_, names=self.level)
        return pd.DataFrame(rows, index=index, dtype=float)

    @property
    def _levels(self):
        return [self.level] if isinstance(self.level, str) else self.level

    def _devices(self, X):
        """Return the rows of each device by label, in order of first appearance."""
        index = getattr(X, "index", None)
        if not isinstance(index, pd.MultiIndex):
            if self.level != "record":
                raise RecordError(_LACKS.format(self.level))
            return {0: slice(None)}
        if not set(self._levels) <= set(index.names):
            raise RecordError(f"{_LACKS.format(self.level)} Got {list(index.names)} instead.")
        for level in self._levels:
            missing = index.get_level_values(level).isna()
            if missing.any():
                raise ValueError(
                    f"Every row must have a label of {level!r}. Got row {missing.argmax()} without "
                    "one instead."
                )
        by = [index.get_level_values(level) for level in self._levels]
        rows = pd.Series(np.arange(len(index)), index)
        groups = rows.groupby(by[0] if isinstance(self.level, str) else by, sort=False)
        return {label: part.to_numpy() for label, part in groups}

    def _part(self, values, rows):
        """Return the rows of a device, without the levels of the index that identify it."""
        if isinstance(rows, slice):
            return values
        part = select_rows(values, rows)
        several = isinstance(getattr(part, "index", None), pd.MultiIndex)
        return part.droplevel(self._levels) if several else part


_LACKS = "The 'level' parameter of PerDevice must name levels of the index of X, not {!r}."


def _fitted(estimator, X, y, weights):
    """Return a fitted model and no error, or no model and the error."""
    try:
        return fit_weighted(estimator, X, y, weights, "PerDevice"), None
    except Exception as error:  # an error of one device must not stop the others
        return None, error
