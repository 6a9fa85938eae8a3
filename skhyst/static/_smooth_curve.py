"""Smooth memoryless curve: Legendre polynomials, and a straight line beyond them."""

from dataclasses import dataclass, replace
from numbers import Integral, Real
from typing import Self

import numpy as np

from .._jit import jit
from .._sklearn import Interval
from ..base import with_params
from ..operators import Resolution, Superposition, as_signal, parameter
from ._base import StaticModel, StaticOperator, range_of_drive

_BEYOND = 3  # highest degree of the terms that are extrapolated beyond the data


@jit
def legendre_curve(u, c, s):
    """Return ``passed u + scale sum_d coefficients_d P_d(z)``.

    ``c`` is (coefficients, centre, scale, passed).
    """
    coefficients, center, scale, passed = c
    z = (u - center) / scale
    inside = min(max(z, -1.0), 1.0)
    beyond = z - inside
    y = 0.0
    before, value, slope_before, slope = 1.0, inside, 0.0, 1.0  # of the degrees 0 and 1
    for k in range(coefficients.size):
        d = k + 2
        # d P_d = (2 d - 1) z P_{d-1} - (d - 1) P_{d-2},  P'_d = (2 d - 1) P_{d-1} + P'_{d-2}
        following = ((2 * d - 1) * inside * value - (d - 1) * before) / d
        slope_before, slope = slope, (2 * d - 1) * value + slope_before
        before, value = value, following
        y += coefficients[k] * value
        if d <= _BEYOND:
            y += coefficients[k] * slope * beyond
    return passed * u + scale * y


@jit
def _legendre_tangents(v, coefficients, center, scale, passed, slope, by_coefficients):
    """Fill the slope, and the derivatives by the coefficients, (n_samples, n_coefficients)."""
    for i in range(v.size):
        z = (v[i] - center) / scale
        inside = min(max(z, -1.0), 1.0)
        beyond = z - inside
        slope[i] = passed
        before, value, slope_before, derivative = 1.0, inside, 0.0, 1.0
        for k in range(coefficients.size):
            d = k + 2
            following = (value * inside * (2 * d - 1) - before * (d - 1)) / d
            slope_before, derivative = derivative, (2 * d - 1) * value + slope_before
            before, value = value, following
            end_slope = derivative if d <= _BEYOND or beyond == 0.0 else 0.0
            by_coefficients[i, k] = scale * (value + end_slope * beyond)
            slope[i] += coefficients[k] * end_slope


@dataclass(frozen=True)
class PolynomialCurveOperator(StaticOperator):
    """Smooth curve ``y = passed v + scale sum_d coefficients_d P_d((v - center) / scale)``.

    P_d are the Legendre polynomials from degree 2 on. Beyond ``center +- scale`` the curve is a
    straight line with the slope that its terms up to degree 3 have at the end. These two suffice
    for any slope at either end, and an error of a coefficient is amplified by the slope of P_d
    there, d (d + 1) / 2, which grows with the degree.

    Parameters
    ----------
    coefficients : ndarray of shape (degree - 1,)
        From degree 2 on.
    center, scale : float
        Middle and half of the range of the polynomials, units of the drive. Fixed structure.
    stage_order : int, default=40
        Place in a series. Fixed structure.
    passed : float, default=1.0
        1 if the input itself is part of the output, 0 if not: the coefficients are then in
        response/drive. Fixed structure.

    Raises
    ------
    ValueError
        If ``scale`` is not above 0.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.static import PolynomialCurveOperator
    >>> curve = PolynomialCurveOperator(np.array([0.1]), center=0.0, scale=1.0)
    >>> curve.run([-1.0, 0.0, 1.0], dt=1.0)[0].round(2).tolist()
    [-0.9, -0.05, 1.1]
    """

    coefficients: np.ndarray = parameter(linear=True)
    center: float
    scale: float
    stage_order: int = 40
    passed: float = 1.0

    resolution = Resolution("terms of a curve", "coefficients")

    curve = staticmethod(legendre_curve)

    def __post_init__(self):
        super().__post_init__()
        self._require("scale", self.scale > 0.0, "be above 0")

    def parameter_specs(self):
        specs = super().parameter_specs()
        if not self.passed:
            specs["coefficients"] = replace(specs["coefficients"], unit="response/drive")
        return specs

    def characteristics(self, seen):
        return self.bend(seen) if self.passed else {}

    def finer(self, records):
        """Return the degrees of further terms: as many as there are, at least two."""
        n = np.size(self.coefficients)
        return n + 2 + np.arange(max(n, 2))

    def curve_constants(self):
        return self.coefficients, self.center, self.scale, self.passed

    def evaluate(self, v):
        v, coefficients = as_signal(v), as_signal(self.coefficients)
        slope, by_coefficients = np.empty(v.size), np.empty((coefficients.size, v.size)).T
        constants = coefficients, float(self.center), float(self.scale), float(self.passed)
        _legendre_tangents(v, *constants, slope, by_coefficients)
        return self.passed * v + by_coefficients @ coefficients, slope, by_coefficients


class SmoothCurve(StaticModel):
    r"""Smooth memoryless curve: Legendre polynomials from degree 2 on, added to the identity.

    Beyond the range of the fit, or `reach` times that, the curve is a straight line with the slope
    that its terms of degree 2 and 3 have at the end of the range.

    Parameters
    ----------
    degree : int, default=5
        Highest degree, at least 2.
    reach : float, default=1.0
        Half of the range over which it is a polynomial, relative to that of the fit: above 1 for a
        law, such as a cubic spring, that continues beyond the recorded range.
    passes : bool, default=True
        Whether the input itself is part of the output. False: the polynomials alone, in parallel
        with a model that has a gain.

    Attributes
    ----------
    operator_ : PolynomialCurveOperator
        ``coefficients``, from degree 2 on, relative to ``scale``.

    See Also
    --------
    DeadZones : A curve in straight pieces.
    SoftSaturation : A curve with two limits.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.static import SmoothCurve
    >>> u = np.linspace(-1, 1, 201)
    >>> y = u + 0.1 * (u**3 - 0.6 * u)
    >>> model = SmoothCurve(degree=3).fit(u.reshape(-1, 1), y)
    >>> bool(np.allclose(model.predict(u.reshape(-1, 1)), y))
    True
    """

    _parameter_constraints = {
        **StaticModel._parameter_constraints,
        "degree": [Interval(Integral, 2, None, closed="left")],
        "reach": [Interval(Real, 0, None, closed="neither")],
        "passes": ["boolean"],
    }

    operator_class = PolynomialCurveOperator

    def __init__(
        self,
        degree=5,
        *,
        reach=1.0,
        passes=True,
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        super().__init__(initial_state=initial_state, dt=dt, drive=drive, method=method)
        self.degree = degree
        self.reach = reach
        self.passes = passes

    def resolved(self, operator) -> Self:
        return with_params(self, degree=np.size(operator.coefficients) + 1)

    def starting_values(self, records):
        low, high = range_of_drive(records)
        scale = 0.5 * self.reach * (high - low) or 1.0
        coefficients = np.zeros(self.degree - 1)
        # in parallel with a hysteresis, it stands where that does
        order = PolynomialCurveOperator.stage_order if self.passes else Superposition.stage_order
        return [
            PolynomialCurveOperator(
                coefficients, 0.5 * (low + high), scale, order, float(self.passes)
            )
        ]
