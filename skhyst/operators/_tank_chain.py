"""Tanks in a row, with an outflow by a power of the level and an overflow."""

from dataclasses import dataclass

import numpy as np

from .._kernels._arrays import as_signal
from .._kernels._tank_chain import LAMINAR, outflow, tank_run, tank_tangents
from ._base import Operator, parameter

__all__ = ["TankChainOperator"]

_ITERATIONS = 60
_CONVERGED = 1e-15


@dataclass(frozen=True, eq=False)
class TankChainOperator(Operator):
    r"""Tanks in a row: each takes what leaves the one before; ``y = gain w_n + intercept``.

    .. math::

        \tau_i \dot w_i = q_i - w_i^{p_i}, \quad 0 \le w_i \le c_i, \qquad
        q_1 = \max\left(\frac{u - u_0}{s}, 0\right), \quad q_{i+1} = w_i^{p_i} + \kappa_i o_i

    with the overflow o of a tank that is full. Levels w and flows q are relative to those at rest
    for a drive s above the offset.

    Parameters
    ----------
    time_constants : array-like of shape (n_tanks,)
        :math:`\tau` in s.
    exponents : array-like of shape (n_tanks,)
        p; 1/2 by Torricelli, 1 for a linear stage.
    ceilings : array-like of shape (n_tanks,), optional
        c, all finite; None without limits, which are not identified then.
    shares : array-like of shape (n_tanks - 1,), optional
        :math:`\kappa`: the part of its overflow that a tank passes on, 0 to 1.
    drive_offset : float, default=0.0
        :math:`u_0`: drive up to which nothing flows, units of the drive.
    gain : float, default=1.0
        Response at the level 1 of the last tank.
    intercept : float, default=0.0
        Response of an empty last tank.
    scale : float, default=1.0
        s, units of the drive. Fixed structure.
    limit : {"level", "reading"}, default="level"
        Whether the ceiling of the last tank limits its level, or the reading alone.
    hold : {"foh", "zoh"}, default="foh"
        Drive between samples: a straight line, or constant.
    n_substeps : int, default=4
        Integration steps in a sampling interval. Fixed structure.

    Raises
    ------
    ValueError
        If sizes differ, or ``n_substeps`` or ``scale`` is not above 0.

    Notes
    -----
    Below a hundredth of the level at rest the outflow is proportional to the level, as laminar flow
    is: its slope would be infinite in an empty tank. The state is the tuple of the levels and the
    last drive.

    References
    ----------
    M. Schoukens, J. P. Noel, "Three benchmarks addressing open challenges in nonlinear system
    identification", IFAC-PapersOnLine 50(1) (2017) 446-451: the cascaded tanks.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.operators import TankChainOperator
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

    carries_scale = True

    def __post_init__(self):
        n = self.n_substeps
        if isinstance(n, bool) or not isinstance(n, (int, np.integer)) or n < 1:
            raise ValueError(
                "The 'n_substeps' parameter of TankChainOperator must be an integer above 0. "
                f"Got {n!r} instead."
            )
        if not self.scale > 0.0:
            raise ValueError(
                "The 'scale' parameter of TankChainOperator must be above 0. "
                f"Got {self.scale!r} instead."
            )
        for name in ("time_constants", "exponents", "ceilings", "shares"):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, np.array(value, dtype=float, ndmin=1))
        sizes = {"exponents": self.n_tanks}
        if self.is_limited:
            sizes |= {"ceilings": self.n_tanks, "shares": self.n_tanks - 1}
        for name, size in sizes.items():
            if np.size(getattr(self, name)) != size:
                raise ValueError(
                    f"The '{name}' parameter of TankChainOperator must have {size} value(s) for "
                    f"{self.n_tanks} time constant(s). Got {getattr(self, name)!r} instead."
                )

    @property
    def n_tanks(self):
        """Number of tanks."""
        return np.size(self.time_constants)

    @property
    def is_limited(self):
        """Whether there are ceilings."""
        return self.ceilings is not None

    def parameter_specs(self):
        specs = super().parameter_specs()
        if not self.is_limited:
            specs = {k: v for k, v in specs.items() if k not in ("ceilings", "shares")}
        return specs

    # ------------------------------------------------------------------ what the loops take

    def _limits(self):
        """Return the ceilings of the levels and the shares, (n_tanks,) each."""
        if not self.is_limited:
            return np.full(self.n_tanks, np.inf), np.zeros(self.n_tanks)
        ceilings = self.ceilings.copy()
        if self.limit == "reading":
            ceilings[-1] = np.inf
        return ceilings, np.append(self.shares, 0.0)

    def _order(self):
        """Return the place in :meth:`pack` of each column of the loops' own derivatives."""
        n = self.n_tanks
        ends = [*range(2 * n)], [*range(2 * n, 4 * n - 1)] if self.is_limited else []
        offset = [2 * n + len(ends[1])]
        return np.array(ends[0] + offset + ends[1])

    def _structure(self, dt):
        k = float(dt) / self.n_substeps / self.time_constants
        return k, float(self.drive_offset), float(self.scale), self.n_substeps, self.hold == "zoh"

    def _reading(self, level):
        """Return what the sensor reads, in units of the level."""
        if self.is_limited and self.limit == "reading":
            return np.minimum(level, self.ceilings[-1])
        return level

    def _rest(self, u0):
        """Return the levels at rest and their derivatives (n_tanks, 1 + n_own).

        The derivatives are those by ``u0`` and by the parameters, in the order of the loops.
        """
        n = self.n_tanks
        ceilings, shares = self._limits()
        levels = np.empty(n)
        dlevels = np.zeros((n, 1 + len(self._order())))
        q, dq = (u0 - self.drive_offset) / self.scale, np.zeros(dlevels.shape[1])
        dq[0], dq[1 + 2 * n] = 1.0 / self.scale, -1.0 / self.scale
        if not q > 0.0:
            q, dq = 0.0, 0.0 * dq
        for i, (p, ceiling, share) in enumerate(zip(self.exponents, ceilings, shares, strict=True)):
            most, slope, most_p, _, _ = outflow(ceiling, p) if ceiling < np.inf else (np.inf,) * 5
            if q > most:
                levels[i], dlevels[i, 2 + 2 * n + i] = ceiling, 1.0
                dmost = np.zeros_like(dq)
                dmost[1 + n + i], dmost[2 + 2 * n + i] = most_p, slope
                dq = share * dq + (1.0 - share) * dmost
                if i < n - 1:
                    dq[2 + 3 * n + i] += q - most
                q = share * q + (1.0 - share) * most
            else:
                levels[i] = _level(q, p)
                _, slope, by_p, _, _ = outflow(levels[i], p)
                dlevels[i] = dq / slope
                dlevels[i, 1 + n + i] -= by_p / slope
        return levels, dlevels

    # ------------------------------------------------------------------ as an operator

    def init(self, u0, initial_state="rest"):
        if initial_state == "zero":
            return (0.0,) * (self.n_tanks + 1)
        return (*self._rest(float(u0))[0].tolist(), float(u0))

    def run(self, u, dt, state=None):
        u = as_signal(u)
        if state is None:
            state = self.init(u[0] if u.size else 0.0)
        levels, before = np.array(state[:-1], dtype=float), float(state[-1])
        k, *rest = self._structure(dt)
        w = np.empty(u.size)
        tank_run(u, before, levels, k, self.exponents, *self._limits(), *rest, w)
        y = self.gain * self._reading(w) + self.intercept
        return y, (*levels.tolist(), float(u[-1]) if u.size else before)

    def linearize(self, u, du, dt, initial_state="rest"):
        u, du = as_signal(u), as_signal(du)
        m, order = du.shape[1], self._order()
        levels, d = np.zeros(self.n_tanks), np.zeros((self.n_tanks, m + len(order)))
        before, dbefore = 0.0, np.zeros(m)
        if initial_state == "rest" and u.size:
            before, dbefore = float(u[0]), du[0]
            levels, by = self._rest(before)
            d[:, :m] = np.outer(by[:, 0], dbefore)
            d[:, m:] = by[:, 1:]
        k, *rest = self._structure(dt)
        w, dw = np.empty(u.size), np.empty((u.size, d.shape[1]))
        given = k, self.time_constants, self.exponents
        tank_tangents(
            u, du, before, as_signal(dbefore), levels, d, *given, *self._limits(), *rest, w, dw
        )
        reading = self._reading(w)
        if self.is_limited and self.limit == "reading":
            over = w > self.ceilings[-1]
            dw[over] = 0.0
            dw[over, m + 3 * self.n_tanks] = 1.0
        dy = np.empty((u.size, m + len(order) + 2))
        dy[:, :m] = self.gain * dw[:, :m]
        dy[:, m + order] = self.gain * dw[:, m:]
        dy[:, -2] = reading
        dy[:, -1] = 1.0
        return self.gain * reading + self.intercept, dy


def _level(q, p):
    """Return the level whose outflow is q, by Newton's method for its logarithm."""
    if q <= 0.0:
        return 0.0
    goal, x = np.log(q), np.log(q) / p
    for _ in range(_ITERATIONS):
        # the logarithm of the outflow is convex or concave in x, so that Newton cannot cycle
        total = np.logaddexp(2.0 * x, 2.0 * np.log(LAMINAR))
        slope = 1.0 + (p - 1.0) * np.exp(2.0 * x - total)
        step = (goal - x - 0.5 * (p - 1.0) * total) / slope
        x += step
        if abs(step) <= _CONVERGED * max(abs(x), 1.0):
            break
    return float(np.exp(x))
