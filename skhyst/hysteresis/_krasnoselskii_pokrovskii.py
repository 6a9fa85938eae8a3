"""Krasnosel'skii-Pokrovskii model: relays with ramps in place of jumps.

Kernel ``(i, j)``, ``j <= i``, rises along the ramp of interval ``i`` of the drive and falls along
that of interval ``j``, where the ramp of interval ``k`` goes from -1 at level ``k`` to 1 at level
``k + 1``::

    z = max(ramp_i(u), min(ramp_j(u), z))

Since ``ramp_i <= ramp_j``, max and min may be exchanged. Kernels with ``i = j`` are reversible. The
response is a weighted sum of the kernels, which are numbered as the cells in ``_relay_grid``.
"""

import dataclasses

import numpy as np

from .._jit import jit
from ..operators import CompiledLaw, as_signal, clip_play, parameter
from ._relay_grid import RelayGridModel, RelayGridOperator, cell_indices


@jit(inline=True)
def move(value, levels, ramps, at, kernels):
    """Write the ramps of all intervals from ``ramps[at]`` on and update the kernels."""
    n = levels.size - 1
    for k in range(n):
        part = 2.0 * (value - levels[k]) / (levels[k + 1] - levels[k]) - 1.0
        ramps[at + k] = min(max(part, -1.0), 1.0)
    start = 0
    for i in range(n):
        low = ramps[at + i]
        for j in range(i + 1):
            kernels[start + j] = clip_play(kernels[start + j], low, ramps[at + j])
        start += i + 1


@jit
def ramp_step(u, c, s):
    """Return the response at one sample; ``s`` are the kernels, and work space for the ramps.

    ``c`` is (levels, weights, intercept).
    """
    levels, weights, y = c
    move(u, levels, s, weights.size, s)
    for k in range(weights.size):
        y += weights[k] * s[k]
    return y


@jit
def ramp_run(u, levels, weights, kernels, y, rows, first):
    """Write the weighted sum of the kernels to ``y``; ``kernels`` (K,) is updated.

    Unless ``rows`` is empty, the kernels are written to ``rows[:, first : first + K]``.
    """
    ramps = np.empty(levels.size - 1)
    for k in range(u.size):
        move(u[k], levels, ramps, 0, kernels)
        total = 0.0
        for c in range(kernels.size):
            total += weights[c] * kernels[c]
        y[k] = total
        if rows.size > 0:
            for c in range(kernels.size):
                rows[k, first + c] = kernels[c]


@jit
def ramp_tangents(u, du, levels, weights, kernels, out):
    """Write the tangents of the response to ``out[:, :m]``; ``kernels`` (K,) is updated.

    A kernel on a ramp has the tangent of the ramp; between the ramps it keeps its last tangent.
    """
    n_ramps, m = levels.size - 1, du.shape[1]
    ramps = np.empty(n_ramps)
    held = np.zeros((kernels.size, m))
    for k in range(u.size):
        value = u[k]
        move(value, levels, ramps, 0, kernels)
        for t in range(m):
            out[k, t] = 0.0
        c = 0
        for i in range(n_ramps):
            for j in range(i + 1):
                kernel = kernels[c]
                rises = kernel == ramps[i]
                if rises or kernel == ramps[j]:
                    ramp = i if rises else j
                    low, high = levels[ramp], levels[ramp + 1]
                    slope = 2.0 / (high - low) if low < value < high else 0.0
                    for t in range(m):
                        held[c, t] = slope * du[k, t]
                for t in range(m):
                    out[k, t] += weights[c] * held[c, t]
                c += 1


@dataclasses.dataclass(frozen=True, eq=False)
class KrasnoselskiiPokrovskiiOperator(RelayGridOperator):
    """Weighted sum of kernels with ramps; :class:`KrasnoselskiiPokrovskii` gives the law.

    The time per sample is proportional to the number of kernels. The operator is rate-independent:
    ``dt`` is not used.

    Parameters
    ----------
    levels : array-like of shape (n,)
        Levels of the drive, ascending, units of the drive. Fixed structure. Beyond the first and
        the last the model is saturated.
    weights : array-like of shape (n (n - 1) / 2,)
        Weights, units of the response; kernel ``(i, j)`` has the number ``i (i + 1) / 2 + j``.
    intercept : float, default=0.0
        In units of the response.
    center : float, default=0.0
        Drive at which the virgin device is demagnetised: kernels whose middle is above it are at
        -1, those below at 1, those centred on it at 0, as far as their ramps allow. ``-inf``: all
        are low at first, ``inf``: all are high.
    non_negative : bool, default=True
        Whether the weights are bounded below by zero when they are identified.
    falling : bool, default=False
        Whether that bound is an upper one: all weights are zero or below, and the response falls
        where the drive rises.

    Raises
    ------
    ValueError
        If the levels do not ascend, or the number of weights does not match them.

    Notes
    -----
    The state is the array of kernels, shape (n (n - 1) / 2,). ``"rest"`` is the state after the
    first loading from ``center`` to the first sample, ``"zero"`` the state before it. Both give the
    same output.

    Examples
    --------
    >>> from skhyst.hysteresis import KrasnoselskiiPokrovskiiOperator
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
    falling: bool = False

    def init(self, u0, initial_state="rest"):
        middle = 0.5 * (self.levels[1:] + self.levels[:-1])
        i, j = cell_indices(self.levels.size)
        distance = 2.0 * self._center - middle[i] - middle[j]
        # the distance of mirrored levels is zero up to rounding
        distance[np.abs(distance) < 1e-9 * np.ptp(self.levels)] = 0.0
        kernels = np.sign(distance)
        path = [self._center, float(u0)] if initial_state == "rest" else [self._center]
        return self._follow(path, kernels)[1]

    def run(self, u, dt, state=None):
        u = as_signal(u)
        y, kernels = self._follow(u, self._before(u) if state is None else state)
        return y + self.intercept, kernels

    def compiled_step(self, dt, state):
        constants = self.levels, self.weights, self.intercept
        return CompiledLaw(ramp_step, constants, [*state, *np.zeros(self.levels.size - 1)])

    def _fill(self, u, state, rows, first):
        return self._follow(u, state, rows, first)[1]

    def _follow(self, u, state, rows=None, first=0):
        u, kernels = as_signal(u), state.copy()
        y = np.empty(u.size)
        rows = np.empty((0, 0)) if rows is None else rows
        ramp_run(u, self.levels, self.weights, kernels, y, rows, first)
        return y, kernels

    def _propagate(self, u, du, state, out):
        ramp_tangents(u, du, self.levels, self.weights, state.copy(), out)


class KrasnoselskiiPokrovskii(RelayGridModel):
    r"""Krasnosel'skii-Pokrovskii model of rate-independent hysteresis.

    .. math::

        y = c + \sum_{j \le i} w_{ij} z_{ij}, \qquad
        z_{ij}(t) = \max(p_i(u), \min(p_j(u), z_{ij}(t^-)))

    The ramp :math:`p_k` rises from -1 at level k of the drive to 1 at level k + 1: a kernel is a
    relay with ramps as wide as the grid. Those with the same ramp up and down are reversible. The
    weights are solved exactly by (non-negative) least squares with a penalty on the differences of
    neighbours; no starting values are needed. The time of a prediction is proportional to the
    number of kernels, one per cell; that of :class:`~skhyst.hysteresis.Preisach`, whose relays have
    a density over the cells, does not depend on it.

    See Also
    --------
    Preisach : The same plane, with relays.
    PrandtlIshlinskii : Plays of one slope each.

    References
    ----------
    Banks, Kurdila and Webb, *Mathematical Problems in Engineering*, 1997, equations (2) to (6).

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import KrasnoselskiiPokrovskii
    >>> drive = np.sin(np.linspace(0, 20, 500)) * np.linspace(0, 1, 500)
    >>> X = drive.reshape(-1, 1)
    >>> model = KrasnoselskiiPokrovskii(n_levels=5).fit(X, drive)
    >>> bool(np.allclose(model.predict(X), drive, atol=1e-3))
    True
    """

    operator_class = KrasnoselskiiPokrovskiiOperator
    _diagonal_is_reversible = True
