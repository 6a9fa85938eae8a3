"""NARX and NARMAX models: the output as a function of past inputs and past outputs."""

from ._narmax import NARMAXRegressor
from ._narx import NARXRegressor
from ._streaming import compiled_regressor as compiled_regressor

__all__ = ["NARMAXRegressor", "NARXRegressor"]
