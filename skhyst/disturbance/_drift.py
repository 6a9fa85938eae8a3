"""A slow function of time: Legendre polynomials over the longest record."""

from dataclasses import dataclass
from numbers import Integral

import numpy as np

from .._jit import jit
from .._sklearn import Interval
from ..base import ParametricModel
from ..operators import parameter
from ._base import Disturbance, DisturbanceOperator


@jit
def drift_step(u, c, s):
    """Return the drift at sample number ``s[0]``; ``c`` is (dt, coefficients, duration)."""
    dt, coefficients, duration = c
    z = min(2.0 * dt * s[0] / duration - 1.0, 1.0)
    s[0] += 1.0
    before, value, y = 0.0, 1.0, 0.0
    for d in range(coefficients.size):
        y += coefficients[d] * value
        # (d + 1) P_{d+1} = (2 d + 1) z P_d - d P_{d-1}
        before, value = value, ((2 * d + 1) * z * value - d * before) / (d + 1)
    return y


@dataclass(frozen=True)
class DriftOperator(DisturbanceOperator):
    """Legendre polynomials of time over ``duration``, from degree 0; constant afterwards.

    Parameters
    ----------
    coefficients : ndarray of shape (degree + 1,)
        Units of the response.
    duration : float
        Of the polynomials, s. Fixed structure.

    Raises
    ------
    ValueError
        If there is no coefficient, or ``duration`` is not above 0.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.disturbance import DriftOperator
    >>> DriftOperator(np.array([0.5, 0.5]), duration=2.0).run(np.zeros(4), dt=1.0)[0]
    array([0. , 0.5, 1. , 1. ])
    """

    has_constant = True

    def __post_init__(self):
        super().__post_init__()
        self._require("duration", self.duration > 0.0, "be above 0")
        is_right = np.ndim(self.coefficients) == 1 and np.size(self.coefficients) > 0
        self._require("coefficients", is_right, "be an array of one value at least")

    coefficients: np.ndarray = parameter(linear=True, unit="response")
    duration: float

    def basis(self, time):
        z = np.clip(2.0 * time / self.duration - 1.0, -1.0, 1.0)
        return np.polynomial.legendre.legvander(z, np.size(self.coefficients) - 1)

    def _step(self):
        return drift_step, (self.coefficients, self.duration)

    def characteristics(self, seen):
        curves = zip(seen.inputs, seen.dts, seen.coefficients, strict=True)
        spans = [
            np.ptp(self.basis(dt * np.arange(len(u))) @ coefficients)
            for u, dt, coefficients in curves
        ]
        return {"largest span in a record": (max(spans), "response")}


class Drift(Disturbance):
    """A slow function of the time since each record's start: Legendre polynomials.

    Parameters
    ----------
    degree : int, default=3
        Highest degree.

    Attributes
    ----------
    record_coefficients_ : ndarray of shape (n_records, degree + 1)
        Units of the response; :meth:`predict` gives the mean over the records.

    See Also
    --------
    Offset : One constant per record.
    skhyst.linear.LogCreep : Slow motion that the drive causes.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.disturbance import Drift
    >>> model = Drift(degree=1).fit(np.zeros((5, 1)), [0.0, 1.0, 2.0, 3.0, 4.0])
    >>> np.round(model.predict(np.zeros((3, 1))), 9) + 0.0
    array([0., 1., 2.])
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "degree": [Interval(Integral, 0, None, closed="left")],
    }

    def __init__(
        self, degree=3, *, initial_state="rest", dt=None, drive=None, method="variable_projection"
    ):
        super().__init__(initial_state=initial_state, dt=dt, drive=drive, method=method)
        self.degree = degree

    def starting_values(self, records):
        duration = max((len(record.u) - 1) * record.dt for record in records)
        return [DriftOperator(np.zeros(self.degree + 1), duration or records[0].dt)]
