"""Test signals between levels: steps with rests, first-order reversal curves."""

from itertools import pairwise

import numpy as np

from ._checks import (
    count,
    interval,
    number,
    refuse,
    scalar,
    signal_frame,
    whole,
)

__all__ = ["first_order_reversal_curves", "steps"]


def steps(levels=(0.0, 1.0), *, hold=1.0, rise_time=0.0, dt=1e-3):
    """Levels with rests: what shows creep, drift and ringing.

    Parameters
    ----------
    levels : sequence of float, default=(0.0, 1.0)
        Levels in succession, units of the drive. The first is where the device rests before.
    hold : float or sequence of float of shape (n_levels,), default=1.0
        Time at each level in s, at least one sampling interval.
    rise_time : float, default=0.0
        Time of the straight line from one level to the next in s; below two sampling intervals the
        next level follows within one.
    dt : float, default=1e-3
        Sampling interval in s.

    Returns
    -------
    DataFrame of shape (n_samples, 1)
        Column ``drive``, one record ``0``.

    Raises
    ------
    ValueError
        If a rest is shorter than one interval, or ``levels`` and ``hold`` differ in length.

    Examples
    --------
    >>> from skhyst.datasets import steps
    >>> steps([0.0, 1.0, -1.0], hold=0.2, dt=0.1)["drive"].tolist()
    [0.0, 0.0, 1.0, 1.0, -1.0, -1.0]
    """
    function = "steps"
    dt = interval(function, dt)
    levels = np.atleast_1d(number(function, "levels", levels))
    rests = number(function, "hold", hold, positive=True, size=levels.size)
    n_held = [whole(rest / dt) for rest in rests]
    if min(n_held) < 1:
        refuse(function, "hold", f"at least one sampling interval, dt = {dt:g} s", hold)
    n_rise = max(whole(scalar(function, "rise_time", rise_time, negative=False) / dt), 1)
    # a ramp has n_rise intervals, and the last sample of it is the first at its level
    parts = [np.full(n_held[0], levels[0])]
    for before, level, n in zip(levels[:-1], levels[1:], n_held[1:], strict=True):
        ramp = before + (level - before) * np.arange(1, n_rise) / n_rise
        parts += [ramp, np.full(n, level)]
    return signal_frame([np.concatenate(parts)], dt)


def first_order_reversal_curves(
    amplitude=1.0, n_curves=10, *, rate=1.0, dt=1e-3, offset=0.0, both_sides=False
):
    r"""First-order reversal curves: from saturation to a reversal value and back, again and again.

    The drive goes from rest to ``offset + amplitude``, then for each curve down to its reversal
    value and up again. The reversal values are spaced evenly, the last is ``offset - amplitude``.
    The response on the way up, by reversal value and drive, is what the density of a Preisach model
    is the mixed second derivative of.

    Parameters
    ----------
    amplitude : float, default=1.0
        Deviation from the rest value that saturates, units of the drive; a negative one mirrors
        the curves.
    n_curves : int, default=10
        Number of reversal values.
    rate : float, default=1.0
        Largest slope, units of the drive over s.
    dt : float, default=1e-3
        Sampling interval in s.
    offset : float, default=0.0
        Rest value, units of the drive: the first sample.
    both_sides : bool, default=False
        Whether the mirrored curves, from ``offset - amplitude``, follow.

    Returns
    -------
    DataFrame of shape (n_samples, 1)
        Column ``drive``, one record ``0``. Every turning point is a sample: each branch takes a
        whole number of intervals, so its slope may be a little below ``rate``.

    Raises
    ------
    ValueError
        If the amplitude is zero, or the rate so high that a branch takes less than two intervals.

    References
    ----------
    I. D. Mayergoyz, *Mathematical Models of Hysteresis*, Springer, 1991, chapter 1.

    Examples
    --------
    >>> from skhyst.datasets import first_order_reversal_curves
    >>> X = first_order_reversal_curves(1.0, 2, rate=1.0, dt=0.5)
    >>> X["drive"].tolist()
    [0.0, 0.5, 1.0, 0.5, 0.0, 0.5, 1.0, 0.5, 0.0, -0.5, -1.0, -0.5, 0.0, 0.5, 1.0]
    """
    function = "first_order_reversal_curves"
    dt = interval(function, dt)
    n_curves = count(function, "n_curves", n_curves)
    amplitude = scalar(function, "amplitude", amplitude)
    rate = scalar(function, "rate", rate, positive=True)
    if amplitude == 0.0:
        refuse(function, "amplitude", "other than zero", amplitude)
    step = rate * dt / abs(amplitude)
    if step > 1.0 / n_curves:
        limit = abs(amplitude) / (n_curves * dt)
        refuse(function, "rate", f"at most {limit:g}, for two samples on each branch", rate)
    reversals = 1.0 - 2.0 * np.arange(1, n_curves + 1) / n_curves
    corners = [0.0, 1.0]
    for reversal in reversals:
        corners += [reversal, 1.0]
    if both_sides:
        corners.append(-1.0)
        for reversal in reversals:
            corners += [-reversal, -1.0]
    parts = [np.zeros(1)]
    for a, b in pairwise(corners):
        n = whole(abs(b - a) / step, up=True)
        parts.append(a + (b - a) * np.arange(1, n + 1) / n)
    offset = scalar(function, "offset", offset)
    return signal_frame([offset + amplitude * np.concatenate(parts)], dt)
