"""Krasnosel'skii-Pokrovskii model: relays with ramps in place of jumps.

Loops over the kernels of Krasnosel'skii and Pokrovskii.

Kernel ``(i, j)``, ``j <= i``, rises along the ramp of interval ``i`` and falls along that of
interval ``j``, where the ramp of interval ``k`` goes from -1 at ``levels[k]`` to 1 at
``levels[k + 1]``::

    z = max(ramp_i(u), min(ramp_j(u), z))

Kernels are numbered ``i (i + 1) / 2 + j``. Since ``ramp_i <= ramp_j``, the order does not matter.

Krasnosel'skii-Pokrovskii operator: relays with ramps in place of jumps.
"""

import dataclasses

import numpy as np

from .._jit import jit
from ..operators import Operator, as_signal, parameter
from ._relay_grid import RelayGridModel, cell_indices, check_grid

__all__ = [
    "KrasnoselskiiPokrovskii",
    "KrasnoselskiiPokrovskiiOperator",
    "ramp_basis",
    "ramp_run",
    "ramp_tangents",
]


@jit
def fill_ramps(value, levels, ramps):
    """Write the ramps of all intervals."""
    for k in range(ramps.size):
        part = 2.0 * (value - levels[k]) / (levels[k + 1] - levels[k]) - 1.0
        ramps[k] = min(max(part, -1.0), 1.0)


@jit
def move(ramps, kernels):
    """Update the kernels."""
    start = 0
    for i in range(ramps.size):
        low = ramps[i]
        for j in range(i + 1):
            high = ramps[j]
            kernel = kernels[start + j]
            kernel = high if high < kernel else kernel
            kernels[start + j] = low if low > kernel else kernel
        start += i + 1


@jit
def ramp_run(u, levels, weights, kernels, y):
    """Write the weighted sum of the kernels to ``y``; ``kernels`` (K,) is updated."""
    ramps = np.empty(levels.size - 1)
    for k in range(u.size):
        fill_ramps(u[k], levels, ramps)
        move(ramps, kernels)
        total = 0.0
        for c in range(kernels.size):
            total += weights[c] * kernels[c]
        y[k] = total


@jit
def ramp_basis(u, levels, kernels, out):
    """Write the kernels to ``out[:, :K]``; ``kernels`` (K,) is updated."""
    ramps = np.empty(levels.size - 1)
    for k in range(u.size):
        fill_ramps(u[k], levels, ramps)
        move(ramps, kernels)
        row = out[k]
        for c in range(kernels.size):
            row[c] = kernels[c]


@jit
def ramp_tangents(u, du, levels, weights, kernels, out):
    """Write the tangents carried through to ``out[:, :m]``; ``kernels`` (K,) is updated.

    A kernel on a ramp has the tangent of the ramp, one between the ramps keeps the one it had.
    """
    n_ramps, m = levels.size - 1, du.shape[1]
    ramps = np.empty(n_ramps)
    held = np.zeros((kernels.size, m))
    for k in range(u.size):
        value = u[k]
        fill_ramps(value, levels, ramps)
        move(ramps, kernels)
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


class KrasnoselskiiPokrovskii(RelayGridModel):
    r"""Krasnosel'skii-Pokrovskii model of rate-independent hysteresis.

    .. math::

        y = c + \sum_{j \le i} w_{ij} z_{ij}, \qquad
        z_{ij}(t) = \max(p_i(u), \min(p_j(u), z_{ij}(t^-)))

    The ramp :math:`p_k` rises from -1 at level k of the drive to 1 at level k + 1: a kernel is a
    relay with slopes as wide as the grid. The weights are solved exactly by (non-negative) least
    squares with a penalty on the differences of neighbours; no starting values are needed. A
    prediction takes time in proportion to the number of kernels;
    :class:`~skhyst.hysteresis.Preisach` spreads its relays over the cells and does not.

    Parameters
    ----------
    n_levels : int, default=20
        Number n of levels of the drive; there are n (n - 1) / 2 kernels. Ignored where ``levels``
        is an array.
    levels : {"grid", "response"} or array-like of shape (n_levels,), default="grid"
        From the lowest to the highest drive in the records of the fit, evenly spaced or denser
        where the response changes more (half of the levels follow the drive, half the response);
        or given, in units of the drive. The second suits responses that are steep in a part of the
        range and saturate in the rest. Beyond the levels the model is saturated: the response stays
        constant.
    smoothness : float, default=1e-3
        Weight of the penalty relative to that of the data, without unit. It fills kernels that the
        data do not determine from their neighbours. 0: none.
    non_negative : bool, default=True
        The weights are not negative: branches are monotone and the model dissipates.
    fit_intercept : bool, default=True
        Whether the response has a constant.
    center : float, default=0.0
        Drive at which the virgin device is demagnetised, units of the drive. ``-inf`` (or any value
        up to the lowest level, such as 0 for a drive from 0 to 150 V): all kernels are down at
        first.
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample: at rest after a first loading from ``center``; the
        drive still at ``center``; or after a rest at a drive value that is fitted for each record.
    dt : float, default=1.0
        Sampling interval in s of data without a time index. The model does not depend on it.
    method : str or Method, default="variable_projection"
        As for every model; all parameters are linear, and solved exactly by any.

    Attributes
    ----------
    levels_ : ndarray of shape (n_levels,)
        Units of the drive.
    weights_ : ndarray of shape (n_levels * (n_levels - 1) / 2,)
        Units of the response; kernel (i, j) has the number i (i + 1) / 2 + j.
    intercept_ : float
        Units of the response.
    operator_ : KrasnoselskiiPokrovskiiOperator
        The model as frozen numbers, to run sample by sample.
    params_, params_std_ : dict
        Parameters and their standard errors, which hold for the penalised estimate: its bias is
        not in them. Kernels that have not moved are named in
        ``identifiability_["undetermined"]``.

    Notes
    -----
    In a :class:`~skhyst.compose.Cascade` or a :class:`~skhyst.compose.Sum` all parameters are
    refined jointly and without the penalty: use few levels there.

    References
    ----------
    H. T. Banks, A. J. Kurdila, G. Webb, "Identification of hysteretic control influence operators
    representing smart actuators, part I: formulation", Mathematical Problems in Engineering 3,
    1997.

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

    _diagonal_is_reversible = True

    def __init__(
        self,
        n_levels=20,
        *,
        levels="grid",
        smoothness=1e-3,
        non_negative=True,
        fit_intercept=True,
        center=0.0,
        initial_state="rest",
        dt=1.0,
        method="variable_projection",
    ):
        self.n_levels = n_levels
        self.levels = levels
        self.smoothness = smoothness
        self.non_negative = non_negative
        self.fit_intercept = fit_intercept
        self.center = center
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    def _operator(self, levels):
        n = len(levels)
        return KrasnoselskiiPokrovskiiOperator(
            levels,
            np.zeros(n * (n - 1) // 2),
            center=self.center,
            non_negative=self.non_negative,
        )
