r"""Detection of changes of an identified device, and isolation of what has changed.

As long as the device behaves like its model, the innovations of an observer are noise. If this
noise is coloured in the records of the fit, it is assumed to be so in service: the whitening filter
follows from the autocovariance of these innovations. Sensitivities are finite differences between
observers of models with one parameter changed a little, through the same filter. The tests on both,
and their rate of false alarms, are in :mod:`skhyst.control._local_tests`; which parameter has
changed is found in :mod:`skhyst.control._suspects`.

The misfit of a model is known from the records of the fit, for drives like theirs. Blocks in which
the drive leaves their range or exceeds their rate are not judged.
"""

from copy import copy
from numbers import Integral, Real
from typing import Self

import numpy as np
from scipy.signal import lfilter
from sklearn.base import BaseEstimator, MetaEstimatorMixin
from sklearn.utils.validation import check_is_fitted

from .._sklearn import HasMethods, Interval, fit_context
from .._validation import interval_of
from ..base import read_data, with_params
from ..noise import whitening_filter
from ..operators import add_disturbances, split_disturbances
from ._local_tests import LocalTests
from ._observer import Running
from ._suspects import likely, smallest_squares, squares_after_step

_EXACT = 1e-12  # rounding error of a run, as a fraction of the response
_STEP = np.sqrt(_EXACT)  # relative step of differences: errors of rounding and curvature balance
_AT_ONCE = 1 << 15  # samples that are processed at once
# Fraction of the range by which a drive may exceed it: a turning point between two of 22 samples
# of a period is missed by 1 - cos(pi / 22).
_BETWEEN = 0.01


class Monitor(Running, MetaEstimatorMixin, BaseEstimator):
    """Detect when a device in service no longer agrees with its model, and what has changed.

    Parameters
    ----------
    observer : Observer
        Observer of the identified model.
    false_alarms : float, default=1e-6
        Upper bound of the mean number of alarms per sample while nothing has changed.
    block : int, default=64
        Number of samples after which each decision is made: about this block, and about the last 2,
        4, 8, ... blocks, up to as many samples as in the fit. Over longer sums the uncertainty of
        the fit prevails.
    parameters : sequence of str, default=None
        Names of the parameters that may change, as in ``params_`` of the model; by default all
        parameters of the driven part to which the records of the fit are sensitive.

    Attributes
    ----------
    observer_ : Observer
        The fitted observer.
    parameters_ : list of str
        Names of the monitored parameters.
    whitening_ : ndarray of shape (order + 1,)
        Autoregressive filter that makes the innovations of the fit white.
    drift_detected : bool
        Whether the last :meth:`update` has raised an alarm.
    suspect_ : tuple of str
        What has changed, the most likely first, followed by what cannot be distinguished from it.
        ``"gain"`` stands for all linear parameters by the same fraction, ``"offset"`` for a step of
        the sensor or of another additive disturbance. ``"other"`` is a change that none of these
        explains: with each, innovations are larger than in any block of the fit, such as those of
        an additional resonance or of a failed sensor. Empty before the first alarm; samples after
        an alarm make it more certain, until :meth:`reset`.
    judged : bool
        Whether the last block of :meth:`update` was within the range and the rate of the drives of
        the fit. Otherwise it raises no alarm and is not used for ``suspect_``.
    misfit_ : float
        Misfit of the model in the records of the fit: its largest energy per sample in the
        directions of the parameters, as a fraction of the variance of the noise; zero where the
        model is exact, and where no direction tells its misfit from noise, as that of a model far
        from its device.
    n_features_in_ : int

    See Also
    --------
    Observer : Estimates the response from the same model and readings.

    Notes
    -----
    The random walk of the observer absorbs slow drift of the response, which is not a change of a
    parameter, and equally slow parts of the effects of parameters.

    The limits for a model that is close to its device and not exact are wider, by the misfit in the
    worst part of the records of the fit. These should resemble the records in service, with every
    amplitude and rate. A change that moves the response by less than the misfit is not found.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.control import Monitor, Observer
    >>> from skhyst.linear import FirstOrderLag, FirstOrderLagOperator
    >>> rng = np.random.default_rng(0)
    >>> u = rng.normal(size=6000)
    >>> noise = 0.01 * rng.normal(size=6000)
    >>> y = FirstOrderLagOperator(0.05).run(u, 0.01)[0] + noise
    >>> monitor = Monitor(Observer(FirstOrderLag(dt=0.01))).fit(u[:, None], y)
    >>> slower = FirstOrderLagOperator(0.055).run(u, 0.01)[0] - noise
    >>> for k in range(3000):
    ...     monitor.update(u[k], slower[k])
    ...     if monitor.drift_detected:
    ...         break
    >>> k < 200, monitor.suspect_
    (True, ('time_constant',))
    """

    one_interval = False  # unless its model asks for one interval
    _changing = "_tests", "_rows"
    _range = -np.inf, np.inf  # for a monitor saved by a version without a range
    _worst = np.inf  # nor the mean square of innovations in the worst block of the fit

    _parameter_constraints = {
        "observer": [HasMethods(["fit", "compiled_step"])],
        "false_alarms": [Interval(Real, 0, 1, closed="neither")],
        "block": [Interval(Integral, 1, None, closed="left")],
        "parameters": ["array-like", None],
    }

    def __init__(self, observer, *, false_alarms=1e-6, block=64, parameters=None):
        self.observer = observer
        self.false_alarms = false_alarms
        self.block = block
        self.parameters = parameters

    @fit_context(prefer_skip_nested_validation=False)
    def fit(self, X, y) -> Self:
        """Fit the observer if it is not fitted, and the filter, the misfit and the limits.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            Column 0 is the drive; the index carries records and time. These should be the records
            of the fit: their information on the parameters is taken for the certainty of the fit.
        y : array-like of shape (n_samples,)
            Reading of the sensor.

        Returns
        -------
        self

        Raises
        ------
        ValueError
            If a name in ``parameters`` is not a parameter of the model, the records are sensitive
            to none of the parameters, or they have no noise.
        """
        observer, is_fitted = self.observer, hasattr(self.observer, "model_")
        known = interval_of(observer if is_fitted else observer.model)
        read_data(self, X, y, reset=True, dt=known, bridge=True)
        if not is_fitted:  # its model may be fitted: no clone
            observer = copy(observer).fit(X, y)
        read = list(observer._rows(X, y))
        self.observer_ = with_params(observer, dt_=self.dt_, time_unit_=self.time_unit_)
        self._changed, self.whitening_ = self._candidates(), np.ones(1)
        self._n_read = read[0][0].shape[1]
        runs = [(self._start(dt, u[0]), rows, known) for rows, u, dt, known in read]
        motion = np.concatenate([columns.motion(rows) for columns, rows, _ in runs])
        records = [columns.run(rows, known) for columns, rows, known in runs]
        self.whitening_ = whitening_filter([record[:, 0] for record in records])
        white = np.concatenate(
            [lfilter(self.whitening_, 1.0, record, axis=0) for record in records]
        )
        scales = np.sqrt(np.einsum("ki,ki->i", white, white))
        steps = np.array([step for *_, step, _ in self._changed])
        size = np.sqrt(sum(rows[:, -1] @ rows[:, -1] for rows, *_ in read))
        is_sensitive = np.append(True, scales[1:] * np.abs(steps) > _EXACT * size)
        if not is_sensitive[1:].any():
            raise ValueError("The records are sensitive to no parameter that Monitor may watch.")
        if scales[0] == 0.0:
            raise ValueError("The residual of the model is zero: Monitor needs records with noise.")
        self._changed = [
            candidate
            for candidate, is_seen in zip(self._changed, is_sensitive[1:], strict=True)
            if is_seen
        ]
        self.parameters_ = [name for name, *_ in self._changed]
        n_read = sum(np.count_nonzero(known) for *_, known in read)
        dof, self._n_kept = max(n_read - len(self._changed), 1), len(white)
        # innovations of unit variance, sensitivities of unit information
        self._scales = scales[is_sensitive] / np.append(np.sqrt(dof), np.ones(len(self._changed)))
        white = white[:, is_sensitive] / self._scales
        # The fit minimises the residual, not the innovations. This shift of the parameters makes
        # the sum of all scores zero, as the tests suppose.
        self._shift = np.linalg.lstsq(white[:, 1:], white[:, 0], rcond=None)[0]
        size = min(self.block, len(white))
        sums = self._sums(white[: len(white) // size * size], size)
        low, high = motion.min(axis=0), motion.max(axis=0)
        beyond = _BETWEEN * (high - low)
        self._range = low - beyond, high + beyond
        orders = _orders(motion[: len(white) // size * size], size)
        squares = (white[:, 0] - white[:, 1:] @ self._shift)[: len(white) // size * size] ** 2
        energies = squares.reshape(-1, size).sum(axis=1), np.mean(squares**2)
        self._tests = LocalTests(*sums, dof, self.false_alarms, self.block, orders, *energies)
        self.misfit_ = self._tests.misfit / self.block
        self._worst = energies[0].max() / size
        return self.reset()

    def reset(self) -> Self:
        """Discard all samples: the next one is the first of a device at rest.

        Returns
        -------
        self
        """
        self._tests.reset()
        self._running, self._begun, self._rows = None, None, []
        self._detected = self._judged = False
        self._evidence = None
        return self

    def update(self, u, y):
        """Process the drive and the reading at the next sample.

        Parameters
        ----------
        u : float, or array-like of shape (n_inputs,)
            Drive, with the further columns that the model reads.
        y : float
            Reading of the sensor.

        Raises
        ------
        ValueError
            If a number is not finite; the state is unchanged then.
        """
        check_is_fitted(self)
        row = np.append(u, y).astype(float)
        if len(row) != self._n_read or not np.isfinite(row).all():
            raise ValueError(
                f"The drive and the reading must be {self._n_read} finite numbers in all. Got "
                f"{row!r} instead."
            )
        if self._going_on() is None:
            self._running, self._rows = self._start(self.observer_._interval(None), u), []
        self._rows.append(row)
        self._detected = False
        if len(self._rows) == self.block:
            alarms, judged = self._decide(self._running, np.array(self._rows))
            self._detected, self._judged = bool(alarms[0]), bool(judged[0])
            self._rows = []

    def alarms(self, X, y, return_judged=False) -> np.ndarray:
        """Return a mask of the samples of records at which there is an alarm.

        Each record begins at rest; samples after its last complete block are not used.
        ``suspect_`` is that of the last record.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            As for :meth:`fit`.
        y : array-like of shape (n_samples,)
            Reading of the sensor.
        return_judged : bool, default=False
            Whether to return which samples are in judged blocks, too.

        Returns
        -------
        alarms : ndarray of shape (n_samples,)
            Of bool.
        judged : ndarray of shape (n_samples,)
            Of bool. Only with ``return_judged``.
        """
        check_is_fitted(self)
        marks, n = [], max(_AT_ONCE // self.block, 1) * self.block
        for rows, u, dt, read in self.observer_._rows(X, y):
            self.reset()
            columns, record_marks = self._start(dt, u[0]), np.zeros((len(rows), 2), dtype=bool)
            n_complete = len(rows) // self.block * self.block
            for start in range(0, n_complete, n):
                part = slice(start, min(start + n, n_complete))
                alarms, judged = self._decide(columns, rows[part], read[part])
                record_marks[part, 0][self.block - 1 :: self.block] = alarms
                record_marks[part, 1] = np.repeat(judged, self.block)
            alarm_rows = np.flatnonzero(record_marks[:, 0])
            record_marks = record_marks[read]
            record_marks[:, 0] = False  # at the next row if the last one of a block is lost
            record_marks[np.searchsorted(np.flatnonzero(read), alarm_rows), 0] = True
            marks.append(record_marks)
        marks = np.concatenate(marks)
        return (marks[:, 0], marks[:, 1]) if return_judged else marks[:, 0]

    @property
    def drift_detected(self) -> bool:
        check_is_fitted(self)
        return self._detected

    @property
    def judged(self) -> bool:
        check_is_fitted(self)
        return self._judged

    @property
    def suspect_(self):
        check_is_fitted(self)
        if self._evidence is None:
            return ()
        names, directions = list(self.parameters_), np.eye(len(self.parameters_))
        values, linear = (np.array(part) for part in list(zip(*self._changed, strict=True))[1:3])
        if np.count_nonzero(values * linear) > 1:
            names.append("gain")
            directions, values = np.vstack([directions, values * linear]), np.append(values, 1.0)
        # the information of the fit is that of scaled parameters, of a diagonal of ones
        scaled = directions * self._scales[1:] / self._scales[0]
        units = 1.0 / np.sqrt(np.einsum("mp,pq,mq->m", scaled, self._tests.known, scaled))
        squares, offset = self._squares_after(directions)
        smallest = [*smallest_squares(squares, units, values), offset]
        if min(smallest) > self._worst * np.count_nonzero(self._evidence[3]):
            return ("other",)
        blocks = len(self._evidence[2]) / self.block
        indices = likely(smallest, self._tests.misfit * blocks)
        return tuple([*names, "offset"][i] for i in indices)

    def _squares_after(self, directions):
        """Return sums of squared innovations under changes of the model and of the reading.

        These are a function ``squares(i, change)`` for a change along direction ``i``, and the
        smallest sum for a step of the reading.
        """
        state, dt, rows, judged, known = self._evidence
        driven, disturbances = split_disturbances(self.observer_.model_.operator_)

        def white(rows, operator=None):
            compiled_step = self.observer_.compiled_step(dt, rows[0, :-1], operator)
            e = compiled_step.innovating(state.copy())(rows)
            return lfilter(self.whitening_, 1.0, e) / self._scales[0]

        e, unit = white(rows), self._scales[0] * np.eye(rows.shape[1])[-1]
        step = white(rows + unit) - e
        offset = squares_after_step(e - known, step, judged, self.block)
        names = [name for name, _ in driven.entries()]
        positions = [names.index(name) for name in self.parameters_]

        def squares(i, change):
            values = driven.pack()
            values[positions] += change * directions[i]
            try:
                other = add_disturbances(driven.unpack(values), disturbances)
                found = [white(rows, other)]
            except ValueError:  # parameters that no device can have
                return np.inf
            if self.observer_.disturbance is not None:
                # the walk may have followed a change before the alarm: as an offset of the reading
                found.append(white(rows - (found[0][0] - e[0]) * unit, other))
            totals = [left @ left for left in ((own - known)[judged] for own in found)]
            return min(totals) if np.isfinite(totals).all() else np.inf

        return squares, offset

    def _start(self, dt, u0, begun=None):
        return _Columns(self, dt, u0, begun)

    def _decide(self, columns, rows, read=None):
        """Return whether each block (n_blocks,) ends with an alarm, and whether it is judged."""
        before = columns.states[0].copy()
        motion = columns.motion(rows)
        within = ((motion >= self._range[0]) & (motion <= self._range[1])).all(axis=1)
        judged = within.reshape(-1, self.block).all(axis=1)
        white = columns.run(rows, read) / self._scales
        scores, information = self._sums(white, self.block)
        alarms = self._tests.decide(scores * judged[:, None], information * judged[:, None, None])
        alarms &= judged  # no alarm of a longer sum whose last block is not judged
        counts = np.repeat(judged, self.block)
        counts = counts if read is None else counts & read
        # a model that starts again in between would have other sensitivities than the fit
        known = white[:, 1:] @ self._shift
        if self._evidence is not None:
            state, dt, *evidence = self._evidence
            if len(evidence[0]) < self._n_kept:
                evidence = zip(evidence, (rows, counts, known), strict=True)
                evidence = [np.concatenate(parts)[: self._n_kept] for parts in evidence]
                self._evidence = state, dt, *evidence
        elif alarms.any():
            first = int(np.argmax(alarms)) * self.block
            columns.compiled_step.innovating(before)(rows[:first])
            end = first + self._n_kept
            parts = (part[first:end] for part in (rows, counts, known))
            self._evidence = before, columns.dt, *parts
        return alarms, judged

    def _sums(self, white, size):
        """Return the scores (n_blocks, p) and the information (n_blocks, p, p) of blocks."""
        white = white.reshape(-1, size, len(self._scales))
        psi = white[:, :, 1:]
        innovations = white[:, :, :1] - psi @ self._shift[:, None]
        return (psi.swapaxes(1, 2) @ innovations)[:, :, 0], psi.swapaxes(1, 2) @ psi

    def _candidates(self):
        """Return (name, value, is linear, step, operator after the step) by monitored parameter."""
        driven, disturbances = split_disturbances(self.observer_.model_.operator_)
        values, entries = driven.pack(), driven.entries()
        held = self.observer_.model_.held_parameters()
        # the random walk absorbs constants
        absorbed = self.observer_.disturbance is not None
        wanted = [
            name
            for name, spec in entries
            if not (spec.held or name in held or (absorbed and spec.is_constant))
        ]
        linear = [spec.linear and not spec.is_constant for _, spec in entries]
        if self.parameters is not None:
            unknown = set(self.parameters) - {name for name, _ in entries}
            if unknown:
                raise ValueError(
                    f"The 'parameters' parameter of Monitor must be names out of {wanted}. "
                    f"Got {sorted(unknown)} instead."
                )
            wanted = list(self.parameters)
        candidates = []
        for i, (name, spec) in enumerate(entries):
            if name in wanted:
                step = _STEP * (abs(values[i]) or self._uncertainty(name))
                step = -step if values[i] + step > spec.upper else step
                changed = values.copy()
                changed[i] += step
                other = add_disturbances(driven.unpack(changed), disturbances)
                candidates.append((name, values[i], linear[i], changed[i] - values[i], other))
        return candidates

    def _uncertainty(self, name):
        """Return the standard error of a parameter, or 1 if it is unknown."""
        std = self.observer_.model_.params_std_.get(name, 1.0)
        return std if 0.0 < std < np.inf else 1.0


class _Columns:
    """Whitened innovations of a record and their sensitivities, sample by sample."""

    def __init__(self, monitor, dt, u0, begun=None):
        observer, operators = (
            monitor.observer_,
            [None, *(operator for *_, operator in monitor._changed)],
        )
        self.dt, self.u0 = dt, u0 if len(np.ravel(u0)) > 1 else float(np.ravel(u0)[0])
        compiled_steps = [observer.compiled_step(dt, self.u0, operator) for operator in operators]
        self.compiled_step = compiled_steps[0]
        self.states = [part.state.copy() for part in compiled_steps]
        self.past = np.zeros((len(monitor.whitening_) - 1, len(operators)))
        self.last = np.reshape(u0, (1, -1))
        if begun is not None:
            states, self.past, self.last = begun
            self.states = [state.copy() for state in states]
        self.innovations = [
            part.innovating(s) for part, s in zip(compiled_steps, self.states, strict=True)
        ]
        self.steps = np.array([step for *_, step, _ in monitor._changed])
        self.whitening = monitor.whitening_

    def begun(self):
        """Return the arguments, but the monitor, with which the same columns go on."""
        states = [state.copy() for state in self.states]
        return self.dt, self.u0, (states, self.past, self.last)

    def run(self, rows, read=None):
        """Return innovations and sensitivities (n_samples, 1 + p) of the next rows.

        Rows that were not read have no influence.
        """
        columns = np.column_stack([innovations(rows) for innovations in self.innovations])
        columns[:, 1:] = (columns[:, :1] - columns[:, 1:]) / self.steps
        if read is not None:
            columns[~read] = 0.0
        if len(self.past):
            columns, self.past = lfilter(self.whitening, 1.0, columns, axis=0, zi=self.past)
        return columns

    def motion(self, rows):
        """Return drives and absolute rates of the next rows, (n_samples, 2 n_inputs)."""
        drives = rows[:, :-1]
        rates = np.abs(np.diff(drives, axis=0, prepend=self.last)) / self.dt
        self.last = drives[-1:]
        return np.hstack([drives, rates])


def _orders(motion, size):
    """Return the block indices, sorted by the energy of each drive, of each rate, and of all."""
    centre = motion.mean(axis=0)
    centre[len(centre) // 2 :] = 0.0  # rates have no operating point
    energy = ((motion - centre) ** 2).reshape(-1, size, motion.shape[1]).mean(axis=1)
    mean = energy.mean(axis=0)
    energy = energy / np.where(mean > 0.0, mean, 1.0)
    return [np.argsort(part, kind="stable") for part in (*energy.T, energy.sum(axis=1))]
