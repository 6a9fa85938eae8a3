r"""What characterises the closed loops of a recording: coercivity, remanence, area, opening.

A cycle goes from a turning point of the drive to the next one of the same kind. It is closed where
the drive is back where it was. Its path :math:`(u, y)` encloses the area

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
from sklearn.utils.validation import check_array, check_consistent_length

from .._jit import jit
from ..records import record_names, record_slices

_LEVELS = 1024  # of the drive, at most, among which the widest opening is looked for
FIGURES = ("coercivity", "remanence", "area", "opening", "closure")


@dataclass(frozen=True)
class Loop:
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
    """

    record: object
    rows: tuple
    dt: float

    @property
    def period(self):
        """Mean duration of the cycles."""
        return self.dt * float(np.mean([c - a for a, _, c in self.rows] or [np.nan]))


def loop_figures(X, y, *, center="loop", tolerance=0.05, skip=0, dt=None) -> pd.DataFrame:
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
        Cycles that are left out at the beginning of each loop, as they still depend on what came
        before.
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
          that is widest. Unit of the response.
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
    u, y, loops = closed_loops(X, y, tolerance=tolerance, dt=dt)
    rows, index, n_loops = [], [], {}
    for loop in loops:
        number = n_loops[loop.record] = n_loops.get(loop.record, -1) + 1
        index.append((loop.record, number))
        rows.append(_figures(u, y, loop, center, skip))
    index = pd.MultiIndex.from_tuples(index, names=["record", "loop"])
    return pd.DataFrame(rows, index).astype({"n_cycles": int})


def closed_loops(X, y, *, tolerance=0.05, dt=None):
    """Return drive (n,), response (n,), and the loops of all records in the order of time.

    A record without a closed loop has one without cycles.
    """
    if not (isinstance(tolerance, Real) and 0.0 < tolerance < 1.0):
        raise ValueError(
            "The 'tolerance' parameter of loop_figures must be between 0 and 1. Got "
            f"{tolerance!r} instead."
        )
    records = record_slices(X, y, dt=dt, one_interval=False)
    u = check_array(X, ensure_2d=False, dtype=float, input_name="X")
    u = u if u.ndim == 1 else np.ascontiguousarray(u[:, 0])
    y = check_array(y, ensure_2d=False, dtype=float, input_name="y").ravel()
    check_consistent_length(u, y)
    found = []
    for record, name in zip(records, record_names(records), strict=True):
        start = record.rows.start
        own = u[record.rows]
        groups = _repeated(own, _cycles(own, tolerance), tolerance)
        found += [
            Loop(name, tuple(tuple(start + i for i in cycle) for cycle in cycles), record.dt)
            for cycles in groups or [()]
        ]
    return u, y, found


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
    points = _turning_points(u, tolerance * np.ptp(u))
    best = []
    for first in (0, 1):
        parts = zip(points[first::2], points[first + 1 :: 2], points[first + 2 :: 2], strict=False)
        closed = [
            (int(a), int(b), int(c))
            for a, b, c in parts
            if abs(u[c] - u[a]) <= tolerance * abs(u[b] - u[a])
        ]
        best = closed if len(closed) > len(best) else best
    return best


def _repeated(u, cycles, tolerance):
    """Return the cycles in groups that have the same ends and the same period."""
    groups = []
    for cycle in cycles:
        for group in groups:
            if _are_alike(u, group[0], cycle, tolerance):
                group.append(cycle)
                break
        else:
            groups.append([cycle])
    return groups


def _are_alike(u, one, other, tolerance):
    size = tolerance * abs(u[one[1]] - u[one[0]])
    ends = max(abs(u[one[i]] - u[other[i]]) for i in range(2))
    periods = [cycle[2] - cycle[0] for cycle in (one, other)]
    return ends <= size and abs(np.subtract(*periods)) <= max(tolerance * periods[0], 2.0)


def branches(u, y, cycle):
    """Return drive and response of a cycle as the drive rises, and as it falls."""
    a, b, c = cycle
    parts = [(u[i : j + 1], y[i : j + 1]) for i, j in ((a, b), (b, c))]
    return parts if u[a] < u[b] else parts[::-1]


def _at(level, branch):
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


def _figures(u, y, loop, center, skip):
    """Return the figures of a loop by name."""
    cycles = loop.rows[skip:]
    if not cycles:
        empty = {name: np.nan for figure in FIGURES for name in (figure, f"{figure}_std")}
        return {"low": np.nan, "high": np.nan, "period": loop.period, "n_cycles": 0} | empty
    pairs = [branches(u, y, cycle) for cycle in cycles]
    ends = np.sort([[u[a], u[b]] for a, b, _ in cycles], axis=1)
    # between the highest of the lower ends and the lowest of the upper ones, at samples of a cycle
    levels = np.unique(np.concatenate([pairs[0][0][0], pairs[0][1][0]]))
    levels = levels[(levels >= ends[:, 0].max()) & (levels <= ends[:, 1].min())]
    levels = levels[np.linspace(0, len(levels) - 1, min(len(levels), _LEVELS)).astype(int)]
    openings = np.array([_at(levels, falling) - _at(levels, rising) for rising, falling in pairs])
    widest = np.argmax(np.abs(openings.mean(axis=0)))
    found = np.empty((len(FIGURES), len(cycles)))
    for k, ((a, _, c), (rising, falling)) in enumerate(zip(cycles, pairs, strict=True)):
        inside = slice(a, c + 1)
        middle = [0.5 * (own[inside].min() + own[inside].max()) for own in (u, y)]
        drive, response = middle if center == "loop" else (0.0, 0.0)
        is_passed = u[inside].min() <= drive <= u[inside].max()
        remanence = 0.5 * (_at(drive, falling) - _at(drive, rising)) if is_passed else np.nan
        coercivity = 0.5 * (_passes(response, rising) - _passes(response, falling))
        area, closure = _area(u[inside], y[inside]), y[c] - y[a]
        found[:, k] = coercivity, remanence, area, openings[k, widest], closure
    figures = {"low": ends[:, 0].mean(), "high": ends[:, 1].mean()}
    figures |= {"period": loop.period, "n_cycles": len(cycles)}
    n = len(cycles)
    for name, values in zip(FIGURES, found, strict=True):
        figures[name] = values.mean()
        figures[f"{name}_std"] = values.std(ddof=1) / np.sqrt(n) if n > 1 else np.nan
    return figures
