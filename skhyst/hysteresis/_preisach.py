r"""Preisach model: relays with a density on the half plane of their thresholds.

    y = c + integral of mu(alpha, beta) gamma[u] over alpha >= beta + sum_k g_k s_k(u)

with relays gamma, and ``s_k`` that rise from -1 to 1 between levels ``k`` and ``k + 1``. The
density mu is constant in the cells of a grid, see ``_relay_grid``; the response is evaluated from
the turning points of the drive, see ``_preisach_loops``.
"""

import dataclasses
from functools import cached_property

import numpy as np

from ..operators import LoweredStep, as_signal, parameter
from ._common import show
from ._preisach_loops import (
    build_bins,
    everett_run,
    everett_step,
    everett_tangents,
    everett_value,
    find_interval,
    first_loading_table,
    in_tables,
    response,
    restore_values,
    staircase_rows,
)
from ._relay_grid import RelayGridModel, RelayGridOperator, cell_indices

# turning points that a step remembers; one that it must drop moves less than 2 / _CORNERS^2 of all
# relays, half of what a converter of 16 bits resolves
_CORNERS = 512


@dataclasses.dataclass(frozen=True, eq=False)
class PreisachOperator(RelayGridOperator):
    """Superposition of relays with a piecewise-constant density; :class:`Preisach` gives the law.

    The output is continuous. A run costs the same for any number of cells. It does not depend on
    ``dt``.

    Parameters
    ----------
    levels : array-like of shape (n,)
        Levels of the drive, ascending, in its unit. Fixed structure. Beyond the first and the last
        the model is saturated: no relay switches and the output stays constant.
    weights : array-like of shape (n (n - 1) / 2,)
        Density times area of each cell, units of the response. The cell of interval ``i`` of alpha
        and interval ``j <= i`` of beta has the number ``i (i + 1) / 2 + j``.
    reversible : array-like of shape (n - 1,) or (0,), default=()
        Weights of the reversible part, units of the response.
    intercept : float, default=0.0
        Midway between the two saturations, units of the response.
    center : float, default=0.0
        Drive at which the virgin device is demagnetised: relays with ``alpha + beta`` above
        ``2 center`` are down, the others up. ``-inf`` (or the lowest level): all down at first,
        ``inf``: all up.
    non_negative : bool, default=True
        Whether the weights are bounded below by zero when they are identified.

    Raises
    ------
    ValueError
        If the levels do not ascend, or the number of weights does not fit to them.

    Notes
    -----
    The state is the tuple (turning points, last drive), clipped to the levels' range: the points
    are nested, the oldest and largest first, and none in a first loading. ``"rest"`` is the first
    loading from ``center`` to the first sample; in ``"zero"`` that loading is still to come. Both
    give the same output.

    Examples
    --------
    >>> from skhyst.hysteresis import PreisachOperator
    >>> operator = PreisachOperator(levels=[-1.0, 0.0, 1.0], weights=[0.0, 1.0, 0.0])
    >>> y, state = operator.run([0.0, 1.0, 0.0, -0.5, -1.0, 0.5], dt=1e-3)
    >>> y
    array([ 0.,  1.,  1.,  0., -1.,  0.])
    """

    levels: np.ndarray
    weights: np.ndarray = parameter(linear=True, lower=0.0, unit="response")
    reversible: np.ndarray = parameter(default=(), linear=True, lower=0.0, unit="response")
    intercept: float = parameter(default=0.0, linear=True, gauge=0.0, unit="response")
    center: float = 0.0
    non_negative: bool = True

    def __post_init__(self):
        super().__post_init__()
        n = self.levels.size - 1
        wanted = f"be empty or have one value for each of the {n} intervals"
        self._require("reversible", self.reversible.size in (0, n), wanted)

    @cached_property
    def _bins(self):
        bins = np.empty(4 * self.levels.size + 1, dtype=np.int64)
        return bins, build_bins(self.levels, bins)

    @cached_property
    def _tables(self):
        n = self.levels.size
        grid = np.zeros((n - 1, n - 1))
        grid[np.tril_indices(n - 1)] = self.weights
        reversible = self.reversible if self.reversible.size else np.zeros(n - 1)
        everett = np.zeros((n, n))
        everett[1:, :-1] = np.cumsum(np.cumsum(grid[:, ::-1], axis=1)[:, ::-1], axis=0)
        everett += np.tril(np.subtract.outer(*2 * [np.append(0.0, np.cumsum(reversible))]))
        everett = 2.0 * np.tril(everett, -1)
        everett += everett.T
        diagonal = 2.0 * np.column_stack((grid.diagonal(), reversible))
        low, high = self.levels[[0, -1]]
        knots = np.unique(np.r_[self.levels, 2.0 * self._center - self.levels, self._center])
        knots = knots[(knots >= low) & (knots <= high)]
        loading = np.zeros((knots.size, 4))
        loading[0, 1] = -(self.weights.sum() + reversible.sum())
        grid = self.levels, everett, diagonal
        first_loading_table(knots, self._center, *grid, *self._bins, loading)
        return *grid, loading, *self._bins

    def init(self, u0, initial_state="rest"):
        last = np.clip(u0, *self.levels[[0, -1]]) if initial_state == "rest" else self._center
        return np.empty(0), float(last)

    def _stack(self, state, n_samples):
        """Return a stack with room for all turning points to come, its depth and the last drive."""
        turning_points, last = state
        top = turning_points.size
        points = np.empty(top + n_samples + 2)
        points[1 : top + 1] = turning_points
        if top:
            points[0] = 2.0 * self._center - points[1]
        return points, top, float(last)

    def run(self, u, dt, state=None):
        u = as_signal(u)
        points, top, last = self._stack(state or self._before(u), u.size)
        values, y = np.empty(points.size), np.empty(u.size)
        restore_values(points, top, values, *self._tables)
        top, last = everett_run(u, self._center, *self._tables, points, values, top, last, y)
        y += self.intercept
        return y, (points[1 : top + 1].copy(), last)

    def lowered(self, dt, state):
        points, top, last = self._stack(state, 0)
        n = max(_CORNERS, top) + 1
        s = np.zeros(2 * n + 3)
        if top:
            s[: top + 1] = points[: top + 1]
        restore_values(s, top, s[n:], *self._tables)
        s[2 * n :] = top, last, response(last, top, s, s, n, *self._tables)
        constants = self._center, self.intercept, *self._tables
        return LoweredStep(everett_step, constants, s, possible=in_tables)

    def _fill(self, u, state, rows):
        points, *place = self._stack(state, u.size)
        grid = self._center, self.levels, *self._bins, self.reversible.size
        top, last = staircase_rows(u, *grid, points, *place, rows)
        return points[1 : top + 1].copy(), last

    def _carry(self, u, du, state, out):
        points, _, last = self._stack(state, u.size)
        everett_tangents(u, du, self._center, *self._tables, points, last, out)

    def everett(self, alpha, beta):
        """Return the Everett function: half the response's change from ``beta`` up to ``alpha``.

        Beyond the levels it stays constant.
        """
        high, low = np.clip([alpha, beta], *self.levels[[0, -1]])
        levels, everett, diagonal, _, *bins = self._tables
        i, j = find_interval(high, levels, *bins), find_interval(low, levels, *bins)
        return 0.5 * everett_value(high, i, low, j, levels, everett, diagonal)


class Preisach(RelayGridModel):
    r"""Preisach model of rate-independent hysteresis with a free density.

    .. math::

        y = c + \iint_{\alpha \ge \beta} \mu(\alpha, \beta)\, \gamma_{\alpha\beta}[u]\,
        d\alpha\, d\beta + \sum_k g_k\, s_k(u)

    A relay :math:`\gamma_{\alpha\beta}` is +1 once the drive has reached alpha and -1 once it has
    fallen to beta. The density is constant in the cells of a grid over the range of the drive; the
    last sum is the density on the line alpha = beta, the reversible part. The density is solved
    exactly by (non-negative) least squares with a penalty on the differences of neighbouring
    cells; no starting values are needed. A prediction costs the same for any number of cells.

    Parameters
    ----------
    reversible : bool, default=True
        Whether there is a reversible part, without which the response does not follow a small
        reversal of the drive at first.

    Attributes
    ----------
    density_ : ndarray of shape (n_levels - 1, n_levels - 1)
        Density in each cell, alpha by beta, zero above the diagonal; units of the response over
        those of the drive squared.
    reversible_ : ndarray of shape (n_levels - 1,) or (0,)
        Weights of the reversible part, units of the response.

    References
    ----------
    Mayergoyz, *Mathematical Models of Hysteresis and Their Applications*, 2003, sections 1.2
    (staircase, wiping-out, congruency) and 1.3 (Everett function, numerical form).

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import Preisach
    >>> drive = np.sin(np.linspace(0, 20, 500)) * np.linspace(0, 1, 500)
    >>> X = drive.reshape(-1, 1)
    >>> model = Preisach(n_levels=5).fit(X, drive)
    >>> bool(np.allclose(model.predict(X), drive, atol=1e-3))
    True
    """

    _parameter_constraints = {**RelayGridModel._parameter_constraints, "reversible": ["boolean"]}

    operator_class = PreisachOperator

    def __init__(
        self,
        n_levels=20,
        *,
        levels="grid",
        smoothness=1e-3,
        reversible=True,
        non_negative=True,
        fit_intercept=True,
        center=0.0,
        initial_state="rest",
        dt=1.0,
        method="variable_projection",
    ):
        super().__init__(
            n_levels,
            levels=levels,
            smoothness=smoothness,
            non_negative=non_negative,
            fit_intercept=fit_intercept,
            center=center,
            initial_state=initial_state,
            dt=dt,
            method=method,
        )
        self.reversible = reversible

    def starting_values(self, records):
        (operator,) = super().starting_values(records)
        zeros = np.zeros(operator.levels.size - 1 if self.reversible else 0)
        return [dataclasses.replace(operator, reversible=zeros)]

    def _adopt(self, result):
        super()._adopt(result)
        show(self, self.operator_, "reversible")
        width = np.diff(self.levels_)
        area = np.outer(width, width)
        area[np.diag_indices_from(area)] *= 0.5
        self.density_ = np.zeros_like(area)
        self.density_[cell_indices(self.levels_.size)] = self.weights_
        self.density_ /= area
        return self
