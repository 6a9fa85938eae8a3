r"""Prandtl-Ishlinskii model whose loops widen, or tilt, with the rate of the drive.

    y = c + sum_k (w_k + s_k v) F_k[u],    F_k a play of the threshold r_k (1 + kappa v) + beta v

with growing thresholds (Al Janaideh and Krejčí 2013) or rate weights s_k (Ang, Khosla and Riviere
2007). The rate v is |u'|, a first-order low-pass of |u'|, or the magnitude of a low-pass of u'. At
a sample u' is the slope of the straight line that ends there, for which the low-pass is exact.
Threshold and drive are straight lines between samples, so the ends of the slack are too, and a
play, which lies between them at the start, is moved by at most one of them: clipping it to their
last values is exact. A threshold of zero is a gain and does not grow. All others stay positive and
in order at any rate, since neither kappa nor beta is negative.

For known rates the inverse is exact (Al Janaideh and Krejčí 2013). Here the rates are those of the
unknown drive, which is found by fixed-point iteration, starting from the inverse at zero rate, as
long as the response comes closer. The iteration amplifies fast changes of the rate, as solving each
sample for its root would, so the rates are smoothed over windows of time that shrink.

The remaining error is reduced by damped least squares over overlapping blocks of the record. Only
the first half of each block is kept, since later samples of the response determine the drive too.
Damping (Levenberg, *Quarterly of Applied Mathematics*, 1944) limits the amplification of noise to
its inverse. Where the motion reverses, the response as a function of the drive has a corner at the
last drive: there may be no drive for a given response, and a part of the error remains.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter

from .._jit import jit
from .._sklearn import StrOptions
from ..operators import (
    CompiledLaw,
    InverseOperator,
    as_signal,
    clip_play,
    parameter,
    rate_play_run,
    rate_play_sample,
    rate_play_tangents,
)
from ._common import in_direction, largest_peak_to_peak, show
from ._prandtl_ishlinskii import PlayModel, PlaySum, place_thresholds


@jit
def rate_play_step(u, c, s):
    """Return the response at one sample; ``s`` is the plays, the last drive and the low-pass.

    ``c`` is (thresholds, growth, weights, rate_weights, intercept, dt, pole and input gain of the
    low-pass, whether the rate enters it with its sign).
    """
    thresholds, growth, weights, rate_weights, intercept, dt, fade, gain, signed = c
    n = thresholds.size
    velocity = (u - s[n]) / dt
    smooth = gain * (velocity if signed > 0.0 else abs(velocity)) + fade * s[n + 1]
    s[n], s[n + 1] = u, smooth
    rate = abs(smooth)
    y = rate_play_sample(u, rate, thresholds, growth, weights, rate_weights, s)
    return y + intercept


@jit
def rate_play_inverse(y, rates, thresholds, growth, weights, rate_weights, plays, out):
    """Write to ``out`` (n,) the drive whose :func:`rate_play_run` is ``y`` at the given rates.

    The first threshold is zero and does not grow. The response increases with the drive whichever
    plays move, and is linear between the drives at which a play starts to move. Newton's method
    goes from one such piece to another, within a bracket, until it stays. ``plays`` (K,) is
    updated.
    """
    for i in range(y.size):
        rate = rates[i]
        value, low, high = plays[0], -np.inf, np.inf
        while True:
            slope = offset = 0.0
            for k in range(thresholds.size):
                slack = thresholds[k] + growth[k] * rate
                weight = weights[k] + rate * rate_weights[k]
                if value - slack >= plays[k]:
                    slope += weight
                    offset -= weight * slack
                elif value + slack <= plays[k]:
                    slope += weight
                    offset += weight * slack
                else:
                    offset += weight * plays[k]
            goal = (y[i] - offset) / slope
            if goal > value:
                low = value
            elif goal < value:
                high = value
            else:
                break
            if not low < goal < high:
                goal = 0.5 * (low + high)
                if not low < goal < high:  # no number left between the ends of the bracket
                    break
            value = goal
        for k in range(thresholds.size):
            slack = thresholds[k] + growth[k] * rate
            plays[k] = clip_play(plays[k], value - slack, value + slack)
        out[i] = value


_PASSES = 40  # most iterations of the inverse with one window
_GAIN = 0.99  # factor by which an iteration must reduce the error to be followed by another
_ENOUGH = 1e-12  # error over the range of the response at which the least squares stop
# samples per block; with a zero at 1.1 an error at its end decays to 1e-8 in the first half
_BLOCK = 400
_DIFFERENCE = 1e-7  # finite difference over the drive's range: a few times the root of rounding
_DAMPING = 1e-4  # least damping, over the root mean square slope
_STEPS, _TRIALS = 20, 8  # most steps of the least squares; most dampings per step


@dataclass(frozen=True)
class RateDependentInverseOperator(InverseOperator):
    """Inverse of rate-dependent plays: from the response to a drive that gives it."""

    causal = False

    def init(self, u0, initial_state="rest"):
        """Return the name of the initial state: a record is inverted in one pass; see the base."""
        return initial_state

    def run(self, u, dt, state=None):
        """Return the drive (n_samples,) whose response is ``u``; see the base."""
        y, plays, initial_state = as_signal(u), self.operator, state or "rest"
        fastest = plays.fastest_monotone()

        def advance(rates):
            drive = plays.drive_at_rates(y, np.minimum(rates, fastest))
            back, _ = plays.run(drive, dt, plays.init(drive[0], initial_state))
            return drive, np.linalg.norm(back - y)

        best, smallest = advance(np.zeros(y.size))
        # from rates averaged over about half the record to those of single intervals: each window
        # starts from the best drive so far, close enough for the iteration to converge
        for half in [*(2 ** np.arange(max(y.size // 4, 1).bit_length())[::-1]), 0]:
            drive = best
            for _ in range(_PASSES):
                velocities = uniform_filter1d(np.diff(drive, prepend=drive[0]), 2 * half + 1) / dt
                if initial_state == "zero":
                    velocities[0] = drive[0] / dt
                drive, error = advance(plays.paces(velocities, dt)[0])
                improved = error < _GAIN * smallest
                if error < smallest:
                    best, smallest = drive, error
                if not improved:
                    break
        return self._polished(best, y, dt, plays.init(best[0], initial_state)), None

    def _polished(self, drive, y, dt, state):
        """Return a drive (n_samples,) with a smaller error, improved in overlapping blocks."""
        drive, enough = drive.copy(), _ENOUGH * np.ptp(y)
        for begin in range(0, len(y), _BLOCK // 2):
            part = slice(begin, begin + _BLOCK)
            is_last = part.stop >= len(y)
            drive[part] = self._improved(drive[part], y[part], dt, state, enough)
            _, state = self.operator.run(drive[begin : begin + _BLOCK // 2], dt, state)
            if is_last:
                break
        return drive

    def _improved(self, drive, y, dt, state, enough):
        """Return a drive (n,) with a smaller sum of squared errors, by damped least squares."""

        def residual(u):
            return self.operator.run(u, dt, state)[0] - y

        error, change, damping = residual(drive), _DIFFERENCE * (np.ptp(drive) or 1.0), _DAMPING
        for _ in range(_STEPS):
            if np.abs(error).max() <= enough:
                break
            matrix = [residual(drive + change * unit) - error for unit in np.eye(len(y))]
            matrix = np.stack(matrix, axis=1) / change
            square = matrix.T @ matrix
            size = np.trace(square) / len(y) * np.eye(len(y))
            before = error @ error
            for _halving in range(_TRIALS):
                trial = drive - np.linalg.solve(square + damping**2 * size, matrix.T @ error)
                trial_error = residual(trial)
                if trial_error @ trial_error < before:
                    break
                damping *= 4.0
            else:
                break
            drive, error, damping = trial, trial_error, max(0.25 * damping, _DAMPING)
            if not error @ error < _GAIN**2 * before:
                break
        return drive


_RESERVE = 0.9  # highest rate used, over that at which the response is no longer monotone
# starting values: growth of a threshold at the highest rate, over the half range of the drive
_GROWTHS = np.geomspace(0.003, 0.3, 5)
_STRETCHES = np.geomspace(0.03, 3.0, 5)  # the same, over the threshold itself
_MEMORIES = 4  # number of time constants, from two samples to a tenth of the longest record


@dataclass(frozen=True, eq=False)
class RateDependentPrandtlIshlinskiiOperator(PlaySum):
    """Weighted sum of rate-dependent plays, see :class:`RateDependentPrandtlIshlinskii`.

    Parameters
    ----------
    thresholds, weights : array-like of shape (n_plays,)
        At rest: thresholds in units of the drive, ascending, not negative, fixed structure;
        weights in response/drive.
    rate_weights : array-like of shape (n_plays,) or (0,), default=()
        Change of the weights with the rate, response s/drive^2; if empty, none is identified.
    intercept : float, default=0.0
        In units of the response.
    dilation : float, default=0.0
        ``beta``: growth of all thresholds above zero with the rate, in s; not identified if zero.
    stretch : float, default=0.0
        ``kappa``: relative growth of the thresholds with the rate instead, in s/drive; not
        identified if zero.
    time_constant : float, default=0.0
        Time constant of the low-pass of the rate, in s; positive unless ``smoothing`` is "none".
    smoothing : {"none", "speed", "velocity"}, default="none"
        Input of the low-pass: none, the magnitude of the drive's rate, or the rate with its sign,
        whose magnitude is then taken after the low-pass.
    non_negative : bool, default=True
        Whether the weights at rest are bounded below by zero when they are identified.
    falling : bool, default=False
        Whether that bound is an upper one: all weights are zero or below, and the response falls
        where the drive rises.

    Raises
    ------
    ValueError
        If the thresholds are negative or do not ascend, or there is not one weight per threshold;
        if dilation, stretch or time constant is negative, dilation and stretch are both positive,
        or the time constant does not match the smoothing.

    Notes
    -----
    The state is the tuple (plays (n_plays,), last drive, last output of the low-pass). ``"rest"``
    is the state after an infinitely slow first loading from zero.

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
    stretch: float = parameter(default=0.0, log=True, lower=0.0, unit="s/drive")
    time_constant: float = parameter(default=0.0, log=True, lower=0.0, unit="s")
    smoothing: str = "none"
    non_negative: bool = True
    falling: bool = False

    resolution = replace(PlaySum.resolution, others=("rate_weights",))

    def __post_init__(self):
        super().__post_init__()
        size = self.thresholds.size
        matching = self.rate_weights.shape in {(0,), (size,)}
        wanted = f"have one value for each of the {size} thresholds, or none"
        self._require("rate_weights", matching, wanted)
        self._require("dilation", self.dilation >= 0.0, "not be negative")
        wanted = "not be negative, and be 0 if there is a dilation"
        fitting = self.stretch >= 0.0 and 0.0 in (self.stretch, self.dilation)
        self._require("stretch", fitting, wanted)
        known = self.smoothing in ("none", "speed", "velocity")
        self._require("smoothing", known, "be 'none', 'speed' or 'velocity'")
        fitting = self.time_constant > 0.0 if self._smooths else self.time_constant == 0.0
        wanted = "be above 0 with a smoothing, and 0 without one"
        self._require("time_constant", fitting, wanted)

    @property
    def _smooths(self):
        return self.smoothing != "none"

    moves_at_rest = _smooths

    def parameter_specs(self):
        """Return the identifiable fields; those of the rate are included if they are not zero."""
        specs = super().parameter_specs()
        for name in ("dilation", "stretch", "time_constant"):
            if getattr(self, name) == 0.0:
                del specs[name]
        return specs

    def _arguments(self):
        """Return thresholds, their growth, weights and rate weights, (n_plays,) each."""
        none = as_signal(np.zeros_like(self.weights))
        rate_weights = self.rate_weights if self.rate_weights.size else none
        growth = self.dilation * (self.thresholds > 0.0) + self.stretch * self.thresholds
        return self.thresholds, growth, self.weights, rate_weights

    def paces(self, velocities, dt, before=0.0):
        """Return the rates of the drive that the thresholds depend on.

        Parameters
        ----------
        velocities : array-like of shape (n_samples,)
            Slopes of the drive in the interval before each sample, in drive/s.
        dt : float
            Sampling interval in s.
        before : float, default=0.0
            Output of the low-pass before the first sample.

        Returns
        -------
        rates : ndarray of shape (n_samples,)
            In drive/s.
        last : float
            Last output of the low-pass.
        """
        smooth = self._low_pass(self._passed(velocities), dt, before)
        return np.abs(smooth), float(smooth[-1]) if smooth.size else before

    def _passed(self, velocities):
        """Return the input of the low-pass."""
        return velocities if self.smoothing == "velocity" else np.abs(velocities)

    def _low_pass(self, signals, dt, before=0.0):
        """Return low-passed signals (n_samples, ...), their inputs constant over each interval."""
        if not (self._smooths and signals.size):
            return signals
        fade, gain = self._fade(dt)
        first = np.full((1, *signals.shape[1:]), fade * before)
        return lfilter([gain], [1.0, -fade], signals, axis=0, zi=first)[0]

    def _fade(self, dt):
        """Return pole and input gain of the low-pass over one interval; they add up to 1."""
        steps = -dt / self.time_constant if self._smooths else -np.inf
        return np.exp(steps), -np.expm1(steps)

    def init(self, u0, initial_state="rest"):
        """Return the state before the first sample ``u0``: plays, last drive and low-pass."""
        last = float(u0) if initial_state == "rest" else 0.0
        return np.clip(0.0, last - self.thresholds, last + self.thresholds), last, 0.0

    def run(self, u, dt, state=None):
        u = as_signal(u)
        y = np.empty(u.size)
        plays, last, smooth = self.init(u[0] if u.size else 0.0) if state is None else state
        plays = plays.copy()
        rates, smooth = self.paces(np.diff(u, prepend=last) / dt, dt, smooth)
        rate_play_run(u, rates, *self._arguments(), plays, y)
        y += self.intercept
        return y, (plays, float(u[-1]) if u.size else last, smooth)

    def compiled_step(self, dt, state):
        plays, last, smooth = state
        rate = dt, *self._fade(dt), self.smoothing == "velocity"
        constants = *self._arguments(), self.intercept, *rate
        return CompiledLaw(rate_play_step, constants, [*plays, last, smooth])

    def sensitivities(self, u, du, dt, initial_state="rest"):
        u, du = as_signal(u), as_signal(du)
        plays, last, _ = self.init(u[0] if u.size else 0.0, initial_state)
        velocities = np.diff(u, prepend=last) / dt
        # from rest the first loading ends at the first sample: before it, the tangents are the same
        before = du[:1] if initial_state == "rest" else np.zeros((1, du.shape[1]))
        rates, drates = self._rate_tangents(
            velocities, np.diff(du, axis=0, prepend=before[: len(du)]) / dt, dt
        )
        m, arguments = du.shape[1], self._arguments()
        y, start = np.empty(u.size), np.zeros(plays.size)
        rate_play_run(u, rates, *arguments, plays, y)
        # growth and time constant act through the rate only: they are additional tangents for which
        # that of the drive is zero. A threshold grows by ``growth * rate``, so the tangent by
        # growth itself is that of the rate, ``rate / growth``
        growth = self.dilation or self.stretch
        if growth:
            drates = np.column_stack((drates[:, :m], np.zeros(u.size), drates[:, m:]))
        speeds, drive = drates, np.zeros_like(drates)
        drive[:, :m] = du
        if growth:
            speeds = drates.copy()
            speeds[:, m] = rates / growth
        out = np.empty((u.size, drive.shape[1] + plays.size))
        rate_play_tangents(u, as_signal(drive), rates, as_signal(speeds), *arguments, start, out)
        plays, propagated = out[:, drive.shape[1] :], out[:, : drive.shape[1]]
        if self.rate_weights.size:
            propagated = propagated + (plays @ self.rate_weights)[:, None] * drates
        scaled = rates[:, None] * plays[:, : self.rate_weights.size]
        ones = np.ones((u.size, 1))
        by_parameters = plays, scaled, ones, propagated[:, m:]
        return y + self.intercept, np.hstack((propagated[:, :m], *by_parameters))

    def position_tangents(self, u, dt, initial_state="rest"):
        u = as_signal(u)
        _, last, smooth = self.init(u[0] if u.size else 0.0, initial_state)
        rates, _ = self.paces(np.diff(u, prepend=last) / dt, dt, smooth)
        thresholds, growth, weights, rate_weights = self._arguments()
        slacks = thresholds + rates[:, None] * growth
        moved = self._moved_plays(u, slacks, 1.0 + self.stretch * rates)
        return moved * (weights + rates[:, None] * rate_weights)

    def _rate_tangents(self, velocities, tangents, dt):
        """Return the rates (n,) and their tangents (n, m [+ 1]), that by the time constant last."""
        if self.smoothing != "velocity":
            tangents = tangents * np.sign(velocities)[:, None]
        passed = self._passed(velocities)
        smooth = self._low_pass(passed, dt)
        tangents = self._low_pass(tangents, dt)
        if self._smooths:
            # derivative by tau of x_i = f x_{i-1} + (1 - f) p_i with f = exp(-dt / tau)
            fade = np.exp(-dt / self.time_constant)
            change = fade * dt / self.time_constant**2
            source = change * (np.append(0.0, smooth[:-1])[: smooth.size] - passed)
            tangents = np.column_stack((tangents, lfilter([1.0], [1.0, -fade], source)))
        return np.abs(smooth), tangents * np.sign(smooth)[:, None]

    def characteristics(self, seen):
        """Return the growth of the loop at the 90 % quantile of the rate, and that rate."""
        fast = np.quantile(seen.rates, 0.9)
        change = self.dilation or self.stretch or np.sum(self.rate_weights) / np.sum(self.weights)
        growth = 100.0 * change * fast / (0.5 * np.ptp(seen.ends) if self.dilation else 1.0)
        return {"growth at fast motion": (growth, "%"), "fast motion": (fast, "drive/s")}

    def drive_at_rates(self, y, rates, plays=None):
        """Return the drive of a response, for known rates.

        Parameters
        ----------
        y, rates : array-like of shape (n_samples,)
            Response, and the rates of the drive as :meth:`paces` returns them, in drive/s.
        plays : ndarray of shape (n_plays,), default=None
            Plays before the first sample; by default zero.

        Returns
        -------
        ndarray of shape (n_samples,)
            Drive.

        Raises
        ------
        ValueError
            If the response is not a strictly monotone function of the drive at one of the rates.
        """
        y, rates = as_signal(np.asarray(y) - self.intercept), as_signal(rates)
        thresholds, growth, weights, rate_weights = self._arguments()
        if self._falls:
            y, weights, rate_weights = (as_signal(-part) for part in (y, weights, rate_weights))
        fastest = rates.max(initial=0.0)
        ends = np.array([weights, weights + fastest * rate_weights])
        if self.stretch:  # a shrinking threshold lets plays move in any order
            ends[:, 1:] = np.minimum(ends[:, 1:], 0.0)
        least = np.min(np.cumsum(ends, axis=1))
        if thresholds[0] != 0.0 or not least > 0.0:
            raise ValueError(
                "RateDependentPrandtlIshlinskiiOperator.drive_at_rates needs a first threshold of "
                "0 and positive partial sums of the weights at all rates: the response must be "
                f"strictly monotone. Got thresholds[0]={thresholds[0]!r} and the smallest sum "
                f"{least!r} instead."
            )
        u = np.empty(y.size)
        plays = np.zeros(thresholds.size) if plays is None else plays.copy()
        rate_play_inverse(y, rates, thresholds, growth, weights, rate_weights, plays, u)
        return u

    @property
    def _falls(self):
        return np.sum(self.weights) < 0.0  # of a monotone law

    def inverse(self):
        """Return the inverse, from response to drive; it needs the later response too."""
        return RateDependentInverseOperator(self)

    def fastest_monotone(self):
        """Return a rate (drive/s) up to which the response is strictly monotone in the drive."""
        sign = -1.0 if self._falls else 1.0
        falls = -sign * np.cumsum(self.rate_weights)
        slopes = sign * np.cumsum(self.weights)[: falls.size]
        falling = falls > 0.0
        return _RESERVE * np.min(slopes[falling] / falls[falling], initial=np.inf)


class RateDependentPrandtlIshlinskii(PlayModel):
    r"""Prandtl-Ishlinskii model that depends on the rate of the drive.

    With ``variant="threshold"`` (Al Janaideh and Krejčí 2013) all thresholds but the one at zero
    grow with the rate v, and loops widen:

    .. math:: y = c + \sum_k w_k F_{r_k(t)}[u], \quad r_k(t) = r_k + \beta v(t)

    With ``variant="proportional"`` they grow in proportion, so that the loop widens uniformly:

    .. math:: r_k(t) = r_k (1 + \kappa v(t))

    With ``variant="slope"`` (Ang, Khosla and Riviere 2007) the weights change with the rate, and
    loops tilt:

    .. math:: y = c + \sum_k (w_k + s_k v(t)) F_{r_k}[u]

    The model depends on the magnitude of the rate, so that without intercept it is odd. The rate at
    a sample is the slope of the straight line that ends there. Without ``smoothing``,
    :math:`v = |u'|` acts without delay; otherwise it acts through a first-order low-pass, as in a
    device that warms up when it moves, or in one whose internal state lags:

    .. math:: \tau v' + v = |u'| \quad\text{(speed)}, \qquad
       \tau q' + q = u', \; v = |q| \quad\text{(velocity)}

    If the time constant is far above the periods of the drive, the low-pass of the speed is its
    mean and that of the velocity is zero. All parameters but :math:`\beta`, :math:`\kappa` and
    :math:`\tau` are solved exactly by least squares.

    Parameters
    ----------
    variant : {"threshold", "proportional", "slope"}, default="threshold"
        Which parameters depend on the rate.
    smoothing : {"none", "speed", "velocity"}, default="none"
        Input of the low-pass: none, the magnitude of the rate, or the rate with its sign.

    Attributes
    ----------
    rate_weights_ : ndarray of shape (n_operators,) or (0,)
        Change of the weights with the rate (``variant="slope"``).
    dilation_ : float
        Growth of the thresholds with the rate, in s; 0 unless ``variant="threshold"``.
    stretch_ : float
        Relative growth, in s/drive; 0 unless ``variant="proportional"``.
    time_constant_ : float
        Time constant of the low-pass, in s; 0 without one.

    See Also
    --------
    PrandtlIshlinskii : Loops that do not depend on the rate.
    TanhHysteresis : Another model with a term in the rate of the drive.

    References
    ----------
    Al Janaideh and Krejčí, *IEEE/ASME Transactions on Mechatronics*, 2013. Al Janaideh, Krejčí and
    Monteiro, *Applications of Mathematics*, 2023, for thresholds that are any functions of time.
    Ang, Khosla and Riviere, *IEEE/ASME Transactions on Mechatronics*, 2007.

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
        "variant": [StrOptions({"threshold", "proportional", "slope"})],
        "smoothing": [StrOptions({"none", "speed", "velocity"})],
    }

    operator_class = RateDependentPrandtlIshlinskiiOperator

    def __init__(
        self,
        n_operators=20,
        *,
        variant="threshold",
        smoothing="none",
        thresholds="grid",
        non_negative=True,
        fit_intercept=True,
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        super().__init__(initial_state=initial_state, dt=dt, drive=drive, method=method)
        self.n_operators = n_operators
        self.variant = variant
        self.smoothing = smoothing
        self.thresholds = thresholds
        self.non_negative = non_negative
        self.fit_intercept = fit_intercept

    def starting_values(self, records):
        thresholds = place_thresholds(self.thresholds, records, self.n_operators)
        zeros = np.zeros(len(thresholds))
        plain = RateDependentPrandtlIshlinskiiOperator(
            thresholds,
            zeros,
            zeros if self.variant == "slope" else (),
            non_negative=self.non_negative,
        )
        starts = []
        for time_constant in self._memories(records):
            start = replace(plain, smoothing=self.smoothing, time_constant=time_constant)
            if self.variant == "slope":
                starts.append(start)
                continue
            half, fastest = 0.5 * largest_peak_to_peak(records), self._fastest(records, start)
            if self.variant == "proportional":
                starts += [replace(start, stretch=float(s)) for s in _STRETCHES / fastest]
            else:
                starts += [replace(start, dilation=float(g)) for g in half * _GROWTHS / fastest]
        directed = in_direction(starts[:1], records, self.held_parameters(), self.free_run_state)
        return [replace(start, falling=choice.falling) for choice in directed for start in starts]

    def _memories(self, records):
        """Return starting time constants (s): two samples to a tenth of the longest record."""
        if self.smoothing == "none":
            return [0.0]
        dt = min(record.dt for record in records)
        longest = max(record.dt * len(record.u) for record in records)
        return np.geomspace(2.0 * dt, max(0.1 * longest, 4.0 * dt), _MEMORIES).tolist()

    @staticmethod
    def _fastest(records, start):
        """Return the highest rate v in drive/s; the range per interval if the drive never moves."""
        rates = [start.paces(np.diff(r.u) / r.dt, r.dt)[0].max(initial=0.0) for r in records]
        return max(rates) or largest_peak_to_peak(records) / records[0].dt

    def adopt(self, result):
        super().adopt(result)
        show(self, self.operator_, "rate_weights", "dilation", "stretch", "time_constant")
        return self
