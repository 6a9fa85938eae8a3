"""Tanks in series, with an outflow that is a power of the level, and an overflow.

Each tank has the balance ``tau w' = q - o(w)``.

The outflow is ``o(w) = w (w^2 + e^2)^((p - 1) / 2)``: the power ``w^p``, and proportional to the
level where that is below ``e``, so that its slope stays finite in an empty tank.

Over a substep h the inflow q is constant and o is replaced by its tangent, for which the balance is
solved exactly: with ``k = h / tau`` and ``z = -k o'(w)`` the level moves by

    D = k (q - o(w)) (exp(z) - 1) / z,

the exponential Rosenbrock-Euler method: of second order, stable for any h, exact for p = 1
(Hochbruck and Ostermann, *Acta Numerica*, 2010, section 2.4). The mean outflow follows from the
balance, ``q - D / k``, so volume is conserved between the tanks. A level that would exceed its
ceiling c ends there; for the fraction of the substep beyond it, ``q - o(c)`` overflows.
"""

import dataclasses
import math
from dataclasses import dataclass
from numbers import Integral

import numpy as np

from .._jit import jit
from .._sklearn import Interval, StrOptions
from ..base import ParametricModel
from ..operators import CompiledLaw, HeldInput, as_signal, parameter
from ..optimize import pole_starts

LAMINAR = 1e-2  # the level e below which the outflow is proportional to the level
_SMALL = 1e-4  # |z| below which quotients are evaluated by series
_GONE = -40.0  # z below which exp(z) is negligible relative to 1


@jit
def outflow(w, p):
    """Return o, ``do/dw``, ``do/dp``, and the derivatives of ``do/dw`` by w and by p."""
    s = w * w + LAMINAR * LAMINAR
    half, power = 0.5 * math.log(s), s ** (0.5 * (p - 3.0))
    o = w * s * power
    slope = power * (LAMINAR * LAMINAR + p * w * w)
    bend = (p - 1.0) * w * power / s * (3.0 * LAMINAR * LAMINAR + p * w * w)
    return o, slope, o * half, bend, slope * half + power * w * w


@jit
def _move(w, q, k, p):
    """Return D and its derivatives by w, q, k and p."""
    o, slope, o_p, bend, slope_p = outflow(w, p)
    z = -k * slope
    part = -math.expm1(z) / slope  # k (exp(z) - 1) / z
    if z > -_SMALL:
        part_k, part_slope = 1.0 + z, -0.5 * k * k
    else:
        part_k = math.exp(z) if z > _GONE else 0.0  # smaller values would underflow when squared
        part_slope = (k * part_k - part) / slope
    f = q - o
    return (
        f * part,
        f * part_slope * bend - slope * part,
        part,
        f * part_k,
        f * part_slope * slope_p - o_p * part,
    )


@jit(inline=True)
def tank_sample(before, u, levels, k, p, ceiling, share, offset, scale, n_substeps, held):
    """Update the levels, the first values of ``levels``, over a sampling interval.

    ``k``, ``p``, ``ceiling`` and ``share``, the fraction of its overflow that a tank passes on, are
    (n_tanks,); ``held`` selects a zero-order hold of the drive.
    """
    for s in range(n_substeps):
        part = 0.0 if held else (s + 0.5) / n_substeps
        q = max((before + part * (u - before) - offset) / scale, 0.0)
        for j in range(k.size):
            w = levels[j]
            move, _, _, _, _ = _move(w, q, k[j], p[j])
            over = 0.0
            if w + move > ceiling[j]:
                room = ceiling[j] - w
                most, _, _, _, _ = outflow(ceiling[j], p[j])
                over = max(q - most, 0.0) * (1.0 - room / move)
                move = room
                levels[j] = ceiling[j]
            else:
                move = max(move, -w)
                levels[j] = w + move
            q = max(q - over - move / k[j] + share[j] * over, 0.0)


@jit
def tank_run(u, before, levels, k, p, ceiling, share, offset, scale, n_substeps, held, out):
    """Write the level of the last tank to ``out`` (n,); ``levels`` (n_tanks,) are overwritten."""
    for i in range(u.size):
        tank_sample(before, u[i], levels, k, p, ceiling, share, offset, scale, n_substeps, held)
        before = u[i]
        out[i] = levels[-1]


@jit
def tank_step(u, c, s):
    """Return the response at one sample; ``s`` are the levels and the last drive.

    ``c`` is (k, p, ceiling, share, offset, scale, n_substeps, held) of :func:`tank_sample`, then
    (gain, intercept, highest level that the sensor reads).
    """
    k, p, ceiling, share, offset, scale, n_substeps, held, gain, intercept, most = c
    n = k.size
    tank_sample(s[n], u, s, k, p, ceiling, share, offset, scale, int(n_substeps), held > 0.0)
    s[n] = u
    return gain * min(s[n - 1], most) + intercept


@jit
def tank_begin(u, c, s):
    """Do :func:`tank_step` if no drive precedes the first sample.

    ``s`` ends with a mark that is zero before it.
    """
    _, _, _, _, _, _, _, _, gain, intercept, most = c
    n = c[0].size
    if s[n + 1] > 0.0:
        return tank_step(u, c, s)
    s[n], s[n + 1] = u, 1.0
    return gain * min(s[n - 1], most) + intercept


@jit
def tank_tangents(
    u, du, before, dbefore, levels, d, k, tau, p, ceiling, share, offset, scale, n_substeps, held,
    out, dout,
):  # fmt: skip
    """Write the results of :func:`tank_run`, and their tangents to ``dout`` (n, n_columns).

    The m columns of ``du`` are followed by the derivatives by the time constants, the exponents,
    the ceilings and all shares but the last (if there are ceilings), and the offset. ``dbefore``
    (m,) and ``d`` (n_tanks, n_columns), which is overwritten, are the tangents of ``before`` and
    ``levels``.
    """
    m, n, n_columns = du.shape[1], levels.size, d.shape[1]
    limited = n_columns > m + 2 * n + 1
    dq, dmove, dover = np.empty(n_columns), np.empty(n_columns), np.empty(n_columns)
    last = dbefore.copy()
    for i in range(u.size):
        for s in range(n_substeps):
            part = 0.0 if held else (s + 0.5) / n_substeps
            q = (before + part * (u[i] - before) - offset) / scale
            dq[:] = 0.0
            # each branch below is one of `tank_sample`, with its derivatives
            if q > 0.0:
                for c in range(m):
                    dq[c] = (last[c] + part * (du[i, c] - last[c])) / scale
                dq[-1] = -1.0 / scale
            else:
                q = 0.0
            for j in range(n):
                w = levels[j]
                at_tank = m + j
                move, by_w, by_q, by_k, by_p = _move(w, q, k[j], p[j])
                for c in range(n_columns):
                    dmove[c] = by_w * d[j, c] + by_q * dq[c]
                    dover[c] = 0.0
                dmove[at_tank] -= by_k * k[j] / tau[j]
                dmove[at_tank + n] += by_p
                over = 0.0
                if w + move > ceiling[j]:
                    room = ceiling[j] - w
                    o, slope, o_p, _, _ = outflow(ceiling[j], p[j])
                    full, excess = 1.0 - room / move, q - o
                    if excess > 0.0:
                        # it flows over for the fraction `full` of the substep, which depends on the
                        # level, the move and the ceiling
                        over = excess * full
                        for c in range(n_columns):
                            dover[c] = full * dq[c] + excess * (
                                d[j, c] / move + room / move * (dmove[c] / move)
                            )
                        dover[at_tank + n] -= full * o_p
                        if limited:
                            dover[at_tank + 2 * n] -= full * slope + excess / move
                    # the level ends at the ceiling, whatever it was: all other tangents are lost
                    for c in range(n_columns):
                        dmove[c] = -d[j, c]
                        d[j, c] = 0.0
                    if limited:
                        dmove[at_tank + 2 * n] += 1.0
                        d[j, at_tank + 2 * n] = 1.0
                    move = room
                    levels[j] = ceiling[j]
                elif w + move < 0.0:
                    for c in range(n_columns):
                        dmove[c] = -d[j, c]
                        d[j, c] = 0.0
                    move = -w
                    levels[j] = 0.0
                else:
                    for c in range(n_columns):
                        d[j, c] += dmove[c]
                    levels[j] = w + move
                # the outflow, by the balance of volume, and the inflow of the next tank
                q = q - over - move / k[j] + share[j] * over
                if q < 0.0:
                    q = 0.0
                    dq[:] = 0.0
                else:
                    for c in range(n_columns):
                        dq[c] += (share[j] - 1.0) * dover[c] - dmove[c] / k[j]
                    dq[at_tank] -= move / (k[j] * tau[j])
                    if limited and j < n - 1:
                        dq[at_tank + 3 * n] += over
        before = u[i]
        for c in range(m):
            last[c] = du[i, c]
        out[i] = levels[-1]
        for c in range(n_columns):
            dout[i, c] = d[-1, c]


_ITERATIONS = 60
_CONVERGED = 1e-15
_EXPONENT = 0.5  # of Torricelli's law
# starting values
_OFFSETS = (0.02, 0.5)  # distance of the offset below the least drive, over the drive's range
_FULL = (0.7, 0.95)  # quantiles of a level, in tanks before the last, that become its ceiling
_SHARE = 0.5
_POLE_SETS = 2
_SPREADS = (1.0, 3.0)  # ratios of neighbouring time constants, if the data give none


@dataclass(frozen=True, eq=False)
class TankChainOperator(HeldInput):
    r"""Tanks in series, see :class:`TankChain`; the response is ``gain w_n + intercept``.

    Parameters
    ----------
    time_constants, exponents : array-like of shape (n_tanks,)
        :math:`\tau` in s, and p, no unit: 1/2 by Torricelli, 1 for a linear stage.
    ceilings : array-like of shape (n_tanks,), optional
        Finite levels c; None: no limits, and none are identified.
    shares : array-like of shape (n_tanks - 1,), optional
        :math:`\kappa`: fraction of its overflow that a tank passes on, 0 to 1.
    drive_offset : float, default=0.0
        :math:`u_0`: drive below which there is no flow, units of the drive.
    gain, intercept : float, default=1.0, 0.0
        Change of the response from level 0 to 1 of the last tank, and response if it is empty,
        units of the response.
    scale : float, default=1.0
        Scale s, units of the drive. Fixed structure.
    limit : {"level", "reading"}, default="level"
        Whether the ceiling of the last tank limits its level, or only the reading.
    hold : {"foh", "zoh", "bandlimited"}, default="foh"
        Drive between samples: a straight line, constant, or without content above half the sampling
        rate. Fixed structure.
    n_substeps : int, default=4
        Integration steps per sampling interval. Fixed structure.

    Raises
    ------
    ValueError
        If sizes differ, or ``n_substeps`` or ``scale`` is not above 0.

    Notes
    -----
    Below the level 0.01 the outflow is proportional to the level, as laminar flow is; otherwise its
    slope would be infinite in an empty tank. The state is the tuple of the levels and the last
    drive.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.fluid import TankChainOperator
    >>> tank = TankChainOperator([10.0], [0.5])
    >>> y, _ = tank.run(np.array([1.0, 1.0, 1.5]), 60.0)
    >>> print(y[:2].round(3))  # at rest
    [1. 1.]
    """

    time_constants: np.ndarray = parameter(log=True, lower=0.0, unit="s")
    exponents: np.ndarray = parameter(log=True, lower=0.2, upper=5.0)
    ceilings: np.ndarray | None = parameter(default=None, log=True, lower=0.0)
    shares: np.ndarray | None = parameter(default=None, lower=0.0, upper=1.0)
    drive_offset: float = parameter(default=0.0, unit="drive")
    gain: float = parameter(default=1.0, linear=True, unit="response")
    intercept: float = parameter(default=0.0, linear=True, gauge=0.0, unit="response")
    scale: float = 1.0
    limit: str = "level"
    hold: str = "foh"
    n_substeps: int = 4

    owns_gain = True
    at_once = False

    def __post_init__(self):
        super().__post_init__()
        self._require("n_substeps", self.n_substeps > 0, "be above 0")
        self._require("scale", self.scale > 0.0, "be above 0")
        for name in ("time_constants", "exponents", "ceilings", "shares"):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, np.array(value, dtype=float, ndmin=1))
        sizes = {"exponents": self.n_tanks}
        if self.is_limited:
            sizes |= {"ceilings": self.n_tanks, "shares": self.n_tanks - 1}
        for name, size in sizes.items():
            wanted = f"have {size} value(s) for {self.n_tanks} time constant(s)"
            self._require(name, np.size(getattr(self, name)) == size, wanted)

    @property
    def n_tanks(self):
        """Number of tanks."""
        return np.size(self.time_constants)

    @property
    def is_limited(self):
        """Whether there are ceilings."""
        return self.ceilings is not None

    def with_scale(self, scale):
        """Return the operator with its levels and flows in another unit.

        The response is the same but at levels where the outflow is laminar, 0.01 in either unit.

        Parameters
        ----------
        scale : float
            Drive, above the offset, at which each level is 1.

        Returns
        -------
        TankChainOperator
            The operator itself where that is its scale.
        """
        if scale == self.scale:
            return self
        flows = self.scale / scale
        levels = flows ** (1.0 / self.exponents)  # of q = w^p
        ceilings = self.ceilings * levels if self.is_limited else None
        changes = {"time_constants": self.time_constants * flows / levels, "ceilings": ceilings}
        return dataclasses.replace(self, scale=scale, gain=self.gain / levels[-1], **changes)

    def characteristics(self, seen):
        """Return time constants and exponents, and the response at the ceiling of the last tank.

        The time constants are those of small changes about the middle of the drive.
        """
        ceiling = self.gain * self.ceilings[-1] + self.intercept if self.is_limited else np.nan
        levels, _ = self._rest(0.5 * sum(seen.ends))
        slopes = np.array([outflow(w, p)[1] for w, p in zip(levels, self.exponents, strict=True)])
        return {
            "time constants at the middle of the drive": (self.time_constants / slopes, "s"),
            "power of the level": (self.exponents, ""),
            "response at the ceiling": (ceiling, "response"),
        }

    def parameter_specs(self):
        specs = super().parameter_specs()
        if not self.is_limited:
            specs = {k: v for k, v in specs.items() if k not in ("ceilings", "shares")}
        return specs

    def _limits(self):
        """Return the ceilings of the levels and the shares, (n_tanks,) each."""
        if not self.is_limited:
            return np.full(self.n_tanks, np.inf), np.zeros(self.n_tanks)
        ceilings = self.ceilings.copy()
        if self.limit == "reading":
            ceilings[-1] = np.inf
        return ceilings, np.append(self.shares, 0.0)

    def _structure(self, dt):
        k = float(dt) / self.n_substeps / self.time_constants
        return k, float(self.drive_offset), float(self.scale), self.n_substeps, self.hold == "zoh"

    def _most(self):
        """Return the highest level that the sensor reads, infinite without a limit."""
        return self.ceilings[-1] if self.is_limited and self.limit == "reading" else np.inf

    def _rest(self, u0):
        """Return the levels at rest; their derivatives by u0 and all but the last 2 parameters."""
        n = self.n_tanks
        ceilings, shares = self._limits()
        levels = np.empty(n)
        dlevels = np.zeros((n, self.n_parameters - 1))
        q, dq = (u0 - self.drive_offset) / self.scale, np.zeros(dlevels.shape[1])
        dq[0], dq[-1] = 1.0 / self.scale, -1.0 / self.scale
        if not q > 0.0:
            q, dq = 0.0, 0.0 * dq
        for i, (p, ceiling, share) in enumerate(zip(self.exponents, ceilings, shares, strict=True)):
            most, slope, most_p, _, _ = outflow(ceiling, p) if ceiling < np.inf else (np.inf,) * 5
            if q > most:
                levels[i], dlevels[i, 1 + 2 * n + i] = ceiling, 1.0
                dmost = np.zeros_like(dq)
                dmost[1 + n + i], dmost[1 + 2 * n + i] = most_p, slope
                dq = share * dq + (1.0 - share) * dmost
                if i < n - 1:
                    dq[1 + 3 * n + i] += q - most
                q = share * q + (1.0 - share) * most
            else:
                levels[i] = _level(q, p)
                _, slope, by_p, _, _ = outflow(levels[i], p)
                dlevels[i] = dq / slope
                dlevels[i, 1 + n + i] -= by_p / slope
        return levels, dlevels

    def init(self, u0, initial_state="rest"):
        if initial_state == "zero":  # a ramp from zero would lead to the first sample
            return (*(0.0,) * self.n_tanks, 0.0 if self.hold == "zoh" else None)
        return (*self._rest(float(u0))[0].tolist(), float(u0))

    def run(self, u, dt, state=None):
        u = as_signal(u)
        if state is None:
            state = self.init(u[0] if u.size else 0.0)
        *levels, before = state
        levels, first = np.array(levels, dtype=float), int(before is None and u.size > 0)
        k, *rest = self._structure(dt)
        w = np.full(u.size, levels[-1])
        before = float(u[0]) if first else before
        tank_run(u[first:], before, levels, k, self.exponents, *self._limits(), *rest, w[first:])
        y = self.gain * np.minimum(w, self._most()) + self.intercept
        return y, (*levels.tolist(), float(u[-1]) if u.size else before)

    def compiled_step(self, dt, state):
        k, *rest = self._structure(dt)
        constants = k, self.exponents, *self._limits(), *rest, self.gain, self.intercept
        constants = *constants, self._most()
        if self.hold == "foh":
            *levels, before = state
            begun = before is not None
            state = (*levels, before if begun else 0.0, float(begun))
            return CompiledLaw(tank_begin, constants, state)
        return CompiledLaw(tank_step, constants, state)

    def sensitivities(self, u, du, dt, initial_state="rest"):
        u, du = as_signal(u), as_signal(du)
        m, n_own = du.shape[1], self.n_parameters - 2
        levels, d = np.zeros(self.n_tanks), np.zeros((self.n_tanks, m + n_own))
        before, dbefore, first = 0.0, np.zeros(m), 0
        if initial_state == "zero" and self.hold == "foh" and u.size:
            before, dbefore, first = float(u[0]), du[0], 1
        elif initial_state == "rest" and u.size:
            before, dbefore = float(u[0]), du[0]
            levels, by = self._rest(before)
            d[:, :m] = np.outer(by[:, 0], dbefore)
            d[:, m:] = by[:, 1:]
        k, *rest = self._structure(dt)
        w, dw = np.zeros(u.size), np.zeros((u.size, d.shape[1]))
        laws, rows = (k, self.time_constants, self.exponents), slice(first, None)
        begin = u[rows], du[rows], before, as_signal(dbefore), levels, d
        tank_tangents(*begin, *laws, *self._limits(), *rest, w[rows], dw[rows])
        reading, over = np.minimum(w, self._most()), w > self._most()
        if over.any():
            dw[over] = 0.0
            dw[over, m + 3 * self.n_tanks - 1] = 1.0
        dy = np.empty((u.size, m + n_own + 2))
        dy[:, :-2] = self.gain * dw
        dy[:, -2] = reading
        dy[:, -1] = 1.0
        return self.gain * reading + self.intercept, dy


def _level(q, p):
    """Return the level whose outflow is q, by Newton's method in the logarithm of the level."""
    if q <= 0.0:
        return 0.0
    goal, x = np.log(q), np.log(q) / p
    for _ in range(_ITERATIONS):
        # the logarithm of the outflow is convex or concave in x, so Newton's method cannot cycle
        total = np.logaddexp(2.0 * x, 2.0 * np.log(LAMINAR))
        slope = 1.0 + (p - 1.0) * np.exp(2.0 * x - total)
        step = (goal - x - 0.5 * (p - 1.0) * total) / slope
        x += step
        if abs(step) <= _CONVERGED * max(abs(x), 1.0):
            break
    return float(np.exp(x))


class TankChain(ParametricModel):
    r"""Tanks in series, with an outflow that is a power of the level, and overflow.

    .. math::

        \tau_i \dot w_i = q_i - w_i^{p_i}, \quad 0 \le w_i \le c_i, \qquad
        q_1 = \max\left(\frac{u - u_0}{s}, 0\right), \quad q_{i+1} = w_i^{p_i} + \kappa_i o_i,
        \qquad y = G w_n + b

    Levels and flows are relative to the scale s of the drive, so no unit of volume is needed. It is
    not fitted, since another one only changes the unit of the time constants: it is the mean drive
    of the fit above its least value, or above zero where the offset is zero. At an inflow of s each
    level is 1, and a small change decays with the time constant :math:`\tau / p`;
    :math:`o_i` is the overflow. With p = 1/2 the outflow is Torricelli's; p = 1 is a chain of
    first-order lags. Around a level w the time constant is :math:`\tau w^{1-p} / p`, so for p < 1
    the chain is slower, and its gain larger, at high levels.

    Parameters
    ----------
    n_tanks : int, default=2
        Number of tanks.
    overflow : bool, default=False
        Whether the levels have ceilings, and all tanks but the last pass on a fraction of their
        overflow.
    limit : {"level", "reading"}, default="level"
        Whether the ceiling of the last tank limits its level, or only the reading.
    fit_exponents : bool, default=False
        Whether the exponents are fitted, one per tank; otherwise they are 1/2.
    fit_offset : bool, default=True
        Whether the drive below which there is no flow is fitted; otherwise it is 0.
    fit_intercept : bool, default=True
        Whether the reading of an empty tank is fitted; otherwise it is 0.
    hold : {"foh", "zoh", "bandlimited"}, default="foh"
        Drive between samples: a straight line, constant, or without content above half the sampling
        rate; a model of such a drive looks ahead, and is neither stepped nor inverted.
    n_substeps : int, default=4
        Integration steps per sampling interval.
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample. Use ``"estimate"`` for recordings that do not begin
        at rest: the drive at which the chain rested before is then fitted per record.

    Attributes
    ----------
    operator_ : TankChainOperator
        ``time_constants``, ``exponents``, ``ceilings``, ``shares``, ``drive_offset``, ``gain``,
        ``intercept`` and ``scale``.

    See Also
    --------
    skhyst.linear.FirstOrderLag : The tank with a linear outflow.

    References
    ----------
    Schoukens and Noël, *IFAC-PapersOnLine*, 2017: the cascaded tanks.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.fluid import TankChain, TankChainOperator
    >>> drive = 1.5 + np.sin(0.05 * np.arange(600)) + 0.4 * np.sin(0.21 * np.arange(600))
    >>> y, _ = TankChainOperator([8.0, 15.0], [0.5, 0.5], gain=3.0).run(drive, 1.0)
    >>> model = TankChain(fit_offset=False, fit_intercept=False).fit(drive.reshape(-1, 1), y)
    >>> bool(np.allclose(model.predict(drive.reshape(-1, 1)), y, atol=1e-3))
    True
    """

    operator_class = TankChainOperator
    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "n_tanks": [Interval(Integral, 1, None, closed="left")],
        "overflow": ["boolean"],
        "limit": [StrOptions({"level", "reading"})],
        "fit_exponents": ["boolean"],
        "fit_offset": ["boolean"],
        "fit_intercept": ["boolean"],
        "hold": [StrOptions(set(HeldInput.holds))],
        "n_substeps": [Interval(Integral, 1, None, closed="left")],
    }

    def __init__(
        self,
        n_tanks=2,
        *,
        overflow=False,
        limit="level",
        fit_exponents=False,
        fit_offset=True,
        fit_intercept=True,
        hold="foh",
        n_substeps=4,
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        super().__init__(initial_state=initial_state, dt=dt, drive=drive, method=method)
        self.n_tanks = n_tanks
        self.overflow = overflow
        self.limit = limit
        self.fit_exponents = fit_exponents
        self.fit_offset = fit_offset
        self.fit_intercept = fit_intercept
        self.hold = hold
        self.n_substeps = n_substeps

    def held_parameters(self) -> frozenset[str]:
        free = dict.fromkeys([f"exponents[{i}]" for i in range(self.n_tanks)], self.fit_exponents)
        free |= {"drive_offset": self.fit_offset, "intercept": self.fit_intercept}
        return frozenset(name for name, is_free in free.items() if not is_free)

    def starting_values(self, records):
        sets = [np.abs(p) for p in pole_starts([(r.u, r.y, r.dt) for r in records], self.n_tanks)]
        sets = sets[-_POLE_SETS:]
        if not sets:
            longest = max(len(r.u) * r.dt for r in records)
            slow = 10.0 / longest * np.ones(self.n_tanks)
            sets = [slow * spread ** np.arange(self.n_tanks) for spread in _SPREADS]
        return [start for rates in sets for start in self.starts_of(rates, records)]

    def starts_of(self, rates, records):
        """Return starting operators with given small-signal rates, in any order of the tanks.

        Parameters
        ----------
        rates : sequence of float
            In 1/s, one per tank.
        records : sequence of RecordData
            Records of the fit.

        Returns
        -------
        list of TankChainOperator
            Of one structure.
        """
        low = min(float(r.u.min()) for r in records)
        span = max(float(r.u.max()) for r in records) - low
        middle = float(np.mean(np.concatenate([r.u for r in records])))
        offsets = [low - part * span for part in _OFFSETS] if self.fit_offset else [0.0]
        slowest = np.sort(_EXPONENT / np.asarray(rates, dtype=float))
        starts = []
        for offset in offsets:
            for constants in [slowest[::-1], slowest][: self.n_tanks]:
                # the level at the mean drive is 1, and around it the rates are those given
                chain = TankChainOperator(
                    constants,
                    np.full(self.n_tanks, _EXPONENT),
                    drive_offset=offset,
                    scale=abs(middle - offset) or span or 1.0,
                    limit=self.limit,
                    hold=self.hold,
                    n_substeps=self.n_substeps,
                )
                starts += self._limited(chain, records) if self.overflow else [chain]
        return starts

    def in_order(self, operator, records):
        low = min(float(r.u.min()) for r in records) if self.fit_offset else 0.0
        mean = float(np.mean(np.concatenate([r.u for r in records])))
        return operator.with_scale(abs(mean - low) or operator.scale)

    def _limited(self, chain, records):
        """Return chains with ceilings: the largest reading, and quantiles of the other levels."""
        levels = []
        for n in range(1, self.n_tanks + 1):
            part = dataclasses.replace(
                chain, time_constants=chain.time_constants[:n], exponents=chain.exponents[:n]
            )
            state = self.free_run_state
            runs = [part.run(r.u, r.dt, part.init(r.u[0], state))[0] for r in records]
            levels.append(np.concatenate(runs))
        y = np.concatenate([r.y for r in records])
        slope, constant = np.polyfit(levels[-1], y, 1) if np.ptp(levels[-1]) > 0.0 else (1.0, 0.0)
        extreme = y.max() if slope > 0.0 else y.min()
        top = (extreme - constant) / slope if slope else 1.0
        top = float(np.clip(top, np.quantile(levels[-1], 0.5), levels[-1].max())) or 1.0
        chains = []
        for part in _FULL if self.n_tanks > 1 else _FULL[:1]:
            before = [float(np.quantile(w, part)) or 1.0 for w in levels[:-1]]
            shares = np.full(self.n_tanks - 1, _SHARE)
            ceilings = np.array([*before, top])
            chains.append(dataclasses.replace(chain, ceilings=ceilings, shares=shares))
        return chains
