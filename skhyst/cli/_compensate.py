"""`skhyst compensate`: the drive under which a fitted model follows a reference."""

import warnings

import numpy as np
import pandas as pd

from .._files import check_outputs, replacing
from ..base import behind_gaps
from ..control import InverseCompensator
from ..datasets import from_rest_to_rest
from ..exceptions import ReachWarning
from ..io import inspect_columns
from ..persistence import load_model
from ..records import read_records, record_slices, resample_records

_LAYOUT = "time_unit", "on_missing", "missing_code", "delimiter", "decimal"


def compensate(options):
    """Write the drive, and report the error of the model's response."""
    check_outputs([options.output], [options.model, options.file], force=options.force)
    model = load_model(options.model, options.trust)
    X, _ = read_records(options.file, **_reading(options))
    if options.resample is not None:
        X = resample_records(X, dt=options.resample)
    reference = X.iloc[:, 0]
    intervals = _intervals(X)
    fitted = None if options.no_limits else "fit"
    compensator = InverseCompensator(
        model,
        bandwidth=options.bandwidth,
        drive_limits=fitted if options.limits is None else options.limits,
        rate_limit=fitted if options.rate_limit is None else options.rate_limit,
        limit_margin=options.limit_margin,
        max_residual=options.max_residual,
    ).fit(X, reference)  # the model is fitted already: X and the reference are only validated
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ReachWarning)
        drive, residual = compensator.predict(X, return_residual=True)
    fraction, worst, record = compensator.largest_miss(X, residual)
    (low, high), rate = compensator.drive_limits_, compensator.rate_limit_
    print(f"limits of the drive: {low:.6g} to {high:.6g}, {rate:.6g} per s")
    where = "" if record is None else f", record {record}"
    part = f"{100.0 * fraction:.3g} % of the range{where}"
    print(f"largest residual of the model: {worst:.4g} ({part})")
    error = getattr(compensator.model_, "fit_error_", np.nan)  # a saved model may not know it
    print(f"root mean square error of the model in its fit: {error:.4g}")
    for message in dict.fromkeys(str(warning.message) for warning in caught):
        print(message)
    try:
        _refuse(options, compensator, worst, fraction)
    except ValueError as refusal:
        if not options.force:
            raise
        print(f"overridden by --force: {refusal}")
    rate = rate if np.isfinite(rate) else None
    parts = pd.Series(drive, X.index).groupby(level="record", sort=False)
    ends = options.rest, rate
    table = pd.concat([_from_rest(name, part, intervals[name], *ends) for name, part in parts])
    single = table["record"].nunique() == 1
    with replacing(options.output) as (part,):
        table.drop(columns="record" if single else []).to_csv(part, index=False)
    print(f"written: {options.output}")


def _reading(options):
    """Return the parameters of read_records: by default, time and reference are the first columns.

    A column whose name says that it labels the records is neither.
    """
    names = *_LAYOUT, "time", "record", "sampling_rate"
    reading = {name: getattr(options, name) for name in names} | {"drive": options.reference}
    if None not in (reading["drive"], reading["time"]):
        return reading
    layout = {name: getattr(options, name) for name in ("delimiter", "decimal")}
    _, columns, *_ = inspect_columns(options.file, **layout)
    free = [k for k, column in enumerate(columns) if column.role != "record"]
    if options.record is None and len(free) < len(columns):
        reading["record"] = next(k for k in range(len(columns)) if k not in free)
    for role in ("time", "drive"):
        if reading[role] is None and not (role == "time" and options.sampling_rate is not None):
            if not free:
                raise ValueError(
                    f"{options.file.name} must have a column of the time and one of the reference. "
                    f"Got {[column.name for column in columns]} alone: give 'sampling_rate' "
                    "in place of the time."
                )
            reading[role] = free.pop(0)
    return reading


def _intervals(X):
    """Return the sampling interval of each record; refuse gaps, in which a drive would jump."""
    slices, time = record_slices(X), X.index.get_level_values("time")
    for number in behind_gaps(slices):
        before, after = (time[slices[number].rows.start - k] for k in (1, 0))
        raise ValueError(
            f"No drive is written: the reference has a gap of {after - before:.6g} s behind the "
            f"time {before:.6g}, in which the drive would jump. Fill it, or give its parts as "
            "records of their own."
        )
    return {s.label: s.dt for s in slices}


def _from_rest(record, drive, dt, rest, rate):
    """Return the rows of a record with ramps from the rest of the amplifier and back."""
    time = drive.index.get_level_values("time").to_numpy()
    values, n_before = from_rest_to_rest(drive, dt, rest, rate_limit=rate)
    n_after = len(values) - n_before - len(time)
    before = time[0] - dt * np.arange(n_before, 0, -1)
    after = time[-1] + dt * np.arange(1, n_after + 1)
    time = np.concatenate([before, time, after])
    return pd.DataFrame({"record": record, "time": time, "drive": values})


def _refuse(options, compensator, worst, fraction):
    """Raise a ValueError if the drive has no known limits, leaves them, or misses too much."""
    known = hasattr(compensator, "drive_range_")
    (low, high), rest = compensator.drive_limits_, options.rest
    if rest is not None and not low <= rest <= high:
        raise ValueError(
            f"{options.output} is not written: the rest of the amplifier, {rest:g} (--rest), is "
            f"not within the limits of the drive, {low:.6g} to {high:.6g}. Give the limits of the "
            "amplifier (--limits), or write it all the same with --force."
        )
    if not (known or options.no_limits or options.limits):
        raise ValueError(
            f"{options.output} is not written: the model, of an earlier version, does not know the "
            "range of the drive of its fit. Give the limits of the amplifier (--limits), or "
            "disable them (--no-limits)."
        )
    if not fraction <= options.max_residual:
        raise ValueError(
            f"{options.output} is not written: by the model, the device would miss the reference "
            f"by up to {worst:.4g} ({100.0 * fraction:.3g} % of its range), more than "
            f"{100.0 * options.max_residual:g} % (--max-residual). Ask for less, let the reference "
            "rest at its beginning, widen the limits (--limits, --rate-limit, --limit-margin), or "
            "write it all the same with --force."
        )
