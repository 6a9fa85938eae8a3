"""Several responses to the same inputs, whose models share parameters."""

import re
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from sklearn.base import (
    BaseEstimator,
    MetaEstimatorMixin,
    MultiOutputMixin,
    clone,
)
from sklearn.utils import get_tags
from sklearn.utils.validation import check_is_fitted

from .._documentation import documented_like
from .._sklearn import HasMethods, fit_context
from .._validation import (
    ScoredMixin,
    as_floats,
    common_parameter,
    read_slices,
    read_weights,
    with_unread,
)
from ..base import ParametricModel, one_thread, refine
from ..operators import Operator, ParameterSpec, split_disturbances
from ..optimize import NOISELESS
from ..records import with_lost_rows


class SharedParameters(MetaEstimatorMixin, MultiOutputMixin, ScoredMixin, BaseEstimator):
    r"""Models of several responses to the same inputs, with common parameters, fitted jointly.

    .. math:: y_k = \Gamma[u;\ \theta,\ g_k w,\ \eta_k] + c_k

    Each response k has the same model :math:`\Gamma`: poles, thresholds and exponents
    :math:`\theta` are common to all; parameters w whose unit contains that of the response are
    common up to a gain :math:`g_k`. The intercept :math:`c_k` and the parameters :math:`\eta_k`
    that are named in ``own`` belong to the response: a structure has common modes at all points,
    with another shape at each. Common parameters are determined by all responses together.

    Parameters
    ----------
    estimator : estimator
        A parametric model of skhyst, or a cascade of them, without additive disturbances.
    own : list of str or None, default=None
        Names of parameters that each response has of its own, as in ``params_`` of the model, such
        as ``["modes__numerator"]``, which stands for all of ``"modes__numerator[0]"``, ... None:
        only gain and intercept.

    Attributes
    ----------
    estimators_ : list of estimator
        The fitted model of each response, with its ``params_`` and their standard errors from the
        joint fit. They can be stepped, inverted, exported and saved like any other model.
    shared_ : tuple of str
        Names of the common parameters, including those that are common up to a gain.
    gains_ : ndarray of shape (n_responses,)
        :math:`g_k`, relative to the first response.
    error_alone_ : ndarray of shape (n_responses,)
        Root mean square of the residual of each response for a model that shares nothing. If
        ``fit_error_`` of its joint model is clearly larger, the responses do not have these
        parameters in common.
    n_evaluations_ : int
        Number of simulations of all records and responses in the joint fit.

    Raises
    ------
    TypeError
        If ``estimator`` is not a parametric model of skhyst.
    ValueError
        If a name in ``own`` is not that of a free parameter, the initial state is estimated, the
        model has additive disturbances or scheduled parameters, or the responses lead to models
        with different parameters.

    See Also
    --------
    skhyst.linear.ModalModel : Linear dynamics of several inputs and responses.
    ScheduledParameters : Parameters that depend on a value per record.
    skhyst.diagnosis.EffectSearchCV : Searches each of several responses, and lists shared effects.

    Notes
    -----
    Each response is fitted alone first; this gives the starting values, and the errors by which the
    responses are scaled. The noise of different responses is treated as independent.

    Examples
    --------
    One hysteresis and one mode, measured by two sensors:

    >>> import numpy as np
    >>> from skhyst.compose import Cascade, SharedParameters
    >>> from skhyst.hysteresis import PrandtlIshlinskii, PrandtlIshlinskiiOperator
    >>> from skhyst.linear import SecondOrderMode, SecondOrderModeOperator
    >>> u = np.cumsum(np.random.default_rng(0).normal(size=600)) / 5
    >>> plays, _ = PrandtlIshlinskiiOperator([0.0, 0.5], [1.0, 0.4]).run(u, 0.01)
    >>> y, _ = SecondOrderModeOperator(60.0, 0.1).run(plays, 0.01)
    >>> plays = PrandtlIshlinskii(thresholds=[0.0, 0.5])
    >>> model = Cascade([("plays", plays), ("mode", SecondOrderMode())], dt=0.01)
    >>> model = SharedParameters(model).fit(u[:, None], np.column_stack([y, 1.0 - 3.0 * y]))
    >>> model.gains_.round(3)
    array([ 1., -3.])
    """

    _parameter_constraints = {
        "estimator": [HasMethods(["fit", "predict"])],
        "own": ["array-like", None],
    }

    def __init__(self, estimator, *, own=None):
        self.estimator = estimator
        self.own = own

    def __sklearn_tags__(self):
        tags = super().__sklearn_tags__()
        tags.regressor_tags.poor_score = get_tags(self.estimator).regressor_tags.poor_score
        return tags

    @property
    def one_interval(self):
        """Whether the model requires one sampling interval for all records."""
        return getattr(self.estimator, "one_interval", False)

    @fit_context(prefer_skip_nested_validation=False)
    def fit(self, X, y, sample_weight=None) -> Self:
        """Identify the parameters of all responses.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            Inputs; the index carries records and time.
        y : array-like of shape (n_samples, n_outputs) or (n_samples,)
            Responses.
        sample_weight : array-like of shape (n_samples,), default=None
            As for :meth:`ParametricModel.fit`, of all responses.

        Returns
        -------
        self

        Raises
        ------
        TypeError, ValueError
            As of the class.
        """
        if not isinstance(self.estimator, ParametricModel):
            raise TypeError(
                "The 'estimator' parameter of SharedParameters must be a parametric model of "
                f"skhyst. Got {self.estimator!r} instead."
            )
        if common_parameter(self.estimator, "initial_state") == "estimate":
            raise ValueError(
                "The 'initial_state' of the model of SharedParameters must be 'rest' or 'zero'. "
                "Got 'estimate' instead."
            )
        y = with_unread(y, sample_weight)
        array, response = as_floats(self, X, y, multi_output=True, ensure_min_samples=2)
        self._one_response = response.ndim == 1
        response = response.reshape(len(array), -1)
        columns = [y] if self._one_response else _columns(y, response)
        weights = read_weights(sample_weight, X)
        models = [clone(self.estimator).fit(X, column, sample_weight) for column in columns]
        slices = read_slices(models[0], X, y, reset=False, bridge=True)
        slices, array, response, weights, read = with_lost_rows(slices, array, response, weights)
        weights = weights if read is None else np.where(read, weights, 0.0)
        # scaled by its own error, each response has the same weight in the joint sum of squares; a
        # response without noise would otherwise have all of it
        self.error_alone_ = np.array([model.fit_error_ for model in models])
        floor = np.sqrt(NOISELESS) * response[weights > 0.0].std(axis=0)
        scales = np.maximum(self.error_alone_, floor)
        scales[scales == 0.0] = 1.0
        data = []
        for k, model in enumerate(models):
            records = model.record_data(slices, array, response[:, k] / scales[k])
            if any(record.schedule is not None for record in records):
                raise ValueError(
                    "The model of SharedParameters must have parameters that do not depend on the "
                    f"record. Got {self.estimator!r} instead."
                )
            rows = [{} if weights.all() else {"weights": weights[s.rows]} for s in slices]
            # the joint operator takes the number of the response as the schedule value
            data.append(
                [
                    replace(r, schedule=float(k), **options)
                    for r, options in zip(records, rows, strict=True)
                ]
            )
        starts = _starts(models, self.own, scales)
        with one_thread():
            result = refine(self.estimator, starts, [r for records in data for r in records])
        joint = result.operator
        for k, model in enumerate(models):
            model.adopt(_of_response(joint, k, result, data[k], model.free_run_state))
        self.estimators_, self.n_evaluations_ = models, result.n_evaluations
        self.shared_, self.gains_ = joint.shared, joint.gains
        return self

    @documented_like(ParametricModel.predict)
    def predict(self, X, y_start=None, return_std=False):
        """Return the free-run predictions: the responses to the inputs alone.

        Parameters
        ----------
        y_start : array-like of shape (n_samples, n_outputs), default=None
            Known values of the responses, as for any model.

        Returns
        -------
        y : ndarray of shape (n_samples, n_outputs), or (n_samples,) where ``y`` of ``fit`` was 1-D
        std : ndarray of the same shape
            Standard deviation of the prediction of a new sample, units of the response. Only with
            ``return_std``.
        """
        check_is_fitted(self)
        n = len(self.estimators_)
        known = [None] * n if y_start is None else _columns(y_start, _two_dimensional(y_start))
        if len(known) != n:
            raise ValueError(
                f"The 'y_start' parameter of SharedParameters.predict must have {n} column(s), one "
                f"per response. Got {len(known)} instead."
            )
        options = {"return_std": True} if return_std else {}
        predictions = [
            model.predict(X, known_response, **options)
            for model, known_response in zip(self.estimators_, known, strict=True)
        ]
        predictions = np.moveaxis(np.array(predictions), 0, -1)  # (2,) n_samples, n_outputs
        predictions = predictions[..., 0] if self._one_response else predictions
        return (predictions[0], predictions[1]) if return_std else predictions


def _two_dimensional(values):
    return np.asarray(values).reshape(len(values), -1)


def _columns(y, values):
    """Return the columns of responses, with their index if they have one."""
    if hasattr(y, "iloc"):
        return [y] if y.ndim == 1 else [y.iloc[:, k] for k in range(y.shape[1])]
    return list(values.T)


def _of_response(joint, k, result, records, initial_state):
    """Return the part of a joint identification result for the model of one response."""
    response = joint.at(k)
    driven, names = response.operator, joint.names
    tangents = response.tangents
    known = np.array([result.params_std[name] for name, _ in joint.entries()])
    covariance = tangents @ result.joint_covariance @ tangents.T
    open_ = np.where(np.isfinite(known), 0.0, known)  # NaN at a bound, infinite
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    std += np.array([sum(open_[row != 0.0]) for row in tangents])
    squares = 0.0
    for record in records:
        run = driven.run(record.u, record.dt, driven.init(record.u[0], initial_state))[0]
        squares += record.counts() @ np.square(joint.scales[k] * record.y - run)
    error = float(np.sqrt(squares / sum(record.counts().sum() for record in records)))
    values = driven.pack()[joint.free]
    return replace(
        result,
        operator=driven,
        params=dict(zip(names, values.tolist(), strict=True)),
        params_std=dict(zip(names, std.tolist(), strict=True)),
        params_std_white={},
        undetermined=tuple(
            name for name, response in zip(names, std, strict=True) if np.isinf(response)
        ),
        joint_covariance=covariance,
        record_coefficients=np.empty((len(records), 0)),
        error=error,
        noise_std=error * (result.noise_std / result.error if result.error else 1.0),
    )


def _starts(models, own, scales):
    """Return joint starting operators from models that were fitted alone."""
    bases = []
    for model in models:
        driven, additive = split_disturbances(model.tree(model.operator_))
        if additive:
            raise ValueError(
                "The model of SharedParameters must have no additive disturbances, which each "
                f"response has for itself. Got {model!r} instead."
            )
        bases.append(driven)
    rows = bases[0].entries()
    entry_names = [name for name, _ in rows]
    if any([name for name, _ in base.entries()] != entry_names for base in bases):
        raise ValueError(
            "The responses must lead to models of the same parameters for SharedParameters. Got "
            f"{', '.join(entry_names)} and others instead: fix what the model chooses by the data."
        )
    free = np.flatnonzero(bases[0].free_mask())
    names, specs = [entry_names[i] for i in free], [rows[i][1] for i in free]
    chosen = set() if own is None else set(own)
    unknown = chosen - {*names, *(name.split("[")[0] for name in names)}
    if unknown:
        raise ValueError(
            "The 'own' parameter of SharedParameters must have names of free parameters of the "
            f"model: {', '.join(names)}. Got {', '.join(map(repr, sorted(unknown)))} instead."
        )
    pairs = list(zip(names, specs, strict=True))
    is_own = [spec.is_constant or not chosen.isdisjoint((n, n.split("[")[0])) for n, spec in pairs]
    is_own = np.array(is_own, dtype=bool)
    power = np.where(is_own, 0, [_power(spec.unit) for spec in specs])
    is_log = np.array([spec.log for spec in specs], dtype=bool)
    values, starts = np.array([base.pack()[free] for base in bases]), []
    for first in values:  # common values start from the model of this response
        gains = np.array([_gain(own, first, power) for own in values])
        if not gains[0]:
            continue  # common values of the first response are zero
        common = first * _factors(gains[0], power, is_log)
        gains = gains[1:] / gains[0] if power.any() else []
        vector = np.concatenate([common[~is_own], values[:, is_own].ravel(), gains])
        starts.append(_Responses(tuple(bases), free, is_own, power, is_log, scales, vector))
    return starts


def _power(unit):
    """Return the power of the response in a unit, such as 1 in response/drive."""
    above, _, below = unit.partition("/")
    powers = [
        sum(int(power or 1) for power in re.findall(r"\bresponse\b(?:\^(\d+))?", part))
        for part in (above, below)
    ]
    return powers[0] - powers[1]


def _gain(values, others, power):
    """Return the gain of the response with which ``others`` are closest to ``values``.

    By least squares of the values in proportion to the response; if there are none, from the mean
    logarithm of the ratios.
    """
    straight = others * (power == 1)
    if straight.any():
        return (values @ straight) / (straight @ straight) or float(power.min() < 0)
    both = (power != 0) & (values != 0.0) & (others != 0.0)
    logs = np.log(np.abs(values[both] / others[both])) / power[both]
    return float(np.exp(logs.mean())) if len(logs) else 1.0


def _factors(gain, power, is_log):
    """Return the factors of values for a gain of the response, by its power in their units."""
    size = np.abs(gain) ** power
    return np.where(is_log, size, np.sign(gain) ** power * size)


def _slopes(gain, power, is_log):
    """Return the derivatives of :func:`_factors` by the gain, for nonzero powers."""
    return power * _factors(gain, power - 1, is_log) * np.where(is_log, np.sign(gain), 1.0)


@dataclass(frozen=True)
class _Responses(Operator):
    """The scaled operators of all responses as one; ``at(k)`` is that of response k.

    Its values are the common ones, those that each response has of its own, and the gains of all
    responses but the first, if the unit of a common value contains that of the response.
    """

    bases: tuple
    free: np.ndarray
    is_own: np.ndarray
    power: np.ndarray  # of the response, in the units of common values
    is_log: np.ndarray
    scales: np.ndarray
    vector: np.ndarray
    response: int = 0

    @property
    def n_start(self):
        return self.bases[0].n_start

    @cached_property
    def names(self):
        """Names of the free entries of one response."""
        rows = self.bases[0].entries()
        return [rows[i][0] for i in self.free]

    @property
    def shared(self):
        """Names of the common entries."""
        return tuple(n for n, is_own in zip(self.names, self.is_own, strict=True) if not is_own)

    @property
    def gains(self):
        """Gain of each response, relative to the first."""
        n = (len(self.bases) - 1) * bool(self.power.any())
        return np.append(1.0, self.vector[len(self.vector) - n :] if n else np.ones(n))

    def entries(self):
        rows, specs = [base.entries() for base in self.bases], []
        for is_own in rows:  # the bounds of a response may be those of falling weights
            specs.append([is_own[i] for i in self.free])
        marks = list(enumerate(self.is_own))
        entries = [specs[0][i] for i, is_own in marks if not is_own]
        for k, pairs in enumerate(specs):
            own_pairs = [pairs[i] for i, is_own in marks if is_own]
            entries += [(f"{name} of response {k}", spec) for name, spec in own_pairs]
        if self.power.any():
            entries += [(f"gain of response {k}", ParameterSpec()) for k in range(1, len(rows))]
        return entries

    def parameter_specs(self):
        return dict(self.entries())

    @cached_property
    def n_parameters(self):
        """Number of values in :meth:`pack`."""
        return len(self.vector)

    def pack(self):
        return np.array(self.vector, dtype=float)

    def unpack(self, vector):
        return self._with_values({"vector": np.array(vector, dtype=float)})

    def at(self, schedule):
        return self._with_values({"response": int(schedule)})

    @cached_property
    def _parts(self):
        """The number of common values, and the slice of the response's own values."""
        n_common, n_own = np.count_nonzero(~self.is_own), np.count_nonzero(self.is_own)
        start = n_common + self.response * n_own
        return n_common, slice(start, start + n_own)

    @cached_property
    def operator(self):
        """The operator of the response, in its own units."""
        (n_common, own), base = self._parts, self.bases[self.response]
        factors = _factors(self.gains[self.response], self.power, self.is_log)
        values = np.empty(len(self.free))
        values[~self.is_own], values[self.is_own] = self.vector[:n_common], self.vector[own]
        whole = base.pack()
        whole[self.free] = factors * values
        return base.unpack(whole)

    @cached_property
    def tangents(self):
        """Derivatives of the free entries of the response by the values, (n_free, n_values)."""
        (n_common, own), k = self._parts, self.response
        tangents = np.zeros((len(self.free), len(self.vector)))
        factors = _factors(self.gains[k], self.power, self.is_log)
        tangents[~self.is_own, :n_common] = np.diag(factors[~self.is_own])
        tangents[self.is_own, own] = np.eye(np.count_nonzero(self.is_own))
        if k and self.power.any():
            at, slopes = len(self.vector) - len(self.bases) + k, np.zeros(len(self.free))
            moved = self.power != 0
            slopes[moved] = _slopes(self.gains[k], self.power[moved], self.is_log[moved])
            tangents[~self.is_own, at] = slopes[~self.is_own] * self.vector[:n_common]
        return tangents

    def init(self, u0, initial_state="rest"):
        return self.operator.init(u0, initial_state)

    def run(self, u, dt, state=None):
        y, state = self.operator.run(u, dt, state)
        return y / self.scales[self.response], state

    def sensitivities(self, u, du, dt, initial_state="rest"):
        y, dy = self.operator.sensitivities(u, du, dt, initial_state)
        m, scale = du.shape[-1], self.scales[self.response]
        by_values = dy[:, m:][:, self.free] @ self.tangents
        return y / scale, np.concatenate([dy[:, :m], by_values], axis=1) / scale
