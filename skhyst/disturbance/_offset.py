"""Offset: one constant per record."""

from dataclasses import dataclass

import numpy as np

from .._jit import jit
from ..operators import parameter
from ._base import Disturbance, DisturbanceOperator


@jit
def offset_step(u, c, s):
    """Return the constant; ``c`` is (dt, coefficients)."""
    return c[1][0]


@dataclass(frozen=True)
class OffsetOperator(DisturbanceOperator):
    """A constant.

    Parameters
    ----------
    coefficients : ndarray of shape (1,)
        The constant, units of the response.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.disturbance import OffsetOperator
    >>> OffsetOperator(np.array([0.2])).run(np.zeros(3), dt=1.0)[0]
    array([0.2, 0.2, 0.2])
    """

    has_constant = True

    coefficients: np.ndarray = parameter(linear=True, unit="response")

    def basis(self, time):
        return np.ones((len(time), 1))

    def _step(self):
        return offset_step, (self.coefficients,)

    def characteristics(self, seen):
        return {"spread between records": (np.ptp(seen.coefficients), "response")}


class Offset(Disturbance):
    """Offset: one constant per record.

    Each record's own constant is in ``record_coefficients_``; :meth:`predict` gives the mean over
    the records of the fit, since the drive of a new record does not determine its constant.

    Attributes
    ----------
    record_coefficients_ : ndarray of shape (n_records, 1)
        Units of the response.

    See Also
    --------
    Drift : A slow function of time.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.disturbance import Offset
    >>> Offset().fit(np.zeros((4, 1)), [1.0, 2.0, 3.0, 4.0]).record_coefficients_
    array([[2.5]])
    """

    def starting_values(self, records):
        return [OffsetOperator(np.zeros(1))]
