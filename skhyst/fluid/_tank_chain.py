"""Tanks in a row."""

import dataclasses
from numbers import Integral

import numpy as np

from .._sklearn import Interval, StrOptions
from ..base import ParametricModel
from ..operators import TankChainOperator
from ..optimize import pole_starts

__all__ = ["TankChain"]

_EXPONENT = 0.5  # Torricelli
_OFFSETS = (0.02, 0.5)  # below the least drive, of its range
_FULL = (0.7, 0.95)  # of the time, below the ceiling of a tank before the last
_SHARE = 0.5
_POLE_SETS = 2
_SPREADS = (1.0, 3.0)  # between the time constants, where the data give none


class TankChain(ParametricModel):
    r"""Tanks in a row, which empty by a power of their level and may overflow.

    .. math::

        \tau_i \dot w_i = q_i - w_i^{p_i}, \quad 0 \le w_i \le c_i, \qquad
        q_1 = \max\left(\frac{u - u_0}{s}, 0\right), \quad q_{i+1} = w_i^{p_i} + \kappa_i o_i,
        \qquad y = G w_n + b

    Levels and flows are relative, so their scale s needs no unit of volume. With p = 1/2 the
    outflow is Torricelli's; p = 1 is a chain of first-order lags. Around a level w the time
    constant is :math:`\tau w^{1-p} / p`, so that the chain is slower, and its gain larger, at high
    levels.

    Parameters
    ----------
    n_tanks : int, default=2
        Number of tanks.
    overflow : bool, default=False
        Whether the levels have ceilings, and the tanks but the last pass on a part of what flows
        over.
    limit : {"level", "reading"}, default="level"
        Whether the ceiling of the last tank limits its level, or the reading alone.
    fit_exponents : bool, default=False
        Whether the exponents are fitted, one a tank; otherwise they are 1/2.
    fit_offset : bool, default=True
        Whether the drive up to which nothing flows is fitted; otherwise it is 0.
    fit_intercept : bool, default=True
        Whether the reading of an empty tank is fitted; otherwise it is 0.
    hold : {"foh", "zoh"}, default="foh"
        Drive between samples: a straight line, or constant.
    n_substeps : int, default=4
        Integration steps in a sampling interval.
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample. A recording that begins under way asks for
        ``"estimate"``: the drive at which the chain had rested before each record of the fit.
    dt : float, default=1.0
        Sampling interval in s of data without a time index.
    method : str or Method, default="variable_projection"
        How the parameters are identified, see :mod:`skhyst.optimize`.

    Attributes
    ----------
    operator_ : TankChainOperator
        ``time_constants`` (s), ``exponents``, ``ceilings``, ``shares``, ``drive_offset`` (drive),
        ``gain`` and ``intercept`` (response), ``scale`` (drive).
    params_, params_std_ : dict
        Parameters and their standard errors.

    References
    ----------
    M. Schoukens, J. P. Noel, "Three benchmarks addressing open challenges in nonlinear system
    identification", IFAC-PapersOnLine 50(1) (2017) 446-451: the cascaded tanks.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.fluid import TankChain
    >>> from skhyst.operators import TankChainOperator
    >>> drive = 1.5 + np.sin(0.05 * np.arange(600)) + 0.4 * np.sin(0.21 * np.arange(600))
    >>> y, _ = TankChainOperator([8.0, 15.0], [0.5, 0.5], gain=3.0).run(drive, 1.0)
    >>> model = TankChain(fit_offset=False, fit_intercept=False).fit(drive.reshape(-1, 1), y)
    >>> bool(np.allclose(model.predict(drive.reshape(-1, 1)), y, atol=1e-3))
    True
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "n_tanks": [Interval(Integral, 1, None, closed="left")],
        "overflow": ["boolean"],
        "limit": [StrOptions({"level", "reading"})],
        "fit_exponents": ["boolean"],
        "fit_offset": ["boolean"],
        "fit_intercept": ["boolean"],
        "hold": [StrOptions({"foh", "zoh"})],
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
        dt=1.0,
        method="variable_projection",
    ):
        self.n_tanks = n_tanks
        self.overflow = overflow
        self.limit = limit
        self.fit_exponents = fit_exponents
        self.fit_offset = fit_offset
        self.fit_intercept = fit_intercept
        self.hold = hold
        self.n_substeps = n_substeps
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    def _fixed(self):
        fixed = set()
        if not self.fit_exponents:
            fixed |= {f"exponents[{i}]" for i in range(self.n_tanks)}
        if not self.fit_offset:
            fixed.add("drive_offset")
        if not self.fit_intercept:
            fixed.add("intercept")
        return frozenset(fixed)

    def _starts(self, records):
        sets = [np.abs(p) for p in pole_starts([(r.u, r.y, r.dt) for r in records], self.n_tanks)]
        sets = sets[-_POLE_SETS:]
        if not sets:
            longest = max(len(r.u) * r.dt for r in records)
            slow = 10.0 / longest * np.ones(self.n_tanks)
            sets = [slow * spread ** np.arange(self.n_tanks) for spread in _SPREADS]
        return [(start, ()) for rates in sets for start in self.starts_of(rates, records)]

    def starts_of(self, rates, records):
        """Return operators to start from, of a linear chain with these rates (1/s), in any order.

        Parameters
        ----------
        rates : array-like of shape (n_tanks,)
        records : sequence of RecordData

        Returns
        -------
        list of TankChainOperator
        """
        low = min(float(r.u.min()) for r in records)
        span = max(float(r.u.max()) for r in records) - low
        middle = float(np.mean(np.concatenate([r.u for r in records])))
        offsets = [0.0]
        if self.fit_offset:
            offsets = [low - part * span for part in _OFFSETS]
        slowest = np.sort(_EXPONENT / np.asarray(rates, dtype=float))
        found = []
        for offset in offsets:
            for constants in [slowest[::-1], slowest][: self.n_tanks]:
                # the level at the mean drive is 1, and around it the linear chain's rates are kept
                chain = TankChainOperator(
                    constants,
                    np.full(self.n_tanks, _EXPONENT),
                    drive_offset=offset,
                    scale=abs(middle - offset) or span or 1.0,
                    limit=self.limit,
                    hold=self.hold,
                    n_substeps=self.n_substeps,
                )
                found += self._limited(chain, records) if self.overflow else [chain]
        return found

    def _limited(self, chain, records):
        """Return the chain with ceilings: of the readings, and of levels that are often reached."""
        levels = []
        for n in range(1, self.n_tanks + 1):
            part = dataclasses.replace(
                chain, time_constants=chain.time_constants[:n], exponents=chain.exponents[:n]
            )
            state = self._free_run_state()
            runs = [part.run(r.u, r.dt, part.init(r.u[0], state))[0] for r in records]
            levels.append(np.concatenate(runs))
        y = np.concatenate([r.y for r in records])
        slope, constant = np.polyfit(levels[-1], y, 1) if np.ptp(levels[-1]) > 0.0 else (1.0, 0.0)
        extreme = y.max() if slope > 0.0 else y.min()
        top = (extreme - constant) / slope if slope else 1.0
        top = float(np.clip(top, np.quantile(levels[-1], 0.5), levels[-1].max())) or 1.0
        found = []
        for part in _FULL if self.n_tanks > 1 else _FULL[:1]:
            before = [float(np.quantile(w, part)) or 1.0 for w in levels[:-1]]
            shares = np.full(self.n_tanks - 1, _SHARE)
            found.append(
                dataclasses.replace(chain, ceilings=np.array([*before, top]), shares=shares)
            )
        return found
