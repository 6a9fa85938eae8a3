"""Jiles-Atherton model of ferromagnetic hysteresis.

The Jiles-Atherton model of ferromagnetic hysteresis.
"""

import dataclasses
from dataclasses import dataclass
from numbers import Real

import numpy as np

from .._sklearn import Interval, StrOptions
from ..base import ParametricModel
from ..operators import Operator, as_signal, parameter
from ..optimize import identify
from ._jiles_atherton_loops import jiles_atherton_run, jiles_atherton_tangents

__all__ = [
    "JilesAtherton",
    "JilesAthertonOperator",
]

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


_SHAPES = (0.3, 1.0, 3.0)  # starts: shape over the coercive field,
_COUPLINGS = (0.2, 0.7)  # coupling,
_PINNINGS = (1.0, 2.5)  # pinning over the coercive field
_REVERSIBILITY = 0.2
_COARSE = 0.15  # step of integration over the smallest length of the model
_STEPS = 30  # at most, a sample on average
_ROUNDS = 3


class JilesAtherton(ParametricModel):
    r"""Jiles-Atherton model: magnetisation with saturation, for B(H) loops.

    .. math::

        B = J_s m + \mu H + c_0, \qquad
        \frac{dm}{dH} = \frac{\delta_M \frac{m_{an} - m}{k \delta - \alpha_s (m_{an} - m)}
        + c \frac{d m_{an}}{d H_e}}{1 - c \alpha_s \frac{d m_{an}}{d H_e}}, \qquad
        m_{an} = \coth \frac{H_e}{a} - \frac{a}{H_e}

    with :math:`m = M / M_s`, :math:`H_e = H + \alpha_s m`, :math:`\alpha_s = \alpha M_s`. The
    factor :math:`\delta_M` is zero where the magnetisation would move against the drive, which
    keeps the susceptibility from being negative. The response may be the flux density or anything
    in proportion to it: :math:`J_s` and :math:`\mu`, which is not negative, are solved exactly.

    Parameters
    ----------
    gain : "fit" or float, default="fit"
        :math:`\mu` in response/drive: fitted, or given (``4e-7 * numpy.pi`` for a flux density in
        T and a field in A/m, 0 for a magnetisation).
    fit_intercept : bool, default=True
        Whether the response has a constant.
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample: after a first magnetisation from the demagnetised
        state; demagnetised at zero, which is the same; or after a rest at a drive value that is
        fitted for each record.
    dt : float, default=1.0
        Sampling interval in s of data without a time index. The model does not depend on it.
    method : str or Method, default="variable_projection"
        How the parameters are identified, see :mod:`skhyst.optimize`.

    Attributes
    ----------
    operator_ : JilesAthertonOperator
        ``saturation`` (:math:`J_s = \mu_0 M_s`) in units of the response, ``shape`` (a) and
        ``pinning`` (k) in units of the drive, ``coupling`` (:math:`\alpha M_s / (3 a)`, from 0 to
        below 1), ``reversibility`` (c, from 0 to 1), ``gain`` in response/drive.
    params_, params_std_ : dict
        Parameters and their standard errors.

    Notes
    -----
    Starting values come from the coercive field of the data. The equation is integrated in steps
    of the drive, shorter than the smallest length of the model; they are made shorter, and the fit
    is repeated, where the identified model turns out to need it.

    References
    ----------
    D. C. Jiles, D. L. Atherton, "Theory of ferromagnetic hysteresis", J. Magn. Magn. Mater. 61
    (1986) 48-60. D. C. Jiles, J. B. Thoelke, M. K. Devine, "Numerical determination of hysteresis
    parameters for the modeling of magnetic properties using the theory of ferromagnetic
    hysteresis", IEEE Trans. Magn. 28 (1992) 27-35.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import JilesAtherton
    >>> from skhyst.hysteresis import JilesAthertonOperator
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

    series_rank = JilesAthertonOperator.rank

    def __init__(
        self,
        gain="fit",
        *,
        fit_intercept=True,
        initial_state="rest",
        dt=1.0,
        method="variable_projection",
    ):
        self.gain = gain
        self.fit_intercept = fit_intercept
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    def starting_values(self, records):
        field = coercive_field(records)
        gain = 0.0 if self.gain == "fit" else float(self.gain)
        starts = [
            JilesAthertonOperator(
                1.0, shape * field, pinning * field, coupling, _REVERSIBILITY, gain
            )
            for shape in _SHAPES
            for pinning in _PINNINGS
            for coupling in _COUPLINGS
        ]
        step = max(_COARSE * field, _shortest_step(records))
        return [(dataclasses.replace(start, max_step=step), ()) for start in starts]

    def held_parameters(self):
        fixed = set() if self.gain == "fit" else {"gain"}
        return frozenset(fixed if self.fit_intercept else fixed | {"intercept"})

    def _identify(self, data):
        result = super()._identify(data)
        evaluations = result.n_evaluations
        for _ in range(_ROUNDS):
            operator = result.operator
            length = min(operator.shape, operator.pinning * (1.0 - operator.coupling))
            step = max(_COARSE * length, _shortest_step(data))
            if not step < 0.8 * operator.max_step:
                break
            result = identify(
                [(dataclasses.replace(operator, max_step=step), ())],
                data,
                fixed=self.held_parameters(),
                initial_state=self._free_run_state(),
            )
            evaluations += result.n_evaluations
        return dataclasses.replace(result, n_evaluations=evaluations)


def coercive_field(records):
    """Return half the mean width of the loops at half height, in units of the drive.

    A tenth of the largest drive where no loop crosses its half height both ways.
    """
    largest = max(float(np.abs(record.u).max()) for record in records) or 1.0
    widths = []
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
    """Return the step of integration that takes the most steps allowed, in units of the drive."""
    path = sum(float(np.abs(np.diff(record.u, prepend=0.0)).sum()) for record in records)
    return path / (_STEPS * sum(record.u.size for record in records)) or 1.0
