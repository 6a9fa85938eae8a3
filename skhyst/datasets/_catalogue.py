"""A catalogue of the test signals of the package within the limits of an amplifier."""

import numpy as np

from . import _checks as check
from ._random_test_signals import multisine
from ._test_signals import (
    decaying_sine,
    first_order_reversal_curves,
    sine,
    steps,
    swept_sine,
    triangle,
)

_FACTOR = 3  # between neighbours of the grid, in frequency and in amplitude
_PERIODS = 2  # of the slowest: the second period shows what repeats
_FASTEST = 10  # samples of a period, at least: the drive is a straight line between them
_STEPS = 4  # of the slowest programme
FEWEST = 64  # samples, in which each of the signals has its form


def signals_within(drive_limits, duration, dt, *, rate_limit=None) -> dict[str, np.ndarray]:
    r"""Return sines, triangles, sweeps, multisines, steps and reversal curves within given limits.

    Each form has the full range of the drive and a third of it: in its middle and at either end.
    Periodic ones have frequencies from two periods in the duration to ten samples per period, a
    factor of three apart. Signals that are too steep are scaled down about their middle to the rate
    limit; those that then span a ninth of the range or less are left out.

    Parameters
    ----------
    drive_limits : (float, float)
        Lowest and highest value, units of the drive.
    duration, dt : float
        Duration of each signal and sampling interval in s, at least 64 samples.
    rate_limit : float or None, default=None
        Largest slope, units of the drive over s. None: any.

    Returns
    -------
    dict of str to ndarray of shape (n_samples,)
        Description and values of each signal.

    Raises
    ------
    ValueError
        If the limits are not in ascending order, or no signal keeps the rate.

    See Also
    --------
    from_rest_to_rest : Ramps before and after such a signal.

    Examples
    --------
    >>> from skhyst.datasets import signals_within
    >>> signals = signals_within((0.0, 100.0), duration=2.0, dt=1e-3, rate_limit=2000.0)
    >>> len(signals), next(iter(signals))
    (115, 'sine of 1 Hz from 0 to 100')
    """
    function = "signals_within"
    dt = check.interval(function, dt)
    duration = check.scalar(function, "duration", duration, positive=True)
    n = check.whole(duration / dt)
    if n < FEWEST:
        check.refuse(function, "duration", f"at least {FEWEST} intervals of {dt:g} s", duration)
    limits = check.number(function, "drive_limits", drive_limits, size=2)
    if np.ndim(drive_limits) != 1 or not limits[0] < limits[1]:
        check.refuse(function, "drive_limits", "two numbers, the lower one first", drive_limits)
    rate = np.inf
    if rate_limit is not None:
        rate = check.scalar(function, "rate_limit", rate_limit, positive=True)
    middle, half = limits.mean(), 0.5 * np.ptp(limits)
    small = half / _FACTOR
    centers = [(middle, half)] + [
        (c, small) for c in (middle, limits[0] + small, limits[1] - small)
    ]
    signals, digits = {}, 3 - int(np.floor(np.log10(half)))
    for name, shape in _shapes(n, dt, 2.0 * half / rate).items():
        steepest = np.abs(np.diff(shape)).max() / dt
        for center, size in centers:
            size = min(size, rate / steepest)
            if size <= half / _FACTOR**2:
                continue
            drive = np.clip(center + size * shape, *limits)  # rounding
            ends = np.round([drive.min(), drive.max()], digits) + 0.0  # no minus zero
            signals[f"{name} from {ends[0]:.4g} to {ends[1]:.4g}"] = drive
    if not signals:
        least = 4.0 * _PERIODS * half / _FACTOR**2 / (n * dt)  # of the slowest triangle
        expected = f"at least {least:.3g} for signals of {duration:g} s"
        check.refuse(function, "rate_limit", expected, rate_limit)
    return signals


def from_rest_to_rest(drive, dt, rest=None, *, rate_limit=None) -> tuple[np.ndarray, int]:
    """Return a drive with ramps from the rest of an amplifier to its beginning, and back.

    Parameters
    ----------
    drive : array-like of shape (n_samples,)
        Units of the drive.
    dt : float
        Sampling interval in s.
    rest : float or None, default=None
        Drive at which amplifier and device rest; by default the one within the range of the drive
        that is nearest to zero.
    rate_limit : float or None, default=None
        Largest slope of the ramps, units of the drive over s. None: that of the drive, or of a
        constant drive a ramp as long as the drive.

    Returns
    -------
    drive : ndarray of shape (n_samples + n_before + n_after,)
    n_before : int
        Samples before the drive begins.

    Raises
    ------
    ValueError
        If the drive is not finite, or the rate is not positive.

    See Also
    --------
    signals_within : Signals within the limits of an amplifier.

    Examples
    --------
    >>> from skhyst.datasets import from_rest_to_rest
    >>> drive, n_before = from_rest_to_rest([3.0, 4.0, 2.0], dt=0.1, rest=0.0)
    >>> drive.tolist(), n_before
    ([0.0, 1.5, 3.0, 4.0, 2.0, 0.0], 2)
    """
    function = "from_rest_to_rest"
    dt = check.interval(function, dt)
    drive = np.asarray(drive, dtype=float)
    if drive.ndim != 1 or not drive.size or not np.isfinite(drive).all():
        check.refuse(function, "drive", "finite numbers, one per sample", drive)
    nearest = min(max(0.0, drive.min()), drive.max())
    rest = nearest if rest is None else check.scalar(function, "rest", rest)
    change = np.abs(np.diff(drive)).max(initial=0.0)
    if rate_limit is not None:
        change = dt * check.scalar(function, "rate_limit", rate_limit, positive=True)

    def ramp(end):
        """Return the samples from rest to a value, without the value."""
        distance = abs(end - rest)
        n = int(np.ceil(distance / change * (1.0 - 1e-12))) if change else len(drive)
        return rest + (end - rest) * np.arange(n) / n if distance else np.empty(0)

    before, after = ramp(drive[0]), ramp(drive[-1])[::-1]
    return np.concatenate([before, drive, after]), len(before)


def _shapes(n, dt, rise):
    """Return the forms, about zero, of unit size, (n,).

    ``rise`` is the least time in s from one end of the range to the other at the rate limit.
    """
    slowest = _PERIODS / (n * dt)
    octaves = np.log(n / (_PERIODS * _FASTEST)) / np.log(_FACTOR)
    shapes = {}
    for power in range(1 + int(octaves)):
        cycles = _PERIODS * _FACTOR**power
        f = cycles / (n * dt)
        at, heights = f"of {f:.3g} Hz", np.linspace(1.0, 1.0 / _FACTOR, cycles)
        shapes[f"sine {at}"] = sine(1.0, f, n_cycles=cycles, dt=dt)
        shapes[f"triangle {at}"] = triangle(1.0, f, n_cycles=cycles, dt=dt)
        shapes[f"ever smaller triangles {at}"] = triangle(heights, f, dt=dt)
        decay = {"decay": _FACTOR / (n * dt), "duration": n * dt, "dt": dt}
        shapes[f"decaying sine {at}"] = decaying_sine(1.0, f, **decay)
        lines = {"band": (0.5 * slowest, f), "amplitude": np.reciprocal, "random_state": 0}
        shapes[f"multisine up to {f:.3g} Hz"] = multisine(n, dt=dt, **lines)
        if power:
            sweep = {"duration": n * dt, "dt": dt, "spacing": "logarithmic"}
            shapes[f"sweep from {slowest:.3g} to {f:.3g} Hz"] = swept_sine(slowest, f, **sweep)
    rise = max(rise, 0.5 * _FASTEST * dt)
    for count in (_STEPS * _FACTOR**power for power in range(_FACTOR)):
        hold = n * dt / count
        if 2.0 * rise < hold:
            # the golden ratio spreads levels evenly, with large and small steps between them
            levels = 2.0 * (np.arange(1, count) * 0.5 * (np.sqrt(5.0) - 1.0) % 1.0) - 1.0
            levels = [0.0, *levels, 0.0]  # cut off after the time that edges take longer
            shapes[f"steps every {hold:.3g} s"] = steps(levels, hold=hold, rise_time=rise, dt=dt)
    for count in (_FACTOR, _FACTOR**2):
        length = 2.0 * count + 3.0  # from rest, and there and back for each curve
        if length * count < n:  # samples on the shortest branch
            curves = first_order_reversal_curves(1.0, count, rate=length / (n * dt), dt=dt)
            shapes[f"{count} reversal curves"] = curves
    shapes = {name: frame["drive"].to_numpy()[:n] for name, frame in shapes.items()}
    return {name: u / np.abs(u).max() for name, u in shapes.items()}
