"""Neural networks that are built from the data, for lagged inputs and hysteretic features."""

from ._gray_box import GrayBoxHysteresis
from ._gray_box_operator import GrayBoxOperator
from ._scn import SCNRegressor

__all__ = ["GrayBoxHysteresis", "GrayBoxOperator", "SCNRegressor"]
