"""A simulated actuator with one hidden effect."""

from functools import partial

import numpy as np
import pandas as pd

from ..datasets.simulation import Plant, clip, dead_zones, kelvin_voigt, oscillate, plays

_SAMPLES = 1500  # per record
_INTERVAL = 1e-3  # s
_SUBSTEPS = 20  # integration steps per sample
_NOISE = 0.002  # standard deviation as a fraction of the range


def _asymmetry(rng):
    """Reduce the slope of the upper part of the stroke."""
    start, slope = rng.uniform(0.0, 0.3), rng.uniform(-0.4, -0.2)
    stage = partial(dead_zones, side=1, thresholds=[start], weights=[slope])
    return stage, f"beyond {start:.3g} um the slope is {1 + slope:.3g}"


def _resonance(rng):
    """Pass the stroke through a mass on a spring."""
    frequency, damping = rng.uniform(20.0, 35.0), rng.uniform(0.02, 0.08)
    stage = partial(oscillate, frequency=frequency, damping=damping)
    return stage, f"a mode at {frequency:.4g} Hz with damping ratio {damping:.3g}"


def _creep(rng):
    """Add a Kelvin-Voigt unit."""
    fraction, tau = rng.uniform(0.15, 0.3), rng.uniform(0.05, 0.2)
    stage = partial(kelvin_voigt, taus=[tau], compliances=[fraction])
    return stage, f"{100 * fraction:.3g} % more, with a time constant of {tau:.3g} s"


def _output_saturation(rng):
    """Clip the reading."""
    level = rng.uniform(0.5, 0.7)
    return partial(clip, low=-np.inf, high=level), f"the sensor stops at {level:.4g} um"


_LAWS = (_asymmetry, _resonance, _creep, _output_saturation)
SECRETS = {law.__name__[1:]: law for law in _LAWS}


def _drive(rng, number):
    """Return one record's drive, which starts at zero: triangles, a sweep, steps, sines, noise."""
    t, kind = np.arange(_SAMPLES) / _SAMPLES, number % 5
    if kind == 0:
        u = 2.0 / np.pi * np.arcsin(np.sin(2.0 * np.pi * 4.0 * t)) * (1.0 - 0.5 * t)
    elif kind == 1:
        u = np.sin(2.0 * np.pi * (1.0 + 7.0 * t) * t)
    elif kind == 2:
        levels = np.append(np.zeros(20), np.repeat(rng.uniform(-1.0, 1.0, 12), _SAMPLES // 12))
        u = np.convolve(levels, np.full(20, 0.05), "valid")[:_SAMPLES]
    elif kind == 3:
        u = sum(np.sin(2.0 * np.pi * (f * t)) for f in (2.0, 5.0, 9.0, 14.0)) / 3.0
    else:
        raw = np.convolve(rng.normal(size=_SAMPLES + 60), np.hanning(60), "valid")[:_SAMPLES]
        u = (raw - raw[0]) / np.abs(raw - raw[0]).max()
    return 50.0 * (u - u[0])


def make_demo_recording(seed, *, n_records=5):
    """Simulate a recording.

    Parameters
    ----------
    seed : int
        Seed of the effect, its size, and everything else.
    n_records : int, default=5

    Returns
    -------
    table : DataFrame
        Columns ``record``, ``time`` (s), ``voltage`` (V), ``position`` (um).
    effect : str
        Name of the hidden effect.
    description : str
        Its size, as text.
    """
    rng = np.random.default_rng(seed)
    effect = sorted(SECRETS)[rng.integers(len(SECRETS))]
    thresholds = np.concatenate([[0.0], np.sort(rng.uniform(2.0, 40.0, 8))])
    weights = rng.uniform(0.3, 1.0, 9) * np.array([4.0, *np.ones(8)])
    weights *= 0.018 / weights.sum()
    # the same size of the effect in every record
    stage, description = SECRETS[effect](np.random.default_rng(rng.integers(2**31)))
    core = partial(plays, thresholds=thresholds, weights=weights)
    plant = Plant({"core": (core,), "effect": (stage,)})
    tables = []
    for number in range(n_records):
        u = _drive(rng, number)
        position = plant.respond(u, _SUBSTEPS, _INTERVAL)
        time = _INTERVAL * np.arange(_SAMPLES)
        tables.append(
            pd.DataFrame({"record": number, "time": time, "voltage": u, "position": position})
        )
    table = pd.concat(tables, ignore_index=True)
    noise = _NOISE * np.ptp(table["position"]) * rng.normal(size=len(table))
    return table.assign(position=table["position"] + noise), effect, description
