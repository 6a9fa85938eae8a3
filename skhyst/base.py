"""The base of every parametric model: validation, records, identification, free run."""

import copy
import os
import warnings
from abc import abstractmethod
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import pairwise
from numbers import Integral, Real
from threading import Lock
from typing import Literal, Self, overload

import numpy as np
from sklearn.base import BaseEstimator, clone
from sklearn.utils.validation import check_is_fitted
from threadpoolctl import ThreadpoolController

from ._documentation import inherit_documentation
from ._signals import input_signals
from ._sklearn import Interval, StrOptions, fit_context
from ._validation import (
    ScoredMixin,
    as_floats,
    common_parameter,
    drive_column,
    finite_number,
    fitted_interval,
    known_response,
    read_data,
    read_weights,
    refuse_several,
    rest_input,
    used_interval,
    warn_beyond,
    warn_schedules,
    with_unread,
)
from .exceptions import (
    ConvergenceWarning,
    DivergenceWarning,
    RecordError,
    ShortRecordWarning,
)
from .operators import (
    MovableOperator,
    Operator,
    Series,
    Signal,
    Stepper,
    SumOperator,
    add_disturbances,
    cut_off,
    holding_what_moves,
    holds_of_input,
    resampled,
    run_records,
    run_variance,
    split_disturbances,
)
from .optimize import (
    LEVEL,
    METHODS,
    NOISELESS,
    Method,
    OperatorProblem,
    RecordData,
    apart_p_value,
    as_of,
    calibrated,
    has_start_misfit,
    identify,
    input_history_of,
    is_coloured,
    later_halves,
    record_with_history,
    start_p_value,
    start_precision,
    with_further_starts,
    with_input_history,
)
from .records import RecordSlice, valid_interval, with_lost_rows

__all__ = ["ParametricModel"]

_NAMED = 10  # undetermined parameters that a warning names
_OUT_OF_RANGE = (
    "Identification has left the range of floating point: choose other units of X, y or time, in "
    "which the numbers are nearer to one."
)
_NO_REST = (
    "{} has found no state of rest, as of an integrator: start with initial_state='zero', or from "
    "a known response, 'y_start' of predict"
)
# of the response: the square of less is lost in the rounding of a matrix of sums of squares
_LEAST_NOISE = np.cbrt(np.finfo(float).eps)
_MOST = 0.5  # ratio of squared errors below which a change removes more of the error than it leaves
_NOTICEABLE = 0.05  # of the response: an error below a few per cent of it misleads nobody
_FEW = "The records hold few independent samples, so that standard errors are too small for"


class _OneThread:
    """A context in which linear algebra uses one thread, until the last user has left it.

    The number of threads is a property of the process: if each user restored the number it found,
    overlapping fits would end with a single thread.
    """

    def __init__(self):
        self._lock, self._n_within, self._limits = Lock(), 0, None

    def __enter__(self):
        with self._lock:
            if not self._n_within:
                self._limits = _threads().limit(limits=1, user_api="blas")
            self._n_within += 1

    def __exit__(self, *_):
        with self._lock:
            self._n_within -= 1
            if not self._n_within:
                self._limits.restore_original_limits()


@cache
def _threads():
    return ThreadpoolController()  # cached, since it searches all loaded libraries


_ONE_THREAD = _OneThread()
if hasattr(os, "register_at_fork"):  # a child has no copy of the thread that may hold the lock
    os.register_at_fork(after_in_child=_ONE_THREAD.__init__)


def one_thread():
    """Return a context in which linear algebra uses one thread."""
    return _ONE_THREAD


@contextmanager
def _calculable():
    """Refuse data for which identification exceeds the range of floating-point numbers."""
    try:
        with one_thread(), np.errstate(over="ignore", invalid="ignore"):
            yield
    except np.linalg.LinAlgError as error:
        raise RecordError(_OUT_OF_RANGE) from error


def informed(model, parent):
    """Return a copy of a part of a model with the column names of the complete model."""
    names = ("n_features_in_", "feature_names_in_")
    known = {name: getattr(parent, name) for name in names if hasattr(parent, name)}
    if known and isinstance(model, ParametricModel):
        model = copy.copy(model)
        vars(model).update(known)
    return model


def with_params(model, **params):
    """Return a copy of a model with other parameters; unlike a clone, with fitted attributes."""
    model = copy.copy(model)
    vars(model).update(params)
    return model


def scored_where(data, slices, read):
    """Return records in which rows that were filled in, those not ``read``, have weight zero."""
    return [
        replace(record, weights=read[s.rows].astype(float)) if not read[s.rows].all() else record
        for record, s in zip(data, slices, strict=True)
    ]


def as_node(model, **parts):
    """Return an unfitted model, with other models as its parts."""
    model = informed(clone(model), model) if hasattr(model, "operator_") else model
    return with_params(model, **parts) if parts else model


def refine(model, starts, records, method=None, *, with_errors=True):
    """Return the identification result of a model, from starts of one structure.

    ``method`` replaces that of the model. ``with_errors`` is that of
    :func:`skhyst.optimize.identify`: False leaves out standard errors.
    """
    return identify(
        starts,
        records,
        fixed=model.held_parameters(),
        initial_state=model.free_run_state,
        method=method or model.method,
        with_errors=with_errors,
    )


def identified(model, records):
    """Return a model with its hold chosen if that is "auto", and its identification result."""
    candidates = [model.with_hold(hold) for hold in ("foh", "zoh")]
    if candidates[0] is model:
        return model, model.identify(records)
    results = [candidate.identify(records) for candidate in candidates]
    better = int(results[1].error < results[0].error)
    evaluations = sum(result.n_evaluations for result in results)
    return candidates[better], replace(results[better], n_evaluations=evaluations)


def input_at_rest(model, u0, initial_state, caller):
    """Return the input at which a fitted model rests; see :meth:`ParametricModel.stepper`."""
    more = {"with_amplitude": model.reads_columns}
    levels = rest_input(u0, initial_state, model.n_features_in_, caller, **more)
    if not model.reads_columns:
        return float(levels[drive_column(model)])
    # the amplitude of the record may follow the columns
    return np.append(levels, levels[0]) if np.size(u0) == 1 else levels


@dataclass(frozen=True)
class _Run:
    """The run of a record from an initial state, after ``skip`` samples of input history.

    ``record`` has the history, or the start values, if they are estimated.
    """

    operator: Operator
    covariance: np.ndarray | None
    u: np.ndarray
    dt: float
    initial_state: str | np.ndarray  # or start values, if there is no state of rest
    skip: int = 0
    record: RecordData | None = None

    def at(self, schedule):
        """Return the same run with the parameters of a record's schedule value."""
        return self if schedule is None else replace(self, operator=self.operator.at(schedule))

    def run(self):
        """Return the output of the record, and the state of the operator after it."""
        driven, additive = split_disturbances(self.operator)
        y, state = driven.run(self.u, self.dt, driven.init(self.u[0], self.initial_state))
        if not additive:
            return y[self.skip :], state
        runs = [disturbance.run(self.u[self.skip :], self.dt) for disturbance in additive]
        y = y[self.skip :] + np.sum([disturbance for disturbance, _ in runs], axis=0)
        return y, (state, *(last_state for _, last_state in runs))

    def variance(self):
        """Return the variance of the output from the errors of all that was estimated."""
        options = {"initial_state": self.initial_state, "skip": self.skip}
        if self.record is not None:
            driven, _ = split_disturbances(self.operator)
            problem = OperatorProblem(driven, [self.record])
            options["by_start"] = problem.history_sensitivities(driven, self.record)
        return run_variance(self.operator, self.covariance, self.u, self.dt, **options)


class ParametricModel(ScoredMixin, BaseEstimator):
    """Base of the models whose free run is the run of an operator.

    A subclass gives :meth:`starting_values`, ``operator_class``, which determines its place in a
    series, and, if parameters are held for another reason than a flag ``fit_<name>``,
    :meth:`held_parameters`. A constructor of its own assigns ``initial_state`` and ``dt`` too.
    Parameters and attributes that its docstring does not describe are described by that of its
    base. Other methods rarely need to be overridden; see the developers' pages.

    Parameters
    ----------
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample: at rest after a first loading from zero; all zero;
        or after an input history that is estimated for each record.
    dt : float or None, default=None
        Sampling interval in s of data without a time index. None: unknown in ``fit``, so that
        constants of time are in samples; in ``predict`` that of the fit, which another value must
        not contradict.
    drive : str, int or None, default=None
        Name or number of the column of X that is the drive; None: column 0. For a model that reads
        further columns it must be column 0.
    method : str or Method, default="variable_projection"
        How the parameters are identified, see :mod:`skhyst.optimize`.

    Attributes
    ----------
    operator_ : Operator
        The identified operator: ``init``, ``step``, ``run``.
    params_, params_std_, params_std_white_ : dict of str to float
        Parameters in the user's units and their standard errors (NaN at a bound, infinite if the
        data do not determine the value): for noise of any colour, and under white noise.
    identifiability_ : dict
        ``undetermined`` (tuple of names) and ``condition_number``.
    n_evaluations_ : int
        Number of simulations of all records in identification.
    fit_error_ : float
        Root mean square of the residual in the records of the fit, units of the response.
    covariance_ : ndarray of shape (n_values, n_values) or None
        Covariance of the errors of ``operator_.pack()``, in its units; zero for values that are
        held, at a bound, or not determined by the data. For coefficients of additive disturbances
        it is their scatter over records: a new record has its own.
    noise_std_ : float or None
        Standard deviation of the noise, units of the response; None for a part of a fitted
        composition, and for a fit by predictions one step ahead.
    has_rest_ : bool
        False if the records of the fit do not begin at a state of rest, as for an integrator; a
        model with the initial state ``"estimate"`` then starts from zero.
    records_ : tuple of RecordSlice
        The records of the fit.
    dt_ : float or None
        Sampling interval of the fit, or that of :meth:`resampled`, in ``time_unit_``; None if the
        records have different intervals.
    time_unit_ : {"s", "sample"}
        "sample" if the data of the fit had no interval.
    drive_range_ : tuple of (float, float)
        Smallest and largest drive in the fit, units of the drive.
    input_range_ : ndarray of shape (2, n_inputs)
        Smallest and largest value of each column of X in the fit, in its units.
    drive_rate_ : float
        Largest rate of the drive between two samples of the fit, units of the drive per s.
    initial_drive_ : ndarray of shape (n_records, n_values), or (n_records, n_values, n_inputs)
        Drive 1, 2, 4, ... samples before each record of the fit, its units; if the initial state is
        estimated. The drive is straight between these values, and at rest before them. For a model
        that reads further columns, each of its inputs.
    initial_values_ : ndarray of shape (n_records, n_start)
        Instead of ``initial_drive_`` for a model without a state of rest: the start values of each
        record of the fit, such as displacement and velocity of a mass without a spring.

    See Also
    --------
    skhyst.operators.Operator : Base of the operators.

    Examples
    --------
    See :ref:`sphx_glr_auto_examples_plot_own_model.py`.
    """

    _parameter_constraints = {
        "dt": [Interval(Real, 0, None, closed="neither"), None],
        "drive": [str, Integral, None],
        "initial_state": [StrOptions({"rest", "zero", "estimate"})],
        "method": [StrOptions(set(METHODS)), Method],
    }

    operator_class = Operator
    dt = drive = None  # for a constructor without these parameters
    method = "variable_projection"  # for a constructor without this parameter
    redefined: tuple[str, ...] = ()  # parameters with another meaning than in other models
    reads_columns = False  # of X other than the first
    one_interval = False  # whether all records must have the same interval
    any_interval = False  # whether the response to a straight drive is the same at any interval
    moves_positions = False  # whether a fit finds where the terms of a sum are, and how many
    has_rest_ = True
    disturbance_names = ()  # of the additive disturbances of the model

    def __init_subclass__(cls, **options):
        super().__init_subclass__(**options)
        inherit_documentation(cls)

    @classmethod
    @cache
    def _get_param_names(cls):
        return super()._get_param_names()  # cached: a search clones thousands of times

    def __init__(self, *, initial_state="rest", dt=None, drive=None, method="variable_projection"):
        self.initial_state = initial_state
        self.dt = dt
        self.drive = drive
        self.method = method

    @property
    def stage_order(self) -> int:
        """Place of the model in a series: the ``stage_order`` of its operator."""
        return self.operator_class.stage_order

    @abstractmethod
    def starting_values(self, records):
        """Return operators of one structure, from which identification starts.

        Linear parameters are solved exactly and need no starting values.

        Parameters
        ----------
        records : sequence of RecordData
            Records of the fit.

        Returns
        -------
        list of Operator
            Starting values; identification uses the best.
        """

    def held_parameters(self) -> frozenset[str]:
        """Return the names of entries that are held at their starting values.

        By default those whose flag ``fit_<name>`` is False.
        """
        flags = self.get_params(deep=False).items()
        return frozenset(name[4:] for name, fit in flags if name[:4] == "fit_" and fit is False)

    @fit_context(prefer_skip_nested_validation=True)
    def fit(self, X, y, sample_weight=None) -> Self:
        """Identify the parameters.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            Inputs; the index carries records and time.
        y : array-like of shape (n_samples,)
            Response.
        sample_weight : array-like of shape (n_samples,), default=None
            Nonnegative weights: the squared error of each sample is multiplied by its weight, as if
            the sample occurred that many times. Unless all are zero or whole numbers, the smallest
            of them 1, they are relative, such as inverse variances: their scale does not matter,
            and the standard deviation of the noise is that of a sample of mean weight. A sample of
            weight zero still acts on later ones through its drive; its response is not read.

        Returns
        -------
        self
        """
        y = with_unread(y, sample_weight)
        data = self._read_records(X, y, sample_weight)
        # the matrices are tiny: synchronising threads costs more than they gain
        with _calculable():
            self.fit_records(data)
        weights = None if sample_weight is None else np.concatenate([r.weights for r in data])
        self._warn_of_other_column(X, y, weights)
        return self

    @fit_context(prefer_skip_nested_validation=True)
    def fit_from(self, operator, X, y, *, records=None, method=None) -> Self:
        """Identify the parameters starting from an operator, such as the result of another fit.

        Parameters
        ----------
        operator : Operator
            Like ``operator_`` of this model: of its structure, with its additive disturbances.
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            As for :meth:`fit`.
        y : array-like of shape (n_samples,)
            As for :meth:`fit`.
        records : sequence of RecordData, default=None
            The records for identification, if they contain more than X and y: weights, segments, an
            input history.
        method : str or Method, default=None
            Replaces that of the model.

        Returns
        -------
        self

        Examples
        --------
        >>> import numpy as np
        >>> from skhyst.linear import FirstOrderLag, FirstOrderLagOperator
        >>> u = np.random.default_rng(0).normal(size=200)
        >>> y, _ = FirstOrderLagOperator(0.05).run(u, 0.01)
        >>> model = FirstOrderLag(dt=0.01).fit_from(FirstOrderLagOperator(0.1), u[:, None], y)
        >>> round(model.operator_.time_constant, 6)
        0.05
        """
        data = self._read_records(X, y)
        data = data if records is None else list(records)
        tree = self._tree_of(operator)
        with _calculable():
            return self.finish(refine(self, [tree], data, method), data)

    def _tree_of(self, operator):
        """Return an operator as a tree of this model, or refuse one of another structure."""
        try:
            tree = self.tree(operator)
        except (AttributeError, ValueError) as error:  # where the model has parts, it has none
            raise ValueError(
                f"The 'operator' parameter of {type(self).__name__}.fit_from must have the parts "
                f"of this model, as 'operator_' of its fit. Got a {type(operator).__name__} "
                "instead."
            ) from error
        _refuse_other_parts(tree)
        return tree

    def _warn_of_other_column(self, X, y, weights):
        """Warn if a straight line through an ignored column predicts better than the model."""
        if (
            self.n_features_in_ == 1
            or self.reads_columns
            or common_parameter(self, "drive") is not None
        ):
            return
        X, y = as_floats(self, X, y, reset=False)
        weights = np.ones(len(y)) if weights is None else weights
        X, y, weights = (values[weights > 0.0] for values in (X, y, weights))
        lines = [
            np.polynomial.Polynomial.fit(x, y, 1, w=np.sqrt(weights))(x)
            if np.ptp(x)
            else np.average(y, weights=weights)
            for x in X.T
        ]
        errors = [np.sqrt(np.average(np.square(y - line), weights=weights)) for line in lines]
        best = int(np.argmin(errors[1:])) + 1
        if errors[best] < self.fit_error_:
            names = list(getattr(self, "feature_names_in_", range(len(errors))))
            warnings.warn(
                f"A straight line through column {names[best]!r} predicts the response better than "
                f"{type(self).__name__} does from its drive, column {names[0]!r}: the drive is "
                "column 0 unless the 'drive' parameter says another.",
                ConvergenceWarning,
                stacklevel=3,
            )

    def _read_records(self, X, y, sample_weight=None):
        """Validate X and y, store the records, and return them in the form for identification."""
        given = X
        slices, X, y = read_data(self, X, y, reset=True, bridge=True)
        self.records_, self.has_rest_ = slices, True
        self.input_range_ = np.array([X.min(axis=0), X.max(axis=0)])
        weights = read_weights(sample_weight, given)
        even, X, y, weights, read = with_lost_rows(slices, X, y, weights)
        data = self.record_data(even, X, y)
        data = data if read is None else scored_where(data, even, read)
        if sample_weight is None:
            return data
        return [
            replace(record, weights=record.counts() * weights[s.rows])
            for s, record in zip(even, data, strict=True)
        ]

    def record_data(self, slices, X, y):
        """Return each record in the form for identification.

        Parameters
        ----------
        slices : sequence of RecordSlice
            Rows and sampling interval of each record.
        X : ndarray of shape (n_samples, n_inputs)
            Validated inputs.
        y : ndarray of shape (n_samples,)
            Validated response.

        Returns
        -------
        list of RecordData
        """
        signal, schedules = self.operator_input(X, slices)
        return [
            RecordData(signal[s.rows], y[s.rows], s.dt, schedule=schedule)
            for s, schedule in zip(slices, schedules, strict=True)
        ]

    def operator_input(self, X, slices):
        """Return the input of the operator, and the schedule values of its parameters.

        Parameters
        ----------
        X : ndarray of shape (n_samples, n_inputs)
            Validated inputs.
        slices : sequence of RecordSlice
            Rows and sampling interval of each record.

        Returns
        -------
        signal : ndarray of shape (n_samples,) or (n_samples, n)
            The drive, or several columns of X if the model ``reads_columns``.
        schedules : list of float or None
            For each record the value that scheduled parameters depend on, or None.
        """
        return X[:, drive_column(self)], [None] * len(slices)

    def __sklearn_tags__(self):
        tags = super().__sklearn_tags__()
        tags.regressor_tags.poor_score = True  # on data that no device has produced
        return tags

    def identify(self, data):
        """Identify the operator from its starting values, without storing the result.

        Parameters
        ----------
        data : sequence of RecordData
            Records of the fit.

        Returns
        -------
        IdentificationResult
        """
        return refine(self, self.starting_values(data), data)

    def in_order(self, operator, records):
        """Return an equivalent operator with exchangeable parts in ascending order.

        Parameters
        ----------
        operator : Operator
            Driven part of a fit.
        records : sequence of RecordData
            Records of the fit.

        Returns
        -------
        Operator
            The operator itself if they are in order.
        """
        return operator.in_order()

    def further_starts(self, records):
        """Return operators around which starts are drawn if the residual of a fit is coloured.

        Parameters
        ----------
        records : sequence of RecordData
            Records of the fit.

        Returns
        -------
        list of Operator
            Those of another structure than the fit are ignored.
        """
        return self.starting_values(records)

    def identified_otherwise(self, data, starts):
        """Yield results from other starting strategies, if the residual of :meth:`fit` is coloured.

        By default from each of several starts: :meth:`fit` has followed the best two.

        Parameters
        ----------
        data : sequence of RecordData
            Records of the fit.
        starts : callable
            Returns :meth:`further_starts` of these records.

        Yields
        ------
        IdentificationResult
        """
        several = starts()
        for start in several if len(several) > 1 else ():
            yield refine(self, [start], data)

    def with_hold(self, hold):
        """Return the model with a given hold of the drive if its own is "auto".

        Parameters
        ----------
        hold : {"foh", "zoh"}
            A straight line between samples, or constant.

        Returns
        -------
        estimator
            The model itself if its hold is not "auto".
        """
        return with_params(self, hold=hold) if getattr(self, "hold", None) == "auto" else self

    def resolved(self, operator) -> Self:
        """Return the unfitted model with the resolution of one of its operators.

        Parameters
        ----------
        operator : Operator
            Like ``operator_``, with another number of terms than in the parameters; see
            :class:`skhyst.operators.Resolution`.

        Returns
        -------
        estimator
            Unfitted.
        """
        return self

    def tree(self, operator) -> Operator:
        """Return an operator of this model as a tree, the structure of the model.

        Parameters
        ----------
        operator : Operator or tuple of (Operator, tuple of Operator)
            Like ``operator_``, with its additive disturbances; or these apart, as
            :func:`skhyst.operators.split_disturbances` returns them.

        Returns
        -------
        Operator
            With the models that its parts belong to, so that its method ``estimator`` returns this
            model, unfitted. Entries that the model holds are held.

        Examples
        --------
        >>> from skhyst.linear import FirstOrderLag, FirstOrderLagOperator
        >>> FirstOrderLag(hold="zoh").tree(FirstOrderLagOperator(0.1)).estimator()
        FirstOrderLag(hold='zoh')
        """
        driven, disturbances = split_disturbances(operator)
        return self.subtree(driven, iter(disturbances))

    def subtree(self, driven, disturbances):
        """Return the tree of a part of a model; see :meth:`tree`.

        Parameters
        ----------
        driven : Operator
            The driven part, or the part of it that belongs to this model.
        disturbances : iterator of Operator
            Of all parts, in their order: each part takes its own.

        Returns
        -------
        Operator
        """
        operator = next(disturbances) if self.operator_class.is_disturbance else driven
        return replace(operator, model=as_node(self))

    def unfitted(self, operator) -> Self:
        """Return the model of a tree whose root belongs to this one.

        Parameters
        ----------
        operator : Operator
            Root of the tree: what :meth:`tree` has returned, or an edit of it.

        Returns
        -------
        estimator
            Unfitted. Its parts are those of the tree itself; ``operator.estimator()`` has copies.
        """
        return self

    def fit_records(self, records) -> Self:
        """Fit validated records: identify, settle how they begin, warn, and store the result.

        Parameters
        ----------
        records : sequence of RecordData
            Those of ``records_``.

        Returns
        -------
        self
        """
        model, result = identified(self, records)
        moving = None if self.free_run_state == "zero" else self._without_rest(result, records)
        if moving is None:
            result = self._settled(model, result, records)
            result, records = self.with_history_behind_gaps(result, records)
            moves = self._warn_of_moving_start(model, result, records)
            self._warn_of_differing_records(model, result, records, moves)
            return self.finish(result, records)
        warnings.warn(
            f"{_NO_REST.format(type(self).__name__)}: with initial_state='zero' the error is "
            f"{moving.error:.3g} in place of {result.error:.3g}.",
            ConvergenceWarning,
            stacklevel=4,
        )
        self.has_rest_ = False
        return self.finish(
            moving if common_parameter(self, "initial_state") == "estimate" else result, records
        )

    def _settled(self, model, result, records):
        """Return a result, after further starts if its residual is coloured, in order.

        ``model`` has a definite hold.
        """
        if result.input_history is not None:  # the starts of the records belong to the operator
            return result
        if self.method == "variable_projection":
            options = {"fixed": model.held_parameters(), "initial_state": self.free_run_state}
            starts = cache(partial(model.further_starts, records))
            others = model.identified_otherwise(records, starts)
            result = with_further_starts(result, records, starts, others, **options)
        ordered = model.in_order(result.operator, records)
        if ordered is result.operator:
            return result
        again = refine(model, [(ordered, result.disturbances)], records, "variable_projection")
        evaluations = result.n_evaluations + again.n_evaluations
        return replace(again, n_evaluations=evaluations, is_local=result.is_local)

    def with_history_behind_gaps(self, result, records):
        """Return a fit and its records, those behind missing rows with an input history.

        A record that continues behind a gap begins in motion: the drive in the gap is estimated,
        unless this improves the fit no more than chance does. Beside start values it is not: then
        the rows of such records have weight zero if a part depends on it.

        Parameters
        ----------
        result : IdentificationResult
            Of this model.
        records : sequence of RecordData
            Those of ``records_``.

        Returns
        -------
        result : IdentificationResult
        records : sequence of RecordData
        """
        behind, operator = behind_gaps(self.records_), result.operator
        if not behind or operator.memoryless or result.input_history is not None:
            return result, records
        state, method = self.free_run_state, "variable_projection"
        which = [number in behind for number in range(len(records))]
        begins = [result]
        if operator.n_start:  # it does not forget a wrong start: the other records know better
            others = [r for r, is_behind in zip(records, which, strict=True) if not is_behind]
            model, apart = identified(self, others)
            begins.append(apart)
            if _has_other_memory(operator):
                n_rows = sum(len(records[number].u) for number in behind)
                warnings.warn(
                    f"{n_rows} rows behind missing rows are left out of the fit of "
                    f"{type(self).__name__}: how they begin is not known, of its part without a "
                    "state of rest and of others that remember the drive.",
                    ConvergenceWarning,
                    stacklevel=5,
                )
                records = [
                    replace(r, weights=np.zeros(len(r.u))) if is_behind else r
                    for r, is_behind in zip(records, which, strict=True)
                ]
                apart = self._settled(model, apart, others)
                begin = refine(model, [(apart.operator, apart.disturbances)], records, method)
                return replace(begin, is_local=apart.is_local), records
        options = {"which": which, "initial_state": state}
        ends = [with_input_history(begin, records, method, **options) for begin in begins]
        refitted = min(ends, key=lambda end: end.error)
        n_values = np.count_nonzero(np.isfinite(refitted.input_history))
        if start_p_value(result, refitted, records, n_values, (state, state)) >= LEVEL:
            return result, records
        pairs = zip(records, refitted.input_history, strict=True)
        records = [record_with_history(operator, *pair) for pair in pairs]
        return replace(refitted, input_history=None), records

    def _warn_of_moving_start(self, model, result, records):
        """Warn if records do not begin at rest, which biases the fit; return whether they do not.

        ``model`` has a definite hold.
        """
        operator, is_given = result.operator, common_parameter(self, "initial_state") != "rest"
        if is_given or operator.memoryless or result.input_history is not None:
            return False
        if not np.ptp(np.concatenate([record.drive for record in records])):  # which is warned of
            return False
        # an operator without a state of rest remembers its start throughout the record
        is_suspect = (
            is_coloured(result, records) if operator.n_start else has_start_misfit(result, records)
        )
        if not is_suspect:
            return False
        state, best, best_state = "rest", result, "rest"
        start, method = [(operator, result.disturbances)], "variable_projection"
        zero = with_params(model, initial_state="zero")
        for other, other_fit in (
            ("zero", refine(zero, start, records, method, with_errors=False)),
            ("estimate", with_input_history(result, records, method)),
        ):
            history = other_fit.input_history
            n_values, other_state = (1, other) if history is None else (history.size, "rest")
            p_value = start_p_value(best, other_fit, records, n_values, (best_state, other_state))
            # an estimated start also fits the misfit of a model; two tests (Bonferroni)
            if other_fit.error**2 < _MOST * best.error**2 and 2.0 * p_value < LEVEL:
                state, best, best_state = other, other_fit, other_state
        if state != "rest":
            warnings.warn(
                f"The records do not begin at rest, as {type(self).__name__} assumes, at their "
                f"first rows or after missing rows: with initial_state={state!r} the error is "
                f"{best.error:.3g} instead of {result.error:.3g}.",
                ConvergenceWarning,
                stacklevel=5,
            )
        return state != "rest"

    def _warn_of_differing_records(self, model, result, records, moves):
        """Warn if no one set of parameters describes the records, such as of two offsets or units.

        ``model`` has a definite hold; with ``moves``, records do not begin at rest.
        """
        ends = [*np.setdiff1d(np.arange(len(records)), behind_gaps(self.records_)), len(records)]
        groups = [records[a:b] for a, b in pairwise(ends)]
        sizes = [sum(record.counts().sum() for record in group) for group in groups]
        operator, state = result.operator, self.free_run_state
        noticeable = _NOTICEABLE * np.sqrt(np.mean([np.var(record.y) for record in records]))
        if (
            min(sizes) <= len(result.params)  # a few samples agree with anything
            or len(groups) < 2
            or result.input_history is not None
            or result.error <= noticeable
            or not is_coloured(result, records, state)
        ):
            return
        method = "variable_projection"
        model = with_params(model, method=method)
        largest = identified(model, groups[int(np.argmax(sizes))])[1]
        starts = [(fit.operator, fit.disturbances) for fit in (result, largest)]
        apart = [refine(model, starts, group, with_errors=False) for group in groups]
        if moves or (
            common_parameter(self, "initial_state") == "estimate" and not operator.memoryless
        ):
            result = with_input_history(result, records, method)
            pairs = zip(apart, groups, strict=True)
            apart = [with_input_history(*pair, method) for pair in pairs]
        squares = [size * fit.error**2 for size, fit in zip(sizes, apart, strict=True)]
        error = np.sqrt(sum(squares) / sum(sizes))
        # records of several ranges also fit a wrong model better each by itself
        if (
            error**2 < min(_MOST * result.error**2, result.error**2 - noticeable**2)
            and apart_p_value(result, groups, apart, state) < LEVEL
        ):
            warnings.warn(
                f"No one set of parameters of {type(self).__name__} describes all records: the "
                f"error is {error:.3g} in place of {result.error:.3g} with one set for each. Do "
                "they differ in their offset (add an Offset in a Sum), amplitude (see "
                "ScheduledParameters), unit or device?",
                ConvergenceWarning,
                stacklevel=5,
            )

    def _without_rest(self, result, records):
        """Return a fit that starts from zero, if the response has no state of rest.

        If a pole does not decay within the longest record, its state of rest is not recorded; an
        integrator has none, and no record begins at one.
        """
        longest = max(len(record.u) * record.dt for record in records)
        # a model declared without rest has start values
        if result.operator.n_start or not result.operator.slowest_decay() > longest:
            return None
        moving = identified(with_params(self, initial_state="zero"), records)[1]
        is_better = moving.error**2 < _MOST * result.error**2
        is_better &= start_p_value(result, moving, records, 1, ("rest", "zero")) < LEVEL
        return moving if is_better and moving.operator.slowest_decay() > longest else None

    def finish(self, result, records):
        """Store the result of identification, and warn of parameters that are not determined.

        If the initial state is to be estimated and is not known yet, it is identified first.

        Parameters
        ----------
        result : IdentificationResult
            Of the driven part and the disturbances.
        records : sequence of RecordData
            Records of the fit.

        Returns
        -------
        self
        """
        if not np.isfinite(result.error):
            raise RecordError(_OUT_OF_RANGE)
        estimated = common_parameter(self, "initial_state") == "estimate" and self.has_rest_
        if estimated and result.input_history is None:
            field_name = "start" if result.operator.n_start else "before"
            if any(getattr(record, field_name) is None for record in records):
                further = () if result.operator.n_start else self._fits_of_later_halves(records)
                result = with_input_history(result, records, self.method, further=further)
            else:
                known = np.array([np.atleast_1d(getattr(record, field_name)) for record in records])
                result = replace(result, input_history=known)
        result = self._with_position_errors(result, records)
        for message, kind in self.fit_warnings(result, records):
            warnings.warn(message, kind, stacklevel=4)
        return self.adopt(result)

    def _fits_of_later_halves(self, records):
        """Return further starts of a fit that estimates how records begin.

        The fit from rest may have ended in another local optimum. In the later halves of the
        records the start hardly matters.
        """
        model, late = identified(self, later_halves(records))
        further = [(late.operator, late.disturbances)]
        if late.operator.signal_linear:
            starts = model.starting_values(records)
            further += [(start, late.disturbances) for start in starts]
        return further

    def _with_position_errors(self, result, records):
        """Return a result whose standard errors hold those of positions that the fit has moved."""
        driven, _ = split_disturbances(self.tree((result.operator, result.disturbances)))
        movable = _with_movable_positions(driven)
        if movable is driven or result.joint_covariance is None:
            return result
        if result.input_history is not None:
            pairs = zip(records, result.input_history, strict=True)
            records = [record_with_history(driven, *pair) for pair in pairs]
        held = {name for name, _ in driven.entries()} - set(result.params)
        options = {"fixed": held, "initial_state": self.free_run_state}
        return result.narrowed(as_of(result, movable, records, **options))

    def fit_warnings(self, result, records):
        """Yield the warnings of an identification result.

        Parameters
        ----------
        result : IdentificationResult
            Of this model.
        records : sequence of RecordData
            The records of the fit.

        Yields
        ------
        message : str
            A sentence.
        category : type
            Category of the warning that a fit gives.
        """
        name, drives = type(self).__name__, np.concatenate([record.drive for record in records])
        # a disturbance ignores the drive, and further columns may move in its place
        driven = not (self.operator_class.is_disturbance or self.reads_columns)
        if driven and self.free_run_state == "rest" and not np.ptp(drives):
            yield (
                f"The drive does not move: it is {drives[0]:g} in every sample, which does not "
                f"determine how {name} responds. If it was switched on at the first sample, set "
                "initial_state='zero'.",
                ConvergenceWarning,
            )
        for part in holding_what_moves(result.operator):
            yield (
                f"The input of {part!r} is held between samples (hold='zoh'), although a part of "
                f"{name} before it moves between them: as if there were a sampler. Set hold='foh' "
                "for it unless there is one; only the drive of the first dynamics is held.",
                UserWarning,
            )
        holds = sorted(holds_of_input(result.operator))
        if len({column for column, _ in holds}) < len(holds):
            kinds = " and ".join(repr(kind) for kind in dict.fromkeys(kind for _, kind in holds))
            yield (
                f"Parts of {name} assume different courses of one input between samples, with the "
                f"holds {kinds}: set the same hold for all of them.",
                UserWarning,
            )
        slope = _better_slope(drives, result, records) if driven else 0.0
        if slope:  # most often a wrong sign or unit: the remedy depends on which models have a gain
            remedy = "add a Gain to it in a Cascade, or take other units"
            if slope < 0.0:
                remedy = "turn the sign of one of them"
            elif result.operator.owns_gain:
                remedy = "add a Gain to it in a Sum, or declare another model"
            yield (
                f"A straight line, {'rising' if slope > 0.0 else 'falling'} with the drive, "
                f"predicts the response clearly better than {name} does: {remedy}.",
                ConvergenceWarning,
            )
        if (
            result.input_history is not None
            and result.operator.n_start
            and _has_other_memory(result.operator)
            and is_coloured(
                result,
                [
                    record_with_history(result.operator, *pair)
                    for pair in zip(records, result.input_history, strict=True)
                ],
            )
        ):
            yield (
                f"Start values are those of the part of {name} without a state of rest: the others "
                "begin at rest, and the residual is not white.",
                ConvergenceWarning,
            )
        if _is_constant(result.operator) and any(np.ptp(record.y) > 0.0 for record in records):
            yield (
                f"No weight of {name} is other than zero: the response follows the "
                "drive in neither direction.",
                ConvergenceWarning,
            )
        if result.is_local:
            yield (
                f"The fit of {type(self).__name__} has not converged to one optimum: its residual "
                "is not white, and further starts lead to others. Its parameters may be those of a "
                "local optimum.",
                ConvergenceWarning,
            )
        for names, text, kind in (
            (result.undetermined, "The data do not determine", ConvergenceWarning),
            (result.short, _FEW, ShortRecordWarning),
        ):
            if names:
                listed, more = ", ".join(names[:_NAMED]), len(names) - _NAMED
                rest = f" and {more} more" if more > 0 else ""
                yield f"{text} these parameters of {type(self).__name__}: {listed}{rest}.", kind

    def adopt(self, result):
        """Store an identification result.

        Parameters
        ----------
        result : IdentificationResult
            Of the driven part and the disturbances.

        Returns
        -------
        self
        """
        result, names = result.released(), self.disturbance_names
        self.operator_: Operator = add_disturbances(result.operator, result.disturbances, names)
        if result.input_history is not None:
            name = "initial_values_" if result.operator.n_start else "initial_drive_"
            setattr(self, name, result.input_history)
        if result.disturbances:
            self.record_coefficients_ = result.record_coefficients
        self.params_: dict[str, float] = result.params
        self.params_std_: dict[str, float] = result.params_std
        self.params_std_white_: dict[str, float] = result.params_std_white or result.params_std
        self.identifiability_ = {
            "undetermined": result.undetermined,
            "condition_number": result.condition_number,
        }
        self.n_evaluations_ = result.n_evaluations
        self.n_iter_ = max(len(result.history), 1)
        self.fit_error_ = result.error
        self.covariance_, self.noise_std_ = result.operator_covariance(), result.noise_std
        return self

    @overload
    def predict(self, X, y_start=None, return_std: Literal[False] = False) -> np.ndarray: ...
    @overload
    def predict(
        self, X, y_start=None, *, return_std: Literal[True]
    ) -> tuple[np.ndarray, np.ndarray]: ...
    def predict(
        self, X, y_start=None, return_std=False
    ) -> np.ndarray | tuple[np.ndarray, np.ndarray]:
        """Return the free-run prediction, each record from its own initial state.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            As for :meth:`fit`.
        y_start : array-like of shape (n_samples,), default=None
            Known values of the response, such as in the first part of a record that begins in
            motion, NaN elsewhere. The input history is estimated from them, as in :meth:`fit` with
            the initial state ``"estimate"``, and so are the coefficients of additive disturbances.
            What they do not determine, such as a velocity from a single reading, is as at rest.
            A record without known values begins at its usual initial state, as all do by default.
        return_std : bool, default=False
            Whether to return the standard deviation of the prediction of a new sample, too.

        Returns
        -------
        y : ndarray of shape (n_samples,)
            Units of the response. Always finite; a run that leaves the range of floating-point
            numbers is cut off there, with a :class:`~skhyst.exceptions.DivergenceWarning`.
        std : ndarray of shape (n_samples,)
            Standard deviation of a new sample about y, units of the response, to first order in the
            errors of the parameters: ``sqrt(diag(J C J.T) + noise_std_**2)``, with the
            sensitivities J of the run and ``covariance_`` C; with ``y_start``, C holds the errors
            of the start, too. Only with ``return_std``.

        Raises
        ------
        RecordError
            If the sampling interval contradicts the fit: X has a time, the fit had none, and the
            model depends on time; or the model counts samples, and the interval differs.
        ValueError
            If ``return_std`` is true for a model without a covariance or noise.

        Examples
        --------
        >>> import numpy as np
        >>> from skhyst.linear import FirstOrderLag, FirstOrderLagOperator
        >>> rng = np.random.default_rng(0)
        >>> u = rng.normal(size=(400, 1)).cumsum(axis=0)
        >>> y = FirstOrderLagOperator(0.05).run(u[:, 0], 0.01)[0] + rng.normal(0.0, 0.1, 400)
        >>> model = FirstOrderLag(dt=0.01).fit(u[:200], y[:200])
        >>> found, std = model.predict(u, return_std=True)
        >>> bool(np.mean(np.abs(y[200:] - found[200:]) < 1.96 * std[200:]) > 0.9)
        True

        A record that begins in motion:

        >>> known = np.where(np.arange(200) < 20, y[200:], np.nan)
        >>> late = model.predict(u[200:], y_start=known)
        >>> bool(np.abs(late - found[200:]).max() < 0.2)
        True
        """
        check_is_fitted(self)
        if return_std:
            self._require_noise()
        known = [] if y_start is None else [known_response(self, X, y_start)]
        slices, X = self.read_inputs(X)
        slices, X, *known, read = with_lost_rows(slices, X, *known)
        if known and read is not None:
            known[0][~read] = np.nan
        signal, schedules = self.operator_input(X, slices)
        known_runs = (
            self._runs_with_known_response(slices, signal, schedules, known[0]) if known else {}
        )
        if self.free_run_state == "rest" and not self.has_rest_ and len(known_runs) < len(slices):
            warnings.warn(
                f"{_NO_REST.format(type(self).__name__)}, from which this run starts.",
                ConvergenceWarning,
                stacklevel=2,
            )
        warn_gaps(self, self.operator_, slices, known_runs)
        linear = self.operator_.signal_linear
        warn_beyond(self, X, self.operator_.acting_columns, linear=linear)
        warn_schedules(self, self.operator_, schedules)
        y, rest = np.empty(len(signal)), [i for i in range(len(slices)) if i not in known_runs]
        if rest:
            from_rest = [slices[i] for i in rest]
            options = self.free_run_state, [schedules[i] for i in rest]
            rows = np.concatenate([np.arange(s.rows.start, s.rows.stop) for s in from_rest])
            y[rows] = run_records(self.operator_, signal, from_rest, *options)
        for number, known_run in known_runs.items():
            rows = slices[number].rows
            y[rows] = cut_off(known_run.run()[0])
            warn_of_unmatched_response(self, y[rows], known[0][rows])
        if not return_std:
            return y if read is None else y[read]
        variance = np.empty(len(y))
        for number, (s, schedule) in enumerate(zip(slices, schedules, strict=True)):
            start = self.operator_, self.covariance_, signal[s.rows], s.dt, self.free_run_state
            variance[s.rows] = known_runs.get(number, _Run(*start).at(schedule)).variance()
        std = np.sqrt(variance + self.noise_std_**2)
        return (y, std) if read is None else (y[read], std[read])

    def _require_noise(self):
        """Refuse a standard deviation if the covariance or the noise is not known."""
        if not self.records_ or getattr(self, "covariance_", None) is None:
            raise ValueError(
                f"The 'return_std' parameter of {type(self).__name__}.predict must be False for a "
                "model without the covariance of its parameters, which a fit to records with "
                "'fit' finds. Got True instead."
            )
        if self.noise_std_ is None:
            raise ValueError(
                f"The 'return_std' parameter of {type(self).__name__}.predict must be False for a "
                "model whose own noise is not known, as that of a part of a fitted composition or "
                "of predictions one step ahead. Got True instead."
            )

    def read_inputs(self, X):
        """Return the records of the inputs of a prediction, and the inputs as an array.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            As for :meth:`predict`.

        Returns
        -------
        slices : sequence of RecordSlice
            Rows and sampling interval of each record.
        X : ndarray of shape (n_samples, n_inputs)
            Validated.
        """
        return read_data(self, X, reset=False, bridge=True)[:2]

    def _runs_with_known_response(self, slices, signal, schedules, y):
        """Return the runs of the records with known response, by their numbers."""
        numbers = [i for i, s in enumerate(slices) if np.isfinite(y[s.rows]).any()]
        data = []
        for i in numbers:
            rows = slices[i].rows
            weights = np.isfinite(y[rows]).astype(float)
            response = np.where(weights > 0.0, y[rows], 0.0)
            options = {"schedule": schedules[i], "weights": weights}
            data.append(RecordData(signal[rows], response, slices[i].dt, **options))
        if not numbers:
            return {}
        # as stored by a fit; a part of a search's model has no range
        drives = np.concatenate([getattr(self, "drive_range_", ()), *(r.drive for r in data)])
        limits = drives.min(), drives.max()
        driven, additive = split_disturbances(self.operator_)
        parts = [r.first_part(1 + np.flatnonzero(r.weights)[-1]) for r in data]
        longest = max((s.n_samples for s in self.records_), default=0)
        if driven.n_start:  # start values count by their effect on as many samples as the fit had
            parts = [_prolonged(part, longest) for part in parts]
        response_range = np.ptp(getattr(self, "_response_range", y[np.isfinite(y)])) or 1.0
        covariance, noise = (getattr(self, name, None) for name in ("covariance_", "noise_std_"))
        noise = max(noise or 0.0, _LEAST_NOISE * response_range)
        options = {"oldest": longest // 2, "noise_std": noise, "response_range": response_range}
        input_history, _ = input_history_of(driven, additive, parts, limits, **options)
        runs = {}
        for i, record, part, before in zip(numbers, data, parts, input_history, strict=True):
            by_history = None
            if not (driven.n_start or part.weights[0]):
                before, by_history = self._needed(part, before, limits, noise)
            record, part = (record_with_history(driven, r, before) for r in (record, part))
            precision = start_precision(driven, part, limits, response_range)
            operator, own = calibrated(
                self.operator_, part, covariance, noise, precision, by_history
            )
            u, skip = record.with_history
            state = "rest" if record.start is None else record.start
            runs[i] = _Run(operator, own, u, record.dt, state, skip, record).at(record.schedule)
        return runs

    def _needed(self, record, before, limits, noise):
        """Return the input history that a record needs: the given one, or a rest.

        What is read in the middle of a record hardly depends on its beginning: a history then also
        fits the misfit of the model. So the readings must be ``1 / LEVEL`` times likelier with a
        history than from rest: with the residuals r of either in units of the noise, the
        derivatives S by the history, and the inverse P of its covariance before the readings, twice
        the logarithm of this Bayes factor is, for the most likely history h of a linear model,
        ``r_rest' r_rest - r' r - h' P h - log det(I + S' S / P)``. S is returned, too; None with a
        rest, about which it is another.
        """
        rest, errors = np.repeat(record.u[:1], len(before), axis=0), []
        driven, _ = split_disturbances(self.operator_)
        for history in (rest, before):
            begun = replace(record, before=history)
            u, skip = begun.with_history
            operator, _ = calibrated(self.operator_, begun)
            run = _Run(operator, None, u, record.dt, "rest", skip).at(record.schedule).run()[0]
            errors.append(np.sum(record.weights * np.square(run - record.y)))
        prior = noise**2 * start_precision(driven, begun, limits, np.inf)
        columns = OperatorProblem(driven, [begun]).history_sensitivities(driven, begun)
        move = (before - rest).ravel()
        gram = (columns.T * record.weights) @ columns
        gain = (errors[0] - errors[1] - move @ prior @ move) / noise**2
        free = np.ix_(*2 * (prior.diagonal() > 0.0,))  # not of an input that is constant
        volumes = [np.linalg.slogdet(matrix[free])[1] for matrix in (gram + prior, prior)]
        is_needed = gain - volumes[0] + volumes[1] > -2.0 * np.log(LEVEL)
        return (before, columns) if is_needed else (rest, None)

    def depends_on_interval(self, dt) -> bool:
        """Return whether the fitted model responds differently at another sampling interval.

        This is tested with a sweep over the range of the drive, as long as the longest record.

        Parameters
        ----------
        dt : float
            Sampling interval in s.

        Returns
        -------
        bool
        """
        n = max((record.n_samples for record in self.records_), default=1_000)
        low, high = getattr(self, "drive_range_", (-1.0, 1.0))
        # up to a quarter of the sampling rate
        sweep = low + 0.5 * (high - low) * (1.0 + np.sin(0.25 * np.pi * np.arange(n) ** 2 / n))
        X, runs = np.repeat(sweep[:, None], self.n_features_in_, axis=1), []
        for interval in (dt, fitted_interval(self)[0]):
            slices = (RecordSlice(0, slice(0, n), interval, 0.0, n),)
            signal, schedules = self.operator_input(X, slices)
            with warnings.catch_warnings():  # divergence is of no interest here
                warnings.simplefilter("ignore", DivergenceWarning)
                state = self.free_run_state
                runs.append(run_records(self.operator_, signal, slices, state, schedules))
        return not np.allclose(*runs)

    def resampled(self, dt) -> Self:
        """Return the fitted model at another sampling interval.

        Its parameters are those of continuous time: the response is the same for a drive with the
        same course between samples. Linear dynamics and a :class:`~skhyst.hysteresis.FreeMass` are
        exact at any interval; a model that is integrated in substeps keeps their length.

        Parameters
        ----------
        dt : float
            Sampling interval of the new model in s.

        Returns
        -------
        estimator
            Fitted; ``predict`` and ``stepper`` assume this interval for data without a time.

        Raises
        ------
        ValueError
            If ``dt`` is not a positive number, or there is no exact model at this interval.
        RecordError
            If the model depends on time and was fitted without one: its constants are in samples.

        Examples
        --------
        >>> import numpy as np
        >>> from skhyst.linear import FirstOrderLag, FirstOrderLagOperator
        >>> u = np.repeat(np.random.default_rng(0).normal(size=100), 2)
        >>> y, _ = FirstOrderLagOperator(0.05, hold="zoh").run(u, 0.01)
        >>> coarse = FirstOrderLag(hold="zoh", dt=0.02).fit(u[::2, None], y[::2])
        >>> bool(np.allclose(coarse.resampled(0.01).predict(u[:, None]), y))
        True
        """
        check_is_fitted(self)
        caller = f"{type(self).__name__}.resampled"
        dt = used_interval(self, valid_interval(dt, caller), caller)
        old_dt, operator = fitted_interval(self)[0] or self.dt, self.operator_
        operator_at_dt = resampled(operator, np.nan if old_dt is None else old_dt, dt)
        if operator_at_dt is None and (old_dt is None or self.depends_on_interval(dt)):
            wanted = "that of the fit: its response between samples is not exact"
            if old_dt is not None and hasattr(operator, "n_substeps"):
                step = old_dt / operator.n_substeps
                wanted = f"a multiple of {step:g} s, its integration step"
            raise ValueError(
                f"The 'dt' parameter of {caller} must be {wanted}. Got {dt:g} s instead: fit the "
                "model at this interval, or give X its times, which 'predict' follows."
            )
        operator_at_dt = operator if operator_at_dt is None else operator_at_dt
        new = with_params(
            self, operator_=operator_at_dt, dt_=dt, dt=None if self.dt is None else dt
        )
        new._records_dt = getattr(self, "_records_dt", fitted_interval(self)[0])
        return new

    def stepper_from(self, X, y, *, schedule=None) -> Stepper:
        """Return the fitted model as a device that continues from a known record.

        The input history of the record is estimated, as with ``y_start`` of :meth:`predict`.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            One record, as for :meth:`fit`.
        y : array-like of shape (n_samples,)
            Its response, NaN where unknown.
        schedule : float, default=None
            Value that scheduled parameters depend on from now on, such as the amplitude; by default
            that of the record.

        Returns
        -------
        Stepper
            Its next ``step(u)`` is the sample after the last one of X.

        Raises
        ------
        NotImplementedError
            If a part is not causal, such as a shift between two instruments.
        ValueError
            If X has several records.

        Examples
        --------
        >>> import numpy as np
        >>> from skhyst.linear import FirstOrderLag, FirstOrderLagOperator
        >>> u = np.random.default_rng(0).normal(size=300).cumsum()
        >>> y, _ = FirstOrderLagOperator(0.05).run(u, 0.01)
        >>> model = FirstOrderLag(dt=0.01).fit(u[:, None], y)
        >>> stepper = model.stepper_from(u[100:200, None], y[100:200])
        >>> bool(np.allclose(stepper.run(u[200:]), y[200:], rtol=0.01))
        True
        """
        check_is_fitted(self)
        y = known_response(self, X, y)
        slices, X = self.read_inputs(X)
        slices, X, y, read = with_lost_rows(slices, X, y)
        if read is not None:
            y[~read] = np.nan
        refuse_several(self, slices)
        signal, schedules = self.operator_input(X, slices)
        from_rest = _Run(self.operator_, None, signal, slices[0].dt, self.free_run_state)
        current = self._runs_with_known_response(slices, signal, schedules, y).get(
            0, from_rest.at(schedules[0])
        )
        response, state = current.run()
        warn_of_unmatched_response(self, response, y)
        if schedule is not None:
            schedule = finite_number(schedule, f"{type(self).__name__}.stepper_from", "schedule")
            warn_schedules(self, self.operator_, [schedule])
            current = current.at(schedule)
        return self._stepper(current.operator, current.dt, state)

    def stepper(self, dt=None, u0=0.0, initial_state=None, *, schedule=None) -> Stepper:
        """Return the fitted model as a device that is run sample by sample.

        Parameters
        ----------
        dt : float, default=None
            Sampling interval in s; by default that of the records of the fit.
        u0 : float or array-like of shape (n_inputs,), default=0.0
            Drive, with further columns if the model reads them, at which the device has rested.
        initial_state : {"rest", "zero"}, default=None
            State before the first sample; by default that of :meth:`predict`.
        schedule : float, default=None
            Value that scheduled parameters depend on, such as the amplitude.

        Returns
        -------
        Stepper
            ``step(u) -> y``, ``run(u)``, ``state``, ``copy()``.

        Raises
        ------
        NotImplementedError
            If a part is not causal, such as a shift between two instruments.
        ValueError
            If a parameter is invalid, or ``dt`` is not given and the records of the fit have
            different intervals.

        Examples
        --------
        >>> import numpy as np
        >>> from skhyst.linear import FirstOrderLag, FirstOrderLagOperator
        >>> u = np.random.default_rng(0).normal(size=200)
        >>> y, _ = FirstOrderLagOperator(0.05).run(u, 0.01)
        >>> model = FirstOrderLag(dt=0.01).fit(u[:, None], y)
        >>> stepper = model.stepper(u0=u[0])
        >>> bool(np.allclose([stepper.step(value) for value in u], model.predict(u[:, None])))
        True
        """
        check_is_fitted(self)
        caller, operator = f"{type(self).__name__}.stepper", self.operator_
        dt = used_interval(self, dt, caller)
        if schedule is not None:
            schedule = finite_number(schedule, caller, "schedule")
            warn_schedules(self, operator, [schedule])
            operator = operator.at(schedule)
        u0 = input_at_rest(self, u0, initial_state, caller)
        return self._stepper(operator, dt, operator.init(u0, initial_state or self.free_run_state))

    def _stepper(self, operator, dt, state):
        """Return a device that continues from a state of an operator."""
        step = operator.compiled_step(dt, state)
        return _device(operator, dt, state, input_signals(self, step.n_inputs), step)

    @property
    def free_run_state(self) -> str:
        """State before each record of a free run, "rest" or "zero"."""
        state = common_parameter(self, "initial_state")
        known = state == "zero" or (state == "estimate" and not self.has_rest_)
        return "zero" if known else "rest"


def _refuse_other_parts(tree):
    """Refuse a tree with an operator of another class than its model has."""
    model = tree.model  # that of a frozen part is a FrozenEstimator, which takes any operator
    kind = model.operator_class if isinstance(model, ParametricModel) else Operator
    if not isinstance(tree, kind):
        raise ValueError(
            f"The operator of {type(model).__name__} must be a {kind.__name__}. Got a "
            f"{type(tree).__name__} instead."
        )
    for part in tree.children:
        _refuse_other_parts(part)


def warn_of_unmatched_response(model, run, known, stacklevel=3):
    """Warn if a run of a model has little to do with a known response, as in another unit.

    Parameters
    ----------
    model : ParametricModel
        Fitted.
    run, known : ndarray of shape (n_samples,)
        The run from the best start, and the response, NaN where it is not known.
    stacklevel : int, default=3
        Of the warning.
    """
    given = np.isfinite(known)
    # about as many values are estimated: fewer samples do not suffice
    if np.count_nonzero(given) <= np.log2(len(known)) or not hasattr(model, "fit_error_"):
        return
    run, known = run[given], known[given]
    error = np.sqrt(np.mean(np.square(run - known)))
    # a constant predicts better, or the run in another unit does and differs by more than it moves
    moves = np.std(known)
    if _scaled_error(run, known) < np.sqrt(_MOST) * error:
        moves = min(moves, np.std(run))
    # and the error exceeds that of the fit in any part of it
    n_fitted = sum(record.n_samples for record in model.records_)
    largest = np.sqrt(n_fitted / len(known)) * model.fit_error_
    if error > max(largest, moves):
        warnings.warn(
            f"{type(model).__name__} does not follow the known response: the error is "
            f"{error:.3g}, that of the fit was {model.fit_error_:.3g}. Is it the same device, in "
            "the same units?",
            ConvergenceWarning,
            stacklevel=stacklevel,
        )


def _scaled_error(run, known):
    """Return the root mean square that a straight line over a run leaves of a response."""
    run, known = run - run.mean(), known - known.mean()
    power = run @ run
    slope = run @ known / power if power > 0.0 else 0.0
    return np.sqrt(np.mean(np.square(known - slope * run)))


def warn_gaps(model, operator, slices, going=()):
    """Warn of missing rows within a record, after which the initial state is not known.

    ``going`` has the numbers of the records that start from a known response.
    """
    if operator.memoryless:
        return
    behind = [number for number in behind_gaps(slices) if number not in going]
    if behind:
        first = slices[behind[0]].rows.start
        warnings.warn(
            f"Rows are missing before row {first}, and before {len(behind)} row(s) in all: "
            f"{type(model).__name__} starts there as at the beginning of a record. Give the drive "
            "of these rows, or some response behind them by 'y_start'.",
            ConvergenceWarning,
            stacklevel=3,
        )


def _with_movable_positions(tree):
    """Return a tree in which the positions that its models fit are parameters, or the same tree."""
    if tree.resolution is not None:
        moves = isinstance(tree.model, ParametricModel) and tree.model.moves_positions
        return MovableOperator.around(tree, np.inf) if moves else tree
    if not isinstance(tree, Series | SumOperator):
        return tree
    return tree.with_stages([_with_movable_positions(stage) for stage in tree.stages])


def _prolonged(record, n):
    """Return a record of at least n samples, at a constant input and without a response."""
    more = max(n - len(record.u), 0)
    u = np.concatenate([record.u, np.repeat(record.u[-1:], more, axis=0)])
    y, weights = np.pad(record.y, (0, more)), np.pad(record.weights, (0, more))
    return replace(record, u=u, y=y, weights=weights, segments=())


def _has_other_memory(operator):
    """Whether a part with a state of rest depends on the drive before a record."""
    if not operator.n_start:
        return not operator.memoryless
    return any(map(_has_other_memory, operator.children))


def behind_gaps(slices):
    """Return the numbers of the slices that continue a record after missing rows."""
    numbered = enumerate(pairwise(slices), start=1)
    return [number for number, (before, record) in numbered if before.label == record.label]


def _better_slope(drives, result, records):
    """Return the covariance of drive and response if a straight line predicts clearly better.

    Zero otherwise. Its sign is that of the line's slope. Clearly: the line leaves less than half of
    the power of the response, and less than half of the squared error of the model.
    """
    counts = np.concatenate([record.counts() for record in records])
    y = np.concatenate([record.y for record in records])
    counts, y, drives = (values[counts > 0.0] for values in (counts, y, drives))
    if not (np.ptp(y) > 0.0 and np.ptp(drives) > 0.0):
        return 0.0
    normalised = y / np.ptp(y), drives / np.ptp(drives)
    (power, product), (_, drive_power) = np.cov(*normalised, ddof=0, aweights=counts)
    error = (result.error / np.ptp(y)) ** 2
    residual_power = max(power - product**2 / drive_power, NOISELESS * power)
    return product if residual_power < _MOST * min(power, error) else 0.0


def _device(operator, dt, state, inputs, step=None):
    """Return a stepper that is pickled as its operator, since compiled code cannot be pickled."""
    return Stepper(
        operator.compiled_step(dt, state) if step is None else step,
        dt,
        inputs=inputs,
        result=Signal("response"),
        remake=partial(_device, operator, dt, state, inputs),
    )


def _is_constant(operator):
    """Whether all numbered weights of a gain-owning operator are zero."""
    weights = [
        value
        for (name, spec), value in zip(operator.entries(), operator.pack(), strict=True)
        if name.endswith("]") and spec.linear and 0.0 in (spec.lower, spec.upper)
    ]
    return operator.owns_gain and len(weights) > 0 and not any(weights)
