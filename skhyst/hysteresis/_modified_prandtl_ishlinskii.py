"""Modified Prandtl-Ishlinskii model: plays in series with one-sided dead zones."""

from itertools import product
from numbers import Integral

import numpy as np
from sklearn.utils.validation import check_array

from .._sklearn import Interval, StrOptions
from ..operators import Series
from ..optimize import bounded_step
from ..static import MonotoneDeadZoneOperator
from ._prandtl_ishlinskii import PlayModel, PrandtlIshlinskii, PrandtlIshlinskiiOperator

_STEEPEST = 10.0  # largest slope of the starting dead zones, which noise would make steeper


class ModifiedPrandtlIshlinskii(PlayModel):
    r"""Modified Prandtl-Ishlinskii model: hysteresis that is asymmetric or saturates.

    .. math:: y = S[z], \quad z = c + \sum_k w_k F_{r_k}[u - u_0], \quad
       S[z] = z + \sum_j v_j D_j(z)

    (Kuhnen 2003): a superposition of plays, followed by a superposition of one-sided dead zones
    :math:`D_j(z) = \max(z - t_j, 0)` above the centre and :math:`\min(z - t_j, 0)` below it. The
    dead zones are parametrised by the slopes of S, which are positive, so that S is strictly
    monotone and the model has an exact inverse. The slope of S at the centre is one, which fixes
    the gain of S relative to H, the sum of plays.

    Starting values come from :math:`S^{-1}[y] = H[u]`, which is linear in the weights of both sides
    and thus one bounded least-squares problem; the error of the response is then minimised over
    the parameters of both parts.

    Parameters
    ----------
    n_dead_zones : int, default=3
        Number of dead zones per side; ignored if ``dead_zone_thresholds`` is an array.
    dead_zone_thresholds : "quantile" or array-like of shape (n_zones,), default="quantile"
        Thresholds of the dead zones: such that equally many samples of the response lie between
        neighbours, or given, in units of the response. The centre is the segment that contains the
        median of the response; dead zones above it act upwards, those below it downwards.

    Attributes
    ----------
    dead_zone_thresholds_, dead_zone_weights_ : ndarray of shape (n_zones,)
        Thresholds of the dead zones, units of the response; their weights, no unit.
    operator_ : Series
        The stages ``plays`` (PrandtlIshlinskiiOperator) and ``zones`` (MonotoneDeadZoneOperator).

    See Also
    --------
    PrandtlIshlinskii : The part in front, whose loops are symmetric.
    skhyst.static.DeadZones : The part behind.

    References
    ----------
    Kuhnen, *European Journal of Control*, 2003.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import ModifiedPrandtlIshlinskii
    >>> drive = np.sin(np.linspace(0, 20, 500)) * np.linspace(0, 1, 500)
    >>> X, y = drive.reshape(-1, 1), np.minimum(drive, 0.5 * drive + 0.1)
    >>> model = ModifiedPrandtlIshlinskii(4, dead_zone_thresholds=[0.2]).fit(X, y)
    >>> round(float(model.dead_zone_weights_[0]), 6)
    -0.5
    >>> bool(np.allclose(model.inverse_predict(y.reshape(-1, 1)), drive))
    True
    """

    _parameter_constraints = {
        **PlayModel._parameter_constraints,
        "drive_offset": PrandtlIshlinskii._parameter_constraints["drive_offset"],
        "n_dead_zones": [Interval(Integral, 1, None, closed="left")],
        "dead_zone_thresholds": [StrOptions({"quantile"}), "array-like"],
    }

    operator_class = Series
    stage_order = PrandtlIshlinskiiOperator.stage_order

    def __init__(
        self,
        n_operators=20,
        *,
        n_dead_zones=3,
        thresholds="grid",
        dead_zone_thresholds="quantile",
        non_negative=True,
        drive_offset=0.0,
        fit_intercept=True,
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        super().__init__(initial_state=initial_state, dt=dt, drive=drive, method=method)
        self.n_operators = n_operators
        self.n_dead_zones = n_dead_zones
        self.thresholds = thresholds
        self.dead_zone_thresholds = dead_zone_thresholds
        self.non_negative = non_negative
        self.drive_offset = drive_offset
        self.fit_intercept = fit_intercept

    def starting_values(self, records):
        directed = PrandtlIshlinskii(
            self.n_operators,
            form="play",
            thresholds=self.thresholds,
            non_negative=self.non_negative,
            drive_offset=self.drive_offset,
            fit_intercept=self.fit_intercept,
            initial_state=self.initial_state,
        ).starting_values(records)
        levels, n_lower = self._levels(np.concatenate([record.y for record in records]))
        unit = MonotoneDeadZoneOperator(np.ones(levels.size), levels, n_lower)
        gram = self._inverse_gram(directed[0], unit, records)
        starts = []
        # dead zones fitted to the data, and none, because noise biases the first
        for plays, steepest in product(directed, (_STEEPEST, 1.0)):
            slopes, weights, intercept = self._solve_inverse(plays, gram, levels.size, steepest)
            zones = MonotoneDeadZoneOperator(slopes, levels, n_lower).inverse()
            if not isinstance(self.dead_zone_thresholds, str):
                zones = MonotoneDeadZoneOperator(zones.slopes, levels, n_lower)
            values = np.concatenate([weights, [intercept, plays.drive_offset]])
            starts.append(Series(("plays", "zones"), (plays.unpack(values), zones)))
        return starts

    def _levels(self, y):
        """Return the thresholds of the dead zones and the number of those below the centre."""
        if isinstance(self.dead_zone_thresholds, str):
            n = self.n_dead_zones
            return np.quantile(y, np.arange(1, 2 * n + 1) / (2 * n + 1)), n
        levels = check_array(self.dead_zone_thresholds, ensure_2d=False, dtype=np.float64)
        if levels.ndim != 1 or not np.all(levels[1:] >= levels[:-1]):
            raise ValueError(
                "The 'dead_zone_thresholds' parameter of ModifiedPrandtlIshlinskii must be "
                f"'quantile' or ascending values. Got {self.dead_zone_thresholds!r} instead."
            )
        return levels, int(np.searchsorted(levels, np.median(y)))

    def _inverse_gram(self, plays, unit, records):
        """Return the Gram matrix of the columns of ``S^-1[y] - H[u]`` and, last, of ``y``."""
        gram = 0.0
        for record in records:
            _, columns = plays.sensitivities(
                record.u, np.empty((len(record.u), 0)), record.dt, self.free_run_state
            )
            _, parts = unit.parts(record.y)
            block = np.column_stack((parts, -columns[:, : plays.weights.size + 1], record.y))
            gram = gram + block.T @ block
        return gram

    def _solve_inverse(self, plays, gram, n_zones, steepest):
        """Return slopes of S^-1, weights and intercept of H that fit best, from the Gram matrix."""
        n = len(gram) - 1
        bound = plays.parameter_specs()["weights"]
        lower, upper = np.full(n, bound.lower), np.full(n, bound.upper)
        lower[:n_zones], upper[:n_zones] = 1.0 / steepest - 1.0, steepest - 1.0
        lower[-1], upper[-1] = (-np.inf, np.inf) if self.fit_intercept else (0.0, 0.0)
        step = bounded_step(gram[:-1, :-1], gram[:-1, -1], lower, upper)
        return 1.0 + step[:n_zones], step[n_zones:-1], step[-1]

    def held_parameters(self) -> frozenset[str]:
        fitted = {"drive_offset": self.drive_offset == "fit", "intercept": self.fit_intercept}
        return frozenset(f"plays__{name}" for name, is_fitted in fitted.items() if not is_fitted)

    def _plays(self):
        return self.operator_.stages[0]

    def adopt(self, result):
        super().adopt(result)
        zones = self.operator_.stages[1]
        self.dead_zone_thresholds_ = np.array(zones.thresholds)
        self.dead_zone_weights_ = zones.weights
        return self
