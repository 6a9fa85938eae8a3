"""Recordings as they should not be: numbers, containers and indexes that break careless code.

A :class:`Case` names one of each; :func:`cases` is a Hypothesis strategy for them. The same numbers
in another container, and the same records in another index, must give the same model.
"""

import tempfile
from dataclasses import dataclass

import numpy as np
import pandas as pd
from hypothesis import strategies as st

__all__ = ["CONTAINERS", "DT", "INDEXES", "VALUES", "Case", "cases"]

DT, N = 0.01, 48  # s, samples
_LINE = np.arange(N, dtype=float)


def _signal():
    waves = np.sin(np.outer(_LINE, (0.17, 0.41, 1.3)) + (0.3, 1.1, 2.0))
    drive = waves @ (1.0, 0.6, 0.3)
    late = np.convolve(np.maximum(drive, -0.9), 0.3 * 0.7 ** np.arange(N))[:N]
    return drive, late + 0.02 * np.sin(9.0 * _LINE**1.5)


DRIVE, RESPONSE = _signal()
_ZERO = np.zeros(N)


def _with(values, at, value):
    changed = values.copy()
    changed[at:][:1] = value  # of no samples, nothing
    return changed


# drive and response of every case, n samples each
VALUES = {
    "plain": (DRIVE, RESPONSE),
    "whole numbers": (np.round(50.0 * DRIVE) + 100.0, np.round(50.0 * RESPONSE) + 100.0),
    "constant drive": (_ZERO + 2.5, RESPONSE),
    "constant response": (DRIVE, _ZERO - 3.0),
    "both constant": (_ZERO + 2.5, _ZERO - 3.0),
    "no drive": (_ZERO, RESPONSE),
    "no response": (DRIVE, _ZERO),
    "nothing": (_ZERO, _ZERO),
    "signed zeros": (np.copysign(0.0, DRIVE), np.copysign(0.0, RESPONSE)),
    "denormal drive": (5e-324 * np.round(10.0 * DRIVE), RESPONSE),
    "denormal response": (DRIVE, 5e-324 * np.round(10.0 * RESPONSE)),
    "no samples": (DRIVE[:0], RESPONSE[:0]),
    "one sample": (DRIVE[:1], RESPONSE[:1]),
    "two samples": (DRIVE[:2], RESPONSE[:2]),
    "three samples": (DRIVE[:3], RESPONSE[:3]),
    "one step": (np.where(_LINE < 20, 0.0, 1.0), RESPONSE),
    "one impulse": (np.where(_LINE == 20, 1.0, 0.0), RESPONSE),
    "changing sign": ((-1.0) ** _LINE, RESPONSE),
    "a straight line": (_LINE, 2.0 * _LINE),
    "the drive itself": (DRIVE, DRIVE),
    "turned round": (DRIVE, -RESPONSE),
    "far from zero": (DRIVE + 1e9, RESPONSE - 1e9),
    "one outlier": (DRIVE, _with(RESPONSE, 20, 1e12)),
    "one far drive": (_with(DRIVE, 20, -1e12), RESPONSE),
    "many scales": (DRIVE * 10.0 ** (_LINE % 30 - 15), RESPONSE * 10.0 ** (_LINE % 20 - 10)),
    "a drive that is not a number": (_with(DRIVE, 7, np.nan), RESPONSE),
    "a response that is not a number": (DRIVE, _with(RESPONSE, 7, np.nan)),
    "an infinite drive": (_with(DRIVE, -1, np.inf), RESPONSE),
    "an infinite response": (DRIVE, _with(RESPONSE, 0, -np.inf)),
    "1e300": (1e300 * DRIVE, 1e300 * RESPONSE),
    "1e-300": (1e-300 * DRIVE, 1e-300 * RESPONSE),
    "the largest numbers": (np.sign(DRIVE) * 1.79e308, np.sign(RESPONSE) * 1.79e308),
    "1e99 over 1e-99": (1e-99 * DRIVE, 1e99 * RESPONSE),
    "1e-99 over 1e99": (1e99 * DRIVE, 1e-99 * RESPONSE),
}


def _memmap(values):
    if not values.size:
        return values  # no file of nothing is mapped
    with tempfile.NamedTemporaryFile() as file:
        file.write(values.tobytes())
        file.flush()
        return np.memmap(file.name, dtype=values.dtype, mode="r", shape=values.shape)


def _read_only(values):
    values.setflags(write=False)
    return values


def _backwards(values):
    return np.ascontiguousarray(values[::-1])[::-1]


def _spread(values):
    wide = np.full((*values.shape, 3), np.nan)
    wide[..., 1] = values
    return wide[..., 1]


def _swapped(values):
    return values.astype(values.dtype.newbyteorder())


def _pandas(dtype):
    def contain(values):
        if values.ndim == 1:
            return pd.Series(values).astype(dtype)
        return pd.DataFrame(values, columns=[f"c{i}" for i in range(values.shape[1])]).astype(dtype)

    return contain


def _with_missing(values):
    frame = _pandas("Float64")(values)
    frame.iloc[len(frame) // 2 :] = pd.NA
    return frame


def _polars(values):
    import polars

    if values.ndim == 1:
        return polars.Series("y", values)
    return polars.DataFrame({f"c{i}": column for i, column in enumerate(values.T)})


def _sparse(values):
    from scipy.sparse import csr_array

    return csr_array(np.atleast_2d(values))


# what holds the same numbers, but for rounding to its own type; a third dimension, a phase or
# letters are no numbers of theirs and must be refused
CONTAINERS = {
    "float64": np.array,
    "float32": lambda a: a.astype(np.float32),
    "float16": lambda a: a.astype(np.float16),
    "long double": lambda a: a.astype(np.longdouble),
    "other byte order": _swapped,
    "int64": lambda a: np.round(a).astype(np.int64),
    "int8": lambda a: np.round(a % 100).astype(np.int8),
    "uint8": lambda a: np.round(np.abs(a)).astype(np.uint8),
    "bool": lambda a: a > 0.5,
    "object": lambda a: a.astype(object),
    "list": lambda a: a.tolist(),
    "tuple": lambda a: tuple(map(tuple, a.tolist())) if a.ndim > 1 else tuple(a.tolist()),
    "memmap": _memmap,
    "read-only": lambda a: _read_only(a.copy()),
    "Fortran": np.asfortranarray,
    "backwards": _backwards,
    "spread": _spread,
    "masked": lambda a: np.ma.masked_array(a, mask=False),
    "frame": _pandas("float64"),
    "frame, float32": _pandas("float32"),
    "frame, Float64": _pandas("Float64"),
    "frame, Int64": lambda a: _pandas("Int64")(np.round(a).astype(np.int64)),
    "frame, boolean": lambda a: _pandas("boolean")(a > 0.5),
    "frame, object": _pandas("object"),
    "frame, double[pyarrow]": _pandas("double[pyarrow]"),
    "frame, int64[pyarrow]": lambda a: _pandas("int64[pyarrow]")(np.round(a).astype(np.int64)),
    "polars": _polars,
    "numbers as text": lambda a: a.astype(str),
    "frame with NA": _with_missing,
    "complex": lambda a: a + 1j,
    "text": lambda a: np.full(a.shape, "volt"),
    "categories": lambda a: _pandas("category")(np.round(a)),
    "times": lambda a: np.round(1e9 * a).astype("M8[ns]"),
    "sparse": _sparse,
    "three dimensions": lambda a: a.reshape(*a.shape, 1) if a.ndim > 1 else a.reshape(-1, 1, 1),
    "None": lambda a: None,
    "a number": lambda a: 1.5,
    "shorter": lambda a: a[:-1],
    "a column": lambda a: a.reshape(-1, 1),
    "frame of a column": lambda a: pd.DataFrame({"y": a.ravel()}),
    "two columns": lambda a: np.column_stack([a, a]),
    "one dimension": lambda a: a.ravel(),
    "a row": lambda a: a.reshape(1, -1),
    "dictionary": lambda a: {"drive": a.tolist()},
    "generator": lambda a: (row for row in a),
}
_NUMBERS = tuple(CONTAINERS)[: tuple(CONTAINERS).index("polars") + 1]


def _records(labels, times):
    return pd.MultiIndex.from_arrays([labels, times], names=["record", "time"])


def _counted(n, length):
    return np.arange(n) // length


def _day(n, start, zone=None):
    return pd.date_range(start, periods=n, freq="10ms", tz=zone)


def _local(n):
    """Return local times around the end of summer time, which go back by an hour."""
    return _day(n, "2024-10-27 00:59:59.800", "UTC").tz_convert("Europe/Berlin").tz_localize(None)


def _jitter(n):
    """Return what is next to a clock, a tenth of an interval, but for the first and last sample."""
    return 0.1 * DT * np.sin(np.arange(n) * (n - 1.0 - np.arange(n)))


# index of n rows, and the record and time (s) that it says; None where there is no such thing
INDEXES = {
    "none": lambda n: (None, None),
    "seconds": lambda n: (pd.Index(DT * np.arange(n)), (np.zeros(n), DT * np.arange(n))),
    "seconds, float32": lambda n: (
        pd.Index((DT * np.arange(n)).astype(np.float32)),
        (np.zeros(n), DT * np.arange(n)),
    ),
    "seconds, Float64": lambda n: (
        pd.Index(DT * np.arange(n), dtype="Float64"),
        (np.zeros(n), DT * np.arange(n)),
    ),
    "seconds, pyarrow": lambda n: (
        pd.Index(DT * np.arange(n), dtype="double[pyarrow]"),
        (np.zeros(n), DT * np.arange(n)),
    ),
    "negative seconds": lambda n: (
        pd.Index(DT * np.arange(n) - 0.2),
        (np.zeros(n), DT * np.arange(n)),
    ),
    "rounded seconds": lambda n: (
        pd.Index(np.round(DT * np.arange(n) + _jitter(n), 4)),
        (np.zeros(n), DT * np.arange(n)),
    ),
    "since 1970": lambda n: (
        pd.Index(1.7e9 + DT * np.arange(n)),
        (np.zeros(n), DT * np.arange(n)),
    ),
    "dates": lambda n: (_day(n, "2024-02-29"), (np.zeros(n), DT * np.arange(n))),
    "dates, ms": lambda n: (
        _day(n, "2024-02-29").as_unit("ms"),
        (np.zeros(n), DT * np.arange(n)),
    ),
    "dates, summer time begins": lambda n: (
        _day(n, "2024-03-31 01:59:59.8", "Europe/Berlin"),
        (np.zeros(n), DT * np.arange(n)),
    ),
    "dates, summer time ends": lambda n: (
        _day(n, "2024-10-27 00:59:59.800", "UTC").tz_convert("Europe/Berlin"),
        (np.zeros(n), DT * np.arange(n)),
    ),
    "dates, pyarrow": lambda n: (
        _day(n, "2024-02-29").astype("timestamp[ns][pyarrow]"),
        (np.zeros(n), DT * np.arange(n)),
    ),
    "local dates, summer time ends": lambda n: (
        _local(n),
        (np.arange(n) >= 20, DT * np.arange(n)),
    ),
    "durations": lambda n: (
        pd.to_timedelta(DT * np.arange(n), unit="s"),
        (np.zeros(n), DT * np.arange(n)),
    ),
    "two records": lambda n: (
        _records(_counted(n, 24), DT * (np.arange(n) % 24)),
        (_counted(n, 24), DT * (np.arange(n) % 24)),
    ),
    "levels the other way round": lambda n: (
        _records(_counted(n, 24), DT * (np.arange(n) % 24)).swaplevel(),
        (_counted(n, 24), DT * (np.arange(n) % 24)),
    ),
    "records in text": lambda n: (
        _records(np.array(["a", "b", "c"])[_counted(n, 16)], DT * (np.arange(n) % 16)),
        (_counted(n, 16), DT * (np.arange(n) % 16)),
    ),
    "records of categories": lambda n: (
        _records(
            pd.Categorical(np.array(["b", "a", "b"])[_counted(n, 16)], categories=["c", "b", "a"]),
            DT * np.arange(n),
        ),
        (_counted(n, 16), DT * (np.arange(n) % 16)),
    ),
    "records of dates": lambda n: (
        _records(
            pd.to_datetime(["2024-01-01", "2023-01-01"], utc=True)[_counted(n, 24)],
            _day(n, "2024-01-01", "Asia/Kathmandu"),
        ),
        (_counted(n, 24), DT * (np.arange(n) % 24)),
    ),
    "records repeat": lambda n: (
        _records(np.array(["a", "b", "a"])[_counted(n, 16)], DT * (np.arange(n) % 16)),
        (_counted(n, 16), DT * (np.arange(n) % 16)),
    ),
    "records without a name": lambda n: (
        pd.MultiIndex.from_arrays([_counted(n, 24), DT * (np.arange(n) % 24)]),
        (_counted(n, 24), DT * (np.arange(n) % 24)),
    ),
    "records among others": lambda n: (
        _records(np.r_[_counted(n, 24), [7, 7]], np.r_[DT * (np.arange(n) % 24), [0.0, np.nan]])[
            :n
        ],
        (_counted(n, 24), DT * (np.arange(n) % 24)),
    ),
    "records of three": lambda n: (
        _records(_counted(n, 3), DT * (np.arange(n) % 3)),
        (_counted(n, 3), DT * (np.arange(n) % 3)),
    ),
    "records of two": lambda n: (
        _records(_counted(n, 2), DT * (np.arange(n) % 2)),
        (_counted(n, 2), DT * (np.arange(n) % 2)),
    ),
    "a hole": lambda n: (
        pd.Index(DT * np.arange(n) + 5.0 * (np.arange(n) >= 20)),
        (np.arange(n) >= 20, DT * np.arange(n)),
    ),
    "a lost row": lambda n: (
        pd.Index(DT * (np.arange(n) + (np.arange(n) >= 20))),
        (np.zeros(n), DT * (np.arange(n) + (np.arange(n) >= 20))),
    ),
    "dates, a lost row": lambda n: (
        _day(n + 1, "2024-02-29")[np.arange(n) + (np.arange(n) >= 20)],
        (np.zeros(n), DT * (np.arange(n) + (np.arange(n) >= 20))),
    ),
    "counted, a lost row": lambda n: (
        pd.Index(np.arange(n) + (np.arange(n) >= 20)),
        (np.zeros(n), DT * (np.arange(n) + (np.arange(n) >= 20))),
    ),
    "it restarts": lambda n: (
        pd.Index(DT * (np.arange(n) % 24)),
        (_counted(n, 24), DT * (np.arange(n) % 24)),
    ),
    "records of one": lambda n: (_records(np.arange(n), np.zeros(n)), None),
    "counted": lambda n: (pd.Index(np.arange(7, n + 7)), (np.zeros(n), DT * np.arange(n))),
    "counted, Int64": lambda n: (
        pd.Index(np.arange(n), dtype="Int64"),
        (np.zeros(n), DT * np.arange(n)),
    ),
    "counted, uint8": lambda n: (
        pd.Index(np.arange(n, dtype=np.uint8)),
        (np.zeros(n), DT * np.arange(n)),
    ),
    "every second": lambda n: (pd.RangeIndex(0, 2 * n, 2), None),
    "down": lambda n: (pd.RangeIndex(n, 0, -1), None),
    "objects": lambda n: (pd.Index((DT * np.arange(n)).tolist(), dtype=object), None),
    "the same time": lambda n: (pd.Index(np.zeros(n)), None),
    "a time twice": lambda n: (pd.Index(DT * (np.arange(n) - (np.arange(n) >= 20))), None),
    "shuffled": lambda n: (pd.Index(DT * np.random.default_rng(0).permutation(n)), None),
    "backwards": lambda n: (pd.Index(DT * np.arange(n)[::-1]), None),
    "no time": lambda n: (_day(n, "2024-01-01").where(np.arange(n) != n // 2), None),
    "time is not a number": lambda n: (pd.Index(_with(DT * np.arange(n), n // 2, np.nan)), None),
    "time is infinite": lambda n: (pd.Index(_with(DT * np.arange(n), n - 1, np.inf)), None),
    "no record": lambda n: (
        _records(pd.Index(["a", None])[(np.arange(n) >= n // 2).astype(int)], DT * np.arange(n)),
        None,
    ),
    "uneven": lambda n: (pd.Index(DT * np.arange(n) ** 1.1), None),
    "text": lambda n: (pd.Index([f"row {i}" for i in range(n)]), None),
    "true and false": lambda n: (pd.Index(np.arange(n) % 2 == 0), None),
    "complex": lambda n: (pd.Index(DT * np.arange(n) + 1j), None),
    "periods": lambda n: (pd.period_range("2024-01-01", periods=n, freq="s"), None),
    "intervals": lambda n: (pd.interval_range(0, n), None),
    "categories": lambda n: (pd.CategoricalIndex(DT * np.arange(n)), None),
    "three levels": lambda n: (
        pd.MultiIndex.from_arrays([np.zeros(n), np.zeros(n), DT * np.arange(n)]),
        None,
    ),
    "one level": lambda n: (pd.MultiIndex.from_arrays([DT * np.arange(n)]), None),
    "1e-300 s": lambda n: (pd.Index(1e-300 * np.arange(n)), None),
    "1e300 s": lambda n: (pd.Index(1e300 * np.arange(n)), None),
    "denormal seconds": lambda n: (pd.Index(5e-324 * np.arange(n)), None),
    "the largest integers": lambda n: (pd.Index(np.iinfo(np.int64).max - n + np.arange(n)), None),
    "unsigned integers": lambda n: (
        pd.Index(np.iinfo(np.uint64).max - np.uint64(n) + np.arange(n, dtype=np.uint64)),
        None,
    ),
}
_RECORDS = tuple(name for name, index in INDEXES.items() if index(N)[1] is not None)


@dataclass(frozen=True)
class Case:
    """What is given to an estimator, by the names of this module's tables.

    ``drive_scale`` and ``response_scale`` are powers of two.
    """

    values: str = "plain"
    container: str = "float64"
    response: str = "float64"
    index: str = "none"
    drive_scale: int = 0
    response_scale: int = 0
    n_further: int = 0

    def numbers(self):
        """Return the drive with further columns, (n_samples, n_inputs), and the response."""
        drive, response = VALUES[self.values]
        with np.errstate(all="ignore"):
            drive = np.ldexp(drive, self.drive_scale)
            response = np.ldexp(response, self.response_scale)
        further = (np.roll(drive, 3 + i) for i in range(self.n_further))
        return np.column_stack([drive, *further]), response

    def given(self):
        """Return X and y as the case has them."""
        X, y = self.numbers()
        with np.errstate(all="ignore"):
            X, y = CONTAINERS[self.container](X), CONTAINERS[self.response](y)
        index = INDEXES[self.index](len(self.numbers()[1]))[0]
        if index is not None:
            if not hasattr(X, "iloc") and isinstance(X, np.ndarray) and X.ndim == 2:
                X = pd.DataFrame(X, columns=[f"c{i}" for i in range(X.shape[1])])
            if hasattr(X, "set_axis") and len(X) == len(index):
                X = X.set_axis(index)
            if isinstance(y, pd.Series) and len(y) == len(index):
                y = y.set_axis(index)
        return X, y

    def told(self):
        """Return X and y as a plain frame and an array, or None where they are no such thing."""
        if not {self.container, self.response} <= set(_NUMBERS):
            return None
        if self.index != "none" and not hasattr(self.given()[0], "iloc"):
            return None  # it has not taken the index
        X, y = self.numbers()
        with np.errstate(all="ignore"):
            X = np.array(CONTAINERS[self.container](X), dtype=float).reshape(X.shape)
            y = np.array(CONTAINERS[self.response](y), dtype=float)
        X = pd.DataFrame(X, columns=[f"c{i}" for i in range(X.shape[1])])
        if self.index == "none":
            return X, y
        index = INDEXES[self.index](len(y))[1]
        if index is None or len(y) == 1:  # one time tells no interval
            return None
        return X.set_axis(_records(*index)), y


def _mostly(usual, table):
    return st.one_of(st.just(usual), st.just(usual), st.sampled_from(tuple(table)))


def cases():
    """Return a strategy for cases, of which most are odd in one or two ways."""
    powers = st.one_of(
        st.just(0), st.just(0), st.sampled_from((-1000, -330, -100, -20, 20, 100, 330, 1000))
    )
    return st.builds(
        Case,
        _mostly("plain", VALUES),
        _mostly("float64", CONTAINERS),
        _mostly("float64", CONTAINERS),
        _mostly("none", INDEXES),
        powers,
        powers,
        st.sampled_from((0, 0, 0, 2)),
    )
