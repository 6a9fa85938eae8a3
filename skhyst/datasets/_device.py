"""The physical effects of the simulated devices, as changes of a plant.

The path of a device is

    drive -> first -> core (hysteresis) -> gain -> middle -> dynamics -> motion -> last (sensor)

Strengths are fractions of full scale; zero means no effect. Defaults of times and frequencies are
in periods of the first mode of the device, everything else in s and Hz.
"""

import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from numbers import Real

import numpy as np

from .simulation import (
    Plant,
    PlantEffect,
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


@dataclass(frozen=True)
class DeviceRecords:
    """Full scale and records of a device, for its effects."""

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


def amplified(signal, step, growth=0.0, peak=0.0):
    """Multiply by a gain that grows with the peak of the drive."""
    return (1.0 + growth * peak) * signal


def path(core, motion):
    """Return the plant of a device without effects."""
    places = dict.fromkeys(("first", "core", "gain", "middle", "dynamics", "motion", "last"), ())
    return Plant(places | {"core": (core,), "gain": (partial(amplified),), "motion": (motion,)})


def _power_law(signal, step, scale, strength, order):
    return signal * (1.0 + strength * (signal / scale) ** (order - 1))


def _ringing_in_part(signal, step, strength, frequency, damping, memory=None):
    ringing = oscillate(signal, step, frequency, damping, memory=memory)
    return signal + strength * (ringing - signal)


class Device(DeviceRecords):
    """A device and its possible effects, one method each, in the order of the path."""

    def slew_limit(self, strength=1.0, frequency=0.02):
        rate = 2.0 * np.pi * frequency * self.drive / strength
        return PlantEffect("first", partial(slew_limited, rate=rate))

    def input_saturation(self, strength=0.3):
        level = (1.0 - strength) * self.drive
        return PlantEffect("first", partial(clip, low=-level, high=level))

    def dead_zone(self, strength=0.1):
        return PlantEffect(
            "first", partial(dead_band, center=0.0, half_width=strength * self.drive)
        )

    def backlash(self, strength=0.05, place="drive"):
        at, scale = ("first", self.drive) if place == "drive" else ("last", self.response)
        return PlantEffect(at, partial(plays, thresholds=[strength * scale], weights=[1.0]))

    def rate_dependence(self, strength=0.5, frequency=0.05):
        stretch = strength / (2.0 * np.pi * frequency * self.drive)
        return PlantEffect(alter=lambda plant, _: plant.adapt("core", stretch=stretch))

    def amplitude_dependence(self, strength=0.2):
        return PlantEffect(alter=lambda plant, _: plant.adapt("gain", growth=strength / self.drive))

    def asymmetry(self, strength=0.25, side=1, threshold=0.2):
        terms = {"thresholds": [threshold * self.response], "weights": [strength / (1 - threshold)]}
        return PlantEffect("middle", partial(dead_zones, side=side, **terms))

    def lag(self, strength=1.0, time_constant=0.5):
        return PlantEffect("dynamics", partial(first_order, tau=strength * time_constant))

    def delay(self, strength=1.0, time=0.2):
        return PlantEffect("dynamics", partial(pure_delay, delay=strength * time))

    def creep(self, strength=0.15, time_constants=(5.0, 30.0, 200.0)):
        shares = np.full(len(time_constants), strength / len(time_constants))
        return PlantEffect(
            "dynamics", partial(kelvin_voigt, taus=time_constants, compliances=shares)
        )

    def resonance(self, strength=0.2, frequency=0.4, damping=0.03):
        mode = {"frequency": frequency, "damping": damping}
        return PlantEffect("dynamics", partial(_ringing_in_part, strength=strength, **mode))

    def friction(self, strength=0.05, presliding=0.01, static=1.5, stribeck=0.1):
        return self._force(
            friction=strength, presliding=presliding, static=static, stribeck=stribeck
        )

    def cubic_stiffness(self, strength=0.2):
        return self._force(cubic=strength)

    def hysteretic_force(self, strength=0.2, width=0.3):
        return self._force(hysteretic=strength, width=width)

    def static_nonlinearity(self, strength=0.15, order=3):
        law = partial(_power_law, scale=self.response, strength=strength, order=order)
        return PlantEffect("last", law)

    def output_saturation(self, strength=0.3):
        level = (1.0 - strength) * self.response
        return PlantEffect("last", partial(clip, low=-level, high=level))

    def drift(self, strength=0.1, time_constant=200.0):
        size = strength * self.response
        return PlantEffect(
            additive=[-size * np.expm1(-time / time_constant) for time in self.times()]
        )

    def offset(self, strength=0.1):
        additive = []
        for number, time in enumerate(self.times()):
            rng = self.generator(number, "offset")
            share = rng.choice([-1, 1]) * rng.uniform(0.5, 1.0)
            additive.append(np.full(time.size, strength * self.response * share))
        return PlantEffect(additive=additive)

    def periodic_disturbance(self, strength=0.02, frequency=0.36):
        additive = []
        for number, time in enumerate(self.times()):
            phase = self.generator(number, "periodic_disturbance").uniform(0.0, 2.0 * np.pi)
            wave = np.sin(2.0 * np.pi * frequency * time + phase)
            additive.append(strength * self.response * wave)
        return PlantEffect(additive=additive)

    def auxiliary_input(self, strength=0.1, time_constant=10.0):
        """Return a column that varies slowly between about -1 and 1, and acts with a lag."""
        columns, additive = [], []
        for number, record in enumerate(self.records):
            rng = self.generator(number, "auxiliary_input")
            cycles = rng.uniform(1.0, 4.0, 3) / (record.n_samples * record.dt)
            phases = rng.uniform(0.0, 2.0 * np.pi, 3)
            angles = 2.0 * np.pi * np.outer(self.times()[number], cycles) + phases
            columns.append(np.sin(angles).mean(axis=1))
            late = first_order(columns[-1], record.dt, time_constant)
            additive.append(strength * self.response * late)
        return PlantEffect(additive=additive, column=("temperature", columns))

    def _force(self, **forces):
        return PlantEffect(
            alter=lambda plant, _: plant.adapt("motion", scale=self.response, **forces)
        )


EFFECTS = tuple(name for name in vars(Device) if not name.startswith("_"))

_SHARES = "input_saturation dead_zone backlash resonance friction output_saturation"
_STRENGTHS = dict.fromkeys(EFFECTS, (0.0, np.inf)) | {  # least and largest
    **dict.fromkeys(_SHARES.split(), (0.0, 1.0)),
    "amplitude_dependence": (-0.5, np.inf),
    "asymmetry": (-0.5, np.inf),
    "static_nonlinearity": (-0.3, np.inf),
    "drift": (-np.inf, np.inf),
    "auxiliary_input": (-np.inf, np.inf),
}
_CHOICES = {"place": ("drive", "response"), "side": (-1, 1), "order": (2, 3)}
_UNITS = {"time": 1, "time_constant": 1, "time_constants": 1, "frequency": -1}  # powers of seconds


def simulate(device, X, plant, effects, respond):
    """Simulate all records of a device, with effects in its plant.

    `respond` maps the plant, the drives, the interval and the additive disturbance to the
    signals of a record, by name. Returns X, with the auxiliary input if there is one, and the
    signals of all records.
    """
    drives = X.to_numpy(dtype=float)
    plants, additive = [plant] * len(device.records), [np.zeros(t.size) for t in device.times()]
    for name, parameters in effects.items():
        effect = getattr(device, name)(**parameters)
        plants = effect.changes(plants)
        if effect.additive:
            additive = [a + b for a, b in zip(additive, effect.additive, strict=True)]
        if effect.column[0]:
            X = X.assign(**{effect.column[0]: np.concatenate(effect.column[1])})
    parts = [
        respond(plant, drives[record.rows], record.dt, added)
        for plant, record, added in zip(plants, device.records, additive, strict=True)
    ]
    return X, {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def in_motion(device, plant, effects, caller):
    """Return the plant with the effects that need no record, and refuse the others."""
    for name, parameters in effects.items():
        effect = getattr(device, name)(**parameters)
        if name == "amplitude_dependence" or (effect.stage is None and effect.alter is None):
            raise ValueError(
                f"The 'effects' parameter of {caller} must not hold {name!r}, which depends on a "
                "complete record: on its length or its largest drive."
            )
        (plant,) = effect.changes([plant])
    return plant


def complete_effects(effects, period, caller):
    """Check the effects that a user asks for and complete them by defaults.

    Returns the parameters of each effect by name, in the order of `EFFECTS`, without those of zero
    strength. The period is that of the first mode, s; errors name the caller.
    """
    effects = () if effects is None else (effects,) if isinstance(effects, str) else effects
    if not isinstance(effects, Mapping):
        effects = {name: {} for name in effects}

    def refuse(wanted, got):
        raise ValueError(f"The 'effects' parameter of {caller} must {wanted}. Got {got!r} instead.")

    complete = {}
    for name, given in effects.items():
        if name not in EFFECTS:
            refuse(f"name effects among {', '.join(EFFECTS)}", name)
        if isinstance(given, Real) and not isinstance(given, bool):
            given = {"strength": given}
        given = {} if given is True else given
        if not isinstance(given, Mapping):
            refuse(
                f"give the parameters of {name!r} as a mapping, or its strength as a number", given
            )
        parameters = list(inspect.signature(getattr(Device, name)).parameters.values())[1:]
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
    """Return the requirement on a parameter of an effect if its value is invalid, else None."""
    if key in _CHOICES:
        return "" if value in _CHOICES[key] else f"one of {_CHOICES[key]}"
    try:
        numbers = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        numbers = np.array(np.nan)
    several = key == "time_constants"
    fits = numbers.ndim == several and numbers.size > 0 and np.isfinite(numbers).all()
    if key == "strength":
        low, high = _STRENGTHS[effect]
        return "" if fits and low <= numbers <= high else f"a number from {low:g} to {high:g}"
    if key == "threshold":
        return "" if fits and 0 <= numbers < 1 else "a number from 0 to below 1"
    wanted = "a sequence of positive numbers" if several else "a positive number"
    return "" if fits and np.all(numbers > 0) else wanted
