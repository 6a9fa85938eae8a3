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

_FAR = 1e3  # ranges of the motion: a curve that needs more of its input is flat


def is_plausible(margin, candidate, before, records, alpha):
    """Return whether the last effect of a candidate may have its name.

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
    if _have_changed_places(before.structure, tree, name) or _are_indistinguishable(tree, records):
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
    """Return the output of an effect, or the motion that drives a force.

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
        if any(own.memoryless and own.signal_linear for own in whole.stages):
            return whole
    return part


def _dissipates(operator, motion):
    """Return a margin above zero unless a force beside a gain works against it.

    If the gain is a spring, a force of the other sign would supply energy: the response is then no
    force, but lags behind its drive. A force whose range exceeds that of the spring has no sign.
    """
    if not hasattr(operator, "stages"):
        return np.inf
    gain = sum(own.gain for own in operator.stages if own.memoryless and own.signal_linear)
    force = next(own for own in operator.stages if _is_force(own)).run(motion, 1.0)[0]
    work = (force[1:] + force[:-1]) @ np.diff(motion)
    return 1.0 + np.sign(work) * gain * np.ptp(motion) / max(np.ptp(force), np.finfo(float).tiny)


def _have_changed_places(before, tree, name):
    """Return whether the added stage has taken over the ringing of an earlier one.

    The added stage is then the earlier mode, and the earlier stage is the new effect.
    """
    if tree.label(name) not in tree.names or not n_ringing(tree.part(name)):
        return False
    ringing = [sum(map(n_ringing, own.operators)) for own in (tree, before)]
    return ringing[0] <= ringing[1]


def _are_indistinguishable(tree, records):
    """Whether an effect is linear dynamics in series with plays, and the drive repeats one loop.

    A single loop, traversed at one rate, is described by a free set of plays and a curve as well as
    by any dynamics: memory cannot be distinguished from a delayed response, except where the drive
    rests.
    """
    added = [tree.part(name) for name in tree.effects if tree.label(name) in tree.names]
    parts = [part for own in tree.operators for _, part, _ in parts_with_resolution(own)]
    plays = any(part.owns_gain for part in parts)
    moving = any(own.signal_linear and not own.memoryless for own in added)
    if tree.multi_input or not (moving and plays):
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
    """Return the smallest margin: below critical damping, height of the peak, resolved.

    The first is one of the quality factor, which stays bounded where a pole is too fast to be
    known; the logarithm of the damping does not. A mode is resolved by the sampling if the upper
    end of its half-power band is below half the sampling rate, and by the records if it repeats in
    the longest of them: a slower one cannot be distinguished from a drift.
    """
    mode, ratio = _lightest_mode(operator)
    if not mode:
        return -np.inf
    highest = np.pi / min(record.dt for record in records)
    lowest = 2.0 * np.pi * REPEATS / max(len(record.u) * record.dt for record in records)
    resolved = min(highest / (mode * (1.0 + ratio)), mode / lowest)
    margin = min(np.sqrt(0.5) / ratio, resolved) - 1.0
    if not np.size(getattr(operator, "numerator", ())):
        return margin
    around = np.r_[0.0, np.geomspace(0.1, 10.0, 200), 1e4]  # rest, near the mode, fast motion
    gain = np.log(np.abs(operator.frequency_response(mode / (2.0 * np.pi) * around)))
    rest, fast, near = gain[0], gain[-1], gain[1:-1]
    # a peak, or a notch
    shows = max(near.max() - max(rest, fast), min(rest, fast) - near.min())
    return min(margin, shows - np.log1p(NOTICEABLE))


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

    Creep without a prompt response within a record is a lag. A unit whose time constant is below
    the sampling interval is part of the prompt response: of the recording it makes a gain.
    """
    times = np.ravel(getattr(operator, "time_constants", getattr(operator, "time_constant", None)))
    # of what relaxes, the part behind the first sample, bounded where no sample shows the rate
    slow = np.exp(-min(record.dt for record in records) / times).min() - np.exp(-1.0)
    if not hasattr(operator, "compliances"):  # in parallel with the prompt response
        return slow
    shown = -np.expm1(-max(len(record.u) * record.dt for record in records) / times)
    return min(1.0 / (1.0 + np.ravel(operator.compliances) @ shown) - NOTICEABLE, slow)


def delay_beyond_sampling(operator, motion, records):
    """Return by how much a delay exceeds a sampling interval: sampling may cause a shorter one."""
    return operator.delay / min(record.dt for record in records) - 1.0


def is_between_samples(operator, motion, records):
    """Return by how much a shift is below a sampling interval; infinite without a shift."""
    shift = getattr(operator, "shift", None)
    return np.inf if shift is None else 1.0 - shift / min(record.dt for record in records)


def width_beyond_noise(operator, motion, records):
    """Return by how much a play is wider than the white noise of the recorded drive.

    A narrower one only smooths that noise, which did not act on the device. Both are fractions of
    the range. The largest of n normal values is about sqrt(2 log(n)) standard deviations away.
    """
    drives = [record.drive for record in records]
    reach = min(largest_noise(u) * np.sqrt(2.0 * np.log(len(u))) for u in drives)
    reach /= np.ptp(np.concatenate(drives))
    return np.log(operator.half_gap / np.ptp(motion) / reach) if reach > 0.0 else np.inf


def varies_in_rate(operator, motion, records):
    """Return whether the times between turning points differ by more than a sample at each end.

    At one frequency, rate and amplitude of the drive cannot be distinguished.
    """
    durations = [record.dt * np.diff(turns(record.drive)) for record in records]
    ends = np.array([np.quantile(own, (0.1, 0.9)) for own in durations if len(own)])
    if not len(ends):
        return -np.inf
    low, high = ends[:, 0].min(), ends[:, 1].max()
    coarse = 2.0 * max(record.dt for record in records)
    return np.inf if high - low > NOTICEABLE * low + coarse else -np.inf


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
    ways = np.array([slope, -slope])  # rising, then falling; falling, then rising
    before = np.minimum.accumulate(ways, axis=1)
    after = np.minimum.accumulate(-ways[:, ::-1], axis=1)[:, ::-1]
    nowhere = np.full((2, 1), np.inf)
    turned = np.minimum(np.hstack([nowhere, before]), np.hstack([after, nowhere]))
    return turned.max() / np.abs(slope).mean()


def bends_to_one_side(operator, motion, records):
    """Return margins of one-sided dead zones: motion beyond the kinks, and their even part.

    A curve is extrapolated with its outermost slopes. If only a small part of the motion determines
    such a slope, it describes the tip of a hysteresis loop, not the curve of the device. One that
    bends to one side of the middle of the motion has an even part as large as its odd part; one
    that bends alike on both sides is no asymmetry.
    """
    kinks = operator.run(operator.thresholds, 1.0)[0]
    low, high = motion.min(), motion.max()
    behind = np.minimum(high - kinks, kinks - low)
    seen = behind[behind > 0.0]  # kinks outside of the recorded motion have no effect
    beyond = seen.min(initial=np.inf) / np.ptp(motion) - NOTICEABLE
    bend = _bend_of_inverse(operator, np.linspace(low, high, 201))
    even, odd = np.std([bend + bend[::-1], bend - bend[::-1]], axis=1)
    return min(beyond, (even - odd) / max(even + odd, np.finfo(float).tiny))


def _bend_of_inverse(curve, outputs):
    """Return the input of a curve in straight pieces for outputs, less a straight line."""
    kinks, far = np.sort(curve.thresholds), _FAR * np.ptp(outputs)
    inputs = np.concatenate([kinks[:1] - far, kinks, kinks[-1:] + far])
    found = np.interp(outputs, np.maximum.accumulate(curve.run(inputs, 1.0)[0]), inputs)
    return found - np.polynomial.Polynomial.fit(outputs, found, 1)(outputs)


def has_own_lines(operator, motion, records):
    """Return whether sinusoids repeat, are resolved, and are no harmonics of the drive."""
    frequencies = np.sort(operator.frequencies)
    longest = max(len(record.u) * record.dt for record in records)
    repeat = frequencies[0] * longest >= REPEATS
    apart = np.all(np.diff(frequencies) * longest >= 1.0)
    own = any(_are_no_harmonics(frequencies, record) for record in records)
    return np.inf if repeat and apart and own else -np.inf


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
    turns = len(record.u) / period
    harmonics = frequencies * period * record.dt
    off = harmonics - np.round(harmonics)
    return bool(np.all((np.sinc(turns * off) / np.sinc(off)) ** 2 < 0.5))


def slides(operator, motion, records):
    """Return how soon a force saturates after a reversal of the motion; friction does soon.

    It opposes the motion, as a spring in parallel with it does.
    """
    way = presliding_displacement(operator)
    if way is None:
        return np.inf
    return min(np.log(NOTICEABLE * np.ptp(motion) / way), _dissipates(operator, motion))


def builds_up(operator, motion, records):
    """Return how slowly a force builds up after a reversal of the motion.

    Where it builds up from one sample to the next, or is a force beside a given motion and
    saturates soon, it is friction, unless it would supply energy.
    """
    way, moves = presliding_displacement(operator), np.abs(np.diff(motion))
    if way is None or not moves.any():
        return np.inf
    least = moves[moves > 0.0].mean()
    if operator.linear_mode() is None:
        least = max(least, NOTICEABLE * np.ptp(motion))
    return max(np.log(way / least), -_dissipates(operator, motion))


def stops(operator, motion, records):
    """Return margins of stops: stiffness over that of the spring, motion beyond and free of them.

    A stop that is softer than the spring, or always touched, is a spring.
    """
    stiffness, place = operator.stop_stiffness, motion
    if operator.linear_mode() is None:  # without a spring
        stiffness = np.inf
    else:
        place = (motion - operator.intercept) / operator.gain
    way = np.ptp(place)
    beyond = max(operator.lower - place.min(), place.max() - operator.upper) / way
    free = (min(operator.upper, place.max()) - max(operator.lower, place.min())) / way
    return min(np.log(stiffness), beyond, free - NOTICEABLE)
