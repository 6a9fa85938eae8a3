"""Noise: its model, spectrum, innovations and size, and tests of sums under it."""

from ._autoregression import autoregression as autoregression
from ._autoregression import whitening_filter as whitening_filter
from ._block_test import block_length as block_length
from ._block_test import block_p_value as block_p_value
from ._block_test import independent_sample as independent_sample
from ._differences import difference_noise
from ._differences import largest_noise as largest_noise
from ._differences import white_noise_floor as white_noise_floor
from ._model import STEEPEST as STEEPEST
from ._model import NoiseModel, fit_noise
from ._model import stretches as stretches
from ._whiteness import whiteness_p_value as whiteness_p_value

__all__ = ["NoiseModel", "difference_noise", "fit_noise"]
