"""The Jiles-Atherton model of ferromagnetic hysteresis."""

from dataclasses import dataclass

import numpy as np

from .._kernels._arrays import as_signal
from .._kernels._jiles_atherton import jiles_atherton_run, jiles_atherton_tangents
from ._base import Operator, parameter

__all__ = ["JilesAthertonOperator"]

_RESOLUTION = 0.1  # of the smaller of shape and pinning, the largest step by default


@dataclass(frozen=True)
class JilesAthertonOperator(Operator):
    r"""Magnetisation with saturation: from field strength ``H`` to flux density ``B``.

    .. math::

        B = J_s m + \mu H + c_0, \qquad
        \frac{dm}{dH} = \frac{\delta_M \frac{m_{an} - m}{k \delta - \alpha_s (m_{an} - m)}
        + c \frac{d m_{an}}{d H_e}}{1 - c \alpha_s \frac{d m_{an}}{d H_e}}, \qquad
        m_{an} = \coth \frac{H_e}{a} - \frac{a}{H_e}

    with :math:`m = M / M_s`, :math:`H_e = H + \alpha_s m`, :math:`\alpha_s = \alpha M_s`,
    :math:`\delta` the direction of the drive, and :math:`\delta_M = 0` where the magnetisation
    would move against the drive, 1 elsewhere.

    Parameters
    ----------
    saturation : float
        Saturation polarisation :math:`J_s = \mu_0 M_s`, units of the response.
    shape : float
        Shape parameter ``a`` of the anhysteretic curve, units of the drive, positive.
    pinning : float
        Pinning ``k``, units of the drive, positive; near the coercive field of soft materials.
    coupling : float
        :math:`\alpha M_s / (3 a)`, no unit, from 0 to below 1. At 1 the anhysteretic curve would
        be vertical at the origin.
    reversibility : float
        Reversible part ``c`` of the magnetisation, no unit, from 0 to 1.
    gain : float, default=0.0
        :math:`\mu`, response/drive: :math:`\mu_0` where the response is the flux density, 0 where
        it is the magnetisation or the polarisation. Not negative where it is identified.
    intercept : float, default=0.0
        Constant, units of the response.
    max_step : float, optional
        Longest step of integration, units of the drive; by default a tenth of the smaller of
        ``shape`` and ``pinning``, and then fixed: a copy with other values keeps it.

    Raises
    ------
    ValueError
        If a parameter is outside its range.

    Notes
    -----
    The state is the tuple (magnetisation m, last drive). ``"rest"`` is the first magnetisation
    from the demagnetised state to the first sample; in ``"zero"`` both are zero. Both give the
    same output, since the way to the first sample is that first magnetisation. The operator is
    rate-independent: ``dt`` is not used. It does not wipe out minor loops, and they do not close
    exactly: both are properties of the equation.

    References
    ----------
    D. C. Jiles, D. L. Atherton, "Theory of ferromagnetic hysteresis", J. Magn. Magn. Mater. 61
    (1986) 48-60. D. C. Jiles, J. B. Thoelke, M. K. Devine, "Numerical determination of hysteresis
    parameters for the modeling of magnetic properties using the theory of ferromagnetic
    hysteresis", IEEE Trans. Magn. 28 (1992) 27-35.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.operators import JilesAthertonOperator
    >>> operator = JilesAthertonOperator(1.5, 10.0, 12.0, 0.6, 0.2)
    >>> polarisation, _ = operator.run([0.0, 100.0, 0.0, -100.0, 0.0], dt=1.0)
    >>> np.round(polarisation, 3)
    array([ 0.   ,  1.357,  0.684, -1.357, -0.684])
    """

    saturation: float = parameter(linear=True, unit="response")
    shape: float = parameter(log=True, lower=0.0, unit="drive")
    pinning: float = parameter(log=True, lower=0.0, unit="drive")
    coupling: float = parameter(lower=0.0, upper=0.999)
    reversibility: float = parameter(lower=0.0, upper=1.0)
    gain: float = parameter(default=0.0, linear=True, lower=0.0, unit="response/drive")
    intercept: float = parameter(default=0.0, linear=True, gauge=0.0, unit="response")
    max_step: float | None = None

    carries_scale = True
    rank = 10

    def __post_init__(self):
        if self.max_step is None:
            object.__setattr__(self, "max_step", _RESOLUTION * min(self.shape, self.pinning))
        ranges = {
            "shape": (self.shape > 0.0, "positive"),
            "pinning": (self.pinning > 0.0, "positive"),
            "coupling": (0.0 <= self.coupling < 1.0, "in [0, 1)"),
            "reversibility": (0.0 <= self.reversibility <= 1.0, "in [0, 1]"),
            "max_step": (self.max_step > 0.0, "positive"),
        }
        for name, (valid, wanted) in ranges.items():
            if not valid:
                raise ValueError(
                    f"The '{name}' parameter of JilesAthertonOperator must be {wanted}. "
                    f"Got {getattr(self, name)!r} instead."
                )

    def _values(self):
        values = self.shape, self.pinning, self.coupling, self.reversibility, self.max_step
        return map(float, values)

    def _response(self, m, u):
        return self.saturation * m + self.gain * u + self.intercept

    def init(self, u0, initial_state="rest"):
        """Return the state before the first sample ``u0``: magnetisation and drive."""
        if initial_state == "zero":
            return 0.0, 0.0
        return jiles_atherton_run(as_signal([u0]), *self._values(), 0.0, 0.0, np.empty(1))

    def run(self, u, dt, state=None):
        """Map a drive of shape (n_samples,) to the response; see :meth:`Operator.run`."""
        u = as_signal(u)
        if state is None:
            state = 0.0, 0.0  # the way to the first sample is the first magnetisation
        m = np.empty(u.size)
        state = jiles_atherton_run(u, *self._values(), *state, m)
        return self._response(m, u), state

    def linearize(self, u, du, dt, initial_state="rest"):
        """Return the response and its tangents; see :meth:`Operator.linearize`."""
        u, du = as_signal(u), as_signal(du)
        upstream = du.shape[1]
        m, dm = np.empty(u.size), np.empty((u.size, upstream + 4))
        if u.size:
            jiles_atherton_tangents(u, du, *self._values(), m, dm)
        dy = np.empty((u.size, upstream + 7))
        dy[:, :upstream] = self.saturation * dm[:, :upstream] + self.gain * du
        dy[:, upstream] = m
        dy[:, upstream + 1 : upstream + 5] = self.saturation * dm[:, upstream:]
        dy[:, upstream + 5] = u
        dy[:, upstream + 6] = 1.0
        return self._response(m, u), dy
