"""Preisach model: relays with a density on the half plane of their thresholds."""

import numpy as np

from ..operators import PreisachOperator
from ..operators._relay_grid import cell_indices
from ._relay_grid import RelayGridModel

__all__ = ["Preisach"]


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
    n_levels : int, default=20
        Number n of levels of the drive; there are n (n - 1) / 2 cells. Ignored where ``levels`` is
        an array.
    levels : {"grid", "response"} or array-like of shape (n_levels,), default="grid"
        From the lowest to the highest drive in the records of the fit, evenly spaced or denser
        where the response changes more (half of the levels follow the drive, half the response);
        or given, in units of the drive. The second suits responses that are steep in a part of the
        range and saturate in the rest. Beyond the levels the model is saturated: the response stays
        constant.
    smoothness : float, default=1e-3
        Weight of the penalty relative to that of the data, without unit. It fills cells that the
        data do not determine from their neighbours. 0: none.
    reversible : bool, default=True
        Whether there is a reversible part, without which the response does not follow a small
        reversal of the drive at first.
    non_negative : bool, default=True
        The density is not negative: branches are monotone and the model dissipates.
    fit_intercept : bool, default=True
        Whether the response has a constant.
    center : float, default=0.0
        Drive at which the virgin device is demagnetised, units of the drive: relays with alpha +
        beta above ``2 center`` are down, the others up. ``-inf`` (or any value up to the lowest
        level, such as 0 for a drive from 0 to 150 V): all relays are down at first.
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
    density_ : ndarray of shape (n_levels - 1, n_levels - 1)
        Density in each cell, alpha by beta, zero above the diagonal; units of the response over
        those of the drive squared.
    weights_ : ndarray of shape (n_levels * (n_levels - 1) / 2,)
        Density times area of the cells, units of the response.
    reversible_ : ndarray of shape (n_levels - 1,) or (0,)
        Weights of the reversible part, units of the response.
    intercept_ : float
        Units of the response.
    operator_ : PreisachOperator
        The model as frozen numbers, to run sample by sample.
    params_, params_std_ : dict
        Parameters and their standard errors, which hold for the penalised estimate: its bias is
        not in them. Cells in which no relay has switched are named in
        ``identifiability_["undetermined"]``.

    Notes
    -----
    In a :class:`~skhyst.compose.Cascade` or a :class:`~skhyst.compose.Sum` all parameters are
    refined jointly and without the penalty: use few levels there.

    References
    ----------
    I. D. Mayergoyz, "Mathematical Models of Hysteresis and Their Applications", Elsevier 2003,
    chapter 1.

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

    _parameter_constraints = {
        **RelayGridModel._parameter_constraints,
        "reversible": ["boolean"],
    }

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
        self.n_levels = n_levels
        self.levels = levels
        self.smoothness = smoothness
        self.reversible = reversible
        self.non_negative = non_negative
        self.fit_intercept = fit_intercept
        self.center = center
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    def _operator(self, levels):
        n = len(levels)
        return PreisachOperator(
            levels,
            np.zeros(n * (n - 1) // 2),
            np.zeros(n - 1 if self.reversible else 0),
            center=self.center,
            non_negative=self.non_negative,
        )

    def _adopt(self, result):
        super()._adopt(result)
        self.reversible_ = np.array(self.operator_.reversible)
        width = np.diff(self.levels_)
        area = np.outer(width, width)
        area[np.diag_indices_from(area)] *= 0.5
        self.density_ = np.zeros_like(area)
        self.density_[cell_indices(self.levels_.size)] = self.weights_
        self.density_ /= area
        return self
