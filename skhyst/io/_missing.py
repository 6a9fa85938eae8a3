"""Missing values: find them, report them, refuse or drop their rows."""

import re

import numpy as np
import pandas as pd

from ..exceptions import RecordError

_LIKELY = re.compile(r"9{3,}(\.9+)?|1e\+?\d\d+|9\.9\d*e\+\d\d+")  # -9999, 999.9, 1e30, 9.91e37
_NO_READING = re.compile(  # as files and instruments write it
    r"[-–—*?.\s]*|[+-]?nan|n/?a|<na>|null|none|no data|[+-]?(inf|∞)|#(n/a|div/0!|num!|ref!|value!)"
    r"|ol|ovld?|ovr|over(flow|load|range)",
    re.IGNORECASE,
)
_FAR = 5.0  # a code is at least this many times as large as any other reading


def marks_missing(cell):
    """Whether a cell of text stands for no reading: blank, dashes, NaN, OL."""
    return bool(_NO_READING.fullmatch(cell))


def missing_rows(path, values, names, codes, stamps, labels, on_missing):
    """Mark missing values as NaN, in place, and return a mask of the rows to keep.

    ``codes`` (n_columns,) are values that stand for missing readings, NaN for a column without one.
    Rows without a time (``stamps``) or a record (``labels``), each None or (n_samples,), cannot be
    interpolated: they are refused unless they are dropped.
    """
    values[~np.isfinite(values) | (values == codes)] = np.nan
    missing = dict(zip(names, np.isnan(values).T, strict=True))
    index = {}
    if stamps is not None:
        unclear = pd.isna(stamps)
        index["the time"] = unclear | np.isinf(stamps) if stamps.dtype.kind == "f" else unclear
    if labels is not None:
        index["the record"] = pd.isna(labels)
    refused = {"raise": {**missing, **index}, "drop": {}, "interpolate": index}[on_missing]
    refused = {name: mask for name, mask in refused.items() if mask.any()}
    if refused:
        listed = "; ".join(f"{n}: {describe_rows(np.flatnonzero(m))}" for n, m in refused.items())
        named = ["drop"] if index.keys() & refused.keys() else ["drop", "interpolate"]
        policies = " or ".join(f"on_missing={policy!r}" for policy in named)
        raise RecordError(
            f"{path.name}, of {len(values)} rows, lacks values. {listed}. Pass "
            f"{policies}, or correct the file."
        )
    keep = np.ones(len(values), dtype=bool)
    if on_missing == "drop":
        keep = ~np.logical_or.reduce([*missing.values(), *index.values()])
        keep &= ~_alone(keep, stamps, labels)
    if not keep.any():
        raise RecordError(f"{path.name} has no two neighbouring rows without a missing value.")
    return keep


def _alone(keep, stamps, labels):
    """Return a mask of the rows whose neighbours in the same record are all dropped."""
    joined = np.ones(len(keep) - 1, dtype=bool)  # whether a row and the next are of one record
    if stamps is not None:
        joined &= ~(stamps[1:] < stamps[:-1])  # a row without a time may belong to either side
    if labels is not None:
        codes = pd.factorize(labels)[0]
        joined &= (np.diff(codes) == 0) | (codes[1:] < 0) | (codes[:-1] < 0)
    before, after = np.append(False, joined), np.append(joined, False)
    lost_before, lost_after = np.append(False, ~keep[:-1]), np.append(~keep[1:], False)
    next_to_lost = before & lost_before | after & lost_after
    next_to_kept = before & ~lost_before | after & ~lost_after
    return next_to_lost & ~next_to_kept


def likely_codes(path, values, names, on_missing):
    """Return the probable code of missing readings of each column (n_columns,), NaN for none.

    A code is a value such as -9999 or 1e30, far from all others. It is refused with
    ``on_missing="raise"``.
    """
    codes = np.full(len(names), np.nan)
    for i, column in enumerate(values.T):
        finite = column[np.isfinite(column)]
        for code in {np.min(finite), np.max(finite)} if finite.size else ():
            others = finite[finite != code]
            if not others.size or not _LIKELY.fullmatch(f"{abs(code):.15g}"):
                continue
            low, high = np.min(others), np.max(others)
            if abs(code) / _FAR <= max(-low, high):
                continue
            if on_missing == "raise":
                raise RecordError(
                    f"The reading {code:.15g} of {names[i]!r} in {path.name}, "
                    f"{finite.size - others.size} of {len(column)} rows, lies far from all others "
                    f"({low:g} to {high:g}). Pass on_missing='interpolate' or on_missing='drop' "
                    "if it marks missing readings, missing_code=nan if it is a reading."
                )
            codes[i] = code
    return codes


def describe_rows(rows, most=5) -> str:
    """Return the number of rows and the first few of them, as in ``"3 row(s) (4, 7, 9)"``."""
    shown = ", ".join(str(row) for row in rows[:most])
    return f"{len(rows)} row(s) ({shown}{', ...' if len(rows) > most else ''})"
