"""Simulated plants with known effects: for the devices, the demo and the blind study.

A :class:`Plant` is a signal path; a :class:`PlantEffect` is a change of it, or a signal added to
its response. Stages of a path are called with a signal of shape (n_samples,) and the interval
between its samples, and return a signal. The laws below are such stages; their times have the unit
of the interval. A signal is a straight line between its samples, and its first value has been
applied until all dynamics settled, after a first loading from zero. Laws with memory take a
``memory``, a dict that is empty at the beginning of a record: with it the next signal continues
where the last one has ended.

Nothing here uses the models that find effects: the two have only the recording in common.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache, partial
from inspect import signature

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq
from scipy.signal import lfilter

from .._documentation import documented_like
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

    Parameters
    ----------
    places : dict of str to tuple of callable
        The stages at each place, in the order of the path.

    See Also
    --------
    PlantEffect : A change of it.
    skhyst.datasets.DeviceStepper : A device sample by sample, in a loop.

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
        """Return the plant with one more stage at the end of a place.

        Parameters
        ----------
        place : str
            A key of ``places``.
        stage : callable
            ``stage(signal, step)`` returns a signal.

        Returns
        -------
        Plant
            A copy.
        """
        return Plant({**self.places, place: (*self.places[place], stage)})

    def adapt(self, place, law=None, **parameters):
        """Return the plant with other parameters of the one stage of a place, or another law.

        Parameters
        ----------
        place : str
            A key of ``places``, with one stage.
        law : callable, default=None
            Function of the stage; None: its present one.
        **parameters : object
            Keyword arguments of the law, which replace those of the stage.

        Returns
        -------
        Plant
            A copy.
        """
        (stage,) = self.places[place]
        adapted = partial(law or stage.func, **{**stage.keywords, **parameters})
        return Plant({**self.places, place: (adapted,)})

    def remembering(self):
        """Return the plant with stages that continue where the last signal has ended.

        Returns
        -------
        Plant
            A copy, for a drive in consecutive parts.
        """
        return Plant({place: tuple(map(remembers, self.places[place])) for place in self.places})

    def send(self, signal, step, *places):
        """Send a signal through some places, one after another.

        Parameters
        ----------
        signal : ndarray of shape (n_samples,)
            Input of the first place.
        step : float
            Interval between the samples, in the unit of the laws' times.
        *places : str
            Keys of ``places``.

        Returns
        -------
        ndarray of shape (n_samples,)
            Output of the last place.
        """
        for place in places:
            for stage in self.places[place]:
                signal = stage(signal, step)
        return signal

    def respond(self, drive, substeps=32, dt=1.0):
        """Return the response at the samples of a drive, computed at finer steps.

        Parameters
        ----------
        drive : ndarray of shape (n_samples,)
            A straight line between its samples.
        substeps : int, default=32
            Steps per interval.
        dt : float, default=1.0
            Interval of the drive, in the unit of the laws' times.

        Returns
        -------
        ndarray of shape (n_samples,)
            Response at the samples of the drive.
        """
        fine = self.send(refine(drive, substeps), dt / substeps, *self.places)
        return fine[::substeps]


@dataclass(frozen=True)
class PlantEffect:
    """Change of the plant for each record, and signal added to each response.

    Parameters
    ----------
    place : str, default=""
        Where a stage is inserted.
    stage : callable, list of callable or None, default=None
        The stage; a list holds one for each record.
    alter : callable, default=None
        Instead, maps the plant of a record and its number to the changed plant.
    additive : list of ndarray of shape (n_samples,), default=[]
        Signal added to the response of each record; empty: none.
    column : (str, list of ndarray of shape (n_samples,)), default=("", [])
        Name and values, record by record, of a further column of X.
    truth : dict, default={}
        True parameters of the effect, by name.

    See Also
    --------
    Plant : What it changes.
    """

    place: str = ""
    stage: Callable | list | None = None
    alter: Callable[[Plant, int], Plant] | None = None
    additive: list = field(default_factory=list)
    column: tuple[str, list] = ("", [])
    truth: dict = field(default_factory=dict)

    def changes(self, plants):
        """Return the plants of all records, changed.

        Parameters
        ----------
        plants : list of Plant
            One per record.

        Returns
        -------
        list of Plant
            One per record; the given one if nothing is inserted or altered.
        """
        if self.alter is not None:
            return [self.alter(plant, number) for number, plant in enumerate(plants)]
        if self.stage is None:
            return plants
        stages = self.stage if isinstance(self.stage, list) else [self.stage] * len(plants)
        return [p.insert(self.place, s) for p, s in zip(plants, stages, strict=True)]


def remembers(stage):
    """Return a stage that keeps its state between signals, if its law takes a ``memory``."""
    return partial(stage, memory={}) if "memory" in signature(stage).parameters else stage


# ------------------------------------------------------------------------------------------ laws


def refine(drive, substeps, memory=None):
    """Put ``substeps`` equal intervals between each two samples of a piecewise linear drive.

    Parameters
    ----------
    drive : ndarray of shape (n_samples,)
        A straight line between its samples.
    substeps : int
        Intervals between two samples.
    memory : dict, default=None
        State between signals: empty where a record begins. None: the signal is a record.

    Returns
    -------
    ndarray of shape ((n_samples - 1) * substeps + 1,)
        Drive at the finer samples; ``n_samples * substeps`` of them if it continues an earlier
        signal.

    See Also
    --------
    Plant.respond : Response at such finer steps.
    skhyst.records.resample_records : Other rates for recordings.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.datasets.simulation import refine
    >>> refine(np.array([0.0, 1.0, 0.0]), 2)
    array([0. , 0.5, 1. , 0.5, 0. ])
    """
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
    """Return a weighted sum of play operators, first loaded from zero.

    At the rate v of the signal a threshold r above zero is ``r (1 + stretch v) + widening v``.

    Parameters
    ----------
    signal : ndarray of shape (n_samples,)
        Input.
    step : float
        Interval between the samples, in the unit of the law's times.
    thresholds, weights : array-like of shape (n_plays,)
        Half widths of the plays, in units of the signal, and their factors.
    stretch : float, default=0.0
        Relative growth of the thresholds, one over the unit of the rate.
    widening : float, default=0.0
        Absolute growth of the thresholds, in the unit of time.
    memory : dict, default=None
        State between signals: empty where a record begins. None: the signal is a record.

    Returns
    -------
    ndarray of shape (n_samples,)
        Output at the samples.

    See Also
    --------
    reversal_curves : Curves that bend from every turning point.
    skhyst.hysteresis.PrandtlIshlinskii : The model with such operators.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.datasets.simulation import plays
    >>> plays(np.array([0.0, 2.0, 0.0]), 1.0, thresholds=[0.0, 1.0], weights=[1.0, 0.5])
    array([0. , 2.5, 0.5])
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
            change = abs(signal[i] - last)
            wide = r * (1.0 + stretch * change / step) + widening * change / step if r > 0.0 else r
            last = signal[i]
            state = max(last - wide, min(last + wide, state))
            out[i] += weights[j] * state
        states[j] = state
    return out


@documented_like(plays)
def reversal_curves(signal, step, slope, curvature, decay, memory=None):
    """Follow the same curve from every turning point of the signal, in the direction of its motion.

    At the distance s from the last turning point its slope is
    ``slope + curvature (1 - exp(-decay s)) / decay``.

    Parameters
    ----------
    slope : float
        Slope at the turning point.
    curvature : float
        Derivative of the slope there.
    decay : float
        Rate at which the curvature decays, one over the unit of the signal.

    See Also
    --------
    plays : Hysteresis with piecewise linear branches.
    skhyst.hysteresis.SystemLevelHysteresis : The model of such curves.

    References
    ----------
    Ahmed and Yan, *IEEE Access*, 2021, equations (15) to (17).

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.datasets.simulation import reversal_curves
    >>> triangle = np.array([0.0, 1.0, 0.0])
    >>> reversal_curves(triangle, 1.0, slope=1.0, curvature=0.5, decay=1.0).round(3)
    array([0.   , 1.184, 0.   ])
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


@documented_like(plays)
def slew_limited(signal, step, rate, memory=None):
    """Limit the rate of the signal: the output follows it no faster than ``rate``.

    Parameters
    ----------
    rate : float
        Largest rate of the output, units of the signal over the unit of time.

    See Also
    --------
    clip : Limit the values.
    skhyst.hysteresis.SlewLimit : The model.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.datasets.simulation import slew_limited
    >>> slew_limited(np.array([0.0, 5.0, 5.0]), 1.0, rate=2.0)
    array([0., 2., 4.])
    """
    memory = {} if memory is None else memory
    out = _slew_limited(signal, step * rate, memory.get("last", signal[0]))
    memory["last"] = out[-1]
    return out


@jit
def _slew_limited(signal, largest_change, last):
    out = np.empty(signal.size)
    for i in range(signal.size):
        last += max(-largest_change, min(largest_change, signal[i] - last))
        out[i] = last
    return out


@documented_like(plays)
def clip(signal, step, low, high):
    """Limit the signal to a lowest and a highest value.

    Parameters
    ----------
    low, high : float
        Limits, units of the signal.

    See Also
    --------
    slew_limited : Limit the rate.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.datasets.simulation import clip
    >>> clip(np.array([-2.0, 0.5, 2.0]), 1.0, low=-1.0, high=1.0)
    array([-1. ,  0.5,  1. ])
    """
    return np.clip(signal, low, high)


@documented_like(plays)
def dead_band(signal, step, center, half_width):
    """Return zero within a band, and the distance from its nearer edge beyond it.

    Parameters
    ----------
    center, half_width : float
        Centre and half width of the band, units of the signal.

    See Also
    --------
    dead_zones : One-sided, several, and added to the signal.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.datasets.simulation import dead_band
    >>> dead_band(np.array([-2.0, 0.5, 2.0]), 1.0, center=0.0, half_width=1.0)
    array([-1.,  0.,  1.])
    """
    above = np.maximum(signal - center - half_width, 0.0)
    return above + np.minimum(signal - center + half_width, 0.0)


@documented_like(plays)
def dead_zones(signal, step, side, thresholds, weights):
    """Add one-sided dead zones, all on the positive or all on the negative side.

    Parameters
    ----------
    side : {1, -1}
        The side: 1 positive, -1 negative.
    thresholds, weights : array-like of shape (n_zones,)
        Distances from zero where the zones begin, units of the signal, and their slopes.

    See Also
    --------
    dead_band : Zero within a band.
    skhyst.hysteresis.ModifiedPrandtlIshlinskii : The model with dead zones.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.datasets.simulation import dead_zones
    >>> dead_zones(np.array([-2.0, 0.5, 2.0]), 1.0, side=1, thresholds=[1.0], weights=[0.5])
    array([-2. ,  0.5,  2.5])
    """
    terms = zip(thresholds, weights, strict=True)
    return signal + side * sum(w * np.maximum(side * signal - r, 0.0) for r, w in terms)


@documented_like(plays)
def pure_delay(signal, step, delay, memory=None):
    """Delay the signal.

    Parameters
    ----------
    delay : float
        In the unit of time; between samples the signal is a straight line.

    See Also
    --------
    first_order : A lag.
    skhyst.linear.Delay : The model.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.datasets.simulation import pure_delay
    >>> pure_delay(np.array([0.0, 1.0, 0.0]), 1.0, delay=0.5)
    array([0. , 0.5, 0.5])
    """
    memory = {} if memory is None else memory
    n_past = int(np.ceil(delay / step))
    line = np.concatenate([memory.get("past", np.full(n_past, signal[0])), signal])
    memory["past"] = line[signal.size :]
    return np.interp(np.arange(signal.size) + (n_past - delay / step), np.arange(line.size), line)


@documented_like(plays)
def first_order(signal, step, tau, memory=None):
    """Return the solution of ``tau x' + x = u``, exact for a piecewise linear signal.

    Parameters
    ----------
    tau : float
        Time constant, in the unit of time.

    See Also
    --------
    kelvin_voigt : Creep by several lags.
    skhyst.linear.FirstOrderLag : The model.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.datasets.simulation import first_order
    >>> first_order(np.array([0.0, 1.0, 1.0]), 1.0, tau=1.0).round(3)
    array([0.   , 0.368, 0.767])
    """
    memory = {} if memory is None else memory
    p = step / tau
    settled = -np.expm1(-p)
    # the difference loses digits at small p: there the first terms of its Taylor series
    ramp = 1.0 - settled / p if p > 1e-4 else 0.5 * p - p * p / 6.0
    start, state = memory.get("start", signal[0]), memory.get("filter", np.zeros(1))
    output, state = lfilter([ramp, settled - ramp], [1.0, settled - 1.0], signal - start, zi=state)
    memory.update(start=start, filter=state)
    return start + output


@documented_like(plays)
def kelvin_voigt(signal, step, taus, compliances, relax=first_order, memory=None):
    """Add creep: the outputs of Kelvin-Voigt units, which relax towards the signal.

    Parameters
    ----------
    taus, compliances : array-like of shape (n_units,)
        Time constants, in the unit of time, and gains of the units.
    relax : callable, default=first_order
        Law of one unit, called as ``relax(signal, step, tau)``.

    See Also
    --------
    first_order : One unit.
    skhyst.linear.KelvinVoigt : The model.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.datasets.simulation import kelvin_voigt
    >>> kelvin_voigt(np.array([0.0, 1.0, 1.0]), 1.0, taus=[1.0], compliances=[0.1]).round(3)
    array([0.   , 1.037, 1.077])
    """
    if memory is not None and not memory:
        memory["units"] = [remembers(relax) for _ in taus]
    units = zip(taus, compliances, memory["units"] if memory else [relax] * len(taus), strict=True)
    return signal + sum(c * unit(signal, step, tau) for tau, c, unit in units)


# ------------------------------------------------------------------------- equations of motion


@jit
def bouc_wen(h, du, limit, shape):
    """Advance ``dh = du (1 - |h| / limit (shape sign(h du) + 1 - shape))`` exactly by a step du.

    Parameters
    ----------
    h : float
        Hysteretic force before the step, units of the displacement.
    du : float
        Step of the displacement.
    limit : float
        Largest force, units of the displacement.
    shape : float
        With 0.5 the force unloads along a straight line, with 1 along an exponential.

    Returns
    -------
    float
        The force after the step.

    See Also
    --------
    oscillate : A mode with this force.
    skhyst.hysteresis.BoucWen : The model.

    Examples
    --------
    >>> from skhyst.datasets.simulation import bouc_wen
    >>> round(bouc_wen(0.0, 1.0, 1.0, 0.5), 3)
    0.632
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
    """Return the matrix that maps (x, v, u, u') to x and v one step later, with u' constant."""
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
        # the deflection of the bristles follows the motion, towards the level of sliding
        z = bouc_wen(z, (x - before) / presliding, level, 1.0)
        h = bouc_wen(h, x - before, width, 0.5)
        force = pull * (cubic * x * x * x + friction * z + hysteretic * h / width)
        v -= 0.5 * step * force
        u = signal[i]
        out[i] = x
    return out, (x, v, z, h, force, u)


@documented_like(plays)
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
    """Return the motion x of a mode driven by a signal u, with forces f in parallel to its spring.

        x'' = w^2 (u - x) + 2 damping w (base u' - x') - w^2 Y f,    w = 2 pi frequency,
        f = cubic (x / Y)^3 + friction z + hysteretic h

    The displacement has the full scale Y, ``scale``. The friction z, which is 1 in fast sliding and
    ``static`` before it slides, the excess fading over a velocity of ``stribeck`` w Y, builds up
    over the displacement ``presliding`` Y, the Bouc-Wen force h over ``width`` Y.

    Without f the motion is exact, by the exponential of the matrix; f enters as half
    an impulse before and half an impulse after each step (Strang splitting), with an error of
    second order in the step.

    Parameters
    ----------
    frequency : float
        Natural frequency, one over the unit of time.
    damping : float
        Damping ratio.
    base : float, default=0.0
        1 where the damper stands on the base that the signal moves, 0 where on the ground.
    scale : float, default=1.0
        Full scale Y of the displacement, units of the signal.
    cubic, friction : float, default=0.0
        Factors of these forces.
    presliding : float, default=1.0
        Displacement over which friction builds up, a fraction of Y.
    static : float, default=1.0
        Friction before sliding, relative to that of fast sliding.
    stribeck : float, default=1.0
        Velocity over which the excess of static friction fades, in w Y.
    hysteretic : float, default=0.0
        Factor of the Bouc-Wen force.
    width : float, default=1.0
        Displacement over which the Bouc-Wen force builds up, a fraction of Y.

    See Also
    --------
    bouc_wen : The hysteretic force.
    skhyst.linear.SecondOrderMode : The linear model.
    skhyst.hysteresis.RestoringForce : The model with such forces.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.datasets.simulation import oscillate
    >>> step = np.append(0.0, np.ones(3))
    >>> oscillate(step, 0.1, frequency=1.0, damping=0.5).round(2)
    array([0.  , 0.06, 0.31, 0.64])
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
