"""An operator and records as a least-squares problem."""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from ..operators import propagate

_COLLINEAR = 1e-6  # singular value below which columns are collinear, relative; 1e-12 as a square
_REST = 64  # samples at rest before a history, twice the reach of a band-limited interpolation
_STILL = 1e-12  # change of a drive that is rounding, relative to its range
_LARGE = 1 << 18  # values of a Jacobian above which copying it costs more than extra products


@dataclass(frozen=True)
class RecordData:
    """One record, in the form for identification.

    Parameters
    ----------
    u : ndarray of shape (n_samples,) or (n_samples, n_inputs)
        Drive; several columns for an operator of several inputs.
    y : ndarray of shape (n_samples,)
        Response.
    dt : float
        Sampling interval in s.
    segments : tuple of (int, int), default=()
        Rows (start, stop) that are scored, in order; empty: the whole record.
    before : ndarray of shape (n_values,) or (n_values, n_inputs), float or None, default=None
        Drive 1, 2, 4, ... samples before the record: its input history. The record is simulated
        from rest at the last of these instead of from rest at its first value. Inputs without a
        history have rested at their first values.
    schedule : float, default=None
        Value that scheduled parameters depend on.
    auxiliary : ndarray of shape (n_samples, n_auxiliary), default=None
        Further columns, which identification does not read.
    weights : ndarray of shape (n_samples,), default=None
        Finite and not negative: the squared error of each sample is multiplied by its weight, as if
        the sample occurred that many times. The record is simulated over all samples, but one of
        weight zero has no valid reading: its response is replaced by a straight line between its
        neighbours, so that starting values ignore it too. None: all weights are one.
    eliminated : ndarray of shape (n_samples, n_columns), default=None
        Signals that are added to the response in unknown proportion, like additive disturbances.
    explained : ndarray of shape (n_samples,), default=None
        The part of the drive that the reference of a closed loop explains; not read either.
    start : ndarray of shape (n_start,), default=None
        Start values of the state at the first sample, for an operator without a state of rest, see
        :class:`~skhyst.operators.Operator`; such a record has no input history.

    Raises
    ------
    ValueError
        If the weights are not one finite value per sample, none below zero.

    See Also
    --------
    identify : Fit an operator to such records.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import GainOperator
    >>> from skhyst.optimize import RecordData, identify
    >>> u = np.array([0.0, 1.0, 2.0, 1.0])
    >>> result = identify([GainOperator()], [RecordData(u, 2.0 * u + 1.0, dt=0.1)])
    >>> round(result.operator.gain, 6), round(result.operator.intercept, 6)
    (2.0, 1.0)
    """

    u: np.ndarray
    y: np.ndarray
    dt: float
    segments: tuple = ()
    before: np.ndarray | float | None = None
    schedule: float | None = None
    auxiliary: np.ndarray | None = None
    weights: np.ndarray | None = None
    eliminated: np.ndarray | None = None
    explained: np.ndarray | None = None
    start: np.ndarray | None = None

    def __post_init__(self):
        if not self.segments:
            object.__setattr__(self, "segments", ((0, len(self.u)),))
        if self.weights is None:
            return
        weights = np.asarray(self.weights, dtype=float)
        if weights.shape != (len(self.u),) or not np.all((weights >= 0.0) & (weights < np.inf)):
            raise ValueError(
                "The 'weights' parameter of RecordData must be one finite value per sample, none "
                f"below zero. Got {self.weights!r} for {len(self.u)} samples instead."
            )
        object.__setattr__(self, "weights", weights)
        if not weights.all():
            rows, read = np.arange(len(weights)), weights > 0.0
            y = np.interp(rows, rows[read], self.y[read]) if read.any() else np.zeros(len(rows))
            object.__setattr__(self, "y", y)

    @property
    def drive(self):
        """The drive, or the first of several columns."""
        return self.u if self.u.ndim == 1 else self.u[:, 0]

    @cached_property
    def with_history(self):
        """The drive preceded by the input history, and the number of samples of the history."""
        if self.before is None:
            return self.u, 0
        path = path_of(self.before)
        if self.u.ndim == 1:
            path = path.reshape(len(path), -1)[:, 0]
            return np.concatenate([path, self.u]), len(path)
        rest = np.repeat(self.u[:1], len(path), axis=0)
        given = path.reshape(len(path), -1)[:, : rest.shape[1]]
        rest[:, : given.shape[1]] = given
        return np.concatenate([rest, self.u]), len(path)

    def first_part(self, stop):
        """Return the record up to a sample, in as many segments.

        Parameters
        ----------
        stop : int
            Number of samples that are kept; more where some segment would have none.

        Returns
        -------
        RecordData
        """
        begin = self.segments[0][0]
        stop = max(stop, begin + len(self.segments))
        edges = np.linspace(begin, stop, len(self.segments) + 1).astype(int)
        rows = ("u", "y", "auxiliary", "weights", "eliminated", "explained")
        arrays = {name: getattr(self, name) for name in rows}
        cut = {name: values[:stop] for name, values in arrays.items() if values is not None}
        return replace(self, segments=tuple(pairwise(edges.tolist())), **cut)

    def counts(self):
        """Return the weight of each sample.

        Returns
        -------
        ndarray of shape (n_samples,)
            Zero outside of the segments; ones within if the record has no weights.
        """
        counts = np.zeros(len(self.u))
        for start, stop in self.segments:
            counts[start:stop] = 1.0 if self.weights is None else self.weights[start:stop]
        return counts

    def segment_weights(self):
        """Return the sum of the weights of each segment.

        Returns
        -------
        ndarray of shape (n_segments,)
            The numbers of samples if the record has no weights.
        """
        if self.weights is None:
            return np.array([float(stop - start) for start, stop in self.segments])
        return np.array([self.weights[start:stop].sum() for start, stop in self.segments])

    def power(self):
        """Return the weighted sum of squares of the response.

        Returns
        -------
        float
            Units of the response squared.
        """
        power = np.square(self.y)
        return float(power.sum() if self.weights is None else self.weights @ power)


def ages(before):
    """Return the ages in samples of the values of an input history, (n_values,)."""
    return 2 ** np.arange(len(np.atleast_1d(before)))


def path_of(before):
    """Return an input history sample by sample, straight between its values."""
    age, values = ages(before), np.atleast_1d(before)
    sample = np.arange(-age[-1], 0)
    if values.ndim > 1:
        return np.stack(
            [np.interp(sample, -age[::-1], column) for column in values[::-1].T], axis=1
        )
    return np.interp(sample, -age[::-1], values[::-1])


class Unknowns:
    """Entries of operators in the coordinates of a search: positive ones as logarithms."""

    def __init__(self, entries, values):
        self.names = [name for name, _ in entries]
        rows = [(s.linear, s.log, s.penalty, s.lower, s.upper) for _, s in entries]
        columns = np.array(rows, dtype=float).reshape(-1, 5).T
        self.linear, self.log = columns[:2].astype(bool)
        self.penalty, lower, upper = columns[2:]
        with np.errstate(divide="ignore"):
            self.lower = np.where(self.log, np.log(np.maximum(lower, 0.0)), lower)
            self.upper = np.where(self.log, np.log(np.maximum(upper, 0.0)), upper)
            self.x0 = np.where(self.log, np.log(np.where(self.log, np.abs(values), 1.0)), values)
        self._logs, self._penalised = np.flatnonzero(self.log), self.penalty.any()
        self._sign = np.where(values[self._logs] < 0.0, -1.0, 1.0)

    def values(self, x):
        """Return the unknowns in their own units."""
        values = np.array(x, dtype=float)
        values[self._logs] = self._sign * np.exp(values[self._logs])
        return values

    def chain(self, values):
        """Return the derivatives of the values by the unknowns, negative for a negative value."""
        return np.where(self.log, values, 1.0)


class OperatorProblem(Unknowns):
    """Least squares of an operator's output, plus disturbances per record, against responses.

    Parameters
    ----------
    operator : Operator
        Starting values of the part that is driven.
    records : sequence of RecordData
    disturbances : sequence of DisturbanceOperator, default=()
        Their coefficients are solved exactly, record by record, and eliminated.
    fixed : collection of str, default=()
        Names of entries of the operator that are held.
    initial_state : {"rest", "zero"}, default="rest"

    Attributes
    ----------
    x0 : ndarray of shape (n,)
        Starting values; positive parameters as logarithms.
    names, linear, lower, upper, log, penalty
        One value per unknown.
    segment_record, segment_length, segment_weight : ndarray of shape (n_segments,)
        Number of the record, number of samples, and sum of their weights (the number of samples for
        a record without weights).
    """

    def __init__(self, operator, records, *, disturbances=(), fixed=(), initial_state="rest"):
        self.operator = operator
        self.records = tuple(records)
        self.disturbances = tuple(disturbances)
        self.initial_state = initial_state
        entries = operator.entries()
        self._free = np.flatnonzero([not (s.held or name in fixed) for name, s in entries])
        self._runs = _runs(self._free)
        entries = [entries[i] for i in self._free]
        self._packed = operator.pack()
        values = self._packed[self._free]
        self._moving = []  # number of nonlinear parameters of each disturbance, last in its pack
        for number, disturbance in enumerate(self.disturbances):
            skip = np.size(disturbance.coefficients)
            moving = disturbance.entries()[skip:]
            entries += [(f"disturbance{number}__{name}", s) for name, s in moving]
            values = np.concatenate([values, disturbance.pack()[skip:]])
            self._moving.append(len(moving))
        super().__init__(entries, values)
        self._n_eliminated = sum(np.size(d.coefficients) for d in self.disturbances)
        if self.records[0].eliminated is not None:
            self._n_eliminated += self.records[0].eliminated.shape[1]

    @cached_property
    def scale(self):
        """Sum of squares of the responses, samples counted by their weights."""
        return float(sum(record.power() for record in self.records))

    @cached_property
    def segment_record(self):
        return np.repeat(np.arange(len(self.records)), [len(r.segments) for r in self.records])

    @cached_property
    def segment_length(self):
        return np.array([stop - start for r in self.records for start, stop in r.segments])

    @cached_property
    def segment_weight(self):
        return np.concatenate([record.segment_weights() for record in self.records])

    def depends_on(self, select):
        """Whether :meth:`evaluate` depends on which segments of a record are selected."""
        selected = np.bincount(self.segment_record, select, minlength=len(self.records))
        split = (selected > 0) & (selected < np.bincount(self.segment_record))
        return any(self._moving) and bool(split.any())

    def unpack(self, x):
        """Return the operator and the disturbances at ``x``."""
        return self._unpacked(self.values(x))

    def _unpacked(self, values):
        vector = self._packed.copy()
        vector[self._free] = values[: len(self._free)]
        start = len(self._free)
        disturbances = []
        for disturbance, size in zip(self.disturbances, self._moving, strict=True):
            pack = disturbance.pack()
            if size:
                pack[-size:] = values[start : start + size]
            disturbances.append(disturbance.unpack(pack))
            start += size
        return self.operator.unpack(vector), tuple(disturbances)

    def simulate(self, operator, record):
        """Return the operator's output for a record, (n_samples,)."""
        operator = scheduled(operator, record)
        u, skip, begins = self._begun(operator, record)
        return operator.run(u, record.dt, operator.init(u[0], begins))[0][skip:]

    def _begun(self, operator, record):
        """Return the drive with the input history, its length, and the state it begins at.

        A history is at rest before the values that matter. At rest nothing moves, so that most of
        it is left out, unless there is an integrator.
        """
        u, skip = record.with_history
        begins = self.initial_state if record.start is None else record.start
        if skip > _REST and begins == "rest" and operator.slowest_decay() < np.inf:
            moved = np.abs(u[:skip] - u[0]) > _STILL * np.ptp(u, axis=0)
            moves = moved.reshape(skip, -1).any(axis=1)
            surplus = max((int(np.argmax(moves)) if moves.any() else skip) - _REST, 0)
            u, skip = u[surplus:], skip - surplus
        return u, skip, begins

    def history_sensitivities(self, operator, record):
        """Return the derivatives of the output by the input history, (n, n_values).

        For an operator without a state of rest, those by its start values.
        """
        if operator.n_start:
            return scheduled(operator, record).by_start(record.u, record.dt, record.start)
        return self.output_and_history_sensitivities(operator, record)[1]

    def output_and_history_sensitivities(self, operator, record):
        """Return the output and its derivatives by the input history, (n, n_values)."""
        u, skip = record.with_history
        du = np.zeros((*u.shape, np.size(record.before)))
        directions = np.eye(du.shape[-1]).reshape(-1, *np.shape(record.before))
        du[:skip] = np.moveaxis([path_of(direction) for direction in directions], 0, -1)
        operator = scheduled(operator, record)
        y, dy = propagate(operator, u, du, record.dt, self.initial_state)
        return y[skip:], dy[skip:]

    def outputs(self, operator, disturbances, coefficients):
        """Return the output of each record, with its row of the disturbances' coefficients."""
        outputs = []
        for record, values in zip(self.records, coefficients, strict=True):
            y = self.simulate(operator, record)
            outputs.append(y + self.basis(disturbances, record) @ values if disturbances else y)
        return outputs

    @staticmethod
    def basis(disturbances, record):
        """Return the columns of the disturbances' coefficients, (n_samples, n_eliminated)."""
        time = record.dt * np.arange(len(record.u))
        columns = [d.basis(time) for d in disturbances]
        columns += [] if record.eliminated is None else [record.eliminated]
        return np.concatenate(columns, axis=1)

    @np.errstate(over="ignore", invalid="ignore")  # of a run that diverges the squares are infinite
    def evaluate(self, x, *, jacobian=True, select=None):
        """Simulate all records; return the Gram matrices of ``[B, J, r]``, one per segment.

        B are the columns of the disturbances' coefficients, J the Jacobian by the unknowns, r the
        prediction minus the response. The Jacobian by a disturbance's own unknowns depends on its
        coefficients in a record, which are computed from the selected segments alone. A record
        without a selected segment is not simulated; its matrices are zero. Rows are multiplied by
        the square root of their weight. Penalties count as additional rows, as many as there are
        samples.
        """
        values = self.values(x)
        operator, disturbances = self._unpacked(values)  # once: it caches its discrete form
        d, n = self._n_eliminated, len(x) * jacobian
        blocks = np.empty((len(self.segment_length), d + n + 1, d + n + 1))
        last = 0
        for record in self.records:
            first, last = last, last + len(record.segments)
            if select is not None and not select[first:last].any():
                blocks[first:last] = 0.0
                continue
            if jacobian:
                y, dy = self._sensitivities(operator, record)
                large = len(y) * n >= _LARGE and len(y) >= n * len(record.segments)
                if large and not d:  # joining columns would copy the whole Jacobian
                    _bordered_grams(dy, y - record.y, record, self._runs, blocks[first:last])
                    continue
            else:
                y = self.simulate(operator, record)
            known = None if select is None else select[first:last]
            columns = self._columns(record, disturbances, y, dy if jacobian else None, known)
            if record.weights is not None:
                columns *= np.sqrt(record.weights)[:, None]
            _segment_grams(columns, record.segments, blocks[first:last])
        if n and len(self._logs):
            chain = np.ones(d + n + 1)
            chain[d:-1] = self.chain(values)
            blocks *= chain[:, None] * chain
        if self._penalised:
            self._penalize(blocks, x)
        return blocks

    def _penalize(self, blocks, x):
        """Add penalties to the Gram matrices: rows ``sqrt(penalty)`` times an unknown."""
        n_counted = np.where(blocks[:, -1, -1] > 0.0, self.segment_weight, 0.0)
        blocks[:, -1, -1] += n_counted * (self.penalty @ np.square(x))
        n = blocks.shape[1] - 1 - self._n_eliminated
        if n:
            diagonal = self._n_eliminated + np.arange(n)
            blocks[:, diagonal, diagonal] += n_counted[:, None] * self.penalty
            blocks[:, diagonal, -1] += n_counted[:, None] * (self.penalty * x)
            blocks[:, -1, diagonal] += n_counted[:, None] * (self.penalty * x)

    def rows(self, x):
        """Yield the arguments of :func:`~skhyst.optimize.coloured_covariance` for each record.

        The columns of the disturbances' coefficients are the basis that is projected out.
        """
        values = self.values(x)
        operator, disturbances = self._unpacked(values)
        d = self._n_eliminated
        for record in self.records:
            columns = self._columns(record, disturbances, *self._sensitivities(operator, record))
            columns[:, d:-1] *= self.chain(values)
            counts = record.counts()
            columns *= np.sqrt(counts)[:, None]
            basis, size, _ = np.linalg.svd(columns[:, :d], full_matrices=False)
            basis = basis[:, size > _COLLINEAR * size.max(initial=0.0)]
            rest = columns[:, d:] - basis @ (basis.T @ columns[:, d:])
            yield rest[:, :-1], rest[:, -1], basis, counts > 0.0, record.dt

    def _columns(self, record, disturbances, y, dy, known=None):
        """Return ``[B, J, r]`` of a record, without J if ``dy`` is None; see :meth:`evaluate`.

        ``known`` are the segments that determine the coefficients, by default all.
        """
        d, driven = self._n_eliminated, len(self._free)
        n = 0 if dy is None else len(self.names)
        columns = np.empty((len(y), d + n + 1))
        for source, target in self._runs if n else ():
            columns[:, d + target.start : d + target.stop] = dy[:, source]
        np.subtract(y, record.y, out=columns[:, -1])
        if d:
            columns[:, :d] = self.basis(disturbances, record)
            if n > driven:
                known = np.ones(len(record.segments), dtype=bool) if known is None else known
                values = _calibrate(columns[:, :d], -columns[:, -1], record, known)
                columns[:, d + driven : -1] = self._moving_columns(disturbances, record, values)
        return columns

    def _sensitivities(self, operator, record):
        """Return the operator's output for a record and its derivatives by the entries."""
        operator = scheduled(operator, record)
        u, skip, begins = self._begun(operator, record)
        y, dy = operator.sensitivities(u, np.empty((len(u), 0)), record.dt, begins)
        return y[skip:], dy[skip:]

    @staticmethod
    def _moving_columns(disturbances, record, coefficients):
        time, start, columns = record.dt * np.arange(len(record.u)), 0, []
        for disturbance in disturbances:
            size = np.size(disturbance.coefficients)
            columns.append(disturbance.basis_tangents(time, coefficients[start : start + size]))
            start += size
        return np.concatenate(columns, axis=1)

    @np.errstate(over="ignore", invalid="ignore")  # of a run that diverges
    def total(self, blocks, select=None):
        """Return the Gram matrix of ``[J, r]`` over segments, disturbances eliminated."""
        d = self._n_eliminated
        if not d:
            return (blocks if select is None or select.all() else blocks[select]).sum(axis=0)
        if select is None:
            select = np.ones(len(blocks), dtype=bool)
        total = np.zeros((blocks.shape[1] - d,) * 2)
        for number in range(len(self.records)):
            rows = select & (self.segment_record == number)
            if rows.any():
                gram = blocks[rows].sum(axis=0)
                total += gram[d:, d:] - gram[d:, :d] @ _solve_basis(gram[:d, :d], gram[:d, d:])
        return total

    def powers(self, blocks):
        """Return the sums of squares of the columns of J, disturbances not eliminated, (n,)."""
        return np.diag(blocks.sum(axis=0))[self._n_eliminated : -1]

    def coefficients(self, blocks, select=None):
        """Return each record's coefficients of the disturbances, (n_records, n_eliminated).

        A record without a selected segment has NaN.
        """
        d = self._n_eliminated
        coefficients = np.full((len(self.records), d), np.nan)
        for number in range(len(self.records)):
            rows = self.segment_record == number
            if select is not None:
                rows = rows & select
            if rows.any():
                gram = blocks[rows].sum(axis=0)
                coefficients[number] = -_solve_basis(gram[:d, :d], gram[:d, -1])
        return coefficients

    def coefficient_slopes(self, blocks):
        """Return the decrease of the coefficients per unknown, (n_records, d, n)."""
        d = self._n_eliminated
        grams = [
            blocks[self.segment_record == number].sum(axis=0) for number in range(len(self.records))
        ]
        return np.array([_solve_basis(gram[:d, :d], gram[:d, d:-1]) for gram in grams])

    def predicted_power(self, blocks, step, select, wanted):
        """Return the predicted sum of squares in wanted segments after a step.

        The coefficients of a record's disturbances come from its selected segments, as for
        :meth:`predictions`; without any, from every other segment in turn.
        """
        d, total = self._n_eliminated, 0.0
        step = np.append(step, 1.0)
        if not d:
            return float(step @ blocks[wanted].sum(axis=0) @ step)
        odd = np.arange(len(blocks)) % 2 == 1
        for number in np.unique(self.segment_record[wanted]):
            of_record = self.segment_record == number
            known = of_record & select
            halves = [(known, of_record & wanted)]
            if not known.any():
                halves = [
                    (of_record & odd, of_record & wanted & ~odd),
                    (of_record & ~odd, of_record & wanted & odd),
                ]
            for fitted, scored in halves:
                gram = blocks[fitted].sum(axis=0)
                coefficients = -_solve_basis(gram[:d, :d], gram[:d, d:] @ step)
                full = np.append(coefficients, step)
                total += full @ blocks[scored].sum(axis=0) @ full
        return float(total)

    def predictions(self, x, select, wanted=None, driven=None):
        """Return the prediction of each (wanted) record, given the response in selected segments.

        The coefficients of a record's disturbances come from its selected segments. For every other
        one of the remaining segments, the segments in between are used, too: no sample is predicted
        from itself, and no disturbance is extrapolated into a block far from known samples.
        ``driven`` are the records with another drive, whose response is predicted.
        """
        operator, disturbances = self.unpack(x)
        predictions = []
        for number, record in enumerate(self.records):
            if wanted is not None and number not in wanted:
                predictions.append(None)
                continue
            y, part = self.simulate(operator, record), 0.0
            if disturbances:
                basis = self.basis(disturbances, record)
                known = select[self.segment_record == number]
                part = _predicted_part(basis, record.y - y, record, known)
            if driven is not None:
                y = self.simulate(operator, driven[number])
            predictions.append(y + part)
        return predictions


def record_with_history(operator, record, history):
    """Return a record with its history: an earlier drive, or start values; the same one for NaN."""
    if np.isnan(history).any():
        return record
    return replace(record, **{"start" if operator.n_start else "before": history})


def scheduled(operator, record):
    """Return the operator with its parameters for a record."""
    return operator if record.schedule is None else operator.at(record.schedule)


def _runs(index):
    """Return slices (source, target) that together select the values at ``index``, ascending."""
    cuts = np.flatnonzero(np.diff(index) != 1) + 1
    bounds = [0, *cuts.tolist(), len(index)]
    return [
        (slice(int(index[a]), int(index[b - 1]) + 1), slice(a, b))
        for a, b in pairwise(bounds)
        if b > a
    ]


def _segment_grams(columns, segments, grams):
    """Write ``A' A`` of each segment's rows; equal consecutive segments in one product."""
    first = 0
    while first < len(segments):
        start, stop = segments[first]
        length, last = stop - start, first + 1
        while last < len(segments) and segments[last] == (stop, stop + length):
            stop, last = stop + length, last + 1
        part = columns[start:stop].reshape(last - first, length, -1)
        np.matmul(part.transpose(0, 2, 1), part, out=grams[first:last])
        first = last


def _bordered_grams(columns, last, record, runs, grams):
    """Write the Gram matrices, by segment, of the columns in ``runs`` and a last one.

    Without weights no column is copied.
    """
    if record.weights is not None:
        root = np.sqrt(record.weights)
        columns, last = columns * root[:, None], last * root
    every = np.empty((len(record.segments), columns.shape[1], columns.shape[1]))
    _segment_grams(columns, record.segments, every)
    for source, target in runs:
        for other, place in runs:
            grams[:, target, place] = every[:, source, other]
    for gram, (start, stop) in zip(grams, record.segments, strict=True):
        residual, products = last[start:stop], last[start:stop] @ columns[start:stop]
        for source, target in runs:
            gram[target, -1] = gram[-1, target] = products[source]
        gram[-1, -1] = residual @ residual


def _calibrate(basis, rest, record, known):
    """Return the least-squares coefficients over the known segments."""
    rows = [np.arange(*record.segments[i]) for i in np.flatnonzero(known)]
    if not rows:
        return np.zeros(basis.shape[1])
    rows = np.concatenate(rows)
    basis, rest = basis[rows], rest[rows]
    if record.weights is not None:
        root = np.sqrt(record.weights[rows])
        basis, rest = basis * root[:, None], rest * root
    return np.linalg.lstsq(basis, rest, rcond=None)[0]


def _predicted_part(basis, rest, record, known):
    """Return the disturbances predicted from known segments and from every other remaining one."""
    odd = np.arange(len(known)) % 2 == 1
    ends = [stop for _, stop in record.segments[:-1]]
    segment = np.searchsorted(ends, np.arange(len(rest)), side="right")
    disturbance = np.empty(len(rest))
    halves = (known, known), (odd & ~known, known | ~odd), (~odd & ~known, known | odd)
    for predicted, fitted in halves:
        if predicted.any():
            samples = predicted[segment]
            disturbance[samples] = basis[samples] @ _calibrate(basis, rest, record, fitted)
    return disturbance


def _solve_basis(gram, rhs):
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), np.finfo(float).tiny))
    # a ridge: columns may be collinear within a record
    scaled = gram * np.outer(scale, scale) + 1e-12 * np.eye(len(gram))
    solution = np.linalg.solve(scaled, (rhs.T * scale).T)
    return (solution.T * scale).T
