r"""The stationary Kalman filter of the residual of a model's free run.

With the states :math:`z` of the linear stages after the hysteresis and of an additive random walk,

.. math:: z_k = F z_{k-1} + w_k, \qquad y_k - \hat y_k = H z_k + v_k

where :math:`\hat y` is the free run of the complete model. Through linear dynamics the responses to
the drive and to everything else add up, so a filter of all states is the free run plus a filter of
its residual. With the covariance :math:`P` of the states before a reading, from the algebraic
Riccati equation,

.. math:: e_k = y_k - \hat y_k - H F z_{k-1}, \qquad z_k = F z_{k-1} + K e_k, \qquad
   K = P H^T / S, \qquad S = H P H^T + R

(Kalman, *Journal of Basic Engineering*, 1960). The innovations :math:`e` of a correct model are
white, with the variance :math:`S`. So the variances of noise, walk and motion are those of maximum
likelihood of the innovations (Schweppe, *IEEE Transactions on Information Theory*, 1965).
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.linalg import block_diag, solve_discrete_are, solve_discrete_lyapunov
from scipy.optimize import minimize

from .._jit import jit
from ..operators import CompiledLaw, CompiledParts, Series, split_disturbances

_ROUNDING = 1e-12  # fraction of the noise's variance; a slower walk makes the Riccati equation fail
_ENOUGH = 0.01  # change of -2 log likelihood, or of log variances, at which the search stops


@jit
def correction_step(r, c, s):
    """Return ``H z`` after a residual ``r``.

    ``c`` is (F, K, H), ``s`` holds z (n), the innovation, and work space (n).
    """
    transition, gain, output = c
    n = gain.size
    innovation = r
    for i in range(n):
        value = 0.0
        for j in range(n):
            value += transition[i, j] * s[j]
        s[n + 1 + i] = value
        innovation -= output[i] * value
    s[n] = innovation
    corrected = 0.0
    for i in range(n):
        s[i] = s[n + 1 + i] + gain[i] * innovation
        corrected += output[i] * s[i]
    return corrected


@dataclass(frozen=True)
class CompiledObserver(CompiledParts):
    """The estimate of a response, from a row of the drive and the reading, which comes last.

    Parameters
    ----------
    parts : tuple of two CompiledStep
        The step of a model and that of the filter of its residual.
    variance : float
        Variance of the innovations.
    """

    variance: float

    @property
    def n_inputs(self):
        """Columns of the input that are read."""
        return (self.parts[0].n_inputs or 1) + 1

    def read(self, s):
        """Return the random walk, the last innovation and its standard deviation from a state."""
        n = len(self.parts[1].constants[1])
        return s[-2 - n], s[-1 - n], np.sqrt(self.variance)

    def predicted(self, estimate, s):
        """Return the free run of the model at the last sample."""
        _, gain, output = self.parts[1].constants
        n = len(gain)
        return estimate - output @ s[-1 - 2 * n : -1 - n]

    def innovating(self, s):
        """Return a function of the next rows that returns their innovations and updates ``s``."""
        run = self.streaming(s)
        _, gain, output = self.parts[1].constants
        fraction = 1.0 - output @ gain  # of an innovation that the updated estimate does not follow
        return lambda rows: (rows[:, -1] - run(rows)) / fraction

    def _joined(self, functions):
        model, correction = functions
        is_signal = self.parts[0].n_inputs is None

        def observed(row):
            y = model(row[..., 0] if is_signal else row)
            return y + correction(row[..., -1] - y)

        return observed


@dataclass(frozen=True)
class Filter:
    """A stationary Kalman filter: F (n, n), K and H (n,), and the variance S of innovations."""

    transition: np.ndarray
    gain: np.ndarray
    output: np.ndarray
    variance: float

    def compiled_step(self):
        """Return the compiled step from the residual of a free run to the estimate of it, H z."""
        constants = self.transition, self.gain, self.output
        return CompiledLaw(correction_step, constants, np.zeros(2 * len(self.gain) + 1))

    def innovations(self, residual, lost):
        """Return the innovations of the residual of a free run (n_samples,), zero where lost."""
        step, rows = self.compiled_step(), residual[:, None]

        def innovating(s):
            run, fraction = step.streaming(s), 1.0 - self.output @ self.gain
            return lambda rows: (rows[:, 0] - run(rows[:, 0])) / fraction

        rows = with_predicted_readings(innovating, step.state.copy(), rows, lost)
        return innovating(step.state.copy())(rows)


def with_predicted_readings(innovating, state, rows, lost):
    """Return rows in which lost readings (the last column) are replaced by their prediction.

    The innovation is zero there, so that the filter continues without it. Its gain is the
    stationary one, somewhat less than the optimal gain of the next readings.

    Parameters
    ----------
    innovating : callable
        Takes a state; returns a function of rows that returns their innovations and updates it.
    state : ndarray
        Before the first row; it is changed.
    rows : ndarray of shape (n_samples, n)
    lost : ndarray of bool of shape (n_samples,)
    """
    rows, last = rows.copy(), 0
    for k in np.flatnonzero(lost):
        if k > last:
            innovating(state)(rows[last:k])
        rows[k, -1] -= innovating(state.copy())(rows[k : k + 1])[0]
        last = k
    return rows


def stages_of(driven):
    """Return the stages of a series, or the operator as the only one."""
    return driven.stages if isinstance(driven, Series) else (driven,)


def last_linear_stages(operator):
    """Return the linear stages at the end of the driven part of an operator.

    A stage with hysteresis in its equation of motion is the first, as its linear mode without it.
    """
    driven, _ = split_disturbances(operator)
    tail = []
    for stage in reversed(stages_of(driven)):
        if not stage.has_matrices:
            mode = None if stage.at_once else stage.linear_mode()
            return [mode, *tail] if mode else tail
        tail.insert(0, stage)
    return tail


def stationary(tail, dt, noise, drift, process):
    """Return the :class:`Filter` for linear stages and a random walk.

    Parameters
    ----------
    tail : list of Operator
    dt : float
        Sampling interval in s.
    noise, drift, process : float
        Variances of the noise, of the displacement of the random walk in 1 s, and of the motion of
        the stages, in units of the response squared.
    """
    a, b, c, _ = driven_by_noise(tail, dt)
    n = len(b)
    transition, output = block_diag(a, 1.0), np.append(c, 1.0)
    increments = np.zeros((n + 1, n + 1))
    increments[:n, :n] = process * np.outer(b, b)
    increments[n, n] = drift * dt
    p = np.zeros((n + 1, n + 1))
    # a state that no noise drives is zero: a walk stands still, motion has decayed; the Riccati
    # equation is solved for the others alone, since it has no stabilising solution with these
    is_live = np.append(np.full(n, process > 0.0), drift > 0.0)
    if is_live.any():
        block = np.ix_(is_live, is_live)
        system = transition[block].T, output[is_live][:, None]
        p[block] = noise * solve_discrete_are(*system, increments[block] / noise, np.ones((1, 1)))
    variance = float(output @ p @ output + noise)
    return Filter(transition, p @ output / variance, output, variance)


def maximum_likelihood(tail, records, given, smallest):
    """Return the maximum-likelihood variances of :func:`stationary`.

    Parameters
    ----------
    tail : list of Operator
    records : list of (ndarray of shape (n_samples,), float, ndarray of bool)
        Residual of the free run of each record, its sampling interval in s, and where it is lost.
    given : sequence of float or None
        Variances of noise, drift and process; None where they are to be estimated.
    smallest : float
        Lower bound of the estimated variance of the noise.

    Returns
    -------
    ndarray of shape (3,)
    """
    n, dt = sum(np.count_nonzero(~lost) for *_, lost in records), records[0][1]
    given = list(given)
    if not len(driven_by_noise(tail, dt)[1]):
        given[2] = 0.0
    free = [i for i, value in enumerate(given) if value is None]

    def variances(logs):
        estimates = np.array([0.0 if value is None else value for value in given])
        estimates[free] = np.exp(logs)
        if 0 in free:
            estimates[0] = max(estimates[0], smallest)
        # from n samples, variances that are a smaller fraction of the noise's cannot be estimated,
        # nor can the noise's if it is a smaller fraction of theirs
        smallest_each = estimates[0] * np.array([1.0, max(n**-2.0, _ROUNDING) / dt, 1.0 / n])
        estimates[free] = np.clip(
            estimates, smallest_each, estimates[0] * np.array([1.0, n / dt, n])
        )[free]
        return estimates

    def deviance(logs):
        parameters, total = variances(logs), 0.0
        for interval in {dt for _, dt, _ in records}:
            law = stationary(tail, interval, *parameters)
            for residual, dt, lost in records:
                if dt == interval:
                    e = law.innovations(residual, lost)
                    total += np.count_nonzero(~lost) * np.log(law.variance) + e @ e / law.variance
        return total

    if not free:
        return variances([])
    # the best of a grid of starts: noise as if the residual were white, or as large as all of it
    white = sum(np.diff(residual) @ np.diff(residual) for residual, *_ in records) / (2.0 * n)
    total = sum(residual @ residual for residual, *_ in records) / n
    sizes = [max(size, smallest) for size in {white, total}]
    fractions = (1.0,), (n**-2.0 / dt, n**-1.0 / dt, 1.0 / dt), (1.0 / n, 1.0)
    starts = product(sizes, *(fractions[i] for i in (0, 1, 2)))
    starts = {tuple(np.log(np.array(s) * size)[free]) for size, *s in starts}
    start = min(sorted(starts), key=deviance)
    simplex = start + np.eye(len(start) + 1, len(start), k=-1)  # a factor e, whatever the unit
    options = {"xatol": _ENOUGH, "fatol": _ENOUGH, "initial_simplex": simplex}
    fit = minimize(deviance, start, method="Nelder-Mead", options=options)
    return variances(fit.x)


def driven_by_noise(tail, dt):
    """Return A (n, n), B and C (n,) of stages in series that are driven by white noise, and a std.

    The noise is held between samples. Each state is scaled by its own standard deviation, and the
    output has unit standard deviation, whatever the units of the stages; the last value returned is
    the corresponding standard deviation of the noise. For stages that are not asymptotically stable
    n is 0: the random walk represents their state.
    """
    matrices = [stage.discrete(dt) for stage in tail]
    n = sum(len(b0) for _, b0, *_ in matrices)
    # the signal between two stages, at the last and at this sample, is a linear combination of all
    # states at the last sample and the input: these are its coefficients
    at_last = at_sample = np.eye(n + 1)[n]
    rows, start = [], 0
    for ad, b0, b1, c, d in matrices:
        states = np.eye(n + 1)[start : start + len(b0)]
        start += len(b0)
        new_states = ad @ states + np.outer(b0, at_last) + np.outer(b1, at_sample)
        at_last, at_sample = c @ states + d * at_last, c @ new_states + d * at_sample
        rows.append(new_states)
    step = np.concatenate([np.empty((0, n + 1)), *rows])
    a, b, c = step[:, :n], step[:, n], at_last[:n]
    if n == 0 or np.abs(np.linalg.eigvals(a)).max() >= 1.0:
        return np.empty((0, 0)), np.empty(0), np.empty(0), 0.0
    covariance = solve_discrete_lyapunov(a, np.outer(b, b))
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    scale[scale == 0.0] = 1.0  # states that the noise does not drive
    a, c = a * scale / scale[:, None], c * scale
    largest = np.abs(c).max() or 1.0
    power = c / largest @ (covariance / np.outer(scale, scale)) @ c / largest
    if not power > 0.0:  # the noise does not move the output
        return a, np.zeros(n), c, 0.0
    size = largest * np.sqrt(power)
    return a, b / scale, c / size, 1.0 / size
