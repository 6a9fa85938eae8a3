"""The drive before a record, if the device had not rested at its first value.

The memory of a device becomes coarser with age: a mode depends on the last few periods, creep on
earlier decades, a hysteresis on its largest turning points. So the drive before a record is a
straight line between values at 1, 2, 4, ... samples before it, up to half of the record, and at
rest before the first of them. With the parameters held, each record is a least-squares problem of
its own.

The output is at best a piecewise smooth function of these values: plays that did not move do not
depend on them. So the search starts from the best few among a rest and sections of the record's own
drive, or from the values of an earlier fit. Steps in one value after the other, the oldest first,
alternate with a descent by damped Gauss-Newton steps with the derivatives that the operator
propagates from its input; the start of lowest cost is followed. Values that the record does not
determine are kept constant by a penalty: a change by the full range from one value to the next
costs as much as the mean squared residual of a sample. Each of several inputs has such values.

The parameters are identified first from the later half of each record, which depends least on its
history. Then the values and the parameters are identified in turn; in a fit of the parameters, the
response to a small change of the values is eliminated like an additive disturbance.

Each loop continues while the sum of squares falls by more than by chance: k values are expected to
reduce it by the fraction k / n for n samples of noise.

Where the memory fades, most of a record does not depend on its history, and none of it on values
far back. Both are determined first, from histories at the limits, and are not simulated again: what
is left out changes the output by a small part of the mean squared residual of a sample. A linear
operator needs no search: its derivatives give all residuals, and their least-squares solution. It
needs no limits either: its history stands for the state at the first sample, which may be beyond
all that the drive reaches within a record, and only the penalty holds what the record leaves open.
"""

from dataclasses import replace
from itertools import compress

import numpy as np

from ._identify import identify
from ._problem import OperatorProblem, ages, record_with_history, scheduled
from ._start_values import SETTLED, estimate_start_values, start_values_of
from ._variable_projection import VariableProjection, variable_projection

_THIRDS = 3.0 ** -np.arange(1, 5)  # of the limits: the range of the drive, to a few per cent of it
_STEPS = np.outer(_THIRDS, (1.0, -1.0)).ravel()
_DEPTH = 3  # evaluations per value of a descent: with one, 1 record of 30 misses its minimum
# of 25 records of plays, one start misses the minimum in 3 records, three starts in none
_STARTS = 3  # if no values are known
# of the limits, three times the range of the drive: the standard deviation of the difference of two
# values within this range, of any of which none is likelier
_CHANGE = 1.0 / (3.0 * np.sqrt(6.0))
_FADED = 1e-3  # of the mean squared residual of a sample: negligible for the choice of a history
_FAR = 1e10  # residual of a diverged run, relative to the response


def estimate_input_history(
    operator,
    disturbances,
    records,
    *,
    fixed=(),
    method="variable_projection",
    with_errors=True,
    further=(),
    which=None,
    initial_state="rest",
):
    """Identify parameters and the drive before each record.

    Parameters
    ----------
    operator, disturbances : Operator, sequence of DisturbanceOperator
        Fitted from rest at each record's first value, or with a known input history.
    records : sequence of RecordData
        Those of the fit.
    fixed : collection of str, default=()
        Names of entries that are held.
    method : str or Method, default="variable_projection"
    with_errors : bool, default=True
        As of :func:`identify`.
    further : sequence of (Operator, sequence of DisturbanceOperator), default=()
        Further starts of the same structure, such as a fit to the later halves.
    which : sequence of bool, default=None
        Records that do not begin at ``initial_state``; by default all of them.
    initial_state : {"rest", "zero"}, default="rest"
        State before each of the other records.

    Returns
    -------
    result : IdentificationResult
    input_history : ndarray of shape (n_records, n_values), or (n_records, n_values, n_inputs)
        Drive 1, 2, 4, ... samples before each record, in its units; for each of several inputs. NaN
        for the other records. For an operator without a state of rest the start values, see
        ``_start_values``.
    """
    if operator.n_start:
        own = {"fixed": fixed, "method": method, "which": which, "initial_state": initial_state}
        return estimate_start_values(operator, disturbances, records, **own)
    count, which = _count(records), [True] * len(records) if which is None else which
    records = [r if _is_known(r, count) else replace(r, before=None) for r in records]
    start = [(operator, disturbances)]
    options = {"fixed": fixed, "method": method, "with_errors": with_errors}
    options |= {"initial_state": initial_state}
    best = identify(start, records, **options)
    pairs = zip(records, later_halves(records), which, strict=True)
    later = [half if is_estimated else record for record, half, is_estimated in pairs]
    n_values = sum(_rest(r, count).size for r in compress(records, which))
    chance = n_values / sum(r.counts().sum() for r in records)
    without_errors = options | {"with_errors": False}
    first_fits = [identify([*start, *further], later, **without_errors)]
    if operator.signal_linear:
        # the dynamics of least error while the linear parameters and the history are free
        rested = [
            replace(r, before=_rest(r, count)) if is_estimated and r.before is None else r
            for r, is_estimated in zip(records, which, strict=True)
        ]
        one_step = without_errors | {"method": VariableProjection(max_evaluations=1)}
        loosened = [_loosened(*guess, rested, which, one_step) for guess in (*start, *further)]
        first_fits.append(min(loosened, key=lambda fit: fit.error))
    fits = [_in_turn(begin, best, records, which, chance, options) for begin in first_fits]
    evaluations = sum(fit.n_evaluations for fit, _ in fits)
    best, records = min(fits, key=lambda fit: fit[0].error)
    input_history = [_rest(r, count) if r.before is None else r.before for r in records]
    input_history = np.array(
        [
            h if is_estimated else np.full_like(h, np.nan)
            for h, is_estimated in zip(input_history, which, strict=True)
        ]
    )
    return replace(best, n_evaluations=evaluations), input_history


def _in_turn(result, best, records, which, chance, how):
    """Identify histories and parameters in turn; return the best result and its records."""
    evaluations, gain = best.n_evaluations, 1.0
    options = {"which": which, "initial_state": how["initial_state"]}
    while gain > chance:
        operator, disturbances = result.operator, result.disturbances
        histories, runs = input_history_of(operator, disturbances, records, **options)
        trial = [
            record_with_history(operator, r, history)
            for r, history in zip(records, histories, strict=True)
        ]
        result = identify([(operator, disturbances)], trial, **how)
        evaluations += runs + result.n_evaluations
        gain = 1.0 - (result.error / best.error) ** 2 if best.error > 0.0 else 0.0
        if gain > 0.0:
            records, best = trial, result
        if gain > chance:
            without_errors = how | {"with_errors": False}
            result = _loosened(best.operator, best.disturbances, records, which, without_errors)
    return replace(best, n_evaluations=evaluations), records


def _loosened(operator, disturbances, records, which, how):
    """Return a fit in which the response to small changes of the history is eliminated."""
    options = {"disturbances": disturbances, "initial_state": how["initial_state"]}
    problem, count = OperatorProblem(operator, records, **options), _count(records)
    loosened = [
        replace(
            r,
            eliminated=problem.history_sensitivities(operator, r)
            if is_estimated
            else np.zeros((len(r.u), _rest(r, count).size)),
        )
        for r, is_estimated in zip(records, which, strict=True)
    ]
    return identify([(operator, disturbances)], loosened, **how)


def later_halves(records):
    """Return records of which only the later half counts, which depends least on their start."""
    counts = [record.counts() for record in records]
    return [
        replace(r, weights=own * (np.cumsum(own) > 0.5 * own.sum()))
        for r, own in zip(records, counts, strict=True)
    ]


def with_input_history(result, records, method="variable_projection", **options):
    """Return a result, fitted again together with the drive before each record.

    Held parameters stay held; ``options`` are those of :func:`estimate_input_history`.
    """
    fixed = {name for name, _ in result.operator.entries()} - set(result.params)
    options |= {"fixed": fixed, "method": method}
    fit, history = estimate_input_history(result.operator, result.disturbances, records, **options)
    evaluations = result.n_evaluations + fit.n_evaluations
    return replace(fit, n_evaluations=evaluations, input_history=history)


def _count(records, oldest=0):
    """Return the number of values of a history to half of a record, or ``oldest`` samples."""
    longest = max(len(record.u) for record in records)
    return int(np.log2(max(longest // 2, oldest, 1))) + 1


def _memory(operator, record, oldest):
    """Return the samples before a record, at most ``oldest``, on which it may depend, if known."""
    decay = -np.log(_FADED) * operator.slowest_decay() / record.dt
    return int(min(oldest, decay or (oldest if operator.signal_linear else 0)))


def _is_known(record, count):
    """Whether an input history with this number of values is given."""
    return record.before is not None and np.shape(record.before) == (count, *record.u.shape[1:])


def _rest(record, count):
    """Return the input history of a record that begins at rest."""
    return np.repeat(record.u[:1], count, axis=0)


def input_history_of(
    operator,
    disturbances,
    records,
    drive_range=None,
    *,
    which=None,
    initial_state="rest",
    oldest=0,
    noise_std=0.0,
    response_range=np.inf,
):
    """Return the input history of each record with the parameters held, and the number of runs.

    The history is (n_records, n_values), or (n_records, n_values, n_inputs); a run simulates all
    records. The limits are by default those of the inputs in the records; ``which`` and
    ``initial_state`` are as for :func:`estimate_input_history`. For an operator without a state of
    rest, the start values (n_records, n_start) are returned.

    The history reaches back by half of a record, or, for records shorter than the memory of the
    operator, to what has decayed, at most by ``oldest`` samples. With ``noise_std``, the standard
    deviation of the noise, what few samples do not determine stays as at rest: they may agree
    exactly with many histories, and the penalty of changes is not below that of the noise;
    ``response_range`` is that of :func:`start_precision`.
    """
    if operator.n_start:
        stiffness = noise_std / response_range
        return start_values_of(operator, disturbances, records, which, stiffness)
    limits = _limits(records, drive_range)
    count = _count(records, max(_memory(operator, record, oldest) for record in records))
    options = {"disturbances": disturbances, "initial_state": initial_state}
    problem = OperatorProblem(operator, records, **options)
    which = [True] * len(records) if which is None else which
    histories = [
        _history(problem, record, limits, count, noise_std)
        if is_estimated
        else (np.full_like(_rest(record, count), np.nan, dtype=float), 0)
        for record, is_estimated in zip(problem.records, which, strict=True)
    ]
    return np.array([history for history, _ in histories]), max(runs for _, runs in histories)


def _limits(records, drive_range):
    """Return the lower and the upper limits (n_inputs,) of input histories.

    The history of what is not linear may exceed the range of the drive by as much on either side.
    """
    ends = [np.array([r.u.min(axis=0), r.u.max(axis=0)]).reshape(2, -1) for r in records]
    low, high = np.min(ends, axis=0)[0], np.max(ends, axis=0)[1]
    if drive_range is not None:
        low[0], high[0] = drive_range
    return 2.0 * low - high, 2.0 * high - low


def start_precision(operator, record, drive_range, response_range):
    """Return the inverse covariance of how a record begins, before its response is known.

    Parameters
    ----------
    operator : Operator
        Without its additive disturbances.
    record : RecordData
        With its input history, or start values.
    drive_range : tuple of (float, float)
        The values of an input history differ from one to the next as any two within this range.
    response_range : float
        Each start value changes the response by this root mean square.

    Returns
    -------
    ndarray of shape (n_values, n_values)
    """
    if operator.n_start:
        columns = scheduled(operator, record).by_start(record.u, record.dt, record.start)
        return np.diag(np.mean(np.square(columns), axis=0)) / response_range**2
    low, high = _limits([record], drive_range)
    size = np.tile(_CHANGE * (high - low), len(record.before))
    size[size == 0.0] = np.inf  # of a constant input, whose history is at rest
    slopes = (np.eye(len(size)) - np.eye(len(size), k=-len(low))) / size
    return slopes.T @ slopes


def _history(problem, record, limits, count, noise_std):
    """Return the input history of one record, and the number of runs."""
    low, high = limits
    width = high - low
    if not width.any():
        return _rest(record, count), 0
    misfit = _Misfit(problem, record, low, width, noise_std)
    starts = _starts(misfit, record, count)
    if problem.operator.signal_linear:
        return misfit.before(misfit.solved(np.array(starts))), misfit.runs
    costs = misfit.screen_starts(starts)
    starts = [start[: misfit.n_values] for start in starts]
    # many histories have the same residual: the penalty of their changes distinguishes them
    costs += [np.square(misfit.changes(start)).sum() for start in starts]
    order = np.argsort(costs)[: 1 if _is_known(record, count) else _STARTS]
    by_chance = len(starts[0]) / max(record.counts().sum(), 1.0)
    minima = [misfit.descended(*misfit.stepped(starts[i], costs[i])) for i in order]
    best = misfit.before(_searched(misfit, *min(minima, key=lambda minimum: minimum[1]), by_chance))
    history = _rest(record, count)
    history[: len(best)] = best
    return history, misfit.runs


def _starts(misfit, record, count):
    """Return candidates of the input history of a record, relative to the limits."""
    delays = ages(np.empty(count))
    starts = [_rest(record, count)]
    if _is_known(record, count):
        return [misfit.relative(start) for start in (*starts, record.before)]
    # sections of its own drive, as many as there are steps in all values
    for row in np.linspace(delays[-1], len(record.u), count * len(_STEPS)).astype(int):
        starts.append(record.u[np.clip(row - delays, 0, len(record.u) - 1)])
    return [misfit.relative(start) for start in starts]


def _searched(misfit, values, cost, by_chance):
    """Return the minimum near the best start, whose sum of squares is ``least``."""
    while True:
        previous = cost
        values, cost = misfit.descended(*misfit.stepped(values, cost))
        if not cost < (1.0 - by_chance) * previous:
            return values


def _at_the_limits(count):
    """Return histories at the limits of the inputs: high, low, and alternating."""
    return np.zeros(count), np.ones(count), np.arange(count) % 2.0, (np.arange(count) + 1) % 2.0


class _Misfit:
    """Residual of a record as a function of its input history, relative to the limits.

    All values are one array, ordered by time, then by input. The history of a constant input is at
    rest.
    """

    def __init__(self, problem, record, low, size, noise_std):
        self._problem, self._low, self._size = problem, low, size
        self._operator = scheduled(problem.operator, record)
        self._record = replace(record, schedule=None)
        self._root, self._basis = np.sqrt(record.counts()), None
        if problem.disturbances:
            columns = self._root[:, None] * problem.basis(problem.disturbances, record)
            self._basis = np.linalg.qr(columns)[0]
        self._scale = np.linalg.norm(self._root * record.y) or 1.0
        self._n_read = np.count_nonzero(self._root) or 1
        self._noise = noise_std / self._scale
        self._last = self.relative(record.u[:1]).reshape(1, -1)
        self._stiffness = 0.0
        self._settled, self._faded, self._part = None, 0.0, self._record
        self.n_values, self.runs = 0, 0
        self.scale = 1.0  # of the response, as a least-squares problem has it

    def relative(self, values):
        """Return inputs relative to the limits, clipped to them unless the operator is linear."""
        scaled = np.reshape(values, (-1, len(self._size))) - self._low
        scaled = (scaled / np.where(self._size > 0.0, self._size, 1.0)).ravel()
        return scaled if self._operator.signal_linear else np.clip(scaled, 0.0, 1.0)

    def before(self, values):
        """Return the input history in the form of a record."""
        inputs = self._low + self._size * values.reshape(-1, len(self._size))
        return inputs if self._record.u.ndim > 1 else inputs[:, 0]

    def solved(self, starts):
        """Return the values of least residual and penalty, for a linear operator.

        The penalty is set as by :meth:`screen_starts`, from the least residual of the starts, then
        from that of the solution until it no longer falls: a start far from all of them must not be
        held there by their residual, such as that of the rest of a slow pole.
        """
        rest, previous = starts[0], np.inf
        factor = np.linalg.qr(self._columns(rest), mode="r")  # sums of squares are the same
        steps = starts - rest
        while True:
            residuals = factor[:, -1] + steps @ factor[:, :-1].T
            self._stiffen(np.square(residuals).sum(axis=1).min())
            if not self._stiffness < (1.0 - SETTLED) * previous:
                return rest + steps[-1]
            previous = self._stiffness
            rows = self._penalised(factor, rest)
            size = np.linalg.norm(rows[:, :-1], axis=0)
            size[size == 0.0] = 1.0
            step = -np.linalg.lstsq(rows[:, :-1] / size, rows[:, -1])[0] / size
            steps = np.vstack([steps, step])

    def screen_starts(self, starts):
        """Return the sums of squares of starts without the penalty of changes, and set the penalty.

        The penalty is the mean square of the least residual. Later simulations are limited to the
        part of the record, and to the values, that depend on each other noticeably.
        """
        n_inputs, rest = len(self._size), starts[0]
        ends = [np.repeat(history, n_inputs) for history in _at_the_limits(len(rest) // n_inputs)]
        outputs = np.array([self._simulate(values) for values in (rest, *ends)])
        with np.errstate(invalid="ignore"):  # diverged runs
            spread = np.ptp(outputs, axis=0)
        after = np.cumsum(self._change(spread)[::-1])[::-1]
        self._settled, costs = outputs[0], [self._squares(outputs[0])]
        self._cut(after, costs)
        costs += [self._squares(self._simulate(start)) for start in starts[1:]]
        self._cut(after, costs)
        kept = len(rest)
        while kept > n_inputs and self._is_forgotten(rest, ends, kept - n_inputs):
            kept -= n_inputs
        self.n_values = kept
        self._stiffen(min(costs))
        return np.array(costs)

    def _stiffen(self, least):
        """Set the penalty of changes by the least sum of squares."""
        self._stiffness = max(np.sqrt(least / self._n_read), self._noise / _CHANGE)

    def _cut(self, after, costs):
        """Leave out the samples that no history affects; ``after`` is each one's change."""
        self._faded = _FADED * max(min(costs) / self._n_read, self._noise**2)
        self._part = self._record.first_part(max(int(np.sum(after > self._faded)), 1))

    def _is_forgotten(self, rest, ends, kept):
        """Whether nothing noticeable depends on the values before the ``kept`` latest ones."""
        unchanged = self._simulate(rest)
        trials = [self._simulate(np.append(rest[:kept], history[kept:])) for history in ends]
        return all(self._change(trial - unchanged).sum() <= self._faded for trial in trials)

    def _change(self, part):
        """Return the squares of a change of the output, relative to the response, weighted."""
        return np.nan_to_num(np.square(part * self._root / self._scale), nan=_FAR, posinf=_FAR)

    def _squares(self, output):
        residual = np.nan_to_num(self._left(output - self._record.y), nan=_FAR, posinf=_FAR)
        return residual @ residual

    def _simulate(self, values):
        """Return the output of the record."""
        self.runs += 1
        return self._whole(self._problem.simulate(self._operator, self._begun(values)))

    def _whole(self, output):
        """Return the output completed by the samples that no history affects."""
        return output if self._settled is None else np.append(output, self._settled[len(output) :])

    def changes(self, values):
        """Return the penalties of changes between values, as residuals."""
        inputs = values.reshape(-1, len(self._size))
        return self._stiffness * np.diff(inputs, axis=0, prepend=self._last).ravel()

    def _begun(self, values):
        """Return the record with this input history."""
        return replace(self._part, before=self.before(values))

    def _left(self, part):
        """Return columns relative to the response, weighted, with the disturbances eliminated."""
        part = (part.T * (self._root / self._scale)).T
        return part if self._basis is None else part - self._basis @ (self._basis.T @ part)

    def _columns(self, values):
        """Return the derivatives by the values and the residual, (n_samples, n_values + 1)."""
        self.runs += 1
        output, part = self._problem.output_and_history_sensitivities(
            self._operator, self._begun(values)
        )
        columns = np.zeros((len(self._root), len(values) + 1))
        columns[: len(part), :-1] = np.tile(self._size, len(values) // len(self._size)) * part
        columns[:, -1] = self._whole(output) - self._record.y
        return np.nan_to_num(self._left(columns), nan=_FAR, posinf=_FAR, neginf=-_FAR)

    def _penalised(self, columns, values):
        """Return these columns with rows of the penalties."""
        slopes = np.eye(len(values)) - np.eye(len(values), k=-len(self._size))
        return np.vstack([columns, np.c_[self._stiffness * slopes, self.changes(values)]])

    def evaluate(self, values, select=None):
        """Return the Gram matrix of the derivatives and the residual, as a problem does."""
        rows = self._penalised(self._columns(values), values)
        return rows.T @ rows

    @staticmethod
    def total(gram, select=None):
        """Return the matrix itself: there are no segments."""
        return gram

    def cost(self, values):
        """Return the sum of squares."""
        changes = self.changes(values)
        return self._squares(self._simulate(values)) + changes @ changes

    def stepped(self, values, least):
        """Return the best values after steps in each of them in turn, and the sum of squares."""
        moves = np.tile(self._size > 0.0, len(values) // len(self._size))
        for place in np.flatnonzero(moves)[::-1]:
            for step in _STEPS:
                trial = values.copy()
                trial[place] = np.clip(values[place] + step, 0.0, 1.0)
                cost = self.cost(trial)
                if cost < least:
                    values, least = trial, cost
        return values, least

    def descended(self, values, least):
        """Return the minimum reached by damped steps, and its sum of squares."""
        self.lower, self.upper = np.zeros((2, len(values))) + [[0.0], [1.0]]
        self.linear = self.log = np.zeros(len(values), dtype=bool)
        found = variable_projection(self, values, max_evaluations=_DEPTH * len(values))
        return (found.x, found.cost) if found.cost < least else (values, least)
