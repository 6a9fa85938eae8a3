"""Maxwell-slip friction: elasto-slide elements in parallel."""

import dataclasses
from functools import cached_property
from numbers import Integral
from typing import Self

import numpy as np

from .._jit import jit
from .._sklearn import Interval, StrOptions
from ..base import with_params
from ..operators import CompiledLaw, CompiledSum, as_signal, parameter
from ._common import (
    FrictionModel,
    as_fine_as_needed,
    force_characteristics,
    in_direction,
    show,
)
from ._prandtl_ishlinskii import PlaySum, PrandtlIshlinskiiOperator, place_thresholds


@jit
def spring_step(u, c, s):
    """Return the force of spring, dashpot and constant; ``s`` is the last drive.

    ``c`` is (stiffness, damping / dt, intercept).
    """
    stiffness, drag, y = c
    y += stiffness * u + drag * (u - s[0])
    s[0] = u
    return y


@dataclasses.dataclass(frozen=True, eq=False)
class MaxwellSlipOperator(PlaySum):
    """Elasto-slide elements, a spring, a dashpot and a constant: the law of :class:`MaxwellSlip`.

    An element is a spring of stiffness ``k_i`` that slides once it is deflected by ``r_i``, a stop
    operator: the drive less a play operator, ``E_r[u] = u - F_r[u]``.

    Parameters
    ----------
    thresholds : array-like of shape (n_elements,)
        Deflections ``r_i`` at which the elements slide, units of the drive, ascending, positive.
        Fixed structure.
    weights : array-like of shape (n_elements,)
        Stiffnesses ``k_i`` in response/drive; the saturation forces are ``k_i r_i``.
    stiffness : float, default=0.0
        Spring ``k`` that never slides, in response/drive.
    damping : float, default=0.0
        Dashpot ``d`` in response s/drive.
    intercept : float, default=0.0
        Constant ``c`` in units of the response.
    non_negative : bool, default=True
        Whether the weights are bounded below by zero when they are identified.
    falling : bool, default=False
        Whether that bound is an upper one: all weights are zero or below, and the response falls
        where the drive rises.

    Raises
    ------
    ValueError
        If the thresholds are not positive or do not ascend, or there is not one weight per
        threshold.

    Notes
    -----
    The elements are evaluated from the turning points of the drive, and the state is that of a
    :class:`PrandtlIshlinskiiOperator`. The velocity at a sample is the slope of the straight line
    that ends there.

    Examples
    --------
    >>> from skhyst.hysteresis import MaxwellSlipOperator
    >>> operator = MaxwellSlipOperator(thresholds=[1.0, 2.0], weights=[3.0, 1.0])
    >>> operator.run([0.0, 1.0, 2.0, 9.0, 8.0], dt=1e-3)[0]
    array([0., 4., 5., 5., 1.])
    """

    thresholds: np.ndarray
    weights: np.ndarray = parameter(linear=True, lower=0.0, unit="response/drive")
    stiffness: float = parameter(default=0.0, linear=True, unit="response/drive")
    damping: float = parameter(default=0.0, linear=True, unit="response s/drive")
    intercept: float = parameter(default=0.0, linear=True, gauge=0.0, unit="response")
    non_negative: bool = True
    falling: bool = False

    def __post_init__(self):
        super().__post_init__()
        self._require("thresholds", self.thresholds[0] > 0.0, "be positive")

    @property
    def presliding_displacement(self):
        """Displacement over which the force builds up, units of the drive; None without a force."""
        return self._mean_threshold()

    def characteristics(self, seen):
        return force_characteristics(self.weights @ self.thresholds, np.sum(self.weights))

    @cached_property
    def _plays(self):
        """The stops as plays: a gain, the sum of the stiffnesses, less the weighted plays."""
        return PrandtlIshlinskiiOperator(
            np.append(0.0, self.thresholds), np.append(self.weights.sum(), -self.weights)
        )

    def init(self, u0, initial_state="rest"):
        return self._plays.init(u0, initial_state)

    def run(self, u, dt, state=None):
        u = as_signal(u)
        state = state or self.init(u[0] if u.size else 0.0)
        y, after = self._plays.run(u, dt, state)
        change = np.diff(u, prepend=state[1])
        y += self.stiffness * u + (self.damping / dt) * change + self.intercept
        return y, after

    def compiled_step(self, dt, state):
        constants = self.stiffness, self.damping / dt, self.intercept
        spring = CompiledLaw(spring_step, constants, state[1:])
        return CompiledSum((self._plays.compiled_step(dt, state), spring))

    def sensitivities(self, u, du, dt, initial_state="rest"):
        u, du = as_signal(u), as_signal(du)
        m, n_elements, rest = du.shape[1], self.thresholds.size, initial_state == "rest"
        y, plays = self._plays.sensitivities(u, du, dt, initial_state)
        change = np.diff(u, prepend=u[:1] if rest else 0.0)
        dchange = np.diff(du, axis=0, prepend=du[:1] if rest else np.zeros((1, m)))
        drag = self.damping / dt
        y += self.stiffness * u + drag * change + self.intercept
        dy = np.empty((u.size, m + n_elements + 3))
        dy[:, :m] = plays[:, :m] + self.stiffness * du + drag * dchange
        np.subtract(u[:, None], plays[:, m + 1 : -2], out=dy[:, m : m + n_elements])
        dy[:, -3], dy[:, -2], dy[:, -1] = u, change / dt, 1.0
        return y, dy

    def position_tangents(self, u, dt, initial_state="rest"):
        return self._moved_plays(as_signal(u)) * -self.weights

    def elements(self, state):
        """Return the deflections of the elements in a state.

        Parameters
        ----------
        state : tuple
            As :meth:`init` and :meth:`run` return it.

        Returns
        -------
        ndarray of shape (n_elements,)
            Units of the drive.
        """
        return state[1] - self._plays.plays(state)[1:]

    def state_from_elements(self, deflections, u):
        """Return the state in which the elements have given deflections.

        Parameters
        ----------
        deflections : array-like of shape (n_elements,)
            As :meth:`elements` returns them.
        u : float
            Drive.

        Returns
        -------
        tuple
            The state.

        Raises
        ------
        ValueError
            If no history of the drive leads to these deflections.
        """
        plays = np.append(float(u), float(u) - np.asarray(deflections, dtype=float))
        return self._plays.state_from_plays(plays, u)


class MaxwellSlip(FrictionModel):
    r"""Maxwell-slip model: elasto-slide elements in parallel, a superposition of stop operators.

    .. math::

        y = \sum_i k_i E_{r_i}[u] + k u + d \dot u + c, \qquad
        E_r[u](t) = \max(-r, \min(r, E_r[u](t^-) + u(t) - u(t^-)))

    The drive ``u`` is a displacement, the response a force (or anything that follows it). All
    parameters are linear and solved exactly, the stiffnesses by non-negative least squares; no
    starting values are needed.

    Parameters
    ----------
    n_elements : int, default=10
        Number of elements; ignored where ``thresholds`` is an array.
    thresholds : {"auto", "grid", "quantile"} or array-like of shape (n_elements,), default="grid"
        Deflections at which the elements slide: evenly spaced over the half range of the drive, by
        quantiles of the drive's swings, or given, in units of the drive, positive. "auto": as for
        :class:`~skhyst.hysteresis.PrandtlIshlinskii`.
    non_negative : bool, default=True
        Whether the stiffnesses of the elements all have the same sign, so that the model
        dissipates: none is below zero, or none above if the data show that the force is measured
        with the opposite sign.

    Attributes
    ----------
    thresholds_ : ndarray of shape (n_elements,)
        Units of the drive.
    weights_ : ndarray of shape (n_elements,)
        Stiffnesses ``k_i``, units of the response over units of the drive.
    saturation_forces_ : ndarray of shape (n_elements,)
        ``k_i r_i``, units of the response.
    intercept_ : float
        Units of the response.

    See Also
    --------
    PrandtlIshlinskii : The superposition of play operators.
    skhyst.preprocessing.StopOperators : The elements as features for any regressor.

    References
    ----------
    Iwan, *Journal of Applied Mechanics*, 1966. Al-Bender, Lampaert and Swevers, *IEEE Transactions
    on Automatic Control*, 2005.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import MaxwellSlip
    >>> drive = 5.0 * np.sin(np.linspace(0, 20, 300))
    >>> y = np.zeros(300)
    >>> for k in range(1, 300):
    ...     y[k] = np.clip(y[k - 1] + drive[k] - drive[k - 1], -2.0, 2.0)
    >>> model = MaxwellSlip(thresholds=[1.0, 2.0, 3.0]).fit(drive.reshape(-1, 1), y + 7.0)
    >>> model.weights_.round(3) + 0.0
    array([0., 1., 0.])
    """

    operator_class = MaxwellSlipOperator
    _parameter_constraints = {
        **FrictionModel._parameter_constraints,
        "n_elements": [Interval(Integral, 1, None, closed="left")],
        "thresholds": [StrOptions({"auto", "grid", "quantile"}), "array-like"],
        "non_negative": ["boolean"],
    }

    def __init__(
        self,
        n_elements=10,
        *,
        thresholds="grid",
        non_negative=True,
        fit_damping=True,
        fit_stiffness=False,
        fit_intercept=True,
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        super().__init__(initial_state=initial_state, dt=dt, drive=drive, method=method)
        self.n_elements = n_elements
        self.thresholds = thresholds
        self.non_negative = non_negative
        self.fit_damping = fit_damping
        self.fit_stiffness = fit_stiffness
        self.fit_intercept = fit_intercept

    def starting_values(self, records):
        # the first threshold of plays is zero, which is no stop, and is left out
        thresholds = place_thresholds(self.thresholds, records, self.n_elements, 1)
        zeros = np.zeros(len(thresholds))
        start = MaxwellSlipOperator(thresholds, zeros, non_negative=self.non_negative)
        fixed, state = self.held_parameters(), self.free_run_state
        starts = in_direction([start], records, fixed, state)
        if self.moves_positions:
            return as_fine_as_needed(starts, records, fixed, state)
        return starts

    @property
    def moves_positions(self):
        """Whether the thresholds are found."""
        return isinstance(self.thresholds, str) and self.thresholds == "auto"

    def resolved(self, operator) -> Self:
        thresholds = operator.thresholds.tolist()
        return with_params(self, n_elements=len(thresholds), thresholds=thresholds)

    def adopt(self, result):
        super().adopt(result)
        show(self, result.operator, "thresholds", "weights", "intercept")
        self.saturation_forces_ = self.weights_ * self.thresholds_
        return self
