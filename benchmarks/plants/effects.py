"""The effects: each draws its parameters and says how it changes a plant.

Strengths are what an engineer would call visible, not grotesque: some percent to some tens of
percent of the range.
"""

from dataclasses import dataclass, field
from functools import partial

import numpy as np

from skhyst.datasets.simulation import (
    PlantEffect,
    clip,
    dead_band,
    dead_zones,
    kelvin_voigt,
    plays,
    pure_delay,
    slew_limited,
)

from .motion import coulomb_mode, lugre_mode, mode
from .physics import (
    bend_cubic,
    bend_exponential,
    bend_tanh,
    first_order,
    modulated,
)
from .signals import N_TRAIN, draw_column, log_uniform

SUBSTEPS = 32


@dataclass(frozen=True)
class Setting:
    """What an effect has to know of the plant that it enters; the response here peaks near one."""

    drive: tuple[float, float]  # lowest and highest drive of the records to fit on
    response: tuple[float, float]  # the same of the response without the effect
    settled: tuple[float, float]  # the same of the core alone, without a mode's overshoot
    lengths: tuple[int, ...]  # samples of each record, held-out records last
    mode: float  # frequency of the plant's own mode, in cycles a sample; 0 without one
    dt: float  # sampling interval, s
    unit: float  # response units per one
    declared: str = "prandtl_ishlinskii"
    drives: tuple = ()  # of each record
    motion: dict = field(default_factory=dict)  # parameters of the plant's own mode
    core: dict = field(default_factory=dict)  # parameters of the core
    substeps: int = SUBSTEPS
    strength: float = 1.0  # of the effect, relative to what is drawn, see `WEAKENED`


def asymmetry(rng, setting):
    count, side = rng.integers(2, 5), rng.choice([-1, 1])
    thresholds = np.sort(rng.uniform(0.0, 0.5, count))
    weights = rng.uniform(0.5, 1.5, count)
    bend = rng.choice([-1, 1]) * rng.uniform(0.15, 0.35)  # share of the peak on that side
    bend *= setting.strength
    weights *= bend / np.sum(weights * (1.0 - thresholds))  # above -0.7 in all: monotone
    stage = partial(dead_zones, side=side, thresholds=thresholds, weights=weights)
    truth = {"side": side, "thresholds": setting.unit * thresholds, "weights": weights}
    return PlantEffect("middle", stage, truth=truth)


def static_nonlinearity(rng, setting):
    scale = np.abs(setting.response).max()
    law = (bend_tanh, bend_cubic, bend_exponential)[rng.integers(3)]
    share = rng.uniform(0.18, 0.3)  # departure from the tangent at zero, at the peak
    share *= setting.strength
    if law is bend_tanh:
        bend = np.sqrt(3 * share) * (1 + 0.6 * share)  # tanh(b) / b = 1 - share, to a percent
    elif law is bend_cubic:
        bend = share if rng.random() < 0.5 else -min(share, 0.22)  # monotone to 1.2 of the peak
    else:
        bend = rng.choice([-1, 1]) * 2 * share
    truth = {"law": law.__name__, "bend": bend, "scale": setting.unit * scale}
    return PlantEffect("last", partial(law, scale=scale, bend=bend), truth=truth)


def lag(rng, setting):
    tau = rng.uniform(3, 30)
    if setting.mode:  # a much slower lag would leave nothing of the mode to see
        tau = max(3.0, rng.uniform(0.8, 3.0) / (2 * np.pi * setting.mode))
    tau *= setting.strength
    return PlantEffect("dynamics", partial(first_order, tau=tau), truth={"tau": tau * setting.dt})


def delay(rng, setting):
    shift = rng.uniform(2, 15)
    return PlantEffect(
        "dynamics", partial(pure_delay, delay=shift), truth={"delay": shift * setting.dt}
    )


def resonance(rng, setting):
    frequency, damping = 1.0 / log_uniform(rng, 14, 50), log_uniform(rng, 0.01, 0.15)
    while setting.mode and 1 / 1.5 < frequency / setting.mode < 1.5:
        frequency = 1.0 / log_uniform(rng, 14, 50)
    truth = {"frequency": frequency / setting.dt, "damping": damping}
    stage = partial(mode, frequency=frequency, damping=damping)
    return PlantEffect("dynamics", stage, truth=truth)


def creep(rng, setting):
    longest = np.mean(setting.lengths)
    share = rng.uniform(0.15, 0.3) * setting.strength  # of the settled response
    count = rng.integers(0, 4)
    if count:
        # One unit in each equal part of the logarithm of time; a lone slow one would hardly show.
        edges = np.geomspace(30, longest / 4 if count == 1 else longest, count + 1)
        taus = log_uniform(rng, edges[:-1], edges[1:])
        compliances = rng.uniform(0.5, 1.5, count)
    else:
        taus = np.geomspace(30, longest, 25)  # a flat spectrum: creep by the logarithm of time
        compliances = np.ones(taus.size)
    compliances *= share / (1.0 - share) / compliances.sum()
    truth = {
        "law": "kelvin_voigt" if count else "logarithmic",
        "taus": taus * setting.dt,
        "compliances": compliances,
    }
    stage = partial(kelvin_voigt, taus=taus, compliances=compliances, relax=first_order)
    return PlantEffect("dynamics", stage, truth=truth)


def _clipping_levels(rng, low, high, strength):
    sides = rng.integers(3)  # high, low, both
    top = high * rng.uniform(0.7, 0.85) ** strength if sides != 1 else np.inf
    bottom = low * rng.uniform(0.7, 0.85) ** strength if sides != 0 else -np.inf
    return bottom, top


def output_saturation(rng, setting):
    low, high = _clipping_levels(rng, *setting.settled, setting.strength)
    truth = {"low": setting.unit * low, "high": setting.unit * high}
    return PlantEffect("last", partial(clip, low=low, high=high), truth=truth)


def input_saturation(rng, setting):
    low, high = _clipping_levels(rng, *setting.drive, setting.strength)
    return PlantEffect("first", partial(clip, low=low, high=high), truth={"low": low, "high": high})


def drift(rng, setting):
    law = ("linear", "exponential", "sine")[rng.integers(3)]
    spans = rng.uniform(0.04, 0.2, len(setting.lengths)) * np.ptp(setting.response)
    spans *= setting.strength
    additive = []
    for n, span in zip(setting.lengths, spans, strict=True):
        s = np.arange(n) / n
        if law == "linear":
            curve = s
        elif law == "exponential":
            curve = -np.exp(-s / rng.uniform(0.1, 0.5))
        else:
            curve = np.sin(2 * np.pi * (rng.uniform(0.4, 1.0) * s + rng.random()))
        additive.append(rng.choice([-1, 1]) * span * (curve - curve[0]) / np.ptp(curve))
    return PlantEffect(additive=additive, truth={"law": law, "spans": setting.unit * spans})


def offset(rng, setting):
    count = len(setting.lengths)
    values = rng.choice([-1, 1], count) * rng.uniform(0.02, 0.1, count)
    while np.ptp(np.sign(values[:N_TRAIN])) == 0:  # equal offsets are one offset, of the model
        values *= rng.choice([-1, 1], count)
    values *= np.ptp(setting.response) * setting.strength
    additive = [np.full(n, value) for n, value in zip(setting.lengths, values, strict=True)]
    return PlantEffect(additive=additive, truth={"values": setting.unit * values})


def periodic_disturbance(rng, setting):
    count = rng.integers(1, 3)
    frequencies = log_uniform(rng, 1 / 250, 1 / 8, count)
    while count == 2 and 1 / 1.3 < frequencies[0] / frequencies[1] < 1.3:
        frequencies = log_uniform(rng, 1 / 250, 1 / 8, count)
    amplitudes = rng.uniform(0.015, 0.05, count) * np.ptp(setting.response)
    amplitudes *= setting.strength
    shape = (len(setting.lengths), count)
    locked = rng.random() < 0.5  # to the start of every record; else each starts at random
    phases = rng.uniform(0, 2 * np.pi, (1, count) if locked else shape)
    additive = [
        np.sin(2 * np.pi * np.outer(np.arange(n), frequencies) + phase) @ amplitudes
        for n, phase in zip(setting.lengths, np.broadcast_to(phases, shape), strict=True)
    ]
    truth = {
        "frequencies": frequencies / setting.dt,
        "amplitudes": setting.unit * amplitudes,
        "locked": locked,
    }
    return PlantEffect(additive=additive, truth=truth)


# ------------------------------------------------------------------------- memory and rate


def draw_plays(rng, low, high):
    """Draw plays, the widest from low to high; weights fall with the width and sum to one."""
    count = rng.integers(8, 16)
    widest = rng.uniform(low, high)
    thresholds = np.concatenate([[0.0], np.sort(rng.uniform(0.01, 1.0, count)) * widest])
    weights = rng.uniform(0.4, 1.6, count) * np.exp(-thresholds[1:] / (0.5 * widest))
    hysteretic = rng.uniform(0.3, 0.6)
    weights *= hysteretic / weights.sum()
    return thresholds, np.concatenate([[1.0 - hysteretic], weights])


def hysteresis(rng, setting):
    if rng.random() < 0.5:
        thresholds, weights = draw_plays(rng, 0.6, 1.0)
        weights[1:] *= setting.strength
        truth = {
            "law": "plays",
            "thresholds": thresholds * np.abs(setting.drive).max(),
            "weights": weights,
        }
        stage = partial(plays, thresholds=thresholds, weights=weights)
        return PlantEffect("middle", stage, truth=truth)
    force = rng.uniform(0.06, 0.2)  # largest hysteretic force, part of the largest drive
    force *= setting.strength
    stiffness = rng.uniform(0.3, 1.5)  # of the hysteretic spring near zero, part of the spring
    parameters = {
        "stiffness": stiffness,
        "limit": force / stiffness,
        "ratio": rng.uniform(0.5, 0.9),
        "exponent": rng.uniform(1.0, 2.0),
    }
    truth = {"law": "force", **parameters, "limit": setting.unit * parameters["limit"]}
    return PlantEffect(alter=lambda plant, _: plant.adapt("motion", **parameters), truth=truth)


def _one_play(half_width):
    return partial(plays, thresholds=[half_width], weights=[1.0])


def backlash(rng, setting):
    if setting.declared == "second_order" and rng.random() < 0.5:
        half_width = rng.uniform(0.04, 0.12) * np.ptp(setting.drive) / 2 * setting.strength
        truth = {"place": "first", "half_width": half_width}
        return PlantEffect("first", _one_play(half_width), truth=truth)
    half_width = rng.uniform(0.04, 0.12) * np.ptp(setting.response) / 2 * setting.strength
    truth = {"place": "last", "half_width": setting.unit * half_width}
    return PlantEffect("last", _one_play(half_width), truth=truth)


def dead_zone(rng, setting):
    low, high = setting.drive
    half_width = rng.uniform(0.05, 0.15) * (high - low) / 2
    center = (low + high) / 2 + rng.uniform(-0.4, 0.4) * (high - low) / 2
    truth = {"center": center, "half_width": half_width}
    return PlantEffect(
        "first", partial(dead_band, center=center, half_width=half_width), truth=truth
    )


def rate_dependence(rng, setting):
    rates = np.abs(np.concatenate([np.diff(drive) for drive in setting.drives[:N_TRAIN]]))
    widening = rng.uniform(0.05, 0.15) * np.ptp(setting.drive) / 2 * setting.strength
    growth = widening / np.quantile(rates, 0.9)  # where the drive is fast, not only on edges
    return PlantEffect(
        alter=lambda plant, _: plant.adapt("core", widening=growth),
        truth={"dilation": growth * setting.dt},
    )


def slew_limit(rng, setting):
    fastest = max(np.abs(np.diff(drive)).max() for drive in setting.drives[:N_TRAIN])
    rate = rng.uniform(0.12, 0.4) * fastest
    return PlantEffect("first", partial(slew_limited, rate=rate), truth={"rate": rate / setting.dt})


# ------------------------------------------------------------------- equations of motion


def friction(rng, setting):
    coulomb = rng.uniform(0.04, 0.15) * setting.strength  # part of the largest drive
    stribeck = rng.random() < 0.5
    static = coulomb * (rng.uniform(1.2, 1.7) if stribeck else 1.0)
    fitted = np.concatenate([np.diff(drive) for drive in setting.drives[:N_TRAIN]])
    typical = np.sqrt(np.mean(np.square(fitted))) / np.abs(setting.drive).max()
    parameters = {
        "static": static,
        "coulomb": coulomb,
        "velocity": rng.uniform(0.2, 1.0) * typical,
    }
    law = coulomb_mode
    if rng.random() < 0.5:
        bristle = log_uniform(rng, 15, 80)
        damping = rng.uniform(0.3, 0.8)
        law = lugre_mode
        parameters |= {"bristle": bristle, "bristle_damping": 2.0 * damping * np.sqrt(bristle)}
    truth = {"law": law.__name__, "stribeck": stribeck, **parameters}
    truth["velocity"] *= setting.unit / setting.dt
    return PlantEffect(alter=lambda plant, _: plant.adapt("motion", law, **parameters), truth=truth)


def cubic_stiffness(rng, setting):
    hardening = rng.random() < 0.5
    peak = np.abs(setting.response).max()
    cubic = rng.uniform(0.15, 0.5) / peak**2 if hardening else -rng.uniform(0.06, 0.15) / peak**2
    cubic *= setting.strength
    drives = [drive / np.abs(setting.drive).max() for drive in setting.drives]
    own = {name: setting.motion[name] for name in ("frequency", "damping")}
    # a soft spring must not be pushed near its summit, where x + k3 x^3 no longer grows
    while not hardening and any(
        not np.abs(cubic) * np.max(np.square(mode(drive, 1.0, **own, cubic=cubic))) < 0.2
        for drive in drives
    ):
        cubic *= 0.8
    truth = {"hardening": hardening, "k3_over_k": cubic / setting.unit**2}
    return PlantEffect(alter=lambda plant, _: plant.adapt("motion", cubic=cubic), truth=truth)


# ------------------------------------------------------------------------- in the parameters


def auxiliary_input(rng, setting):
    name, column, middle, size = draw_column(rng, setting.lengths)
    law = ("static", "lag", "gain")[rng.integers(3)]
    strength = rng.choice([-1, 1]) * rng.uniform(0.05, 0.15) * setting.strength
    units = [(values - middle) / size for values in column]
    truth = {"law": law, "column": name}
    if law == "gain":
        truth["sensitivity"] = strength / size
        stages = [partial(modulated, gains=1.0 + strength * part) for part in units]
        return PlantEffect("last", stages, column=(name, column), truth=truth)
    strength *= np.ptp(setting.response) / 2
    truth["gain"] = setting.unit * strength / size
    if law == "lag":
        tau = log_uniform(rng, 15, 120)
        truth["tau"] = tau * setting.dt
        units = [first_order(part, 1.0, tau) for part in units]
    additive = [strength * part for part in units]
    return PlantEffect(additive=additive, column=(name, column), truth=truth)


def amplitude_dependence(rng, setting):
    amplitudes = np.array([np.ptp(drive) / 2 for drive in setting.drives])
    low, high = amplitudes[:N_TRAIN].min(), amplitudes[:N_TRAIN].max()
    place = (2.0 * amplitudes - low - high) / (high - low)  # -1 to 1 in the records fitted on
    ranges = {"gain": (0.08, 0.2)}
    if setting.declared != "second_order":
        ranges["hysteresis"] = (0.15, 0.4)
    if setting.mode:
        ranges["frequency"] = (0.04, 0.1)
    if setting.declared == "second_order":
        ranges["damping"] = (0.2, 0.5)
    names = list(rng.permutation(list(ranges))[: rng.integers(1, 3)])
    if names == ["damping"]:  # alone it would hardly show
        names.append("frequency")
    sizes = {name: rng.choice([-1, 1]) * rng.uniform(*ranges[name]) for name in names}
    slopes = {name: size * setting.strength for name, size in sizes.items()}

    def alter(plant, number):
        factor = {name: 1.0 + slope * place[number] for name, slope in slopes.items()}
        core, gain, share = setting.core, factor.get("gain", 1.0), factor.get("hysteresis", 1.0)
        if "weights" in core:
            weights = gain * core["weights"] * np.where(core["thresholds"] > 0, share, 1.0)
            plant = plant.adapt("core", weights=weights)
        elif "share" in core:
            plant = plant.adapt("core", gain=gain * core["gain"], share=share * core["share"])
        else:
            plant = plant.adapt("core", gain=gain * core["gain"])
        changed = {n: factor[n] * setting.motion[n] for n in factor if n in setting.motion}
        return plant.adapt("motion", **changed) if changed else plant

    truth = {"slopes": slopes, "amplitudes": amplitudes}
    return PlantEffect(alter=alter, truth=truth)


LAWS = {
    law.__name__: law
    for law in (
        asymmetry,
        static_nonlinearity,
        lag,
        delay,
        resonance,
        creep,
        drift,
        offset,
        output_saturation,
        input_saturation,
        periodic_disturbance,
        hysteresis,
        dead_zone,
        backlash,
        rate_dependence,
        auxiliary_input,
        amplitude_dependence,
        friction,
        cubic_stiffness,
        slew_limit,
    )
}
# a weak one is still what it is: a short delay would be one of the instruments, a fast mode or a
# high limit of the rate would be nothing, a narrow dead zone would shift the drive by its centre
_NOT_WEAKENED = ("dead_zone", "delay", "resonance", "slew_limit")
WEAKENED = tuple(name for name in LAWS if name not in _NOT_WEAKENED)
