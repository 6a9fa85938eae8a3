"""Noise: its model, its spectrum and innovations, its least and largest size, tests beside it."""

from ._autoregression import autoregression, levinson, whitening_filter
from ._block_test import block_length, block_p_value
from ._differences import difference_noise, largest_noise, white_noise_floor
from ._model import STEEPEST, NoiseModel, fit_noise, quantisation_step, stretches

__all__ = [
    "STEEPEST",
    "NoiseModel",
    "autoregression",
    "block_length",
    "block_p_value",
    "difference_noise",
    "fit_noise",
    "largest_noise",
    "levinson",
    "quantisation_step",
    "stretches",
    "white_noise_floor",
    "whitening_filter",
]
