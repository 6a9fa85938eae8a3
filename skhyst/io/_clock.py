"""The time and the record of each row of a file."""

import re
import warnings

import numpy as np
import pandas as pd

from ..exceptions import RecordError, TimeUnitWarning
from ._column_names import SECONDS, time_unit_of
from ._file_columns import coerced, is_blank, numbers
from ._formats import reading

_ROUNDED = 0.1  # largest rounding of a stamp, as a fraction of the interval
JITTER = 0.25  # largest deviation of one interval, as a fraction: both ends rounded, with margin
_MISMATCH = 0.01  # relative difference of two rates that contradict each other
_NEXT = 1.5  # intervals to the next sample, also where the clock begins anew
_HOUR = 3600.0  # s
_ORDERS = ("d m Y", "m d Y", "d m y", "m d y", "y m d", "d b Y", "d b y", "b d Y")  # of a date
_DATE = re.compile(r"(\w+)[ ./-]+(\w+)[ ,./-]+(\w+)(?:[ T,]+(.*))?")
_HALF_DAY = re.compile(r"(\d{1,2}):(\d\d:\d\d(?:\.\d+)?) ?([AP])\.?M\.?", re.IGNORECASE)
_NO_SECONDS = re.compile(r"^(\d+:\d\d)(?![\d:.])")
_CODES = {ord(letter): f"%{letter}" for letter in "dmyYb"}
_MINUTES = re.compile(r"(\d+):([0-5]\d\.\d+)")  # the fraction shows that it is no hh:mm
# what pandas makes durations of, without the dates (01.01.2024 00:00) that it takes for some
_DURATION = re.compile(
    r"[+-]?(\d+ days?,? [+-]?)?\d+:[0-5]?\d:[0-5]?\d(\.\d+)?"
    r"|[+-]?(\d+(\.\d+)? *[a-zµμ]+ *)+|[+-]?P[\dDTHMS.]+",
    re.IGNORECASE,
)
_FRACTION = re.compile(r"(\d\d:\d\d:\d\d):(\d{1,6})$")
_SINCE_1970 = (1e9, 1e10)  # s, from 2001 to 2286: a count of ms, us or ns is not within
_DAY_1970 = (25569.0, 719529.0)  # of a count of days: of a spreadsheet, of MATLAB


def evenly(path, columns, rows, sampling_rate):
    """Return even times in s by a given rate or the interval in the file; else row numbers.

    ``rows`` are the numbers of the rows within their records.
    """
    if sampling_rate is not None:
        return rows / float(sampling_rate)
    intervals = {column.name: column.interval for column in columns if column.interval is not None}
    if len(set(intervals.values())) > 1:
        listed = ", ".join(f"{name!r} {value:g} s" for name, value in intervals.items())
        raise RecordError(
            f"The columns of {path.name} differ in their sampling intervals: {listed}. Bring them "
            "to one, or pass 'sampling_rate' if the file is wrong."
        )
    return rows * next(iter(intervals.values())) if intervals else rows


def _seconds(path, name, values, unit):
    """Return times in s; warn without a unit if steps of 1 or more, or dates, make s unlikely."""
    if unit is None:
        try:
            unit = time_unit_of(name)
        except ValueError as error:
            raise RecordError(
                f"The time {name!r} of {path.name} is in {str(error)!r}, which is not a known "
                f"unit of time: pass 'time_unit', one of {', '.join(SECONDS)}, or 'sampling_rate' "
                "instead of 'time'."
            ) from None
    if not unit:
        unit = next(
            (one for one in ("ms", "us", "ns") if _is_since_1970(values * SECONDS[one])), ""
        )
    steps = np.abs(np.diff(values))
    step = np.median(steps[np.isfinite(steps)]) if np.isfinite(steps).any() else 0.0
    days = any(_is_since_1970((values - day) * SECONDS["d"]) for day in _DAY_1970)
    if not unit and (step >= 1.0 or days):
        warnings.warn(
            f"The time {name!r} of {path.name} has no unit and is taken for seconds, {step:g} s "
            "from sample to sample. Pass 'time_unit' if it counts s, ms, days ('d') or others, or "
            "'sampling_rate' instead of 'time' if it counts samples.",
            TimeUnitWarning,
            stacklevel=6,
        )
    return _counting_on(values) * SECONDS[unit or "s"]


def _is_since_1970(seconds):
    """Whether all times lie between 2001 and 2286, if they count from 1970."""
    finite = seconds[np.isfinite(seconds)]
    return bool(finite.size and np.all((_SINCE_1970[0] <= finite) & (finite < _SINCE_1970[1])))


def times(path, column, unit):
    """Return times in s as floats, or datetimes or timedeltas as a pandas index."""
    name, values = column.name, column.values
    if values.dtype.kind in "biuf":
        return _seconds(path, name, values.astype(float), unit)
    if values.dtype.kind in "Mm":
        return pd.Index(values)
    column = pd.Series(values, dtype=object)
    column = column.mask(is_blank(column), None)
    if coerced(path, name, column).notna().any():
        return _seconds(path, name, numbers(path, name, values), unit)
    # a comma is a decimal one, which pandas would leave out
    column = column.map(_with_point, na_action="ignore")
    clock = _clock(column)
    if clock.notna().any() and (clock.notna() | column.isna()).all():
        in_minutes = _MINUTES.fullmatch(str(column.dropna().iloc[0]).strip())
        return _going_on(pd.TimedeltaIndex(clock), bool(in_minutes))
    with reading(path):
        try:
            dates = pd.to_datetime(column, format="ISO8601", utc=True)
        except (ValueError, TypeError) as error:
            dates = _national_dates(column)
            if dates is None:
                first = str(column.dropna().iloc[0])[:40] if column.notna().any() else ""
                raise RecordError(
                    f"the time {name!r} must be numbers, ISO 8601 dates (2024-05-31T12:00:00.5), "
                    "others that have one meaning (31.05.2024 12:00:00.5) or clock times "
                    f"(hh:mm:ss.fff). It starts with {first!r} instead: write such times, or pass "
                    "'sampling_rate' instead of 'time'"
                ) from error
    dates = pd.DatetimeIndex(dates).tz_localize(None)
    seconds = _count(dates)
    if (np.diff(seconds) > 0.0).any() and (back := _begins_anew(seconds, _HOUR)).any():
        warnings.warn(
            f"The time {name!r} of {path.name} steps back by an hour at row {np.argmax(back)}, as "
            "a local time does when summer time ends: a record begins there. Write the time in UTC "
            "or with its offset if the recording went on.",
            TimeUnitWarning,
            stacklevel=5,
        )
    return dates


def warn_of_rate(path, columns, stamps):
    """Warn if the times of the rows contradict the sampling interval that the file says."""
    seconds = stamps if isinstance(stamps, np.ndarray) else _count(stamps)
    steps = np.diff(seconds)
    steps = steps[steps > 0.0]
    if not steps.size:
        return
    steps = steps[np.abs(steps / np.median(steps) - 1.0) <= JITTER]
    step = steps.mean()  # in which the rounding of all stamps but the first and last cancels
    for interval in sorted({c.interval for c in columns if c.interval is not None}):
        if abs(step / interval - 1.0) > max(_MISMATCH, 2.0 * _ROUNDED / steps.size):
            warnings.warn(
                f"The time of {path.name} advances by {step:.6g} s ({1.0 / step:.6g} Hz), the file "
                f"says {interval:.6g} s ({1.0 / interval:.6g} Hz). The time is taken. Pass "
                f"'sampling_rate={1.0 / interval:.6g}' instead of 'time' if that is right, or "
                "'time_unit' if the unit of the time is another.",
                TimeUnitWarning,
                stacklevel=5,
            )


def are_same_times(path, one, other):
    """Whether two columns of times agree in the rows that both have, up to a tenth of an interval.

    That is how far the stamps of one may be rounded. A clock or a date and a time that counts from
    the start of the recording agree if their differences do.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TimeUnitWarning)  # told where a time is read
        stamps = [times(path, column, None) for column in (one, other)]
    dated = [not isinstance(s, np.ndarray) or _is_since_1970(s) for s in stamps]
    seconds = [s if isinstance(s, np.ndarray) else _count(s) for s in stamps]
    rows = np.isfinite(seconds[0]) & np.isfinite(seconds[1])
    first, second = (s[rows] for s in seconds)
    if len(first) < 2:
        return True
    if dated[0] != dated[1]:
        first, second = first - first[0], second - second[0]
    step = np.median(np.abs(np.diff(first)))
    return bool(np.all(np.abs(first - second) <= _ROUNDED * step))


def _count(stamps):
    """Return datetimes or timedeltas as seconds, NaN where one is missing."""
    origin = pd.Timedelta(0) if stamps.dtype.kind == "m" else pd.Timestamp(0)
    return ((stamps - origin) / pd.Timedelta(seconds=1)).to_numpy()


def _clock(column):
    """Return durations and clock times, not a time where a cell is another text."""
    return pd.to_timedelta(column.map(_duration, na_action="ignore"), errors="coerce")


def _going_on(clock, in_minutes):
    """Return clock times that go on where they step back to begin a day, or 12 hours, anew.

    One of minutes and seconds begins each hour anew.
    """
    seconds = clock.total_seconds().to_numpy()
    steps, hours = np.diff(seconds), np.floor(seconds / _HOUR)
    if not (steps > 0.0).any() or hours.max() >= 24.0:
        return clock
    is_12 = hours.min() >= 1.0 and hours.max() <= 12.0  # 12:59:59 is followed by 1:00:00
    turn = (12.0 if is_12 else 1.0 if in_minutes and hours.max() < 1.0 else 24.0) * _HOUR
    return clock + np.cumsum(_begins_anew(seconds, turn)) * pd.Timedelta(seconds=turn)


def _begins_anew(values, turn):
    """Mark the values that step back to the next sample, modulo a turn."""
    steps = np.diff(values)
    following = steps + turn <= _NEXT * np.median(steps[steps > 0.0])
    return np.append(False, (steps < 0.0) & following)


def _counting_on(values):
    """Return the values of a counter that go on where it overflows.

    It has run before the recording: one that begins at 0 and steps back counts records of 2**16.
    """
    steps = np.diff(values)
    if not (steps < 0.0).any() or not (steps > 0.0).any() or np.any(values % 1.0 != 0.0):
        return values
    turn = 2.0**16 if values.max() < 2.0**16 else 2.0**32
    if values.min() < 0.0 or values.max() >= turn or values[0] < np.median(steps[steps > 0.0]):
        return values
    return values + turn * np.cumsum(_begins_anew(values, turn))


def _with_point(cell):
    """Return a time with a point in place of a comma, or of a colon before the fraction."""
    return _FRACTION.sub(r"\1.\2", cell.replace(",", ".")) if isinstance(cell, str) else cell


def _duration(cell):
    """Return a cell as a duration or a clock time of 24 hours, None if it is another text."""
    if not isinstance(cell, str):
        return cell
    cell = cell.strip()
    if half := _HALF_DAY.fullmatch(cell):
        return f"{int(half[1]) % 12 + 12 * (half[3] in 'Pp')}:{half[2]}"
    if minutes := _MINUTES.fullmatch(cell):
        return f"{int(minutes[1]) // 60}:{int(minutes[1]) % 60:02}:{minutes[2]}"
    return cell if _DURATION.fullmatch(cell) else None


def _national_dates(column):
    """Return dates in a national format, None if several formats give different intervals.

    Of these, the one in which the samples follow each other without a gap is meant, if it alone is:
    05/06 before midnight and 05/07 after it are days in May.
    """
    parses = []
    for options in ({"dayfirst": True}, {"dayfirst": False}):
        with warnings.catch_warnings(record=True) as ambiguities:  # pandas guesses row by row
            warnings.simplefilter("always")
            try:
                dates = pd.to_datetime(column, **options)
            except (ValueError, TypeError):
                continue
        parses += [] if ambiguities else [dates]
    parts = column.map(_date_and_clock, na_action="ignore")
    days, clock = parts.str[0], _clock(parts.str[1])
    for order in _ORDERS if (clock.notna() | column.isna()).all() else ():
        dates = pd.to_datetime(days, format=order.translate(_CODES), errors="coerce") + clock
        parses += [dates] if (dates.notna() | column.isna()).all() else []
    if any(not parses[0].diff().equals(other.diff()) for other in parses[1:]):
        parses = [dates for dates in parses if _has_no_gap(dates)]
    is_unique = parses and all(parses[0].diff().equals(other.diff()) for other in parses[1:])
    return parses[0] if is_unique else None


def _date_and_clock(cell):
    """Return the date of a text, its parts between blanks, and the clock time behind it."""
    found = _DATE.fullmatch(cell.strip()) if isinstance(cell, str) else None
    if not found:
        return "", None
    return " ".join(found.groups()[:3]), _NO_SECONDS.sub(r"\1:00", found[4] or "0:00")


def _has_no_gap(dates):
    steps = dates.dropna().diff().dt.total_seconds().to_numpy()[1:]
    return bool(steps.size and steps.min() > 0.0 and steps.max() <= _NEXT * np.median(steps))


def record_labels(values):
    """Return the labels of records; floats with integer values become integers."""
    if values.dtype.kind == "f" and (values[np.isfinite(values)] % 1.0 == 0.0).all():
        return pd.Index(values).astype("Int64") if np.isnan(values).any() else values.astype(int)
    return values


def by_record(labels, time):
    """Return the order of the rows by their labels, None if time does not rise within a label."""
    rows = pd.factorize(labels)[0]
    order = np.argsort(rows, kind="stable")
    together = np.diff(rows[order]) == 0
    return order if np.all(time[order][1:] > time[order][:-1], where=together) else None


def positions(labels, n):
    """Return the number of each row within its record, from 0."""
    rows = np.arange(n)
    if labels is None:
        return rows
    starts = np.flatnonzero(np.diff(pd.factorize(labels)[0], prepend=-2))
    return rows - np.repeat(starts, np.diff([*starts, n]))


def record_numbers(path, stamps, n):
    """Return a record label for each row: the number of times that time stepped back before it."""
    if stamps is None:
        return np.zeros(n, dtype=int)
    still = np.flatnonzero(stamps[1:] == stamps[:-1]) + 1
    if still.size:
        raise RecordError(
            f"The time of {path.name} does not advance at row {still[0]} ({still.size} of {n} rows "
            "in all): delete rows that are stored twice or, if the stamps are too coarse, pass "
            "'sampling_rate' instead of 'time'."
        )
    restarts = np.append(False, stamps[1:] < stamps[:-1])
    if restarts.sum() > max(n // 4, 1):
        raise RecordError(
            f"The time of {path.name} runs backwards at {restarts.sum()} of {n} rows: the rows are "
            "shuffled, or 'time' names another column. Sort the rows by time."
        )
    return np.cumsum(restarts)
