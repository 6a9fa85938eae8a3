r"""Prandtl-Ishlinskii model: a weighted sum of plays or of stops, with an exact inverse.

    y = c + sum_k w_k F_k[u - d],    F_k[v](t) = max(v(t) - r_k, min(v(t) + r_k, F_k[v](t-)))

(Steinbusch 2020, equations (3.1) to (3.5), where a_0 is the weight of the threshold zero here). In
the stop form, stops E_k[v] = v - F_k[v] (springs that yield at r_k) replace the plays. That is a
sum of plays with the gain sum_k w_k and the weights -w_k, and it is evaluated as such, from its
turning points (:func:`skhyst.operators.play_sum_run`). The first loading is a piecewise linear
curve with the slopes s_k = w_0 + ... + w_k, and that of the inverse is its mirror image: slopes
1 / s_k, thresholds sum_j w_j max(r_k - r_j, 0) (Kuhnen 2003).
"""

import dataclasses
from functools import cached_property
from numbers import Integral, Real
from typing import Self

import numpy as np
from sklearn.utils.validation import check_array, check_is_fitted

from .._sklearn import Interval, StrOptions
from ..base import ParametricModel, read_data, with_params
from ..operators import (
    CompiledLaw,
    Resolution,
    ScaledWithin,
    Superposition,
    as_constant,
    as_signal,
    parameter,
    parts_with_resolution,
    play_basis,
    play_sum_run,
    play_sum_step,
    play_sum_table,
    play_tangents,
    play_thresholds,
    rate_play_run,
    rate_play_tangents,
    run_records,
    threshold_tangents,
    widened_play_step,
)
from ..records import with_lost_rows
from ._common import as_fine_as_needed, in_direction, show

# Thresholds that are tried for further plays. From one to the next the response of a play changes
# by a hundredth of the drive's span at most; a play that is added then moves to its best position.
_SCAN = 64


class PlaySum(Superposition):
    """Base of the weighted sums of plays: fields ``thresholds``, ``weights``, ``non_negative``."""

    resolution = Resolution("plays", "weights", "thresholds", fixed=0.0)
    drive_offset = 0.0

    def __post_init__(self):
        super().__post_init__()
        r = self.thresholds
        ascending = r.ndim == 1 and r.size and r[0] >= 0.0 and np.all(r[1:] >= r[:-1])
        self._require("thresholds", ascending, "be a list of ascending values, none negative")
        matching = self.weights.shape == r.shape
        self._require("weights", matching, f"have one value for each of the {r.size} thresholds")

    def _mean_threshold(self):
        """Return the mean of the thresholds above zero, weighted, or None without a weight."""
        weights = np.where(self.thresholds > 0.0, self.weights, 0.0)
        return float(weights @ self.thresholds / weights.sum()) if weights.sum() else None

    def finer(self, records):
        """Return thresholds of further plays: a fine grid over the span of the drive."""
        drives = [record.u for record in records]
        return play_thresholds(drives, _SCAN, drive_offset=self.drive_offset)[1:]

    def _moved_plays(self, u, slacks=None, growth=None):
        """Return the derivatives of the plays by their thresholds, (n, n_plays)."""
        slacks = self.thresholds[None] if slacks is None else slacks
        growth = np.ones(1) if growth is None else growth
        out = np.empty((u.size, self.thresholds.size))
        plays = np.zeros(self.thresholds.size)
        threshold_tangents(as_signal(u), as_signal(slacks), as_signal(growth), plays, out)
        return out


@dataclasses.dataclass(frozen=True, eq=False)
class PrandtlIshlinskiiOperator(PlaySum, ScaledWithin):
    """Weighted sum of play or stop operators; :class:`PrandtlIshlinskii` gives the law.

    The time of a run does not depend on the number of plays. The operator is rate-independent:
    ``dt`` is not used.

    Parameters
    ----------
    thresholds, weights : array-like of shape (n_plays,)
        Thresholds in units of the drive, ascending, not negative, fixed structure; weights in
        response/drive. A threshold of zero is a gain, in the stop form a spring that never yields.
    intercept, drive_offset : float, default=0.0
        ``c`` in units of the response; ``d`` in units of the drive.
    non_negative : bool, default=True
        Whether the weights are bounded below by zero when they are identified.
    falling : bool, default=False
        Whether that bound is an upper one: all weights are zero or below, and the response falls
        where the drive rises.
    form : {"play", "stop"}, default="play"
        Whether the weights are those of plays or of stops.

    Raises
    ------
    ValueError
        If the thresholds are negative or do not ascend, there is not one weight per threshold, or
        the form is unknown.

    Notes
    -----
    The state is the tuple (turning points, last drive), less the drive's offset. The turning points
    are nested, the oldest and largest first; there are none during the first loading. ``"rest"`` is
    the state after the first loading from ``drive_offset`` to the first sample, ``"zero"`` the
    state before it. Both give the same output.

    Examples
    --------
    >>> from skhyst.hysteresis import PrandtlIshlinskiiOperator
    >>> operator = PrandtlIshlinskiiOperator(thresholds=[0.0, 1.0], weights=[1.0, 0.5])
    >>> y, state = operator.run([0.0, 4.0, 0.0], dt=1e-3)
    >>> y
    array([0. , 5.5, 0.5])
    >>> u, _ = operator.inverse().run(y, dt=1e-3)
    >>> u
    array([0., 4., 0.])
    """

    thresholds: np.ndarray
    weights: np.ndarray = parameter(linear=True, lower=0.0, unit="response/drive")
    intercept: float = parameter(default=0.0, linear=True, gauge=0.0, unit="response")
    drive_offset: float = parameter(default=0.0, unit="drive")
    non_negative: bool = True
    form: str = "play"
    falling: bool = False

    def __post_init__(self):
        super().__post_init__()
        self._require("form", self.form in ("play", "stop"), "be 'play' or 'stop'")

    @property
    def presliding_displacement(self):
        """Displacement over which the force of stops builds up, units of the drive, or None."""
        return self._mean_threshold() if self.form == "stop" else None

    @cached_property
    def _play_form(self):
        """Thresholds (n,) and weights (n,) as plays, and partial sums of the weights (n + 1,)."""
        r, w = self.thresholds, self.weights
        if self.form == "play":
            return r, w, as_constant(np.concatenate(([0.0], np.cumsum(w))))
        yielding = np.where(r > 0.0, w, 0.0)
        # stiffness of the springs that have not yielded, summed from the end so that it ends at
        # exactly 0
        elastic = np.append(np.cumsum(yielding[::-1])[::-1], 0.0)
        sums = np.concatenate(([0.0], np.sum(w - yielding) + elastic))
        return tuple(map(as_constant, (np.append(0.0, r), np.diff(sums), sums)))

    @cached_property
    def _tables(self):
        thresholds, weights, _ = self._play_form
        return play_sum_table(thresholds, weights)

    def init(self, u0, initial_state="rest"):
        last = float(u0) - self.drive_offset if initial_state == "rest" else 0.0
        return np.empty(0), last

    def run(self, u, dt, state=None):
        u = as_signal(u)
        points, last = state or self.init(u[0] if u.size else self.drive_offset)
        constants = float(self.drive_offset), float(self.intercept)
        y, *state = play_sum_run(u, *constants, self._tables, points, float(last))
        return y, tuple(state)

    def compiled_step(self, dt, state):
        thresholds, weights, _ = self._play_form
        acts = weights != 0.0  # a fit without negative weights leaves many plays at zero
        constants = thresholds[acts], weights[acts], self.intercept, self.drive_offset
        return CompiledLaw(play_sum_step, constants, self._played(thresholds, state)[acts])

    def sensitivities(self, u, du, dt, initial_state="rest"):
        thresholds, weights, sums = self._play_form
        m, n_plays = du.shape[1], thresholds.size
        dy = np.empty((len(u), m + n_plays + 2))
        v = as_signal(u - self.drive_offset)
        play_tangents(v, as_signal(du), thresholds, sums, np.zeros(n_plays), dy)
        y = dy[:, m : m + n_plays] @ weights + self.intercept
        if self.form == "stop":
            plays = dy[:, m + 1 : m + n_plays]
            np.subtract(v[:, None], plays, out=plays, where=self.thresholds > 0.0)
            dy = np.delete(dy, m, axis=1)
        return y, dy

    def position_tangents(self, u, dt, initial_state="rest"):
        sign = np.where((self.form == "stop") & (self.thresholds > 0.0), -1.0, 1.0)
        return self._moved_plays(as_signal(u) - self.drive_offset) * (sign * self.weights)

    scaled_within = ("thresholds",)

    def scaled_init(self, u0, factor, initial_state="rest"):
        slacks = factor * self._play_form[0]
        if initial_state == "zero":
            return np.zeros(slacks.size)
        v = float(u0) - self.drive_offset
        return np.clip(0.0, v - slacks, v + slacks)

    def scaled_run(self, u, factor, dt, state):
        """Return the output with all thresholds scaled by a factor that changes with time.

        ``F[k] = max(u[k] - q[k] r, min(u[k] + q[k] r, F[k - 1]))``: a play stays where it is, until
        an end of its slack, which the drive and the factor q move, takes it along. For a constant
        factor this is a sum of plays with other thresholds.
        """
        thresholds, weights, _ = self._play_form
        zeros, plays, y = as_constant(np.zeros(weights.size)), np.array(state), np.empty(len(u))
        signals = as_signal(u - self.drive_offset), as_signal(factor)
        rate_play_run(*signals, zeros, thresholds, weights, zeros, plays, y)
        return y + self.intercept, plays

    def scaled_step(self, dt, state):
        thresholds, weights, _ = self._play_form
        constants = thresholds, weights, self.intercept, self.drive_offset
        return CompiledLaw(widened_play_step, constants, state, n_inputs=2)

    def scaled_sensitivities(self, u, du, factor, dfactor, dt, initial_state="rest"):
        thresholds, weights, _ = self._play_form
        (n, m), n_own, n_plays = du.shape, dfactor.shape[1] - du.shape[1], thresholds.size
        v, zeros = as_signal(u - self.drive_offset), as_constant(np.zeros(n_plays))
        both = (
            np.column_stack([du, -np.ones(n), np.zeros((n, n_own))]),
            np.column_stack([dfactor[:, :m], np.zeros(n), dfactor[:, m:]]),
        )
        dy = np.empty((n, m + 1 + n_own + n_plays))
        du, dfactor = map(as_signal, both)
        signals = v, du, as_signal(factor), dfactor
        rate_play_tangents(*signals, zeros, thresholds, weights, zeros, np.zeros(n_plays), dy)
        propagated, offset, by_factor, plays = np.split(dy, [m, m + 1, m + 1 + n_own], axis=1)
        y = plays @ weights + self.intercept
        if self.form == "stop":
            plays = np.where(self.thresholds > 0.0, v[:, None] - plays[:, 1:], plays[:, 1:])
        return y, np.column_stack([propagated, plays, np.ones(n), offset, by_factor])

    def characteristics(self, seen):
        """Return the width of the major loop over the range of the input, in % of its height."""
        low, high = seen.ends
        rise = np.linspace(low, high, 400)
        y = self.run(np.concatenate([np.linspace(0.0, low, 400), rise, rise[::-1], rise]), 1.0)[0]
        down, up = y[800:1200][::-1], y[1200:]
        width = 100.0 * np.abs(up - down).max() / np.ptp([up, down])
        return {"loop width over the range": (width, "%")}

    def plays(self, state):
        """Return the values of the plays in a state, less the offset of the drive.

        Parameters
        ----------
        state : tuple
            As :meth:`init` and :meth:`run` return it.

        Returns
        -------
        ndarray of shape (n_plays,)
            Units of the drive.
        """
        return self._played(self.thresholds, state)

    @staticmethod
    def _played(thresholds, state):
        plays = np.zeros(thresholds.size)
        path = as_signal(np.append(*state))
        play_basis(path, thresholds, plays, np.empty((path.size, plays.size)))
        return plays

    def state_from_plays(self, plays, u):
        """Return the state in which the plays have given values.

        Parameters
        ----------
        plays : array-like of shape (n_plays,)
            As :meth:`plays` returns them.
        u : float
            Drive.

        Returns
        -------
        tuple
            The state.

        Raises
        ------
        ValueError
            If no history of the drive leads to these plays: neighbours differ by more than their
            thresholds, or a play is further from the drive than its threshold.
        """
        plays = np.asarray(plays, dtype=float)
        v = float(u) - self.drive_offset
        reachable = plays.shape == self.thresholds.shape
        if reachable:
            slack = np.diff(self.thresholds, prepend=0.0)
            slack += 1e-12 * (np.abs(plays).max() + self.thresholds[-1])
            reachable = np.all(np.abs(np.diff(plays, prepend=v)) <= slack)
        if not reachable:
            raise ValueError(
                "The 'plays' parameter of PrandtlIshlinskiiOperator.state_from_plays must be "
                "reachable: neighbours may differ by the difference of their thresholds at most. "
                f"Got {plays!r} at the drive {u!r} instead."
            )
        # From the widest play inwards, visit both ends of its slack; narrower plays are set later.
        path = np.ravel(np.column_stack((plays + self.thresholds, plays - self.thresholds))[::-1])
        return self.run(np.append(path, v) + self.drive_offset, 1.0, (np.empty(0), 0.0))[1]

    def inverse(self):
        """Return the exact inverse: an operator from response to drive, in the play form.

        Raises
        ------
        ValueError
            If the first threshold is not zero (the operator has a dead zone after each reversal)
            or the partial sums of the weights are not of one sign (the response is not monotone).
        """
        thresholds, _, sums = self._play_form
        sign = -1.0 if sums[-1] + sums[1] < 0.0 else 1.0  # a response that falls is mirrored
        slopes = sign * sums[1:]
        if thresholds[0] != 0.0 or not np.all(slopes > 0.0):
            needs = (
                "sums w_0 + ... + w_k of the weights"
                if self.form == "play"
                else "at each threshold sums of the stiffnesses that have not yielded"
            )
            raise ValueError(
                "PrandtlIshlinskiiOperator has no inverse: its response must be strictly monotone, "
                f"with a first threshold of 0 and {needs} of one sign. Got the first threshold "
                f"{self.thresholds[0]:g} and the smallest sum {slopes.min():g} instead."
            )
        steps = np.diff(thresholds) * slopes[:-1]
        return PrandtlIshlinskiiOperator(
            thresholds=np.concatenate(([0.0], np.cumsum(steps))),
            weights=sign * np.diff(1.0 / slopes, prepend=0.0),
            intercept=self.drive_offset,
            drive_offset=self.intercept,
            non_negative=False,
        )

    def inverse_state(self, state):
        """Return the state of :meth:`inverse` that belongs to a state of this operator.

        Parameters
        ----------
        state : tuple
            Of this operator.

        Returns
        -------
        tuple
            Of the inverse.
        """
        path = np.append(*state) + self.drive_offset
        y = self.run(path, 1.0, (np.empty(0), 0.0))[0] - self.intercept
        return y[:-1], float(y[-1])


def place_thresholds(thresholds, records, n_operators, n_left_out=0):
    """Return the given thresholds, or those of a rule by name without the first ``n_left_out``."""
    if isinstance(thresholds, str):
        thresholds = "grid" if thresholds == "auto" else thresholds  # to begin with
        drives = [record.u for record in records]
        return play_thresholds(drives, n_operators + n_left_out, thresholds)[n_left_out:]
    return check_array(thresholds, ensure_2d=False, dtype=np.float64)


class PlayModel(ParametricModel):
    """Base of the models that contain a weighted sum of plays and have an inverse.

    Parameters
    ----------
    n_operators : int, default=20
        Number of operators; ignored if ``thresholds`` is an array.
    thresholds : {"grid", "quantile"} or array-like of shape (n_operators,), default="grid"
        Thresholds (at rest): evenly spaced over the half range of the drive, by quantiles of the
        drive's swings, or given, in units of the drive.
    non_negative : bool, default=True
        Whether all weights (at rest) have the same sign, so that the model dissipates: none is
        below zero, or none above if the data show that the response falls as the drive rises.
    drive_offset : float or "fit", default=0.0
        Drive from which the virgin device is first loaded, units of the drive.
    fit_intercept : bool, default=True
        Whether the sum of plays has a constant.

    Attributes
    ----------
    thresholds_, weights_ : ndarray of shape (n_operators,)
        Thresholds (units of the drive) and weights (response/drive), at rest.
    intercept_ : float
        Constant of the sum of plays, units of the response.
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "n_operators": [Interval(Integral, 1, None, closed="left")],
        "thresholds": [StrOptions({"grid", "quantile"}), "array-like"],
        "non_negative": ["boolean"],
        "fit_intercept": ["boolean"],
    }

    def _plays(self):
        """Return the sum of plays in the identified operator."""
        return self.operator_

    def resolved(self, operator) -> Self:
        thresholds = parts_with_resolution(operator)[0][1].thresholds.tolist()
        return with_params(self, n_operators=len(thresholds), thresholds=thresholds)

    def adopt(self, result):
        super().adopt(result)
        show(self, self._plays(), "thresholds", "weights", "intercept")
        return self

    def inverse_predict(self, X) -> np.ndarray:
        """Return the drive that makes the response follow column 0 of ``X``.

        The inverse is exact (Kuhnen 2003), except for thresholds or weights that depend on the rate
        of the drive. The rates are then found by fixed-point iteration as long as that brings the
        response closer to ``X``, and a small error remains where they change fast. Check
        ``predict`` of the result.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            Column 0 is the desired response, in its units; the index carries the records.

        Returns
        -------
        ndarray of shape (n_samples,)
            Drive.

        Raises
        ------
        ValueError
            If the model is not strictly monotone: the threshold zero must have a positive weight.
        """
        check_is_fitted(self)
        slices, X, _ = read_data(self, X, reset=False, bridge=True)
        slices, X, read = with_lost_rows(slices, X)
        drive = run_records(self.operator_.inverse(), X[:, 0], slices, self.free_run_state)
        return drive if read is None else drive[read]


class PrandtlIshlinskii(PlayModel):
    r"""Prandtl-Ishlinskii model of rate-independent hysteresis.

    .. math:: y = c + \sum_k w_k F_{r_k}[u - u_0], \quad
       F_r[u](t) = \max(u(t) - r, \min(u(t) + r, F_r[u](t^-)))

    (Steinbusch 2020, (3.1) to (3.6)). With ``form="stop"``, stops :math:`E_r[v] = v - F_r[v]`,
    springs that yield at r, replace the plays with a threshold above zero. The weights
    and the intercept are solved exactly by (non-negative) least squares; no starting values are
    needed.

    Parameters
    ----------
    thresholds : {"auto", "grid", "quantile"} or array-like of shape (n_operators,), default="grid"
        Thresholds: evenly spaced over the half range of the drive, by quantiles of the drive's
        swings, or given, in units of the drive. "auto": the number and positions that predict best
        out of fold, found by exchange from ``n_operators`` on a grid (sliding conditional
        gradient). In a composition, for the step's own input.
    form : {"auto", "play", "stop"}, default="auto"
        Superposition of plays or of stops. It matters with ``non_negative``: plays
        then give counter-clockwise loops (displacement over voltage), stops clockwise ones (force
        over displacement). "auto": plays, unless the data show stops; the ``form`` of ``operator_``
        is the choice. Without ``non_negative`` "auto" is "play".

    See Also
    --------
    ModifiedPrandtlIshlinskii : Loops that are asymmetric or saturate.
    RateDependentPrandtlIshlinskii : Loops that grow with the rate of the drive.
    skhyst.preprocessing.PlayOperators : The plays as features for any regressor.

    References
    ----------
    Steinbusch, *Hysteresis and Dynamics Compensation for Accurate Positioning in High Speed Piezo
    Scanning Stages*, 2020, section 3.2. Kuhnen, *European Journal of Control*, 2003. Denoyelle
    et al., *Inverse Problems*, 2020.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import PrandtlIshlinskii, PrandtlIshlinskiiOperator
    >>> drive = np.sin(np.linspace(0, 20, 500)) * np.linspace(0, 1, 500)
    >>> X = drive.reshape(-1, 1)
    >>> y = PrandtlIshlinskii(n_operators=4).fit(X, drive).predict(X)
    >>> bool(np.allclose(y, drive))
    True

    As many plays as the data ask for, where they are:

    >>> y, _ = PrandtlIshlinskiiOperator([0.0, 0.13, 0.4], [1.0, 0.5, 0.7]).run(drive, 1.0)
    >>> PrandtlIshlinskii(thresholds="auto").fit(X, y).thresholds_.round(6)
    array([0.  , 0.13, 0.4 ])
    """

    _parameter_constraints = {
        **PlayModel._parameter_constraints,
        "thresholds": [StrOptions({"auto", "grid", "quantile"}), "array-like"],
        "form": [StrOptions({"auto", "play", "stop"})],
        "drive_offset": [Interval(Real, None, None, closed="neither"), StrOptions({"fit"})],
    }

    operator_class = PrandtlIshlinskiiOperator
    any_interval = True

    def __init__(
        self,
        n_operators=20,
        *,
        form="auto",
        thresholds="grid",
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
        self.form = form
        self.thresholds = thresholds
        self.non_negative = non_negative
        self.drive_offset = drive_offset
        self.fit_intercept = fit_intercept

    def starting_values(self, records):
        thresholds = place_thresholds(self.thresholds, records, self.n_operators)
        offset = 0.0 if self.drive_offset == "fit" else self.drive_offset
        both = self.form == "auto" and self.non_negative
        forms = ("play", "stop") if both else (self.form.replace("auto", "play"),)
        starts = [
            PrandtlIshlinskiiOperator(
                thresholds, np.zeros(len(thresholds)), 0.0, offset, self.non_negative, form
            )
            for form in forms
        ]
        fixed, state = self.held_parameters(), self.free_run_state
        starts = in_direction(starts, records, fixed | {"drive_offset"}, state)
        if self.moves_positions:
            return as_fine_as_needed(starts, records, fixed, state)
        return starts

    @property
    def moves_positions(self):
        """Whether the thresholds are found."""
        return isinstance(self.thresholds, str) and self.thresholds == "auto"

    def held_parameters(self) -> frozenset[str]:
        held = super().held_parameters()
        return held if self.drive_offset == "fit" else held | {"drive_offset"}
