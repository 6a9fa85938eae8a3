"""Krasnosel'skii-Pokrovskii operator: relays with ramps in place of jumps."""

import dataclasses

import numpy as np

from .._kernels._arrays import as_signal
from .._kernels._krasnoselskii_pokrovskii import ramp_basis, ramp_run, ramp_tangents
from ._base import Operator, parameter
from ._relay_grid import cell_indices, check_grid

__all__ = ["KrasnoselskiiPokrovskiiOperator"]


@dataclasses.dataclass(frozen=True, eq=False)
class KrasnoselskiiPokrovskiiOperator(Operator):
    r"""Weighted sum of Krasnosel'skii-Pokrovskii kernels.

    .. math::

        y = c + \sum_{j \le i} w_{ij} z_{ij}, \qquad
        z_{ij}(t) = \max(p_i(u), \min(p_j(u), z_{ij}(t^-)))

    where the ramp ``p_k`` rises from -1 at level ``k`` to 1 at level ``k + 1``. A kernel rises
    along the ramp of interval ``i`` of the drive and falls along that of interval ``j``: a relay
    with finite slopes. Those with ``i = j`` are reversible.

    Parameters
    ----------
    levels : array-like of shape (n,)
        Levels of the drive, ascending, in its unit. Fixed structure. Beyond the first and the last
        the model is saturated.
    weights : array-like of shape (n (n - 1) / 2,)
        Weights, units of the response; kernel ``(i, j)`` has the number ``i (i + 1) / 2 + j``.
    intercept : float, default=0.0
        Constant ``c`` in units of the response.
    center : float, default=0.0
        Drive at which the virgin device is demagnetised: kernels whose middle is above it stand at
        -1, those below at 1, those about it at 0, as far as their ramps allow. ``-inf``: all
        low at first, ``inf``: all high.
    non_negative : bool, default=True
        Whether the weights are bounded below by zero when they are identified.

    Raises
    ------
    ValueError
        If the levels do not ascend, or the number of weights does not fit to them.

    Notes
    -----
    The state is the array of kernels, shape (n (n - 1) / 2,). ``"rest"`` is the first loading from
    ``center`` to the first sample; in ``"zero"`` the drive stands at ``center`` still. Both give
    the same output. The operator is rate-independent: ``dt`` is not used. A sample costs time in
    proportion to the number of kernels.

    References
    ----------
    H. T. Banks, A. J. Kurdila, G. Webb, "Identification of hysteretic control influence operators
    representing smart actuators, part I: formulation", Mathematical Problems in Engineering 3,
    1997, equations (2) to (6).

    Examples
    --------
    >>> from skhyst.operators import KrasnoselskiiPokrovskiiOperator
    >>> operator = KrasnoselskiiPokrovskiiOperator(levels=[-1.0, 0.0, 1.0], weights=[0, 1, 0])
    >>> y, state = operator.run([0.0, 0.5, 1.0, 0.0, -0.5, -1.0], dt=1e-3)
    >>> y
    array([ 0.,  0.,  1.,  1.,  0., -1.])
    """

    levels: np.ndarray
    weights: np.ndarray = parameter(linear=True, lower=0.0, unit="response")
    intercept: float = parameter(default=0.0, linear=True, gauge=0.0, unit="response")
    center: float = 0.0
    non_negative: bool = True

    carries_scale = True
    rank = 10

    def __post_init__(self):
        check_grid(self)

    def __reduce__(self):
        fields = dataclasses.fields(self)
        return type(self), tuple(getattr(self, field.name) for field in fields)

    def parameter_specs(self):
        """Return the identifiable fields; the weights have a bound if ``non_negative``."""
        specs = super().parameter_specs()
        if not self.non_negative:
            specs["weights"] = dataclasses.replace(specs["weights"], lower=-np.inf)
        return specs

    def init(self, u0, initial_state="rest"):
        """Return the kernels before the first sample ``u0``."""
        center = float(np.clip(self.center, self.levels[0], self.levels[-1]))
        middle = 0.5 * (self.levels[1:] + self.levels[:-1])
        i, j = cell_indices(self.levels.size)
        distance = 2.0 * center - middle[i] - middle[j]
        # mirrored levels meet up to rounding only
        distance[np.abs(distance) < 1e-9 * np.ptp(self.levels)] = 0.0
        kernels = np.sign(distance)
        path = [center, float(u0)] if initial_state == "rest" else [center]
        ramp_basis(as_signal(path), self.levels, kernels, np.empty((len(path), kernels.size)))
        return kernels

    def run(self, u, dt, state=None):
        """Map a drive of shape (n_samples,) to the response; see :meth:`Operator.run`."""
        u = as_signal(u)
        kernels = self._kernels(u, state)
        y = np.empty(u.size)
        ramp_run(u, self.levels, self.weights, kernels, y)
        y += self.intercept
        return y, kernels

    def _kernels(self, u, state):
        if state is None:
            return self.init(u[0] if u.size else self.center)
        return state.copy()

    def basis(self, u, state=None):
        """Return the derivatives of the response with respect to all parameters, and the state.

        Parameters
        ----------
        u : array-like of shape (n_samples,)
            Drive.
        state : ndarray of shape (n (n - 1) / 2,), optional
            Kernels before the first sample; first loading by default.

        Returns
        -------
        rows : ndarray of shape (n_samples, n_parameters)
            The kernels, then a one, in the order of ``pack``.
        state : ndarray of shape (n (n - 1) / 2,)
        """
        u = as_signal(u)
        kernels = self._kernels(u, state)
        rows = np.ones((u.size, self.n_parameters))
        ramp_basis(u, self.levels, kernels, rows)
        return rows, kernels

    def linearize(self, u, du, dt, initial_state="rest"):
        """Return the response and its tangents; see :meth:`Operator.linearize`."""
        u, du = as_signal(u), as_signal(du)
        kernels = self.init(u[0] if u.size else self.center, initial_state)
        y, _ = self.run(u, dt, kernels)
        m = du.shape[1]
        dy = np.ones((u.size, m + self.n_parameters))
        if m:
            ramp_tangents(u, du, self.levels, self.weights, kernels.copy(), dy)
        ramp_basis(u, self.levels, kernels, dy[:, m:])
        return y, dy
