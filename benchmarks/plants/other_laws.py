"""Effects by laws of other textbooks than those of `effects`, and than those of skhyst's models.

Laws of both are called by the same names, and are as strong.
"""

from functools import partial

import numba
import numpy as np
from scipy.signal import fftconvolve

from skhyst.datasets.simulation import PlantEffect

from .motion import coulomb_mode, stopped_mode
from .signals import N_TRAIN, log_uniform

# ------------------------------------------------------------------------- rate of the drive


@numba.njit(cache=True)
def rate_plays(signal, step, thresholds, weights, stretch, widening, tilt, tau, signed):
    """Weighted sum of plays that follow a rate v: r (1 + stretch v) + widening v, w (1 + tilt v).

    The rate is that of the signal, or with tau above zero behind tau q' + q = |u'|, or u' where it
    is signed: then v = |q|. Plays of the threshold zero do not change.
    """
    out = np.zeros(signal.size)
    plays = np.zeros(thresholds.size)
    last, q = signal[0], 0.0
    for i in range(signal.size):
        rate = (signal[i] - last) / step
        last = signal[i]
        rate = rate if signed else abs(rate)
        q = rate + (q - rate) * np.exp(-step / tau) if tau > 0.0 else rate
        v = abs(q)
        for k in range(thresholds.size):
            moving = thresholds[k] > 0.0
            r = thresholds[k] * (1.0 + stretch * v) + widening * v * moving
            plays[k] = max(signal[i] - r, min(signal[i] + r, plays[k]))
            out[i] += weights[k] * (1.0 + tilt * v * moving) * plays[k]
    return out


def rate_dependence(rng, setting):
    """Let thresholds grow in proportion, or thresholds or weights with a filtered rate."""
    law = ("proportional", "filtered_thresholds", "filtered_weights")[rng.integers(3)]
    tau, signed = log_uniform(rng, 5, 100), bool(rng.integers(2))
    tau = 0.0 if law == "proportional" else tau
    share = rng.uniform(0.05, 0.15)  # of the half range, where the drive is fast
    rates = []
    for drive in setting.drives[:N_TRAIN]:
        change = np.diff(drive)
        change = change if signed else np.abs(change)
        if tau:
            kernel = np.exp(-np.arange(change.size) / tau) / tau
            change = fftconvolve(change, kernel)[: change.size]
        rates.append(np.abs(change))
    fast = np.quantile(np.concatenate(rates), 0.9)
    half, widest = np.ptp(setting.drive) / 2, setting.core["thresholds"].max()
    parameters = {
        "stretch": share * half / widest / fast if law == "proportional" else 0.0,
        "widening": share * half / fast if law == "filtered_thresholds" else 0.0,
        "tilt": 2.0 * share / fast if law == "filtered_weights" else 0.0,
    }

    def alter(plant, _):
        return plant.adapt("core", rate_plays, **parameters, tau=tau, signed=signed)

    return PlantEffect(alter=alter, truth={"law": law, "signed": signed, "tau": tau * setting.dt})


# ------------------------------------------------------------------------- creep


def slow_step(signal, step, compliance, longest):
    """Add what each change of the signal leads to later: compliance of the time since then.

    It ends after the longest time, since when the device has rested.
    """
    times = np.minimum(step * (np.arange(signal.size) + 0.5), longest)
    crept = fftconvolve(np.diff(signal), compliance(times))[: signal.size - 1]
    return signal + signal[0] * compliance(longest) + np.append(0.0, crept)


def by_logarithm(t, decade, shortest):
    return decade * np.log10(1.0 + t / shortest)


def by_power(t, size, exponent):
    return size * t**exponent


def creep(rng, setting):
    """Creep by the logarithm, or by a power, of the time since each change."""
    longest = np.mean(setting.lengths)
    share = rng.uniform(0.15, 0.3)  # of the response a record's length later
    size = share / (1.0 - share)
    if rng.random() < 0.5:
        shortest = log_uniform(rng, 1, 30)
        decade = size / np.log10(1.0 + longest / shortest)
        law = partial(by_logarithm, decade=decade, shortest=shortest)
    else:
        exponent = rng.uniform(0.15, 0.5)
        law = partial(by_power, size=size / longest**exponent, exponent=exponent)
    stage = partial(slow_step, compliance=law, longest=longest)
    return PlantEffect("dynamics", stage, truth={"law": law.func.__name__, **law.keywords})


# ------------------------------------------------------------------------- curves


def level_tanh(signal, step, center, level):
    return center + level * np.tanh((signal - center) / level)


def level_cubic(signal, step, center, level):
    """End flat: x - x^3 / (3 L^2) up to where its slope is zero."""
    x = np.clip((signal - center) / level, -1.0, 1.0)
    return center + level * (x - x**3 / 3.0)


def _levels_off(rng, place, low, high, setting, unit):
    center, half = 0.5 * (low + high), 0.5 * (high - low)
    if rng.random() < 0.5:  # the slope is 0.15 to 0.02 at the ends
        law, level = level_tanh, rng.uniform(0.4, 0.6)
    else:
        law, level = level_cubic, rng.uniform(0.7, 0.95)
    parameters = {"center": center, "level": level * half}
    truth = {"law": law.__name__, **{name: unit * value for name, value in parameters.items()}}
    return PlantEffect(place, partial(law, **parameters), truth=truth)


def output_saturation(rng, setting):
    return _levels_off(rng, "last", *setting.settled, setting, setting.unit)


def input_saturation(rng, setting):
    return _levels_off(rng, "first", *setting.drive, setting, 1.0)


def bend_arctan(signal, step, scale, bend):
    return scale / bend * np.arctan(bend * signal / scale)


def bend_root(signal, step, scale, bend):
    """Bend one way: u + b u^2 in the limit of small bends, with a root."""
    return scale / bend * (np.sqrt(1.0 + 2.0 * bend * signal / scale) - 1.0)


def static_nonlinearity(rng, setting):
    """A sensor whose law is an arc tangent, a root, or two straight lines that are rounded."""
    scale = np.abs(setting.response).max()
    share = rng.uniform(0.18, 0.3)  # departure at the peak
    if rng.random() < 0.5:
        law, bend = bend_arctan, np.sqrt(3.0 * share) * (1.0 + 1.1 * share)
    else:  # above -0.45, so that it is a root of what is above a tenth
        law, bend = bend_root, rng.choice([-1, 1]) * 1.4 * share
    truth = {"law": law.__name__, "bend": bend, "scale": setting.unit * scale}
    return PlantEffect("last", partial(law, scale=scale, bend=bend), truth=truth)


# ------------------------------------------------------------------------- transmission, motion


@numba.njit(cache=True)
def elastic_play(signal, step, half_width, tau):
    """Be drawn by springs at both ends of a slack against a viscous force.

    The force is that of the step's middle, so steps far below tau matter; it begins in the middle
    of the slack after a first loading.
    """
    out = np.empty(signal.size)
    y = np.sign(signal[0]) * max(abs(signal[0]) - half_width, 0.0)
    out[0] = y
    fade = 1.0 - np.exp(-step / tau)
    for i in range(1, signal.size):
        way = 0.5 * (signal[i] + signal[i - 1]) - y
        y += np.sign(way) * max(abs(way) - half_width, 0.0) * fade
        out[i] = y
    return out


def backlash(rng, setting):
    """A slack with elastic ends, from which the output creeps back for a few samples."""
    first = setting.declared == "second_order" and rng.random() < 0.5
    place, ends, unit = ("first", setting.drive, 1.0)
    if not first:
        place, ends, unit = ("last", setting.response, setting.unit)
    half_width = rng.uniform(0.04, 0.12) * np.ptp(ends) / 2
    tau = rng.uniform(0.3, 1.0)  # samples: the ends are stiff
    truth = {"place": place, "half_width": unit * half_width, "tau": tau * setting.dt}
    return PlantEffect(place, partial(elastic_play, half_width=half_width, tau=tau), truth=truth)


def friction(rng, setting):
    """Stribeck's fall by another curve than a bell: exponential, or one over a square."""
    coulomb = rng.uniform(0.04, 0.15)  # part of the largest drive
    fitted = np.concatenate([np.diff(drive) for drive in setting.drives[:N_TRAIN]])
    typical = np.sqrt(np.mean(np.square(fitted))) / np.abs(setting.drive).max()
    curve = int(rng.integers(1, 3))
    parameters = {
        "static": coulomb * rng.uniform(1.2, 1.7),
        "coulomb": coulomb,
        "velocity": rng.uniform(0.2, 1.0) * typical,
        "curve": curve,
    }

    def alter(plant, _):
        return plant.adapt("motion", coulomb_mode, **parameters)

    return PlantEffect(
        alter=alter, truth={"law": ("exponential", "square")[curve - 1], **parameters}
    )


def cubic_stiffness(rng, setting):
    """A spring that is stiffer beyond a gap, to both sides."""
    peak = np.abs(setting.response).max()
    parameters = {
        "gap": rng.uniform(0.2, 0.5) * peak,
        "stiffer": rng.uniform(0.3, 1.0),
    }

    def alter(plant, _):
        return plant.adapt("motion", stopped_mode, **parameters)

    return PlantEffect(alter=alter, truth={"law": "two springs", **parameters})


LAWS = {
    law.__name__: law
    for law in (
        rate_dependence,
        creep,
        output_saturation,
        input_saturation,
        static_nonlinearity,
        backlash,
        friction,
        cubic_stiffness,
    )
}
