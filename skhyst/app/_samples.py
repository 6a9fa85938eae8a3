"""Recordings to try the page on: simulated devices that share no code with the models."""

from functools import partial

import numpy as np
import pandas as pd

from ..datasets.simulation import Plant, clip, first_order, kelvin_voigt, oscillate, plays

_DT = 2e-3  # s
_N_SAMPLES = 1500
_SUBSTEPS = 10  # integration steps per sample
_NOISE = 0.003  # standard deviation as a fraction of the range
_PLAYS = partial(plays, thresholds=[0.0, 4.0, 10.0, 20.0], weights=[0.1, 0.03, 0.03, 0.02])


def _bursts(rng):
    """Return steps with rests, then a sine that grows in amplitude and frequency."""
    levels = np.repeat(rng.uniform(-1.0, 1.0, 8), _N_SAMPLES // 16)
    ramps = np.convolve(np.append(np.zeros(9), levels), np.full(10, 0.1), "valid")
    t = np.linspace(0.0, 1.0, _N_SAMPLES - ramps.size)  # the last level decays under the sine
    swept = np.sin(2.0 * np.pi * (2.0 + 10.0 * t) * t) * (0.3 + 0.7 * t)
    return np.concatenate([ramps, ramps[-1] * (1.0 - t) ** 8 + swept])


_DEVICES = {  # file, names of drive and response, full scale of the drive, stages
    "A piezo stage: voltage to position": (
        "piezo_stage.csv",
        ("voltage [V]", "position [um]"),
        40.0,
        (_PLAYS, partial(kelvin_voigt, taus=[0.15], compliances=[0.25])),
    ),
    "A mass on a spring with friction: force to position": (
        "mass_with_friction.csv",
        ("force [N]", "position [mm]"),
        5.0,
        (
            partial(
                oscillate, frequency=12.0, damping=0.1, scale=5.0, friction=0.08, presliding=0.005
            ),
        ),
    ),
    "A slow sensor that clips: pressure to voltage": (
        "clipped_sensor.csv",
        ("pressure [bar]", "sensor [V]"),
        3.0,
        (partial(first_order, tau=0.02), partial(clip, low=-np.inf, high=1.8)),
    ),
}
SAMPLES = tuple(_DEVICES)
"""What the recordings are of."""


def sample_recording(name) -> tuple[str, pd.DataFrame]:
    """Return a recording to try.

    Parameters
    ----------
    name : str
        One of :data:`SAMPLES`.

    Returns
    -------
    file : str
        Name for a file.
    table : DataFrame
        Columns of the time (s), the drive and the response.
    """
    file, (drive, response), scale, stages = _DEVICES[name]
    rng = np.random.default_rng(SAMPLES.index(name))
    u = scale * _bursts(rng)
    y = Plant({str(number): (stage,) for number, stage in enumerate(stages)}).respond(
        u, _SUBSTEPS, _DT
    )
    y = y + _NOISE * np.ptp(y) * rng.normal(size=y.size)
    time = np.round(_DT * np.arange(u.size), 6)
    return file, pd.DataFrame({"time [s]": time, drive: u, response: y})
