"""Common modes of several inputs and responses: one sampled state space for all of them."""

import warnings
from abc import ABC, abstractmethod
from copy import copy
from dataclasses import dataclass
from functools import partial
from numbers import Integral, Real
from typing import Self

import numpy as np
from scipy.optimize import least_squares
from sklearn.base import BaseEstimator, MultiOutputMixin
from sklearn.utils.validation import check_is_fitted

from .._signals import input_signals
from .._sklearn import Interval, StrOptions, fit_context
from .._validation import (
    ScoredMixin,
    as_floats,
    known_response,
    read_slices,
    refuse_extreme,
    refuse_several,
    refuse_std,
    rest_input,
    store_drive_range,
    warn_beyond,
)
from ..base import one_thread
from ..exceptions import ConvergenceWarning
from ..operators import (
    CompiledColumn,
    CompiledLaw,
    CompiledSum,
    Signal,
    Stepper,
    cut_off,
    state_space_step,
)
from ..optimize import (
    ModalProblem,
    RationalBlock,
    modal_start,
    rational_residues,
    variable_projection,
    vector_fit,
    warp,
)
from ..records import valid_interval, with_lost_rows
from ._linear import complex_gain
from ._modes import ModesMixin, section_poles
from ._periodic import find_period, period_spectra
from ._transfer_function import state_space_run_many

_EXCITED = 1e-3  # smallest amplitude of an excited line, relative to the largest


class SampledSystem(ABC):
    """Base of systems that run at the interval at which they were sampled, ``dt``.

    A subclass has ``init``, ``step`` and ``run`` as operators have, but for inputs (n_samples,
    n_inputs) and responses (n_samples, n_outputs), with an ``intercept`` of each. It cannot be part
    of a composition, whose parts pass on one signal each, at any interval.
    """

    @abstractmethod
    def init(self, u0, initial_state="rest"):
        """Return the state before the first sample.

        Parameters
        ----------
        u0 : array-like of shape (n_inputs,)
            Inputs at the first sample.
        initial_state : {"rest", "zero"}, default="rest"
            At rest at ``u0``, or zero.

        Returns
        -------
        object
            The state.
        """

    @abstractmethod
    def run(self, u, dt, state=None):
        """Map the inputs to the responses.

        Parameters
        ----------
        u : array-like of shape (n_samples, n_inputs)
            Inputs.
        dt : float
            Sampling interval in s.
        state : object, default=None
            State before; None: at rest at the first inputs.

        Returns
        -------
        y : ndarray of shape (n_samples, n_outputs)
            Responses.
        state : object
            State behind the last sample.

        Raises
        ------
        ValueError
            If ``dt`` is not the sampling interval of the system.
        """

    def refuse_other(self, dt):
        """Refuse another sampling interval.

        Parameters
        ----------
        dt : float
            Sampling interval in s.

        Raises
        ------
        ValueError
            If it is not that of the system.
        """
        if abs(dt - self.dt) > 1e-3 * self.dt:
            raise ValueError(
                f"The system is sampled every {self.dt:g} s and runs at no other interval. Got "
                f"dt = {dt:g} s instead."
            )

    def step(self, state, u, dt):
        """Advance by one sample.

        Parameters
        ----------
        state : object
            As :meth:`init` returns it.
        u : array-like of shape (n_inputs,)
            Inputs at the sample.
        dt : float
            Sampling interval in s.

        Returns
        -------
        state : object
            State behind the sample.
        y : ndarray of shape (n_outputs,)
            Responses.
        """
        y, state = self.run(np.asarray(u, dtype=float)[None], dt, state)
        return state, y[0]

    @abstractmethod
    def compiled_step(self, dt, state):
        """Return the compiled step, see :class:`~skhyst.operators.Operator`.

        Parameters
        ----------
        dt : float
            Sampling interval in s.
        state : object
            As :meth:`init` returns it.

        Returns
        -------
        CompiledLaw
            The step.

        Raises
        ------
        NotImplementedError
            If there are several responses: a step returns one number.
        """

    def refuse_several(self):
        """Refuse several responses where a step returns one number.

        Raises
        ------
        NotImplementedError
            If there are several.
        """
        if len(self.intercept) > 1:
            raise NotImplementedError(
                f"A model of {len(self.intercept)} responses cannot be stepped: a step returns one "
                "number. Fit each response alone."
            )


@dataclass(frozen=True)
class SampledStateSpace(SampledSystem):
    """Sampled state space: ``x[k+1] = a x[k] + b u[k]``, ``y[k] = c x[k] + d u[k] + intercept``.

    The state before a sample is ``x`` (n_states,) and the last inputs (n_inputs,).

    Parameters
    ----------
    a : ndarray of shape (n_states, n_states)
        From a state to the next.
    b : ndarray of shape (n_states, n_inputs)
        From the inputs to the next state.
    c : ndarray of shape (n_outputs, n_states)
        From the state to the responses.
    d : ndarray of shape (n_outputs, n_inputs)
        From the inputs to the responses of the same sample.
    dt : float
        Sampling interval in s.
    intercept : ndarray of shape (n_outputs,)
        Units of the responses.

    See Also
    --------
    ModalModel : Identifies one.
    TransferFunctionOperator : A linear model in continuous time.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import SampledStateSpace
    >>> one = np.ones((1, 1))
    >>> system = SampledStateSpace(0.5 * one, one, 0.5 * one, 0.0 * one, 0.1, np.zeros(1))
    >>> system.run([[0.0], [1.0], [1.0]], dt=0.1)[0].ravel()
    array([0.  , 0.  , 0.5])
    """

    signal_linear = True

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: np.ndarray
    dt: float
    intercept: np.ndarray

    @property
    def n_inputs(self):
        """Number of inputs."""
        return self.b.shape[1]

    def init(self, u0, initial_state="rest"):
        u0 = np.atleast_1d(np.asarray(u0, dtype=float))
        if initial_state == "zero":
            return np.zeros(len(self.a)), np.zeros(len(u0))
        return np.linalg.solve(np.eye(len(self.a)) - self.a, self.b @ u0), u0

    def run(self, u, dt, state=None):
        self.refuse_other(dt)
        u = np.ascontiguousarray(u, dtype=float)
        x, previous = self.init(u[0]) if state is None else state
        y, x = state_space_run_many(self.a, self.b, 0.0 * self.b, self.c, self.d, u, x, previous)
        return y + self.intercept, (x, u[-1].copy())

    def compiled_step(self, dt, state):
        self.refuse_several()
        self.refuse_other(dt)
        x, previous = state
        steps = []
        for i in range(self.b.shape[1]):  # responses add up, so the first can carry the whole state
            start, intercept = (x, self.intercept[0]) if i == 0 else (0.0 * x, 0.0)
            b = self.b[:, i]
            constants = self.a, b, 0.0 * b, self.c[0], self.d[0, i], intercept
            steps.append(CompiledLaw(state_space_step, constants, [*start, previous[i], *start]))
        if len(steps) == 1:
            return steps[0]
        return CompiledSum(tuple(CompiledColumn((s,), i, 0.0) for i, s in enumerate(steps)))

    def poles(self):
        """Return the poles in the z-plane, complex, shape (n_states,)."""
        return np.linalg.eigvals(self.a)

    def frequency_response(self, frequency):
        """Return the complex gains.

        Parameters
        ----------
        frequency : ndarray of shape (n,)
            Hz.

        Returns
        -------
        ndarray of shape (n, n_outputs, n_inputs)
            From each input to each response.
        """
        z = np.exp(2j * np.pi * self.dt * np.asarray(frequency, dtype=float))
        return complex_gain(self.a, self.b, self.c, self.d, z)


class ModalModel(ModesMixin, MultiOutputMixin, ScoredMixin, BaseEstimator):
    r"""Linear dynamics of several inputs and responses with common modes.

    .. math:: Y(z) = \Bigl(D + \sum_r \frac{c_r b_r^T}{z - z_r}\Bigr) U(z)

    Each pole (or conjugate pair) has one vector :math:`b_r` of participation factors and one shape
    :math:`c_r`, like a mode of a structure: as many states as poles, for any number of inputs and
    responses. Several :class:`TransferFunction` would need as many poles each.

    The model describes the *sampled* device, including the hold of its inputs, of any kind.
    Records with periodic inputs in steady state (at least as many different records as inputs)
    are fitted at the excited lines, without leakage; all others by the Fourier transforms of the
    complete records [3]_, with the initial state of every record as an unknown. Vector fitting
    [1]_ gives a partial-fraction expansion with residues of full rank, balanced truncation [2]_
    reduces it to ``n_poles`` states, and separable least squares with exact derivatives refines
    these.

    Parameters
    ----------
    n_poles : int, default=4
        Number of states.
    fit_intercept : bool, default=True
        Whether a constant is added to each response.
    transient_periods : int, default=1
        Periods at the start of each record that are dropped where the inputs are periodic.
    initial_state : {"rest", "zero"}, default="rest"
        State before each record's first sample in :meth:`predict`.
    tolerance : float, default=1e-6
        Relative change of the sum of squares at which the least-squares fit stops.
    max_evaluations : int, default=60
        Largest number of evaluations; if they do not suffice, there is a
        :class:`~skhyst.exceptions.ConvergenceWarning`.
    dt : float or None, default=None
        Sampling interval in s of data without a time index.

    Attributes
    ----------
    operator_ : SampledStateSpace
        ``a``, ``b``, ``c``, ``d``, ``intercept``; ``init``, ``step`` and ``run``.
    poles_ : ndarray of shape (n_poles,), complex
        rad/s: logarithms of the poles in the z-plane, divided by the interval. Their standard
        errors assume that the residual is white.
    covariance_ : ndarray of shape (n_entries, n_entries)
        Of the entries of ``a`` that are not zero, by rows, and of ``b``, ``c``, ``d`` and the
        intercept. It assumes that the residual is white.
    noise_std_ : ndarray of shape (n_outputs,)
        Standard deviation of the residual, units of the responses.
    n_evaluations_ : int
    records_ : tuple of RecordSlice
    drive_range_ : tuple of (float, float)
        Smallest and largest drive (column 0 of X) in the fit, units of the drive.
    drive_rate_ : float
        Fastest change of the drive between two samples in the fit, units of the drive per s.
    input_range_ : ndarray of shape (2, n_inputs)
        Smallest and largest value of each input in the fit, its units.

    Raises
    ------
    ValueError
        If no record has 3 samples.

    See Also
    --------
    TransferFunction : One response, each input with zeros of its own.
    SecondOrderMode : A single mode.

    References
    ----------
    .. [1] Gustavsen and Semlyen, *IEEE Transactions on Power Delivery*, 1999.
    .. [2] Moore, *IEEE Transactions on Automatic Control*, 1981.
    .. [3] Pintelon and Schoukens, *System Identification*, 2012, section 6.3 (records that are not
       periodic).

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import ModalModel, SecondOrderModeOperator
    >>> X = np.random.default_rng(0).normal(size=(400, 2))
    >>> mode, _ = SecondOrderModeOperator(60.0, 0.05).run(X @ [1.0, 0.5], 0.01)
    >>> model = ModalModel(n_poles=2, dt=0.01).fit(X, np.stack([mode, -2.0 * mode], axis=1))
    >>> model.poles_table().round(3)[["frequency", "damping_ratio"]]
       frequency  damping_ratio
    0      9.549           0.05
    """

    _parameter_constraints = {
        "n_poles": [Interval(Integral, 1, None, closed="left")],
        "fit_intercept": ["boolean"],
        "transient_periods": [Interval(Integral, 0, None, closed="left")],
        "initial_state": [StrOptions({"rest", "zero"})],
        "tolerance": [Interval(Real, 0, None, closed="left")],
        "max_evaluations": [Interval(Integral, 1, None, closed="left")],
        "dt": [Interval(Real, 0, None, closed="neither"), None],
    }

    def __init__(
        self,
        n_poles=4,
        *,
        fit_intercept=True,
        transient_periods=1,
        initial_state="rest",
        tolerance=1e-6,
        max_evaluations=60,
        dt=None,
    ):
        self.n_poles = n_poles
        self.fit_intercept = fit_intercept
        self.transient_periods = transient_periods
        self.initial_state = initial_state
        self.tolerance = tolerance
        self.max_evaluations = max_evaluations
        self.dt = dt

    @fit_context(prefer_skip_nested_validation=True)
    def fit(self, X, y) -> Self:
        """Identify the model.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            All columns are inputs; the index carries records and time.
        y : array-like of shape (n_samples, n_outputs) or (n_samples,)
            Responses.

        Returns
        -------
        self
        """
        self._warn_unless_converged(self._fit_linear(*self._read(X, y)), "ModalModel")
        return self

    def _read(self, X, y):
        """Return the records without gaps, their inputs and their responses."""
        array, response = as_floats(self, X, y, multi_output=True, ensure_min_samples=2)
        refuse_extreme(array, response)
        self._one_response = response.ndim == 1
        response = response.reshape(len(array), -1)
        self.records_ = slices = read_slices(self, X, y, reset=True, bridge=True)
        store_drive_range(self, array[:, 0], slices)
        self.input_range_ = np.array([array.min(axis=0), array.max(axis=0)])
        return with_lost_rows(slices, array, response)[:3]

    def _fit_linear(self, slices, array, response):
        """Identify and store the linear system; return the solution."""
        dt, scales = slices[0].dt, (_size(array), _size(response))
        records = [(array[s.rows] / scales[0], response[s.rows] / scales[1]) for s in slices]
        with one_thread():
            problem = self._problem(records, dt)
            limits = {"tolerance": self.tolerance, "max_evaluations": self.max_evaluations}
            solution = variable_projection(problem, problem.x0, **limits)
        self.n_evaluations_ = self.n_iter_ = solution.n_evaluations
        self._store(problem, solution, dt, scales, self.fit_intercept * array.mean(axis=0))
        self._store_constants(slices, array, response, scales[1])
        return solution

    def _warn_unless_converged(self, solution, name):
        if not solution.converged:
            warnings.warn(
                f"The fit of {name} has not converged in 'max_evaluations' = "
                f"{self.max_evaluations} evaluations; the best fit so far is returned.",
                ConvergenceWarning,
                stacklevel=4,
            )

    def _problem(self, records, dt):
        """Return the least-squares problem, started from vector fitting and truncation."""
        lines = _periodic_lines(records, dt, self.transient_periods)
        periodic = lines is not None
        s, drives, responses = lines if periodic else _record_lines(records, dt)
        n_columns, n_outputs = drives.shape[-1], responses.shape[-1]
        n_lines = responses.size // n_outputs
        if not n_lines:
            raise ValueError(
                "ModalModel needs a record of at least 3 samples. Got "
                f"{max(len(u) for u, _ in records)} in the longest instead."
            )
        n_unknowns = self.n_poles * (n_columns + n_outputs) + n_columns * n_outputs
        if 2 * responses.size <= n_unknowns:
            warnings.warn(
                f"The data do not determine ModalModel with 'n_poles' = {self.n_poles}: "
                f"{n_unknowns} unknowns for {2 * responses.size} real data.",
                ConvergenceWarning,
                stacklevel=5,
            )
        blocks = (_response_blocks if periodic else _record_blocks)(drives, responses)
        poles, _ = vector_fit(s, blocks, self.n_poles)
        coefficients, _ = rational_residues(s, blocks, poles)
        residues = np.stack([coefficient[:-1] for coefficient in coefficients], axis=1)
        if periodic:
            residues = residues.reshape(self.n_poles, n_outputs, n_columns)
            s = np.repeat(s, drives.shape[1])
            drives, responses = drives.reshape(-1, n_columns), responses.reshape(-1, n_outputs)
        parts, b = modal_start(poles, residues, self.n_poles)
        return ModalProblem(s, drives, responses, np.ones(responses.shape), parts, b)

    def _store(self, problem, solution, dt, scales, mean):
        """Store the fitted system without intercept, its modes, and their covariances."""
        x, covariance = solution.x, problem.covariance(solution)
        *system, _ = _sampled(problem, x, dt, scales, mean)
        self.operator_ = SampledStateSpace(*system, dt, np.zeros(problem.n_outputs))
        # derivatives by complex steps, which are exact to rounding
        steps = x + 1e-30j * np.eye(len(x))
        changed = [_sampled(problem, step, dt, scales, mean) for step in steps]
        by = [np.concatenate([a[system[0] != 0.0], *map(np.ravel, rest)]) for a, *rest in changed]
        by = 1e30 * np.imag(by)
        self.covariance_ = by.T @ covariance @ by
        poles, by = section_poles(*problem.split(x)[0])
        slope = 1.0 - (0.5 * dt * poles) ** 2  # reciprocal of the derivative of `warp`
        by = by / np.where(slope == 0.0, 1.0, slope)[:, None]
        k = problem.n_poles
        with np.errstate(over="ignore", invalid="ignore"):  # of poles that are not determined
            spread = covariance[:k, :k] * np.outer(*[np.exp(x[:k])] * 2)
        self._set_modes(warp(poles, dt), by, spread)

    def _store_constants(self, slices, array, response, size):
        """Store intercept and noise, of the residual without the decay of earlier states."""
        system, parts = self.operator_, []
        n, n_outputs = len(system.a), len(system.c)
        for s in slices:
            u, rows = array[s.rows], response[s.rows]
            residual = (rows - system.run(u, s.dt)[0]) / size
            runs = [system.run(0.0 * u, s.dt, (one, 0.0 * u[0]))[0] / size for one in np.eye(n)]
            fading, _ = np.linalg.qr(np.reshape(runs, (n, -1)).T)
            constants = np.tile(np.eye(n_outputs), (len(u), 1))
            columns = np.column_stack([residual.ravel(), constants])
            parts.append(columns - fading @ (fading.T @ columns))
        left, constants = np.split(np.vstack(parts), [1], axis=1)
        if self.fit_intercept:
            intercept = np.linalg.lstsq(constants, left[:, 0], rcond=None)[0]
            system.intercept[:] = size * intercept
            left[:, 0] -= constants @ intercept
        left = left[:, 0].reshape(-1, n_outputs)
        # poles, participations and shapes, less what these can exchange, and each start
        m = system.b.shape[1]
        unknowns = n * (m + n_outputs + len(slices)) + (m + self.fit_intercept) * n_outputs
        freedom = max(1.0 - unknowns / left.size, np.finfo(float).eps)
        self.noise_std_ = size * np.sqrt(np.mean(np.square(left), axis=0) / freedom)
        if self.fit_intercept:
            at = np.arange(-n_outputs, 0)
            self.covariance_[at, at] += self.noise_std_**2 / len(left)

    def _variance(self, u):
        """Return the variance of the free run by the errors of the parameters.

        The tangent of a linear system by a parameter is a linear system of the same inputs.
        """
        system, variance = self.operator_, 0.0
        values, vectors = np.linalg.eigh(self.covariance_)
        arrays = system.b, system.c, system.d, system.intercept
        edges = np.cumsum([np.count_nonzero(system.a), *(part.size for part in arrays[:-1])])
        for size, vector in zip(values, vectors.T, strict=True):
            if size > 0.0:
                entries, *rest = np.split(np.sqrt(size) * vector, edges)
                a = np.zeros_like(system.a)
                a[system.a != 0.0] = entries
                b, c, d, constant = (
                    part.reshape(own.shape) for part, own in zip(rest, arrays, strict=True)
                )
                tangent = SampledStateSpace(
                    np.block([[system.a, 0.0 * a], [a, system.a]]),
                    np.vstack([system.b, b]),
                    np.hstack([c, system.c]),
                    d,
                    system.dt,
                    constant,
                )
                state = tangent.init(u[0], self.initial_state)
                variance += tangent.run(u, system.dt, state)[0] ** 2
        return variance

    def predict(self, X, y_start=None, return_std=False):
        """Return the free run: the responses to the inputs alone, each record from its own start.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            Sampled at the interval of the fit.
        y_start : array-like of shape (n_samples, n_outputs) or (n_samples,), default=None
            Known responses, such as in the first part of a record that begins in motion, NaN
            elsewhere. The state at the first sample is estimated from them. A record without known
            responses begins at ``initial_state``, as all do by default.
        return_std : bool, default=False
            Whether to return the standard deviation of the prediction of a new sample, too, by the
            errors of the parameters and the noise, both white.

        Returns
        -------
        y : ndarray of shape (n_samples, n_outputs), or (n_samples,) where ``y`` of ``fit`` was 1-D
        std : ndarray of that shape
            Only with ``return_std``.

        Raises
        ------
        ValueError
            If the sampling interval is not that of the fit, or a standard deviation is not known:
            that of an estimated start is not.

        Warns
        -----
        ConvergenceWarning
            If a record has fewer known values than the model has states: then the start is the
            nearest to ``initial_state`` that explains them.
        """
        check_is_fitted(self)
        if y_start is not None:
            refuse_std(self, return_std, "whose start is estimated")
        slices, array, known, read = self._read_known(X, y_start)
        columns = set(range(array.shape[1]))
        warn_beyond(self, array, columns, linear=self.operator_.signal_linear)
        parts = []
        with np.errstate(over="ignore", invalid="ignore"):  # divergence is reported below
            for s in slices:
                state = self._start_state(array[s.rows], known[s.rows])
                parts.append(self.operator_.run(array[s.rows], s.dt, state)[0])
        found = [cut_off(np.concatenate(parts))]
        if return_std:
            variance = np.concatenate([self._variance(array[s.rows]) for s in slices])
            found.append(np.sqrt(variance + self.noise_std_**2))
        found = [y if read is None else y[read] for y in found]
        found = [y[:, 0] if self._one_response else y for y in found]
        return tuple(found) if return_std else found[0]

    def _read_known(self, X, y):
        """Return the records, their inputs and known responses, and the rows that X has."""
        array, n_outputs = as_floats(self, X, reset=False), len(self.operator_.intercept)
        known = np.full((len(array), n_outputs), np.nan)
        if y is not None:
            known = known_response(self, X, y, one=False).reshape(len(array), -1)
        if known.shape[1] != n_outputs:
            raise ValueError(
                f"The known responses of {type(self).__name__} must have {n_outputs} column(s), as "
                f"in the fit. Got {known.shape[1]} instead."
            )
        slices = read_slices(self, X, reset=False, bridge=True)
        slices, array, known, read = with_lost_rows(slices, array, known)
        if read is not None:
            known[~read] = np.nan
        return slices, array, known, read

    def _start_state(self, u, known):
        """Return the state at the first sample from which the run fits the known responses best."""
        state = self.operator_.init(u[0], self.initial_state)
        is_known = np.isfinite(known)
        if not is_known.any():
            return state
        end = np.flatnonzero(is_known.any(axis=1))[-1] + 1
        u, known, is_known = u[:end], known[:end], is_known[:end]
        start = state if isinstance(state, np.ndarray) else state[0]
        if is_known.sum() < len(start):
            warnings.warn(
                f"The start of a record is not determined: {is_known.sum()} known responses for "
                f"{len(start)} states.",
                ConvergenceWarning,
                stacklevel=4,
            )

        def misfit(x):
            run, _ = self.operator_.run(u, self.operator_.dt, self._state(x, u[0]))
            return (run - known)[is_known] / size

        high = np.where(is_known, known, -np.inf).max(axis=0)
        spans = high - np.where(is_known, known, np.inf).min(axis=0)
        size = np.broadcast_to(np.where(spans > 0.0, spans, 1.0), known.shape)[is_known]
        found = least_squares(misfit, start, x_scale="jac", method="trf")
        return self._state(found.x, u[0])

    def _state(self, x, u0):
        return x, u0

    def stepper_from(self, X, y) -> Stepper:
        """Return the fitted model as a device that continues from a known record.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            One record.
        y : array-like of shape (n_samples,)
            Its response, NaN where unknown, from which the start is estimated as in
            :meth:`predict`.

        Returns
        -------
        Stepper
            Its next ``step(u)`` is the sample after the last one of X.

        Raises
        ------
        NotImplementedError
            If there are several responses: a step returns one number.
        ValueError
            If X has several records.
        """
        check_is_fitted(self)
        slices, array, known, _ = self._read_known(X, y)
        refuse_several(self, slices)
        _, state = self.operator_.run(array, slices[0].dt, self._start_state(array, known))
        return self._stepper(slices[0].dt, state)

    def stepper(self, dt=None, u0=0.0, initial_state=None) -> Stepper:
        """Return the fitted model as a simulated device that is stepped sample by sample.

        Parameters
        ----------
        dt : float, default=None
            Sampling interval in s; it must be that of the fit, which is the default.
        u0 : float or array-like of shape (n_inputs,), default=0.0
            Inputs at which the device is at rest before the first sample.
        initial_state : {"rest", "zero"}, default=None
            State before the first sample; by default that of :meth:`predict`.

        Returns
        -------
        Stepper
            ``step(u) -> y``, ``run(u)``, ``state``, ``copy()``.

        Raises
        ------
        NotImplementedError
            If there are several responses: a step returns one number.
        ValueError
            If a parameter is not as above, or ``dt`` is not that of the fit.
        """
        check_is_fitted(self)
        caller = f"{type(self).__name__}.stepper"
        dt = self.operator_.dt if dt is None else valid_interval(dt, caller)
        u0 = rest_input(u0, initial_state, self.n_features_in_, caller)
        return self._stepper(dt, self.operator_.init(u0, initial_state or self.initial_state))

    def _stepper(self, dt, state):
        """Return a device that continues from a state."""
        step = self.operator_.compiled_step(dt, state)
        again = partial(copy(self)._stepper, dt, state)
        inputs = input_signals(self, step.n_inputs)
        return Stepper(step, dt, inputs=inputs, result=Signal("response"), remake=again)

    def __sklearn_tags__(self):
        tags = super().__sklearn_tags__()
        tags.regressor_tags.poor_score = True  # on data that no linear dynamic system has produced
        return tags


def _sampled(problem, x, dt, scales, mean):
    """Return a, b, c, d in terms of z and of the units of X and y, and an intercept.

    It was fitted in terms of Tustin's variable, ``s = (2 / dt) (z - 1) / (z + 1)``, and scaled.
    With the intercept, the response to the mean input is zero.
    """
    parts, b, c, d = problem.split(x)
    n_inputs, half = len(scales[0]), 0.5 * dt
    a = problem.matrix(parts)
    eye = np.eye(len(a))
    inverse = np.linalg.inv(eye - half * a)
    stepped = inverse @ (eye + half * a)
    b, d = b[:, :n_inputs], d[:, :n_inputs]
    d = scales[1][:, None] * (d + half * c @ inverse @ b) / scales[0]
    b = half * (eye + stepped) @ inverse @ b / scales[0]
    c = np.ascontiguousarray(scales[1][:, None] * c)
    gain = d + c @ np.linalg.solve(eye - stepped, b)
    return stepped, b, c, d, -gain @ mean


def _size(values):
    """Return the standard deviation of each column, 1 for a constant column."""
    size = values.std(axis=0)
    return np.where(size > 0.0, size, 1.0)


def _periodic_lines(records, dt, transient_periods):
    """Return s, drives and responses of periodic records at the excited lines, or None.

    Drives and responses are (n_lines, n_inputs, ...): at each line the equations ``Y = G U`` of all
    records are reduced to ``n_inputs`` by the orthogonal factor of U, which leaves their
    least-squares solution unchanged.
    """
    n_inputs = records[0][0].shape[1]
    period = find_period([u for u, _ in records]) if len(records) >= n_inputs else None
    if period is None or min(len(u) for u, _ in records) < (transient_periods + 1) * period:
        return None
    spectra = period_spectra(records, period, transient_periods)
    drives, responses = (
        np.stack([part.mean(axis=0) for part in parts], axis=1) / np.sqrt(period)
        for parts in zip(*spectra, strict=True)
    )
    if not len(drives):  # a period of two samples has no line below half the sampling rate
        return None
    strength = np.linalg.svd(drives, compute_uv=False)
    excited = strength[:, -1] > _EXCITED * strength[:, 0].max()
    if not excited.any():
        return None
    q, r = np.linalg.qr(drives[excited])
    # Tustin's variable, which is rational in z: the fit is that of a continuous-time system
    s = 2j / dt * np.tan(np.pi * (1 + np.flatnonzero(excited)) / period)
    return s, r, q.conj().transpose(0, 2, 1) @ responses[excited]


def _record_lines(records, dt):
    """Return s, drives and responses of records that are not periodic.

    The last drives are unit pulses, one per record: the response to a pulse is that to the record's
    unknown initial state.
    """
    s, drives, responses = [], [], []
    for number, (u, y) in enumerate(records):
        n = len(u)
        k = np.arange(1, (n + 1) // 2)
        pulses = np.zeros((len(k), len(records)))
        pulses[:, number] = 1.0
        s.append(2j / dt * np.tan(np.pi * k / n))
        drives.append(np.hstack([np.fft.rfft(u - u[0], axis=0)[k] / np.sqrt(n), pulses]))
        responses.append(np.fft.rfft(y - y[0], axis=0)[k] / np.sqrt(n))
    return tuple(np.concatenate(parts) for parts in (s, drives, responses))


def _record_blocks(drives, responses):
    """Return one block per response, as a function of all drives."""
    return [RationalBlock(target, drives, np.ones(len(drives))) for target in responses.T]


def _response_blocks(drives, responses):
    """Return one block per element of the frequency response, outputs first, weighted by drives."""
    g = np.linalg.solve(drives, responses)
    size = np.linalg.norm(drives, axis=1)
    one = np.ones((len(g), 1))
    return [
        RationalBlock(g[:, i, o], one, size[:, i])
        for o in range(g.shape[2])
        for i in range(g.shape[1])
    ]
