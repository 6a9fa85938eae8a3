"""Further forms of effects that laboratories have than those of `effects` and of `other_laws`."""

from functools import partial

import numba
import numpy as np

from skhyst.datasets.simulation import PlantEffect, plays

from .motion import coulomb_mode
from .physics import PARTS, WEIGHTS, first_order
from .signals import N_TRAIN, draw_column, log_uniform


def biased(signal, step, bias):
    """Add what is a straight line between samples."""
    return signal + np.interp(step * np.arange(signal.size), np.arange(bias.size), bias)


def auxiliary_input(rng, setting):
    """A further column acts on what drives the actuator, at once or behind a lag of its own."""
    name, column, middle, size = draw_column(rng, setting.lengths)
    strength = rng.choice([-1, 1]) * rng.uniform(0.05, 0.15) * np.ptp(setting.drive) / 2
    units = [(values - middle) / size for values in column]
    truth = {"law": "bias", "column": name, "gain": strength / size}
    if rng.random() < 0.5:
        tau = log_uniform(rng, 15, 120)
        truth |= {"law": "bias behind a lag", "tau": tau * setting.dt}
        units = [first_order(part, 1.0, tau) for part in units]
    stages = [partial(biased, bias=strength * part) for part in units]
    return PlantEffect("first", stages, column=(name, column), truth=truth)


@numba.njit(cache=True)
def knocking_mode(signal, step, frequency, damping, low, high, stiffer, damper):
    """Add a spring `stiffer` times as stiff, and a damper, below `low` and above `high`.

    `damper` is the damping ratio, of the mode, that it adds.
    """
    w = 2.0 * np.pi * frequency
    a, b, more = w * w, 2.0 * damping * w, 2.0 * damper * w
    out = np.empty(signal.size)
    x, v = signal[0], 0.0
    if x > high:
        x = (x + stiffer * high) / (1.0 + stiffer)
    elif x < low:
        x = (x + stiffer * low) / (1.0 + stiffer)
    out[0] = x
    for i in range(1, signal.size):
        u0, u2 = signal[i - 1], signal[i]
        drives = (u0, 0.5 * (u0 + u2), 0.5 * (u0 + u2), u2)
        dx = dv = sum_x = sum_v = 0.0
        for k in range(4):
            y, ahead = x + PARTS[k] * step * dx, v + PARTS[k] * step * dv
            beyond = max(y - high, 0.0) - max(low - y, 0.0)
            force = a * stiffer * beyond + (more * ahead if beyond != 0.0 else 0.0)
            dv = a * (drives[k] - y) - b * ahead - force
            dx = ahead
            sum_x += WEIGHTS[k] * dx
            sum_v += WEIGHTS[k] * dv
        x += step / 6.0 * sum_x
        v += step / 6.0 * sum_v
        out[i] = x
    return out


def end_stops(rng, setting):
    """Stops at one end of the motion or at both, at places of their own."""
    low, high = setting.response
    sides = rng.integers(3)  # high, low, both
    parameters = {
        "low": low * rng.uniform(0.5, 0.85) if sides != 0 else -np.inf,
        "high": high * rng.uniform(0.5, 0.85) if sides != 1 else np.inf,
        "stiffer": log_uniform(rng, 5, 50),
        "damper": rng.uniform(0.1, 1.0) if rng.random() < 0.5 else 0.0,
    }
    return PlantEffect(
        alter=lambda plant, _: plant.adapt("motion", knocking_mode, **parameters), truth=parameters
    )


def folded(signal, step, center):
    return np.abs(signal - center)


def rectification(rng, setting):
    """The sensor reads how far the response is from a place, and not to which side."""
    low, high = setting.response
    center = low + rng.uniform(0.2, 0.8) * (high - low)
    return PlantEffect(
        "last", partial(folded, center=center), truth={"center": setting.unit * center}
    )


def friction(rng, setting):
    """Stiction: it sticks at twice what it slides at, however slowly."""
    coulomb = rng.uniform(0.04, 0.1)  # part of the largest drive
    fitted = np.concatenate([np.diff(drive) for drive in setting.drives[:N_TRAIN]])
    typical = np.sqrt(np.mean(np.square(fitted))) / np.abs(setting.drive).max()
    parameters = {
        "static": coulomb * rng.uniform(1.8, 2.5),
        "coulomb": coulomb,
        "velocity": rng.uniform(0.05, 0.2) * typical,
    }
    return PlantEffect(
        alter=lambda plant, _: plant.adapt("motion", coulomb_mode, **parameters), truth=parameters
    )


def backlash(rng, setting):
    """A play of the displacement in front of a force."""
    half_width = rng.uniform(0.04, 0.12) * np.ptp(setting.drive) / 2
    play = partial(plays, thresholds=[half_width], weights=[1.0])
    return PlantEffect("first", play, truth={"half_width": half_width})


LAWS = {
    law.__name__: law for law in (auxiliary_input, end_stops, rectification, friction, backlash)
}
MATRIX = {
    "prandtl_ishlinskii": ("auxiliary_input",),
    "cascade": ("auxiliary_input", "rectification"),
    "bouc_wen": ("auxiliary_input", "backlash"),
    "second_order": ("auxiliary_input", "end_stops", "friction", "rectification"),
}
