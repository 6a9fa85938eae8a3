"""The protocol of operators, series and sums of them, and loops that several models share."""

from ._composition import FrozenOperator, SeriesOperator, SumOperator
from ._differences import latest, samples_before, slopes
from ._plays import (
    clip_play,
    play_basis,
    play_tangents,
    play_thresholds,
    stop_basis,
    turning_points,
)
from ._protocol import Operator, ParameterSpec, as_signal, parameter

__all__ = [
    "FrozenOperator",
    "Operator",
    "ParameterSpec",
    "SeriesOperator",
    "SumOperator",
    "as_signal",
    "clip_play",
    "latest",
    "parameter",
    "play_basis",
    "play_tangents",
    "play_thresholds",
    "samples_before",
    "slopes",
    "stop_basis",
    "turning_points",
]
