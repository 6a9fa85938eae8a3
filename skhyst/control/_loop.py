"""A feedback loop around a device, sample by sample.

At a sample the response is read, the controller takes the reading and the reference, and its output
drives the device until the next sample. The integral part is stopped where the limits of the drive
cut what it asks for in the direction in which it would go on (conditional integration), so that it
does not wind up.
"""

import math
from typing import NamedTuple

import numpy as np
from sklearn.utils import check_random_state

from ._compensator import check_limits


class FeedforwardPI:
    r"""Proportional-integral control of what a feed-forward leaves.

    .. math:: u = u_r + k_p e + k_i \int e \, dt, \qquad e = r - y

    with the drive :math:`u_r` that a compensator gives for the reference r.

    Parameters
    ----------
    kp : float
        Drive over response.
    ki : float
        Drive over response and s.
    compensator : InverseCompensator, default=None
        Fitted; without one there is no feed-forward.
    drive_limits : tuple of (float, float), default=None
        Units of the drive.

    Examples
    --------
    >>> from skhyst.control import FeedforwardPI, simulate_loop
    >>> from skhyst.linear import FirstOrderLagOperator
    >>> from skhyst.operators import Stepper
    >>> lag = FirstOrderLagOperator(0.05)
    >>> device = Stepper(lag.lowered(1e-3, lag.init(0.0)))
    >>> loop = simulate_loop(device, FeedforwardPI(1.0, 40.0), [1.0] * 500, dt=1e-3)
    >>> print(f"{loop.response[-1]:.3f}")
    1.000
    """

    def __init__(self, kp, ki, *, compensator=None, drive_limits=None):
        self.kp = kp
        self.ki = ki
        self.compensator = compensator
        self.drive_limits = drive_limits

    def controlling(self, reference, dt):
        """Return a function of the number of a sample and of its reading: the drive until the next.

        Parameters
        ----------
        reference : ndarray of shape (n_samples,)
            Units of the response.
        dt : float
            Sampling interval in s.
        """
        check_limits(self.drive_limits, "FeedforwardPI")
        low, high = self.drive_limits or (-math.inf, math.inf)
        ahead = np.zeros(len(reference))
        if self.compensator is not None:
            ahead = self.compensator.drive_for(reference, dt)
        integral = 0.0

        def control(k, reading):
            nonlocal integral
            error = float(reference[k]) - reading
            step = self.ki * dt * error
            wanted = ahead[k] + self.kp * error + integral + step
            drive = min(max(wanted, low), high)
            if (wanted - drive) * step <= 0.0:
                integral += step
            return drive

        return control


class Loop(NamedTuple):
    """What a loop did: arrays of shape (n_samples,)."""

    time: np.ndarray  # s
    reference: np.ndarray
    drive: np.ndarray
    response: np.ndarray
    reading: np.ndarray


def simulate_loop(
    device, controller, reference, dt, *, noise=0.0, resolution=0.0, delay=0, random_state=None
):
    """Close a loop around a device and run it along a reference.

    Parameters
    ----------
    device : object
        With ``step(u) -> y``, such as a :class:`~skhyst.operators.Stepper`; it goes on from the
        state that it is in.
    controller : object
        With ``controlling(reference, dt)``, as :class:`FeedforwardPI` has.
    reference : array-like of shape (n_samples,)
        Units of the response.
    dt : float
        Sampling interval in s.
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
    n, control = len(reference), controller.controlling(reference, dt)
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
