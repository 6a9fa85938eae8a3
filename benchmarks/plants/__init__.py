"""Plants that judge the effect search: simulated recordings with undeclared effects.

Nothing here is shared with the models that are judged. A plant is built as those of skhyst's own
datasets are, by `skhyst.datasets.simulation`, and so are its memory and its clipping; differential
equations and signals are written once more, in the plainest way. The drive is piecewise linear
between its samples. Every plant is advanced on a grid that is `substeps` times finer than the
sampling: plays by their defining recursion, dynamics by classical Runge-Kutta steps, everything
else by its law. In here time counts in sampling intervals and the static response peaks at one;
`Recording` carries seconds and the units of drive and response.

A signal path has these places, in this order; the core is the declared hysteresis or gain, the
motion the declared mode::

    drive -> first -> core -> middle -> motion -> dynamics -> last -> (sampled) + additive + noise

Every record starts as if the device had been loaded from zero to the first drive value for the
first time, and had then rested until every dynamic settled.
"""

from .effects import LAWS, SUBSTEPS, Setting
from .recording import (
    BASES,
    EFFECTS,
    MATRIX,
    UNKNOWN,
    Recording,
    effect_pairs,
    make_recording,
    unknown_structures,
)
from .signals import N_TEST, N_TRAIN, SIGNALS

__all__ = [
    "BASES",
    "EFFECTS",
    "LAWS",
    "MATRIX",
    "N_TEST",
    "N_TRAIN",
    "SIGNALS",
    "SUBSTEPS",
    "UNKNOWN",
    "Recording",
    "Setting",
    "effect_pairs",
    "make_recording",
    "unknown_structures",
]
