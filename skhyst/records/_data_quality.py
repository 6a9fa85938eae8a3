"""Faults of the measurement, as distinguished from physical effects.

A physical effect acts before the noise of the sensor is added; a fault of the converter or of the
recorder acts after it, and leaves readings that are equal to the last digit. This distinguishes
clipping at the converter's range from a saturation of the device, and a stuck sensor from a rest.

For faults that show in the relation of drive and response see ``_channels``.
"""

import numpy as np
import pandas as pd
from scipy.stats import median_abs_deviation

from ._channels import SIDE, are_exchanged, lost_samples, noise_on_drive, reaction_p_value
from ._index import first_of_equals, record_names

_ADVICE = {
    "outlier": "treat the rows as missing readings, or use a robust loss",
    "lost_reading": "read it again with its value as missing_code (--missing-code), and on_missing",
    "stuck_sensor": "leave these rows out: the sensor gave one reading while the drive moved",
    "clipped_range": "choose a larger range of the converter, or leave these samples out",
    "wrapped_reading": "unwrap the reading, as np.unwrap(y, period=value) does",
    "clock_jitter": "resample with skhyst.records.resample_records (--resample)",
    "lost_samples": "start a new record at each of these rows; a time index would show the gap",
    "lost_rows": "nothing to do: models simulate through them, and they are not scored",
    "repeated_record": "leave it out: it is equal to an earlier one to the last bit",
    "constant_drive": "drive the device: a constant signal does not determine its response",
    "same_signal": "check the columns: the drive is in another column, too",
    "swapped_channels": "check the columns: the drive looks like a response, and lags",
    "noisy_drive": "use the commanded signal as the drive, or average it over repetitions",
    "closed_loop": "record what the controller follows, and search with it as the reference",
}


_STANDING = 10  # least number of equal readings of a sensor that is stuck
_BESIDE = 20  # readings on either side of a jump that show which way the signal goes


def data_quality(X, y, records) -> pd.DataFrame:
    """Return a table of the faults of a measurement.

    Parameters
    ----------
    X : DataFrame or array-like of shape (n_samples, n_inputs)
        Column 0 is the drive; the jitter of the clock is found from a time index.
    y : ndarray of shape (n_samples,)
        Response.
    records : sequence of RecordSlice
        Rows and sampling interval of each record, with its lost rows if these are to be reported
        (``record_slices(X, bridge=True)``).

    Returns
    -------
    DataFrame
        One row per fault and record: ``fault`` (one of ``outlier``, ``lost_reading``,
        ``stuck_sensor``, ``clipped_range``, ``wrapped_reading``, ``clock_jitter``,
        ``lost_samples``, ``lost_rows`` (gaps in the index), ``swapped_channels``,
        ``noisy_drive``, ``repeated_record``, and of all records ``constant_drive`` and
        ``same_signal``), ``record``, ``n_samples``, ``rows`` (numbers of the first few rows; of
        lost rows, those after the gap), ``value`` (reading at which the sensor was stuck, clipped
        or lost; jump of a wrapped reading; relative standard deviation of the interval; number of
        samples lost before each row; standard deviation of the drive's noise; NaN for others),
        ``advice``.

    See Also
    --------
    inspect_recording : Overview of a file before it is read, with such faults.

    Notes
    -----
    Feedback from the response to the drive only shows in the residual of a model: ``data_quality_``
    of a search whose residual is noise also contains ``closed_loop``, with the p-value.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.records import data_quality, record_slices
    >>> drive = np.sin(np.linspace(0, 20, 1000))
    >>> y = drive + 0.01 * np.random.default_rng(0).normal(size=1000)
    >>> y[400] = 9.0
    >>> X = drive.reshape(-1, 1)
    >>> data_quality(X, y, record_slices(X))[["fault", "rows"]].to_numpy().tolist()
    [['outlier', (400,)]]
    """
    drive = np.asarray(X, dtype=float)[:, 0]
    y = np.asarray(y, dtype=float)
    report, firsts = [], first_of_equals(records, X, y)
    is_constant = drive.size > 0 and not np.ptp(drive)
    others = [y, *np.asarray(X, dtype=float).T[1:]]
    is_copied = not is_constant and any(np.array_equal(drive, other) for other in others)
    for number, (record, name) in enumerate(zip(records, record_names(records), strict=True)):
        u, response = drive[record.rows], y[record.rows]
        all_rows = np.arange(record.rows.start, record.rows.stop)
        if is_constant:
            report.append(("constant_drive", name, all_rows, u[0]))
        if is_copied:
            report.append(("same_signal", name, all_rows, np.nan))
        if firsts[number] < number:
            report.append(("repeated_record", name, all_rows, np.nan))
        runs = _runs(response)
        faults = list(_spikes(u, response, *runs))
        codes = [value for fault, _, value in faults if fault == "lost_reading"]
        faults += [] if faults else _wrapped(u, response)
        if _noisy(runs[1]):
            step = np.min(np.diff(np.unique(response)), initial=np.inf)
            faults += _clipped(response, *runs, codes, step)
            # with noise below a step of the converter, a device at rest repeats a reading, too
            if _scatter(response) > step:
                faults += _stuck(u, response, *runs)
        for fault, rows, value in faults:
            report.append((fault, name, rows + record.rows.start, value))
        jitter = _jitter(X, record)
        if jitter > 0.05:  # rounding of the interval by a tenth gives 0.04
            report.append(("clock_jitter", name, all_rows, jitter))
        noise = noise_on_drive(u, response)
        if noise > 0.0 and are_exchanged(u, response):
            report.append(("swapped_channels", name, all_rows, np.nan))
        elif noise > 0.0:
            report.append(("noisy_drive", name, all_rows, noise))
        steps = np.diff(record.samples, prepend=-1) - 1
        if record.lost:
            rows = np.repeat(np.arange(record.n_samples), steps) + record.rows.start
            report.append(("lost_rows", name, rows, np.nan))
        for rows, n_lost in lost_samples(u, response):
            # lost rows are reported already
            distance = np.abs(rows[:, None] - np.flatnonzero(steps)).min(axis=1, initial=len(u))
            rows = rows[distance >= SIDE]
            if rows.size:
                report.append(("lost_samples", name, rows + record.rows.start, n_lost))
    return _table(report)


def with_reactions(table, drive, residuals, records):
    """Return the table with ``closed_loop`` added for records whose drive reacts to the residual.

    Records with noise on the drive are left out, since this noise is in the residual, too.
    """
    reactions = []
    others = set(table["record"][table["fault"].isin(["noisy_drive", "swapped_channels"])])
    names = record_names(records)
    for record, name, residual in zip(records, names, residuals, strict=True):
        start = int(np.argmax(np.isfinite(residual)))
        p_value = reaction_p_value(drive[record.rows][start:], np.nan_to_num(residual[start:]))
        if len(records) * p_value < 0.001 and name not in others:
            rows = np.arange(record.rows.start, record.rows.stop)
            reactions.append(("closed_loop", name, rows, p_value))
    tables = [part for part in (table, _table(reactions)) if len(part)]
    return pd.concat(tables, ignore_index=True) if tables else table


def _table(found):
    rows = [
        (fault, label, len(at), tuple(at[:5].tolist()), float(value), _ADVICE[fault])
        for fault, label, at, value in found
    ]
    return pd.DataFrame(rows, columns=["fault", "record", "n_samples", "rows", "value", "advice"])


def lost_readings(drive, y, records):
    """Return masks (n_record,), one per record, of samples that are lost readings or outliers."""
    masks = []
    for record in records:
        response = y[record.rows]
        lost = np.zeros(len(response), dtype=bool)
        for _, rows, _ in _spikes(drive[record.rows], response, *_runs(response)):
            lost[rows] = True
        masks.append(lost)
    return masks


def _runs(y):
    """Return starts and lengths of stretches of equal readings."""
    starts = np.flatnonzero(np.r_[True, np.diff(y) != 0.0])
    return starts, np.diff(np.r_[starts, len(y)])


def _spikes(u, y, starts, lengths):
    """Yield readings far above or below both neighbours; repeated values are codes."""
    if not np.ptp(y) > 0.0:
        return
    # smallest height: 12 sigma of the second difference, and 2 % of the range
    lowest = max(12.0 * _scatter(y), 0.02 * np.ptp(y))
    inner = slice(1, -1)
    before, value, after = y[starts[inner] - 1], y[starts[inner]], y[(starts + lengths)[inner]]
    into, back = value - before, value - after
    height = np.minimum(np.abs(into), np.abs(back))
    is_spike = (into * back > 0.0) & (height > lowest) & (lengths[inner] <= 20)
    is_spike &= np.abs(after - before) < 0.5 * height
    # not where the drive jumps there and back
    first, last = starts[inner], (starts + lengths)[inner]
    moved = np.minimum(np.abs(u[first] - u[first - 1]), np.abs(u[last] - u[last - 1]))
    is_spike &= moved / (np.ptp(u) or 1.0) < 0.3 * height / np.ptp(y)
    # many spikes belong to the signal
    if not is_spike.any() or lengths[inner][is_spike].sum() > 0.02 * len(y):
        return
    at = np.concatenate(
        [np.arange(a, b) for a, b in zip(first[is_spike], last[is_spike], strict=True)]
    )
    rows = {code: at[y[at] == code] for code in np.unique(value[is_spike])}
    single = [code_rows for code_rows in rows.values() if code_rows.size == 1]
    if single:
        yield "outlier", np.sort(np.concatenate(single)), np.nan
    for code, code_rows in rows.items():
        if code_rows.size > 1:
            yield "lost_reading", code_rows, code


def _scatter(y):
    """Return the robust standard deviation (MAD) of the distance from the mean of neighbours."""
    distance = y[1:-1] - 0.5 * (y[:-2] + y[2:])
    return median_abs_deviation(distance, scale="normal") if distance.size else 0.0


def _wrapped(u, y):
    """Yield jumps of one size, over half the range, of a smooth signal, without one of its drive.

    A counter that overflows, or an angle that wraps, makes such jumps, against the way it goes
    before and after. A device that switches between two states rests there, or goes the same way;
    that of a sawtooth jumps each time by as many samples later than its drive.
    """
    jumps, size = np.diff(y), np.ptp(y)
    at = np.flatnonzero(np.abs(jumps) > 0.5 * size)
    if not at.size:
        return
    sizes, rest = np.abs(jumps[at]), np.delete(np.abs(jumps), at)
    moves = np.abs(np.diff(u)) / (np.ptp(u) or 1.0)
    late = [moves[at[at >= lag] - lag].min() for lag in range(1, min(_BESIDE, at[-1] + 1))]
    moved = max(moves[at].max(), *late, 0.0)
    alike = np.ptp(sizes) + 2.0 * rest.max(initial=0.0) < 0.2 * size
    if alike and moved < 0.2 and 2 * at.size < len(rest) and _against_the_way(y, at):
        yield "wrapped_reading", at + 1, np.median(sizes)


def _against_the_way(y, at):
    """Whether a signal goes on, before and after most of its jumps, against their direction."""
    ends = np.r_[-1, at, len(y) - 1]
    ways = []
    for before, here, after in zip(ends[:-2], at, ends[2:], strict=True):
        sides = y[max(before + 1, here - _BESIDE + 1) : here + 1], y[here + 1 : after + 1][:_BESIDE]
        jump = np.sign(y[here + 1] - y[here])
        ways += [-jump * (side[-1] - side[0]) for side in sides if len(side) > 1]
    return bool(ways) and np.median(ways) > 4.0 * _scatter(y)


def _noisy(lengths):
    """Whether readings hardly ever repeat, so that runs of equal readings are a fault."""
    return np.median(lengths) == 1.0 and np.mean(lengths == 1) > 0.5


def _stuck(u, y, starts, lengths):
    """Yield stretches of one reading while the drive moves, away from the ends of the range.

    One that begins before the drive moves may be that of a device at rest, with noise below a step
    of the converter, which does not move at once.
    """
    ends, least = (y.min(), y.max()), 0.03 * (np.ptp(u) or np.inf)
    rest = 8.0 * _scatter(u)  # range of a drive that rests, four standard deviations to either side
    long = lengths >= _STANDING
    for start, length in zip(starts[long], lengths[long], strict=True):
        rows = np.arange(start, start + length)
        moves = np.ptp(u[rows[:_STANDING]]) > rest and np.ptp(u[rows]) > least
        if moves and y[start] not in ends:
            yield "stuck_sensor", rows, y[start]


def _clipped(y, starts, lengths, codes, step):
    """Yield the readings at the largest or smallest value, codes aside, if there are runs of it.

    Quantization alone gives runs at the top of any wave: at the top of a parabola, the last step of
    the converter lasts at most 1 / (sqrt(2) - 1) times as long as the one before.
    """
    if not np.ptp(y) > 0.0:
        return
    real = y[~np.isin(y, codes)]
    for end in (real.min(), real.max()):
        long = (y[starts] == end) & (lengths >= 3)
        rows = np.flatnonzero(y == end)
        before = np.count_nonzero(np.abs(np.abs(y - end) - step) < 0.5 * step)
        # 1 / (sqrt(2) - 1) of the count one step below, plus two standard deviations of it
        usual = (1.0 + np.sqrt(2.0)) * (before + 2.0 * np.sqrt(before))
        if long.any() and len(rows) >= max(5, usual):
            yield "clipped_range", rows, end


def _jitter(X, record):
    """Return the standard deviation of the interval relative to its mean, 0 without times."""
    index = X.index if hasattr(X, "iloc") else pd.RangeIndex(0)
    times = index.get_level_values("time") if index.nlevels > 1 else index
    if times.dtype.kind not in "fmM":
        return 0.0
    if getattr(times, "tz", None) is not None:
        times = times.tz_convert(None)  # to_numpy of times with a zone gives objects
    steps = np.diff(times[record.rows].to_numpy())
    steps = steps / np.timedelta64(1, "s") if steps.dtype.kind == "m" else steps
    steps = steps / np.diff(record.samples) if record.lost else steps
    return float(steps.std() / steps.mean()) if len(steps) > 1 else 0.0
