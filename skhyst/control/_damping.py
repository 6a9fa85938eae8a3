r"""Active damping of a resonant mode, by feedback of the position alone.

Let the mode be :math:`G = g \omega^2 / (s^2 + \omega^2)`. With a feedthrough :math:`-d`, d above g,
poles and zeros interlace,

.. math:: G - d = -d \frac{s^2 + \rho \omega^2}{s^2 + \omega^2}, \qquad \rho = 1 - g / d,

and integral feedback :math:`k / s` of its output moves the poles along an arc from
:math:`\pm j \omega` to :math:`\pm j \sqrt\rho \omega`. Around the device itself that is the filter

.. math:: D = \frac{k}{s + K}, \quad K = k d, \qquad s^3 + K s^2 + \omega^2 s + \rho K \omega^2 = 0

for the poles. With :math:`s = \sqrt\rho\, \omega^2 / t` the equation becomes that of
:math:`K' = \omega^2 / (K \sqrt\rho)`, so the damping ratio of the pair is the same for K and K',
and largest where they are equal, :math:`K = \omega \rho^{-1/4}`. There the poles are
:math:`-\Omega` and a pair of frequency :math:`\Omega = \omega \rho^{1/4}`; their sum is -K, so that
the damping ratio of the pair is

.. math:: \zeta = \tfrac12 \left(\rho^{-1/2} - 1\right), \qquad \rho = (1 + 2 \zeta)^{-2}

One number is chosen, :math:`\zeta`, and all others follow from the mode.
"""

import math
from numbers import Real

import numpy as np

from .._sklearn import Interval, validate_parameter_constraints
from ..records import valid_interval


class IntegralResonantControl:
    r"""Integral resonant control: :math:`D = k / (s + K)` of the reading, added to the drive.

    It supposes that at its resonance the device lags by a quarter of a period, as a mass on a
    spring with collocated actuator and sensor: with further lags, of an amplifier or of the sensor,
    the filter may excite the mode instead of damping it. python-control gives stability and margins
    of a loop. At low frequencies the gain of the damped device is :math:`(1 + 2 \zeta)^2` times
    that without damping.

    Parameters
    ----------
    mode : tuple of (float, float), operator or estimator
        Frequency in Hz and static gain of the mode, response over drive, or an object with
        ``natural_frequency`` (rad/s) and ``gain``, such as a fitted
        :class:`~skhyst.linear.SecondOrderMode`.
    damping_ratio : float, default=0.5
        Damping ratio :math:`\zeta` of the damped mode. In proportional-integral loops around a mode
        without other lags, of the values tried from 0.1 to 1.5, 0.5 gave the smallest peak of the
        sensitivity, and a bandwidth within 1 % of the largest.

    See Also
    --------
    FeedforwardPI : The controller that takes such a damping filter.

    References
    ----------
    Aphale, Fleming and Moheimani, *Smart Materials and Structures*, 2007. In this form: Fleming,
    Aphale and Moheimani, *IEEE Transactions on Nanotechnology*, 2010.

    Examples
    --------
    >>> from skhyst.control import FeedforwardPI, IntegralResonantControl, simulate_loop
    >>> from skhyst.linear import SecondOrderModeOperator
    >>> from skhyst.operators import Stepper
    >>> mode = SecondOrderModeOperator(900.0, 0.01, gain=0.1)
    >>> for damping in (None, IntegralResonantControl(mode)):
    ...     stage = Stepper(mode.compiled_step(1e-4, mode.init(0.0)))
    ...     controller = FeedforwardPI(4.0, 300.0, damping=damping)
    ...     loop = simulate_loop(stage, controller, [1.0] * 2000, 1e-4)
    ...     print(f"largest error at the end: {abs(loop.response[-200:] - 1.0).max():.0e}")
    largest error at the end: 1e+01
    largest error at the end: 3e-04
    """

    def __init__(self, mode, *, damping_ratio=0.5):
        self.mode = mode
        self.damping_ratio = damping_ratio

    def section(self, dt):
        """Return the discrete coefficients of D, exact for readings held between samples.

        Parameters
        ----------
        dt : float
            Sampling interval in s.

        Returns
        -------
        tuple of float
            Numerator b0, b1, b2 and denominator a1, a2.

        Raises
        ------
        ValueError
            If ``dt`` is not a positive number, the mode is not below half the sampling rate, or the
            damping ratio is not above 0.
        """
        dt = valid_interval(dt, "IntegralResonantControl.section")
        frequency, gain = as_mode(self.mode, "gain")
        if not (0.0 < frequency * dt < 0.5 and gain != 0.0 and math.isfinite(gain)):
            raise ValueError(
                "The 'mode' parameter of IntegralResonantControl must be a frequency below half "
                f"the sampling rate, {0.5 / dt:g} Hz, and a gain. Got {self.mode!r} instead."
            )
        constraints = {"damping_ratio": [Interval(Real, 0, None, closed="neither")]}
        validate_parameter_constraints(constraints, vars(self), "IntegralResonantControl")
        rho = (1.0 + 2.0 * self.damping_ratio) ** -2
        rate = 2.0 * math.pi * frequency * rho**-0.25
        settled = (1.0 - rho) / gain  # k / K = 1 / d
        return (-settled * math.expm1(-rate * dt), 0.0, 0.0, -math.exp(-rate * dt), 0.0)


def as_mode(mode, number):
    """Return the frequency of a mode in Hz and a second number, NaN if it has none.

    Of an operator or estimator the second number is the attribute named ``number``, of a pair the
    second entry.
    """
    operator = getattr(mode, "operator_", mode)
    if hasattr(operator, "natural_frequency"):
        return operator.natural_frequency / (2.0 * math.pi), getattr(operator, number, math.nan)
    if np.shape(operator) == (2,) and all(isinstance(value, Real) for value in operator):
        return float(operator[0]), float(operator[1])
    return math.nan, math.nan
