"""Models that predict the output from past inputs and past outputs."""

from ._narmax import NARMAXRegressor
from ._narx import NARXRegressor
from ._streaming import lowered_regressor

__all__ = ["NARMAXRegressor", "NARXRegressor", "lowered_regressor"]
