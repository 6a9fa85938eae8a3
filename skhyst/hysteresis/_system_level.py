"""System-level model: the slope depends on the distance from the drive's last turning point.

With the distance ``s = |u - v|`` from the last turning point ``v`` and ``x = decay s``

    slope(s) = slope + curvature s E(x),    E(x) = (1 - exp(-x)) / x,

and its integral from the turning point is ``slope s + curvature s^2 H(x)`` where
``H(x) = (1 - E(x)) / x = sum_n (-x)^n / (n + 2)!``. Both have a limit for ``decay = 0``: the
Rayleigh law.
"""

import math
from dataclasses import dataclass

import numpy as np

from .._jit import jit
from .._sklearn import StrOptions
from ..base import ParametricModel
from ..operators import CompiledLaw, Operator, as_signal, parameter


@jit
def saturation_terms(x):
    """Return E(x), E'(x), H(x) and H'(x) for ``x >= 0``."""
    if x < 0.5:
        # the truncated series of H; the first term left out is x^13 / 15!
        h = 0.5
        dh = 0.0
        for n in range(14, 2, -1):
            ratio = 1.0 / n
            dh = -ratio * (h + x * dh)
            h = 0.5 - ratio * x * h
        return 1.0 - x * h, -(h + x * dh), h, dh
    e = -math.expm1(-x) / x
    de = (math.exp(-x) - e) / x
    h = (1.0 - e) / x
    return e, de, h, -(de + h) / x


@jit(inline=True)
def turn(step, turning, base, last, direction, slope, curvature, decay):
    """Return turning point, response there and direction of the branch of a step of the drive."""
    if step == 0.0:
        return turning, base, direction
    if step * direction < 0.0:  # the sample before was the turning point
        s = abs(last - turning)
        _, _, h, _ = saturation_terms(decay * s)
        base += direction * s * (slope + curvature * s * h)
        turning = last
    return turning, base, 1.0 if step > 0.0 else -1.0


@jit
def system_level_step(u, c, s):
    """Return the response at one sample.

    ``c`` is (slope, curvature, decay, intercept, rate_gain / dt, whether as printed), ``s`` is
    (last turning point, response there less the intercept, last drive, its direction).
    """
    slope, curvature, decay, intercept, rate, printed = c
    step = u - s[2]
    turning, base, direction = turn(step, s[0], s[1], s[2], s[3], slope, curvature, decay)
    s[0], s[1], s[2], s[3] = turning, base, u, direction
    distance = abs(u - turning)
    e, _, h, _ = saturation_terms(decay * distance)
    if printed > 0.0:
        return intercept + (slope + curvature * distance * e) * u + rate * step
    return intercept + (base + direction * distance * (slope + curvature * distance * h))


@jit
def system_level(u, du, values, dt, printed, turning, base, last, direction, dlast, y, dy):
    """Write the response to ``y`` and its tangents to ``dy``; return the state after.

    ``turning`` is the last turning point, ``base`` the response there less the intercept, ``last``
    the last drive, ``direction`` that in which it moved last (0 if it never has). Their tangents
    are zero, except ``dlast`` (m,) of ``last``, which is overwritten. The columns of ``dy``
    (n, m + p) after those of ``du`` (n, m) are the derivatives by slope, curvature, decay,
    intercept and, if ``printed``, rate_gain. An empty ``dy`` is not written.
    """
    slope, curvature, decay, intercept, rate_gain = values
    rate = rate_gain / dt
    m = du.shape[1]
    dturning = np.zeros(m)
    dbase = np.zeros(m + 3)
    for k in range(u.size):
        value = u[k]
        step = value - last
        if step * direction < 0.0 and k > 0 and dy.size:
            # a new branch starts at the last sample: so do the tangents of its start
            for q in range(m):
                dturning[q] = dlast[q]
            for q in range(m + 3):
                dbase[q] = dy[k - 1, q]
        turning, base, direction = turn(
            step, turning, base, last, direction, slope, curvature, decay
        )
        last = value
        s = abs(value - turning)
        e, de, h, dh = saturation_terms(decay * s)
        gain = slope + curvature * s * e
        if printed:
            y[k] = intercept + gain * value + rate * step
        else:
            y[k] = intercept + (base + direction * s * (slope + curvature * s * h))
        if dy.size == 0:
            continue
        dy[k, m + 3] = 1.0
        if printed:
            # s E(decay s) has the derivative exp(-decay s) by s
            bend = value * direction * curvature * (1.0 - decay * s * e)
            for q in range(m):
                dy[k, q] = gain * du[k, q] + rate * (du[k, q] - dlast[q])
                dy[k, q] += bend * (du[k, q] - dturning[q])
            dy[k, m] = value
            dy[k, m + 1] = value * s * e
            dy[k, m + 2] = value * curvature * s * s * de
            dy[k, m + 4] = step / dt
        else:
            for q in range(m):
                dy[k, q] = dbase[q] + gain * (du[k, q] - dturning[q])
            dy[k, m] = dbase[m] + direction * s
            dy[k, m + 1] = dbase[m + 1] + direction * s * s * h
            dy[k, m + 2] = dbase[m + 2] + direction * curvature * s * s * s * dh
        for q in range(m):
            dlast[q] = du[k, q]
    return turning, base, last, direction


@dataclass(frozen=True)
class SystemLevelOperator(Operator):
    """Hysteresis whose slope depends on the distance from the drive's last turning point.

    See :class:`SystemLevelHysteresis` for the law.

    Parameters
    ----------
    slope : float
        Slope ``p`` just after a turning point, response/drive.
    curvature : float
        Growth ``kappa`` of the slope with the distance, response/drive^2.
    decay : float
        Rate ``lambda`` at which the growth decays, 1/drive, not negative; zero is the Rayleigh law.
    intercept : float, default=0.0
        Constant ``c``, units of the response.
    rate_gain : float, default=0.0
        Weight ``h_s`` of the drive's rate, response s/drive; only with ``variant="printed"``.
    variant : {"integral", "printed"}, default="integral"
        As for :class:`SystemLevelHysteresis`.

    Raises
    ------
    ValueError
        If the variant is unknown, ``decay`` is negative, or the integral has a ``rate_gain``.

    Notes
    -----
    The state is the tuple (last turning point, response there less the intercept, last drive,
    direction in which it moved last). ``"rest"`` is the state after the first loading from zero to
    the first sample; in ``"zero"`` all four are zero. Both have their turning point at zero, so the
    integral is the same; only the rate of the first sample differs. The integral closes every minor
    loop but does not wipe it out: beyond the loop it continues from the last turning point, its
    only memory. The printed form jumps where the drive reverses.

    Examples
    --------
    >>> from skhyst.hysteresis import SystemLevelOperator
    >>> operator = SystemLevelOperator(slope=1.0, curvature=0.5, decay=0.0)
    >>> operator.run([0.0, 2.0, 1.0, 0.0], dt=1.0)[0]
    array([0.  , 3.  , 1.75, 0.  ])
    """

    slope: float = parameter(linear=True, unit="response/drive")
    curvature: float = parameter(linear=True, unit="response/drive^2")
    decay: float = parameter(lower=0.0, unit="1/drive")
    intercept: float = parameter(default=0.0, linear=True, gauge=0.0, unit="response")
    rate_gain: float = parameter(default=0.0, linear=True, unit="response s/drive")
    variant: str = "integral"

    owns_gain = True
    stage_order = 10

    def __post_init__(self):
        super().__post_init__()
        known = self.variant in ("integral", "printed")
        self._require("variant", known, "be 'integral' or 'printed'")
        self._require("decay", self.decay >= 0.0, "not be negative")
        is_right = self.variant == "printed" or self.rate_gain == 0.0
        wanted = "be 0 with variant='integral', which is rate-independent"
        self._require("rate_gain", is_right, wanted)

    @classmethod
    def from_paper(cls, delta_d, gamma, v_c, *, d_o=0.0, h_s=0.0, variant="integral"):
        """Return the operator for the parameters of Ahmed and Yan (2021).

        Parameters
        ----------
        delta_d, gamma, v_c : float
            ``Delta d`` (response/drive) with the factor ``T`` of (22), a constant; ``gamma``, no
            unit; ``V_c`` in units of the drive, positive.
        d_o : float, default=0.0
            In (16) a slope (response/drive), in (21) a constant (response).
        h_s : float, default=0.0
            Weight of the drive's rate in (22), response s/drive.
        variant : {"integral", "printed"}, default="integral"
            As for :class:`SystemLevelHysteresis`.

        Returns
        -------
        SystemLevelOperator
        """
        printed = variant == "printed"
        return cls(
            slope=delta_d * (1.0 - gamma) + (0.0 if printed else d_o),
            curvature=delta_d * gamma / v_c,
            decay=1.0 / v_c,
            intercept=d_o if printed else 0.0,
            rate_gain=h_s,
            variant=variant,
        )

    def parameter_specs(self):
        specs = super().parameter_specs()
        if self.variant == "integral":
            del specs["rate_gain"]
        return specs

    def init(self, u0, initial_state="rest"):
        last = float(u0) if initial_state == "rest" else 0.0
        return 0.0, 0.0, last, float(np.sign(last))

    def compiled_step(self, dt, state):
        parameters = self.slope, self.curvature, self.decay, self.intercept
        constants = *parameters, self.rate_gain / dt, self.variant == "printed"
        return CompiledLaw(system_level_step, constants, state)

    def _loop(self, u, du, dt, state, dlast, dy):
        """Return the response and the state after, and write the tangents to ``dy``."""
        values = self.slope, self.curvature, self.decay, self.intercept, self.rate_gain
        u, du, y = as_signal(u), as_signal(du), np.empty(len(u))
        printed = self.variant == "printed"
        state = system_level(
            u, du, tuple(map(float, values)), float(dt), printed, *state, dlast, y, dy
        )
        return y, state

    def run(self, u, dt, state=None):
        if state is None:
            state = self.init(u[0] if len(u) else 0.0)
        return self._loop(u, np.empty((0, 0)), dt, state, np.empty(0), np.empty((0, 0)))

    def sensitivities(self, u, du, dt, initial_state="rest"):
        n, m = du.shape
        state = self.init(u[0] if n else 0.0, initial_state)
        dlast = np.array(du[0]) if n and initial_state == "rest" else np.zeros(m)
        dy = np.empty((n, m + self.n_parameters))
        return self._loop(u, du, dt, state, dlast, dy)[0], dy


_DECAYS = (0.1, 1.0, 4.0, 15.0, 60.0)  # starting values: decay times the range of the drive


class SystemLevelHysteresis(ParametricModel):
    r"""System-level model of hysteresis: the slope depends on the last turning point.

    .. math:: d(s) = p + \kappa \frac{1 - e^{-\lambda s}}{\lambda}, \qquad s = |u - V_{shift}|

    where :math:`V_{shift}` is the drive at its last turning point. The response is
    :math:`y = c + \int d(s)\, du`, the true integral of (15) of Ahmed and Yan (2021), or as printed
    there in (21) and (22), :math:`y = c + d(s)\, u + h_s \dot u`, with the causal backward
    difference as rate.

    Parameters
    ----------
    variant : {"integral", "printed"}, default="integral"
        The integral is rate-independent and continuous. The printed form multiplies by the drive
        instead of integrating, so it jumps where the drive reverses.
    fit_intercept : bool, default=True
        Whether the response has a constant.
    dt : float or None, default=None
        Sampling interval in s of data without a time index. The integral does not depend on it.

    Attributes
    ----------
    operator_ : SystemLevelOperator
        ``slope`` p, ``curvature`` kappa, ``decay`` lambda and, as printed, ``rate_gain`` h_s.

    See Also
    --------
    skhyst.neural.GrayBoxHysteresis : With a model of the dynamics behind it.

    Notes
    -----
    In terms of Ahmed and Yan (2021), ``slope = d_o + Delta d (1 - gamma)``,
    ``curvature = Delta d gamma / V_c`` and ``decay = 1 / V_c``. If ``V_c`` is far larger than the
    largest distance, as there, the response depends on gamma and V_c only through their ratio, in
    the curvature; the standard error of ``decay`` shows how well V_c alone is determined. The
    response belongs to the same sample of the drive, without the delay of (22).

    The only memory is the last turning point, and every reversal of the drive, however small, is
    one: use the commanded drive, not a noisy measurement of it.

    References
    ----------
    Ahmed and Yan, *IEEE Access*, 2021, equations (15) to (22). Lallart et al., *Mechanical Systems
    and Signal Processing*, 2019.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import SystemLevelHysteresis, SystemLevelOperator
    >>> drive = 50.0 - 50.0 * np.cos(np.linspace(0.0, 20.0, 500))
    >>> y, _ = SystemLevelOperator(0.1, 0.002, 0.03).run(drive, 1.0)
    >>> model = SystemLevelHysteresis().fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.operator_.decay:.4f}")
    0.0300
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "variant": [StrOptions({"integral", "printed"})],
        "fit_intercept": ["boolean"],
    }

    largest_value = 1e30  # largest value of the data: products of several are squared
    operator_class = SystemLevelOperator

    def __init__(
        self,
        variant="integral",
        *,
        fit_intercept=True,
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        super().__init__(initial_state=initial_state, dt=dt, drive=drive, method=method)
        self.variant = variant
        self.fit_intercept = fit_intercept

    def starting_values(self, records):
        # a first loading from zero is a branch too
        span = max(np.ptp(np.append(record.u, 0.0)) for record in records) or 1.0
        return [
            SystemLevelOperator(0.0, 1.0, decay / span, variant=self.variant) for decay in _DECAYS
        ]
