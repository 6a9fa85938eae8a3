"""Models that predict the output from past inputs and past outputs."""

from ._narmax import NARMAXRegressor
from ._narx import NARXRegressor

__all__ = ["NARMAXRegressor", "NARXRegressor"]
