"""Validation of the data of every estimator: finite numbers of workable size, in records."""

import warnings
from numbers import Integral, Real
from reprlib import repr as shortened

import numpy as np
import pandas as pd
from scipy.special import chdtrc, factorial, lambertw
from sklearn.base import RegressorMixin
from sklearn.frozen import FrozenEstimator
from sklearn.pipeline import Pipeline
from sklearn.utils.validation import (
    check_array,
    check_consistent_length,
    column_or_1d,
    has_fit_parameter,
    validate_data,
)

from ._sklearn import StrOptions, check_sample_weight, validate_parameter_constraints
from .exceptions import ConvergenceWarning, ExtrapolationWarning, RecordError
from .io import are_swapped, symbol_of
from .records import MISMATCH, record_slices, refuse_lost_index, valid_interval

# Largest value and, inverted, the smallest, unless an estimator has its own `largest_value`: the
# squares of such values, of their gains and of the inverses of these are finite.
EXTREME = 1e100
_ROUNDING = 1e-9  # residual, relative to the standard deviation, that is rounding error
_FEWEST = 64  # rows needed to test for an order: from there on 8 / sqrt(n) is 1 at most
_UNLIKELY = 1e-3  # p-value below which the numbers of repeats are not those of a draw
_OF_A_CLASS = 5.0  # least expected count in a class of Pearson's test
_DRAWN = 0.05  # fraction of repeated rows above which they may be a draw with replacement
# Fraction of the range of a fit by which a drive may leave it without a warning. Of two records of
# one Gaussian drive, 300 to 1000 independent samples each, one in ten goes that much further.
_FURTHER = 0.15
# Of a linear model, whose response grows with its drive: nearer to another unit, which is a factor
# of 1000, than to that of the fit.
_OTHER_UNIT = np.sqrt(1e3)
_TOO_FAR = (
    "The largest value of {} is {:g}, too far from one to calculate with: choose another unit."
)


def read_data(estimator, X, *y, reset, dt=None, bridge=False):
    """Validate X and y; return the records, X as an array, and y, or None if it is not given.

    With ``reset``, in a fit, ``drive_range_``, ``drive_rate_``, ``dt_`` and ``time_unit_`` of the
    estimator are set, and the unit of the response is stored; later another one is refused.
    ``dt`` and ``bridge`` are as for :func:`read_slices`.
    """
    if not y:
        array = as_floats(estimator, X, reset=reset)
        _drive_of(estimator, reset)
        return read_slices(estimator, X, reset=reset, dt=dt, bridge=bridge), array, None
    if not reset:
        refuse_other_unit(estimator, *y)
    least = 2 if reset else 1
    array, response = as_floats(estimator, X, *y, reset=reset, ensure_min_samples=least)
    drive = array[:, _drive_of(estimator, reset)]
    refuse_extreme(drive, response, _largest_value(estimator))
    slices = read_slices(estimator, X, *y, reset=reset, dt=dt, bridge=bridge)
    if reset:
        _warn_of_swapped_names(estimator, *y)
        estimator._response_range = float(response.min()), float(response.max())
        if not _is_memoryless(estimator):
            refuse_drawn(X, drive, array, response)
            _warn_of_shuffled_rows(X, drive, response)
        store_drive_range(estimator, drive, slices)
    return slices, array, response


def refuse_no_experiment(columns, response, slices):
    """Refuse signals that cannot be drive and response: constant, equal, or a count of time."""
    if not np.ptp(response):
        raise RecordError(
            f"The response must move. Got {response[0]:g} in every sample instead: is it the "
            "column that was meant, and was the sensor on?"
        )
    for number, column in enumerate(columns.T):
        if np.array_equal(column, response):
            raise RecordError(
                f"The response must be another signal than the inputs. Got column {number} of X "
                "twice instead: name the column that the sensor measured."
            )
    if _is_time(columns[:, 0], slices):
        raise RecordError(
            "The drive must be a signal that was applied to the device. Got one that counts the "
            "time or the samples instead: it is the first column of X, and the time belongs into "
            "the index (the 'time' parameter of read_records, --time on the command line)."
        )


def refuse_still(drive):
    """Refuse a constant drive: no parameter can be identified from it."""
    if not np.ptp(drive):
        raise RecordError(
            f"The drive must move. Got {drive[0]:g} in every sample instead: is it the column that "
            "was meant, and was the amplifier on?"
        )


def _is_time(drive, slices):
    """Whether a signal rises as the time of each record does, in any unit, or as row numbers."""
    starts = [drive[s.rows.start] for s in slices]
    drives = np.concatenate(
        [drive[s.rows] - start for s, start in zip(slices, starts, strict=True)]
    )
    time = np.concatenate([s.dt * np.arange(s.n_samples) for s in slices])
    dt = min(s.dt for s in slices)
    scales = 1.0 / dt, 1.0, 1e3, 1e6, 1e9  # samples, s, ms, us, ns
    # half a sample: stamps are rounded, or stray from even ones
    return any(np.abs(drives - scale * time).max() < 0.5 * scale * dt for scale in scales)


def _is_memoryless(estimator):
    submodels = [part for key, part in _parts(estimator).items() if "__" not in key]
    parts = [part.estimator if isinstance(part, FrozenEstimator) else part for part in submodels]
    models = [part for part in parts if hasattr(part, "operator_class")]
    if models:
        return all(map(_is_memoryless, models))
    # for some operators it depends on their values, and the class has a property
    return getattr(getattr(estimator, "operator_class", None), "memoryless", False) is True


def refuse_drawn(frame, drive, X, response):
    """Refuse rows that were drawn from a recording with replacement, as by bagging.

    Neighbouring rows are then no more similar than any two rows (ratio of von Neumann, *Annals of
    Mathematical Statistics*, 1941), and some distant rows are equal to the last digit, while the
    rows after them differ. If equal inputs often have different responses, the values have few
    digits, and rows are equal by chance. Rows with times in their index are in order.
    """
    index = getattr(frame, "index", None)
    if isinstance(index, pd.Index) and not isinstance(index, pd.RangeIndex):
        return
    n = len(X)
    if _is_drawn_in_order(np.column_stack([X, response])):
        raise RecordError(
            "The rows must be a recording. Got repeated and missing rows, as in a sorted "
            "random sample with replacement, instead. Give the repetitions of all rows as "
            "sample_weight; if the rows are a recording, give their times in the index."
        )
    if n < _FEWEST or not all(_is_disordered(values) for values in (drive, response)):
        return
    if n - len(np.unique(response)) <= _DRAWN * n:
        return
    _, inputs = np.unique(X, axis=0, return_inverse=True)
    pairs, row = np.unique(
        np.column_stack([np.ravel(inputs), response]), axis=0, return_inverse=True
    )
    row, n_repeats = np.ravel(row), n - len(pairs)
    if not _DRAWN * n < n_repeats < n / 2:
        return
    shares_inputs = np.bincount(np.ravel(inputs))[np.ravel(inputs)] > 1
    shares_all = np.bincount(row)[row] > 1
    order = np.argsort(row, kind="stable")
    first, second = order[:-1], order[1:]
    repeated = (row[first] == row[second]) & (second < n - 1)
    first, second = first[repeated], second[repeated]
    in_order = np.count_nonzero((row[first + 1] == row[second + 1]) | (second == first + 1))
    if 2 * in_order < len(first) and 2 * shares_all.sum() > shares_inputs.sum():
        raise RecordError(
            f"The rows must be a recording, in the order of time. Got {n_repeats} of {n} rows "
            "repeated, in random order, instead, as an ensemble draws them. Give the repetitions "
            "as sample_weight, as BaggingRegressor does for a model outside of a pipeline; if the "
            "rows are in order, give their times in the index."
        )


def _warn_of_shuffled_rows(frame, drive, response):
    """Warn if drive and response are correlated within a row, but not between neighbouring rows.

    This is so if a recording was shuffled: drive, response and the residual of a straight line are
    then all uncorrelated from one row to the next, while a device with memory, or a smooth drive,
    shows in at least one of these. Sample correlations of independent rows have a standard
    deviation of 1 / sqrt(n); the limit is four of them.
    """
    index, n = getattr(frame, "index", None), len(drive)
    has_times = isinstance(index, pd.Index) and not isinstance(index, pd.RangeIndex)
    if has_times or n < _FEWEST or not (np.ptp(drive) and np.ptp(response)):
        return
    drives, responses = ((values - values.mean()) / np.std(values) for values in (drive, response))
    slope = drives @ responses / n
    residual = responses - slope * drives
    residual_std = np.std(residual)
    if abs(slope) < 4.0 / np.sqrt(n) or not residual_std > _ROUNDING:
        return
    columns = np.column_stack([drives, responses, residual / residual_std])
    if np.abs(columns[1:].T @ columns[:-1]).max() < 4.0 * np.sqrt(n):
        warnings.warn(
            "Drive and response are correlated within a row, but not with the row before, as if "
            "the rows had been shuffled. A model with memory needs them in the order of time "
            "(train_test_split(shuffle=False), skhyst.model_selection); if they are, give their "
            "times as the index.",
            ConvergenceWarning,
            stacklevel=5,
        )


def _is_drawn_in_order(rows):
    """Whether runs of equal rows are as long as in a sorted draw with replacement.

    How often a row is drawn is a Poisson variable, independent of that of the next row. Other
    causes of runs differ from that: a sensor that is read faster than it updates gives runs of two
    neighbouring lengths, and a signal of few digits long runs where it is slow. The lengths are
    compared with Pearson's chi-squared test, which needs an expected count of five in each class.
    """
    starts = np.flatnonzero(np.any(rows[1:] != rows[:-1], axis=1)) + 1
    repeats = np.diff(starts, prepend=0, append=len(rows))
    mean, n = repeats.mean(), len(repeats)
    if mean == 1.0:
        return False
    # of a Poisson variable with this rate, the mean of the values above zero is ``mean``
    rate = mean + lambertw(-mean * np.exp(-mean)).real
    for classes in (np.arange(1, 4), np.arange(1, 3)):  # and a last class of all longer runs
        expected = n * rate**classes / factorial(classes) / np.expm1(rate)
        expected = np.append(expected, n - expected.sum())
        if expected.min() >= _OF_A_CLASS:
            break
    else:
        return False
    counts = np.bincount(np.minimum(repeats, len(expected)), minlength=len(expected) + 1)[1:]
    p_value = chdtrc(len(expected) - 2, np.sum(np.square(counts - expected) / expected))
    if p_value < _UNLIKELY or len(np.unique(rows, axis=0)) < n:
        return False
    return abs(np.corrcoef(repeats[1:], repeats[:-1])[0, 1]) < 4.0 / np.sqrt(n)


def _is_disordered(values):
    """Whether neighbours are as far apart as any two values.

    The von Neumann ratio of independent values is 2, with a standard deviation of 2 / sqrt(n); the
    limit is four of them.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        ratio = np.square(np.diff(values)).sum() / np.square(values - values.mean()).sum()
    return abs(ratio - 2.0) < 8.0 / np.sqrt(len(values))


def read_slices(estimator, X, *y, reset, dt=None, bridge=False):
    """Return the records of X, sampled as an estimator asks for.

    Data without a time have the given interval in a fit, with ``reset``, and later that of the fit;
    ``dt`` replaces either. Contradictions to the fit are refused: another interval given since; a
    time with another interval, if the estimator counts samples. ``bridge`` is as for
    :func:`~skhyst.records.record_slices`.

    Raises
    ------
    RecordError
        If the interval is not that of the fit, or is not known.
    """
    options = {"one_interval": _counts_samples(estimator), "bridge": bridge}
    slices = record_slices(X, *y, **options)
    counted = bool(slices) and slices[0].time_unit == "sample"
    known = interval_of(estimator, fitted=not reset) if dt is None else dt
    if counted and known is not None:
        slices = record_slices(X, *y, dt=known, **options)
    if reset:
        intervals = {record.dt for record in slices}
        estimator.dt_ = intervals.pop() if len(intervals) == 1 else None
        estimator.time_unit_ = slices[0].time_unit
        vars(estimator).pop("_records_dt", None)  # of a resampled model
        if estimator.time_unit_ == "s":
            for part in _held_parts(estimator):
                if fitted_interval(part)[1] == "sample":
                    _refuse_seconds(part, slices[0].dt)
    elif slices:
        _refuse_other_interval(estimator, slices[0].dt, counted, known)
    return slices


def _refuse_other_interval(estimator, dt, counted, known):
    kind, (fitted_dt, unit) = type(estimator).__name__, fitted_interval(estimator)
    if counted:
        has_no_one = hasattr(estimator, "dt_") or getattr(estimator, "records_", ())
        if known is None and unit is None and has_no_one:
            raise RecordError(
                f"{kind} was fitted to records of several sampling intervals, or to none: X must "
                "have a time index, or 'dt' must be given. Got neither instead."
            )
        given = getattr(estimator, "dt", None) if hasattr(estimator, "dt_") else None
        if given is not None and unit is not None and not _agree(given, fitted_dt):
            raise RecordError(
                f"The 'dt' parameter of {kind} must be that of the fit, {fitted_dt:g} {unit}, or "
                f"None, for an X without a time index. Got {given:g} s instead; give X its times."
            )
    elif unit == "s" and not _agree(dt, fitted_dt):
        if not _counts_samples(estimator, default=False):
            _warn_of_other_time(estimator, dt, fitted_dt)
            return
        raise RecordError(
            f"The records must be sampled at {fitted_dt:g} s, as those of the fit: {kind} counts "
            f"samples. Got {dt:g} s instead; use skhyst.records.resample_records."
        )
    elif unit == "sample":
        _refuse_seconds(estimator, dt)


def _warn_of_other_time(estimator, dt, fitted_dt):
    """Warn of an interval that is that of the fit in another unit of time, if it matters."""
    power = round(np.log10(dt / fitted_dt) / 3.0)
    model = getattr(estimator, "model_", estimator)
    if (
        power
        and _agree(dt, fitted_dt * 1e3**power)
        and hasattr(model, "depends_on_interval")
        and model.depends_on_interval(dt)
    ):
        warnings.warn(
            f"{type(estimator).__name__} was fitted at the interval {fitted_dt:g} s. Got {dt:g} s "
            f"instead, {1e3**power:g} times as much: are the times in another unit than s?",
            ExtrapolationWarning,
            stacklevel=5,
        )


def _refuse_seconds(estimator, dt):
    """Refuse an interval in s where an estimator, or its model, is in samples and they matter."""
    model = getattr(estimator, "model_", estimator)
    if hasattr(model, "depends_on_interval") and model.depends_on_interval(dt):
        raise RecordError(
            f"{type(model).__name__} was fitted without a time, and its constants are in samples. "
            f"Got the interval {dt:g} s instead: fit it with a time index or 'dt', or use it "
            "without."
        )


def _agree(one, other):
    return abs(one - other) <= MISMATCH * other


def fitted_interval(estimator):
    """Return the sampling interval of a fit and its unit; None for both if it is not unique."""
    if hasattr(estimator, "dt_"):
        dt = estimator.dt_
        return dt, None if dt is None else getattr(estimator, "time_unit_", "s")
    records = getattr(estimator, "records_", ())  # of earlier versions
    if len({record.dt for record in records}) != 1:
        return None, None
    return records[0].dt, records[0].time_unit


def used_interval(estimator, dt, caller):
    """Return the interval at which an estimator, such as a model or what is around one, is used.

    By default that of its fit, also if that of its model is another one.
    """
    used = fitted_interval(estimator)[0] if dt is None else dt
    if used is None:
        raise RecordError(
            f"The 'dt' parameter of {caller} must be given: {type(estimator).__name__} was fitted "
            "to records of several sampling intervals, or to none."
        )
    used = valid_interval(used, caller)
    fitted_dt, unit = fitted_interval(getattr(estimator, "model_", estimator))
    if unit == "sample" and used != fitted_dt:
        _refuse_seconds(estimator, used)
    return used


def interval_of(estimator, *, fitted=True):
    """Return the sampling interval in s of data without a time: that of the fit, or the given one.

    None where none is known: time is in samples.
    """
    if fitted:
        dt, unit = fitted_interval(estimator)
        if dt is not None:
            return dt if unit == "s" else None
    return common_parameter(estimator, "dt")


def common_parameter(estimator, name):
    """Return a parameter of an estimator or, if it is None, the value that its parts agree on.

    None if no part sets it. A part in a FrozenEstimator has the interval of its fit.

    Raises
    ------
    RecordError
        If the parts contradict each other.
    """
    redefined = name in getattr(estimator, "redefined", ())
    value_here = None if redefined else getattr(estimator, name, None)
    if value_here is not None:
        return value_here
    values = {}
    for key, part in _parts(estimator).items():
        if "__" in key or isinstance(part, type) or not hasattr(part, "get_params"):
            continue
        held = isinstance(part, FrozenEstimator)
        part = part.estimator if held else part
        value = interval_of(part) if held and name == "dt" else common_parameter(part, name)
        if value is not None:
            values[key] = value
    if len(set(values.values())) > 1:
        listed = ", ".join(f"{value!r} in {key!r}" for key, value in values.items())
        raise RecordError(
            f"The '{name}' parameter of {type(estimator).__name__} must be given, since its parts "
            f"differ in theirs. Got {listed} instead."
        )
    return next(iter(values.values()), None)


def _held_parts(estimator):
    """Yield the parts of an estimator in a FrozenEstimator: fitted, and not fitted again."""
    for key, part in _parts(estimator).items():
        if "__" in key or isinstance(part, type) or not hasattr(part, "get_params"):
            continue
        yield from [part.estimator] if isinstance(part, FrozenEstimator) else _held_parts(part)


def read_weights(sample_weight, X):
    """Return the weights of the samples, (n_samples,), of the rows of X; ones for None.

    Whole numbers are counts if the smallest, but for zeros, is 1. Others, such as inverse
    variances, are relative: their scale would otherwise count as a number of samples.
    """
    refuse_lost_index(X, sample_weight, "sample_weight")
    weights = check_sample_weight(sample_weight, X, dtype=float, ensure_non_negative=True)
    positive = weights[weights > 0.0]
    if not positive.size or (positive.min() == 1.0 and not np.any(positive % 1.0)):
        return weights
    return weights / positive.mean()


def with_unread(y, sample_weight):
    """Return a response with a read value in place of NaN in rows of weight zero."""
    if sample_weight is None:
        return y
    values, weights = np.asarray(y), np.asarray(sample_weight)
    if values.ndim == 0 or values.shape[:1] != weights.shape:
        return y
    unread = pd.isna(values)
    unread &= np.reshape(weights == 0.0, (-1, *[1] * (unread.ndim - 1)))
    if not unread.any() or unread.all():
        return y
    filled = y.copy() if hasattr(y, "iloc") else values.copy()
    filled[unread] = values[~unread][0]
    return filled


def drive_column(estimator):
    """Return the position of the drive among the columns of X.

    Raises
    ------
    ValueError
        If there is no such column, or the estimator needs the drive in front.
    """
    drive = common_parameter(estimator, "drive")
    if drive is None:
        return 0
    if isinstance(drive, bool):  # which is a number in Python
        raise ValueError(
            f"The 'drive' parameter of {type(estimator).__name__} must be a name or a position. "
            f"Got {drive!r} instead."
        )
    position = find_column(estimator, drive, "drive")
    if position and (not hasattr(estimator, "drive") or getattr(estimator, "reads_columns", False)):
        names = list(getattr(estimator, "feature_names_in_", range(estimator.n_features_in_)))
        raise ValueError(
            f"The drive must be column 0 of X for {type(estimator).__name__}, which reads further "
            f"columns. Got {drive!r} among {names} instead; move it to the front."
        )
    return position


def _drive_of(estimator, reset):
    """Return the position of the drive; refuse another one than in the fit."""
    position = drive_column(estimator)
    if reset:
        estimator._drive_number = position
    known = getattr(estimator, "_drive_number", position)
    if known != position:
        raise ValueError(
            f"The 'drive' parameter of {type(estimator).__name__} must be that of the fit, column "
            f"{known}. Got {common_parameter(estimator, 'drive')!r} instead; fit the model again."
        )
    return position


def find_column(estimator, column, parameter) -> int:
    """Return the position of a column given by position or name.

    Parameters
    ----------
    estimator : estimator
        Estimator with ``n_features_in_`` and, for names, ``feature_names_in_``.
    column : int or str
        Position, counted from the end if negative, or name.
    parameter : str
        Name of the parameter that holds ``column``, for the error message.

    Returns
    -------
    int

    Raises
    ------
    ValueError
        If there is no such column.

    Examples
    --------
    >>> import pandas as pd
    >>> from skhyst.preprocessing import PlayOperators, find_column
    >>> plays = PlayOperators().fit(pd.DataFrame({"drive": [0.0, 1.0], "load": [2.0, 2.0]}))
    >>> find_column(plays, "load", "columns"), find_column(plays, -2, "columns")
    (1, 0)
    """
    if isinstance(column, str):
        names = list(getattr(estimator, "feature_names_in_", ()))
        if column in names:
            return names.index(column)
    else:
        n_features = estimator.n_features_in_
        if isinstance(column, Integral) and -n_features <= column < n_features:
            return int(column) % n_features
    raise ValueError(
        f"The '{parameter}' parameter of {type(estimator).__name__} must be positions or names of "
        f"columns of X, which has {estimator.n_features_in_} features. Got {column!r} instead."
    )


def store_drive_range(estimator, drive, slices):
    """Store the range and the largest rate of the drive of a fit.

    See :class:`ParametricModel` for ``drive_range_`` and ``drive_rate_``.
    """
    with np.errstate(over="ignore"):
        rates = [
            np.abs(np.diff(drive[s.rows]) / np.diff(s.samples)).max(initial=0.0) / s.dt
            for s in slices
        ]
    estimator.drive_range_ = (float(drive.min()), float(drive.max()))
    estimator.drive_rate_ = float(max(rates))


def warn_beyond(estimator, X, columns, *, linear=False):
    """Warn of a drive, or of further columns that are read, beyond those of the fit.

    For a ``linear`` model only where they may be in another unit.
    """
    drive = drive_column(estimator)
    seen = {drive: getattr(estimator, "drive_range_", (-np.inf, np.inf))}
    if hasattr(estimator, "input_range_"):  # models of earlier versions know only that of the drive
        seen |= {i: estimator.input_range_[:, i] for i in sorted(columns - {drive})}
    names = list(getattr(estimator, "feature_names_in_", range(X.shape[1])))
    for i, (low, high) in seen.items():
        what = "drives" if i == drive else f"values of column {names[i]!r}"
        _warn_range(estimator, what, low, high, X[:, i], _OTHER_UNIT if linear else _FURTHER)


def warn_schedules(estimator, operator, schedules):
    """Warn of records with schedule values beyond those of the fit."""
    known = [schedule for schedule in schedules if schedule is not None]
    what = "records whose parameters depend on an amplitude, or a column,"
    for limits in _schedule_ranges(operator) if known else ():
        _warn_range(estimator, what, *limits, known)


def _schedule_ranges(operator):
    if operator.schedule_range is not None:
        yield operator.schedule_range
    for child in operator.children:
        yield from _schedule_ranges(child)


def _warn_range(estimator, what, low, high, values, further=_FURTHER):
    lowest, highest = np.min(values), np.max(values)
    if low < high and max(low - lowest, highest - high) > further * (high - low):
        unit = ". Are they in the same unit?" if further == _OTHER_UNIT else "."
        warnings.warn(
            f"{type(estimator).__name__} was fitted to {what} from {low:g} to {high:g}. Got "
            f"{lowest:g} to {highest:g} instead: the response there was not measured{unit}",
            ExtrapolationWarning,
            stacklevel=4,
        )


def as_floats(estimator, X, *y, **options):
    """Return X, and y if it is given, as floats, validated by scikit-learn.

    Rows are contiguous, so that sums are rounded equally for any container of the numbers.
    """
    options |= {"dtype": np.float64, "order": "C"} | ({"y_numeric": True} if y else {})
    with np.errstate(invalid="ignore"):  # scikit-learn sums infinities of both signs
        data = validate_data(estimator, X, *y, **options)
    if not y:
        return data
    if options.get("reset", True):
        store_response_units(estimator, *y)
    array, response = data
    try:
        values = np.asarray(response, dtype=float)
    except ValueError as error:  # text, which validate_data lets through
        raise RecordError(
            f"The response y must be numbers. Got {response[0]!r} instead."
        ) from error
    if not np.isfinite(values).all():  # of None, or of text
        row = int(np.argmin(np.isfinite(values)))
        raise RecordError(f"The response y must be finite. Got {response[row]!r} in row {row}.")
    return array, values


def store_response_units(estimator, y):
    """Store the unit in the name of each column of the response of a fit."""
    estimator._response_units = _units(y)


def _units(y):
    """Return the unit in the name of each column of a response, "" where it has none."""
    names = getattr(y, "columns", (getattr(y, "name", None),))
    return tuple(symbol_of(name) for name in names)


def _warn_of_swapped_names(estimator, y):
    """Warn if the names of drive and response say that each is the other."""
    names = getattr(estimator, "feature_names_in_", None)
    if names is None:
        return
    drive, response = names[drive_column(estimator)], getattr(y, "name", None)
    if response is not None and are_swapped(drive, response):
        warnings.warn(
            f"{type(estimator).__name__} is fitted to the drive {drive!r} and the response "
            f"{response!r}: have X and y been swapped?",
            ConvergenceWarning,
            stacklevel=5,
        )


def refuse_other_unit(estimator, y):
    """Refuse a response whose name has another unit than that of the fit."""
    for own, other in zip(getattr(estimator, "_response_units", ()), _units(y), strict=False):
        if own and other and own != other:
            raise RecordError(
                f"The response must be in {own}, as in the fit of {type(estimator).__name__}. Got "
                f"a column in {other} instead; convert it."
            )


class ScoredMixin(RegressorMixin):
    """A regressor whose score refuses a response in another unit, or of other rows."""

    def score(self, X, y, sample_weight=None) -> float:
        """Return R2 of the free run.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            As for ``predict``.
        y : array-like of shape (n_samples,) or (n_samples, n_outputs)
            Response.
        sample_weight : array-like of shape (n_samples,), default=None
            Weights.

        Returns
        -------
        float

        Raises
        ------
        RecordError
            If the name of the response has another unit than that of the fit, or its index has
            records or times that X lacks.
        """
        refuse_lost_index(X, y)
        refuse_other_unit(self, y)
        return super().score(X, y, sample_weight)


def known_response(estimator, X, y, one=True):
    """Return a response of the samples of X, or several, NaN where it is not known, as a copy."""
    refuse_lost_index(X, y)
    refuse_other_unit(estimator, y)
    options = {"ensure_2d": False, "ensure_all_finite": "allow-nan", "copy": True}
    y = check_array(y, dtype=float, input_name="y", **options)
    check_consistent_length(X, y)
    return column_or_1d(y, warn=True) if one else y


def refuse_std(estimator, return_std, why):
    """Refuse ``return_std`` for a model without a covariance; ``why`` completes "a model"."""
    if return_std:
        raise ValueError(
            f"The 'return_std' parameter of {type(estimator).__name__}.predict must be False for a "
            f"model {why}: it has no covariance from which a standard deviation follows. Got "
            f"{return_std!r} instead."
        )


def refuse_several(estimator, records):
    """Refuse more than one record for a stepper to continue from."""
    if len(records) > 1:
        raise ValueError(
            f"The 'X' parameter of {type(estimator).__name__}.stepper_from must be one record. Got "
            f"{len(records)} instead."
        )


def fit_weighted(estimator, X, y, sample_weight, caller):
    """Return a scikit-learn estimator fitted with sample weights; refuse one that takes none."""
    if np.all(np.equal(sample_weight, 1.0)):
        return estimator.fit(X, y)
    name = _weights_name(estimator)
    if name is None:
        raise ValueError(
            f"The 'sample_weight' of {caller} must be None, or all of it one, for an estimator "
            f"whose fit takes none. Got {estimator!r} instead."
        )
    return estimator.fit(X, y, **{name: sample_weight})


def _weights_name(estimator):
    """Return the name of the row weights in the `fit` of an estimator; None without weights."""
    if has_fit_parameter(estimator, "sample_weight"):
        return "sample_weight"
    if isinstance(estimator, Pipeline):
        step, last = estimator.steps[-1]
        name = _weights_name(last)
        return None if name is None else f"{step}__{name}"
    inside = getattr(estimator, "regressor", getattr(estimator, "estimator", None))
    return None if inside is None else _weights_name(inside)


def select_rows(values, rows):
    """Return some rows of X or y, with their index where it has one."""
    if not hasattr(values, "iloc"):
        return np.asarray(values)[rows]
    return values.iloc[rows]


def in_native_order(values):
    """Return a frame or series in the native byte order: pandas can select rows of no other."""

    def native(dtype):
        return dtype.newbyteorder("=") if isinstance(dtype, np.dtype) else dtype

    if not hasattr(values, "iloc"):
        return values
    several = values.ndim > 1
    return values.astype(values.dtypes.map(native) if several else native(values.dtype))


def _counts_samples(estimator, *, default=True):
    """Whether an estimator, or a part of it, is valid at one sampling interval only.

    ``default`` is the answer for an estimator without the attribute ``one_interval``.
    """
    return getattr(estimator, "one_interval", default) or any(
        getattr(part, "one_interval", False) for part in _parts(estimator).values()
    )


def _largest_value(estimator):
    """Return the largest value that an estimator and all its parts can calculate with."""
    limit = getattr(estimator, "largest_value", EXTREME)
    return min(
        [limit, *(getattr(part, "largest_value", limit) for part in _parts(estimator).values())]
    )


def _parts(estimator):
    try:
        return estimator.get_params()
    except (AttributeError, TypeError):  # a class for a step is refused where steps are checked
        return {}


def refuse_large(name, values, extreme=EXTREME):
    """Refuse values if one is too large to calculate with; return the largest magnitude."""
    largest = max(values.max(), -values.min())
    if largest > extreme:
        raise RecordError(_TOO_FAR.format(name, largest))
    return largest


def refuse_size(name, values, extreme=EXTREME):
    """Refuse values too large or too small to calculate with; return the largest magnitude."""
    largest = refuse_large(name, values, extreme)
    if 0.0 < largest < 1.0 / extreme:
        raise RecordError(_TOO_FAR.format(name, largest))
    return largest


def refuse_extreme(drive, response, extreme=EXTREME):
    """Refuse a drive and a response whose magnitudes are too far from one or from each other."""
    u, y = refuse_size("X", drive, extreme), refuse_size("y", response, extreme)
    ratio = y / (u or 1.0)
    if ratio > extreme or 0.0 < ratio < 1.0 / extreme:
        raise RecordError(
            f"The largest value of y is {y:g} and that of X is {u:g}, too far apart to calculate "
            "with: choose another unit of one of them."
        )


def finite_numbers(values, caller, name, wanted, ndim=None):
    """Return a parameter as finite numbers of ``ndim`` dimensions, by default any; or refuse it.

    ``wanted`` states the requirement, such as "a finite number".
    """
    try:
        numbers = np.asarray(values)
        is_right = numbers.dtype.kind in "biuf" or all(isinstance(v, Real) for v in numbers.flat)
        numbers = numbers.astype(float) if is_right else np.empty(0)
    except (TypeError, ValueError):  # of several lengths
        numbers = np.empty(0)
    if ndim not in (None, numbers.ndim) or not numbers.size or not np.isfinite(numbers).all():
        raise ValueError(
            f"The '{name}' parameter of {caller} must be {wanted}. Got {shortened(values)} instead."
        )
    return numbers


def finite_number(value, caller, name):
    """Return a parameter as a finite number, or refuse it."""
    return float(finite_numbers(value, caller, name, "a finite number", ndim=0))


def rest_input(u0, initial_state, n_inputs, caller, *, with_amplitude=False):
    """Return the inputs (n_inputs,) at which a stepped device rests at first.

    Inputs that are not finite, or of another number, are refused, and so is an initial state other
    than "rest", "zero" and None. With ``with_amplitude`` the amplitude may follow the inputs.
    """
    options = {"initial_state": [StrOptions({"rest", "zero"}), None]}
    validate_parameter_constraints(options, {"initial_state": initial_state}, caller)
    wanted = "a finite number" + (f", or {n_inputs} of them" if n_inputs > 1 else "")
    levels = np.ravel(finite_numbers(u0, caller, "u0", wanted))
    if levels.size not in (1, n_inputs, n_inputs + with_amplitude):
        raise ValueError(
            f"The 'u0' parameter of {caller} must be {wanted}. Got {shortened(u0)} instead."
        )
    return np.full(n_inputs, levels[0]) if levels.size == 1 else levels
