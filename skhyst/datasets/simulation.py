"""Simulated plants with effects in them: of the devices, of the demo and of the blind study.

A :class:`Plant` is a signal path, a :class:`PlantEffect` what changes in it, or what is added to
its response. Stages of a path are called with a signal of shape (n_samples,) and the interval
between its samples, and return a signal. The laws below are such; their times count as the interval
does. A signal is a straight line between its samples, and its first value has stood since all
dynamics settled, after a first loading from zero. Laws that remember take a ``memory``, a dict that
is empty where a record begins: with it the next signal goes on where the last one has ended.

Nothing here uses the models that find effects: the two share the recording and nothing else.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache, partial
from inspect import signature

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq
from scipy.signal import lfilter

from .._jit import jit

__all__ = [
    "Plant",
    "PlantEffect",
    "bouc_wen",
    "clip",
    "dead_band",
    "dead_zones",
    "first_order",
    "kelvin_voigt",
    "oscillate",
    "plays",
    "pure_delay",
    "refine",
    "reversal_curves",
    "slew_limited",
]


@dataclass(frozen=True)
class Plant:
    """A signal path.

    Attributes
    ----------
    places : dict of str to tuple of callable
        The stages at each place, in the order of the path.

    Examples
    --------
    >>> from functools import partial
    >>> import numpy as np
    >>> from skhyst.datasets.simulation import PlantEffect, Plant, first_order, plays
    >>> core = partial(plays, thresholds=[0.0, 0.2], weights=[0.6, 0.4])
    >>> lag = PlantEffect("dynamics", partial(first_order, tau=0.1))
    >>> (plant,) = lag.changes([Plant({"core": (core,), "dynamics": ()})])
    >>> plant.respond(np.linspace(0.0, 1.0, 5), dt=0.1).round(2).tolist()
    [0.0, 0.06, 0.22, 0.44, 0.68]
    """

    places: dict[str, tuple[Callable, ...]]

    def insert(self, place, stage):
        """Return the plant with one more stage at the end of a place."""
        return Plant({**self.places, place: (*self.places[place], stage)})

    def adapt(self, place, law=None, **parameters):
        """Return the plant with parameters of the one stage of a place set, or another law."""
        (stage,) = self.places[place]
        adapted = partial(law or stage.func, **{**stage.keywords, **parameters})
        return Plant({**self.places, place: (adapted,)})

    def remembering(self):
        """Return the plant whose stages go on where the signal before has ended."""
        return Plant({place: tuple(map(remembers, self.places[place])) for place in self.places})

    def send(self, signal, step, *places):
        """Send a signal through some places, one after another."""
        for place in places:
            for stage in self.places[place]:
                signal = stage(signal, step)
        return signal

    def respond(self, drive, substeps=32, dt=1.0):
        """Return the response at the samples of a drive, computed at finer steps."""
        fine = self.send(refine(drive, substeps), dt / substeps, *self.places)
        return fine[::substeps]


@dataclass(frozen=True)
class PlantEffect:
    """How the plant of each record is changed, and what is added to each response.

    Attributes
    ----------
    place : str
        Where a stage is inserted.
    stage : callable, list of callable or None
        The stage; a list holds one for each record.
    alter : callable or None
        Instead, maps the plant of a record and its number to the changed plant.
    beside : list of ndarray of shape (n_samples,)
        What is added to the response of each record.
    column : (str, list of ndarray of shape (n_samples,))
        Name and values, record by record, of a column beside the drive.
    truth : dict
        Parameters, for whoever wants to know.
    """

    place: str = ""
    stage: Callable | list | None = None
    alter: Callable[[Plant, int], Plant] | None = None
    beside: list = field(default_factory=list)
    column: tuple[str, list] = ("", [])
    truth: dict = field(default_factory=dict)

    def changes(self, plants):
        """Return the plants of all records, changed."""
        if self.alter is not None:
            return [self.alter(plant, number) for number, plant in enumerate(plants)]
        if self.stage is None:
            return plants
        stages = self.stage if isinstance(self.stage, list) else [self.stage] * len(plants)
        return [p.insert(self.place, s) for p, s in zip(plants, stages, strict=True)]


def remembers(stage):
    """Return a stage with a memory of its own, where it can have one."""
    return partial(stage, memory={}) if "memory" in signature(stage).parameters else stage


# ------------------------------------------------------------------------------------------ laws


def refine(drive, substeps, memory=None):
    """Put ``substeps`` equal intervals between each two samples of a piecewise linear drive."""
    if memory:
        last, memory["last"] = memory["last"], drive[-1:]
        return refine(np.concatenate([last, drive]), substeps)[1:]
    if memory is not None:
        memory["last"] = drive[-1:]
    n = len(drive)
    fine = np.interp(np.arange((n - 1) * substeps + 1) / substeps, np.arange(n), drive)
    fine[::substeps] = drive
    return fine


def plays(signal, step, thresholds, weights, stretch=0.0, widening=0.0, memory=None):
    """Weighted sum of play operators, first loaded from zero.

    At the rate v of the signal a threshold r above zero is r (1 + stretch v) + widening v.
    """
    thresholds, weights = np.asarray(thresholds, float), np.asarray(weights, float)
    memory = {} if memory is None else memory
    if not memory:
        memory.update(states=np.zeros(thresholds.size), before=signal[0])
    out = _plays(signal, step, thresholds, weights, stretch, widening, **memory)
    memory["before"] = signal[-1]
    return out


@jit
def _plays(signal, step, thresholds, weights, stretch, widening, states, before):
    out = np.zeros(signal.size)
    for j in range(thresholds.size):
        r, state, last = thresholds[j], states[j], before
        for i in range(signal.size):
            way = abs(signal[i] - last)
            wide = r * (1.0 + stretch * way / step) + widening * way / step if r > 0.0 else r
            last = signal[i]
            state = max(last - wide, min(last + wide, state))
            out[i] += weights[j] * state
        states[j] = state
    return out


def reversal_curves(signal, step, slope, curvature, decay, memory=None):
    """Follow the same curve from every turning point of the signal, in the direction of its motion.

    At the distance s from the last turning point its slope is that of Ahmed and Yan (2021),
    equations (15) to (17): slope + curvature (1 - exp(-decay s)) / decay.
    """
    memory = {} if memory is None else memory
    state = memory.get("state", (0.0, 0.0, 1.0, 0.0, 0.0))
    out, memory["state"] = _reversal_curves(signal, slope, curvature, decay, state)
    return out


@jit
def _reversal_curves(signal, slope, curvature, decay, state):
    turning, base, direction, last, y = state
    out = np.empty(signal.size)
    for i in range(signal.size):
        if (signal[i] - last) * direction < 0.0:
            base, turning, direction = y, last, -direction
        s = abs(signal[i] - turning)
        bend = (s + np.expm1(-decay * s) / decay) / decay
        y = base + direction * (slope * s + curvature * bend)
        last = signal[i]
        out[i] = y
    return out, (turning, base, direction, last, y)


def slew_limited(signal, step, rate, memory=None):
    """Follow the signal, at most so fast."""
    memory = {} if memory is None else memory
    out = _slew_limited(signal, step * rate, memory.get("last", signal[0]))
    memory["last"] = out[-1]
    return out


@jit
def _slew_limited(signal, most, last):
    out = np.empty(signal.size)
    for i in range(signal.size):
        last += max(-most, min(most, signal[i] - last))
        out[i] = last
    return out


def clip(signal, step, low, high):
    """End at a lowest and a highest value."""
    return np.clip(signal, low, high)


def dead_band(signal, step, center, half_width):
    """Nothing within the band; beyond it what is left."""
    above = np.maximum(signal - center - half_width, 0.0)
    return above + np.minimum(signal - center + half_width, 0.0)


def dead_zones(signal, step, side, thresholds, weights):
    """Add one-sided dead zones, all on the positive (``side`` 1) or the negative side (-1)."""
    terms = zip(thresholds, weights, strict=True)
    return signal + side * sum(w * np.maximum(side * signal - r, 0.0) for r, w in terms)


def pure_delay(signal, step, delay, memory=None):
    """Shift in time."""
    memory = {} if memory is None else memory
    back = int(np.ceil(delay / step))
    line = np.concatenate([memory.get("past", np.full(back, signal[0])), signal])
    memory["past"] = line[signal.size :]
    return np.interp(np.arange(signal.size) + (back - delay / step), np.arange(line.size), line)


def first_order(signal, step, tau, memory=None):
    """Solve tau x' + x = u exactly."""
    memory = {} if memory is None else memory
    p = step / tau
    gone = -np.expm1(-p)
    ramp = 1.0 - gone / p if p > 1e-4 else 0.5 * p - p * p / 6.0
    start, gone_by = memory.get("start", signal[0]), memory.get("filter", np.zeros(1))
    away, gone_by = lfilter([ramp, gone - ramp], [1.0, gone - 1.0], signal - start, zi=gone_by)
    memory.update(start=start, filter=gone_by)
    return start + away


def kelvin_voigt(signal, step, taus, compliances, relax=first_order, memory=None):
    """Add a chain of Kelvin-Voigt units to the signal that loads them."""
    if memory is not None and not memory:
        memory["units"] = [remembers(relax) for _ in taus]
    units = zip(taus, compliances, memory["units"] if memory else [relax] * len(taus), strict=True)
    return signal + sum(c * unit(signal, step, tau) for tau, c, unit in units)


# ------------------------------------------------------------------------- equations of motion


@jit
def bouc_wen(h, du, limit, shape):
    """Advance dh = du (1 - |h| / limit (shape sign(h du) + 1 - shape)) exactly by a step du.

    With the shape 0.5 it unloads along a straight line, with 1 along an exponential.
    """
    if du == 0.0:
        return h
    side = 1.0 if du > 0.0 else -1.0
    q, s = side * h / limit, side * du / limit
    if q < 0.0:
        rate = 2.0 * shape - 1.0
        to_zero = np.log1p(-rate * q) / rate if abs(rate) > 1e-9 else -q
        if s <= to_zero:
            if abs(rate) > 1e-9:
                return side * limit * (q * np.exp(-rate * s) - np.expm1(-rate * s) / rate)
            return side * limit * (q + s)
        q, s = 0.0, s - to_zero
    return side * limit * (q * np.exp(-s) - np.expm1(-s))


@lru_cache
def _flow(w, c, base, step):
    """Return what takes (x, v, u, u') to x and v a step later."""
    law = np.zeros((4, 4))
    law[0, 1] = law[2, 3] = 1.0
    law[1] = [-w * w, -c, w * w, c * base]
    return expm(law * step)[:2].copy()


@jit
def _advance(signal, state, flow, step, pull, forces):
    """Advance x, v, z, h under a force and the last input, x in units of full scale."""
    cubic, friction, presliding, static, fading, hysteretic, width = forces
    x, v, z, h, force, u = state
    out = np.empty(signal.size)
    for i in range(signal.size):
        v -= 0.5 * step * force
        rate, before = (signal[i] - u) / step, x
        x, v = (
            flow[0, 0] * x + flow[0, 1] * v + flow[0, 2] * u + flow[0, 3] * rate,
            flow[1, 0] * x + flow[1, 1] * v + flow[1, 2] * u + flow[1, 3] * rate,
        )
        level = 1.0 + (static - 1.0) * np.exp(-((v / fading) ** 2))
        # the bristles bend by the way, towards the level of sliding
        z = bouc_wen(z, (x - before) / presliding, level, 1.0)
        h = bouc_wen(h, x - before, width, 0.5)
        force = pull * (cubic * x * x * x + friction * z + hysteretic * h / width)
        v -= 0.5 * step * force
        u = signal[i]
        out[i] = x
    return out, (x, v, z, h, force, u)


def oscillate(
    signal,
    step,
    frequency,
    damping,
    base=0.0,
    scale=1.0,
    cubic=0.0,
    friction=0.0,
    presliding=1.0,
    static=1.0,
    stribeck=1.0,
    hysteretic=0.0,
    width=1.0,
    memory=None,
):
    """Solve the motion x of a mode that a signal u drives, with forces f beside its spring.

        x'' = w^2 (u - x) + 2 damping w (base u' - x') - w^2 Y f,    w = 2 pi frequency,
        f = cubic (x / Y)^3 + friction z + hysteretic h

    The displacement has the full scale Y, `scale`. The friction z, which is 1 in fast sliding and
    `static` before it slides, the excess fading over a velocity of `stribeck` w Y, builds up over
    the way `presliding` Y, the Bouc-Wen force h over `width` Y.

    Without f the motion is exact, by the exponential of the matrix; f acts as half a kick before
    and half a kick after each step (Strang splitting), and is of second order in the step.
    """
    w = 2.0 * np.pi * frequency
    flow = _flow(w, 2.0 * damping * w, base, step)
    scaled = np.ascontiguousarray(signal, dtype=float) / scale
    forces = tuple(
        map(float, (cubic, friction, presliding, static, stribeck * w, hysteretic, width))
    )
    if memory:
        out, memory["state"] = _advance(scaled, memory["state"], flow, step, w * w, forces)
        return scale * out
    x, h = _equilibrium(scaled[0], cubic, hysteretic, width)
    force = w * w * (cubic * x * x * x + hysteretic * h / width)
    start = (x, 0.0, 0.0, h, force, scaled[0])
    out, state = _advance(scaled[1:], start, flow, step, w * w, forces)
    if memory is not None:
        memory["state"] = state
    return scale * np.concatenate([[x], out])


def _equilibrium(u, cubic, hysteretic, width):
    """Return where a mode rests under a drive, and the state of its hysteresis."""

    def excess(x):
        h = bouc_wen(0.0, x, width, 0.5)
        return x + cubic * x**3 + hysteretic * h / width - u

    x = u
    if cubic != 0.0 or hysteretic != 0.0:
        x = brentq(excess, -abs(x) - 1e-300, abs(x) + 1e-300, xtol=1e-300, rtol=1e-14)
    return x, bouc_wen(0.0, x, width, 0.5)
