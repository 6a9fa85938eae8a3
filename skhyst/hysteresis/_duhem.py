"""Duhem model of Coleman and Hodgdon, exact on straight pieces of the drive.

The memory terms follow ``dH_j/du = -s alpha H_j + t^j`` with ``s`` the sign of the motion and
``t = (u - center)/scale``, j = 0 .. d-1. On a straight piece with ``x = alpha |change|``,
``H_j = exp(-x) H_j0 + change M_j``, ``M_j = int_0^1 exp(-x (1 - a)) (t0 + (t1 - t0) a)^j da``. The
response is ``f(u) + sum_j (b_j - (j + 1) a_(j+1)) H_j + c``: linear in all but ``alpha``.
"""

import dataclasses
import math
from numbers import Integral

import numpy as np

from .._jit import jit
from .._sklearn import Interval
from ..base import ParametricModel
from ..operators import CompiledLaw, Operator, as_constant, as_signal, parameter
from ._common import half_range, largest_peak_to_peak

_LONGEST = 1e300  # path in units of 1/alpha; infinity times zero would be NaN
MAX_TERMS = 9  # the upward recursion from x = 1 amplifies rounding by i at step i, by 9! in all
# I_n = sum_k (-x)^k n!/(n+k+1)!, one row per n; below each x this many terms are exact to rounding
_SMALL, _MIDDLE, _LARGE = (0.02, 8), (0.25, 12), (1.0, 18)
_SERIES = np.cumprod(
    np.where(np.arange(_LARGE[1]) == 0, 1.0, -1.0)
    / (np.arange(MAX_TERMS + 1.0)[:, None] + np.arange(1.0, _LARGE[1] + 1.0)),
    axis=1,
)


@jit(inline=True)
def exponential_moments(x, moments, at, last):
    """Write ``int_0^1 exp(-x (1 - a)) a^i da``, i = 0 .. last, to ``moments[at]`` and on.

    Integration by parts gives ``x I_i = 1 - i I_(i-1)``: for small x this recursion runs downwards
    from a series, for large x upwards; both are stable up to ``MAX_TERMS``. Returns ``exp(-x)``.
    """
    if x < 1.0:
        n_terms = _SMALL[1] if x < _SMALL[0] else (_MIDDLE[1] if x < _MIDDLE[0] else _LARGE[1])
        # even and odd powers separately: two short chains of operations instead of a long one
        even = 0.0
        odd = 0.0
        square = x * x
        for k in range(n_terms - 2, -2, -2):
            even = even * square + _SERIES[last, k]
            odd = odd * square + _SERIES[last, k + 1]
        value = even + x * odd
        for i in range(last, 0, -1):
            moments[at + i] = value
            value = (1.0 - x * value) / i
        moments[at] = value
        return 1.0 - x * value
    decay = math.exp(-x)
    value = (1.0 - decay) / x
    moments[at] = value
    for i in range(1, last + 1):
        value = (1.0 - i * value) / x
        moments[at + i] = value
    return decay


@jit(inline=True)
def response(t, scale, curve, weights, s, y):
    """Return ``y`` plus the curve at t plus the weighted memory terms (first values of s)."""
    value = 0.0
    for j in range(curve.size - 1, -1, -1):
        value = (value + curve[j]) * t
    y += scale * value
    for j in range(curve.size):
        y += weights[j] * s[j]
    return y


@jit
def duhem_step(u, c, s):
    """Return the response at one sample; ``s`` is H (d,), the last drive, and work space (d,).

    ``c`` is (alpha, center, scale, curve, weights of H, intercept).
    """
    alpha, center, scale, curve, weights, y = c
    d = curve.size
    room, change = d + 1, u - s[d]
    x = min(alpha * abs(change), _LONGEST)
    decay = exponential_moments(x, s, room, d - 1)
    start, step = (s[d] - center) / scale, change / scale
    for j in range(d):
        s[j] = decay * s[j] + change * s[room]
        for i in range(d - 1 - j):
            s[room + i] = start * s[room + i] + step * s[room + i + 1]
    s[d] = u
    return response((u - center) / scale, scale, curve, weights, s, y)


@jit
def first_degree_step(u, c, s):
    """Return the response as :func:`duhem_step` does, for d = 1, in a third of the time."""
    alpha, center, scale, curve, weights, y = c
    change = u - s[1]
    x = min(alpha * abs(change), _LONGEST)
    s[0] = math.exp(-x) * s[0] + change * (-math.expm1(-x) / x if x > 0.0 else 1.0)
    s[1] = u
    return response((u - center) / scale, scale, curve, weights, s, y)


@jit
def duhem_moments(x, t0, step, work, moments):
    """Write ``M_ij = int_0^1 exp(-x (1 - a)) a^i (t0 + step a)^j da`` to ``moments`` (k, d).

    ``work`` has shape (d + k - 1,). Returns ``exp(-x)``.
    """
    decay = exponential_moments(x, work, 0, work.size - 1)
    k, d = moments.shape
    for i in range(k):
        moments[i, 0] = work[i]
    for j in range(1, d):
        for i in range(work.size - j):
            work[i] = t0 * work[i] + step * work[i + 1]
        for i in range(k):
            moments[i, j] = work[i]
    return decay


@jit
def duhem_tangents(u, du, alpha, center, scale, out, dout):
    """Write the memory terms of ``u`` to ``out`` (n, d), starting from zero at drive zero.

    Their tangents for ``du`` (n, m), then their derivatives by ``alpha``, go to ``dout``
    (n, d, m + 1).
    """
    d, m, before = out.shape[1], du.shape[1], 0.0
    work, moments = np.empty(d + 1), np.empty((2, d))
    h, dbefore, dh = np.zeros(d), np.zeros(m), np.zeros((d, m + 1))
    for k in range(u.size):
        change = u[k] - before
        x = min(alpha * abs(change), _LONGEST)
        # at rest the mean of both directions
        steep = math.copysign(alpha, change) if change != 0.0 else 0.0
        decay = duhem_moments(x, (before - center) / scale, change / scale, work, moments)
        for j in range(d):
            out[k, j] = decay * h[j] + change * moments[0, j]
            # derivatives by x, then by the end and by the start of the piece
            by_x = -decay * h[j] - change * (moments[0, j] - moments[1, j])
            by_end = moments[0, j] + steep * by_x
            by_start = -by_end
            if j > 0:
                by_end += j * change / scale * moments[1, j - 1]
                by_start += j * change / scale * (moments[0, j - 1] - moments[1, j - 1])
            for q in range(m):
                dout[k, j, q] = decay * dh[j, q] + by_end * du[k, q] + by_start * dbefore[q]
            dout[k, j, m] = decay * dh[j, m] + by_x * abs(change)
        before, h = u[k], out[k]
        for q in range(m):
            dbefore[q] = du[k, q]
        dh = dout[k]


@dataclasses.dataclass(frozen=True, eq=False)
class DuhemOperator(Operator):
    """Duhem model with polynomials for its two functions: the law of :class:`Duhem`.

    ``f`` is the curve that the response approaches, ``g`` the slope of the response on that curve.

    Parameters
    ----------
    alpha : float
        Reciprocal of the path of the drive over which memory decays, 1/drive, positive.
    curve : array-like of shape (d,)
        Coefficients ``a_i`` of ``f``, in response/drive.
    slope : array-like of shape (d,)
        Coefficients ``b_j`` of ``g``, in response/drive.
    intercept : float, default=0.0
        Constant ``c`` in units of the response.
    center, scale : float, default=0.0, 1.0
        ``m`` and ``s`` in units of the drive, fixed structure: beyond ``center +- scale`` the
        polynomials extrapolate.

    Raises
    ------
    ValueError
        If there are not as many coefficients of ``f`` as of ``g``, or none, or more than 9.

    Notes
    -----
    The step along the straight line between two samples is exact. The model is rate-independent:
    ``dt`` is not used. At degree 1 the response equals that of a Dahl model with
    ``x_c = 1/alpha``, ``F_c = (b_0 - a_1)/alpha`` and a spring ``a_1``. The state is
    ``(H, last drive)``.

    Examples
    --------
    >>> from skhyst.hysteresis import DuhemOperator
    >>> operator = DuhemOperator(1.0, curve=[1.0], slope=[0.5])
    >>> operator.run([0.0, 20.0, 19.0, 0.0], dt=1e-3)[0].round(3)
    array([ 0.   , 19.5  , 19.132,  0.5  ])
    """

    alpha: float = parameter(log=True, lower=0.0, unit="1/drive")
    curve: np.ndarray = parameter(linear=True, unit="response/drive")
    slope: np.ndarray = parameter(linear=True, unit="response/drive")
    intercept: float = parameter(default=0.0, linear=True, gauge=0.0, unit="response")
    center: float = 0.0
    scale: float = 1.0

    owns_gain = True
    stage_order = 10

    def __post_init__(self):
        super().__post_init__()
        self._require("scale", self.scale > 0.0, "be above 0")
        for name in ("curve", "slope"):
            object.__setattr__(self, name, as_constant(getattr(self, name)))
        shape = self.curve.shape
        if shape != self.slope.shape or len(shape) != 1 or not 1 <= shape[0] <= MAX_TERMS:
            raise ValueError(
                "The 'curve' and 'slope' parameters of DuhemOperator must be lists of one length, "
                f"from 1 to {MAX_TERMS}. Got shapes {shape} and {self.slope.shape} instead."
            )

    def _excess(self):
        """Return the weights of the memory terms: the coefficients of ``g - f'``."""
        return self.slope - np.arange(1, self.curve.size + 1) * self.curve

    def init(self, u0, initial_state="rest"):
        h = np.zeros(self.curve.size)
        if initial_state == "zero":
            return h, 0.0
        return self.run([u0], 1.0, (h, 0.0))[1]

    def run(self, u, dt, state=None):
        step, d = (
            self.compiled_step(dt, state or self.init(u[0] if len(u) else 0.0)),
            self.curve.size,
        )
        s = step.state.copy()
        y = step.streaming(s)(u)
        return y, (s[:d].copy(), float(s[d]))

    def compiled_step(self, dt, state):
        h, last = state
        shape = self.alpha, self.center, self.scale, self.curve, self._excess(), self.intercept
        law = first_degree_step if h.size == 1 else duhem_step
        return CompiledLaw(law, shape, [*h, last, *np.zeros(h.size)])

    def sensitivities(self, u, du, dt, initial_state="rest"):
        # "rest" and "zero" agree: in both the path starts at zero, and the law is rate-independent
        u, du = as_signal(u), as_signal(du)
        m, d = du.shape[1], self.curve.size
        tangents = np.empty((u.size, d, m + 1))
        memory = np.empty((u.size, d))
        shape = float(self.alpha), float(self.center), float(self.scale)
        duhem_tangents(u, du, *shape, memory, tangents)
        powers = np.vander((u - self.center) / self.scale, d + 1, increasing=True)
        degrees = np.arange(1, d + 1)
        dy = np.empty((u.size, m + self.n_parameters))
        dy[:, : m + 1] = np.einsum("j,njq->nq", self._excess(), tangents)
        dy[:, :m] += (powers[:, :-1] @ (degrees * self.curve))[:, None] * du
        dy[:, m + 1 : m + 1 + d] = self.scale * powers[:, 1:] - degrees * memory
        dy[:, m + 1 + d : m + 1 + 2 * d] = memory
        dy[:, -1] = 1.0
        return self.run(u, dt, (np.zeros(d), 0.0))[0], dy


_STARTS = np.geomspace(0.003, 1.0, 6)  # starting 1/alpha, fractions of the peak-to-peak drive


class Duhem(ParametricModel):
    r"""Duhem model in the rate-independent form of Coleman and Hodgdon, with two polynomials.

    .. math::

        \dot h = \alpha |\dot u| (f(u) - h) + \dot u\, g(u), \qquad y = h + c

        f(u) = s \sum_{i=1}^{d} a_i t^i, \quad g(u) = \sum_{j=0}^{d-1} b_j t^j, \quad
        t = (u - m)/s

    At degree 1, ``f(u) = a u`` and ``g(u) = b``. All but ``alpha`` is linear and solved exactly.

    Parameters
    ----------
    degree : int, default=1
        Degree ``d`` of ``f``, one more than that of ``g``. 1 is a loop of two exponential branches
        about a straight line, the same as :class:`Dahl` with a spring; with higher degrees the
        line is curved and the branches differ in shape.
    fit_intercept : bool, default=True
        Whether the response has a constant.

    Attributes
    ----------
    operator_ : DuhemOperator
        ``alpha`` in 1/drive, ``curve`` a_i and ``slope`` b_j in response/drive, ``intercept`` in
        units of the response. At degree 1 ``t = u``; otherwise ``t`` is -1 to 1 over the range of
        the drive in the records of the fit (``center``, ``scale``).

    See Also
    --------
    Dahl : The same loop at degree 1, in the parameters of friction.
    BoucWen : Another shape of the branches.
    JilesAtherton : The law of magnetic materials.

    References
    ----------
    Coleman and Hodgdon, *International Journal of Engineering Science*, 1986.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import Duhem, DuhemOperator
    >>> drive = np.sin(np.linspace(0, 20, 2000))
    >>> y, _ = DuhemOperator(3.0, curve=[1.0], slope=[0.4]).run(drive, 1.0)
    >>> model = Duhem().fit(drive.reshape(-1, 1), y)
    >>> {name: round(value, 3) + 0.0 for name, value in model.params_.items()}
    {'alpha': 3.0, 'curve[0]': 1.0, 'slope[0]': 0.4, 'intercept': 0.0}
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "degree": [Interval(Integral, 1, 9, closed="both")],
        "fit_intercept": ["boolean"],
    }

    largest_value = 1e30  # largest value of the data: products of several are squared
    operator_class = DuhemOperator

    def __init__(
        self,
        degree=1,
        *,
        fit_intercept=True,
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        super().__init__(initial_state=initial_state, dt=dt, drive=drive, method=method)
        self.degree = degree
        self.fit_intercept = fit_intercept

    def starting_values(self, records):
        length = largest_peak_to_peak(records)
        slope = half_range(records) / length
        low = min(float(record.u.min()) for record in records)
        high = max(float(record.u.max()) for record in records)
        center, scale = 0.0, 1.0
        if self.degree > 1:
            center, scale = 0.5 * (low + high), 0.5 * (high - low) or 1.0
        curve, slopes = np.zeros((2, self.degree))
        curve[0], slopes[0] = 2.0 * slope, slope
        return [
            DuhemOperator(1.0 / (part * length), curve, slopes, center=center, scale=scale)
            for part in _STARTS
        ]
