"""Structures that no effect, and no combination of effects, expresses."""

from functools import partial

import numba
import numpy as np

from skhyst.datasets.simulation import PlantEffect, refine

from .physics import PARTS, WEIGHTS, delayed_by_itself, first_order, modulated, pinned
from .signals import log_uniform


def _unit_drives(setting):
    return [drive / np.abs(setting.drive).max() for drive in setting.drives]


def parametric_resonance(rng, setting):
    """Let the spring of the mode pulsate at a frequency of its own."""
    depth = rng.uniform(0.15, 0.3)
    pump = rng.uniform(0.3, 0.7) * setting.mode
    phases = rng.uniform(0, 2 * np.pi, len(setting.lengths))
    truth = {"depth": depth, "frequency": pump / setting.dt}

    def alter(plant, number):
        return plant.adapt("motion", depth=depth, pump=pump, phase=phases[number])

    return PlantEffect(alter=alter, truth=truth)


@numba.njit(cache=True)
def van_der_pol(signal, step, frequency, strength, pull, push, x, v):
    """Solve x'' - s w (1 - x^2) x' + w^2 (1 + pull u) x = w^2 push u by Runge-Kutta steps."""
    w = 2.0 * np.pi * frequency
    out = np.empty(signal.size)
    out[0] = x
    for i in range(1, signal.size):
        u0, u2 = signal[i - 1], signal[i]
        drives = (u0, 0.5 * (u0 + u2), 0.5 * (u0 + u2), u2)
        dx = dv = sum_x = sum_v = 0.0
        for k in range(4):
            u, y, dx = drives[k], x + PARTS[k] * step * dx, v + PARTS[k] * step * dv
            dv = strength * w * (1.0 - y * y) * dx - w * w * ((1.0 + pull * u) * y - push * u)
            sum_x += WEIGHTS[k] * dx
            sum_v += WEIGHTS[k] * dv
        x += step / 6.0 * sum_x
        v += step / 6.0 * sum_v
        out[i] = x
    return out


def self_oscillation(rng, setting):
    """Add an oscillation that keeps itself going, at a frequency that the drive pulls."""
    frequency, strength = 1.0 / log_uniform(rng, 40, 120), rng.uniform(0.8, 2.0)
    pull, push = rng.uniform(0.4, 0.7), rng.uniform(0.3, 0.8)
    size = rng.uniform(0.015, 0.035) * np.ptp(setting.response) / 2
    n = setting.substeps
    additive = [
        size
        * van_der_pol(
            refine(u, n), 1.0 / n, frequency, strength, pull, push, rng.uniform(-2, 2), 0.0
        )[::n]
        for u in _unit_drives(setting)
    ]
    truth = {"frequency": frequency / setting.dt, "strength": strength, "pull": pull}
    return PlantEffect(additive=additive, truth=truth)


def volterra_product(rng, setting):
    """Add the product of the drive behind one lag and of its change behind another."""
    short, long = log_uniform(rng, 5, 15), log_uniform(rng, 40, 120)
    n = setting.substeps
    products = []
    for u in _unit_drives(setting):
        fine = refine(u, n)
        slow = first_order(fine, 1.0 / n, long)
        quick = fine - first_order(fine, 1.0 / n, short)
        products.append((slow * quick)[::n])
    size = rng.uniform(0.02, 0.04) * np.ptp(setting.response)
    size /= np.sqrt(np.mean(np.square(np.concatenate(products))))
    truth = {"taus": (short * setting.dt, long * setting.dt)}
    return PlantEffect(additive=[size * product for product in products], truth=truth)


def switching_gain(rng, setting):
    """Let the gain jump between two values at random times."""
    jump = rng.uniform(0.1, 0.2)
    stages = []
    for n in setting.lengths:
        gains, start, state = np.empty(n), 0, rng.choice([-1.0, 1.0])
        while start < n:
            stop = start + int(log_uniform(rng, 60, 350))
            gains[start:stop] = 1.0 + 0.5 * jump * state
            start, state = stop, -state
        stages.append(partial(modulated, gains=gains))
    return PlantEffect("last", stages, truth={"jump": jump})


def wandering_gain(rng, setting):
    """Let slow oscillators of its own modulate the gain."""
    depth, frequency = rng.uniform(0.06, 0.12), 1.0 / log_uniform(rng, 120, 500)
    stages = []
    for n in setting.lengths:
        t = np.arange(n)
        phase = 2 * np.pi * (frequency * t + rng.random()) + 2.0 * np.sin(
            2 * np.pi * (0.31 * frequency * t + rng.random())
        )
        stages.append(partial(modulated, gains=1.0 + depth * np.sin(phase)))
    return PlantEffect("last", stages, truth={"depth": depth, "frequency": frequency / setting.dt})


@numba.njit(cache=True)
def lorenz(signal, step, rate, push, state):
    """Solve the Lorenz equations, the drive pushing the first, by Runge-Kutta steps."""
    out = np.empty(signal.size)
    k = np.empty((4, 3))
    h = step * rate
    for i in range(signal.size):
        out[i] = state[0]
        for j in range(4):
            x, y, z = state + PARTS[j] * h * k[j - 1] if j else state
            k[j, 0] = 10.0 * (y - x) + push * signal[i]
            k[j, 1] = x * (28.0 - z) - y
            k[j, 2] = x * y - 8.0 / 3.0 * z
        state = state + h / 6.0 * (k[0] + 2.0 * k[1] + 2.0 * k[2] + k[3])
    return out


def chaotic_neighbour(rng, setting):
    """Add the motion of a chaotic system that the drive pushes a little."""
    rate, push = 1.0 / log_uniform(rng, 25, 70), rng.uniform(5, 15)
    size = rng.uniform(0.015, 0.04) * np.ptp(setting.response) / 15.0
    n = setting.substeps
    additive = []
    for u in _unit_drives(setting):
        start = np.array([1.0, 1.0, 25.0]) + rng.uniform(-5, 5, 3)
        additive.append(size * lorenz(refine(u, n), 1.0 / n, rate, push, start)[::n])
    return PlantEffect(additive=additive, truth={"rate": rate / setting.dt})


def state_dependent_delay(rng, setting):
    """Delay the response the longer, the larger it is."""
    shortest, growth = rng.uniform(0.0, 2.0), rng.uniform(5, 12)
    growth /= np.abs(setting.response).max()
    truth = {"shortest": shortest * setting.dt, "growth": growth * setting.dt / setting.unit}
    stage = partial(delayed_by_itself, shortest=shortest, growth=growth)
    return PlantEffect("last", stage, truth=truth)


def random_pinning(rng, setting):
    """Let the response stick at obstacles that are different each time."""
    low, high = np.array([0.01, 0.06]) * rng.uniform(0.7, 1.3) * np.ptp(setting.response)
    stages = [partial(pinned, obstacles=log_uniform(rng, low, high, 4096)) for _ in setting.lengths]
    return PlantEffect(
        "last", stages, truth={"obstacles": (setting.unit * low, setting.unit * high)}
    )


LAWS = {
    law.__name__: law
    for law in (
        parametric_resonance,
        self_oscillation,
        volterra_product,
        switching_gain,
        wandering_gain,
        chaotic_neighbour,
        state_dependent_delay,
        random_pinning,
    )
}
NEEDS_MODE = ("parametric_resonance",)
