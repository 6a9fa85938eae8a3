"""Test signals that are known in closed form: triangles, sines, sweeps, steps, reversal curves."""

from itertools import pairwise

import numpy as np
import pandas as pd

from .._documentation import documented_like
from . import _checks as check


def triangle(
    amplitude=1.0, frequency=1.0, *, n_cycles=1, dt=1e-3, offset=0.0, unipolar=False
) -> pd.DataFrame:
    r"""Triangles, with a programme of amplitudes and frequencies.

    Stretch :math:`i` has ``n_cycles[i]`` whole cycles of ``amplitude[i]`` and ``frequency[i]``, and
    the next begins where it ends, at the rest value: the phase is continuous.

    Parameters
    ----------
    amplitude, frequency : float or sequence of float, default=1.0
        Largest deviation from the rest value, units of the drive (a negative one starts downwards),
        and Hz.
    n_cycles : int or sequence of int, default=1
        Cycles of each stretch.
    dt : float, default=1e-3
        Sampling interval in s.
    offset : float, default=0.0
        Rest value, units of the drive: the first sample.
    unipolar : bool, default=False
        Whether the drive stays between ``offset`` and ``offset + amplitude``.

    Returns
    -------
    DataFrame of shape (n_samples, 1)
        Column ``drive``, one record ``0``; the end of the last cycle is left out.

    Raises
    ------
    ValueError
        If the programmes differ in length, a number of cycles is not whole, or a frequency is not
        below half the sampling rate.

    See Also
    --------
    sine : Smooth turning points.
    first_order_reversal_curves : Nested branches.

    Examples
    --------
    >>> from skhyst.datasets import triangle
    >>> X = triangle([1.0, 2.0], 1.0, n_cycles=1, dt=0.25)
    >>> X["drive"].tolist()
    [0.0, 1.0, 0.0, -1.0, 0.0, 2.0, 0.0, -2.0]
    """
    phase, height = _programme("triangle", amplitude, frequency, n_cycles, dt)
    phase = phase % 1.0
    if unipolar:
        shape = 1.0 - np.abs(1.0 - 2.0 * phase)
    else:
        shape = np.where(phase < 0.75, 1.0 - np.abs(4.0 * phase - 1.0), 4.0 * phase - 4.0)
    offset = check.scalar("triangle", "offset", offset)
    return check.signal_frame([offset + height * shape], dt)


@documented_like(triangle)
def sine(
    amplitude=1.0, frequency=1.0, *, n_cycles=1, dt=1e-3, offset=0.0, unipolar=False
) -> pd.DataFrame:
    r"""Sines, with a programme of amplitudes and frequencies.

    .. math:: u = u_0 + a \sin 2 \pi \phi \quad\text{or, to one side,}\quad
       u = u_0 + \tfrac{a}{2} (1 - \cos 2 \pi \phi)

    The phase :math:`\phi` grows with the frequency of its stretch and has no jumps.

    See Also
    --------
    triangle : Constant rates.
    swept_sine : The frequency changes continuously.

    Examples
    --------
    >>> from skhyst.datasets import sine
    >>> X = sine(2.0, [1.0, 10.0], n_cycles=[1, 5], dt=0.01)
    >>> len(X), round(float(X["drive"].max()), 3)
    (150, 2.0)
    """
    phase, height = _programme("sine", amplitude, frequency, n_cycles, dt)
    angle = 2.0 * np.pi * (phase % 1.0)
    shape = 0.5 * (1.0 - np.cos(angle)) if unipolar else np.sin(angle)
    return check.signal_frame([check.scalar("sine", "offset", offset) + height * shape], dt)


def _programme(function, amplitude, frequency, n_cycles, dt):
    """Return the phase in cycles and the amplitude at each sample."""
    dt, size = check.interval(function, dt), max(map(np.size, (amplitude, frequency, n_cycles)))
    amplitude = check.number(function, "amplitude", amplitude, size=size)
    frequency = check.number(function, "frequency", frequency, positive=True, size=size)
    cycles = check.number(function, "n_cycles", n_cycles, positive=True, size=size)
    if np.any(cycles != np.round(cycles)):
        check.refuse(function, "n_cycles", "a whole number, or whole numbers", n_cycles)
    check.refuse_aliasing(function, "frequency", frequency, dt)
    ends = np.concatenate([[0.0], np.cumsum(cycles / frequency)])
    n_samples = check.whole(ends[-1] / dt, up=True)
    # rounding must not move the first sample of a part to the end of the previous one
    time = dt * np.arange(n_samples)
    stretch = np.searchsorted(ends[1:] / dt * (1.0 - 1e-12), np.arange(n_samples), side="right")
    stretch = np.minimum(stretch, size - 1)
    phase = np.maximum((time - ends[stretch]) * frequency[stretch], 0.0)
    return phase, amplitude[stretch]


@documented_like(triangle)
def swept_sine(
    start_frequency,
    stop_frequency,
    *,
    duration=1.0,
    amplitude=1.0,
    dt=1e-3,
    offset=0.0,
    phase=0.0,
    spacing="linear",
) -> pd.DataFrame:
    r"""A sine whose frequency moves from one value to another.

    .. math:: u = u_0 + a \sin\bigl(2 \pi \textstyle\int_0^t f + \varphi\bigr), \quad
       f = f_0 + (f_e - f_0)\,t / T \quad\text{or}\quad f = f_0\,(f_e / f_0)^{t / T}

    Parameters
    ----------
    start_frequency, stop_frequency : float
        Frequencies at the start and at the end, Hz.
    duration : float, default=1.0
        :math:`T` in s.
    amplitude : float, default=1.0
        Largest deviation from the rest value, units of the drive.
    offset : float, default=0.0
        Rest value, units of the drive.
    phase : float, default=0.0
        Phase at the start, rad. With 0 the drive starts at the rest value.
    spacing : {"linear", "logarithmic"}, default="linear"
        Equally many Hz, or octaves, a second.

    Returns
    -------
    DataFrame of shape (n_samples, 1)
        Column ``drive``, one record ``0``; start and end are included.

    Raises
    ------
    ValueError
        If a frequency is negative or not below half the sampling rate.

    See Also
    --------
    multisine : All frequencies at once.

    References
    ----------
    Han et al., *An Identification Method for Dynamic Systems with SCNs Hysteresis Compensator*,
    undated, (14): 0.1 to 800 Hz with amplitude 5 V and phase pi/2, which needs ``dt`` below 0.625
    ms.

    Examples
    --------
    >>> from skhyst.datasets import swept_sine
    >>> X = swept_sine(0.1, 800.0, duration=2.0, amplitude=5.0, dt=1e-4, phase=0.5 * 3.14159265)
    >>> len(X), round(float(X["drive"].iloc[0]), 3)
    (20001, 5.0)
    """
    function = "swept_sine"
    dt = check.interval(function, dt)
    duration = check.scalar(function, "duration", duration, positive=True)
    logarithmic = spacing == "logarithmic"
    if spacing not in ("linear", "logarithmic"):
        check.refuse(function, "spacing", "'linear' or 'logarithmic'", spacing)
    options = {"positive": True} if logarithmic else {"negative": False}
    start = check.scalar(function, "start_frequency", start_frequency, **options)
    stop = check.scalar(function, "stop_frequency", stop_frequency, **options)
    check.refuse_aliasing(function, "start_frequency", start, dt)
    check.refuse_aliasing(function, "stop_frequency", stop, dt)
    time = dt * np.arange(check.whole(duration / dt) + 1)
    octaves = np.log(stop / start) if logarithmic else 0.0
    if octaves != 0.0:
        cycles = start * duration / octaves * np.expm1(octaves * time / duration)
    else:
        cycles = start * time + 0.5 * (stop - start) / duration * time**2
    angle = 2.0 * np.pi * cycles + check.scalar(function, "phase", phase)
    amplitude = check.scalar(function, "amplitude", amplitude)
    return check.signal_frame(
        [check.scalar(function, "offset", offset) + amplitude * np.sin(angle)], dt
    )


@documented_like(swept_sine)
def decaying_sine(
    amplitude=3.5, frequency=5.0, *, decay=1.0, duration=3.5, dt=1e-4, offset=0.0
) -> pd.DataFrame:
    r"""A sine with decaying amplitude, which erases the hysteresis memory.

    .. math:: u = u_0 + a\,e^{-\lambda t} \sin 2 \pi f t

    Parameters
    ----------
    amplitude : float, default=3.5
        :math:`a`, units of the drive.
    frequency : float, default=5.0
        Hz.
    decay : float, default=1.0
        :math:`\lambda` in 1/s.
    offset : float, default=0.0
        Rest value :math:`u_0`, the first sample, units of the drive.
    duration, dt : float, default=3.5 and 1e-4
        Duration and sampling interval in s.

    Raises
    ------
    ValueError
        If the frequency is not below half the sampling rate, or the decay is negative.

    See Also
    --------
    sine : Constant amplitude.

    References
    ----------
    Han et al., *An Identification Method for Dynamic Systems with SCNs Hysteresis Compensator*,
    undated, (12): the defaults.

    Examples
    --------
    >>> from skhyst.datasets import decaying_sine
    >>> len(decaying_sine())
    35001
    """
    function = "decaying_sine"
    dt = check.interval(function, dt)
    frequency = check.scalar(function, "frequency", frequency, positive=True)
    check.refuse_aliasing(function, "frequency", frequency, dt)
    duration = check.scalar(function, "duration", duration, positive=True)
    time = dt * np.arange(check.whole(duration / dt) + 1)
    decay = check.scalar(function, "decay", decay, negative=False)
    amplitude = check.scalar(function, "amplitude", amplitude)
    u = amplitude * np.sin(2.0 * np.pi * frequency * time) * np.exp(-decay * time)
    return check.signal_frame([check.scalar(function, "offset", offset) + u], dt)


@documented_like(triangle)
def steps(levels=(0.0, 1.0), *, hold=1.0, rise_time=0.0, dt=1e-3) -> pd.DataFrame:
    """Return levels that are held one after another: they show creep, drift and ringing.

    Parameters
    ----------
    levels : sequence of float, default=(0.0, 1.0)
        Levels in succession, units of the drive. The first is where the device rests before.
    hold : float or sequence of float of shape (n_levels,), default=1.0
        Time at each level in s, at least one sampling interval.
    rise_time : float, default=0.0
        Time of the straight line from one level to the next in s; below two sampling intervals the
        next level follows within one.

    Returns
    -------
    DataFrame of shape (n_samples, 1)
        Column ``drive``, one record ``0``.

    Raises
    ------
    ValueError
        If a rest is shorter than one interval, or ``levels`` and ``hold`` differ in length.

    See Also
    --------
    triangle : Ramps without rests.

    Examples
    --------
    >>> from skhyst.datasets import steps
    >>> steps([0.0, 1.0, -1.0], hold=0.2, dt=0.1)["drive"].tolist()
    [0.0, 0.0, 1.0, 1.0, -1.0, -1.0]
    """
    function = "steps"
    dt = check.interval(function, dt)
    levels = np.atleast_1d(check.number(function, "levels", levels))
    rests = check.number(function, "hold", hold, positive=True, size=levels.size)
    n_held = [check.whole(rest / dt) for rest in rests]
    if min(n_held) < 1:
        check.refuse(function, "hold", f"at least one sampling interval, dt = {dt:g} s", hold)
    n_rise = max(
        check.whole(check.scalar(function, "rise_time", rise_time, negative=False) / dt), 1
    )
    # a ramp has n_rise intervals, and the last sample of it is the first at its level
    parts = [np.full(n_held[0], levels[0])]
    for before, level, n in zip(levels[:-1], levels[1:], n_held[1:], strict=True):
        ramp = before + (level - before) * np.arange(1, n_rise) / n_rise
        parts += [ramp, np.full(n, level)]
    return check.signal_frame([np.concatenate(parts)], dt)


@documented_like(triangle)
def first_order_reversal_curves(
    amplitude=1.0, n_curves=10, *, rate=1.0, dt=1e-3, offset=0.0, both_sides=False
) -> pd.DataFrame:
    r"""First-order reversal curves: from saturation to one reversal value after another and back.

    The drive goes from rest to ``offset + amplitude``, then for each curve down to its reversal
    value and up again. The reversal values are spaced evenly, the last is ``offset - amplitude``.
    The density of a Preisach model is a mixed second derivative of the response on the way up.

    Parameters
    ----------
    amplitude : float, default=1.0
        Deviation from the rest value that saturates, units of the drive; a negative one mirrors
        the curves.
    n_curves : int, default=10
        Number of reversal values.
    rate : float, default=1.0
        Largest slope, units of the drive over s.
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

    See Also
    --------
    triangle : Loops of given amplitudes.

    References
    ----------
    Mayergoyz, *Mathematical Models of Hysteresis*, 1991, chapter 1.

    Examples
    --------
    >>> from skhyst.datasets import first_order_reversal_curves
    >>> X = first_order_reversal_curves(1.0, 2, rate=1.0, dt=0.5)
    >>> X["drive"].tolist()
    [0.0, 0.5, 1.0, 0.5, 0.0, 0.5, 1.0, 0.5, 0.0, -0.5, -1.0, -0.5, 0.0, 0.5, 1.0]
    """
    function = "first_order_reversal_curves"
    dt = check.interval(function, dt)
    n_curves = check.count(function, "n_curves", n_curves)
    amplitude = check.scalar(function, "amplitude", amplitude)
    rate = check.scalar(function, "rate", rate, positive=True)
    if amplitude == 0.0:
        check.refuse(function, "amplitude", "other than zero", amplitude)
    step = rate * dt / abs(amplitude)
    if step > 1.0 / n_curves:
        limit = abs(amplitude) / (n_curves * dt)
        check.refuse(function, "rate", f"at most {limit:g}, for two samples on each branch", rate)
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
        n = check.whole(abs(b - a) / step, up=True)
        parts.append(a + (b - a) * np.arange(1, n + 1) / n)
    offset = check.scalar(function, "offset", offset)
    return check.signal_frame([offset + amplitude * np.concatenate(parts)], dt)
