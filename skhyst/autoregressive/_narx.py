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
from ..base import one_thread
from ._base import AutoregressiveRegressor
from ._extract import extract_step
from ._output_weights import fit_output_weights
from ._steps import LinearStep

_COMPARED = 64  # rows on which the compiled form must agree with the estimator


class NARXRegressor(AutoregressiveRegressor):
    r"""Nonlinear autoregressive model with exogenous inputs, around any regressor.

    .. math:: y(k) = f\bigl(u(k - l_1), \dots, u(k - l_p),\, y(k - m_1), \dots, y(k - m_q)\bigr)

    The regressor :math:`f` is fitted one step ahead, to the measured past. `predict` is the free
    run: the model sees its own past outputs instead. A model that is good one step ahead may be
    poor, or diverge, in the free run, so compare models by `score`, which is R2 of the free run.

    Parameters
    ----------
    estimator : estimator, default=None
        Any regressor or pipeline, of which a clone is fitted; by default linear regression of the
        standardised signals (ARX).
    objective : {"one_step", "simulation"}, default="one_step"
        The error that is made small: one step ahead, or of the free run. For the latter the weights
        that enter linearly, all of a linear model, those of the output of a network, are fitted
        again from those one step ahead, by Gauss-Newton steps with exact derivatives and without a
        penalty; the inner weights of a network stay.

    Attributes
    ----------
    estimator_ : estimator
        The fitted regressor. Its columns are named by ``lag_names_``.
    coef_, intercept_ : ndarray of shape (n_signals,), float
        Weights of the signals in ``lag_names_`` and constant, in the user's units; of linear
        regressors only.
    compiled_ : bool
        Whether the free run is a compiled loop.
    output_weights_ : ndarray of shape (n_weights + 1,)
        Weights of the output and constant, fitted to the free run; with that objective only. What
        predicts has these, ``estimator_`` those one step ahead.
    n_evaluations_ : int
        Runs over all records that the fit took, 0 one step ahead.

    Raises
    ------
    ValueError
        If ``objective`` is ``"simulation"`` and the estimator is none of linear models,
        ``MLPRegressor`` and ``SCNRegressor``, also behind scalers.

    See Also
    --------
    skhyst.preprocessing.PlayOperators : Gives the regressor a rate-independent memory.

    Notes
    -----
    Lags do not cross the limits of records: in `fit`, samples whose past lies before their record
    are left out.

    Trees, networks and neighbours expect signals of order one: scale them in a pipeline, and the
    response with a ``TransformedTargetRegressor``.

    The free run is compiled for linear models, for those behind ``PolynomialFeatures``, for
    ``MLPRegressor``, ``SCNRegressor``, decision trees, random forests, extra trees and gradient
    boosting (both kinds), also in a pipeline behind scalers, in a search, or in a
    ``TransformedTargetRegressor`` with a scaler. Any other regressor is called once a time step for
    all records together, which costs little more than for one record.

    The resting output solves ``y = f(u, ..., u, y, ..., y)``. It is looked for within the range of
    the response and as far again on both sides. Where there are several solutions, those that can
    be stable go first, then the one nearest to the linear regression of the response on the
    inputs; where there is none, as for an integrator, that regression is the resting output.

    References
    ----------
    Leontaritis and Billings, *International Journal of Control*, 1985. Han et al., *An
    Identification Method for Dynamic Systems with SCNs Hysteresis Compensator*, undated, equation
    (8), where the lags are the defaults.

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
        dt=1.0,
    ):
        self.estimator = estimator
        self.input_lags = input_lags
        self.output_lags = output_lags
        self.objective = objective
        self.initial_output = initial_output
        self.dt = dt

    def _fit_records(self, X, y, records):
        Z, target = self._regression(X, y, records)
        estimator = _default() if self.estimator is None else clone(self.estimator)
        self.estimator_ = estimator.fit(Z, target)
        rows = np.linspace(0, len(Z) - 1, min(_COMPARED, len(Z))).astype(int)
        self._step = extract_step(self.estimator_, self._lags, [Z[rows]], self.estimator_.predict)
        self.compiled_ = self._step is not None
        for name in ("coef_", "intercept_", "output_weights_"):  # of an earlier fit
            self.__dict__.pop(name, None)
        self.n_evaluations_ = 0
        if self.objective == "simulation":
            self._fit_free_run(X, y, records)
        if isinstance(self._step, LinearStep):
            self.coef_, self.intercept_ = self._step.weights, self._step.intercept

    def _fit_free_run(self, X, y, records):
        if self._step is None or self._step.output_weights is None:
            raise ValueError(
                "The 'objective' parameter of NARXRegressor must be 'one_step' where 'estimator' "
                "is no linear model, MLPRegressor or SCNRegressor; NARMAXRegressor fits "
                f"polynomials. Got 'simulation' with {type(self.estimator_).__name__} instead."
            )
        starts = partial(self.starting_values, X, records, y)
        with one_thread():
            self.n_evaluations_ = fit_output_weights(self, starts)
        self.output_weights_ = self._step.output_weights

    def _one_step(self, Z):
        if self._step is not None:
            return self._step.rows(Z)
        # the signals are finite: the fit has seen to it, and outputs are bounded
        with config_context(assume_finite=True):
            return self.estimator_.predict(Z)


def _default():
    """Return a linear regression that neither units nor fast sampling mislead."""
    # since scikit-learn 1.7 singular values below 1e-6 are dropped: neighbours differ by less
    known = "tol" in signature(LinearRegression).parameters
    options = {"tol": np.finfo(float).eps} if known else {}
    return make_pipeline(StandardScaler(), LinearRegression(**options))
