r"""What characterises the closed loops of a recording: coercivity, remanence, area, opening.

A cycle goes from a turning point of the drive to the next one of the same kind. It is closed where
the drive is back where it was; one that repeats the cycle before it is closed, too, if the drive
then goes further, as where its amplitude is raised. A drive that jumps from one end to the other
traces no path between them, and so no loop. The path :math:`(u, y)` encloses the area

.. math:: \oint u \, dy = \frac{1}{2} \sum_k (u_k y_{k+1} - u_{k+1} y_k) ,

the work of a cycle where u and y are conjugate, such as a force and a displacement. It is positive
where the path goes counter-clockwise, as that of a response that lags, and negative where it goes
clockwise.

Cycles with the same ends and the same period are repetitions of one loop. A figure is the mean over
them; its standard error is their standard deviation over the square root of their number.
"""

from dataclasses import dataclass
from numbers import Real

import numpy as np
import pandas as pd
from scipy.ndimage import uniform_filter1d
from sklearn.utils.validation import check_array, check_consistent_length

from .._jit import jit
from ..records import record_names, record_slices, with_lost_rows

_LEVELS = 1024  # of the drive, among which the widest opening is looked for
_WINDOW = 1 / 32  # of the drive's range, over which it is a mean: of an ellipse it is 2e-4 less
TOLERANCE = 0.05  # by default, see loop_figures
FIGURES = ("coercivity", "remanence", "area", "opening", "closure")


@dataclass(frozen=True)
class HysteresisLoop:
    """Cycles of one record that repeat each other.

    Parameters
    ----------
    record : object
        Label of the record.
    rows : tuple of (int, int, int)
        Of each cycle: rows of its first, middle and last turning point; none where the record has
        no closed loop.
    dt : float
        Sampling interval.
    time_unit : {"s", "sample"}, default="s"
        Its unit.
    """

    record: object
    rows: tuple
    dt: float
    time_unit: str = "s"

    @property
    def period(self):
        """Mean duration of the cycles."""
        return self.dt * float(np.mean([c - a for a, _, c in self.rows] or [np.nan]))


def loop_figures(X, y, *, center="loop", tolerance=TOLERANCE, skip=0, dt=None) -> pd.DataFrame:
    """Return coercivity, remanence, area, opening and closure of each closed loop.

    Parameters
    ----------
    X : DataFrame or array-like of shape (n_samples, n_inputs) or (n_samples,)
        Column 0 is the drive; the index carries records and time.
    y : array-like of shape (n_samples,)
        Response.
    center : {"loop", "zero"}, default="loop"
        What coercivity and remanence are counted from: the middle of the ranges of drive and
        response in the loop, or zero, as for a loop that is symmetric about it.
    tolerance : float, default=0.05
        Reversals of the drive count that are larger than this part of its range in the record; a
        cycle is closed whose ends differ by less than this part of its own range, and cycles whose
        ends and periods differ by less repeat each other.
    skip : int, default=0
        Cycles that are left out at the beginning of each loop, as they still depend on the earlier
        drive.
    dt : float, default=None
        Sampling interval in s of data without a time index; by default samples are counted.

    Returns
    -------
    DataFrame
        One row per closed loop. Its index has the levels ``record`` and ``loop``; its columns are
        ``low`` and ``high``, the ends of the drive, ``period`` (s, or samples), ``n_cycles``, and

        - ``coercivity``: half of the difference between the drives at which the response passes the
          center, as the drive rises and as it falls. Unit of the drive.
        - ``remanence``: half of the difference between the responses at the center, as the drive
          falls and as it rises. Unit of the response.
        - ``area``: of the loop, unit of the drive times that of the response.
        - ``opening``: difference between the responses as the drive falls and as it rises, where
          that is widest: a mean over 1/32 of the range of the drive. Unit of the response.
        - ``closure``: the response at the end of the cycle minus that at its beginning.

        each followed by its standard error, ``coercivity_std`` and so on, NaN of one cycle. All but
        the closure are positive where the response lags and rises with the drive, and the area,
        the remanence and the opening are negative where the loop goes clockwise. A record without a
        closed loop has a row with ``n_cycles`` 0 and no figures.

    Raises
    ------
    ValueError
        If a parameter is not as above.

    Examples
    --------
    An ellipse: a sine that lags by 0.3 rad.

    >>> import numpy as np
    >>> from skhyst.metrics import loop_figures
    >>> phase = 2 * np.pi * np.arange(4000) / 1000 - np.pi / 2
    >>> found = loop_figures(2.0 * np.sin(phase), 5.0 * np.sin(phase - 0.3))
    >>> found.loc[0, ["coercivity", "remanence", "area"]].round(3).to_numpy()
    array([[0.591, 1.478, 9.284]])
    """
    options = {"center": center, "tolerance": tolerance, "skip": skip, "dt": dt}
    return figures_of(*read_loops(X, y, **options), center)


def read_loops(X, y, *, center="loop", tolerance=TOLERANCE, skip=0, dt=None):
    """Return drive (n,), response (n,) and the loops of a recording; see :func:`loop_figures`.

    Rows that the recording has lost are there too, interpolated.
    """
    if center not in ("loop", "zero"):
        raise ValueError(
            "The 'center' parameter of loop_figures must be 'loop' or 'zero'. Got "
            f"{center!r} instead."
        )
    if not (isinstance(skip, int | np.integer) and skip >= 0):
        raise ValueError(
            "The 'skip' parameter of loop_figures must be an integer of at least 0. Got "
            f"{skip!r} instead."
        )
    if not (isinstance(tolerance, Real) and 0.0 < tolerance < 1.0):
        raise ValueError(
            "The 'tolerance' parameter of loop_figures must be between 0 and 1. Got "
            f"{tolerance!r} instead."
        )
    records = record_slices(X, y, dt=dt, one_interval=False, bridge=True)
    drive = X.iloc[:, 0] if getattr(X, "ndim", 1) == 2 and hasattr(X, "iloc") else np.asarray(X)
    drive = drive[:, 0] if drive.ndim == 2 else drive
    u = check_array(drive, ensure_2d=False, dtype=float, input_name="X")
    y = check_array(y, ensure_2d=False, dtype=float, input_name="y").ravel()
    check_consistent_length(u, y)
    records, u, y, _ = with_lost_rows(records, u, y)
    return u, y, closed_loops(u, records, tolerance, skip)


def figures_of(u, y, loops, center="loop"):
    """Return the figures of loops of a drive and a response; see :func:`loop_figures`."""
    rows, index, n_loops = [], [], {}
    for loop in loops:
        number = n_loops[loop.record] = n_loops.get(loop.record, -1) + 1
        index.append((loop.record, number))
        rows.append(_figures(u, y, loop, center))
    index = pd.MultiIndex.from_tuples(index, names=["record", "loop"])
    return pd.DataFrame(rows, index).astype({"n_cycles": int})


def closed_loops(u, records, tolerance=TOLERANCE, skip=0):
    """Return the loops of all records of a drive, in the order of time.

    A record without a closed loop has one without cycles. The first cycles of each are skipped.
    """
    found = []
    for record, name in zip(records, record_names(records), strict=True):
        start = record.rows.start
        own = u[record.rows]
        groups = _repeated(own, _cycles(own, tolerance), tolerance)
        found += [
            HysteresisLoop(
                name,
                tuple(tuple(start + i for i in cycle) for cycle in cycles[skip:]),
                record.dt,
                record.time_unit,
            )
            for cycles in groups or [()]
        ]
    return found


@jit
def _turning_points(u, least):
    """Return the rows of the turning points that are followed by a reversal of more than least.

    The first and the last one are where the signal begins and ends.
    """
    found = np.empty(u.size + 1, dtype=np.int64)
    count, way, high, low = 0, 0, 0, 0
    for k in range(u.size):
        high = k if u[k] > u[high] else high
        low = k if u[k] < u[low] else low
        if way >= 0 and u[high] - u[k] > least:
            found[count] = high
            count, way, low = count + 1, -1, k
        elif way <= 0 and u[k] - u[low] > least:
            found[count] = low
            count, way, high = count + 1, 1, k
    if way:
        found[count] = high if way > 0 else low
        count += 1
    return found[:count]


def _cycles(u, tolerance):
    """Return the turning points (first, middle, last) of each closed cycle, in order."""
    points = [int(k) for k in _turning_points(u, tolerance * np.ptp(u))]
    best = []
    for first in (0, 1):
        closed = [
            own
            for k in range(first, len(points) - 2, 2)
            if (own := _closed(u, points, k, tolerance)) and _is_traced(u, own)
        ]
        best = closed if len(closed) > len(best) else best
    return best


def _closed(u, points, k, tolerance):
    """Return the cycle from a turning point on, None where it is not closed.

    One that repeats the cycle before ends where the drive passes its beginning and goes further.
    """
    a, b, c = points[k : k + 3]
    size = u[b] - u[a]
    beyond = (u[a] - u[c]) / size
    if abs(beyond) <= tolerance:
        return a, b, c
    if beyond > 0.0 and k and abs(u[points[k - 1]] - u[b]) <= tolerance * abs(size):
        passed = b + int(np.argmax((u[b : c + 1] - u[a]) / size <= 0.0))
        return a, b, min((passed, passed - 1), key=lambda k: abs(u[k] - u[a]))
    return None


def _is_traced(u, cycle):
    """Whether both branches have samples in the middle half of the drive's range."""
    a, b, c = cycle
    middle, size = 0.5 * (u[a] + u[b]), abs(u[b] - u[a])
    parts = u[a : b + 1], u[b : c + 1]
    return all((np.abs(part - middle) < 0.25 * size).any() for part in parts)


def _repeated(u, cycles, tolerance):
    """Return the cycles in groups that have the same ends and the same period."""
    groups = []
    first = np.empty((len(cycles), 4))  # of each group: ends, range, period
    for a, b, c in cycles:
        ends, size, period = first[: len(groups), :2], *first[: len(groups), 2:].T
        away = np.abs(ends - (u[a], u[b])).max(axis=1, initial=0.0)
        alike = away <= tolerance * size
        alike &= np.abs(period - (c - a)) <= np.maximum(tolerance * period, 2.0)
        if alike.any():
            groups[int(np.argmax(alike))].append((a, b, c))
        else:
            first[len(groups)] = u[a], u[b], abs(u[b] - u[a]), c - a
            groups.append([(a, b, c)])
    return groups


def branches(u, y, cycle):
    """Return drive and response of a cycle as the drive rises, and as it falls."""
    a, b, c = cycle
    parts = [(u[i : j + 1], y[i : j + 1]) for i, j in ((a, b), (b, c))]
    return parts if u[a] < u[b] else parts[::-1]


def sections(pair, center="loop"):
    """Return where a cycle is cut through its center, NaN where it does not reach it.

    Parameters
    ----------
    pair : sequence of (ndarray, ndarray)
        Drive and response as the drive rises, and as it falls.
    center : {"loop", "zero"}, default="loop"
        As for :func:`loop_figures`.

    Returns
    -------
    drive, response : float
        The center.
    drives : list of float
        At which the response passes the center, as the drive rises and as it falls.
    responses : list of float
        At the center, as the drive rises and as it falls.
    """
    drive, response = 0.0, 0.0
    ranges = [(min(map(np.min, own)), max(map(np.max, own))) for own in zip(*pair, strict=True)]
    if center == "loop":
        drive, response = (0.5 * (low + high) for low, high in ranges)
    is_reached = ranges[0][0] <= drive <= ranges[0][1]
    responses = [float(response_at(drive, own)) if is_reached else np.nan for own in pair]
    return drive, response, [_passes(response, own) for own in pair], responses


def widest_opening(pairs):
    """Return the drive at which the mean loop of cycles is widest, and the opening of each there.

    It is looked for between the highest of the lower ends and the lowest of the upper ones. The
    opening is a mean over a part of the drive's range, else noise would make it wider.
    """
    low = max(own[0].min() for pair in pairs for own in pair)
    high = min(own[0].max() for pair in pairs for own in pair)
    levels, total = np.linspace(low, high, _LEVELS), 0.0
    for pair in pairs:
        total = total + _opening(levels, pair)
    half = int(0.5 * _WINDOW * _LEVELS)
    widest = int(np.argmax(np.abs(uniform_filter1d(total, 2 * half + 1, mode="nearest"))))
    near = levels[np.clip(np.arange(widest - half, widest + half + 1), 0, _LEVELS - 1)]
    return float(levels[widest]), np.array([_opening(near, pair).mean() for pair in pairs])


def _opening(levels, pair):
    rising, falling = pair
    return response_at(levels, falling) - response_at(levels, rising)


def response_at(level, branch):
    """Return the response of a branch at levels of the drive."""
    u, y = branch
    order = np.argsort(u, kind="stable")
    return np.interp(level, u[order], y[order])


def _passes(level, branch):
    """Return the drive at which the response of a branch passes a level, NaN where it does not."""
    u, y = branch[0], branch[1] - level
    k = np.flatnonzero((y[:-1] < 0.0) != (y[1:] < 0.0))
    if not len(k):
        return np.nan
    return float(np.median(u[k] + (u[k + 1] - u[k]) * y[k] / (y[k] - y[k + 1])))


def _area(u, y):
    """Return the area of a polygon, positive counter-clockwise."""
    u, y = u - u[0], y - y[0]
    return 0.5 * float(u[:-1] @ y[1:] - u[1:] @ y[:-1])


def _figures(u, y, loop, center):
    """Return the figures of a loop by name."""
    cycles = loop.rows
    if not cycles:
        empty = {name: np.nan for figure in FIGURES for name in (figure, f"{figure}_std")}
        return {"low": np.nan, "high": np.nan, "period": loop.period, "n_cycles": 0} | empty
    pairs = [branches(u, y, cycle) for cycle in cycles]
    _, openings = widest_opening(pairs)
    found = np.empty((len(FIGURES), len(cycles)))
    for k, ((start, _, stop), pair) in enumerate(zip(cycles, pairs, strict=True)):
        inside = slice(start, stop + 1)
        _, _, drives, responses = sections(pair, center)
        coercivity, remanence = -0.5 * np.diff(drives)[0], 0.5 * np.diff(responses)[0]
        area, closure = _area(u[inside], y[inside]), y[stop] - y[start]
        found[:, k] = coercivity, remanence, area, openings[k], closure
    ends = np.sort([[u[a], u[b]] for a, b, _ in cycles], axis=1)
    figures = {"low": ends[:, 0].mean(), "high": ends[:, 1].mean()}
    figures |= {"period": loop.period, "n_cycles": len(cycles)}
    n = len(cycles)
    for name, values in zip(FIGURES, found, strict=True):
        figures[name] = values.mean()
        figures[f"{name}_std"] = values.std(ddof=1) / np.sqrt(n) if n > 1 else np.nan
    return figures
