r"""The stationary Kalman filter of what the free run of a model leaves.

With the states :math:`z` of the linear stages behind the hysteresis and of a random walk beside the
response,

.. math:: z_k = F z_{k-1} + w_k, \qquad y_k - \hat y_k = H z_k + v_k

where :math:`\hat y` is the free run of the whole model: in front of linear dynamics the response
is the sum of what the drive makes of them and of what anything else does, so that a filter of all
states is the free run and a filter of what it leaves. With the covariance :math:`P` of the states
before a reading, from the algebraic Riccati equation,

.. math:: e_k = y_k - \hat y_k - H F z_{k-1}, \qquad z_k = F z_{k-1} + K e_k, \qquad
   K = P H^T / S, \qquad S = H P H^T + R

(Kalman, *Journal of Basic Engineering*, 1960). The innovations :math:`e` of a right model are
white, of the variance :math:`S`. So the variances are those under which the innovations of records
are most likely (Schweppe, *IEEE Transactions on Information Theory*, 1965).
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.linalg import block_diag, solve_discrete_are, solve_discrete_lyapunov
from scipy.optimize import minimize

from .._jit import jit
from ..operators import CompiledLaw, CompiledParts, SeriesOperator, split_disturbances

_ROUNDING = 1e-12  # of the noise's variance: the Riccati equation of a slower walk is lost in it
_ENOUGH = 0.01  # change of the log likelihood, or of log variances, that nobody sees


@jit
def correction_step(r, c, s):
    """Return ``H z`` behind a residual; ``c`` is F, K, H, ``s`` is z, the innovation, and room."""
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
        The step of a model and that of the filter of what it leaves.
    variance : float
        Of the innovations.
    """

    variance: float

    @property
    def n_inputs(self):
        """Columns of the input that are read."""
        return (self.parts[0].n_inputs or 1) + 1

    def read(self, s):
        """Return the walk, the last innovation and its standard deviation out of a state."""
        n = len(self.parts[1].constants[1])
        return s[-2 - n], s[-1 - n], np.sqrt(self.variance)

    def innovating(self, s):
        """Return a function of the next rows that returns their innovations, and changes ``s``."""
        run = self.streaming(s)
        _, gain, output = self.parts[1].constants
        left = 1.0 - output @ gain  # of an innovation, beside what goes to the estimate
        return lambda rows: (rows[:, -1] - run(rows)) / left

    def _joined(self, functions):
        model, correction = functions
        is_signal = self.parts[0].n_inputs is None

        def observed(row):
            y = model(row[..., 0] if is_signal else row)
            return y + correction(row[..., -1] - y)

        return observed


@dataclass(frozen=True)
class Filter:
    """A stationary filter: F (n, n), K and H (n,), and the variance S of its innovations."""

    transition: np.ndarray
    gain: np.ndarray
    output: np.ndarray
    variance: float

    def compiled_step(self):
        """Return the step from what a free run leaves to the part of it that is no noise."""
        constants = self.transition, self.gain, self.output
        return CompiledLaw(correction_step, constants, np.zeros(2 * len(self.gain) + 1))

    def innovations(self, left):
        """Return the innovations of a record that a free run has left (n_samples,)."""
        step = self.compiled_step()
        corrected = step.streaming(step.state.copy())(left)
        return (left - corrected) / (1.0 - self.output @ self.gain)


def stages_of(driven):
    """Return the stages of a series, or the operator as the only one."""
    return driven.stages if isinstance(driven, SeriesOperator) else (driven,)


def tail_of(operator):
    """Return the linear stages behind all others of the driven part of an operator.

    A stage whose motion has hysteresis within it counts as the mode that it is without.
    """
    driven, _ = split_disturbances(operator)
    tail = []
    for stage in reversed(stages_of(driven)):
        if not _is_linear(stage):
            mode = None if stage.at_once else stage.linear_mode()
            return [mode, *tail] if mode else tail
        tail.insert(0, stage)
    return tail


def stationary(tail, dt, noise, drift, process):
    """Return the :class:`Filter` behind linear stages.

    Parameters
    ----------
    tail : list of Operator
    dt : float
        Sampling interval in s.
    noise, drift, process : float
        Variances of the noise, of the way of the random walk in a second, and of the motion of the
        stages, in units of the response squared.
    """
    a, b, c, _ = driven_by_noise(tail, dt)
    n = len(b)
    transition, output = block_diag(a, 1.0), np.append(c, 1.0)
    moved = np.zeros((n + 1, n + 1))
    moved[:n, :n] = process * np.outer(b, b)
    moved[n, n] = drift * dt
    p = np.zeros((n + 1, n + 1))
    # without noise of its own a walk stands still, and motion that dies out has died out
    live = np.append(np.full(n, process > 0.0), drift > 0.0)
    if live.any():
        own = np.ix_(live, live)
        system = transition[own].T, output[live][:, None]
        p[own] = noise * solve_discrete_are(*system, moved[own] / noise, np.ones((1, 1)))
    variance = float(output @ p @ output + noise)
    return Filter(transition, p @ output / variance, output, variance)


def most_likely(tail, records, given, smallest):
    """Return the variances of :func:`stationary` under which innovations are most likely.

    Parameters
    ----------
    tail : list of Operator
    records : list of (ndarray of shape (n_samples,), float)
        What the free run has left of each, and the interval in s.
    given : sequence of float or None
        Variances that are known.
    smallest : float
        Of the noise.
    """
    n, dt = sum(len(left) for left, _ in records), records[0][1]
    given = list(given)
    if not len(driven_by_noise(tail, dt)[1]):
        given[2] = 0.0
    free = [i for i, value in enumerate(given) if value is None]

    def variances(logs):
        found = np.array([0.0 if value is None else value for value in given])
        found[free] = np.exp(logs)
        if 0 in free:
            found[0] = max(found[0], smallest)
        # what varies less, beside the noise or the noise beside it, cannot be told of n samples
        least = found[0] * np.array([1.0, max(n**-2.0, _ROUNDING) / dt, 1.0 / n])
        found[free] = np.clip(found, least, found[0] * np.array([1.0, n / dt, n]))[free]
        return found

    def deviance(logs):
        own, total = variances(logs), 0.0
        for interval in {dt for _, dt in records}:
            law = stationary(tail, interval, *own)
            for left, dt in records:
                if dt == interval:
                    e = law.innovations(left)
                    total += len(e) * np.log(law.variance) + e @ e / law.variance
        return total

    if not free:
        return variances([])
    white = sum(np.diff(left) @ np.diff(left) for left, _ in records) / (2.0 * n)
    total = sum(left @ left for left, _ in records) / n
    sizes = [max(size, smallest) for size in {white, total}]
    shares = (1.0,), (n**-2.0 / dt, n**-1.0 / dt, 1.0 / dt), (1.0 / n, 1.0)
    starts = product(sizes, *(shares[i] for i in (0, 1, 2)))
    starts = {tuple(np.log(np.array(s) * size)[free]) for size, *s in starts}
    start = min(sorted(starts), key=deviance)
    simplex = start + np.eye(len(start) + 1, len(start), k=-1)  # whatever the unit
    options = {"xatol": _ENOUGH, "fatol": _ENOUGH, "initial_simplex": simplex}
    found = minimize(deviance, start, method="Nelder-Mead", options=options)
    return variances(found.x)


def _is_linear(stage):
    """Whether a stage, or all parts of a sum, has discrete matrices."""
    return all(hasattr(part, "discrete") for part in (stage, *getattr(stage, "stages", ())))


def driven_by_noise(tail, dt):
    """Return A (n, n), B and C (n,) of stages in series whose input is held for an interval.

    The states are in units of their standard deviation under white noise, and of the output's: that
    varies by one, whatever the units of the stages. Last is the standard deviation that the input
    itself has then. Stages that never come to rest are left out: their state is that of the random
    walk.
    """
    matrices = [stage.discrete(dt) for stage in tail]
    n = sum(len(b0) for _, b0, *_ in matrices)
    # rows of coefficients of the states before and of the input: the signal before, and now
    before = now = np.eye(n + 1)[n]
    rows, start = [], 0
    for ad, b0, b1, c, d in matrices:
        own = np.eye(n + 1)[start : start + len(b0)]
        start += len(b0)
        moved = ad @ own + np.outer(b0, before) + np.outer(b1, now)
        before, now = c @ own + d * before, c @ moved + d * now
        rows.append(moved)
    step = np.concatenate([np.empty((0, n + 1)), *rows])
    a, b, c = step[:, :n], step[:, n], before[:n]
    if n == 0 or np.abs(np.linalg.eigvals(a)).max() >= 1.0:
        return np.empty((0, 0)), np.empty(0), np.empty(0), 0.0
    covariance = solve_discrete_lyapunov(a, np.outer(b, b))
    own = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    own[own == 0.0] = 1.0  # what noise does not reach
    a, c = a * own / own[:, None], c * own
    largest = np.abs(c).max() or 1.0
    power = c / largest @ (covariance / np.outer(own, own)) @ c / largest
    if not power > 0.0:  # noise does not reach the output
        return a, np.zeros(n), c, 0.0
    size = largest * np.sqrt(power)
    return a, b / own, c / size, 1.0 / size
