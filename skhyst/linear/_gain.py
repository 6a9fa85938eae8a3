"""Static gain, ``y = gain u + intercept``."""

from dataclasses import dataclass

import numpy as np

from .._jit import jit
from ..operators import CompiledLaw, Operator, as_signal, parameter
from ._linear import LinearModel


@jit
def gain_step(u, c, s):
    """Return ``gain u + intercept``."""
    gain, intercept = c
    return gain * u + intercept


@dataclass(frozen=True)
class GainOperator(Operator):
    """``y = gain u + intercept``.

    Parameters
    ----------
    gain : float, default=1.0
        Static gain, response/drive.
    intercept : float, default=0.0
        Units of the response.

    Examples
    --------
    >>> from skhyst.linear import GainOperator
    >>> GainOperator(2.0, 1.0).run([0.0, 1.0], dt=1.0)[0]
    array([1., 3.])
    """

    gain: float = parameter(default=1.0, linear=True, gauge=1.0, unit="response/drive")
    intercept: float = parameter(default=0.0, linear=True, gauge=0.0, unit="response")

    signal_linear = True
    has_matrices = True
    memoryless = True
    n_poles = (0, 0)

    def init(self, u0, initial_state="rest"):
        return None

    def run(self, u, dt, state=None):
        return self.gain * as_signal(u) + self.intercept, None

    def compiled_step(self, dt, state):
        return CompiledLaw(gain_step, (self.gain, self.intercept), ())

    def discrete(self, dt):
        """Return the matrices of a system without states.

        Parameters
        ----------
        dt : float
            Sampling interval in s.

        Returns
        -------
        tuple
            As :meth:`LinearOperator.discrete` returns it.
        """
        return np.empty((0, 0)), np.empty(0), np.empty(0), np.empty(0), self.gain

    def inverse(self):
        """Return the inverse, also a gain.

        Raises
        ------
        ValueError
            If the gain is 0.
        """
        self._require("gain", self.gain != 0.0, "not be 0 to have an inverse")
        return GainOperator(1.0 / self.gain, -self.intercept / self.gain)

    def sensitivities(self, u, du, dt, initial_state="rest"):
        u = as_signal(u)
        m = du.shape[1]
        dy = np.empty((u.size, m + 2))
        np.multiply(du, self.gain, out=dy[:, :m])
        dy[:, m] = u
        dy[:, m + 1] = 1.0
        return self.gain * u + self.intercept, dy


class Gain(LinearModel):
    r"""Static gain: the response is proportional to the drive.

    .. math:: y = g u + c

    The simplest model of an actuator, and of the effect of an auxiliary input.

    Attributes
    ----------
    operator_ : GainOperator
        ``gain`` in response units over drive units, ``intercept`` in units of the response.

    See Also
    --------
    skhyst.static.SmoothCurve : A curve in place of a straight line.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import Gain
    >>> X = np.linspace(0.0, 5.0, 50).reshape(-1, 1)
    >>> model = Gain().fit(X, 2.0 * X[:, 0] + 1.0)
    >>> round(model.operator_.gain, 6), round(model.operator_.intercept, 6)
    (2.0, 1.0)
    """

    operator_class = GainOperator
    _parameter_constraints = dict(LinearModel._parameter_constraints)
    del _parameter_constraints["hold"]

    def __init__(
        self,
        *,
        fit_gain=True,
        fit_intercept=True,
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        self.fit_gain = fit_gain
        self.fit_intercept = fit_intercept
        self.initial_state = initial_state
        self.dt = dt
        self.drive = drive
        self.method = method

    def starting_values(self, records):
        return [GainOperator(slope(records) if self.fit_gain else 1.0)]


def slope(records):
    """Return the least-squares slope of the response over the drive, 1 for a constant drive."""
    u = np.concatenate([record.u for record in records])
    y = np.concatenate([record.y for record in records])
    u, y = u - u.mean(), y - y.mean()
    power = u @ u
    return float(u @ y / power) if power > 0.0 else 1.0
