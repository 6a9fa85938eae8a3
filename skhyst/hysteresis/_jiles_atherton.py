r"""Jiles-Atherton model of ferromagnetic hysteresis, integrated over the drive.

With the magnetisation ``m`` in units of its saturation, the drive ``H``, ``x = H / a + 3 b m`` (the
effective field over the shape parameter a; ``b = alpha Ms / (3 a)`` is the coupling), the Langevin
function L and the direction ``d`` of the drive,

    dm/dH = (X + c L'(x) / a) / (1 - 3 b c L'(x)),    X = e / (k - 3 a b e),  e = d (L(x) - m),

where X is zero unless e is positive. Since L' <= 1/3, e never exceeds k / (3 a) and the denominator
of X stays above k (1 - b) while b < 1. In X, e is limited to the midpoint between k / (3 a) and the
pole, and m to [-1, 1]. A solution never reaches these limits, but they keep coarse steps finite.

The number of steps per interval depends only on the change of H and on ``max_step``, so the result
is a smooth function of the parameters. The steps are fourth-order Runge-Kutta. Where e changes its
sign, once after a reversal, X has a kink, and the one step across it is of second order.
"""

import dataclasses
import math
from dataclasses import dataclass
from itertools import product
from numbers import Real

import numpy as np

from .._jit import jit
from .._sklearn import Interval, StrOptions
from ..base import ParametricModel, refine
from ..operators import OneStateOperator, parameter
from ._common import in_direction, largest_drive

_RESOLUTION = 0.1  # default of the largest step over the smaller of shape and pinning
_MOST_STEPS = 10000.0  # steps per sampling interval, so that a run ends for any drive
# 2^(2n) B(2n) / (2n)!, the coefficients of x^(2n-1) in L(x); B are the Bernoulli numbers
_L = (
    1 / 3,
    -1 / 45,
    2 / 945,
    -1 / 4725,
    2 / 93555,
    -1382 / 638512875,
    4 / 18243225,
    -3617 / 162820783125,
    87734 / 38979295480125,
    -349222 / 1531329465290625,
    310732 / 13447856940643125,
    -472728182 / 201919571963756521875,
    2631724 / 11094481976030578125,
)
_L1 = tuple((2 * n + 1) * value for n, value in enumerate(_L))
_L2 = tuple(2 * n * value for n, value in enumerate(_L1))


@jit
def langevin(x):
    """Return ``L(x) = coth(x) - 1 / x`` and its first two derivatives."""
    z = x * x
    if z < 0.25:
        value = _L[12]
        first = _L1[12]
        second = _L2[12]
        for n in range(11, 0, -1):
            value = _L[n] + z * value
            first = _L1[n] + z * first
            second = _L2[n] + z * second
        return x * (_L[0] + z * value), _L1[0] + z * first, x * second
    decay = math.exp(-2.0 * abs(x))
    quotient = 1.0 / (1.0 - decay)
    coth = math.copysign((1.0 + decay) * quotient, x)
    inverse = 1.0 / x
    square = 4.0 * decay * quotient * quotient  # 1 / sinh(x)^2
    return (
        coth - inverse,
        inverse * inverse - square,
        2.0 * (coth * square - inverse * inverse * inverse),
    )


@jit
def susceptibility(field, m, direction, a, k, b, c):
    """Return dm/dH and its derivatives by field, m, a, k, b and c."""
    curve, slope, bend = langevin(field / a + 3.0 * b * m)
    e = direction * (curve - m)
    # X (``irreversible``) and its derivatives by e, and at constant e by a, k and b
    feedback = 3.0 * a * b
    # e is limited to the midpoint; below a quarter of k (1 + b), since e <= 2 is far from it
    pole = max(2.0 * feedback, 0.25 * k * (1.0 + b))
    is_limited = pole * e > k * (1.0 + b)
    e = min(max(e, 0.0), k * (1.0 + b) / pole)
    inverse = 1.0 / (k - feedback * e)
    irreversible = e * inverse
    by_e = by_a = by_k = by_b = 0.0
    if is_limited:
        by_a = -irreversible / a
        by_b = 2.0 / ((1.0 - b) * (1.0 - b) * feedback) - irreversible / b
    elif e > 0.0:
        by_e = k * inverse * inverse
        by_k = -irreversible * inverse
        by_a = 3.0 * b * irreversible * irreversible
        by_b = 3.0 * a * irreversible * irreversible
    # the susceptibility; its derivatives by x, then at constant x by the others
    reversible = slope / a
    inverse = 1.0 / (1.0 - 3.0 * b * c * slope)
    value = (irreversible + c * reversible) * inverse
    by_x = (by_e * direction * slope + c * bend / a + value * 3.0 * b * c * bend) * inverse
    return (
        value,
        by_x / a,
        by_x * 3.0 * b - by_e * direction * inverse,
        (by_a - c * reversible / a) * inverse - by_x * field / (a * a),
        by_k * inverse,
        (by_b + value * 3.0 * c * slope) * inverse + by_x * 3.0 * m,
        (reversible + value * 3.0 * b * slope) * inverse,
    )


@jit
def increment(s, field, part, h, n, direction, a, k, b, c):
    """Return the increment of a Runge-Kutta stage: ``h`` times the susceptibility, with tangents.

    ``part`` is the fraction of the interval at which the stage is evaluated. ``s`` holds the
    magnetisation and its derivatives: by the magnetisation and the drive at the beginning of the
    interval, by the change of the drive over its n steps, and by a, k, b and c.
    """
    value, by_field, by_m, by_a, by_k, by_b, by_c = susceptibility(
        field, s[0], direction, a, k, b, c
    )
    steep = h * by_m
    return (
        h * value,
        steep * s[1],
        steep * s[2] + h * by_field,
        steep * s[3] + h * by_field * part + value / n,
        steep * s[4] + h * by_a,
        steep * s[5] + h * by_k,
        steep * s[6] + h * by_b,
        steep * s[7] + h * by_c,
    )


@jit
def add(s, weight, t):
    """Return ``s + weight t``, tuples of eight."""
    return (
        s[0] + weight * t[0],
        s[1] + weight * t[1],
        s[2] + weight * t[2],
        s[3] + weight * t[3],
        s[4] + weight * t[4],
        s[5] + weight * t[5],
        s[6] + weight * t[6],
        s[7] + weight * t[7],
    )


def jiles_atherton_step(m, u0, u1, dt, values):
    """Return the next magnetisation and the flux density, each with its derivatives."""
    saturation, a, k, b, c, gain, intercept, max_step = values
    change = u1 - u0
    s = (m, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    if change == 0.0:  # without a direction of motion, the slope is the mean of both
        rising, _, _, _, _, _, _ = susceptibility(u0, m, 1.0, a, k, b, c)
        falling, _, _, _, _, _, _ = susceptibility(u0, m, -1.0, a, k, b, c)
        s = (m, 1.0, 0.0, 0.5 * (rising + falling), 0.0, 0.0, 0.0, 0.0)
    else:
        d = 1.0 if change > 0.0 else -1.0
        n = math.ceil(min(max(abs(change) / max_step, 1.0), _MOST_STEPS))
        h = change / n
        for j in range(n):
            field = u0 + j * h
            middle = field + 0.5 * h
            k1 = increment(s, field, j / n, h, n, d, a, k, b, c)
            k2 = increment(add(s, 0.5, k1), middle, (j + 0.5) / n, h, n, d, a, k, b, c)
            k3 = increment(add(s, 0.5, k2), middle, (j + 0.5) / n, h, n, d, a, k, b, c)
            k4 = increment(add(s, 1.0, k3), field + h, (j + 1.0) / n, h, n, d, a, k, b, c)
            s = add(s, 1.0 / 6.0, add(add(k1, 1.0, k4), 2.0, add(k2, 1.0, k3)))
            within = 1.0 if abs(s[0]) <= 1.0 else 0.0  # a limit has no derivatives
            m = min(max(s[0], -1.0), 1.0)
            s = (
                m,
                within * s[1],
                within * s[2],
                within * s[3],
                within * s[4],
                within * s[5],
                within * s[6],
                within * s[7],
            )
    m, by_m, by_start, by_change, by_a, by_k, by_b, by_c = s
    by_start -= by_change
    y = saturation * m + gain * u1 + intercept
    y_by = (
        saturation * by_m,
        saturation * by_start,
        saturation * by_change + gain,
        m,
        saturation * by_a,
        saturation * by_k,
        saturation * by_b,
        saturation * by_c,
        u1,
        1.0,
    )
    return m, y, (by_m, by_start, by_change, 0.0, by_a, by_k, by_b, by_c), y_by


@dataclass(frozen=True)
class JilesAthertonOperator(OneStateOperator, step=jiles_atherton_step):
    r"""Flux density ``B`` of a field strength ``H``: the law of :class:`JilesAtherton`.

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
        Largest integration step, units of the drive; by default a tenth of the smaller of
        ``shape`` and ``pinning``. It is then fixed: a copy with other values keeps it.
    falling : bool, default=False
        Whether the gain is not positive, instead of not negative, if it is identified: the response
        falls where the drive rises.

    Raises
    ------
    ValueError
        If a parameter is outside its range.

    Notes
    -----
    The state is the tuple (magnetisation m, last drive). ``"rest"`` is the state after the first
    magnetisation from the demagnetised state to the first sample; in ``"zero"`` both are zero. Both
    give the same output, since the step to the first sample is that first magnetisation. The
    operator is rate-independent: ``dt`` is not used. It does not wipe out minor loops, and they do
    not close exactly: both are properties of the equation.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import JilesAthertonOperator
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
    falling: bool = False

    owns_gain = True
    stage_order = 10
    structure = ("max_step",)

    def parameter_specs(self):
        """Return the identifiable fields; the gain of a response that falls is not above zero."""
        specs = super().parameter_specs()
        if self.falling:
            specs["gain"] = dataclasses.replace(specs["gain"], lower=-np.inf, upper=0.0)
        return specs

    def __post_init__(self):
        super().__post_init__()
        if self.max_step is None:
            object.__setattr__(self, "max_step", _RESOLUTION * min(self.shape, self.pinning))
        for name in ("shape", "pinning", "max_step"):
            self._require(name, getattr(self, name) > 0.0, "be positive")
        self._require("coupling", 0.0 <= self.coupling < 1.0, "be in [0, 1)")
        self._require("reversibility", 0.0 <= self.reversibility <= 1.0, "be in [0, 1]")


# starting values; shape and pinning over the coercive field
_SHAPES = (0.3, 1.0, 3.0)
_COUPLINGS = (0.2, 0.7)
_PINNINGS = (1.0, 2.5)
_REVERSIBILITY = 0.2
_COARSE = 0.15  # integration step over the smallest scale of the drive in the model
_STEPS = 30  # most integration steps per sample, on average
_ROUNDS = 3  # most refinements of the step


class JilesAtherton(ParametricModel):
    r"""Jiles-Atherton model: rate-independent magnetisation with saturation, for B(H) loops.

    .. math::

        B = J_s m + \mu H + c_0, \qquad
        \frac{dm}{dH} = \frac{\delta_M \frac{m_{an} - m}{k \delta - \alpha_s (m_{an} - m)}
        + c \frac{d m_{an}}{d H_e}}{1 - c \alpha_s \frac{d m_{an}}{d H_e}}, \qquad
        m_{an} = \coth \frac{H_e}{a} - \frac{a}{H_e}

    with :math:`m = M / M_s`, :math:`H_e = H + \alpha_s m`, :math:`\alpha_s = \alpha M_s`. The
    factor :math:`\delta_M` is zero where the magnetisation would move against the drive, which
    keeps the susceptibility from being negative. The response may be the flux density or anything
    proportional to it: :math:`J_s` and :math:`\mu`, which is not negative, are solved exactly.

    Parameters
    ----------
    gain : "fit" or float, default="fit"
        :math:`\mu` in response/drive: fitted, or given (``4e-7 * numpy.pi`` for a flux density in
        T and a field in A/m, 0 for a magnetisation).
    fit_intercept : bool, default=True
        Whether the response has a constant.

    Attributes
    ----------
    operator_ : JilesAthertonOperator
        ``saturation`` (:math:`J_s = \mu_0 M_s`) in units of the response, ``shape`` (a) and
        ``pinning`` (k) in units of the drive, ``coupling`` (:math:`\alpha M_s / (3 a)`, from 0 to
        below 1), ``reversibility`` (c, from 0 to 1), ``gain`` in response/drive.

    See Also
    --------
    Preisach : Any rate-independent loops with return-point memory.
    skhyst.static.SoftSaturation : Saturation alone.

    Notes
    -----
    Starting values come from the coercive field of the data. The equation is integrated in steps
    of the drive that are smaller than the smallest scale of the drive in the model. If the
    identified model needs smaller steps, the fit is repeated with them.

    References
    ----------
    Jiles and Atherton, *Journal of Magnetism and Magnetic Materials*, 1986. Jiles, Thoelke and
    Devine, *IEEE Transactions on Magnetics*, 1992.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import JilesAtherton, JilesAthertonOperator
    >>> field = 100.0 * np.sin(np.linspace(0.0, 12.0, 400))
    >>> flux, _ = JilesAthertonOperator(1.5, 10.0, 12.0, 0.6, 0.2, 1e-3).run(field, 1.0)
    >>> model = JilesAtherton().fit(field.reshape(-1, 1), flux)
    >>> print(f"{model.operator_.saturation:.3f} T")
    1.500 T
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "gain": [Interval(Real, None, None, closed="neither"), StrOptions({"fit"})],
        "fit_intercept": ["boolean"],
    }

    operator_class = JilesAthertonOperator

    def __init__(
        self,
        gain="fit",
        *,
        fit_intercept=True,
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        super().__init__(initial_state=initial_state, dt=dt, drive=drive, method=method)
        self.gain = gain
        self.fit_intercept = fit_intercept

    def starting_values(self, records):
        field = coercive_field(records)
        gain = 0.0 if self.gain == "fit" else float(self.gain)
        others = _REVERSIBILITY, gain, 0.0, max(_COARSE * field, _shortest_step(records))
        starts = [
            JilesAthertonOperator(1.0, shape * field, pinning * field, coupling, *others)
            for shape, pinning, coupling in product(_SHAPES, _PINNINGS, _COUPLINGS)
        ]
        directed = in_direction(starts[:1], records, self.held_parameters(), self.free_run_state)
        return [
            dataclasses.replace(start, falling=choice.falling)
            for choice in directed
            for start in starts
        ]

    def held_parameters(self) -> frozenset[str]:
        held = super().held_parameters()
        return held if self.gain == "fit" else held | {"gain"}

    def identify(self, data):
        result = super().identify(data)
        evaluations = result.n_evaluations
        for _ in range(_ROUNDS):
            operator = result.operator
            length = min(operator.shape, operator.pinning * (1.0 - operator.coupling))
            step = max(_COARSE * length, _shortest_step(data))
            if not step < 0.8 * operator.max_step:
                break
            starts = [dataclasses.replace(operator, max_step=step)]
            result = refine(self, starts, data, "variable_projection")
            evaluations += result.n_evaluations
        return dataclasses.replace(result, n_evaluations=evaluations)


def coercive_field(records):
    """Return half the mean width of the loops at half height, in units of the drive.

    A tenth of the largest drive if no loop crosses its half height in both directions.
    """
    largest, widths = largest_drive(records), []
    for record in records:
        above = record.y > 0.5 * (record.y.min() + record.y.max())
        crossed = np.flatnonzero(above[1:] != above[:-1]) + 1
        rising = record.u[crossed[above[crossed]]]
        falling = record.u[crossed[~above[crossed]]]
        if rising.size and falling.size:
            widths.append(abs(rising.mean() - falling.mean()))
    field = 0.5 * float(np.mean(widths)) if widths else 0.1 * largest
    return float(np.clip(field, 1e-3 * largest, largest))


def _shortest_step(records):
    """Return the smallest integration step allowed, in units of the drive (see ``_STEPS``)."""
    path = sum(float(np.abs(np.diff(record.u, prepend=0.0)).sum()) for record in records)
    return path / (_STEPS * sum(record.u.size for record in records)) or 1.0
