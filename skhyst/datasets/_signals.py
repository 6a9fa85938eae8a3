"""Test signals that are known in closed form: triangles, sines, sweeps, a decaying sine."""

import numpy as np

from ._checks import (
    interval,
    number,
    refuse,
    refuse_aliasing,
    scalar,
    signal_frame,
    whole,
)

__all__ = ["decaying_sine", "sine", "swept_sine", "triangle"]


def triangle(amplitude=1.0, frequency=1.0, *, n_cycles=1, dt=1e-3, offset=0.0, unipolar=False):
    r"""Triangles, with a programme of amplitudes and frequencies.

    Stretch :math:`i` has ``n_cycles[i]`` whole cycles of ``amplitude[i]`` and ``frequency[i]``, and
    the next begins where it ends, at the rest value ``offset``, at whatever time that is: the phase
    is continuous, the amplitude changes where the drive is at rest.

    Parameters
    ----------
    amplitude : float or sequence of float, default=1.0
        Largest deviation from the rest value, units of the drive; a negative one starts downwards.
    frequency : float or sequence of float, default=1.0
        Hz.
    n_cycles : int or sequence of int, default=1
        Cycles of each stretch.
    dt : float, default=1e-3
        Sampling interval in s.
    offset : float, default=0.0
        Rest value, units of the drive: the first sample.
    unipolar : bool, default=False
        Whether the drive stays on one side of the rest value, between ``offset`` and
        ``offset + amplitude``, instead of going to both.

    Returns
    -------
    DataFrame of shape (n_samples, 1)
        Column ``drive``, one record ``0``. The end of the last cycle, which is the start of the
        next, is left out: where a cycle is a whole number of samples, so is the record of cycles.

    Raises
    ------
    ValueError
        If the programmes differ in length, a number of cycles is not whole, or a frequency is not
        below half the sampling rate.

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
    offset = scalar("triangle", "offset", offset)
    return signal_frame([offset + height * shape], dt)


def sine(amplitude=1.0, frequency=1.0, *, n_cycles=1, dt=1e-3, offset=0.0, unipolar=False):
    r"""Sines, with a programme of amplitudes and frequencies.

    .. math:: u = u_0 + a \sin 2 \pi \phi, \qquad u = u_0 + \tfrac{a}{2} (1 - \cos 2 \pi \phi)

    to both sides of the rest value :math:`u_0`, and to one side. The phase :math:`\phi` grows with
    the frequency of its stretch and has no jumps.

    Parameters
    ----------
    amplitude : float or sequence of float, default=1.0
        Largest deviation from the rest value, units of the drive; a negative one starts downwards.
    frequency : float or sequence of float, default=1.0
        Hz.
    n_cycles : int or sequence of int, default=1
        Cycles of each stretch.
    dt : float, default=1e-3
        Sampling interval in s.
    offset : float, default=0.0
        Rest value, units of the drive: the first sample.
    unipolar : bool, default=False
        Whether the drive stays on one side of the rest value, between ``offset`` and
        ``offset + amplitude``, instead of going to both.

    Returns
    -------
    DataFrame of shape (n_samples, 1)
        Column ``drive``, one record ``0``; the end of the last cycle is left out.

    Raises
    ------
    ValueError
        If the programmes differ in length, a number of cycles is not whole, or a frequency is not
        below half the sampling rate.

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
    return signal_frame([scalar("sine", "offset", offset) + height * shape], dt)


def _programme(function, amplitude, frequency, n_cycles, dt):
    """Return the phase in cycles and the amplitude at each sample."""
    dt = interval(function, dt)
    amplitude = number(function, "amplitude", amplitude)
    frequency = number(function, "frequency", frequency, positive=True)
    cycles = number(function, "n_cycles", n_cycles, positive=True)
    if np.any(cycles != np.round(cycles)):
        refuse(function, "n_cycles", "a whole number, or a sequence of whole numbers", n_cycles)
    refuse_aliasing(function, "frequency", frequency, dt)
    size = max(amplitude.size, frequency.size, cycles.size)
    programmes = {"amplitude": amplitude, "frequency": frequency, "n_cycles": cycles}
    for name, values in programmes.items():
        if values.size not in (1, size):
            refuse(function, name, f"a number or {size} numbers, as the others", values.tolist())
        programmes[name] = np.broadcast_to(values.ravel(), size)
    amplitude, frequency, cycles = programmes.values()
    ends = np.concatenate([[0.0], np.cumsum(cycles / frequency)])
    n_samples = whole(ends[-1] / dt, up=True)
    # rounding must not put a sample that starts a stretch at the end of the one before
    time = dt * np.arange(n_samples)
    stretch = np.searchsorted(ends[1:] / dt * (1.0 - 1e-12), np.arange(n_samples), side="right")
    stretch = np.minimum(stretch, size - 1)
    phase = np.maximum((time - ends[stretch]) * frequency[stretch], 0.0)
    return phase, amplitude[stretch]


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
):
    r"""A sine whose frequency moves from one value to another.

    .. math::

       u = u_0 + a \sin\bigl(2 \pi \textstyle\int_0^t f + \varphi\bigr), \qquad
       f = f_0 + (f_e - f_0)\,t / T \quad\text{or}\quad f = f_0\,(f_e / f_0)^{t / T}

    Parameters
    ----------
    start_frequency, stop_frequency : float
        Frequencies at the start and at the end, Hz.
    duration : float, default=1.0
        :math:`T` in s.
    amplitude : float, default=1.0
        Units of the drive.
    dt : float, default=1e-3
        Sampling interval in s.
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

    References
    ----------
    S. Han, Y. Xu, J. Yu, X. Yang, "An identification method for dynamic systems with SCNs
    hysteresis compensator: application to the inchworm piezo motor", (14): 0.1 to 800 Hz with
    amplitude 5 V and phase pi/2, which needs ``dt`` below 0.625 ms.

    Examples
    --------
    >>> from skhyst.datasets import swept_sine
    >>> X = swept_sine(0.1, 800.0, duration=2.0, amplitude=5.0, dt=1e-4, phase=0.5 * 3.14159265)
    >>> len(X), round(float(X["drive"].iloc[0]), 3)
    (20001, 5.0)
    """
    function = "swept_sine"
    dt = interval(function, dt)
    duration = scalar(function, "duration", duration, positive=True)
    logarithmic = spacing == "logarithmic"
    if spacing not in ("linear", "logarithmic"):
        refuse(function, "spacing", "'linear' or 'logarithmic'", spacing)
    options = {"positive": True} if logarithmic else {"negative": False}
    start = scalar(function, "start_frequency", start_frequency, **options)
    stop = scalar(function, "stop_frequency", stop_frequency, **options)
    refuse_aliasing(function, "start_frequency", start, dt)
    refuse_aliasing(function, "stop_frequency", stop, dt)
    time = dt * np.arange(whole(duration / dt) + 1)
    octaves = np.log(stop / start) if logarithmic else 0.0
    if octaves != 0.0:
        cycles = start * duration / octaves * np.expm1(octaves * time / duration)
    else:
        cycles = start * time + 0.5 * (stop - start) / duration * time**2
    angle = 2.0 * np.pi * cycles + scalar(function, "phase", phase)
    amplitude = scalar(function, "amplitude", amplitude)
    return signal_frame([scalar(function, "offset", offset) + amplitude * np.sin(angle)], dt)


def decaying_sine(amplitude=3.5, frequency=5.0, *, decay=1.0, duration=3.5, dt=1e-4, offset=0.0):
    r"""A sine that dies away, and with it the hysteresis memory.

    .. math:: u = u_0 + a\,e^{-\lambda t} \sin 2 \pi f t

    Parameters
    ----------
    amplitude : float, default=3.5
        Units of the drive.
    frequency : float, default=5.0
        Hz.
    decay : float, default=1.0
        :math:`\lambda` in 1/s.
    duration : float, default=3.5
        s.
    dt : float, default=1e-4
        Sampling interval in s.
    offset : float, default=0.0
        Rest value, units of the drive: the first sample.

    Returns
    -------
    DataFrame of shape (n_samples, 1)
        Column ``drive``, one record ``0``; start and end are included.

    Raises
    ------
    ValueError
        If the frequency is not below half the sampling rate, or the decay is negative.

    References
    ----------
    S. Han, Y. Xu, J. Yu, X. Yang, "An identification method for dynamic systems with SCNs
    hysteresis compensator: application to the inchworm piezo motor", (12): the defaults.

    Examples
    --------
    >>> from skhyst.datasets import decaying_sine
    >>> len(decaying_sine())
    35001
    """
    function = "decaying_sine"
    dt = interval(function, dt)
    frequency = scalar(function, "frequency", frequency, positive=True)
    refuse_aliasing(function, "frequency", frequency, dt)
    duration = scalar(function, "duration", duration, positive=True)
    time = dt * np.arange(whole(duration / dt) + 1)
    decay = scalar(function, "decay", decay, negative=False)
    amplitude = scalar(function, "amplitude", amplitude)
    u = amplitude * np.sin(2.0 * np.pi * frequency * time) * np.exp(-decay * time)
    return signal_frame([scalar(function, "offset", offset) + u], dt)
