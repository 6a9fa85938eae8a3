"""The physical effects of the simulated devices: each says how it changes a plant.

The path of a device is

    drive -> first -> core (hysteresis) -> gain -> middle -> dynamics -> motion -> last (sensor)

Strengths are shares of full scale and change nothing at zero. Defaults of times and frequencies
count in periods of the device's first mode, everything else is in s and Hz.
"""

import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from numbers import Real

import numpy as np

from .simulation import (
    Effect,
    Plant,
    clip,
    dead_band,
    dead_zones,
    first_order,
    kelvin_voigt,
    oscillate,
    plays,
    pure_delay,
    slew_limited,
)

__all__ = ["EFFECTS", "Device", "complete_effects", "path"]


@dataclass(frozen=True)
class Device:
    """A simulated device, and the records that are made with it."""

    drive: float  # full scale
    response: float  # full scale
    records: tuple  # of RecordSlice
    seed: int = 0

    def generator(self, record, name=""):
        """Return the random generator of one effect in one record, independent of all others."""
        stream = 1 + EFFECTS.index(name) if name else 0
        return np.random.default_rng([self.seed, record, stream])

    def times(self):
        """Return the times of each record, s."""
        return [record.dt * np.arange(record.n_samples) for record in self.records]

    def simulate(self, X, plant, effects, respond):
        """Simulate all records, with effects in the plant.

        `respond` maps the plant, the drives, the interval and what stands beside the response to
        the signals of a record, by name. Returns X, with the auxiliary input if there is one, and
        the signals of all records.
        """
        found = [_LAWS[name](self, **own) for name, own in effects.items()]
        drives = X.to_numpy(dtype=float)
        plants, beside = [plant] * len(self.records), [np.zeros_like(t) for t in self.times()]
        for effect in found:
            plants = effect.changes(plants)
            if effect.beside:
                beside = [a + b for a, b in zip(beside, effect.beside, strict=True)]
            if effect.column[0]:
                X = X.assign(**{effect.column[0]: np.concatenate(effect.column[1])})
        parts = [
            respond(plant, drives[record.rows], record.dt, added)
            for plant, record, added in zip(plants, self.records, beside, strict=True)
        ]
        return X, {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def amplified(signal, step, growth=0.0, peak=0.0):
    """Multiply by a gain that grows with the peak of the drive."""
    return (1.0 + growth * peak) * signal


def path(core, motion):
    """Return the plant of a device without effects."""
    places = dict.fromkeys(("first", "core", "gain", "middle", "dynamics", "motion", "last"), ())
    return Plant(places | {"core": (core,), "gain": (partial(amplified),), "motion": (motion,)})


def slew_limit(device, strength=1.0, frequency=0.02):
    rate = 2.0 * np.pi * frequency * device.drive / strength
    return Effect("first", partial(slew_limited, rate=rate))


def input_saturation(device, strength=0.3):
    level = (1.0 - strength) * device.drive
    return Effect("first", partial(clip, low=-level, high=level))


def dead_zone(device, strength=0.1):
    return Effect("first", partial(dead_band, center=0.0, half_width=strength * device.drive))


def backlash(device, strength=0.05, place="drive"):
    at, scale = ("first", device.drive) if place == "drive" else ("last", device.response)
    return Effect(at, partial(plays, thresholds=[strength * scale], weights=[1.0]))


def rate_dependence(device, strength=0.5, frequency=0.05):
    stretch = strength / (2.0 * np.pi * frequency * device.drive)
    return Effect(alter=lambda plant, _: plant.adapt("core", stretch=stretch))


def amplitude_dependence(device, strength=0.2):
    return Effect(alter=lambda plant, _: plant.adapt("gain", growth=strength / device.drive))


def asymmetry(device, strength=0.25, side=1, threshold=0.2):
    start, weight = threshold * device.response, strength / (1.0 - threshold)
    return Effect("middle", partial(dead_zones, side=side, thresholds=[start], weights=[weight]))


def lag(device, strength=1.0, time_constant=0.5):
    return Effect("dynamics", partial(first_order, tau=strength * time_constant))


def delay(device, strength=1.0, time=0.2):
    return Effect("dynamics", partial(pure_delay, delay=strength * time))


def creep(device, strength=0.15, time_constants=(5.0, 30.0, 200.0)):
    shares = np.full(len(time_constants), strength / len(time_constants))
    return Effect("dynamics", partial(kelvin_voigt, taus=time_constants, compliances=shares))


def resonance(device, strength=0.2, frequency=0.4, damping=0.03):
    def stage(signal, step):
        ringing = oscillate(signal, step, frequency, damping)
        return signal + strength * (ringing - signal)

    return Effect("dynamics", stage)


def _force(device, **forces):
    return Effect(alter=lambda plant, _: plant.adapt("motion", scale=device.response, **forces))


def friction(device, strength=0.05, presliding=0.01, static=1.5, stribeck=0.1):
    return _force(
        device, friction=strength, presliding=presliding, static=static, stribeck=stribeck
    )


def cubic_stiffness(device, strength=0.2):
    return _force(device, cubic=strength)


def hysteretic_force(device, strength=0.2, width=0.3):
    return _force(device, hysteretic=strength, width=width)


def _power_law(signal, step, scale, strength, order):
    return signal * (1.0 + strength * (signal / scale) ** (order - 1))


def static_nonlinearity(device, strength=0.15, order=3):
    law = partial(_power_law, scale=device.response, strength=strength, order=order)
    return Effect("last", law)


def output_saturation(device, strength=0.3):
    level = (1.0 - strength) * device.response
    return Effect("last", partial(clip, low=-level, high=level))


def drift(device, strength=0.1, time_constant=200.0):
    size = strength * device.response
    return Effect(beside=[-size * np.expm1(-time / time_constant) for time in device.times()])


def offset(device, strength=0.1):
    beside = []
    for number, time in enumerate(device.times()):
        rng = device.generator(number, "offset")
        share = rng.choice([-1, 1]) * rng.uniform(0.5, 1.0)
        beside.append(np.full(time.size, strength * device.response * share))
    return Effect(beside=beside)


def periodic_disturbance(device, strength=0.02, frequency=0.36):
    beside = []
    for number, time in enumerate(device.times()):
        phase = device.generator(number, "periodic_disturbance").uniform(0.0, 2.0 * np.pi)
        wave = np.sin(2.0 * np.pi * frequency * time + phase)
        beside.append(strength * device.response * wave)
    return Effect(beside=beside)


def auxiliary_input(device, strength=0.1, time_constant=10.0):
    """Wander slowly between about -1 and 1, and act with a lag."""
    columns, beside = [], []
    for number, record in enumerate(device.records):
        rng = device.generator(number, "auxiliary_input")
        cycles = rng.uniform(1.0, 4.0, 3) / (record.n_samples * record.dt)
        phases = rng.uniform(0.0, 2.0 * np.pi, 3)
        angles = 2.0 * np.pi * np.outer(device.times()[number], cycles) + phases
        columns.append(np.sin(angles).mean(axis=1))
        late = first_order(columns[-1], record.dt, time_constant)
        beside.append(strength * device.response * late)
    return Effect(beside=beside, column=("temperature", columns))


_LAWS = {  # in the order in which they enter
    law.__name__: law
    for law in (
        slew_limit,
        input_saturation,
        dead_zone,
        backlash,
        rate_dependence,
        amplitude_dependence,
        asymmetry,
        lag,
        delay,
        creep,
        resonance,
        friction,
        cubic_stiffness,
        hysteretic_force,
        static_nonlinearity,
        output_saturation,
        drift,
        offset,
        periodic_disturbance,
        auxiliary_input,
    )
}
EFFECTS = tuple(_LAWS)

_STRENGTHS = {  # least and largest; from zero upwards, where there is none
    "input_saturation": (0.0, 1.0),
    "dead_zone": (0.0, 1.0),
    "backlash": (0.0, 1.0),
    "amplitude_dependence": (-0.5, np.inf),
    "asymmetry": (-0.5, np.inf),
    "resonance": (0.0, 1.0),
    "friction": (0.0, 1.0),
    "static_nonlinearity": (-0.3, np.inf),
    "output_saturation": (0.0, 1.0),
    "drift": (-np.inf, np.inf),
    "auxiliary_input": (-np.inf, np.inf),
}
_CHOICES = {"place": ("drive", "response"), "side": (-1, 1), "order": (2, 3)}
_UNITS = {"time": 1, "time_constant": 1, "time_constants": 1, "frequency": -1}  # powers of seconds


def complete_effects(effects, period, caller):
    """Check the effects that a user asks for and complete them by defaults.

    Parameters
    ----------
    effects : mapping of str to (mapping or float), iterable of str, str or None
        Effects and their parameters; a number is the strength, a name alone means defaults.
    period : float
        Period of the first mode, s.
    caller : str
        Function that errors name.

    Returns
    -------
    dict of str to dict
        All parameters of each effect that is not of zero strength, in the order of `EFFECTS`.

    Raises
    ------
    ValueError
        If an effect or a parameter has no such name, or a value is out of its range.
    """
    effects = () if effects is None else (effects,) if isinstance(effects, str) else effects
    if not isinstance(effects, Mapping):
        effects = {name: {} for name in effects}

    def refuse(wanted, got):
        raise ValueError(f"The 'effects' parameter of {caller} must {wanted}. Got {got!r} instead.")

    complete = {}
    for name, given in effects.items():
        if name not in _LAWS:
            refuse(f"name effects among {', '.join(EFFECTS)}", name)
        if isinstance(given, Real) and not isinstance(given, bool):
            given = {"strength": given}
        given = {} if given is True else given
        if not isinstance(given, Mapping):
            refuse(
                f"give the parameters of {name!r} as a mapping, or its strength as a number", given
            )
        parameters = list(inspect.signature(_LAWS[name]).parameters.values())[1:]
        known = {p.name: _scaled(p.default, period ** _UNITS.get(p.name, 0)) for p in parameters}
        for key, value in given.items():
            if key not in known:
                refuse(f"set parameters of {name!r} among {', '.join(known)}", key)
            if wanted := _wanted(name, key, value):
                refuse(f"set {key!r} of {name!r} to {wanted}", value)
        complete[name] = known | dict(given)
    return {name: complete[name] for name in EFFECTS if complete.get(name, {}).get("strength")}


def _scaled(value, factor):
    if factor == 1:
        return value
    return tuple(v * factor for v in value) if isinstance(value, tuple) else value * factor


def _wanted(effect, key, value):
    """Return what a parameter of an effect must be, where the value is not."""
    if key in _CHOICES:
        return "" if value in _CHOICES[key] else f"one of {_CHOICES[key]}"
    try:
        numbers = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        numbers = np.array(np.nan)
    several = key == "time_constants"
    fits = numbers.ndim == several and numbers.size > 0 and np.isfinite(numbers).all()
    if key == "strength":
        low, high = _STRENGTHS.get(effect, (0.0, np.inf))
        return "" if fits and low <= numbers <= high else f"a number from {low:g} to {high:g}"
    if key == "threshold":
        return "" if fits and 0 <= numbers < 1 else "a number from 0 to below 1"
    wanted = "a sequence of positive numbers" if several else "a positive number"
    return "" if fits and np.all(numbers > 0) else wanted
