"""Whether an identified effect has the property that its name states.

A margin is a number above zero if the effect has the property: how far a mode is below critical
damping, how flat a saturation is at its end, and so on. It is a function of the parameters of the
part, so their covariance gives its standard error. A name is refused if the margin is significantly
below zero, that is, if its one-sided confidence interval contains no value above zero. If the data
do not decide, the name is accepted, and the simpler effect that fits as well is claimed.
"""

import numpy as np
from scipy.stats import norm

from ..noise import largest_noise
from ..operators import parts_with_resolution
from ..records import near_period
from ._constants import FLAT, NOTICEABLE, REPEATS
from ._traits import n_ringing, presliding_displacement
from ._turns import turns

_LONGEST_PIECE = 1e3  # ranges of the motion: a curve that needs more of its input is flat


def is_plausible(margin, candidate, before, records, alpha):
    """Return whether the last effect of a candidate may keep its name.

    Parameters
    ----------
    margin : callable or None
        See :class:`Effect`.
    candidate : Candidate
    before : Candidate
        The model without the effect.
    records : list of RecordData
        The records that the candidate was fitted to.
    alpha : float
        Level of the confidence interval.
    """
    name, tree = candidate.effects[-1], candidate.structure
    if _are_swapped(before.structure, tree, name) or _are_indistinguishable(tree, records):
        return False
    return has_its_name(name, margin, tree, records, alpha)


def has_its_name(name, margin, tree, records, alpha):
    """Return whether an effect of a tree has the property of its name; see :func:`is_plausible`."""
    if margin is None:
        return True
    problem = tree.problem(records)
    x, motion = problem.x0, _motion(tree, name, records)

    def at(values):
        return margin(_with_spring(tree.at(problem, values), name), motion, records)

    value = at(x)
    if value >= 0.0 or not np.isfinite(value):
        return bool(value >= 0.0)
    return bool(value + norm.isf(alpha) * _standard_error(problem, x, at) >= 0.0)


def _standard_error(problem, x, function):
    """Return the standard error of a function of the parameters, by linear error propagation."""
    gram = problem.total(problem.evaluate(x))
    free = np.flatnonzero((x > problem.lower) & (x < problem.upper) & (np.diag(gram)[:-1] > 0.0))
    hessian = gram[:-1, :-1][np.ix_(free, free)]
    scale = 1.0 / np.sqrt(np.diag(hessian))
    # sums of products of 1e5 samples are rounded to about 1e-11
    inverse = np.linalg.pinv(hessian * np.outer(scale, scale), 1e-11, hermitian=True)
    variance = gram[-1, -1] / max(problem.segment_weight.sum() - len(free), 1.0)
    # step of central differences with about equal truncation and rounding error; a parameter that
    # may be zero is scaled by its standard error too, a logarithm by one
    sizes = np.maximum(np.abs(x[free]), np.where(problem.log[free], 1.0, np.sqrt(variance) * scale))
    sizes = np.cbrt(np.finfo(float).eps) * np.where(sizes > 0.0, sizes, 1.0)
    steps = sizes[:, None] * np.eye(len(x))[free]
    ends = [np.clip([x - h, x + h], problem.lower, problem.upper) for h in steps]
    slopes = np.array([(function(b) - function(a)) / (b - a).sum() for a, b in ends])
    return float(np.sqrt(variance * (slopes * scale) @ inverse @ (slopes * scale)))


def _motion(tree, name, records):
    """Return the output of an effect, or the motion that a force is a function of.

    Empty for an additive disturbance.
    """
    if tree.label(name) in tree.disturbance_names:
        return np.array([])
    part = tree.part(name)
    last = tree.place(name) + (not (_is_force(part) or tree.is_part(name)))
    motion = np.concatenate(tree.run(records, last=last))
    return motion if motion.ndim == 1 else motion[:, 0]


def _is_force(operator):
    """Whether an operator is a force that builds up over a given motion."""
    return presliding_displacement(operator) is not None and operator.linear_mode() is None


def _with_spring(tree, name):
    """Return the operator of an effect; of a force beside a gain, the sum of both."""
    part = tree.part(name)
    if tree.is_part(name) and _is_force(part):
        whole = tree.operators[tree.place(name)]
        if _has_spring(whole):
            return whole
    return part


def _has_spring(operator):
    """Whether an operator is a sum whose first part is a gain."""
    first, *_ = getattr(operator, "stages", [operator])
    return first is not operator and first.memoryless and first.signal_linear


def _dissipates(operator, motion):
    """Return a margin above zero unless a force beside a gain works against it.

    If the gain is a spring, a force of the other sign would supply energy: the response is then no
    force, but lags behind its drive. A force whose range exceeds that of the spring has no sign.
    """
    if not _has_spring(operator):
        return np.inf
    spring, *forces = operator.stages
    force = sum(own.run(motion, 1.0)[0] for own in forces if _is_force(own))
    way = np.sign((force[1:] + force[:-1]) @ np.diff(motion)) * np.ptp(motion)
    return 1.0 + spring.gain * way / max(np.ptp(force), np.finfo(float).tiny)


def _are_swapped(before, tree, name):
    """Return whether the added stage has become the mode that an earlier stage was before.

    The earlier stage then describes the new effect, so that the name would be wrong.
    """
    if tree.label(name) not in tree.names or not n_ringing(tree.part(name)):
        return False
    n_modes = [sum(map(n_ringing, model.operators)) for model in (tree, before)]
    return n_modes[0] <= n_modes[1]


def _are_indistinguishable(tree, records):
    """Whether an effect is linear dynamics in series with plays, and the drive repeats one loop.

    A single loop, traversed at one rate, is described by a free set of plays and a curve as well as
    by any dynamics: memory cannot be distinguished from a delayed response, except where the drive
    rests.
    """
    added = [tree.part(name) for name in tree.effects if tree.label(name) in tree.names]
    parts = [part for operator in tree.operators for _, part, _ in parts_with_resolution(operator)]
    plays = any(part.owns_gain for part in parts)
    dynamic = any(operator.signal_linear and not operator.memoryless for operator in added)
    if tree.multi_input or not (dynamic and plays):
        return False
    drive = np.concatenate([record.drive for record in records])
    rates = np.abs(np.diff(drive))
    if np.mean(rates <= NOTICEABLE * rates.mean()) > NOTICEABLE:  # a sine rests for 2 %
        return False
    period = near_period(drive)
    return bool(period) and round(len(turns(drive)) * period / len(drive)) <= 2


# ------------------------------------------------------------------------------------ margins


def has_no_peak(operator, motion, records):
    """Return the damping ratio minus the one above which a mode has no resonance peak.

    Near zero damping its logarithm is unbounded, so the margin is in the damping itself.
    """
    return getattr(operator, "damping_ratio", np.inf) - np.sqrt(0.5)


def rings(operator, motion, records):
    """Return the smallest margin of a mode: a peak, its height, and resolution by the recording.

    The first is a margin of the squared quality factor, which stays bounded where a pole is too
    fast to be known, and is linear in one that is too slow; the logarithm of the damping is
    neither. A mode is resolved by the sampling if the upper end of its half-power band is below
    half the sampling rate, and by the records if it repeats in the longest of them: a slower one
    cannot be distinguished from a drift. A mode with zeros follows any short transient, such as
    that of several lags after a single step. Each extremum of a free vibration shows one number,
    so there must be as many half periods as the mode has parameters.
    """
    mode, ratio = _lightest_mode(operator)
    if not mode:
        return -np.inf
    highest = np.pi / min(record.dt for record in records)
    if ratio > 1.0 and mode * np.exp(np.arccosh(ratio)) > highest:
        return -np.inf  # two real poles, the faster one known to be beyond the sampling alone
    lowest = 2.0 * np.pi * REPEATS / max(len(record.u) * record.dt for record in records)
    resolved = min(highest / (mode * (1.0 + ratio)), mode / lowest)
    margin = min(0.5 / ratio**2, resolved**2) - 1.0
    if not np.size(getattr(operator, "numerator", ())):
        return margin
    vibrating = sum(_excited_time(record, ringing_time(operator)) for record in records)
    half_periods = mode * vibrating / np.pi
    margin = min(margin, half_periods / (2 + np.size(operator.numerator)) - 1.0)
    # a decade to both sides in steps of 2.3 %, less than the half-power band of a damping of 1.2 %
    multiples = np.r_[0.0, np.geomspace(0.1, 10.0, 200), 1e4]  # static, near the mode, fast
    gain = np.log(np.abs(operator.frequency_response(mode / (2.0 * np.pi) * multiples)))
    static, high, between = gain[0], gain[-1], gain[1:-1]
    # of a peak, or of a notch
    prominence = max(between.max() - max(static, high), min(static, high) - between.min())
    return min(margin, prominence - np.log1p(NOTICEABLE))


def _excited_time(record, ringing):
    r"""Return how long a mode vibrates noticeably in a record, s: while driven, and after that.

    It is driven where the rate of the drive changes by a noticeable part of its largest change. Of
    a measured drive, noise does not drive it: where the largest change is beyond noise with the
    scatter of most changes, only those beyond it count. One of n normal values exceeds
    :math:`2 \sqrt{\ln n}` standard deviations with a probability below 1 / n.
    """
    changes = np.abs(np.diff(record.u, 2))
    largest = changes.max(initial=0.0)
    scatter = np.median(changes) / norm.ppf(0.75) if changes.size else 0.0
    noise = 2.0 * np.sqrt(np.log(max(changes.size, 1))) * scatter
    driven = 1 + np.flatnonzero(
        changes > max(NOTICEABLE * largest, noise if noise < largest else 0.0)
    )
    rests = record.dt * np.diff(np.append(driven, len(record.u)))
    return float(np.minimum(rests, -np.log(NOTICEABLE) * ringing).sum())


def _lightest_mode(operator):
    """Return frequency (rad/s) and damping ratio of the least damped mode; 0, inf without one."""
    ratios = np.ravel(getattr(operator, "damping_ratios", getattr(operator, "damping_ratio", ())))
    if not ratios.size:
        return 0.0, np.inf
    modes = getattr(operator, "natural_frequencies", getattr(operator, "natural_frequency", None))
    least = np.argmin(ratios)
    return np.ravel(modes)[least], ratios[least]


def ringing_time(operator):
    """Return the time in which the free vibration of the least damped mode falls to 1/e, s.

    Zero without a mode.
    """
    mode, ratio = _lightest_mode(operator)
    with np.errstate(divide="ignore"):
        return np.divide(1.0, mode * ratio) if mode else 0.0


def responds_promptly(operator, motion, records):
    """Return margins of creep: of its prompt response, and of the rate of its fastest unit.

    Creep whose prompt response is a negligible part of that within a record is a lag. A unit whose
    time constant is below the sampling interval is part of the prompt response.
    """
    operator = getattr(operator, "stages", [operator])[-1]  # a velocity is integrated before it
    times = np.ravel(getattr(operator, "time_constants", getattr(operator, "time_constant", None)))
    # what still relaxes after the first sample: bounded where no sample determines the rate
    unsampled = np.exp(-min(record.dt for record in records) / times).min() - np.exp(-1.0)
    if not hasattr(operator, "compliances"):  # in parallel with the prompt response
        return unsampled
    relaxed = -np.expm1(-max(len(record.u) * record.dt for record in records) / times)
    prompt = 1.0 / (1.0 + np.ravel(operator.compliances) @ relaxed)
    return min(prompt - NOTICEABLE, unsampled)


def delay_beyond_sampling(operator, motion, records):
    """Return by how much a delay exceeds a sampling interval: sampling may cause a shorter one."""
    return operator.delay / min(record.dt for record in records) - 1.0


def is_between_samples(operator, motion, records):
    """Return by how much a shift is below a sampling interval; infinite without a shift.

    A longer one is a delay of the device; no device answers before it is driven, so that a response
    that is early by any time is due to the instruments.
    """
    shift = getattr(operator, "shift", None)
    return np.inf if shift is None else 1.0 - shift / min(record.dt for record in records)


def width_beyond_noise(operator, motion, records):
    """Return the logarithm of a play's half gap over the largest white noise of the drive.

    A narrower play only smooths that noise, which did not act on the device. Both are fractions of
    the range. The largest of n normal values is about sqrt(2 log(n)) standard deviations away.
    """
    drives = [record.drive for record in records]
    noise = min(largest_noise(u) * np.sqrt(2.0 * np.log(len(u))) for u in drives)
    noise /= np.ptp(np.concatenate(drives))
    return np.log(operator.half_gap / np.ptp(motion) / noise) if noise > 0.0 else np.inf


def varies_in_rate(operator, motion, records):
    """Return whether the times between turning points differ by more than a sample at each end.

    At one frequency, rate and amplitude of the drive cannot be distinguished.
    """
    durations = [record.dt * np.diff(turns(record.drive)) for record in records]
    # noise adds turning points, and the first and last swing are cut: extremes are left out
    quantiles = np.array([np.quantile(times, (0.1, 0.9)) for times in durations if len(times)])
    if not len(quantiles):
        return -np.inf
    low, high = quantiles[:, 0].min(), quantiles[:, 1].max()
    resolution = 2.0 * max(record.dt for record in records)
    return np.inf if high - low > NOTICEABLE * low + resolution else -np.inf


def levels_off(operator, motion, records):
    """Return by how much a rounded curve is beyond its knee point at an end of the motion.

    Of :math:`y = v / (1 + |v / L|^n)^{1/n}`, the slope over the chord, :math:`(dy/dv) / (y/v)`, is
    :math:`1 - |y / L|^n`.
    """
    if not hasattr(operator, "knee"):
        return np.inf
    reached = min(np.abs(motion - operator.center).max() / operator.level, 1.0)
    return FLAT - (1.0 - reached**operator.knee)


def input_beyond_dead_zone(operator, motion, records):
    """Return by how much the input of a dead zone exceeds its nearer end.

    Otherwise the band is where the drive saturates; a band without samples is a shift.
    """
    if not np.any(motion == 0.0):
        return -np.inf
    return min(motion.max(), -motion.min()) / np.ptp(motion) - NOTICEABLE


def bends(operator, motion, records):
    """Return margins of a curve: at most one extremum, and no saturation of a rounded curve.

    The curve is monotone, or has one extremum, as the strain of an electrostrictor over its field.
    A curve with more extrema is overfitted. The margin is the smallest slope in the direction of
    its branch, relative to the mean absolute slope.
    """
    if hasattr(operator, "knee"):
        return -levels_off(operator, motion, records)
    if not getattr(operator, "passed", 0.0):  # in parallel with a slope, which it cannot turn
        return np.inf
    slope = operator.evaluate(operator.center + operator.scale * np.linspace(-1.0, 1.0, 200))[1]
    directed = np.array([slope, -slope])  # rising, then falling; falling, then rising
    before = np.minimum.accumulate(directed, axis=1)
    after = np.minimum.accumulate(-directed[:, ::-1], axis=1)[:, ::-1]
    # with the extremum before each point, and behind the last
    end = np.full((2, 1), np.inf)
    smallest = np.minimum(np.hstack([end, before]), np.hstack([after, end]))
    return smallest.max() / np.abs(slope).mean()


def bends_to_one_side(operator, motion, records):
    """Return margins of one-sided dead zones: motion beyond the kinks, and the curve's even part.

    If only a small part of the motion determines an outermost slope, that describes the tip of a
    hysteresis loop, not the curve of the device. A curve that bends on one side of the middle of
    the motion has, without its straight line, an even part as large as its odd part; one that bends
    alike on both sides is no asymmetry.
    """
    kinks = operator.run(operator.thresholds, 1.0)[0]
    low, high = motion.min(), motion.max()
    distances = np.minimum(high - kinks, kinks - low)
    inside = distances[distances > 0.0]  # kinks outside of the recorded motion have no effect
    beyond = inside.min(initial=np.inf) / np.ptp(motion) - NOTICEABLE
    deviation = _bend_of_inverse(operator, np.linspace(low, high, 201))
    even, odd = np.std([deviation + deviation[::-1], deviation - deviation[::-1]], axis=1)
    return min(beyond, (even - odd) / max(even + odd, np.finfo(float).tiny))


def _bend_of_inverse(curve, outputs):
    """Return the input of a piecewise linear curve for its outputs, minus a straight line."""
    kinks, length = np.sort(curve.thresholds), _LONGEST_PIECE * np.ptp(outputs)
    knots = np.concatenate([kinks[:1] - length, kinks, kinks[-1:] + length])
    inputs = np.interp(outputs, np.maximum.accumulate(curve.run(knots, 1.0)[0]), knots)
    return inputs - np.polynomial.Polynomial.fit(outputs, inputs, 1)(outputs)


def has_own_lines(operator, motion, records):
    """Return whether sinusoids repeat, are resolved, and are no harmonics of the drive."""
    frequencies = np.sort(operator.frequencies)
    longest = max(len(record.u) * record.dt for record in records)
    repeats = frequencies[0] * longest >= REPEATS
    # lines closer than one over the length of a record are one (Rayleigh's criterion)
    resolved = np.all(np.diff(frequencies) * longest >= 1.0)
    independent = any(_are_no_harmonics(frequencies, record) for record in records)
    return np.inf if repeats and resolved and independent else -np.inf


def _are_no_harmonics(frequencies, record):
    r"""Return whether at least half of the power of each sinusoid does not repeat with the drive.

    The mean over the periods of the drive repeats. A sinusoid whose frequency is :math:`\delta`
    drive frequencies from a harmonic keeps the fraction
    :math:`\sin(\pi k \delta) / (k \sin(\pi \delta))` of its amplitude in the mean of :math:`k`
    periods.
    """
    period = near_period(record.drive)
    if not period:
        return True
    n_periods = len(record.u) / period
    harmonics = frequencies * period * record.dt
    offsets = harmonics - np.round(harmonics)
    return bool(np.all((np.sinc(n_periods * offsets) / np.sinc(offsets)) ** 2 < 0.5))


def slides(operator, motion, records):
    """Return the logarithm of a noticeable part of the motion over the presliding displacement.

    Friction saturates soon after a reversal of the motion, which it opposes, as a spring in
    parallel with it does.
    """
    presliding = presliding_displacement(operator)
    if presliding is None:
        return np.inf
    soon = np.log(NOTICEABLE * np.ptp(motion) / presliding)
    return min(soon, _dissipates(operator, motion))


def builds_up(operator, motion, records):
    """Return the logarithm of the presliding displacement over that of friction.

    A force that builds up from one sample to the next after a reversal is friction; so is one that
    is added to others of a given motion, and saturates within a negligible part of it, unless it
    would supply energy.
    """
    presliding, steps = presliding_displacement(operator), np.abs(np.diff(motion))
    if presliding is None or not steps.any():
        return np.inf
    smallest = steps[steps > 0.0].mean()
    if operator.linear_mode() is None:
        smallest = max(smallest, NOTICEABLE * np.ptp(motion))
    return max(np.log(presliding / smallest), -_dissipates(operator, motion))


def stops(operator, motion, records):
    """Return margins of stops: stiffness over that of the spring, motion beyond and free of them.

    A stop that is softer than the spring, or always touched, is a spring.
    """
    stiffness, displacement = operator.stop_stiffness, motion
    if operator.linear_mode() is None:  # without a spring
        stiffness = np.inf
    else:
        displacement = (motion - operator.intercept) / operator.gain
    span = np.ptp(displacement)
    beyond = max(operator.lower - displacement.min(), displacement.max() - operator.upper) / span
    clear = (
        min(operator.upper, displacement.max()) - max(operator.lower, displacement.min())
    ) / span
    return min(np.log(stiffness), beyond, clear - NOTICEABLE)
