"""A feedback loop around a device, sample by sample.

At a sample the response is read, the controller takes the reading and the reference, and its output
drives the device until the next sample. A row holds the reading, the drive, and the response at the
end of the interval of this drive.
"""

import math
import warnings
from numbers import Integral, Real
from typing import NamedTuple

import numpy as np
from sklearn.utils import check_random_state

from .._sklearn import HasMethods, Interval, validate_parameter_constraints
from .._validation import finite_numbers
from ..exceptions import DivergenceWarning
from ..records import MISMATCH, valid_interval

_CONSTRAINTS = {
    "device": [HasMethods("step")],
    "controller": [HasMethods("controlling")],
    "u0": [Interval(Real, None, None, closed="neither"), None],
    "noise": [Interval(Real, 0, None, closed="left")],
    "resolution": [Interval(Real, 0, None, closed="left")],
    "delay": [Interval(Integral, 0, None, closed="left")],
    "random_state": ["random_state"],
}


class Loop(NamedTuple):
    """Signals of a simulated loop, shorter than the reference if the loop has diverged.

    Parameters
    ----------
    time : ndarray of shape (n_samples,)
        In s.
    reference, drive, response : ndarray of shape (n_samples,)
        The reference, the output of the controller, and the output of the device.
    reading : ndarray of shape (n_samples,)
        The response with the noise and the delay of the sensor.

    See Also
    --------
    simulate_loop : Simulate a loop.
    """

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
    """Simulate a feedback loop around a device, along a reference.

    Parameters
    ----------
    device : object
        With ``step(u) -> y``, such as a :class:`~skhyst.operators.Stepper`; it continues from its
        current state.
    controller : object
        With ``controlling(reference, dt, u0)`` as in :meth:`FeedforwardPI.controlling`.
    reference : array-like of shape (n_samples,)
        Units of the response.
    dt : float
        Sampling interval in s.
    u0 : float, default=None
        Drive at which the device rests at the first reference; by default that of the controller's
        feed-forward, or zero.
    noise : float, default=0.0
        Standard deviation of the sensor's noise, units of the response.
    resolution : float, default=0.0
        Quantization step of the sensor, units of the response. 0: none.
    delay : int, default=0
        Delay of the drive in samples; until then, the first drive acts.
    random_state : int, RandomState or None, default=None
        Seed of the noise.

    Returns
    -------
    Loop
        ``time``, ``reference``, ``drive``, ``response``, ``reading``. Always finite: a diverging
        loop ends before the first sample at which the reading, the drive or the response is not
        finite.

    Raises
    ------
    ValueError
        If the reference is not finite, an option is out of its range, or the device is a stepper
        at another interval.

    Warns
    -----
    DivergenceWarning
        If the loop has diverged, with the time and the number of the sample.

    See Also
    --------
    FeedforwardPI : A controller.
    skhyst.operators.Stepper : A model that is run sample by sample, as the device.

    Examples
    --------
    A gain of 3 around a device of gain 1 that is read one sample late: each error is three times
    the last one.

    >>> import warnings
    >>> from skhyst.control import FeedforwardPI, simulate_loop
    >>> from skhyst.linear import GainOperator
    >>> from skhyst.operators import Stepper
    >>> device = Stepper(GainOperator(1.0).compiled_step(1e-3, ()))
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     loop = simulate_loop(device, FeedforwardPI(3.0, 0.0), [0.0] + [1.0] * 999, 1e-3)
    >>> print(str(caught[0].message)[:73])
    The loop diverged: it left the range of floating point at 0.648 s, sample
    >>> len(loop.response), f"{abs(loop.response[-1]):.0e}"
    (648, '1e+308')
    """
    caller, given = "simulate_loop", (device, controller, u0, noise, resolution, delay)
    named = dict(zip(_CONSTRAINTS, (*given, random_state), strict=True))
    validate_parameter_constraints(_CONSTRAINTS, named, caller)
    wanted = "finite numbers, one per sample"
    reference = finite_numbers(reference, caller, "reference", wanted, ndim=1)
    dt = valid_interval(dt, caller)
    device_dt = getattr(device, "dt", None)  # of a stepper, which has an interval of its own
    if device_dt is not None and abs(device_dt - dt) > MISMATCH * dt:
        raise ValueError(
            f"The 'dt' parameter of simulate_loop must be that of the device, {device_dt:g} s. Got "
            f"{dt:g} s instead."
        )
    n, control = len(reference), controller.controlling(reference, dt, u0)
    errors = (noise * check_random_state(random_state).standard_normal(n)).tolist()
    drive, response, reading = np.empty((3, n))
    y = float(reference[0])
    for k in range(n):
        # the reading is the response to earlier drives; the new drive acts from now on
        noisy = y + errors[k]
        steps = noisy / resolution if resolution else math.inf
        reading[k] = resolution * round(steps) if math.isfinite(steps) else noisy
        if not math.isfinite(noisy):
            break
        try:
            drive[k] = control(k, reading[k])
        except FloatingPointError:
            break
        if not math.isfinite(drive[k]):
            break
        response[k] = y = float(device.step(drive[max(k - delay, 0)]))
        if not math.isfinite(y) or _has_begun_anew(device):
            break
    else:
        k = n
    if k < n:
        warnings.warn(
            f"The loop diverged: it left the range of floating point at {k * dt:.6g} s, sample "
            f"{k}, and only the samples before are returned.",
            DivergenceWarning,
            stacklevel=2,
        )
    return Loop(dt * np.arange(k), *(part[:k] for part in (reference, drive, response, reading)))


def _has_begun_anew(device):
    """Whether numbers have left floating point in a stepper, which holds its output then."""
    status = getattr(device, "status", None)
    return isinstance(status, frozenset) and "overrange" in status
