"""Simulated plants with effects in them: of the devices, of the demo and of the blind study.

A :class:`Plant` is a signal path, an :class:`Effect` what changes in it, or what is added to its
response. Stages of a path are called with a signal of shape (n_samples,) and the interval between
its samples, and return a signal. The laws below are such; their times count as the interval does.
A signal is a straight line between its samples, and its first value has stood since all dynamics
settled, after a first loading from zero.

Nothing here uses the models that find effects: the two share the recording and nothing else.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq
from scipy.signal import lfilter

from .._jit import jit

__all__ = [
    "Effect",
    "Plant",
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
    >>> from skhyst.datasets.simulation import Effect, Plant, first_order, plays
    >>> core = partial(plays, thresholds=[0.0, 0.2], weights=[0.6, 0.4])
    >>> lag = Effect("dynamics", partial(first_order, tau=0.1))
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
class Effect:
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


# ------------------------------------------------------------------------------------------ laws


def refine(drive, substeps):
    """Put ``substeps`` equal intervals between each two samples of a piecewise linear drive."""
    n = len(drive)
    fine = np.interp(np.arange((n - 1) * substeps + 1) / substeps, np.arange(n), drive)
    fine[::substeps] = drive
    return fine


def plays(signal, step, thresholds, weights, stretch=0.0, widening=0.0):
    """Weighted sum of play operators, first loaded from zero.

    At the rate v of the signal a threshold r above zero is r (1 + stretch v) + widening v.
    """
    thresholds, weights = np.asarray(thresholds, float), np.asarray(weights, float)
    return _plays(signal, step, thresholds, weights, stretch, widening)


@jit
def _plays(signal, step, thresholds, weights, stretch, widening):
    out = np.zeros(signal.size)
    for j in range(thresholds.size):
        r, state, before = thresholds[j], 0.0, signal[0]
        for i in range(signal.size):
            way = abs(signal[i] - before)
            wide = r * (1.0 + stretch * way / step) + widening * way / step if r > 0.0 else r
            before = signal[i]
            state = max(before - wide, min(before + wide, state))
            out[i] += weights[j] * state
    return out


@jit
def slew_limited(signal, step, rate):
    """Follow the signal, at most so fast."""
    out = np.empty(signal.size)
    out[0] = signal[0]
    for i in range(1, signal.size):
        way = signal[i] - out[i - 1]
        out[i] = out[i - 1] + max(-rate * step, min(rate * step, way))
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


def pure_delay(signal, step, delay):
    """Shift in time."""
    time = step * np.arange(signal.size)
    return np.interp(time - delay, time, signal)


def first_order(signal, step, tau):
    """Solve tau x' + x = u exactly."""
    p = step / tau
    gone = -np.expm1(-p)
    ramp = 1.0 - gone / p if p > 1e-4 else 0.5 * p - p * p / 6.0
    start = signal[0]
    return start + lfilter([ramp, gone - ramp], [1.0, gone - 1.0], signal - start)


def kelvin_voigt(signal, step, taus, compliances, relax=first_order):
    """Add a chain of Kelvin-Voigt units to the signal that loads them."""
    units = zip(taus, compliances, strict=True)
    return signal + sum(c * relax(signal, step, tau) for tau, c in units)


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


@jit
def _advance(signal, x, h, flow, step, pull, forces):
    """Advance from rest; ``flow`` maps (x, v, u, u') over a step, x in units of full scale."""
    cubic, friction, presliding, static, fading, hysteretic, width = forces
    out = np.empty(signal.size)
    v = z = 0.0
    out[0] = x
    force = pull * (cubic * x * x * x + hysteretic * h / width)
    for i in range(1, signal.size):
        v -= 0.5 * step * force
        u, rate, before = signal[i - 1], (signal[i] - signal[i - 1]) / step, x
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
        out[i] = x
    return out


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
    c = 2.0 * damping * w
    law = np.zeros((4, 4))  # of x, v, u, u'
    law[0, 1] = law[2, 3] = 1.0
    law[1] = [-w * w, -c, w * w, c * base]
    flow = expm(law * step)[:2].copy()
    scaled = np.ascontiguousarray(signal, dtype=float) / scale

    def excess(x):
        h = bouc_wen(0.0, x, width, 0.5)
        return x + cubic * x**3 + hysteretic * h / width - scaled[0]

    x = scaled[0]
    if cubic != 0.0 or hysteretic != 0.0:
        x = brentq(excess, -abs(x) - 1e-300, abs(x) + 1e-300, xtol=1e-300, rtol=1e-14)
    h = bouc_wen(0.0, x, width, 0.5)
    forces = (cubic, friction, presliding, static, stribeck * w, hysteretic, width)
    return scale * _advance(scaled, x, h, flow, step, w * w, tuple(map(float, forces)))
