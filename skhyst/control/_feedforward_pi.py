r"""Proportional-integral control with feed-forward, derivative, notch and damping, as one step.

At a sample the controller takes the reading, the reference of the same instant and, with
feed-forward, the compensator's drive for the next sample. Anti-windup is by conditional
integration: while the limits clip the drive, the integral part does not move further beyond them.
If the acting drive is measured, or comes from another controller, the integral part follows it by
back-calculation (Åström and Hägglund, *Advanced PID Control*, 2006, chapter 3). Where a reading
leads beyond floating point, such as one that stands for a fault of the sensor, the last drive is
held, and the controller starts again from rest at this drive and the reference of the next sample.

The derivative part of a signal x, with a filter of time constant T, is by backward differences

.. math:: d_k = \frac{T}{T + h} d_{k-1} + \frac{k_d}{T + h} (x_k - x_{k-1})

with the sampling interval h (same, chapter 13).
"""

import math
from collections.abc import Callable
from copy import copy
from dataclasses import replace
from functools import partial
from numbers import Real

import numpy as np
from scipy.signal import bilinear

from .._jit import jit
from .._signals import drive_signal
from .._sklearn import HasMethods, Interval, StrOptions, validate_parameter_constraints
from .._validation import finite_number, finite_numbers
from ..operators import CompiledLaw, Signal, Stepper
from ..records import valid_interval
from ._compensator import InverseCompensator, check_limits
from ._damping import as_mode

_THROUGH = (1.0, 0.0, 0.0, 0.0, 0.0)
_NOTHING = (0.0, 0.0, 0.0, 0.0, 0.0)
_FILTER = 0.1  # of the derivative's own time constant kd / kp: Åström and Hägglund name 1/8 to 1/16
_CONSTRAINTS = {
    "kp": [Interval(Real, None, None, closed="neither")],
    "ki": [Interval(Real, None, None, closed="neither")],
    "kd": [Interval(Real, None, None, closed="neither")],
    "filter_time": [Interval(Real, 0, None, closed="left"), None],
    "setpoint_weight": [Interval(Real, 0, None, closed="left")],
    "rate_limit": [StrOptions({"fit"}), Interval(Real, 0, None, closed="neither"), None],
    "tracking_time": [Interval(Real, 0, None, closed="neither"), None],
    "start_time": [StrOptions({"fit"}), Interval(Real, 0, None, closed="left")],
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
def started(reference, reading, c, s):
    """Return the reference, which after the start moves to the given one in equal steps.

    ``s[10]`` is the remaining fraction of the initial difference ``s[11]`` between the first
    reading and the reference.
    """
    if s[10] == 1.0:
        s[11] = reading - reference
    s[10] = max(s[10] - c[11], 0.0)
    return reference + s[10] * s[11]


@jit
def settled(x, b, s, at):
    """Return the output of a section at rest under a constant input; set its two states."""
    y = x * (b[0] + b[1] + b[2]) / (1.0 + b[3] + b[4])
    s[at + 1] = b[2] * x - b[4] * y
    s[at] = b[1] * x - b[3] * y + s[at + 1]
    return y


@jit
def rested(drive, reference, damped, c, s):
    """Put the parts to rest at a drive, without that of a compensator, and a reference.

    ``damped`` is the input of the damping filter. The reading has no part in it: a wrong one would
    remain in the integral part.
    """
    inner = drive - settled(damped, c[5], s, 3)  # the output of the notch
    settled(inner, c[4], s, 1)
    s[0] = inner - c[0] * (c[6] - 1.0) * reference  # the gain of the notch at rest is one
    return 0.0


@jit
def restarted(low, high, s):
    """Return the last drive, at which the controller rests at the next sample's reference.

    For numbers beyond floating point, which no later sample would take out of the state. The drive
    is within its limits, whatever drive has acted before.
    """
    s[6] = min(max(s[6], low), high)
    s[0] = s[1] = s[2] = s[3] = s[4] = s[5] = s[7] = s[11] = 0.0
    s[10] = s[12] = 1.0
    s[9] = -1.0
    return s[6]


@jit
def limited_step(feedforward, reference, reading, damped, c, s):
    """Return the drive for a feed-forward drive and the input of the damping filter.

    ``c`` is (kp, ki dt, lowest, highest drive, coefficients of notch, of damping, weight of the
    reference, decay of the derivative, its gain, largest change of the drive, dt over tracking
    time, fraction of the start per sample). ``s`` is the integral part, two states each of notch
    and damping, 1 if limits clip the drive, else 0, the last drive, derivative, the last input of
    the derivative, 1 before the first sample, -1 after :func:`restarted`, else 0, the two numbers
    of :func:`started`, and 1 after the first restart.
    """
    kp, ki, low, high, notch, damping, weight, decay, kd, change = c[:10]
    error = reference - reading
    step = ki * error
    derivative = decay * s[7] - (0.0 if s[9] != 0.0 else kd * (damped - s[8]))
    direct = kp * (weight * reference - reading) + derivative
    if not (
        abs(feedforward + (notch[0] * (direct + s[0] + step) + s[1]) + (damping[0] * damped + s[3]))
        < math.inf
    ):
        return restarted(low, high, s)
    s[7], s[8], s[9] = derivative, damped, 0.0
    wanted = feedforward + section_step(direct + s[0] + step, notch, s, 1)
    wanted += section_step(damped, damping, s, 3)
    drive = min(max(wanted, s[6] - change), s[6] + change)
    drive = min(max(drive, low), high)  # in any case, whatever drive has acted before
    s[5] = 1.0 if drive != wanted else 0.0
    s[6] = drive
    if (wanted - drive) * step <= 0.0:  # not cut, or integrating back into the limits
        s[0] += step
    return drive


@jit
def tracked(acted, c, s):
    """Move the integral part to where the drive equals the one that has acted.

    One beyond the limits is followed no faster than the drive may change, and the change is counted
    from the last output: it may be a fault of its reading.
    """
    low, high, change = c[2], c[3], c[9]
    if acted < low or acted > high:
        near = min(max(acted, s[6] - change), s[6] + change)
        s[0] += c[10] * (min(max(near, low), high) - s[6])
    else:
        s[0] += c[10] * (acted - s[6])
        s[6] = acted
    return 0.0


@jit
def feedback_step(u, c, s):
    """Return the drive for the row (reference, reading)."""
    if s[9] < 0.0:
        rested(s[6], u[0], u[0], c, s)
    return limited_step(0.0, started(u[0], u[1], c, s), u[1], u[1], c, s)


@jit
def tracking_feedback_step(u, c, s):
    """Return the drive for the row (reference, reading, acting drive)."""
    tracked(u[2], c, s)
    return feedback_step(u, c, s)


@jit
def followed(u, c, s):
    """Return the drive for the row of :func:`following_step`, with the last drive known."""
    if s[9] < 0.0:
        rested(s[6] - min(max(u[2], c[2]), c[3]), u[0], 0.0, c, s)
    reference = started(u[0], u[1], c, s)
    return limited_step(u[2], reference, u[1], u[1] - reference, c, s)


@jit
def following_step(u, c, s):
    """Return the drive for the row (reference, reading, drive of the compensator)."""
    if s[9] > 0.0:  # at rest the drive is that of the compensator, and a difference
        s[6] += u[2]
    return followed(u, c, s)


@jit
def tracking_following_step(u, c, s):
    """Return the drive for the row (reference, reading, compensator's drive, acting drive)."""
    if s[9] > 0.0:
        s[6] += u[2]
    tracked(u[3], c, s)
    return followed(u, c, s)


_STEPS = {  # by whether there is a compensator, and whether the acting drive is known
    (False, False): feedback_step,
    (True, False): following_step,
    (False, True): tracking_feedback_step,
    (True, True): tracking_following_step,
}


class FeedforwardPI:
    r"""Proportional-integral control, with feed-forward by an inverse compensator, notch, damping.

    .. math::

        u = u_r + N \left[ k_p (b r - y) + k_i \int e \, dt
        - \frac{k_d s}{1 + T s} (y - y_r) \right] + D[y - y_r], \qquad e = r - y

    with the drive :math:`u_r` of a compensator for the reference r, a weight b of the reference, a
    notch N, and a filter D for damping. With feed-forward, the derivative and D act on the
    deviation from :math:`y_r = r`, so that they add nothing while the device follows the reference;
    without it, on the reading alone, :math:`y_r = 0`.

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
        Units of the drive. By default those of the compensator, ``drive_limits_``, and none without
        a compensator. None: no limits.
    kd : float, default=0.0
        Derivative gain, units of the drive per unit of the response, times s.
    filter_time : float, default=None
        Time constant T of the derivative's filter in s; by default a tenth of ``kd / kp``.
    setpoint_weight : float, default=1.0
        Weight b of the reference in the proportional part: below 1, steps overshoot less.
    rate_limit : {"fit"}, float or None, default="fit"
        Largest rate of the drive, its units per s; by default that of the compensator,
        ``rate_limit_``, and none without a compensator. None: no limit.
    tracking_time : float, default=None
        If the acting drive is known: it is a further column of the rows, up to the present sample.
        While it differs from the requested drive, because of a limit of the amplifier or of another
        controller, the integral part follows it with this time constant in s, at least a sampling
        interval. With the interval itself, control is taken over without a bump. An acting drive
        beyond the limits is followed to them, no faster than the rate limit.
    start_time : {"fit"} or float, default="fit"
        Time in s in which the reference moves from the first reading to the given reference. By
        default the time of the drive through the range of the fit at its largest rate, and zero
        without a compensator that has them.

    See Also
    --------
    InverseCompensator : The feed-forward.
    IntegralResonantControl : Damping of a resonance.
    simulate_loop : Simulate the loop around a device.

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

    def __init__(
        self,
        kp,
        ki,
        *,
        compensator=None,
        notch=None,
        damping=None,
        drive_limits="fit",
        kd=0.0,
        filter_time=None,
        setpoint_weight=1.0,
        rate_limit="fit",
        tracking_time=None,
        start_time="fit",
    ):
        self.kp = kp
        self.ki = ki
        self.compensator = compensator
        self.notch = notch
        self.damping = damping
        self.drive_limits = drive_limits
        self.kd = kd
        self.filter_time = filter_time
        self.setpoint_weight = setpoint_weight
        self.rate_limit = rate_limit
        self.tracking_time = tracking_time
        self.start_time = start_time

    def stepper(self, dt, reference=0.0, u0=0.0) -> Stepper:
        """Return the controller as a device that is run row by row, from rest.

        Parameters
        ----------
        dt : float
            Sampling interval in s.
        reference, u0 : float, default=0.0
            Response and drive at which the device has rested; with a compensator ``u0`` is the
            difference from the compensator's drive.

        Returns
        -------
        Stepper
            Its ``step`` takes the row (reference, reading), with a compensator (reference, reading,
            drive of the compensator), with a ``tracking_time`` the acting drive as the last column,
            and returns the drive until the next sample. The reference is that at the instant of the
            reading, the compensator's drive that for the next sample.

        Raises
        ------
        ValueError
            If a parameter is invalid, or the notch is not below half the sampling rate.
        """
        caller = "FeedforwardPI.stepper"
        dt = valid_interval(dt, caller)
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
        if self.tracking_time is not None and not self.tracking_time >= dt:
            raise ValueError(
                "The 'tracking_time' parameter of FeedforwardPI must be at least the sampling "
                f"interval, {dt:g} s. Got {self.tracking_time!r} instead."
            )
        has_rate = isinstance(self.compensator, InverseCompensator)
        if has_rate and "fit" in (self.rate_limit, self.start_time):
            self.compensator._require_rate(dt)
        filter_time, change = self._filter_time(), self._rate_limit() * dt
        follows, tracks = self.compensator is not None, self.tracking_time is not None
        constants = (
            *(self.kp, self.ki * dt, low, high, notch, damping, self.setpoint_weight),
            filter_time / (filter_time + dt),
            self.kd / (filter_time + dt),
            change,
            dt / self.tracking_time if tracks else 0.0,
            min(dt / self._start_time(), 1.0) if self._start_time() else 1.0,
        )
        state = np.zeros(13)
        state[6] = u0 if follows else min(max(u0, low), high)
        state[9] = state[10] = 1.0  # before the first sample, and the whole way of the start
        acting = [Signal("acting drive", low=low, high=high)]
        inputs = [Signal("reference"), Signal("reading")]
        inputs += [Signal("drive of the compensator")] * follows + acting * tracks
        law = CompiledLaw(
            *(_STEPS[follows, tracks], constants, state, len(inputs)),
            flags=(("limited", 5), ("overrange", 12)),
            limited=(2, 3, 9) if (low, high, change) != (-math.inf, math.inf, math.inf) else (),
            acting=len(inputs) - 1 if tracks else None,
        )
        rested(u0, reference, 0.0 if follows else reference, law.constants, state)
        law = replace(law, state=state)
        return Stepper(
            law,
            dt,
            inputs=inputs,
            result=drive_signal(self.compensator),
            remake=partial(copy(self).stepper, dt, reference, u0),
        )

    def _filter_time(self):
        """Return the time constant of the derivative's filter in s."""
        if self.filter_time is None and self.kd:
            if not self.kp:
                raise ValueError(
                    "The 'filter_time' parameter of FeedforwardPI must be given in s for a 'kp' of "
                    "0. Got None instead."
                )
            return _FILTER * abs(self.kd / self.kp)
        return self.filter_time or 0.0

    def _rate_limit(self):
        """Return the largest rate of the drive, its units per s."""
        if isinstance(self.rate_limit, str):
            return getattr(self.compensator, "rate_limit_", math.inf)
        return math.inf if self.rate_limit is None else self.rate_limit

    def _start_time(self):
        """Return the time in s in which the reference moves to the given one."""
        if not isinstance(self.start_time, str):
            return self.start_time
        drive = drive_signal(self.compensator)
        return (drive.high - drive.low) / drive.rate if 0.0 < drive.rate < math.inf else 0.0

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
            Drive at which the device rests; by default the first drive of the compensator, or zero
            without one.

        Returns
        -------
        callable

        Raises
        ------
        ValueError
            If a parameter is invalid, or as in :meth:`stepper`.
        FloatingPointError
            By the function, if a reading leads beyond floating point.
        """
        caller, wanted = "FeedforwardPI.controlling", "finite numbers, one per sample"
        reference = finite_numbers(reference, caller, "reference", wanted, ndim=1)
        u0 = None if u0 is None else finite_number(u0, caller, "u0")
        dt = valid_interval(dt, caller)
        # the reading of a sample is the response at the sample before
        due = np.concatenate([reference[:1], reference[:-1]])
        columns, rest = [due], u0 or 0.0
        if self.compensator is not None:
            columns.append(self.compensator.drive_for(reference, dt))
            rest = 0.0 if u0 is None else u0 - columns[1][0]
        stepper = self.stepper(dt, reference[0], rest)
        begin = rest + (columns[1][0] if len(columns) > 1 else 0.0)
        tracks = self.tracking_time is not None

        def control(k, reading):
            acting = begin if stepper.output is None else stepper.output
            row = due[k], reading, *(column[k] for column in columns[1:])
            drive = stepper.step((*row, acting) if tracks else row)
            if stepper.state[10] == 1.0:  # as before the first step: held
                raise FloatingPointError(f"The reading {reading!r} leads beyond floating point.")
            return drive

        return control


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
