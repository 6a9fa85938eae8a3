"""A simulated actuator with one effect that nobody is told: the data of ``skhyst demo``.

Nothing here uses the models of the package: plays by their recursion and differential equations
by small semi-implicit steps, on a grid finer than the samples.
"""

import numpy as np
import pandas as pd

__all__ = ["SECRETS", "make_demo_recording"]

_SAMPLES = 1500  # a record
_RECORDS = 5
_INTERVAL = 1e-3  # s
_SUBSTEPS = 20
_NOISE = 0.002  # of the range


def _asymmetry(rng, v, step):
    """Bend the upper part of the stroke."""
    start, slope = rng.uniform(0.0, 0.3), rng.uniform(-0.4, -0.2)
    return v + slope * np.maximum(
        v - start, 0.0
    ), f"beyond {start:.3g} um the slope is {1 + slope:.3g}"


def _resonance(rng, v, step):
    """Pass the stroke through a mass on a spring."""
    frequency, damping = rng.uniform(20.0, 35.0), rng.uniform(0.02, 0.08)
    w = 2.0 * np.pi * frequency
    x, velocity = v[0], 0.0
    out = np.empty_like(v)
    for i, target in enumerate(v):
        velocity += step * w * (w * (target - x) - 2.0 * damping * velocity)
        x += step * velocity
        out[i] = x
    return out, f"a mode at {frequency:.4g} Hz with damping ratio {damping:.3g}"


def _creep(rng, v, step):
    """Add a unit that relaxes."""
    share, constant = rng.uniform(0.15, 0.3), rng.uniform(0.05, 0.2)
    x = v[0]
    slow = np.empty_like(v)
    for i, target in enumerate(v):
        x += (target - x) * -np.expm1(-step / constant)
        slow[i] = x
    return v + share * slow, f"{100 * share:.3g} % more, with a time constant of {constant:.3g} s"


def _output_saturation(rng, v, step):
    """Clip the reading."""
    level = rng.uniform(0.5, 0.7)
    return np.minimum(v, level), f"the sensor stops at {level:.4g} um"


SECRETS = {
    "asymmetry": _asymmetry,
    "resonance": _resonance,
    "creep": _creep,
    "output_saturation": _output_saturation,
}


def _drive(rng, number):
    """Return one record's drive, which starts at zero: triangles, a sweep, steps, sines, noise."""
    t = np.arange(_SAMPLES) / _SAMPLES
    kind = number % 5
    if kind == 0:
        u = 2.0 / np.pi * np.arcsin(np.sin(2.0 * np.pi * 4.0 * t)) * (1.0 - 0.5 * t)
    elif kind == 1:
        u = np.sin(2.0 * np.pi * (1.0 + 7.0 * t) * t)
    elif kind == 2:
        levels = np.repeat(rng.uniform(-1.0, 1.0, 12), -(-_SAMPLES // 12))[:_SAMPLES]
        u = np.convolve(np.concatenate([np.zeros(20), levels]), np.full(20, 0.05), "valid")[
            :_SAMPLES
        ]
    elif kind == 3:
        u = sum(np.sin(2.0 * np.pi * (f * t)) for f in (2.0, 5.0, 9.0, 14.0)) / 3.0
    else:
        raw = np.convolve(rng.normal(size=_SAMPLES + 60), np.hanning(60), "valid")[:_SAMPLES]
        u = (raw - raw[0]) / np.abs(raw - raw[0]).max()
    return 50.0 * (u - u[0])


def make_demo_recording(seed, *, n_records=_RECORDS):
    """Simulate a recording.

    Parameters
    ----------
    seed : int
        Chooses the effect, its size, and everything else.
    n_records : int, default=5

    Returns
    -------
    table : DataFrame
        Columns ``record``, ``time`` (s), ``voltage`` (V), ``position`` (um).
    effect : str
        The secret.
    description : str
        Its size, in words.
    """
    rng = np.random.default_rng(seed)
    effect = sorted(SECRETS)[rng.integers(len(SECRETS))]
    thresholds = np.concatenate([[0.0], np.sort(rng.uniform(2.0, 40.0, 8))])
    weights = rng.uniform(0.3, 1.0, 9) * np.array([4.0, *np.ones(8)])
    weights *= 0.018 / weights.sum()
    size_seed = rng.integers(2**31)
    tables, description = [], ""
    for number in range(n_records):
        u = _drive(rng, number)
        fine = np.interp(np.arange(_SAMPLES * _SUBSTEPS) / _SUBSTEPS, np.arange(_SAMPLES), u)
        plays = np.zeros(9)
        v = np.empty_like(fine)
        for i, value in enumerate(fine):
            plays = np.maximum(value - thresholds, np.minimum(value + thresholds, plays))
            v[i] = weights @ plays
        # the same size of the effect in every record
        y, description = SECRETS[effect](np.random.default_rng(size_seed), v, _INTERVAL / _SUBSTEPS)
        tables.append(
            pd.DataFrame(
                {
                    "record": number,
                    "time": np.arange(_SAMPLES) * _INTERVAL,
                    "voltage": u,
                    "position": y[::_SUBSTEPS],
                }
            )
        )
    table = pd.concat(tables, ignore_index=True)
    noise = _NOISE * np.ptp(table["position"]) * rng.normal(size=len(table))
    return table.assign(position=table["position"] + noise), effect, description
