"""NARX model around any regressor of scikit-learn."""

from functools import partial
from inspect import signature

import numpy as np
from sklearn import config_context
from sklearn.base import clone
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from .._sklearn import HasMethods, StrOptions
from .._validation import fit_weighted
from ..base import one_thread
from ._base import AutoregressiveRegressor
from ._extract import extract_step
from ._narmax import NARMAXRegressor
from ._output_weights import fit_output_weights
from ._steps import LinearStep

_COMPARED = 64  # rows on which the compiled form must agree with the estimator


class NARXRegressor(AutoregressiveRegressor):
    r"""Nonlinear autoregressive model with exogenous inputs, around any regressor.

    .. math:: y(k) = f\bigl(u(k - l_1), \dots, u(k - l_p),\, y(k - m_1), \dots, y(k - m_q)\bigr)

    The regressor :math:`f` is fitted one step ahead, with measured past outputs. `predict` is the
    free run (simulation): the model uses its own past outputs instead. A model that is good one
    step ahead may be poor, or diverge, in the free run, so compare models by `score`, which is R2
    of the free run.

    Parameters
    ----------
    estimator : estimator, default=None
        Any regressor or pipeline, of which a clone is fitted; by default linear regression of the
        standardised signals (ARX).
    objective : {"one_step", "simulation"}, default="one_step"
        The error that is minimised: that of the one-step prediction, or of the free run. For the
        latter the weights that enter linearly (all of a linear model, the output weights of a
        network) are refitted from those of the one-step fit, by Gauss-Newton steps with exact
        derivatives and without a penalty; the hidden weights of a network stay.

    Attributes
    ----------
    estimator_ : estimator
        The fitted regressor. Its columns are named by ``lag_names_``.
    coef_, intercept_ : ndarray of shape (n_signals,), float
        Weights of the signals in ``lag_names_`` and constant, in the user's units; for linear
        regressors only.
    compiled_ : bool
        Whether the free run is a compiled loop.
    output_weights_ : ndarray of shape (n_weights + 1,)
        Output weights and constant, fitted to the free run; with ``objective="simulation"`` only.
        The model predicts with these; ``estimator_`` has those of the one-step fit.
    n_evaluations_ : int
        Number of runs over all records in the fit, 0 one step ahead.

    Raises
    ------
    ValueError
        If ``objective`` is ``"simulation"`` and the estimator is not a linear model,
        ``MLPRegressor`` or ``SCNRegressor``, with or without scalers.

    See Also
    --------
    NARMAXRegressor : Polynomial terms, selected from data, with a model of the noise.
    skhyst.preprocessing.PlayOperators : Gives the regressor a rate-independent memory.

    Notes
    -----
    Lags do not cross the boundaries of records: in `fit`, samples whose lagged signals lie before
    their record are left out.

    Trees, networks and neighbours expect signals of order one: scale them in a pipeline, and the
    response with a ``TransformedTargetRegressor``.

    The free run is compiled for linear models, for those of ``PolynomialFeatures``, for
    ``MLPRegressor``, ``SCNRegressor``, decision trees, random forests, extra trees and gradient
    boosting (both kinds), also in a pipeline after scalers, in a hyperparameter search, or in a
    ``TransformedTargetRegressor`` with a scaler. Any other regressor is called once per time step
    for all records together, which costs little more than for one record.

    The output at rest solves ``y = f(u, ..., u, y, ..., y)``. It is searched within the range of
    the response, extended by that range on both sides. Of several solutions, those that can be
    stable are preferred, then the one closest to the linear regression of the response on the
    inputs; without a solution, as for an integrator, that regression is the output at rest.

    References
    ----------
    Leontaritis and Billings, *International Journal of Control*, 1985. Han et al., *An
    Identification Method for Dynamic Systems with SCNs Hysteresis Compensator*, undated, equation
    (8), with the default lags.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.autoregressive import NARXRegressor
    >>> u = np.sin(np.arange(200) / 5.0) + np.sin(np.arange(200) / 17.0)
    >>> y = np.zeros(200)
    >>> for k in range(1, 200):
    ...     y[k] = 0.8 * y[k - 1] + 0.2 * u[k - 1]
    >>> model = NARXRegressor(input_lags=[1]).fit(u[:, None], y)
    >>> model.coef_.round(6)
    array([0.2, 0.8])
    >>> bool(np.allclose(model.predict(u[:, None]), y))
    True
    """

    _parameter_constraints = {
        "estimator": [HasMethods(["fit", "predict"]), None],
        "objective": [StrOptions({"one_step", "simulation"})],
        **AutoregressiveRegressor._parameter_constraints,
    }

    def __init__(
        self,
        estimator=None,
        *,
        input_lags=(0, 1),
        output_lags=(1,),
        objective="one_step",
        initial_output="rest",
        dt=None,
        drive=None,
    ):
        self.estimator = estimator
        self.input_lags = input_lags
        self.output_lags = output_lags
        self.objective = objective
        self.initial_output = initial_output
        self.dt = dt
        self.drive = drive

    resampled = NARMAXRegressor.resampled

    def _linear_terms(self):
        """Return the weights of all lagged signals and the constant; None if it is not linear."""
        return (self.coef_, self.intercept_) if isinstance(self._step, LinearStep) else None

    def _fit_records(self, X, y, records, weights, read):
        parts = self._regression(X, y, records, weights, read)
        Z, *target_and_weights = map(np.concatenate, zip(*parts, strict=True))
        estimator = _default() if self.estimator is None else clone(self.estimator)
        self.estimator_ = fit_weighted(estimator, Z, *target_and_weights, type(self).__name__)
        rows = np.linspace(0, len(Z) - 1, min(_COMPARED, len(Z))).astype(int)
        self._step = extract_step(self.estimator_, self._lags, [Z[rows]], self.estimator_.predict)
        self.compiled_ = self._step is not None
        for name in ("coef_", "intercept_", "output_weights_"):  # of an earlier fit
            self.__dict__.pop(name, None)
        self.n_evaluations_ = 0
        if self.objective == "simulation":
            self._fit_free_run(X, y, records, weights)
        if isinstance(self._step, LinearStep):
            self.coef_, self.intercept_ = self._step.weights, self._step.intercept

    def _fit_free_run(self, X, y, records, weights):
        if self._step is None or self._step.output_weights is None:
            raise ValueError(
                "The 'objective' parameter of NARXRegressor must be 'one_step' where 'estimator' "
                "is not a linear model, MLPRegressor or SCNRegressor; NARMAXRegressor fits "
                f"polynomials. Got 'simulation' with {type(self.estimator_).__name__} instead."
            )
        starts = partial(self.starting_values, X, records, y, weights)
        with one_thread():
            self.n_evaluations_ = fit_output_weights(self, starts)
        self.output_weights_ = self._step.output_weights

    def _one_step(self, Z):
        if self._step is not None:
            return self._step.rows(Z)
        # the signals are finite: inputs were validated and outputs are bounded
        with config_context(assume_finite=True):
            return self.estimator_.predict(Z)


def _default():
    """Return a linear regression that is accurate for any units and for fast sampling."""
    # scikit-learn 1.7 drops singular values below 1e-6: neighbouring samples may differ by less
    known = "tol" in signature(LinearRegression).parameters
    options = {"tol": np.finfo(float).eps} if known else {}
    return make_pipeline(StandardScaler(), LinearRegression(**options))
