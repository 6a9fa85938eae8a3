"""Proportional-integral control with feed-forward, notch and damping, as one compiled step.

At a sample the controller takes the reading, the reference of the same instant and, with
feed-forward, the compensator's drive for the next sample. Anti-windup is by conditional
integration: while the limits cut the drive, the integral part does not move further beyond them.
"""

import math
from collections.abc import Callable
from copy import copy
from functools import partial
from numbers import Real

import numpy as np
from scipy.signal import bilinear

from .._jit import jit
from .._sklearn import HasMethods, Interval, validate_parameter_constraints
from .._validation import drive_signal, finite_number, finite_numbers
from ..operators import CompiledLaw, Signal, Stepper
from ..records import chosen_interval
from ._compensator import check_limits
from ._damping import as_mode

_THROUGH = (1.0, 0.0, 0.0, 0.0, 0.0)
_NOTHING = (0.0, 0.0, 0.0, 0.0, 0.0)
_CONSTRAINTS = {
    "kp": [Interval(Real, None, None, closed="neither")],
    "ki": [Interval(Real, None, None, closed="neither")],
    "compensator": [HasMethods("drive_for"), None],
    "damping": [HasMethods("section"), None],
}


@jit
def section_step(x, b, s, at):
    """Return the output of a second-order section in transposed direct form II.

    ``b`` (5,) holds b0, b1, b2 of its numerator and a1, a2 of its denominator; its two states are
    ``s[at]`` and ``s[at + 1]``.
    """
    y = b[0] * x + s[at]
    s[at] = b[1] * x - b[3] * y + s[at + 1]
    s[at + 1] = b[2] * x - b[4] * y
    return y


@jit
def limited_step(feedforward, error, damped, c, s):
    """Return the drive for an error, a feed-forward drive, and the input of the damping filter.

    ``c`` is (kp, ki dt, lowest, highest drive, coefficients of notch, of damping). ``s`` is the
    integral part, two states each of notch and damping, and 1 if the limits cut, else 0.
    """
    kp, ki, low, high, notch, damping = c
    step = ki * error
    wanted = feedforward + section_step(kp * error + s[0] + step, notch, s, 1)
    wanted += section_step(damped, damping, s, 3)
    drive = min(max(wanted, low), high)
    s[5] = 1.0 if drive != wanted else 0.0
    if (wanted - drive) * step <= 0.0:  # not cut, or integrating back into the limits
        s[0] += step
    return drive


@jit
def feedback_step(u, c, s):
    """Return the drive for the row (reference, reading)."""
    return limited_step(0.0, u[0] - u[1], u[1], c, s)


@jit
def following_step(u, c, s):
    """Return the drive for the row (reference, reading, drive of the compensator)."""
    return limited_step(u[2], u[0] - u[1], u[1] - u[0], c, s)


class FeedforwardPI:
    r"""Proportional-integral control, with feed-forward by an inverse compensator, notch, damping.

    .. math:: u = u_r + N \left[ k_p e + k_i \int e \, dt \right] + D[y - y_r], \qquad e = r - y

    with the drive :math:`u_r` that a compensator gives for the reference r, a notch N, and a filter
    D for damping. With feed-forward, D acts on the deviation from :math:`y_r = r`, so that it adds
    nothing while the device follows the reference; without, on the reading alone,
    :math:`y_r = 0`.

    Parameters
    ----------
    kp : float
        Proportional gain, units of the drive per unit of the response.
    ki : float
        Integral gain, units of the drive per unit of the response and second.
    compensator : InverseCompensator, default=None
        Fitted compensator; without one there is no feed-forward.
    notch : tuple of (float, float), operator or estimator, default=None
        Frequency in Hz and damping ratio of the mode that feedback must not excite, or an object
        with ``natural_frequency`` (rad/s) and ``damping_ratio``, such as a fitted
        :class:`~skhyst.linear.SecondOrderMode`. The zeros of N are the mode's poles, and its own
        poles are critically damped at the same frequency (G. F. Franklin, J. D. Powell,
        A. Emami-Naeini, "Feedback Control of Dynamic Systems", notch compensation).
    damping : IntegralResonantControl, default=None
        Object whose ``section(dt)`` returns the coefficients of the filter D.
    drive_limits : {"fit"}, tuple of (float, float) or None, default="fit"
        Units of the drive. By default those of the compensator, ``drive_limits_``, and none where
        there is no compensator. None: there are none.

    Notes
    -----
    For gains, margins and linear design use python-control.

    Examples
    --------
    >>> from skhyst.control import FeedforwardPI, simulate_loop
    >>> from skhyst.linear import FirstOrderLagOperator
    >>> from skhyst.operators import Stepper
    >>> lag = FirstOrderLagOperator(0.05)
    >>> device = Stepper(lag.compiled_step(1e-3, lag.init(0.0)))
    >>> loop = simulate_loop(device, FeedforwardPI(1.0, 40.0), [1.0] * 500, dt=1e-3)
    >>> print(f"{loop.response[-1]:.3f}")
    1.000

    Sample by sample, here without the loop:

    >>> controller = FeedforwardPI(1.0, 40.0).stepper(1e-3)
    >>> [round(controller.step((1.0, reading)), 6) for reading in (0.0, 0.5)]
    [1.04, 0.56]
    """

    def __init__(self, kp, ki, *, compensator=None, notch=None, damping=None, drive_limits="fit"):
        self.kp = kp
        self.ki = ki
        self.compensator = compensator
        self.notch = notch
        self.damping = damping
        self.drive_limits = drive_limits

    def stepper(self, dt, reference=0.0, u0=0.0) -> Stepper:
        """Return the controller as a device that is fed rows, from rest.

        Parameters
        ----------
        dt : float
            Sampling interval in s.
        reference, u0 : float, default=0.0
            Response and drive at which the device rests before; with a compensator ``u0`` is the
            difference from the compensator's drive.

        Returns
        -------
        Stepper
            Its ``step`` takes the row (reference, reading), with a compensator (reference, reading,
            drive of the compensator), and returns the drive until the next sample. The reference is
            that at the instant of the reading, the compensator's drive that for the next sample.

        Raises
        ------
        ValueError
            If a parameter is not as above, or the notch is not below half the sampling rate.
        """
        caller = "FeedforwardPI.stepper"
        dt = chosen_interval((), dt, caller)
        reference = finite_number(reference, caller, "reference")
        u0 = finite_number(u0, caller, "u0")
        limits = self.drive_limits
        if isinstance(limits, str) and limits == "fit":
            limits = getattr(self.compensator, "drive_limits_", None)
        check_limits(limits, "FeedforwardPI")
        validate_parameter_constraints(_CONSTRAINTS, vars(self), "FeedforwardPI")
        low, high = (-math.inf, math.inf) if limits is None else limits
        notch = _THROUGH if self.notch is None else notch_section(self.notch, dt)
        damping = _NOTHING if self.damping is None else self.damping.section(dt)
        constants = (self.kp, self.ki * dt, low, high, notch, damping)
        state = np.zeros(6)
        follows = self.compensator is not None
        settled, state[3:5] = _settled(damping, 0.0 if follows else reference)
        state[0] = u0 - settled
        _, state[1:3] = _settled(notch, state[0])
        step = following_step if follows else feedback_step
        inputs = (Signal("reference"), Signal("reading"), Signal("drive of the compensator"))
        inputs, flags = inputs[: 3 if follows else 2], (("limited", 5),)
        return Stepper(
            CompiledLaw(step, constants, state, len(inputs), flags=flags),
            dt,
            inputs=inputs,
            result=drive_signal(self.compensator),
            remake=partial(copy(self).stepper, dt, reference, u0),
        )

    def controlling(self, reference, dt, u0=None) -> Callable[[int, float], float]:
        """Return a function ``(k, reading) -> drive`` that controls a device along a reference.

        ``k`` is the number of the sample; the drive holds until the next sample.

        Parameters
        ----------
        reference : ndarray of shape (n_samples,)
            Units of the response.
        dt : float
            Sampling interval in s.
        u0 : float, default=None
            Drive under which the device rests; by default the first drive of the compensator, or
            zero without one.

        Returns
        -------
        callable

        Raises
        ------
        ValueError
            If a parameter is not as above, or as in :meth:`stepper`.
        """
        caller, wanted = "FeedforwardPI.controlling", "finite numbers, one per sample"
        reference = finite_numbers(reference, caller, "reference", wanted, ndim=1)
        u0 = None if u0 is None else finite_number(u0, caller, "u0")
        dt = chosen_interval((), dt, caller)
        # the reading of a sample is the response at the sample before
        due = np.concatenate([reference[:1], reference[:-1]])
        if self.compensator is None:
            step = self.stepper(dt, reference[0], u0 or 0.0).step
            return lambda k, reading: step((due[k], reading))
        feedforward = self.compensator.drive_for(reference, dt)
        step = self.stepper(dt, reference[0], 0.0 if u0 is None else u0 - feedforward[0]).step
        return lambda k, reading: step((due[k], reading, feedforward[k]))


def notch_section(mode, dt):
    """Return b0, b1, b2, a1, a2 of the notch: bilinear transform, prewarped at its frequency.

    Raises
    ------
    ValueError
        If the frequency is not below half the sampling rate, or the damping ratio is negative.
    """
    frequency, damping_ratio = as_mode(mode, "damping_ratio")
    if not (0.0 < frequency * dt < 0.5 and 0.0 <= damping_ratio < math.inf):
        raise ValueError(
            "The 'notch' parameter of FeedforwardPI must be a frequency below half the sampling "
            f"rate, {0.5 / dt:g} Hz, and a damping ratio. Got {mode!r} instead."
        )
    w = 2.0 * math.pi * frequency
    b, a = bilinear(
        [1.0, 2.0 * damping_ratio * w, w * w],
        [1.0, 2.0 * w, w * w],
        w / (2.0 * math.tan(0.5 * w * dt)),
    )
    return (*b, *a[1:])


def _settled(section, x):
    """Return the output and the two states of a section at rest under a constant input."""
    b0, b1, b2, a1, a2 = section
    y = x * (b0 + b1 + b2) / (1.0 + a1 + a2)
    last = b2 * x - a2 * y
    return y, (b1 * x - a1 * y + last, last)
