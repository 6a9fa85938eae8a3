"""Checks of parameters, and the frame of the test signals."""

import numpy as np
import pandas as pd

from ..records import stack_records

ROUNDING = 1e-9  # of a duration or frequency, in samples or lines


def refuse(function, name, expected, value):
    """Raise the error of a parameter that is not as expected."""
    raise ValueError(
        f"The '{name}' parameter of {function} must be {expected}. Got {value!r} instead."
    )


def number(function, name, value, *, positive=False, negative=True, size=None, shape=None):
    """Return finite numbers as an array, of zero or one dimension, or of ``size`` values.

    ``positive`` refuses zero, ``negative=False`` only values below; errors name the ``shape``.
    """
    kind = "positive" if positive else "finite" if negative else "not negative"
    if shape is None:
        shape = f"a number, or {size} numbers" if size else "a number or a sequence of numbers"
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        refuse(function, name, f"{shape}, {kind}", value)
    fits = array.ndim <= 1 and array.size > 0 and np.isfinite(array).all()
    fits = fits and (size is None or array.size in (1, size))
    fits = fits and not isinstance(value, str)
    if not fits or (positive and (array <= 0).any()) or (not negative and (array < 0).any()):
        refuse(function, name, f"{shape}, {kind}", value)
    return array if size is None else np.broadcast_to(array.ravel(), size).astype(float)


def scalar(function, name, value, **options):
    """Return one finite number."""
    array = number(function, name, value, shape="a number", **options)
    if array.ndim:
        refuse(function, name, "a number", value)
    return float(array)


def count(function, name, value, low=1):
    """Return a whole number of at least ``low``."""
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or value < low:
        refuse(function, name, f"a whole number of at least {low}", value)
    return int(value)


def interval(function, dt):
    """Return the sampling interval in s."""
    return scalar(function, "dt", dt, positive=True)


def refuse_aliasing(function, name, frequency, dt):
    """Refuse frequencies in Hz that samples ``dt`` s apart cannot carry."""
    if np.any(np.asarray(frequency) * dt * 2.0 >= 1.0):
        expected = f"below half the sampling rate, {0.5 / dt:g} Hz for dt = {dt:g} s"
        refuse(function, name, expected, frequency)


def whole(ratio, *, up=False):
    """Return the next whole number below, or above, with a tolerance for rounding."""
    slack = ROUNDING * max(abs(ratio), 1.0)
    return int(np.ceil(ratio - slack) if up else np.floor(ratio + slack))


def signal_frame(signals, dt, labels=None):
    """Return records of shape (n_samples,) or (n_samples, n_inputs) as one frame of drives."""
    frames = []
    for signal in signals:
        signal = signal.reshape(len(signal), -1)
        names = ["drive", *(f"drive_{i}" for i in range(1, signal.shape[1]))]
        frames.append(pd.DataFrame(signal, columns=names))
    return stack_records(frames, labels=labels, dt=dt)
