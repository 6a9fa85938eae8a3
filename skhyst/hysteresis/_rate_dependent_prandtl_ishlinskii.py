r"""Prandtl-Ishlinskii model whose loops widen, or tilt, with the rate of the drive.

    y = c + sum_k (w_k + s_k |u'|) F_k[u],    F_k a play of the threshold r_k + beta |u'|

with growing thresholds (Al Janaideh and Krejci 2013) or rate weights s_k (Ang, Khosla and Riviere
2007). The rate at a sample is that of the straight line that leads to it. Threshold and drive are
straight lines between samples, so the ends of the slack are too, and a play, which lies between
them at the start, is moved by one of them at most: clipping it to their last values is exact. A
threshold of zero is the plain gain and does not grow.
"""

import dataclasses

import numpy as np
from scipy.ndimage import uniform_filter1d

from .._jit import jit
from .._sklearn import StrOptions
from ..operators import as_signal, clip_play, parameter
from ._common import fastest_change, show, swing
from ._prandtl_ishlinskii import PlayModel, PlaySum, place_thresholds

_PASSES = 40  # of the inverse with one window, at most
_GAIN = 0.99  # part of the error that a pass must leave at most, for another one
_RESERVE = 0.9  # of the rate at which the response is no longer monotone
_GROWTHS = np.geomspace(0.003, 0.3, 5)  # of a threshold at the highest rate, over the half range


@jit
def rate_play_run(u, rates, thresholds, growth, weights, rate_weights, plays, out):
    """Write ``sum_k (w_k + s_k rate) F_k[u]`` to ``out`` (n,); ``plays`` (K,) is updated.

    ``rates`` (n,) are not negative; ``growth`` of the thresholds and ``rate_weights`` are (K,).
    """
    n_plays = thresholds.size
    for i in range(u.size):
        value = u[i]
        rate = rates[i]
        for k in range(n_plays):
            slack = thresholds[k] + growth[k] * rate
            plays[k] = clip_play(plays[k], value - slack, value + slack)
        total = 0.0
        for k in range(n_plays):
            total += (weights[k] + rate * rate_weights[k]) * plays[k]
        out[i] = total


@jit
def rate_play_inverse(y, rates, thresholds, growth, weights, rate_weights, plays, out):
    """Write to ``out`` (n,) the drive whose :func:`rate_play_run` is ``y`` at the given rates.

    The first threshold is zero and does not grow; the sums of the first weights are positive at
    all rates; growth is the same for all other plays. The response is then a rising function of
    the drive, straight between the values at which one play after the other starts to move: these
    are passed in order, upwards or downwards. ``plays`` (K,) is updated.
    """
    n_plays = thresholds.size
    for i in range(y.size):
        rate = rates[i]
        rest = y[i]
        for k in range(1, n_plays):
            rest -= (weights[k] + rate * rate_weights[k]) * plays[k]
        slope = weights[0] + rate * rate_weights[0]
        value = rest / slope
        sign = 0.0
        for k in range(1, n_plays):
            slack = thresholds[k] + growth[k] * rate
            if sign >= 0.0 and value > plays[k] + slack:
                sign = 1.0
            elif sign <= 0.0 and value < plays[k] - slack:
                sign = -1.0
            else:
                break
            weight = weights[k] + rate * rate_weights[k]
            slope += weight
            rest += weight * (plays[k] + sign * slack)
            value = rest / slope
        for k in range(n_plays):
            slack = thresholds[k] + growth[k] * rate
            plays[k] = clip_play(plays[k], value - slack, value + slack)
        out[i] = value


@jit
def rate_play_tangents(u, du, rates, drates, thresholds, growth, weights, rate_weights, plays, out):
    """Write to ``out`` (n, m + K) the tangents carried through by the plays, and the plays.

    ``du`` (n, m) are the tangents of the drive, ``drates`` (n, m) those of the rates, which act
    by the thresholds here, not by the weights. ``plays`` (K,) is updated. A play that moves takes
    over the tangent of the end of its slack; one that sticks keeps the one it took last.
    """
    m = du.shape[1]
    tangents = np.zeros((thresholds.size, m))
    for i in range(u.size):
        value = u[i]
        rate = rates[i]
        row = out[i]
        row[:m] = 0.0
        for k in range(thresholds.size):
            slack = thresholds[k] + growth[k] * rate
            play = plays[k]
            sign = 0.0
            if value - slack >= play:
                play = value - slack
                sign = -1.0
            elif value + slack <= play:
                play = value + slack
                sign = 1.0
            plays[k] = play
            row[m + k] = play
            weight = weights[k] + rate * rate_weights[k]
            for j in range(m):
                if sign != 0.0:
                    tangents[k, j] = du[i, j] + sign * growth[k] * drates[i, j]
                row[j] += weight * tangents[k, j]


@dataclasses.dataclass(frozen=True, eq=False)
class RateDependentPrandtlIshlinskiiOperator(PlaySum):
    """Weighted sum of plays, as in :class:`RateDependentPrandtlIshlinskii`.

    Parameters
    ----------
    thresholds, weights : array-like of shape (n_plays,)
        At rest: units of the drive, ascending, not negative, fixed structure; response/drive.
    rate_weights : array-like of shape (n_plays,) or (0,), default=()
        Change of the weights with the rate in response s/drive^2; empty: none, and not identified.
    intercept : float, default=0.0
        In units of the response.
    dilation : float, default=0.0
        Growth of the thresholds with the rate, in s; zero: none, and not identified.
    non_negative : bool, default=True
        Whether the weights at rest are bounded below by zero when they are identified.

    Raises
    ------
    ValueError
        If the thresholds are negative or do not ascend, or there is not one weight for each.

    Notes
    -----
    The state is a tuple of the plays (n_plays,) and the last drive. ``"rest"`` is a first loading
    from zero, infinitely slow.

    Examples
    --------
    >>> from skhyst.hysteresis import RateDependentPrandtlIshlinskiiOperator
    >>> operator = RateDependentPrandtlIshlinskiiOperator([0.0, 1.0], [1.0, 0.5], dilation=0.1)
    >>> operator.run([0.0, 4.0, 0.0], dt=1.0)[0]
    array([0. , 5.3, 0.7])
    >>> operator.run([0.0, 4.0, 0.0], dt=1e9)[0]
    array([0. , 5.5, 0.5])
    """

    thresholds: np.ndarray
    weights: np.ndarray = parameter(linear=True, lower=0.0, unit="response/drive")
    rate_weights: np.ndarray = parameter(default=(), linear=True, unit="response s/drive^2")
    intercept: float = parameter(default=0.0, linear=True, gauge=0.0, unit="response")
    dilation: float = parameter(default=0.0, log=True, lower=0.0, unit="s")
    non_negative: bool = True

    def __post_init__(self):
        super().__post_init__()
        size = self.thresholds.size
        matching = self.rate_weights.shape in {(0,), (size,)}
        wanted = f"have one value for each of the {size} thresholds, or none"
        self._require("rate_weights", matching, wanted)

    def parameter_specs(self):
        """Return the identifiable fields; without ``dilation`` where it is zero."""
        specs = super().parameter_specs()
        if self.dilation == 0.0:
            del specs["dilation"]
        return specs

    @property
    def _grows(self):
        return (self.thresholds > 0.0).astype(float)

    def _arguments(self):
        rate_weights = self.rate_weights if self.rate_weights.size else np.zeros_like(self.weights)
        return self.thresholds, self.dilation * self._grows, self.weights, rate_weights

    def init(self, u0, initial_state="rest"):
        """Return the state before the first sample ``u0``: plays (n_plays,) and last drive."""
        last = float(u0) if initial_state == "rest" else 0.0
        return np.clip(0.0, last - self.thresholds, last + self.thresholds), last

    def run(self, u, dt, state=None):
        u = as_signal(u)
        y = np.empty(u.size)
        plays, last = self.init(u[0] if u.size else 0.0) if state is None else state
        plays = plays.copy()
        rates = np.abs(np.diff(u, prepend=last)) / dt
        rate_play_run(u, rates, *self._arguments(), plays, y)
        y += self.intercept
        return y, (plays, float(u[-1]) if u.size else last)

    def linearize(self, u, du, dt, initial_state="rest"):
        u, du = as_signal(u), as_signal(du)
        state = self.init(u[0] if u.size else 0.0, initial_state)
        y, _ = self.run(u, dt, state)
        # the first sample is the first loading, so that its tangents are those of a sample
        steps = np.diff(u, prepend=state[1])
        before = du[:1] if initial_state == "rest" else np.zeros((1, du.shape[1]))
        drates = np.diff(du, axis=0, prepend=before[: len(du)]) * (np.sign(steps) / dt)[:, None]
        rates, m = np.abs(steps) / dt, du.shape[1]
        if self.dilation:  # a threshold grows by ``growth * rate``, so this is one tangent more
            drive = np.column_stack((du, np.zeros(u.size)))
            speed = np.column_stack((drates, rates / self.dilation))
        else:
            drive, speed = du, drates
        arguments = self._arguments()
        out = np.empty((u.size, drive.shape[1] + self.thresholds.size))
        start = np.zeros(self.thresholds.size)
        rate_play_tangents(u, as_signal(drive), rates, as_signal(speed), *arguments, start, out)
        plays = out[:, drive.shape[1] :]
        carried = out[:, :m] + (plays @ arguments[-1])[:, None] * drates
        scaled = rates[:, None] * plays[:, : self.rate_weights.size]
        ones = np.ones((u.size, 1))
        return y, np.hstack((carried, plays, scaled, ones, out[:, m : drive.shape[1]]))

    def characteristics(self, seen):
        """Return how much the loop grows at the rate that a tenth of the samples exceed."""
        fast = np.quantile(seen.rates, 0.9)
        change = self.dilation or np.sum(self.rate_weights) / np.sum(self.weights)
        growth = 100.0 * change * fast / (0.5 * np.ptp(seen.ends) if self.dilation else 1.0)
        return {"growth at fast motion": (growth, "%"), "fast motion": (fast, "drive/s")}

    def drive_at_rates(self, y, rates, plays=None):
        """Return the drive (n_samples,) under which the response is ``y``, its rates being known.

        Parameters
        ----------
        y, rates : array-like of shape (n_samples,)
            Response, and sizes of the drive's rates, units of the drive over s.
        plays : ndarray of shape (n_plays,), optional
            The plays before the first sample; by default they are zero.

        Raises
        ------
        ValueError
            If the response is not a strictly monotone function of the drive at one of the rates.
        """
        y, rates = as_signal(np.asarray(y) - self.intercept), as_signal(rates)
        thresholds, growth, weights, rate_weights = self._arguments()
        fastest = rates.max(initial=0.0)
        sums = np.cumsum(weights), np.cumsum(weights + fastest * rate_weights)
        least = np.min(sums)
        if thresholds[0] != 0.0 or not least > 0.0:
            raise ValueError(
                "RateDependentPrandtlIshlinskiiOperator.drive_at_rates needs a first threshold of "
                "0 and positive sums of the first weights at all rates: the response must be "
                f"strictly monotone. Got thresholds[0]={thresholds[0]!r} and the smallest sum "
                f"{least!r} instead."
            )
        u = np.empty(y.size)
        plays = np.zeros(thresholds.size) if plays is None else plays.copy()
        rate_play_inverse(y, rates, thresholds, growth, weights, rate_weights, plays, u)
        return u

    def inverse_run(self, y, dt, initial_state="rest"):
        """Return a drive (n_samples,) that makes the response follow ``y``.

        With the rates known, the inverse is exact (Al Janaideh and Krejci 2013). Here the rates are
        those of the drive that is sought, which is found by repetition, beginning with the inverse
        at rest, as long as the response comes closer to ``y``. Repetition amplifies fast changes
        of the rate, so the rates are smoothed over windows of time, ever smaller ones: what is left
        is small where thresholds or weights change little within the smallest window that
        converges, but it is not zero.

        Parameters
        ----------
        y : array-like of shape (n_samples,)
            Desired response, from the ``initial_state`` on.
        dt : float
            Sampling interval in s.
        initial_state : {"rest", "zero"}
            As in :meth:`init`.
        """
        y = as_signal(y)
        fastest = self._fastest_monotone()

        def advance(rates):
            u = self.drive_at_rates(y, np.minimum(rates, fastest))
            return u, np.linalg.norm(self.run(u, dt, self.init(u[0], initial_state))[0] - y)

        best, smallest = advance(np.zeros(y.size))
        for half in [*(2 ** np.arange(max(y.size // 4, 1).bit_length())[::-1]), 0]:
            u = best
            for _ in range(_PASSES):
                rates = np.abs(uniform_filter1d(np.diff(u, prepend=u[0]), 2 * half + 1)) / dt
                if initial_state == "zero":
                    rates[0] = np.abs(u[0]) / dt
                u, error = advance(rates)
                gained = error < _GAIN * smallest
                if error < smallest:
                    best, smallest = u, error
                if not gained:
                    break
        return best

    def _fastest_monotone(self):
        """Return a rate up to which the response is a strictly monotone function of the drive."""
        falls = -np.cumsum(self.rate_weights)
        slopes = np.cumsum(self.weights)[: falls.size]
        falling = falls > 0.0
        return _RESERVE * np.min(slopes[falling] / falls[falling], initial=np.inf)


class RateDependentPrandtlIshlinskii(PlayModel):
    r"""Prandtl-Ishlinskii model that depends on the rate of the drive.

    With ``variant="threshold"`` (Al Janaideh and Krejci 2013) all thresholds but the one at zero
    grow with the rate, and loops widen:

    .. math:: y = c + \sum_k w_k F_{r_k(t)}[u], \quad r_k(t) = r_k + \beta |u'(t)|

    With ``variant="slope"`` (Ang, Khosla and Riviere 2007) the weights change with the rate, and
    loops tilt:

    .. math:: y = c + \sum_k (w_k + s_k |u'(t)|) F_{r_k}[u]

    The size of the rate counts, so that a model without intercept stays odd. The rate at a
    sample is that of the straight line that leads to it. All parameters but :math:`\beta` are
    solved exactly by least squares.

    Parameters
    ----------
    variant : {"threshold", "slope"}, default="threshold"
        What follows the rate.

    Attributes
    ----------
    rate_weights_ : ndarray of shape (n_operators,) or (0,)
        Change of the weights with the rate (``variant="slope"``).
    dilation_ : float
        Growth of the thresholds with the rate, in s; 0 with ``variant="slope"``.

    References
    ----------
    M. Al Janaideh and P. Krejci, "Inverse rate-dependent Prandtl-Ishlinskii model for feedforward
    compensation of hysteresis in a piezomicropositioning actuator", IEEE/ASME Trans. Mechatronics
    18(5), 2013. W. T. Ang, P. K. Khosla and C. N. Riviere, "Feedforward controller with inverse
    rate-dependent model for piezoelectric actuators in trajectory-tracking applications",
    IEEE/ASME Trans. Mechatronics 12(2), 2007.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import RateDependentPrandtlIshlinskii
    >>> from skhyst.hysteresis import RateDependentPrandtlIshlinskiiOperator
    >>> truth = RateDependentPrandtlIshlinskiiOperator([0.0, 0.3], [1.0, 0.5], dilation=0.02)
    >>> drive = np.sin(np.linspace(0, 8, 500) ** 2)
    >>> y, _ = truth.run(drive, 0.01)
    >>> model = RateDependentPrandtlIshlinskii(thresholds=[0.0, 0.3], dt=0.01)
    >>> round(model.fit(drive.reshape(-1, 1), y).dilation_, 6)
    0.02
    """

    _parameter_constraints = {
        **PlayModel._parameter_constraints,
        "variant": [StrOptions({"threshold", "slope"})],
    }

    operator_class = RateDependentPrandtlIshlinskiiOperator

    def __init__(
        self,
        n_operators=20,
        *,
        variant="threshold",
        thresholds="grid",
        non_negative=True,
        fit_intercept=True,
        initial_state="rest",
        dt=1.0,
        method="variable_projection",
    ):
        super().__init__(initial_state=initial_state, dt=dt, method=method)
        self.n_operators = n_operators
        self.variant = variant
        self.thresholds = thresholds
        self.non_negative = non_negative
        self.fit_intercept = fit_intercept

    def starting_values(self, records):
        thresholds = place_thresholds(self.thresholds, records, self.n_operators)
        zeros = np.zeros(len(thresholds))
        if self.variant == "slope":
            rates, dilations = zeros, [0.0]
        else:
            rates, dilations = (), self._dilations(records)
        kind, options = RateDependentPrandtlIshlinskiiOperator, {"non_negative": self.non_negative}
        return [
            kind(thresholds, zeros, rates, dilation=float(dilation), **options)
            for dilation in dilations
        ]

    @staticmethod
    def _dilations(records):
        """Return growths with which a threshold changes by a part of the drive's half range."""
        fastest = fastest_change(records)
        return _GROWTHS * (0.5 * swing(records) / fastest if fastest > 0.0 else records[0].dt)

    def _adopt(self, result):
        super()._adopt(result)
        show(self, self.operator_, "rate_weights", "dilation")
        return self

    def _invert(self, y, slices):
        inverse, state = self.operator_.inverse_run, self._free_run_state()
        return np.concatenate([inverse(y[r.rows], r.dt, state) for r in slices])
