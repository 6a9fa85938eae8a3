"""Neural networks that are built from the data, for lagged inputs and hysteretic features."""

from ._gray_box import GrayBoxHysteresis, GrayBoxOperator
from ._scn import SCNRegressor

__all__ = ["GrayBoxHysteresis", "GrayBoxOperator", "SCNRegressor"]
