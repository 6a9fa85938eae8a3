"""Recordings of plants: drawn, driven, and measured with noise."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pandas as pd

from skhyst.datasets.simulation import Plant, plays

from . import effects, unknown
from .effects import SUBSTEPS, Setting
from .motion import mode
from .physics import bouc_wen, scaled
from .signals import (
    N_TRAIN,
    draw_colour,
    draw_column,
    draw_drives,
    draw_noise,
    log_uniform,
    spread_amplitudes,
)

PLACES = ("first", "core", "middle", "motion", "dynamics", "last")
BASES = ("prandtl_ishlinskii", "cascade", "bouc_wen", "second_order")
EFFECTS = tuple(effects.LAWS)
UNKNOWN = tuple(unknown.LAWS)

_IN_EVERY_PLANT = (
    "static_nonlinearity",
    "delay",
    "lag",
    "resonance",
    "creep",
    "drift",
    "offset",
    "output_saturation",
    "input_saturation",
    "periodic_disturbance",
    "dead_zone",
    "auxiliary_input",
    "amplitude_dependence",
    "slew_limit",
)
# asymmetry is told from any bent curve by the hysteresis before it; a play before, or behind,
# hysteresis without dynamics is a part of that hysteresis
_MORE = {
    "prandtl_ishlinskii": ("asymmetry", "rate_dependence"),
    "bouc_wen": ("asymmetry",),
    "cascade": ("asymmetry", "backlash", "rate_dependence"),
    "second_order": ("hysteresis", "backlash", "friction", "cubic_stiffness"),
}
MATRIX = {
    declared: tuple(e for e in EFFECTS if e in _IN_EVERY_PLANT + more)
    for declared, more in _MORE.items()
}

_CLASSES = (
    {
        "asymmetry",
        "static_nonlinearity",
        "input_saturation",
        "output_saturation",
        "dead_zone",
        "amplitude_dependence",
    },
    {"lag", "delay", "resonance", "creep"},
    {"drift", "offset", "periodic_disturbance", "auxiliary_input"},
    {"hysteresis", "backlash", "friction", "cubic_stiffness", "rate_dependence", "slew_limit"},
)
# what one of them does to a record, the other does too
_ALIKE = (
    {"creep", "drift"},
    {"lag", "slew_limit"},
    {"lag", "rate_dependence"},
    {"amplitude_dependence", "friction"},
    {"amplitude_dependence", "cubic_stiffness"},
    {"amplitude_dependence", "hysteresis"},
    {"amplitude_dependence", "backlash"},
)


@dataclass(frozen=True)
class Recording:
    """Records to fit on, records held out, and what made them.

    Attributes
    ----------
    X_train, X_test : DataFrame of shape (n_samples, n_inputs)
        Column `drive`, and a further one in some plants; MultiIndex with levels `record` and
        `time` (s, from 0 in each record).
    y_train, y_test : Series of shape (n_samples,)
        Measured response, with sensor noise.
    y_train_clean, y_test_clean : Series of shape (n_samples,)
        The same without the sensor noise.
    noise_std : float
        Standard deviation of the sensor noise, units of the response.
    sampling_interval : float
        Seconds.
    truth : dict
        Parameters of the plant in seconds, hertz and the units of drive and response.
        `effect_over_noise`: for each effect, the root mean square of what it changes in the
        response to the same drives, but for gain and offset, over the noise.
    """

    X_train: pd.DataFrame
    y_train: pd.Series
    X_test: pd.DataFrame
    y_test: pd.Series
    y_train_clean: pd.Series
    y_test_clean: pd.Series
    noise_std: float
    sampling_interval: float
    truth: dict


def effect_pairs(declared):
    """Return the pairs of effects, of different kinds, that one plant can have."""
    names = MATRIX[declared]
    return [
        (one, two)
        for i, one in enumerate(names)
        for two in names[i + 1 :]
        if not any({one, two} <= kind for kind in _CLASSES) and {one, two} not in _ALIKE
    ]


def unknown_structures(declared):
    """Return the structures of no library that this plant can have."""
    mode = declared in ("cascade", "second_order")
    return tuple(name for name in UNKNOWN if mode or name not in unknown.NEEDS_MODE)


def _draw_core(rng, declared, drives, scale):
    """Draw what stands before all dynamics; its output over the given drives peaks at one."""
    if declared == "second_order":
        return partial(scaled, gain=1.0 / max(np.abs(drive).max() for drive in drives))
    if declared == "bouc_wen":
        core = partial(
            bouc_wen,
            gain=1.0,
            share=rng.uniform(0.2, 0.5),
            limit=log_uniform(rng, 0.1, 0.5) * scale,
            ratio=rng.uniform(0.5, 0.9),
            exponent=rng.uniform(1.0, 2.0),
        )
        peak = max(np.abs(core(drive, 1.0)).max() for drive in drives)
        return partial(core.func, **{**core.keywords, "gain": 1.0 / peak})
    thresholds, weights = effects.draw_plays(rng, 0.8 * scale, scale)  # to half of the full range
    peak = max(np.abs(plays(u, 1.0, thresholds, weights)).max() for u in drives)
    return partial(plays, thresholds=thresholds, weights=weights / peak)


def _draw_motion(rng, declared):
    if declared == "cascade":
        frequency = 1.0 / log_uniform(rng, 14, 50)
        return {"frequency": frequency, "damping": log_uniform(rng, 0.02, 0.25)}
    if declared == "second_order":  # within the band of most drives
        frequency = 1.0 / log_uniform(rng, 25, 100)
        return {"frequency": frequency, "damping": log_uniform(rng, 0.03, 0.3)}
    return {}


def _bounds(signals):
    fitted = np.concatenate(signals[:N_TRAIN])
    return fitted.min(), fitted.max()


def change(signals, others):
    """Return the root mean square change from others to signals, but for gain and offset."""
    here, there = (np.concatenate(parts[:N_TRAIN]) for parts in (signals, others))
    basis = np.column_stack([there, np.ones(there.size)])
    return np.sqrt(np.mean((here - basis @ np.linalg.lstsq(basis, here, rcond=None)[0]) ** 2))


def respond(plant, found, setting, read=None):
    """Return the clean responses of all records with these effects in the plant.

    `read` maps a plant and a drive to the response at its samples.
    """
    plants = [plant] * len(setting.drives)
    for effect in found:
        plants = effect.changes(plants)
    drives = zip(plants, setting.drives, strict=True)
    read = read or partial(Plant.respond, substeps=setting.substeps)
    clean = [read(one, drive) for one, drive in drives]
    for effect in found:
        if effect.additive:
            clean = [y + part for y, part in zip(clean, effect.additive, strict=True)]
    return clean


def draw_plant(seed, kind, n_samples, substeps, distract, spread):
    """Draw a plant without effects, its setting, its drives' names and its column."""
    declared = BASES[kind]
    rng = np.random.default_rng([seed, kind, 1])
    dt = 1.0 / np.round(log_uniform(rng, 100, 10_000))
    scale, unit = log_uniform(rng, 1, 150), log_uniform(rng, 1e-6, 1e3)
    drives, signals = draw_drives(rng, n_samples, scale)
    core = _draw_core(rng, declared, drives[:N_TRAIN], scale)
    motion = _draw_motion(rng, declared)
    rng = np.random.default_rng([seed, kind, 4])
    distraction = rng.integers(3) if distract else -1
    if spread or distraction == 0:
        drives = spread_amplitudes(rng, drives, scale)
    lengths = tuple(drive.size for drive in drives)
    column = ("", [None] * len(lengths))
    if distraction == 1:
        column = ("temperature", draw_column(rng, lengths)[1])
    stages = {"core": (core,), "motion": (partial(mode, **motion),) if motion else ()}
    plant = Plant(dict.fromkeys(PLACES, ()) | stages)
    setting = Setting(
        drive=_bounds(drives),
        response=_bounds([plant.respond(drive, substeps) for drive in drives[:N_TRAIN]]),
        settled=_bounds([core(drive, 1.0) for drive in drives[:N_TRAIN]]),
        lengths=lengths,
        mode=motion.get("frequency", 0.0),
        dt=dt,
        unit=unit,
        declared=declared,
        drives=tuple(drives),
        motion=motion,
        core=core.keywords,
        substeps=substeps,
    )
    return plant, setting, signals, column


def put_in(rng, names, plant, setting, laws=None, last=1.0):
    """Draw the effects, each for the plant with those before it; return them and the responses.

    Some have other laws, the last effect another strength.
    """
    found, laws = [], effects.LAWS | unknown.LAWS | (laws or {})
    for i, name in enumerate(names, start=1):
        if found:
            setting = replace(setting, response=_bounds(respond(plant, found, setting)))
        strength = last if i == len(names) else 1.0
        found.append(laws[name](rng, replace(setting, strength=strength)))
    return found, respond(plant, found, setting)


def _record(rng, part, repeats, noise_std, colour, unit):
    """Record (drive, column or None, clean response) each so many times, with noise of its own."""
    return [
        (u, c, unit * (y + noise_std * draw_noise(rng, y.size, **colour)), unit * y)
        for _ in range(repeats)
        for u, c, y in part
    ]


def frames(records, first_label, dt, name):
    """Stack (drive, column or None, measured, clean) records under a (record, time) index."""
    labels = np.repeat(np.arange(len(records)) + first_label, [r[0].size for r in records])
    times = np.concatenate([dt * np.arange(r[0].size) for r in records])
    index = pd.MultiIndex.from_arrays([labels, times], names=["record", "time"])
    X = pd.DataFrame({"drive": np.concatenate([r[0] for r in records])}, index=index)
    if name:
        X[name] = np.concatenate([r[1] for r in records])
    measured, clean = (
        pd.Series(np.concatenate([r[i] for r in records]), index=index, name="response")
        for i in (2, 3)
    )
    return X, measured, clean


def recorded(fitted, held_out, setting, noise_std, truth):
    """Return the recording of (drive, column or None, measured, clean) records."""
    dt, name = setting.dt, truth["column"]
    X_train, y_train, y_train_clean = frames(fitted, 0, dt, name)
    X_test, y_test, y_test_clean = frames(held_out, len(fitted), dt, name)
    return Recording(
        X_train=X_train,
        y_train=y_train,
        X_test=X_test,
        y_test=y_test,
        y_train_clean=y_train_clean,
        y_test_clean=y_test_clean,
        noise_std=setting.unit * noise_std,
        sampling_interval=dt,
        truth=truth,
    )


def make_recording(
    effect,
    declared,
    seed,
    *,
    noise=0.002,
    n_samples=6000,
    substeps=SUBSTEPS,
    distract=False,
    coloured=False,
    repeats=1,
):
    """Draw a plant with undeclared effects and record it.

    Parameters
    ----------
    effect : str or tuple of str
        Of `EFFECTS` or `UNKNOWN`, or "none". Several effects enter one after another.
    declared : {"prandtl_ishlinskii", "cascade", "bouc_wen", "second_order"}
        What the plant is but for the effect: plays alone, plays and a second-order mode, a
        Bouc-Wen law, or a second-order mode alone.
    seed : int
        Non-negative. The same seed gives the same plant, drives and records for every effect;
        but `amplitude_dependence` is recorded at peaks from 0.3 to 1.
    noise : float, default 0.002
        Standard deviation of the sensor noise over the range of the clean response.
    n_samples : int, default 6000
        Samples to fit on, in five records; the three held-out records are as long as three of them.
    substeps : int, default 32
        Integration steps a sample.
    distract : bool, default False
        Whether a third of all plants, by the seed, carry a column `temperature` that does nothing,
        and another third are recorded at peaks from 0.3 to 1.
    coloured : bool, default False
        Whether the noise is coloured, by the seed: autoregressive with a coefficient from 0.5 to
        0.97, or in a quarter of all plants with a power that falls as one over the frequency.
    repeats : int, default 1
        How often all drives are recorded, one pass after the other, each time with noise of its
        own. The samples multiply.

    Returns
    -------
    Recording
    """
    names = () if effect == "none" else (effect,) if isinstance(effect, str) else tuple(effect)
    kind = BASES.index(declared)
    known = (*EFFECTS, *UNKNOWN)
    chosen = [1 + known.index(name) for name in names] or [0]
    plant, setting, signals, column = draw_plant(
        seed, kind, n_samples, substeps, distract, spread="amplitude_dependence" in names
    )
    found, clean = put_in(np.random.default_rng([seed, kind, 2, *chosen]), names, plant, setting)
    noise_std = noise * np.ptp(np.concatenate(clean[:N_TRAIN]))
    sizes = {}
    for name, one in zip(names, found, strict=True):
        others = [other for other in found if other is not one]
        size = change(clean, respond(plant, others, setting))
        sizes[name] = size / noise_std if noise_std else np.inf
        column = one.column if one.column[0] else column

    colour = draw_colour(np.random.default_rng([seed, kind, 5])) if coloured else {"law": "white"}
    rng = np.random.default_rng([seed, kind, 3, *chosen])
    parts = list(zip(setting.drives, column[1], clean, strict=True))
    dt, unit = setting.dt, setting.unit
    fitted = _record(rng, parts[:N_TRAIN], repeats, noise_std, colour, unit)
    held_out = _record(rng, parts[N_TRAIN:], repeats, noise_std, colour, unit)
    parameters = [one.truth for one in found] or [{}]
    # weights and gains are responses over drives
    core = {n: v * (unit if n in ("weights", "gain") else 1.0) for n, v in setting.core.items()}
    motion = setting.motion
    truth = {
        "effect": effect,
        "declared": declared,
        "seed": seed,
        "parameters": parameters[0] if len(parameters) == 1 else parameters,
        "effect_over_noise": sizes,
        "signals": signals,
        "column": column[0],
        "noise": colour,
        **core,
        "mode": {**motion, "frequency": motion["frequency"] / dt} if motion else {},
    }
    return recorded(fitted, held_out, setting, noise_std, truth)
