"""Krasnosel'skii-Pokrovskii model: relays with ramps in place of jumps."""

import numpy as np

from ..operators import KrasnoselskiiPokrovskiiOperator
from ._relay_grid import RelayGridModel

__all__ = ["KrasnoselskiiPokrovskii"]


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
