"""A feedback loop around a device, sample by sample.

At a sample the response is read, the controller takes the reading and the reference, and its output
drives the device until the next sample, whose response stands in the same row.
"""

import math
from typing import NamedTuple

import numpy as np
from sklearn.utils import check_random_state


class Loop(NamedTuple):
    """What a loop did: arrays of shape (n_samples,)."""

    time: np.ndarray  # s
    reference: np.ndarray
    drive: np.ndarray
    response: np.ndarray
    reading: np.ndarray


def simulate_loop(
    device,
    controller,
    reference,
    dt,
    *,
    u0=None,
    noise=0.0,
    resolution=0.0,
    delay=0,
    random_state=None,
) -> Loop:
    """Close a loop around a device and run it along a reference.

    Parameters
    ----------
    device : object
        With ``step(u) -> y``, such as a :class:`~skhyst.operators.Stepper`; it goes on from the
        state that it is in.
    controller : object
        With ``controlling(reference, dt, u0)``, as :class:`FeedforwardPI` has.
    reference : array-like of shape (n_samples,)
        Units of the response.
    dt : float
        Sampling interval in s.
    u0 : float, default=None
        Drive under which the device rests at the first reference; by default that of the
        controller's feed-forward, or zero.
    noise : float, default=0.0
        Standard deviation of the sensor's noise, units of the response.
    resolution : float, default=0.0
        Smallest step of the sensor, units of the response.
    delay : int, default=0
        Samples by which a drive acts late; the first drive stands before.
    random_state : int, RandomState or None, default=None
        Of the noise.

    Returns
    -------
    Loop
        ``time``, ``reference``, ``drive``, ``response``, ``reading``.

    Raises
    ------
    ValueError
        If the reference is not finite or an option is out of its range.
    """
    reference = np.asarray(reference, dtype=float)
    if reference.ndim != 1 or not len(reference) or not np.isfinite(reference).all():
        raise ValueError(
            "The 'reference' parameter of simulate_loop must be finite numbers, one a sample."
        )
    for name, value in {"noise": noise, "resolution": resolution, "delay": delay}.items():
        if not 0.0 <= value < math.inf:
            raise ValueError(
                f"The '{name}' parameter of simulate_loop must not be negative. Got {value!r} "
                "instead."
            )
    if not 0.0 < dt < math.inf:
        raise ValueError(f"The 'dt' parameter of simulate_loop must be above 0. Got {dt!r}.")
    n, control = len(reference), controller.controlling(reference, dt, u0)
    errors = noise * check_random_state(random_state).standard_normal(n)
    drive, response, reading = np.empty((3, n))
    y = None
    for k in range(n):
        # what is read now, the drive answers from now on
        seen = (reference[0] if y is None else y) + errors[k]
        reading[k] = resolution * round(seen / resolution) if resolution else seen
        drive[k] = control(k, reading[k])
        response[k] = y = device.step(drive[max(k - delay, 0)])
    return Loop(dt * np.arange(n), reference, drive, response, reading)
